#include "drivers/imu/i2c_imu.h"

#include <errno.h>
#include <gpiod.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "drivers/imu/board.h"
#include "drivers/imu/source.h"

enum { NS_PER_S = 1000000000, QUEUE = 256, STACK_BYTES = 256 * 1024 };

struct message {
	struct imu_health health;
	struct imu_sample sample;
	bool has_sample;
};

struct i2c_imu {
	struct imu_port port;
	struct i2c_bus *bus;
	struct i2c_imu_config config;

	/* the thread's own */
	struct board board;
	struct imu_health told; /* what the last message said */
	struct gpiod_chip *gpio;
	struct gpiod_line *drdy;

	/* between the two */
	pthread_t thread;
	int wake_fd; /* for the thread: stop, or something to do */
	struct message queue[QUEUE];
	atomic_uint head, tail; /* written by the thread; taken by the port */
	atomic_uint lost;	/* found no room */
	atomic_bool stop, self_test, replan;
	pthread_mutex_t plan_lock;
	struct board_plan plan; /* to be applied when `replan` */
};

/* ---- the thread -------------------------------------------------------------------------------------------------- */

int64_t i2c_imu_now_ns(void *unused)
{
	struct timespec now;

	(void)unused;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

static void sleep_until(void *unused, int64_t ns)
{
	struct timespec at = {ns / NS_PER_S, ns % NS_PER_S};

	(void)unused;
	while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) == EINTR)
		;
}

static const struct board_clock CLOCK = {.now_ns = i2c_imu_now_ns, .sleep_until = sleep_until};

static void send_message(struct i2c_imu *imu, const struct imu_sample *sample)
{
	unsigned head = atomic_load_explicit(&imu->head, memory_order_relaxed);
	struct message *m = &imu->queue[head % QUEUE];
	const uint64_t one = 1;

	if (head - atomic_load_explicit(&imu->tail, memory_order_acquire) == QUEUE) {
		atomic_fetch_add_explicit(&imu->lost, 1, memory_order_relaxed);
		return;
	}
	*m = (struct message){.health = imu->board.health, .has_sample = sample};
	if (sample)
		m->sample = *sample;
	imu->told = imu->board.health;
	atomic_store_explicit(&imu->head, head + 1, memory_order_release);
	if (write(imu->port.fd, &one, sizeof one) < 0) { /* the counter is full: it is readable already */
	}
}

static bool state_changed(const struct imu_health *a, const struct imu_health *b)
{
	return a->fault != b->fault || a->fault_chip != b->fault_chip || a->degraded != b->degraded ||
	       a->degraded_chip != b->degraded_chip || a->self_test != b->self_test || a->restarts != b->restarts;
}

static void deliver(struct i2c_imu *imu)
{
	struct imu_sample sample;

	while (board_next(&imu->board, &sample))
		if (!imu->board.health.fault)
			send_message(imu, &sample);
	if (state_changed(&imu->told, &imu->board.health))
		send_message(imu, NULL);
}

static void wait_until(struct i2c_imu *imu, int64_t wake_ns)
{
	struct pollfd fds[2] = {{imu->wake_fd, POLLIN, 0}, {-1, POLLIN, 0}};
	int64_t left_ns = wake_ns - i2c_imu_now_ns(NULL);
	struct timespec timeout = {0};
	struct gpiod_line_event event;
	uint64_t count;

	if (left_ns > 0)
		timeout = (struct timespec){left_ns / NS_PER_S, left_ns % NS_PER_S};
	if (imu->drdy)
		fds[1].fd = gpiod_line_event_get_fd(imu->drdy);
	if (ppoll(fds, 2, &timeout, NULL) <= 0)
		return;
	if (fds[0].revents && read(imu->wake_fd, &count, sizeof count) < 0)
		return;
	if (fds[1].revents && gpiod_line_event_read(imu->drdy, &event) == 0)
		board_data_ready(&imu->board, (int64_t)event.ts.tv_sec * NS_PER_S + event.ts.tv_nsec);
}

static void take_orders(struct i2c_imu *imu)
{
	if (atomic_exchange(&imu->replan, false)) {
		pthread_mutex_lock(&imu->plan_lock);
		board_apply(&imu->board, &imu->plan);
		pthread_mutex_unlock(&imu->plan_lock);
	}
	if (atomic_exchange(&imu->self_test, false))
		board_self_test(&imu->board);
}

static void *run(void *ctx)
{
	struct i2c_imu *imu = ctx;

	prctl(PR_SET_NAME, "imu9-i2c");
	prctl(PR_SET_TIMERSLACK, 1UL);
	while (!atomic_load(&imu->stop)) {
		int64_t wake_ns;

		take_orders(imu);
		wake_ns = board_step(&imu->board);
		deliver(imu);
		wait_until(imu, wake_ns);
	}
	return NULL;
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static void note_lost(struct i2c_imu *imu)
{
	unsigned lost = atomic_exchange_explicit(&imu->lost, 0, memory_order_relaxed);

	if (lost == 0)
		return;
	imu->port.counters.skipped += lost;
	snprintf(imu->port.last_skip, sizeof imu->port.last_skip, "nobody took them in time");
}

static int take_message(struct i2c_imu *imu, struct imu_sample *sample)
{
	unsigned tail = atomic_load_explicit(&imu->tail, memory_order_relaxed);
	const struct message *m = &imu->queue[tail % QUEUE];
	int result = 0;

	imu->port.health = m->health;
	if (m->has_sample) {
		*sample = m->sample;
		imu->port.counters.samples++;
		if ((double)i2c_imu_now_ns(NULL) - 1e3 * (double)sample->t_us > 2e9 / imu->port.rate_hz)
			imu->port.counters.late++;
		result = 1;
	} else if (m->health.fault) {
		result = -EIO;
	}
	atomic_store_explicit(&imu->tail, tail + 1, memory_order_release);
	return result;
}

static bool queue_empty(struct i2c_imu *imu)
{
	return atomic_load_explicit(&imu->head, memory_order_acquire) ==
	       atomic_load_explicit(&imu->tail, memory_order_relaxed);
}

static int port_read(struct imu_port *port, struct imu_sample *sample)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;
	uint64_t count;
	int result = 0;

	note_lost(imu);
	if (queue_empty(imu) && read(port->fd, &count, sizeof count) < 0 && errno != EAGAIN)
		return -errno;
	while (result == 0 && !queue_empty(imu)) /* one may have come before the counter was read */
		result = take_message(imu, sample);
	return result;
}

static void wake(struct i2c_imu *imu)
{
	const uint64_t one = 1;

	if (write(imu->wake_fd, &one, sizeof one) < 0) { /* full: it wakes anyway */
	}
}

static int make_plan(struct i2c_imu *imu, const struct imu_settings *settings, struct board_plan *plan, char *error,
	size_t error_size)
{
	struct imu_settings wanted = *settings;

	if (imu->config.rate_hz > 0)
		wanted.rate_hz = imu->config.rate_hz;
	return board_plan(&imu->board, &wanted, imu->config.stub, imu->drdy != NULL, plan, error, error_size);
}

static void use_rate(struct imu_port *port, double rate_hz)
{
	port->rate_hz = rate_hz;
	port->silence_us = source_silence_us(rate_hz);
}

static int port_configure(
	struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;
	struct board_plan plan;
	int result = make_plan(imu, settings, &plan, error, error_size);

	if (result < 0 || dry)
		return result;
	pthread_mutex_lock(&imu->plan_lock);
	imu->plan = plan;
	pthread_mutex_unlock(&imu->plan_lock);
	atomic_store(&imu->replan, true);
	use_rate(port, plan.rate_hz);
	wake(imu);
	return 0;
}

static void port_self_test(struct imu_port *port)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;

	atomic_store(&imu->self_test, true);
	wake(imu);
}

static void release(struct i2c_imu *imu)
{
	if (imu->gpio)
		gpiod_chip_close(imu->gpio);
	if (imu->port.fd >= 0)
		close(imu->port.fd);
	if (imu->wake_fd >= 0)
		close(imu->wake_fd);
	i2c_close(imu->bus);
	free(imu);
}

static void port_close(struct imu_port *port)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;

	atomic_store(&imu->stop, true);
	wake(imu);
	pthread_join(imu->thread, NULL);
	pthread_mutex_destroy(&imu->plan_lock);
	release(imu);
}

static const struct imu_ops OPS = {
	.read = port_read, .close = port_close, .configure = port_configure, .self_test = port_self_test};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static int open_drdy(struct i2c_imu *imu, char *error, size_t error_size)
{
	const struct i2c_imu_config *config = &imu->config;
	int result;

	if (!config->drdy_chip)
		return 0;
	imu->gpio = gpiod_chip_open_lookup(config->drdy_chip);
	imu->drdy = imu->gpio ? gpiod_chip_get_line(imu->gpio, config->drdy_line) : NULL;
	if (imu->drdy && gpiod_line_request_rising_edge_events(imu->drdy, "imu9-gateway") == 0)
		return 0;
	result = errno ? -errno : -EIO;
	snprintf(error, error_size, "data-ready line %s:%u: %s: gpioinfo shows what there is", config->drdy_chip,
		config->drdy_line, strerror(-result));
	return result;
}

static int start_thread(struct i2c_imu *imu, const struct imu_settings *settings)
{
	const struct sched_param param = {.sched_priority = settings->realtime};
	pthread_attr_t attributes;
	int result;

	pthread_attr_init(&attributes);
	pthread_attr_setstacksize(&attributes, STACK_BYTES);
	pthread_mutex_init(&imu->plan_lock, NULL);
	result = pthread_create(&imu->thread, &attributes, run, imu);
	pthread_attr_destroy(&attributes);
	/* refused: the process says so for its main thread */
	if (result == 0 && settings->realtime > 0)
		pthread_setschedparam(imu->thread, SCHED_FIFO, &param);
	return -result;
}

/* Up to the thread: everything that can fail with a reason. */
static int prepare(struct i2c_imu *imu, const struct imu_settings *settings, char *error, size_t error_size)
{
	char why[160];
	int result = board_detect(&imu->board, imu->bus, &CLOCK, why, sizeof why);

	if (result < 0) {
		snprintf(error, error_size, "%s: %s", imu->config.name, why);
		return result;
	}
	result = open_drdy(imu, error, error_size);
	if (result == 0)
		result = make_plan(imu, settings, &imu->plan, error, error_size);
	if (result < 0)
		return result;
	snprintf(imu->port.name, sizeof imu->port.name, "%.40s %.20s", imu->config.name, imu->board.name);
	use_rate(&imu->port, imu->plan.rate_hz);
	board_apply(&imu->board, &imu->plan);
	if (settings->self_test)
		board_self_test(&imu->board);
	return 0;
}

int i2c_imu_start(struct i2c_bus *bus, const struct i2c_imu_config *config, const struct imu_settings *settings,
	struct imu_port **port, char *error, size_t error_size)
{
	struct i2c_imu *imu = calloc(1, sizeof *imu);
	int result;

	if (!imu) {
		i2c_close(bus);
		return -ENOMEM;
	}
	imu->bus = bus;
	imu->config = *config;
	imu->port.ops = &OPS;
	imu->port.fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	imu->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	if (imu->port.fd < 0 || imu->wake_fd < 0) {
		result = -errno;
		snprintf(error, error_size, "%s: %s", config->name, strerror(-result));
	} else {
		result = prepare(imu, settings, error, error_size);
	}
	if (result == 0) {
		imu->config.name = imu->config.drdy_chip = NULL; /* the caller's */
		result = start_thread(imu, settings);
		if (result < 0)
			snprintf(error, error_size, "no thread for the sensor: %s", strerror(-result));
	}
	if (result < 0) {
		release(imu);
		return result;
	}
	*port = &imu->port;
	return 0;
}

/* ---- i2c:/dev/i2c-N ---------------------------------------------------------------------------------------------- */

static int parse_option(char *option, struct i2c_imu_config *config)
{
	char *line, *end;

	if (strcmp(option, "stub") == 0) {
		config->stub = true;
		return 0;
	}
	if (strncmp(option, "drdy=", 5) != 0 || !(line = strchr(option, ':')) || line == option + 5)
		return -EINVAL;
	*line++ = '\0';
	config->drdy_chip = option + 5;
	config->drdy_line = (unsigned)strtoul(line, &end, 10);
	return *line >= '0' && *line <= '9' && *end == '\0' ? 0 : -EINVAL;
}

int i2c_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	char *rest = args, *path = strsep(&rest, ","), *option, name[48];
	struct i2c_imu_config config = {.name = name};
	struct i2c_bus *bus;
	int result;

	if (!path || *path == '\0') {
		snprintf(error, error_size, "i2c: no bus: use i2c:/dev/i2c-N[,drdy=GPIOCHIP:LINE][,stub]");
		return -EINVAL;
	}
	while ((option = strsep(&rest, ",")))
		if (parse_option(option, &config) < 0) {
			snprintf(error, error_size, "i2c: '%.40s': use drdy=GPIOCHIP:LINE or stub", option);
			return -EINVAL;
		}
	snprintf(name, sizeof name, "i2c:%.40s", path);
	result = i2c_dev_open(path, &bus, error, error_size);
	if (result < 0)
		return result;
	return i2c_imu_start(bus, &config, settings, port, error, error_size);
}

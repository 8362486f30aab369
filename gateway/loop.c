#include "gateway/loop.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/signalfd.h>
#include <sys/timerfd.h>
#include <sys/timex.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"
#include "gateway/log.h"
#include "gateway/record.h"
#include "gateway/service.h"

/* Limits for each wake-up, so that no source starves the others; what is left is read at the next one. */
enum { SAMPLES_PER_WAKE = 16, FRAMES_PER_WAKE = 64 };

/* The time stamp of a frame replaces a reading of the clock that is at most this much older. */
enum { STAMP_TRUSTED_US = 20000 };

/* A wake-up this late means that the process was not scheduled. */
enum { AWAY_US = 20000 };

/* A deadline so close is not worth setting the timer and going to sleep. */
enum { AT_ONCE_US = 10 };

enum source {
	SOURCE_SENSOR,
	SOURCE_BUS,
	SOURCE_TIMER,
	SOURCE_SIGNAL,
	SOURCE_STORE,
	SOURCE_CIA309,
	SOURCE_WINDOW,
	SOURCE_COUNT
};

struct loop {
	struct device *device;
	struct can_port *bus;
	struct imu_port *imu;
	struct store_writer *writer;
	struct cia309_server *cia309; /* NULL: off */
	bool cia309_readable;
	struct window *window;
	struct service service;
	loop_reload *reload;
	int epoll, timer, signals;
	uint64_t now_us;   /* the last reading */
	uint64_t begun_us; /* the turn under way: time of its first event; 0: none yet */
	uint64_t due_us;   /* when the device, the bus or the service manager must be served next */
	uint64_t armed_us; /* what the timer is set to, at most due_us; UINT64_MAX: off */
	uint32_t last_skipped;
	uint64_t skip_logged_us;
	uint64_t second_us; /* of the last once_a_second(); what the process had used, and samples it had read: */
	uint64_t cpu_ns;
	uint32_t samples;
	bool frames_left; /* by the last wake-up */
	bool quit;
};

static uint64_t read_ns(clockid_t clock)
{
	struct timespec t;

	clock_gettime(clock, &t);
	return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

/* CLOCK_MONOTONIC. */
static uint64_t now(void)
{
	return read_ns(CLOCK_MONOTONIC) / 1000;
}

static uint64_t now_ns(void *ctx)
{
	(void)ctx;
	return read_ns(CLOCK_MONOTONIC);
}

static int watch(struct loop *l, int fd, enum source source)
{
	struct epoll_event event = {.events = EPOLLIN, .data.u32 = source};

	return epoll_ctl(l->epoll, EPOLL_CTL_ADD, fd, &event) < 0 ? -errno : 0;
}

/* ---- sources ----------------------------------------------------------------------------------------------------- */

/* Bad rows of a log are reported once a second at most. */
static void log_skips(struct loop *l, uint64_t now_us)
{
	uint32_t skipped = l->imu->counters.skipped;

	if (skipped == l->last_skipped || (l->skip_logged_us && now_us - l->skip_logged_us < 1000000))
		return;
	log_line("%u samples skipped; reason for the last one: %s", skipped - l->last_skipped, l->imu->last_skip);
	l->last_skipped = skipped;
	l->skip_logged_us = now_us;
}

static void on_sensor(struct loop *l, uint64_t now_us)
{
	struct imu_sample sample;

	for (int i = 0; i < SAMPLES_PER_WAKE; i++) {
		int read = imu_read(l->imu, &sample);

		if (read == 0)
			break;
		if (read == -ENODATA) {
			log_line("%s has ended", l->imu->name);
			epoll_ctl(l->epoll, EPOLL_CTL_DEL, l->imu->fd, NULL);
		}
		if (read > 0)
			latency_stage(&l->device->latency, LATENCY_READ);
		device_sample(l->device, read, &sample, now_us);
		if (read < 0)
			break;
		service_ready(&l->service, l->imu->name);
	}
	log_skips(l, now_us);
}

/* The first event of a turn begins it. */
static void begin_turn(struct loop *l)
{
	if (l->begun_us == 0)
		l->begun_us = l->now_us;
}

/* Never back: the time stamp of a frame can be slightly ahead of the clock when the host's time is set. */
static void read_clock(struct loop *l)
{
	uint64_t t_ns = now_ns(NULL);

	latency_mark(&l->device->latency, t_ns);
	if (t_ns / 1000 > l->now_us)
		l->now_us = t_ns / 1000;
	begin_turn(l);
}

/* The time stamp of the frame saves a reading of the clock, a tenth of the time from SYNC to PDO where the kernel has
 * no vDSO. With a synchronous window (1007h) the clock is read: the time the frame has waited in the socket counts. */
static void update_time(struct loop *l, const struct can_msg *msg)
{
	bool trusted = msg->t_us > l->now_us && msg->t_us - l->now_us < STAMP_TRUSTED_US;

	if (!trusted || l->device->values.synchronous_window_length) {
		read_clock(l);
		return;
	}
	l->now_us = msg->t_us;
	begin_turn(l);
}

static uint32_t frames_sent(const struct can_port *bus)
{
	return bus->counters.tx + bus->counters.tx_dropped + (uint32_t)bus->queue_count;
}

static void on_bus(struct loop *l)
{
	struct can_msg msg;

	l->frames_left = false;
	for (int i = 0; i < FRAMES_PER_WAKE; i++) {
		if (can_receive(l->bus, &msg, l->now_us) <= 0)
			return;
		update_time(l, &msg);
		device_receive(l->device, &msg, l->now_us);
		if (!l->cia309)
			continue;
		uint32_t sent = frames_sent(l->bus);
		cia309_receive(l->cia309->core, &msg, l->now_us);
		if (frames_sent(l->bus) != sent)
			record_others(l->device->record);
	}
	l->frames_left = true;
}

/* The user has closed it, and does not want the configuration to be read. */
static bool terminal_is_gone(void)
{
	struct termios settings;

	return tcgetattr(STDERR_FILENO, &settings) < 0 && errno == EIO;
}

static void on_signal(struct loop *l)
{
	struct signalfd_siginfo info;

	if (read(l->signals, &info, sizeof(info)) != sizeof(info))
		return;
	if (info.ssi_signo == SIGHUP && !terminal_is_gone()) {
		l->reload(l->device, l->now_us);
		return;
	}
	log_line("stopping on SIG%s", sigabbrev_np((int)info.ssi_signo));
	l->quit = true;
}

static void on_store(struct loop *l, uint64_t now_us)
{
	int rc = store_writer_result(l->writer);

	if (rc == -EAGAIN)
		return;
	device_saved(l->device, rc, now_us);
	if (l->window)
		window_saved(l->window, rc);
}

static void on_event(struct loop *l, enum source source)
{
	if (source != SOURCE_BUS)
		read_clock(l);
	switch (source) {
	case SOURCE_SENSOR:
		on_sensor(l, l->now_us);
		break;
	case SOURCE_BUS:
		on_bus(l);
		break;
	case SOURCE_TIMER:
		l->armed_us = UINT64_MAX; /* expired: setting it again clears the descriptor */
		break;
	case SOURCE_SIGNAL:
		on_signal(l);
		break;
	case SOURCE_STORE:
		on_store(l, l->now_us);
		break;
	case SOURCE_CIA309: /* after what is urgent */
		l->cia309_readable = true;
		break;
	case SOURCE_WINDOW:
		window_serve(l->window, l->now_us);
		break;
	case SOURCE_COUNT:
		break;
	}
}

/* ---- the deadline ------------------------------------------------------------------------------------------------ */

/* Each sample and each frame moves deadlines on. The timer is left as it is then: it expires too early once, and is set
 * again. */
static void arm(struct loop *l)
{
	struct itimerspec t = {.it_value = {.tv_sec = (time_t)(l->due_us / 1000000),
				       .tv_nsec = (long)(l->due_us % 1000000 * 1000) + 1}}; /* 0 would disarm */

	if (l->due_us >= l->armed_us)
		return;
	l->armed_us = l->due_us;
	timerfd_settime(l->timer, TFD_TIMER_ABSTIME, &t, NULL);
}

/* The kernel knows whether an NTP or PTP daemon synchronises the host's clock. */
static void read_host_clock(struct loop *l)
{
	struct timex timex = {0};
	struct timespec t;

	bool synchronised = adjtimex(&timex) >= 0 && (timex.status & STA_UNSYNC) == 0;
	clock_gettime(CLOCK_REALTIME, &t);
	device_host_clock(l->device, synchronised, (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000 - (int64_t)now());
}

/* Of all threads, since the last call. */
static void measure_cpu(struct loop *l)
{
	uint64_t cpu_ns = read_ns(CLOCK_PROCESS_CPUTIME_ID);
	uint32_t samples = l->imu->counters.samples - l->samples;

	if (l->cpu_ns && samples)
		l->device->values.loop_turn.cpu_per_sample = (float)(cpu_ns - l->cpu_ns) / 1e3f / (float)samples;
	l->cpu_ns = cpu_ns;
	l->samples += samples;
}

static void once_a_second(struct loop *l)
{
	if (l->second_us && l->now_us - l->second_us < 1000000)
		return;
	l->second_us = l->now_us;
	read_host_clock(l);
	measure_cpu(l);
}

static uint64_t watch_threads(struct loop *l)
{
	return service_tick(&l->service, atomic_load_explicit(&l->imu->turns, memory_order_relaxed),
		l->writer && store_writer_busy(l->writer), l->now_us);
}

/* The commands of clients come last, and what they change may be due at once. */
static uint64_t tick_device(struct loop *l)
{
	uint64_t next_us = device_tick(l->device, l->now_us);

	if (!l->cia309)
		return next_us;
	uint32_t sent = frames_sent(l->bus);
	next_us = cia309_server_step(l->cia309, l->cia309_readable, l->now_us);
	l->cia309_readable = false;
	if (frames_sent(l->bus) != sent)
		record_others(l->device->record);
	return earlier(next_us, device_tick(l->device, l->now_us));
}

static void wake(struct loop *l)
{
	uint64_t slept_us = l->now_us;
	bool at_once = l->due_us <= l->now_us + AT_ONCE_US;
	struct epoll_event events[SOURCE_COUNT];

	if (!at_once)
		arm(l);
	int n = epoll_wait(l->epoll, events, SOURCE_COUNT, l->frames_left || at_once ? 0 : -1);
	l->begun_us = 0;
	if (at_once)
		read_clock(l);
	if (l->frames_left)
		on_bus(l);
	for (int i = 0; i < n; i++)
		on_event(l, (enum source)events[i].data.u32);
	if (l->now_us > l->due_us && l->now_us - l->due_us > AWAY_US) {
		device_away(l->device, l->now_us - slept_us, l->now_us);
		service_away(&l->service, l->now_us - slept_us);
	}
	once_a_second(l);
	l->due_us = earlier(earlier(tick_device(l), watch_threads(l)), can_service(l->bus, l->now_us));
	if (l->window)
		window_publish(l->window);
	latency_loop(&l->device->latency, l->begun_us);
}

static sigset_t signals_read(void)
{
	sigset_t signals;

	sigemptyset(&signals);
	sigaddset(&signals, SIGINT);
	sigaddset(&signals, SIGTERM);
	sigaddset(&signals, SIGHUP);
	return signals;
}

void loop_hold_signals(void)
{
	sigset_t signals = signals_read();

	sigprocmask(SIG_BLOCK, &signals, NULL);
	signal(SIGPIPE, SIG_IGN);
}

static int open_descriptors(struct loop *l)
{
	sigset_t signals = signals_read();
	int rc;

	l->signals = signalfd(-1, &signals, SFD_NONBLOCK | SFD_CLOEXEC);
	l->timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
	l->epoll = epoll_create1(EPOLL_CLOEXEC);
	if (l->signals < 0 || l->timer < 0 || l->epoll < 0)
		return -errno;
	if ((rc = watch(l, l->signals, SOURCE_SIGNAL)) < 0 || (rc = watch(l, l->timer, SOURCE_TIMER)) < 0 ||
		(rc = watch(l, l->imu->fd, SOURCE_SENSOR)) < 0 || (rc = watch(l, l->bus->fd, SOURCE_BUS)) < 0)
		return rc;
	if (l->writer && (rc = watch(l, l->writer->fd, SOURCE_STORE)) < 0)
		return rc;
	if (l->window && (rc = watch(l, window_fd(l->window), SOURCE_WINDOW)) < 0)
		return rc;
	return l->cia309 ? watch(l, l->cia309->fd, SOURCE_CIA309) : 0;
}

int loop_run(struct device *device, struct can_port *bus, struct imu_port *imu, struct store_writer *writer,
	struct cia309_server *cia309, struct window *window, bool stored_damaged, loop_reload *reload)
{
	struct loop l = {.device = device,
		.bus = bus,
		.imu = imu,
		.last_skipped = imu->counters.skipped, /* of a log: told with its notes */
		.writer = writer,
		.cia309 = cia309,
		.window = window,
		.reload = reload,
		.epoll = -1,
		.timer = -1,
		.signals = -1,
		.armed_us = UINT64_MAX};
	int rc = open_descriptors(&l);

	service_open(&l.service, getenv("NOTIFY_SOCKET"), getenv("WATCHDOG_USEC"), getenv("WATCHDOG_PID"));
	if (rc == 0) {
		l.now_us = now();
		device->latency.clock_ns = now_ns;
		device_start(device, stored_damaged, l.now_us);
		l.due_us = l.now_us;
		while (!l.quit)
			wake(&l);
		service_stopping(&l.service);
	}
	service_close(&l.service);
	close(l.epoll);
	close(l.timer);
	close(l.signals);
	return rc;
}

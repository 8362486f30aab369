#include "drivers/imu/pololu/i2c_imu.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "drivers/imu/pololu/board.h"
#include "drivers/imu/pololu/drdy.h"
#include "drivers/imu/imu_thread.h"
#include "drivers/imu/source.h"

static const char FIRMWARE[] = "/lib/firmware/bmi270-init-data.fw"; /* as the kernel's driver names it */

enum { NS_PER_S = 1000000000, HANGS_US = 300000, LOADS_US = 3000000, SIMULATED_US = 10000000 };

struct i2c_imu {
	struct imu_thread thread;
	struct i2c_bus *bus;
	struct i2c_imu_config config;

	uint8_t *firmware; /* of the chip; NULL: it needs none */

	/* used by the thread only */
	struct board board;
	struct drdy *drdy; /* or NULL */

	/* set by the port, read by the thread */
	atomic_bool self_test, replan;
	pthread_mutex_t plan_lock;
	struct board_plan plan; /* to be applied when `replan` */
};

/* ---- the thread -------------------------------------------------------------------------------------------------- */

int64_t i2c_imu_now_ns(void *unused)
{
	(void)unused;
	return imu_thread_now_ns();
}

static void sleep_until(void *unused, int64_t ns)
{
	struct timespec at = {ns / NS_PER_S, (long)(ns % NS_PER_S)};

	(void)unused;
	while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) == EINTR)
		;
}

static const struct board_clock CLOCK = {.now_ns = i2c_imu_now_ns, .sleep_until = sleep_until};

static void deliver(struct i2c_imu *imu)
{
	struct imu_sample sample;

	while (board_next(&imu->board, &sample)) {
		imu->thread.health = imu->board.health;
		if (!imu->board.health.fault)
			imu_thread_send(&imu->thread, &sample);
	}
	imu->thread.health = imu->board.health;
	imu_thread_report(&imu->thread);
}

static void wait_until(struct i2c_imu *imu, int64_t wake_ns)
{
	struct pollfd fd = {.events = POLLIN};
	int64_t edge_ns;

	if (imu->drdy)
		fd.fd = drdy_fd(imu->drdy);
	imu_thread_wait(&imu->thread, wake_ns, &fd, imu->drdy ? 1 : 0);
	if (fd.revents && drdy_read(imu->drdy, &edge_ns) == 0)
		board_data_ready(&imu->board, edge_ns);
}

static void apply_requests(struct i2c_imu *imu)
{
	if (atomic_exchange(&imu->replan, false)) {
		pthread_mutex_lock(&imu->plan_lock);
		board_apply(&imu->board, &imu->plan);
		pthread_mutex_unlock(&imu->plan_lock);
	}
	if (atomic_exchange(&imu->self_test, false)) {
		imu->thread.health.self_test = IMU_SELF_TEST_RUNS;
		imu_thread_report(&imu->thread);
		board_self_test(&imu->board);
	}
}

static void run(struct imu_thread *t)
{
	struct i2c_imu *imu = (struct i2c_imu *)t;

	while (!imu_thread_stopping(t)) {
		int64_t wake_ns;

		apply_requests(imu);
		wake_ns = board_step(&imu->board);
		deliver(imu);
		wait_until(imu, wake_ns);
	}
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static int make_plan(struct i2c_imu *imu, const struct imu_settings *settings, struct board_plan *plan, char *error,
	size_t error_size)
{
	struct imu_settings wanted = *settings;

	if (imu->config.rate_hz > 0)
		wanted.rate_hz = imu->config.rate_hz;
	return board_plan(&imu->board, &wanted, imu->config.stub, imu->drdy != NULL, plan, error, error_size);
}

/* The thread reports faults of the bus itself. The port's silence is the limit for a hanging thread, and tolerates a
 * slow machine, and the time that a chip's configuration file takes on a slow bus. */
static void use_rate(struct i2c_imu *imu, double rate_hz)
{
	uint64_t hangs_us = imu->config.simulated ? SIMULATED_US : imu->firmware ? LOADS_US : HANGS_US;
	struct imu_port *port = &imu->thread.port;

	source_use_rate(port, rate_hz);
	if (port->silence_us < hangs_us)
		port->silence_us = hangs_us;
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
	use_rate(imu, plan.rate_hz);
	imu_thread_wake(&imu->thread);
	return 0;
}

static void port_self_test(struct imu_port *port)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;

	atomic_store(&imu->self_test, true);
	imu_thread_wake(&imu->thread);
}

static void release(struct i2c_imu *imu)
{
	drdy_close(imu->drdy);
	pthread_mutex_destroy(&imu->plan_lock);
	imu_thread_release(&imu->thread);
	i2c_close(imu->bus);
	free(imu->firmware);
	free(imu);
}

static void port_close(struct imu_port *port)
{
	struct i2c_imu *imu = (struct i2c_imu *)port;

	imu_thread_stop(&imu->thread);
	release(imu);
}

static const struct imu_ops OPS = {
	.read = imu_thread_read, .close = port_close, .configure = port_configure, .self_test = port_self_test};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static int open_drdy(struct i2c_imu *imu, char *error, size_t error_size)
{
	const struct i2c_imu_config *config = &imu->config;
	int result;

	if (!config->drdy_chip)
		return 0;
	imu->drdy = drdy_open(config->drdy_chip, config->drdy_line);
	if (imu->drdy)
		return 0;
	result = errno ? -errno : -EIO;
	snprintf(error, error_size, "data-ready line %s:%u: %s: use one that `gpioinfo` lists as unused",
		config->drdy_chip, config->drdy_line, strerror(-result));
	return result;
}

static int read_file(const char *path, uint8_t *bytes, size_t size)
{
	FILE *file = fopen(path, "rb");
	int result = file ? 0 : -errno;

	if (file && (fread(bytes, 1, size, file) != size || fgetc(file) != EOF))
		result = -EINVAL;
	if (file)
		fclose(file);
	return result;
}

/* A simulated chip takes any file; here one of zeroes. */
static int load_firmware(struct i2c_imu *imu, char *error, size_t error_size)
{
	const struct chip *chip = imu->board.gyro->chip;
	const char *path = imu->config.firmware ? imu->config.firmware : FIRMWARE;
	int result;

	if (chip->firmware_size == 0)
		return 0;
	imu->board.firmware = imu->firmware = calloc(1, chip->firmware_size);
	if (!imu->firmware)
		return -ENOMEM;
	result = imu->config.simulated ? 0 : read_file(path, imu->firmware, chip->firmware_size);
	if (result < 0)
		snprintf(error, error_size,
			"%s: the %s needs its configuration file %.80s: %s: take the array bmi270_config_file of its "
			"manufacturer's BMI270_SensorAPI (%zu bytes), and name it by config=FILE or put it there",
			imu->config.name, chip->name, path,
			result == -EINVAL ? "it has another size" : strerror(-result), chip->firmware_size);
	return result;
}

/* All that can fail before the thread is started. */
static int prepare(struct i2c_imu *imu, const struct imu_settings *settings, char *error, size_t error_size)
{
	char why[160];
	int result = board_detect(&imu->board, imu->bus, &CLOCK, why, sizeof why);

	if (result < 0) {
		snprintf(error, error_size, "%s: %s", imu->config.name, why);
		return result;
	}
	result = load_firmware(imu, error, error_size);
	if (result == 0)
		result = open_drdy(imu, error, error_size);
	if (result == 0)
		result = make_plan(imu, settings, &imu->plan, error, error_size);
	if (result < 0)
		return result;
	snprintf(imu->thread.port.name, sizeof imu->thread.port.name, "%.40s %.20s", imu->config.name, imu->board.name);
	snprintf(imu->thread.port.notes, sizeof imu->thread.port.notes, "%s%s%s",
		imu->board.note[0] ? imu->config.name : "", imu->board.note[0] ? ": " : "", imu->board.note);
	use_rate(imu, imu->plan.rate_hz);
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
	imu->thread.port.ops = &OPS;
	pthread_mutex_init(&imu->plan_lock, NULL);
	result = imu_thread_init(&imu->thread);
	if (result < 0)
		snprintf(error, error_size, "%s: %s", config->name, strerror(-result));
	else
		result = prepare(imu, settings, error, error_size);
	if (result == 0) {
		imu->config.name = imu->config.drdy_chip = imu->config.firmware = NULL; /* the caller's */
		result = imu_thread_start(&imu->thread, "imu9-i2c", settings->realtime, run);
		if (result < 0)
			snprintf(error, error_size, "cannot start the sensor's thread: %s", strerror(-result));
	}
	if (result < 0) {
		release(imu);
		return result;
	}
	*port = &imu->thread.port;
	return 0;
}

/* ---- i2c:/dev/i2c-N and spi:/dev/spidevB.C ----------------------------------------------------------------------- */

static int parse_drdy(char *value, struct i2c_imu_config *config)
{
	char *line = strchr(value, ':'), *end;

	if (!line || line == value)
		return -EINVAL;
	*line++ = '\0';
	config->drdy_chip = value;
	config->drdy_line = (unsigned)strtoul(line, &end, 10);
	return *line >= '0' && *line <= '9' && *end == '\0' ? 0 : -EINVAL;
}

/* The options of both buses. */
static int parse_option(char *option, struct i2c_imu_config *config)
{
	if (strcmp(option, "stub") == 0) {
		config->stub = true;
		return 0;
	}
	if (strncmp(option, "config=", 7) == 0 && option[7]) {
		config->firmware = option + 7;
		return 0;
	}
	return strncmp(option, "drdy=", 5) == 0 ? parse_drdy(option + 5, config) : -EINVAL;
}

/* Of chips as they were delivered. */
static int start_delivered(struct i2c_bus *bus, const struct i2c_imu_config *config,
	const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	int result = i2c_imu_start(bus, config, settings, port, error, error_size);

	if (result == 0)
		(*port)->uncalibrated = IMU_UNCALIBRATED;
	return result;
}

int i2c_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	char *rest = args, *path = strsep(&rest, ","), *option, name[48];
	struct i2c_imu_config config = {.name = name};
	struct i2c_bus *bus;
	int result;

	if (!path || *path == '\0') {
		snprintf(error, error_size, "i2c: no bus: use " I2C_SYNTAX);
		return -EINVAL;
	}
	while ((option = strsep(&rest, ",")))
		if (parse_option(option, &config) < 0) {
			snprintf(error, error_size, "i2c: unknown option '%.40s': use " I2C_SYNTAX, option);
			return -EINVAL;
		}
	if (!port)
		return 0;
	snprintf(name, sizeof name, "i2c:%.40s", path);
	result = i2c_dev_open(path, &bus, error, error_size);
	if (result < 0)
		return result;
	return start_delivered(bus, &config, settings, port, error, error_size);
}

struct spi_args {
	const char *paths[SPI_DEVICES_MAX];
	size_t count;
	struct spi_options options;
};

static int parse_spi(char *option, struct spi_args *spi, struct i2c_imu_config *config)
{
	double number;

	if (option[0] == '/') {
		if (spi->count == SPI_DEVICES_MAX)
			return -EINVAL;
		spi->paths[spi->count++] = option;
		return 0;
	}
	if (strcmp(option, "mode=0") == 0 || strcmp(option, "mode=3") == 0) {
		spi->options.mode = (unsigned)(option[5] - '0');
		return 0;
	}
	if (strncmp(option, "speed=", 6) != 0)
		return parse_option(option, config);
	if (source_positive(option + 6, &number) < 0 || number < 1e4 || number > 24e6)
		return -EINVAL;
	spi->options.speed_hz = (unsigned)number;
	return 0;
}

/* Mode 3 and 1 MHz suit all chips. */
int spi_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	char *rest = args, *option, name[48];
	struct i2c_imu_config config = {.name = name};
	struct spi_args spi = {.options = {.mode = 3, .speed_hz = 1000000}};
	struct i2c_bus *bus;
	int result;

	while ((option = strsep(&rest, ",")))
		if (parse_spi(option, &spi, &config) < 0) {
			snprintf(error, error_size, "spi: '%.40s': use " SPI_SYNTAX, option);
			return -EINVAL;
		}
	if (spi.count == 0) {
		snprintf(error, error_size, "spi: no device: use " SPI_SYNTAX);
		return -EINVAL;
	}
	if (!port)
		return 0;
	snprintf(name, sizeof name, "spi:%.40s", spi.paths[0]);
	result = spi_dev_open(spi.paths, spi.count, &spi.options, &bus, error, error_size);
	if (result < 0)
		return result;
	return start_delivered(bus, &config, settings, port, error, error_size);
}

#include "drivers/ports/imu.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/source.h"
#include "drivers/ports/sources.h"

static const struct source {
	const char *name; /* up to the ':' */
	const char *syntax, *description;
	int (*open)(char *args, const struct imu_settings *settings, struct imu_port **port, char *error,
		size_t error_size);
} SOURCES[] = {
	{"sim", SIM_SYNTAX,
		"a simulated Pololu IMU 9, read by the real driver register by register, on a simulated robot",
		sim_open},
	{"replay", REPLAY_SYNTAX, "an IMU log, in real time or X times as fast", replay_open},
	{"i2c", I2C_SYNTAX,
		"a Pololu IMU 9, v0 to v6, LSM9DS1, ICM-20948, ICM-42688-P or BMI270, by its registers; it is detected",
		i2c_open},
	{"spi", SPI_SYNTAX, "the same, as far as they have SPI; with several devices, the magnetometer has its own",
		spi_open},
	{"iio", IIO_SYNTAX, "the kernel's IIO drivers: gyro, accelerometer and magnetometer, found by their channels",
		iio_open},
	{"wt901", WT901_SYNTAX, "a WitMotion WT901C-485, over Modbus RTU", wt901_open},
};
enum { SOURCE_COUNT = sizeof SOURCES / sizeof *SOURCES };

void imu_print_sources(FILE *out)
{
	for (size_t i = 0; i < SOURCE_COUNT; i++)
		fprintf(out, "  %s\n      %s\n", SOURCES[i].syntax, SOURCES[i].description);
}

static int refuse(const char *name, char *error, size_t error_size)
{
	int used = snprintf(error, error_size, "unknown IMU source '%.20s': use one of", name);

	for (size_t i = 0; i < SOURCE_COUNT && (size_t)used < error_size; i++)
		used += snprintf(error + used, error_size - (size_t)used, "%s %s", i ? "," : "", SOURCES[i].syntax);
	return -EINVAL;
}

int source_positive(const char *text, double *value)
{
	char *end;

	*value = strtod(text, &end);
	return end != text && *end == '\0' && isfinite(*value) && *value > 0 ? 0 : -EINVAL;
}

static const struct source *find(const char *name)
{
	for (size_t i = 0; i < SOURCE_COUNT; i++)
		if (strcmp(name, SOURCES[i].name) == 0)
			return &SOURCES[i];
	return NULL;
}

int imu_open(
	const char *src, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	const struct imu_settings defaults = IMU_SETTINGS_DEFAULTS;
	char text[4096], *args = text, *name;
	const struct source *source;
	int result;

	if ((size_t)snprintf(text, sizeof text, "%s", src) >= sizeof text) {
		snprintf(error, error_size, "the IMU source is too long: use at most %zu characters", sizeof text - 1);
		return -EINVAL;
	}
	name = strsep(&args, ":");
	source = find(name);
	if (!source)
		return refuse(name, error, error_size);
	error[0] = '\0';
	result = source->open(args, settings ? settings : &defaults, port, error, error_size);
	if (result < 0 && error[0] == '\0') /* out of memory or descriptors: the driver had nothing to add */
		snprintf(error, error_size, "%s: %s", name, strerror(-result));
	return result;
}

uint64_t source_silence_us(double rate_hz)
{
	return (uint64_t)fmax(1e5, 10e6 / rate_hz);
}

void source_use_rate(struct imu_port *port, double rate_hz)
{
	port->rate_hz = rate_hz;
	port->silence_us = source_silence_us(rate_hz);
}

int imu_read(struct imu_port *port, struct imu_sample *sample)
{
	return port->ops->read(port, sample);
}

void imu_close(struct imu_port *port)
{
	if (port)
		port->ops->close(port);
}

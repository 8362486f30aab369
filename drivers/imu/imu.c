#include "drivers/ports/imu.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/source.h"

static const struct source {
	const char *name;
	int (*open)(char *args, const struct imu_settings *settings, struct imu_port **port, char *error,
		size_t error_size);
} SOURCES[] = {{"sim", sim_open}, {"replay", replay_open}, {"i2c", i2c_open}, {"iio", iio_open}, {"wt901", wt901_open}};

int source_positive(const char *text, double *value)
{
	char *end;

	*value = strtod(text, &end);
	return end != text && *end == '\0' && isfinite(*value) && *value > 0 ? 0 : -EINVAL;
}

static const struct source *find(const char *name)
{
	for (size_t i = 0; i < sizeof SOURCES / sizeof *SOURCES; i++)
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
		snprintf(error, error_size, "IMU source longer than %zu characters", sizeof text - 1);
		return -EINVAL;
	}
	name = strsep(&args, ":");
	source = find(name);
	if (!source) {
		snprintf(error, error_size,
			"unknown IMU source '%.40s': use sim[:SCENARIO[,rate=HZ][,board=B]], "
			"replay:FILE.imu.csv[,loop][,speed=X], i2c:/dev/i2c-N[,drdy=GPIOCHIP:LINE][,stub], "
			"iio[:DEVICE,...] or wt901:/dev/ttyX[,baud=9600][,address=0x50]",
			name);
		return -EINVAL;
	}
	error[0] = '\0';
	result = source->open(args, settings ? settings : &defaults, port, error, error_size);
	if (result < 0 && error[0] == '\0') /* memory or descriptors are short: nothing the driver could add */
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

/* A simulated IMU: a scenario of model/signal seen by a calibrated sensor of model/sensor, in real
 * time, for ever. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/pace.h"
#include "drivers/imu/source.h"
#include "model/sensor.h"

static const char PRESET[] = "lsm303dlhc_l3gd20";
enum { SEED = 1 };
/* from the robot's reference point to the sensor: the seed's 5 cm */
static const struct vec3 LEVER_ARM_B_M = {0.05, 0, 0};

struct sim {
	struct imu_port port;
	struct pace pace;
	const struct signal *signal;
	struct sensor sensor;
};

static int sim_read(struct imu_port *port, struct imu_sample *sample)
{
	struct sim *sim = (struct sim *)port;
	double interval_ns = 1e9 / port->rate_hz;
	int64_t late_ns = pace_since(&sim->pace, (int64_t)((double)sim->sensor.taken * interval_ns));

	if (late_ns < 0)
		return 0;
	sensor_next(&sim->sensor, sim->signal, sample, NULL);
	port->counters.samples++;
	if ((double)late_ns > interval_ns)
		port->counters.late++;
	return 1;
}

static void sim_close(struct imu_port *port)
{
	struct sim *sim = (struct sim *)port;

	pace_stop(&sim->pace);
	free(sim);
}

static const struct imu_ops SIM_OPS = {.read = sim_read, .close = sim_close};

static void scenarios(char *text, size_t size)
{
	size_t n = 0;

	for (const struct signal *s = SIGNALS; s->name && n < size; s++)
		n += (size_t)snprintf(text + n, size - n, "%s%s", n ? ", " : "", s->name);
}

int sim_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	struct sensor_config config = *sensor_preset(PRESET);
	char *options = args, *name = strsep(&options, ",");
	const struct signal *signal = name && *name ? signal_find(name) : &SIGNALS[0];
	struct sim *sim;
	int result;

	(void)settings;
	if (!signal) {
		char known[160];

		scenarios(known, sizeof known);
		snprintf(error, error_size, "sim: unknown scenario '%.40s': use one of %s", name, known);
		return -EINVAL;
	}
	if (options && (strncmp(options, "rate=", 5) != 0 || source_positive(options + 5, &config.rate_hz) < 0 ||
			       config.rate_hz < 1 || config.rate_hz > 10000)) {
		snprintf(error, error_size, "sim: '%.40s': use rate=HZ, 1 to 10000", options);
		return -EINVAL;
	}
	sim = calloc(1, sizeof *sim);
	if (!sim)
		return -ENOMEM;
	sensor_calibrate(&config);
	config.lever_arm_b_m = LEVER_ARM_B_M;
	result = sensor_init(&sim->sensor, &config, SEED);
	if (result == 0)
		result = pace_start(&sim->pace);
	if (result < 0) {
		free(sim);
		return result;
	}
	sim->signal = signal;
	sim->port = (struct imu_port){
		.ops = &SIM_OPS,
		.fd = sim->pace.fd,
		.rate_hz = config.rate_hz,
		.silence_us = source_silence_us(config.rate_hz),
	};
	snprintf(sim->port.name, sizeof sim->port.name, "sim:%s", signal->name);
	*port = &sim->port;
	return 0;
}

/* tests/rig/i2c_check.c
 * i2c_check SRC SCENARIO START_US SECONDS: reads SRC, whose chips measure SCENARIO from START_US on (printed by
 * i2c_feed), and compares each sample with the motion at its time. Prints the RMS errors; status 0 when they are within
 * the limits for the digits and the feeder's delay of 1 ms, and there was no fault. */
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>

#include "drivers/ports/imu.h"
#include "model/sim/sensor.h"

/* RMS limits: rad/s, m/s^2, uT */
#define GYRO_LIMIT  0.03
#define ACCEL_LIMIT 0.15
#define MAG_LIMIT   1.0

enum { SETTLE = 200 };

struct error {
	double squares;
	unsigned n;
};

static void add(struct error *e, struct vec3 a, struct vec3 b)
{
	const struct vec3 d = vec3_sub(a, b);

	e->squares += vec3_dot(d, d);
	e->n++;
}

static double rms(const struct error *e)
{
	return e->n ? sqrt(e->squares / e->n) : INFINITY;
}

int main(int argc, char **argv)
{
	const struct sensor_config *ideal = sensor_preset("ideal");
	const struct signal *signal = argc == 5 ? signal_find(argv[2]) : NULL;
	struct error gyro = {0}, accel = {0}, mag = {0};
	double late = 0, alpha = 0; /* for a least-squares fit of the gyro's delay */
	unsigned samples = 0, faults = 0;
	struct imu_sample sample;
	struct signal_truth truth;
	struct imu_port *port;
	char why[256];

	if (!signal || imu_open(argv[1], NULL, &port, why, sizeof why) < 0) {
		fprintf(stderr, "i2c_check: %s\n", signal ? why : "SRC SCENARIO START_US SECONDS");
		return 2;
	}
	while (samples < SETTLE + (unsigned)(atof(argv[4]) * port->rate_hz)) {
		struct pollfd fd = {port->fd, POLLIN, 0};
		int result = poll(&fd, 1, 2000) == 1 ? imu_read(port, &sample) : -1;

		faults += result < 0;
		if (result < 0 && faults > 3)
			break;
		if (result <= 0 || ++samples <= SETTLE)
			continue;
		signal_at(signal, 1e-6 * ((double)sample.t_us - atof(argv[3])), &truth);
		late += vec3_dot(vec3_sub(truth.omega_b_rad_s, sample.gyro_rad_s), truth.alpha_b_rad_s2);
		alpha += vec3_dot(truth.alpha_b_rad_s2, truth.alpha_b_rad_s2);
		add(&gyro, sample.gyro_rad_s, truth.omega_b_rad_s);
		add(&accel, sample.accel_m_s2,
			sensor_specific_force(&truth, ideal->lever_arm_b_m, ideal->gravity_m_s2));
		if (sample.flags & SAMPLE_MAG)
			add(&mag, sample.mag_uT, quat_rotate_inverse(truth.q_nb, ideal->field_n_uT));
	}
	printf("%s: %u samples, %u faults, %.1f Hz; RMS errors: gyro %.4f rad/s, accelerometer %.3f m/s^2, "
	       "magnetometer "
	       "%.2f uT; %.1f ms late\n",
		port->name, samples, faults, (double)port->health.rate_hz, rms(&gyro), rms(&accel), rms(&mag),
		1e3 * late / alpha);
	imu_close(port);
	return faults || rms(&gyro) > GYRO_LIMIT || rms(&accel) > ACCEL_LIMIT || rms(&mag) > MAG_LIMIT;
}

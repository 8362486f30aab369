#include "drivers/imu/pololu/board.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>

/* A value of the data sheet is enough from this share of the requested one on: 95 Hz for 100, 245 deg/s for 250. */
#define NEARLY 0.94

static const struct chip_rate *choose_rate(const struct chip *chip, double hz, bool or_fastest)
{
	const struct chip_rate *r = chip->rates;

	while (r->hz > 0 && r->hz < hz * NEARLY)
		r++;
	if (r->hz > 0)
		return r;
	return or_fastest ? r - 1 : NULL;
}

/* Chooses the narrowest bandwidth that is enough, or the widest. */
static void choose_bandwidth(struct chip_setup *setup, double hz)
{
	const double *all = setup->rate->bandwidth_hz;
	int best = 0;

	for (int i = 1; i < CHIP_BANDWIDTHS && all[i] > 0; i++)
		if (all[best] < hz * NEARLY ? all[i] > all[best] : all[i] >= hz * NEARLY && all[i] < all[best])
			best = i;
	setup->bandwidth_code = (uint8_t)best;
	setup->bandwidth_hz = all[best];
}

struct request {
	const char *what, *unit;
	double value;
};

static struct request request_of(enum imu_chip what, const struct imu_settings *settings)
{
	switch (what) {
	case IMU_CHIP_GYRO:
		return (struct request){"gyro", "deg/s", settings->gyro_range_deg_s};
	case IMU_CHIP_ACCEL:
		return (struct request){"accelerometer", "g", settings->accel_range_g};
	case IMU_CHIP_MAG:
		break;
	}
	return (struct request){"magnetometer", "uT", settings->mag_range_uT};
}

static int choose_ranges(const struct stream *s, const struct imu_settings *settings, struct chip_setup *setup,
	char *error, size_t error_size)
{
	for (size_t i = 0; i < s->chip->triad_count; i++) {
		struct request wanted = request_of(s->chip->triads[i].what, settings);
		const struct chip_range *r = s->chip->triads[i].ranges;

		while (r->full_scale > 0 && !(r->full_scale >= wanted.value * NEARLY))
			r++;
		if (r->full_scale > 0) {
			setup->range[i] = r;
			continue;
		}
		snprintf(error, error_size, "%s range %g %s: the %s has at most %g", wanted.what, wanted.value,
			wanted.unit, s->chip->name, (r - 1)->full_scale);
		return -EINVAL;
	}
	return 0;
}

/* Faster than the gyro where possible: less to interpolate, and less to wait for. Not below 400 Hz, where coarse digits
 * repeat too often to detect frozen data in time. */
static double accel_rate(double gyro_hz)
{
	return fmax(2 * gyro_hz, 400);
}

int board_plan(const struct board *b, const struct imu_settings *settings, bool stub, bool data_ready,
	struct board_plan *plan, char *error, size_t error_size)
{
	const struct chip_rate *gyro = choose_rate(b->gyro->chip, settings->rate_hz, false);
	double bandwidth_hz;

	if (!gyro || !(settings->rate_hz > 0)) {
		const struct chip_rate *fastest = choose_rate(b->gyro->chip, INFINITY, true);

		snprintf(error, error_size, "sensor rate %g Hz: the %s has at most %g Hz", settings->rate_hz,
			b->gyro->chip->name, fastest->hz);
		return -EINVAL;
	}
	*plan = (struct board_plan){.settings = *settings, .rate_hz = gyro->hz};
	bandwidth_hz = settings->bandwidth_hz > 0 ? settings->bandwidth_hz : gyro->hz / 2;
	for (size_t i = 0; i < b->stream_count; i++) {
		const struct stream *s = &b->streams[i];
		struct chip_setup *setup = &plan->setup[i];

		setup->rate = s == b->gyro    ? gyro
			      : s == b->accel ? choose_rate(s->chip, accel_rate(gyro->hz), true)
					      : choose_rate(s->chip, INFINITY, true);
		setup->stub = stub;
		setup->spi = b->bus->spi;
		setup->fifo = !stub && s->chip->fifo != CHIP_NO_FIFO;
		setup->data_ready = data_ready && s == b->gyro;
		choose_bandwidth(setup, bandwidth_hz);
		if (choose_ranges(s, settings, setup, error, error_size) < 0)
			return -EINVAL;
	}
	return 0;
}

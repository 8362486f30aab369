#include "gateway/angle_filter.h"

#include <math.h>

enum { GAP_US = 1000000 };

static double step(double from_rad, double to_rad, double gain)
{
	return remainder(from_rad + gain * remainder(to_rad - from_rad, 2 * M_PI), 2 * M_PI);
}

struct vec3 angle_filter_step(struct angle_filter *filter, double cutoff_hz, uint64_t t_us, struct vec3 angles_rad)
{
	uint64_t interval_us = t_us - filter->t_us;

	if (!filter->running || cutoff_hz <= 0 || interval_us > GAP_US) {
		filter->angles_rad = angles_rad;
	} else {
		double gain = 1 - exp(-2 * M_PI * cutoff_hz * (double)interval_us / 1e6);
		struct vec3 *y = &filter->angles_rad;

		*y = (struct vec3){
			step(y->x, angles_rad.x, gain), step(y->y, angles_rad.y, gain), step(y->z, angles_rad.z, gain)};
	}
	filter->running = true;
	filter->t_us = t_us;
	return filter->angles_rad;
}

#include "gateway/slope_range.h"

#include <math.h>

#include "gateway/publish.h"

#define CLEAR_BELOW 0.98 /* of the range: hysteresis, so that a slope at the limit does not set and clear the error */

static void check(
	struct canopen_node *node, uint16_t code, double slope_deg, double range_deg, bool clipped, uint64_t now_us)
{
	bool beyond = range_deg > 0 && fabs(slope_deg) > range_deg;
	bool within = range_deg == 0 || fabs(slope_deg) <= CLEAR_BELOW * range_deg;

	if (clipped || beyond)
		canopen_error_set(node, code, ERROR_PROFILE, NULL, now_us);
	else if (within)
		canopen_error_clear(node, code, now_us);
}

void slope_range_check(struct canopen_node *node, const struct od_values *values, unsigned clipped, uint64_t now_us)
{
	check(node, EMCY_SLOPE_LONG, (double)values->angles_deg.pitch, (double)values->slope_range.longitudinal,
		clipped & PUBLISH_CLIPPED_LONG, now_us);
	check(node, EMCY_SLOPE_LATERAL, (double)values->angles_deg.roll, (double)values->slope_range.lateral,
		clipped & PUBLISH_CLIPPED_LATERAL, now_us);
}

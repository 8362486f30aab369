#include "gateway/threshold.h"
#include "od_index.h"

#include <math.h>
#include <string.h>

/* One step of a scaled output, as publish.c has it. */
static double step_of(const struct od_values *v, const struct od_entry *entry)
{
	switch (entry->index) {
	case OD_INDEX_ACCELERATION:
		return v->resolution.acceleration * 0.001;
	case OD_INDEX_POSITION_OUTPUT:
		return v->resolution.position * 0.001;
	case OD_INDEX_ANGLES:
	case OD_INDEX_SLOPE_LONG16:
	case OD_INDEX_SLOPE_LATERAL16:
	case OD_INDEX_SLOPE_LONG32:
	case OD_INDEX_SLOPE_LATERAL32:
		return v->angle_resolution * 0.001;
	default:
		return entry->factor;
	}
}

double threshold_of(const struct od_values *v, const struct od_entry *entry)
{
	const struct {
		const char *unit;
		float threshold;
	} kinds[] = {{"m/s^2", v->change_threshold.acceleration}, {"deg", v->change_threshold.angle},
		{"rad/s", v->change_threshold.angular_rate}, {"m/s", v->change_threshold.velocity},
		{"m", v->change_threshold.position}};

	if (entry->index == OD_INDEX_SAMPLE && entry->sub != 3) /* counter and time are never the same */
		return INFINITY;
	for (size_t i = 0; i < sizeof(kinds) / sizeof(kinds[0]); i++)
		if (strcmp(entry->unit, kinds[i].unit) == 0)
			return (double)kinds[i].threshold / step_of(v, entry);
	return 0;
}

#include "gateway/threshold.h"

#include <math.h>
#include <string.h>

#include "od_values.h"

double threshold_of(const struct od *od, const struct od_entry *entry)
{
	const struct od_values *v = od->values;
	const struct {
		const char *unit;
		float threshold;
	} kinds[] = {{"m/s^2", v->change_threshold.acceleration}, {"deg", v->change_threshold.angle},
		{"rad/s", v->change_threshold.angular_rate}, {"m/s", v->change_threshold.velocity},
		{"m", v->change_threshold.position}};

	/* counter and time change with each sample */
	if ((entry->index == OD_INDEX_SAMPLE && entry->sub != 3) || entry->index == OD_INDEX_HIGH_RESOLUTION_TIME_STAMP)
		return INFINITY;
	for (size_t i = 0; i < sizeof(kinds) / sizeof(kinds[0]); i++)
		if (strcmp(entry->unit, kinds[i].unit) == 0)
			return (double)kinds[i].threshold / od_step(od, entry);
	return 0;
}

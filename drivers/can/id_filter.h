/* drivers/can/id_filter.h
 * A filter for 11-bit identifiers, for buses whose adapter does not filter. */
#ifndef DRIVERS_CAN_ID_FILTER_H
#define DRIVERS_CAN_ID_FILTER_H

#include <string.h>

#include "drivers/ports/can.h"

struct id_filter {
	bool on; /* false: all frames pass, 29-bit ones too */
	uint32_t wanted[2048 / 32];
};

/** As can_filter(). */
static inline void id_filter_set(struct id_filter *filter, const uint32_t *ids, size_t n)
{
	memset(filter, 0, sizeof(*filter));
	filter->on = n > 0;
	for (size_t i = 0; i < n; i++)
		filter->wanted[ids[i] % 2048 / 32] |= 1u << ids[i] % 32;
}

static inline bool id_filter_wants(const struct id_filter *filter, const struct can_msg *msg)
{
	return !filter->on || (!msg->extended && (filter->wanted[msg->id / 32] >> msg->id % 32 & 1) != 0);
}

#endif

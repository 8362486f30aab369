/* gateway/canopen/deadline.h
 * Deadlines: the time at which a passive part (the core, the device, a client) must be called again at the latest. All
 * are in us of one monotonic clock; UINT64_MAX means that nothing is due. */
#ifndef GATEWAY_CANOPEN_DEADLINE_H
#define GATEWAY_CANOPEN_DEADLINE_H

#include <stdint.h>

static inline uint64_t earlier(uint64_t a_us, uint64_t b_us)
{
	return a_us < b_us ? a_us : b_us;
}

static inline uint64_t later(uint64_t a_us, uint64_t b_us)
{
	return a_us > b_us ? a_us : b_us;
}

#endif

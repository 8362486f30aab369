/* tests/scenario/browsers.h
 * imu9-web without its network and a whole device in simulated time, and browsers that come, ask for anything that a
 * browser can ask for, read fast, slowly or not at all, and go, also in the middle of a transfer. The device is reset,
 * becomes another one by its identity, so that its EDS is read again, and is switched off for some seconds in each
 * minute. At the end of each minute all browsers have gone: then no more memory is in use than before. */
#ifndef TESTS_SCENARIO_BROWSERS_H
#define TESTS_SCENARIO_BROWSERS_H

#include <stddef.h>
#include <stdint.h>

enum { BROWSERS_WARM_UP = 5 }; /* minutes */

struct browsers_count {
	unsigned connections, requests, answers, refusals; /* answers: those without a refusal */
	unsigned eds_read;				   /* the EDS from 1021h */
	unsigned lost;					   /* the device was found to be gone */
	double megabytes;				   /* of messages to browsers */
	size_t heap; /* bytes in use when all browsers had gone, after the warm-up */
	size_t peak; /* while they were there, at any time */
	/* The largest difference of later minutes: 0 with GLIBC_TUNABLES=glibc.malloc.tcache_count=0, else what
	 * malloc() keeps for quick use is among it. */
	size_t grown;
};

/** Fails (cmocka's assertions) when a browser or the device does what it must not. */
struct browsers_count browsers(unsigned minutes, uint64_t seed);

#endif

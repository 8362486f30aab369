/* tests/bench/bus_end.h
 * What the benchmarks on the udp bus share: a master's end of the bus that receives one kind of frame, medians, and the
 * processor to run on. The same end of a CAN interface. Times are us of CLOCK_MONOTONIC. */
#ifndef TESTS_BENCH_BUS_END_H
#define TESTS_BENCH_BUS_END_H

#include <netinet/in.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"

struct end {
	int fd;
	bool can;
	struct sockaddr_in group; /* of udp */
};

/** Ends the program with the text of errno. */
_Noreturn void fail(const char *what);
double now_us(void);
void use_processor(unsigned number);

enum { END_SENDS = 0 /* and receives nothing */, END_RECEIVES_ALL = 0x800 }; /* in place of a mask */

/** On the interface lo. The kernel drops all frames but those whose identifier is `id` under this mask, so that others
 * do not delay the master. The bits of the mask include 700h, or the identifier is below 100h. */
struct end open_end(const char *group, uint16_t port, uint32_t id, uint32_t mask);
/** The same on a CAN interface, for any identifier. */
struct end open_can_end(const char *interface, uint32_t id, uint32_t mask);
void put_bytes(const struct end *end, const void *bytes, size_t size);
void put(const struct end *end, uint32_t id, const void *data, size_t len);
/** False: nothing was received for so long. */
bool get(const struct end *end, struct can_msg *msg, int timeout_ms);
/** Returns the number of frames that were waiting. */
unsigned drain(const struct end *end);

/** Sorts; the value below which this part (0 to 1) of them is. */
double quantile(double *values, size_t count, double part);

#endif

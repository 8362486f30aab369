/* A simulated libgpiod with one chip, gpiochip3, and one line of it. gpiod1_stub.c defines the functions of version 1,
 * gpiod2_stub.c those of version 2; the Makefile links the one whose headers are installed. */
#ifndef TESTS_UNIT_GPIOD_STUB_H
#define TESTS_UNIT_GPIOD_STUB_H

#include <stdbool.h>
#include <stdint.h>

enum { GPIOD_STUB_LINE = 17, GPIOD_STUB_FD = 1000 };

extern struct gpiod_stub {
	/* set by the test */
	bool no_chip, no_line, busy; /* ENOENT, EINVAL, EBUSY */
	int64_t edge_ns;

	/* counted */
	int open_objects; /* what libgpiod has allocated */
	unsigned requests, events_read;
} gpiod_stub;

#endif

/* drivers/can/bus_options.h
 * The options of a BUS whose adapter this process sets up itself: ,bitrate=B ,sample-point=0.875 ,listen-only */
#ifndef DRIVERS_CAN_BUS_OPTIONS_H
#define DRIVERS_CAN_BUS_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { BUS_ADDRESS_MAX = 200, BUS_BIT_RATE_DEFAULT = 500000 };

struct bus_options {
	char address[BUS_ADDRESS_MAX];
	uint32_t bit_s;
	uint32_t sample_point_permille; /* 0: chosen by the bit rate */
	bool listen_only;		/* neither acknowledges nor sends */
};

/** Splits `text` at the commas. 0; -EINVAL and a reason: an unknown option, a value out of range. */
int bus_options_parse(struct bus_options *options, const char *text, char *error, size_t error_size);

#endif

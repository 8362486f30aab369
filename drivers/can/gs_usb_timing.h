/* drivers/can/gs_usb_timing.h
 * Bit timing of a CAN controller: prescaler and time segments for a bit rate and a sample point. Pure. */
#ifndef DRIVERS_CAN_GS_USB_TIMING_H
#define DRIVERS_CAN_GS_USB_TIMING_H

#include "drivers/can/can_link.h"

/* In time quanta of brp / clock. One bit is 1 + prop + seg1 + seg2 quanta, sampled at the end of seg1. */
struct bit_timing {
	uint32_t prop, seg1, seg2, sjw, brp;
};

/** The sample point [permille of a bit] of CiA 301 and the kernel: 875, above 500 kbit/s 800, above 800 kbit/s 750. */
uint32_t bit_timing_sample_point(uint32_t bit_s);

/** The timing nearest to the bit rate, then to the sample point, then with the most time quanta. `sjw_max`: limit of
 * the controller; at most half of seg2 is used. 0; -EOPNOTSUPP: no setting is within 0.5 % of the bit rate. */
int bit_timing_find(const struct can_link_limits *limits, uint32_t sjw_max, uint32_t bit_s,
	uint32_t sample_point_permille, struct bit_timing *timing);

#endif

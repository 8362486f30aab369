/* gateway/slope_range.h
 * EMCY 5010h and 5020h of CiA 410: the longitudinal or the lateral slope is out of its range (2119h, deg). One thread.
 * */
#ifndef GATEWAY_SLOPE_RANGE_H
#define GATEWAY_SLOPE_RANGE_H

#include <stdint.h>

#include "gateway/canopen/canopen.h"
#include "od_values.h"

/** After each publish_sample(). `clipped`: what it returned. */
void slope_range_check(struct canopen_node *node, const struct od_values *values, unsigned clipped, uint64_t now_us);

#endif

/* gateway/threshold.h
 * What counts as a change of a value (2118h), for TPDOs by event. */
#ifndef GATEWAY_THRESHOLD_H
#define GATEWAY_THRESHOLD_H

#include "od/od.h"

/** As canopen_device.change_threshold() wants it: in steps of an integer, in the unit of a real. Which threshold is that
 * of an object its unit says. */
double threshold_of(const struct od *od, const struct od_entry *entry);

#endif

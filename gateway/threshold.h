/* gateway/threshold.h
 * The change of a value that triggers an event-driven TPDO (2118h). */
#ifndef GATEWAY_THRESHOLD_H
#define GATEWAY_THRESHOLD_H

#include "od/od.h"

/** For canopen_device.change_threshold(): in steps for an integer, in its unit for a REAL. The unit of an object
 * selects its threshold; 0: every change, INFINITY: no change triggers. */
double threshold_of(const struct od *od, const struct od_entry *entry);

#endif

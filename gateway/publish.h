/* gateway/publish.h
 * From the pipeline's output to the objects that PDOs and SDO clients see: units, scaling,
 * saturation; and the CiA 410 inclinometer objects. */
#ifndef GATEWAY_PUBLISH_H
#define GATEWAY_PUBLISH_H

#include <stdint.h>

#include "gateway/status.h"
#include "model/pipeline.h"
#include "od_values.h"

enum { PUBLISH_CLIPPED_LONG = 1 << 0, PUBLISH_CLIPPED_LATERAL = 1 << 1 };

/** Writes everything that one sample says, at once. `counter`: 0 for the first sample, wraps at
 * 65536. Returns PUBLISH_CLIPPED_... for each slope of CiA 410 that its objects cannot hold. */
unsigned publish_sample(struct od *od, const struct pipeline_output *out, uint16_t counter);

/** The sensor has stopped: the values stand, the status says that they are old. */
void publish_sensor_lost(struct od_values *values);

/** CiA 410: 6012h, 6022h, 6112h or 6122h (`index`) was written: the offset that makes the slope
 * read the preset now. */
void publish_preset(struct od *od, uint16_t index);

#endif

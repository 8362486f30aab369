/* gateway/publish.h
 * From the pipeline's output to the objects that PDOs and SDO clients read: units, scaling, saturation; and the
 * inclinometer objects of CiA 410. One thread. */
#ifndef GATEWAY_PUBLISH_H
#define GATEWAY_PUBLISH_H

#include <stdint.h>

#include "gateway/status.h"
#include "model/pipeline.h"
#include "od_values.h"

enum { PUBLISH_CLIPPED_LONG = 1 << 0, PUBLISH_CLIPPED_LATERAL = 1 << 1 };

/** Writes all objects of one sample. `counter`: 0 for the first sample, wraps at 65536. Returns PUBLISH_CLIPPED_... for
 * each slope of CiA 410 that exceeds the range of its objects. */
unsigned publish_sample(struct od *od, const struct pipeline_output *out, uint16_t counter);

/** No samples: the values stay, the status word marks them invalid. */
void publish_sensor_lost(struct od_values *values);

/** CiA 410: 6012h, 6022h, 6112h or 6122h (`index`) was written. Computes the offset that makes the present slope equal
 * to the preset. */
void publish_preset(struct od *od, uint16_t index);

#endif

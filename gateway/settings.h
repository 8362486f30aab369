/* gateway/settings.h
 * The configuration objects (2000h to 2054h) as configuration of the pipeline, converted from their units to SI. The
 * gateway and the tools share it, so that they compute the same. Pure. */
#ifndef GATEWAY_SETTINGS_H
#define GATEWAY_SETTINGS_H

#include <stdbool.h>

#include "model/pipeline.h"
#include "od/od.h"
#include "od_values.h"

struct pipeline_config settings_pipeline(const struct od_values *values);

/** Whether these objects, each within its limits, agree with one another, at the rate of 2058h. */
bool settings_valid(const struct od_values *values);
/** PIPELINE_UNCALIBRATED_... of the sensors that nobody calibrated, by 2055h; where that is automatic, by 2050h to
 * 2052h and the word of the source (imu_port.uncalibrated). settings_pipeline() takes the source for calibrated. */
unsigned settings_uncalibrated(const struct od_values *values, unsigned source);

/** Writes REAL32 values to the sub-indices 1 to `count` of an object: all of them and OD_OK, or none and the reason. */
enum od_status settings_write(struct od *od, uint16_t index, const float *values, uint8_t count);

#endif

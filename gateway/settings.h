/* gateway/settings.h
 * What the configuration objects (2000h-2053h) mean to the pipeline: from their units to SI. Used
 * by the gateway and by imu9-replay, so that both compute the same. */
#ifndef GATEWAY_SETTINGS_H
#define GATEWAY_SETTINGS_H

#include "model/pipeline.h"
#include "od/od.h"
#include "od_values.h"

struct pipeline_config settings_pipeline(const struct od_values *values);

/** Writes REAL32 values to the sub-indices 1 to `count` of an object: all of them, or none and why. */
enum od_status settings_write(struct od *od, uint16_t index, const float *values, uint8_t count);

#endif

/* gateway/settings.h
 * What the configuration objects (2000h-2053h) mean to the pipeline: from their units to SI. Used
 * by the gateway and by imu9-replay, so that both compute the same. */
#ifndef GATEWAY_SETTINGS_H
#define GATEWAY_SETTINGS_H

#include "model/pipeline.h"
#include "od_values.h"

struct pipeline_config settings_pipeline(const struct od_values *values);

#endif

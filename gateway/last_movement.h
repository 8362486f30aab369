/* gateway/last_movement.h
 * The movement last ended as objects: 211Ah is its summary, 2132h its smoothed path as CSV text, which a spreadsheet opens:
 * t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,sx_m,sy_m,sz_m, a line for each point; no line before the first movement. */
#ifndef GATEWAY_LAST_MOVEMENT_H
#define GATEWAY_LAST_MOVEMENT_H

#include "model/pipeline.h"
#include "model/smoother.h"
#include "od/od.h"
#include "od_values.h"

/** Caller-owned. */
struct last_movement {
	struct smoother smoother;
	struct od_domain domain;
	struct od_values *values;
};

/** The objects are there from now on. */
void last_movement_attach(struct last_movement *m, struct od *od, struct od_values *values);
/** There was no movement yet; those of the pipeline will be followed. */
void last_movement_start(struct last_movement *m, struct pipeline *pipeline);
/** After each sample. */
void last_movement_publish(struct last_movement *m);

#endif

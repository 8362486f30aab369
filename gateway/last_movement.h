/* gateway/last_movement.h
 * The last complete movement as objects: 211Ah is its summary, 2132h its smoothed path (global frame, 1 sigma) as CSV
 * text: t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,sx_m,sy_m,sz_m, and one line for each point; only this header before the
 * first movement. One thread. */
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

/** Attaches 2132h to the dictionary. */
void last_movement_attach(struct last_movement *m, struct od *od, struct od_values *values);
/** After pipeline_init(): no movement yet; the smoother records those of the pipeline. */
void last_movement_start(struct last_movement *m, struct pipeline *pipeline);
/** After each pipeline_step(): updates 211Ah. */
void last_movement_publish(struct last_movement *m);

#endif

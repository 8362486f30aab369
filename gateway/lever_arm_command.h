/* gateway/lever_arm_command.h
 * Identification of the lever arm by command (2060h): the result appears with 1 sigma and a verdict; "accept" writes it
 * to 2000h. The acceleration of the reference point (object frame, m/s^2) from an external sensor comes with the sample
 * (columns of a log) or by 2075h, from an RPDO or an SDO client. One thread.
 *
 * A value of 2075h is used from the next sample on, until the next write but for 50 ms at most. At 100 writes a second
 * it is 5 ms late on average, besides the delay of the bus; the identification estimates this delay. The steps between
 * writes are above its low-pass. The acceleration that comes with a sample is taken to be of the same instant. */
#ifndef GATEWAY_LEVER_ARM_COMMAND_H
#define GATEWAY_LEVER_ARM_COMMAND_H

#include "gateway/command_object.h"
#include "model/identify/lever_identification.h"
#include "model/pipeline.h"
#include "od/od.h"
#include "od_values.h"

struct lever_arm_command { /* PRIVATE */
	struct od *od;
	struct od_values *values;
	const struct pipeline *pipeline;
	struct command_object command;
	struct od_hook reference_hook;
	struct lever_identification lever;
	struct vec3 arm_b_m; /* 2060h:6 to 8, not rounded */
	bool started;	     /* the next sample is the first */
	uint64_t started_us;
	struct vec3 ref_b_m_s2; /* 2075h when its last component was written */
	bool ref_written;	/* since the last sample */
	uint64_t ref_until_us;
};

/** Attaches to the dictionary. */
void lever_arm_command_init(struct lever_arm_command *c, struct command_group *group, struct od *od,
	struct od_values *values, const struct pipeline *pipeline);
/** NMT reset: what runs is aborted, and there is no result. */
void lever_arm_command_reset(struct lever_arm_command *c);
/** A sample that the pipeline has just processed. */
void lever_arm_command_sample(struct lever_arm_command *c, const struct imu_sample *sample, uint64_t now_us);

#endif

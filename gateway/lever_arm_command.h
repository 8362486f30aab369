/* gateway/lever_arm_command.h
 * The lever arm finds itself (2060h): a command starts it, the result appears with its sigma and a verdict, and is taken
 * over into 2000h or left. The acceleration of the reference point from outside comes with the sample (a log's columns) or
 * by 2075h, from an RPDO or an SDO client.
 *
 * What was written to 2075h holds until the next write, 50 ms at most, as of the sample after the write: at 100 writes a
 * second that is 5 ms late in the mean, beside what the bus takes. The identification estimates this delay, so nobody
 * needs to know it; the steps are above its low-pass. What comes with the sample is believed to be of its instant. */
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
	struct vec3 arm_b_m; /* found: 2060h:6 to 8 before they are rounded */
	bool started;	     /* the next sample is the first */
	uint64_t started_us;
	struct vec3 ref_b_m_s2; /* 2075h as it was when complete */
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

/* gateway/lever_arm_um.h
 * 2004h: the lever arm 2000h in whole micrometres, for tools that write 0 for 0.05. 2000h is the only truth: a write to
 * 2004h is one to 2000h, and each change of 2000h shows in 2004h. Within the limits of 10 m every micrometre is a
 * different REAL32, so that what was written is read back. One thread. */
#ifndef GATEWAY_LEVER_ARM_UM_H
#define GATEWAY_LEVER_ARM_UM_H

#include "od/od.h"
#include "od_values.h"

/** Caller-owned. */
struct lever_arm_um {
	/* PRIVATE */
	struct od *od;
	struct od_values *values;
	struct od_hook hook;
};

void lever_arm_um_attach(struct lever_arm_um *twin, struct od *od, struct od_values *values);
/** The dictionary was set without its hooks (start, reset). */
void lever_arm_um_update(struct lever_arm_um *twin);

#endif

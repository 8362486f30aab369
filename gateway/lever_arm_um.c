#include "gateway/lever_arm_um.h"

#include <math.h>
#include <string.h>

#include "od/little_endian.h"
#include "od_index.h"

static int32_t um(float metres)
{
	return (int32_t)lround((double)metres * 1e6);
}

void lever_arm_um_update(struct lever_arm_um *twin)
{
	struct od_values *v = twin->values;

	v->lever_arm_in_um.l = um(v->lever_arm.l);
	v->lever_arm_in_um.s = um(v->lever_arm.s);
	v->lever_arm_in_um.t = um(v->lever_arm.t);
}

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct lever_arm_um *twin = ctx;
	float metres = (float)((double)(int32_t)get_u32(wire) * 1e-6);
	uint32_t bits;
	uint8_t real[4];

	(void)size;
	if (entry->index != OD_INDEX_LEVER_ARM_IN_UM)
		return OD_OK;
	memcpy(&bits, &metres, sizeof(bits));
	put_u32(real, bits);
	enum od_status status = od_write(twin->od, OD_INDEX_LEVER_ARM, entry->sub, real, sizeof(real));
	return status == OD_OK ? OD_CONSUMED : status;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	(void)entry;
	lever_arm_um_update(ctx);
}

void lever_arm_um_attach(struct lever_arm_um *twin, struct od *od, struct od_values *values)
{
	*twin = (struct lever_arm_um){.od = od, .values = values};
	twin->hook = (struct od_hook){.first = OD_INDEX_LEVER_ARM,
		.last = OD_INDEX_LEVER_ARM_IN_UM,
		.before = before_write,
		.after = after_write,
		.ctx = twin};
	od_attach(od, &twin->hook);
	lever_arm_um_update(twin);
}

#include "gateway/device_state.h"

#include <string.h>

#include "build_id.h"

_Static_assert(sizeof(void *) == sizeof(uintptr_t), "pointers are stored as offsets");

/* ---- pointers that device_init() sets ---------------------------------------------------------------------------- */

/* Members from `offset` on, in each of `count` elements of an array. */
struct kept {
	size_t offset, size, count, stride;
};

#define AT(member)   offsetof(struct device, member)
#define SIZE(member) sizeof(((const struct device *)0)->member)
#define END(member)  (AT(member) + SIZE(member))
#define KEEP(first, last)                              \
	{                                              \
		AT(first), END(last) - AT(first), 1, 0 \
	}
#define KEEP_IN(array, first, last)                                                                        \
	{                                                                                                  \
		AT(array[0].first), END(array[0].last) - AT(array[0].first), SIZE(array) / SIZE(array[0]), \
			SIZE(array[0])                                                                     \
	}

/* A pointer that is added to a struct of the device and missing here fails tests/scenario/test_record.c. */
static const struct kept KEPT[] = {
	KEEP(od, od),
	KEEP(latency, latency),
	KEEP(storing.od, storing.port),
	KEEP(pipeline.position.navigation.smoother, pipeline.position.navigation.smoother),
	KEEP(lever_arm_command.od, lever_arm_command.reference_hook),
	KEEP(calibration_command.od, calibration_command.command),
	KEEP(aids.hook, aids.pipeline),
	KEEP(sensor_watch.imu, sensor_watch.hook),
	KEEP(canopen.od, canopen.device),
	KEEP(canopen.listener, canopen.listener),
	KEEP(canopen.nmt.hook, canopen.nmt.startup),
	KEEP(canopen.heartbeat.hook, canopen.heartbeat.hook),
	KEEP_IN(canopen.heartbeat.consumer, value, value),
	KEEP(canopen.guard.time_ms, canopen.guard.life_factor),
	KEEP_IN(canopen.sdo_servers, buffer, buffer),
	KEEP(canopen.sdo_channels, canopen.sdo_channels),
	KEEP(canopen.pdos.hook, canopen.pdos.hook),
	KEEP_IN(canopen.pdos.rpdo, pdo.cob_id, pdo.mapped),
	KEEP_IN(canopen.pdos.tpdo, pdo.cob_id, pdo.mapped),
	KEEP(canopen.sync.hook, canopen.sync.counter_overflow),
	KEEP(canopen.emcy.cob_id_hook, canopen.emcy.history),
	KEEP(canopen.store.hook, canopen.store.hook),
	KEEP(canopen.store.date_hook, canopen.store.date),
	KEEP(canopen.lss.identity, canopen.lss.identity),
	KEEP(canopen.time.hook, canopen.time.cob_id),
	KEEP(bus_health.bus, bus_health.hook),
	KEEP(leds, leds),
	KEEP(utc.values, utc.node),
	KEEP(bus, eds),
	KEEP(log.domain, log.domain),
	KEEP(log.kinds, log.kinds),
	KEEP(snapshot.od, snapshot.domain),
	KEEP(last_movement.domain, last_movement.values),
	KEEP(pdo_preset.od, pdo_preset.value),
	KEEP(pdo_preset.command, pdo_preset.mapping),
	KEEP(lever_arm_um, lever_arm_um),
	KEEP(commands.on_event, commands.ctx),
	KEEP(procedure_log, procedure_log),
	KEEP(write_lock.storing, write_lock.state),
	KEEP(write_lock.hook, write_lock.hook),
	KEEP(record, record_hook),
};

static void copy_kept(uint8_t *to, const struct device *from)
{
	for (const struct kept *k = KEPT; k < KEPT + sizeof(KEPT) / sizeof(KEPT[0]); k++)
		for (size_t i = 0; i < k->count; i++) {
			size_t at = k->offset + i * k->stride;

			if (from)
				memcpy(to + at, (const uint8_t *)from + at, k->size);
			else
				memset(to + at, 0, k->size);
		}
}

/* ---- pointers that change ---------------------------------------------------------------------------------------- */

/* NULL, into the device, or the EDS: the only constant that an SDO transfer reads. */
static const size_t MOVING[] = {AT(commands.running), AT(canopen.sdo), AT(canopen.sdo_servers[0].data),
	AT(canopen.sdo_servers[1].data), AT(canopen.sdo_servers[2].data), AT(canopen.sdo_servers[3].data),
	AT(canopen.sdo_servers[4].data), AT(canopen.sdo_servers[5].data), AT(canopen.sdo_servers[6].data),
	AT(canopen.sdo_servers[7].data)};
_Static_assert(SDO_SERVERS == 8, "MOVING has one line for each");

static const uintptr_t OF_EDS = UINTPTR_MAX;

static uintptr_t to_offset(const struct device *d, uintptr_t pointer)
{
	if (pointer == 0)
		return 0;
	if (pointer - (uintptr_t)d < sizeof(*d))
		return 1 + pointer - (uintptr_t)d;
	return OF_EDS;
}

static uintptr_t to_pointer(const struct device *d, uintptr_t offset)
{
	if (offset == 0)
		return 0;
	return offset == OF_EDS ? (uintptr_t)d->eds.data : (uintptr_t)d + offset - 1;
}

static void convert(
	const struct device *d, uint8_t *bytes, uintptr_t (*conversion)(const struct device *d, uintptr_t value))
{
	for (size_t i = 0; i < sizeof(MOVING) / sizeof(MOVING[0]); i++) {
		uintptr_t value;

		memcpy(&value, bytes + MOVING[i], sizeof(value));
		value = conversion(d, value);
		memcpy(bytes + MOVING[i], &value, sizeof(value));
	}
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

const char *device_state_build(void)
{
	return BUILD_ID;
}

void device_state_save(const struct device *d, uint8_t *out)
{
	memcpy(out, d, sizeof(*d));
	copy_kept(out, NULL);
	convert(d, out, to_offset);
}

void device_state_load(struct device *d, uint8_t *saved)
{
	copy_kept(saved, d);
	convert(d, saved, to_pointer);
	memcpy(d, saved, sizeof(*d));
	canopen_restored(&d->canopen);
}

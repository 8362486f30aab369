/* gateway/write_lock.h
 * 214Ch: a lock against writes by mistake. Whoever writes a key into it locks the configuration; only the same key, or
 * `imu9-gateway --unlock` at the machine, opens it again. It is stored at once, so a power cut does not open it.
 *
 * Locked are all values that 1010h stores, 1010h and 1011h themselves, calibrations, mapping presets and snapshots,
 * from every side (SDO, RPDO, the other windows): abort code 06010002h. Inputs and commands of the running machine
 * remain (2070h to 2073h, resets, NMT), and so does a reload of the file, which is as local as --unlock. A key of 32
 * bits on a bus in clear text is no defence against an attacker. One thread. */
#ifndef GATEWAY_WRITE_LOCK_H
#define GATEWAY_WRITE_LOCK_H

#include "gateway/storing.h"
#include "od_values.h"

/** Caller-owned. */
struct write_lock {
	bool suspended; /* the process itself writes */
	/* PRIVATE */
	struct storing *storing;
	struct event_log *log;
	const uint64_t *now_us; /* of the present call of the device */
	uint8_t *state;
	uint64_t retry_us; /* after a wrong key */
	struct od_hook hook;
};

/** Before all other hooks: they would act on a write that is refused. */
void write_lock_attach(struct write_lock *lock, struct od *od, struct od_values *values, struct storing *storing,
	struct event_log *log, const uint64_t *now_us);
/** What is stored may have changed. */
void write_lock_update(struct write_lock *lock);

#endif

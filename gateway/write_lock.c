#include "gateway/write_lock.h"

#include "od/little_endian.h"
#include "od_index.h"

enum { OPEN = 0, LOCKED = 1, RETRY_US = 1000000 };

/* Commands that change or keep the configuration, and what takes it as a whole. */
static bool is_configuration(const struct od_entry *entry)
{
	switch (entry->index) {
	case OD_INDEX_STORE_PARAMETERS:
	case OD_INDEX_RESTORE_DEFAULTS:
	case OD_INDEX_LEVER_ARM_IN_UM:
	case OD_INDEX_LEVER_ARM_IDENTIFICATION:
	case OD_INDEX_CALIBRATION:
	case OD_INDEX_CONFIGURATION_SNAPSHOT:
	case OD_INDEX_PDO_PRESET:
		return true;
	default:
		return entry->access & OD_STORED;
	}
}

static enum od_status open_with(struct write_lock *lock, uint32_t key)
{
	if (*lock->now_us < lock->retry_us)
		return OD_DEVICE_STATE;
	if (key != lock->storing->stored.lock_key) {
		lock->retry_us = *lock->now_us + RETRY_US;
		event_log_warning(lock->log, *lock->now_us, "write lock: wrong key; imu9-gateway --unlock opens it");
		return OD_LOCAL_CONTROL;
	}
	return storing_store_lock(lock->storing, 0);
}

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct write_lock *lock = ctx;
	bool locked = lock->storing->stored.lock_key != 0;
	enum od_status status = OD_OK;

	(void)size;
	if (entry->index == OD_INDEX_WRITE_LOCK && entry->sub == OD_SUB_WRITE_LOCK_KEY) {
		uint32_t key = get_u32(wire);

		status = locked ? open_with(lock, key) : key ? storing_store_lock(lock->storing, key) : OD_BAD_VALUE;
		write_lock_update(lock);
		return status == OD_OK ? OD_CONSUMED : status;
	}
	return locked && !lock->suspended && is_configuration(entry) ? OD_READ_ONLY : OD_OK;
}

void write_lock_update(struct write_lock *lock)
{
	uint8_t state = lock->storing->stored.lock_key ? LOCKED : OPEN;

	if (state == *lock->state)
		return;
	*lock->state = state;
	event_log_add(lock->log, *lock->now_us, "configuration %s (214Ch)", state == LOCKED ? "locked" : "unlocked");
}

void write_lock_attach(struct write_lock *lock, struct od *od, struct od_values *values, struct storing *storing,
	struct event_log *log, const uint64_t *now_us)
{
	*lock = (struct write_lock){
		.storing = storing, .log = log, .now_us = now_us, .state = &values->write_lock.state};
	lock->hook = (struct od_hook){.first = 0x1000, .last = 0xFFFF, .before = before_write, .ctx = lock};
	od_attach(od, &lock->hook);
	write_lock_update(lock);
}

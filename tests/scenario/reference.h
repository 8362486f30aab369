/* tests/scenario/reference.h
 * A second, independent implementation of a CANopen device: the model that test_random.c compares the core with. It has
 * its own dictionary, written by hand from CiA 301, CiA 305, gateway/README.md and the EDS, and shares no code with the
 * core. Where the standards leave a choice it has that of gateway/README.md (block size 31, SDO timeout of 1 s).
 *
 * Use: reference_init(), reference_start(), then the same calls as for the core. `expected` has the frames that must be
 * on the bus. */
#ifndef TESTS_SCENARIO_REFERENCE_H
#define TESTS_SCENARIO_REFERENCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"

enum { /* enum reference_flags: of an object */
	REF_READ = 1 << 0,
	REF_WRITE = 1 << 1,
	REF_KEPT = 1 << 2, /* restored by a reset of its range */
	REF_TPDO = 1 << 3,
	REF_RPDO = 1 << 4,
	REF_NODE_ID = 1 << 5, /* the default follows the node-ID */
	REF_STRING = 1 << 6,
	REF_DOMAIN = 1 << 7,
	REF_REAL = 1 << 8,
	REF_SIGNED = 1 << 9,
	REF_LIMITS = 1 << 10,
};

enum {
	REF_OBJECTS = 512,
	REF_FRAMES = 4096,
	REF_DOMAIN_MAX = 16384, /* maximum size of a written domain */
	REF_BLOCK_SIZE = 31,	/* segments in a sub-block of a download */
	REF_ERRORS = 16,
	REF_HISTORY = 8,
	REF_CONSUMERS = 8,
	REF_RPDOS = 4,
	REF_TPDOS = 8,
	REF_CHANNELS = 8,
	REF_UNCONFIGURED = 255,
};

struct reference_object {
	uint16_t index;
	uint8_t sub;
	uint16_t size; /* of a string: the maximum */
	uint16_t flags;
	double low, high;
	uint32_t base, value;
};

/** The results of the callbacks of the device. */
enum reference_storage { REF_STORED, REF_STORING, REF_NOT_STORED };

struct reference_transfer {
	enum reference_transfer_state {
		REF_IDLE,
		REF_DOWNLOAD,
		REF_UPLOAD,
		REF_BLOCK_DOWNLOAD,
		REF_BLOCK_DOWNLOAD_END,
		REF_BLOCK_UPLOAD_START,
		REF_BLOCK_UPLOAD,
		REF_BLOCK_UPLOAD_END,
		REF_PENDING
	} state;
	uint32_t request, response; /* identifiers; 0: channel not valid */
	uint16_t index;
	uint8_t sub, toggle;
	bool sized, crc, last;
	size_t size, done;
	uint8_t sequence, block_size;
	uint64_t timeout_us, nudge_us;
	uint8_t data[REF_DOMAIN_MAX + 7];
	uint8_t answer[8]; /* sent when the store has finished */
};

struct reference_rpdo {
	bool waits, monitored;
	uint8_t data[8];
	uint64_t deadline_us;
};

struct reference_tpdo {
	bool event, await_start, sent;
	unsigned syncs;
	uint8_t sampled[8], sampled_len;
	uint64_t inhibited_us, timer_us;
};

struct reference_error {
	uint16_t code;
	uint8_t source, bits;
	uint64_t earliest_us, over_us;
};

struct reference {
	uint64_t now_us;
	struct reference_object objects[REF_OBJECTS];
	size_t object_count;
	char text[33];			/* 1009h */
	uint8_t domain[REF_DOMAIN_MAX]; /* 2130h */
	size_t domain_size;
	const uint8_t *long_domain; /* 1021h */

	struct {
		uint64_t t_us;
		struct can_msg msg;
	} expected[REF_FRAMES];
	size_t expected_count;

	uint8_t node_id, state;
	uint64_t heartbeat_us; /* of the last one */
	uint64_t boot_us;      /* after a reset; 0: none */
	uint8_t guard_toggle;
	bool guarded;
	uint64_t guard_us;
	struct {
		uint8_t node_id;
		bool alive, lost;
		uint64_t deadline_us;
	} consumer[REF_CONSUMERS];
	struct reference_transfer sdo[REF_CHANNELS];
	struct reference_rpdo rpdo[REF_RPDOS];
	struct reference_tpdo tpdo[REF_TPDOS];

	bool sync_running;
	uint64_t sync_due_us, sync_last_us, sync_missing_us; /* 0: no timeout */
	uint8_t sync_counter;

	struct reference_error errors[REF_ERRORS];
	size_t error_count;
	struct {
		uint16_t code;
		uint8_t source;
		uint64_t t_us;
	} ended[REF_ERRORS];
	size_t ended_next;
	struct reference_emcy {
		uint16_t code;
		uint8_t source;
		uint8_t data[8];
	} emcy[REF_ERRORS];
	size_t emcy_count;
	uint64_t emcy_inhibited_us;
	uint8_t history_count;

	enum reference_storage storage;
	bool store_pending, lss_storing;
	unsigned stores, restores, lss_stores, times, collisions, bit_rate_switches;

	struct {
		uint8_t start_id, stored_id, next_id, storing_id;
		bool configuring;
		uint8_t selected, identified, scanned;
		bool confirmed[4];
		uint32_t bit_s, active_bit_s;
		unsigned phase; /* of a bit rate switch: 0 none, 1 delay at the old rate, 2 delay at the new rate */
		uint64_t phase_end_us, delay_us;
	} lss;
};

void reference_init(struct reference *r, uint8_t node_id, uint64_t now_us);
void reference_start(struct reference *r);
void reference_receive(struct reference *r, const struct can_msg *msg);
/** Does what is due; returns the next deadline. */
uint64_t reference_tick(struct reference *r);
/** Lets time pass. */
void reference_run(struct reference *r, uint64_t us);
void reference_sample(struct reference *r, uint16_t counter, uint16_t acceleration);
void reference_error_set(struct reference *r, uint16_t code, uint8_t bits);
void reference_error_clear(struct reference *r, uint16_t code);
void reference_store_done(struct reference *r, bool stored);
void reference_lss_stored(struct reference *r, bool stored);
void reference_bus_off(struct reference *r);

struct reference_object *reference_find(struct reference *r, uint16_t index, uint8_t sub);
bool reference_knows(const struct reference *r, uint16_t index);
uint16_t reference_crc(const uint8_t *data, size_t size);

/* What the files of the model call of each other. */
uint32_t ref_value(struct reference *r, uint16_t index, uint8_t sub);
bool ref_talks(const struct reference *r); /* SDO, SYNC, TIME and EMCY are available */
void ref_send(struct reference *r, uint32_t id, const uint8_t *data, size_t len);
bool ref_identifier_allowed(uint32_t cob_id);
void ref_error_set(struct reference *r, uint16_t code, uint8_t source, uint8_t bits, const uint8_t info[5]);
void ref_error_frame(struct reference *r, uint16_t code, uint8_t source, const uint8_t info[5]);
void ref_error_clear(struct reference *r, uint16_t code, uint8_t source);
/** The abort code; 0; or REF_ABORT_LATER: the response has to wait. */
enum { REF_ABORT_LATER = 1 };
uint32_t ref_write(struct reference *r, uint16_t index, uint8_t sub, const uint8_t *data, size_t size);
uint32_t ref_check(const struct reference_object *o, const uint8_t *data, size_t size);

void ref_sdo_stop(struct reference *r);
/** Opens or closes the channel of 1201h to 1207h as its COB-IDs say. */
void ref_sdo_open(struct reference *r, uint16_t index);
bool ref_sdo_receive(struct reference *r, const struct can_msg *msg);
void ref_sdo_done(struct reference *r, bool stored);
uint64_t ref_sdo_tick(struct reference *r);

uint32_t ref_pdo_before(struct reference *r, const struct reference_object *o, uint32_t value);
void ref_pdo_after(struct reference *r, const struct reference_object *o);
void ref_pdo_start(struct reference *r);
void ref_pdo_sync(struct reference *r, uint8_t counter);
void ref_pdo_receive(struct reference *r, const struct can_msg *msg);
void ref_pdo_remote(struct reference *r, uint32_t id);
uint64_t ref_pdo_tick(struct reference *r);
bool ref_pdo_sends_with(struct reference *r, uint32_t id);

bool ref_lss_silent(const struct reference *r);
void ref_lss_receive(struct reference *r, const struct can_msg *msg);
uint64_t ref_lss_tick(struct reference *r);
void ref_reset(struct reference *r, bool node);

static inline uint64_t ref_earlier(uint64_t a, uint64_t b)
{
	return a < b ? a : b;
}

static inline uint32_t ref_u32(const uint8_t *p)
{
	return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

#endif

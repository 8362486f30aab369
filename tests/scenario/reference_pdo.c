/* The PDOs of the model (CiA 301, 7.2.2 and 7.5.2.35 to 7.5.2.38). The mapping is read from the dictionary each time.
 */
#include <string.h>

#include "tests/scenario/reference.h"

#define INVALID	   0x80000000u
#define NO_RTR	   0x40000000u
#define BAD_VALUE  0x06090030u
#define NO_ACCESS  0x06010000u
#define NO_MAPPING 0x06040041u

static bool valid(struct reference *r, uint16_t comm)
{
	return !(ref_value(r, comm, 1) & INVALID);
}

static bool type_exists(uint16_t comm, unsigned type)
{
	return type <= 240 || type >= (comm >= 0x1800 ? 252 : 254);
}

/* The bytes of a mapping entry, and its object (NULL: a dummy entry). */
static uint32_t mapping_entry(
	struct reference *r, uint16_t comm, uint32_t entry, size_t *bytes, struct reference_object **object)
{
	static const uint8_t dummies[] = {0, 0, 1, 2, 4, 1, 2, 4}; /* by data type: INTEGER8 .. UNSIGNED32 */
	uint16_t index = (uint16_t)(entry >> 16);
	uint8_t sub = (uint8_t)(entry >> 8);

	*object = NULL;
	*bytes = comm < 0x1800 && index < 8 && sub == 0 ? dummies[index] : 0;
	if (!*bytes) {
		*object = reference_find(r, index, sub);
		if (!*object)
			return 0x06020000;
		if (!((*object)->flags & (comm < 0x1800 ? REF_RPDO : REF_TPDO)))
			return NO_MAPPING;
		*bytes = (*object)->size;
	}
	return (entry & 255) == *bytes * 8 ? 0 : NO_MAPPING;
}

/* Length of the first `count` entries of a mapping. */
static uint32_t mapping(struct reference *r, uint16_t comm, unsigned count, size_t *length)
{
	*length = 0;
	if (count > 8)
		return 0x06040042;
	for (unsigned i = 1; i <= count; i++) {
		struct reference_object *object;
		size_t bytes;
		uint32_t code = mapping_entry(r, comm, ref_value(r, comm + 0x200u, (uint8_t)i), &bytes, &object);

		if (code)
			return code;
		*length += bytes;
	}
	return *length > 8 ? 0x06040042 : 0;
}

static size_t length_in_use(struct reference *r, uint16_t comm)
{
	size_t length;

	if (!valid(r, comm) || mapping(r, comm, ref_value(r, comm + 0x200u, 0), &length))
		return 0;
	return length;
}

static struct reference_object *mapped(struct reference *r, uint16_t comm, unsigned i, size_t *bytes)
{
	struct reference_object *object;

	mapping_entry(r, comm, ref_value(r, comm + 0x200u, (uint8_t)(i + 1)), bytes, &object);
	return object;
}

/* ---- checks of writes -------------------------------------------------------------------------------------------- */

static uint32_t before_cob_id(struct reference *r, uint16_t comm, uint32_t value)
{
	uint32_t old = ref_value(r, comm, 1);
	size_t length;

	if (value & 0x3FFFF800)
		return BAD_VALUE;
	if (value & INVALID)
		return 0;
	if (!(old & INVALID))
		return (old ^ value) & 0x7FF ? BAD_VALUE : 0;
	if (!ref_identifier_allowed(value))
		return BAD_VALUE;
	return mapping(r, comm, ref_value(r, comm + 0x200u, 0), &length);
}

static uint32_t before_mapping(struct reference *r, uint16_t comm, uint8_t sub, uint32_t value)
{
	struct reference_object *object;
	size_t bytes;

	if (valid(r, comm))
		return NO_ACCESS;
	if (sub == 0)
		return mapping(r, comm, value, &bytes);
	if (ref_value(r, comm + 0x200u, 0))
		return NO_ACCESS;
	return value ? mapping_entry(r, comm, value, &bytes, &object) : 0;
}

uint32_t ref_pdo_before(struct reference *r, const struct reference_object *o, uint32_t value)
{
	uint16_t comm = o->index & (uint16_t)~0x200u;
	bool held = valid(r, comm) && value != o->value;

	if (o->index & 0x200)
		return before_mapping(r, comm, o->sub, value);
	switch (o->sub) {
	case 1:
		return before_cob_id(r, comm, value);
	case 2:
		return type_exists(comm, value) ? 0 : BAD_VALUE;
	case 3:
	case 6:
		return held ? BAD_VALUE : 0;
	default:
		return 0;
	}
}

/* ---- RPDO errors ------------------------------------------------------------------------------------------------- */

enum { CONTENT = 0x8200, SHORT = 0x8210, LONG = 0x8220, ABSENT = 0x8250 };

static void fault(struct reference *r, unsigned n, uint16_t code, uint8_t a, uint8_t b, uint8_t c)
{
	const uint8_t info[5] = {(uint8_t)n, 0x14, a, b, c};

	if (code == ABSENT)
		ref_error_set(r, code, (uint8_t)(n + 1), 0x10, info);
	else
		ref_error_frame(r, code, (uint8_t)(n + 1), info);
}

static void clear_fault(struct reference *r, unsigned n, uint16_t code)
{
	ref_error_clear(r, code, (uint8_t)(n + 1));
}

/* ---- operation --------------------------------------------------------------------------------------------------- */

static void restart(struct reference *r, uint16_t comm)
{
	unsigned n = comm & 0x1FFu;

	if (comm >= 0x1800) {
		r->tpdo[n] = (struct reference_tpdo){.await_start = true, .timer_us = r->now_us};
		return;
	}
	r->rpdo[n].waits = r->rpdo[n].monitored = false;
	clear_fault(r, n, CONTENT);
	clear_fault(r, n, SHORT);
	clear_fault(r, n, LONG);
	clear_fault(r, n, ABSENT);
}

void ref_pdo_after(struct reference *r, const struct reference_object *o)
{
	uint16_t comm = o->index & (uint16_t)~0x200u;

	if (o->index != comm || o->sub != 5) {
		restart(r, comm);
	} else if (comm < 0x1800) {
		r->rpdo[comm & 0x1FFu].monitored = false;
		clear_fault(r, comm & 0x1FFu, ABSENT);
	}
}

void ref_pdo_start(struct reference *r)
{
	r->sync_last_us = 0;
	for (uint16_t n = 0; n < REF_RPDOS; n++)
		restart(r, 0x1400 + n);
	for (uint16_t n = 0; n < REF_TPDOS; n++)
		restart(r, 0x1800 + n);
}

/* ---- RPDO -------------------------------------------------------------------------------------------------------- */

static void apply(struct reference *r, uint16_t comm, const uint8_t *data)
{
	unsigned n = comm & 0x1FFu, count = ref_value(r, comm + 0x200u, 0);

	for (int writing = 0; writing < 2; writing++) {
		size_t at = 0, bytes;

		for (unsigned i = 0; i < count; i++, at += bytes) {
			struct reference_object *o = mapped(r, comm, i, &bytes);

			if (!o)
				continue;
			if (writing) {
				ref_write(r, o->index, o->sub, data + at, bytes);
			} else if (ref_check(o, data + at, bytes)) {
				fault(r, n, CONTENT, (uint8_t)o->index, (uint8_t)(o->index >> 8), o->sub);
				return;
			}
		}
	}
	clear_fault(r, n, CONTENT);
}

static void receive(struct reference *r, uint16_t comm, const struct can_msg *msg)
{
	unsigned n = comm & 0x1FFu;
	struct reference_rpdo *rpdo = &r->rpdo[n];
	bool synchronous = ref_value(r, comm, 2) <= 240;
	uint32_t window_us = ref_value(r, 0x1007, 0), timer_ms = ref_value(r, comm, 5);
	size_t length = length_in_use(r, comm);

	if (synchronous && window_us && r->sync_last_us && r->now_us > r->sync_last_us + window_us)
		return;
	if (msg->len < length) {
		fault(r, n, SHORT, msg->len, (uint8_t)length, 0);
		return;
	}
	clear_fault(r, n, SHORT);
	if (msg->len > length)
		fault(r, n, LONG, msg->len, (uint8_t)length, 0);
	else
		clear_fault(r, n, LONG);
	rpdo->monitored = timer_ms;
	rpdo->deadline_us = r->now_us + timer_ms * 1000u;
	clear_fault(r, n, ABSENT);
	rpdo->waits = synchronous;
	memcpy(rpdo->data, msg->data, 8);
	if (!synchronous)
		apply(r, comm, msg->data);
}

void ref_pdo_receive(struct reference *r, const struct can_msg *msg)
{
	if (r->state != 5)
		return;
	for (uint16_t n = 0; n < REF_RPDOS; n++)
		if (length_in_use(r, 0x1400 + n) && (ref_value(r, 0x1400 + n, 1) & 0x7FF) == msg->id)
			receive(r, 0x1400 + n, msg);
}

/* ---- TPDO -------------------------------------------------------------------------------------------------------- */

static uint8_t pack(struct reference *r, uint16_t comm, uint8_t data[8])
{
	unsigned count = ref_value(r, comm + 0x200u, 0);
	size_t at = 0, bytes;

	for (unsigned i = 0; i < count; i++, at += bytes) {
		const struct reference_object *o = mapped(r, comm, i, &bytes);

		for (size_t k = 0; k < bytes; k++)
			data[at + k] = (uint8_t)(o->value >> 8 * k);
	}
	return (uint8_t)at;
}

static void transmit(struct reference *r, uint16_t comm)
{
	struct reference_tpdo *tpdo = &r->tpdo[comm & 0x1FFu];
	uint8_t data[8];
	uint8_t len = pack(r, comm, data);

	ref_send(r, ref_value(r, comm, 1) & 0x7FF, data, len);
	tpdo->event = false;
	tpdo->sent = true;
	tpdo->timer_us = r->now_us;
	tpdo->inhibited_us = r->now_us + ref_value(r, comm, 3) * 100u;
}

static bool due_on_sync(struct reference *r, uint16_t comm, uint8_t counter)
{
	struct reference_tpdo *tpdo = &r->tpdo[comm & 0x1FFu];
	uint32_t type = ref_value(r, comm, 2), start = ref_value(r, comm, 6);

	if (!length_in_use(r, comm) || type > 240)
		return false;
	if (tpdo->await_start && counter && start && start != counter)
		return false;
	tpdo->await_start = false;
	if (type == 0)
		return tpdo->event;
	if (++tpdo->syncs % type)
		return false;
	return true;
}

void ref_pdo_sync(struct reference *r, uint8_t counter)
{
	for (uint16_t n = 0; n < REF_TPDOS; n++) {
		uint16_t comm = 0x1800 + n;

		if (due_on_sync(r, comm, counter))
			transmit(r, comm);
		else if (ref_value(r, comm, 2) == 252 && length_in_use(r, comm))
			r->tpdo[n].sampled_len = pack(r, comm, r->tpdo[n].sampled);
	}
	for (uint16_t n = 0; n < REF_RPDOS; n++) {
		if (r->rpdo[n].waits)
			apply(r, 0x1400 + n, r->rpdo[n].data);
		r->rpdo[n].waits = false;
	}
}

void ref_pdo_remote(struct reference *r, uint32_t id)
{
	if (r->state != 5)
		return;
	for (uint16_t n = 0; n < REF_TPDOS; n++) {
		uint32_t cob_id = ref_value(r, 0x1800 + n, 1), type = ref_value(r, 0x1800 + n, 2);

		if (!length_in_use(r, 0x1800 + n) || cob_id & NO_RTR || (cob_id & 0x7FF) != id)
			continue;
		if (type >= 254)
			r->tpdo[n].event = true;
		else if (type == 253)
			transmit(r, 0x1800 + n);
		else if (type == 252 && r->tpdo[n].sampled_len)
			ref_send(r, id, r->tpdo[n].sampled, r->tpdo[n].sampled_len);
	}
}

bool ref_pdo_sends_with(struct reference *r, uint32_t id)
{
	for (uint16_t n = 0; n < REF_TPDOS; n++)
		if (valid(r, 0x1800 + n) && (ref_value(r, 0x1800 + n, 1) & 0x7FF) == id)
			return true;
	return false;
}

void reference_sample(struct reference *r, uint16_t counter, uint16_t acceleration)
{
	reference_find(r, 0x210F, 1)->value = counter;
	reference_find(r, 0x2100, 1)->value = acceleration;
	for (uint16_t n = 0; r->state == 5 && !ref_lss_silent(r) && n < REF_TPDOS; n++) {
		uint32_t type = ref_value(r, 0x1800 + n, 2);
		bool periodic = ref_value(r, 0x1800 + n, 5) && r->tpdo[n].sent;

		if (length_in_use(r, 0x1800 + n))
			r->tpdo[n].event |= type == 0 || (type >= 254 && !periodic);
	}
	reference_tick(r);
}

/* The time at which an event-driven PDO is sent. */
static uint64_t due_us(struct reference *r, uint16_t comm)
{
	const struct reference_tpdo *tpdo = &r->tpdo[comm & 0x1FFu];
	uint32_t timer_ms = ref_value(r, comm, 5);
	uint64_t due = tpdo->event ? 0 : timer_ms ? tpdo->timer_us + timer_ms * 1000u : UINT64_MAX;

	return due > tpdo->inhibited_us ? due : tpdo->inhibited_us;
}

uint64_t ref_pdo_tick(struct reference *r)
{
	uint64_t next = UINT64_MAX;

	if (r->state != 5)
		return next;
	for (uint16_t n = 0; n < REF_RPDOS; n++) {
		if (!r->rpdo[n].monitored)
			continue;
		if (r->now_us < r->rpdo[n].deadline_us) {
			next = ref_earlier(next, r->rpdo[n].deadline_us);
			continue;
		}
		r->rpdo[n].monitored = false;
		fault(r, n, ABSENT, 0, 0, 0);
	}
	for (uint16_t n = 0; n < REF_TPDOS; n++) {
		uint16_t comm = 0x1800 + n;

		if (!length_in_use(r, comm) || ref_value(r, comm, 2) < 254)
			continue;
		if (r->now_us >= due_us(r, comm)) {
			uint64_t period_us = ref_value(r, comm, 5) * 1000u, timer_us = r->tpdo[n].timer_us + period_us;

			transmit(r, comm);
			if (period_us && r->now_us >= timer_us && r->now_us < timer_us + period_us)
				r->tpdo[n].timer_us = timer_us;
		}
		next = ref_earlier(next, due_us(r, comm));
	}
	return next;
}

/* Dictionary, NMT, error control, SYNC, TIME, EMCY, storage and LSS of the model (CiA 301, 302-2, 305). */
#include "tests/scenario/reference.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "od_index.h"

#define INVALID	    0x80000000u
#define BAD_VALUE   0x06090030u
#define WRONG_STATE 0x08000022u
#define CANNOT	    0x08000020u

enum { STOPPED = 4, OPERATIONAL = 5, PRE_OPERATIONAL = 127, INITIALISING = 0 };
enum { RO = REF_READ, RW = REF_READ | REF_WRITE, CONFIG = REF_READ | REF_WRITE | REF_KEPT };

/* ---- dictionary -------------------------------------------------------------------------------------------------- */

static struct reference_object *add(
	struct reference *r, uint16_t index, uint8_t sub, uint16_t size, unsigned flags, uint32_t value)
{
	struct reference_object *o = &r->objects[r->object_count++];

	*o = (struct reference_object){
		.index = index, .sub = sub, .size = size, .flags = (uint16_t)flags, .base = value, .value = value};
	return o;
}

static void limit(struct reference_object *o, double low, double high)
{
	o->flags |= REF_LIMITS;
	o->low = low;
	o->high = high;
}

static void add_mapping(struct reference *r, uint16_t index, const uint32_t *entries, uint8_t count)
{
	limit(add(r, index, 0, 1, CONFIG, count), 0, 64);
	for (uint8_t i = 0; i < 8; i++)
		add(r, index, (uint8_t)(i + 1), 4, CONFIG, i < count ? entries[i] : 0);
}

static void add_rpdos(struct reference *r)
{
	static const uint32_t entries[REF_RPDOS][4] = {{0x20700510, 0x20700610, 0x20700710, 0x20700810},
		{0x20710120, 0x20710220}, {0x20720410, 0x20720510, 0x20720610, 0x20720708}, {0x20730010}};
	static const uint8_t counts[REF_RPDOS] = {4, 2, 4, 1};

	for (uint16_t n = 0; n < REF_RPDOS; n++) {
		add(r, 0x1400 + n, 0, 1, RO, 5);
		add(r, 0x1400 + n, 1, 4, CONFIG | REF_NODE_ID, 0x200u + 0x100u * n);
		add(r, 0x1400 + n, 2, 1, CONFIG, 254);
		add(r, 0x1400 + n, 5, 2, CONFIG, 0);
		add_mapping(r, 0x1600 + n, entries[n], counts[n]);
	}
}

static void add_tpdos(struct reference *r)
{
	static const uint32_t entries[REF_TPDOS][4] = {{0x21000110, 0x21000210, 0x21000310, 0x210F0110},
		{0x21010110, 0x21010210, 0x21010310, 0x210F0110}, {0x21020110, 0x21020210, 0x21020310, 0x210F0110},
		{0x210F0310, 0x210F0110, 0x210F0220}};
	static const uint8_t counts[REF_TPDOS] = {4, 4, 4, 3};

	for (uint16_t n = 0; n < REF_TPDOS; n++) {
		unsigned follows = n < 4 ? REF_NODE_ID : 0;

		add(r, 0x1800 + n, 0, 1, RO, 6);
		add(r, 0x1800 + n, 1, 4, CONFIG | follows, n < 4 ? 0x40000180u + 0x100u * n : INVALID);
		add(r, 0x1800 + n, 2, 1, CONFIG, 1);
		add(r, 0x1800 + n, 3, 2, CONFIG, 0);
		add(r, 0x1800 + n, 5, 2, CONFIG, 0);
		limit(add(r, 0x1800 + n, 6, 1, CONFIG, 0), 0, 240);
		add_mapping(r, 0x1A00 + n, entries[n], counts[n]);
	}
}

static void add_application(struct reference *r)
{
	add(r, 0x2000, 0, 1, RO, 3);
	for (uint8_t i = 1; i <= 3; i++)
		limit(add(r, 0x2000, i, 4, CONFIG | REF_REAL, 0), -10, 10);
	limit(add(r, 0x2001, 0, 1, CONFIG, 2), 0, 3);
	add(r, 0x2070, 0, 1, RO, 9);
	for (uint8_t i = 1; i <= 4; i++)
		limit(add(r, 0x2070, i, 4, RW | REF_REAL | REF_RPDO, 0), i == 4 ? 0 : -1000, 1000);
	for (uint8_t i = 5; i <= 8; i++)
		add(r, 0x2070, i, 2, RW | REF_RPDO | (i == 8 ? 0 : REF_SIGNED), 0);
	limit(add(r, 0x2070, 9, 1, CONFIG, 0), 0, 1);
	add(r, 0x2071, 0, 1, RO, 2);
	limit(add(r, 0x2071, 1, 4, RW | REF_REAL | REF_RPDO, 0), -360, 360);
	limit(add(r, 0x2071, 2, 4, RW | REF_REAL | REF_RPDO, 0), 0, 180);
	add(r, 0x2072, 0, 1, RO, 7);
	for (uint8_t i = 1; i <= 3; i++)
		limit(add(r, 0x2072, i, 4, RW | REF_REAL | REF_RPDO, 0), i == 2 ? -90 : -360, i == 2 ? 90 : 360);
	add(r, 0x2072, 4, 2, RW | REF_SIGNED | REF_RPDO, 0);
	limit(add(r, 0x2072, 5, 2, RW | REF_SIGNED | REF_RPDO, 0), -9000, 9000);
	add(r, 0x2072, 6, 2, RW | REF_SIGNED | REF_RPDO, 0);
	limit(add(r, 0x2072, 7, 1, RW | REF_RPDO, 0), 0, 1);
	limit(add(r, 0x2073, 0, 2, RW | REF_RPDO, 0), 0, 7);
	for (uint16_t index = 0x2100; index <= 0x2101; index++) {
		add(r, index, 0, 1, RO, 3);
		for (uint8_t i = 1; i <= 3; i++)
			add(r, index, i, 2, RO | REF_TPDO, 0);
	}
	add(r, 0x2102, 0, 1, RO, 6);
	for (uint8_t i = 1; i <= 6; i++)
		add(r, 0x2102, i, i <= 3 ? 2 : 4, RO | REF_TPDO, 0);
	add(r, 0x210F, 0, 1, RO, 3);
	add(r, 0x210F, 1, 2, RO | REF_TPDO, 0);
	add(r, 0x210F, 2, 4, RO | REF_TPDO, 0);
	add(r, 0x210F, 3, 2, RO | REF_TPDO, 0);
	add(r, 0x2130, 0, 0, RW | REF_DOMAIN, 0);
	limit(add(r, 0x6000, 0, 2, CONFIG, 10), 1, 1000);
}

static void add_communication(struct reference *r)
{
	static const uint32_t identity[] = {4, 0x00494D55, 9, OD_REVISION, 0};

	add(r, 0x1000, 0, 4, RO, 0x0004019A);
	add(r, 0x1001, 0, 1, RO | REF_TPDO, 0);
	add(r, 0x1003, 0, 1, RW, 0);
	for (uint8_t i = 1; i <= REF_HISTORY; i++)
		add(r, 0x1003, i, 4, RO, 0);
	add(r, 0x1005, 0, 4, CONFIG, 0x80);
	add(r, 0x1006, 0, 4, CONFIG, 0);
	add(r, 0x1007, 0, 4, CONFIG, 0);
	add(r, 0x1008, 0, 32, RO | REF_STRING, 0);
	add(r, 0x1009, 0, 32, RW | REF_STRING, 0);
	add(r, 0x100C, 0, 2, CONFIG, 0);
	add(r, 0x100D, 0, 1, CONFIG, 0);
	for (uint16_t index = 0x1010; index <= 0x1011; index++) {
		add(r, index, 0, 1, RO, 4);
		for (uint8_t i = 1; i <= 4; i++)
			add(r, index, i, 4, RW, 1);
	}
	add(r, 0x1012, 0, 4, CONFIG, 0x100);
	add(r, 0x1014, 0, 4, CONFIG | REF_NODE_ID, 0x80);
	add(r, 0x1015, 0, 2, CONFIG, 0);
	add(r, 0x1016, 0, 1, RO, REF_CONSUMERS);
	for (uint8_t i = 1; i <= REF_CONSUMERS; i++)
		add(r, 0x1016, i, 4, CONFIG, 0);
	add(r, 0x1017, 0, 2, CONFIG, 0);
	for (uint8_t i = 0; i <= 4; i++)
		add(r, 0x1018, i, i ? 4 : 1, RO, identity[i]);
	limit(add(r, 0x1019, 0, 1, CONFIG, 0), 0, 240);
	add(r, 0x1020, 0, 1, RO, 2);
	add(r, 0x1020, 1, 4, CONFIG, 0);
	add(r, 0x1020, 2, 4, CONFIG, 0);
	add(r, 0x1021, 0, 0, RO | REF_DOMAIN, 0);
	add(r, 0x1022, 0, 1, RO, 0);
	add(r, 0x1029, 0, 1, RO, 1);
	limit(add(r, 0x1029, 1, 1, CONFIG, 0), 0, 2);
	add(r, 0x1200, 0, 1, RO, 2);
	add(r, 0x1200, 1, 4, RO | REF_NODE_ID, 0x600);
	add(r, 0x1200, 2, 4, RO | REF_NODE_ID, 0x580);
	for (uint16_t channel = 0x1201; channel <= 0x1207; channel++) {
		add(r, channel, 0, 1, RO, 2);
		add(r, channel, 1, 4, CONFIG, INVALID);
		add(r, channel, 2, 4, CONFIG, INVALID);
	}
	add(r, 0x1F80, 0, 4, CONFIG, 4);
}

static uint32_t key(const struct reference_object *o)
{
	return (uint32_t)o->index << 8 | o->sub;
}

static int compare(const void *a, const void *b)
{
	uint32_t x = key(a), y = key(b);

	return x < y ? -1 : x > y;
}

struct reference_object *reference_find(struct reference *r, uint16_t index, uint8_t sub)
{
	const struct reference_object wanted = {.index = index, .sub = sub};

	return bsearch(&wanted, r->objects, r->object_count, sizeof(wanted), compare);
}

bool reference_knows(const struct reference *r, uint16_t index)
{
	for (size_t i = 0; i < r->object_count; i++)
		if (r->objects[i].index == index)
			return true;
	return false;
}

uint32_t ref_value(struct reference *r, uint16_t index, uint8_t sub)
{
	return reference_find(r, index, sub)->value;
}

static uint32_t default_of(const struct reference *r, const struct reference_object *o)
{
	bool follows = o->flags & REF_NODE_ID && r->node_id != REF_UNCONFIGURED;

	return o->base + (follows ? r->node_id : 0u);
}

static void reset_objects(struct reference *r, bool node)
{
	for (size_t i = 0; i < r->object_count; i++) {
		struct reference_object *o = &r->objects[i];

		if ((o->flags & REF_NODE_ID) || (o->flags & REF_KEPT && (node || o->index < 0x2000)))
			o->value = default_of(r, o);
	}
}

static double number(const struct reference_object *o, uint32_t raw)
{
	float real;

	memcpy(&real, &raw, 4);
	if (o->flags & REF_REAL)
		return (double)real;
	if (o->flags & REF_SIGNED)
		return o->size == 1 ? (int8_t)raw : o->size == 2 ? (int16_t)raw : (int32_t)raw;
	return raw;
}

static uint32_t raw_of(const uint8_t *data, size_t size)
{
	uint32_t raw = 0;

	for (size_t i = 0; i < size && i < 4; i++)
		raw |= (uint32_t)data[i] << 8 * i;
	return raw;
}

static uint32_t check_text(const uint8_t *text, size_t size)
{
	size_t length = strnlen((const char *)text, size);

	for (size_t i = length; i < size; i++)
		if (text[i])
			return BAD_VALUE;
	return 0;
}

uint32_t ref_check(const struct reference_object *o, const uint8_t *data, size_t size)
{
	double value = number(o, raw_of(data, size));

	if (size > o->size)
		return 0x06070012;
	if (o->flags & REF_STRING)
		return check_text(data, size);
	if (size < o->size)
		return 0x06070013;
	if (o->flags & REF_REAL && !isfinite(value))
		return BAD_VALUE;
	if (!(o->flags & REF_LIMITS))
		return 0;
	return value > o->high ? 0x06090031 : value < o->low ? 0x06090032 : 0;
}

/* CiA 301, 7.3.5: the eleven bits of the identifier, and bits 30 and 31. */
bool ref_identifier_allowed(uint32_t cob_id)
{
	uint32_t id = cob_id & 0x3FFFFFFF;

	if (id > 0x7FF)
		return false;
	return !(id < 0x80 || (id > 0x100 && id <= 0x180) || (id > 0x580 && id < 0x600) || (id > 0x600 && id < 0x680) ||
		 (id >= 0x6E0 && id <= 0x6FF) || id > 0x700);
}

/* ---- objects with side effects ----------------------------------------------------------------------------------- */

static uint32_t plain_cob_id(uint32_t old, uint32_t value)
{
	if (value & INVALID)
		return value & 0x7FFFF800 ? BAD_VALUE : 0;
	if (value & 0x40000000 || !ref_identifier_allowed(value))
		return BAD_VALUE;
	return !(old & INVALID) && old != value ? BAD_VALUE : 0;
}

static unsigned watched(uint32_t value)
{
	return value & 0xFFFF ? value >> 16 & 127 : 0;
}

static uint32_t before_consumer(struct reference *r, const struct reference_object *o, uint32_t value)
{
	if (value & 0xFF800000)
		return BAD_VALUE;
	for (uint8_t i = 1; i <= REF_CONSUMERS && watched(value); i++)
		if (i != o->sub && watched(ref_value(r, 0x1016, i)) == watched(value))
			return 0x06040043;
	return 0;
}

static uint32_t before_storage(struct reference *r, const struct reference_object *o, uint32_t value)
{
	if (value != (o->index == 0x1010 ? 0x65766173u : 0x64616F6Cu))
		return CANNOT;
	if (r->store_pending)
		return WRONG_STATE;
	if (o->index == 0x1010)
		r->stores++;
	else
		r->restores++;
	r->store_pending = r->storage == REF_STORING;
	return r->storage == REF_STORED ? 0 : r->storage == REF_STORING ? REF_ABORT_LATER : CANNOT;
}

static bool is_channel(const struct reference_object *o)
{
	return o->index > 0x1200 && o->index < 0x1208 && o->sub;
}

/* The identifier that the node uses when the object has this value; 0: none. */
static uint32_t identifier_of(const struct reference_object *o, uint32_t value)
{
	bool pdo = o->index >= 0x1400 && o->index < 0x1C00 && !(o->index & 0x200) && o->sub == 1;

	if (o->index == 0x1005 || (o->index == 0x1012 && value >> 30))
		return value & 0x7FF;
	return (is_channel(o) || pdo || o->index == 0x1014) && !(value >> 31) ? value & 0x7FF : 0;
}

/* The channels of 1201h to 1207h share no identifier with another object. */
static bool used_twice(const struct reference *r, const struct reference_object *o, uint32_t value)
{
	uint32_t id = identifier_of(o, value);

	for (size_t i = 0; i < r->object_count && id; i++) {
		const struct reference_object *other = &r->objects[i];

		if (other != o && (is_channel(o) || is_channel(other)) && identifier_of(other, other->value) == id)
			return true;
	}
	return false;
}

static uint32_t allowed(struct reference *r, const struct reference_object *o, uint32_t value)
{
	uint32_t moved = (o->value ^ value) & 0x7FF;

	switch (o->index) {
	case 0x1003:
		return value ? BAD_VALUE : 0;
	case 0x1005:
		return !ref_identifier_allowed(value) || (o->value & 0x40000000 && moved) ? BAD_VALUE : 0;
	case 0x1006:
		return value && value < 1000 ? BAD_VALUE : 0;
	case 0x1010:
	case 0x1011:
		return before_storage(r, o, value);
	case 0x1012:
		return !ref_identifier_allowed(value) || (o->value >> 30 && moved) ? BAD_VALUE : 0;
	case 0x1014:
	case 0x1201:
	case 0x1202:
	case 0x1203:
	case 0x1204:
	case 0x1205:
	case 0x1206:
	case 0x1207:
		return plain_cob_id(o->value, value);
	case 0x1016:
		return before_consumer(r, o, value);
	case 0x1019:
		return value == 1 ? BAD_VALUE : value != o->value && ref_value(r, 0x1006, 0) ? WRONG_STATE : 0;
	case 0x1F80:
		return value & ~4u ? BAD_VALUE : 0;
	default:
		return o->index >= 0x1400 && o->index < 0x1C00 ? ref_pdo_before(r, o, value) : 0;
	}
}

static uint32_t before(struct reference *r, const struct reference_object *o, uint32_t value)
{
	uint32_t code = allowed(r, o, value);

	return code ? code : used_twice(r, o, value) ? 0x06040043 : 0;
}

static void watch(struct reference *r, unsigned i)
{
	if (r->consumer[i].lost)
		ref_error_clear(r, 0x8130, r->consumer[i].node_id);
	r->consumer[i].alive = r->consumer[i].lost = false;
	r->consumer[i].node_id = (uint8_t)watched(ref_value(r, 0x1016, (uint8_t)(i + 1)));
}

static void clear_history(struct reference *r)
{
	r->history_count = 0;
	for (uint8_t i = 0; i <= REF_HISTORY; i++)
		reference_find(r, 0x1003, i)->value = 0;
}

static void after(struct reference *r, const struct reference_object *o)
{
	switch (o->index) {
	case 0x1003:
		clear_history(r);
		break;
	case 0x1005:
	case 0x1006:
		r->sync_running &= o->index == 0x1005;
		r->sync_missing_us = 0;
		ref_error_clear(r, 0x8100, 6);
		break;
	case 0x1016:
		watch(r, o->sub - 1u);
		break;
	default:
		if (o->index > 0x1200 && o->index < 0x1208)
			ref_sdo_open(r, o->index);
		if (o->index >= 0x1400 && o->index < 0x1C00)
			ref_pdo_after(r, o);
	}
}

uint32_t ref_write(struct reference *r, uint16_t index, uint8_t sub, const uint8_t *data, size_t size)
{
	struct reference_object *o = reference_find(r, index, sub);
	uint32_t code;

	if (o->flags & REF_DOMAIN) {
		memcpy(r->domain, data, size);
		r->domain_size = size;
		return 0;
	}
	code = ref_check(o, data, size);
	if (!code)
		code = before(r, o, raw_of(data, size));
	if (code || index == 0x1010 || index == 0x1011)
		return code;
	if (o->flags & REF_STRING) {
		memset(r->text, 0, sizeof(r->text));
		memcpy(r->text, data, size);
	} else {
		o->value = raw_of(data, size);
	}
	if (o->flags & REF_KEPT && index != 0x1020)
		reference_find(r, 0x1020, 1)->value = reference_find(r, 0x1020, 2)->value = 0;
	after(r, o);
	return 0;
}

/* ---- EMCY -------------------------------------------------------------------------------------------------------- */

void ref_send(struct reference *r, uint32_t id, const uint8_t *data, size_t len)
{
	struct can_msg *msg = &r->expected[r->expected_count].msg;

	if (r->expected_count == REF_FRAMES)
		return;
	*msg = (struct can_msg){.id = id, .len = (uint8_t)len};
	memcpy(msg->data, data, len);
	r->expected[r->expected_count++].t_us = r->now_us;
}

bool ref_talks(const struct reference *r)
{
	return r->state == OPERATIONAL || r->state == PRE_OPERATIONAL;
}

static uint64_t emcy_tick(struct reference *r)
{
	uint32_t cob_id = ref_value(r, 0x1014, 0);

	if (cob_id & INVALID)
		r->emcy_count = 0;
	while (r->emcy_count && ref_talks(r) && !ref_lss_silent(r)) {
		if (r->now_us < r->emcy_inhibited_us)
			return r->emcy_inhibited_us;
		ref_send(r, cob_id, r->emcy[0].data, 8);
		memmove(&r->emcy[0], &r->emcy[1], --r->emcy_count * sizeof(r->emcy[0]));
		r->emcy_inhibited_us = r->now_us + ref_value(r, 0x1015, 0) * 100u;
	}
	return UINT64_MAX;
}

static bool is_active(const struct reference *r, uint16_t code, uint8_t source)
{
	for (size_t i = 0; i < r->error_count; i++)
		if (r->errors[i].code == code && r->errors[i].source == source)
			return true;
	return false;
}

static void show_register(struct reference *r)
{
	uint8_t bits = r->error_count ? 1 : 0;

	for (size_t i = 0; i < r->error_count; i++)
		bits |= r->errors[i].bits;
	reference_find(r, 0x1001, 0)->value = bits;
}

static void notify(struct reference *r, uint16_t code, uint8_t source, const uint8_t info[5])
{
	struct reference_emcy *emcy;

	if (r->emcy_count == REF_ERRORS)
		memmove(&r->emcy[0], &r->emcy[1], --r->emcy_count * sizeof(r->emcy[0]));
	emcy = &r->emcy[r->emcy_count++];
	*emcy = (struct reference_emcy){.code = code,
		.source = source,
		.data = {(uint8_t)code, (uint8_t)(code >> 8), (uint8_t)ref_value(r, 0x1001, 0)}};
	memcpy(emcy->data + 3, info, 5);
	emcy_tick(r);
}

/* An entry that recurs goes to the front. */
static void note_history(struct reference *r, uint32_t value)
{
	uint32_t kept[REF_HISTORY] = {value};
	uint8_t count = 1;

	for (uint8_t i = 1; i <= r->history_count && count < REF_HISTORY; i++)
		if (ref_value(r, 0x1003, i) != value)
			kept[count++] = ref_value(r, 0x1003, i);
	r->history_count = count;
	reference_find(r, 0x1003, 0)->value = count;
	for (uint8_t i = 0; i < count; i++)
		reference_find(r, 0x1003, i + 1)->value = kept[i];
}

static struct reference_error *find_error(struct reference *r, uint16_t code, uint8_t source)
{
	for (size_t i = 0; i < r->error_count; i++)
		if (r->errors[i].code == code && r->errors[i].source == source)
			return &r->errors[i];
	return NULL;
}

/* A communication error ends once a second at most. */
static uint64_t *end_of(struct reference *r, uint16_t code, uint8_t source)
{
	for (size_t i = 0; i < REF_ERRORS; i++)
		if (r->ended[i].code == code && r->ended[i].source == source)
			return &r->ended[i].t_us;
	return NULL;
}

static void note_end(struct reference *r, const struct reference_error *error)
{
	if (!(error->bits & 0x10))
		return;
	if (!end_of(r, error->code, error->source)) {
		r->ended[r->ended_next].code = error->code;
		r->ended[r->ended_next].source = error->source;
		r->ended_next = (r->ended_next + 1) % REF_ERRORS;
	}
	*end_of(r, error->code, error->source) = r->now_us;
}

void ref_error_set(struct reference *r, uint16_t code, uint8_t source, uint8_t bits, const uint8_t info[5])
{
	struct reference_error *error = find_error(r, code, source);
	const uint64_t *end = bits & 0x10 ? end_of(r, code, source) : NULL;

	if (error)
		error->over_us = UINT64_MAX;
	if (error || r->error_count == REF_ERRORS)
		return;
	r->errors[r->error_count++] =
		(struct reference_error){code, source, bits, end ? *end + 1000000 : 0, UINT64_MAX};
	show_register(r);
	note_history(r, code | (uint32_t)info[0] << 16 | (uint32_t)info[1] << 24);
	notify(r, code, source, info);
}

/* A wrong frame, or one of another node: over after 1 s without one, forgotten after 10 s. */
void ref_error_frame(struct reference *r, uint16_t code, uint8_t source, const uint8_t info[5])
{
	struct reference_error *error;

	ref_error_set(r, code, source, 0x10, info);
	error = find_error(r, code, source);
	if (!error)
		return;
	error->earliest_us = r->now_us + 1000000;
	error->over_us = r->now_us + 10000000;
}

static void remove_errors(struct reference *r, uint16_t code, int source)
{
	size_t kept = 0;

	for (size_t i = 0; i < r->error_count; i++)
		if (r->errors[i].code != code || (source >= 0 && r->errors[i].source != source))
			r->errors[kept++] = r->errors[i];
	r->error_count = kept;
	show_register(r);
}

static void end_error(struct reference *r, uint16_t code, uint8_t source)
{
	note_end(r, find_error(r, code, source));
	remove_errors(r, code, source);
	if (!r->error_count)
		notify(r, 0, 0, (const uint8_t[5]){0});
}

void ref_error_clear(struct reference *r, uint16_t code, uint8_t source)
{
	struct reference_error *error = find_error(r, code, source);

	if (error && error->earliest_us > r->now_us)
		error->over_us = error->earliest_us;
	else if (error)
		end_error(r, code, source);
}

static uint64_t errors_tick(struct reference *r)
{
	uint64_t next = UINT64_MAX;

	for (size_t i = r->error_count; i-- > 0;) {
		if (r->errors[i].over_us > r->now_us)
			next = ref_earlier(next, r->errors[i].over_us);
		else
			end_error(r, r->errors[i].code, r->errors[i].source);
	}
	return ref_earlier(next, emcy_tick(r));
}

/* The most recent message of an active error, or the last one if none is active. */
static void leave_stopped(struct reference *r)
{
	size_t i = r->emcy_count;

	while (i && !is_active(r, r->emcy[i - 1].code, r->emcy[i - 1].source))
		i--;
	if (!i && !r->error_count)
		i = r->emcy_count;
	if (i)
		r->emcy[0] = r->emcy[i - 1];
	r->emcy_count = i ? 1 : 0;
}

static void reset_errors(struct reference *r, bool node)
{
	static const uint16_t own[] = {0x6300, 0x8100, 0x8130, 0x8150, 0x8200, 0x8210, 0x8220, 0x8240, 0x8250};

	if (r->node_id != REF_UNCONFIGURED)
		r->emcy_count = 0;
	r->emcy_inhibited_us = 0;
	for (size_t i = 0; i < sizeof(own) / sizeof(own[0]); i++)
		remove_errors(r, own[i], -1);
	if (!node)
		return;
	r->error_count = 0;
	show_register(r);
	clear_history(r);
}

/* ---- NMT --------------------------------------------------------------------------------------------------------- */

static void enter(struct reference *r, uint8_t state)
{
	uint8_t old = r->state;

	if (state == old)
		return;
	r->state = state;
	if (old == STOPPED && ref_talks(r))
		leave_stopped(r);
	if (state == STOPPED)
		ref_sdo_stop(r);
	if (state == OPERATIONAL)
		ref_pdo_start(r);
}

static void boot(struct reference *r)
{
	if (r->node_id == REF_UNCONFIGURED)
		return;
	ref_send(r, 0x700u + r->node_id, (const uint8_t[]){0}, 1);
	r->heartbeat_us = r->now_us;
	enter(r, PRE_OPERATIONAL);
	if (!(ref_value(r, 0x1F80, 0) & 4))
		enter(r, OPERATIONAL);
}

void ref_reset(struct reference *r, bool node)
{
	r->state = INITIALISING;
	reset_errors(r, node);
	if (node)
		r->lss.next_id = r->lss.stored_id;
	r->node_id = r->lss.next_id;
	r->lss.configuring = false;
	r->lss.selected = r->lss.identified = r->lss.scanned = 0;
	memset(r->lss.confirmed, 0, sizeof(r->lss.confirmed));
	reset_objects(r, node);
	ref_sdo_stop(r);
	for (uint16_t channel = 0x1201; channel <= 0x1207; channel++)
		ref_sdo_open(r, channel);
	r->sync_running = r->guarded = false;
	r->sync_counter = r->guard_toggle = 0;
	r->sync_last_us = r->sync_missing_us = 0;
	memset(r->consumer, 0, sizeof(r->consumer));
	memset(r->rpdo, 0, sizeof(r->rpdo));
	r->boot_us = r->node_id == REF_UNCONFIGURED ? 0 : r->now_us + 10000;
}

static void nmt(struct reference *r, const struct can_msg *msg)
{
	if (msg->len != 2 || (msg->data[1] && msg->data[1] != r->node_id))
		return;
	if (msg->data[0] == 1)
		enter(r, OPERATIONAL);
	else if (msg->data[0] == 2)
		enter(r, STOPPED);
	else if (msg->data[0] == 128)
		enter(r, PRE_OPERATIONAL);
	else if (msg->data[0] == 129 || msg->data[0] == 130)
		ref_reset(r, msg->data[0] == 129);
}

static void communication_error(struct reference *r)
{
	uint32_t behaviour = ref_value(r, 0x1029, 1);

	if (r->state != INITIALISING && behaviour == 2)
		enter(r, STOPPED);
	if (r->state == OPERATIONAL && behaviour == 0)
		enter(r, PRE_OPERATIONAL);
}

void reference_bus_off(struct reference *r)
{
	communication_error(r);
	reference_tick(r);
}

static uint64_t heartbeat_tick(struct reference *r)
{
	uint64_t period_us = ref_value(r, 0x1017, 0) * 1000u, due_us;

	if (r->boot_us && r->now_us < r->boot_us)
		return r->boot_us;
	if (r->boot_us)
		boot(r);
	r->boot_us = 0;
	due_us = r->heartbeat_us + period_us;
	if (r->state == INITIALISING || !period_us)
		return UINT64_MAX;
	if (r->now_us < due_us)
		return due_us;
	ref_send(r, 0x700u + r->node_id, &r->state, 1);
	r->heartbeat_us = r->now_us >= due_us + period_us ? r->now_us : due_us;
	return r->heartbeat_us + period_us;
}

static void guard(struct reference *r)
{
	ref_send(r, 0x700u + r->node_id, (const uint8_t[]){(uint8_t)(r->state | r->guard_toggle << 7)}, 1);
	r->guard_toggle ^= 1;
	if (ref_value(r, 0x1017, 0))
		return;
	r->guarded = true;
	r->guard_us = r->now_us;
	ref_error_clear(r, 0x8130, 0);
}

static uint64_t guard_tick(struct reference *r)
{
	uint64_t life_us = (uint64_t)ref_value(r, 0x100C, 0) * ref_value(r, 0x100D, 0) * 1000;

	if (ref_value(r, 0x1017, 0)) {
		r->guarded = false;
		ref_error_clear(r, 0x8130, 0);
	}
	if (!r->guarded || !life_us)
		return UINT64_MAX;
	if (r->now_us < r->guard_us + life_us)
		return r->guard_us + life_us;
	r->guarded = false;
	ref_error_set(r, 0x8130, 0, 0x10, (const uint8_t[5]){0});
	communication_error(r);
	return UINT64_MAX;
}

static void heartbeat_of(struct reference *r, const struct can_msg *msg)
{
	for (uint8_t i = 0; i < REF_CONSUMERS && msg->len == 1; i++) {
		uint8_t node_id = r->consumer[i].node_id;

		if (!node_id || msg->id != 0x700u + node_id)
			continue;
		if (r->consumer[i].lost)
			ref_error_clear(r, 0x8130, node_id);
		r->consumer[i].lost = false;
		r->consumer[i].alive = true;
		r->consumer[i].deadline_us = r->now_us + (ref_value(r, 0x1016, (uint8_t)(i + 1)) & 0xFFFF) * 1000u;
		return;
	}
}

static uint64_t consumer_tick(struct reference *r)
{
	uint64_t next = UINT64_MAX;

	for (unsigned i = 0; i < REF_CONSUMERS; i++) {
		if (!r->consumer[i].alive)
			continue;
		if (r->now_us < r->consumer[i].deadline_us) {
			next = ref_earlier(next, r->consumer[i].deadline_us);
			continue;
		}
		r->consumer[i].alive = false;
		r->consumer[i].lost = true;
		ref_error_set(r, 0x8130, r->consumer[i].node_id, 0x10, (const uint8_t[5]){r->consumer[i].node_id});
		communication_error(r);
	}
	return next;
}

/* ---- SYNC, TIME, node-ID collisions ------------------------------------------------------------------------------ */

static bool consumes_sync(struct reference *r, uint32_t id)
{
	uint32_t cob_id = ref_value(r, 0x1005, 0);

	return !(cob_id & 0x40000000) && (cob_id & 0x7FF) == id;
}

static void sync(struct reference *r, const struct can_msg *msg)
{
	bool counted = ref_value(r, 0x1019, 0);
	uint64_t period_us = ref_value(r, 0x1006, 0);

	if (!ref_talks(r))
		return;
	if (msg->len != counted) {
		ref_error_frame(r, 0x8240, 0, (const uint8_t[5]){0});
		return;
	}
	ref_error_clear(r, 0x8240, 0);
	ref_error_clear(r, 0x8100, 6);
	if (r->state != OPERATIONAL)
		return;
	r->sync_last_us = r->now_us;
	r->sync_missing_us = period_us ? r->now_us + period_us + period_us / 2 : 0;
	ref_pdo_sync(r, counted ? msg->data[0] : 0);
}

static uint64_t await_sync(struct reference *r)
{
	if (r->state != OPERATIONAL)
		r->sync_missing_us = 0;
	if (!r->sync_missing_us)
		return UINT64_MAX;
	if (r->now_us < r->sync_missing_us)
		return r->sync_missing_us;
	r->sync_missing_us = 0;
	ref_error_set(r, 0x8100, 6, 0x10, (const uint8_t[5]){0x06, 0x10});
	return UINT64_MAX;
}

static uint64_t sync_tick(struct reference *r)
{
	uint32_t cob_id = ref_value(r, 0x1005, 0), period_us = ref_value(r, 0x1006, 0);
	uint8_t overflow = (uint8_t)ref_value(r, 0x1019, 0);

	if (!(cob_id & 0x40000000) || !period_us || !ref_talks(r)) {
		r->sync_running = false;
		r->sync_counter = 0;
		return await_sync(r);
	}
	if (!r->sync_running)
		r->sync_due_us = r->now_us + period_us;
	r->sync_running = true;
	if (r->now_us < r->sync_due_us)
		return r->sync_due_us;
	if (overflow)
		r->sync_counter = (uint8_t)(r->sync_counter >= overflow ? 1 : r->sync_counter + 1);
	ref_send(r, cob_id & 0x7FF, &r->sync_counter, overflow ? 1 : 0);
	if (r->state == OPERATIONAL) {
		r->sync_last_us = r->now_us;
		ref_pdo_sync(r, overflow ? r->sync_counter : 0);
	}
	if (r->now_us >= r->sync_due_us + period_us)
		r->sync_due_us = r->now_us;
	r->sync_due_us += period_us;
	return r->sync_due_us;
}

static void time_of_day(struct reference *r, const struct can_msg *msg)
{
	if (ref_talks(r) && msg->len == 6 && (ref_u32(msg->data) & 0x0FFFFFFF) < 86400000)
		r->times++;
}

static bool is_own_id(struct reference *r, uint32_t id)
{
	return id == 0x700u + r->node_id || id == ref_value(r, 0x1014, 0) || id == r->sdo[0].response ||
	       (r->sdo[1].request && id == r->sdo[1].response) || ref_pdo_sends_with(r, id);
}

static void collide(struct reference *r, uint32_t id)
{
	bool before = find_error(r, 0x8150, 0);

	ref_error_frame(r, 0x8150, 0, (const uint8_t[5]){(uint8_t)id, (uint8_t)(id >> 8)});
	r->collisions += !before && find_error(r, 0x8150, 0);
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

bool ref_lss_silent(const struct reference *r)
{
	return r->lss.phase != 0;
}

static void lss_respond(struct reference *r, uint8_t command, uint32_t value)
{
	ref_send(r, 0x7E4,
		(const uint8_t[8]){
			command, (uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)},
		8);
}

static bool unconfigured(const struct reference *r)
{
	return r->node_id == REF_UNCONFIGURED && r->lss.next_id == REF_UNCONFIGURED;
}

static void lss_selective(struct reference *r, uint8_t n, uint32_t value)
{
	bool right = !r->lss.configuring && (n == 1 || n == r->lss.selected + 1) && value == ref_value(r, 0x1018, n);

	r->lss.selected = right ? n : 0;
	if (r->lss.selected != 4)
		return;
	r->lss.selected = 0;
	r->lss.configuring = true;
	lss_respond(r, 0x44, 0);
}

static void lss_identify(struct reference *r, uint8_t step, uint32_t value)
{
	static const uint8_t subs[] = {1, 2, 3, 3, 4, 4};
	uint32_t mine = ref_value(r, 0x1018, subs[step]);
	bool fits = step < 2 ? mine == value : step % 2 ? mine <= value : mine >= value;

	r->lss.identified = fits && (step == 0 || step == r->lss.identified) ? step + 1 : 0;
	if (r->lss.identified != 6)
		return;
	r->lss.identified = 0;
	lss_respond(r, 0x4F, 0);
}

static void lss_fastscan(struct reference *r, const uint8_t *f)
{
	uint8_t bit = f[5], number = f[6], next = f[7];

	if (!unconfigured(r) || r->lss.configuring)
		return;
	if (bit == 0x80) {
		r->lss.scanned = 0;
		memset(r->lss.confirmed, 0, sizeof(r->lss.confirmed));
		lss_respond(r, 0x4F, 0);
		return;
	}
	if (bit > 31 || number > 3 || next > 3 || number != r->lss.scanned)
		return;
	for (unsigned i = bit; i < 32; i++)
		if ((ref_value(r, 0x1018, (uint8_t)(number + 1)) >> i & 1) != (ref_u32(f + 1) >> i & 1))
			return;
	lss_respond(r, 0x4F, 0);
	if (bit)
		return;
	r->lss.scanned = next;
	r->lss.confirmed[number] = true;
	if (next < number && r->lss.confirmed[0] && r->lss.confirmed[1] && r->lss.confirmed[2] && r->lss.confirmed[3])
		r->lss.configuring = true;
}

static void lss_bit_timing(struct reference *r, uint8_t table, uint8_t index)
{
	static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000, 0, 50000, 20000, 10000};
	uint32_t bit_s = table == 0 && index < 9 ? rates[index] : 0;
	bool right = bit_s && bit_s != 800000; /* bus.c does not support this one */

	if (right)
		r->lss.bit_s = bit_s;
	lss_respond(r, 0x13, right ? 0 : 1);
}

static void lss_kept(struct reference *r, bool stored)
{
	if (stored)
		r->lss.stored_id = r->lss.storing_id;
	if (r->lss.configuring && !ref_lss_silent(r))
		lss_respond(r, 0x17, stored ? 0 : 2);
}

static void lss_store(struct reference *r)
{
	if (r->lss_storing) {
		lss_respond(r, 0x17, 2);
		return;
	}
	r->lss_stores++;
	r->lss.storing_id = r->lss.next_id;
	r->lss_storing = r->storage == REF_STORING;
	if (!r->lss_storing)
		lss_kept(r, r->storage == REF_STORED);
}

void reference_lss_stored(struct reference *r, bool stored)
{
	r->lss_storing = false;
	lss_kept(r, stored);
	reference_tick(r);
}

static void lss_configuration(struct reference *r, const uint8_t *f)
{
	bool right = f[1] >= 1 && (f[1] <= 127 || f[1] == REF_UNCONFIGURED);

	switch (f[0]) {
	case 0x11:
		if (right)
			r->lss.next_id = f[1];
		lss_respond(r, 0x11, right ? 0 : 1);
		break;
	case 0x13:
		lss_bit_timing(r, f[1], f[2]);
		break;
	case 0x15:
		if (!r->lss.bit_s)
			break;
		ref_sdo_stop(r);
		r->lss.phase = 1;
		r->lss.delay_us = (unsigned)(f[1] | f[2] << 8) * 1000u;
		r->lss.phase_end_us = r->now_us + r->lss.delay_us;
		break;
	case 0x17:
		lss_store(r);
		break;
	case 0x5A:
	case 0x5B:
	case 0x5C:
	case 0x5D:
		lss_respond(r, f[0], ref_value(r, 0x1018, (uint8_t)(f[0] - 0x59)));
		break;
	case 0x5E:
		lss_respond(r, 0x5E, r->node_id);
		break;
	default:
		break;
	}
}

static void lss_global(struct reference *r, uint8_t mode)
{
	bool ends = r->lss.configuring && mode == 0;

	if (mode > 1)
		return;
	r->lss.configuring = mode == 1;
	if (ends && r->node_id == REF_UNCONFIGURED && r->lss.next_id != REF_UNCONFIGURED)
		ref_reset(r, false);
}

void ref_lss_receive(struct reference *r, const struct can_msg *msg)
{
	const uint8_t *f = msg->data;

	if (msg->len != 8)
		return;
	if (f[0] == 0x04)
		lss_global(r, f[1]);
	else if (f[0] >= 0x40 && f[0] <= 0x43)
		lss_selective(r, f[0] - 0x3F, ref_u32(f + 1));
	else if (f[0] >= 0x46 && f[0] <= 0x4B)
		lss_identify(r, f[0] - 0x46, ref_u32(f + 1));
	else if (f[0] == 0x4C && unconfigured(r))
		lss_respond(r, 0x50, 0);
	else if (f[0] == 0x51)
		lss_fastscan(r, f);
	else if (r->lss.configuring)
		lss_configuration(r, f);
}

uint64_t ref_lss_tick(struct reference *r)
{
	if (r->lss.phase == 1 && r->now_us >= r->lss.phase_end_us) {
		r->lss.active_bit_s = r->lss.bit_s;
		r->lss.phase = 2;
		r->lss.phase_end_us = r->now_us + r->lss.delay_us;
	}
	if (r->lss.phase == 2 && r->now_us >= r->lss.phase_end_us) {
		r->lss.phase = 0;
		r->guarded = false;
		r->sync_missing_us = 0;
		for (unsigned i = 0; i < REF_CONSUMERS; i++)
			r->consumer[i].alive = false;
		for (unsigned n = 0; n < REF_RPDOS; n++)
			r->rpdo[n].monitored = false;
	}
	return r->lss.phase ? r->lss.phase_end_us : UINT64_MAX;
}

/* ---- the device -------------------------------------------------------------------------------------------------- */

void reference_init(struct reference *r, uint8_t node_id, uint64_t now_us)
{
	memset(r, 0, sizeof(*r));
	r->now_us = now_us;
	r->node_id = node_id;
	r->lss.start_id = r->lss.stored_id = r->lss.next_id = node_id;
	add_communication(r);
	add_rpdos(r);
	add_tpdos(r);
	add_application(r);
	qsort(r->objects, r->object_count, sizeof(r->objects[0]), compare);
	reset_objects(r, true);
	ref_sdo_stop(r);
	for (uint16_t channel = 0x1201; channel <= 0x1207; channel++)
		ref_sdo_open(r, channel);
}

void reference_start(struct reference *r)
{
	boot(r);
	reference_tick(r);
}

static void dispatch(struct reference *r, const struct can_msg *msg)
{
	if (msg->id == 0x000)
		nmt(r, msg);
	else if (consumes_sync(r, msg->id))
		sync(r, msg);
	else if (ref_sdo_receive(r, msg))
		return;
	else if (msg->id == 0x7E5)
		ref_lss_receive(r, msg);
	else if (ref_value(r, 0x1012, 0) & INVALID && (ref_value(r, 0x1012, 0) & 0x7FF) == msg->id)
		time_of_day(r, msg);
	else if (is_own_id(r, msg->id))
		collide(r, msg->id);
	else if (msg->id > 0x700)
		heartbeat_of(r, msg);
	else
		ref_pdo_receive(r, msg);
}

void reference_receive(struct reference *r, const struct can_msg *msg)
{
	if (ref_lss_silent(r) || msg->extended)
		return;
	if (r->node_id == REF_UNCONFIGURED || r->state == INITIALISING) {
		if (msg->id == 0x7E5 && !msg->remote)
			ref_lss_receive(r, msg);
	} else if (!msg->remote) {
		dispatch(r, msg);
	} else if (msg->id == 0x700u + r->node_id) {
		guard(r);
	} else {
		ref_pdo_remote(r, msg->id);
	}
	reference_tick(r);
}

/* Timeouts first, which may change the NMT state; errors last. */
uint64_t reference_tick(struct reference *r)
{
	uint64_t next = ref_lss_tick(r);

	if (ref_lss_silent(r))
		return next;
	next = ref_earlier(next, consumer_tick(r));
	next = ref_earlier(next, guard_tick(r));
	next = ref_earlier(next, heartbeat_tick(r));
	next = ref_earlier(next, sync_tick(r));
	next = ref_earlier(next, ref_pdo_tick(r));
	next = ref_earlier(next, errors_tick(r));
	return ref_earlier(next, ref_sdo_tick(r));
}

void reference_run(struct reference *r, uint64_t us)
{
	uint64_t end_us = r->now_us + us;

	for (uint64_t next = reference_tick(r); next <= end_us; next = reference_tick(r))
		r->now_us = next;
	r->now_us = end_us;
	reference_tick(r);
}

void reference_error_set(struct reference *r, uint16_t code, uint8_t bits)
{
	ref_error_set(r, code, 0, bits, (const uint8_t[5]){0});
	reference_tick(r);
}

void reference_error_clear(struct reference *r, uint16_t code)
{
	ref_error_clear(r, code, 0);
	reference_tick(r);
}

void reference_store_done(struct reference *r, bool stored)
{
	r->store_pending = false;
	ref_sdo_done(r, stored);
	reference_tick(r);
}

#include "tests/scenario/hammer.h"

#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/ascii_gateway.h"
#include "gateway/canopen/sdo_abort.h"
#include "gateway/window.h"
#include "model/sim/rng.h"
#include "od/little_endian.h"
#include "od_index.h"
#include "tests/scenario/world.h"

enum { NODE = WORLD_NODE_ID, ENTRIES_MAX = 1024, ACTIONS_PER_S = 4, SAMPLES_PER_S = 100 };
enum channel { MODBUS, OBJECT, TEXT, SDO, CHANNELS };

struct value {
	uint8_t wire[8];
};

struct hammer {
	struct world world;
	struct modbus_link link;
	struct modbus_access access;
	struct cia309 gateway;
	struct cia309_session *client;
	struct value now[ENTRIES_MAX], stored[ENTRIES_MAX], defaults[ENTRIES_MAX]; /* by entry, where it is stored */
	bool touched[ENTRIES_MAX];
	struct rng rng;
	unsigned sequence;
	struct hammer_count count;
};

static unsigned roll(struct hammer *h, unsigned sides)
{
	return (unsigned)(rng_uniform(&h->rng) * sides) % sides;
}

static const struct od_entry *entry_of(unsigned i)
{
	return &imu9_od_table.entries[i];
}

static unsigned find(uint16_t index, uint8_t sub)
{
	return (unsigned)(od_find(&imu9_od_table, index, sub, NULL) - imu9_od_table.entries);
}

static bool in_model(const struct od_entry *e)
{
	return e->access & OD_STORED && e->size > 0 && e->size <= 8 && e->type != OD_VISIBLE_STRING &&
	       e->type != OD_OCTET_STRING;
}

/* Its write changes this value and no other one, and no write of another one changes it: not the lever arm in um, which
 * is another form of 2000h, nor presets; nor objects of CiA 301 and 410 with a service behind them. */
static bool independent(const struct od_entry *e)
{
	return in_model(e) && (e->access & OD_WRITE) && e->index >= 0x2000 && e->index < 0x6000 &&
	       e->index != OD_INDEX_LEVER_ARM_IN_UM && e->index != OD_INDEX_PDO_PRESET &&
	       !(e->index == OD_INDEX_POSITION && e->sub == OD_SUB_POSITION_MOTION_PRESET);
}

/* ---- the windows ------------------------------------------------------------------------------------------------- */

static void serve(void *ctx)
{
	struct hammer *h = ctx;

	window_execute(&h->link, &h->world.device, h->world.now_us);
}

static uint8_t response[MODBUS_PDU_MAX];

static bool request(struct hammer *h, const uint8_t *pdu, size_t size)
{
	size_t n = modbus_pdu(&h->access.registers, pdu, size, response);

	assert_true(n >= 2);
	return !(response[0] & 0x80);
}

/* The registers of a value. Their number, 0: it has none. */
static unsigned registers_of(const struct hammer *h, unsigned i, uint16_t *address, const uint8_t *wire, uint8_t *out)
{
	const struct od_entry *e = entry_of(i);
	unsigned count = (e->size + 1u) / 2;

	for (unsigned p = 0; p < imu9_modbus_map.point_count; p++) {
		const struct modbus_point *point = &imu9_modbus_map.points[p];

		if (point->entry != i || point->address < 0x1000)
			continue;
		*address = point->address;
		if (e->size == 1) {
			out[0] = e->type == OD_INTEGER8 && wire[0] & 0x80 ? 0xFF : 0;
			out[1] = wire[0];
			return 1;
		}
		bool low_first = h->now[find(OD_INDEX_MODBUS, OD_SUB_MODBUS_WORD_ORDER)].wire[0];
		for (unsigned k = 0; k < count; k++) {
			unsigned word = low_first ? k : count - 1 - k;

			out[2 * k] = wire[2 * word + 1];
			out[2 * k + 1] = wire[2 * word];
		}
		return count;
	}
	return 0;
}

static bool write_registers(struct hammer *h, uint16_t address, unsigned count, const uint8_t *registers)
{
	uint8_t pdu[MODBUS_PDU_MAX] = {
		16, (uint8_t)(address >> 8), (uint8_t)address, 0, (uint8_t)count, (uint8_t)(2 * count)};

	memcpy(pdu + 6, registers, (size_t)2 * count);
	return request(h, pdu, 6 + (size_t)2 * count);
}

static size_t object_header(uint8_t *pdu, uint8_t control, uint16_t index, uint8_t sub, size_t count)
{
	const uint8_t header[] = {
		0x2B, 0x0D, control, NODE, (uint8_t)(index >> 8), (uint8_t)index, sub, 0, 0, 0, (uint8_t)count};

	memcpy(pdu, header, sizeof(header));
	return sizeof(header);
}

static bool write_object(struct hammer *h, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	uint8_t pdu[MODBUS_PDU_MAX];
	size_t n = object_header(pdu, 1, index, sub, size);

	memcpy(pdu + n, wire, size);
	return request(h, pdu, n + size);
}

/* One line of CiA 309-3. The answer has its sequence number, or the line is empty. */
static bool say(struct hammer *h, const char *command, char *answer, size_t capacity)
{
	char line[128];
	size_t n, used = 0;

	snprintf(line, sizeof(line), "[%u] %s\n", ++h->sequence, command);
	cia309_input(h->client, line, strlen(line));
	for (int i = 0; i < 1000; i++) {
		cia309_tick(&h->gateway, h->world.now_us);
		const char *out = cia309_output(h->client, &n);
		assert_true(used + n < capacity);
		memcpy(answer + used, out, n);
		cia309_sent(h->client, n);
		used += n;
		answer[used] = '\0';
		if (used > 0 && answer[used - 1] == '\n')
			break;
		world_sample(&h->world);
	}
	snprintf(line, sizeof(line), "[%u] OK\r\n", h->sequence);
	return strcmp(answer, line) == 0;
}

static bool tell(struct hammer *h, const char *command)
{
	char answer[256];

	return say(h, command, answer, sizeof(answer));
}

static bool write_text(struct hammer *h, const struct od_entry *e, const uint8_t *wire)
{
	static const char *const TYPES[] = {[OD_BOOLEAN] = "b",
		[OD_INTEGER8] = "i8",
		[OD_INTEGER16] = "i16",
		[OD_INTEGER32] = "i32",
		[OD_UNSIGNED8] = "u8",
		[OD_UNSIGNED16] = "u16",
		[OD_UNSIGNED32] = "u32",
		[OD_REAL32] = "r32",
		[OD_REAL64] = "r64",
		[OD_INTEGER64] = "i64",
		[OD_UNSIGNED64] = "u64"};
	char text[64], command[120];

	assert_true(od_format(e, wire, e->size, text, sizeof(text)) > 0);
	snprintf(command, sizeof(command), "%u w 0x%X %u %s %s", NODE, e->index, e->sub, TYPES[e->type], text);
	return tell(h, command);
}

/* ---- the model --------------------------------------------------------------------------------------------------- */

static void look(const struct hammer *h, struct value *values)
{
	for (unsigned i = 0; i < imu9_od_table.count; i++)
		if (in_model(entry_of(i)))
			od_get(&h->world.device.od, entry_of(i), values[i].wire, sizeof(values[i].wire));
}

static void compare(struct hammer *h)
{
	for (unsigned i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = entry_of(i);
		uint8_t wire[8];

		if (!in_model(e))
			continue;
		od_get(&h->world.device.od, e, wire, sizeof(wire));
		if (memcmp(wire, h->now[i].wire, e->size) != 0)
			fail_msg("%s is not what was acknowledged", e->name);
		h->count.compared++;
	}
}

static void acknowledged(struct hammer *h, unsigned i, const uint8_t *wire)
{
	memcpy(h->now[i].wire, wire, entry_of(i)->size);
	h->touched[i] = true;
}

static void after_reset(struct hammer *h, bool all)
{
	for (unsigned i = 0; i < imu9_od_table.count; i++)
		if (all || entry_of(i)->index < 0x2000)
			h->now[i] = h->stored[i];
	h->count.resets++;
}

/* ---- actions ----------------------------------------------------------------------------------------------------- */

static double limit(const struct od_entry *e, union od_number n)
{
	return e->type == OD_REAL32 || e->type == OD_REAL64	   ? n.f
	       : e->type <= OD_INTEGER32 && e->type >= OD_INTEGER8 ? (double)n.i
								   : (double)n.u;
}

/* A value, mostly within the limits. False: it is beyond them. */
static bool any_value(struct hammer *h, const struct od_entry *e, uint8_t *wire)
{
	bool real = e->type == OD_REAL32, has_low = e->access & OD_LIMIT_LOW, has_high = e->access & OD_LIMIT_HIGH;
	double low = has_low ? limit(e, e->low) : 0, high = has_high ? limit(e, e->high) : low + 100;
	double x = low + (high - low) * rng_uniform(&h->rng);
	bool good = roll(h, 5) > 0 || !has_high;
	float f;

	if (!good)
		x = high + 1 + high * rng_uniform(&h->rng);
	if (real) {
		f = (float)x;
		memcpy(wire, &f, sizeof(f));
		return good;
	}
	if (!good && x >= ldexp(1, 8 * e->size - (e->type <= OD_INTEGER32)))
		x = floor(low + (high - low) * rng_uniform(&h->rng)), good = true;
	long long n = llrint(floor(x));
	for (unsigned k = 0; k < e->size; k++)
		wire[k] = (uint8_t)(n >> 8 * k);
	return good;
}

static void write_one(struct hammer *h)
{
	unsigned i, n;
	uint16_t address;
	uint8_t wire[8] = {0}, registers[8];
	bool done = false;

	do
		i = roll(h, (unsigned)imu9_od_table.count);
	while (!independent(entry_of(i)));
	const struct od_entry *e = entry_of(i);
	enum channel by = (enum channel)roll(h, CHANNELS);
	bool good = any_value(h, e, wire);

	if (by == SDO && e->size > 4)
		by = OBJECT;
	if (by == MODBUS && (n = registers_of(h, i, &address, wire, registers)) == 0)
		by = OBJECT;
	if (by == MODBUS)
		done = write_registers(h, address, n, registers);
	else if (by == OBJECT)
		done = write_object(h, e->index, e->sub, wire, e->size);
	else if (by == TEXT)
		done = write_text(h, e, wire);
	else
		done = world_sdo_write(&h->world, e->index, e->sub, wire, e->size) == 0;
	if (done && !good)
		fail_msg("%s takes a value beyond its limits", e->name);
	h->count.written[by] += done;
	h->count.refused += !done;
	if (done)
		acknowledged(h, i, wire);
}

/* The lever arm at once, all of it or nothing. */
static void write_block(struct hammer *h)
{
	const unsigned first = find(OD_INDEX_LEVER_ARM, 1);
	uint8_t wire[3][8], registers[12];
	uint16_t address, start = 0;
	bool good = true;

	for (unsigned k = 0; k < 3; k++) {
		good = any_value(h, entry_of(first + k), wire[k]) && good;
		registers_of(h, first + k, &address, wire[k], registers + (size_t)4 * k);
		if (k == 0)
			start = address;
	}
	assert_int_equal(write_registers(h, start, 6, registers), good);
	for (unsigned k = 0; good && k < 3; k++)
		acknowledged(h, first + k, wire[k]);
	h->count.blocks++;
}

static void read_one(struct hammer *h)
{
	uint8_t pdu[MODBUS_PDU_MAX];
	unsigned i;

	do
		i = roll(h, (unsigned)imu9_od_table.count);
	while (!in_model(entry_of(i)) || !(entry_of(i)->access & OD_READ));
	const struct od_entry *e = entry_of(i);
	assert_true(request(h, pdu, object_header(pdu, 0, e->index, e->sub, 240)));
	assert_memory_equal(response + 11, h->now[i].wire, e->size);
	h->count.read++;
}

static bool write_by(struct hammer *h, enum channel by, uint16_t index, uint8_t sub, uint32_t value)
{
	const struct od_entry *e = od_find(&imu9_od_table, index, sub, NULL);
	uint8_t wire[8] = {0};
	bool done;

	put_u32(wire, value);
	if (by == TEXT)
		done = write_text(h, e, wire);
	else if (by == SDO)
		done = world_sdo_write(&h->world, index, sub, wire, e->size) == 0;
	else
		done = write_object(h, index, sub, wire, e->size);
	if (done && in_model(e))
		acknowledged(h, find(index, sub), wire);
	return done;
}

/* A TPDO as CiA 301 says, with one to four values of 16 bits. */
static void remap(struct hammer *h)
{
	const uint8_t pdo = (uint8_t)roll(h, 4);
	const uint16_t parameter = 0x1800 + pdo, mapping = 0x1A00 + pdo;
	const enum channel by = (enum channel)(OBJECT + roll(h, CHANNELS - OBJECT));
	const uint32_t cob_id = 0x40000180u + 0x100u * pdo + NODE;
	const uint8_t count = (uint8_t)(1 + roll(h, 4));

	assert_true(write_by(h, by, parameter, 1, cob_id | 0x80000000u));
	assert_true(write_by(h, by, mapping, 0, 0));
	for (uint8_t k = 1; k <= count; k++)
		assert_true(
			write_by(h, by, mapping, k, 0x21000010u + 0x10000u * roll(h, 3) + 0x100u * (1 + roll(h, 3))));
	assert_false(write_by(h, by, mapping, count, 0x10080020)); /* a string is not mappable */
	assert_true(write_by(h, by, mapping, 0, count));
	assert_true(write_by(h, by, parameter, 1, cob_id));
	h->count.remaps++;
}

static void store_or_restore(struct hammer *h, bool restore)
{
	static const uint8_t SAVE[] = "save", LOAD[] = "load", COIL[] = {5, 0, 1, 0xFF, 0};
	const unsigned how = roll(h, 4);
	const uint16_t index = restore ? 0x1011 : 0x1010;
	const uint8_t *word = restore ? LOAD : SAVE;
	char command[40];
	bool done;

	snprintf(command, sizeof(command), "%u w 0x%X 1 vs %s", NODE, index, (const char *)word);
	if (how == 0 && !restore)
		done = request(h, COIL, sizeof(COIL));
	else if (how == 1)
		done = write_object(h, index, 1, word, 4);
	else if (how == 2)
		done = tell(h, command);
	else
		done = world_sdo_write(&h->world, index, 1, word, 4) == 0;
	assert_true(done);
	memcpy(h->stored, restore ? h->defaults : h->now, sizeof(h->stored));
	h->count.stores += !restore;
	h->count.restores += restore;
}

/* A stopped node answers no SDO: the next command of the network takes it out of that state. */
static void network(struct hammer *h)
{
	static const char *const COMMANDS[] = {"start", "preop", "stop", "reset node", "reset comm"};
	const unsigned which = roll(h, 5);
	char command[40];

	snprintf(command, sizeof(command), "%u %s", NODE, COMMANDS[which]);
	assert_true(tell(h, command));
	world_samples(&h->world, 5);
	if (which >= 3)
		after_reset(h, which == 3);
	if (which == 2) {
		read_one(h);
		snprintf(command, sizeof(command), "%u preop", NODE);
		assert_true(tell(h, command));
	}
}

static void act(struct hammer *h)
{
	const unsigned die = roll(h, 1000);

	if (die < 600)
		write_one(h);
	else if (die < 700)
		write_block(h);
	else if (die < 960)
		read_one(h);
	else if (die < 975)
		remap(h);
	else if (die < 985)
		store_or_restore(h, false);
	else if (die < 987)
		store_or_restore(h, true);
	else
		network(h);
}

/* ---- a life ------------------------------------------------------------------------------------------------------ */

struct hammer_count hammer(unsigned seconds, uint64_t seed)
{
	struct hammer *h = calloc(1, sizeof(*h));
	size_t heap = 0;

	assert_non_null(h);
	assert_true(imu9_od_table.count <= ENTRIES_MAX);
	rng_init(&h->rng, seed);
	world_init(&h->world, sensor_preset("ideal"), seed, "tumble");
	world_power_on(&h->world, NULL);
	modbus_link_direct(&h->link, serve, h);
	modbus_access_init(&h->access, &h->link, &imu9_modbus_map, &imu9_od_table, "hammer", true, sdo_abort_code);
	h->access.registers.node_id = NODE;
	ascii_gateway_init(&h->gateway, &h->world.device, &h->world.bus);
	h->client = cia309_open(&h->gateway, "hammer", true);
	look(h, h->defaults);
	memcpy(h->now, h->defaults, sizeof(h->now));
	memcpy(h->stored, h->defaults, sizeof(h->stored));

	for (unsigned s = 0; s < seconds; s++) {
		for (int k = 0; k < ACTIONS_PER_S; k++) {
			world_samples(&h->world, SAMPLES_PER_S / ACTIONS_PER_S);
			modbus_link_publish(&h->link, &h->world.device.values);
			act(h);
			modbus_link_publish(&h->link, &h->world.device.values);
		}
		if (s % 10 == 0)
			compare(h);
		if (s == seconds / 10)
			heap = mallinfo2().uordblks;
	}
	compare(h);
	for (unsigned i = 0; i < ENTRIES_MAX; i++)
		h->count.objects += h->touched[i];
	h->count.grown = (long)mallinfo2().uordblks - (long)heap;
	struct hammer_count count = h->count;
	free(h);
	return count;
}

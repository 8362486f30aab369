/* Random frames, time, samples, errors and storage. In ten thousand short sequences of a seeded generator, which makes
 * legal and illegal requests of a master, each frame and each value of the core is compared with that of a model
 * (reference.h), and the node serves NMT and SDO afterwards. In a hundred thousand steps of random bytes the node sends
 * only what its NMT state allows, has a deadline in the future, and serves NMT and SDO afterwards.
 *
 * IMU9_SEED=N repeats one sequence; IMU9_SEQUENCES=N sets their number. */
#include "tests/scenario/bus.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/scenario/reference.h"

enum { STEPS = 100000 };

/* xorshift32: the same steps on every machine */
static uint32_t next(uint32_t *seed)
{
	*seed ^= *seed << 13;
	*seed ^= *seed >> 17;
	*seed ^= *seed << 5;
	return *seed;
}

enum { BOOT_UP_US = 10000 }; /* from a reset */

static uint32_t below(uint32_t *seed, uint32_t n)
{
	return next(seed) % n;
}

static void fill(uint32_t *seed, uint8_t *data)
{
	for (int i = 0; i < 8; i++)
		data[i] = (uint8_t)next(seed);
}

static struct can_msg garbage(uint32_t *seed)
{
	struct can_msg msg = {.id = below(seed, 0x800),
		.len = (uint8_t)below(seed, 9),
		.extended = below(seed, 8) == 0,
		.remote = below(seed, 8) == 0};

	fill(seed, msg.data);
	return msg;
}

static struct can_msg nmt(uint32_t *seed)
{
	static const uint8_t commands[] = {1, 1, 1, 2, 128, 128, 129, 130, 0, 255};
	struct can_msg msg = {.id = 0x000, .len = 2};

	msg.data[0] = commands[below(seed, sizeof(commands))];
	msg.data[1] = (uint8_t)(below(seed, 3) * BUS_NODE_ID);
	return msg;
}

/* A request of any kind, mostly for an existing object and with a meaningful value. */
static struct can_msg sdo(uint32_t *seed, const struct od_table *table)
{
	static const uint8_t commands[] = {0x40, 0x40, 0x23, 0x27, 0x2B, 0x2F, 0x22, 0x21, 0x20, 0x60, 0x70, 0x00, 0x10,
		0x01, 0x11, 0x0D, 0x80, 0xA0, 0xA4, 0xA1, 0xA2, 0xA3, 0xC0, 0xC2, 0xC6, 0xE0};
	static const uint32_t values[] = {0, 1, 2, 3, 4, 100, 254, 255, 0x80000190, 0x40000190, 0xC0000290, 0x80,
		0x21000110, 0x210F0220, 0x10010008, 0x21080120, 0x65766173, 0x64616F6C};
	const struct od_entry *entry = &table->entries[below(seed, (uint32_t)table->count)];
	struct can_msg msg = {.id = 0x600 + BUS_NODE_ID, .len = 8};

	while (below(seed, 2) && entry->index >= 0x2000) /* objects of the core more often */
		entry = &table->entries[below(seed, (uint32_t)table->count)];
	fill(seed, msg.data);
	if (below(seed, 4)) {
		uint32_t value = values[below(seed, sizeof(values) / sizeof(values[0]))];

		msg.data[0] = commands[below(seed, sizeof(commands))];
		msg.data[1] = (uint8_t)entry->index;
		msg.data[2] = (uint8_t)(entry->index >> 8);
		msg.data[3] = entry->sub;
		for (int i = 0; i < 4; i++)
			msg.data[4 + i] = (uint8_t)(value >> 8 * i);
	}
	if (below(seed, 20) == 0)
		msg.len = (uint8_t)below(seed, 9);
	return msg;
}

static struct can_msg sync(uint32_t *seed)
{
	struct can_msg msg = {.id = 0x080, .len = (uint8_t)(below(seed, 8) == 0), .t_us = 1};

	msg.data[0] = (uint8_t)below(seed, 242);
	return msg;
}

/* Every service but the one that changes the node-ID: the end of this test uses node 10h. */
static struct can_msg lss(uint32_t *seed)
{
	static const uint8_t commands[] = {0x04, 0x04, 0x13, 0x15, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x47, 0x48, 0x49,
		0x4A, 0x4B, 0x4C, 0x51, 0x5A, 0x5D, 0x5E, 0x5F, 0xFF};
	static const uint32_t values[] = {0, 1, 0x0200, 0x00494D55, 9, OD_REVISION, 0xFFFFFFFF};
	uint32_t value = values[below(seed, sizeof(values) / sizeof(values[0]))];
	struct can_msg msg = {.id = 0x7E5, .len = 8};

	fill(seed, msg.data);
	msg.data[0] = commands[below(seed, sizeof(commands))];
	for (int i = 0; i < 4; i++)
		msg.data[1 + i] = (uint8_t)(value >> 8 * i);
	return msg;
}

static void run_a_while(struct bus *bus, uint32_t *seed)
{
	uint64_t end_us = bus->now_us + below(seed, 1u << below(seed, 22));

	for (int i = 0; i < 100 && bus->deadline_us <= end_us; i++) /* event timers may be short: not every deadline */
		bus_run(bus, bus->deadline_us - bus->now_us);
	if (bus->deadline_us > end_us)
		bus_run(bus, end_us - bus->now_us);
}

static void step(struct bus *bus, uint32_t *seed)
{
	static const enum od_status answers[] = {OD_OK, OD_PENDING, OD_CANNOT_STORE};
	struct can_msg msg;

	switch (below(seed, 13)) {
	case 0:
		msg = garbage(seed);
		break;
	case 1:
		msg = nmt(seed);
		break;
	case 2:
	case 3:
	case 4:
	case 5:
	case 6:
		msg = sdo(seed, bus->od.table);
		break;
	case 7:
	case 8:
		msg = sync(seed);
		break;
	case 12:
		msg = lss(seed);
		break;
	case 9:
		bus_sample(bus, (uint16_t)next(seed));
		return;
	case 10:
		if (below(seed, 2))
			canopen_error_set(&bus->node, (uint16_t)(0xFF00 + below(seed, 20)), (uint8_t)next(seed), NULL,
				bus->now_us);
		else
			canopen_error_clear(&bus->node, (uint16_t)(0xFF00 + below(seed, 20)), bus->now_us);
		bus_tick(bus);
		return;
	default:
		bus->storage_answer = answers[below(seed, 3)];
		if (below(seed, 4) == 0)
			canopen_store_done(&bus->node, OD_OK, bus->now_us);
		run_a_while(bus, seed);
		return;
	}
	bus_send_msg(bus, &msg);
}

/* CiA 301, table 37. PDO, SYNC and EMCY cannot have one of these identifiers. */
static void check_sent_frames(const struct bus *bus)
{
	enum nmt_state now = canopen_nmt_state(&bus->node);

	for (size_t i = 0; i < bus->sent_count; i++) {
		const struct can_msg *msg = &bus->sent[i].msg;

		if (msg->id == 0x700 + BUS_NODE_ID) {
			assert_int_equal(msg->len, 1);
			assert_true(msg->data[0] == 0 || msg->data[0] == (uint8_t)now);
			continue;
		}
		if (msg->id == 0x7E4) {
			assert_int_equal(msg->len, 8);
			continue;
		}
		assert_true(now == NMT_PRE_OPERATIONAL || now == NMT_OPERATIONAL);
		assert_true(msg->id != 0x000 && (msg->id & 0x780) != 0x600);
		if (msg->id == 0x580 + BUS_NODE_ID)
			assert_int_equal(msg->len, 8);
	}
}

/* During a switch of the bit rate the node sends nothing for up to two minutes. */
static void wait_for_the_bit_rate(struct bus *bus)
{
	while (bus->node.lss.switching)
		bus_run(bus, bus->deadline_us - bus->now_us);
}

static void test_random_steps_neither_break_nor_block_the_node(void **state)
{
	struct bus *bus = *state;
	uint32_t seed = 20261122;

	for (int i = 0; i < STEPS; i++) {
		step(bus, &seed);
		assert_true(bus->deadline_us > bus->now_us);
		check_sent_frames(bus);
		bus->sent_count = bus->seen = 0;
		if (below(&seed, 8) == 0)
			wait_for_the_bit_rate(bus);
		if (i % 1000)
			continue;
		wait_for_the_bit_rate(bus);
		bus_run(bus, BOOT_UP_US);
		bus_send(bus, "610 80 00 00 00 00 00 00 00");
		bus_send(bus, "000 80 10");
		bus_forget(bus);
		bus_send(bus, "610 40 00 10 00 00 00 00 00");
		bus_expect(bus, "590 43 00 10 00 9A 01 04 00");
		bus->sent_count = bus->seen = 0;
	}
	wait_for_the_bit_rate(bus);
	bus_run(bus, BOOT_UP_US);
	bus_forget(bus);
	bus_reset(bus, "000 81 10", "710 00");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	bus_exchange(bus, "610 2F 01 20 00 01 00 00 00", "590 60 01 20 00 00 00 00 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	assert_int_equal(bus->sent_count - bus->seen, 4);
}

/* ---- sequences against the model --------------------------------------------------------------------------------- */

enum { SEQUENCES = 10000, SEQUENCE_STEPS = 150, PLAN_MAX = 256, LONG_DOMAIN = 1000 };

struct random_step {
	enum random_step_kind {
		SEND,
		WAIT,
		SAMPLE,
		RAISE,
		CLEAR,
		STORAGE,
		STORE_DONE,
		LSS_STORED,
		BUS_OFF,
		STEP_KINDS
	} kind;
	struct can_msg msg;
	uint32_t a, b;
};

struct sequence {
	uint32_t seed;
	struct random_step step[SEQUENCE_STEPS];
	size_t count;
	char what[400]; /* the deviation */
};

/* The core and the model side by side. */
struct pair {
	struct bus *bus;
	struct reference *reference;
	size_t seen; /* of the expected frames of the model */
	uint8_t domain[OD_DOMAIN_MAX];
	size_t domain_size;
	struct od_domain long_domain, short_domain;
	const char *text;		    /* 1009h of the core */
	const uint8_t *values[REF_OBJECTS]; /* of the core, by object of the model */
};

static uint8_t long_domain[LONG_DOMAIN];

static size_t read_domain(void *ctx, uint8_t *out)
{
	const struct pair *p = ctx;

	memcpy(out, p->domain, p->domain_size);
	return p->domain_size;
}

static enum od_status write_domain(void *ctx, const uint8_t *data, size_t size)
{
	struct pair *p = ctx;

	memcpy(p->domain, data, size);
	p->domain_size = size;
	return OD_OK;
}

static void pair_start(struct pair *p)
{
	struct bus *bus = bus_new();
	struct reference *r = p->reference;

	p->bus = bus;
	p->seen = p->domain_size = 0;
	p->text = bus_writable_string(bus);
	p->long_domain = (struct od_domain){.index = 0x1021, .data = long_domain, .size = LONG_DOMAIN};
	p->short_domain = (struct od_domain){.index = 0x2130, .read = read_domain, .write = write_domain, .ctx = p};
	od_set_domain(&bus->od, &p->long_domain);
	od_set_domain(&bus->od, &p->short_domain);
	reference_init(r, BUS_NODE_ID, bus->now_us);
	r->long_domain = long_domain;
	for (size_t i = 0; i < r->object_count; i++) {
		const struct reference_object *o = &r->objects[i];

		p->values[i] =
			o->flags & (REF_STRING | REF_DOMAIN) ? NULL : od_value(&bus->od, o->index, o->sub, o->size);
	}
	bus_start(bus);
	reference_start(r);
}

static void pair_end(struct pair *p)
{
	test_free(p->bus);
}

/* ---- comparing --------------------------------------------------------------------------------------------------- */

static bool same_frame(const struct can_msg *a, const struct can_msg *b)
{
	return a->id == b->id && a->len == b->len && !a->remote && memcmp(a->data, b->data, a->len) == 0;
}

static void write_frame(char *text, size_t size, const struct can_msg *msg)
{
	int n = snprintf(text, size, "%03X%s", (unsigned)msg->id, msg->remote ? " R" : "");

	for (int i = 0; i < msg->len; i++)
		n += snprintf(text + n, size - (size_t)n, " %02X", msg->data[i]);
}

/* The core may spread the segments of a sub-block over some microseconds, the more channels the more. */
enum { BLOCK_US = 100 };

static bool same_time(const struct reference *r, uint64_t a, uint64_t b, uint32_t id)
{
	uint64_t apart = a > b ? a - b : b - a;
	bool sdo = false;

	for (int i = 0; i < REF_CHANNELS; i++)
		sdo |= id == r->sdo[i].response;
	return apart <= (sdo ? BLOCK_US : 0);
}

static bool deviates(struct sequence *s, const char *why, const struct can_msg *sent, const struct can_msg *expected)
{
	char a[40] = "nothing", b[40] = "nothing";

	if (sent)
		write_frame(a, sizeof(a), sent);
	if (expected)
		write_frame(b, sizeof(b), expected);
	snprintf(s->what, sizeof(s->what), "%s: sent %s, expected %s", why, a, b);
	return false;
}

/* In order for each identifier; services may send in any order at one time. */
static bool same_frames(struct pair *p, struct sequence *s)
{
	struct bus *bus = p->bus;
	const struct reference *r = p->reference;
	static bool taken[BUS_FRAMES];

	memset(taken, 0, bus->sent_count);
	for (size_t i = 0; i < r->expected_count; i++) {
		const struct can_msg *expected = &r->expected[i].msg;
		size_t k = 0;

		while (k < bus->sent_count && (taken[k] || bus->sent[k].msg.id != expected->id))
			k++;
		if (k == bus->sent_count)
			return deviates(s, "a frame is missing", NULL, expected);
		if (!same_frame(&bus->sent[k].msg, expected))
			return deviates(s, "another frame", &bus->sent[k].msg, expected);
		if (!same_time(r, bus->sent[k].t_us, r->expected[i].t_us, expected->id))
			return deviates(s, "at another time", &bus->sent[k].msg, expected);
		taken[k] = true;
	}
	for (size_t k = 0; k < bus->sent_count; k++)
		if (!taken[k])
			return deviates(s, "a frame too many", &bus->sent[k].msg, NULL);
	return true;
}

static uint32_t value_in(const uint8_t *at, size_t size)
{
	uint16_t u16;
	uint32_t u32;

	if (size == 1)
		return *at;
	memcpy(&u16, at, 2);
	memcpy(&u32, at, size == 4 ? 4 : 2);
	return size == 2 ? u16 : u32;
}

static bool differs(struct sequence *s, const char *what, uint32_t is, uint32_t expected)
{
	if (is == expected)
		return false;
	snprintf(s->what, sizeof(s->what), "%s: %Xh, expected %Xh", what, (unsigned)is, (unsigned)expected);
	return true;
}

static bool same_objects(struct pair *p, struct sequence *s)
{
	const struct reference *r = p->reference;
	char what[32];

	for (size_t i = 0; i < r->object_count; i++) {
		const struct reference_object *o = &r->objects[i];

		if (!p->values[i] || value_in(p->values[i], o->size) == o->value)
			continue;
		snprintf(what, sizeof(what), "object %04Xh:%02X", o->index, o->sub);
		return !differs(s, what, value_in(p->values[i], o->size), o->value);
	}
	return true;
}

static bool same_state(struct pair *p, struct sequence *s)
{
	const struct reference *r = p->reference;
	const struct bus *bus = p->bus;

	return !differs(s, "NMT state", canopen_nmt_state(&bus->node), r->state) &&
	       !differs(s, "node-ID", bus->node.id, r->node_id) &&
	       !differs(s, "LSS configuration", bus->node.lss.configuring, r->lss.configuring) &&
	       !differs(s, "node-ID to come", bus->node.lss.node_id, r->lss.next_id) &&
	       !differs(s, "bit rate", bus->active_bit_s, r->lss.active_bit_s) &&
	       !differs(s, "stores", bus->store_calls, r->stores) &&
	       !differs(s, "restores", bus->restore_calls, r->restores) &&
	       !differs(s, "LSS stores", bus->store_lss_calls, r->lss_stores) &&
	       !differs(s, "TIME heard", bus->times, r->times) &&
	       !differs(s, "collisions", bus->collisions, r->collisions) &&
	       !differs(s, "1009h", (uint32_t)strncmp(p->text, r->text, 32), 0) &&
	       !differs(s, "bytes of 2130h", (uint32_t)p->domain_size, (uint32_t)r->domain_size) &&
	       !differs(s, "2130h", (uint32_t)memcmp(p->domain, r->domain, p->domain_size), 0);
}

static bool compare(struct pair *p, struct sequence *s)
{
	bool same = same_frames(p, s) && same_state(p, s) && same_objects(p, s);

	if (same && p->bus->deadline_us <= p->bus->now_us)
		same = !differs(s, "deadline", 0, 1);
	p->bus->sent_count = p->bus->seen = p->reference->expected_count = 0;
	return same;
}

/* ---- executing steps --------------------------------------------------------------------------------------------- */

static void wait(struct pair *p, uint64_t us)
{
	bus_run(p->bus, us);
	reference_run(p->reference, us);
}

/* The kernel discards what the receive filter does not have. */
static void give(struct pair *p, struct can_msg msg)
{
	msg.t_us = p->bus->now_us;
	if (msg.extended || bus_listens_to(p->bus, msg.id))
		bus_send_msg(p->bus, &msg);
	reference_receive(p->reference, &msg);
}

static void do_step(struct pair *p, const struct random_step *step)
{
	static const enum od_status answers[] = {OD_OK, OD_PENDING, OD_CANNOT_STORE};
	struct bus *bus = p->bus;
	struct reference *r = p->reference;
	bool stored = step->a;

	switch (step->kind) {
	case SEND:
		give(p, step->msg);
		return;
	case WAIT:
		wait(p, step->a);
		return;
	case SAMPLE:
		bus_put(bus, 0x2100, 1, 2, step->b);
		bus_sample(bus, (uint16_t)step->a);
		reference_sample(r, (uint16_t)step->a, (uint16_t)step->b);
		return;
	case RAISE:
		canopen_error_set(&bus->node, (uint16_t)step->a, (uint8_t)step->b, NULL, bus->now_us);
		reference_error_set(r, (uint16_t)step->a, (uint8_t)step->b);
		break;
	case CLEAR:
		canopen_error_clear(&bus->node, (uint16_t)step->a, bus->now_us);
		reference_error_clear(r, (uint16_t)step->a);
		break;
	case STORAGE:
		bus->storage_answer = answers[step->a];
		r->storage = (enum reference_storage)step->a;
		break;
	case STORE_DONE:
		if (!r->store_pending)
			return;
		canopen_store_done(&bus->node, stored ? OD_OK : OD_CANNOT_STORE, bus->now_us);
		reference_store_done(r, stored);
		break;
	case LSS_STORED:
		if (!r->lss_storing)
			return;
		canopen_lss_stored(&bus->node, stored ? OD_OK : OD_CANNOT_STORE, bus->now_us);
		reference_lss_stored(r, stored);
		break;
	case BUS_OFF:
		canopen_bus_off(&bus->node, bus->now_us);
		reference_bus_off(r);
		break;
	default:
		break;
	}
	bus_tick(bus);
}

/* ---- generating steps -------------------------------------------------------------------------------------------- */

struct generator {
	uint32_t seed;
	struct random_step plan[PLAN_MAX]; /* of a correct client */
	size_t planned, done;
	struct reference *reference;
};

#define PICK(g, list) ((list)[below(&(g)->seed, sizeof(list) / sizeof((list)[0]))])

static void plan_frame(struct generator *g, struct can_msg msg)
{
	if (g->planned < PLAN_MAX)
		g->plan[g->planned++] = (struct random_step){.kind = SEND, .msg = msg};
}

static void plan_wait(struct generator *g, uint32_t us)
{
	if (g->planned < PLAN_MAX)
		g->plan[g->planned++] = (struct random_step){.kind = WAIT, .a = us};
}

static void plan_bytes(struct generator *g, uint32_t id, const uint8_t *data, uint8_t len)
{
	struct can_msg msg = {.id = id, .len = len};

	if (len)
		memcpy(msg.data, data, len);
	plan_frame(g, msg);
}

static uint32_t request_id(struct generator *g)
{
	const struct reference *r = g->reference;

	uint32_t other = r->sdo[below(&g->seed, REF_CHANNELS)].request;

	return other && below(&g->seed, 3) == 0 ? other : 0x600u + r->node_id;
}

static void plan_sdo(struct generator *g, uint32_t id, uint8_t command, uint16_t index, uint8_t sub, uint32_t value)
{
	plan_bytes(g, id,
		(const uint8_t[8]){command, (uint8_t)index, (uint8_t)(index >> 8), sub, (uint8_t)value,
			(uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)},
		8);
}

static void plan_write(struct generator *g, uint16_t index, uint8_t sub, uint32_t value)
{
	const struct reference_object *o = reference_find(g->reference, index, sub);
	uint8_t size = o && o->size < 4 && o->size ? (uint8_t)o->size : 4;

	plan_sdo(g, request_id(g), (uint8_t)(0x23 | (4 - size) << 2), index, sub, value);
}

/* A value for an object of that kind, valid or slightly wrong. */
static uint32_t value_for(struct generator *g, const struct reference_object *o)
{
	static const uint32_t small[] = {0, 1, 2, 3, 4, 7, 8, 20, 100, 240, 241, 251, 252, 253, 254, 255, 1000, 65535};
	static const uint32_t reals[] = {0, 0x3F800000, 0xC1200000, 0x41200001, 0x7F800000, 0x7FC00000, 0x43B40000};
	static const uint32_t cob_ids[] = {0x80, 0x82, 0x40000080, 0xC0000082, 0x181, 0x190, 0x195, 0x210, 0x215, 0x310,
		0x40000190, 0x80000190, 0xC0000190, 0x80000210, 0x80000000, 0x20000190, 0x620, 0x680, 0x690, 0x580,
		0x90, 0x91, 0x80000090, 0x100, 0x80000100, 0xC0000100, 0x6D0, 0x700, 0x7E5, 0x000, 0x800};
	static const uint32_t consumers[] = {0, 0x00050064, 0x00050032, 0x00060032, 0x00070001, 0x00050000, 0x00800064,
		0x01050064, 0x007F00C8, 0x00000064};
	static const uint32_t objects[] = {0x21000110, 0x21000210, 0x21010110, 0x210F0110, 0x210F0220, 0x210F0310,
		0x10010008, 0x21020420, 0x21020520, 0x21020110, 0x20700510, 0x20700120, 0x20720510, 0x20720708,
		0x20730010, 0x20000120, 0x00050008, 0x00060010, 0x00070020, 0x00010001, 0, 0x21000120, 0x21000410,
		0x5FFF0010, 0x10000020};
	static const uint32_t signatures[] = {0x65766173, 0x64616F6C, 0, 0x65766174};
	uint16_t range = o->index & 0xFF00;

	if (o->flags & REF_REAL)
		return PICK(g, reals);
	if (o->index == 0x1010 || o->index == 0x1011)
		return PICK(g, signatures);
	if (o->index == 0x1016)
		return PICK(g, consumers);
	if ((range == 0x1600 || range == 0x1A00) && o->sub)
		return PICK(g, objects);
	if (o->size == 4 && o->index != 0x1006 && o->index != 0x1007 && o->index < 0x2000 && o->index != 0x1F80)
		return PICK(g, cob_ids);
	if (o->index == 0x1006 || o->index == 0x1007)
		return below(&g->seed, 2) ? below(&g->seed, 200000) : PICK(g, small);
	return below(&g->seed, 4) ? PICK(g, small) : next(&g->seed);
}

static const struct reference_object *any_object(struct generator *g)
{
	const struct reference *r = g->reference;
	const struct reference_object *o = &r->objects[below(&g->seed, (uint32_t)r->object_count)];

	while ((o->index >= 0x1400 && o->index < 0x1C00) && below(&g->seed, 8)) /* most objects are these */
		o = &r->objects[below(&g->seed, (uint32_t)r->object_count)];
	return o;
}

static void plan_any_write(struct generator *g)
{
	const struct reference_object *o = any_object(g);
	uint32_t value = value_for(g, o);

	while (!(o->flags & REF_WRITE) && below(&g->seed, 8))
		o = any_object(g), value = value_for(g, o);
	plan_write(g, o->index, o->sub, value);
}

static void plan_any_read(struct generator *g)
{
	static const uint16_t absent[] = {0x0005, 0x1002, 0x1404, 0x1808, 0x5FFF, 0xFFFF};
	const struct reference_object *o = any_object(g);
	bool away = below(&g->seed, 10) == 0;

	plan_sdo(g, request_id(g), 0x40, away ? PICK(g, absent) : o->index,
		below(&g->seed, 10) ? o->sub : (uint8_t)(o->sub + 20), next(&g->seed));
}

static void plan_event(struct generator *g, struct random_step step)
{
	if (g->planned < PLAN_MAX)
		g->plan[g->planned++] = step;
}

/* A frame that triggers a PDO, or one with its identifier. */
static void plan_use_of_pdo(struct generator *g, uint32_t id)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)below(&g->seed, 9)};

	for (int i = 0; i < 8; i++)
		msg.data[i] = (uint8_t)(below(&g->seed, 3) ? below(&g->seed, 4) : next(&g->seed));
	switch (below(&g->seed, 6)) {
	case 0:
		plan_bytes(g, 0x080, NULL, 0);
		break;
	case 1:
		plan_frame(g, (struct can_msg){.id = id, .remote = true, .len = msg.len});
		break;
	case 2:
		plan_event(g, (struct random_step){.kind = SAMPLE, .a = next(&g->seed) & 0xFFFF, .b = msg.data[0]});
		break;
	case 3:
		plan_wait(g, below(&g->seed, 400000));
		break;
	case 4:
		msg.len = 8;
		/* fallthrough */
	default:
		plan_frame(g, msg);
	}
}

/* The mapping procedure, NMT start, and frames that trigger the PDO. */
static void plan_pdo(struct generator *g)
{
	static const uint32_t sent[] = {0x21000110, 0x21010210, 0x210F0110, 0x210F0220, 0x10010008, 0x21020420};
	static const uint32_t received[] = {
		0x20700510, 0x20700120, 0x20720510, 0x20720708, 0x20730010, 0x00050008, 0x00060010};
	static const uint8_t types[] = {0, 1, 2, 3, 240, 252, 253, 254, 255};
	static const uint32_t start[] = {1, 1, 1, 2, 128, 130};
	bool tx = below(&g->seed, 2);
	uint16_t comm = (uint16_t)(tx ? 0x1800 + below(&g->seed, 8) : 0x1400 + below(&g->seed, 4));
	uint32_t id = (tx ? 0x180u : 0x200u) + 0x100u * below(&g->seed, 4) + g->reference->node_id + below(&g->seed, 2);
	uint8_t count = (uint8_t)(1 + below(&g->seed, 5));
	const uint8_t nmt[2] = {(uint8_t)PICK(g, start), g->reference->node_id};

	plan_write(g, comm, 1, 0x80000000u | id);
	plan_write(g, comm | 0x200, 0, 0);
	for (uint8_t i = 1; i <= count; i++)
		plan_write(g, comm | 0x200, i, tx ? PICK(g, sent) : PICK(g, received));
	plan_write(g, comm | 0x200, 0, count);
	plan_write(g, comm, 2, PICK(g, types));
	if (tx && below(&g->seed, 2))
		plan_write(g, comm, 3, below(&g->seed, 3000));
	if (below(&g->seed, 2))
		plan_write(g, comm, 5, below(&g->seed, 300));
	if (tx && below(&g->seed, 4) == 0)
		plan_write(g, comm, 6, below(&g->seed, 5));
	plan_write(g, comm, 1, (below(&g->seed, 2) ? 0x40000000u : 0) | id);
	plan_bytes(g, 0, nmt, 2);
	for (uint32_t n = below(&g->seed, 6); n > 0; n--)
		plan_use_of_pdo(g, id);
}

static void plan_time(struct generator *g)
{
	struct can_msg msg = {.id = ref_value(g->reference, 0x1012, 0) & 0x7FF, .len = below(&g->seed, 5) ? 6 : 8};

	for (int i = 0; i < 6; i++)
		msg.data[i] = (uint8_t)(i == 3 ? below(&g->seed, 8) : next(&g->seed));
	plan_frame(g, msg);
}

/* Producers, consumers, SDO channels, and faults. */
static void plan_service(struct generator *g)
{
	static const uint8_t overflows[] = {0, 0, 2, 3, 240, 1};
	const uint8_t id = g->reference->node_id;

	switch (below(&g->seed, 11)) {
	case 0:
		plan_write(g, 0x1019, 0, PICK(g, overflows));
		plan_write(g, 0x1006, 0, 1000 + below(&g->seed, 100000));
		plan_write(g, 0x1005, 0, 0x40000080);
		plan_bytes(g, 0, (const uint8_t[2]){1, id}, 2);
		plan_wait(g, below(&g->seed, 300000));
		break;
	case 1:
		for (uint32_t n = 1 + below(&g->seed, REF_CHANNELS - 1); n > 0; n--) {
			plan_write(g, (uint16_t)(0x1200 + n), 1, 0x680 + n);
			plan_write(g, (uint16_t)(0x1200 + n), 2, 0x690 + n);
		}
		break;
	case 2:
		plan_write(g, 0x100C, 0, 1 + below(&g->seed, 100));
		plan_write(g, 0x100D, 0, below(&g->seed, 4));
		for (uint32_t n = below(&g->seed, 5); n > 0; n--) {
			plan_frame(g, (struct can_msg){.id = 0x700u + id, .remote = true, .len = 1});
			plan_wait(g, below(&g->seed, 150000));
		}
		break;
	case 3:
		plan_write(g, 0x1016, (uint8_t)(1 + below(&g->seed, 8)), 0x00050000 | (1 + below(&g->seed, 100)));
		plan_write(g, 0x1016, (uint8_t)(1 + below(&g->seed, 8)), 0x00060000 | (1 + below(&g->seed, 100)));
		for (uint32_t n = below(&g->seed, 6); n > 0; n--) {
			plan_bytes(g, 0x705 + below(&g->seed, 2), (const uint8_t[1]){5}, 1);
			plan_wait(g, below(&g->seed, 80000));
		}
		break;
	case 4:
		plan_write(g, 0x1017, 0, 1 + below(&g->seed, 200));
		plan_wait(g, below(&g->seed, 400000));
		break;
	case 5:
		plan_write(g, 0x1029, 1, below(&g->seed, 4));
		plan_event(g, (struct random_step){.kind = BUS_OFF});
		break;
	case 6:
		plan_write(g, 0x1F80, 0, below(&g->seed, 3) ? 0 : 4);
		plan_bytes(g, 0, (const uint8_t[2]){130, 0}, 2);
		break;
	case 7:
		plan_write(g, 0x1012, 0, 0x80000100);
		plan_time(g);
		break;
	case 8:
		for (uint32_t n = below(&g->seed, 5); n > 0; n--) {
			plan_bytes(g, 0x700u + id, (const uint8_t[1]){5}, 1); /* another node with this node-ID */
			plan_wait(g, below(&g->seed, 11000000));
		}
		break;
	case 9:
		plan_write(g, 0x1007, 0, 1 + below(&g->seed, 3000));
		plan_write(g, 0x1400, 2, below(&g->seed, 3));
		plan_bytes(g, 0, (const uint8_t[2]){1, id}, 2);
		plan_bytes(g, 0x080, NULL, 0);
		plan_wait(g, below(&g->seed, 4000));
		plan_bytes(g, 0x200u + id, (const uint8_t[8]){1, 2, 3, 4, 5, 6, 7, 8}, 8);
		plan_bytes(g, 0x080, NULL, 0);
		break;
	default:
		plan_write(g, 0x1015, 0, below(&g->seed, 5000));
		for (uint32_t n = below(&g->seed, 22); n > 0; n--)
			plan_event(g, (struct random_step){.kind = below(&g->seed, 3) ? RAISE : CLEAR,
					      .a = 0xFF00 + below(&g->seed, 20),
					      .b = next(&g->seed) & 0xFF});
	}
}

static uint32_t any_identifier(struct generator *g)
{
	struct reference *r = g->reference;
	bool tx = below(&g->seed, 3) == 0;

	return ref_value(r, (uint16_t)(tx ? 0x1800 + below(&g->seed, 8) : 0x1400 + below(&g->seed, 4)), 1) & 0x7FF;
}

static void plan_process_data(struct generator *g)
{
	struct can_msg msg = {
		.id = any_identifier(g), .len = (uint8_t)below(&g->seed, 9), .remote = below(&g->seed, 3) == 0};

	if (below(&g->seed, 2))
		msg.len = 8;
	for (int i = 0; i < 8; i++)
		msg.data[i] = (uint8_t)(below(&g->seed, 3) ? below(&g->seed, 4) : next(&g->seed));
	plan_frame(g, msg);
}

static void plan_sync(struct generator *g)
{
	struct reference *r = g->reference;
	bool counted = ref_value(r, 0x1019, 0);
	uint32_t n = 1 + below(&g->seed, 6);

	for (uint32_t i = 0; i < n; i++) {
		struct can_msg msg = {.id = ref_value(r, 0x1005, 0) & 0x7FF, .len = counted};

		msg.data[0] = (uint8_t)(i + 1);
		if (below(&g->seed, 20) == 0)
			msg.len ^= 1;
		plan_frame(g, msg);
		if (below(&g->seed, 3) == 0)
			plan_wait(g, below(&g->seed, 20000));
	}
}

static void plan_nmt(struct generator *g)
{
	static const uint8_t commands[] = {1, 1, 1, 2, 2, 128, 128, 129, 130, 130, 0, 3, 255};
	struct can_msg msg = {.len = below(&g->seed, 12) ? 2 : (uint8_t)below(&g->seed, 9)};

	msg.data[0] = PICK(g, commands);
	msg.data[1] = below(&g->seed, 4) ? g->reference->node_id : (uint8_t)below(&g->seed, 3);
	plan_frame(g, msg);
}

static void plan_error_control(struct generator *g)
{
	static const uint8_t nodes[] = {5, 5, 5, 6, 7, 127, 16};
	struct can_msg msg = {.id = 0x700u + PICK(g, nodes), .len = 1, .data = {5}};

	if (below(&g->seed, 3) == 0)
		msg = (struct can_msg){.id = 0x700u + g->reference->node_id, .remote = true, .len = 1};
	if (below(&g->seed, 10) == 0)
		msg.len = (uint8_t)below(&g->seed, 9);
	plan_frame(g, msg);
	if (below(&g->seed, 3) == 0)
		plan_wait(g, below(&g->seed, 150000));
}

/* ---- SDO transfers of a client ----------------------------------------------------------------------------------- */

static size_t any_text(struct generator *g, uint8_t *text, size_t longest)
{
	size_t size = below(&g->seed, (uint32_t)longest + 1);

	for (size_t i = 0; i < size; i++)
		text[i] = (uint8_t)('a' + below(&g->seed, 26));
	if (size && below(&g->seed, 10) == 0)
		text[below(&g->seed, (uint32_t)size)] = 0;
	return size;
}

/* Objects for long values: the text 1009h, of up to 32 bytes, the domain 2130h, and numbers. */
static const struct reference_object *long_target(struct generator *g, uint8_t *data, size_t *size)
{
	const struct reference_object *o =
		below(&g->seed, 3) ? reference_find(g->reference, 0x1009, 0) : reference_find(g->reference, 0x2130, 0);

	if (below(&g->seed, 6) == 0)
		o = any_object(g);
	*size = any_text(g, data, o->flags & REF_DOMAIN ? 480 : o->flags & REF_STRING ? 36 : 8);
	if (!(o->flags & (REF_DOMAIN | REF_STRING)) && below(&g->seed, 4))
		*size = o->size;
	return o;
}

static void plan_segmented_download(struct generator *g)
{
	uint8_t data[512];
	size_t size, at = 0;
	const struct reference_object *o = long_target(g, data, &size);
	uint32_t id = request_id(g), said = below(&g->seed, 10) ? (uint32_t)size : below(&g->seed, 40);
	uint8_t toggle = 0;

	plan_sdo(g, id, below(&g->seed, 4) ? 0x21 : 0x20, o->index, o->sub, said);
	do {
		size_t n = size - at < 7 ? size - at : 7;
		uint8_t f[8] = {(uint8_t)((unsigned)toggle << 4 | (7 - n) << 1 | (at + n == size))};

		memcpy(f + 1, data + at, n);
		plan_bytes(g, id, f, 8);
		toggle ^= 1;
		at += n;
	} while (at < size);
}

static void plan_segmented_upload(struct generator *g)
{
	static const uint16_t indices[] = {0x1008, 0x1009, 0x2130, 0x1021};
	uint16_t index = PICK(g, indices);
	uint32_t id = request_id(g), n = 1 + below(&g->seed, 20);

	plan_sdo(g, id, 0x40, index, 0, 0);
	for (uint32_t i = 0; i < n; i++)
		plan_bytes(g, id, (const uint8_t[8]){(uint8_t)(0x60 | (i & 1) << 4)}, 8);
}

static void plan_block_download(struct generator *g)
{
	uint8_t data[512 + 7] = {0};
	size_t size, at = 0;
	const struct reference_object *o = long_target(g, data, &size);
	uint32_t id = request_id(g), said = below(&g->seed, 10) ? (uint32_t)size : below(&g->seed, 40);
	bool crc = below(&g->seed, 2);
	uint16_t sum = reference_crc(data, size);
	uint8_t end[8] = {
		(uint8_t)(0xC1 | (size ? (7 - ((size - 1) % 7 + 1)) : 7) << 2), (uint8_t)sum, (uint8_t)(sum >> 8)};
	uint8_t sequence = 0;

	if (below(&g->seed, 12) == 0)
		end[1] ^= 1;
	plan_sdo(g, id, (uint8_t)(0xC0 | (crc ? 4 : 0) | (below(&g->seed, 4) ? 2 : 0)), o->index, o->sub, said);
	do {
		uint8_t f[8] = {(uint8_t)(++sequence | (at + 7 >= size ? 0x80 : 0))};

		memcpy(f + 1, data + at, 7);
		if (below(&g->seed, 60)) /* else it is lost */
			plan_bytes(g, id, f, 8);
		sequence %= REF_BLOCK_SIZE;
		at += 7;
	} while (at < size);
	plan_bytes(g, id, end, 8);
}

static void plan_block_upload(struct generator *g)
{
	static const uint16_t indices[] = {0x1008, 0x1009, 0x2130, 0x1021, 0x1021, 0x1021, 0x1000};
	static const uint8_t sizes[] = {1, 2, 5, 16, 17, 60, 127, 0, 128};
	uint32_t id = request_id(g), acks = below(&g->seed, 12);
	uint8_t size = PICK(g, sizes);
	uint8_t threshold = (uint8_t)(below(&g->seed, 4) ? 0 : below(&g->seed, 40));

	plan_sdo(g, id, below(&g->seed, 2) ? 0xA4 : 0xA0, PICK(g, indices), 0, size | (uint32_t)threshold << 8);
	plan_bytes(g, id, (const uint8_t[8]){0xA3}, 8);
	for (uint32_t i = 0; i < acks; i++) {
		uint8_t got = below(&g->seed, 6) ? size : (uint8_t)below(&g->seed, size + 2u);

		plan_wait(g, 100);
		size = below(&g->seed, 5) ? size : PICK(g, sizes);
		plan_bytes(g, id, (const uint8_t[8]){0xA2, got, size}, 8);
	}
	plan_bytes(g, id, (const uint8_t[8]){0xA1}, 8);
}

/* Mostly the frame that the transfer under way expects. */
static void plan_next_of_a_transfer(struct generator *g)
{
	const struct reference_transfer *t = &g->reference->sdo[below(&g->seed, 2)];
	size_t left = t->size > t->done ? t->size - t->done : 0;
	size_t sent = t->sequence * 7u < left ? t->sequence : (left + 6) / 7;
	uint8_t toggle = (uint8_t)(t->toggle << 4);

	switch ((int)t->state) {
	case REF_UPLOAD:
		plan_bytes(g, t->request, (const uint8_t[8]){(uint8_t)(0x60 | toggle)}, 8);
		break;
	case REF_DOWNLOAD:
		plan_bytes(g, t->request,
			(const uint8_t[8]){(uint8_t)(toggle | (left <= 7 ? (7 - left) << 1 | 1 : 0)), 'x', 'y'}, 8);
		break;
	case REF_BLOCK_UPLOAD:
		plan_bytes(g, t->request, (const uint8_t[8]){0xA2, (uint8_t)sent, 20}, 8);
		break;
	case REF_BLOCK_UPLOAD_START:
		plan_bytes(g, t->request, (const uint8_t[8]){0xA3}, 8);
		break;
	case REF_BLOCK_DOWNLOAD:
		plan_bytes(g, t->request,
			(const uint8_t[8]){(uint8_t)((t->sequence + 1) | (below(&g->seed, 4) ? 0 : 0x80)), 'q'}, 8);
		break;
	default:
		break;
	}
}

static void plan_random_frame(struct generator *g)
{
	struct can_msg msg = {.id = request_id(g), .len = 8};

	for (int i = 0; i < 8; i++)
		msg.data[i] = (uint8_t)next(&g->seed);
	if (below(&g->seed, 2))
		msg.len = (uint8_t)below(&g->seed, 9);
	msg.remote = below(&g->seed, 8) == 0;
	msg.extended = below(&g->seed, 8) == 0;
	if (below(&g->seed, 4) == 0)
		msg.id = below(&g->seed, 0x800);
	plan_frame(g, msg);
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

static void plan_lss(struct generator *g, uint8_t command, uint32_t value)
{
	plan_bytes(g, 0x7E5,
		(const uint8_t[8]){
			command, (uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)},
		8);
}

static void plan_lss_selective(struct generator *g)
{
	for (uint8_t i = 0; i < 4; i++)
		plan_lss(g, 0x40 + i, ref_value(g->reference, 0x1018, i + 1));
}

static void plan_lss_identify(struct generator *g)
{
	static const uint8_t subs[] = {1, 2, 3, 3, 4, 4};

	for (uint8_t i = 0; i < 6; i++)
		plan_lss(g, 0x46 + i, ref_value(g->reference, 0x1018, subs[i]) + (below(&g->seed, 20) == 0));
}

/* A master that knows the LSS address: the bits of each number from the highest, then the next number. */
static void plan_lss_fastscan(struct generator *g)
{
	plan_bytes(g, 0x7E5, (const uint8_t[8]){0x51, 0, 0, 0, 0, 0x80}, 8);
	for (uint8_t n = 0; n < 4; n++) {
		uint32_t id = ref_value(g->reference, 0x1018, n + 1);

		for (int bit = 31; bit >= 0; bit -= bit ? 1 + (int)below(&g->seed, (uint32_t)bit) : 1) {
			uint32_t asked = id >> bit << bit ^ (below(&g->seed, 15) ? 0 : 1u << bit);

			plan_bytes(g, 0x7E5,
				(const uint8_t[8]){0x51, (uint8_t)asked, (uint8_t)(asked >> 8), (uint8_t)(asked >> 16),
					(uint8_t)(asked >> 24), (uint8_t)bit, n, (uint8_t)(bit ? n : (n + 1) % 4)},
				8);
		}
	}
}

static void plan_lss_node_id(struct generator *g)
{
	static const uint8_t ids[] = {0x10, 0x10, 0x11, 1, 127, 255, 255, 0, 128, 254};
	static const uint8_t nmt[] = {130, 129};

	plan_lss(g, 0x04, 1);
	plan_lss(g, 0x11, PICK(g, ids));
	if (below(&g->seed, 2))
		plan_lss(g, 0x17, 0);
	plan_lss(g, 0x04, 0);
	if (below(&g->seed, 2))
		plan_bytes(g, 0, (const uint8_t[2]){PICK(g, nmt), 0}, 2);
}

static void plan_lss_bit_rate(struct generator *g)
{
	static const uint32_t delays[] = {0, 3, 50, 200, 2000};

	plan_lss(g, 0x04, 1);
	plan_lss(g, 0x13, below(&g->seed, 10) << 8 | (below(&g->seed, 8) == 0));
	plan_lss(g, 0x15, PICK(g, delays));
	plan_lss(g, 0x17, 0);
	plan_wait(g, below(&g->seed, 500000));
}

static void plan_any_lss(struct generator *g)
{
	static const uint8_t commands[] = {0x04, 0x04, 0x13, 0x15, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x47, 0x48, 0x49,
		0x4A, 0x4B, 0x4C, 0x51, 0x5A, 0x5D, 0x5E, 0x5F, 0xFF, 0x11};
	static const uint32_t values[] = {0, 1, 0x0200, 0x00494D55, 9, OD_REVISION, 0xFFFFFFFF};

	plan_lss(g, PICK(g, commands), PICK(g, values));
	if (below(&g->seed, 10) == 0)
		g->plan[g->planned - 1].msg.len = (uint8_t)below(&g->seed, 8);
}

static void make_plan(struct generator *g)
{
	static void (*const plans[])(struct generator *) = {plan_any_write, plan_any_write, plan_any_read, plan_service,
		plan_service, plan_service, plan_pdo, plan_pdo, plan_process_data, plan_process_data, plan_sync,
		plan_sync, plan_nmt, plan_error_control, plan_time, plan_segmented_download, plan_segmented_upload,
		plan_block_download, plan_block_upload, plan_next_of_a_transfer, plan_random_frame, plan_lss_selective,
		plan_lss_identify, plan_lss_fastscan, plan_lss_node_id, plan_lss_bit_rate, plan_any_lss};

	g->planned = g->done = 0;
	PICK(g, plans)(g);
}

static struct random_step any_event(struct generator *g)
{
	struct random_step step = {
		.kind = (enum random_step_kind)below(&g->seed, STEP_KINDS), .a = next(&g->seed), .b = next(&g->seed)};

	switch ((int)step.kind) {
	case SEND:
	case WAIT:
		step.kind = WAIT;
		step.a = 1 + below(&g->seed, 1u << (1 + below(&g->seed, 22)));
		break;
	case RAISE:
	case CLEAR:
		step.a = 0xFF00 + step.a % 20;
		step.b &= 0xFF;
		break;
	case STORAGE:
		step.a %= 3;
		break;
	default:
		step.a &= step.kind == SAMPLE ? 0xFFFF : 1;
		step.b &= 0xFFFF;
	}
	return step;
}

static void corrupt(struct generator *g, struct can_msg *msg)
{
	switch (below(&g->seed, 6)) {
	case 0:
		msg->len = (uint8_t)below(&g->seed, 9);
		break;
	case 1:
		msg->remote = true;
		break;
	case 2:
		msg->data[0] ^= (uint8_t)(1u << below(&g->seed, 8));
		break;
	case 3:
		msg->data[3 + below(&g->seed, 3)] = (uint8_t)next(&g->seed);
		break;
	case 4:
		msg->extended = true;
		break;
	default:
		msg->id ^= 1u << below(&g->seed, 11);
	}
}

static bool unknown_to_the_model(const struct pair *p, uint16_t index)
{
	enum od_status status;

	od_find(p->bus->od.table, index, 0, &status);
	return status != OD_NO_OBJECT && !reference_knows(p->reference, index);
}

/* Replaces an object that the model does not have, in a request or a mapping entry, by one that does not exist. */
static void replace_unknown_objects(const struct pair *p, struct can_msg *msg)
{
	uint16_t index = (uint16_t)(msg->data[1] | msg->data[2] << 8);
	bool segment = (msg->data[0] >> 5 == 0 || msg->data[0] >> 5 == 3);

	if (!segment && unknown_to_the_model(p, index))
		index = 0x5FFF;
	msg->data[1] = (uint8_t)index;
	msg->data[2] = (uint8_t)(index >> 8);
	if (unknown_to_the_model(p, (uint16_t)(msg->data[6] | msg->data[7] << 8)))
		msg->data[7] = 0x5F;
}

static struct random_step make_step(struct pair *p, struct generator *g)
{
	struct random_step step;

	if (below(&g->seed, 6) == 0)
		return any_event(g);
	if (g->done == g->planned || below(&g->seed, 25) == 0)
		make_plan(g);
	if (g->done == g->planned)
		return any_event(g);
	step = g->plan[g->done++];
	if (step.kind == SEND && below(&g->seed, 30) == 0)
		corrupt(g, &step.msg);
	if (step.kind == SEND)
		replace_unknown_objects(p, &step.msg);
	return step;
}

/* ---- sequences --------------------------------------------------------------------------------------------------- */

static bool wait_and_compare(struct pair *p, struct sequence *s, uint64_t us)
{
	enum { SLICE_US = 50000 }; /* limits the frames that are recorded */

	for (; us > SLICE_US; us -= SLICE_US) {
		wait(p, SLICE_US);
		if (!compare(p, s))
			return false;
	}
	wait(p, us);
	return compare(p, s);
}

static bool run_step(struct pair *p, struct sequence *s, const struct random_step *step)
{
	if (step->kind == WAIT)
		return wait_and_compare(p, s, step->a);
	do_step(p, step);
	for (int i = 0; i < REF_CHANNELS; i++)
		if (p->reference->sdo[i].state == REF_BLOCK_UPLOAD)
			wait(p, BLOCK_US); /* until the sub-block is sent */
	return compare(p, s);
}

static bool run_frame(struct pair *p, struct sequence *s, uint32_t id, uint8_t len, uint32_t first)
{
	struct random_step step = {.kind = SEND, .msg = {.id = id, .len = len}};

	for (int i = 0; i < 4; i++)
		step.msg.data[i] = (uint8_t)(first >> 8 * i);
	return run_step(p, s, &step);
}

/* After any sequence the node serves NMT and SDO. Checked without the model. */
static bool recovers(struct pair *p, struct sequence *s)
{
	const struct random_step stored = {.kind = STORE_DONE, .a = 1}, lss_stored = {.kind = LSS_STORED, .a = 1};
	struct bus *bus = p->bus;
	const struct can_msg *answer;

	for (int i = 0; i < 150 && bus->node.lss.switching; i++)
		if (!wait_and_compare(p, s, 1000000))
			return false;
	if (!run_step(p, s, &stored) || !run_step(p, s, &lss_stored) || !wait_and_compare(p, s, BOOT_UP_US) ||
		!run_frame(p, s, 0x000, 2, 129))
		return false;
	if (bus->node.id == CANOPEN_UNCONFIGURED &&
		(!run_frame(p, s, 0x7E5, 8, 0x0104) || !run_frame(p, s, 0x7E5, 8, 0x1011) ||
			!run_frame(p, s, 0x7E5, 8, 0x0004)))
		return false;
	if (!wait_and_compare(p, s, BOOT_UP_US))
		return false;
	give(p, (struct can_msg){.id = 0x000, .len = 2, .data = {130}});
	wait(p, BOOT_UP_US);
	if (bus->sent_count < 1 || bus->sent[0].msg.id != 0x700u + bus->node.id || bus->sent[0].msg.data[0] != 0)
		return deviates(s, "no boot-up", bus->sent_count ? &bus->sent[0].msg : NULL, NULL);
	give(p, (struct can_msg){.id = 0x600u + bus->node.id, .len = 8, .data = {0x40, 0x00, 0x10}});
	answer = &bus->sent[bus->sent_count - 1].msg;
	if (answer->id != 0x580u + bus->node.id || memcmp(answer->data, "\x43\x00\x10\x00\x9A\x01\x04\x00", 8) != 0)
		return deviates(s, "stuck", answer, NULL);
	return compare(p, s);
}

/* With `make`, generates the steps of `s`; else executes those that it has. */
static bool run_sequence(struct sequence *s, struct reference *r, bool make)
{
	struct pair p = {.reference = r};
	struct generator g = {.seed = s->seed, .reference = r};
	bool same;

	pair_start(&p);
	same = compare(&p, s);
	if (make)
		s->count = 0;
	for (size_t i = 0; same && i < (make ? (size_t)SEQUENCE_STEPS : s->count); i++) {
		if (make)
			s->step[s->count++] = make_step(&p, &g);
		same = run_step(&p, s, &s->step[i]);
	}
	same = same && recovers(&p, s);
	pair_end(&p);
	return same;
}

/* Removes every step that the deviation does not depend on. */
static void shorten(struct sequence *s, struct reference *r)
{
	for (size_t size = s->count; size > 0; size /= 2)
		for (size_t at = 0; at + size <= s->count;) {
			struct sequence shorter = *s;

			memmove(&shorter.step[at], &shorter.step[at + size],
				(shorter.count - at - size) * sizeof(shorter.step[0]));
			shorter.count -= size;
			if (run_sequence(&shorter, r, false))
				at += size;
			else
				*s = shorter;
		}
}

static void print_sequence(const struct sequence *s)
{
	static const char *const names[] = {
		"send", "wait (us)", "sample", "raise", "clear", "storage", "stored", "LSS stored", "bus-off"};
	char frame[40];

	print_error("IMU9_SEED=%u: %s\nthe shortest sequence that deviates:\n", s->seed, s->what);
	for (size_t i = 0; i < s->count; i++) {
		write_frame(frame, sizeof(frame), &s->step[i].msg);
		print_error("    %s %s%s\n", names[s->step[i].kind],
			s->step[i].kind == SEND ? frame : (snprintf(frame, sizeof(frame), "%u", s->step[i].a), frame),
			s->step[i].msg.extended ? " (29 bits)" : "");
	}
}

static uint32_t sequence_under_way; /* its seed, for the message of a failed assertion */

static int print_location(void **state)
{
	(void)state;
	if (sequence_under_way)
		print_error("in the sequence of IMU9_SEED=%u\n", sequence_under_way);
	return 0;
}

static void run_seed(struct reference *r, uint32_t seed)
{
	static struct sequence s;

	s = (struct sequence){.seed = seed};
	sequence_under_way = seed;
	if (!run_sequence(&s, r, true)) {
		shorten(&s, r);
		print_sequence(&s);
		fail();
	}
	sequence_under_way = 0;
}

static void test_ten_thousand_sequences_of_legal_and_illegal_steps_agree_with_the_model(void **state)
{
	struct reference *r = test_calloc(1, sizeof(*r));
	const char *seed = getenv("IMU9_SEED"), *count = getenv("IMU9_SEQUENCES");
	uint32_t n = count ? (uint32_t)strtoul(count, NULL, 0) : SEQUENCES;

	(void)state;
	for (size_t i = 0; i < LONG_DOMAIN; i++)
		long_domain[i] = (uint8_t)(i * 7 + i / 256);
	if (seed)
		run_seed(r, (uint32_t)strtoul(seed, NULL, 0));
	else
		for (uint32_t i = 1; i <= n; i++)
			run_seed(r, i * 2654435761u);
	test_free(r);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_teardown(
			test_ten_thousand_sequences_of_legal_and_illegal_steps_agree_with_the_model, print_location),
		PRE_OPERATIONAL(test_random_steps_neither_break_nor_block_the_node),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

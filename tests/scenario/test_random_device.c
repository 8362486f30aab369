/* Random sequences of everything that reaches the whole device: writes of aids (2070h to 2075h) and configuration by
 * SDO, RPDO, Modbus and CiA 309-3, store and restore, the write lock, resets, procedures, other services, and the
 * faults of the list (faults.c), up to three at once. A model of the objects says what each write must answer and what
 * each value is after each step, by whatever interface it is read. In the end all faults end and the device recovers;
 * after 1011h and reset node (of each fourth sequence) it is as it was at the start.
 *
 * IMU9_SEED=N repeats one sequence; IMU9_SEQUENCES=N sets their number (the first is IMU9_FIRST, 1). */
#include "tests/scenario/faults.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/ascii_gateway.h"
#include "gateway/canopen/sdo_abort.h"
#include "gateway/log.h"
#include "gateway/modbus/access.h"
#include "gateway/window.h"
#include "od/little_endian.h"

enum { SEQUENCES = 150, ACTIONS = 25, AT_ONCE = 3, NODE = WORLD_NODE_ID };

/* abort codes, CiA 301 */
#define NO_ANSWER     1u
#define READ_ONLY     0x06010002u
#define BAD_VALUE     0x06090030u
#define TOO_HIGH      0x06090031u
#define TOO_LOW	      0x06090032u
#define LOCAL_CONTROL 0x08000021u
#define DEVICE_STATE  0x08000022u

/* Replaces gateway/log.c. */
void log_at(int severity, const char *format, ...)
{
	(void)severity, (void)format;
}

/* ---- the objects: eds/README.md ---------------------------------------------------------------------------------- */

enum type { U8, U16, I16, REAL };

static const struct object {
	uint16_t index;
	uint8_t sub;
	enum type type;
	double low, high;
	bool configuration;
	uint16_t modbus; /* its first register, gateway/modbus/README.md */
} OBJECTS[] = {
	{0x2000, 1, REAL, -10, 10, true, 0x1000},
	{0x2000, 2, REAL, -10, 10, true, 0x1002},
	{0x2000, 3, REAL, -10, 10, true, 0x1004},
	{0x2001, 0, U8, 0, 3, true, 0x1040},
	{0x2012, 1, REAL, 0, 1000, true, 0x1480},
	{0x2070, 1, REAL, -1000, 1000, false, 0x2C00},
	{0x2070, 2, REAL, -1000, 1000, false, 0x2C02},
	{0x2070, 3, REAL, -1000, 1000, false, 0x2C04},
	{0x2070, 4, REAL, 0, 1000, false, 0x2C06},
	{0x2070, 5, I16, -32768, 32767, false, 0x2C08},
	{0x2070, 6, I16, -32768, 32767, false, 0x2C09},
	{0x2070, 7, I16, -32768, 32767, false, 0x2C0A},
	{0x2070, 8, U16, 0, 65535, false, 0x2C0B},
	{0x2070, 9, U8, 0, 1, true, 0x2C0C},
	{0x2071, 1, REAL, -360, 360, false, 0x2C40},
	{0x2071, 2, REAL, 0, 180, false, 0x2C42},
	{0x2072, 1, REAL, -360, 360, false, 0x2C80},
	{0x2072, 2, REAL, -90, 90, false, 0x2C82},
	{0x2072, 3, REAL, -360, 360, false, 0x2C84},
	{0x2072, 4, I16, -32768, 32767, false, 0x2C86},
	{0x2072, 5, I16, -9000, 9000, false, 0x2C87},
	{0x2072, 6, I16, -32768, 32767, false, 0x2C88},
	{0x2072, 7, U8, 0, 1, false, 0x2C89},
	{0x2073, 0, U16, 0, 7, false, 0x2CC0},
	{0x2075, 1, REAL, -1000, 1000, false, 0x2D40},
	{0x2075, 2, REAL, -1000, 1000, false, 0x2D42},
	{0x2075, 3, REAL, -1000, 1000, false, 0x2D44},
	{0x2075, 4, I16, -32768, 32767, false, 0x2D46},
	{0x2075, 5, I16, -32768, 32767, false, 0x2D47},
	{0x2075, 6, I16, -32768, 32767, false, 0x2D48},
	{0x2110, 1, U16, 1, 1000, true, 0x5400},
	{0x2117, 5, U16, 1, 3600, true, 0x55C8},
	{0x6000, 0, U16, 1, 1000, true, 0x8000},
};

enum { COUNT = sizeof(OBJECTS) / sizeof(OBJECTS[0]) };

static size_t find(uint16_t index, uint8_t sub)
{
	size_t i = 0;

	while (i < COUNT && (OBJECTS[i].index != index || OBJECTS[i].sub != sub))
		i++;
	assert_true(i < COUNT);
	return i;
}

static size_t size_of(enum type type)
{
	return type == REAL ? 4 : type == U8 ? 1 : 2;
}

static float real_of(uint32_t bits)
{
	float value;

	memcpy(&value, &bits, 4);
	return value;
}

static uint32_t bits_of(float value)
{
	uint32_t bits;

	memcpy(&bits, &value, 4);
	return bits;
}

static double number(enum type type, uint32_t bits)
{
	return type == REAL ? (double)real_of(bits) : type == I16 ? (double)(int16_t)bits : (double)bits;
}

/* ---- the model --------------------------------------------------------------------------------------------------- */

struct model {
	uint32_t value[COUNT], stored[COUNT], saving_value[COUNT]; /* bits; of I16: 16 */
	uint8_t preset, stored_preset, saving_preset;
	uint32_t key, saving_key; /* of the write lock; 0: open */
	enum save { NO_SAVE, STORE, RESTORE, LOCK } saving;
	unsigned saves;
	bool bad_stored;   /* a value that a fault has written was stored: a reset brings it back */
	bool rpdo_refused; /* one of this test: EMCY 8200h */
};

struct rig {
	struct site site; /* first */
	struct modbus_link link;
	struct modbus_access access;
	struct cia309 cia309;
	struct cia309_session *session;
	struct model model;
	const uint8_t *at[COUNT]; /* of the device */
	uint32_t seed;
	const struct fault *begun[ACTIONS];
	size_t begun_count;
	char actions[ACTIONS + 8][100];
	size_t action_count;
};

static struct rig *rig;
static uint32_t base[COUNT];

static uint32_t clamp_bits(double value, double low, double high)
{
	return (uint32_t)(int32_t)fmax(low, fmin(high, round(value))) & 0xFFFF;
}

/* A value has a twin in 16 bits: 2070h:1 to 4 and 5 to 8, 2072h:1 to 3 and 4 to 6, 2075h:1 to 3 and 4 to 6. */
static void set(struct model *m, size_t i, uint32_t bits)
{
	const struct object *o = &OBJECTS[i];
	unsigned reals = o->index == 0x2070 ? 4 : o->index == 0x2072 || o->index == 0x2075 ? 3 : 0;
	double step = o->index == 0x2070 ? 0.001 : o->index == 0x2072 ? 0.01 : 0.005;

	m->value[i] = bits;
	if (o->sub == 0 || o->sub > 2 * reals)
		return;
	if (o->sub > reals) {
		m->value[i - reals] = bits_of((float)(number(o->type, bits) * step));
		return;
	}
	enum type twin = OBJECTS[i + reals].type;
	m->value[i + reals] =
		clamp_bits((double)real_of(bits) / step, twin == I16 ? -32768 : 0, twin == I16 ? 32767 : 65535);
}

/* The abort code of a write, but for the lock; 0: accepted. */
static uint32_t refusal(size_t i, uint32_t bits)
{
	const struct object *o = &OBJECTS[i];
	double value = number(o->type, bits);

	if (!isfinite(value))
		return BAD_VALUE;
	if (value > o->high)
		return TOO_HIGH;
	if (value < o->low)
		return TOO_LOW;
	if (o->index == 0x6000 && bits != 1 && bits != 10 && bits != 100 && bits != 1000)
		return BAD_VALUE;
	return 0;
}

static void begin_save(struct model *m, enum save kind)
{
	m->saving = kind;
	memcpy(m->saving_value, kind == STORE ? m->value : base, sizeof(m->saving_value));
	m->saving_preset = kind == STORE ? m->preset : 1;
}

static void on_saved(struct site *s)
{
	struct model *m = &((struct rig *)s)->model;
	bool done = s->saves != m->saves;

	m->saves = s->saves;
	if (done && m->saving == LOCK)
		m->key = m->saving_key;
	if (done && (m->saving == STORE || m->saving == RESTORE)) {
		memcpy(m->stored, m->saving_value, sizeof(m->stored));
		m->stored_preset = m->saving_preset;
		for (size_t i = 0; i < s->fault_count && m->saving == STORE; i++)
			m->bad_stored |= s->faults[i]->needs & CONFIGURATION;
	}
	m->saving = NO_SAVE;
}

/* Default mapping. All values are checked before the first is written. */
static void rpdo(struct model *m, unsigned n, const struct can_msg *msg)
{
	static const struct {
		uint16_t index;
		uint8_t sub[4];
	} MAPPED[] = {{0x2070, {5, 6, 7, 8}}, {0x2071, {1, 2}}, {0x2072, {4, 5, 6, 7}}, {0x2073, {0}}};
	static const unsigned COUNTS[] = {4, 2, 4, 1}, BYTES[] = {8, 8, 7, 2};
	uint32_t bits[4];
	size_t at[4], from = 0;

	if (msg->remote || msg->len < BYTES[n])
		return;
	for (unsigned k = 0; k < COUNTS[n]; k++) {
		at[k] = find(MAPPED[n].index, MAPPED[n].sub[k]);
		bits[k] = 0;
		for (size_t byte = 0; byte < size_of(OBJECTS[at[k]].type); byte++)
			bits[k] |= (uint32_t)msg->data[from++] << 8 * byte;
		if (refusal(at[k], bits[k])) {
			m->rpdo_refused = true;
			return;
		}
	}
	for (unsigned k = 0; k < COUNTS[n]; k++)
		set(m, at[k], bits[k]);
}

static void reset(struct model *m, bool node)
{
	m->preset = m->stored_preset;
	for (size_t i = 0; node && i < COUNT; i++)
		m->value[i] = OBJECTS[i].configuration ? m->stored[i] : 0;
}

/* What the device has heard, whoever sent it. */
static void on_heard(struct site *s, const struct can_msg *msg, enum nmt_state before, bool disk_waited)
{
	struct model *m = &((struct rig *)s)->model;

	if (before == NMT_INITIALISING || msg->extended)
		return;
	if (msg->id == 0x000 && msg->len == 2 && (msg->data[1] == NODE || msg->data[1] == 0) &&
		(msg->data[0] == 0x81 || msg->data[0] == 0x82))
		reset(m, msg->data[0] == 0x81);
	if (before == NMT_OPERATIONAL && (msg->id & 0x7F) == NODE && msg->id >= 0x200 && msg->id < 0x580 &&
		!(msg->id & 0x80))
		rpdo(m, msg->id / 0x100 - 2, msg);
	if (msg->id != 0x600 + NODE || !s->world.disk_waits || disk_waited)
		return;
	if (get_u16(msg->data + 1) == 0x214C) {
		m->saving = LOCK;
		m->saving_key = m->key ? 0 : get_u32(msg->data + 4);
	} else {
		begin_save(m, get_u16(msg->data + 1) == 0x1010 ? STORE : RESTORE);
	}
}

/* ---- interfaces -------------------------------------------------------------------------------------------------- */

static void serve(void *ctx)
{
	struct rig *r = ctx;

	window_execute(&r->link, &r->site.world.device, r->site.world.now_us);
}

static uint32_t sdo_write(struct rig *r, uint16_t index, uint8_t sub, uint32_t bits, size_t size)
{
	uint8_t request[8] = {(uint8_t)(0x23 | (4 - size) << 2), (uint8_t)index, (uint8_t)(index >> 8), sub};

	put_u32(request + 4, bits);
	r->site.sdo = (struct can_msg){0};
	site_send(&r->site, 0x600 + NODE, 8, request);
	if (r->site.sdo.data[0] == 0x60)
		return 0;
	return r->site.sdo.data[0] == 0x80 ? get_u32(r->site.sdo.data + 4) : NO_ANSWER;
}

/* 0, or an exception: READ_ONLY, or any other refusal. */
static uint32_t write_by_modbus(struct rig *r, size_t i, uint32_t bits)
{
	const struct object *o = &OBJECTS[i];
	uint8_t words = o->type == REAL ? 2 : 1, response[MODBUS_PDU_MAX];
	uint8_t request[10] = {16, (uint8_t)(o->modbus >> 8), (uint8_t)o->modbus, 0, words, (uint8_t)(2 * words)};
	uint8_t *at = request + 6;

	if (o->type == REAL)
		*at++ = (uint8_t)(bits >> 24), *at++ = (uint8_t)(bits >> 16);
	*at++ = (uint8_t)(bits >> 8);
	*at++ = (uint8_t)bits;
	size_t size = modbus_pdu(&r->access.registers, request, (size_t)(at - request), response);
	assert_true(size > 0);
	return response[0] & 0x80 ? response[1] : 0;
}

static uint32_t modbus_read(struct rig *r, size_t i)
{
	const struct object *o = &OBJECTS[i];
	uint8_t words = o->type == REAL ? 2 : 1, response[MODBUS_PDU_MAX];
	const uint8_t request[5] = {3, (uint8_t)(o->modbus >> 8), (uint8_t)o->modbus, 0, words};

	modbus_link_publish(&r->link, &r->site.world.device.values);
	assert_int_equal(modbus_pdu(&r->access.registers, request, 5, response), 2 + 2 * words);
	uint32_t high = (uint32_t)(response[2] << 8 | response[3]);
	return words == 1 ? high : high << 16 | (uint32_t)(response[4] << 8 | response[5]);
}

static const char *words_of(enum type type)
{
	return type == REAL ? "r32" : type == I16 ? "i16" : type == U16 ? "u16" : "u8";
}

static const char *ask(struct rig *r, const char *line)
{
	static char answer[200];
	size_t n = 0, size;

	while (r->site.world.device.canopen.nmt.state == NMT_INITIALISING) /* commands wait until the boot-up */
		site_run(&r->site, 0.01);
	assert_in_range(strlen(line), 1, cia309_room(r->session));
	cia309_input(r->session, line, strlen(line));
	for (int i = 0; i < 9 && (n < 2 || answer[n - 1] != '\n'); i++) {
		cia309_tick(&r->cia309, r->site.world.now_us);
		const char *out = cia309_output(r->session, &size);
		assert_true(n + size < sizeof(answer));
		memcpy(answer + n, out, size);
		n += size;
		cia309_sent(r->session, size);
		site_wait(&r->site, 300);
	}
	assert_true(n >= 2);
	answer[n - 2] = '\0';
	return answer;
}

static uint32_t cia309_write(struct rig *r, size_t i, uint32_t bits)
{
	const struct object *o = &OBJECTS[i];
	char line[100];
	const char *answer, *code;

	if (o->type == REAL)
		snprintf(line, sizeof(line), "[7] %d w 0x%04X %d r32 %.9g\n", NODE, o->index, o->sub,
			(double)real_of(bits));
	else
		snprintf(line, sizeof(line), "[7] %d w 0x%04X %d %s %d\n", NODE, o->index, o->sub, words_of(o->type),
			(int)number(o->type, bits));
	answer = ask(r, line);
	if (strcmp(answer, "[7] OK") == 0)
		return 0;
	code = strstr(answer, "0x");
	return code ? (uint32_t)strtoul(code, NULL, 16) : NO_ANSWER;
}

static bool cia309_agrees(struct rig *r, size_t i, uint32_t bits)
{
	const struct object *o = &OBJECTS[i];
	char line[100];
	const char *answer;

	snprintf(line, sizeof(line), "[8] %d r 0x%04X %d %s\n", NODE, o->index, o->sub, words_of(o->type));
	answer = ask(r, line);
	if (strncmp(answer, "[8] ", 4) != 0)
		return false;
	double value = strtod(answer + 4, NULL), expected = number(o->type, bits);
	return fabs(value - expected) <= (o->type == REAL ? 1e-5 * fabs(expected) : 0);
}

/* ---- random ------------------------------------------------------------------------------------------------------ */

static uint32_t next(void)
{
	rig->seed ^= rig->seed << 13;
	rig->seed ^= rig->seed >> 17;
	rig->seed ^= rig->seed << 5;
	return rig->seed;
}

static uint32_t below(uint32_t n)
{
	return next() % n;
}

__attribute__((format(printf, 1, 2))) static void note(const char *format, ...)
{
	va_list args;

	va_start(args, format);
	vsnprintf(rig->actions[rig->action_count++], sizeof(rig->actions[0]), format, args);
	va_end(args);
}

__attribute__((format(printf, 1, 2))) static void broken(const char *format, ...)
{
	char text[200];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	print_error("%s\n", text);
	fail();
}

/* Within the limits, at them, a little beyond, or no number. Sigmas are often 0. */
static uint32_t any_value(const struct object *o)
{
	double span = o->high - o->low, value = o->low + span * below(1001) / 1000;

	switch (below(8)) {
	case 0:
		value = o->high;
		break;
	case 1:
		value = o->low;
		break;
	case 2:
		value = below(2) ? o->high + 1 : o->low - 1;
		break;
	case 3:
		value = o->low <= 0 ? 0 : o->low;
		break;
	default:
		break;
	}
	if (o->index == 0x2000 && fabs(value) <= o->high)
		value *= 0.01; /* with 10 m an output of a sensor at rest may be implausible (EMCY 5032h) */
	if (o->type == REAL)
		return below(20) == 0 ? 0x7FC00000 : bits_of((float)value);
	if (o->index == 0x6000 && below(2))
		value = (double[]){10, 100, 1000}[below(3)];
	if (o->index == 0x6000 && value == 1)
		value = 10; /* with 0.001 deg a slope of 33 deg exceeds its object (EMCY 5010h) */
	/* what does not fit the type is not sent */
	value = fmax(o->type == I16 ? -32768 : 0, fmin(o->type == I16 ? 32767 : o->type == U16 ? 65535 : 255, value));
	return (uint32_t)(int32_t)round(value) & (o->type == U8 ? 0xFF : 0xFFFF);
}

static bool answers_sdo(void)
{
	const struct world *w = &rig->site.world;

	return w->bus.state != CAN_STATE_BUS_OFF && w->bus.state != CAN_STATE_DOWN && !rig->site.full &&
	       w->bus.queue_count == 0 && /* else the answer may wait for the end of the back-off */
	       (w->device.canopen.nmt.state == NMT_PRE_OPERATIONAL || w->device.canopen.nmt.state == NMT_OPERATIONAL);
}

static bool executes_sdo(void)
{
	const struct world *w = &rig->site.world;

	return w->bus.state != CAN_STATE_BUS_OFF && w->bus.state != CAN_STATE_DOWN &&
	       (w->device.canopen.nmt.state == NMT_PRE_OPERATIONAL || w->device.canopen.nmt.state == NMT_OPERATIONAL);
}

/* ---- actions ----------------------------------------------------------------------------------------------------- */

static void write_by(unsigned interface, size_t i, uint32_t bits)
{
	static const char *const names[] = {"SDO", "Modbus", "CiA 309-3"};
	struct model *m = &rig->model;
	const struct object *o = &OBJECTS[i];
	uint32_t is, must = refusal(i, bits);
	bool locked = m->key && o->configuration, done, answered = interface != 0 || answers_sdo();

	note("%s: %04Xh:%d = %g", names[interface], o->index, o->sub, number(o->type, bits));
	done = interface != 0 || executes_sdo();
	is = interface == 0   ? sdo_write(rig, o->index, o->sub, bits, size_of(o->type))
	     : interface == 1 ? write_by_modbus(rig, i, bits)
			      : cia309_write(rig, i, bits);
	if (interface == 1 && !is != !(must || locked))
		broken("Modbus: %s", is ? "refused" : "not refused");
	if (interface != 1 && answered && is != must && !(locked && is == READ_ONLY))
		broken("answered %08Xh, not %08Xh", is, must);
	if (done && !locked && !refusal(i, bits))
		set(m, i, bits);
}

static void write_any(void)
{
	size_t i = below(COUNT);
	unsigned interface = below(3);
	uint32_t bits = any_value(&OBJECTS[i]);

	if (interface == 2 && OBJECTS[i].type == REAL && !isfinite(real_of(bits)))
		interface = 1; /* CiA 309-3 has no word for it */
	write_by(interface, i, bits);
}

static void send_rpdo(void)
{
	uint8_t data[8] = {0};
	unsigned n = below(4);
	static const unsigned BYTES[] = {8, 8, 7, 2};

	for (int i = 0; i < 8; i++)
		data[i] = (uint8_t)(below(3) ? 0 : next());
	if (n == 1) {
		put_u32(data, any_value(&OBJECTS[find(0x2071, 1)]));
		put_u32(data + 4, any_value(&OBJECTS[find(0x2071, 2)]));
	} else if (n == 2 && below(10)) {
		data[3] &= 0x1F, data[6] &= 1;
	} else if (n == 3 && below(10)) {
		data[0] &= 7, data[1] = 0;
	}
	note("RPDO%u", n + 1);
	site_send(&rig->site, 0x200 + 0x100 * n + NODE, BYTES[n], data);
}

static bool configuration_fault(void)
{
	for (size_t i = 0; i < rig->site.fault_count; i++)
		if (rig->site.faults[i]->needs & CONFIGURATION)
			return true;
	return false;
}

static void save_or_lock(void)
{
	static const uint32_t KEYS[] = {0x12345678, 0x12345678, 99};
	struct model *m = &rig->model;
	uint32_t is, kind = below(3);

	if (kind == 2 && configuration_fault())
		kind = 0; /* their end is a write, too */
	note("%s", kind == 0 ? "1010h" : kind == 1 ? "1011h" : "214Ch");
	bool may = executes_sdo() && !rig->site.world.disk_waits, answered = answers_sdo();
	unsigned saves = m->saves;
	uint32_t key = m->key, tried = KEYS[below(3)];
	if (kind == 2)
		is = sdo_write(rig, 0x214C, 2, tried, 4);
	else
		is = sdo_write(rig, kind ? 0x1011 : 0x1010, 1, kind ? 0x64616F6C : 0x65766173, 4);
	if (may && answered && key && kind != 2 && is != READ_ONLY)
		broken("locked, and answered %08Xh", is);
	if (may && key && kind == 2 && tried != key && is != LOCAL_CONTROL && is != DEVICE_STATE && answered)
		broken("a wrong key, and answered %08Xh", is);
	bool begins = m->saving != NO_SAVE && may;
	site_run(&rig->site, 0.05);
	if (begins && rig->site.disk_result == 0 && m->saves == saves)
		broken("not saved");
	if (begins && kind == 2 && rig->site.disk_result == 0 && m->key == key)
		broken("the key has not changed");
}

static void procedure(void)
{
	uint16_t index = below(2) ? 0x2060 : 0x2061;
	uint32_t command = below(3), is;
	bool answered = answers_sdo();

	note("%04Xh:1 = %u", index, command);
	is = sdo_write(rig, index, 1, command, 1);
	if (rig->model.key && is != READ_ONLY && answered)
		broken("locked, and answered %08Xh", is);
}

static void preset(void)
{
	static const uint8_t PRESETS[] = {1, 3, 4};
	uint8_t n = PRESETS[below(3)];
	uint32_t is;
	bool done = executes_sdo(), answered = answers_sdo();

	note("2148h = %u", n);
	is = sdo_write(rig, 0x2148, 0, n, 1);
	if (answered && is != (rig->model.key ? READ_ONLY : 0))
		broken("answered %08Xh", is);
	if (done && !rig->model.key)
		rig->model.preset = n;
}

static void service(void)
{
	static const uint8_t COMMANDS[] = {1, 1, 1, 2, 0x80, 0x81, 0x82};
	static const uint8_t INQUIRIES[] = {0x5A, 0x5E, 0x4C, 0x46, 0x51, 0x11, 0x17, 0x13};
	uint8_t data[8] = {0}, command;
	struct can_msg guard = {.id = 0x700 + NODE, .remote = true, .len = 1, .t_us = rig->site.world.now_us};

	switch (below(6)) {
	case 0:
	case 1:
		command = COMMANDS[below(sizeof(COMMANDS))];
		note("NMT %02Xh", command);
		site_send(&rig->site, 0, 2, (const uint8_t[2]){command, (uint8_t)(below(3) ? NODE : 0)});
		break;
	case 2:
		note("node guarding");
		site_send_msg(&rig->site, &guard);
		break;
	case 3:
		note("TIME");
		put_u32(data, next() & 0x0FFFFFFF);
		site_send(&rig->site, 0x100, 6, data);
		break;
	case 4: /* in LSS waiting: no command has an effect */
		if (canopen_lss_active(&rig->site.world.device.canopen))
			break;
		data[0] = INQUIRIES[below(sizeof(INQUIRIES))];
		note("LSS %02Xh", data[0]);
		site_send(&rig->site, 0x7E5, 8, data);
		break;
	default:
		note("block upload of the EDS, to its first block");
		put_u32(data, 0x001021A4);
		data[4] = 20;
		site_send(&rig->site, 0x600 + NODE, 8, data);
		site_send(&rig->site, 0x600 + NODE, 8, (const uint8_t[8]){0xA3});
	}
}

static bool lasts(const struct fault *f)
{
	size_t i = 0;

	while (i < rig->site.fault_count && rig->site.faults[i] != f)
		i++;
	return i < rig->site.fault_count;
}

static void fault(void)
{
	const struct fault *f = &FAULTS[below((uint32_t)FAULT_COUNT)];
	struct site *s = &rig->site;

	if (s->fault_count == AT_ONCE || (s->fault_count && below(3) == 0)) {
		f = s->faults[below((uint32_t)s->fault_count)];
		note("over: %s", f->name);
		fault_end(s, f);
	} else if (!lasts(f) && !((f->needs & CONFIGURATION) && (rig->model.key || rig->model.saving == LOCK))) {
		note("begins: %s", f->name);
		rig->begun[rig->begun_count++] = f;
		fault_begin(s, f);
	}
}

static void pass(void)
{
	double s = (1 + below(1u << below(6))) * 0.01;

	note("%.2f s", s);
	site_run(&rig->site, s);
}

static void act(void)
{
	static void (*const actions[])(void) = {write_any, write_any, write_any, write_any, send_rpdo, send_rpdo,
		save_or_lock, procedure, preset, service, service, fault, fault, fault, pass, pass};

	/* requests of an impatient client at the same time get the answers that there are */
	site_run(&rig->site, 0.01);
	site_wait(&rig->site, 2000);
	actions[below(sizeof(actions) / sizeof(actions[0]))]();
}

/* ---- judging ----------------------------------------------------------------------------------------------------- */

static void compare(void)
{
	const struct model *m = &rig->model;
	const struct od_values *v = &rig->site.world.device.values;
	const float finite[] = {v->quaternion.w, v->velocity.x, v->angular_rate.l, v->acceleration_object.l,
		v->position_m.x, v->position_sigma.x, v->attitude_sigma.z};

	for (size_t i = 0; i < COUNT; i++) {
		uint32_t bits = 0;

		memcpy(&bits, rig->at[i], size_of(OBJECTS[i].type));
		if (bits != m->value[i])
			broken("%04Xh:%d is %g, not %g", OBJECTS[i].index, OBJECTS[i].sub,
				number(OBJECTS[i].type, bits), number(OBJECTS[i].type, m->value[i]));
	}
	if (v->pdo_preset != m->preset && v->pdo_preset != 0)
		broken("2148h is %u, not %u", v->pdo_preset, m->preset);
	if ((v->write_lock.state != 0) != (m->key != 0))
		broken("214Ch:1 is %u", v->write_lock.state);
	for (size_t i = 0; i < sizeof(finite) / sizeof(finite[0]); i++)
		if (!isfinite(finite[i]))
			broken("an output is not finite");
}

static void read_any(void)
{
	size_t i = below(COUNT);
	const struct object *o = &OBJECTS[i];
	uint32_t value, mask = o->type == REAL ? UINT32_MAX : o->type == U8 ? 0xFF : 0xFFFF;

	switch (below(3)) {
	case 0:
		site_wait(&rig->site, 1000);
		if (answers_sdo() &&
			(!site_read(&rig->site, o->index, o->sub, &value) || (value & mask) != rig->model.value[i]))
			broken("SDO reads %04Xh:%d as %08Xh", o->index, o->sub, value);
		break;
	case 1:
		if (modbus_read(rig, i) != rig->model.value[i])
			broken("Modbus reads %04Xh:%d as %08Xh", o->index, o->sub, modbus_read(rig, i));
		break;
	default:
		if (!cia309_agrees(rig, i, rig->model.value[i]))
			broken("CiA 309-3 reads another %04Xh:%d", o->index, o->sub);
	}
}

static bool may_come(uint16_t code)
{
	bool may = code == 0 || (code == 0x8200 && rig->model.rpdo_refused);

	for (size_t i = 0; i < rig->begun_count; i++) {
		may |= rig->begun[i]->code == code;
		for (int k = 0; k < 3; k++)
			may |= rig->begun[i]->also[k] == code;
	}
	return may || rig->model.bad_stored;
}

static void check_emcys(void)
{
	for (size_t i = 0; i < rig->site.emcy_count && i < SITE_EMCYS; i++)
		if (!may_come(get_u16(rig->site.emcy[i].data)))
			broken("EMCY %04Xh without a fault", get_u16(rig->site.emcy[i].data));
}

static void write_direct(uint16_t index, uint8_t sub, uint32_t bits, size_t size)
{
	uint8_t wire[4];
	struct model *m = &rig->model;
	bool waited = rig->site.world.disk_waits;

	put_u32(wire, bits);
	enum od_status status = device_write(&rig->site.world.device, index, sub, wire, size, rig->site.world.now_us);
	if (status != OD_OK && status != OD_PENDING)
		broken("at the end: %04Xh:%d: %s", index, sub, od_status_text(status));
	if (rig->site.world.disk_waits && !waited && index == 0x214C)
		m->saving = LOCK, m->saving_key = 0;
	else if (rig->site.world.disk_waits && !waited)
		begin_save(m, RESTORE);
	site_run(&rig->site, 0.05);
}

static void end_all(uint32_t seed)
{
	struct site *s = &rig->site;
	const char *wrong;
	double longest_s = 0.3;

	while (s->fault_count)
		fault_end(s, s->faults[0]);
	for (size_t i = 0; i < rig->begun_count; i++)
		longest_s = fmax(longest_s, rig->begun[i]->recovered_s);
	if (rig->model.rpdo_refused)
		longest_s = fmax(longest_s, 10.1);
	note("all faults are over, for %.1f s", longest_s);
	s->master_repairs = true;
	site_run(s, longest_s);
	compare();
	check_emcys();
	site_run(s, 1); /* after a wrong key */
	if (rig->model.key)
		write_direct(0x214C, 2, rig->model.key, 4);
	write_direct(0x2060, 1, 0, 1);
	write_direct(0x2061, 1, 0, 1);
	if (!rig->model.bad_stored && (wrong = site_communicates(s)))
		broken("%s", wrong);
	if (seed % 4 && !rig->model.bad_stored) /* what follows takes as long as all before */
		return;
	note("1011h, reset node");
	write_direct(0x1011, 1, 0x64616F6C, 4);
	site_send(s, 0, 2, (const uint8_t[2]){0x81, NODE});
	site_run(s, 4);
	compare();
	if ((wrong = site_deviation(s, 0)))
		broken("%s", wrong);
}

static void run(const struct rig *at_rest, uint32_t seed)
{
	*rig = *at_rest;
	rig->seed = seed * 2654435761u | 1;
	for (int i = 0; i < ACTIONS; i++) {
		act();
		compare();
		if (below(2))
			read_any();
		check_emcys();
	}
	end_all(seed);
}

static void set_up(void)
{
	struct device *d;

	rig = calloc(1, sizeof(*rig));
	assert_non_null(rig);
	site_init(&rig->site, 7);
	d = &rig->site.world.device;
	rig->site.heard = on_heard;
	rig->site.saved = on_saved;
	modbus_link_direct(&rig->link, serve, rig);
	modbus_access_init(
		&rig->access, &rig->link, &imu9_modbus_map, &imu9_od_table, "192.0.2.1:4711", true, sdo_abort_code);
	ascii_gateway_init(&rig->cia309, d, &rig->site.world.bus);
	rig->session = cia309_open(&rig->cia309, "uid 1000", true);
	assert_non_null(rig->session);
	for (size_t i = 0; i < COUNT; i++) {
		rig->at[i] = od_value(&d->od, OBJECTS[i].index, OBJECTS[i].sub, size_of(OBJECTS[i].type));
		assert_non_null(rig->at[i]);
		memcpy(&base[i], rig->at[i], size_of(OBJECTS[i].type));
	}
	memcpy(rig->model.value, base, sizeof(base));
	memcpy(rig->model.stored, base, sizeof(base));
	rig->model.preset = rig->model.stored_preset = 1;
}

static uint32_t under_way;

static int print_seed(void **state)
{
	(void)state;
	if (!under_way)
		return 0;
	print_error("IMU9_SEED=%u:\n", under_way);
	for (size_t i = 0; i < rig->action_count; i++)
		print_error("    %s\n", rig->actions[i]);
	return 0;
}

static uint32_t from_environment(const char *name, uint32_t otherwise)
{
	const char *text = getenv(name);

	return text ? (uint32_t)strtoul(text, NULL, 0) : otherwise;
}

static void test_random_sequences_at_all_interfaces_agree_with_the_model_and_all_recover(void **state)
{
	struct rig *at_rest = calloc(1, sizeof(*at_rest));
	uint32_t first = from_environment("IMU9_FIRST", 1), count = from_environment("IMU9_SEQUENCES", SEQUENCES);

	(void)state;
	set_up();
	assert_non_null(at_rest);
	*at_rest = *rig;
	for (uint32_t i = 0; i < count; i++) {
		under_way = getenv("IMU9_SEED") ? from_environment("IMU9_SEED", 1) : first + i;
		run(at_rest, under_way);
		if (getenv("IMU9_SEED"))
			break;
	}
	under_way = 0;
	free(at_rest);
	free(rig);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_teardown(
			test_random_sequences_at_all_interfaces_agree_with_the_model_and_all_recover, print_seed),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

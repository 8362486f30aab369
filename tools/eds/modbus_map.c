/* The rules of the register map:
 *
 * - Each object of 2000h to 21BFh begins at register 1000h + 64 * (index - 2000h), each of 6000h to 67FFh at register
 * 8000h + 16 * (index - 6000h). Its sub-indices follow each other without gaps; sub-index 0 of records is left out, as
 *   are DOMAINs. An object that is added changes no address.
 * - Below are the blocks: copies of what belongs to one sample, to be read by one request.
 * - A value that is written and only 0 or 1 is a coil, too, at the address of its register.
 * - Commands are coils, and flags discrete inputs, as listed here.
 *
 * What is listed here and not in the EDS is left out: tests/scenario/test_modbus.c notices it. */
#include "tools/eds/modbus_map.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum {
	MANUFACTURER = 0x2000,
	MANUFACTURER_END = 0x21C0,
	MANUFACTURER_AT = 0x1000,
	MANUFACTURER_ROOM = 64,
	PROFILE = 0x6000,
	PROFILE_END = 0x6800,
	PROFILE_AT = 0x8000,
	PROFILE_ROOM = 16,
	REQUEST_MAX = 125,
	BLOCK_OF_REALS = 100,
};

/* The blocks: scaled integers from 0 on, REAL32 from 100 on. */
static const struct {
	unsigned address;
	const char *object;
} BLOCKS[] = {
	{0, "sample"},
	{4, "acceleration"},
	{7, "angles"},
	{10, "position_output"},
	{19, "quaternion16"},
	{23, "angular_rate16"},
	{26, "velocity16"},
	{29, "specific_force16"},
	{32, "magnetic_field16"},
	{35, "attitude_sigma16"},
	{38, "velocity_sigma16"},
	{41, "position_sigma16"},
	{44, "error_register"},
	{BLOCK_OF_REALS, "sample"},
	{104, "acceleration_object"},
	{110, "angles_deg"},
	{116, "position_m"},
	{122, "velocity"},
	{128, "quaternion"},
	{136, "angular_rate"},
	{142, "angular_acceleration"},
	{148, "specific_force"},
	{154, "magnetic_field"},
	{160, "acceleration_global"},
	{166, "attitude_sigma"},
	{172, "acceleration_sigma"},
	{178, "velocity_sigma"},
	{184, "position_sigma"},
	{190, "displacement"},
	{196, "displacement_sigma"},
};

/* Discrete inputs: the bits of these entries. */
static const struct {
	unsigned address;
	const char *entry;
	unsigned bits;
} INPUTS[] = {
	{0, "sample.status", 16},
	{16, "error_register", 8},
};

/* Coils that are commands: the value that goes to the entry. */
static const struct {
	unsigned address, value;
	const char *entry, *what;
} COMMANDS[] = {
	{0, 1, "position.reset", "velocity and position become 0"},
	{1, 0x65766173, "store_parameters.all", "store the configuration"},
	{2, 0x64616F6C, "restore_defaults.all", "clear the stored configuration"},
	{3, 1, "bus_health.restart", "restart a CAN controller that is bus-off"},
	{8, 1, "lever_arm_identification.command", "start, reference point held still"},
	{9, 2, "lever_arm_identification.command", "start, its acceleration is known"},
	{10, 3, "lever_arm_identification.command", "accept"},
	{11, 4, "lever_arm_identification.command", "discard"},
	{12, 0, "lever_arm_identification.command", "abort"},
	{16, 1, "calibration.command", "gyro bias"},
	{17, 2, "calibration.command", "accelerometer on six faces"},
	{18, 3, "calibration.command", "accelerometer in free positions"},
	{19, 4, "calibration.command", "magnetometer"},
	{20, 10, "calibration.command", "accept"},
	{21, 11, "calibration.command", "discard"},
	{22, 0, "calibration.command", "abort"},
};

#define COUNT_OF(array) (sizeof(array) / sizeof(*(array)))

struct modbus_layout {
	const struct eds *eds;
	struct point {
		unsigned address, count;
		const struct od_entry *entry;
	} * points; /* sorted by address */
	size_t count;
};

/* ---- the layout -------------------------------------------------------------------------------------------------- */

static unsigned registers_of(const struct od_entry *entry)
{
	return (entry->size + 1u) / 2;
}

static bool in_map(const struct eds_object *object, const struct od_entry *entry)
{
	return entry->type != OD_DOMAIN && (object->kind == EDS_VAR || entry->sub > 0);
}

/* The registers of an object from `address` on. Returns the first one behind it. */
static unsigned add_object(struct modbus_layout *l, const struct eds_object *object, unsigned address)
{
	for (size_t i = 0; i < object->count; i++) {
		const struct od_entry *entry = &l->eds->table.entries[object->first + i];

		if (!in_map(object, entry))
			continue;
		l->points[l->count++] = (struct point){address, registers_of(entry), entry};
		address += registers_of(entry);
	}
	return address;
}

static bool by_rule(uint16_t index, unsigned *address, unsigned *room)
{
	if (index >= MANUFACTURER && index < MANUFACTURER_END) {
		*address = (unsigned)(MANUFACTURER_AT + MANUFACTURER_ROOM * (index - MANUFACTURER));
		*room = MANUFACTURER_ROOM;
		return true;
	}
	*address = (unsigned)(PROFILE_AT + PROFILE_ROOM * (index - PROFILE));
	*room = PROFILE_ROOM;
	return index >= PROFILE && index < PROFILE_END;
}

static const struct eds_object *find_object(const struct eds *eds, const char *name)
{
	for (size_t i = 0; i < eds->object_count; i++)
		if (strcmp(eds->objects[i].name, name) == 0)
			return &eds->objects[i];
	return NULL;
}

static int compare(const void *a, const void *b)
{
	const struct point *p = a, *q = b;

	return p->address < q->address ? -1 : p->address > q->address;
}

__attribute__((format(printf, 3, 4))) static bool fail(char *error, size_t size, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	vsnprintf(error, size, format, args);
	va_end(args);
	return false;
}

static bool lay_out(struct modbus_layout *l, char *error, size_t error_size)
{
	const struct eds *eds = l->eds;

	for (size_t i = 0; i < eds->object_count; i++) {
		unsigned address, room;

		if (by_rule(eds->objects[i].index, &address, &room) &&
			add_object(l, &eds->objects[i], address) > address + room)
			return fail(error, error_size,
				"%s has more than the %u registers of its place in the Modbus map",
				eds->objects[i].name, room);
		if (eds->objects[i].index >= MANUFACTURER_END && eds->objects[i].index < PROFILE)
			return fail(error, error_size, "%s has no place in the Modbus map", eds->objects[i].name);
	}
	for (size_t i = 0; i < COUNT_OF(BLOCKS); i++) {
		const struct eds_object *object = find_object(eds, BLOCKS[i].object);

		if (object)
			add_object(l, object, BLOCKS[i].address);
	}
	qsort(l->points, l->count, sizeof(*l->points), compare);
	for (size_t i = 1; i < l->count; i++)
		if (l->points[i - 1].address + l->points[i - 1].count > l->points[i].address)
			return fail(error, error_size, "%s and %s overlap in the Modbus map",
				l->points[i - 1].entry->name, l->points[i].entry->name);
	return true;
}

struct modbus_layout *modbus_layout_new(const struct eds *eds, char *error, size_t error_size)
{
	struct modbus_layout *l = calloc(1, sizeof(*l));
	/* an object is in one block of each kind at most */
	struct point *points = calloc(3 * eds->table.count, sizeof(*points));

	if (l && points) {
		l->eds = eds;
		l->points = points;
		if (lay_out(l, error, error_size))
			return l;
	} else {
		fail(error, error_size, "out of memory");
	}
	free(points);
	free(l);
	return NULL;
}

void modbus_layout_free(struct modbus_layout *layout)
{
	free(layout->points);
	free(layout);
}

/* ---- C ----------------------------------------------------------------------------------------------------------- */

static bool is_block(const struct point *p)
{
	return p->address < MANUFACTURER_AT;
}

static bool is_flag(const struct od_entry *entry)
{
	return (entry->access & OD_STORED) && (entry->access & OD_WRITE) && entry->size == 1 &&
	       (entry->type == OD_BOOLEAN ||
		       (entry->type == OD_UNSIGNED8 && entry->access & OD_LIMIT_HIGH && entry->high.u == 1));
}

static size_t number(const struct modbus_layout *l, const struct od_entry *entry)
{
	return (size_t)(entry - l->eds->table.entries);
}

static const struct od_entry *named(const struct modbus_layout *l, const char *name)
{
	return od_find_name(&l->eds->table, name);
}

void modbus_print_c(FILE *out, const struct modbus_layout *l)
{
	fputs("/* modbus_map.c: generated by gen-od from the EDS. Do not edit. */\n"
	      "#include \"gateway/modbus/map.h\"\n\nstatic const struct modbus_point POINTS[] = {\n",
		out);
	for (size_t i = 0; i < l->count; i++)
		fprintf(out, "\t{%u, %u, %zu}, /* %s */\n", l->points[i].address, l->points[i].count,
			number(l, l->points[i].entry), l->points[i].entry->name);
	fputs("};\n\nstatic const struct modbus_input INPUTS[] = {\n", out);
	for (size_t i = 0; i < COUNT_OF(INPUTS); i++)
		for (unsigned bit = 0; named(l, INPUTS[i].entry) && bit < INPUTS[i].bits; bit++)
			fprintf(out, "\t{%u, %zu, %u},\n", INPUTS[i].address + bit,
				number(l, named(l, INPUTS[i].entry)), bit);
	fputs("};\n\nstatic const struct modbus_coil COILS[] = {\n", out);
	for (size_t i = 0; i < COUNT_OF(COMMANDS); i++)
		if (named(l, COMMANDS[i].entry))
			fprintf(out, "\t{%u, %zu, true, %u}, /* %s */\n", COMMANDS[i].address,
				number(l, named(l, COMMANDS[i].entry)), COMMANDS[i].value, COMMANDS[i].what);
	for (size_t i = 0; i < l->count; i++)
		if (is_flag(l->points[i].entry))
			fprintf(out, "\t{%u, %zu, false, 0}, /* %s */\n", l->points[i].address,
				number(l, l->points[i].entry), l->points[i].entry->name);
	fprintf(out,
		"};\n\n#define COUNT(array) (sizeof(array) / sizeof(*(array)))\n\n"
		"const struct modbus_map imu9_modbus_map = {POINTS, INPUTS, COILS, COUNT(POINTS), COUNT(INPUTS), "
		"COUNT(COILS),\n\t\"%s\", \"%s\"};\n",
		l->eds->info.vendor_name, l->eds->info.order_code);
}

/* ---- for people -------------------------------------------------------------------------------------------------- */

/* The registers of both kinds of strings are the same. */
static const char *type_name(const struct od_entry *entry)
{
	return entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING ? "string" : eds_type_name(entry);
}

static const char *access_text(const struct od_entry *entry)
{
	return !(entry->access & OD_WRITE) ? "r" : entry->access & OD_READ ? "rw" : "w";
}

static void print_step(FILE *out, const struct od_entry *entry)
{
	if (entry->factor != 1)
		fprintf(out, "%.7g%s", entry->factor, *entry->unit ? " " : "");
	fputs(entry->unit, out);
}

static void print_rows(FILE *out, const struct modbus_layout *l, unsigned from, unsigned to)
{
	fputs("| Register | hex | Number | Object | Name | Type | Access | Unit |\n|---|---|---|---|---|---|---|---|\n",
		out);
	for (size_t i = 0; i < l->count; i++) {
		const struct point *p = &l->points[i];

		if (p->address < from || p->address >= to)
			continue;
		fprintf(out, "| %u | %04X | %u | %04Xh:%u | `%s` | %s | %s | ", p->address, p->address, p->count,
			p->entry->index, p->entry->sub, p->entry->name, type_name(p->entry), access_text(p->entry));
		print_step(out, p->entry);
		fputs(" |\n", out);
	}
}

void modbus_print_markdown(FILE *out, const struct modbus_layout *l)
{
	fputs("### Block of integers\n\n", out);
	print_rows(out, l, 0, BLOCK_OF_REALS);
	fputs("\n### Block of REAL32\n\n", out);
	print_rows(out, l, BLOCK_OF_REALS, MANUFACTURER_AT);
	fputs("\n### Discrete inputs\n\n| Input | Bit |\n|---|---|\n", out);
	for (size_t i = 0; i < COUNT_OF(INPUTS); i++)
		fprintf(out, "| %u to %u | bits 0 to %u of `%s` |\n", INPUTS[i].address,
			INPUTS[i].address + INPUTS[i].bits - 1, INPUTS[i].bits - 1, INPUTS[i].entry);
	fputs("\n### Coils\n\n| Coil | What it does |\n|---|---|\n", out);
	for (size_t i = 0; i < COUNT_OF(COMMANDS); i++)
		fprintf(out, "| %u | `%s`: %s |\n", COMMANDS[i].address, COMMANDS[i].entry, COMMANDS[i].what);
	for (size_t i = 0; i < l->count; i++)
		if (is_flag(l->points[i].entry))
			fprintf(out, "| %u | `%s` |\n", l->points[i].address, l->points[i].entry->name);
	fputs("\n### Objects\n\n", out);
	print_rows(out, l, MANUFACTURER_AT, 0x10000);
}

/* ---- for programs ------------------------------------------------------------------------------------------------ */

void modbus_print_csv(FILE *out, const struct modbus_layout *l)
{
	fputs("table,address,count,index,sub,name,type,access,factor,unit\n", out);
	for (size_t i = 0; i < l->count; i++) {
		const struct point *p = &l->points[i];

		fprintf(out, "register,%u,%u,0x%04X,%u,%s,%s,%s,%.9g,%s\n", p->address, p->count, p->entry->index,
			p->entry->sub, p->entry->name, type_name(p->entry), access_text(p->entry), p->entry->factor,
			p->entry->unit);
	}
	for (size_t i = 0; i < COUNT_OF(INPUTS); i++) {
		const struct od_entry *e = named(l, INPUTS[i].entry);

		for (unsigned bit = 0; e && bit < INPUTS[i].bits; bit++)

			fprintf(out, "input,%u,1,0x%04X,%u,%s.%u,bit,r,1,\n", INPUTS[i].address + bit, e->index, e->sub,
				e->name, bit);
	}
	for (size_t i = 0; i < COUNT_OF(COMMANDS); i++) {
		const struct od_entry *e = named(l, COMMANDS[i].entry);

		if (e)
			fprintf(out, "coil,%u,1,0x%04X,%u,%s=%u,command,w,1,\n", COMMANDS[i].address, e->index, e->sub,
				e->name, COMMANDS[i].value);
	}
	for (size_t i = 0; i < l->count; i++)
		if (is_flag(l->points[i].entry))
			fprintf(out, "coil,%u,1,0x%04X,%u,%s,bit,rw,1,\n", l->points[i].address,
				l->points[i].entry->index, l->points[i].entry->sub, l->points[i].entry->name);
}

/* Types of inputs.modbus; "" for what it cannot read. */
static const char *telegraf_type(const struct od_entry *entry)
{
	switch ((enum od_type)entry->type) {
	case OD_INTEGER8:
	case OD_INTEGER16:
		return "INT16";
	case OD_UNSIGNED8:
	case OD_UNSIGNED16:
	case OD_BOOLEAN:
		return "UINT16";
	case OD_INTEGER32:
		return "INT32";
	case OD_UNSIGNED32:
		return "UINT32";
	case OD_REAL32:
		return "FLOAT32";
	default:
		return "";
	}
}

void modbus_print_telegraf(FILE *out, const struct modbus_layout *l)
{
	fputs("# Generated by gen-od from the EDS: the two blocks of the IMU9 gateway.\n"
	      "[[inputs.modbus]]\n"
	      "  name = \"imu9\"\n"
	      "  controller = \"tcp://127.0.0.1:1502\"\n"
	      "  timeout = \"1s\"\n"
	      "  configuration_type = \"request\"\n\n"
	      "  [[inputs.modbus.request]]\n"
	      "    slave_id = 1\n"
	      "    byte_order = \"ABCD\"\n"
	      "    register = \"input\"\n"
	      "    optimization = \"none\"\n"
	      "    measurement = \"imu9\"\n"
	      "    fields = [\n",
		out);
	for (size_t i = 0; i < l->count; i++) {
		const struct point *p = &l->points[i];
		bool integer = p->entry->type != OD_REAL32;

		if (!is_block(p) || p->address < BLOCK_OF_REALS || !*telegraf_type(p->entry))
			continue;
		fprintf(out, "      { address = %u, name = \"%s\", type = \"%s\"%s },\n", p->address, p->entry->name,
			telegraf_type(p->entry), integer ? "" : ", output = \"FLOAT64\"");
	}
	fputs("    ]\n", out);
}

/* How a Buffer of JavaScript reads it. */
static const char *buffer_read(const struct od_entry *entry)
{
	switch ((enum od_type)entry->type) {
	case OD_INTEGER8:
	case OD_INTEGER16:
		return "readInt16BE";
	case OD_UNSIGNED8:
	case OD_UNSIGNED16:
	case OD_BOOLEAN:
		return "readUInt16BE";
	case OD_INTEGER32:
		return "readInt32BE";
	case OD_UNSIGNED32:
		return "readUInt32BE";
	case OD_REAL32:
		return "readFloatBE";
	default:
		return "";
	}
}

/* The registers of the block of REAL32: one request, up to the last whole value that fits. */
static unsigned block_registers(const struct modbus_layout *l)
{
	unsigned end = BLOCK_OF_REALS;

	for (size_t i = 0; i < l->count; i++) {
		unsigned behind = l->points[i].address + l->points[i].count;

		if (is_block(&l->points[i]) && l->points[i].address >= BLOCK_OF_REALS &&
			behind <= BLOCK_OF_REALS + REQUEST_MAX)
			end = behind;
	}
	return end - BLOCK_OF_REALS;
}

void modbus_print_node_red(FILE *out, const struct modbus_layout *l)
{
	fprintf(out,
		"[{\"id\":\"imu9tab\",\"type\":\"tab\",\"label\":\"IMU9 gateway\"},\n"
		"{\"id\":\"imu9client\",\"type\":\"modbus-client\",\"name\":\"imu9\",\"clienttype\":\"tcp\","
		"\"tcpHost\":\"127.0.0.1\",\"tcpPort\":\"1502\",\"unit_id\":\"1\",\"commandDelay\":\"1\","
		"\"clientTimeout\":\"1000\",\"reconnectTimeout\":\"2000\",\"bufferCommands\":true},\n"
		"{\"id\":\"imu9read\",\"type\":\"modbus-read\",\"z\":\"imu9tab\",\"name\":\"block of REAL32\","
		"\"dataType\":\"InputRegister\",\"adr\":\"%d\",\"quantity\":\"%u\",\"rate\":\"1\",\"rateUnit\":\"s\","
		"\"server\":\"imu9client\",\"x\":160,\"y\":80,\"wires\":[[],[\"imu9decode\"]]},\n"
		"{\"id\":\"imu9decode\",\"type\":\"function\",\"z\":\"imu9tab\",\"name\":\"values\",\"outputs\":1,"
		"\"x\":360,\"y\":80,\"wires\":[[\"imu9debug\"]],\"func\":\"const b = msg.payload.buffer;\\nmsg.payload "
		"= {\\n",
		BLOCK_OF_REALS, block_registers(l));
	for (size_t i = 0; i < l->count; i++) {
		const struct point *p = &l->points[i];

		if (is_block(p) && p->address >= BLOCK_OF_REALS &&
			p->address + p->count <= BLOCK_OF_REALS + block_registers(l))
			fprintf(out, "  '%s': b.%s(%u),\\n", p->entry->name, buffer_read(p->entry),
				2 * (p->address - BLOCK_OF_REALS));
	}
	fputs("};\\nreturn msg;\"},\n"
	      "{\"id\":\"imu9debug\",\"type\":\"debug\",\"z\":\"imu9tab\",\"name\":\"\",\"active\":true,\"console\":"
	      "true,"
	      "\"complete\":\"payload\",\"x\":540,\"y\":80,\"wires\":[]}]\n",
		out);
}

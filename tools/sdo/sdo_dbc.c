/* imu9-sdo dbc: a DBC of the PDOs as the node has them now: node-ID, COB-IDs, mapping and resolutions; bits that have
 * words as signals. For tools that support CAN but not CANopen. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/emcy_codes.h"
#include "od_index.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_session.h"

enum { NAME_MAX_LENGTH = 32, MAP_MAX = 8, DUMMY_LAST = 0x1F, PDOS_MAX = 8 };

static const uint16_t emcy_codes[] = {EMCY_NO_ERROR, EMCY_SLOPE_LONG, EMCY_SLOPE_LATERAL, EMCY_SENSOR_LOST,
	EMCY_SENSOR_DEGRADED, EMCY_IMPLAUSIBLE, EMCY_STORE_DAMAGED, EMCY_DATA_SET, EMCY_CONFIGURATION,
	EMCY_SENSOR_SETTINGS, EMCY_SYNC_TIME, EMCY_CAN_OVERRUN, EMCY_ERROR_PASSIVE, EMCY_HEARTBEAT, EMCY_BUS_OFF_OVER,
	EMCY_COLLISION, EMCY_PDO_CONTENT, EMCY_PDO_SHORT, EMCY_PDO_LONG, EMCY_SYNC_LENGTH, EMCY_PDO_TIMEOUT,
	EMCY_POSITION_UNSURE};

/* The parts of a DBC come in this order. */
struct dbc {
	struct session *session;
	FILE *messages, *comments, *values, *types;
	bool failed; /* the node gave no answer */
};

/* False, after a message, when the node has it and does not give it. An object that it does not have is 0. */
static bool read_number(struct dbc *dbc, uint16_t index, uint8_t sub, uint32_t *value)
{
	struct cli_node *node = &dbc->session->node;
	uint8_t wire[8];

	*value = 0;
	if (dbc->failed)
		return false;
	if (cli_node_read(node, index, sub, wire, sizeof(wire))) {
		*value = (uint32_t)sdo_number(wire, node->sdo.size);
		return true;
	}
	if (node->sdo.result == SDO_ABORTED && node->sdo.aborted_by_server)
		return false;
	cli_node_explain(node, od_find(dbc->session->table, index, sub, NULL));
	dbc->failed = true;
	return false;
}

static void print_text(FILE *out, const char *text)
{
	fputc('"', out);
	for (; *text; text++)
		fputc(*text == '"' || *text == '\\' ? '\'' : *text, out);
	fputc('"', out);
}

/* ---- signals ----------------------------------------------------------------------------------------------------- */

struct message {
	uint32_t id;
	const char *receiver;
	unsigned bit; /* where the next signal begins */
	char names[8 * MAP_MAX][NAME_MAX_LENGTH + 1];
	unsigned count;
};

static bool is_used(const struct message *m, const char *name)
{
	for (unsigned i = 0; i < m->count; i++)
		if (strcmp(m->names[i], name) == 0)
			return true;
	return false;
}

/* Valid and different from the others: an object can be mapped twice. */
static const char *new_name(struct message *m, const char *text)
{
	char base[NAME_MAX_LENGTH + 1], *name = m->names[m->count];

	snprintf(base, sizeof(base), "%s", text);
	for (char *dot = base; (dot = strchr(dot, '.'));)
		*dot = '_';
	strcpy(name, base);
	for (uint8_t n = 2; is_used(m, name); n++)
		snprintf(name, NAME_MAX_LENGTH + 1, "%.28s_%u", base, n);
	m->count++;
	return name;
}

static void print_signal(struct dbc *dbc, struct message *m, const char *text, const struct od_entry *e, unsigned bits)
{
	bool real = e && (e->type == OD_REAL32 || e->type == OD_REAL64);
	bool is_signed = e && (e->type == OD_INTEGER8 || e->type == OD_INTEGER16 || e->type == OD_INTEGER32 ||
				      e->type == OD_INTEGER64);
	double step = e ? sdo_step(dbc->session, e) : 1, all = 1;
	const char *name = new_name(m, text);

	for (unsigned i = is_signed ? 1 : 0; i < bits; i++)
		all *= 2;
	fprintf(dbc->messages, " SG_ %s : %u|%u@1%c (%.10g,0) [%.10g|%.10g] \"%s\" %s\n", name, m->bit, bits,
		is_signed || real ? '-' : '+', step, real || !is_signed ? 0 : -all * step, real ? 0 : (all - 1) * step,
		e ? e->unit : "", m->receiver);
	if (real)
		fprintf(dbc->types, "SIG_VALTYPE_ %u %s : %d;\n", m->id, name, e->type == OD_REAL32 ? 1 : 2);
	if (e && e->description[0]) {
		fprintf(dbc->comments, "CM_ SG_ %u %s ", m->id, name);
		print_text(dbc->comments, e->description);
		fputs(";\n", dbc->comments);
	}
	m->bit += bits;
}

/* A signal for each bit that has a word: "status_valid". */
static void print_bits(struct dbc *dbc, struct message *m, const struct od_entry *entry, unsigned bits)
{
	const char *dot = strrchr(entry->name, '.');
	unsigned first = m->bit;
	struct od_word word = {0};
	char name[NAME_MAX_LENGTH + 1];

	while (od_next_word(entry, &word)) {
		m->bit = first + word.number;
		snprintf(name, sizeof(name), "%s_%.*s", dot ? dot + 1 : entry->name, (int)word.length, word.text);
		print_signal(dbc, m, name, NULL, 1);
		fprintf(dbc->values, "VAL_ %u %s 0 \"no\" 1 \"yes\" ;\n", m->id, m->names[m->count - 1]);
	}
	m->bit = first + bits;
}

static void print_words(struct dbc *dbc, const struct message *m, const struct od_entry *entry)
{
	struct od_word word = {0};

	fprintf(dbc->values, "VAL_ %u %s", m->id, m->names[m->count - 1]);
	while (od_next_word(entry, &word))
		fprintf(dbc->values, " %u \"%.*s\"", word.number, (int)word.length, word.text);
	fputs(" ;\n", dbc->values);
}

/* A mapping entry: index << 16 | sub-index << 8 | bits. Dummies of an RPDO are gaps. */
static void print_mapped(struct dbc *dbc, struct message *m, uint32_t mapping)
{
	const struct od_table *table = dbc->session->table;
	uint16_t index = (uint16_t)(mapping >> 16);
	uint8_t sub = (uint8_t)(mapping >> 8), bits = (uint8_t)mapping;
	const struct od_entry *entry = od_find(table, index, sub, NULL);
	bool fits = entry && entry->size * 8u == bits, words = fits && od_has_words(entry);
	char unknown[NAME_MAX_LENGTH];

	if (index <= DUMMY_LAST || bits > 64 || m->bit + bits > 64) {
		m->bit += bits;
	} else if (words && entry->words_of_bits) {
		print_bits(dbc, m, entry, bits);
	} else {
		snprintf(unknown, sizeof(unknown), "object_%04X_%02X", index, sub);
		print_signal(dbc, m, entry ? entry->name : unknown, fits ? entry : NULL, bits);
		if (words)
			print_words(dbc, m, entry);
	}
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

static void print_pdo(struct dbc *dbc, uint16_t communication, const char *kind, unsigned number)
{
	bool received = communication < PDO_FIRST_TPDO;
	struct message m = {.receiver = received ? "IMU9" : "Vector__XXX"};
	uint32_t cob_id, count, mapping[MAP_MAX] = {0};
	unsigned bits = 0;

	if (!read_number(dbc, communication, 1, &cob_id) || cob_id & COB_ID_INVALID ||
		!read_number(dbc, communication | PDO_MAPPING, 0, &count))
		return;
	for (uint8_t i = 0; i < count && i < MAP_MAX; i++) {
		read_number(dbc, communication | PDO_MAPPING, (uint8_t)(i + 1), &mapping[i]);
		bits += mapping[i] & 0xFF;
	}
	if (bits == 0)
		return;
	m.id = cob_id & COB_ID_MASK;
	fprintf(dbc->messages, "BO_ %u %s%u: %u %s\n", m.id, kind, number, (bits + 7) / 8,
		received ? "Vector__XXX" : "IMU9");
	for (uint8_t i = 0; i < count && i < MAP_MAX; i++)
		print_mapped(dbc, &m, mapping[i]);
	fputc('\n', dbc->messages);
}

static void print_emcy(struct dbc *dbc)
{
	uint32_t cob_id;

	if (!read_number(dbc, OD_INDEX_COB_ID_EMCY, 0, &cob_id) || cob_id & COB_ID_INVALID)
		return;
	cob_id &= COB_ID_MASK;
	fprintf(dbc->messages,
		"BO_ %u EMCY: 8 IMU9\n"
		" SG_ emcy_error_code : 0|16@1+ (1,0) [0|65535] \"\" Vector__XXX\n"
		" SG_ emcy_error_register : 16|8@1+ (1,0) [0|255] \"\" Vector__XXX\n"
		" SG_ emcy_information : 24|40@1+ (1,0) [0|1099511627775] \"\" Vector__XXX\n\n",
		cob_id);
	if (dbc->session->eds_path)
		return; /* another device has codes of its own */
	fprintf(dbc->values, "VAL_ %u emcy_error_code", cob_id);
	for (size_t i = 0; i < sizeof(emcy_codes) / sizeof(emcy_codes[0]); i++) {
		fprintf(dbc->values, " %u ", emcy_codes[i]);
		print_text(dbc->values, emcy_code_text(emcy_codes[i]));
	}
	fputs(" ;\n", dbc->values);
}

static void print_heartbeat(struct dbc *dbc)
{
	uint32_t id = CAN_ID_ERROR_CONTROL + (uint32_t)dbc->session->node_id;

	fprintf(dbc->messages, "BO_ %u Heartbeat: 1 IMU9\n SG_ nmt_state : 0|7@1+ (1,0) [0|127] \"\" Vector__XXX\n\n",
		id);
	fprintf(dbc->values,
		"VAL_ %u nmt_state 0 \"boot-up\" 4 \"stopped\" 5 \"operational\" 127 \"pre-operational\" ;\n", id);
}

static void print_dbc(struct dbc *dbc)
{
	for (unsigned n = 0; n < PDOS_MAX; n++)
		print_pdo(dbc, (uint16_t)(PDO_FIRST_TPDO + n), "TPDO", n + 1);
	for (unsigned n = 0; n < PDOS_MAX; n++)
		print_pdo(dbc, (uint16_t)(PDO_FIRST_RPDO + n), "RPDO", n + 1);
	print_emcy(dbc);
	print_heartbeat(dbc);
}

int sdo_command_dbc(struct session *s, int argc, char **argv)
{
	char *parts[4] = {NULL}, *text = NULL;
	size_t sizes[4], size;
	struct dbc dbc = {.session = s,
		.messages = sdo_open_text(&parts[0], &sizes[0]),
		.comments = sdo_open_text(&parts[1], &sizes[1]),
		.values = sdo_open_text(&parts[2], &sizes[2]),
		.types = sdo_open_text(&parts[3], &sizes[3])};
	FILE *out = sdo_open_text(&text, &size), *const streams[] = {dbc.messages, dbc.comments, dbc.values, dbc.types};

	sdo_open(s);
	print_dbc(&dbc);
	sdo_close(s);
	fputs("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: IMU9\n\n", out);
	for (size_t i = 0; i < 4; i++) {
		fclose(streams[i]);
		fputs(parts[i], out);
		if (i == 0)
			fprintf(out,
				"CM_ \"imu9-sdo " IMU9_VERSION ": node-ID %ld, mapping and resolutions as read.\";\n",
				s->node_id);
		free(parts[i]);
	}
	fclose(out);
	bool written = !dbc.failed && sdo_write_file(argc > 0 ? argv[0] : "-", text, size);
	free(text);
	return written ? CLI_OK : CLI_FAILED;
}

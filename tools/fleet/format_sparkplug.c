/* Sparkplug B 3.0: this process is an edge node, the CANopen nodes of the bus are its devices, the values are metrics
 * by their names in the EDS, with aliases. Births are QoS 0 as the specification says; data and the death of a
 * device are QoS 1, so that what was not acknowledged is sent again. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/emcy_codes.h"
#include "od/little_endian.h"
#include "sparkplug_b.pb-c.h"
#include "tools/fleet/format.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/watch.h"

typedef Sparkplug__Payload__Metric metric;

/* data types of the specification */
enum {
	SPARKPLUG_INT32 = 3,
	SPARKPLUG_INT64 = 4,
	SPARKPLUG_UINT32 = 7,
	SPARKPLUG_UINT64 = 8,
	SPARKPLUG_FLOAT = 9,
	SPARKPLUG_DOUBLE = 10,
	SPARKPLUG_BOOLEAN = 11,
	SPARKPLUG_STRING = 12
};

/* the metrics beside the mapped objects, as sub-indices of index 0 */
enum { SAMPLE = 1, NMT_STATE, EMCY_CODE, EMCY_REGISTER, EMCY_TEXT, ANSWER };

enum { METRICS_MAX = RECORD_FIELDS + 8, STRING_MAX = RECORD_TEXT_MAX, UNITS_NAMED = 1 };

/* A payload under construction; what it points to. */
struct building {
	Sparkplug__Payload payload;
	metric metrics[METRICS_MAX], *list[METRICS_MAX];
	char names[METRICS_MAX][96];
	char text[STRING_MAX];
	Sparkplug__Payload__PropertySet sets[METRICS_MAX];
	Sparkplug__Payload__PropertyValue units[METRICS_MAX], *unit_list[METRICS_MAX];
	bool birth, late;
	uint64_t ms;
};

static char UNIT_KEY[] = "engUnit", *UNIT_KEYS[] = {UNIT_KEY};

static void begin(struct building *p, int64_t utc_us, bool birth, bool late)
{
	sparkplug__payload__init(&p->payload);
	p->payload.metrics = p->list;
	p->birth = birth;
	p->late = late;
	p->ms = (uint64_t)utc_us / 1000;
	p->payload.has_timestamp = true;
	p->payload.timestamp = p->ms;
}

/* A metric; its value follows. Data have no name: that of the alias was in the birth. */
static metric *add(struct building *p, const char *name, uint64_t alias, uint32_t datatype)
{
	size_t n = p->payload.n_metrics++;
	metric *m = &p->metrics[n];

	sparkplug__payload__metric__init(m);
	p->list[n] = m;
	m->has_timestamp = true;
	m->timestamp = p->ms;
	m->has_alias = alias != 0;
	m->alias = alias;
	if (p->birth || alias == 0) {
		snprintf(p->names[n], sizeof(p->names[n]), "%s", name);
		m->name = p->names[n];
		m->has_datatype = true;
		m->datatype = datatype;
	}
	m->has_is_historical = m->is_historical = p->late;
	return m;
}

static void set_int(metric *m, uint32_t value)
{
	m->value_case = SPARKPLUG__PAYLOAD__METRIC__VALUE_INT_VALUE;
	m->int_value = value;
}

static void set_long(metric *m, uint64_t value)
{
	m->value_case = SPARKPLUG__PAYLOAD__METRIC__VALUE_LONG_VALUE;
	m->long_value = value;
}

static void set_boolean(metric *m, bool value)
{
	m->value_case = SPARKPLUG__PAYLOAD__METRIC__VALUE_BOOLEAN_VALUE;
	m->boolean_value = value;
}

static void set_string(metric *m, const char *value)
{
	m->value_case = SPARKPLUG__PAYLOAD__METRIC__VALUE_STRING_VALUE;
	m->string_value = (char *)(uintptr_t)value; /* it is not written */
}

static void set_real(metric *m, double value, bool is_float)
{
	m->value_case = is_float ? SPARKPLUG__PAYLOAD__METRIC__VALUE_FLOAT_VALUE
				 : SPARKPLUG__PAYLOAD__METRIC__VALUE_DOUBLE_VALUE;
	if (is_float)
		m->float_value = (float)value;
	else
		m->double_value = value;
	if (!isfinite(value)) {
		m->value_case = SPARKPLUG__PAYLOAD__METRIC__VALUE__NOT_SET;
		m->has_is_null = m->is_null = true;
	}
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

/* Unique for the edge node, and the same after a restart. */
static uint64_t alias_of(uint8_t node_id, uint32_t mapping)
{
	return (uint64_t)node_id << 24 | mapping >> 8;
}

static bool is_signed(const struct od_entry *entry)
{
	return entry->type == OD_INTEGER8 || entry->type == OD_INTEGER16 || entry->type == OD_INTEGER32 ||
	       entry->type == OD_INTEGER64;
}

/* A scaled value of at most 16 bits has all of its digits in a float. */
static uint32_t datatype_of(const struct od_entry *entry, const struct record_field *field)
{
	size_t size = record_field_size(field);
	bool scaled = field->step < 1 || field->step > 1;

	if (!entry)
		return size <= 4 ? SPARKPLUG_UINT32 : SPARKPLUG_UINT64;
	if (entry->type == OD_REAL32 || (scaled && size <= 2))
		return SPARKPLUG_FLOAT;
	if (entry->type == OD_REAL64 || scaled)
		return SPARKPLUG_DOUBLE;
	switch ((enum od_type)entry->type) {
	case OD_BOOLEAN:
		return SPARKPLUG_BOOLEAN;
	case OD_VISIBLE_STRING:
	case OD_OCTET_STRING:
		return SPARKPLUG_STRING;
	default:
		break;
	}
	if (is_signed(entry))
		return size <= 4 ? SPARKPLUG_INT32 : SPARKPLUG_INT64;
	return size <= 4 ? SPARKPLUG_UINT32 : SPARKPLUG_UINT64;
}

static void set_field(struct building *p, metric *m, const struct od_entry *entry, const struct record_field *field,
	uint32_t datatype)
{
	uint8_t wire[OD_VALUE_MAX] = {0};
	size_t size = record_field_size(field);

	put_uint(wire, field->wire, 8);
	switch (datatype) {
	case SPARKPLUG_FLOAT:
	case SPARKPLUG_DOUBLE:
		set_real(m, cli_number(entry, wire) * field->step, datatype == SPARKPLUG_FLOAT);
		break;
	case SPARKPLUG_BOOLEAN:
		set_boolean(m, wire[0] != 0);
		break;
	case SPARKPLUG_STRING:
		if (od_format(entry, wire, entry->size, p->text, sizeof(p->text)) < 0)
			p->text[0] = '\0';
		set_string(m, p->text);
		break;
	case SPARKPLUG_INT32:
		set_int(m, (uint32_t)sign_extend(field->wire, size));
		break;
	case SPARKPLUG_INT64:
		set_long(m, (uint64_t)sign_extend(field->wire, size));
		break;
	case SPARKPLUG_UINT32:
		set_int(m, (uint32_t)field->wire);
		break;
	default:
		set_long(m, field->wire);
		break;
	}
}

static void set_unit(struct building *p, metric *m, const char *unit)
{
	size_t n = p->payload.n_metrics - 1;
	Sparkplug__Payload__PropertyValue *value = &p->units[n];
	Sparkplug__Payload__PropertySet *set = &p->sets[n];

	sparkplug__payload__property_value__init(value);
	value->has_type = true;
	value->type = SPARKPLUG_STRING;
	value->value_case = SPARKPLUG__PAYLOAD__PROPERTY_VALUE__VALUE_STRING_VALUE;
	value->string_value = (char *)(uintptr_t)unit;
	p->unit_list[n] = value;
	sparkplug__payload__property_set__init(set);
	set->n_keys = set->n_values = UNITS_NAMED;
	set->keys = UNIT_KEYS;
	set->values = &p->unit_list[n];
	m->properties = set;
}

static void add_values(struct format *f, struct building *p, const struct record *record)
{
	char name[96];

	for (size_t i = 0; i < record->field_count; i++) {
		const struct record_field *field = &record->fields[i];
		const struct od_entry *entry = format_entry(f, record->node_id, field);
		uint32_t datatype = datatype_of(entry, field);

		format_name(entry, field, name, sizeof(name));
		metric *m = add(p, name, alias_of(record->node_id, field->mapping), datatype);
		set_field(p, m, entry, field, datatype);
		if (p->birth && entry && entry->unit[0])
			set_unit(p, m, entry->unit);
	}
	if (record->counted)
		set_int(add(p, "sample.counter", alias_of(record->node_id, SAMPLE << 8), SPARKPLUG_UINT32),
			record->counter);
}

static void add_state(struct building *p, uint8_t node_id, int nmt_state)
{
	set_string(add(p, "nmt_state", alias_of(node_id, NMT_STATE << 8), SPARKPLUG_STRING), watch_nmt_text(nmt_state));
}

static void add_emcy(struct building *p, uint8_t node_id, const uint8_t emcy[8])
{
	uint16_t code = get_u16(emcy);

	set_int(add(p, "emcy.code", alias_of(node_id, EMCY_CODE << 8), SPARKPLUG_UINT32), code);
	set_int(add(p, "emcy.register", alias_of(node_id, EMCY_REGISTER << 8), SPARKPLUG_UINT32), emcy[2]);
	set_string(add(p, "emcy.text", alias_of(node_id, EMCY_TEXT << 8), SPARKPLUG_STRING), emcy_code_text(code));
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

/* spBv1.0/GROUP/TYPE/EDGE[/DEVICE] */
static long publish(
	struct format *f, const struct publisher *to, struct building *p, const char *type, uint8_t node_id, int qos)
{
	int n = snprintf(f->topic, sizeof(f->topic), "spBv1.0/%s/%s/%s", f->config.prefix, type, f->config.bus);

	if (node_id)
		snprintf(f->topic + n, sizeof(f->topic) - (size_t)n, "/%u", node_id);
	p->payload.has_seq = true;
	p->payload.seq = f->seq;
	if (sparkplug__payload__get_packed_size(&p->payload) > sizeof(f->payload))
		return 0;
	size_t size = sparkplug__payload__pack(&p->payload, f->payload);
	long result = to->publish(
		to->ctx, &(struct message){.topic = f->topic, .payload = f->payload, .size = size, .qos = qos});
	if (result >= 0)
		f->seq++;
	return result;
}

static bool is_alive(const struct node_view *view)
{
	return view->configured && !(view->has_state && view->nmt_state == WATCH_NMT_LOST);
}

static bool publish_birth(struct format *f, const struct publisher *to, uint8_t node_id, int64_t utc_us)
{
	struct node_view *view = &f->nodes[node_id];
	static struct building p;

	begin(&p, utc_us, true, false);
	add_values(f, &p, &view->values);
	add_state(&p, node_id, view->has_state ? view->nmt_state : WATCH_NMT_UNKNOWN);
	add_emcy(&p, node_id, view->emcy);
	set_string(add(&p, "answer", alias_of(node_id, ANSWER << 8), SPARKPLUG_STRING), "");
	view->born = publish(f, to, &p, "DBIRTH", node_id, 0) >= 0;
	return view->born;
}

/* Of the edge node. */
static void add_counts(struct building *p, const struct fleet_status *status)
{
	const struct {
		const char *name;
		uint64_t count;
	} counts[] = {{"nodes", status->nodes}, {"samples", status->samples}, {"delivered", status->delivered},
		{"spool/records", status->spooled}, {"dropped/frames", status->bus_dropped},
		{"dropped/hand_over", status->hand_over_dropped}, {"dropped/commands", status->commands_dropped},
		{"dropped/spool", status->spool_dropped}, {"dropped/disk", status->lost}};

	for (size_t i = 0; i < sizeof(counts) / sizeof(counts[0]); i++)
		set_long(add(p, counts[i].name, 0, SPARKPLUG_UINT64), counts[i].count);
}

/* NDEATH, with the number that the birth of the connection will have. */
static void sparkplug_will(struct format *f, struct message *message)
{
	static struct building p;

	begin(&p, 0, true, false);
	p.payload.has_timestamp = false;
	f->birth++;
	metric *m = add(&p, "bdSeq", 0, SPARKPLUG_INT64);
	m->has_timestamp = false;
	set_long(m, f->birth);
	snprintf(f->topic, sizeof(f->topic), "spBv1.0/%s/NDEATH/%s", f->config.prefix, f->config.bus);
	*message = (struct message){
		.topic = f->topic,
		.payload = f->payload,
		.size = sparkplug__payload__pack(&p.payload, f->payload),
		.qos = 1,
	};
}

static bool sparkplug_begin(struct format *f, const struct publisher *to, int64_t utc_us)
{
	static struct building p;
	bool published;

	begin(&p, utc_us, true, false);
	set_long(add(&p, "bdSeq", 0, SPARKPLUG_INT64), f->birth);
	set_boolean(add(&p, "Node Control/Rebirth", 0, SPARKPLUG_BOOLEAN), false);
	add_counts(&p, &f->status);
	f->seq = 0;
	published = publish(f, to, &p, "NBIRTH", 0, 0) >= 0;
	for (unsigned id = 1; id < FORMAT_NODES && published; id++) {
		f->nodes[id].born = false;
		if (is_alive(&f->nodes[id]))
			published = publish_birth(f, to, (uint8_t)id, utc_us);
	}
	return published;
}

/* ---- records ----------------------------------------------------------------------------------------------------- */

static long publish_values(struct format *f, const struct publisher *to, const struct record *record, bool late)
{
	static struct building p;

	begin(&p, record->utc_us, false, late);
	add_values(f, &p, record);
	return publish(f, to, &p, "DDATA", record->node_id, 1);
}

static long publish_state(struct format *f, const struct publisher *to, const struct record *record, bool late)
{
	static struct building p;
	struct node_view *view = &f->nodes[record->node_id];

	if (record->nmt_state == WATCH_NMT_LOST) {
		bool was_born = view->born;

		view->born = false;
		begin(&p, record->utc_us, false, false);
		return was_born ? publish(f, to, &p, "DDEATH", record->node_id, 1) : 0;
	}
	if (!view->born) /* the birth has the state */
		return !view->configured || publish_birth(f, to, record->node_id, record->utc_us) ? 0 : -1;
	begin(&p, record->utc_us, false, late);
	add_state(&p, record->node_id, record->nmt_state);
	return publish(f, to, &p, "DDATA", record->node_id, 1);
}

static long publish_emcy(struct format *f, const struct publisher *to, const struct record *record, bool late)
{
	static struct building p;

	begin(&p, record->utc_us, false, late);
	add_emcy(&p, record->node_id, record->emcy);
	return f->nodes[record->node_id].born ? publish(f, to, &p, "DDATA", record->node_id, 1) : 0;
}

static long publish_answer(struct format *f, const struct publisher *to, const struct record *record)
{
	static struct building p;

	begin(&p, record->utc_us, false, false);
	set_string(add(&p, "answer", alias_of(record->node_id, ANSWER << 8), SPARKPLUG_STRING), record->text);
	return f->nodes[record->node_id].born ? publish(f, to, &p, "DDATA", record->node_id, 1) : 0;
}

static long sparkplug_record(struct format *f, const struct publisher *to, const struct record *record, bool late)
{
	struct node_view *view = &f->nodes[record->node_id];

	switch (record->kind) {
	case RECORD_VALUES:
		if ((format_learn(view, record) || !view->born) &&
			!publish_birth(f, to, record->node_id, record->utc_us))
			return -1;
		return publish_values(f, to, record, late);
	case RECORD_STATE:
		view->nmt_state = record->nmt_state;
		view->has_state = true;
		return publish_state(f, to, record, late);
	case RECORD_EMCY:
		memcpy(view->emcy, record->emcy, sizeof(view->emcy));
		return publish_emcy(f, to, record, late);
	case RECORD_CONFIGURED:
		view->configured = false;
		return 0;
	case RECORD_ANSWER:
		return publish_answer(f, to, record);
	}
	return 0;
}

static bool sparkplug_status(
	struct format *f, const struct publisher *to, const struct fleet_status *status, int64_t utc_us)
{
	static struct building p;

	f->status = *status;
	begin(&p, utc_us, false, false);
	add_counts(&p, status);
	return publish(f, to, &p, "NDATA", 0, 1) >= 0;
}

static void sparkplug_end(struct format *f, const struct publisher *to, int64_t utc_us)
{
	struct message death;

	(void)utc_us;
	f->birth--; /* of this connection */
	sparkplug_will(f, &death);
	to->publish(to->ctx, &death);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static size_t sparkplug_subscriptions(const struct format_config *config, bool writes, char topics[][FORMAT_TOPIC_MAX])
{
	snprintf(topics[0], FORMAT_TOPIC_MAX, "spBv1.0/%s/NCMD/%s", config->prefix, config->bus);
	snprintf(topics[1], FORMAT_TOPIC_MAX, "spBv1.0/%s/DCMD/%s/+", config->prefix, config->bus);
	return writes ? 2 : 1;
}

static bool value_text(const metric *m, char *text, size_t size)
{
	int n = -1;

	switch (m->value_case) {
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_INT_VALUE:
		n = m->datatype <= SPARKPLUG_INT32 && m->has_datatype
			    ? snprintf(text, size, "%d", (int32_t)m->int_value)
			    : snprintf(text, size, "%u", m->int_value);
		break;
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_LONG_VALUE:
		n = m->datatype == SPARKPLUG_INT64 && m->has_datatype
			    ? snprintf(text, size, "%lld", (long long)m->long_value)
			    : snprintf(text, size, "%llu", (unsigned long long)m->long_value);
		break;
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_FLOAT_VALUE:
		n = snprintf(text, size, "%.9g", (double)m->float_value);
		break;
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_DOUBLE_VALUE:
		n = snprintf(text, size, "%.17g", m->double_value);
		break;
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_BOOLEAN_VALUE:
		n = snprintf(text, size, "%s", m->boolean_value ? "true" : "false");
		break;
	case SPARKPLUG__PAYLOAD__METRIC__VALUE_STRING_VALUE:
		n = snprintf(text, size, "%s", m->string_value);
		break;
	default:
		break;
	}
	return n >= 0 && (size_t)n < size;
}

static void on_metric(const metric *m, int node_id, format_on_command *on_command, void *ctx)
{
	struct command command = {.kind = COMMAND_WRITE, .node_id = (uint8_t)node_id};

	if (node_id == 0) {
		command.kind = COMMAND_REBIRTH;
		if (m->name && strcmp(m->name, "Node Control/Rebirth") == 0 && m->boolean_value &&
			m->value_case == SPARKPLUG__PAYLOAD__METRIC__VALUE_BOOLEAN_VALUE)
			on_command(ctx, &command);
		return;
	}
	if (m->name && m->name[0])
		snprintf(command.object, sizeof(command.object), "%s", m->name);
	else if (m->has_alias && m->alias >> 24 == (uint64_t)node_id)
		snprintf(command.object, sizeof(command.object), "%04Xh:%u", (unsigned)(m->alias >> 8 & 0xFFFF),
			(unsigned)(m->alias & 0xFF));
	if (command.object[0] && value_text(m, command.value, sizeof(command.value)))
		on_command(ctx, &command);
}

static bool sparkplug_command(const struct format_config *config, const char *topic, const uint8_t *payload,
	size_t size, format_on_command *on_command, void *ctx)
{
	char node[FORMAT_TOPIC_MAX], device[FORMAT_TOPIC_MAX];
	int node_id = 0;

	snprintf(node, sizeof(node), "spBv1.0/%s/NCMD/%s", config->prefix, config->bus);
	int length = snprintf(device, sizeof(device), "spBv1.0/%s/DCMD/%s/", config->prefix, config->bus);
	if (strncmp(topic, device, (size_t)length) == 0)
		node_id = format_node(topic + length);
	else if (strcmp(topic, node) != 0)
		return false;
	Sparkplug__Payload *p = node_id >= 0 ? sparkplug__payload__unpack(NULL, size, payload) : NULL;
	for (size_t i = 0; p && i < p->n_metrics; i++)
		on_metric(p->metrics[i], node_id, on_command, ctx);
	if (!p)
		return false;
	sparkplug__payload__free_unpacked(p, NULL);
	return true;
}

const struct format_ops format_sparkplug = {
	.subscriptions = sparkplug_subscriptions,
	.command = sparkplug_command,
	.will = sparkplug_will,
	.begin = sparkplug_begin,
	.record = sparkplug_record,
	.status = sparkplug_status,
	.end = sparkplug_end,
};

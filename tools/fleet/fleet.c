#include "tools/fleet/fleet.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "od/little_endian.h"
#include "tools/lib/cli_value.h"
#include "od_index.h"

enum { HOUSEKEEPING_US = 100000, FIRST_FUNCTION = 0x080, NODE_MASK = 0x7F };

/* ---- nodes ------------------------------------------------------------------------------------------------------- */

static void emit(struct fleet *fleet, struct record *record, enum record_kind kind, uint8_t node_id, uint64_t t_us)
{
	record->kind = kind;
	record->node_id = node_id;
	record->utc_us = (int64_t)t_us + fleet->utc_offset_us;
	fleet->sink->record(fleet->sink->ctx, record);
}

/* CiA 301, table 39: what a node sends by default. Other COB-IDs are learned from the node. */
static uint8_t default_owner(uint32_t id)
{
	uint32_t function = id & ~(uint32_t)NODE_MASK, node_id = id & NODE_MASK;
	bool sends = function == CAN_ID_ERROR_CONTROL || function == CAN_ID_SDO_RESPONSE ||
		     function == FIRST_FUNCTION ||
		     (function >= 0x180 && function <= 0x480 && (function & 0x80)); /* TPDO1 to 4 */

	return sends ? (uint8_t)node_id : 0;
}

struct fleet_node *fleet_node(struct fleet *fleet, unsigned node_id)
{
	return node_id < FLEET_NODES ? fleet->nodes[node_id] : NULL;
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

static double field_number(const struct fleet_node *node, const struct record_field *field)
{
	const struct od_entry *entry = od_find(
		node->watch.mirror.table, (uint16_t)(field->mapping >> 16), (uint8_t)(field->mapping >> 8), NULL);
	uint8_t wire[OD_VALUE_MAX] = {0};

	put_uint(wire, field->wire, 8);
	return (entry && entry->size <= 8 ? cli_number(entry, wire) : (double)field->wire) * field->step;
}

static const struct record_field *find_field(const struct record *record, uint32_t mapping)
{
	for (size_t i = 0; i < record->field_count; i++)
		if (record->fields[i].mapping == mapping)
			return &record->fields[i];
	return NULL;
}

static bool exceeds(const struct fleet_node *node, const struct fleet_threshold *threshold)
{
	for (size_t i = 0; i < node->sample.field_count; i++) {
		const struct record_field *now = &node->sample.fields[i];
		const struct record_field *before = find_field(&node->published, now->mapping);

		if (now->mapping >> 16 != threshold->index ||
			(threshold->sub != 0 && (now->mapping >> 8 & 0xFF) != threshold->sub))
			continue;
		if (!before)
			return true;
		double change = fabs(field_number(node, now) - field_number(node, before));
		if (!(change <= threshold->change)) /* a NAN has changed */
			return true;
	}
	return false;
}

static bool has_changed(const struct fleet *fleet, const struct fleet_node *node)
{
	const struct fleet_config *config = fleet->config;
	int64_t since_us = node->sample.utc_us - node->published.utc_us;

	if (config->threshold_count == 0 || !node->any_published || since_us < 0 ||
		(double)since_us >= config->at_least_s * 1e6)
		return true;
	for (size_t i = 0; i < config->threshold_count; i++)
		if (exceeds(node, &config->thresholds[i]))
			return true;
	return false;
}

/* Decimation keeps the average rate: the next one is due a period after the last was, not after it came. */
static bool is_due(const struct fleet *fleet, struct fleet_node *node)
{
	double hz = fleet->config->hz;
	uint64_t period_us = hz > 0 ? (uint64_t)(1e6 / hz) : 0;

	if (period_us == 0)
		return true;
	if (node->opened_us < node->next_us)
		return false;
	node->next_us = later(node->next_us + period_us, node->opened_us > period_us ? node->opened_us - period_us : 0);
	return true;
}

static void close_sample(struct fleet *fleet, struct fleet_node *node)
{
	if (node->open == 0)
		return;
	bool same = node->sample.counted && node->last_counted && node->last_counter == node->sample.counter;
	node->expected = node->open | (same ? node->last : 0);
	node->last = node->expected;
	node->last_counted = node->sample.counted;
	node->last_counter = node->sample.counter;
	node->open = 0;
	fleet->samples++;
	node->sample.utc_us = (int64_t)node->opened_us + fleet->utc_offset_us; /* for has_changed() */
	if (!has_changed(fleet, node) || !is_due(fleet, node)) {
		fleet->withheld++;
		return;
	}
	emit(fleet, &node->sample, RECORD_VALUES, node->id, node->opened_us);
	node->published = node->sample;
	node->any_published = true;
}

/* Two records of a node never have the same time: with the sample counter it is the key that tells duplicates. */
static void open_sample(struct fleet_node *node, uint64_t t_us)
{
	node->sample = (struct record){0};
	node->opened_us = later(t_us, node->opened_us + 1);
}

static uint64_t field_wire(const struct watch_field *field, uint64_t payload)
{
	uint64_t wire = payload >> field->bit;

	return field->bits < 64 ? wire & ((UINT64_C(1) << field->bits) - 1) : wire;
}

static void add_fields(struct fleet_node *node, const struct watch_pdo *pdo, uint64_t payload)
{
	struct record *sample = &node->sample;

	for (size_t i = 0; i < pdo->field_count && sample->field_count < RECORD_FIELDS; i++) {
		const struct watch_field *field = &pdo->fields[i];

		if (field->bits == 0 || field->bits > 64)
			continue;
		uint64_t wire = field_wire(field, payload);
		if (field->mapping >> 8 == node->counter_mapping) {
			sample->counted = true;
			sample->counter = (uint16_t)wire;
		} else if (!find_field(sample, field->mapping)) {
			sample->fields[sample->field_count++] =
				(struct record_field){field->mapping, field->step, wire};
		}
	}
}

/* Whether the PDO has a sample counter, and which. */
static bool counter_of(const struct fleet_node *node, const struct watch_pdo *pdo, uint64_t payload, uint16_t *counter)
{
	for (size_t i = 0; node->counter_mapping && i < pdo->field_count; i++)
		if (pdo->fields[i].mapping >> 8 == node->counter_mapping) {
			*counter = (uint16_t)field_wire(&pdo->fields[i], payload);
			return true;
		}
	return false;
}

static void on_pdo(
	struct fleet *fleet, struct fleet_node *node, size_t number, const struct can_msg *msg, uint64_t t_us)
{
	const struct watch_pdo *pdo = &node->watch.pdos[number];
	unsigned bit = 1u << number;
	uint64_t payload = get_uint(msg->data, msg->len);
	uint16_t counter = 0;
	bool counted = counter_of(node, pdo, payload, &counter);

	bool another = counted && node->sample.counted && counter != node->sample.counter;
	if (node->open && (another || (node->open & bit)))
		close_sample(fleet, node);
	if (!node->open && counted && node->last_counted && counter == node->last_counter && (node->last & bit))
		return; /* the same sample again: SYNC is faster than the sensor */
	if (!node->open)
		open_sample(node, t_us);
	add_fields(node, pdo, payload);
	node->open |= bit;
	if ((node->open & node->expected) == node->expected && node->expected != 0)
		close_sample(fleet, node);
}

/* ---- the mapping of a node --------------------------------------------------------------------------------------- */

static uint32_t counter_mapping(const struct watch *watch)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		for (size_t k = 0; watch->pdos[i].enabled && k < watch->pdos[i].field_count; k++) {
			const struct od_entry *entry = watch->pdos[i].fields[k].entry;

			if (entry && strcmp(entry->name, "sample.counter") == 0)
				return watch->pdos[i].fields[k].mapping >> 8;
		}
	return 0;
}

/* The mapping of the node was read: which frames are its own, and what they hold. */
static void learn(struct fleet *fleet, struct fleet_node *node, uint64_t t_us)
{
	const struct watch *watch = &node->watch;
	uint32_t emcy = watch_object(watch, OD_INDEX_COB_ID_EMCY, 0) & COB_ID_MASK;
	struct record record = {0};

	close_sample(fleet, node); /* of the mapping before */
	node->configured = watch->configured;
	node->counter_mapping = counter_mapping(watch);
	node->open = node->last = node->expected = 0;
	node->last_counted = node->any_published = false;
	for (uint32_t id = 0; id < FLEET_IDS; id++)
		if (fleet->owner[id] == node->id)
			fleet->owner[id] = default_owner(id);
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].enabled && watch->pdos[i].id < FLEET_IDS)
			fleet->owner[watch->pdos[i].id] = node->id;
	if (emcy > 0 && emcy < FLEET_IDS)
		fleet->owner[emcy] = node->id;
	emit(fleet, &record, RECORD_CONFIGURED, node->id, t_us);
}

static void look_after(struct fleet *fleet, struct fleet_node *node, uint64_t now_us)
{
	node->due_us = watch_tick(&node->watch, now_us);
	if (node->configured != node->watch.configured && node->watch.mapping != WATCH_READING)
		learn(fleet, node, now_us);
}

static struct fleet_node *add_node(struct fleet *fleet, uint8_t id, uint64_t now_us)
{
	const struct od_table *table = fleet->config->tables[id];
	struct fleet_node *node = table ? calloc(1, sizeof(*node)) : NULL;

	if (!node)
		return NULL;
	node->values = calloc(1, table->values_size);
	if (!node->values) {
		free(node);
		return NULL;
	}
	node->id = id;
	node->published_state = WATCH_NMT_UNKNOWN;
	node->due_us = now_us;
	fleet->nodes[id] = node;
	fleet->known[fleet->node_count++] = id;
	watch_init(&node->watch, table, node->values, fleet->bus, id, fleet->config->passive, now_us);
	look_after(fleet, node, now_us);
	return node;
}

/* ---- frames and time --------------------------------------------------------------------------------------------- */

static void look_at_state(struct fleet *fleet, struct fleet_node *node, uint64_t now_us)
{
	struct record record = {.nmt_state = watch_nmt_state(&node->watch, now_us)};

	if (record.nmt_state == node->published_state)
		return;
	node->published_state = record.nmt_state;
	emit(fleet, &record, RECORD_STATE, node->id, now_us);
}

static struct watch_pdo *find_pdo(struct watch *watch, uint32_t id, size_t *number)
{
	for (*number = 0; *number < watch->pdo_count; ++*number)
		if (watch->pdos[*number].enabled && watch->pdos[*number].id == id)
			return &watch->pdos[*number];
	return NULL;
}

void fleet_init(struct fleet *fleet, const struct fleet_config *config, struct can_port *bus,
	const struct fleet_sink *sink, uint64_t now_us)
{
	*fleet = (struct fleet){.config = config, .sink = sink, .bus = bus};
	for (uint32_t id = 0; id < FLEET_IDS; id++)
		fleet->owner[id] = default_owner(id);
	for (unsigned id = 1; id < FLEET_NODES; id++)
		if (config->expected[id])
			add_node(fleet, (uint8_t)id, now_us);
}

void fleet_free(struct fleet *fleet)
{
	for (size_t i = 0; i < fleet->node_count; i++) {
		free(fleet->nodes[fleet->known[i]]->values);
		free(fleet->nodes[fleet->known[i]]);
	}
	*fleet = (struct fleet){0};
}

void fleet_receive(struct fleet *fleet, const struct can_msg *msg, uint64_t now_us, int64_t utc_offset_us)
{
	uint8_t id = msg->extended || msg->remote || msg->id >= FLEET_IDS ? 0 : fleet->owner[msg->id];
	uint64_t t_us = msg->t_us ? msg->t_us : now_us;
	size_t number;

	fleet->utc_offset_us = utc_offset_us;
	if (id == 0)
		return;
	struct fleet_node *node = fleet->nodes[id] ? fleet->nodes[id] : add_node(fleet, id, now_us);
	if (!node)
		return;
	struct watch *watch = &node->watch;
	struct watch_pdo *pdo = watch->mapping == WATCH_READING ? NULL : find_pdo(watch, msg->id, &number);
	uint64_t pdos = pdo ? pdo->rate.count : 0, misfits = pdo ? pdo->misfits : 0, emcys = watch->emcy.count;
	watch_receive(watch, msg, now_us);
	look_at_state(fleet, node, now_us);
	if (pdo && pdo->rate.count != pdos)
		on_pdo(fleet, node, number, msg, t_us);
	fleet->misfits += pdo ? pdo->misfits - misfits : 0;
	if (watch->emcy.count != emcys) {
		struct record record = {0};

		memcpy(record.emcy, msg->data, sizeof(record.emcy));
		emit(fleet, &record, RECORD_EMCY, id, t_us);
	}
	look_after(fleet, node, now_us);
}

uint64_t fleet_tick(struct fleet *fleet, uint64_t now_us, int64_t utc_offset_us)
{
	uint64_t next_us = now_us + HOUSEKEEPING_US;

	fleet->utc_offset_us = utc_offset_us;
	for (size_t i = 0; i < fleet->node_count; i++) {
		struct fleet_node *node = fleet->nodes[fleet->known[i]];

		if (node->open && now_us >= node->opened_us + FLEET_SAMPLE_US)
			close_sample(fleet, node);
		if (now_us >= node->due_us || node->configured != node->watch.configured)
			look_after(fleet, node, now_us);
		look_at_state(fleet, node, now_us);
		next_us = earlier(next_us, node->due_us);
		if (node->open)
			next_us = earlier(next_us, node->opened_us + FLEET_SAMPLE_US);
	}
	return next_us;
}

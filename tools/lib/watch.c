#include "tools/lib/watch.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "od/little_endian.h"
#include "tools/lib/cli_value.h"
#include "od_index.h"

enum {
	SDO_TIMEOUT_US = 300000,
	POLL_US = 100000,
	RETRY_US = 2000000,
	SAMPLE_INDEX = OD_INDEX_SAMPLE,
	SAMPLE_COUNTER = 1,
};

/* ---- the mapping ---- */

/* Objects that are needed to decode the frames of the node. */
static bool is_needed(const struct od_entry *entry)
{
	uint16_t index = entry->index;

	if (index >= PDO_FIRST_TPDO && is_pdo_object(index))
		return index % PDO_INDICES < WATCH_PDOS &&
		       (is_pdo_mapping(index) || entry->sub == 1 || entry->sub == 2);
	return index == OD_INDEX_COB_ID_SYNC || index == OD_INDEX_COB_ID_EMCY ||
	       index == OD_INDEX_PRODUCER_HEARTBEAT_TIME || index == OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE ||
	       index == OD_INDEX_RESOLUTION || index == OD_INDEX_ANGLE_RESOLUTION;
}

static double mirrored(const struct watch *watch, const struct od_entry *entry)
{
	uint8_t wire[OD_VALUE_MAX];

	od_get(&watch->mirror, entry, wire, sizeof(wire));
	return cli_number(entry, wire);
}

uint32_t watch_object(const struct watch *watch, uint16_t index, uint8_t sub)
{
	const struct od_entry *entry = od_find(watch->mirror.table, index, sub, NULL);

	return entry ? (uint32_t)mirrored(watch, entry) : 0;
}

static void set_up_pdo(struct watch *watch, struct watch_pdo *pdo, unsigned int number)
{
	uint16_t parameter = (uint16_t)(PDO_FIRST_TPDO + number),
		 mapping = (uint16_t)(PDO_FIRST_TPDO + PDO_MAPPING + number);
	uint32_t cob_id = watch_object(watch, parameter, 1);
	uint32_t count = watch_object(watch, mapping, 0);
	unsigned int bit = 0;
	bool changed = false;

	pdo->enabled = !(cob_id & COB_ID_INVALID) && count > 0;
	pdo->id = cob_id & COB_ID_MASK; /* the gateway supports 11-bit identifiers only */
	pdo->type = (uint8_t)watch_object(watch, parameter, 2);
	pdo->field_count = 0;
	for (uint8_t sub = 1; sub <= count && pdo->field_count < WATCH_FIELDS; sub++) {
		struct watch_field *field = &pdo->fields[pdo->field_count];
		uint32_t object = watch_object(watch, mapping, sub);
		unsigned int bits = object & 0xFF;

		if (bit + bits > 64)
			break;
		changed |= field->mapping != object;
		field->mapping = object;
		field->bit = bit;
		field->bits = bits;
		field->step = 1;
		field->entry = od_find(watch->mirror.table, (uint16_t)(object >> 16), (uint8_t)(object >> 8), NULL);
		if (field->entry && 8u * field->entry->size != bits)
			field->entry = NULL;
		if (field->entry)
			field->step = od_step(&watch->mirror, field->entry);
		bit += bits;
		pdo->field_count++;
	}
	pdo->enabled = pdo->enabled && pdo->field_count > 0;
	if (changed) { /* the values belong to other objects */
		pdo->rate = (struct watch_rate){0};
		pdo->counted = false;
	}
}

static void set_up(struct watch *watch, enum watch_mapping mapping)
{
	const struct od_table *table = watch->mirror.table;

	watch->mapping = mapping;
	watch->configured++;
	for (watch->pdo_count = 0; watch->pdo_count < WATCH_PDOS; watch->pdo_count++) {
		unsigned int number = (unsigned int)watch->pdo_count;

		if (!od_find(table, (uint16_t)(PDO_FIRST_TPDO + number), 1, NULL))
			break;
		set_up_pdo(watch, &watch->pdos[number], number);
	}
}

/* ---- reading the objects, one after the other ---- */

static void no_answer(struct watch *watch, uint64_t now_us)
{
	watch->retry_us = now_us + RETRY_US;
	if (watch->mapping == WATCH_READING)
		set_up(watch, WATCH_DEFAULTS);
}

static void read_next(struct watch *watch, uint64_t now_us)
{
	const struct od_table *table = watch->mirror.table;

	while (watch->reading < table->count && !is_needed(&table->entries[watch->reading]))
		watch->reading++;
	if (watch->reading == table->count) {
		set_up(watch, WATCH_READ);
		return;
	}
	const struct od_entry *entry = &table->entries[watch->reading];
	sdo_client_upload(&watch->sdo, entry->index, entry->sub, watch->wire, sizeof(watch->wire), now_us);
	if (watch->sdo.result == SDO_UNSENT)
		no_answer(watch, now_us);
}

static void start_reading(struct watch *watch, uint64_t now_us)
{
	watch->retry_us = UINT64_MAX;
	if (watch->passive)
		return;
	watch->job = WATCH_MAP;
	watch->reading = 0;
	read_next(watch, now_us);
}

void watch_read_mapping(struct watch *watch, uint64_t now_us)
{
	if (!watch->passive && watch->mapping != WATCH_READING)
		watch->retry_us = now_us;
}

static void on_mapping(struct watch *watch, uint64_t now_us)
{
	const struct od_entry *entry = &watch->mirror.table->entries[watch->reading];

	switch (watch->sdo.result) {
	case SDO_DONE:
		od_put(&watch->mirror, entry, watch->wire, watch->sdo.size);
		watch->reading++;
		read_next(watch, now_us);
		break;
	case SDO_ABORTED: /* not in this node: the default remains */
		watch->reading++;
		read_next(watch, now_us);
		break;
	case SDO_TIMEOUT:
	case SDO_UNSENT:
		no_answer(watch, now_us);
		break;
	case SDO_IDLE:
	case SDO_RUNNING:
		break;
	}
}

/* ---- other transfers, while the mapping is known ---- */

static const struct watch_polled POLLED[WATCH_POLLED] = {{.index = OD_INDEX_ATTITUDE_SIGMA, .sub = 1},
	{.index = OD_INDEX_ATTITUDE_SIGMA, .sub = 2}, {.index = OD_INDEX_ATTITUDE_SIGMA, .sub = 3},
	{.index = OD_INDEX_ACCELERATION_SIGMA, .sub = 1}, {.index = OD_INDEX_ACCELERATION_SIGMA, .sub = 2},
	{.index = OD_INDEX_ACCELERATION_SIGMA, .sub = 3}, {.index = OD_INDEX_VELOCITY_SIGMA, .sub = 1},
	{.index = OD_INDEX_VELOCITY_SIGMA, .sub = 2}, {.index = OD_INDEX_VELOCITY_SIGMA, .sub = 3},
	{.index = OD_INDEX_POSITION_SIGMA, .sub = 1}, {.index = OD_INDEX_POSITION_SIGMA, .sub = 2},
	{.index = OD_INDEX_POSITION_SIGMA, .sub = 3}, {.index = OD_INDEX_BUS_HEALTH, .sub = OD_SUB_BUS_HEALTH_LOAD},
	{.index = OD_INDEX_BUS_HEALTH, .sub = OD_SUB_BUS_HEALTH_BIT_RATE}};

void watch_poll(struct watch *watch, uint64_t now_us)
{
	memcpy(watch->polled, POLLED, sizeof(POLLED));
	watch->polls = !watch->passive;
	watch->poll_us = now_us;
}

void watch_read_events(struct watch *watch)
{
	watch->wants_events = !watch->passive;
}

void watch_command(struct watch *watch, const char *name, uint16_t index, uint8_t sub, uint32_t value, uint8_t size)
{
	uint8_t wire[4];

	put_uint(wire, value, size);
	if (watch->passive)
		snprintf(watch->message, sizeof(watch->message), "%s: not with --passive", name);
	else
		watch_write(watch, name, index, sub, wire, size);
}

bool watch_write(struct watch *watch, const char *name, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	struct watch_command command = {.name = name, .index = index, .sub = sub, .size = (uint8_t)size};

	if (watch->passive || watch->command_count == WATCH_COMMANDS || size > sizeof(command.wire))
		return false;
	memcpy(command.wire, wire, size);
	watch->commands[watch->command_count++] = command;
	return true;
}

static const char *result_text(const struct sdo_client *sdo)
{
	switch (sdo->result) {
	case SDO_DONE:
		return "done";
	case SDO_ABORTED:
		return sdo_abort_text(sdo->abort_code);
	default:
		return "no answer";
	}
}

static void on_command(struct watch *watch)
{
	const struct watch_command *command = &watch->commands[0];

	snprintf(watch->message, sizeof(watch->message), "%s: %s", command->name, result_text(&watch->sdo));
	watch->commands_done++;
	watch->command_result = watch->sdo.result;
	watch->command_abort = watch->sdo.abort_code;
	watch->command_count--;
	memmove(watch->commands, watch->commands + 1, watch->command_count * sizeof(watch->commands[0]));
}

static void on_polled(struct watch *watch, uint64_t now_us)
{
	struct watch_polled *polled = &watch->polled[watch->polling];
	const struct od_entry *entry = od_find(watch->mirror.table, polled->index, polled->sub, NULL);

	if (watch->sdo.result == SDO_DONE && entry && watch->sdo.size == entry->size) {
		polled->value = cli_number(entry, watch->wire) * entry->factor;
		polled->at_us = now_us;
	}
	watch->polling = (watch->polling + 1) % WATCH_POLLED;
}

static void on_answer(struct watch *watch, uint64_t now_us)
{
	if (watch->sdo.result == SDO_RUNNING || watch->sdo.result == SDO_IDLE)
		return;
	switch (watch->job) {
	case WATCH_MAP:
		on_mapping(watch, now_us);
		break;
	case WATCH_POLL:
		on_polled(watch, now_us);
		break;
	case WATCH_COMMAND:
		on_command(watch);
		break;
	case WATCH_EVENTS:
		watch->events[watch->sdo.result == SDO_DONE ? watch->sdo.size : 0] = '\0';
		break;
	}
}

/* Starts what waits for the SDO client. Returns when to look again. */
static uint64_t next_transfer(struct watch *watch, uint64_t now_us)
{
	const struct watch_command *command = &watch->commands[0];
	const struct watch_polled *polled = &watch->polled[watch->polling];

	if (watch->sdo.result == SDO_RUNNING || watch->mapping == WATCH_READING)
		return UINT64_MAX;
	if (watch->command_count > 0) {
		watch->job = WATCH_COMMAND;
		sdo_client_download(&watch->sdo, command->index, command->sub, command->wire, command->size, now_us);
	} else if (watch->wants_events) {
		watch->wants_events = false;
		watch->job = WATCH_EVENTS;
		sdo_client_block_upload(
			&watch->sdo, OD_INDEX_EVENT_LOG, 0, watch->events, sizeof(watch->events) - 1, now_us);
	} else if (watch->polls && now_us >= watch->poll_us && watch->mapping == WATCH_READ) {
		watch->poll_us = now_us + POLL_US;
		watch->job = WATCH_POLL;
		sdo_client_upload(&watch->sdo, polled->index, polled->sub, watch->wire, sizeof(watch->wire), now_us);
	} else {
		return watch->polls && watch->mapping == WATCH_READ ? watch->poll_us : UINT64_MAX;
	}
	on_answer(watch, now_us); /* it could not be sent */
	return now_us;
}

double watch_polled(const struct watch *watch, uint16_t index, uint8_t sub)
{
	for (size_t i = 0; i < WATCH_POLLED; i++)
		if (watch->polled[i].index == index && watch->polled[i].sub == sub && watch->polled[i].at_us)
			return watch->polled[i].value;
	return NAN;
}

double watch_sigma(const struct watch *watch, const struct od_entry *entry)
{
	double xy, z;

	switch (entry->index) {
	case OD_INDEX_POSITION_OUTPUT:
	case OD_INDEX_POSITION_M:
		return watch_polled(watch, OD_INDEX_POSITION_SIGMA, (uint8_t)((entry->sub - 1) % 3 + 1));
	case OD_INDEX_VELOCITY:
		return watch_polled(watch, OD_INDEX_VELOCITY_SIGMA, entry->sub);
	case OD_INDEX_ACCELERATION_GLOBAL:
		return watch_polled(watch, OD_INDEX_ACCELERATION_SIGMA, entry->sub);
	case OD_INDEX_ACCELERATION:
	case OD_INDEX_ACCELERATION_OBJECT:
		xy = fmax(watch_polled(watch, OD_INDEX_ACCELERATION_SIGMA, 1),
			watch_polled(watch, OD_INDEX_ACCELERATION_SIGMA, 2));
		z = watch_polled(watch, OD_INDEX_ACCELERATION_SIGMA, 3);
		return isnan(z) ? NAN : fmax(xy, z);
	case OD_INDEX_ANGLES:
	case OD_INDEX_ANGLES_DEG:
		xy = fmax(watch_polled(watch, OD_INDEX_ATTITUDE_SIGMA, 1),
			watch_polled(watch, OD_INDEX_ATTITUDE_SIGMA, 2));
		return entry->sub == 3 ? watch_polled(watch, OD_INDEX_ATTITUDE_SIGMA, 3) : xy;
	default:
		return NAN;
	}
}

void watch_init(struct watch *watch, const struct od_table *table, void *values, struct can_port *bus, uint8_t node_id,
	bool passive, uint64_t now_us)
{
	*watch = (struct watch){
		.nmt_state = WATCH_NMT_UNKNOWN,
		.node_id = node_id,
		.passive = passive,
		.retry_us = UINT64_MAX,
	};
	od_init(&watch->mirror, table, values, node_id);
	sdo_client_init(&watch->sdo, bus, node_id, SDO_TIMEOUT_US);
	if (passive)
		set_up(watch, WATCH_DEFAULTS);
	else
		start_reading(watch, now_us);
}

/* ---- frames of the node ---- */

static void count_frame(struct watch_rate *rate, uint64_t now_us)
{
	double interval_us = (double)(now_us - rate->last_us);

	if (rate->count == 0)
		rate->first_us = now_us;
	else if (rate->count < 16) /* the arithmetic mean first */
		rate->interval_us = (double)(now_us - rate->first_us) / (double)rate->count;
	else
		rate->interval_us += (interval_us - rate->interval_us) / 16;
	rate->last_us = now_us;
	rate->count++;
}

double watch_rate_hz(const struct watch_rate *rate, uint64_t now_us)
{
	double silent_us = (double)(now_us - rate->last_us);

	if (rate->count < 2 || rate->interval_us <= 0)
		return 0;
	return 1e6 / (silent_us > 2 * rate->interval_us ? silent_us : rate->interval_us);
}

/* Over a second: frames come in bursts. */
static void count_bus(struct watch *watch, uint64_t now_us)
{
	uint64_t span_us = now_us - watch->second_us;

	if (watch->second_us == 0 || span_us >= 1000000) {
		watch->bus_hz = watch->second_us ? watch->frames * 1e6 / (double)span_us : 0;
		watch->second_us = now_us;
		watch->frames = 0;
	}
	watch->frames++;
}

void watch_sync_sent(struct watch *watch, uint64_t now_us)
{
	count_frame(&watch->sync, now_us);
	count_bus(watch, now_us);
}

static void count_sample(struct watch_pdo *pdo, uint16_t counter)
{
	uint16_t ahead = (uint16_t)(counter - pdo->counter);

	if (pdo->counted && ahead == 0)
		pdo->repeated++;
	else if (pdo->counted)
		pdo->skipped += ahead - 1u;
	pdo->counted = true;
	pdo->counter = counter;
}

static double field_value(const struct watch_field *field, uint64_t payload)
{
	uint8_t wire[OD_VALUE_MAX] = {0};
	uint64_t raw;

	if (field->bits == 0) /* it may be behind the last bit */
		return 0;
	raw = payload >> field->bit;
	if (field->bits < 64)
		raw &= (UINT64_C(1) << field->bits) - 1;
	if (!field->entry)
		return (double)raw;
	for (size_t i = 0; i < field->entry->size; i++)
		wire[i] = (uint8_t)(raw >> 8 * i);
	return cli_number(field->entry, wire);
}

static size_t mapped_bytes(const struct watch_pdo *pdo)
{
	const struct watch_field *last = &pdo->fields[pdo->field_count - 1];

	return (last->bit + last->bits + 7) / 8;
}

static void on_pdo(struct watch *watch, struct watch_pdo *pdo, const struct can_msg *msg, uint64_t now_us)
{
	uint64_t payload = 0;

	watch->nmt_state = NMT_OPERATIONAL; /* PDOs are sent in operational only */
	if (msg->len != mapped_bytes(pdo)) {
		pdo->misfits++;
		if (watch->retry_us == UINT64_MAX && (watch->sdo.result != SDO_RUNNING || watch->job != WATCH_MAP))
			watch->retry_us = now_us + RETRY_US / 4; /* the mapping has changed */
		return;
	}
	for (unsigned int i = 0; i < msg->len; i++)
		payload |= (uint64_t)msg->data[i] << 8 * i;
	count_frame(&pdo->rate, now_us);
	for (size_t i = 0; i < pdo->field_count; i++) {
		struct watch_field *field = &pdo->fields[i];

		field->raw = field_value(field, payload);
		if (field->mapping >> 8 == (SAMPLE_INDEX << 8 | SAMPLE_COUNTER))
			count_sample(pdo, (uint16_t)field->raw);
	}
}

static void on_heartbeat(struct watch *watch, const struct can_msg *msg, uint64_t now_us)
{
	int state = msg->data[0] & 0x7F;

	if (state != NMT_INITIALISING) {
		count_frame(&watch->heartbeat, now_us);
		watch->nmt_state = state;
		return;
	}
	watch->boot_ups++; /* the configuration may have changed */
	watch->nmt_state = NMT_PRE_OPERATIONAL;
	for (size_t i = 0; i < WATCH_PDOS; i++)
		watch->pdos[i].counted = false;
	if (!watch->passive) {
		watch->mapping = WATCH_READING;
		start_reading(watch, now_us);
	}
}

static void on_emcy(struct watch *watch, const struct can_msg *msg, uint64_t now_us)
{
	count_frame(&watch->emcy, now_us);
	memmove(watch->emcys + 1, watch->emcys, sizeof(watch->emcys) - sizeof(watch->emcys[0]));
	watch->emcys[0] = (struct watch_emcy){now_us, get_u16(msg->data), msg->data[2]};
}

static struct watch_pdo *find_pdo(struct watch *watch, uint32_t id)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].enabled && watch->pdos[i].id == id)
			return &watch->pdos[i];
	return NULL;
}

void watch_receive(struct watch *watch, const struct can_msg *msg, uint64_t now_us)
{
	struct watch_pdo *pdo = watch->mapping == WATCH_READING ? NULL : find_pdo(watch, msg->id);

	count_bus(watch, now_us);
	if (msg->remote || msg->extended)
		return;
	if (msg->id == (watch_object(watch, OD_INDEX_COB_ID_SYNC, 0) & COB_ID_MASK)) {
		count_frame(&watch->sync, now_us);
		return;
	}
	if (pdo)
		on_pdo(watch, pdo, msg, now_us);
	else if (msg->id == CAN_ID_ERROR_CONTROL + watch->node_id && msg->len == 1)
		on_heartbeat(watch, msg, now_us);
	else if (msg->id == (watch_object(watch, OD_INDEX_COB_ID_EMCY, 0) & COB_ID_MASK) && msg->len == 8)
		on_emcy(watch, msg, now_us);
	else if (msg->id != CAN_ID_SDO_RESPONSE + watch->node_id)
		return; /* from another node */
	watch->heard_us = now_us;
	if (watch->sdo.result == SDO_RUNNING) {
		sdo_client_receive(&watch->sdo, msg, now_us);
		on_answer(watch, now_us);
	}
}

uint64_t watch_tick(struct watch *watch, uint64_t now_us)
{
	if (watch->sdo.result == SDO_RUNNING) {
		sdo_client_tick(&watch->sdo, now_us);
		on_answer(watch, now_us);
	}
	if (now_us >= watch->retry_us && (watch->job == WATCH_MAP || watch->sdo.result != SDO_RUNNING))
		start_reading(watch, now_us);
	uint64_t next_us = next_transfer(watch, now_us);
	return earlier(earlier(sdo_client_tick(&watch->sdo, now_us), watch->retry_us), next_us);
}

int watch_nmt_state(const struct watch *watch, uint64_t now_us)
{
	uint64_t period_us = watch_object(watch, OD_INDEX_PRODUCER_HEARTBEAT_TIME, 0) * UINT64_C(1000);
	bool expected = watch->heartbeat.count > 0 && period_us > 0;

	return expected && now_us - watch->heard_us > 3 * period_us ? WATCH_NMT_LOST : watch->nmt_state;
}

bool watch_has_values(const struct watch *watch)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].rate.count > 0)
			return true;
	return false;
}

/* ---- texts ---- */

void watch_field_text(const struct watch_field *field, char *text, size_t capacity)
{
	bool real = field->entry && (field->entry->type == OD_REAL32 || field->entry->type == OD_REAL64);
	bool words = od_has_words(field->entry);
	int decimals = field->step < 1 && field->step > 0 ? (int)-floor(log10(field->step)) : 0;

	text[0] = '\0';
	if (words)
		od_words_text(field->entry, (uint64_t)field->raw, text, capacity);
	if (text[0])
		return;
	if (real)
		snprintf(text, capacity, "%.6g", field->raw * field->step);
	else
		snprintf(text, capacity, "%.*f", decimals, field->raw * field->step);
}

const char *watch_nmt_text(int nmt_state)
{
	switch (nmt_state) {
	case NMT_INITIALISING:
		return "initialising";
	case NMT_STOPPED:
		return "stopped";
	case NMT_OPERATIONAL:
		return "operational";
	case NMT_PRE_OPERATIONAL:
		return "pre-operational";
	case WATCH_NMT_LOST:
		return "lost";
	default:
		return "unknown";
	}
}

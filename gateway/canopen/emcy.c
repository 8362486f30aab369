/* EMCY (CiA 301, 7.2.7): error register 1001h, error history 1003h, COB-ID 1014h, inhibit time 1015h. */
#include "gateway/canopen/service.h"
#include "od_index.h"

#include <string.h>

static bool enabled(const struct emcy *emcy)
{
	return emcy->cob_id && !(*emcy->cob_id & COB_ID_INVALID);
}

static enum od_status before_cob_id(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const struct canopen_node *node = ctx;
	uint32_t value = get_u32(wire);
	enum od_status status = cob_id_change(*node->emcy.cob_id, value);

	(void)entry;
	(void)size;
	return status == OD_OK && !(value & COB_ID_INVALID) && sdo_server_uses(node, value) ? OD_INCOMPATIBLE : status;
}

static void after_cob_id(void *ctx, const struct od_entry *entry)
{
	(void)entry;
	node_filter(ctx);
}

/* Only 0 may be written to sub-index 0, which clears the history; the others are read-only. */
static enum od_status before_history(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	(void)ctx;
	(void)entry;
	(void)size;
	return *(const uint8_t *)wire == 0 ? OD_OK : OD_BAD_VALUE;
}

static void clear_history(struct emcy *emcy)
{
	if (!emcy->history_count)
		return;
	*emcy->history_count = 0;
	for (size_t i = 0; i < emcy->history_size; i++)
		*emcy->history[i] = 0;
}

static void after_history(void *ctx, const struct od_entry *entry)
{
	(void)entry;
	clear_history(&((struct canopen_node *)ctx)->emcy);
}

void emcy_init(struct canopen_node *node)
{
	struct emcy *emcy = &node->emcy;

	emcy->error_register = od_value(node->od, OD_INDEX_ERROR_REGISTER, 0, sizeof(uint8_t));
	emcy->cob_id = od_value(node->od, OD_INDEX_COB_ID_EMCY, 0, sizeof(uint32_t));
	emcy->inhibit_100us = node_value(node, OD_INDEX_INHIBIT_TIME_EMCY, 0, sizeof(uint16_t));
	emcy->history_count = od_value(node->od, OD_INDEX_ERROR_HISTORY, 0, sizeof(uint8_t));
	for (uint8_t i = 0; i < EMCY_HISTORY; i++) {
		emcy->history[i] = od_value(node->od, OD_INDEX_ERROR_HISTORY, (uint8_t)(i + 1), sizeof(uint32_t));
		if (!emcy->history[i])
			break;
		emcy->history_size++;
	}
	emcy->cob_id_hook = (struct od_hook){.first = OD_INDEX_COB_ID_EMCY,
		.last = OD_INDEX_COB_ID_EMCY,
		.before = before_cob_id,
		.after = after_cob_id,
		.ctx = node};
	emcy->history_hook = (struct od_hook){.first = OD_INDEX_ERROR_HISTORY,
		.last = OD_INDEX_ERROR_HISTORY,
		.before = before_history,
		.after = after_history,
		.ctx = node};
	od_attach(node->od, &emcy->cob_id_hook);
	od_attach(node->od, &emcy->history_hook);
}

bool emcy_history_empty(const struct canopen_node *node, uint16_t index, uint8_t sub)
{
	return index == OD_INDEX_ERROR_HISTORY && node->emcy.history_count && sub > *node->emcy.history_count;
}

static void update_register(struct emcy *emcy)
{
	uint8_t bits = 0;

	for (size_t i = 0; i < emcy->error_count; i++)
		bits |= emcy->errors[i].bits | ERROR_GENERIC;
	*emcy->error_register = bits;
}

/* The index of an active error, or error_count. */
static size_t find_error(const struct emcy *emcy, uint16_t code, uint8_t source)
{
	size_t i = 0;

	while (i < emcy->error_count && (emcy->errors[i].code != code || emcy->errors[i].source != source))
		i++;
	return i;
}

bool canopen_error_active(const struct canopen_node *node, uint16_t code)
{
	for (size_t i = 0; i < node->emcy.error_count; i++)
		if (node->emcy.errors[i].code == code)
			return true;
	return false;
}

static void remove_error(struct emcy *emcy, size_t i)
{
	emcy->error_count--;
	memmove(&emcy->errors[i], &emcy->errors[i + 1], (emcy->error_count - i) * sizeof(emcy->errors[0]));
	update_register(emcy);
}

static bool is_own(uint16_t code)
{
	static const uint16_t own[] = {EMCY_DATA_SET, EMCY_HEARTBEAT, EMCY_SYNC_LENGTH, EMCY_SYNC_TIME,
		EMCY_PDO_CONTENT, EMCY_PDO_SHORT, EMCY_PDO_LONG, EMCY_PDO_TIMEOUT, EMCY_COLLISION};
	size_t i = 0;

	while (i < sizeof(own) / sizeof(own[0]) && own[i] != code)
		i++;
	return i < sizeof(own) / sizeof(own[0]);
}

/* Reset communication ends the errors that the core raises itself; the application ends its own. */
void emcy_reset(struct canopen_node *node, enum od_group group)
{
	struct emcy *emcy = &node->emcy;

	if (node->id != CANOPEN_UNCONFIGURED) /* else nothing could be sent yet: the messages stay */
		emcy->queue_count = 0;
	emcy->inhibited_until_us = 0;
	for (size_t i = emcy->error_count; i-- > 0;)
		if (group == OD_GROUP_ALL || is_own(emcy->errors[i].code))
			remove_error(emcy, i);
	if (group == OD_GROUP_ALL)
		clear_history(emcy);
}

void emcy_check(struct canopen_node *node)
{
	struct emcy *emcy = &node->emcy;

	if (!enabled(emcy) || cob_id_in_use(*emcy->cob_id))
		return;
	*emcy->cob_id |= COB_ID_INVALID;
	node_bad_data(node, OD_INDEX_COB_ID_EMCY);
}

/* An error that recurs moves to the front, so that the history keeps the last different ones. */
static void record(struct emcy *emcy, uint16_t code, const uint8_t *info)
{
	uint32_t value = code | (uint32_t)get_u16(info) << 16;
	size_t i = 0;

	if (emcy->history_size == 0)
		return;
	while (i < *emcy->history_count && *emcy->history[i] != value)
		i++;
	if (i == *emcy->history_count && i < emcy->history_size)
		(*emcy->history_count)++;
	if (i == emcy->history_size)
		i--;
	for (; i > 0; i--)
		*emcy->history[i] = *emcy->history[i - 1];
	*emcy->history[0] = value;
}

static void drop_oldest(struct emcy *emcy)
{
	emcy->queue_count--;
	memmove(&emcy->queue[0], &emcy->queue[1], emcy->queue_count * sizeof(emcy->queue[0]));
}

static void enqueue(struct emcy *emcy, uint16_t code, uint8_t source, const uint8_t info[5])
{
	struct emcy_message *message;

	if (emcy->queue_count == EMCY_QUEUE) {
		drop_oldest(emcy);
		emcy->lost++;
	}
	message = &emcy->queue[emcy->queue_count++];
	message->code = code;
	message->source = source;
	put_u16(message->data, code);
	message->data[2] = *emcy->error_register;
	memcpy(message->data + 3, info, 5);
}

/* Sends what may be sent now. Returns when the next message may be. */
static uint64_t send_queue(struct canopen_node *node)
{
	struct emcy *emcy = &node->emcy;

	if (!enabled(emcy))
		emcy->queue_count = 0;
	while (emcy->queue_count && nmt_communicates(node) && !lss_silent(node) && !emcy->bus_down) {
		if (node->now_us < emcy->inhibited_until_us)
			return emcy->inhibited_until_us;
		node_send(node, *emcy->cob_id & COB_ID_MASK, emcy->queue[0].data, 8);
		drop_oldest(emcy);
		emcy->inhibited_until_us = node->now_us + *emcy->inhibit_100us * 100u;
	}
	return UINT64_MAX;
}

static bool is_active(const struct emcy *emcy, const struct emcy_message *message)
{
	return find_error(emcy, message->code, message->source) < emcy->error_count;
}

/* Of the errors raised in NMT stopped the most recent one that is still active is sent afterwards (CiA 301, 7.3.2.2.4),
 * or "no error" when none is active any more. */
void emcy_leave_stopped(struct canopen_node *node)
{
	struct emcy *emcy = &node->emcy;
	size_t i = emcy->queue_count;

	while (i > 0 && !is_active(emcy, &emcy->queue[i - 1]))
		i--;
	if (i == 0 && emcy->error_count == 0)
		i = emcy->queue_count;
	if (i > 0)
		emcy->queue[0] = emcy->queue[i - 1];
	emcy->queue_count = i > 0 ? 1 : 0;
}

static void notify(const struct canopen_node *node, uint16_t code, bool set, const uint8_t info[5])
{
	if (node->device.error_changed)
		node->device.error_changed(node->device.ctx, code, set, info);
}

/* When this communication error may end: EMCY_QUIET_US after it has ended before. */
static uint64_t earliest_end_us(const struct emcy *emcy, uint16_t code, uint8_t source)
{
	for (size_t i = 0; i < EMCY_ERRORS; i++)
		if (emcy->ended[i].code == code && emcy->ended[i].source == source)
			return emcy->ended[i].t_us + EMCY_QUIET_US;
	return 0;
}

static void note_end(struct emcy *emcy, const struct emcy_error *error, uint64_t now_us)
{
	size_t i = 0;

	while (i < EMCY_ERRORS && (emcy->ended[i].code != error->code || emcy->ended[i].source != error->source))
		i++;
	if (i == EMCY_ERRORS)
		i = emcy->ended_next++ % EMCY_ERRORS;
	emcy->ended[i].code = error->code;
	emcy->ended[i].source = error->source;
	emcy->ended[i].t_us = now_us;
}

/* The error, raised or found active; NULL: there are too many. */
static struct emcy_error *raise(
	struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits, const uint8_t info[5])
{
	struct emcy *emcy = &node->emcy;
	size_t i = find_error(emcy, code, source);

	if (i == EMCY_ERRORS) {
		emcy->lost++;
		return NULL;
	}
	emcy->errors[i].over_us = UINT64_MAX;
	if (i < emcy->error_count)
		return &emcy->errors[i];
	emcy->errors[i].code = code;
	emcy->errors[i].source = source;
	emcy->errors[i].bits = register_bits;
	emcy->errors[i].earliest_us = register_bits & ERROR_COMMUNICATION ? earliest_end_us(emcy, code, source) : 0;
	emcy->error_count++;
	update_register(emcy);
	notify(node, code, true, info);
	record(emcy, code, info);
	enqueue(emcy, code, source, info);
	send_queue(node);
	return &emcy->errors[i];
}

void emcy_set_info(
	struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits, const uint8_t info[5])
{
	(void)raise(node, code, source, register_bits, info);
}

bool emcy_set_frame(struct canopen_node *node, uint16_t code, uint8_t source, const uint8_t info[5])
{
	size_t count = node->emcy.error_count;
	struct emcy_error *error = raise(node, code, source, ERROR_COMMUNICATION, info);

	if (!error)
		return false;
	error->earliest_us = node->now_us + EMCY_QUIET_US;
	error->over_us = node->now_us + EMCY_FORGOTTEN_US;
	return node->emcy.error_count > count;
}

void emcy_set(struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits)
{
	emcy_set_info(node, code, source, register_bits, (const uint8_t[5]){source});
}

static void end_error(struct canopen_node *node, size_t i)
{
	static const uint8_t no_info[5];
	struct emcy *emcy = &node->emcy;
	uint16_t code = emcy->errors[i].code;

	if (emcy->errors[i].bits & ERROR_COMMUNICATION)
		note_end(emcy, &emcy->errors[i], node->now_us);
	remove_error(emcy, i);
	notify(node, code, false, no_info);
	if (emcy->error_count)
		return;
	enqueue(emcy, EMCY_NO_ERROR, EMCY_NO_SOURCE, no_info);
	send_queue(node);
}

void emcy_clear(struct canopen_node *node, uint16_t code, uint8_t source)
{
	struct emcy *emcy = &node->emcy;
	size_t i = find_error(emcy, code, source);

	if (i == emcy->error_count)
		return;
	if (emcy->errors[i].earliest_us <= node->now_us)
		end_error(node, i);
	else
		emcy->errors[i].over_us = emcy->errors[i].earliest_us;
}

uint64_t emcy_tick(struct canopen_node *node)
{
	struct emcy *emcy = &node->emcy;
	uint64_t next_us = UINT64_MAX;

	for (size_t i = emcy->error_count; i-- > 0;) {
		if (emcy->errors[i].over_us <= node->now_us)
			end_error(node, i);
		else
			next_us = earlier(next_us, emcy->errors[i].over_us);
	}
	return earlier(next_us, send_queue(node));
}

void canopen_error_set(
	struct canopen_node *node, uint16_t code, uint8_t register_bits, const uint8_t *info, uint64_t now_us)
{
	static const uint8_t no_info[5];

	node->now_us = now_us;
	emcy_set_info(node, code, EMCY_NO_SOURCE, register_bits, info ? info : no_info);
}

void canopen_error_clear(struct canopen_node *node, uint16_t code, uint64_t now_us)
{
	node->now_us = now_us;
	emcy_clear(node, code, EMCY_NO_SOURCE);
}

void canopen_bus_down(struct canopen_node *node, bool down)
{
	node->emcy.bus_down = down;
}

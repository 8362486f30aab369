/* Heartbeat consumer (CiA 301, 7.2.8.3.2.2): 1016h has up to HEARTBEAT_CONSUMERS producers with the consumer time of
 * each. A consumer starts with the first heartbeat of its producer, boot-up included, and after a heartbeat event with
 * the next one. */
#include "gateway/canopen/service.h"
#include "od_index.h"

static uint8_t node_of(uint32_t value)
{
	return (uint8_t)(value >> 16);
}

/* A product of 64 bits: in one of 32 bits gcc 14 for arm64 loses the mask (-O2). */
static uint64_t time_us(uint32_t value)
{
	return (uint64_t)(value & 0xFFFF) * 1000;
}

/* An entry without a node-ID or a time is not in use. */
static bool in_use(uint32_t value)
{
	return node_of(value) >= 1 && node_of(value) <= 127 && (value & 0xFFFF);
}

static bool watches(const struct heartbeat *heartbeat, size_t n, uint8_t node_id)
{
	return in_use(*heartbeat->consumer[n].value) && node_of(*heartbeat->consumer[n].value) == node_id;
}

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const struct heartbeat *heartbeat = &((struct canopen_node *)ctx)->heartbeat;
	uint32_t value = get_u32(wire);

	(void)size;
	if (value >> 24 || node_of(value) > 127)
		return OD_BAD_VALUE;
	for (size_t i = 0; in_use(value) && i < heartbeat->count; i++)
		if (i + 1 != entry->sub && watches(heartbeat, i, node_of(value)))
			return OD_INCOMPATIBLE;
	return OD_OK;
}

static void forget(struct canopen_node *node, struct heartbeat_consumer *consumer)
{
	if (consumer->lost)
		emcy_clear(node, EMCY_HEARTBEAT, consumer->node_id);
	consumer->alive = consumer->lost = false;
	consumer->node_id = in_use(*consumer->value) ? node_of(*consumer->value) : 0;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	struct canopen_node *node = ctx;

	forget(node, &node->heartbeat.consumer[entry->sub - 1]);
	node_filter(node);
}

void heartbeat_init(struct canopen_node *node)
{
	struct heartbeat *heartbeat = &node->heartbeat;

	for (uint8_t i = 0; i < HEARTBEAT_CONSUMERS; i++) {
		const uint32_t *value =
			od_value(node->od, OD_INDEX_CONSUMER_HEARTBEAT_TIME, (uint8_t)(i + 1), sizeof(uint32_t));
		if (!value)
			break;
		heartbeat->consumer[heartbeat->count++].value = value;
	}
	heartbeat->hook = (struct od_hook){.first = OD_INDEX_CONSUMER_HEARTBEAT_TIME,
		.last = OD_INDEX_CONSUMER_HEARTBEAT_TIME,
		.before = before_write,
		.after = after_write,
		.ctx = node};
	od_attach(node->od, &heartbeat->hook);
}

/* Stored values did not pass the hook: of two entries for one producer the first is used. */
void heartbeat_reset(struct canopen_node *node)
{
	struct heartbeat *heartbeat = &node->heartbeat;

	for (size_t i = 0; i < heartbeat->count; i++) {
		struct heartbeat_consumer *consumer = &heartbeat->consumer[i];

		consumer->lost = false; /* emcy_reset() has ended the error */
		forget(node, consumer);
		for (size_t k = 0; consumer->node_id && k < i; k++)
			if (heartbeat->consumer[k].node_id == consumer->node_id) {
				consumer->node_id = 0;
				node_bad_data(node, OD_INDEX_CONSUMER_HEARTBEAT_TIME);
			}
	}
}

void heartbeat_receive(struct canopen_node *node, const struct can_msg *msg)
{
	struct heartbeat *heartbeat = &node->heartbeat;

	if (msg->len != 1)
		return;
	for (size_t i = 0; i < heartbeat->count; i++) {
		struct heartbeat_consumer *consumer = &heartbeat->consumer[i];

		if (consumer->node_id == 0 || msg->id != CAN_ID_ERROR_CONTROL + consumer->node_id)
			continue;
		if (consumer->lost)
			emcy_clear(node, EMCY_HEARTBEAT, consumer->node_id);
		consumer->lost = false;
		consumer->alive = true;
		consumer->deadline_us = node->now_us + time_us(*consumer->value);
		return;
	}
}

void heartbeat_pause(struct canopen_node *node)
{
	for (size_t i = 0; i < node->heartbeat.count; i++)
		node->heartbeat.consumer[i].alive = false;
}

uint64_t heartbeat_tick(struct canopen_node *node)
{
	struct heartbeat *heartbeat = &node->heartbeat;
	uint64_t deadline_us = UINT64_MAX;

	for (size_t i = 0; i < heartbeat->count; i++) {
		struct heartbeat_consumer *consumer = &heartbeat->consumer[i];

		if (!consumer->alive)
			continue;
		if (node->now_us < consumer->deadline_us) {
			deadline_us = earlier(deadline_us, consumer->deadline_us);
			continue;
		}
		consumer->alive = false;
		consumer->lost = true;
		emcy_set(node, EMCY_HEARTBEAT, consumer->node_id, ERROR_COMMUNICATION);
		nmt_communication_error(node);
	}
	return deadline_us;
}

/* SYNC consumer and producer (CiA 301, 7.2.5): COB-ID 1005h, period 1006h, synchronous window 1007h, counter 1019h. A
 * producer is its own consumer. A consumer that has a period reports a missing SYNC (EMCY 8100h, and the LED of CiA
 * 303-3). */
#include "gateway/canopen/service.h"
#include "od_index.h"

enum {
	PERIOD_MIN_US = 1000,
	COUNTER_MAX = 240,
	SOURCE_MISSING = 0x06, /* of EMCY_SYNC_TIME: the first byte of its info 1006h */
};

/* The identifier cannot change while SYNC is produced. */
static enum od_status before_cob_id(const struct canopen_node *node, uint32_t value)
{
	uint32_t old = *node->sync.cob_id;

	if (!cob_id_usable(value) || (old & COB_ID_PRODUCES && (old ^ value) & COB_ID_MASK))
		return OD_BAD_VALUE;
	return sdo_server_uses(node, value) ? OD_INCOMPATIBLE : OD_OK;
}

/* Nor the counter overflow value while there is a period. */
static enum od_status before_counter(const struct sync *sync, uint8_t value)
{
	if (value == 1 || value > COUNTER_MAX)
		return OD_BAD_VALUE;
	return *sync->period_us && value != *sync->counter_overflow ? OD_DEVICE_STATE : OD_OK;
}

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const struct canopen_node *node = ctx;
	const struct sync *sync = &node->sync;

	(void)size;
	switch (entry->index) {
	case OD_INDEX_COB_ID_SYNC: /* bit 31 has no meaning */
		return before_cob_id(node, get_u32(wire));
	case OD_INDEX_COMMUNICATION_CYCLE_PERIOD:
		return get_u32(wire) && get_u32(wire) < PERIOD_MIN_US ? OD_BAD_VALUE : OD_OK;
	case OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE:
		return before_counter(sync, *(const uint8_t *)wire);
	default:
		return OD_OK;
	}
}

static void update_id(struct canopen_node *node)
{
	bool consumer = cob_id_usable(*node->sync.cob_id) && !(*node->sync.cob_id & COB_ID_PRODUCES);

	node->sync.id = consumer ? *node->sync.cob_id & COB_ID_MASK : CAN_ID_NONE;
}

void sync_pause(struct canopen_node *node)
{
	node->sync.watched = false;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	struct canopen_node *node = ctx;

	if (entry->index == OD_INDEX_COB_ID_SYNC || entry->index == OD_INDEX_COMMUNICATION_CYCLE_PERIOD) {
		sync_pause(node);
		emcy_clear(node, EMCY_SYNC_TIME, SOURCE_MISSING);
	}
	if (entry->index == OD_INDEX_COMMUNICATION_CYCLE_PERIOD)
		node->sync.running = false;
	if (entry->index != OD_INDEX_COB_ID_SYNC)
		return;
	update_id(node);
	node_filter(node);
}

void sync_init(struct canopen_node *node)
{
	struct sync *sync = &node->sync;

	sync->cob_id = node_value(node, OD_INDEX_COB_ID_SYNC, 0, sizeof(uint32_t));
	sync->period_us = node_value(node, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0, sizeof(uint32_t));
	sync->window_us = node_value(node, OD_INDEX_SYNCHRONOUS_WINDOW_LENGTH, 0, sizeof(uint32_t));
	sync->counter_overflow = node_value(node, OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE, 0, sizeof(uint8_t));
	sync->hook = (struct od_hook){.first = OD_INDEX_COB_ID_SYNC,
		.last = OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE,
		.before = before_write,
		.after = after_write,
		.ctx = node};
	od_attach(node->od, &sync->hook);
}

void sync_start(struct canopen_node *node)
{
	node->sync.last_us = 0;
}

void sync_reset(struct canopen_node *node)
{
	node->sync.running = false;
	node->sync.counter = 0;
	sync_start(node);
	update_id(node);
	if (!cob_id_usable(*node->sync.cob_id) && od_find(node->od->table, OD_INDEX_COB_ID_SYNC, 0, NULL))
		node_bad_data(node, OD_INDEX_COB_ID_SYNC);
}

static uint64_t received_us(const struct canopen_node *node, const struct can_msg *msg)
{
	return msg->t_us ? msg->t_us : node->now_us;
}

bool sync_window_open(const struct canopen_node *node, const struct can_msg *msg)
{
	const struct sync *sync = &node->sync;

	return *sync->window_us == 0 || sync->last_us == 0 ||
	       received_us(node, msg) <= sync->last_us + *sync->window_us;
}

/* 1007h: for how long after the SYNC its PDOs may be sent. The core sends them when it processes the SYNC, so they are
 * late only when the SYNC was processed late. That raises an EMCY, as CiA 301, 7.5.2.7 permits. */
static bool window_passed(struct canopen_node *node)
{
	struct sync *sync = &node->sync;
	uint8_t info[5] = {0};

	if (*sync->window_us == 0 || node->now_us <= sync->last_us + *sync->window_us) {
		canopen_error_clear(node, EMCY_SYNC_TIME, node->now_us);
		return false;
	}
	put_u16(info, OD_INDEX_SYNCHRONOUS_WINDOW_LENGTH);
	canopen_error_set(node, EMCY_SYNC_TIME, ERROR_COMMUNICATION, info, node->now_us);
	sync->late++;
	return true;
}

void sync_receive(struct canopen_node *node, const struct can_msg *msg)
{
	bool counted = *node->sync.counter_overflow != 0;

	if (!nmt_communicates(node))
		return;
	if (msg->len != (counted ? 1 : 0)) {
		emcy_set_frame(node, EMCY_SYNC_LENGTH, EMCY_NO_SOURCE, (const uint8_t[5]){0});
		return;
	}
	canopen_error_clear(node, EMCY_SYNC_LENGTH, node->now_us);
	emcy_clear(node, EMCY_SYNC_TIME, SOURCE_MISSING);
	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	node->sync.last_us = received_us(node, msg);
	node->sync.watched = *node->sync.period_us != 0;
	node->sync.missing_us = node->now_us + *node->sync.period_us * UINT64_C(3) / 2;
	pdo_sync(node, counted ? msg->data[0] : 0, window_passed(node));
}

/* The timeout starts with the first SYNC in operational: the producer may start after its consumers. */
static uint64_t watch(struct canopen_node *node)
{
	uint8_t info[5] = {0};

	if (node->nmt.state != NMT_OPERATIONAL)
		sync_pause(node);
	if (!node->sync.watched)
		return UINT64_MAX;
	if (node->now_us < node->sync.missing_us)
		return node->sync.missing_us;
	put_u16(info, OD_INDEX_COMMUNICATION_CYCLE_PERIOD);
	emcy_set_info(node, EMCY_SYNC_TIME, SOURCE_MISSING, ERROR_COMMUNICATION, info);
	sync_pause(node);
	return UINT64_MAX;
}

static bool produces(const struct canopen_node *node)
{
	const struct sync *sync = &node->sync;

	return *sync->cob_id & COB_ID_PRODUCES && cob_id_usable(*sync->cob_id) && *sync->period_us >= PERIOD_MIN_US &&
	       nmt_communicates(node);
}

static void produce(struct canopen_node *node)
{
	struct sync *sync = &node->sync;
	bool counted = *sync->counter_overflow != 0;

	if (counted)
		sync->counter = (uint8_t)(sync->counter % *sync->counter_overflow + 1);
	node_send(node, *sync->cob_id & COB_ID_MASK, &sync->counter, counted ? 1 : 0);
	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	sync->last_us = node->now_us;
	pdo_sync(node, counted ? sync->counter : 0, false);
}

uint64_t sync_tick(struct canopen_node *node)
{
	struct sync *sync = &node->sync;

	if (!produces(node)) {
		sync->running = false;
		sync->counter = 0; /* the first SYNC has 1 */
		return watch(node);
	}
	if (!sync->running) {
		sync->running = true;
		sync->next_us = node->now_us + *sync->period_us;
	}
	if (node->now_us < sync->next_us)
		return sync->next_us;
	produce(node);
	/* keep the phase after a small delay, restart it when whole periods were missed */
	if (node->now_us - sync->next_us >= *sync->period_us)
		sync->next_us = node->now_us;
	sync->next_us += *sync->period_us;
	return sync->next_us;
}

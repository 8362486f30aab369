/* Node guarding, slave (CiA 301, 7.2.8.3.2.1): the response to the master's remote request carries the NMT state and a
 * toggle bit. Life guarding (100Ch, 100Dh) starts with the first request. CiA 301 gives the heartbeat precedence over
 * both; here a heartbeat producer (1017h, the default) answers requests nevertheless, since masters that guard do not
 * set it to 0, and has no life guarding. */
#include "gateway/canopen/service.h"
#include "od_index.h"

enum { TOGGLE = 1 << 7 };

static uint64_t life_time_us(const struct guard *guard)
{
	return (uint64_t)*guard->time_ms * *guard->life_factor * 1000u;
}

void guard_init(struct canopen_node *node)
{
	node->guard.time_ms = node_value(node, OD_INDEX_GUARD_TIME, 0, sizeof(uint16_t));
	node->guard.life_factor = node_value(node, OD_INDEX_LIFE_TIME_FACTOR, 0, sizeof(uint8_t));
}

void guard_pause(struct canopen_node *node)
{
	node->guard.alive = false;
}

void guard_reset(struct canopen_node *node)
{
	node->guard.toggle = 0;
	guard_pause(node);
}

void guard_receive(struct canopen_node *node)
{
	struct guard *guard = &node->guard;

	node_send(node, CAN_ID_ERROR_CONTROL + node->id, (const uint8_t[]){(uint8_t)(node->nmt.state | guard->toggle)},
		1);
	guard->toggle ^= TOGGLE;
	if (*node->nmt.heartbeat_ms)
		return;
	guard->alive = true;
	guard->last_us = node->now_us;
	emcy_clear(node, EMCY_HEARTBEAT, EMCY_NO_SOURCE);
}

uint64_t guard_tick(struct canopen_node *node)
{
	struct guard *guard = &node->guard;
	uint64_t due_us = guard->last_us + life_time_us(guard);

	if (*node->nmt.heartbeat_ms) {
		guard->alive = false;
		emcy_clear(node, EMCY_HEARTBEAT, EMCY_NO_SOURCE);
	}
	if (!guard->alive || life_time_us(guard) == 0)
		return UINT64_MAX;
	if (node->now_us < due_us)
		return due_us;
	guard->alive = false;
	emcy_set(node, EMCY_HEARTBEAT, EMCY_NO_SOURCE, ERROR_COMMUNICATION);
	nmt_communication_error(node);
	return UINT64_MAX;
}

/* LSS slave (CiA 305): a master finds this node by its LSS address, the identity of 1018h, and configures node-ID and
 * bit rate. There are two states, waiting and configuration. LSS is available in every NMT state, and is the only
 * service of a node without a node-ID. */
#include "gateway/canopen/cia305.h"
#include "gateway/canopen/service.h"
#include "od_index.h"

#include <string.h>

enum answer {
	ANSWER_OK = 0,
	ANSWER_OUT_OF_RANGE = 1,  /* node-ID, bit timing */
	ANSWER_NOT_SUPPORTED = 1, /* store */
	ANSWER_STORE_FAILED = 2,
};

enum {
	VENDOR,
	PRODUCT,
	REVISION,
	SERIAL,
	FASTSCAN_RESET = 0x80,
};

void lss_init(struct canopen_node *node, uint8_t node_id)
{
	struct lss *lss = &node->lss;

	for (uint8_t i = 0; i < LSS_NUMBERS; i++)
		lss->identity[i] = node_value(node, OD_INDEX_IDENTITY, (uint8_t)(i + 1), sizeof(uint32_t));
	lss->start_id = lss->stored_id = lss->node_id = node->id = node_id;
}

static void answer(struct canopen_node *node, uint8_t command, uint32_t value)
{
	struct can_msg msg = {.id = CAN_ID_LSS_RESPONSE, .len = 8, .data = {command}};

	put_u32(msg.data + 1, value);
	node_send(node, msg.id, msg.data, msg.len);
	if (node->listener)
		node->listener->lss_answered(node->listener->ctx, &msg);
}

/* ---- node-ID ----------------------------------------------------------------------------------------------------- */

void lss_reset(struct canopen_node *node, enum od_group group)
{
	struct lss *lss = &node->lss;
	uint8_t old = node->id;

	if (group == OD_GROUP_ALL)
		lss->node_id = lss->stored_id;
	lss->configuring = false;
	lss->selected = lss->identified = lss->scanned = lss->confirmed = 0;
	node->id = lss->node_id;
	od_follow_node_id(node->od->table, node->od->values, old, node->id);
	od_follow_node_id(node->od->table, node->od->values, lss->start_id, node->id);
}

static void configure_node_id(struct canopen_node *node, uint8_t node_id)
{
	bool valid = (node_id >= 1 && node_id <= 127) || node_id == CANOPEN_UNCONFIGURED;

	if (valid)
		node->lss.node_id = node_id;
	answer(node, LSS_CONFIGURE_NODE_ID, valid ? ANSWER_OK : ANSWER_OUT_OF_RANGE);
}

/* ---- bit timing and storage, where the device supports them ------------------------------------------------------ */

/* CiA 305, the standard table of bit timings, by index; 0: reserved */
static uint32_t bit_rate_of(uint8_t table, uint8_t index)
{
	static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000, 0, 50000, 20000, 10000};

	return table == 0 && index < sizeof(rates) / sizeof(rates[0]) ? rates[index] : 0;
}

static void configure_bit_timing(struct canopen_node *node, uint8_t table, uint8_t index)
{
	const struct canopen_device *device = &node->device;
	uint32_t bit_s = bit_rate_of(table, index);
	bool valid = bit_s && device->bit_rate_possible && device->bit_rate_possible(device->ctx, bit_s);

	if (valid)
		node->lss.bit_s = bit_s;
	answer(node, LSS_CONFIGURE_BIT_TIMING, valid ? ANSWER_OK : ANSWER_OUT_OF_RANGE);
}

/* All nodes receive this at once and switch together: each sends nothing for one delay at the old bit rate and for one
 * delay at the new one. */
static void activate_bit_timing(struct canopen_node *node, uint16_t delay_ms)
{
	struct lss *lss = &node->lss;

	if (!lss->bit_s || !node->device.set_bit_rate)
		return;
	sdo_server_stop(node);
	lss->switching = SWITCH_OLD_RATE;
	lss->switch_delay_us = delay_ms * 1000u;
	lss->switch_us = node->now_us + lss->switch_delay_us;
}

bool lss_silent(const struct canopen_node *node)
{
	return node->lss.switching != SWITCH_NONE;
}

/* Nothing was received meanwhile: every supervision restarts. */
static void end_silence(struct canopen_node *node)
{
	node->lss.switching = SWITCH_NONE;
	guard_pause(node);
	heartbeat_pause(node);
	sync_pause(node);
	pdo_pause(node);
}

uint64_t lss_tick(struct canopen_node *node)
{
	struct lss *lss = &node->lss;

	if (lss->switching == SWITCH_OLD_RATE && node->now_us >= lss->switch_us) {
		node->device.set_bit_rate(node->device.ctx, lss->bit_s);
		lss->switching = SWITCH_NEW_RATE;
		lss->switch_us = node->now_us + lss->switch_delay_us;
	}
	if (lss->switching == SWITCH_NEW_RATE && node->now_us >= lss->switch_us)
		end_silence(node);
	return lss_silent(node) ? lss->switch_us : UINT64_MAX;
}

static void store_ended(struct canopen_node *node, enum od_status status)
{
	struct lss *lss = &node->lss;

	if (status == OD_OK)
		lss->stored_id = lss->storing_id;
	if (lss->configuring && !lss_silent(node))
		answer(node, LSS_STORE, status == OD_OK ? ANSWER_OK : ANSWER_STORE_FAILED);
}

void canopen_lss_stored(struct canopen_node *node, enum od_status status, uint64_t now_us)
{
	node->now_us = now_us;
	node->lss.storing = false;
	store_ended(node, status);
}

static void store(struct canopen_node *node)
{
	const struct canopen_device *device = &node->device;
	struct lss *lss = &node->lss;
	enum od_status status;

	if (!device->store_lss) {
		answer(node, LSS_STORE, ANSWER_NOT_SUPPORTED);
		return;
	}
	if (lss->storing) {
		answer(node, LSS_STORE, ANSWER_STORE_FAILED);
		return;
	}
	lss->storing_id = lss->node_id;
	status = device->store_lss(device->ctx, lss->node_id, lss->bit_s);
	lss->storing = status == OD_PENDING;
	if (!lss->storing)
		store_ended(node, status);
}

bool canopen_lss_active(const struct canopen_node *node)
{
	return node->lss.configuring || node->id == CANOPEN_UNCONFIGURED;
}

/* ---- switching and identification -------------------------------------------------------------------------------- */

/* A node that had no node-ID boots up with its new one. */
static void switch_global(struct canopen_node *node, uint8_t mode)
{
	struct lss *lss = &node->lss;
	bool was_configuring = lss->configuring;

	if (mode > 1)
		return;
	lss->configuring = mode == 1;
	if (was_configuring && !lss->configuring && node->id == CANOPEN_UNCONFIGURED && lss->node_id != node->id)
		node_reset(node, OD_GROUP_COMMUNICATION);
}

/* The four numbers of the LSS address are received one by one; the node that matches all of them is switched. */
static void switch_selective(struct canopen_node *node, unsigned number, uint32_t value)
{
	struct lss *lss = &node->lss;
	bool match =
		!lss->configuring && (number == VENDOR || number == lss->selected) && *lss->identity[number] == value;

	lss->selected = match ? (uint8_t)(number + 1) : 0;
	if (lss->selected < LSS_NUMBERS)
		return;
	lss->selected = 0;
	lss->configuring = true;
	answer(node, LSS_SWITCHED, 0);
}

/* Steps 0 to 5: vendor, product, lowest and highest revision, lowest and highest serial number. */
static bool within(const struct lss *lss, unsigned step, uint32_t value)
{
	switch (step) {
	case 2:
		return *lss->identity[REVISION] >= value;
	case 3:
		return *lss->identity[REVISION] <= value;
	case 4:
		return *lss->identity[SERIAL] >= value;
	case 5:
		return *lss->identity[SERIAL] <= value;
	default:
		return *lss->identity[step] == value;
	}
}

static void identify(struct canopen_node *node, unsigned step, uint32_t value)
{
	struct lss *lss = &node->lss;
	bool match = (step == 0 || step == lss->identified) && within(lss, step, value);

	lss->identified = match ? (uint8_t)(step + 1) : 0;
	if (lss->identified < 6)
		return;
	lss->identified = 0;
	answer(node, LSS_IDENTIFIED, 0);
}

/* Neither an active nor a pending node-ID. */
static bool unconfigured(const struct canopen_node *node)
{
	return node->id == CANOPEN_UNCONFIGURED && node->lss.node_id == CANOPEN_UNCONFIGURED;
}

/* The master determines the LSS address bit by bit: nodes whose number matches from bit 31 down to `bit` respond. Bit 0
 * confirms a number, and `next` is the number that follows. After the last one it is a smaller one: then the node
 * enters configuration state, if all four numbers were confirmed. */
static void fastscan(struct canopen_node *node, const uint8_t data[8])
{
	struct lss *lss = &node->lss;
	uint8_t bit = data[5], number = data[6], next = data[7];

	if (!unconfigured(node) || lss->configuring)
		return;
	if (bit == FASTSCAN_RESET) {
		lss->scanned = VENDOR;
		lss->confirmed = 0;
		answer(node, LSS_IDENTIFIED, 0);
		return;
	}
	if (bit > 31 || number >= LSS_NUMBERS || next >= LSS_NUMBERS || number != lss->scanned ||
		(*lss->identity[number] ^ get_u32(data + 1)) >> bit)
		return;
	if (bit == 0) {
		lss->scanned = next;
		lss->confirmed |= (uint8_t)(1u << number);
		lss->configuring = next < number && lss->confirmed == (1u << LSS_NUMBERS) - 1;
	}
	answer(node, LSS_IDENTIFIED, 0);
}

/* ---- requests of the master -------------------------------------------------------------------------------------- */

/* Services of configuration state only. */
static void receive_configuration(struct canopen_node *node, const uint8_t data[8])
{
	switch (data[0]) {
	case LSS_CONFIGURE_NODE_ID:
		configure_node_id(node, data[1]);
		break;
	case LSS_CONFIGURE_BIT_TIMING:
		configure_bit_timing(node, data[1], data[2]);
		break;
	case LSS_ACTIVATE_BIT_TIMING:
		activate_bit_timing(node, get_u16(data + 1));
		break;
	case LSS_STORE:
		store(node);
		break;
	case LSS_INQUIRE_NODE_ID:
		answer(node, LSS_INQUIRE_NODE_ID, node->id);
		break;
	default:
		if (data[0] >= LSS_INQUIRE_IDENTITY && data[0] < LSS_INQUIRE_IDENTITY + LSS_NUMBERS)
			answer(node, data[0], *node->lss.identity[data[0] - LSS_INQUIRE_IDENTITY]);
		break;
	}
}

void lss_receive(struct canopen_node *node, const struct can_msg *msg)
{
	const uint8_t *data = msg->data;

	if (msg->len != 8)
		return;
	if (data[0] == LSS_SWITCH_GLOBAL)
		switch_global(node, data[1]);
	else if (data[0] >= LSS_SWITCH_SELECTIVE && data[0] < LSS_SWITCH_SELECTIVE + LSS_NUMBERS)
		switch_selective(node, data[0] - LSS_SWITCH_SELECTIVE, get_u32(data + 1));
	else if (data[0] >= LSS_IDENTIFY && data[0] < LSS_IDENTIFY + 6)
		identify(node, data[0] - LSS_IDENTIFY, get_u32(data + 1));
	else if (data[0] == LSS_FASTSCAN)
		fastscan(node, data);
	else if (data[0] == LSS_IDENTIFY_UNCONFIGURED && unconfigured(node))
		answer(node, LSS_IDENTIFIED_UNCONFIGURED, 0);
	else if (node->lss.configuring)
		receive_configuration(node, data);
}

#include "gateway/canopen/client/lss_master.h"

#include <string.h>

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/cia305.h"
#include "od/little_endian.h"

enum { FASTSCAN_RESET = 0x80 };

void lss_master_init(
	struct lss_master *m, void (*send)(void *ctx, const struct can_msg *msg, uint64_t now_us), void *ctx)
{
	*m = (struct lss_master){.send = send, .ctx = ctx};
}

static void send(struct lss_master *m, unsigned command, uint32_t value, const uint8_t tail[3], uint64_t now_us)
{
	struct can_msg msg = {.id = CAN_ID_LSS_REQUEST, .len = 8, .data = {(uint8_t)command}};

	put_u32(msg.data + 1, value);
	if (tail)
		memcpy(msg.data + 5, tail, 3);
	m->send(m->ctx, &msg, now_us);
}

/* Before the request: the answer of a node in the same process can come at once. */
static void expect(struct lss_master *m, unsigned command, uint64_t now_us)
{
	m->result = LSS_RUNNING;
	m->scanning = SCAN_NONE;
	m->confirmed = m->answered = false;
	m->expected = (uint8_t)command;
	m->next_us = now_us + m->timeout_us;
}

void lss_master_switch_global(struct lss_master *m, bool configuration, uint64_t now_us)
{
	send(m, LSS_SWITCH_GLOBAL, configuration, NULL, now_us);
	m->result = LSS_DONE;
}

void lss_master_activate_bit_rate(struct lss_master *m, uint16_t delay_ms, uint64_t now_us)
{
	send(m, LSS_ACTIVATE_BIT_TIMING, delay_ms, NULL, now_us);
	m->result = LSS_DONE;
}

void lss_master_switch_selective(struct lss_master *m, const uint32_t address[LSS_ADDRESS], uint64_t now_us)
{
	expect(m, LSS_SWITCHED, now_us);
	for (unsigned i = 0; i < LSS_ADDRESS; i++)
		send(m, LSS_SWITCH_SELECTIVE + i, address[i], NULL, now_us);
}

/* A service whose answer has an error code. */
static void configure(struct lss_master *m, unsigned command, uint32_t value, uint64_t now_us)
{
	expect(m, command, now_us);
	m->confirmed = true;
	send(m, command, value, NULL, now_us);
}

void lss_master_configure_node_id(struct lss_master *m, uint8_t node_id, uint64_t now_us)
{
	configure(m, LSS_CONFIGURE_NODE_ID, node_id, now_us);
}

void lss_master_configure_bit_rate(struct lss_master *m, uint8_t table, uint8_t index, uint64_t now_us)
{
	configure(m, LSS_CONFIGURE_BIT_TIMING, table | (uint32_t)index << 8, now_us);
}

void lss_master_store(struct lss_master *m, uint64_t now_us)
{
	configure(m, LSS_STORE, 0, now_us);
}

void lss_master_inquire(struct lss_master *m, uint8_t part, uint64_t now_us)
{
	expect(m, LSS_INQUIRE_IDENTITY + part, now_us);
	send(m, LSS_INQUIRE_IDENTITY + part, 0, NULL, now_us);
}

/* ---- fastscan ---------------------------------------------------------------------------------------------------- */

/* The next part that counts; the first one again behind the last. */
static uint8_t part_after(const struct lss_master *m, uint8_t part)
{
	do
		part = (uint8_t)((part + 1) % LSS_ADDRESS);
	while (part != LSS_VENDOR && m->how[part] == LSS_IGNORE);
	return part;
}

static void ask(struct lss_master *m, uint8_t bit, uint8_t next, uint64_t now_us)
{
	m->answered = false;
	m->next_us = now_us + m->timeout_us;
	send(m, LSS_FASTSCAN, bit == FASTSCAN_RESET ? 0 : m->address[m->part], (const uint8_t[3]){bit, m->part, next},
		now_us);
}

static void confirm(struct lss_master *m, uint64_t now_us)
{
	m->scanning = SCAN_CONFIRM;
	ask(m, 0, part_after(m, m->part), now_us);
}

static void scan_part(struct lss_master *m, uint8_t part, uint64_t now_us)
{
	m->part = part;
	if (m->how[part] == LSS_MATCH) {
		confirm(m, now_us);
		return;
	}
	m->scanning = SCAN_BITS;
	m->bit = 31;
	m->address[part] = 0;
	ask(m, m->bit, part, now_us);
}

void lss_master_fastscan(
	struct lss_master *m, const enum lss_scan how[LSS_ADDRESS], const uint32_t match[LSS_ADDRESS], uint64_t now_us)
{
	expect(m, LSS_IDENTIFIED, now_us);
	m->scanning = SCAN_RESET;
	m->part = LSS_VENDOR;
	for (int i = 0; i < LSS_ADDRESS; i++) {
		m->how[i] = how[i];
		m->address[i] = how[i] == LSS_MATCH ? match[i] : 0;
	}
	ask(m, FASTSCAN_RESET, 0, now_us);
}

/* The time of a question is over. */
static void scan_on(struct lss_master *m, uint64_t now_us)
{
	uint8_t next = part_after(m, m->part);

	switch (m->scanning) {
	case SCAN_NONE:
		break;
	case SCAN_RESET:
		if (m->answered)
			scan_part(m, LSS_VENDOR, now_us);
		else
			m->result = LSS_NO_ANSWER;
		break;
	case SCAN_BITS:
		if (!m->answered)
			m->address[m->part] |= UINT32_C(1) << m->bit;
		if (m->bit-- > 0)
			ask(m, m->bit, m->part, now_us);
		else
			confirm(m, now_us);
		break;
	case SCAN_CONFIRM:
		if (!m->answered)
			m->result = LSS_LOST;
		else if (next == LSS_VENDOR)
			m->result = LSS_DONE;
		else
			scan_part(m, next, now_us);
		break;
	}
}

/* ---- answers ----------------------------------------------------------------------------------------------------- */

void lss_master_receive(struct lss_master *m, const struct can_msg *msg, uint64_t now_us)
{
	if (m->result != LSS_RUNNING || m->answered || msg->id != CAN_ID_LSS_RESPONSE || msg->extended || msg->remote ||
		msg->len != 8 || msg->data[0] != m->expected)
		return;
	m->answered = true;
	memcpy(m->answer, msg->data, 8);
	m->next_us = now_us + (m->scanning ? m->timeout_us / 4 : 0);
}

static void end(struct lss_master *m)
{
	m->value = get_u32(m->answer + 1);
	m->error = m->answer[1];
	if (!m->answered)
		m->result = LSS_NO_ANSWER;
	else
		m->result = m->confirmed && m->error ? LSS_REFUSED : LSS_DONE;
}

uint64_t lss_master_tick(struct lss_master *m, uint64_t now_us)
{
	if (m->result == LSS_RUNNING && now_us >= m->next_us) {
		if (m->scanning)
			scan_on(m, now_us);
		else
			end(m);
	}
	return m->result == LSS_RUNNING ? m->next_us : UINT64_MAX;
}

/* Receive PDOs (CiA 301, 7.2.2, 7.5.2.35 and 7.5.2.36). A PDO is written to the dictionary as a whole: all values are
 * checked before the first is written, each with the checks of an SDO. Synchronous PDOs are applied at the next SYNC.
 */
#include "gateway/canopen/pdo.h"

#include <string.h>

/* ---- errors: each is sent once; a correct PDO ends it ------------------------------------------------------------ */

static const uint16_t codes[] = {EMCY_PDO_CONTENT, EMCY_PDO_SHORT, EMCY_PDO_LONG, EMCY_PDO_TIMEOUT};
enum fault { FAULT_CONTENT, FAULT_SHORT, FAULT_LONG, FAULT_TIMEOUT };

/* The source of the EMCY: 1 for the first RPDO; 0 would mean none. */
static uint8_t source(const struct canopen_node *node, const struct rpdo *rpdo)
{
	return (uint8_t)(rpdo - node->pdos.rpdo + 1);
}

/* The manufacturer-specific field: index of the PDO, then `detail`. */
static void set_fault(struct canopen_node *node, const struct rpdo *rpdo, enum fault fault, const uint8_t detail[3])
{
	uint8_t info[5] = {0};

	put_u16(info, rpdo->pdo.index);
	memcpy(info + 2, detail, 3);
	if (fault == FAULT_TIMEOUT)
		emcy_set_info(node, codes[fault], source(node, rpdo), ERROR_COMMUNICATION, info);
	else
		emcy_set_frame(node, codes[fault], source(node, rpdo), info);
}

static void clear_fault(struct canopen_node *node, const struct rpdo *rpdo, enum fault fault)
{
	emcy_clear(node, codes[fault], source(node, rpdo));
}

/* ---- operation --------------------------------------------------------------------------------------------------- */

void rpdo_restart(struct canopen_node *node, struct rpdo *rpdo)
{
	rpdo->waits = rpdo->monitored = false;
	for (enum fault fault = FAULT_CONTENT; fault <= FAULT_TIMEOUT; fault++)
		clear_fault(node, rpdo, fault);
}

void rpdo_stop_timer(struct canopen_node *node, struct rpdo *rpdo)
{
	rpdo->monitored = false;
	clear_fault(node, rpdo, FAULT_TIMEOUT);
}

void pdo_pause(struct canopen_node *node)
{
	for (size_t i = 0; i < node->pdos.rpdo_count; i++)
		node->pdos.rpdo[i].monitored = false;
}

size_t pdo_receive_ids(const struct canopen_node *node, uint32_t ids[RPDO_MAX])
{
	size_t n = 0;

	for (size_t i = 0; i < node->pdos.rpdo_count; i++)
		if (node->pdos.rpdo[i].pdo.mapped_count)
			ids[n++] = pdo_can_id(&node->pdos.rpdo[i].pdo);
	return n;
}

/* ---- into the dictionary ----------------------------------------------------------------------------------------- */

static enum od_status check_one(struct od *od, const struct od_entry *entry, const uint8_t *wire)
{
	(void)od;
	return od_check(entry, wire, entry->size);
}

static enum od_status write_one(struct od *od, const struct od_entry *entry, const uint8_t *wire)
{
	enum od_status status = od_write(od, entry->index, entry->sub, wire, entry->size);

	return status == OD_PENDING ? OD_OK : status;
}

/* The first object that refuses its value, or NULL. */
static const struct od_entry *for_each_value(struct od *od, const struct rpdo *rpdo,
	enum od_status (*action)(struct od *od, const struct od_entry *entry, const uint8_t *wire))
{
	const struct od_entry *refuses = NULL;
	size_t at = 0;

	for (size_t i = 0; i < rpdo->pdo.mapped_count; i++) {
		const struct od_entry *entry = rpdo->pdo.mapped[i];

		if (!pdo_is_dummy(entry) && action(od, entry, rpdo->data + at) != OD_OK && !refuses)
			refuses = entry;
		at += entry->size;
	}
	return refuses;
}

static void write_values(struct canopen_node *node, const struct rpdo *rpdo)
{
	const struct od_entry *refuses = for_each_value(node->od, rpdo, check_one);

	if (!refuses)
		refuses = for_each_value(node->od, rpdo, write_one);
	if (refuses)
		set_fault(node, rpdo, FAULT_CONTENT,
			(const uint8_t[3]){(uint8_t)refuses->index, (uint8_t)(refuses->index >> 8), refuses->sub});
	else
		clear_fault(node, rpdo, FAULT_CONTENT);
}

void rpdo_sync(struct canopen_node *node)
{
	for (size_t i = 0; i < node->pdos.rpdo_count; i++) {
		struct rpdo *rpdo = &node->pdos.rpdo[i];

		if (!rpdo->waits)
			continue;
		rpdo->waits = false;
		write_values(node, rpdo);
	}
}

/* ---- reception --------------------------------------------------------------------------------------------------- */

/* Of a PDO that is too long the mapped bytes are used; one that is too short is not used (CiA 301, 7.5.2.36). */
static bool length_fits(struct canopen_node *node, const struct rpdo *rpdo, uint8_t len)
{
	const uint8_t detail[3] = {len, rpdo->pdo.bytes};

	if (len < rpdo->pdo.bytes) {
		set_fault(node, rpdo, FAULT_SHORT, detail);
		return false;
	}
	clear_fault(node, rpdo, FAULT_SHORT);
	if (len > rpdo->pdo.bytes)
		set_fault(node, rpdo, FAULT_LONG, detail);
	else
		clear_fault(node, rpdo, FAULT_LONG);
	return true;
}

static void receive(struct canopen_node *node, struct rpdo *rpdo, const struct can_msg *msg)
{
	bool synchronous = !pdo_event_driven(&rpdo->pdo);

	if (synchronous && !sync_window_open(node, msg)) {
		node->pdos.late++;
		return;
	}
	if (!length_fits(node, rpdo, msg->len))
		return;
	rpdo->monitored = *rpdo->pdo.event_ms != 0;
	rpdo->deadline_us = node->now_us + *rpdo->pdo.event_ms * 1000u;
	clear_fault(node, rpdo, FAULT_TIMEOUT);
	memcpy(rpdo->data, msg->data, rpdo->pdo.bytes);
	rpdo->waits = synchronous;
	if (!synchronous)
		write_values(node, rpdo);
}

void pdo_receive(struct canopen_node *node, const struct can_msg *msg)
{
	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	for (size_t i = 0; i < node->pdos.rpdo_count; i++) {
		struct rpdo *rpdo = &node->pdos.rpdo[i];

		if (rpdo->pdo.mapped_count && pdo_can_id(&rpdo->pdo) == msg->id)
			receive(node, rpdo, msg);
	}
}

/* Event timer (sub-index 5): the next PDO must be received within it. */
uint64_t rpdo_tick(struct canopen_node *node)
{
	uint64_t deadline_us = UINT64_MAX;

	for (size_t i = 0; i < node->pdos.rpdo_count; i++) {
		struct rpdo *rpdo = &node->pdos.rpdo[i];

		if (!rpdo->monitored)
			continue;
		if (node->now_us < rpdo->deadline_us) {
			deadline_us = earlier(deadline_us, rpdo->deadline_us);
			continue;
		}
		rpdo->monitored = false;
		set_fault(node, rpdo, FAULT_TIMEOUT, (const uint8_t[3]){0});
	}
	return deadline_us;
}

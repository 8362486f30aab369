/* Transmit PDOs (CiA 301, 7.2.2). A PDO is packed from the dictionary when it is sent. All PDOs of one SYNC are packed
 * within one call, so that they carry one sample. */
#include "gateway/canopen/pdo.h"

#include <math.h>
#include <string.h>

void tpdo_restart(struct canopen_node *node, struct tpdo *tpdo)
{
	tpdo->event = false;
	tpdo->await_start = true;
	tpdo->syncs = 0;
	tpdo->sampled_len = 0;
	tpdo->sent_before = false;
	tpdo->inhibited_until_us = 0;
	tpdo->timer_start_us = node->now_us;
}

static uint8_t pack(const struct canopen_node *node, const struct pdo *pdo, uint8_t data[PDO_BYTES])
{
	size_t len = 0;

	for (size_t i = 0; i < pdo->mapped_count; i++)
		len += od_get(node->od, pdo->mapped[i], data + len, PDO_BYTES - len);
	return (uint8_t)len;
}

static void transmit(struct canopen_node *node, struct tpdo *tpdo)
{
	uint8_t len = pack(node, &tpdo->pdo, tpdo->sent);

	node_send(node, pdo_can_id(&tpdo->pdo), tpdo->sent, len);
	node->pdos.sent++;
	tpdo->sent_before = true;
	tpdo->event = false;
	tpdo->timer_start_us = node->now_us;
	tpdo->inhibited_until_us = node->now_us + *tpdo->pdo.inhibit_100us * 100u;
}

/* ---- change of state --------------------------------------------------------------------------------------------- */

static double number(const struct od_entry *entry, const uint8_t *wire)
{
	uint32_t raw = entry->size == 1 ? wire[0] : entry->size == 2 ? get_u16(wire) : get_u32(wire);
	float real;

	switch ((enum od_type)entry->type) {
	case OD_REAL32:
		memcpy(&real, &raw, sizeof(real));
		return (double)real;
	case OD_INTEGER8:
		return (int8_t)raw;
	case OD_INTEGER16:
		return (int16_t)raw;
	case OD_INTEGER32:
		return (int32_t)raw;
	default:
		return raw;
	}
}

/* Of two values of one object; of one longer than 4 bytes, INFINITY where they differ. */
static double distance(const struct od_entry *entry, const uint8_t *a, const uint8_t *b)
{
	if (entry->size == 1 || entry->size == 2 || entry->size == 4)
		return fabs(number(entry, a) - number(entry, b));
	return memcmp(a, b, entry->size) ? INFINITY : 0;
}

/* With an event timer the PDO is periodic: samples are no events. */
static bool is_periodic(const struct tpdo *tpdo)
{
	return pdo_event_driven(&tpdo->pdo) && *tpdo->pdo.event_ms;
}

/* A sample is an event when a mapped value has changed by more than its threshold since the last transmission; without
 * any threshold every sample is, unless there is an event timer. */
static bool is_event(const struct canopen_node *node, const struct tpdo *tpdo)
{
	const struct canopen_device *device = &node->device;
	bool thresholds = false, changed = false;
	uint8_t data[PDO_BYTES];
	size_t at = 0;

	if (!tpdo->sent_before)
		return true;
	if (!device->change_threshold)
		return !is_periodic(tpdo);
	pack(node, &tpdo->pdo, data);
	for (size_t i = 0; i < tpdo->pdo.mapped_count; i++) {
		const struct od_entry *entry = tpdo->pdo.mapped[i];
		double threshold = device->change_threshold(device->ctx, entry);

		thresholds = thresholds || (threshold > 0 && threshold < INFINITY);
		changed = changed || distance(entry, data + at, tpdo->sent + at) > threshold;
		at += entry->size;
	}
	return thresholds ? changed : !is_periodic(tpdo);
}

static bool waits_for_event(const struct tpdo *tpdo)
{
	return tpdo->pdo.mapped_count && !tpdo->event &&
	       (pdo_event_driven(&tpdo->pdo) || *tpdo->pdo.type == TYPE_SYNC_ACYCLIC);
}

void pdo_sample(struct canopen_node *node)
{
	struct pdos *pdos = &node->pdos;

	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	for (size_t i = 0; i < pdos->tpdo_count; i++)
		if (waits_for_event(&pdos->tpdo[i]))
			pdos->tpdo[i].event = is_event(node, &pdos->tpdo[i]);
	tpdo_tick(node);
}

/* ---- SYNC -------------------------------------------------------------------------------------------------------- */

/* The SYNC with the start value (sub-index 6) is the first one that counts; without a counter, any SYNC is. */
static bool due_on_sync(struct tpdo *tpdo, uint8_t counter)
{
	const struct pdo *pdo = &tpdo->pdo;

	if (pdo->mapped_count == 0 || *pdo->type > TYPE_SYNC_MAX)
		return false;
	if (tpdo->await_start && counter && *pdo->sync_start && counter != *pdo->sync_start)
		return false;
	tpdo->await_start = false;
	if (*pdo->type == TYPE_SYNC_ACYCLIC)
		return tpdo->event;
	if (++tpdo->syncs < *pdo->type)
		return false;
	tpdo->syncs = 0;
	return true;
}

void tpdo_sync(struct canopen_node *node, uint8_t counter, bool late)
{
	uint32_t before = node->pdos.sent;

	for (size_t i = 0; i < node->pdos.tpdo_count; i++) {
		struct tpdo *tpdo = &node->pdos.tpdo[i];

		if (due_on_sync(tpdo, counter) && !late)
			transmit(node, tpdo);
		else if (*tpdo->pdo.type == TYPE_RTR_SYNC)
			tpdo->sampled_len = pack(node, &tpdo->pdo, tpdo->sampled);
	}
	node->pdos.answered += node->pdos.sent != before;
}

/* ---- RTR --------------------------------------------------------------------------------------------------------- */

static bool answers_rtr(const struct tpdo *tpdo)
{
	const struct pdo *pdo = &tpdo->pdo;

	return pdo->mapped_count && !(*pdo->cob_id & COB_ID_NO_RTR) && *pdo->type >= TYPE_RTR_SYNC;
}

static void request(struct canopen_node *node, struct tpdo *tpdo)
{
	if (pdo_event_driven(&tpdo->pdo))
		tpdo->event = true; /* sent by tpdo_tick(), after the inhibit time */
	else if (*tpdo->pdo.type == TYPE_RTR)
		transmit(node, tpdo);
	else if (tpdo->sampled_len)
		node_send(node, pdo_can_id(&tpdo->pdo), tpdo->sampled, tpdo->sampled_len);
}

void pdo_receive_remote(struct canopen_node *node, uint32_t id)
{
	struct pdos *pdos = &node->pdos;

	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	for (size_t i = 0; i < pdos->tpdo_count; i++)
		if (answers_rtr(&pdos->tpdo[i]) && pdo_can_id(&pdos->tpdo[i].pdo) == id)
			request(node, &pdos->tpdo[i]);
	tpdo_tick(node);
}

/* ---- time -------------------------------------------------------------------------------------------------------- */

static uint64_t timer_due_us(const struct tpdo *tpdo)
{
	return *tpdo->pdo.event_ms ? tpdo->timer_start_us + *tpdo->pdo.event_ms * 1000u : UINT64_MAX;
}

static uint64_t event_due_us(const struct tpdo *tpdo)
{
	return later(tpdo->event ? 0 : timer_due_us(tpdo), tpdo->inhibited_until_us);
}

static void transmit_event(struct canopen_node *node, struct tpdo *tpdo)
{
	uint64_t due_us = timer_due_us(tpdo), period_us = *tpdo->pdo.event_ms * 1000u;

	transmit(node, tpdo);
	/* keep the phase after a small delay */
	if (due_us <= node->now_us && node->now_us - due_us < period_us)
		tpdo->timer_start_us = due_us;
}

uint64_t tpdo_tick(struct canopen_node *node)
{
	uint64_t deadline = UINT64_MAX;

	for (size_t i = 0; i < node->pdos.tpdo_count; i++) {
		struct tpdo *tpdo = &node->pdos.tpdo[i];

		if (tpdo->pdo.mapped_count == 0 || !pdo_event_driven(&tpdo->pdo))
			continue;
		if (event_due_us(tpdo) <= node->now_us)
			transmit_event(node, tpdo);
		deadline = earlier(deadline, event_due_us(tpdo));
	}
	return deadline;
}

/* Transmit PDOs (CiA 301, 7.2.2): communication parameters 1800h.., mapping 1A00h... A PDO is packed from the
 * dictionary at the moment it is sent, and all PDOs of one SYNC in one go, so that they carry one sample. */
#include "gateway/canopen/service.h"

#include <errno.h>

enum {
	TYPE_SYNC_ACYCLIC = 0,
	TYPE_SYNC_MAX = 240,
	TYPE_RTR_SYNC = 252, /* sampled at the SYNC, sent on request */
	TYPE_RTR = 253,	     /* sampled and sent on request */
	TYPE_EVENT = 254,
	PDO_BYTES = 8,
};

static bool event_driven(const struct tpdo *tpdo)
{
	return *tpdo->type >= TYPE_EVENT;
}

/* ---- parameters -------------------------------------------------------------------------------------------------- */

static bool valid(const struct tpdo *tpdo)
{
	return !(*tpdo->cob_id & COB_ID_INVALID);
}

static bool type_supported(uint8_t type)
{
	return type <= TYPE_SYNC_MAX || type >= TYPE_RTR_SYNC;
}

/* One mapping entry: index << 16 | sub-index << 8 | bits. */
static enum od_status find_mapped(const struct od *od, uint32_t mapping, const struct od_entry **entry)
{
	*entry = od_find(od->table, (uint16_t)(mapping >> 16), (uint8_t)(mapping >> 8), NULL);
	if (!*entry)
		return OD_NO_OBJECT;
	if (!((*entry)->access & OD_TPDO) || (mapping & 0xFF) != (*entry)->size * 8u)
		return OD_NOT_MAPPABLE;
	return OD_OK;
}

static enum od_status find_mapping(
	const struct od *od, const struct tpdo *tpdo, size_t count, const struct od_entry *mapped[PDO_MAP_MAX])
{
	size_t bytes = 0;

	if (count > PDO_MAP_MAX)
		return OD_PDO_LENGTH;
	for (size_t i = 0; i < count; i++) {
		enum od_status status = find_mapped(od, *tpdo->map[i], &mapped[i]);
		if (status != OD_OK)
			return status;
		bytes += mapped[i]->size;
	}
	return bytes > PDO_BYTES ? OD_PDO_LENGTH : OD_OK;
}

/* Whether the PDO could be valid with what stands in the dictionary. */
static enum od_status check(const struct od *od, const struct tpdo *tpdo, uint32_t cob_id)
{
	const struct od_entry *mapped[PDO_MAP_MAX];

	if (!cob_id_usable(cob_id) || !type_supported(*tpdo->type))
		return OD_BAD_VALUE;
	return find_mapping(od, tpdo, *tpdo->map_count, mapped);
}

static void restart(struct canopen_node *node, struct tpdo *tpdo)
{
	tpdo->mapped_count = 0;
	if (valid(tpdo) && find_mapping(node->od, tpdo, *tpdo->map_count, tpdo->mapped) == OD_OK)
		tpdo->mapped_count = *tpdo->map_count;
	tpdo->event = false;
	tpdo->await_start = true;
	tpdo->syncs = 0;
	tpdo->sampled_len = 0;
	tpdo->inhibited_until_us = 0;
	tpdo->timer_start_us = node->now_us;
}

static struct tpdo *of_entry(struct canopen_node *node, const struct od_entry *entry)
{
	for (size_t i = 0; i < node->pdo.tpdo_count; i++)
		if ((node->pdo.tpdo[i].index & 0x1FF) == (entry->index & 0x1FF))
			return &node->pdo.tpdo[i];
	return NULL;
}

static enum od_status before_cob_id(const struct od *od, const struct tpdo *tpdo, uint32_t value)
{
	if (value & ~(COB_ID_INVALID | COB_ID_NO_RTR | COB_ID_MASK))
		return OD_BAD_VALUE;
	if (value & COB_ID_INVALID)
		return OD_OK;
	if (valid(tpdo))
		return (value ^ *tpdo->cob_id) & COB_ID_MASK ? OD_BAD_VALUE : OD_OK;
	return check(od, tpdo, value);
}

static enum od_status before_communication(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct canopen_node *node = ctx;
	const struct tpdo *tpdo = of_entry(node, entry);
	const uint8_t *bytes = wire;

	(void)size;
	if (!tpdo)
		return OD_OK;
	switch (entry->sub) {
	case 1:
		return before_cob_id(node->od, tpdo, get_u32(bytes));
	case 2:
		return type_supported(bytes[0]) ? OD_OK : OD_BAD_VALUE;
	case 3:
		return valid(tpdo) && get_u16(bytes) != *tpdo->inhibit_100us ? OD_BAD_VALUE : OD_OK;
	case 6:
		return bytes[0] > TYPE_SYNC_MAX || (valid(tpdo) && bytes[0] != *tpdo->sync_start) ? OD_BAD_VALUE
												  : OD_OK;
	default:
		return OD_OK;
	}
}

/* The mapping procedure (CiA 301, 7.5.2.38): PDO invalid, sub-index 0 = 0, entries, sub-index 0 = number of them. An
 * entry of 0 is an empty place, as masters write it. */
static enum od_status before_mapping(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct canopen_node *node = ctx;
	const struct tpdo *tpdo = of_entry(node, entry);
	const struct od_entry *mapped[PDO_MAP_MAX];
	uint32_t mapping;

	(void)size;
	if (!tpdo)
		return OD_OK;
	if (valid(tpdo))
		return OD_UNSUPPORTED_ACCESS;
	if (entry->sub == 0)
		return find_mapping(node->od, tpdo, *(const uint8_t *)wire, mapped);
	if (*tpdo->map_count != 0)
		return OD_UNSUPPORTED_ACCESS;
	mapping = get_u32(wire);
	return mapping ? find_mapped(node->od, mapping, &mapped[0]) : OD_OK;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	struct tpdo *tpdo = of_entry(ctx, entry);

	/* the event timer may change while it runs */
	if (!tpdo || (entry->index == tpdo->index && entry->sub == 5))
		return;
	restart(ctx, tpdo);
	node_filter(ctx);
}

static void look_up(struct canopen_node *node, struct tpdo *tpdo, uint16_t index)
{
	uint16_t mapping = (uint16_t)(index + 0x200);

	tpdo->index = index;
	tpdo->cob_id = od_value(node->od, index, 1, sizeof(uint32_t));
	tpdo->type = node_value(node, index, 2, sizeof(uint8_t));
	tpdo->inhibit_100us = node_value(node, index, 3, sizeof(uint16_t));
	tpdo->event_ms = node_value(node, index, 5, sizeof(uint16_t));
	tpdo->sync_start = node_value(node, index, 6, sizeof(uint8_t));
	tpdo->map_count = node_value(node, mapping, 0, sizeof(uint8_t));
	for (uint8_t i = 0; i < PDO_MAP_MAX; i++)
		tpdo->map[i] = node_value(node, mapping, (uint8_t)(i + 1), sizeof(uint32_t));
}

int pdo_init(struct canopen_node *node)
{
	struct pdo *pdo = &node->pdo;

	for (uint16_t index = 0x1800; index < 0x1A00; index++) {
		if (!od_value(node->od, index, 1, sizeof(uint32_t)))
			continue;
		if (pdo->tpdo_count == TPDO_MAX)
			return -ENOSPC;
		look_up(node, &pdo->tpdo[pdo->tpdo_count++], index);
	}
	pdo->communication_hook = (struct od_hook){
		.first = 0x1800, .last = 0x19FF, .before = before_communication, .after = after_write, .ctx = node};
	pdo->mapping_hook = (struct od_hook){
		.first = 0x1A00, .last = 0x1BFF, .before = before_mapping, .after = after_write, .ctx = node};
	od_attach(node->od, &pdo->communication_hook);
	od_attach(node->od, &pdo->mapping_hook);
	return 0;
}

/* Stored values did not pass the hooks. A PDO that cannot be as they say is invalid, for all to see in its COB-ID. */
void pdo_reset(struct canopen_node *node)
{
	for (size_t i = 0; i < node->pdo.tpdo_count; i++) {
		struct tpdo *tpdo = &node->pdo.tpdo[i];

		if (valid(tpdo) && check(node->od, tpdo, *tpdo->cob_id) != OD_OK) {
			*tpdo->cob_id |= COB_ID_INVALID;
			node_bad_data(node, tpdo->index);
		}
	}
}

/* ---- transmission ------------------------------------------------------------------------------------------------ */

static uint8_t pack(const struct canopen_node *node, const struct tpdo *tpdo, uint8_t data[PDO_BYTES])
{
	size_t len = 0;

	for (size_t i = 0; i < tpdo->mapped_count; i++)
		len += od_get(node->od, tpdo->mapped[i], data + len, PDO_BYTES - len);
	return (uint8_t)len;
}

static void transmit(struct canopen_node *node, struct tpdo *tpdo)
{
	uint8_t data[PDO_BYTES];
	uint8_t len = pack(node, tpdo, data);

	node_send(node, *tpdo->cob_id & COB_ID_MASK, data, len);
	tpdo->event = false;
	tpdo->timer_start_us = node->now_us;
	tpdo->inhibited_until_us = node->now_us + *tpdo->inhibit_100us * 100u;
}

void pdo_start(struct canopen_node *node)
{
	for (size_t i = 0; i < node->pdo.tpdo_count; i++)
		restart(node, &node->pdo.tpdo[i]);
}

void pdo_sample(struct canopen_node *node)
{
	for (size_t i = 0; i < node->pdo.tpdo_count; i++)
		node->pdo.tpdo[i].event = true;
	pdo_tick(node);
}

/* The SYNC with the start value counts as the first one received; without a counter every PDO has started. */
static bool due_on_sync(struct tpdo *tpdo, uint8_t counter)
{
	if (tpdo->mapped_count == 0 || *tpdo->type > TYPE_SYNC_MAX)
		return false;
	if (tpdo->await_start && counter && *tpdo->sync_start && counter != *tpdo->sync_start)
		return false;
	tpdo->await_start = false;
	if (*tpdo->type == TYPE_SYNC_ACYCLIC)
		return tpdo->event;
	if (++tpdo->syncs < *tpdo->type)
		return false;
	tpdo->syncs = 0;
	return true;
}

void pdo_sync(struct canopen_node *node, uint8_t counter, bool late)
{
	for (size_t i = 0; i < node->pdo.tpdo_count; i++) {
		struct tpdo *tpdo = &node->pdo.tpdo[i];

		if (due_on_sync(tpdo, counter) && !late)
			transmit(node, tpdo);
		else if (*tpdo->type == TYPE_RTR_SYNC)
			tpdo->sampled_len = pack(node, tpdo, tpdo->sampled);
	}
}

static bool answers_rtr(const struct tpdo *tpdo)
{
	return tpdo->mapped_count && !(*tpdo->cob_id & COB_ID_NO_RTR) && *tpdo->type >= TYPE_RTR_SYNC;
}

size_t pdo_remote_ids(const struct canopen_node *node, uint32_t ids[TPDO_MAX])
{
	size_t n = 0;

	for (size_t i = 0; i < node->pdo.tpdo_count; i++)
		if (answers_rtr(&node->pdo.tpdo[i]))
			ids[n++] = *node->pdo.tpdo[i].cob_id & COB_ID_MASK;
	return n;
}

static void request(struct canopen_node *node, struct tpdo *tpdo)
{
	if (*tpdo->type >= TYPE_EVENT)
		tpdo->event = true; /* which waits for the inhibit time */
	else if (*tpdo->type == TYPE_RTR)
		transmit(node, tpdo);
	else if (tpdo->sampled_len)
		node_send(node, *tpdo->cob_id & COB_ID_MASK, tpdo->sampled, tpdo->sampled_len);
}

void pdo_receive_remote(struct canopen_node *node, uint32_t id)
{
	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	for (size_t i = 0; i < node->pdo.tpdo_count; i++)
		if (answers_rtr(&node->pdo.tpdo[i]) && (*node->pdo.tpdo[i].cob_id & COB_ID_MASK) == id)
			request(node, &node->pdo.tpdo[i]);
	pdo_tick(node);
}

static uint64_t event_due_us(const struct tpdo *tpdo)
{
	if (tpdo->event)
		return tpdo->inhibited_until_us;
	if (*tpdo->event_ms)
		return later(tpdo->timer_start_us + *tpdo->event_ms * 1000u, tpdo->inhibited_until_us);
	return UINT64_MAX;
}

uint64_t pdo_tick(struct canopen_node *node)
{
	uint64_t deadline = UINT64_MAX;

	if (node->nmt.state != NMT_OPERATIONAL)
		return deadline;
	for (size_t i = 0; i < node->pdo.tpdo_count; i++) {
		struct tpdo *tpdo = &node->pdo.tpdo[i];

		if (tpdo->mapped_count == 0 || !event_driven(tpdo))
			continue;
		if (event_due_us(tpdo) <= node->now_us)
			transmit(node, tpdo);
		deadline = earlier(deadline, event_due_us(tpdo));
	}
	return deadline;
}

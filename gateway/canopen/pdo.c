/* What RPDOs and TPDOs have in common (CiA 301, 7.2.2 and 7.5.2.35 to 7.5.2.38): communication parameters (1400h,
 * 1800h), mapping (1600h, 1A00h), and the checks of writes to both. */
#include "gateway/canopen/pdo.h"

#include <errno.h>

/* ---- parameters -------------------------------------------------------------------------------------------------- */

static bool receives(const struct pdo *pdo)
{
	return pdo->index < PDO_FIRST_TPDO;
}

static bool valid(const struct pdo *pdo)
{
	return !(*pdo->cob_id & COB_ID_INVALID);
}

static bool type_supported(const struct pdo *pdo, uint8_t type)
{
	return type <= TYPE_SYNC_MAX || type >= (receives(pdo) ? TYPE_EVENT : TYPE_RTR_SYNC);
}

/* The data types that [DummyUsage] of the EDS allows: INTEGER8 to UNSIGNED32. */
static const struct od_entry *find_dummy(uint32_t mapping)
{
	static const struct od_entry dummies[] = {{.index = OD_INTEGER8, .size = 1}, {.index = OD_INTEGER16, .size = 2},
		{.index = OD_INTEGER32, .size = 4}, {.index = OD_UNSIGNED8, .size = 1},
		{.index = OD_UNSIGNED16, .size = 2}, {.index = OD_UNSIGNED32, .size = 4}};

	for (size_t i = 0; i < sizeof(dummies) / sizeof(dummies[0]); i++)
		if (mapping >> 8 == (uint32_t)dummies[i].index << 8)
			return &dummies[i];
	return NULL;
}

/* One mapping entry: index << 16 | sub-index << 8 | bits. */
static enum od_status find_mapped(
	const struct od *od, const struct pdo *pdo, uint32_t mapping, const struct od_entry **entry)
{
	const struct od_entry *dummy = receives(pdo) ? find_dummy(mapping) : NULL;

	*entry = dummy ? dummy : od_find(od->table, (uint16_t)(mapping >> 16), (uint8_t)(mapping >> 8), NULL);
	if (!*entry)
		return OD_NO_OBJECT;
	if (!dummy && !((*entry)->access & (receives(pdo) ? OD_RPDO : OD_TPDO)))
		return OD_NOT_MAPPABLE;
	return (mapping & 0xFF) == (*entry)->size * 8u ? OD_OK : OD_NOT_MAPPABLE;
}

/* Looks up the first `count` mapping entries and sums up their bytes. */
static enum od_status find_mapping(const struct od *od, const struct pdo *pdo, size_t count,
	const struct od_entry *mapped[PDO_MAP_MAX], size_t *bytes)
{
	*bytes = 0;
	if (count > PDO_MAP_MAX)
		return OD_PDO_LENGTH;
	for (size_t i = 0; i < count; i++) {
		enum od_status status = find_mapped(od, pdo, *pdo->map[i], &mapped[i]);
		if (status != OD_OK)
			return status;
		*bytes += mapped[i]->size;
	}
	return *bytes > PDO_BYTES ? OD_PDO_LENGTH : OD_OK;
}

/* Whether the PDO may become valid with its parameters in the dictionary. */
static enum od_status check(const struct od *od, const struct pdo *pdo, uint32_t cob_id)
{
	const struct od_entry *mapped[PDO_MAP_MAX];
	size_t bytes;

	if (!cob_id_usable(cob_id) || !type_supported(pdo, *pdo->type))
		return OD_BAD_VALUE;
	return find_mapping(od, pdo, *pdo->map_count, mapped, &bytes);
}

static void restart(struct canopen_node *node, struct pdo *pdo)
{
	size_t bytes;

	pdo->mapped_count = pdo->bytes = 0;
	if (valid(pdo) && find_mapping(node->od, pdo, *pdo->map_count, pdo->mapped, &bytes) == OD_OK) {
		pdo->mapped_count = *pdo->map_count;
		pdo->bytes = (uint8_t)bytes;
	}
	if (receives(pdo))
		rpdo_restart(node, (struct rpdo *)pdo);
	else
		tpdo_restart(node, (struct tpdo *)pdo);
}

/* RPDOs first, then TPDOs; NULL after the last one. */
static struct pdo *nth(struct canopen_node *node, size_t n)
{
	struct pdos *pdos = &node->pdos;

	if (n < pdos->rpdo_count)
		return &pdos->rpdo[n].pdo;
	n -= pdos->rpdo_count;
	return n < pdos->tpdo_count ? &pdos->tpdo[n].pdo : NULL;
}

static struct pdo *of_entry(struct canopen_node *node, const struct od_entry *entry)
{
	struct pdo *pdo;

	for (size_t i = 0; (pdo = nth(node, i)); i++)
		if (pdo->index == (entry->index & ~PDO_MAPPING))
			return pdo;
	return NULL;
}

static enum od_status before_cob_id(const struct od *od, const struct pdo *pdo, uint32_t value)
{
	if (value & ~(COB_ID_INVALID | COB_ID_NO_RTR | COB_ID_MASK))
		return OD_BAD_VALUE;
	if (value & COB_ID_INVALID)
		return OD_OK;
	if (valid(pdo))
		return (value ^ *pdo->cob_id) & COB_ID_MASK ? OD_BAD_VALUE : OD_OK;
	return check(od, pdo, value);
}

/* Only TPDOs have sub-indices 3 and 6. */
static enum od_status before_communication(
	const struct od *od, const struct pdo *pdo, uint8_t sub, const uint8_t *bytes)
{
	switch (sub) {
	case 1:
		return before_cob_id(od, pdo, get_u32(bytes));
	case 2:
		return type_supported(pdo, bytes[0]) ? OD_OK : OD_BAD_VALUE;
	case 3:
		return valid(pdo) && get_u16(bytes) != *pdo->inhibit_100us ? OD_BAD_VALUE : OD_OK;
	case 6:
		return bytes[0] > TYPE_SYNC_MAX || (valid(pdo) && bytes[0] != *pdo->sync_start) ? OD_BAD_VALUE : OD_OK;
	default:
		return OD_OK;
	}
}

/* The mapping procedure (CiA 301, 7.5.2.36 and 7.5.2.38): PDO invalid, sub-index 0 = 0, the entries, sub-index 0 =
 * their number. Masters write 0 to entries that they do not use, so 0 is accepted. */
static enum od_status before_mapping(const struct od *od, const struct pdo *pdo, uint8_t sub, const uint8_t *bytes)
{
	const struct od_entry *mapped[PDO_MAP_MAX];
	size_t length;

	if (valid(pdo))
		return OD_UNSUPPORTED_ACCESS;
	if (sub == 0)
		return find_mapping(od, pdo, bytes[0], mapped, &length);
	if (*pdo->map_count != 0)
		return OD_UNSUPPORTED_ACCESS;
	return get_u32(bytes) ? find_mapped(od, pdo, get_u32(bytes), &mapped[0]) : OD_OK;
}

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct canopen_node *node = ctx;
	const struct pdo *pdo = of_entry(node, entry);
	enum od_status status;

	(void)size;
	if (!pdo)
		return OD_OK;
	if (entry->index & PDO_MAPPING)
		return before_mapping(node->od, pdo, entry->sub, wire);
	status = before_communication(node->od, pdo, entry->sub, wire);
	if (status == OD_OK && entry->sub == 1 && !(get_u32(wire) & COB_ID_INVALID) &&
		sdo_server_uses(node, get_u32(wire)))
		return OD_INCOMPATIBLE;
	return status;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	struct canopen_node *node = ctx;
	struct pdo *pdo = of_entry(node, entry);

	if (!pdo)
		return;
	if (entry->index == pdo->index && entry->sub == 5) { /* may be written while the PDO is valid */
		if (receives(pdo))
			rpdo_stop_timer(node, (struct rpdo *)pdo);
		return;
	}
	restart(node, pdo);
	node_filter(node);
}

static void look_up(struct canopen_node *node, struct pdo *pdo, uint16_t index)
{
	uint16_t mapping = index | PDO_MAPPING;

	pdo->index = index;
	pdo->cob_id = od_value(node->od, index, 1, sizeof(uint32_t));
	pdo->type = node_value(node, index, 2, sizeof(uint8_t));
	pdo->inhibit_100us = node_value(node, index, 3, sizeof(uint16_t));
	pdo->event_ms = node_value(node, index, 5, sizeof(uint16_t));
	pdo->sync_start = node_value(node, index, 6, sizeof(uint8_t));
	pdo->map_count = node_value(node, mapping, 0, sizeof(uint8_t));
	for (uint8_t i = 0; i < PDO_MAP_MAX; i++)
		pdo->map[i] = node_value(node, mapping, (uint8_t)(i + 1), sizeof(uint32_t));
}

int pdo_init(struct canopen_node *node)
{
	struct pdos *pdos = &node->pdos;

	for (uint16_t i = 0; i < PDO_INDICES; i++) {
		uint16_t rpdo = (uint16_t)(PDO_FIRST_RPDO + i), tpdo = (uint16_t)(PDO_FIRST_TPDO + i);

		if (od_value(node->od, rpdo, 1, sizeof(uint32_t))) {
			if (pdos->rpdo_count == RPDO_MAX)
				return -ENOSPC;
			look_up(node, &pdos->rpdo[pdos->rpdo_count++].pdo, rpdo);
		}
		if (od_value(node->od, tpdo, 1, sizeof(uint32_t))) {
			if (pdos->tpdo_count == TPDO_MAX)
				return -ENOSPC;
			look_up(node, &pdos->tpdo[pdos->tpdo_count++].pdo, tpdo);
		}
	}
	pdos->hook = (struct od_hook){.first = PDO_FIRST_RPDO,
		.last = PDO_LAST_OBJECT,
		.before = before_write,
		.after = after_write,
		.ctx = node};
	od_attach(node->od, &pdos->hook);
	return 0;
}

/* Stored values did not pass the hooks. A PDO with unusable parameters is made invalid in its COB-ID, where a master
 * can read it. */
void pdo_reset(struct canopen_node *node)
{
	struct pdo *pdo;

	for (size_t i = 0; (pdo = nth(node, i)); i++) {
		if (valid(pdo) && check(node->od, pdo, *pdo->cob_id) != OD_OK) {
			*pdo->cob_id |= COB_ID_INVALID;
			node_bad_data(node, pdo->index);
		}
		restart(node, pdo);
	}
}

void canopen_restored(struct canopen_node *node)
{
	struct pdo *pdo;
	size_t bytes;

	for (size_t i = 0; (pdo = nth(node, i)); i++)
		(void)find_mapping(node->od, pdo, pdo->mapped_count, pdo->mapped, &bytes);
}

/* ---- operation --------------------------------------------------------------------------------------------------- */

void pdo_start(struct canopen_node *node)
{
	struct pdo *pdo;

	for (size_t i = 0; (pdo = nth(node, i)); i++)
		restart(node, pdo);
}

/* TPDOs first: they carry the values as they were at the SYNC, before the RPDOs of the last cycle are applied. */
void pdo_sync(struct canopen_node *node, uint8_t counter, bool late)
{
	tpdo_sync(node, counter, late);
	rpdo_sync(node);
}

uint64_t pdo_tick(struct canopen_node *node)
{
	if (node->nmt.state != NMT_OPERATIONAL)
		return UINT64_MAX;
	return earlier(rpdo_tick(node), tpdo_tick(node));
}

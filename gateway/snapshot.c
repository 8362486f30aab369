#include "gateway/snapshot.h"

#include <assert.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"
#include "od_index.h"

#define COB_ID_FOLLOWS (1u << 29) /* the node-ID is to be added */
#define COB_ID_FLAGS   (COB_ID_INVALID | COB_ID_NO_RTR)

/* The order of the writes. */
enum phase { SWITCH_OFF, SET, SET_COUNT, SWITCH_ON, SET_DATE, PHASES };

static bool is_configuration(const struct od_entry *entry)
{
	return (entry->access & OD_STORED) && (entry->access & OD_WRITE);
}

static bool is_cob_id(const struct od_entry *entry)
{
	if (entry->size != sizeof(uint32_t))
		return false;
	return entry->index == OD_INDEX_COB_ID_EMCY || entry->index == OD_INDEX_SECOND_SDO_SERVER_PARAMETER ||
	       (is_pdo_communication(entry->index) && entry->sub == 1);
}

static bool is_sync(uint16_t index)
{
	return index == OD_INDEX_COB_ID_SYNC || index == OD_INDEX_COMMUNICATION_CYCLE_PERIOD;
}

static enum phase phase_of(const struct od_entry *entry)
{
	if (is_cob_id(entry) || is_sync(entry->index) || entry->index == OD_INDEX_CONSUMER_HEARTBEAT_TIME)
		return SWITCH_ON;
	if (is_pdo_mapping(entry->index) && entry->sub == 0)
		return SET_COUNT;
	return entry->index == OD_INDEX_VERIFY_CONFIGURATION ? SET_DATE : SET;
}

static bool is_switched_off_first(const struct od_entry *entry)
{
	enum phase phase = phase_of(entry);

	return phase == SWITCH_ON || phase == SET_COUNT;
}

/* ---- upload ------------------------------------------------------------------------------------------------------ */

static uint32_t value_u32(const struct od *od, const struct od_entry *entry)
{
	uint8_t wire[sizeof(uint32_t)];

	return od_get(od, entry, wire, sizeof(wire)) == sizeof(wire) ? get_u32(wire) : 0;
}

/* The value that disables it: a COB-ID marked invalid, SYNC not produced, no period, consumer or mapping. */
static void off_value(const struct od *od, const struct od_entry *entry, uint8_t wire[sizeof(uint32_t)])
{
	if (entry->index == OD_INDEX_COB_ID_SYNC)
		put_u32(wire, value_u32(od, entry) & ~COB_ID_PRODUCES);
	else
		put_u32(wire, is_cob_id(entry) ? COB_ID_INVALID : 0);
}

static uint32_t without_node_id(const struct od *od, const struct od_entry *entry, uint32_t value, uint8_t node_id)
{
	uint32_t base;

	memcpy(&base, (const uint8_t *)od->table->defaults + entry->offset, sizeof(base));
	if ((value & COB_ID_MASK) != ((base + node_id) & COB_ID_MASK))
		return value;
	return (value & COB_ID_FLAGS) | (base & COB_ID_MASK) | COB_ID_FOLLOWS;
}

static size_t value_of(const struct od *od, uint8_t node_id, const struct od_entry *entry, uint8_t wire[OD_VALUE_MAX])
{
	size_t size = od_get(od, entry, wire, OD_VALUE_MAX);

	if ((entry->access & OD_NODE_ID) && is_cob_id(entry))
		put_u32(wire, without_node_id(od, entry, get_u32(wire), node_id));
	return size;
}

/* Entries of a mapping beyond its count are not in use. */
static bool is_in_use(const struct od *od, const struct od_entry *entry)
{
	const uint8_t *count;

	if (!is_pdo_mapping(entry->index) || entry->sub == 0)
		return true;
	count = od_value(od, entry->index, 0, sizeof(*count));
	return !count || entry->sub <= *count;
}

size_t snapshot_encode(const struct od *od, uint8_t node_id, uint8_t *out)
{
	size_t used = 0;
	bool fits = true;

	for (enum phase phase = SWITCH_OFF; phase < PHASES; phase++) {
		for (size_t i = 0; i < od->table->count; i++) {
			const struct od_entry *entry = &od->table->entries[i];
			uint8_t wire[OD_VALUE_MAX];
			struct od_dcf_item item = {entry->index, entry->sub, wire, entry->size};

			if (!is_configuration(entry) || !is_in_use(od, entry))
				continue;
			if (phase == SWITCH_OFF && is_switched_off_first(entry))
				off_value(od, entry, wire);
			else if (phase == phase_of(entry))
				item.size = value_of(od, node_id, entry, wire);
			else
				continue;
			fits = fits && od_dcf_add(out, OD_DOMAIN_MAX, &used, &item);
		}
	}
	assert(fits); /* else the EDS has outgrown OD_DOMAIN_MAX */
	return used;
}

static size_t read_snapshot(void *ctx, uint8_t *out)
{
	const struct snapshot *s = ctx;

	return snapshot_encode(s->od, *s->node_id, out);
}

/* ---- download ---------------------------------------------------------------------------------------------------- */

struct item {
	struct od_dcf_item dcf;
	const struct od_entry *entry;
	uint8_t wire[sizeof(uint32_t)]; /* replaces dcf.data for a COB-ID that contains the node-ID */
};

static bool next(const struct snapshot *s, const uint8_t *in, size_t size, size_t *used, struct item *item)
{
	if (!od_dcf_next(in, size, used, &item->dcf))
		return false;
	item->entry = od_find(s->od->table, item->dcf.index, item->dcf.sub, NULL);
	if (!item->entry || !(item->entry->access & OD_NODE_ID) || item->dcf.size != sizeof(uint32_t))
		return true;
	uint32_t value = get_u32(item->dcf.data);
	if (value & COB_ID_FOLLOWS) {
		put_u32(item->wire, (value & ~COB_ID_FOLLOWS) + *s->node_id);
		item->dcf.data = item->wire;
	}
	return true;
}

static enum od_status check_item(const struct snapshot *s, const struct item *item)
{
	enum od_status status;

	if (!od_find(s->od->table, item->dcf.index, item->dcf.sub, &status))
		return status;
	if (!(item->entry->access & OD_WRITE))
		return OD_READ_ONLY;
	return is_configuration(item->entry) ? od_check(item->entry, item->dcf.data, item->dcf.size)
					     : OD_UNSUPPORTED_ACCESS;
}

/* CiA 301 allows no new identifier while SYNC is produced, and the old identifier is not known to the client. */
static void stop_sync(const struct snapshot *s, const struct item *item)
{
	uint8_t wire[sizeof(uint32_t)];

	if (item->dcf.index != OD_INDEX_COB_ID_SYNC)
		return;
	off_value(s->od, item->entry, wire);
	od_write(s->od, OD_INDEX_COB_ID_SYNC, 0, wire, sizeof(wire));
}

static enum od_status apply(struct snapshot *s, const uint8_t *in, size_t size, struct item *item)
{
	size_t used = 0;

	while (next(s, in, size, &used, item)) {
		stop_sync(s, item);
		enum od_status status = od_write(s->od, item->dcf.index, item->dcf.sub, item->dcf.data, item->dcf.size);
		if (status != OD_OK)
			return status;
	}
	item->dcf = (struct od_dcf_item){0};
	return s->apply(s->ctx) ? OD_OK : OD_INCOMPATIBLE;
}

static enum od_status check(const struct snapshot *s, const uint8_t *in, size_t size, struct item *item)
{
	size_t used = 0;

	if (!od_dcf_valid(in, size))
		return OD_INCOMPATIBLE;
	while (next(s, in, size, &used, item)) {
		enum od_status status = check_item(s, item);
		if (status != OD_OK)
			return status;
	}
	return OD_OK;
}

/* Restores the previous configuration, also values that no client could have written. */
static void roll_back(struct snapshot *s, size_t size)
{
	struct item item;
	size_t used = 0;

	while (next(s, s->before, size, &used, &item)) {
		stop_sync(s, &item);
		if (od_write(s->od, item.dcf.index, item.dcf.sub, item.dcf.data, item.dcf.size) != OD_OK)
			od_put(s->od, item.entry, item.dcf.data, item.dcf.size);
	}
	s->apply(s->ctx);
}

/* All or nothing. */
static enum od_status write_snapshot(void *ctx, const uint8_t *in, size_t size)
{
	struct snapshot *s = ctx;
	struct item item = {0};
	enum od_status status = check(s, in, size, &item);

	if (status == OD_OK) {
		size_t before = snapshot_encode(s->od, *s->node_id, s->before);

		status = apply(s, in, size, &item);
		if (status != OD_OK)
			roll_back(s, before);
	}
	s->done(s->ctx, status, status == OD_OK ? get_u32(in) : 0, item.dcf.index, item.dcf.sub);
	return status;
}

void snapshot_attach(struct snapshot *s)
{
	s->domain = (struct od_domain){
		.index = OD_INDEX_CONFIGURATION_SNAPSHOT, .read = read_snapshot, .write = write_snapshot, .ctx = s};
	od_set_domain(s->od, &s->domain);
}

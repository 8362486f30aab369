/* How a configuration gets into a node: the values that differ, in the order and by the procedures of CiA 301. */
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"
#include "od_index.h"
#include "tools/lib/settings.h"

static const struct setting *find_setting(const struct settings *settings, unsigned int index, unsigned int sub)
{
	for (size_t i = settings->count; i-- > 0;) /* the last one is valid */
		if (settings->list[i].entry->index == index && settings->list[i].entry->sub == sub)
			return &settings->list[i];
	return NULL;
}

static bool has_settings(const struct settings *settings, unsigned int index)
{
	for (size_t i = 0; i < settings->count; i++)
		if (settings->list[i].entry->index == index)
			return true;
	return false;
}

/* Room for one more element. */
static bool grow(struct settings_plan *plan, void *array, size_t count, size_t *room, size_t element)
{
	void **elements = array;
	size_t wanted = *room ? 2 * *room : 64;

	if (count < *room)
		return true;
	void *larger = realloc(*elements, wanted * element);
	if (!larger) {
		plan->out_of_memory = true;
		return false;
	}
	*elements = larger;
	*room = wanted;
	return true;
}

/* ---- reads ------------------------------------------------------------------------------------------------------- */

static struct settings_read *find_read(const struct settings_plan *plan, const struct od_entry *entry)
{
	for (size_t i = 0; i < plan->read_count; i++)
		if (plan->reads[i].entry == entry)
			return &plan->reads[i];
	return NULL;
}

static void add_read(struct settings_plan *plan, const struct od_entry *entry, bool needed)
{
	struct settings_read *read = entry ? find_read(plan, entry) : NULL;

	if (!entry)
		return;
	if (!read) {
		if (!grow(plan, &plan->reads, plan->read_count, &plan->read_room, sizeof(*plan->reads)))
			return;
		read = &plan->reads[plan->read_count++];
		*read = (struct settings_read){.entry = entry};
	}
	read->needed |= needed;
}

/* An object whose old value decides how it is written. */
static bool is_guarded(uint16_t index)
{
	return index == OD_INDEX_COB_ID_SYNC || index == OD_INDEX_COB_ID_EMCY ||
	       index == OD_INDEX_SECOND_SDO_SERVER_PARAMETER;
}

bool settings_plan_reads(struct settings_plan *plan, const struct settings *settings)
{
	const struct od_table *table = settings->table;

	plan->settings = settings;
	for (size_t i = 0; i < settings->count; i++) {
		const struct od_entry *entry = settings->list[i].entry;
		uint16_t index = entry->index;

		add_read(plan, entry, is_guarded(index));
		if (index == OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE)
			add_read(plan, od_find(table, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0, NULL), true);
		if (is_pdo_object(index))
			add_read(plan, od_find(table, (uint16_t)(index & ~PDO_MAPPING), 1, NULL), true);
		if (is_pdo_mapping(index))
			add_read(plan, od_find(table, index, 0, NULL), true);
	}
	return !plan->out_of_memory;
}

static bool is_same(const struct settings_plan *plan, const struct setting *setting)
{
	const struct settings_read *read = find_read(plan, setting->entry);

	return read && read->done && read->size == setting->size &&
	       memcmp(read->wire, setting->wire, setting->size) == 0;
}

/* False: it could not be read. */
static bool old_value(const struct settings_plan *plan, const struct od_entry *entry, uint32_t *value)
{
	const struct settings_read *read = find_read(plan, entry);

	if (!read || !read->done)
		return false;
	*value = (uint32_t)get_uint(read->wire, read->size < 4 ? read->size : 4);
	return true;
}

/* ---- writes ------------------------------------------------------------------------------------------------------ */

static struct settings_write *add_write(
	struct settings_plan *plan, const struct od_entry *entry, const void *wire, size_t size)
{
	static struct settings_write nowhere;

	if (!grow(plan, &plan->writes, plan->write_count, &plan->write_room, sizeof(*plan->writes)))
		return &nowhere;
	struct settings_write *write = &plan->writes[plan->write_count++];
	*write = (struct settings_write){.entry = entry, .size = size, .group = plan->group};
	memcpy(write->wire, wire, size);
	return write;
}

static struct settings_write *add_u32(struct settings_plan *plan, const struct od_entry *entry, uint32_t value)
{
	uint8_t wire[4];

	put_u32(wire, value);
	return add_write(plan, entry, wire, sizeof(wire));
}

static struct settings_write *add_setting(struct settings_plan *plan, const struct setting *setting)
{
	return add_write(plan, setting->entry, setting->wire, setting->size);
}

/* The CAN-ID of a valid EMCY COB-ID must not be changed (CiA 301, 7.5.2.17), so it is made invalid first. The same
 * applies to the second SDO server. */
static void write_switched_off(struct settings_plan *plan, const struct setting *setting)
{
	uint32_t old;

	if (!old_value(plan, setting->entry, &old))
		return;
	add_u32(plan, setting->entry, old | COB_ID_INVALID);
	add_setting(plan, setting)->counts = 1;
	add_u32(plan, setting->entry, old)->when = SETTINGS_AFTER_FAILURE;
}

/* The CAN-ID of SYNC must not be changed while the node produces it (CiA 301, 7.5.2.5). */
static void write_sync(struct settings_plan *plan, const struct setting *setting)
{
	uint32_t old;

	if (!old_value(plan, setting->entry, &old))
		return;
	if (old & COB_ID_PRODUCES)
		add_u32(plan, setting->entry, old & ~COB_ID_PRODUCES);
	add_setting(plan, setting)->counts = 1;
}

/* The counter overflow value must not be changed while there is a period (CiA 301, 7.5.2.22). The period already has
 * its new value. */
static void write_sync_counter(struct settings_plan *plan, const struct setting *setting)
{
	const struct od_entry *entry = od_find(plan->settings->table, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0, NULL);
	const struct setting *wanted = find_setting(plan->settings, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0);
	uint32_t period_us = 0;

	if (entry && !old_value(plan, entry, &period_us))
		return;
	if (wanted)
		period_us = (uint32_t)get_uint(wanted->wire, wanted->size);
	if (period_us)
		add_u32(plan, entry, 0);
	add_setting(plan, setting)->counts = 1;
	if (period_us)
		add_u32(plan, entry, period_us)->when = SETTINGS_ALWAYS;
}

static void load_plain(struct settings_plan *plan, const struct setting *setting)
{
	plan->group++;
	if (is_same(plan, setting))
		plan->same++;
	else if (setting->entry->index == OD_INDEX_COB_ID_SYNC)
		write_sync(plan, setting);
	else if (setting->entry->index == OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE)
		write_sync_counter(plan, setting);
	else if (is_guarded(setting->entry->index))
		write_switched_off(plan, setting);
	else
		add_setting(plan, setting)->counts = 1;
}

/* Two entries must not monitor the same node, not even temporarily: entries that change are cleared first. */
static void clear_consumers(struct settings_plan *plan)
{
	for (size_t i = 0; i < plan->settings->count; i++) {
		const struct setting *setting = &plan->settings->list[i];

		plan->group++;
		if (setting->entry->index == OD_INDEX_CONSUMER_HEARTBEAT_TIME && setting->size == 4 &&
			!is_same(plan, setting))
			add_u32(plan, setting->entry, 0);
	}
}

/* Written last: any other write clears the date of the configuration. */
static void load_date(struct settings_plan *plan)
{
	for (unsigned int sub = 1; sub <= 2; sub++) {
		const struct setting *setting = find_setting(plan->settings, OD_INDEX_VERIFY_CONFIGURATION, sub);

		if (setting)
			load_plain(plan, setting);
	}
}

static void write_count(struct settings_plan *plan, const struct od_entry *entry, uint32_t count)
{
	const uint8_t wire = (uint8_t)count;

	add_write(plan, entry, &wire, 1);
}

/* False: the number of mapped objects is not known. */
static bool write_mapping(struct settings_plan *plan, unsigned int index)
{
	const struct settings *settings = plan->settings;
	const struct od_entry *entry = od_find(settings->table, (uint16_t)index, 0, NULL);
	const struct setting *setting = find_setting(settings, index, 0);
	uint32_t count;

	if (!has_settings(settings, index))
		return true;
	if (!entry || !old_value(plan, entry, &count))
		return false;
	if (setting)
		count = setting->wire[0];
	write_count(plan, entry, 0);
	for (unsigned int sub = 1; sub <= count; sub++) {
		setting = find_setting(settings, index, sub);
		if (setting)
			add_setting(plan, setting);
	}
	write_count(plan, entry, count);
	return true;
}

/* The mapping procedure (CiA 301, 7.5.2.36): make the PDO invalid, map, make it valid. `index`: 1400h.. or 1800h.. */
static void load_pdo(struct settings_plan *plan, uint16_t index)
{
	const struct settings *settings = plan->settings;
	const struct od_entry *entry = od_find(settings->table, index, 1, NULL);
	const struct setting *cob_id = find_setting(settings, index, 1), *setting;
	int count = 0, same = 0;
	size_t before = plan->write_count;
	uint32_t old;

	for (size_t i = 0; i < settings->count; i++)
		if ((settings->list[i].entry->index & ~PDO_MAPPING) == index) {
			count++;
			same += is_same(plan, &settings->list[i]);
		}
	if (count == same) {
		plan->same += same;
		return;
	}
	plan->group++;
	if (!entry || !old_value(plan, entry, &old))
		return;
	add_u32(plan, entry, old | COB_ID_INVALID);
	if (!write_mapping(plan, index | PDO_MAPPING)) {
		plan->write_count = before; /* untouched */
		return;
	}
	for (unsigned int sub = 2; sub <= 6; sub++)
		if ((setting = find_setting(settings, index, sub)))
			add_setting(plan, setting);
	add_u32(plan, entry, cob_id ? get_u32(cob_id->wire) : old)->counts = count;
}

bool settings_plan_writes(struct settings_plan *plan)
{
	const struct od_table *table = plan->settings->table;
	uint16_t index = 0;

	for (size_t i = 0; i < plan->read_count; i++)
		plan->failed += plan->reads[i].needed && !plan->reads[i].done;
	clear_consumers(plan);
	for (size_t i = 0; i < table->count; i++) {
		const struct od_entry *entry = &table->entries[i];
		const struct setting *setting = find_setting(plan->settings, entry->index, entry->sub);

		if (!is_pdo_object(entry->index)) {
			if (setting && entry->index != OD_INDEX_VERIFY_CONFIGURATION)
				load_plain(plan, setting);
		} else if (!is_pdo_mapping(entry->index) && entry->index != index) {
			index = entry->index;
			load_pdo(plan, index);
		}
	}
	load_date(plan);
	return !plan->out_of_memory;
}

const struct settings_write *settings_plan_next(struct settings_plan *plan, bool failed)
{
	const struct settings_write *last = plan->at > 0 ? &plan->writes[plan->at - 1] : NULL;

	if (last && failed) {
		plan->failed += last->group != plan->failed_group;
		plan->failed_group = last->group;
	} else if (last) {
		plan->written += last->counts;
	}
	while (plan->writes && plan->at < plan->write_count) {
		const struct settings_write *write = &plan->writes[plan->at++];
		bool after_failure = write->group == plan->failed_group;

		if (write->when == SETTINGS_ALWAYS || (write->when == SETTINGS_AFTER_FAILURE) == after_failure)
			return write;
	}
	return NULL;
}

void settings_plan_free(struct settings_plan *plan)
{
	free(plan->reads);
	free(plan->writes);
	*plan = (struct settings_plan){0};
}

#include "tools/sdo/sdo_load.h"

#include <stdio.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_json.h"
#include "od_index.h"

/* COB-IDs that have the default for the node of the file get the default for this node. */
static void move_to_node(struct settings *settings, long node_id)
{
	const struct od_table *table = settings->session->table;

	if (settings->node_id == 0 || settings->node_id == node_id)
		return;
	for (size_t i = 0; i < settings->count; i++) {
		struct setting *setting = &settings->list[i];
		uint32_t base;

		if (!(setting->entry->access & OD_NODE_ID) || setting->size != 4)
			continue;
		memcpy(&base, (const char *)table->defaults + setting->entry->offset, 4);
		if (sdo_number(setting->wire, 4) == base + (uint32_t)settings->node_id)
			sdo_put_u32(setting->wire, base + (uint32_t)node_id);
	}
}

static const struct setting *find_setting(const struct settings *settings, unsigned int index, unsigned int sub)
{
	for (size_t i = settings->count; i-- > 0;) /* the last one is valid */
		if (settings->list[i].entry->index == index && settings->list[i].entry->sub == sub)
			return &settings->list[i];
	return NULL;
}

static bool has_settings(const struct settings *settings, uint16_t index)
{
	for (size_t i = 0; i < settings->count; i++)
		if (settings->list[i].entry->index == index)
			return true;
	return false;
}

/* ---- to the node ------------------------------------------------------------------------------------------------- */

struct load {
	struct session *session;
	const struct settings *settings;
	int written, same, failed;
	bool lost; /* the node stopped answering */
};

static bool load_failed(struct load *load, const struct od_entry *entry)
{
	cli_node_explain(&load->session->node, entry);
	load->failed++;
	load->lost = load->session->node.sdo.result != SDO_ABORTED;
	return false;
}

static bool load_write(struct load *load, const struct od_entry *entry, const void *wire, size_t size)
{
	if (load->lost)
		return false;
	return cli_node_write(&load->session->node, entry->index, entry->sub, wire, size) || load_failed(load, entry);
}

static bool load_read_u32(struct load *load, const struct od_entry *entry, uint32_t *value)
{
	uint8_t wire[OD_VALUE_MAX];

	if (load->lost)
		return false;
	if (!cli_node_read(&load->session->node, entry->index, entry->sub, wire, sizeof(wire)))
		return load_failed(load, entry);
	*value = (uint32_t)sdo_number(wire, load->session->node.sdo.size);
	return true;
}

/* Whether the node already has this value. */
static bool is_same(struct load *load, const struct setting *setting)
{
	uint8_t wire[OD_VALUE_MAX];
	struct cli_node *node = &load->session->node;

	if (load->lost)
		return false;
	if (cli_node_read(node, setting->entry->index, setting->entry->sub, wire, sizeof(wire)))
		return node->sdo.size == setting->size && memcmp(wire, setting->wire, setting->size) == 0;
	return node->sdo.result != SDO_ABORTED && load_failed(load, setting->entry);
}

static bool write_cob_id(struct load *load, const struct od_entry *entry, uint32_t cob_id)
{
	uint8_t wire[4];

	sdo_put_u32(wire, cob_id);
	return load_write(load, entry, wire, sizeof(wire));
}

/* The CAN-ID of a valid EMCY COB-ID must not be changed (CiA 301, 7.5.2.17), so it is made invalid first. The same
 * applies to the second SDO server. */
static bool write_switched_off(struct load *load, const struct setting *setting)
{
	uint32_t old;

	if (!load_read_u32(load, setting->entry, &old) || !write_cob_id(load, setting->entry, old | COB_ID_INVALID))
		return false;
	if (load_write(load, setting->entry, setting->wire, setting->size))
		return true;
	write_cob_id(load, setting->entry, old);
	return false;
}

/* The CAN-ID of SYNC must not be changed while the node produces it (CiA 301, 7.5.2.5). */
static bool write_sync(struct load *load, const struct setting *setting)
{
	uint32_t old;

	if (!load_read_u32(load, setting->entry, &old))
		return false;
	if ((old & COB_ID_PRODUCES) && !write_cob_id(load, setting->entry, old & ~COB_ID_PRODUCES))
		return false;
	return load_write(load, setting->entry, setting->wire, setting->size);
}

/* The counter overflow value must not be changed while there is a period (CiA 301, 7.5.2.22). The period already has
 * its new value. */
static bool write_sync_counter(struct load *load, const struct setting *setting)
{
	const struct od_entry *entry = od_find(load->session->table, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0, NULL);
	uint32_t period_us = 0;

	if (entry && (!load_read_u32(load, entry, &period_us) || (period_us && !write_cob_id(load, entry, 0))))
		return false;
	bool done = load_write(load, setting->entry, setting->wire, setting->size);
	return (!period_us || write_cob_id(load, entry, period_us)) && done;
}

/* Two entries must not monitor the same node, not even temporarily: entries that change are cleared first. */
static void clear_consumers(struct load *load)
{
	for (size_t i = 0; i < load->settings->count; i++) {
		const struct setting *setting = &load->settings->list[i];

		if (setting->entry->index == OD_INDEX_CONSUMER_HEARTBEAT_TIME && setting->size == 4 &&
			!is_same(load, setting))
			write_cob_id(load, setting->entry, 0);
	}
}

static bool write_plain(struct load *load, const struct setting *setting)
{
	switch (setting->entry->index) {
	case OD_INDEX_COB_ID_SYNC:
		return write_sync(load, setting);
	case OD_INDEX_SYNCHRONOUS_COUNTER_OVERFLOW_VALUE:
		return write_sync_counter(load, setting);
	case OD_INDEX_COB_ID_EMCY:
	case OD_INDEX_SECOND_SDO_SERVER_PARAMETER:
		return write_switched_off(load, setting);
	default:
		return load_write(load, setting->entry, setting->wire, setting->size);
	}
}

static void load_plain(struct load *load, const struct setting *setting)
{
	if (is_same(load, setting))
		load->same++;
	else
		load->written += write_plain(load, setting);
}

/* Written last: any other write clears the date of the configuration. */
static void load_date(struct load *load)
{
	for (unsigned int sub = 1; sub <= 2; sub++) {
		const struct setting *setting = find_setting(load->settings, OD_INDEX_VERIFY_CONFIGURATION, sub);

		if (setting)
			load_plain(load, setting);
	}
}

static bool write_mapped_count(struct load *load, const struct od_entry *entry, uint32_t count)
{
	const uint8_t wire = (uint8_t)count;

	return load_write(load, entry, &wire, 1);
}

static bool write_mapping(struct load *load, uint16_t index)
{
	const struct od_entry *entry = od_find(load->session->table, index, 0, NULL);
	const struct setting *setting = find_setting(load->settings, index, 0);
	uint32_t count;

	if (!has_settings(load->settings, index))
		return true;
	if (!entry || !load_read_u32(load, entry, &count))
		return false;
	if (setting)
		count = setting->wire[0];
	if (!write_mapped_count(load, entry, 0))
		return false;
	for (unsigned int sub = 1; sub <= count; sub++) {
		setting = find_setting(load->settings, index, sub);
		if (setting && !load_write(load, setting->entry, setting->wire, setting->size))
			return false;
	}
	return write_mapped_count(load, entry, count);
}

static bool write_transmission(struct load *load, unsigned int index)
{
	for (unsigned int sub = 2; sub <= 6; sub++) {
		const struct setting *setting = find_setting(load->settings, index, sub);

		if (setting && !load_write(load, setting->entry, setting->wire, setting->size))
			return false;
	}
	return true;
}

/* The mapping procedure (CiA 301, 7.5.2.36): make the PDO invalid, map, make it valid. `index`: 1400h.. or 1800h.. */
static void load_pdo(struct load *load, uint16_t index)
{
	const struct od_entry *entry = od_find(load->session->table, index, 1, NULL);
	const struct setting *cob_id = find_setting(load->settings, index, 1);
	int settings = 0, same = 0;
	uint32_t old;

	for (size_t i = 0; i < load->settings->count; i++) {
		const struct setting *setting = &load->settings->list[i];

		if ((setting->entry->index & ~0x200) == index) {
			settings++;
			same += is_same(load, setting);
		}
	}
	if (settings == same) {
		load->same += same;
		return;
	}
	if (!entry || !load_read_u32(load, entry, &old))
		return;
	if (!write_cob_id(load, entry, old | COB_ID_INVALID))
		return;
	if (!write_mapping(load, (uint16_t)(index | 0x200)) || !write_transmission(load, index)) {
		cli_error("the PDO at %04Xh remains switched off", index);
		return;
	}
	if (write_cob_id(load, entry, cob_id ? (uint32_t)sdo_number(cob_id->wire, 4) : old))
		load->written += settings;
}

static void load_all(struct load *load)
{
	uint16_t index = 0;

	clear_consumers(load);
	for (size_t i = 0; i < load->session->table->count && !load->lost; i++) {
		const struct od_entry *entry = &load->session->table->entries[i];
		const struct setting *setting = find_setting(load->settings, entry->index, entry->sub);

		if (!is_pdo_object(entry->index)) {
			if (setting && entry->index != OD_INDEX_VERIFY_CONFIGURATION)
				load_plain(load, setting);
		} else if (!is_pdo_mapping(entry->index) && entry->index != index) {
			index = entry->index;
			load_pdo(load, index);
		}
	}
	load_date(load);
}

int sdo_load(struct session *s, struct settings *settings)
{
	struct load load = {.session = s, .settings = settings};

	move_to_node(settings, s->node_id);
	sdo_open(s);
	load_all(&load);
	sdo_close(s);
	if (!s->quiet)
		fprintf(stderr, "imu9-sdo: node %ld: %d values written, %d unchanged, %d failed%s\n", s->node_id,
			load.written, load.same, load.failed, load.written ? "; 'imu9-sdo store' stores them" : "");
	return load.failed ? CLI_FAILED : CLI_OK;
}

/* ---- compare ----------------------------------------------------------------------------------------------------- */

static void print_difference(struct session *s, const struct setting *setting, const uint8_t *wire, size_t size,
	struct json_object *differences)
{
	const struct target target = {setting->entry->index, setting->entry->sub, setting->entry};

	if (differences) {
		sdo_json_add_difference(differences, s, &target, wire, size, setting->wire, setting->size);
		return;
	}
	char there[CLI_VALUE_TEXT_MAX], wanted[CLI_VALUE_TEXT_MAX];

	sdo_value_text(s, &target, setting->wire, setting->size, wanted, sizeof(wanted));
	sdo_value_text(s, &target, wire, size, there, sizeof(there));
	printf("%04Xh:%02X  %-44s node: %s  file: %s\n", target.index, target.sub, setting->entry->name, there, wanted);
}

int sdo_compare(struct session *s, struct settings *settings)
{
	int same = 0, different = 0, failed = 0;
	uint8_t wire[OD_VALUE_MAX];
	struct json_object *document = s->json ? sdo_json_new(s) : NULL;
	struct json_object *differences = document ? sdo_json_array(document, "differences") : NULL;

	move_to_node(settings, s->node_id);
	sdo_open(s);
	for (size_t i = 0; i < settings->count; i++) {
		const struct setting *setting = &settings->list[i];

		if (!cli_node_read(&s->node, setting->entry->index, setting->entry->sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, setting->entry);
			failed++;
			if (s->node.sdo.result != SDO_ABORTED)
				break;
		} else if (s->node.sdo.size == setting->size && memcmp(wire, setting->wire, setting->size) == 0) {
			same++;
		} else {
			different++;
			print_difference(s, setting, wire, s->node.sdo.size, differences);
		}
	}
	sdo_close(s);
	if (document)
		sdo_json_print_comparison(document, same, failed);
	else if (!s->quiet)
		fprintf(stderr, "imu9-sdo: node %ld: %d values as in the file, %d differ, %d could not be read\n",
			s->node_id, same, different, failed);
	return different || failed ? CLI_FAILED : CLI_OK;
}

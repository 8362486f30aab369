#include "tools/sdo/sdo_load.h"

#include <stdio.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_json.h"

/* ---- to the node ------------------------------------------------------------------------------------------------- */

/* True: it was aborted, so the node is there. */
static bool is_refused(struct session *s, const struct od_entry *entry)
{
	cli_node_explain(&s->node, entry);
	return s->node.sdo.result == SDO_ABORTED;
}

/* False: the node stopped answering. */
static bool read_all(struct session *s, struct settings_plan *plan)
{
	for (size_t i = 0; i < plan->read_count; i++) {
		struct settings_read *read = &plan->reads[i];
		const struct od_entry *entry = read->entry;

		read->done = cli_node_read(&s->node, entry->index, entry->sub, read->wire, sizeof(read->wire));
		read->size = s->node.sdo.size;
		if (!read->done && (read->needed || s->node.sdo.result != SDO_ABORTED) && !is_refused(s, entry))
			return false;
	}
	return true;
}

static void write_all(struct session *s, struct settings_plan *plan)
{
	const struct settings_write *write = NULL;
	bool failed = false;

	while ((write = settings_plan_next(plan, failed))) {
		const struct od_entry *entry = write->entry;

		failed = !cli_node_write(&s->node, entry->index, entry->sub, write->wire, write->size);
		if (!failed)
			continue;
		if (!is_refused(s, entry)) {
			plan->failed++;
			return;
		}
		if (is_pdo_mapping(entry->index) || (is_pdo_object(entry->index) && entry->sub > 1))
			cli_error("the PDO at %04Xh remains switched off", entry->index & ~PDO_MAPPING);
	}
}

int sdo_load(struct session *s, struct settings *settings)
{
	struct settings_plan plan = {0};

	settings_move_to_node(settings, s->node_id);
	bool ok = settings_plan_reads(&plan, settings);
	sdo_open(s);
	if (ok && !read_all(s, &plan))
		plan.failed++;
	else if (ok && settings_plan_writes(&plan))
		write_all(s, &plan);
	else
		cli_error("out of memory");
	sdo_close(s);
	if (!s->quiet)
		fprintf(stderr, "imu9-sdo: node %ld: %d values written, %d unchanged, %d failed%s\n", s->node_id,
			plan.written, plan.same, plan.failed, plan.written ? "; 'imu9-sdo store' stores them" : "");
	ok = ok && plan.failed == 0;
	settings_plan_free(&plan);
	return ok ? CLI_OK : CLI_FAILED;
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

	settings_move_to_node(settings, s->node_id);
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

/* The configuration of a node as a file: save, compare, load. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"
#include "od_index.h"
#include "od_values.h"
#include "tools/lib/json_value.h"
#include "tools/lib/settings.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

/* Whether the node stopped answering: the last step is then the one that failed, or was not tried. */
static bool is_lost(const struct web_job *job)
{
	const struct web_step *last = job->steps + job->count;

	return job->count > 0 && last[-1].result != SDO_DONE && last[-1].result != SDO_ABORTED;
}

/* "format". False after an answer. */
static bool find_format(struct web *web, struct web_job *job, bool *dcf)
{
	const char *format = web_string(job->request, "format");

	*dcf = format && strcmp(format, "dcf") == 0;
	if (*dcf || (format && strcmp(format, "ini") == 0))
		return true;
	web_refuse(web, job, "\"format\" is ini or dcf");
	return false;
}

/* ---- save -------------------------------------------------------------------------------------------------------- */

static bool step_value(void *ctx, const struct od_entry *entry, uint8_t wire[OD_VALUE_MAX], size_t *size)
{
	const struct web_job *job = ctx;

	for (size_t i = 0; i < job->count; i++) {
		const struct web_step *step = &job->steps[i];

		if (step->entry != entry)
			continue;
		if (step->result != SDO_DONE || step->large)
			return false;
		memcpy(wire, step->wire, step->size);
		*size = step->size;
		return true;
	}
	return false;
}

static void write_ini(FILE *out, struct web_job *job, int *failed)
{
	uint16_t index = 0;
	uint64_t mapped = 0;

	fprintf(out, "# Configuration of node %u, saved by imu9-web.\n# For 'imu9-sdo load' and 'imu9-gateway -c'.\n",
		job->node->id);
	for (size_t i = 0; i < job->count; i++) {
		const struct web_step *step = &job->steps[i];

		if (step->index != index) {
			index = step->index;
			mapped = UINT64_MAX; /* until sub-index 0 was read */
			fprintf(out, "\n# %04Xh\n", index);
		}
		if (is_pdo_mapping(index) && step->sub > mapped)
			continue; /* not in use */
		if (step->sub == 0)
			mapped = web_u32(step, UINT32_MAX);
		*failed += step->result != SDO_DONE || step->large ||
			   !settings_write_value(out, step->entry, step->wire, step->size);
	}
	fprintf(out, "\n[gateway]\nnode_id = %u\n", job->node->id);
}

/* The text of the EDS; the built-in one with the vendor of the node, as the node gives it in 1021h. */
static char *eds_text(const struct web_node *node)
{
	char *text = malloc(node->eds->size + 1);
	char vendor[sizeof("0x00000000")];

	if (!text)
		return NULL;
	memcpy(text, node->eds->text, node->eds->size);
	snprintf(vendor, sizeof(vendor), "0x%08X", (unsigned int)node->identity[0]);
	for (size_t i = 0; node->eds->text == (const char *)imu9_eds && i < IMU9_EDS_VENDORS; i++)
		memcpy(text + imu9_eds_vendor[i], vendor, strlen(vendor));
	return text;
}

static void write_dcf(FILE *out, struct web_job *job, int *failed)
{
	char *eds = eds_text(job->node);
	int saved = 0;

	if (eds)
		settings_write_dcf(out, job->node->eds->table, eds, job->node->eds->size, job->node->id, step_value,
			job, &saved, failed);
	free(eds);
}

static bool answer_file(struct web *web, struct web_job *job, bool dcf)
{
	char *text = NULL;
	size_t size;
	int failed = 0;
	FILE *out = open_memstream(&text, &size);

	if (!out) {
		web_refuse(web, job, "out of memory");
		return false;
	}
	if (dcf)
		write_dcf(out, job, &failed);
	else
		write_ini(out, job, &failed);
	fclose(out);
	struct json_object *result = json_object_new_object();
	json_object_object_add(result, "text", json_object_new_string(text));
	json_object_object_add(result, "failed", json_object_new_int(failed));
	web_answer(web, job, result);
	free(text);
	return false;
}

bool web_op_save(struct web *web, struct web_job *job, uint64_t now_us)
{
	const struct od_table *table = job->node->eds->table;
	bool dcf, ok = true;

	(void)now_us;
	if (!find_format(web, job, &dcf))
		return false;
	if (dcf && !job->node->eds->text) {
		web_refuse(web, job, "a DCF is made of the EDS of the node: start imu9-web with --eds FILE");
		return false;
	}
	if (job->stage == 0) {
		for (size_t i = 0; i < table->count; i++)
			if (settings_has(&table->entries[i]))
				ok = web_read(job, table->entries[i].index, table->entries[i].sub) && ok;
		return ok;
	}
	if (is_lost(job)) {
		web_refuse(web, job, "no answer from node %u", job->node->id);
		return false;
	}
	return answer_file(web, job, dcf);
}

/* ---- a file that was sent ---------------------------------------------------------------------------------------- */

struct file {
	struct eds dcf;
	bool parsed;
	struct settings_plan plan;
	struct json_object *failures;
	const struct od_entry *writing; /* NULL: still reading */
	struct settings settings;
};

static void release(void *data)
{
	struct file *file = data;

	if (file->parsed)
		eds_free(&file->dcf);
	settings_plan_free(&file->plan);
	json_object_put(file->failures);
	free(file);
}

static bool parse_ini(struct settings *settings, const char *text, size_t size, char *error, size_t error_size)
{
	FILE *in = size ? fmemopen((char *)(uintptr_t)text, size, "r") : NULL;

	if (!in) {
		snprintf(error, error_size, "the file is empty");
		return false;
	}
	bool ok = settings_read(settings, in, "line", error, error_size);
	fclose(in);
	return ok;
}

static bool parse_dcf(struct file *file, const char *text, size_t size, uint8_t node_id, char *error, size_t error_size)
{
	file->parsed = eds_parse(&file->dcf, "line", text, size, EDS_LENIENT, error, error_size) == 0;
	return file->parsed && settings_take_dcf(&file->settings, &file->dcf, "line", node_id, error, error_size);
}

/* job->data; false after an answer. */
static bool take_file(struct web *web, struct web_job *job)
{
	struct json_object *text = NULL;
	struct file *file = calloc(1, sizeof(*file));
	char error[512];
	bool dcf;

	job->data = file;
	job->release = release;
	if (!file) {
		job->release = NULL;
		web_refuse(web, job, "out of memory");
		return false;
	}
	json_object_object_get_ex(job->request, "text", &text);
	if (!find_format(web, job, &dcf))
		return false;
	if (!json_object_is_type(text, json_type_string)) {
		web_refuse(web, job, "\"text\" is the content of the file");
		return false;
	}
	file->settings.table = job->node->eds->table;
	const char *content = json_object_get_string(text);
	size_t size = (size_t)json_object_get_string_len(text);
	if (dcf ? !parse_dcf(file, content, size, job->node->id, error, sizeof(error))
		: !parse_ini(&file->settings, content, size, error, sizeof(error))) {
		web_refuse(web, job, "%s", error);
		return false;
	}
	settings_move_to_node(&file->settings, job->node->id);
	return true;
}

static void add_failure(struct json_object *list, const struct od_entry *entry, enum sdo_result result, uint32_t code)
{
	struct json_object *failure = json_object_new_object();

	json_object_object_add(failure, "name", json_object_new_string(entry->name));
	json_add_failure(failure, result, code);
	json_object_array_add(list, failure);
}

/* ---- compare ----------------------------------------------------------------------------------------------------- */

static struct json_object *difference(
	const struct web_job *job, const struct setting *setting, const struct web_step *step)
{
	struct json_object *json = json_object_new_object();
	const struct od_entry *entry = setting->entry;
	double factor = step->entry ? web_step_of(job, step->entry) : entry->factor;

	json_object_object_add(json, "name", json_object_new_string(entry->name));
	json_object_object_add(json, "unit", json_object_new_string(entry->unit));
	json_object_object_add(json, "node_value", json_value(entry, factor, web_bytes(step), step->size));
	json_object_object_add(json, "file_value", json_value(entry, factor, setting->wire, setting->size));
	return json;
}

bool web_op_compare(struct web *web, struct web_job *job, uint64_t now_us)
{
	(void)now_us;
	if (job->stage == 0) {
		bool ok = take_file(web, job);
		const struct file *file = job->data;

		for (size_t i = 0; ok && i < file->settings.count; i++) {
			const struct od_entry *entry = file->settings.list[i].entry;

			ok = web_read(job, entry->index, entry->sub);
		}
		for (size_t i = 0; ok && i < file->settings.count; i++)
			ok = web_read_resolution(job, job->steps[i].entry);
		return ok;
	}
	const struct file *file = job->data;
	struct json_object *result = json_object_new_object(), *list = json_object_new_array(),
			   *failed = json_object_new_array();
	int same = 0;
	for (size_t i = 0; i < file->settings.count; i++) {
		const struct setting *setting = &file->settings.list[i];
		const struct web_step *step = &job->steps[i];

		if (step->result != SDO_DONE)
			add_failure(failed, setting->entry, step->result, step->abort_code);
		else if (step->size == setting->size && memcmp(web_bytes(step), setting->wire, setting->size) == 0)
			same++;
		else
			json_object_array_add(list, difference(job, setting, step));
	}
	json_object_object_add(result, "differences", list);
	json_object_object_add(result, "same", json_object_new_int(same));
	json_object_object_add(result, "failed", failed);
	web_answer(web, job, result);
	return false;
}

/* ---- load -------------------------------------------------------------------------------------------------------- */

static bool start_load(struct web *web, struct web_job *job)
{
	if (!take_file(web, job))
		return false;
	struct file *file = job->data;
	bool ok = settings_plan_reads(&file->plan, &file->settings);
	file->failures = json_object_new_array();
	for (size_t i = 0; ok && i < file->plan.read_count; i++)
		ok = web_read(job, file->plan.reads[i].entry->index, file->plan.reads[i].entry->sub);
	if (!ok)
		web_refuse(web, job, "out of memory");
	return ok;
}

static bool plan_writes(struct file *file, const struct web_job *job)
{
	for (size_t i = 0; i < file->plan.read_count; i++) {
		struct settings_read *read = &file->plan.reads[i];
		const struct web_step *step = &job->steps[i];

		read->done = step->result == SDO_DONE && !step->large;
		read->size = step->size;
		memcpy(read->wire, step->wire, sizeof(read->wire));
		if (!read->done && read->needed)
			add_failure(file->failures, read->entry, step->result, step->abort_code);
	}
	return settings_plan_writes(&file->plan);
}

static bool end_load(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct file *file = job->data;
	struct json_object *result = json_object_new_object();

	json_object_object_add(result, "written", json_object_new_int(file->plan.written));
	json_object_object_add(result, "same", json_object_new_int(file->plan.same));
	json_object_object_add(result, "failed", json_object_get(file->failures));
	web_answer(web, job, result);
	job->node->heartbeat_us = job->node->heartbeat_interval_us = 0; /* 1017h may be another */
	web_node_mapping_changed(job->node, now_us);
	return false;
}

bool web_op_load(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct file *file = job->data;
	const struct settings_write *write;
	bool failed = false;

	if (job->stage == 0)
		return start_load(web, job);
	if (is_lost(job)) {
		if (!file->writing) {
			web_refuse(web, job, "no answer from node %u", job->node->id);
			return false;
		}
		add_failure(file->failures, file->writing, SDO_TIMEOUT, 0);
		return end_load(web, job, now_us);
	}
	if (job->stage == 1 && !plan_writes(file, job)) {
		web_refuse(web, job, "out of memory");
		return false;
	}
	if (file->writing) { /* the only step */
		failed = job->steps[0].result == SDO_ABORTED;
		if (failed)
			add_failure(file->failures, file->writing, SDO_ABORTED, job->steps[0].abort_code);
	}
	write = settings_plan_next(&file->plan, failed);
	if (!write)
		return end_load(web, job, now_us);
	web_clear_steps(job);
	file->writing = write->entry;
	return web_write(job, write->entry->index, write->entry->sub, write->wire, write->size);
}

/* PDO mapping: as it is, and changed by the procedure of CiA 301. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"
#include "od_index.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

enum { ENTRIES = 8 /* a bit is the least that can be mapped, but a name has at least a byte */, COMMUNICATION = 4 };

/* Sub-indices of 14xxh and 18xxh: COB-ID, transmission type, inhibit time, event timer. */
static const uint8_t SUBS[COMMUNICATION] = {1, 2, 3, 5};
enum { COB_ID, TYPE, INHIBIT, EVENT_TIMER };

static const struct direction {
	const char *key, *name;
	uint16_t first; /* object */
	uint8_t access;
} DIRECTIONS[] = {{"tpdo", "a TPDO", PDO_FIRST_TPDO, OD_TPDO}, {"rpdo", "an RPDO", PDO_FIRST_RPDO, OD_RPDO}};
enum { DIRECTION_COUNT = 2 };

static size_t count_pdos(const struct od_table *table, const struct direction *direction)
{
	size_t n = 0;

	while (n < WATCH_PDOS && od_find(table, (uint16_t)(direction->first + n), 1, NULL))
		n++;
	return n;
}

/* COMMUNICATION steps, then sub-index 0 and ENTRIES of the mapping. Objects that the EDS does not have are read, too:
 * the node aborts. */
enum { PDO_STEPS = COMMUNICATION + 1 + ENTRIES };

static bool read_pdo(struct web_job *job, uint16_t index)
{
	bool ok = true;

	for (size_t i = 0; i < COMMUNICATION; i++)
		ok = web_read(job, index, SUBS[i]) && ok;
	for (uint8_t sub = 0; sub <= ENTRIES; sub++)
		ok = web_read(job, (uint16_t)(index + PDO_MAPPING), sub) && ok;
	return ok;
}

static void add_u32(struct json_object *to, const char *key, const struct web_step *step)
{
	json_object_object_add(to, key, step->result == SDO_DONE ? json_object_new_int64(web_u32(step, 0)) : NULL);
}

static struct json_object *entries_json(const struct web_job *job, const struct web_step *steps, unsigned int *bits)
{
	struct json_object *entries = json_object_new_array();
	uint32_t count = web_u32(&steps[0], 0);

	for (uint32_t i = 1; i <= count && i <= ENTRIES; i++) {
		uint32_t object = web_u32(&steps[i], 0);
		uint16_t index = (uint16_t)(object >> 16);
		uint8_t sub = (uint8_t)(object >> 8);
		const struct od_entry *entry = od_find(job->node->eds->table, index, sub, NULL);
		char address[16];

		snprintf(address, sizeof(address), "%04Xh:%02X", index, sub);
		json_object_array_add(entries, json_object_new_string(entry ? entry->name : address));
		*bits += object & 0xFF;
	}
	return entries;
}

static struct json_object *pdo_json(
	const struct web_job *job, const struct web_step *steps, const struct direction *direction, size_t number)
{
	struct json_object *pdo = json_object_new_object();
	unsigned int bits = 0;
	uint32_t cob_id = web_u32(&steps[COB_ID], COB_ID_INVALID);

	json_object_object_add(pdo, "direction", json_object_new_string(direction->key));
	json_object_object_add(pdo, "pdo", json_object_new_int((int)number + 1));
	json_object_object_add(pdo, "cob_id", json_object_new_int((int)(cob_id & COB_ID_MASK)));
	json_object_object_add(pdo, "enabled", json_object_new_boolean(!(cob_id & COB_ID_INVALID)));
	add_u32(pdo, "type", &steps[TYPE]);
	add_u32(pdo, "inhibit", &steps[INHIBIT]);
	add_u32(pdo, "event_timer", &steps[EVENT_TIMER]);
	json_object_object_add(pdo, "entries", entries_json(job, steps + COMMUNICATION, &bits));
	json_object_object_add(pdo, "bits", json_object_new_int((int)bits));
	return pdo;
}

bool web_op_mapping(struct web *web, struct web_job *job, uint64_t now_us)
{
	const struct od_table *table = job->node->eds->table;
	const struct direction *d;
	struct json_object *result, *pdos;

	(void)now_us;
	if (job->stage == 0) {
		bool ok = true;

		for (d = DIRECTIONS; d < DIRECTIONS + DIRECTION_COUNT; d++)
			for (size_t i = 0; i < count_pdos(table, d); i++)
				ok = read_pdo(job, (uint16_t)(d->first + i)) && ok;
		return web_read(job, OD_INDEX_COMMUNICATION_CYCLE_PERIOD, 0) && ok;
	}
	const struct web_step *period = &job->steps[job->count - 1];
	if (period->result != SDO_DONE && period->result != SDO_ABORTED) {
		web_refuse(web, job, "no answer from node %u", job->node->id);
		return false;
	}
	result = json_object_new_object();
	pdos = json_object_new_array();
	const struct web_step *steps = job->steps;
	for (d = DIRECTIONS; d < DIRECTIONS + DIRECTION_COUNT; d++)
		for (size_t i = 0; i < count_pdos(table, d); i++, steps += PDO_STEPS)
			json_object_array_add(pdos, pdo_json(job, steps, d, i));
	json_object_object_add(result, "pdos", pdos);
	add_u32(result, "sync_us", period);
	web_answer(web, job, result);
	return false;
}

/* ---- set_mapping ------------------------------------------------------------------------------------------------- */

struct mapping {
	const struct direction *direction;
	uint16_t index; /* 14xxh or 18xxh */
	uint32_t entries[ENTRIES];
	size_t count;
	uint32_t cob_id; /* when it is valid again */
	struct web_step failed;
	bool restoring;
};

/* 0: there is no such object, or it cannot be mapped. The data types 0002h to 0007h are dummies: bytes that an RPDO
 * skips (CiA 301, 7.5.2.36). */
static uint32_t parse_entry(const struct web_job *job, const struct direction *direction, const char *name)
{
	static const uint8_t DUMMY_BITS[] = {8, 16, 32, 8, 16, 32};
	const struct od_entry *entry = od_find_name(job->node->eds->table, name);
	unsigned int type;
	int end = 0;

	if (entry && (entry->access & direction->access) && entry->size > 0 && entry->size <= 8)
		return (uint32_t)entry->index << 16 | (uint32_t)entry->sub << 8 | 8u * entry->size;
	if (direction->access == OD_RPDO && sscanf(name, "000%1uh:00%n", &type, &end) == 1 && end > 0 && !name[end] &&
		type >= 2 && type <= 7)
		return type << 16 | DUMMY_BITS[type - 2];
	return 0;
}

/* False after an answer. */
static bool parse_entries(struct web *web, struct web_job *job, struct mapping *mapping)
{
	struct json_object *entries = web_array(job->request, "entries");
	size_t n = entries ? json_object_array_length(entries) : 0;
	unsigned int bits = 0;

	if (!entries || n > ENTRIES) {
		web_refuse(web, job, "\"entries\" is an array of at most %d names", ENTRIES);
		return false;
	}
	for (size_t i = 0; i < n; i++) {
		struct json_object *name = json_object_array_get_idx(entries, i);
		const char *text = json_object_is_type(name, json_type_string) ? json_object_get_string(name) : "";

		mapping->entries[i] = parse_entry(job, mapping->direction, text);
		if (!mapping->entries[i]) {
			bool known = od_find_name(job->node->eds->table, text);

			web_refuse(web, job, "%.100s: %s%s", text,
				known ? "cannot be mapped into " : "the EDS has no such object",
				known ? mapping->direction->name : "");
			return false;
		}
		bits += mapping->entries[i] & 0xFF;
	}
	if (bits > 64) {
		web_refuse(web, job, "a PDO has 8 bytes, these objects %u", bits / 8);
		return false;
	}
	mapping->count = n;
	return true;
}

static bool start_mapping(struct web *web, struct web_job *job)
{
	struct mapping *mapping = job->data = calloc(1, sizeof(*mapping));
	const char *key = web_string(job->request, "direction");
	const struct direction *direction = &DIRECTIONS[key && strcmp(key, "rpdo") == 0];
	int64_t number, most = (int64_t)count_pdos(job->node->eds->table, direction);

	if (!mapping || (key && strcmp(key, direction->key) != 0) ||
		!web_integer(job->request, "pdo", 1, most, &number)) {
		web_refuse(web, job, "%s",
			mapping ? "\"direction\" is tpdo or rpdo, and \"pdo\" the number of a TPDO or RPDO"
				: "out of memory");
		return false;
	}
	mapping->direction = direction;
	mapping->index = (uint16_t)(direction->first + number - 1);
	return parse_entries(web, job, mapping) && read_pdo(job, mapping->index);
}

static bool write_uint(struct web_job *job, uint16_t index, uint8_t sub, uint64_t value, size_t size)
{
	uint8_t wire[8];

	put_uint(wire, value, size);
	return web_write(job, index, sub, wire, size);
}

static bool write_entries(struct web_job *job, uint16_t index, const uint32_t *entries, size_t count)
{
	bool ok = write_uint(job, (uint16_t)(index + PDO_MAPPING), 0, 0, 1);

	for (size_t i = 0; i < count; i++)
		ok = write_uint(job, (uint16_t)(index + PDO_MAPPING), (uint8_t)(i + 1), entries[i], 4) && ok;
	return write_uint(job, (uint16_t)(index + PDO_MAPPING), 0, count, 1) && ok;
}

/* A member that is given, and not what the node has already. */
static bool write_member(struct web_job *job, uint16_t index, const char *key, uint8_t sub, size_t size, uint32_t old)
{
	int64_t value;

	if (!web_integer(job->request, key, 0, (INT64_C(1) << (8 * size)) - 1, &value) || (uint32_t)value == old)
		return true;
	return write_uint(job, index, sub, (uint64_t)value, size);
}

/* The PDO is made invalid, mapped, and made valid again (CiA 301, 7.5.2.36). */
static bool write_mapping(struct web *web, struct web_job *job, struct mapping *mapping)
{
	struct json_object *enabled = NULL;
	const struct web_step *steps = job->steps;
	uint32_t old[COMMUNICATION];
	int64_t can_id;

	if (steps[COB_ID].result != SDO_DONE || steps[COMMUNICATION].result != SDO_DONE) {
		web_refuse_step(web, job, &steps[steps[COB_ID].result == SDO_DONE ? COMMUNICATION : COB_ID]);
		return false;
	}
	for (size_t i = 0; i < COMMUNICATION; i++)
		old[i] = web_u32(&steps[i], UINT32_MAX);
	mapping->cob_id = old[COB_ID] & ~COB_ID_INVALID;
	if (web_integer(job->request, "cob_id", 1, COB_ID_MASK, &can_id))
		mapping->cob_id = (mapping->cob_id & ~COB_ID_MASK) | (uint32_t)can_id;
	json_object_object_get_ex(job->request, "enabled", &enabled);
	if (json_object_is_type(enabled, json_type_boolean) && !json_object_get_boolean(enabled))
		mapping->cob_id |= COB_ID_INVALID;
	job->stop = true;
	bool ok = write_uint(job, mapping->index, 1, old[COB_ID] | COB_ID_INVALID, 4);
	ok = write_entries(job, mapping->index, mapping->entries, mapping->count) && ok;
	ok = write_member(job, mapping->index, "type", SUBS[TYPE], 1, old[TYPE]) && ok;
	ok = write_member(job, mapping->index, "inhibit", SUBS[INHIBIT], 2, old[INHIBIT]) && ok;
	ok = write_member(job, mapping->index, "event_timer", SUBS[EVENT_TIMER], 2, old[EVENT_TIMER]) && ok;
	return write_uint(job, mapping->index, 1, mapping->cob_id, 4) && ok;
}

/* As it was, so that a refused mapping leaves a PDO that works. */
static bool restore(struct web_job *job, struct mapping *mapping)
{
	uint32_t entries[ENTRIES], count = web_u32(&job->steps[COMMUNICATION], 0);

	for (uint32_t i = 0; i < ENTRIES; i++)
		entries[i] = web_u32(&job->steps[COMMUNICATION + 1 + i], 0);
	mapping->restoring = true;
	job->stop = false;
	bool ok = true;
	for (size_t i = TYPE; i < COMMUNICATION; i++)
		if (job->steps[i].result == SDO_DONE)
			ok = web_write(job, mapping->index, SUBS[i], job->steps[i].wire, job->steps[i].size) && ok;
	ok = write_entries(job, mapping->index, entries, count < ENTRIES ? count : ENTRIES) && ok;
	return write_uint(job, mapping->index, 1, web_u32(&job->steps[COB_ID], COB_ID_INVALID), 4) && ok;
}

static const struct web_step *first_failure(const struct web_job *job)
{
	for (size_t i = PDO_STEPS; i < job->count; i++)
		if (job->steps[i].result != SDO_DONE)
			return &job->steps[i];
	return NULL;
}

bool web_op_set_mapping(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct mapping *mapping = job->data;
	const struct web_step *failed;

	if (job->stage == 0)
		return start_mapping(web, job);
	if (job->stage == 1)
		return write_mapping(web, job, mapping);
	failed = first_failure(job);
	if (failed && failed->result == SDO_ABORTED && !mapping->restoring) {
		mapping->failed = *failed;
		return restore(job, mapping);
	}
	web_node_mapping_changed(job->node, now_us);
	if (mapping->restoring)
		web_refuse_step(web, job, &mapping->failed);
	else if (failed)
		web_refuse_step(web, job, failed);
	else
		web_answer(web, job, json_object_new_object());
	return false;
}

/* The EDS of each kind of node: from the node itself (1021h), from --eds, or built in. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "od_values.h"
#include "tools/lib/json_value.h"
#include "tools/web/web.h"

enum { MANUFACTURER_OBJECTS = 0x2000 };

static struct web_eds *find(struct web *web, const struct web_node *node, bool of_device)
{
	for (size_t i = 0; i < WEB_EDS_CACHE; i++) {
		struct web_eds *eds = &web->eds[i];

		if (eds->table && eds->of_device == of_device &&
			memcmp(eds->identity, node->identity, sizeof(eds->identity)) == 0)
			return eds;
	}
	return NULL;
}

static void forget(struct web_eds *eds)
{
	if (eds->memory)
		eds_free(&eds->parsed);
	free(eds->memory);
	*eds = (struct web_eds){0};
}

/* A free place, or that of an EDS which no node has any more. NULL: as many kinds of devices are on the bus. */
static struct web_eds *place(struct web *web, const struct web_node *node, bool of_device)
{
	struct web_eds *eds = NULL;

	for (size_t i = 0; i < WEB_EDS_CACHE && (!eds || eds->table); i++)
		if (web->eds[i].nodes == 0)
			eds = &web->eds[i];
	if (eds) {
		forget(eds);
		memcpy(eds->identity, node->identity, sizeof(eds->identity));
		eds->of_device = of_device;
	}
	return eds;
}

static struct web_eds *built_in(struct web *web, const struct web_node *node)
{
	struct web_eds *eds = place(web, node, true);

	if (eds) {
		eds->table = &imu9_od_table;
		eds->text = (const char *)imu9_eds;
		eds->size = imu9_eds_size;
	}
	return eds;
}

struct web_eds *web_eds_known(struct web *web, const struct web_node *node)
{
	const struct od_values *defaults = imu9_od_table.defaults;
	struct web_eds *eds = find(web, node, true);

	/* the revision of a gateway is that of its EDS: the one of this program is the same file */
	if (!eds && web_is_ours(node) && node->identity[2] == defaults->identity.revision_number)
		eds = built_in(web, node);
	return eds;
}

/* Control codes of another device must not reach a terminal. */
static void tell(const struct web_node *node, char *error)
{
	for (char *c = error; *c; c++)
		if (*c < 0x20 || *c > 0x7E)
			*c = '?';
	fprintf(stderr, "imu9-web: EDS of node %u: %s\n", node->id, error);
}

struct web_eds *web_eds_read(struct web *web, const struct web_node *node, char *text, size_t size)
{
	struct web_eds *eds = place(web, node, true);
	char error[256];

	if (!eds || eds_parse(&eds->parsed, "1021h", text, size, EDS_LENIENT, error, sizeof(error)) < 0) {
		if (eds)
			tell(node, error);
		free(text);
		return NULL;
	}
	eds->table = &eds->parsed.table;
	eds->text = eds->memory = text;
	eds->size = size;
	return eds;
}

static bool fits(const struct eds *eds, const struct web_node *node)
{
	return eds->info.vendor_number == node->identity[0] && eds->info.product_number == node->identity[1];
}

/* What CiA 301 defines is the same in every device. */
static const struct od_table *communication_objects(void)
{
	static struct od_table table;

	if (!table.entries) {
		table = imu9_od_table;
		while (table.count > 0 && table.entries[table.count - 1].index >= MANUFACTURER_OBJECTS)
			table.count--;
	}
	return &table;
}

struct web_eds *web_eds_otherwise(struct web *web, const struct web_node *node)
{
	struct web_eds *eds = find(web, node, false);

	if (eds)
		return eds;
	eds = place(web, node, false);
	if (!eds) /* as the first one of all is never released, there is always an EDS */
		return &web->eds[0];
	for (size_t i = 0; i < web->config.eds_count; i++)
		if (fits(&web->config.eds[i], node)) {
			eds->table = &web->config.eds[i].table;
			eds->text = web->config.eds_texts[i];
			eds->size = web->config.eds_sizes[i];
			return eds;
		}
	eds->table = web_is_ours(node) ? &imu9_od_table : communication_objects();
	return eds;
}

void web_eds_free(struct web *web)
{
	for (size_t i = 0; i < WEB_EDS_CACHE; i++)
		forget(&web->eds[i]);
}

/* ---- as JSON ----------------------------------------------------------------------------------------------------- */

static bool is_highest_subindex(const struct od_entry *entry)
{
	return entry->sub == 0 && (entry->access & OD_CONST) && entry->type == OD_UNSIGNED8 && strchr(entry->name, '.');
}

static const char *access_text(const struct od_entry *entry)
{
	if (entry->access & OD_CONST)
		return "const";
	if (!(entry->access & OD_WRITE))
		return "ro";
	return entry->access & OD_READ ? "rw" : "wo";
}

static void add_number(struct json_object *to, const char *key, double value)
{
	char text[32];

	snprintf(text, sizeof(text), "%.9g", value);
	json_object_object_add(to, key, json_number(text));
}

static void add_words(struct json_object *to, const struct od_entry *entry)
{
	struct json_object *words = json_object_new_object();
	struct od_word word = {0};
	char number[16];

	while (od_next_word(entry, &word)) {
		snprintf(number, sizeof(number), "%u", word.number);
		json_object_object_add(words, number, json_object_new_string_len(word.text, (int)word.length));
	}
	json_object_object_add(to, entry->words_of_bits ? "bits" : "words", words);
}

/* Of a parameter; that of an output says nothing. */
static void add_default(struct json_object *to, const struct od *defaults, const struct od_entry *entry)
{
	uint8_t wire[OD_VALUE_MAX];

	if (!(entry->access & OD_STORED) || entry->type == OD_DOMAIN)
		return;
	size_t size = od_get(defaults, entry, wire, sizeof(wire));
	json_object_object_add(to, "default", json_value(entry, entry->factor, wire, size));
}

static struct json_object *object(const struct od *defaults, const struct od_entry *entry)
{
	struct json_object *to = json_object_new_object();
	const char *dot = strchr(entry->name, '.');
	char index[8];

	snprintf(index, sizeof(index), "%04Xh", entry->index);
	json_object_object_add(to, "name", json_object_new_string(entry->name));
	json_object_object_add(to, "index", json_object_new_string(index));
	json_object_object_add(to, "sub", json_object_new_int(entry->sub));
	json_object_object_add(
		to, "record", json_object_new_string_len(entry->name, dot ? (int)(dot - entry->name) : 0));
	json_object_object_add(to, "type", json_object_new_string(eds_type_name(entry)));
	json_object_object_add(to, "access", json_object_new_string(access_text(entry)));
	json_object_object_add(to, "unit", json_object_new_string(entry->unit));
	add_number(to, "step", entry->factor);
	if (entry->access & OD_LIMIT_LOW)
		add_number(to, "low", od_number_value(entry->type, entry->low) * entry->factor);
	if (entry->access & OD_LIMIT_HIGH)
		add_number(to, "high", od_number_value(entry->type, entry->high) * entry->factor);
	add_default(to, defaults, entry);
	if (od_has_words(entry))
		add_words(to, entry);
	json_object_object_add(to, "mappable", json_object_new_boolean((entry->access & OD_TPDO) != 0));
	json_object_object_add(to, "receivable", json_object_new_boolean((entry->access & OD_RPDO) != 0));
	json_object_object_add(to, "stored", json_object_new_boolean((entry->access & OD_STORED) != 0));
	json_object_object_add(to, "text", json_object_new_string(entry->description));
	json_object_object_add(to, "bits_size", json_object_new_int(8 * entry->size));
	return to;
}

struct json_object *web_eds_objects(const struct web_eds *eds, uint8_t node_id)
{
	struct json_object *result = json_object_new_object(), *list = json_object_new_array();
	void *values = calloc(1, eds->table->values_size + 1);
	struct od defaults;

	if (values)
		od_init(&defaults, eds->table, values, node_id);
	for (size_t i = 0; values && i < eds->table->count; i++) {
		const struct od_entry *entry = &eds->table->entries[i];

		if (!is_highest_subindex(entry))
			json_object_array_add(list, object(&defaults, entry));
	}
	free(values);
	json_object_object_add(result, "objects", list);
	return result;
}

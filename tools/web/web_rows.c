/* The samples of a watched node as rows of text: made once, sent to every browser that subscribes. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "od_index.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/json_words.h"
#include "tools/web/web.h"

enum { ROW_US = 20000 /* PDOs of one sample come within this time */, TIME_TEXT = 24 };

/* ---- filling ----------------------------------------------------------------------------------------------------- */

static void end_row(const struct web *web, struct web_node *node)
{
	struct web_rows *rows = node->rows;
	struct web_row *row = &rows->rows[rows->count % WEB_ROWS];
	double t_s = ((double)rows->t_us - (double)web->start_us) / 1e6;
	size_t used = (size_t)snprintf(row->text, TIME_TEXT, "[%.6f", t_s), field = 0;

	for (size_t i = 0; i < node->watch->pdo_count; i++) {
		const struct watch_pdo *pdo = &node->watch->pdos[i];

		for (size_t j = 0; pdo->enabled && j < pdo->field_count; j++, field++) {
			const char *text = rows->has >> i & 1 ? rows->values[i * WATCH_FIELDS + j] : "null";

			row->text[used++] = ',';
			used += strlen(strcpy(row->text + used, text)); /* < 16 each: WEB_ROW_TEXT is enough */
		}
	}
	row->text[used++] = ']';
	row->size = (uint16_t)used;
	rows->count++;
	rows->expected = rows->has;
	rows->has = 0;
}

static void number_text(char text[16], double value)
{
	if (!isfinite(value))
		snprintf(text, 16, "null");
	else if (value == floor(value) && fabs(value) < 1e14)
		snprintf(text, 16, "%.0f", value);
	else
		snprintf(text, 16, "%.7g", value);
}

static void take_pdo(const struct web *web, struct web_node *node, size_t number, uint64_t t_us)
{
	struct web_rows *rows = node->rows;
	const struct watch_pdo *pdo = &node->watch->pdos[number];
	uint32_t bit = UINT32_C(1) << number;

	if (rows->has & bit)
		end_row(web, node);
	if (rows->has == 0)
		rows->t_us = t_us;
	rows->has |= bit;
	for (size_t i = 0; i < pdo->field_count; i++)
		number_text(rows->values[number * WATCH_FIELDS + i], pdo->fields[i].raw * pdo->fields[i].step);
	if ((rows->has & rows->expected) == rows->expected && rows->expected)
		end_row(web, node);
}

/* True: the rows have another meaning from now on. */
static bool is_remapped(struct web_node *node)
{
	struct web_rows *rows = node->rows;

	if (rows->configured == node->watch->configured)
		return false;
	rows->configured = node->watch->configured;
	rows->fields++;
	rows->first = rows->count;
	rows->has = rows->expected = 0;
	return true;
}

void web_rows_receive(struct web *web, struct web_node *node, const struct can_msg *msg, uint64_t now_us)
{
	struct watch *watch = node->watch;
	uint64_t before[WATCH_PDOS];

	for (size_t i = 0; i < WATCH_PDOS; i++)
		before[i] = watch->pdos[i].rate.count;
	watch_receive(watch, msg, now_us);
	if (is_remapped(node))
		return;
	if (node->rows->has && msg->id == (watch_object(watch, OD_INDEX_COB_ID_SYNC, 0) & COB_ID_MASK))
		end_row(web, node);
	for (size_t i = 0; i < watch->pdo_count; i++)
		if (watch->pdos[i].rate.count == before[i] + 1)
			take_pdo(web, node, i, msg->t_us ? msg->t_us : now_us);
}

uint64_t web_rows_tick(struct web *web, struct web_node *node, uint64_t now_us)
{
	struct web_rows *rows = node->rows;

	if (is_remapped(node) || rows->has == 0)
		return UINT64_MAX;
	if (now_us < rows->t_us + ROW_US)
		return rows->t_us + ROW_US;
	end_row(web, node);
	return UINT64_MAX;
}

/* ---- events ------------------------------------------------------------------------------------------------------ */

char *web_rows_event(const struct web *web, struct web_subscription *s, size_t *size, uint64_t now_us)
{
	const struct web_rows *rows = s->node->rows;
	uint64_t oldest = rows->count > WEB_ROWS ? rows->count - WEB_ROWS : 0;
	char *text = NULL;
	FILE *out = open_memstream(&text, size);

	if (!out)
		return NULL;
	if (s->position < oldest) {
		s->lost += oldest - s->position;
		s->position = oldest;
	}
	fprintf(out, "{\"event\":\"pdo\",\"node\":%u,\"t\":%.6f,\"rows\":[", s->node->id,
		(double)(now_us - web->start_us) / 1e6);
	for (unsigned int n = 0; n < WEB_ROWS_EVENT && s->position < rows->count; n++, s->position++) {
		const struct web_row *row = &rows->rows[s->position % WEB_ROWS];

		if (n > 0)
			fputc(',', out);
		fwrite(row->text, 1, row->size, out);
	}
	fputc(']', out);
	if (s->lost)
		fprintf(out, ",\"lost\":%llu", (unsigned long long)s->lost);
	fputc('}', out);
	s->lost = 0;
	fclose(out);
	return text;
}

static struct json_object *field_json(size_t pdo, const struct watch_field *field)
{
	struct json_object *json = json_object_new_object();
	const struct od_entry *entry = field->entry;
	char name[16];

	cli_address_text((uint16_t)(field->mapping >> 16), (uint8_t)(field->mapping >> 8), NULL, name, sizeof(name));
	json_object_object_add(json, "name", json_object_new_string(entry ? entry->name : name));
	json_object_object_add(json, "unit", json_object_new_string(entry ? entry->unit : ""));
	json_object_object_add(json, "pdo", json_object_new_int((int)pdo + 1));
	json_object_object_add(json, "bit", json_object_new_int((int)field->bit));
	json_object_object_add(json, "bits", json_object_new_int((int)field->bits));
	return json;
}

char *web_fields_event(struct web_subscription *s, size_t *size)
{
	const struct watch *watch = s->node->watch;
	struct json_object *event = json_object_new_object(), *fields = json_object_new_array();

	s->fields = s->node->rows->fields;
	if (s->position < s->node->rows->first)
		s->position = s->node->rows->first;
	json_object_object_add(event, "event", json_object_new_string("fields"));
	json_object_object_add(event, "node", json_object_new_int(s->node->id));
	for (size_t i = 0; i < watch->pdo_count; i++)
		for (size_t j = 0; watch->pdos[i].enabled && j < watch->pdos[i].field_count; j++)
			json_object_array_add(fields, field_json(i, &watch->pdos[i].fields[j]));
	json_object_object_add(event, "fields", fields);
	char *text = strdup(json_object_to_json_string_length(event, JSON_C_TO_STRING_PLAIN, size));
	json_object_put(event);
	return text;
}

#include "tools/fleet/format.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "tools/lib/cli.h"

void format_init(struct format *f, const struct format_ops *ops, const struct format_config *config, uint8_t birth)
{
	*f = (struct format){.ops = ops, .config = *config, .birth = birth};
}

const struct od_entry *format_entry(const struct format *f, uint8_t node_id, const struct record_field *field)
{
	const struct od_table *table = f->config.tables[node_id];
	const struct od_entry *entry =
		table ? od_find(table, (uint16_t)(field->mapping >> 16), (uint8_t)(field->mapping >> 8), NULL) : NULL;

	return entry && 8u * entry->size == (field->mapping & 0xFF) ? entry : NULL;
}

void format_name(const struct od_entry *entry, const struct record_field *field, char *name, size_t capacity)
{
	if (entry)
		snprintf(name, capacity, "%s", entry->name);
	else
		snprintf(name, capacity, "%04Xh:%02X", field->mapping >> 16, field->mapping >> 8 & 0xFF);
}

static struct record_field *find(struct record *values, const struct record_field *field)
{
	for (size_t i = 0; i < values->field_count; i++)
		if (values->fields[i].mapping == field->mapping)
			return &values->fields[i];
	return NULL;
}

bool format_learn(struct node_view *view, const struct record *record)
{
	bool is_new = !view->configured;

	if (!view->configured)
		view->values = (struct record){.kind = RECORD_VALUES, .node_id = record->node_id};
	view->known = view->configured = true;
	view->values.utc_us = record->utc_us;
	view->values.counted = record->counted;
	view->values.counter = record->counter;
	for (size_t i = 0; i < record->field_count; i++) {
		struct record_field *field = find(&view->values, &record->fields[i]);

		if (!field && view->values.field_count == RECORD_FIELDS)
			continue;
		is_new |= !field || field->step < record->fields[i].step || field->step > record->fields[i].step;
		if (!field)
			field = &view->values.fields[view->values.field_count++];
		*field = record->fields[i];
	}
	return is_new;
}

int format_node(const char *text)
{
	long id;

	return cli_integer(text, 1, FORMAT_NODES - 1, &id) ? (int)id : -1;
}

void format_level(const char *text, char *level, size_t capacity)
{
	snprintf(level, capacity, "%s", text);
	for (char *c = level; *c; c++)
		if (strchr("/+#:,$ ", *c) || (unsigned char)*c < ' ')
			*c = '_';
}

void format_utc(int64_t utc_us, char text[FORMAT_UTC_TEXT])
{
	bool before = utc_us % 1000000 < 0; /* of 1970: the division rounds up */
	time_t t = (time_t)(utc_us / 1000000 - before);
	struct tm utc;

	if (!gmtime_r(&t, &utc) || utc.tm_year < -1900 || utc.tm_year > 8099)
		utc = (struct tm){.tm_year = 70, .tm_mday = 1};
	strftime(text, FORMAT_UTC_TEXT, "%Y-%m-%dT%H:%M:%S", &utc);
	snprintf(text + strlen(text), FORMAT_UTC_TEXT - strlen(text), ".%06dZ",
		(int)(utc_us % 1000000 + (before ? 1000000 : 0)));
}

/* Arbitrary bytes as an EDS, parsed by both sets of rules. The result is an error text that starts with the file
 * name, or a table that the object dictionary can read, write and format. */
#include <string.h>

#include "od/od.h"
#include "tests/fuzz/fuzz.h"
#include "tools/eds/eds.h"

static void exercise(const struct od_table *table)
{
	uint8_t *values = malloc(table->values_size + 1), wire[OD_VALUE_MAX];
	struct od od;

	od_init(&od, table, values, 127);
	for (size_t i = 0; i < table->count; i++) {
		const struct od_entry *entry = &table->entries[i];
		char text[2 * OD_VALUE_MAX + 1];
		size_t length;

		if (od_find(table, entry->index, entry->sub, NULL) != entry || !*entry->name)
			abort();
		od_find_name(table, entry->name);
		if (od_read(&od, entry->index, entry->sub, wire, sizeof(wire), &length) == OD_OK &&
			od_format(entry, wire, length, text, sizeof(text)) < 0)
			abort();
		memset(wire, i & 0xFF, sizeof(wire));
		od_write(&od, entry->index, entry->sub, wire, entry->size);
	}
	free(values);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	for (int rules = EDS_LENIENT; rules <= EDS_STRICT; rules++) {
		char error[200] = "";
		struct eds eds;
		int result =
			eds_parse(&eds, "f.eds", (const char *)data, size, (enum eds_rules)rules, error, sizeof(error));

		if (result == 0)
			exercise(&eds.table);
		else if (strncmp(error, "f.eds:", 6) != 0)
			abort();
		eds_free(&eds);
	}
	return 0;
}

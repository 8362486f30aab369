/* Arbitrary bytes as a stored concise DCF. It is refused with all values unchanged, or applied, and the result
 * encodes and decodes to the same values. The same bytes are then parsed as the text of a value and as a name. */
#include <string.h>

#include "tests/fuzz/fuzz.h"
#include "od_values.h"

static void check_round_trip(struct od *od, const void *base)
{
	static struct od_values again;
	static uint8_t out[16384];
	struct od other;
	size_t skipped;
	long length = od_encode(od, OD_GROUP_ALL, base, out, sizeof(out));

	od_init(&other, od->table, &again, 1);
	if (length < 0 || od_decode(&other, out, (size_t)length, &skipped) < 0 || skipped)
		abort();
	if (memcmp(od->values, &again, sizeof(again)))
		abort();
}

static void check_text(const uint8_t *data, size_t size)
{
	const struct od_table *table = &imu9_od_table;
	const struct od_entry *entry = &table->entries[size ? data[0] % table->count : 0];
	uint8_t wire[OD_VALUE_MAX];
	char text[256], printed[256];
	size_t length = size < sizeof(text) ? size : sizeof(text) - 1;

	memcpy(text, data, length);
	text[length] = '\0';
	od_find_name(table, text);
	if (length && od_parse(entry, text + 1, wire, sizeof(wire), &length) == OD_OK &&
		od_format(entry, wire, length, printed, sizeof(printed)) < 0)
		abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static struct od_values values, base;
	struct od od;
	size_t skipped;

	od_init(&od, &imu9_od_table, &values, 1);
	base = values;
	if (od_decode(&od, data, size, &skipped) >= 0)
		check_round_trip(&od, &base);
	else if (memcmp(&values, &base, sizeof(base)))
		abort();
	check_text(data, size);
	return 0;
}

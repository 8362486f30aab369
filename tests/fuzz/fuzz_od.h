/* tests/fuzz/fuzz_od.h
 * Whatever was written, each value of the dictionary has the type and the limits of its entry. */
#ifndef TESTS_FUZZ_FUZZ_OD_H
#define TESTS_FUZZ_FUZZ_OD_H

#include "od/od.h"
#include "tests/fuzz/fuzz.h"

static inline void require_valid_values(const struct od *od)
{
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *entry = &od->table->entries[i];
		uint8_t wire[OD_VALUE_MAX];
		size_t size = od_get(od, entry, wire, sizeof(wire));

		require(entry->type == OD_DOMAIN || od_check(entry, wire, size) == OD_OK);
	}
}

#endif

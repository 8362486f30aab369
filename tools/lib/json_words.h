/* tools/lib/json_words.h
 * Words of values and bits in JSON. */
#ifndef TOOLS_LIB_JSON_WORDS_H
#define TOOLS_LIB_JSON_WORDS_H

#include <json-c/json.h>

#include "od/od.h"

/** Of an entry that has words: that of a value, NULL where it has none; or the list of those of its bits. */
struct json_object *json_words(const struct od_entry *entry, uint64_t value);

#endif

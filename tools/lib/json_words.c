#include "tools/lib/json_words.h"

#include <string.h>

#include "tools/lib/cli_value.h"

struct json_object *json_words(const struct od_entry *entry, uint64_t value)
{
	char text[CLI_VALUE_TEXT_MAX];
	struct json_object *list;

	od_words_text(entry, value, text, sizeof(text));
	if (!entry->words_of_bits)
		return text[0] ? json_object_new_string(text) : NULL;
	list = json_object_new_array();
	for (char *rest = NULL, *word = strtok_r(text, ",", &rest); word && value; word = strtok_r(NULL, ",", &rest))
		json_object_array_add(list, json_object_new_string(word));
	return list;
}

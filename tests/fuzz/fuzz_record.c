/* Arbitrary lines of a recording: what is accepted is written as a line that reads back to the same. */
#include <string.h>

#include "gateway/record_text.h"
#include "tests/fuzz/fuzz.h"

static void check_line(const char *line)
{
	char text[RECORD_ROW_MAX], again[RECORD_ROW_MAX];
	struct record_entry e;
	int rc = record_parse(line, &e);

	if (rc != 1)
		return;
	size_t n = record_text(&e, text);
	require(n > 0 && n < sizeof(text) && text[n - 1] == '\n');
	text[n - 1] = '\0';
	require(record_parse(text, &e) == 1);
	n = record_text(&e, again);
	again[n - 1] = '\0';
	require(strcmp(text, again) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	char *text = malloc(size + 1), *rest = text, *line;
	uint8_t *bytes = malloc(size + 3);

	require(text && bytes);
	memcpy(text, data, size);
	text[size] = '\0';
	require(record_from_base64(text, strlen(text), bytes) <= (long)size);
	while ((line = strsep(&rest, "\n")) != NULL)
		check_line(line);
	free(text);
	free(bytes);
	return 0;
}

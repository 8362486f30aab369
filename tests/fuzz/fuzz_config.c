/* Arbitrary bytes as the configuration file, and its first line as the argument of --set. An error is one line that
 * starts with the file's name or the name of what is wrong; without one all values have the limits of their objects. */
#include <string.h>

#include "gateway/config.h"
#include "od_values.h"
#include "tests/fuzz/fuzz_od.h"

static void check_error(const char *error)
{
	size_t length = strnlen(error, CONFIG_ERROR_MAX);

	require(length > 0 && length < CONFIG_ERROR_MAX && strchr(error, '\n') == NULL);
}

static void check_values(const struct config *config)
{
	static struct od_values values;
	struct od od;

	od_init(&od, &imu9_od_table, &values, 1);
	config_apply(config, &od);
	require_valid_values(&od);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static struct config config;
	char error[CONFIG_ERROR_MAX] = "", text[CONFIG_TEXT_MAX];
	size_t length = size < sizeof(text) ? size : sizeof(text) - 1;

	config_init(&config, &imu9_od_table);
	if (config_file(&config, fuzz_file(data, size), error) != 0)
		check_error(error);
	memcpy(text, data, length);
	text[length] = '\0';
	text[strcspn(text, "\n")] = '\0';
	if (config_set(&config, text, error) != 0)
		check_error(error);
	check_values(&config);
	require(config.node_id >= 1 && (config.node_id <= 127 || config.node_id == 255));
	return 0;
}

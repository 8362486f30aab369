#include "drivers/can/bus_options.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BIT_RATE_MIN = 5000, BIT_RATE_MAX = 1000000 };

static bool parse_bit_rate(const char *text, uint32_t *bit_s)
{
	char *end;
	unsigned long value = strtoul(text, &end, 10);

	if (text[0] < '0' || text[0] > '9' || *end != '\0' || value < BIT_RATE_MIN || value > BIT_RATE_MAX)
		return false;
	*bit_s = (uint32_t)value;
	return true;
}

static bool parse_sample_point(const char *text, uint32_t *permille)
{
	char *end;
	double value = strtod(text, &end);

	if (end == text || *end != '\0' || !(value >= 0.5 && value <= 0.95))
		return false;
	*permille = (uint32_t)(value * 1000 + 0.5);
	return true;
}

static bool parse_option(struct bus_options *options, const char *option)
{
	if (strncmp(option, "bitrate=", 8) == 0)
		return parse_bit_rate(option + 8, &options->bit_s);
	if (strncmp(option, "sample-point=", 13) == 0)
		return parse_sample_point(option + 13, &options->sample_point_permille);
	options->listen_only = true;
	return strcmp(option, "listen-only") == 0;
}

int bus_options_parse(struct bus_options *options, const char *text, char *error, size_t error_size)
{
	char copy[BUS_ADDRESS_MAX], *rest = copy, *option;

	*options = (struct bus_options){.bit_s = BUS_BIT_RATE_DEFAULT};
	if (strlen(text) >= sizeof(copy)) {
		snprintf(error, error_size, "'%.40s...' is too long for a bus: use at most 199 characters", text);
		return -EINVAL;
	}
	strcpy(copy, text);
	strcpy(options->address, strsep(&rest, ","));
	while ((option = strsep(&rest, ",")) != NULL)
		if (!parse_option(options, option)) {
			snprintf(error, error_size,
				"unknown bus option or bad value '%s': use bitrate=%d to %d, sample-point=0.5 to 0.95 "
				"or "
				"listen-only",
				option, BIT_RATE_MIN, BIT_RATE_MAX);
			return -EINVAL;
		}
	return 0;
}

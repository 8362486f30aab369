#include "tools/lib/cli_config.h"

#include "tools/lib/cli.h"

void cli_config_files(struct config *config, int argc, char **argv, const char *letters, const struct option *options)
{
	char why[CONFIG_ERROR_MAX];
	int option;

	opterr = 0;
	optind = 0; /* glibc: restart the scan */
	while ((option = getopt_long(argc, argv, letters, options, NULL)) != -1)
		if (option == 'c' && config_file(config, optarg, why) < 0)
			cli_usage_error("%s", why);
	optind = 0;
}

void cli_config_set(struct config *config, const char *assignment)
{
	char why[CONFIG_ERROR_MAX];

	if (config_set(config, assignment, why) < 0)
		cli_usage_error("%s", why);
}

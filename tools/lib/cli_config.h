/* tools/lib/cli_config.h
 * The gateway's configuration on the command line of a tool. */
#ifndef TOOLS_LIB_CLI_CONFIG_H
#define TOOLS_LIB_CLI_CONFIG_H

#include <getopt.h>

#include "gateway/config.h"

/** Takes the files of every -c (`letters` has c:), for which getopt_long() goes through all arguments once and then starts
 * anew: as in the gateway, a file comes before --set whatever the order. A bad one ends the program with CLI_USAGE. */
void cli_config_files(struct config *config, int argc, char **argv, const char *letters, const struct option *options);
/** NAME=VALUE of --set; a bad one ends the program with CLI_USAGE. */
void cli_config_set(struct config *config, const char *assignment);

#endif

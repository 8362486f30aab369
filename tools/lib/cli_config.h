/* tools/lib/cli_config.h
 * The configuration of the gateway on the command line of a tool. */
#ifndef TOOLS_LIB_CLI_CONFIG_H
#define TOOLS_LIB_CLI_CONFIG_H

#include <getopt.h>

#include "gateway/config.h"

/** Reads the files of all -c options (`letters` contains c:) in a first pass of getopt_long() over the arguments, and
 * resets it for the second one: as in the gateway, --set overrides a file whatever their order. An invalid file ends
 * the program with CLI_USAGE. */
void cli_config_files(struct config *config, int argc, char **argv, const char *letters, const struct option *options);
/** NAME=VALUE of --set; an invalid one ends the program with CLI_USAGE. */
void cli_config_set(struct config *config, const char *assignment);

#endif

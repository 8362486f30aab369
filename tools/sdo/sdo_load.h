/* tools/sdo/sdo_load.h
 * The transfer of a configuration to a node, and its comparison with that of the node. */
#ifndef TOOLS_SDO_SDO_LOAD_H
#define TOOLS_SDO_SDO_LOAD_H

#include "tools/lib/settings.h"
#include "tools/sdo/sdo_session.h"

/** Writes the values that differ, reports failures and counts. Returns the exit code. */
int sdo_load(struct session *s, struct settings *settings);
/** Prints the differences. CLI_FAILED if there are any. */
int sdo_compare(struct session *s, struct settings *settings);

#endif

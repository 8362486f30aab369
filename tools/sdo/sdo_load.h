/* tools/sdo/sdo_load.h
 * A configuration in memory, and its transfer to a node: only values that differ, PDOs by the mapping procedure. */
#ifndef TOOLS_SDO_SDO_LOAD_H
#define TOOLS_SDO_SDO_LOAD_H

#include "tools/sdo/sdo_session.h"

enum { SETTINGS_MAX = 4096 };

struct setting {
	const struct od_entry *entry;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
};

struct settings {
	const struct session *session;
	struct setting list[SETTINGS_MAX];
	size_t count;
	long node_id; /* node-ID of the configuration; 0: not in the file */
};

/** Writes the values that differ, reports failures and counts. Returns the exit code. */
int sdo_load(struct session *s, struct settings *settings);
/** Prints the differences. CLI_FAILED if there are any. */
int sdo_compare(struct session *s, struct settings *settings);

#endif

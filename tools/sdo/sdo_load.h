/* tools/sdo/sdo_load.h
 * A configuration in memory, and the way it gets into a node: only what differs, PDOs by the mapping procedure. */
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
	long node_id; /* whose configuration it is; 0: the file does not say */
};

/** Writes what differs, says what failed and how many were written. The exit code. */
int sdo_load(struct session *s, struct settings *settings);
/** Prints what differs. CLI_FAILED when something does. */
int sdo_compare(struct session *s, struct settings *settings);

#endif

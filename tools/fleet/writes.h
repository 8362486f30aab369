/* tools/fleet/writes.h
 * Writes that a subscriber asks for: only of objects that are allowed, with the types and limits of the EDS, by SDO,
 * and with an answer for each. Passive; the thread of the bus. */
#ifndef TOOLS_FLEET_WRITES_H
#define TOOLS_FLEET_WRITES_H

#include "tools/fleet/fleet.h"
#include "tools/fleet/format.h"

enum { WRITES_ALLOWED = 64 };

struct writes {
	struct writes_allowed {
		uint16_t index;
		int sub;	   /* -1: all */
	} allowed[WRITES_ALLOWED]; /* set by the caller, as are the two below */
	size_t allowed_count;
	const char *bus; /* in the answers */

	/* PRIVATE */
	struct writes_node {
		struct command waiting[WATCH_COMMANDS]; /* for the node; oldest first */
		size_t count;
		unsigned done; /* watch.commands_done */
	} nodes[FLEET_NODES];
	size_t waiting_count; /* of all */
};

/** Checks the command and gives it to the node; refuses it with an answer otherwise. */
void writes_submit(
	struct writes *w, struct fleet *fleet, const struct command *command, uint64_t now_us, int64_t utc_offset_us);
/** After each fleet_receive() and fleet_tick(): answers what is done. */
void writes_poll(struct writes *w, struct fleet *fleet, uint64_t now_us, int64_t utc_offset_us);

#endif

/* tools/lib/settings.h
 * A configuration in memory: read from a file of names and values or from a DCF, written as such a file, and loaded
 * into a node, only what differs, by the procedures of CiA 301. Passive: a plan says what to read and then what to
 * write; how the transfers are made is up to the caller. */
#ifndef TOOLS_LIB_SETTINGS_H
#define TOOLS_LIB_SETTINGS_H

#include <stdbool.h>
#include <stdio.h>

#include "od/od.h"
#include "tools/eds/eds.h"

enum { SETTINGS_MAX = 4096 };

struct setting {
	const struct od_entry *entry;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
};

struct settings {
	const struct od_table *table; /* of the entries */
	struct setting list[SETTINGS_MAX];
	size_t count;
	long node_id; /* node-ID of the configuration; 0: not in the file */
};

/** Whether an entry can be copied to another node: stored and writable. */
bool settings_has(const struct od_entry *entry);

/** Reads NAME = VALUE lines for settings->table. False: `error` has "path:line: what". */
bool settings_read(struct settings *settings, FILE *file, const char *path, char *error, size_t error_size);
/** Takes the ParameterValues of a DCF for this node-ID; settings->table becomes that of the DCF, which outlives it. */
bool settings_take_dcf(struct settings *settings, const struct eds *dcf, const char *path, uint8_t node_id, char *error,
	size_t error_size);
/** COB-IDs that have the default for the node of the file get the default for this node. */
void settings_move_to_node(struct settings *settings, long node_id);

/** One line of a file that settings_read() reads. False: the value does not have the type of the entry. */
bool settings_write_value(FILE *out, const struct od_entry *entry, const uint8_t *wire, size_t size);

/** Gets a value of the node. False: it has none. */
typedef bool settings_value(void *ctx, const struct od_entry *entry, uint8_t wire[OD_VALUE_MAX], size_t *size);
/** Copies an EDS line by line as a DCF: [DeviceComissioning], and the value behind each configuration object of
 * `table`. Values that `value` does not get, or that have another type, are left out: these are added to `failed`, the
 * others to `saved`. */
void settings_write_dcf(FILE *out, const struct od_table *table, const char *eds, size_t size, long node_id,
	settings_value *value, void *ctx, int *saved, int *failed);

/* ---- loading into a node ---- */

struct settings_read {
	const struct od_entry *entry;
	bool needed; /* without it something cannot be written; else it only shows what differs */
	bool done;   /* set by the caller, with: */
	size_t size;
	uint8_t wire[OD_VALUE_MAX];
};

struct settings_write {
	const struct od_entry *entry;
	size_t size;
	uint8_t wire[OD_VALUE_MAX];

	/* PRIVATE */
	unsigned int group; /* what is left of a group after a failure is not written */
	enum { SETTINGS_IF_GOOD, SETTINGS_AFTER_FAILURE, SETTINGS_ALWAYS } when;
	int counts; /* settings that the node has by then */
};

struct settings_plan { /* all 0 */
	struct settings_read *reads;
	size_t read_count;
	int written, same, failed;

	/* PRIVATE */
	const struct settings *settings;
	struct settings_write *writes;
	size_t read_room, write_count, write_room, at;
	unsigned int group, failed_group;
	bool out_of_memory;
};

/** What to read first: plan->reads, in this order. `settings` outlives the plan. False: out of memory. Free it in both
 * cases. */
bool settings_plan_reads(struct settings_plan *plan, const struct settings *settings);
/** After the reads: what to write. Counts in `failed` the needed reads that are not done. False: out of memory. */
bool settings_plan_writes(struct settings_plan *plan);
/** The next write, after the last one that this function returned was done or has failed; NULL: that was all. */
const struct settings_write *settings_plan_next(struct settings_plan *plan, bool failed);
void settings_plan_free(struct settings_plan *plan);

#endif

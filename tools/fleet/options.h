/* tools/fleet/options.h
 * The configuration of imu9-fleet: defaults, FILE (INI, section [fleet], keys as the options with '_'), command
 * line. */
#ifndef TOOLS_FLEET_OPTIONS_H
#define TOOLS_FLEET_OPTIONS_H

#include "tools/eds/eds.h"
#include "tools/fleet/fleet.h"
#include "tools/fleet/sender.h"
#include "tools/fleet/writes.h"

enum { OPTIONS_TEXT_MAX = 256, OPTIONS_ERROR_MAX = 512, OPTIONS_LIST_MAX = 32 };

struct options {
	char bus[OPTIONS_TEXT_MAX];
	struct fleet_config fleet;
	struct sender_config sender;
	struct writes writes; /* what is allowed */

	/* PRIVATE */
	char broker[OPTIONS_TEXT_MAX], topic[OPTIONS_TEXT_MAX], name[OPTIONS_TEXT_MAX], spool[OPTIONS_TEXT_MAX];
	char nodes[OPTIONS_TEXT_MAX], credentials[OPTIONS_TEXT_MAX];
	char change[OPTIONS_LIST_MAX][OPTIONS_TEXT_MAX]; /* OBJECT=X */
	size_t change_count;
	char allow[OPTIONS_LIST_MAX][OPTIONS_TEXT_MAX]; /* OBJECT,... */
	size_t allow_count;
	char eds_names[OPTIONS_LIST_MAX][OPTIONS_TEXT_MAX]; /* [NODE=]FILE */
	struct eds eds[OPTIONS_LIST_MAX];
	size_t eds_count;
	char spool_folder[OPTIONS_TEXT_MAX * 2];
};

void options_init(struct options *o);
/** These return 0, or -errno and one line in why[OPTIONS_ERROR_MAX]. */
int options_file(struct options *o, const char *path, char *why);
/** A key of the file or a long option: "node_id" or "node-id". -ENOENT: there is no such one. */
int options_set(struct options *o, const char *key, const char *value, char *why);
/** All are set: reads the files that they name, and completes `fleet` and `sender`. */
int options_finish(struct options *o, char *why);
void options_free(struct options *o);

#endif

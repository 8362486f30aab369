/* tools/sdo/sdo_session.h
 * Shared by the commands of imu9-sdo. Each command is one function: it returns the exit code, or ends the program with
 * a usage error. */
#ifndef TOOLS_SDO_SDO_SESSION_H
#define TOOLS_SDO_SDO_SESSION_H

#include <stdio.h>

#include "tools/lib/cli.h"
#include "tools/lib/cli_node.h"
#include "tools/eds/eds.h"

enum { SDO_TARGETS_MAX = 512, SDO_DOMAIN_MAX = 4 << 20, SDO_STRING_MAX = 1024 /* of other devices */ };

struct session {
	const char *bus;
	long node_id;
	const char *eds_path; /* NULL: the built-in EDS of the IMU9 gateway */
	unsigned int timeout_ms;
	bool timeout_given;
	bool quiet;
	bool json;

	const struct od_table *table;
	struct cli_node node;
	const struct od_entry *resolution; /* the last one read, and its step */
	double step;
};

/** An object named on the command line. */
struct target {
	uint16_t index;
	uint8_t sub;
	const struct od_entry *entry; /* NULL: not in the EDS */
};

/** An object, or all members of a record. Returns the count; an unknown object is a usage error, more than `capacity`,
 * too. */
size_t sdo_targets(const struct session *s, const char *text, struct target *targets, size_t capacity);
/** "0.05 m", or the value without unit with -q. */
void sdo_value_text(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, char *text, size_t capacity);
/** The physical value of one step by the resolution objects of the node. */
double sdo_step(struct session *s, const struct od_entry *entry);
void sdo_target_name(const struct target *target, char *name, size_t capacity);

void sdo_open(struct session *s);
void sdo_close(struct session *s);
/** Sends a frame and waits until it has left. False after a message. */
bool sdo_send_frame(const struct session *s, struct can_port *bus, const struct can_msg *msg);
/** Writes the result of a save command to `path` ('-': standard output) and reports the counts. The exit code. */
int sdo_finish_save(const struct session *s, const char *path, const char *text, size_t size, int saved, int failed);

/** Removes an option of a command from its arguments. Returns whether it was given, or its value or NULL. */
bool sdo_extract_flag(int *argc, char **argv, const char *option);
const char *sdo_extract_value(int *argc, char **argv, const char *option);

uint64_t sdo_number(const uint8_t *wire, size_t size);
void sdo_put_u32(uint8_t *wire, uint32_t value);

/** Writes a complete file; '-': standard output, with '?' for unprintable bytes if it is a terminal. */
bool sdo_write_file(const char *path, const void *data, size_t size);
/** Allocated content of a file, or NULL after a message; '-': standard input. */
uint8_t *sdo_read_file(const char *path, size_t *size);
/** A stream that writes to *text, allocated; the program ends when there is no memory. */
FILE *sdo_open_text(char **text, size_t *size);

/* sdo_object.c */
int sdo_command_read(struct session *s, int argc, char **argv);
int sdo_command_write(struct session *s, int argc, char **argv);
int sdo_command_objects(struct session *s, int argc, char **argv);
int sdo_command_dump(struct session *s, int argc, char **argv);
int sdo_command_log(struct session *s, int argc, char **argv);
/* sdo_watch.c */
int sdo_command_watch(struct session *s, int argc, char **argv);
/* sdo_file.c */
int sdo_command_save(struct session *s, int argc, char **argv);
int sdo_command_load(struct session *s, int argc, char **argv);
/* sdo_control.c */
int sdo_command_store(struct session *s, int argc, char **argv);
int sdo_command_restore(struct session *s, int argc, char **argv);
int sdo_command_nmt(struct session *s, int argc, char **argv);
/* sdo_scan.c */
/** How many nodes answer on the bus, and the lowest of their node-IDs; below 0 after a message. */
int sdo_find_nodes(struct session *s, uint8_t *first);
int sdo_command_scan(struct session *s, int argc, char **argv);
/* sdo_lss.c */
int sdo_command_lss(struct session *s, int argc, char **argv);
/* sdo_dbc.c */
int sdo_command_dbc(struct session *s, int argc, char **argv);
/* sdo_dcf.c */
int sdo_command_dcf(struct session *s, int argc, char **argv);

#endif

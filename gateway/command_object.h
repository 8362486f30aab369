/* gateway/command_object.h
 * What the objects that run a procedure on command have in common (2060h, 2061h). A write to sub-index 1 starts it,
 * accepts or discards its result, or aborts it (0); another sub-index shows the state. One procedure runs at a time,
 * and none without samples. Passive, one thread. */
#ifndef GATEWAY_COMMAND_OBJECT_H
#define GATEWAY_COMMAND_OBJECT_H

#include <stdbool.h>
#include <stdint.h>

#include "od/od.h"

/** 2060h:2, 2061h:2 */
enum command_state {
	COMMAND_IDLE = 0,
	COMMAND_RUNNING = 1,
	COMMAND_DONE = 2,    /* the result can be accepted or discarded */
	COMMAND_REFUSED = 3, /* no result: see the verdict */
};

struct command_object;

/** Shared by the command objects of a device. Zeroed: nothing runs. */
struct command_group {
	struct command_object *running; /* NULL: none */
	bool sensor_lost;		/* until the next sample */
	/** "started", "done", "refused", "accepted", "discarded", "stopped"; may be NULL. */
	void (*on_event)(void *ctx, const struct command_object *c, const char *event);
	void *ctx;
};

struct command_object {
	/* set by its owner */
	struct command_group *group;
	uint16_t index;
	uint8_t starts; /* the commands 1 to `starts` start it */
	uint8_t accept; /* the commands that accept and discard the result */
	uint8_t discard;
	uint8_t aborted; /* verdicts */
	uint8_t sensor_lost;
	uint8_t *state, *verdict; /* the values of the object */
	/** OD_OK: it runs. */
	enum od_status (*on_start)(void *ctx, uint8_t command);
	/** Writes the result to the configuration. OD_OK, or why not; then the result is kept. */
	enum od_status (*on_accept)(void *ctx);
	/** Clears the result. */
	void (*on_clear)(void *ctx);
	void *ctx;

	struct od_hook hook; /* PRIVATE */
};

/** Attaches to the dictionary; to be reset then. */
void command_object_attach(struct command_object *c, struct od *od);
/** Idle, without a result. */
void command_object_reset(struct command_object *c);
bool command_object_running(const struct command_object *c);
/** The procedure has ended with this verdict. */
void command_object_end(struct command_object *c, bool good, uint8_t verdict);

/** The sensor delivers samples. */
void command_group_sample(struct command_group *g);
/** The sensor has failed: what runs is refused, and so is a start until the next sample. */
void command_group_sensor_lost(struct command_group *g);
/** STATUS_COMMISSIONING, or 0. */
unsigned command_group_status(const struct command_group *g);

#endif

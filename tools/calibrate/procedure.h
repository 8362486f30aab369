/* tools/calibrate/procedure.h
 * What the calibration (2061h) and the identification of the lever arm (2060h) on the bus have in common: commands,
 * values, the dialogue. Failures print why and return false. */
#ifndef TOOLS_CALIBRATE_PROCEDURE_H
#define TOOLS_CALIBRATE_PROCEDURE_H

#include <stdio.h>

#include "tools/lib/cli_node.h"

enum { PROCEDURE_COMMAND = 1, PROCEDURE_STATE = 2, PROCEDURE_ABORT = 0 };
enum { PROCEDURE_RUNNING = 1, PROCEDURE_DONE = 2 };

/** For a program that leads through several procedures: it asks whether to start this one. */
struct procedure_lead {
	const char *prompt;
	char answer[64]; /* to the prompt; empty: start */
	FILE *report;	 /* gets the result, too */
};

struct procedure {
	struct cli_node node;
	uint16_t object; /* 2060h or 2061h */
	int signal_fd;
	bool yes;		     /* ask nothing */
	struct procedure_lead *lead; /* or NULL */
};

bool procedure_command(struct procedure *p, uint8_t value);
/** Likewise, with what to do when the gateway is not ready. */
bool procedure_start(struct procedure *p, uint8_t value);
bool procedure_byte(struct procedure *p, uint8_t sub, uint8_t *value);
bool procedure_real(struct procedure *p, uint8_t sub, float *value);
bool procedure_write_real(struct procedure *p, uint8_t sub, float value);

/** Asks, and gives the line without its end; false when a signal arrives before, or at the end of the input. */
bool procedure_ask(const struct procedure *p, const char *prompt, char *answer, int size);
/** Likewise; true for y, and without asking if `yes`. */
bool procedure_agree(const struct procedure *p, const char *prompt);
/** Says what to do and how long it takes. On a terminal, or if there is a lead, it then waits for Enter, unless `yes`.
 * False: not now. */
bool procedure_begin(const struct procedure *p, const char *what_to_do);
/** A part of the result, on standard output and in the report. */
void procedure_result(const struct procedure *p, const char *format, ...) __attribute__((format(printf, 2, 3)));
/** Progress: overwrites one line on a terminal; elsewhere each change gets a new line. */
void procedure_show(const char *text);
/** Waits, and receives frames meanwhile. True: a signal. */
bool procedure_pause(struct procedure *p, uint64_t us);
/** Calls `show` until the procedure ends. False: the node does not answer, or the user stopped it. */
bool procedure_watch(struct procedure *p, bool (*show)(struct procedure *p, void *ctx), void *ctx, uint8_t *state);
/** Asks whether to accept, unless `yes`; sends the command `accept` or `discard`. False: not accepted. */
bool procedure_accept(struct procedure *p, uint8_t accept, uint8_t discard);

#endif

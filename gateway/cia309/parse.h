/* gateway/cia309/parse.h
 * One line of CiA 309-3 as a command: "[" sequence "]" [[net] node] command, and a comment behind #. Pure. */
#ifndef GATEWAY_CIA309_PARSE_H
#define GATEWAY_CIA309_PARSE_H

#include <stddef.h>
#include <stdint.h>

#include "gateway/cia309/value.h"

/** Internal errors of CiA 309-3 that occur here. */
enum cia309_error {
	CIA309_OK = 0,
	CIA309_NOT_SUPPORTED = 100,
	CIA309_SYNTAX = 101,
	CIA309_STATE = 102, /* not possible now, or not permitted */
	CIA309_TIMEOUT = 103,
	CIA309_NO_NODE = 105, /* none in the command, and no default */
	CIA309_BAD_NET = 106,
	CIA309_BAD_NODE = 107,
	CIA309_NMT_STATE = 204,
	CIA309_BUS_OFF = 301,
	CIA309_CAN_FULL = 303,
	CIA309_PDO_LENGTH = 401,
	CIA309_LSS = 501,
	CIA309_LSS_NODE = 502,
	CIA309_LSS_BIT_RATE = 503,
	CIA309_LSS_STORE = 504,
	CIA309_MEMORY = 600,
};

enum cia309_verb {
	CIA309_NOTHING, /* an empty line, or a comment */
	CIA309_READ,
	CIA309_WRITE,
	CIA309_READ_PDO,  /* number: the PDO */
	CIA309_WRITE_PDO, /* numbers: the PDO, how many values, and those */
	CIA309_START,
	CIA309_STOP,
	CIA309_PREOP,
	CIA309_RESET_NODE,
	CIA309_RESET_COMM,
	CIA309_SET_NETWORK,
	CIA309_SET_NODE,
	CIA309_SET_SDO_TIMEOUT,
	CIA309_SET_SDO_BLOCK,
	CIA309_LSS_SWITCH_GLOBAL,
	CIA309_LSS_SWITCH_SELECTIVE, /* numbers: the LSS address */
	CIA309_LSS_SET_NODE,
	CIA309_LSS_CONFIGURE_BIT_RATE, /* numbers: table, index */
	CIA309_LSS_ACTIVATE_BIT_RATE,
	CIA309_LSS_STORE_CONFIGURATION,
	CIA309_LSS_INQUIRE, /* a number: which part of the LSS address; none: all */
	CIA309_LSS_GET_NODE,
	CIA309_LSS_FASTSCAN,
	CIA309_LSS_ALL_NODES, /* numbers: timeout; first node-ID, store; for each part of the address how, and value */
	CIA309_VERSION,
	CIA309_HELP,
	CIA309_HELP_TYPES,
	CIA309_HELP_LSS,
	CIA309_LOG,
};

enum { CIA309_NUMBERS = 11, CIA309_ABSENT = -1 };

struct cia309_command {
	uint32_t sequence;
	int net, node; /* or CIA309_ABSENT */
	enum cia309_verb verb;
	uint16_t index; /* READ, WRITE */
	uint8_t sub;
	const struct cia309_type *type;
	const char *value; /* WRITE: the rest of the line, for cia309_scan() */
	size_t value_length;
	uint64_t numbers[CIA309_NUMBERS];
	unsigned count; /* of numbers */
};

/** `line` has no line break. 0, or an enum cia309_error; then `sequence` is the line's if it has one, else 0. */
enum cia309_error cia309_parse(const char *line, size_t length, struct cia309_command *command);

/** "Syntax error." */
const char *cia309_error_text(enum cia309_error error);

#endif

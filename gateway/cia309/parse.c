#include "gateway/cia309/parse.h"

#include <ctype.h>
#include <string.h>
#include <strings.h>

#include "od/od.h"

enum { WORD_MAX = 24, NODE_MAX = 127 };

struct line {
	const char *at, *end;
	char word[WORD_MAX]; /* the last one */
};

static bool is_blank(char c)
{
	return !isgraph((unsigned char)c);
}

static bool at_end(struct line *l)
{
	while (l->at < l->end && is_blank(*l->at))
		l->at++;
	return l->at == l->end || *l->at == '#';
}

/* False: there is none, or it is longer than any word of the language. */
static bool next_word(struct line *l)
{
	size_t n = 0;

	if (at_end(l))
		return false;
	while (l->at < l->end && !is_blank(*l->at) && *l->at != '#') {
		if (n + 1 == sizeof(l->word))
			return false;
		l->word[n++] = *l->at++;
	}
	l->word[n] = '\0';
	return true;
}

static bool word_is(const struct line *l, const char *word)
{
	return strcasecmp(l->word, word) == 0;
}

/* Decimal, or hexadecimal with 0x. */
static bool number_of(const char *text, uint64_t high, uint64_t *number)
{
	const struct od_entry entry = {.type = OD_UNSIGNED64, .size = 8};
	uint8_t wire[8];
	size_t size;

	if (!isdigit((unsigned char)text[0]) || od_parse(&entry, text, wire, sizeof(wire), &size) != OD_OK)
		return false;
	*number = 0;
	for (size_t i = size; i > 0; i--)
		*number = *number << 8 | wire[i - 1];
	return *number <= high;
}

static bool next_number(struct line *l, uint64_t high, uint64_t *number)
{
	return next_word(l) && number_of(l->word, high, number);
}

static enum cia309_error sequence(struct line *l, struct cia309_command *c)
{
	uint64_t number;
	size_t n;

	if (!next_word(l))
		return CIA309_SYNTAX;
	n = strlen(l->word);
	if (l->word[0] != '[' || l->word[n - 1] != ']')
		return CIA309_SYNTAX;
	l->word[n - 1] = '\0';
	if (!number_of(l->word + 1, UINT32_MAX, &number))
		return CIA309_SYNTAX;
	c->sequence = (uint32_t)number;
	return CIA309_OK;
}

/* ---- read and write ---------------------------------------------------------------------------------------------- */

static enum cia309_error object(struct line *l, struct cia309_command *c)
{
	uint64_t index, sub;

	if (!number_of(l->word, UINT16_MAX, &index) || !next_number(l, UINT8_MAX, &sub))
		return CIA309_SYNTAX;
	c->index = (uint16_t)index;
	c->sub = (uint8_t)sub;
	c->type = &CIA309_TYPE_HEX;
	if (c->verb == CIA309_READ && at_end(l))
		return CIA309_OK;
	if (!next_word(l) || !(c->type = cia309_type(l->word)))
		return CIA309_SYNTAX;
	if (c->verb == CIA309_READ)
		return at_end(l) ? CIA309_OK : CIA309_SYNTAX;
	if (at_end(l))
		return CIA309_SYNTAX;
	c->value = l->at;
	c->value_length = (size_t)(l->end - l->at);
	return CIA309_OK;
}

/* "pdo" number; of a write how many values, and the values. */
static enum cia309_error pdo(struct line *l, struct cia309_command *c)
{
	c->verb = c->verb == CIA309_READ ? CIA309_READ_PDO : CIA309_WRITE_PDO;
	if (!next_number(l, 512, &c->numbers[c->count++]) || c->numbers[0] == 0)
		return CIA309_SYNTAX;
	if (c->verb == CIA309_READ_PDO)
		return at_end(l) ? CIA309_OK : CIA309_SYNTAX;
	if (!next_number(l, 8, &c->numbers[c->count++]))
		return CIA309_SYNTAX;
	for (uint64_t i = 0; i < c->numbers[1]; i++)
		if (!next_number(l, UINT64_MAX, &c->numbers[c->count++]))
			return CIA309_SYNTAX;
	return at_end(l) ? CIA309_OK : CIA309_SYNTAX;
}

static enum cia309_error access(struct line *l, struct cia309_command *c)
{
	if (!next_word(l))
		return CIA309_SYNTAX;
	return word_is(l, "p") || word_is(l, "pdo") ? pdo(l, c) : object(l, c);
}

/* ---- the other commands: one or two words, then numbers ---------------------------------------------------------- */

#define COUNT(n) (1u << (n))
#define ANY	 UINT32_MAX

static const struct rule {
	const char *name, *second;
	enum cia309_verb verb;
	bool node;	 /* "[[net] node]" before it; else "[net]" */
	unsigned counts; /* of numbers: COUNT(n) | ... */
	uint32_t low[3], high[3];
} RULES[] = {
	{"r", NULL, CIA309_READ, .node = true},
	{"read", NULL, CIA309_READ, .node = true},
	{"w", NULL, CIA309_WRITE, .node = true},
	{"write", NULL, CIA309_WRITE, .node = true},
	{"start", NULL, CIA309_START, .node = true, .counts = COUNT(0)},
	{"stop", NULL, CIA309_STOP, .node = true, .counts = COUNT(0)},
	{"preop", NULL, CIA309_PREOP, .node = true, .counts = COUNT(0)},
	{"preoperational", NULL, CIA309_PREOP, .node = true, .counts = COUNT(0)},
	{"reset", "node", CIA309_RESET_NODE, .node = true, .counts = COUNT(0)},
	{"reset", "comm", CIA309_RESET_COMM, .node = true, .counts = COUNT(0)},
	{"reset", "communication", CIA309_RESET_COMM, .node = true, .counts = COUNT(0)},
	{"set", "network", CIA309_SET_NETWORK, .counts = COUNT(1), .high = {UINT16_MAX}},
	{"set", "node", CIA309_SET_NODE, .counts = COUNT(1), .low = {1}, .high = {NODE_MAX}},
	{"set", "sdo_timeout", CIA309_SET_SDO_TIMEOUT, .counts = COUNT(1), .low = {1}, .high = {UINT16_MAX}},
	{"set", "sdo_block", CIA309_SET_SDO_BLOCK, .counts = COUNT(1), .high = {1}},
	{"lss_switch_glob", NULL, CIA309_LSS_SWITCH_GLOBAL, .counts = COUNT(1), .high = {1}},
	{"lss_switch_sel", NULL, CIA309_LSS_SWITCH_SELECTIVE, .counts = COUNT(4), .high = {ANY, ANY, ANY}},
	{"lss_set_node", NULL, CIA309_LSS_SET_NODE, .counts = COUNT(1), .high = {UINT8_MAX}},
	{"lss_conf_bitrate", NULL, CIA309_LSS_CONFIGURE_BIT_RATE, .counts = COUNT(2), .high = {0, 9}},
	{"lss_activate_bitrate", NULL, CIA309_LSS_ACTIVATE_BIT_RATE, .counts = COUNT(1), .high = {UINT16_MAX}},
	{"lss_store", NULL, CIA309_LSS_STORE_CONFIGURATION, .counts = COUNT(0)},
	{"lss_inquire_addr", NULL, CIA309_LSS_INQUIRE, .counts = COUNT(0) | COUNT(1), .high = {3}},
	{"lss_get_node", NULL, CIA309_LSS_GET_NODE, .counts = COUNT(0)},
	{"_lss_fastscan", NULL, CIA309_LSS_FASTSCAN, .counts = COUNT(0) | COUNT(1), .high = {UINT16_MAX}},
	{"lss_allnodes", NULL, CIA309_LSS_ALL_NODES, .counts = COUNT(0) | COUNT(1) | COUNT(3) | COUNT(11),
		.low = {0, 1}, .high = {UINT16_MAX, NODE_MAX, 1}},
	{"info", "version", CIA309_VERSION, .counts = COUNT(0)},
	{"help", "datatype", CIA309_HELP_TYPES, .counts = COUNT(0)},
	{"help", "lss", CIA309_HELP_LSS, .counts = COUNT(0)},
	{"help", NULL, CIA309_HELP, .counts = COUNT(0)},
	{"log", NULL, CIA309_LOG, .counts = COUNT(0)},
};

/* What cannot be said by one range for each number. */
static bool valid(const struct cia309_command *c)
{
	if (c->verb == CIA309_LSS_SET_NODE)
		return c->numbers[0] <= NODE_MAX || c->numbers[0] == UINT8_MAX;
	if (c->verb == CIA309_LSS_CONFIGURE_BIT_RATE)
		return c->numbers[1] != 5; /* reserved */
	if (c->verb == CIA309_LSS_ALL_NODES)
		for (unsigned i = 3; i < c->count; i += 2)
			if (c->numbers[i] > 2)
				return false;
	return true;
}

static enum cia309_error numbers(struct line *l, const struct rule *rule, struct cia309_command *c)
{
	while (!at_end(l)) {
		uint32_t high = c->count < 3 ? rule->high[c->count] : ANY;
		uint32_t low = c->count < 3 ? rule->low[c->count] : 0;

		if (c->count == CIA309_NUMBERS || !next_number(l, high, &c->numbers[c->count]) ||
			c->numbers[c->count] < low)
			return CIA309_SYNTAX;
		c->count++;
	}
	return rule->counts & COUNT(c->count) && valid(c) ? CIA309_OK : CIA309_SYNTAX;
}

/* The rule of the command in l->word, and its second word. The first word alone decides between a command that is not
 * supported and one that is written wrong, but for "set", as canopend does. */
static enum cia309_error find_rule(struct line *l, const struct rule **rule)
{
	char first[WORD_MAX];
	bool known = false, second = false;

	memcpy(first, l->word, sizeof(first));
	for (*rule = RULES; *rule < RULES + sizeof(RULES) / sizeof(RULES[0]); (*rule)++) {
		if (strcasecmp(first, (*rule)->name) != 0)
			continue;
		known = true;
		if (!(*rule)->second && !second)
			return CIA309_OK;
		if (!second && !at_end(l))
			second = next_word(l);
		if (second && (*rule)->second && word_is(l, (*rule)->second))
			return CIA309_OK;
	}
	return !known || (second && strcasecmp(first, "set") == 0) ? CIA309_NOT_SUPPORTED : CIA309_SYNTAX;
}

/* The numbers before the command: none, "net" or "node", "net node". */
static enum cia309_error address(struct cia309_command *c, const uint64_t prefix[2], unsigned count, bool node)
{
	unsigned nets = node ? 2 : 1;

	if (count > nets)
		return CIA309_SYNTAX;
	if (count == nets) {
		if (prefix[0] > 1)
			return CIA309_BAD_NET;
		c->net = (int)prefix[0];
	}
	if (node && count) {
		if (prefix[count - 1] > NODE_MAX)
			return CIA309_BAD_NODE;
		c->node = (int)prefix[count - 1];
	}
	return CIA309_OK;
}

enum cia309_error cia309_parse(const char *line, size_t length, struct cia309_command *c)
{
	struct line l = {.at = line, .end = line + length};
	const struct rule *rule;
	uint64_t prefix[2] = {0};
	unsigned count = 0;
	enum cia309_error error;

	*c = (struct cia309_command){.net = CIA309_ABSENT, .node = CIA309_ABSENT};
	if (at_end(&l))
		return CIA309_OK;
	if ((error = sequence(&l, c)) != CIA309_OK)
		return error;
	for (;; count++) {
		if (!next_word(&l))
			return CIA309_SYNTAX;
		if (!isdigit((unsigned char)l.word[0]))
			break;
		if (count == 2 || !number_of(l.word, UINT32_MAX, &prefix[count]))
			return CIA309_SYNTAX;
	}
	if ((error = find_rule(&l, &rule)) != CIA309_OK || (error = address(c, prefix, count, rule->node)) != CIA309_OK)
		return error;
	c->verb = rule->verb;
	return rule->verb == CIA309_READ || rule->verb == CIA309_WRITE ? access(&l, c) : numbers(&l, rule, c);
}

const char *cia309_error_text(enum cia309_error error)
{
	switch (error) {
	case CIA309_OK:
		break;
	case CIA309_NOT_SUPPORTED:
		return "Request not supported.";
	case CIA309_SYNTAX:
		return "Syntax error.";
	case CIA309_STATE:
		return "Request not processed due to internal state.";
	case CIA309_TIMEOUT:
		return "Time-out.";
	case CIA309_NO_NODE:
		return "No default node set.";
	case CIA309_BAD_NET:
		return "Unsupported net.";
	case CIA309_BAD_NODE:
		return "Unsupported node.";
	case CIA309_NMT_STATE:
		return "Wrong NMT state.";
	case CIA309_BUS_OFF:
		return "Bus off.";
	case CIA309_CAN_FULL:
		return "CAN buffer overflow.";
	case CIA309_PDO_LENGTH:
		return "PDO length exceeded.";
	case CIA309_LSS:
		return "LSS implementation- / manufacturer-specific error.";
	case CIA309_LSS_NODE:
		return "LSS node-ID not supported.";
	case CIA309_LSS_BIT_RATE:
		return "LSS bit-rate not supported.";
	case CIA309_LSS_STORE:
		return "LSS parameter storing failed.";
	case CIA309_MEMORY:
		return "Running out of memory.";
	}
	return "-";
}

#include "gateway/cia309/cia309.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "gateway/canopen/sdo_abort.h"
#include "gateway/cia309/help.h"
#include "od/little_endian.h"
#include "od_index.h"

enum { NMT_START = 1, NMT_STOP = 2, NMT_PREOP = 128, NMT_RESET_NODE = 129, NMT_RESET_COMM = 130 };
enum { ALL_NODES = 0, NODE_MAX = 127 };
enum { SDO_TIMEOUT_MS = 500, LSS_TIMEOUT_MS = 1000, LSS_STORE_MS = 5000, FASTSCAN_MS = 100, FIRST_NODE = 2 };
enum { ANSWER_MAX = 160, ROOM_FOR_ANSWER = 256 };
enum { LSS_MANUFACTURER_ERROR = 255 };

/* ---- answers ----------------------------------------------------------------------------------------------------- */

/* What changes something on the bus or in this device. LSS is all of it: the states of other nodes change. */
static bool changes(enum cia309_verb verb)
{
	switch (verb) {
	case CIA309_NOTHING:
	case CIA309_READ:
	case CIA309_READ_PDO:
	case CIA309_SET_NETWORK:
	case CIA309_SET_NODE:
	case CIA309_SET_SDO_TIMEOUT:
	case CIA309_SET_SDO_BLOCK:
	case CIA309_VERSION:
	case CIA309_HELP:
	case CIA309_HELP_TYPES:
	case CIA309_HELP_LSS:
	case CIA309_LOG:
		return false;
	default:
		return true;
	}
}

static void append(struct cia309_session *s, const char *text)
{
	size_t n = strlen(text);

	if (n > sizeof(s->out) - s->out_used)
		n = sizeof(s->out) - s->out_used;
	memcpy(s->out + s->out_used, text, n);
	s->out_used += n;
}

/* The command has ended. Those that waited for the bus may try again. */
static void done(struct cia309 *g, struct cia309_session *s)
{
	s->state = CIA309_IDLE;
	if (g->storing == s)
		g->storing = NULL;
	if (g->owner != s)
		return;
	g->owner = NULL;
	for (struct cia309_session *i = g->sessions; i < g->sessions + CIA309_SESSIONS; i++)
		i->waits = false;
}

/* For the log. Who only reads cannot fill it with different commands. */
static unsigned number_of(const struct cia309_session *s)
{
	const struct cia309_command *c = &s->command;

	return s->may_write ? (unsigned)c->verb << 24 | (unsigned)c->index << 8 | c->sub : 0;
}

/* The answer that ends the command. */
__attribute__((format(printf, 4, 5))) static void answer(
	struct cia309 *g, struct cia309_session *s, uint64_t now_us, const char *format, ...)
{
	char text[ANSWER_MAX], head[16];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	snprintf(head, sizeof(head), "[%u] ", s->command.sequence);
	append(s, head);
	append(s, text);
	append(s, "\r\n");
	if (changes(s->command.verb))
		g->device.log(g->device.ctx, number_of(s), s->who, s->text, text, now_us);
	done(g, s);
}

static void answer_error(struct cia309 *g, struct cia309_session *s, enum cia309_error error, uint64_t now_us)
{
	answer(g, s, now_us, "ERROR:%d #%s", error, cia309_error_text(error));
}

static void answer_abort(struct cia309 *g, struct cia309_session *s, uint32_t code, uint64_t now_us)
{
	answer(g, s, now_us, "ERROR:0x%08X #%s", code, sdo_abort_text(code));
}

static void answer_status(struct cia309 *g, struct cia309_session *s, enum od_status status, uint64_t now_us)
{
	if (status == OD_OK)
		answer(g, s, now_us, "OK");
	else
		answer_abort(g, s, sdo_abort_code(status), now_us);
}

static void print(struct cia309_session *s, const struct cia309_type *type, const void *bytes, size_t size)
{
	s->printer = (struct cia309_printer){.type = type, .bytes = bytes, .size = size};
	s->printing = true;
}

static void print_value(struct cia309_session *s, const void *bytes, size_t size)
{
	char head[16];

	snprintf(head, sizeof(head), "[%u] ", s->command.sequence);
	append(s, head);
	print(s, s->command.type, bytes, size);
}

static bool may_print(const struct cia309_session *s)
{
	return s->printing && sizeof(s->out) - s->out_used >= CIA309_PRINT_MIN + 2;
}

/* Prints as much as there is room for. */
static void print_on(struct cia309 *g, struct cia309_session *s)
{
	while (may_print(s)) {
		s->out_used += cia309_print(&s->printer, s->out + s->out_used, sizeof(s->out) - s->out_used - 2);
		if (!cia309_printed(&s->printer))
			continue;
		append(s, "\r\n");
		s->printing = false;
		done(g, s);
	}
}

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static struct cia309_defaults *defaults(struct cia309 *g, const struct cia309_session *s)
{
	return &g->defaults[s->may_write];
}

/* The node that the command names, or the default. */
static enum cia309_error addressed(const struct cia309 *g, const struct cia309_session *s, int lowest, uint8_t *node)
{
	int id = s->command.node != CIA309_ABSENT ? s->command.node : g->defaults[s->may_write].node;

	if (id == CIA309_ABSENT)
		return CIA309_NO_NODE;
	if (id < lowest)
		return CIA309_BAD_NODE;
	*node = (uint8_t)id;
	return g->node->id == CANOPEN_UNCONFIGURED ? CIA309_STATE : CIA309_OK;
}

static const struct od_entry *own_entry(const struct cia309 *g, const struct cia309_command *c)
{
	return od_find(g->node->od->table, c->index, c->sub, NULL);
}

static bool is_domain(const struct od_entry *entry)
{
	return entry && entry->type == OD_DOMAIN;
}

static enum od_status read_domain(struct cia309 *g, const struct od_entry *entry, const uint8_t **bytes, size_t *size)
{
	const struct od_domain *domain = od_find_domain(g->node->od, entry->index, entry->sub);

	if (!(entry->access & OD_READ))
		return OD_WRITE_ONLY;
	if (!domain)
		return OD_NO_DATA;
	*bytes = domain->read ? g->buffer : domain->data;
	*size = domain->read ? domain->read(domain->ctx, g->buffer) : domain->size;
	return OD_OK;
}

static void read_own(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	const uint8_t *bytes = s->value;
	size_t size;
	enum od_status status;

	if (is_domain(own_entry(g, c)))
		status = read_domain(g, own_entry(g, c), &bytes, &size);
	else
		status = canopen_read(g->node, c->index, c->sub, s->value, sizeof(s->value), &size);
	if (status != OD_OK) {
		answer_status(g, s, status, now_us);
		return;
	}
	print_value(s, bytes, size);
	if (bytes == g->buffer)
		g->owner = s;
}

/* The bytes of a write in g->buffer. False: answered. */
static bool scanned(
	struct cia309 *g, struct cia309_session *s, uint8_t *bytes, size_t capacity, size_t *size, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	long n = cia309_scan(c->type, c->value, c->value_length, bytes, capacity);

	if (n == -ENOSPC)
		answer_abort(g, s, SDO_ABORT_TOO_LONG, now_us);
	else if (n < 0)
		answer_error(g, s, CIA309_SYNTAX, now_us);
	*size = n < 0 ? 0 : (size_t)n;
	return n >= 0;
}

static void write_own(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	bool domain = is_domain(own_entry(g, c));
	uint8_t *bytes = domain ? g->buffer : s->value;
	size_t size;

	if (!scanned(g, s, bytes, domain ? OD_DOMAIN_MAX : sizeof(s->value), &size, now_us))
		return;
	enum od_status status = g->device.write(g->device.ctx, c->index, c->sub, bytes, size, now_us);
	if (status != OD_PENDING) {
		answer_status(g, s, status, now_us);
		return;
	}
	s->state = CIA309_STORING;
	g->storing = s;
}

static bool communicates(const struct cia309 *g)
{
	enum nmt_state state = canopen_nmt_state(g->node);

	return state == NMT_PRE_OPERATIONAL || state == NMT_OPERATIONAL;
}

/* Changing the filter of a CAN interface takes locks of the kernel: not for each transfer. */
static void listen_to(struct cia309 *g, uint8_t node)
{
	uint32_t id = CAN_ID_SDO_RESPONSE + node;

	if (g->listener.count == 2 && g->listener.ids[1] == id)
		return;
	g->listener.ids[1] = id;
	g->listener.count = 2;
	canopen_listen(g->node, &g->listener);
}

static void transfer(struct cia309 *g, struct cia309_session *s, uint8_t node, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	const struct cia309_defaults *d = defaults(g, s);
	size_t size = 0;

	if (c->verb == CIA309_WRITE && !scanned(g, s, g->buffer, sizeof(g->buffer), &size, now_us))
		return;
	listen_to(g, node);
	g->owner = s;
	g->sdo_running = true;
	s->state = CIA309_BUSY;
	sdo_client_init(&g->sdo, g->bus, node, d->sdo_timeout_ms * 1000ull);
	if (c->verb == CIA309_WRITE)
		(d->sdo_block ? sdo_client_block_download : sdo_client_download)(
			&g->sdo, c->index, c->sub, g->buffer, size, now_us);
	else
		(d->sdo_block ? sdo_client_block_upload : sdo_client_upload)(
			&g->sdo, c->index, c->sub, g->buffer, sizeof(g->buffer), now_us);
}

static enum cia309_error bus_error(const struct cia309 *g)
{
	return g->bus->state == CAN_STATE_BUS_OFF || g->bus->state == CAN_STATE_DOWN ? CIA309_BUS_OFF : CIA309_CAN_FULL;
}

static void transferred(struct cia309 *g, uint64_t now_us)
{
	struct cia309_session *s = g->owner;

	g->sdo_running = false;
	switch (g->sdo.result) {
	case SDO_DONE:
		if (s->command.verb == CIA309_READ) {
			print_value(s, g->buffer, g->sdo.size);
			print_on(g, s); /* with its head: cocomm takes a short answer for one */
		} else {
			answer(g, s, now_us, "OK");
		}
		break;
	case SDO_UNSENT:
		answer_error(g, s, bus_error(g), now_us);
		break;
	default: /* of a timeout, too, the code is that of the abort */
		answer_abort(g, s, g->sdo.abort_code, now_us);
		break;
	}
}

static void access(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	uint8_t node;
	enum cia309_error error = addressed(g, s, 1, &node);

	if (error == CIA309_OK && node != g->node->id && !communicates(g))
		error = CIA309_NMT_STATE;
	if (error != CIA309_OK)
		answer_error(g, s, error, now_us);
	else if (node != g->node->id)
		transfer(g, s, node, now_us);
	else if (s->command.verb == CIA309_READ)
		read_own(g, s, now_us);
	else
		write_own(g, s, now_us);
}

/* ---- PDOs of this device ----------------------------------------------------------------------------------------- */

static const struct pdo *own_pdo(const struct cia309 *g, const struct cia309_command *c)
{
	const struct pdos *pdos = &g->node->pdos;
	uint64_t number = c->numbers[0] - 1;

	if (c->verb == CIA309_READ_PDO)
		for (size_t i = 0; i < pdos->tpdo_count; i++)
			if (pdos->tpdo[i].pdo.index == PDO_FIRST_TPDO + number)
				return &pdos->tpdo[i].pdo;
	if (c->verb == CIA309_WRITE_PDO)
		for (size_t i = 0; i < pdos->rpdo_count; i++)
			if (pdos->rpdo[i].pdo.index == PDO_FIRST_RPDO + number)
				return &pdos->rpdo[i].pdo;
	return NULL;
}

static void read_pdo(struct cia309 *g, struct cia309_session *s, const struct pdo *pdo, uint64_t now_us)
{
	char text[ANSWER_MAX];
	int n = snprintf(text, sizeof(text), "1 pdo %u", pdo->mapped_count);

	for (unsigned i = 0; i < pdo->mapped_count; i++) {
		uint8_t wire[8] = {0};
		size_t size = od_get(g->node->od, pdo->mapped[i], wire, sizeof(wire));

		n += snprintf(text + n, sizeof(text) - (size_t)n, " 0x%0*llX", (int)(2 * size),
			(unsigned long long)get_uint(wire, size));
	}
	answer(g, s, now_us, "%s", text);
}

/* As if the bus had brought it. A value that the dictionary refuses is an EMCY, as for any RPDO. */
static enum cia309_error write_pdo(
	struct cia309 *g, const struct cia309_command *c, const struct pdo *pdo, uint64_t now_us)
{
	struct can_msg msg = {.id = *pdo->cob_id & COB_ID_MASK};

	if (canopen_nmt_state(g->node) != NMT_OPERATIONAL)
		return CIA309_NMT_STATE;
	if (c->numbers[1] != pdo->mapped_count)
		return CIA309_PDO_LENGTH;
	for (unsigned i = 0; i < pdo->mapped_count; i++) {
		size_t size = pdo->mapped[i]->size;

		if (size < 8 && c->numbers[2 + i] >> (8 * size))
			return CIA309_SYNTAX;
		put_uint(msg.data + msg.len, c->numbers[2 + i], size);
		msg.len = (uint8_t)(msg.len + size);
	}
	g->device.receive(g->device.ctx, &msg, now_us);
	return CIA309_OK;
}

static void access_pdo(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	const struct pdo *pdo = own_pdo(g, c);
	int node = c->node != CIA309_ABSENT ? c->node : defaults(g, s)->node;
	enum cia309_error error = CIA309_OK;

	if (node != CIA309_ABSENT && node != g->node->id)
		error = CIA309_BAD_NODE;
	else if (!pdo || pdo->mapped_count == 0)
		error = CIA309_STATE;
	else if (c->verb == CIA309_WRITE_PDO)
		error = write_pdo(g, c, pdo, now_us);
	if (error != CIA309_OK)
		answer_error(g, s, error, now_us);
	else if (c->verb == CIA309_WRITE_PDO)
		answer(g, s, now_us, "OK");
	else
		read_pdo(g, s, pdo, now_us);
}

/* ---- NMT --------------------------------------------------------------------------------------------------------- */

static void nmt(struct cia309 *g, struct cia309_session *s, uint8_t command, uint64_t now_us)
{
	struct can_msg msg = {.id = CAN_ID_NMT, .len = 2, .data = {command}};
	enum cia309_error error = addressed(g, s, ALL_NODES, &msg.data[1]);
	bool own = msg.data[1] == g->node->id;

	if (error == CIA309_OK && !own && can_send(g->bus, &msg, now_us) < 0)
		error = bus_error(g);
	if (error != CIA309_OK) {
		answer_error(g, s, error, now_us);
		return;
	}
	if (own || msg.data[1] == ALL_NODES)
		g->device.receive(g->device.ctx, &msg, now_us);
	answer(g, s, now_us, "OK");
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

/* To the bus, and to the slave of this node. */
static void send_lss(void *ctx, const struct can_msg *msg, uint64_t now_us)
{
	struct cia309 *g = ctx;

	(void)can_send(g->bus, msg, now_us); /* without an answer it is a time-out */
	g->device.receive(g->device.ctx, msg, now_us);
}

static void on_lss_answered(void *ctx, const struct can_msg *msg)
{
	struct cia309 *g = ctx;

	g->own_answer = *msg;
	g->own_answered = true;
}

enum { STEP_SCAN, STEP_NODE, STEP_STORE };

static uint64_t scan_timeout_us(const struct cia309_command *c)
{
	return (c->count && c->numbers[0] ? c->numbers[0] : FASTSCAN_MS) * 1000;
}

static void fastscan(struct cia309 *g, const struct cia309_command *c, uint64_t now_us)
{
	enum lss_scan how[LSS_ADDRESS] = {LSS_SCAN};
	uint32_t match[LSS_ADDRESS] = {0};

	for (unsigned i = 0; c->count == CIA309_NUMBERS && i < LSS_ADDRESS; i++) {
		how[i] = (enum lss_scan)c->numbers[3 + 2 * i];
		match[i] = (uint32_t)c->numbers[4 + 2 * i];
	}
	g->lss_step = STEP_SCAN;
	g->lss.timeout_us = scan_timeout_us(c);
	lss_master_fastscan(&g->lss, how, match, now_us);
}

static void start_lss(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;

	g->owner = s;
	s->state = CIA309_BUSY;
	g->lss_running = true;
	g->own_answered = false;
	g->lss.timeout_us = LSS_TIMEOUT_MS * 1000;
	g->lss_step = 0;
	switch (c->verb) {
	case CIA309_LSS_SWITCH_GLOBAL:
		lss_master_switch_global(&g->lss, c->numbers[0], now_us);
		break;
	case CIA309_LSS_SWITCH_SELECTIVE:
		for (int i = 0; i < LSS_ADDRESS; i++)
			g->lss_address[i] = (uint32_t)c->numbers[i];
		lss_master_switch_selective(&g->lss, g->lss_address, now_us);
		break;
	case CIA309_LSS_SET_NODE:
		lss_master_configure_node_id(&g->lss, (uint8_t)c->numbers[0], now_us);
		break;
	case CIA309_LSS_CONFIGURE_BIT_RATE:
		lss_master_configure_bit_rate(&g->lss, (uint8_t)c->numbers[0], (uint8_t)c->numbers[1], now_us);
		break;
	case CIA309_LSS_ACTIVATE_BIT_RATE:
		lss_master_activate_bit_rate(&g->lss, (uint16_t)c->numbers[0], now_us);
		break;
	case CIA309_LSS_STORE_CONFIGURATION:
		g->lss.timeout_us = LSS_STORE_MS * 1000;
		lss_master_store(&g->lss, now_us);
		break;
	case CIA309_LSS_INQUIRE:
		lss_master_inquire(&g->lss, (uint8_t)c->numbers[0], now_us);
		break;
	case CIA309_LSS_GET_NODE:
		lss_master_inquire(&g->lss, LSS_ADDRESS, now_us);
		break;
	case CIA309_LSS_ALL_NODES:
		g->lss_node = c->count > 1 ? (uint8_t)c->numbers[1] : FIRST_NODE;
		g->lss_found = 0;
		fastscan(g, c, now_us);
		break;
	default:
		fastscan(g, c, now_us);
		break;
	}
}

static void answer_address(
	struct cia309 *g, struct cia309_session *s, const uint32_t address[LSS_ADDRESS], uint64_t now_us)
{
	answer(g, s, now_us, "0x%08X 0x%08X 0x%08X 0x%08X", address[LSS_VENDOR], address[LSS_PRODUCT],
		address[LSS_REVISION], address[LSS_SERIAL]);
}

/* `refused`: what the error code of the node means for this service. */
static void answer_lss_error(struct cia309 *g, struct cia309_session *s, enum cia309_error refused, uint64_t now_us)
{
	if (g->lss.result == LSS_NO_ANSWER)
		refused = CIA309_TIMEOUT;
	else if (g->lss.result == LSS_LOST)
		refused = CIA309_STATE;
	else if (g->lss.error == LSS_MANUFACTURER_ERROR)
		refused = CIA309_LSS;
	answer_error(g, s, refused, now_us);
}

static enum cia309_error refusal(const struct cia309 *g, enum cia309_verb verb)
{
	bool storing =
		verb == CIA309_LSS_ALL_NODES ? g->lss_step == STEP_STORE : verb == CIA309_LSS_STORE_CONFIGURATION;

	if (storing)
		return CIA309_LSS_STORE;
	return verb == CIA309_LSS_CONFIGURE_BIT_RATE ? CIA309_LSS_BIT_RATE : CIA309_LSS_NODE;
}

static void inquired(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	if (s->command.count) {
		answer(g, s, now_us, "0x%08X", g->lss.value);
		return;
	}
	g->lss_address[g->lss_step++] = g->lss.value;
	if (g->lss_step == LSS_ADDRESS)
		answer_address(g, s, g->lss_address, now_us);
	else
		lss_master_inquire(&g->lss, (uint8_t)g->lss_step, now_us);
}

/* This node has its node-ID: on to the next one. */
static void assigned(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const uint32_t *a = g->lss.address;
	char text[ANSWER_MAX];

	snprintf(text, sizeof(text), "# Node-ID %u assigned to: 0x%08X 0x%08X 0x%08X 0x%08X\n", g->lss_node,
		a[LSS_VENDOR], a[LSS_PRODUCT], a[LSS_REVISION], a[LSS_SERIAL]);
	append(s, text);
	g->lss_found++;
	lss_master_switch_global(&g->lss, false, now_us);
	if (g->lss_node++ < NODE_MAX) {
		fastscan(g, &s->command, now_us);
		return;
	}
	append(s, "# Not all nodes scanned!\n");
	answer(g, s, now_us, "OK");
}

static void all_nodes(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;
	bool store = c->count < 3 || c->numbers[2];

	if (g->lss_step == STEP_SCAN) {
		g->lss_step = STEP_NODE;
		g->lss.timeout_us = LSS_TIMEOUT_MS * 1000;
		lss_master_configure_node_id(&g->lss, g->lss_node, now_us);
	} else if (g->lss_step == STEP_NODE && store) {
		g->lss_step = STEP_STORE;
		g->lss.timeout_us = LSS_STORE_MS * 1000;
		lss_master_store(&g->lss, now_us);
	} else {
		assigned(g, s, now_us);
	}
}

static void all_found(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	char text[64];

	snprintf(text, sizeof(text), "# Found %u nodes, search finished.\n", g->lss_found);
	append(s, text);
	answer(g, s, now_us, "OK");
}

/* The service has ended; the command goes on or is answered. */
static void lss_ended(struct cia309 *g, uint64_t now_us)
{
	struct cia309_session *s = g->owner;
	enum cia309_verb verb = s->command.verb;

	if (verb == CIA309_LSS_ALL_NODES && g->lss_step == STEP_SCAN && g->lss.result == LSS_NO_ANSWER)
		all_found(g, s, now_us);
	else if (g->lss.result != LSS_DONE)
		answer_lss_error(g, s, refusal(g, verb), now_us);
	else if (verb == CIA309_LSS_INQUIRE)
		inquired(g, s, now_us);
	else if (verb == CIA309_LSS_GET_NODE)
		answer(g, s, now_us, "0x%02X", g->lss.value & 0xFF);
	else if (verb == CIA309_LSS_FASTSCAN)
		answer_address(g, s, g->lss.address, now_us);
	else if (verb == CIA309_LSS_ALL_NODES)
		all_nodes(g, s, now_us);
	else
		answer(g, s, now_us, "OK");
	g->lss_running = s->state == CIA309_BUSY;
}

/* ---- the gateway itself ------------------------------------------------------------------------------------------ */

static uint32_t identity(const struct cia309 *g, uint8_t sub)
{
	const uint32_t *value = od_value(g->node->od, OD_INDEX_IDENTITY, sub, sizeof(uint32_t));

	return value ? *value : 0;
}

/* Identity, gateway class 1, version of the protocol, and of this program. */
static void version(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	uint32_t revision = identity(g, 3);

	answer(g, s, now_us, "%u %u %u.%u %u 1 3.0 " IMU9_VERSION, identity(g, 1), identity(g, 2), revision >> 16,
		revision & 0xFFFF, identity(g, 4));
}

static void set(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	const struct cia309_command *c = &s->command;

	switch (c->verb) {
	case CIA309_SET_NETWORK:
		if (c->numbers[0] > 1) {
			answer_error(g, s, CIA309_BAD_NET, now_us);
			return;
		}
		break;
	case CIA309_SET_NODE:
		defaults(g, s)->node = (int)c->numbers[0];
		break;
	case CIA309_SET_SDO_TIMEOUT:
		defaults(g, s)->sdo_timeout_ms = (uint32_t)c->numbers[0];
		break;
	default:
		defaults(g, s)->sdo_block = c->numbers[0];
		break;
	}
	answer(g, s, now_us, "OK");
}

static void print_log(struct cia309 *g, struct cia309_session *s)
{
	const struct od_domain *domain = od_find_domain(g->node->od, OD_INDEX_EVENT_LOG, 0);

	g->owner = s;
	print(s, &CIA309_TYPE_RAW, g->buffer, domain && domain->read ? domain->read(domain->ctx, g->buffer) : 0);
}

static void print_help(struct cia309_session *s, const char *text)
{
	print(s, &CIA309_TYPE_RAW, text, strlen(text));
}

static void execute(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	enum cia309_verb verb = s->command.verb;

	if (changes(verb) && !s->may_write) {
		answer(g, s, now_us, "ERROR:%d #Not permitted: the address of --cia309 has no ',write=yes'.",
			CIA309_STATE);
		return;
	}
	switch (verb) {
	case CIA309_NOTHING:
		append(s, "\r\n");
		break;
	case CIA309_READ:
	case CIA309_WRITE:
		access(g, s, now_us);
		break;
	case CIA309_READ_PDO:
	case CIA309_WRITE_PDO:
		access_pdo(g, s, now_us);
		break;
	case CIA309_START:
		nmt(g, s, NMT_START, now_us);
		break;
	case CIA309_STOP:
		nmt(g, s, NMT_STOP, now_us);
		break;
	case CIA309_PREOP:
		nmt(g, s, NMT_PREOP, now_us);
		break;
	case CIA309_RESET_NODE:
		nmt(g, s, NMT_RESET_NODE, now_us);
		break;
	case CIA309_RESET_COMM:
		nmt(g, s, NMT_RESET_COMM, now_us);
		break;
	case CIA309_SET_NETWORK:
	case CIA309_SET_NODE:
	case CIA309_SET_SDO_TIMEOUT:
	case CIA309_SET_SDO_BLOCK:
		set(g, s, now_us);
		break;
	case CIA309_VERSION:
		version(g, s, now_us);
		break;
	case CIA309_HELP:
		print_help(s, cia309_help);
		break;
	case CIA309_HELP_TYPES:
		print_help(s, cia309_help_types);
		break;
	case CIA309_HELP_LSS:
		print_help(s, cia309_help_lss);
		break;
	case CIA309_LOG:
		print_log(g, s);
		break;
	default:
		start_lss(g, s, now_us);
		break;
	}
}

/* ---- lines ------------------------------------------------------------------------------------------------------- */

/* Whether the command needs the bus or the buffer, which have one owner at a time. */
static bool needs_owner(const struct cia309 *g, const struct cia309_session *s)
{
	const struct cia309_command *c = &s->command;
	uint8_t node = 0;

	switch (c->verb) {
	case CIA309_READ:
	case CIA309_WRITE:
		(void)addressed(g, s, 1, &node);
		return node != g->node->id || is_domain(own_entry(g, c));
	case CIA309_LOG:
		return true;
	default:
		return changes(c->verb) && c->verb >= CIA309_LSS_SWITCH_GLOBAL;
	}
}

static void find_line(struct cia309_session *s, size_t from)
{
	const char *lf = memchr(s->in + from, '\n', s->in_used - from);

	s->line = lf ? (size_t)(lf - s->in) + 1 : 0;
}

static void keep_text(struct cia309_session *s, size_t length)
{
	size_t n = length < sizeof(s->text) - 1 ? length : sizeof(s->text) - 1;

	for (size_t i = 0; i < n; i++)
		s->text[i] = s->in[i] < 0x20 || s->in[i] > 0x7E ? ' ' : s->in[i];
	while (n > 0 && s->text[n - 1] == ' ')
		n--;
	s->text[n] = '\0';
}

static bool ready(const struct cia309_session *s)
{
	return s->used && s->line && s->state == CIA309_IDLE && !s->printing && s->out_used == 0 && !s->closing &&
	       !s->waits;
}

static void run_line(struct cia309 *g, struct cia309_session *s, uint64_t now_us)
{
	enum cia309_error error = cia309_parse(s->in, s->line - 1, &s->command);

	s->waits = error == CIA309_OK && g->owner && needs_owner(g, s);
	if (s->waits)
		return;
	keep_text(s, s->line - 1);
	if (error == CIA309_OK) {
		execute(g, s, now_us);
	} else {
		s->command.verb = CIA309_NOTHING; /* nothing for the log */
		answer_error(g, s, error, now_us);
	}
	s->in_used -= s->line;
	memmove(s->in, s->in + s->line, s->in_used);
	find_line(s, 0);
}

/* One command, or one piece of a long value, of the client whose turn it is. */
static void run(struct cia309 *g, uint64_t now_us)
{
	unsigned first = g->turn;

	for (unsigned i = 0; i < CIA309_SESSIONS && now_us >= g->next_us; i++) {
		unsigned turn = (first + i) % CIA309_SESSIONS;
		struct cia309_session *s = &g->sessions[turn];
		bool command = ready(s) && canopen_listens(g->node);

		if (command)
			run_line(g, s, now_us);
		if (s->waits || (!command && !may_print(s)))
			continue;
		print_on(g, s);
		g->next_us = now_us + CIA309_COMMAND_US;
		g->turn = turn + 1;
	}
}

/* When there is something to do next; the deadline of the node covers the time in which it does not listen. */
static uint64_t next_run(const struct cia309 *g)
{
	for (unsigned i = 0; i < CIA309_SESSIONS; i++)
		if (may_print(&g->sessions[i]) || (ready(&g->sessions[i]) && canopen_listens(g->node)))
			return g->next_us;
	return UINT64_MAX;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

static void on_stored(void *ctx, enum od_status status)
{
	struct cia309 *g = ctx;

	if (g->storing)
		answer_status(g, g->storing, status, g->node->now_us);
}

void cia309_init(struct cia309 *g, const struct cia309_device *device, struct canopen_node *node, struct can_port *bus)
{
	*g = (struct cia309){.device = *device,
		.node = node,
		.bus = bus,
		.defaults = {{CIA309_ABSENT, SDO_TIMEOUT_MS, false}, {CIA309_ABSENT, SDO_TIMEOUT_MS, false}}};
	g->listener = (struct canopen_listener){.ctx = g, .lss_answered = on_lss_answered, .stored = on_stored};
	g->listener.ids[0] = CAN_ID_LSS_RESPONSE;
	g->listener.count = 1;
	lss_master_init(&g->lss, send_lss, g);
	canopen_listen(node, &g->listener);
}

struct cia309_session *cia309_open(struct cia309 *g, const char *who, bool may_write)
{
	for (struct cia309_session *s = g->sessions; s < g->sessions + CIA309_SESSIONS; s++) {
		if (s->used)
			continue;
		s->in_used = s->line = s->out_used = 0;
		s->printing = s->closing = s->waits = false;
		s->state = CIA309_IDLE;
		s->used = true;
		s->may_write = may_write;
		snprintf(s->who, sizeof(s->who), "%s", who);
		return s;
	}
	return NULL;
}

void cia309_close(struct cia309 *g, struct cia309_session *s)
{
	s->used = s->printing = false;
	if (g->owner == s)
		g->sdo_running = g->lss_running = false;
	done(g, s);
}

size_t cia309_room(const struct cia309_session *s)
{
	return s->line || s->closing ? 0 : sizeof(s->in) - s->in_used;
}

void cia309_input(struct cia309_session *s, const char *bytes, size_t n)
{
	struct cia309_command command;
	size_t from = s->in_used;
	char text[64];

	memcpy(s->in + s->in_used, bytes, n);
	s->in_used += n;
	find_line(s, from);
	if (s->line || s->in_used < sizeof(s->in))
		return;
	(void)cia309_parse(s->in, s->in_used, &command);
	snprintf(text, sizeof(text), "[%u] ERROR:%d #The line is too long.\r\n", command.sequence, CIA309_MEMORY);
	append(s, text);
	s->closing = true;
}

const char *cia309_output(const struct cia309_session *s, size_t *n)
{
	*n = s->out_used;
	return s->out;
}

void cia309_sent(struct cia309_session *s, size_t n)
{
	s->out_used -= n;
	memmove(s->out, s->out + n, s->out_used);
}

bool cia309_idle(const struct cia309_session *s)
{
	return s->state == CIA309_IDLE && !s->printing && !s->line && s->out_used == 0;
}

bool cia309_closing(const struct cia309_session *s)
{
	return s->closing;
}

/* While the bit rate is switched nothing may be sent. */
static bool silent(const struct cia309 *g)
{
	return g->node->lss.switching != SWITCH_NONE;
}

void cia309_receive(struct cia309 *g, const struct can_msg *msg, uint64_t now_us)
{
	if (silent(g))
		return;
	if (g->sdo_running)
		sdo_client_receive(&g->sdo, msg, now_us);
	if (g->lss_running)
		lss_master_receive(&g->lss, msg, now_us);
}

/* Whether the client of a long search takes its answers. */
static bool owner_has_room(const struct cia309 *g)
{
	return !g->owner || sizeof(g->owner->out) - g->owner->out_used >= ROOM_FOR_ANSWER;
}

/* An answer of this node's own slave comes while the request is being sent, and counts from here on. */
static void lss_tick(struct cia309 *g, uint64_t now_us)
{
	if (g->own_answered)
		lss_master_receive(&g->lss, &g->own_answer, now_us);
	g->own_answered = false;
	lss_master_tick(&g->lss, now_us);
	if (g->lss.result != LSS_RUNNING && owner_has_room(g))
		lss_ended(g, now_us);
}

static uint64_t next_lss(struct cia309 *g, uint64_t now_us)
{
	uint64_t next_us = lss_master_tick(&g->lss, now_us);

	return g->own_answered || (g->lss.result != LSS_RUNNING && owner_has_room(g)) ? now_us : next_us;
}

uint64_t cia309_tick(struct cia309 *g, uint64_t now_us)
{
	uint64_t next_us = UINT64_MAX;

	if (silent(g)) /* the deadline of the node is its end */
		return next_us;
	if (g->sdo_running) {
		sdo_client_tick(&g->sdo, now_us);
		if (g->sdo.result != SDO_RUNNING)
			transferred(g, now_us);
	}
	if (g->lss_running)
		lss_tick(g, now_us);
	run(g, now_us);
	if (g->sdo_running)
		next_us = g->sdo.result == SDO_RUNNING ? sdo_client_tick(&g->sdo, now_us) : now_us;
	if (g->lss_running)
		next_us = earlier(next_us, next_lss(g, now_us));
	return earlier(next_us, next_run(g));
}

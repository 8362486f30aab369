/* imu9-sdo lss: LSS master (CiA 305). A node is selected by its identity, or it must be the only one on the bus. */
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/cia305.h"
#include "tools/sdo/sdo_session.h"
#include "od_index.h"

enum {
	ANSWER_MS = 50,	 /* no answer within this time means no; changed by -t */
	STORE_MS = 5000, /* storing waits for the disk */
	BOOT_UP_MS = 1000,
	NODES_MAX = 127,
	UNCONFIGURED = 255,
};

enum { VENDOR, PRODUCT, REVISION, SERIAL, NUMBERS };

static const char *const number_names[NUMBERS] = {"vendor", "product", "revision", "serial"};

struct lss {
	struct session *session;
	struct can_port *bus;
	unsigned int answer_ms;
	bool unsent;	/* a request could not be sent, and that was reported: no more are sent */
	bool selective; /* the node is selected by `wanted` */
	uint32_t wanted[NUMBERS];
};

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static void send_command(struct lss *lss, uint8_t command, uint32_t value, const uint8_t tail[3])
{
	struct can_msg msg = {.id = CAN_ID_LSS_REQUEST, .len = 8, .data = {command}};

	sdo_put_u32(&msg.data[1], value);
	if (tail)
		memcpy(&msg.data[5], tail, 3);
	if (!lss->unsent)
		lss->unsent = !sdo_send_frame(lss->session, lss->bus, &msg);
}

/* Waits for a frame with this CAN-ID and, for an answer, this command. False: timeout. */
static bool await(struct lss *lss, uint32_t id, uint8_t command, unsigned int ms, struct can_msg *msg)
{
	uint64_t until_us = cli_now_us() + ms * 1000ull;

	while (cli_now_us() < until_us) {
		cli_wait(lss->bus, -1, until_us);
		while (can_receive(lss->bus, msg, cli_now_us()) > 0)
			if (msg->id == id && !msg->extended && !msg->remote &&
				(id != CAN_ID_LSS_RESPONSE || msg->data[0] == command))
				return true;
	}
	return false;
}

static bool request(struct lss *lss, uint8_t command, uint32_t value, unsigned int ms, uint32_t *answer)
{
	struct can_msg msg;

	send_command(lss, command, value, NULL);
	if (!await(lss, CAN_ID_LSS_RESPONSE, command, ms, &msg))
		return false;
	*answer = (uint32_t)sdo_number(&msg.data[1], 4);
	return true;
}

/* ---- which node -------------------------------------------------------------------------------------------------- */

static bool fastscan_step(struct lss *lss, uint32_t value, uint8_t bit, uint8_t number, uint8_t next)
{
	struct can_msg msg;

	send_command(lss, LSS_FASTSCAN, value, (const uint8_t[3]){bit, number, next});
	return await(lss, CAN_ID_LSS_RESPONSE, LSS_IDENTIFIED, lss->answer_ms, &msg);
}

/* Finds one node without a node-ID bit by bit (CiA 305, fastscan); it is then in LSS configuration state. False: there
 * is none, or it stopped answering. */
static bool fastscan(struct lss *lss, uint32_t identity[NUMBERS])
{
	if (!fastscan_step(lss, 0, 0x80, 0, 0))
		return false;
	for (uint8_t number = 0; number < NUMBERS; number++) {
		uint32_t value = 0;

		for (uint8_t bit = 32; bit-- > 0;)
			if (!fastscan_step(lss, value, bit, number, number))
				value |= 1u << bit;
		if (!fastscan_step(lss, value, 0, number, (uint8_t)((number + 1) % NUMBERS)))
			return false;
		identity[number] = value;
	}
	return true;
}

static bool select_by_identity(struct lss *lss)
{
	struct can_msg msg;

	for (uint8_t i = 0; i < NUMBERS; i++)
		send_command(lss, (uint8_t)(LSS_SWITCH_SELECTIVE + i), lss->wanted[i], NULL);
	if (await(lss, CAN_ID_LSS_RESPONSE, LSS_SWITCHED, lss->answer_ms, &msg))
		return true;
	cli_error(
		"no node with vendor %08Xh, product %08Xh, revision %08Xh, serial %08Xh on %s: 'imu9-sdo lss scan' and "
		"'imu9-sdo scan' list the nodes",
		lss->wanted[VENDOR], lss->wanted[PRODUCT], lss->wanted[REVISION], lss->wanted[SERIAL],
		lss->session->bus);
	return false;
}

static void switch_all(struct lss *lss, bool configuring)
{
	send_command(lss, LSS_SWITCH_GLOBAL, configuring, NULL);
}

/* Selects the node given by the options; without them all nodes on the bus, so there should be only one. */
static bool select_node(struct lss *lss)
{
	switch_all(lss, false);
	if (lss->selective)
		return select_by_identity(lss);
	switch_all(lss, true);
	return true;
}

static int no_answer(const struct lss *lss)
{
	if (lss->unsent)
		return CLI_FAILED;
	cli_error("no answer to LSS on %s: is there a node that supports it, and is the bit rate right?",
		lss->session->bus);
	return CLI_FAILED;
}

/* ---- the commands ------------------------------------------------------------------------------------------------ */

static void print_identity(const uint32_t identity[NUMBERS])
{
	for (int i = 0; i < NUMBERS; i++)
		printf("%s%s %08Xh", i ? "  " : "", number_names[i], identity[i]);
	putchar('\n');
}

static int scan(struct lss *lss)
{
	uint32_t identity[NUMBERS] = {0};
	int found = 0;

	switch_all(lss, false);
	while (found < NODES_MAX && fastscan(lss, identity)) {
		print_identity(identity);
		fflush(stdout);
		found++;
	}
	switch_all(lss, false);
	if (!lss->session->quiet && !lss->unsent)
		fprintf(stderr, "imu9-sdo: %d node%s without a node-ID\n", found, found == 1 ? "" : "s");
	return CLI_OK;
}

static bool configured(struct lss *lss, uint8_t command, uint32_t value, unsigned int ms, const char *refusal)
{
	uint32_t answer;

	if (!request(lss, command, value, ms, &answer)) {
		no_answer(lss);
		return false;
	}
	if ((answer & 0xFF) == 0)
		return true;
	cli_error("the node refused: %s (error %u)", refusal, answer & 0xFF);
	return false;
}

static bool store(struct lss *lss)
{
	return configured(lss, LSS_STORE, 0, STORE_MS, "it cannot store node-ID and bit rate");
}

static bool set_node_id(struct lss *lss, uint32_t id)
{
	return configured(lss, LSS_CONFIGURE_NODE_ID, id, lss->answer_ms, "node-ID out of range");
}

static uint32_t node_id_of(const char *text)
{
	return (uint32_t)cli_integer_option("node-ID", text, 1, UNCONFIGURED);
}

/* A node without a node-ID boots up as soon as it gets one. */
static int assign(struct lss *lss, const char *text, bool with_store)
{
	uint32_t id = node_id_of(text), identity[NUMBERS] = {0};
	struct can_msg msg;

	if (id > NODES_MAX)
		cli_usage_error("lss assign %s: a node-ID from 1 to 127", text);
	switch_all(lss, false);
	if (lss->selective ? !select_by_identity(lss) : !fastscan(lss, identity)) {
		if (!lss->selective)
			cli_error("no node without a node-ID on %s: 'imu9-sdo scan' lists those that have one",
				lss->session->bus);
		return CLI_FAILED;
	}
	bool done = set_node_id(lss, id) && (!with_store || store(lss));
	switch_all(lss, false);
	if (!done)
		return CLI_FAILED;
	print_identity(lss->selective ? lss->wanted : identity);
	if (!await(lss, CAN_ID_ERROR_CONTROL + id, 0, BOOT_UP_MS, &msg)) {
		cli_error("the node accepted node-ID %u, but did not boot up with it: if it had another one, use "
			  "'imu9-sdo -n OLD nmt reset-comm'",
			id);
		return CLI_FAILED;
	}
	if (!lss->session->quiet)
		fprintf(stderr, "imu9-sdo: the node has node-ID %u now%s\n", id,
			with_store ? "" : "; 'imu9-sdo lss store' stores it");
	return CLI_OK;
}

static int change_node_id(struct lss *lss, const char *text)
{
	uint32_t id = node_id_of(text);
	bool done = select_node(lss) && set_node_id(lss, id);

	switch_all(lss, false);
	if (done && !lss->session->quiet)
		fprintf(stderr,
			"imu9-sdo: takes effect with 'imu9-sdo nmt reset-comm'; 'imu9-sdo lss store' stores it\n");
	return done ? CLI_OK : CLI_FAILED;
}

/* CiA 301, table 1. */
static int change_bit_rate(struct lss *lss, const char *text, const char *delay)
{
	static const long kbit_s[] = {1000, 800, 500, 250, 125, 0, 50, 20, 10};
	long rate = cli_integer_option("bit rate", text, 10, 1000), delay_ms = 0;
	uint32_t index = 0;

	while (index < sizeof(kbit_s) / sizeof(kbit_s[0]) && kbit_s[index] != rate)
		index++;
	if (index == sizeof(kbit_s) / sizeof(kbit_s[0]))
		cli_usage_error("%s kbit/s: use 10, 20, 50, 125, 250, 500, 800 or 1000", text);
	if (delay)
		delay_ms = cli_integer_option("--activate", delay, 1, 65535);
	bool done = select_node(lss) && configured(lss, LSS_CONFIGURE_BIT_TIMING, index << 8, lss->answer_ms,
						"this bit rate is not possible");
	if (done && delay)
		send_command(lss, LSS_ACTIVATE_BIT_TIMING, (uint32_t)delay_ms, NULL);
	else
		switch_all(lss, false);
	return done ? CLI_OK : CLI_FAILED;
}

static int store_selected(struct lss *lss)
{
	bool done = select_node(lss) && store(lss);

	switch_all(lss, false);
	return done ? CLI_OK : CLI_FAILED;
}

static int inquire(struct lss *lss)
{
	uint32_t identity[NUMBERS] = {0}, id = 0;
	bool done = select_node(lss);

	if (!done)
		return CLI_FAILED;
	for (uint8_t i = 0; done && i < NUMBERS; i++)
		done = request(lss, (uint8_t)(LSS_INQUIRE_IDENTITY + i), 0, lss->answer_ms, &identity[i]);
	done = done && request(lss, LSS_INQUIRE_NODE_ID, 0, lss->answer_ms, &id);
	switch_all(lss, false);
	if (!done)
		return no_answer(lss);
	printf((id & 0xFF) == UNCONFIGURED ? "no node-ID  " : "node-ID %u  ", id & 0xFF);
	print_identity(identity);
	return CLI_OK;
}

/* --serial and the others; defaults are those of the EDS. */
static void extract_identity(struct lss *lss, int *argc, char **argv)
{
	const struct od_table *table = lss->session->table;

	for (uint8_t i = 0; i < NUMBERS; i++) {
		const struct od_entry *entry = od_find(table, OD_INDEX_IDENTITY, (uint8_t)(i + 1), NULL);
		char option[16];

		snprintf(option, sizeof(option), "--%s", number_names[i]);
		const char *text = sdo_extract_value(argc, argv, option);
		if (text)
			lss->wanted[i] = cli_u32_option(option, text);
		else if (entry && entry->size == 4)
			memcpy(&lss->wanted[i], (const uint8_t *)table->defaults + entry->offset, 4);
		lss->selective |= text != NULL;
	}
}

static _Noreturn void usage(void)
{
	cli_usage_error(
		"usage: imu9-sdo lss scan | assign ID [--store] | node-id ID | bit-rate KBIT [--activate MS] | "
		"store | inquire; to select one of several nodes: --serial N (--vendor, --product, --revision)");
}

static int run(struct lss *lss, const char *what, int argc, char **argv, bool with_store, const char *delay)
{
	if (strcmp(what, "scan") == 0 && argc == 0)
		return scan(lss);
	if (strcmp(what, "assign") == 0 && argc == 1)
		return assign(lss, argv[0], with_store);
	if (strcmp(what, "node-id") == 0 && argc == 1)
		return change_node_id(lss, argv[0]);
	if (strcmp(what, "bit-rate") == 0 && argc == 1)
		return change_bit_rate(lss, argv[0], delay);
	if (strcmp(what, "store") == 0 && argc == 0)
		return store_selected(lss);
	if (strcmp(what, "inquire") == 0 && argc == 0)
		return inquire(lss);
	usage();
}

int sdo_command_lss(struct session *s, int argc, char **argv)
{
	struct lss lss = {.session = s, .answer_ms = s->timeout_given ? s->timeout_ms : ANSWER_MS};
	bool with_store = sdo_extract_flag(&argc, argv, "--store");
	const char *delay = sdo_extract_value(&argc, argv, "--activate");

	extract_identity(&lss, &argc, argv);
	if (argc == 0)
		usage();
	lss.bus = cli_open_bus(s->bus);
	int exit_code = run(&lss, argv[0], argc - 1, argv + 1, with_store, delay);
	can_close(lss.bus);
	return lss.unsent ? CLI_FAILED : exit_code;
}

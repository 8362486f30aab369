/* What each command of CiA 309-3 does with the bus, with this node and with the log, frame by frame. The bytes of the
 * frames are written out from CiA 301 (NMT, SDO, PDO) and CiA 305 (LSS); the answers are those of CANopenNode's
 * canopend. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "gateway/cia309/cia309.h"
#include "od/little_endian.h"
#include "od_values.h"

enum { NODE = 5, FRAMES = 400, TEXT = 60000 };

static struct od od;
static struct od_values values;
static struct canopen_node node;
static struct can_port bus;
static struct cia309 g;
static struct cia309_session *client;
static uint64_t now_us;

/* ---- around the gateway ------------------------------------------------------------------------------------------ */

static struct can_msg sent[FRAMES], received[FRAMES]; /* on the bus; by this node */
static size_t sent_count, received_count, filters;
static int send_result;
static uint32_t listened[64];
static size_t listened_count;
static char logged[TEXT];
static unsigned log_number;
static enum od_status write_status; /* of objects of this node; OD_OK: what the dictionary says */
static uint8_t written[OD_DOMAIN_MAX];
static size_t written_size;

static void (*other_nodes)(const struct can_msg *msg); /* get each frame that is sent */

static int bus_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	if (send_result == 0 && msg->id != 0x700 + NODE)
		sent[sent_count++ % FRAMES] = *msg;
	return send_result;
}

static int bus_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port;
	memcpy(listened, ids, n * sizeof(*ids));
	listened_count = n;
	filters++;
	return 0;
}

static void receive(void *ctx, const struct can_msg *msg, uint64_t t_us)
{
	(void)ctx;
	assert_int_equal(t_us, now_us);
	received[received_count++ % FRAMES] = *msg;
	if (msg->id == 0)
		canopen_receive(&node, msg, t_us);
}

static enum od_status write_object(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t t_us)
{
	(void)ctx;
	memcpy(written, wire, size);
	written_size = size;
	return write_status ? write_status : canopen_write(&node, index, sub, wire, size, t_us);
}

static void log_change(
	void *ctx, unsigned number, const char *who, const char *command, const char *answer, uint64_t t_us)
{
	(void)ctx, (void)t_us;
	log_number = number;
	snprintf(logged + strlen(logged), sizeof(logged) - strlen(logged), "%s: %s: %s\n", who, command, answer);
}

static void start_as(uint8_t id)
{
	static const struct can_ops ops = {.send = bus_send, .filter = bus_filter};
	static const struct cia309_device device = {.receive = receive, .write = write_object, .log = log_change};

	now_us = 1000000;
	bus = (struct can_port){.ops = &ops, .fd = -1};
	send_result = 0;
	od_init(&od, &imu9_od_table, &values, id);
	assert_int_equal(canopen_init(&node, &od, &bus, NULL, id), 0);
	canopen_start(&node, now_us);
	canopen_tick(&node, now_us);
	cia309_init(&g, &device, &node, &bus);
	client = cia309_open(&g, "me", true);
	sent_count = received_count = filters = 0;
	logged[0] = '\0';
	write_status = OD_OK;
	written_size = 0;
	other_nodes = NULL;
}

static int set_up(void **state)
{
	(void)state;
	start_as(NODE);
	return 0;
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

static void type(struct cia309_session *s, const char *text)
{
	assert_in_range(strlen(text), 1, cia309_room(s));
	cia309_input(s, text, strlen(text));
}

static char text[TEXT];

/* What the client has received so far, which is taken. */
static const char *take(struct cia309_session *s)
{
	size_t n;
	const char *bytes = cia309_output(s, &n);

	memcpy(text, bytes, n);
	text[n] = '\0';
	cia309_sent(s, n);
	return text;
}

/* What another node sends. */
static void respond(uint32_t id, const uint8_t bytes[8])
{
	struct can_msg msg = {.id = id, .len = 8};

	memcpy(msg.data, bytes, 8);
	cia309_receive(&g, &msg, now_us);
}

static size_t handed;

/* From deadline to deadline until nothing more is due. */
static void run(void)
{
	for (uint64_t next_us = now_us; next_us != UINT64_MAX;) {
		assert_in_range(next_us, now_us, now_us + 10000000);
		now_us = next_us;
		next_us = cia309_tick(&g, now_us);
		for (; handed < sent_count; handed++)
			if (other_nodes) {
				other_nodes(&sent[handed % FRAMES]);
				next_us = now_us;
			}
	}
}

static const char *ask_as(struct cia309_session *s, const char *line)
{
	char with_end[OD_DOMAIN_MAX];

	snprintf(with_end, sizeof(with_end), "%s\n", line);
	type(s, with_end);
	handed = sent_count;
	run();
	return take(s);
}

static const char *ask(const char *line)
{
	return ask_as(client, line);
}

#define assert_answer(line, expected) assert_string_equal(ask(line), expected "\r\n")

static void assert_frame(const struct can_msg *msg, uint32_t id, size_t size, const char *bytes)
{
	assert_int_equal(msg->id, id);
	assert_int_equal(msg->len, size);
	assert_memory_equal(msg->data, bytes, size);
}

/* ---- NMT --------------------------------------------------------------------------------------------------------- */

static const struct {
	const char *name;
	uint8_t command; /* CiA 301, 7.2.8.2.1 */
} NMT[] = {{"start", 1}, {"stop", 2}, {"preop", 128}, {"preoperational", 128}, {"reset node", 129}, {"reset comm", 130},
	{"reset communication", 130}};

static void test_nmt_commands_are_frames_to_the_other_nodes_and_commands_to_this_one(void **state)
{
	static const int NODES[] = {6, NODE, 0, 127};
	char line[64];

	(void)state;
	for (size_t i = 0; i < sizeof(NMT) / sizeof(NMT[0]); i++)
		for (size_t k = 0; k < sizeof(NODES) / sizeof(NODES[0]); k++) {
			const char frame[2] = {(char)NMT[i].command, (char)NODES[k]};
			bool own = NODES[k] == NODE || NODES[k] == 0, others = NODES[k] != NODE;

			start_as(NODE);
			snprintf(line, sizeof(line), "[1] %d %s", NODES[k], NMT[i].name);
			assert_string_equal(ask(line), "[1] OK\r\n");
			assert_int_equal(sent_count, others);
			assert_int_equal(received_count, own);
			assert_frame(others ? &sent[0] : &received[0], 0, 2, frame);
			assert_frame(own ? &received[0] : &sent[0], 0, 2, frame);
		}
}

static void test_what_the_bus_does_not_take_is_an_error_of_the_bus(void **state)
{
	static const struct {
		enum can_state state;
		const char *error;
	} STATES[] = {{CAN_STATE_ACTIVE, "303 #CAN buffer overflow."}, {CAN_STATE_PASSIVE, "303 #CAN buffer overflow."},
		{CAN_STATE_BUS_OFF, "301 #Bus off."}, {CAN_STATE_DOWN, "301 #Bus off."}};
	char expected[64];

	(void)state;
	send_result = -EIO;
	for (size_t i = 0; i < sizeof(STATES) / sizeof(STATES[0]); i++) {
		bus.state = STATES[i].state;
		snprintf(expected, sizeof(expected), "[1] ERROR:%s\r\n", STATES[i].error);
		assert_string_equal(ask("[1] 6 start"), expected);
		assert_string_equal(ask("[1] 0 start"), expected);
		assert_string_equal(ask("[1] 6 r 0x1000 0"), expected);
		assert_int_equal(received_count, 0);
	}
	assert_answer("[1] 5 start", "[1] OK"); /* needs no bus */
	assert_int_equal(received_count, 1);
}

static void test_without_a_node_the_default_is_meant(void **state)
{
	(void)state;
	assert_answer("[1] start", "[1] ERROR:105 #No default node set.");
	assert_answer("[1] r 0x1000 0", "[1] ERROR:105 #No default node set.");
	assert_answer("[1] set node 1", "[1] OK");
	assert_answer("[1] start", "[1] OK");
	assert_frame(&sent[0], 0, 2, "\1\1");
	assert_answer("[1] 6 start", "[1] OK");
	assert_frame(&sent[1], 0, 2, "\1\6");
	assert_answer("[1] r p 1", "[1] ERROR:107 #Unsupported node.");
	assert_answer("[1] set network 1", "[1] OK");
	assert_answer("[1] set network 0", "[1] OK");
	assert_answer("[1] set network 2", "[1] ERROR:106 #Unsupported net.");
	assert_int_equal(sent_count, 2);
}

static void test_a_gateway_without_a_node_id_is_no_master(void **state)
{
	(void)state;
	start_as(CANOPEN_UNCONFIGURED);
	assert_answer("[1] 6 start", "[1] ERROR:102 #Request not processed due to internal state.");
	assert_answer("[1] 6 r 0x1000 0", "[1] ERROR:102 #Request not processed due to internal state.");
	assert_int_equal(sent_count, 0);
}

/* ---- SDO --------------------------------------------------------------------------------------------------------- */

/* CiA 301, 7.2.4.3: the first byte of a request. */
static void test_the_transfers_of_other_nodes_are_segmented_or_in_blocks_as_set(void **state)
{
	(void)state;
	ask("[1] 6 r 0x1017 2");
	assert_frame(&sent[0], 0x606, 8, "\x40\x17\x10\x02\0\0\0\0");
	ask("[1] 6 w 0x1017 2 u16 0x1234");
	assert_frame(&sent[2], 0x606, 8, "\x2B\x17\x10\x02\x34\x12\0\0");
	assert_answer("[1] set sdo_block 1", "[1] OK");
	ask("[1] 7 r 0x1017 2");
	assert_int_equal(sent[4].id, 0x607);
	assert_int_equal(sent[4].data[0] & 0xE3, 0xA0);
	ask("[1] 7 w 0x1017 2 u16 0x1234");
	assert_int_equal(sent[6].data[0] & 0xE1, 0xC0);
	assert_answer("[1] set sdo_block 0", "[1] OK");
	ask("[1] 7 r 0x1017 2");
	assert_int_equal(sent[8].data[0], 0x40);
}

static bool listens_to(uint32_t id)
{
	for (size_t i = 0; i < listened_count; i++)
		if (listened[i] == id)
			return true;
	return false;
}

static void test_the_filter_of_the_bus_changes_with_the_node_that_is_asked(void **state)
{
	(void)state;
	ask("[1] 6 r 0x1017 0");
	assert_true(listens_to(0x586) && listens_to(0x7E4));
	assert_int_equal(filters, 1);
	ask("[1] 6 r 0x1018 1");
	assert_int_equal(filters, 1);
	ask("[1] 7 r 0x1018 1");
	assert_true(listens_to(0x587) && !listens_to(0x586));
	assert_int_equal(filters, 2);
}

static void serve_sdo(const struct can_msg *msg)
{
	uint8_t answer[8];

	if (msg->id != 0x606)
		return;
	memcpy(answer, msg->data, 8);
	if (msg->data[3] == 9) {
		answer[0] = 0x80;
		put_u32(answer + 4, 0x06090011);
	} else if (msg->data[0] == 0x40) {
		answer[0] = 0x4B; /* two bytes */
		answer[4] = 0xE8, answer[5] = 0x03;
	} else {
		answer[0] = 0x60;
		memset(answer + 4, 0, 4);
	}
	respond(0x586, answer);
}

static void test_what_another_node_answers_is_told(void **state)
{
	(void)state;
	other_nodes = serve_sdo;
	assert_answer("[1] 6 r 0x1017 0", "[1] E8 03");
	assert_answer("[1] 6 r 0x1017 0 u16", "[1] 1000");
	assert_answer("[1] 6 r 0x1017 0 u32", "[1] E8 03"); /* of another size */
	assert_answer("[1] 6 w 0x1017 0 u16 1", "[1] OK");
	assert_answer("[1] 6 r 0x1017 9", "[1] ERROR:0x06090011 #the object has no such sub-index");
	assert_answer("[1] 6 w 0x1017 9 u16 1", "[1] ERROR:0x06090011 #the object has no such sub-index");
	other_nodes = NULL;
}

/* cocomm takes the head for the whole answer when the value comes later. */
static void test_a_short_answer_comes_in_one_piece(void **state)
{
	(void)state;
	type(client, "[1] 6 r 0x1017 0 u16\n");
	cia309_tick(&g, now_us);
	respond(0x586, (const uint8_t[8]){0x4B, 0x17, 0x10, 0, 0xE8, 3});
	cia309_tick(&g, now_us);
	assert_string_equal(take(client), "[1] 1000\r\n");
}

static void test_the_time_for_an_answer_is_as_set_by_clients_with_the_same_rights(void **state)
{
	struct cia309_session *reader = cia309_open(&g, "reader", false);
	uint64_t start_us = now_us;

	(void)state;
	ask("[1] 6 r 0x1017 0");
	assert_in_range(now_us - start_us, 500000, 502000);
	assert_answer("[1] set sdo_timeout 20", "[1] OK");
	start_us = now_us;
	ask("[1] 6 r 0x1017 0");
	assert_in_range(now_us - start_us, 20000, 22000);
	start_us = now_us;
	ask_as(reader, "[1] 6 r 0x1017 0");
	assert_in_range(now_us - start_us, 500000, 502000);
}

static void test_a_value_that_is_none_reaches_nobody(void **state)
{
	char line[200] = "[1] 5 w 0x1010 1 vs ";

	(void)state;
	assert_answer("[1] 6 w 0x1017 0 u16 65536", "[1] ERROR:101 #Syntax error.");
	assert_answer("[1] 5 w 0x1017 0 u16 x", "[1] ERROR:101 #Syntax error.");
	memset(line + strlen(line), 'a', OD_VALUE_MAX + 1);
	assert_string_equal(ask(line), "[1] ERROR:0x06070012 #the value is too long for the type of the object\r\n");
	assert_int_equal(sent_count, 0);
	assert_int_equal(written_size, 0);
	line[strlen("[1] 5 w 0x1010 1 vs ") + OD_VALUE_MAX] = '\0';
	write_status = OD_BAD_VALUE;
	ask(line);
	assert_int_equal(written_size, OD_VALUE_MAX);
}

/* ---- this node --------------------------------------------------------------------------------------------------- */

static size_t few(void *ctx, uint8_t *out)
{
	(void)ctx;
	memcpy(out, "some\nlines", 10);
	return 10;
}

static enum od_status take_data(void *ctx, const uint8_t *data, size_t size)
{
	(void)ctx, (void)data;
	return size > 3 ? OD_OK : OD_TOO_SHORT;
}

static void test_long_objects_of_this_node_are_read_and_written(void **state)
{
	static struct od_domain eds, log, store;

	(void)state;
	assert_answer("[1] 5 r 0x1021 0 vs", "[1] ERROR:0x08000024 #no data available");
	assert_answer("[1] log", "");
	eds = (struct od_domain){.index = 0x1021, .data = (const uint8_t *)"[FileInfo]", .size = 10};
	log = (struct od_domain){.index = 0x2131, .read = few};
	store = (struct od_domain){.index = 0x2130, .write = take_data, .data = (const uint8_t *)"x", .size = 1};
	od_set_domain(&od, &eds);
	od_set_domain(&od, &log);
	od_set_domain(&od, &store);
	assert_answer("[1] 5 r 0x1021 0 vs", "[1] \"[FileInfo]\"");
	assert_answer("[1] 5 r 0x2131 0 vs", "[1] \"some\nlines\"");
	assert_answer("[1] log", "some\nlines");
	assert_answer(
		"[1] 5 w 0x2130 0 vs \"\"", "[1] ERROR:0x06070013 #the value is too short for the type of the object");
	assert_answer("[1] 5 w 0x2130 0 vs data", "[1] OK");
	assert_int_equal(written_size, 4);
	assert_answer(
		"[1] 5 w 0x2130 0 vs d", "[1] ERROR:0x06070013 #the value is too short for the type of the object");
	assert_answer("[1] 5 w 0x1021 0 vs data", "[1] ERROR:0x06010002 #the object can only be read");
	assert_int_equal(sent_count, 0);
}

/* No object of the device is one; a dictionary may have it. */
static void test_a_long_object_that_can_only_be_written_is_not_read(void **state)
{
	static struct od_entry entries[1];
	static struct od_domain program;
	const struct od_table *whole = od.table, table = {.entries = entries, .count = 1};

	(void)state;
	entries[0] = *od_find(whole, 0x2130, 0, NULL);
	entries[0].access = OD_WRITE;
	program = (struct od_domain){.index = 0x2130, .write = take_data, .data = (const uint8_t *)"x", .size = 1};
	od_set_domain(&od, &program);
	od.table = &table;
	assert_answer("[1] 5 r 0x2130 0 vs", "[1] ERROR:0x06010001 #the object can only be written");
	assert_answer("[1] 5 w 0x2130 0 vs data", "[1] OK");
	od.table = whole;
}

static void test_a_write_that_takes_longer_is_answered_at_its_end(void **state)
{
	(void)state;
	write_status = OD_PENDING;
	assert_string_equal(ask("[1] 5 w 0x1010 1 vs save"), "");
	assert_false(cia309_idle(client));
	struct cia309_session *other = cia309_open(&g, "other", true);
	write_status = OD_OK;
	assert_string_equal(ask_as(other, "[7] 5 w 0x1017 0 u16 4"), "[7] OK\r\n");
	g.listener.stored(g.listener.ctx, OD_CANNOT_STORE);
	assert_string_equal(take(client), "[1] ERROR:0x08000020 #the data cannot be transferred or stored\r\n");
	assert_true(cia309_idle(client));
	g.listener.stored(g.listener.ctx, OD_OK); /* of somebody else */
	assert_string_equal(take(client), "");
	write_status = OD_PENDING;
	assert_string_equal(ask("[2] 5 w 0x1010 1 vs save"), "");
	g.listener.stored(g.listener.ctx, OD_OK);
	assert_string_equal(take(client), "[2] OK\r\n");
}

/* Bytes from the most significant on, as wide as each object. */
static void test_each_pdo_of_this_node_is_read_by_its_number(void **state)
{
	(void)state;
	values.acceleration.l = 0x1234;
	values.acceleration.s = -2;
	values.sample.counter = 0xABC;
	values.sample.status = 0x8001;
	values.sample.time = 0x00BC614E;
	assert_answer("[1] r p 1", "[1] 1 pdo 4 0x1234 0xFFFE 0x0000 0x0ABC");
	assert_answer("[1] 5 r p 4", "[1] 1 pdo 3 0x8001 0x0ABC 0x00BC614E");
	assert_answer("[1] r p 5", "[1] ERROR:102 #Request not processed due to internal state.");
	assert_answer("[1] r p 512", "[1] ERROR:102 #Request not processed due to internal state.");
	assert_answer("[1] 0 r p 1", "[1] ERROR:107 #Unsupported node.");
}

static void test_a_pdo_that_is_written_is_its_frame_to_this_node(void **state)
{
	(void)state;
	assert_answer("[1] 5 w p 2 2 1 2", "[1] ERROR:204 #Wrong NMT state.");
	ask("[1] 5 start");
	assert_answer("[1] 5 w p 2 2 0x3FC00000 0x12345678", "[1] OK");
	assert_frame(&received[1], 0x300 + NODE, 8, "\0\0\xC0\x3F\x78\x56\x34\x12");
	assert_answer("[1] w p 2 2 0xFFFFFFFF 0", "[1] OK");
	assert_answer("[1] w p 2 2 0x100000000 0", "[1] ERROR:101 #Syntax error.");
	assert_answer("[1] w p 2 2 0 0x100000000", "[1] ERROR:101 #Syntax error.");
	assert_answer("[1] w p 2 1 0", "[1] ERROR:401 #PDO length exceeded.");
	assert_answer("[1] w p 2 3 0 0 0", "[1] ERROR:401 #PDO length exceeded.");
	assert_answer("[1] w p 5 1 0", "[1] ERROR:102 #Request not processed due to internal state.");
	assert_answer("[1] 6 w p 2 2 0 0", "[1] ERROR:107 #Unsupported node.");
	assert_int_equal(received_count, 3);
	assert_int_equal(sent_count, 0);
}

static void test_the_version_is_that_of_the_identity(void **state)
{
	(void)state;
	values.identity.vendor_id = 11;
	values.identity.product_code = 22;
	values.identity.revision_number = 0x00030004;
	values.identity.serial_number = 55;
	assert_answer("[9] info version", "[9] 11 22 3.4 55 1 3.0 " IMU9_VERSION);
}

static void test_an_answer_has_the_longest_number_of_its_command(void **state)
{
	(void)state;
	assert_answer("[4294967295] set node 5", "[4294967295] OK");
	assert_answer("[4294967295] 5 r 0x1017 0 u16", "[4294967295] 1000");
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

/* CiA 305, 6.4: the frame of each request; the command of its answer, 0: there is none; how long it is waited for. */
static const struct lss_case {
	const char *line, *request;
	uint8_t answer;
	unsigned ms;
	const char *refused; /* the meaning of an error code; NULL: it has none */
	const char *good;    /* the answer when the node sends 78 56 34 12 behind its command */
} LSS[] = {
	{"lss_switch_glob 1", "\x04\1\0\0\0\0\0\0", 0, 0, NULL, NULL},
	{"lss_switch_glob 0", "\x04\0\0\0\0\0\0\0", 0, 0, NULL, NULL},
	{"lss_activate_bitrate 1000", "\x15\xE8\x03\0\0\0\0\0", 0, 0, NULL, NULL},
	{"lss_set_node 0x22", "\x11\x22\0\0\0\0\0\0", 0x11, 1000, "502 #LSS node-ID not supported.", "OK"},
	{"lss_conf_bitrate 0 3", "\x13\0\3\0\0\0\0\0", 0x13, 1000, "503 #LSS bit-rate not supported.", "OK"},
	{"lss_store", "\x17\0\0\0\0\0\0\0", 0x17, 5000, "504 #LSS parameter storing failed.", "OK"},
	{"lss_inquire_addr 0", "\x5A\0\0\0\0\0\0\0", 0x5A, 1000, NULL, "0x12345678"},
	{"lss_inquire_addr 1", "\x5B\0\0\0\0\0\0\0", 0x5B, 1000, NULL, "0x12345678"},
	{"lss_inquire_addr 2", "\x5C\0\0\0\0\0\0\0", 0x5C, 1000, NULL, "0x12345678"},
	{"lss_inquire_addr 3", "\x5D\0\0\0\0\0\0\0", 0x5D, 1000, NULL, "0x12345678"},
	{"lss_get_node", "\x5E\0\0\0\0\0\0\0", 0x5E, 1000, NULL, "0x78"},
	{"lss_switch_sel 1 2 3 0x87654321", "\x43\x21\x43\x65\x87\0\0\0", 0x44, 1000, NULL, "OK"},
};

static uint8_t lss_answer[8];

static void answer_lss(const struct can_msg *msg)
{
	if (msg->id == 0x7E5 && lss_answer[0])
		respond(0x7E4, lss_answer);
}

static const char *ask_lss(const struct lss_case *c, uint8_t answer, uint32_t value)
{
	char line[64];

	lss_answer[0] = answer;
	put_u32(lss_answer + 1, value);
	other_nodes = answer_lss;
	snprintf(line, sizeof(line), "[1] %s", c->line);
	ask(line);
	other_nodes = NULL;
	return text;
}

static void assert_text(const char *expected)
{
	char whole[128];

	snprintf(whole, sizeof(whole), "[1] %s\r\n", expected);
	assert_string_equal(text, whole);
}

static void test_each_lss_command_is_its_frame_and_waits_for_its_answer(void **state)
{
	(void)state;
	for (const struct lss_case *c = LSS; c < LSS + sizeof(LSS) / sizeof(LSS[0]); c++) {
		start_as(NODE);
		uint64_t start_us = now_us;
		char error[64];

		ask_lss(c, 0, 0);
		assert_frame(&sent[sent_count - 1], 0x7E5, 8, c->request);
		assert_frame(&received[sent_count - 1], 0x7E5, 8, c->request); /* this node is a slave, too */
		assert_text(c->answer ? "ERROR:103 #Time-out." : "OK");
		assert_in_range(now_us - start_us, c->ms * 1000, c->ms * 1000 + 2000);
		if (!c->answer)
			continue;
		start_us = now_us;
		ask_lss(c, c->answer, c->refused ? 0 : 0x12345678);
		assert_text(c->good);
		assert_in_range(now_us - start_us, 0, 2000);
		ask_lss(c, c->answer ^ 0x80, 0); /* of another service */
		assert_text("ERROR:103 #Time-out.");
		if (!c->refused)
			continue;
		snprintf(error, sizeof(error), "ERROR:%s", c->refused);
		ask_lss(c, c->answer, 1);
		assert_text(error);
		ask_lss(c, c->answer, 0x07FF); /* 255: one of the manufacturer */
		assert_text("ERROR:501 #LSS implementation- / manufacturer-specific error.");
	}
}

/* Another master of the bus has asked this node before. */
static void test_an_answer_of_this_node_to_another_lss_master_is_none_to_the_gateway(void **state)
{
	const struct can_msg answer = {.id = 0x7E4, .len = 8, .data = {0x5E, NODE}};

	(void)state;
	g.listener.lss_answered(g.listener.ctx, &answer);
	run();
	assert_answer("[1] lss_get_node", "[1] ERROR:103 #Time-out.");
}

static void test_a_selected_node_is_told_all_four_parts_of_its_address(void **state)
{
	(void)state;
	ask("[1] lss_switch_sel 0x494D55 2 0xFFFFFFFF 0");
	assert_int_equal(sent_count, 4);
	assert_frame(&sent[0], 0x7E5, 8, "\x40\x55\x4D\x49\0\0\0\0");
	assert_frame(&sent[1], 0x7E5, 8, "\x41\2\0\0\0\0\0\0");
	assert_frame(&sent[2], 0x7E5, 8, "\x42\xFF\xFF\xFF\xFF\0\0\0");
	assert_frame(&sent[3], 0x7E5, 8, "\x43\0\0\0\0\0\0\0");
}

static void answer_inquiry(const struct can_msg *msg)
{
	const uint8_t answer[8] = {msg->data[0], (uint8_t)(msg->data[0] - 0x50), 0, 0, 0x10};

	respond(0x7E4, answer);
}

static void test_a_whole_lss_address_is_inquired_part_by_part(void **state)
{
	(void)state;
	other_nodes = answer_inquiry;
	assert_answer("[1] lss_inquire_addr", "[1] 0x1000000A 0x1000000B 0x1000000C 0x1000000D");
	other_nodes = NULL;
	assert_int_equal(sent_count, 4);
}

/* Nodes without a node-ID and with a serial number of 0 bits only: each answers every question of a fastscan. */
static struct {
	unsigned nodes, stores;
	bool deaf; /* after the first question */
	uint8_t node_error, store_error;
	bool no_node_answer, no_store_answer;
	uint8_t ids[128];
	unsigned assigned;
	uint32_t match[4];
} slaves;

static void scan(const struct can_msg *msg)
{
	uint8_t answer[8] = {0x4F};

	if (msg->id != 0x7E5)
		return;
	switch (msg->data[0]) {
	case 0x51:
		if (slaves.nodes == 0 || (slaves.deaf && msg->data[5] != 0x80))
			return;
		if (msg->data[5] == 0)
			slaves.match[msg->data[6]] = get_u32(msg->data + 1);
		respond(0x7E4, answer);
		break;
	case 0x11:
		slaves.ids[slaves.assigned++] = msg->data[1];
		answer[0] = 0x11;
		answer[1] = slaves.node_error;
		if (!slaves.no_node_answer)
			respond(0x7E4, answer);
		break;
	case 0x17:
		slaves.stores++;
		answer[0] = 0x17;
		answer[1] = slaves.store_error;
		if (!slaves.no_store_answer)
			respond(0x7E4, answer);
		break;
	case 0x04:
		assert_int_equal(msg->data[1], 0); /* back to the waiting state */
		slaves.nodes--;
		break;
	default:
		fail();
	}
}

static const char *scan_nodes(unsigned nodes, const char *line)
{
	slaves.nodes = nodes;
	slaves.stores = slaves.assigned = 0;
	other_nodes = scan;
	ask(line);
	other_nodes = NULL;
	return text;
}

static void test_all_nodes_get_node_ids_from_the_first_on(void **state)
{
	(void)state;
	memset(&slaves, 0, sizeof(slaves));
	assert_string_equal(scan_nodes(2, "[1] lss_allnodes"),
		"# Node-ID 2 assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n"
		"# Node-ID 3 assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n"
		"# Found 2 nodes, search finished.\n[1] OK\r\n");
	assert_memory_equal(slaves.ids, "\2\3", 2);
	assert_int_equal(slaves.stores, 2);
	scan_nodes(1, "[1] lss_allnodes 10"); /* without a node-ID */
	assert_int_equal(slaves.ids[0], 2);
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 10 50 0"),
		"# Node-ID 50 assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n"
		"# Found 1 nodes, search finished.\n[1] OK\r\n");
	assert_int_equal(slaves.stores, 0);
	scan_nodes(1, "[1] lss_allnodes 10 50 1");
	assert_int_equal(slaves.stores, 1);
	assert_string_equal(scan_nodes(3, "[1] lss_allnodes 10 126 0"),
		"# Node-ID 126 assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n"
		"# Node-ID 127 assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n"
		"# Not all nodes scanned!\n[1] OK\r\n");
}

static void test_a_search_asks_for_the_parts_of_the_address_that_are_given(void **state)
{
	(void)state;
	memset(&slaves, 0, sizeof(slaves));
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 10 9 0 2 0x494D55 2 7 1 0 2 0xFFFFFFFF"),
		"# Node-ID 9 assigned to: 0x00494D55 0x00000007 0x00000000 0xFFFFFFFF\n"
		"# Found 1 nodes, search finished.\n[1] OK\r\n");
	assert_int_equal(slaves.match[0], 0x494D55);
	assert_int_equal(slaves.match[1], 7);
	assert_int_equal(slaves.match[3], 0xFFFFFFFF);
	assert_string_equal(
		scan_nodes(1, "[1] _lss_fastscan 10"), "[1] 0x00000000 0x00000000 0x00000000 0x00000000\r\n");
}

static void test_the_time_of_a_question_of_a_search_is_100_ms_or_as_said(void **state)
{
	static const struct {
		const char *line;
		unsigned ms;
	} LINES[] = {{"[1] _lss_fastscan", 100}, {"[1] _lss_fastscan 0", 100}, {"[1] _lss_fastscan 7", 7},
		{"[1] lss_allnodes", 100}, {"[1] lss_allnodes 30", 30}, {"[1] lss_allnodes 30 5 1", 30}};

	(void)state;
	memset(&slaves, 0, sizeof(slaves));
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++) {
		uint64_t start_us = now_us;

		scan_nodes(0, LINES[i].line);
		assert_in_range(now_us - start_us, LINES[i].ms * 1000, LINES[i].ms * 1000 + 2000);
		assert_string_equal(text, LINES[i].line[4] == '_' ? "[1] ERROR:103 #Time-out.\r\n"
								  : "# Found 0 nodes, search finished.\n[1] OK\r\n");
	}
}

static void test_a_search_that_fails_tells_at_which_step(void **state)
{
	uint64_t start_us;

	(void)state;
	memset(&slaves, 0, sizeof(slaves));
	slaves.deaf = true;
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 10 9 1 2 1 2 2 2 3 2 4"),
		"[1] ERROR:102 #Request not processed due to internal state.\r\n");
	slaves.deaf = false;
	slaves.node_error = 1;
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 10 9 1"), "[1] ERROR:502 #LSS node-ID not supported.\r\n");
	slaves.node_error = 255;
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 10 9 1"),
		"[1] ERROR:501 #LSS implementation- / manufacturer-specific error.\r\n");
	slaves.node_error = 0;
	slaves.store_error = 1;
	assert_string_equal(
		scan_nodes(1, "[1] lss_allnodes 10 9 1"), "[1] ERROR:504 #LSS parameter storing failed.\r\n");
	slaves.no_node_answer = true;
	start_us = now_us;
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 1 9 1"), "[1] ERROR:103 #Time-out.\r\n");
	assert_in_range(now_us - start_us, 1000000, 1200000);
	slaves.no_node_answer = false;
	slaves.no_store_answer = true;
	start_us = now_us;
	assert_string_equal(scan_nodes(1, "[1] lss_allnodes 1 9 1"), "[1] ERROR:103 #Time-out.\r\n");
	assert_in_range(now_us - start_us, 5000000, 5200000);
}

/* The client takes its answers late: the search waits for it, and nothing is lost. */
static void test_a_search_waits_for_the_client_that_takes_its_answers(void **state)
{
	static char all[TEXT];
	size_t n;

	(void)state;
	memset(&slaves, 0, sizeof(slaves));
	slaves.nodes = 126;
	all[0] = '\0';
	other_nodes = scan;
	type(client, "[1] lss_allnodes 10 2 0\n");
	handed = sent_count;
	do {
		run();
		cia309_output(client, &n);
		assert_true(n <= CIA309_OUT_MAX - 32);
		strcat(all, take(client));
		assert_true(strlen(all) < TEXT - CIA309_OUT_MAX);
	} while (!cia309_idle(client));
	other_nodes = NULL;
	for (unsigned id = 2; id <= 127; id++) {
		char line[100];

		snprintf(line, sizeof(line), "# Node-ID %u assigned to: 0x00000000 0x00000000 0x00000000 0x00000000\n",
			id);
		assert_non_null(strstr(all, line));
	}
	assert_non_null(strstr(all, "# Not all nodes scanned!\n[1] OK\r\n"));
}

/* ---- rights and log ---------------------------------------------------------------------------------------------- */

static const struct {
	const char *line;
	bool changes;
} RIGHTS[] = {{"5 r 0x1017 0", false}, {"6 r 0x1017 0", false}, {"r p 1", false}, {"set network 1", false},
	{"set node 5", false}, {"set sdo_timeout 500", false}, {"set sdo_block 0", false}, {"info version", false},
	{"help", false}, {"help datatype", false}, {"help lss", false}, {"log", false}, {"5 w 0x1017 0 u16 5", true},
	{"6 w 0x1017 0 u16 5", true}, {"w p 2 2 0 0", true}, {"5 start", true}, {"5 stop", true}, {"5 preop", true},
	{"6 reset node", true}, {"6 reset comm", true}, {"lss_switch_glob 0", true}, {"lss_switch_sel 1 2 3 4", true},
	{"lss_set_node 3", true}, {"lss_conf_bitrate 0 1", true}, {"lss_activate_bitrate 1", true}, {"lss_store", true},
	{"lss_inquire_addr", true}, {"lss_get_node", true}, {"_lss_fastscan", true}, {"lss_allnodes", true}};

static void test_what_changes_something_is_logged_and_refused_to_who_only_reads(void **state)
{
	char line[64];

	(void)state;
	for (size_t i = 0; i < sizeof(RIGHTS) / sizeof(RIGHTS[0]); i++) {
		start_as(NODE);
		struct cia309_session *reader = cia309_open(&g, "reader", false);

		snprintf(line, sizeof(line), "[1] %s", RIGHTS[i].line);
		bool refused = strstr(ask_as(reader, line), "[1] ERROR:102 #Not permitted: the address of --cia309 "
							    "has no ',write=yes'.\r\n");
		assert_int_equal(refused, RIGHTS[i].changes);
		if (RIGHTS[i].changes) {
			assert_int_equal(sent_count + received_count, 0);
			assert_memory_equal(logged, "reader: [1] ", 12);
			assert_int_equal(log_number, 0);
			logged[0] = '\0';
		}
		assert_int_equal(strlen(logged), 0);
		assert_null(strstr(ask(line), "Not permitted"));
		assert_int_equal(logged[0] != '\0', RIGHTS[i].changes);
	}
}

static void test_equal_changes_have_the_same_number_in_the_log_and_others_another(void **state)
{
	static const char *const LINES[] = {"[1] 5 w 0x1017 0 u16 5", "[2] 5 w 0x1017 0 u16 6", "[3] 5 w 0x1018 0 u8 6",
		"[4] 5 w 0x1017 1 u16 6", "[5] 5 start", "[6] 6 start", "[7] 5 stop"};
	static const unsigned SAME_AS[] = {0, 0, 2, 3, 4, 4, 6};
	unsigned numbers[7];

	(void)state;
	for (size_t i = 0; i < 7; i++) {
		ask(LINES[i]);
		numbers[i] = log_number;
		assert_int_not_equal(numbers[i], 0);
		for (size_t k = 0; k < i; k++)
			assert_int_equal(numbers[k] == numbers[i], SAME_AS[k] == SAME_AS[i]);
	}
}

static unsigned number_of_write(unsigned index, unsigned sub)
{
	char line[64];

	snprintf(line, sizeof(line), "[1] 5 w 0x%04X %u u8 0", index, sub);
	ask(line);
	return log_number;
}

static void test_each_bit_of_an_index_and_a_sub_index_makes_another_number(void **state)
{
	const unsigned number = number_of_write(0x5A5A, 0x5A);

	(void)state;
	for (unsigned bit = 0; bit < 16; bit++)
		assert_int_not_equal(number_of_write(0x5A5A ^ 1u << bit, 0x5A), number);
	for (unsigned bit = 0; bit < 8; bit++)
		assert_int_not_equal(number_of_write(0x5A5A, 0x5A ^ 1u << bit), number);
}

static void test_the_log_gets_what_can_be_printed_of_a_line_up_to_63_characters(void **state)
{
	char line[200] = "[1] 5 start #";

	(void)state;
	ask("[1] 5 start # \x01\x1F\x7F\xC3~\t\r");
	assert_string_equal(logged, "me: [1] 5 start #     ~: OK\n");
	logged[0] = '\0';
	memset(line + strlen(line), 'c', 63 - strlen(line));
	ask(line);
	assert_memory_equal(logged + 4, line, 63);
	assert_string_equal(logged + 67, ": OK\n");
	logged[0] = '\0';
	strcat(line, "d");
	ask(line);
	assert_memory_equal(logged + 4, line, 63);
	assert_string_equal(logged + 67, ": OK\n");
}

static void test_a_line_that_is_no_command_is_not_logged(void **state)
{
	(void)state;
	assert_answer("[1] 5 w 0x1017", "[1] ERROR:101 #Syntax error.");
	assert_answer("[1] 300 start", "[1] ERROR:107 #Unsupported node.");
	assert_answer("start", "[0] ERROR:101 #Syntax error.");
	assert_answer("", "");
	assert_int_equal(strlen(logged), 0);
}

/* ---- turns ------------------------------------------------------------------------------------------------------- */

static void test_clients_with_many_lines_take_turns_of_a_millisecond(void **state)
{
	struct cia309_session *s[3] = {client, cia309_open(&g, "2", true), cia309_open(&g, "3", true)};

	(void)state;
	for (int i = 0; i < 3; i++)
		type(s[i], "[1] r p 1\n[2] r p 1\n[3] r p 1\n");
	for (unsigned turn = 0; turn < 9; turn++) {
		uint64_t next_us = cia309_tick(&g, now_us);
		char head[8];

		snprintf(head, sizeof(head), "[%u] ", turn / 3 + 1);
		for (unsigned i = 0; i < 3; i++) {
			take(s[i]);
			assert_int_equal(text[0] != '\0', i == turn % 3);
			if (i == turn % 3)
				assert_memory_equal(text, head, 4);
		}
		if (turn < 8)
			assert_int_equal(cia309_tick(&g, now_us), now_us + 1000);
		(void)next_us;
		now_us += 999;
		cia309_tick(&g, now_us);
		take(s[(turn + 1) % 3]);
		assert_int_equal(text[0], '\0');
		now_us++;
	}
	assert_int_equal(cia309_tick(&g, now_us), UINT64_MAX);
}

static void test_a_client_that_takes_no_answer_gets_no_other(void **state)
{
	size_t n;

	(void)state;
	type(client, "[1] r p 1\n[2] r p 1\n");
	run();
	cia309_output(client, &n);
	now_us += 1000000;
	run();
	size_t later;
	cia309_output(client, &later);
	assert_int_equal(later, n);
	cia309_sent(client, n - 1);
	run();
	cia309_output(client, &later);
	assert_int_equal(later, 1);
	assert_memory_equal(take(client), "\n", 1);
	run();
	assert_memory_equal(take(client), "[2] ", 4);
}

/* A client that prints a long value keeps the buffer; it is not given to another before the end. */
static size_t many(void *ctx, uint8_t *out)
{
	memset(out, *(char *)ctx, OD_DOMAIN_MAX);
	return OD_DOMAIN_MAX;
}

static void test_a_long_answer_is_not_overwritten_by_another_client(void **state)
{
	static struct od_domain log;
	struct cia309_session *second = cia309_open(&g, "2", false), *third = cia309_open(&g, "3", false);
	char letter = 'a';
	size_t as = 0, n;

	(void)state;
	log = (struct od_domain){.index = 0x2131, .read = many, .ctx = &letter};
	od_set_domain(&od, &log);
	type(client, "[1] log\n");
	run();
	letter = 'b';
	type(second, "[2] 5 r 0x2131 0 vs\n");
	type(third, "[3] log\n");
	run();
	cia309_output(second, &n);
	assert_int_equal(n, 0);
	cia309_output(third, &n);
	assert_int_equal(n, 0);
	for (const char *piece; *(piece = take(client)); run()) {
		as += strspn(piece, "a");
		cia309_output(second, &n);
		assert_true(n == 0 || as == OD_DOMAIN_MAX);
	}
	assert_int_equal(as, OD_DOMAIN_MAX);
	run();
	assert_memory_equal(take(second), "[2] \"bbb", 8);
	cia309_output(third, &n);
	assert_int_equal(n, 0);
	cia309_close(&g, second); /* in the middle of its answer */
	run();
	assert_memory_equal(take(third), "bbb", 3);
}

static size_t letters(void *ctx, uint8_t *out)
{
	memset(out, 'a', *(size_t *)ctx);
	return *(size_t *)ctx;
}

static size_t length_of_answer(const char *line)
{
	size_t length = 0;

	for (const char *piece = ask(line); *piece; piece = take(client)) {
		length += strlen(piece);
		if (cia309_idle(client))
			assert_string_equal(piece + strlen(piece) - 2, "\r\n");
		run();
	}
	return length;
}

/* The answer fills the output to the last byte, or is some bytes longer or shorter. */
static void test_a_long_answer_ends_with_its_line_break_wherever_it_ends(void **state)
{
	static struct od_domain log;
	size_t size;

	(void)state;
	log = (struct od_domain){.index = 0x2131, .read = letters, .ctx = &size};
	od_set_domain(&od, &log);
	for (unsigned number = 1; number < 10000; number *= 10) {
		char line[64];
		size_t head = (size_t)snprintf(line, sizeof(line), "[%u] ", number);

		for (size = CIA309_OUT_MAX - 20; size < CIA309_OUT_MAX + 5; size++) {
			strcpy(line + head, "5 r 0x2131 0 vs");
			assert_int_equal(length_of_answer(line), head + 1 + size + 1 + 2);
		}
		for (size = CIA309_OUT_MAX / 4 * 3 - 20; size < CIA309_OUT_MAX / 4 * 3 + 5; size++) {
			strcpy(line + head, "5 r 0x2131 0 d");
			assert_int_equal(length_of_answer(line), head + (size + 2) / 3 * 4 + 2);
		}
		for (size = CIA309_OUT_MAX / 3 - 20; size < CIA309_OUT_MAX / 3 + 5; size++) {
			strcpy(line + head, "5 r 0x2131 0");
			assert_int_equal(length_of_answer(line), head + 3 * size - 1 + 2);
		}
	}
}

/* Its answers are not taken, and there is no room for what is wrong. */
static void test_a_line_that_is_too_long_behind_a_full_output_overwrites_nothing(void **state)
{
	static char line[CIA309_LINE_MAX];
	static struct od_domain log;
	char letter = 'a';
	size_t n;

	(void)state;
	log = (struct od_domain){.index = 0x2131, .read = many, .ctx = &letter};
	od_set_domain(&od, &log);
	type(client, "[1] log\n");
	run();
	cia309_output(client, &n);
	assert_in_range(n, CIA309_OUT_MAX - 20, CIA309_OUT_MAX);
	memset(line, 'x', sizeof(line));
	cia309_input(client, line, cia309_room(client));
	assert_true(cia309_closing(client));
	assert_int_equal(client->out_used, CIA309_OUT_MAX);
	assert_int_equal(client->command.verb, CIA309_LOG);
}

static void test_a_client_that_is_gone_leaves_its_place_clean(void **state)
{
	size_t n;

	(void)state;
	type(client, "[1] r p 1\n[2] r p");
	run();
	cia309_close(&g, client);
	client = cia309_open(&g, "new", false);
	cia309_output(client, &n);
	assert_int_equal(n, 0);
	assert_true(cia309_idle(client));
	assert_int_equal(cia309_room(client), CIA309_LINE_MAX);
	assert_answer("[3] r p 9", "[3] ERROR:102 #Request not processed due to internal state.");
	assert_string_equal(client->who, "new");
}

#define TEST(name) cmocka_unit_test_setup(name, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_nmt_commands_are_frames_to_the_other_nodes_and_commands_to_this_one),
		TEST(test_what_the_bus_does_not_take_is_an_error_of_the_bus),
		TEST(test_without_a_node_the_default_is_meant),
		TEST(test_a_gateway_without_a_node_id_is_no_master),
		TEST(test_the_transfers_of_other_nodes_are_segmented_or_in_blocks_as_set),
		TEST(test_the_filter_of_the_bus_changes_with_the_node_that_is_asked),
		TEST(test_what_another_node_answers_is_told),
		TEST(test_a_short_answer_comes_in_one_piece),
		TEST(test_the_time_for_an_answer_is_as_set_by_clients_with_the_same_rights),
		TEST(test_a_value_that_is_none_reaches_nobody),
		TEST(test_long_objects_of_this_node_are_read_and_written),
		TEST(test_a_long_object_that_can_only_be_written_is_not_read),
		TEST(test_a_write_that_takes_longer_is_answered_at_its_end),
		TEST(test_each_pdo_of_this_node_is_read_by_its_number),
		TEST(test_a_pdo_that_is_written_is_its_frame_to_this_node),
		TEST(test_the_version_is_that_of_the_identity),
		TEST(test_an_answer_has_the_longest_number_of_its_command),
		TEST(test_each_lss_command_is_its_frame_and_waits_for_its_answer),
		TEST(test_an_answer_of_this_node_to_another_lss_master_is_none_to_the_gateway),
		TEST(test_a_selected_node_is_told_all_four_parts_of_its_address),
		TEST(test_a_whole_lss_address_is_inquired_part_by_part),
		TEST(test_all_nodes_get_node_ids_from_the_first_on),
		TEST(test_a_search_asks_for_the_parts_of_the_address_that_are_given),
		TEST(test_the_time_of_a_question_of_a_search_is_100_ms_or_as_said),
		TEST(test_a_search_that_fails_tells_at_which_step),
		TEST(test_a_search_waits_for_the_client_that_takes_its_answers),
		TEST(test_what_changes_something_is_logged_and_refused_to_who_only_reads),
		TEST(test_equal_changes_have_the_same_number_in_the_log_and_others_another),
		TEST(test_each_bit_of_an_index_and_a_sub_index_makes_another_number),
		TEST(test_the_log_gets_what_can_be_printed_of_a_line_up_to_63_characters),
		TEST(test_a_line_that_is_no_command_is_not_logged),
		TEST(test_clients_with_many_lines_take_turns_of_a_millisecond),
		TEST(test_a_client_that_takes_no_answer_gets_no_other),
		TEST(test_a_long_answer_is_not_overwritten_by_another_client),
		TEST(test_a_long_answer_ends_with_its_line_break_wherever_it_ends),
		TEST(test_a_line_that_is_too_long_behind_a_full_output_overwrites_nothing),
		TEST(test_a_client_that_is_gone_leaves_its_place_clean),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

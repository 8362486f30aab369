/* CiA 309-3 in simulated time: clients of node 5 send lines, as cocomm does; node 6 is another device on its bus.
 * Both are whole devices. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/ascii_gateway.h"
#include "od/little_endian.h"
#include "tests/scenario/world.h"

enum { A, B, NODES };
enum { NODE_A = 5, NODE_B = 6, STEP_US = 1000 };
static const uint32_t SERIAL_A = 1001, SERIAL_B = 0xFFFF0002;

struct net {
	struct world node[NODES];
	size_t forwarded[NODES];
	bool off; /* node B */
	struct cia309 gateway;
	struct cia309_session *client;
	char answer[300000];
	size_t answered;
	uint64_t due_us; /* what the gateway returned last */
};

/* ---- the bus, and time ------------------------------------------------------------------------------------------- */

static bool forward_one(struct net *t, int from)
{
	struct world *sender = &t->node[from], *other = &t->node[!from];
	struct can_msg msg;

	if (t->forwarded[from] == sender->frame_count)
		return false;
	msg = sender->frames[t->forwarded[from]++ % WORLD_FRAMES];
	if (from == A && t->off)
		return true;
	world_receive(other, msg.id, msg.len, msg.data);
	if (from == B)
		cia309_receive(&t->gateway, &msg, other->now_us);
	return true;
}

/* Until nothing is due at this moment. */
static void settle(struct net *t)
{
	do {
		device_tick(&t->node[A].device, t->node[A].now_us);
		t->due_us = cia309_tick(&t->gateway, t->node[A].now_us);
	} while (forward_one(t, A) || forward_one(t, B) || t->due_us <= t->node[A].now_us);
}

/* To the next deadline, at most a step. */
static void step(struct net *t)
{
	t->node[A].now_us += STEP_US;
	t->node[B].now_us = t->node[A].now_us;
	device_tick(&t->node[B].device, t->node[B].now_us);
	settle(t);
}

static void run_ms(struct net *t, unsigned ms)
{
	while (ms-- > 0)
		step(t);
}

static void take_output(struct net *t, struct cia309_session *s)
{
	size_t n;
	const char *text = cia309_output(s, &n);

	assert_true(t->answered + n < sizeof(t->answer));
	memcpy(t->answer + t->answered, text, n);
	t->answered += n;
	t->answer[t->answered] = '\0';
	cia309_sent(s, n);
}

static void type(struct cia309_session *s, const char *line)
{
	assert_in_range(strlen(line), 1, cia309_room(s));
	cia309_input(s, line, strlen(line));
}

/* The answer without its line end, within 60 s. */
static const char *await(struct net *t, struct cia309_session *s)
{
	t->answered = 0;
	for (int i = 0; i < 60000; i++) {
		settle(t);
		take_output(t, s);
		if (t->answered >= 2 && memcmp(t->answer + t->answered - 2, "\r\n", 2) == 0) {
			t->answer[t->answered - 2] = '\0';
			return t->answer;
		}
		step(t);
	}
	fail_msg("no answer");
	return "";
}

static const char *ask(struct net *t, const char *line)
{
	char text[256];

	snprintf(text, sizeof(text), "%s\n", line);
	type(t->client, text);
	return await(t, t->client);
}

#define assert_answer(t, line, expected) assert_string_equal(ask(t, line), expected)

static void init(struct net *t, uint8_t node_a, uint8_t node_b)
{
	world_init(&t->node[A], sensor_preset("ideal"), 1, "rest");
	world_init(&t->node[B], sensor_preset("ideal"), 2, "rest");
	t->node[A].node_id = node_a;
	t->node[A].serial = SERIAL_A;
	t->node[B].node_id = node_b;
	t->node[B].serial = SERIAL_B;
	for (int i = 0; i < NODES; i++)
		world_power_on(&t->node[i], NULL);
	ascii_gateway_init(&t->gateway, &t->node[A].device, &t->node[A].bus);
	t->client = cia309_open(&t->gateway, "uid 1000", true);
	assert_non_null(t->client);
	run_ms(t, 20);
}

static int set_up(void **state)
{
	struct net *t = calloc(1, sizeof(*t));

	assert_non_null(t);
	init(t, NODE_A, NODE_B);
	*state = t;
	return 0;
}

static int set_up_unconfigured(void **state)
{
	struct net *t = calloc(1, sizeof(*t));

	assert_non_null(t);
	init(t, CANOPEN_UNCONFIGURED, CANOPEN_UNCONFIGURED);
	*state = t;
	return 0;
}

static enum nmt_state state_of(const struct net *t, int node)
{
	return canopen_nmt_state(&t->node[node].device.canopen);
}

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static void test_this_node_is_answered_without_a_frame(void **state)
{
	struct net *t = *state;
	size_t frames = t->node[A].frame_count;

	assert_answer(t, "[1] 5 read 0x1017 0 u16", "[1] 1000");
	assert_answer(t, "[2] 5 r 0x1018 4", "[2] E9 03 00 00");
	assert_answer(t, "[3] 5 r 0x1018 4 x32", "[3] 0x000003E9");
	assert_answer(t, "[4] 5 r 0x1008 0 vs", "[4] \"IMU9 CANopen gateway\"");
	assert_answer(t, "[5] 5 w 0x2000 1 r32 0.05", "[5] OK");
	assert_answer(t, "[6] 5 r 0x2000 1 r32", "[6] 0.05");
	assert_answer(t, "[4294967295] 5 r 0x1017 0 u16", "[4294967295] 1000");
	assert_true(t->node[A].device.values.lever_arm.l == 0.05f);
	assert_int_equal(t->node[A].frame_count, frames);
}

static void test_another_node_is_read_and_written_by_sdo(void **state)
{
	struct net *t = *state;

	assert_answer(t, "[1] 6 read 0x1018 4 u32", "[1] 4294901762");
	assert_answer(t, "[2] 6 r 0x1008 0 vs", "[2] \"IMU9 CANopen gateway\"");
	assert_answer(t, "[3] 1 6 w 0x2000 1 r32 -0.25", "[3] OK");
	assert_true(t->node[B].device.values.lever_arm.l == -0.25f);
	assert_true(t->node[A].device.values.lever_arm.l == 0);
	assert_int_not_equal(world_count(&t->node[A], 0x606), 0);
}

/* Of both nodes the same: the client cannot tell which way its request went. */
static void test_refusals_have_the_abort_codes_of_sdo(void **state)
{
	static const struct {
		const char *request, *code;
	} REFUSED[] = {
		{"r 0x5FFF 0", "0x06020000"},
		{"r 0x2000 9", "0x06090011"},
		{"w 0x1000 0 u32 1", "0x06010002"},
		{"w 0x2000 1 r32 1e9", "0x06090031"},
		{"w 0x2000 1 u16 1", "0x06070013"},
		{"w 0x1010 1 vs load", "0x08000020"},
		{"r 0x1003 1 u32", "0x08000024"},
	};
	struct net *t = *state;

	for (size_t i = 0; i < sizeof(REFUSED) / sizeof(REFUSED[0]); i++)
		for (int node = NODE_A; node <= NODE_B; node++) {
			char line[64], expected[64];

			snprintf(line, sizeof(line), "[9] %d %s", node, REFUSED[i].request);
			snprintf(expected, sizeof(expected), "[9] ERROR:%s #", REFUSED[i].code);
			assert_memory_equal(ask(t, line), expected, strlen(expected));
		}
}

static void test_a_node_that_is_not_there_times_out_as_set(void **state)
{
	struct net *t = *state;
	uint64_t start_us = t->node[A].now_us;

	assert_answer(t, "[1] 7 r 0x1000 0 u32", "[1] ERROR:0x05040000 #the SDO transfer timed out");
	assert_in_range(t->node[A].now_us - start_us, 500000, 505000);
	assert_answer(t, "[2] set sdo_timeout 100", "[2] OK");
	start_us = t->node[A].now_us;
	assert_answer(t, "[3] 7 r 0x1000 0 u32", "[3] ERROR:0x05040000 #the SDO transfer timed out");
	assert_in_range(t->node[A].now_us - start_us, 100000, 105000);
}

static const char *base64_value(const char *answer)
{
	assert_memory_equal(answer, "[1] ", 4);
	return answer + 4;
}

/* The EDS of 150 kB: longer than the output buffer of a client, and on the bus with and without blocks. */
static void test_a_long_domain_is_read_completely_from_either_node(void **state)
{
	static const char *const READ[] = {"[1] 5 r 0x1021 0 d", "[1] 6 r 0x1021 0 d"};
	static uint8_t bytes[200000];
	struct net *t = *state;

	uint64_t start_us = t->node[A].now_us;
	ask(t, "[1] 5 r 0x1021 0 d"); /* 4 kB in a millisecond */
	assert_true(((t->node[A].now_us - start_us) / STEP_US + 1) * CIA309_OUT_MAX >= imu9_eds_size * 4 / 3);
	for (int block = 0; block <= 1; block++) {
		ask(t, block ? "[1] set sdo_block 1" : "[1] set sdo_block 0");
		for (int i = 0; i < NODES; i++) {
			const char *text = base64_value(ask(t, READ[i]));
			long n = cia309_scan(cia309_type("d"), text, strlen(text), bytes, sizeof(bytes));

			assert_int_equal(n, imu9_eds_size);
			assert_memory_equal(bytes, imu9_eds, imu9_eds_size);
		}
	}
}

static void test_storing_is_answered_when_the_storage_has_ended(void **state)
{
	struct net *t = *state;

	t->node[A].disk_answer = -EINPROGRESS;
	type(t->client, "[1] 5 w 0x1010 1 vs save\n[2] 5 r 0x1017 0 u16\n");
	run_ms(t, 300);
	size_t n;
	cia309_output(t->client, &n);
	assert_int_equal(n, 0);
	device_saved(&t->node[A].device, 0, t->node[A].now_us);
	assert_string_equal(await(t, t->client), "[1] OK");
	assert_string_equal(await(t, t->client), "[2] 1000");
	type(t->client, "[3] 5 w 0x1010 1 vs save\n");
	run_ms(t, 5);
	device_saved(&t->node[A].device, -EIO, t->node[A].now_us);
	assert_memory_equal(await(t, t->client), "[3] ERROR:0x08000020", 20);
}

static void test_the_defaults_are_those_of_all_clients_with_the_same_rights(void **state)
{
	struct net *t = *state;
	struct cia309_session *writer = cia309_open(&t->gateway, "uid 1001", true);
	struct cia309_session *reader = cia309_open(&t->gateway, "uid 1002", false);

	assert_answer(t, "[1] r 0x1018 4 u32", "[1] ERROR:105 #No default node set.");
	assert_answer(t, "[2] set node 5", "[2] OK");
	assert_answer(t, "[3] set network 1", "[3] OK");
	assert_answer(t, "[4] r 0x1018 4 u32", "[4] 1001");
	type(writer, "[5] r 0x1018 4 u32\n");
	assert_string_equal(await(t, writer), "[5] 1001");
	assert_answer(t, "[6] 0 r 0x1018 4 u32", "[6] ERROR:107 #Unsupported node.");
	assert_answer(t, "[7] set network 2", "[7] ERROR:106 #Unsupported net.");
	/* who only reads cannot turn the commands of others to another node */
	type(reader, "[8] set node 6\n");
	assert_string_equal(await(t, reader), "[8] OK");
	type(reader, "[9] r 0x1018 4 x32\n");
	assert_string_equal(await(t, reader), "[9] 0xFFFF0002");
	assert_answer(t, "[10] r 0x1018 4 u32", "[10] 1001");
}

static void test_nothing_is_sent_while_the_bit_rate_is_switched(void **state)
{
	struct net *t = *state;
	struct cia309_session *second = cia309_open(&t->gateway, "2", true);

	type(second, "[1] 7 r 0x1000 0\n"); /* nobody: an abort follows after 500 ms */
	run_ms(t, 5);
	t->node[A].device.canopen.lss.bit_s = 500000;
	world_receive(&t->node[A], 0x7E5, 8, (const uint8_t[8]){0x04, 1});
	world_receive(&t->node[A], 0x7E5, 8, (const uint8_t[8]){0x15, 0xE8, 0x03}); /* 1 s */
	size_t frames = t->node[A].frame_count;
	type(t->client, "[2] 6 start\n");
	run_ms(t, 1990);
	assert_int_equal(t->node[A].frame_count, frames);
	assert_string_equal(await(t, t->client), "[2] OK");
	assert_memory_equal(await(t, second), "[1] ERROR:0x05040000", 20);
}

/* ---- NMT --------------------------------------------------------------------------------------------------------- */

static void test_nmt_commands_reach_the_node_that_they_name(void **state)
{
	struct net *t = *state;

	assert_answer(t, "[1] 6 start", "[1] OK");
	assert_int_equal(state_of(t, B), NMT_OPERATIONAL);
	assert_int_equal(state_of(t, A), NMT_PRE_OPERATIONAL);
	assert_answer(t, "[2] 5 start", "[2] OK");
	assert_int_equal(state_of(t, A), NMT_OPERATIONAL);
	assert_answer(t, "[3] 0 stop", "[3] OK");
	assert_int_equal(state_of(t, A), NMT_STOPPED);
	assert_int_equal(state_of(t, B), NMT_STOPPED);
	assert_answer(t, "[4] 6 r 0x1017 0", "[4] ERROR:204 #Wrong NMT state.");
	assert_answer(t, "[5] 5 r 0x1017 0 u16", "[5] 1000"); /* the dictionary is there in any state */
	assert_answer(t, "[6] 0 preop", "[6] OK");
	assert_int_equal(state_of(t, A), NMT_PRE_OPERATIONAL);
	assert_int_equal(state_of(t, B), NMT_PRE_OPERATIONAL);
	assert_int_equal(world_count(&t->node[A], 0x000), 3);
}

static void test_commands_behind_a_reset_of_this_node_wait_for_its_boot_up(void **state)
{
	struct net *t = *state;

	type(t->client, "[1] 5 w 0x2000 1 r32 0.5\n[2] 5 reset node\n[3] 5 start\n[4] 5 r 0x2000 1 r32\n");
	assert_string_equal(await(t, t->client), "[1] OK");
	assert_string_equal(await(t, t->client), "[2] OK");
	assert_string_equal(await(t, t->client), "[3] OK");
	assert_int_equal(state_of(t, A), NMT_OPERATIONAL);
	assert_string_equal(await(t, t->client), "[4] 0");
	assert_int_equal(world_count(&t->node[A], 0x705), 2); /* boot-up at the start, and after the reset */
	assert_answer(t, "[5] 6 reset communication", "[5] OK");
	run_ms(t, 20);
	assert_int_equal(world_count(&t->node[B], 0x706), 2);
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

static void test_a_node_is_selected_and_configured_by_its_lss_address(void **state)
{
	struct net *t = *state;
	char select[96], identity[96];
	const uint32_t revision = t->node[B].device.values.identity.revision_number;

	snprintf(select, sizeof(select), "[1] lss_switch_sel 0x494D55 0x%X 0x%X 0x%X",
		t->node[B].device.values.identity.product_code, revision, SERIAL_B);
	snprintf(identity, sizeof(identity), "[2] 0x00494D55 0x%08X 0x%08X 0x%08X",
		t->node[B].device.values.identity.product_code, revision, SERIAL_B);
	assert_answer(t, select, "[1] OK");
	assert_answer(t, "[2] lss_inquire_addr", identity);
	assert_answer(t, "[3] lss_inquire_addr 3", "[3] 0xFFFF0002");
	assert_answer(t, "[4] lss_get_node", "[4] 0x06");
	assert_answer(t, "[5] lss_set_node 0", "[5] ERROR:502 #LSS node-ID not supported.");
	assert_answer(t, "[6] lss_set_node 0x22", "[6] OK");
	assert_answer(t, "[7] lss_store", "[7] OK");
	assert_int_equal(t->node[B].disk.lss.node_id, 0x22);
	assert_answer(
		t, "[8] lss_conf_bitrate 0 0", "[8] ERROR:503 #LSS bit-rate not supported."); /* no bit rate here */
	assert_answer(t, "[9] lss_switch_glob 0", "[9] OK");
	assert_answer(t, "[10] lss_get_node", "[10] ERROR:103 #Time-out.");
	assert_answer(t, "[11] 6 reset comm", "[11] OK");
	run_ms(t, 20);
	assert_int_equal(world_count(&t->node[B], 0x722), 1);
	assert_answer(t, "[12] 0x22 r 0x1018 4 x32", "[12] 0xFFFF0002");
}

static void test_this_node_takes_part_in_lss(void **state)
{
	struct net *t = *state;
	char identity[96];

	t->off = true;
	assert_answer(t, "[1] lss_switch_glob 1", "[1] OK");
	assert_answer(t, "[2] lss_inquire_addr 3", "[2] 0x000003E9");
	assert_answer(t, "[3] lss_get_node", "[3] 0x05");
	snprintf(identity, sizeof(identity), "[4] 0x00494D55 0x%08X 0x%08X 0x%08X",
		t->node[A].device.values.identity.product_code, t->node[A].device.values.identity.revision_number,
		SERIAL_A);
	assert_answer(t, "[4] lss_inquire_addr", identity);
	assert_answer(t, "[5] lss_switch_glob 0", "[5] OK");
}

static void test_a_storage_that_fails_is_the_error_of_lss_store(void **state)
{
	struct net *t = *state;

	t->off = true;
	t->node[A].disk_answer = -EIO;
	assert_answer(t, "[1] lss_switch_glob 1", "[1] OK");
	assert_answer(t, "[2] lss_store", "[2] ERROR:504 #LSS parameter storing failed.");
}

static void test_all_nodes_get_their_node_ids_one_after_the_other(void **state)
{
	struct net *t = *state;
	const uint32_t product = t->node[A].device.values.identity.product_code;
	const uint32_t revision = t->node[A].device.values.identity.revision_number;
	char expected[400];

	snprintf(expected, sizeof(expected),
		"# Node-ID 32 assigned to: 0x00494D55 0x%08X 0x%08X 0x%08X\n"
		"# Node-ID 33 assigned to: 0x00494D55 0x%08X 0x%08X 0x%08X\n"
		"# Found 2 nodes, search finished.\n[1] OK",
		product, revision, SERIAL_A, product, revision, SERIAL_B);
	assert_answer(t, "[1] lss_allnodes 20 32 1", expected);
	run_ms(t, 20);
	assert_int_equal(t->node[A].disk.lss.node_id, 32);
	assert_int_equal(t->node[B].disk.lss.node_id, 33);
	assert_answer(t, "[2] 32 r 0x1018 4 u32", "[2] 1001");
	assert_answer(t, "[3] 33 r 0x1018 4 x32", "[3] 0xFFFF0002");
	assert_answer(t, "[4] lss_allnodes 20", "# Found 0 nodes, search finished.\n[4] OK");
}

static void test_fastscan_finds_the_node_with_the_serial_number_given(void **state)
{
	struct net *t = *state;
	char expected[96];

	snprintf(expected, sizeof(expected), "[1] 0x00494D55 0x%08X 0x%08X 0x%08X",
		t->node[A].device.values.identity.product_code, t->node[A].device.values.identity.revision_number,
		SERIAL_A);
	assert_answer(t, "[1] _lss_fastscan 20", expected); /* of both the one whose first differing bit is 0 */
	assert_answer(t, "[2] lss_switch_glob 0", "[2] OK");
	assert_answer(t, "[3] lss_allnodes 20 50 0 0 0 0 0 0 0 2 7",
		"[3] ERROR:102 #Request not processed due to "
		"internal state.");
	assert_answer(t, "[4] 5 r 0x1017 0", "[4] ERROR:102 #Request not processed due to internal state.");
}

static void test_nobody_answers_where_all_nodes_have_a_node_id(void **state)
{
	assert_answer(*state, "[1] _lss_fastscan 20", "[1] ERROR:103 #Time-out.");
}

/* ---- PDOs -------------------------------------------------------------------------------------------------------- */

static void test_the_values_of_a_tpdo_are_those_that_it_would_send(void **state)
{
	struct net *t = *state;
	struct world *w = &t->node[A];
	char expected[96];

	world_samples(w, 100);
	t->node[B].now_us = w->now_us;
	assert_answer(t, "[1] 5 start", "[1] OK");
	world_receive(w, 0x080, 0, NULL);
	const uint8_t *d = world_last(w, 0x185)->data;
	snprintf(expected, sizeof(expected), "[2] 1 pdo 4 0x%04X 0x%04X 0x%04X 0x%04X", get_u16(d), get_u16(d + 2),
		get_u16(d + 4), get_u16(d + 6));
	assert_answer(t, "[2] 5 r p 1", expected);
	assert_answer(t, "[3] r p 9", "[3] ERROR:102 #Request not processed due to internal state.");
	assert_answer(t, "[4] 6 r p 1", "[4] ERROR:107 #Unsupported node.");
}

static void test_a_pdo_that_is_written_is_received_by_this_node(void **state)
{
	struct net *t = *state;

	assert_answer(t, "[1] 5 w p 2 2 0x3FC00000 0x3F000000", "[1] ERROR:204 #Wrong NMT state.");
	assert_answer(t, "[2] 5 start", "[2] OK");
	/* RPDO2: yaw and its sigma, REAL32, type 255 */
	assert_answer(t, "[3] 5 w p 2 2 0x42B40000 0x3F800000", "[3] OK");
	assert_true(t->node[A].device.values.yaw_aid.yaw == 90);
	assert_answer(t, "[4] 5 w p 2 1 0", "[4] ERROR:401 #PDO length exceeded.");
	assert_answer(t, "[5] 5 w p 2 2 0x100000000 0", "[5] ERROR:101 #Syntax error.");
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

static void test_a_client_that_may_not_write_changes_nothing(void **state)
{
	static const char *const LINES[] = {"5 w 0x2000 1 r32 0.5", "6 w 0x2000 1 r32 0.5", "6 start", "5 start",
		"0 reset node", "lss_switch_glob 1", "lss_get_node", "_lss_fastscan", "lss_allnodes", "5 w p 2 2 0 0"};
	struct net *t = *state;

	t->client = cia309_open(&t->gateway, "uid 1001", false);
	size_t frames = t->node[A].frame_count;
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++) {
		char line[64];

		snprintf(line, sizeof(line), "[1] %s", LINES[i]);
		assert_memory_equal(ask(t, line), "[1] ERROR:102 #Not permitted", 28);
	}
	assert_int_equal(t->node[A].frame_count, frames);
	assert_int_equal(state_of(t, B), NMT_PRE_OPERATIONAL);
	assert_true(t->node[A].device.values.lever_arm.l == 0);
	assert_answer(t, "[2] 6 r 0x1018 4 x32", "[2] 0xFFFF0002");
}

static void test_the_event_log_tells_who_changed_what_and_who_was_refused(void **state)
{
	struct net *t = *state;
	struct cia309_session *reader = cia309_open(&t->gateway, "127.0.0.1:9", false);

	ask(t, "[1] 5 w 0x2000 1 r32 0.5 # \033[31m");
	type(reader, "[2] 6 start\n");
	await(t, reader);
	ask(t, "[3] 5 r 0x2000 1 r32");
	const char *log = ask(t, "[4] log");
	assert_non_null(strstr(log, "CiA 309, uid 1000: [1] 5 w 0x2000 1 r32 0.5 #  [31m: OK\n"));
	assert_non_null(strstr(log, "CiA 309, 127.0.0.1:9: [2] 6 start: ERROR:102 #Not permitted"));
	assert_null(strstr(log, "[3]"));
}

static void test_clients_take_turns_and_one_that_waits_for_the_bus_delays_no_other(void **state)
{
	struct net *t = *state;
	struct cia309_session *second = cia309_open(&t->gateway, "2", true),
			      *third = cia309_open(&t->gateway, "3", true);

	type(t->client, "[1] 7 r 0x1000 0\n"); /* nobody there: half a second */
	type(second, "[2] 6 r 0x1017 0 u16\n");
	type(third, "[3] 5 r 0x1017 0 u16\n");
	uint64_t start_us = t->node[A].now_us;
	assert_string_equal(await(t, third), "[3] 1000");
	assert_in_range(t->node[A].now_us - start_us, 0, 5000);
	assert_string_equal(await(t, second), "[2] 1000");
	assert_in_range(t->node[A].now_us - start_us, 500000, 510000);
}

static void test_what_a_client_waits_for_ends_with_it(void **state)
{
	struct net *t = *state;
	struct cia309_session *second = cia309_open(&t->gateway, "2", true);

	type(t->client, "[1] 7 r 0x1000 0\n");
	run_ms(t, 5);
	cia309_close(&t->gateway, t->client);
	type(second, "[2] 6 r 0x1017 0 u16\n");
	uint64_t start_us = t->node[A].now_us;
	assert_string_equal(await(t, second), "[2] 1000");
	assert_in_range(t->node[A].now_us - start_us, 0, 5000);
	type(second, "[3] lss_allnodes\n");
	run_ms(t, 5);
	cia309_close(&t->gateway, second);
	t->client = cia309_open(&t->gateway, "4", true);
	assert_answer(t, "[4] 6 r 0x1017 0 u16", "[4] 1000");
	t->node[A].disk_answer = -EINPROGRESS;
	type(t->client, "[5] 5 w 0x1010 1 vs save\n");
	run_ms(t, 5);
	cia309_close(&t->gateway, t->client);
	device_saved(&t->node[A].device, 0, t->node[A].now_us);
	run_ms(t, 5);
}

static void test_at_most_a_thousand_commands_run_in_a_second(void **state)
{
	struct net *t = *state;
	unsigned lines = 0;

	for (int i = 0; i < 1000; i++) {
		if (cia309_room(t->client))
			type(t->client, "\n#\n\n#\n\n#\n\n#\n\n#\n\n#\n\n#\n\n#\n");
		step(t);
		t->answered = 0;
		take_output(t, t->client);
		lines += (unsigned)t->answered / 2;
	}
	assert_in_range(lines, 990, 1001);
}

static void test_a_line_that_is_too_long_is_the_last_of_its_client(void **state)
{
	static char line[CIA309_LINE_MAX];
	struct net *t = *state;

	memset(line, 'A', sizeof(line));
	memcpy(line, "[77] 5 w 0x1F22 1 d ", 20);
	cia309_input(t->client, line, sizeof(line) / 2);
	assert_false(cia309_closing(t->client));
	cia309_input(t->client, line + sizeof(line) / 2, cia309_room(t->client));
	assert_true(cia309_closing(t->client));
	assert_int_equal(cia309_room(t->client), 0);
	assert_string_equal(await(t, t->client), "[77] ERROR:600 #The line is too long.");
}

static void test_there_are_as_many_clients_as_places(void **state)
{
	struct net *t = *state;
	struct cia309_session *last = NULL;

	for (int i = 1; i < CIA309_SESSIONS; i++)
		assert_non_null(last = cia309_open(&t->gateway, "more", false));
	assert_null(cia309_open(&t->gateway, "too many", false));
	cia309_close(&t->gateway, last);
	assert_non_null(cia309_open(&t->gateway, "again", false));
}

static void test_comments_help_and_version_are_answered(void **state)
{
	struct net *t = *state;

	assert_answer(t, "# a comment", "");
	assert_answer(t, "", "");
	assert_non_null(strstr(ask(t, "[1] help"), "r[ead] INDEX SUB"));
	assert_non_null(strstr(ask(t, "[1] help lss"), "lss_switch_sel"));
	assert_non_null(strstr(ask(t, "[1] help datatype"), "r32"));
	assert_memory_equal(ask(t, "[1] info version"), "[1] 4803925 ", 12); /* 494D55h */
	assert_answer(t, "[1] init 3", "[1] ERROR:100 #Request not supported.");
}

/* ---- many clients for a long time -------------------------------------------------------------------------------- */

/* What a client waits for. */
struct pending {
	struct cia309_session *session;
	uint32_t sequence;
	bool waits;
	float *written; /* the value that is `value` after OK; NULL: not a write */
	float value;
};

static uint64_t random_state;

static unsigned random_below(unsigned n)
{
	random_state = random_state * 6364136223846793005u + 1442695040888963407u;
	return (unsigned)(random_state >> 33) % n;
}

static void send_random(struct pending *p, float model[NODES][3])
{
	static const char *const OTHERS[] = {"5 r 0x1017 0 u16", "6 r 0x1018 4", "9 r 0x1000 0", "6 start", "6 stop",
		"6 preop", "5 start", "5 preop", "0 preop", "6 reset comm", "5 reset comm", "lss_get_node", "r p 1",
		"lss_switch_glob 0", "_lss_fastscan 5", "set sdo_timeout 50", "set sdo_block 0", "set sdo_block 1",
		"5 r 0x1021 0 d", "6 r 0x2131 0 vs", "help", "bogus", "6 w 0x1000 0 u32 1", "5 w 0x1010 1 vs save"};
	char line[96];

	p->sequence++;
	p->waits = true;
	p->written = NULL;
	if (random_below(3) > 0) {
		snprintf(line, sizeof(line), "[%u] %s\n", p->sequence,
			OTHERS[random_below(sizeof(OTHERS) / sizeof(OTHERS[0]))]);
	} else {
		unsigned node = random_below(NODES), axis = random_below(3);

		p->value = (float)random_below(2000) / 1000;
		p->written = &model[node][axis];
		snprintf(line, sizeof(line), "[%u] %u w 0x2000 %u r32 %.3f\n", p->sequence, node + NODE_A, axis + 1,
			(double)p->value);
	}
	type(p->session, line);
}

static void take_answer(struct net *t, struct pending *p)
{
	char head[16];
	const char *end;

	t->answered = 0;
	take_output(t, p->session);
	if (t->answered < 2 || memcmp(t->answer + t->answered - 2, "\r\n", 2) != 0)
		return; /* nothing, or a piece of a long one */
	snprintf(head, sizeof(head), "[%u] ", p->sequence);
	end = t->answer;
	if (p->written && strcmp(end + strlen(head), "OK\r\n") == 0)
		*p->written = p->value;
	if (t->answer[0] == '[' && p->written)
		assert_memory_equal(t->answer, head, strlen(head));
	p->waits = false;
}

static void test_after_half_an_hour_of_many_clients_the_values_are_those_that_were_acknowledged(void **state)
{
	static struct pending pending[CIA309_SESSIONS];
	struct net *t = *state;
	float model[NODES][3] = {{0}};
	unsigned answers = 0;

	random_state = 1;
	memset(pending, 0, sizeof(pending));
	cia309_close(&t->gateway, t->client);
	while (t->node[A].now_us < 1800000000) {
		struct pending *p = &pending[random_below(CIA309_SESSIONS)];

		if (!p->session)
			p->session = cia309_open(&t->gateway, "many", true);
		else if (!p->waits)
			send_random(p, model);
		else if (!p->written && random_below(20) == 0) /* it leaves while it waits */
			cia309_close(&t->gateway, p->session), p->session = NULL, p->waits = false;
		for (unsigned ms = random_below(200); ms > 0; ms--) {
			step(t);
			for (p = pending; p < pending + CIA309_SESSIONS; p++)
				if (p->waits) {
					take_answer(t, p);
					answers += !p->waits;
				}
		}
	}
	for (struct pending *p = pending; p < pending + CIA309_SESSIONS; p++)
		for (int ms = 0; ms < 60000 && p->waits; ms++) {
			step(t);
			for (struct pending *q = pending; q < pending + CIA309_SESSIONS; q++)
				if (q->waits)
					take_answer(t, q);
		}
	assert_true(answers > 5000);
	for (struct pending *p = pending; p < pending + CIA309_SESSIONS; p++) {
		assert_false(p->waits);
		if (p->session)
			cia309_close(&t->gateway, p->session);
	}
	for (int i = 0; i < NODES; i++) {
		assert_true(t->node[i].device.values.lever_arm.l == model[i][0]);
		assert_true(t->node[i].device.values.lever_arm.s == model[i][1]);
		assert_true(t->node[i].device.values.lever_arm.t == model[i][2]);
	}
}

int main(void)
{
#define TEST(test)	   cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)
#define UNCONFIGURED(test) cmocka_unit_test_setup_teardown(test, set_up_unconfigured, world_tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_this_node_is_answered_without_a_frame),
		TEST(test_another_node_is_read_and_written_by_sdo),
		TEST(test_refusals_have_the_abort_codes_of_sdo),
		TEST(test_a_node_that_is_not_there_times_out_as_set),
		TEST(test_a_long_domain_is_read_completely_from_either_node),
		TEST(test_storing_is_answered_when_the_storage_has_ended),
		TEST(test_the_defaults_are_those_of_all_clients_with_the_same_rights),
		TEST(test_nothing_is_sent_while_the_bit_rate_is_switched),
		TEST(test_nmt_commands_reach_the_node_that_they_name),
		TEST(test_commands_behind_a_reset_of_this_node_wait_for_its_boot_up),
		TEST(test_a_node_is_selected_and_configured_by_its_lss_address),
		TEST(test_this_node_takes_part_in_lss),
		TEST(test_a_storage_that_fails_is_the_error_of_lss_store),
		UNCONFIGURED(test_all_nodes_get_their_node_ids_one_after_the_other),
		UNCONFIGURED(test_fastscan_finds_the_node_with_the_serial_number_given),
		TEST(test_nobody_answers_where_all_nodes_have_a_node_id),
		TEST(test_the_values_of_a_tpdo_are_those_that_it_would_send),
		TEST(test_a_pdo_that_is_written_is_received_by_this_node),
		TEST(test_a_client_that_may_not_write_changes_nothing),
		TEST(test_the_event_log_tells_who_changed_what_and_who_was_refused),
		TEST(test_clients_take_turns_and_one_that_waits_for_the_bus_delays_no_other),
		TEST(test_what_a_client_waits_for_ends_with_it),
		TEST(test_at_most_a_thousand_commands_run_in_a_second),
		TEST(test_a_line_that_is_too_long_is_the_last_of_its_client),
		TEST(test_there_are_as_many_clients_as_places),
		TEST(test_comments_help_and_version_are_answered),
		TEST(test_after_half_an_hour_of_many_clients_the_values_are_those_that_were_acknowledged),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

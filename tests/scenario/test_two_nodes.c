/* Two whole devices in one process, on one bus: node 5 stands still, node 6 is on a turntable. Each receives every
 * frame that the other or the master sends. */
#include <stdlib.h>
#include <string.h>

#include "od/little_endian.h"
#include "tests/scenario/world.h"

enum { A, B, NODES };
enum { NODE_A = 5, NODE_B = 6 };
enum { NMT_COMMAND_START = 1, NMT_COMMAND_STOP = 2, LSS_REQUEST = 0x7E5, LSS_RESPONSE = 0x7E4 };
static const uint32_t SERIAL_A = 1001, SERIAL_B = 0xFFFF0002;
static const uint32_t INTERVAL_MS = 10; /* between two samples: both sensors have 100 Hz */

struct pair {
	struct world node[NODES];
	size_t forwarded[NODES]; /* frames of this node that the other has received */
	bool off[NODES];
};

/* ---- the bus between them ---------------------------------------------------------------------------------------- */

static bool forward_one(struct pair *p, int from)
{
	struct world *sender = &p->node[from];
	struct can_msg msg;

	if (p->forwarded[from] == sender->frame_count)
		return false;
	msg = sender->frames[p->forwarded[from]++ % WORLD_FRAMES];
	if (!p->off[!from])
		world_receive(&p->node[!from], msg.id, msg.len, msg.data);
	return true;
}

static void exchange(struct pair *p)
{
	while (forward_one(p, A) || forward_one(p, B))
		;
}

/* The master sends a frame. */
static void send(struct pair *p, uint32_t id, size_t len, const uint8_t *data)
{
	for (int i = 0; i < NODES; i++)
		if (!p->off[i])
			world_receive(&p->node[i], id, len, data);
	exchange(p);
}

static void send_nmt(struct pair *p, uint8_t command, uint8_t node_id)
{
	send(p, 0x000, 2, (const uint8_t[]){command, node_id});
}

static void send_sync(struct pair *p)
{
	send(p, 0x080, 0, NULL);
}

static void run_ms(struct pair *p, uint32_t ms)
{
	for (uint32_t t = 0; t < ms; t += INTERVAL_MS) {
		for (int i = 0; i < NODES; i++)
			if (!p->off[i])
				world_sample(&p->node[i]);
		exchange(p);
	}
}

static void init(struct pair *p, uint8_t node_a, uint8_t node_b)
{
	world_init(&p->node[A], sensor_preset("ideal"), 1, "rest");
	world_init(&p->node[B], sensor_preset("ideal"), 2, "turntable");
	p->node[A].node_id = node_a;
	p->node[A].serial = SERIAL_A;
	p->node[B].node_id = node_b;
	p->node[B].serial = SERIAL_B;
	for (int i = 0; i < NODES; i++)
		world_power_on(&p->node[i], NULL);
	exchange(p);
}

static int set_up(void **state)
{
	struct pair *p = calloc(1, sizeof(*p));

	assert_non_null(p);
	init(p, NODE_A, NODE_B);
	*state = p;
	return 0;
}

/* ---- SDO, SYNC, NMT ---------------------------------------------------------------------------------------------- */

static void test_each_node_answers_its_own_sdo_and_keeps_its_own_values(void **state)
{
	static const uint8_t write[] = {0x23, 0x00, 0x20, 0x01, 0xCD, 0xCC, 0x4C, 0x3D}; /* 2000h:1 = 0.05 */
	struct pair *p = *state;

	send(p, 0x600 + NODE_B, 8, write);
	assert_int_equal(world_count(&p->node[B], 0x580 + NODE_B), 1);
	assert_int_equal(world_last(&p->node[B], 0x580 + NODE_B)->data[0], 0x60);
	assert_int_equal(world_count(&p->node[A], 0x580 + NODE_A), 0);
	assert_true(p->node[B].device.values.lever_arm.l == 0.05f);
	assert_true(p->node[A].device.values.lever_arm.l == 0);
}

static void test_one_sync_makes_both_nodes_send_the_pdos_of_their_own_sensors(void **state)
{
	struct pair *p = *state;

	send_nmt(p, NMT_COMMAND_START, 0);
	run_ms(p, 3000);
	send_sync(p);
	for (uint32_t tpdo = 0x180; tpdo <= 0x480; tpdo += 0x100) {
		assert_int_equal(world_count(&p->node[A], tpdo + NODE_A), 1);
		assert_int_equal(world_count(&p->node[B], tpdo + NODE_B), 1);
	}
	assert_true(p->node[A].device.values.sample.status & PIPELINE_REST);
	assert_false(p->node[B].device.values.sample.status & PIPELINE_REST);
	assert_int_equal(
		get_u16(world_last(&p->node[A], 0x480 + NODE_A)->data), p->node[A].device.values.sample.status);
	assert_int_equal(
		get_u16(world_last(&p->node[B], 0x480 + NODE_B)->data), p->node[B].device.values.sample.status);
}

static void test_a_node_computes_the_same_beside_another_one_as_alone(void **state)
{
	struct pair *p = *state, *alone = calloc(1, sizeof(*alone));

	assert_non_null(alone);
	init(alone, NODE_A, NODE_B);
	alone->off[A] = true;
	send_nmt(p, NMT_COMMAND_START, 0);
	send_nmt(alone, NMT_COMMAND_START, 0);
	for (int i = 0; i < 500; i++) {
		run_ms(p, INTERVAL_MS);
		run_ms(alone, INTERVAL_MS);
		send_sync(p);
		send_sync(alone);
		for (uint32_t tpdo = 0x180; tpdo <= 0x480; tpdo += 0x100)
			assert_memory_equal(world_last(&p->node[B], tpdo + NODE_B)->data,
				world_last(&alone->node[B], tpdo + NODE_B)->data, 8);
	}
	free(alone);
}

static void test_a_node_that_is_stopped_leaves_the_other_operational(void **state)
{
	static const uint8_t read_device_type[] = {0x40, 0x00, 0x10, 0, 0, 0, 0, 0};
	struct pair *p = *state;

	send_nmt(p, NMT_COMMAND_START, 0);
	send_nmt(p, NMT_COMMAND_STOP, NODE_B);
	run_ms(p, 100);
	send_sync(p);
	assert_int_equal(canopen_nmt_state(&p->node[A].device.canopen), NMT_OPERATIONAL);
	assert_int_equal(canopen_nmt_state(&p->node[B].device.canopen), NMT_STOPPED);
	assert_int_equal(world_count(&p->node[A], 0x180 + NODE_A), 1);
	assert_int_equal(world_count(&p->node[B], 0x180 + NODE_B), 0);
	send(p, 0x600 + NODE_A, 8, read_device_type);
	send(p, 0x600 + NODE_B, 8, read_device_type);
	assert_int_equal(world_count(&p->node[A], 0x580 + NODE_A), 1);
	assert_int_equal(world_count(&p->node[B], 0x580 + NODE_B), 0);
}

/* ---- heartbeat, collision ---------------------------------------------------------------------------------------- */

static void write_u32(struct pair *p, int node, uint16_t index, uint8_t sub, uint32_t value)
{
	assert_int_equal(world_sdo_write(&p->node[node], index, sub, &value, 4), 0);
	exchange(p);
}

static void write_u16(struct pair *p, int node, uint16_t index, uint8_t sub, uint16_t value)
{
	assert_int_equal(world_sdo_write(&p->node[node], index, sub, &value, 2), 0);
	exchange(p);
}

static void test_a_node_reports_that_the_other_one_is_silent_and_that_it_is_back(void **state)
{
	struct pair *p = *state;

	write_u16(p, B, 0x1017, 0, 100);
	write_u32(p, A, 0x1016, 1, NODE_B << 16 | 250); /* ms */
	send_nmt(p, NMT_COMMAND_START, 0);
	run_ms(p, 2000);
	assert_int_equal(world_count(&p->node[A], 0x080 + NODE_A), 0);

	p->off[B] = true;
	run_ms(p, 500);
	assert_int_equal(world_emcy_code(&p->node[A]), EMCY_HEARTBEAT);
	assert_int_equal(world_last(&p->node[A], 0x080 + NODE_A)->data[3], NODE_B);
	assert_int_equal(canopen_nmt_state(&p->node[A].device.canopen), NMT_PRE_OPERATIONAL);

	p->off[B] = false;
	p->node[B].now_us = p->node[A].now_us;
	world_power_on(&p->node[B], NULL);
	run_ms(p, 100);
	assert_int_equal(world_emcy_code(&p->node[A]), EMCY_NO_ERROR);
}

static void test_two_nodes_with_one_node_id_both_report_the_collision(void **state)
{
	struct pair *p = *state;

	memset(p, 0, sizeof(*p));
	init(p, NODE_A, NODE_A);
	run_ms(p, 1100); /* a heartbeat of each */
	assert_int_equal(world_emcy_code(&p->node[A]), EMCY_COLLISION);
	assert_int_equal(world_emcy_code(&p->node[B]), EMCY_COLLISION);
}

/* ---- LSS --------------------------------------------------------------------------------------------------------- */

/* True: at least one node responds. */
static bool lss(struct pair *p, const uint8_t request[8])
{
	unsigned before = world_count(&p->node[A], LSS_RESPONSE) + world_count(&p->node[B], LSS_RESPONSE);

	send(p, LSS_REQUEST, 8, request);
	return world_count(&p->node[A], LSS_RESPONSE) + world_count(&p->node[B], LSS_RESPONSE) > before;
}

static bool scan(struct pair *p, uint32_t value, uint8_t bit, uint8_t number, uint8_t next)
{
	uint8_t request[8] = {0x51, 0, 0, 0, 0, bit, number, next};

	put_u32(request + 1, value);
	return lss(p, request);
}

/* The serial number of the node that was found, which is in configuration state then; 0: no node is unconfigured. */
static uint32_t fastscan(struct pair *p)
{
	uint32_t value = 0;

	if (!scan(p, 0, 0x80, 0, 0))
		return 0;
	for (uint8_t number = 0; number < 4; number++) {
		value = 0;
		for (int bit = 31; bit >= 0; bit--)
			if (!scan(p, value, (uint8_t)bit, number, number))
				value |= 1u << bit;
		assert_true(scan(p, value, 0, number, (number + 1) & 3));
	}
	return value;
}

static void give_node_id(struct pair *p, uint8_t node_id)
{
	assert_true(lss(p, (const uint8_t[8]){0x11, node_id}));
	lss(p, (const uint8_t[8]){0x04, 0});
}

static void test_fastscan_finds_both_unconfigured_nodes_one_after_the_other(void **state)
{
	struct pair *p = *state;

	memset(p, 0, sizeof(*p));
	init(p, CANOPEN_UNCONFIGURED, CANOPEN_UNCONFIGURED);
	assert_int_equal(fastscan(p), SERIAL_A); /* of two the one whose first differing bit is 0 */
	give_node_id(p, 0x20);
	run_ms(p, 20);
	assert_int_equal(world_count(&p->node[A], 0x720), 1);
	assert_int_equal(fastscan(p), SERIAL_B);
	give_node_id(p, 0x21);
	run_ms(p, 20);
	assert_int_equal(world_count(&p->node[B], 0x721), 1);
	assert_int_equal(fastscan(p), 0);
}

int main(void)
{
#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_each_node_answers_its_own_sdo_and_keeps_its_own_values),
		TEST(test_one_sync_makes_both_nodes_send_the_pdos_of_their_own_sensors),
		TEST(test_a_node_computes_the_same_beside_another_one_as_alone),
		TEST(test_a_node_that_is_stopped_leaves_the_other_operational),
		TEST(test_a_node_reports_that_the_other_one_is_silent_and_that_it_is_back),
		TEST(test_two_nodes_with_one_node_id_both_report_the_collision),
		TEST(test_fastscan_finds_both_unconfigured_nodes_one_after_the_other),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

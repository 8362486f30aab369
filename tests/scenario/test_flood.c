/* A whole device on a bus that misbehaves: 20000 frames a second of one kind. They cost two EMCYs and two lines of the
 * log a second and kind at most, and the device goes on. */
#include <string.h>

#include "tests/scenario/world.h"

enum { EMCYS = 1000, FRAME_US = 50, SAMPLE_US = 10000, FLOOD_US = 5000000 };

struct flooded {
	struct world world;
	struct {
		uint64_t t_us;
		uint8_t data[8];
	} emcy[EMCYS];
	size_t emcy_count;
	unsigned pdos, answers;
};

static int take_frame(struct can_port *port, const struct can_msg *msg)
{
	struct flooded *f = (struct flooded *)(void *)port;

	if (msg->id == 0x080 + WORLD_NODE_ID) {
		assert_true(f->emcy_count < EMCYS);
		f->emcy[f->emcy_count].t_us = f->world.now_us;
		memcpy(f->emcy[f->emcy_count++].data, msg->data, 8);
	}
	f->pdos += msg->id == 0x180 + WORLD_NODE_ID;
	f->answers += msg->id == 0x580 + WORLD_NODE_ID;
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static int set_up(void **state)
{
	static const struct can_ops ops = {.send = take_frame, .filter = take_filter};
	struct flooded *f = test_calloc(1, sizeof(*f));

	world_init(&f->world, sensor_preset("ideal"), 1, "rest");
	f->world.bus = (struct can_port){.ops = &ops, .fd = -1, .name = "can9"};
	world_power_on(&f->world, (const char *const[]){"tpdo1_communication.transmission_type=255", NULL});
	world_nmt(&f->world, 1);
	*state = f;
	return 0;
}

static int tear_down(void **state)
{
	test_free(*state);
	return 0;
}

/* Frames `frames` in turn, and the states of the controller `states` in turn. */
struct flood {
	struct {
		uint32_t id;
		uint8_t len, data[8];
	} frames[4];
	size_t count;
	enum can_state states[2];
};

static void flood(struct flooded *f, const struct flood *flood)
{
	struct world *w = &f->world;
	uint64_t next_sample_us = w->now_us + SAMPLE_US, end_us = w->now_us + FLOOD_US;

	for (unsigned i = 0; w->now_us < end_us; i++) {
		w->now_us += FRAME_US;
		w->bus.state = flood->states[i % 2];
		world_receive(w, flood->frames[i % flood->count].id, flood->frames[i % flood->count].len,
			flood->frames[i % flood->count].data);
		if (w->now_us < next_sample_us)
			continue;
		next_sample_us += SAMPLE_US;
		w->now_us -= w->interval_us;
		world_sample(w);
	}
}

static void assert_few_emcys(const struct flooded *f)
{
	for (size_t i = 0; i < f->emcy_count; i++) {
		unsigned same = 0;

		for (size_t k = i; k < f->emcy_count && f->emcy[k].t_us < f->emcy[i].t_us + 1000000; k++)
			same += memcmp(f->emcy[k].data, f->emcy[i].data, 2) == 0;
		assert_in_range(same, 0, 2);
	}
}

/* Lines of a kind have the same first characters after the time. */
static void assert_few_lines(const struct flooded *f)
{
	enum { KIND_AT = 15, KIND_LENGTH = 11, LINE_MIN = KIND_AT + KIND_LENGTH };
	const char *text = f->world.device.log.text, *end = text + f->world.device.log.used, *next;

	for (const char *line = text; line < end; line = next) {
		unsigned same = 0;

		next = (const char *)memchr(line, '\n', (size_t)(end - line)) + 1;
		for (const char *other = line; end - other > LINE_MIN && next - line > LINE_MIN;
			other = (const char *)memchr(other, '\n', (size_t)(end - other)) + 1)
			same += memcmp(other + KIND_AT, line + KIND_AT, KIND_LENGTH) == 0;
		assert_in_range(same, 0, 2 + FLOOD_US / 1000000);
	}
}

#define SYNC              \
	{                 \
		0x080, 0, \
		{         \
			0 \
		}         \
	}
static const struct flood FLOODS[] = {
	{{{0x000, 2, {1, WORLD_NODE_ID}}, {0x000, 2, {0x80, WORLD_NODE_ID}}, {0x000, 2, {2, 0}}}, 3, {0}},
	{{SYNC, {0x080, 1, {7}}}, 2, {0}},
	{{{0x200 + WORLD_NODE_ID, 8, {0}}, {0x200 + WORLD_NODE_ID, 6, {0}}}, 2, {0}},
	{{{0x500 + WORLD_NODE_ID, 2, {0}}, {0x500 + WORLD_NODE_ID, 3, {0}}, {0x500 + WORLD_NODE_ID, 0, {0}}}, 3, {0}},
	{{{0x400 + WORLD_NODE_ID, 8, {0, 0, 0, 0, 0, 0, 9}}, {0x400 + WORLD_NODE_ID, 8, {0}}}, 2, {0}},
	{{{0x700 + WORLD_NODE_ID, 1, {5}}, {0x580 + WORLD_NODE_ID, 8, {0}}, {0x180 + WORLD_NODE_ID, 8, {0}}}, 3, {0}},
	{{{0x600 + WORLD_NODE_ID, 4, {0x40, 0x17, 0x10, 0}}}, 1, {0}},
	{{{0x600 + WORLD_NODE_ID, 8, {0x2F, 0x30, 0x21, 0, 1}}}, 1, {0}},
	{{{0x7E5, 8, {0x04, 1}}, {0x7E5, 8, {0x13, 0, 2}}}, 2, {0}},
	{{{0x7E5, 8, {0x51}}, {0x7E5, 3, {0x51}}}, 2, {0}},
	{{SYNC}, 1, {CAN_STATE_PASSIVE, CAN_STATE_ACTIVE}},
	{{SYNC}, 1, {CAN_STATE_BUS_OFF, CAN_STATE_ACTIVE}},
};

static void test_no_flood_costs_more_than_two_emcys_and_two_lines_a_second_and_kind(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof(FLOODS) / sizeof(FLOODS[0]); i++) {
		void *fixture;

		set_up(&fixture);
		struct flooded *f = fixture;

		flood(f, &FLOODS[i]);
		assert_few_emcys(f);
		assert_few_lines(f);
		assert_int_equal(f->world.device.samples, FLOOD_US / SAMPLE_US);
		world_nmt(&f->world, 1);
		f->pdos = 0;
		world_sample(&f->world);
		assert_int_equal(f->pdos, 1);
		tear_down(&fixture);
	}
}

static bool logged(const struct flooded *f, const char *text)
{
	return memmem(f->world.device.log.text, f->world.device.log.used, text, strlen(text)) != NULL;
}

static void test_the_log_says_how_many_lines_were_left_out_and_has_the_last_one(void **state)
{
	struct flooded *f = *state;

	world_seconds(&f->world, 2);
	for (int i = 0; i < 1000; i++)
		world_nmt(&f->world, i % 2 ? 2 : 1);
	world_nmt(&f->world, 0x80);
	assert_false(logged(f, "lines like this left out"));
	world_seconds(&f->world, 1.1);
	assert_true(logged(f, "NMT state: pre-operational (997 lines like this left out)\n"));
}

static void test_lines_a_second_apart_are_all_in_the_log(void **state)
{
	struct flooded *f = *state;

	for (int i = 0; i < 5; i++) {
		world_seconds(&f->world, 1.5);
		world_nmt(&f->world, 0x80);
		world_nmt(&f->world, 1);
	}
	assert_false(logged(f, "left out"));
	unsigned lines = 0;
	const char *text = f->world.device.log.text, *end = text + f->world.device.log.used;
	for (const char *at = text; (at = memmem(at, (size_t)(end - at), "operational\n", 12)); at++)
		lines++;
	assert_int_equal(lines, 2 + 10);
}

/* Old PLCs send SDO requests of as many bytes as they have: no answer is legal. */
static void test_sdo_requests_of_fewer_than_eight_bytes_are_counted_and_told_once(void **state)
{
	static const uint8_t requests[][6] = {
		{0x2F, 0x0D, 0x10, 0, 2}, {0x2B, 0x17, 0x10, 0, 0xF4, 1}, {0x40, 0x17, 0x10, 0}};
	struct flooded *f = *state;

	for (size_t i = 0; i < 3; i++) {
		world_receive(&f->world, 0x600 + WORLD_NODE_ID, 6 - i % 2, requests[i]);
		world_seconds(&f->world, 2);
	}
	assert_int_equal(f->world.device.values.bus_counters.short_sdo_requests, 3);
	const char *text = f->world.device.log.text, *end = text + f->world.device.log.used;
	const char *line = memmem(text, (size_t)(end - text), "an SDO request has fewer than 8 bytes", 37);
	assert_non_null(line);
	assert_null(memmem(line + 37, (size_t)(end - line - 37), "fewer than 8 bytes", 18));
	assert_int_equal(f->world.device.values.producer_heartbeat_time, 1000);
}

/* Frames that were received in one go: there is no tick between them. */
static void receive_at_once(struct flooded *f, uint32_t id, const uint8_t data[8], unsigned count)
{
	struct can_msg msg = {.id = id, .len = 8, .t_us = f->world.now_us};

	memcpy(msg.data, data, 8);
	f->answers = 0;
	for (unsigned i = 0; i < count; i++)
		device_receive(&f->world.device, &msg, f->world.now_us);
}

static void test_of_many_sdo_requests_at_once_sixteen_are_answered(void **state)
{
	static const uint8_t upload[8] = {0x40, 0, 0x10}, block_upload[8] = {0xA0, 0x21, 0x10, 0, 127};
	struct flooded *f = *state;

	for (int i = 0; i < 3; i++) {
		receive_at_once(f, 0x600 + WORLD_NODE_ID, upload, 64);
		assert_int_equal(f->answers, 16);
		device_tick(&f->world.device, f->world.now_us);
	}
	receive_at_once(f, 0x600 + WORLD_NODE_ID, block_upload, 64);
	assert_int_equal(f->answers, 16);
	device_tick(&f->world.device, f->world.now_us);
	receive_at_once(f, 0x600 + WORLD_NODE_ID, upload, 1);
	assert_int_equal(f->answers, 1);
	const char *text = f->world.device.log.text, *end = text + f->world.device.log.used;
	const char *line = memmem(text, (size_t)(end - text), "without waiting for the answers", 31);
	assert_non_null(line);
	assert_null(memmem(line + 31, (size_t)(end - line - 31), "without waiting for the answers", 31));
}

static void test_the_segments_of_a_block_download_are_no_flood(void **state)
{
	static const uint8_t start[8] = {0xC2, 0x30, 0x21, 0, 0xE8, 3};
	struct flooded *f = *state;

	receive_at_once(f, 0x600 + WORLD_NODE_ID, start, 1);
	assert_int_equal(f->answers, 1);
	for (uint8_t n = 1; n <= 20; n++) {
		assert_int_equal(f->world.device.canopen.sdo_servers[0].done, 7 * (n - 1));
		receive_at_once(f, 0x600 + WORLD_NODE_ID, (const uint8_t[8]){n}, 1);
	}
}

#define FLOODED(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_no_flood_costs_more_than_two_emcys_and_two_lines_a_second_and_kind),
		FLOODED(test_the_log_says_how_many_lines_were_left_out_and_has_the_last_one),
		FLOODED(test_sdo_requests_of_fewer_than_eight_bytes_are_counted_and_told_once),
		FLOODED(test_of_many_sdo_requests_at_once_sixteen_are_answered),
		FLOODED(test_the_segments_of_a_block_download_are_no_flood),
		FLOODED(test_lines_a_second_apart_are_all_in_the_log),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

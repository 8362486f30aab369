/* Decoding of a node's frames by the monitor. A simulated node: an SDO server with a few objects, and frames. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <string.h>
#include <cmocka.h>

#include "gateway/canopen/canopen.h"
#include "gateway/status.h"
#include "model/pipeline.h"
#include "od_values.h"
#include "tools/lib/watch.h"

enum { NODE = 5, SECOND = 1000000 };

struct object {
	uint16_t index;
	uint8_t sub, size;
	uint32_t value;
};

struct bench {
	struct can_port bus; /* first member: ops->send() gets a pointer to it */
	struct watch watch;
	struct od_values values;
	struct can_msg request;
	bool requested;
	unsigned int requests;
};

static int capture(struct can_port *port, const struct can_msg *msg)
{
	struct bench *bench = (struct bench *)port;

	bench->request = *msg;
	bench->requested = true;
	bench->requests++;
	return 0;
}

static struct bench *bench_new(bool passive)
{
	static const struct can_ops ops = {.send = capture};
	static struct bench bench;

	bench = (struct bench){.bus = {.ops = &ops, .fd = -1}};
	watch_init(&bench.watch, &imu9_od_table, &bench.values, &bench.bus, NODE, passive, SECOND);
	return &bench;
}

static void frame(struct bench *bench, uint32_t id, const void *data, uint8_t len, uint64_t now_us)
{
	struct can_msg msg = {.id = id, .len = len};

	memcpy(msg.data, data, len);
	watch_receive(&bench->watch, &msg, now_us);
}

#define FRAME(bench, id, now_us, ...) \
	frame(bench, id, (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}), now_us)

/* Answers all SDO requests: these objects expedited, all others aborted. */
static void serve(struct bench *bench, const struct object *objects, size_t count, uint64_t now_us)
{
	while (bench->requested) {
		const uint8_t *r = bench->request.data;
		uint8_t answer[8] = {0x80, r[1], r[2], r[3], 0x00, 0x00, 0x02, 0x06};

		bench->requested = false;
		assert_int_equal(bench->request.id, 0x600 + NODE);
		for (size_t i = 0; i < count; i++)
			if (objects[i].index == (r[1] | r[2] << 8) && objects[i].sub == r[3]) {
				answer[0] = (uint8_t)(0x43 | (4 - objects[i].size) << 2);
				for (int k = 0; k < 4; k++)
					answer[4 + k] = (uint8_t)(objects[i].value >> 8 * k);
			}
		frame(bench, 0x580 + NODE, answer, 8, now_us);
	}
}

static const char *text_of(const struct watch_field *field)
{
	static char text[128];

	watch_field_text(field, text, sizeof(text));
	return text;
}

static void test_a_pdo_is_decoded_by_the_default_mapping_with_units(void **state)
{
	(void)state;
	struct bench *b = bench_new(true);
	const struct watch_pdo *pdo = &b->watch.pdos[0];

	FRAME(b, 0x180 + NODE, SECOND, 0x7B, 0x00, 0xFE, 0xFF, 0x00, 0x80, 0x2A, 0x01);
	assert_int_equal(pdo->field_count, 4);
	assert_string_equal(pdo->fields[0].entry->name, "acceleration.l");
	assert_string_equal(pdo->fields[0].entry->unit, "m/s^2");
	assert_string_equal(text_of(&pdo->fields[0]), "0.615");	   /* 123 * 0.005 */
	assert_string_equal(text_of(&pdo->fields[1]), "-0.010");   /* -2 */
	assert_string_equal(text_of(&pdo->fields[2]), "-163.840"); /* -32768 */
	assert_string_equal(text_of(&pdo->fields[3]), "298");
	assert_int_equal(b->watch.nmt_state, NMT_OPERATIONAL);
}

static void test_frames_with_29_bit_identifiers_are_ignored(void **state)
{
	static const uint32_t IDS[] = {0x080, 0x080 + NODE, 0x180 + NODE, 0x700 + NODE};
	struct bench *bench = bench_new(true);

	(void)state;
	for (size_t i = 0; i < sizeof(IDS) / sizeof(IDS[0]); i++) {
		const struct can_msg msg = {.id = IDS[i], .extended = true, .len = i == 3 ? 1 : 8};

		watch_receive(&bench->watch, &msg, 2 * SECOND);
	}
	assert_int_equal(bench->watch.heard_us, 0);
	assert_int_equal(bench->watch.sync.count, 0);
	assert_int_equal(bench->watch.emcy.count, 0);
	assert_false(watch_has_values(&bench->watch));
}

static void test_a_passive_watch_sends_nothing(void **state)
{
	(void)state;
	struct bench *b = bench_new(true);

	FRAME(b, 0x700 + NODE, SECOND, 0x00);
	watch_tick(&b->watch, 10 * SECOND);
	assert_int_equal(b->requests, 0);
}

static void test_mapping_and_resolutions_are_read_from_the_node(void **state)
{
	(void)state;
	static const struct object objects[] = {
		{0x1800, 1, 4, 0x1C5},
		{0x1A00, 0, 1, 3},
		{0x1A00, 1, 4, 0x21030120}, /* REAL32 quaternion.w */
		{0x1A00, 2, 4, 0x21000210},
		{0x1A00, 3, 4, 0x10010008},
		{0x1801, 1, 4, 0xC0000285}, /* switched off */
		{0x2110, 1, 2, 100},
	};
	struct bench *b = bench_new(false);
	const struct watch_pdo *pdo = &b->watch.pdos[0];

	serve(b, objects, sizeof(objects) / sizeof(objects[0]), SECOND);
	assert_int_equal(b->watch.mapping, WATCH_READ);
	FRAME(b, 0x1C5, SECOND, 0x00, 0x00, 0x00, 0xBF, 0x0A, 0x00, 0x81);
	assert_int_equal(pdo->rate.count, 1);
	assert_string_equal(text_of(&pdo->fields[0]), "-0.5");
	assert_string_equal(text_of(&pdo->fields[1]), "1.0");		       /* 10 * 0.1 m/s^2 */
	assert_string_equal(text_of(&pdo->fields[2]), "generic,manufacturer"); /* 129 */
	FRAME(b, 0x285, SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	assert_int_equal(b->watch.pdos[1].rate.count, 0);
	assert_true(b->watch.pdos[2].enabled);
}

static void test_pdos_are_not_decoded_before_the_mapping_is_known(void **state)
{
	(void)state;
	struct bench *b = bench_new(false);

	FRAME(b, 0x180 + NODE, SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	assert_false(watch_has_values(&b->watch));
}

static void test_without_an_answer_the_default_mapping_is_used_and_reading_is_retried(void **state)
{
	(void)state;
	struct bench *b = bench_new(false);
	uint64_t deadline_us = watch_tick(&b->watch, SECOND);

	deadline_us = watch_tick(&b->watch, deadline_us);
	assert_int_equal(b->watch.mapping, WATCH_DEFAULTS);
	FRAME(b, 0x180 + NODE, 2 * SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	assert_true(watch_has_values(&b->watch));
	b->requested = false;
	watch_tick(&b->watch, deadline_us);
	assert_true(b->requested);
	serve(b, NULL, 0, deadline_us);
	assert_int_equal(b->watch.mapping, WATCH_READ);
	assert_true(watch_has_values(&b->watch)); /* the mapping is the same: values are kept */
}

static void test_the_mapping_is_read_again_after_a_boot_up(void **state)
{
	(void)state;
	static const struct object objects[] = {{0x1800, 1, 4, 0x1C5}};
	struct bench *b = bench_new(false);

	serve(b, NULL, 0, SECOND);
	assert_int_equal(b->watch.pdos[0].id, 0x185);
	FRAME(b, 0x700 + NODE, SECOND, 0x00);
	assert_int_equal(b->watch.mapping, WATCH_READING);
	assert_int_equal(b->watch.nmt_state, NMT_PRE_OPERATIONAL);
	serve(b, objects, 1, SECOND);
	assert_int_equal(b->watch.pdos[0].id, 0x1C5);
	assert_int_equal(b->watch.configured, 2);
}

static void test_a_pdo_of_another_length_is_not_decoded_and_the_mapping_is_read_again(void **state)
{
	(void)state;
	struct bench *b = bench_new(false);

	serve(b, NULL, 0, SECOND);
	FRAME(b, 0x180 + NODE, SECOND, 1, 2, 3, 4, 5, 6);
	assert_int_equal(b->watch.pdos[0].misfits, 1);
	assert_false(watch_has_values(&b->watch));
	uint64_t deadline_us = watch_tick(&b->watch, SECOND);
	assert_true(deadline_us <= 2 * SECOND);
	watch_tick(&b->watch, deadline_us);
	assert_true(b->requested);
}

static void test_skipped_and_repeated_samples_are_counted_across_the_wrap(void **state)
{
	(void)state;
	static const uint16_t counters[] = {65533, 65534, 65534, 2, 3};
	struct bench *b = bench_new(true);

	for (size_t i = 0; i < sizeof(counters) / sizeof(counters[0]); i++)
		FRAME(b, 0x180 + NODE, SECOND, 0, 0, 0, 0, 0, 0, (uint8_t)counters[i], (uint8_t)(counters[i] >> 8));
	assert_int_equal(b->watch.pdos[0].repeated, 1);
	assert_int_equal(b->watch.pdos[0].skipped, 3); /* 65535, 0, 1 */
}

static void test_the_rate_is_that_of_the_frames_and_falls_when_they_stop(void **state)
{
	(void)state;
	struct bench *b = bench_new(true);
	const struct watch_rate *rate = &b->watch.pdos[0].rate;

	for (unsigned int i = 0; i <= 100; i++)
		FRAME(b, 0x180 + NODE, SECOND + i * 10000, 0, 0, 0, 0, 0, 0, 0, 0);
	assert_true(watch_rate_hz(rate, 2 * SECOND) > 99.9 && watch_rate_hz(rate, 2 * SECOND) < 100.1);
	assert_true(watch_rate_hz(rate, 4 * SECOND) <= 0.5);
}

static void test_heartbeat_sync_and_emergency_are_recorded(void **state)
{
	(void)state;
	struct bench *b = bench_new(true);

	FRAME(b, 0x700 + NODE, SECOND, 0x04);
	FRAME(b, 0x080, SECOND, 0);
	FRAME(b, 0x080 + NODE, SECOND, 0x20, 0x81, 0x11, 0, 0, 0, 0, 0);
	assert_int_equal(b->watch.nmt_state, NMT_STOPPED);
	assert_int_equal(b->watch.sync.count, 1);
	assert_int_equal(b->watch.emcys[0].code, 0x8120);
	assert_int_equal(b->watch.emcys[0].error_register, 0x11);
}

static void test_a_node_is_lost_after_three_heartbeat_periods_of_silence(void **state)
{
	(void)state;
	struct bench *b = bench_new(true); /* 1017h: 1000 ms */

	FRAME(b, 0x700 + NODE, SECOND, 0x05);
	assert_int_equal(watch_nmt_state(&b->watch, 4 * SECOND), NMT_OPERATIONAL);
	assert_int_equal(watch_nmt_state(&b->watch, 4 * SECOND + 1), WATCH_NMT_LOST);
	FRAME(b, 0x180 + NODE, 5 * SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	assert_int_equal(watch_nmt_state(&b->watch, 5 * SECOND), NMT_OPERATIONAL);
}

static void test_frames_of_other_nodes_are_ignored(void **state)
{
	(void)state;
	struct bench *b = bench_new(true);

	FRAME(b, 0x180 + NODE + 1, SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	FRAME(b, 0x700 + NODE + 1, SECOND, 0x05);
	FRAME(b, 0x080 + NODE + 1, SECOND, 0x20, 0x81, 0x11, 0, 0, 0, 0, 0);
	assert_false(watch_has_values(&b->watch));
	assert_int_equal(b->watch.nmt_state, WATCH_NMT_UNKNOWN);
	assert_int_equal(b->watch.emcy.count, 0);
	assert_int_equal(b->watch.heard_us, 0);
}

/* The words of the EDS belong to the bits of the code. */
static void test_status_bits_have_texts(void **state)
{
	static const struct {
		unsigned int status;
		const char *text;
	} CASES[] = {
		{0, "none"},
		{PIPELINE_VALID | PIPELINE_REST, "valid,rest"},
		{PIPELINE_MAG_USED | PIPELINE_TIME_LIMIT, "magnetometer_used,position_held"},
		{PIPELINE_GAP | PIPELINE_UNSURE, "gap,position_unsure"},
		{PIPELINE_ASSUMED | PIPELINE_DISAGREES, "standstill_assumed,field_disagrees"},
		{STATUS_SATURATED | STATUS_SENSOR_LOST, "saturated,sensor_lost"},
		{STATUS_SENSOR_FAULT | STATUS_EXTERNAL_AID, "sensor_fault,external_aid"},
		{STATUS_COMMISSIONING | STATUS_UTC | PIPELINE_VIBRATION, "commissioning,utc,vibration"},
		{1u << 15, "bit15"},
	};
	struct watch_field field = {
		.entry = od_find(&imu9_od_table, OD_INDEX_SAMPLE, OD_SUB_SAMPLE_STATUS, NULL), .step = 1};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); i++) {
		field.raw = CASES[i].status;
		assert_string_equal(text_of(&field), CASES[i].text);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_pdo_is_decoded_by_the_default_mapping_with_units),
		cmocka_unit_test(test_frames_with_29_bit_identifiers_are_ignored),
		cmocka_unit_test(test_a_passive_watch_sends_nothing),
		cmocka_unit_test(test_mapping_and_resolutions_are_read_from_the_node),
		cmocka_unit_test(test_pdos_are_not_decoded_before_the_mapping_is_known),
		cmocka_unit_test(test_without_an_answer_the_default_mapping_is_used_and_reading_is_retried),
		cmocka_unit_test(test_the_mapping_is_read_again_after_a_boot_up),
		cmocka_unit_test(test_a_pdo_of_another_length_is_not_decoded_and_the_mapping_is_read_again),
		cmocka_unit_test(test_skipped_and_repeated_samples_are_counted_across_the_wrap),
		cmocka_unit_test(test_the_rate_is_that_of_the_frames_and_falls_when_they_stop),
		cmocka_unit_test(test_heartbeat_sync_and_emergency_are_recorded),
		cmocka_unit_test(test_a_node_is_lost_after_three_heartbeat_periods_of_silence),
		cmocka_unit_test(test_frames_of_other_nodes_are_ignored),
		cmocka_unit_test(test_status_bits_have_texts),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

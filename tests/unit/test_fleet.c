/* What imu9-fleet says of the nodes of a bus: frames and time go in, records come out. The nodes have the default
 * mapping: three values and the sample counter in TPDO1 to TPDO3 (README.md). */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "od_values.h"
#include "tools/fleet/fleet.h"
#include "tools/fleet/format.h"

enum { SECOND = 1000000, MS = 1000, RECORDS = 4096 };
static const int64_t UTC_OFFSET_US = INT64_C(1700000000000000);

static struct bench {
	struct can_port bus;
	struct fleet_config config;
	struct fleet fleet;
	struct record records[RECORDS];
	size_t count;
	uint64_t now_us;
} b;

static int refuse(struct can_port *port, const struct can_msg *msg)
{
	(void)port, (void)msg;
	fail(); /* it is passive */
	return 0;
}

static void keep(void *ctx, const struct record *record)
{
	(void)ctx;
	uint8_t bytes[RECORD_MAX];
	assert_true(b.count < RECORDS);
	/* as it comes out at the other end */
	assert_int_equal(record_decode(&b.records[b.count++], bytes, record_encode(record, bytes)), 0);
}

static int set_up(void **state)
{
	static const struct can_ops ops = {.send = refuse};
	static const struct fleet_sink sink = {NULL, keep};

	(void)state;
	b = (struct bench){.bus = {.ops = &ops, .fd = -1}, .now_us = SECOND};
	b.config.passive = true;
	b.config.at_least_s = 60;
	for (int id = 1; id < FLEET_NODES; id++)
		b.config.tables[id] = &imu9_od_table;
	fleet_init(&b.fleet, &b.config, &b.bus, &sink, b.now_us);
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	fleet_free(&b.fleet);
	return 0;
}

static void frame(uint32_t id, const void *data, uint8_t len)
{
	struct can_msg msg = {.id = id, .len = len, .t_us = b.now_us};

	memcpy(msg.data, data, len);
	fleet_receive(&b.fleet, &msg, b.now_us, UTC_OFFSET_US);
}

static void pdo(unsigned number, unsigned node, int value, unsigned counter)
{
	uint8_t data[8] = {
		(uint8_t)value, (uint8_t)(value >> 8), 0, 0, 0, 0, (uint8_t)counter, (uint8_t)(counter >> 8)};

	frame(0x80 + 0x100 * number + node, data, 8);
}

static void pass(uint64_t us)
{
	for (uint64_t end_us = b.now_us + us; b.now_us < end_us;) {
		uint64_t next_us = fleet_tick(&b.fleet, b.now_us, UTC_OFFSET_US);

		assert_true(next_us > b.now_us);
		b.now_us = next_us < end_us ? next_us : end_us;
	}
	fleet_tick(&b.fleet, b.now_us, UTC_OFFSET_US);
}

/* The record of this kind number n, or NULL. */
static const struct record *record_of(enum record_kind kind, size_t n)
{
	for (size_t i = 0; i < b.count; i++)
		if (b.records[i].kind == kind && n-- == 0)
			return &b.records[i];
	return NULL;
}

static size_t count_of(enum record_kind kind)
{
	size_t n = 0;

	while (record_of(kind, n))
		n++;
	return n;
}

static void test_pdos_with_one_counter_are_one_sample_with_the_time_of_the_first(void **state)
{
	uint64_t first_us;

	(void)state;
	for (unsigned sample = 7; sample < 10; sample++) {
		first_us = b.now_us;
		for (unsigned number = 1; number <= 3; number++) {
			pdo(number, 5, 100 * (int)number + (int)sample, sample);
			b.now_us += 300;
		}
		pass(10 * MS);
	}
	pass(50 * MS);
	assert_int_equal(count_of(RECORD_VALUES), 3);
	const struct record *last = record_of(RECORD_VALUES, 2);
	assert_int_equal(last->node_id, 5);
	assert_true(last->counted);
	assert_int_equal(last->counter, 9);
	assert_int_equal(last->field_count, 9);
	assert_int_equal(last->fields[0].mapping, 0x21000110); /* acceleration.l */
	assert_int_equal(last->fields[0].wire, 109);
	assert_true(last->fields[0].step > 0.0049 && last->fields[0].step < 0.0051);
	assert_int_equal(last->fields[6].wire, 309);
	assert_int_equal(last->utc_us, (int64_t)first_us + UTC_OFFSET_US);
}

static void test_no_sample_is_lost_or_doubled_when_frames_of_two_interleave(void **state)
{
	(void)state;
	for (unsigned sample = 0; sample < 200; sample++) {
		pdo(1, 5, 1, sample);
		pdo(2, 5, 2, sample);
		if (sample % 3 == 0)
			pass(30 * MS); /* TPDO3 comes late: it is another record of the same sample */
		pdo(3, 5, 3, sample);
		b.now_us += 10 * MS;
	}
	pass(50 * MS);
	unsigned seen[200][4] = {{0}};
	for (size_t i = 0; i < count_of(RECORD_VALUES); i++) {
		const struct record *r = record_of(RECORD_VALUES, i);

		for (size_t k = 0; k < r->field_count; k += 3)
			seen[r->counter][r->fields[k].wire]++;
	}
	for (unsigned sample = 0; sample < 200; sample++)
		for (unsigned number = 1; number <= 3; number++)
			assert_int_equal(seen[sample][number], 1);
}

static void test_two_records_of_a_sample_have_different_times(void **state)
{
	uint64_t first_us = b.now_us;

	(void)state;
	pdo(1, 5, 1, 7);
	pass(30 * MS);
	b.now_us = first_us; /* the time stamps of both frames are the same */
	pdo(2, 5, 2, 7);
	pass(60 * MS);
	assert_int_equal(count_of(RECORD_VALUES), 2);
	assert_int_equal(record_of(RECORD_VALUES, 1)->counter, record_of(RECORD_VALUES, 0)->counter);
	assert_true(record_of(RECORD_VALUES, 1)->utc_us > record_of(RECORD_VALUES, 0)->utc_us);
}

static void test_a_sample_that_is_sent_again_is_published_once(void **state)
{
	(void)state;
	for (int i = 0; i < 10; i++) {
		pdo(1, 5, 1, (unsigned)i / 5);
		b.now_us += 10 * MS;
		pass(30 * MS);
	}
	assert_int_equal(count_of(RECORD_VALUES), 2);
}

static void test_decimation_keeps_the_average_rate(void **state)
{
	(void)state;
	b.config.hz = 10;
	for (unsigned sample = 0; sample < 1000; sample++) { /* 10 s at 100 Hz, not in step with the 0.1 s */
		pdo(1, 5, 1, sample);
		pdo(1, 6, 1, sample);
		b.now_us += 10 * MS + (sample & 1);
	}
	pass(50 * MS);
	assert_in_range(count_of(RECORD_VALUES), 2 * 99, 2 * 102);
	assert_int_equal(b.fleet.samples, 2000);
	assert_int_equal(b.fleet.withheld, 2000 - count_of(RECORD_VALUES));
}

static void test_with_a_threshold_only_changes_are_published_and_one_a_minute(void **state)
{
	(void)state;
	b.config.thresholds[0] = (struct fleet_threshold){.index = 0x2100, .sub = 1, .change = 0.1}; /* 20 steps */
	b.config.threshold_count = 1;
	for (unsigned sample = 0; sample < 500; sample++) { /* 5 s */
		pdo(1, 5, sample < 250 ? (int)(sample % 20) : 300, sample);
		b.now_us += 10 * MS;
	}
	pass(50 * MS);
	assert_int_equal(count_of(RECORD_VALUES), 2); /* the first one, and that with 300 */
	assert_int_equal(record_of(RECORD_VALUES, 1)->counter, 250);
	for (unsigned sample = 500; sample < 6550; sample++) { /* a minute */
		pdo(1, 5, 300, sample);
		b.now_us += 10 * MS;
	}
	pass(50 * MS);
	assert_int_equal(count_of(RECORD_VALUES), 3);
}

static void test_each_change_of_the_state_is_told_and_a_lost_heartbeat_too(void **state)
{
	(void)state;
	static const uint8_t PRE_OPERATIONAL = 0x7F, OPERATIONAL = 0x05;

	frame(0x705, &PRE_OPERATIONAL, 1);
	pass(SECOND);
	frame(0x705, &PRE_OPERATIONAL, 1);
	frame(0x705, &OPERATIONAL, 1);
	pass(SECOND);
	frame(0x705, &OPERATIONAL, 1);
	assert_int_equal(count_of(RECORD_STATE), 2);
	assert_int_equal(record_of(RECORD_STATE, 0)->nmt_state, NMT_PRE_OPERATIONAL);
	assert_int_equal(record_of(RECORD_STATE, 1)->nmt_state, NMT_OPERATIONAL);
	pass(2 * SECOND); /* 1017h is 1 s by default; three periods */
	assert_int_equal(count_of(RECORD_STATE), 2);
	pass(2 * SECOND);
	assert_int_equal(count_of(RECORD_STATE), 3);
	assert_int_equal(record_of(RECORD_STATE, 2)->nmt_state, WATCH_NMT_LOST);
	assert_in_range(record_of(RECORD_STATE, 2)->utc_us - UTC_OFFSET_US, 6 * SECOND, 6 * SECOND + 200 * MS);
}

static void test_each_emcy_is_told_as_it_was_sent(void **state)
{
	static const uint8_t FRAMES[][8] = {{0x32, 0x50, 0x81, 1, 2, 3, 4, 5}, {0, 0, 0, 0, 0, 0, 0, 0}};

	(void)state;
	frame(0x085, FRAMES[0], 8);
	frame(0x085, FRAMES[1], 8);
	assert_int_equal(count_of(RECORD_EMCY), 2);
	for (size_t i = 0; i < 2; i++)
		assert_memory_equal(record_of(RECORD_EMCY, i)->emcy, FRAMES[i], 8);
}

static void test_only_wanted_nodes_are_told_of(void **state)
{
	(void)state;
	b.config.tables[6] = NULL;
	for (unsigned sample = 0; sample < 10; sample++) {
		pdo(1, 5, 1, sample);
		pdo(1, 6, 1, sample);
		pass(30 * MS);
	}
	assert_int_equal(b.fleet.node_count, 1);
	assert_int_equal(count_of(RECORD_VALUES), 10);
}

static void test_frames_that_nobody_maps_are_ignored(void **state)
{
	static const uint8_t DATA[8] = {0};

	(void)state;
	for (uint32_t id = 0; id <= 0x7FF; id++)
		if ((id & 0x7F) == 0 || id >= 0x780 || (id > 0x600 && id < 0x700)) /* SYNC, NMT, SDO requests, LSS */
			frame(id, DATA, 8);
	pass(SECOND);
	assert_int_equal(b.count, 0);
	assert_int_equal(b.fleet.node_count, 0);
}

static void test_a_pdo_of_the_wrong_length_is_counted_and_not_decoded(void **state)
{
	static const uint8_t DATA[8] = {0};

	(void)state;
	frame(0x185, DATA, 7);
	pass(SECOND);
	assert_int_equal(count_of(RECORD_VALUES), 0);
	assert_int_equal(b.fleet.misfits, 1);
}

static void test_utc_is_written_as_iso_8601(void **state)
{
	char text[FORMAT_UTC_TEXT];

	(void)state;
	format_utc(INT64_C(1795953600000001), text); /* date -u -d @1795953600 */
	assert_string_equal(text, "2026-11-29T12:00:00.000001Z");
	format_utc(-1, text);
	assert_string_equal(text, "1969-12-31T23:59:59.999999Z");
	format_utc(INT64_MAX, text);
	assert_int_equal(strlen(text), FORMAT_UTC_TEXT - 1);
	format_utc(INT64_MIN, text);
	assert_int_equal(strlen(text), FORMAT_UTC_TEXT - 1);
}

static long remember(void *ctx, const struct message *message)
{
	struct message *last = ctx;

	*last = *message;
	return 1;
}

static void test_an_answer_that_is_no_json_object_is_not_published(void **state)
{
	const struct format_config config = {.prefix = "imu9", .bus = "can0", .tables = b.config.tables};
	struct message last = {0};
	const struct publisher to = {&last, remember};
	struct record record = {.kind = RECORD_ANSWER, .node_id = 5};
	static struct format json;

	(void)state;
	format_init(&json, &format_json, &config, 0);
	static const char *const DAMAGED[] = {
		"", "1", "\"object\"", "[1]", "{\"done\":", "{\"done\":true}}", "{\"object\":\"\xC3\x28\"}"};
	for (size_t i = 0; i < sizeof(DAMAGED) / sizeof(DAMAGED[0]); i++) {
		snprintf(record.text, sizeof(record.text), "%s", DAMAGED[i]);
		assert_int_equal(json.ops->record(&json, &to, &record, false), 0);
		assert_null(last.topic);
	}
	snprintf(record.text, sizeof(record.text), "{\"done\":true}\n");
	assert_int_equal(json.ops->record(&json, &to, &record, false), 1);
	assert_string_equal(last.topic, "imu9/can0/5/answer");
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_pdos_with_one_counter_are_one_sample_with_the_time_of_the_first),
		TEST(test_no_sample_is_lost_or_doubled_when_frames_of_two_interleave),
		TEST(test_two_records_of_a_sample_have_different_times),
		TEST(test_a_sample_that_is_sent_again_is_published_once),
		TEST(test_decimation_keeps_the_average_rate),
		TEST(test_with_a_threshold_only_changes_are_published_and_one_a_minute),
		TEST(test_each_change_of_the_state_is_told_and_a_lost_heartbeat_too),
		TEST(test_each_emcy_is_told_as_it_was_sent),
		TEST(test_only_wanted_nodes_are_told_of),
		TEST(test_frames_that_nobody_maps_are_ignored),
		TEST(test_a_pdo_of_the_wrong_length_is_counted_and_not_decoded),
		TEST(test_utc_is_written_as_iso_8601),
		TEST(test_an_answer_that_is_no_json_object_is_not_published),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* The lines of a recording: numbers read back to the same bits, damaged lines are refused. Its options. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <string.h>

#include "gateway/record_file.h"
#include "gateway/record_text.h"
#include "model/sim/rng.h"

static struct rng rng = {.state = {1, 2, 3, 4}};

static uint64_t random_bits(void)
{
	return rng_u64(&rng);
}

static double random_double(void)
{
	double value;

	do {
		uint64_t bits = random_bits();

		memcpy(&value, &bits, sizeof(value));
	} while (!isfinite(value));
	return value;
}

static struct vec3 random_vector(void)
{
	return (struct vec3){random_double(), random_double(), random_double()};
}

/* The line without its line break. */
static const char *text_of(const struct record_entry *e)
{
	static char text[RECORD_ROW_MAX];
	size_t n = record_text(e, text);

	assert_true(n < sizeof(text) && n == strlen(text) && text[n - 1] == '\n');
	text[n - 1] = '\0';
	return text;
}

static void assert_comes_back(const struct record_entry *e)
{
	struct record_entry again;

	assert_int_equal(record_parse(text_of(e), &again), 1);
	assert_int_equal(again.kind, e->kind);
	assert_memory_equal(text_of(&again), text_of(e), 1);
	assert_int_equal(again.now_us, e->now_us);
	assert_int_equal(again.value, e->value);
}

static void test_a_sample_comes_back_to_the_bit(void **state)
{
	(void)state;
	for (int i = 0; i < 20000; i++) {
		struct record_entry e, again;

		memset(&e, 0, sizeof(e));
		e.kind = RECORD_SAMPLE;
		e.now_us = random_bits() >> 12;
		e.sample.t_us = random_bits() >> 12;
		e.sample.flags = (unsigned)(random_bits() & 31);
		e.sample.gyro_rad_s = random_vector();
		e.sample.accel_m_s2 = random_vector();
		if (e.sample.flags & SAMPLE_MAG)
			e.sample.mag_uT = random_vector();
		if (e.sample.flags & SAMPLE_TEMPERATURE)
			e.sample.temperature_degC = random_double();
		if (e.sample.flags & SAMPLE_REFERENCE)
			e.sample.ref_accel_b_m_s2 = random_vector();
		assert_comes_back(&e);
		memset(&again, 0, sizeof(again));
		record_parse(text_of(&e), &again);
		assert_memory_equal(&again.sample, &e.sample, offsetof(struct imu_sample, flags));
		assert_int_equal(again.sample.flags, e.sample.flags);
	}
}

/* 16 digits of it would be 9.801060121277329. */
static void test_a_number_has_the_fewest_digits_that_come_back(void **state)
{
	struct record_entry e = {.kind = RECORD_SAMPLE, .sample.gyro_rad_s = {9.80106012127733, 0.1 + 0.2, -2}};

	(void)state;
	assert_string_equal(text_of(&e), "0.000000,9.80106012127733,0.30000000000000004,-2,0,0,0,,,,,,,,,0,0");
}

static void test_a_frame_comes_back(void **state)
{
	(void)state;
	for (int i = 0; i < 20000; i++) {
		struct record_entry e, again;
		uint64_t data = random_bits();

		memset(&e, 0, sizeof(e));
		e.kind = RECORD_FRAME;
		e.now_us = random_bits() >> 12;
		e.msg.extended = i % 3 == 0;
		e.msg.remote = i % 5 == 0;
		e.msg.id = (uint32_t)random_bits() & (e.msg.extended ? 0x1FFFFFFF : 0x7FF);
		e.msg.len = (uint8_t)(random_bits() % 9);
		if (!e.msg.remote)
			memcpy(e.msg.data, &data, e.msg.len);
		e.msg.t_us = i % 2 ? e.now_us : e.now_us - 17;
		assert_comes_back(&e);
		memset(&again, 0, sizeof(again));
		record_parse(text_of(&e), &again);
		assert_memory_equal(&again.msg, &e.msg, sizeof(e.msg));
	}
}

static void test_what_the_ports_show_comes_back(void **state)
{
	struct record_entry bus = {.kind = RECORD_BUS}, imu = {.kind = RECORD_IMU}, self = {.kind = RECORD_SELF}, again;

	(void)state;
	bus.bus = (struct record_bus){.counters = {1, 2, 3, 4, 5, 6, 4000000000u},
		.frames = 1ull << 40,
		.bytes = 1ull << 50,
		.queued = 128,
		.bit_s = 1000000,
		.state = CAN_STATE_BUS_OFF,
		.tx_errors = 255,
		.rx_errors = 127};
	assert_int_equal(record_parse(text_of(&bus), &again), 1);
	assert_memory_equal(&again.bus, &bus.bus, sizeof(bus.bus));
	imu.imu = (struct record_imu){.health = {1, 2, 3, 1, 0xF7, 4000000000u, 5, 6, 99.87654f},
		.counters = {7, 8, 9},
		.rate_hz = 99.123456789012345,
		.silence_us = 100000};
	assert_int_equal(record_parse(text_of(&imu), &again), 1);
	assert_memory_equal(&again.imu.counters, &imu.imu.counters, sizeof(imu.imu.counters));
	assert_true(again.imu.rate_hz == imu.imu.rate_hz && again.imu.health.rate_hz == imu.imu.health.rate_hz &&
		    again.imu.health.self_test == 0xF7 && again.imu.health.bus_errors == 4000000000u &&
		    again.imu.silence_us == 100000);
	self.self = (struct record_self){.lost = 12, .kept = 3, .state = RECORD_ENDED, .error = ENOSPC};
	assert_int_equal(record_parse(text_of(&self), &again), 1);
	assert_memory_equal(&again.self, &self.self, sizeof(self.self));
}

static void test_the_other_inputs_come_back(void **state)
{
	const struct record_entry entries[] = {
		{.kind = RECORD_START, .now_us = 5, .value = 1},
		{.kind = RECORD_FAILED, .now_us = 1ull << 52, .value = -5},
		{.kind = RECORD_CLOCK, .now_us = 7, .value = 1, .offset_us = -1790000000000000},
		{.kind = RECORD_SAVED, .now_us = 8, .value = -28},
		{.kind = RECORD_AWAY, .now_us = 9, .offset_us = 12345678},
		{.kind = RECORD_TICK, .now_us = 10},
		{.kind = RECORD_ANSWER, .value = -95},
		{.kind = RECORD_LOST, .value = 17},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(entries) / sizeof(entries[0]); i++) {
		struct record_entry again;

		assert_comes_back(&entries[i]);
		record_parse(text_of(&entries[i]), &again);
		if (entries[i].kind == RECORD_CLOCK || entries[i].kind == RECORD_AWAY)
			assert_int_equal(again.offset_us, entries[i].offset_us);
	}
}

static void test_a_damaged_line_is_refused(void **state)
{
	static const char *const lines[] = {"# tick", "# tick x", "# tick 5 6", "# rx 5", "# rx 5 181", "# rx 5 181#1",
		"# rx 5 181#0102030405060708FF", "# rx 5 181#00 z", "# bus 1 2 3", "# imu 1 2", "# recording 1",
		"# failed 5 0", "# answer", "1.5,1,2", "1.000000,1,2,3,4,5,6,,,,,,,,,5",
		"# bus 1 2 3 4 5 6 7 8 4 9 10 11 12 13x", "# bus 1 2 3 4 5 6 7 8 4 9 10 11 12 13 14",
		"# imu 1 2 3 4 5 6 7 8 9 10 11 1 2 5x", "# recording 1 2 3 4x", "1.000000,1,2,3,4,5,6,,,,,,,,,5,x",
		"1.000000,a,2,3,4,5,6,,,,,,,,,5,0",
		/* a time has six digits behind the point; what follows is not taken for a value */
		"1.0000005,1,2,3,4,5,6,,,,,,,,,5,0", "1.0000005,2,3,4,5,6,,,,,,,,,5,0", "1.5;2,3,4,5,6,,,,,,,,,5,0"};
	struct record_entry e;

	(void)state;
	for (size_t i = 0; i < sizeof(lines) / sizeof(lines[0]); i++)
		if (record_parse(lines[i], &e) != -EBADMSG)
			fail_msg("accepted: %s", lines[i]);
}

static void test_other_comments_are_passed_over(void **state)
{
	struct record_entry e;

	(void)state;
	assert_int_equal(record_parse("# a note of the user", &e), 0);
	assert_int_equal(record_parse("# ticks 5", &e), 0);
	assert_int_equal(record_parse("", &e), 0);
	assert_int_equal(record_parse(RECORD_COLUMNS, &e), 0);
}

/* RFC 4648, section 10. */
static void test_bytes_are_base64(void **state)
{
	static const char *const vectors[][2] = {{"", ""}, {"f", "Zg=="}, {"fo", "Zm8="}, {"foo", "Zm9v"},
		{"foob", "Zm9vYg=="}, {"fooba", "Zm9vYmE="}, {"foobar", "Zm9vYmFy"}};
	uint8_t bytes[8];
	char text[16];

	(void)state;
	for (size_t i = 0; i < sizeof(vectors) / sizeof(vectors[0]); i++) {
		size_t size = strlen(vectors[i][0]);

		record_base64((const uint8_t *)vectors[i][0], size, text);
		assert_string_equal(text, vectors[i][1]);
		assert_int_equal(record_from_base64(text, strlen(text), bytes), size);
		assert_memory_equal(bytes, vectors[i][0], size);
	}
	assert_int_equal(record_from_base64("Zm9", 3, bytes), -EBADMSG);
	assert_int_equal(record_from_base64("Zm-v", 4, bytes), -EBADMSG);
}

static void test_options_have_their_limits(void **state)
{
	static const char *const wrong[] = {"", ",size=1", "/x,size=0", "/x,size=2001", "/x,files=1", "/x,files=1001",
		"/x,size=", "/x,size=1k", "/x,loop", "/x,files=-3"};
	struct record_options o;
	char why[200];

	(void)state;
	assert_int_equal(record_options("/var/rec", &o, why, sizeof(why)), 0);
	assert_string_equal(o.folder, "/var/rec");
	assert_true(o.size_mb == 16 && o.files == 8);
	assert_int_equal(record_options("rec,files=1000,size=2000", &o, why, sizeof(why)), 0);
	assert_true(o.size_mb == 2000 && o.files == 1000);
	for (size_t i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++)
		assert_int_equal(record_options(wrong[i], &o, why, sizeof(why)), -EINVAL);
	assert_non_null(strstr(why, "'files=-3'"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_sample_comes_back_to_the_bit),
		cmocka_unit_test(test_a_number_has_the_fewest_digits_that_come_back),
		cmocka_unit_test(test_a_frame_comes_back),
		cmocka_unit_test(test_what_the_ports_show_comes_back),
		cmocka_unit_test(test_the_other_inputs_come_back),
		cmocka_unit_test(test_a_damaged_line_is_refused),
		cmocka_unit_test(test_other_comments_are_passed_over),
		cmocka_unit_test(test_bytes_are_base64),
		cmocka_unit_test(test_options_have_their_limits),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Bit timing, protocol and clock of gs_usb adapters. Oracles: the bytes that candleLight adapters send, the bit timings
 * of CiA 301, and what `ip -details link show` prints for the kernel's gs_usb driver. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "drivers/can/error_frame.h"
#include "drivers/can/gs_usb_codec.h"
#include "drivers/can/gs_usb_find.h"
#include "drivers/can/id_filter.h"
#include "tests/unit/descriptors.h"

/* bxCAN at 48 MHz: the candleLight, and most others */
static const struct can_link_limits candlelight = {48000000, 1, 1024, 1, 1, 16, 1, 8};

static struct bit_timing timing_of(const struct can_link_limits *limits, uint32_t bit_s)
{
	struct bit_timing timing = {0};

	assert_int_equal(bit_timing_find(limits, 4, bit_s, bit_timing_sample_point(bit_s), &timing), 0);
	return timing;
}

static uint32_t quanta(const struct bit_timing *t)
{
	return 1 + t->prop + t->seg1 + t->seg2;
}

/* ---- bit timing ---- */

static void test_500_kbit_s_is_what_the_kernel_sets(void **state)
{
	struct bit_timing t = timing_of(&candlelight, 500000);

	(void)state; /* tq 125 prop-seg 6 phase-seg1 7 phase-seg2 2 sjw 1 brp 6 */
	assert_int_equal(t.prop, 6);
	assert_int_equal(t.seg1, 7);
	assert_int_equal(t.seg2, 2);
	assert_int_equal(t.sjw, 1);
	assert_int_equal(t.brp, 6);
}

static void test_every_bit_rate_of_cia_301_is_exact_at_48_mhz(void **state)
{
	static const uint32_t rates[] = {10000, 20000, 50000, 125000, 250000, 500000, 800000, 1000000};

	(void)state;
	for (size_t i = 0; i < sizeof(rates) / sizeof(rates[0]); i++) {
		struct bit_timing t = timing_of(&candlelight, rates[i]);

		assert_int_equal(quanta(&t) * t.brp * rates[i], 48000000);
	}
}

static void test_sample_points_are_those_of_cia_301(void **state)
{
	static const struct {
		uint32_t bit_s, permille;
	} table[] = {{1000000, 750}, {800000, 800}, {500000, 875}, {250000, 875}, {125000, 875}, {50000, 875},
		{20000, 875}, {10000, 875}};

	(void)state;
	for (size_t i = 0; i < sizeof(table) / sizeof(table[0]); i++) {
		struct bit_timing t = timing_of(&candlelight, table[i].bit_s);

		assert_int_equal((quanta(&t) - t.seg2) * 1000 / quanta(&t), table[i].permille);
	}
}

static void test_the_sample_point_depends_on_the_bit_rate_as_in_the_kernel(void **state)
{
	(void)state;
	assert_int_equal(bit_timing_sample_point(10000), 875);
	assert_int_equal(bit_timing_sample_point(500000), 875);
	assert_int_equal(bit_timing_sample_point(500001), 800);
	assert_int_equal(bit_timing_sample_point(800000), 800);
	assert_int_equal(bit_timing_sample_point(800001), 750);
	assert_int_equal(bit_timing_sample_point(1000000), 750);
}

static void assert_timing(
	const struct can_link_limits *limits, uint32_t bit_s, uint32_t permille, const struct bit_timing *expected)
{
	struct bit_timing t = {0};

	assert_int_equal(bit_timing_find(limits, 4, bit_s, permille, &t), 0);
	assert_int_equal(t.prop, expected->prop);
	assert_int_equal(t.seg1, expected->seg1);
	assert_int_equal(t.seg2, expected->seg2);
	assert_int_equal(t.sjw, expected->sjw);
	assert_int_equal(t.brp, expected->brp);
}

/* Worked out by hand: 48 MHz / (brp * quanta) is the bit rate, 1 - seg2 / quanta the sample point. */
static void test_a_timing_has_the_sample_point_asked_for(void **state)
{
	(void)state;
	/* 1 Mbit/s, 75 %: 3 * 16 quanta, 12 of them before the sample point */
	assert_timing(&candlelight, 1000000, 750, &(struct bit_timing){5, 6, 4, 2, 3});
	/* 800 kbit/s, 80 %: 3 * 20 and 4 * 15 quanta are exact; the first has more */
	assert_timing(&candlelight, 800000, 800, &(struct bit_timing){7, 8, 4, 2, 3});
	/* 500 kbit/s, 80 %: no number of quanta is exact; 13 of 16 are 81.25 % */
	assert_timing(&candlelight, 500000, 800, &(struct bit_timing){6, 6, 3, 1, 6});
	/* 500 kbit/s, 50 %: 8 of 16 */
	assert_timing(&candlelight, 500000, 500, &(struct bit_timing){3, 4, 8, 4, 6});
}

/* 8 quanta, of which the sample point asked for would leave too many before it, or too few. */
static void test_the_segments_keep_to_their_limits(void **state)
{
	static const struct can_link_limits late = {8000000, 1, 1, 0, 1, 4, 1, 8},
					    early = {8000000, 1, 1, 0, 3, 16, 1, 8};

	(void)state;
	assert_timing(&late, 1000000, 875, &(struct bit_timing){2, 2, 3, 1, 1});
	assert_timing(&early, 1000000, 100, &(struct bit_timing){1, 2, 4, 2, 1});
}

/* 12 quanta at 87.5 %: 10 of them are 83.3 %, 11 are 91.7 %, both as far off. */
static void test_between_two_sample_points_the_earlier_one_is_chosen(void **state)
{
	static const struct can_link_limits twelve = {6000000, 1, 1, 1, 1, 16, 1, 8};

	(void)state;
	assert_timing(&twelve, 500000, 875, &(struct bit_timing){4, 5, 2, 1, 1});
}

static void test_the_jump_width_is_half_of_the_last_segment_within_what_the_controller_can(void **state)
{
	static const struct {
		uint32_t sjw_max, sjw;
	} cases[] = {{4, 4}, {3, 3}, {1, 1}, {0, 1}, {100, 4}};
	struct bit_timing t;

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		assert_int_equal(bit_timing_find(&candlelight, cases[i].sjw_max, 500000, 500, &t), 0);
		assert_int_equal(t.seg2, 8);
		assert_int_equal(t.sjw, cases[i].sjw);
	}
}

static void test_the_prescaler_keeps_to_its_bounds(void **state)
{
	static const struct can_link_limits l = {16000000, 2, 4, 2, 1, 16, 1, 8};
	struct bit_timing t;

	(void)state;
	/* 2 * 8 and 4 * 4 quanta give 1 Mbit/s; 2 and 4 only, so 160 kbit/s (4 * 25) is the slowest */
	assert_timing(&l, 1000000, 750, &(struct bit_timing){2, 3, 2, 1, 2});
	assert_int_equal(bit_timing_find(&l, 4, 160000, 700, &t), 0);
	assert_int_equal(t.brp, 4);
	assert_int_equal(bit_timing_find(&l, 4, 150000, 700, &t), -EOPNOTSUPP);
	assert_int_equal(bit_timing_find(&l, 4, 500000, 1000, &t), -EOPNOTSUPP);
}

static void test_a_clock_that_does_not_divide_gives_the_nearest_bit_rate(void **state)
{
	static const struct can_link_limits sja1000 = {8000000, 1, 64, 1, 1, 16, 1, 8};
	struct bit_timing t = timing_of(&sja1000, 83333);

	(void)state; /* 8 MHz / 96 = 83333.3 bit/s */
	assert_int_equal(quanta(&t) * t.brp, 96);
}

static void test_a_bit_rate_that_cannot_be_reached_is_refused(void **state)
{
	struct bit_timing t;

	(void)state;
	assert_int_equal(bit_timing_find(&candlelight, 4, 1000, 875, &t), -EOPNOTSUPP);
	assert_int_equal(bit_timing_find(&candlelight, 4, 20000000, 875, &t), -EOPNOTSUPP);
	assert_int_equal(bit_timing_find(&candlelight, 4, 0, 875, &t), -EOPNOTSUPP);
}

static void test_more_than_half_a_percent_off_is_refused(void **state)
{
	static const struct can_link_limits coarse = {8000000, 1, 64, 1, 1, 16, 1, 8};
	struct bit_timing t;

	(void)state; /* 8 MHz / 8 = 1 Mbit/s, / 9 = 889 kbit/s */
	assert_int_equal(bit_timing_find(&coarse, 4, 950000, 875, &t), -EOPNOTSUPP);
	assert_int_equal(bit_timing_find(&coarse, 4, 1004900, 750, &t), 0);
	assert_int_equal(bit_timing_find(&coarse, 4, 1005500, 750, &t), -EOPNOTSUPP);
}

/* Oracle: all combinations of prescaler and segments. */
static void test_no_other_setting_is_nearer(void **state)
{
	static const struct can_link_limits odd = {36000000, 2, 96, 2, 3, 13, 2, 5};
	struct bit_timing t;

	(void)state;
	for (uint32_t bit_s = 30000; bit_s <= 1000000; bit_s += 30000) {
		if (bit_timing_find(&odd, 2, bit_s, 800, &t) < 0)
			continue;
		uint64_t off = (uint64_t)llabs((long long)quanta(&t) * t.brp * bit_s - 36000000);
		double point = 1 - (double)t.seg2 / quanta(&t);

		assert_in_range(t.prop + t.seg1, 3, 13);
		assert_in_range(t.seg2, 2, 5);
		assert_int_equal(t.brp % 2, 0);
		for (uint32_t brp = 2; brp <= 96; brp += 2)
			for (uint32_t one = 3; one <= 13; one++)
				for (uint32_t two = 2; two <= 5; two++) {
					uint32_t n = 1 + one + two;
					uint64_t other = (uint64_t)llabs((long long)n * brp * bit_s - 36000000);
					double other_point = 1 - (double)two / n;

					assert_true(other >= off);
					if (other == off)
						assert_true(fabs(other_point - 0.8) >= fabs(point - 0.8) - 1e-5);
				}
	}
}

/* ---- the bytes ---- */

static void test_a_frame_is_packed_as_the_adapter_expects_it(void **state)
{
	static const uint8_t expected[GS_USB_FRAME_LEN] = {7, 0, 0, 0, 0x81, 1, 0, 0, 3, 2, 0, 0, 0xAA, 0xBB, 0xCC};
	const struct can_msg msg = {.id = 0x181, .len = 3, .data = {0xAA, 0xBB, 0xCC, 0xDD}};
	uint8_t bytes[GS_USB_FRAME_LEN];

	(void)state;
	gs_usb_put_frame(&msg, 7, 2, bytes);
	assert_memory_equal(bytes, expected, sizeof(expected));
}

static void test_extended_and_remote_are_flags_of_the_identifier(void **state)
{
	const struct can_msg msg = {.id = 0x12345678, .extended = true, .remote = true, .len = 4};
	uint8_t bytes[GS_USB_FRAME_LEN];

	(void)state;
	gs_usb_put_frame(&msg, 0, 0, bytes);
	assert_memory_equal(bytes + 4, "\x78\x56\x34\xD2\x04", 5);
}

static void test_requests_are_packed_little_endian(void **state)
{
	const struct bit_timing timing = {6, 7, 2, 1, 0x103};
	uint8_t bytes[GS_USB_BIT_TIMING_LEN];

	(void)state;
	gs_usb_put_host_format(bytes);
	assert_memory_equal(bytes, "\xEF\xBE\0\0", 4);
	gs_usb_put_mode(GS_USB_MODE_START, GS_USB_FEATURE_TIMESTAMP, bytes);
	assert_memory_equal(bytes, "\1\0\0\0\x10\0\0\0", 8);
	gs_usb_put_bit_timing(&timing, bytes);
	assert_memory_equal(bytes, "\6\0\0\0\7\0\0\0\2\0\0\0\1\0\0\0\3\1\0\0", 20);
}

static const uint8_t received[GS_USB_FRAME_STAMPED_LEN] = {
	0xFF, 0xFF, 0xFF, 0xFF, 0x01, 0x06, 0, 0, 2, 1, 0, 0, 0x11, 0x22, 0, 0, 0, 0, 0, 0, 0x78, 0x56, 0x34, 0x12};

static void test_a_received_frame_is_unpacked(void **state)
{
	struct gs_usb_frame frame;

	(void)state;
	assert_int_equal(gs_usb_get_frame(received, sizeof(received), true, &frame), 0);
	assert_int_equal(frame.kind, GS_USB_RECEIVED);
	assert_int_equal(frame.channel, 1);
	assert_int_equal(frame.msg.id, 0x601);
	assert_false(frame.msg.extended || frame.msg.remote || frame.overflow);
	assert_int_equal(frame.msg.len, 2);
	assert_memory_equal(frame.msg.data, "\x11\x22\0\0\0\0\0\0", 8);
	assert_true(frame.stamped);
	assert_int_equal(frame.stamp_us, 0x12345678);
}

/* 31 and 30 of the identifier: extended and remote; a standard one has 11 bits. A remote frame has a length and no
 * data. */
static void test_the_flags_of_a_received_identifier_are_unpacked(void **state)
{
	static const struct {
		uint8_t bytes[4];
		uint32_t id;
		bool extended, remote;
	} frames[] = {{{0x78, 0x56, 0x34, 0x92}, 0x12345678, true, false},
		{{0x78, 0x56, 0x34, 0x52}, 0x678, false, true}, {{0xFF, 0xFF, 0xFF, 0xDF}, 0x1FFFFFFF, true, true}};
	uint8_t bytes[GS_USB_FRAME_LEN];
	struct gs_usb_frame frame;

	(void)state;
	memcpy(bytes, received, sizeof(bytes));
	bytes[10] = 1; /* the adapter has lost frames */
	for (size_t i = 0; i < 3; i++) {
		memcpy(bytes + 4, frames[i].bytes, 4);
		assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), 0);
		assert_int_equal(frame.kind, GS_USB_RECEIVED);
		assert_int_equal(frame.msg.id, frames[i].id);
		assert_int_equal(frame.msg.extended, frames[i].extended);
		assert_int_equal(frame.msg.remote, frames[i].remote);
		assert_int_equal(frame.msg.len, 2);
		assert_int_equal(frame.msg.data[0], frames[i].remote ? 0 : 0x11);
		assert_true(frame.overflow);
	}
	bytes[7] = 0x20;
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), 0);
	assert_int_equal(frame.kind, GS_USB_ERROR);
	bytes[8] = 8;
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), 0);
	bytes[0] = GS_USB_SLOTS - 1; /* the last slot */
	bytes[1] = bytes[2] = bytes[3] = 0;
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), 0);
}

static void test_without_time_stamps_the_last_four_bytes_are_padding(void **state)
{
	struct gs_usb_frame frame;

	(void)state;
	assert_int_equal(gs_usb_get_frame(received, sizeof(received), false, &frame), 0);
	assert_false(frame.stamped);
	assert_int_equal(gs_usb_get_frame(received, GS_USB_FRAME_LEN, true, &frame), 0);
	assert_false(frame.stamped);
}

static void test_an_echo_names_its_slot(void **state)
{
	uint8_t bytes[GS_USB_FRAME_LEN] = {9, 0, 0, 0, 0x81, 1};
	struct gs_usb_frame frame;

	(void)state;
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), 0);
	assert_int_equal(frame.kind, GS_USB_ECHO);
	assert_int_equal(frame.slot, 9);
}

static void test_packets_that_are_not_frames_are_refused(void **state)
{
	uint8_t bytes[GS_USB_FRAME_STAMPED_LEN];
	struct gs_usb_frame frame;

	(void)state;
	assert_int_equal(gs_usb_get_frame(received, GS_USB_FRAME_LEN - 1, false, &frame), -EBADMSG);
	assert_int_equal(gs_usb_get_frame(received, 0, false, &frame), -EBADMSG);
	memcpy(bytes, received, sizeof(bytes));
	bytes[8] = 9; /* DLC */
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), -EBADMSG);
	bytes[8] = 8;
	bytes[10] = 2; /* CAN FD */
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), -ENOTSUP);
	bytes[0] = GS_USB_SLOTS; /* an echo of a slot that does not exist */
	bytes[1] = bytes[2] = bytes[3] = 0;
	assert_int_equal(gs_usb_get_frame(bytes, sizeof(bytes), false, &frame), -EBADMSG);
}

static const uint8_t bt_const[GS_USB_LIMITS_LEN] = {0x3B, 0, 0, 0, 0, 0x6C, 0xDC, 2, 1, 0, 0, 0, 16, 0, 0, 0, 1, 0, 0,
	0, 8, 0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 0, 4, 0, 0, 1, 0, 0, 0};

static void test_the_limits_of_a_candlelight_are_unpacked(void **state)
{
	struct gs_usb_limits limits;

	(void)state;
	assert_int_equal(gs_usb_get_limits(bt_const, sizeof(bt_const), &limits), 0);
	assert_int_equal(limits.features, 0x3B);
	assert_int_equal(limits.sjw_max, 4);
	assert_memory_equal(&limits.timing, &candlelight, sizeof(candlelight));
}

static void test_limits_that_no_controller_can_have_are_refused(void **state)
{
	struct gs_usb_limits limits;
	uint8_t bytes[GS_USB_LIMITS_LEN];

	(void)state;
	assert_int_equal(gs_usb_get_limits(bt_const, GS_USB_LIMITS_LEN - 1, &limits), -EBADMSG);
	for (size_t at = 4; at < 24; at += 4) { /* clock and segments: zero */
		memcpy(bytes, bt_const, sizeof(bytes));
		memset(bytes + at, 0, 4);
		assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), -EBADMSG);
	}
	memcpy(bytes, bt_const, sizeof(bytes));
	for (int i = 0; i < 2; i++) { /* no more than 4096 quanta, and prescalers up to 65536 */
		const bool beyond = i == 1;

		memcpy(bytes, bt_const, sizeof(bytes));
		memcpy(bytes + 12, beyond ? "\1\x10\0" : "\0\x10\0", 3);
		assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), beyond ? -EBADMSG : 0);
		memcpy(bytes, bt_const, sizeof(bytes));
		memcpy(bytes + 20, beyond ? "\1\x10\0" : "\0\x10\0", 3);
		assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), beyond ? -EBADMSG : 0);
		memcpy(bytes, bt_const, sizeof(bytes));
		memcpy(bytes + 32, beyond ? "\1\0\1" : "\0\0\1", 3);
		assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), beyond ? -EBADMSG : 0);
	}
	memset(bytes + 28, 0, 4); /* a prescaler of 0 */
	bytes[32] = 1;
	assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), -EBADMSG);
	bytes[28] = 2; /* the least above the greatest */
	bytes[32] = 1, bytes[34] = 0;
	assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), -EBADMSG);
	bytes[28] = 1; /* one alone */
	assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), 0);
	memset(bytes + 32, 0xFF, 4); /* 2^32 - 1 prescalers */
	assert_int_equal(gs_usb_get_limits(bytes, sizeof(bytes), &limits), -EBADMSG);
}

static void test_the_number_of_channels_is_one_more_than_the_adapter_says(void **state)
{
	static const uint8_t config[GS_USB_CONFIG_LEN] = {0, 0, 0, 1, 2, 0, 0, 0, 1, 0, 0, 0};

	(void)state;
	assert_int_equal(gs_usb_get_channels(config, sizeof(config)), 2);
	assert_int_equal(gs_usb_get_channels(config, 11), -EBADMSG);
}

/* ---- error frames ---- */

static struct can_port after_error(enum can_state before, uint32_t can_id, uint8_t controller)
{
	struct can_port port = {.state = before};
	const uint8_t data[8] = {0, controller, 0, 0, 0, 0, 130, 7};

	can_error_frame(&port, can_id, data);
	assert_int_equal(port.counters.errors, 1);
	return port;
}

static void test_error_frames_report_the_state_of_the_bus(void **state)
{
	(void)state;
	assert_int_equal(after_error(CAN_STATE_ACTIVE, 0x20000004, 0x08).state, CAN_STATE_WARNING);
	assert_int_equal(after_error(CAN_STATE_ACTIVE, 0x20000004, 0x04).state, CAN_STATE_WARNING);
	assert_int_equal(after_error(CAN_STATE_WARNING, 0x20000004, 0x20).state, CAN_STATE_PASSIVE);
	assert_int_equal(after_error(CAN_STATE_WARNING, 0x20000004, 0x10).state, CAN_STATE_PASSIVE);
	assert_int_equal(after_error(CAN_STATE_PASSIVE, 0x20000004, 0x40).state, CAN_STATE_ACTIVE);
	assert_int_equal(after_error(CAN_STATE_PASSIVE, 0x20000004, 0).state, CAN_STATE_ACTIVE);
	assert_int_equal(after_error(CAN_STATE_BUS_OFF, 0x20000100, 0).state, CAN_STATE_ACTIVE);
	assert_int_equal(after_error(CAN_STATE_PASSIVE, 0x20000040, 0).state, CAN_STATE_BUS_OFF);
}

static void test_a_missing_acknowledge_alone_changes_no_state(void **state)
{
	(void)state;
	const struct can_port port =
		after_error(CAN_STATE_WARNING, 0x200001BB, 0); /* all but a controller's and bus-off */

	assert_int_equal(after_error(CAN_STATE_WARNING, 0x20000020, 0).state, CAN_STATE_WARNING);
	assert_int_equal(port.tx_errors, 0);
	assert_int_equal(port.rx_errors, 0);
}

static void test_error_frames_contain_the_error_counters(void **state)
{
	struct can_port port = after_error(CAN_STATE_ACTIVE, 0x20000004, 0x20);

	(void)state;
	assert_int_equal(port.tx_errors, 130);
	assert_int_equal(port.rx_errors, 7);
	assert_int_equal(port.counters.rx_dropped, 0);
	port = after_error(CAN_STATE_ACTIVE, 0x20000200, 0); /* CAN_ERR_CNT */
	assert_int_equal(port.tx_errors, 130);
	assert_int_equal(port.rx_errors, 7);
}

static void test_going_bus_off_is_counted_once(void **state)
{
	struct can_port port = after_error(CAN_STATE_PASSIVE, 0x20000040, 0);

	(void)state;
	assert_int_equal(port.counters.bus_off, 1);
	can_error_frame(&port, 0x20000040, (const uint8_t[8]){0});
	can_error_frame(&port, 0x20000044, (const uint8_t[8]){0});
	assert_int_equal(port.counters.bus_off, 1);
}

static void test_an_overflow_counts_as_a_lost_frame(void **state)
{
	struct can_port port = after_error(CAN_STATE_PASSIVE, 0x20000004, 0x01);

	(void)state;
	assert_int_equal(port.counters.rx_dropped, 1);
	assert_int_equal(port.state, CAN_STATE_PASSIVE);
}

/* ---- the clock ---- */

static void test_a_frame_read_late_has_the_time_it_was_on_the_bus(void **state)
{
	struct gs_usb_clock clock = {0};

	(void)state;
	assert_int_equal(gs_usb_clock_map(&clock, 5000, 1000000), 1000000);
	assert_int_equal(gs_usb_clock_map(&clock, 7000, 1004000), 1002000); /* 2 ms late */
}

static void test_no_time_of_a_frame_is_in_the_future(void **state)
{
	struct gs_usb_clock clock = {0};

	(void)state;
	gs_usb_clock_map(&clock, 5000, 1000000); /* itself 300 us late */
	assert_int_equal(gs_usb_clock_map(&clock, 7300, 1002000), 1002000);
	assert_int_equal(gs_usb_clock_map(&clock, 9300, 1004500), 1004000);
}

static void test_the_clock_of_the_adapter_may_wrap(void **state)
{
	struct gs_usb_clock clock = {0};

	(void)state;
	gs_usb_clock_map(&clock, UINT32_MAX - 999, 1000000);
	assert_int_equal(gs_usb_clock_map(&clock, 1000, 1002500), 1002000);
}

static void test_a_frame_may_be_ten_seconds_late(void **state)
{
	struct gs_usb_clock clock = {0};

	(void)state;
	gs_usb_clock_map(&clock, 5000, 1000000);
	/* 200 ppm of 10.00 s: it may have crept by 2 ms */
	assert_int_equal(gs_usb_clock_map(&clock, 6000, 11002000), 1001000 + 10002000 / 5000);
	clock = (struct gs_usb_clock){0};
	gs_usb_clock_map(&clock, 5000, 1000000);
	assert_int_equal(gs_usb_clock_map(&clock, 6000, 11005000), 11005000);
}

/* An hour at 1 kHz with a crystal error: the error of the times stays within the jitter of the transport. */
static void follow(int32_t ppm)
{
	struct gs_usb_clock clock = {0};
	uint64_t worst_us = 0;

	for (uint64_t t = 0; t < UINT64_C(3600000000); t += 1000) {
		uint32_t stamp = (uint32_t)(t + (uint64_t)((int64_t)t * ppm / 1000000));
		uint64_t now = 1000000 + t + (t / 1000 * 7919 % 400); /* 0 to 399 us late */
		uint64_t mapped = gs_usb_clock_map(&clock, stamp, now);

		if (t > 10000000) {
			uint64_t off = mapped > 1000000 + t ? mapped - 1000000 - t : 1000000 + t - mapped;

			worst_us = off > worst_us ? off : worst_us;
		}
	}
	assert_in_range(worst_us, 0, 100);
}

static void test_a_fast_crystal_is_followed(void **state)
{
	(void)state;
	follow(100);
}

static void test_a_slow_crystal_is_followed(void **state)
{
	(void)state;
	follow(-100);
}

static void test_after_a_reset_of_the_adapter_the_clock_is_initialised_again(void **state)
{
	struct gs_usb_clock clock = {0};

	(void)state;
	gs_usb_clock_map(&clock, 900000000, 1000000000);
	assert_int_equal(gs_usb_clock_map(&clock, 100, 1000500000), 1000500000);
	assert_int_equal(gs_usb_clock_map(&clock, 1100, 1000502000), 1000501000);
}

/* ---- the filter ---- */

static void test_a_filter_passes_the_wanted_identifiers_only(void **state)
{
	struct id_filter filter = {0};
	struct can_msg msg = {.id = 0x605};

	(void)state;
	assert_true(id_filter_wants(&filter, &msg));
	id_filter_set(&filter, (const uint32_t[]){0x000, 0x605, 0x7FF}, 3);
	assert_true(id_filter_wants(&filter, &msg));
	msg.id = 0x604;
	assert_false(id_filter_wants(&filter, &msg));
	msg = (struct can_msg){.id = 0x605, .extended = true};
	assert_false(id_filter_wants(&filter, &msg));
	id_filter_set(&filter, NULL, 0);
	assert_true(id_filter_wants(&filter, &msg));
}

/* ---- finding adapters ---- */

static void put_file(const char *folder, const char *name, const char *text)
{
	char path[200];
	FILE *f;

	snprintf(path, sizeof(path), "%s/%s", folder, name);
	f = fopen(path, "w");
	assert_non_null(f);
	fprintf(f, "%s\n", text);
	fclose(f);
}

/* A device as sysfs shows it, in a folder of that name below `root`. */
static void put_device(const char *root, const char *place, const char *vendor, const char *product, const char *serial)
{
	char folder[100];

	snprintf(folder, sizeof(folder), "%s/%s", root, place);
	assert_int_equal(mkdir(folder, 0700), 0);
	put_file(folder, "idVendor", vendor);
	put_file(folder, "idProduct", product);
	put_file(folder, "busnum", "10");
	put_file(folder, "devnum", "12");
	put_file(folder, "product", "candleLight");
	if (serial[0])
		put_file(folder, "serial", serial);
}

static void test_adapters_are_found_among_the_usb_devices_of_sysfs(void **state)
{
	char root[] = "/tmp/imu9-sysfs.XXXXXX", command[100];
	struct gs_usb_adapter list[GS_USB_ADAPTERS];

	(void)state;
	assert_non_null(mkdtemp(root));
	put_device(root, "3-2", "1d50", "606f", "");
	put_device(root, "3-1", "1209", "2323", "0042");
	put_device(root, "usb3", "1d6b", "0002", "dummy");
	put_device(root, "3-4", "1d50", "6018", "not this one");
	put_device(root, "3-1:1.0", "1d50", "606f", "an interface");
	put_file(root, "notes", "a file is no device");
	put_device(root, "3-5", "1d50", "606f", "without a number");
	snprintf(command, sizeof(command), "%s/3-5/devnum", root);
	assert_int_equal(truncate(command, 0), 0);
	assert_int_equal(gs_usb_list(root, list), 2);
	assert_string_equal(list[0].place, "3-1");
	assert_string_equal(list[0].serial, "0042");
	assert_string_equal(list[0].node, "/dev/bus/usb/010/012");
	assert_string_equal(list[0].product, "candleLight");
	assert_string_equal(list[1].place, "3-2");
	assert_string_equal(list[1].serial, "");
	assert_int_equal(gs_usb_list("/no/such/folder", list), 0);
	snprintf(command, sizeof(command), "rm -r %s", root);
	assert_int_equal(system(command), 0);
}

static void test_control_codes_of_a_device_do_not_reach_the_terminal(void **state)
{
	char root[] = "/tmp/imu9-sysfs.XXXXXX", command[100];
	struct gs_usb_adapter list[GS_USB_ADAPTERS];

	(void)state;
	assert_non_null(mkdtemp(root));
	put_device(root, "3-1", "1209", "2323", "\x1B[2J42");
	assert_int_equal(gs_usb_list(root, list), 1);
	assert_string_equal(list[0].serial, "?[2J42");
	snprintf(command, sizeof(command), "rm -r %s", root);
	assert_int_equal(system(command), 0);
}

static const struct gs_usb_adapter two[] = {
	{"3-1", "0042", "candleLight", "/dev/bus/usb/003/012"}, {"3-2", "0043", "CANable", "/dev/bus/usb/003/013"}};

static int choose(const struct gs_usb_adapter *list, size_t n, const char *wanted, const char *place, const char *words)
{
	struct gs_usb_adapter found = {.place = ""};
	char error[300] = "";
	int result = gs_usb_choose(list, n, wanted, &found, error, sizeof(error));

	assert_string_equal(found.place, place);
	assert_non_null(strstr(error, words));
	return result;
}

static void test_an_adapter_is_chosen_by_serial_number_or_place(void **state)
{
	(void)state;
	assert_int_equal(choose(two, 2, "0043", "3-2", ""), 0);
	assert_int_equal(choose(two, 2, "3-1", "3-1", ""), 0);
	assert_int_equal(choose(two, 1, "", "3-1", ""), 0);
}

static void test_when_no_adapter_or_several_match_they_are_listed(void **state)
{
	struct gs_usb_adapter alike[2] = {two[0], two[1]};

	(void)state;
	assert_int_equal(
		choose(two, 2, "", "", "gs_usb:0042 (candleLight at 3-1), gs_usb:0043 (CANable at 3-2)"), -ENOTUNIQ);
	assert_int_equal(choose(two, 2, "0044", "", "'0044': use one of gs_usb:0042"), -ENODEV);
	assert_int_equal(choose(two, 0, "", "", "no gs_usb adapter"), -ENODEV);
	assert_int_equal(choose(two, 1, "0043", "", "'0043': use one of gs_usb:0042 (candleLight at 3-1)"), -ENODEV);
	strcpy(alike[1].serial, "0042");
	assert_int_equal(choose(alike, 2, "0042", "", "several"), -ENOTUNIQ);
	assert_int_equal(choose(alike, 2, "3-2", "3-2", ""), 0);
}

static void test_the_udev_rule_contains_every_usb_id_that_is_known(void **state)
{
	char root[] = "/tmp/imu9-sysfs.XXXXXX", line[300], vendor[5], product[5], place[16], command[100];
	struct gs_usb_adapter list[GS_USB_ADAPTERS];
	FILE *rule = fopen("tools/service/70-imu9-gateway.rules", "r");
	size_t named = 0;

	(void)state;
	if (rule == NULL)
		skip(); /* not run from the top folder */
	assert_non_null(mkdtemp(root));
	while (fgets(line, sizeof(line), rule))
		if (sscanf(line, "ATTR{idVendor}==\"%4[0-9a-f]\", ATTR{idProduct}==\"%4[0-9a-f]\"", vendor, product) ==
			2) {
			snprintf(place, sizeof(place), "1-%zu", named++);
			put_device(root, place, vendor, product, "");
		}
	fclose(rule);
	assert_int_equal(named, 6);
	assert_int_equal(gs_usb_list(root, list), named);
	snprintf(command, sizeof(command), "rm -r %s", root);
	assert_int_equal(system(command), 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_500_kbit_s_is_what_the_kernel_sets),
		cmocka_unit_test(test_every_bit_rate_of_cia_301_is_exact_at_48_mhz),
		cmocka_unit_test(test_sample_points_are_those_of_cia_301),
		cmocka_unit_test(test_the_sample_point_depends_on_the_bit_rate_as_in_the_kernel),
		cmocka_unit_test(test_a_timing_has_the_sample_point_asked_for),
		cmocka_unit_test(test_the_segments_keep_to_their_limits),
		cmocka_unit_test(test_between_two_sample_points_the_earlier_one_is_chosen),
		cmocka_unit_test(test_the_jump_width_is_half_of_the_last_segment_within_what_the_controller_can),
		cmocka_unit_test(test_the_prescaler_keeps_to_its_bounds),
		cmocka_unit_test(test_a_clock_that_does_not_divide_gives_the_nearest_bit_rate),
		cmocka_unit_test(test_a_bit_rate_that_cannot_be_reached_is_refused),
		cmocka_unit_test(test_more_than_half_a_percent_off_is_refused),
		cmocka_unit_test(test_no_other_setting_is_nearer),
		cmocka_unit_test(test_a_frame_is_packed_as_the_adapter_expects_it),
		cmocka_unit_test(test_extended_and_remote_are_flags_of_the_identifier),
		cmocka_unit_test(test_requests_are_packed_little_endian),
		cmocka_unit_test(test_a_received_frame_is_unpacked),
		cmocka_unit_test(test_the_flags_of_a_received_identifier_are_unpacked),
		cmocka_unit_test(test_without_time_stamps_the_last_four_bytes_are_padding),
		cmocka_unit_test(test_an_echo_names_its_slot),
		cmocka_unit_test(test_packets_that_are_not_frames_are_refused),
		cmocka_unit_test(test_the_limits_of_a_candlelight_are_unpacked),
		cmocka_unit_test(test_limits_that_no_controller_can_have_are_refused),
		cmocka_unit_test(test_the_number_of_channels_is_one_more_than_the_adapter_says),
		cmocka_unit_test(test_error_frames_report_the_state_of_the_bus),
		cmocka_unit_test(test_a_missing_acknowledge_alone_changes_no_state),
		cmocka_unit_test(test_error_frames_contain_the_error_counters),
		cmocka_unit_test(test_going_bus_off_is_counted_once),
		cmocka_unit_test(test_an_overflow_counts_as_a_lost_frame),
		cmocka_unit_test(test_a_frame_read_late_has_the_time_it_was_on_the_bus),
		cmocka_unit_test(test_no_time_of_a_frame_is_in_the_future),
		cmocka_unit_test(test_the_clock_of_the_adapter_may_wrap),
		cmocka_unit_test(test_a_frame_may_be_ten_seconds_late),
		cmocka_unit_test(test_a_fast_crystal_is_followed),
		cmocka_unit_test(test_a_slow_crystal_is_followed),
		cmocka_unit_test(test_after_a_reset_of_the_adapter_the_clock_is_initialised_again),
		cmocka_unit_test(test_a_filter_passes_the_wanted_identifiers_only),
		cmocka_unit_test(test_adapters_are_found_among_the_usb_devices_of_sysfs),
		cmocka_unit_test(test_control_codes_of_a_device_do_not_reach_the_terminal),
		cmocka_unit_test(test_an_adapter_is_chosen_by_serial_number_or_place),
		cmocka_unit_test(test_when_no_adapter_or_several_match_they_are_listed),
		cmocka_unit_test(test_the_udev_rule_contains_every_usb_id_that_is_known),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

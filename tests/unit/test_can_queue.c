/* The transmit queue of can_send() and can_service(), on a fake bus that is full at times. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <string.h>

#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"

struct fake {
	struct can_port port;
	int room;    /* frames that the bus accepts before it is full */
	int refusal; /* the error then */
	uint32_t sent[1200];
	size_t sent_count, attempts;
};

static int fake_send(struct can_port *port, const struct can_msg *msg)
{
	struct fake *fake = (struct fake *)(void *)port;

	fake->attempts++;
	if (fake->room == 0)
		return fake->refusal;
	fake->room--;
	fake->sent[fake->sent_count++] = msg->id;
	return 0;
}

static const struct can_ops fake_ops = {.send = fake_send};

static void fake_init(struct fake *fake, int room)
{
	memset(fake, 0, sizeof(*fake));
	fake->port.ops = &fake_ops;
	fake->room = room;
	fake->refusal = -ENOBUFS;
}

static int send_id(struct fake *fake, uint32_t id, uint64_t now_us)
{
	const struct can_msg msg = {.id = id, .len = 1};

	return can_send(&fake->port, &msg, now_us);
}

static void assert_sent(const struct fake *fake, uint32_t first, size_t count)
{
	assert_int_equal(fake->sent_count, count);
	for (size_t i = 0; i < count; i++)
		assert_int_equal(fake->sent[i], first + i);
}

static void test_a_frame_goes_straight_to_a_bus_that_has_room(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 1);
	assert_int_equal(send_id(&fake, 7, 1000), 0);
	assert_sent(&fake, 7, 1);
	assert_int_equal(fake.port.counters.tx, 1);
	assert_int_equal(fake.port.queue_count, 0);
}

static void test_a_refused_frame_waits_and_the_refusal_is_counted(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	assert_int_equal(send_id(&fake, 7, 1000), 0);
	assert_int_equal(fake.port.queue_count, 1);
	assert_int_equal(fake.port.counters.tx_retries, 1);
	assert_int_equal(fake.port.counters.tx, 0);
	assert_int_equal(fake.port.counters.tx_dropped, 0);
}

static void test_eagain_means_that_the_bus_is_full_too(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	fake.refusal = -EAGAIN;
	assert_int_equal(send_id(&fake, 7, 1000), 0);
	assert_int_equal(fake.port.queue_count, 1);
	assert_int_equal(fake.port.counters.tx_retries, 1);
}

static void test_the_next_deadline_is_the_end_of_the_back_off(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 7, 1000);
	assert_int_equal(can_service(&fake.port, 1000), 1500);
}

static void test_with_an_empty_queue_there_is_no_deadline(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	assert_true(can_service(&fake.port, 1000) == UINT64_MAX);
}

static void test_nothing_is_sent_during_the_back_off(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 1, 1000);
	can_service(&fake.port, 1499);
	send_id(&fake, 2, 1499);
	assert_int_equal(fake.attempts, 1);
}

static void test_the_back_off_doubles_from_half_a_millisecond_to_20_ms(void **state)
{
	static const uint64_t waits_us[] = {500, 1000, 2000, 4000, 8000, 16000, 20000, 20000};
	struct fake fake;
	uint64_t now_us = 1000;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 7, now_us);
	for (size_t i = 0; i < sizeof(waits_us) / sizeof(waits_us[0]); i++) {
		uint64_t next_us = can_service(&fake.port, now_us);

		assert_int_equal(next_us - now_us, waits_us[i]);
		now_us = next_us;
	}
}

static void test_a_frame_that_was_sent_resets_the_back_off(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 1, 0);
	can_service(&fake.port, 500); /* refused again: waits 1 ms */
	fake.room = 1;
	can_service(&fake.port, 1500);
	send_id(&fake, 2, 2000);
	assert_int_equal(can_service(&fake.port, 2000), 2500);
}

static void test_a_new_frame_does_not_overtake_queued_frames(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 1, 0);
	fake.room = 10;
	send_id(&fake, 2, 100); /* there is room, but frame 1 is not due before 500 us */
	assert_sent(&fake, 1, 0);
	can_service(&fake.port, 500);
	assert_sent(&fake, 1, 2);
}

static void test_a_new_frame_after_the_back_off_is_sent_behind_the_queued_ones(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 1, 0);
	fake.room = 10;
	assert_int_equal(send_id(&fake, 2, 500), 0);
	assert_sent(&fake, 1, 2);
}

static void test_nothing_is_lost_until_the_queue_is_full(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	for (uint32_t id = 0; id < CAN_QUEUE_LEN; id++)
		assert_int_equal(send_id(&fake, id, 0), 0);
	assert_int_equal(fake.port.counters.tx_dropped, 0);
	fake.room = 1000;
	can_service(&fake.port, 500);
	assert_sent(&fake, 0, CAN_QUEUE_LEN);
	assert_int_equal(fake.port.counters.tx, CAN_QUEUE_LEN);
}

static void test_a_full_queue_drops_the_oldest_frame_and_counts_it(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	for (uint32_t id = 0; id < CAN_QUEUE_LEN + 3; id++)
		assert_int_equal(send_id(&fake, id, 0), 0);
	assert_int_equal(fake.port.counters.tx_dropped, 3);
	fake.room = 1000;
	can_service(&fake.port, 500);
	assert_sent(&fake, 3, CAN_QUEUE_LEN);
}

static void test_in_a_full_queue_a_new_frame_replaces_the_oldest_with_its_identifier(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 0x90, 1000); /* an EMCY among PDOs */
	for (int i = 1; i < CAN_QUEUE_LEN + 1000; i++)
		send_id(&fake, 0x190, 1000);
	assert_int_equal(fake.port.queue_count, CAN_QUEUE_LEN);
	assert_int_equal(fake.port.counters.tx_dropped, 1000);
	fake.room = CAN_QUEUE_LEN;
	can_service(&fake.port, 1000000);
	assert_int_equal(fake.sent_count, CAN_QUEUE_LEN);
	assert_int_equal(fake.sent[0], 0x90);
	assert_int_equal(fake.sent[CAN_QUEUE_LEN - 1], 0x190);
}

static void test_a_full_queue_drops_a_superseded_frame_rather_than_the_only_one_of_its_identifier(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	send_id(&fake, 0x90, 1000); /* an EMCY among PDOs */
	for (int i = 1; i < CAN_QUEUE_LEN; i++)
		send_id(&fake, 0x190, 1000);
	send_id(&fake, 0x710, 1000); /* a heartbeat */
	fake.room = CAN_QUEUE_LEN;
	can_service(&fake.port, 1000000);
	assert_int_equal(fake.sent_count, CAN_QUEUE_LEN);
	assert_int_equal(fake.sent[0], 0x90);
	assert_int_equal(fake.sent[CAN_QUEUE_LEN - 1], 0x710);
}

static void test_the_queue_keeps_its_order_when_a_superseded_frame_is_dropped(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	for (uint32_t id = 0; id < CAN_QUEUE_LEN; id++)
		send_id(&fake, id, 1000);
	send_id(&fake, 5, 1000);
	fake.room = CAN_QUEUE_LEN;
	can_service(&fake.port, 1000000);
	assert_int_equal(fake.sent_count, CAN_QUEUE_LEN);
	for (uint32_t i = 0; i < CAN_QUEUE_LEN - 1; i++)
		assert_int_equal(fake.sent[i], i < 5 ? i : i + 1);
	assert_int_equal(fake.sent[CAN_QUEUE_LEN - 1], 5);
}

static void test_of_two_superseded_frames_the_older_one_is_dropped_even_at_the_head(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	for (uint32_t i = 0; i < CAN_QUEUE_LEN; i++)
		send_id(&fake, i == 0 || i == 5 ? 0x7FF : i, 1000);
	send_id(&fake, 0x7FF, 1000);
	fake.room = CAN_QUEUE_LEN;
	can_service(&fake.port, 1000000);
	assert_int_equal(fake.sent[0], 1);
	assert_int_equal(fake.sent[4], 0x7FF);
	assert_int_equal(fake.sent[CAN_QUEUE_LEN - 1], 0x7FF);
}

/* A bus with room for 10 frames that sends one every 250 us, fed in bursts of 20. */
static void test_the_order_is_kept_through_many_refusals(void **state)
{
	struct fake fake;
	uint64_t now_us = 0;
	uint32_t id = 0;

	(void)state;
	fake_init(&fake, 10);
	for (; fake.sent_count < 400; now_us += 250) {
		fake.room = fake.room < 10 ? fake.room + 1 : 10;
		if (now_us % 8000 == 0 && id < 400)
			for (int burst = 0; burst < 20; burst++)
				send_id(&fake, id++, now_us);
		can_service(&fake.port, now_us);
		assert_true(now_us < 10000000);
	}
	assert_sent(&fake, 0, 400);
	assert_true(fake.port.counters.tx_retries > 20);
	assert_int_equal(fake.port.counters.tx_dropped, 0);
}

static void test_a_frame_that_the_bus_cannot_send_is_reported_and_counted(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	fake.refusal = -ENETDOWN;
	assert_int_equal(send_id(&fake, 7, 0), -ENETDOWN);
	assert_int_equal(fake.port.counters.tx_dropped, 1);
	assert_int_equal(fake.port.queue_count, 0);
}

static void test_queued_frames_are_dropped_and_counted_when_the_bus_goes_down(void **state)
{
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	for (uint32_t id = 0; id < 5; id++)
		send_id(&fake, id, 0);
	fake.refusal = -ENETDOWN;
	assert_true(can_service(&fake.port, 500) == UINT64_MAX);
	assert_int_equal(fake.port.queue_count, 0);
	assert_int_equal(fake.port.counters.tx_dropped, 5);
}

static int receive_a_frame(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	(void)port, (void)now_us;
	*msg = (struct can_msg){.id = 5, .len = 3};
	return 1;
}

static void refresh_nothing(struct can_port *port)
{
	(void)port;
}

static void test_the_traffic_is_frames_and_data_bytes_of_both_directions(void **state)
{
	static const struct can_ops ops = {.send = fake_send, .receive = receive_a_frame};
	const struct can_msg data = {.id = 1, .len = 8}, remote = {.id = 2, .remote = true, .len = 4};
	struct fake fake;
	struct can_msg msg;

	(void)state;
	fake_init(&fake, 2);
	fake.port.ops = &ops;
	can_send(&fake.port, &data, 0);
	can_send(&fake.port, &remote, 0); /* has a length and no data */
	can_send(&fake.port, &data, 0);	  /* queued: not on the bus */
	assert_int_equal(can_receive(&fake.port, &msg, 0), 1);
	assert_int_equal(fake.port.traffic.frames, 3);
	assert_int_equal(fake.port.traffic.bytes, 8 + 3);
	assert_int_equal(fake.port.counters.tx, 2);
	assert_int_equal(fake.port.counters.rx, 1);
}

static void test_a_driver_that_knows_the_traffic_of_the_bus_counts_it_itself(void **state)
{
	static const struct can_ops ops = {.send = fake_send, .receive = receive_a_frame, .refresh = refresh_nothing};
	struct fake fake;

	(void)state;
	fake_init(&fake, 1);
	fake.port.ops = &ops;
	send_id(&fake, 1, 0);
	assert_int_equal(fake.port.traffic.frames, 0);
}

static uint64_t service_in_a_second(struct can_port *port, uint64_t now_us)
{
	(void)port;
	return now_us + 1000000;
}

static void test_the_deadline_is_the_drivers_own_when_that_is_earlier_than_the_queues(void **state)
{
	static const struct can_ops ops = {.send = fake_send, .service = service_in_a_second};
	struct fake fake;

	(void)state;
	fake_init(&fake, 0);
	fake.port.ops = &ops;
	assert_int_equal(can_service(&fake.port, 100), 1000100);
	send_id(&fake, 1, 100);
	assert_int_equal(can_service(&fake.port, 100), 600);
}

static void test_an_unknown_kind_of_bus_is_refused_with_the_known_kinds(void **state)
{
	struct can_port *port = NULL;
	char error[300] = "";

	(void)state;
	assert_int_equal(can_open("pcan:1", &port, error, sizeof(error)), -EINVAL);
	assert_string_equal(error, "unknown bus 'pcan:1': use one of INTERFACE, "
				   "gs_usb[:SERIAL[:CHANNEL]][,bitrate=B][,sample-point=P][,listen-only], "
				   "slcan:DEVICE[@BAUD][,bitrate=B][,listen-only], "
				   "udp[:GROUP[:PORT]][,interface=NAME][,hosts=HOSTS]");
	assert_null(port);
}

static void test_an_interface_that_does_not_exist_is_refused(void **state)
{
	struct can_port *port = NULL;
	char error[200] = "";

	(void)state;
	assert_true(can_open("nocan7", &port, error, sizeof(error)) < 0);
	assert_non_null(strstr(error, "nocan7"));
	assert_non_null(strstr(error, "or use the bus `udp`"));
	assert_null(port);
}

static void test_a_name_that_is_too_long_for_an_interface_is_refused(void **state)
{
	struct can_port *port = NULL;
	char error[200] = "";

	(void)state;
	assert_int_equal(can_open("an_interface_name", &port, error, sizeof(error)), -EINVAL);
	assert_non_null(strstr(error, "at most 15 characters"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_frame_goes_straight_to_a_bus_that_has_room),
		cmocka_unit_test(test_a_refused_frame_waits_and_the_refusal_is_counted),
		cmocka_unit_test(test_eagain_means_that_the_bus_is_full_too),
		cmocka_unit_test(test_the_next_deadline_is_the_end_of_the_back_off),
		cmocka_unit_test(test_with_an_empty_queue_there_is_no_deadline),
		cmocka_unit_test(test_nothing_is_sent_during_the_back_off),
		cmocka_unit_test(test_the_back_off_doubles_from_half_a_millisecond_to_20_ms),
		cmocka_unit_test(test_a_frame_that_was_sent_resets_the_back_off),
		cmocka_unit_test(test_a_new_frame_does_not_overtake_queued_frames),
		cmocka_unit_test(test_a_new_frame_after_the_back_off_is_sent_behind_the_queued_ones),
		cmocka_unit_test(test_nothing_is_lost_until_the_queue_is_full),
		cmocka_unit_test(test_a_full_queue_drops_the_oldest_frame_and_counts_it),
		cmocka_unit_test(test_in_a_full_queue_a_new_frame_replaces_the_oldest_with_its_identifier),
		cmocka_unit_test(test_a_full_queue_drops_a_superseded_frame_rather_than_the_only_one_of_its_identifier),
		cmocka_unit_test(test_the_queue_keeps_its_order_when_a_superseded_frame_is_dropped),
		cmocka_unit_test(test_of_two_superseded_frames_the_older_one_is_dropped_even_at_the_head),
		cmocka_unit_test(test_the_order_is_kept_through_many_refusals),
		cmocka_unit_test(test_a_frame_that_the_bus_cannot_send_is_reported_and_counted),
		cmocka_unit_test(test_queued_frames_are_dropped_and_counted_when_the_bus_goes_down),
		cmocka_unit_test(test_the_deadline_is_the_drivers_own_when_that_is_earlier_than_the_queues),
		cmocka_unit_test(test_the_traffic_is_frames_and_data_bytes_of_both_directions),
		cmocka_unit_test(test_a_driver_that_knows_the_traffic_of_the_bus_counts_it_itself),
		cmocka_unit_test(test_an_unknown_kind_of_bus_is_refused_with_the_known_kinds),
		cmocka_unit_test(test_an_interface_that_does_not_exist_is_refused),
		cmocka_unit_test(test_a_name_that_is_too_long_for_an_interface_is_refused),
	};

	return cmocka_run_group_tests_name("can_queue", tests, count_descriptors, no_descriptor_is_left);
}

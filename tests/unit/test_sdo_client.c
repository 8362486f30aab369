/* The SDO client against scripted frames, byte for byte as in CiA 301, 7.2.4.3. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <string.h>
#include <errno.h>
#include <cmocka.h>

#include "gateway/canopen/client/sdo_client.h"

enum { NODE = 5, TIMEOUT_US = 500000 };

struct bench {
	struct can_port bus; /* first, so that ops->send() can cast it */
	struct sdo_client client;
	struct can_msg sent;
	unsigned int sent_count;
	int send_result;
};

static int capture(struct can_port *port, const struct can_msg *msg)
{
	struct bench *bench = (struct bench *)port;

	if (bench->send_result)
		return bench->send_result;
	bench->sent = *msg;
	bench->sent_count++;
	return 0;
}

static const struct can_ops capturing = {.send = capture};

static struct bench *bench_reset(void)
{
	static struct bench bench;

	bench = (struct bench){.bus = {.ops = &capturing, .fd = -1}};
	sdo_client_init(&bench.client, &bench.bus, NODE, TIMEOUT_US);
	return &bench;
}

static void answer_from(struct bench *bench, uint32_t id, const void *data, uint8_t len, uint64_t now_us)
{
	struct can_msg msg = {.id = id, .len = len};

	memcpy(msg.data, data, len);
	sdo_client_receive(&bench->client, &msg, now_us);
}

#define ANSWER(bench, ...) answer_from(bench, 0x580 + NODE, (const uint8_t[8]){__VA_ARGS__}, 8, 1000)

#define assert_sent(bench, ...)                                                                \
	do {                                                                                   \
		assert_int_equal((bench)->sent.id, 0x600 + NODE);                              \
		assert_int_equal((bench)->sent.len, 8);                                        \
		assert_memory_equal((bench)->sent.data, ((const uint8_t[8]){__VA_ARGS__}), 8); \
	} while (0)

static void test_an_expedited_read_has_the_bytes_that_its_size_bits_indicate(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8] = {0};

	sdo_client_upload(&b->client, 0x1017, 2, value, sizeof(value), 0);
	assert_sent(b, 0x40, 0x17, 0x10, 2);
	ANSWER(b, 0x4B, 0x17, 0x10, 2, 0xE8, 0x03, 0xAA, 0xAA);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(b->client.size, 2);
	assert_memory_equal(value, ((const uint8_t[]){0xE8, 0x03, 0}), 3);
}

static void test_an_expedited_read_without_a_size_gives_four_bytes(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8];

	sdo_client_upload(&b->client, 0x1000, 0, value, sizeof(value), 0);
	ANSWER(b, 0x42, 0x00, 0x10, 0, 1, 2, 3, 4);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(b->client.size, 4);
}

static void test_a_segmented_read_alternates_the_toggle_bit_and_concatenates_the_segments(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[32];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0x41, 0x08, 0x10, 0, 17, 0, 0, 0);
	assert_sent(b, 0x60);
	ANSWER(b, 0x00, 'I', 'M', 'U', '9', ' ', 'C', 'A');
	assert_sent(b, 0x70);
	ANSWER(b, 0x10, 'N', 'o', 'p', 'e', 'n', ' ', 'g');
	assert_sent(b, 0x60);
	ANSWER(b, 0x09, 'a', 't', 'e'); /* 4 of 7 bytes unused, last */
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(b->client.size, 17);
	assert_memory_equal(value, "IMU9 CANopen gate", 17);
}

static void test_a_read_of_an_empty_value_gives_no_bytes(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[4];

	sdo_client_upload(&b->client, 0x100A, 0, value, sizeof(value), 0);
	ANSWER(b, 0x41, 0x0A, 0x10, 0);
	ANSWER(b, 0x0F);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(b->client.size, 0);
}

static void test_a_value_of_one_to_four_bytes_is_written_in_one_frame(void **state)
{
	(void)state;
	static const uint8_t commands[] = {0x2F, 0x2B, 0x27, 0x23};

	for (uint8_t n = 1; n <= 4; n++) {
		struct bench *b = bench_reset();
		uint8_t want[8] = {commands[n - 1], 0x00, 0x20, 3};

		memcpy(&want[4], "\x11\x22\x33\x44", n);
		sdo_client_download(&b->client, 0x2000, 3, "\x11\x22\x33\x44", n, 0);
		assert_memory_equal(b->sent.data, want, 8);
		ANSWER(b, 0x60, 0x00, 0x20, 3);
		assert_int_equal(b->client.result, SDO_DONE);
		assert_int_equal(b->client.size, n);
	}
}

static void test_a_longer_value_is_written_in_segments(void **state)
{
	(void)state;
	struct bench *b = bench_reset();

	sdo_client_download(&b->client, 0x2000, 1, "0123456789", 10, 0);
	assert_sent(b, 0x21, 0x00, 0x20, 1, 10, 0, 0, 0);
	ANSWER(b, 0x60, 0x00, 0x20, 1);
	assert_sent(b, 0x00, '0', '1', '2', '3', '4', '5', '6');
	ANSWER(b, 0x20);
	assert_sent(b, 0x19, '7', '8', '9'); /* toggle, 4 unused, last */
	assert_int_equal(b->client.result, SDO_RUNNING);
	ANSWER(b, 0x30);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(b->client.size, 10);
}

static void test_a_value_of_two_full_segments_ends_with_the_second(void **state)
{
	(void)state;
	struct bench *b = bench_reset();

	sdo_client_download(&b->client, 0x2000, 1, "0123456789abcd", 14, 0);
	ANSWER(b, 0x60, 0x00, 0x20, 1);
	ANSWER(b, 0x20);
	assert_sent(b, 0x11, '7', '8', '9', 'a', 'b', 'c', 'd');
}

static void test_an_empty_value_is_written_as_one_empty_segment(void **state)
{
	(void)state;
	struct bench *b = bench_reset();

	sdo_client_download(&b->client, 0x2000, 1, "", 0, 0);
	assert_sent(b, 0x21, 0x00, 0x20, 1);
	ANSWER(b, 0x60, 0x00, 0x20, 1);
	assert_sent(b, 0x0F);
	ANSWER(b, 0x20);
	assert_int_equal(b->client.result, SDO_DONE);
}

static void test_an_abort_of_the_server_ends_the_transfer_with_its_code(void **state)
{
	(void)state;
	struct bench *b = bench_reset();

	sdo_client_download(&b->client, 0x2000, 1, "\0\0\0", 4, 0);
	ANSWER(b, 0x80, 0x00, 0x20, 1, 0x31, 0x00, 0x09, 0x06);
	assert_int_equal(b->client.result, SDO_ABORTED);
	assert_true(b->client.aborted_by_server);
	assert_int_equal(b->client.abort_code, 0x06090031);
	assert_int_equal(b->sent_count, 1);
}

static void test_a_segment_with_the_wrong_toggle_is_aborted(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[32];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0x40, 0x08, 0x10, 0);
	ANSWER(b, 0x10, 'I', 'M', 'U', '9', ' ', 'C', 'A');
	assert_int_equal(b->client.result, SDO_ABORTED);
	assert_false(b->client.aborted_by_server);
	assert_sent(b, 0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x03, 0x05);
}

static void test_a_confirmation_with_the_wrong_toggle_is_aborted(void **state)
{
	(void)state;
	struct bench *b = bench_reset();

	sdo_client_download(&b->client, 0x2000, 1, "0123456789", 10, 0);
	ANSWER(b, 0x60, 0x00, 0x20, 1);
	ANSWER(b, 0x30);
	assert_int_equal(b->client.abort_code, SDO_ABORT_TOGGLE);
	assert_sent(b, 0x80, 0x00, 0x20, 1, 0x00, 0x00, 0x03, 0x05);
}

static void test_an_unexpected_command_is_aborted(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[8];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0xE0, 0x08, 0x10, 0);
	assert_int_equal(b->client.abort_code, SDO_ABORT_COMMAND);
	assert_sent(b, 0x80, 0x08, 0x10, 0, 0x01, 0x00, 0x04, 0x05);
}

/* An abort would end the transfer of that client, too. */
static void test_what_another_client_does_with_the_same_object_is_ignored(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint32_t value = 0;

	sdo_client_upload(&b->client, 0x1805, 1, &value, sizeof(value), 0);
	ANSWER(b, 0x60, 0x05, 0x18, 1);
	assert_int_equal(b->client.result, SDO_RUNNING);
	ANSWER(b, 0x43, 0x05, 0x18, 1, 0xDD, 0x06, 0, 0);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(value, 0x6DD);

	sdo_client_download(&b->client, 0x1805, 1, &value, sizeof(value), 0);
	ANSWER(b, 0x43, 0x05, 0x18, 1, 0xDD, 0x06, 0, 0);
	assert_int_equal(b->client.result, SDO_RUNNING);
	ANSWER(b, 0x60, 0x05, 0x18, 1);
	assert_int_equal(b->client.result, SDO_DONE);
}

static void test_a_value_larger_than_the_buffer_is_aborted_before_it_is_sent(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[8];

	sdo_client_upload(&b->client, 0x1021, 0, value, sizeof(value), 0);
	ANSWER(b, 0x41, 0x21, 0x10, 0, 9, 0, 0, 0);
	assert_int_equal(b->client.abort_code, SDO_ABORT_MEMORY);
	assert_sent(b, 0x80, 0x21, 0x10, 0, 0x05, 0x00, 0x04, 0x05);
}

static void test_a_value_of_unknown_size_never_overruns_the_buffer(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[12] = "...........";

	sdo_client_upload(&b->client, 0x1021, 0, value, 10, 0);
	ANSWER(b, 0x40, 0x21, 0x10, 0);
	ANSWER(b, 0x00, 1, 2, 3, 4, 5, 6, 7);
	ANSWER(b, 0x10, 1, 2, 3, 4, 5, 6, 7);
	assert_int_equal(b->client.abort_code, SDO_ABORT_MEMORY);
	assert_int_equal(value[10], '.');
}

static void test_more_or_fewer_bytes_than_indicated_are_aborted(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[32];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0x41, 0x08, 0x10, 0, 6, 0, 0, 0);
	ANSWER(b, 0x01, 1, 2, 3, 4, 5, 6, 7);
	assert_int_equal(b->client.abort_code, SDO_ABORT_LENGTH);

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0x41, 0x08, 0x10, 0, 8, 0, 0, 0);
	ANSWER(b, 0x01, 1, 2, 3, 4, 5, 6, 7);
	assert_int_equal(b->client.abort_code, SDO_ABORT_LENGTH);
}

static void test_an_empty_segment_that_is_not_the_last_is_aborted(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[32];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	ANSWER(b, 0x40, 0x08, 0x10, 0);
	ANSWER(b, 0x0E);
	assert_int_equal(b->client.result, SDO_ABORTED);
}

static void test_no_response_within_the_timeout_sends_an_abort(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[8];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 100);
	assert_int_equal(sdo_client_tick(&b->client, 100), 100 + TIMEOUT_US);
	assert_int_equal(sdo_client_tick(&b->client, 99 + TIMEOUT_US), 100 + TIMEOUT_US);
	assert_int_equal(b->client.result, SDO_RUNNING);
	assert_true(sdo_client_tick(&b->client, 100 + TIMEOUT_US) == UINT64_MAX);
	assert_int_equal(b->client.result, SDO_TIMEOUT);
	assert_sent(b, 0x80, 0x08, 0x10, 0, 0x00, 0x00, 0x04, 0x05);
}

static void test_the_timeout_restarts_with_each_request(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	char value[32];

	sdo_client_upload(&b->client, 0x1008, 0, value, sizeof(value), 0);
	answer_from(b, 0x580 + NODE, "\x40\x08\x10\0\0\0\0", 8, 400000);
	assert_int_equal(sdo_client_tick(&b->client, 400000), 400000 + TIMEOUT_US);
}

static void test_a_late_response_to_an_earlier_request_is_ignored(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8];

	sdo_client_upload(&b->client, 0x1000, 0, value, sizeof(value), 0);
	sdo_client_tick(&b->client, TIMEOUT_US);
	sdo_client_upload(&b->client, 0x1001, 0, value, sizeof(value), TIMEOUT_US);
	ANSWER(b, 0x43, 0x00, 0x10, 0, 1, 2, 3, 4);
	ANSWER(b, 0x80, 0x00, 0x10, 0, 0, 0, 2, 6);
	assert_int_equal(b->client.result, SDO_RUNNING);
	ANSWER(b, 0x4F, 0x01, 0x10, 0, 0x11);
	assert_int_equal(b->client.result, SDO_DONE);
	assert_int_equal(value[0], 0x11);
}

static void test_frames_of_other_nodes_and_malformed_ones_are_ignored(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8];
	struct can_msg good = {.id = 0x580 + NODE, .len = 8, .data = {0x4F, 0x01, 0x10, 0, 0x11}};
	struct can_msg msg;

	sdo_client_upload(&b->client, 0x1001, 0, value, sizeof(value), 0);
	msg = good, msg.id = 0x580 + NODE + 1;
	sdo_client_receive(&b->client, &msg, 0);
	msg = good, msg.extended = true;
	sdo_client_receive(&b->client, &msg, 0);
	msg = good, msg.remote = true;
	sdo_client_receive(&b->client, &msg, 0);
	msg = good, msg.len = 7;
	sdo_client_receive(&b->client, &msg, 0);
	assert_int_equal(b->client.result, SDO_RUNNING);
	sdo_client_receive(&b->client, &good, 0);
	assert_int_equal(b->client.result, SDO_DONE);
}

static void test_a_response_after_the_end_is_ignored(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8];

	sdo_client_upload(&b->client, 0x1001, 0, value, sizeof(value), 0);
	ANSWER(b, 0x4F, 0x01, 0x10, 0, 0x11);
	ANSWER(b, 0x4F, 0x01, 0x10, 0, 0x22);
	assert_int_equal(value[0], 0x11);
	assert_int_equal(b->sent_count, 1);
}

static void test_a_bus_that_accepts_no_frame_ends_the_transfer(void **state)
{
	(void)state;
	struct bench *b = bench_reset();
	uint8_t value[8];

	b->send_result = -ENETDOWN;
	sdo_client_upload(&b->client, 0x1001, 0, value, sizeof(value), 0);
	assert_int_equal(b->client.result, SDO_UNSENT);
	assert_int_equal(b->client.send_error, -ENETDOWN);
	b->send_result = 0;
	sdo_client_upload(&b->client, 0x1001, 0, value, sizeof(value), 0);
	assert_int_equal(b->client.result, SDO_RUNNING);
	assert_int_equal(b->client.send_error, 0);
}

static void test_every_abort_code_of_cia_301_has_its_own_text(void **state)
{
	(void)state;
	static const uint32_t codes[] = {0x05030000, 0x05040000, 0x05040001, 0x05040002, 0x05040003, 0x05040004,
		0x05040005, 0x06010000, 0x06010001, 0x06010002, 0x06020000, 0x06040041, 0x06040042, 0x06040043,
		0x06040047, 0x06060000, 0x06070010, 0x06070012, 0x06070013, 0x06090011, 0x06090030, 0x06090031,
		0x06090032, 0x06090036, 0x060A0023, 0x08000000, 0x08000020, 0x08000021, 0x08000022, 0x08000023,
		0x08000024};
	const size_t n = sizeof(codes) / sizeof(codes[0]);

	for (size_t i = 0; i < n; i++) {
		assert_string_not_equal(sdo_abort_text(codes[i]), sdo_abort_text(0xFFFFFFFF));
		for (size_t k = 0; k < i; k++)
			assert_string_not_equal(sdo_abort_text(codes[i]), sdo_abort_text(codes[k]));
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_expedited_read_has_the_bytes_that_its_size_bits_indicate),
		cmocka_unit_test(test_an_expedited_read_without_a_size_gives_four_bytes),
		cmocka_unit_test(test_a_segmented_read_alternates_the_toggle_bit_and_concatenates_the_segments),
		cmocka_unit_test(test_a_read_of_an_empty_value_gives_no_bytes),
		cmocka_unit_test(test_a_value_of_one_to_four_bytes_is_written_in_one_frame),
		cmocka_unit_test(test_a_longer_value_is_written_in_segments),
		cmocka_unit_test(test_a_value_of_two_full_segments_ends_with_the_second),
		cmocka_unit_test(test_an_empty_value_is_written_as_one_empty_segment),
		cmocka_unit_test(test_an_abort_of_the_server_ends_the_transfer_with_its_code),
		cmocka_unit_test(test_a_segment_with_the_wrong_toggle_is_aborted),
		cmocka_unit_test(test_a_confirmation_with_the_wrong_toggle_is_aborted),
		cmocka_unit_test(test_an_unexpected_command_is_aborted),
		cmocka_unit_test(test_a_value_larger_than_the_buffer_is_aborted_before_it_is_sent),
		cmocka_unit_test(test_a_value_of_unknown_size_never_overruns_the_buffer),
		cmocka_unit_test(test_more_or_fewer_bytes_than_indicated_are_aborted),
		cmocka_unit_test(test_an_empty_segment_that_is_not_the_last_is_aborted),
		cmocka_unit_test(test_no_response_within_the_timeout_sends_an_abort),
		cmocka_unit_test(test_the_timeout_restarts_with_each_request),
		cmocka_unit_test(test_a_late_response_to_an_earlier_request_is_ignored),
		cmocka_unit_test(test_what_another_client_does_with_the_same_object_is_ignored),
		cmocka_unit_test(test_frames_of_other_nodes_and_malformed_ones_are_ignored),
		cmocka_unit_test(test_a_response_after_the_end_is_ignored),
		cmocka_unit_test(test_a_bus_that_accepts_no_frame_ends_the_transfer),
		cmocka_unit_test(test_every_abort_code_of_cia_301_has_its_own_text),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

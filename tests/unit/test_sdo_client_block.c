/* The SDO client's block transfers against scripted frames, byte for byte as in CiA 301, 7.2.4.3.9 to 7.2.4.3.16.
 * The CRC of "123456789" is 31C3h. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <errno.h>
#include <string.h>
#include <cmocka.h>

#include "gateway/canopen/client/sdo_client.h"

enum { NODE = 5, TIMEOUT_US = 500000, SENT_MAX = 200, T0 = 1000 };

struct bench {
	struct can_port bus; /* first, so that ops->send() can cast it */
	struct sdo_client client;
	struct can_msg sent[SENT_MAX];
	size_t sent_count, seen;
	uint8_t value[100];
};

static int capture(struct can_port *port, const struct can_msg *msg)
{
	struct bench *bench = (struct bench *)port;

	assert_true(bench->sent_count < SENT_MAX);
	bench->sent[bench->sent_count++] = *msg;
	return 0;
}

static struct bench *bench_reset(void)
{
	static const struct can_ops capturing = {.send = capture};
	static struct bench bench;

	bench = (struct bench){.bus = {.ops = &capturing, .fd = -1}};
	sdo_client_init(&bench.client, &bench.bus, NODE, TIMEOUT_US);
	return &bench;
}

static void answer(struct bench *bench, const uint8_t data[8])
{
	struct can_msg msg = {.id = 0x580 + NODE, .len = 8};

	memcpy(msg.data, data, 8);
	sdo_client_receive(&bench->client, &msg, T0);
}

#define ANSWER(bench, ...) answer(bench, (const uint8_t[8]){__VA_ARGS__})

/* The next frame that the client sent. */
#define ASSERT_SENT(bench, ...)                                                                                 \
	do {                                                                                                    \
		assert_true((bench)->seen < (bench)->sent_count);                                               \
		assert_int_equal((bench)->sent[(bench)->seen].id, 0x600 + NODE);                                \
		assert_memory_equal((bench)->sent[(bench)->seen++].data, ((const uint8_t[8]){__VA_ARGS__}), 8); \
	} while (0)
#define ASSERT_NOTHING_SENT(bench) assert_int_equal((bench)->seen, (bench)->sent_count)

static struct bench *upload(size_t capacity)
{
	struct bench *bench = bench_reset();

	sdo_client_block_upload(&bench->client, 0x1021, 0, bench->value, capacity, T0);
	ASSERT_SENT(bench, 0xA4, 0x21, 0x10, 0, 127);
	return bench;
}

static struct bench *download(const char *text)
{
	struct bench *bench = bench_reset();

	sdo_client_block_download(&bench->client, 0x2130, 0, text, strlen(text), T0);
	ASSERT_SENT(bench, 0xC6, 0x30, 0x21, 0, (uint8_t)strlen(text));
	return bench;
}

static void assert_aborted(struct bench *bench, uint16_t index, uint32_t code)
{
	assert_int_equal(bench->client.result, SDO_ABORTED);
	assert_int_equal(bench->client.abort_code, code);
	assert_false(bench->client.aborted_by_server);
	ASSERT_SENT(bench, 0x80, (uint8_t)index, (uint8_t)(index >> 8), 0, (uint8_t)code, (uint8_t)(code >> 8),
		(uint8_t)(code >> 16), (uint8_t)(code >> 24));
	ASSERT_NOTHING_SENT(bench);
}

/* Calls the client until it waits for the server. */
static void let_it_send(struct bench *bench)
{
	while (sdo_client_tick(&bench->client, T0) <= T0)
		;
}

/* ---- upload ------------------------------------------------------------------------------------------------------ */

static void test_an_upload_acknowledges_the_segments_and_checks_the_crc(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC6, 0x21, 0x10, 0, 9);
	ASSERT_SENT(bench, 0xA3);
	ANSWER(bench, 0x01, '1', '2', '3', '4', '5', '6', '7');
	ASSERT_NOTHING_SENT(bench);
	ANSWER(bench, 0x82, '8', '9');
	ASSERT_SENT(bench, 0xA2, 2, 127);
	ANSWER(bench, 0xD5, 0xC3, 0x31);
	ASSERT_SENT(bench, 0xA1);
	assert_int_equal(bench->client.result, SDO_DONE);
	assert_int_equal(bench->client.size, 9);
	assert_memory_equal(bench->value, "123456789", 9);
}

static void test_a_wrong_crc_is_aborted(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC6, 0x21, 0x10, 0, 9);
	ANSWER(bench, 0x01, '1', '2', '3', '4', '5', '6', '7');
	ANSWER(bench, 0x82, '8', '8');
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xD5, 0xC3, 0x31);
	assert_aborted(bench, 0x1021, 0x05040004);
}

static void test_the_crc_of_a_server_without_crc_is_not_checked(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC2, 0x21, 0x10, 0, 2);
	ANSWER(bench, 0x81, 'a', 'b');
	ANSWER(bench, 0xD5, 0, 0);
	assert_int_equal(bench->client.result, SDO_DONE);
}

static void test_after_a_lost_segment_the_last_one_in_order_is_acknowledged(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	ASSERT_SENT(bench, 0xA3);
	ANSWER(bench, 0x01, 'a', 'b', 'c', 'd', 'e', 'f', 'g');
	ANSWER(bench, 0x83, 'o', 'p'); /* the second is lost */
	ASSERT_SENT(bench, 0xA2, 1, 127);
	ANSWER(bench, 0x01, 'h', 'i', 'j', 'k', 'l', 'm', 'n');
	ANSWER(bench, 0x82, 'o', 'p');
	ASSERT_SENT(bench, 0xA2, 2, 127);
	assert_memory_equal(bench->value, "abcdefghijklmnop", 16);
}

static void test_a_lost_last_segment_is_requested_once_after_the_timeout(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	ASSERT_SENT(bench, 0xA3);
	ANSWER(bench, 0x01, 'a', 'b', 'c', 'd', 'e', 'f', 'g');
	assert_int_equal(sdo_client_tick(&bench->client, T0 + TIMEOUT_US), T0 + 2 * TIMEOUT_US);
	ASSERT_SENT(bench, 0xA2, 1, 127);
	assert_true(sdo_client_tick(&bench->client, T0 + 2 * TIMEOUT_US) == UINT64_MAX);
	assert_int_equal(bench->client.result, SDO_TIMEOUT);
	ASSERT_SENT(bench, 0x80, 0x21, 0x10, 0, 0, 0, 0x04, 0x05);
}

static void test_segment_127_ends_a_sub_block(void **state)
{
	struct bench *bench = bench_reset();
	static uint8_t value[2000];

	(void)state;
	sdo_client_block_upload(&bench->client, 0x1021, 0, value, sizeof(value), T0);
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	bench->seen = bench->sent_count;
	for (uint8_t i = 1; i < 127; i++)
		ANSWER(bench, i);
	ASSERT_NOTHING_SENT(bench);
	ANSWER(bench, 127);
	ASSERT_SENT(bench, 0xA2, 127, 127);
	ANSWER(bench, 0x81, 'x');
	ASSERT_SENT(bench, 0xA2, 1, 127);
}

static void test_a_value_larger_than_the_buffer_is_aborted_at_once(void **state)
{
	struct bench *bench = upload(10);

	(void)state;
	ANSWER(bench, 0xC6, 0x21, 0x10, 0, 11);
	assert_aborted(bench, 0x1021, 0x05040005);
}

static void test_a_value_of_unknown_size_never_overruns_the_buffer(void **state)
{
	struct bench *bench = upload(10);

	(void)state;
	memset(bench->value, 0xEE, sizeof(bench->value));
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	ANSWER(bench, 0x01, 1, 2, 3, 4, 5, 6, 7);
	ANSWER(bench, 0x02, 1, 2, 3, 4, 5, 6, 7);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0x03, 1, 2, 3, 4, 5, 6, 7);
	assert_aborted(bench, 0x1021, 0x05040005);
	assert_int_equal(bench->value[9], 3);
	assert_int_equal(bench->value[10], 0xEE);
}

static void test_more_or_fewer_bytes_than_indicated_are_aborted(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC2, 0x21, 0x10, 0, 7);
	ANSWER(bench, 0x01, 1, 2, 3, 4, 5, 6, 7);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0x82, 1);
	assert_aborted(bench, 0x1021, 0x06070010);

	bench = upload(100);
	ANSWER(bench, 0xC2, 0x21, 0x10, 0, 7);
	ANSWER(bench, 0x81, 1, 2, 3);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xD1, 0, 0);
	assert_aborted(bench, 0x1021, 0x06070010);
}

static void test_an_empty_value_is_one_empty_segment(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC6, 0x21, 0x10, 0, 0);
	ANSWER(bench, 0x81);
	ANSWER(bench, 0xDD, 0, 0);
	assert_int_equal(bench->client.result, SDO_DONE);
	assert_int_equal(bench->client.size, 0);
}

static void test_a_server_that_prefers_a_segmented_upload_is_followed(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0x4B, 0x21, 0x10, 0, 0xE8, 0x03);
	assert_int_equal(bench->client.result, SDO_DONE);
	assert_int_equal(bench->client.size, 2);

	bench = upload(100);
	ANSWER(bench, 0x41, 0x21, 0x10, 0, 5);
	ASSERT_SENT(bench, 0x60);
	ANSWER(bench, 0x05, 'h', 'e', 'l', 'l', 'o');
	assert_int_equal(bench->client.result, SDO_DONE);
}

static void test_an_abort_between_the_segments_ends_the_transfer(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	ANSWER(bench, 0x80, 0x21, 0x10, 0, 0, 0, 0x04, 0x05);
	assert_int_equal(bench->client.result, SDO_ABORTED);
	assert_true(bench->client.aborted_by_server);
}

static void test_a_server_without_block_transfer_aborts(void **state)
{
	struct bench *bench = upload(100);

	(void)state;
	ANSWER(bench, 0x80, 0x21, 0x10, 0, 0x01, 0, 0x04, 0x05);
	assert_int_equal(bench->client.result, SDO_ABORTED);
	assert_int_equal(bench->client.abort_code, 0x05040001);
	assert_true(bench->client.aborted_by_server);
}

/* ---- download ---------------------------------------------------------------------------------------------------- */

static void test_a_download_sends_the_segments_and_the_crc(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	ASSERT_SENT(bench, 0x01, '1', '2', '3', '4', '5', '6', '7');
	ASSERT_SENT(bench, 0x82, '8', '9');
	ASSERT_NOTHING_SENT(bench);
	ANSWER(bench, 0xA2, 2, 127);
	ASSERT_SENT(bench, 0xD5, 0xC3, 0x31);
	ANSWER(bench, 0xA1);
	assert_int_equal(bench->client.result, SDO_DONE);
	assert_int_equal(bench->client.size, 9);
}

static void test_a_server_without_crc_receives_a_crc_of_0(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA0, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xA2, 2, 127);
	ASSERT_SENT(bench, 0xD5, 0, 0);
}

static void test_the_server_sets_the_size_of_each_sub_block(void **state)
{
	struct bench *bench = download("abcdefghijklmnopqrstuvwxyz");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 1);
	let_it_send(bench);
	ASSERT_SENT(bench, 0x01, 'a', 'b', 'c', 'd', 'e', 'f', 'g');
	ASSERT_NOTHING_SENT(bench);
	ANSWER(bench, 0xA2, 1, 2);
	let_it_send(bench);
	ASSERT_SENT(bench, 0x01, 'h', 'i', 'j', 'k', 'l', 'm', 'n');
	ASSERT_SENT(bench, 0x02, 'o', 'p', 'q', 'r', 's', 't', 'u');
	ASSERT_NOTHING_SENT(bench);
	ANSWER(bench, 0xA2, 2, 127);
	let_it_send(bench);
	ASSERT_SENT(bench, 0x81, 'v', 'w', 'x', 'y', 'z');
}

static void test_segments_that_the_server_misses_are_sent_again(void **state)
{
	struct bench *bench = download("abcdefghijklmnopqrstuvwxyz");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xA2, 3, 127); /* the last one is lost */
	let_it_send(bench);
	ASSERT_SENT(bench, 0x81, 'v', 'w', 'x', 'y', 'z');
	ANSWER(bench, 0xA2, 0, 127); /* again */
	let_it_send(bench);
	ASSERT_SENT(bench, 0x81, 'v', 'w', 'x', 'y', 'z');
	ANSWER(bench, 0xA2, 1, 127);
	ASSERT_SENT(bench, 0xC9, 0xAC, 0x63);
}

static void test_a_server_that_acknowledges_nothing_ends_the_transfer(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	for (int i = 0; i < 4; i++) {
		let_it_send(bench);
		bench->seen = bench->sent_count;
		ANSWER(bench, 0xA2, 0, 127);
	}
	assert_aborted(bench, 0x2130, 0x05040003);
}

static void test_an_acknowledgement_of_segments_that_were_not_sent_is_aborted(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xA2, 3, 127);
	assert_aborted(bench, 0x2130, 0x05040003);
}

static void test_a_block_size_of_0_or_above_127_is_aborted(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 0);
	assert_aborted(bench, 0x2130, 0x05040002);
	bench = download("123456789");
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 128);
	assert_aborted(bench, 0x2130, 0x05040002);
}

static void test_an_empty_value_is_sent_as_one_empty_segment(void **state)
{
	struct bench *bench = download("");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	ASSERT_SENT(bench, 0x81);
	ANSWER(bench, 0xA2, 1, 127);
	ASSERT_SENT(bench, 0xDD, 0, 0);
}

static void test_a_full_bus_delays_the_segments(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	bench->bus.queue_count = 1;
	assert_int_equal(sdo_client_tick(&bench->client, T0), T0 + 1000);
	ASSERT_NOTHING_SENT(bench);
	bench->bus.queue_count = 0;
	sdo_client_tick(&bench->client, T0 + 1000);
	ASSERT_SENT(bench, 0x01, '1', '2', '3', '4', '5', '6', '7');
}

/* Abort 05040001h: client/server command specifier not valid or unknown. */
static void test_an_answer_that_belongs_to_another_step_is_aborted(void **state)
{
	struct bench *bench;

	(void)state;
	bench = upload(100);
	ANSWER(bench, 0xA4, 0x21, 0x10, 0, 127); /* of a download */
	assert_aborted(bench, 0x1021, 0x05040001);

	bench = upload(100);
	ANSWER(bench, 0xC6, 0x21, 0x10, 0, 9);
	ANSWER(bench, 0x01, '1', '2', '3', '4', '5', '6', '7');
	ANSWER(bench, 0x82, '8', '9');
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xC6, 0xC3, 0x31); /* starts again in the place of its end */
	assert_aborted(bench, 0x1021, 0x05040001);

	bench = download("123456789");
	ANSWER(bench, 0xC6, 0x30, 0x21, 0, 127); /* of an upload */
	assert_aborted(bench, 0x2130, 0x05040001);

	bench = download("123456789");
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xA1, 2, 127); /* its end in the place of the acknowledgement */
	assert_aborted(bench, 0x2130, 0x05040001);

	bench = download("123456789");
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	ANSWER(bench, 0xA2, 2, 127);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0xA2, 2, 127); /* acknowledges again */
	assert_aborted(bench, 0x2130, 0x05040001);
}

static void test_a_transfer_after_an_interrupted_one_starts_afresh(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	ANSWER(bench, 0x80, 0x30, 0x21, 0, 0, 0, 0, 0x08);
	assert_int_equal(bench->client.result, SDO_ABORTED);
	sdo_client_block_upload(&bench->client, 0x1021, 0, bench->value, sizeof(bench->value), T0);
	ASSERT_SENT(bench, 0xA4, 0x21, 0x10, 0, 127);
	ANSWER(bench, 0xC2, 0x21, 0x10, 0, 2); /* without CRC */
	ASSERT_SENT(bench, 0xA3);
	ANSWER(bench, 0x81, 'o', 'k');
	ASSERT_SENT(bench, 0xA2, 1, 127);
	ANSWER(bench, 0xD5, 0, 0);
	ASSERT_SENT(bench, 0xA1);
	assert_int_equal(bench->client.result, SDO_DONE);
	assert_memory_equal(bench->value, "ok", 2);
}

static int refuse(struct can_port *port, const struct can_msg *msg)
{
	(void)port, (void)msg;
	return -ENETDOWN;
}

static void test_a_bus_that_accepts_no_segment_ends_the_transfer(void **state)
{
	static const struct can_ops refusing = {.send = refuse};
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	bench->bus.ops = &refusing;
	assert_true(sdo_client_tick(&bench->client, T0) == UINT64_MAX);
	assert_int_equal(bench->client.result, SDO_UNSENT);
	assert_int_equal(bench->client.send_error, -ENETDOWN);
	ASSERT_NOTHING_SENT(bench);
}

static void test_a_bus_that_stays_full_until_the_timeout_ends_the_transfer(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	bench->bus.queue_count = 1;
	assert_int_equal(sdo_client_tick(&bench->client, T0 + TIMEOUT_US - 1), T0 + TIMEOUT_US - 1 + 1000);
	assert_int_equal(bench->client.result, SDO_RUNNING);
	assert_true(sdo_client_tick(&bench->client, T0 + TIMEOUT_US) == UINT64_MAX);
	assert_int_equal(bench->client.result, SDO_TIMEOUT);
}

static void test_a_server_that_does_not_acknowledge_is_a_timeout(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	let_it_send(bench);
	bench->seen = bench->sent_count;
	sdo_client_tick(&bench->client, T0 + TIMEOUT_US);
	assert_int_equal(bench->client.result, SDO_TIMEOUT);
	ASSERT_SENT(bench, 0x80, 0x30, 0x21, 0, 0, 0, 0x04, 0x05);
}

static void test_an_unexpected_command_is_aborted(void **state)
{
	struct bench *bench = download("123456789");

	(void)state;
	ANSWER(bench, 0x60, 0x30, 0x21, 0);
	assert_aborted(bench, 0x2130, 0x05040001);
}

/* So that an abort or a lost segment stops a download early, however long the sub-block. */
static void test_frames_are_received_after_every_16_segments_sent(void **state)
{
	char text[40 * 7 + 1];
	struct bench *bench = bench_reset();

	(void)state;
	memset(text, 'x', sizeof(text) - 1);
	text[sizeof(text) - 1] = '\0';
	sdo_client_block_download(&bench->client, 0x2130, 0, text, 40 * 7, T0);
	bench->sent_count = 0;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 127);
	assert_int_equal(sdo_client_tick(&bench->client, T0), T0);
	assert_int_equal(bench->sent_count, 16);
	assert_int_equal(sdo_client_tick(&bench->client, T0), T0);
	assert_int_equal(bench->sent_count, 32);
	assert_true(sdo_client_tick(&bench->client, T0) > T0);
	assert_int_equal(bench->sent_count, 40);
}

static void test_each_segment_of_an_upload_restarts_the_timeout(void **state)
{
	struct bench *bench = upload(100);
	struct can_msg segment = {.id = 0x580 + NODE, .len = 8, .data = {0x01, 'a', 'b', 'c', 'd', 'e', 'f', 'g'}};

	(void)state;
	ANSWER(bench, 0xC4, 0x21, 0x10, 0);
	sdo_client_receive(&bench->client, &segment, T0 + TIMEOUT_US - 1);
	assert_int_equal(sdo_client_tick(&bench->client, T0 + TIMEOUT_US), T0 + 2 * TIMEOUT_US - 1);
	assert_int_equal(bench->client.result, SDO_RUNNING);
}

/* The server has just answered: a bus that is full then has the whole timeout. */
static void test_an_acknowledgement_restarts_the_timeout(void **state)
{
	struct bench *bench = download("123456789");
	struct can_msg acknowledgement = {.id = 0x580 + NODE, .len = 8, .data = {0xA2, 1, 1}};

	(void)state;
	ANSWER(bench, 0xA4, 0x30, 0x21, 0, 1);
	let_it_send(bench);
	bench->bus.queue_count = 1;
	sdo_client_receive(&bench->client, &acknowledgement, T0 + TIMEOUT_US - 1);
	sdo_client_tick(&bench->client, T0 + 2 * TIMEOUT_US - 2);
	assert_int_equal(bench->client.result, SDO_RUNNING);
	sdo_client_tick(&bench->client, T0 + 2 * TIMEOUT_US - 1);
	assert_int_equal(bench->client.result, SDO_TIMEOUT);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_upload_acknowledges_the_segments_and_checks_the_crc),
		cmocka_unit_test(test_a_wrong_crc_is_aborted),
		cmocka_unit_test(test_the_crc_of_a_server_without_crc_is_not_checked),
		cmocka_unit_test(test_after_a_lost_segment_the_last_one_in_order_is_acknowledged),
		cmocka_unit_test(test_a_lost_last_segment_is_requested_once_after_the_timeout),
		cmocka_unit_test(test_segment_127_ends_a_sub_block),
		cmocka_unit_test(test_a_value_larger_than_the_buffer_is_aborted_at_once),
		cmocka_unit_test(test_a_value_of_unknown_size_never_overruns_the_buffer),
		cmocka_unit_test(test_more_or_fewer_bytes_than_indicated_are_aborted),
		cmocka_unit_test(test_an_empty_value_is_one_empty_segment),
		cmocka_unit_test(test_a_server_that_prefers_a_segmented_upload_is_followed),
		cmocka_unit_test(test_an_abort_between_the_segments_ends_the_transfer),
		cmocka_unit_test(test_a_server_without_block_transfer_aborts),
		cmocka_unit_test(test_a_download_sends_the_segments_and_the_crc),
		cmocka_unit_test(test_a_server_without_crc_receives_a_crc_of_0),
		cmocka_unit_test(test_the_server_sets_the_size_of_each_sub_block),
		cmocka_unit_test(test_segments_that_the_server_misses_are_sent_again),
		cmocka_unit_test(test_a_server_that_acknowledges_nothing_ends_the_transfer),
		cmocka_unit_test(test_an_acknowledgement_of_segments_that_were_not_sent_is_aborted),
		cmocka_unit_test(test_a_block_size_of_0_or_above_127_is_aborted),
		cmocka_unit_test(test_an_empty_value_is_sent_as_one_empty_segment),
		cmocka_unit_test(test_a_full_bus_delays_the_segments),
		cmocka_unit_test(test_a_bus_that_stays_full_until_the_timeout_ends_the_transfer),
		cmocka_unit_test(test_an_answer_that_belongs_to_another_step_is_aborted),
		cmocka_unit_test(test_a_transfer_after_an_interrupted_one_starts_afresh),
		cmocka_unit_test(test_a_bus_that_accepts_no_segment_ends_the_transfer),
		cmocka_unit_test(test_a_server_that_does_not_acknowledge_is_a_timeout),
		cmocka_unit_test(test_an_unexpected_command_is_aborted),
		cmocka_unit_test(test_frames_are_received_after_every_16_segments_sent),
		cmocka_unit_test(test_each_segment_of_an_upload_restarts_the_timeout),
		cmocka_unit_test(test_an_acknowledgement_restarts_the_timeout),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

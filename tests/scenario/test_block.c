/* SDO block transfer: CiA 301, 7.2.4.3.9 to 7.2.4.3.16. The CRC of "123456789" is 31C3h; the other CRCs were
 * computed by a bitwise implementation outside this project. */
#include "od/little_endian.h"
#include "tests/scenario/bus.h"

#include <string.h>

#include "drivers/ports/can.h"

static struct od_domain domain;

/* Sets the content of 1021h. */
static void set_domain(struct bus *bus, const void *data, size_t size)
{
	domain = (struct od_domain){.index = 0x1021, .data = data, .size = size};
	od_set_domain(&bus->od, &domain);
}

/* ---- upload ------------------------------------------------------------------------------------------------------ */

static void test_a_block_upload_gives_size_segments_and_crc(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_expect(bus, "590 01 31 32 33 34 35 36 37");
	bus_expect(bus, "590 82 38 39 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 D5 C3 31 00 00 00 00 00");
	bus_send(bus, "610 A1 00 00 00 00 00 00 00");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_client_without_crc_receives_a_crc_of_0(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 D5 00 00 00 00 00 00 00");
}

static void test_the_client_sets_the_size_of_each_sub_block(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "ABCDEFGHIJKLMNOPQRSTUVWXYZ", 26);
	bus_exchange(bus, "610 A4 21 10 00 01 00 00 00", "590 C6 21 10 00 1A 00 00 00");
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 01 41 42 43 44 45 46 47");
	bus_send(bus, "610 A2 01 02 00 00 00 00 00");
	bus_expect(bus, "590 01 48 49 4A 4B 4C 4D 4E");
	bus_expect(bus, "590 02 4F 50 51 52 53 54 55");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 81 56 57 58 59 5A 00 00");
	bus_exchange(bus, "610 A2 01 7F 00 00 00 00 00", "590 C9 AF E8 00 00 00 00 00");
}

static void test_segments_that_the_client_misses_are_sent_again(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "ABCDEFGHIJKLMNOPQRSTUVWXYZ", 26);
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 1A 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus); /* the second of four is lost */
	bus_send(bus, "610 A2 01 7F 00 00 00 00 00");
	bus_expect(bus, "590 01 48 49 4A 4B 4C 4D 4E");
	bus_expect(bus, "590 02 4F 50 51 52 53 54 55");
	bus_expect(bus, "590 83 56 57 58 59 5A 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 81 56 57 58 59 5A 00 00"); /* the last one */
	bus_exchange(bus, "610 A2 01 7F 00 00 00 00 00", "590 C9 AF E8 00 00 00 00 00");
}

static void test_a_sub_block_without_an_acknowledged_segment_is_sent_again(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_send(bus, "610 A2 00 7F 00 00 00 00 00");
	bus_expect(bus, "590 01 31 32 33 34 35 36 37");
	bus_expect(bus, "590 82 38 39 00 00 00 00 00");
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 D5 C3 31 00 00 00 00 00");
}

static void test_small_and_empty_values_are_uploaded_in_blocks_too(void **state)
{
	struct bus *bus = *state;
	const struct od_entry *entry = od_find(bus->od.table, 0x1009, 0, NULL);

	bus_exchange(bus, "610 A4 01 20 00 7F 00 00 00", "590 C6 01 20 00 01 00 00 00");
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 81 02 00 00 00 00 00 00");
	bus_exchange(bus, "610 A2 01 7F 00 00 00 00 00", "590 D9 42 20 00 00 00 00 00");
	memset((uint8_t *)&bus->values + entry->offset, 0, entry->size);
	bus_exchange(bus, "610 A4 09 10 00 7F 00 00 00", "590 C6 09 10 00 00 00 00 00");
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 81 00 00 00 00 00 00 00");
	bus_exchange(bus, "610 A2 01 7F 00 00 00 00 00", "590 DD 00 00 00 00 00 00 00");
}

static void test_seven_bytes_fill_one_segment(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "1234567", 7);
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 07 00 00 00");
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 81 31 32 33 34 35 36 37");
	bus_exchange(bus, "610 A2 01 7F 00 00 00 00 00", "590 C1 00 00 00 00 00 00 00");
}

static void test_up_to_the_protocol_switch_threshold_the_upload_is_not_a_block_upload(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 A4 08 10 00 7F 14 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 A4 01 20 00 7F 04 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_exchange(bus, "610 A4 08 10 00 7F 13 00 00", "590 C6 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 A4 01 20 00 7F 04 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus); /* the previous transfer has ended */
}

static void test_a_block_size_of_0_or_above_127_is_refused(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A4 21 10 00 00 00 00 00", "590 80 21 10 00 02 00 04 05");
	bus_exchange(bus, "610 A4 21 10 00 80 00 00 00", "590 80 21 10 00 02 00 04 05");
	bus_exchange(bus, "610 A4 21 10 00 01 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 01 31 32 33 34 35 36 37");
	bus_exchange(bus, "610 A2 01 80 00 00 00 00 00", "590 80 21 10 00 02 00 04 05");
}

static void test_a_segment_that_was_never_sent_cannot_be_acknowledged(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_exchange(bus, "610 A2 03 7F 00 00 00 00 00", "590 80 21 10 00 03 00 04 05");
}

static void test_an_object_that_cannot_be_read_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 A4 FF 2F 00 7F 00 00 00", "590 80 FF 2F 00 00 00 02 06");
	bus_exchange(bus, "610 A4 00 20 09 7F 00 00 00", "590 80 00 20 09 11 00 09 06");
	bus_exchange(bus, "610 A4 40 20 06 7F 00 00 00", "590 80 40 20 06 01 00 01 06");
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 80 21 10 00 24 00 00 08");
}

static void test_an_upload_command_in_the_wrong_state_is_refused(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A3 00 00 00 00 00 00 00", "590 80 00 00 00 01 00 04 05");
	bus_exchange(bus, "610 A2 02 7F 00 00 00 00 00", "590 80 02 7F 00 01 00 04 05");
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_exchange(bus, "610 A2 00 7F 00 00 00 00 00", "590 80 21 10 00 01 00 04 05");
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_exchange(bus, "610 A1 00 00 00 00 00 00 00", "590 80 21 10 00 01 00 04 05");
}

static void test_an_upload_without_a_response_of_the_client_times_out(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_run(bus, 999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 21 10 00 00 00 04 05");

	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_run(bus, 999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 21 10 00 00 00 04 05");

	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_send(bus, "610 A2 02 7F 00 00 00 00 00");
	bus_forget(bus);
	bus_run(bus, 1000000);
	bus_expect(bus, "590 80 21 10 00 00 00 04 05");
}

static void test_an_abort_or_a_new_request_ends_an_upload(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[1000];

	set_domain(bus, content, sizeof(content));
	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 E8 03 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_send(bus, "610 80 21 10 00 00 00 00 08");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);

	bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 E8 03 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_pdos_are_sent_between_the_segments_of_a_sub_block(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[1000];

	set_domain(bus, content, sizeof(content));
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 E8 03 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	assert_int_equal(bus->sent_count - bus->seen, 16);
	bus_forget(bus);
	bus_send(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 100);
	assert_int_equal(bus->sent[bus->sent_count - 1].msg.data[0], 127);
}

static uint16_t crc_bit_by_bit(const uint8_t *data, size_t size)
{
	uint16_t crc = 0;

	for (size_t i = 0; i < size * 8; i++) {
		unsigned bit = data[i / 8] >> (7 - i % 8) & 1;

		crc = (uint16_t)((crc >> 15 ^ bit) & 1 ? crc << 1 ^ 0x1021 : crc << 1);
	}
	return crc;
}

/* The data bytes of the segments on one channel, each in order. */
static size_t received_on(const struct bus *bus, uint32_t id, uint8_t *got)
{
	size_t segments = 0;

	for (size_t i = bus->seen; i < bus->sent_count; i++) {
		const struct can_msg *msg = &bus->sent[i].msg;

		if (msg->id != id)
			continue;
		assert_int_equal(msg->data[0] & 0x7F, segments + 1);
		memcpy(got + segments++ * 7, msg->data + 1, 7);
	}
	return segments * 7;
}

static void test_eight_uploads_share_the_segments_sent_at_a_time_and_each_is_complete(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[889], got[BUS_FRAMES * 7]; /* 127 segments */
	uint16_t crc;

	for (size_t i = 0; i < sizeof(content); i++)
		content[i] = (uint8_t)(i * i >> 3);
	crc = crc_bit_by_bit(content, sizeof(content));
	set_domain(bus, content, sizeof(content));
	for (uint16_t n = 1; n < 8; n++) {
		assert_int_equal(bus_write(bus, 0x1200 + n, 1, 4, 0x680u + n), 0);
		assert_int_equal(bus_write(bus, 0x1200 + n, 2, 4, 0x690u + n), 0);
	}
	for (uint32_t n = 1; n < 8; n++)
		bus_send_msg(bus, &(struct can_msg){.id = 0x680 + n, .len = 8, .data = {0xA4, 0x21, 0x10, 0, 127}});
	bus_forget(bus);
	for (uint32_t n = 1; n < 8; n++)
		bus_send_msg(bus, &(struct can_msg){.id = 0x680 + n, .len = 8, .data = {0xA3}});
	for (int i = 0; i < 200; i++) {
		size_t before = bus->sent_count;
		bus_run(bus, 1);
		assert_in_range(bus->sent_count - before, 0, 16);
	}
	for (uint32_t n = 1; n < 8; n++) {
		assert_int_equal(received_on(bus, 0x690 + n, got), sizeof(content));
		assert_memory_equal(got, content, sizeof(content));
	}
	for (uint32_t n = 1; n < 8; n++) {
		bus_forget(bus);
		bus_send_msg(bus, &(struct can_msg){.id = 0x680 + n, .len = 8, .data = {0xA2, 127, 127}});
		assert_int_equal(bus->sent[bus->seen].msg.data[0], 0xC1);
		assert_int_equal(get_u16(bus->sent[bus->seen].msg.data + 1), crc);
	}
}

static void test_a_full_bus_delays_the_segments_and_none_is_lost(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[889]; /* 127 segments */

	set_domain(bus, content, sizeof(content));
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 79 03 00 00");
	bus->full = true;
	bus_send(bus, "080");
	assert_int_equal(bus->port.queue_count, 4);
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_run(bus, 300000);
	assert_int_equal(bus->port.queue_count, 4);
	bus_expect_nothing(bus);
	bus->full = false;
	can_service(&bus->port, bus->now_us);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
	bus_expect(bus, "390 00 00 00 00 00 00 00 00");
	bus_expect(bus, "490 00 00 00 00 00 00 00 00");
	bus_run(bus, 2000);
	for (unsigned i = 1; i <= 127; i++) {
		assert_true(bus->seen < bus->sent_count);
		assert_int_equal(bus->sent[bus->seen++].msg.data[0], i | (i == 127 ? 0x80 : 0));
	}
	bus_expect_nothing(bus);
}

static void test_a_sub_block_does_not_time_out_on_a_slow_bus(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[889];

	set_domain(bus, content, sizeof(content));
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 79 03 00 00");
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	for (int i = 0; i < 10; i++) { /* one frame per 600 ms */
		bus->full = true;
		bus_run(bus, 600000);
		assert_int_equal(bus->port.queue_count, 1);
		bus->full = false;
		can_service(&bus->port, bus->now_us);
	}
	bus_run(bus, 2000);
	assert_int_equal(bus->sent_count - bus->seen, 127);
}

static void test_a_bus_that_stays_full_ends_the_upload(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 A0 21 10 00 7F 00 00 00", "590 C6 21 10 00 09 00 00 00");
	bus->full = true;
	bus_send(bus, "610 A3 00 00 00 00 00 00 00");
	bus_run(bus, 2000000);
	bus->full = false;
	can_service(&bus->port, bus->now_us);
	bus_expect(bus, "590 01 31 32 33 34 35 36 37");
	bus_expect(bus, "590 80 21 10 00 00 00 04 05");
	bus_expect_nothing(bus);
}

/* xorshift32 */
static uint32_t next(uint32_t *seed)
{
	*seed ^= *seed << 13;
	*seed ^= *seed >> 17;
	*seed ^= *seed << 5;
	return *seed;
}

/* Receives the segments of one sub-block, each of which is lost with a probability of 1 / `odds`. Returns the number of
 * the last one in order; adds to *got, and sets *last after the last segment of the value. */
static uint8_t take_sub_block(struct bus *bus, uint32_t *seed, uint32_t odds, uint8_t *got, size_t *size, bool *last)
{
	uint8_t sequence = 0;

	for (; bus->seen < bus->sent_count; bus->seen++) {
		const uint8_t *segment = bus->sent[bus->seen].msg.data;

		if ((segment[0] & 0x7F) != sequence + 1 || next(seed) % odds == 0)
			continue;
		memcpy(got + *size, segment + 1, 7);
		*size += 7;
		sequence++;
		*last = segment[0] & 0x80;
	}
	return sequence;
}

static void test_a_large_upload_completes_with_any_loss_of_segments(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[50000], got[50000 + 7];
	uint32_t seed = 42;

	for (size_t i = 0; i < sizeof(content); i++)
		content[i] = (uint8_t)next(&seed);
	for (uint32_t odds = 10; odds <= 100000; odds *= 100) {
		struct can_msg acknowledge = {.id = 0x610, .len = 8, .data = {0xA2}};
		const uint8_t *end;
		size_t size = 0;
		bool last = false;

		set_domain(bus, content, sizeof(content));
		bus_exchange(bus, "610 A4 21 10 00 7F 00 00 00", "590 C6 21 10 00 50 C3 00 00");
		bus_send(bus, "610 A3 00 00 00 00 00 00 00");
		while (!last) {
			bus_run(bus, 1000);
			acknowledge.data[1] = take_sub_block(bus, &seed, odds, got, &size, &last);
			acknowledge.data[2] = (uint8_t)(1 + next(&seed) % 127);
			bus->sent_count = bus->seen = 0;
			bus_send_msg(bus, &acknowledge);
		}
		end = bus->sent[0].msg.data;
		assert_int_equal(bus->sent_count, 1);
		assert_int_equal(end[0] & 0xE3, 0xC1);
		assert_int_equal(size - (end[0] >> 2 & 7u), sizeof(content));
		assert_memory_equal(got, content, sizeof(content));
		assert_int_equal(end[1] | end[2] << 8, crc_bit_by_bit(content, sizeof(content)));
		bus_forget(bus);
		bus_send(bus, "610 A1 00 00 00 00 00 00 00");
		bus_expect_nothing(bus);
	}
}

static void test_every_block_size_from_1_to_127_gives_the_same_bytes(void **state)
{
	struct bus *bus = *state;
	uint8_t content[1000];

	for (size_t i = 0; i < sizeof(content); i++)
		content[i] = (uint8_t)(i * 31 + i / 7);
	set_domain(bus, content, sizeof(content));
	for (uint8_t block_size = 1; block_size <= 127; block_size++) {
		struct can_msg open = {.id = 0x610, .len = 8, .data = {0xA0, 0x21, 0x10, 0, block_size}};
		struct can_msg acknowledge = {.id = 0x610, .len = 8, .data = {0xA3}};
		uint8_t got[1008];
		size_t size = 0;
		bool last = false;

		bus->sent_count = bus->seen = 0;
		bus_send_msg(bus, &open);
		bus_expect(bus, "590 C6 21 10 00 E8 03 00 00");
		while (!last) {
			uint8_t sequence = 0;

			bus_send_msg(bus, &acknowledge);
			bus_run(bus, 1000);
			while (bus->seen < bus->sent_count) {
				const uint8_t *segment = bus->sent[bus->seen++].msg.data;

				assert_int_equal(segment[0] & 0x7F, ++sequence);
				memcpy(got + size, segment + 1, 7);
				size += 7;
				last = segment[0] & 0x80;
			}
			assert_true(sequence == block_size || last);
			acknowledge = (struct can_msg){.id = 0x610, .len = 8, .data = {0xA2, sequence, block_size}};
		}
		bus_send_msg(bus, &acknowledge);
		bus_expect(bus, "590 C5 00 00 00 00 00 00 00");
		bus_send(bus, "610 A1 00 00 00 00 00 00 00");
		assert_memory_equal(got, content, sizeof(content));
	}
}

static void test_reserved_bits_and_bytes_are_ignored_in_block_transfers(void **state)
{
	struct bus *bus = *state;

	set_domain(bus, "123456789", 9);
	bus_exchange(bus, "610 BC 21 10 00 7F 00 EE EE", "590 C6 21 10 00 09 00 00 00");
	bus_send(bus, "610 BF EE EE EE EE EE EE EE");
	bus_forget(bus);
	bus_exchange(bus, "610 BE 02 7F EE EE EE EE EE", "590 D5 C3 31 00 00 00 00 00");
	bus_send(bus, "610 BD EE EE EE EE EE EE EE");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

/* ---- download ---------------------------------------------------------------------------------------------------- */

static void test_a_block_download_is_written_at_its_end(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C6 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 0);
	bus_exchange(bus, "610 CD 24 DC 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 1.0f);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_wrong_crc_is_refused_and_the_old_value_stays(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C6 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 CD 25 DC 00 00 00 00 00", "590 80 00 20 01 04 00 04 05");
	assert_true(bus->values.lever_arm.l == 0);
}

static void test_the_crc_of_a_client_without_crc_is_not_checked(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 CD 00 00 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 1.0f);
}

static void test_a_block_download_without_a_size_is_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C0 00 20 01 00 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 CD 00 00 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 1.0f);
}

static void test_a_download_of_several_segments_is_written(void **state)
{
	struct bus *bus = *state;
	const char *text = bus_writable_string(bus);

	bus_exchange(bus, "610 C6 09 10 00 1A 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_send(bus, "610 01 41 42 43 44 45 46 47");
	bus_send(bus, "610 02 48 49 4A 4B 4C 4D 4E");
	bus_send(bus, "610 03 4F 50 51 52 53 54 55");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 84 56 57 58 59 5A 00 00", "590 A2 04 1F 00 00 00 00 00");
	bus_exchange(bus, "610 C9 AF E8 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_string_equal(text, "ABCDEFGHIJKLMNOPQRSTUVWXYZ");
}

static void test_a_lost_segment_is_requested_at_the_end_of_the_sub_block(void **state)
{
	struct bus *bus = *state;
	const char *text = bus_writable_string(bus);

	bus_exchange(bus, "610 C6 09 10 00 1A 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_send(bus, "610 01 41 42 43 44 45 46 47"); /* 02 is lost */
	bus_send(bus, "610 03 4F 50 51 52 53 54 55");
	bus_exchange(bus, "610 84 56 57 58 59 5A 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_send(bus, "610 01 48 49 4A 4B 4C 4D 4E");
	bus_send(bus, "610 02 4F 50 51 52 53 54 55");
	bus_exchange(bus, "610 83 56 57 58 59 5A 00 00", "590 A2 03 1F 00 00 00 00 00");
	bus_exchange(bus, "610 C9 AF E8 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_string_equal(text, "ABCDEFGHIJKLMNOPQRSTUVWXYZ");
}

static void test_segment_31_ends_a_sub_block_even_if_segments_were_lost(void **state)
{
	struct bus *bus = *state;

	bus_writable_string(bus);
	bus_exchange(bus, "610 C6 09 10 00 1A 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_send(bus, "610 01 41 42 43 44 45 46 47");
	bus_exchange(bus, "610 1F 41 42 43 44 45 46 47", "590 A2 01 1F 00 00 00 00 00");
}

static void test_a_lost_last_segment_is_requested_after_half_a_second(void **state)
{
	struct bus *bus = *state;
	const char *text = bus_writable_string(bus);

	bus_exchange(bus, "610 C6 09 10 00 1A 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_send(bus, "610 01 41 42 43 44 45 46 47");
	bus_run(bus, 400000);
	bus_send(bus, "610 02 48 49 4A 4B 4C 4D 4E");
	bus_send(bus, "610 03 4F 50 51 52 53 54 55"); /* 84 is lost */
	bus_run(bus, 499999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 A2 03 1F 00 00 00 00 00");
	bus_exchange(bus, "610 81 56 57 58 59 5A 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 C9 AF E8 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_string_equal(text, "ABCDEFGHIJKLMNOPQRSTUVWXYZ");
}

static void test_a_download_without_segments_times_out(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C6 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_run(bus, 500000);
	bus_expect(bus, "590 A2 00 1F 00 00 00 00 00");
	bus_run(bus, 499999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 00 20 01 00 00 04 05");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);

	bus_exchange(bus, "610 C6 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_run(bus, 1000000);
	bus_expect(bus, "590 80 00 20 01 00 00 04 05");
	bus_expect_nothing(bus);

	bus_writable_string(bus);
	bus_exchange(bus, "610 C6 09 10 00 1A 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_run(bus, 400000);
	bus_send(bus, "610 01 41 42 43 44 45 46 47");
	bus_run(bus, 999999);
	bus_expect(bus, "590 A2 01 1F 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 09 10 00 00 00 04 05");
}

static void test_a_wrong_size_is_refused_before_or_after_the_segments(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C6 00 20 01 05 00 00 00", "590 80 00 20 01 12 00 07 06");
	bus_exchange(bus, "610 C6 00 20 01 03 00 00 00", "590 80 00 20 01 13 00 07 06");
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 C9 00 00 00 00 00 00 00", "590 80 00 20 01 12 00 07 06"); /* 5 bytes */
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 D1 00 00 00 00 00 00 00", "590 80 00 20 01 13 00 07 06"); /* 3 bytes */
	bus_exchange(bus, "610 C0 00 20 01 00 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 80 3F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 D1 00 00 00 00 00 00 00", "590 80 00 20 01 13 00 07 06"); /* 3 bytes */
	assert_true(bus->values.lever_arm.l == 0);
}

static void test_a_segment_beyond_the_size_is_refused_at_once(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_send(bus, "610 01 00 00 80 3F 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 02 00 00 00 00 00 00 00", "590 80 00 20 01 12 00 07 06");

	bus_writable_string(bus);
	bus_exchange(bus, "610 C2 09 10 00 07 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_send(bus, "610 01 41 42 43 44 45 46 47");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 82 00 00 00 00 00 00 00", "590 80 09 10 00 12 00 07 06");
}

static void test_an_empty_string_is_one_empty_segment(void **state)
{
	struct bus *bus = *state;
	const char *text = bus_writable_string(bus);

	bus_exchange(bus, "610 C2 09 10 00 00 00 00 00", "590 A4 09 10 00 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 00 00 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 DD 00 00 00 00 00 00 00", "590 A1 00 00 00 00 00 00 00");
	assert_string_equal(text, "");
}

static void test_the_limits_of_an_object_apply_to_a_block_download(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 81 00 00 C0 7F 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_exchange(bus, "610 CD 00 00 00 00 00 00 00", "590 80 00 20 01 30 00 09 06"); /* NaN */
	bus_exchange(bus, "610 C6 00 10 00 04 00 00 00", "590 80 00 10 00 02 00 01 06");
	bus_exchange(bus, "610 C6 FF 2F 00 04 00 00 00", "590 80 FF 2F 00 00 00 02 06");
}

static void test_segment_number_0_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 00 00 00 80 3F 00 00 00", "590 80 00 20 01 03 00 04 05");
}

static void test_a_download_end_in_the_wrong_state_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C1 00 00 00 00 00 00 00", "590 80 00 00 00 01 00 04 05");
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 CD 24 DC 00 00 00 00 00", "590 80 00 20 01 01 00 04 05");
}

static void test_an_abort_or_any_new_request_ends_a_download(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_send(bus, "610 80 00 20 01 00 00 00 08");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 2F 01 20 00 01 00 00 00", "590 60 01 20 00 00 00 00 00");
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 C2 00 20 02 04 00 00 00", "590 A4 00 20 02 1F 00 00 00");
	bus_exchange(bus, "610 A0 01 20 00 7F 00 00 00", "590 C6 01 20 00 01 00 00 00");
	bus_exchange(bus, "610 C2 00 20 01 04 00 00 00", "590 A4 00 20 01 1F 00 00 00");
	bus_exchange(bus, "610 E0 00 00 00 00 00 00 00", "590 80 00 20 01 01 00 04 05");
}

static void test_the_response_to_a_block_download_waits_for_the_storage(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "610 C6 10 10 01 04 00 00 00", "590 A4 10 10 01 1F 00 00 00");
	bus_exchange(bus, "610 81 73 61 76 65 00 00 00", "590 A2 01 1F 00 00 00 00 00");
	bus_send(bus, "610 CD 0E EB 00 00 00 00 00");
	bus_expect_nothing(bus);
	canopen_store_done(&bus->node, OD_OK, bus->now_us);
	bus_expect(bus, "590 A1 00 00 00 00 00 00 00");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_a_block_upload_gives_size_segments_and_crc),
		PRE_OPERATIONAL(test_a_client_without_crc_receives_a_crc_of_0),
		PRE_OPERATIONAL(test_the_client_sets_the_size_of_each_sub_block),
		PRE_OPERATIONAL(test_segments_that_the_client_misses_are_sent_again),
		PRE_OPERATIONAL(test_a_sub_block_without_an_acknowledged_segment_is_sent_again),
		PRE_OPERATIONAL(test_small_and_empty_values_are_uploaded_in_blocks_too),
		PRE_OPERATIONAL(test_seven_bytes_fill_one_segment),
		PRE_OPERATIONAL(test_up_to_the_protocol_switch_threshold_the_upload_is_not_a_block_upload),
		PRE_OPERATIONAL(test_a_block_size_of_0_or_above_127_is_refused),
		PRE_OPERATIONAL(test_a_segment_that_was_never_sent_cannot_be_acknowledged),
		PRE_OPERATIONAL(test_an_object_that_cannot_be_read_is_refused),
		PRE_OPERATIONAL(test_an_upload_command_in_the_wrong_state_is_refused),
		PRE_OPERATIONAL(test_an_upload_without_a_response_of_the_client_times_out),
		PRE_OPERATIONAL(test_an_abort_or_a_new_request_ends_an_upload),
		OPERATIONAL(test_pdos_are_sent_between_the_segments_of_a_sub_block),
		OPERATIONAL(test_eight_uploads_share_the_segments_sent_at_a_time_and_each_is_complete),
		OPERATIONAL(test_a_full_bus_delays_the_segments_and_none_is_lost),
		PRE_OPERATIONAL(test_a_sub_block_does_not_time_out_on_a_slow_bus),
		PRE_OPERATIONAL(test_a_bus_that_stays_full_ends_the_upload),
		PRE_OPERATIONAL(test_a_large_upload_completes_with_any_loss_of_segments),
		PRE_OPERATIONAL(test_every_block_size_from_1_to_127_gives_the_same_bytes),
		PRE_OPERATIONAL(test_reserved_bits_and_bytes_are_ignored_in_block_transfers),
		PRE_OPERATIONAL(test_a_block_download_is_written_at_its_end),
		PRE_OPERATIONAL(test_a_wrong_crc_is_refused_and_the_old_value_stays),
		PRE_OPERATIONAL(test_the_crc_of_a_client_without_crc_is_not_checked),
		PRE_OPERATIONAL(test_a_block_download_without_a_size_is_written),
		PRE_OPERATIONAL(test_a_download_of_several_segments_is_written),
		PRE_OPERATIONAL(test_a_lost_segment_is_requested_at_the_end_of_the_sub_block),
		PRE_OPERATIONAL(test_segment_31_ends_a_sub_block_even_if_segments_were_lost),
		PRE_OPERATIONAL(test_a_lost_last_segment_is_requested_after_half_a_second),
		PRE_OPERATIONAL(test_a_download_without_segments_times_out),
		PRE_OPERATIONAL(test_a_wrong_size_is_refused_before_or_after_the_segments),
		PRE_OPERATIONAL(test_a_segment_beyond_the_size_is_refused_at_once),
		PRE_OPERATIONAL(test_an_empty_string_is_one_empty_segment),
		PRE_OPERATIONAL(test_the_limits_of_an_object_apply_to_a_block_download),
		PRE_OPERATIONAL(test_segment_number_0_is_refused),
		PRE_OPERATIONAL(test_a_download_end_in_the_wrong_state_is_refused),
		PRE_OPERATIONAL(test_an_abort_or_any_new_request_ends_a_download),
		PRE_OPERATIONAL(test_the_response_to_a_block_download_waits_for_the_storage),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

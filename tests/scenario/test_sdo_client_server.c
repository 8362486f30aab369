/* The SDO client against the real SDO server, frame by frame in simulated time; some frames are lost. */
#include <string.h>

#include "gateway/canopen/client/sdo_client.h"
#include "tests/scenario/bus.h"

enum { TIMEOUT_US = 100000, DOMAIN_BYTES = 20000, NONE_LOST = -1 };

struct pair {
	struct can_port port; /* of the client; first, so that ops->send() can cast it */
	struct bus *bus;
	struct sdo_client client;
	int lost_answer;		  /* the response with this number is lost */
	unsigned lost_requests, requests; /* of a block download: one segment of this number is lost; 0: none */
	unsigned lost_segments, segments; /* of a block upload: one segment of this number is lost; 0: none */
	uint8_t value[DOMAIN_BYTES];
};

static int to_node(struct can_port *port, const struct can_msg *msg)
{
	struct pair *pair = (struct pair *)port;
	bool segment = pair->client.phase == SDO_BLOCK_DOWNLOAD && msg->data[0] != 0x80;

	if (segment && pair->lost_requests && ++pair->requests % pair->lost_requests == 0)
		return 0;
	bus_send_msg(pair->bus, msg);
	return 0;
}

static struct pair *pair_new(struct bus *bus)
{
	static const struct can_ops ops = {.send = to_node};
	static struct pair pair;

	pair = (struct pair){.port = {.ops = &ops, .fd = -1}, .bus = bus, .lost_answer = NONE_LOST};
	sdo_client_init(&pair.client, &pair.port, BUS_NODE_ID, TIMEOUT_US);
	return &pair;
}

static bool is_lost(struct pair *pair)
{
	if (pair->lost_segments && pair->client.phase == SDO_BLOCK_UPLOAD)
		return ++pair->segments % pair->lost_segments == 0;
	return pair->lost_answer-- == 0;
}

static enum sdo_result finish(struct pair *pair)
{
	struct bus *bus = pair->bus;

	while (pair->client.result == SDO_RUNNING) {
		if (bus->seen == bus->sent_count) {
			uint64_t client_us = sdo_client_tick(&pair->client, bus->now_us);

			if (bus->seen < bus->sent_count || pair->client.result != SDO_RUNNING)
				continue;
			bus_run(bus, (client_us < bus->deadline_us ? client_us : bus->deadline_us) - bus->now_us);
			continue;
		}
		const struct can_msg *msg = &bus->sent[bus->seen++].msg;
		if (!is_lost(pair))
			sdo_client_receive(&pair->client, msg, bus->now_us);
	}
	return pair->client.result;
}

static enum sdo_result read_object(struct pair *pair, uint16_t index, uint8_t sub)
{
	sdo_client_upload(&pair->client, index, sub, pair->value, sizeof(pair->value), pair->bus->now_us);
	return finish(pair);
}

static enum sdo_result write_object(struct pair *pair, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	sdo_client_download(&pair->client, index, sub, data, size, pair->bus->now_us);
	return finish(pair);
}

static uint8_t *set_domain(struct pair *pair, struct od_domain *domain)
{
	static uint8_t text[DOMAIN_BYTES];

	for (size_t i = 0; i < sizeof(text); i++)
		text[i] = (uint8_t)(i * 7 + i / 256);
	*domain = (struct od_domain){.index = 0x1021, .data = text, .size = sizeof(text)};
	od_set_domain(&pair->bus->od, domain);
	return text;
}

static void test_the_client_reads_every_readable_object_as_in_the_dictionary(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	const struct od_table *table = bus->od.table;
	size_t compared = 0;

	for (size_t i = 0; i < table->count; i++) {
		const struct od_entry *entry = &table->entries[i];
		uint8_t want[OD_VALUE_MAX];
		size_t size;

		if (od_read(&bus->od, entry->index, entry->sub, want, sizeof(want), &size) != OD_OK)
			continue;
		if (entry->index == 0x1003 && entry->sub > 0)
			continue; /* no error was recorded: no data */
		assert_int_equal(read_object(pair, entry->index, entry->sub), SDO_DONE);
		assert_int_equal(pair->client.size, size);
		assert_memory_equal(pair->value, want, size);
		compared++;
	}
	assert_true(compared > 100);
}

static void test_an_object_that_cannot_be_read_is_aborted_with_the_code_of_its_status(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	const struct od_table *table = bus->od.table;
	size_t refused = 0;

	for (size_t i = 0; i < table->count; i++) {
		const struct od_entry *entry = &table->entries[i];
		uint8_t wire[OD_VALUE_MAX];
		size_t size;
		enum od_status status = od_read(&bus->od, entry->index, entry->sub, wire, sizeof(wire), &size);

		if (status == OD_OK || entry->type == OD_DOMAIN)
			continue;
		assert_int_equal(read_object(pair, entry->index, entry->sub), SDO_ABORTED);
		assert_int_equal(pair->client.abort_code, sdo_abort_code(status));
		refused++;
	}
	assert_true(refused > 0);
}

static void test_a_string_of_more_than_four_bytes_is_read_completely(void **state)
{
	struct pair *pair = pair_new(*state);

	assert_int_equal(read_object(pair, 0x1008, 0), SDO_DONE);
	assert_int_equal(pair->client.size, strlen("IMU9 CANopen gateway"));
	assert_memory_equal(pair->value, "IMU9 CANopen gateway", pair->client.size);
}

static void test_a_long_domain_is_read_completely_with_seven_bytes_per_frame(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	struct od_domain domain;
	const uint8_t *want = set_domain(pair, &domain);
	size_t before = bus->sent_count;

	assert_int_equal(read_object(pair, 0x1021, 0), SDO_DONE);
	assert_int_equal(pair->client.size, DOMAIN_BYTES);
	assert_memory_equal(pair->value, want, DOMAIN_BYTES);
	assert_int_equal(bus->sent_count - before, 1 + (DOMAIN_BYTES + 6) / 7);
}

static void test_a_long_domain_is_read_completely_in_blocks_with_any_segments_lost(void **state)
{
	struct bus *bus = *state;
	struct od_domain domain;
	static const unsigned patterns[] = {0, 200, 400};

	for (size_t i = 0; i < sizeof(patterns) / sizeof(patterns[0]); i++) {
		struct pair *pair = pair_new(bus);

		bus->sent_count = bus->seen = 0;
		bus->od.domains = NULL;
		const uint8_t *want = set_domain(pair, &domain);
		pair->lost_segments = patterns[i];
		sdo_client_block_upload(&pair->client, 0x1021, 0, pair->value, sizeof(pair->value), bus->now_us);
		assert_int_equal(finish(pair), SDO_DONE);
		assert_int_equal(pair->client.size, DOMAIN_BYTES);
		assert_memory_equal(pair->value, want, DOMAIN_BYTES);
	}
}

static enum od_status keep(void *ctx, const uint8_t *data, size_t size)
{
	struct pair *pair = ctx;

	memcpy(pair->value, data, size);
	pair->segments = (unsigned)size;
	return OD_OK;
}

static void test_a_long_domain_is_written_completely_in_blocks_with_any_segments_lost(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	struct od_domain domain = {.index = 0x2130, .write = keep, .ctx = pair};
	static uint8_t content[OD_DOMAIN_MAX];

	for (size_t i = 0; i < sizeof(content); i++)
		content[i] = (uint8_t)(i * 13 + i / 200);
	od_set_domain(&bus->od, &domain);
	for (unsigned lost = 11; lost < 40; lost += 3) {
		bus->sent_count = bus->seen = 0;
		pair->segments = 0;
		pair->lost_requests = lost;
		pair->client.timeout_us = 2000000; /* the server requests lost segments after half a second */
		sdo_client_block_download(&pair->client, 0x2130, 0, content, sizeof(content), bus->now_us);
		assert_int_equal(finish(pair), SDO_DONE);
		assert_int_equal(pair->segments, sizeof(content));
		assert_memory_equal(pair->value, content, sizeof(content));
	}
}

static void test_a_written_value_is_in_the_dictionary(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	const float lever_arm_l = 0.05f;

	assert_int_equal(write_object(pair, 0x2000, 1, &lever_arm_l, 4), SDO_DONE);
	assert_true(bus->values.lever_arm.l == lever_arm_l);
}

static void test_a_value_above_its_limit_is_aborted_and_the_old_one_stays(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	const float too_high = 10.5f;

	assert_int_equal(write_object(pair, 0x2000, 1, &too_high, 4), SDO_ABORTED);
	assert_true(pair->client.aborted_by_server);
	assert_int_equal(pair->client.abort_code, 0x06090031);
	assert_true(bus->values.lever_arm.l == 0);
}

static void test_a_value_of_too_many_bytes_is_aborted(void **state)
{
	struct pair *pair = pair_new(*state);

	assert_int_equal(write_object(pair, 0x2000, 1, "0123456789", 10), SDO_ABORTED);
	assert_int_equal(pair->client.abort_code, 0x06070012);
}

static void test_an_unknown_object_is_aborted(void **state)
{
	struct pair *pair = pair_new(*state);

	assert_int_equal(read_object(pair, 0x4000, 0), SDO_ABORTED);
	assert_int_equal(pair->client.abort_code, 0x06020000);
	assert_int_equal(read_object(pair, 0x2000, 9), SDO_ABORTED);
	assert_int_equal(pair->client.abort_code, 0x06090011);
}

static void test_a_lost_response_is_a_timeout_and_the_next_transfer_succeeds(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);
	uint64_t begin_us = bus->now_us;

	pair->lost_answer = 0;
	assert_int_equal(read_object(pair, 0x1000, 0), SDO_TIMEOUT);
	assert_int_equal(bus->now_us - begin_us, TIMEOUT_US);
	assert_int_equal(read_object(pair, 0x1000, 0), SDO_DONE);
}

static void test_a_lost_segment_is_a_timeout_and_the_next_transfer_succeeds(void **state)
{
	struct pair *pair = pair_new(*state);
	struct od_domain domain;

	set_domain(pair, &domain);
	pair->lost_answer = 100;
	assert_int_equal(read_object(pair, 0x1021, 0), SDO_TIMEOUT);
	assert_int_equal(pair->client.size, 99 * 7);
	assert_int_equal(read_object(pair, 0x1021, 0), SDO_DONE);
	assert_int_equal(pair->client.size, DOMAIN_BYTES);
}

static void test_a_stopped_node_does_not_respond(void **state)
{
	struct bus *bus = *state;
	struct pair *pair = pair_new(bus);

	bus_send(bus, "000 02 10");
	assert_int_equal(read_object(pair, 0x1000, 0), SDO_TIMEOUT);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_the_client_reads_every_readable_object_as_in_the_dictionary),
		PRE_OPERATIONAL(test_an_object_that_cannot_be_read_is_aborted_with_the_code_of_its_status),
		PRE_OPERATIONAL(test_a_string_of_more_than_four_bytes_is_read_completely),
		PRE_OPERATIONAL(test_a_long_domain_is_read_completely_with_seven_bytes_per_frame),
		PRE_OPERATIONAL(test_a_long_domain_is_read_completely_in_blocks_with_any_segments_lost),
		PRE_OPERATIONAL(test_a_long_domain_is_written_completely_in_blocks_with_any_segments_lost),
		PRE_OPERATIONAL(test_a_written_value_is_in_the_dictionary),
		PRE_OPERATIONAL(test_a_value_above_its_limit_is_aborted_and_the_old_one_stays),
		PRE_OPERATIONAL(test_a_value_of_too_many_bytes_is_aborted),
		PRE_OPERATIONAL(test_an_unknown_object_is_aborted),
		PRE_OPERATIONAL(test_a_lost_response_is_a_timeout_and_the_next_transfer_succeeds),
		PRE_OPERATIONAL(test_a_lost_segment_is_a_timeout_and_the_next_transfer_succeeds),
		PRE_OPERATIONAL(test_a_stopped_node_does_not_respond),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

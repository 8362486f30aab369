/* SDO server: CiA 301, 7.2.4. An abort is "80", index, sub-index and code, little-endian. */
#include "gateway/canopen/sdo_abort.h"
#include "tests/scenario/bus.h"

#include <stdio.h>
#include <string.h>

/* ---- expedited --------------------------------------------------------------------------------------------------- */

static void test_an_upload_of_1_2_and_4_bytes_is_expedited(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_exchange(bus, "610 40 17 10 00 00 00 00 00", "590 4B 17 10 00 00 00 00 00");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
}

static void test_a_download_with_an_indicated_size_is_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 2F 01 20 00 01 00 00 00", "590 60 01 20 00 00 00 00 00");
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 01 00 00 00");
	bus_exchange(bus, "610 2B 15 10 00 64 00 00 00", "590 60 15 10 00 00 00 00 00");
	bus_exchange(bus, "610 23 00 20 01 00 00 80 3F", "590 60 00 20 01 00 00 00 00"); /* 1.0 */
	bus_exchange(bus, "610 40 00 20 01 00 00 00 00", "590 43 00 20 01 00 00 80 3F");
}

static void test_a_download_without_a_size_has_that_of_the_object(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 22 01 20 00 01 FF FF FF", "590 60 01 20 00 00 00 00 00");
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 01 00 00 00");
}

static void test_a_value_below_or_above_its_limits_is_refused_and_the_old_one_stays(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 2F 01 20 00 04 00 00 00", "590 80 01 20 00 31 00 09 06");
	bus_exchange(bus, "610 23 00 20 01 00 00 30 C1", "590 80 00 20 01 32 00 09 06"); /* -11 */
	bus_exchange(bus, "610 23 00 20 01 00 00 C0 7F", "590 80 00 20 01 30 00 09 06"); /* NaN */
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_exchange(bus, "610 40 00 20 01 00 00 00 00", "590 43 00 20 01 00 00 00 00");
}

static void test_a_wrong_size_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 2B 01 20 00 01 00 00 00", "590 80 01 20 00 12 00 07 06");
	bus_exchange(bus, "610 2B 00 20 01 01 00 00 00", "590 80 00 20 01 13 00 07 06");
}

static void test_an_unknown_object_or_sub_index_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 FF 2F 00 00 00 00 00", "590 80 FF 2F 00 00 00 02 06");
	bus_exchange(bus, "610 40 00 20 04 00 00 00 00", "590 80 00 20 04 11 00 09 06");
	bus_exchange(bus, "610 2F FF 2F 00 00 00 00 00", "590 80 FF 2F 00 00 00 02 06");
	bus_exchange(bus, "610 2F 00 20 04 00 00 00 00", "590 80 00 20 04 11 00 09 06");
}

static void test_access_rights_are_enforced(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 00 10 00 00 00 00 00", "590 80 00 10 00 02 00 01 06"); /* const */
	bus_exchange(bus, "610 2F 01 10 00 00 00 00 00", "590 80 01 10 00 02 00 01 06"); /* ro */
	bus_exchange(bus, "610 40 40 20 06 00 00 00 00", "590 80 40 20 06 01 00 01 06"); /* wo */
}

/* ---- segmented --------------------------------------------------------------------------------------------------- */

static void test_a_string_is_uploaded_in_segments_of_7_bytes(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41"); /* IMU9 CA */
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 10 4E 6F 70 65 6E 20 67"); /* Nopen g */
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 03 61 74 65 77 61 79 00"); /* ateway */
}

static void test_the_last_segment_ends_the_transfer(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_send(bus, "610 60 00 00 00 00 00 00 00");
	bus_send(bus, "610 70 00 00 00 00 00 00 00");
	bus_send(bus, "610 60 00 00 00 00 00 00 00");
	bus_forget(bus);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 80 00 00 00 01 00 04 05");
}

static void test_an_empty_string_is_uploaded_as_one_empty_segment(void **state)
{
	struct bus *bus = *state;
	const struct od_entry *entry = od_find(bus->od.table, 0x1009, 0, NULL);

	memset((uint8_t *)&bus->values + entry->offset, 0, entry->size);
	bus_exchange(bus, "610 40 09 10 00 00 00 00 00", "590 41 09 10 00 00 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 0F 00 00 00 00 00 00 00");
}

static void test_a_segmented_upload_reads_the_value_as_it_was_at_its_start(void **state)
{
	struct bus *bus = *state;
	const struct od_entry *entry = od_find(bus->od.table, 0x1009, 0, NULL);
	char *text = (char *)&bus->values + entry->offset;

	strcpy(text, "AAAAAAAAAA");
	bus_exchange(bus, "610 40 09 10 00 00 00 00 00", "590 41 09 10 00 0A 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 41 41 41 41 41 41 41");
	strcpy(text, "BBBBBBBBBB");
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 19 41 41 41 00 00 00 00");
}

static void test_a_domain_is_uploaded_from_its_memory(void **state)
{
	struct bus *bus = *state;
	static uint8_t content[100000];
	struct od_domain domain = {.index = 0x1021, .data = content, .size = sizeof(content)};
	size_t got = 0;
	uint8_t toggle = 0;

	for (size_t i = 0; i < sizeof(content); i++)
		content[i] = (uint8_t)(i * 7 + i / 256);
	bus_exchange(bus, "610 40 21 10 00 00 00 00 00", "590 80 21 10 00 24 00 00 08");
	od_set_domain(&bus->od, &domain);
	bus_exchange(bus, "610 40 21 10 00 00 00 00 00", "590 41 21 10 00 A0 86 01 00");
	for (;;) {
		const struct can_msg request = {.id = 0x610, .len = 8, .data = {(uint8_t)(0x60 | toggle)}};
		const uint8_t *answer = bus->sent[0].msg.data;

		bus->sent_count = bus->seen = 0;
		bus_send_msg(bus, &request);
		assert_int_equal(bus->sent_count, 1);
		assert_int_equal(answer[0] & 0xF0, toggle);
		assert_memory_equal(answer + 1, content + got, 7u - (answer[0] >> 1 & 7u));
		got += 7u - (answer[0] >> 1 & 7u);
		toggle ^= 0x10;
		if (answer[0] & 1)
			break;
	}
	assert_int_equal(got, sizeof(content));
}

static void test_a_domain_that_is_read_only_cannot_be_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 21 10 00 10 00 00 00", "590 80 21 10 00 02 00 01 06");
}

static void test_a_segmented_download_is_written_with_its_last_segment(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 0A 00 00 00 00 00 00 00", "590 20 00 00 00 00 00 00 00"); /* 2 bytes */
	assert_true(bus->values.lever_arm.l == 0);
	bus_exchange(bus, "610 1B 80 3F 00 00 00 00 00", "590 30 00 00 00 00 00 00 00"); /* 2 more, last */
	assert_true(bus->values.lever_arm.l == 1.0f);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_segmented_download_without_a_size_is_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 20 00 20 01 00 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 07 00 00 80 3F 00 00 00", "590 20 00 00 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 1.0f);
}

static void test_a_wrong_size_is_refused_before_any_segment(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 05 00 00 00", "590 80 00 20 01 12 00 07 06");
	bus_exchange(bus, "610 21 00 20 01 03 00 00 00", "590 80 00 20 01 13 00 07 06");
	bus_exchange(bus, "610 21 00 20 01 FF FF FF FF", "590 80 00 20 01 12 00 07 06");
}

static void test_access_is_refused_before_any_segment(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 08 10 00 14 00 00 00", "590 80 08 10 00 02 00 01 06");
	bus_exchange(bus, "610 21 FF 2F 00 14 00 00 00", "590 80 FF 2F 00 00 00 02 06");
	bus_exchange(bus, "610 21 00 20 09 04 00 00 00", "590 80 00 20 09 11 00 09 06");
}

static void test_more_bytes_than_the_indicated_size_are_too_long(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 05 00 00 80 3F 00 00 00", "590 80 00 20 01 12 00 07 06");
	assert_true(bus->values.lever_arm.l == 0);
}

static void test_segments_that_together_exceed_the_indicated_size_are_too_long(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 0A 00 00 00 00 00 00 00", "590 20 00 00 00 00 00 00 00");
	bus_exchange(bus, "610 18 80 3F 00 00 00 00 00", "590 80 00 20 01 12 00 07 06");
}

static void test_a_restarted_transfer_starts_with_the_first_byte(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 0A 11 22 00 00 00 00 00", "590 20 00 00 00 00 00 00 00");
	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 07 00 00 80 3F 00 00 00", "590 20 00 00 00 00 00 00 00");
	assert_true(bus->values.lever_arm.l == 1.0f);
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
}

static void test_fewer_bytes_than_the_indicated_size_are_too_short(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 09 00 00 80 00 00 00 00", "590 80 00 20 01 13 00 07 06");
	assert_true(bus->values.lever_arm.l == 0);
}

static void test_a_download_without_a_size_is_limited_by_the_object(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 20 00 20 01 00 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 04 00 00 80 3F 00 00 00", "590 80 00 20 01 12 00 07 06");
	bus_exchange(bus, "610 20 00 20 01 00 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 09 00 00 80 00 00 00 00", "590 80 00 20 01 13 00 07 06");
}

static void test_a_string_may_be_shorter_than_its_object_but_not_than_the_indicated_size(void **state)
{
	struct bus *bus = *state;
	const char *text = bus_writable_string(bus);

	bus_exchange(bus, "610 21 09 10 00 05 00 00 00", "590 60 09 10 00 00 00 00 00");
	bus_exchange(bus, "610 09 41 42 43 00 00 00 00", "590 80 09 10 00 13 00 07 06"); /* 3 of 5 */
	bus_exchange(bus, "610 20 09 10 00 00 00 00 00", "590 60 09 10 00 00 00 00 00");
	bus_exchange(bus, "610 09 41 42 43 00 00 00 00", "590 20 00 00 00 00 00 00 00");
	assert_string_equal(text, "ABC");
	bus_exchange(bus, "610 21 09 10 00 21 00 00 00", "590 80 09 10 00 12 00 07 06"); /* 33 */
}

static void test_the_limits_of_an_object_apply_to_a_segmented_download(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 01 20 00 01 00 00 00", "590 60 01 20 00 00 00 00 00");
	bus_exchange(bus, "610 0D 04 00 00 00 00 00 00", "590 80 01 20 00 31 00 09 06");
	assert_int_equal(bus->values.lever_arm_model, 2);
}

static void test_a_wrong_toggle_in_an_upload_aborts_it(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 80 08 10 00 00 00 03 05");
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 80 08 10 00 00 00 03 05");
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 80 00 00 00 01 00 04 05");
}

static void test_a_wrong_toggle_in_a_download_aborts_it(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 17 00 00 80 3F 00 00 00", "590 80 00 20 01 00 00 03 05");
	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 0A 00 00 00 00 00 00 00", "590 20 00 00 00 00 00 00 00");
	bus_exchange(bus, "610 0B 80 3F 00 00 00 00 00", "590 80 00 20 01 00 00 03 05");
	assert_true(bus->values.lever_arm.l == 0);
}

/* ---- timeouts, aborts, unexpected frames ------------------------------------------------------------------------- */

static void test_a_download_without_a_segment_for_a_second_times_out(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_run(bus, 999999);
	bus_exchange(bus, "610 0A 00 00 00 00 00 00 00", "590 20 00 00 00 00 00 00 00");
	bus_run(bus, 999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 00 20 01 00 00 04 05");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_an_upload_without_a_segment_for_a_second_times_out(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_run(bus, 900000);
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_run(bus, 999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "590 80 08 10 00 00 00 04 05");
}

static void test_an_abort_of_the_client_ends_the_transfer_without_a_response(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_send(bus, "610 80 08 10 00 00 00 04 05");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 80 00 00 00 01 00 04 05");
}

static void test_an_abort_without_a_transfer_is_ignored(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "610 80 08 10 00 00 00 04 05");
	bus_expect_nothing(bus);
}

static void test_a_new_request_during_a_transfer_is_served(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 10 4E 6F 70 65 6E 20 67");
}

static void test_an_unknown_command_is_refused_and_ends_the_transfer(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 E0 08 10 00 00 00 00 00", "590 80 08 10 00 01 00 04 05");
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 E0 00 20 01 00 00 00 00", "590 80 08 10 00 01 00 04 05");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_segment_of_the_other_direction_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 00 01 02 03 04 05 06 07", "590 80 08 10 00 01 00 04 05");
	bus_exchange(bus, "610 21 00 20 01 04 00 00 00", "590 60 00 20 01 00 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 80 00 20 01 01 00 04 05");
}

static void test_a_request_of_wrong_length_is_ignored(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "610");
	bus_send(bus, "610 40");
	bus_send(bus, "610 40 00 10 00");
	bus_send(bus, "610 40 00 10 00 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_send(bus, "610 60 00 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
}

static void test_reserved_bits_and_bytes_are_ignored(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 5F 17 10 00 EE EE EE EE", "590 4B 17 10 00 00 00 00 00"); /* upload */
	bus_exchange(bus, "610 3B 17 10 00 F4 01 EE EE", "590 60 17 10 00 00 00 00 00"); /* expedited: bit 4 */
	bus_exchange(bus, "610 40 17 10 00 00 00 00 00", "590 4B 17 10 00 F4 01 00 00");
	bus_write(bus, 0x1017, 0, 2, 0);
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 6F EE EE EE EE EE EE EE", "590 00 49 4D 55 39 20 43 41"); /* upload segment */
	bus_exchange(bus, "610 7F EE EE EE EE EE EE EE", "590 10 4E 6F 70 65 6E 20 67");
}

static void test_a_request_to_another_node_has_no_response(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "611 40 00 10 00 00 00 00 00");
	bus_send(bus, "591 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_extended_and_remote_frames_are_not_sdo_requests(void **state)
{
	struct bus *bus = *state;
	struct can_msg request = {.id = 0x610, .len = 8, .data = {0x40, 0x00, 0x10}};

	request.extended = true;
	bus_send_msg(bus, &request);
	request.extended = false;
	request.remote = true;
	bus_send_msg(bus, &request);
	bus_expect_nothing(bus);
}

static void test_every_status_of_the_dictionary_has_its_abort_code(void **state)
{
	static const uint32_t codes[OD_STATUS_COUNT] = {
		[OD_NO_OBJECT] = 0x06020000,
		[OD_NO_SUBINDEX] = 0x06090011,
		[OD_WRITE_ONLY] = 0x06010001,
		[OD_READ_ONLY] = 0x06010002,
		[OD_UNSUPPORTED_ACCESS] = 0x06010000,
		[OD_TOO_LONG] = 0x06070012,
		[OD_TOO_SHORT] = 0x06070013,
		[OD_TOO_HIGH] = 0x06090031,
		[OD_TOO_LOW] = 0x06090032,
		[OD_BAD_VALUE] = 0x06090030,
		[OD_NOT_MAPPABLE] = 0x06040041,
		[OD_PDO_LENGTH] = 0x06040042,
		[OD_INCOMPATIBLE] = 0x06040043,
		[OD_CANNOT_STORE] = 0x08000020,
		[OD_LOCAL_CONTROL] = 0x08000021,
		[OD_DEVICE_STATE] = 0x08000022,
		[OD_NO_DATA] = 0x08000024,
		[OD_GENERAL] = 0x08000000,
	};

	for (int status = 0; status < OD_STATUS_COUNT; status++)
		assert_int_equal(sdo_abort_code((enum od_status)status), codes[status]);
	(void)state;
}

static void test_every_object_reads_by_sdo_as_in_the_dictionary(void **state)
{
	struct bus *bus = *state;

	for (size_t i = 0; i < bus->od.table->count; i++) {
		const struct od_entry *entry = &bus->od.table->entries[i];
		uint8_t wire[OD_VALUE_MAX];
		uint32_t value = 0;
		size_t size = od_get(&bus->od, entry, wire, sizeof(wire));

		if (!(entry->access & OD_READ) || entry->size > 4 || entry->size == 0)
			continue;
		if (entry->index == 0x1003 && entry->sub > 0)
			continue;
		for (size_t k = size; k > 0; k--)
			value = value << 8 | wire[k - 1];
		assert_int_equal(bus_read(bus, entry->index, entry->sub), value);
	}
}

/* ---- the further channels (1201h to 1207h) ----------------------------------------------------------------------- */

/* A channel of its own has identifiers that nothing else of the node has; those of what is off are free. */
static void test_an_identifier_of_another_service_is_refused_for_a_channel(void **state)
{
	static const struct {
		uint16_t index;
		uint8_t sub;
		uint32_t off, on, id;
	} services[] = {{0x1014, 0, 0x80000090, 0x90, 0x90}, {0x1012, 0, 0x100, 0x80000100, 0x100},
		{0x1012, 0, 0x100, 0x40000100, 0x100}, {0x1800, 1, 0xC0000190, 0x40000190, 0x190},
		{0x1803, 1, 0xC0000490, 0x40000490, 0x490}, {0x1400, 1, 0x80000210, 0x210, 0x210},
		{0x1202, 1, 0x80000000, 0x6A2, 0x6A2}, {0x1207, 2, 0x80000000, 0x6A3, 0x6A3}};
	struct bus *bus = bus_new();

	(void)state;
	bus_start(bus);
	bus_forget(bus);
	assert_int_equal(bus_write(bus, 0x1201, 2, 4, 0x80), 0x06040043); /* SYNC is always there */
	for (size_t i = 0; i < sizeof(services) / sizeof(services[0]); i++) {
		assert_int_equal(bus_write(bus, services[i].index, services[i].sub, 4, services[i].off), 0);
		assert_int_equal(bus_write(bus, services[i].index, services[i].sub, 4, services[i].on), 0);
		assert_int_equal(bus_write(bus, 0x1201, 1, 4, services[i].id), 0x06040043);
		assert_int_equal(bus_write(bus, services[i].index, services[i].sub, 4, services[i].off), 0);
		assert_int_equal(bus_write(bus, 0x1201, 1, 4, services[i].id), 0);
		assert_int_equal(bus_write(bus, 0x1201, 1, 4, services[i].id), 0); /* its own */
		assert_int_equal(bus_write(bus, 0x1201, 2, 4, services[i].id), 0x06040043);
		assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x80000000), 0);
	}
	test_free(bus);
}

static void open_second(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x6A0), 0);
	assert_int_equal(bus_write(bus, 0x1201, 2, 4, 0x6A1), 0);
}

static void test_the_second_channel_is_closed_until_configured(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_read(bus, 0x1201, 1), 0x80000000);
	assert_int_equal(bus_read(bus, 0x1201, 2), 0x80000000);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x6A0), 0);
	bus_send(bus, "6A0 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_the_second_channel_responds_with_its_own_identifier(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	assert_int_equal(bus->filter_count, 17);
	assert_true(bus_listens_to(bus, 0x6A0));
	bus_exchange(bus, "6A0 40 00 10 00 00 00 00 00", "6A1 43 00 10 00 9A 01 04 00");
}

static void test_both_channels_transfer_at_the_same_time(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "6A0 40 08 10 00 00 00 00 00", "6A1 41 08 10 00 14 00 00 00");
	bus_exchange(bus, "610 60 00 00 00 00 00 00 00", "590 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "6A0 60 00 00 00 00 00 00 00", "6A1 00 49 4D 55 39 20 43 41");
	bus_exchange(bus, "610 70 00 00 00 00 00 00 00", "590 10 4E 6F 70 65 6E 20 67");
	bus_exchange(bus, "6A0 70 00 00 00 00 00 00 00", "6A1 10 4E 6F 70 65 6E 20 67");
}

static void test_each_channel_has_its_own_timeout(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_run(bus, 500000);
	bus_exchange(bus, "6A0 40 08 10 00 00 00 00 00", "6A1 41 08 10 00 14 00 00 00");
	bus_run(bus, 500000);
	bus_expect(bus, "590 80 08 10 00 00 00 04 05");
	bus_expect_nothing(bus);
	bus_run(bus, 500000);
	bus_expect(bus, "6A1 80 08 10 00 00 00 04 05");
}

static void test_the_second_channel_receives_the_response_of_its_own_store(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus->storage_answer = OD_PENDING;
	bus_send(bus, "6A0 23 10 10 01 73 61 76 65");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	canopen_store_done(&bus->node, OD_OK, bus->now_us);
	bus_expect(bus, "6A1 60 10 10 01 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_an_identifier_of_the_second_channel_does_not_change_while_in_use(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x6A2), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x800006A0), 0);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x6A2), 0);
	bus_exchange(bus, "6A2 40 00 10 00 00 00 00 00", "6A1 43 00 10 00 9A 01 04 00");
}

static void test_restricted_29_bit_and_dynamic_identifiers_of_the_second_channel_are_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x611), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x200006A0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x400006A0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1201, 2, 4, 0x591), 0x06090030);
}

static void test_a_client_that_closes_its_own_channel_receives_the_response(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus_exchange(bus, "6A0 23 01 12 02 00 00 00 80", "6A1 60 01 12 02 00 00 00 00");
	bus_send(bus, "6A0 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
	assert_int_equal(bus->filter_count, 15);
}

static void test_a_channel_that_is_closed_ends_its_transfer(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus_exchange(bus, "6A0 40 08 10 00 00 00 00 00", "6A1 41 08 10 00 14 00 00 00");
	assert_int_equal(bus_write(bus, 0x1201, 1, 4, 0x800006A0), 0);
	bus_run(bus, 1100000); /* longer than the SDO timeout */
	bus_expect_nothing(bus);
}

static void test_reset_communication_closes_the_second_channel(void **state)
{
	struct bus *bus = *state;

	open_second(bus);
	bus_reset(bus, "000 82 10", "710 00");
	bus_send(bus, "6A0 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_a_stored_identifier_of_the_second_channel_that_is_not_allowed_keeps_it_closed(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1201, 1, 4, 0x611);
	bus_put(bus, 0x1201, 2, 4, 0x6A1);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 01 12 00 00 00");
	bus_send(bus, "611 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
	test_free(bus);
	(void)state;
}

enum { CHANNELS = 8 }; /* 1200h to 1207h */

/* Channel n of 1201h to 1207h has 680h + n for requests and 690h + n for responses. */
static void open_all(struct bus *bus)
{
	for (uint16_t n = 1; n < CHANNELS; n++) {
		assert_int_equal(bus_write(bus, 0x1200 + n, 1, 4, 0x680u + n), 0);
		assert_int_equal(bus_write(bus, 0x1200 + n, 2, 4, 0x690u + n), 0);
	}
}

static void send_on(struct bus *bus, unsigned n, const char *data)
{
	char text[64];

	snprintf(text, sizeof(text), "%X %s", n ? 0x680 + n : 0x610, data);
	bus_send(bus, text);
}

static void expect_on(struct bus *bus, unsigned n, const char *data)
{
	char text[64];

	snprintf(text, sizeof(text), "%X %s", n ? 0x690 + n : 0x590, data);
	bus_expect(bus, text);
	bus_expect_nothing(bus);
}

static void test_eight_clients_have_transfers_of_their_own_at_the_same_time(void **state)
{
	static const struct {
		const char *request, *response;
	} steps[] = {{"40 08 10 00 00 00 00 00", "41 08 10 00 14 00 00 00"},
		{"60 00 00 00 00 00 00 00", "00 49 4D 55 39 20 43 41"},
		{"70 00 00 00 00 00 00 00", "10 4E 6F 70 65 6E 20 67"},
		{"60 00 00 00 00 00 00 00", "03 61 74 65 77 61 79 00"}};
	struct bus *bus = *state;

	open_all(bus);
	for (size_t i = 0; i < sizeof(steps) / sizeof(steps[0]); i++)
		for (unsigned n = 0; n < CHANNELS; n++) {
			send_on(bus, n, steps[i].request);
			expect_on(bus, n, steps[i].response);
		}
}

static void test_a_client_that_gives_up_or_is_silent_ends_its_own_transfer_only(void **state)
{
	struct bus *bus = *state;

	open_all(bus);
	for (unsigned n = 0; n < CHANNELS; n++) {
		send_on(bus, n, "40 08 10 00 00 00 00 00");
		expect_on(bus, n, "41 08 10 00 14 00 00 00");
		bus_run(bus, 100000);
	}
	send_on(bus, 3, "80 08 10 00 00 00 04 05");
	bus_expect_nothing(bus);
	bus_run(bus, 199999); /* channel 0 was asked 1 s ago, less 1 us */
	bus_expect_nothing(bus);
	for (unsigned n = 0; n < CHANNELS; n++) {
		bus_run(bus, 1);
		if (n != 3)
			expect_on(bus, n, "80 08 10 00 00 00 04 05");
		bus_run(bus, 99999);
		bus_expect_nothing(bus);
	}
}

static void test_two_clients_write_the_same_object_and_the_last_value_stays(void **state)
{
	struct bus *bus = *state;

	open_all(bus);
	send_on(bus, 1, "21 00 20 01 04 00 00 00"); /* segmented: 1.0 */
	expect_on(bus, 1, "60 00 20 01 00 00 00 00");
	send_on(bus, 7, "23 00 20 01 00 00 00 40"); /* 2.0 */
	expect_on(bus, 7, "60 00 20 01 00 00 00 00");
	send_on(bus, 0, "40 00 20 01 00 00 00 00");
	expect_on(bus, 0, "43 00 20 01 00 00 00 40");
	send_on(bus, 1, "07 00 00 80 3F 00 00 00");
	expect_on(bus, 1, "20 00 00 00 00 00 00 00");
	send_on(bus, 0, "40 00 20 01 00 00 00 00");
	expect_on(bus, 0, "43 00 20 01 00 00 80 3F");
}

static void test_a_second_client_cannot_store_while_the_first_one_waits(void **state)
{
	struct bus *bus = *state;

	open_all(bus);
	bus->storage_answer = OD_PENDING;
	send_on(bus, 2, "23 10 10 01 73 61 76 65");
	bus_expect_nothing(bus);
	send_on(bus, 5, "23 10 10 01 73 61 76 65");
	expect_on(bus, 5, "80 10 10 01 22 00 00 08");
	canopen_store_done(&bus->node, OD_OK, bus->now_us);
	expect_on(bus, 2, "60 10 10 01 00 00 00 00");
}

static void test_an_identifier_that_the_node_uses_already_is_refused_for_a_channel(void **state)
{
	static const uint32_t used[] = {
		0x080, /* SYNC */
		0x090, /* EMCY */
		0x190, /* TPDO1 */
		0x210, /* RPDO1 */
		0x681, /* the request and the response of another channel */
		0x691,
	};
	struct bus *bus = *state;

	open_all(bus);
	assert_int_equal(bus_write(bus, 0x1202, 1, 4, 0x80000000), 0);
	for (size_t i = 0; i < sizeof(used) / sizeof(used[0]); i++)
		assert_int_equal(bus_write(bus, 0x1202, 1, 4, used[i]), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1202, 1, 4, 0x692), 0x06040043); /* its own response */
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x80000100), 0);
	assert_int_equal(bus_write(bus, 0x1202, 1, 4, 0x100), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x100), 0); /* TIME is not used any more */
	assert_int_equal(bus_write(bus, 0x1202, 1, 4, 0x100), 0);
}

static void test_an_identifier_of_a_channel_is_refused_for_another_object(void **state)
{
	struct bus *bus = *state;

	open_all(bus);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x681), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x80000681), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x80000000), 0);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x691), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x80000000), 0);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x687), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x80000000), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x697), 0x06040043);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x698), 0);
}

static void test_of_two_stored_channels_with_one_identifier_one_is_closed_and_reported(void **state)
{
	struct bus *bus = bus_new();

	for (uint16_t n = 1; n <= 2; n++) {
		bus_put(bus, 0x1200 + n, 1, 4, 0x680);
		bus_put(bus, 0x1200 + n, 2, 4, 0x690u + n);
	}
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 01 12 00 00 00");
	assert_int_equal(bus_read(bus, 0x1201, 1), 0x80000680);
	bus_exchange(bus, "680 40 00 10 00 00 00 00 00", "692 43 00 10 00 9A 01 04 00");
	test_free(bus);
	(void)state;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_an_upload_of_1_2_and_4_bytes_is_expedited),
		PRE_OPERATIONAL(test_a_download_with_an_indicated_size_is_written),
		PRE_OPERATIONAL(test_a_download_without_a_size_has_that_of_the_object),
		PRE_OPERATIONAL(test_a_value_below_or_above_its_limits_is_refused_and_the_old_one_stays),
		PRE_OPERATIONAL(test_a_wrong_size_is_refused),
		PRE_OPERATIONAL(test_an_unknown_object_or_sub_index_is_refused),
		PRE_OPERATIONAL(test_access_rights_are_enforced),
		PRE_OPERATIONAL(test_a_string_is_uploaded_in_segments_of_7_bytes),
		PRE_OPERATIONAL(test_the_last_segment_ends_the_transfer),
		PRE_OPERATIONAL(test_an_empty_string_is_uploaded_as_one_empty_segment),
		PRE_OPERATIONAL(test_a_segmented_upload_reads_the_value_as_it_was_at_its_start),
		PRE_OPERATIONAL(test_a_domain_is_uploaded_from_its_memory),
		PRE_OPERATIONAL(test_a_domain_that_is_read_only_cannot_be_written),
		PRE_OPERATIONAL(test_a_segmented_download_is_written_with_its_last_segment),
		PRE_OPERATIONAL(test_a_segmented_download_without_a_size_is_written),
		PRE_OPERATIONAL(test_a_wrong_size_is_refused_before_any_segment),
		PRE_OPERATIONAL(test_access_is_refused_before_any_segment),
		PRE_OPERATIONAL(test_more_bytes_than_the_indicated_size_are_too_long),
		PRE_OPERATIONAL(test_segments_that_together_exceed_the_indicated_size_are_too_long),
		PRE_OPERATIONAL(test_a_restarted_transfer_starts_with_the_first_byte),
		PRE_OPERATIONAL(test_fewer_bytes_than_the_indicated_size_are_too_short),
		PRE_OPERATIONAL(test_a_download_without_a_size_is_limited_by_the_object),
		PRE_OPERATIONAL(test_a_string_may_be_shorter_than_its_object_but_not_than_the_indicated_size),
		PRE_OPERATIONAL(test_the_limits_of_an_object_apply_to_a_segmented_download),
		PRE_OPERATIONAL(test_a_wrong_toggle_in_an_upload_aborts_it),
		PRE_OPERATIONAL(test_a_wrong_toggle_in_a_download_aborts_it),
		PRE_OPERATIONAL(test_a_download_without_a_segment_for_a_second_times_out),
		PRE_OPERATIONAL(test_an_upload_without_a_segment_for_a_second_times_out),
		PRE_OPERATIONAL(test_an_abort_of_the_client_ends_the_transfer_without_a_response),
		PRE_OPERATIONAL(test_an_abort_without_a_transfer_is_ignored),
		PRE_OPERATIONAL(test_a_new_request_during_a_transfer_is_served),
		PRE_OPERATIONAL(test_an_unknown_command_is_refused_and_ends_the_transfer),
		PRE_OPERATIONAL(test_a_segment_of_the_other_direction_is_refused),
		PRE_OPERATIONAL(test_a_request_of_wrong_length_is_ignored),
		PRE_OPERATIONAL(test_reserved_bits_and_bytes_are_ignored),
		PRE_OPERATIONAL(test_a_request_to_another_node_has_no_response),
		PRE_OPERATIONAL(test_extended_and_remote_frames_are_not_sdo_requests),
		cmocka_unit_test(test_an_identifier_of_another_service_is_refused_for_a_channel),
		cmocka_unit_test(test_every_status_of_the_dictionary_has_its_abort_code),
		PRE_OPERATIONAL(test_every_object_reads_by_sdo_as_in_the_dictionary),
		PRE_OPERATIONAL(test_the_second_channel_is_closed_until_configured),
		PRE_OPERATIONAL(test_the_second_channel_responds_with_its_own_identifier),
		PRE_OPERATIONAL(test_both_channels_transfer_at_the_same_time),
		PRE_OPERATIONAL(test_each_channel_has_its_own_timeout),
		PRE_OPERATIONAL(test_the_second_channel_receives_the_response_of_its_own_store),
		PRE_OPERATIONAL(test_an_identifier_of_the_second_channel_does_not_change_while_in_use),
		PRE_OPERATIONAL(test_restricted_29_bit_and_dynamic_identifiers_of_the_second_channel_are_refused),
		PRE_OPERATIONAL(test_a_client_that_closes_its_own_channel_receives_the_response),
		PRE_OPERATIONAL(test_a_channel_that_is_closed_ends_its_transfer),
		PRE_OPERATIONAL(test_reset_communication_closes_the_second_channel),
		cmocka_unit_test(test_a_stored_identifier_of_the_second_channel_that_is_not_allowed_keeps_it_closed),
		PRE_OPERATIONAL(test_eight_clients_have_transfers_of_their_own_at_the_same_time),
		PRE_OPERATIONAL(test_a_client_that_gives_up_or_is_silent_ends_its_own_transfer_only),
		PRE_OPERATIONAL(test_two_clients_write_the_same_object_and_the_last_value_stays),
		PRE_OPERATIONAL(test_a_second_client_cannot_store_while_the_first_one_waits),
		PRE_OPERATIONAL(test_an_identifier_that_the_node_uses_already_is_refused_for_a_channel),
		PRE_OPERATIONAL(test_an_identifier_of_a_channel_is_refused_for_another_object),
		cmocka_unit_test(test_of_two_stored_channels_with_one_identifier_one_is_closed_and_reported),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

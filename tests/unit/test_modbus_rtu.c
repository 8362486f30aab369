/* Frames of a serial line, and the options of --modbus. The CRC of "02 07" is the example of the Modicon Modbus
 * Protocol Reference Guide; that of the read request is of the same format as any Modbus master sends it. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <errno.h>
#include <string.h>

#include "gateway/modbus/options.h"
#include "gateway/modbus/rtu.h"

enum { ADDRESS = 1 };

/* Read 1 register at 0 of slave 1, and of slave 2 with its response. */
static const uint8_t READ[] = {0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A};
static uint8_t frame[MODBUS_RTU_MAX];

static size_t with_crc(const uint8_t *bytes, size_t size)
{
	memcpy(frame, bytes, size);
	uint16_t crc = modbus_crc(frame, size);
	frame[size] = (uint8_t)crc;
	frame[size + 1] = (uint8_t)(crc >> 8);
	return size + 2;
}

static void test_the_crc_is_that_of_the_reference_guide(void **state)
{
	(void)state;
	assert_int_equal(modbus_crc((const uint8_t[]){0x02, 0x07}, 2), 0x1241);
	assert_int_equal(modbus_crc(READ, 6), 0x0A84);
	assert_int_equal(modbus_crc(READ, sizeof(READ)), 0);
}

static void test_a_request_is_complete_with_its_last_byte(void **state)
{
	size_t size;

	(void)state;
	for (size_t used = 1; used < sizeof(READ); used++) {
		assert_int_equal(modbus_rtu_next(READ, used, ADDRESS, false, &size), MODBUS_RTU_WAIT);
		assert_int_equal(modbus_rtu_next(READ, used, ADDRESS, true, &size), MODBUS_RTU_BAD);
	}
	assert_int_equal(modbus_rtu_next(READ, sizeof(READ), ADDRESS, false, &size), MODBUS_RTU_REQUEST);
	assert_int_equal(size, sizeof(READ));
}

static void test_a_broadcast_is_for_every_slave(void **state)
{
	size_t size, used = with_crc((const uint8_t[]){0, 6, 0, 1, 0, 3}, 6);

	(void)state;
	assert_int_equal(modbus_rtu_next(frame, used, ADDRESS, false, &size), MODBUS_RTU_REQUEST);
}

static void test_each_wrong_bit_is_noticed(void **state)
{
	size_t size;

	(void)state;
	for (size_t bit = 8; bit < 8 * sizeof(READ); bit++) { /* the first byte is another slave's */
		memcpy(frame, READ, sizeof(READ));
		frame[bit / 8] ^= (uint8_t)(1 << bit % 8);
		assert_int_not_equal(modbus_rtu_next(frame, sizeof(READ), ADDRESS, true, &size), MODBUS_RTU_REQUEST);
	}
}

static void test_frames_of_other_slaves_are_skipped_wherever_they_end(void **state)
{
	uint8_t line[64];
	size_t size, used = with_crc((const uint8_t[]){2, 3, 0, 0, 0, 1}, 6);

	(void)state;
	memcpy(line, frame, used);
	size_t response = with_crc((const uint8_t[]){2, 3, 2, 0x12, 0x34}, 5);
	memcpy(line + used, frame, response);
	memcpy(line + used + response, READ, sizeof(READ));
	assert_int_equal(modbus_rtu_next(line, used + response + sizeof(READ), ADDRESS, false, &size), MODBUS_RTU_DROP);
	assert_int_equal(size, used);
	assert_int_equal(modbus_rtu_next(line + used, response + sizeof(READ), ADDRESS, false, &size), MODBUS_RTU_DROP);
	assert_int_equal(size, response);
	assert_int_equal(
		modbus_rtu_next(line + used + response, sizeof(READ), ADDRESS, false, &size), MODBUS_RTU_REQUEST);
}

static void test_an_unknown_function_ends_with_the_silence(void **state)
{
	size_t size, used = with_crc((const uint8_t[]){ADDRESS, 0x41, 1, 2, 3}, 5);

	(void)state;
	assert_int_equal(modbus_rtu_next(frame, used, ADDRESS, false, &size), MODBUS_RTU_WAIT);
	assert_int_equal(modbus_rtu_next(frame, used, ADDRESS, true, &size), MODBUS_RTU_REQUEST);
	assert_int_equal(size, used);
}

static void test_a_size_beyond_a_frame_is_no_request(void **state)
{
	size_t size, used = with_crc((const uint8_t[]){ADDRESS, 0x2B, 0x0D, 1, 0, 0x20, 0, 1, 0, 0, 0xFF, 0xFF}, 12);

	(void)state;
	assert_int_equal(modbus_rtu_next(frame, used, ADDRESS, false, &size), MODBUS_RTU_BAD);
}

/* ---- options ----------------------------------------------------------------------------------------------------- */

static struct modbus_window window;
static char why[400];

static void assert_parses(const char *text)
{
	if (modbus_options_parse(&window, text, why, sizeof(why)) != 0)
		fail_msg("%s: %s", text, why);
}

static bool may(const struct modbus_nets *nets, const char *address)
{
	uint8_t bytes[16] = {[10] = 0xFF, [11] = 0xFF};

	assert_true(inet_pton(AF_INET, address, bytes + 12) == 1 || inet_pton(AF_INET6, address, bytes) == 1);
	return modbus_nets_have(nets, bytes);
}

static void test_by_default_this_host_reads_and_nobody_writes(void **state)
{
	(void)state;
	assert_parses("tcp:0.0.0.0:1502");
	assert_string_equal(window.host, "0.0.0.0");
	assert_string_equal(window.port, "1502");
	assert_true(may(&window.allow, "127.0.0.1"));
	assert_true(may(&window.allow, "::1"));
	assert_false(may(&window.allow, "192.168.1.5"));
	assert_false(may(&window.write, "127.0.0.1"));
}

static void test_the_lists_have_addresses_and_networks(void **state)
{
	(void)state;
	assert_parses("tcp:[::]:502,allow=192.168.1.0/25,allow=fe80::/"
		      "10,allow=10.1.2.3,write=10.1.2.3,clients=3,idle=7,rate=9");
	assert_string_equal(window.host, "::");
	assert_true(may(&window.allow, "192.168.1.127"));
	assert_false(may(&window.allow, "192.168.1.128"));
	assert_true(may(&window.allow, "10.1.2.3"));
	assert_false(may(&window.allow, "10.1.2.2"));
	assert_true(may(&window.allow, "febf::1"));
	assert_false(may(&window.allow, "fec0::1"));
	assert_false(may(&window.allow, "127.0.0.1"));
	assert_true(may(&window.write, "10.1.2.3"));
	assert_false(may(&window.write, "192.168.1.1"));
	assert_int_equal(window.clients, 3);
	assert_int_equal(window.idle_s, 7);
	assert_int_equal(window.rate, 9);
	assert_parses("tcp:10.0.0.1,allow=0.0.0.0/0");
	assert_string_equal(window.port, "502");
	assert_true(may(&window.allow, "8.8.8.8"));
	assert_false(may(&window.allow, "2001:db8::1"));
}

static void test_a_serial_line_is_read_only_unless_it_may_write(void **state)
{
	(void)state;
	assert_parses("rtu:/dev/ttyUSB0");
	assert_true(window.serial);
	assert_string_equal(window.device, "/dev/ttyUSB0");
	assert_int_equal(window.baud, 19200);
	assert_int_equal(window.parity, 'E');
	assert_int_equal(window.address, 1);
	assert_false(window.may_write);
	assert_parses("rtu:/dev/ttyS1,baud=115200,parity=none,stop=2,address=247,write=yes");
	assert_int_equal(window.baud, 115200);
	assert_int_equal(window.parity, 'N');
	assert_int_equal(window.stop, 2);
	assert_int_equal(window.address, 247);
	assert_true(window.may_write);
}

static void test_what_is_wrong_is_refused_with_a_reason(void **state)
{
	static const char *const WRONG[] = {"", "tcp:", "udp:1", "tcp::502", "tcp:a:0", "tcp:a:65536", "tcp:[::1",
		"tcp:[]:1", "tcp:a:1x", "tcp:a,allow=", "tcp:a,allow=host", "tcp:a,allow=1.2.3.4/33",
		"tcp:a,allow=::/129", "tcp:a,clients=0", "tcp:a,clients=33", "tcp:a,rate=0", "tcp:a,idle=0",
		"tcp:a,baud=9600", "tcp:a,what", "rtu:", "rtu:/dev/a,baud=0", "rtu:/dev/a,parity=mark",
		"rtu:/dev/a,address=0", "rtu:/dev/a,address=248", "rtu:/dev/a,write=perhaps",
		"rtu:/dev/a,allow=1.2.3.4",
		"tcp:a,write=1.1.1.1,write=1.1.1.2,write=1.1.1.3,write=1.1.1.4,write=1.1.1.5,write=1.1.1.6,write=1.1.1."
		"7,"
		"write=1.1.1.8,write=1.1.1.9"};

	(void)state;
	for (size_t i = 0; i < sizeof(WRONG) / sizeof(*WRONG); i++) {
		why[0] = '\0';
		if (modbus_options_parse(&window, WRONG[i], why, sizeof(why)) != -EINVAL)
			fail_msg("%s is accepted", WRONG[i]);
		assert_true(strlen(why) > 20);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_crc_is_that_of_the_reference_guide),
		cmocka_unit_test(test_a_request_is_complete_with_its_last_byte),
		cmocka_unit_test(test_a_broadcast_is_for_every_slave),
		cmocka_unit_test(test_each_wrong_bit_is_noticed),
		cmocka_unit_test(test_frames_of_other_slaves_are_skipped_wherever_they_end),
		cmocka_unit_test(test_an_unknown_function_ends_with_the_silence),
		cmocka_unit_test(test_a_size_beyond_a_frame_is_no_request),
		cmocka_unit_test(test_by_default_this_host_reads_and_nobody_writes),
		cmocka_unit_test(test_the_lists_have_addresses_and_networks),
		cmocka_unit_test(test_a_serial_line_is_read_only_unless_it_may_write),
		cmocka_unit_test(test_what_is_wrong_is_refused_with_a_reason),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

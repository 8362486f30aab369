/* Frames of a serial line, and the options of --modbus. The CRC of "02 07" is the example of the Modicon Modbus
 * Protocol Reference Guide; that of the read request is of the same format as any Modbus master sends it. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <errno.h>
#include <stdio.h>
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

static void test_bytes_without_a_frame_are_dropped_with_the_silence_or_when_there_is_no_room(void **state)
{
	static const uint8_t other[MODBUS_RTU_MAX] = {7}, own[MODBUS_RTU_MAX] = {ADDRESS, 0x41};
	size_t size;

	(void)state;
	for (size_t used = 1; used <= MODBUS_RTU_MAX; used++) {
		bool full = used == MODBUS_RTU_MAX;

		assert_int_equal(
			modbus_rtu_next(other, used, ADDRESS, false, &size), full ? MODBUS_RTU_DROP : MODBUS_RTU_WAIT);
		assert_int_equal(modbus_rtu_next(other, used, ADDRESS, true, &size), MODBUS_RTU_DROP);
		assert_int_equal(size, used);
		assert_int_equal(
			modbus_rtu_next(own, used, ADDRESS, false, &size), full ? MODBUS_RTU_BAD : MODBUS_RTU_WAIT);
		assert_int_equal(modbus_rtu_next(own, used, ADDRESS, true, &size), MODBUS_RTU_BAD);
	}
}

/* 1 + 253 + 2 bytes. */
static void test_the_longest_request_is_one_of_256_bytes(void **state)
{
	uint8_t bytes[MODBUS_RTU_MAX] = {ADDRESS, 0x2B, 0x0D, 1, 0, 0x20, 0, 1, 0, 0, 0, 242};
	size_t size;

	(void)state;
	assert_int_equal(with_crc(bytes, MODBUS_RTU_MAX - 2), MODBUS_RTU_MAX);
	assert_int_equal(modbus_rtu_next(frame, MODBUS_RTU_MAX, ADDRESS, false, &size), MODBUS_RTU_REQUEST);
	assert_int_equal(size, MODBUS_RTU_MAX);
	bytes[11] = 243;
	with_crc(bytes, MODBUS_RTU_MAX - 2);
	assert_int_equal(modbus_rtu_next(frame, MODBUS_RTU_MAX, ADDRESS, false, &size), MODBUS_RTU_BAD);
}

/* A frame of three bytes whose CRC fits: address and CRC without a function. */
static void test_what_has_no_function_is_no_request(void **state)
{
	size_t size, used = with_crc((const uint8_t[]){ADDRESS}, 1);

	(void)state;
	assert_int_equal(modbus_rtu_next(frame, used, ADDRESS, true, &size), MODBUS_RTU_BAD);
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

/* Each number at its limits and beyond, and how else it could be written. */
static void test_each_number_has_its_limits(void **state)
{
	static const struct {
		const char *option;
		unsigned low, high;
	} NUMBERS[] = {{"tcp:a,clients=", 1, 32}, {"tcp:a,idle=", 1, 86400}, {"tcp:a,rate=", 1, 10000},
		{"rtu:/dev/a,baud=", 1200, 921600}, {"rtu:/dev/a,stop=", 1, 2}, {"rtu:/dev/a,address=", 1, 247},
		{"tcp:a:", 1, 65535}, {"tcp:a,allow=1.2.3.4/", 0, 32}, {"tcp:a,allow=::1/", 0, 128}};
	static const char *const WRONG[] = {"", "-1", "+1", " 1", "1 ", "1x", "0x1", ":", "4294967297",
		"18446744073709551617", "99999999999999999999999"};
	char text[100];

	(void)state;
	for (size_t i = 0; i < sizeof(NUMBERS) / sizeof(*NUMBERS); i++) {
		const unsigned values[] = {NUMBERS[i].low, NUMBERS[i].high, NUMBERS[i].high + 1, NUMBERS[i].low - 1};

		for (int k = 0; k < 4; k++) {
			snprintf(text, sizeof(text), "%s%u", NUMBERS[i].option, values[k]);
			assert_int_equal(modbus_options_parse(&window, text, why, sizeof(why)), k < 2 ? 0 : -EINVAL);
		}
		for (size_t k = 0; k < sizeof(WRONG) / sizeof(*WRONG); k++) {
			snprintf(text, sizeof(text), "%s%s", NUMBERS[i].option, WRONG[k]);
			if (modbus_options_parse(&window, text, why, sizeof(why)) != -EINVAL)
				fail_msg("%s is accepted", text);
		}
	}
}

static void test_without_options_a_window_has_those_of_the_documentation(void **state)
{
	(void)state;
	assert_parses("tcp:a");
	assert_false(window.serial);
	assert_string_equal(window.port, "502");
	assert_int_equal(window.clients, 8);
	assert_int_equal(window.idle_s, 60);
	assert_int_equal(window.rate, 200);
	assert_parses("rtu:/dev/a");
	assert_int_equal(window.baud, 19200);
	assert_int_equal(window.stop, 1);
	assert_int_equal(window.parity, 'E');
	assert_int_equal(window.address, 1);
	assert_parses("rtu:/dev/a,parity=odd,write=yes,write=no");
	assert_int_equal(window.parity, 'O');
	assert_false(window.may_write);
	assert_parses("rtu:/dev/a,parity=none,parity=even");
	assert_int_equal(window.parity, 'E');
}

/* For every number of bits: the last address that differs behind them is in, the next before them is not. */
static void test_a_network_is_what_its_bits_say(void **state)
{
	static const uint8_t V4[4] = {10, 0xA5, 0x5A, 0xC3};
	static const uint8_t V6[16] = {0x20, 1, 0xD, 0xB8, 0xA5, 0x5A, 0xC3, 0x3C, 1, 2, 4, 8, 0x10, 0x20, 0x40, 0x80};
	uint8_t address[16];
	char text[100];

	(void)state;
	for (unsigned v6 = 0; v6 <= 1; v6++)
		for (unsigned bits = 0; bits <= (v6 ? 128 : 32); bits++) {
			unsigned fixed = v6 ? bits : 96 + bits;

			snprintf(text, sizeof(text), "tcp:a,allow=%s/%u",
				v6 ? "2001:db8:a55a:c33c:102:408:1020:4080" : "10.165.90.195", bits);
			assert_parses(text);
			for (unsigned bit = 0; bit < 128; bit++) {
				memset(address, 0, 10);
				address[10] = address[11] = 0xFF;
				memcpy(address + 12, V4, 4);
				if (v6)
					memcpy(address, V6, 16);
				assert_true(modbus_nets_have(&window.allow, address));
				address[bit / 8] ^= (uint8_t)(0x80 >> bit % 8);
				assert_int_equal(modbus_nets_have(&window.allow, address), bit >= fixed);
			}
		}
}

static void test_the_longest_texts_fit_and_longer_ones_are_refused(void **state)
{
	char text[300], name[300];

	(void)state;
	memset(name, 'h', sizeof(name));
	snprintf(text, sizeof(text), "tcp:%.63s:502", name);
	assert_parses(text);
	assert_int_equal(strlen(window.host), 63);
	snprintf(text, sizeof(text), "tcp:[%.63s]:502", name);
	assert_parses(text);
	snprintf(text, sizeof(text), "rtu:%.127s", name);
	assert_parses(text);
	assert_int_equal(strlen(window.device), 127);
	snprintf(text, sizeof(text), "tcp:%.64s:502", name);
	assert_int_equal(modbus_options_parse(&window, text, why, sizeof(why)), -EINVAL);
	snprintf(text, sizeof(text), "tcp:[%.64s]:502", name);
	assert_int_equal(modbus_options_parse(&window, text, why, sizeof(why)), -EINVAL);
	snprintf(text, sizeof(text), "rtu:%.128s", name);
	assert_int_equal(modbus_options_parse(&window, text, why, sizeof(why)), -EINVAL);
	assert_parses("tcp:a,allow=1.2.3.4,allow=1.2.3.5,allow=1.2.3.6,allow=1.2.3.7,allow=1.2.3.8,allow=1.2.3.9,"
		      "allow=1.2.3.10,allow=1.2.3.11");
	assert_true(may(&window.allow, "1.2.3.11"));
	assert_int_equal(modbus_options_parse(&window, "tcp:a,allow=00000000000000000000000000000000000000000000000::1",
				 why, sizeof(why)),
		-EINVAL);
	/* 255 characters, and one more */
	snprintf(text, sizeof(text), "tcp:a,rate=%.*d", 244, 5);
	assert_int_equal(strlen(text), 255);
	assert_parses(text);
	assert_int_equal(window.rate, 5);
	snprintf(text, sizeof(text), "tcp:a,rate=%.*d", 245, 5);
	assert_int_equal(modbus_options_parse(&window, text, why, sizeof(why)), -EINVAL);
	assert_string_equal(why, "'tcp:a,rate=00000000000000000000000000000...' is too long for a Modbus window");
}

static void test_a_reason_says_what_to_write(void **state)
{
	static const char *const REASONS[][2] = {
		{"udp:1", "'udp:1' is no Modbus window: write tcp:HOST:PORT or rtu:DEVICE"},
		{"tcp:", "Modbus window 'tcp:': write tcp:HOST:PORT, such as tcp:127.0.0.1:1502"},
		{"rtu:", "Modbus window 'rtu:': write rtu:DEVICE, such as rtu:/dev/ttyUSB0"},
		{"tcp:a,clients=0",
			"unknown Modbus option, bad value or more than 8 of a kind: 'clients=0': use allow=NET, "
			"write=NET, clients=1 to 32, idle=1 to 86400 (s), rate=1 to 10000 (1/s)"},
		{"rtu:/dev/a,stop=3",
			"unknown Modbus option, bad value or more than 8 of a kind: 'stop=3': use baud=1200 to 921600, "
			"parity=even, odd or none, stop=1 or 2, address=1 to 247, write=yes or no"},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(REASONS) / sizeof(*REASONS); i++) {
		assert_int_equal(modbus_options_parse(&window, REASONS[i][0], why, sizeof(why)), -EINVAL);
		assert_string_equal(why, REASONS[i][1]);
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
		cmocka_unit_test(test_bytes_without_a_frame_are_dropped_with_the_silence_or_when_there_is_no_room),
		cmocka_unit_test(test_the_longest_request_is_one_of_256_bytes),
		cmocka_unit_test(test_what_has_no_function_is_no_request),
		cmocka_unit_test(test_a_size_beyond_a_frame_is_no_request),
		cmocka_unit_test(test_by_default_this_host_reads_and_nobody_writes),
		cmocka_unit_test(test_the_lists_have_addresses_and_networks),
		cmocka_unit_test(test_a_serial_line_is_read_only_unless_it_may_write),
		cmocka_unit_test(test_what_is_wrong_is_refused_with_a_reason),
		cmocka_unit_test(test_each_number_has_its_limits),
		cmocka_unit_test(test_without_options_a_window_has_those_of_the_documentation),
		cmocka_unit_test(test_a_network_is_what_its_bits_say),
		cmocka_unit_test(test_the_longest_texts_fit_and_longer_ones_are_refused),
		cmocka_unit_test(test_a_reason_says_what_to_write),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

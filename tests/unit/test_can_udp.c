/* The udp bus: its codec against bytes made by python-can, and ports over real sockets. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <errno.h>
#include <net/if.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "drivers/can/udp_codec.h"
#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"

/* Made by python3-can 4.1.0: can.interfaces.udp_multicast.utils.pack_message(can.Message(...)). */
#define MAP(TIME, ID, EXTENDED, REMOTE, ERROR, CHANNEL, DLC, DATA, FD)                                                \
	"8ba974696d657374616d70cb" TIME "ae6172626974726174696f6e5f6964" ID "ae69735f657874656e6465645f6964" EXTENDED \
	"af69735f72656d6f74655f6672616d65" REMOTE "ae69735f6572726f725f6672616d65" ERROR "a76368616e6e656c" CHANNEL   \
	"a3646c63" DLC "a464617461" DATA "a569735f6664" FD "ae626974726174655f737769746368c2"                         \
	"b56572726f725f73746174655f696e64696361746f72c2"
#define NO_TIME "0000000000000000"

/* (arbitration_id=0x181, is_extended_id=False, data=[1, 2, 3, 4]) */
#define DATA_FRAME MAP(NO_TIME, "cd0181", "c2", "c2", "c2", "c0", "04", "c40401020304", "c2")
/* (arbitration_id=0x1FFFFFFF, is_extended_id=True, data=[1, 2, 3, 4, 5, 6, 7, 0xFF]) */
#define EXTENDED_FRAME MAP(NO_TIME, "ce1fffffff", "c3", "c2", "c2", "c0", "08", "c40801020304050607ff", "c2")
/* (arbitration_id=0x700, is_extended_id=False, is_remote_frame=True, dlc=1) */
#define REMOTE_FRAME MAP(NO_TIME, "cd0700", "c2", "c3", "c2", "c0", "01", "c400", "c2")
/* (timestamp=1700000000.25, arbitration_id=0x7F, is_extended_id=False, data=[], channel="vcan0") */
#define CHANNEL_FRAME MAP("41d954fc40100000", "7f", "c2", "c2", "c2", "a57663616e30", "00", "c400", "c2")
/* (arbitration_id=0x123, is_extended_id=False, is_fd=True, data=bytes(12)) */
#define FD_FRAME MAP(NO_TIME, "cd0123", "c2", "c2", "c2", "c0", "0c", "c40c000000000000000000000000", "c3")
/* (arbitration_id=0x4, is_extended_id=False, is_error_frame=True, data=bytes(8)) */
#define ERROR_FRAME MAP(NO_TIME, "04", "c2", "c2", "c3", "c0", "08", "c4080000000000000000", "c2")

static size_t from_hex(const char *hex, char *out)
{
	size_t size = strlen(hex) / 2;

	for (size_t i = 0; i < size; i++) {
		unsigned byte;

		assert_int_equal(sscanf(hex + 2 * i, "%2x", &byte), 1);
		out[i] = (char)byte;
	}
	return size;
}

static int decode(const char *hex, struct can_msg *msg)
{
	char bytes[1024];

	return can_udp_decode(bytes, from_hex(hex, bytes), msg);
}

static void assert_encodes_to(const struct can_msg *msg, const char *hex)
{
	char expected[1024], out[CAN_UDP_MAX];
	size_t size = from_hex(hex, expected);

	assert_int_equal(can_udp_encode(msg, out), size);
	assert_memory_equal(out, expected, size);
}

enum { PATIENCE_MS = 120000 }; /* for what must arrive */

static const struct can_msg data_frame = {.id = 0x181, .len = 4, .data = {1, 2, 3, 4}};
static const struct can_msg extended_frame = {
	.id = 0x1FFFFFFF, .extended = true, .len = 8, .data = {1, 2, 3, 4, 5, 6, 7, 0xFF}};
static const struct can_msg remote_frame = {.id = 0x700, .remote = true, .len = 1};

static void assert_same(const struct can_msg *a, const struct can_msg *b)
{
	assert_int_equal(a->id, b->id);
	assert_int_equal(a->extended, b->extended);
	assert_int_equal(a->remote, b->remote);
	assert_int_equal(a->len, b->len);
	assert_memory_equal(a->data, b->data, sizeof(a->data));
}

static void test_data_frames_are_written_as_python_can_writes_them(void **state)
{
	(void)state;
	assert_encodes_to(&data_frame, DATA_FRAME);
	assert_encodes_to(&extended_frame, EXTENDED_FRAME);
}

static void test_a_remote_frame_is_written_as_python_can_writes_it(void **state)
{
	(void)state;
	assert_encodes_to(&remote_frame, REMOTE_FRAME);
}

static void test_the_data_bytes_of_a_remote_frame_are_not_sent(void **state)
{
	struct can_msg msg = remote_frame;

	(void)state;
	msg.data[0] = 0x55;
	assert_encodes_to(&msg, REMOTE_FRAME);
}

static void test_frames_of_python_can_are_read(void **state)
{
	struct can_msg msg;

	(void)state;
	memset(&msg, 0xAA, sizeof(msg));
	assert_int_equal(decode(DATA_FRAME, &msg), 0);
	assert_same(&msg, &data_frame);
	assert_int_equal(decode(EXTENDED_FRAME, &msg), 0);
	assert_same(&msg, &extended_frame);
	assert_int_equal(decode(REMOTE_FRAME, &msg), 0);
	assert_same(&msg, &remote_frame);
}

static void test_a_frame_with_a_channel_name_and_a_time_is_read(void **state)
{
	const struct can_msg expected = {.id = 0x7F};
	struct can_msg msg;

	(void)state;
	assert_int_equal(decode(CHANNEL_FRAME, &msg), 0);
	assert_same(&msg, &expected);
}

static void test_every_length_and_identifier_size_survives_the_way_there_and_back(void **state)
{
	static const uint32_t ids[] = {0, 0x7F, 0x80, 0xFF, 0x100, 0x7FF, 0xFFFF, 0x10000, 0x1FFFFFFF};

	(void)state;
	for (size_t i = 0; i < sizeof(ids) / sizeof(ids[0]); i++) {
		for (uint8_t len = 0; len <= 8; len++) {
			struct can_msg msg = {.id = ids[i], .extended = ids[i] > 0x7FF, .len = len};
			struct can_msg back;
			char bytes[CAN_UDP_MAX];

			memset(msg.data, 0x80 + len, len);
			assert_int_equal(can_udp_decode(bytes, can_udp_encode(&msg, bytes), &back), 0);
			assert_same(&back, &msg);
		}
	}
}

static void test_fd_frames_and_error_frames_are_not_supported(void **state)
{
	struct can_msg msg;

	(void)state;
	assert_int_equal(decode(FD_FRAME, &msg), -ENOTSUP);
	assert_int_equal(decode(ERROR_FRAME, &msg), -ENOTSUP);
}

/* The page behind the bytes is unmapped: a read beyond them crashes. */
/* In a map of any order; the first is the same map with its last value. */
static void test_a_map_whose_last_value_is_missing_is_refused(void **state)
{
#define FIRST "85ae6172626974726174696f6e5f6964cd0181ae69735f657874656e6465645f6964c2a3646c6300a464617461c400"
	static const char *const last[][2] = {{"a76368616e6e656c", "c0"}, {"a974696d657374616d70", "cb" NO_TIME},
		{"af69735f72656d6f74655f6672616d65", "c2"}, {"a569735f6664", "c2"},
		{"ae69735f6572726f725f6672616d65", "c2"}, {"ae626974726174655f737769746368", "c2"}};
	struct can_msg msg;
	char hex[400];

	(void)state;
	for (size_t i = 0; i < sizeof(last) / sizeof(last[0]); i++) {
		snprintf(hex, sizeof(hex), FIRST "%s%s", last[i][0], last[i][1]);
		assert_int_equal(decode(hex, &msg), 0);
		snprintf(hex, sizeof(hex), FIRST "%s", last[i][0]);
		assert_true(decode(hex, &msg) < 0);
		snprintf(hex, sizeof(hex), FIRST);
		assert_true(decode(hex, &msg) < 0);
	}
}

static void test_every_truncation_is_refused_without_reading_on(void **state)
{
	size_t page = (size_t)sysconf(_SC_PAGESIZE);
	char *pages = mmap(NULL, 2 * page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
	char bytes[CAN_UDP_MAX];
	struct can_msg msg;
	size_t size = from_hex(EXTENDED_FRAME, bytes);

	(void)state;
	assert_ptr_not_equal(pages, MAP_FAILED);
	assert_int_equal(munmap(pages + page, page), 0);
	for (size_t length = 0; length < size; length++) {
		memcpy(pages + page - length, bytes, length);
		assert_int_equal(can_udp_decode(pages + page - length, length, &msg), -EBADMSG);
	}
	munmap(pages, page);
}

/* Each differs from a valid frame in one respect. */
static void test_what_is_not_a_valid_frame_is_refused(void **state)
{
	static const struct {
		const char *what, *hex;
	} bad[] = {
		{"bytes behind the map", DATA_FRAME "00"},
		{"an array", "93010203"},
		{"a number", "05"},
		{"an empty map", "80"},
		{"an unknown key", "81a3666f6f01"},
		{"a key that is a number", "810101"},
		{"an empty key", "81a001"},
		{"a standard identifier of 12 bits",
			MAP(NO_TIME, "cd0800", "c2", "c2", "c2", "c0", "00", "c400", "c2")},
		{"an identifier of 30 bits", MAP(NO_TIME, "ce20000000", "c3", "c2", "c2", "c0", "00", "c400", "c2")},
		{"an identifier of 64 bits",
			MAP(NO_TIME, "cf0000000100000001", "c3", "c2", "c2", "c0", "00", "c400", "c2")},
		{"a negative identifier", MAP(NO_TIME, "ff", "c2", "c2", "c2", "c0", "00", "c400", "c2")},
		{"a dlc of 9", MAP(NO_TIME, "01", "c2", "c2", "c2", "c0", "09", "c409000000000000000000", "c2")},
		{"a dlc above the data", MAP(NO_TIME, "01", "c2", "c2", "c2", "c0", "02", "c401aa", "c2")},
		{"a dlc below the data", MAP(NO_TIME, "01", "c2", "c2", "c2", "c0", "01", "c402aaaa", "c2")},
		{"a remote frame with data", MAP(NO_TIME, "01", "c2", "c3", "c2", "c0", "01", "c401aa", "c2")},
		{"data as text", MAP(NO_TIME, "01", "c2", "c2", "c2", "c0", "01", "a161", "c2")},
		{"a flag that is a number", MAP(NO_TIME, "01", "00", "c2", "c2", "c0", "00", "c400", "c2")},
		{"a channel that is a map", MAP(NO_TIME, "01", "c2", "c2", "c2", "80", "00", "c400", "c2")},
	};
	struct can_msg msg;

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		int result = decode(bad[i].hex, &msg);

		if (result != -EBADMSG)
			fail_msg("%s: %d", bad[i].what, result);
	}
}

/* A map says in its first byte how many entries follow: 8Bh is 11. */
static void test_a_map_with_another_number_of_entries_than_it_says_is_refused(void **state)
{
	char bytes[CAN_UDP_MAX];
	struct can_msg msg;
	size_t size = from_hex(DATA_FRAME, bytes);

	(void)state;
	assert_int_equal((unsigned char)bytes[0], 0x8B);
	bytes[0] = (char)0x8A; /* the last entry is behind the map */
	assert_int_equal(can_udp_decode(bytes, size, &msg), -EBADMSG);
	bytes[0] = (char)0x8C; /* one is missing */
	assert_int_equal(can_udp_decode(bytes, size, &msg), -EBADMSG);
	bytes[0] = (char)0x80;
	assert_int_equal(can_udp_decode(bytes, size, &msg), -EBADMSG);
}

#define ID_181	 "ae6172626974726174696f6e5f6964cd0181"
#define STANDARD "ae69735f657874656e6465645f6964c2"
#define DLC_0	 "a3646c6300"

static void test_identifier_its_format_and_the_length_are_required_and_nothing_else(void **state)
{
	struct can_msg msg;

	(void)state;
	assert_int_equal(decode("83" ID_181 STANDARD DLC_0, &msg), 0);
	assert_same(&msg, &(struct can_msg){.id = 0x181});
	assert_int_equal(decode("82" STANDARD DLC_0, &msg), -EBADMSG);
	assert_int_equal(decode("82" ID_181 DLC_0, &msg), -EBADMSG);
	assert_int_equal(decode("82" ID_181 STANDARD, &msg), -EBADMSG);
}

static void test_a_map_with_a_16_bit_or_32_bit_count_is_read(void **state)
{
	struct can_msg msg;

	(void)state;
	assert_int_equal(decode("de0003" ID_181 STANDARD DLC_0, &msg), 0);
	assert_int_equal(decode("df00000003" ID_181 STANDARD DLC_0, &msg), 0);
	assert_same(&msg, &(struct can_msg){.id = 0x181});
	assert_int_equal(decode("de0004" ID_181 STANDARD DLC_0, &msg), -EBADMSG);
	assert_int_equal(decode("dfffffffff" ID_181 STANDARD DLC_0, &msg), -EBADMSG);
}

/* ---- over sockets: a UDP port of this process only, so that no other program's frames are received ---- */

static uint64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * 1000000 + (uint64_t)t.tv_nsec / 1000;
}

static uint16_t test_port(void)
{
	return (uint16_t)(20000 + getpid() % 20000);
}

struct pair {
	struct can_port *a, *b;
};

/* Linux has had SO_RXQ_OVFL since 2.6.33; qemu-user does not pass it on. */
static void skip_in_an_emulator(void)
{
	int on = 1, fd = socket(AF_INET, SOCK_DGRAM, 0);

	assert_true(fd >= 0);
	if (setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof(on)) != 0) {
		print_message("skipped: no SO_RXQ_OVFL here\n");
		close(fd);
		skip();
	}
	close(fd);
}

static struct can_port *open_bus(const char *format)
{
	struct can_port *port;
	char bus[80], error[200] = "";

	skip_in_an_emulator();
	snprintf(bus, sizeof(bus), format, test_port());
	if (can_open(bus, &port, error, sizeof(error)) < 0 || error[0])
		fail_msg("%s", error);
	return port;
}

static struct pair open_pair(void)
{
	return (struct pair){open_bus("udp:239.74.163.77:%u"), open_bus("udp:239.74.163.77:%u")};
}

static void close_pair(struct pair bus)
{
	can_close(bus.a);
	can_close(bus.b);
}

static int receive_within(struct can_port *port, struct can_msg *msg, int timeout_ms)
{
	struct pollfd poll_fd = {.fd = port->fd, .events = POLLIN};
	int result = can_receive(port, msg, now());

	if (result == 0 && poll(&poll_fd, 1, timeout_ms) == 1)
		result = can_receive(port, msg, now());
	return result;
}

static void test_a_frame_reaches_the_other_port(void **state)
{
	struct pair bus = open_pair();
	struct can_msg msg;

	(void)state;
	assert_int_equal(can_send(bus.a, &data_frame, now()), 0);
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &data_frame);
	assert_int_equal(bus.a->counters.tx, 1);
	assert_int_equal(bus.b->counters.rx, 1);
	close_pair(bus);
}

static void test_own_frames_are_not_received_nor_counted(void **state)
{
	struct pair bus = open_pair();
	struct can_msg msg;

	(void)state;
	can_send(bus.a, &data_frame, now());
	can_send(bus.b, &remote_frame, now());
	assert_int_equal(receive_within(bus.a, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &remote_frame);
	assert_int_equal(receive_within(bus.a, &msg, 20), 0);
	assert_int_equal(bus.a->counters.rx, 1);
	assert_int_equal(bus.a->counters.rx_dropped, 0);
	close_pair(bus);
}

static void test_the_time_of_a_frame_is_that_of_its_sending_not_of_its_reading(void **state)
{
	struct pair bus = open_pair();
	const uint64_t before_us = now();
	struct can_msg msg;
	uint64_t sent_us;

	(void)state;
	can_send(bus.a, &data_frame, before_us);
	sent_us = now();
	usleep(20000);
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_in_range(msg.t_us, before_us - 100, sent_us + 100);
	close_pair(bus);
}

static void test_a_burst_of_100_arrives_whole_and_in_order(void **state)
{
	struct pair bus = open_pair();
	struct can_msg msg = data_frame;

	(void)state;
	for (uint32_t id = 0; id < 100; id++) {
		msg.id = id;
		can_send(bus.a, &msg, now());
	}
	for (uint32_t id = 0; id < 100; id++) {
		assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
		assert_int_equal(msg.id, id);
	}
	close_pair(bus);
}

static void test_a_filter_lets_only_its_identifiers_through(void **state)
{
	static const uint32_t ids[] = {0, 0x601};
	struct pair bus = open_pair();
	struct can_msg msg = data_frame;

	(void)state;
	assert_int_equal(can_filter(bus.b, ids, 2), 0);
	can_send(bus.a, &data_frame, now());
	msg.id = 0x601;
	msg.extended = true;
	can_send(bus.a, &msg, now());
	msg.extended = false;
	msg.remote = true;
	can_send(bus.a, &msg, now());
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_int_equal(msg.id, 0x601);
	assert_true(msg.remote);
	assert_int_equal(bus.b->counters.rx, 1);

	assert_int_equal(can_filter(bus.b, NULL, 0), 0);
	can_send(bus.a, &extended_frame, now());
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &extended_frame);
	close_pair(bus);
}

/* To the group of open_pair(), routed as the driver does: by loopback where there is no route. */
static void send_raw(int fd, const char *data, size_t size)
{
	const struct ip_mreqn loopback = {.imr_ifindex = (int)if_nametoindex("lo")};
	struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(test_port())};

	inet_pton(AF_INET, "239.74.163.77", &to.sin_addr);
	if (sendto(fd, data, size, 0, (struct sockaddr *)&to, sizeof(to)) == (ssize_t)size)
		return;
	setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof(loopback));
	assert_int_equal(sendto(fd, data, size, 0, (struct sockaddr *)&to, sizeof(to)), size);
}

static void test_malformed_datagrams_are_counted_and_the_next_frame_is_read(void **state)
{
	struct pair bus = open_pair();
	int fd = socket(AF_INET, SOCK_DGRAM, 0);
	const char junk[1000] = "junk";
	struct can_msg msg;

	(void)state;
	send_raw(fd, junk, 4);
	send_raw(fd, junk, sizeof(junk));
	can_send(bus.a, &data_frame, now());
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &data_frame);
	assert_int_equal(bus.b->counters.rx_dropped, 2);
	close(fd);
	close_pair(bus);
}

static void test_a_call_reads_a_bounded_number_of_unwanted_datagrams(void **state)
{
	enum { UNWANTED = 1000 };
	struct pair bus = open_pair();
	const struct can_msg unwanted = {.id = 0x300, .len = 8};
	const uint32_t ids[] = {0x181};
	struct can_msg msg;
	int calls = 1;

	(void)state;
	assert_int_equal(can_filter(bus.b, ids, 1), 0);
	for (int i = 0; i < UNWANTED; i++)
		can_send(bus.a, &unwanted, now());
	can_send(bus.a, &data_frame, now());
	for (; receive_within(bus.b, &msg, 10) == 0 && calls < UNWANTED; calls++) {
		can_service(bus.a, now()); /* what the socket did not take at once */
		if (calls % 50 == 0)	   /* a busy machine loses some on the way */
			can_send(bus.a, &data_frame, now());
	}
	assert_same(&msg, &data_frame);
	assert_in_range(calls, 3, UNWANTED / 20); /* 64 a call; a busy machine needs more */
	close_pair(bus);
}

/* The kernel reports drops with the next datagram it has room for. The pauses let it move the datagrams to the receive
 * buffer, which holds about 2500. On a busy machine more are lost on the way there, and in no count. */
static void test_frames_the_kernel_dropped_for_a_slow_reader_are_counted(void **state)
{
	enum { FRAMES = 4000 };
	struct pair bus = open_pair();
	struct can_msg msg;
	uint32_t received = 0;

	(void)state;
	for (int i = 1; i <= FRAMES; i++) {
		can_send(bus.a, &data_frame, now());
		if (i % 50 == 0)
			usleep(1000);
		for (int k = 0; k < 10000 && bus.a->queue_count > 0; k++) { /* until the socket takes it */
			usleep(1000);
			can_service(bus.a, now());
		}
	}
	assert_int_equal(bus.a->counters.tx, FRAMES);
	while (receive_within(bus.b, &msg, 1000) == 1)
		received++;
	can_send(bus.a, &data_frame, now());
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_true(received < FRAMES);
	assert_in_range(bus.b->counters.rx_dropped, 1, FRAMES);
	assert_in_range(received + bus.b->counters.rx_dropped, FRAMES / 2, FRAMES);
	close_pair(bus);
}

static void test_addresses_that_are_not_multicast_groups_are_refused(void **state)
{
	static const char *const bad[] = {
		"udp:10.0.0.1",
		"udp:::1",
		"udp:nonsense",
		"udp:239.1.1.1:0",
		"udp:239.1.1.1:65536",
		"udp:239.1.1.1:",
		"udp:239.1.1.1:12x",
		"udp:239.1.1.1: 12",
		"udp:[ff15::1",
		"udp:[ff15::1]12",
		"udp:fffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
	};
	char error[200];

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		struct can_port *port = NULL;

		if (can_open(bad[i], &port, error, sizeof(error)) != -EINVAL)
			fail_msg("%s", bad[i]);
		assert_non_null(strstr(error, bad[i]));
		assert_non_null(strstr(error, "with a multicast group"));
	}
}

static void test_an_address_of_more_than_255_characters_is_refused(void **state)
{
	char bus[300] = "udp:239.1.1.1,hosts=", error[200] = "";
	struct can_port *port = NULL;

	(void)state;
	memset(bus + strlen(bus), '1', sizeof(bus) - 1 - strlen(bus));
	bus[sizeof(bus) - 1] = 0;
	assert_int_equal(can_open(bus, &port, error, sizeof(error)), -EINVAL);
	assert_null(port);
	assert_true(error[0] != 0);
}

static void assert_bound_to(const struct can_port *port, const char *group, uint16_t port_number)
{
	struct sockaddr_in address;
	socklen_t size = sizeof(address);
	char text[INET_ADDRSTRLEN];

	assert_int_equal(getsockname(port->fd, (struct sockaddr *)&address, &size), 0);
	assert_string_equal(inet_ntop(AF_INET, &address.sin_addr, text, sizeof(text)), group);
	assert_int_equal(ntohs(address.sin_port), port_number);
}

/* Other programs may use this bus: nothing is sent. */
static void test_the_default_is_the_group_and_the_port_of_python_can(void **state)
{
	struct can_port *port = open_bus("udp");

	(void)state;
	assert_string_equal(port->name, "udp");
	assert_bound_to(port, "239.74.163.2", 43113);
	can_close(port);
	port = open_bus("udp:239.74.163.77");
	assert_string_equal(port->name, "udp:239.74.163.77");
	assert_bound_to(port, "239.74.163.77", 43113);
	can_close(port);
	port = open_bus("udp::%u");
	assert_bound_to(port, "239.74.163.2", test_port());
	can_close(port);
}

static void test_each_of_several_ports_of_a_host_receives_what_another_sends(void **state)
{
	struct pair bus = open_pair();
	struct can_port *third = open_bus("udp:239.74.163.77:%u");
	struct can_msg msg;

	(void)state;
	can_send(bus.b, &remote_frame, now());
	assert_int_equal(receive_within(bus.a, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &remote_frame);
	assert_int_equal(receive_within(third, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &remote_frame);
	can_close(third);
	close_pair(bus);
}

static void test_another_group_or_another_port_is_another_bus(void **state)
{
	struct can_port *a = open_bus("udp:239.74.163.77:%u"), *group = open_bus("udp:239.74.163.78:%u"), *port, *b;
	struct can_msg msg;
	char bus[80], error[200];

	(void)state;
	snprintf(bus, sizeof(bus), "udp:239.74.163.77:%u", test_port() + 1u);
	assert_int_equal(can_open(bus, &port, error, sizeof(error)), 0);
	b = open_bus("udp:239.74.163.77:%u");
	can_send(a, &data_frame, now());
	assert_int_equal(receive_within(b, &msg, PATIENCE_MS), 1); /* so it has been delivered */
	assert_int_equal(receive_within(group, &msg, 0), 0);
	assert_int_equal(receive_within(port, &msg, 0), 0);
	can_close(a);
	can_close(b);
	can_close(group);
	can_close(port);
}

static void test_a_datagram_of_a_program_that_is_not_in_the_group_is_received(void **state)
{
	struct can_port *port = open_bus("udp:239.74.163.77:%u");
	int fd = socket(AF_INET, SOCK_DGRAM, 0);
	char bytes[CAN_UDP_MAX];
	struct can_msg msg;

	(void)state;
	send_raw(fd, bytes, from_hex(DATA_FRAME, bytes));
	assert_int_equal(receive_within(port, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &data_frame);
	close(fd);
	can_close(port);
}

static void test_what_a_port_sends_is_the_datagram_of_python_can(void **state)
{
	struct can_port *port = open_bus("udp:239.74.163.77:%u");
	int fd = socket(AF_INET, SOCK_DGRAM, 0);
	const int on = 1;
	struct sockaddr_in group = {.sin_family = AF_INET, .sin_port = htons(test_port())};
	struct ip_mreqn membership = {0};
	char expected[CAN_UDP_MAX], bytes[CAN_UDP_MAX];
	size_t size = from_hex(DATA_FRAME, expected);
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};

	(void)state;
	inet_pton(AF_INET, "239.74.163.77", &group.sin_addr);
	membership.imr_multiaddr = group.sin_addr;
	setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
	assert_int_equal(bind(fd, (struct sockaddr *)&group, sizeof(group)), 0);
	if (setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof(membership)) != 0) {
		membership.imr_ifindex = (int)if_nametoindex("lo"); /* no route to the group */
		assert_int_equal(setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof(membership)), 0);
	}
	can_send(port, &data_frame, now());
	assert_int_equal(poll(&poll_fd, 1, PATIENCE_MS), 1);
	assert_int_equal(recv(fd, bytes, sizeof(bytes), 0), size);
	assert_memory_equal(bytes, expected, size);
	close(fd);
	can_close(port);
}

/* The source port of the next datagram that reaches the bus. */
static uint16_t source_port(const struct can_port *port)
{
	struct pollfd poll_fd = {.fd = port->fd, .events = POLLIN};
	struct sockaddr_in source;
	socklen_t size = sizeof(source);
	char bytes[CAN_UDP_MAX];

	assert_int_equal(poll(&poll_fd, 1, PATIENCE_MS), 1);
	assert_true(recvfrom(port->fd, bytes, sizeof(bytes), 0, (struct sockaddr *)&source, &size) > 0);
	return ntohs(source.sin_port);
}

/* The kernel chooses source ports from a range that contains 43113, the default. */
static void test_a_source_port_of_one_bus_can_be_the_port_of_another(void **state)
{
	struct pair bus = open_pair(), other;
	struct can_msg msg;
	char name[80], error[200] = "";

	(void)state;
	can_send(bus.a, &data_frame, now());
	snprintf(name, sizeof(name), "udp:239.74.163.77:%u", source_port(bus.b));
	if (can_open(name, &other.a, error, sizeof(error)) < 0)
		fail_msg("%s", error);
	assert_int_equal(can_open(name, &other.b, error, sizeof(error)), 0);
	can_send(other.a, &remote_frame, now());
	assert_int_equal(receive_within(other.b, &msg, PATIENCE_MS), 1);
	can_send(bus.a, &data_frame, now());
	assert_int_equal(receive_within(bus.b, &msg, PATIENCE_MS), 1);
	assert_same(&msg, &data_frame);
	close_pair(other);
	close_pair(bus);
}

static void test_a_port_that_a_program_has_for_itself_is_told(void **state)
{
	struct sockaddr_in own = {.sin_family = AF_INET};
	socklen_t size = sizeof(own);
	struct can_port *port;
	char name[80], error[200] = "";

	(void)state;
	skip_in_an_emulator();
	int fd = socket(AF_INET, SOCK_DGRAM, 0);
	assert_int_equal(bind(fd, (struct sockaddr *)&own, size), 0);
	assert_int_equal(getsockname(fd, (struct sockaddr *)&own, &size), 0);
	snprintf(name, sizeof(name), "udp:239.74.163.77:%u", ntohs(own.sin_port));
	assert_int_equal(can_open(name, &port, error, sizeof(error)), -EADDRINUSE);
	assert_non_null(strstr(error, "another program has its UDP port for itself"));
	assert_non_null(strstr(error, "udp:GROUP:PORT"));
	close(fd);
}

static void test_an_ipv6_group_with_a_port_is_opened(void **state)
{
	struct can_port *port = open_bus("udp:[ff15::77]:%u");

	(void)state;
	assert_memory_equal(port->name, "udp:[ff15::77]:", 15);
	can_close(port);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_data_frames_are_written_as_python_can_writes_them),
		cmocka_unit_test(test_a_remote_frame_is_written_as_python_can_writes_it),
		cmocka_unit_test(test_the_data_bytes_of_a_remote_frame_are_not_sent),
		cmocka_unit_test(test_frames_of_python_can_are_read),
		cmocka_unit_test(test_a_frame_with_a_channel_name_and_a_time_is_read),
		cmocka_unit_test(test_every_length_and_identifier_size_survives_the_way_there_and_back),
		cmocka_unit_test(test_fd_frames_and_error_frames_are_not_supported),
		cmocka_unit_test(test_a_map_whose_last_value_is_missing_is_refused),
		cmocka_unit_test(test_every_truncation_is_refused_without_reading_on),
		cmocka_unit_test(test_what_is_not_a_valid_frame_is_refused),
		cmocka_unit_test(test_a_map_with_another_number_of_entries_than_it_says_is_refused),
		cmocka_unit_test(test_identifier_its_format_and_the_length_are_required_and_nothing_else),
		cmocka_unit_test(test_a_map_with_a_16_bit_or_32_bit_count_is_read),
		cmocka_unit_test(test_the_default_is_the_group_and_the_port_of_python_can),
		cmocka_unit_test(test_each_of_several_ports_of_a_host_receives_what_another_sends),
		cmocka_unit_test(test_another_group_or_another_port_is_another_bus),
		cmocka_unit_test(test_a_datagram_of_a_program_that_is_not_in_the_group_is_received),
		cmocka_unit_test(test_what_a_port_sends_is_the_datagram_of_python_can),
		cmocka_unit_test(test_a_frame_reaches_the_other_port),
		cmocka_unit_test(test_own_frames_are_not_received_nor_counted),
		cmocka_unit_test(test_the_time_of_a_frame_is_that_of_its_sending_not_of_its_reading),
		cmocka_unit_test(test_a_burst_of_100_arrives_whole_and_in_order),
		cmocka_unit_test(test_a_filter_lets_only_its_identifiers_through),
		cmocka_unit_test(test_malformed_datagrams_are_counted_and_the_next_frame_is_read),
		cmocka_unit_test(test_a_call_reads_a_bounded_number_of_unwanted_datagrams),
		cmocka_unit_test(test_frames_the_kernel_dropped_for_a_slow_reader_are_counted),
		cmocka_unit_test(test_addresses_that_are_not_multicast_groups_are_refused),
		cmocka_unit_test(test_an_address_of_more_than_255_characters_is_refused),
		cmocka_unit_test(test_a_source_port_of_one_bus_can_be_the_port_of_another),
		cmocka_unit_test(test_a_port_that_a_program_has_for_itself_is_told),
		cmocka_unit_test(test_an_ipv6_group_with_a_port_is_opened),
	};

	return cmocka_run_group_tests_name("can_udp", tests, count_descriptors, no_descriptor_is_left);
}

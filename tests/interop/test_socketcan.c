/* The SocketCAN driver on its own vcan, against can-utils. Needs root and vcan:
 *
 *     make build/tests/interop/test_socketcan && tests/rig/vcan-run build/tests/interop/test_socketcan
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "drivers/ports/can.h"

#define IF "imu9test" /* used by this test only */

enum { SKIPPED = 77 };

static uint64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * 1000000 + (uint64_t)t.tv_nsec / 1000;
}

static void shell(const char *command)
{
	if (system(command) != 0)
		fail_msg("failed: %s", command);
}

static bool readable(const struct can_port *port, int timeout_ms)
{
	struct pollfd poll_fd = {.fd = port->fd, .events = POLLIN};

	return poll(&poll_fd, 1, timeout_ms) == 1;
}

static int receive_within(struct can_port *port, struct can_msg *msg, int timeout_ms)
{
	int result = can_receive(port, msg, now());

	if (result == 0 && readable(port, timeout_ms))
		result = can_receive(port, msg, now());
	return result;
}

static void assert_receives(struct can_port *port, uint32_t id)
{
	struct can_msg msg;

	assert_int_equal(receive_within(port, &msg, 1000), 1);
	assert_int_equal(msg.id, id);
}

static void assert_receives_nothing(struct can_port *port)
{
	struct can_msg msg;

	assert_int_equal(receive_within(port, &msg, 50), 0);
}

static int send_id(struct can_port *port, uint32_t id)
{
	const struct can_msg msg = {.id = id, .len = 1};

	return can_send(port, &msg, now());
}

static int open_port(void **state)
{
	struct can_port *port;
	char error[300];

	if (system("ip link show " IF " >/dev/null 2>&1 || ip link add dev " IF " type vcan") != 0 ||
		system("ip link set " IF " up") != 0)
		return -1;
	if (can_open(IF, &port, error, sizeof(error)) < 0) {
		print_error("%s\n", error);
		return -1;
	}
	*state = port;
	return 0;
}

static int close_port(void **state)
{
	can_close(*state);
	return 0;
}

/* ---- frames ---- */

static void test_data_extended_and_remote_frames_come_in_as_they_were_sent(void **state)
{
	const uint8_t data[8] = {0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88};
	struct can_msg msg;

	shell("cansend " IF " 7FF#1122334455667788; cansend " IF " 1FFFFFFF#11; cansend " IF " 701#R4");
	assert_int_equal(receive_within(*state, &msg, 1000), 1);
	assert_int_equal(msg.id, 0x7FF);
	assert_false(msg.extended);
	assert_false(msg.remote);
	assert_int_equal(msg.len, 8);
	assert_memory_equal(msg.data, data, 8);
	assert_int_equal(receive_within(*state, &msg, 1000), 1);
	assert_int_equal(msg.id, 0x1FFFFFFF);
	assert_true(msg.extended);
	assert_int_equal(msg.len, 1);
	assert_int_equal(receive_within(*state, &msg, 1000), 1);
	assert_int_equal(msg.id, 0x701);
	assert_true(msg.remote);
	assert_int_equal(msg.len, 4);
}

static void test_frames_go_out_as_they_should(void **state)
{
	const struct can_msg data = {.id = 0x181, .len = 3, .data = {1, 2, 3}};
	const struct can_msg extended = {.id = 0x12345678, .extended = true};
	const struct can_msg remote = {.id = 0x701, .remote = true, .len = 1};
	char line[80], seen[200] = "";
	FILE *candump = popen("candump -L -n 3 -T 2000 " IF " | cut -d' ' -f3", "r");

	assert_non_null(candump);
	usleep(300000);
	can_send(*state, &data, now());
	can_send(*state, &extended, now());
	can_send(*state, &remote, now());
	while (fgets(line, sizeof(line), candump) != NULL)
		strncat(seen, line, sizeof(seen) - strlen(seen) - 1);
	pclose(candump);
	assert_string_equal(seen, "181#010203\n12345678#\n701#R1\n");
}

static void test_own_frames_are_not_received(void **state)
{
	send_id(*state, 0x181);
	assert_receives_nothing(*state);
}

static void test_the_time_of_a_frame_is_when_it_came_in(void **state)
{
	struct can_msg msg;
	uint64_t before_us = now(), after_us;

	shell("cansend " IF " 123#");
	after_us = now();
	usleep(100000);
	assert_int_equal(receive_within(*state, &msg, 1000), 1);
	assert_in_range(msg.t_us, before_us, after_us);
}

/* In bursts that fit into the receive buffer: cangen is faster than any bus. */
static void test_10000_frames_come_in_whole_and_in_order(void **state)
{
	struct can_msg msg;

	for (int burst = 0; burst < 20; burst++) {
		shell("cangen -g 0 -n 500 -I 123 -L 4 -D i " IF);
		for (int i = 0; i < 500; i++) {
			assert_int_equal(receive_within(*state, &msg, 1000), 1);
			assert_int_equal(msg.data[0] | msg.data[1] << 8, i);
		}
	}
	assert_receives_nothing(*state);
}

static void test_10000_frames_go_out_whole_and_in_order(void **state)
{
	struct can_port *port = *state;
	struct can_msg msg = {.id = 0x181, .len = 2};
	FILE *candump = popen("candump -L -n 10000 -T 3000 -r 20000000 " IF, "r");
	char line[80];
	unsigned value;

	assert_non_null(candump);
	usleep(300000);
	for (int i = 0; i < 10000; i++) {
		msg.data[0] = (uint8_t)(i >> 8);
		msg.data[1] = (uint8_t)i;
		assert_int_equal(can_send(port, &msg, now()), 0);
		if (i % 500 == 499)
			usleep(20000); /* the kernel queues at most 1000 frames of a vcan */
	}
	assert_int_equal(port->counters.tx, 10000);
	for (unsigned i = 0; i < 10000; i++) {
		assert_non_null(fgets(line, sizeof(line), candump));
		assert_int_equal(sscanf(line, "(%*[^)]) " IF " 181#%x", &value), 1);
		assert_int_equal(value, i);
	}
	pclose(candump);
}

static void test_frames_the_kernel_dropped_for_a_slow_reader_are_counted(void **state)
{
	enum { FRAMES = 4000 };
	struct can_port *port = *state, *sender;
	struct can_msg msg;
	char error[300];
	uint32_t received = 0;

	assert_int_equal(can_open(IF, &sender, error, sizeof(error)), 0);
	for (int i = 0; i < FRAMES; i++) {
		assert_int_equal(send_id(sender, 0x181), 0);
		if (i % 500 == 499)
			usleep(20000);
	}
	while (receive_within(port, &msg, 50) == 1)
		received++;
	send_id(sender, 0x181); /* the kernel reports drops with the next frame */
	assert_receives(port, 0x181);
	assert_true(received < FRAMES);
	assert_int_equal(received + port->counters.rx_dropped, FRAMES);
	can_close(sender);
}

/* ---- filters ---- */

static void test_a_filter_passes_data_and_remote_frames_of_its_identifiers_only(void **state)
{
	static const uint32_t ids[] = {0x000, 0x601};
	struct can_port *port = *state;

	assert_int_equal(can_filter(port, ids, 2), 0);
	shell("for f in 600# 00000601# 602#11 601#R 000#01; do cansend " IF " $f; done");
	assert_receives(port, 0x601);
	assert_receives(port, 0x000);
	assert_receives_nothing(port);
	assert_int_equal(port->counters.rx, 2);
}

static void test_an_empty_filter_passes_all_frames(void **state)
{
	static const uint32_t ids[] = {0x601};

	can_filter(*state, ids, 1);
	assert_int_equal(can_filter(*state, NULL, 0), 0);
	shell("cansend " IF " 123#; cansend " IF " 12345678#");
	assert_receives(*state, 0x123);
	assert_receives(*state, 0x12345678);
}

static void test_more_identifiers_than_the_kernel_takes_pass_all(void **state)
{
	uint32_t ids[513] = {0x601};

	assert_int_equal(can_filter(*state, ids, 513), 0);
	shell("cansend " IF " 123#");
	assert_receives(*state, 0x123);
}

static void test_error_frames_pass_every_filter(void **state)
{
	static const uint32_t ids[] = {0x601};
	struct can_port *port = *state;

	can_filter(port, ids, 1);
	shell("cansend " IF " 20000040#0000000000000000");
	assert_receives_nothing(port);
	assert_int_equal(port->counters.errors, 1);
}

/* ---- error frames ---- */

static enum can_state state_after(struct can_port *port, const char *error_frame)
{
	char command[80];

	snprintf(command, sizeof(command), "cansend " IF " %s", error_frame);
	shell(command);
	assert_receives_nothing(port);
	return port->state;
}

static void test_the_state_follows_the_controller(void **state)
{
	struct can_port *port = *state;

	assert_int_equal(state_after(port, "20000004#0008000000000000"), CAN_STATE_WARNING);
	assert_int_equal(state_after(port, "20000004#0020000000000000"), CAN_STATE_PASSIVE);
	assert_int_equal(state_after(port, "20000004#0004000000000000"), CAN_STATE_WARNING);
	assert_int_equal(state_after(port, "20000004#0040000000000000"), CAN_STATE_ACTIVE);
	assert_int_equal(state_after(port, "20000004#0010000000000000"), CAN_STATE_PASSIVE);
	assert_int_equal(port->counters.errors, 5);
	assert_int_equal(port->counters.rx, 0);
}

static void test_bus_off_is_detected_counted_once_and_ended_by_a_restart(void **state)
{
	struct can_port *port = *state;

	assert_int_equal(state_after(port, "20000040#0000000000000000"), CAN_STATE_BUS_OFF);
	assert_int_equal(state_after(port, "20000040#0000000000000000"), CAN_STATE_BUS_OFF);
	assert_int_equal(port->counters.bus_off, 1);
	assert_int_equal(state_after(port, "20000100#0000000000000000"), CAN_STATE_ACTIVE);
	assert_int_equal(state_after(port, "20000040#0000000000000000"), CAN_STATE_BUS_OFF);
	assert_int_equal(port->counters.bus_off, 2);
}

static void test_a_bus_error_changes_no_state(void **state)
{
	assert_int_equal(state_after(*state, "20000088#0000040000000000"), CAN_STATE_ACTIVE);
	assert_int_equal(((struct can_port *)*state)->counters.errors, 1);
}

static void test_an_overflow_in_the_controller_counts_as_a_lost_frame(void **state)
{
	assert_int_equal(state_after(*state, "20000004#0001000000000000"), CAN_STATE_ACTIVE);
	assert_int_equal(((struct can_port *)*state)->counters.rx_dropped, 1);
}

/* ---- an interface that goes down or away ---- */

static void assert_down(struct can_port *port)
{
	struct can_msg msg;

	assert_true(readable(port, 1000));
	assert_true(can_receive(port, &msg, now()) < 0);
	assert_int_equal(port->state, CAN_STATE_DOWN);
}

static void assert_comes_back(struct can_port *port)
{
	for (uint64_t until_us = now() + 1000000; port->state == CAN_STATE_DOWN;) {
		uint64_t next_us = can_service(port, now());

		assert_true(now() < until_us);
		if (next_us != UINT64_MAX)
			usleep((unsigned)(next_us > now() ? next_us - now() : 0));
	}
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_true(can_service(port, now()) == UINT64_MAX);
	shell("cansend " IF " 123#; cansend " IF " 601#");
}

static void test_going_down_is_reported_once_and_frames_are_refused_and_counted(void **state)
{
	struct can_port *port = *state;

	shell("ip link set " IF " down");
	assert_down(port);
	assert_false(readable(port, 300)); /* or a poll loop would be busy */
	assert_int_equal(send_id(port, 0x181), -ENETDOWN);
	assert_int_equal(port->counters.tx_dropped, 1);
	assert_int_equal(can_service(port, 5000000), 5200000);
	assert_int_equal(port->state, CAN_STATE_DOWN);
}

static void test_an_interface_that_comes_up_again_works_again(void **state)
{
	static const uint32_t ids[] = {0x601};
	struct can_port *port = *state;
	int fd = port->fd;

	can_filter(port, ids, 1);
	shell("ip link set " IF " down");
	assert_down(port);
	can_service(port, now());
	shell("ip link set " IF " up");
	assert_comes_back(port);
	assert_receives(port, 0x601);
	assert_int_equal(send_id(port, 0x181), 0);
	assert_int_equal(port->fd, fd);
}

static void test_frames_that_came_in_before_going_down_are_still_delivered(void **state)
{
	struct can_port *port = *state;

	shell("cansend " IF " 123#; ip link set " IF " down");
	assert_down(port);
	shell("ip link set " IF " up");
	assert_receives(port, 0x123);
}

static void test_an_interface_that_is_removed_and_created_again_works_again(void **state)
{
	static const uint32_t ids[] = {0x601};
	struct can_port *port = *state;
	int fd = port->fd;

	can_filter(port, ids, 1);
	shell("ip link del " IF); /* may be reported twice: down, then gone */
	assert_down(port);
	if (readable(port, 0))
		assert_down(port);
	assert_false(readable(port, 300));
	assert_int_equal(send_id(port, 0x181), -ENXIO);
	can_service(port, now());
	assert_int_equal(port->state, CAN_STATE_DOWN);
	shell("ip link add dev " IF " type vcan && ip link set " IF " up");
	assert_comes_back(port);
	assert_receives(port, 0x601);
	assert_int_equal(send_id(port, 0x181), 0);
	assert_int_equal(port->fd, fd);
}

static void test_sending_detects_that_the_interface_is_gone(void **state)
{
	struct can_port *port = *state;

	shell("ip link del " IF);
	assert_true(send_id(port, 0x181) < 0);
	assert_int_equal(port->state, CAN_STATE_DOWN);
	shell("ip link add dev " IF " type vcan && ip link set " IF " up");
	assert_comes_back(port);
	assert_receives(port, 0x123);
}

/* ---- a slow bus ---- */

/* A shaper of 1000 frames (of 16 bytes) a second with room for 10, like an interface of txqueuelen 10. */
static void test_a_bus_that_is_full_slows_sending_down_and_loses_nothing(void **state)
{
	struct can_port *port = *state, *reader;
	struct can_msg msg;
	char error[300];
	uint32_t received = 0;

	if (system("m=/usr/lib/uml/modules/$(uname -r)/kernel/net/sched/sch_tbf.ko; [ ! -e $m ] || insmod $m; "
		   "tc qdisc replace dev " IF " root tbf rate 128kbit burst 32 limit 160") != 0)
		skip();
	assert_int_equal(can_open(IF, &reader, error, sizeof(error)), 0);
	for (uint32_t id = 0; id < 100; id++)
		assert_int_equal(send_id(port, id), 0);
	assert_true(port->counters.tx < 50);
	for (uint64_t until_us = now() + 2000000; received < 100 && now() < until_us;) {
		can_service(port, now());
		while (receive_within(reader, &msg, 1) == 1)
			assert_int_equal(msg.id, received++);
	}
	assert_int_equal(received, 100);
	assert_int_equal(port->counters.tx, 100);
	assert_true(port->counters.tx_retries > 3);
	assert_int_equal(port->counters.tx_dropped, 0);
	can_close(reader);
}

/* ---- errors of can_open() ---- */

static void assert_open_says(const char *bus, int result, const char *text)
{
	struct can_port *port;
	char error[300];

	assert_int_equal(can_open(bus, &port, error, sizeof(error)), result);
	assert_string_equal(error, text);
}

static void test_an_interface_that_is_not_there_or_down_is_explained(void **state)
{
	(void)state;
	assert_open_says("nocan7", -ENODEV,
		"no CAN interface nocan7: plug its adapter in, or create a virtual one: `ip link add dev nocan7 type "
		"vcan "
		"&& ip link set nocan7 up`, or use the bus `udp`");
	shell("ip link set " IF " down");
	assert_open_says(IF, -ENETDOWN,
		"interface " IF " is down: `ip link set " IF " up` (with a controller: `ip link set " IF
		" up type can bitrate 500000`)");
}

static void test_an_interface_that_is_not_a_can_interface_is_refused(void **state)
{
	(void)state;
	assert_open_says(
		"lo", -EMEDIUMTYPE, "lo is not a CAN interface: `ip -brief link show type can` (or vcan) lists them");
}

#define ON_A_PORT(test) cmocka_unit_test_setup_teardown(test, open_port, close_port)

int main(void)
{
	const struct CMUnitTest tests[] = {
		ON_A_PORT(test_data_extended_and_remote_frames_come_in_as_they_were_sent),
		ON_A_PORT(test_frames_go_out_as_they_should),
		ON_A_PORT(test_own_frames_are_not_received),
		ON_A_PORT(test_the_time_of_a_frame_is_when_it_came_in),
		ON_A_PORT(test_10000_frames_come_in_whole_and_in_order),
		ON_A_PORT(test_10000_frames_go_out_whole_and_in_order),
		ON_A_PORT(test_frames_the_kernel_dropped_for_a_slow_reader_are_counted),
		ON_A_PORT(test_a_filter_passes_data_and_remote_frames_of_its_identifiers_only),
		ON_A_PORT(test_an_empty_filter_passes_all_frames),
		ON_A_PORT(test_more_identifiers_than_the_kernel_takes_pass_all),
		ON_A_PORT(test_error_frames_pass_every_filter),
		ON_A_PORT(test_the_state_follows_the_controller),
		ON_A_PORT(test_bus_off_is_detected_counted_once_and_ended_by_a_restart),
		ON_A_PORT(test_a_bus_error_changes_no_state),
		ON_A_PORT(test_an_overflow_in_the_controller_counts_as_a_lost_frame),
		ON_A_PORT(test_going_down_is_reported_once_and_frames_are_refused_and_counted),
		ON_A_PORT(test_an_interface_that_comes_up_again_works_again),
		ON_A_PORT(test_frames_that_came_in_before_going_down_are_still_delivered),
		ON_A_PORT(test_an_interface_that_is_removed_and_created_again_works_again),
		ON_A_PORT(test_sending_detects_that_the_interface_is_gone),
		ON_A_PORT(test_an_interface_that_is_not_there_or_down_is_explained),
		ON_A_PORT(test_an_interface_that_is_not_a_can_interface_is_refused),
		ON_A_PORT(test_a_bus_that_is_full_slows_sending_down_and_loses_nothing),
	};
	int failed;

	if (system("ip link add dev " IF " type vcan 2>/dev/null && command -v candump >/dev/null") != 0) {
		fprintf(stderr, "skipped: needs root, vcan and can-utils (tests/rig/vcan-run)\n");
		return SKIPPED;
	}
	failed = cmocka_run_group_tests_name("socketcan", tests, NULL, NULL);
	return system("ip link del " IF) != 0 || failed != 0;
}

/* Who may write on the udp bus: a network namespace of its own with two networks, net0 (10.9.0.1, fd09::1) and net1
 * (10.8.0.1), in which the frames of other hosts are made by hand (IPv4: RFC 791, IPv6: RFC 8200, UDP: RFC 768). */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "drivers/can/udp_codec.h"
#include "drivers/ports/can.h"

enum { PORT = 43113 };
static const struct can_msg FRAME = {.id = 0x605, .len = 8, .data = {0x40}};
static bool have_networks;

/* Root in a network namespace; who is not root is root in a user namespace. */
static bool enter_namespace(void)
{
	uid_t uid = geteuid();
	FILE *map;

	if (unshare(uid == 0 ? CLONE_NEWNET : CLONE_NEWUSER | CLONE_NEWNET) != 0)
		return false;
	map = uid == 0 ? NULL : fopen("/proc/self/uid_map", "w");
	return uid == 0 || (map && fprintf(map, "0 %u 1", (unsigned)uid) > 0 && fclose(map) == 0);
}

static int make_networks(void **state)
{
	(void)state;
	have_networks = enter_namespace() &&
			system("{ ip link set lo up && for n in 0 1; do "
			       "ip link add net$n type veth peer name wire$n && ip link set wire$n up && "
			       "ip addr add 10.$((9 - n)).0.1/24 dev net$n && ip link set net$n up; done && "
			       "ip -6 addr add fd09::1/64 dev net0 nodad && ip route add 239.0.0.0/8 dev net0; } "
			       ">/dev/null 2>&1") == 0;
	return 0;
}

static struct can_port *open_bus(const char *bus)
{
	char error[300] = "";
	struct can_port *port;

	if (!have_networks)
		skip();
	if (can_open(bus, &port, error, sizeof(error)) < 0 || error[0])
		fail_msg("%s", error);
	return port;
}

static uint32_t sum16(const uint8_t *bytes, size_t size, uint32_t sum)
{
	for (size_t i = 0; i < size; i++)
		sum += (uint32_t)bytes[i] << (i % 2 ? 0 : 8);
	return sum;
}

static void put_sum(uint8_t *at, uint32_t sum)
{
	while (sum >> 16)
		sum = (sum & 0xFFFF) + (sum >> 16);
	at[0] = (uint8_t)(~sum >> 8);
	at[1] = (uint8_t)~sum;
}

static void put_on_wire(const char *wire, uint16_t type, const uint8_t *packet, size_t size)
{
	int fd = socket(AF_PACKET, SOCK_DGRAM, 0);
	struct sockaddr_ll to = {.sll_family = AF_PACKET,
		.sll_protocol = htons(type),
		.sll_ifindex = (int)if_nametoindex(wire),
		.sll_halen = 6,
		.sll_addr = {1, 0, 0x5E, 0x4A, 0xA3, 2}};

	if (type == ETH_P_IPV6)
		memcpy(to.sll_addr, "\x33\x33\0\0\0\1", 6);
	assert_int_equal(sendto(fd, packet, size, 0, (struct sockaddr *)&to, sizeof(to)), size);
	close(fd);
}

static size_t put_udp(uint8_t *udp)
{
	char payload[CAN_UDP_MAX];
	size_t size = can_udp_encode(&FRAME, payload);
	const uint8_t header[8] = {0x30, 0x39, PORT >> 8, PORT & 0xFF, (uint8_t)((8 + size) >> 8), (uint8_t)(8 + size)};

	memcpy(udp, header, 8);
	memcpy(udp + 8, payload, size);
	return 8 + size;
}

/* The host with this address sends FRAME to 239.74.163.2 on a wire. */
static void host_sends(const char *wire, const char *host)
{
	uint8_t packet[512] = {0x45, 0, 0, 0, 0, 1, 0, 0, 1, 17, 0, 0, 0, 0, 0, 0, 239, 74, 163, 2};
	size_t size = 20 + put_udp(packet + 20);

	packet[2] = (uint8_t)(size >> 8);
	packet[3] = (uint8_t)size;
	assert_int_equal(inet_pton(AF_INET, host, packet + 12), 1);
	put_sum(packet + 10, sum16(packet, 20, 0));
	put_on_wire(wire, ETH_P_IP, packet, size);
}

/* The same to ff15::1. */
static void host_sends_v6(const char *wire, const char *host)
{
	uint8_t packet[512] = {0x60};
	size_t size = put_udp(packet + 40);

	packet[4] = (uint8_t)(size >> 8);
	packet[5] = (uint8_t)size;
	packet[6] = 17;
	packet[7] = 1;
	assert_int_equal(inet_pton(AF_INET6, host, packet + 8), 1);
	assert_int_equal(inet_pton(AF_INET6, "ff15::1", packet + 24), 1);
	put_sum(packet + 46, sum16(packet + 8, 32 + size, 17 + (uint32_t)size));
	put_on_wire(wire, ETH_P_IPV6, packet, 40 + size);
}

/* How many frames arrive. The wire is in the same kernel, so the wait is for the scheduler only. */
static unsigned frames_of(struct can_port *port)
{
	struct pollfd fd = {.fd = port->fd, .events = POLLIN};
	struct can_msg msg;
	unsigned n = 0;

	while (poll(&fd, 1, 50) == 1)
		while (can_receive(port, &msg, 1000000) == 1) {
			assert_int_equal(msg.id, FRAME.id);
			n++;
		}
	return n;
}

static void test_by_default_frames_of_other_hosts_are_not_taken_and_it_is_told_once(void **state)
{
	struct can_port *port = open_bus("udp");

	(void)state;
	assert_non_null(strstr(port->notice, "only frames of this host are taken"));
	port->notice = NULL;
	host_sends("wire0", "10.9.0.7");
	host_sends("wire0", "10.9.0.1"); /* a lie */
	assert_int_equal(frames_of(port), 0);
	assert_non_null(strstr(port->notice, "hosts=any"));
	port->notice = NULL;
	host_sends("wire0", "10.9.0.7");
	assert_int_equal(frames_of(port), 0);
	assert_null(port->notice);
	can_close(port);
}

static void test_frames_of_this_host_are_taken_whatever_hosts_says(void **state)
{
	static const char *const buses[] = {"udp", "udp,hosts=any", "udp,hosts=10.1.2.3",
		"udp:239.74.163.2,interface=net0", "udp,interface=lo", "udp:[ff15::1],interface=net0",
		"udp:[ff15::1],interface=net0,hosts=fd00::1"};

	(void)state;
	for (size_t i = 0; i < sizeof(buses) / sizeof(buses[0]); i++) {
		struct can_port *port = open_bus(buses[i]), *other = open_bus(buses[i]);

		assert_int_equal(can_send(other, &FRAME, 1000000), 0);
		assert_int_equal(frames_of(port), 1);
		assert_int_equal(frames_of(other), 0);
		can_close(port);
		can_close(other);
	}
}

static void test_with_hosts_any_frames_of_every_host_are_taken(void **state)
{
	struct can_port *port = open_bus("udp,hosts=any");

	(void)state;
	assert_non_null(strstr(port->notice, "every host"));
	host_sends("wire0", "10.9.0.7");
	host_sends("wire0", "192.168.200.200");
	assert_int_equal(frames_of(port), 2);
	can_close(port);
}

static void test_with_a_network_frames_of_its_hosts_are_taken(void **state)
{
	static const struct {
		const char *bus, *host, *stranger;
	} cases[] = {{"udp,hosts=10.9.0.0/24", "10.9.0.255", "10.9.1.0"},
		{"udp,hosts=10.9.0.7", "10.9.0.7", "10.9.0.8"}, {"udp,hosts=10.9.0.7/20", "10.9.15.1", "10.9.16.1"},
		{"udp,hosts=0.0.0.0/0", "1.2.3.4", NULL}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct can_port *port = open_bus(cases[i].bus);

		assert_non_null(strstr(port->notice, "the hosts of the option"));
		port->notice = NULL;
		host_sends("wire0", cases[i].host);
		assert_int_equal(frames_of(port), 1);
		if (cases[i].stranger)
			host_sends("wire0", cases[i].stranger);
		assert_int_equal(frames_of(port), 0);
		can_close(port);
	}
}

static void test_networks_of_ipv6_work_alike(void **state)
{
	static const struct {
		const char *hosts, *host, *stranger;
	} cases[] = {{"fd09::/64", "fd09::7", "fd09:0:0:1::7"}, {"fd09::7", "fd09::7", "fd09::8"},
		{"fd09::1:0:0:0/80", "fd09::1:9:0:7", "fd09::2:9:0:7"}, {"fd08::/15", "fd09::7", "fd0a::7"}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct can_port *port;
		char bus[100];

		snprintf(bus, sizeof(bus), "udp:[ff15::1],interface=net0,hosts=%s", cases[i].hosts);
		port = open_bus(bus);
		host_sends_v6("wire0", cases[i].host);
		assert_int_equal(frames_of(port), 1);
		host_sends_v6("wire0", cases[i].stranger);
		assert_int_equal(frames_of(port), 0);
		can_close(port);
	}
}

static void test_without_its_network_the_bus_is_down_and_says_why_until_it_is_back(void **state)
{
	struct can_port *port = open_bus("udp");

	(void)state;
	assert_int_equal(can_send(port, &FRAME, 1000000), 0);
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(system("ip link set net0 down"), 0);
	assert_true(can_send(port, &FRAME, 2000000) < 0);
	assert_int_equal(port->state, CAN_STATE_DOWN);
	assert_non_null(port->down_why);
	assert_non_null(strstr(port->down_why, "the network of the group is down"));
	assert_int_equal(system("ip link set net0 up && ip route add 239.0.0.0/8 dev net0 && "
				"ip -6 addr add fd09::1/64 dev net0 nodad"),
		0);
	assert_int_equal(can_send(port, &FRAME, 3000000), 0);
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	can_close(port);
}

/* Another process on this host joins the group on the second network. */
static void test_a_network_that_only_another_process_has_joined_is_not_heard_and_doubles_nothing(void **state)
{
	struct can_port *port = open_bus("udp,hosts=any"), *other = open_bus("udp,hosts=any,interface=net1");

	(void)state;
	host_sends("wire1", "10.9.0.7");
	host_sends("wire0", "10.9.0.7"); /* the same datagram by another route */
	assert_int_equal(frames_of(port), 1);
	assert_int_equal(frames_of(other), 1);
	can_close(port);
	can_close(other);
}

static void test_options_that_do_not_exist_are_refused_with_what_to_use(void **state)
{
	static const char *const bad[] = {"udp,hosts=", "udp,hosts=10.0.0.0/33", "udp,hosts=fd09::/64",
		"udp,hosts=nobody", "udp:[ff15::1],hosts=10.0.0.0/8", "udp,host=any", "udp:239.1.1.1,hosts=10.0.0.0/x"};
	struct can_port *port;
	char error[300];

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(can_open(bad[i], &port, error, sizeof(error)), -22);
		assert_non_null(strstr(error, "192.168.1.0/24"));
	}
	assert_int_equal(can_open("udp,interface=nosuch0", &port, error, sizeof(error)), -19);
	assert_string_equal(error, "no network interface 'nosuch0': `ip -brief link` lists them");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_by_default_frames_of_other_hosts_are_not_taken_and_it_is_told_once),
		cmocka_unit_test(test_frames_of_this_host_are_taken_whatever_hosts_says),
		cmocka_unit_test(test_with_hosts_any_frames_of_every_host_are_taken),
		cmocka_unit_test(test_with_a_network_frames_of_its_hosts_are_taken),
		cmocka_unit_test(test_networks_of_ipv6_work_alike),
		cmocka_unit_test(test_a_network_that_only_another_process_has_joined_is_not_heard_and_doubles_nothing),
		cmocka_unit_test(test_without_its_network_the_bus_is_down_and_says_why_until_it_is_back),
		cmocka_unit_test(test_options_that_do_not_exist_are_refused_with_what_to_use),
	};

	return cmocka_run_group_tests(tests, make_networks, NULL);
}

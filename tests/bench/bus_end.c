#include "tests/bench/bus_end.h"

#include <arpa/inet.h>
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <linux/filter.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "drivers/can/udp_codec.h"

void fail(const char *what)
{
	fprintf(stderr, "%s: %s: %s\n", program_invocation_short_name, what, strerror(errno));
	exit(EXIT_FAILURE);
}

double now_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec * 1e6 + (double)t.tv_nsec / 1e3;
}

void use_processor(unsigned number)
{
	cpu_set_t set;

	CPU_ZERO(&set);
	CPU_SET(number, &set);
	sched_setaffinity(0, sizeof(set), &set);
}

/* ---- the bus ----------------------------------------------------------------------------------------------------- */

/* The ID is an UNSIGNED8 or UNSIGNED16 of msgpack, at this place of each datagram (8 bytes of UDP before it). */
static void receive_only(int fd, uint32_t id, uint32_t mask)
{
	enum { ID_AT = 8 + 1 + 10 + 9 + 15, UNSIGNED8 = 0xCC, UNSIGNED16 = 0xCD };
	bool small = id < 0x100;
	struct sock_filter code[] = {
		BPF_STMT(BPF_LD | BPF_B | BPF_ABS, ID_AT),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, small ? UNSIGNED8 : UNSIGNED16, 0, 4),
		BPF_STMT(BPF_LD | (small ? BPF_B : BPF_H) | BPF_ABS, ID_AT + 1),
		BPF_STMT(BPF_ALU | BPF_AND | BPF_K, mask),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, id, 0, 1),
		BPF_STMT(BPF_RET | BPF_K, 0xFFFF),
		BPF_STMT(BPF_RET | BPF_K, 0),
	};
	struct sock_fprog program = {.len = sizeof(code) / sizeof(*code), .filter = code};

	if (setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program)) < 0)
		fail("filter");
}

static void join(const struct end *end, const struct ip_mreqn *member)
{
	int on = 1;

	setsockopt(end->fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
	if (bind(end->fd, (const struct sockaddr *)&end->group, sizeof(end->group)) < 0 ||
		setsockopt(end->fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, member, sizeof(*member)) < 0)
		fail("udp bus");
}

struct end open_end(const char *group, uint16_t port, uint32_t id, uint32_t mask)
{
	struct end end = {.fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0),
		.group = {.sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = inet_addr(group)}};
	struct ip_mreqn member = {.imr_multiaddr = end.group.sin_addr, .imr_ifindex = (int)if_nametoindex("lo")};

	if (end.fd < 0 || setsockopt(end.fd, IPPROTO_IP, IP_MULTICAST_IF, &member, sizeof(member)) < 0)
		fail("socket");
	if (mask == END_SENDS)
		return end;
	if (mask != END_RECEIVES_ALL)
		receive_only(end.fd, id, mask);
	join(&end, &member);
	return end;
}

struct end open_can_end(const char *interface, uint32_t id, uint32_t mask)
{
	struct end end = {.fd = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW), .can = true};
	struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(interface)};
	struct can_filter filter = {.can_id = id, .can_mask = mask == END_RECEIVES_ALL ? 0 : mask | CAN_EFF_FLAG};

	if (end.fd < 0 || address.can_ifindex == 0 ||
		bind(end.fd, (const struct sockaddr *)&address, sizeof(address)) < 0 ||
		setsockopt(end.fd, SOL_CAN_RAW, CAN_RAW_FILTER, &filter, mask == END_SENDS ? 0 : sizeof(filter)) < 0)
		fail(interface);
	return end;
}

void put_bytes(const struct end *end, const void *bytes, size_t size)
{
	while (sendto(end->fd, bytes, size, 0, (const struct sockaddr *)&end->group, sizeof(end->group)) < 0)
		if (errno != ENOBUFS && errno != EAGAIN)
			fail("send");
}

static void put_can(const struct end *end, uint32_t id, const void *data, size_t len)
{
	struct can_frame frame = {.can_id = id, .len = (uint8_t)len};

	memcpy(frame.data, data, len);
	while (write(end->fd, &frame, sizeof(frame)) < 0)
		if (errno != ENOBUFS && errno != EAGAIN)
			fail("send");
}

void put(const struct end *end, uint32_t id, const void *data, size_t len)
{
	if (end->can) {
		put_can(end, id, data, len);
		return;
	}

	struct can_msg msg = {.id = id, .len = (uint8_t)len};
	char bytes[CAN_UDP_MAX];

	memcpy(msg.data, data, len);
	put_bytes(end, bytes, can_udp_encode(&msg, bytes));
}

static int decode_can(const char *bytes, size_t size, struct can_msg *msg)
{
	struct can_frame frame;

	if (size != sizeof(frame))
		return -1;
	memcpy(&frame, bytes, sizeof(frame));
	*msg = (struct can_msg){.id = frame.can_id, .len = frame.len};
	memcpy(msg->data, frame.data, frame.len);
	return 0;
}

bool get(const struct end *end, struct can_msg *msg, int timeout_ms)
{
	struct pollfd p = {.fd = end->fd, .events = POLLIN};
	char bytes[CAN_UDP_MAX];
	ssize_t size;

	if (poll(&p, 1, timeout_ms) != 1)
		return false;
	size = recv(end->fd, bytes, sizeof(bytes), 0);
	if (size < 0 ||
		(end->can ? decode_can(bytes, (size_t)size, msg) : can_udp_decode(bytes, (size_t)size, msg)) < 0)
		fail("receive");
	return true;
}

unsigned drain(const struct end *end)
{
	char bytes[CAN_UDP_MAX];
	unsigned n = 0;

	while (recv(end->fd, bytes, sizeof(bytes), MSG_DONTWAIT) > 0)
		n++;
	return n;
}

/* ---- figures ----------------------------------------------------------------------------------------------------- */

static int ascending(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

double quantile(double *values, size_t count, double part)
{
	qsort(values, count, sizeof(*values), ascending);
	return count > 0 ? values[(size_t)(part * (double)(count - 1))] : 0;
}

/* The SocketCAN bus on a kernel that is simulated at its system calls, which are defined here: one CAN interface, its
 * raw socket and its netlink messages. tests/interop/test_socketcan.c runs the same driver on a real vcan. Oracles:
 * struct can_frame of linux/can.h and the messages of linux/rtnetlink.h, laid out by hand. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <linux/capability.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "drivers/can/can_link.h"
#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"

enum { INDEX = 7, CAN_TYPE = 280, ETHERNET_TYPE = 1, FRAMES = 40, ORDERS = 8, CAN_RAW_LEVEL = 101 };
enum { NETDEV_UP = 1, REALTIME_AHEAD_S = 1000 };
enum { STAMP_OPTION = sizeof(time_t) > sizeof(long) ? 64 : 35 }; /* SO_TIMESTAMPNS_NEW or _OLD */

struct frame {
	uint8_t bytes[80];
	size_t size;
	uint64_t t_us; /* CLOCK_MONOTONIC */
};

static struct kernel {
	/* the interface */
	bool exists, up;
	int index, type;
	bool privileged;

	/* the raw socket */
	int fd; /* -1: none is bound */
	struct frame frames[FRAMES];
	size_t frame_count, frame_next;
	int receive_error, send_error;
	uint8_t sent[FRAMES][16];
	size_t sent_count;
	int bound_index;
	uint32_t filters[1024], error_mask;
	size_t filter_count;
	uint32_t overflows;
	bool endless; /* the frames are received again and again */
	unsigned fetches;

	int calls, failing; /* the call of the set-up with this number fails; 0: none */

	/* netlink */
	uint8_t orders[ORDERS][256]; /* what changes something */
	size_t order_count;
	/* of the first order, the second, and the third, which brings the interface up */
	int order_result, set_result, up_result;
	int socket_error, ask_error, answer_error;
	uint8_t link[1024];
	size_t link_size;
	bool asked;
	size_t odd_answer_size; /* an order is answered by so much of `link` */
	bool empty_answer;	/* .. or by nothing */

	/* options of the raw socket */
	int forced_bytes, bytes; /* SO_RCVBUFFORCE, SO_RCVBUF */
	int refused_option;	 /* of SOL_SOCKET */
	bool stamps, drops_counted;

	uint64_t now_us;
	int ahead_s; /* CLOCK_REALTIME */
	unsigned clock_reads;
	int lost_after; /* reading the clock so many times the process loses the processor for 5 ms; 0: it does not */
} k;

/* ---- system calls ------------------------------------------------------------------------------------------------ */

static int failed(int error)
{
	errno = error;
	return -1;
}

static bool call_fails(void)
{
	return k.failing && ++k.calls == k.failing;
}

int socket(int domain, int type, int protocol)
{
	if (call_fails())
		return failed(EIO);
	assert_int_equal(type & ~04000, 3 | 02000000);	      /* SOCK_RAW, SOCK_CLOEXEC; also SOCK_NONBLOCK */
	assert_int_equal(protocol, domain == PF_CAN ? 1 : 0); /* CAN_RAW, NETLINK_ROUTE */
	if (k.socket_error)
		return failed(k.socket_error);
	return eventfd(0, 0);
}

int bind(int fd, __CONST_SOCKADDR_ARG address, socklen_t size)
{
	const uint8_t *bytes = (const uint8_t *)address.__sockaddr__; /* struct sockaddr_can */
	uint16_t family;

	if (call_fails())
		return failed(EIO);
	k.fd = fd;
	assert_true(size >= 8);
	memcpy(&family, bytes, 2);
	memcpy(&k.bound_index, bytes + 4, 4);
	assert_int_equal(family, AF_CAN);
	return 0;
}

int setsockopt(int fd, int level, int option, const void *value, socklen_t size)
{
	(void)fd;
	if (call_fails())
		return failed(EIO);
	if (level == SOL_SOCKET && option == k.refused_option)
		return failed(EPERM);
	if (level == SOL_SOCKET && option == 33) /* SO_RCVBUFFORCE */
		memcpy(&k.forced_bytes, value, 4);
	if (level == SOL_SOCKET && option == 8) /* SO_RCVBUF */
		memcpy(&k.bytes, value, 4);
	if (level == SOL_SOCKET && option == STAMP_OPTION)
		k.stamps = *(const int *)value == 1;
	if (level == SOL_SOCKET && option == 40) /* SO_RXQ_OVFL */
		k.drops_counted = *(const int *)value == 1;
	if (level == CAN_RAW_LEVEL && option == 1) { /* CAN_RAW_FILTER */
		k.filter_count = size / 8;
		memcpy(k.filters, value, size);
	}
	if (level == CAN_RAW_LEVEL && option == 2) /* CAN_RAW_ERR_FILTER */
		memcpy(&k.error_mask, value, 4);
	return 0;
}

int getsockopt(int fd, int level, int option, void *restrict value, socklen_t *restrict size)
{
	(void)fd, (void)level, (void)size;
	if (option == SO_ERROR) { /* reading clears it */
		memcpy(value, &k.send_error, sizeof(int));
		k.send_error = 0;
	}
	return 0;
}

int ioctl(int fd, unsigned long request, ...)
{
	struct ifreq *r;
	va_list args;

	(void)fd;
	va_start(args, request);
	r = va_arg(args, struct ifreq *);
	va_end(args);
	if (call_fails())
		return failed(EIO);
	if (!k.exists || strcmp(r->ifr_name, "can7") != 0)
		return failed(ENODEV);
	if (request == SIOCGIFHWADDR)
		r->ifr_hwaddr.sa_family = (sa_family_t)k.type;
	else if (request == SIOCGIFFLAGS)
		r->ifr_flags = k.up ? NETDEV_UP : 0;
	else if (request == SIOCGIFINDEX)
		r->ifr_ifindex = k.index;
	return 0;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	ssize_t (*real)(int, const void *, size_t);

	if (fd != k.fd) {
		*(void **)&real = dlsym(RTLD_NEXT, "write");
		return real(fd, bytes, size);
	}
	if (k.send_error)
		return failed(k.send_error);
	assert_int_equal(size, 16);
	assert_true(k.sent_count < FRAMES);
	memcpy(k.sent[k.sent_count++], bytes, 16);
	return 16;
}

static void put_control(struct msghdr *header, int type, const void *value, size_t size)
{
	struct cmsghdr *c = (struct cmsghdr *)((char *)header->msg_control + header->msg_controllen);

	c->cmsg_level = SOL_SOCKET;
	c->cmsg_type = type;
	c->cmsg_len = CMSG_LEN(size);
	memcpy(CMSG_DATA(c), value, size);
	header->msg_controllen += CMSG_SPACE(size);
}

int recvmmsg(int fd, struct mmsghdr *headers, unsigned n, int flags, struct timespec *timeout)
{
	unsigned count = 0;

	(void)timeout;
	k.fetches++;
	if (k.endless)
		k.frame_next = 0;
	assert_int_equal(fd, k.fd);
	assert_true(flags & MSG_DONTWAIT);
	for (; count < n && k.frame_next < k.frame_count; count++) {
		const struct frame *f = &k.frames[k.frame_next++];
		struct msghdr *h = &headers[count].msg_hdr;
		const struct timespec stamp = {
			(time_t)(f->t_us / 1000000) + k.ahead_s, (long)(f->t_us % 1000000) * 1000};

		assert_int_equal(h->msg_iovlen, 1);
		assert_true(h->msg_iov->iov_len >= f->size);
		assert_int_equal(h->msg_controllen, CMSG_SPACE(16) + CMSG_SPACE(4)); /* a timespec and a counter */
		memcpy(h->msg_iov->iov_base, f->bytes, f->size);
		headers[count].msg_len = (unsigned)f->size;
		h->msg_controllen = 0;
		put_control(h, SO_TIMESTAMPNS, &stamp, sizeof(stamp));
		if (k.overflows)
			put_control(h, SO_RXQ_OVFL, &k.overflows, sizeof(k.overflows));
	}
	if (count > 0)
		return (int)count;
	if (k.receive_error) {
		int error = k.receive_error;

		k.receive_error = 0; /* reported once */
		return failed(error);
	}
	return failed(EAGAIN);
}

int clock_gettime(clockid_t clock, struct timespec *t)
{
	k.clock_reads++;
	*t = (struct timespec){(time_t)(k.now_us / 1000000) + (clock == CLOCK_REALTIME ? k.ahead_s : 0),
		(long)(k.now_us % 1000000) * 1000};
	if (k.lost_after > 0 && --k.lost_after == 0)
		k.now_us += 5000;
	return 0;
}

long syscall(long number, ...)
{
	struct __user_cap_data_struct *data;
	va_list args;

	assert_int_equal(number, SYS_capget);
	va_start(args, number);
	(void)va_arg(args, void *);
	data = va_arg(args, struct __user_cap_data_struct *);
	va_end(args);
	data[0].effective = k.privileged ? 1u << CAP_NET_ADMIN : 0;
	return 0;
}

ssize_t send(int fd, const void *bytes, size_t size, int flags)
{
	uint16_t type;

	(void)fd;
	assert_int_equal(flags, 0);
	if (k.ask_error)
		return failed(k.ask_error);
	memcpy(&type, (const uint8_t *)bytes + 4, 2);
	k.asked = type == 18; /* RTM_GETLINK */
	if (!k.asked) {
		assert_true(k.order_count < ORDERS && size <= sizeof(k.orders[0]));
		memcpy(k.orders[k.order_count++], bytes, size);
	}
	return (ssize_t)size;
}

static size_t put_error(uint8_t *out, int error)
{
	const struct {
		uint32_t length;
		uint16_t type, flags;
		uint32_t sequence, port;
		int32_t error;
		uint32_t of[4];
	} message = {36, 2, 0, 0, 0, error, {0}}; /* NLMSG_ERROR */

	memcpy(out, &message, 36);
	return 36;
}

ssize_t recv(int fd, void *bytes, size_t size, int flags)
{
	(void)fd, (void)size;
	assert_int_equal(flags, MSG_DONTWAIT);
	if (k.answer_error && (!k.asked || k.order_count == 0))
		return failed(k.answer_error);
	if (!k.asked && k.empty_answer)
		return 0;
	if (!k.asked && k.odd_answer_size) {
		memcpy(bytes, k.link, k.odd_answer_size);
		return (ssize_t)k.odd_answer_size;
	}
	if (!k.asked)
		return (ssize_t)put_error(bytes, k.order_count == 3   ? k.up_result
						 : k.order_count == 2 ? k.set_result
								      : k.order_result);
	if (!k.exists)
		return (ssize_t)put_error(bytes, -ENODEV);
	memcpy(bytes, k.link, k.link_size);
	return (ssize_t)k.link_size;
}

/* ---- RTM_NEWLINK ------------------------------------------------------------------------------------------------- */

/* Type, then the payload, padded to four bytes. */
static void put_attribute(uint16_t type, const void *payload, size_t size)
{
	uint16_t head[2] = {(uint16_t)(4 + size), type};

	memcpy(k.link + k.link_size, head, 4);
	memcpy(k.link + k.link_size + 4, payload, size);
	k.link_size += 4 + (size + 3) / 4 * 4;
	memcpy(k.link, &k.link_size, 4); /* nlmsg_len */
}

/* What follows is inside; the start of it, for end_nested(). */
static size_t begin_nested(uint16_t type)
{
	size_t start = k.link_size;

	put_attribute(type, "", 0);
	return start;
}

static void end_nested(size_t start)
{
	uint16_t length = (uint16_t)(k.link_size - start);

	memcpy(k.link + start, &length, 2);
}

/* rx_packets, tx_packets, rx_bytes, tx_bytes, ... */
static void begin_link(void)
{
	static const uint64_t stats[24] = {100, 20, 800, 160, 5, 6, 7, 8};
	static const uint16_t head[] = {0, 0, 16 /* RTM_NEWLINK */};

	memset(k.link, 0, sizeof(k.link));
	memcpy(k.link, head, sizeof(head));
	k.link_size = 32;
	put_attribute(3, "can7", 5); /* IFLA_IFNAME */
	put_attribute(23, stats, sizeof(stats));
}

/* A controller at 8 MHz with an SJA1000's limits. */
static void put_controller(uint32_t state, uint32_t restart_ms, const uint32_t *rates, size_t rate_count)
{
	static const uint32_t timing[8] = {250000, 875, 250, 6, 7, 2, 1, 2}, clock_hz = 8000000;
	static const struct {
		char name[16];
		uint32_t limits[8];
	} limits = {"sja1000", {1, 16, 2, 8, 4, 1, 64, 1}};
	static const uint16_t errors[2] = {300, 12};
	size_t info, data;

	begin_link();
	info = begin_nested(18);    /* IFLA_LINKINFO */
	put_attribute(1, "can", 3); /* no NUL, so that a byte of padding follows */
	data = begin_nested(2);
	put_attribute(1, timing, sizeof(timing));
	put_attribute(2, &limits, sizeof(limits));
	put_attribute(3, &clock_hz, 4);
	put_attribute(4, &state, 4);
	put_attribute(6, &restart_ms, 4);
	put_attribute(8, errors, 4);
	if (rates)
		put_attribute(13, rates, 4 * rate_count);
	end_nested(data);
	end_nested(info);
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

static struct can_port *port;

static void open_bus(void)
{
	char error[300] = "";

	if (can_open("can7", &port, error, sizeof(error)) < 0 || error[0])
		fail_msg("%s", error);
}

static int set_up(void **state)
{
	(void)state;
	k = (struct kernel){.exists = true, .up = true, .index = INDEX, .type = CAN_TYPE, .privileged = true, .fd = -1};
	k.now_us = 5000000000;
	k.ahead_s = REALTIME_AHEAD_S;
	put_controller(0, 0, NULL, 0);
	port = NULL;
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	if (port)
		can_close(port);
	return 0;
}

static void put_frame(uint32_t can_id, uint8_t length, const char *data)
{
	struct frame *f = &k.frames[k.frame_count++];

	*f = (struct frame){.size = 16, .t_us = k.now_us};
	memcpy(f->bytes, &can_id, 4);
	f->bytes[4] = length;
	memcpy(f->bytes + 8, data, 8);
}

static int receive(struct can_msg *msg)
{
	memset(msg, 0xEE, sizeof(*msg));
	return can_receive(port, msg, k.now_us);
}

static void assert_receives(uint32_t id, bool extended, bool remote, uint8_t length)
{
	struct can_msg msg;

	assert_int_equal(receive(&msg), 1);
	assert_int_equal(msg.id, id);
	assert_int_equal(msg.extended, extended);
	assert_int_equal(msg.remote, remote);
	assert_int_equal(msg.len, length);
}

static void assert_receives_nothing(void)
{
	struct can_msg msg;

	assert_int_equal(receive(&msg), 0);
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static void test_frames_are_sent_as_the_kernel_has_them(void **state)
{
	const struct can_msg msgs[] = {{.id = 0x181, .len = 3, .data = {1, 2, 3}},
		{.id = 0x12345678, .extended = true, .len = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}},
		{.id = 0x701, .remote = true, .len = 1, .data = {9}}};

	(void)state;
	open_bus();
	for (int i = 0; i < 3; i++)
		assert_int_equal(can_send(port, &msgs[i], k.now_us), 0);
	assert_memory_equal(k.sent[0], "\x81\x01\0\0\3\0\0\0\1\2\3\0\0\0\0\0", 16);
	assert_memory_equal(k.sent[1], "\x78\x56\x34\x92\x8\0\0\0\1\2\3\4\5\6\7\x8", 16);
	assert_memory_equal(k.sent[2], "\1\7\0\x40\1\0\0\0\0\0\0\0\0\0\0\0", 16);
	assert_int_equal(port->counters.tx, 3);
}

static void test_frames_are_received_as_the_kernel_has_them(void **state)
{
	struct can_msg msg;

	(void)state;
	open_bus();
	put_frame(0x605, 8, "\1\2\3\4\5\6\7\x8");
	put_frame(0x92345678, 2, "\1\2\0\0\0\0\0");
	put_frame(0x40000701, 4, "\0\0\0\0\0\0\0");
	assert_int_equal(receive(&msg), 1);
	assert_int_equal(msg.id, 0x605);
	assert_memory_equal(msg.data, "\1\2\3\4\5\6\7\x8", 8);
	assert_receives(0x12345678, true, false, 2);
	assert_receives(0x701, false, true, 4);
	assert_receives_nothing();
	assert_int_equal(port->counters.rx, 3);
}

static void test_more_frames_than_a_batch_arrive_in_order(void **state)
{
	(void)state;
	open_bus();
	for (uint32_t id = 0; id < 33; id++) /* twice 16 and one */
		put_frame(id, 0, "\0\0\0\0\0\0\0");
	for (uint32_t id = 0; id < 33; id++)
		assert_receives(id, false, false, 0);
	assert_receives_nothing();
	put_frame(99, 0, "\0\0\0\0\0\0\0");
	assert_receives(99, false, false, 0);
}

static void test_what_is_not_a_classical_frame_is_counted_and_not_received(void **state)
{
	(void)state;
	open_bus();
	put_frame(0x100, 9, "\0\0\0\0\0\0\0"); /* no such length */
	put_frame(0x101, 8, "\0\0\0\0\0\0\0");
	k.frames[1].size = 72; /* CAN FD */
	put_frame(0x102, 8, "\0\0\0\0\0\0\0");
	assert_receives(0x102, false, false, 8);
	assert_int_equal(port->counters.rx_dropped, 2);
}

static void test_the_time_of_a_frame_is_the_kernel_s_on_the_monotonic_clock(void **state)
{
	struct can_msg msg;

	(void)state;
	open_bus();
	put_frame(0x605, 0, "\0\0\0\0\0\0\0");
	k.frames[0].t_us = k.now_us - 1234;
	assert_int_equal(receive(&msg), 1);
	assert_int_equal(msg.t_us, k.now_us - 1234);
}

static void test_a_process_that_loses_the_processor_between_two_clocks_has_the_right_time(void **state)
{
	for (int reads = 1; reads <= 8; reads++) {
		struct can_msg msg;

		open_bus();
		k.lost_after = reads;
		put_frame(0x605, 0, "\0\0\0\0\0\0\0");
		const uint64_t sent_us = k.frames[0].t_us = k.now_us - 1234;
		assert_int_equal(receive(&msg), 1);
		assert_int_equal(msg.t_us, sent_us);
		assert_int_equal(k.lost_after, 0);
		tear_down(state);
		set_up(state);
	}
}

/* CLOCK_REALTIME was set meanwhile: the stamp cannot be right. */
static void test_a_time_in_the_future_or_ten_seconds_old_is_replaced_by_now(void **state)
{
	struct can_msg msg;
	const uint64_t now_us = k.now_us;

	(void)state;
	open_bus();
	put_frame(1, 0, "\0\0\0\0\0\0\0");
	put_frame(2, 0, "\0\0\0\0\0\0\0");
	put_frame(3, 0, "\0\0\0\0\0\0\0");
	k.frames[0].t_us = now_us + 1000001;
	k.frames[1].t_us = now_us - 10000001;
	k.frames[2].t_us = now_us - 9999999;
	receive(&msg);
	assert_int_equal(msg.t_us, now_us);
	receive(&msg);
	assert_int_equal(msg.t_us, now_us);
	receive(&msg);
	assert_int_equal(msg.t_us, now_us - 9999999);
}

static void test_frames_the_kernel_dropped_are_counted_once(void **state)
{
	(void)state;
	open_bus();
	k.overflows = 5;
	put_frame(1, 0, "\0\0\0\0\0\0\0");
	put_frame(2, 0, "\0\0\0\0\0\0\0");
	assert_receives(1, false, false, 0);
	assert_receives(2, false, false, 0);
	assert_receives_nothing();
	assert_int_equal(port->counters.rx_dropped, 5);
	k.overflows = 7;
	put_frame(3, 0, "\0\0\0\0\0\0\0");
	assert_receives(3, false, false, 0);
	assert_int_equal(port->counters.rx_dropped, 7);
}

static void test_a_call_reads_a_bounded_number_of_frames_that_are_not_returned(void **state)
{
	struct can_msg msg;

	(void)state;
	open_bus();
	for (int i = 0; i < 16; i++)
		put_frame(i % 2 ? 0x20000004 : 0x123, i % 2 ? 8 : 9, "\0\x20\0\0\0\0\x82\7");
	k.endless = true;
	k.fetches = 0;
	assert_int_equal(can_receive(port, &msg, k.now_us), 0);
	assert_in_range(k.fetches, 1, 10);
	k.endless = false;
	k.frame_count = k.frame_next = 0;
	put_frame(0x181, 1, "\7\0\0\0\0\0\0");
	assert_int_equal(can_receive(port, &msg, k.now_us), 1);
	assert_int_equal(msg.id, 0x181);
}

static void test_an_error_frame_changes_the_state_and_is_not_received(void **state)
{
	(void)state;
	open_bus();
	put_frame(0x20000004, 8, "\0\x20\0\0\0\0\x82\7"); /* CAN_ERR_CRTL, TX_PASSIVE, 130, 7 */
	assert_receives_nothing();
	assert_int_equal(port->state, CAN_STATE_PASSIVE);
	assert_int_equal(port->tx_errors, 130);
	assert_int_equal(port->rx_errors, 7);
	assert_int_equal(port->counters.rx, 0);
}

static void test_a_full_interface_keeps_the_frame_waiting(void **state)
{
	const struct can_msg msg = {.id = 0x181};

	(void)state;
	open_bus();
	k.send_error = ENOBUFS;
	assert_int_equal(can_send(port, &msg, k.now_us), 0);
	assert_int_equal(port->queue_count, 1);
	k.send_error = 0;
	can_service(port, k.now_us += 1000);
	assert_int_equal(k.sent_count, 1);
}

/* ---- filters ----------------------------------------------------------------------------------------------------- */

static void test_without_a_filter_all_frames_and_all_errors_pass(void **state)
{
	(void)state;
	open_bus();
	assert_int_equal(k.bound_index, INDEX);
	assert_int_equal(k.filter_count, 1);
	assert_int_equal(k.filters[0] | k.filters[1], 0);
	assert_int_equal(k.error_mask, 0x1FFFFFFF);
}

/* A frame passes when its identifier and the mask are those of the filter: 11 bits, and not extended; RTR is not in
 * it. */
static void test_a_filter_is_one_of_the_kernel_s_for_each_identifier(void **state)
{
	uint32_t many[513] = {0};

	(void)state;
	open_bus();
	assert_int_equal(can_filter(port, (const uint32_t[]){0x000, 0x605}, 2), 0);
	assert_int_equal(k.filter_count, 2);
	assert_memory_equal(k.filters, ((const uint32_t[]){0x000, 0x800007FF, 0x605, 0x800007FF}), 16);
	assert_int_equal(can_filter(port, many, 513), 0); /* more than the kernel has */
	assert_int_equal(k.filter_count, 1);
	assert_int_equal(k.filters[1], 0);
	assert_int_equal(can_filter(port, many, 512), 0);
	assert_int_equal(k.filter_count, 512);
}

/* ---- the interface goes and comes -------------------------------------------------------------------------------- */

static void test_down_and_up_again_the_same_socket_goes_on(void **state)
{
	const struct can_msg msg = {.id = 0x181};
	struct can_msg in;
	int fd;

	(void)state;
	open_bus();
	fd = k.fd;
	k.up = false;
	k.receive_error = k.send_error = ENETDOWN;
	assert_int_equal(receive(&in), -ENETDOWN);
	assert_int_equal(port->state, CAN_STATE_DOWN);
	assert_int_equal(can_send(port, &msg, k.now_us), -ENETDOWN);
	assert_int_equal(port->counters.tx_dropped, 1);
	assert_int_equal(can_service(port, k.now_us), k.now_us + 200000);
	k.up = true;
	k.send_error = 0;
	k.now_us += 199999;
	can_service(port, k.now_us);
	assert_int_equal(port->state, CAN_STATE_DOWN); /* looks five times a second */
	k.now_us += 1;
	assert_true(can_service(port, k.now_us) == UINT64_MAX);
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(k.fd, fd);
	assert_int_equal(can_send(port, &msg, k.now_us), 0);
}

static void test_removed_and_made_again_it_is_bound_to_the_new_interface_with_its_filters(void **state)
{
	struct can_msg in;
	int fd;

	(void)state;
	open_bus();
	can_filter(port, (const uint32_t[]){0x605}, 1);
	fd = port->fd;
	k.exists = false;
	k.receive_error = ENODEV;
	assert_int_equal(receive(&in), -ENODEV);
	assert_int_equal(port->state, CAN_STATE_DOWN);
	can_service(port, k.now_us);
	assert_int_equal(port->state, CAN_STATE_DOWN);
	k.exists = true;
	k.index = INDEX + 1;
	k.filter_count = 0;
	can_service(port, k.now_us += 200000);
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(k.bound_index, INDEX + 1);
	assert_int_equal(k.filter_count, 1);
	assert_int_equal(k.filters[0], 0x605);
	assert_int_equal(port->fd, fd);
}

static void assert_refused(int result, const char *words)
{
	char error[300] = "";

	assert_int_equal(can_open("can7", &port, error, sizeof(error)), result);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
	assert_null(port);
}

static void test_an_interface_that_cannot_be_used_is_refused_with_what_to_do(void **state)
{
	(void)state;
	k.up = false;
	assert_refused(-ENETDOWN, "ip link set can7 up");
	k.type = ETHERNET_TYPE;
	assert_refused(-EMEDIUMTYPE, "not a CAN interface");
	k.exists = false;
	assert_refused(-ENODEV, "ip link add dev can7 type vcan");
}

/* ---- the controller ---------------------------------------------------------------------------------------------- */

static void test_a_controller_s_properties_are_read(void **state)
{
	static const uint32_t rates[] = {125000, 250000};
	struct can_link link;

	(void)state;
	put_controller(2, 100, rates, 2);
	assert_int_equal(can_link_look(INDEX, &link), 0);
	assert_true(link.controller);
	assert_int_equal(link.state, 2);
	assert_int_equal(link.bit_s, 250000);
	assert_int_equal(link.tx_errors, 300);
	assert_int_equal(link.rx_errors, 12);
	assert_int_equal(link.restart_ms, 100);
	assert_int_equal(link.frames, 100 + 20);
	assert_int_equal(link.bytes, 800 + 160);
	assert_int_equal(link.limits.clock_hz, 8000000);
	assert_int_equal(link.limits.tseg1_min, 1);
	assert_int_equal(link.limits.tseg1_max, 16);
	assert_int_equal(link.limits.tseg2_min, 2);
	assert_int_equal(link.limits.tseg2_max, 8);
	assert_int_equal(link.limits.brp_min, 1);
	assert_int_equal(link.limits.brp_max, 64);
	assert_int_equal(link.limits.brp_inc, 1);
	assert_int_equal(link.rate_count, 2);
	assert_int_equal(link.rates[1], 250000);
}

static void test_a_virtual_interface_has_no_controller_and_counts_each_frame_twice(void **state)
{
	struct can_link link;
	size_t info;

	(void)state;
	begin_link();
	info = begin_nested(18);
	put_attribute(1, "vcan", 5);
	end_nested(info);
	assert_int_equal(can_link_look(INDEX, &link), 0);
	assert_false(link.controller);
	assert_int_equal(link.frames, 20);
	assert_int_equal(link.bytes, 160);
	assert_int_equal(can_link_bit_rate(INDEX, 250000, false), -EOPNOTSUPP);
	assert_int_equal(can_link_restart(INDEX), -EOPNOTSUPP);
}

static void test_a_refusal_or_a_damaged_message_is_an_error_or_empty(void **state)
{
	struct can_link link;
	const uint16_t too_long = 4000;
	size_t whole;

	(void)state;
	k.exists = false;
	assert_int_equal(can_link_look(INDEX, &link), -ENODEV);
	k.exists = true;
	whole = k.link_size;
	k.link_size = 15; /* shorter than its header */
	assert_int_equal(can_link_look(INDEX, &link), -EIO);
	k.link_size = whole;
	memcpy(k.link + 32, &too_long, 2); /* its first attribute ends behind it */
	assert_int_equal(can_link_look(INDEX, &link), 0);
	assert_false(link.controller);
	assert_int_equal(link.frames, 0);
}

static void test_the_port_has_the_state_the_counters_and_the_bit_rate_of_the_controller(void **state)
{
	(void)state;
	put_controller(1, 0, NULL, 0);
	open_bus();
	assert_int_equal(port->state, CAN_STATE_WARNING);
	assert_int_equal(port->bit_s, 250000);
	assert_int_equal(port->tx_errors, 255); /* 300 does not fit */
	assert_int_equal(port->rx_errors, 12);
	assert_int_equal(port->traffic.frames, 120);
	assert_int_equal(port->traffic.bytes, 960);
	put_controller(3, 0, NULL, 0);
	can_refresh(port);
	can_refresh(port);
	assert_int_equal(port->state, CAN_STATE_BUS_OFF);
	assert_int_equal(port->counters.bus_off, 1);
	put_controller(4, 0, NULL, 0); /* stopped */
	can_refresh(port);
	assert_int_equal(port->state, CAN_STATE_BUS_OFF);
}

static void test_what_the_kernel_refuses_or_does_not_answer_is_an_error(void **state)
{
	const struct can_link none = {0};
	struct can_link link;
	int *const errors[] = {&k.socket_error, &k.ask_error, &k.answer_error};

	(void)state;
	for (size_t i = 0; i < 3; i++) {
		*errors[i] = ENOBUFS;
		memset(&link, 0xEE, sizeof(link));
		assert_int_equal(can_link_look(INDEX, &link), -ENOBUFS);
		assert_memory_equal(&link, &none, sizeof(link));
		assert_int_equal(can_link_bit_rate(INDEX, 500000, false), -ENOBUFS);
		assert_int_equal(can_link_restart(INDEX), -ENOBUFS);
		*errors[i] = 0;
	}
	assert_int_equal(k.order_count, 0);
	k.link_size = 0;
	assert_int_equal(can_link_look(INDEX, &link), -EIO);
}

/* An order is answered by NLMSG_ERROR; 0 in it is the acknowledgement. */
static void test_an_order_that_is_not_acknowledged_has_failed(void **state)
{
	(void)state;
	put_controller(3, 0, NULL, 0);
	k.odd_answer_size = k.link_size; /* RTM_NEWLINK */
	assert_int_equal(can_link_restart(INDEX), -EIO);
	k.odd_answer_size = 15;
	assert_int_equal(can_link_restart(INDEX), -EIO);
	k.odd_answer_size = 0;
	k.empty_answer = true;
	assert_int_equal(can_link_restart(INDEX), -EIO);
	k.empty_answer = false;
	assert_int_equal(can_link_restart(INDEX), 0);
}

static void test_a_bit_rate_is_not_set_while_the_interface_stays_up(void **state)
{
	(void)state;
	k.order_result = -EBUSY;
	assert_int_equal(can_link_bit_rate(INDEX, 500000, false), -EBUSY);
	assert_int_equal(k.order_count, 2);
	for (int i = 0; i < 2; i++) /* ifinfomsg and no attribute */
		assert_int_equal(k.orders[i][0], 32);
}

/* A driver says EDOM or EINVAL of a rate that its clock cannot give. */
static void test_a_rate_that_the_driver_cannot_give_is_not_supported(void **state)
{
	(void)state;
	k.set_result = -EDOM;
	assert_int_equal(can_link_bit_rate(INDEX, 500000, false), -EOPNOTSUPP);
	k.order_count = 0;
	k.set_result = -ENODEV;
	assert_int_equal(can_link_bit_rate(INDEX, 500000, false), -ENODEV);
}

static void test_frames_have_the_time_and_the_losses_of_the_kernel_and_a_buffer_of_a_megabyte(void **state)
{
	char error[300];

	(void)state;
	open_bus();
	assert_true(k.stamps && k.drops_counted);
	assert_int_equal(k.forced_bytes, 1 << 20);
	assert_int_equal(k.bytes, 0);
	can_close(port);
	port = NULL;
	k.refused_option = 33; /* without CAP_NET_ADMIN as much as net.core.rmem_max permits */
	open_bus();
	assert_int_equal(k.bytes, 1 << 20);
	can_close(port);
	port = NULL;
	k.refused_option = STAMP_OPTION;
	assert_int_equal(can_open("can7", &port, error, sizeof(error)), -EPERM);
	k.refused_option = 40;
	assert_int_equal(can_open("can7", &port, error, sizeof(error)), -EPERM);
}

static void test_each_call_that_fails_is_told_and_leaves_no_socket(void **state)
{
	char error[300];
	int opened = 0, before;

	(void)state;
	before = open_descriptors();
	for (k.failing = 1; k.failing == 1 || k.calls >= k.failing - 1; k.failing++) {
		k.calls = 0;
		int result = can_open("can7", &port, error, sizeof(error));

		if (result == 0) {
			can_close(port);
			opened++;
		} else {
			assert_int_equal(result, -EIO);
			assert_non_null(strstr(error, strerror(EIO)));
		}
		port = NULL;
		assert_int_equal(open_descriptors(), before);
	}
	assert_true(k.failing > 8);
	assert_int_equal(opened, 3); /* without a failure, a buffer beyond the limit of the host, or netlink */
	k.failing = 0;
}

/* The two clocks differ by something else once CLOCK_REALTIME was set; they are compared once a second. */
static void test_after_the_time_was_set_frames_have_the_right_time_within_a_second(void **state)
{
	struct can_msg msg;

	(void)state;
	open_bus();
	for (int i = 0; i < 3; i++) {
		k.frame_count = k.frame_next = 0;
		put_frame(1, 0, "\0\0\0\0\0\0\0");
		k.frames[0].t_us -= 1234;
		k.clock_reads = 0;
		assert_int_equal(receive(&msg), 1);
		assert_int_equal(
			k.clock_reads, i == 1 ? 0 : 3 * 3); /* the best of three, each between two of the other */
		assert_int_equal(msg.t_us, i == 1 ? k.now_us : k.now_us - 1234);
		assert_receives_nothing();
		k.ahead_s = -REALTIME_AHEAD_S;
		k.now_us += i == 0 ? 999999 : 1;
	}
}

static uint32_t word(size_t order, size_t at)
{
	uint32_t value;

	memcpy(&value, k.orders[order] + at, 4);
	return value;
}

/* nlmsghdr (length, type and flags), ifinfomsg (index, flags, change) */
static void assert_order(size_t i, uint32_t length, uint32_t flags, uint32_t change)
{
	assert_int_equal(word(i, 0), length);
	assert_int_equal(word(i, 4), 16 | (0x01 | 0x04) << 16); /* RTM_NEWLINK, REQUEST and ACK */
	assert_int_equal(word(i, 20), INDEX);
	assert_int_equal(word(i, 24), flags);
	assert_int_equal(word(i, 28), change);
}

/* IFLA_LINKINFO { IFLA_INFO_KIND "can", IFLA_INFO_DATA { type: value... } } */
static void assert_controller_order(size_t i, uint32_t type, uint32_t size, uint32_t value)
{
	assert_order(i, 32 + 4 + 8 + 4 + 4 + size, 0, 0);
	assert_int_equal(word(i, 32), (4 + 8 + 4 + 4 + size) | 18 << 16);
	assert_int_equal(word(i, 36), 7 | 1 << 16);
	assert_memory_equal(k.orders[i] + 40, "can", 3);
	assert_int_equal(word(i, 44), (4 + 4 + size) | 2 << 16);
	assert_int_equal(word(i, 48), (4 + size) | type << 16);
	assert_int_equal(word(i, 52), value);
}

static void test_a_bit_rate_is_set_with_the_interface_down(void **state)
{
	const struct can_msg msg = {.id = 0x181};

	(void)state;
	open_bus();
	assert_int_equal(can_bit_rate(port, 500000, true), 0);
	assert_int_equal(can_bit_rate(port, 250000, false), 0); /* as it is */
	assert_int_equal(k.order_count, 0);
	k.send_error = ENETDOWN; /* what going down leaves on the socket */
	assert_int_equal(can_bit_rate(port, 500000, false), 0);
	assert_int_equal(k.order_count, 3);
	assert_order(0, 32, 0, 1);
	assert_controller_order(1, 1, 32, 500000); /* IFLA_CAN_BITTIMING */
	assert_order(2, 32, 1, 1);
	assert_int_equal(port->bit_s, 500000);
	assert_int_equal(can_send(port, &msg, k.now_us), 0);
}

static void test_a_bit_rate_that_cannot_be_set_is_refused(void **state)
{
	static const uint32_t rates[] = {125000, 250000};

	(void)state;
	open_bus();
	assert_int_equal(can_bit_rate(port, 4000, false), -EOPNOTSUPP); /* 8 MHz / 64 / 25 is 5 kbit/s */
	k.privileged = false;
	assert_int_equal(can_bit_rate(port, 500000, false), -EPERM);
	assert_int_equal(can_bit_rate(port, 500000, true), -EPERM);
	k.privileged = true;
	assert_int_equal(k.order_count, 0);
	k.set_result = -EINVAL; /* the driver of the controller refuses it */
	assert_int_equal(can_bit_rate(port, 500000, false), -EOPNOTSUPP);
	assert_int_equal(port->bit_s, 250000);
	put_controller(0, 0, rates, 2);
	assert_int_equal(can_bit_rate(port, 500000, true), -EOPNOTSUPP);
	assert_int_equal(can_bit_rate(port, 125000, true), 0);
}

static void test_an_interface_that_does_not_come_up_again_is_reported(void **state)
{
	(void)state;
	open_bus();
	k.up_result = -ENODEV;
	assert_int_equal(can_bit_rate(port, 500000, false), -ENODEV);
	assert_int_equal(port->bit_s, 250000);
}

static void test_bus_off_is_ended_where_the_kernel_does_not_do_it(void **state)
{
	(void)state;
	put_controller(3, 0, NULL, 0);
	open_bus();
	assert_int_equal(port->state, CAN_STATE_BUS_OFF);
	assert_int_equal(can_restart(port), 0);
	assert_int_equal(k.order_count, 1);
	assert_controller_order(0, 7, 4, 1); /* IFLA_CAN_RESTART */
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	put_controller(3, 100, NULL, 0); /* restart-ms 100 */
	assert_int_equal(can_restart(port), -EOPNOTSUPP);
	put_controller(3, 0, NULL, 0);
	k.privileged = false;
	assert_int_equal(can_restart(port), -EPERM);
	assert_int_equal(k.order_count, 1);
}

/* One socket to ask for the state, one to change it. */
static void test_bus_off_that_cannot_be_ended_for_want_of_a_socket_stays(void **state)
{
	(void)state;
	put_controller(3, 0, NULL, 0);
	open_bus();
	for (k.failing = 1; k.failing <= 2; k.failing++) {
		k.calls = 0;
		assert_int_equal(can_restart(port), -EIO);
		assert_int_equal(port->state, CAN_STATE_BUS_OFF);
	}
	k.failing = 0;
	assert_int_equal(can_restart(port), 0);
}

int main(void)
{
#define KERNEL_TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		KERNEL_TEST(test_frames_are_sent_as_the_kernel_has_them),
		KERNEL_TEST(test_frames_are_received_as_the_kernel_has_them),
		KERNEL_TEST(test_more_frames_than_a_batch_arrive_in_order),
		KERNEL_TEST(test_what_is_not_a_classical_frame_is_counted_and_not_received),
		KERNEL_TEST(test_the_time_of_a_frame_is_the_kernel_s_on_the_monotonic_clock),
		KERNEL_TEST(test_a_process_that_loses_the_processor_between_two_clocks_has_the_right_time),
		KERNEL_TEST(test_a_time_in_the_future_or_ten_seconds_old_is_replaced_by_now),
		KERNEL_TEST(test_frames_the_kernel_dropped_are_counted_once),
		KERNEL_TEST(test_a_call_reads_a_bounded_number_of_frames_that_are_not_returned),
		KERNEL_TEST(test_an_error_frame_changes_the_state_and_is_not_received),
		KERNEL_TEST(test_a_full_interface_keeps_the_frame_waiting),
		KERNEL_TEST(test_without_a_filter_all_frames_and_all_errors_pass),
		KERNEL_TEST(test_a_filter_is_one_of_the_kernel_s_for_each_identifier),
		KERNEL_TEST(test_down_and_up_again_the_same_socket_goes_on),
		KERNEL_TEST(test_removed_and_made_again_it_is_bound_to_the_new_interface_with_its_filters),
		KERNEL_TEST(test_an_interface_that_cannot_be_used_is_refused_with_what_to_do),
		KERNEL_TEST(test_a_controller_s_properties_are_read),
		KERNEL_TEST(test_a_virtual_interface_has_no_controller_and_counts_each_frame_twice),
		KERNEL_TEST(test_a_refusal_or_a_damaged_message_is_an_error_or_empty),
		KERNEL_TEST(test_what_the_kernel_refuses_or_does_not_answer_is_an_error),
		KERNEL_TEST(test_an_order_that_is_not_acknowledged_has_failed),
		KERNEL_TEST(test_a_bit_rate_is_not_set_while_the_interface_stays_up),
		KERNEL_TEST(test_a_rate_that_the_driver_cannot_give_is_not_supported),
		KERNEL_TEST(test_frames_have_the_time_and_the_losses_of_the_kernel_and_a_buffer_of_a_megabyte),
		KERNEL_TEST(test_each_call_that_fails_is_told_and_leaves_no_socket),
		KERNEL_TEST(test_after_the_time_was_set_frames_have_the_right_time_within_a_second),
		KERNEL_TEST(test_the_port_has_the_state_the_counters_and_the_bit_rate_of_the_controller),
		KERNEL_TEST(test_a_bit_rate_is_set_with_the_interface_down),
		KERNEL_TEST(test_a_bit_rate_that_cannot_be_set_is_refused),
		KERNEL_TEST(test_an_interface_that_does_not_come_up_again_is_reported),
		KERNEL_TEST(test_bus_off_is_ended_where_the_kernel_does_not_do_it),
		KERNEL_TEST(test_bus_off_that_cannot_be_ended_for_want_of_a_socket_stays),
	};

	return cmocka_run_group_tests_name("socketcan_port", tests, count_descriptors, no_descriptor_is_left);
}

/* Buses in simulated time, compared with what they did when the trace was written (trace.h): the slcan driver with
 * adapters of different kinds, the queue of a bus that is full at times, the codecs of slcan, gs_usb and UDP, error
 * frames, option texts. What is right is for test_can_*.c and test_slcan_codec.c to say. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <termios.h>
#include <unistd.h>

#include "drivers/can/bus_options.h"
#include "drivers/can/error_frame.h"
#include "drivers/can/gs_usb_codec.h"
#include "drivers/can/slcan_codec.h"
#include "drivers/can/udp_codec.h"
#include "drivers/ports/can.h"
#include "tests/unit/trace.h"

enum { MS = 1000, TEXT = 200 };

/* ---- a serial line that is a socket, so that what was written is there at once ----------------------------------- */

#define TTY "/sim/tty"

static struct {
	int ours, theirs; /* the adapter's end, the driver's */
	int absent;	  /* errno of open(); 0: it is plugged in */
	size_t room;	  /* bytes that the line takes now */
} line = {.ours = -1, .theirs = -1};

int open(const char *path, int flags, ...)
{
	int ends[2];

	if (strcmp(path, TTY) != 0)
		return (int)syscall(SYS_openat, AT_FDCWD, path, flags, 0644);
	if (line.absent) {
		errno = line.absent;
		return -1;
	}
	assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends), 0);
	if (line.ours >= 0)
		close(line.ours);
	line.ours = ends[0];
	line.theirs = ends[1];
	return ends[1];
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	if (fd != line.theirs)
		return syscall(SYS_write, fd, bytes, size);
	if (line.room == 0) {
		errno = EAGAIN;
		return -1;
	}
	size = size < line.room ? size : line.room;
	line.room -= size;
	return send(fd, bytes, size, MSG_NOSIGNAL);
}

int tcgetattr(int fd, struct termios *termios)
{
	(void)fd;
	memset(termios, 0, sizeof(*termios));
	return 0;
}

int tcsetattr(int fd, int actions, const struct termios *termios)
{
	(void)fd, (void)actions, (void)termios;
	return 0;
}

int tcflush(int fd, int queue)
{
	(void)fd, (void)queue;
	return 0;
}

int ioctl(int fd, unsigned long request, ...)
{
	(void)fd, (void)request;
	return 0;
}

/* ---- adapters ---------------------------------------------------------------------------------------------------- */

struct adapter {
	const char *name;
	const char *closes, *sets, *opens, *status, *sends; /* what it answers; "": nothing */
	unsigned other_from_ms, other_to_ms;		    /* meanwhile it answers what follows to all, or: */
	const char *other;
	enum { ANSWERS, UNPLUGGED, NO_PERMISSION, FULL } then;
	const char *tells; /* this each 700 ms */
};

static const struct adapter ADAPTERS[] = {
	{"all is well", "\r", "\r", "\r", "F00\r", "z\r", 0, 0, "", ANSWERS, ""},
	{"it tells its version", "V1013\r", "\r", "\r", "F00\r", "Z\r", 0, 0, "", ANSWERS, "N1234\r"},
	{"no answers", "", "", "", "", "", 0, 0, "", ANSWERS, ""},
	{"no answers, but frames", "", "", "", "", "", 0, 0, "", ANSWERS, "t1232AABB\r"},
	{"no status", "\r", "\r", "\r", "\a", "z\r", 0, 0, "", ANSWERS, ""},
	{"no answer to the status", "\r", "\r", "\r", "", "z\r", 0, 0, "", ANSWERS, ""},
	{"closing is refused", "\a", "\r", "\r", "F04\r", "\r", 0, 0, "", ANSWERS, ""},
	{"the bit rate is refused", "\r", "\a", "\r", "F00\r", "z\r", 0, 0, "", ANSWERS, ""},
	{"opening is refused for a while", "\r", "\r", "\r", "F00\r", "z\r", 0, 6000, "\a", ANSWERS, ""},
	{"frames are refused", "\r", "\r", "\r", "F20\r", "\a", 0, 0, "", ANSWERS, ""},
	{"all is refused for a while", "\r", "\r", "\r", "F00\r", "z\r", 3000, 7500, "\a", ANSWERS, ""},
	{"it becomes mute for a while", "\r", "\r", "\r", "F00\r", "z\r", 4100, 9000, "", ANSWERS, ""},
	{"it loses frames", "\r", "\r", "\r", "FA9\r", "z\r", 5000, 7000, "F01\r\a", ANSWERS, "t1230\rT1\rr\rxyz\r"},
	{"unplugged for a while", "\r", "\r", "\r", "F00\r", "z\r", 3300, 8700, "", UNPLUGGED, ""},
	{"not permitted for a while", "\r", "\r", "\r", "F00\r", "z\r", 3300, 5100, "", NO_PERMISSION, ""},
	{"full for a while", "\r", "\r", "\r", "F00\r", "z\r", 2000, 2900, "", FULL, ""},
	{"a line too long", "\r", "\r", "\r", "F00\r", "z\r", 0, 0, "", ANSWERS,
		"T12345678801020304050607089999\rt0011AA\n\r\nt002\n"},
};

static const char *answer_to(const struct adapter *a, const char *text, bool other)
{
	if (other && a->then == ANSWERS)
		return a->other;
	return text[0] == 'C'	? a->closes
	       : text[0] == 'S' ? a->sets
	       : text[0] == 'O' ? a->opens
	       : text[0] == 'F' ? a->status
				: a->sends;
}

/* Answers each line that has come, as it is told; `heard`: all lines. */
static void turn(const struct adapter *a, bool other, char heard[TEXT])
{
	static char rest[TEXT];
	size_t n = strlen(rest);
	ssize_t more = line.ours < 0 ? 0 : recv(line.ours, rest + n, sizeof(rest) - 1 - n, 0);
	char *end;

	heard[0] = '\0';
	rest[n + (more > 0 ? (size_t)more : 0)] = '\0';
	while ((end = strchr(rest, '\r')) != NULL) {
		const char *answer = answer_to(a, rest, other);

		snprintf(heard + strlen(heard), TEXT - strlen(heard), " %.*s", (int)(end - rest), rest);
		if (line.ours >= 0 && answer[0])
			(void)send(line.ours, answer, strlen(answer), MSG_NOSIGNAL);
		memmove(rest, end + 1, strlen(end + 1) + 1);
	}
	if (line.ours < 0)
		rest[0] = '\0';
}

static void show_port(struct can_port *port, char out[TEXT])
{
	const struct can_counters *c = &port->counters;

	snprintf(out, TEXT, "state %d, %u sent, %u received, %u again, %u and %u lost, %u errors%s%.60s%s%.60s",
		port->state, c->tx, c->rx, c->tx_retries, c->tx_dropped, c->rx_dropped, c->errors,
		port->state == CAN_STATE_DOWN && port->down_why ? ", " : "",
		port->state == CAN_STATE_DOWN && port->down_why ? port->down_why : "", port->notice ? "; " : "",
		port->notice ? port->notice : "");
	port->notice = NULL;
}

static void test_slcan(void **state)
{
	const struct adapter *a = *state;
	char header[80], heard[TEXT], now[TEXT], before[TEXT] = "", text[TEXT + 60];
	uint64_t now_us = 70000000, begin_us = now_us, send_us = now_us, tell_us = now_us;
	struct can_msg msg = {.id = 0x181, .len = 2, .data = {1, 2}}, got;
	struct can_port *port;
	bool was_other = false;

	snprintf(header, sizeof(header), "slcan: %s", a->name);
	trace_block(header);
	line.absent = 0;
	line.room = 1000000;
	assert_int_equal(can_open("slcan:" TTY ",bitrate=250000", &port, text, sizeof(text)), 0);
	while (now_us < begin_us + 13000 * MS) {
		unsigned ms = (unsigned)((now_us - begin_us) / MS);
		bool other = ms >= a->other_from_ms && ms < a->other_to_ms;

		if (other != was_other && a->then == UNPLUGGED && other) {
			close(line.ours);
			line.ours = -1;
		}
		line.absent = !other ? 0 : a->then == UNPLUGGED ? ENOENT : a->then == NO_PERMISSION ? EACCES : 0;
		line.room = other && a->then == FULL ? (ms / 100 % 3 == 0) * 7 : 1000000;
		was_other = other;
		if (now_us >= send_us) {
			msg.data[0]++;
			can_send(port, &msg, now_us);
			send_us += 230 * MS;
		}
		if (now_us >= tell_us && line.ours >= 0 && a->tells[0] && ms > 1000)
			(void)send(line.ours, a->tells, strlen(a->tells), MSG_NOSIGNAL);
		if (now_us >= tell_us)
			tell_us += 700 * MS;
		uint64_t next_us = can_service(port, now_us);
		turn(a, other, heard);
		while (can_receive(port, &got, now_us) == 1) {
			snprintf(text, sizeof(text), "%03X with %u at %llu", got.id, got.len,
				(unsigned long long)(got.t_us - begin_us));
			trace_text("received", text);
		}
		show_port(port, now);
		snprintf(text, sizeof(text), "%llu:%.60s, next in %lld", (unsigned long long)(now_us - begin_us), heard,
			next_us == UINT64_MAX ? -1 : (long long)(next_us - now_us));
		if (heard[0] || strcmp(now, before) != 0)
			trace_text("heard", text);
		if (strcmp(now, before) != 0)
			trace_text("port", now);
		strcpy(before, now);
		if (next_us > send_us)
			next_us = send_us;
		now_us = next_us > now_us + MS ? next_us : now_us + MS;
	}
	assert_int_equal(can_bit_rate(port, 83333, false), -EOPNOTSUPP);
	assert_int_equal(can_bit_rate(port, 125000, true), 0);
	assert_int_equal(can_bit_rate(port, 125000, false), 0);
	for (int i = 0; i < 6; i++) {
		can_service(port, now_us);
		turn(a, false, heard);
		(void)can_receive(port, &got, now_us);
		trace_text("another bit rate", heard[0] ? heard : "none");
		now_us += 30 * MS;
	}
	can_close(port);
	turn(a, false, heard);
	trace_text("closed", heard);
	if (line.ours >= 0)
		close(line.ours);
	line.ours = line.theirs = -1;
	trace_check();
}

/* ---- the queue --------------------------------------------------------------------------------------------------- */

struct fake {
	struct can_port port; /* first */
	int room, refusal;
	char sent[TEXT];
};

static int fake_send(struct can_port *port, const struct can_msg *msg)
{
	struct fake *fake = (struct fake *)(void *)port;

	if (fake->room == 0)
		return fake->refusal;
	fake->room--;
	snprintf(fake->sent + strlen(fake->sent), TEXT - strlen(fake->sent), " %X.%d", msg->id, msg->data[0]);
	return 0;
}

static void test_queue(void **state)
{
	static const struct can_ops ops = {.send = fake_send};
	struct fake fake = {.port = {.ops = &ops}, .refusal = -ENOBUFS};
	uint64_t now_us = 5000000;
	char text[TEXT];

	(void)state;
	trace_block("a bus that is full at times");
	for (int i = 0; i < 700; i++) {
		struct can_msg msg = {.id = 0x100u + (unsigned)(i * i) % 7u * 0x11u + (i % 50 == 0 ? (unsigned)i : 0),
			.len = 1 + (uint8_t)(i % 3),
			.data = {(uint8_t)i},
			.extended = i % 11 == 0};
		int result = can_send(&fake.port, &msg, now_us);
		uint64_t next_us = can_service(&fake.port, now_us);

		if (i % 10 == 0 || result < 0 || fake.sent[0]) {
			snprintf(text, sizeof(text), "%d: %d, %zu wait, next in %lld", i, result, fake.port.queue_count,
				next_us == UINT64_MAX ? -1 : (long long)(next_us - now_us));
			trace_text("step", text);
			trace_text("sent", fake.sent);
		}
		fake.sent[0] = '\0';
		fake.room = i < 40 ? 1 : i < 400 ? i % 3 == 0 && i % 100 > 90 : i < 500 ? 3 : i % 2;
		fake.refusal = i > 600 && i < 640 ? -ENETDOWN : i % 2 ? -EAGAIN : -ENOBUFS;
		now_us += i % 5 ? 400 : 9000;
	}
	show_port(&fake.port, text);
	trace_text("port", text);
	trace_check();
}

/* ---- codecs ------------------------------------------------------------------------------------------------------ */

static void show_bytes(const char *name, const void *bytes, size_t size)
{
	char text[TEXT + 2] = "";

	for (size_t i = 0; i < size && 2 * i < TEXT - 2; i++)
		snprintf(text + 2 * i, 3, "%02X", ((const uint8_t *)bytes)[i]);
	trace_text(name, text);
}

static void show_msg(const char *name, const struct can_msg *m)
{
	char text[TEXT];
	int n = snprintf(text, sizeof(text), "%X%s%s %u:", m->id, m->extended ? "x" : "", m->remote ? "R" : "", m->len);

	for (int i = 0; i < m->len && i < 8; i++)
		n += snprintf(text + n, sizeof(text) - (size_t)n, " %02X", m->data[i]);
	trace_text(name, text);
}

static void test_codecs(void **state)
{
	static const char *const lines[] = {"t1230\r", "t12381122334455667788\r", "t1239112233445566778899\r",
		"t12311\r", "t1231111\r", "T123456782AABB\r", "T200000001AA\r", "T1FFFFFFF0\r", "t7FF0\r", "t8000\r",
		"r1238\r", "r1239\r", "R000000010\r", "t1232AABB1234\r", "t1232AABB12345\r", "t123\r", "t12g0\r",
		"t1231ab\r", "z\r", "Z\r", "zz\r", "\r", "\n", "\a", "F00\r", "FFF\r", "F0\r", "F000\r", "V1013\r",
		"NA123\r", "xyz\r", "t1230\n", "t1230\r\n", "\n\nt1231AA\n",
		"tttttttttttttttttttttttttttttttttttttttttttttt\rt1230\r"};
	struct can_msg msgs[] = {{.id = 0x80}, {.id = 0x7FF, .len = 8, .data = {1, 2, 3, 4, 5, 6, 7, 0xFF}},
		{.id = 1, .len = 3, .data = {0xAB, 0xCD, 0xEF}}, {.id = 0x1FFFFFFF, .extended = true, .len = 1},
		{.id = 0x10, .extended = true}, {.id = 0x701, .remote = true, .len = 1},
		{.id = 0x12345, .remote = true, .extended = true, .len = 8}};
	char text[CAN_UDP_MAX];
	uint8_t packet[32];

	(void)state;
	trace_block("frames");
	for (size_t i = 0; i < sizeof(msgs) / sizeof(msgs[0]); i++) {
		struct gs_usb_frame frame;
		struct can_msg again;
		size_t n = slcan_encode(&msgs[i], text);

		show_msg("frame", &msgs[i]);
		text[n - 1] = '\0';
		trace_text("slcan", text);
		gs_usb_put_frame(&msgs[i], (uint32_t)i, 3, packet);
		show_bytes("gs_usb", packet, GS_USB_FRAME_LEN);
		memset(packet, 0xFF, 4); /* received, not an echo */
		assert_int_equal(gs_usb_get_frame(packet, GS_USB_FRAME_LEN, false, &frame), 0);
		show_msg("from gs_usb", &frame.msg);
		n = can_udp_encode(&msgs[i], text);
		show_bytes("udp", text, 90);
		show_bytes("udp, the rest", text + 90, n - 90);
		assert_int_equal(can_udp_decode(text, n, &again), 0);
		show_msg("from udp", &again);
		for (int bit = 0; bit < 8; bit++) { /* of each byte, another one */
			char results[CAN_UDP_MAX + 1] = "";

			for (size_t k = 0; k < n; k++) {
				text[k] = (char)(text[k] ^ 1 << bit);
				int rc = can_udp_decode(text, n, &again);
				results[k] = rc == -EBADMSG ? '-' : rc == -ENOTSUP ? '=' : rc == 0 ? '+' : '?';
				text[k] = (char)(text[k] ^ 1 << bit);
			}
			trace_text("changed", results);
		}
	}
	trace_block("lines of slcan");
	for (size_t i = 0; i < sizeof(lines) / sizeof(lines[0]); i++) {
		struct slcan_reader reader = {.length = 0};
		int n = snprintf(text, sizeof(text), "%zu:", i);

		for (const char *p = lines[i]; *p; p++) {
			enum slcan_kind kind = slcan_read(&reader, *p);

			if (kind == SLCAN_NOTHING)
				continue;
			n += snprintf(text + n, sizeof(text) - (size_t)n, " kind %d at %d, flags %02X", (int)kind,
				(int)(p - lines[i]), reader.flags);
			if (kind == SLCAN_FRAME)
				show_msg("line", &reader.msg);
		}
		trace_text("kinds", text);
	}
	for (uint32_t bit_s = 0; bit_s < 1100000; bit_s += 1000)
		if (slcan_bit_rate_code(bit_s)) {
			snprintf(text, sizeof(text), "%u %c", bit_s, slcan_bit_rate_code(bit_s));
			trace_text("rate", text);
		}
	trace_check();
}

static void test_gs_usb(void **state)
{
	struct gs_usb_clock clock = {.running = false};
	struct gs_usb_frame frame;
	struct gs_usb_limits limits;
	uint8_t packet[40] = {0};
	char text[TEXT];
	uint64_t now_us = 900000000;
	uint32_t stamp = 4294000000u;

	(void)state;
	trace_block("packets of gs_usb");
	for (int i = 0; i < 40; i++) {
		for (size_t k = 0; k < sizeof(packet); k++)
			packet[k] = (uint8_t)(k * 37 + (size_t)i * 11);
		if (i % 2)
			memset(packet, 0xFF, 4);
		else
			packet[0] = (uint8_t)(i / 2), packet[1] = packet[2] = packet[3] = 0;
		packet[7] = (uint8_t)((i % 8) << 5);
		packet[8] = (uint8_t)(i % 11);
		packet[10] = (uint8_t)(i % 4);
		bool stamped = i % 3 == 0;
		int rc = gs_usb_get_frame(packet, i % 13 == 0 ? 19 : stamped ? 24 : 20, stamped, &frame);
		snprintf(text, sizeof(text), "%d: %d", i, rc);
		trace_text("result", text);
		if (rc != 0)
			continue;
		snprintf(text, sizeof(text), "kind %d, channel %u, id %X, overflow %d, stamp %u", (int)frame.kind,
			frame.channel, frame.can_id, frame.overflow, frame.stamped ? frame.stamp_us : 0);
		trace_text("frame", text);
		if (frame.kind == GS_USB_ECHO)
			trace_value("slot", frame.slot, 0);
		else
			show_msg("msg", &frame.msg);
	}
	for (int i = 0; i < 12; i++) {
		static const uint32_t good[10] = {0x1F, 48000000, 1, 16, 1, 8, 4, 1, 1024, 1};

		for (int k = 0; k < 10; k++)
			for (int byte = 0; byte < 4; byte++)
				packet[4 * k + byte] = (uint8_t)((k == i ? 0 : good[k]) >> 8 * byte);
		int rc = gs_usb_get_limits(packet, i == 11 ? 39 : 40, &limits);
		const struct can_link_limits *t = &limits.timing;
		snprintf(text, sizeof(text), "%d: %d", i, rc);
		trace_text("limits", text);
		if (rc != 0)
			continue;
		snprintf(text, sizeof(text), "%X %u: %u, %u %u, %u %u %u %u", limits.features, limits.sjw_max,
			t->clock_hz, t->brp_min, t->brp_max, t->tseg1_min, t->tseg1_max, t->tseg2_min, t->tseg2_max);
		trace_text("are", text);
	}
	trace_block("the clock of an adapter");
	for (int i = 0; i < 300; i++) {
		uint32_t passed = i == 150 ? 1000000000u : i == 200 ? 3000000000u : (uint32_t)(i * 7919 % 50000);

		stamp += passed;
		now_us += i == 200 ? 5000 : passed - passed / 8000 + (uint64_t)(i * 31 % 900);
		uint64_t mapped_us = gs_usb_clock_map(&clock, stamp, now_us);
		assert_true(mapped_us <= now_us);
		if (i % 4 == 0)
			trace_value("late us", (double)(now_us - mapped_us) + 1, 0);
	}
	trace_check();
}

static void test_error_frames(void **state)
{
	struct can_port port = {.state = CAN_STATE_ACTIVE};
	char text[TEXT];

	(void)state;
	trace_block("error frames");
	for (unsigned class = 0; class < 12; class ++)
		for (unsigned detail = 0; detail < 8; detail++) {
			uint8_t data[8] = {
				0, (uint8_t)(1u << detail), 4, 8, 16, 32, (uint8_t)(detail * 20), (uint8_t)(class * 9)};

			can_error_frame(&port, 1u << class, data);
			can_error_frame(&port, 1u << class | 0x200, data);
			show_port(&port, text);
			trace_text("port", text);
			snprintf(text, sizeof(text), "%u, %u and %u", port.counters.bus_off, port.tx_errors,
				port.rx_errors);
			trace_text("off, counters", text);
			if (detail == 7)
				port.state = CAN_STATE_ACTIVE;
		}
	trace_check();
}

static void test_options(void **state)
{
	static const char *const texts[] = {"", "a", "a,bitrate=125000", "a,bitrate=0", "a,bitrate=9999",
		"a,bitrate=10000", "a,bitrate=1000000", "a,bitrate=1000001", "a,bitrate=", "a,bitrate=5k",
		"a,sample-point=0.875", "a,sample-point=0.5", "a,sample-point=0.499", "a,sample-point=0.95",
		"a,sample-point=0.999", "a,sample-point=1", "a,sample-point=x", "a,listen-only", "a,listen-only=1",
		"a,other", "a,", ",listen-only", "a,bitrate=125000,listen-only,sample-point=0.8"};
	static const char *const buses[] = {"slcan:", "slcan:/dev/x@", "slcan:/dev/x@9600", "slcan:/dev/x@9601",
		"slcan:/dev/x@3000000", "slcan:/dev/x@4000000", "slcan:/dev/x,bitrate=83333", "slcan:/dev/x", "gs_usb",
		"gs_usb:A:1", "gs_usb:A:x", "udp", "udp:", "udp:1.2.3.4", "udp:239.0.0.1", "udp:239.0.0.1:99999",
		"udp:[ff15::1]:5", "udp,hosts=any", "udp,hosts=none", "udp,hosts=10.1.2.0/24", "udp,hosts=10.1.2.0/33",
		"udp,hosts=10.1.2.0", "udp,hosts=fe80::/10", "udp,hosts=10.1.2.0/24x", "udp,interface=no-such-one",
		"udp,interface=", "udp,hosts=any,hosts=any", "udp,x=1", "udp:[ff15::1]", "udp:[ff15::1", "udp:ff15::1",
		"udp:239.0.0.1:", "udp:239.0.0.1:0", "udp:239.0.0.1:65535", "udp:239.0.0.1:+5", "can0",
		"can0,bitrate=5", "x:y", "", "a-name-that-is-too-long"};
	struct bus_options o;
	char text[400], why[300];

	(void)state;
	trace_block("options of buses");
	for (size_t i = 0; i < sizeof(texts) / sizeof(texts[0]); i++) {
		why[0] = '\0';
		memset(&o, 0, sizeof(o));
		int rc = bus_options_parse(&o, texts[i], why, sizeof(why));
		snprintf(text, sizeof(text), "'%s': %d, '%s' %u bit/s, 0.%u, %d", texts[i], rc, o.address, o.bit_s,
			o.sample_point_permille, o.listen_only);
		trace_text("options", text);
		snprintf(text, sizeof(text), "%.180s", why);
		trace_text("error", text);
	}
	for (size_t i = 0; i < sizeof(buses) / sizeof(buses[0]); i++) {
		int rc = can_open(buses[i], NULL, why, sizeof(why));

		snprintf(text, sizeof(text), "'%s': %d", buses[i], rc);
		trace_text("bus", text);
		snprintf(text, sizeof(text), "%.180s", rc < 0 ? why : "");
		trace_text("error", text);
	}
	trace_check();
}

int main(void)
{
	enum { COUNT = sizeof(ADAPTERS) / sizeof(ADAPTERS[0]) };
	struct CMUnitTest tests[COUNT + 6] = {
		cmocka_unit_test(test_queue),
		cmocka_unit_test(test_codecs),
		cmocka_unit_test(test_gs_usb),
		cmocka_unit_test(test_error_frames),
		cmocka_unit_test(test_options),
	};

	for (int i = 0; i < COUNT; i++)
		tests[5 + i] = (struct CMUnitTest){"slcan", test_slcan, NULL, NULL, (void *)&ADAPTERS[i]};
	return trace_run("can", tests, COUNT + 5);
}

/* The slcan driver on a pseudo terminal whose other end is the adapter. Oracle: the lines of Lawicel's CANUSB
 * manual. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <termios.h>
#include <unistd.h>

#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"

static const char *failing; /* the call that fails, */
static int failing_errno;   /* with this */

static bool fails(const char *call)
{
	if (!failing || strcmp(failing, call) != 0)
		return false;
	failing = NULL;
	errno = failing_errno;
	return true;
}

int tcgetattr(int fd, struct termios *line)
{
	int (*real)(int, struct termios *);

	*(void **)&real = dlsym(RTLD_NEXT, "tcgetattr");
	return fails("tcgetattr") ? -1 : real(fd, line);
}

int tcsetattr(int fd, int how, const struct termios *line)
{
	int (*real)(int, int, const struct termios *);

	*(void **)&real = dlsym(RTLD_NEXT, "tcsetattr");
	return fails("tcsetattr") ? -1 : real(fd, how, line);
}

int epoll_ctl(int fd, int op, int of, struct epoll_event *event)
{
	return fails("epoll_ctl") ? -1 : (int)syscall(SYS_epoll_ctl, fd, op, of, event);
}

int open(const char *path, int flags, ...)
{
	return fails("open") ? -1 : (int)syscall(SYS_openat, AT_FDCWD, path, flags, 0);
}

static bool stuck; /* the adapter takes nothing more: bytes stay in the buffer of the tty */
static unsigned slept_us, flushed;

int ioctl(int fd, unsigned long request, ...)
{
	va_list args;

	va_start(args, request);
	void *argument = va_arg(args, void *);
	va_end(args);
	if (request != TIOCOUTQ || !stuck)
		return (int)syscall(SYS_ioctl, fd, request, argument);
	*(int *)argument = 1;
	return 0;
}

int usleep(useconds_t us)
{
	slept_us += us;
	return 0;
}

int tcflush(int fd, int queue)
{
	(void)fd;
	flushed += queue == TCOFLUSH;
	return 0;
}

struct rig {
	int adapter; /* its end of the pseudo terminal */
	char link[64];
	struct can_port *port;
	uint64_t now_us;
	char folder[32];
};

/* A new pseudo terminal under the same name. */
static void plug(struct rig *r)
{
	r->adapter = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
	assert_true(r->adapter >= 0);
	assert_int_equal(grantpt(r->adapter), 0);
	assert_int_equal(unlockpt(r->adapter), 0);
	unlink(r->link);
	assert_int_equal(symlink(ptsname(r->adapter), r->link), 0);
}

static int set_up(void **state)
{
	struct rig *r = calloc(1, sizeof(*r));

	strcpy(r->folder, "/tmp/imu9-slcan.XXXXXX");
	assert_non_null(mkdtemp(r->folder));
	snprintf(r->link, sizeof(r->link), "%s/tty", r->folder);
	r->now_us = 1000000;
	plug(r);
	*state = r;
	return 0;
}

static int tear_down(void **state)
{
	struct rig *r = *state;

	if (r->port)
		can_close(r->port);
	if (r->adapter >= 0)
		close(r->adapter);
	unlink(r->link);
	rmdir(r->folder);
	free(r);
	return 0;
}

static int try_open(struct rig *r, const char *options, char error[300])
{
	char bus[128];

	snprintf(bus, sizeof(bus), "slcan:%s%s", r->link, options);
	return can_open(bus, &r->port, error, 300);
}

/* A pseudo terminal passes bytes on from a kernel thread: waits for them, a limit that only a failure reaches. */
static void await(int fd)
{
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};

	assert_int_equal(poll(&poll_fd, 1, 120000), 1);
}

static void assert_hears(struct rig *r, const char *expected)
{
	char heard[512] = "";
	size_t length = 0;
	ssize_t n;

	while (length < strlen(expected)) {
		await(r->adapter);
		n = read(r->adapter, heard + length, sizeof(heard) - 1 - length);
		assert_true(n > 0);
		length += (size_t)n;
	}
	n = read(r->adapter, heard + length, sizeof(heard) - 1 - length);
	heard[length + (n > 0 ? (size_t)n : 0)] = '\0';
	assert_string_equal(heard, expected);
}

static void open_bus(struct rig *r, const char *options)
{
	char error[300] = "";

	assert_int_equal(try_open(r, options, error), 0);
}

/* The bytes have reached the driver's end when this returns, if it had read all before. */
static void say(struct rig *r, const char *text)
{
	assert_int_equal(write(r->adapter, text, strlen(text)), strlen(text));
	await(r->port->fd);
}

/* The next command of the set-up is a write of its own, and `answer` the adapter's. */
static void assert_asks(struct rig *r, const char *command, const char *answer)
{
	struct can_msg msg;

	can_service(r->port, r->now_us);
	assert_hears(r, command);
	say(r, answer);
	assert_int_equal(can_receive(r->port, &msg, r->now_us), 0);
}

/* On the bus, and the adapter has confirmed it. */
static void set_up_adapter(struct rig *r)
{
	assert_asks(r, "C\r", "\r");
	assert_asks(r, "S6\r", "\r");
	assert_asks(r, "O\r", "\r");
	assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
}

static void go_on_bus(struct rig *r)
{
	open_bus(r, "");
	set_up_adapter(r);
}

static bool is_readable(const struct can_port *port)
{
	struct pollfd fd = {.fd = port->fd, .events = POLLIN};

	return poll(&fd, 1, 0) == 1;
}

static void assert_receives(struct rig *r, const struct can_msg *expected)
{
	struct can_msg msg = {0};

	assert_int_equal(can_receive(r->port, &msg, r->now_us), 1);
	assert_int_equal(msg.id, expected->id);
	assert_int_equal(msg.extended, expected->extended);
	assert_int_equal(msg.remote, expected->remote);
	assert_int_equal(msg.len, expected->len);
	assert_memory_equal(msg.data, expected->data, sizeof(msg.data));
	assert_int_equal(msg.t_us, r->now_us);
}

static void assert_receives_nothing(struct rig *r)
{
	struct can_msg msg;

	assert_int_equal(can_receive(r->port, &msg, r->now_us), 0);
}

static void ask(struct rig *r, const char *answer)
{
	r->now_us += 1000000;
	can_service(r->port, r->now_us);
	assert_hears(r, "F\r");
	say(r, answer);
	assert_receives_nothing(r);
}

/* ---- going on the bus ---- */

static void test_the_adapter_is_closed_set_and_opened_by_one_command_a_write(void **state)
{
	struct rig *r = *state;
	const struct can_msg msg = {.id = 1};

	open_bus(r, "");
	assert_hears(r, "");
	assert_int_equal(can_send(r->port, &msg, r->now_us), 0); /* waits in the queue */
	assert_asks(r, "C\r", "\r");
	assert_asks(r, "S6\r", "\r");
	assert_asks(r, "O\r", "\r");
	r->now_us += 1000;
	can_service(r->port, r->now_us);
	assert_hears(r, "t0010\r");
}

static void test_bit_rate_and_listening_are_options_of_the_bus(void **state)
{
	struct rig *r = *state;
	const struct can_msg msg = {.id = 1};

	open_bus(r, "@921600,bitrate=125000,listen-only");
	assert_asks(r, "C\r", "\r");
	assert_asks(r, "S4\r", "\r");
	assert_asks(r, "L\r", "\r");
	assert_int_equal(can_send(r->port, &msg, r->now_us), -EPERM);
	assert_hears(r, "");
}

static void test_each_usual_baud_rate_is_that_of_the_line(void **state)
{
	static const struct {
		const char *options;
		speed_t speed;
	} rates[] = {{"@9600", B9600}, {"@19200", B19200}, {"@38400", B38400}, {"@57600", B57600}, {"@115200", B115200},
		{"@230400", B230400}, {"@460800", B460800}, {"@500000", B500000}, {"@921600", B921600},
		{"@1000000", B1000000}, {"@2000000", B2000000}, {"@3000000", B3000000}};
	struct rig *r = *state;

	for (size_t i = 0; i < sizeof(rates) / sizeof(rates[0]); i++) {
		struct termios line;

		open_bus(r, rates[i].options);
		assert_int_equal(tcgetattr(r->adapter, &line), 0);
		assert_int_equal(cfgetospeed(&line), rates[i].speed);
		can_close(r->port);
		r->port = NULL;
	}
}

static void test_a_bit_rate_set_after_opening_is_used_from_the_start(void **state)
{
	struct rig *r = *state;

	open_bus(r, "");
	assert_int_equal(can_bit_rate(r->port, 250000, false), 0);
	assert_asks(r, "C\r", "\r");
	assert_asks(r, "S5\r", "\r");
	assert_int_equal(r->port->bit_s, 250000);
}

static void test_the_bit_rate_can_be_changed_on_the_bus(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	assert_int_equal(can_bit_rate(r->port, 1000000, true), 0);
	assert_int_equal(can_bit_rate(r->port, 83333, false), -EOPNOTSUPP);
	can_service(r->port, r->now_us);
	assert_hears(r, "");
	assert_int_equal(can_bit_rate(r->port, 1000000, false), 0);
	assert_asks(r, "C\r", "\r");
	assert_asks(r, "S8\r", "\r");
	assert_asks(r, "O\r", "\r");
}

static void test_closing_takes_the_adapter_off_the_bus(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	can_close(r->port);
	r->port = NULL;
	assert_hears(r, "C\r");
}

static void test_firmware_that_answers_nothing_is_on_the_bus_after_three_timeouts(void **state)
{
	static const char *const commands[] = {"C\r", "S6\r", "O\r"};
	struct rig *r = *state;
	const struct can_msg msg = {.id = 0x181};

	open_bus(r, "");
	for (size_t i = 0; i < 3; i++) {
		const uint64_t wait_us = i == 0 ? 100000 : 20000; /* it has not answered the first one */

		assert_int_equal(can_service(r->port, r->now_us), r->now_us + wait_us);
		assert_hears(r, commands[i]);
		r->now_us += wait_us;
	}
	can_service(r->port, r->now_us);
	assert_int_equal(can_send(r->port, &msg, r->now_us), 0);
	assert_hears(r, "t1810\r");
	for (int i = 0; i < 60; i++) {
		r->now_us += 1000000;
		can_service(r->port, r->now_us);
		assert_hears(r, "F\r");
		assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
	}
}

static void test_an_adapter_that_refuses_everything_is_tried_with_a_back_off(void **state)
{
	static const uint64_t pauses_us[] = {0, 500000, 1000000, 2000000, 2000000};
	struct rig *r = *state;

	open_bus(r, "");
	for (size_t i = 0; i < 5; i++) {
		assert_asks(r, "C\r", "\a");
		assert_asks(r, "S6\r", "\a");
		assert_int_equal(r->port->state, CAN_STATE_DOWN);
		assert_non_null(strstr(r->port->down_why, "refuses"));
		if (i == 0)
			continue; /* the first pause has passed already */
		assert_int_equal(can_service(r->port, r->now_us), r->now_us + pauses_us[i]);
		r->now_us += pauses_us[i];
	}
	assert_int_equal(r->port->counters.tx_dropped, 0);
	set_up_adapter(r); /* it is well again */
}

/* Reads what the driver has written, until it writes no more. */
static void drain(struct rig *r)
{
	struct pollfd line = {.fd = r->adapter, .events = POLLIN};
	char heard[256];

	while (poll(&line, 1, 20) == 1 && read(r->adapter, heard, sizeof(heard)) > 0)
		;
}

static void test_an_adapter_that_becomes_mute_is_down_until_it_answers(void **state)
{
	struct rig *r = *state;
	uint64_t end_us, next_us = 0;

	go_on_bus(r);
	ask(r, "F00\r");
	for (int i = 0; i < 3; i++) {
		r->now_us += 1000000;
		can_service(r->port, r->now_us);
		assert_hears(r, "F\r");
		assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
	}
	r->now_us += 500000;
	next_us = can_service(r->port, r->now_us);
	assert_int_equal(r->port->state, CAN_STATE_DOWN);
	assert_non_null(strstr(r->port->down_why, "does not answer"));
	end_us = r->now_us + 6000000;
	while (r->now_us < end_us || next_us <= r->now_us + 100000) {
		r->now_us = next_us;
		next_us = can_service(r->port, r->now_us);
		assert_int_equal(r->port->state, CAN_STATE_DOWN);
	}
	assert_in_range(next_us - r->now_us, 1, 2000000);
	drain(r);
	r->now_us = next_us;
	set_up_adapter(r);
}

static void test_an_adapter_that_refuses_every_frame_is_set_up_again(void **state)
{
	struct rig *r = *state;
	const struct can_msg msg = {.id = 0x701, .len = 1};

	go_on_bus(r);
	for (int i = 0; i < 4; i++) {
		assert_int_equal(can_send(r->port, &msg, r->now_us), 0);
		assert_hears(r, "t701100\r");
		say(r, "\a");
		assert_int_equal(can_receive(r->port, &(struct can_msg){0}, r->now_us), 0);
		r->now_us += 400000;
	}
	assert_int_equal(r->port->counters.tx_dropped, 4);
	assert_null(r->port->notice); /* it may refuse to be set up, too */
	set_up_adapter(r);
	assert_non_null(strstr(r->port->notice, "refused frames"));
	r->now_us += 2500000; /* and no frame is sent: nothing is known against it */
	can_service(r->port, r->now_us);
	assert_hears(r, "F\r");
}

/* Each frame that it accepts, and each that it receives, shows that it is on the bus. */
static void test_an_adapter_that_refuses_a_frame_now_and_then_stays_on_the_bus(void **state)
{
	static const char *const signs[] = {"z\r", "t0000\r", "T000000010\r"};
	struct rig *r = *state;
	const struct can_msg msg = {.id = 0x701, .len = 1};

	go_on_bus(r);
	for (int i = 0; i < 12; i++) {
		assert_int_equal(can_send(r->port, &msg, r->now_us), 0);
		assert_hears(r, "t701100\r");
		say(r, "\a");
		assert_receives_nothing(r);
		can_service(r->port, r->now_us); /* it may ask for the state */
		drain(r);
		say(r, "F00\r");
		assert_receives_nothing(r);
		r->now_us += 700000;
		say(r, signs[i % 3]);
		assert_int_equal(can_receive(r->port, &(struct can_msg){0}, r->now_us), i % 3 > 0);
		assert_receives_nothing(r);
		assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
	}
	assert_int_equal(r->port->counters.tx_dropped, 12);
}

static void test_an_adapter_that_was_closed_already_may_refuse_to_close(void **state)
{
	struct rig *r = *state;

	open_bus(r, "");
	assert_asks(r, "C\r", "\a");
	assert_asks(r, "S6\r", "\r");
	assert_asks(r, "O\r", "\r");
	assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
	assert_int_equal(r->port->counters.tx_dropped, 0);
}

static void test_lines_may_end_with_lf_or_cr_lf(void **state)
{
	struct rig *r = *state;

	open_bus(r, "");
	assert_asks(r, "C\r", "\r\n");
	assert_asks(r, "S6\r", "\r\n");
	assert_asks(r, "O\r", "\r\n");
	say(r, "z\r\nt1000\r\nt1010\nZ\nF20\n");
	assert_receives(r, &(struct can_msg){.id = 0x100});
	assert_receives(r, &(struct can_msg){.id = 0x101});
	assert_receives_nothing(r);
	assert_int_equal(r->port->state, CAN_STATE_PASSIVE);
	assert_int_equal(r->port->counters.rx_dropped, 0);
}

static void test_a_wrong_address_or_device_is_refused_with_what_to_do(void **state)
{
	struct rig *r = *state;
	char error[300] = "";

	assert_int_equal(try_open(r, "@1234", error), -EINVAL);
	assert_non_null(strstr(error, "slcan:DEVICE[@BAUD]"));
	assert_int_equal(try_open(r, ",bitrate=83333", error), -EOPNOTSUPP);
	assert_non_null(strstr(error, "125000"));
	assert_int_equal(try_open(r, ",speed=1", error), -EINVAL);
	assert_non_null(strstr(error, "'speed=1'"));
	assert_int_equal(can_open("slcan:/dev/null", &r->port, error, sizeof(error)), -ENOTTY);
	assert_string_equal(error, "/dev/null is not a serial device: use one of /dev/ttyACM*, /dev/ttyUSB*");
	assert_int_equal(can_open("slcan:/no/such", &r->port, error, sizeof(error)), -ENOENT);
	assert_null(r->port);
}

static void test_why_an_adapter_is_not_opened_is_told(void **state)
{
	static const struct {
		const char *call;
		int error;
		const char *text; /* %s: the device */
	} FAILURES[] = {{"open", EACCES,
				"no permission to use %s: add this user to the group that owns it (dialout), "
				"or run as root"},
		{"open", EBUSY, "another program uses %s: stop it (`fuser %s` shows which)"},
		{"open", ENXIO,
			"cannot open %s: No such device or address: is the adapter plugged in? "
			"`ls /dev/tty[AU]*`"},
		{"tcgetattr", EIO, "cannot open %s: Input/output error: is the adapter plugged in? `ls /dev/tty[AU]*`"},
		{"tcsetattr", EIO, "cannot open %s: Input/output error: is the adapter plugged in? `ls /dev/tty[AU]*`"},
		{"epoll_ctl", ENOSPC,
			"cannot open %s: No space left on device: is the adapter plugged in? "
			"`ls /dev/tty[AU]*`"}};
	struct rig *r = *state;
	char error[300], expected[300];
	int before = open_descriptors();

	for (size_t i = 0; i < sizeof(FAILURES) / sizeof(FAILURES[0]); i++) {
		const char *text = FAILURES[i].text, *device = strstr(text, "%s"), *again = strstr(device + 2, "%s");

		failing = FAILURES[i].call;
		failing_errno = FAILURES[i].error;
		assert_int_equal(try_open(r, "", error), -FAILURES[i].error);
		snprintf(expected, sizeof(expected), "%.*s%s%.*s%s%s", (int)(device - text), text, r->link,
			again ? (int)(again - device - 2) : 0, device + 2, again ? r->link : "",
			again ? again + 2 : device + 2);
		assert_string_equal(error, expected);
		assert_null(r->port);
		assert_int_equal(open_descriptors(), before);
	}
}

/* close() of a tty would wait up to 30 s for it. */
static void test_an_adapter_that_takes_nothing_is_closed_after_100_ms(void **state)
{
	struct rig *r = *state;

	for (int i = 0; i < 2; i++) {
		open_bus(r, "");
		stuck = i == 1;
		slept_us = flushed = 0;
		can_close(r->port);
		r->port = NULL;
		assert_int_equal(slept_us, stuck ? 100000 : 0);
		assert_int_equal(flushed, stuck);
		stuck = false;
	}
}

/* ---- frames ---- */

static void test_frames_are_sent_as_lines(void **state)
{
	static const struct can_msg frames[] = {
		{.id = 0x181, .len = 3, .data = {0xAB, 0x0C, 0xFF}},
		{.id = 0x701, .len = 0},
		{.id = 0x1ABCDEF0, .extended = true, .len = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}},
		{.id = 0x701, .remote = true, .len = 1},
		{.id = 1, .extended = true, .remote = true},
	};
	struct rig *r = *state;

	go_on_bus(r);
	for (size_t i = 0; i < sizeof(frames) / sizeof(frames[0]); i++)
		assert_int_equal(can_send(r->port, &frames[i], r->now_us), 0);
	assert_hears(r, "t1813AB0CFF\rt7010\rT1ABCDEF080102030405060708\rr7011\rR000000010\r");
}

static void test_lines_are_received_as_frames(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	say(r, "t6018aBcDeF0102030405\rT1FFFFFFF1AA\rr1234\rR000000008\r");
	assert_receives(r, &(struct can_msg){.id = 0x601, .len = 8, .data = {0xAB, 0xCD, 0xEF, 1, 2, 3, 4, 5}});
	assert_receives(r, &(struct can_msg){.id = 0x1FFFFFFF, .extended = true, .len = 1, .data = {0xAA}});
	assert_receives(r, &(struct can_msg){.id = 0x123, .remote = true, .len = 4});
	assert_receives(r, &(struct can_msg){.id = 0, .extended = true, .remote = true, .len = 8});
	assert_receives_nothing(r);
}

static void test_a_time_stamp_behind_the_data_is_not_taken_as_data(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	say(r, "t10021122EA5F\r");
	assert_receives(r, &(struct can_msg){.id = 0x100, .len = 2, .data = {0x11, 0x22}});
	assert_int_equal(r->port->counters.rx_dropped, 0);
}

static void test_a_line_may_arrive_in_pieces(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	say(r, "t1");
	assert_receives_nothing(r);
	say(r, "0011");
	assert_receives_nothing(r);
	say(r, "2\r");
	assert_receives(r, &(struct can_msg){.id = 0x100, .len = 1, .data = {0x12}});
}

static void test_garbage_is_counted_and_the_next_frame_is_received(void **state)
{
	static const char *const garbage[] = {"x", "t", "t12", "t1239", "t123200", "t12320011FFFFF", "T2000000000",
		"t8000", "t1G00", "F1", "\xFF\x01", "t100112\a"};
	struct rig *r = *state;
	char line[40];

	go_on_bus(r);
	for (size_t i = 0; i < sizeof(garbage) / sizeof(garbage[0]); i++) {
		snprintf(line, sizeof(line), "%s\rt1000\r", garbage[i]);
		say(r, line);
		assert_receives(r, &(struct can_msg){.id = 0x100});
		assert_receives_nothing(r);
		assert_int_equal(r->port->counters.rx_dropped, i + 1);
	}
}

static void test_a_line_without_an_end_is_bounded(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	for (int i = 0; i < 100; i++) {
		say(r, "t123812345678901234567890");
		assert_receives_nothing(r);
	}
	say(r, "\rt1000\r");
	assert_receives(r, &(struct can_msg){.id = 0x100});
	assert_int_equal(r->port->counters.rx_dropped, 1);
}

static void test_a_call_reads_64_lines_at_most(void **state)
{
	struct rig *r = *state;
	const uint32_t wanted[] = {0x181};

	go_on_bus(r);
	assert_int_equal(can_filter(r->port, wanted, 1), 0);
	for (int unwanted = 63; unwanted <= 64; unwanted++) {
		char text[1000] = "";
		struct can_msg msg;

		for (int i = 0; i < unwanted; i++)
			strcat(text, "t3000\r");
		strcat(text, "t1810\r");
		say(r, text);
		if (unwanted == 64)
			assert_receives_nothing(r);
		assert_int_equal(can_receive(r->port, &msg, r->now_us), 1);
		assert_int_equal(msg.id, 0x181);
		assert_receives_nothing(r);
	}
}

/* So that the work of a wake is bounded by what had arrived, and a client that waits for its answers, with as little
 * delay as here, is not taken for one that does not. */
static void test_what_arrives_while_frames_are_taken_is_left_for_the_next_wake(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	say(r, "t1000\r");
	assert_receives(r, &(struct can_msg){.id = 0x100});
	say(r, "t1010\r");
	assert_receives_nothing(r);
	assert_true(is_readable(r->port));
	assert_receives(r, &(struct can_msg){.id = 0x101});
}

static void test_the_descriptor_stays_readable_while_frames_wait_in_the_driver(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	assert_false(is_readable(r->port));
	say(r, "t1000\rt1010\r");
	assert_receives(r, &(struct can_msg){.id = 0x100});
	assert_true(is_readable(r->port));
	assert_receives(r, &(struct can_msg){.id = 0x101});
	assert_receives_nothing(r);
	assert_false(is_readable(r->port));
}

static void test_a_filter_passes_the_wanted_identifiers_only(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	assert_int_equal(can_filter(r->port, (const uint32_t[]){0x101}, 1), 0);
	say(r, "t1000\rt1010\rT000001010\r");
	assert_receives(r, &(struct can_msg){.id = 0x101});
	assert_receives_nothing(r);
}

static void test_frames_wait_while_the_line_is_full_and_none_is_lost_or_split(void **state)
{
	struct rig *r = *state;
	char heard[64 * 1024], line[32];
	size_t length = 0, at = 0;
	ssize_t n;

	go_on_bus(r);
	for (uint32_t i = 0; i < 1000; i++) {
		const struct can_msg msg = {.id = i, .len = 8};

		assert_int_equal(can_send(r->port, &msg, r->now_us), 0);
		/* the adapter reads more slowly than the driver writes at first */
		while (r->port->queue_count > CAN_QUEUE_LEN / 2) {
			await(r->adapter);
			n = read(r->adapter, heard + length, 100);
			length += n > 0 ? (size_t)n : 0;
			can_service(r->port, r->now_us += 20000);
		}
	}
	heard[length] = '\0';
	while (strstr(heard, "t3E780000000000000000\r") == NULL) { /* frame 999 */
		can_service(r->port, r->now_us += 20000);
		await(r->adapter);
		n = read(r->adapter, heard + length, 1000);
		length += n > 0 ? (size_t)n : 0;
		heard[length] = '\0';
	}
	assert_int_equal(r->port->counters.tx_dropped, 0);
	assert_true(r->port->counters.tx_retries > 0);
	for (uint32_t i = 0; i < 1000; i++) {
		if (strncmp(heard + at, "F\r", 2) == 0)
			at += 2; /* the state is requested meanwhile */
		snprintf(line, sizeof(line), "t%03X80000000000000000\r", i);
		assert_memory_equal(heard + at, line, strlen(line));
		at += strlen(line);
	}
}

/* ---- the state of the bus ---- */

static void test_the_state_is_requested_once_a_second(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	assert_int_equal(can_service(r->port, r->now_us), 2000000);
	ask(r, "F20\r");
	assert_int_equal(r->port->state, CAN_STATE_PASSIVE);
	ask(r, "F04\r");
	assert_int_equal(r->port->state, CAN_STATE_WARNING);
	ask(r, "F00\r");
	assert_int_equal(r->port->state, CAN_STATE_ACTIVE);
	ask(r, "F89\r");
	assert_int_equal(r->port->counters.errors, 1);
	assert_int_equal(r->port->counters.rx_dropped, 1);
}

static void test_an_adapter_without_the_status_command_is_not_asked_again(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	ask(r, "\a");
	ask(r, "\a");
	ask(r, "\a");
	assert_int_equal(r->port->counters.tx_dropped, 0);
	r->now_us += 5000000;
	assert_true(can_service(r->port, r->now_us) == UINT64_MAX);
	assert_hears(r, "");
}

static void test_a_frame_refused_while_the_status_is_due_does_not_end_the_requests(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	for (uint32_t i = 1; i <= 10; i++) {
		ask(r, "\aF00\r");
		assert_int_equal(r->port->counters.tx_dropped, i);
		say(r, "z\r");
		assert_receives_nothing(r);
	}
}

static void test_a_refused_frame_is_counted_as_lost(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	say(r, "z\r\a");
	assert_receives_nothing(r);
	assert_int_equal(r->port->counters.tx_dropped, 1);
}

/* F: 01h and 08h receive queue full and overrun, 04h warning, 20h passive, 80h bus error; 02h is the send queue. */
static void test_each_status_flag_has_its_meaning(void **state)
{
	static const struct {
		const char *answer;
		enum can_state state;
		uint32_t lost, errors;
	} flags[] = {{"F01\r", CAN_STATE_ACTIVE, 1, 0}, {"F02\r", CAN_STATE_ACTIVE, 0, 0},
		{"F04\r", CAN_STATE_WARNING, 0, 0}, {"F08\r", CAN_STATE_ACTIVE, 1, 0},
		{"F20\r", CAN_STATE_PASSIVE, 0, 0}, {"F24\r", CAN_STATE_PASSIVE, 0, 0},
		{"F80\r", CAN_STATE_ACTIVE, 0, 1}, {"F10\r", CAN_STATE_ACTIVE, 0, 0}};
	struct rig *r = *state;
	uint32_t lost = 0, errors = 0;

	go_on_bus(r);
	for (size_t i = 0; i < sizeof(flags) / sizeof(flags[0]); i++) {
		ask(r, flags[i].answer);
		assert_int_equal(r->port->state, flags[i].state);
		assert_int_equal(r->port->counters.rx_dropped, lost += flags[i].lost);
		assert_int_equal(r->port->counters.errors, errors += flags[i].errors);
	}
}

static void test_refusals_are_told_once_when_a_frame_is_accepted(void **state)
{
	struct rig *r = *state;

	go_on_bus(r);
	for (int i = 0; i < 2; i++) {
		say(r, "\a");
		assert_receives_nothing(r);
		say(r, "\a");
		assert_receives_nothing(r);
		assert_null(r->port->notice);
		say(r, "z\r");
		assert_receives_nothing(r);
		assert_non_null(strstr(r->port->notice, "refused frames"));
		r->port->notice = NULL;
		say(r, "z\r");
		assert_receives_nothing(r);
		assert_null(r->port->notice);
	}
	assert_int_equal(r->port->counters.tx_dropped, 4);
}

/* Raw, 8 bits, one stop bit, without flow control, whatever the line was before. */
static void test_the_line_is_raw_with_one_stop_bit_and_without_flow_control(void **state)
{
	struct rig *r = *state;
	struct termios line;

	assert_int_equal(tcgetattr(r->adapter, &line), 0);
	line.c_cflag = (line.c_cflag & ~(tcflag_t)(CSIZE | CLOCAL | CREAD)) | CS7 | CSTOPB | CRTSCTS | PARENB;
	line.c_iflag |= IXON | ICRNL;
	line.c_lflag |= ICANON | ECHO;
	line.c_oflag |= OPOST;
	assert_int_equal(tcsetattr(r->adapter, TCSANOW, &line), 0);
	open_bus(r, "");
	assert_int_equal(tcgetattr(r->adapter, &line), 0);
	assert_int_equal(line.c_cflag & (CSIZE | CSTOPB | CRTSCTS | PARENB), CS8);
	assert_int_equal(line.c_cflag & (CLOCAL | CREAD), CLOCAL | CREAD);
	assert_int_equal(line.c_iflag & (IXON | ICRNL), 0);
	assert_int_equal(line.c_lflag & (ICANON | ECHO), 0);
	assert_int_equal(line.c_oflag & OPOST, 0);
}

static void test_no_descriptor_of_the_port_is_passed_to_other_programs(void **state)
{
	struct rig *r = *state;
	bool before[64];
	int opened = 0;

	for (int fd = 0; fd < 64; fd++)
		before[fd] = fcntl(fd, F_GETFD) >= 0;
	open_bus(r, "");
	for (int fd = 0; fd < 64; fd++) {
		const int flags = before[fd] ? -1 : fcntl(fd, F_GETFD);

		opened += flags >= 0;
		assert_true(flags < 0 || flags & FD_CLOEXEC);
	}
	assert_true(opened >= 2); /* the line, and what is waited on */
	assert_non_null(strstr(r->port->name, r->link));
}

/* ---- unplugging ---- */

static void test_an_adapter_that_is_gone_is_noticed_by_a_frame_that_is_sent(void **state)
{
	struct rig *r = *state;
	const struct can_msg msg = {.id = 0x181};

	go_on_bus(r);
	close(r->adapter);
	r->adapter = -1;
	assert_int_equal(can_send(r->port, &msg, r->now_us), -ENETDOWN);
	assert_int_equal(r->port->state, CAN_STATE_DOWN);
	assert_non_null(strstr(r->port->down_why, "unplugged"));
	assert_int_equal(r->port->counters.tx_dropped, 1);
	assert_int_equal(can_bit_rate(r->port, 83333, true), -EOPNOTSUPP);
	assert_int_equal(can_bit_rate(r->port, 250000, true), 0);
}

static void test_unplugged_the_bus_is_down_and_comes_back_when_plugged_in_again(void **state)
{
	struct rig *r = *state;
	const struct can_msg msg = {.id = 0x181};
	int fd;

	go_on_bus(r);
	fd = r->port->fd;
	close(r->adapter);
	r->adapter = -1;
	assert_receives_nothing(r);
	assert_int_equal(r->port->state, CAN_STATE_DOWN);
	assert_int_equal(can_send(r->port, &msg, r->now_us), -ENETDOWN);
	unlink(r->link);
	r->now_us += 600000;
	assert_int_equal(can_service(r->port, r->now_us), r->now_us + 500000);
	plug(r);
	r->now_us += 600000;
	set_up_adapter(r);
	assert_int_equal(r->port->fd, fd);
	assert_int_equal(can_send(r->port, &msg, r->now_us), 0);
	assert_hears(r, "t1810\r");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup_teardown(
			test_the_adapter_is_closed_set_and_opened_by_one_command_a_write, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_bit_rate_and_listening_are_options_of_the_bus, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_bit_rate_set_after_opening_is_used_from_the_start, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_the_bit_rate_can_be_changed_on_the_bus, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_closing_takes_the_adapter_off_the_bus, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_firmware_that_answers_nothing_is_on_the_bus_after_three_timeouts, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_refuses_everything_is_tried_with_a_back_off, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_becomes_mute_is_down_until_it_answers, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_refuses_every_frame_is_set_up_again, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_lines_may_end_with_lf_or_cr_lf, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_frame_refused_while_the_status_is_due_does_not_end_the_requests, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_was_closed_already_may_refuse_to_close, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_a_call_reads_64_lines_at_most, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_each_usual_baud_rate_is_that_of_the_line, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_refuses_a_frame_now_and_then_stays_on_the_bus, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_wrong_address_or_device_is_refused_with_what_to_do, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_takes_nothing_is_closed_after_100_ms, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_why_an_adapter_is_not_opened_is_told, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_frames_are_sent_as_lines, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_lines_are_received_as_frames, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_time_stamp_behind_the_data_is_not_taken_as_data, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_a_line_may_arrive_in_pieces, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_garbage_is_counted_and_the_next_frame_is_received, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_a_line_without_an_end_is_bounded, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_what_arrives_while_frames_are_taken_is_left_for_the_next_wake, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_descriptor_stays_readable_while_frames_wait_in_the_driver, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_a_filter_passes_the_wanted_identifiers_only, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_frames_wait_while_the_line_is_full_and_none_is_lost_or_split, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_the_state_is_requested_once_a_second, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_without_the_status_command_is_not_asked_again, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_a_refused_frame_is_counted_as_lost, set_up, tear_down),
		cmocka_unit_test_setup_teardown(test_each_status_flag_has_its_meaning, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_refusals_are_told_once_when_a_frame_is_accepted, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_line_is_raw_with_one_stop_bit_and_without_flow_control, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_no_descriptor_of_the_port_is_passed_to_other_programs, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_an_adapter_that_is_gone_is_noticed_by_a_frame_that_is_sent, set_up, tear_down),
		cmocka_unit_test_setup_teardown(
			test_unplugged_the_bus_is_down_and_comes_back_when_plugged_in_again, set_up, tear_down),
	};

	return cmocka_run_group_tests_name("can_slcan", tests, count_descriptors, no_descriptor_is_left);
}

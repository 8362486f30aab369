#include "drivers/can/slcan.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include "drivers/can/bus_options.h"
#include "drivers/can/id_filter.h"
#include "drivers/can/more.h"
#include "drivers/can/slcan_codec.h"

enum {
	LOOK_AGAIN_US = 500000,
	ASK_STATUS_US = 1000000,
	WRITE_AGAIN_US = 1000,
	BAUD_DEFAULT = 115200,
	LINES_PER_CALL = 64,
	CLOSE_TIMEOUT_MS = 100,
};

struct slcan {
	struct can_port port; /* port.fd is an epoll descriptor over the device, and `more` */
	struct more more;
	char device[BUS_ADDRESS_MAX];
	speed_t baud;
	bool listen_only;
	int fd; /* -1: unplugged */
	uint64_t look_at_us;

	bool set_up;	 /* the commands C, S and O were written */
	int answers_due; /* answers to them; 0: all received, or the adapter answers nothing */
	bool status_due; /* the answer to F */
	bool no_status;	 /* the adapter does not support F */
	uint64_t ask_status_at_us;

	char out[SLCAN_LINE_MAX]; /* a line that the device did not accept at once */
	size_t out_at, out_length;
	char in[256];
	size_t in_at, in_length;
	struct slcan_reader reader;
	struct id_filter filter;
};

static struct slcan *of(struct can_port *port)
{
	return (struct slcan *)(void *)port;
}

/* ---- the serial line --------------------------------------------------------------------------------------------- */

static bool find_baud(unsigned long baud, speed_t *speed)
{
	static const struct {
		unsigned long baud;
		speed_t speed;
	} table[] = {{9600, B9600}, {19200, B19200}, {38400, B38400}, {57600, B57600}, {115200, B115200},
		{230400, B230400}, {460800, B460800}, {500000, B500000}, {921600, B921600}, {1000000, B1000000},
		{2000000, B2000000}, {3000000, B3000000}};

	for (size_t i = 0; i < sizeof(table) / sizeof(table[0]); i++)
		if (table[i].baud == baud) {
			*speed = table[i].speed;
			return true;
		}
	return false;
}

static int set_line(int fd, speed_t baud)
{
	struct termios line;

	if (tcgetattr(fd, &line) != 0)
		return -errno;
	cfmakeraw(&line);
	line.c_cflag |= CLOCAL | CREAD;
	line.c_cflag &= ~(tcflag_t)(CRTSCTS | CSTOPB);
	cfsetspeed(&line, baud);
	if (tcsetattr(fd, TCSANOW, &line) != 0)
		return -errno;
	(void)ioctl(fd, TIOCEXCL);
	return 0;
}

static int attach(struct slcan *can)
{
	struct epoll_event event = {.events = EPOLLIN};
	int fd = open(can->device, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
	int result;

	if (fd < 0)
		return -errno;
	result = set_line(fd, can->baud);
	if (result == 0 && epoll_ctl(can->port.fd, EPOLL_CTL_ADD, fd, &event) != 0)
		result = -errno;
	if (result < 0) {
		close(fd);
		return result;
	}
	can->fd = fd;
	can->set_up = can->status_due = can->no_status = false;
	can->answers_due = 0;
	can->in_at = can->in_length = can->out_at = can->out_length = 0;
	can->reader = (struct slcan_reader){.length = 0};
	return 0;
}

static void detach(struct slcan *can)
{
	(void)tcflush(can->fd, TCOFLUSH); /* close() would wait until it is written */
	close(can->fd);			  /* also removes it from the epoll set */
	can->fd = -1;
	can->port.state = CAN_STATE_DOWN;
}

/* Writes the rest of the last line. 0; -EAGAIN: some is left; -ENETDOWN. */
static int write_rest(struct slcan *can)
{
	ssize_t n;

	if (can->fd < 0)
		return -ENETDOWN;
	if (can->out_at == can->out_length)
		return 0;
	n = write(can->fd, can->out + can->out_at, can->out_length - can->out_at);
	if (n < 0 && errno != EAGAIN) {
		detach(can);
		return -ENETDOWN;
	}
	can->out_at += n > 0 ? (size_t)n : 0;
	return can->out_at == can->out_length ? 0 : -EAGAIN;
}

/* Writes `out`, a new line of this length. */
static int write_line(struct slcan *can, size_t length)
{
	int result;

	can->out_at = 0;
	can->out_length = length;
	result = write_rest(can);
	if (result != -EAGAIN)
		return result;
	if (can->out_at > 0)
		return 0; /* the rest follows */
	can->out_length = 0;
	return -EAGAIN;
}

/* ---- answers of the adapter -------------------------------------------------------------------------------------- */

static void handle_status(struct slcan *can, uint8_t flags)
{
	struct can_port *port = &can->port;

	can->status_due = false;
	if (flags & (SLCAN_RX_FULL | SLCAN_OVERRUN))
		port->counters.rx_dropped++;
	if (flags & SLCAN_BUS_ERROR)
		port->counters.errors++;
	port->state = (flags & SLCAN_PASSIVE)	? CAN_STATE_PASSIVE
		      : (flags & SLCAN_WARNING) ? CAN_STATE_WARNING
						: CAN_STATE_ACTIVE;
}

/* The answers to C, S and O arrive in this order. An adapter that is closed already refuses C. */
static void handle_answer(struct slcan *can, bool refused)
{
	if (can->answers_due > 0) {
		can->answers_due--;
		if (refused && can->answers_due < 2)
			detach(can); /* and start again */
	} else if (refused && can->status_due) {
		can->no_status = true;
		can->status_due = false;
	} else if (refused) {
		can->port.counters.tx_dropped++;
	}
}

/* True: reader.msg is a received frame. */
static bool handle_line(struct slcan *can, enum slcan_kind kind)
{
	switch (kind) {
	case SLCAN_FRAME:
		return id_filter_wants(&can->filter, &can->reader.msg);
	case SLCAN_OK:
	case SLCAN_REFUSED:
		handle_answer(can, kind == SLCAN_REFUSED);
		break;
	case SLCAN_STATUS:
		handle_status(can, can->reader.flags);
		break;
	case SLCAN_BAD:
		can->port.counters.rx_dropped++;
		break;
	case SLCAN_NOTHING:
	case SLCAN_OTHER:
		break;
	}
	return false;
}

/* False: nothing was read. */
static bool read_more(struct slcan *can)
{
	ssize_t n = can->fd < 0 ? 0 : read(can->fd, can->in, sizeof(can->in));

	if (can->fd >= 0 && (n == 0 || (n < 0 && errno != EAGAIN)))
		detach(can);
	can->in_at = 0;
	can->in_length = n > 0 ? (size_t)n : 0;
	return can->in_length > 0;
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static int slcan_send(struct can_port *port, const struct can_msg *msg)
{
	struct slcan *can = of(port);
	int result;

	if (can->listen_only)
		return -EPERM;
	if (can->fd >= 0 && !can->set_up)
		return -EAGAIN;
	result = write_rest(can);
	return result < 0 ? result : write_line(can, slcan_encode(msg, can->out));
}

static int slcan_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	struct slcan *can = of(port);
	bool received = false;
	int lines = 0;

	while (!received && lines < LINES_PER_CALL && (can->in_at < can->in_length || read_more(can))) {
		enum slcan_kind kind = slcan_read(&can->reader, can->in[can->in_at++]);

		lines += kind != SLCAN_NOTHING;
		received = handle_line(can, kind);
	}
	if (received) {
		*msg = can->reader.msg;
		msg->t_us = now_us;
	}
	more_set(&can->more, can->in_at < can->in_length);
	return received;
}

static int slcan_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	id_filter_set(&of(port)->filter, ids, n);
	return 0;
}

static void set_up(struct slcan *can)
{
	int n = snprintf(can->out, sizeof(can->out), "C\rS%c\r%c\r", slcan_bit_rate_code(can->port.bit_s),
		can->listen_only ? 'L' : 'O');

	if (write_line(can, (size_t)n) < 0)
		return;
	can->set_up = true;
	can->answers_due = 3;
	can->port.state = CAN_STATE_ACTIVE;
}

static void ask_status(struct slcan *can, uint64_t now_us)
{
	if (now_us < can->ask_status_at_us || can->no_status)
		return;
	can->ask_status_at_us = now_us + ASK_STATUS_US;
	memcpy(can->out, "F\r", 2);
	can->status_due = write_line(can, 2) == 0;
	/* an adapter that has not answered yet does not answer at all */
	can->answers_due = 0;
}

static uint64_t slcan_service(struct can_port *port, uint64_t now_us)
{
	struct slcan *can = of(port);

	if (can->fd < 0) {
		if (now_us < can->look_at_us)
			return can->look_at_us;
		can->look_at_us = now_us + LOOK_AGAIN_US;
		if (attach(can) < 0)
			return can->look_at_us;
	}
	if (write_rest(can) < 0)
		return can->fd < 0 ? can->look_at_us : now_us + WRITE_AGAIN_US;
	if (!can->set_up) {
		set_up(can);
		can->ask_status_at_us = now_us + ASK_STATUS_US;
	} else {
		ask_status(can, now_us);
	}
	if (can->fd < 0)
		return can->look_at_us;
	return can->out_at < can->out_length || !can->set_up ? now_us + WRITE_AGAIN_US
	       : can->no_status				     ? UINT64_MAX
							     : can->ask_status_at_us;
}

static int slcan_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	struct slcan *can = of(port);

	if (slcan_bit_rate_code(bit_s) == '\0')
		return -EOPNOTSUPP;
	if (dry_run || bit_s == port->bit_s)
		return 0;
	port->bit_s = bit_s;
	can->set_up = false;
	return 0;
}

/* close() of a tty waits up to 30 s for an adapter that does not accept data: limit that to 100 ms. */
static void drain(int fd)
{
	int left = 0;

	for (int ms = 0; ms < CLOSE_TIMEOUT_MS && ioctl(fd, TIOCOUTQ, &left) == 0 && left > 0; ms += 10)
		usleep(10000);
	if (left > 0)
		tcflush(fd, TCOFLUSH);
}

static void slcan_close(struct can_port *port)
{
	struct slcan *can = of(port);

	if (can->fd >= 0) {
		if (write_rest(can) == 0) {
			memcpy(can->out, "C\r", 2);
			(void)write_line(can, 2);
		}
		if (can->fd >= 0) {
			drain(can->fd);
			close(can->fd);
		}
	}
	more_close(&can->more, port->fd);
	free(can);
}

static const struct can_ops slcan_ops = {
	.send = slcan_send,
	.receive = slcan_receive,
	.filter = slcan_filter,
	.service = slcan_service,
	.bit_rate = slcan_bit_rate,
	.close = slcan_close,
};

/* DEVICE[@BAUD] */
static bool parse(struct slcan *can, char *address)
{
	char *at = strrchr(address, '@'), *end;
	unsigned long baud = BAUD_DEFAULT;

	if (at != NULL) {
		baud = strtoul(at + 1, &end, 10);
		if (end == at + 1 || *end != '\0')
			return false;
		*at = '\0';
	}
	strcpy(can->device, address);
	return address[0] != '\0' && find_baud(baud, &can->baud);
}

static void explain(int result, const struct slcan *can, char *error, size_t error_size)
{
	switch (result) {
	case -EOPNOTSUPP:
		snprintf(error, error_size,
			"slcan does not support %u bit/s: use 10000, 20000, 50000, 100000, 125000, 250000, 500000, "
			"800000 or 1000000",
			can->port.bit_s);
		break;
	case -EINVAL:
		snprintf(error, error_size,
			"bad bus address: use " CAN_SLCAN_SYNTAX " with a usual baud rate from 9600 to 3000000");
		break;
	case -EACCES:
		snprintf(error, error_size,
			"no permission to use %s: add this user to the group that owns it (dialout), or run as root",
			can->device);
		break;
	case -EBUSY:
		snprintf(error, error_size, "another program uses %s: stop it (`fuser %s` shows which)", can->device,
			can->device);
		break;
	case -ENOTTY:
		snprintf(error, error_size, "%s is not a serial device: use one of /dev/ttyACM*, /dev/ttyUSB*",
			can->device);
		break;
	default:
		snprintf(error, error_size, "cannot open %s: %s: is the adapter plugged in? `ls /dev/tty[AU]*`",
			can->device, strerror(-result));
	}
}

static int set_up_port(struct slcan *can, const struct bus_options *options)
{
	int result;

	can->port.bit_s = options->bit_s;
	can->listen_only = options->listen_only;
	if (slcan_bit_rate_code(options->bit_s) == '\0')
		return -EOPNOTSUPP;
	result = more_open(&can->more, &can->port.fd);
	return result < 0 ? result : attach(can);
}

int can_slcan_open(const char *address, struct can_port **port, char *error, size_t error_size)
{
	struct bus_options options;
	struct slcan *can;
	int result = bus_options_parse(&options, address, error, error_size);

	if (result < 0)
		return result;
	can = calloc(1, sizeof(*can));
	if (can == NULL)
		return -ENOMEM;
	can->port.ops = &slcan_ops;
	can->port.fd = can->more.fd = can->fd = -1;
	result = parse(can, options.address) ? set_up_port(can, &options) : -EINVAL;
	if (result < 0) {
		explain(result, can, error, error_size);
		slcan_close(&can->port);
		return result;
	}
	snprintf(can->port.name, sizeof(can->port.name), "slcan:%.50s", can->device);
	*port = &can->port;
	return 0;
}

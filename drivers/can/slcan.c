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
	BACKOFF_MIN_US = 500000, /* until the device is opened again */
	BACKOFF_MAX_US = 2000000,
	ANSWER_US = 100000,   /* firmware that answers commands does so within this time */
	NO_ANSWER_US = 20000, /* what it has for the next one if it did not answer the first */
	ASK_STATUS_US = 1000000,
	STATUS_TRIES = 3,      /* refusals of F, after which it is not asked again */
	MUTE_US = 3500000,     /* nothing was received, not even the answers to three F */
	REFUSING_US = 1000000, /* every frame was refused */
	WRITE_AGAIN_US = 1000,
	BAUD_DEFAULT = 115200,
	LINES_PER_CALL = 64,
	CLOSE_TIMEOUT_MS = 100,
};

/* The commands that set the adapter up. Each is a write of its own and waits for its answer: some firmware reads one
 * command of each USB packet. Firmware that answers nothing gets them a little apart. */
enum step { STEP_CLOSE, STEP_RATE, STEP_OPEN, STEP_OPENED };

struct slcan {
	struct can_port port; /* port.fd is an epoll descriptor over the device, and `more` */
	struct more more;
	char device[BUS_ADDRESS_MAX];
	speed_t baud;
	bool listen_only;

	bool awaiting; /* the command of this step was written, its answer is due by answer_by_us */
	bool silent;   /* a command of this set-up was not answered */
	bool answers;  /* this adapter has answered a command of the set-up */

	bool status_due;       /* the answer to F */
	bool status_refused;   /* a BEL since F: to F or to a frame */
	bool status_known;     /* F was answered since the device was opened */
	bool refusal_untold;   /* frames were refused; whether it only was full is not known yet */
	unsigned status_tries; /* that were refused */

	int fd; /* -1: unplugged */
	enum step step;
	uint32_t backoff_us;
	uint64_t look_at_us, answer_by_us, ask_status_at_us;
	uint64_t heard_us;		      /* the last line */
	uint64_t refused_us, refused_last_us; /* frames refused since one was accepted; 0: none */

	size_t out_at, out_length, in_at, in_length;
	char out[SLCAN_LINE_MAX]; /* a line that the device did not accept at once */
	char in[256];
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

/* Sets the adapter up from the start. */
static void restart(struct slcan *can)
{
	can->step = STEP_CLOSE;
	can->awaiting = can->silent = false;
	can->refused_us = 0;
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
	restart(can);
	can->status_due = can->status_refused = can->status_known = false;
	can->status_tries = 0;
	can->in_at = can->in_length = can->out_at = can->out_length = 0;
	can->reader = (struct slcan_reader){.length = 0};
	return 0;
}

/* Closes the device, which is opened again after a back-off. */
static void detach(struct slcan *can, const char *why)
{
	(void)tcflush(can->fd, TCOFLUSH); /* close() would wait until it is written */
	close(can->fd);			  /* also removes it from the epoll set */
	can->fd = -1;
	if (can->port.state != CAN_STATE_DOWN)
		can->port.down_why = why;
	can->port.state = CAN_STATE_DOWN;
	can->refusal_untold = false; /* that says it */
}

static void unplugged(struct slcan *can)
{
	can->answers = false; /* the next one may be another */
	detach(can, "unplugged: plug the adapter in, it is searched for");
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
		unplugged(can);
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

/* Once, when the adapter is on the bus again: if it cannot be, that is what is told. */
static void tell_refusal(struct slcan *can)
{
	if (can->refusal_untold)
		can->port.notice = "the adapter has refused frames: its buffer was full, or it had left the bus";
	can->refusal_untold = false;
}

static void frame_accepted(struct slcan *can)
{
	can->refused_us = 0;
	tell_refusal(can);
	can->backoff_us = BACKOFF_MIN_US;
}

static void frame_refused(struct slcan *can)
{
	can->port.counters.tx_dropped++;
	if (can->refused_us == 0)
		can->refused_us = can->heard_us;
	can->refused_last_us = can->heard_us;
	can->refusal_untold = true;
}

static void handle_status(struct slcan *can, uint8_t flags)
{
	struct can_port *port = &can->port;

	if (can->status_refused) /* not F was refused, but a frame */
		frame_refused(can);
	can->status_due = can->status_refused = false;
	can->status_known = true;
	if (flags & (SLCAN_RX_FULL | SLCAN_OVERRUN))
		port->counters.rx_dropped++;
	if (flags & SLCAN_BUS_ERROR)
		port->counters.errors++;
	port->state = (flags & SLCAN_PASSIVE)	? CAN_STATE_PASSIVE
		      : (flags & SLCAN_WARNING) ? CAN_STATE_WARNING
						: CAN_STATE_ACTIVE;
}

static void next_step(struct slcan *can)
{
	can->awaiting = false;
	can->step++;
	if (can->step < STEP_OPENED)
		return;
	can->port.state = CAN_STATE_ACTIVE;
	can->port.retry_at_us = 0; /* what has waited is sent now */
	tell_refusal(can);
}

/* CR or BEL. An adapter that is closed already refuses C. */
static void handle_answer(struct slcan *can, bool refused)
{
	if (can->step < STEP_OPENED) {
		can->answers = can->answers || can->awaiting;
		if (refused && can->step > STEP_CLOSE)
			detach(can, "the adapter refuses to go on the bus: unplug it, or use another bit rate; it is "
				    "tried again");
		else if (can->awaiting)
			next_step(can);
	} else if (!refused) {
		frame_accepted(can);
	} else if (can->status_due && !can->status_refused) {
		can->status_refused = true;
	} else {
		frame_refused(can);
	}
}

/* True: reader.msg is a received frame. */
static bool handle_line(struct slcan *can, enum slcan_kind kind)
{
	switch (kind) {
	case SLCAN_FRAME:
		can->refused_us = 0; /* it is on the bus */
		return id_filter_wants(&can->filter, &can->reader.msg);
	case SLCAN_OK:
	case SLCAN_REFUSED:
		handle_answer(can, kind == SLCAN_REFUSED);
		break;
	case SLCAN_SENT:
		frame_accepted(can);
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

/* False: nothing is left. What did not fill the buffer was the last: the port's descriptor tells when there is more. */
static bool read_more(struct slcan *can)
{
	bool drained = can->in_length % sizeof(can->in) != 0;
	ssize_t n;

	can->in_at = can->in_length = 0;
	if (can->fd < 0 || drained)
		return false;
	n = read(can->fd, can->in, sizeof(can->in));
	if (n == 0 || (n < 0 && errno != EAGAIN))
		unplugged(can);
	can->in_length = n > 0 ? (size_t)n : 0;
	return n > 0;
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static int slcan_send(struct can_port *port, const struct can_msg *msg)
{
	struct slcan *can = of(port);
	int result;

	if (can->listen_only)
		return -EPERM;
	if (can->fd >= 0 && can->step < STEP_OPENED)
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

		if (kind != SLCAN_NOTHING) {
			can->heard_us = now_us;
			lines++;
		}
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

/* Writes `text` as one write; false: later. */
static bool command(struct slcan *can, const char *text)
{
	size_t length = strlen(text);

	memcpy(can->out, text, length);
	return write_line(can, length) == 0;
}

static void set_up(struct slcan *can, uint64_t now_us)
{
	const char *const commands[] = {"C\r", (const char[]){'S', slcan_bit_rate_code(can->port.bit_s), '\r', '\0'},
		can->listen_only ? "L\r" : "O\r"};

	if (can->awaiting && now_us >= can->answer_by_us) {
		if (can->answers) {
			detach(can, "the adapter does not answer: unplug it and plug it in again; it is tried again");
			return;
		}
		can->silent = true;
		next_step(can);
	}
	if (can->step < STEP_OPENED && !can->awaiting && command(can, commands[can->step])) {
		can->awaiting = true;
		can->answer_by_us = now_us + (can->silent ? NO_ANSWER_US : ANSWER_US);
	}
	can->heard_us = now_us;
	can->ask_status_at_us = now_us + ASK_STATUS_US;
}

static bool asks_status(const struct slcan *can)
{
	return can->status_tries < STATUS_TRIES;
}

static void ask_status(struct slcan *can, uint64_t now_us)
{
	if (now_us < can->ask_status_at_us || !asks_status(can))
		return;
	can->status_tries = can->status_refused && !can->status_known ? can->status_tries + 1 : 0;
	can->status_due = can->status_refused = false;
	can->ask_status_at_us = now_us + ASK_STATUS_US;
	if (asks_status(can))
		can->status_due = command(can, "F\r");
}

static void back_off(struct slcan *can, uint64_t now_us)
{
	can->look_at_us = now_us + can->backoff_us;
	can->backoff_us = can->backoff_us < BACKOFF_MAX_US ? 2 * can->backoff_us : BACKOFF_MAX_US;
}

/* An adapter that has become mute is opened again, one that refuses every frame is set up again. */
static void watch(struct slcan *can, uint64_t now_us)
{
	if (can->status_known && now_us - can->heard_us >= MUTE_US)
		detach(can, "the adapter does not answer: unplug it and plug it in again; it is tried again");
	if (can->fd < 0 || can->refused_us == 0 || can->refused_last_us - can->refused_us < REFUSING_US ||
		now_us < can->look_at_us)
		return;
	back_off(can, now_us);
	restart(can);
}

static void search(struct slcan *can, uint64_t now_us)
{
	if (now_us < can->look_at_us)
		return;
	back_off(can, now_us);
	if (attach(can) == 0)
		return;
	can->look_at_us = now_us + BACKOFF_MIN_US; /* it was unplugged: looked for often */
	can->backoff_us = BACKOFF_MIN_US;
	can->answers = false;
}

static uint64_t slcan_service(struct can_port *port, uint64_t now_us)
{
	struct slcan *can = of(port);

	if (can->fd < 0)
		search(can, now_us);
	if (can->fd < 0)
		return can->look_at_us;
	if (can->step == STEP_OPENED)
		watch(can, now_us);
	if (can->fd >= 0 && write_rest(can) == 0) {
		if (can->step < STEP_OPENED)
			set_up(can, now_us);
		else
			ask_status(can, now_us);
	}
	if (can->fd < 0)
		return can->look_at_us > now_us ? can->look_at_us : now_us;
	if (can->out_at < can->out_length || (can->step < STEP_OPENED && !can->awaiting))
		return now_us + WRITE_AGAIN_US;
	if (can->step < STEP_OPENED)
		return can->answer_by_us;
	return asks_status(can) ? can->ask_status_at_us : UINT64_MAX;
}

static int slcan_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	struct slcan *can = of(port);

	if (slcan_bit_rate_code(bit_s) == '\0')
		return -EOPNOTSUPP;
	if (dry_run || bit_s == port->bit_s)
		return 0;
	port->bit_s = bit_s;
	restart(can);
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
		if (write_rest(can) == 0)
			(void)command(can, "C\r");
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

static int set_up_port(struct slcan *can)
{
	int result = more_open(&can->more, &can->port.fd);

	can->backoff_us = BACKOFF_MIN_US;
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
	can->port.bit_s = options.bit_s;
	can->listen_only = options.listen_only;
	if (!parse(can, options.address))
		result = -EINVAL;
	else if (slcan_bit_rate_code(options.bit_s) == '\0')
		result = -EOPNOTSUPP;
	else if (port != NULL)
		result = set_up_port(can);
	if (result < 0)
		explain(result, can, error, error_size);
	if (result < 0 || port == NULL) {
		slcan_close(&can->port);
		return result;
	}
	snprintf(can->port.name, sizeof(can->port.name), "slcan:%.50s", can->device);
	*port = &can->port;
	return 0;
}

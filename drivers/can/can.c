#include "drivers/ports/can.h"
#include "drivers/ports/sources.h"

#include <assert.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "drivers/can/gs_usb.h"
#include "drivers/can/slcan.h"
#include "drivers/can/socketcan.h"
#include "drivers/can/udp.h"

/* Back-off of a full bus. One full frame takes 0.25 ms at 500 kbit/s and 12 ms at 10 kbit/s. */
enum { BACKOFF_MIN_US = 500, BACKOFF_MAX_US = 20000 };

static const struct source {
	const char *name; /* up to the first ':' or ','; "": an interface name */
	const char *syntax, *description;
	/* `address` is what follows the name, without the ':' */
	int (*open)(const char *address, struct can_port **port, char *error, size_t error_size);
} SOURCES[] = {
	{"", "INTERFACE", "a CAN interface of the kernel (SocketCAN), e.g. can0 or vcan0", can_socketcan_open},
	{"gs_usb", CAN_GS_USB_SYNTAX,
		"a USB adapter of the candleLight family, through libusb, without a kernel driver", can_gs_usb_open},
	{"slcan", CAN_SLCAN_SYNTAX, "a serial or USB-serial adapter with the slcan protocol (Lawicel, CANable)",
		can_slcan_open},
	{"udp", CAN_UDP_SYNTAX,
		"UDP multicast in the format of python-can's udp_multicast bus (default " CAN_UDP_GROUP ":" CAN_UDP_PORT
		"); HOSTS that may write beside this one: any, or NETWORK/BITS",
		can_udp_open},
};
enum { SOURCE_COUNT = sizeof(SOURCES) / sizeof(SOURCES[0]) };

void can_print_sources(FILE *out)
{
	for (size_t i = 0; i < SOURCE_COUNT; i++)
		fprintf(out, "  %s\n      %s\n", SOURCES[i].syntax, SOURCES[i].description);
}

static int refuse(const char *bus, char *error, size_t error_size)
{
	int used = snprintf(error, error_size, "unknown bus '%.40s': use one of", bus);

	for (size_t i = 0; i < SOURCE_COUNT && (size_t)used < error_size; i++)
		used += snprintf(error + used, error_size - (size_t)used, "%s %s", i ? "," : "", SOURCES[i].syntax);
	return -EINVAL;
}

static int open_any(const char *bus, struct can_port **port, char *error, size_t error_size)
{
	size_t length = strcspn(bus, ":,");

	for (size_t i = 1; i < SOURCE_COUNT; i++)
		if (strlen(SOURCES[i].name) == length && strncmp(bus, SOURCES[i].name, length) == 0)
			return SOURCES[i].open(bus + length + (bus[length] == ':'), port, error, error_size);
	if (bus[0] == '\0' || strpbrk(bus, ":/ ") != NULL)
		return refuse(bus, error, error_size);
	return SOURCES[0].open(bus, port, error, error_size);
}

int can_open(const char *bus, struct can_port **port, char *error, size_t error_size)
{
	int result;

	error[0] = '\0';
	result = open_any(bus, port, error, error_size);
	if (result < 0 && error[0] == '\0') /* out of memory: the driver had nothing to add */
		snprintf(error, error_size, "cannot open bus '%s': %s", bus, strerror(-result));
	return result;
}

void can_close(struct can_port *port)
{
	port->ops->close(port);
}

static void count_traffic(struct can_port *port, const struct can_msg *msg)
{
	if (port->ops->refresh)
		return;
	port->traffic.frames++;
	port->traffic.bytes += msg->remote ? 0 : msg->len;
}

static bool bus_is_full(int result)
{
	return result == -ENOBUFS || result == -EAGAIN;
}

/* Sends one frame. After -ENOBUFS or -EAGAIN the caller keeps it; the next attempt is due at retry_at_us. */
static int send_now(struct can_port *port, const struct can_msg *msg, uint64_t now_us)
{
	int result = port->ops->send(port, msg);

	if (bus_is_full(result)) {
		uint32_t wait_us = port->backoff_us == 0 ? BACKOFF_MIN_US : port->backoff_us * 2;

		port->backoff_us = wait_us < BACKOFF_MAX_US ? wait_us : BACKOFF_MAX_US;
		port->retry_at_us = now_us + port->backoff_us;
		port->counters.tx_retries++;
		return result;
	}
	port->backoff_us = 0;
	if (result < 0) {
		port->counters.tx_dropped++;
		return result;
	}
	port->counters.tx++;
	count_traffic(port, msg);
	return 0;
}

static void drop_oldest(struct can_port *port)
{
	port->queue_head = (port->queue_head + 1) % CAN_QUEUE_LEN;
	port->queue_count--;
}

/* The i-th frame of the queue. */
static struct can_msg *waiting(struct can_port *port, size_t i)
{
	return &port->queue[(port->queue_head + i) % CAN_QUEUE_LEN];
}

static bool same_id(const struct can_msg *a, const struct can_msg *b)
{
	return a->id == b->id && a->extended == b->extended;
}

/* Whether a later frame of the queue has the same identifier. */
static bool superseded(struct can_port *port, size_t i)
{
	size_t k = i + 1;

	while (k < port->queue_count && !same_id(waiting(port, k), waiting(port, i)))
		k++;
	return k < port->queue_count;
}

/* Drops the oldest frame with the same identifier, whose value is superseded; if there is none, the oldest one that
 * another frame of the queue supersedes; if there is none, the oldest of all. So neither PDOs nor a heartbeat
 * displaces an EMCY. */
static void make_room(struct can_port *port, const struct can_msg *msg)
{
	size_t i = 0;

	while (i < port->queue_count && !same_id(waiting(port, i), msg))
		i++;
	if (i == port->queue_count)
		for (i = 0; i < port->queue_count && !superseded(port, i);)
			i++;
	for (i %= port->queue_count; i > 0; i--)
		*waiting(port, i) = *waiting(port, i - 1);
	drop_oldest(port);
	port->counters.tx_dropped++;
}

/* The newest value of a device matters most, and an SDO client repeats a request whose response was lost. */
static void enqueue(struct can_port *port, const struct can_msg *msg)
{
	if (port->queue_count == CAN_QUEUE_LEN)
		make_room(port, msg);
	*waiting(port, port->queue_count++) = *msg;
}

static void flush(struct can_port *port, uint64_t now_us)
{
	if (now_us < port->retry_at_us)
		return;
	while (port->queue_count > 0) {
		if (bus_is_full(send_now(port, &port->queue[port->queue_head], now_us)))
			return;
		drop_oldest(port);
	}
}

int can_send(struct can_port *port, const struct can_msg *msg, uint64_t now_us)
{
	assert(msg->len <= 8);
	flush(port, now_us);
	if (port->queue_count == 0) {
		int result = send_now(port, msg, now_us);

		if (!bus_is_full(result))
			return result;
	}
	enqueue(port, msg);
	return 0;
}

int can_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	int result = port->ops->receive(port, msg, now_us);

	if (result > 0) {
		port->counters.rx++;
		count_traffic(port, msg);
	}
	return result;
}

int can_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	return port->ops->filter(port, ids, n);
}

int can_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	return port->ops->bit_rate ? port->ops->bit_rate(port, bit_s, dry_run) : -EOPNOTSUPP;
}

void can_refresh(struct can_port *port)
{
	if (port->ops->refresh)
		port->ops->refresh(port);
}

int can_restart(struct can_port *port)
{
	return port->ops->restart ? port->ops->restart(port) : -EOPNOTSUPP;
}

uint64_t can_service(struct can_port *port, uint64_t now_us)
{
	uint64_t next = port->ops->service == NULL ? UINT64_MAX : port->ops->service(port, now_us);

	flush(port, now_us);
	if (port->queue_count > 0 && port->retry_at_us < next)
		next = port->retry_at_us;
	return next;
}

#include "drivers/can/socketcan.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <net/if_arp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "drivers/can/can_link.h"
#include "drivers/can/error_frame.h"
#include "drivers/can/rx_socket.h"

enum { LOOK_AGAIN_US = 200000 }; /* for an interface that is down or gone */

struct socketcan {
	struct can_port port;
	struct rx_socket rx; /* rx.fd is port.fd */
	int interface;	     /* the index that it is bound to; 0: the interface is gone */
	uint64_t look_at_us;
	struct can_filter filters[CAN_RAW_FILTER_MAX];
	size_t filter_count; /* 0: all */
};

static struct socketcan *of(struct can_port *port)
{
	return (struct socketcan *)(void *)port;
}

/* Updates the state when the interface is down or gone; service() then searches for it. Returns -error. */
static int note_error(struct socketcan *can, int error)
{
	if (error == ENETDOWN || error == ENODEV || error == ENXIO)
		can->port.state = CAN_STATE_DOWN;
	if (error == ENODEV || error == ENXIO)
		can->interface = 0;
	return -error;
}

static int socketcan_send(struct can_port *port, const struct can_msg *msg)
{
	struct can_frame frame = {.can_id = msg->id, .can_dlc = msg->len};

	if (msg->extended)
		frame.can_id |= CAN_EFF_FLAG;
	if (msg->remote)
		frame.can_id |= CAN_RTR_FLAG;
	else
		memcpy(frame.data, msg->data, msg->len);
	if (write(of(port)->rx.fd, &frame, sizeof(frame)) < 0)
		return note_error(of(port), errno);
	return 0;
}

static void get_frame(const struct can_frame *frame, uint64_t t_us, struct can_msg *msg)
{
	msg->extended = (frame->can_id & CAN_EFF_FLAG) != 0;
	msg->remote = (frame->can_id & CAN_RTR_FLAG) != 0;
	msg->id = frame->can_id & (msg->extended ? CAN_EFF_MASK : CAN_SFF_MASK);
	msg->len = frame->can_dlc;
	memcpy(msg->data, frame->data, sizeof(msg->data));
	msg->t_us = t_us;
}

static int socketcan_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	struct socketcan *can = of(port);
	const struct rx_datagram *datagram;
	struct can_frame frame;

	for (unsigned n = 0; rx_socket_may_read(&can->rx, n); n++) {
		int result = rx_socket_receive(&can->rx, &datagram, now_us, &port->counters.rx_dropped);

		if (result < 0)
			return note_error(can, -result);
		if (result == 0)
			return 0;
		memcpy(&frame, datagram->data, sizeof(frame)); /* the buffer is longer */
		if (datagram->size != sizeof(frame) || frame.can_dlc > CAN_MAX_DLEN) {
			port->counters.rx_dropped++;
		} else if ((frame.can_id & CAN_ERR_FLAG) != 0) {
			can_error_frame(port, frame.can_id, frame.data);
		} else {
			get_frame(&frame, datagram->t_us, msg);
			return 1;
		}
	}
	return 0;
}

static int apply_filters(const struct socketcan *can)
{
	static const struct can_filter all = {0, 0};
	const struct can_filter *filters = can->filter_count > 0 ? can->filters : &all;
	size_t count = can->filter_count > 0 ? can->filter_count : 1;

	if (setsockopt(can->rx.fd, SOL_CAN_RAW, CAN_RAW_FILTER, filters, (socklen_t)(count * sizeof(*filters))) != 0)
		return -errno;
	return 0;
}

static int socketcan_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	struct socketcan *can = of(port);

	can->filter_count = n <= CAN_RAW_FILTER_MAX ? n : 0;
	for (size_t i = 0; i < can->filter_count; i++) {
		can->filters[i].can_id = ids[i];
		can->filters[i].can_mask = CAN_SFF_MASK | CAN_EFF_FLAG; /* data and remote frames */
	}
	return apply_filters(can);
}

/* The index of a CAN interface that is up, or -ENODEV, -ENETDOWN, -EMEDIUMTYPE. */
static int find_interface(const char *name, int fd)
{
	struct ifreq request = {0};

	snprintf(request.ifr_name, sizeof(request.ifr_name), "%s", name);
	if (ioctl(fd, SIOCGIFHWADDR, &request) != 0)
		return -errno;
	if (request.ifr_hwaddr.sa_family != ARPHRD_CAN)
		return -EMEDIUMTYPE;
	if (ioctl(fd, SIOCGIFFLAGS, &request) != 0)
		return -errno;
	if ((request.ifr_flags & IFF_UP) == 0)
		return -ENETDOWN;
	if (ioctl(fd, SIOCGIFINDEX, &request) != 0)
		return -errno;
	return request.ifr_ifindex;
}

/* An interface that went down leaves an error on the socket, which makes the next call fail. Reading clears it. */
static void forget_error(const struct socketcan *can)
{
	int error;
	socklen_t size = sizeof(error);

	(void)getsockopt(can->rx.fd, SOL_SOCKET, SO_ERROR, &error, &size);
}

/* Binds the socket to the interface that has the name now, also after another one: the kernel has forgotten the filters
 * of an interface that was removed. 0 or -errno. */
static int attach(struct socketcan *can)
{
	int interface = find_interface(can->port.name, can->rx.fd);
	struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = interface};

	if (interface < 0)
		return interface;
	int result = apply_filters(can);
	if (result < 0)
		return result;
	forget_error(can);
	if (bind(can->rx.fd, (struct sockaddr *)&address, sizeof(address)) != 0)
		return -errno;
	can->interface = interface;
	return 0;
}

static int open_socket(struct socketcan *can)
{
	const can_err_mask_t errors = CAN_ERR_MASK;
	int fd = socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);

	can->port.fd = fd;
	can->rx = (struct rx_socket){.fd = fd};
	if (fd < 0)
		return -errno;
	int result = rx_socket_prepare(fd);
	if (result == 0 && setsockopt(fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof(errors)) != 0)
		result = -errno;
	return result < 0 ? result : attach(can);
}

/* Error frames report a change of state at once; this covers the state before the socket was opened, and drivers
 * without error frames. service() handles an interface that is down. */
static void socketcan_refresh(struct can_port *port)
{
	struct can_link link;

	if (can_link_look(of(port)->interface, &link) < 0)
		return;
	port->traffic = (struct can_traffic){link.frames, link.bytes};
	if (!link.controller)
		return;
	port->bit_s = link.bit_s;
	port->tx_errors = (uint8_t)(link.tx_errors < UINT8_MAX ? link.tx_errors : UINT8_MAX);
	port->rx_errors = (uint8_t)(link.rx_errors < UINT8_MAX ? link.rx_errors : UINT8_MAX);
	if (port->state == CAN_STATE_DOWN || link.state > CAN_STATE_BUS_OFF)
		return;
	if (link.state == CAN_STATE_BUS_OFF && port->state != CAN_STATE_BUS_OFF)
		port->counters.bus_off++;
	port->state = (enum can_state)link.state;
}

static uint64_t socketcan_service(struct can_port *port, uint64_t now_us)
{
	struct socketcan *can = of(port);

	if (port->state != CAN_STATE_DOWN)
		return UINT64_MAX;
	if (now_us >= can->look_at_us) {
		can->look_at_us = now_us + LOOK_AGAIN_US;
		if (find_interface(port->name, can->rx.fd) == can->interface || attach(can) == 0) {
			port->state = CAN_STATE_ACTIVE;
			socketcan_refresh(port);
			return UINT64_MAX;
		}
	}
	return can->look_at_us;
}

static void socketcan_close(struct can_port *port)
{
	if (port->fd >= 0)
		close(port->fd);
	free(of(port));
}

/* The interface is down meanwhile. */
static int socketcan_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	int result = can_link_bit_rate(of(port)->interface, bit_s, dry_run);

	if (result < 0 || dry_run)
		return result;
	forget_error(of(port));
	port->bit_s = bit_s;
	return 0;
}

static int socketcan_restart(struct can_port *port)
{
	int result = can_link_restart(of(port)->interface);

	if (result == 0)
		port->state = CAN_STATE_ACTIVE;
	return result;
}

static const struct can_ops socketcan_ops = {
	.send = socketcan_send,
	.receive = socketcan_receive,
	.filter = socketcan_filter,
	.service = socketcan_service,
	.bit_rate = socketcan_bit_rate,
	.refresh = socketcan_refresh,
	.restart = socketcan_restart,
	.close = socketcan_close,
};

static void explain(int result, const char *name, char *error, size_t error_size)
{
	switch (result) {
	case -ENODEV:
		snprintf(error, error_size,
			"no CAN interface %s: plug its adapter in, or create a virtual one: `ip link add dev %s type "
			"vcan && "
			"ip link set %s up`, or use the bus `udp`",
			name, name, name);
		break;
	case -EMEDIUMTYPE:
		snprintf(error, error_size,
			"%s is not a CAN interface: `ip -brief link show type can` (or vcan) lists them", name);
		break;
	case -ENETDOWN:
		snprintf(error, error_size,
			"interface %s is down: `ip link set %s up` (with a controller: `ip link set %s up "
			"type can bitrate 500000`)",
			name, name, name);
		break;
	case -EAFNOSUPPORT:
	case -EPROTONOSUPPORT:
		snprintf(error, error_size,
			"cannot open %s: this kernel has no SocketCAN: `modprobe can_raw`, or use the bus `udp`", name);
		break;
	default:
		snprintf(error, error_size, "cannot open CAN interface %s: %s", name, strerror(-result));
	}
}

int can_socketcan_open(const char *interface, struct can_port **port, char *error, size_t error_size)
{
	struct socketcan *can;
	int result;

	if (strlen(interface) >= IFNAMSIZ) {
		snprintf(error, error_size, "'%.60s' is too long for an interface name: use at most %d characters",
			interface, IFNAMSIZ - 1);
		return -EINVAL;
	}
	if (port == NULL)
		return 0;
	can = calloc(1, sizeof(*can));
	if (can == NULL)
		return -ENOMEM;
	can->port.ops = &socketcan_ops;
	snprintf(can->port.name, sizeof(can->port.name), "%s", interface);
	result = open_socket(can);
	if (result < 0) {
		explain(result, interface, error, error_size);
		socketcan_close(&can->port);
		return result;
	}
	socketcan_refresh(&can->port); /* the controller may be passive already, which no error frame reports */
	*port = &can->port;
	return 0;
}

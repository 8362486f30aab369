#include "drivers/can/udp.h"

#include <arpa/inet.h>
#include <errno.h>
#include <linux/filter.h>
#include <net/if.h>
#include <netinet/in.h>
#include <netinet/udp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "drivers/can/id_filter.h"
#include "drivers/can/rx_socket.h"
#include "drivers/can/udp_codec.h"

union address {
	struct sockaddr any;
	struct sockaddr_in v4;
	struct sockaddr_in6 v6;
};

struct udp {
	struct can_port port;
	struct rx_socket rx; /* rx.fd is port.fd */
	int sender;	     /* its source port identifies this port's own datagrams */
	union address group;
	struct id_filter filter;
};

static struct udp *of(struct can_port *port)
{
	return (struct udp *)(void *)port;
}

static socklen_t address_size(const union address *address)
{
	return address->any.sa_family == AF_INET ? sizeof(address->v4) : sizeof(address->v6);
}

static int udp_send(struct can_port *port, const struct can_msg *msg)
{
	const struct udp *udp = of(port);
	char datagram[CAN_UDP_MAX];
	size_t size = can_udp_encode(msg, datagram);

	if (sendto(udp->sender, datagram, size, MSG_DONTWAIT, &udp->group.any, address_size(&udp->group)) < 0) {
		int error = errno;

		if (error == ENETUNREACH || error == ENETDOWN || error == ENODEV)
			port->state = CAN_STATE_DOWN;
		return -error;
	}
	port->state = CAN_STATE_ACTIVE;
	return 0;
}

static int udp_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	struct udp *udp = of(port);
	const struct rx_datagram *datagram;

	for (unsigned n = 0; rx_socket_may_read(&udp->rx, n); n++) {
		int result = rx_socket_receive(&udp->rx, &datagram, now_us, &port->counters.rx_dropped);

		if (result <= 0)
			return result;
		if (datagram->size == 0)
			continue; /* own */
		msg->t_us = datagram->t_us;
		if (datagram->size > sizeof(datagram->data) || can_udp_decode(datagram->data, datagram->size, msg) < 0)
			port->counters.rx_dropped++;
		else if (id_filter_wants(&udp->filter, msg))
			return 1;
	}
	return 0;
}

static int udp_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	id_filter_set(&of(port)->filter, ids, n);
	return 0;
}

static void udp_close(struct can_port *port)
{
	struct udp *udp = of(port);

	if (udp->sender >= 0)
		close(udp->sender);
	if (port->fd >= 0)
		close(port->fd);
	free(udp);
}

static const struct can_ops udp_ops = {
	.send = udp_send,
	.receive = udp_receive,
	.filter = udp_filter,
	.close = udp_close,
};

/* "GROUP", "GROUP:PORT", "[GROUP6]:PORT", "GROUP6", "" */
static bool split(const char *text, char group[INET6_ADDRSTRLEN], const char **port)
{
	const char *start = text, *end;

	if (text[0] == '[') {
		start = text + 1;
		end = strchr(start, ']');
		if (end == NULL || (end[1] != '\0' && end[1] != ':'))
			return false;
		*port = end[1] == ':' ? end + 2 : NULL;
	} else {
		const char *colon = strchr(text, ':');
		bool v6 = colon != NULL && strchr(colon + 1, ':') != NULL;

		end = colon == NULL || v6 ? text + strlen(text) : colon;
		*port = colon == NULL || v6 ? NULL : colon + 1;
	}
	if (end - start >= INET6_ADDRSTRLEN)
		return false;
	snprintf(group, INET6_ADDRSTRLEN, "%.*s", (int)(end - start), start);
	return true;
}

static bool parse_port(const char *text, uint16_t *port)
{
	char *end;
	unsigned long value;

	value = strtoul(text, &end, 10);
	if (text[0] < '0' || text[0] > '9' || *end != '\0' || value == 0 || value > 65535)
		return false;
	*port = (uint16_t)value;
	return true;
}

static bool parse(const char *text, union address *address)
{
	char group[INET6_ADDRSTRLEN];
	const char *port_text;
	uint16_t port;

	if (!split(text, group, &port_text) || !parse_port(port_text ? port_text : CAN_UDP_PORT, &port))
		return false;
	memset(address, 0, sizeof(*address));
	if (group[0] == '\0')
		snprintf(group, sizeof(group), "%s", CAN_UDP_GROUP);
	if (inet_pton(AF_INET, group, &address->v4.sin_addr) == 1) {
		address->v4.sin_family = AF_INET;
		address->v4.sin_port = htons(port);
		return IN_MULTICAST(ntohl(address->v4.sin_addr.s_addr));
	}
	address->v6.sin6_family = AF_INET6;
	address->v6.sin6_port = htons(port);
	return inet_pton(AF_INET6, group, &address->v6.sin6_addr) == 1 && IN6_IS_ADDR_MULTICAST(&address->v6.sin6_addr);
}

static int set(int fd, int level, int option, const void *value, size_t size)
{
	return setsockopt(fd, level, option, value, (socklen_t)size) == 0 ? 0 : -errno;
}

static int set_int(int fd, int level, int option, int value)
{
	return set(fd, level, option, &value, sizeof(value));
}

/* Interface 0 is the one the kernel routes the group to. */
static int join(int fd, const union address *group, unsigned interface)
{
	struct group_req request = {.gr_interface = interface};
	int level = group->any.sa_family == AF_INET ? IPPROTO_IP : IPPROTO_IPV6;

	memcpy(&request.gr_group, group, sizeof(*group));
	return set(fd, level, MCAST_JOIN_GROUP, &request, sizeof(request));
}

static int send_through(int fd, const union address *group, unsigned interface)
{
	struct ip_mreqn request = {.imr_ifindex = (int)interface};

	if (group->any.sa_family == AF_INET)
		return set(fd, IPPROTO_IP, IP_MULTICAST_IF, &request, sizeof(request));
	return set_int(fd, IPPROTO_IPV6, IPV6_MULTICAST_IF, (int)interface);
}

/* A socket with its own source port. The kernel's defaults: multicasts go one hop and are looped back to this host. */
static int open_sender(const union address *group)
{
	union address own = {.any.sa_family = group->any.sa_family};
	int fd = socket(own.any.sa_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
	int result;

	if (fd >= 0 && bind(fd, &own.any, address_size(&own)) == 0)
		return fd;
	result = -errno;
	if (fd >= 0)
		close(fd);
	return result;
}

/* Attaches a filter that truncates own datagrams to the UDP header, so that they are received empty. (Rejected ones
 * would be counted as dropped in SO_RXQ_OVFL.) Own datagrams have the source port of `sender` and were sent by this
 * host: they are looped back (PACKET_LOOPBACK) or were received through the loopback interface. */
static int truncate_own(int fd, int sender)
{
	union address own = {0};
	socklen_t size = sizeof(own);
	struct sock_filter code[] = {
		BPF_STMT(BPF_LD | BPF_H | BPF_ABS, 0), /* source port: the UDP header comes first */
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 0, 0, 4),
		BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (uint32_t)(SKF_AD_OFF + SKF_AD_PKTTYPE)),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 5 /* PACKET_LOOPBACK */, 3, 0),
		BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (uint32_t)(SKF_AD_OFF + SKF_AD_IFINDEX)),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, if_nametoindex("lo"), 1, 0),
		BPF_STMT(BPF_RET | BPF_K, UINT32_MAX), /* keep */
		BPF_STMT(BPF_RET | BPF_K, sizeof(struct udphdr)),
	};
	const struct sock_fprog program = {sizeof(code) / sizeof(code[0]), code};

	if (getsockname(sender, &own.any, &size) != 0)
		return -errno;
	code[1].k = ntohs(own.any.sa_family == AF_INET ? own.v4.sin_port : own.v6.sin6_port);
	return set(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program));
}

/* Bound to the group, so that unicast datagrams and those of other groups are not received. */
static int open_receiver(const union address *group, int sender)
{
	int fd = socket(group->any.sa_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
	int result;

	if (fd < 0)
		return -errno;
	result = rx_socket_prepare(fd);
	if (result == 0)
		result = truncate_own(fd, sender);
	if (result == 0)
		result = set_int(fd, SOL_SOCKET, SO_REUSEADDR, 1);
	if (result == 0 && bind(fd, &group->any, address_size(group)) != 0)
		result = -errno;
	if (result < 0) {
		close(fd);
		return result;
	}
	return fd;
}

static int open_sockets(struct udp *udp)
{
	unsigned loopback = if_nametoindex("lo");
	int result;

	udp->sender = open_sender(&udp->group);
	if (udp->sender < 0)
		return udp->sender;
	udp->port.fd = open_receiver(&udp->group, udp->sender);
	if (udp->port.fd < 0)
		return udp->port.fd;
	udp->rx.fd = udp->port.fd;
	result = join(udp->port.fd, &udp->group, 0);
	if (result == 0)
		return 0;
	/* no route to the group, e.g. in a container without a network */
	result = join(udp->port.fd, &udp->group, loopback);
	return result < 0 ? result : send_through(udp->sender, &udp->group, loopback);
}

int can_udp_open(const char *address, struct can_port **port, char *error, size_t error_size)
{
	union address group;
	struct udp *udp;
	int result;

	if (!parse(address, &group)) {
		snprintf(error, error_size,
			"bad bus 'udp:%s': use " CAN_UDP_SYNTAX " with a multicast group, e.g. udp:" CAN_UDP_GROUP
			":" CAN_UDP_PORT " or udp:[ff15::1]:" CAN_UDP_PORT,
			address);
		return -EINVAL;
	}
	udp = calloc(1, sizeof(*udp));
	if (udp == NULL)
		return -ENOMEM;
	udp->port.ops = &udp_ops;
	udp->port.fd = udp->sender = -1;
	udp->group = group;
	snprintf(udp->port.name, sizeof(udp->port.name), address[0] == '\0' ? "udp" : "udp:%s", address);
	result = open_sockets(udp);
	if (result < 0) {
		snprintf(error, error_size,
			"cannot open bus '%s': %s: check that this host has a network interface with multicast",
			udp->port.name, strerror(-result));
		udp_close(&udp->port);
		return result;
	}
	*port = &udp->port;
	return 0;
}

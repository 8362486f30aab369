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
	unsigned interface; /* of the option; 0: the one the kernel routes the group to */
	struct hosts {
		enum { HOSTS_OWN, HOSTS_NETWORK, HOSTS_ANY } kind;
		uint32_t address[4], mask[4]; /* HOSTS_NETWORK; of IPv4 the first word; host byte order */
	} hosts;
	bool foreign_told;
	struct id_filter filter;
};

/* What the filter of the socket leaves of a datagram that is not taken. (One that it rejects would be counted as
 * dropped, in SO_RXQ_OVFL.) */
enum { OWN_BYTES = 0, FOREIGN_BYTES = 1 };

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

		if (error == ENETUNREACH || error == ENETDOWN || error == ENODEV) {
			port->down_why = "the network of the group is down (ip route get ...)";
			port->state = CAN_STATE_DOWN;
		}
		return -error;
	}
	port->state = CAN_STATE_ACTIVE;
	return 0;
}

static void tell_foreign(struct udp *udp)
{
	if (!udp->foreign_told)
		udp->port.notice = "another host sends to the group and is not heard: the bus option hosts=any or "
				   "hosts=NETWORK/BITS would take its frames";
	udp->foreign_told = true;
}

static int udp_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	struct udp *udp = of(port);
	const struct rx_datagram *datagram;

	for (unsigned n = 0; rx_socket_may_read(&udp->rx, n); n++) {
		int result = rx_socket_receive(&udp->rx, &datagram, now_us, &port->counters.rx_dropped);

		if (result <= 0)
			return result;
		if (datagram->size == OWN_BYTES)
			continue;
		if (datagram->size == FOREIGN_BYTES) {
			tell_foreign(udp);
			continue;
		}
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

static bool parse_group(const char *text, union address *address)
{
	char group[INET6_ADDRSTRLEN];
	const char *port_text;
	uint16_t port;

	if (!split(text, group, &port_text) || !parse_port(port_text ? port_text : CAN_UDP_PORT, &port))
		return false;
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

static void to_words(int family, const void *address, uint32_t words[4])
{
	uint32_t wire[4] = {0};

	memcpy(wire, address, family == AF_INET ? 4 : 16);
	for (int i = 0; i < 4; i++)
		words[i] = ntohl(wire[i]);
}

/* "any", ADDRESS or ADDRESS/BITS of the family of the group */
static bool parse_hosts(const char *text, int family, struct hosts *hosts)
{
	char copy[INET6_ADDRSTRLEN], *bits_text = copy, *end;
	unsigned long bits = family == AF_INET ? 32 : 128, max = bits;
	uint8_t address[16];

	*hosts = (struct hosts){.kind = strcmp(text, "any") == 0 ? HOSTS_ANY : HOSTS_NETWORK};
	if (hosts->kind == HOSTS_ANY)
		return true;
	if (strlen(text) >= sizeof(copy))
		return false;
	strcpy(copy, text);
	strsep(&bits_text, "/");
	if (bits_text) {
		bits = strtoul(bits_text, &end, 10);
		if (bits_text[0] < '0' || bits_text[0] > '9' || *end != '\0' || bits > max)
			return false;
	}
	if (inet_pton(family, copy, address) != 1)
		return false;
	to_words(family, address, hosts->address);
	for (unsigned long bit = 0; bit < bits; bit++)
		hosts->mask[bit / 32] |= 0x80000000u >> bit % 32;
	for (int i = 0; i < 4; i++)
		hosts->address[i] &= hosts->mask[i];
	return true;
}

/* GROUP[:PORT][,interface=NAME][,hosts=HOSTS]; `bad`: the part that is wrong. 0, -EINVAL, -ENODEV: no such
 * interface. */
static int parse(struct udp *udp, char *text, const char **bad)
{
	*bad = strsep(&text, ",");
	if (!parse_group(*bad, &udp->group))
		return -EINVAL;
	while ((*bad = strsep(&text, ",")) != NULL) {
		if (strncmp(*bad, "interface=", 10) == 0) {
			udp->interface = if_nametoindex(*bad + 10);
			if (udp->interface == 0)
				return -ENODEV;
		} else if (strncmp(*bad, "hosts=", 6) != 0 ||
			   !parse_hosts(*bad + 6, udp->group.any.sa_family, &udp->hosts)) {
			return -EINVAL;
		}
	}
	return 0;
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

/* Without this the socket would receive what any process on this host has joined, on any interface: the frames of other
 * networks, and doubled ones where two of them reach the sender. */
static int own_memberships_only(int fd, int family)
{
	return family == AF_INET ? set_int(fd, IPPROTO_IP, IP_MULTICAST_ALL, 0)
				 : set_int(fd, IPPROTO_IPV6, IPV6_MULTICAST_ALL, 0);
}

/* A socket with its own source port. The kernel's defaults: multicasts go one hop and are looped back to this host. The
 * kernel chooses a port that no socket has; from then on, others may open a bus of that port, of which this socket, in
 * no group, receives nothing. */
static int open_sender(const union address *group)
{
	union address own = {.any.sa_family = group->any.sa_family};
	int fd = socket(own.any.sa_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
	int result;

	if (fd < 0)
		return -errno;
	result = own_memberships_only(fd, own.any.sa_family);
	if (result == 0 && bind(fd, &own.any, address_size(&own)) != 0)
		result = -errno;
	if (result == 0)
		result = set_int(fd, SOL_SOCKET, SO_REUSEADDR, 1);
	if (result < 0) {
		close(fd);
		return result;
	}
	return fd;
}

/* ---- the filter of the receiving socket -------------------------------------------------------------------------- */

enum { FILTER_MAX = 32, NEXT = 0, TO_FOREIGN = 0xF0, TO_OWN, TO_KEEP }; /* jumps to the ends of the filter */

struct filter {
	struct sock_filter code[FILTER_MAX];
	unsigned short length;
};

static void load(struct filter *f, uint16_t size, uint32_t offset)
{
	f->code[f->length++] = (struct sock_filter)BPF_STMT(BPF_LD | size | BPF_ABS, offset);
}

/* Ends with the first `bytes` of the datagram. */
static void finish(struct filter *f, uint32_t bytes)
{
	f->code[f->length++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, bytes);
}

static void jump_if(struct filter *f, uint32_t value, uint8_t equal, uint8_t other)
{
	f->code[f->length++] = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, value, equal, other);
}

/* This host sent it: it was looped back (PACKET_LOOPBACK), or received through the loopback interface. */
static void jump_if_of_this_host(struct filter *f, uint8_t to)
{
	load(f, BPF_W, (uint32_t)(SKF_AD_OFF + SKF_AD_PKTTYPE));
	jump_if(f, 5 /* PACKET_LOOPBACK */, to, NEXT);
	load(f, BPF_W, (uint32_t)(SKF_AD_OFF + SKF_AD_IFINDEX));
	jump_if(f, if_nametoindex("lo"), to, NEXT);
}

/* Source address: from byte 12 of the header of IPv4, 8 of that of IPv6. */
static void keep_network(struct filter *f, const struct hosts *hosts, int family)
{
	uint32_t at = (uint32_t)SKF_NET_OFF + (family == AF_INET ? 12 : 8);

	int last = family == AF_INET ? 0 : 3;

	for (int i = 0; i <= last; i++) {
		load(f, BPF_W, at + 4 * (uint32_t)i);
		f->code[f->length++] = (struct sock_filter)BPF_STMT(BPF_ALU | BPF_AND | BPF_K, hosts->mask[i]);
		jump_if(f, hosts->address[i], i < last ? NEXT : TO_KEEP, TO_FOREIGN);
	}
}

/* Appends the ends, the first of which is reached without a jump, and completes the jumps to them. */
static void end_filter(struct filter *f)
{
	const unsigned short first = f->length;

	for (unsigned short i = 0; i < first; i++) {
		struct sock_filter *c = &f->code[i];

		if (BPF_CLASS(c->code) != BPF_JMP)
			continue;
		c->jt = c->jt >= TO_FOREIGN ? (uint8_t)(first + c->jt - TO_FOREIGN - i - 1) : c->jt;
		c->jf = c->jf >= TO_FOREIGN ? (uint8_t)(first + c->jf - TO_FOREIGN - i - 1) : c->jf;
	}
	finish(f, sizeof(struct udphdr) + FOREIGN_BYTES);
	finish(f, sizeof(struct udphdr) + OWN_BYTES);
	finish(f, UINT32_MAX);
}

/* Own datagrams have the source port of `sender` and are of this host. */
static int attach_filter(const struct udp *udp, int fd)
{
	union address own = {0};
	socklen_t size = sizeof(own);
	struct filter f = {.length = 0};
	int family = udp->group.any.sa_family;

	if (getsockname(udp->sender, &own.any, &size) != 0)
		return -errno;
	load(&f, BPF_H, 0); /* source port: the UDP header comes first */
	jump_if(&f, ntohs(family == AF_INET ? own.v4.sin_port : own.v6.sin6_port), NEXT, 4);
	jump_if_of_this_host(&f, TO_OWN);
	if (udp->hosts.kind != HOSTS_ANY)
		jump_if_of_this_host(&f, TO_KEEP);
	if (udp->hosts.kind == HOSTS_NETWORK)
		keep_network(&f, &udp->hosts, family);
	if (udp->hosts.kind == HOSTS_ANY)
		finish(&f, UINT32_MAX);
	end_filter(&f);
	const struct sock_fprog program = {f.length, f.code};
	return set(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program));
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

/* Bound to the group, so that unicast datagrams and those of other groups are not received. */
static int open_receiver(const struct udp *udp)
{
	const union address *group = &udp->group;
	int fd = socket(group->any.sa_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
	int result;

	if (fd < 0)
		return -errno;
	result = rx_socket_prepare(fd);
	if (result == 0)
		result = attach_filter(udp, fd);
	if (result == 0)
		result = own_memberships_only(fd, group->any.sa_family);
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

static int join_through(const struct udp *udp, unsigned interface)
{
	int result = join(udp->port.fd, &udp->group, interface);

	return result < 0 ? result : send_through(udp->sender, &udp->group, interface);
}

static int open_sockets(struct udp *udp)
{
	udp->sender = open_sender(&udp->group);
	if (udp->sender < 0)
		return udp->sender;
	udp->port.fd = open_receiver(udp);
	if (udp->port.fd < 0)
		return udp->port.fd;
	udp->rx.fd = udp->port.fd;
	if (udp->interface)
		return join_through(udp, udp->interface);
	if (join(udp->port.fd, &udp->group, 0) == 0)
		return 0;
	/* no route to the group, e.g. in a container without a network */
	return join_through(udp, if_nametoindex("lo"));
}

/* `bad`: the part of the address that is wrong, or NULL. */
static void explain(int result, const char *address, const char *bad, char *error, size_t error_size)
{
	if (result == -ENODEV && bad)
		snprintf(error, error_size, "no network interface '%s': `ip -brief link` lists them",
			bad + strlen("interface="));
	else if (bad && strchr(bad, '='))
		snprintf(error, error_size,
			"bad option '%s' of bus udp: use interface=NAME, hosts=any, or hosts= with an address or "
			"network "
			"of the kind of the group, like 192.168.1.0/24",
			bad);
	else if (bad)
		snprintf(error, error_size,
			"bad bus 'udp:%s': use udp[:GROUP[:PORT]][,OPTION] with a multicast group, e.g. "
			"udp:" CAN_UDP_GROUP ":" CAN_UDP_PORT " or udp:[ff15::1]:" CAN_UDP_PORT,
			address);
	else if (result == -EAFNOSUPPORT)
		snprintf(error, error_size,
			"cannot open bus 'udp:%s': IP is not permitted here: a service needs the drop-in udp.conf",
			address);
	else if (result == -EADDRINUSE)
		snprintf(error, error_size,
			"cannot open bus 'udp:%s': another program has its UDP port for itself (`ss -uapn` shows "
			"which): "
			"end that, or use another port, udp:GROUP:PORT",
			address);
	else
		snprintf(error, error_size,
			"cannot open bus 'udp:%s': %s: check that this host has a network interface with multicast",
			address, strerror(-result));
}

static const char *who_may_write(const struct hosts *hosts)
{
	switch (hosts->kind) {
	case HOSTS_ANY:
		return "frames of every host that reaches the group are taken; any of them can configure this node";
	case HOSTS_NETWORK:
		return "frames of this host and of the hosts of the option are taken";
	case HOSTS_OWN:
		break;
	}
	return "only frames of this host are taken; the bus option hosts=any or hosts=NETWORK/BITS admits others";
}

int can_udp_open(const char *address, struct can_port **port, char *error, size_t error_size)
{
	char copy[256];
	const char *bad = address;
	struct udp *udp;
	int result;

	udp = calloc(1, sizeof(*udp));
	if (udp == NULL)
		return -ENOMEM;
	udp->port.ops = &udp_ops;
	udp->port.fd = udp->sender = -1;
	snprintf(udp->port.name, sizeof(udp->port.name), address[0] == '\0' ? "udp" : "udp:%s", address);
	snprintf(copy, sizeof(copy), "%s", address);
	result = strlen(address) < sizeof(copy) ? parse(udp, copy, &bad) : -EINVAL;
	if (port == NULL && result == -ENODEV)
		result = 0; /* the interface may appear later */
	else if (port != NULL && result == 0)
		result = open_sockets(udp);
	if (result < 0)
		explain(result, address, bad, error, error_size);
	if (result < 0 || port == NULL) {
		udp_close(&udp->port);
		return result;
	}
	udp->port.notice = who_may_write(&udp->hosts);
	*port = &udp->port;
	return 0;
}

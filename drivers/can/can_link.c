#include "drivers/can/can_link.h"

#include <errno.h>
#include <linux/can/netlink.h>
#include <linux/capability.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "drivers/can/gs_usb_timing.h"

enum { ANSWER_MAX = 16384 };

/* ---- netlink: one request, one answer ---------------------------------------------------------------------------- */

struct request {
	struct nlmsghdr header;
	struct ifinfomsg link;
	char attributes[256];
};

static struct request request_of(uint16_t type, uint16_t flags, int interface)
{
	return (struct request){
		.header = {.nlmsg_len = NLMSG_LENGTH(sizeof(struct ifinfomsg)),
			.nlmsg_type = type,
			.nlmsg_flags = (uint16_t)(NLM_F_REQUEST | flags)},
		.link = {.ifi_family = AF_UNSPEC, .ifi_index = interface},
	};
}

static struct rtattr *add(struct request *r, unsigned short type, const void *data, size_t size)
{
	struct rtattr *attribute = (struct rtattr *)((char *)r + NLMSG_ALIGN(r->header.nlmsg_len));

	attribute->rta_type = type;
	attribute->rta_len = (unsigned short)RTA_LENGTH(size);
	if (size > 0)
		memcpy(RTA_DATA(attribute), data, size);
	r->header.nlmsg_len = (uint32_t)(NLMSG_ALIGN(r->header.nlmsg_len) + RTA_ALIGN(attribute->rta_len));
	return attribute;
}

static void end_nested(const struct request *r, struct rtattr *outer)
{
	outer->rta_len = (unsigned short)((const char *)r + r->header.nlmsg_len - (const char *)outer);
}

/* The kernel has queued its answer when send() returns. The size of the answer, or -errno. */
static ssize_t request(const struct request *r, void *answer)
{
	int fd = socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE);
	ssize_t size = -1;

	if (fd >= 0 && send(fd, r, r->header.nlmsg_len, 0) >= 0)
		size = recv(fd, answer, ANSWER_MAX, MSG_DONTWAIT);
	int error = errno;
	if (fd >= 0)
		close(fd);
	return size < 0 ? -error : size;
}

/* Requests a change. 0, or the kernel's -errno. */
static int change(const struct request *r)
{
	_Alignas(struct nlmsghdr) char answer[ANSWER_MAX] = {0};
	const struct nlmsghdr *header = (const struct nlmsghdr *)(const void *)answer;
	ssize_t size = request(r, answer);

	if (size < 0)
		return (int)size;
	if (!NLMSG_OK(header, (size_t)size) || header->nlmsg_type != NLMSG_ERROR)
		return -EIO;
	return ((const struct nlmsgerr *)NLMSG_DATA(header))->error;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

/* The first attribute of this type in `size` bytes of attributes, or NULL. */
static const struct rtattr *find(const void *first, size_t size, unsigned short type)
{
	const char *at = first, *end = at + size;

	while (end - at >= (ptrdiff_t)sizeof(struct rtattr)) {
		const struct rtattr *attribute = (const void *)at;

		if (attribute->rta_len < sizeof(*attribute) || attribute->rta_len > end - at)
			break;
		if ((attribute->rta_type & NLA_TYPE_MASK) == type)
			return attribute;
		at += RTA_ALIGN(attribute->rta_len);
	}
	return NULL;
}

static const struct rtattr *find_in(const struct rtattr *outer, unsigned short type)
{
	return outer ? find(RTA_DATA(outer), RTA_PAYLOAD(outer), type) : NULL;
}

/* Copies as many bytes as kernel and this header both have, the rest is 0. The size of the attribute, 0: not there. */
static size_t copy(void *out, size_t size, const struct rtattr *attribute)
{
	size_t there = attribute ? RTA_PAYLOAD(attribute) : 0;

	memset(out, 0, size);
	if (there > 0)
		memcpy(out, RTA_DATA(attribute), there < size ? there : size);
	return there;
}

static void read_limits(struct can_link_limits *limits, const struct rtattr *data)
{
	struct can_bittiming_const c;
	struct can_clock clock;

	copy(&c, sizeof(c), find_in(data, IFLA_CAN_BITTIMING_CONST));
	copy(&clock, sizeof(clock), find_in(data, IFLA_CAN_CLOCK));
	*limits = (struct can_link_limits){
		clock.freq, c.brp_min, c.brp_max, c.brp_inc, c.tseg1_min, c.tseg1_max, c.tseg2_min, c.tseg2_max};
}

static void read_controller(struct can_link *link, const struct rtattr *data)
{
	struct can_bittiming timing;
	struct can_berr_counter errors;

	/* every controller reports its state; vcan does not */
	link->controller = copy(&link->state, sizeof(link->state), find_in(data, IFLA_CAN_STATE)) > 0;
	copy(&timing, sizeof(timing), find_in(data, IFLA_CAN_BITTIMING));
	copy(&errors, sizeof(errors), find_in(data, IFLA_CAN_BERR_COUNTER));
	copy(&link->restart_ms, sizeof(link->restart_ms), find_in(data, IFLA_CAN_RESTART_MS));
	read_limits(&link->limits, data);
	size_t rates = copy(link->rates, sizeof(link->rates), find_in(data, IFLA_CAN_BITRATE_CONST));
	link->bit_s = timing.bitrate;
	link->tx_errors = errors.txerr;
	link->rx_errors = errors.rxerr;
	link->rate_count = (rates < sizeof(link->rates) ? rates : sizeof(link->rates)) / sizeof(link->rates[0]);
}

static void read_link(struct can_link *link, const struct nlmsghdr *header)
{
	const void *first = IFLA_RTA(NLMSG_DATA(header));
	size_t size = IFLA_PAYLOAD(header);
	struct rtnl_link_stats64 stats;

	copy(&stats, sizeof(stats), find(first, size, IFLA_STATS64));
	read_controller(link, find_in(find(first, size, IFLA_LINKINFO), IFLA_INFO_DATA));
	/* vcan counts each frame in both directions */
	link->frames = stats.tx_packets + (link->controller ? stats.rx_packets : 0);
	link->bytes = stats.tx_bytes + (link->controller ? stats.rx_bytes : 0);
}

int can_link_look(int interface, struct can_link *link)
{
	_Alignas(struct nlmsghdr) char answer[ANSWER_MAX] = {0};
	const struct nlmsghdr *header = (const struct nlmsghdr *)(const void *)answer;
	const struct request r = request_of(RTM_GETLINK, 0, interface);
	ssize_t size = request(&r, answer);

	*link = (struct can_link){0};
	if (size < 0)
		return (int)size;
	if (!NLMSG_OK(header, (size_t)size))
		return -EIO;
	if (header->nlmsg_type == NLMSG_ERROR)
		return ((const struct nlmsgerr *)NLMSG_DATA(header))->error;
	if (header->nlmsg_len < NLMSG_LENGTH(sizeof(struct ifinfomsg)))
		return -EIO;
	read_link(link, header);
	return 0;
}

/* ---- changing ---------------------------------------------------------------------------------------------------- */

static bool permitted(void)
{
	struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
	struct __user_cap_data_struct data[_LINUX_CAPABILITY_U32S_3] = {0};

	if (syscall(SYS_capget, &header, data) != 0)
		return false;
	return (data[CAP_TO_INDEX(CAP_NET_ADMIN)].effective & CAP_TO_MASK(CAP_NET_ADMIN)) != 0;
}

static bool divides(const struct can_link_limits *limits, uint32_t bit_s)
{
	struct bit_timing timing;

	return bit_timing_find(limits, 0, bit_s, bit_timing_sample_point(bit_s), &timing) == 0;
}

bool can_link_has_rate(const struct can_link *link, uint32_t bit_s)
{
	if (!link->controller || bit_s == 0)
		return false;
	if (link->rate_count == 0)
		return link->limits.clock_hz == 0 ||
		       divides(&link->limits, bit_s); /* limits unknown: the kernel decides */
	for (size_t i = 0; i < link->rate_count; i++)
		if (link->rates[i] == bit_s)
			return true;
	return false;
}

static int switch_on(int interface, bool on)
{
	struct request r = request_of(RTM_NEWLINK, NLM_F_ACK, interface);

	r.link.ifi_change = IFF_UP;
	r.link.ifi_flags = on ? IFF_UP : 0;
	return change(&r);
}

/* Sets one attribute of the controller. */
static int set(int interface, unsigned short type, const void *data, size_t size)
{
	struct request r = request_of(RTM_NEWLINK, NLM_F_ACK, interface);
	struct rtattr *info = add(&r, IFLA_LINKINFO, NULL, 0);

	add(&r, IFLA_INFO_KIND, "can", 3);
	struct rtattr *inner = add(&r, IFLA_INFO_DATA, NULL, 0);
	add(&r, type, data, size);
	end_nested(&r, inner);
	end_nested(&r, info);
	return change(&r);
}

int can_link_bit_rate(int interface, uint32_t bit_s, bool dry_run)
{
	const struct can_bittiming timing = {.bitrate = bit_s}; /* the kernel finds the rest */
	struct can_link link;
	int result = can_link_look(interface, &link);

	if (result < 0)
		return result;
	if (!can_link_has_rate(&link, bit_s))
		return -EOPNOTSUPP;
	if (link.bit_s == bit_s)
		return 0;
	if (!permitted())
		return -EPERM;
	if (dry_run)
		return 0;
	result = switch_on(interface, false);
	if (result == 0)
		result = set(interface, IFLA_CAN_BITTIMING, &timing, sizeof(timing));
	int started = switch_on(interface, true);
	if (result < 0)
		return result == -EINVAL || result == -EDOM ? -EOPNOTSUPP : result;
	return started;
}

int can_link_restart(int interface)
{
	const uint32_t now = 1;
	struct can_link link;
	int result = can_link_look(interface, &link);

	if (result < 0)
		return result;
	if (!link.controller || link.restart_ms > 0)
		return -EOPNOTSUPP;
	return permitted() ? set(interface, IFLA_CAN_RESTART, &now, sizeof(now)) : -EPERM;
}

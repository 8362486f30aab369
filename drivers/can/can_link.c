#include "drivers/can/can_link.h"

#include <errno.h>
#include <libsocketcan.h>
#include <linux/capability.h>
#include <linux/if_link.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { PERMILLE_OFF = 5 };

static bool permitted(void)
{
	struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
	struct __user_cap_data_struct data[_LINUX_CAPABILITY_U32S_3] = {0};

	if (syscall(SYS_capget, &header, data) != 0)
		return false;
	return (data[CAP_TO_INDEX(CAP_NET_ADMIN)].effective & CAP_TO_MASK(CAP_NET_ADMIN)) != 0;
}

/* libsocketcan returns -1 with or without errno. */
static int result_of(int rc)
{
	if (rc == 0)
		return 0;
	return errno != 0 ? -errno : -EIO;
}

static uint8_t up_to_255(uint16_t count)
{
	return (uint8_t)(count < UINT8_MAX ? count : UINT8_MAX);
}

void can_link_look(const char *interface, struct can_link *link)
{
	struct can_bittiming timing = {0};
	struct can_berr_counter errors = {0};
	struct rtnl_link_stats64 stats = {0};

	*link = (struct can_link){0};
	link->controller = can_get_bittiming(interface, &timing) == 0 && can_get_state(interface, &link->state) == 0;
	if (can_get_link_stats(interface, &stats) == 0) {
		/* vcan counts each frame in both directions */
		link->frames = stats.tx_packets + (link->controller ? stats.rx_packets : 0);
		link->bytes = stats.tx_bytes + (link->controller ? stats.rx_bytes : 0);
	}
	if (!link->controller)
		return;
	link->bit_s = timing.bitrate;
	if (can_get_berr_counter(interface, &errors) == 0) {
		link->tx_errors = up_to_255(errors.txerr);
		link->rx_errors = up_to_255(errors.rxerr);
	}
}

bool can_link_divides(const struct can_link_limits *l, uint32_t bit_s)
{
	for (uint32_t brp = l->brp_min; brp > 0 && brp <= l->brp_max; brp += l->brp_inc > 0 ? l->brp_inc : 1) {
		uint64_t quanta = (l->clock_hz / brp + bit_s / 2) / bit_s;
		uint64_t got = quanta * brp * bit_s;
		uint64_t off = got > l->clock_hz ? got - l->clock_hz : l->clock_hz - got;

		if (quanta >= 1 + l->tseg1_min + l->tseg2_min && quanta <= 1 + l->tseg1_max + l->tseg2_max &&
			off * 1000 <= (uint64_t)l->clock_hz * PERMILLE_OFF)
			return true;
	}
	return false;
}

/* A controller that does not tell its limits (slcan has a list instead) is asked by setting it. */
static bool possible(const char *interface, uint32_t bit_s)
{
	struct can_bittiming_const c = {.name = ""};
	struct can_clock clock = {0};

	if (can_get_bittiming_const(interface, &c) != 0 || can_get_clock(interface, &clock) != 0 || clock.freq == 0)
		return true;
	const struct can_link_limits limits = {
		clock.freq, c.brp_min, c.brp_max, c.brp_inc, c.tseg1_min, c.tseg1_max, c.tseg2_min, c.tseg2_max};
	return can_link_divides(&limits, bit_s);
}

int can_link_bit_rate(const char *interface, uint32_t bit_s, bool dry_run)
{
	struct can_bittiming timing = {0};

	if (can_get_bittiming(interface, &timing) != 0 || !possible(interface, bit_s))
		return -EOPNOTSUPP;
	if (!permitted())
		return -EPERM;
	if (dry_run || timing.bitrate == bit_s)
		return 0;
	errno = 0;
	int stopped = result_of(can_do_stop(interface));
	int set = stopped < 0 ? stopped : result_of(can_set_bitrate(interface, bit_s));
	int started = result_of(can_do_start(interface));
	if (set < 0)
		return set == -EINVAL ? -EOPNOTSUPP : set;
	return started;
}

int can_link_restart(const char *interface)
{
	uint32_t kernel_ms = 0;

	if (can_get_restart_ms(interface, &kernel_ms) != 0 || kernel_ms > 0)
		return -EOPNOTSUPP;
	if (!permitted())
		return -EPERM;
	errno = 0;
	return result_of(can_do_restart(interface));
}

#include "gateway/bus_health.h"

#include <errno.h>
#include <string.h>

#include "gateway/canopen/deadline.h"
#include "gateway/canopen/node.h"
#include "od_index.h"

enum {
	POLL_US = 1000000,
	OVERRUN_CLEAR_US = 1000000,
	RESTART_DELAY_MAX_MS = 60000,
	DOUBLINGS_MAX = 16,
};

/* ---- load -------------------------------------------------------------------------------------------------------- */

/* From start of frame to interframe space a frame without data has 47 bits (ISO 11898-1). Bit stuffing applies to 34 of
 * them and to the data, with at most one stuff bit for each four bits. */
uint64_t bus_health_bits(uint64_t frames, uint64_t bytes)
{
	return 47 * frames + 8 * bytes + (34 * frames + 8 * bytes) / 8;
}

static void publish_load(struct bus_health *h, uint64_t elapsed_us)
{
	const struct can_traffic *now = &h->bus->traffic, *then = &h->traffic;
	uint64_t bits = bus_health_bits(now->frames - then->frames, now->bytes - then->bytes);
	uint64_t room = h->bus->bit_s * elapsed_us / 1000000;
	uint64_t permille = room > 0 ? bits * 1000 / room : 0;

	if (now->frames < then->frames) /* the interface was replaced by another one of this name */
		permille = 0;
	h->values->bus_health.load = (uint16_t)(permille < UINT16_MAX ? permille : UINT16_MAX);
	if (h->values->bus_health.load > h->values->bus_health.highest_load)
		h->values->bus_health.highest_load = h->values->bus_health.load;
}

static void poll_bus(struct bus_health *h)
{
	if (h->poll_us > 0 && h->now_us - h->poll_us < POLL_US)
		return;
	can_refresh(h->bus);
	record_refreshed(h->record, h->bus);
	if (h->poll_us > 0)
		publish_load(h, h->now_us - h->poll_us);
	h->traffic = h->bus->traffic;
	h->poll_us = h->now_us;
}

static void publish(struct bus_health *h)
{
	const struct can_port *bus = h->bus;
	const struct can_counters *c = &bus->counters;
	struct od_values *v = h->values;

	v->bus_counters.tx_frames = c->tx;
	v->bus_counters.rx_frames = c->rx;
	v->bus_counters.tx_retries = c->tx_retries;
	v->bus_counters.tx_dropped = c->tx_dropped;
	v->bus_counters.rx_dropped = c->rx_dropped;
	v->bus_counters.error_frames = c->errors;
	v->bus_counters.bus_off = c->bus_off;
	v->bus_health.bit_rate = bus->bit_s;
	v->bus_health.state = (uint8_t)bus->state;
	v->bus_health.tx_error_counter = bus->tx_errors;
	v->bus_health.rx_error_counter = bus->rx_errors;
}

/* ---- bus-off ----------------------------------------------------------------------------------------------------- */

/* Exponential back-off: each restart that is soon followed by another bus-off doubles the delay. */
static void plan_restart(struct bus_health *h)
{
	uint64_t delay_ms = h->values->bus_health.restart_delay;
	unsigned limit = h->values->bus_health.restart_limit;

	h->restart_us = UINT64_MAX;
	if (delay_ms == 0)
		return;
	if (limit > 0 && h->tries >= limit) {
		event_log_warning(h->log, h->now_us,
			"%s: remains bus-off after %u restarts (limit: 2122h:8); write 1 to 2122h:11 to restart it",
			h->bus->name, h->tries);
		return;
	}
	delay_ms <<= h->tries < DOUBLINGS_MAX ? h->tries : DOUBLINGS_MAX;
	h->restart_us = h->now_us + (delay_ms < RESTART_DELAY_MAX_MS ? delay_ms : RESTART_DELAY_MAX_MS) * 1000;
}

static void restart(struct bus_health *h)
{
	int rc = record_answer(h->record, can_restart(h->bus));

	h->restart_us = UINT64_MAX;
	if (rc == 0) {
		h->tries++;
		h->restarted_us = h->now_us;
		h->values->bus_health.restarts++;
	} else if (rc == -EPERM) {
		event_log_warning(h->log, h->now_us,
			"%s: restart needs CAP_NET_ADMIN; or let the kernel do it: `ip link set %s type can restart-ms "
			"100`",
			h->bus->name, h->bus->name);
	} else if (rc != -EOPNOTSUPP) {
		h->tries++;
		plan_restart(h);
	}
}

static void tick_restart(struct bus_health *h)
{
	uint64_t calm_us = h->values->bus_health.restart_window * (uint64_t)1000000;

	if (h->bus->state == CAN_STATE_BUS_OFF && h->now_us >= h->restart_us)
		restart(h);
	else if (h->bus->state != CAN_STATE_BUS_OFF && h->tries > 0 && h->now_us - h->restarted_us >= calm_us)
		h->tries = 0;
}

/* 2122h:11 = 1 restarts the controller now. */
static enum od_status on_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct bus_health *h = ctx;

	(void)size;
	if (entry->sub != OD_SUB_BUS_HEALTH_RESTART)
		return OD_OK;
	if (*(const uint8_t *)wire != 1)
		return OD_BAD_VALUE;
	if (h->bus->state != CAN_STATE_BUS_OFF)
		return OD_DEVICE_STATE;
	h->tries = 0;
	h->restart_us = h->now_us;
	return OD_CONSUMED;
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static const char *state_text(const struct can_port *bus)
{
	switch (bus->state) {
	case CAN_STATE_ACTIVE:
		return "error active";
	case CAN_STATE_WARNING:
		return "error warning";
	case CAN_STATE_PASSIVE:
		return "error passive (check cable, termination, bit rate, and that another node is on the bus)";
	case CAN_STATE_BUS_OFF:
		return "bus-off";
	case CAN_STATE_DOWN:
		break;
	}
	return bus->down_why ? bus->down_why : "down (ip link set ... up)";
}

static void went_off(struct bus_health *h)
{
	h->was_off = true;
	canopen_bus_off(h->node, h->now_us);
	plan_restart(h);
}

static void came_back(struct bus_health *h)
{
	h->was_off = false;
	h->restart_us = UINT64_MAX;
	canopen_error_set(h->node, EMCY_BUS_OFF_OVER, ERROR_COMMUNICATION, NULL, h->now_us);
	canopen_error_clear(h->node, EMCY_BUS_OFF_OVER, h->now_us);
}

static void watch_state(struct bus_health *h)
{
	enum can_state state = h->bus->state;

	if (state == h->seen)
		return;
	h->seen = state;
	if (state == CAN_STATE_ACTIVE)
		event_log_line(h->log, h->now_us, "%s: %s", h->bus->name, state_text(h->bus));
	else
		event_log_warning(h->log, h->now_us, "%s: %s", h->bus->name, state_text(h->bus));
	if (state == CAN_STATE_BUS_OFF)
		went_off(h);
	if (state == CAN_STATE_PASSIVE)
		canopen_error_set(h->node, EMCY_ERROR_PASSIVE, ERROR_COMMUNICATION, NULL, h->now_us);
	if (h->was_off && state != CAN_STATE_BUS_OFF && state != CAN_STATE_DOWN)
		came_back(h);
	if (state != CAN_STATE_PASSIVE && state != CAN_STATE_BUS_OFF)
		canopen_error_clear(h->node, EMCY_ERROR_PASSIVE, h->now_us);
}

static void pass_notice_on(struct bus_health *h)
{
	if (h->bus->notice)
		event_log_line(h->log, h->now_us, "%s: %s.", h->bus->name, h->bus->notice);
	h->bus->notice = NULL;
}

/* One error for all frames lost with less than a second between them. Those of the time in which the interface is down
 * are none; the last of them are counted after the last tick of that time. */
static void watch_lost_frames(struct bus_health *h)
{
	uint32_t dropped = h->bus->counters.tx_dropped;
	bool down = h->bus->state == CAN_STATE_DOWN, was_down = h->was_down;

	h->was_down = down;
	if (dropped != h->dropped_seen && !down && !was_down) {
		h->overrun = true;
		h->overrun_us = h->now_us;
		canopen_error_set(h->node, EMCY_CAN_OVERRUN, ERROR_COMMUNICATION, NULL, h->now_us);
	} else if (h->overrun && h->now_us - h->overrun_us > OVERRUN_CLEAR_US) {
		h->overrun = false;
		canopen_error_clear(h->node, EMCY_CAN_OVERRUN, h->now_us);
	}
	h->dropped_seen = dropped;
}

/* The standard allows no answer, so the log is the only place that explains the silence. */
static void watch_short_requests(struct bus_health *h)
{
	uint32_t before = h->values->bus_counters.short_sdo_requests, now = h->node->sdo_short;

	h->values->bus_counters.short_sdo_requests = now;
	if (before == 0 && now > 0)
		event_log_warning(h->log, h->now_us,
			"%s: an SDO request has fewer than 8 bytes and gets no answer (CiA 301, 7.2.4.3): make the "
			"master send 8; 2120h:8 counts them",
			h->bus->name);
}

static void watch_excess_requests(struct bus_health *h)
{
	if (h->excess_told || h->node->sdo_excess == 0)
		return;
	h->excess_told = true;
	event_log_warning(h->log, h->now_us,
		"%s: an SDO client sends requests without waiting for the answers: those beyond %d at once get none",
		h->bus->name, SDO_REQUESTS_AT_ONCE);
}

/* ---- bit rate ---------------------------------------------------------------------------------------------------- */

static const char *why_not(int rc)
{
	return rc == -EPERM	   ? "not permitted (CAP_NET_ADMIN)"
	       : rc == -EOPNOTSUPP ? "not supported by this bus"
				   : strerror(-rc);
}

bool bus_health_bit_rate_possible(struct bus_health *h, uint32_t bit_s)
{
	int rc = record_answer(h->record, can_bit_rate(h->bus, bit_s, true));

	if (rc < 0)
		event_log_line(h->log, h->now_us, "%s: LSS requested %u bit/s: %s", h->bus->name, bit_s, why_not(rc));
	return rc == 0;
}

void bus_health_set_bit_rate(struct bus_health *h, uint32_t bit_s)
{
	int rc = record_answer(h->record, can_bit_rate(h->bus, bit_s, false));

	event_log_line(h->log, h->now_us, "%s: %u bit/s by LSS%s%s", h->bus->name, bit_s, rc < 0 ? " failed: " : "",
		rc < 0 ? why_not(rc) : "");
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

void bus_health_init(
	struct bus_health *h, struct can_port *bus, struct canopen_node *node, struct od *od, struct event_log *log)
{
	*h = (struct bus_health){.bus = bus, .node = node, .values = od->values, .log = log, .restart_us = UINT64_MAX};
	h->hook = (struct od_hook){
		.first = OD_INDEX_BUS_HEALTH, .last = OD_INDEX_BUS_HEALTH, .before = on_write, .ctx = h};
	od_attach(od, &h->hook);
}

void bus_health_reset(struct bus_health *h)
{
	h->overrun = false;
	h->seen = CAN_STATE_ACTIVE;
	h->values->bus_health.highest_load = 0;
}

uint64_t bus_health_tick(struct bus_health *h, uint64_t now_us)
{
	uint64_t next_poll_us;

	h->now_us = now_us;
	poll_bus(h);
	canopen_bus_down(h->node, h->bus->state == CAN_STATE_DOWN);
	watch_state(h);
	pass_notice_on(h);
	tick_restart(h);
	watch_lost_frames(h);
	watch_short_requests(h);
	watch_excess_requests(h);
	publish(h);
	next_poll_us = h->poll_us + POLL_US;
	/* a restart that is due while the interface is down waits until it is up */
	return h->restart_us > now_us ? earlier(h->restart_us, next_poll_us) : next_poll_us;
}

#include "gateway/ascii_gateway.h"

static void receive(void *ctx, const struct can_msg *msg, uint64_t now_us)
{
	device_receive(ctx, msg, now_us);
}

static enum od_status write(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	struct device *d = ctx;

	d->now_us = now_us;
	return canopen_write(&d->canopen, index, sub, wire, size, now_us);
}

static void log_change(void *ctx, const char *who, const char *command, const char *answer, uint64_t now_us)
{
	event_log_line(&((struct device *)ctx)->log, now_us, "CiA 309, %s: %s: %s", who, command, answer);
}

void ascii_gateway_init(struct cia309 *g, struct device *device, struct can_port *bus)
{
	const struct cia309_device port = {.ctx = device, .receive = receive, .write = write, .log = log_change};

	cia309_init(g, &port, &device->canopen, bus);
}

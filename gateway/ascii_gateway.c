#include "gateway/ascii_gateway.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/log.h"

static void receive(void *ctx, const struct can_msg *msg, uint64_t now_us)
{
	device_receive(ctx, msg, now_us);
}

static enum od_status write_object(
	void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	return device_write(ctx, index, sub, wire, size, now_us);
}

static void log_change(
	void *ctx, unsigned number, const char *who, const char *command, const char *answer, uint64_t now_us)
{
	struct device *d = ctx;

	event_log_line_about(&d->log, now_us, number, "CiA 309, %s: %s: %s", who, command, answer);
}

void ascii_gateway_init(struct cia309 *g, struct device *device, struct can_port *bus)
{
	const struct cia309_device port = {.ctx = device, .receive = receive, .write = write_object, .log = log_change};

	cia309_init(g, &port, &device->canopen, bus);
}

struct ascii_gateway {
	struct cia309_server server; /* first: the caller has a pointer to it */
	struct cia309 core;
};

struct cia309_server *ascii_gateway_open(
	const char *addresses, struct device *device, struct can_port *bus, char *error, size_t error_size)
{
	struct ascii_gateway *g = calloc(1, sizeof(*g));

	if (!g) {
		snprintf(error, error_size, "cia309: %s", strerror(ENOMEM));
		return NULL;
	}
	ascii_gateway_init(&g->core, device, bus);
	if (cia309_server_open(&g->server, &g->core, addresses, error, error_size) < 0) {
		canopen_listen(&device->canopen, NULL);
		free(g);
		return NULL;
	}
	log_line("CiA 309-3 at %s", addresses);
	return &g->server;
}

void ascii_gateway_close(struct cia309_server *server)
{
	struct ascii_gateway *g = (struct ascii_gateway *)server;

	cia309_server_close(server);
	canopen_listen(g->core.node, NULL);
	free(g);
}

/* gateway/modbus/server.h
 * The Modbus server: a thread that accepts clients on TCP and reads serial lines, and answers requests by modbus_pdu().
 * It is never scheduled in real time, has a lower priority (nice) than the loop, and shares with it only the link.
 *
 * libmodbus opens sockets and lines. It does not read them: its modbus_receive() knows no function 43, and waits for a
 * slow client, and modbus_reply() sleeps after a bad request.
 *
 * Limits, so that no client takes more than its share: MODBUS_CLIENTS_MAX clients in all, and those of each window; one
 * request of each at a time, and so many a second; a client that sends no whole request for the idle time, whose frame
 * has a wrong header, or who does not read its responses, is disconnected. */
#ifndef GATEWAY_MODBUS_SERVER_H
#define GATEWAY_MODBUS_SERVER_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "gateway/modbus/access.h"
#include "gateway/modbus/options.h"

struct modbus_counters {
	atomic_uint clients, requests, exceptions, writes, refused, malformed;
};

struct modbus_server;

struct modbus_server_config {
	const struct modbus_window *windows;
	size_t count; /* 1 to MODBUS_WINDOWS_MAX */
	struct modbus_link *link;
	const struct modbus_map *map;
	const struct od_table *table;
	uint32_t (*abort_code)(enum od_status status);
	/** A line for the log, from the thread. `severity` as of syslog(3). */
	void (*log)(int severity, const char *text);
};

/** Opens the windows and starts the thread; what config points to must stay. NULL, and what and why in error: a window
 * cannot be opened. A serial line that fails later is opened again. Allocates. */
struct modbus_server *modbus_server_start(const struct modbus_server_config *config, char *error, size_t error_size);
const struct modbus_counters *modbus_server_counters(const struct modbus_server *server);
/** The node-ID that function 43/13 answers for. */
void modbus_server_node_id(struct modbus_server *server, uint8_t node_id);
/** Ends the thread and closes everything. The loop does not serve the link any more. */
void modbus_server_stop(struct modbus_server *server);

#endif

/* gateway/window.h
 * The Modbus server as a second window on the device: gateway/modbus/ connected to its dictionary, event log and clock.
 * All functions belong to the loop. */
#ifndef GATEWAY_WINDOW_H
#define GATEWAY_WINDOW_H

#include <stdio.h>

#include "gateway/device.h"
#include "gateway/modbus/link.h"
#include "gateway/modbus/server.h"

struct window {
	/* PRIVATE */
	struct device *device;
	struct modbus_server *server; /* NULL: closed */
	struct modbus_link *link;
};

/** The syntax of a window, for --help. */
void window_print_syntax(FILE *out);

/** `windows`: one a line, as config.modbus. 0; -EINVAL and a reason. */
int window_check(const char *windows, char *error, size_t error_size);

/** Starts the server, before the process gets real-time scheduling: its thread shall not have it. Without windows this
 * does nothing. 0; -errno and a reason. */
int window_open(struct window *w, const char *windows, struct device *device, char *error, size_t error_size);
bool window_is_open(const struct window *w);
/** Readable when a client wants something from the loop. */
int window_fd(const struct window *w);
void window_serve(struct window *w, uint64_t now_us);
/** The values of the device have changed. */
void window_publish(struct window *w);
/** A save has ended, result as of device_saved(). */
void window_saved(struct window *w, int result);
void window_close(struct window *w);

/** Executes what a client wants on the device: for window_serve(), and for tests without a thread. */
void window_execute(struct modbus_link *link, struct device *device, uint64_t now_us);

#endif

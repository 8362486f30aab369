/* gateway/ascii_gateway.h
 * The device as a CiA 309-3 gateway (gateway/cia309/): what that asks of the device. One thread, that of the device. */
#ifndef GATEWAY_ASCII_GATEWAY_H
#define GATEWAY_ASCII_GATEWAY_H

#include "gateway/cia309/server.h"
#include "gateway/device.h"

/** After device_init(); `g` must live as long as the device is used. The event log gets what clients change. Each frame
 * that device_receive() gets is for cia309_receive(), too, and each device_tick() is followed by cia309_tick(). */
void ascii_gateway_init(struct cia309 *g, struct device *device, struct can_port *bus);

/** Allocates one, listens at `addresses` (server.h), and says so in the log. NULL: not possible, and `error` says
 * why. */
struct cia309_server *ascii_gateway_open(
	const char *addresses, struct device *device, struct can_port *bus, char *error, size_t error_size);
void ascii_gateway_close(struct cia309_server *server);

#endif

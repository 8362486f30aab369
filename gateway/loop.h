/* gateway/loop.h
 * The daemon's one loop: epoll over sensor, bus, timer, signals and the storage thread. The clock
 * is read once per wake and handed down. */
#ifndef GATEWAY_LOOP_H
#define GATEWAY_LOOP_H

#include "gateway/device.h"
#include "gateway/store.h"

/** SIGINT and SIGTERM wait for the loop from here on. To be called before any thread is started, which inherits that. */
void loop_hold_signals(void);

/** Runs until SIGINT or SIGTERM. 0, or -errno when the loop itself cannot be set up. `writer` may
 * be NULL. */
int loop_run(struct device *device, struct can_port *bus, struct imu_port *imu, struct store_writer *writer,
	bool stored_damaged);

#endif

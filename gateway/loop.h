/* gateway/loop.h
 * The one loop of the process: epoll over sensor, bus, timer, signals and the storage thread. The clock
 * (CLOCK_MONOTONIC) is read once for each wake-up and passed down. */
#ifndef GATEWAY_LOOP_H
#define GATEWAY_LOOP_H

#include "gateway/device.h"
#include "gateway/store.h"

/** Blocks SIGINT and SIGTERM until the loop reads them, and SIGHUP, which has no effect. To be called before any thread
 * is started: threads inherit it. */
void loop_hold_signals(void);

/** Runs until SIGINT or SIGTERM. 0, or -errno when the loop itself cannot be set up. `writer`: NULL when nothing can be
 * stored. */
int loop_run(struct device *device, struct can_port *bus, struct imu_port *imu, struct store_writer *writer,
	bool stored_damaged);

#endif

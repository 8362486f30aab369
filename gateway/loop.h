/* gateway/loop.h
 * The one loop of the process: epoll over sensor, bus, timer, signals and the storage thread. The clock
 * (CLOCK_MONOTONIC) is read once for each wake-up and passed down. */
#ifndef GATEWAY_LOOP_H
#define GATEWAY_LOOP_H

#include "gateway/cia309/server.h"
#include "gateway/device.h"
#include "gateway/store.h"
#include "gateway/window.h"

/** Blocks SIGINT, SIGTERM and SIGHUP until the loop reads them. To be called before any thread is started: threads
 * inherit it. */
void loop_hold_signals(void);

/** SIGHUP: reads the configuration again. */
typedef void loop_reload(struct device *device, uint64_t now_us);

/** Runs until SIGINT or SIGTERM; tells the service manager of it (service.h). 0, or -errno when the loop itself
 * cannot be set up. `writer`: NULL when nothing can be stored. `cia309`, `window`: NULL when they are off. */
int loop_run(struct device *device, struct can_port *bus, struct imu_port *imu, struct store_writer *writer,
	struct cia309_server *cia309, struct window *window, bool stored_damaged, loop_reload *reload);

#endif

/* gateway/device_state.h
 * The state of a device between two calls of it, as plain bytes: a recording begins with it (record.h), and imu9-replay
 * continues from it. It is the memory of struct device without its pointers, so it holds for one build of the gateway
 * only, which device_state_build() names. Passive. */
#ifndef GATEWAY_DEVICE_STATE_H
#define GATEWAY_DEVICE_STATE_H

#include "gateway/device.h"

/** Of the sources of the device and the layout of its memory. */
const char *device_state_build(void);

/** Bytes of sizeof(struct device), without any address. */
void device_state_save(const struct device *d, uint8_t *out);
/** `d` is as device_init() made it, in any process of the same build; its ports stay. Uses up `saved`. What is not in
 * the state: LEDs, and which lines of the event log were left out. */
void device_state_load(struct device *d, uint8_t *saved);

#endif

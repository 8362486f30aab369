/* gateway/reload.h
 * The configuration read again while the device runs (SIGHUP). Passive, one thread. */
#ifndef GATEWAY_RELOAD_H
#define GATEWAY_RELOAD_H

#include "gateway/config.h"
#include "gateway/device.h"

/** The objects of `after` take the place of those of `before` as values of file and command line, which every NMT reset
 * starts from. Those that differ are applied at once, all or none, as a configuration snapshot (2130h) would be; those
 * of 1000h to 1FFFh are used from the next reset communication on, and stored values (1010h) keep their precedence. The
 * log says so of each, and of each key of [gateway] that differs. 0; -EINVAL: they contradict each other, nothing
 * changed. */
int reload(struct device *d, const struct config *before, const struct config *after, uint64_t now_us);

#endif

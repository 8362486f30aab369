/* gateway/serial.h
 * 1018h:4: the same for a gateway after each start, with another spelling of its sensor and another name of its bus,
 * and different on another machine, also when its card is a copy. The first start derives it from a number of the
 * hardware and keeps it in FOLDER/serial; a file that was copied from other hardware is not used. */
#ifndef GATEWAY_SERIAL_H
#define GATEWAY_SERIAL_H

#include <stddef.h>
#include <stdint.h>

enum { SERIAL_NOTE_MAX = 200 };

/** The serial number of the gateway on `bus`, never 0. `configured`: the one to use, 0: none. A note for the log, or
 * "": other hardware, another gateway of this host has the number, it could not be kept. The number is held by this
 * process until it ends. `root` is "" (tests: a folder with etc/, proc/ and sys/). Blocks. */
uint32_t serial_number(
	const char *root, const char *folder, const char *bus, uint32_t configured, char note[SERIAL_NOTE_MAX]);

#endif

/* drivers/can/slcan.h
 * A serial or USB-serial CAN adapter with the slcan protocol; one that answers nothing works, too. When it is
 * unplugged, the port is CAN_STATE_DOWN and tries to open the device twice a second. */
#ifndef DRIVERS_CAN_SLCAN_H
#define DRIVERS_CAN_SLCAN_H

#include "drivers/ports/can.h"

#define CAN_SLCAN_SYNTAX "slcan:DEVICE[@BAUD][,bitrate=B][,listen-only]"

/** `address` is DEVICE[@BAUD][,OPTION...] (bus_options.h; the adapter chooses the sample point). BAUD is the baud rate
 * of the serial line, default 115200; adapters with USB ignore it. Otherwise as can_open(). The adapter goes on the bus
 * with the first can_service(), so a bit rate set right after opening is used from the start. -EOPNOTSUPP: slcan has no
 * such bit rate; -EINVAL: no such BAUD; -EBUSY: another program uses it. */
int can_slcan_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

/* drivers/can/slcan.h
 * A serial (or USB serial) CAN adapter that speaks slcan. Adapters that answer nothing are fine, too. Survives
 * unplugging: the port is CAN_STATE_DOWN and tries to open the device twice a second. */
#ifndef DRIVERS_CAN_SLCAN_H
#define DRIVERS_CAN_SLCAN_H

#include "drivers/ports/can.h"

#define CAN_SLCAN_SYNTAX "slcan:DEVICE[@BAUD][,bitrate=B][,listen-only]"

/** `address` is DEVICE[@BAUD][,OPTION...] (bus_options.h; the adapter chooses the sample point). BAUD, of the serial
 * line, is 115200 unless given; adapters with USB do not mind. Otherwise as can_open(). The adapter goes on the bus with
 * the first can_service(), so a bit rate given right after opening holds from the beginning.
 * -EOPNOTSUPP: slcan has no such bit rate; -EINVAL: no such BAUD; -EBUSY: another program has it. */
int can_slcan_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

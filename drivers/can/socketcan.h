/* drivers/can/socketcan.h
 * A CAN interface of the Linux kernel. Survives the interface going down, coming up again, being
 * removed and coming back. Own frames are not received; other programs of this host see them. */
#ifndef DRIVERS_CAN_SOCKETCAN_H
#define DRIVERS_CAN_SOCKETCAN_H

#include "drivers/ports/can.h"

/** As can_open(). -ENODEV: no such interface; -ENETDOWN: it is down; -EAFNOSUPPORT: the kernel has
 * no SocketCAN. */
int can_socketcan_open(const char *interface, struct can_port **port, char *error, size_t error_size);

#endif

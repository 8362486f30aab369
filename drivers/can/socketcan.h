/* drivers/can/socketcan.h
 * A CAN interface of the Linux kernel. The port recovers when the interface goes down and up again, or is removed and
 * created again. Own frames are not received; other programs on this host receive them. */
#ifndef DRIVERS_CAN_SOCKETCAN_H
#define DRIVERS_CAN_SOCKETCAN_H

#include "drivers/ports/can.h"

/** As can_open(). -ENODEV: no such interface; -ENETDOWN: it is down; -EMEDIUMTYPE: it is not a CAN interface;
 * -EAFNOSUPPORT: the kernel has no SocketCAN. */
int can_socketcan_open(const char *interface, struct can_port **port, char *error, size_t error_size);

#endif

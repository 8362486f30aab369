/* drivers/can/udp.h
 * A CAN bus of UDP multicast datagrams in the format of python-can's udp_multicast bus. It needs no CAN hardware and no
 * kernel support. Programs on one host and on hosts one hop away share the bus. Own frames are not received. */
#ifndef DRIVERS_CAN_UDP_H
#define DRIVERS_CAN_UDP_H

#include "drivers/ports/can.h"

#define CAN_UDP_SYNTAX "udp[:GROUP[:PORT]]"
#define CAN_UDP_GROUP  "239.74.163.2" /* python-can's own */
#define CAN_UDP_PORT   "43113"

/** `address` is [GROUP[:PORT]]; an IPv6 group with a port is written [GROUP]:PORT. Otherwise as can_open(). The
 * interface is the one the kernel routes the group to, as in python-can; loopback when there is no route. */
int can_udp_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

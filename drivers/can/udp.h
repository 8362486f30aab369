/* drivers/can/udp.h
 * A CAN bus of UDP multicast datagrams in the format of python-can's udp_multicast bus. It needs no CAN hardware and no
 * kernel support. Programs on one host share the bus, and those on hosts one hop away where `hosts` admits them. Own
 * frames are not received. */
#ifndef DRIVERS_CAN_UDP_H
#define DRIVERS_CAN_UDP_H

#include "drivers/ports/can.h"

#define CAN_UDP_SYNTAX "udp[:GROUP[:PORT]][,interface=NAME][,hosts=HOSTS]"
#define CAN_UDP_GROUP  "239.74.163.2" /* python-can's own */
#define CAN_UDP_PORT   "43113"

/** `address` is [GROUP[:PORT]][,OPTION]...; an IPv6 group with a port is written [GROUP]:PORT. Otherwise as can_open().
 * The interface is that of the option, or the one the kernel routes the group to, as in python-can; loopback when there
 * is no route. Frames of other hosts are taken only if `hosts` says so; port->notice says what holds. */
int can_udp_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

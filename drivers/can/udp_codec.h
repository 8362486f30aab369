/* drivers/can/udp_codec.h
 * One CAN frame as one msgpack map, as python-can's udp_multicast bus writes it. Pure, no heap. */
#ifndef DRIVERS_CAN_UDP_CODEC_H
#define DRIVERS_CAN_UDP_CODEC_H

#include "drivers/ports/can.h"

enum { CAN_UDP_MAX = 256 }; /* bytes; a frame of 8 data bytes takes 164 */

/** Writes msg as python-can would. Returns the length. */
size_t can_udp_encode(const struct can_msg *msg, char out[CAN_UDP_MAX]);

/** Reads one datagram into msg (not t_us). 0; -EBADMSG: not a valid message; -ENOTSUP: a valid one
 * that is not a classical data or remote frame (CAN FD, error frame). */
int can_udp_decode(const char *in, size_t size, struct can_msg *msg);

#endif

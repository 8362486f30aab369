/* drivers/can/udp_codec.h
 * One CAN frame as one msgpack map, in the format of python-can's udp_multicast bus. Pure, no heap. */
#ifndef DRIVERS_CAN_UDP_CODEC_H
#define DRIVERS_CAN_UDP_CODEC_H

#include "drivers/ports/can.h"

enum { CAN_UDP_MAX = 256 }; /* bytes; a frame of 8 data bytes takes 164 */

/** Encodes msg. Returns the length. */
size_t can_udp_encode(const struct can_msg *msg, char out[CAN_UDP_MAX]);

/** Decodes one datagram into msg (not t_us). 0; -EBADMSG: not a valid message; -ENOTSUP: a CAN FD frame or an error
 * frame. */
int can_udp_decode(const char *in, size_t size, struct can_msg *msg);

#endif

/* drivers/can/error_frame.h
 * What SocketCAN's error frames say, which gs_usb adapters send in the same form. */
#ifndef DRIVERS_CAN_ERROR_FRAME_H
#define DRIVERS_CAN_ERROR_FRAME_H

#include "drivers/ports/can.h"

/** Brings state, error counters and counters of the port up to date. `can_id`: with its class bits. */
void can_error_frame(struct can_port *port, uint32_t can_id, const uint8_t data[8]);

#endif

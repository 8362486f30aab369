/* drivers/can/error_frame.h
 * Error frames of SocketCAN (linux/can/error.h); gs_usb adapters send the same ones. */
#ifndef DRIVERS_CAN_ERROR_FRAME_H
#define DRIVERS_CAN_ERROR_FRAME_H

#include "drivers/ports/can.h"

/** Updates state, error counters and counters of the port. `can_id` contains the error classes. */
void can_error_frame(struct can_port *port, uint32_t can_id, const uint8_t data[8]);

#endif

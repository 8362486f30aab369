/* drivers/can/gs_usb.h
 * A USB-CAN adapter of the gs_usb family (candleLight, CANable, CANtact and kin) by libusb: no kernel driver, interface or
 * root needed, only the permission that the udev rule gives. The kernel's driver is put aside and gets the adapter back.
 *
 * Survives unplugging: the port is CAN_STATE_DOWN and looks for the adapter twice a second. Opening it again is
 * done within service(), since claiming an interface blocks in libusb; everything else is asynchronous. */
#ifndef DRIVERS_CAN_GS_USB_H
#define DRIVERS_CAN_GS_USB_H

#include "drivers/ports/can.h"

#define CAN_GS_USB_SYNTAX "gs_usb[:SERIAL[:CHANNEL]][,bitrate=B][,sample-point=P][,listen-only]"

/** `address` is [SERIAL[:CHANNEL]][,OPTION...] (bus_options.h); instead of the serial number the place is accepted, e.g.
 * 3-1.2. Otherwise as can_open(). The adapter goes on the bus with the first can_service(), so a bit rate given
 * right after opening holds from the beginning.
 * -ENODEV: no such adapter; -ENOTUNIQ: several; -EACCES: no permission; -EBUSY: another program has it; -EOPNOTSUPP: it
 * cannot do that bit rate, or listen only; -ECHRNG: no such channel. */
int can_gs_usb_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

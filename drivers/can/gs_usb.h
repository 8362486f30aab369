/* drivers/can/gs_usb.h
 * A USB-CAN adapter of the gs_usb family (candleLight, CANable, CANtact and kin) through libusb. It needs no
 * kernel driver, interface or root, only the permission that the udev rule gives. The kernel's driver is detached while
 * the port is open.
 *
 * When the adapter is unplugged, the port is CAN_STATE_DOWN and searches for the adapter twice a second. It is opened
 * again within service(), where claiming the interface blocks in libusb; everything else is asynchronous. */
#ifndef DRIVERS_CAN_GS_USB_H
#define DRIVERS_CAN_GS_USB_H

#include "drivers/ports/can.h"

#define CAN_GS_USB_SYNTAX "gs_usb[:SERIAL[:CHANNEL]][,bitrate=B][,sample-point=P][,listen-only]"

/** `address` is [SERIAL[:CHANNEL]][,OPTION...] (bus_options.h); instead of the serial number, the USB port is accepted,
 * e.g. 3-1.2. Otherwise as can_open(). The adapter goes on the bus with the first can_service(), so a bit rate set
 * right after opening is used from the start. -ENODEV: no such adapter; -ENOTUNIQ: several; -EACCES: no permission;
 * -EBUSY: another program uses it; -EOPNOTSUPP: it does not support the bit rate or listen-only mode; -ECHRNG: no such
 * channel. */
int can_gs_usb_open(const char *address, struct can_port **port, char *error, size_t error_size);

#endif

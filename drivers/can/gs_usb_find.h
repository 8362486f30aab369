/* drivers/can/gs_usb_find.h
 * The gs_usb adapters that are plugged in, as sysfs lists them: needs neither udev nor permission. */
#ifndef DRIVERS_CAN_GS_USB_FIND_H
#define DRIVERS_CAN_GS_USB_FIND_H

#include <stddef.h>

enum { GS_USB_TEXT = 64, GS_USB_ADAPTERS = 16 };

struct gs_usb_adapter {
	char place[GS_USB_TEXT];  /* bus and ports, e.g. 3-1.2: the same while it stays in that socket */
	char serial[GS_USB_TEXT]; /* "": it has none */
	char product[GS_USB_TEXT];
	char node[GS_USB_TEXT]; /* below /dev, e.g. /dev/bus/usb/003/007: another one after each plugging in */
};

/** What it is called by: its serial number, or else its place. */
static inline const char *gs_usb_name(const struct gs_usb_adapter *adapter)
{
	return adapter->serial[0] ? adapter->serial : adapter->place;
}

/** Adapters below `root` (/sys/bus/usb/devices), in the order of their places; so many, at most GS_USB_ADAPTERS. */
size_t gs_usb_list(const char *root, struct gs_usb_adapter list[GS_USB_ADAPTERS]);

/** The one whose serial number, or else whose place, is `wanted` ("": any). 0; -ENODEV: none; -ENOTUNIQ: several;
 * `error` then tells which there are. */
int gs_usb_choose(const struct gs_usb_adapter *list, size_t n, const char *wanted, struct gs_usb_adapter *found,
	char *error, size_t error_size);

#endif

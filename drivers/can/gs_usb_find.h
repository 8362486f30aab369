/* drivers/can/gs_usb_find.h
 * The gs_usb adapters that are plugged in, from sysfs. Needs neither udev nor permissions. */
#ifndef DRIVERS_CAN_GS_USB_FIND_H
#define DRIVERS_CAN_GS_USB_FIND_H

#include <stddef.h>

enum { GS_USB_TEXT = 64, GS_USB_ADAPTERS = 16 };

struct gs_usb_adapter {
	char place[GS_USB_TEXT];  /* USB bus and ports, e.g. 3-1.2: the same as long as it stays in that socket */
	char serial[GS_USB_TEXT]; /* "" where it has none */
	char product[GS_USB_TEXT];
	char node[GS_USB_TEXT]; /* e.g. /dev/bus/usb/003/007; changes each time it is plugged in */
};

/** Its serial number, or its place where it has none. */
static inline const char *gs_usb_name(const struct gs_usb_adapter *adapter)
{
	return adapter->serial[0] ? adapter->serial : adapter->place;
}

/** Lists the adapters below `root` (/sys/bus/usb/devices) by place. Returns their number, at most GS_USB_ADAPTERS. */
size_t gs_usb_list(const char *root, struct gs_usb_adapter list[GS_USB_ADAPTERS]);

/** Finds the adapter whose place or serial number is `wanted` ("": the only one). 0; -ENODEV: none; -ENOTUNIQ: several;
 * `error` then lists the adapters. */
int gs_usb_choose(const struct gs_usb_adapter *list, size_t n, const char *wanted, struct gs_usb_adapter *found,
	char *error, size_t error_size);

#endif

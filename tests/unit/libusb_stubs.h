/* tests/unit/libusb_stubs.h
 * What a program that simulates libusb needs beside the adapter itself: the opaque types, one object of each, and the
 * functions that do nothing for one adapter. It defines functions of the library, so it is included in one file. */
#ifndef TESTS_UNIT_LIBUSB_STUBS_H
#define TESTS_UNIT_LIBUSB_STUBS_H

#include <libusb-1.0/libusb.h>
#include <stddef.h>

struct libusb_context {
	int unused;
};
struct libusb_device {
	int unused;
};
struct libusb_device_handle {
	int unused;
};
static struct libusb_context the_context;
static struct libusb_device the_device;
static struct libusb_device_handle the_handle;

int LIBUSB_CALL libusb_init(libusb_context **context)
{
	*context = &the_context;
	return 0;
}

void LIBUSB_CALL libusb_exit(libusb_context *context)
{
	(void)context;
}

int LIBUSB_CALL libusb_set_option(libusb_context *context, enum libusb_option option, ...)
{
	(void)context, (void)option;
	return 0;
}

void LIBUSB_CALL libusb_set_pollfd_notifiers(
	libusb_context *context, libusb_pollfd_added_cb added, libusb_pollfd_removed_cb removed, void *user_data)
{
	(void)context, (void)added, (void)removed, (void)user_data;
}

const struct libusb_pollfd **LIBUSB_CALL libusb_get_pollfds(libusb_context *context)
{
	static const struct libusb_pollfd *none[] = {NULL};

	(void)context;
	return none;
}

void LIBUSB_CALL libusb_free_pollfds(const struct libusb_pollfd **list)
{
	(void)list;
}

libusb_device *LIBUSB_CALL libusb_get_device(libusb_device_handle *handle)
{
	(void)handle;
	return &the_device;
}

int LIBUSB_CALL libusb_set_auto_detach_kernel_driver(libusb_device_handle *handle, int on)
{
	(void)handle, (void)on;
	return 0;
}

#endif

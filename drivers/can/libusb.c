/* libusb, loaded when `gs_usb` is opened: with libudev, which it needs, it is 0.2 MB. */
#include <libusb-1.0/libusb.h>

#define LIBRARY "libusb-1.0.so.0"
#define FUNCTIONS(VALUE, VOID, ENTRY)                                                                                \
	ENTRY(libusb_set_option, int, (libusb_context * c, enum libusb_option option, ...))                          \
	VALUE(libusb_init, int, (libusb_context * *c), (c))                                                          \
	VOID(libusb_exit, (libusb_context * c), (c))                                                                 \
	VALUE(libusb_get_pollfds, const struct libusb_pollfd **, (libusb_context * c), (c))                          \
	VOID(libusb_free_pollfds, (const struct libusb_pollfd **list), (list))                                       \
	VOID(libusb_set_pollfd_notifiers,                                                                            \
		(libusb_context * c, libusb_pollfd_added_cb added, libusb_pollfd_removed_cb removed, void *user),    \
		(c, added, removed, user))                                                                           \
	VALUE(libusb_handle_events_timeout_completed, int,                                                           \
		(libusb_context * c, struct timeval * time, int *completed), (c, time, completed))                   \
	VALUE(libusb_wrap_sys_device, int, (libusb_context * c, intptr_t fd, libusb_device_handle * *h), (c, fd, h)) \
	VOID(libusb_close, (libusb_device_handle * h), (h))                                                          \
	VALUE(libusb_get_device, libusb_device *, (libusb_device_handle * h), (h))                                   \
	VALUE(libusb_get_active_config_descriptor, int,                                                              \
		(libusb_device * d, struct libusb_config_descriptor * *config), (d, config))                         \
	VOID(libusb_free_config_descriptor, (struct libusb_config_descriptor * config), (config))                    \
	VALUE(libusb_set_auto_detach_kernel_driver, int, (libusb_device_handle * h, int on), (h, on))                \
	VALUE(libusb_claim_interface, int, (libusb_device_handle * h, int interface), (h, interface))                \
	VALUE(libusb_release_interface, int, (libusb_device_handle * h, int interface), (h, interface))              \
	VALUE(libusb_control_transfer, int,                                                                          \
		(libusb_device_handle * h, uint8_t type, uint8_t request, uint16_t value, uint16_t index,            \
			unsigned char *data, uint16_t length, unsigned int timeout_ms),                              \
		(h, type, request, value, index, data, length, timeout_ms))                                          \
	VALUE(libusb_alloc_transfer, struct libusb_transfer *, (int packets), (packets))                             \
	VOID(libusb_free_transfer, (struct libusb_transfer * t), (t))                                                \
	VALUE(libusb_submit_transfer, int, (struct libusb_transfer * t), (t))                                        \
	VALUE(libusb_cancel_transfer, int, (struct libusb_transfer * t), (t))
#include "drivers/loaded.h"

/* Called before all others, with options that have no arguments. LIBUSB_ERROR_NOT_SUPPORTED: there is no libusb, or not
 * one that has these functions. */
int libusb_set_option(libusb_context *context, enum libusb_option option, ...)
{
	static bool loaded;

	if (!loaded && !(loaded = load_library()))
		return LIBUSB_ERROR_NOT_SUPPORTED;
	return library.libusb_set_option(context, option);
}

/* libiio, loaded when `iio:` is opened. With what it needs (avahi, D-Bus, libxml2, ICU) it is 18 libraries, more than
 * everything else in the process. */
#include <errno.h>
#include <iio.h>

#define LIBRARY "libiio.so.0"
#define FUNCTIONS(VALUE, VOID, ENTRY)                                                                                 \
	ENTRY(iio_create_local_context, struct iio_context *, (void))                                                 \
	VALUE(iio_context_get_devices_count, unsigned int, (const struct iio_context *c), (c))                        \
	VALUE(iio_context_get_device, struct iio_device *, (const struct iio_context *c, unsigned int i), (c, i))     \
	VALUE(iio_context_find_device, struct iio_device *, (const struct iio_context *c, const char *name),          \
		(c, name))                                                                                            \
	VOID(iio_context_destroy, (struct iio_context * c), (c))                                                      \
	VALUE(iio_device_get_id, const char *, (const struct iio_device *d), (d))                                     \
	VALUE(iio_device_get_name, const char *, (const struct iio_device *d), (d))                                   \
	VALUE(iio_device_is_trigger, bool, (const struct iio_device *d), (d))                                         \
	VALUE(iio_device_get_channels_count, unsigned int, (const struct iio_device *d), (d))                         \
	VALUE(iio_device_get_channel, struct iio_channel *, (const struct iio_device *d, unsigned int i), (d, i))     \
	VALUE(iio_device_find_channel, struct iio_channel *,                                                          \
		(const struct iio_device *d, const char *name, bool output), (d, name, output))                       \
	VALUE(iio_device_attr_read, ssize_t, (const struct iio_device *d, const char *attr, char *text, size_t size), \
		(d, attr, text, size))                                                                                \
	VALUE(iio_device_attr_write, ssize_t, (const struct iio_device *d, const char *attr, const char *text),       \
		(d, attr, text))                                                                                      \
	VALUE(iio_device_get_trigger, int, (const struct iio_device *d, const struct iio_device **trigger),           \
		(d, trigger))                                                                                         \
	VALUE(iio_device_set_trigger, int, (const struct iio_device *d, const struct iio_device *trigger),            \
		(d, trigger))                                                                                         \
	VALUE(iio_device_set_kernel_buffers_count, int, (const struct iio_device *d, unsigned int n), (d, n))         \
	VALUE(iio_device_create_buffer, struct iio_buffer *,                                                          \
		(const struct iio_device *d, size_t samples, bool cyclic), (d, samples, cyclic))                      \
	VALUE(iio_channel_get_type, enum iio_chan_type, (const struct iio_channel *c), (c))                           \
	VALUE(iio_channel_get_modifier, enum iio_modifier, (const struct iio_channel *c), (c))                        \
	VALUE(iio_channel_is_output, bool, (const struct iio_channel *c), (c))                                        \
	VALUE(iio_channel_is_scan_element, bool, (const struct iio_channel *c), (c))                                  \
	VALUE(iio_channel_get_data_format, const struct iio_data_format *, (const struct iio_channel *c), (c))        \
	VALUE(iio_channel_find_attr, const char *, (const struct iio_channel *c, const char *name), (c, name))        \
	VALUE(iio_channel_attr_read, ssize_t,                                                                         \
		(const struct iio_channel *c, const char *attr, char *text, size_t size), (c, attr, text, size))      \
	VALUE(iio_channel_attr_read_double, int, (const struct iio_channel *c, const char *attr, double *value),      \
		(c, attr, value))                                                                                     \
	VALUE(iio_channel_attr_write, ssize_t, (const struct iio_channel *c, const char *attr, const char *text),     \
		(c, attr, text))                                                                                      \
	VOID(iio_channel_enable, (struct iio_channel * c), (c))                                                       \
	VOID(iio_channel_disable, (struct iio_channel * c), (c))                                                      \
	VOID(iio_channel_convert, (const struct iio_channel *c, void *to, const void *from), (c, to, from))           \
	VALUE(iio_buffer_set_blocking_mode, int, (struct iio_buffer * b, bool blocking), (b, blocking))               \
	VALUE(iio_buffer_get_poll_fd, int, (struct iio_buffer * b), (b))                                              \
	VALUE(iio_buffer_refill, ssize_t, (struct iio_buffer * b), (b))                                               \
	VALUE(iio_buffer_first, void *, (const struct iio_buffer *b, const struct iio_channel *c), (b, c))            \
	VOID(iio_buffer_destroy, (struct iio_buffer * b), (b))
#include "drivers/loaded.h"

/* Called before all others. NULL with errno ELIBACC: there is no libiio, or not one that has these functions. */
struct iio_context *iio_create_local_context(void)
{
	static bool loaded;

	if (!loaded && !(loaded = load_library())) {
		errno = ELIBACC;
		return NULL;
	}
	return library.iio_create_local_context();
}

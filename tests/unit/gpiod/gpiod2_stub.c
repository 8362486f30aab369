#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <gpiod.h>
#include <string.h>

#include "tests/unit/gpiod/gpiod_stub.h"

struct gpiod_chip {
	int unused;
};
struct gpiod_line_settings {
	enum gpiod_line_direction direction;
	enum gpiod_line_edge edge;
};
struct gpiod_line_config {
	unsigned line;
	const struct gpiod_line_settings *settings;
};
struct gpiod_request_config {
	const char *consumer;
};
struct gpiod_line_request {
	int unused;
};
struct gpiod_edge_event {
	uint64_t ns;
};
struct gpiod_edge_event_buffer {
	struct gpiod_edge_event event;
};

struct gpiod_stub gpiod_stub;

static struct gpiod_chip the_chip;
static struct gpiod_line_settings the_settings;
static struct gpiod_line_config the_config;
static struct gpiod_request_config the_consumer;
static struct gpiod_line_request the_request;
static struct gpiod_edge_event_buffer the_buffer;

/* Takes paths only. */
struct gpiod_chip *gpiod_chip_open(const char *path)
{
	assert_string_equal(path, "/dev/gpiochip3");
	errno = ENOENT;
	gpiod_stub.open_objects += !gpiod_stub.no_chip;
	return gpiod_stub.no_chip ? NULL : &the_chip;
}

void gpiod_chip_close(struct gpiod_chip *chip)
{
	assert_ptr_equal(chip, &the_chip);
	gpiod_stub.open_objects--;
	errno = EBADF; /* of closing it, not why there is no line */
}

struct gpiod_line_settings *gpiod_line_settings_new(void)
{
	gpiod_stub.open_objects++;
	the_settings = (struct gpiod_line_settings){0};
	return &the_settings;
}

void gpiod_line_settings_free(struct gpiod_line_settings *settings)
{
	gpiod_stub.open_objects -= settings != NULL;
}

int gpiod_line_settings_set_direction(struct gpiod_line_settings *settings, enum gpiod_line_direction direction)
{
	settings->direction = direction;
	return 0;
}

int gpiod_line_settings_set_edge_detection(struct gpiod_line_settings *settings, enum gpiod_line_edge edge)
{
	settings->edge = edge;
	return 0;
}

struct gpiod_line_config *gpiod_line_config_new(void)
{
	gpiod_stub.open_objects++;
	the_config = (struct gpiod_line_config){0};
	return &the_config;
}

void gpiod_line_config_free(struct gpiod_line_config *config)
{
	gpiod_stub.open_objects -= config != NULL;
}

int gpiod_line_config_add_line_settings(
	struct gpiod_line_config *config, const unsigned *offsets, size_t n, struct gpiod_line_settings *settings)
{
	assert_int_equal(n, 1);
	config->line = offsets[0];
	config->settings = settings;
	return 0;
}

struct gpiod_request_config *gpiod_request_config_new(void)
{
	gpiod_stub.open_objects++;
	the_consumer = (struct gpiod_request_config){0};
	return &the_consumer;
}

void gpiod_request_config_free(struct gpiod_request_config *config)
{
	gpiod_stub.open_objects -= config != NULL;
}

void gpiod_request_config_set_consumer(struct gpiod_request_config *config, const char *consumer)
{
	config->consumer = consumer;
}

struct gpiod_line_request *gpiod_chip_request_lines(
	struct gpiod_chip *chip, struct gpiod_request_config *request, struct gpiod_line_config *config)
{
	assert_ptr_equal(chip, &the_chip);
	assert_string_equal(request->consumer, "imu9-gateway");
	assert_int_equal(config->line, GPIOD_STUB_LINE);
	assert_int_equal(config->settings->direction, GPIOD_LINE_DIRECTION_INPUT);
	assert_int_equal(config->settings->edge, GPIOD_LINE_EDGE_RISING);
	gpiod_stub.requests++;
	if (gpiod_stub.no_line || gpiod_stub.busy) {
		errno = gpiod_stub.no_line ? EINVAL : EBUSY;
		return NULL;
	}
	gpiod_stub.open_objects++;
	return &the_request;
}

void gpiod_line_request_release(struct gpiod_line_request *request)
{
	assert_ptr_equal(request, &the_request);
	gpiod_stub.open_objects--;
}

int gpiod_line_request_get_fd(struct gpiod_line_request *request)
{
	assert_ptr_equal(request, &the_request);
	return GPIOD_STUB_FD;
}

struct gpiod_edge_event_buffer *gpiod_edge_event_buffer_new(size_t capacity)
{
	assert_int_equal(capacity, 1);
	gpiod_stub.open_objects++;
	return &the_buffer;
}

void gpiod_edge_event_buffer_free(struct gpiod_edge_event_buffer *buffer)
{
	gpiod_stub.open_objects -= buffer != NULL;
}

int gpiod_line_request_read_edge_events(
	struct gpiod_line_request *request, struct gpiod_edge_event_buffer *buffer, size_t max_events)
{
	assert_ptr_equal(request, &the_request);
	assert_int_equal(max_events, 1);
	gpiod_stub.events_read++;
	buffer->event.ns = (uint64_t)gpiod_stub.edge_ns;
	return 1;
}

struct gpiod_edge_event *gpiod_edge_event_buffer_get_event(struct gpiod_edge_event_buffer *buffer, unsigned long index)
{
	assert_int_equal(index, 0);
	return &buffer->event;
}

uint64_t gpiod_edge_event_get_timestamp_ns(struct gpiod_edge_event *event)
{
	return event->ns;
}

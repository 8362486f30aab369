#include "drivers/imu/pololu/drdy.h"

#include <errno.h>
#include <gpiod.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct drdy {
	struct gpiod_line_request *request;
	struct gpiod_edge_event_buffer *buffer; /* of one event */
};

/* Version 2 opens paths only. */
static struct gpiod_chip *open_chip(const char *chip)
{
	char path[80];

	if (strchr(chip, '/'))
		return gpiod_chip_open(chip);
	snprintf(path, sizeof(path), "/dev/%s%.60s", chip[strspn(chip, "0123456789")] ? "" : "gpiochip", chip);
	return gpiod_chip_open(path);
}

static struct gpiod_line_request *request_edges(struct gpiod_chip *chip, unsigned line)
{
	struct gpiod_line_settings *edges = gpiod_line_settings_new();
	struct gpiod_line_config *lines = gpiod_line_config_new();
	struct gpiod_request_config *consumer = gpiod_request_config_new();
	struct gpiod_line_request *request = NULL;

	if (edges && lines && consumer) {
		gpiod_line_settings_set_direction(edges, GPIOD_LINE_DIRECTION_INPUT);
		gpiod_line_settings_set_edge_detection(edges, GPIOD_LINE_EDGE_RISING);
		gpiod_request_config_set_consumer(consumer, "imu9-gateway");
		if (gpiod_line_config_add_line_settings(lines, &line, 1, edges) == 0)
			request = gpiod_chip_request_lines(chip, consumer, lines);
	}
	gpiod_request_config_free(consumer);
	gpiod_line_config_free(lines);
	gpiod_line_settings_free(edges);
	return request;
}

struct drdy *drdy_open(const char *chip, unsigned line)
{
	struct drdy *drdy = calloc(1, sizeof(*drdy));
	struct gpiod_chip *opened;
	int why;

	if (!drdy)
		return NULL;
	drdy->buffer = gpiod_edge_event_buffer_new(1);
	opened = drdy->buffer ? open_chip(chip) : NULL;
	drdy->request = opened ? request_edges(opened, line) : NULL;
	why = errno;
	if (opened)
		gpiod_chip_close(opened); /* the request stays */
	if (drdy->request)
		return drdy;
	drdy_close(drdy);
	errno = why;
	return NULL;
}

int drdy_fd(const struct drdy *drdy)
{
	return gpiod_line_request_get_fd(drdy->request);
}

int drdy_read(struct drdy *drdy, int64_t *t_ns)
{
	struct gpiod_edge_event *event;

	if (gpiod_line_request_read_edge_events(drdy->request, drdy->buffer, 1) != 1)
		return -1;
	event = gpiod_edge_event_buffer_get_event(drdy->buffer, 0);
	*t_ns = (int64_t)gpiod_edge_event_get_timestamp_ns(event);
	return 0;
}

void drdy_close(struct drdy *drdy)
{
	if (!drdy)
		return;
	if (drdy->request)
		gpiod_line_request_release(drdy->request);
	gpiod_edge_event_buffer_free(drdy->buffer);
	free(drdy);
}

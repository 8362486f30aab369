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
struct gpiod_line {
	int unused;
};

struct gpiod_stub gpiod_stub;
static struct gpiod_chip the_chip;
static struct gpiod_line the_line;

/* Looks up a name, number or path. */
struct gpiod_chip *gpiod_chip_open_lookup(const char *name)
{
	assert_true(!strcmp(name, "gpiochip3") || !strcmp(name, "3") || !strcmp(name, "/dev/gpiochip3"));
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

struct gpiod_line *gpiod_chip_get_line(struct gpiod_chip *chip, unsigned line)
{
	assert_ptr_equal(chip, &the_chip);
	assert_int_equal(line, GPIOD_STUB_LINE);
	errno = EINVAL;
	return gpiod_stub.no_line ? NULL : &the_line;
}

int gpiod_line_request_rising_edge_events(struct gpiod_line *line, const char *consumer)
{
	assert_ptr_equal(line, &the_line);
	assert_string_equal(consumer, "imu9-gateway");
	gpiod_stub.requests++;
	errno = EBUSY;
	return gpiod_stub.busy ? -1 : 0;
}

int gpiod_line_event_get_fd(struct gpiod_line *line)
{
	assert_ptr_equal(line, &the_line);
	return GPIOD_STUB_FD;
}

int gpiod_line_event_read(struct gpiod_line *line, struct gpiod_line_event *event)
{
	assert_ptr_equal(line, &the_line);
	gpiod_stub.events_read++;
	*event = (struct gpiod_line_event){.ts = {gpiod_stub.edge_ns / 1000000000, gpiod_stub.edge_ns % 1000000000}};
	return 0;
}

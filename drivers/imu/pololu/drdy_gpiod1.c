#include "drivers/imu/pololu/drdy.h"

#include <errno.h>
#include <gpiod.h>
#include <stdlib.h>

struct drdy {
	struct gpiod_chip *chip;
	struct gpiod_line *line;
};

struct drdy *drdy_open(const char *chip, unsigned line)
{
	struct drdy *drdy = calloc(1, sizeof(*drdy));
	int why;

	if (!drdy)
		return NULL;
	drdy->chip = gpiod_chip_open_lookup(chip);
	drdy->line = drdy->chip ? gpiod_chip_get_line(drdy->chip, line) : NULL;
	if (drdy->line && gpiod_line_request_rising_edge_events(drdy->line, "imu9-gateway") == 0)
		return drdy;
	why = errno;
	drdy_close(drdy);
	errno = why;
	return NULL;
}

int drdy_fd(const struct drdy *drdy)
{
	return gpiod_line_event_get_fd(drdy->line);
}

int drdy_read(struct drdy *drdy, int64_t *t_ns)
{
	struct gpiod_line_event event;

	if (gpiod_line_event_read(drdy->line, &event) < 0)
		return -1;
	*t_ns = (int64_t)event.ts.tv_sec * 1000000000 + event.ts.tv_nsec;
	return 0;
}

void drdy_close(struct drdy *drdy)
{
	if (!drdy)
		return;
	if (drdy->chip)
		gpiod_chip_close(drdy->chip); /* releases the line */
	free(drdy);
}

/* drivers/imu/pololu/drdy.h
 * A data-ready line: the rising edges of one GPIO line, through libgpiod. Its two APIs have nothing in common:
 * drdy_gpiod1.c is for version 1, drdy_gpiod2.c for version 2, and the Makefile takes the one that is installed. One
 * thread uses it. */
#ifndef DRIVERS_IMU_POLOLU_DRDY_H
#define DRIVERS_IMU_POLOLU_DRDY_H

#include <stdint.h>

struct drdy;

/** Requests line number `line` of the chip: its name (gpiochip0), number or path. NULL: errno says why. */
struct drdy *drdy_open(const char *chip, unsigned line);
/** Readable while there are edges. */
int drdy_fd(const struct drdy *drdy);
/** Takes the oldest edge; call it when drdy_fd() is readable. 0 and its time by CLOCK_MONOTONIC, or -1. */
int drdy_read(struct drdy *drdy, int64_t *t_ns);
/** Accepts NULL. */
void drdy_close(struct drdy *drdy);

#endif

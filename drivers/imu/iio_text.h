/* drivers/imu/iio_text.h
 * Parses attributes of the kernel's IIO drivers (Documentation/ABI/testing/sysfs-bus-iio). Pure. */
#ifndef DRIVERS_IMU_IIO_TEXT_H
#define DRIVERS_IMU_IIO_TEXT_H

#include <stddef.h>

#include "model/math/vec3.h"

/** "1, 0, 0; 0, 1, 0; 0, 0, 1": rows of the rotation from the axes of the chip to those of the device it is mounted
 * in. 0; 1: orthogonal, but it mirrors; -EINVAL: neither, `rows` is unchanged. */
int iio_parse_mount_matrix(const char *text, struct vec3 rows[3]);

/** Chooses from *_available, a list or "[FIRST STEP LAST]", the smallest value that is at least `wanted`; `token` is
 * its text in the list. 0; -ERANGE: all are smaller, `token` is the largest; -EINVAL: no values. */
int iio_choose(const char *available, double wanted, char *token, size_t size);

#endif

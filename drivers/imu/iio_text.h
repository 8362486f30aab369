/* drivers/imu/iio_text.h
 * What the kernel's IIO drivers say in their attribute files (Documentation/ABI/testing/sysfs-bus-iio). Pure. */
#ifndef DRIVERS_IMU_IIO_TEXT_H
#define DRIVERS_IMU_IIO_TEXT_H

#include <stddef.h>

#include "model/math/vec3.h"

/** "1, 0, 0; 0, 1, 0; 0, 0, 1": rows that turn a reading into the axes of the device the chip is built into. 0;
 * -EINVAL: no such matrix, or not a rotation; `rows` stays. */
int iio_parse_mount_matrix(const char *text, struct vec3 rows[3]);

/** Which of *_available is the smallest that is at least `wanted`: a list, or "[FIRST STEP LAST]". Into `token` as the
 * file has it. 0; -ERANGE: none is, `token` is the largest; -EINVAL: nothing there. */
int iio_choose(const char *available, double wanted, char *token, size_t size);

#endif

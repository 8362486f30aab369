#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

/* Tries twice, so that one disturbed transfer does not hide a chip. */
static bool is_there(const struct board *b, const struct chip *chip, uint8_t address, int *error)
{
	int result = board_identify(b, chip, address);

	if (result < 0)
		result = board_identify(b, chip, address);
	if (result < 0 && result != -ENODEV && *error != -EACCES && *error != -EBUSY)
		*error = result;
	return result == 0;
}

/* Adds a stream for the first of `candidates` that answers. */
static struct stream *find(struct board *b, const struct chip *const candidates[], int *error)
{
	for (; *candidates; candidates++)
		for (int i = 0; i < 2 && (*candidates)->addresses[i]; i++)
			if (is_there(b, *candidates, (*candidates)->addresses[i], error)) {
				struct stream *s = &b->streams[b->stream_count++];

				*s = (struct stream){.chip = *candidates, .address = (*candidates)->addresses[i]};
				return s;
			}
	return NULL;
}

static void name_board(struct board *b)
{
	static const struct {
		const char *name;
		const struct chip *gyro, *mag;
	} boards[] = {{"v0", &CHIP_L3G4200D, &CHIP_LSM303DLH_MAG}, {"v1", &CHIP_L3G4200D, &CHIP_LSM303DLM_MAG},
		{"v2", &CHIP_L3GD20, &CHIP_LSM303DLHC_MAG}, {"v3", &CHIP_L3GD20H, &CHIP_LSM303D_MAG},
		{"v5", &CHIP_LSM6DS33, &CHIP_LIS3MDL}, {"v6", &CHIP_LSM6DSO, &CHIP_LIS3MDL}};

	snprintf(b->name, sizeof b->name, "%s+%s", b->gyro->chip->name, b->mag->chip->name);
	for (size_t i = 0; i < sizeof boards / sizeof *boards; i++)
		if (b->gyro->chip == boards[i].gyro && b->mag->chip == boards[i].mag)
			snprintf(b->name, sizeof b->name, "%s", boards[i].name);
}

static int missing(const char *what, const char *where, int cause, char *error, size_t error_size)
{
	snprintf(error, error_size,
		"no %s answers at %s (%s): check power and wiring, and that no kernel driver is bound to the chip",
		what, where, cause ? strerror(-cause) : "other chips answer there");
	return cause ? cause : -ENODEV;
}

int board_detect(struct board *b, struct i2c_bus *bus, const struct board_clock *clock, char *error, size_t error_size)
{
	static const struct chip *const gyros[] = {
		&CHIP_LSM6DS33, &CHIP_LSM6DSO, &CHIP_L3GD20H, &CHIP_L3GD20, &CHIP_L3G4200D, NULL};
	static const struct chip *const accels[] = {
		&CHIP_LSM303D_ACCEL, &CHIP_LSM303DLHC_ACCEL, &CHIP_LSM303DLH_ACCEL, NULL};
	static const struct chip *const beside_lsm6[] = {&CHIP_LIS3MDL, NULL},
					*const beside_d[] = {&CHIP_LSM303D_MAG, NULL},
					*const beside_dlhc[] = {&CHIP_LSM303DLHC_MAG, NULL},
					*const beside_dlh[] = {&CHIP_LSM303DLM_MAG, &CHIP_LSM303DLH_MAG, NULL};
	int cause = 0;

	*b = (struct board){.bus = bus, .clock = *clock};
	b->gyro = find(b, gyros, &cause);
	if (!b->gyro)
		return missing("gyro", "68h to 6Bh", cause, error, error_size);
	cause = 0;
	b->accel = b->gyro->chip->triad_count == 2 ? b->gyro : find(b, accels, &cause);
	if (!b->accel)
		return missing("accelerometer", "18h, 19h, 1Dh or 1Eh", cause, error, error_size);
	cause = 0;
	b->mag = find(b,
		b->accel == b->gyro			   ? beside_lsm6
		: b->accel->chip == &CHIP_LSM303D_ACCEL	   ? beside_d
		: b->accel->chip == &CHIP_LSM303DLHC_ACCEL ? beside_dlhc
							   : beside_dlh,
		&cause);
	if (!b->mag)
		return missing("magnetometer", "1Ch to 1Eh", cause, error, error_size);
	name_board(b);
	return 0;
}

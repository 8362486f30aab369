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

/* Adds a stream for the first of `candidates` that answers. On SPI each device of the bus is asked. */
static struct stream *find(struct board *b, const struct chip *const candidates[], int *error)
{
	for (; *candidates; candidates++)
		for (uint8_t i = 0; i < (b->bus->spi ? SPI_DEVICES_MAX : 2); i++) {
			uint8_t address = b->bus->spi ? i : (*candidates)->addresses[i];

			if (b->bus->spi ? !(*candidates)->spi.has : address == 0)
				continue;
			if (is_there(b, *candidates, address, error)) {
				struct stream *s = &b->streams[b->stream_count++];

				*s = (struct stream){.chip = *candidates, .address = address};
				return s;
			}
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
	const struct chip *mag = b->mag ? b->mag->chip : NULL, *accel = b->accel->chip;

	for (size_t i = 0; i < sizeof boards / sizeof *boards; i++)
		if (b->gyro->chip == boards[i].gyro && mag == boards[i].mag) {
			snprintf(b->name, sizeof b->name, "%s", boards[i].name);
			return;
		}
	if (!mag && b->accel != b->gyro)
		mag = accel;
	if (!mag || strcmp(mag->name, b->gyro->chip->name) == 0)
		snprintf(b->name, sizeof b->name, "%s", b->gyro->chip->name);
	else
		snprintf(b->name, sizeof b->name, "%s+%s", b->gyro->chip->name, mag->name);
}

static int missing(
	const struct board *b, const char *what, const char *where, int cause, char *error, size_t error_size)
{
	if (b->bus->spi)
		snprintf(error, error_size,
			"no %s answers on SPI: name the device of each chip, check power and wiring, and try "
			"speed=100000",
			what);
	else
		snprintf(error, error_size,
			"no %s answers at %s (%s): check power and wiring, and that no kernel driver is bound to the "
			"chip",
			what, where, cause ? strerror(-cause) : "other chips answer there");
	return cause ? cause : -ENODEV;
}

/* At 19h is the accelerometer of an LSM303DLHC, or that of a DLH or DLM with SA0 high; neither has an identity. Boards
 * with an L3G4200D have the latter. */
static const struct chip *const *accels_beside(const struct chip *gyro)
{
	static const struct chip *const old[] = {&CHIP_LSM303D_ACCEL, &CHIP_LSM303DLH_ACCEL, NULL},
					*const others[] = {&CHIP_LSM303D_ACCEL, &CHIP_LSM303DLHC_ACCEL,
						&CHIP_LSM303DLH_ACCEL, NULL};

	return gyro == &CHIP_L3G4200D ? old : others;
}

/* The magnetometers that may belong to an accelerometer, in the order in which they are asked. */
static const struct chip *const *mags_beside(const struct chip *accel)
{
	static const struct chip
		*const lsm6[] = {&CHIP_LIS3MDL, NULL},
		       *const lsm9[] = {&CHIP_LSM9DS1_MAG, NULL}, *const icm20948[] = {&CHIP_AK09916, NULL},
		       *const d[] = {&CHIP_LSM303D_MAG, NULL}, *const dlhc[] = {&CHIP_LSM303DLHC_MAG, NULL},
		       *const dlh[] = {&CHIP_LSM303DLM_MAG, &CHIP_LSM303DLH_MAG, NULL}, *const none[] = {NULL};

	return accel == &CHIP_LSM6DS33 || accel == &CHIP_LSM6DSO ? lsm6
	       : accel == &CHIP_LSM9DS1				 ? lsm9
	       : accel == &CHIP_ICM20948			 ? icm20948
	       : accel == &CHIP_LSM303D_ACCEL			 ? d
	       : accel == &CHIP_LSM303DLHC_ACCEL		 ? dlhc
	       : accel == &CHIP_LSM303DLH_ACCEL			 ? dlh
								 : none;
}

/* The AK09916 is behind the ICM-20948, which must be awake and connect it to the bus. */
static void connect_mag(struct board *b)
{
	static const struct chip_register awake[] = {
		{0x7F, 0x00, 0}, {0x06, 0x01, 0}, {0x03, 0x00, 0}, {0x0F, 0x02, 0}};

	if (b->gyro->chip != &CHIP_ICM20948)
		return;
	for (size_t i = 0; i < sizeof awake / sizeof *awake; i++)
		for (int tries = 0; tries < 2; tries++) /* again, as in is_there() */
			if (i2c_write(b->bus, b->gyro->address, awake[i].address, awake[i].value) == 0)
				break;
}

static void find_mag(struct board *b)
{
	const struct chip *const *candidates = mags_beside(b->accel->chip);
	int cause = 0; /* of which the note says nothing */

	connect_mag(b);
	b->mag = find(b, candidates, &cause);
	if (b->mag)
		return;
	if (b->bus->spi && b->gyro->chip == &CHIP_ICM20948)
		snprintf(b->note, sizeof b->note,
			"on SPI the magnetometer of the ICM-20948 cannot be read: the heading is not known; use I2C");
	else if (*candidates)
		snprintf(b->note, sizeof b->note,
			"no magnetometer answers (%s beside the %s): the heading is not known", (*candidates)->name,
			b->gyro->chip->name);
	else
		snprintf(b->note, sizeof b->note, "the %s has no magnetometer: the heading is not known",
			b->gyro->chip->name);
}

int board_detect(struct board *b, struct i2c_bus *bus, const struct board_clock *clock, char *error, size_t error_size)
{
	/* those at the end are asked in another bank, by a write */
	static const struct chip *const gyros[] = {&CHIP_LSM6DS33, &CHIP_LSM6DSO, &CHIP_LSM9DS1, &CHIP_L3GD20H,
		&CHIP_L3GD20, &CHIP_L3G4200D, &CHIP_BMI270, &CHIP_ICM42688P, &CHIP_ICM20948, NULL};
	int cause = 0;

	*b = (struct board){.bus = bus, .clock = *clock};
	b->gyro = find(b, gyros, &cause);
	if (!b->gyro)
		return missing(b, "gyro", "68h to 6Bh", cause, error, error_size);
	cause = 0;
	b->accel = b->gyro->chip->triad_count == 2 ? b->gyro : find(b, accels_beside(b->gyro->chip), &cause);
	if (!b->accel)
		return missing(b, "accelerometer", "18h, 19h, 1Dh or 1Eh", cause, error, error_size);
	find_mag(b);
	name_board(b);
	return 0;
}

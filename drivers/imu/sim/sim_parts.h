/* drivers/imu/sim/sim_parts.h
 * Shared by the files behind sim_chips.h: sim_registers.c knows what the registers of each chip mean, sim_chips.c
 * samples, fills the FIFOs and answers on the bus. */
#ifndef DRIVERS_IMU_SIM_SIM_PARTS_H
#define DRIVERS_IMU_SIM_SIM_PARTS_H

#include "drivers/imu/sim/sim_chips.h"

enum { SIM_SETS = 32, SIM_WORDS = 4096, SIM_ENTRIES = 512, SIM_BANKS = 4, SIM_CONFIGURATION = 8192 };

enum sim_kind {
	L3G4200D,
	L3GD20,
	L3GD20H,
	DLH_ACCEL,
	DLHC_ACCEL,
	DLH_MAG,
	DLM_MAG,
	DLHC_MAG,
	LSM303D,
	LSM6DS33,
	LSM6DSO,
	LIS3MDL,
	LSM9DS1,
	LSM9DS1_MAG,
	ICM42688P,
	ICM20948,
	AK09916,
	BMI270,
	NONE
};

struct sim_triad {
	enum imu_chip what; /* 0: none */
	double rate_hz;	    /* 0: off */
	double rate_error;
	double lsb[3]; /* of the axes x, y, z; negative: the chip's axis points against the board's */
	double grain;  /* step of the word, in digits of lsb */
	struct vec3 self_test, deflection; /* of a self-test; deflection: instead of self_test, if a test has set it */
	bool axis_on[3];
	uint8_t out, status; /* registers: first data register, status */
	uint8_t order[3];    /* register pair of x, y, z */
	struct sensor sensor;
	double epoch_ns;
	int64_t taken;
	int16_t word[3]; /* x, y, z */
	bool ready, overrun;
	bool frozen, stopped, saturated, self_test_broken;
};

struct sim_chip {
	enum sim_kind kind;
	uint8_t address;
	uint8_t regs[256];
	uint8_t banks[SIM_BANKS][128]; /* ICM-20948: of banks 1 to 3 */
	struct sim_triad triads[2];
	bool silent;
	/* FIFO: bytes of sets, words, packets or tagged entries, oldest first */
	uint8_t fifo[SIM_WORDS * 2];
	size_t fifo_first, fifo_used, fifo_size, entry; /* in entries; entry: bytes of one */
	bool fifo_on, fifo_overrun;
	unsigned word_phase; /* LSM6DS33: position of the next word in its set */
	size_t entry_byte;   /* of the oldest entry, to be read next */
	unsigned tag_count;
	bool locked;	   /* AK09916: its data are being read */
	size_t configured; /* BMI270: bytes of the configuration file, in order */
	size_t written;	   /* bytes of this transfer */
	double loaded_ns;  /* BMI270: when it will have started with it; 0: it has not been told to */
};

static inline bool sim_is_l3g(enum sim_kind kind)
{
	return kind <= L3GD20H;
}

static inline bool sim_is_lsm6(enum sim_kind kind)
{
	return kind == LSM6DS33 || kind == LSM6DSO;
}

/* gyro and accelerometer sample together */
static inline bool sim_is_pair(enum sim_kind kind)
{
	return sim_is_lsm6(kind) || kind == LSM9DS1 || kind == ICM42688P || kind == ICM20948 || kind == BMI270;
}

static inline bool sim_is_old_mag(enum sim_kind kind)
{
	return kind == DLH_MAG || kind == DLM_MAG || kind == DLHC_MAG;
}

/* the data have the more significant byte first */
static inline bool sim_is_big_endian(enum sim_kind kind)
{
	return sim_is_old_mag(kind) || kind == ICM42688P || kind == ICM20948;
}

/* ---- sim_registers.c ---- */
void sim_make_chip(struct sim_chip *chip, enum sim_kind kind, uint8_t address);
/** The values after power-on. */
void sim_default_registers(struct sim_chip *chip);
/** Sets what follows from the registers: rates, digits, axes, self-test, FIFO. */
void sim_effect(struct sim_chip *chip);

#endif

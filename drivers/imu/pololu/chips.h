/* drivers/imu/pololu/chips.h
 * What the driver must know of each chip: how to recognise it, what can be set, which registers do that, and where and
 * in which form its data stand. Source: the data sheets of STMicroelectronics for the chips named. A device with one
 * oscillator is one struct chip; the LSM303D, whose accelerometer and magnetometer run on their own, is two. */
#ifndef DRIVERS_IMU_POLOLU_CHIPS_H
#define DRIVERS_IMU_POLOLU_CHIPS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/imu.h"

enum { CHIP_REGISTERS = 16, CHIP_TRIADS = 2, CHIP_BANDWIDTHS = 4 };

struct chip_register {
	uint8_t address, value;
};

/* What is written at the start, in this order; also what must still stand there later. */
struct chip_registers {
	struct chip_register at[CHIP_REGISTERS];
	size_t n;
};

struct chip_rate {
	double hz;
	uint8_t code;
	double bandwidth_hz[CHIP_BANDWIDTHS]; /* by code; 0: the chip has not so many */
};

/* SI units (rad/s, m/s^2), micro-tesla */
struct chip_range {
	double full_scale; /* deg/s, g, uT, as in struct imu_settings */
	double step;	   /* one digit of the 16-bit word */
	double step_z;	   /* where the z axis differs; 0: as the others */
	uint8_t code;
};

/* Settings as this chip has them. */
struct chip_setup {
	const struct chip_rate *rate;
	const struct chip_range *range[CHIP_TRIADS];
	double bandwidth_hz;
	uint8_t bandwidth_code;
	bool fifo;
	bool data_ready; /* on its interrupt line */
	bool stub;	 /* see board_plan() */
};

enum chip_fifo {
	CHIP_NO_FIFO,
	CHIP_FIFO_SETS,	  /* 32 sets, read through the data registers; level in FIFO_SRC 2Fh */
	CHIP_FIFO_WORDS,  /* LSM6DS33: words of gyro and accelerometer in turn at 3Eh, level 3Ah-3Dh */
	CHIP_FIFO_TAGGED, /* LSM6DSO: tag and three words at 78h, level 3Ah-3Bh */
};

struct chip_triad {
	enum imu_chip what;
	const struct chip_range *ranges; /* ends with full_scale 0 */
	uint8_t byte;			 /* of its first word in the data */
	uint8_t order[3];		 /* which of its words are x, y, z */
	double density;			 /* white noise, unit/sqrt(Hz) */
	uint8_t digit;			 /* the word moves in steps of so many (left-justified 12 bits: 16); 0: 1 */
	int16_t overflow;		 /* word that means "out of range"; 0: the ends of 16 bits do */
	struct {
		uint8_t address, mask, on;
		/* change of the output, either sign, of gyros in their widest range; most 0: no self-test that has
		 * limits */
		double least, most;
	} self_test;
};

struct chip {
	const char *name;
	uint8_t addresses[2]; /* 0: only one */
	/* these bytes stand there; none: whoever answers */
	uint8_t identity_at, identity[3];
	size_t identity_size;

	uint8_t increment; /* bit in the sub-address that makes a read go on to the next register */
	bool big_endian;
	uint8_t status, ready, overrun;
	uint8_t data, data_size;
	enum chip_fifo fifo;
	const struct chip_rate *rates; /* rising, ends with 0 Hz */
	struct chip_triad triads[CHIP_TRIADS];
	size_t triad_count;
	struct {
		uint8_t address, size; /* size 0: none */
		double per_digit, zero_degC;
	} temperature;
	void (*registers)(const struct chip_setup *setup, struct chip_registers *out);
};

extern const struct chip CHIP_L3G4200D, CHIP_L3GD20, CHIP_L3GD20H;
extern const struct chip CHIP_LSM303DLH_ACCEL, CHIP_LSM303DLHC_ACCEL, CHIP_LSM303D_ACCEL;
extern const struct chip CHIP_LSM303DLH_MAG, CHIP_LSM303DLM_MAG, CHIP_LSM303DLHC_MAG, CHIP_LSM303D_MAG;
extern const struct chip CHIP_LSM6DS33, CHIP_LSM6DSO, CHIP_LIS3MDL;

static inline void chip_put(struct chip_registers *out, uint8_t address, unsigned value)
{
	out->at[out->n++] = (struct chip_register){address, (uint8_t)value};
}

#endif

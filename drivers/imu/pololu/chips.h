/* drivers/imu/pololu/chips.h
 * Descriptions of the chips: identity, settings and the registers for them, address and format of the data. Sources:
 * the manufacturers' data sheets, named in each chips_*.c. A device with one oscillator is one struct chip; the
 * LSM303D, whose accelerometer and magnetometer sample independently, is two. */
#ifndef DRIVERS_IMU_POLOLU_CHIPS_H
#define DRIVERS_IMU_POLOLU_CHIPS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/imu.h"
#include "model/math/units.h"

enum { CHIP_REGISTERS = 20, CHIP_TRIADS = 2, CHIP_BANDWIDTHS = 8, CHIP_SET = CHIP_TRIADS * 6 };

struct board;

struct chip_register {
	uint8_t address, value;
	uint8_t bank; /* of a chip with banks */
};

/* Registers written at the start, in this order, and verified later. */
struct chip_registers {
	struct chip_register at[CHIP_REGISTERS];
	size_t n;
};

struct chip_rate {
	double hz;
	uint8_t code;
	double bandwidth_hz[CHIP_BANDWIDTHS]; /* by code; 0: the chip has no such code */
};

/* SI units (rad/s, m/s^2), micro-tesla */
struct chip_range {
	double full_scale; /* deg/s, g, uT, as in struct imu_settings */
	double step;	   /* one digit of the 16-bit word */
	double step_z;	   /* of the z axis if it differs; 0: as the others */
	uint8_t code;
};
/* Ranges of gyros and accelerometers whose full scale is 32768 digits; deg/s and g. */
#define CHIP_RANGE_DPS(full_scale, code)                                  \
	{                                                                 \
		full_scale, (full_scale) / 32768.0 * RAD_PER_DEG, 0, code \
	}
#define CHIP_RANGE_G(full_scale, code)                                              \
	{                                                                           \
		full_scale, (full_scale) / 32768.0 * STANDARD_GRAVITY_M_S2, 0, code \
	}

/* The settings chosen for this chip. */
struct chip_setup {
	const struct chip_rate *rate;
	const struct chip_range *range[CHIP_TRIADS];
	double bandwidth_hz;
	uint8_t bandwidth_code;
	bool fifo;
	bool data_ready; /* signal data ready on the interrupt line */
	bool stub;	 /* see board_plan() */
	bool spi;
};

enum chip_fifo {
	CHIP_NO_FIFO,
	CHIP_FIFO_SETS,	   /* 32 sets, read through the data registers; level in FIFO_SRC 2Fh */
	CHIP_FIFO_PAIRS,   /* LSM9DS1: the same, gyro and accelerometer each through its data registers */
	CHIP_FIFO_WORDS,   /* LSM6DS33: words of gyro and accelerometer in turn at 3Eh, level 3Ah-3Dh */
	CHIP_FIFO_TAGGED,  /* LSM6DSO: tag and three words at 78h, level 3Ah-3Bh */
	CHIP_FIFO_PACKETS, /* packets with both triads, see struct chip_packets */
};

struct chip_packets {
	uint8_t level;		       /* register of the number of bytes, two bytes in the order of the data */
	uint16_t level_mask;	       /* of the number */
	uint16_t depth;		       /* bytes; an overflow may leave a part of a packet at the beginning */
	uint8_t window;		       /* register of the content; its address does not advance */
	uint8_t size;		       /* bytes of a packet */
	uint8_t header, mask;	       /* of its first byte; mask 0: none */
	uint8_t at[CHIP_TRIADS];       /* first byte of each triad */
	struct chip_register flush[2]; /* what empties the FIFO; an address 0 ends it */
};

struct chip_self_test {
	uint8_t address, mask, on;
	uint8_t before; /* written for the first measurement, if the test compares two excitations; 0: off */
	bool widest;	/* the limits are specified for the widest range */
	/* limits of the change of each axis, either sign; most 0: no self-test with limits */
	struct vec3 least, most;
};

struct chip_triad {
	enum imu_chip what;
	const struct chip_range *ranges; /* ends with full_scale 0 */
	uint8_t byte;			 /* offset of its first word in the data registers */
	uint8_t order[3];		 /* positions of the words of x, y and z */
	uint8_t negative;		 /* bit 0: x of the chip points against x of the board; 1: y; 2: z */
	double density;			 /* white noise, unit/sqrt(Hz) */
	uint8_t digit;			 /* step of the word, 16 for left-justified 12 bits; 0: 1 */
	int16_t overflow;		 /* word that means "out of range"; 0: the ends of the 16-bit range */
	struct chip_self_test self_test;
};

struct chip {
	const char *name;
	uint8_t addresses[2]; /* on I2C; [1] 0: only one */
	/* bytes of the identity registers; size 0: any chip that answers */
	uint8_t identity_at, identity[3];
	size_t identity_size;

	uint8_t increment; /* auto-increment bit of the sub-address on I2C */
	struct {
		bool has;	  /* the chip can be read on SPI */
		uint8_t multiple; /* bit of the first byte for more than one register */
		uint8_t dummy;	  /* bytes before the data of a read */
	} spi;
	uint8_t bank_select; /* register with the bank in bits 4-5; 0: no banks */
	bool big_endian;
	uint8_t status, ready, overrun;
	uint8_t data, data_size;
	enum chip_fifo fifo;
	struct chip_packets packets;   /* of CHIP_FIFO_PACKETS */
	const struct chip_rate *rates; /* increasing, ends with 0 Hz */
	struct chip_triad triads[CHIP_TRIADS];
	size_t triad_count;
	struct {
		uint8_t address, size; /* size 0: none */
		double per_digit, zero_degC;
	} temperature;
	void (*registers)(const struct chip_setup *setup, struct chip_registers *out);

	/** Before the registers are written, e.g. the chip's firmware. 0 or -errno. NULL: nothing. */
	int (*prepare)(struct board *board, const struct chip *chip, uint8_t address);
	size_t firmware_size; /* of the file that prepare() needs; 0: none */
};

extern const struct chip CHIP_L3G4200D, CHIP_L3GD20, CHIP_L3GD20H;
extern const struct chip CHIP_LSM303DLH_ACCEL, CHIP_LSM303DLHC_ACCEL, CHIP_LSM303D_ACCEL;
extern const struct chip CHIP_LSM303DLH_MAG, CHIP_LSM303DLM_MAG, CHIP_LSM303DLHC_MAG, CHIP_LSM303D_MAG;
extern const struct chip CHIP_LSM6DS33, CHIP_LSM6DSO, CHIP_LIS3MDL;
extern const struct chip CHIP_LSM9DS1, CHIP_LSM9DS1_MAG;
extern const struct chip CHIP_ICM42688P, CHIP_ICM20948, CHIP_AK09916;
extern const struct chip CHIP_BMI270;

static inline void chip_put_bank(struct chip_registers *out, uint8_t bank, uint8_t address, unsigned value)
{
	out->at[out->n++] = (struct chip_register){address, (uint8_t)value, bank};
}

static inline void chip_put(struct chip_registers *out, uint8_t address, unsigned value)
{
	chip_put_bank(out, 0, address, value);
}

#endif

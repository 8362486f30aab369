/* drivers/i2c/i2c.h
 * A bus of chips with 8-bit registers, real or simulated. Transfers block. */
#ifndef DRIVERS_I2C_I2C_H
#define DRIVERS_I2C_I2C_H

#include <stddef.h>
#include <stdint.h>

enum { I2C_BLOCK_MAX = 32 }; /* bytes of one read: the limit of SMBus */

struct i2c_bus;

struct i2c_ops {
	/** Reads n bytes from register `sub` on. 0 or -errno (-ENXIO: no chip answers at that address). Bit 7 of `sub`
	 * is passed on: some chips use it for auto-increment. */
	int (*read)(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n);
	int (*write)(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t value);
	void (*close)(struct i2c_bus *bus);
};

struct i2c_bus {
	const struct i2c_ops *ops;
};

/** Opens /dev/i2c-N of Linux. 0, or -errno and one line in `error` that says what is wrong and what to do. */
int i2c_dev_open(const char *path, struct i2c_bus **bus, char *error, size_t error_size);

int i2c_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n);
int i2c_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t value);
void i2c_close(struct i2c_bus *bus);

#endif

/* drivers/i2c/i2c.h
 * A bus of chips with 8-bit registers, I2C or SPI, real or simulated. Transfers block.
 *
 * On SPI a chip has no address: `address` is the place of its device in the list that was opened, 0 for the first.
 * `sub` is the first byte of the transfer, as the chip wants it: bit 7 set for a read. A chip that is not there reads
 * as FFh or 00h, without an error. */
#ifndef DRIVERS_I2C_I2C_H
#define DRIVERS_I2C_I2C_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
	I2C_BLOCK_MAX = 32, /* bytes of one transfer: the limit of SMBus */
	SPI_DUMMY_MAX = 1,  /* and so many more in a read on SPI */
	SPI_DEVICES_MAX = 3,
};

struct i2c_bus;

struct i2c_ops {
	/** Reads n bytes from register `sub` on. 0 or -errno (-ENXIO: no chip answers at that address). Bit 7 of `sub`
	 * is passed on: some chips use it for auto-increment. */
	int (*read)(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n);
	/** Writes n bytes behind `sub` in one transfer. 0 or -errno. */
	int (*write)(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n);
	void (*close)(struct i2c_bus *bus);
};

struct i2c_bus {
	const struct i2c_ops *ops;
	bool spi;
};

struct spi_options {
	unsigned mode, speed_hz;
};

/** Opens /dev/i2c-N of Linux. 0, or -errno and one line in `error` that says what is wrong and what to do. */
int i2c_dev_open(const char *path, struct i2c_bus **bus, char *error, size_t error_size);

/** Opens count of /dev/spidevB.C of Linux as one bus; their addresses are 0, 1... Results as those of
 * i2c_dev_open(). */
int spi_dev_open(const char *const paths[], size_t count, const struct spi_options *options, struct i2c_bus **bus,
	char *error, size_t error_size);

int i2c_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n);
int i2c_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t value);
int i2c_write_block(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n);
void i2c_close(struct i2c_bus *bus);

#endif

#include "drivers/i2c/i2c.h"

#include <assert.h>

int i2c_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	assert(n > 0 && n <= I2C_BLOCK_MAX + (bus->spi ? SPI_DUMMY_MAX : 0));
	return bus->ops->read(bus, address, sub, bytes, n);
}

int i2c_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t value)
{
	return bus->ops->write(bus, address, sub, &value, 1);
}

int i2c_write_block(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	assert(n > 0 && n <= I2C_BLOCK_MAX);
	return bus->ops->write(bus, address, sub, bytes, n);
}

void i2c_close(struct i2c_bus *bus)
{
	if (bus)
		bus->ops->close(bus);
}

/* /dev/i2c-N. A combined write and read (I2C_RDWR) where the adapter supports it, else SMBus I2C block reads, as SMBus
 * hosts and the kernel's i2c-stub have them. */
#include <errno.h>
#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "drivers/i2c/i2c.h"

/* a chip that stretches the clock would block the thread for the kernel's default of 1 s */
enum { TIMEOUT_10MS = 2, RETRIES = 0 };

struct i2c_dev {
	struct i2c_bus bus;
	int fd;
	int slave; /* address last set by I2C_SLAVE; -1: none */
};

static int rdwr(struct i2c_dev *dev, struct i2c_msg *messages, unsigned n)
{
	struct i2c_rdwr_ioctl_data data = {.msgs = messages, .nmsgs = n};

	return ioctl(dev->fd, I2C_RDWR, &data) < 0 ? -errno : 0;
}

static int rdwr_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	struct i2c_msg messages[] = {{.addr = address, .len = 1, .buf = &sub},
		{.addr = address, .flags = I2C_M_RD, .len = (uint16_t)n, .buf = bytes}};

	return rdwr((struct i2c_dev *)bus, messages, 2);
}

static int rdwr_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	uint8_t all[1 + I2C_BLOCK_MAX] = {sub};
	struct i2c_msg message = {.addr = address, .len = (uint16_t)(1 + n), .buf = all};

	memcpy(all + 1, bytes, n);
	return rdwr((struct i2c_dev *)bus, &message, 1);
}

static int smbus(
	struct i2c_dev *dev, uint8_t address, uint8_t direction, uint8_t sub, uint32_t size, union i2c_smbus_data *data)
{
	struct i2c_smbus_ioctl_data transfer = {.read_write = direction, .command = sub, .size = size, .data = data};

	/* not I2C_SLAVE_FORCE: that would disturb a kernel driver that is bound to the chip */
	if (dev->slave != address && ioctl(dev->fd, I2C_SLAVE, (unsigned long)address) < 0)
		return -errno;
	dev->slave = address;
	return ioctl(dev->fd, I2C_SMBUS, &transfer) < 0 ? -errno : 0;
}

static int smbus_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	union i2c_smbus_data data = {.block = {(uint8_t)n}};
	int result = smbus((struct i2c_dev *)bus, address, I2C_SMBUS_READ, sub, I2C_SMBUS_I2C_BLOCK_DATA, &data);

	if (result < 0)
		return result;
	if (data.block[0] != n)
		return -EIO;
	memcpy(bytes, data.block + 1, n);
	return 0;
}

static int smbus_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	union i2c_smbus_data data = {.byte = bytes[0]};

	if (n == 1)
		return smbus((struct i2c_dev *)bus, address, I2C_SMBUS_WRITE, sub, I2C_SMBUS_BYTE_DATA, &data);
	data.block[0] = (uint8_t)n;
	memcpy(data.block + 1, bytes, n);
	return smbus((struct i2c_dev *)bus, address, I2C_SMBUS_WRITE, sub, I2C_SMBUS_I2C_BLOCK_DATA, &data);
}

static void dev_close(struct i2c_bus *bus)
{
	close(((struct i2c_dev *)bus)->fd);
	free(bus);
}

static const struct i2c_ops RDWR = {rdwr_read, rdwr_write, dev_close};
static const struct i2c_ops SMBUS = {smbus_read, smbus_write, dev_close};

static const struct i2c_ops *choose(unsigned long functions)
{
	const unsigned long needed = I2C_FUNC_SMBUS_READ_I2C_BLOCK | I2C_FUNC_SMBUS_WRITE_BYTE_DATA;

	if (functions & I2C_FUNC_I2C)
		return &RDWR;
	return (functions & needed) == needed ? &SMBUS : NULL;
}

static const char *advice(int error)
{
	return error == ENOENT	 ? ": enable the bus (`modprobe i2c-dev`; on a Raspberry Pi dtparam=i2c_arm=on); "
				   "`i2cdetect -l` lists the buses"
	       : error == EACCES ? ": add this user to the group i2c"
				 : "";
}

int i2c_dev_open(const char *path, struct i2c_bus **bus, char *error, size_t error_size)
{
	unsigned long functions = 0;
	int fd = open(path, O_RDWR | O_CLOEXEC), result;
	struct i2c_dev *dev;

	if (fd < 0 || ioctl(fd, I2C_FUNCS, &functions) < 0) {
		result = -errno;
		snprintf(error, error_size, "%s: %s%s", path, strerror(-result),
			result == -ENOTTY ? ": not an I2C bus: use /dev/i2c-N" : advice(-result));
		if (fd >= 0)
			close(fd);
		return result;
	}
	dev = calloc(1, sizeof *dev);
	if (!dev || !choose(functions)) {
		snprintf(error, error_size, "%s: %s", path,
			dev ? "this adapter supports neither I2C nor SMBus I2C block reads: use another one"
			    : "out of memory");
		free(dev);
		close(fd);
		return -ENOTSUP;
	}
	ioctl(fd, I2C_TIMEOUT, (unsigned long)TIMEOUT_10MS);
	ioctl(fd, I2C_RETRIES, (unsigned long)RETRIES);
	*dev = (struct i2c_dev){.bus.ops = choose(functions), .fd = fd, .slave = -1};
	*bus = &dev->bus;
	return 0;
}

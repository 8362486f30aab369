/* /dev/spidevB.C: each device is one chip select. A transfer is the register's byte, then the data. */
#include <errno.h>
#include <fcntl.h>
#include <linux/spi/spidev.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "drivers/i2c/i2c.h"

struct spi_dev {
	struct i2c_bus bus;
	int fd[SPI_DEVICES_MAX];
	size_t count;
	uint32_t speed_hz;
};

static int transfer(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *out, uint8_t *in, size_t n)
{
	const struct spi_dev *dev = (struct spi_dev *)bus;
	struct spi_ioc_transfer parts[] = {{.tx_buf = (uintptr_t)&sub, .len = 1, .speed_hz = dev->speed_hz},
		{.tx_buf = (uintptr_t)out, .rx_buf = (uintptr_t)in, .len = (uint32_t)n, .speed_hz = dev->speed_hz}};

	if (address >= dev->count)
		return -ENXIO;
	return ioctl(dev->fd[address], SPI_IOC_MESSAGE(2), parts) < 0 ? -errno : 0;
}

static int spi_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	return transfer(bus, address, sub, NULL, bytes, n);
}

static int spi_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	return transfer(bus, address, sub, bytes, NULL, n);
}

static void spi_close(struct i2c_bus *bus)
{
	struct spi_dev *dev = (struct spi_dev *)bus;

	for (size_t i = 0; i < dev->count; i++)
		close(dev->fd[i]);
	free(dev);
}

static const struct i2c_ops SPI = {spi_read, spi_write, spi_close};

static const char *advice(int error)
{
	return error == ENOENT
		       ? ": enable the bus (on a Raspberry Pi dtparam=spi=on); `ls /dev/spidev*` lists its devices"
	       : error == EACCES ? ": add this user to the group spi, or permit it by a udev rule"
	       : error == ENOTTY ? ": not an SPI device: use /dev/spidevB.C"
	       : error == EINVAL ? ": its controller does not support this mode: use mode=0 or mode=3"
				 : "";
}

static int open_one(const char *path, const struct spi_options *options)
{
	const uint8_t bits = 8, mode = (uint8_t)options->mode;
	int fd = open(path, O_RDWR | O_CLOEXEC), result;

	if (fd < 0)
		return -errno;
	if (ioctl(fd, SPI_IOC_WR_MODE, &mode) == 0 && ioctl(fd, SPI_IOC_WR_BITS_PER_WORD, &bits) == 0)
		return fd;
	result = -errno;
	close(fd);
	return result;
}

int spi_dev_open(const char *const paths[], size_t count, const struct spi_options *options, struct i2c_bus **bus,
	char *error, size_t error_size)
{
	struct spi_dev *dev = calloc(1, sizeof *dev);

	if (!dev)
		return -ENOMEM;
	*dev = (struct spi_dev){.bus = {.ops = &SPI, .spi = true}, .speed_hz = options->speed_hz};
	for (; dev->count < count; dev->count++) {
		int fd = open_one(paths[dev->count], options);

		if (fd < 0) {
			snprintf(error, error_size, "%s: %s%s", paths[dev->count], strerror(-fd), advice(-fd));
			spi_close(&dev->bus);
			return fd;
		}
		dev->fd[dev->count] = fd;
	}
	*bus = &dev->bus;
	return 0;
}

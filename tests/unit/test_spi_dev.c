/* /dev/spidevB.C on a kernel that is simulated at open() and ioctl(), which are defined here. Requests and structs:
 * Documentation/spi/spidev, linux/spi/spidev.h. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/spi/spidev.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/imu.h"
#include "tests/unit/descriptors.h"

enum { DEVICES = 3 };

static struct kernel {
	int open_error, mode_error, transfer_error;
	int fds[DEVICES]; /* of /dev/spidev0.0... */
	uint8_t mode[DEVICES], bits[DEVICES];

	/* the last transfer */
	int device;
	uint32_t speed_hz[2], length[2];
	uint8_t out[2][40], answer;
	bool is_read;
	unsigned transfers;
} k;

static int failed(int error)
{
	errno = error;
	return -1;
}

int open(const char *path, int flags, ...)
{
	int (*real)(const char *, int, ...);
	int device;

	if (sscanf(path, "/dev/spidev0.%d", &device) == 1 && device < DEVICES) {
		assert_int_equal(flags & O_ACCMODE, O_RDWR);
		return k.open_error ? failed(k.open_error) : (k.fds[device] = eventfd(0, EFD_CLOEXEC));
	}
	*(void **)&real = dlsym(RTLD_NEXT, "open");
	return real(path, flags, 0600);
}

static int transfer(const struct spi_ioc_transfer parts[2])
{
	k.transfers++;
	for (int i = 0; i < 2; i++) {
		k.speed_hz[i] = parts[i].speed_hz;
		k.length[i] = parts[i].len;
		assert_in_range(parts[i].len, 1, sizeof k.out[0]);
		assert_int_equal(parts[i].cs_change, 0); /* one chip select for both */
		if (parts[i].tx_buf)
			memcpy(k.out[i], (const void *)(uintptr_t)parts[i].tx_buf, parts[i].len);
	}
	k.is_read = parts[1].rx_buf != 0;
	if (parts[1].rx_buf)
		for (uint32_t i = 0; i < parts[1].len; i++)
			((uint8_t *)(uintptr_t)parts[1].rx_buf)[i] = (uint8_t)(k.answer + i);
	return k.transfer_error ? failed(k.transfer_error) : (int)(parts[0].len + parts[1].len);
}

int ioctl(int fd, unsigned long request, ...)
{
	const void *pointer;
	va_list args;
	int device = 0;

	va_start(args, request);
	pointer = va_arg(args, void *);
	va_end(args);
	while (device < DEVICES && k.fds[device] != fd)
		device++;
	assert_in_range(device, 0, DEVICES - 1);
	if (request == SPI_IOC_WR_MODE) {
		k.mode[device] = *(const uint8_t *)pointer;
		return k.mode_error ? failed(k.mode_error) : 0;
	}
	if (request == SPI_IOC_WR_BITS_PER_WORD) {
		k.bits[device] = *(const uint8_t *)pointer;
		return 0;
	}
	assert_int_equal(request, SPI_IOC_MESSAGE(2));
	k.device = device;
	return transfer(pointer);
}

static const char *const PATHS[] = {"/dev/spidev0.0", "/dev/spidev0.1"};

static struct i2c_bus *opened(size_t count)
{
	const struct spi_options options = {.mode = 3, .speed_hz = 2000000};
	struct i2c_bus *bus;
	char error[200] = "";

	k = (struct kernel){.answer = 0xA0};
	if (spi_dev_open(PATHS, count, &options, &bus, error, sizeof error) != 0)
		fail_msg("%s", error);
	return bus;
}

static void test_a_register_is_read_behind_its_byte_under_one_chip_select(void **state)
{
	struct i2c_bus *bus = opened(2);
	uint8_t bytes[6];

	(void)state;
	assert_true(bus->spi);
	assert_int_equal(k.mode[0], 3);
	assert_int_equal(k.bits[1], 8);
	assert_int_equal(i2c_read(bus, 1, 0xE8, bytes, 6), 0);
	assert_memory_equal(bytes, "\xA0\xA1\xA2\xA3\xA4\xA5", 6);
	assert_int_equal(k.device, 1);
	assert_int_equal(k.length[0], 1);
	assert_int_equal(k.out[0][0], 0xE8);
	assert_int_equal(k.length[1], 6);
	assert_true(k.is_read);
	assert_int_equal(k.speed_hz[0], 2000000);
	assert_int_equal(k.speed_hz[1], 2000000);
	i2c_close(bus);
}

static void test_registers_are_written_behind_the_first_ones_byte(void **state)
{
	static const uint8_t block[] = {1, 2, 3};
	struct i2c_bus *bus = opened(1);

	(void)state;
	assert_int_equal(i2c_write(bus, 0, 0x20, 0x8F), 0);
	assert_int_equal(k.out[0][0], 0x20);
	assert_int_equal(k.length[1], 1);
	assert_int_equal(k.out[1][0], 0x8F);
	assert_false(k.is_read);
	assert_int_equal(i2c_write_block(bus, 0, 0x5E, block, sizeof block), 0);
	assert_int_equal(k.length[1], 3);
	assert_memory_equal(k.out[1], block, 3);
	i2c_close(bus);
}

static void test_a_failed_transfer_and_a_device_that_was_not_opened_are_errors(void **state)
{
	struct i2c_bus *bus = opened(1);
	uint8_t byte;

	(void)state;
	assert_int_equal(i2c_read(bus, 1, 0x8F, &byte, 1), -ENXIO);
	k.transfer_error = EIO;
	assert_int_equal(i2c_read(bus, 0, 0x8F, &byte, 1), -EIO);
	assert_int_equal(i2c_write(bus, 0, 0x20, 0), -EIO);
	i2c_close(bus);
}

static void assert_refused(struct kernel kernel, const char *src, const char *words)
{
	struct imu_port *port = NULL;
	char error[400] = "";

	k = kernel;
	assert_true(imu_open(src, NULL, &port, error, sizeof error) < 0);
	if (!strstr(error, words))
		fail_msg("%s: '%s' does not say '%s'", src, error, words);
	assert_null(port);
}

static void test_what_cannot_be_opened_is_refused_with_what_to_do(void **state)
{
	(void)state;
	assert_refused((struct kernel){.open_error = ENOENT}, "spi:/dev/spidev0.0", "dtparam=spi=on");
	assert_refused((struct kernel){.open_error = EACCES}, "spi:/dev/spidev0.0", "group spi");
	assert_refused((struct kernel){.mode_error = ENOTTY}, "spi:/dev/spidev0.0", "use /dev/spidevB.C");
	assert_refused((struct kernel){.mode_error = EINVAL}, "spi:/dev/spidev0.0,mode=0", "use mode=0 or mode=3");
	assert_refused((struct kernel){.answer = 0x33}, "spi:/dev/spidev0.0", "no gyro answers on SPI");
	assert_refused((struct kernel){.answer = 0x33}, "spi:/dev/spidev0.0,/dev/spidev0.1",
		"spi:/dev/spidev0.0: no gyro answers on SPI");
	assert_refused((struct kernel){0}, "spi", "no device: use spi:/dev/spidevB.C");
	assert_refused((struct kernel){0}, "spi:mode=3", "no device");
	assert_refused((struct kernel){0}, "spi:/dev/spidev0.0,mode=1", "mode=3");
	assert_refused((struct kernel){0}, "spi:/dev/spidev0.0,speed=1", "speed=1000000");
	assert_refused((struct kernel){0}, "spi:/dev/spidev0.0,speed=1e9", "speed=1000000");
	assert_refused((struct kernel){0}, "spi:/a,/b,/c,/d", "'/d'");
	assert_refused((struct kernel){0}, "spi:/dev/spidev0.0,drdy=5", "drdy=GPIOCHIP:LINE");
}

static void test_mode_and_speed_are_those_of_the_options(void **state)
{
	(void)state;
	assert_refused(
		(struct kernel){.answer = 0x33}, "spi:/dev/spidev0.0,/dev/spidev0.1,mode=0,speed=5e6", "no gyro");
	assert_int_equal(k.mode[0], 0);
	assert_int_equal(k.mode[1], 0);
	assert_int_equal(k.speed_hz[0], 5000000);
	assert_true(k.transfers > 10); /* it has asked for each chip */
	assert_refused((struct kernel){.answer = 0x33}, "spi:/dev/spidev0.0", "no gyro");
	assert_int_equal(k.mode[0], 3);
	assert_int_equal(k.speed_hz[0], 1000000);
}

/* The dummy byte is 23h, CHIP_ID behind it 24h: a BMI270. */
static void test_a_bmi270_without_its_configuration_file_is_refused_with_what_to_do(void **state)
{
	char small[] = "/tmp/imu9-bmi270-XXXXXX", src[100];
	int fd = mkstemp(small);

	(void)state;
	assert_int_equal(write(fd, "not the file", 12), 12);
	close(fd);
	assert_refused((struct kernel){.answer = 0x23}, "spi:/dev/spidev0.0,config=/nowhere/bmi.fw",
		"the BMI270 needs its configuration file /nowhere/bmi.fw: No such file");
	assert_refused((struct kernel){.answer = 0x23}, "spi:/dev/spidev0.0,config=/nowhere/bmi.fw", "8192 bytes");
	snprintf(src, sizeof src, "spi:/dev/spidev0.0,config=%s", small);
	assert_refused((struct kernel){.answer = 0x23}, src, "it has another size");
	remove(small);
}

/* As the gateway does it at each start, and with --check. */
static void test_how_a_source_is_written_is_checked_without_the_device(void **state)
{
	char error[300];

	(void)state;
	k = (struct kernel){.open_error = EACCES};
	assert_int_equal(imu_open("spi:/dev/spidev0.0,/dev/spidev0.1,mode=0", NULL, NULL, error, sizeof error), 0);
	assert_int_equal(imu_open("spi:/dev/spidev0.0,mode=1", NULL, NULL, error, sizeof error), -EINVAL);
	k = (struct kernel){.answer = 0xD4};
	assert_int_equal(imu_open("spi:/dev/spidev0.0", NULL, NULL, error, sizeof error), 0);
	assert_int_equal(k.transfers, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_register_is_read_behind_its_byte_under_one_chip_select),
		cmocka_unit_test(test_registers_are_written_behind_the_first_ones_byte),
		cmocka_unit_test(test_a_failed_transfer_and_a_device_that_was_not_opened_are_errors),
		cmocka_unit_test(test_what_cannot_be_opened_is_refused_with_what_to_do),
		cmocka_unit_test(test_mode_and_speed_are_those_of_the_options),
		cmocka_unit_test(test_a_bmi270_without_its_configuration_file_is_refused_with_what_to_do),
		cmocka_unit_test(test_how_a_source_is_written_is_checked_without_the_device),
	};

	return cmocka_run_group_tests_name("spi_dev", tests, count_descriptors, no_descriptor_is_left);
}

/* /dev/i2c-N on a kernel that is simulated at open() and ioctl(), which are defined here. Requests and structs:
 * Documentation/i2c/dev-interface, linux/i2c-dev.h. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>

#include "drivers/i2c/i2c.h"
#include "tests/unit/descriptors.h"

static struct kernel {
	int open_error, funcs_error;
	unsigned long functions;
	unsigned long timeout, retries;
	int transfer_error, slave_error;

	/* the last transfer */
	unsigned messages;
	struct {
		uint16_t address, flags, length;
		uint8_t bytes[8];
	} message[4];
	unsigned long slave;
	unsigned slave_calls;
	struct i2c_smbus_ioctl_data smbus;
	uint8_t smbus_byte, smbus_block, written[5];
	uint8_t answer[I2C_BLOCK_MAX], answer_size; /* bytes that the chip gives */
} k;

static int failed(int error)
{
	errno = error;
	return -1;
}

int open(const char *path, int flags, ...)
{
	if (strcmp(path, "/dev/i2c-7") != 0) { /* gcov's */
		int (*real)(const char *, int, ...);

		*(void **)&real = dlsym(RTLD_NEXT, "open");
		return real(path, flags, 0600);
	}
	assert_int_equal(flags & O_ACCMODE, O_RDWR);
	return k.open_error ? failed(k.open_error) : eventfd(0, EFD_CLOEXEC);
}

static int transfer(const struct i2c_rdwr_ioctl_data *data)
{
	k.messages = data->nmsgs;
	for (unsigned i = 0; i < data->nmsgs; i++) {
		const struct i2c_msg *m = &data->msgs[i];

		k.message[i].address = m->addr;
		k.message[i].flags = m->flags;
		k.message[i].length = m->len;
		if (m->flags & I2C_M_RD)
			memcpy(m->buf, k.answer, m->len);
		else
			memcpy(k.message[i].bytes, m->buf, m->len);
	}
	return k.transfer_error ? failed(k.transfer_error) : (int)data->nmsgs;
}

static int smbus(const struct i2c_smbus_ioctl_data *data)
{
	k.smbus = *data;
	if (data->read_write == I2C_SMBUS_WRITE) {
		k.smbus_byte = data->data->byte;
		memcpy(k.written, data->data->block, sizeof(k.written));
	} else {
		k.smbus_block = data->data->block[0]; /* so many are asked for */
		data->data->block[0] = k.answer_size;
		memcpy(data->data->block + 1, k.answer, k.answer_size);
	}
	return k.transfer_error ? failed(k.transfer_error) : 0;
}

int ioctl(int fd, unsigned long request, ...)
{
	unsigned long number;
	void *pointer;
	va_list args;

	(void)fd;
	va_start(args, request);
	pointer = va_arg(args, void *);
	number = (unsigned long)pointer;
	va_end(args);
	switch (request) {
	case I2C_FUNCS:
		*(unsigned long *)pointer = k.functions;
		return k.funcs_error ? failed(k.funcs_error) : 0;
	case I2C_TIMEOUT:
		k.timeout = number;
		return 0;
	case I2C_RETRIES:
		k.retries = number;
		return 0;
	case I2C_SLAVE:
		k.slave = number;
		k.slave_calls++;
		return k.slave_error ? failed(k.slave_error) : 0;
	case I2C_RDWR:
		return transfer(pointer);
	case I2C_SMBUS:
		return smbus(pointer);
	}
	fail_msg("ioctl %lx", request);
	return -1;
}

static struct i2c_bus *bus;

static void open_with(unsigned long functions)
{
	char error[200] = "";

	k = (struct kernel){.functions = functions, .retries = 99};
	for (uint8_t i = 0; i < sizeof(k.answer); i++)
		k.answer[i] = (uint8_t)(0xA0 + i);
	if (i2c_dev_open("/dev/i2c-7", &bus, error, sizeof(error)) != 0)
		fail_msg("%s", error);
}

static void test_a_register_is_read_by_a_write_of_its_number_and_a_repeated_start(void **state)
{
	uint8_t bytes[6];

	(void)state;
	open_with(I2C_FUNC_I2C);
	assert_int_equal(i2c_read(bus, 0x6B, 0xA8, bytes, 6), 0);
	assert_memory_equal(bytes, "\xA0\xA1\xA2\xA3\xA4\xA5", 6);
	assert_int_equal(k.messages, 2);
	assert_int_equal(k.message[0].address, 0x6B);
	assert_int_equal(k.message[0].flags, 0);
	assert_int_equal(k.message[0].length, 1);
	assert_int_equal(k.message[0].bytes[0], 0xA8);
	assert_int_equal(k.message[1].address, 0x6B);
	assert_int_equal(k.message[1].flags, I2C_M_RD);
	assert_int_equal(k.message[1].length, 6);
	i2c_close(bus);
}

static void test_a_register_is_written_in_one_message(void **state)
{
	(void)state;
	open_with(I2C_FUNC_I2C);
	assert_int_equal(i2c_write(bus, 0x1D, 0x20, 0x8F), 0);
	assert_int_equal(k.messages, 1);
	assert_int_equal(k.message[0].address, 0x1D);
	assert_int_equal(k.message[0].flags, 0);
	assert_int_equal(k.message[0].length, 2);
	assert_memory_equal(k.message[0].bytes, "\x20\x8F", 2);
	i2c_close(bus);
}

static void test_a_block_is_written_in_one_message(void **state)
{
	static const uint8_t block[] = {1, 2, 3, 4};

	(void)state;
	open_with(I2C_FUNC_I2C);
	assert_int_equal(i2c_write_block(bus, 0x68, 0x5E, block, sizeof block), 0);
	assert_int_equal(k.messages, 1);
	assert_int_equal(k.message[0].length, 5);
	assert_memory_equal(k.message[0].bytes, "\x5E\x01\x02\x03\x04", 5);
	i2c_close(bus);
	open_with(I2C_FUNC_SMBUS_READ_I2C_BLOCK | I2C_FUNC_SMBUS_WRITE_BYTE_DATA);
	assert_int_equal(i2c_write_block(bus, 0x68, 0x5E, block, sizeof block), 0);
	assert_int_equal(k.smbus.size, I2C_SMBUS_I2C_BLOCK_DATA);
	assert_int_equal(k.smbus.command, 0x5E);
	assert_memory_equal(k.written, "\x04\x01\x02\x03\x04", 5);
	i2c_close(bus);
}

static void test_an_adapter_without_i2c_messages_is_read_by_smbus_blocks(void **state)
{
	uint8_t bytes[6];

	(void)state;
	open_with(I2C_FUNC_SMBUS_READ_I2C_BLOCK | I2C_FUNC_SMBUS_WRITE_BYTE_DATA);
	k.answer_size = 6;
	assert_int_equal(i2c_read(bus, 0x6B, 0xA8, bytes, 6), 0);
	assert_memory_equal(bytes, "\xA0\xA1\xA2\xA3\xA4\xA5", 6);
	assert_int_equal(k.slave, 0x6B);
	assert_int_equal(k.smbus.read_write, I2C_SMBUS_READ);
	assert_int_equal(k.smbus.command, 0xA8);
	assert_int_equal(k.smbus.size, I2C_SMBUS_I2C_BLOCK_DATA);
	assert_int_equal(k.smbus_block, 6);
	assert_int_equal(i2c_write(bus, 0x6B, 0x20, 0x8F), 0);
	assert_int_equal(k.smbus.read_write, I2C_SMBUS_WRITE);
	assert_int_equal(k.smbus.command, 0x20);
	assert_int_equal(k.smbus.size, I2C_SMBUS_BYTE_DATA);
	assert_int_equal(k.smbus_byte, 0x8F);
	i2c_close(bus);
}

static void test_the_chip_is_selected_when_it_is_another_one(void **state)
{
	uint8_t byte;

	(void)state;
	open_with(I2C_FUNC_SMBUS_READ_I2C_BLOCK | I2C_FUNC_SMBUS_WRITE_BYTE_DATA);
	k.answer_size = 1;
	i2c_read(bus, 0x6B, 0x0F, &byte, 1);
	i2c_read(bus, 0x6B, 0x0F, &byte, 1);
	assert_int_equal(k.slave_calls, 1);
	i2c_write(bus, 0x1D, 0x20, 0);
	assert_int_equal(k.slave_calls, 2);
	assert_int_equal(k.slave, 0x1D);
	k.slave_error = EBUSY; /* a kernel driver has it */
	assert_int_equal(i2c_read(bus, 0x1E, 0x0F, &byte, 1), -EBUSY);
	i2c_close(bus);
}

static void test_what_the_kernel_refuses_is_an_error_and_so_is_a_short_block(void **state)
{
	uint8_t bytes[6];

	(void)state;
	open_with(I2C_FUNC_I2C);
	k.transfer_error = ENXIO;
	assert_int_equal(i2c_read(bus, 0x6B, 0x0F, bytes, 1), -ENXIO);
	assert_int_equal(i2c_write(bus, 0x6B, 0x20, 0), -ENXIO);
	i2c_close(bus);
	open_with(I2C_FUNC_SMBUS_READ_I2C_BLOCK | I2C_FUNC_SMBUS_WRITE_BYTE_DATA);
	k.answer_size = 5;
	assert_int_equal(i2c_read(bus, 0x6B, 0x28, bytes, 6), -EIO);
	k.transfer_error = EREMOTEIO;
	assert_int_equal(i2c_read(bus, 0x6B, 0x28, bytes, 6), -EREMOTEIO);
	assert_int_equal(i2c_write(bus, 0x6B, 0x20, 0), -EREMOTEIO);
	i2c_close(bus);
}

/* A chip that holds the clock must not hold the thread for the kernel's second. */
static void test_a_transfer_may_take_20_ms_and_is_not_repeated_by_the_kernel(void **state)
{
	(void)state;
	open_with(I2C_FUNC_I2C);
	assert_int_equal(k.timeout, 2); /* in 10 ms */
	assert_int_equal(k.retries, 0);
	i2c_close(bus);
}

static void assert_refused(struct kernel kernel, int result, const char *words)
{
	char error[200] = "";

	k = kernel;
	assert_int_equal(i2c_dev_open("/dev/i2c-7", &bus, error, sizeof(error)), result);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
}

static void test_a_bus_that_cannot_be_used_is_refused_with_what_to_do(void **state)
{
	(void)state;
	assert_refused((struct kernel){.open_error = ENOENT}, -ENOENT, "modprobe i2c-dev");
	assert_refused((struct kernel){.open_error = EACCES}, -EACCES, "group i2c");
	assert_refused((struct kernel){.funcs_error = ENOTTY}, -ENOTTY, "not an I2C bus");
	assert_refused((struct kernel){.functions = I2C_FUNC_SMBUS_READ_I2C_BLOCK}, -ENOTSUP, "SMBus");
	assert_refused((struct kernel){.functions = I2C_FUNC_SMBUS_WRITE_BYTE_DATA}, -ENOTSUP, "SMBus");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_register_is_read_by_a_write_of_its_number_and_a_repeated_start),
		cmocka_unit_test(test_a_register_is_written_in_one_message),
		cmocka_unit_test(test_a_block_is_written_in_one_message),
		cmocka_unit_test(test_an_adapter_without_i2c_messages_is_read_by_smbus_blocks),
		cmocka_unit_test(test_the_chip_is_selected_when_it_is_another_one),
		cmocka_unit_test(test_what_the_kernel_refuses_is_an_error_and_so_is_a_short_block),
		cmocka_unit_test(test_a_transfer_may_take_20_ms_and_is_not_repeated_by_the_kernel),
		cmocka_unit_test(test_a_bus_that_cannot_be_used_is_refused_with_what_to_do),
	};

	return cmocka_run_group_tests_name("i2c_dev", tests, count_descriptors, no_descriptor_is_left);
}

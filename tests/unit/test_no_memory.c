/* A host without memory: this program's calloc() is the one that the drivers call. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/can.h"
#include "drivers/ports/imu.h"

static bool no_memory;
static int calls, failing; /* the call with this number fails; 0: none */

/* The compiler may not make a calloc() of malloc() and memset(). */
static void *(*volatile allocate)(size_t size) = malloc;

void *calloc(size_t count, size_t size)
{
	void *p;

	if (no_memory || ++calls == failing) {
		errno = ENOMEM;
		return NULL;
	}
	p = allocate(count * size);
	if (p)
		memset(p, 0, count * size);
	return p;
}

static void test_a_bus_is_not_opened_and_the_message_says_why(void **state)
{
	static const char *const buses[] = {"udp", "slcan:/dev/null", "can0", "gs_usb"};

	(void)state;
	for (size_t i = 0; i < sizeof buses / sizeof *buses; i++) {
		struct can_port *port = NULL;
		char error[200] = "??";
		int result;

		no_memory = true;
		result = can_open(buses[i], &port, error, sizeof error);
		no_memory = false;
		assert_int_equal(result, -ENOMEM);
		assert_null(port);
		assert_non_null(strstr(error, buses[i]));
		assert_non_null(strstr(error, "Cannot allocate memory"));
	}
}

static void test_a_bus_of_chips_is_not_opened(void **state)
{
	static const char *const paths[] = {"/dev/null"};
	const struct spi_options options = {.mode = 3, .speed_hz = 1000000};
	struct i2c_bus *bus = NULL;
	char error[200] = "";

	(void)state;
	no_memory = true;
	assert_int_equal(spi_dev_open(paths, 1, &options, &bus, error, sizeof error), -ENOMEM);
	assert_null(bus);
	no_memory = false;
}

/* Each allocation of the driver fails once; those behind it are of the thread and of libraries. */
static void test_a_source_of_samples_is_not_opened(void **state)
{
	static const struct {
		const char *source;
		int allocations;
	} sources[] = {{"sim:rest", 2}, {"wt901:/dev/null", 1}, {"iio", 1}, {"spi:/dev/null", 1}};

	(void)state;
	for (size_t i = 0; i < sizeof sources / sizeof *sources; i++)
		for (failing = 1; failing <= sources[i].allocations; failing++) {
			struct imu_port *port = NULL;
			char error[300] = "";

			calls = 0;
			assert_int_equal(imu_open(sources[i].source, NULL, &port, error, sizeof error), -ENOMEM);
			assert_int_equal(calls, failing);
			assert_null(port);
			assert_non_null(strstr(error, "Cannot allocate memory"));
		}
	failing = 0;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_bus_is_not_opened_and_the_message_says_why),
		cmocka_unit_test(test_a_bus_of_chips_is_not_opened),
		cmocka_unit_test(test_a_source_of_samples_is_not_opened),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Libraries that are loaded when they are needed, libusb and libiio, on a host that does not have them. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <iio.h>
#include <libusb-1.0/libusb.h>
#include <stdbool.h>

static const char *file; /* that was opened last */
static bool other;	 /* of that name there is a library without these functions */

void *dlopen(const char *name, int mode)
{
	assert_int_equal(mode, RTLD_NOW | RTLD_LOCAL);
	file = name;
	return other ? dlmopen(LM_ID_BASE, "libc.so.6", RTLD_NOW) : NULL;
}

static void test_what_is_not_installed_or_has_not_the_functions_is_told(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		other = i == 1;
		assert_int_equal(
			libusb_set_option(NULL, LIBUSB_OPTION_NO_DEVICE_DISCOVERY), LIBUSB_ERROR_NOT_SUPPORTED);
		assert_string_equal(file, "libusb-1.0.so.0");
		errno = 0;
		assert_null(iio_create_local_context());
		assert_int_equal(errno, ELIBACC);
		assert_string_equal(file, "libiio.so.0");
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_what_is_not_installed_or_has_not_the_functions_is_told),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

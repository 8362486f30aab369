/* The name of the file of 1010h, and what earlier versions called it. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "gateway/store_name.h"

static char folder[64], path[300], old[400];

static int make_folder(void **state)
{
	(void)state;
	strcpy(folder, "/tmp/imu9-name-XXXXXX");
	return mkdtemp(folder) ? 0 : -1;
}

static int remove_folder(void **state)
{
	char command[100];

	(void)state;
	snprintf(command, sizeof(command), "rm -r %s", folder);
	return system(command);
}

/* A file of that name, written `age` seconds ago, that contains its name. */
static void put(const char *name, long age)
{
	char file[300];
	struct timespec times[2] = {{.tv_sec = 1800000000 - age}, {.tv_sec = 1800000000 - age}};

	snprintf(file, sizeof(file), "%s/%s", folder, name);
	FILE *f = fopen(file, "w");
	assert_non_null(f);
	fputs(name, f);
	fclose(f);
	assert_int_equal(utimensat(AT_FDCWD, file, times, 0), 0);
}

static void assert_store_is(const char *name)
{
	char text[200] = "";
	FILE *f = fopen(path, "r");

	assert_non_null(f);
	assert_non_null(fgets(text, sizeof(text), f));
	fclose(f);
	assert_string_equal(text, name);
}

static int take_over(const char *bus)
{
	store_path(path, sizeof(path), folder, bus);
	return store_take_over(path, folder, bus, 5, old, sizeof(old));
}

static void test_the_name_has_the_bus_and_none_of_its_options(void **state)
{
	static const char *const names[][2] = {{"can0", "can0"}, {"udp", "udp"}, {"udp,hosts=any", "udp"},
		{"udp:239.1.2.3:4000,interface=eth0", "udp_239.1.2.3_4000"}, {"udp:[ff15::1]", "udp__ff15__1_"},
		{"slcan:/dev/ttyACM0@115200", "slcan__dev_ttyACM0"}, {"gs_usb:0042:1,bitrate=250000", "gs_usb_0042_1"}};
	char name[256];

	(void)state;
	for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++) {
		store_bus_name(name, sizeof(name), names[i][0]);
		assert_string_equal(name, names[i][1]);
	}
}

static void test_the_newest_file_under_an_earlier_name_is_taken_over_once(void **state)
{
	(void)state;
	put("udp,hosts=any.store", 100);
	put("udp,hosts=any,interface=eth0.store", 50);
	put("node-5.store", 200);
	assert_int_equal(take_over("udp,interface=lo"), 1);
	assert_non_null(strstr(old, "/udp,hosts=any,interface=eth0.store"));
	assert_store_is("udp,hosts=any,interface=eth0.store");
	assert_int_equal(take_over("udp"), 0);
	assert_store_is("udp,hosts=any,interface=eth0.store");
	assert_int_equal(take_over("slcan:/dev/ttyACM0@115200"), 1); /* what 0.1 stored for node 5 */
	assert_store_is("node-5.store");
}

static void test_a_file_of_another_bus_is_left_alone(void **state)
{
	(void)state;
	put("udp_239.1.2.3,hosts=any.store", 1);
	put("udp2.store", 1);
	put("udp,hosts=any.store.bad", 1);
	put("udp,hosts=any.store.lock", 1);
	put("node-6.store", 1);
	assert_int_equal(take_over("udp"), 0);
	assert_int_equal(access(path, F_OK), -1);
}

static void test_a_link_is_not_taken_over(void **state)
{
	char link[200];

	(void)state;
	snprintf(link, sizeof(link), "%s/udp,hosts=any.store", folder);
	assert_int_equal(symlink("/etc/passwd", link), 0);
	assert_int_equal(take_over("udp"), 0);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, make_folder, remove_folder)

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_name_has_the_bus_and_none_of_its_options),
		TEST(test_the_newest_file_under_an_earlier_name_is_taken_over_once),
		TEST(test_a_file_of_another_bus_is_left_alone),
		TEST(test_a_link_is_not_taken_over),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

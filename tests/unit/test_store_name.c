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
#include "tests/unit/descriptors.h"

static char folder[64], path[400], old[400];

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

/* A file of that name, written at this time, that contains its name. */
static void put_at(const char *name, struct timespec time)
{
	char file[400];
	struct timespec times[2] = {time, time};

	snprintf(file, sizeof(file), "%s/%s", folder, name);
	FILE *f = fopen(file, "w");
	assert_non_null(f);
	fputs(name, f);
	fclose(f);
	assert_int_equal(utimensat(AT_FDCWD, file, times, 0), 0);
}

/* Written `age` seconds ago. */
static void put(const char *name, long age)
{
	put_at(name, (struct timespec){.tv_sec = 1800000000 - age});
}

static void assert_store_is(const char *name)
{
	char text[300] = "";
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

/* Whichever the folder lists first. */
static void test_of_two_files_of_the_same_second_the_newer_one_is_taken_over(void **state)
{
	static const char *const names[] = {"udp,a.store", "udp,b.store"};

	(void)state;
	for (int newer = 0; newer < 2; newer++) {
		for (int i = 0; i < 2; i++)
			put_at(names[i], (struct timespec){1800000000, i == newer ? 2 : 1});
		assert_int_equal(take_over("udp"), 1);
		assert_store_is(names[newer]);
		assert_int_equal(unlink(path), 0);
		for (int i = 0; i < 2; i++) /* the second counts first */
			put_at(names[i], (struct timespec){1800000000 + (i == newer), i == newer ? 1 : 2});
		assert_int_equal(take_over("udp"), 1);
		assert_store_is(names[newer]);
		assert_int_equal(unlink(path), 0);
	}
}

static void test_names_can_be_long_and_an_option_has_a_character_at_least(void **state)
{
	char bus[256] = "slcan:/dev/serial/by-id/", name[256], expected[400];

	(void)state;
	put("udp,.store", 1);
	assert_int_equal(take_over("udp"), 0);
	memset(bus + strlen(bus), 'x', 200);
	snprintf(name, sizeof(name), "slcan__dev_serial_by-id_%.200s@115200.store",
		bus + strlen("slcan:/dev/serial/by-id/"));
	put(name, 1);
	strcat(bus, "@9600");
	assert_int_equal(take_over(bus), 1);
	snprintf(expected, sizeof(expected), "%s/%s", folder, name);
	assert_string_equal(old, expected);
	snprintf(strchr(expected, '@'), 8, ".store");
	assert_string_equal(path, expected);
	assert_store_is(name);
}

static void test_what_cannot_be_taken_over_is_told_and_stays(void **state)
{
	char there[200];

	(void)state;
	put("udp,a.store", 1);
	assert_int_equal(store_take_over("/no/such/udp.store", folder, "udp", 5, old, sizeof(old)), -ENOENT);
	snprintf(there, sizeof(there), "%s/udp,a.store", folder);
	assert_string_equal(old, there);
	assert_int_equal(access(there, F_OK), 0);
	strcat(there, "/udp.store"); /* not in a folder */
	assert_int_equal(store_take_over(there, folder, "udp", 5, old, sizeof(old)), 0);
	assert_string_equal(old, "");
	assert_int_equal(store_take_over("/no/such/udp.store", "/no/such", "udp", 5, old, sizeof(old)), 0);
	assert_string_equal(old, "");
	store_path(path, sizeof(path), folder, "udp");
	assert_int_equal(symlink("/no/such", path), 0); /* the name is in use, whatever it is */
	assert_int_equal(store_take_over(path, folder, "udp", 5, old, sizeof(old)), 0);
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
		TEST(test_of_two_files_of_the_same_second_the_newer_one_is_taken_over),
		TEST(test_names_can_be_long_and_an_option_has_a_character_at_least),
		TEST(test_what_cannot_be_taken_over_is_told_and_stays),
		TEST(test_a_link_is_not_taken_over),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

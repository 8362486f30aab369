/* 1018h:4. Each start of a gateway is a process, whose machine is a folder with the files that the kernel shows. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gateway/serial.h"
#include "tests/unit/descriptors.h"

static char base[64], pi[128], other_pi[128], store[128], other_store[128];
static void (*before_lock)(void); /* what happens while a gateway waits for the lock */
static bool no_sockets;

int flock(int fd, int operation)
{
	void (*happens)(void) = before_lock;

	before_lock = NULL;
	if (happens && operation == LOCK_EX)
		happens();
	return (int)syscall(SYS_flock, fd, operation);
}

int socket(int domain, int type, int protocol)
{
	errno = EMFILE;
	return no_sockets ? -1 : (int)syscall(SYS_socket, domain, type, protocol);
}

static void run(const char *format, const char *a, const char *b, const char *c)
{
	char command[1024];

	snprintf(command, sizeof(command), format, a, b, c);
	assert_int_equal(system(command), 0);
}

static void put(const char *machine, const char *file, const char *text)
{
	run("mkdir -p \"$(dirname %s/%s)\"", machine, file, "");
	run("printf '%%s' '%3$s' >%1$s/%2$s", machine, file, text);
}

static void put_mac(const char *machine, const char *interface, const char *address, const char *assign_type)
{
	char file[400];

	snprintf(file, sizeof(file), "sys/class/net/%s/address", interface);
	put(machine, file, address);
	snprintf(file, sizeof(file), "sys/class/net/%s/addr_assign_type", interface);
	put(machine, file, assign_type);
	snprintf(file, sizeof(file), "sys/class/net/%s/type", interface);
	put(machine, file, "1");
}

static int make_machines(void **state)
{
	(void)state;
	strcpy(base, "/tmp/imu9-serial-XXXXXX");
	if (!mkdtemp(base))
		return -1;
	snprintf(pi, sizeof(pi), "%s/pi", base);
	snprintf(other_pi, sizeof(other_pi), "%s/other", base);
	snprintf(store, sizeof(store), "%s/store", base);
	snprintf(other_store, sizeof(other_store), "%s/other-store", base);
	put(pi, "proc/device-tree/serial-number", "10000000c0ffee01");
	put(other_pi, "proc/device-tree/serial-number", "10000000c0ffee02");
	put(pi, "etc/machine-id", "0123456789abcdef0123456789abcdef"); /* the same card image */
	put(other_pi, "etc/machine-id", "0123456789abcdef0123456789abcdef");
	run("mkdir %s %s", store, other_store, "");
	return 0;
}

static int remove_machines(void **state)
{
	(void)state;
	run("rm -r %s", base, "", "");
	return 0;
}

/* A function finds there what others left. */
__attribute__((noinline)) static void leave_ones_on_the_stack(void)
{
	volatile uint8_t bytes[65536];

	for (size_t i = 0; i < sizeof(bytes); i++)
		bytes[i] = 0xFF;
}

struct gateway {
	pid_t pid;
	uint32_t serial;
	int descriptors; /* that it has more than before */
	char note[SERIAL_NOTE_MAX];
};

static struct gateway start(const char *machine, const char *folder, const char *bus, uint32_t configured)
{
	struct gateway g = {0};
	int result[2];

	assert_int_equal(pipe(result), 0);
	g.pid = fork();
	if (g.pid == 0) {
		int before = open_descriptors();

		leave_ones_on_the_stack();
		g.serial = serial_number(machine, folder, bus, configured, g.note);
		g.descriptors = open_descriptors() - before;
		_exit(write(result[1], &g, sizeof(g)) == sizeof(g) && pause());
	}
	pid_t pid = g.pid;
	assert_int_equal(read(result[0], &g, sizeof(g)), sizeof(g));
	g.pid = pid;
	close(result[0]);
	close(result[1]);
	assert_int_not_equal(g.serial, 0);
	return g;
}

static void end_gateway(struct gateway g)
{
	kill(g.pid, SIGKILL);
	assert_int_equal(waitpid(g.pid, NULL, 0), g.pid);
}

/* Started and stopped, without a note. */
static uint32_t serial_of(const char *machine, const char *folder, const char *bus)
{
	struct gateway g = start(machine, folder, bus, 0);

	end_gateway(g);
	assert_string_equal(g.note, "");
	return g.serial;
}

static void test_the_serial_number_stays_with_another_bus_name_and_its_options(void **state)
{
	uint32_t serial = serial_of(pi, store, "can0");

	(void)state;
	assert_int_equal(serial_of(pi, store, "can0"), serial);
	assert_int_equal(serial_of(pi, store, "udp,hosts=any"), serial);
	assert_int_equal(serial_of(pi, store, "slcan:/dev/ttyACM0@115200"), serial);
	assert_int_equal(serial_of(pi, store, "can0"), serial);
}

/* CRC-32 by python's zlib. Of the machine's numbers the first that is one counts. */
static void test_the_number_is_the_crc_of_a_number_of_the_hardware(void **state)
{
	(void)state;
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	run("rm -r %s/proc %s/*", pi, store, "");
	assert_int_equal(serial_of(pi, store, "can0"), 0x7759B50E); /* /etc/machine-id */
	put_mac(pi, "wlan0", "b8:27:eb:ff:34:56", "0");
	put_mac(pi, "eth0", "b8:27:eb:12:34:56", "0");
	run("rm %s/*", store, "", "");
	assert_int_equal(serial_of(pi, store, "can0"), 0xC87278F5); /* the smaller address */
	put(pi, "sys/class/dmi/id/board_serial", "001E00345246");
	run("rm %s/*", store, "", "");
	assert_int_equal(serial_of(pi, store, "can0"), 0x3BC9D650);
}

static void test_sixteen_gateways_of_a_host_keep_their_serial_numbers(void **state)
{
	enum { GATEWAYS = 18, KEPT = 16 };
	struct gateway g[GATEWAYS];
	char bus[8];

	(void)state;
	for (int i = 0; i < GATEWAYS; i++) {
		snprintf(bus, sizeof(bus), "can%d", i);
		g[i] = start(pi, store, bus, 0);
		assert_string_equal(g[i].note, "");
		for (int k = 0; k < i; k++)
			assert_int_not_equal(g[k].serial, g[i].serial);
	}
	for (int i = 0; i < GATEWAYS; i++)
		end_gateway(g[i]);
	for (int i = 0; i < KEPT - 1; i++) {
		snprintf(bus, sizeof(bus), "can%d", i);
		assert_int_equal(serial_of(pi, store, bus), g[i].serial);
	}
	assert_int_equal(serial_of(pi, store, "can17"), g[17].serial); /* the last line is the one that is replaced */
}

static void test_a_bus_with_a_long_name_keeps_its_serial_number(void **state)
{
	char bus[300] = "slcan:/dev/serial/by-id/";
	struct gateway a = start(pi, store, "can0", 0), b;

	(void)state;
	memset(bus + strlen(bus), 'x', sizeof(bus) - 1 - strlen(bus));
	b = start(pi, store, bus, 0);
	end_gateway(a);
	end_gateway(b);
	assert_string_equal(b.note, "");
	assert_int_not_equal(a.serial, b.serial);
	assert_int_equal(serial_of(pi, store, bus), b.serial);
	assert_int_equal(serial_of(pi, store, "can0"), a.serial);
}

/* A file has names of up to 255 characters. */
static void test_buses_whose_long_names_differ_in_the_last_character_have_different_serial_numbers(void **state)
{
	char bus[256] = "slcan:", other_bus[256];
	struct gateway a, b;

	(void)state;
	memset(bus + strlen(bus), 'x', sizeof(bus) - 1 - strlen(bus));
	strcpy(other_bus, bus);
	other_bus[254] = 'y';
	a = start(pi, store, bus, 0);
	b = start(pi, store, other_bus, 0);
	end_gateway(a);
	end_gateway(b);
	assert_string_equal(b.note, "");
	assert_int_equal(serial_of(pi, store, bus), a.serial);
	assert_int_equal(serial_of(pi, store, other_bus), b.serial);
	assert_int_not_equal(a.serial, b.serial);
}

static void test_a_new_installation_on_the_same_board_has_the_same_serial_number(void **state)
{
	uint32_t serial = serial_of(pi, store, "can0");

	(void)state;
	put(pi, "etc/machine-id", "fedcba9876543210fedcba9876543210");
	assert_int_equal(serial_of(pi, other_store, "can0"), serial);
}

static void test_a_copied_card_has_another_serial_number_on_another_board_and_says_so(void **state)
{
	uint32_t serial = serial_of(pi, store, "can0");

	(void)state;
	run("cp -r %s/. %s", store, other_store, "");
	struct gateway copy = start(other_pi, other_store, "can0", 0);
	end_gateway(copy);
	assert_int_not_equal(copy.serial, serial);
	assert_non_null(strstr(copy.note, "is of other hardware"));
	assert_int_equal(serial_of(other_pi, other_store, "can0"), copy.serial);
	assert_int_equal(serial_of(pi, store, "can0"), serial);
}

static void test_two_gateways_of_a_host_have_different_serial_numbers_in_any_order(void **state)
{
	struct gateway a = start(pi, store, "can0", 0), b = start(pi, store, "can1", 0);

	(void)state;
	end_gateway(a);
	end_gateway(b);
	assert_int_not_equal(a.serial, b.serial);
	assert_int_equal(serial_of(pi, store, "can1"), b.serial);
	assert_int_equal(serial_of(pi, store, "can0"), a.serial);
	a = start(pi, store, "can0", 0);
	struct gateway c = start(pi, other_store, "can0", 0); /* another folder, as for two nodes of one bus */
	assert_int_not_equal(c.serial, a.serial);
	end_gateway(a);
	end_gateway(c);
	assert_int_equal(serial_of(pi, other_store, "can0"), c.serial);
}

static void test_a_serial_number_that_another_gateway_of_the_host_has_is_told(void **state)
{
	struct gateway a = start(pi, store, "can0", 1234), b = start(pi, store, "can1", 1234),
		       c = start(pi, store, "can2", 1235);

	(void)state;
	assert_string_equal(a.note, "");
	assert_non_null(strstr(b.note, "000004D2h is that of another gateway of this host"));
	assert_int_equal(b.serial, 1234);
	assert_string_equal(c.note, "");
	end_gateway(c);
	end_gateway(a);
	end_gateway(b);
}

static void test_a_gateway_whose_number_another_one_has_got_is_told_what_to_set(void **state)
{
	struct gateway a = start(pi, store, "can0", 0), b;

	(void)state;
	end_gateway(a);
	b = start(pi, other_store, "can0", 0);
	assert_int_equal(b.serial, a.serial);
	assert_string_equal(b.note, "");
	a = start(pi, store, "can0", 0);
	assert_int_equal(a.serial, b.serial);
	assert_string_equal(
		a.note, "serial number 5BE6FC0Ch is that of another gateway of this host, too: set --serial");
	end_gateway(a);
	end_gateway(b);
}

/* The name is that of all versions: they can run side by side. */
static void test_a_number_is_held_by_a_socket_with_its_name_and_nothing_else_stays_open(void **state)
{
	static const char name[] = "imu9-gateway/serial/000004D2";
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	int fd = socket(AF_UNIX, SOCK_DGRAM, 0);

	(void)state;
	memcpy(address.sun_path + 1, name, strlen(name));
	assert_int_equal(bind(fd, (struct sockaddr *)&address,
				 (socklen_t)(offsetof(struct sockaddr_un, sun_path) + 1 + strlen(name))),
		0);
	struct gateway taken = start(pi, store, "can0", 1234), free_one = start(pi, store, "can0", 0);
	end_gateway(taken);
	end_gateway(free_one);
	struct gateway again = start(pi, store, "can0", 0); /* with a file */
	end_gateway(again);
	close(fd);
	assert_string_equal(taken.note,
		"serial number 000004D2h is that of another gateway of this host, too: set another --serial");
	assert_int_equal(taken.descriptors, 0);
	assert_string_equal(free_one.note, "");
	assert_int_equal(free_one.descriptors, 1);
	assert_int_equal(again.descriptors, 1);
}

static void test_without_sockets_a_gateway_has_the_number_of_its_hardware(void **state)
{
	(void)state;
	no_sockets = true;
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	no_sockets = false;
}

static void start_two(void)
{
	struct gateway a = start(pi, store, "can1", 0), b = start(pi, store, "can2", 0);

	end_gateway(a);
	end_gateway(b);
}

static void test_gateways_that_start_at_the_same_time_have_their_lines_too(void **state)
{
	(void)state;
	before_lock = start_two;
	struct gateway a = start(pi, store, "can0", 0);
	before_lock = NULL;
	end_gateway(a);
	assert_int_equal(serial_of(pi, store, "can1"), 0x5BE6FC0C); /* it was the first */
	assert_int_not_equal(a.serial, 0x5BE6FC0C);
	assert_int_equal(serial_of(pi, store, "can0"), a.serial);
}

static void test_a_usb_network_adapter_changes_nothing(void **state)
{
	uint32_t serial;

	(void)state;
	run("rm %s/proc/device-tree/serial-number", pi, "", "");
	put_mac(pi, "eth0", "b8:27:eb:12:34:56", "0");
	put_mac(pi, "wlan0", "00:11:22:33:44:66", "3"); /* set at random, not the hardware's */
	serial = serial_of(pi, store, "can0");
	put_mac(pi, "usb0", "00:01:02:03:04:05", "0");
	put_mac(pi, "wlan0", "00:11:22:33:44:77", "3");
	assert_int_equal(serial_of(pi, store, "can0"), serial);
	put_mac(other_pi, "eth0", "b8:27:eb:12:34:57", "0");
	run("rm %s/proc/device-tree/serial-number", other_pi, "", "");
	struct gateway copy = start(other_pi, store, "can0", 0);
	end_gateway(copy);
	assert_int_not_equal(copy.serial, serial);
}

static void test_what_vendors_write_instead_of_a_number_is_none(void **state)
{
	static const char *const texts[] = {"Default string", "To be filled by O.E.M.", "00000000", "0123456789",
		"123456789", "None", "03000200-0400-0500-0006-000700080009", "", "1234", "11223", "ABCDEF",
		"PF3 ABCDE"};
	static const char *const numbers[] = {"PF3ABCDE", "12345", "11234"};
	uint32_t without;

	(void)state;
	run("rm -r %s/proc %s/proc", pi, other_pi, "");
	without = serial_of(pi, store, "can0"); /* of the machine-id */
	for (size_t i = 0; i < sizeof(texts) / sizeof(texts[0]); i++) {
		put(pi, "sys/class/dmi/id/board_serial", texts[i]);
		run("rm -f %s/serial", store, "", "");
		assert_int_equal(serial_of(pi, store, "can0"), without);
	}
	for (size_t i = 0; i < sizeof(numbers) / sizeof(numbers[0]); i++) {
		put(pi, "sys/class/dmi/id/board_serial", numbers[i]);
		run("rm %s/serial", store, "", "");
		assert_int_not_equal(serial_of(pi, store, "can0"), without);
	}
}

static void test_what_is_no_number_has_no_influence_on_the_next(void **state)
{
	uint32_t serial;

	(void)state;
	run("rm -r %s/proc", pi, "", "");
	put(pi, "sys/class/dmi/id/board_serial", "PF3ABCDE");
	serial = serial_of(pi, store, "can0");
	put(pi, "sys/class/dmi/id/product_uuid", "03000200-0400-0500-0006-000700080009");
	put(pi, "sys/class/dmi/id/product_serial", "Default string\n");
	put(pi, "sys/class/dmi/id/board_serial", "PF3ABCDE \nXYZ12345");
	assert_int_equal(serial_of(pi, other_store, "can0"), serial);
}

/* CRC-32 by python's zlib. */
static void test_a_number_counts_with_its_first_127_characters(void **state)
{
	char text[244] = "PF3";

	(void)state;
	for (int i = 0; i < 60; i++)
		snprintf(text + 3 + 4 * i, 5, "%04d", i);
	run("rm -r %s/proc", pi, "", "");
	put(pi, "sys/class/dmi/id/board_serial", text);
	assert_int_equal(serial_of(pi, store, "can0"), 0x6B654D45);
}

static void expect_table(const char *expected)
{
	char path[160], text[512] = "";

	snprintf(path, sizeof(path), "%s/serial", store);
	FILE *f = fopen(path, "r");
	assert_non_null(f);
	text[fread(text, 1, sizeof(text) - 1, f)] = '\0';
	fclose(f);
	assert_string_equal(text, expected);
}

/* Of the board, and of the network interfaces in the order of their addresses. Names can have 255 characters. */
static void test_the_file_has_eight_numbers_of_the_hardware_and_one_of_them_is_enough(void **state)
{
	char interface[256], address[32];

	(void)state;
	for (int i = 1; i <= 8; i++) {
		memset(interface, 'a' + i * 5 % 8, sizeof(interface) - 1);
		interface[255] = '\0';
		snprintf(address, sizeof(address), "b8:27:eb:12:34:5%d", i);
		put_mac(pi, interface, address, "0");
	}
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	expect_table("5BE6FC0C can0 5BE6FC0C 5616ED56 CF1FBCEC B8188C7A 267C19D9 517B294F C87278F5 BF754863\n");
	run("rm -r %s/proc", pi, "", "");
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	run("rm -r %s/sys/class/net/[b-z]*", pi, "", "");
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
}

static void test_the_address_of_an_interface_that_is_no_ethernet_does_not_count(void **state)
{
	(void)state;
	run("rm -r %s/proc", pi, "", "");
	put_mac(pi, "eth0", "b8:27:eb:12:34:56", "0");
	put_mac(pi, "ib0", "80:00:02:08:fe:80", "0");
	put(pi, "sys/class/net/ib0/type", "32");
	assert_int_equal(serial_of(pi, store, "can0"), 0xC87278F5);
	expect_table("C87278F5 can0 C87278F5\n");
}

static void test_a_user_who_cannot_read_the_numbers_leaves_them_in_the_file(void **state)
{
	(void)state;
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	run("rm -r %s/proc", pi, "", "");
	assert_int_equal(serial_of(pi, store, "can0"), 0x5BE6FC0C);
	expect_table("5BE6FC0C can0 5BE6FC0C\n");
}

static void test_a_line_has_serial_number_bus_and_numbers_in_hexadecimal(void **state)
{
	(void)state;
	put(store, "serial", "ABCD can0 1 2 3 4 5 6 7 5BE6FC0C\nABCE can1 1 2\n");
	struct gateway g = start(pi, store, "can0", 0);
	end_gateway(g);
	assert_int_equal(g.serial, 0xABCD);
	assert_non_null(strstr(g.note, "is of other hardware; this one has 0000ABCDh")); /* the second line */
	expect_table("0000ABCD can0 5BE6FC0C\n");
}

static void test_a_file_that_is_right_is_not_written_again(void **state)
{
	struct stat before, after;
	char path[160];

	(void)state;
	snprintf(path, sizeof(path), "%s/serial", store);
	serial_of(pi, store, "can0");
	assert_int_equal(stat(path, &before), 0);
	serial_of(pi, store, "can0");
	assert_int_equal(stat(path, &after), 0);
	assert_int_equal(after.st_ino, before.st_ino);
}

static void test_a_usb_can_adapter_has_a_number_where_the_machine_has_none(void **state)
{
	(void)state;
	run("rm -r %s/proc %s/proc", pi, other_pi, "");
	run("mkdir -p %s/sys/class/net/can0/device %s/sys/class/net/can0/device", pi, other_pi, "");
	put(pi, "sys/class/net/can0/serial", "001E00345246"); /* where device/.. leads here */
	put(other_pi, "sys/class/net/can0/serial", "001E00345247");
	assert_int_not_equal(serial_of(pi, store, "can0"), serial_of(other_pi, other_store, "can0"));
}

static void test_a_folder_that_cannot_be_written_is_told_and_the_number_is_that_of_the_board(void **state)
{
	struct gateway g = start(pi, "/proc/no", "can0", 0);

	(void)state;
	end_gateway(g);
	assert_non_null(strstr(g.note, "cannot be kept in /proc/no/serial"));
	assert_int_equal(serial_of(pi, store, "can0"), g.serial);
}

static void test_a_damaged_file_is_no_number(void **state)
{
	uint32_t serial = serial_of(pi, store, "can0");

	(void)state;
	put(store, "serial", "zz can0\n\n00000000 can0 1\nFFFF\n");
	assert_int_equal(serial_of(pi, store, "can0"), serial);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, make_machines, remove_machines)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_the_serial_number_stays_with_another_bus_name_and_its_options),
		TEST(test_the_number_is_the_crc_of_a_number_of_the_hardware),
		TEST(test_sixteen_gateways_of_a_host_keep_their_serial_numbers),
		TEST(test_a_bus_with_a_long_name_keeps_its_serial_number),
		TEST(test_buses_whose_long_names_differ_in_the_last_character_have_different_serial_numbers),
		TEST(test_a_new_installation_on_the_same_board_has_the_same_serial_number),
		TEST(test_a_copied_card_has_another_serial_number_on_another_board_and_says_so),
		TEST(test_two_gateways_of_a_host_have_different_serial_numbers_in_any_order),
		TEST(test_a_serial_number_that_another_gateway_of_the_host_has_is_told),
		TEST(test_a_gateway_whose_number_another_one_has_got_is_told_what_to_set),
		TEST(test_a_number_is_held_by_a_socket_with_its_name_and_nothing_else_stays_open),
		TEST(test_without_sockets_a_gateway_has_the_number_of_its_hardware),
		TEST(test_gateways_that_start_at_the_same_time_have_their_lines_too),
		TEST(test_a_usb_network_adapter_changes_nothing),
		TEST(test_what_vendors_write_instead_of_a_number_is_none),
		TEST(test_what_is_no_number_has_no_influence_on_the_next),
		TEST(test_a_number_counts_with_its_first_127_characters),
		TEST(test_the_file_has_eight_numbers_of_the_hardware_and_one_of_them_is_enough),
		TEST(test_the_address_of_an_interface_that_is_no_ethernet_does_not_count),
		TEST(test_a_user_who_cannot_read_the_numbers_leaves_them_in_the_file),
		TEST(test_a_line_has_serial_number_bus_and_numbers_in_hexadecimal),
		TEST(test_a_file_that_is_right_is_not_written_again),
		TEST(test_a_usb_can_adapter_has_a_number_where_the_machine_has_none),
		TEST(test_a_folder_that_cannot_be_written_is_told_and_the_number_is_that_of_the_board),
		TEST(test_a_damaged_file_is_no_number),
	};

	(void)unshare(CLONE_NEWNET); /* where permitted: the names of sockets are of this program alone */
	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

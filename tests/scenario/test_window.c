/* The two windows on a device, gateway/window.h and gateway/ascii_gateway.h, as the process opens them: with sockets of
 * the kernel and the server's thread. The test is the loop. What clients can ask is for test_modbus.c, test_cia309.c
 * and the tests of the servers. */
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/ascii_gateway.h"
#include "gateway/window.h"
#include "tests/scenario/world.h"
#include "tests/unit/descriptors.h"

enum { PATIENCE_MS = 120000 /* ends a test that hangs */, AT_LEVER_ARM_UM = 0x1100, COIL_STORE = 1, BUSY = 6 };

/* A host without memory, and without descriptors for the loop to be woken by, for this thread: the server's goes on. */
static _Thread_local bool no_memory, no_events;
/* The compiler may not make a calloc() of malloc() and memset(). */
static void *(*volatile allocate)(size_t size) = malloc;

void *calloc(size_t count, size_t size)
{
	void *p = no_memory ? NULL : allocate(count * size);

	if (p)
		memset(p, 0, count * size);
	return p;
}

int eventfd(unsigned count, int flags)
{
	errno = EMFILE;
	return no_events ? -1 : (int)syscall(SYS_eventfd2, count, flags);
}

struct fixture {
	struct world world; /* first */
	struct window window;
	unsigned port;
	char where[100], why[300];
	int client;
	uint8_t answer[260];
	size_t size;
};

static unsigned free_port(void)
{
	struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	socklen_t size = sizeof(address);
	int fd = socket(AF_INET, SOCK_STREAM, 0);

	assert_int_equal(bind(fd, (struct sockaddr *)&address, size), 0);
	assert_int_equal(getsockname(fd, (struct sockaddr *)&address, &size), 0);
	close(fd);
	return ntohs(address.sin_port);
}

static int connect_to(unsigned port)
{
	struct sockaddr_in address = {
		.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK), .sin_port = htons((uint16_t)port)};
	int fd = socket(AF_INET, SOCK_STREAM, 0);

	if (connect(fd, (struct sockaddr *)&address, sizeof(address)) == 0)
		return fd;
	close(fd);
	return -1;
}

static int set_up(void **state)
{
	struct fixture *f = calloc(1, sizeof(*f));

	assert_non_null(f);
	world_init(&f->world, sensor_preset("ideal"), 1, "rest");
	world_power_on(&f->world, NULL);
	world_seconds(&f->world, 1);
	f->port = free_port();
	snprintf(f->where, sizeof(f->where), "tcp:127.0.0.1:%u,write=127.0.0.1\n", f->port);
	assert_int_equal(window_open(&f->window, f->where, &f->world.device, f->why, sizeof(f->why)), 0);
	f->client = connect_to(f->port);
	assert_true(f->client >= 0);
	*state = f;
	return 0;
}

static int tear_down(void **state)
{
	struct fixture *f = *state;

	close(f->client);
	window_close(&f->window);
	free(f);
	return 0;
}

static void wait_for(int fd)
{
	struct pollfd p = {.fd = fd, .events = POLLIN};

	assert_int_equal(poll(&p, 1, PATIENCE_MS), 1);
}

/* A request of function code and data to unit 1. */
static void send_request(struct fixture *f, const uint8_t *pdu, size_t size)
{
	uint8_t frame[40] = {0, 1, 0, 0, 0, (uint8_t)(size + 1), 1};

	memcpy(frame + 7, pdu, size);
	assert_int_equal(send(f->client, frame, 7 + size, 0), 7 + size);
}

/* The function code of its answer. */
static uint8_t receive_answer(struct fixture *f)
{
	uint8_t frame[270];
	size_t n = 0;

	while (n < 7 || n < 6 + (size_t)frame[5]) {
		wait_for(f->client);
		ssize_t more = recv(f->client, frame + n, sizeof(frame) - n, 0);
		assert_true(more > 0);
		n += (size_t)more;
	}
	f->size = n - 7;
	memcpy(f->answer, frame + 7, f->size);
	return f->answer[0];
}

/* The server does not wait for long where the loop is busy: then again. */
static void ask_the_loop(struct fixture *f, const uint8_t *pdu, size_t size)
{
	do {
		send_request(f, pdu, size);
		wait_for(window_fd(&f->window));
		window_serve(&f->window, f->world.now_us);
	} while (receive_answer(f) == (pdu[0] | 0x80) && f->answer[1] == BUSY);
}

/* ---- Modbus ------------------------------------------------------------------------------------------------------ */

static uint16_t counter_in(struct fixture *f)
{
	send_request(f, (const uint8_t[]){3, 0, 0, 0, 1}, 5); /* the block of integers begins with 210Fh:1 */
	assert_int_equal(receive_answer(f), 3);
	return (uint16_t)(f->answer[2] << 8 | f->answer[3]);
}

static void test_a_client_reads_what_was_published_last(void **state)
{
	struct fixture *f = *state;

	assert_true(window_is_open(&f->window));
	assert_int_equal(counter_in(f), f->world.device.values.sample.counter);
	world_samples(&f->world, 3);
	uint16_t before = counter_in(f);
	assert_int_equal(before, f->world.device.values.sample.counter - 3);
	window_publish(&f->window);
	assert_int_equal(counter_in(f), before + 3);
}

/* LSS has given it another node-ID. */
static void test_function_43_13_reaches_the_node_id_of_the_device(void **state)
{
	const uint8_t heartbeat_of_77[] = {0x2B, 0x0D, 0, 77, 0x10, 0x17, 0, 0, 0, 0, 9};
	struct fixture *f = *state;

	send_request(f, heartbeat_of_77, sizeof(heartbeat_of_77));
	assert_int_equal(receive_answer(f), 0xAB);
	f->world.device.canopen.id = 77;
	window_publish(&f->window);
	send_request(f, heartbeat_of_77, sizeof(heartbeat_of_77));
	assert_int_equal(receive_answer(f), 0x2B);
}

static void test_the_loop_executes_a_write_and_logs_who_wrote(void **state)
{
	struct fixture *f = *state;
	const uint8_t quarter_metre[] = {16, AT_LEVER_ARM_UM >> 8, AT_LEVER_ARM_UM & 0xFF, 0, 2, 4, 0, 3, 0xD0, 0x90};

	ask_the_loop(f, quarter_metre, sizeof(quarter_metre));
	assert_int_equal(f->answer[0], 16);
	assert_near(f->world.device.values.lever_arm.l, 0.25, 1e-6);
	assert_non_null(strstr(f->world.device.log.text, "Modbus, 127.0.0.1:"));
	assert_non_null(strstr(f->world.device.log.text, "lever_arm_in_um.l = 250000\n"));
}

static void test_a_refused_write_is_logged_with_its_reason(void **state)
{
	struct fixture *f = *state;
	const uint8_t twelve_metres[] = {16, AT_LEVER_ARM_UM >> 8, AT_LEVER_ARM_UM & 0xFF, 0, 2, 4, 0, 0xB7, 0x1B, 0};

	ask_the_loop(f, twelve_metres, sizeof(twelve_metres));
	assert_int_equal(f->answer[0], 0x90);
	assert_non_null(strstr(f->world.device.log.text, "lever_arm_in_um.l = 12000000 refused: value above its high"));
}

static void test_the_counters_of_the_server_are_objects(void **state)
{
	struct fixture *f = *state;
	const struct od_values *v = &f->world.device.values;

	counter_in(f);
	send_request(f, (const uint8_t[]){99}, 1);
	assert_int_equal(receive_answer(f), 0x80 | 99);
	ask_the_loop(f, (const uint8_t[]){5, 0, 0, 0xFF, 0}, 5);
	assert_int_equal(v->modbus.requests, 0);
	window_publish(&f->window);
	assert_int_equal(v->modbus.clients, 1);
	assert_true(v->modbus.requests >= 3);
	assert_true(v->modbus.exceptions >= 1);
	assert_true(v->modbus.writes >= 1 && v->modbus.writes < v->modbus.requests);
	assert_int_equal(v->modbus.refused, 0);
	assert_int_equal(v->modbus.malformed, 0);
}

/* Read-only coil 1 stores as 1010h:1 does. The answer comes when the disk has given its result. */
static void store_by_coil(struct fixture *f, int result)
{
	struct world *w = &f->world;
	const uint8_t store[] = {5, 0, COIL_STORE, 0xFF, 0};

	w->disk_answer = -EINPROGRESS;
	do {
		send_request(f, store, sizeof(store));
		wait_for(window_fd(&f->window));
		w->disk_waits = false;
		window_serve(&f->window, w->now_us);
		assert_true(w->disk_waits);
		device_saved(&w->device, result, w->now_us);
		window_saved(&f->window, result);
	} while (receive_answer(f) == 0x85 && f->answer[1] == BUSY);
}

static void test_a_store_is_answered_when_it_has_ended(void **state)
{
	struct fixture *f = *state;

	store_by_coil(f, 0);
	assert_int_equal(f->answer[0], 5);
}

static void test_a_store_that_fails_is_exception_4(void **state)
{
	struct fixture *f = *state;

	store_by_coil(f, -EIO);
	assert_int_equal(f->answer[0], 0x85);
	assert_int_equal(f->answer[1], 4);
}

static void test_a_closed_window_takes_no_client(void **state)
{
	struct fixture *f = *state;

	window_close(&f->window);
	assert_false(window_is_open(&f->window));
	assert_int_equal(connect_to(f->port), -1);
	assert_int_equal(window_open(&f->window, f->where, &f->world.device, f->why, sizeof(f->why)), 0);
	close(f->client);
	f->client = connect_to(f->port);
	assert_int_equal(counter_in(f), f->world.device.values.sample.counter);
}

static void test_a_window_that_cannot_be_opened_is_told(void **state)
{
	struct fixture *f = *state;
	struct window second;
	char port[8];

	assert_int_equal(window_open(&second, f->where, &f->world.device, f->why, sizeof(f->why)), -EIO);
	snprintf(port, sizeof(port), "%u", f->port);
	assert_non_null(strstr(f->why, port));
	assert_false(window_is_open(&second));
	assert_int_equal(window_open(&second, "tcp", &f->world.device, f->why, sizeof(f->why)), -EINVAL);
	assert_non_null(strstr(f->why, "'tcp' is no Modbus window"));
	assert_false(window_is_open(&second));
	assert_int_equal(window_open(&second, "", &f->world.device, f->why, sizeof(f->why)), 0);
	assert_false(window_is_open(&second));
	window_close(&second);
}

static void test_a_host_without_memory_or_descriptors_has_no_window_and_says_so(void **state)
{
	struct fixture *f = *state;
	struct window second;

	no_memory = true;
	assert_int_equal(window_open(&second, f->where, &f->world.device, f->why, sizeof(f->why)), -ENOMEM);
	assert_string_equal(f->why, "Modbus: Cannot allocate memory");
	assert_null(ascii_gateway_open("unix:/tmp/x\n", &f->world.device, &f->world.bus, f->why, sizeof(f->why)));
	no_memory = false;
	assert_string_equal(f->why, "cia309: Cannot allocate memory");
	assert_null(f->world.device.canopen.listener);
	no_events = true;
	assert_int_equal(window_open(&second, f->where, &f->world.device, f->why, sizeof(f->why)), -EMFILE);
	no_events = false;
	assert_string_equal(f->why, "Modbus: Too many open files");
	window_close(&second);
}

static void test_a_gateway_has_up_to_four_windows(void **state)
{
	static char texts[] = "tcp:127.0.0.1:1\ntcp:127.0.0.1:2\ntcp:127.0.0.1:3\ntcp:127.0.0.1:4\n";
	struct fixture *f = *state;
	char five[100];

	assert_int_equal(window_check(texts, f->why, sizeof(f->why)), 0);
	snprintf(five, sizeof(five), "%stcp:127.0.0.1:5\n", texts);
	assert_int_equal(window_check(five, f->why, sizeof(f->why)), -EINVAL);
	assert_string_equal(f->why, "more than 4 Modbus windows");
}

/* ---- CiA 309-3 --------------------------------------------------------------------------------------------------- */

static void test_cia309_takes_clients_until_it_is_closed(void **state)
{
	struct fixture *f = *state;
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	char where[120];

	snprintf(address.sun_path, sizeof(address.sun_path), "/tmp/imu9-window-%d", (int)getpid());
	snprintf(where, sizeof(where), "unix:%s\n", address.sun_path);
	struct cia309_server *server =
		ascii_gateway_open(where, &f->world.device, &f->world.bus, f->why, sizeof(f->why));
	assert_non_null(server);
	assert_non_null(f->world.device.canopen.listener); /* it hears what the node hears */
	int client = socket(AF_UNIX, SOCK_STREAM, 0);
	assert_int_equal(connect(client, (struct sockaddr *)&address, sizeof(address)), 0);
	ascii_gateway_close(server);
	close(client);
	assert_null(f->world.device.canopen.listener);
	assert_int_equal(access(address.sun_path, F_OK), -1);
}

static void test_cia309_that_cannot_be_opened_is_told(void **state)
{
	struct fixture *f = *state;
	char where[40];

	snprintf(where, sizeof(where), "tcp:127.0.0.1:%u\n", f->port); /* Modbus is there */
	assert_null(ascii_gateway_open(where, &f->world.device, &f->world.bus, f->why, sizeof(f->why)));
	assert_non_null(strstr(f->why, strerror(EADDRINUSE)));
	assert_null(f->world.device.canopen.listener);
}

int main(void)
{
#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_a_client_reads_what_was_published_last),
		TEST(test_function_43_13_reaches_the_node_id_of_the_device),
		TEST(test_the_loop_executes_a_write_and_logs_who_wrote),
		TEST(test_a_refused_write_is_logged_with_its_reason),
		TEST(test_the_counters_of_the_server_are_objects),
		TEST(test_a_store_is_answered_when_it_has_ended),
		TEST(test_a_store_that_fails_is_exception_4),
		TEST(test_a_closed_window_takes_no_client),
		TEST(test_a_window_that_cannot_be_opened_is_told),
		TEST(test_a_host_without_memory_or_descriptors_has_no_window_and_says_so),
		TEST(test_a_gateway_has_up_to_four_windows),
		TEST(test_cia309_takes_clients_until_it_is_closed),
		TEST(test_cia309_that_cannot_be_opened_is_told),
	};

	return cmocka_run_group_tests_name("windows", tests, count_descriptors, no_descriptor_is_left);
}

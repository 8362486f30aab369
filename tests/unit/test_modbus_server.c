/* The Modbus server with its thread, on sockets and on a pty, beside a thread that takes the part of the loop. The
 * other side is libmodbus' client, or raw bytes. Nothing here is judged by the time it takes. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/modbus/rtu.h"
#include "gateway/modbus/server.h"

enum { AT_REALS = 100, REALS = 102, AT_MODEL = 0x1040, COIL_STORE = 1, PATIENCE_MS = 60000 };

/* What happens, and what poll() returns, when the server waits for the loop; NULL: it waits. */
static int (*instead_of_waiting)(void);
static atomic_uint skipped_s;	  /* of the server's time */
static atomic_uint without_delay; /* connections whose answers do not wait for each other */

int poll(struct pollfd *fds, nfds_t count, int timeout)
{
	const struct timespec limit = {timeout / 1000, timeout % 1000 * 1000000};

	if (instead_of_waiting && timeout == MODBUS_LINK_PATIENCE_MS)
		return instead_of_waiting();
	return (int)syscall(SYS_ppoll, fds, count, timeout < 0 ? NULL : &limit, NULL, 0);
}

int clock_gettime(clockid_t clock, struct timespec *t)
{
	int rc = (int)syscall(SYS_clock_gettime, clock, t);

	t->tv_sec += (time_t)skipped_s;
	return rc;
}

int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
	without_delay += level == IPPROTO_TCP && name == TCP_NODELAY && *(const int *)value == 1;
	return (int)syscall(SYS_setsockopt, fd, level, name, value, size);
}

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

static struct fixture {
	struct od od;
	struct od_values values;
	struct od_hook hook;
	struct modbus_link link;
	struct modbus_server *server;
	pthread_t loop;
	atomic_bool quit, end_pending;
	atomic_uint pending;
	char port[8], tty[64];
	int pty;
} f;

static enum od_status write_value(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	(void)ctx;
	return od_write(&f.od, index, sub, wire, size);
}

static void ignore(
	void *ctx, const char *who, const struct od_entry *entry, const void *wire, size_t size, enum od_status status)
{
	(void)ctx, (void)who, (void)entry, (void)wire, (void)size, (void)status;
}

/* Each sample has values that follow from its counter. */
static void next_sample(struct od_values *v)
{
	uint16_t counter = ++v->sample.counter;

	v->sample.time = counter * 10000u;
	v->acceleration_object.l = (float)counter;
	v->displacement_sigma.z = -(float)counter;
}

static void *run_loop(void *arg)
{
	struct pollfd request = {.fd = f.link.request_fd, .events = POLLIN};

	(void)arg;
	while (!atomic_load(&f.quit)) {
		poll(&request, 1, 1);
		struct modbus_job *job = modbus_link_take(&f.link);
		if (job)
			modbus_execute(job, &imu9_modbus_map, &f.od, false, write_value, ignore, NULL);
		next_sample(&f.values);
		modbus_link_publish(&f.link, &f.values);
		if (job)
			modbus_link_done(&f.link);
		if (atomic_exchange(&f.end_pending, false))
			modbus_link_ended(&f.link, OD_OK);
	}
	return NULL;
}

static enum od_status take_long(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	(void)ctx, (void)entry, (void)wire, (void)size;
	if (atomic_load(&f.pending))
		return OD_DEVICE_STATE;
	atomic_store(&f.pending, 1);
	return OD_PENDING;
}

static pthread_mutex_t said_lock = PTHREAD_MUTEX_INITIALIZER;
static char said[4000]; /* by the server, a line each */

static void take_log(int severity, const char *text)
{
	(void)severity;
	pthread_mutex_lock(&said_lock);
	snprintf(said + strlen(said), sizeof(said) - strlen(said), "%s\n", text);
	pthread_mutex_unlock(&said_lock);
}

/* Until the server has said it. */
static void await_log(const char *text)
{
	for (bool found = false; !found; poll(NULL, 0, 1)) {
		pthread_mutex_lock(&said_lock);
		found = strstr(said, text) != NULL;
		pthread_mutex_unlock(&said_lock);
	}
}

/* A port that is free. */
static void choose_port(void)
{
	struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	socklen_t size = sizeof(address);
	int fd = socket(AF_INET, SOCK_STREAM, 0);

	assert_int_equal(bind(fd, (struct sockaddr *)&address, size), 0);
	assert_int_equal(getsockname(fd, (struct sockaddr *)&address, &size), 0);
	snprintf(f.port, sizeof(f.port), "%u", ntohs(address.sin_port));
	close(fd);
}

static void open_pty(void)
{
	struct termios raw;

	f.pty = posix_openpt(O_RDWR | O_NOCTTY);
	assert_true(f.pty >= 0 && grantpt(f.pty) == 0 && unlockpt(f.pty) == 0);
	snprintf(f.tty, sizeof(f.tty), "/tmp/imu9-modbus-tty-%d", (int)getpid());
	unlink(f.tty);
	assert_int_equal(symlink(ptsname(f.pty), f.tty), 0);
	tcgetattr(f.pty, &raw);
	cfmakeraw(&raw);
	tcsetattr(f.pty, TCSANOW, &raw);
}

/* A server on TCP with these options, and on a line as slave 1. */
static void start(const char *options)
{
	struct modbus_window windows[2];
	char text[200], why[200];

	f = (struct fixture){.hook = {.first = 0x1010, .last = 0x1010, .before = take_long}};
	choose_port();
	open_pty();
	od_init(&f.od, &imu9_od_table, &f.values, 1);
	od_attach(&f.od, &f.hook);
	next_sample(&f.values);
	assert_int_equal(modbus_link_open(&f.link), 0);
	modbus_link_publish(&f.link, &f.values);
	snprintf(text, sizeof(text), "tcp:127.0.0.1:%s%s", f.port, options);
	assert_int_equal(modbus_options_parse(&windows[0], text, why, sizeof(why)), 0);
	snprintf(text, sizeof(text), "rtu:%s,baud=115200,parity=none,write=yes", f.tty);
	assert_int_equal(modbus_options_parse(&windows[1], text, why, sizeof(why)), 0);
	const struct modbus_server_config config = {.windows = windows,
		.count = 2,
		.link = &f.link,
		.map = &imu9_modbus_map,
		.table = &imu9_od_table,
		.abort_code = sdo_abort_code,
		.log = take_log};
	f.server = modbus_server_start(&config, why, sizeof(why));
	if (!f.server)
		fail_msg("%s", why);
	assert_int_equal(pthread_create(&f.loop, NULL, run_loop, NULL), 0);
}

static int stop(void **state)
{
	(void)state;
	atomic_store(&f.quit, true);
	pthread_join(f.loop, NULL);
	modbus_server_stop(f.server);
	modbus_link_close(&f.link);
	close(f.pty);
	unlink(f.tty);
	return 0;
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

static modbus_t *connect_client(void)
{
	modbus_t *client = modbus_new_tcp_pi("127.0.0.1", f.port);

	assert_non_null(client);
	modbus_set_response_timeout(client, PATIENCE_MS / 1000, 0);
	assert_int_equal(modbus_connect(client), 0);
	return client;
}

static void close_client(modbus_t *client)
{
	modbus_close(client);
	modbus_free(client);
}

static int connect_raw(void)
{
	struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM, 0);

	address.sin_port = htons((uint16_t)atoi(f.port));
	assert_int_equal(connect(fd, (struct sockaddr *)&address, sizeof(address)), 0);
	return fd;
}

/* Exactly `size` bytes. */
static void receive(int fd, uint8_t *bytes, size_t size)
{
	for (size_t done = 0; done < size;) {
		struct pollfd p = {.fd = fd, .events = POLLIN};

		assert_int_equal(poll(&p, 1, PATIENCE_MS), 1);
		ssize_t n = read(fd, bytes + done, size - done);
		assert_true(n > 0);
		done += (size_t)n;
	}
}

/* The server closes the connection: its end, or a reset. */
static void assert_closed(int fd)
{
	struct pollfd p = {.fd = fd, .events = POLLIN};
	uint8_t byte;

	assert_int_equal(poll(&p, 1, PATIENCE_MS), 1);
	assert_true(read(fd, &byte, 1) <= 0);
	close(fd);
}

static void assert_serves(modbus_t *client)
{
	uint16_t model;

	assert_int_equal(modbus_read_registers(client, AT_MODEL, 1, &model), 1);
	assert_int_equal(model, 2);
}

static float real(const uint16_t *words)
{
	return modbus_get_float_abcd(words);
}

/* ---- TCP --------------------------------------------------------------------------------------------------------- */

static void test_each_response_has_the_values_of_one_sample(void **state)
{
	unsigned different = 0;
	uint16_t last = 0;

	(void)state;
	start(",rate=10000");
	modbus_t *client = connect_client();
	while (different < 300) {
		uint16_t words[REALS];

		assert_int_equal(modbus_read_input_registers(client, AT_REALS, REALS, words), REALS);
		assert_int_equal((uint32_t)words[1] << 16 | words[2], words[0] * 10000u);
		assert_true(real(words + 4) == (float)words[0] && real(words + 100) == -(float)words[0]);
		different += words[0] != last;
		last = words[0];
	}
	close_client(client);
}

static void test_a_client_reads_what_it_wrote_while_samples_go_on(void **state)
{
	(void)state;
	start(",write=127.0.0.1,rate=10000");
	modbus_t *client = connect_client();
	for (int i = 0; i < 500; i++) {
		uint16_t model = 9, mask;

		assert_int_equal(modbus_write_register(client, AT_MODEL, (uint16_t)(i % 3)), 1);
		assert_int_equal(modbus_read_registers(client, AT_MODEL, 1, &model), 1);
		assert_int_equal(model, i % 3);
		assert_int_equal(modbus_mask_write_register(client, AT_MODEL, 0, 2), 1);
		assert_int_equal(
			modbus_write_and_read_registers(client, AT_MODEL, 1, (uint16_t[]){1}, AT_MODEL, 1, &mask), 1);
		assert_int_equal(mask, 1);
	}
	assert_int_equal(modbus_write_register(client, AT_MODEL, 9), -1);
	assert_int_equal(errno, EMBXILVAL);
	assert_int_equal(modbus_write_register(client, 0, 3), -1);
	assert_int_equal(errno, EMBXILADD);
	close_client(client);
}

static void test_an_answer_is_sent_at_once(void **state)
{
	static const uint8_t read_model[] = {0, 9, 0, 0, 0, 6, 1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};
	uint8_t response[11];

	(void)state;
	start("");
	without_delay = 0;
	int fd = connect_raw();
	assert_int_equal(write(fd, read_model, sizeof(read_model)), sizeof(read_model));
	receive(fd, response, sizeof(response));
	close(fd);
	assert_int_equal(without_delay, 1);
}

static void test_a_client_outside_the_second_list_may_only_read(void **state)
{
	(void)state;
	start(",write=127.0.0.2");
	modbus_t *client = connect_client();
	assert_serves(client);
	assert_int_equal(modbus_write_register(client, AT_MODEL, 1), -1);
	assert_int_equal(errno, EMBXILFUN);
	assert_serves(client);
	close_client(client);
}

static void test_a_client_outside_the_first_list_is_not_served(void **state)
{
	(void)state;
	start(",allow=127.0.0.2");
	said[0] = '\0';
	assert_closed(connect_raw());
	assert_int_equal(atomic_load(&modbus_server_counters(f.server)->refused), 1);
	await_log(" is refused: allow= does not have its address\n");
	assert_memory_equal(said, "Modbus: 127.0.0.1:", strlen("Modbus: 127.0.0.1:"));
}

static void test_a_client_that_is_idle_for_the_time_of_its_window_is_closed(void **state)
{
	(void)state;
	start(",idle=10");
	int idle = connect_raw();
	modbus_t *client = connect_client();
	assert_serves(client);
	skipped_s += 9;
	assert_serves(client);
	skipped_s += 2;
	assert_serves(client);
	assert_closed(idle);
	assert_serves(client);
	close_client(client);
}

static void test_there_are_no_more_clients_than_permitted(void **state)
{
	(void)state;
	start(",clients=2");
	modbus_t *one = connect_client(), *two = connect_client();
	assert_serves(one);
	assert_serves(two);
	assert_closed(connect_raw());
	close_client(one);
	modbus_t *three;
	do /* until the server has seen the end of `one` */
		three = connect_client();
	while (modbus_read_registers(three, AT_MODEL, 1, &(uint16_t){0}) < 0 && (close_client(three), true));
	assert_serves(two);
	close_client(two);
	close_client(three);
}

static void test_a_slow_client_does_not_keep_the_others_waiting(void **state)
{
	static const uint8_t request[] = {0, 7, 0, 0, 0, 6, 1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};
	uint8_t response[11];

	(void)state;
	start("");
	int slow = connect_raw();
	modbus_t *client = connect_client();
	for (size_t i = 0; i < sizeof(request); i++) {
		assert_int_equal(write(slow, request + i, 1), 1);
		assert_serves(client);
	}
	receive(slow, response, sizeof(response));
	const uint8_t expected[] = {0, 7, 0, 0, 0, 5, 1, 3, 2, 0, 2};
	assert_memory_equal(response, expected, sizeof(expected));
	close(slow);
	close_client(client);
}

static void test_requests_that_come_together_are_answered_in_their_order(void **state)
{
	uint8_t requests[12 * 20], responses[11 * 20];

	(void)state;
	start("");
	for (uint8_t i = 0; i < 20; i++)
		memcpy(requests + i * 12, (uint8_t[]){0, i, 0, 0, 0, 6, 1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1},
			12);
	int fd = connect_raw();
	assert_int_equal(write(fd, requests, sizeof(requests)), sizeof(requests));
	receive(fd, responses, sizeof(responses));
	for (uint8_t i = 0; i < 20; i++)
		assert_int_equal(responses[i * 11 + 1], i);
	close(fd);
}

/* More than the buffer of a client has room for. */
static void test_requests_beyond_the_rate_of_the_window_wait_and_none_is_lost(void **state)
{
	enum { REQUESTS = 150 };
	uint8_t requests[12 * REQUESTS], responses[11 * REQUESTS];

	(void)state;
	start(",rate=100");
	for (uint8_t i = 0; i < REQUESTS; i++)
		memcpy(requests + i * 12, (uint8_t[]){0, i, 0, 0, 0, 6, 1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1},
			12);
	int fd = connect_raw();
	assert_int_equal(write(fd, requests, sizeof(requests)), sizeof(requests));
	receive(fd, responses, sizeof(responses));
	for (uint8_t i = 0; i < REQUESTS; i++)
		assert_int_equal(responses[i * 11 + 1], i);
	close(fd);
}

static void test_a_wrong_header_ends_the_connection(void **state)
{
	static const uint8_t WRONG[][8] = {{0, 1, 0, 1, 0, 6, 1, 3}, {0, 1, 1, 0, 0, 6, 1, 3}, {0, 1, 0, 0, 0, 1, 1, 3},
		{0, 1, 0, 0, 0, 255, 1, 3}, {0, 1, 0, 0, 0xFF, 0xFF, 1, 3}, {'G', 'E', 'T', ' ', '/', ' ', 'H', 'T'}};

	(void)state;
	start("");
	modbus_t *client = connect_client();
	for (size_t i = 0; i < sizeof(WRONG) / sizeof(*WRONG); i++) {
		int fd = connect_raw();

		assert_int_equal(write(fd, WRONG[i], 8), 8);
		assert_closed(fd);
		assert_int_equal(atomic_load(&modbus_server_counters(f.server)->malformed), i + 1);
	}
	assert_serves(client);
	close_client(client);
}

static void test_a_store_that_takes_long_keeps_only_its_client_waiting(void **state)
{
	static const uint8_t store[] = {0, 9, 0, 0, 0, 6, 1, 5, 0, COIL_STORE, 0xFF, 0};
	uint8_t response[12];

	(void)state;
	start(",write=127.0.0.1");
	int storing = connect_raw();
	modbus_t *client = connect_client();
	assert_int_equal(write(storing, store, sizeof(store)), sizeof(store));
	while (!atomic_load(&f.pending))
		assert_serves(client);
	assert_serves(client);
	assert_int_equal(modbus_write_bit(client, COIL_STORE, 1), -1);
	assert_int_equal(errno, EMBXSBUSY);
	assert_int_equal(recv(storing, response, 1, MSG_DONTWAIT), -1);
	atomic_store(&f.end_pending, true);
	receive(storing, response, sizeof(response));
	assert_memory_equal(response, store, sizeof(store));
	close(storing);
	close_client(client);
}

/* ---- RTU --------------------------------------------------------------------------------------------------------- */

static void send_line(const uint8_t *bytes, size_t size)
{
	uint8_t frame[64];
	uint16_t crc = modbus_crc(bytes, size);

	memcpy(frame, bytes, size);
	frame[size] = (uint8_t)crc;
	frame[size + 1] = (uint8_t)(crc >> 8);
	assert_int_equal(write(f.pty, frame, size + 2), size + 2);
}

/* Sends it again after a second without an answer: a busy machine may split a frame by more than the silence between
 * two, and the server then drops it. */
static void ask_line(const uint8_t *request, size_t request_size, uint8_t *response, size_t size)
{
	struct pollfd p = {.fd = f.pty, .events = POLLIN};

	do
		send_line(request, request_size);
	while (poll(&p, 1, 1000) == 0);
	receive(f.pty, response, size);
}

static void assert_line_reads(uint16_t model)
{
	static const uint8_t read_model[] = {1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};
	uint8_t response[7];

	ask_line(read_model, sizeof(read_model), response, sizeof(response));
	assert_int_equal(modbus_crc(response, sizeof(response)), 0);
	const uint8_t expected[] = {1, 3, 2, 0, (uint8_t)model};
	assert_memory_equal(response, expected, sizeof(expected));
}

static void test_a_serial_line_is_served_as_slave(void **state)
{
	static const uint8_t write_model[] = {1, 6, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};
	uint8_t response[8];

	(void)state;
	start("");
	assert_line_reads(2);
	ask_line(write_model, sizeof(write_model), response, sizeof(response));
	assert_memory_equal(response, write_model, sizeof(write_model));
	assert_line_reads(1);
}

/* A USB adapter that is pulled and plugged in again. */
static void test_a_line_that_is_gone_is_opened_again(void **state)
{
	(void)state;
	start("");
	said[0] = '\0';
	assert_line_reads(2);
	close(f.pty);
	await_log(" is gone; trying to open it again\n");
	open_pty();
	skipped_s += 3;
	await_log(" is back\n");
	assert_line_reads(2);
}

static void test_a_broadcast_is_executed_without_a_response(void **state)
{
	static const uint8_t broadcast[] = {0, 6, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 0};

	(void)state;
	start("");
	for (int ms = 0; atomic_load(&modbus_server_counters(f.server)->requests) < 1; ms++) {
		if (ms % 1000 == 0) /* as in ask_line() */
			send_line(broadcast, sizeof(broadcast));
		poll(NULL, 0, 1);
	}
	assert_line_reads(0);
}

static void test_requests_to_other_slaves_and_noise_are_not_answered(void **state)
{
	static const uint8_t other[] = {7, 3, 0, 0, 0, 1};

	(void)state;
	start("");
	send_line(other, sizeof(other));
	assert_line_reads(2);
	assert_int_equal(write(f.pty, "\x01\x03\x10\x40\x00\x01\x00\x00", 8), 8); /* CRC wrong */
	while (atomic_load(&modbus_server_counters(f.server)->malformed) < 1)
		poll(NULL, 0, 1);
	assert_line_reads(2);
	assert_int_equal(atomic_load(&modbus_server_counters(f.server)->requests), 2);
}

/* ---- the link ---------------------------------------------------------------------------------------------------- */

static void take_and_wait(void *ctx)
{
	struct modbus_link *link = ctx;
	struct modbus_job *job = modbus_link_take(link);

	assert_non_null(job);
	job->status = OD_PENDING;
	modbus_link_done(link);
}

static void test_the_end_of_a_job_is_that_of_its_ticket(void **state)
{
	static struct modbus_link link;
	enum od_status status;
	uint8_t first, ticket;

	(void)state;
	modbus_link_direct(&link, take_and_wait, &link);
	modbus_link_ended(&link, OD_OK); /* of another client of the store */
	assert_false(modbus_link_late(&link, &ticket, &status));
	assert_int_equal(modbus_link_submit(&link), OD_PENDING);
	first = link.job.ticket;
	modbus_link_ended(&link, OD_CANNOT_STORE);
	assert_int_equal(modbus_link_submit(&link), OD_PENDING); /* before the first answer was taken */
	assert_true(modbus_link_late(&link, &ticket, &status));
	assert_int_equal(ticket, first);
	assert_int_equal(status, OD_CANNOT_STORE);
	assert_false(modbus_link_late(&link, &ticket, &status));
	modbus_link_ended(&link, OD_OK);
	assert_true(modbus_link_late(&link, &ticket, &status));
	assert_int_equal(ticket, link.job.ticket);
	assert_int_equal(status, OD_OK);
	modbus_link_ended(&link, OD_OK); /* there is none any more */
	assert_false(modbus_link_late(&link, &ticket, &status));
}

static void test_a_snapshot_stays_until_the_next_one_is_asked_for(void **state)
{
	static struct modbus_link link;
	static struct od_values values;

	(void)state;
	modbus_link_direct(&link, take_and_wait, &link);
	for (uint32_t i = 1; i < 50; i++) {
		const struct od_values *read = modbus_link_values(&link);
		uint16_t before = read->sample.counter;

		for (uint32_t k = 0; k < i % 4; k++) {
			values.sample.counter++;
			modbus_link_publish(&link, &values);
			assert_int_equal(read->sample.counter, before);
		}
		read = modbus_link_values(&link);
		assert_int_equal(read->sample.counter, values.sample.counter);
		assert_ptr_equal(modbus_link_values(&link), read);
	}
}

static struct modbus_link waited;

static int nothing_happens(void)
{
	return 0;
}

/* The loop has begun before the patience ends, and ends later. */
static int take_then_end(void)
{
	static struct modbus_job *job;

	if (!job) {
		job = modbus_link_take(&waited);
		return 0;
	}
	job->status = OD_TOO_HIGH;
	modbus_link_done(&waited);
	return 1;
}

static void test_a_job_that_the_loop_does_not_begin_is_withdrawn_and_one_that_it_has_begun_is_waited_for(void **state)
{
	(void)state;
	assert_int_equal(modbus_link_open(&waited), 0);
	instead_of_waiting = nothing_happens;
	assert_int_equal(modbus_link_submit(&waited), OD_DEVICE_STATE);
	assert_null(modbus_link_take(&waited));
	instead_of_waiting = take_then_end;
	assert_int_equal(modbus_link_submit(&waited), OD_TOO_HIGH);
	instead_of_waiting = NULL;
	modbus_link_close(&waited);
}

/* ---- start and end ----------------------------------------------------------------------------------------------- */

static void test_a_window_that_cannot_be_opened_is_told(void **state)
{
	struct modbus_window windows[2];
	char text[64], why[200];

	(void)state;
	start("");
	snprintf(text, sizeof(text), "tcp:127.0.0.1:%s", f.port);
	assert_int_equal(modbus_options_parse(&windows[0], text, why, sizeof(why)), 0);
	assert_int_equal(modbus_options_parse(&windows[1], "rtu:/dev/none", why, sizeof(why)), 0);
	struct modbus_server_config config = {.windows = windows, .count = 1, .link = &f.link, .log = take_log};
	assert_null(modbus_server_start(&config, why, sizeof(why)));
	assert_non_null(strstr(why, f.port));
	assert_non_null(strstr(why, strerror(EADDRINUSE)));
	config.windows = windows + 1;
	assert_null(modbus_server_start(&config, why, sizeof(why)));
	assert_non_null(strstr(why, "/dev/none: No such file"));
}

static void test_the_server_ends_while_a_job_waits_for_the_loop(void **state)
{
	static const uint8_t write_model[] = {0, 9, 0, 0, 0, 6, 1, 6, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};

	(void)state;
	start(",write=127.0.0.1");
	atomic_store(&f.quit, true);
	pthread_join(f.loop, NULL);
	int fd = connect_raw();
	assert_int_equal(write(fd, write_model, sizeof(write_model)), sizeof(write_model));
	while (atomic_load(&modbus_server_counters(f.server)->requests) < 1)
		poll(NULL, 0, 1);
	modbus_server_stop(f.server);
	modbus_link_close(&f.link);
	assert_int_equal(f.values.lever_arm_model, 2);
	close(f.pty);
	close(fd);
}

#define TEST(name) cmocka_unit_test_teardown(name, stop)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_each_response_has_the_values_of_one_sample),
		TEST(test_a_client_reads_what_it_wrote_while_samples_go_on),
		TEST(test_an_answer_is_sent_at_once),
		TEST(test_a_client_outside_the_second_list_may_only_read),
		TEST(test_a_client_outside_the_first_list_is_not_served),
		TEST(test_a_client_that_is_idle_for_the_time_of_its_window_is_closed),
		TEST(test_there_are_no_more_clients_than_permitted),
		TEST(test_a_slow_client_does_not_keep_the_others_waiting),
		TEST(test_requests_that_come_together_are_answered_in_their_order),
		TEST(test_requests_beyond_the_rate_of_the_window_wait_and_none_is_lost),
		TEST(test_a_wrong_header_ends_the_connection),
		TEST(test_a_store_that_takes_long_keeps_only_its_client_waiting),
		TEST(test_a_serial_line_is_served_as_slave),
		TEST(test_a_line_that_is_gone_is_opened_again),
		TEST(test_a_broadcast_is_executed_without_a_response),
		TEST(test_requests_to_other_slaves_and_noise_are_not_answered),
		TEST(test_a_window_that_cannot_be_opened_is_told),
		cmocka_unit_test(test_the_end_of_a_job_is_that_of_its_ticket),
		cmocka_unit_test(test_a_snapshot_stays_until_the_next_one_is_asked_for),
		cmocka_unit_test(
			test_a_job_that_the_loop_does_not_begin_is_withdrawn_and_one_that_it_has_begun_is_waited_for),
		cmocka_unit_test(test_the_server_ends_while_a_job_waits_for_the_loop),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

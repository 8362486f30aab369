/* The thread of the Modbus server turn by turn: in simulated time, with simulated sockets and lines. It stands still
 * between two turns, so that what it waits for, and how long, is seen to the microsecond. libmodbus, which opens
 * sockets and lines, is simulated, too. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <semaphore.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/modbus/rtu.h"
#include "gateway/modbus/server.h"
#include "tests/unit/descriptors.h"

enum { AT_MODEL = 0x1040, WINDOWS = MODBUS_WINDOWS_MAX, QUEUE = 64 };
static const uint64_t FOREVER = UINT64_MAX;

/* ---- the operating system ---------------------------------------------------------------------------------------- */

static uint64_t now_us;
static pthread_t test_thread;
static sem_t go, arrived;
static atomic_bool ending;
static uint64_t waits_us; /* of the server: FOREVER, or how long */
static struct pollfd waited[1 + WINDOWS + MODBUS_CLIENTS_MAX];
static size_t waited_count;
static unsigned priorities; /* nice values that were set */
static int policy;

int clock_gettime(clockid_t clock, struct timespec *t)
{
	(void)clock;
	*t = (struct timespec){.tv_sec = (time_t)(now_us / 1000000), .tv_nsec = (long)(now_us % 1000000) * 1000};
	return 0;
}

/* The server waits: until the next turn. */
int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	(void)mask;
	waits_us = timeout ? (uint64_t)timeout->tv_sec * 1000000 + (uint64_t)timeout->tv_nsec / 1000 : FOREVER;
	memcpy(waited, fds, n * sizeof(*fds));
	waited_count = n;
	sem_post(&arrived);
	while (!atomic_load(&ending) && sem_wait(&go) != 0)
		;
	return (int)syscall(SYS_ppoll, fds, n, &(struct timespec){0}, NULL, 0);
}

int setpriority(__priority_which_t which, id_t who, int value)
{
	priorities += which == PRIO_PROCESS && who == 0 && value == 10;
	return 0;
}

int pthread_setschedparam(pthread_t thread, int to, const struct sched_param *param)
{
	policy = pthread_equal(thread, pthread_self()) && param->sched_priority == 0 ? to : -1;
	return 0;
}

static int read_result; /* of a read: negative: -errno; 0: as it is; 1: nothing is there */

ssize_t read(int fd, void *bytes, size_t size)
{
	if (read_result && !pthread_equal(pthread_self(), test_thread)) {
		errno = -read_result;
		return read_result < 0 ? -1 : 0;
	}
	return syscall(SYS_read, fd, bytes, size);
}

static size_t room = SIZE_MAX; /* of the kernel, for answers */

ssize_t send(int fd, const void *bytes, size_t size, int flags)
{
	assert_int_equal(flags, MSG_NOSIGNAL);
	return syscall(SYS_sendto, fd, bytes, size < room ? size : room, flags, NULL, 0);
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	return syscall(SYS_write, fd, bytes, size < room ? size : room);
}

static unsigned without_delay;

int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
	(void)fd;
	without_delay += level == IPPROTO_TCP && name == TCP_NODELAY && size == sizeof(int) && *(const int *)value == 1;
	return 0;
}

static bool no_thread;
static size_t stack;

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*body)(void *), void *arg)
{
	int (*create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);

	*(void **)&create = dlsym(RTLD_NEXT, "pthread_create");
	pthread_attr_getstacksize(attributes, &stack);
	return no_thread ? EAGAIN : create(thread, attributes, body, arg);
}

static int refused_command = -1; /* of fcntl() */
static bool nonblocking, closes_on_exec;

int fcntl(int fd, int command, ...)
{
	va_list args;
	int value;

	va_start(args, command);
	value = va_arg(args, int);
	va_end(args);
	nonblocking |= command == F_SETFL && value == O_NONBLOCK;
	closes_on_exec |= command == F_SETFD && value == FD_CLOEXEC;
	if (command != refused_command)
		return (int)syscall(SYS_fcntl, fd, command, value);
	errno = EPERM;
	return -1;
}

/* Who comes to a listener. */
static struct {
	int listener, fd;
	struct sockaddr_in6 peer;
	socklen_t size;
} coming[QUEUE];
static size_t came, accepted;

int accept4(int listener, __SOCKADDR_ARG peer, socklen_t *restrict size, int flags)
{
	assert_int_equal(flags, SOCK_NONBLOCK | SOCK_CLOEXEC);
	if (accepted == came || coming[accepted].listener != listener) {
		errno = EAGAIN;
		return -1;
	}
	assert_true(*size >= coming[accepted].size);
	memcpy(peer.__sockaddr__, &coming[accepted].peer, coming[accepted].size);
	eventfd_read(listener, &(eventfd_t){0});
	return coming[accepted++].fd;
}

/* ---- libmodbus --------------------------------------------------------------------------------------------------- */

static struct {
	int context; /* what a modbus_t is here */
	unsigned made, freed, connected;
	int new_errno, open_errno; /* of the next */
	int listeners[WINDOWS], listener_count;
	char text[200]; /* with what it was called */
	int line;	/* this end of the serial line */
} lib;

modbus_t *modbus_new_tcp_pi(const char *host, const char *port)
{
	snprintf(lib.text, sizeof(lib.text), "%s %s", host, port);
	errno = lib.new_errno;
	lib.made += !lib.new_errno;
	return lib.new_errno ? NULL : (modbus_t *)&lib.context;
}

int modbus_tcp_pi_listen(modbus_t *ctx, int backlog)
{
	assert_ptr_equal(ctx, &lib.context);
	assert_in_range(backlog, 1, 100);
	if (lib.open_errno) {
		errno = lib.open_errno < 0 ? 0 : lib.open_errno;
		return -1;
	}
	return lib.listeners[lib.listener_count++] = eventfd(0, EFD_SEMAPHORE);
}

modbus_t *modbus_new_rtu(const char *device, int baud, char parity, int bits, int stop)
{
	snprintf(lib.text, sizeof(lib.text), "%s %d %c %d %d", device, baud, parity, bits, stop);
	errno = lib.new_errno;
	lib.made += !lib.new_errno;
	return lib.new_errno ? NULL : (modbus_t *)&lib.context;
}

static int line_fd; /* the server's end */

int modbus_connect(modbus_t *ctx)
{
	int pair[2];

	assert_ptr_equal(ctx, &lib.context);
	lib.connected++;
	if (lib.open_errno) {
		errno = lib.open_errno;
		return -1;
	}
	assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, pair), 0);
	lib.line = pair[0];
	line_fd = pair[1];
	return 0;
}

int modbus_get_socket(modbus_t *ctx)
{
	assert_ptr_equal(ctx, &lib.context);
	return line_fd;
}

void modbus_close(modbus_t *ctx)
{
	assert_ptr_equal(ctx, &lib.context);
	if (line_fd >= 0)
		close(line_fd);
	line_fd = -1;
}

void modbus_free(modbus_t *ctx)
{
	assert_ptr_equal(ctx, &lib.context);
	lib.freed++;
}

/* ---- the server -------------------------------------------------------------------------------------------------- */

static struct od od;
static struct od_values values;
static struct modbus_link link_;
static struct modbus_server *server;
static enum od_status write_status;
static char said[2000];
static char who[MODBUS_WHO_MAX]; /* wrote last */

static enum od_status write_value(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	(void)ctx;
	return write_status ? write_status : od_write(&od, index, sub, wire, size);
}

static void wrote(
	void *ctx, const char *name, const struct od_entry *entry, const void *wire, size_t size, enum od_status status)
{
	(void)ctx, (void)entry, (void)wire, (void)size, (void)status;
	snprintf(who, sizeof(who), "%s", name);
}

static void serve(void *ctx)
{
	(void)ctx;
	struct modbus_job *job = modbus_link_take(&link_);

	modbus_execute(job, &imu9_modbus_map, &od, false, write_value, wrote, NULL);
	modbus_link_publish(&link_, &values);
	modbus_link_done(&link_);
}

static void take_log(int severity, const char *text)
{
	snprintf(said + strlen(said), sizeof(said) - strlen(said), "<%d>%s\n", severity, text);
}

static const struct modbus_counters *counters(void)
{
	return modbus_server_counters(server);
}

/* The server turns once, at this time, and waits again. */
static void turn(void)
{
	sem_post(&go);
	while (sem_wait(&arrived) != 0)
		;
}

static void pass(uint64_t us)
{
	now_us += us;
	turn();
}

static char why[200];

static struct modbus_server *open_server(const char *const *options, size_t count)
{
	struct modbus_window windows[WINDOWS];

	for (size_t i = 0; i < count; i++)
		assert_int_equal(modbus_options_parse(&windows[i], options[i], why, sizeof(why)), 0);
	const struct modbus_server_config config = {.windows = windows,
		.count = count,
		.link = &link_,
		.map = &imu9_modbus_map,
		.table = &imu9_od_table,
		.abort_code = sdo_abort_code,
		.log = take_log};
	return modbus_server_start(&config, why, sizeof(why));
}

static int set_up(void **state)
{
	(void)state;
	now_us = 5000000;
	memset(&lib, 0, sizeof(lib));
	lib.line = line_fd = -1;
	came = accepted = 0;
	read_result = 0;
	room = SIZE_MAX;
	priorities = without_delay = 0;
	policy = -1;
	ending = false;
	write_status = OD_OK;
	said[0] = who[0] = '\0';
	test_thread = pthread_self();
	sem_init(&go, 0, 0);
	sem_init(&arrived, 0, 0);
	od_init(&od, &imu9_od_table, &values, 5);
	modbus_link_direct(&link_, serve, NULL);
	link_.done_fd = eventfd(0, EFD_NONBLOCK);
	modbus_link_publish(&link_, &values);
	return 0;
}

static void start(const char *options)
{
	server = open_server(&options, 1);
	if (!server)
		fail_msg("%s", why);
	while (sem_wait(&arrived) != 0)
		;
}

static int tear_down(void **state)
{
	(void)state;
	if (server) {
		atomic_store(&ending, true);
		sem_post(&go);
		modbus_server_stop(server);
	}
	server = NULL;
	modbus_link_close(&link_);
	if (lib.line >= 0)
		close(lib.line);
	assert_int_equal(lib.made, lib.freed);
	return 0;
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

/* Comes to a window; its socket. */
static int come_to(int window, const char *address, uint16_t port)
{
	struct sockaddr_in6 peer = {.sin6_family = AF_INET6, .sin6_port = htons(port)};
	struct sockaddr_in v4 = {.sin_family = AF_INET, .sin_port = htons(port)};
	int pair[2];

	assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, pair), 0);
	coming[came].listener = lib.listeners[window];
	coming[came].fd = pair[1];
	coming[came].size = sizeof(peer);
	if (inet_pton(AF_INET, address, &v4.sin_addr) == 1) {
		memcpy(&peer, &v4, sizeof(v4));
		coming[came].size = sizeof(v4);
	} else {
		assert_int_equal(inet_pton(AF_INET6, address, &peer.sin6_addr), 1);
	}
	coming[came++].peer = peer;
	eventfd_write(lib.listeners[window], 1);
	return pair[0];
}

static int come(void)
{
	int fd = come_to(0, "127.0.0.1", 4711);

	turn();
	return fd;
}

static void put(int fd, const void *bytes, size_t size)
{
	assert_int_equal(syscall(SYS_write, fd, bytes, size), size);
}

/* A request to read the lever-arm model, with its number. */
static void ask(int fd, uint8_t number)
{
	const uint8_t request[] = {0, number, 0, 0, 0, 6, 0x55, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};

	put(fd, request, sizeof(request));
}

static uint8_t got[600];

/* How many bytes the client has received, or -1: the end. */
static int take(int fd)
{
	ssize_t n = syscall(SYS_read, fd, got, sizeof(got));

	return n == 0 ? -1 : n < 0 ? 0 : (int)n;
}

static void assert_answered(int fd, uint8_t number)
{
	const uint8_t answer[] = {0, number, 0, 0, 0, 5, 0x55, 3, 2, 0, 2};

	assert_int_equal(take(fd), sizeof(answer));
	assert_memory_equal(got, answer, sizeof(answer));
}

/* What the server waits for of a client's socket; -1: it does not wait for it. */
static int events_of_client(size_t client)
{
	const struct pollfd *p = &waited[1 + WINDOWS + client];

	return p->fd < 0 ? -1 : p->events;
}

static unsigned count_of(const atomic_uint *counter)
{
	return atomic_load(counter);
}

/* ---- who comes --------------------------------------------------------------------------------------------------- */

static void test_the_thread_leaves_the_processor_to_the_loop(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502");
	assert_string_equal(lib.text, "127.0.0.1 1502");
	assert_int_equal(policy, SCHED_OTHER);
	assert_int_equal(priorities, 1);
	assert_int_equal(waits_us, FOREVER);
	assert_int_equal(waited_count, 1 + WINDOWS + MODBUS_CLIENTS_MAX);
	assert_int_equal(waited[0].fd, link_.done_fd);
	assert_int_equal(waited[0].events, POLLIN);
	assert_int_equal(waited[1].events, POLLIN);
	assert_int_equal(waited[2].fd, -1);
}

static void test_a_client_is_told_by_its_address_and_port(void **state)
{
	const uint8_t write_model[] = {0, 1, 0, 0, 0, 6, 0, 6, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};
	static const char *const PEERS[][2] = {
		{"192.168.1.20", "192.168.1.20:65535"}, {"2001:db8::7", "[2001:db8::7]:65535"}};

	(void)state;
	start("tcp:[::]:502,allow=0.0.0.0/0,allow=::/0,write=192.168.1.20,write=2001:db8::/32");
	for (int i = 0; i < 2; i++) {
		int fd = come_to(0, PEERS[i][0], 65535);

		turn();
		put(fd, write_model, sizeof(write_model));
		turn();
		assert_string_equal(who, PEERS[i][1]);
		assert_int_equal(take(fd), sizeof(write_model));
		assert_memory_equal(got, write_model, sizeof(write_model));
		close(fd);
		turn();
	}
	assert_int_equal(without_delay, 2);
	int reader = come_to(0, "192.168.1.21", 1);
	turn();
	put(reader, write_model, sizeof(write_model));
	turn();
	assert_int_equal(take(reader), 9);
	assert_memory_equal(got, "\0\1\0\0\0\3\0\x86\1", 9);
	assert_int_equal(count_of(&counters()->writes), 2);
	assert_int_equal(count_of(&counters()->requests), 3);
	assert_int_equal(count_of(&counters()->exceptions), 1);
	close(reader);
}

static void test_who_is_refused_is_told_once_a_second(void **state)
{
	(void)state;
	start("tcp:0.0.0.0:502,allow=10.0.0.0/8");
	for (int i = 0; i < 3; i++) {
		int fd = come_to(0, "11.0.0.1", (uint16_t)(20 + i));

		pass(i < 2 ? 999999 * (uint64_t)i : 1);
		assert_int_equal(take(fd), -1);
		close(fd);
	}
	assert_string_equal(said, "<4>Modbus: 11.0.0.1:20 is refused: allow= does not have its address\n"
				  "<4>Modbus: 11.0.0.1:22 is refused: allow= does not have its address\n");
	assert_int_equal(count_of(&counters()->refused), 3);
	assert_int_equal(count_of(&counters()->clients), 0);
}

static void test_each_window_has_its_clients_and_all_have_32(void **state)
{
	static const char *const OPTIONS[] = {
		"tcp:127.0.0.1:1,clients=2", "tcp:127.0.0.1:2,clients=30", "tcp:127.0.0.1:3,clients=32"};
	int fds[40], n = 0;

	(void)state;
	server = open_server(OPTIONS, 3);
	while (sem_wait(&arrived) != 0)
		;
	for (int i = 0; i < 3; i++)
		fds[n++] = come_to(0, "127.0.0.1", 1);
	turn();
	assert_int_equal(take(fds[1]), 0);
	assert_int_equal(take(fds[2]), -1);
	assert_non_null(strstr(said, "127.0.0.1:1 is refused: too many clients\n"));
	for (int i = 0; i < 20; i++)
		fds[n++] = come_to(1, "127.0.0.1", 2);
	turn(); /* eight in a turn, so that the others have theirs */
	assert_int_equal(count_of(&counters()->clients), 10);
	turn();
	turn();
	assert_int_equal(count_of(&counters()->clients), 22);
	for (int i = 0; i < 11; i++)
		fds[n++] = come_to(2, "127.0.0.1", 3);
	turn();
	turn();
	assert_int_equal(count_of(&counters()->clients), 32);
	assert_int_equal(count_of(&counters()->refused), 2);
	assert_int_equal(take(fds[n - 1]), -1);
	assert_int_equal(take(fds[n - 2]), 0);
	close(fds[0]);
	turn();
	assert_int_equal(count_of(&counters()->clients), 31);
	fds[0] = come_to(0, "127.0.0.1", 1);
	turn();
	assert_int_equal(count_of(&counters()->clients), 32);
	while (n > 0)
		close(fds[--n]);
}

/* ---- TCP --------------------------------------------------------------------------------------------------------- */

static void test_a_client_has_a_second_of_requests_and_then_its_rate(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502,rate=4,idle=100");
	int fd = come();
	for (uint8_t i = 0; i < 6; i++)
		ask(fd, i);
	for (uint8_t i = 0; i < 4; i++) {
		turn();
		assert_answered(fd, i);
		assert_int_equal(waits_us, i < 3 ? 0 : 250000);
	}
	turn();
	assert_int_equal(take(fd), 0);
	assert_int_equal(events_of_client(0), 0); /* its next request waits already */
	assert_int_equal(waits_us, 250000);
	pass(100000);
	assert_int_equal(waits_us, 150000);
	pass(149999);
	assert_int_equal(take(fd), 0);
	assert_int_equal(waits_us, 1);
	pass(1);
	assert_answered(fd, 4);
	turn();
	assert_int_equal(waits_us, 250000);
	pass(250000);
	assert_answered(fd, 5);
	assert_int_equal(events_of_client(0), POLLIN);
	pass(10000000); /* what it does not use for longer than a second is lost */
	for (uint8_t i = 0; i < 6; i++)
		ask(fd, i);
	for (uint8_t i = 0; i < 4; i++) {
		turn();
		assert_answered(fd, i);
	}
	turn();
	assert_int_equal(take(fd), 0);
	assert_int_equal(count_of(&counters()->requests), 10);
	close(fd);
}

static void test_a_client_is_closed_when_its_time_without_a_request_is_over(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502,idle=60");
	int fd = come();
	assert_int_equal(waits_us, 60000000);
	pass(40500000);
	assert_int_equal(waits_us, 19500000);
	ask(fd, 1);
	turn();
	assert_answered(fd, 1);
	assert_int_equal(waits_us, 60000000);
	pass(30000000);
	put(fd, "\0\2\0", 3); /* the beginning of a request does not count */
	turn();
	assert_int_equal(waits_us, 30000000);
	pass(29999999);
	assert_int_equal(take(fd), 0);
	assert_int_equal(waits_us, 1);
	pass(1);
	assert_int_equal(take(fd), -1);
	assert_int_equal(waits_us, FOREVER);
	assert_int_equal(count_of(&counters()->clients), 0);
	assert_string_equal(said, "");
	close(fd);
}

static void test_a_request_in_pieces_is_answered_with_its_last_byte(void **state)
{
	const uint8_t request[] = {1, 2, 0, 0, 0, 6, 0xFF, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};

	(void)state;
	start("tcp:127.0.0.1:1502");
	int fd = come();
	for (size_t i = 0; i < sizeof(request); i++) {
		assert_int_equal(take(fd), 0);
		put(fd, request + i, 1);
		turn();
	}
	assert_int_equal(take(fd), 11);
	assert_memory_equal(got, "\1\2\0\0\0\5\xFF\3\2\0\2", 11);
	close(fd);
}

static void test_the_shortest_and_the_longest_frames_are_served_and_others_end_the_connection(void **state)
{
	static const struct {
		uint8_t head[6];
		bool good;
	} HEADS[] = {{{0, 1, 0, 0, 0, 1}, false}, {{0, 1, 0, 0, 0, 2}, true}, {{0, 1, 0, 0, 0, 254}, true},
		{{0, 1, 0, 0, 0, 255}, false}, {{0, 1, 0, 0, 1, 2}, false}, {{0, 1, 1, 0, 0, 6}, false},
		{{0, 1, 0, 1, 0, 6}, false}};
	uint8_t frame[300];
	unsigned malformed = 0;

	(void)state;
	start("tcp:127.0.0.1:1502");
	for (size_t i = 0; i < sizeof(HEADS) / sizeof(HEADS[0]); i++) {
		int fd = come();

		memset(frame, 0x41, sizeof(frame)); /* no such function */
		memcpy(frame, HEADS[i].head, 6);
		put(fd, frame, 5);
		turn();
		assert_int_equal(take(fd), 0);
		put(fd, frame + 5, HEADS[i].good ? frame[5] + 1u : 1);
		turn();
		turn();
		assert_int_equal(take(fd), HEADS[i].good ? 9 : -1);
		if (HEADS[i].good)
			assert_memory_equal(got, "\0\1\0\0\0\3\x41\xC1\1", 9);
		malformed += !HEADS[i].good;
		assert_int_equal(count_of(&counters()->malformed), malformed);
		close(fd);
		turn();
	}
	assert_int_equal(count_of(&counters()->requests), 2);
	assert_int_equal(count_of(&counters()->exceptions), 2);
}

static void test_a_client_that_does_not_take_its_answer_is_closed(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502");
	int fd = come();
	ask(fd, 1);
	room = 10;
	turn();
	assert_int_equal(take(fd), 10);
	assert_int_equal(take(fd), -1);
	assert_int_equal(count_of(&counters()->clients), 0);
	close(fd);
}

static void test_a_read_that_is_to_be_repeated_keeps_the_client_and_another_error_does_not(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502");
	int fd = come();
	ask(fd, 1);
	read_result = -EAGAIN;
	turn();
	read_result = -EINTR;
	turn();
	read_result = 0;
	turn();
	assert_answered(fd, 1);
	ask(fd, 2);
	read_result = -EIO;
	turn();
	read_result = 0;
	assert_int_equal(count_of(&counters()->clients), 0);
	close(fd);
}

static void test_what_a_client_sent_before_its_end_is_answered(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502");
	int fd = come();
	ask(fd, 1);
	shutdown(fd, SHUT_WR);
	turn();
	assert_answered(fd, 1);
	turn();
	assert_int_equal(count_of(&counters()->clients), 0);
	close(fd);
}

static void test_the_node_id_of_function_43_13_is_that_of_the_device(void **state)
{
	const uint8_t request[] = {0, 1, 0, 0, 0, 12, 0, 0x2B, 0x0D, 0, 33, 0x10, 0x17, 0, 0, 0, 0, 9};

	(void)state;
	start("tcp:127.0.0.1:1502");
	int fd = come();
	put(fd, request, sizeof(request));
	turn();
	assert_int_equal(take(fd), 17);
	assert_memory_equal(got + 7, "\xAB\xFF\0\6\x0D\xEC\x06\x0A\0\x23", 10);
	modbus_server_node_id(server, 33);
	put(fd, request, sizeof(request));
	turn();
	assert_int_equal(take(fd), 20);
	assert_memory_equal(got + 18, "\xE8\x03", 2);
	close(fd);
}

/* ---- writes that take longer ------------------------------------------------------------------------------------- */

static void write_model(int fd, uint8_t number)
{
	const uint8_t request[] = {0, number, 0, 0, 0, 6, 9, 6, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};

	put(fd, request, sizeof(request));
}

static void test_a_client_whose_write_takes_longer_waits_and_gets_its_own_answer(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502,write=127.0.0.1,idle=5");
	int first = come(), second = come();
	write_status = OD_PENDING;
	write_model(first, 1);
	ask(first, 2);
	turn();
	assert_int_equal(take(first), 0);
	assert_int_equal(events_of_client(0), 0);
	pass(4999999); /* it is not idle, and only the other has a deadline */
	assert_int_equal(waits_us, 1);
	ask(second, 3);
	turn();
	assert_answered(second, 3);
	pass(4000000);
	assert_int_equal(take(first), 0);
	modbus_link_ended(&link_, OD_CANNOT_STORE);
	turn();
	assert_int_equal(take(first), 9);
	assert_memory_equal(got, "\0\1\0\0\0\3\x09\x86\4", 9);
	assert_int_equal(take(second), 0);
	assert_int_equal(syscall(SYS_read, link_.done_fd, got, 8), -1);
	turn();
	assert_answered(first, 2);
	assert_int_equal(waits_us, 1000000); /* of the second */
	write_model(first, 4);
	turn();
	modbus_link_ended(&link_, OD_OK);
	turn();
	assert_int_equal(take(first), 12);
	assert_memory_equal(got, "\0\4\0\0\0\6\x09\6\x10\x40\0\1", 12);
	assert_int_equal(count_of(&counters()->exceptions), 1);
	close(first);
	close(second);
}

static void test_a_client_that_is_gone_before_its_write_ends_is_forgotten(void **state)
{
	(void)state;
	start("tcp:127.0.0.1:1502,write=127.0.0.1");
	int fd = come();
	write_status = OD_PENDING;
	write_model(fd, 1);
	turn();
	room = 0;
	modbus_link_ended(&link_, OD_OK);
	turn();
	assert_int_equal(count_of(&counters()->clients), 0);
	room = SIZE_MAX;
	close(fd);
	int next = come();
	ask(next, 7);
	turn();
	assert_answered(next, 7);
	close(next);
}

/* ---- a serial line ----------------------------------------------------------------------------------------------- */

static size_t with_crc(uint8_t *frame, size_t size)
{
	uint16_t crc = modbus_crc(frame, size);

	frame[size] = (uint8_t)crc;
	frame[size + 1] = (uint8_t)(crc >> 8);
	return size + 2;
}

static void send_line(uint8_t slave, uint8_t function, uint8_t value)
{
	uint8_t frame[16] = {slave, function, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, value};

	put(lib.line, frame, with_crc(frame, 6));
}

static void assert_line_answers(const char *bytes, size_t size)
{
	uint8_t frame[32];

	memcpy(frame, bytes, size);
	size = with_crc(frame, size);
	assert_int_equal(take(lib.line), size);
	assert_memory_equal(got, frame, size);
}

static void test_a_line_is_opened_as_its_options_say(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS7,baud=57600,parity=odd,stop=2,address=17");
	assert_string_equal(lib.text, "/dev/ttyS7 57600 O 8 2");
	assert_int_equal(count_of(&counters()->clients), 1);
	assert_int_equal(waits_us, FOREVER);
	assert_int_equal(events_of_client(0), POLLIN);
	send_line(17, 3, 1);
	turn();
	pass(1750);
	assert_line_answers("\x11\3\2\0\2", 5);
	send_line(17, 6, 1);
	turn();
	pass(1750);
	assert_line_answers("\x11\x86\1", 3); /* it may only read */
}

/* V1.02, 2.5.1.1: 3.5 characters of 11 bits, above 19200 Bd 1.75 ms. */
static void test_a_request_ends_with_the_silence_of_the_line(void **state)
{
	static const struct {
		int baud;
		uint64_t silence_us;
	} LINES[] = {{1200, 32083}, {9600, 4010}, {19200, 2005}, {38400, 1750}, {921600, 1750}};
	char options[64];

	(void)state;
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++) {
		snprintf(options, sizeof(options), "rtu:/dev/ttyS0,baud=%d,write=yes", LINES[i].baud);
		if (i > 0) {
			tear_down(NULL);
			set_up(NULL);
		}
		start(options);
		send_line(1, 6, 1);
		turn();
		assert_int_equal(waits_us, LINES[i].silence_us);
		pass(LINES[i].silence_us - 1);
		assert_int_equal(take(lib.line), 0);
		assert_int_equal(waits_us, 1);
		pass(1);
		assert_line_answers("\1\6\x10\x40\0\1", 6);
		assert_string_equal(who, "/dev/ttyS0");
		assert_int_equal(waits_us, FOREVER);
	}
}

static void test_a_frame_may_have_gaps_of_50_ms_and_a_longer_one_ends_it(void **state)
{
	uint8_t frame[8] = {1, 3, AT_MODEL >> 8, AT_MODEL & 0xFF, 0, 1};

	(void)state;
	start("rtu:/dev/ttyS0");
	with_crc(frame, 6);
	put(lib.line, frame, 4);
	turn();
	pass(2005);
	assert_int_equal(waits_us, 50000 - 2005);
	pass(47994);
	put(lib.line, frame + 4, 4);
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\2", 5);
	put(lib.line, frame, 7);
	turn();
	pass(49999);
	assert_int_equal(count_of(&counters()->malformed), 0);
	assert_int_equal(waits_us, 1);
	pass(1);
	assert_int_equal(count_of(&counters()->malformed), 1);
	assert_int_equal(waits_us, FOREVER);
	put(lib.line, frame, 8); /* nothing of it is left */
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\2", 5);
	assert_int_equal(count_of(&counters()->requests), 2);
}

static void test_what_is_not_for_this_slave_is_passed_over(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS0,write=yes");
	send_line(2, 6, 0);
	send_line(0, 6, 1); /* to all: executed without an answer */
	turn();
	pass(2005);
	assert_int_equal(values.lever_arm_model, 1);
	assert_int_equal(take(lib.line), 0);
	send_line(3, 3, 1);
	send_line(1, 3, 1);
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\1", 5);
	assert_int_equal(count_of(&counters()->requests), 2);
	assert_int_equal(count_of(&counters()->writes), 1);
	assert_int_equal(count_of(&counters()->malformed), 0);
	send_line(0, 6, 99);
	turn();
	pass(2005);
	assert_int_equal(count_of(&counters()->exceptions), 1);
	assert_int_equal(take(lib.line), 0);
}

static void test_a_write_over_a_line_that_takes_longer_is_answered_at_its_end(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS0,write=yes");
	write_status = OD_PENDING;
	send_line(1, 6, 1);
	turn();
	pass(2005);
	assert_int_equal(take(lib.line), 0);
	assert_int_equal(waits_us, FOREVER);
	assert_int_equal(events_of_client(0), 0);
	modbus_link_ended(&link_, OD_OK);
	turn();
	assert_line_answers("\1\6\x10\x40\0\1", 6);
	send_line(1, 3, 1);
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\2", 5);
}

static void test_a_line_that_is_gone_is_tried_every_two_seconds_and_told_once(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS0");
	for (int times = 1; times <= 2; times++) {
		lib.connected = 0;
		said[0] = '\0';
		put(lib.line, "\1\3", 2);
		turn();
		close(lib.line);
		turn();
		turn();
		assert_string_equal(said, "<4>Modbus: /dev/ttyS0 is gone; trying to open it again\n");
		assert_int_equal(events_of_client(0), -1);
		assert_int_equal(waits_us, 2000000);
		lib.open_errno = ENOENT;
		pass(1999999);
		assert_int_equal(lib.connected, 0);
		pass(1);
		assert_int_equal(lib.connected, 1);
		assert_int_equal(waits_us, 2000000);
		lib.open_errno = 0;
		pass(2000000);
		assert_int_equal(lib.connected, 2);
		assert_string_equal(said, "<4>Modbus: /dev/ttyS0 is gone; trying to open it again\n"
					  "<6>Modbus: /dev/ttyS0 is back\n");
		send_line(1, 3, 1);
		turn();
		pass(2005);
		assert_line_answers("\1\3\2\0\2", 5);
		assert_int_equal(count_of(&counters()->clients), 1);
	}
}

static void test_the_longest_name_of_a_line_is_told_whole(void **state)
{
	char options[140] = "rtu:/dev/", expected[200];

	(void)state;
	memset(options + strlen(options), 'x', 127 - 5);
	start(options);
	close(lib.line);
	turn();
	snprintf(expected, sizeof(expected), "<4>Modbus: %s is gone; trying to open it again\n", options + 4);
	assert_string_equal(said, expected);
}

static void test_a_line_that_takes_no_answer_is_opened_again(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS0");
	send_line(1, 3, 1);
	turn();
	room = 3;
	pass(2005);
	assert_non_null(strstr(said, "is gone"));
	close(lib.line);
	room = SIZE_MAX;
	pass(2000000);
	assert_non_null(strstr(said, "is back"));
}

static void test_a_line_without_data_stays(void **state)
{
	(void)state;
	start("rtu:/dev/ttyS0");
	send_line(1, 3, 1);
	read_result = 1;
	turn();
	read_result = 0;
	assert_string_equal(said, "");
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\2", 5);
}

/* More than a frame has is not read before the silence. */
static void test_noise_fills_a_frame_and_no_more(void **state)
{
	uint8_t noise[300];

	(void)state;
	memset(noise, 0x55, sizeof(noise)); /* of another slave */
	start("rtu:/dev/ttyS0");
	put(lib.line, noise, sizeof(noise));
	turn();
	assert_int_equal(events_of_client(0), 0);
	pass(2005);
	assert_int_equal(events_of_client(0), POLLIN);
	turn();
	pass(50000);
	send_line(1, 3, 1);
	turn();
	pass(2005);
	assert_line_answers("\1\3\2\0\2", 5);
}

/* ---- start ------------------------------------------------------------------------------------------------------- */

static void assert_fails(const char *options, const char *reason)
{
	const char *const both[] = {"tcp:127.0.0.1:99", options};

	why[0] = '\0';
	assert_null(open_server(both + 1, 1));
	assert_string_equal(why, reason);
	lib.new_errno = lib.open_errno = 0;
}

static void test_why_a_window_is_not_opened_is_told(void **state)
{
	(void)state;
	lib.new_errno = ENOMEM;
	assert_fails("tcp:[::1]:502", "Modbus: ::1:502: Cannot allocate memory");
	lib.new_errno = EINVAL;
	assert_fails("rtu:/dev/ttyS0", "Modbus: /dev/ttyS0: Invalid argument");
	lib.open_errno = EACCES;
	assert_fails("tcp:127.0.0.1:502", "Modbus: 127.0.0.1:502: Permission denied");
	lib.open_errno = -1; /* of a name that is not resolved libmodbus sets none */
	assert_fails("tcp:somewhere:502", "Modbus: somewhere:502: Cannot assign requested address");
	lib.open_errno = ENOENT;
	assert_fails("rtu:/dev/ttyS0", "Modbus: /dev/ttyS0: No such file or directory");
	assert_int_equal(lib.made, lib.freed);
	int before = open_descriptors();
	static const int COMMANDS[] = {F_SETFL, F_SETFD};
	for (int i = 0; i < 2; i++) {
		refused_command = COMMANDS[i];
		assert_fails("tcp:127.0.0.1:502", "Modbus: 127.0.0.1:502: Operation not permitted");
		assert_int_equal(open_descriptors(), before);
	}
	refused_command = -1;
	no_thread = true;
	assert_fails("tcp:127.0.0.1:502", "Modbus: no thread: Resource temporarily unavailable");
	assert_int_equal(open_descriptors(), before);
	no_thread = false;
	assert_true(nonblocking && closes_on_exec);
	assert_in_range(stack, 100000, 1000000); /* less than the 8 MB of a thread */
}

static void test_when_one_window_is_not_opened_the_others_are_closed(void **state)
{
	static const char *const OPTIONS[] = {"rtu:/dev/ttyS0", "tcp:127.0.0.1:502", "tcp:127.0.0.1:503"};

	(void)state;
	lib.listener_count = 0;
	server = open_server(OPTIONS, 3);
	assert_non_null(server);
	while (sem_wait(&arrived) != 0)
		;
	assert_int_equal(waited[1].fd, -1);
	assert_int_equal(waited[2].fd, lib.listeners[0]);
	assert_int_equal(waited[3].fd, lib.listeners[1]);
	int before = open_descriptors();
	struct modbus_server *first = server;
	lib.open_errno = EADDRINUSE;
	static const char *const MORE[] = {"tcp:127.0.0.1:504", "rtu:/dev/ttyS1"};
	assert_null(open_server(MORE, 2));
	assert_int_equal(open_descriptors(), before);
	server = first;
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_the_thread_leaves_the_processor_to_the_loop),
		TEST(test_a_client_is_told_by_its_address_and_port),
		TEST(test_who_is_refused_is_told_once_a_second),
		TEST(test_each_window_has_its_clients_and_all_have_32),
		TEST(test_a_client_has_a_second_of_requests_and_then_its_rate),
		TEST(test_a_client_is_closed_when_its_time_without_a_request_is_over),
		TEST(test_a_request_in_pieces_is_answered_with_its_last_byte),
		TEST(test_the_shortest_and_the_longest_frames_are_served_and_others_end_the_connection),
		TEST(test_a_client_that_does_not_take_its_answer_is_closed),
		TEST(test_a_read_that_is_to_be_repeated_keeps_the_client_and_another_error_does_not),
		TEST(test_what_a_client_sent_before_its_end_is_answered),
		TEST(test_the_node_id_of_function_43_13_is_that_of_the_device),
		TEST(test_a_client_whose_write_takes_longer_waits_and_gets_its_own_answer),
		TEST(test_a_client_that_is_gone_before_its_write_ends_is_forgotten),
		TEST(test_a_line_is_opened_as_its_options_say),
		TEST(test_a_request_ends_with_the_silence_of_the_line),
		TEST(test_a_frame_may_have_gaps_of_50_ms_and_a_longer_one_ends_it),
		TEST(test_what_is_not_for_this_slave_is_passed_over),
		TEST(test_a_write_over_a_line_that_takes_longer_is_answered_at_its_end),
		TEST(test_a_line_that_is_gone_is_tried_every_two_seconds_and_told_once),
		TEST(test_the_longest_name_of_a_line_is_told_whole),
		TEST(test_a_line_that_takes_no_answer_is_opened_again),
		TEST(test_a_line_without_data_stays),
		TEST(test_noise_fills_a_frame_and_no_more),
		TEST(test_why_a_window_is_not_opened_is_told),
		TEST(test_when_one_window_is_not_opened_the_others_are_closed),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

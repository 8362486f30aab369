/* The sockets of CiA 309-3: real ones, in simulated time. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/cia309/server.h"
#include "od_values.h"
#include "tests/unit/descriptors.h"

enum { NODE = 5 };

static struct od od;
static struct od_domain eds;
static struct od_values values;
static struct canopen_node node;
static struct can_port bus;
static struct cia309 core;
static struct cia309_server server;
static char folder[32], path[64], address[96], who[CIA309_WHO_MAX];
static uint64_t now_us;

/* ---- the operating system ---------------------------------------------------------------------------------------- */

static const char *failing; /* the call that fails, */
static int failing_errno;   /* with this */
static unsigned failing_in; /* after so many of it that do not */
static unsigned without_delay;
static gid_t group_set;

static bool fails(const char *call)
{
	if (!failing || strcmp(failing, call) != 0 || failing_in-- > 0)
		return false;
	failing = NULL;
	errno = failing_errno;
	return true;
}

static void fail_next(const char *call, int with, unsigned in)
{
	failing = call;
	failing_errno = with;
	failing_in = in;
}

int socket(int domain, int type, int protocol)
{
	return fails("socket") ? -1 : (int)syscall(SYS_socket, domain, type, protocol);
}

int bind(int fd, __CONST_SOCKADDR_ARG to, socklen_t size)
{
	return fails("bind") ? -1 : (int)syscall(SYS_bind, fd, to.__sockaddr__, size);
}

int listen(int fd, int backlog)
{
	return fails("listen") ? -1 : (int)syscall(SYS_listen, fd, backlog);
}

int connect(int fd, __CONST_SOCKADDR_ARG to, socklen_t size)
{
	return fails("connect") ? -1 : (int)syscall(SYS_connect, fd, to.__sockaddr__, size);
}

int lstat(const char *restrict file, struct stat *restrict st)
{
	return fails("lstat") ? -1 : fstatat(AT_FDCWD, file, st, AT_SYMLINK_NOFOLLOW);
}

int chmod(const char *file, mode_t mode)
{
	return fails("chmod") ? -1 : fchmodat(AT_FDCWD, file, mode, 0);
}

int chown(const char *file, uid_t user, gid_t group)
{
	(void)file;
	assert_int_equal(user, (uid_t)-1);
	group_set = group;
	return fails("chown") ? -1 : 0;
}

int unlink(const char *file)
{
	return fails("unlink") ? -1 : unlinkat(AT_FDCWD, file, 0);
}

int epoll_create1(int flags)
{
	return fails("epoll_create1") ? -1 : (int)syscall(SYS_epoll_create1, flags);
}

int epoll_ctl(int fd, int op, int of, struct epoll_event *event)
{
	return fails("epoll_ctl") ? -1 : (int)syscall(SYS_epoll_ctl, fd, op, of, event);
}

ssize_t read(int fd, void *bytes, size_t size)
{
	return fails("read") ? -1 : syscall(SYS_read, fd, bytes, size);
}

ssize_t send(int fd, const void *bytes, size_t size, int flags)
{
	return fails("send") ? -1 : syscall(SYS_sendto, fd, bytes, size, flags, NULL, 0);
}

int getpeername(int fd, __SOCKADDR_ARG peer, socklen_t *restrict size)
{
	return fails("getpeername") ? -1 : (int)syscall(SYS_getpeername, fd, peer.__sockaddr__, size);
}

int getsockopt(int fd, int level, int name, void *restrict value, socklen_t *restrict size)
{
	return fails("getsockopt") ? -1 : (int)syscall(SYS_getsockopt, fd, level, name, value, size);
}

int setsockopt(int fd, int level, int name, const void *value, socklen_t size)
{
	without_delay += level == IPPROTO_TCP && name == TCP_NODELAY && *(const int *)value == 1;
	return (int)syscall(SYS_setsockopt, fd, level, name, value, size);
}

/* ---- a device around it ------------------------------------------------------------------------------------------ */

static int no_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port, (void)msg;
	return 0;
}

static int no_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static void receive(void *ctx, const struct can_msg *msg, uint64_t t_us)
{
	(void)ctx;
	canopen_receive(&node, msg, t_us);
}

static enum od_status write_object(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t t_us)
{
	(void)ctx;
	return canopen_write(&node, index, sub, wire, size, t_us);
}

static void log_change(
	void *ctx, unsigned number, const char *name, const char *command, const char *answer, uint64_t t_us)
{
	(void)ctx, (void)number, (void)command, (void)answer, (void)t_us;
	snprintf(who, sizeof(who), "%s", name);
}

static void start_device(void)
{
	static const struct can_ops ops = {.send = no_send, .filter = no_filter};
	static const struct cia309_device device = {.receive = receive, .write = write_object, .log = log_change};

	bus = (struct can_port){.ops = &ops, .fd = -1};
	od_init(&od, &imu9_od_table, &values, NODE);
	eds = (struct od_domain){.index = 0x1021, .data = imu9_eds, .size = imu9_eds_size};
	od_set_domain(&od, &eds);
	assert_int_equal(canopen_init(&node, &od, &bus, NULL, NODE), 0);
	canopen_start(&node, now_us);
	cia309_init(&core, &device, &node, &bus);
}

static void serve(const char *addresses)
{
	char error[256] = "";

	start_device();
	if (cia309_server_open(&server, &core, addresses, error, sizeof(error)) < 0)
		fail_msg("%s", error);
}

static int set_up(void **state)
{
	(void)state;
	now_us = 1000000;
	strcpy(folder, "/tmp/imu9-309.XXXXXX");
	if (!mkdtemp(folder))
		return -1;
	snprintf(path, sizeof(path), "%s/socket", folder);
	snprintf(address, sizeof(address), "unix:%s,write=yes", path);
	serve(address);
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	cia309_server_close(&server);
	return rmdir(folder); /* the socket is removed */
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

static bool readable(int fd)
{
	struct pollfd p = {.fd = fd, .events = POLLIN};

	return poll(&p, 1, 0) == 1;
}

/* The loop, until nothing more happens at this moment; it must not be woken for ever. */
static uint64_t turn(void)
{
	uint64_t next_us;
	int turns = 0;

	do {
		next_us = cia309_server_step(&server, readable(server.fd), now_us);
		assert_true(turns++ < 1000);
	} while (readable(server.fd));
	return next_us;
}

static void pass_ms(unsigned ms)
{
	while (ms-- > 0) {
		now_us += 1000;
		turn();
	}
}

static int connect_unix(void)
{
	struct sockaddr_un un = {.sun_family = AF_UNIX};
	int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);

	strcpy(un.sun_path, path);
	assert_int_equal(connect(fd, (struct sockaddr *)&un, sizeof(un)), 0);
	pass_ms(CIA309_ACCEPT_US / 1000 + 1);
	return fd;
}

static void type(int fd, const char *text)
{
	assert_int_equal(send(fd, text, strlen(text), MSG_NOSIGNAL), strlen(text));
}

/* What the client has received within some time; "" at its end. */
static const char *received(int fd)
{
	static char text[8192];
	ssize_t n;

	pass_ms(20);
	n = recv(fd, text, sizeof(text) - 1, MSG_DONTWAIT);
	text[n > 0 ? n : 0] = '\0';
	return n < 0 && errno == EAGAIN ? "(nothing)" : text;
}

static bool closed(int fd)
{
	char byte;

	return recv(fd, &byte, 1, MSG_DONTWAIT) == 0;
}

static void test_a_client_sends_lines_and_receives_answers(void **state)
{
	int fd = connect_unix();

	(void)state;
	type(fd, "[1] 5 r 0x1017 0 u16\n[2] 5 w 0x1017 0 u16 500\r\n# done\n[3] 5 r 0x1017 0 u");
	assert_string_equal(received(fd), "[1] 1000\r\n[2] OK\r\n\r\n");
	type(fd, "16\n");
	assert_string_equal(received(fd), "[3] 500\r\n");
	close(fd);
}

static void test_the_log_gets_the_process_at_the_other_end(void **state)
{
	char expected[CIA309_WHO_MAX];
	int fd = connect_unix();

	(void)state;
	type(fd, "[1] 5 start\n");
	assert_string_equal(received(fd), "[1] OK\r\n");
	snprintf(expected, sizeof(expected), "uid %u pid %d", getuid(), getpid());
	assert_string_equal(who, expected);
	close(fd);
}

static void test_the_socket_is_for_its_owner_and_group(void **state)
{
	struct stat st;

	(void)state;
	assert_int_equal(stat(path, &st), 0);
	assert_int_equal(st.st_mode, S_IFSOCK | 0660);
}

static void test_a_socket_without_write_yes_changes_nothing(void **state)
{
	(void)state;
	cia309_server_close(&server);
	address[strlen(address) - strlen(",write=yes")] = '\0';
	serve(address);
	int fd = connect_unix();
	type(fd, "[1] 5 w 0x1017 0 u16 500\n");
	assert_memory_equal(received(fd), "[1] ERROR:102 #Not permitted", 28);
	assert_int_equal(values.producer_heartbeat_time, 1000);
	close(fd);
}

static void test_tcp_listens_on_the_loopback_address(void **state)
{
	struct sockaddr_in in = {.sin_family = AF_INET};
	socklen_t size = sizeof(in);
	char tcp[64], expected[CIA309_WHO_MAX];
	int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);

	(void)state;
	/* a free port: of a socket that is closed again */
	in.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
	assert_int_equal(bind(fd, (struct sockaddr *)&in, sizeof(in)), 0);
	assert_int_equal(getsockname(fd, (struct sockaddr *)&in, &size), 0);
	close(fd);
	cia309_server_close(&server);
	snprintf(tcp, sizeof(tcp), "tcp:127.0.0.1:%u,write=yes", ntohs(in.sin_port));
	serve(tcp);
	fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
	assert_int_equal(connect(fd, (struct sockaddr *)&in, sizeof(in)), 0);
	type(fd, "[1] 5 start\n");
	assert_string_equal(received(fd), "[1] OK\r\n");
	assert_int_equal(getsockname(fd, (struct sockaddr *)&in, &size), 0);
	snprintf(expected, sizeof(expected), "127.0.0.1 port %u", ntohs(in.sin_port));
	assert_string_equal(who, expected);
	close(fd);
	turn();
}

static void test_addresses_of_other_hosts_and_wrong_ones_are_refused(void **state)
{
	static const char *const BAD[] = {"tcp:0.0.0.0:60000", "tcp:192.168.1.1:60000", "tcp:localhost:60000",
		"tcp:127.0.0.1", "tcp:127.0.0.1:0", "tcp:127.0.0.1:65536", "tcp:127.0.0.1:6x", "tcp:[::]:60000",
		"unix:", "unix:relative", "unix;/run/309", "tcp;127.0.0.1:60000", "udp:127.0.0.1:60000", "/run/309",
		"unix:/run/309,write=maybe", "tcp:127.0.0.1:60000,group=root", "unix:/run/309,group=no-such-group",
		"unix:/run/309,mode=0666", "unix:/run/309,group:root", "unix:/run/309,write:yes"};
	char error[256];

	(void)state;
	for (size_t i = 0; i < sizeof(BAD) / sizeof(BAD[0]); i++) {
		error[0] = '\0';
		assert_int_equal(cia309_server_check(BAD[i], error, sizeof(error)), -EINVAL);
		assert_memory_equal(error, "cia309: ", 8);
	}
	assert_int_equal(
		cia309_server_check("unix:/run/309.sock,group=root,write=yes\ntcp:127.0.0.1:60000\ntcp:[::1]:60000\n",
			error, sizeof(error)),
		0);
	assert_int_equal(
		cia309_server_check("unix:/a\nunix:/b\nunix:/c\nunix:/d\nunix:/e\n", error, sizeof(error)), -EINVAL);
	assert_int_equal(cia309_server_check("", error, sizeof(error)), 0);
}

static void test_an_address_has_255_characters_at_most(void **state)
{
	char text[257] = "tcp:127.0.0.1:60000", error[256];

	(void)state;
	memset(text + strlen(text), ',', 256 - strlen(text)); /* options without a name are none */
	assert_int_equal(cia309_server_check(text, error, sizeof(error)), -EINVAL);
	text[255] = '\0';
	assert_int_equal(cia309_server_check(text, error, sizeof(error)), 0);
}

static void test_a_socket_that_was_left_is_replaced_and_a_living_one_or_a_file_is_not(void **state)
{
	struct sockaddr_un un = {.sun_family = AF_UNIX};
	int left = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
	struct cia309_server second;
	char error[256];

	(void)state;
	assert_int_equal(cia309_server_open(&second, &core, address, error, sizeof(error)), -EADDRINUSE);
	cia309_server_close(&server);
	strcpy(un.sun_path, path);
	assert_int_equal(bind(left, (struct sockaddr *)&un, sizeof(un)), 0);
	close(left); /* the file stays */
	serve(address);
	close(connect_unix());
	cia309_server_close(&server);
	FILE *file = fopen(path, "w");
	fclose(file);
	assert_int_equal(cia309_server_open(&server, &core, address, error, sizeof(error)), -EEXIST);
	assert_int_equal(unlink(path), 0);
	serve(address);
}

/* echo '[1] ...' | nc -N: what was sent before the end is answered. */
static void test_a_client_that_has_ended_its_input_receives_its_answers(void **state)
{
	int fd = connect_unix();

	(void)state;
	type(fd, "[1] 5 r 0x1017 0 u16\n[2] 7 r 0x1017 0\n[3] incomplete");
	shutdown(fd, SHUT_WR);
	assert_string_equal(received(fd), "[1] 1000\r\n");
	pass_ms(500);
	assert_memory_equal(received(fd), "[2] ERROR:0x05040000", 20);
	assert_true(closed(fd));
	close(fd);
}

static void test_a_client_that_is_gone_executes_what_it_sent_and_wakes_nobody(void **state)
{
	int fd = connect_unix();

	(void)state;
	type(fd, "[1] 7 r 0x1017 0\n[2] 5 start\n");
	close(fd);
	pass_ms(100); /* the loop would turn for ever in the first of them */
	assert_int_equal(canopen_nmt_state(&node), NMT_PRE_OPERATIONAL);
	pass_ms(500);
	assert_int_equal(canopen_nmt_state(&node), NMT_OPERATIONAL);
	for (int i = 0; i < CIA309_SESSIONS; i++)
		assert_null(server.clients[i].session);
}

static void test_a_client_that_takes_no_answers_is_closed(void **state)
{
	int fd = connect_unix();

	(void)state;
	for (int i = 0; i < 30; i++)
		type(fd, "[1] 5 r 0x1021 0 d\n"); /* 200 kB each */
	pass_ms(1000);
	now_us += CIA309_STALLED_US - 1000000;
	turn();
	assert_non_null(server.clients[0].session);
	now_us += 1000000;
	turn();
	assert_null(server.clients[0].session);
	close(fd);
}

static void test_a_silent_client_is_closed_after_a_while(void **state)
{
	int fd = connect_unix();

	(void)state;
	uint64_t deadline_us = turn();
	assert_in_range(deadline_us, now_us, now_us + CIA309_QUIET_US);
	now_us = deadline_us - 1;
	turn();
	assert_false(closed(fd));
	now_us = deadline_us;
	turn();
	assert_true(closed(fd));
	close(fd);
}

static void test_a_client_that_sends_a_part_of_a_line_is_not_silent(void **state)
{
	int fd = connect_unix();

	(void)state;
	now_us += CIA309_QUIET_US / 2;
	type(fd, "[1] ");
	assert_int_equal(turn(), now_us + CIA309_QUIET_US);
	close(fd);
}

static void test_a_line_without_end_closes_its_client(void **state)
{
	static char line[CIA309_LINE_MAX];
	int fd = connect_unix();

	(void)state;
	memset(line, 'x', sizeof(line));
	assert_int_equal(send(fd, line, sizeof(line), MSG_NOSIGNAL), sizeof(line));
	assert_string_equal(received(fd), "[0] ERROR:600 #The line is too long.\r\n");
	assert_true(closed(fd));
	close(fd);
}

static void test_one_client_more_than_there_are_places_is_closed(void **state)
{
	int fds[CIA309_SESSIONS + 1];

	(void)state;
	for (int i = 0; i <= CIA309_SESSIONS; i++)
		fds[i] = connect_unix();
	for (int i = 0; i < CIA309_SESSIONS; i++)
		assert_false(closed(fds[i]));
	assert_true(closed(fds[CIA309_SESSIONS]));
	close(fds[0]);
	turn();
	close(fds[CIA309_SESSIONS]);
	fds[0] = connect_unix();
	type(fds[0], "[1] 5 r 0x1017 0 u16\n");
	assert_string_equal(received(fds[0]), "[1] 1000\r\n");
	for (int i = 0; i < CIA309_SESSIONS; i++)
		close(fds[i]);
}

static void test_clients_that_come_at_once_are_accepted_one_by_one(void **state)
{
	struct sockaddr_un un = {.sun_family = AF_UNIX};
	int fds[5], accepted = 0;

	(void)state;
	strcpy(un.sun_path, path);
	for (int i = 0; i < 5; i++) {
		fds[i] = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
		assert_int_equal(connect(fds[i], (struct sockaddr *)&un, sizeof(un)), 0);
	}
	pass_ms(2 * CIA309_ACCEPT_US / 1000);
	for (int i = 0; i < CIA309_SESSIONS; i++)
		accepted += server.clients[i].session != NULL;
	assert_in_range(accepted, 2, 3);
	for (int i = 0; i < 5; i++)
		close(fds[i]);
}

static void test_what_cannot_be_opened_is_told_and_leaves_nothing(void **state)
{
	static const struct {
		const char *call;
		int error;
		const char *advice;
	} FAILURES[] = {{"lstat", EACCES, "; the folder must be writable, and a group one that this user is in"},
		{"lstat", ENOTDIR, ""}, {"socket", EMFILE, ""},
		{"socket", EAFNOSUPPORT, "; the service permits no IP: udp.conf beside the example configuration does"},
		{"bind", ENOENT, "; create its folder"}, {"bind", EADDRINUSE, "; another gateway uses it"},
		{"bind", EPERM, "; the folder must be writable, and a group one that this user is in"},
		{"chmod", EPERM, "; the folder must be writable, and a group one that this user is in"},
		{"chown", EPERM, "; the folder must be writable, and a group one that this user is in"},
		{"listen", EADDRINUSE, "; another gateway uses it"}, {"epoll_ctl", ENOSPC, ""}};
	char error[256], expected[256], with_group[120], where[120];

	(void)state;
	cia309_server_close(&server);
	snprintf(with_group, sizeof(with_group), "unix:%s,group=root", path);
	for (size_t i = 0; i < sizeof(FAILURES) / sizeof(FAILURES[0]); i++) {
		int before = open_descriptors();

		fail_next(FAILURES[i].call, FAILURES[i].error, 0);
		assert_int_equal(
			cia309_server_open(&server, &core, with_group, error, sizeof(error)), -FAILURES[i].error);
		snprintf(expected, sizeof(expected), "cia309: %s: %s%s", with_group, strerror(FAILURES[i].error),
			FAILURES[i].advice);
		assert_string_equal(error, expected);
		assert_int_equal(open_descriptors(), before);
		assert_int_not_equal(access(path, F_OK), 0);
	}
	/* with the file of a process that was killed */
	static const char *const LEFT[] = {"socket", "connect", "unlink"};
	for (size_t i = 0; i < 3; i++) {
		struct sockaddr_un un = {.sun_family = AF_UNIX};
		int before = open_descriptors(), left = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);

		strcpy(un.sun_path, path);
		assert_int_equal(bind(left, (struct sockaddr *)&un, sizeof(un)), 0);
		close(left);
		fail_next(LEFT[i], EACCES, 0);
		assert_int_equal(cia309_server_open(&server, &core, with_group, error, sizeof(error)),
			i == 1 ? -EADDRINUSE : -EACCES);
		assert_int_equal(open_descriptors(), before);
		assert_int_equal(unlink(path), 0); /* it is not this process's: it stays */
	}
	assert_int_equal(cia309_server_open(&server, &core, "nowhere", error, sizeof(error)), -EINVAL);
	fail_next("epoll_create1", EMFILE, 0);
	assert_int_equal(cia309_server_open(&server, &core, with_group, error, sizeof(error)), -EMFILE);
	/* the second of two: the first is closed again */
	snprintf(where, sizeof(where), "%s\ntcp:127.0.0.1:1", address);
	fail_next("bind", EACCES, 1);
	assert_int_equal(cia309_server_open(&server, &core, where, error, sizeof(error)), -EACCES);
	assert_int_not_equal(access(path, F_OK), 0);
	serve(with_group);
	assert_int_equal(group_set, 0);
}

static void test_a_file_without_a_group_keeps_that_of_the_process(void **state)
{
	(void)state;
	cia309_server_close(&server);
	group_set = 77;
	serve(address);
	assert_int_equal(group_set, 77);
}

static void test_why_an_address_is_refused_is_told(void **state)
{
	static const char *const REASONS[][2] = {
		{"tcp:10.0.0.1:60000", "cia309: 'tcp:10.0.0.1:60000': use unix:/PATH or tcp:127.0.0.1:PORT; other "
				       "hosts reach it through ssh or stunnel"},
		{"unix:/a,write=maybe", "cia309: option 'write=maybe': use write=yes or group=NAME"},
		{"tcp:127.0.0.1:1,group=root", "cia309: option 'group=root': use write=yes"},
		{"unix:/a,group=nobody-has-this", "cia309: there is no group 'nobody-has-this'"},
		{"unix:/a\nunix:/b\n\nunix:/c\nunix:/d\nunix:/e", "cia309: more than 4 addresses"}};
	char error[256], longest[300] = "unix:/";

	(void)state;
	for (size_t i = 0; i < sizeof(REASONS) / sizeof(REASONS[0]); i++) {
		assert_int_equal(cia309_server_check(REASONS[i][0], error, sizeof(error)), -EINVAL);
		assert_string_equal(error, REASONS[i][1]);
	}
	assert_int_equal(cia309_server_check("\nunix:/a\nunix:/b\n\nunix:/c\nunix:/d\n", error, sizeof(error)), 0);
	assert_int_equal(cia309_server_check("tcp:127.0.0.1:65535\ntcp:127.255.255.255:1", error, sizeof(error)), 0);
	assert_int_equal(cia309_server_check("tcp:128.0.0.1:1", error, sizeof(error)), -EINVAL);
	assert_int_equal(cia309_server_check("tcp:126.0.0.1:1", error, sizeof(error)), -EINVAL);
	memset(longest + 6, 'x', 106);
	assert_int_equal(cia309_server_check(longest, error, sizeof(error)), 0); /* 107 bytes, and a NUL */
	longest[112] = 'x';
	assert_int_equal(cia309_server_check(longest, error, sizeof(error)), -EINVAL);
	/* the whole address: 255 characters */
	snprintf(longest, sizeof(longest), "unix:/a%0*d", 0, 0);
	longest[7] = '\0';
	while (strlen(longest) + 10 <= 255)
		strcat(longest, ",write=yes");
	while (strlen(longest) < 255)
		strcat(longest, ",");
	assert_int_equal(cia309_server_check(longest, error, sizeof(error)), 0);
	strcat(longest, ",");
	assert_int_equal(cia309_server_check(longest, error, sizeof(error)), -EINVAL);
}

static void test_the_last_of_contradicting_options_counts(void **state)
{
	(void)state;
	cia309_server_close(&server);
	strcat(address, ",write=no");
	serve(address);
	int fd = connect_unix();
	type(fd, "[1] 5 start\n");
	assert_memory_equal(received(fd), "[1] ERROR:102 #Not permitted", 28);
	close(fd);
}

static void test_a_client_over_ipv6_is_told_by_its_port(void **state)
{
	struct sockaddr_in6 in6 = {.sin6_family = AF_INET6, .sin6_addr = IN6ADDR_LOOPBACK_INIT};
	socklen_t size = sizeof(in6);
	char tcp[64], expected[CIA309_WHO_MAX];
	int fd = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);

	(void)state;
	if (fd < 0 || bind(fd, (struct sockaddr *)&in6, sizeof(in6)) < 0) {
		close(fd);
		skip(); /* a host without IPv6 */
	}
	assert_int_equal(getsockname(fd, (struct sockaddr *)&in6, &size), 0);
	close(fd);
	cia309_server_close(&server);
	snprintf(tcp, sizeof(tcp), "tcp:[::1]:%u,write=yes", ntohs(in6.sin6_port));
	serve(tcp);
	fd = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
	assert_int_equal(connect(fd, (struct sockaddr *)&in6, sizeof(in6)), 0);
	without_delay = 0;
	pass_ms(CIA309_ACCEPT_US / 1000 + 1);
	assert_int_equal(without_delay, 1);
	type(fd, "[1] 5 start\n");
	assert_string_equal(received(fd), "[1] OK\r\n");
	size = sizeof(in6);
	assert_int_equal(getsockname(fd, (struct sockaddr *)&in6, &size), 0);
	snprintf(expected, sizeof(expected), "::1 port %u", ntohs(in6.sin6_port));
	assert_string_equal(who, expected);
	close(fd);
	turn();
}

static void test_a_client_that_the_kernel_does_not_tell_is_unknown(void **state)
{
	static const char *const CALLS[] = {"getpeername", "getsockopt"};

	(void)state;
	for (int i = 0; i < 2; i++) {
		fail_next(CALLS[i], ENOTCONN, 0);
		int fd = connect_unix();
		type(fd, "[1] 5 start\n");
		assert_string_equal(received(fd), "[1] OK\r\n");
		assert_string_equal(who, "unknown");
		close(fd);
		turn();
	}
}

static void test_a_client_that_cannot_be_watched_is_closed(void **state)
{
	(void)state;
	turn();
	now_us += CIA309_ACCEPT_US;
	struct sockaddr_un un = {.sun_family = AF_UNIX};
	int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
	strcpy(un.sun_path, path);
	assert_int_equal(connect(fd, (struct sockaddr *)&un, sizeof(un)), 0);
	fail_next("epoll_ctl", ENOSPC, 0);
	cia309_server_step(&server, true, now_us);
	assert_true(closed(fd));
	assert_null(server.clients[0].session);
	close(fd);
}

static void test_what_is_interrupted_is_repeated_and_another_error_ends_the_client(void **state)
{
	static const int AGAIN[] = {EAGAIN, EINTR};
	int fd = connect_unix();

	(void)state;
	for (int i = 0; i < 2; i++) {
		type(fd, "[1] 5 r 0x1017 0 u16\n");
		fail_next("read", AGAIN[i], 0);
		assert_string_equal(received(fd), "[1] 1000\r\n");
		type(fd, "[2] 5 r 0x1017 0 u16\n");
		fail_next("send", AGAIN[i], 0);
		assert_string_equal(received(fd), "[2] 1000\r\n");
	}
	type(fd, "[3] 5 r 0x1017 0 u16\n");
	fail_next("send", EPIPE, 0);
	pass_ms(20);
	assert_true(closed(fd));
	close(fd);
	fd = connect_unix();
	type(fd, "[3] 5 r 0x1017 0 u16\n");
	fail_next("read", EIO, 0);
	pass_ms(20);
	assert_null(server.clients[0].session);
	close(fd);
}

/* epoll reports a new client for as long as it waits: it is not asked before the next may come. */
static void test_between_two_clients_the_listeners_wait(void **state)
{
	struct sockaddr_un un = {.sun_family = AF_UNIX};
	int fds[2];

	(void)state;
	strcpy(un.sun_path, path);
	for (int i = 0; i < 2; i++) {
		fds[i] = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
		assert_int_equal(connect(fds[i], (struct sockaddr *)&un, sizeof(un)), 0);
	}
	uint64_t start_us = now_us;
	assert_int_equal(turn(), start_us + CIA309_ACCEPT_US);
	assert_false(readable(server.fd));
	assert_non_null(server.clients[0].session);
	assert_null(server.clients[1].session);
	now_us = start_us + CIA309_ACCEPT_US - 1;
	assert_int_equal(turn(), start_us + CIA309_ACCEPT_US);
	assert_null(server.clients[1].session);
	now_us = start_us + CIA309_ACCEPT_US;
	turn();
	assert_non_null(server.clients[1].session);
	now_us += CIA309_ACCEPT_US;
	assert_int_equal(turn(), start_us + CIA309_QUIET_US);
	close(fds[0]);
	close(fds[1]);
}

static void test_a_client_that_takes_nothing_has_10_s_and_one_that_says_nothing_10_minutes(void **state)
{
	int fd = connect_unix();

	(void)state;
	while (server.clients[0].session->out_used == 0) {
		type(fd, "[1] 5 r 0x1021 0 d\n");
		pass_ms(100);
	}
	uint64_t last_us = server.clients[0].last_us, next_us = 0;
	for (; server.clients[0].session && now_us<last_us + 20000000; now_us += next_us> now_us ? 0 : 1000) {
		next_us = turn();
		if (server.clients[0].session)
			last_us = server.clients[0].last_us;
		assert_true(next_us > now_us);
		now_us = next_us < last_us + CIA309_STALLED_US ? next_us : last_us + CIA309_STALLED_US;
	}
	assert_int_equal(now_us, last_us + CIA309_STALLED_US);
	close(fd);
	fd = connect_unix();
	type(fd, "[1] 5 r 0x1017 0 u16\n");
	assert_string_equal(received(fd), "[1] 1000\r\n");
	assert_int_equal(turn(), server.clients[0].last_us + CIA309_QUIET_US);
	close(fd);
}

int main(void)
{
#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_a_client_sends_lines_and_receives_answers),
		TEST(test_the_log_gets_the_process_at_the_other_end),
		TEST(test_the_socket_is_for_its_owner_and_group),
		TEST(test_a_socket_without_write_yes_changes_nothing),
		TEST(test_tcp_listens_on_the_loopback_address),
		TEST(test_addresses_of_other_hosts_and_wrong_ones_are_refused),
		TEST(test_an_address_has_255_characters_at_most),
		TEST(test_a_socket_that_was_left_is_replaced_and_a_living_one_or_a_file_is_not),
		TEST(test_a_client_that_has_ended_its_input_receives_its_answers),
		TEST(test_a_client_that_is_gone_executes_what_it_sent_and_wakes_nobody),
		TEST(test_a_client_that_takes_no_answers_is_closed),
		TEST(test_a_silent_client_is_closed_after_a_while),
		TEST(test_a_client_that_sends_a_part_of_a_line_is_not_silent),
		TEST(test_a_line_without_end_closes_its_client),
		TEST(test_one_client_more_than_there_are_places_is_closed),
		TEST(test_clients_that_come_at_once_are_accepted_one_by_one),
		TEST(test_what_cannot_be_opened_is_told_and_leaves_nothing),
		TEST(test_a_file_without_a_group_keeps_that_of_the_process),
		TEST(test_why_an_address_is_refused_is_told),
		TEST(test_the_last_of_contradicting_options_counts),
		TEST(test_a_client_over_ipv6_is_told_by_its_port),
		TEST(test_a_client_that_the_kernel_does_not_tell_is_unknown),
		TEST(test_a_client_that_cannot_be_watched_is_closed),
		TEST(test_what_is_interrupted_is_repeated_and_another_error_ends_the_client),
		TEST(test_between_two_clients_the_listeners_wait),
		TEST(test_a_client_that_takes_nothing_has_10_s_and_one_that_says_nothing_10_minutes),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

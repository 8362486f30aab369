/* The udp bus when the operating system refuses one of its calls: what is told, and that no descriptor is left. And
 * with which options its sockets are made (ip(7), ipv6(7), socket(7)). */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <net/if.h>
#include <netinet/in.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"

/* ---- the operating system ---------------------------------------------------------------------------------------- */

static int calls, failing, failing_errno; /* the call that fails */
static bool route;			  /* to the group */
static char made[2000];			  /* "call fd", a line each; the sender is socket 0 */
static int sockets;
static int fds[2];

static int number_of(int fd)
{
	return sockets > 1 && fd == fds[1];
}

__attribute__((format(printf, 1, 2))) static int result_of(const char *format, ...)
{
	size_t n = strlen(made);
	va_list args;

	va_start(args, format);
	vsnprintf(made + n, sizeof(made) - n, format, args);
	va_end(args);
	strcat(made, "\n");
	if (calls++ != failing)
		return 0;
	errno = failing_errno;
	return -1;
}

int socket(int domain, int type, int protocol)
{
	(void)protocol;
	assert_int_equal(type, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC);
	if (result_of("socket %s", domain == AF_INET ? "4" : domain == AF_INET6 ? "6" : "?") < 0)
		return -1;
	return fds[sockets++] = open("/dev/null", O_RDWR | O_CLOEXEC);
}

int bind(int fd, __CONST_SOCKADDR_ARG to, socklen_t size)
{
	const struct sockaddr_in *v4 = to.__sockaddr_in__;
	const struct sockaddr_in6 *v6 = to.__sockaddr_in6__;

	assert_int_equal(size, v4->sin_family == AF_INET ? sizeof(*v4) : sizeof(*v6));
	return result_of("bind %d %u", number_of(fd), ntohs(v4->sin_port));
}

int getsockname(int fd, __SOCKADDR_ARG own, socklen_t *restrict size)
{
	struct sockaddr_in v4 = {.sin_family = AF_INET, .sin_port = htons(4711)};

	assert_true(*size >= sizeof(v4));
	memcpy(own.__sockaddr__, &v4, sizeof(v4));
	return result_of("name %d", number_of(fd));
}

int setsockopt(int fd, int level, int option, const void *value, socklen_t size)
{
	static const struct {
		int level, option;
		const char *name;
		bool is_number;
	} OPTIONS[] = {{SOL_SOCKET, SO_REUSEADDR, "reuse", true}, {SOL_SOCKET, SO_ATTACH_FILTER, "filter", false},
		{SOL_SOCKET, SO_TIMESTAMPNS, "stamps", true}, {SOL_SOCKET, SO_RXQ_OVFL, "overflow", true},
		{IPPROTO_IP, IP_MULTICAST_ALL, "all", true}, {IPPROTO_IPV6, IPV6_MULTICAST_ALL, "all", true},
		{IPPROTO_IP, MCAST_JOIN_GROUP, "join", false}, {IPPROTO_IPV6, MCAST_JOIN_GROUP, "join", false},
		{IPPROTO_IP, IP_MULTICAST_IF, "through", false}, {IPPROTO_IPV6, IPV6_MULTICAST_IF, "through", true}};
	const struct group_req *group = value;
	const struct ip_mreqn *through = value;

	if (level == SOL_SOCKET && (option == SO_RCVBUFFORCE || option == SO_RCVBUF))
		return 0; /* best effort */
	for (size_t i = 0; i < sizeof(OPTIONS) / sizeof(OPTIONS[0]); i++)
		if (level == OPTIONS[i].level && option == OPTIONS[i].option) {
			const char *name = OPTIONS[i].name;
			int interface = strcmp(name, "join") == 0			      ? (int)group->gr_interface
					: strcmp(name, "through") == 0 && level == IPPROTO_IP ? through->imr_ifindex
											      : 0;

			if (strcmp(name, "join") == 0 && interface == 0 && !route) {
				errno = ENODEV;
				return -1;
			}
			if (!OPTIONS[i].is_number)
				return result_of("%s %d %d", name, number_of(fd), interface);
			assert_int_equal(size, sizeof(int));
			return result_of("%s %d %d", name, number_of(fd), *(const int *)value);
		}
	fail_msg("option %d of level %d", option, level);
	return -1;
}

unsigned if_nametoindex(const char *name)
{
	return strcmp(name, "lo") == 0 ? 1 : strcmp(name, "eth7") == 0 ? 7 : 0;
}

/* ---- tests ------------------------------------------------------------------------------------------------------- */

static char error[400];

static int open_bus(const char *bus, int fails_at, int with)
{
	struct can_port *port;

	calls = sockets = 0;
	failing = fails_at;
	failing_errno = with;
	made[0] = error[0] = '\0';
	int rc = can_open(bus, &port, error, sizeof(error));

	if (rc == 0)
		can_close(port);
	return rc;
}

#define OPENED                                                                                                      \
	"socket 4\nall 0 0\nbind 0 0\nreuse 0 1\nsocket 4\nstamps 1 1\noverflow 1 1\nname 0\nfilter 1 0\nall 1 0\n" \
	"reuse 1 1\nbind 1 43113\n"

static void test_the_sockets_are_in_the_group_through_the_interface(void **state)
{
	(void)state;
	route = true;
	assert_int_equal(open_bus("udp", -1, 0), 0);
	assert_string_equal(made, OPENED "join 1 0\n");
	assert_int_equal(open_bus("udp:239.74.163.2,interface=eth7", -1, 0), 0);
	assert_string_equal(made, OPENED "join 1 7\nthrough 0 7\n");
	route = false; /* as in a container without a network */
	assert_int_equal(open_bus("udp", -1, 0), 0);
	assert_string_equal(made, OPENED "join 1 1\nthrough 0 1\n");
	assert_int_equal(open_bus("udp:[ff15::1]:43113,interface=eth7", -1, 0), 0);
	assert_string_equal(made,
		"socket 6\nall 0 0\nbind 0 0\nreuse 0 1\nsocket 6\nstamps 1 1\noverflow 1 1\nname 0\nfilter 1 0\n"
		"all 1 0\nreuse 1 1\nbind 1 43113\njoin 1 7\nthrough 0 7\n");
}

static void test_each_call_that_fails_is_told_and_leaves_nothing(void **state)
{
	static const struct {
		int error;
		const char *text;
	} ERRORS[] = {{EACCES, "cannot open bus 'udp:239.74.163.2': Permission denied: check that this host has a "
			       "network interface with multicast"},
		{EAFNOSUPPORT, "cannot open bus 'udp:239.74.163.2': IP is not permitted here: a service needs the "
			       "drop-in udp.conf"},
		{EADDRINUSE, "cannot open bus 'udp:239.74.163.2': another program has its UDP port for itself "
			     "(`ss -uapn` shows which): end that, or use another port, udp:GROUP:PORT"}};

	(void)state;
	route = false;
	assert_int_equal(open_bus("udp:239.74.163.2", -1, 0), 0);
	int all = calls, before = open_descriptors();
	for (int i = 0; i < all; i++)
		for (size_t k = 0; k < sizeof(ERRORS) / sizeof(ERRORS[0]); k++) {
			assert_int_equal(open_bus("udp:239.74.163.2", i, ERRORS[k].error), -ERRORS[k].error);
			assert_string_equal(error, ERRORS[k].text);
			assert_int_equal(calls, i + 1);
			assert_int_equal(open_descriptors(), before);
		}
}

static void test_what_is_written_wrong_opens_nothing(void **state)
{
	static const struct {
		const char *bus;
		int rc;
		const char *text;
	} WRONG[] = {{"udp,interface=eth8", -ENODEV, "no network interface 'eth8': `ip -brief link` lists them"},
		{"udp:192.168.1.1", -EINVAL,
			"bad bus 'udp:192.168.1.1': use udp[:GROUP[:PORT]][,OPTION] with a multicast group, e.g. "
			"udp:239.74.163.2:43113 or udp:[ff15::1]:43113"},
		{"udp,hosts=here", -EINVAL,
			"bad option 'hosts=here' of bus udp: use interface=NAME, hosts=any, or hosts= with an address "
			"or network of the kind of the group, like 192.168.1.0/24"}};

	(void)state;
	for (size_t i = 0; i < sizeof(WRONG) / sizeof(WRONG[0]); i++) {
		assert_int_equal(open_bus(WRONG[i].bus, -1, 0), WRONG[i].rc);
		assert_string_equal(error, WRONG[i].text);
		assert_int_equal(calls, 0);
	}
	/* as --check does: the interface may come later */
	assert_int_equal(can_open("udp,interface=eth8", NULL, error, sizeof(error)), 0);
	assert_int_equal(can_open("udp,hosts=here", NULL, error, sizeof(error)), -EINVAL);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_sockets_are_in_the_group_through_the_interface),
		cmocka_unit_test(test_each_call_that_fails_is_told_and_leaves_nothing),
		cmocka_unit_test(test_what_is_written_wrong_opens_nothing),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

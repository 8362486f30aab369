#include "gateway/cia309/server.h"

#include <arpa/inet.h>
#include <errno.h>
#include <grp.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"

enum { ADDRESS_MAX = 256, BACKLOG = 8, GROUP_BUFFER = 4096 };
enum { LISTENER_EVENT = 1 << 8 }; /* in the data of an epoll event: a listener, else a client */

/* ---- addresses --------------------------------------------------------------------------------------------------- */

struct address {
	char text[ADDRESS_MAX];
	bool may_write;
	gid_t group; /* (gid_t)-1: that of the process */
	union {
		struct sockaddr any;
		struct sockaddr_un un;
		struct sockaddr_in in;
		struct sockaddr_in6 in6;
	} to;
	socklen_t size;
};

static int find_group(const char *name, gid_t *group)
{
	struct group entry, *found = NULL;
	char buffer[GROUP_BUFFER];

	(void)getgrnam_r(name, &entry, buffer, sizeof(buffer), &found);
	if (found)
		*group = entry.gr_gid;
	return found ? 0 : -EINVAL;
}

static int parse_options(struct address *a, char *options, char *error, size_t error_size)
{
	char *rest = NULL;

	for (char *o = strtok_r(options, ",", &rest); o; o = strtok_r(NULL, ",", &rest)) {
		bool group = strncmp(o, "group=", 6) == 0 && a->to.any.sa_family == AF_UNIX;

		if (strcmp(o, "write=yes") == 0 || strcmp(o, "write=no") == 0) {
			a->may_write = o[6] == 'y';
		} else if (!group) {
			snprintf(error, error_size, "cia309: option '%.100s': use write=yes%s", o,
				a->to.any.sa_family == AF_UNIX ? " or group=NAME" : "");
			return -EINVAL;
		} else if (find_group(o + 6, &a->group) < 0) {
			snprintf(error, error_size, "cia309: there is no group '%.100s'", o + 6);
			return -EINVAL;
		}
	}
	return 0;
}

static int parse_path(struct address *a, const char *path)
{
	if (path[0] != '/' || strlen(path) >= sizeof(a->to.un.sun_path))
		return -EINVAL;
	a->to.un.sun_family = AF_UNIX;
	strcpy(a->to.un.sun_path, path);
	a->size = sizeof(a->to.un);
	return 0;
}

static int parse_host(struct address *a, char *text)
{
	char *colon = strrchr(text, ':'), *end;
	unsigned long port = colon ? strtoul(colon + 1, &end, 10) : 0;

	if (port == 0 || port > UINT16_MAX || *end)
		return -EINVAL;
	*colon = '\0';
	if (strcmp(text, "[::1]") == 0) {
		a->to.in6 = (struct sockaddr_in6){.sin6_family = AF_INET6,
			.sin6_port = htons((uint16_t)port),
			.sin6_addr = IN6ADDR_LOOPBACK_INIT};
		a->size = sizeof(a->to.in6);
		return 0;
	}
	a->to.in = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
	a->size = sizeof(a->to.in);
	return inet_pton(AF_INET, text, &a->to.in.sin_addr) == 1 && ntohl(a->to.in.sin_addr.s_addr) >> 24 == 127
		       ? 0
		       : -EINVAL;
}

static int parse_address(struct address *a, const char *text, size_t length, char *error, size_t error_size)
{
	char copy[ADDRESS_MAX];
	int rc = -EINVAL;

	*a = (struct address){.group = (gid_t)-1};
	snprintf(copy, sizeof(copy), "%.*s", (int)length, text);
	snprintf(a->text, sizeof(a->text), "%s", copy);
	char *options = strchr(copy, ',');
	if (options)
		*options++ = '\0';
	if (length < sizeof(copy) && strncmp(copy, "unix:", 5) == 0)
		rc = parse_path(a, copy + 5);
	else if (length < sizeof(copy) && strncmp(copy, "tcp:", 4) == 0)
		rc = parse_host(a, copy + 4);
	if (rc < 0) {
		snprintf(error, error_size,
			"cia309: '%.100s': use unix:/PATH or tcp:127.0.0.1:PORT; other hosts reach it through ssh or "
			"stunnel",
			a->text);
		return rc;
	}
	return options ? parse_options(a, options, error, error_size) : 0;
}

/* The next address of the list. False: there is none, or it is wrong (*rc). */
static bool next_address(const char **list, struct address *a, int *rc, char *error, size_t error_size)
{
	*list += strspn(*list, "\n");
	size_t length = strcspn(*list, "\n");
	if (length == 0)
		return false;
	*rc = parse_address(a, *list, length, error, error_size);
	*list += length;
	return *rc == 0;
}

int cia309_server_check(const char *addresses, char *error, size_t error_size)
{
	struct address a;
	int rc = 0, count = 0;

	while (next_address(&addresses, &a, &rc, error, error_size))
		count++;
	if (rc == 0 && count > CIA309_LISTENERS) {
		snprintf(error, error_size, "cia309: more than %d addresses", CIA309_LISTENERS);
		rc = -EINVAL;
	}
	return rc;
}

/* ---- listening --------------------------------------------------------------------------------------------------- */

/* A socket file that nobody listens at is left from a process that was killed. */
static int remove_stale(const struct sockaddr_un *un)
{
	struct stat st;
	int fd, rc;

	if (lstat(un->sun_path, &st) < 0)
		return errno == ENOENT ? 0 : -errno;
	if (!S_ISSOCK(st.st_mode))
		return -EEXIST;
	fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
	if (fd < 0)
		return -errno;
	rc = connect(fd, (const struct sockaddr *)un, sizeof(*un)) == 0 || errno != ECONNREFUSED ? -EADDRINUSE : 0;
	close(fd);
	return rc == 0 && unlink(un->sun_path) < 0 ? -errno : rc;
}

/* Before listen() nobody can connect, so the mode is set in time. */
static int set_owner(const struct address *a)
{
	const char *path = a->to.un.sun_path;

	if (a->group != (gid_t)-1 && chown(path, (uid_t)-1, a->group) < 0)
		return -errno;
	return chmod(path, 0660) < 0 ? -errno : 0;
}

static int listen_at(struct cia309_listener *l, const struct address *a)
{
	bool local = a->to.any.sa_family == AF_UNIX;
	int rc = local ? remove_stale(&a->to.un) : 0, on = 1;

	if (rc < 0)
		return rc;
	l->fd = socket(a->to.any.sa_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
	if (l->fd < 0)
		return -errno;
	l->may_write = a->may_write;
	setsockopt(l->fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
	if (bind(l->fd, &a->to.any, a->size) < 0)
		return -errno;
	if (local)
		strcpy(l->path, a->to.un.sun_path);
	if (local && (rc = set_owner(a)) < 0)
		return rc;
	return listen(l->fd, BACKLOG) < 0 ? -errno : 0;
}

static int watch(struct cia309_server *s, int op, int fd, uint32_t events, uint32_t data)
{
	struct epoll_event event = {.events = events, .data.u32 = data};

	return epoll_ctl(s->fd, op, fd, &event) < 0 ? -errno : 0;
}

static const char *advice(int rc)
{
	switch (rc) {
	case -ENOENT:
		return "; create its folder";
	case -EACCES:
	case -EPERM:
		return "; the folder must be writable, and a group one that this user is in";
	case -EADDRINUSE:
		return "; another gateway uses it";
	case -EAFNOSUPPORT:
		return "; the service permits no IP: udp.conf beside the example configuration does";
	default:
		return "";
	}
}

int cia309_server_open(
	struct cia309_server *s, struct cia309 *core, const char *addresses, char *error, size_t error_size)
{
	struct address a;
	int rc = cia309_server_check(addresses, error, error_size);

	if (rc < 0)
		return rc;
	*s = (struct cia309_server){.core = core, .fd = epoll_create1(EPOLL_CLOEXEC)};
	for (int i = 0; i < CIA309_LISTENERS; i++)
		s->listeners[i].fd = -1;
	rc = s->fd < 0 ? -errno : 0;
	for (uint32_t i = 0; rc == 0 && next_address(&addresses, &a, &rc, error, error_size); i++) {
		rc = listen_at(&s->listeners[i], &a);
		if (rc == 0)
			rc = watch(s, EPOLL_CTL_ADD, s->listeners[i].fd, EPOLLIN, LISTENER_EVENT | i);
		s->listeners[i].open = rc == 0;
		if (rc < 0)
			snprintf(error, error_size, "cia309: %s: %s%s", a.text, strerror(-rc), advice(rc));
	}
	if (rc < 0)
		cia309_server_close(s);
	return rc;
}

static void drop(struct cia309_server *s, struct cia309_client *c)
{
	cia309_close(s->core, c->session);
	c->session = NULL;
	close(c->fd);
}

void cia309_server_close(struct cia309_server *s)
{
	for (struct cia309_client *c = s->clients; c < s->clients + CIA309_SESSIONS; c++)
		if (c->session)
			drop(s, c);
	for (struct cia309_listener *l = s->listeners; l < s->listeners + CIA309_LISTENERS; l++) {
		if (l->fd >= 0)
			close(l->fd);
		if (l->path[0])
			unlink(l->path);
	}
	if (s->fd >= 0)
		close(s->fd);
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

/* For the log: the process at the other end, or its port. */
static void tell_who(int fd, char *who, size_t size)
{
	union {
		struct sockaddr any;
		struct sockaddr_in in;
		struct sockaddr_in6 in6;
		struct sockaddr_storage storage;
	} peer = {0};
	socklen_t length = sizeof(peer), credentials = sizeof(struct ucred);
	struct ucred process;

	snprintf(who, size, "unknown");
	if (getpeername(fd, &peer.any, &length) < 0)
		return;
	if (peer.any.sa_family == AF_INET)
		snprintf(who, size, "127.0.0.1 port %u", ntohs(peer.in.sin_port));
	else if (peer.any.sa_family == AF_INET6)
		snprintf(who, size, "::1 port %u", ntohs(peer.in6.sin6_port));
	else if (getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &process, &credentials) == 0)
		snprintf(who, size, "uid %u pid %d", process.uid, process.pid);
}

/* One more than there are places is closed at once. */
static void accept_client(struct cia309_server *s, const struct cia309_listener *l, uint64_t now_us)
{
	int fd = accept4(l->fd, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC), on = 1;
	struct cia309_client *c = s->clients;
	char who[CIA309_WHO_MAX];

	s->accept_us = now_us + CIA309_ACCEPT_US;
	if (fd < 0)
		return;
	while (c < s->clients + CIA309_SESSIONS && c->session)
		c++;
	tell_who(fd, who, sizeof(who));
	struct cia309_session *session =
		c < s->clients + CIA309_SESSIONS ? cia309_open(s->core, who, l->may_write) : NULL;
	if (!session) {
		close(fd);
		return;
	}
	setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
	*c = (struct cia309_client){.session = session, .fd = fd, .events = EPOLLIN, .last_us = now_us};
	if (watch(s, EPOLL_CTL_ADD, fd, EPOLLIN, (uint32_t)(c - s->clients)) < 0)
		drop(s, c);
}

static void receive(struct cia309_client *c, uint64_t now_us)
{
	char bytes[CIA309_OUT_MAX];
	size_t room = cia309_room(c->session);
	ssize_t n;

	if (room == 0 || c->ended)
		return;
	n = read(c->fd, bytes, room < sizeof(bytes) ? room : sizeof(bytes));
	if (n > 0) {
		cia309_input(c->session, bytes, (size_t)n);
		c->last_us = now_us;
	}
	c->ended = n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR);
}

/* True: something was sent. What a client that is gone should get is dropped. */
static bool transmit(struct cia309_client *c, uint64_t now_us)
{
	size_t size;
	const char *bytes = cia309_output(c->session, &size);
	ssize_t n = size && !c->gone ? send(c->fd, bytes, size, MSG_NOSIGNAL) : 0;

	if (n < 0 && errno != EAGAIN && errno != EINTR)
		c->ended = c->gone = true;
	if (c->gone)
		n = (ssize_t)size;
	if (n <= 0)
		return false;
	cia309_sent(c->session, (size_t)n);
	c->last_us = now_us;
	return true;
}

static bool transmit_all(struct cia309_server *s, uint64_t now_us)
{
	bool sent = false;

	for (struct cia309_client *c = s->clients; c < s->clients + CIA309_SESSIONS; c++)
		if (c->session && transmit(c, now_us))
			sent = true;
	return sent;
}

static void on_client(struct cia309_server *s, struct cia309_client *c, uint32_t events, uint64_t now_us)
{
	if (!c->session)
		return;
	receive(c, now_us);
	if (!(events & (EPOLLHUP | EPOLLERR)))
		return;
	/* epoll would report that for ever */
	c->ended = c->gone = true;
	watch(s, EPOLL_CTL_DEL, c->fd, 0, 0);
}

static void receive_all(struct cia309_server *s, uint64_t now_us)
{
	struct epoll_event events[CIA309_SESSIONS + CIA309_LISTENERS];
	int n = epoll_wait(s->fd, events, CIA309_SESSIONS + CIA309_LISTENERS, 0);

	for (int i = 0; i < n; i++) {
		uint32_t data = events[i].data.u32;

		if (!(data & LISTENER_EVENT))
			on_client(s, &s->clients[data], events[i].events, now_us);
		else if (now_us >= s->accept_us)
			accept_client(s, &s->listeners[data & ~(uint32_t)LISTENER_EVENT], now_us);
	}
}

/* Waits for what can be handled, and for nothing else: epoll must not wake the loop in vain. */
static uint64_t supervise(struct cia309_server *s, struct cia309_client *c, uint64_t now_us)
{
	size_t waiting;
	uint64_t limit_us;

	cia309_output(c->session, &waiting);
	limit_us = c->last_us + (waiting ? CIA309_STALLED_US : CIA309_QUIET_US);
	if (now_us >= limit_us ||
		(waiting == 0 && (cia309_closing(c->session) || (c->ended && cia309_idle(c->session))))) {
		drop(s, c);
		return UINT64_MAX;
	}
	uint32_t wanted = (cia309_room(c->session) && !c->ended ? EPOLLIN : 0u) | (waiting ? EPOLLOUT : 0u);
	if (wanted != c->events && !c->gone)
		watch(s, EPOLL_CTL_MOD, c->fd, wanted, (uint32_t)(c - s->clients));
	c->events = wanted;
	return limit_us;
}

static uint64_t supervise_listeners(struct cia309_server *s, uint64_t now_us)
{
	bool open = now_us >= s->accept_us;

	for (uint32_t i = 0; i < CIA309_LISTENERS; i++) {
		struct cia309_listener *l = &s->listeners[i];

		if (l->fd >= 0 && l->open != open)
			watch(s, EPOLL_CTL_MOD, l->fd, open ? EPOLLIN : 0u, LISTENER_EVENT | i);
		l->open = open;
	}
	return open ? UINT64_MAX : s->accept_us;
}

uint64_t cia309_server_step(struct cia309_server *s, bool readable, uint64_t now_us)
{
	uint64_t next_us;

	if (readable)
		receive_all(s, now_us);
	next_us = cia309_tick(s->core, now_us);
	if (transmit_all(s, now_us)) /* room for more */
		next_us = cia309_tick(s->core, now_us);
	for (struct cia309_client *c = s->clients; c < s->clients + CIA309_SESSIONS; c++)
		if (c->session)
			next_us = earlier(next_us, supervise(s, c, now_us));
	return earlier(next_us, supervise_listeners(s, now_us));
}

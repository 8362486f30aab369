#include "gateway/modbus/server.h"

#include <arpa/inet.h>
#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <syslog.h>
#include <time.h>
#include <unistd.h>

#include "gateway/modbus/rtu.h"

enum { MBAP = 7, ADU_MAX = MBAP + MODBUS_PDU_MAX, MBAP_LENGTH_MIN = 2, MBAP_LENGTH_MAX = MODBUS_PDU_MAX + 1 };
enum { STACK_BYTES = 192 * 1024, BACKLOG = 8, NICE = 10, ACCEPTS_PER_WAKE = 8 };
enum {
	SECOND_US = 1000000,
	REOPEN_US = 2 * SECOND_US,
	CHAR_BITS = 11,
	FAST_SILENCE_US = 1750, /* 3.5 characters, above 19200 Bd this */
	FRAME_GAP_US = 50000,	/* within a frame, of a USB adapter or a loaded host */
};

struct client {
	const struct modbus_window *window; /* NULL: unused */
	int fd;				    /* -1: a serial line that is to be opened again */
	modbus_t *line;
	bool waiting;	/* its write is not complete: OD_PENDING */
	uint8_t ticket; /* of this write */
	bool told;	/* of a line: that it is gone */
	uint8_t in[ADU_MAX];
	size_t used;
	uint64_t request_us, byte_us; /* the last one */
	uint64_t tokens_us;	      /* requests that may come now, as time at the rate of the window */
	uint64_t retry_us;	      /* of a line */
	struct modbus_access access;
};

struct modbus_server {
	struct modbus_server_config config;
	struct modbus_window windows[MODBUS_WINDOWS_MAX];
	int listeners[MODBUS_WINDOWS_MAX]; /* -1: a serial line */
	struct client clients[MODBUS_CLIENTS_MAX];
	struct modbus_counters counters;
	uint64_t refusal_told_us;
	pthread_t thread;
	atomic_bool quit;
	atomic_uint node_id;
};

static uint64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * SECOND_US + (uint64_t)t.tv_nsec / 1000;
}

/* The counters have one writer: no read-modify-write of the bus is needed. */
static void count(atomic_uint *counter, int change)
{
	unsigned value = atomic_load_explicit(counter, memory_order_relaxed);

	atomic_store_explicit(counter, value + (unsigned)change, memory_order_relaxed);
}

__attribute__((format(printf, 3, 4))) static void tell(
	const struct modbus_server *s, int severity, const char *format, ...)
{
	char text[256];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	s->config.log(severity, text);
}

/* ---- clients ----------------------------------------------------------------------------------------------------- */

static unsigned clients_of(const struct modbus_server *s, const struct modbus_window *window)
{
	unsigned n = 0;

	for (size_t i = 0; i < MODBUS_CLIENTS_MAX; i++)
		n += s->clients[i].window == window;
	return n;
}

static struct client *new_client(struct modbus_server *s, const struct modbus_window *window, int fd, const char *who,
	bool may_write, uint64_t now_us)
{
	for (struct client *c = s->clients; c < s->clients + MODBUS_CLIENTS_MAX; c++) {
		if (c->window)
			continue;
		c->window = window;
		c->fd = fd;
		c->line = NULL;
		c->waiting = c->told = false;
		c->used = 0;
		c->request_us = c->byte_us = now_us;
		c->tokens_us = SECOND_US;
		c->retry_us = 0;
		modbus_access_init(&c->access, s->config.link, s->config.map, s->config.table, who, may_write,
			s->config.abort_code);
		count(&s->counters.clients, 1);
		return c;
	}
	return NULL;
}

static void close_line(struct client *c)
{
	if (c->line) {
		modbus_close(c->line);
		modbus_free(c->line);
	}
	c->line = NULL;
	c->fd = -1;
	c->used = 0;
	c->waiting = false;
}

static int open_line(struct client *c)
{
	const struct modbus_window *w = c->window;

	c->line = modbus_new_rtu(w->device, w->baud, w->parity, 8, w->stop);
	if (!c->line)
		return -errno;
	if (modbus_connect(c->line) < 0) {
		int rc = -errno;

		close_line(c);
		return rc;
	}
	c->fd = modbus_get_socket(c->line);
	return 0;
}

/* A line is opened again after a while. */
static void drop(struct modbus_server *s, struct client *c, uint64_t now_us)
{
	if (c->window->serial) {
		if (!c->told)
			tell(s, LOG_WARNING, "Modbus: %s is gone; trying to open it again", c->window->device);
		c->told = true;
		close_line(c);
		c->retry_us = now_us + REOPEN_US;
		return;
	}
	close(c->fd);
	c->window = NULL;
	count(&s->counters.clients, -1);
}

static void reopen(struct modbus_server *s, struct client *c, uint64_t now_us)
{
	if (now_us < c->retry_us)
		return;
	c->retry_us = now_us + REOPEN_US;
	if (open_line(c) < 0)
		return;
	c->told = false;
	tell(s, LOG_INFO, "Modbus: %s is back", c->window->device);
}

union peer {
	struct sockaddr any;
	struct sockaddr_in v4;
	struct sockaddr_in6 v6;
};

/* IPv4 as IPv6, and as text with the port. */
static void address_of(const union peer *peer, uint8_t address[16], char *who, size_t size)
{
	char text[INET6_ADDRSTRLEN] = "";

	if (peer->any.sa_family == AF_INET) {
		memset(address, 0, 16);
		address[10] = address[11] = 0xFF;
		memcpy(address + 12, &peer->v4.sin_addr, 4);
		inet_ntop(AF_INET, &peer->v4.sin_addr, text, sizeof(text));
		snprintf(who, size, "%s:%u", text, ntohs(peer->v4.sin_port));
	} else {
		memcpy(address, &peer->v6.sin6_addr, 16);
		inet_ntop(AF_INET6, &peer->v6.sin6_addr, text, sizeof(text));
		snprintf(who, size, "[%s]:%u", text, ntohs(peer->v6.sin6_port));
	}
}

/* Once a second at most. */
static void refuse(struct modbus_server *s, int fd, const char *who, const char *why, uint64_t now_us)
{
	count(&s->counters.refused, 1);
	close(fd);
	if (s->refusal_told_us && now_us - s->refusal_told_us < SECOND_US)
		return;
	s->refusal_told_us = now_us;
	tell(s, LOG_WARNING, "Modbus: %s is refused: %s", who, why);
}

/* False: there is nobody more. */
static bool accept_one(struct modbus_server *s, size_t window, uint64_t now_us)
{
	const struct modbus_window *w = &s->windows[window];
	union peer peer = {.v6 = {0}};
	socklen_t size = sizeof(peer);
	uint8_t address[16];
	char who[MODBUS_WHO_MAX];
	int fd = accept4(s->listeners[window], &peer.any, &size, SOCK_NONBLOCK | SOCK_CLOEXEC);

	if (fd < 0)
		return false;
	address_of(&peer, address, who, sizeof(who));
	setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &(int){1}, sizeof(int));
	if (!modbus_nets_have(&w->allow, address))
		refuse(s, fd, who, "allow= does not have its address", now_us);
	else if (clients_of(s, w) >= w->clients ||
		 !new_client(s, w, fd, who, modbus_nets_have(&w->write, address), now_us))
		refuse(s, fd, who, "too many clients", now_us);
	return true;
}

/* ---- requests ---------------------------------------------------------------------------------------------------- */

static bool send_all(const struct client *c, const uint8_t *bytes, size_t size)
{
	ssize_t n = c->window->serial ? write(c->fd, bytes, size) : send(c->fd, bytes, size, MSG_NOSIGNAL);

	return n == (ssize_t)size; /* the buffers of the kernel hold more than one response */
}

static void consume(struct client *c, size_t size)
{
	c->used -= size;
	memmove(c->in, c->in + size, c->used);
}

/* Where the PDU is in a frame, and its size. `in` has a whole request. */
static size_t pdu_at(const struct client *c)
{
	return c->window->serial ? 1 : MBAP;
}

/* False: the client is to be dropped. */
static bool answer(struct modbus_server *s, struct client *c, const uint8_t *pdu, size_t size)
{
	uint8_t out[ADU_MAX + 2];
	size_t at = pdu_at(c);

	count(&s->counters.exceptions, pdu[0] >> 7);
	if (c->window->serial && c->in[0] == MODBUS_RTU_BROADCAST)
		return true;
	memcpy(out, c->in, at);
	memcpy(out + at, pdu, size);
	size += at;
	if (c->window->serial) {
		uint16_t crc = modbus_crc(out, size);

		out[size++] = (uint8_t)crc;
		out[size++] = (uint8_t)(crc >> 8);
	} else {
		out[4] = (uint8_t)((size - 6) >> 8);
		out[5] = (uint8_t)(size - 6);
	}
	return send_all(c, out, size);
}

/* The request is at the beginning of `in`: its frame has `size` bytes, its PDU ends `behind` before that. */
static bool serve(struct modbus_server *s, struct client *c, size_t size, size_t behind, uint64_t now_us)
{
	uint8_t response[MODBUS_PDU_MAX];
	const uint8_t *request = c->in + pdu_at(c);
	size_t request_size = size - pdu_at(c) - behind;

	c->request_us = now_us;
	count(&s->counters.requests, 1);
	if (!c->access.registers.read_only)
		count(&s->counters.writes, modbus_pdu_writes(request, request_size));
	c->access.registers.node_id = (uint8_t)atomic_load_explicit(&s->node_id, memory_order_relaxed);
	size_t n = modbus_pdu(&c->access.registers, request, request_size, response);
	c->waiting = n == 0;
	c->ticket = s->config.link->job.ticket;
	if (c->waiting)
		return true;
	bool good = answer(s, c, response, n);
	if (good)
		consume(c, size);
	return good;
}

static size_t mbap_size(const struct client *c)
{
	return 6u + (size_t)(c->in[4] << 8 | c->in[5]);
}

static bool take_token(struct client *c)
{
	uint64_t price_us = SECOND_US / c->window->rate;

	if (c->tokens_us < price_us)
		return false;
	c->tokens_us -= price_us;
	return true;
}

static bool whole_tcp(const struct client *c)
{
	return c->used >= MBAP && c->used >= mbap_size(c);
}

static bool process_tcp(struct modbus_server *s, struct client *c, uint64_t now_us)
{
	if (c->used >= 6) {
		size_t length = mbap_size(c) - 6;

		if (c->in[2] || c->in[3] || length < MBAP_LENGTH_MIN || length > MBAP_LENGTH_MAX) {
			count(&s->counters.malformed, 1);
			return false;
		}
	}
	return !whole_tcp(c) || !take_token(c) || serve(s, c, mbap_size(c), 0, now_us);
}

static uint64_t silence_us(const struct modbus_window *w)
{
	return w->baud > 19200 ? FAST_SILENCE_US : (uint64_t)(7 * CHAR_BITS * SECOND_US / 2 / w->baud);
}

static bool process_rtu(struct modbus_server *s, struct client *c, uint64_t now_us)
{
	uint64_t silent_us = now_us - c->byte_us;
	enum modbus_rtu_result result = MODBUS_RTU_DROP;
	size_t size;

	if (silent_us < silence_us(c->window))
		return true;
	while (result == MODBUS_RTU_DROP && c->used > 0) {
		result = modbus_rtu_next(c->in, c->used, c->window->address, silent_us >= FRAME_GAP_US, &size);
		if (result == MODBUS_RTU_DROP)
			consume(c, size);
	}
	if (result == MODBUS_RTU_REQUEST)
		return serve(s, c, size, 2, now_us);
	if (result == MODBUS_RTU_BAD) {
		count(&s->counters.malformed, 1);
		c->used = 0;
	}
	return true;
}

static bool receive(struct client *c, short events, uint64_t now_us)
{
	size_t room = (c->window->serial ? (size_t)MODBUS_RTU_MAX : sizeof(c->in)) - c->used;
	ssize_t n = read(c->fd, c->in + c->used, room);

	if (n < 0)
		return errno == EAGAIN || errno == EINTR;
	if (n == 0)
		return c->window->serial && !(events & POLLHUP); /* a tty without data */
	c->used += (size_t)n;
	c->byte_us = now_us;
	return true;
}

/* A write that was OD_PENDING is complete. */
static void answer_late(struct modbus_server *s, uint64_t now_us)
{
	uint8_t response[MODBUS_PDU_MAX];
	enum od_status status;
	uint8_t ticket;

	if (!modbus_link_late(s->config.link, &ticket, &status))
		return;
	for (struct client *c = s->clients; c < s->clients + MODBUS_CLIENTS_MAX; c++) {
		size_t size;

		if (!c->window || !c->waiting || c->ticket != ticket)
			continue;
		size_t n = modbus_pdu_done(&c->access.registers, c->in + pdu_at(c), status, response);
		c->waiting = false;
		c->request_us = now_us;
		if (!answer(s, c, response, n))
			drop(s, c, now_us);
		else if (!c->window->serial)
			consume(c, mbap_size(c));
		else if (modbus_rtu_next(c->in, c->used, c->window->address, true, &size) == MODBUS_RTU_REQUEST)
			consume(c, size);
	}
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static uint64_t earlier(uint64_t a, uint64_t b)
{
	return a < b ? a : b;
}

/* When there is something to do for it although nothing is received. */
static uint64_t deadline_us(const struct client *c, uint64_t now_us)
{
	const struct modbus_window *w = c->window;

	if (c->fd < 0)
		return c->retry_us;
	if (c->waiting)
		return UINT64_MAX;
	if (w->serial) {
		if (c->used == 0)
			return UINT64_MAX;
		uint64_t first_us = c->byte_us + silence_us(w);
		return first_us > now_us ? first_us : c->byte_us + FRAME_GAP_US;
	}
	if (whole_tcp(c)) /* it has no token */
		return now_us + SECOND_US / w->rate - earlier(c->tokens_us, SECOND_US / w->rate);
	return c->request_us + (uint64_t)w->idle_s * SECOND_US;
}

static void refill(struct client *c, uint64_t passed_us)
{
	c->tokens_us = earlier(c->tokens_us + passed_us, SECOND_US);
}

static void turn_client(struct modbus_server *s, struct client *c, short events, uint64_t now_us)
{
	bool good = !(events & (POLLERR | POLLHUP | POLLNVAL)) || events & POLLIN;

	if (c->fd < 0) {
		reopen(s, c, now_us);
		return;
	}
	if (good && events & POLLIN)
		good = receive(c, events, now_us);
	if (good && !c->waiting)
		good = c->window->serial ? process_rtu(s, c, now_us) : process_tcp(s, c, now_us);
	if (good && !c->window->serial && !c->waiting &&
		now_us - c->request_us >= (uint64_t)c->window->idle_s * SECOND_US)
		good = false;
	if (!good)
		drop(s, c, now_us);
}

/* A client whose request is not served yet is not read. */
static bool wants_input(const struct client *c)
{
	return !c->waiting && (c->window->serial ? c->used < MODBUS_RTU_MAX : !whole_tcp(c));
}

static void wait_for(struct pollfd *fds, nfds_t n, uint64_t until_us, uint64_t now_us)
{
	uint64_t us = until_us > now_us ? until_us - now_us : 0;
	struct timespec t = {.tv_sec = (time_t)(us / SECOND_US), .tv_nsec = (long)(us % SECOND_US) * 1000};

	ppoll(fds, n, until_us == UINT64_MAX ? NULL : &t, NULL);
}

static uint64_t turn(struct modbus_server *s, uint64_t before_us)
{
	struct pollfd fds[1 + MODBUS_WINDOWS_MAX + MODBUS_CLIENTS_MAX];
	uint64_t until_us = UINT64_MAX, now_us = now();
	eventfd_t done;

	answer_late(s, now_us);
	fds[0] = (struct pollfd){.fd = s->config.link->done_fd, .events = POLLIN};
	for (size_t i = 0; i < MODBUS_WINDOWS_MAX; i++)
		fds[1 + i] = (struct pollfd){.fd = s->listeners[i], .events = POLLIN};
	for (size_t i = 0; i < MODBUS_CLIENTS_MAX; i++) {
		struct client *c = &s->clients[i];
		struct pollfd *fd = &fds[1 + MODBUS_WINDOWS_MAX + i];

		*fd = (struct pollfd){.fd = c->window ? c->fd : -1};
		if (!c->window)
			continue;
		refill(c, now_us - before_us);
		fd->events = wants_input(c) ? POLLIN : 0;
		until_us = earlier(until_us, deadline_us(c, now_us));
	}
	wait_for(fds, 1 + MODBUS_WINDOWS_MAX + MODBUS_CLIENTS_MAX, until_us, now_us);
	before_us = now_us;
	now_us = now();
	if (fds[0].revents & POLLIN)
		eventfd_read(s->config.link->done_fd, &done);
	for (size_t i = 0; i < MODBUS_CLIENTS_MAX; i++) {
		struct client *c = &s->clients[i];

		if (!c->window)
			continue;
		refill(c, now_us - before_us);
		turn_client(s, c, fds[1 + MODBUS_WINDOWS_MAX + i].revents, now_us);
	}
	for (size_t i = 0; i < MODBUS_WINDOWS_MAX; i++)
		for (int k = 0; fds[1 + i].revents & POLLIN && k < ACCEPTS_PER_WAKE && accept_one(s, i, now_us); k++)
			;
	return now_us;
}

static void *thread_main(void *arg)
{
	struct modbus_server *s = arg;
	uint64_t now_us = now();

	/* The loop comes first, also where who started the process gave it real-time scheduling. */
	pthread_setschedparam(pthread_self(), SCHED_OTHER, &(struct sched_param){.sched_priority = 0});
	setpriority(PRIO_PROCESS, 0, NICE); /* of this thread */
	while (!atomic_load(&s->quit))
		now_us = turn(s, now_us);
	return NULL;
}

/* ---- start and end ----------------------------------------------------------------------------------------------- */

static int open_listener(const struct modbus_window *w)
{
	modbus_t *tcp = modbus_new_tcp_pi(w->host, w->port);

	if (!tcp)
		return -errno;
	errno = 0;
	int fd = modbus_tcp_pi_listen(tcp, BACKLOG);
	int rc = fd >= 0 ? fd : errno ? -errno : -EADDRNOTAVAIL;
	modbus_free(tcp);
	if (fd >= 0 && (fcntl(fd, F_SETFL, O_NONBLOCK) < 0 || fcntl(fd, F_SETFD, FD_CLOEXEC) < 0)) {
		rc = -errno;
		close(fd);
	}
	return rc;
}

static int open_window(struct modbus_server *s, size_t i)
{
	const struct modbus_window *w = &s->windows[i];

	if (!w->serial) {
		int fd = open_listener(w);

		s->listeners[i] = fd >= 0 ? fd : -1;
		return fd >= 0 ? 0 : fd;
	}
	struct client *c = new_client(s, w, -1, w->device, w->may_write, now());
	assert(c); /* there are more places than windows */
	return open_line(c);
}

static void close_all(struct modbus_server *s)
{
	for (size_t i = 0; i < MODBUS_WINDOWS_MAX; i++)
		if (s->listeners[i] >= 0)
			close(s->listeners[i]);
	for (struct client *c = s->clients; c < s->clients + MODBUS_CLIENTS_MAX; c++) {
		if (c->window && c->window->serial)
			close_line(c);
		else if (c->window)
			close(c->fd);
	}
	free(s);
}

static int start_thread(struct modbus_server *s)
{
	pthread_attr_t attributes;

	pthread_attr_init(&attributes);
	pthread_attr_setstacksize(&attributes, STACK_BYTES);
	int rc = pthread_create(&s->thread, &attributes, thread_main, s);
	pthread_attr_destroy(&attributes);
	return -rc;
}

struct modbus_server *modbus_server_start(const struct modbus_server_config *config, char *error, size_t error_size)
{
	struct modbus_server *s = calloc(1, sizeof(*s));
	int rc = s ? 0 : -ENOMEM;

	if (!s) {
		snprintf(error, error_size, "Modbus: %s", strerror(-rc));
		return NULL;
	}
	s->config = *config;
	for (size_t i = 0; i < MODBUS_WINDOWS_MAX; i++)
		s->listeners[i] = -1;
	memcpy(s->windows, config->windows, config->count * sizeof(*config->windows));
	for (size_t i = 0; i < config->count && rc == 0; i++) {
		const struct modbus_window *w = &s->windows[i];

		rc = open_window(s, i);
		if (rc < 0)
			snprintf(error, error_size, "Modbus: %s%s%s: %s", w->serial ? w->device : w->host,
				w->serial ? "" : ":", w->serial ? "" : w->port, strerror(-rc));
	}
	if (rc == 0 && (rc = start_thread(s)) < 0)
		snprintf(error, error_size, "Modbus: no thread: %s", strerror(-rc));
	if (rc == 0)
		return s;
	close_all(s);
	return NULL;
}

const struct modbus_counters *modbus_server_counters(const struct modbus_server *server)
{
	return &server->counters;
}

void modbus_server_node_id(struct modbus_server *server, uint8_t node_id)
{
	atomic_store_explicit(&server->node_id, node_id, memory_order_relaxed);
}

void modbus_server_stop(struct modbus_server *server)
{
	atomic_store(&server->quit, true);
	modbus_link_closing(server->config.link);
	pthread_join(server->thread, NULL);
	close_all(server);
}

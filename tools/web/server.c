#include "tools/web/server.h"

#include <errno.h>
#include <libwebsockets.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "tools/lib/cli.h"
#include "tools/web/request.h"

enum {
	CONNECTIONS = 128, /* with those that only fetch a file */
	HEADERS = 8192,	   /* bytes of the headers of a request */
	REQUEST_S = 5,	   /* in which a request must be complete */
	SILENT_S = 20,	   /* then a browser is asked whether it is there */
	GONE_S = 40,
	CHUNK = 16384,
	RECEIVE = 4096,
	FRAMES = 256, /* of the bus in one wake */
	/* Frames are fetched together, so that not each one takes the processor from a gateway: */
	GATHER_US = 20000,
	GATHER_ANSWER_US = 1000, /* while an answer is awaited */
	QUIET_US = 1000000,	 /* after this time without a frame the next one wakes this program */
};

/* Of each connection: one that fetches a file, or a browser. */
struct connection {
	const struct web_file *file;
	size_t sent;
	int client; /* slot + 1; 0: none, also of a browser that was refused */
	char *text; /* of a message that has not arrived completely */
	size_t size;
	bool paused;
};

struct server {
	struct web *web;
	const struct web_server_config *config;
	struct lws_context *context;
	int events, timer;
	uint64_t next_us;
	uint64_t fetched_us; /* frames, the last time that it was tried */
	uint64_t stamped_us; /* the last time that there was one with a time stamp of the bus */
	bool gathers;	     /* is not woken by frames */
	struct lws *wsi[WEB_CLIENTS];
	struct connection *connections[WEB_CLIENTS];
	bool ends;
};

static struct server *server_of(struct lws *wsi)
{
	return lws_context_user(lws_get_context(wsi));
}

/* ---- the loop: libwebsockets waits on one descriptor for the bus, the timer and the signals ---------------------- */

static void set_timer(struct server *server, uint64_t next_us)
{
	struct itimerspec at = {.it_value = {(time_t)(next_us / 1000000), (long)(next_us % 1000000) * 1000}};

	if (next_us == server->next_us)
		return;
	server->next_us = next_us;
	if (next_us == UINT64_MAX)
		at = (struct itimerspec){0};
	else if (next_us == 0)
		at.it_value.tv_nsec = 1; /* 0 would switch it off */
	timerfd_settime(server->timer, TFD_TIMER_ABSTIME, &at, NULL);
}

/* Only where the bus stamps its frames: else the time of a frame is that at which it is fetched. Returns when to fetch
 * the next ones. */
static uint64_t gather(struct server *server, uint64_t now_us)
{
	bool gathers = server->stamped_us && now_us < server->stamped_us + QUIET_US;
	int fd = server->web->config.bus->fd;

	if (gathers != server->gathers) {
		struct epoll_event event = {.events = gathers ? 0 : EPOLLIN, .data.fd = fd};

		epoll_ctl(server->events, EPOLL_CTL_MOD, fd, &event);
		server->gathers = gathers;
	}
	if (!gathers)
		return UINT64_MAX;
	return server->fetched_us + (web_awaits_answer(server->web) ? GATHER_ANSWER_US : GATHER_US);
}

/* Before anything is sent: what others were answered is no answer to that. Returns whether there may be more. */
static bool receive_frames(struct server *server)
{
	struct can_port *bus = server->web->config.bus;
	struct can_msg msg;

	for (int i = 0; i < FRAMES; i++) {
		uint64_t now_us = server->fetched_us = cli_now_us();

		if (can_receive(bus, &msg, now_us) <= 0)
			return false;
		web_receive(server->web, &msg, now_us);
		if (msg.t_us && msg.t_us != now_us)
			server->stamped_us = now_us;
	}
	return true;
}

/* After anything has happened: what is due, and who wants to send or may receive again. */
static void tick(struct server *server)
{
	struct web *web = server->web;
	bool more = receive_frames(server);
	uint64_t now_us = cli_now_us();
	uint64_t next_us = web_tick(web, now_us);
	uint64_t bus_us = can_service(web->config.bus, now_us), gather_us = gather(server, now_us);

	if (bus_us < next_us)
		next_us = bus_us;
	if (gather_us < next_us)
		next_us = gather_us;
	for (int i = 0; i < WEB_CLIENTS; i++) {
		struct connection *connection = server->connections[i];

		if (!connection)
			continue;
		if (web_has_output(web, i, now_us, &next_us))
			lws_callback_on_writable(server->wsi[i]);
		if (connection->paused == web_takes_input(web, i)) {
			connection->paused = !connection->paused;
			lws_rx_flow_control(server->wsi[i], !connection->paused);
		}
	}
	set_timer(server, more ? 0 : next_us); /* the descriptor is not readable for what the port has fetched */
}

static int on_events(struct server *server)
{
	struct epoll_event events[4];
	uint64_t expirations;
	int n = epoll_wait(server->events, events, 4, 0);

	for (int i = 0; i < n; i++)
		if (events[i].data.fd == server->timer)
			server->next_us = read(server->timer, &expirations, sizeof(expirations)) > 0 ? UINT64_MAX
												     : server->next_us;
		else if (events[i].data.fd == server->config->signal_fd)
			server->ends = true;
	tick(server);
	if (server->ends)
		lws_cancel_service(server->context);
	return 0;
}

/* ---- HTTP -------------------------------------------------------------------------------------------------------- */

static bool header(struct lws *wsi, enum lws_token_indexes token, char *value, int capacity)
{
	return lws_hdr_total_length(wsi, token) > 0 && lws_hdr_copy(wsi, value, capacity, token) > 0;
}

/* Of the files and of the WebSocket. */
static bool is_host_allowed(struct lws *wsi, char host[300])
{
	const struct web_server_config *config = server_of(wsi)->config;

	return header(wsi, WSI_TOKEN_HOST, host, 300) && web_host_allowed(host, config->hosts, config->host_count);
}

static int add(struct lws *wsi, const char *name, const char *value, unsigned char **at, unsigned char *end)
{
	return lws_add_http_header_by_name(
		wsi, (const unsigned char *)name, (const unsigned char *)value, (int)strlen(value), at, end);
}

static int add_safety(struct lws *wsi, unsigned char **at, unsigned char *end)
{
	return add(wsi, "content-security-policy:",
		       "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
		       "frame-ancestors 'none'",
		       at, end) ||
	       add(wsi, "x-content-type-options:", "nosniff", at, end) ||
	       add(wsi, "referrer-policy:", "no-referrer", at, end) ||
	       add(wsi, "cross-origin-resource-policy:", "same-origin", at, end) ||
	       add(wsi, "x-frame-options:", "DENY", at, end);
}

static int refuse(struct lws *wsi, unsigned int status, const char *text)
{
	unsigned char buffer[LWS_PRE + 1200], *start = buffer + LWS_PRE, *at = start,
					      *end = buffer + sizeof(buffer) - 1;
	unsigned char body[LWS_PRE + 128];
	size_t size = strlen(text);

	memcpy(body + LWS_PRE, text, size);
	if (lws_add_http_common_headers(wsi, status, "text/plain", size, &at, end) || add_safety(wsi, &at, end) ||
		lws_finalize_write_http_header(wsi, start, &at, end))
		return -1;
	lws_write(wsi, body + LWS_PRE, size, LWS_WRITE_HTTP_FINAL);
	return -1; /* ends the connection */
}

static const struct web_file *find_file(const char *path)
{
	if (strcmp(path, "/") == 0)
		path = "/index.html";
	for (const struct web_file *file = web_files; file->path; file++)
		if (strcmp(file->path, path) == 0)
			return file;
	return NULL;
}

static int send_headers(struct lws *wsi, const struct web_file *file, bool known)
{
	unsigned char buffer[LWS_PRE + 2048], *start = buffer + LWS_PRE, *at = start,
					      *end = buffer + sizeof(buffer) - 1;
	unsigned int status = known ? HTTP_STATUS_NOT_MODIFIED : HTTP_STATUS_OK;

	return lws_add_http_common_headers(wsi, status, file->type, known ? 0 : file->size, &at, end) ||
	       add(wsi, "etag:", file->tag, &at, end) || add(wsi, "cache-control:", "no-cache", &at, end) ||
	       (!known && add(wsi, "content-encoding:", "gzip", &at, end)) || add_safety(wsi, &at, end) ||
	       lws_finalize_write_http_header(wsi, start, &at, end);
}

static int on_http(struct lws *wsi, struct connection *connection, const char *path)
{
	char host[300], tag[64];

	if (lws_hdr_total_length(wsi, WSI_TOKEN_GET_URI) <= 0)
		return refuse(wsi, HTTP_STATUS_METHOD_NOT_ALLOWED, "only GET\n");
	if (!is_host_allowed(wsi, host))
		return refuse(wsi, HTTP_STATUS_FORBIDDEN, "this name is not one of the server: see imu9-web --host\n");
	const struct web_file *file = find_file(path);
	if (!file)
		return refuse(wsi, HTTP_STATUS_NOT_FOUND, "no such file\n");
	bool known = header(wsi, WSI_TOKEN_HTTP_IF_NONE_MATCH, tag, sizeof(tag)) && strcmp(tag, file->tag) == 0;
	if (send_headers(wsi, file, known))
		return -1;
	if (known)
		return lws_http_transaction_completed(wsi) ? -1 : 0;
	connection->file = file;
	connection->sent = 0;
	lws_callback_on_writable(wsi);
	return 0;
}

static int on_http_writable(struct lws *wsi, struct connection *connection)
{
	unsigned char buffer[LWS_PRE + CHUNK];
	const struct web_file *file = connection->file;

	if (!file)
		return 0;
	size_t left = file->size - connection->sent, size = left < CHUNK ? left : CHUNK;
	bool last = size == left;
	memcpy(buffer + LWS_PRE, file->data + connection->sent, size);
	if (lws_write(wsi, buffer + LWS_PRE, size, last ? LWS_WRITE_HTTP_FINAL : LWS_WRITE_HTTP) < 0)
		return -1;
	connection->sent += size;
	if (!last) {
		lws_callback_on_writable(wsi);
		return 0;
	}
	connection->file = NULL;
	return lws_http_transaction_completed(wsi) ? -1 : 0;
}

/* ---- WebSocket --------------------------------------------------------------------------------------------------- */

/* An upgrade to something else, from another site, or of another path. */
static int on_upgrade(struct lws *wsi, const char *protocol)
{
	char host[300], origin[320], path[64];

	if (strcmp(protocol, "websocket") != 0)
		return refuse(wsi, HTTP_STATUS_FORBIDDEN, "no such protocol\n");
	if (!is_host_allowed(wsi, host))
		return refuse(wsi, HTTP_STATUS_FORBIDDEN, "this name is not one of the server: see imu9-web --host\n");
	if (!header(wsi, WSI_TOKEN_ORIGIN, origin, sizeof(origin)) || !web_origin_allowed(origin, host))
		return refuse(wsi, HTTP_STATUS_FORBIDDEN, "only for the page of this server\n");
	if (!header(wsi, WSI_TOKEN_GET_URI, path, sizeof(path)) || strcmp(path, "/ws") != 0)
		return refuse(wsi, HTTP_STATUS_NOT_FOUND, "the WebSocket is /ws\n");
	return 0;
}

static int on_established(struct lws *wsi, struct connection *connection)
{
	struct server *server = server_of(wsi);
	int client = web_connect(server->web, cli_now_us());

	*connection = (struct connection){.client = client + 1};
	if (client < 0) {
		static unsigned char why[] = "too many browsers";

		lws_close_reason(wsi, LWS_CLOSE_STATUS_POLICY_VIOLATION, why, sizeof(why) - 1);
		return -1;
	}
	server->wsi[client] = wsi;
	server->connections[client] = connection;
	tick(server);
	return 0;
}

/* The place is free for another browser, although the connection may end later. */
static void leave(struct server *server, struct connection *connection)
{
	if (connection->client > 0) {
		web_disconnect(server->web, connection->client - 1);
		server->wsi[connection->client - 1] = NULL;
		server->connections[connection->client - 1] = NULL;
	}
	free(connection->text);
	*connection = (struct connection){0};
}

static int on_message(struct lws *wsi, struct connection *connection, const char *in, size_t size)
{
	struct server *server = server_of(wsi);

	if (connection->client <= 0)
		return -1; /* it was refused */
	if (lws_frame_is_binary(wsi) || connection->size + size > WEB_REQUEST_MAX) {
		leave(server, connection);
		lws_close_reason(wsi,
			lws_frame_is_binary(wsi) ? LWS_CLOSE_STATUS_UNACCEPTABLE_OPCODE
						 : LWS_CLOSE_STATUS_MESSAGE_TOO_LARGE,
			NULL, 0);
		return -1;
	}
	char *text = realloc(connection->text, connection->size + size + 1);
	if (!text)
		return -1;
	memcpy(text + connection->size, in, size);
	connection->text = text;
	connection->size += size;
	if (!lws_is_final_fragment(wsi) || lws_remaining_packet_payload(wsi) > 0)
		return 0;
	text[connection->size] = '\0';
	receive_frames(server);
	web_request(server->web, connection->client - 1, text, connection->size, cli_now_us());
	free(connection->text);
	connection->text = NULL;
	connection->size = 0;
	tick(server);
	return 0;
}

static int on_writable(struct lws *wsi, struct connection *connection)
{
	struct server *server = server_of(wsi);
	uint64_t now_us = cli_now_us();
	size_t size;

	if (connection->client <= 0)
		return -1; /* it was refused */
	const char *text = web_output(server->web, connection->client - 1, &size, now_us);
	int rc = 0;

	if (text) {
		unsigned char *buffer = malloc(LWS_PRE + size);

		if (!buffer)
			return -1;
		memcpy(buffer + LWS_PRE, text, size);
		rc = lws_write(wsi, buffer + LWS_PRE, size, LWS_WRITE_TEXT) < (int)size ? -1 : 0;
		free(buffer);
	}
	tick(server);
	return rc;
}

static int callback(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
	switch ((int)reason) {
	case LWS_CALLBACK_RAW_RX_FILE:
		return on_events(server_of(wsi));
	case LWS_CALLBACK_HTTP:
		return on_http(wsi, user, in);
	case LWS_CALLBACK_HTTP_WRITEABLE:
		return on_http_writable(wsi, user);
	case LWS_CALLBACK_HTTP_CONFIRM_UPGRADE:
		return on_upgrade(wsi, in);
	case LWS_CALLBACK_ESTABLISHED:
		return on_established(wsi, user);
	case LWS_CALLBACK_RECEIVE:
		return on_message(wsi, user, in, size);
	case LWS_CALLBACK_SERVER_WRITEABLE:
		return on_writable(wsi, user);
	case LWS_CALLBACK_WS_PEER_INITIATED_CLOSE:
	case LWS_CALLBACK_CLOSED:
		leave(server_of(wsi), user);
		return 0;
	default:
		return 0; /* no CGI, no proxy, no file of the disk */
	}
}

/* ---- start ------------------------------------------------------------------------------------------------------- */

static const struct lws_protocols PROTOCOLS[] = {
	{"imu9.v1", callback, sizeof(struct connection), RECEIVE, 0, NULL, 0},
	{0},
};

static int watch_fd(struct server *server, int fd)
{
	struct epoll_event event = {.events = EPOLLIN, .data.fd = fd};

	return epoll_ctl(server->events, EPOLL_CTL_ADD, fd, &event);
}

static int open_events(struct server *server)
{
	server->events = epoll_create1(EPOLL_CLOEXEC);
	server->timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
	server->next_us = UINT64_MAX;
	if (server->events < 0 || server->timer < 0 || watch_fd(server, server->timer) < 0 ||
		watch_fd(server, server->web->config.bus->fd) < 0 || watch_fd(server, server->config->signal_fd) < 0) {
		int rc = -errno;

		cli_error("epoll: %s", strerror(-rc));
		return rc;
	}
	return 0;
}

static int run(struct server *server, struct lws_vhost *vhost)
{
	lws_sock_file_fd_type events = {.filefd = server->events};

	if (!lws_adopt_descriptor_vhost(vhost, LWS_ADOPT_RAW_FILE_DESC, events, PROTOCOLS[0].name, NULL)) {
		cli_error("libwebsockets does not take the descriptor of the bus");
		return -EINVAL;
	}
	fputs(server->config->greeting, stdout);
	fflush(stdout);
	set_timer(server, 0);
	while (!server->ends && lws_service(server->context, 0) >= 0)
		;
	return 0;
}

int web_serve(struct web *web, const struct web_server_config *config)
{
	static const lws_retry_bo_t silence = {.secs_since_valid_ping = SILENT_S, .secs_since_valid_hangup = GONE_S};
	struct server server = {.web = web, .config = config};
	struct lws_context_creation_info info = {
		.options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS | LWS_SERVER_OPTION_VALIDATE_UTF8 |
			   LWS_SERVER_OPTION_FAIL_UPON_UNABLE_TO_BIND,
		.port = config->port,
		.iface = config->address,
		.protocols = PROTOCOLS,
		.fd_limit_per_thread = CONNECTIONS,
		.max_http_header_data = HEADERS,
		.max_http_header_data2 = HEADERS,
		.timeout_secs = REQUEST_S,
		.keepalive_timeout = REQUEST_S,
		.retry_and_idle_policy = &silence,
		.alpn = "http/1.1",
		.user = &server,
	};
	struct lws_vhost *vhost = NULL;

	if (strchr(config->address, ':') == NULL)
		info.options |= LWS_SERVER_OPTION_DISABLE_IPV6;
	lws_set_log_level(0, NULL); /* what others send must not fill a log */
	int rc = open_events(&server);
	if (rc == 0) {
		server.context = lws_create_context(&info);
		vhost = server.context ? lws_create_vhost(server.context, &info) : NULL;
		if (!vhost) {
			cli_error("cannot listen on %s port %d: is another program there, or is the port below 1024?",
				config->address, config->port);
			rc = -EADDRINUSE;
		}
	}
	if (rc == 0)
		rc = run(&server, vhost);
	if (server.context)
		lws_context_destroy(server.context);
	close(server.timer);
	return rc;
}

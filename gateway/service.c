#include "gateway/service.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/log.h"

static int connect_to(const char *path)
{
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	size_t length = strlen(path);

	if (length == 0 || length >= sizeof(address.sun_path))
		return -1;
	memcpy(address.sun_path, path, length);
	if (path[0] == '@') /* the abstract namespace */
		address.sun_path[0] = '\0';
	int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
	socklen_t size = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + length);
	if (fd >= 0 && connect(fd, (const struct sockaddr *)&address, size) < 0) {
		close(fd);
		fd = -1;
	}
	return fd;
}

static void tell(const struct service *s, const char *message)
{
	if (s->fd >= 0) /* a manager that does not read has its own limits for that */
		(void)send(s->fd, message, strlen(message), MSG_NOSIGNAL);
}

void service_open(struct service *s, const char *socket, const char *watchdog, const char *pid)
{
	*s = (struct service){.fd = socket ? connect_to(socket) : -1};
	if (s->fd < 0 && socket)
		log_warning("NOTIFY_SOCKET %s cannot be used: the service manager is not told of the start", socket);
	if (s->fd >= 0 && watchdog && (!pid || strtol(pid, NULL, 10) == getpid()))
		s->period_us = strtoull(watchdog, NULL, 10) / 2;
}

void service_close(struct service *s)
{
	if (s->fd >= 0)
		close(s->fd);
	s->fd = -1;
}

void service_ready(struct service *s, const char *status)
{
	char message[256];

	if (s->ready)
		return;
	s->ready = true;
	snprintf(message, sizeof(message), "READY=1\nSTATUS=%s", status);
	tell(s, message);
}

void service_stopping(struct service *s)
{
	tell(s, "STOPPING=1");
}

/* A thread with nothing to do does not hang. */
static bool hangs(struct service_thread *t, bool works, unsigned turns, uint64_t limit_us, uint64_t now_us)
{
	if (!works || turns != t->turns || t->since_us == 0)
		*t = (struct service_thread){.turns = turns, .since_us = now_us};
	return now_us > t->since_us && now_us - t->since_us > limit_us;
}

uint64_t service_tick(struct service *s, unsigned turns, bool storing, uint64_t now_us)
{
	if (s->period_us == 0)
		return UINT64_MAX;
	if (now_us < s->next_us)
		return s->next_us;
	s->next_us = now_us + s->period_us;
	bool sensor = hangs(&s->sensor, turns != 0, turns, SERVICE_SENSOR_HANGS_US, now_us);
	bool store = hangs(&s->store, storing, 0, SERVICE_STORE_HANGS_US, now_us);
	if (!sensor && !store)
		tell(s, "WATCHDOG=1");
	else if (!s->silent)
		log_error("%s hangs: waiting for the service manager to restart this process",
			sensor ? "the sensor's driver" : "the write to the store");
	s->silent = sensor || store;
	return s->next_us;
}

void service_away(struct service *s, uint64_t us)
{
	s->sensor.since_us += us;
	s->store.since_us += us;
}

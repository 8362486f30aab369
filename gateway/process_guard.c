#include "gateway/process_guard.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "gateway/log.h"
#include "gateway/loop.h"

enum { PATIENCE_S = 5, STACK_BYTES = 128 * 1024 };

/* Sent to the guard alone to end it. Its default action is none, so that others cannot do harm with it. */
enum { SIGNAL_REST = SIGURG };

static void end(struct process_guard *guard, const char *why)
{
	const char *what = atomic_load(&guard->opening);

	log_line("%s%s%s%s", why, guard->stopping ? "" : " before the start",
		!guard->stopping && what ? ", opening " : "", !guard->stopping && what ? what : "");
	_exit(guard->stopping ? EXIT_FAILURE : EXIT_SUCCESS);
}

static void *guard_main(void *arg)
{
	struct process_guard *guard = arg;
	const struct timespec patience = {.tv_sec = PATIENCE_S};
	sigset_t signals;
	const char *what;

	sigemptyset(&signals);
	sigaddset(&signals, SIGINT);
	sigaddset(&signals, SIGTERM);
	sigaddset(&signals, SIGNAL_REST);
	for (;;) {
		switch (sigtimedwait(&signals, NULL, &patience)) {
		case SIGNAL_REST:
			return NULL;
		case SIGINT:
			end(guard, "stopping on SIGINT");
			break;
		case SIGTERM:
			end(guard, "stopping on SIGTERM");
			break;
		default:
			if (errno != EAGAIN)
				break;
			if (guard->stopping)
				end(guard, "a device or the store did not end within 5 s; stopped without it");
			if ((what = atomic_exchange(&guard->opening, NULL)))
				log_line("%s: has been opening for seconds; a FIFO waits for its writer", what);
		}
	}
}

static void run(struct process_guard *guard)
{
	pthread_attr_t attributes;

	pthread_attr_init(&attributes);
	pthread_attr_setstacksize(&attributes, STACK_BYTES);
	guard->running = pthread_create(&guard->thread, &attributes, guard_main, guard) == 0;
	pthread_attr_destroy(&attributes);
}

void process_guard_start(struct process_guard *guard)
{
	sigset_t own;

	for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; fd++)
		if (fcntl(fd, F_GETFD) < 0)
			open("/dev/null", O_RDWR); /* the lowest free descriptor, which is `fd` */
	loop_hold_signals();
	sigemptyset(&own);
	sigaddset(&own, SIGNAL_REST);
	sigprocmask(SIG_BLOCK, &own, NULL);
	run(guard);
}

void process_guard_opening(struct process_guard *guard, const char *what)
{
	atomic_store(&guard->opening, what);
}

void process_guard_rest(struct process_guard *guard)
{
	if (!guard->running)
		return;
	pthread_kill(guard->thread, SIGNAL_REST);
	pthread_join(guard->thread, NULL);
	guard->running = false;
}

void process_guard_stop(struct process_guard *guard)
{
	guard->stopping = true;
	run(guard);
}

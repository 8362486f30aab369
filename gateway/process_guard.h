/* gateway/process_guard.h
 * A thread that takes SIGINT and SIGTERM while the loop does not: at the start, which can wait for a FIFO, a device or
 * a mount, and at the end, which waits for threads of drivers and of the store. */
#ifndef GATEWAY_PROCESS_GUARD_H
#define GATEWAY_PROCESS_GUARD_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

struct process_guard {
	pthread_t thread;
	bool running;
	bool stopping; /* written while the thread does not run */
	_Atomic(const char *) opening;
};

/** The first call of the process: holds the signals, and opens descriptors 0 to 2 on /dev/null where they are closed,
 * so that no device gets one of them and with it the log. From then on a signal ends the process at once, exit status
 * 0. */
void process_guard_start(struct process_guard *guard);
/** What the start opens next; a line of the log names it when that takes more than 5 s. `what` must stay. */
void process_guard_opening(struct process_guard *guard, const char *what);
/** The loop takes the signals now; one that came meanwhile waits for it. */
void process_guard_rest(struct process_guard *guard);
/** The loop has ended. A second signal, or 5 s, end the process, exit status 1. */
void process_guard_stop(struct process_guard *guard);

#endif

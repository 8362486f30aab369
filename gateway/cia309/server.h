/* gateway/cia309/server.h
 * The sockets of a CiA 309-3 gateway. An address is one of
 *
 *   unix:PATH[,group=NAME][,write=yes]     a socket of mode 0660: who may connect is who may open the file
 *   tcp:ADDRESS:PORT[,write=yes]           127.x.x.x or [::1]: every user of this host
 *
 * Runs in the loop of the device. No call blocks, and each does a bounded amount of work: at most one read and one
 * write of CIA309_OUT_MAX bytes for each client, and one new client each CIA309_ACCEPT_US. A client that does not
 * take its answers, or is idle for long, is closed. */
#ifndef GATEWAY_CIA309_SERVER_H
#define GATEWAY_CIA309_SERVER_H

#include "gateway/cia309/cia309.h"

enum {
	CIA309_LISTENERS = 4,
	CIA309_PATH_MAX = 108, /* sun_path */
	CIA309_ACCEPT_US = 10000,
	CIA309_STALLED_US = 10000000,
	CIA309_QUIET_US = 600000000,
};

/** Caller-owned. */
struct cia309_server {
	int fd; /* readable: call cia309_server_step() */

	/* PRIVATE */
	struct cia309 *core;
	struct cia309_listener {
		int fd; /* -1: none */
		bool may_write, open;
		char path[CIA309_PATH_MAX]; /* to be removed; "": TCP */
	} listeners[CIA309_LISTENERS];
	struct cia309_client {
		struct cia309_session *session; /* NULL: none */
		int fd;
		uint32_t events; /* that epoll waits for */
		bool ended;	 /* it sends nothing more */
		bool gone;	 /* it takes nothing more, either */
		uint64_t last_us;
	} clients[CIA309_SESSIONS];
	uint64_t accept_us; /* the next client */
};

/** Whether the addresses, one a line, are written well. 0, or -EINVAL and one line in `error`. */
int cia309_server_check(const char *addresses, char *error, size_t error_size);
/** Listens. 0, or -errno and one line in `error` that says what to do. */
int cia309_server_open(
	struct cia309_server *server, struct cia309 *core, const char *addresses, char *error, size_t error_size);
void cia309_server_close(struct cia309_server *server);

/** Receives if `readable`, calls cia309_tick(), and sends. Returns the next deadline. To be called in each turn of the
 * loop, after the device had its. */
uint64_t cia309_server_step(struct cia309_server *server, bool readable, uint64_t now_us);

#endif

/* tools/web/access.h
 * Who may use the server: Host and Origin of a request, and the token that unlocks what writes. No I/O but the file of
 * a token and the random numbers of the kernel.
 *
 * A page of another site can make a browser send requests here; it cannot choose Host and Origin. Its own name for this
 * address (DNS rebinding) is in Host, its own site is in Origin: both are refused. */
#ifndef TOOLS_WEB_ACCESS_H
#define TOOLS_WEB_ACCESS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { WEB_TOKEN_MIN = 16, WEB_TOKEN_MAX = 64 };

/** Whether a Host header (NULL: none) names this server as no foreign DNS name can: an IP address, localhost, or one of
 * the `count` names that the user gave; with or without a port. */
bool web_host_allowed(const char *host, const char *const *names, size_t count);
/** Whether an Origin header (NULL: none, refused) is that of a page of this server: http or https at `host`. */
bool web_origin_allowed(const char *origin, const char *host);

/** "127.0.0.1:8410", "[::1]:8410": an IP address and a port. False: it is written in another way. `address` gets at
 * least 46 bytes, without brackets. */
bool web_listen_address(const char *text, char address[64], int *port);
bool web_is_loopback(const char *address);

enum web_unlock { WEB_UNLOCKED, WEB_WRONG_TOKEN, WEB_WAIT };

struct web_token {
	char text[WEB_TOKEN_MAX + 1];
	/* PRIVATE */
	unsigned int failures; /* since the last right one */
	uint64_t next_us;      /* before that no token is looked at */
};

/** A token of 128 random bits. 0, or -errno. */
int web_token_create(struct web_token *token);
/** The first line of a file that only its owner can read. 0, or -errno and one line in `error` that says what to do. */
int web_token_load(struct web_token *token, const char *path, char *error, size_t error_size);
/** Compares in a time that does not depend on the content. After three wrong ones each further attempt waits twice as
 * long as the last, from 1 s up to 32 s; until then even the right one gives WEB_WAIT. */
enum web_unlock web_token_try(struct web_token *token, const char *given, uint64_t now_us);
/** Seconds until the next attempt, rounded up. */
unsigned int web_token_wait_s(const struct web_token *token, uint64_t now_us);

#endif

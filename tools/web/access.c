#include "tools/web/access.h"

#include <arpa/inet.h>
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

enum { NAME_MAX_SIZE = 256, FREE_FAILURES = 3, WAIT_MAX_SHIFT = 5 };

/* ---- Host and Origin --------------------------------------------------------------------------------------------- */

static bool is_port(const char *text)
{
	size_t digits = strspn(text, "0123456789");

	return digits >= 1 && digits <= 5 && text[digits] == '\0' && strtol(text, NULL, 10) <= 65535;
}

/* The name or address before the port, without brackets. */
static bool split_host(const char *host, char name[NAME_MAX_SIZE], bool *v6, const char **port)
{
	const char *begin = host, *end;

	*v6 = host[0] == '[';
	if (*v6) {
		begin = host + 1;
		end = strchr(begin, ']');
		*port = end ? end + 1 : NULL;
	} else {
		end = begin + strcspn(begin, ":");
		*port = end;
	}
	if (!end || end == begin || end - begin >= NAME_MAX_SIZE || (**port && **port != ':'))
		return false;
	memcpy(name, begin, (size_t)(end - begin));
	name[end - begin] = '\0';
	*port = **port ? *port + 1 : NULL;
	return !*port || is_port(*port);
}

bool web_host_allowed(const char *host, const char *const *names, size_t count)
{
	char name[NAME_MAX_SIZE];
	struct in6_addr address;
	const char *port;
	bool v6;

	if (!host || !split_host(host, name, &v6, &port))
		return false;
	if (v6)
		return inet_pton(AF_INET6, name, &address) == 1;
	if (inet_pton(AF_INET, name, &address) == 1 || strcasecmp(name, "localhost") == 0)
		return true;
	for (size_t i = 0; i < count; i++)
		if (strcasecmp(name, names[i]) == 0)
			return true;
	return false;
}

bool web_origin_allowed(const char *origin, const char *host)
{
	if (!origin || !host)
		return false;
	if (strncmp(origin, "http://", 7) == 0)
		return strcasecmp(origin + 7, host) == 0;
	return strncmp(origin, "https://", 8) == 0 && strcasecmp(origin + 8, host) == 0;
}

bool web_listen_address(const char *text, char address[64], int *port)
{
	char name[NAME_MAX_SIZE];
	struct in6_addr parsed;
	const char *digits;
	bool v6;

	if (!split_host(text, name, &v6, &digits) || !digits || inet_pton(v6 ? AF_INET6 : AF_INET, name, &parsed) != 1)
		return false;
	memcpy(address, name, strlen(name) + 1); /* an address has at most 45 characters */
	*port = (int)strtol(digits, NULL, 10);
	return true;
}

bool web_is_loopback(const char *address)
{
	struct in_addr v4;
	struct in6_addr v6;

	if (inet_pton(AF_INET, address, &v4) == 1)
		return ntohl(v4.s_addr) >> 24 == 127;
	return inet_pton(AF_INET6, address, &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

/* ---- the token --------------------------------------------------------------------------------------------------- */

int web_token_create(struct web_token *token)
{
	uint8_t bytes[16];

	*token = (struct web_token){0};
	if (getrandom(bytes, sizeof(bytes), 0) != (ssize_t)sizeof(bytes))
		return -errno;
	for (size_t i = 0; i < sizeof(bytes); i++)
		snprintf(token->text + 2 * i, 3, "%02x", bytes[i]);
	return 0;
}

static int read_line(int fd, const char *path, char *line, size_t capacity, char *error, size_t error_size)
{
	struct stat status;
	ssize_t n = read(fd, line, capacity - 1);

	if (n < 0 || fstat(fd, &status) < 0) {
		int rc = -errno;

		snprintf(error, error_size, "%s: %s", path, strerror(-rc));
		return rc;
	}
	line[n] = '\0';
	line[strcspn(line, "\r\n")] = '\0';
	if (status.st_mode & (S_IRWXG | S_IRWXO)) {
		snprintf(error, error_size, "%s: others can read the token: chmod 600 %s", path, path);
		return -EPERM;
	}
	return 0;
}

int web_token_load(struct web_token *token, const char *path, char *error, size_t error_size)
{
	char line[WEB_TOKEN_MAX + 3];
	int fd = open(path, O_RDONLY | O_CLOEXEC), rc = -errno;

	*token = (struct web_token){0};
	if (fd < 0) {
		snprintf(error, error_size, "%s: %s: make one, e.g. (umask 077; openssl rand -hex 16 >%s)", path,
			strerror(-rc), path);
		return rc;
	}
	rc = read_line(fd, path, line, sizeof(line), error, error_size);
	close(fd);
	if (rc < 0)
		return rc;
	size_t length = strlen(line);
	bool printable = true;
	for (size_t i = 0; i < length; i++)
		printable = printable && isgraph((unsigned char)line[i]);
	if (length < WEB_TOKEN_MIN || length > WEB_TOKEN_MAX || !printable) {
		snprintf(error, error_size, "%s: a token has %d to %d characters without blanks: openssl rand -hex 16",
			path, WEB_TOKEN_MIN, WEB_TOKEN_MAX);
		return -EINVAL;
	}
	memcpy(token->text, line, length + 1);
	return 0;
}

/* All WEB_TOKEN_MAX bytes, whatever differs. */
static bool is_equal(const char *a, const char *b)
{
	volatile unsigned char difference = 0;

	for (size_t i = 0; i < WEB_TOKEN_MAX; i++)
		difference = (unsigned char)(difference | (a[i] ^ b[i]));
	return difference == 0;
}

enum web_unlock web_token_try(struct web_token *token, const char *given, uint64_t now_us)
{
	char padded[WEB_TOKEN_MAX + 1] = "";
	size_t length = strlen(given);

	if (now_us < token->next_us)
		return WEB_WAIT;
	if (length <= WEB_TOKEN_MAX)
		memcpy(padded, given, length);
	if (token->text[0] && is_equal(padded, token->text)) {
		token->failures = 0;
		return WEB_UNLOCKED;
	}
	token->failures++;
	if (token->failures >= FREE_FAILURES) {
		unsigned int shift = token->failures - FREE_FAILURES;

		token->next_us = now_us + (UINT64_C(1000000) << (shift < WAIT_MAX_SHIFT ? shift : WAIT_MAX_SHIFT));
	}
	return WEB_WRONG_TOKEN;
}

unsigned int web_token_wait_s(const struct web_token *token, uint64_t now_us)
{
	return token->next_us > now_us ? (unsigned int)((token->next_us - now_us + 999999) / 1000000) : 0;
}

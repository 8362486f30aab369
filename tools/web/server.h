/* tools/web/server.h
 * The network side of imu9-web: HTTP and WebSocket by libwebsockets, and the loop. The only file that knows the
 * library; web.h is what it serves. */
#ifndef TOOLS_WEB_SERVER_H
#define TOOLS_WEB_SERVER_H

#include "tools/web/web.h"

/** A file of the page, compiled in by tools/web/embed. */
struct web_file {
	const char *path;	   /* "/index.html" */
	const char *type;	   /* Content-Type */
	const char *tag;	   /* ETag, in quotes: of the content */
	const unsigned char *data; /* gzip */
	size_t size;
};

/** Generated; ends with an empty path. */
extern const struct web_file web_files[];

struct web_server_config {
	const char *address;
	int port;
	const char *const *hosts; /* names that Host may have, besides IP addresses and localhost */
	size_t host_count;
	int signal_fd;	      /* ends the loop */
	const char *greeting; /* printed on standard output as soon as browsers can connect */
};

/** Serves until a signal arrives. 0, or -errno after a message on stderr. */
int web_serve(struct web *web, const struct web_server_config *config);

#endif

#include "gateway/log.h"

#include <ctype.h>
#include <errno.h>
#include <poll.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

static atomic_int log_threshold = LOG_INFO; /* of the process, as standard error is */

void log_set_level(int severity)
{
	atomic_store(&log_threshold, severity);
}

/* $JOURNAL_STREAM names the journal's end of standard error, unless that was redirected since. */
static bool journal_reads(void)
{
	const char *stream = getenv("JOURNAL_STREAM");
	unsigned long long device, inode;
	struct stat s;

	return stream && sscanf(stream, "%llu:%llu", &device, &inode) == 2 && fstat(STDERR_FILENO, &s) == 0 &&
	       s.st_dev == device && s.st_ino == inode;
}

void log_at(int severity, const char *format, ...)
{
	char text[512];
	va_list args;

	if (severity > atomic_load(&log_threshold))
		return;
	size_t prefix = (size_t)(journal_reads() ? snprintf(text, sizeof(text), "<%d>", severity)
						 : snprintf(text, sizeof(text), "%s: ", program_invocation_short_name));
	va_start(args, format);
	int n = vsnprintf(text + prefix, sizeof(text) - prefix - 1, format, args);
	va_end(args);
	if (n < 0)
		return;
	size_t size = prefix + (size_t)n;
	if (size > sizeof(text) - 2)
		size = sizeof(text) - 2;
	for (size_t i = prefix; i < size; i++)
		if (iscntrl((unsigned char)text[i])) /* can come from a file or device name */
			text[i] = '?';
	text[size++] = '\n';
	struct pollfd room = {.fd = STDERR_FILENO, .events = POLLOUT};

	if (poll(&room, 1, 0) != 1 || !(room.revents & POLLOUT))
		return; /* a reader that does not read must not block the loop */
	if (write(STDERR_FILENO, text, size) < 0)
		return; /* no reader: no fault of the device */
}

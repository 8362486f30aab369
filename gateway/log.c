#include "gateway/log.h"

#include <ctype.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <unistd.h>

void log_line(const char *format, ...)
{
	char text[512] = "imu9-gateway: ";
	const size_t prefix = sizeof("imu9-gateway: ") - 1;
	va_list args;

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

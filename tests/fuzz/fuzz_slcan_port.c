/* The slcan driver at an adapter that sends anything, in pieces, is unplugged and comes back. No call is endless,
 * frames are valid, and what the driver writes is lines of slcan. */
#include <fcntl.h>
#include <string.h>
#include <termios.h>

#include "drivers/ports/can.h"
#include "tests/fuzz/fuzz.h"

enum { FRAMES = 2000, MS = 1000 };

static int adapter = -1;
static char folder[32] = "/tmp/imu9-fuzz.XXXXXX", path[64];

static void plug(void)
{
	struct termios raw = {0}; /* a serial line does not echo */

	adapter = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
	require(adapter >= 0 && grantpt(adapter) == 0 && unlockpt(adapter) == 0);
	unlink(path);
	cfmakeraw(&raw);
	require(tcsetattr(adapter, TCSANOW, &raw) == 0);
	require(symlink(ptsname(adapter), path) == 0);
}

static void clean_up(void)
{
	unlink(path);
	rmdir(folder);
}

static void read_lines(void)
{
	char bytes[512];
	ssize_t n = adapter >= 0 ? read(adapter, bytes, sizeof(bytes)) : 0;

	for (ssize_t i = 0; i < n; i++)
		require(strchr("\rtTrRSOCFLMmVNZzXQUW0123456789ABCDEF", bytes[i]) != NULL && bytes[i]);
}

static void receive_all(struct can_port *port, uint64_t now_us)
{
	struct can_msg msg;
	int n = 0;

	while (can_receive(port, &msg, now_us) > 0) {
		require(msg.len <= 8 && msg.id <= (msg.extended ? 0x1FFFFFFFu : 0x7FFu) && ++n < FRAMES);
		require(msg.t_us <= now_us);
	}
}

static void step(struct can_port *port, struct input *in, uint64_t *now_us)
{
	uint8_t bytes[64], kind = read_byte(in);
	struct can_msg msg = {.id = kind, .len = kind & 7, .extended = kind & 8};

	switch (kind >> 6) {
	case 0:
	case 1:
		read_bytes(in, bytes, kind & 63);
		require(adapter < 0 || write(adapter, bytes, kind & 63) <= (kind & 63));
		break;
	case 2:
		(void)can_send(port, &msg, *now_us);
		break;
	default:
		*now_us += (uint64_t)(1 << (kind & 15)) * MS;
		if ((kind & 0x30) == 0x30) {
			if (adapter >= 0)
				close(adapter);
			adapter = -1;
		} else if ((kind & 0x20) && adapter < 0) {
			plug();
		}
		break;
	}
	receive_all(port, *now_us);
	for (int calls = 1; can_service(port, *now_us) <= *now_us; calls++) /* at once: it wants to look again */
		require(calls < 3);
	can_refresh(port);
	read_lines();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	uint64_t now_us = 1000000;
	struct can_port *port;
	char bus[96], error[256];

	if (!*path) {
		require(mkdtemp(folder) != NULL);
		snprintf(path, sizeof(path), "%s/tty", folder);
		atexit(clean_up);
	}
	plug();
	snprintf(bus, sizeof(bus), "slcan:%s,bitrate=500000", path);
	require(can_open(bus, &port, error, sizeof(error)) == 0);
	while (in.size > 0)
		step(port, &in, &now_us);
	can_close(port);
	if (adapter >= 0)
		close(adapter);
	return 0;
}

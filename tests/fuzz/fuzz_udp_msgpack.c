/* Arbitrary datagrams: no byte beyond one is read, and a frame that is accepted is decoded equally after encoding. */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/can/udp_codec.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check(bool holds)
{
	if (!holds)
		abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct can_msg msg = {0}, back = {0};
	char bytes[CAN_UDP_MAX];

	if (can_udp_decode((const char *)data, size, &msg) != 0)
		return 0;
	check(msg.len <= 8 && msg.id <= (msg.extended ? 0x1FFFFFFFu : 0x7FFu));
	check(can_udp_decode(bytes, can_udp_encode(&msg, bytes), &back) == 0);
	check(back.id == msg.id && back.extended == msg.extended && back.remote == msg.remote);
	check(back.len == msg.len && memcmp(back.data, msg.data, sizeof(msg.data)) == 0);
	return 0;
}

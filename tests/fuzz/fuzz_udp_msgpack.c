/* Arbitrary datagrams: no byte beyond one is read, and a frame that is accepted is decoded equally after encoding. */
#include <string.h>

#include "drivers/can/udp_codec.h"
#include "tests/fuzz/fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct can_msg msg = {0}, back = {0};
	char bytes[CAN_UDP_MAX];

	if (can_udp_decode((const char *)data, size, &msg) != 0)
		return 0;
	require(msg.len <= 8 && msg.id <= (msg.extended ? 0x1FFFFFFFu : 0x7FFu));
	require(can_udp_decode(bytes, can_udp_encode(&msg, bytes), &back) == 0);
	require(back.id == msg.id && back.extended == msg.extended && back.remote == msg.remote);
	require(back.len == msg.len && memcmp(back.data, msg.data, sizeof(msg.data)) == 0);
	return 0;
}

/* Arbitrary bytes as the kernel's answer about a CAN interface: no byte beyond it is read. recv() is defined here. */
#include <string.h>
#include <sys/socket.h>

#include "drivers/can/can_link.h"
#include "tests/fuzz/fuzz.h"

static const uint8_t *answer;
static size_t answer_size;

ssize_t recv(int fd, void *buffer, size_t capacity, int flags)
{
	size_t size = answer_size < capacity ? answer_size : capacity;

	(void)fd, (void)flags;
	memcpy(buffer, answer, size);
	return (ssize_t)size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct can_link link;

	answer = data;
	answer_size = size;
	if (can_link_look(1, &link) == 0) {
		require(link.rate_count <= CAN_LINK_RATES);
		(void)can_link_has_rate(&link, 500000);
	}
	return 0;
}

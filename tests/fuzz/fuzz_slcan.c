/* Arbitrary bytes from a serial line: the reader stays within its buffer, and a frame it accepts is decoded equally
 * after encoding. */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/can/slcan_codec.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check(bool holds)
{
	if (!holds)
		abort();
}

static void check_frame(const struct can_msg *msg)
{
	struct slcan_reader back = {.length = 0};
	char line[SLCAN_LINE_MAX];
	size_t length = slcan_encode(msg, line);
	enum slcan_kind kind = SLCAN_NOTHING;

	check(msg->len <= 8 && msg->id <= (msg->extended ? 0x1FFFFFFFu : 0x7FFu) && length <= sizeof(line));
	for (size_t i = 0; i < length; i++) {
		check(kind == SLCAN_NOTHING);
		kind = slcan_read(&back, line[i]);
	}
	check(kind == SLCAN_FRAME && memcmp(&back.msg, msg, sizeof(*msg)) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct slcan_reader reader = {.length = 0};

	for (size_t i = 0; i < size; i++) {
		enum slcan_kind kind = slcan_read(&reader, (char)data[i]);

		check(reader.length <= sizeof(reader.line));
		if (kind == SLCAN_FRAME)
			check_frame(&reader.msg);
	}
	return 0;
}

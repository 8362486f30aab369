/* Arbitrary bytes from a serial line: the reader stays within its buffer, and a frame it accepts is decoded equally
 * after encoding. */
#include <string.h>

#include "drivers/can/slcan_codec.h"
#include "tests/fuzz/fuzz.h"

static void check_frame(const struct can_msg *msg)
{
	struct slcan_reader back = {.length = 0};
	char line[SLCAN_LINE_MAX];
	size_t length = slcan_encode(msg, line);
	enum slcan_kind kind = SLCAN_NOTHING;

	require(msg->len <= 8 && msg->id <= (msg->extended ? 0x1FFFFFFFu : 0x7FFu) && length <= sizeof(line));
	for (size_t i = 0; i < length; i++) {
		require(kind == SLCAN_NOTHING);
		kind = slcan_read(&back, line[i]);
	}
	require(kind == SLCAN_FRAME && memcmp(&back.msg, msg, sizeof(*msg)) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct slcan_reader reader = {.length = 0};

	for (size_t i = 0; i < size; i++) {
		enum slcan_kind kind = slcan_read(&reader, (char)data[i]);

		require(reader.length <= sizeof(reader.line));
		if (kind == SLCAN_FRAME)
			check_frame(&reader.msg);
	}
	return 0;
}

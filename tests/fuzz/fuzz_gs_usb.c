/* Arbitrary packets and limits: no byte beyond them is read, an accepted packet is a valid frame that encodes to the
 * same bytes, a bit timing is within the limits, a time is never in the future. */
#include <string.h>

#include "drivers/can/error_frame.h"
#include "drivers/can/gs_usb_codec.h"
#include "tests/fuzz/fuzz.h"

static void try_frame(const uint8_t *data, size_t size)
{
	static struct gs_usb_clock clock;
	static uint64_t now_us = 1000000;
	struct gs_usb_frame frame;
	uint8_t bytes[GS_USB_FRAME_LEN];

	if (gs_usb_get_frame(data, size, true, &frame) < 0)
		return;
	now_us += data[0];
	require(!frame.stamped || gs_usb_clock_map(&clock, frame.stamp_us, now_us) <= now_us);
	if (frame.kind == GS_USB_ECHO) {
		require(frame.slot < GS_USB_SLOTS);
		return;
	}
	if (frame.kind == GS_USB_ERROR) {
		struct can_port port = {.state = CAN_STATE_ACTIVE};

		can_error_frame(&port, frame.can_id, frame.msg.data);
		require(port.state <= CAN_STATE_BUS_OFF);
		return;
	}
	require(frame.msg.len <= 8 && frame.msg.id <= (frame.msg.extended ? 0x1FFFFFFFu : 0x7FFu));
	gs_usb_put_frame(&frame.msg, 0, frame.channel, bytes);
	require(bytes[8] == data[8] && bytes[9] == data[9]);
	require(frame.msg.remote || memcmp(bytes + 12, data + 12, frame.msg.len) == 0);
}

static void try_limits(const uint8_t *data, size_t size)
{
	struct gs_usb_limits limits;
	struct bit_timing t;
	const struct can_link_limits *l = &limits.timing;

	if (gs_usb_get_limits(data, size, &limits) < 0)
		return;
	if (bit_timing_find(l, limits.sjw_max, 500000, 875, &t) < 0)
		return;
	require(t.prop + t.seg1 >= l->tseg1_min && t.prop + t.seg1 <= l->tseg1_max);
	require(t.seg2 >= l->tseg2_min && t.seg2 <= l->tseg2_max);
	require(t.brp >= l->brp_min && t.brp <= l->brp_max && t.sjw >= 1);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	try_frame(data, size);
	try_limits(data, size);
	require(gs_usb_get_channels(data, size) <= 256);
	return 0;
}

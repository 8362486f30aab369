#include "drivers/can/gs_usb_codec.h"

#include <endian.h>
#include <errno.h>
#include <string.h>

enum { HOST_FORMAT = 0xBEEF };
enum { FLAG_OVERFLOW = 1 << 0, FLAG_FD = 1 << 1 };
#define ID_EXTENDED	 UINT32_C(0x80000000)
#define ID_REMOTE	 UINT32_C(0x40000000)
#define ID_ERROR	 UINT32_C(0x20000000)
#define ID_MASK		 UINT32_C(0x1FFFFFFF)
#define ID_STANDARD_MASK UINT32_C(0x7FF)
#define RECEIVED	 UINT32_C(0xFFFFFFFF) /* echo_id of a frame that another node sent */

/* Far above any controller's, and few enough to try all. */
enum { SEGMENT_MAX = 4096, BRP_MAX = 65536 };

enum { CREEP = 5000, LATE_MAX_US = 10000000 }; /* 1/5000 = 200 ppm */

static void put_u32(uint8_t *out, uint32_t value)
{
	const uint32_t le = htole32(value);

	memcpy(out, &le, sizeof(le));
}

static uint32_t get_u32(const uint8_t *in)
{
	uint32_t le;

	memcpy(&le, in, sizeof(le));
	return le32toh(le);
}

void gs_usb_put_host_format(uint8_t out[GS_USB_HOST_FORMAT_LEN])
{
	put_u32(out, HOST_FORMAT);
}

void gs_usb_put_bit_timing(const struct bit_timing *timing, uint8_t out[GS_USB_BIT_TIMING_LEN])
{
	put_u32(out, timing->prop);
	put_u32(out + 4, timing->seg1);
	put_u32(out + 8, timing->seg2);
	put_u32(out + 12, timing->sjw);
	put_u32(out + 16, timing->brp);
}

void gs_usb_put_mode(uint32_t mode, uint32_t flags, uint8_t out[GS_USB_MODE_LEN])
{
	put_u32(out, mode);
	put_u32(out + 4, flags);
}

void gs_usb_put_frame(const struct can_msg *msg, uint32_t slot, uint8_t channel, uint8_t out[GS_USB_FRAME_LEN])
{
	memset(out, 0, GS_USB_FRAME_LEN);
	put_u32(out, slot);
	put_u32(out + 4, msg->id | (msg->extended ? ID_EXTENDED : 0) | (msg->remote ? ID_REMOTE : 0));
	out[8] = msg->len;
	out[9] = channel;
	if (!msg->remote)
		memcpy(out + 12, msg->data, msg->len);
}

static bool is_range(uint32_t low, uint32_t high, uint32_t most)
{
	return low > 0 && low <= high && high <= most;
}

int gs_usb_get_limits(const uint8_t *in, size_t size, struct gs_usb_limits *limits)
{
	struct can_link_limits *t = &limits->timing;

	if (size < GS_USB_LIMITS_LEN)
		return -EBADMSG;
	limits->features = get_u32(in);
	t->clock_hz = get_u32(in + 4);
	t->tseg1_min = get_u32(in + 8);
	t->tseg1_max = get_u32(in + 12);
	t->tseg2_min = get_u32(in + 16);
	t->tseg2_max = get_u32(in + 20);
	limits->sjw_max = get_u32(in + 24);
	t->brp_min = get_u32(in + 28);
	t->brp_max = get_u32(in + 32);
	t->brp_inc = get_u32(in + 36);
	if (t->clock_hz == 0 || !is_range(t->tseg1_min, t->tseg1_max, SEGMENT_MAX) ||
		!is_range(t->tseg2_min, t->tseg2_max, SEGMENT_MAX) || !is_range(t->brp_min, t->brp_max, BRP_MAX))
		return -EBADMSG;
	return 0;
}

int gs_usb_get_channels(const uint8_t *in, size_t size)
{
	return size < GS_USB_CONFIG_LEN ? -EBADMSG : in[3] + 1;
}

int gs_usb_get_frame(const uint8_t *in, size_t size, bool stamped, struct gs_usb_frame *frame)
{
	if (size < GS_USB_FRAME_LEN)
		return -EBADMSG;
	memset(frame, 0, sizeof(*frame));
	frame->slot = get_u32(in);
	frame->can_id = get_u32(in + 4);
	frame->channel = in[9];
	frame->overflow = (in[10] & FLAG_OVERFLOW) != 0;
	frame->stamped = stamped && size >= GS_USB_FRAME_STAMPED_LEN;
	if (frame->stamped)
		frame->stamp_us = get_u32(in + GS_USB_FRAME_LEN);
	if (frame->slot != RECEIVED) {
		frame->kind = GS_USB_ECHO;
		return frame->slot < GS_USB_SLOTS ? 0 : -EBADMSG;
	}
	if ((in[10] & FLAG_FD) != 0)
		return -ENOTSUP;
	if (in[8] > 8)
		return -EBADMSG;
	frame->kind = (frame->can_id & ID_ERROR) != 0 ? GS_USB_ERROR : GS_USB_RECEIVED;
	frame->msg.extended = (frame->can_id & ID_EXTENDED) != 0;
	frame->msg.remote = (frame->can_id & ID_REMOTE) != 0;
	frame->msg.id = frame->can_id & (frame->msg.extended ? ID_MASK : ID_STANDARD_MASK);
	frame->msg.len = in[8];
	if (!frame->msg.remote)
		memcpy(frame->msg.data, in + 12, frame->msg.len);
	return 0;
}

static uint64_t start(struct gs_usb_clock *clock, uint32_t stamp_us, uint64_t now_us)
{
	clock->running = true;
	clock->last_stamp_us = stamp_us;
	clock->crept_at_us = now_us;
	clock->mapped_us = now_us;
	return now_us;
}

/* With the previous offset, the frame was on the bus at mapped_us + step_us. */
uint64_t gs_usb_clock_map(struct gs_usb_clock *clock, uint32_t stamp_us, uint64_t now_us)
{
	int32_t step_us = (int32_t)(stamp_us - clock->last_stamp_us);
	uint64_t creep_us = (now_us - clock->crept_at_us) / CREEP;

	if (!clock->running)
		return start(clock, stamp_us, now_us);
	clock->last_stamp_us = stamp_us;
	clock->crept_at_us += creep_us * CREEP;
	clock->mapped_us += (uint64_t)(int64_t)step_us + creep_us;
	if (clock->mapped_us > now_us || now_us - clock->mapped_us > LATE_MAX_US)
		return start(clock, stamp_us, now_us);
	return clock->mapped_us;
}

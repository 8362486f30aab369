/* drivers/can/gs_usb_codec.h
 * The gs_usb protocol's bytes (candleLight and kin): little-endian on the wire. Pure: no USB, no clock, no heap. */
#ifndef DRIVERS_CAN_GS_USB_CODEC_H
#define DRIVERS_CAN_GS_USB_CODEC_H

#include "drivers/can/gs_usb_timing.h"
#include "drivers/ports/can.h"

/* Vendor requests to the interface. wValue is the channel, but 1 in HOST_FORMAT and CONFIG. */
enum gs_usb_request {
	GS_USB_HOST_FORMAT = 0,
	GS_USB_BIT_TIMING = 1,
	GS_USB_MODE = 2,
	GS_USB_LIMITS = 4, /* "BT_CONST" */
	GS_USB_CONFIG = 5,
};

enum { GS_USB_FEATURE_LISTEN_ONLY = 1 << 0, GS_USB_FEATURE_TIMESTAMP = 1 << 4 }; /* the same bits as mode flags */
enum { GS_USB_MODE_RESET = 0, GS_USB_MODE_START = 1 };

/* Lengths [bytes]. */
enum {
	GS_USB_HOST_FORMAT_LEN = 4,
	GS_USB_BIT_TIMING_LEN = 20,
	GS_USB_MODE_LEN = 8,
	GS_USB_LIMITS_LEN = 40,
	GS_USB_CONFIG_LEN = 12,
	GS_USB_FRAME_LEN = 20,
	GS_USB_FRAME_STAMPED_LEN = 24,
};

enum { GS_USB_SLOTS = 10 }; /* frames an adapter accepts before it has echoed the first */

struct gs_usb_limits {
	uint32_t features;
	uint32_t sjw_max;
	struct can_link_limits timing;
};

enum gs_usb_kind {
	GS_USB_RECEIVED, /* `msg` */
	GS_USB_ECHO,	 /* the frame sent from `slot` is on the bus */
	GS_USB_ERROR,	 /* `can_id` and `msg.data` as in SocketCAN's error frames */
};

struct gs_usb_frame {
	enum gs_usb_kind kind;
	uint8_t channel;
	uint32_t slot; /* below GS_USB_SLOTS */
	uint32_t can_id;
	bool overflow; /* the adapter lost frames before this one */
	bool stamped;
	uint32_t stamp_us; /* the adapter's clock */
	struct can_msg msg;
};

void gs_usb_put_host_format(uint8_t out[GS_USB_HOST_FORMAT_LEN]);
void gs_usb_put_bit_timing(const struct bit_timing *timing, uint8_t out[GS_USB_BIT_TIMING_LEN]);
void gs_usb_put_mode(uint32_t mode, uint32_t flags, uint8_t out[GS_USB_MODE_LEN]);
void gs_usb_put_frame(const struct can_msg *msg, uint32_t slot, uint8_t channel, uint8_t out[GS_USB_FRAME_LEN]);

/** 0; -EBADMSG: too short, or limits that no controller can have. */
int gs_usb_get_limits(const uint8_t *in, size_t size, struct gs_usb_limits *limits);
/** The number of channels, or -EBADMSG. */
int gs_usb_get_channels(const uint8_t *in, size_t size);
/** One packet is one frame; the rest of it is padding. 0; -EBADMSG: too short, too long a DLC, an echo of a slot that
 * does not exist; -ENOTSUP: CAN FD. */
int gs_usb_get_frame(const uint8_t *in, size_t size, bool stamped, struct gs_usb_frame *frame);

/** Maps the adapter's 32-bit microsecond clock to CLOCK_MONOTONIC. No frame arrives before it was on the bus, and the
 * fastest one has hardly any delay: the offset between the clocks is the smallest seen. It increases by 200 ppm, more
 * than two crystals differ, so that a drift in either direction is followed. */
struct gs_usb_clock {
	bool running;
	uint32_t last_stamp_us;
	uint64_t mapped_us;   /* last_stamp_us in CLOCK_MONOTONIC */
	uint64_t crept_at_us; /* when the offset was increased last */
};

/** The time of the stamp on the clock of now_us, never after now_us. When it would be more than 10 s before now_us (no
 * frame for 35 minutes, an adapter that was reset), the mapping is re-initialised with now_us. */
uint64_t gs_usb_clock_map(struct gs_usb_clock *clock, uint32_t stamp_us, uint64_t now_us);

#endif

#include "drivers/can/gs_usb.h"

#include <errno.h>
#include <fcntl.h>
#include <libusb-1.0/libusb.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "drivers/can/bus_options.h"
#include "drivers/can/error_frame.h"
#include "drivers/can/gs_usb_codec.h"
#include "drivers/can/gs_usb_find.h"
#include "drivers/can/id_filter.h"
#include "drivers/can/more.h"

enum {
	PACKETS = 32,	  /* IN transfers submitted at once: 7 ms of a full bus at 500 kbit/s */
	PACKET_MAX = 512, /* of a high-speed bulk endpoint */
	PACKETS_PER_CALL = 2 * PACKETS,
	CONTROL_TIMEOUT_MS = 500,
	CONTROL_TRIES = 4, /* of a request that a slow adapter does not answer in time */
	OPEN_TIMEOUT_MS = 4000,
	CLOSE_TIMEOUT_MS = 1000,
	LOOK_AGAIN_US = 500000,
	STUCK_US = 2000000, /* doubles with each restart in vain */
	STUCK_DOUBLINGS_MAX = 5,
	STUCK_TOLD = 3,
	STUCK_RESET = 5, /* every fifth time the whole USB device is reset instead */
};
#define SYSFS "/sys/bus/usb/devices"

/* Setting up the adapter: one control transfer each, in this order. */
enum step {
	STEP_HOST_FORMAT,
	STEP_CONFIG,
	STEP_LIMITS,
	STEP_KNOWN, /* no transfer: waits for the first service() */
	STEP_RESET, /* a restart starts here */
	STEP_TIMING,
	STEP_START,
	STEP_RUNNING,
};

struct packet {
	struct gs_usb *can;
	struct libusb_transfer *transfer;
	bool idle; /* neither submitted to libusb nor in `done` */
	uint8_t bytes[PACKET_MAX];
};

/* A frame being sent. Free again when its transfer has completed and its echo has arrived. */
struct slot {
	struct gs_usb *can;
	struct libusb_transfer *transfer;
	bool on_usb, on_bus;
	uint8_t bytes[GS_USB_FRAME_LEN];
};

/* A reset of the USB device, as if it had been unplugged. It can take a second, so it has a thread. */
struct usb_reset {
	bool wanted; /* when the handle is closed */
	bool started;
	pthread_t thread;
	_Atomic bool ended;
	char node[GS_USB_TEXT];
};

struct gs_usb {
	struct can_port port; /* port.fd is an epoll descriptor over libusb's, and `more` */
	struct more more;
	libusb_context *usb;

	char wanted[GS_USB_TEXT]; /* serial number or place */
	uint8_t channel;
	uint32_t sample_point_permille; /* 0: chosen by the bit rate */
	bool listen_only;

	libusb_device_handle *handle; /* NULL: unplugged */
	int node;		      /* descriptor of the handle */
	struct usb_reset reset;
	bool lost; /* close the handle and search for the adapter */
	bool cancelled;
	uint8_t interface, in, out;
	int packet_size;
	struct gs_usb_limits limits;

	enum step step;
	bool restart;	   /* continue with STEP_RESET after the control transfer in progress */
	bool asking;	   /* a control transfer is in progress */
	int answer;	   /* -errno of the last step that failed */
	unsigned timeouts; /* of this step */
	struct libusb_transfer *control;
	uint8_t control_bytes[LIBUSB_CONTROL_SETUP_SIZE + GS_USB_LIMITS_LEN];

	struct packet packets[PACKETS];
	struct packet *done[PACKETS]; /* a ring, oldest first */
	size_t done_head, done_count;
	struct slot slots[GS_USB_SLOTS];
	int pending; /* transfers submitted to libusb */

	struct id_filter filter;
	struct gs_usb_clock clock;
	uint64_t look_at_us;	/* search for the adapter next at */
	unsigned restarts;	/* since the last echo */
	uint64_t full_since_us; /* since when all slots are in use without an echo; 0: they are not */
};

static struct gs_usb *of(struct can_port *port)
{
	return (struct gs_usb *)(void *)port;
}

static int errno_of(int usb_error)
{
	switch (usb_error) {
	case LIBUSB_ERROR_ACCESS:
		return -EACCES;
	case LIBUSB_ERROR_BUSY:
		return -EBUSY;
	case LIBUSB_ERROR_NO_DEVICE:
	case LIBUSB_ERROR_NOT_FOUND:
		return -ENODEV;
	case LIBUSB_ERROR_NO_MEM:
		return -ENOMEM;
	default:
		return -EIO;
	}
}

/* ---- libusb's descriptors in the port's -------------------------------------------------------------------------- */

static void LIBUSB_CALL add_descriptor(int fd, short events, void *user_data)
{
	const struct gs_usb *can = user_data;
	struct epoll_event event = {
		.events = ((events & POLLIN) ? EPOLLIN : 0u) | ((events & POLLOUT) ? EPOLLOUT : 0u), .data.fd = fd};

	(void)epoll_ctl(can->port.fd, EPOLL_CTL_ADD, fd, &event);
}

static void LIBUSB_CALL remove_descriptor(int fd, void *user_data)
{
	const struct gs_usb *can = user_data;

	(void)epoll_ctl(can->port.fd, EPOLL_CTL_DEL, fd, NULL);
}

static int watch_descriptors(struct gs_usb *can)
{
	const struct libusb_pollfd **list;
	int result = more_open(&can->more, &can->port.fd);

	if (result < 0)
		return result;
	libusb_set_pollfd_notifiers(can->usb, add_descriptor, remove_descriptor, can);
	list = libusb_get_pollfds(can->usb);
	if (list == NULL)
		return -ENOMEM;
	for (size_t i = 0; list[i] != NULL; i++)
		add_descriptor(list[i]->fd, list[i]->events, can);
	libusb_free_pollfds(list);
	return 0;
}

static void wait_for_events(struct gs_usb *can, long ms)
{
	struct timeval time = {.tv_usec = ms * 1000};

	(void)libusb_handle_events_timeout_completed(can->usb, &time, NULL);
}

/* ---- transfers --------------------------------------------------------------------------------------------------- */

static bool submit(struct gs_usb *can, struct libusb_transfer *transfer)
{
	if (can->lost || libusb_submit_transfer(transfer) != 0) {
		can->lost = true;
		return false;
	}
	can->pending++;
	return true;
}

static void LIBUSB_CALL on_packet(struct libusb_transfer *transfer)
{
	struct packet *packet = transfer->user_data;
	struct gs_usb *can = packet->can;

	can->pending--;
	if (transfer->status == LIBUSB_TRANSFER_COMPLETED || transfer->status == LIBUSB_TRANSFER_OVERFLOW) {
		if (transfer->status == LIBUSB_TRANSFER_OVERFLOW) {
			can->port.counters.rx_dropped++;
			transfer->actual_length = 0;
		}
		can->done[(can->done_head + can->done_count++) % PACKETS] = packet;
		return;
	}
	packet->idle = true;
	can->lost = true;
}

static void LIBUSB_CALL on_sent(struct libusb_transfer *transfer)
{
	struct slot *slot = transfer->user_data;

	slot->can->pending--;
	slot->on_usb = false;
	if (transfer->status != LIBUSB_TRANSFER_COMPLETED)
		slot->can->lost = true;
}

static void await_packet(struct gs_usb *can, struct packet *packet)
{
	packet->idle = !submit(can, packet->transfer);
}

static void await_packets(struct gs_usb *can)
{
	for (size_t i = 0; i < PACKETS; i++)
		if (can->packets[i].idle)
			await_packet(can, &can->packets[i]);
}

/* The frames that the adapter has not sent are lost when it is unplugged or restarted. */
static void free_slots(struct gs_usb *can)
{
	for (size_t i = 0; i < GS_USB_SLOTS; i++) {
		if (can->slots[i].on_bus)
			can->port.counters.tx_dropped++;
		can->slots[i].on_bus = false;
	}
	can->full_since_us = 0;
}

/* ---- setting the adapter up -------------------------------------------------------------------------------------- */

static uint32_t mode_flags(const struct gs_usb *can)
{
	return (can->limits.features & GS_USB_FEATURE_TIMESTAMP) |
	       (can->listen_only ? (uint32_t)GS_USB_FEATURE_LISTEN_ONLY : 0);
}

static int find_timing(const struct gs_usb *can, uint32_t bit_s, struct bit_timing *timing)
{
	uint32_t permille = can->sample_point_permille ? can->sample_point_permille : bit_timing_sample_point(bit_s);

	return bit_timing_find(&can->limits.timing, can->limits.sjw_max, bit_s, permille, timing);
}

/* Evaluates the answer to the current step. */
static int evaluate_answer(struct gs_usb *can, const uint8_t *data, size_t size)
{
	struct bit_timing timing;
	int result = 0;

	switch (can->step) {
	case STEP_CONFIG:
		result = gs_usb_get_channels(data, size);
		return result < 0 ? result : can->channel >= result ? -ECHRNG : 0;
	case STEP_LIMITS:
		result = gs_usb_get_limits(data, size, &can->limits);
		if (result == 0)
			result = find_timing(can, can->port.bit_s, &timing);
		if (result == 0 && can->listen_only && !(can->limits.features & GS_USB_FEATURE_LISTEN_ONLY))
			result = -EOPNOTSUPP;
		return result;
	case STEP_RESET:
		free_slots(can);
		return 0;
	case STEP_START:
		can->port.state = CAN_STATE_ACTIVE;
		can->port.retry_at_us = 0;
		return 0;
	default:
		return 0;
	}
}

static void LIBUSB_CALL on_answer(struct libusb_transfer *transfer)
{
	struct gs_usb *can = transfer->user_data;

	can->pending--;
	can->asking = false;
	if (transfer->status == LIBUSB_TRANSFER_TIMED_OUT && ++can->timeouts < CONTROL_TRIES)
		return; /* it is requested again */
	can->timeouts = 0;
	can->answer = transfer->status == LIBUSB_TRANSFER_COMPLETED
			      ? evaluate_answer(can, libusb_control_transfer_get_data(transfer),
					(size_t)transfer->actual_length)
			      : -EIO;
	if (can->answer < 0) {
		can->lost = true;
		return;
	}
	can->step = can->restart ? STEP_RESET : can->step + 1;
	can->restart = false;
}

static void ask(struct gs_usb *can, enum gs_usb_request request, uint16_t value, size_t length, bool in)
{
	uint8_t type = (uint8_t)((in ? LIBUSB_ENDPOINT_IN : LIBUSB_ENDPOINT_OUT) | LIBUSB_REQUEST_TYPE_VENDOR |
				 LIBUSB_RECIPIENT_INTERFACE);

	libusb_fill_control_setup(can->control_bytes, type, (uint8_t)request, value, can->interface, (uint16_t)length);
	libusb_fill_control_transfer(can->control, can->handle, can->control_bytes, on_answer, can, CONTROL_TIMEOUT_MS);
	can->asking = submit(can, can->control);
}

static void request_step(struct gs_usb *can)
{
	uint8_t *data = can->control_bytes + LIBUSB_CONTROL_SETUP_SIZE;
	struct bit_timing timing = {0};

	switch (can->step) {
	case STEP_HOST_FORMAT:
		gs_usb_put_host_format(data);
		ask(can, GS_USB_HOST_FORMAT, 1, GS_USB_HOST_FORMAT_LEN, false);
		break;
	case STEP_CONFIG:
		ask(can, GS_USB_CONFIG, 1, GS_USB_CONFIG_LEN, true);
		break;
	case STEP_LIMITS:
		ask(can, GS_USB_LIMITS, can->channel, GS_USB_LIMITS_LEN, true);
		break;
	case STEP_RESET:
		gs_usb_put_mode(GS_USB_MODE_RESET, 0, data);
		ask(can, GS_USB_MODE, can->channel, GS_USB_MODE_LEN, false);
		break;
	case STEP_TIMING:
		(void)find_timing(can, can->port.bit_s, &timing); /* cannot fail: checked before */
		gs_usb_put_bit_timing(&timing, data);
		ask(can, GS_USB_BIT_TIMING, can->channel, GS_USB_BIT_TIMING_LEN, false);
		break;
	case STEP_START:
		await_packets(can);
		gs_usb_put_mode(GS_USB_MODE_START, mode_flags(can), data);
		ask(can, GS_USB_MODE, can->channel, GS_USB_MODE_LEN, false);
		break;
	case STEP_KNOWN:
	case STEP_RUNNING:
		break;
	}
}

static void restart(struct gs_usb *can)
{
	if (can->asking)
		can->restart = true;
	else
		can->step = STEP_RESET;
}

/* ---- attaching and detaching ------------------------------------------------------------------------------------- */

/* The CAN interface has a bulk endpoint in each direction; candleLight has another one for firmware updates. */
static bool use_interface(struct gs_usb *can, const struct libusb_interface_descriptor *interface)
{
	bool in = false, out = false;

	if (interface->bInterfaceClass != LIBUSB_CLASS_VENDOR_SPEC)
		return false;
	for (int i = 0; i < interface->bNumEndpoints; i++) {
		const struct libusb_endpoint_descriptor *e = &interface->endpoint[i];

		if ((e->bmAttributes & LIBUSB_TRANSFER_TYPE_MASK) != LIBUSB_TRANSFER_TYPE_BULK)
			continue;
		if ((e->bEndpointAddress & LIBUSB_ENDPOINT_DIR_MASK) == LIBUSB_ENDPOINT_OUT) {
			can->out = e->bEndpointAddress;
			out = true;
		} else if (e->wMaxPacketSize >= GS_USB_FRAME_STAMPED_LEN && e->wMaxPacketSize <= PACKET_MAX) {
			can->in = e->bEndpointAddress;
			can->packet_size = e->wMaxPacketSize;
			in = true;
		}
	}
	can->interface = interface->bInterfaceNumber;
	return in && out;
}

static int find_interface(struct gs_usb *can)
{
	struct libusb_config_descriptor *config;
	bool found = false;
	int result = libusb_get_active_config_descriptor(libusb_get_device(can->handle), &config);

	if (result < 0)
		return errno_of(result);
	for (int i = 0; i < config->bNumInterfaces && !found; i++)
		if (config->interface[i].num_altsetting > 0)
			found = use_interface(can, &config->interface[i].altsetting[0]);
	libusb_free_config_descriptor(config);
	return found ? 0 : -EPROTO;
}

static void fill_transfers(struct gs_usb *can)
{
	for (size_t i = 0; i < PACKETS; i++) {
		struct packet *p = &can->packets[i];

		libusb_fill_bulk_transfer(
			p->transfer, can->handle, can->in, p->bytes, can->packet_size, on_packet, p, 0);
		p->idle = true;
	}
	for (size_t i = 0; i < GS_USB_SLOTS; i++) {
		struct slot *s = &can->slots[i];

		libusb_fill_bulk_transfer(
			s->transfer, can->handle, can->out, s->bytes, sizeof(s->bytes), on_sent, s, 0);
	}
}

static void close_handle(struct gs_usb *can)
{
	if (can->handle != NULL) {
		(void)libusb_release_interface(can->handle, can->interface); /* the kernel's driver is attached again */
		libusb_close(can->handle);
		can->handle = NULL;
	}
	if (can->node >= 0)
		close(can->node);
	can->node = -1;
}

static int claim(struct gs_usb *can)
{
	int result = find_interface(can);

	if (result < 0)
		return result;
	(void)libusb_set_auto_detach_kernel_driver(can->handle, 1);
	result = libusb_claim_interface(can->handle, can->interface);
	return result < 0 ? errno_of(result) : 0;
}

/* Opens the wanted adapter; its set-up starts with STEP_HOST_FORMAT. */
static int attach(struct gs_usb *can, struct gs_usb_adapter *adapter, char *error, size_t error_size)
{
	struct gs_usb_adapter list[GS_USB_ADAPTERS];
	int result = gs_usb_choose(list, gs_usb_list(SYSFS, list), can->wanted, adapter, error, error_size);

	if (result < 0)
		return result;
	can->node = open(adapter->node, O_RDWR | O_CLOEXEC);
	if (can->node < 0)
		return -errno;
	result = libusb_wrap_sys_device(can->usb, can->node, &can->handle);
	result = result < 0 ? errno_of(result) : claim(can);
	if (result < 0) {
		close_handle(can);
		return result;
	}
	fill_transfers(can);
	memcpy(can->reset.node, adapter->node, sizeof(can->reset.node));
	can->step = STEP_HOST_FORMAT;
	can->lost = can->cancelled = can->restart = false;
	can->done_count = 0;
	can->clock = (struct gs_usb_clock){0};
	return 0;
}

static void *usb_reset_main(void *arg)
{
	struct usb_reset *reset = arg;
	int fd = open(reset->node, O_WRONLY | O_CLOEXEC);

	if (fd >= 0) {
		(void)ioctl(fd, USBDEVFS_RESET, NULL);
		close(fd);
	}
	atomic_store(&reset->ended, true);
	return NULL;
}

static void start_usb_reset(struct usb_reset *reset)
{
	reset->wanted = false;
	atomic_store(&reset->ended, false);
	reset->started = pthread_create(&reset->thread, NULL, usb_reset_main, reset) == 0;
}

static void end_usb_reset(struct usb_reset *reset)
{
	if (reset->started)
		pthread_join(reset->thread, NULL);
	reset->started = false;
}

static void cancel(struct gs_usb *can)
{
	(void)libusb_cancel_transfer(can->control);
	for (size_t i = 0; i < PACKETS; i++)
		(void)libusb_cancel_transfer(can->packets[i].transfer);
	for (size_t i = 0; i < GS_USB_SLOTS; i++)
		(void)libusb_cancel_transfer(can->slots[i].transfer);
	can->cancelled = true;
}

/* Cancels the transfers, and closes the handle when libusb has returned all of them. */
static void detach(struct gs_usb *can)
{
	can->port.state = CAN_STATE_DOWN;
	can->port.down_why = "unplugged, or it has failed: plug the adapter in, it is searched for";
	if (!can->cancelled) {
		free_slots(can);
		cancel(can);
	}
	if (can->pending > 0)
		return;
	close_handle(can);
	if (can->reset.wanted)
		start_usb_reset(&can->reset);
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static int gs_usb_send(struct can_port *port, const struct can_msg *msg)
{
	struct gs_usb *can = of(port);

	if (can->listen_only)
		return -EPERM;
	if (port->state == CAN_STATE_DOWN || can->lost)
		return -ENETDOWN;
	if (can->step != STEP_RUNNING || port->state == CAN_STATE_BUS_OFF)
		return -EAGAIN;
	for (uint32_t i = 0; i < GS_USB_SLOTS; i++) {
		struct slot *slot = &can->slots[i];

		if (slot->on_usb || slot->on_bus)
			continue;
		gs_usb_put_frame(msg, i, can->channel, slot->bytes);
		slot->on_usb = slot->on_bus = submit(can, slot->transfer);
		return slot->on_usb ? 0 : -ENETDOWN;
	}
	return -ENOBUFS;
}

static void handle_echo(struct gs_usb *can, uint32_t slot)
{
	if (!can->slots[slot].on_bus) {
		can->port.counters.rx_dropped++; /* no such frame was sent */
		return;
	}
	can->slots[slot].on_bus = false;
	can->port.retry_at_us = 0; /* a slot is free: no back-off */
	can->full_since_us = 0;
	can->restarts = 0;
}

/* True: *msg is a received frame. */
static bool handle_packet(struct gs_usb *can, const struct packet *packet, struct can_msg *msg, uint64_t now_us)
{
	struct gs_usb_frame frame;
	size_t size = (size_t)packet->transfer->actual_length;
	bool stamped = (can->limits.features & GS_USB_FEATURE_TIMESTAMP) != 0;

	if (size == 0)
		return false;
	if (gs_usb_get_frame(packet->bytes, size, stamped, &frame) < 0 || frame.channel != can->channel) {
		can->port.counters.rx_dropped++;
		return false;
	}
	if (frame.overflow)
		can->port.counters.rx_dropped++;
	if (frame.kind == GS_USB_ECHO)
		handle_echo(can, frame.slot);
	else if (frame.kind == GS_USB_ERROR)
		can_error_frame(&can->port, frame.can_id, frame.msg.data);
	if (frame.kind != GS_USB_RECEIVED)
		return false;
	*msg = frame.msg;
	msg->t_us = frame.stamped ? gs_usb_clock_map(&can->clock, frame.stamp_us, now_us) : now_us;
	return id_filter_wants(&can->filter, msg);
}

static int gs_usb_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	struct gs_usb *can = of(port);
	bool received = false;

	for (int i = 0; i < PACKETS_PER_CALL && !received; i++) {
		if (can->done_count == 0)
			wait_for_events(can, 0);
		if (can->done_count == 0)
			break;
		struct packet *packet = can->done[can->done_head];

		can->done_head = (can->done_head + 1) % PACKETS;
		can->done_count--;
		received = port->state != CAN_STATE_DOWN && handle_packet(can, packet, msg, now_us);
		await_packet(can, packet);
	}
	more_set(&can->more, can->done_count > 0);
	return received;
}

static int gs_usb_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	id_filter_set(&of(port)->filter, ids, n);
	return 0;
}

/* An adapter that has echoed none of ten frames for a while is restarted: it hangs, or nobody acknowledges frames. */
static uint64_t watch_echoes(struct gs_usb *can, uint64_t now_us)
{
	uint64_t stuck_us = (uint64_t)STUCK_US
			    << (can->restarts < STUCK_DOUBLINGS_MAX ? can->restarts : STUCK_DOUBLINGS_MAX);

	for (size_t i = 0; i < GS_USB_SLOTS; i++)
		if (!can->slots[i].on_bus)
			return UINT64_MAX;
	if (can->port.state == CAN_STATE_BUS_OFF || can->step != STEP_RUNNING)
		return UINT64_MAX;
	if (can->full_since_us == 0)
		can->full_since_us = now_us;
	if (now_us - can->full_since_us < stuck_us)
		return can->full_since_us + stuck_us;
	if (++can->restarts == STUCK_TOLD)
		can->port.notice = "the adapter sends nothing, restarts do not help: if cable, termination and the "
				   "other nodes are right, unplug it and plug it in again";
	if (can->restarts % STUCK_RESET == 0)
		can->lost = can->reset.wanted = true;
	else
		restart(can);
	return can->lost ? now_us : UINT64_MAX;
}

static uint64_t search_adapter(struct gs_usb *can, uint64_t now_us)
{
	struct gs_usb_adapter adapter;
	char error[300];

	if (now_us < can->look_at_us)
		return can->look_at_us;
	can->look_at_us = now_us + LOOK_AGAIN_US;
	if (can->reset.started && !atomic_load(&can->reset.ended))
		return can->look_at_us;
	end_usb_reset(&can->reset);
	return attach(can, &adapter, error, sizeof(error)) < 0 ? can->look_at_us : now_us;
}

static uint64_t gs_usb_service(struct can_port *port, uint64_t now_us)
{
	struct gs_usb *can = of(port);
	uint64_t next_us = UINT64_MAX;

	if (can->handle != NULL && can->lost)
		detach(can);
	if (can->handle == NULL)
		next_us = search_adapter(can, now_us);
	if (can->handle == NULL || can->lost)
		return next_us;
	next_us = watch_echoes(can, now_us);
	if (can->step == STEP_KNOWN)
		can->step = STEP_RESET;
	if (!can->asking)
		request_step(can);
	return next_us;
}

static int gs_usb_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	struct gs_usb *can = of(port);
	struct bit_timing timing;

	if (find_timing(can, bit_s, &timing) < 0)
		return -EOPNOTSUPP;
	if (dry_run || port->bit_s == bit_s)
		return 0;
	port->bit_s = bit_s;
	if (can->step > STEP_KNOWN)
		restart(can);
	return 0;
}

static int gs_usb_restart(struct can_port *port)
{
	struct gs_usb *can = of(port);

	if (can->step != STEP_RUNNING)
		return 0; /* a restart is in progress */
	restart(can);
	return 0;
}

static void leave_bus(struct gs_usb *can)
{
	uint8_t mode[GS_USB_MODE_LEN];

	gs_usb_put_mode(GS_USB_MODE_RESET, 0, mode);
	(void)libusb_control_transfer(can->handle,
		LIBUSB_ENDPOINT_OUT | LIBUSB_REQUEST_TYPE_VENDOR | LIBUSB_RECIPIENT_INTERFACE, GS_USB_MODE,
		can->channel, can->interface, mode, sizeof(mode), CONTROL_TIMEOUT_MS);
}

static void gs_usb_close(struct can_port *port)
{
	struct gs_usb *can = of(port);

	can->reset.wanted = false;
	end_usb_reset(&can->reset);
	if (can->handle != NULL) {
		if (!can->lost)
			leave_bus(can);
		can->lost = true;
		for (int ms = 0; can->handle != NULL && ms < CLOSE_TIMEOUT_MS; ms += 10) {
			detach(can);
			if (can->handle != NULL)
				wait_for_events(can, 10);
		}
		if (can->handle != NULL)
			return; /* libusb still uses the transfers: they must not be freed */
	}
	if (can->usb != NULL) {
		libusb_free_transfer(can->control);
		for (size_t i = 0; i < PACKETS; i++)
			libusb_free_transfer(can->packets[i].transfer);
		for (size_t i = 0; i < GS_USB_SLOTS; i++)
			libusb_free_transfer(can->slots[i].transfer);
		libusb_exit(can->usb);
	}
	more_close(&can->more, port->fd);
	free(can);
}

static const struct can_ops gs_usb_ops = {
	.send = gs_usb_send,
	.receive = gs_usb_receive,
	.filter = gs_usb_filter,
	.service = gs_usb_service,
	.bit_rate = gs_usb_bit_rate,
	.restart = gs_usb_restart,
	.close = gs_usb_close,
};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static bool allocate_transfers(struct gs_usb *can)
{
	bool all = (can->control = libusb_alloc_transfer(0)) != NULL;

	for (size_t i = 0; i < PACKETS; i++) {
		can->packets[i].can = can;
		all &= (can->packets[i].transfer = libusb_alloc_transfer(0)) != NULL;
	}
	for (size_t i = 0; i < GS_USB_SLOTS; i++) {
		can->slots[i].can = can;
		all &= (can->slots[i].transfer = libusb_alloc_transfer(0)) != NULL;
	}
	return all;
}

/* [SERIAL[:CHANNEL]] */
static bool parse(struct gs_usb *can, char *address)
{
	char *colon = strrchr(address, ':'), *end;

	if (colon != NULL) {
		unsigned long channel = strtoul(colon + 1, &end, 10);

		if (end == colon + 1 || *end != '\0' || channel > UINT8_MAX)
			return false;
		can->channel = (uint8_t)channel;
		*colon = '\0';
	}
	if (strlen(address) >= sizeof(can->wanted))
		return false;
	strcpy(can->wanted, address);
	return true;
}

static void explain(
	int result, const struct gs_usb *can, const struct gs_usb_adapter *adapter, char *error, size_t error_size)
{
	const char *name = gs_usb_name(adapter);

	switch (result) {
	case -EACCES:
		snprintf(error, error_size,
			"no permission to use the adapter %s (%s): install the udev rule 70-imu9-gateway.rules "
			"(`make install`, then plug the adapter in again), or run as root",
			name, adapter->node);
		break;
	case -EBUSY:
		snprintf(error, error_size,
			"another program uses the adapter %s (with all its channels): stop it, or use another adapter "
			"(gs_usb:SERIAL)",
			name);
		break;
	case -ECHRNG:
		snprintf(error, error_size, "the adapter %s has no channel %u: channels count from 0", name,
			can->channel);
		break;
	case -EOPNOTSUPP:
		snprintf(error, error_size,
			"the adapter %s does not support %u bit/s%s: use another bit rate (bitrate=B)", name,
			can->port.bit_s, can->listen_only ? " in listen-only mode" : "");
		break;
	default:
		snprintf(error, error_size, "the adapter %s (%s) failed: %s: plug it in again, or try another USB port",
			name, adapter->node, strerror(-result));
	}
}

/* Reads the adapter's properties. */
static int identify(struct gs_usb *can)
{
	for (int ms = 0; ms < OPEN_TIMEOUT_MS && can->step != STEP_KNOWN && !can->lost; ms += 10) {
		if (!can->asking)
			request_step(can);
		wait_for_events(can, 10);
	}
	if (can->step == STEP_KNOWN)
		return 0;
	return can->answer < 0 ? can->answer : -ETIMEDOUT;
}

static int set_up(struct gs_usb *can, char *error, size_t error_size)
{
	struct gs_usb_adapter adapter = {0};
	int result;

	/* gs_usb_find.c does it without a thread or udev */
	if (libusb_set_option(NULL, LIBUSB_OPTION_NO_DEVICE_DISCOVERY) != 0) {
		snprintf(error, error_size, "gs_usb: libusb is missing: apt install libusb-1.0-0");
		return -ELIBACC;
	}
	result = libusb_init(&can->usb);
	result = result < 0 ? errno_of(result) : watch_descriptors(can);
	if (result == 0)
		result = allocate_transfers(can) ? attach(can, &adapter, error, error_size) : -ENOMEM;
	if (result == 0)
		result = identify(can);
	if (result < 0 && error[0] == '\0')
		explain(result, can, &adapter, error, error_size);
	if (result == 0) {
		snprintf(can->wanted, sizeof(can->wanted), "%s", gs_usb_name(&adapter));
		snprintf(can->port.name, sizeof(can->port.name), "gs_usb:%.40s", can->wanted);
	}
	return result;
}

int can_gs_usb_open(const char *address, struct can_port **port, char *error, size_t error_size)
{
	struct bus_options options;
	struct gs_usb *can;
	int result = bus_options_parse(&options, address, error, error_size);

	if (result < 0)
		return result;
	can = calloc(1, sizeof(*can));
	if (can == NULL)
		return -ENOMEM;
	can->port.ops = &gs_usb_ops;
	can->port.fd = can->more.fd = can->node = -1;
	can->port.bit_s = options.bit_s;
	can->sample_point_permille = options.sample_point_permille;
	can->listen_only = options.listen_only;
	if (!parse(can, options.address)) {
		snprintf(error, error_size, "bad bus 'gs_usb:%s': use " CAN_GS_USB_SYNTAX, address);
		result = -EINVAL;
	}
	if (result == 0 && port != NULL)
		result = set_up(can, error, error_size);
	if (result < 0 || port == NULL) {
		gs_usb_close(&can->port);
		return result;
	}
	*port = &can->port;
	return 0;
}

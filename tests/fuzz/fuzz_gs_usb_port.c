/* The gs_usb driver at an adapter that answers anything: descriptors, answers of any length, statuses in any order,
 * late, cancelled, unplugged and plugged in again. libusb's functions are defined here. No call is endless, frames are
 * valid, no transfer is submitted twice or freed in use, and nothing is left when the port is closed. */
#include <errno.h>
#include <libusb-1.0/libusb.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/can/gs_usb_find.h"
#include "drivers/ports/can.h"
#include "tests/fuzz/fuzz.h"
#include "tests/unit/libusb_stubs.h"

enum { TRANSFERS = 64, FRAMES = 5000, FRAME_BYTES = 20, PAST_HOST = 1000000000 };

static struct adapter {
	struct input *in;
	bool unplugged;
	unsigned allocated, open;
	struct waiting {
		struct libusb_transfer *transfer;
		bool cancelled;
	} waiting[TRANSFERS];
	size_t count;
	uint8_t sent[FRAME_BYTES]; /* the last frame */
} adapter;

/* An error, sometimes. */
static int may_fail(void)
{
	const int errors[] = {LIBUSB_ERROR_IO, LIBUSB_ERROR_ACCESS, LIBUSB_ERROR_NO_DEVICE, LIBUSB_ERROR_BUSY};
	uint8_t byte = read_byte(adapter.in);

	return adapter.unplugged ? LIBUSB_ERROR_NO_DEVICE : byte < 0xF0 ? 0 : errors[byte % 4];
}

/* ---- libusb ------------------------------------------------------------------------------------------------------ */

static size_t find(const struct libusb_transfer *transfer)
{
	size_t i = 0;

	while (i < adapter.count && adapter.waiting[i].transfer != transfer)
		i++;
	return i;
}

struct libusb_transfer *LIBUSB_CALL libusb_alloc_transfer(int packets)
{
	(void)packets;
	adapter.allocated++;
	return calloc(1, sizeof(struct libusb_transfer));
}

void LIBUSB_CALL libusb_free_transfer(struct libusb_transfer *transfer)
{
	require(find(transfer) == adapter.count);
	adapter.allocated -= transfer != NULL;
	free(transfer);
}

int LIBUSB_CALL libusb_submit_transfer(struct libusb_transfer *transfer)
{
	require(adapter.open && find(transfer) == adapter.count && adapter.count < TRANSFERS);
	require(transfer->dev_handle == &the_handle && transfer->buffer != NULL && transfer->length > 0);
	if (adapter.unplugged)
		return LIBUSB_ERROR_NO_DEVICE;
	adapter.waiting[adapter.count++] = (struct waiting){.transfer = transfer};
	return 0;
}

/* It comes back later. */
int LIBUSB_CALL libusb_cancel_transfer(struct libusb_transfer *transfer)
{
	size_t i = find(transfer);

	if (i == adapter.count)
		return LIBUSB_ERROR_NOT_FOUND;
	adapter.waiting[i].cancelled = true;
	return 0;
}

/* Two interfaces: one for firmware updates and the one of CAN, whose three endpoints are anything at times. */
int LIBUSB_CALL libusb_get_active_config_descriptor(libusb_device *device, struct libusb_config_descriptor **config)
{
	static struct libusb_endpoint_descriptor endpoints[3];
	static struct libusb_interface_descriptor settings[2];
	static const struct libusb_interface interfaces[2] = {
		{.altsetting = &settings[0], .num_altsetting = 1}, {.altsetting = &settings[1], .num_altsetting = 1}};
	static struct libusb_config_descriptor the_config = {.interface = interfaces};
	uint8_t kind = read_byte(adapter.in);

	(void)device;
	settings[0] = (struct libusb_interface_descriptor){.bInterfaceClass = 0xFE};
	settings[1] = (struct libusb_interface_descriptor){.bInterfaceClass = LIBUSB_CLASS_VENDOR_SPEC,
		.bInterfaceNumber = 1,
		.bNumEndpoints = 2,
		.endpoint = endpoints};
	endpoints[0] = (struct libusb_endpoint_descriptor){
		.bEndpointAddress = 0x81, .bmAttributes = LIBUSB_TRANSFER_TYPE_BULK, .wMaxPacketSize = 32};
	endpoints[1] = (struct libusb_endpoint_descriptor){
		.bEndpointAddress = 0x02, .bmAttributes = LIBUSB_TRANSFER_TYPE_BULK, .wMaxPacketSize = 32};
	the_config.bNumInterfaces = 2;
	if (kind & 1)
		the_config.bNumInterfaces = read_byte(adapter.in) % 3;
	if (kind & 2) {
		settings[1].bNumEndpoints = read_byte(adapter.in) % 4;
		settings[1].bInterfaceNumber = read_byte(adapter.in);
		for (int i = 0; i < 3; i++) {
			endpoints[i].bEndpointAddress = read_byte(adapter.in);
			endpoints[i].bmAttributes = read_byte(adapter.in);
			read_bytes(adapter.in, &endpoints[i].wMaxPacketSize, sizeof(uint16_t));
		}
	}
	*config = &the_config;
	return may_fail();
}

void LIBUSB_CALL libusb_free_config_descriptor(struct libusb_config_descriptor *config)
{
	(void)config;
}

int LIBUSB_CALL libusb_wrap_sys_device(libusb_context *context, intptr_t fd, libusb_device_handle **handle)
{
	int result = may_fail();

	(void)context, (void)fd;
	if (result < 0)
		return result;
	adapter.open++;
	*handle = &the_handle;
	return 0;
}

int LIBUSB_CALL libusb_claim_interface(libusb_device_handle *handle, int interface)
{
	(void)handle, (void)interface;
	return may_fail();
}

int LIBUSB_CALL libusb_release_interface(libusb_device_handle *handle, int interface)
{
	(void)handle, (void)interface;
	return 0;
}

void LIBUSB_CALL libusb_close(libusb_device_handle *handle)
{
	require(handle == &the_handle && adapter.open == 1 && adapter.count == 0);
	adapter.open--;
}

int LIBUSB_CALL libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t number, uint16_t value,
	uint16_t index, unsigned char *data, uint16_t length, unsigned int timeout_ms)
{
	(void)handle, (void)number, (void)value, (void)index, (void)data, (void)timeout_ms;
	require((type & LIBUSB_ENDPOINT_IN) == 0 && adapter.open);
	return may_fail() < 0 ? LIBUSB_ERROR_PIPE : length;
}

/* ---- what the adapter does --------------------------------------------------------------------------------------- */

static void complete(size_t i, enum libusb_transfer_status status, int length)
{
	struct libusb_transfer *transfer = adapter.waiting[i].transfer;

	require(length >= 0 && length <= transfer->length);
	memmove(&adapter.waiting[i], &adapter.waiting[i + 1], (--adapter.count - i) * sizeof(adapter.waiting[0]));
	transfer->status = status;
	transfer->actual_length = length;
	transfer->callback(transfer);
}

/* Bytes of the input, as many as it says and there is room for. */
static int put_bytes(uint8_t *out, int room)
{
	int n = read_byte(adapter.in);

	n = n < room ? n : room;
	read_bytes(adapter.in, out, (size_t)n);
	return n;
}

/* One channel, and an STM32F0 at 48 MHz: most answers must be good for the driver to go on. */
static int put_answer(uint8_t kind, const uint8_t *setup, uint8_t *data, int length)
{
	static const uint8_t limits[40] = {0x1B, 0, 0, 0, 0, 0x6C, 0xDC, 0x02, 1, 0, 0, 0, 16, 0, 0, 0, 1, 0, 0, 0, 8,
		0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 0, 4, 0, 0, 1, 0, 0, 0};
	static const uint8_t config[12] = {0, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0};

	if ((setup[0] & LIBUSB_ENDPOINT_IN) == 0)
		return length;
	if (kind & 0x10)
		return put_bytes(data, length);
	memset(data, 0, (size_t)length);
	if (setup[1] == 4)
		memcpy(data, limits, (size_t)length < sizeof(limits) ? (size_t)length : sizeof(limits));
	else if (setup[1] == 5)
		memcpy(data, config, (size_t)length < sizeof(config) ? (size_t)length : sizeof(config));
	return length;
}

static int put_packet(uint8_t kind, uint8_t *out, int room)
{
	if ((kind & 0x10) == 0 || room < FRAME_BYTES)
		return put_bytes(out, room);
	memset(out, 0, (size_t)room);
	memcpy(out, adapter.sent, FRAME_BYTES); /* the echo */
	return kind & 0x08 ? room : FRAME_BYTES;
}

static void answer(size_t i, uint8_t kind)
{
	static const enum libusb_transfer_status failures[] = {LIBUSB_TRANSFER_ERROR, LIBUSB_TRANSFER_TIMED_OUT,
		LIBUSB_TRANSFER_STALL, LIBUSB_TRANSFER_NO_DEVICE, LIBUSB_TRANSFER_OVERFLOW};
	struct libusb_transfer *t = adapter.waiting[i].transfer;
	int length = 0;

	if (kind & 0x20) {
		complete(i, failures[(kind & 7) % 5], kind & 8 ? t->length : 0);
		return;
	}
	if (t->type == LIBUSB_TRANSFER_TYPE_CONTROL) {
		length = put_answer(kind, t->buffer, t->buffer + LIBUSB_CONTROL_SETUP_SIZE,
			t->length - (int)LIBUSB_CONTROL_SETUP_SIZE);
	} else if (t->endpoint & LIBUSB_ENDPOINT_IN) {
		length = put_packet(kind, t->buffer, t->length);
	} else {
		require(t->length == FRAME_BYTES);
		memcpy(adapter.sent, t->buffer, FRAME_BYTES);
		length = FRAME_BYTES;
	}
	complete(i, LIBUSB_TRANSFER_COMPLETED, length);
}

/* A byte of the input: one transfer is answered, of a kind if there is one. */
int LIBUSB_CALL libusb_handle_events_timeout_completed(libusb_context *context, struct timeval *timeout, int *completed)
{
	uint8_t kind = read_byte(adapter.in);

	(void)context, (void)timeout, (void)completed;
	for (size_t i = 0; i < adapter.count;)
		if (adapter.unplugged)
			complete(i, LIBUSB_TRANSFER_NO_DEVICE, 0);
		else if (adapter.waiting[i].cancelled)
			complete(i, kind & 1 ? LIBUSB_TRANSFER_COMPLETED : LIBUSB_TRANSFER_CANCELLED, 0);
		else
			i++;
	for (size_t i = 0; i < adapter.count && kind >= 0x40; i++) {
		const struct libusb_transfer *t = adapter.waiting[i].transfer;
		bool in = t->type != LIBUSB_TRANSFER_TYPE_CONTROL && (t->endpoint & LIBUSB_ENDPOINT_IN);

		if (kind >= 0xC0 || in == (kind >= 0x80)) {
			answer(i, kind);
			break;
		}
	}
	return 0;
}

/* ---- in place of gs_usb_find.c ----------------------------------------------------------------------------------- */

size_t gs_usb_list(const char *root, struct gs_usb_adapter list[GS_USB_ADAPTERS])
{
	(void)root;
	list[0] = (struct gs_usb_adapter){"3-1", "0042", "candleLight", "/dev/null"};
	return !adapter.unplugged;
}

int gs_usb_choose(const struct gs_usb_adapter *list, size_t n, const char *wanted, struct gs_usb_adapter *found,
	char *error, size_t error_size)
{
	(void)wanted;
	if (n == 0) {
		snprintf(error, error_size, "no adapter");
		return -ENODEV;
	}
	*found = list[0];
	return 0;
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

static void receive_all(struct can_port *port, uint64_t now_us)
{
	struct can_msg msg;
	int n = 0;

	while (can_receive(port, &msg, now_us) > 0) {
		require(msg.len <= 8 && msg.id <= (msg.extended ? 0x1FFFFFFFu : 0x7FFu) && ++n < FRAMES);
		require(msg.t_us <= now_us && msg.t_us > 0);
	}
}

static void step(struct can_port *port, uint64_t *now_us)
{
	uint8_t kind = read_byte(adapter.in);
	struct can_msg msg = {.id = kind, .len = kind & 7, .extended = kind & 8};

	switch (kind >> 5) {
	case 0:
		adapter.unplugged = kind & 1;
		break;
	case 1:
		*now_us += UINT64_C(1) << (kind & 31);
		break;
	case 2:
		(void)can_bit_rate(port, kind & 1 ? 250000 : 500000, kind & 2);
		break;
	case 3:
		(void)can_restart(port);
		break;
	case 4:
		(void)can_filter(port, (const uint32_t[]){kind, 0x605}, kind & 3 ? 2 : 0);
		break;
	default:
		for (int i = 0; i < (kind & 15); i++)
			(void)can_send(port, &msg, *now_us);
		break;
	}
	receive_all(port, *now_us);
	for (int calls = 1; can_service(port, *now_us) <= *now_us; calls++) /* at once: it wants to go on */
		require(calls < 10);
	can_refresh(port);
	require(port->state <= CAN_STATE_DOWN);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	uint64_t now_us = PAST_HOST;
	struct can_port *port;
	char error[300] = "";

	adapter = (struct adapter){.in = &in};
	if (can_open("gs_usb", &port, error, sizeof(error)) == 0) {
		while (in.size > 0)
			step(port, &now_us);
		can_close(port);
	} else {
		require(error[0] != '\0');
	}
	require(adapter.allocated == 0 && adapter.open == 0 && adapter.count == 0);
	return 0;
}

/* The gs_usb bus on an adapter that is simulated behind libusb's functions, which are defined here. Every byte the
 * adapter sends or expects is written out from the protocol (candleLight firmware, gs_usb.h of the kernel), none of
 * them by the driver's codec. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <libusb-1.0/libusb.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>

#include "drivers/can/gs_usb_find.h"
#include "drivers/ports/can.h"
#include "tests/unit/descriptors.h"
#include "tests/unit/libusb_stubs.h"

enum { REQUESTS = 64, TRANSFERS = 64, SENT = 64, HOST_FORMAT = 0, BIT_TIMING = 1, MODE = 2, LIMITS = 4, CONFIG = 5 };

struct request {
	uint8_t type, number;
	uint16_t value, index, length;
	uint8_t data[40];
};

static struct adapter {
	/* what it is */
	bool plugged, can_listen_only, stamps;
	uint8_t channels;
	uint8_t fails; /* the request that is refused; 0xFF: none */
	unsigned slow; /* as many answers come too late */

	/* what it was asked and sent */
	struct request requests[REQUESTS];
	size_t request_count;
	uint8_t sent[SENT][20];
	size_t sent_count;
	bool holds; /* completes no OUT transfer */
	unsigned opened, closed, claimed, released, allocated;

	/* libusb's: submitted and not completed */
	struct libusb_transfer *waiting[TRANSFERS];
	size_t waiting_count;
	/* packets to the host */
	uint8_t packets[TRANSFERS][64];
	size_t packet_size[TRANSFERS], packet_count, packet_next;
} adapter;

/* ---- libusb ------------------------------------------------------------------------------------------------------ */

struct libusb_transfer *LIBUSB_CALL libusb_alloc_transfer(int packets)
{
	(void)packets;
	adapter.allocated++;
	return calloc(1, sizeof(struct libusb_transfer));
}

void LIBUSB_CALL libusb_free_transfer(struct libusb_transfer *transfer)
{
	adapter.allocated -= transfer != NULL;
	free(transfer);
}

int LIBUSB_CALL libusb_submit_transfer(struct libusb_transfer *transfer)
{
	if (!adapter.plugged)
		return LIBUSB_ERROR_NO_DEVICE;
	for (size_t i = 0; i < adapter.waiting_count; i++)
		assert_ptr_not_equal(adapter.waiting[i], transfer); /* is libusb's until it has completed */
	assert_true(adapter.waiting_count < TRANSFERS);
	adapter.waiting[adapter.waiting_count++] = transfer;
	return 0;
}

static void complete(size_t i, enum libusb_transfer_status status, int length)
{
	struct libusb_transfer *transfer = adapter.waiting[i];

	memmove(&adapter.waiting[i], &adapter.waiting[i + 1],
		(--adapter.waiting_count - i) * sizeof(adapter.waiting[0]));
	transfer->status = status;
	transfer->actual_length = length;
	transfer->callback(transfer);
}

int LIBUSB_CALL libusb_cancel_transfer(struct libusb_transfer *transfer)
{
	for (size_t i = 0; i < adapter.waiting_count; i++)
		if (adapter.waiting[i] == transfer) {
			complete(i, LIBUSB_TRANSFER_CANCELLED, 0);
			return 0;
		}
	return LIBUSB_ERROR_NOT_FOUND;
}

int LIBUSB_CALL libusb_get_active_config_descriptor(libusb_device *device, struct libusb_config_descriptor **config)
{
	static const struct libusb_endpoint_descriptor endpoints[] = {
		{.bEndpointAddress = 0x81, .bmAttributes = LIBUSB_TRANSFER_TYPE_BULK, .wMaxPacketSize = 32},
		{.bEndpointAddress = 0x02, .bmAttributes = LIBUSB_TRANSFER_TYPE_BULK, .wMaxPacketSize = 32}};
	static const struct libusb_interface_descriptor other = {.bInterfaceClass = 0xFE, .bInterfaceNumber = 0},
							vendor = {.bInterfaceClass = LIBUSB_CLASS_VENDOR_SPEC,
								.bInterfaceNumber = 1,
								.bNumEndpoints = 2,
								.endpoint = endpoints};
	static const struct libusb_interface interfaces[] = {
		{.altsetting = &other, .num_altsetting = 1}, {.altsetting = &vendor, .num_altsetting = 1}};
	static struct libusb_config_descriptor the_config = {.bNumInterfaces = 2, .interface = interfaces};

	(void)device;
	*config = &the_config;
	return 0;
}

void LIBUSB_CALL libusb_free_config_descriptor(struct libusb_config_descriptor *config)
{
	(void)config;
}

int LIBUSB_CALL libusb_wrap_sys_device(libusb_context *context, intptr_t fd, libusb_device_handle **handle)
{
	(void)context, (void)fd;
	adapter.opened++;
	*handle = &the_handle;
	return 0;
}

int LIBUSB_CALL libusb_claim_interface(libusb_device_handle *handle, int interface)
{
	(void)handle;
	assert_int_equal(interface, 1);
	adapter.claimed++;
	return 0;
}

int LIBUSB_CALL libusb_release_interface(libusb_device_handle *handle, int interface)
{
	(void)handle, (void)interface;
	adapter.released++;
	return 0;
}

void LIBUSB_CALL libusb_close(libusb_device_handle *handle)
{
	(void)handle;
	assert_int_equal(adapter.waiting_count, 0); /* libusb needs its transfers back first */
	adapter.closed++;
}

/* BT_CONST of an STM32F0 at 48 MHz, and DEVICE_CONFIG. */
static size_t answer(const struct request *request, uint8_t *data)
{
	const uint8_t limits[40] = {(uint8_t)(0x0A | adapter.can_listen_only | (adapter.stamps ? 0x10 : 0)), 0, 0, 0, 0,
		0x6C, 0xDC, 0x02, 1, 0, 0, 0, 16, 0, 0, 0, 1, 0, 0, 0, 8, 0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 0, 4, 0, 0,
		1, 0, 0, 0};
	const uint8_t config[12] = {0, 0, 0, (uint8_t)(adapter.channels - 1), 2, 0, 0, 0, 1, 0, 0, 0};

	if (request->number == LIMITS)
		memcpy(data, limits, sizeof(limits));
	if (request->number == CONFIG)
		memcpy(data, config, sizeof(config));
	return request->length;
}

static bool serve_request(uint8_t type, uint8_t number, uint16_t value, uint16_t index, uint16_t length, uint8_t *data)
{
	struct request *request = &adapter.requests[adapter.request_count++];

	assert_true(adapter.request_count < REQUESTS);
	*request = (struct request){type, number, value, index, length, {0}};
	if (number == adapter.fails)
		return false;
	if ((type & LIBUSB_ENDPOINT_IN) == 0)
		memcpy(request->data, data, length);
	else
		answer(request, data);
	return true;
}

int LIBUSB_CALL libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t number, uint16_t value,
	uint16_t index, unsigned char *data, uint16_t length, unsigned int timeout_ms)
{
	(void)handle, (void)timeout_ms;
	return serve_request(type, number, value, index, length, data) ? length : LIBUSB_ERROR_PIPE;
}

static bool serve_transfer(size_t i)
{
	struct libusb_transfer *t = adapter.waiting[i];

	if (t->type == LIBUSB_TRANSFER_TYPE_CONTROL) {
		uint8_t *b = t->buffer; /* the set-up packet of USB 2.0, 9.3 */

		if (adapter.slow && adapter.slow--)
			complete(i, LIBUSB_TRANSFER_TIMED_OUT, 0);
		else if (serve_request(b[0], b[1], (uint16_t)(b[2] | b[3] << 8), (uint16_t)(b[4] | b[5] << 8),
				 (uint16_t)(b[6] | b[7] << 8), b + 8))
			complete(i, LIBUSB_TRANSFER_COMPLETED, b[6] | b[7] << 8);
		else
			complete(i, LIBUSB_TRANSFER_STALL, 0);
		return true;
	}
	if (t->endpoint == 0x02 && !adapter.holds) {
		assert_int_equal(t->length, 20);
		assert_true(adapter.sent_count < SENT);
		memcpy(adapter.sent[adapter.sent_count++], t->buffer, 20);
		complete(i, LIBUSB_TRANSFER_COMPLETED, 20);
		return true;
	}
	if (t->endpoint == 0x81 && adapter.packet_next < adapter.packet_count) {
		size_t size = adapter.packet_size[adapter.packet_next];

		if (size == 0) { /* more than the transfer has room for */
			adapter.packet_next++;
			complete(i, LIBUSB_TRANSFER_OVERFLOW, t->length);
			return true;
		}
		memcpy(t->buffer, adapter.packets[adapter.packet_next++], size);
		complete(i, LIBUSB_TRANSFER_COMPLETED, (int)size);
		return true;
	}
	return false;
}

int LIBUSB_CALL libusb_handle_events_timeout_completed(libusb_context *context, struct timeval *timeout, int *completed)
{
	(void)context, (void)timeout, (void)completed;
	for (size_t i = 0; i < adapter.waiting_count;) {
		if (!adapter.plugged)
			complete(i, LIBUSB_TRANSFER_NO_DEVICE, 0);
		else if (!serve_transfer(i))
			i++;
	}
	return 0;
}

/* ---- the kernel's file of the USB device ------------------------------------------------------------------------- */

static _Atomic unsigned resets;

int ioctl(int fd, unsigned long request, ...)
{
	(void)fd;
	if (request == (unsigned long)USBDEVFS_RESET)
		resets++;
	return 0;
}

/* ---- in place of gs_usb_find.c ----------------------------------------------------------------------------------- */

size_t gs_usb_list(const char *root, struct gs_usb_adapter list[GS_USB_ADAPTERS])
{
	assert_string_equal(root, "/sys/bus/usb/devices");
	list[0] = (struct gs_usb_adapter){"3-1", "0042", "candleLight", "/dev/null"};
	return adapter.plugged;
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

static struct can_port *port;
static uint64_t now_us;

static int set_up(void **state)
{
	(void)state;
	adapter = (struct adapter){.plugged = true, .can_listen_only = true, .channels = 1, .fails = 0xFF};
	port = NULL;
	resets = 0;
	now_us = 1000000000;
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	if (port)
		can_close(port);
	port = NULL;
	assert_int_equal(adapter.allocated, 0);
	assert_int_equal(adapter.opened, adapter.closed);
	assert_int_equal(adapter.claimed, adapter.released);
	return 0;
}

static int try_open(const char *bus, char error[300])
{
	error[0] = '\0';
	return can_open(bus, &port, error, 300);
}

static void open_bus(const char *bus)
{
	char error[300];

	if (try_open(bus, error) < 0)
		fail_msg("%s", error);
}

/* Calls the port until nothing is left to do; false: no frame was received. */
static bool run(struct can_msg *msg)
{
	struct can_msg unused;
	bool received = false;

	for (int i = 0; i < 8 && !received; i++) {
		can_service(port, now_us);
		received = can_receive(port, msg ? msg : &unused, now_us) == 1;
	}
	return received;
}

static void assert_nothing_received(void)
{
	struct can_msg msg;

	assert_false(run(&msg));
}

static void open_and_start(const char *bus)
{
	open_bus(bus);
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
}

static int send_id(uint32_t id)
{
	const struct can_msg msg = {.id = id, .len = 1, .data = {0x5A}};

	return can_send(port, &msg, now_us);
}

static void put_packet(const uint8_t *bytes, size_t size)
{
	memcpy(adapter.packets[adapter.packet_count], bytes, size);
	adapter.packet_size[adapter.packet_count++] = size;
}

/* A frame 605h with these two bytes, with the time of the adapter's clock. */
static void put_frame_of(uint8_t first, uint8_t second, uint32_t stamp_us)
{
	const uint8_t bytes[24] = {0xFF, 0xFF, 0xFF, 0xFF, 0x05, 0x06, 0, 0, 2, 0, 0, 0, first, second, 0, 0, 0, 0, 0,
		0, (uint8_t)stamp_us, (uint8_t)(stamp_us >> 8), (uint8_t)(stamp_us >> 16), (uint8_t)(stamp_us >> 24)};

	put_packet(bytes, sizeof(bytes));
}

static void put_frame(uint32_t stamp_us)
{
	put_frame_of(0x11, 0x22, stamp_us);
}

static void put_echo(uint8_t slot)
{
	const uint8_t bytes[20] = {slot, 0, 0, 0, 0x81, 0x01, 0, 0, 1, 0, 0, 0, 0x5A};

	put_packet(bytes, sizeof(bytes));
}

/* An error frame as SocketCAN has it: class, and data bytes 1, 6 and 7. */
static void put_error(uint8_t class_low, uint8_t class_high, uint8_t controller, uint8_t tx_errors, uint8_t rx_errors)
{
	const uint8_t bytes[20] = {0xFF, 0xFF, 0xFF, 0xFF, class_low, class_high, 0, 0x20, 8, 0, 0, 0, 0, controller, 0,
		0, 0, 0, tx_errors, rx_errors};

	put_packet(bytes, sizeof(bytes));
}

static void assert_request(size_t i, uint8_t type, uint8_t number, uint16_t value, uint16_t length, const char *data)
{
	const struct request *r = &adapter.requests[i];

	assert_true(i < adapter.request_count);
	assert_int_equal(r->type, type);
	assert_int_equal(r->number, number);
	assert_int_equal(r->value, value);
	assert_int_equal(r->index, 1); /* the interface */
	assert_int_equal(r->length, length);
	assert_memory_equal(r->data, data, type == 0x41 ? length : 0);
}

/* RESET, bit timing of 500 kbit/s at 87.5 %, START with these flags. */
static void assert_started_with_request(size_t i, uint16_t channel, const char *start)
{
	assert_request(i, 0x41, MODE, channel, 8, "\0\0\0\0\0\0\0\0");
	assert_request(i + 1, 0x41, BIT_TIMING, channel, 20, "\6\0\0\0\7\0\0\0\2\0\0\0\1\0\0\0\6\0\0\0");
	assert_request(i + 2, 0x41, MODE, channel, 8, start);
}

/* ---- going on the bus -------------------------------------------------------------------------------------------- */

static void test_opening_asks_what_the_adapter_is_and_the_first_service_puts_it_on_the_bus(void **state)
{
	(void)state;
	open_bus("gs_usb");
	assert_string_equal(port->name, "gs_usb:0042");
	assert_int_equal(adapter.request_count, 3);
	assert_request(0, 0x41, HOST_FORMAT, 1, 4, "\xEF\xBE\0\0");
	assert_request(1, 0xC1, CONFIG, 1, 12, NULL);
	assert_request(2, 0xC1, LIMITS, 0, 40, NULL);
	assert_int_equal(send_id(0x181), 0); /* waits */
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 6);
	assert_started_with_request(3, 0, "\1\0\0\0\0\0\0\0");
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
}

static void test_channel_and_listening_are_in_the_requests(void **state)
{
	(void)state;
	adapter.channels = 3;
	adapter.stamps = true;
	open_and_start("gs_usb:0042:2,listen-only");
	assert_request(2, 0xC1, LIMITS, 2, 40, NULL);
	assert_started_with_request(3, 2, "\1\0\0\0\x11\0\0\0"); /* LISTEN_ONLY and HW_TIMESTAMP */
	assert_int_equal(send_id(0x181), -EPERM);
	assert_int_equal(adapter.sent_count, 0);
}

static void test_another_bit_rate_restarts_the_adapter_with_its_timing(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	assert_int_equal(can_bit_rate(port, 1000000, true), 0);
	assert_int_equal(can_bit_rate(port, 1500, false), -EOPNOTSUPP); /* 1875 is the slowest */
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 6);
	assert_int_equal(can_bit_rate(port, 1000000, false), 0);
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 9);
	assert_request(6, 0x41, MODE, 0, 8, "\0\0\0\0\0\0\0\0");
	assert_request(7, 0x41, BIT_TIMING, 0, 20, "\5\0\0\0\6\0\0\0\4\0\0\0\2\0\0\0\3\0\0\0");
	assert_int_equal(port->bit_s, 1000000);
}

static void test_a_bit_rate_set_after_opening_is_used_from_the_start(void **state)
{
	(void)state;
	open_bus("gs_usb");
	assert_int_equal(can_bit_rate(port, 1000000, false), 0);
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 6);
	assert_request(4, 0x41, BIT_TIMING, 0, 20, "\5\0\0\0\6\0\0\0\4\0\0\0\2\0\0\0\3\0\0\0");
}

static void test_the_sample_point_can_be_chosen(void **state)
{
	(void)state; /* 50 %: 8 of 16 quanta */
	open_and_start("gs_usb,sample-point=0.5");
	assert_request(4, 0x41, BIT_TIMING, 0, 20, "\3\0\0\0\4\0\0\0\x8\0\0\0\4\0\0\0\6\0\0\0");
}

static void test_closing_takes_the_adapter_off_the_bus(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	can_close(port);
	port = NULL;
	assert_int_equal(adapter.request_count, 7);
	assert_request(6, 0x41, MODE, 0, 8, "\0\0\0\0\0\0\0\0");
}

static void assert_refused(const char *bus, int result, const char *words)
{
	char error[300];

	assert_int_equal(try_open(bus, error), result);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
	assert_null(port);
}

static void test_what_the_adapter_does_not_support_is_refused(void **state)
{
	(void)state;
	assert_refused("gs_usb::1", -ECHRNG, "has no channel 1");
	/* 48 MHz / 989690 is 48.5: 1 % off either way */
	assert_refused("gs_usb,bitrate=989690", -EOPNOTSUPP, "989690 bit/s");
	adapter.can_listen_only = false;
	assert_refused("gs_usb,listen-only", -EOPNOTSUPP, "listen-only");
	adapter.fails = LIMITS;
	assert_refused("gs_usb", -EIO, "0042");
	adapter.plugged = false;
	assert_refused("gs_usb", -ENODEV, "no adapter");
	assert_refused("gs_usb:0042:", -EINVAL, "gs_usb[:SERIAL[:CHANNEL]]");
	assert_refused("gs_usb:0123456789012345678901234567890123456789012345678901234567890123", -EINVAL,
		"gs_usb[:SERIAL[:CHANNEL]]"); /* 64 characters */
	assert_refused("gs_usb:0042:256", -EINVAL, "gs_usb[:SERIAL[:CHANNEL]]");
}

/* ---- sending ----------------------------------------------------------------------------------------------------- */

static void test_a_frame_is_sent_as_one_packet_with_its_slot(void **state)
{
	static const uint8_t first[20] = {0, 0, 0, 0, 0x81, 0x01, 0, 0, 1, 0, 0, 0, 0x5A};
	static const uint8_t second[20] = {
		1, 0, 0, 0, 0x78, 0x56, 0x34, 0x92, 8, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8}; /* 80000000h: extended */
	static const uint8_t third[20] = {2, 0, 0, 0, 0x01, 0x07, 0, 0x40, 1};		 /* 40000000h: remote */
	const struct can_msg extended = {
		.id = 0x12345678, .extended = true, .len = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}};
	const struct can_msg remote = {.id = 0x701, .remote = true, .len = 1, .data = {9}};

	(void)state;
	open_and_start("gs_usb");
	assert_int_equal(send_id(0x181), 0);
	assert_int_equal(can_send(port, &extended, now_us), 0);
	assert_int_equal(can_send(port, &remote, now_us), 0);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 3);
	assert_memory_equal(adapter.sent[0], first, 20);
	assert_memory_equal(adapter.sent[1], second, 20);
	assert_memory_equal(adapter.sent[2], third, 20);
	assert_int_equal(port->counters.tx, 3);
}

static void send_ten(void)
{
	for (uint32_t i = 0; i < 10; i++)
		assert_int_equal(send_id(0x100 + i), 0);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 10);
}

static void test_the_adapter_is_given_ten_frames_and_the_next_when_an_echo_has_come(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	send_ten();
	assert_int_equal(send_id(0x200), 0);
	assert_int_equal(send_id(0x201), 0);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 10);
	assert_int_equal(port->queue_count, 2);
	put_echo(3);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 11); /* without waiting for the back-off to end */
	assert_int_equal(adapter.sent[10][0], 3); /* the slot that is free */
	assert_int_equal(adapter.sent[10][4], 0x00);
	assert_int_equal(adapter.sent[10][5], 0x02);
	assert_int_equal(port->queue_count, 1);
	assert_int_equal(port->counters.rx, 0); /* an echo is not a received frame */
	assert_int_equal(port->counters.rx_dropped, 0);
}

/* Its echo may be faster than the confirmation of the host controller. */
static void test_a_slot_is_not_used_again_before_its_transfer_has_completed(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	adapter.holds = true;
	assert_int_equal(send_id(0x181), 0);
	put_echo(0);
	assert_nothing_received();
	assert_int_equal(send_id(0x182), 0);
	adapter.holds = false;
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 2);
	assert_int_equal(adapter.sent[0][0], 0);
	assert_int_equal(adapter.sent[1][0], 1);
}

static void test_an_echo_of_a_frame_that_was_not_sent_is_counted(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	put_echo(4);
	assert_nothing_received();
	assert_int_equal(port->counters.rx_dropped, 1);
	put_echo(10); /* no slot at all */
	assert_nothing_received();
	assert_int_equal(port->counters.rx_dropped, 2);
}

static void test_an_adapter_that_confirms_nothing_for_two_seconds_is_restarted(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	send_ten();
	now_us += 1000000;
	assert_nothing_received();
	now_us += 999999;
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 6);
	now_us += 1;
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 9);
	assert_started_with_request(6, 0, "\1\0\0\0\0\0\0\0");
	assert_int_equal(port->counters.tx_dropped, 10); /* and the slots are free again */
	assert_int_equal(send_id(0x181), 0);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 11);
}

static void test_an_adapter_that_confirms_nothing_is_restarted_when_it_is_passive_too(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	send_ten();
	put_error(0x04, 0, 0x20, 0, 0);
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_PASSIVE);
	now_us += 2000000;
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 9);
	assert_started_with_request(6, 0, "\1\0\0\0\0\0\0\0");
}

static void test_restarts_in_vain_are_ever_rarer_and_told(void **state)
{
	static const uint64_t pauses_us[] = {2000000, 4000000, 8000000, 16000000};

	(void)state;
	open_and_start("gs_usb");
	for (size_t i = 0; i < 4; i++) {
		assert_true((port->notice != NULL) == (i >= 3));
		for (int k = 0; k < 10; k++)
			assert_int_equal(send_id(0x181), 0);
		assert_nothing_received();
		now_us += pauses_us[i] - 1;
		assert_nothing_received();
		assert_int_equal(adapter.request_count, 6 + 3 * i);
		now_us += 1;
		assert_nothing_received();
		assert_int_equal(adapter.request_count, 6 + 3 * (i + 1));
	}
	assert_non_null(strstr(port->notice, "unplug it"));
}

static void test_after_four_restarts_in_vain_the_usb_device_is_reset_and_set_up_again(void **state)
{
	static const uint64_t pauses_us[] = {2000000, 4000000, 8000000, 16000000, 32000000};

	(void)state;
	open_and_start("gs_usb");
	for (size_t i = 0; i < 5; i++) {
		assert_int_equal(resets, 0);
		for (int k = 0; k < 10; k++)
			assert_int_equal(send_id(0x181), 0);
		assert_nothing_received();
		now_us += pauses_us[i];
		assert_nothing_received();
	}
	while (resets == 0) { /* by a thread */
		now_us += 500000;
		assert_int_equal(adapter.opened, 1);
		sched_yield();
		assert_nothing_received();
	}
	while (adapter.opened == 1) {
		now_us += 500000;
		assert_nothing_received();
	}
	assert_nothing_received();
	assert_int_equal(resets, 1);
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(adapter.request_count, 6 + 3 * 4 + 6);
}

static void test_a_request_that_is_answered_too_late_is_repeated(void **state)
{
	(void)state;
	adapter.slow = 3;
	open_and_start("gs_usb");
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(adapter.opened, 1);
}

static void test_an_echo_in_between_shows_that_the_adapter_works(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	send_ten();
	now_us += 1500000;
	put_echo(0);
	assert_nothing_received();
	assert_int_equal(send_id(0x181), 0); /* all ten slots are in use again */
	assert_nothing_received();
	now_us += 1500000;
	assert_nothing_received();
	assert_int_equal(adapter.request_count, 6);
	assert_int_equal(can_service(port, now_us), now_us + 500000); /* the next deadline */
}

/* ---- receiving --------------------------------------------------------------------------------------------------- */

static void test_a_received_frame_has_the_time_of_its_arrival_without_stamps(void **state)
{
	struct can_msg msg;

	(void)state;
	open_and_start("gs_usb");
	put_frame(12345);
	assert_true(run(&msg));
	assert_int_equal(msg.id, 0x605);
	assert_false(msg.extended);
	assert_false(msg.remote);
	assert_int_equal(msg.len, 2);
	assert_memory_equal(msg.data, "\x11\x22\0\0\0\0\0\0", 8);
	assert_int_equal(msg.t_us, now_us);
	assert_int_equal(port->counters.rx, 1);
}

static void test_with_stamps_the_time_is_that_of_the_adapter(void **state)
{
	struct can_msg msg;
	uint64_t first_us = now_us;

	(void)state;
	adapter.stamps = true;
	open_and_start("gs_usb");
	put_frame(0xFFFFFF00); /* wraps soon */
	assert_true(run(&msg));
	assert_int_equal(msg.t_us, first_us);
	now_us += 5000;
	put_frame(0xFFFFFF00u + 2000u); /* 2 ms after the first, read 3 ms late */
	assert_true(run(&msg));
	assert_int_equal(msg.t_us, first_us + 2000 + 1); /* the offset creeps by 200 ppm */
}

static void test_an_error_frame_sets_state_and_counters_and_is_not_received(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	put_error(0x04, 0, 0x20, 130, 7); /* CAN_ERR_CRTL, TX_PASSIVE */
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_PASSIVE);
	assert_int_equal(port->tx_errors, 130);
	assert_int_equal(port->rx_errors, 7);
	assert_int_equal(port->counters.errors, 1);
	put_error(0x04, 0, 0x08, 96, 0); /* TX_WARNING */
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_WARNING);
	assert_int_equal(port->counters.rx, 0);
}

static void test_in_bus_off_frames_wait_and_a_restart_ends_it(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	put_error(0x40, 0, 0, 0, 0);
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_BUS_OFF);
	assert_int_equal(port->counters.bus_off, 1);
	assert_int_equal(send_id(0x181), 0);
	assert_int_equal(port->queue_count, 1);
	assert_int_equal(can_restart(port), 0);
	assert_nothing_received();
	assert_started_with_request(6, 0, "\1\0\0\0\0\0\0\0");
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(port->queue_count, 0);
	assert_int_equal(adapter.sent_count, 1);
}

static void test_the_overflow_flag_of_a_frame_counts_as_a_lost_frame(void **state)
{
	static const uint8_t bytes[20] = {0xFF, 0xFF, 0xFF, 0xFF, 0x05, 0x06, 0, 0, 0, 0, 1};
	struct can_msg msg;

	(void)state;
	open_and_start("gs_usb");
	put_packet(bytes, sizeof(bytes));
	assert_true(run(&msg));
	assert_int_equal(port->counters.rx_dropped, 1);
}

static void test_packets_of_another_channel_too_short_or_too_long_are_counted_and_not_received(void **state)
{
	static const uint8_t other[20] = {0xFF, 0xFF, 0xFF, 0xFF, 0x05, 0x06, 0, 0, 0, 1};

	(void)state;
	open_and_start("gs_usb");
	put_packet(other, 20);
	assert_nothing_received();
	assert_int_equal(port->counters.rx_dropped, 1);
	put_packet(other, 19);
	assert_nothing_received();
	assert_int_equal(port->counters.rx_dropped, 2);
	adapter.packet_size[adapter.packet_count++] = 0; /* OVERFLOW of libusb */
	assert_nothing_received();
	assert_int_equal(port->counters.rx_dropped, 3);
	put_frame(0);
	assert_true(run(NULL));
}

static void test_the_descriptor_is_readable_while_packets_wait_in_the_driver(void **state)
{
	struct pollfd fd;

	(void)state;
	open_and_start("gs_usb");
	fd = (struct pollfd){.fd = port->fd, .events = POLLIN};
	assert_int_equal(poll(&fd, 1, 0), 0);
	put_frame(0);
	put_frame(0);
	assert_true(run(NULL));
	assert_int_equal(poll(&fd, 1, 0), 1);
	assert_true(run(NULL));
	assert_nothing_received();
	assert_int_equal(poll(&fd, 1, 0), 0);
}

static void test_many_more_packets_than_transfers_arrive_in_order(void **state)
{
	struct can_msg msg;

	(void)state;
	adapter.stamps = true;
	open_and_start("gs_usb");
	for (uint8_t i = 0; i < 60; i++)
		put_frame_of(i, 0, 1000u + 10u * i);
	now_us += 600;
	for (int i = 0; i < 60; i++) {
		assert_true(run(&msg));
		assert_int_equal(msg.data[0], i);
		assert_true(msg.t_us <= now_us);
	}
	assert_nothing_received();
	assert_int_equal(port->counters.rx, 60);
	assert_int_equal(port->counters.rx_dropped, 0);
}

static void test_a_filter_passes_the_wanted_identifiers_only(void **state)
{
	(void)state;
	open_and_start("gs_usb");
	assert_int_equal(can_filter(port, (const uint32_t[]){0x604}, 1), 0);
	put_frame(0);
	assert_nothing_received();
	assert_int_equal(can_filter(port, (const uint32_t[]){0x604, 0x605}, 2), 0);
	put_frame(0);
	assert_true(run(NULL));
}

/* ---- unplugging -------------------------------------------------------------------------------------------------- */

static void test_unplugged_the_bus_is_down_and_comes_back_when_plugged_in_again(void **state)
{
	int fd;

	(void)state;
	open_and_start("gs_usb");
	fd = port->fd;
	assert_int_equal(send_id(0x181), 0);
	assert_nothing_received();
	adapter.plugged = false;
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_DOWN);
	assert_int_equal(adapter.closed, 1);
	assert_int_equal(port->counters.tx_dropped, 1); /* its echo will not come */
	assert_int_equal(send_id(0x181), -ENETDOWN);
	adapter.plugged = true;
	now_us += 499999;
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_DOWN); /* looks twice a second */
	now_us += 1;
	assert_nothing_received();
	assert_int_equal(port->state, CAN_STATE_ACTIVE);
	assert_int_equal(port->fd, fd);
	assert_int_equal(adapter.request_count, 12);
	assert_started_with_request(9, 0, "\1\0\0\0\0\0\0\0");
	assert_int_equal(send_id(0x181), 0);
	assert_nothing_received();
	assert_int_equal(adapter.sent_count, 2);
	assert_int_equal(adapter.sent[1][0], 0);
}

int main(void)
{
#define ADAPTER_TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		ADAPTER_TEST(test_opening_asks_what_the_adapter_is_and_the_first_service_puts_it_on_the_bus),
		ADAPTER_TEST(test_channel_and_listening_are_in_the_requests),
		ADAPTER_TEST(test_another_bit_rate_restarts_the_adapter_with_its_timing),
		ADAPTER_TEST(test_a_bit_rate_set_after_opening_is_used_from_the_start),
		ADAPTER_TEST(test_the_sample_point_can_be_chosen),
		ADAPTER_TEST(test_closing_takes_the_adapter_off_the_bus),
		ADAPTER_TEST(test_what_the_adapter_does_not_support_is_refused),
		ADAPTER_TEST(test_a_frame_is_sent_as_one_packet_with_its_slot),
		ADAPTER_TEST(test_the_adapter_is_given_ten_frames_and_the_next_when_an_echo_has_come),
		ADAPTER_TEST(test_a_slot_is_not_used_again_before_its_transfer_has_completed),
		ADAPTER_TEST(test_an_echo_of_a_frame_that_was_not_sent_is_counted),
		ADAPTER_TEST(test_an_adapter_that_confirms_nothing_for_two_seconds_is_restarted),
		ADAPTER_TEST(test_an_adapter_that_confirms_nothing_is_restarted_when_it_is_passive_too),
		ADAPTER_TEST(test_restarts_in_vain_are_ever_rarer_and_told),
		ADAPTER_TEST(test_after_four_restarts_in_vain_the_usb_device_is_reset_and_set_up_again),
		ADAPTER_TEST(test_a_request_that_is_answered_too_late_is_repeated),
		ADAPTER_TEST(test_an_echo_in_between_shows_that_the_adapter_works),
		ADAPTER_TEST(test_a_received_frame_has_the_time_of_its_arrival_without_stamps),
		ADAPTER_TEST(test_with_stamps_the_time_is_that_of_the_adapter),
		ADAPTER_TEST(test_an_error_frame_sets_state_and_counters_and_is_not_received),
		ADAPTER_TEST(test_in_bus_off_frames_wait_and_a_restart_ends_it),
		ADAPTER_TEST(test_the_overflow_flag_of_a_frame_counts_as_a_lost_frame),
		ADAPTER_TEST(test_packets_of_another_channel_too_short_or_too_long_are_counted_and_not_received),
		ADAPTER_TEST(test_the_descriptor_is_readable_while_packets_wait_in_the_driver),
		ADAPTER_TEST(test_many_more_packets_than_transfers_arrive_in_order),
		ADAPTER_TEST(test_a_filter_passes_the_wanted_identifiers_only),
		ADAPTER_TEST(test_unplugged_the_bus_is_down_and_comes_back_when_plugged_in_again),
	};

	return cmocka_run_group_tests_name("gs_usb_port", tests, count_descriptors, no_descriptor_is_left);
}

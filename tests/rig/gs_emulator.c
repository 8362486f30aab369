/* gs_emulator FFS GADGET COMMANDS BUS [BUS2]
 *
 * A candleLight-like USB-CAN adapter in user space: a function of a USB gadget (FFS: mount point of its functionfs;
 * GADGET: its folder in configfs) with one channel for each BUS, a SocketCAN interface. Written from the description of
 * the protocol, independently of the driver's codec. Prints `ready`.
 *
 * COMMANDS is a FIFO with one command a line, for channel 0:
 *   warning, passive, active   error state that the controller reports
 *   bus-off                    bus-off until the host restarts the channel, or `restarted`
 *   restarted                  the controller leaves bus-off by itself
 *   noack, ack                 no other node acknowledges: frames are repeated, the controller becomes error passive
 *   deaf, hears                accepts frames and drops them, as an adapter with a bug
 *   garbage                    ten packets that are not frames
 *   unplug, replug
 *   report                     a line to stdout: frames from the host, frames to it, restarts */
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/usb/functionfs.h>
#include <net/if.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { CHANNELS = 2, KEPT_MAX = 64, QUEUE = 8192, CLOCK_HZ = 48000000 };
enum { HOST_FORMAT, BITTIMING, MODE, BERR, BT_CONST, DEVICE_CONFIG }; /* requests */
enum { LISTEN_ONLY = 1 << 0, TIMESTAMP = 1 << 4 };		      /* features, and flags of MODE */
#define NO_ECHO UINT32_C(0xFFFFFFFF)

struct frame { /* as on the wire, little-endian, as the host: user-mode-linux is x86 */
	uint32_t echo_id, can_id;
	uint8_t dlc, channel, flags, reserved, data[8];
	uint32_t time_us;
};
enum { PLAIN = 20, STAMPED = 24 };

struct channel {
	int bus;
	bool on, bus_off, noack, deaf;
	uint32_t flags;
	struct frame kept[KEPT_MAX]; /* not acknowledged yet */
	size_t kept_count;
	unsigned from_host, to_host, starts;
};

struct packet {
	size_t size;
	uint8_t bytes[64];
};

static struct {
	int ep0, in, out;
	const char *gadget;
	int channel_count;
	pthread_mutex_t lock; /* protects the members below */
	pthread_cond_t change;
	struct channel channels[CHANNELS];
	struct packet queue[QUEUE]; /* to the host */
	size_t queue_head, queue_count;
} adapter = {.lock = PTHREAD_MUTEX_INITIALIZER, .change = PTHREAD_COND_INITIALIZER};

static void fail(const char *what)
{
	perror(what);
	exit(1);
}

static uint32_t clock_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint32_t)(t.tv_sec * 1000000 + t.tv_nsec / 1000);
}

/* ---- to the host ------------------------------------------------------------------------------------------------- */

static void put(const void *data, size_t size)
{
	struct packet *p = &adapter.queue[(adapter.queue_head + adapter.queue_count) % QUEUE];

	if (adapter.queue_count == QUEUE) {
		fprintf(stderr, "gs_emulator: the host takes nothing, a packet is lost\n");
		return;
	}
	adapter.queue_count++;
	p->size = size;
	memcpy(p->bytes, data, size);
	pthread_cond_broadcast(&adapter.change);
}

static void to_host(struct channel *c, struct frame frame)
{
	frame.channel = (uint8_t)(c - adapter.channels);
	frame.time_us = clock_us();
	put(&frame, c->flags & TIMESTAMP ? STAMPED : PLAIN);
}

/* Writes without the lock, since it blocks until the host reads. */
static void *write_in(void *unused)
{
	struct packet packet;

	for (;;) {
		pthread_mutex_lock(&adapter.lock);
		while (adapter.queue_count == 0)
			pthread_cond_wait(&adapter.change, &adapter.lock);
		packet = adapter.queue[adapter.queue_head];
		adapter.queue_head = (adapter.queue_head + 1) % QUEUE;
		adapter.queue_count--;
		pthread_mutex_unlock(&adapter.lock);
		if (write(adapter.in, packet.bytes, packet.size) < 0 && errno != ESHUTDOWN && errno != EINTR)
			perror("in");
	}
	return unused;
}

static void error_to_host(struct channel *c, uint32_t class, uint8_t controller, uint8_t tx_errors)
{
	struct frame frame = {.echo_id = NO_ECHO, .can_id = CAN_ERR_FLAG | class, .dlc = 8};

	frame.data[1] = controller;
	frame.data[6] = tx_errors;
	to_host(c, frame);
}

/* ---- the bus ----------------------------------------------------------------------------------------------------- */

static void to_bus(struct channel *c, const struct frame *frame)
{
	struct can_frame f = {.can_id = frame->can_id, .can_dlc = frame->dlc};

	memcpy(f.data, frame->data, sizeof(f.data));
	while (write(c->bus, &f, sizeof(f)) < 0 && errno == ENOBUFS)
		usleep(1000);
	to_host(c, *frame);
}

static void send_kept(struct channel *c)
{
	for (size_t i = 0; i < c->kept_count; i++)
		to_bus(c, &c->kept[i]);
	c->kept_count = 0;
	pthread_cond_broadcast(&adapter.change);
}

/* Called with the lock held, as all functions that handle a frame. */
static void from_host(struct channel *c, const struct frame *frame)
{
	if (!c->on || (c->flags & LISTEN_ONLY))
		return;
	c->from_host++;
	if (c->deaf)
		return;
	if (!c->noack && !c->bus_off) {
		to_bus(c, frame);
		return;
	}
	while (c->kept_count == KEPT_MAX)
		pthread_cond_wait(&adapter.change, &adapter.lock);
	c->kept[c->kept_count++] = *frame;
	if (c->noack && c->kept_count == 1) {
		error_to_host(c, CAN_ERR_ACK | CAN_ERR_CRTL, CAN_ERR_CRTL_TX_WARNING, 96);
		error_to_host(c, CAN_ERR_ACK | CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE, 128);
	}
}

static void *read_out(void *unused)
{
	struct frame frame;
	uint8_t packet[512];

	for (;;) {
		ssize_t n = read(adapter.out, packet, sizeof(packet));

		if (n < 0 && errno != ESHUTDOWN && errno != EINTR)
			fail("out");
		if (n < 0)
			usleep(10000); /* unplugged */
		if (n < PLAIN)
			continue;
		memset(&frame, 0, sizeof(frame));
		memcpy(&frame, packet, PLAIN);
		pthread_mutex_lock(&adapter.lock);
		if (frame.channel < adapter.channel_count)
			from_host(&adapter.channels[frame.channel], &frame);
		pthread_mutex_unlock(&adapter.lock);
	}
	return unused;
}

static void *read_bus(void *arg)
{
	struct channel *c = arg;
	struct can_frame f;

	while (read(c->bus, &f, sizeof(f)) == sizeof(f)) {
		struct frame frame = {.echo_id = NO_ECHO, .can_id = f.can_id, .dlc = f.can_dlc};

		memcpy(frame.data, f.data, sizeof(frame.data));
		pthread_mutex_lock(&adapter.lock);
		if (c->on && !c->bus_off) {
			c->to_host++;
			to_host(c, frame);
		}
		pthread_mutex_unlock(&adapter.lock);
	}
	fail("bus");
	return NULL;
}

/* ---- requests of the host ---------------------------------------------------------------------------------------- */

static void set_mode(struct channel *c, uint32_t mode, uint32_t flags)
{
	c->on = mode == 1;
	c->flags = flags;
	c->bus_off = false;
	c->kept_count = 0;
	c->starts += c->on;
	pthread_cond_broadcast(&adapter.change);
}

static void set_all_off(void)
{
	pthread_mutex_lock(&adapter.lock);
	for (int i = 0; i < adapter.channel_count; i++)
		set_mode(&adapter.channels[i], 0, 0);
	pthread_mutex_unlock(&adapter.lock);
}

static void print_timing(const uint32_t *t)
{
	uint32_t quanta = 1 + t[0] + t[1] + t[2], brp = t[4];

	printf("bit rate %u sample point %u\n", CLOCK_HZ / quanta / brp, 1000 * (quanta - t[2]) / quanta);
	fflush(stdout);
}

/* False: not known. */
static bool answer(uint8_t request, size_t length)
{
	const uint32_t limits[10] = {LISTEN_ONLY | TIMESTAMP, CLOCK_HZ, 1, 16, 1, 8, 4, 1, 1024, 1};
	const uint8_t config[12] = {0, 0, 0, (uint8_t)(adapter.channel_count - 1), 2, 0, 0, 0, 1};
	const void *data = request == BT_CONST ? (const void *)limits : config;
	size_t size = request == BT_CONST ? sizeof(limits) : sizeof(config);

	if (request != BT_CONST && request != DEVICE_CONFIG)
		return false;
	if (write(adapter.ep0, data, size < length ? size : length) < 0)
		perror("ep0");
	return true;
}

static bool obey(uint8_t request, uint16_t value, size_t length)
{
	uint32_t data[8] = {0};

	if (request > BERR || length > sizeof(data) || (request != HOST_FORMAT && value >= adapter.channel_count))
		return false;
	/* the host continues as soon as the data are read: the mode must be set before its first frame */
	pthread_mutex_lock(&adapter.lock);
	if (read(adapter.ep0, data, length) < 0)
		perror("ep0");
	else if (request == BITTIMING)
		print_timing(data);
	else if (request == MODE)
		set_mode(&adapter.channels[value], data[0], data[1]);
	pthread_mutex_unlock(&adapter.lock);
	return true;
}

static void take_setup(const struct usb_ctrlrequest *r)
{
	bool in = r->bRequestType & USB_DIR_IN, known = (r->bRequestType & USB_TYPE_MASK) == USB_TYPE_VENDOR;
	char none = 0;

	if (known && in)
		known = answer(r->bRequest, r->wLength);
	else if (known)
		known = obey(r->bRequest, r->wValue, r->wLength);
	if (known)
		return;
	/* the wrong direction stalls the endpoint */
	if (in ? read(adapter.ep0, &none, 0) : write(adapter.ep0, &none, 0))
		return;
}

static void serve_ep0(void)
{
	struct usb_functionfs_event event;
	ssize_t n;

	for (;;) {
		n = read(adapter.ep0, &event, sizeof(event));
		if (n < 0 && errno == EINTR)
			continue;
		if (n != sizeof(event))
			fail("ep0");
		if (event.type == FUNCTIONFS_SETUP)
			take_setup(&event.u.setup);
		if (event.type == FUNCTIONFS_DISABLE || event.type == FUNCTIONFS_UNBIND)
			set_all_off();
	}
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static void write_udc(const char *name)
{
	char path[300];

	snprintf(path, sizeof(path), "%s/UDC", adapter.gadget);
	int fd = open(path, O_WRONLY | O_CLOEXEC);
	if (fd < 0 || write(fd, name, strlen(name)) < 0)
		perror(path);
	if (fd >= 0)
		close(fd);
}

static void send_garbage(void)
{
	uint8_t bytes[64];

	for (size_t i = 0; i < 10; i++) {
		size_t size = 5 + i * 6;

		for (size_t k = 0; k < sizeof(bytes); k++)
			bytes[k] = (uint8_t)(i * 37 + k * 11 + 100); /* not a valid slot */
		put(bytes, size);
	}
}

static void take_command(const char *word)
{
	struct channel *c = &adapter.channels[0];

	if (strcmp(word, "unplug") == 0 || strcmp(word, "replug") == 0) {
		write_udc(word[0] == 'u' ? "\n" : "dummy_udc.0\n");
		return;
	}
	pthread_mutex_lock(&adapter.lock);
	if (strcmp(word, "warning") == 0)
		error_to_host(c, CAN_ERR_CRTL, CAN_ERR_CRTL_TX_WARNING, 96);
	else if (strcmp(word, "passive") == 0)
		error_to_host(c, CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE, 128);
	else if (strcmp(word, "active") == 0)
		error_to_host(c, CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE, 0);
	else if (strcmp(word, "garbage") == 0)
		send_garbage();
	else if (strcmp(word, "deaf") == 0 || strcmp(word, "hears") == 0)
		c->deaf = word[0] == 'd';
	if (strcmp(word, "bus-off") == 0) {
		c->bus_off = true;
		error_to_host(c, CAN_ERR_BUSOFF, 0, 255);
	}
	if (strcmp(word, "restarted") == 0) {
		c->bus_off = false;
		error_to_host(c, CAN_ERR_RESTARTED, 0, 0);
		send_kept(c);
	}
	if (strcmp(word, "noack") == 0)
		c->noack = true;
	if (strcmp(word, "ack") == 0) {
		c->noack = false;
		send_kept(c);
		error_to_host(c, CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE, 0);
	}
	if (strcmp(word, "report") == 0)
		printf("from host %u to host %u starts %u\n", c->from_host, c->to_host, c->starts);
	fflush(stdout);
	pthread_mutex_unlock(&adapter.lock);
}

static void *read_commands(void *path)
{
	FILE *f = fopen(path, "r+");
	char word[32];

	if (f == NULL)
		fail(path);
	while (fscanf(f, "%31s", word) == 1)
		take_command(word);
	return NULL;
}

/* ---- starting ---------------------------------------------------------------------------------------------------- */

#define ENDPOINT(address, size)                                                                                     \
	{                                                                                                           \
		.bLength = USB_DT_ENDPOINT_SIZE, .bDescriptorType = USB_DT_ENDPOINT, .bEndpointAddress = (address), \
		.bmAttributes = USB_ENDPOINT_XFER_BULK, .wMaxPacketSize = (size)                                    \
	}
#define INTERFACE                                                                                                 \
	{                                                                                                         \
		.bLength = USB_DT_INTERFACE_SIZE, .bDescriptorType = USB_DT_INTERFACE, .bNumEndpoints = 2,        \
		.bInterfaceClass = USB_CLASS_VENDOR_SPEC, .bInterfaceSubClass = 0xFF, .bInterfaceProtocol = 0xFF, \
		.iInterface = 1                                                                                   \
	}

struct function {
	struct usb_interface_descriptor interface;
	struct usb_endpoint_descriptor_no_audio in, out;
} __attribute__((packed));

static const struct {
	struct usb_functionfs_descs_head_v2 head;
	uint32_t full_count, high_count;
	struct function full, high;
} __attribute__((packed)) descriptors = {
	.head = {FUNCTIONFS_DESCRIPTORS_MAGIC_V2, sizeof(descriptors), FUNCTIONFS_HAS_FS_DESC | FUNCTIONFS_HAS_HS_DESC},
	.full_count = 3,
	.high_count = 3,
	.full = {INTERFACE, ENDPOINT(0x81, 64), ENDPOINT(0x02, 64)},
	.high = {INTERFACE, ENDPOINT(0x81, 512), ENDPOINT(0x02, 512)},
};

static const struct {
	struct usb_functionfs_strings_head head;
	uint16_t language;
	char name[16];
} __attribute__((packed)) strings = {{FUNCTIONFS_STRINGS_MAGIC, sizeof(strings), 1, 1}, 0x409, "emulated gs_usb"};

static int open_file(const char *folder, const char *name)
{
	char path[300];
	int fd;

	snprintf(path, sizeof(path), "%s/%s", folder, name);
	fd = open(path, O_RDWR | O_CLOEXEC);
	if (fd < 0)
		fail(path);
	return fd;
}

static int open_bus(const char *name)
{
	struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(name)};
	int fd = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW), size = 1 << 24; /* so that no frame is lost */

	if (fd < 0 || address.can_ifindex == 0 || bind(fd, (struct sockaddr *)&address, sizeof(address)) != 0)
		fail(name);
	(void)setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof(size));
	return fd;
}

static void start(void *(*run)(void *), void *arg)
{
	pthread_t thread;

	if (pthread_create(&thread, NULL, run, arg) != 0)
		fail("thread");
}

int main(int argc, char **argv)
{
	if (argc < 5 || argc > 4 + CHANNELS) {
		fprintf(stderr, "usage: gs_emulator FFS GADGET COMMANDS BUS [BUS2]\n");
		return 2;
	}
	adapter.gadget = argv[2];
	adapter.channel_count = argc - 4;
	adapter.ep0 = open_file(argv[1], "ep0");
	if (write(adapter.ep0, &descriptors, sizeof(descriptors)) < 0 ||
		write(adapter.ep0, &strings, sizeof(strings)) < 0)
		fail("descriptors");
	adapter.in = open_file(argv[1], "ep1");
	adapter.out = open_file(argv[1], "ep2");
	for (int i = 0; i < adapter.channel_count; i++) {
		adapter.channels[i].bus = open_bus(argv[4 + i]);
		start(read_bus, &adapter.channels[i]);
	}
	start(write_in, NULL);
	start(read_out, NULL);
	start(read_commands, argv[3]);
	puts("ready");
	fflush(stdout);
	serve_ep0();
	return 0;
}

/* Arbitrary bytes as the file of stored values, as they are, or as the body of a file whose size and CRC are right. It
 * is refused, or it encodes to a file that decodes to the same; a device that starts with it has valid values. */
#include <string.h>

#include "gateway/device.h"
#include "gateway/log.h"
#include "tests/fuzz/fuzz_od.h"

enum { NODE_ID = 0x10, HEADER_SIZE = 16 };

/* Replaces gateway/log.c: the log lines are not checked and would slow the fuzzer down. */
void log_at(int severity, const char *format, ...)
{
	(void)severity;
	(void)format;
}

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->id <= 0x7FF && msg->len <= 8);
	return 0;
}

static int port_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port;
	require(ids != NULL && n > 0);
	return 0;
}

static int port_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	(void)port, (void)bit_s, (void)dry_run;
	return 0;
}

static int save(void *ctx, const uint8_t *bytes, size_t size)
{
	(void)ctx, (void)bytes, (void)size;
	return 0;
}

static void start_with(const struct store_image *image)
{
	static const struct can_ops ops = {.send = port_send, .filter = port_filter, .bit_rate = port_bit_rate};
	static const struct storing_port storage = {.save = save};
	static struct device device;
	struct can_port bus = {.ops = &ops, .bit_s = 500000};
	struct imu_port imu = {.rate_hz = 100, .silence_us = 100000};
	uint8_t node_id = image->lss.node_id ? image->lss.node_id : NODE_ID;

	memset(&device, 0, sizeof(device));
	od_init(&device.od, &imu9_od_table, &device.values, node_id);
	require(device_init(&device, &bus, &imu, &storage, image, node_id) == 0);
	device_start(&device, false, 1000);
	require(device_tick(&device, 2000) > 2000);
	require_valid_values(&device.od);
}

/* The bytes behind a header with their size, and their CRC. */
static size_t make_file(uint8_t version, const uint8_t *body, size_t size, uint8_t *file)
{
	const uint8_t header[HEADER_SIZE] = {
		'I', 'M', 'U', '9', 'S', 'T', 'O', 'R', version, 0, 0, 0, (uint8_t)size, (uint8_t)(size >> 8)};
	uint32_t crc;

	memcpy(file, header, sizeof(header));
	memcpy(file + sizeof(header), body, size);
	crc = od_crc32(0, file, sizeof(header) + size);
	for (int i = 0; i < 4; i++)
		file[sizeof(header) + size + (size_t)i] = (uint8_t)(crc >> 8 * i);
	return sizeof(header) + size + sizeof(crc);
}

static bool try(const uint8_t *file, size_t size)
{
	static struct store_image image, again;
	static uint8_t out[STORE_FILE_MAX];

	if (store_decode(&image, file, size) != 0)
		return false;
	require(store_decode(&again, out, store_encode(&image, out)) == 0);
	require(memcmp(&image, &again, sizeof(image)) == 0);
	start_with(&image);
	return true;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static uint8_t file[STORE_FILE_MAX];

	if (!try(data, size) && size > 0 && size <= STORE_FILE_MAX - HEADER_SIZE - 4)
		try(file, make_file(data[0], data + 1, size - 1, file));
	return 0;
}

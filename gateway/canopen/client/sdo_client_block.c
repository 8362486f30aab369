/* SDO block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.16), client. */
#include "gateway/canopen/client/sdo_client_private.h"

#include <string.h>

#include "gateway/canopen/crc16.h"
#include "od/little_endian.h"

enum {
	SEGMENT_BYTES = 7,
	BLOCK_SIZE_MAX = 127,
	BURST = 16, /* segments per call, so that received frames are processed in between */
	BUS_FULL_PAUSE_US = 1000,
	RETRIES_MAX = 3,
};

enum { /* client command specifiers with their subcommands, shifted */
	CCS_UPLOAD = 0xA0,
	CCS_UPLOAD_END = 0xA1,
	CCS_UPLOAD_ACKNOWLEDGE = 0xA2,
	CCS_UPLOAD_START = 0xA3,
	CCS_DOWNLOAD = 0xC0,
	CCS_DOWNLOAD_END = 0xC1,
};

enum { /* server command specifiers with their subcommands */
	SCS_DOWNLOAD = 0xA0,
	SCS_DOWNLOAD_END = 0xA1,
	SCS_DOWNLOAD_ACKNOWLEDGE = 0xA2,
	SCS_UPLOAD = 0xC0,
	SCS_UPLOAD_END = 0xC1,
	SCS_PLAIN_UPLOAD = 0x40,
};

enum {
	CS_MASK = 0xE0,
	SIZE_INDICATED = 1 << 1,
	CRC = 1 << 2,
	LAST = 1 << 7,
};

static size_t smaller(size_t a, size_t b)
{
	return a < b ? a : b;
}

static void give_up(struct sdo_client *client, uint32_t code, uint64_t now_us)
{
	sdo_client_abort(client, SDO_ABORTED, code, now_us);
}

static void begin(struct sdo_client *client, uint16_t index, uint8_t sub)
{
	sdo_client_start(client, index, sub);
	memset(&client->block, 0, sizeof(client->block));
}

/* ---- upload ------------------------------------------------------------------------------------------------------ */

void sdo_client_block_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us)
{
	begin(client, index, sub);
	client->phase = SDO_BLOCK_UPLOAD_START;
	client->in = buffer;
	client->capacity = capacity;
	client->total = SIZE_MAX;
	sdo_client_send_start(client, CCS_UPLOAD | CRC, (const uint8_t[4]){BLOCK_SIZE_MAX}, now_us);
}

static void upload_started(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	if ((data[0] & CS_MASK) == SCS_PLAIN_UPLOAD) {
		sdo_client_upload_started(client, data, now_us);
		return;
	}
	if ((data[0] & ~(CRC | SIZE_INDICATED)) != SCS_UPLOAD) {
		give_up(client, SDO_ABORT_COMMAND, now_us);
		return;
	}
	if (data[0] & SIZE_INDICATED)
		client->total = get_u32(&data[4]);
	if (data[0] & SIZE_INDICATED && client->total > client->capacity) {
		give_up(client, SDO_ABORT_MEMORY, now_us);
		return;
	}
	client->block.crc = data[0] & CRC;
	client->phase = SDO_BLOCK_UPLOAD;
	sdo_client_send(client, CCS_UPLOAD_START, NULL, 0, now_us);
}

static void acknowledge(struct sdo_client *client, uint64_t now_us)
{
	const uint8_t payload[] = {client->block.sequence, BLOCK_SIZE_MAX};

	client->block.sequence = 0;
	sdo_client_send(client, CCS_UPLOAD_ACKNOWLEDGE, payload, sizeof(payload), now_us);
}

/* `size` counts whole segments, until the end frame says how many bytes of the last one are padding. */
static bool append(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	if (client->size && client->size >= client->total) {
		give_up(client, SDO_ABORT_LENGTH, now_us);
		return false;
	}
	if (client->size && client->size >= client->capacity) {
		give_up(client, SDO_ABORT_MEMORY, now_us);
		return false;
	}
	size_t n = smaller(SEGMENT_BYTES, client->capacity - client->size);
	if (n)
		memcpy(client->in + client->size, data, n);
	client->size += SEGMENT_BYTES;
	client->block.sequence++;
	client->deadline_us = now_us + client->timeout_us;
	return true;
}

/* A segment out of order is dropped: one before it was lost, and the server repeats it after the acknowledgement. */
static void upload_segment(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	uint8_t sequence = data[0] & 0x7F;
	bool in_order = sequence == client->block.sequence + 1, last = data[0] & LAST;

	if (in_order && !append(client, &data[1], now_us))
		return;
	if (in_order && last)
		client->phase = SDO_BLOCK_UPLOAD_END;
	if (last || sequence == BLOCK_SIZE_MAX)
		acknowledge(client, now_us);
}

static void upload_end(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	uint8_t unused = data[0] >> 2 & 7;

	if ((data[0] & (CS_MASK | 3)) != SCS_UPLOAD_END) {
		give_up(client, SDO_ABORT_COMMAND, now_us);
		return;
	}
	client->size -= unused;
	if (client->size > client->capacity)
		give_up(client, SDO_ABORT_MEMORY, now_us);
	else if (client->total != SIZE_MAX && client->size != client->total)
		give_up(client, SDO_ABORT_LENGTH, now_us);
	else if (client->block.crc && canopen_crc16(0, client->in, client->size) != get_u16(data + 1))
		give_up(client, SDO_ABORT_CRC, now_us);
	else
		sdo_client_send(client, CCS_UPLOAD_END, NULL, 0, now_us);
	if (client->result == SDO_RUNNING)
		client->result = SDO_DONE;
}

/* Timeout within a sub-block: acknowledges the segments received so far, so that the server repeats the rest. When none
 * was received, the server may have missed the last acknowledgement, and a second one would mean something else. */
static bool acknowledge_partial(struct sdo_client *client, uint64_t now_us)
{
	if (client->phase != SDO_BLOCK_UPLOAD || client->block.sequence == 0)
		return false;
	acknowledge(client, now_us);
	return true;
}

/* ---- download ---------------------------------------------------------------------------------------------------- */

void sdo_client_block_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us)
{
	uint8_t tail[4];

	put_u32(tail, (uint32_t)size);
	begin(client, index, sub);
	client->phase = SDO_BLOCK_DOWNLOAD_START;
	client->out = data;
	client->total = size;
	sdo_client_send_start(client, CCS_DOWNLOAD | CRC | SIZE_INDICATED, tail, now_us);
}

static bool set_block_size(struct sdo_client *client, uint8_t size, uint64_t now_us)
{
	client->block.size = size;
	client->block.sequence = 0;
	if (size >= 1 && size <= BLOCK_SIZE_MAX)
		return true;
	give_up(client, SDO_ABORT_BLOCK_SIZE, now_us);
	return false;
}

static void download_started(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	if ((data[0] & ~CRC) != SCS_DOWNLOAD) {
		give_up(client, SDO_ABORT_COMMAND, now_us);
		return;
	}
	client->block.crc = data[0] & CRC;
	client->phase = SDO_BLOCK_DOWNLOAD;
	client->deadline_us = now_us + client->timeout_us;
	set_block_size(client, data[4], now_us);
}

/* Segments in this sub-block. An empty value has one, too. */
static size_t segments(const struct sdo_client *client)
{
	size_t left = (client->total - client->size + SEGMENT_BYTES - 1) / SEGMENT_BYTES;

	return smaller(left ? left : 1, client->block.size);
}

static void send_segment(struct sdo_client *client, uint64_t now_us)
{
	size_t from = client->size + (size_t)client->block.sequence * SEGMENT_BYTES;
	size_t left = client->total - from;
	uint8_t command = ++client->block.sequence;

	if (left <= SEGMENT_BYTES)
		command |= LAST;
	sdo_client_send(client, command, left ? client->out + from : NULL, smaller(left, SEGMENT_BYTES), now_us);
}

/* True: more is to be sent, at *next_us. */
static bool send_burst(struct sdo_client *client, uint64_t now_us, uint64_t *next_us)
{
	for (int i = 0; i < BURST && client->block.sequence < segments(client); i++) {
		if (client->bus->queue_count > 0) { /* the timeout is the server's, not that of a full bus */
			if (now_us >= client->deadline_us)
				return false;
			*next_us = now_us + BUS_FULL_PAUSE_US;
			return true;
		}
		send_segment(client, now_us);
		if (client->result != SDO_RUNNING)
			return false;
	}
	*next_us = now_us;
	return client->block.sequence < segments(client);
}

static void send_end(struct sdo_client *client, uint64_t now_us)
{
	size_t in_last = client->total ? (client->total - 1) % SEGMENT_BYTES + 1 : 0;
	uint16_t crc = client->block.crc ? canopen_crc16(0, client->out, client->total) : 0;
	uint8_t payload[2];

	put_u16(payload, crc);
	client->phase = SDO_BLOCK_DOWNLOAD_END;
	sdo_client_send(client, CCS_DOWNLOAD_END | (unsigned int)(SEGMENT_BYTES - in_last) << 2, payload,
		sizeof(payload), now_us);
}

/* The server has received the segments up to `sequence`; the next sub-block starts after it. */
static void acknowledged(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	uint8_t sequence = data[1];
	size_t bytes = smaller((size_t)sequence * SEGMENT_BYTES, client->total - client->size);

	if ((data[0] & (CS_MASK | 3)) != SCS_DOWNLOAD_ACKNOWLEDGE) {
		give_up(client, SDO_ABORT_COMMAND, now_us);
		return;
	}
	client->block.retries = sequence ? 0 : (uint8_t)(client->block.retries + 1);
	if (sequence > client->block.sequence || client->block.retries > RETRIES_MAX) {
		give_up(client, SDO_ABORT_SEQUENCE, now_us);
		return;
	}
	client->size += bytes;
	client->deadline_us = now_us + client->timeout_us;
	if (sequence && client->size == client->total)
		send_end(client, now_us);
	else
		set_block_size(client, data[2], now_us);
}

static void download_end(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	if ((data[0] & (CS_MASK | 3)) == SCS_DOWNLOAD_END)
		client->result = SDO_DONE;
	else
		give_up(client, SDO_ABORT_COMMAND, now_us);
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

bool sdo_client_block_receive(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	switch (client->phase) {
	case SDO_BLOCK_UPLOAD_START:
		upload_started(client, data, now_us);
		return true;
	case SDO_BLOCK_UPLOAD:
		upload_segment(client, data, now_us);
		return true;
	case SDO_BLOCK_UPLOAD_END:
		upload_end(client, data, now_us);
		return true;
	case SDO_BLOCK_DOWNLOAD_START:
		download_started(client, data, now_us);
		return true;
	case SDO_BLOCK_DOWNLOAD:
		acknowledged(client, data, now_us);
		return true;
	case SDO_BLOCK_DOWNLOAD_END:
		download_end(client, data, now_us);
		return true;
	default:
		return false;
	}
}

bool sdo_client_block_tick(struct sdo_client *client, uint64_t now_us, uint64_t *next_us)
{
	if (client->phase == SDO_BLOCK_DOWNLOAD && send_burst(client, now_us, next_us))
		return true;
	if (client->result != SDO_RUNNING) {
		*next_us = UINT64_MAX;
		return true;
	}
	if (now_us < client->deadline_us || !acknowledge_partial(client, now_us))
		return false;
	*next_us = client->deadline_us;
	return true;
}

/* SDO block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.16), server. */
#include "gateway/canopen/service.h"

#include <string.h>

#include "gateway/canopen/crc16.h"

enum {
	SEGMENT_BYTES = 7,
	BLOCK_SIZE_MAX = 127,
	/* Segments in a sub-block of a download. Up to 31 a sequence number differs from every command specifier, so
	 * that a new request within a sub-block is recognised; the cost is one response for 31 frames. */
	DOWNLOAD_BLOCK_SIZE = 31,
	/* All uploads together send so many segments per call, so that PDOs do not wait for whole sub-blocks. */
	BURST = 16,
	BURST_PAUSE_US = 1,
	BUS_FULL_PAUSE_US = 1000,
	/* No segment for so long means that one was lost: request it again before the client times out. */
	SILENCE_US = SDO_TIMEOUT_US / 2,
};

/* Client command specifiers with their subcommands. */
enum {
	CCS_BLOCK_UPLOAD = 5,
	CCS_BLOCK_DOWNLOAD = 6,
	SUB_INITIATE = 0, /* both; of a download only bit 0 is valid */
	SUB_END = 1,	  /* both */
	SUB_ACKNOWLEDGE = 2,
	SUB_START = 3,
};

/* First bytes of the responses. */
enum {
	SCS_DOWNLOAD_INITIATE = 0xA0,
	SCS_DOWNLOAD_END = 0xA1,
	SCS_DOWNLOAD_ACKNOWLEDGE = 0xA2,
	SCS_UPLOAD_INITIATE = 0xC0,
	SCS_UPLOAD_END = 0xC1,
};

enum {
	SIZE_INDICATED = 1 << 1, /* initiate */
	CRC = 1 << 2,		 /* initiate: supported */
	LAST = 1 << 7,		 /* segment */
	ABORT = 0x80,
};

static size_t smaller(size_t a, size_t b)
{
	return a < b ? a : b;
}

static void open_transfer(struct sdo_server *sdo, const uint8_t request[8])
{
	sdo->state = SDO_SERVER_IDLE;
	sdo->index = get_u16(request + 1);
	sdo->sub = request[3];
	memset(&sdo->block, 0, sizeof(sdo->block));
	sdo->block.crc_wanted = request[0] & CRC;
}

/* ---- download: the client writes --------------------------------------------------------------------------------- */

/* Ready for the next sub-block. */
static void expect_sub_block(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;

	sdo->block.sequence = 0;
	sdo->block.next_us = node->now_us + SILENCE_US;
}

static void initiate_download(struct canopen_node *node, const uint8_t request[8])
{
	enum od_status status;

	open_transfer(node->sdo, request);
	status = sdo_open_download(node, request[0] & SIZE_INDICATED, get_u32(request + 4));
	if (status != OD_OK) {
		sdo_abort(node, sdo_abort_code(status));
		return;
	}
	expect_sub_block(node);
	sdo_wait(node, SDO_SERVER_BLOCK_DOWNLOAD);
	sdo_answer(node, SCS_DOWNLOAD_INITIATE | CRC, DOWNLOAD_BLOCK_SIZE);
}

/* Acknowledges the last segment in order; the client continues with the one after it. */
static void acknowledge(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	const uint8_t response[8] = {SCS_DOWNLOAD_ACKNOWLEDGE, sdo->block.sequence, DOWNLOAD_BLOCK_SIZE};

	expect_sub_block(node);
	if (sdo->block.last)
		sdo->state = SDO_SERVER_BLOCK_DOWNLOAD_END;
	sdo_send(node, response);
}

/* A segment out of order is dropped: one before it was lost, and the client repeats from there. */
static void download_segment(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = node->sdo;
	uint8_t sequence = request[0] & 0x7F;
	bool last = request[0] & LAST;

	sdo_wait(node, SDO_SERVER_BLOCK_DOWNLOAD);
	sdo->block.next_us = node->now_us + SILENCE_US;
	if (sequence == sdo->block.sequence + 1) {
		if (sdo->done > 0 && sdo->done >= sdo->size) {
			sdo_abort(node, sdo_abort_code(OD_TOO_LONG));
			return;
		}
		memcpy(sdo->buffer + sdo->done, request + 1, SEGMENT_BYTES);
		sdo->done += SEGMENT_BYTES;
		sdo->block.sequence = sequence;
		sdo->block.last = last;
	}
	if (last || sequence == DOWNLOAD_BLOCK_SIZE)
		acknowledge(node);
}

static void end_download(struct canopen_node *node, const uint8_t request[8])
{
	static const uint8_t response[8] = {SCS_DOWNLOAD_END};
	struct sdo_server *sdo = node->sdo;

	sdo->done -= request[0] >> 2 & 7;
	if (sdo->done > sdo->size)
		sdo_abort(node, sdo_abort_code(OD_TOO_LONG));
	else if (sdo->size_indicated && sdo->done < sdo->size)
		sdo_abort(node, sdo_abort_code(OD_TOO_SHORT));
	else if (sdo->block.crc_wanted && canopen_crc16(0, sdo->buffer, sdo->done) != get_u16(request + 1))
		sdo_abort(node, SDO_ABORT_CRC);
	else
		sdo_write(node, response);
}

/* ---- upload: the client reads ------------------------------------------------------------------------------------ */

/* Segments in this sub-block. An empty value has one, too. */
static size_t sub_block_segments(const struct sdo_server *sdo)
{
	size_t left = (sdo->size - sdo->done + SEGMENT_BYTES - 1) / SEGMENT_BYTES;

	return smaller(left ? left : 1, sdo->block.size);
}

static bool block_size_allowed(uint8_t size)
{
	return size >= 1 && size <= BLOCK_SIZE_MAX;
}

static void initiate_upload(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = node->sdo;
	uint8_t switch_threshold = request[5]; /* bytes; up to that size the client prefers another protocol */
	enum od_status status;

	open_transfer(sdo, request);
	sdo->block.size = request[4];
	status = sdo_open_upload(node);
	if (status != OD_OK) {
		sdo_abort(node, sdo_abort_code(status));
	} else if (!block_size_allowed(sdo->block.size)) {
		sdo_abort(node, SDO_ABORT_BLOCK_SIZE);
	} else if (switch_threshold && sdo->size <= switch_threshold) {
		sdo_start_upload(node);
	} else {
		sdo_wait(node, SDO_SERVER_BLOCK_UPLOAD_START);
		sdo_answer(node, SCS_UPLOAD_INITIATE | CRC | SIZE_INDICATED, (uint32_t)sdo->size);
	}
}

static bool bus_full(const struct canopen_node *node)
{
	return node->bus->queue_count > 0;
}

static void send_segment(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	size_t from = sdo->done + (size_t)sdo->block.sequence * SEGMENT_BYTES;
	size_t left = sdo->size - from;
	uint8_t segment[8] = {++sdo->block.sequence};

	if (left <= SEGMENT_BYTES)
		segment[0] |= LAST;
	memcpy(segment + 1, sdo->data + from, smaller(left, SEGMENT_BYTES));
	sdo_send(node, segment);
}

static int uploads(const struct canopen_node *node)
{
	int n = 0;

	for (size_t i = 0; i < SDO_SERVERS; i++)
		n += node->sdo_servers[i].state == SDO_SERVER_BLOCK_UPLOAD;
	return n;
}

/* Nothing is added to the queue of a full bus: PDOs would have to wait behind it. */
static uint64_t send_burst(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	size_t segments = sub_block_segments(sdo);
	int burst = BURST / uploads(node);

	if (sdo->block.sequence < segments && node->now_us < sdo->block.next_us)
		return sdo->block.next_us;
	for (int i = 0; i < burst && sdo->block.sequence < segments && !bus_full(node); i++) {
		send_segment(node);
		sdo_wait(node, SDO_SERVER_BLOCK_UPLOAD);
	}
	if (sdo->block.sequence == segments)
		return UINT64_MAX;
	sdo->block.next_us = node->now_us + (bus_full(node) ? BUS_FULL_PAUSE_US : BURST_PAUSE_US);
	return sdo->block.next_us;
}

static void send_end(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	size_t in_last = sdo->size ? (sdo->size - 1) % SEGMENT_BYTES + 1 : 0;
	uint8_t response[8] = {(uint8_t)(SCS_UPLOAD_END | (SEGMENT_BYTES - in_last) << 2)};

	put_u16(response + 1, sdo->block.crc_wanted ? sdo->block.crc : 0);
	sdo_wait(node, SDO_SERVER_BLOCK_UPLOAD_END);
	sdo_send(node, response);
}

/* The client has received the segments up to `sequence`; the next sub-block starts after it. */
static void acknowledged(struct canopen_node *node, uint8_t sequence, uint8_t next_size)
{
	struct sdo_server *sdo = node->sdo;
	size_t bytes = smaller((size_t)sequence * SEGMENT_BYTES, sdo->size - sdo->done);
	bool all = sequence > 0 && sdo->done + bytes == sdo->size;

	if (sequence > sdo->block.sequence) {
		sdo_abort(node, SDO_ABORT_SEQUENCE);
		return;
	}
	if (!all && !block_size_allowed(next_size)) {
		sdo_abort(node, SDO_ABORT_BLOCK_SIZE);
		return;
	}
	sdo->block.crc = canopen_crc16(sdo->block.crc, sdo->data + sdo->done, bytes);
	sdo->done += bytes;
	sdo->block.sequence = 0;
	sdo->block.size = next_size;
	sdo_wait(node, SDO_SERVER_BLOCK_UPLOAD);
	if (all)
		send_end(node);
	else
		send_burst(node);
}

/* ---- requests of the client -------------------------------------------------------------------------------------- */

static bool receive_upload(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = node->sdo;

	switch (request[0] & 3) {
	case SUB_INITIATE:
		initiate_upload(node, request);
		return true;
	case SUB_START:
		if (sdo->state != SDO_SERVER_BLOCK_UPLOAD_START)
			return false;
		acknowledged(node, 0, sdo->block.size);
		return true;
	case SUB_ACKNOWLEDGE:
		if (sdo->state != SDO_SERVER_BLOCK_UPLOAD)
			return false;
		acknowledged(node, request[1], request[2]);
		return true;
	default:
		if (sdo->state != SDO_SERVER_BLOCK_UPLOAD_END)
			return false;
		sdo->state = SDO_SERVER_IDLE;
		return true;
	}
}

static bool receive_download(struct canopen_node *node, const uint8_t request[8])
{
	if ((request[0] & 1) == SUB_INITIATE)
		initiate_download(node, request);
	else if (node->sdo->state == SDO_SERVER_BLOCK_DOWNLOAD_END)
		end_download(node, request);
	else
		return false;
	return true;
}

bool sdo_block_receive(struct canopen_node *node, const uint8_t request[8])
{
	uint8_t sequence = request[0] & 0x7F;

	if (node->sdo->state == SDO_SERVER_BLOCK_DOWNLOAD && request[0] != ABORT && sequence <= DOWNLOAD_BLOCK_SIZE) {
		if (sequence == 0)
			sdo_abort(node, SDO_ABORT_SEQUENCE);
		else
			download_segment(node, request);
		return true;
	}
	switch (request[0] >> 5) {
	case CCS_BLOCK_UPLOAD:
		return receive_upload(node, request);
	case CCS_BLOCK_DOWNLOAD:
		return receive_download(node, request);
	default:
		return false;
	}
}

uint64_t sdo_block_tick(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;

	switch (sdo->state) {
	case SDO_SERVER_BLOCK_UPLOAD:
		return send_burst(node);
	case SDO_SERVER_BLOCK_DOWNLOAD:
		if (node->now_us < sdo->block.next_us)
			return sdo->block.next_us;
		acknowledge(node);
		sdo->block.next_us = UINT64_MAX; /* only once: then the client's timeout decides */
		return UINT64_MAX;
	default:
		return UINT64_MAX;
	}
}

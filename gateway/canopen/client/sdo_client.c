/* Expedited and segmented transfers (CiA 301, 7.2.4.3.3 to 7.2.4.3.8 and 7.2.4.3.17). Bits 5 to 7 of the first byte of
 * each frame are the command specifier. */
#include "gateway/canopen/client/sdo_client.h"
#include "gateway/canopen/client/sdo_client_private.h"

#include <string.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"

enum { /* client command specifiers, shifted */
	CCS_DOWNLOAD_SEGMENT = 0 << 5,
	CCS_DOWNLOAD = 1 << 5,
	CCS_UPLOAD = 2 << 5,
	CCS_UPLOAD_SEGMENT = 3 << 5,
	CS_ABORT = 4 << 5,
};

enum { /* server command specifiers, shifted */
	SCS_UPLOAD_SEGMENT = 0 << 5,
	SCS_DOWNLOAD_SEGMENT = 1 << 5,
	SCS_UPLOAD = 2 << 5,
	SCS_DOWNLOAD = 3 << 5,
};

enum {
	CS_MASK = 7 << 5,
	EXPEDITED = 1 << 1,
	SIZE_INDICATED = 1 << 0,
	TOGGLE = 1 << 4,
	LAST_SEGMENT = 1 << 0,
	SEGMENT_BYTES = 7,
	EXPEDITED_BYTES = 4,
};

void sdo_client_init(struct sdo_client *client, struct can_port *bus, uint8_t node_id, uint64_t timeout_us)
{
	*client = (struct sdo_client){
		.bus = bus,
		.node_id = node_id,
		.timeout_us = timeout_us,
	};
}

void sdo_client_send(
	struct sdo_client *client, unsigned int command, const uint8_t *payload, size_t size, uint64_t now_us)
{
	struct can_msg msg = {.id = CAN_ID_SDO_REQUEST + client->node_id, .len = 8};

	msg.data[0] = (uint8_t)command;
	if (payload)
		memcpy(&msg.data[1], payload, size);
	client->deadline_us = now_us + client->timeout_us;
	int rc = can_send(client->bus, &msg, now_us);
	if (rc < 0) {
		client->result = SDO_UNSENT;
		client->send_error = rc;
	}
}

void sdo_client_send_start(struct sdo_client *client, unsigned int command, const uint8_t tail[4], uint64_t now_us)
{
	uint8_t payload[7] = {(uint8_t)client->index, (uint8_t)(client->index >> 8), client->sub};

	memcpy(&payload[3], tail, 4);
	sdo_client_send(client, command, payload, sizeof(payload), now_us);
}

void sdo_client_abort(struct sdo_client *client, enum sdo_result result, uint32_t code, uint64_t now_us)
{
	uint8_t tail[4];

	put_u32(tail, code);
	sdo_client_send_start(client, CS_ABORT, tail, now_us);
	client->result = result;
	client->abort_code = code;
}

void sdo_client_start(struct sdo_client *client, uint16_t index, uint8_t sub)
{
	client->result = SDO_RUNNING;
	client->size = 0;
	client->abort_code = 0;
	client->aborted_by_server = false;
	client->send_error = 0;
	client->index = index;
	client->sub = sub;
	client->toggle = false;
}

void sdo_client_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us)
{
	sdo_client_start(client, index, sub);
	client->phase = SDO_UPLOAD_START;
	client->in = buffer;
	client->capacity = capacity;
	client->total = SIZE_MAX;
	sdo_client_send_start(client, CCS_UPLOAD, (const uint8_t[4]){0}, now_us);
}

void sdo_client_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us)
{
	uint8_t tail[4] = {0};
	unsigned int command = CCS_DOWNLOAD | SIZE_INDICATED;

	sdo_client_start(client, index, sub);
	client->phase = SDO_DOWNLOAD_START;
	client->out = data;
	client->total = size;
	if (size >= 1 && size <= EXPEDITED_BYTES) {
		command |= EXPEDITED | (unsigned int)(EXPEDITED_BYTES - size) << 2;
		memcpy(tail, data, size);
		client->segment = size;
	} else {
		put_u32(tail, (uint32_t)size);
		client->segment = 0;
	}
	sdo_client_send_start(client, command, tail, now_us);
}

static void request_segment(struct sdo_client *client, uint64_t now_us)
{
	sdo_client_send(client, CCS_UPLOAD_SEGMENT | (client->toggle ? TOGGLE : 0u), NULL, 0, now_us);
}

static void send_segment(struct sdo_client *client, uint64_t now_us)
{
	size_t left = client->total - client->size;
	size_t n = left < SEGMENT_BYTES ? left : SEGMENT_BYTES;
	unsigned int command = CCS_DOWNLOAD_SEGMENT | (unsigned int)(SEGMENT_BYTES - n) << 1;

	if (client->toggle)
		command |= TOGGLE;
	if (n == left)
		command |= LAST_SEGMENT;
	client->segment = n;
	sdo_client_send(client, command, n ? client->out + client->size : NULL, n, now_us);
}

/* False, and the transfer is aborted: more bytes than were indicated, or than fit. */
static bool append(struct sdo_client *client, const uint8_t *data, size_t n, uint64_t now_us)
{
	if (n > client->total - client->size) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_LENGTH, now_us);
		return false;
	}
	if (n > client->capacity - client->size) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_MEMORY, now_us);
		return false;
	}
	if (n)
		memcpy(client->in + client->size, data, n);
	client->size += n;
	return true;
}

void sdo_client_upload_started(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	bool sized = data[0] & SIZE_INDICATED;

	if (data[0] & EXPEDITED) {
		size_t unused = sized ? data[0] >> 2 & 3 : 0;

		if (append(client, &data[4], EXPEDITED_BYTES - unused, now_us))
			client->result = SDO_DONE;
		return;
	}
	if (sized)
		client->total = get_u32(&data[4]);
	if (sized && client->total > client->capacity) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_MEMORY, now_us);
		return;
	}
	client->phase = SDO_UPLOAD_SEGMENT;
	request_segment(client, now_us);
}

static void upload_segment(struct sdo_client *client, const uint8_t *data, uint64_t now_us)
{
	size_t unused = data[0] >> 1 & 7;
	bool last = data[0] & LAST_SEGMENT;

	if (unused == SEGMENT_BYTES && !last) { /* it might never end */
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_COMMAND, now_us);
		return;
	}
	if (!append(client, &data[1], SEGMENT_BYTES - unused, now_us))
		return;
	if (!last) {
		client->toggle = !client->toggle;
		request_segment(client, now_us);
		return;
	}
	if (client->total != SIZE_MAX && client->size != client->total) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_LENGTH, now_us);
		return;
	}
	client->result = SDO_DONE;
}

static void download_started(struct sdo_client *client, uint64_t now_us)
{
	if (client->segment) { /* expedited: the request had all bytes */
		client->size = client->segment;
		client->result = SDO_DONE;
		return;
	}
	client->phase = SDO_DOWNLOAD_SEGMENT;
	send_segment(client, now_us);
}

static void download_segment(struct sdo_client *client, uint64_t now_us)
{
	client->size += client->segment;
	if (client->size == client->total) {
		client->result = SDO_DONE;
		return;
	}
	client->toggle = !client->toggle;
	send_segment(client, now_us);
}

static bool is_response(const struct sdo_client *client, const struct can_msg *msg)
{
	return client->result == SDO_RUNNING && msg->id == CAN_ID_SDO_RESPONSE + client->node_id && !msg->extended &&
	       !msg->remote && msg->len == 8;
}

static bool names_object(const struct sdo_client *client, const uint8_t *data)
{
	return data[1] == (uint8_t)client->index && data[2] == client->index >> 8 && data[3] == client->sub;
}

void sdo_client_receive(struct sdo_client *client, const struct can_msg *msg, uint64_t now_us)
{
	static const uint8_t expected[] = {
		[SDO_UPLOAD_START] = SCS_UPLOAD,
		[SDO_UPLOAD_SEGMENT] = SCS_UPLOAD_SEGMENT,
		[SDO_DOWNLOAD_START] = SCS_DOWNLOAD,
		[SDO_DOWNLOAD_SEGMENT] = SCS_DOWNLOAD_SEGMENT,
	};
	const uint8_t *data = msg->data;
	bool starting = client->phase == SDO_UPLOAD_START || client->phase == SDO_DOWNLOAD_START ||
			client->phase == SDO_BLOCK_UPLOAD_START || client->phase == SDO_BLOCK_DOWNLOAD_START;
	/* the first byte of a segment of a block is its sequence number */
	bool aborted = client->phase == SDO_BLOCK_UPLOAD ? data[0] == CS_ABORT : (data[0] & CS_MASK) == CS_ABORT;

	if (!is_response(client, msg))
		return;
	if ((starting || aborted) && !names_object(client, data))
		return; /* a late response to a request that timed out, or a response to another client */
	if (aborted) {
		client->result = SDO_ABORTED;
		client->abort_code = get_u32(&data[4]);
		client->aborted_by_server = true;
		return;
	}
	if (sdo_client_block_receive(client, data, now_us))
		return;
	if (starting && (data[0] & CS_MASK) == (client->phase == SDO_UPLOAD_START ? SCS_DOWNLOAD : SCS_UPLOAD))
		return; /* a response to another client, which writes what this one reads, or reads what it writes */
	if ((data[0] & CS_MASK) != expected[client->phase]) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_COMMAND, now_us);
		return;
	}
	if (!starting && client->toggle != !!(data[0] & TOGGLE)) {
		sdo_client_abort(client, SDO_ABORTED, SDO_ABORT_TOGGLE, now_us);
		return;
	}
	switch (client->phase) {
	case SDO_UPLOAD_START:
		sdo_client_upload_started(client, data, now_us);
		break;
	case SDO_UPLOAD_SEGMENT:
		upload_segment(client, data, now_us);
		break;
	case SDO_DOWNLOAD_START:
		download_started(client, now_us);
		break;
	case SDO_DOWNLOAD_SEGMENT:
		download_segment(client, now_us);
		break;
	default:
		break;
	}
}

uint64_t sdo_client_tick(struct sdo_client *client, uint64_t now_us)
{
	uint64_t next_us;

	if (client->result != SDO_RUNNING)
		return UINT64_MAX;
	if (sdo_client_block_tick(client, now_us, &next_us))
		return next_us;
	if (now_us < client->deadline_us)
		return client->deadline_us;
	sdo_client_abort(client, SDO_TIMEOUT, SDO_ABORT_TIMEOUT, now_us);
	return UINT64_MAX;
}

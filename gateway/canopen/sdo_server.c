/* SDO server, expedited and segmented (CiA 301, 7.2.4). */
#include "gateway/canopen/service.h"

#include <string.h>

enum {
	SDO_TIMEOUT_US = 1000000, /* from one segment to the next */
	SEGMENT_BYTES = 7,
};

/* Client command specifiers: bits 7..5 of the first byte. */
enum {
	CCS_DOWNLOAD_SEGMENT = 0,
	CCS_DOWNLOAD = 1,
	CCS_UPLOAD = 2,
	CCS_UPLOAD_SEGMENT = 3,
	CCS_ABORT = 4,
};

/* First bytes of what the server says. */
enum {
	SCS_UPLOAD_SEGMENT = 0x00,
	SCS_DOWNLOAD_SEGMENT = 0x20,
	SCS_UPLOAD = 0x40,
	SCS_DOWNLOAD = 0x60,
	SCS_ABORT = 0x80,
};

enum {
	INDICATED = 1 << 0, /* initiate: the size is said */
	EXPEDITED = 1 << 1, /* initiate: the data are in this frame */
	LAST = 1 << 0,	    /* segment */
	TOGGLE = 1 << 4,    /* segment */
};

static bool is_initiate(uint8_t ccs)
{
	return ccs == CCS_DOWNLOAD || ccs == CCS_UPLOAD;
}

void sdo_server_init(struct canopen_node *node)
{
	node->sdo.request_id = 0x600u + node->id;
	node->sdo.response_id = 0x580u + node->id;
}

void sdo_server_reset(struct canopen_node *node)
{
	node->sdo.state = SDO_SERVER_IDLE;
}

/* ---- answers
 * -----------------------------------------------------------------------------------------------------
 */

static void send(struct canopen_node *node, const uint8_t data[8])
{
	node_send(node, node->sdo.response_id, data, 8);
}

/* Command, index and sub-index of the transfer, 4 bytes. */
static void fill(const struct sdo_server *sdo, uint8_t data[8], uint8_t command, uint32_t value)
{
	data[0] = command;
	put_u16(data + 1, sdo->index);
	data[3] = sdo->sub;
	put_u32(data + 4, value);
}

static void abort_transfer(struct canopen_node *node, uint32_t code)
{
	uint8_t data[8];

	node->sdo.state = SDO_SERVER_IDLE;
	fill(&node->sdo, data, SCS_ABORT, code);
	send(node, data);
}

static void expect_segment(struct canopen_node *node, enum sdo_server_state state)
{
	node->sdo.state = state;
	node->sdo.deadline_us = node->now_us + SDO_TIMEOUT_US;
}

/* ---- download: the client writes
 * --------------------------------------------------------------------------------- */

/* All is received: writes it and answers, at once or when the device has finished. */
static void write_object(struct canopen_node *node, const uint8_t response[8])
{
	struct sdo_server *sdo = &node->sdo;
	enum od_status status = od_write(node->od, sdo->index, sdo->sub, sdo->buffer, sdo->done);

	sdo->state = SDO_SERVER_IDLE;
	if (status == OD_PENDING) {
		sdo->state = SDO_SERVER_PENDING;
		memcpy(sdo->response, response, 8);
	} else if (status != OD_OK) {
		abort_transfer(node, canopen_abort_code(status));
	} else {
		send(node, response);
	}
}

void sdo_server_done(struct canopen_node *node, enum od_status status)
{
	if (node->sdo.state != SDO_SERVER_PENDING)
		return;
	node->sdo.state = SDO_SERVER_IDLE;
	if (status == OD_OK)
		send(node, node->sdo.response);
	else
		abort_transfer(node, canopen_abort_code(status));
}

/* What can be said before the data came. */
static enum od_status check_download(const struct sdo_server *sdo, const struct od_entry *entry, enum od_status found)
{
	if (!entry)
		return found;
	if (!(entry->access & OD_WRITE))
		return OD_READ_ONLY;
	if (entry->type == OD_DOMAIN)
		return OD_UNSUPPORTED_ACCESS;
	if (sdo->size_indicated && sdo->size > entry->size)
		return OD_TOO_LONG;
	if (sdo->size_indicated && sdo->size < entry->size && entry->type != OD_VISIBLE_STRING)
		return OD_TOO_SHORT;
	return OD_OK;
}

static void initiate_download(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = &node->sdo;
	bool expedited = request[0] & EXPEDITED;
	enum od_status status;
	const struct od_entry *entry = od_find(node->od->table, sdo->index, sdo->sub, &status);
	uint8_t response[8];

	sdo->size_indicated = request[0] & INDICATED;
	if (sdo->size_indicated)
		sdo->size = expedited ? 4u - (request[0] >> 2 & 3u) : get_u32(request + 4);
	status = check_download(sdo, entry, status);
	if (status != OD_OK) {
		abort_transfer(node, canopen_abort_code(status));
		return;
	}
	if (!sdo->size_indicated)
		sdo->size = entry->size;
	fill(sdo, response, SCS_DOWNLOAD, 0);
	if (expedited) {
		sdo->done = sdo->size < 4 ? sdo->size : 4;
		memcpy(sdo->buffer, request + 4, 4);
		write_object(node, response);
		return;
	}
	sdo->done = 0;
	sdo->toggle = 0;
	expect_segment(node, SDO_SERVER_DOWNLOAD);
	send(node, response);
}

static void download_segment(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = &node->sdo;
	size_t n = SEGMENT_BYTES - (request[0] >> 1 & 7);
	const uint8_t response[8] = {(uint8_t)(SCS_DOWNLOAD_SEGMENT | sdo->toggle)};

	if (n > sdo->size - sdo->done) {
		abort_transfer(node, canopen_abort_code(OD_TOO_LONG));
		return;
	}
	memcpy(sdo->buffer + sdo->done, request + 1, n);
	sdo->done += n;
	sdo->toggle ^= TOGGLE;
	if (!(request[0] & LAST)) {
		expect_segment(node, SDO_SERVER_DOWNLOAD);
		send(node, response);
	} else if (sdo->size_indicated && sdo->done < sdo->size) {
		abort_transfer(node, canopen_abort_code(OD_TOO_SHORT));
	} else {
		write_object(node, response);
	}
}

/* ---- upload: the client reads
 * ------------------------------------------------------------------------------------ */

static enum od_status open_domain(struct canopen_node *node)
{
	const struct od_domain *domain = od_find_domain(node->od, node->sdo.index, node->sdo.sub);

	if (!domain)
		return OD_NO_DATA;
	node->sdo.data = domain->data;
	node->sdo.size = domain->size;
	return OD_OK;
}

/* The value as it is now, whatever happens to it while its segments are fetched. */
static enum od_status open_upload(struct canopen_node *node)
{
	struct sdo_server *sdo = &node->sdo;
	const struct od_entry *entry = od_find(node->od->table, sdo->index, sdo->sub, NULL);

	if (entry && emcy_history_empty(node, sdo->index, sdo->sub))
		return OD_NO_DATA;
	if (entry && entry->type == OD_DOMAIN && entry->access & OD_READ)
		return open_domain(node);
	sdo->data = sdo->buffer;
	return od_read(node->od, sdo->index, sdo->sub, sdo->buffer, sizeof(sdo->buffer), &sdo->size);
}

static void initiate_upload(struct canopen_node *node)
{
	struct sdo_server *sdo = &node->sdo;
	enum od_status status = open_upload(node);
	uint8_t response[8];

	if (status != OD_OK) {
		abort_transfer(node, canopen_abort_code(status));
		return;
	}
	if (sdo->size >= 1 && sdo->size <= 4) {
		fill(sdo, response, (uint8_t)(SCS_UPLOAD | (4 - sdo->size) << 2 | EXPEDITED | INDICATED), 0);
		memcpy(response + 4, sdo->data, sdo->size);
	} else {
		fill(sdo, response, SCS_UPLOAD | INDICATED, (uint32_t)sdo->size);
		sdo->done = 0;
		sdo->toggle = 0;
		expect_segment(node, SDO_SERVER_UPLOAD);
	}
	send(node, response);
}

static void upload_segment(struct canopen_node *node)
{
	struct sdo_server *sdo = &node->sdo;
	size_t left = sdo->size - sdo->done;
	size_t n = left < SEGMENT_BYTES ? left : SEGMENT_BYTES;
	uint8_t response[8] = {(uint8_t)(SCS_UPLOAD_SEGMENT | sdo->toggle | (SEGMENT_BYTES - n) << 1)};

	memcpy(response + 1, sdo->data + sdo->done, n);
	sdo->done += n;
	sdo->toggle ^= TOGGLE;
	if (n == left) {
		response[0] |= LAST;
		sdo->state = SDO_SERVER_IDLE;
	} else {
		expect_segment(node, SDO_SERVER_UPLOAD);
	}
	send(node, response);
}

/* ---- the frames of the client
 * ------------------------------------------------------------------------------------ */

/* A new request ends what was under way, without a word: its client has given up on it. */
static void initiate(struct canopen_node *node, const uint8_t request[8])
{
	node->sdo.state = SDO_SERVER_IDLE;
	node->sdo.index = get_u16(request + 1);
	node->sdo.sub = request[3];
	if (request[0] >> 5 == CCS_DOWNLOAD)
		initiate_download(node, request);
	else
		initiate_upload(node);
}

static void segment(struct canopen_node *node, const uint8_t request[8])
{
	if ((request[0] & TOGGLE) != node->sdo.toggle)
		abort_transfer(node, ABORT_TOGGLE);
	else if (node->sdo.state == SDO_SERVER_DOWNLOAD)
		download_segment(node, request);
	else
		upload_segment(node);
}

/* Not a command that this server knows, or not one that it expects now. */
static void refuse(struct canopen_node *node, const uint8_t request[8])
{
	if (node->sdo.state == SDO_SERVER_IDLE) {
		node->sdo.index = get_u16(request + 1);
		node->sdo.sub = request[3];
	}
	abort_transfer(node, ABORT_COMMAND);
}

void sdo_server_receive(struct canopen_node *node, const struct can_msg *msg)
{
	struct sdo_server *sdo = &node->sdo;
	uint8_t ccs = msg->data[0] >> 5;

	if (msg->len != 8 || !nmt_communicates(node))
		return;
	if (is_initiate(ccs))
		initiate(node, msg->data);
	else if (ccs == CCS_ABORT)
		sdo->state = SDO_SERVER_IDLE;
	else if ((ccs == CCS_DOWNLOAD_SEGMENT && sdo->state == SDO_SERVER_DOWNLOAD) ||
		 (ccs == CCS_UPLOAD_SEGMENT && sdo->state == SDO_SERVER_UPLOAD))
		segment(node, msg->data);
	else
		refuse(node, msg->data);
}

uint64_t sdo_server_tick(struct canopen_node *node)
{
	const struct sdo_server *sdo = &node->sdo;

	if (sdo->state != SDO_SERVER_DOWNLOAD && sdo->state != SDO_SERVER_UPLOAD)
		return UINT64_MAX;
	if (node->now_us < sdo->deadline_us)
		return sdo->deadline_us;
	abort_transfer(node, ABORT_TIMEOUT);
	return UINT64_MAX;
}

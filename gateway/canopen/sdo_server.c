/* SDO server, expedited and segmented (CiA 301, 7.2.4). Block transfer is in sdo_block.c. */
#include "gateway/canopen/service.h"
#include "od_index.h"

#include <string.h>

enum { SEGMENT_BYTES = 7 };

/* Client command specifiers: bits 7..5 of the first byte. */
enum {
	CCS_DOWNLOAD_SEGMENT = 0,
	CCS_DOWNLOAD = 1,
	CCS_UPLOAD = 2,
	CCS_UPLOAD_SEGMENT = 3,
	CCS_ABORT = 4,
};

/* First bytes of the responses. */
enum {
	SCS_UPLOAD_SEGMENT = 0x00,
	SCS_DOWNLOAD_SEGMENT = 0x20,
	SCS_UPLOAD = 0x40,
	SCS_DOWNLOAD = 0x60,
	SCS_ABORT = 0x80,
};

enum {
	INDICATED = 1 << 0, /* initiate: the size is indicated */
	EXPEDITED = 1 << 1, /* initiate: the data are in this frame */
	LAST = 1 << 0,	    /* segment */
	TOGGLE = 1 << 4,    /* segment */
};

/* ---- channels: the default one, and 1201h to 1207h --------------------------------------------------------------- */

static bool has_id(uint32_t cob_id, uint32_t id)
{
	return !(cob_id & COB_ID_INVALID) && (cob_id & COB_ID_MASK) == id;
}

/* Whether an identifier belongs to one of 1201h to 1207h, other than by the COB-ID at `except`. */
static bool channel_has(const struct canopen_node *node, uint32_t id, const uint32_t *except)
{
	for (size_t i = 1; i < SDO_SERVERS; i++)
		for (size_t k = 0; k < 2; k++) {
			const uint32_t *cob_id = node->sdo_channels.cob_id[i][k];
			if (cob_id && cob_id != except && has_id(*cob_id, id))
				return true;
		}
	return false;
}

bool sdo_server_uses(const struct canopen_node *node, uint32_t cob_id)
{
	return channel_has(node, cob_id & COB_ID_MASK, NULL);
}

/* Whether another service has it. The identifiers of the default channel and of error control are restricted. */
static bool service_has(const struct canopen_node *node, uint32_t id)
{
	const struct pdos *pdos = &node->pdos;

	for (size_t i = 0; i < pdos->rpdo_count; i++)
		if (has_id(*pdos->rpdo[i].pdo.cob_id, id))
			return true;
	for (size_t i = 0; i < pdos->tpdo_count; i++)
		if (has_id(*pdos->tpdo[i].pdo.cob_id, id))
			return true;
	return (node->emcy.cob_id && has_id(*node->emcy.cob_id, id)) || (*node->sync.cob_id & COB_ID_MASK) == id ||
	       (*node->time.cob_id & (COB_ID_CONSUMES | COB_ID_PRODUCES) && (*node->time.cob_id & COB_ID_MASK) == id);
}

static bool collides(const struct canopen_node *node, uint32_t value, const uint32_t *except)
{
	uint32_t id = value & COB_ID_MASK;

	return !(value & COB_ID_INVALID) && (channel_has(node, id, except) || service_has(node, id));
}

static size_t channel_of(const struct od_entry *entry)
{
	return entry->index - OD_INDEX_SDO_SERVER_PARAMETER;
}

static enum od_status before_cob_id(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const struct canopen_node *node = ctx;
	const uint32_t *old = node->sdo_channels.cob_id[channel_of(entry)][entry->sub - 1];
	enum od_status status = cob_id_change(*old, get_u32(wire));

	(void)size;
	return status == OD_OK && collides(node, get_u32(wire), old) ? OD_INCOMPATIBLE : status;
}

/* response_id stays when the channel is closed: a client that closes its own channel still receives the response. */
static void open_channel(struct canopen_node *node, size_t n)
{
	struct sdo_server *sdo = &node->sdo_servers[n];
	uint32_t *const *cob_id = node->sdo_channels.cob_id[n];

	sdo->state = SDO_SERVER_IDLE;
	sdo->request_id = CAN_ID_NONE;
	if (!cob_id[0] || !cob_id[1] || (*cob_id[0] | *cob_id[1]) & COB_ID_INVALID)
		return;
	sdo->request_id = *cob_id[0];
	sdo->response_id = *cob_id[1];
}

static void after_cob_id(void *ctx, const struct od_entry *entry)
{
	open_channel(ctx, channel_of(entry));
	node_filter(ctx);
}

void sdo_server_init(struct canopen_node *node)
{
	struct sdo_channels *channels = &node->sdo_channels;

	node->sdo = &node->sdo_servers[0];
	for (size_t i = 0; i < SDO_SERVERS; i++)
		node->sdo_servers[i].buffer = node->sdo_buffers[i];
	for (uint16_t i = 1; i < SDO_SERVERS; i++)
		for (uint8_t k = 0; k < 2; k++)
			channels->cob_id[i][k] = od_value(node->od, (uint16_t)(OD_INDEX_SDO_SERVER_PARAMETER + i),
				(uint8_t)(k + 1), sizeof(uint32_t));
	channels->hook = (struct od_hook){.first = OD_INDEX_SDO_SERVER_PARAMETER + 1,
		.last = OD_INDEX_SDO_SERVER_PARAMETER + SDO_SERVERS - 1,
		.before = before_cob_id,
		.after = after_cob_id,
		.ctx = node};
	od_attach(node->od, &channels->hook);
}

void sdo_server_stop(struct canopen_node *node)
{
	for (size_t i = 0; i < SDO_SERVERS; i++)
		node->sdo_servers[i].state = SDO_SERVER_IDLE;
}

/* Stored values did not pass the hooks. As for PDOs, an unusable COB-ID becomes invalid where a master can read it. */
static void check_channel(struct canopen_node *node, uint16_t n)
{
	for (size_t k = 0; k < 2; k++) {
		uint32_t *cob_id = node->sdo_channels.cob_id[n][k];

		if (!cob_id || *cob_id & COB_ID_INVALID || (cob_id_in_use(*cob_id) && !collides(node, *cob_id, cob_id)))
			continue;
		*cob_id |= COB_ID_INVALID;
		node_bad_data(node, (uint16_t)(OD_INDEX_SDO_SERVER_PARAMETER + n));
	}
}

void sdo_server_reset(struct canopen_node *node)
{
	sdo_server_stop(node);
	node->sdo_servers[0].request_id = CAN_ID_SDO_REQUEST + node->id;
	node->sdo_servers[0].response_id = CAN_ID_SDO_RESPONSE + node->id;
	for (uint16_t i = 1; i < SDO_SERVERS; i++) {
		check_channel(node, i);
		open_channel(node, i);
	}
}

size_t sdo_server_ids(const struct canopen_node *node, uint32_t ids[SDO_SERVERS])
{
	size_t n = 0;

	for (size_t i = 0; i < SDO_SERVERS; i++)
		if (node->sdo_servers[i].request_id != CAN_ID_NONE)
			ids[n++] = node->sdo_servers[i].request_id;
	return n;
}

/* ---- responses --------------------------------------------------------------------------------------------------- */

void sdo_send(struct canopen_node *node, const uint8_t data[8])
{
	node_send(node, node->sdo->response_id, data, 8);
}

static void fill(const struct sdo_server *sdo, uint8_t data[8], uint8_t command, uint32_t value)
{
	data[0] = command;
	put_u16(data + 1, sdo->index);
	data[3] = sdo->sub;
	put_u32(data + 4, value);
}

void sdo_answer(struct canopen_node *node, uint8_t command, uint32_t value)
{
	uint8_t data[8];

	fill(node->sdo, data, command, value);
	sdo_send(node, data);
}

void sdo_abort(struct canopen_node *node, uint32_t code)
{
	node->sdo->state = SDO_SERVER_IDLE;
	sdo_answer(node, SCS_ABORT, code);
}

void sdo_wait(struct canopen_node *node, enum sdo_server_state state)
{
	node->sdo->state = state;
	node->sdo->deadline_us = node->now_us + SDO_TIMEOUT_US;
}

/* ---- download: the client writes --------------------------------------------------------------------------------- */

static void finish_write(struct canopen_node *node, enum od_status status, const uint8_t response[8])
{
	node->sdo->state = SDO_SERVER_IDLE;
	if (status == OD_OK)
		sdo_send(node, response);
	else
		sdo_abort(node, sdo_abort_code(status));
}

void sdo_write(struct canopen_node *node, const uint8_t response[8])
{
	struct sdo_server *sdo = node->sdo;
	enum od_status status = od_write(node->od, sdo->index, sdo->sub, sdo->buffer, sdo->done);

	if (status == OD_PENDING) {
		sdo->state = SDO_SERVER_PENDING;
		memcpy(sdo->response, response, 8);
	} else {
		finish_write(node, status, response);
	}
}

void sdo_server_done(struct canopen_node *node, enum od_status status)
{
	for (size_t i = 0; i < SDO_SERVERS; i++) {
		node->sdo = &node->sdo_servers[i];
		if (node->sdo->state == SDO_SERVER_PENDING)
			finish_write(node, status, node->sdo->response);
	}
}

static bool can_be_written(const struct od *od, const struct od_entry *entry)
{
	const struct od_domain *domain = od_find_domain(od, entry->index, entry->sub);

	return domain && domain->write;
}

static size_t size_max(const struct od_entry *entry)
{
	return entry->type == OD_DOMAIN ? OD_DOMAIN_MAX : entry->size;
}

enum od_status sdo_open_download(struct canopen_node *node, bool size_indicated, uint32_t size)
{
	struct sdo_server *sdo = node->sdo;
	enum od_status status;
	const struct od_entry *entry = od_find(node->od->table, sdo->index, sdo->sub, &status);

	if (!entry)
		return status;
	if (!(entry->access & OD_WRITE))
		return OD_READ_ONLY;
	if (entry->type == OD_DOMAIN && !can_be_written(node->od, entry))
		return OD_UNSUPPORTED_ACCESS;
	if (size_indicated && size > size_max(entry))
		return OD_TOO_LONG;
	if (size_indicated && size < entry->size && entry->type != OD_VISIBLE_STRING)
		return OD_TOO_SHORT;
	sdo->size_indicated = size_indicated;
	sdo->size = size_indicated ? size : size_max(entry);
	sdo->done = 0;
	return OD_OK;
}

static uint32_t indicated_size(const uint8_t request[8])
{
	return request[0] & EXPEDITED ? 4u - (request[0] >> 2 & 3u) : get_u32(request + 4);
}

static void initiate_download(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = node->sdo;
	enum od_status status = sdo_open_download(node, request[0] & INDICATED, indicated_size(request));
	uint8_t response[8];

	if (status != OD_OK) {
		sdo_abort(node, sdo_abort_code(status));
		return;
	}
	fill(sdo, response, SCS_DOWNLOAD, 0);
	if (request[0] & EXPEDITED) {
		sdo->done = sdo->size < 4 ? sdo->size : 4;
		memcpy(sdo->buffer, request + 4, 4);
		sdo_write(node, response);
		return;
	}
	sdo->toggle = 0;
	sdo_wait(node, SDO_SERVER_DOWNLOAD);
	sdo_send(node, response);
}

static void download_segment(struct canopen_node *node, const uint8_t request[8])
{
	struct sdo_server *sdo = node->sdo;
	size_t n = SEGMENT_BYTES - (request[0] >> 1 & 7);
	const uint8_t response[8] = {(uint8_t)(SCS_DOWNLOAD_SEGMENT | sdo->toggle)};

	if (n > sdo->size - sdo->done) {
		sdo_abort(node, sdo_abort_code(OD_TOO_LONG));
		return;
	}
	memcpy(sdo->buffer + sdo->done, request + 1, n);
	sdo->done += n;
	sdo->toggle ^= TOGGLE;
	if (!(request[0] & LAST)) {
		sdo_wait(node, SDO_SERVER_DOWNLOAD);
		sdo_send(node, response);
	} else if (sdo->size_indicated && sdo->done < sdo->size) {
		sdo_abort(node, sdo_abort_code(OD_TOO_SHORT));
	} else {
		sdo_write(node, response);
	}
}

/* ---- upload: the client reads ------------------------------------------------------------------------------------ */

static enum od_status open_domain(struct canopen_node *node)
{
	const struct od_domain *domain = od_find_domain(node->od, node->sdo->index, node->sdo->sub);

	if (!domain)
		return OD_NO_DATA;
	if (domain->read) {
		node->sdo->size = domain->read(domain->ctx, node->sdo->buffer);
		return OD_OK;
	}
	node->sdo->data = domain->data;
	node->sdo->size = domain->size;
	return OD_OK;
}

enum od_status sdo_open_upload(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	const struct od_entry *entry = od_find(node->od->table, sdo->index, sdo->sub, NULL);

	sdo->done = 0;
	sdo->data = sdo->buffer;
	if (entry && emcy_history_empty(node, sdo->index, sdo->sub))
		return OD_NO_DATA;
	if (entry && entry->type == OD_DOMAIN && entry->access & OD_READ)
		return open_domain(node);
	return od_read(node->od, sdo->index, sdo->sub, sdo->buffer, SDO_BUFFER_BYTES, &sdo->size);
}

void sdo_start_upload(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
	uint8_t response[8];

	if (sdo->size >= 1 && sdo->size <= 4) {
		fill(sdo, response, (uint8_t)(SCS_UPLOAD | (4 - sdo->size) << 2 | EXPEDITED | INDICATED), 0);
		memcpy(response + 4, sdo->data, sdo->size);
		sdo_send(node, response);
		return;
	}
	sdo->toggle = 0;
	sdo_wait(node, SDO_SERVER_UPLOAD);
	sdo_answer(node, SCS_UPLOAD | INDICATED, (uint32_t)sdo->size);
}

static void initiate_upload(struct canopen_node *node)
{
	enum od_status status = sdo_open_upload(node);

	if (status == OD_OK)
		sdo_start_upload(node);
	else
		sdo_abort(node, sdo_abort_code(status));
}

static void upload_segment(struct canopen_node *node)
{
	struct sdo_server *sdo = node->sdo;
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
		sdo_wait(node, SDO_SERVER_UPLOAD);
	}
	sdo_send(node, response);
}

/* ---- requests of the client -------------------------------------------------------------------------------------- */

/* A new request ends the transfer under way without an abort: its client has given it up. */
static void initiate(struct canopen_node *node, const uint8_t request[8])
{
	node->sdo->state = SDO_SERVER_IDLE;
	node->sdo->index = get_u16(request + 1);
	node->sdo->sub = request[3];
	if (request[0] >> 5 == CCS_DOWNLOAD)
		initiate_download(node, request);
	else
		initiate_upload(node);
}

static void segment(struct canopen_node *node, const uint8_t request[8])
{
	if ((request[0] & TOGGLE) != node->sdo->toggle)
		sdo_abort(node, SDO_ABORT_TOGGLE);
	else if (node->sdo->state == SDO_SERVER_DOWNLOAD)
		download_segment(node, request);
	else
		upload_segment(node);
}

/* An unknown command, or one that is not expected in this state. */
static void refuse(struct canopen_node *node, const uint8_t request[8])
{
	if (node->sdo->state == SDO_SERVER_IDLE) {
		node->sdo->index = get_u16(request + 1);
		node->sdo->sub = request[3];
	}
	sdo_abort(node, SDO_ABORT_COMMAND);
}

/* A client waits for each answer, so that a channel has one request at a time, or a few if programs share it. Many that
 * were received at once are a flood: to answer them would delay everything else. Segments of a block have no answer. */
static bool is_excess(struct canopen_node *node, uint8_t ccs)
{
	if (node->sdo->state == SDO_SERVER_BLOCK_DOWNLOAD || ccs == CCS_ABORT)
		return false;
	if (node->sdo_requests < SDO_REQUESTS_AT_ONCE) {
		node->sdo_requests++;
		return false;
	}
	node->sdo_excess++;
	return true;
}

static void receive(struct canopen_node *node, const struct can_msg *msg)
{
	const struct sdo_server *sdo = node->sdo;
	uint8_t ccs = msg->data[0] >> 5;

	node->sdo_short += msg->len < 8;
	if (msg->len < 8 || !nmt_communicates(node) || is_excess(node, ccs) || sdo_block_receive(node, msg->data))
		return;
	if (ccs == CCS_DOWNLOAD || ccs == CCS_UPLOAD)
		initiate(node, msg->data);
	else if (ccs == CCS_ABORT)
		node->sdo->state = SDO_SERVER_IDLE;
	else if ((ccs == CCS_DOWNLOAD_SEGMENT && sdo->state == SDO_SERVER_DOWNLOAD) ||
		 (ccs == CCS_UPLOAD_SEGMENT && sdo->state == SDO_SERVER_UPLOAD))
		segment(node, msg->data);
	else
		refuse(node, msg->data);
}

bool sdo_server_receive(struct canopen_node *node, const struct can_msg *msg)
{
	for (size_t i = 0; i < SDO_SERVERS; i++) {
		if (msg->id != node->sdo_servers[i].request_id)
			continue;
		node->sdo = &node->sdo_servers[i];
		receive(node, msg);
		return true;
	}
	return false;
}

static uint64_t tick(struct canopen_node *node)
{
	uint64_t deadline_us = sdo_block_tick(node);
	const struct sdo_server *sdo = node->sdo;

	if (sdo->state == SDO_SERVER_PENDING)
		return UINT64_MAX;
	if (node->now_us < sdo->deadline_us)
		return earlier(deadline_us, sdo->deadline_us);
	sdo_abort(node, SDO_ABORT_TIMEOUT);
	return UINT64_MAX;
}

uint64_t sdo_server_tick(struct canopen_node *node)
{
	uint64_t deadline_us = UINT64_MAX;

	node->sdo_requests = 0;
	for (size_t i = 0; i < SDO_SERVERS; i++) {
		node->sdo = &node->sdo_servers[i];
		if (node->sdo->state != SDO_SERVER_IDLE)
			deadline_us = earlier(deadline_us, tick(node));
	}
	return deadline_us;
}

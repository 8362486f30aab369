/* gateway/canopen/client/sdo_client.h
 * The client's side of SDO (CiA 301, 7.2.4.3): reads and writes the objects of another node. A
 * passive core: frames and time go in, frames go out through the CAN port; one transfer at a time;
 * expedited, segmented, and in blocks with CRC (sdo_client_block.c).
 *
 * Use: sdo_client_init(), then one of the four that start a transfer; feed every received frame to
 * sdo_client_receive() and call sdo_client_tick() at the deadline it returns, while `result` is
 * SDO_RUNNING. */
#ifndef GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_H
#define GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/sdo_abort.h"

/** What became of the last transfer. */
enum sdo_result {
	SDO_IDLE, /* none was started */
	SDO_RUNNING,
	SDO_DONE,    /* `size` bytes were transferred */
	SDO_ABORTED, /* see `abort_code` and `aborted_by_server` */
	SDO_TIMEOUT, /* the server did not answer; it was told 05040000h */
	SDO_UNSENT,  /* the bus did not take a frame; `send_error` is its -errno */
};

/** Caller-owned. Read the first part; the rest is the client's. */
struct sdo_client {
	enum sdo_result result;
	size_t size; /* bytes transferred so far */
	uint32_t abort_code;
	bool aborted_by_server; /* or else by this client, because the server broke the protocol */
	int send_error;

	struct can_port *bus;
	uint64_t timeout_us; /* from each request to its answer */
	uint8_t node_id;
	uint8_t sub;
	uint16_t index;
	enum {
		SDO_UPLOAD_START,
		SDO_UPLOAD_SEGMENT,
		SDO_DOWNLOAD_START,
		SDO_DOWNLOAD_SEGMENT,
		SDO_BLOCK_UPLOAD_START,
		SDO_BLOCK_UPLOAD,     /* segments come */
		SDO_BLOCK_UPLOAD_END, /* all came; the CRC is to come */
		SDO_BLOCK_DOWNLOAD_START,
		SDO_BLOCK_DOWNLOAD,	/* segments go, until they are acknowledged */
		SDO_BLOCK_DOWNLOAD_END, /* the CRC is sent */
	} phase;
	bool toggle; /* of the segment under way */
	uint8_t *in;
	const uint8_t *out;
	size_t total; /* upload: the size that the server announced, or SIZE_MAX; download: all
			 bytes */
	size_t capacity;
	size_t segment; /* download: bytes in the segment under way */
	uint64_t deadline_us;
	struct {
		uint8_t size;	  /* segments in a sub-block at the most */
		uint8_t sequence; /* of the last segment that came in order, or was sent */
		uint8_t in_vain;  /* tries without progress */
		bool crc;	  /* the server has one */
	} block;
};

void sdo_client_init(struct sdo_client *client, struct can_port *bus, uint8_t node_id, uint64_t timeout_us);

/** Starts to read an object into `buffer`, which must live until the end. A value above `capacity`
 * is aborted (05040005h). A transfer under way is forgotten. */
void sdo_client_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us);

/** Starts to write an object; `data` must live until the end. */
void sdo_client_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us);

/** The same in blocks: faster for large objects. A server without block transfer aborts (05040001h). */
void sdo_client_block_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us);
void sdo_client_block_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us);

/** Frames of others, and late answers to earlier requests, are ignored. */
void sdo_client_receive(struct sdo_client *client, const struct can_msg *msg, uint64_t now_us);

/** Returns when it must be called again at the latest (UINT64_MAX: never). */
uint64_t sdo_client_tick(struct sdo_client *client, uint64_t now_us);

#endif

/* gateway/canopen/client/sdo_client.h
 * SDO client (CiA 301, 7.2.4.3): reads and writes the objects of another node, on its default SDO channel (600h and
 * 580h + node-ID). A passive core: frames and time go in, frames go out through the CAN port; one transfer at a time,
 * expedited, segmented, or in blocks with CRC (sdo_client_block.c).
 *
 * Use: sdo_client_init(), then one of the four functions that start a transfer. While `result` is SDO_RUNNING, give
 * every received frame to sdo_client_receive(), and call sdo_client_tick() at the deadline that it returned last. A
 * transfer that fails says so in `result` and the fields with it; no function returns an error.
 *
 * Threads: all calls for one client come from one thread; clients share nothing but the port. Times are us of one
 * monotonic clock. */
#ifndef GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_H
#define GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/sdo_abort.h"

/** The state of the last transfer. */
enum sdo_result {
	SDO_IDLE, /* none was started */
	SDO_RUNNING,
	SDO_DONE,    /* `size` bytes were transferred */
	SDO_ABORTED, /* see `abort_code` and `aborted_by_server` */
	SDO_TIMEOUT, /* no response in time; an abort 05040000h was sent */
	SDO_UNSENT,  /* can_send() failed; `send_error` is its -errno */
};

/** Owned by the caller, who reads the first block of fields; the rest is private. */
struct sdo_client {
	enum sdo_result result;
	size_t size; /* bytes transferred so far */
	uint32_t abort_code;
	bool aborted_by_server; /* false: by this client, because the response was wrong */
	int send_error;

	struct can_port *bus;
	uint64_t timeout_us; /* from a request to its response */
	uint8_t node_id;
	uint8_t sub;
	uint16_t index;
	enum {
		SDO_UPLOAD_START,
		SDO_UPLOAD_SEGMENT,
		SDO_DOWNLOAD_START,
		SDO_DOWNLOAD_SEGMENT,
		SDO_BLOCK_UPLOAD_START,
		SDO_BLOCK_UPLOAD,     /* segments are received */
		SDO_BLOCK_UPLOAD_END, /* all are received; the CRC follows */
		SDO_BLOCK_DOWNLOAD_START,
		SDO_BLOCK_DOWNLOAD,	/* segments are sent, until they are acknowledged */
		SDO_BLOCK_DOWNLOAD_END, /* the CRC is sent */
	} phase;
	bool toggle; /* of the segment under way */
	uint8_t *in;
	const uint8_t *out;
	size_t total; /* upload: the size that the server indicated, or SIZE_MAX; download: all bytes */
	size_t capacity;
	size_t segment; /* download: bytes in the segment under way */
	uint64_t deadline_us;
	struct {
		uint8_t size;	  /* maximum of segments in a sub-block */
		uint8_t sequence; /* of the last segment received in order, or sent */
		uint8_t retries;  /* of a download, without progress */
		bool crc;	  /* the server supports it */
	} block;
};

/** For the server of `node_id`, 1 to 127. `bus` must outlive the client. Sends nothing. */
void sdo_client_init(struct sdo_client *client, struct can_port *bus, uint8_t node_id, uint64_t timeout_us);

/** Starts to read an object into `buffer`, of `capacity` bytes, which must live until the end. A longer value is
 * aborted (05040005h). A transfer under way is dropped without an abort; the server drops it with the new request. */
void sdo_client_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us);

/** Starts to write an object with `size` bytes; `data` must live until the end. */
void sdo_client_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us);

/** The same as block transfers (7.2.4.3.9 to 7.2.4.3.16), which are faster for large objects. A server without them
 * aborts (05040001h). */
void sdo_client_block_upload(
	struct sdo_client *client, uint16_t index, uint8_t sub, void *buffer, size_t capacity, uint64_t now_us);
void sdo_client_block_download(
	struct sdo_client *client, uint16_t index, uint8_t sub, const void *data, size_t size, uint64_t now_us);

/** Any frame may be given: those of other nodes, and late responses to earlier requests, are ignored. */
void sdo_client_receive(struct sdo_client *client, const struct can_msg *msg, uint64_t now_us);

/** Sends segments that are due and handles the timeout. Returns the time of the next call at the latest (UINT64_MAX:
 * none is needed). */
uint64_t sdo_client_tick(struct sdo_client *client, uint64_t now_us);

#endif

/* gateway/canopen/client/sdo_client_private.h
 * What sdo_client.c and sdo_client_block.c call of each other; no other file includes it. */
#ifndef GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_PRIVATE_H
#define GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_PRIVATE_H

#include "gateway/canopen/client/sdo_client.h"

/** Sends `command` and up to 7 payload bytes, padded with zeros, and starts the timeout. */
void sdo_client_send(
	struct sdo_client *client, unsigned int command, const uint8_t *payload, size_t size, uint64_t now_us);
/** Sends a request that names the object: `command`, index, sub-index and four bytes. */
void sdo_client_send_start(struct sdo_client *client, unsigned int command, const uint8_t tail[4], uint64_t now_us);
/** Sends an abort with `code` and ends the transfer as `result`. */
void sdo_client_abort(struct sdo_client *client, enum sdo_result result, uint32_t code, uint64_t now_us);
/** Clears the state of the last transfer. */
void sdo_client_start(struct sdo_client *client, uint16_t index, uint8_t sub);
/** The response to an upload request, or of a server that prefers it to a block upload. */
void sdo_client_upload_started(struct sdo_client *client, const uint8_t *data, uint64_t now_us);

/** False: the transfer under way is not a block transfer. */
bool sdo_client_block_receive(struct sdo_client *client, const uint8_t *data, uint64_t now_us);
/** Sends segments, or requests missing ones. True: call again at *next_us. False: the timeout applies. */
bool sdo_client_block_tick(struct sdo_client *client, uint64_t now_us, uint64_t *next_us);

#endif

/* gateway/canopen/client/sdo_client_private.h
 * Between sdo_client.c and sdo_client_block.c. */
#ifndef GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_PRIVATE_H
#define GATEWAY_CANOPEN_CLIENT_SDO_CLIENT_PRIVATE_H

#include "gateway/canopen/client/sdo_client.h"

/** `payload` are bytes 1 to 7; shorter ones are filled with zeros. */
void sdo_client_send(
	struct sdo_client *client, unsigned int command, const uint8_t *payload, size_t size, uint64_t now_us);
/** A request that names the object: its multiplexer and four bytes. */
void sdo_client_send_start(struct sdo_client *client, unsigned int command, const uint8_t tail[4], uint64_t now_us);
void sdo_client_abort(struct sdo_client *client, enum sdo_result result, uint32_t code, uint64_t now_us);
void sdo_client_start(struct sdo_client *client, uint16_t index, uint8_t sub);
/** The server answered a plain upload request, or would rather not use blocks. */
void sdo_client_upload_started(struct sdo_client *client, const uint8_t *data, uint64_t now_us);

/** False: this phase is not one of a block transfer. */
bool sdo_client_block_receive(struct sdo_client *client, const uint8_t *data, uint64_t now_us);
/** At or before the deadline: sends segments, asks for what is missing. False: the deadline stands. */
bool sdo_client_block_tick(struct sdo_client *client, uint64_t now_us, uint64_t *next_us);

#endif

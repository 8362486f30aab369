/* gateway/canopen/service.h
 * What the service files of the core call of each other; nothing outside the core includes it. Each service has
 * X_init(), once, which looks up its objects and attaches its hooks; X_reset(), after the dictionary was brought back
 * to its power-on values; and X_tick(), which does what is due at node->now_us and returns the next deadline.
 *
 * The rule: a struct of struct canopen_node is written only by the files of its own service. The others read it, or
 * call a function below. `make check-layers` enforces it. */
#ifndef GATEWAY_CANOPEN_SERVICE_H
#define GATEWAY_CANOPEN_SERVICE_H

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "gateway/canopen/node.h"
#include "gateway/canopen/sdo_abort.h"
#include "od/little_endian.h"

enum { SDO_TIMEOUT_US = 1000000 }; /* server: from one frame of a transfer to the next one of the client */

#define CAN_ID_NONE 0xFFFFFFFFu /* "not in use": no frame has this identifier */

/* ---- node.c ------------------------------------------------------------------------------------------------------ */
/** Sends a data frame. A frame that the port drops is counted there. */
void node_send(struct canopen_node *node, uint32_t id, const uint8_t *data, uint8_t len);
/** The value in the dictionary; where the optional object is absent, a zero, which switches its feature off. */
const void *node_value(const struct canopen_node *node, uint16_t index, uint8_t sub, size_t size);
/** Sets the port's receive filter to the identifiers that the services use now. */
void node_filter(struct canopen_node *node);
/** NMT reset: resets the dictionary, then every service, then sends boot-up. */
void node_reset(struct canopen_node *node, enum od_group group);
/** Raises EMCY_DATA_SET: the object at `index` has a value that its SDO checks would have refused. */
void node_bad_data(struct canopen_node *node, uint16_t index);
/** False for 29-bit and for restricted identifiers (CiA 301, 7.3.5). Bits 30 and 31 are ignored. */
bool cob_id_usable(uint32_t cob_id);
/** For EMCY and SDO: usable, and bits 30 and 31 are 0. */
bool cob_id_in_use(uint32_t cob_id);
/** For EMCY and SDO: the status of writing `value` over `old`. The identifier cannot change while it is in use. */
enum od_status cob_id_change(uint32_t old, uint32_t value);

/* ---- nmt.c ------------------------------------------------------------------------------------------------------- */
void nmt_init(struct canopen_node *node);
void nmt_receive(struct canopen_node *node, const struct can_msg *msg);
uint64_t nmt_tick(struct canopen_node *node);
void nmt_enter(struct canopen_node *node, enum nmt_state state);
/** Pre-operational or operational: SDO, SYNC, TIME and EMCY are available (CiA 301, table 37). */
bool nmt_communicates(const struct canopen_node *node);
/** A heartbeat or life guarding event, or bus-off: the state transition of 1029h:1. */
void nmt_communication_error(struct canopen_node *node);
/** Reset: the node boots up a little later, by nmt_tick(). */
void nmt_plan_boot_up(struct canopen_node *node);
/** Sends boot-up, enters pre-operational, and operational where 1F80h says so (CiA 302-2). */
void nmt_boot_up(struct canopen_node *node);

/* ---- heartbeat.c ------------------------------------------------------------------------------------------------- */
void heartbeat_init(struct canopen_node *node);
void heartbeat_reset(struct canopen_node *node);
void heartbeat_receive(struct canopen_node *node, const struct can_msg *msg);
/** No frame could be received for a while: each consumer starts again with the next heartbeat of its producer. */
void heartbeat_pause(struct canopen_node *node);
uint64_t heartbeat_tick(struct canopen_node *node);

/* ---- guard.c ----------------------------------------------------------------------------------------------------- */
void guard_init(struct canopen_node *node);
void guard_reset(struct canopen_node *node);
/** The master's remote request was received. */
void guard_receive(struct canopen_node *node);
/** No frame could be received for a while: life guarding starts again with the next request. */
void guard_pause(struct canopen_node *node);
uint64_t guard_tick(struct canopen_node *node);

/* ---- sdo_server.c ------------------------------------------------------------------------------------------------ */
void sdo_server_init(struct canopen_node *node);
void sdo_server_reset(struct canopen_node *node);
/** Ends the transfers without an abort message. */
void sdo_server_stop(struct canopen_node *node);
/** False: the frame is no request to an SDO channel that is in use. */
bool sdo_server_receive(struct canopen_node *node, const struct can_msg *msg);
/** The identifiers of the requests; returns how many. */
size_t sdo_server_ids(const struct canopen_node *node, uint32_t ids[SDO_SERVERS]);
/** Whether 1201h to 1207h have this identifier, for a request or a response. */
bool sdo_server_uses(const struct canopen_node *node, uint32_t cob_id);
uint64_t sdo_server_tick(struct canopen_node *node);
/** Sends the response that waited for the device (OD_PENDING). */
void sdo_server_done(struct canopen_node *node, enum od_status status);

/* ---- sdo_server.c, for sdo_block.c; all work on the channel node->sdo and its index and sub-index ---------------- */
void sdo_send(struct canopen_node *node, const uint8_t data[8]);
/** Sends command, index, sub-index and a 4-byte value. */
void sdo_answer(struct canopen_node *node, uint8_t command, uint32_t value);
void sdo_abort(struct canopen_node *node, uint32_t code);
/** Enters `state` and waits there for the client's next frame, for SDO_TIMEOUT_US. */
void sdo_wait(struct canopen_node *node, enum sdo_server_state state);
/** The value is complete: writes it and sends `response` or an abort, now or when the device has finished. */
void sdo_write(struct canopen_node *node, const uint8_t response[8]);
/** Checks what can be checked before the data are received, and sets `size`. */
enum od_status sdo_open_download(struct canopen_node *node, bool size_indicated, uint32_t size);
/** Sets `data` and `size` to a snapshot of the value, so that later changes of it do not reach the transfer. */
enum od_status sdo_open_upload(struct canopen_node *node);
/** Sends an opened upload expedited, or its size as the start of a segmented transfer. */
void sdo_start_upload(struct canopen_node *node);

/* ---- sdo_block.c ------------------------------------------------------------------------------------------------- */
/** False: the frame neither belongs to a block transfer under way nor starts one. */
bool sdo_block_receive(struct canopen_node *node, const uint8_t request[8]);
uint64_t sdo_block_tick(struct canopen_node *node);

/* ---- pdo.c, tpdo.c, rpdo.c --------------------------------------------------------------------------------------- */
/** 0, or -ENOSPC: the dictionary has more PDOs than the core. */
int pdo_init(struct canopen_node *node);
void pdo_reset(struct canopen_node *node);
/** Operational begins. */
void pdo_start(struct canopen_node *node);
void pdo_sample(struct canopen_node *node);
/** `counter` is that of the SYNC, 0 without one. A SYNC that is `late` counts, but no TPDO is sent. */
void pdo_sync(struct canopen_node *node, uint8_t counter, bool late);
/** A remote request for the PDO with that identifier. */
void pdo_receive_remote(struct canopen_node *node, uint32_t id);
void pdo_receive(struct canopen_node *node, const struct can_msg *msg);
/** The identifiers of the RPDOs in use; returns how many. */
size_t pdo_receive_ids(const struct canopen_node *node, uint32_t ids[RPDO_MAX]);
/** No frame could be received for a while: each event timer starts again with the next RPDO. */
void pdo_pause(struct canopen_node *node);
uint64_t pdo_tick(struct canopen_node *node);

/* ---- sync.c ------------------------------------------------------------------------------------------------------ */
void sync_init(struct canopen_node *node);
void sync_reset(struct canopen_node *node);
void sync_receive(struct canopen_node *node, const struct can_msg *msg);
/** Operational begins: no SYNC was received in it yet, so no synchronous window is closed. */
void sync_start(struct canopen_node *node);
/** No frame could be received for a while: the timeout of the SYNC starts again with the next one. */
void sync_pause(struct canopen_node *node);
/** Whether a synchronous RPDO was received within the window (1007h) of the last SYNC. */
bool sync_window_open(const struct canopen_node *node, const struct can_msg *msg);
uint64_t sync_tick(struct canopen_node *node);

/* ---- emcy.c ------------------------------------------------------------------------------------------------------ */
void emcy_init(struct canopen_node *node);
/** Before the dictionary is reset, which may raise errors itself. */
void emcy_reset(struct canopen_node *node, enum od_group group);
/** After the dictionary was reset. */
void emcy_check(struct canopen_node *node);
/** NMT stopped ends: of the EMCYs that waited, the most recent active one is sent. */
void emcy_leave_stopped(struct canopen_node *node);
uint64_t emcy_tick(struct canopen_node *node);
/** canopen_error_set() and canopen_error_clear() for an error that several sources raise independently. The source is
 * the first byte of the manufacturer-specific field. */
enum { EMCY_NO_SOURCE = 0 };
void emcy_set(struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits);
/** The same with a manufacturer-specific field of its own. */
void emcy_set_info(
	struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits, const uint8_t info[5]);
/** Raises ERROR_COMMUNICATION for a wrong frame. It ends EMCY_FORGOTTEN_US after the last one; a correct frame ends it
 * sooner by emcy_clear(), EMCY_QUIET_US after the last wrong one. Whether the error is new. */
bool emcy_set_frame(struct canopen_node *node, uint16_t code, uint8_t source, const uint8_t info[5]);
/** The cause is gone: the error ends. A communication error ends once within EMCY_QUIET_US, so that a cause that comes
 * and goes does not fill the bus. */
enum { EMCY_QUIET_US = 1000000, EMCY_FORGOTTEN_US = 10000000 };
void emcy_clear(struct canopen_node *node, uint16_t code, uint8_t source);
/** Whether this is a sub-index of 1003h that has no record yet. */
bool emcy_history_empty(const struct canopen_node *node, uint16_t index, uint8_t sub);

/* ---- store.c ----------------------------------------------------------------------------------------------------- */
void store_init(struct canopen_node *node);

/* ---- time.c ------------------------------------------------------------------------------------------------------ */
void time_init(struct canopen_node *node);
void time_reset(struct canopen_node *node);
void time_receive(struct canopen_node *node, const struct can_msg *msg);

/* ---- collision.c ------------------------------------------------------------------------------------------------- */
enum { COLLISION_IDS_MAX = 2 + SDO_SERVERS + TPDO_MAX };
/** The identifiers that only this node may send with; returns how many. */
size_t collision_ids(const struct canopen_node *node, uint32_t ids[COLLISION_IDS_MAX]);
/** True: the frame has one of them. */
bool collision_receive(struct canopen_node *node, const struct can_msg *msg);

/* ---- lss.c ------------------------------------------------------------------------------------------------------- */
void lss_init(struct canopen_node *node, uint8_t node_id);
/** After the dictionary was reset: applies the node-ID that holds from this reset on. */
void lss_reset(struct canopen_node *node, enum od_group group);
void lss_receive(struct canopen_node *node, const struct can_msg *msg);
/** The bit rate is being switched: nothing is sent, received frames are ignored, and timeouts are suspended. */
bool lss_silent(const struct canopen_node *node);
uint64_t lss_tick(struct canopen_node *node);

#endif

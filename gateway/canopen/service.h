/* gateway/canopen/service.h
 * What the service files of the core call of one another. Nobody else includes this. Each service has X_init(), once,
 * which looks its objects up and attaches its hook; X_reset(), whenever the dictionary was brought back to its power-on
 * values; X_tick(), which does what is due and returns the next deadline. They take the time from node->now_us.
 *
 * The rule: a struct of struct canopen_node is written only by the files of its own service. The others read it, or call
 * a function below. `make check-layers` holds that. */
#ifndef GATEWAY_CANOPEN_SERVICE_H
#define GATEWAY_CANOPEN_SERVICE_H

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "gateway/canopen/node.h"
#include "gateway/canopen/sdo_abort.h"
#include "od/little_endian.h"

enum { SDO_TIMEOUT_US = 1000000 }; /* from one frame of a transfer to the next */

#define CAN_ID_NONE 0xFFFFFFFFu /* no frame has it */

/* node.c */
void node_send(struct canopen_node *node, uint32_t id, const uint8_t *data, uint8_t len);
/** The value in the dictionary, or zeros where an optional object is absent: its feature is off. */
const void *node_value(const struct canopen_node *node, uint16_t index, uint8_t sub, size_t size);
/** Tells the bus which identifiers this node listens to. */
void node_filter(struct canopen_node *node);
/** NMT reset: the dictionary, then every service, then boot-up. */
void node_reset(struct canopen_node *node, enum od_group group);
/** EMCY_DATA_SET: the object at `index` holds what no SDO client could have written. */
void node_bad_data(struct canopen_node *node, uint16_t index);
/** False for 29-bit identifiers and those that CiA 301, 7.3.5 restricts. Bits 30 and 31 are not looked at. */
bool cob_id_usable(uint32_t cob_id);
/** EMCY and SDO: usable, and neither bit 30 nor bit 31 is set. */
bool cob_id_in_use(uint32_t cob_id);
/** Whether such a COB-ID may be written over another: not while that one is in use. */
enum od_status cob_id_change(uint32_t old, uint32_t value);

/* nmt.c */
void nmt_init(struct canopen_node *node);
void nmt_receive(struct canopen_node *node, const struct can_msg *msg);
uint64_t nmt_tick(struct canopen_node *node);
void nmt_enter(struct canopen_node *node, enum nmt_state state);
/** SDO, SYNC and EMCY live in these two states (CiA 301, table 37). */
bool nmt_communicates(const struct canopen_node *node);
/** A heartbeat or life guarding event, or bus-off: the state becomes what 1029h says. */
void nmt_communication_error(struct canopen_node *node);
/** Sends boot-up, enters pre-operational, and operational where 1F80h says so (CiA 302-2). */
void nmt_boot_up(struct canopen_node *node);

/* heartbeat.c */
void heartbeat_init(struct canopen_node *node);
void heartbeat_reset(struct canopen_node *node);
void heartbeat_receive(struct canopen_node *node, const struct can_msg *msg);
/** Watching begins anew with the next heartbeat of each node: none could be heard for a while. */
void heartbeat_pause(struct canopen_node *node);
uint64_t heartbeat_tick(struct canopen_node *node);

/* guard.c */
void guard_init(struct canopen_node *node);
void guard_reset(struct canopen_node *node);
void guard_receive(struct canopen_node *node); /* the master asked */
/** Life guarding starts again with the next request: none could be received for a while. */
void guard_pause(struct canopen_node *node);
uint64_t guard_tick(struct canopen_node *node);

/* sdo_server.c */
void sdo_server_init(struct canopen_node *node);
void sdo_server_reset(struct canopen_node *node);
/** Transfers end without a word. */
void sdo_server_stop(struct canopen_node *node);
void sdo_server_receive(struct canopen_node *node, const struct can_msg *msg);
uint64_t sdo_server_tick(struct canopen_node *node);
/** Gives the answer that waited for the device. */
void sdo_server_done(struct canopen_node *node, enum od_status status);

/* sdo_server.c, for sdo_block.c. The channel that is served is node->sdo, with index and sub-index. */
void sdo_send(struct canopen_node *node, const uint8_t data[8]);
/** Answers with command, index and sub-index of the transfer, and 4 bytes. */
void sdo_answer(struct canopen_node *node, uint8_t command, uint32_t value);
void sdo_abort(struct canopen_node *node, uint32_t code);
/** Waits in this state for the client's next frame, for SDO_TIMEOUT_US. */
void sdo_wait(struct canopen_node *node, enum sdo_server_state state);
/** All is received: writes it and answers, at once or when the device has finished. */
void sdo_write(struct canopen_node *node, const uint8_t response[8]);
/** Says what can be said before the data come, and sets `size`. */
enum od_status sdo_open_download(struct canopen_node *node, bool size_indicated, uint32_t size);
/** Sets `data` and `size`: the value as it is now, whatever happens to it while it is fetched. */
enum od_status sdo_open_upload(struct canopen_node *node);
/** What is open is answered at once, or in segments. */
void sdo_start_upload(struct canopen_node *node);

/* sdo_block.c */
/** False: the frame has nothing to do with a block transfer under way, nor does it start one. */
bool sdo_block_receive(struct canopen_node *node, const uint8_t request[8]);
uint64_t sdo_block_tick(struct canopen_node *node);

/* pdo.c, tpdo.c, rpdo.c */
int pdo_init(struct canopen_node *node);
void pdo_reset(struct canopen_node *node);
void pdo_start(struct canopen_node *node); /* operational begins */
void pdo_sample(struct canopen_node *node);
/** `counter` is 0 for a SYNC without one. Nothing is sent when it is `late`. */
void pdo_sync(struct canopen_node *node, uint8_t counter, bool late);
/** The PDO with that identifier is asked for. */
void pdo_receive_remote(struct canopen_node *node, uint32_t id);
void pdo_receive(struct canopen_node *node, const struct can_msg *msg);
size_t pdo_receive_ids(const struct canopen_node *node, uint32_t ids[RPDO_MAX]);
/** Monitoring begins anew with the next RPDO: none could be heard for a while. */
void pdo_pause(struct canopen_node *node);
uint64_t pdo_tick(struct canopen_node *node);

/* sync.c */
void sync_init(struct canopen_node *node);
void sync_reset(struct canopen_node *node);
void sync_receive(struct canopen_node *node, const struct can_msg *msg);
/** Operational begins: no SYNC was received in it yet, so no synchronous window is closed. */
void sync_start(struct canopen_node *node);
/** Watching begins anew with the next SYNC: none could be heard for a while. */
void sync_pause(struct canopen_node *node);
/** Whether a synchronous RPDO came in time after the last SYNC. */
bool sync_window_open(const struct canopen_node *node, const struct can_msg *msg);
uint64_t sync_tick(struct canopen_node *node);

/* emcy.c */
void emcy_init(struct canopen_node *node);
void emcy_reset(struct canopen_node *node, enum od_group group); /* before the dictionary is reset: it may raise some */
void emcy_check(struct canopen_node *node);			 /* after it */
void emcy_leave_stopped(struct canopen_node *node);
uint64_t emcy_tick(struct canopen_node *node);
/** canopen_error_set() and canopen_error_clear() for an error that several sources have, each on its own. The source is
 * the first byte of the manufacturer field. */
enum { EMCY_NO_SOURCE = 0 };
void emcy_set(struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits);
/** The same with another manufacturer field. */
void emcy_set_info(
	struct canopen_node *node, uint16_t code, uint8_t source, uint8_t register_bits, const uint8_t info[5]);
void emcy_clear(struct canopen_node *node, uint16_t code, uint8_t source);
/** 1003h: nothing was recorded at this sub-index yet. */
bool emcy_history_empty(const struct canopen_node *node, uint16_t index, uint8_t sub);

/* store.c */
void store_init(struct canopen_node *node);

/* time.c */
void time_init(struct canopen_node *node);
void time_reset(struct canopen_node *node);
void time_receive(struct canopen_node *node, const struct can_msg *msg);

/* collision.c */
enum { COLLISION_IDS_MAX = 2 + SDO_SERVERS + TPDO_MAX };
/** The identifiers that only this node sends with; how many. */
size_t collision_ids(const struct canopen_node *node, uint32_t ids[COLLISION_IDS_MAX]);
/** True: the frame has one of them. */
bool collision_receive(struct canopen_node *node, const struct can_msg *msg);
void collision_reset(struct canopen_node *node);
uint64_t collision_tick(struct canopen_node *node);

/* lss.c */
void lss_init(struct canopen_node *node);
/** Takes the node-ID that holds from this reset on, after the dictionary was reset. */
void lss_reset(struct canopen_node *node, enum od_group group);
void lss_receive(struct canopen_node *node, const struct can_msg *msg);
/** The bit rate of the bus is being switched: nothing is sent, nothing heard, and time does not count. */
bool lss_silent(const struct canopen_node *node);
uint64_t lss_tick(struct canopen_node *node);

#endif

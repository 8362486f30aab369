/* gateway/storing.h
 * The configuration in the storage: 1010h and LSS save it, 1011h clears it, and it is applied at the start and with
 * each NMT reset, on top of the values of file and command line. The format of the file is store.h's.
 *
 * Passive, one thread: the port saves, storing_saved() is called when a save that takes longer has ended. */
#ifndef GATEWAY_STORING_H
#define GATEWAY_STORING_H

#include <stdbool.h>
#include <stdint.h>

#include "gateway/canopen/canopen.h"
#include "gateway/event_log.h"
#include "gateway/record.h"
#include "gateway/store.h"
#include "od_values.h"

/** Where the file goes. save() returns 0: saved; -EINPROGRESS: storing_saved() will be called; else as store_write().
 * NULL: this device cannot store (1010h answers 08000020h). */
struct storing_port {
	void *ctx;
	int (*save)(void *ctx, const uint8_t *bytes, size_t size);
};

struct storing {
	/* PRIVATE */
	struct od *od;
	struct canopen_node *canopen;
	struct event_log *log;
	struct record *record; /* of the device */
	struct storing_port port;
	struct od_values base;	   /* defaults < file < command line: what a reset starts from */
	struct store_image stored; /* what the storage holds */
	struct store_image saving; /* what it will hold when the save in progress has ended */
	bool in_progress;
	bool lss;	 /* the save in progress was requested by LSS */
	uint8_t node_id; /* that `base` is for */
};

/** The values in the dictionary are those of file and command line. `port`: NULL or without save(): cannot store.
 * `stored`: what store_read() gave, or NULL. */
void storing_init(struct storing *s, struct od *od, struct canopen_node *canopen, struct event_log *log,
	const struct storing_port *port, const struct store_image *stored, uint8_t node_id);

/** For canopen_device.store, .restore and .store_lss. OD_PENDING: storing_saved() answers the request. OD_DEVICE_STATE:
 * a save is in progress. OD_CANNOT_STORE. */
enum od_status storing_store(struct storing *s, enum od_group group);
enum od_status storing_restore(struct storing *s, enum od_group group);
enum od_status storing_store_lss(struct storing *s, uint8_t node_id, uint32_t bit_s);
/** The key of the write lock (write_lock.h); 0: open. */
enum od_status storing_store_lock(struct storing *s, uint32_t key);

/** The save in progress has ended, `result` as of store_write(). Answers the SDO or LSS request. */
void storing_saved(struct storing *s, int result, uint64_t now_us);

/** NMT reset: the objects of the group take the values of file and command line, then the stored ones. */
void storing_reset(struct storing *s, enum od_group group, uint64_t now_us);

/** Only the stored values; at the start. */
void storing_apply(struct storing *s, enum od_group group, uint64_t now_us);

/** LSS may have given the node another node-ID: defaults that depend on it follow. True when it is another one. */
bool storing_follow_node_id(struct storing *s, uint8_t node_id);

#endif

/* gateway/config.h
 * Where the configuration comes from: defaults < FILE < command line (< what 1010h stored, applied
 * by the device).
 *
 * FILE is INI: a section [gateway] with the process's own keys (imu, can, node_id, bitrate, store,
 * realtime, serial, run_led, error_led), and every object of the dictionary by its EDS name, as `lever_arm.l = 0.05` before any
 * section or `l = 0.05` in [lever_arm]. Anything unknown is an error that names file:line. */
#ifndef GATEWAY_CONFIG_H
#define GATEWAY_CONFIG_H

#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum { CONFIG_TEXT_MAX = 256, CONFIG_ERROR_MAX = 512, CONFIG_OBJECTS_MAX = 256 };

struct config {
	char imu[CONFIG_TEXT_MAX];
	char can[CONFIG_TEXT_MAX];
	char store[CONFIG_TEXT_MAX];				   /* folder; empty: the default one */
	char run_led[CONFIG_TEXT_MAX], error_led[CONFIG_TEXT_MAX]; /* under /sys/class/leds; empty: none */
	unsigned node_id;					   /* 255: waits for one by LSS */
	unsigned bitrate;					   /* bit/s; 0: as the interface is */
	unsigned realtime;					   /* SCHED_FIFO priority; 0: ordinary scheduling */
	unsigned serial;					   /* 1018h:4; 0: made of machine, sensor and bus */

	/* PRIVATE: objects set so far, applied by config_apply() once the node-ID is known */
	struct config_object {
		uint16_t index;
		uint8_t sub;
		uint8_t size;
		uint8_t wire[OD_VALUE_MAX];
	} objects[CONFIG_OBJECTS_MAX];
	size_t object_count;
	const struct od_table *table;
};

void config_init(struct config *config, const struct od_table *table);
/** 0, or -errno and one line in error[CONFIG_ERROR_MAX]. */
int config_file(struct config *config, const char *path, char *error);
/** A key of [gateway], e.g. ("node_id", "5"). -ENOENT: no such key. */
int config_option(struct config *config, const char *key, const char *value, char *error);
/** "NAME=VALUE" of --set. */
int config_set(struct config *config, const char *assignment, char *error);
/** Brings the objects into the dictionary (od_put()). */
void config_apply(const struct config *config, struct od *od);

#endif

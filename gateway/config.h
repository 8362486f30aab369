/* gateway/config.h
 * The configuration of the process: defaults < FILE < command line. What 1010h stored has precedence; the device
 * applies it.
 *
 * FILE is INI: a section [gateway] with the keys of the process (imu, can, node_id, bitrate, store, record, realtime,
 * serial, vendor_id, run_led, error_led, log_level, cia309, modbus), and configuration objects by their EDS names, in
 * their units:
 * `lever_arm.l = 0.05` before any section or `l = 0.05` in [lever_arm]. An unknown name is an error with file:line. One
 * thread. */
#ifndef GATEWAY_CONFIG_H
#define GATEWAY_CONFIG_H

#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum { CONFIG_TEXT_MAX = 256, CONFIG_ERROR_MAX = 512, CONFIG_OBJECTS_MAX = 512, CONFIG_LIST_MAX = 1024 };

struct config {
	char imu[CONFIG_TEXT_MAX];
	char can[CONFIG_TEXT_MAX];
	char store[CONFIG_TEXT_MAX];				   /* folder; empty: the default of main.c */
	char record[CONFIG_TEXT_MAX];				   /* folder and options; empty: nothing is recorded */
	char run_led[CONFIG_TEXT_MAX], error_led[CONFIG_TEXT_MAX]; /* under /sys/class/leds; empty: none */
	char cia309[CONFIG_LIST_MAX];				   /* addresses of CiA 309-3, one a line; empty: none */
	char modbus[CONFIG_LIST_MAX]; /* windows of the Modbus server, one a line; empty: none */
	unsigned node_id;	      /* 1..127; 255: unconfigured, LSS assigns one */
	unsigned bitrate;	      /* bit/s; 0: unchanged */
	unsigned realtime;	      /* SCHED_FIFO priority; 0: ordinary scheduling */
	unsigned serial;	      /* 1018h:4; 0: see serial.h */
	unsigned vendor_id;	      /* 1018h:1; 0: that of the EDS */
	unsigned log_level;	      /* severity of syslog(3): lines that are less severe are not written */

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
/** The functions that follow return 0, or -errno and one line in error[CONFIG_ERROR_MAX]. -ENOENT: unknown name;
 * -EACCES: not a configuration object; -E2BIG: too many; -EINVAL: bad value or syntax; others: FILE cannot be read. */
int config_file(struct config *config, const char *path, char *error);
/** A key of [gateway], e.g. ("node_id", "5"). */
int config_option(struct config *config, const char *key, const char *value, char *error);
/** The first key of [gateway], from number *from on (0 at first), that differs; *from is that behind it. NULL: none. */
const char *config_changed(const struct config *before, const struct config *after, size_t *from);
/** The argument "NAME=VALUE" of --set. */
int config_set(struct config *config, const char *assignment, char *error);
/** Writes the objects into the dictionary (od_put()). */
void config_apply(const struct config *config, struct od *od);

#endif

/* gateway/modbus/access.h
 * What a client of the Modbus server reads and writes (struct modbus_registers): the map over the snapshots of the
 * link, and jobs for the loop. The loop executes them by modbus_execute(). */
#ifndef GATEWAY_MODBUS_ACCESS_H
#define GATEWAY_MODBUS_ACCESS_H

#include "gateway/modbus/link.h"
#include "gateway/modbus/map.h"

/** One client. Of the thread. */
struct modbus_access {
	struct modbus_registers registers; /* for modbus_pdu() */

	/* PRIVATE */
	struct modbus_link *link;
	const struct modbus_map *map;
	const struct od_table *table;
	char who[MODBUS_WHO_MAX];
	char text[OD_VALUE_MAX + 1];
	struct {
		uint16_t index;
		uint8_t sub;
		const uint8_t *data; /* NULL: none */
		size_t size;
		uint8_t bytes[OD_DOMAIN_MAX];
	} upload; /* a DOMAIN that is read in parts */
};

void modbus_access_init(struct modbus_access *access, struct modbus_link *link, const struct modbus_map *map,
	const struct od_table *table, const char *who, bool may_write, uint32_t (*abort_code)(enum od_status));

/** Whose write is told: each value, or an object of type DOMAIN (wire NULL), with its result. */
typedef void modbus_wrote(
	void *ctx, const char *who, const struct od_entry *entry, const void *wire, size_t size, enum od_status status);

/** od_write(), or what does more than that. */
typedef enum od_status modbus_write(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** Executes a job on the dictionary. A write of several values changes all of them or none; values that cannot be read
 * are written alone. Of the loop. */
void modbus_execute(struct modbus_job *job, const struct modbus_map *map, struct od *od, bool low_first,
	modbus_write *write, modbus_wrote *wrote, void *ctx);

#endif

/* tools/cli_node.h
 * A node on the bus, as a command-line program wants it: one blocking call for one SDO transfer. */
#ifndef TOOLS_CLI_NODE_H
#define TOOLS_CLI_NODE_H

#include "gateway/canopen/sdo_client.h"
#include "od/od.h"
#include "tools/cli.h"

struct cli_node {
	struct can_port *bus;
	const char *bus_name;
	uint8_t id;
	unsigned int timeout_ms;
	struct sdo_client sdo; /* tells what became of the last transfer, and its size */
};

/** Opens the bus, or ends the program. */
void cli_node_open(struct cli_node *node, const char *bus, uint8_t id, unsigned int timeout_ms);
void cli_node_close(struct cli_node *node);

/** True when done: sdo.size bytes. */
bool cli_node_read(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity);
bool cli_node_write(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** Says on stderr why the last transfer failed and what to do. `entry` (or NULL) lends its name and
 * its limits. */
void cli_node_explain(const struct cli_node *node, const struct od_entry *entry);

#endif

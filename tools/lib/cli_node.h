/* tools/lib/cli_node.h
 * A node on the bus, as a command-line program wants it: one blocking call for one SDO transfer. */
#ifndef TOOLS_LIB_CLI_NODE_H
#define TOOLS_LIB_CLI_NODE_H

#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"
#include "tools/lib/cli.h"

/** When a transfer goes in blocks (cli_node_read_large(), cli_node_write_large()). */
enum cli_blocks {
	CLI_BLOCKS_LARGE, /* when it is large; in segments if the node cannot do blocks */
	CLI_BLOCKS_ALWAYS,
	CLI_BLOCKS_NEVER,
};

struct cli_node {
	struct can_port *bus;
	const char *bus_name;
	uint8_t id;
	unsigned int timeout_ms;
	enum cli_blocks blocks;
	bool show_progress;    /* of large transfers, when standard error is a terminal */
	struct sdo_client sdo; /* tells what became of the last transfer, and its size */
};

/** Opens the bus, or ends the program. */
void cli_node_open(struct cli_node *node, const char *bus, uint8_t id, unsigned int timeout_ms);
/** The same on a bus that is open already, and is not closed here. */
void cli_node_use(
	struct cli_node *node, struct can_port *bus, const char *bus_name, uint8_t id, unsigned int timeout_ms);
void cli_node_close(struct cli_node *node);

/** True when done: sdo.size bytes. */
bool cli_node_read(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity);
bool cli_node_write(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** For DOMAINs: in blocks, with a progress bar. */
bool cli_node_read_large(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity);
bool cli_node_write_large(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** Says on stderr why the last transfer failed and what to do. `entry` (or NULL) lends its name and
 * its limits. */
void cli_node_explain(const struct cli_node *node, const struct od_entry *entry);

#endif

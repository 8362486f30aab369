/* tools/lib/cli_node.h
 * Access to a node for command-line programs: one blocking call for each SDO transfer. */
#ifndef TOOLS_LIB_CLI_NODE_H
#define TOOLS_LIB_CLI_NODE_H

#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"
#include "tools/lib/cli.h"

/** When block transfer is used (cli_node_read_large(), cli_node_write_large()). */
enum cli_blocks {
	CLI_BLOCKS_LARGE, /* for large values; segmented if the node does not support it */
	CLI_BLOCKS_ALWAYS,
	CLI_BLOCKS_NEVER,
};

struct cli_node {
	struct can_port *bus;
	const char *bus_name;
	uint8_t id;
	unsigned int timeout_ms;
	enum cli_blocks blocks;
	bool show_progress;    /* of large transfers, if standard error is a terminal */
	struct sdo_client sdo; /* holds result and size of the last transfer */
};

/** Opens the bus, or ends the program. */
void cli_node_open(struct cli_node *node, const char *bus, uint8_t id, unsigned int timeout_ms);
/** Likewise, on a bus that the caller has opened and closes. */
void cli_node_use(
	struct cli_node *node, struct can_port *bus, const char *bus_name, uint8_t id, unsigned int timeout_ms);
void cli_node_close(struct cli_node *node);

/** True: transferred sdo.size bytes. */
bool cli_node_read(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity);
bool cli_node_write(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** For DOMAINs: block transfer, with a progress bar. */
bool cli_node_read_large(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity);
bool cli_node_write_large(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** Prints on stderr why the last transfer failed and what to do, with the name and limits of `entry` (or NULL). */
void cli_node_explain(const struct cli_node *node, const struct od_entry *entry);

#endif

/* tools/eds/modbus_map.h
 * The register map of the Modbus server, made from the EDS. See modbus_map.c for its rules. */
#ifndef TOOLS_EDS_MODBUS_MAP_H
#define TOOLS_EDS_MODBUS_MAP_H

#include <stdio.h>

#include "tools/eds/eds.h"

struct modbus_layout;

/** NULL, and a reason in error: an object does not fit into the map. */
struct modbus_layout *modbus_layout_new(const struct eds *eds, char *error, size_t error_size);
void modbus_layout_free(struct modbus_layout *layout);

/** The table of gateway/modbus/map.h as C; tables for people; CSV; inputs of telegraf and a flow of Node-RED. */
void modbus_print_c(FILE *out, const struct modbus_layout *layout);
void modbus_print_markdown(FILE *out, const struct modbus_layout *layout);
void modbus_print_csv(FILE *out, const struct modbus_layout *layout);
void modbus_print_telegraf(FILE *out, const struct modbus_layout *layout);
void modbus_print_node_red(FILE *out, const struct modbus_layout *layout);

#endif

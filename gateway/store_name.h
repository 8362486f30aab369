/* gateway/store_name.h
 * Where the file of 1010h is: one for each bus in the folder, since the node-ID can change. The name is that of the bus
 * without its options, so that another option finds the same values. */
#ifndef GATEWAY_STORE_NAME_H
#define GATEWAY_STORE_NAME_H

#include <stddef.h>

/** The bus without options, in characters that a file name may have: "can0", "slcan__dev_ttyACM0". */
void store_bus_name(char *out, size_t size, const char *bus);

/** PATH = FOLDER/NAME.store. */
void store_path(char *path, size_t size, const char *folder, const char *bus);

/** Names of earlier versions have the options of the bus (0.2), or are node-N.store (0.1). When there is no PATH, the
 * newest such file is renamed to it. 1, and its name in old[size]; 0: there is none; -errno: it cannot be renamed. */
int store_take_over(const char *path, const char *folder, const char *bus, unsigned node_id, char *old, size_t size);

#endif

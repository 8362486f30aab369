/* gateway/pdo_preset.h
 * 2148h: one write maps TPDO1 to TPDO4 for a purpose. It writes the communication and mapping parameters through the
 * dictionary, as a master would, within one call, so that no PDO is sent in between; what cannot be mapped changes
 * nothing. One thread. */
#ifndef GATEWAY_PDO_PRESET_H
#define GATEWAY_PDO_PRESET_H

#include "od/od.h"

/** Caller-owned. */
struct pdo_preset {
	/* PRIVATE */
	struct od *od;
	uint8_t *value; /* 2148h */
	bool applying;
	struct od_hook command, mapping;
};

/** Attaches to the dictionary, after the core has. */
void pdo_preset_attach(struct pdo_preset *preset, struct od *od, uint8_t *value);
/** The dictionary was set without its hooks (start, reset): 2148h shows which preset is mapped. */
void pdo_preset_update(struct pdo_preset *preset);

#endif

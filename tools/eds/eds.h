/* tools/eds/eds.h
 * Loads an electronic data sheet (CiA 306) into a table that od/ works on. Two users: gen-od with
 * the device's own file at build time (EDS_STRICT), and imu9-sdo at run time with other people's
 * files (EDS_LENIENT).
 *
 * Beyond CiA 306 these keys of an entry are understood: Unit, Factor, Description (as
 * python-canopen reads them), StringSize (bytes of a VISIBLE_STRING or OCTET_STRING), and for REALs
 * RealDefault, RealLowLimit, RealHighLimit as decimal text, because tools disagree on how
 * DefaultValue writes a REAL (0x... is taken as its IEEE 754 bits). */
#ifndef TOOLS_EDS_EDS_H
#define TOOLS_EDS_EDS_H

#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum eds_rules {
	EDS_LENIENT, /* takes whatever still tells type and access of each entry without doubt */
	EDS_STRICT,  /* everything that must hold for our own file: lists, counts, limits, PDO
			mappings, unique names */
};

enum eds_kind { EDS_VAR, EDS_ARRAY, EDS_RECORD };

struct eds_object {
	uint16_t index;
	enum eds_kind kind;
	unsigned line;		 /* of its section */
	const char *label;	 /* ParameterName as written */
	const char *name;	 /* normalised */
	const char *description; /* or "" */
	size_t first, count;	 /* its entries in the table */
};

/** What belongs to a table entry besides struct od_entry. */
struct eds_entry {
	const char *label; /* ParameterName as written: of the object for a VAR, else of the
			      sub-index */
	unsigned line;
	const char *value; /* DCF: its ParameterValue; NULL: none */
};

struct eds_info {
	const char *file_name, *description; /* [FileInfo] */
	uint32_t file_version, file_revision;
	const char *vendor_name, *product_name, *order_code; /* [DeviceInfo] */
	uint32_t vendor_number, product_number, revision_number;
	uint32_t rpdo_count, tpdo_count;
	uint32_t node_id; /* [DeviceComissioning] of a DCF; 0: none */
};

struct eds {
	struct od_table table;
	struct eds_object *objects; /* sorted by index */
	size_t object_count;
	struct eds_entry *entries; /* as many as, and in the order of, table.entries */
	struct eds_info info;
	void *memory; /* PRIVATE: owns all of the above */
};

/** 0 with *eds to be freed by eds_free(), or -errno with "file:line: what, and what to do" in
 * `error`: -EINVAL a fault in the file, -ENOMEM, or why the file could not be read. */
int eds_load(struct eds *eds, const char *path, enum eds_rules rules, char *error, size_t error_size);

/** The same for text in memory; `path` is only for the error text. */
int eds_parse(struct eds *eds, const char *path, const char *text, size_t size, enum eds_rules rules, char *error,
	size_t error_size);

void eds_free(struct eds *eds);

/** A value as an EDS or DCF writes it, for that node-ID: $NODEID, hexadecimal, IEEE 754 bits. */
enum od_status eds_value(
	const struct od_entry *entry, const char *text, uint8_t node_id, void *wire, size_t capacity, size_t *size);

/** A ParameterName in its normalised form: lower case, runs of other characters than letters and
 * digits as one '_', none at the ends. Returns its length, cut to fit. */
size_t eds_normalise(const char *label, char *name, size_t capacity);

#endif

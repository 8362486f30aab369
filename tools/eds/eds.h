/* tools/eds/eds.h
 * Loads an electronic data sheet (CiA 306) into an object dictionary table. Two users: gen-od with the device's own
 * file at build time (EDS_STRICT), and imu9-sdo at run time with files of other devices (EDS_LENIENT).
 *
 * Keys in addition to CiA 306, as keys or in comments (";Unit=m"): Unit, Factor, Description (as python-canopen reads
 * them), Resolution (name of the entry whose value, times its own Factor, is one step of this one; Factor is then the
 * step by default), StringSize (bytes of a VISIBLE_STRING or OCTET_STRING), Stored, and for REALs RealDefault,
 * RealLowLimit and RealHighLimit as decimal text: tools differ in how DefaultValue writes a REAL. Here 0x... means its
 * IEEE 754 bits.
 *
 * The name of an entry is "object.sub". A ParameterName of a sub-index that begins with that of its object stands alone
 * in other tools, "Lever arm l"; here the repetition is left out: "lever_arm.l". */
#ifndef TOOLS_EDS_EDS_H
#define TOOLS_EDS_EDS_H

#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum eds_rules {
	EDS_LENIENT, /* accepts a file as long as type and access of each entry are unambiguous */
	EDS_STRICT,  /* for the device's own file: also checks lists, counts, limits, PDO mappings and unique names */
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

/** Data of a table entry that struct od_entry does not have. */
struct eds_entry {
	const char *label; /* ParameterName as written: of the object for a VAR, else of the sub-index */
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

/** 0: free *eds with eds_free(). Or -errno and "file:line: what, and what to do" in `error`: -EINVAL an error in the
 * file, -ENOMEM, or the reason why the file could not be read. */
int eds_load(struct eds *eds, const char *path, enum eds_rules rules, char *error, size_t error_size);

/** The same for text in memory; `path` is used in the error text only. */
int eds_parse(struct eds *eds, const char *path, const char *text, size_t size, enum eds_rules rules, char *error,
	size_t error_size);

void eds_free(struct eds *eds);

/** Parses a value in the notation of an EDS or DCF for this node-ID: $NODEID, hexadecimal, IEEE 754 bits. */
enum od_status eds_value(
	const struct od_entry *entry, const char *text, uint8_t node_id, void *wire, size_t capacity, size_t *size);

/** The normalised form of a ParameterName: lower case, '_' for each run of characters other than letters and digits,
 * none at the ends. Returns its length, truncated to fit. */
size_t eds_normalise(const char *label, char *name, size_t capacity);

/** The data type as CiA 301 writes it, "UNSIGNED16". */
const char *eds_type_name(const struct od_entry *entry);

#endif

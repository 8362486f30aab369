/* od/od.h
 * The object dictionary: typed, bounded, named values (CiA 301, 7.4). It does not depend on CAN or Modbus; both write
 * through od_write(), so the same checks apply to both.
 *
 * The table (struct od_table) is generated from eds/imu9-gateway.eds and is constant; the values are one struct owned
 * by the caller (struct od_values of the generated od_values.h), so that C code reads `values.lever_arm.l` directly.
 * Values are in host byte order in the struct and little-endian ("wire", as CiA 301 transmits them) at od_read() and
 * od_write(). Nothing here allocates memory, blocks or has global state. */
#ifndef OD_OD_H
#define OD_OD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/** Data types by their CiA 301 index (table 44). */
enum od_type {
	OD_BOOLEAN = 0x01,
	OD_INTEGER8 = 0x02,
	OD_INTEGER16 = 0x03,
	OD_INTEGER32 = 0x04,
	OD_UNSIGNED8 = 0x05,
	OD_UNSIGNED16 = 0x06,
	OD_UNSIGNED32 = 0x07,
	OD_REAL32 = 0x08,
	OD_VISIBLE_STRING = 0x09, /* NUL-padded in a field of od_entry.size bytes */
	OD_OCTET_STRING = 0x0A,	  /* fixed length: od_entry.size bytes */
	OD_DOMAIN = 0x0F,	  /* not in the values struct: see struct od_domain */
	OD_REAL64 = 0x11,
	OD_INTEGER64 = 0x15,
	OD_UNSIGNED64 = 0x1B,
};

/** Bits of od_entry.access. */
enum {
	OD_READ = 1 << 0,
	OD_WRITE = 1 << 1,
	OD_CONST = 1 << 2,  /* does not change after start-up */
	OD_TPDO = 1 << 3,   /* mappable into a TPDO */
	OD_RPDO = 1 << 4,   /* mappable into an RPDO */
	OD_STORED = 1 << 5, /* stored by 1010h: read-write without ObjFlags bit 0 (a command), or Stored=1 in the EDS */
	OD_NODE_ID = 1 << 6, /* the default is $NODEID + the value in the table */
	OD_LIMIT_LOW = 1 << 7,
	OD_LIMIT_HIGH = 1 << 8,
};

/** Storage groups: the sub-indices of 1010h/1011h (CiA 301, 7.5.2.13). Sub-index 1 is all of them. */
enum od_group {
	OD_GROUP_ALL = 1,
	OD_GROUP_COMMUNICATION = 2, /* 1000h-1FFFh */
	OD_GROUP_APPLICATION = 3,   /* 6000h-9FFFh */
	OD_GROUP_MANUFACTURER = 4,  /* 2000h-5FFFh */
};

/** Result of a request to the dictionary. SDO abort codes and Modbus exceptions are exhaustive switches over it. */
enum od_status {
	OD_OK = 0,
	OD_CONSUMED,  /* from a hook only: a command was executed and no value is stored. od_write() returns OD_OK */
	OD_PENDING,   /* accepted, completes later (storing waits for the disk) */
	OD_NO_OBJECT, /* the index is not in the dictionary */
	OD_NO_SUBINDEX,
	OD_WRITE_ONLY, /* read of a write-only entry */
	OD_READ_ONLY,  /* write of a read-only or constant entry */
	OD_UNSUPPORTED_ACCESS,
	OD_TOO_LONG,
	OD_TOO_SHORT,
	OD_TOO_HIGH,
	OD_TOO_LOW,
	OD_BAD_VALUE, /* within the limits, but not allowed (NaN, a reserved bit, a wrong signature) */
	OD_NOT_MAPPABLE,
	OD_PDO_LENGTH,	  /* the mapping would exceed 8 bytes */
	OD_INCOMPATIBLE,  /* parameter incompatibility */
	OD_CANNOT_STORE,  /* storage failed */
	OD_LOCAL_CONTROL, /* refused because of local control */
	OD_DEVICE_STATE,  /* refused in the present device state */
	OD_NO_DATA,	  /* no value available yet */
	OD_GENERAL,	  /* internal error */
	OD_STATUS_COUNT
};

union od_number {
	uint64_t u; /* BOOLEAN, UNSIGNEDx */
	int64_t i;  /* INTEGERx */
	double f;   /* REALx */
};

/** One sub-index. */
struct od_entry {
	uint16_t index;
	uint8_t sub;
	uint8_t type;		   /* enum od_type */
	uint8_t resolution_sub;	   /* with `resolution` */
	bool words_of_bits;	   /* `words` names bits, not values */
	uint16_t resolution;	   /* index of the entry that holds the step, see od_step(); 0: none */
	uint16_t access;	   /* OD_READ | ... */
	uint16_t size;		   /* bytes in the values struct; capacity of a VISIBLE_STRING; 0 for a DOMAIN */
	uint32_t offset;	   /* into the values struct */
	union od_number low, high; /* valid with OD_LIMIT_LOW, OD_LIMIT_HIGH */
	double factor;		   /* physical = raw * factor at the default resolution; 1 if the EDS has none */
	const char *name; /* "lever_arm.l", normalised from the EDS: lower case, runs of other characters as '_' */
	const char *unit; /* "m", or "" */
	const char *description; /* one line, or "" */
	const char *words;	 /* "off, paper, 4 rigid" names 0, 1 and 4: see od_next_word(). NULL or "": none */
};

struct od_table {
	const struct od_entry *entries; /* sorted by index, then sub-index */
	size_t count;
	const void *defaults; /* a values struct, without the node-ID in entries with OD_NODE_ID */
	size_t values_size;
};

/** Longest value of an entry that is not a DOMAIN, in bytes: the buffer size that od_read() needs at most. */
enum { OD_VALUE_MAX = 64 };

/** Longest DOMAIN that read() provides or write() accepts, in bytes. A DOMAIN in constant memory may be longer. */
enum { OD_DOMAIN_MAX = 16384 };

/** Data of an object of type DOMAIN; owned by the caller of od_set_domain(), must outlive the dictionary. */
struct od_domain {
	struct od_domain *next;
	uint16_t index;
	uint8_t sub;
	/** Data to read: constant memory; or, if read is not NULL, what read() puts into out[OD_DOMAIN_MAX] at the
	 * beginning of a transfer. It returns the number of bytes, at most OD_DOMAIN_MAX. */
	const uint8_t *data;
	size_t size;
	size_t (*read)(void *ctx, uint8_t *out);
	/** Gets the complete written data; NULL: cannot be written. After a status other than OD_OK nothing has
	 * changed. */
	enum od_status (*write)(void *ctx, const uint8_t *data, size_t size);
	void *ctx;
};

/** Callbacks for writes to a range of indices. `before` gets the new value (wire form, type and limits already checked)
 * and can refuse it with a status, consume it (OD_CONSUMED) or complete it later (OD_PENDING); then the value is not
 * changed. `after` is called when the value has changed; a DOMAIN has its own write() instead. Either may be NULL.
 * Hooks run in the order of attachment. */
struct od_hook {
	struct od_hook *next;
	uint16_t first, last; /* indices, inclusive */
	enum od_status (*before)(void *ctx, const struct od_entry *entry, const void *wire, size_t size);
	void (*after)(void *ctx, const struct od_entry *entry);
	void *ctx;
};

struct od {
	const struct od_table *table;
	void *values; /* table->values_size bytes, owned by the caller */
	struct od_hook *hooks;
	struct od_domain *domains;
};

/** Binds the table to the caller's values and sets them to the defaults for this node-ID (1..127, or 255: none). */
void od_init(struct od *od, const struct od_table *table, void *values, uint8_t node_id);

/** Resets the stored entries (OD_STORED) of a group, or of all, to their values in `base`: a values struct, for
 * example a copy made at start-up. No hook runs. */
void od_reset(struct od *od, enum od_group group, const void *base);

/** Entries of a values struct that have their default for the node-ID `old` ($NODEID + value) get that for `node_id`
 * (1..127, or 255: none); other values remain. */
void od_follow_node_id(const struct od_table *table, void *values, uint8_t old, uint8_t node_id);

void od_attach(struct od *od, struct od_hook *hook);
void od_set_domain(struct od *od, struct od_domain *domain);

/** The entry, or NULL. `status` (may be NULL) is then OD_NO_OBJECT or OD_NO_SUBINDEX. */
const struct od_entry *od_find(const struct od_table *table, uint16_t index, uint8_t sub, enum od_status *status);

/** The entry whose value, times its own factor, is one step of this one (an unsigned integer, such as 6000h for the
 * angles of CiA 410), or NULL: entry->factor is the step. */
const struct od_entry *od_resolution(const struct od_table *table, const struct od_entry *entry);

/** The physical value of 1, in entry->unit, as the resolution objects say now. */
double od_step(const struct od *od, const struct od_entry *entry);

/** By name ("lever_arm.l", any case, spaces as '_', or "Lever arm l" as the EDS has it), by index ("0x2000:1",
 * "2000h:1", "0x2000" for sub-index 0). */
const struct od_entry *od_find_name(const struct od_table *table, const char *name);

enum od_group od_group_of(uint16_t index);

/** Reads a value in wire form with access check; a VISIBLE_STRING without padding. OD_UNSUPPORTED_ACCESS for a DOMAIN:
 * use od_find_domain(). */
enum od_status od_read(const struct od *od, uint16_t index, uint8_t sub, void *wire, size_t capacity, size_t *size);

/** Like od_read() without access check. Returns the size; 0: more than `capacity`, or an empty string. */
size_t od_get(const struct od *od, const struct od_entry *entry, void *wire, size_t capacity);

const struct od_domain *od_find_domain(const struct od *od, uint16_t index, uint8_t sub);

/** A write by a client: checks access, size and limits (NaN and infinity are refused), runs the hooks, then sets the
 * value. After a refusal the old value remains. A DOMAIN is written by od_domain.write(). */
enum od_status od_write(struct od *od, uint16_t index, uint8_t sub, const void *wire, size_t size);

/** Checks size, type and limits of a value in wire form. */
enum od_status od_check(const struct od_entry *entry, const void *wire, size_t size);

/** A write by the device itself (a value from a file or from storage): checks size and limits but not access, and runs
 * no hook. Constants are refused. */
enum od_status od_put(struct od *od, const struct od_entry *entry, const void *wire, size_t size);

/** Pointer to the value in host byte order, for code that addresses objects by number (the CANopen core). NULL: no such
 * entry, or its size is not `size`. */
void *od_value(const struct od *od, uint16_t index, uint8_t sub, size_t size);

/** One of the words of an entry; `text` is not terminated. */
struct od_word {
	unsigned number; /* the value, or the bit, that it names */
	const char *text;
	size_t length;
};

/** Whether its values, or bits, have words; false for NULL. */
bool od_has_words(const struct od_entry *entry);
/** Goes to the next word; start with an empty struct. False: there is no further one. */
bool od_next_word(const struct od_entry *entry, struct od_word *word);
/** A value in words: "rigid_body"; of bits "valid,rest", or "none"; "" where the value has none. A bit without a word
 * is "bit5". */
void od_words_text(const struct od_entry *entry, uint64_t value, char *text, size_t capacity);

/** Text to wire form and back, without limits: see od_check(). Reads decimal, 0x hex, floats, true/false, the words of
 * the entry as od_words_text() writes them, strings as they are, OCTET_STRING in hex. Writes integers in decimal, REALs
 * with the digits that give the same bits when read. od_format() returns the length, or -ENOSPC, or -EINVAL for a wrong
 * size. */
enum od_status od_parse(const struct od_entry *entry, const char *text, void *wire, size_t capacity, size_t *size);
int od_format(const struct od_entry *entry, const void *wire, size_t size, char *text, size_t capacity);

/** A number of an entry, such as a limit, as its type says; in steps. */
double od_number_value(enum od_type type, union od_number number);
/** "-10 to 10 m", "0 or more", or "" without limits; limits of scaled integers are in steps, without unit. */
void od_limits_text(const struct od_entry *entry, char *text, size_t capacity);

/** Text for messages, such as "value above its high limit". */
const char *od_status_text(enum od_status status);

/** Encodes the stored entries of a group that differ from `base` (a values struct) as a concise DCF (CiA 302-3: u32
 * count, then for each entry u16 index, u8 sub-index, u32 size, data; little-endian). The length, or -ENOSPC. */
long od_encode(const struct od *od, enum od_group group, const void *base, uint8_t *out, size_t capacity);

/** One entry of a concise DCF. */
struct od_dcf_item {
	uint16_t index;
	uint8_t sub;
	const uint8_t *data;
	size_t size;
};

/** Whether the bytes are a concise DCF with exactly as many entries as its count says. */
bool od_dcf_valid(const uint8_t *in, size_t size);
/** The entry at offset `*used` of a valid concise DCF, and the offset of the next; start with 0. False: end. */
bool od_dcf_next(const uint8_t *in, size_t size, size_t *used, struct od_dcf_item *item);
/** Appends an entry to the `*used` bytes of `out`; start with 0. False: no room; `out` is unchanged. */
bool od_dcf_add(uint8_t *out, size_t capacity, size_t *used, const struct od_dcf_item *item);

/** Applies a concise DCF with od_put(). Entries that are not in this dictionary, not stored, or refused are skipped and
 * counted in *skipped. Returns the number applied, or -EINVAL: not a concise DCF, nothing was applied. */
long od_decode(struct od *od, const uint8_t *in, size_t size, size_t *skipped);

/** CRC-32 (IEEE 802.3, reflected) of stored files. */
uint32_t od_crc32(uint32_t crc, const void *data, size_t size);

#endif

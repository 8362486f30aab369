#include "gateway/pdo_preset.h"

#include <assert.h>
#include <string.h>

#include "od/little_endian.h"
#include "od_index.h"

enum { PRESETS = 4, PDOS = 4, ENTRIES = 4 };
enum { FIRST_COMMUNICATION = 0x1800, FIRST_MAPPING = 0x1A00, LAST = 0x1BFF };

#define COB_ID_INVALID 0x80000000u

#define U16(index, sub) ((uint32_t)(index) << 16 | (sub) << 8 | 16)
#define U32(index, sub) ((uint32_t)(index) << 16 | (sub) << 8 | 32)
#define COUNTER		U16(OD_INDEX_SAMPLE, OD_SUB_SAMPLE_COUNTER)
#define STATUS		U16(OD_INDEX_SAMPLE, OD_SUB_SAMPLE_STATUS), COUNTER, U32(OD_INDEX_SAMPLE, OD_SUB_SAMPLE_TIME)
#define VECTOR(index)	U16(index, 1), U16(index, 2), U16(index, 3)

/* Mapping entries of 2148h = 1 to 4; a PDO without any is invalid. Preset 1 is the default of the EDS. */
static const uint32_t mappings[PRESETS][PDOS][ENTRIES] = {
	{
		{VECTOR(OD_INDEX_ACCELERATION), COUNTER},
		{VECTOR(OD_INDEX_ANGLES), COUNTER},
		{VECTOR(OD_INDEX_POSITION_OUTPUT), COUNTER},
		{STATUS},
	},
	{
		{U16(OD_INDEX_SLOPE_LONG16, 0), U16(OD_INDEX_SLOPE_LATERAL16, 0)},
		{U32(OD_INDEX_SLOPE_LONG32, 0), U32(OD_INDEX_SLOPE_LATERAL32, 0)},
		{0},
		{STATUS},
	},
	{
		{VECTOR(OD_INDEX_QUATERNION16), U16(OD_INDEX_QUATERNION16, 4)},
		{VECTOR(OD_INDEX_ANGULAR_RATE16), COUNTER},
		{VECTOR(OD_INDEX_ANGLES), COUNTER},
		{STATUS},
	},
	{
		{VECTOR(OD_INDEX_SPECIFIC_FORCE16), COUNTER},
		{VECTOR(OD_INDEX_ANGULAR_RATE16), COUNTER},
		{VECTOR(OD_INDEX_MAGNETIC_FIELD16), COUNTER},
		{STATUS},
	},
};

static uint8_t count_of(const uint32_t entries[ENTRIES])
{
	uint8_t n = 0;

	while (n < ENTRIES && entries[n])
		n++;
	return n;
}

static uint32_t read_u32(const struct od *od, uint16_t index, uint8_t sub)
{
	const uint32_t *value = od_value(od, index, sub, sizeof(uint32_t));

	assert(value); /* the EDS has all of them */
	return *value;
}

static uint8_t mapped_count(const struct od *od, uint16_t pdo)
{
	const uint8_t *count = od_value(od, FIRST_MAPPING + pdo, 0, 1);

	assert(count);
	return *count;
}

static enum od_status write_u32(struct od *od, uint16_t index, uint8_t sub, uint32_t value)
{
	uint8_t wire[4];

	put_u32(wire, value);
	return od_write(od, index, sub, wire, sizeof(wire));
}

/* COB-ID and mapping of a PDO, of which no preset writes more entries. */
struct pdo_setting {
	uint32_t cob_id, entries[ENTRIES];
	uint8_t entry_count; /* that are written */
	uint8_t count;	     /* that are mapped: sub-index 0 */
};

static struct pdo_setting setting_of(const struct od *od, uint16_t pdo)
{
	uint8_t count = mapped_count(od, pdo);
	struct pdo_setting setting = {
		.cob_id = read_u32(od, FIRST_COMMUNICATION + pdo, 1), .entry_count = ENTRIES, .count = count};

	for (uint8_t i = 0; i < ENTRIES; i++)
		setting.entries[i] = read_u32(od, FIRST_MAPPING + pdo, i + 1);
	return setting;
}

/* The mapping procedure of CiA 301. */
static enum od_status map(struct od *od, uint16_t pdo, const struct pdo_setting *setting)
{
	uint16_t communication = FIRST_COMMUNICATION + pdo, mapping = FIRST_MAPPING + pdo;
	uint8_t none = 0;
	enum od_status status = write_u32(od, communication, 1, setting->cob_id | COB_ID_INVALID);

	if (status == OD_OK)
		status = od_write(od, mapping, 0, &none, 1);
	for (uint8_t i = 0; status == OD_OK && i < setting->entry_count; i++)
		status = write_u32(od, mapping, i + 1, setting->entries[i]);
	if (status == OD_OK)
		status = od_write(od, mapping, 0, &setting->count, 1);
	return status == OD_OK ? write_u32(od, communication, 1, setting->cob_id) : status;
}

static enum od_status map_preset(struct od *od, uint16_t pdo, const uint32_t entries[ENTRIES])
{
	uint32_t cob_id = read_u32(od, FIRST_COMMUNICATION + pdo, 1);
	uint8_t count = count_of(entries);
	struct pdo_setting setting = {.cob_id = count ? cob_id & ~COB_ID_INVALID : cob_id | COB_ID_INVALID,
		.entry_count = count,
		.count = count};

	memcpy(setting.entries, entries, ENTRIES * sizeof(*entries));
	return map(od, pdo, &setting);
}

static bool is_mapped(const struct od *od, uint16_t pdo, const uint32_t entries[ENTRIES])
{
	uint8_t count = mapped_count(od, pdo);
	bool valid = !(read_u32(od, FIRST_COMMUNICATION + pdo, 1) & COB_ID_INVALID);
	bool same = count == count_of(entries);

	for (uint8_t i = 0; same && i < count; i++)
		same = read_u32(od, FIRST_MAPPING + pdo, i + 1) == entries[i];
	return same && valid == (count_of(entries) > 0);
}

void pdo_preset_update(struct pdo_preset *preset)
{
	*preset->value = 0;
	for (uint8_t n = 0; n < PRESETS && *preset->value == 0; n++) {
		bool same = true;

		for (uint16_t pdo = 0; pdo < PDOS; pdo++)
			same = same && is_mapped(preset->od, pdo, mappings[n][pdo]);
		*preset->value = same ? n + 1 : 0;
	}
}

static enum od_status on_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct pdo_preset *preset = ctx;
	uint8_t n = *(const uint8_t *)wire;
	struct pdo_setting before[PDOS];
	enum od_status status = OD_OK;

	(void)entry;
	(void)size;
	if (n == 0)
		return OD_BAD_VALUE;
	for (uint16_t pdo = 0; pdo < PDOS; pdo++)
		before[pdo] = setting_of(preset->od, pdo);
	preset->applying = true;
	for (uint16_t pdo = 0; status == OD_OK && pdo < PDOS; pdo++)
		status = map_preset(preset->od, pdo, mappings[n - 1][pdo]);
	for (uint16_t pdo = 0; status != OD_OK && pdo < PDOS; pdo++)
		(void)map(preset->od, pdo, &before[pdo]);
	preset->applying = false;
	pdo_preset_update(preset);
	return status == OD_OK ? OD_CONSUMED : status;
}

static void on_mapping(void *ctx, const struct od_entry *entry)
{
	struct pdo_preset *preset = ctx;

	(void)entry;
	if (!preset->applying)
		pdo_preset_update(preset);
}

void pdo_preset_attach(struct pdo_preset *preset, struct od *od, uint8_t *value)
{
	*preset = (struct pdo_preset){.od = od, .value = value};
	preset->command = (struct od_hook){
		.first = OD_INDEX_PDO_PRESET, .last = OD_INDEX_PDO_PRESET, .before = on_command, .ctx = preset};
	preset->mapping =
		(struct od_hook){.first = FIRST_COMMUNICATION, .last = LAST, .after = on_mapping, .ctx = preset};
	od_attach(od, &preset->command);
	od_attach(od, &preset->mapping);
	pdo_preset_update(preset);
}

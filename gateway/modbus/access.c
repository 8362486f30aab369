#include "gateway/modbus/access.h"

#include <stdio.h>
#include <string.h>

#include "od/little_endian.h"

/* ---- the thread: reading ----------------------------------------------------------------------------------------- */

/* The dictionary as of the latest snapshot. Nothing is written through it. */
static struct od latest(struct modbus_access *a)
{
	return (struct od){.table = a->table, .values = (void *)(uintptr_t)modbus_link_values(a->link)};
}

static bool low_first(const struct od *od)
{
	return ((const struct od_values *)od->values)->modbus.word_order;
}

static enum od_status read_registers(void *ctx, uint16_t address, unsigned count, uint8_t *out)
{
	struct modbus_access *a = ctx;
	const struct od od = latest(a);

	return modbus_map_read(a->map, &od, low_first(&od), address, count, out);
}

static enum od_status read_bits(void *ctx, enum modbus_bits kind, uint16_t address, unsigned count, uint8_t *out)
{
	struct modbus_access *a = ctx;
	const struct od od = latest(a);

	return modbus_map_read_bits(a->map, &od, kind, address, count, out);
}

/* VendorName, ProductCode, MajorMinorRevision, VendorUrl (none), ProductName, ModelName, UserApplicationName (none);
 * then the serial number and the revision of the objects, in hex as 1018h has them. */
static const char *identification(void *ctx, uint8_t number)
{
	struct modbus_access *a = ctx;
	const struct od_values *v = modbus_link_values(a->link);

	switch (number) {
	case 0x00:
		return a->map->vendor_name;
	case 0x01:
		return a->map->product_code;
	case 0x02:
		return v->manufacturer_software_version;
	case 0x04:
		return v->manufacturer_device_name;
	case 0x05:
		return v->manufacturer_hardware_version;
	case 0x80:
		snprintf(a->text, sizeof(a->text), "%08X", v->identity.serial_number);
		return a->text;
	case 0x81:
		snprintf(a->text, sizeof(a->text), "%08X", v->identity.revision_number);
		return a->text;
	default:
		return NULL;
	}
}

/* ---- the thread: jobs -------------------------------------------------------------------------------------------- */

static struct modbus_job *new_job(struct modbus_access *a, enum modbus_job_kind kind)
{
	struct modbus_job *job = &a->link->job;

	job->kind = kind;
	memcpy(job->who, a->who, sizeof(job->who));
	return job;
}

static enum od_status write_registers(void *ctx, uint16_t address, unsigned count, const uint8_t *in)
{
	struct modbus_access *a = ctx;
	struct modbus_job *job = new_job(a, MODBUS_WRITE);

	job->address = address;
	job->count = (uint16_t)count;
	memcpy(job->data, in, (size_t)count * 2);
	return modbus_link_submit(a->link);
}

static enum od_status mask_register(void *ctx, uint16_t address, uint16_t and_mask, uint16_t or_mask)
{
	struct modbus_access *a = ctx;
	struct modbus_job *job = new_job(a, MODBUS_MASK);

	job->address = address;
	put_u16(job->data, and_mask);
	put_u16(job->data + 2, or_mask);
	return modbus_link_submit(a->link);
}

static enum od_status write_coils(void *ctx, uint16_t address, unsigned count, const uint8_t *in)
{
	struct modbus_access *a = ctx;
	struct modbus_job *job = new_job(a, MODBUS_WRITE_COILS);

	job->address = address;
	job->count = (uint16_t)count;
	memcpy(job->data, in, (count + 7) / 8);
	return modbus_link_submit(a->link);
}

static enum od_status write_object(void *ctx, uint16_t index, uint8_t sub, const uint8_t *in, size_t size)
{
	struct modbus_access *a = ctx;
	struct modbus_job *job = new_job(a, MODBUS_WRITE_OBJECT);

	job->index = index;
	job->sub = sub;
	job->size = size;
	memcpy(job->data, in, size);
	return modbus_link_submit(a->link);
}

/* A DOMAIN is read as of the request for its beginning; the parts that follow are of the same content. */
static enum od_status open_domain(struct modbus_access *a, uint16_t index, uint8_t sub)
{
	struct modbus_job *job = new_job(a, MODBUS_READ_OBJECT);

	job->index = index;
	job->sub = sub;
	job->out = a->upload.bytes;
	a->upload.data = NULL;
	enum od_status status = modbus_link_submit(a->link);
	if (status)
		return status;
	a->upload.index = index;
	a->upload.sub = sub;
	a->upload.data = job->read;
	a->upload.size = job->size;
	return OD_OK;
}

/* The error history has no entries beyond its count. */
static bool has_no_data(const struct od *od, uint16_t index, uint8_t sub)
{
	const struct od_values *v = od->values;

	return index == OD_INDEX_ERROR_HISTORY && sub > v->error_history.number_of_errors;
}

static enum od_status read_object(void *ctx, uint16_t index, uint8_t sub, size_t offset, uint8_t *out, size_t *size)
{
	struct modbus_access *a = ctx;
	const struct od od = latest(a);
	uint8_t value[OD_VALUE_MAX];
	const uint8_t *from = value;
	size_t whole;
	enum od_status status;
	const struct od_entry *entry = od_find(a->table, index, sub, &status);

	if (!entry)
		return status;
	if (entry->type == OD_DOMAIN) {
		bool open = a->upload.data && a->upload.index == index && a->upload.sub == sub;

		status = offset > 0 && open ? OD_OK : open_domain(a, index, sub);
		from = a->upload.data;
		whole = a->upload.size;
	} else {
		status = has_no_data(&od, index, sub) ? OD_NO_DATA
						      : od_read(&od, index, sub, value, sizeof(value), &whole);
	}
	if (status)
		return status;
	size_t left = offset < whole ? whole - offset : 0;
	*size = *size < left ? *size : left;
	memcpy(out, from + (left ? offset : 0), *size);
	return OD_OK;
}

void modbus_access_init(struct modbus_access *access, struct modbus_link *link, const struct modbus_map *map,
	const struct od_table *table, const char *who, bool may_write, uint32_t (*abort_code)(enum od_status))
{
	access->registers = (struct modbus_registers){.ctx = access,
		.read_only = !may_write,
		.read = read_registers,
		.write = write_registers,
		.mask = mask_register,
		.read_bits = read_bits,
		.write_coils = write_coils,
		.identification = identification,
		.read_object = read_object,
		.write_object = write_object,
		.abort_code = abort_code};
	access->link = link;
	access->map = map;
	access->table = table;
	access->upload.data = NULL;
	snprintf(access->who, sizeof(access->who), "%s", who);
}

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

struct execution {
	struct od *od;
	const char *who;
	modbus_write *write;
	modbus_wrote *wrote;
	void *ctx;
};

static void tell(const struct execution *x, const struct modbus_item *item, enum od_status status)
{
	x->wrote(x->ctx, x->who, item->entry, item->wire, item->size, status);
}

static enum od_status write_item(const struct execution *x, const struct modbus_item *item)
{
	return x->write(x->ctx, item->entry->index, item->entry->sub, item->wire, item->size);
}

/* What is refused without a hook. What cannot be read cannot be taken back: it is written alone. */
static enum od_status check(const struct modbus_item *item, bool alone)
{
	if (!(item->entry->access & OD_WRITE))
		return OD_READ_ONLY;
	if (!alone && !(item->entry->access & OD_READ))
		return OD_UNSUPPORTED_ACCESS;
	return od_check(item->entry, item->wire, item->size);
}

static void take_back(const struct execution *x, const struct modbus_item *old, unsigned count)
{
	while (count-- > 0)
		if (write_item(x, &old[count]) != OD_OK)
			od_put(x->od, old[count].entry, old[count].wire, old[count].size);
}

/* All or none. */
static enum od_status write_items(const struct execution *x, const struct modbus_item *items, unsigned count)
{
	struct modbus_item old[MODBUS_REGISTERS_MAX];
	enum od_status status = OD_OK;
	unsigned done;

	for (done = 0; done < count && !status; done++)
		status = check(&items[done], count == 1);
	if (status) {
		tell(x, &items[done - 1], status);
		return status;
	}
	for (done = 0; done < count; done++) {
		old[done].entry = items[done].entry;
		old[done].size = od_get(x->od, items[done].entry, old[done].wire, sizeof(old[done].wire));
		status = write_item(x, &items[done]);
		if (status && status != OD_PENDING) {
			take_back(x, old, done);
			tell(x, &items[done], status);
			return status;
		}
	}
	for (done = 0; done < count; done++)
		tell(x, &items[done], status);
	return status;
}

static enum od_status mask(
	const struct modbus_job *job, const struct modbus_map *map, struct od *od, bool low, uint8_t value[2])
{
	enum od_status status = modbus_map_read(map, od, low, job->address, 1, value);
	unsigned and_mask = get_u16(job->data), or_mask = get_u16(job->data + 2);

	if (status)
		return status;
	unsigned masked = ((unsigned)(value[0] << 8 | value[1]) & and_mask) | (or_mask & ~and_mask);
	value[0] = (uint8_t)(masked >> 8);
	value[1] = (uint8_t)masked;
	return OD_OK;
}

static enum od_status read_domain(struct modbus_job *job, const struct od *od)
{
	const struct od_domain *domain = od_find_domain(od, job->index, job->sub);
	const struct od_entry *entry = od_find(od->table, job->index, job->sub, NULL);

	if (entry && !(entry->access & OD_READ))
		return OD_WRITE_ONLY;
	if (!domain)
		return OD_NO_DATA;
	job->read = domain->read ? job->out : domain->data;
	job->size = domain->read ? domain->read(domain->ctx, job->out) : domain->size;
	return OD_OK;
}

static enum od_status write_dictionary(const struct execution *x, const struct modbus_job *job)
{
	enum od_status status;
	const struct od_entry *entry = od_find(x->od->table, job->index, job->sub, &status);

	if (!entry)
		return status;
	status = x->write(x->ctx, job->index, job->sub, job->data, job->size);
	x->wrote(x->ctx, x->who, entry, entry->type == OD_DOMAIN ? NULL : job->data, job->size, status);
	return status;
}

void modbus_execute(struct modbus_job *job, const struct modbus_map *map, struct od *od, bool low_first,
	modbus_write *write, modbus_wrote *wrote, void *ctx)
{
	const struct execution x = {.od = od, .who = job->who, .write = write, .wrote = wrote, .ctx = ctx};
	struct modbus_item items[MODBUS_REGISTERS_MAX];
	enum od_status status = OD_GENERAL;
	uint8_t masked[2];
	unsigned count = 0;

	switch (job->kind) {
	case MODBUS_WRITE:
		status =
			modbus_map_items(map, od->table, low_first, job->address, job->count, job->data, items, &count);
		break;
	case MODBUS_MASK:
		status = mask(job, map, od, low_first, masked);
		if (!status)
			status = modbus_map_items(map, od->table, low_first, job->address, 1, masked, items, &count);
		break;
	case MODBUS_WRITE_COILS:
		status = modbus_map_coil_items(map, od->table, job->address, job->count, job->data, items, &count);
		break;
	case MODBUS_WRITE_OBJECT:
		status = write_dictionary(&x, job);
		break;
	case MODBUS_READ_OBJECT:
		status = read_domain(job, od);
		break;
	}
	job->status = status ? status : count ? write_items(&x, items, count) : OD_OK;
}

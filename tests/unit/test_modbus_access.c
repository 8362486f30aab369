/* What a client of the Modbus server reads from snapshots, and what the loop makes of its jobs: on a hand-made
 * dictionary with kinds of objects that the device's EDS does not have in the map. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/modbus/access.h"
#include "od/little_endian.h"
#include "tests/unit/descriptors.h"

struct values {
	uint16_t a, b, fixed, secret;
	uint8_t small;
	char text[4];
	uint16_t limited;
};

#define ENTRY(i, t, a, member)                                                                                         \
	{                                                                                                              \
		.index = (i), .type = (t), .access = (a), .size = sizeof(((struct values *)0)->member),                \
		.offset = offsetof(struct values, member), .factor = 1, .name = #member, .unit = "", .description = "" \
	}
#define DOMAIN(i, a)                                                                                       \
	{                                                                                                  \
		.index = (i), .type = OD_DOMAIN, .access = (a), .factor = 1, .name = "domain", .unit = "", \
		.description = ""                                                                          \
	}

static const struct od_entry ENTRIES[] = {
	ENTRY(0x2000, OD_UNSIGNED16, OD_READ | OD_WRITE, a),
	ENTRY(0x2001, OD_UNSIGNED16, OD_READ | OD_WRITE, b),
	ENTRY(0x2002, OD_UNSIGNED16, OD_READ, fixed),
	ENTRY(0x2003, OD_UNSIGNED16, OD_WRITE, secret),
	ENTRY(0x2004, OD_UNSIGNED8, OD_READ | OD_WRITE, small),
	ENTRY(0x2005, OD_VISIBLE_STRING, OD_READ | OD_WRITE, text),
	DOMAIN(0x2006, OD_READ),
	DOMAIN(0x2007, OD_READ | OD_WRITE),
	DOMAIN(0x2008, OD_WRITE),
	DOMAIN(0x2009, OD_READ),
	{.index = 0x200B,
		.type = OD_UNSIGNED16,
		.access = OD_READ | OD_WRITE | OD_LIMIT_HIGH,
		.size = 2,
		.offset = offsetof(struct values, limited),
		.factor = 1,
		.high = {.u = 100},
		.name = "limited",
		.unit = "",
		.description = ""},
	{.index = 0x2010, .sub = 3, .type = OD_DOMAIN, .access = OD_READ, .name = "c", .unit = "", .description = ""},
	{.index = 0x2010, .sub = 4, .type = OD_DOMAIN, .access = OD_READ, .name = "d", .unit = "", .description = ""},
};
enum { A, B, FIXED, SECRET, SMALL, TEXT, CONSTANT, GENERATED, WRITTEN, LIMITED = 10 };
enum { AT_A = 10, AT_B, AT_FIXED, AT_SECRET, AT_SMALL, AT_TEXT, AT_LIMITED = 17 };

static const struct values DEFAULTS = {
	.a = 0x1122, .b = 0x3344, .fixed = 7, .secret = 9, .small = 0x55, .text = "abcd"};
static const struct od_table TABLE = {.entries = ENTRIES,
	.count = sizeof(ENTRIES) / sizeof(*ENTRIES),
	.defaults = &DEFAULTS,
	.values_size = sizeof(DEFAULTS)};
static const struct modbus_point POINTS[] = {{AT_A, 1, A}, {AT_B, 1, B}, {AT_FIXED, 1, FIXED}, {AT_SECRET, 1, SECRET},
	{AT_SMALL, 1, SMALL}, {AT_TEXT, 2, TEXT}, {AT_LIMITED, 1, LIMITED}};
static const struct modbus_coil COILS[] = {{1, SMALL, false, 0}, {2, A, true, 0x1234}};
static const struct modbus_map MAP = {POINTS, NULL, COILS, 7, 0, 2, "ACME", "X1"};

/* ---- the loop ---------------------------------------------------------------------------------------------------- */

static struct od od;
static struct values values;
static struct modbus_link link_;
static struct modbus_access client;
static bool low_first;
static struct {
	uint16_t index;	       /* the write of this object is refused, */
	enum od_status status; /* with this */
	unsigned after;	       /* once so many writes have been accepted */
} refused;
static unsigned writes;
static char told[400]; /* who: name = wire bytes, status */

static enum od_status write_value(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	assert_ptr_equal(ctx, &od);
	if (index == refused.index && writes >= refused.after)
		return refused.status;
	writes++;
	return od_write(&od, index, sub, wire, size);
}

static void wrote(
	void *ctx, const char *who, const struct od_entry *entry, const void *wire, size_t size, enum od_status status)
{
	const uint8_t *bytes = wire;
	char *end = told + strlen(told);

	assert_ptr_equal(ctx, &od);
	end += sprintf(end, "%s %s", who, entry->name);
	for (size_t i = 0; wire && i < size; i++)
		end += sprintf(end, " %02X", bytes[i]);
	if (!wire)
		end += sprintf(end, " (%zu)", size);
	sprintf(end, " %d;", status);
}

static void serve(void *ctx)
{
	assert_ptr_equal(ctx, &link_);
	struct modbus_job *job = modbus_link_take(&link_);

	assert_non_null(job);
	modbus_execute(job, &MAP, &od, low_first, write_value, wrote, &od);
	modbus_link_done(&link_);
}

static unsigned generated; /* how often it was */

static size_t generate(void *ctx, uint8_t *out)
{
	(void)ctx;
	return (size_t)sprintf((char *)out, "content %u", ++generated);
}

static char taken[16];

static enum od_status take(void *ctx, const uint8_t *data, size_t size)
{
	(void)ctx;
	snprintf(taken, sizeof(taken), "%.*s", (int)size, (const char *)data);
	return OD_OK;
}

static int set_up(void **state)
{
	static struct od_domain constant, generator, written, third, fourth;
	static const struct od_values snapshot;

	(void)state;
	od_init(&od, &TABLE, &values, 1);
	constant = (struct od_domain){.index = 0x2006, .data = (const uint8_t *)"constant", .size = 8};
	generator = (struct od_domain){.index = 0x2007, .read = generate, .write = take};
	written = (struct od_domain){.index = 0x2008, .data = (const uint8_t *)"no", .size = 2, .write = take};
	third = (struct od_domain){.index = 0x2010, .sub = 3, .read = generate};
	fourth = (struct od_domain){.index = 0x2010, .sub = 4, .data = (const uint8_t *)"the fourth", .size = 10};
	od_set_domain(&od, &third);
	od_set_domain(&od, &fourth);
	od_set_domain(&od, &constant);
	od_set_domain(&od, &generator);
	od_set_domain(&od, &written);
	low_first = false;
	refused.index = 0;
	writes = generated = 0;
	told[0] = taken[0] = '\0';
	modbus_link_direct(&link_, serve, &link_);
	modbus_link_publish(&link_, &snapshot);
	modbus_access_init(&client, &link_, &MAP, &TABLE, "me:7", true, sdo_abort_code);
	return 0;
}

static enum od_status write_words(uint16_t address, unsigned count, const char *bytes)
{
	return client.registers.write(client.registers.ctx, address, count, (const uint8_t *)bytes);
}

static enum od_status mask(uint16_t address, uint16_t and_mask, uint16_t or_mask)
{
	return client.registers.mask(client.registers.ctx, address, and_mask, or_mask);
}

static enum od_status write_coils(uint16_t address, unsigned count, uint8_t bits)
{
	return client.registers.write_coils(client.registers.ctx, address, count, &bits);
}

static enum od_status write_object(uint16_t index, uint8_t sub, const char *bytes, size_t size)
{
	return client.registers.write_object(client.registers.ctx, index, sub, (const uint8_t *)bytes, size);
}

/* ---- registers and coils ----------------------------------------------------------------------------------------- */

static void test_each_value_that_is_written_is_told_with_its_client(void **state)
{
	(void)state;
	assert_int_equal(write_words(AT_A, 2, "\1\2\3\4"), OD_OK);
	assert_int_equal(values.a, 0x0102);
	assert_int_equal(values.b, 0x0304);
	assert_string_equal(told, "me:7 a 02 01 0;me:7 b 04 03 0;");
	told[0] = '\0';
	assert_int_equal(write_words(AT_TEXT, 2, "xy\0z"), OD_OK);
	assert_string_equal(told, "me:7 text 78 79 0;");
}

static void test_of_several_values_none_is_written_when_one_cannot_be(void **state)
{
	(void)state;
	assert_int_equal(write_words(AT_B, 2, "\1\2\0\7"), OD_READ_ONLY);
	assert_int_equal(writes, 0);
	assert_string_equal(told, "me:7 fixed 07 00 6;");
	told[0] = '\0';
	assert_int_equal(write_words(AT_SMALL, 1, "\1\2"), OD_TOO_HIGH); /* fits no 8 bits: nothing to tell */
	assert_int_equal(write_words(AT_B, 1, "\1\2\3\4"), OD_OK);
	assert_int_equal(write_words(AT_B - 2, 1, "\1\2"), OD_NO_OBJECT);
	assert_string_equal(told, "me:7 b 02 01 0;");
}

static void test_of_several_values_none_is_written_when_one_is_beyond_its_limit(void **state)
{
	(void)state;
	assert_int_equal(write_words(AT_TEXT, 3, "xy\0z\0\145"), OD_TOO_HIGH); /* 101 */
	assert_int_equal(writes, 0);
	assert_int_equal(write_words(AT_TEXT, 3, "xy\0z\0\144"), OD_OK);
	assert_int_equal(values.limited, 100);
}

/* A request ends at the end of a page, and nothing can be read behind it. */
static void test_of_a_request_no_more_is_read_than_it_has(void **state)
{
	const size_t page = (size_t)sysconf(_SC_PAGESIZE);
	uint8_t *pages = mmap(NULL, 2 * page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
	uint8_t *end = pages + page;

	(void)state;
	assert_true(pages != MAP_FAILED);
	assert_int_equal(mprotect(end, page, PROT_NONE), 0);
	memcpy(end - 4, "\1\2\3\4", 4);
	assert_int_equal(client.registers.write(client.registers.ctx, AT_A, 2, end - 4), OD_OK);
	assert_int_equal(values.b, 0x0304);
	end[-1] = 0xFF;
	client.registers.write_coils(client.registers.ctx, 0, 8, end - 1);
	client.registers.write_coils(client.registers.ctx, 0, 1, end - 1);
	munmap(pages, 2 * page);
}

/* It could not be taken back. */
static void test_a_value_that_cannot_be_read_is_written_alone(void **state)
{
	(void)state;
	assert_int_equal(write_words(AT_SECRET, 1, "\1\2"), OD_OK);
	assert_int_equal(values.secret, 0x0102);
	told[0] = '\0';
	assert_int_equal(write_words(AT_SECRET, 2, "\5\6\0\1"), OD_UNSUPPORTED_ACCESS);
	assert_int_equal(values.secret, 0x0102);
	assert_int_equal(values.small, 0x55);
	assert_string_equal(told, "me:7 secret 06 05 7;");
}

static void test_what_was_written_before_a_refusal_is_taken_back(void **state)
{
	(void)state;
	refused.index = 0x2001;
	refused.status = OD_LOCAL_CONTROL;
	assert_int_equal(write_words(AT_A, 2, "\1\2\3\4"), OD_LOCAL_CONTROL);
	assert_int_equal(values.a, 0x1122);
	assert_int_equal(values.b, 0x3344);
	assert_int_equal(writes, 2); /* there and back, so that hooks see both */
	assert_string_equal(told, "me:7 b 04 03 17;");
}

/* A service that accepts a value and refuses the old one: the dictionary has the old one all the same. */
static void test_an_old_value_that_is_refused_is_put_back(void **state)
{
	static const struct modbus_point both[] = {{20, 1, A}, {21, 1, A}, {22, 1, FIXED}};
	static const struct modbus_map map = {.points = both, .point_count = 2};
	struct modbus_job job = {.kind = MODBUS_WRITE, .address = 20, .count = 2, .data = {1, 2, 3, 4}, .who = "me:7"};

	(void)state;
	refused.index = 0x2000;
	refused.status = OD_DEVICE_STATE;
	refused.after = 1; /* the first is written; the second, and the old value, are not */
	modbus_execute(&job, &map, &od, false, write_value, wrote, &od);
	assert_int_equal(job.status, OD_DEVICE_STATE);
	assert_int_equal(values.a, 0x1122);
	assert_string_equal(told, "me:7 a 04 03 18;");
	refused.after = 0;
}

static void test_a_write_that_takes_longer_counts_as_written(void **state)
{
	(void)state;
	refused.index = 0x2000;
	refused.status = OD_PENDING;
	assert_int_equal(write_words(AT_A, 1, "\1\2"), OD_PENDING);
	assert_string_equal(told, "me:7 a 02 01 2;");
}

/* V1.1b3, 6.16: (old AND and_mask) OR (or_mask AND NOT and_mask), in all 16 bits. */
static void test_a_mask_changes_the_bits_that_it_names(void **state)
{
	(void)state;
	assert_int_equal(mask(AT_A, 0xF00F, 0x0BB0), OD_OK);
	assert_int_equal(values.a, 0x1BB2);
	assert_int_equal(mask(AT_A, 0xFFFF, 0xFFFF), OD_OK);
	assert_int_equal(values.a, 0x1BB2);
	assert_int_equal(mask(AT_A, 0x0000, 0xA55A), OD_OK);
	assert_int_equal(values.a, 0xA55A);
	assert_int_equal(mask(AT_SMALL, 0x00F0, 0x000A), OD_OK);
	assert_int_equal(values.small, 0x5A);
	assert_int_equal(mask(AT_SMALL, 0x00FF, 0x0100), OD_TOO_HIGH);
	assert_int_equal(mask(AT_SECRET, 0, 1), OD_WRITE_ONLY);
	assert_int_equal(mask(AT_FIXED, 0, 1), OD_READ_ONLY);
	assert_int_equal(mask(AT_TEXT, 0, 1), OD_NO_OBJECT); /* half of a value */
	assert_int_equal(mask(9, 0, 1), OD_NO_OBJECT);
	assert_int_equal(values.secret, 9);
}

static void test_coils_write_their_values_and_a_command_that_is_0_nothing(void **state)
{
	(void)state;
	assert_int_equal(write_coils(1, 1, 1), OD_OK);
	assert_int_equal(values.small, 1);
	assert_int_equal(write_coils(2, 1, 0), OD_OK);
	assert_int_equal(values.a, 0x1122);
	assert_int_equal(write_coils(2, 1, 1), OD_OK);
	assert_int_equal(values.a, 0x1234);
	assert_string_equal(told, "me:7 small 01 0;me:7 a 34 12 0;");
	assert_int_equal(write_coils(2, 2, 1), OD_NO_OBJECT);
}

static void test_the_order_of_words_is_that_of_the_loop(void **state)
{
	static const struct od_entry wide[] = {{.index = 0x2000,
		.type = OD_UNSIGNED32,
		.access = OD_READ | OD_WRITE,
		.size = 4,
		.factor = 1,
		.name = "wide"}};
	static const struct modbus_point points[] = {{1, 2, 0}};
	static const struct modbus_map map = {.points = points, .point_count = 1};
	static const uint32_t zero;
	const struct od_table table = {wide, 1, &zero, 4};
	struct modbus_job job = {.kind = MODBUS_WRITE, .address = 1, .count = 2, .data = {1, 2, 3, 4}};
	uint32_t value;
	struct od wide_od;

	(void)state;
	od_init(&od, &table, &value, 1);
	wide_od = od;
	modbus_execute(&job, &map, &wide_od, false, write_value, wrote, &od);
	assert_int_equal(value, 0x01020304);
	modbus_execute(&job, &map, &wide_od, true, write_value, wrote, &od);
	assert_int_equal(value, 0x03040102);
}

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static void test_an_object_is_written_and_told(void **state)
{
	(void)state;
	assert_int_equal(write_object(0x2000, 0, "\1\2", 2), OD_OK);
	assert_int_equal(values.a, 0x0201);
	assert_int_equal(write_object(0x2000, 0, "\1", 1), OD_TOO_SHORT);
	assert_int_equal(write_object(0x2007, 0, "data", 4), OD_OK);
	assert_string_equal(taken, "data");
	assert_string_equal(told, "me:7 a 01 02 0;me:7 a 01 9;me:7 domain (4) 0;");
	assert_int_equal(write_object(0x2000, 1, "\1\2", 2), OD_NO_SUBINDEX);
	assert_int_equal(write_object(0x200A, 0, "\1\2", 2), OD_NO_OBJECT);
}

/* `size` bytes from `offset` on are these. */
static void assert_reads(uint16_t index, size_t offset, size_t size, const char *bytes)
{
	uint8_t out[32];
	size_t n = size;

	assert_int_equal(client.registers.read_object(client.registers.ctx, index, 0, offset, out, &n), OD_OK);
	assert_int_equal(n, strlen(bytes));
	assert_memory_equal(out, bytes, n);
}

static void assert_reads_sub(uint8_t sub, size_t offset, size_t size, const char *bytes)
{
	uint8_t out[32];
	size_t n = size;

	assert_int_equal(client.registers.read_object(client.registers.ctx, 0x2010, sub, offset, out, &n), OD_OK);
	assert_int_equal(n, strlen(bytes));
	assert_memory_equal(out, bytes, n);
}

static void test_a_part_is_of_the_sub_index_that_was_read_before(void **state)
{
	(void)state;
	assert_reads_sub(3, 0, 1, "c");
	assert_reads_sub(3, 1, 8, "ontent 1");
	assert_reads_sub(4, 4, 9, "fourth");
	assert_reads_sub(3, 8, 9, "2");
	assert_int_equal(generated, 2);
}

static void test_the_next_client_continues_no_read_of_the_one_before(void **state)
{
	(void)state;
	assert_reads(0x2007, 0, 4, "cont");
	modbus_access_init(&client, &link_, &MAP, &TABLE, "you:8", true, sdo_abort_code);
	assert_reads(0x2007, 8, 9, "2");
}

static enum od_status read_status(uint16_t index, uint8_t sub)
{
	uint8_t out[32];
	size_t n = sizeof(out);

	return client.registers.read_object(client.registers.ctx, index, sub, 0, out, &n);
}

static void test_a_domain_is_read_in_parts_as_of_its_beginning(void **state)
{
	(void)state;
	assert_reads(0x2006, 0, 32, "constant");
	assert_reads(0x2006, 3, 2, "st");
	assert_reads(0x2006, 7, 9, "t");
	assert_reads(0x2006, 8, 9, "");
	assert_reads(0x2006, 9, 9, "");
	assert_reads(0x2007, 0, 4, "cont");
	assert_reads(0x2007, 4, 9, "ent 1");
	assert_reads(0x2007, 8, 9, "1");
	assert_reads(0x2007, 0, 9, "content 2");
	assert_reads(0x2006, 2, 9, "nstant"); /* another one: from its own beginning */
	assert_reads(0x2007, 8, 9, "3");
	assert_int_equal(generated, 3);
}

static void test_what_cannot_be_read_of_objects_is_told(void **state)
{
	(void)state;
	assert_int_equal(read_status(0x2003, 0), OD_WRITE_ONLY);
	assert_int_equal(read_status(0x2008, 0), OD_WRITE_ONLY);
	assert_int_equal(read_status(0x2009, 0), OD_NO_DATA);
	assert_int_equal(read_status(0x2007, 1), OD_NO_SUBINDEX);
	assert_int_equal(read_status(0x200A, 0), OD_NO_OBJECT);
	assert_reads(0x2007, 0, 4, "cont");
	assert_int_equal(read_status(0x2009, 0), OD_NO_DATA);
	assert_reads(0x2007, 8, 9, "2"); /* what was read before is no longer there */
}

/* ---- the device's dictionary ------------------------------------------------------------------------------------- */

static struct od_values snapshot;

static void use_device(void)
{
	od_init(&od, &imu9_od_table, &snapshot, 5);
	snapshot.identity.serial_number = 0x00C0FFEE;
	snapshot.identity.revision_number = 0x00010002;
	modbus_link_publish(&link_, &snapshot);
	modbus_access_init(&client, &link_, &imu9_modbus_map, &imu9_od_table, "me:7", false, sdo_abort_code);
}

static void test_identification_has_the_objects_of_the_dictionary(void **state)
{
	(void)state;
	use_device();
	for (unsigned number = 0; number < 256; number++) {
		const char *text = client.registers.identification(client.registers.ctx, (uint8_t)number);
		const char *expected = number == 0	? imu9_modbus_map.vendor_name
				       : number == 1	? imu9_modbus_map.product_code
				       : number == 2	? snapshot.manufacturer_software_version
				       : number == 4	? snapshot.manufacturer_device_name
				       : number == 5	? snapshot.manufacturer_hardware_version
				       : number == 0x80 ? "00C0FFEE"
				       : number == 0x81 ? "00010002"
							: NULL;

		if (expected)
			assert_string_equal(text, expected);
		else
			assert_null(text);
	}
}

static void test_the_error_history_has_no_entry_beyond_its_count(void **state)
{
	(void)state;
	use_device();
	snapshot.error_history.number_of_errors = 2;
	modbus_link_publish(&link_, &snapshot);
	assert_int_equal(read_status(0x1003, 0), OD_OK);
	assert_int_equal(read_status(0x1003, 1), OD_OK);
	assert_int_equal(read_status(0x1003, 2), OD_OK);
	assert_int_equal(read_status(0x1003, 3), OD_NO_DATA);
	assert_int_equal(read_status(0x1005, 0), OD_OK); /* of other objects it says nothing */
	assert_int_equal(read_status(0x1018, 4), OD_OK);
}

static void test_values_are_read_in_parts_and_of_the_latest_snapshot(void **state)
{
	uint8_t out[8];
	size_t n = 8;

	(void)state;
	use_device();
	assert_int_equal(client.registers.read_object(client.registers.ctx, 0x1018, 4, 1, out, &n), OD_OK);
	assert_int_equal(n, 3);
	assert_memory_equal(out, "\xFF\xC0\x00", 3);
	snapshot.identity.serial_number = 0x01020304;
	n = 2;
	assert_int_equal(client.registers.read_object(client.registers.ctx, 0x1018, 4, 0, out, &n), OD_OK);
	assert_memory_equal(out, "\xEE\xFF", 2);
	modbus_link_publish(&link_, &snapshot);
	assert_int_equal(client.registers.read_object(client.registers.ctx, 0x1018, 4, 0, out, &n), OD_OK);
	assert_memory_equal(out, "\x04\x03", 2);
	n = 8;
	assert_int_equal(client.registers.read_object(client.registers.ctx, 0x1018, 4, 4, out, &n), OD_OK);
	assert_int_equal(n, 0);
}

static void test_who_may_write_is_said_at_the_beginning(void **state)
{
	(void)state;
	assert_false(client.registers.read_only);
	use_device();
	assert_true(client.registers.read_only);
	assert_int_equal(client.registers.abort_code(OD_NO_OBJECT), 0x06020000);
}

/* ---- the link ---------------------------------------------------------------------------------------------------- */

static int eventfds, failing_eventfd; /* the one with this number; 0: none */

int eventfd(unsigned count, int flags)
{
	assert_int_equal(count, 0);
	assert_int_equal(flags, EFD_NONBLOCK | EFD_CLOEXEC);
	if (++eventfds != failing_eventfd)
		return (int)syscall(SYS_eventfd2, count, flags);
	errno = EMFILE;
	return -1;
}

static void test_a_link_that_cannot_be_opened_leaves_no_descriptor(void **state)
{
	static struct modbus_link link;

	(void)state;
	for (failing_eventfd = 0; failing_eventfd <= 2; failing_eventfd++) {
		eventfds = 0;
		assert_int_equal(modbus_link_open(&link), failing_eventfd ? -EMFILE : 0);
		if (!failing_eventfd)
			modbus_link_close(&link);
		assert_int_equal(link.request_fd, -1);
		assert_int_equal(link.done_fd, -1);
		modbus_link_close(&link); /* once more: nothing is left to close */
		assert_int_equal(open_descriptors(), descriptors_before);
	}
}

#define TEST(name) cmocka_unit_test_setup(name, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_each_value_that_is_written_is_told_with_its_client),
		TEST(test_of_several_values_none_is_written_when_one_cannot_be),
		TEST(test_of_several_values_none_is_written_when_one_is_beyond_its_limit),
		TEST(test_of_a_request_no_more_is_read_than_it_has),
		TEST(test_a_value_that_cannot_be_read_is_written_alone),
		TEST(test_what_was_written_before_a_refusal_is_taken_back),
		TEST(test_an_old_value_that_is_refused_is_put_back),
		TEST(test_a_write_that_takes_longer_counts_as_written),
		TEST(test_a_mask_changes_the_bits_that_it_names),
		TEST(test_coils_write_their_values_and_a_command_that_is_0_nothing),
		TEST(test_the_order_of_words_is_that_of_the_loop),
		TEST(test_an_object_is_written_and_told),
		TEST(test_a_domain_is_read_in_parts_as_of_its_beginning),
		TEST(test_a_part_is_of_the_sub_index_that_was_read_before),
		TEST(test_the_next_client_continues_no_read_of_the_one_before),
		TEST(test_what_cannot_be_read_of_objects_is_told),
		TEST(test_identification_has_the_objects_of_the_dictionary),
		TEST(test_the_error_history_has_no_entry_beyond_its_count),
		TEST(test_values_are_read_in_parts_and_of_the_latest_snapshot),
		TEST(test_who_may_write_is_said_at_the_beginning),
		TEST(test_a_link_that_cannot_be_opened_leaves_no_descriptor),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}

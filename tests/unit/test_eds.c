/* The EDS loader: the contents of a file are in the table, and an error names its line. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "od_values.h"
#include "tools/eds/eds.h"

/* A complete, valid file. Each test changes one place of it. */
static const char GOOD[] = "[FileInfo]\n"
			   "FileName=test.eds\n"
			   "[DeviceInfo]\n"
			   "VendorName=Somebody\n"
			   "VendorNumber=0x00000012\n"
			   "NrOfRXPDO=0\n"
			   "NrOfTXPDO=1\n"
			   "[MandatoryObjects]\n"
			   "SupportedObjects=3\n"
			   "1=0x1000\n"
			   "2=0x1001\n"
			   "3=0x1018\n"
			   "[OptionalObjects]\n"
			   "SupportedObjects=2\n"
			   "1=0x1800\n"
			   "2=0x1A00\n"
			   "[ManufacturerObjects]\n"
			   "SupportedObjects=2\n"
			   "1=0x2000\n"
			   "2=0x2001\n"
			   "[1000]\n"
			   "ParameterName=Device type\n"
			   "DataType=0x0007\n"
			   "AccessType=const\n"
			   "DefaultValue=0x0004019A\n"
			   "[1001]\n"
			   "ParameterName=Error register\n"
			   "DataType=0x0005\n"
			   "AccessType=ro\n"
			   "PDOMapping=1\n"
			   "[1018]\n"
			   "ParameterName=Identity\n"
			   "ObjectType=0x9\n"
			   "SubNumber=2\n"
			   "[1018sub0]\n"
			   "ParameterName=Count\n"
			   "DataType=0x0005\n"
			   "AccessType=const\n"
			   "DefaultValue=1 \n"
			   "[1018sub1]\n"
			   "ParameterName=Vendor-ID\n"
			   "DataType=0x0007\n"
			   "AccessType=ro\n"
			   "DefaultValue=0x00000012\n"
			   "[1800]\n"
			   "ParameterName=TPDO1 communication\n"
			   "ObjectType=0x9\n"
			   "SubNumber=2\n"
			   "[1800sub0]\n"
			   "ParameterName=Count\n"
			   "DataType=0x0005\n"
			   "AccessType=const\n"
			   "DefaultValue=1  \n"
			   "[1800sub1]\n"
			   "ParameterName=COB-ID\n"
			   "DataType=0x0007\n"
			   "AccessType=rw\n"
			   "DefaultValue=$NODEID+0x180\n"
			   "[1A00]\n"
			   "ParameterName=TPDO1 mapping\n"
			   "ObjectType=0x9\n"
			   "SubNumber=4\n"
			   "[1A00sub0]\n"
			   "ParameterName=Number of mapped objects\n"
			   "DataType=0x0005\n"
			   "AccessType=rw\n"
			   "DefaultValue=2\n"
			   "[1A00sub1]\n"
			   "ParameterName=Object 1\n"
			   "DataType=0x0007\n"
			   "AccessType=rw\n"
			   "DefaultValue=0x20000120\n"
			   "[1A00sub2]\n"
			   "ParameterName=Object 2\n"
			   "DataType=0x0007\n"
			   "AccessType=rw\n"
			   "DefaultValue=0x10010008\n"
			   "[1A00sub3]\n"
			   "ParameterName=Object 3\n"
			   "DataType=0x0007\n"
			   "AccessType=rw\n"
			   "DefaultValue=0\n"
			   "[2000]\n"
			   "ParameterName=Lever arm\n"
			   "ObjectType=0x8\n"
			   "SubNumber=3\n"
			   "Description=To the sensor\n"
			   "[2000sub0]\n"
			   "ParameterName=Count\n"
			   "DataType=0x0005\n"
			   "AccessType=const\n"
			   "DefaultValue=2   \n"
			   "[2000sub1]\n"
			   "ParameterName=l\n"
			   "DataType=0x0008\n"
			   "AccessType=rw\n"
			   "RealDefault=0.5\n"
			   "RealLowLimit=-10\n"
			   "RealHighLimit=10\n"
			   "PDOMapping=1 \n"
			   "Unit=m\n"
			   "[2000sub2]\n"
			   "ParameterName=s\n"
			   "DataType=0x0003\n"
			   "AccessType=rw\n"
			   "DefaultValue=-7\n"
			   "LowLimit=-100\n"
			   "HighLimit=100\n"
			   "Factor=0.25\n"
			   "[2001]\n"
			   "ParameterName=Mode\n"
			   "DataType=0x0005\n"
			   "AccessType=wo\n"
			   "ObjFlags=1\n";

static struct eds eds;
static char error[300];

static int release(void **state)
{
	(void)state;
	eds_free(&eds);
	return 0;
}

/* GOOD with the only occurrence of `from` (complete lines) replaced by `to`; NULL: removed. */
static char *changed(const char *from, const char *to)
{
	static char text[2 * sizeof(GOOD)];
	const char *place = from;
	char wanted[600];

	snprintf(wanted, sizeof(wanted), "\n%s\n", from);
	place = strstr(GOOD, wanted);
	assert_non_null(place);
	assert_null(strstr(place + 1, wanted));
	snprintf(text, sizeof(text), "%.*s\n%s%s%s", (int)(place - GOOD), GOOD, to ? to : "", to ? "\n" : "",
		place + strlen(wanted));
	return text;
}

static int load(const char *text, enum eds_rules rules)
{
	eds_free(&eds);
	error[0] = '\0';
	return eds_parse(&eds, "test.eds", text, strlen(text), rules, error, sizeof(error));
}

static unsigned line_of(const char *text, const char *line)
{
	char wanted[200];
	unsigned number = 1;

	snprintf(wanted, sizeof(wanted), "\n%s\n", line);
	assert_non_null(strstr(text, wanted));
	for (const char *c = text; c <= strstr(text, wanted); c++)
		number += *c == '\n';
	return number;
}

/* The text is refused with the number of the first line equal to `line`, and `what` in the message. */
static void assert_refused(const char *text, enum eds_rules rules, const char *line, const char *what)
{
	char expected[64];

	snprintf(expected, sizeof(expected), "test.eds:%u: ", line_of(text, line));
	assert_int_equal(load(text, rules), -EINVAL);
	if (strncmp(error, expected, strlen(expected)) || !strstr(error, what))
		fail_msg("expected %s...%s, got %s", expected, what, error);
	assert_null(eds.table.entries);
}

/* The strict rules refuse the change, the lenient rules accept it. */
static void assert_only_strict_refuses(const char *from, const char *to, const char *line, const char *what)
{
	const char *text = changed(from, to);

	assert_refused(text, EDS_STRICT, line, what);
	assert_int_equal(load(text, EDS_LENIENT), 0);
}

static void assert_both_refuse(const char *from, const char *to, const char *line, const char *what)
{
	const char *text = changed(from, to);

	assert_refused(text, EDS_STRICT, line, what);
	assert_refused(text, EDS_LENIENT, line, what);
}

static const struct od_entry *entry_of(uint16_t index, uint8_t sub)
{
	const struct od_entry *entry = od_find(&eds.table, index, sub, NULL);

	assert_non_null(entry);
	return entry;
}

/* The default of an entry of up to 8 bytes as an unsigned number. */
static uint64_t default_of(uint16_t index, uint8_t sub)
{
	const struct od_entry *entry = entry_of(index, sub);
	const uint8_t *at = (const uint8_t *)eds.table.defaults + entry->offset;
	uint16_t u16;
	uint32_t u32;
	uint64_t u64;

	switch (entry->size) {
	case 1:
		return *at;
	case 2:
		return memcpy(&u16, at, 2), u16;
	case 4:
		return memcpy(&u32, at, 4), u32;
	default:
		assert_int_equal(entry->size, 8);
		return memcpy(&u64, at, 8), u64;
	}
}

/* ---- contents ---- */

static void test_a_valid_file_is_loaded(void **state)
{
	(void)state;
	if (load(GOOD, EDS_STRICT))
		fail_msg("%s", error);
	assert_int_equal(eds.table.count, 14);
	assert_int_equal(eds.object_count, 7);
	assert_string_equal(eds.info.file_name, "test.eds");
	assert_string_equal(eds.info.vendor_name, "Somebody");
	assert_int_equal(eds.info.vendor_number, 0x12);
	assert_string_equal(eds.info.product_name, "");
}

static void test_a_sub_index_that_begins_with_the_name_of_its_object_has_the_rest_as_name(void **state)
{
	static const struct {
		const char *label, *name;
	} CASES[] = {{"Lever arm l", "lever_arm.l"}, {"LEVER-ARM l", "lever_arm.l"},
		{"Lever arms", "lever_arm.lever_arms"}, {"Lever arm", "lever_arm.lever_arm"},
		{"Lever arm 1", "lever_arm.lever_arm_1"}, {"The lever arm l", "lever_arm.the_lever_arm_l"}};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(*CASES); i++) {
		char line[64];

		snprintf(line, sizeof(line), "ParameterName=%s", CASES[i].label);
		assert_int_equal(load(changed("ParameterName=l", line), EDS_STRICT), 0);
		assert_string_equal(entry_of(0x2000, 1)->name, CASES[i].name);
		assert_int_equal(load(changed("ParameterName=l", line), EDS_LENIENT), 0);
		assert_string_equal(entry_of(0x2000, 1)->name, CASES[i].name);
	}
}

static void test_an_entry_has_name_unit_factor_limits_and_default(void **state)
{
	const struct od_entry *l, *s;

	(void)state;
	assert_int_equal(load(GOOD, EDS_STRICT), 0);
	l = entry_of(0x2000, 1);
	s = entry_of(0x2000, 2);
	assert_string_equal(l->name, "lever_arm.l");
	assert_string_equal(l->unit, "m");
	assert_true(l->factor == 1);
	assert_true(l->low.f == -10 && l->high.f == 10);
	assert_int_equal(default_of(0x2000, 1), 0x3F000000);
	assert_true(s->factor == 0.25);
	assert_int_equal(s->resolution, 0);
	assert_true(s->low.i == -100 && s->high.i == 100);
	assert_int_equal(default_of(0x2000, 2), 0xFFF9);
	assert_string_equal(entry_of(0x1000, 0)->name, "device_type");
	assert_string_equal(eds.objects[5].label, "Lever arm");
	assert_string_equal(eds.objects[5].description, "To the sensor");
}

static void test_a_resolution_names_the_entry_that_holds_the_step(void **state)
{
	(void)state;
	assert_int_equal(load(changed("Factor=0.25", "Factor=0.25\nResolution=Mode"), EDS_STRICT), 0);
	assert_ptr_equal(od_resolution(&eds.table, entry_of(0x2000, 2)), entry_of(0x2001, 0));
	assert_null(od_resolution(&eds.table, entry_of(0x2000, 1)));
	assert_only_strict_refuses("Factor=0.25", "Factor=0.25\nResolution=nothing", "Resolution=nothing", "UNSIGNED");
	assert_null(od_resolution(&eds.table, entry_of(0x2000, 2)));
	assert_only_strict_refuses(
		"Factor=0.25", "Factor=0.25\nResolution=lever_arm.l", "Resolution=lever_arm.l", "UNSIGNED");
}

static void test_words_of_values_and_bits_are_read_and_checked(void **state)
{
	static const char *const WRONG[] = {
		"Values=a, B", "Values=3 a, 3 b", "Values=3 a, b, 2 c", "Values=256 a", "Bits=8 a", "Values=a/b"};
	struct od_word word = {0};

	(void)state;
	assert_int_equal(
		load(changed("DataType=0x0005\nAccessType=wo", "DataType=0x0005\n;Bits=up, 7 down\nAccessType=wo"),
			EDS_STRICT),
		0);
	assert_true(entry_of(0x2001, 0)->words_of_bits);
	assert_true(od_next_word(entry_of(0x2001, 0), &word) && word.number == 0);
	assert_true(od_next_word(entry_of(0x2001, 0), &word) && word.number == 7);
	assert_memory_equal(word.text, "down", word.length);
	assert_false(od_next_word(entry_of(0x2001, 0), &word));
	assert_false(od_next_word(entry_of(0x2000, 1), &(struct od_word){0}));
	for (size_t i = 0; i < sizeof(WRONG) / sizeof(*WRONG); i++) {
		char text[80];

		snprintf(text, sizeof(text), "ObjFlags=1\n%s", WRONG[i]);
		assert_both_refuse("ObjFlags=1", text, WRONG[i], "is not a word");
	}
	assert_both_refuse("RealDefault=0.5", "RealDefault=0.5\nValues=a", "Values=a", "integers only");
}

static void test_access_and_mapping_become_bits(void **state)
{
	(void)state;
	assert_int_equal(load(GOOD, EDS_STRICT), 0);
	assert_int_equal(entry_of(0x1000, 0)->access, OD_READ | OD_CONST);
	assert_int_equal(entry_of(0x1001, 0)->access, OD_READ | OD_TPDO);
	assert_int_equal(entry_of(0x1800, 1)->access, OD_READ | OD_WRITE | OD_STORED | OD_NODE_ID);
	assert_int_equal(entry_of(0x2000, 1)->access,
		OD_READ | OD_WRITE | OD_STORED | OD_TPDO | OD_RPDO | OD_LIMIT_LOW | OD_LIMIT_HIGH);
	assert_int_equal(entry_of(0x2001, 0)->access, OD_WRITE);
}

static void test_access_rwr_and_rww_give_the_direction_of_the_pdo(void **state)
{
	(void)state;
	assert_int_equal(load(changed("AccessType=wo\nObjFlags=1", "AccessType=rwr\nPDOMapping=1"), EDS_STRICT), 0);
	assert_int_equal(entry_of(0x2001, 0)->access, OD_READ | OD_WRITE | OD_STORED | OD_TPDO);
	assert_int_equal(load(changed("AccessType=wo\nObjFlags=1", "AccessType=RWW\nPDOMapping=1"), EDS_STRICT), 0);
	assert_int_equal(entry_of(0x2001, 0)->access, OD_READ | OD_WRITE | OD_STORED | OD_RPDO);
}

static void test_entries_excluded_from_download_are_not_stored(void **state)
{
	(void)state;
	assert_int_equal(load(changed("AccessType=wo\nObjFlags=1", "AccessType=rw\nObjFlags=1"), EDS_STRICT), 0);
	assert_int_equal(entry_of(0x2001, 0)->access, OD_READ | OD_WRITE);
}

static void test_the_flags_of_an_object_apply_to_its_sub_indices(void **state)
{
	(void)state;
	assert_int_equal(load(changed("Description=To the sensor", "ObjFlags=1"), EDS_STRICT), 0);
	assert_false(entry_of(0x2000, 1)->access & OD_STORED);
}

static void test_the_node_id_may_be_on_either_side(void **state)
{
	static const char *const TEXTS[] = {"DefaultValue=$NODEID+0x180", "DefaultValue=0x180+$NODEID",
		"DefaultValue=$nodeid + 384", "DefaultValue=384 +$NodeId"};

	(void)state;
	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(*TEXTS); i++) {
		assert_int_equal(load(changed("DefaultValue=$NODEID+0x180", TEXTS[i]), EDS_STRICT), 0);
		assert_true(entry_of(0x1800, 1)->access & OD_NODE_ID);
		assert_int_equal(default_of(0x1800, 1), 0x180);
	}
	assert_int_equal(load(changed("DefaultValue=$NODEID+0x180", "DefaultValue=$NODEID"), EDS_STRICT), 0);
	assert_true(entry_of(0x1800, 1)->access & OD_NODE_ID);
	assert_int_equal(default_of(0x1800, 1), 0);
}

static void test_integers_are_decimal_hex_or_octal(void **state)
{
	(void)state;
	assert_int_equal(load(changed("DefaultValue=0x0004019A", "DefaultValue=010"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x1000, 0), 8);
	assert_int_equal(load(changed("DefaultValue=0x0004019A", "DefaultValue=0XfF"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x1000, 0), 255);
	assert_int_equal(load(changed("DefaultValue=0x0004019A", "DefaultValue=4294967295"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x1000, 0), 0xFFFFFFFF);
}

static void test_hex_of_full_width_is_a_negative_number_in_twos_complement(void **state)
{
	(void)state;
	assert_int_equal(load(changed("LowLimit=-100", "LowLimit=0xFF9C"), EDS_STRICT), 0);
	assert_true(entry_of(0x2000, 2)->low.i == -100);
	assert_int_equal(load(changed("DefaultValue=-7", "DefaultValue=0xFFF9"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x2000, 2), 0xFFF9);
}

static void test_a_real_default_may_be_decimal_or_the_bits_in_hex(void **state)
{
	(void)state;
	assert_int_equal(load(changed("RealDefault=0.5", "DefaultValue=-0.25"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x2000, 1), 0xBE800000);
	assert_int_equal(load(changed("RealDefault=0.5", "DefaultValue=0x3F800000"), EDS_STRICT), 0);
	assert_int_equal(default_of(0x2000, 1), 0x3F800000);
}

static void test_a_real_default_may_equal_a_limit_that_is_not_a_binary_fraction(void **state)
{
	(void)state;
	assert_int_equal(
		load(changed("RealDefault=0.5\nRealLowLimit=-10", "RealDefault=0.01\nRealLowLimit=0.01"), EDS_STRICT),
		0);
}

static void test_strings_have_the_size_given_in_the_file(void **state)
{
	static const char TEXT[] = "DataType=0x0009\nAccessType=ro\nDefaultValue=Hello\nStringSize=12";

	(void)state;
	assert_int_equal(load(changed("DataType=0x0005\nAccessType=wo\nObjFlags=1", TEXT), EDS_STRICT), 0);
	assert_int_equal(entry_of(0x2001, 0)->size, 12);
	assert_memory_equal((const char *)eds.table.defaults + entry_of(0x2001, 0)->offset, "Hello\0\0\0\0\0\0\0", 12);
}

static void test_octets_are_read_with_and_without_blanks(void **state)
{
	static const char *const TEXTS[] = {
		"DataType=10\nAccessType=ro\nDefaultValue=0A0bff", "DataType=10\nAccessType=ro\nDefaultValue=0A 0b ff"};

	(void)state;
	for (int i = 0; i < 2; i++) {
		assert_int_equal(load(changed("DataType=0x0005\nAccessType=wo\nObjFlags=1", TEXTS[i]), EDS_STRICT), 0);
		assert_int_equal(entry_of(0x2001, 0)->size, 3);
		assert_memory_equal((const char *)eds.table.defaults + entry_of(0x2001, 0)->offset, "\x0A\x0B\xFF", 3);
	}
}

static void test_a_domain_has_no_value(void **state)
{
	(void)state;
	assert_int_equal(load(changed("DataType=0x0005\nAccessType=wo\nObjFlags=1",
				      "ObjectType=2\nAccessType=rw\nDefaultValue=file.bin"),
				 EDS_STRICT),
		0);
	assert_int_equal(entry_of(0x2001, 0)->type, OD_DOMAIN);
	assert_int_equal(entry_of(0x2001, 0)->size, 0);
	assert_int_equal(entry_of(0x2001, 0)->access, OD_READ | OD_WRITE);
}

static void test_compact_sub_objects_use_the_keys_of_their_object(void **state)
{
	static const char TEXT[] = "ObjectType=8\nCompactSubObj=3\nDataType=3\nAccessType=rw\nDefaultValue=-5\n"
				   "[2001Name]\nNrOfEntries=1\n2=Middle\n"
				   "[2001Value]\nNrOfEntries=1\n3=12\n";

	(void)state;
	if (load(changed("DataType=0x0005\nAccessType=wo\nObjFlags=1", TEXT), EDS_STRICT))
		fail_msg("%s", error);
	assert_int_equal(default_of(0x2001, 0), 3);
	assert_string_equal(entry_of(0x2001, 1)->name, "mode.mode1");
	assert_string_equal(entry_of(0x2001, 2)->name, "mode.middle");
	assert_int_equal(default_of(0x2001, 1), 0xFFFB);
	assert_int_equal(default_of(0x2001, 3), 12);
	assert_int_equal(entry_of(0x2001, 3)->type, OD_INTEGER16);
}

static void test_keys_and_sections_are_found_in_any_case_and_any_order(void **state)
{
	(void)state;
	assert_int_equal(load(changed("ParameterName=Mode\nDataType=0x0005", "DATATYPE=5\n  parametername = Mode \r"),
				 EDS_STRICT),
		0);
	assert_int_equal(load(changed("[1A00sub1]", "[1a00SUB01]"), EDS_STRICT), 0);
	assert_string_equal(entry_of(0x2001, 0)->name, "mode");
}

static void test_crlf_comments_and_a_byte_order_mark_are_accepted(void **state)
{
	char text[3 * sizeof(GOOD)] = "\xEF\xBB\xBF", *to = text + 3;

	(void)state;
	to += sprintf(to, "; a comment = of any length, %0300d\r\n", 0);
	for (const char *from = GOOD; *from; from++) {
		if (*from == '\n')
			*to++ = '\r';
		*to++ = *from;
	}
	*to = '\0';
	if (load(text, EDS_STRICT))
		fail_msg("%s", error);
	assert_string_equal(entry_of(0x2000, 1)->unit, "m");
}

static void test_names_are_normalised(void **state)
{
	static const char *const CASES[][2] = {
		{"Lever arm", "lever_arm"},
		{"COB-ID", "cob_id"},
		{"  Slope (long16) -- preset! ", "slope_long16_preset"},
		{"TPDO1", "tpdo1"},
		{"---", ""},
		{"L\xC3\xA4nge", "l_nge"},
	};
	char name[64];

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(*CASES); i++) {
		assert_int_equal(eds_normalise(CASES[i][0], name, sizeof(name)), strlen(CASES[i][1]));
		assert_string_equal(name, CASES[i][1]);
	}
	assert_int_equal(eds_normalise("abcdef", name, 4), 3);
	assert_string_equal(name, "abc");
}

/* ---- files of other devices ---- */

static void test_lenient_rules_accept_missing_keys(void **state)
{
	static const char TEXT[] = "[OptionalObjects]\nSupportedObjects=4\n1=0x2000\n3=0x0005\n4=0x2003\n"
				   "[2000]\nDataType=0x0005\n"
				   "[2003]\nParameterName=---\nObjectType=9\n[2003sub2]\nDataType=0x0016\n";

	(void)state;
	if (load(TEXT, EDS_LENIENT))
		fail_msg("%s", error);
	assert_string_equal(entry_of(0x2000, 0)->name, "object_2000");
	assert_int_equal(entry_of(0x2000, 0)->access, OD_READ | OD_WRITE | OD_STORED);
	assert_string_equal(entry_of(0x2003, 2)->name, "object_2003.sub_2");
	assert_int_equal(entry_of(0x2003, 2)->type, OD_OCTET_STRING); /* UNSIGNED24 as bytes */
	assert_int_equal(entry_of(0x2003, 2)->size, 3);
}

static void test_an_empty_value_is_an_absent_key(void **state)
{
	(void)state;
	assert_int_equal(load(changed("LowLimit=-100", "LowLimit="), EDS_STRICT), 0);
	assert_false(entry_of(0x2000, 2)->access & OD_LIMIT_LOW);
}

/* ---- errors ---- */

static void test_a_line_without_eds_syntax_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("Unit=m", "Unit m", "Unit m", "is not a [section]");
	assert_both_refuse("[2001]", "[2001", "[2001", "is not a [section]");
}

static void test_a_line_too_long_is_refused(void **state)
{
	char line[220] = "Unit=";

	(void)state;
	memset(line + 5, 'x', sizeof(line) - 6);
	assert_int_equal(load(changed("Unit=m", line), EDS_LENIENT), -EINVAL);
	assert_non_null(strstr(error, "is longer than 198 characters"));
	line[198] = '\0';
	assert_int_equal(load(changed("Unit=m", line), EDS_STRICT), 0);
	assert_int_equal(strlen(entry_of(0x2000, 1)->unit), 198 - 5);
}

static void test_a_nul_byte_is_refused(void **state)
{
	static const char TEXT[] = "[FileInfo]\nFileName=a\0b\n";

	(void)state;
	assert_int_equal(
		eds_parse(&eds, "test.eds", TEXT, sizeof(TEXT) - 1, EDS_LENIENT, error, sizeof(error)), -EINVAL);
	assert_string_equal(error, "test.eds:2: contains a NUL byte; an EDS is plain text");
}

static void test_a_duplicate_key_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("Unit=m", "Unit=m\nUNIT=mm", "UNIT=mm", "already has UNIT in line");
}

static void test_a_duplicate_section_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("[2001]", "[2000SUB2]\nUnit=V\n[2001]", "[2000SUB2]", "twice");
}

static void test_a_duplicate_sub_index_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("[2001]", "[2000sub02]\nParameterName=again\nDataType=5\nAccessType=ro\n[2001]",
		"ParameterName=again", "twice");
}

static void test_a_listed_object_without_section_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("SupportedObjects=2\n1=0x2000\n2=0x2001", "SupportedObjects=3\n1=0x2000\n2=0x2001\n3=0x2002",
		"3=0x2002", "no section [2002]");
}

static void test_an_object_listed_twice_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("2=0x2001", "2=0x2000", "2=0x2000", "listed in line");
}

static void test_a_list_with_a_wrong_count_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("1=0x1800", NULL, "SupportedObjects=2", "but 1 are listed");
	assert_only_strict_refuses("1=0x1800", "3=0x1800", "SupportedObjects=2", "no entry 1");
}

static void test_an_object_in_the_wrong_list_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("SupportedObjects=2\n1=0x1800\n2=0x1A00",
		"SupportedObjects=3\n1=0x1800\n2=0x1A00\n3=0x2002\n[2002]\nParameterName=Lost\nDataType=5\nAccessType="
		"ro",
		"3=0x2002", "does not belong");
}

static void test_a_section_of_an_unlisted_object_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("[2001]", "[2002]\nParameterName=Lost\nDataType=5\nAccessType=ro\n[2001]", "[2002]",
		"belongs to an object that is not listed");
}

static void test_a_wrong_sub_number_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("SubNumber=3", "SubNumber=5", "SubNumber=5", "but 3 sub-indices");
	assert_only_strict_refuses("SubNumber=3", NULL, "ParameterName=Lever arm", "no SubNumber");
	assert_only_strict_refuses("[1018sub0]", "[1018sub2]", "SubNumber=2", "no sub-index 0");
}

static void test_a_wrong_sub_index_0_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("DefaultValue=2   ", "DefaultValue=5", "DefaultValue=5", "highest sub-index");
}

static void test_an_array_without_any_sub_index_is_refused(void **state)
{
	(void)state;
	assert_both_refuse(
		"ParameterName=Mode", "ParameterName=Mode \nObjectType=8", "ParameterName=Mode ", "no sub-index");
}

static void test_a_bad_sub_index_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("[2000sub2]", "[2000subG]", "[2000subG]", "name a sub-index");
	assert_both_refuse("[2000sub2]", "[2000sub100]", "[2000sub100]", "name a sub-index");
	assert_both_refuse("[2000sub2]", "[2000sub]", "[2000sub]", "name a sub-index");
}

static void test_an_unknown_type_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("DataType=0x0003", "DataType=0x0099", "DataType=0x0099", "unknown");
	assert_both_refuse("DataType=0x0003", "DataType=INTEGER", "DataType=INTEGER", "unknown");
	assert_both_refuse("DataType=0x0003", NULL, "[2000sub2]", "no DataType");
	assert_only_strict_refuses("DataType=0x0003\nAccessType=rw\nDefaultValue=-7",
		"DataType=0x0010\nAccessType=rw\nDefaultValue=-7", "DataType=0x0010", "unknown");
}

static void test_an_unknown_access_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("AccessType=wo", "AccessType=write", "AccessType=write", "is not one of");
	assert_only_strict_refuses("AccessType=wo", NULL, "[2001]", "no AccessType");
}

static void test_an_unknown_object_type_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses(
		"ParameterName=Mode", "ParameterName=Mode\nObjectType=5", "ObjectType=5", "is not 0x2");
}

static void test_a_default_outside_the_limits_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("DefaultValue=-7", "DefaultValue=-101", "DefaultValue=-101", "below");
	assert_only_strict_refuses("DefaultValue=-7", "DefaultValue=101", "DefaultValue=101", "above");
	assert_only_strict_refuses("RealDefault=0.5", "RealDefault=10.5", "RealDefault=10.5", "above");
}

static void test_a_value_out_of_range_of_its_type_is_refused(void **state)
{
	static const char *const TEXTS[] = {"DefaultValue=-32769", "DefaultValue=32768", "DefaultValue=0x10000",
		"DefaultValue=1.5", "DefaultValue=08", "DefaultValue=seven", "DefaultValue=7 7", "DefaultValue=--7",
		"DefaultValue=$NODEID-7", "DefaultValue=$NODEID+", "DefaultValue=0x"};

	(void)state;
	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(*TEXTS); i++)
		assert_both_refuse("DefaultValue=-7", TEXTS[i], TEXTS[i], "not a value of data type 0x0003");
	assert_both_refuse(
		"RealDefault=0.5", "RealDefault=half", "RealDefault=half", "not a value of data type 0x0008");
	assert_both_refuse("RealDefault=0.5", "RealDefault=nan", "RealDefault=nan", "not a value of data type 0x0008");
	assert_both_refuse(
		"RealDefault=0.5", "RealDefault=1e39", "RealDefault=1e39", "not a value of data type 0x0008");
	assert_both_refuse("DefaultValue=0x0004019A", "DefaultValue=-1", "DefaultValue=-1", "data type 0x0007");
	assert_both_refuse("HighLimit=100", "HighLimit=lots", "HighLimit=lots", "data type 0x0003");
	assert_both_refuse("Factor=0.25", "Factor=0", "Factor=0", "Factor");
	assert_both_refuse("ObjFlags=1", "ObjFlags=x", "ObjFlags=x", "not a number");
	assert_both_refuse("Description=To the sensor", "ObjFlags=x", "ObjFlags=x", "not a number");
	assert_both_refuse("1=0x1800", "1=first", "1=first", "not an index");
	assert_both_refuse("SubNumber=3", "SubNumber=three", "SubNumber=three", "not a number");
}

static void test_a_string_longer_than_its_size_is_refused(void **state)
{
	(void)state;
	assert_both_refuse("DataType=0x0005\nAccessType=wo\nObjFlags=1",
		"DataType=9\nAccessType=ro\nStringSize=4\nDefaultValue=Hello", "DefaultValue=Hello",
		"more than StringSize=4");
	assert_both_refuse("DataType=0x0005\nAccessType=wo\nObjFlags=1", "DataType=9\nAccessType=ro\nStringSize=65",
		"StringSize=65", "not 1 to 64");
	assert_both_refuse("DataType=0x0005\nAccessType=wo\nObjFlags=1", "DataType=10\nAccessType=ro\nDefaultValue=abc",
		"DefaultValue=abc", "hex digits");
}

static void test_a_mapping_to_a_missing_object_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses(
		"DefaultValue=0x20000120", "DefaultValue=0x20050120", "DefaultValue=0x20050120", "not in the file");
	assert_only_strict_refuses("DefaultValue=2", "DefaultValue=3", "DefaultValue=0", "not in the file");
}

static void test_a_mapping_to_an_object_that_cannot_be_mapped_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses(
		"DefaultValue=0x20000120", "DefaultValue=0x10000020", "DefaultValue=0x10000020", "cannot be mapped");
}

static void test_a_mapping_of_the_wrong_length_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("DefaultValue=0x20000120", "DefaultValue=0x20000110", "DefaultValue=0x20000110",
		"16 bits of lever_arm.l, which has 32");
}

static void test_a_default_mapping_longer_than_a_pdo_is_refused(void **state)
{
	const char *text =
		changed("DefaultValue=2\n[1A00sub1]\nParameterName=Object 1\nDataType=0x0007\nAccessType=rw\n"
			"DefaultValue=0x20000120\n[1A00sub2]\nParameterName=Object 2\nDataType=0x0007\n"
			"AccessType=rw\nDefaultValue=0x10010008\n[1A00sub3]\nParameterName=Object 3\n"
			"DataType=0x0007\nAccessType=rw\nDefaultValue=0",
			"DefaultValue=3\n[1A00sub1]\nParameterName=Object 1\nDataType=0x0007\nAccessType=rw\n"
			"DefaultValue=0x20000120\n[1A00sub2]\nParameterName=Object 2\nDataType=0x0007\n"
			"AccessType=rw\nDefaultValue=0x20000120\n[1A00sub3]\nParameterName=Object 3\n"
			"DataType=0x0007\nAccessType=rw\nDefaultValue=0x10010008");

	(void)state;
	assert_refused(text, EDS_STRICT, "DefaultValue=3", "has 72 bits; a PDO has at most 64");
	assert_int_equal(load(text, EDS_LENIENT), 0);
}

static void test_two_objects_with_one_name_are_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses(
		"ParameterName=Mode", "ParameterName=LEVER-ARM", "ParameterName=LEVER-ARM", "choose another");
}

static void test_two_sub_indices_with_one_name_are_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("ParameterName=s", "ParameterName=L!", "ParameterName=L!", "choose another");
}

static void test_a_name_that_is_not_a_c_identifier_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses(
		"ParameterName=Mode", "ParameterName=2nd mode", "ParameterName=2nd mode", "must begin with a letter");
	assert_only_strict_refuses("ParameterName=Mode", NULL, "[2001]", "no ParameterName");
}

static void test_device_info_that_differs_from_the_objects_is_refused(void **state)
{
	(void)state;
	assert_only_strict_refuses("VendorNumber=0x00000012", "VendorNumber=0x13", "VendorNumber=0x13", "[1018sub1]");
	assert_only_strict_refuses("NrOfTXPDO=1", "NrOfTXPDO=4", "NrOfTXPDO=4", "must be 1");
	assert_only_strict_refuses("NrOfRXPDO=0", "NrOfRXPDO=1", "NrOfRXPDO=1", "must be 0");
	assert_both_refuse("NrOfTXPDO=1", "NrOfTXPDO=many", "NrOfTXPDO=many", "not a number");
}

static void test_a_file_that_is_not_an_eds_is_refused(void **state)
{
	(void)state;
	assert_int_equal(load("", EDS_LENIENT), -EINVAL);
	assert_string_equal(error, "test.eds: has no content; is it an EDS file?");
	assert_int_equal(load("[a]\nb=c\n", EDS_LENIENT), -EINVAL);
	assert_string_equal(error, "test.eds: lists no objects; is it an EDS file?");
}

static void test_a_file_that_cannot_be_read_is_named_in_the_error(void **state)
{
	(void)state;
	assert_int_equal(eds_load(&eds, "/nonexistent.eds", EDS_LENIENT, error, sizeof(error)), -ENOENT);
	assert_string_equal(error, "/nonexistent.eds: No such file or directory");
	assert_int_equal(eds_load(&eds, "/", EDS_LENIENT, error, sizeof(error)), -EISDIR);
}

static void test_an_error_text_is_truncated_to_its_buffer(void **state)
{
	char small[16];

	(void)state;
	memset(small, 'x', sizeof(small));
	assert_int_equal(eds_parse(&eds, "test.eds", "[a]\nb\n", 6, EDS_LENIENT, small, 12), -EINVAL);
	assert_string_equal(small, "test.eds:2:");
	assert_int_equal(small[12], 'x');
}

static void test_a_file_truncated_anywhere_is_loaded_or_refused_by_name(void **state)
{
	(void)state;
	for (size_t size = 0; size < sizeof(GOOD); size++) {
		char *cut = malloc(size + 1); /* exact size: a sanitizer finds reads beyond the end */

		memcpy(cut, GOOD, size);
		error[0] = '\0';
		for (int rules = EDS_LENIENT; rules <= EDS_STRICT; rules++) {
			if (eds_parse(&eds, "test.eds", cut, size, (enum eds_rules)rules, error, sizeof(error)))
				assert_int_equal(strncmp(error, "test.eds:", 9), 0);
			eds_free(&eds);
		}
		free(cut);
	}
}

/* ---- the device's own file ---- */

static void test_the_generated_table_equals_the_loaded_one(void **state)
{
	(void)state;
	if (eds_parse(&eds, "imu9", (const char *)imu9_eds, imu9_eds_size, EDS_STRICT, error, sizeof(error)))
		fail_msg("%s", error);
	assert_int_equal(eds.table.count, imu9_od_table.count);
	assert_int_equal(eds.table.values_size, imu9_od_table.values_size);
	assert_memory_equal(eds.table.defaults, imu9_od_table.defaults, sizeof(struct od_values));
	for (size_t i = 0; i < eds.table.count; i++) {
		const struct od_entry *a = &eds.table.entries[i], *b = &imu9_od_table.entries[i];

		assert_int_equal(a->index, b->index);
		assert_int_equal(a->sub, b->sub);
		assert_int_equal(a->type, b->type);
		assert_int_equal(a->access, b->access);
		assert_int_equal(a->size, b->size);
		assert_true(a->type == OD_DOMAIN || a->offset == b->offset);
		assert_memory_equal(&a->low, &b->low, sizeof(a->low));
		assert_memory_equal(&a->high, &b->high, sizeof(a->high));
		assert_true(a->factor == b->factor);
		assert_int_equal(a->resolution, b->resolution);
		assert_int_equal(a->resolution_sub, b->resolution_sub);
		assert_string_equal(a->name, b->name);
		assert_string_equal(a->unit, b->unit);
		assert_string_equal(a->description, b->description);
	}
}

static void test_the_device_file_has_crlf_line_ends_and_no_empty_key(void **state)
{
	(void)state;
	for (size_t i = 0; i < imu9_eds_size; i++) {
		if (imu9_eds[i] == '\n')
			assert_int_equal(imu9_eds[i - 1], '\r');
		if (imu9_eds[i] == '=')
			assert_int_not_equal(imu9_eds[i + 1], '\r');
	}
}

/* Tools show the ParameterName of a sub-index alone. "Highest sub-index supported" is the name that CiA 301
 * gives it. */
static void test_the_names_of_the_device_file_stand_alone_and_find_their_entry(void **state)
{
	(void)state;
	assert_int_equal(
		eds_parse(&eds, "imu9", (const char *)imu9_eds, imu9_eds_size, EDS_STRICT, error, sizeof(error)), 0);
	for (size_t i = 0; i < eds.table.count; i++) {
		const struct od_entry *entry = &eds.table.entries[i];
		const char *label = eds.entries[i].label;

		if (!strcmp(label, "Highest sub-index supported") && entry->sub == 0 && entry->access & OD_CONST)
			continue;
		for (size_t k = 0; k < i; k++)
			if (!strcmp(label, eds.entries[k].label))
				fail_msg("%s and %s: %s", entry->name, eds.table.entries[k].name, label);
		if (entry->index == 0x1018 || entry->index == 0x1020 || (entry->index == 0x1003 && entry->sub == 0))
			continue; /* the names of CiA 301 */
		if (od_find_name(&eds.table, label) != entry)
			fail_msg("%s: %s", entry->name, label);
	}
}

static void test_the_factor_of_a_measurement_is_its_default_resolution(void **state)
{
	static struct od_values values;
	struct od od;
	size_t scaled = 0;

	(void)state;
	od_init(&od, &imu9_od_table, &values, 1);
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		const struct od_entry *resolution = od_resolution(&imu9_od_table, entry);

		if (!resolution)
			continue;
		scaled++;
		assert_true(fabs(entry->factor - od_step(&od, entry)) < 1e-12);
		assert_string_equal(entry->unit, resolution->unit);
	}
	assert_int_equal(scaled, 53); /* 2100h to 2102h, 2140h to 2147h; slopes, presets and offsets of CiA 410 */
}

/* ---- the programs gen-od and eds-revision ---- */

static char gen_od[512];

static int run_gen_od(const char *eds_text, const char *folder, char *output, size_t capacity)
{
	char path[64], command[1024];
	FILE *file;
	size_t length;

	snprintf(path, sizeof(path), "%s/in.eds", folder);
	file = fopen(path, "wb");
	assert_non_null(file);
	fputs(eds_text, file);
	fclose(file);
	snprintf(command, sizeof(command), "%s %s %s/out 2>&1", gen_od, path, folder);
	file = popen(command, "r");
	assert_non_null(file);
	length = fread(output, 1, capacity - 1, file);
	output[length] = '\0';
	return WEXITSTATUS(pclose(file));
}

static void test_gen_od_refuses_a_broken_file_with_its_line_and_leaves_no_output(void **state)
{
	static const char *const OUTPUTS[] = {"od_values.h", "od_table.c", "objects.md", "imu9-gateway.dbc",
		"modbus_map.c", "modbus.md", "modbus.csv", "modbus-telegraf.conf", "modbus-node-red.json"};
	enum { COUNT = sizeof(OUTPUTS) / sizeof(*OUTPUTS) };
	static const char *const BROKEN[][2] = {
		{"DataType=0x0099", "unknown"},		      /* an error of the file */
		{"ParameterName=default", "keyword of the C"} /* an error only for C */
	};
	char folder[] = "/tmp/imu9-gen-od-XXXXXX", path[64], output[400], expected[100];

	(void)state;
	if (access(gen_od, X_OK))
		skip();
	assert_non_null(mkdtemp(folder));
	snprintf(path, sizeof(path), "mkdir %s/out", folder);
	assert_int_equal(system(path), 0);
	for (int i = 0; i < 2; i++) {
		const char *text = changed(i ? "ParameterName=Mode" : "DataType=0x0003", BROKEN[i][0]);

		assert_int_equal(run_gen_od(text, folder, output, sizeof(output)), 1);
		snprintf(expected, sizeof(expected), "gen-od: %s/in.eds:%u: ", folder, line_of(text, BROKEN[i][0]));
		assert_int_equal(strncmp(output, expected, strlen(expected)), 0);
		assert_non_null(strstr(output, BROKEN[i][1]));
		for (size_t k = 0; k < COUNT; k++) {
			snprintf(path, sizeof(path), "%s/out/%s", folder, OUTPUTS[k]);
			assert_int_not_equal(access(path, F_OK), 0);
		}
	}
	assert_int_equal(run_gen_od(GOOD, folder, output, sizeof(output)), 0);
	assert_string_equal(output, "");
	for (size_t k = 0; k < COUNT; k++) {
		snprintf(path, sizeof(path), "%s/out/%s", folder, OUTPUTS[k]);
		assert_int_equal(unlink(path), 0);
	}
	snprintf(path, sizeof(path), "rm -r %s", folder);
	assert_int_equal(system(path), 0);
}

/* tools/eds/eds-revision STEP on a copy of the device's EDS: its exit status. */
static int eds_revision(const char *path, const char *step)
{
	char command[400];

	snprintf(command, sizeof(command), "tools/eds/eds-revision %s %s >%s.out 2>&1", path, step, path);
	return WEXITSTATUS(system(command));
}

/* FileVersion and FileRevision, and the same two numbers in 1018h:3, which the strict rules compare with DeviceInfo. */
static void expect_revision(const char *path, unsigned major, unsigned minor)
{
	struct eds copy;

	assert_int_equal(eds_load(&copy, path, EDS_STRICT, error, sizeof(error)), 0);
	assert_int_equal(copy.info.file_version, major);
	assert_int_equal(copy.info.file_revision, minor);
	assert_int_equal(copy.info.revision_number, major << 16 | minor);
	eds_free(&copy);
}

static void test_a_changed_eds_needs_a_new_revision(void **state)
{
	char folder[] = "/tmp/imu9-eds-revision-XXXXXX", path[64], command[200];

	(void)state;
	assert_non_null(mkdtemp(folder));
	snprintf(path, sizeof(path), "%s/copy.eds", folder);
	snprintf(command, sizeof(command), "cp eds/imu9-gateway.eds %s", path);
	assert_int_equal(system(command), 0);
	assert_int_equal(eds_revision(path, "major"), 0);
	expect_revision(path, OD_REVISION / 65536 + 1, 0);
	assert_int_equal(eds_revision(path, "check"), 0);

	snprintf(command, sizeof(command), "sed -i 's/^;RealHighLimit=10\\r/;RealHighLimit=11\\r/' %s", path);
	assert_int_equal(system(command), 0);
	assert_int_equal(eds_revision(path, "check"), 1);
	snprintf(command, sizeof(command), "grep -q 'make eds-revision' %s.out", path);
	assert_int_equal(system(command), 0);
	assert_int_equal(eds_revision(path, "minor"), 0);
	expect_revision(path, OD_REVISION / 65536 + 1, 1);
	assert_int_equal(eds_revision(path, "check"), 0);
	assert_int_equal(eds_revision(path, "minor"), 0); /* nothing changed since */
	expect_revision(path, OD_REVISION / 65536 + 1, 1);
	snprintf(command, sizeof(command), "rm -r %s", folder);
	assert_int_equal(system(command), 0);
}

#define CASE(test) cmocka_unit_test_teardown(test, release)

int main(int argc, char **argv)
{
	const struct CMUnitTest tests[] = {
		CASE(test_a_valid_file_is_loaded),
		CASE(test_a_sub_index_that_begins_with_the_name_of_its_object_has_the_rest_as_name),
		CASE(test_an_entry_has_name_unit_factor_limits_and_default),
		CASE(test_a_resolution_names_the_entry_that_holds_the_step),
		CASE(test_words_of_values_and_bits_are_read_and_checked),
		CASE(test_access_and_mapping_become_bits),
		CASE(test_access_rwr_and_rww_give_the_direction_of_the_pdo),
		CASE(test_entries_excluded_from_download_are_not_stored),
		CASE(test_the_flags_of_an_object_apply_to_its_sub_indices),
		CASE(test_the_node_id_may_be_on_either_side),
		CASE(test_integers_are_decimal_hex_or_octal),
		CASE(test_hex_of_full_width_is_a_negative_number_in_twos_complement),
		CASE(test_a_real_default_may_be_decimal_or_the_bits_in_hex),
		CASE(test_a_real_default_may_equal_a_limit_that_is_not_a_binary_fraction),
		CASE(test_strings_have_the_size_given_in_the_file),
		CASE(test_octets_are_read_with_and_without_blanks),
		CASE(test_a_domain_has_no_value),
		CASE(test_compact_sub_objects_use_the_keys_of_their_object),
		CASE(test_keys_and_sections_are_found_in_any_case_and_any_order),
		CASE(test_crlf_comments_and_a_byte_order_mark_are_accepted),
		CASE(test_names_are_normalised),
		CASE(test_lenient_rules_accept_missing_keys),
		CASE(test_an_empty_value_is_an_absent_key),
		CASE(test_a_line_without_eds_syntax_is_refused),
		CASE(test_a_line_too_long_is_refused),
		CASE(test_a_nul_byte_is_refused),
		CASE(test_a_duplicate_key_is_refused),
		CASE(test_a_duplicate_section_is_refused),
		CASE(test_a_duplicate_sub_index_is_refused),
		CASE(test_a_listed_object_without_section_is_refused),
		CASE(test_an_object_listed_twice_is_refused),
		CASE(test_a_list_with_a_wrong_count_is_refused),
		CASE(test_an_object_in_the_wrong_list_is_refused),
		CASE(test_a_section_of_an_unlisted_object_is_refused),
		CASE(test_a_wrong_sub_number_is_refused),
		CASE(test_a_wrong_sub_index_0_is_refused),
		CASE(test_an_array_without_any_sub_index_is_refused),
		CASE(test_a_bad_sub_index_is_refused),
		CASE(test_an_unknown_type_is_refused),
		CASE(test_an_unknown_access_is_refused),
		CASE(test_an_unknown_object_type_is_refused),
		CASE(test_a_default_outside_the_limits_is_refused),
		CASE(test_a_value_out_of_range_of_its_type_is_refused),
		CASE(test_a_string_longer_than_its_size_is_refused),
		CASE(test_a_mapping_to_a_missing_object_is_refused),
		CASE(test_a_mapping_to_an_object_that_cannot_be_mapped_is_refused),
		CASE(test_a_mapping_of_the_wrong_length_is_refused),
		CASE(test_a_default_mapping_longer_than_a_pdo_is_refused),
		CASE(test_two_objects_with_one_name_are_refused),
		CASE(test_two_sub_indices_with_one_name_are_refused),
		CASE(test_a_name_that_is_not_a_c_identifier_is_refused),
		CASE(test_device_info_that_differs_from_the_objects_is_refused),
		CASE(test_a_file_that_is_not_an_eds_is_refused),
		CASE(test_a_file_that_cannot_be_read_is_named_in_the_error),
		CASE(test_an_error_text_is_truncated_to_its_buffer),
		CASE(test_a_file_truncated_anywhere_is_loaded_or_refused_by_name),
		CASE(test_the_generated_table_equals_the_loaded_one),
		CASE(test_the_device_file_has_crlf_line_ends_and_no_empty_key),
		CASE(test_the_names_of_the_device_file_stand_alone_and_find_their_entry),
		CASE(test_the_factor_of_a_measurement_is_its_default_resolution),
		CASE(test_gen_od_refuses_a_broken_file_with_its_line_and_leaves_no_output),
		CASE(test_a_changed_eds_needs_a_new_revision),
	};
	const char *slash = strrchr(argv[0], '/');

	(void)argc;
	/* build/tests/unit/test_eds -> build/gen-od */
	snprintf(
		gen_od, sizeof(gen_od), "%.*s/../../gen-od", slash ? (int)(slash - argv[0]) : 1, slash ? argv[0] : ".");
	return cmocka_run_group_tests(tests, NULL, NULL);
}

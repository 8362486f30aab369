/* How a configuration is written into a node: the order and the procedures of CiA 301, and what a refusal does. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <cmocka.h>

#include "od/little_endian.h"
#include "od_values.h"
#include "tools/lib/settings.h"

enum { NODE = 5 };

static struct settings settings;
static struct settings_plan plan;
static struct od_values node_values;
static struct od node;
static char written[2000]; /* "1800:1=80000185 ..." */

static void read_text(const char *text)
{
	char error[200] = "";
	FILE *file = fmemopen((char *)(uintptr_t)text, strlen(text), "r");

	memset(&settings, 0, sizeof(settings));
	settings.table = &imu9_od_table;
	if (!settings_read(&settings, file, "test", error, sizeof(error)))
		fail_msg("%s", error);
	fclose(file);
}

/* Carries the plan out on a node that refuses `refused` ("1A00:2"), or nothing. */
static void load(const char *text, const char *refused)
{
	const struct settings_write *write;
	bool failed = false;

	od_init(&node, &imu9_od_table, &node_values, NODE);
	read_text(text);
	plan = (struct settings_plan){0};
	written[0] = '\0';
	assert_true(settings_plan_reads(&plan, &settings));
	for (size_t i = 0; i < plan.read_count; i++) {
		struct settings_read *read = &plan.reads[i];

		read->size = od_get(&node, read->entry, read->wire, sizeof(read->wire));
		read->done = true;
	}
	assert_true(settings_plan_writes(&plan));
	while ((write = settings_plan_next(&plan, failed))) {
		char name[16];

		snprintf(name, sizeof(name), "%04X:%u", write->entry->index, write->entry->sub);
		snprintf(written + strlen(written), sizeof(written) - strlen(written), "%s=%llX ", name,
			(unsigned long long)get_uint(write->wire, write->size < 8 ? write->size : 8));
		failed = refused && strcmp(name, refused) == 0;
	}
	int counts[] = {plan.written, plan.same, plan.failed};
	settings_plan_free(&plan);
	plan.written = counts[0], plan.same = counts[1], plan.failed = counts[2];
}

static void test_only_what_differs_is_written(void **state)
{
	(void)state;
	load("lever_arm.l = 0\nlever_arm.s = 0.5\n", NULL);
	assert_string_equal(written, "2000:2=3F000000 ");
	assert_true(plan.written == 1 && plan.same == 1 && plan.failed == 0);
}

static void test_a_pdo_is_invalid_while_it_is_mapped(void **state)
{
	(void)state;
	load("tpdo1_mapping.number_of_mapped_objects = 1\ntpdo1_mapping.object_1 = 0x21000210\n"
	     "tpdo1_communication.transmission_type = 3\n",
		NULL);
	assert_string_equal(written, "1800:1=C0000185 1A00:0=0 1A00:1=21000210 1A00:0=1 1800:2=3 1800:1=40000185 ");
	assert_int_equal(plan.written, 3);
}

static void test_a_refused_mapping_leaves_the_pdo_invalid_and_the_rest_is_written(void **state)
{
	(void)state;
	load("tpdo1_mapping.object_1 = 0x21000210\ntpdo2_communication.transmission_type = 3\n", "1A00:1");
	assert_string_equal(
		written, "1800:1=C0000185 1A00:0=0 1A00:1=21000210 1801:1=C0000285 1801:2=3 1801:1=40000285 ");
	assert_true(plan.written == 1 && plan.failed == 1);
}

static void test_the_emcy_cob_id_is_invalid_in_between_and_comes_back_after_a_refusal(void **state)
{
	(void)state;
	load("cob_id_emcy = 0x90\n", NULL);
	assert_string_equal(written, "1014:0=80000085 1014:0=90 ");
	load("cob_id_emcy = 0x90\n", "1014:0"); /* the first one already */
	assert_string_equal(written, "1014:0=80000085 1014:0=85 ");
	assert_int_equal(plan.failed, 1);
}

static void test_the_sync_counter_is_written_without_a_period(void **state)
{
	(void)state;
	load("communication_cycle_period = 10000\nsynchronous_counter_overflow_value = 10\n", NULL);
	assert_string_equal(written, "1006:0=2710 1006:0=0 1019:0=A 1006:0=2710 ");
	load("communication_cycle_period = 10000\nsynchronous_counter_overflow_value = 10\n", "1019:0");
	assert_string_equal(written, "1006:0=2710 1006:0=0 1019:0=A 1006:0=2710 ");
	assert_true(plan.failed == 1 && plan.written == 1);
}

static void test_heartbeat_consumers_that_change_are_cleared_first(void **state)
{
	(void)state;
	load("lever_arm.s = 0.5\nconsumer_heartbeat_time.consumer_1 = 0x000A03E8\n", NULL);
	assert_string_equal(written, "1016:1=0 1016:1=A03E8 2000:2=3F000000 ");
}

static void test_the_date_of_the_configuration_is_written_last(void **state)
{
	(void)state;
	load("verify_configuration.configuration_date = 1\nlever_arm.s = 0.5\n", NULL);
	assert_string_equal(written, "2000:2=3F000000 1020:1=1 ");
}

static void test_what_cannot_be_read_but_is_needed_is_a_failure(void **state)
{
	(void)state;
	read_text("cob_id_emcy = 0x90\nlever_arm.s = 0.5\n");
	plan = (struct settings_plan){0};
	assert_true(settings_plan_reads(&plan, &settings));
	assert_true(settings_plan_writes(&plan)); /* nothing was read */
	assert_int_equal(plan.failed, 1);
	assert_int_equal(settings_plan_next(&plan, false)->entry->index, 0x2000);
	assert_null(settings_plan_next(&plan, false));
	settings_plan_free(&plan);
}

static void test_cob_ids_follow_the_node_id(void **state)
{
	(void)state;
	read_text("tpdo1_communication.cob_id = 0x40000185\ntpdo2_communication.cob_id = "
		  "0x40000333\n[gateway]\nnode_id = 5\n");
	settings_move_to_node(&settings, 9);
	assert_int_equal(get_u32(settings.list[0].wire), 0x40000189);
	assert_int_equal(get_u32(settings.list[1].wire), 0x40000333);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_only_what_differs_is_written),
		cmocka_unit_test(test_a_pdo_is_invalid_while_it_is_mapped),
		cmocka_unit_test(test_a_refused_mapping_leaves_the_pdo_invalid_and_the_rest_is_written),
		cmocka_unit_test(test_the_emcy_cob_id_is_invalid_in_between_and_comes_back_after_a_refusal),
		cmocka_unit_test(test_the_sync_counter_is_written_without_a_period),
		cmocka_unit_test(test_heartbeat_consumers_that_change_are_cleared_first),
		cmocka_unit_test(test_the_date_of_the_configuration_is_written_last),
		cmocka_unit_test(test_what_cannot_be_read_but_is_needed_is_a_failure),
		cmocka_unit_test(test_cob_ids_follow_the_node_id),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

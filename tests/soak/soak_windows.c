/* Both windows hammered for days in simulated time (tests/scenario/hammer.h).
 *
 * usage: soak_windows [DAYS] [SEED]. Prints what was done; exits 1 as soon as the dictionary is not what was
 * acknowledged, or when memory grew. */
#include <stdio.h>
#include <stdlib.h>

#include "gateway/log.h"
#include "tests/scenario/hammer.h"
#include "tests/scenario/world.h"

enum { DAY_S = 86400 };

/* Replaces gateway/log.c. */
void log_at(int severity, const char *format, ...)
{
	(void)severity, (void)format;
}

static double days = 1;
static uint64_t seed = 1;

static void the_dictionary_is_what_was_acknowledged(void **state)
{
	(void)state;
	struct hammer_count n = hammer((unsigned)(days * DAY_S), seed);

	printf("%.2f days: writes by Modbus %u, by function 43/13 %u, by CiA 309-3 %u, by SDO %u, refused %u; all of "
	       "%u "
	       "objects; %u blocks, %u reads, %u TPDOs remapped, stored %u times, restored %u, reset %u; %u "
	       "comparisons; "
	       "memory grew by %ld bytes\n",
		days, n.written[0], n.written[1], n.written[2], n.written[3], n.refused, n.objects, n.blocks, n.read,
		n.remaps, n.stores, n.restores, n.resets, n.compared, n.grown);
	assert_int_equal(n.grown, 0);
}

int main(int argc, char **argv)
{
	const struct CMUnitTest tests[] = {cmocka_unit_test(the_dictionary_is_what_was_acknowledged)};

	days = argc > 1 ? atof(argv[1]) : days;
	seed = argc > 2 ? strtoull(argv[2], NULL, 10) : seed;
	return cmocka_run_group_tests(tests, NULL, NULL);
}

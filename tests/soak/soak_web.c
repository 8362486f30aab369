/* imu9-web for an hour in simulated time, with browsers that come and go (tests/scenario/browsers.h).
 *
 * usage: soak_web [MINUTES] [SEED]. Prints what was done; exits 1 when after five minutes the heap in use changes. */
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "gateway/log.h"
#include "tests/scenario/browsers.h"
#include "tests/scenario/world.h"

/* Replaces gateway/log.c. */
void log_at(int severity, const char *format, ...)
{
	(void)severity, (void)format;
}

static unsigned minutes = 60;
static uint64_t seed = 1;

static void no_more_memory_is_in_use_than_after_five_minutes(void **state)
{
	(void)state;
	struct browsers_count n = browsers(minutes, seed);

	printf("%u minutes: %u connections, %u requests, %u answers, %u refusals, %.0f MB to browsers; the EDS read %u "
	       "times, the device lost %u times; %zu bytes in use after %d minutes without browsers, at most %zu with "
	       "them; "
	       "grown by %zu\n",
		minutes, n.connections, n.requests, n.answers, n.refusals, n.megabytes, n.eds_read, n.lost, n.heap,
		BROWSERS_WARM_UP, n.peak, n.grown);
	assert_int_equal(n.grown, 0);
}

int main(int argc, char **argv)
{
	const struct CMUnitTest tests[] = {cmocka_unit_test(no_more_memory_is_in_use_than_after_five_minutes)};

	if (!getenv("GLIBC_TUNABLES")) { /* so that what malloc() keeps for quick use is not taken for memory in use */
		setenv("GLIBC_TUNABLES", "glibc.malloc.tcache_count=0", 1);
		execv("/proc/self/exe", argv);
	}
	minutes = argc > 1 ? (unsigned)atoi(argv[1]) : minutes;
	seed = argc > 2 ? strtoull(argv[2], NULL, 10) : seed;
	return cmocka_run_group_tests(tests, NULL, NULL);
}

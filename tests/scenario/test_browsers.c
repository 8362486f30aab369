/* imu9-web for nine minutes with browsers that come and go: memory stays what it was. `make soak`: an hour. */
#include "gateway/log.h"
#include "tests/scenario/browsers.h"
#include "tests/scenario/world.h"

static void test_memory_does_not_grow_with_browsers_that_come_and_go(void **state)
{
	(void)state;
	log_set_level(LOG_ERR);
	struct browsers_count n = browsers(BROWSERS_WARM_UP + 4, 1);
	log_set_level(LOG_INFO);
	assert_true(n.connections > 500 && n.requests > 5000 && n.answers > 3000 && n.refusals > 500);
	assert_true(n.eds_read >= 2 && n.lost == BROWSERS_WARM_UP + 4 && n.megabytes > 50);
	assert_true(n.grown < 50000);
	assert_true(n.peak < 8000000);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_memory_does_not_grow_with_browsers_that_come_and_go),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

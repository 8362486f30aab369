/* Both windows hammered for ten minutes: the dictionary has what was acknowledged. `make soak` does it for a day. */
#include "gateway/log.h"
#include "tests/scenario/hammer.h"
#include "tests/scenario/world.h"

static void test_after_ten_minutes_every_object_has_what_was_acknowledged_last(void **state)
{
	(void)state;
	log_set_level(LOG_ERR);
	struct hammer_count n = hammer(600, 1);
	log_set_level(LOG_INFO);
	for (int by = 0; by < 4; by++)
		assert_true(n.written[by] > 100);
	assert_true(n.refused > 100 && n.remaps > 10 && n.stores > 5 && n.restores > 0 && n.resets > 5);
	assert_int_equal(n.grown, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_after_ten_minutes_every_object_has_what_was_acknowledged_last),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

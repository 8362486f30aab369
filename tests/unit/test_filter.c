/* Filters against scipy.signal; each constant with the call that gave it. */
#include "model_test.h"

#include "model/math/filter.h"

static struct filter3 filter(enum filter_type type, unsigned order, double cutoff_hz, double rate_hz)
{
	struct filter_config config = {type, order, cutoff_hz};
	struct filter3 f;

	assert_int_equal(filter3_init(&f, &config, rate_hz), 0);
	return f;
}

static struct vec3 same(double v)
{
	return (struct vec3){v, 2 * v, -v};
}

static void test_butterworth_of_every_order_equals_scipy(void **state)
{
	/* x = [1,2,-1,0.5,3,0,0,-2,1,1,4,-3]; sosfilt(butter(order, cutoff/(rate/2), output='sos'), x)[[0,1,5,11]] */
	static const double x[12] = {1, 2, -1, 0.5, 3, 0, 0, -2, 1, 1, 4, -3};
	static const struct {
		unsigned order;
		double cutoff_hz, rate_hz, y0, y1, y5, y11;
	} scipy[] = {
		{1, 10, 100, 0.2452372752527856, 0.8606664586643213, 1.2316689068315778, 0.9533991486727473},
		{2, 30, 286, 0.07307673890069144, 0.37293578392608984, 0.9429181727963505, 0.8869752200385717},
		{3, 5, 100, 0.0028981946337214297, 0.021371561814771844, 0.3045571496641151, 0.5509340266619902},
		{4, 40, 100, 0.43284664499029185, 1.571444114522149, 2.536712084269605, 0.8276228656072215},
		{5, 20, 100, 0.02193962068846417, 0.17519500682380587, 0.6204594925361665, 0.4501031118713175},
		{6, 40, 1000, 2.497222526890372e-06, 3.253740696389939e-05, 0.005881392604602093, 0.12565310863430432},
		{7, 3, 50, 3.91467181449382e-06, 5.6007941389003935e-05, 0.01403995853252998, 0.3107379412917414},
		{8, 10, 200, 1.7625537291912843e-07, 2.8888898183511643e-06, 0.001359585841750042, 0.0738516372034005},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(scipy) / sizeof(scipy[0]); i++) {
		struct filter3 f = filter(FILTER_BUTTERWORTH, scipy[i].order, scipy[i].cutoff_hz, scipy[i].rate_hz);
		struct vec3 y[12];

		filter3_prime(&f, (struct vec3){0, 0, 0});
		for (int k = 0; k < 12; k++)
			y[k] = filter3_step(&f, same(x[k]));
		assert_vec_near(y[0], same(scipy[i].y0), 1e-12);
		assert_vec_near(y[1], same(scipy[i].y1), 1e-12);
		assert_vec_near(y[5], same(scipy[i].y5), 1e-12);
		assert_vec_near(y[11], same(scipy[i].y11), 1e-12);
	}
}

static void test_the_seeds_fir_has_the_taps_of_scipys_firwin(void **state)
{
	/* firwin(11, 0.6, window=('chebwin', 30)) */
	static const double taps[11] = {5.95569339887437e-18, 0.02967949744685079, -0.03764029373122,
		-0.07493572636297863, 0.2850851217575403, 0.595622801779615, 0.2850851217575403, -0.07493572636297863,
		-0.03764029373122, 0.02967949744685079, 5.95569339887437e-18};
	struct filter3 f = filter(FILTER_SEED_FIR, 1, 1, 100);

	(void)state;
	filter3_prime(&f, (struct vec3){0, 0, 0});
	for (int k = 0; k < 11; k++)
		assert_vec_near(filter3_step(&f, same(k == 0)), same(taps[k]), 1e-15);
	assert_vec_near(filter3_step(&f, same(0)), same(0), 0);
}

static void test_the_gain_at_the_cutoff_is_minus_3_db(void **state)
{
	struct filter3 f = filter(FILTER_BUTTERWORTH, 5, 10, 100);
	double power = 0;

	(void)state;
	for (int k = 0; k < 1000; k++) {
		double y = filter3_step(&f, same(sin(2 * PI * 10 * k / 100))).x;

		if (k >= 900)
			power += y * y / 100;
	}
	assert_near(power, 0.25, 1e-9); /* of the input's 0.5 */
}

static void test_a_constant_from_the_first_sample_on_has_no_transient(void **state)
{
	static const enum filter_type types[] = {FILTER_OFF, FILTER_BUTTERWORTH, FILTER_SEED_FIR};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct filter3 f = filter(types[i], 3, 1, 100);

		for (int k = 0; k < 50; k++)
			assert_vec_near(filter3_step(&f, same(9.81)), same(9.81), 1e-12);
	}
}

static void test_a_cutoff_near_nyquist_passes_all(void **state)
{
	struct filter3 f = filter(FILTER_BUTTERWORTH, 2, 45, 100);

	(void)state;
	filter3_step(&f, same(1));
	assert_vec_near(filter3_step(&f, same(-7)), same(-7), 0);
	assert_near(filter3_delay_s(&f, 100), 0, 0);
}

static void test_the_gain_at_dc_is_one_even_at_the_lowest_cutoff(void **state)
{
	struct filter3 f = filter(FILTER_BUTTERWORTH, 8, 0.01, 1000);
	struct vec3 y = same(0);

	(void)state;
	for (int k = 0; k < 10000; k++)
		y = filter3_step(&f, same(9.81));
	assert_vec_near(y, same(9.81), 1e-6);
}

static void test_the_delay_is_scipys_group_delay_at_dc(void **state)
{
	/* group_delay(butter(order, cutoff/(rate/2)), [1e-6])[1] / rate */
	struct filter3 second = filter(FILTER_BUTTERWORTH, 2, 30, 286);
	struct filter3 third = filter(FILTER_BUTTERWORTH, 3, 5, 100);
	struct filter3 fir = filter(FILTER_SEED_FIR, 1, 1, 100);

	(void)state;
	assert_near(filter3_delay_s(&second, 286), 0.0072290660946482685, 1e-9);
	assert_near(filter3_delay_s(&third, 100), 0.06313751514708141, 1e-9);
	assert_near(filter3_delay_s(&fir, 100), 0.05, 1e-15);
}

static void test_a_shifted_filter_continues_as_if_its_input_had_always_been_greater(void **state)
{
	static const enum filter_type types[] = {FILTER_OFF, FILTER_BUTTERWORTH, FILTER_SEED_FIR};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct filter3 plain = filter(types[i], 3, 10, 100), shifted = plain;

		for (int k = 0; k < 20; k++) {
			struct vec3 in = any_vec(5);

			filter3_step(&plain, in);
			filter3_step(&shifted, in);
		}
		filter3_shift(&shifted, same(3));
		for (int k = 0; k < 20; k++) {
			struct vec3 in = any_vec(5), y = filter3_step(&plain, in);

			assert_vec_near(filter3_step(&shifted, vec3_add(in, same(3))), vec3_add(y, same(3)), 1e-12);
		}
	}
}

static void test_a_configuration_out_of_range_is_refused(void **state)
{
	static const struct filter_config bad[] = {
		{(enum filter_type)3, 2, 10},
		{FILTER_BUTTERWORTH, 0, 10},
		{FILTER_BUTTERWORTH, 9, 10},
		{FILTER_BUTTERWORTH, 2, 0},
		{FILTER_BUTTERWORTH, 2, -1},
		{FILTER_BUTTERWORTH, 2, NAN},
	};
	static const struct filter_config good = {FILTER_BUTTERWORTH, 2, 10};
	struct filter3 f;

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++)
		assert_int_equal(filter3_init(&f, &bad[i], 100), -EINVAL);
	assert_int_equal(filter3_init(&f, &good, 0), -EINVAL);
	assert_int_equal(filter3_init(&f, &good, NAN), -EINVAL);
}

static void test_priming_forgets_all_inputs_so_far(void **state)
{
	static const enum filter_type types[] = {FILTER_OFF, FILTER_BUTTERWORTH, FILTER_SEED_FIR};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct filter3 f = filter(types[i], 3, 10, 100);

		for (int k = 0; k < 17; k++)
			filter3_step(&f, any_vec(100));
		filter3_prime(&f, same(2));
		assert_vec_near(f.out, same(2), 0);
		for (int k = 0; k < 15; k++)
			assert_vec_near(filter3_step(&f, same(2)), same(2), 1e-12);
	}
}

static void test_the_last_output_of_a_filter_is_kept_and_shifted(void **state)
{
	struct filter3 f = filter(FILTER_BUTTERWORTH, 3, 10, 100);
	struct vec3 y = same(0);

	(void)state;
	for (int k = 0; k < 9; k++)
		y = filter3_step(&f, any_vec(100));
	assert_vec_near(f.out, y, 0);
	filter3_shift(&f, same(4));
	assert_vec_near(f.out, vec3_add(y, same(4)), 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_butterworth_of_every_order_equals_scipy),
		cmocka_unit_test(test_the_seeds_fir_has_the_taps_of_scipys_firwin),
		cmocka_unit_test(test_the_gain_at_the_cutoff_is_minus_3_db),
		cmocka_unit_test(test_a_constant_from_the_first_sample_on_has_no_transient),
		cmocka_unit_test(test_a_cutoff_near_nyquist_passes_all),
		cmocka_unit_test(test_the_gain_at_dc_is_one_even_at_the_lowest_cutoff),
		cmocka_unit_test(test_the_delay_is_scipys_group_delay_at_dc),
		cmocka_unit_test(test_a_shifted_filter_continues_as_if_its_input_had_always_been_greater),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused),
		cmocka_unit_test(test_priming_forgets_all_inputs_so_far),
		cmocka_unit_test(test_the_last_output_of_a_filter_is_kept_and_shifted),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* A robot that stands for hours. Both filters' covariances must stay what they are, symmetric, or after some hours the
 * filters believe in a motion: rounding that adds up in a chain of integrators does not show earlier. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/sim/sensor.h"

enum { RATE_HZ = 100, SECONDS = 20 * 60 };

/* What differs between p_ij and p_ji, as a share of the sigmas of both states. */
static double asymmetry(int n, const double *p)
{
	double worst = 0;

	for (int i = 0; i < n; i++)
		for (int j = 0; j < i; j++) {
			double scale = sqrt(p[i * n + i] * p[j * n + j]);

			if (scale > 0)
				worst = fmax(worst, fabs(p[i * n + j] - p[j * n + i]) / scale);
		}
	return worst;
}

static void test_the_covariances_stay_symmetric_at_rest(void **state)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	const struct pipeline_config config = PIPELINE_DEFAULTS;
	const struct signal *rest = signal_find("rest");
	static struct pipeline p;
	static struct sensor sensor;
	struct pipeline_output out = {0};
	struct imu_sample sample;

	(void)state;
	sensor_calibrate(&chip);
	assert_int_equal(sensor_init(&sensor, &chip, 1), 0);
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	for (int i = 0; i < RATE_HZ * SECONDS; i++) {
		sensor_next(&sensor, rest, &sample, NULL);
		pipeline_step(&p, &sample, &out);
	}
	assert_true(asymmetry(NAVIGATION_STATES, p.position.navigation.p[0]) < 1e-9); /* 1e-5 without a remedy */
	assert_true(asymmetry(KALMAN_STATES, p.fusion.kalman.covariance[0]) < 1e-9);
	assert_true(out.status & PIPELINE_REST);
	assert_true(vec3_norm(out.position_n_m) < 0.01);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_covariances_stay_symmetric_at_rest),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

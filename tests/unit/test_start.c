/* The first attitude of a sensor that is turning already, at a known lever arm. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/sim/sensor.h"

static const struct {
	const char *motion;
	struct vec3 lever_arm_b_m;
} STARTS[] = {{"tumble", {0.3, 0, 0}}, {"tumble", {0, 0.3, 0}}, {"tumble", {0.1, 0.2, -0.2}}, {"tumble", {0.05, 0, 0}},
	{"pendulum", {0, 0.5, 0}}, {"turntable", {0.5, 0, 0}}, {"turntable", {-0.3, 0.4, 0.1}}, {"rest", {0.5, 0, 0}}};

static double tilt_rad(struct quat a, struct quat b)
{
	const struct vec3 up = {0, 0, 1};

	return vec3_norm(vec3_sub(quat_rotate_inverse(a, up), quat_rotate_inverse(b, up)));
}

/* Without the correction the centripetal force is taken for gravity: 28 to 60 degrees off. */
static void test_the_lever_arms_share_is_taken_off_before_the_first_attitude(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof STARTS / sizeof *STARTS; i++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		struct sensor_config simulated = *sensor_preset("lsm303dlhc_l3gd20");
		struct pipeline_output out;
		struct signal_truth truth;
		static struct pipeline p;
		struct sensor sensor;
		struct imu_sample s;

		sensor_calibrate(&simulated);
		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		config.estimator.lever_arm_b_m = simulated.lever_arm_b_m = STARTS[i].lever_arm_b_m;
		assert_int_equal(pipeline_init(&p, &config, 100), 0);
		assert_int_equal(sensor_init(&sensor, &simulated, 1), 0);
		for (int k = 0; k < 500; k++) {
			sensor_next(&sensor, signal_find(STARTS[i].motion), &s, &truth);
			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			if (!(out.status & PIPELINE_VALID) && k > 5)
				fail_msg("%s %zu: not valid after %d samples", STARTS[i].motion, i, k);
			if ((out.status & PIPELINE_VALID) && tilt_rad(out.q_nb, truth.q_nb) > 6 * RAD_PER_DEG)
				fail_msg("%s %zu: sample %d is off by %.1f degrees", STARTS[i].motion, i, k,
					DEG_PER_RAD * tilt_rad(out.q_nb, truth.q_nb));
		}
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_lever_arms_share_is_taken_off_before_the_first_attitude),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Each number in the configurations of the model has the range of its header: the ends are accepted, the next number
 * beyond is refused, and so is what is no number. */
#include "model_test.h"

#include "model/identify/lever_identification.h"
#include "model/pipeline.h"
#include "model/sim/sensor.h"

struct range {
	const char *name;
	double *field;
	double least, most; /* INFINITY: any finite one */
	bool open;	    /* the lower end is not in it */
};

typedef int accepts(void);

/* `accepts` returns 0 or -EINVAL for the configuration whose fields these are. */
static void assert_ranges(const struct range *ranges, size_t count, accepts *check)
{
	for (size_t i = 0; i < count; i++) {
		const struct range *r = &ranges[i];
		const double was = *r->field, most = isinf(r->most) ? 1e300 : r->most;
		const struct {
			double value;
			bool good;
		} at[] = {{r->least, !r->open}, {nextafter(r->least, INFINITY), true}, {most, true},
			{nextafter(r->least, -INFINITY), false}, {nextafter(r->most, INFINITY), false},
			{INFINITY, false}, {-INFINITY, false}, {NAN, false}};

		for (size_t k = 0; k < sizeof at / sizeof *at; k++) {
			*r->field = at[k].value;
			if (check() != (at[k].good ? 0 : -EINVAL))
				fail_msg("%s: %.17g is %s", r->name, at[k].value, at[k].good ? "refused" : "accepted");
		}
		*r->field = was;
	}
}
#define RANGE(field, least, most)                    \
	{                                            \
#field, &(field), least, most, false \
	}
#define OPEN_RANGE(field, least, most)              \
	{                                           \
#field, &(field), least, most, true \
	}
#define ASSERT_RANGES(ranges, check) assert_ranges(ranges, sizeof(ranges) / sizeof *(ranges), check)

static struct pipeline_config pipeline_config;
static const double RATE_HZ = 100;

/* Both ways to configure agree. */
static int pipeline_accepts(void)
{
	static struct pipeline running, fresh;
	int result = pipeline_init(&fresh, &pipeline_config, RATE_HZ);

	assert_int_equal(pipeline_init(&running, &PIPELINE_DEFAULTS, RATE_HZ), 0);
	assert_int_equal(pipeline_configure(&running, &pipeline_config), result);
	return result;
}

static void test_the_numbers_of_the_pipeline_have_their_ranges(void **state)
{
	struct pipeline_config *c = &pipeline_config;
	struct fusion_kalman_config *k = &c->fusion.kalman;
	struct noise_config *n = &c->noise;

	(void)state;
	*c = PIPELINE_DEFAULTS;
	const struct range ranges[] = {
		RANGE(c->latency.sensor_s, 0, 0.1),
		RANGE(c->latency.accelerometer_s, -0.05, 0.05),
		RANGE(c->estimator.lever_arm_b_m.x, -10, 10),
		RANGE(c->estimator.lever_arm_b_m.y, -10, 10),
		RANGE(c->estimator.lever_arm_b_m.z, -10, 10),
		RANGE(c->estimator.gravity_m_s2, 9.0, 10.5),
		RANGE(c->fusion.madgwick_beta, 0, 10),
		RANGE(c->fusion.mahony_kp_rad_s, 0, 100),
		RANGE(c->fusion.mahony_ki_rad_s2, 0, 100),
		RANGE(k->velocity_sigma_m_s, 0.01, 1000),
		RANGE(k->heading_sigma_rad, 0.001, 1),
		RANGE(k->field_limit, 0.01, 1),
		RANGE(k->rejection_time_s, 0, 1e6),
		RANGE(k->gyro_error, 0, 0.1),
		RANGE(k->bias_walk_rad_s_sqrt_s, 0, 0.1),
		RANGE(k->gyro_scale_sigma, 0, 0.05),
		RANGE(n->gyro_density_rad_s_sqrt_hz, 0, INFINITY),
		RANGE(n->gyro_bias_instability_rad_s, 0, INFINITY),
		RANGE(n->accel_density_m_s2_sqrt_hz, 0, INFINITY),
		RANGE(n->accel_bias_instability_m_s2, 0, INFINITY),
		RANGE(n->gyro_bias_per_K_rad_s, 0, INFINITY),
		RANGE(n->accel_bias_per_K_m_s2, 0, INFINITY),
		RANGE(n->mag_sigma_uT, 0, 1000),
		RANGE(c->position.longest_integration_s, 0, INFINITY),
		RANGE(c->position.sigma_limit_m, 0, INFINITY),
		RANGE(c->position.navigation.velocity_prior_m_s, 0, INFINITY),
		RANGE(c->position.navigation.rope_m, 0, INFINITY),
		OPEN_RANGE(c->rest.gyro_threshold_rad_s, 0, INFINITY),
		OPEN_RANGE(c->rest.accel_threshold_m_s2, 0, INFINITY),
		RANGE(c->rest.time_s, 0, INFINITY),
		OPEN_RANGE(c->rest.mean_time_s, 0, INFINITY),
		RANGE(c->rest.deviation_time_s, 0, INFINITY),
		OPEN_RANGE(c->rest.deviation_share, 0, INFINITY),
		OPEN_RANGE(c->rest.drift_time_s, 0, INFINITY),
	};

	ASSERT_RANGES(ranges, pipeline_accepts);
}

static struct fusion_config fusion_config;

static int fusion_accepts(void)
{
	static struct fusion f;

	return fusion_init(&f, &fusion_config);
}

static void test_delay_and_sigmas_of_the_fusion_have_their_ranges(void **state)
{
	(void)state;
	fusion_config = PIPELINE_DEFAULTS.fusion;
	const struct range ranges[] = {RANGE(fusion_config.delay_s, 0, 0.1),
		RANGE(fusion_config.kalman.field_sigma_uT, 0, 1000),
		RANGE(fusion_config.kalman.bias_sigma_rad_s, 0, 10),
		RANGE(fusion_config.kalman.accel_sigma_m_s2, 0, 10),
		RANGE(fusion_config.kalman.offset_sigma_uT, 0, 1000)};

	ASSERT_RANGES(ranges, fusion_accepts);
}

static struct navigation_config navigation_config;

static int navigation_accepts(void)
{
	return navigation_check(&navigation_config);
}

static void test_the_numbers_of_the_navigation_have_their_ranges(void **state)
{
	struct rest_config *s = &navigation_config.standstill;

	(void)state;
	navigation_config = PIPELINE_DEFAULTS.position.navigation;
	const struct range ranges[] = {
		RANGE(navigation_config.velocity_prior_m_s, 0, INFINITY),
		RANGE(navigation_config.rope_m, 0, INFINITY),
		RANGE(navigation_config.rest_s, 0, INFINITY),
		RANGE(navigation_config.gyro_bias_sigma_rad_s, 0, INFINITY),
		RANGE(navigation_config.gyro_scale_sigma, 0, INFINITY),
		RANGE(navigation_config.accel_bias_sigma_m_s2, 0, INFINITY),
		RANGE(navigation_config.accel_scale_sigma, 0, INFINITY),
		RANGE(navigation_config.noise.gyro_density_rad_s_sqrt_hz, 0, INFINITY),
		RANGE(navigation_config.noise.gyro_bias_instability_rad_s, 0, INFINITY),
		RANGE(navigation_config.noise.accel_density_m_s2_sqrt_hz, 0, INFINITY),
		RANGE(navigation_config.noise.accel_bias_instability_m_s2, 0, INFINITY),
		RANGE(navigation_config.noise.gyro_bias_per_K_rad_s, 0, INFINITY),
		RANGE(navigation_config.noise.accel_bias_per_K_m_s2, 0, INFINITY),
		OPEN_RANGE(s->gyro_threshold_rad_s, 0, INFINITY),
		OPEN_RANGE(s->accel_threshold_m_s2, 0, INFINITY),
		RANGE(s->time_s, 0, INFINITY),
		OPEN_RANGE(s->mean_time_s, 0, INFINITY),
		RANGE(s->deviation_time_s, 0, INFINITY),
		OPEN_RANGE(s->deviation_share, 0, INFINITY),
		OPEN_RANGE(s->drift_time_s, 0, INFINITY),
	};

	ASSERT_RANGES(ranges, navigation_accepts);
}

static struct lever_identification_config lever_config;

static int lever_accepts(void)
{
	static struct lever_identification id;

	return lever_identification_init(&id, &lever_config);
}

static void test_rate_and_duration_of_the_lever_arms_identification_have_their_ranges(void **state)
{
	(void)state;
	lever_config = (struct lever_identification_config){.rate_hz = 100, .duration_s = 30};
	const struct range ranges[] = {
		RANGE(lever_config.rate_hz, 25, 10000), RANGE(lever_config.duration_s, 10, 3600)};

	ASSERT_RANGES(ranges, lever_accepts);
}

static struct sensor_config sensor_config;

static int sensor_accepts(void)
{
	static struct sensor s;

	return sensor_init(&s, &sensor_config, 1);
}

static void test_the_errors_of_the_simulated_sensor_have_their_ranges(void **state)
{
	struct triad_errors *triads[] = {&sensor_config.gyro, &sensor_config.accel, &sensor_config.mag};

	(void)state;
	sensor_config = *sensor_preset("lsm303dlhc_l3gd20");
	for (int i = 0; i < 3; i++) {
		struct triad_errors *e = triads[i];
		const struct range ranges[] = {
			RANGE(e->density, 0, INFINITY),
			RANGE(e->bias_instability, 0, INFINITY),
			RANGE(e->random_walk, 0, INFINITY),
			RANGE(e->bias_sigma, 0, INFINITY),
			RANGE(e->scale_sigma, 0, INFINITY),
			RANGE(e->cross_axis_sigma, 0, INFINITY),
			RANGE(e->bandwidth_hz, 0, INFINITY),
			RANGE(e->step, 0, INFINITY),
			RANGE(e->range, 0, INFINITY),
			RANGE(e->temperature_sigma, 0, INFINITY),
		};

		ASSERT_RANGES(ranges, sensor_accepts);
	}
	sensor_config.rate_hz = 100;
	const struct range jitter[] = {RANGE(sensor_config.jitter_s, 0, 0.001)}; /* a tenth of the interval */

	ASSERT_RANGES(jitter, sensor_accepts);
}

/* A scale factor of 0.1 on each axis has the determinant 0.001. */
static void test_a_calibration_matrix_must_have_an_inverse(void **state)
{
	struct triad_calibration *triads[] = {&pipeline_config.calibration.gyro, &pipeline_config.calibration.accel,
		&pipeline_config.calibration.mag};

	(void)state;
	pipeline_config = PIPELINE_DEFAULTS;
	for (int i = 0; i < 3; i++) {
		const struct triad_calibration was = *triads[i];
		double(*m)[3] = triads[i]->matrix;

		for (int row = 0; row < 3; row++) /* a rotation, so that each product of the determinant counts */
			for (int column = 0; column < 3; column++)
				m[row][column] = row == column ? -1 / 3.0 : 2 / 3.0;
		assert_int_equal(pipeline_accepts(), 0);
		for (int row = 0; row < 3; row++)
			m[row][0] *= 0.00101;
		assert_int_equal(pipeline_accepts(), 0);
		for (int row = 0; row < 3; row++)
			m[row][0] *= 0.98;
		assert_int_equal(pipeline_accepts(), -EINVAL);
		*triads[i] = was;
	}
}

static void test_choices_are_those_of_the_header(void **state)
{
	struct pipeline_config *c = &pipeline_config;

	(void)state;
	*c = PIPELINE_DEFAULTS;
	for (int choice = -2; choice <= 10; choice++) {
		*c = PIPELINE_DEFAULTS;
		c->fusion.algorithm = (enum fusion_algorithm)choice;
		assert_int_equal(pipeline_accepts(), choice >= 0 && choice <= 2 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->fusion.use_magnetometer = choice;
		assert_int_equal(pipeline_accepts(), choice == 0 || choice == 1 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->estimator.model = (enum lever_arm_model)choice;
		assert_int_equal(pipeline_accepts(), choice >= 0 && choice <= 3 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->estimator.rates_from = (enum rate_source)choice;
		assert_int_equal(pipeline_accepts(), choice == 0 || choice == 1 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->position.mode = (enum position_mode)choice;
		assert_int_equal(pipeline_accepts(), choice >= 0 && choice <= 2 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->position.navigation.levelling = choice;
		assert_int_equal(pipeline_accepts(), choice == 0 || choice == 1 ? 0 : -EINVAL);
		*c = PIPELINE_DEFAULTS;
		c->position.navigation.preset = (enum motion_preset)choice;
		assert_int_equal(pipeline_accepts(), choice >= 0 && choice < MOTION_PRESETS ? 0 : -EINVAL);
		for (int which = 0; which < 2; which++) {
			struct filter_config *f = which ? &c->accel_filter : &c->rate_filter;

			*c = PIPELINE_DEFAULTS;
			f->order = (unsigned)choice;
			assert_int_equal(pipeline_accepts(), choice >= 1 && choice <= 8 ? 0 : -EINVAL);
			*c = PIPELINE_DEFAULTS;
			f->type = (enum filter_type)choice;
			assert_int_equal(pipeline_accepts(), choice >= 0 && choice <= 2 ? 0 : -EINVAL);
		}
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_numbers_of_the_pipeline_have_their_ranges),
		cmocka_unit_test(test_delay_and_sigmas_of_the_fusion_have_their_ranges),
		cmocka_unit_test(test_the_numbers_of_the_navigation_have_their_ranges),
		cmocka_unit_test(test_rate_and_duration_of_the_lever_arms_identification_have_their_ranges),
		cmocka_unit_test(test_the_errors_of_the_simulated_sensor_have_their_ranges),
		cmocka_unit_test(test_a_calibration_matrix_must_have_an_inverse),
		cmocka_unit_test(test_choices_are_those_of_the_header),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Agreement of magnetometer and gyro: an object turns in a constant field, 100 samples a second, and its magnetometer has
 * an offset, wrong axes or a magnet beside it. */
#include "model_test.h"

#include "model/hard_iron.h"
#include "model/math/rotation.h"

static const struct vec3 FIELD_N = {0, 20, -45}; /* uT */
static const double DT_S = 0.01, NOISE_UT = 0.3;
static const struct mat3 AS_IT_IS = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/* An object that turns to and fro about all axes, and what its magnetometer measures: matrix * (field + magnet). */
struct object {
	struct quat q_nb;
	struct mat3 axes;
	struct vec3 magnet_b_uT;
	double t_s;
	bool about_z_only;
};

static struct vec3 rate_of(const struct object *o)
{
	if (o->about_z_only)
		return (struct vec3){0, 0, 1.2 * sin(0.9 * o->t_s + 1)};
	return (struct vec3){1.5 * sin(1.3 * o->t_s), 1.2 * cos(0.8 * o->t_s), 1.8 * sin(0.6 * o->t_s + 1)};
}

static struct vec3 next(struct object *o, struct vec3 *rate)
{
	*rate = rate_of(o);
	o->t_s += DT_S;
	o->q_nb = quat_normalize(quat_multiply(o->q_nb, quat_from_rotation_vector(vec3_scale(DT_S, *rate))));
	return vec3_add(mat3_apply(o->axes, vec3_add(quat_rotate_inverse(o->q_nb, FIELD_N), o->magnet_b_uT)),
		any_vec(NOISE_UT));
}

/* Number of the events in this time. */
struct events {
	int disagrees, agrees, found;
	bool changes;
};

static struct events turn(struct hard_iron *h, struct object *o, double s)
{
	struct events e = {0};

	for (double end = o->t_s + s; o->t_s < end;) {
		struct vec3 rate, field = next(o, &rate);
		enum hard_iron_event event = hard_iron_step(h, rate, &field, NOISE_UT, DT_S);

		e.disagrees += event == HARD_IRON_DISAGREES;
		e.agrees += event == HARD_IRON_AGREES;
		e.found += event == HARD_IRON_FOUND;
		e.changes |= h->changes;
	}
	return e;
}

static struct object object(struct mat3 axes, struct vec3 magnet_b_uT)
{
	return (struct object){.q_nb = {1, 0, 0, 0}, .axes = axes, .magnet_b_uT = magnet_b_uT};
}

static void test_an_offset_of_any_direction_is_found_within_its_sigma(void **state)
{
	(void)state;
	for (int i = 0; i < 20; i++) {
		struct vec3 off, b = any_vec(50);
		struct object o = object(AS_IT_IS, b);
		struct hard_iron h = {0};

		if (vec3_norm(b) < 10)
			continue;
		turn(&h, &o, 60);
		assert_true(h.known && !h.disagrees);
		off = vec3_sub(h.offset_b_uT, b);
		assert_true(vec3_norm(off) < 1);
		for (int axis = 0; axis < 3; axis++)
			assert_true(fabs((&off.x)[axis]) < 3 * sqrt(h.variance_uT2[axis][axis]));
	}
}

static void test_a_calibrated_magnetometer_has_no_offset_and_agrees(void **state)
{
	struct object o = object(AS_IT_IS, (struct vec3){0, 0, 0});
	struct hard_iron h = {0};
	struct events e = turn(&h, &o, 600);

	(void)state;
	assert_int_equal(e.found + e.disagrees, 0);
	assert_true(h.agreed && !h.known);
	assert_vec_near(h.offset_b_uT, ((struct vec3){0, 0, 0}), 0);
}

/* Below 0.12 of the field an offset is what a building's fields pretend. */
static void test_an_offset_of_3_uT_is_left(void **state)
{
	struct object o = object(AS_IT_IS, (struct vec3){0, 3, 0});
	struct hard_iron h = {0};

	(void)state;
	assert_int_equal(turn(&h, &o, 60).found, 0);
}

static void test_swapped_or_mirrored_axes_disagree_within_a_few_turns(void **state)
{
	static const struct mat3 wrong[] = {
		{{{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}}},
		{{{1, 0, 0}, {0, -1, 0}, {0, 0, 1}}},
		{{{1, 0, 0}, {0, 1, 0}, {0, 0, -1}}},
		{{{0, 1, 0}, {1, 0, 0}, {0, 0, 1}}},
		{{{1, 0, 0}, {0, 0, 1}, {0, 1, 0}}},
		{{{0, 0, 1}, {0, 1, 0}, {1, 0, 0}}},
		{{{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}}},
		{{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++) {
		struct object o = object(wrong[i], (struct vec3){0, 0, 0});
		struct hard_iron h = {0};

		assert_int_equal(turn(&h, &o, 15).disagrees, 1);
		assert_int_equal(turn(&h, &o, 120).agrees, 0);
		assert_true(h.disagrees && !h.agreed && !h.known);
	}
}

/* A southern hemisphere, or a chip that counts the other way: only a map could tell. */
static void test_a_field_that_points_up_agrees(void **state)
{
	static const struct mat3 inverted = {{{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}}};
	struct object o = object(inverted, (struct vec3){0, 0, 0});
	struct hard_iron h = {0};

	(void)state;
	assert_int_equal(turn(&h, &o, 60).disagrees, 0);
	assert_true(h.agreed);
}

static void test_an_object_that_does_not_turn_shows_nothing(void **state)
{
	struct hard_iron h = {0};

	(void)state;
	for (int i = 0; i < 100000; i++) {
		struct vec3 field = vec3_add((struct vec3){80, 20, -90}, any_vec(NOISE_UT));

		assert_int_equal(hard_iron_step(&h, any_vec(0.001), &field, NOISE_UT, DT_S), HARD_IRON_NOTHING);
	}
	assert_false(h.known || h.disagrees || h.agreed);
}

/* Turns about z tell the offset along x and y; that along z is as unknown as before. */
static void test_turns_about_one_axis_leave_the_offset_along_it_open(void **state)
{
	struct object o = object(AS_IT_IS, (struct vec3){20, -10, 0});
	struct hard_iron h = {0};

	(void)state;
	o.about_z_only = true;
	turn(&h, &o, 60);
	assert_true(h.known && !h.agreed);
	assert_near(h.offset_b_uT.x, 20, 2);
	assert_near(h.offset_b_uT.y, -10, 2);
	assert_true(hard_iron_variance(&h, (struct vec3){0, 0, 1}) > 10 * 10);
	assert_true(hard_iron_variance(&h, (struct vec3){1, 0, 0}) < 2 * 2);
}

static void test_a_magnet_attached_or_removed_is_a_change(void **state)
{
	const struct vec3 none = {0, 0, 0}, magnet = {0, -30, 20};
	struct object o = object(AS_IT_IS, none);
	struct hard_iron h = {0};

	(void)state;
	assert_false(turn(&h, &o, 60).changes);
	o.magnet_b_uT = magnet;
	assert_true(turn(&h, &o, 30).changes);
	assert_true(h.known && !h.disagrees);
	assert_vec_near(h.offset_b_uT, magnet, 1.5);
	o.magnet_b_uT = none;
	assert_true(turn(&h, &o, 60).changes);
	assert_false(h.known || h.disagrees);
	assert_vec_near(h.offset_b_uT, none, 0);
}

/* Half a radian does not change the field by three times its length. */
static void test_a_turn_during_which_a_magnet_appears_is_not_counted(void **state)
{
	struct object o = object(AS_IT_IS, (struct vec3){0, 0, 0});
	struct hard_iron h = {0};

	(void)state;
	turn(&h, &o, 30);
	for (int i = 0; i < 20; i++) {
		struct events e;

		o.magnet_b_uT = (struct vec3){i % 2 ? 0 : 150, 0, 0};
		e = turn(&h, &o, i % 2 ? 5 : 0.05);
		assert_int_equal(e.disagrees + e.found, 0);
	}
}

/* A rate that was not measured turned the object by an unknown angle. */
static void test_after_a_gap_the_field_before_it_is_not_compared(void **state)
{
	struct object o = object(AS_IT_IS, (struct vec3){0, 0, 0});
	struct hard_iron h = {0};

	(void)state;
	for (int i = 0; i < 60; i++) {
		struct events e = turn(&h, &o, 2);

		assert_int_equal(e.disagrees + e.found, 0);
		hard_iron_skip(&h);
		o.q_nb = quat_multiply(o.q_nb, quat_from_rotation_vector(any_vec(2)));
	}
	assert_true(h.agreed);
}

static void test_nonsense_is_forgotten(void **state)
{
	const struct vec3 nonsense[] = {{NAN, 0, 0}, {INFINITY, 1, 1}, {1e200, -1e200, 1}, {0, 0, 0}};
	struct object o = object(AS_IT_IS, (struct vec3){0, 0, 0});
	struct hard_iron h = {0};

	(void)state;
	for (int i = 0; i < 400; i++)
		hard_iron_step(&h, any_vec(100), &nonsense[i % 4], NOISE_UT, DT_S);
	turn(&h, &o, 60);
	assert_true(h.agreed && !h.disagrees && !h.known);
	assert_true(vec3_finite(h.offset_b_uT));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_offset_of_any_direction_is_found_within_its_sigma),
		cmocka_unit_test(test_a_calibrated_magnetometer_has_no_offset_and_agrees),
		cmocka_unit_test(test_an_offset_of_3_uT_is_left),
		cmocka_unit_test(test_swapped_or_mirrored_axes_disagree_within_a_few_turns),
		cmocka_unit_test(test_a_field_that_points_up_agrees),
		cmocka_unit_test(test_an_object_that_does_not_turn_shows_nothing),
		cmocka_unit_test(test_turns_about_one_axis_leave_the_offset_along_it_open),
		cmocka_unit_test(test_a_magnet_attached_or_removed_is_a_change),
		cmocka_unit_test(test_a_turn_during_which_a_magnet_appears_is_not_counted),
		cmocka_unit_test(test_after_a_gap_the_field_before_it_is_not_compared),
		cmocka_unit_test(test_nonsense_is_forgotten),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

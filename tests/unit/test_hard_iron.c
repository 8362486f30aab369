/* Agreement of magnetometer and gyro: an object turns in a constant field, 100 samples a second, and its magnetometer
 * has an offset, wrong axes or a magnet beside it. */
#include "model_test.h"

#include "model/hard_iron.h"
#include "model/math/linalg.h"
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
	assert_near(sqrt(hard_iron_variance(&h, (struct vec3){0, 0, 1})), 50, 2); /* as before any turn */
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

/* ---- turn by turn, without noise --------------------------------------------------------------------------------- */

/* The object makes one turn between two samples. The field turns with it but for a share of the angle. */
struct turns {
	struct hard_iron h;
	struct vec3 field_b_uT, magnet_b_uT;
};

static const struct vec3 AXES[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
static const struct vec3 NO_MAGNET = {0, 0, 0}, FIELD_B = {30, 25, -20};
static const double TURN = 0.51, LITTLE_NOISE_UT = 0.1;

static struct turns turns(struct vec3 field, struct vec3 magnet)
{
	struct turns t = {.field_b_uT = field, .magnet_b_uT = magnet};
	struct vec3 measured = vec3_add(field, magnet);

	hard_iron_step(&t.h, (struct vec3){0, 0, 0}, &measured, LITTLE_NOISE_UT, 1);
	return t;
}

static enum hard_iron_event turn_by(struct turns *t, struct vec3 axis, double angle, double unexplained, double s)
{
	struct vec3 turned = vec3_scale((1 - unexplained) * angle, axis), measured;

	t->field_b_uT = quat_rotate_inverse(quat_from_rotation_vector(turned), t->field_b_uT);
	measured = vec3_add(t->field_b_uT, t->magnet_b_uT);
	return hard_iron_step(&t->h, vec3_scale(angle / s, axis), &measured, LITTLE_NOISE_UT, s);
}

/* Turns until this event; 0: none in this many. */
static int turns_until(struct turns *t, enum hard_iron_event event, double unexplained, bool about_z, int most)
{
	for (int k = 1; k <= most; k++)
		if (turn_by(t, AXES[about_z ? 2 : k % 3], TURN, unexplained, 1) == event)
			return k;
	return 0;
}

/* Beyond 0.9 after four turns, beyond 0.6 after ten. */
static void test_a_field_disagrees_by_the_share_of_its_turn_that_is_unexplained(void **state)
{
	static const struct {
		double unexplained;
		int after;
	} at[] = {{0.99, 4}, {0.91, 4}, {0.88, 10}, {0.62, 10}, {0.58, 0}, {0.4, 0}};

	(void)state;
	for (size_t i = 0; i < sizeof(at) / sizeof(at[0]); i++)
		for (int about_z = 0; about_z < 2; about_z++) {
			struct turns t = turns(FIELD_B, NO_MAGNET);

			assert_int_equal(
				turns_until(&t, HARD_IRON_DISAGREES, at[i].unexplained, about_z, 100), at[i].after);
		}
}

static void test_a_field_agrees_again_below_a_share_of_0_4(void **state)
{
	(void)state;
	for (int agrees = 0; agrees < 2; agrees++) {
		struct turns t = turns(FIELD_B, NO_MAGNET);

		assert_int_equal(turns_until(&t, HARD_IRON_DISAGREES, 0.7, true, 20), 10);
		assert_int_equal(!!turns_until(&t, HARD_IRON_AGREES, agrees ? 0.38 : 0.42, true, 500), agrees);
	}
}

/* After ten turns with at least two about each axis, of which less than 0.3 is unexplained. */
static void test_magnetometer_and_gyro_have_agreed_after_ten_turns_about_all_axes(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct turns t = turns(FIELD_B, NO_MAGNET);

		for (int k = 0; k < 30; k++) {
			assert_int_equal(t.h.agreed, i == 0 && k >= 10);
			turn_by(&t, AXES[k % 3], TURN, i == 0 ? 0.2 : 0.33, 1);
		}
	}
	for (int seldom = 0; seldom < 3; seldom++) {
		struct turns t = turns(FIELD_B, NO_MAGNET);

		for (int k = 0; k < 40; k++) {
			int about = k == 25 || k == 30 ? 0 : 1 + k % 2;

			assert_int_equal(t.h.agreed, k > 30);
			turn_by(&t, AXES[(about + seldom) % 3], TURN, 0.1, 1);
		}
	}
}

static void test_an_axis_that_disagrees_shows_by_the_second_turn_about_it(void **state)
{
	struct turns t = turns(FIELD_B, NO_MAGNET);

	(void)state;
	for (int k = 0; k < 20; k++)
		assert_int_equal(turn_by(&t, AXES[k % 2], TURN, 0, 1), HARD_IRON_NOTHING);
	assert_int_equal(turn_by(&t, AXES[2], TURN, 1, 1), HARD_IRON_NOTHING);
	assert_int_equal(turn_by(&t, AXES[2], TURN, 1, 1), HARD_IRON_DISAGREES);
}

static void test_a_turn_is_half_a_radian_within_5_seconds(void **state)
{
	static const struct {
		double angle, s;
		bool counts;
	} at[] = {{0.51, 0.1, true}, {0.49, 0.1, false}, {0.51, 4.9, true}, {0.51, 5.1, false}, {2, 1, true}};

	(void)state;
	for (size_t i = 0; i < sizeof(at) / sizeof(at[0]); i++) {
		struct turns t = turns(FIELD_B, NO_MAGNET);

		for (int k = 0; k < 40; k++) /* to and fro */
			turn_by(&t, AXES[k / 2 % 3], k % 2 ? -at[i].angle : at[i].angle, 0, at[i].s);
		assert_int_equal(t.h.agreed, at[i].counts);
	}
}

/* Of the length of the field: it is found from 0.12 on, as far as four sigma allow, and is gone below 0.06. */
static void test_an_offset_is_one_from_a_share_of_the_field_on(void **state)
{
	const double length = vec3_norm(FIELD_B);

	(void)state;
	for (int found = 0; found < 2; found++) {
		struct turns t = turns(FIELD_B, (struct vec3){(found ? 0.14 : 0.128) * length, 0, 0});

		assert_int_equal(!!turns_until(&t, HARD_IRON_FOUND, 0, false, 300), found);
	}
	for (int stays = 0; stays < 2; stays++) {
		struct turns t = turns(FIELD_B, (struct vec3){0, 0.25 * length, 0});

		assert_true(turns_until(&t, HARD_IRON_FOUND, 0, false, 60) > 0);
		t.magnet_b_uT.y = (stays ? 0.065 : 0.055) * length;
		turns_until(&t, HARD_IRON_FOUND, 0, false, 300);
		assert_int_equal(t.h.known, stays);
		assert_near(t.h.offset_b_uT.y, stays ? 0.065 * length : 0, 0.3);
	}
}

/* What is unexplained grows at once by a factor (of squares). Its mean over 6 turns exceeds three times that over 50
 * from a factor of 7.3 on; of 9, from the fourth turn on and for 12. */
static void test_a_change_is_three_times_as_much_unexplained_as_usual(void **state)
{
	static const struct {
		double factor;
		int first, turns;
		double tolerance;
	} at[] = {{6.9, 0, 0, 0}, {7.6, 6, 8, 1}, {9, 4, 12, 1}, {16, 2, 24, 1}};

	(void)state;
	for (size_t i = 0; i < sizeof(at) / sizeof(at[0]); i++) {
		struct turns t = turns((struct vec3){40, 0, -20}, NO_MAGNET);
		int first = 0, changes = 0;

		turns_until(&t, HARD_IRON_FOUND, 0.1, true, 300);
		assert_false(t.h.changes);
		for (int k = 1; k <= 100; k++) {
			turn_by(&t, AXES[2], TURN, 0.1 * sqrt(at[i].factor), 1);
			first = t.h.changes && !first ? k : first;
			changes += t.h.changes;
		}
		assert_int_equal(first, at[i].first);
		assert_near(changes, at[i].turns, at[i].tolerance);
	}
}

/* A turn changes the field by 2 sin(angle / 2) of what is measured before and after at most; 1.2 of it are let pass. */
static void test_a_change_of_the_field_beyond_what_a_turn_can_make_is_not_counted(void **state)
{
	const double chord = 2 * sin(TURN / 2);

	(void)state;
	for (int counts = 0; counts < 2; counts++) {
		const double factor = counts ? 1.17 : 1.23;
		struct turns t = turns((struct vec3){40, 0, 0}, NO_MAGNET);
		struct vec3 next;

		for (int k = 0; k < 20; k++)
			turn_by(&t, AXES[2], TURN, 0, 1);
		/* a magnet along the field, as strong as factor * chord * (40 + 40 + magnet) */
		next = quat_rotate_inverse(quat_from_rotation_vector((struct vec3){0, 0, TURN}), t.field_b_uT);
		t.magnet_b_uT = vec3_scale(factor * chord * 80 / (1 - factor * chord) / 40, next);
		turn_by(&t, AXES[2], TURN, 0, 1);
		assert_int_equal(t.h.changes, counts);
	}
}

/* 1 / sigma^2 of each turn by the two relations of the header, of which all earlier ones lose a hundredth with each
 * turn. A field has a sigma of 0.04 of its length, of the rate over 10 ms, and of its noise; its length one of 0.1. A
 * share of 0.03 of the field always remains. Where the length spreads by more than 0.05, the rest is larger by as
 * much. */
static void assert_variance(double angle, double s, double noise_uT, double spread)
{
	const struct vec3 magnet = {20, -15, 10};
	const double length = vec3_norm(FIELD_B), rate = angle / s;
	struct turns t = turns(FIELD_B, magnet);
	double information[16] = {0}, worse = fmax(1, spread * spread / (0.05 * 0.05));

	for (int k = 1; k <= 900; k++) {
		const struct vec3 axis = AXES[k % 3];
		struct quat q = quat_from_rotation_vector(vec3_scale(angle, axis));
		double size = 1 + (k < 200 ? 0 : k / 3 % 2 ? spread : -spread), weight;
		struct vec3 m;

		t.field_b_uT = quat_rotate_inverse(q, vec3_scale(length / vec3_norm(t.field_b_uT), t.field_b_uT));
		t.field_b_uT = vec3_scale(size, t.field_b_uT);
		m = vec3_add(t.field_b_uT, magnet);
		hard_iron_step(&t.h, vec3_scale(rate, axis), &m, noise_uT, s);

		const double sphere[4] = {2 * m.x, 2 * m.y, 2 * m.z, 1};

		weight = length * length * (0.04 * 0.04 + 0.01 * 0.01 * 2 * rate * rate) + 2 * noise_uT * noise_uT;
		for (int i = 0; i < 16; i++)
			information[i] = 0.99 * information[i] +
					 sphere[i / 4] * sphere[i % 4] / pow(2 * 0.1 * length * length, 2);
		for (int row = 0; row < 3; row++) { /* of I - R', which turns the axes before into those after */
			struct vec3 r = vec3_sub(AXES[row], quat_rotate(q, AXES[row]));
			const double of[4] = {r.x, r.y, r.z, 0};

			for (int i = 0; i < 16; i++)
				information[i] += of[i / 4] * of[i % 4] / weight;
		}
	}
	assert_true(t.h.known);
	assert_int_equal(linalg_invert(4, information), 0);
	for (int i = 0; i < 3; i++)
		for (int j = 0; j <= i; j++) {
			struct vec3 d = i == j ? AXES[i] : vec3_scale(sqrt(0.5), vec3_add(AXES[i], AXES[j]));
			double of_turns =
				i == j ? information[5 * i]
				       : (information[5 * i] + information[5 * j]) / 2 + information[4 * i + j];
			double expected = worse * of_turns + pow(0.03 * length, 2);

			assert_near(hard_iron_variance(&t.h, d), expected, (spread > 0 ? 0.1 : 0.02) * expected);
		}
}

static void test_the_variance_of_the_offset_is_that_of_least_squares(void **state)
{
	(void)state;
	assert_variance(0.51, 1, 0.1, 0);
	assert_variance(1.5, 1, 0.1, 0);     /* more by a larger turn */
	assert_variance(0.51, 0.05, 0.1, 0); /* less by a faster one: 10 rad/s */
	assert_variance(0.51, 1, 3, 0);	     /* less by a noisier chip */
	assert_variance(0.51, 1, 0.1, 0.04);
	assert_variance(0.51, 1, 0.1, 0.08);
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
		cmocka_unit_test(test_a_field_disagrees_by_the_share_of_its_turn_that_is_unexplained),
		cmocka_unit_test(test_a_field_agrees_again_below_a_share_of_0_4),
		cmocka_unit_test(test_magnetometer_and_gyro_have_agreed_after_ten_turns_about_all_axes),
		cmocka_unit_test(test_an_axis_that_disagrees_shows_by_the_second_turn_about_it),
		cmocka_unit_test(test_a_turn_is_half_a_radian_within_5_seconds),
		cmocka_unit_test(test_an_offset_is_one_from_a_share_of_the_field_on),
		cmocka_unit_test(test_a_change_is_three_times_as_much_unexplained_as_usual),
		cmocka_unit_test(test_a_change_of_the_field_beyond_what_a_turn_can_make_is_not_counted),
		cmocka_unit_test(test_the_variance_of_the_offset_is_that_of_least_squares),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

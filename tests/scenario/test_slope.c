/* The inclinometer of CiA 410 on the bus: EMCY 5010h and 5020h, and refused writes. */
#include "tests/scenario/bus.h"

#include "gateway/publish.h"
#include "gateway/slope_range.h"
#include "model/math/units.h"

#define RAD(deg) ((deg)*RAD_PER_DEG)

#define LONG_EMCY    "090 10 50 21 00 00 00 00 00"
#define LATERAL_EMCY "090 20 50 21 00 00 00 00 00"
#define OVER	     "090 00 00 00 00 00 00 00 00"

/* A sample with these angles. */
static void tilt(struct bus *bus, double longitudinal_deg, double lateral_deg)
{
	const struct pipeline_output out = {.q_nb = QUAT_IDENTITY,
		.angles_rad = {RAD(lateral_deg), RAD(longitudinal_deg), 0},
		.status = PIPELINE_VALID};

	slope_range_check(&bus->node, &bus->values, publish_sample(&bus->od, &out, 0), bus->now_us);
	bus_tick(bus);
}

static void set_range(struct bus *bus, float longitudinal_deg, float lateral_deg)
{
	bus->values.slope_range.longitudinal = longitudinal_deg;
	bus->values.slope_range.lateral = lateral_deg;
}

static void test_the_device_type_is_that_of_a_two_axis_inclinometer(void **state)
{
	assert_int_equal(bus_read(*state, 0x1000, 0), 0x0004019A);
}

static void test_without_a_range_every_slope_that_fits_its_object_is_in_range(void **state)
{
	struct bus *bus = *state;

	tilt(bus, 90, 180);
	tilt(bus, -90, -180);
	bus_expect_nothing(bus);
}

static void test_a_longitudinal_slope_beyond_its_range_sets_and_clears_5010h(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 30);
	tilt(bus, 29.9, 0);
	bus_expect_nothing(bus);
	tilt(bus, 30.1, 0);
	bus_expect(bus, LONG_EMCY);
	tilt(bus, 45, 0);
	bus_expect_nothing(bus);
	tilt(bus, 10, 0);
	bus_expect(bus, OVER);
}

static void test_a_lateral_slope_beyond_its_range_sets_and_clears_5020h(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 20);
	tilt(bus, 0, -20.1);
	bus_expect(bus, LATERAL_EMCY);
	tilt(bus, 0, 0);
	bus_expect(bus, OVER);
}

static void test_the_error_register_is_clear_when_both_slopes_are_within_their_ranges(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 30);
	tilt(bus, 31, -31);
	bus_expect(bus, LONG_EMCY);
	bus_expect(bus, LATERAL_EMCY);
	tilt(bus, 0, -31);
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1001, 0) & 0xFF, 0x21);
	tilt(bus, 0, 0);
	bus_expect(bus, OVER);
	assert_int_equal(bus_read(bus, 0x1001, 0) & 0xFF, 0);
}

static void test_a_slope_that_oscillates_about_its_limit_is_reported_once(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 30);
	for (int i = 0; i < 100; i++)
		tilt(bus, i % 2 ? 29.9 : 30.1, 0);
	bus_expect(bus, LONG_EMCY);
	bus_expect_nothing(bus);
}

static void test_removing_the_range_clears_the_error(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 30);
	tilt(bus, 31, 0);
	bus_expect(bus, LONG_EMCY);
	set_range(bus, 0, 0);
	tilt(bus, 31, 0);
	bus_expect(bus, OVER);
}

/* The largest 16-bit value is 32767 steps of 0.001 deg. */
static void test_a_slope_that_exceeds_16_bits_is_out_of_range(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x6000, 0, 2, 1);
	tilt(bus, 32.767, 0);
	bus_expect_nothing(bus);
	tilt(bus, 32.768, 0);
	bus_expect(bus, LONG_EMCY);
	assert_int_equal(bus->values.slope_long16, 32767);
	assert_int_equal(bus->values.slope_long32, 32768);
	assert_true(bus->values.sample.status & STATUS_SATURATED);
	tilt(bus, -32.768, 0);
	bus_expect(bus, OVER);
	tilt(bus, -32.769, 0);
	bus_expect(bus, LONG_EMCY);
	tilt(bus, 0, 0);
	bus_expect(bus, OVER);
	tilt(bus, 0, 32.768);
	bus_expect(bus, LATERAL_EMCY);
}

static void test_a_slope_with_an_offset_can_exceed_its_object(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x6021, 0, 1, 2);
	bus_write(bus, 0x6024, 0, 2, 32767);
	tilt(bus, 0, 0);
	bus_expect_nothing(bus);
	tilt(bus, 0, 0.01);
	bus_expect(bus, LATERAL_EMCY);
	assert_int_equal(bus->values.slope_lateral16, 32767);
	assert_int_equal(bus->values.slope_lateral32, 1);
}

static void test_reset_node_reports_a_slope_that_is_still_out_of_range_again(void **state)
{
	struct bus *bus = *state;

	set_range(bus, 30, 30);
	bus->power_on = bus->values;
	tilt(bus, 31, 0);
	bus_expect(bus, LONG_EMCY);
	bus_reset(bus, "000 81 10", "710 00");
	tilt(bus, 31, 0);
	bus_expect(bus, LONG_EMCY);
}

static void test_the_reserved_bits_of_an_operating_parameter_are_refused(void **state)
{
	static const uint16_t operating[] = {0x6011, 0x6021, 0x6111, 0x6121};

	for (size_t i = 0; i < 4; i++) {
		assert_int_equal(bus_write(*state, operating[i], 0, 1, 3), 0);
		assert_int_equal(bus_write(*state, operating[i], 0, 1, 4), 0x06090031);
	}
}

static void test_slopes_and_offsets_are_read_only(void **state)
{
	static const uint16_t index[] = {0x6010, 0x6013, 0x6020, 0x6023};

	for (size_t i = 0; i < 4; i++) {
		assert_int_equal(bus_write(*state, index[i], 0, 2, 0), 0x06010002);
		assert_int_equal(bus_write(*state, index[i] + 0x100, 0, 4, 0), 0x06010002);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_the_device_type_is_that_of_a_two_axis_inclinometer),
		PRE_OPERATIONAL(test_without_a_range_every_slope_that_fits_its_object_is_in_range),
		PRE_OPERATIONAL(test_a_longitudinal_slope_beyond_its_range_sets_and_clears_5010h),
		PRE_OPERATIONAL(test_a_lateral_slope_beyond_its_range_sets_and_clears_5020h),
		PRE_OPERATIONAL(test_the_error_register_is_clear_when_both_slopes_are_within_their_ranges),
		PRE_OPERATIONAL(test_a_slope_that_oscillates_about_its_limit_is_reported_once),
		PRE_OPERATIONAL(test_removing_the_range_clears_the_error),
		PRE_OPERATIONAL(test_a_slope_that_exceeds_16_bits_is_out_of_range),
		PRE_OPERATIONAL(test_a_slope_with_an_offset_can_exceed_its_object),
		PRE_OPERATIONAL(test_reset_node_reports_a_slope_that_is_still_out_of_range_again),
		PRE_OPERATIONAL(test_the_reserved_bits_of_an_operating_parameter_are_refused),
		PRE_OPERATIONAL(test_slopes_and_offsets_are_read_only),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

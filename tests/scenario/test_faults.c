/* Each fault of the list (faults.c) alone, and each two of them at once: what gateway/README.md promises while they
 * last, and that all is as before in time. The list has every EMCY but those of a start (5530h, 6300h: test_store.c,
 * test_emcy.c) and 5032h, which no fault of a sensor causes (test_sensor.c).
 *
 * IMU9_FAULT=TEXT runs only faults that have the text in their names; IMU9_LONG=1 runs each two in both orders. */
#include "tests/scenario/faults.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/log.h"
#include "od/little_endian.h"

/* Replaces gateway/log.c: nothing on standard error. */
void log_at(int severity, const char *format, ...)
{
	(void)severity, (void)format;
}

static struct site *site;
static struct site *at_rest; /* a copy of it, before any fault */

static int set_up(void **state)
{
	(void)state;
	site = calloc(1, sizeof(*site));
	at_rest = malloc(sizeof(*at_rest));
	assert_non_null(site);
	assert_non_null(at_rest);
	site_init(site, 1);
	*at_rest = *site;
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	free(site);
	free(at_rest);
	return 0;
}

static bool wanted(const struct fault *f)
{
	const char *text = getenv("IMU9_FAULT");

	return !text || strstr(f->name, text);
}

/* ---- promises ---------------------------------------------------------------------------------------------------- */

static char names[200];
static unsigned broken;

static void expect(bool kept, const char *format, unsigned a, unsigned b)
{
	char text[200];

	if (kept)
		return;
	snprintf(text, sizeof(text), format, a, b);
	print_error("%s: %s\n", names, text);
	broken++;
}

/* Whether `f` shows its signs while `other` (or NULL) lasts, too. */
static bool shows(const struct fault *f, const struct fault *other)
{
	return !other || !(f->needs & other->takes);
}

/* An error that is active is not reported again, whatever its bytes. */
static bool shows_later(const struct fault *f, const struct fault *first)
{
	return shows(f, first) && (!f->code || f->code != first->code);
}

static void check_signs(const struct fault *f, bool log)
{
	const struct od_values *v = &site->world.device.values;
	unsigned status = v->sample.status;

	expect(!f->code || f->brief || canopen_error_active(&site->world.device.canopen, f->code),
		"EMCY %04Xh is not active", f->code, 0);
	expect(!f->code || f->brief || (v->error_register & f->error_register) == f->error_register,
		"the error register is %02Xh, not %02Xh", v->error_register, f->error_register);
	expect((status & f->set) == f->set && !(status & f->clear), "the status is %04Xh", status, 0);
	expect(!f->log || !log || site_log_has(site, f->log), "the log does not have its line", 0, 0);
}

/* CiA 303-3: of two the one of the higher priority. */
static enum site_led led_of(const struct fault *f, const struct fault *other)
{
	static const enum site_led order[] = {
		RED_ON, RED_QUADRUPLE, RED_TRIPLE, RED_DOUBLE, RED_SINGLE, RED_BLINKING, RED_FLICKERING};

	for (size_t i = 0; i < sizeof(order) / sizeof(order[0]); i++)
		if ((f->led == order[i] && shows(f, other)) || (other && other->led == order[i] && shows(other, f)))
			return order[i];
	return RED_OFF;
}

static bool may_send(const struct fault *f, uint16_t code)
{
	bool may = f->code == code;

	for (size_t i = 0; i < sizeof(f->also) / sizeof(f->also[0]); i++)
		may |= f->also[i] && f->also[i] == code;
	return may;
}

/* Sent with its bytes, and only as often as it began. */
static void check_emcy_of(const struct fault *f, bool alone)
{
	unsigned count = 0;

	for (size_t i = 0; i < site->emcy_count && i < SITE_EMCYS; i++) {
		const uint8_t *data = site->emcy[i].data;

		if (get_u16(data) != f->code || memcmp(data + 3, f->info, 5) != 0)
			continue;
		expect((data[2] & f->error_register) == f->error_register && (!alone || data[2] == f->error_register),
			"EMCY with register %02Xh, not %02Xh", data[2], f->error_register);
		count++;
	}
	expect(count > 0, "no EMCY %04Xh with its bytes", f->code, 0);
	expect(!alone || count == 1 || f->takes & RECEPTION, "EMCY %04Xh was sent %u times", f->code, count);
}

static void check_no_other_emcy(const struct fault *f, const struct fault *other)
{
	for (size_t i = 0; i < site->emcy_count && i < SITE_EMCYS; i++) {
		uint16_t code = get_u16(site->emcy[i].data);

		expect(code == 0 || may_send(f, code) || (other && may_send(other, code)), "EMCY %04Xh was sent", code,
			0);
	}
}

/* ---- one, and two ------------------------------------------------------------------------------------------------ */

static void run_until_recovered(double s, unsigned but)
{
	const char *deviation;

	site_run(site, fmax(0, s));
	deviation = site_deviation(site, but);
	if (!deviation)
		return;
	print_error("%s: after %.2f s: %s\n", names, s, deviation);
	broken++;
}

static void run_one(const struct fault *f)
{
	char line[40];

	*site = *at_rest;
	snprintf(names, sizeof(names), "%s", f->name);
	fault_begin(site, f);
	site_run(site, f->seen_s);
	check_signs(f, true);
	expect(site->world.device.values.status_leds.error == led_of(f, NULL), "the error LED is %u, not %u",
		site->world.device.values.status_leds.error, led_of(f, NULL));
	expect((site->world.device.canopen.nmt.state == NMT_OPERATIONAL) == !f->pre_operational, "NMT state", 0, 0);
	site_run(site, 1);
	fault_end(site, f);
	site->master_repairs = true;
	site_run(site, f->over_s);
	if (f->code) {
		expect(!canopen_error_active(&site->world.device.canopen, f->code), "EMCY %04Xh is not over", f->code,
			0);
		snprintf(line, sizeof(line), "error %04Xh (%s) is over", f->code, emcy_code_text(f->code));
		expect(site_log_has(site, line), "the log does not have the end of the error", 0, 0);
	}
	expect(!f->over || site_log_has(site, f->over), "the log does not have the line of the end", 0, 0);
	site_run(site, 0.3); /* inhibit time of EMCY, if any */
	if (f->code)
		check_emcy_of(f, true);
	check_no_other_emcy(f, NULL);
	run_until_recovered(f->recovered_s - f->over_s - 0.3, f->lingering);
	if (f->lingering)
		run_until_recovered(f->lingering_s - f->recovered_s, 0);
}

static void run_two(const struct fault *f, const struct fault *g)
{
	enum site_led led = led_of(f, g);
	bool pre_operational = (f->pre_operational && shows(f, g)) || (g->pre_operational && shows(g, f));

	/* of lines of one kind the log leaves some out */
	bool log = !(f->log && g->log && strncmp(f->log, "can: ", 5) == 0 && strncmp(g->log, "can: ", 5) == 0);

	*site = *at_rest;
	snprintf(names, sizeof(names), "%s, and %s", f->name, g->name);
	fault_begin(site, f);
	site_run(site, 0.05);
	fault_begin(site, g);
	site_run(site, fmax(f->seen_s, g->seen_s));
	if (shows(f, g) && !f->brief)
		check_signs(f, log);
	if (shows_later(g, f) && (!g->brief || g->seen_s >= f->seen_s))
		check_signs(g, log);
	if (!f->brief && !g->brief && shows(f, g) && shows(g, f) && !((f->takes | g->takes) & RECEPTION)) {
		expect(site->world.device.values.status_leds.error == led, "the error LED is %u, not %u",
			site->world.device.values.status_leds.error, led);
		expect((site->world.device.canopen.nmt.state == NMT_OPERATIONAL) == !pre_operational, "NMT state", 0,
			0);
	}
	site_run(site, 0.5);
	fault_end(site, f);
	fault_end(site, g);
	site->master_repairs = true;
	site_run(site, fmax(0.3, fmax(f->over_s, g->over_s)));
	if (f->code && shows(f, g) && !((f->takes | g->takes) & SENDING))
		check_emcy_of(f, false);
	if (g->code && shows_later(g, f) && !((f->takes | g->takes) & SENDING))
		check_emcy_of(g, false);
	check_no_other_emcy(f, g);
	run_until_recovered(fmax(f->recovered_s, g->recovered_s) - fmax(0.3, fmax(f->over_s, g->over_s)),
		f->lingering | g->lingering);
}

static void test_each_fault_shows_its_status_emcy_log_and_led_and_all_is_as_before_in_time(void **state)
{
	(void)state;
	*site = *at_rest;
	assert_null(site_deviation(site, 0));
	for (const struct fault *f = FAULTS; f < FAULTS + FAULT_COUNT; f++)
		if (wanted(f))
			run_one(f);
	assert_int_equal(broken, 0);
}

static void test_each_two_faults_at_once_show_what_each_shows_and_all_is_as_before_in_time(void **state)
{
	(void)state;
	for (const struct fault *f = FAULTS; f < FAULTS + FAULT_COUNT; f++)
		for (const struct fault *g = FAULTS; g < FAULTS + FAULT_COUNT; g++)
			if (f != g && wanted(f) && (getenv("IMU9_LONG") || (f < g) == ((f - g) % 2 == 0)))
				run_two(f, g);
	assert_int_equal(broken, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_fault_shows_its_status_emcy_log_and_led_and_all_is_as_before_in_time),
		cmocka_unit_test(test_each_two_faults_at_once_show_what_each_shows_and_all_is_as_before_in_time),
	};

	return cmocka_run_group_tests(tests, set_up, tear_down);
}

/* Bit timings for the clocks of controllers, compared with those that were found when the trace was written (trace.h).
 * That they fit the bit rate and the sample point is for test_can_gs_usb.c to say. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>

#include "drivers/can/gs_usb_timing.h"
#include "tests/unit/trace.h"

static const struct can_link_limits CONTROLLERS[] = {
	{8000000, 1, 64, 1, 1, 16, 1, 8},
	{7372800, 1, 64, 1, 1, 16, 1, 8},
	{36000000, 1, 1024, 1, 1, 16, 1, 8},
	{42000000, 1, 1024, 1, 1, 16, 1, 8},
	{48000000, 1, 1024, 1, 1, 16, 1, 8},
	{60000000, 2, 512, 2, 3, 16, 2, 8},
	{80000000, 1, 512, 1, 2, 256, 2, 128},
	{170000000, 1, 512, 1, 1, 256, 1, 128},
};

static void test_each_rate(void **state)
{
	static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000, 50000, 20000, 10000, 123456, 83333};
	const struct can_link_limits *l = *state;
	char text[100];

	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++)
		for (uint32_t sjw = 1; sjw <= 4; sjw += 3) {
			struct bit_timing t = {0};
			int result = bit_timing_find(l, sjw, rates[i], bit_timing_sample_point(rates[i]), &t);

			snprintf(text, sizeof text, "%u Hz, %u bit/s, sjw %u", l->clock_hz, rates[i], sjw);
			trace_block(text);
			snprintf(text, sizeof text, "%d: prop %u, seg1 %u, seg2 %u, sjw %u, brp %u", result, t.prop,
				t.seg1, t.seg2, t.sjw, t.brp);
			trace_text("timing", text);
		}
	trace_check();
}

int main(void)
{
	enum { COUNT = sizeof CONTROLLERS / sizeof *CONTROLLERS };
	struct CMUnitTest tests[COUNT + 1];

	for (int i = 0; i < COUNT; i++)
		tests[i] = (struct CMUnitTest){"each rate", test_each_rate, NULL, NULL, (void *)&CONTROLLERS[i]};
	return trace_run("timing", tests, COUNT);
}

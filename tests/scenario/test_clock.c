/* The device sends the same frames whatever the clock says when it is switched on: a counter of 32 bits of us wraps
 * after 71 minutes, one of ms after 49.7 days. The clock has 64 bits; a time that is cut somewhere shows as another
 * frame. */
#include <stdlib.h>
#include <string.h>

#include "od/little_endian.h"
#include "tests/scenario/world.h"

enum {
	FIRST_US = 1000000,
	SECONDS = 20,
	INTERVALS = 100 * SECONDS,
	SILENT_FROM = 600,
	SILENT_TO = 680,
	PARTNER_LOST = 1500
};

static void configure(struct world *w)
{
	static const struct {
		uint16_t index;
		uint8_t sub, size;
		uint32_t value;
	} settings[] = {
		{0x1017, 0, 2, 70},	    /* heartbeat, ms */
		{0x1016, 1, 4, 0x0005012C}, /* that of node 5, 300 ms */
		{0x1801, 1, 4, 0x80000280u + WORLD_NODE_ID},
		{0x1801, 2, 1, 254},
		{0x1801, 5, 2, 130}, /* event timer, ms */
		{0x1801, 1, 4, 0x280 + WORLD_NODE_ID},
		{0x1802, 1, 4, 0x80000380u + WORLD_NODE_ID},
		{0x1802, 2, 1, 255},
		{0x1802, 3, 2, 370}, /* inhibit time, 0.1 ms */
		{0x1802, 1, 4, 0x380 + WORLD_NODE_ID},
	};

	world_power_on(w, NULL);
	for (size_t i = 0; i < sizeof(settings) / sizeof(settings[0]); i++)
		assert_int_equal(
			world_sdo_write(w, settings[i].index, settings[i].sub, &settings[i].value, settings[i].size),
			0);
	world_nmt(w, 1);
}

/* Everything that waits for a time: SYNC, heartbeats of another node until it is lost, an SDO transfer that its client
 * leaves, and a sensor that is silent for a while. */
static void interval(struct world *w, int i, uint64_t start_us)
{
	struct imu_sample sample;

	sensor_next(&w->sensor, w->signal, &sample, NULL);
	sample.t_us += start_us;
	if (i < SILENT_FROM || i >= SILENT_TO) {
		world_deliver(w, &sample);
	} else {
		w->now_us += w->interval_us;
		device_tick(&w->device, w->now_us);
	}
	if (i % 8 == 0)
		world_receive(w, 0x080, 0, NULL);
	if (i % 20 == 0 && i < PARTNER_LOST)
		world_receive(w, 0x705, 1, "\x05");
	if (i % 700 == 0)
		world_receive(w, 0x600u + w->node_id, 8, (const uint8_t[8]){0x40, 0x08, 0x10, 0});
}

static struct world *run(uint64_t start_us)
{
	struct world *w = calloc(1, sizeof(*w));

	assert_non_null(w);
	world_init(w, sensor_preset("lsm303dlhc_l3gd20"), 3, "tumble");
	w->now_us = start_us;
	configure(w);
	for (int i = 0; i < INTERVALS; i++)
		interval(w, i, start_us);
	return w;
}

/* TPDO4 has the time of the sample (210Fh:2) in bytes 4 to 7: it counts from the start here. */
static struct can_msg since_start(struct can_msg msg, uint64_t start_us)
{
	if (msg.id == 0x480u + WORLD_NODE_ID)
		put_u32(msg.data + 4, get_u32(msg.data + 4) - (uint32_t)start_us);
	return msg;
}

static void test_the_frames_do_not_depend_on_the_time_of_the_start(void **state)
{
	static const uint64_t wraps_us[] = {UINT64_C(1) << 31, UINT64_C(1) << 32, (UINT64_C(1) << 31) * 1000,
		(UINT64_C(1) << 32) * 1000, UINT64_C(1) << 48, UINT64_C(1) << 53};
	struct world *first = run(FIRST_US);

	*state = first;
	assert_true(first->frame_count < WORLD_FRAMES);		       /* all are recorded */
	assert_true(world_count(first, 0x080u + first->node_id) >= 3); /* the sensor lost and back, the node lost */
	for (size_t i = 0; i < sizeof(wraps_us) / sizeof(wraps_us[0]); i++) {
		uint64_t start_us = wraps_us[i] - SECONDS / 2 * 1000000;
		struct world *w = run(start_us);

		assert_int_equal(w->frame_count, first->frame_count);
		for (size_t k = 0; k < w->frame_count; k++) {
			struct can_msg a = since_start(first->frames[k], FIRST_US),
				       b = since_start(w->frames[k], start_us);

			assert_int_equal(a.id, b.id);
			assert_memory_equal(a.data, b.data, 8);
		}
		free(w);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_teardown(test_the_frames_do_not_depend_on_the_time_of_the_start, world_tear_down),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

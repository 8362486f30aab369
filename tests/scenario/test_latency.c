/* The histograms of latency (2149h to 214Bh, 2151h to 2153h), and 1 kHz with all TPDOs: the whole device in simulated
 * time, which passes while the driver of the bus takes a frame. So each duration is known. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/histogram.h"
#include "od/little_endian.h"
#include "tests/scenario/world.h"

enum { SEND_US = 40, TPDOS = 8, KHZ_SAMPLES = 5000 };

struct lab {
	struct world world;
	const struct can_ops *ops; /* of the world */
	uint64_t send_us;
	bool full; /* the driver of the bus takes no frame */
	unsigned readings;
	uint32_t delays_ns[8]; /* the clock advances by so much before each of its first readings */
	uint64_t extra_ns;
	uint64_t epoch_us; /* of the time stamps of samples */
};

static uint64_t read_clock(void *ctx)
{
	struct lab *lab = ctx;

	if (lab->readings < sizeof(lab->delays_ns) / sizeof(lab->delays_ns[0]))
		lab->extra_ns += lab->delays_ns[lab->readings++];
	return lab->world.now_us * 1000 + lab->extra_ns;
}

static int send_slowly(struct can_port *port, const struct can_msg *msg)
{
	struct lab *lab = (struct lab *)port;

	if (lab->full)
		return -ENOBUFS;
	lab->world.now_us += lab->send_us;
	return lab->ops->send(port, msg);
}

static struct lab *new_lab(double rate_hz)
{
	static struct can_ops ops;
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	struct lab *lab = calloc(1, sizeof(*lab));

	assert_non_null(lab);
	chip.rate_hz = rate_hz;
	sensor_calibrate(&chip);
	world_init(&lab->world, &chip, 1, "rest");
	lab->ops = lab->world.bus.ops;
	ops = *lab->ops;
	ops.send = send_slowly;
	lab->world.bus.ops = &ops;
	world_power_on(&lab->world, NULL);
	lab->world.device.latency.clock_ns = read_clock;
	lab->world.device.latency.clock_ctx = lab;
	return lab;
}

static int set_up(void **state)
{
	struct lab *lab = new_lab(100);

	world_nmt(&lab->world, 1);
	lab->send_us = SEND_US;
	*state = lab;
	return 0;
}

/* A sample arrives `age_us` after it was measured. */
static void deliver(struct lab *lab, uint64_t age_us)
{
	struct world *w = &lab->world;
	struct imu_sample sample;

	sensor_next(&w->sensor, w->signal, &sample, NULL);
	sample.t_us = lab->epoch_us + w->now_us + w->interval_us - age_us;
	world_deliver(w, &sample);
}

/* The device reads a SYNC `waited_us` after its time stamp. */
static void sync_after(struct lab *lab, uint64_t waited_us)
{
	struct world *w = &lab->world;
	const struct can_msg msg = {.id = 0x080, .t_us = w->now_us - waited_us};

	device_receive(&w->device, &msg, w->now_us);
	device_tick(&w->device, w->now_us);
}

/* Segmented upload (CiA 301, 7.2.4.3.6); after each segment a SYNC is received. */
static size_t upload(struct lab *lab, uint16_t index, uint8_t *out, size_t capacity)
{
	struct world *w = &lab->world;
	uint8_t request[8] = {0x40, (uint8_t)index, (uint8_t)(index >> 8), 4};
	const struct can_msg *answer;
	size_t size = 0;

	world_receive(w, 0x600u + w->node_id, 8, request);
	answer = world_last(w, 0x580u + w->node_id);
	assert_int_equal(answer->data[0], 0x41);
	for (uint8_t toggle = 0;; toggle ^= 0x10) {
		sync_after(lab, 0);
		world_receive(w, 0x600u + w->node_id, 8, (const uint8_t[8]){0x60 | toggle});
		answer = world_last(w, 0x580u + w->node_id);
		assert_int_equal(answer->data[0] & 0xF0, toggle);
		size_t n = 7u - (answer->data[0] >> 1 & 7);
		assert_true(size + n <= capacity);
		memcpy(out + size, answer->data + 1, n);
		size += n;
		if (answer->data[0] & 1)
			return size;
	}
}

/* ---- latency ----------------------------------------------------------------------------------------------------- */

static void test_without_a_clock_nothing_is_measured(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	lab->world.device.latency.clock_ns = NULL;
	deliver(lab, 500);
	sync_after(lab, 100);
	assert_int_equal(v->sample_age.count, 0);
	assert_int_equal(v->sync_to_tpdo.count, 0);
	assert_int_equal(v->stage_filter.count, 0);
}

static void test_the_age_of_a_sample_ends_when_its_tpdos_were_sent(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	deliver(lab, 1500);
	lab->world.now_us += 2000;
	sync_after(lab, 0);
	assert_int_equal(v->sample_age.count, 1); /* of four TPDOs */
	assert_int_equal(v->sample_age.minimum, 1500 + 2000 + 4 * SEND_US);
	assert_int_equal(v->sample_age.maximum, 1500 + 2000 + 4 * SEND_US);
	/* 3660: of 2048 to 4095, whose bins are 40 to 43, the last quarter */
	assert_int_equal(lab->world.device.latency.objects[LATENCY_SAMPLE_AGE].histogram.bins[43], 1);
}

static void test_a_sample_that_is_sent_again_is_older(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	deliver(lab, 1000);
	sync_after(lab, 0);
	lab->world.now_us += 30000;
	sync_after(lab, 0);
	assert_int_equal(v->sample_age.count, 2);
	assert_int_equal(v->sample_age.minimum, 1000 + 4 * SEND_US);
	assert_int_equal(v->sample_age.maximum, 1000 + 30000 + 8 * SEND_US);
}

static void test_the_time_stamps_of_a_log_have_an_epoch_of_their_own(void **state)
{
	struct lab *lab = *state;

	lab->epoch_us = UINT64_C(1700000000000000);
	for (int i = 0; i < 10; i++)
		deliver(lab, 0);
	deliver(lab, 700);
	sync_after(lab, 0);
	assert_int_equal(lab->world.device.values.sample_age.maximum, 700 + 4 * SEND_US);
}

static void test_without_a_sample_tpdos_have_no_age(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	sync_after(lab, 0);
	assert_int_equal(v->sample_age.count, 0);
	assert_int_equal(v->sync_to_tpdo.count, 1);
}

static void test_sync_to_tpdo_begins_with_the_time_stamp_of_the_sync(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	deliver(lab, 0);
	sync_after(lab, 120);
	assert_int_equal(v->sync_to_tpdo.count, 1);
	assert_int_equal(v->sync_to_tpdo.minimum, 120 + 4 * SEND_US);
	/* 280: of 256 to 511, whose bins are 28 to 31, the first quarter */
	assert_int_equal(lab->world.device.latency.objects[LATENCY_SYNC].histogram.bins[28], 1);
	world_nmt(&lab->world, 2); /* stopped: not answered */
	sync_after(lab, 120);
	assert_int_equal(v->sync_to_tpdo.count, 1);
}

static void test_a_tpdo_of_an_event_has_an_age_and_no_sync(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	for (uint16_t index = 0x1800; index < 0x1804; index++)
		assert_int_equal(world_sdo_write(&lab->world, index, 2, &(uint8_t){254}, 1), 0);
	sync_after(lab, 0); /* which no TPDO answers */
	deliver(lab, 2500);
	assert_int_equal(v->sample_age.count, 1);
	assert_int_equal(v->sample_age.maximum, 2500 + 4 * SEND_US);
	assert_int_equal(v->sync_to_tpdo.count, 0);
}

static void test_a_time_stamp_ahead_of_the_clock_counts_as_0(void **state)
{
	struct lab *lab = *state;

	lab->send_us = 0;
	sync_after(lab, (uint64_t)-3);
	assert_int_equal(lab->world.device.values.sync_to_tpdo.count, 1);
	assert_int_equal(lab->world.device.values.sync_to_tpdo.maximum, 0);
}

/* In ns: 300 to read, 5000 to filter, 9000 for the rest. */
static void test_the_stages_of_a_sample_are_measured_one_by_one(void **state)
{
	static const uint32_t delays_ns[] = {300, 5000, 9000};
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	memcpy(lab->delays_ns, delays_ns, sizeof(delays_ns));
	latency_mark(&lab->world.device.latency, lab->world.now_us * 1000);
	latency_stage(&lab->world.device.latency, LATENCY_READ);
	/* the simulated interval is not one of the stages */
	lab->world.interval_us = 0;
	deliver(lab, 0);
	assert_int_equal(v->stage_read.maximum, 300);
	assert_int_equal(v->stage_filter.maximum, 5000);
	assert_int_equal(v->stage_publish.maximum, 9000);
	assert_int_equal(v->stage_read.count + v->stage_filter.count + v->stage_publish.count, 3);
}

static void test_a_turn_of_the_loop_is_measured_in_us(void **state)
{
	struct lab *lab = *state;
	struct latency *l = &lab->world.device.latency;
	uint64_t begun_us = lab->world.now_us += 1000;

	latency_loop(l, 0); /* it was woken by nothing */
	assert_int_equal(lab->world.device.values.loop_turn.count, 0);
	deliver(lab, 0);
	latency_loop(l, begun_us);
	assert_int_equal(lab->world.device.values.loop_turn.count, 1);
	assert_int_equal(lab->world.device.values.loop_turn.maximum, lab->world.interval_us);
}

static void test_writing_0_to_the_count_empties_that_histogram(void **state)
{
	struct lab *lab = *state;
	const struct od_values *v = &lab->world.device.values;

	deliver(lab, 100);
	sync_after(lab, 100);
	assert_int_equal(world_sdo_write(&lab->world, 0x2149, 1, &(uint32_t){1}, 4), 0x06090031);
	assert_int_equal(v->sample_age.count, 1);
	assert_int_equal(world_sdo_write(&lab->world, 0x2149, 1, &(uint32_t){0}, 4), 0);
	assert_int_equal(v->sample_age.count, 0);
	assert_int_equal(v->sample_age.minimum, 0);
	assert_int_equal(v->sample_age.maximum, 0);
	assert_int_equal(v->sync_to_tpdo.count, 1);
	assert_int_equal(v->stage_filter.count, 1);
	assert_int_equal(world_sdo_write(&lab->world, 0x2152, 1, &(uint32_t){0}, 4), 0);
	assert_int_equal(v->stage_filter.count, 0);
	deliver(lab, 900);
	sync_after(lab, 0);
	assert_int_equal(v->sample_age.minimum, 900 + 4 * SEND_US);
}

static void test_an_upload_has_all_of_one_moment(void **state)
{
	struct lab *lab = *state;
	uint8_t wire[512];
	struct histogram h;

	deliver(lab, 100);
	for (int i = 0; i < 20; i++)
		sync_after(lab, (uint64_t)i);
	size_t size = upload(lab, 0x214A, wire, sizeof(wire));
	assert_int_equal(histogram_decode(&h, wire, size), 0);
	assert_int_equal(h.count, 20);
	assert_int_equal(h.minimum, 4 * SEND_US);
	assert_int_equal(h.maximum, 4 * SEND_US + 19);
	assert_int_equal(h.sum, 20 * 4 * SEND_US + 19 * 20 / 2);
	assert_true(lab->world.device.values.sync_to_tpdo.count > 70); /* counted during the upload */
}

/* ---- 1 kHz ------------------------------------------------------------------------------------------------------- */

static const uint32_t COB_IDS[TPDOS] = {0x180, 0x280, 0x380, 0x480, 0x1C0, 0x2C0, 0x3C0, 0x4C0};

static void write_object(struct world *w, uint16_t index, uint8_t sub, uint32_t value, size_t size)
{
	uint8_t wire[4];

	put_u32(wire, value);
	assert_int_equal(world_sdo_write(w, index, sub, wire, size), 0);
}

/* All TPDOs full, with the sample counter in their last two bytes, by the procedure of CiA 301, 7.5.2.38. */
static struct lab *new_khz_lab(uint8_t type)
{
	static const uint32_t mapped[TPDOS] = {0x2100, 0x2101, 0x2102, 0x2141, 0x2142, 0x2143, 0x2144, 0x2145};
	struct lab *lab = new_lab(1000);
	struct world *w = &lab->world;

	for (uint16_t i = 0; i < TPDOS; i++) {
		uint16_t communication = (uint16_t)(0x1800 + i), mapping = (uint16_t)(0x1A00 + i);

		write_object(w, communication, 1, 0x80000000 | (COB_IDS[i] + w->node_id), 4);
		write_object(w, communication, 2, type, 1);
		write_object(w, mapping, 0, 0, 1);
		for (uint8_t sub = 1; sub <= 3; sub++)
			write_object(w, mapping, sub, mapped[i] << 16 | (uint32_t)sub << 8 | 16, 4);
		write_object(w, mapping, 4, 0x210F0110, 4);
		write_object(w, mapping, 0, 4, 1);
		write_object(w, communication, 1, COB_IDS[i] + w->node_id, 4);
	}
	world_nmt(w, 1);
	w->frame_count = 0;
	return lab;
}

/* Of the TPDOs sent so far: each one's counters are 0, 1, 2 ... */
struct seen {
	size_t frames;
	uint16_t next[TPDOS];
};

static void look(struct lab *lab, struct seen *seen)
{
	struct world *w = &lab->world;

	assert_true(w->frame_count - seen->frames <= WORLD_FRAMES);
	for (; seen->frames < w->frame_count; seen->frames++) {
		const struct can_msg *msg = &w->frames[seen->frames % WORLD_FRAMES];

		for (int i = 0; i < TPDOS; i++) {
			if (msg->id != COB_IDS[i] + w->node_id)
				continue;
			assert_int_equal(msg->len, 8);
			assert_int_equal(get_u16(msg->data + 6), seen->next[i]);
			seen->next[i]++;
		}
	}
}

static void assert_all_seen(struct lab *lab, struct seen *seen, unsigned samples)
{
	look(lab, seen);
	for (int i = 0; i < TPDOS; i++)
		assert_int_equal(seen->next[i], samples);
	assert_int_equal(lab->world.bus.counters.tx_dropped, 0);
}

static void test_at_1_khz_each_sample_is_in_all_eight_tpdos(void **state)
{
	struct lab *lab = new_khz_lab(255);
	struct seen seen = {0};

	(void)state;
	for (unsigned k = 1; k <= KHZ_SAMPLES; k++) {
		deliver(lab, 300);
		assert_all_seen(lab, &seen, k); /* before the next sample */
	}
	assert_int_equal(lab->world.device.values.sample_age.count, KHZ_SAMPLES);
	assert_int_equal(lab->world.device.values.sample_age.maximum, 300);
	free(lab);
}

static void test_at_1_khz_each_sync_is_answered_by_eight_tpdos_of_the_newest_sample(void **state)
{
	struct lab *lab = new_khz_lab(1);
	struct seen seen = {0};

	(void)state;
	for (unsigned k = 1; k <= KHZ_SAMPLES; k++) {
		deliver(lab, 300);
		sync_after(lab, 0);
		assert_all_seen(lab, &seen, k);
	}
	assert_int_equal(lab->world.device.values.sync_to_tpdo.count, KHZ_SAMPLES);
	free(lab);
}

/* The queue has 128 frames: 16 samples. */
static void test_at_1_khz_a_bus_that_is_full_for_15_ms_loses_nothing(void **state)
{
	struct lab *lab = new_khz_lab(255);
	struct seen seen = {0};

	(void)state;
	for (unsigned k = 0; k < KHZ_SAMPLES; k++) {
		lab->full = k % 100 < 15;
		can_service(&lab->world.bus, lab->world.now_us);
		deliver(lab, 300);
		look(lab, &seen);
	}
	can_service(&lab->world.bus, lab->world.now_us);
	assert_all_seen(lab, &seen, KHZ_SAMPLES);
	assert_true(lab->world.bus.counters.tx_retries >= KHZ_SAMPLES / 100);
	free(lab);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
#define LAB(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)
		LAB(test_without_a_clock_nothing_is_measured),
		LAB(test_the_age_of_a_sample_ends_when_its_tpdos_were_sent),
		LAB(test_a_sample_that_is_sent_again_is_older),
		LAB(test_the_time_stamps_of_a_log_have_an_epoch_of_their_own),
		LAB(test_without_a_sample_tpdos_have_no_age),
		LAB(test_sync_to_tpdo_begins_with_the_time_stamp_of_the_sync),
		LAB(test_a_tpdo_of_an_event_has_an_age_and_no_sync),
		LAB(test_a_time_stamp_ahead_of_the_clock_counts_as_0),
		LAB(test_the_stages_of_a_sample_are_measured_one_by_one),
		LAB(test_a_turn_of_the_loop_is_measured_in_us),
		LAB(test_writing_0_to_the_count_empties_that_histogram),
		LAB(test_an_upload_has_all_of_one_moment),
		cmocka_unit_test(test_at_1_khz_each_sample_is_in_all_eight_tpdos),
		cmocka_unit_test(test_at_1_khz_each_sync_is_answered_by_eight_tpdos_of_the_newest_sample),
		cmocka_unit_test(test_at_1_khz_a_bus_that_is_full_for_15_ms_loses_nothing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

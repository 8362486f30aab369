#include "drivers/imu/pololu/board_parts.h"

#include <math.h>

enum {
	RETRY_MS = 5,
	CAN_WAIT_MS = 11, /* reads that are not urgent: a little more than the gyro's interval at 100 Hz */
	TEMPERATURE_MS = 1000,
	BATCH_US = 2500, /* shortest time between reads of a FIFO */
};

/* Periods of the gyro between two accelerations, between which one is interpolated. By judgement: without a FIFO, a
 * late read loses readings of a fast accelerometer all the time. */
#define CHORD_PERIODS 2.5

int64_t board_read_clock(struct board *b)
{
	return b->now_ns = b->clock.now_ns(b->clock.ctx);
}

void board_sleep_until(struct board *b, int64_t ns)
{
	b->clock.sleep_until(b->clock.ctx, ns);
	board_read_clock(b);
}

void board_apply(struct board *b, const struct board_plan *plan)
{
	for (size_t i = 0; i < b->stream_count; i++) {
		struct stream *s = &b->streams[i];

		s->setup = plan->setup[i];
		s->registers = (struct chip_registers){0};
		s->chip->registers(&s->setup, &s->registers);
		s->backoff_ns = STREAM_FIRST_BACKOFF_MS * BOARD_MS;
		s->retry_ns = board_read_clock(b);
		s->state = STREAM_DOWN;
		s->count = 0;
	}
}

void board_update_health(struct board *b)
{
	struct imu_health *h = &b->health;
	const struct stream *bad = b->gyro->fault ? b->gyro : b->accel;
	double period_ns = sample_clock_period(&b->gyro->clock);

	h->fault = (uint8_t)bad->fault;
	h->fault_chip = bad->fault ? (uint8_t)(bad == b->gyro ? IMU_CHIP_GYRO : IMU_CHIP_ACCEL) : 0;
	h->degraded = b->mag ? (uint8_t)b->mag->fault : 0;
	h->degraded_chip = h->degraded ? (uint8_t)IMU_CHIP_MAG : 0;
	if (!h->degraded && b->self_test_failed) {
		h->degraded = IMU_FAULT_SELF_TEST;
		h->degraded_chip = b->self_test_chip;
	}
	if (h->fault || (b->gyro->state == STREAM_UP && b->accel->state == STREAM_UP))
		h->self_test &= (uint8_t)~IMU_SELF_TEST_RUNS;
	h->rate_hz = b->gyro->state == STREAM_UP && period_ns > 0 ? (float)(1e9 / period_ns) : 0;
}

/* ---- schedule of the reads --------------------------------------------------------------------------------------- */

static const struct reading *peek(const struct stream *s, size_t i)
{
	return &s->readings[(s->first + i) % STREAM_READINGS];
}

static int64_t gyro_target(const struct stream *s)
{
	double period_us = sample_clock_period(&s->clock) / 1000;

	return s->setup.fifo ? s->next + (int64_t)ceil(BATCH_US / period_us) - 1 : s->next;
}

/* Whether the newest sample of the gyro has no accelerometer sample after it yet. */
static bool gyro_waits(const struct board *b)
{
	const struct stream *g = b->gyro, *a = b->accel;

	return g->count > 0 && peek(g, g->count - 1)->t_ns > sample_clock_at(&a->clock, a->clock.newest);
}

/* With a FIFO, the accelerometer is read once per batch of the gyro, when it has a sample after the batch. */
static int64_t accel_target(const struct board *b, const struct stream *s)
{
	const struct stream *g = b->gyro;
	double until_ns;
	int64_t index;

	if (!s->setup.fifo || g->state != STREAM_UP)
		return s->next;
	until_ns = gyro_waits(b) ? peek(g, g->count - 1)->t_ns : sample_clock_at(&g->clock, gyro_target(g));
	index = s->clock.newest + (int64_t)ceil((until_ns - sample_clock_at(&s->clock, s->clock.newest)) /
						sample_clock_period(&s->clock));
	return index > s->next ? index : s->next;
}

/* The gyro is read together with the accelerometer, which its samples need, unless its clock has a wide bracket. */
static double gyro_due(const struct board *b, const struct stream *g)
{
	const struct stream *a = b->accel;
	double due_ns = sample_clock_due(&g->clock, gyro_target(g));

	if (a == g || !g->setup.fifo || !a->setup.fifo || g->state != STREAM_UP || a->state != STREAM_UP ||
		gyro_waits(b) || a->failures > 0 || sample_clock_is_wide(&g->clock, gyro_target(g)))
		return due_ns;
	return fmax(due_ns, sample_clock_due(&a->clock, accel_target(b, a)));
}

static int64_t next_due(const struct board *b, const struct stream *s)
{
	double period_ns = sample_clock_period(&s->clock), t_ns = (double)b->now_ns, due_ns;

	if (s->failures > 0)
		return (int64_t)t_ns + RETRY_MS * BOARD_MS;
	if (s->clock.newest < 0)
		return (int64_t)(t_ns + period_ns / 4);
	due_ns = s == b->gyro	 ? gyro_due(b, s)
		 : s == b->accel ? sample_clock_due(&s->clock, accel_target(b, s))
				 : sample_clock_due(&s->clock, s->next);
	return (int64_t)fmax(due_ns, t_ns + period_ns / 32);
}

static void step_stream(struct board *b, struct stream *s)
{
	if (s->state == STREAM_DOWN && b->now_ns >= s->retry_ns)
		stream_start(b, s);
	if (s->state != STREAM_DOWN && b->now_ns >= s->due_ns) {
		stream_count_errors(b, s, stream_read(b, s));
		s->due_ns = next_due(b, s);
	}
	if (s->state != STREAM_DOWN && b->now_ns >= s->verify_ns)
		stream_verify_next(b, s);
	stream_watch(b, s);
}

/* Reads of the magnetometer and the verification of registers may wait for the next read of the gyro. */
static int64_t wake_of(const struct board *b, const struct stream *s)
{
	int64_t can_wait_ns = b->gyro->state == STREAM_UP ? CAN_WAIT_MS * BOARD_MS : 0, due_ns;

	if (s->state == STREAM_DOWN)
		return s->retry_ns;
	due_ns = s->due_ns;
	if (s == b->mag && s->failures == 0 && s->state == STREAM_UP && !sample_clock_is_wide(&s->clock, s->next))
		due_ns += can_wait_ns;
	return due_ns < s->verify_ns + can_wait_ns ? due_ns : s->verify_ns + can_wait_ns;
}

static void read_temperature(struct board *b)
{
	const struct stream *s = b->gyro;
	uint8_t bytes[2] = {0};

	if (b->now_ns < b->temperature_ns || s->state != STREAM_UP || s->chip->temperature.size == 0)
		return;
	b->temperature_ns = b->now_ns + TEMPERATURE_MS * BOARD_MS;
	if (board_read_chip(b, s->chip, s->address, s->chip->temperature.address, bytes, s->chip->temperature.size) <
		0) {
		b->health.bus_errors++;
		return;
	}
	b->temperature_degC = s->chip->temperature.zero_degC +
			      s->chip->temperature.per_digit *
				      (s->chip->temperature.size == 1 ? (int8_t)bytes[0] : stream_word(s->chip, bytes));
	b->temperature_new = true;
}

int64_t board_step(struct board *b)
{
	int64_t wake_ns = INT64_MAX;

	board_read_clock(b);
	for (size_t i = 0; i < b->stream_count; i++)
		step_stream(b, &b->streams[i]);
	/* the gyro sample that it waits for may just have been read */
	if (b->accel != b->gyro && b->accel->state != STREAM_DOWN && b->accel->failures == 0) {
		b->accel->due_ns = next_due(b, b->accel);
		if (b->gyro->state == STREAM_UP && b->gyro->failures == 0 && b->gyro->due_ns > b->now_ns)
			b->gyro->due_ns = next_due(b, b->gyro);
	}
	read_temperature(b);
	board_update_health(b);
	for (size_t i = 0; i < b->stream_count; i++)
		if (wake_of(b, &b->streams[i]) < wake_ns)
			wake_ns = wake_of(b, &b->streams[i]);
	return wake_ns;
}

/* The time stamp of the interrupt may be up to LATENCY_NS after the edge. */
void board_data_ready(struct board *b, int64_t t_ns)
{
	enum { LATENCY_NS = 100000 };

	if (b->gyro->state == STREAM_DOWN)
		return;
	sample_clock_edge(&b->gyro->clock, (double)t_ns - LATENCY_NS, (double)t_ns);
	b->gyro->due_ns = t_ns;
}

/* ---- samples of the board ---------------------------------------------------------------------------------------- */

static void drop(struct stream *s)
{
	s->first = (s->first + 1) % STREAM_READINGS;
	s->count--;
}

/* The acceleration at the time of a gyro sample. 1; 0: not known yet; -1: will not be known. Where readings were lost
 * (a fast accelerometer fills its FIFO before the gyro does) it is not: a chord across that gap is no measurement. */
static int accel_at(struct board *b, const struct reading *gyro, struct vec3 *value, bool *saturated)
{
	struct stream *a = b->accel;
	const struct reading *before, *after;
	double w;

	if (a == b->gyro) {
		*value = gyro->value[1];
		return 1;
	}
	while (a->count >= 2 && peek(a, 1)->t_ns <= gyro->t_ns)
		drop(a);
	if (a->count > 0 && peek(a, 0)->t_ns > gyro->t_ns)
		return -1;
	if (a->count < 2)
		return 0;
	before = peek(a, 0);
	after = peek(a, 1);
	if (after->t_ns - before->t_ns > CHORD_PERIODS * sample_clock_period(&b->gyro->clock))
		return -1;
	w = (gyro->t_ns - before->t_ns) / (after->t_ns - before->t_ns);
	*value = vec3_add(vec3_scale(1 - w, before->value[0]), vec3_scale(w, after->value[0]));
	*saturated |= before->saturated || after->saturated;
	return 1;
}

/* Rotates the field to the time of the gyro sample: dv/dt = v x omega. */
static void add_mag(struct board *b, double t_ns, struct imu_sample *sample)
{
	for (struct stream *m = b->mag; m && m->count > 0 && peek(m, 0)->t_ns <= t_ns; drop(m)) {
		const struct vec3 field = peek(m, 0)->value[0];
		const double age_s = fmin((t_ns - peek(m, 0)->t_ns) * 1e-9, 0.05);

		sample->mag_uT = vec3_add(field, vec3_scale(age_s, vec3_cross(field, sample->gyro_rad_s)));
		sample->flags |= SAMPLE_MAG | (peek(m, 0)->saturated ? SAMPLE_SATURATED : 0u);
	}
}

bool board_next(struct board *b, struct imu_sample *sample)
{
	struct reading gyro;
	bool saturated;
	int have = -1;

	while (have < 0) {
		if (b->gyro->count == 0)
			return false;
		gyro = *peek(b->gyro, 0);
		saturated = gyro.saturated;
		*sample = (struct imu_sample){.t_us = (uint64_t)(gyro.t_ns / 1000), .gyro_rad_s = gyro.value[0]};
		have = accel_at(b, &gyro, &sample->accel_m_s2, &saturated);
		if (have == 0)
			return false;
		drop(b->gyro);
		if (gyro.t_ns < b->last_t_ns + 1000) /* its clock was re-initialised */
			have = -1;
	}
	b->last_t_ns = gyro.t_ns;
	sample->flags = saturated ? SAMPLE_SATURATED : 0;
	add_mag(b, gyro.t_ns, sample);
	if (b->temperature_new) {
		sample->temperature_degC = b->temperature_degC;
		sample->flags |= SAMPLE_TEMPERATURE;
		b->temperature_new = false;
	}
	return true;
}

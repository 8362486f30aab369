#include "drivers/imu/merge.h"

#include <stdlib.h>

/* Between two readings of the accelerometer a chord is its reading, if it is not longer than 0.1 s or that many usual
 * intervals. By judgement: a hand changes its acceleration within that time. */
enum { CHORD_NS = 100000000, CHORD_INTERVALS = 3, USUAL = 16 };

static struct merge_reading *peek(struct merge_ring *ring, unsigned i)
{
	return i < ring->count ? &ring->at[(ring->first + i) % MERGE_READINGS] : NULL;
}

static void drop(struct merge_ring *ring)
{
	ring->first = (ring->first + 1) % MERGE_READINGS;
	ring->count--;
}

static void push(struct merge_ring *ring, const struct merge_reading *reading)
{
	if (reading->t_ns <= ring->last_ns)
		return;
	if (ring->last_ns > INT64_MIN) {
		const int64_t interval_ns = reading->t_ns - ring->last_ns, usual_ns = ring->usual_ns;

		if (usual_ns == 0)
			ring->usual_ns = interval_ns;
		else
			ring->usual_ns +=
				((interval_ns < 2 * usual_ns ? interval_ns : 2 * usual_ns) - usual_ns) / USUAL;
	}
	ring->last_ns = reading->t_ns;
	ring->at[(ring->first + ring->count++) % MERGE_READINGS] = *reading;
}

void merge_init(struct merge *m, int64_t tolerance_ns)
{
	*m = (struct merge){.tolerance_ns = tolerance_ns, .gyro.last_ns = INT64_MIN, .accel.last_ns = INT64_MIN};
}

void merge_add(struct merge *m, enum imu_chip chip, const struct merge_reading *reading)
{
	if (chip == IMU_CHIP_MAG) {
		m->mag = *reading;
		m->mag_new = true;
		return;
	}
	if (m->gyro.count == MERGE_READINGS) {
		drop(&m->gyro);
		m->lost++;
	}
	if (m->accel.count == MERGE_READINGS)
		drop(&m->accel);
	push(chip == IMU_CHIP_GYRO ? &m->gyro : &m->accel, reading);
}

static int64_t apart_ns(const struct merge_reading *a, const struct merge_reading *b)
{
	return llabs(a->t_ns - b->t_ns);
}

/* Readings are missing between these. */
static bool is_hole(
	const struct merge_ring *ring, const struct merge_reading *before, const struct merge_reading *after)
{
	const int64_t apart = apart_ns(after, before);

	return apart > CHORD_NS && apart > CHORD_INTERVALS * ring->usual_ns;
}

/* The acceleration at the time of the gyro reading. 1; 0: not known yet; -1: will not be known. */
static int accel_at(struct merge *m, const struct merge_reading *gyro, struct merge_reading *out)
{
	const struct merge_reading *before, *after;

	while (m->accel.count > 1 && peek(&m->accel, 1)->t_ns <= gyro->t_ns)
		drop(&m->accel);
	before = peek(&m->accel, 0);
	after = peek(&m->accel, 1);
	if (!before)
		return 0;
	*out = *before;
	if (apart_ns(before, gyro) <= m->tolerance_ns && (!after || apart_ns(before, gyro) <= apart_ns(after, gyro)))
		return 1;
	if (before->t_ns > gyro->t_ns)
		return -1;
	if (!after)
		return 0;
	if (apart_ns(after, gyro) <= m->tolerance_ns) {
		*out = *after;
		return 1;
	}
	if (is_hole(&m->accel, before, after))
		return -1;
	double share = (double)(gyro->t_ns - before->t_ns) / (double)(after->t_ns - before->t_ns);
	out->value = vec3_add(before->value, vec3_scale(share, vec3_sub(after->value, before->value)));
	out->saturated = before->saturated || after->saturated;
	return 1;
}

/* The field is constant in the global frame: in the sensor's axes it changes by v x omega. */
static void add_mag(struct merge *m, const struct merge_reading *gyro, struct imu_sample *sample)
{
	double age_s = 1e-9 * (double)(gyro->t_ns - m->mag.t_ns);

	if (!m->mag_new || m->mag.t_ns > gyro->t_ns + m->tolerance_ns)
		return;
	m->mag_new = false;
	sample->mag_uT = vec3_add(m->mag.value, vec3_scale(age_s, vec3_cross(m->mag.value, gyro->value)));
	sample->flags |= SAMPLE_MAG;
}

bool merge_next(struct merge *m, struct imu_sample *sample)
{
	struct merge_reading accel, gyro;
	int known = -1;

	while (known < 0 && m->gyro.count > 0) {
		gyro = *peek(&m->gyro, 0);
		known = accel_at(m, &gyro, &accel);
		if (known != 0)
			drop(&m->gyro);
		if (known < 0)
			m->lost++;
	}
	if (known <= 0)
		return false;
	*sample = (struct imu_sample){.t_us = (uint64_t)(gyro.t_ns / 1000),
		.gyro_rad_s = gyro.value,
		.accel_m_s2 = accel.value,
		.flags = gyro.saturated || accel.saturated ? SAMPLE_SATURATED : 0};
	add_mag(m, &gyro, sample);
	return true;
}

#include "model/identify/calibrate.h"
#include "model/math/units.h"

static const uint64_t BLOCK_US = (uint64_t)(1e6 * CALIBRATE_BLOCK_S), GAP_US = 500000;
static const double MEAN_BLOCKS = 8; /* time constant of the mean over blocks: 2 s */
/* MIN_SAMPLES: for a standard deviation; MIN_RUN: a block at rest with one at rest on either side. */
enum { MIN_SAMPLES = 3, MIN_RUN = 3 };

const struct calibrate_stillness CALIBRATE_LYING = {1 * RAD_PER_DEG, 0.15}, CALIBRATE_HELD = {5 * RAD_PER_DEG, 0.4};

const char *calibrate_text(enum calibrate_verdict verdict)
{
	switch (verdict) {
	case CALIBRATE_COLLECTING:
		return "running";
	case CALIBRATE_GOOD:
		return "good";
	case CALIBRATE_MOVED:
		return "the sensor did not lie still long enough: put it down and do not touch it";
	case CALIBRATE_TURNED:
		return "the sensor turned slowly and steadily: the measured gravity or magnetic field changed "
		       "direction";
	case CALIBRATE_TOO_FEW_POSITIONS:
		return "too few positions: hold the sensor still for 3 s in each, at least 20 deg away from all others";
	case CALIBRATE_POOR_COVERAGE:
		return "the orientations do not cover the sphere: turn every side up and down";
	case CALIBRATE_LARGE_RESIDUAL:
		return "the measurements are inconsistent: avoid vibration, hold the sensor more steadily, keep away "
		       "from moving iron and magnets";
	case CALIBRATE_NO_ELLIPSOID:
		return "the magnetic measurements do not form an ellipsoid: move away from iron and turn about all "
		       "axes";
	case CALIBRATE_IMPLAUSIBLE:
		return "the estimated errors are larger than those of a working sensor: check sensor, units and field "
		       "strength";
	case CALIBRATE_FACES_TURNED:
		return "the faces are more than 5 deg away from the sensor's axes: use a more accurate fixture, or "
		       "calibrate without one";
	case CALIBRATE_NO_MAGNETOMETER:
		return "no magnetometer values were received";
	case CALIBRATE_NO_TEMPERATURE:
		return "no temperature was received";
	case CALIBRATE_SMALL_TEMPERATURE_SPAN:
		return "the temperature changed by less than 5 K at rest: warm or cool the sensor more";
	case CALIBRATE_SENSOR_LOST:
		return "the sensor stopped sending samples";
	case CALIBRATE_ABORTED:
		return "aborted";
	case CALIBRATE_VERDICTS:
		break;
	}
	return "unknown verdict";
}

struct vec3 calibrate_side(int number)
{
	int corner = number - CALIBRATE_FACES - 1;
	double sign = number % 2 ? 1 : -1;

	switch (number) {
	case 1:
	case 2:
		return (struct vec3){sign, 0, 0};
	case 3:
	case 4:
		return (struct vec3){0, sign, 0};
	case 5:
	case 6:
		return (struct vec3){0, 0, sign};
	default:
		return (struct vec3){corner & 1 ? -1 : 1, corner & 2 ? -1 : 1, corner & 4 ? -1 : 1};
	}
}

const char *calibrate_side_text(int number)
{
	static const char *const TEXTS[CALIBRATE_SIDES + 1] = {"any new side", "+x", "-x", "+y", "-y", "+z", "-z",
		"the corner +x +y +z", "the corner -x +y +z", "the corner +x -y +z", "the corner -x -y +z",
		"the corner +x +y -z", "the corner -x +y -z", "the corner +x -y -z", "the corner -x -y -z"};

	return TEXTS[number > 0 && number <= CALIBRATE_SIDES ? number : 0];
}

double calibrate_gap_rad(int number, const struct vec3 *vectors, int count, struct vec3 centre)
{
	struct vec3 side = calibrate_side(number);
	double nearest = -1;

	for (int i = 0; i < count; i++) {
		struct vec3 v = vec3_sub(vectors[i], centre);
		double norm = vec3_norm(v);

		if (norm > 0)
			nearest = fmax(nearest, vec3_dot(side, v) / (vec3_norm(side) * norm));
	}
	return acos(fmin(1, nearest));
}

void calibrate_rest_init(struct calibrate_rest *rest, const struct calibrate_stillness *stillness)
{
	*rest = (struct calibrate_rest){.stillness = *stillness};
}

double calibrate_rest_time_s(const struct calibrate_rest *rest)
{
	return (double)rest->elapsed_us * 1e-6;
}

static struct vec3 squares(struct vec3 v)
{
	return (struct vec3){v.x * v.x, v.y * v.y, v.z * v.z};
}

static void begin_block(struct calibrate_rest *r, uint64_t t_us)
{
	r->sum = (struct calibrate_block){0};
	r->gyro_squares = r->accel_squares = (struct vec3){0, 0, 0};
	r->block_t_us = t_us;
}

/* Sums deviations from the mean over blocks: squares of the raw values would lose digits to the bias and gravity. */
static void add(struct calibrate_rest *r, const struct imu_sample *s)
{
	struct calibrate_block *b = &r->sum;
	struct vec3 gyro = vec3_sub(s->gyro_rad_s, r->gyro_mean), accel = vec3_sub(s->accel_m_s2, r->accel_mean);

	b->samples++;
	b->gyro_rad_s = vec3_add(b->gyro_rad_s, gyro);
	b->accel_m_s2 = vec3_add(b->accel_m_s2, accel);
	r->gyro_squares = vec3_add(r->gyro_squares, squares(gyro));
	r->accel_squares = vec3_add(r->accel_squares, squares(accel));
	if (s->flags & SAMPLE_MAG) {
		b->mag_samples++;
		b->mag_uT = vec3_add(b->mag_uT, s->mag_uT);
	}
	if (s->flags & SAMPLE_TEMPERATURE) {
		b->temperature_samples++;
		b->temperature_degC += s->temperature_degC;
	}
}

/* Root of the summed variances of the axes, from sum and sum of squares. */
static double deviation(struct vec3 sum, struct vec3 square_sum, unsigned n)
{
	double variance = square_sum.x + square_sum.y + square_sum.z - vec3_dot(sum, sum) / n;

	return sqrt(fmax(0, variance) / (n - 1));
}

/* Turns r->sum from sums into means. True: the block was at rest. */
static bool close_block(struct calibrate_rest *r)
{
	struct calibrate_block *b = &r->sum;
	const struct calibrate_stillness *limit = &r->stillness;
	bool first = r->run == 0, still;

	if (b->samples < MIN_SAMPLES)
		return false;
	still = deviation(b->gyro_rad_s, r->gyro_squares, b->samples) < limit->gyro_rad_s &&
		deviation(b->accel_m_s2, r->accel_squares, b->samples) < limit->accel_m_s2;
	b->gyro_rad_s = vec3_scale(1.0 / b->samples, b->gyro_rad_s);
	b->accel_m_s2 = vec3_scale(1.0 / b->samples, b->accel_m_s2);
	if (!first)
		still = still && vec3_norm(b->gyro_rad_s) < limit->gyro_rad_s &&
			vec3_norm(b->accel_m_s2) < limit->accel_m_s2;
	b->gyro_rad_s = vec3_add(b->gyro_rad_s, r->gyro_mean);
	b->accel_m_s2 = vec3_add(b->accel_m_s2, r->accel_mean);
	if (b->mag_samples)
		b->mag_uT = vec3_scale(1.0 / b->mag_samples, b->mag_uT);
	if (b->temperature_samples)
		b->temperature_degC /= b->temperature_samples;
	b->end_s = calibrate_rest_time_s(r);
	return still;
}

static enum calibrate_rest_event end_rest(struct calibrate_rest *r)
{
	enum calibrate_rest_event event = r->run >= MIN_RUN ? CALIBRATE_REST_ENDED : CALIBRATE_REST_NOTHING;

	r->run = 0;
	return event;
}

/* The first and the last block of a rest are dropped, because motion can reach into them: a block is reported one block
 * late. */
static enum calibrate_rest_event end_block(struct calibrate_rest *r)
{
	bool still = close_block(r);
	double share = r->run == 0 ? 1 : fmax(1 / MEAN_BLOCKS, 1.0 / (r->run + 1));

	if (r->sum.samples >= MIN_SAMPLES) {
		r->gyro_mean = vec3_add(r->gyro_mean, vec3_scale(share, vec3_sub(r->sum.gyro_rad_s, r->gyro_mean)));
		r->accel_mean = vec3_add(r->accel_mean, vec3_scale(share, vec3_sub(r->sum.accel_m_s2, r->accel_mean)));
	}
	if (!still)
		return end_rest(r);
	r->run++;
	r->block = r->pending;
	r->pending = r->sum;
	return r->run >= MIN_RUN ? CALIBRATE_REST_BLOCK : CALIBRATE_REST_NOTHING;
}

enum calibrate_rest_event calibrate_rest_step(struct calibrate_rest *r, const struct imu_sample *raw)
{
	enum calibrate_rest_event event = CALIBRATE_REST_NOTHING;
	bool gap, unusable = raw->flags & (SAMPLE_DISCONTINUITY | SAMPLE_SATURATED);

	if (!vec3_finite(raw->gyro_rad_s) || !vec3_finite(raw->accel_m_s2))
		return CALIBRATE_REST_NOTHING;
	if (!r->started)
		begin_block(r, raw->t_us);
	gap = raw->t_us < r->last_t_us || raw->t_us - r->last_t_us > GAP_US;
	if (r->started && !gap)
		r->elapsed_us += raw->t_us - r->last_t_us;
	if (gap || unusable)
		event = end_rest(r);
	else if (raw->t_us - r->block_t_us >= BLOCK_US)
		event = end_block(r);
	if (gap || unusable || raw->t_us - r->block_t_us >= BLOCK_US)
		begin_block(r, raw->t_us);
	r->started = true;
	r->last_t_us = raw->t_us;
	add(r, raw);
	return event;
}

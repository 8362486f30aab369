#include "model/auto_correction.h"

#include <math.h>

/* c^2 / v that counts at once: six sigma. Convention: that never happens by noise. */
static const double AT_ONCE = 36;
/* Limit of one sample's c^2 / v in the mean. By judgement: after a violent motion it falls below its threshold within
 * ln 50 = 4 s. */
static const double LIMIT = 100;
/* By how much the mean has to exceed 1, which is that of noise alone. By judgement: it scatters by 0.3 or so. */
static const double MARGIN = 1;
/* s, time constant of the mean. By judgement: as long as a movement of a hand. */
static const double MEMORY_S = 1;

/* Samples of the impulse response. By judgement: that of the lowest usual cut-off has decayed. */
enum { IMPULSE_SAMPLES = 4096 };
/* It is over where so many samples add a share so small: quick filters have decayed long before. By judgement: far
 * below what a variance is known to. */
enum { DECAY_SAMPLES = 128 };
static const double DECAYED = 1e-12;

/* The variance of white noise behind a filter is that before it times the sum of squares of the impulse response.
 * Angles are differentiated first: an impulse of them is a pair of impulses of the rate. */
struct rates_variance rates_variance(const struct noise_config *noise, enum rate_source source,
	const struct filter_config *rate_filter, double rate_hz)
{
	const struct vec3 zero = {0, 0, 0};
	const bool angles = source == RATES_FROM_ANGLES;
	const double dt_s = 1 / rate_hz, bias = noise->gyro_bias_instability_rad_s;
	const double gyro_sigma = noise->gyro_density_rad_s_sqrt_hz * sqrt(rate_hz / 2);
	const double first = angles ? noise->angle_sigma_rad * rate_hz : gyro_sigma;
	struct rates_variance sum = {0, 0}, before = sum;
	struct rates rates;

	if (rates_init(&rates, rate_filter, rate_hz) < 0)
		return sum;
	rates_prime(&rates, zero, QUAT_IDENTITY);
	for (int k = 0; k < IMPULSE_SAMPLES; k++) {
		struct vec3 in = {k == 0 ? first : angles && k == 1 ? -first : 0, 0, 0};
		const struct body_rates *out = &rates.out[RATES_FROM_GYRO];

		rates_step(&rates, in, QUAT_IDENTITY, dt_s);
		sum.omega += out->omega_b_rad_s.x * out->omega_b_rad_s.x;
		sum.alpha += out->alpha_b_rad_s2.x * out->alpha_b_rad_s2.x;
		if (k % DECAY_SAMPLES != DECAY_SAMPLES - 1)
			continue;
		if (sum.omega - before.omega <= DECAYED * sum.omega && sum.alpha - before.alpha <= DECAYED * sum.alpha)
			break;
		before = sum;
	}
	if (!angles)
		sum.omega += bias * bias;
	return sum;
}

/* alpha x r, and omega x (omega x r) = omega (omega . r) - r omega^2, whose derivative by omega is
 * (omega . r) I + omega r^T - 2 r omega^T. */
struct vec3 rigid_lever_arm_variance(struct vec3 omega_b_rad_s, struct vec3 r_b_m, struct rates_variance variance)
{
	const double w[3] = {omega_b_rad_s.x, omega_b_rad_s.y, omega_b_rad_s.z}, r[3] = {r_b_m.x, r_b_m.y, r_b_m.z};
	const double wr = vec3_dot(omega_b_rad_s, r_b_m), rr = vec3_dot(r_b_m, r_b_m);
	double v[3];

	for (int i = 0; i < 3; i++) {
		v[i] = variance.alpha * (rr - r[i] * r[i]);
		for (int j = 0; j < 3; j++) {
			double d = (i == j ? wr : 0) + w[i] * r[j] - 2 * r[i] * w[j];

			v[i] += variance.omega * d * d;
		}
	}
	return (struct vec3){v[0], v[1], v[2]};
}

struct vec3 seed_lever_arm_variance(const struct seed_motion *motion, struct vec3 r_b_m, struct rates_variance variance)
{
	struct vec3 d = motion->rates_rad_s, r = r_b_m;

	return (struct vec3){
		(4 * d.y * d.y * variance.omega + variance.alpha) * r.x * r.x,
		4 * (d.x * d.x + d.z * d.z) * variance.omega * r.y * r.y,
		2 * variance.alpha * r.z * r.z,
	};
}

static double weigh(double *mean_power, double correction, double variance, double share)
{
	double power = correction * correction / variance;
	double slow, at_once = power > AT_ONCE ? 1 - 1 / power : 0;

	if (correction == 0 || variance <= 0)
		return correction;
	*mean_power += share * (fmin(power, LIMIT) - *mean_power);
	slow = *mean_power > 1 + MARGIN ? 1 - 1 / *mean_power : 0;
	return fmax(slow, at_once) * correction;
}

struct vec3 auto_correction_step(struct auto_correction *a, struct vec3 correction, struct vec3 variance, double dt_s)
{
	const double share = fmin(1, dt_s / MEMORY_S);

	return (struct vec3){
		weigh(&a->power[0], correction.x, variance.x, share),
		weigh(&a->power[1], correction.y, variance.y, share),
		weigh(&a->power[2], correction.z, variance.z, share),
	};
}

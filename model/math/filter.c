#include "model/math/filter.h"
#include "model/math/units.h"

#include <errno.h>
#include <string.h>

/* One section by the bilinear transform of an analogue low-pass of unit cut-off, w = tan(pi fc / fs) pre-warped: second
 * order w^2 / (s^2 + d w s + w^2), or first order w / (s + w). Unit gain at DC by construction. */
static void second_order(struct filter3 *f, double w, double damping)
{
	double k = 1 + damping * w + w * w, *a = f->a[f->sections], *b = f->b[f->sections];

	a[0] = 2 * (w * w - 1) / k;
	a[1] = (1 - damping * w + w * w) / k;
	b[0] = w * w / k;
	b[1] = 2 * b[0];
	b[2] = b[0];
	f->sections++;
}

static void first_order(struct filter3 *f, double w)
{
	double *a = f->a[f->sections], *b = f->b[f->sections];

	a[0] = (w - 1) / (w + 1);
	a[1] = 0;
	b[0] = w / (w + 1);
	b[1] = b[0];
	b[2] = 0;
	f->sections++;
}

static void design_butterworth(struct filter3 *f, double rate_hz)
{
	unsigned n = f->config.order;
	double w = tan(PI * f->config.cutoff_hz / rate_hz);

	for (unsigned i = 0; i < n / 2; i++)
		second_order(f, w, 2 * sin(PI * (2 * i + 1) / (2.0 * n)));
	if (n % 2)
		first_order(f, w);
}

/* Chebyshev polynomial of the order of the FIR. */
static double chebyshev(double x)
{
	double n = FILTER_SEED_FIR_ORDER;

	return fabs(x) <= 1 ? cos(n * acos(x)) : cosh(n * acosh(fabs(x)));
}

/* Windowed sinc. The Dolph-Chebyshev window is the inverse transform of the Chebyshev polynomial sampled on the unit
 * circle. Its scale does not matter, since the taps are scaled to unit gain at DC. */
static void design_seed_fir(struct filter3 *f)
{
	const int taps = FILTER_SEED_FIR_ORDER + 1, middle = FILTER_SEED_FIR_ORDER / 2;
	const double attenuation = pow(10, 30.0 / 20), cutoff = 0.6;
	const double x0 = cosh(acosh(attenuation) / FILTER_SEED_FIR_ORDER);
	double sum = 0;

	for (int i = 0; i < taps; i++) {
		double window = 0, x = PI * cutoff * (i - middle);

		for (int k = 0; k < taps; k++)
			window += chebyshev(x0 * cos(PI * k / taps)) * cos(2 * PI * k * (i - middle) / taps);
		f->h[i] = window * (i == middle ? 1 : sin(x) / x);
		sum += f->h[i];
	}
	for (int i = 0; i < taps; i++)
		f->h[i] /= sum;
}

int filter3_init(struct filter3 *f, const struct filter_config *config, double rate_hz)
{
	if (config->type != FILTER_OFF && config->type != FILTER_BUTTERWORTH && config->type != FILTER_SEED_FIR)
		return -EINVAL;
	if (config->order < 1 || config->order > FILTER_ORDER_MAX)
		return -EINVAL;
	if (!(config->cutoff_hz > 0) || !(rate_hz > 0) || !isfinite(rate_hz))
		return -EINVAL;
	memset(f, 0, sizeof(*f));
	f->config = *config;
	if (config->type == FILTER_BUTTERWORTH && config->cutoff_hz < 0.45 * rate_hz)
		design_butterworth(f, rate_hz);
	if (config->type == FILTER_SEED_FIR)
		design_seed_fir(f);
	return 0;
}

void filter3_shift(struct filter3 *f, struct vec3 offset)
{
	for (int i = 0; i < f->sections; i++) {
		f->z[i][0] = vec3_add(f->z[i][0], vec3_scale(1 - f->b[i][0], offset));
		f->z[i][1] = vec3_add(f->z[i][1], vec3_scale(f->b[i][2] - f->a[i][1], offset));
	}
	for (int i = 0; i <= FILTER_SEED_FIR_ORDER; i++)
		f->x[i] = vec3_add(f->x[i], offset);
	f->out = vec3_add(f->out, offset);
}

void filter3_prime(struct filter3 *f, struct vec3 value)
{
	memset(f->z, 0, sizeof(f->z));
	memset(f->x, 0, sizeof(f->x));
	f->out = (struct vec3){0, 0, 0};
	filter3_shift(f, value);
	f->primed = 1;
}

/* One section, transposed direct form II. */
static struct vec3 section_step(const double b[3], const double a[2], struct vec3 z[2], struct vec3 x)
{
	struct vec3 y = vec3_add(vec3_scale(b[0], x), z[0]);

	z[0] = vec3_add(vec3_sub(vec3_scale(b[1], x), vec3_scale(a[0], y)), z[1]);
	z[1] = vec3_sub(vec3_scale(b[2], x), vec3_scale(a[1], y));
	return y;
}

static struct vec3 fir_step(struct filter3 *f, struct vec3 in)
{
	const int taps = FILTER_SEED_FIR_ORDER + 1;
	struct vec3 y = {0, 0, 0};

	f->x[f->next] = in;
	for (int i = 0; i < taps; i++)
		y = vec3_add(y, vec3_scale(f->h[i], f->x[(f->next + taps - i) % taps]));
	f->next = (f->next + 1) % taps;
	return y;
}

struct vec3 filter3_step(struct filter3 *f, struct vec3 in)
{
	if (!f->primed)
		filter3_prime(f, in);
	f->out = f->config.type == FILTER_SEED_FIR ? fir_step(f, in) : in;
	for (int i = 0; i < f->sections; i++)
		f->out = section_step(f->b[i], f->a[i], f->z[i], f->out);
	return f->out;
}

double filter3_delay_s(const struct filter3 *f, double rate_hz)
{
	double samples = 0;

	if (f->config.type == FILTER_SEED_FIR)
		return FILTER_SEED_FIR_ORDER / 2 / rate_hz;
	for (int i = 0; i < f->sections; i++) {
		const double *a = f->a[i], *b = f->b[i];

		samples += (b[1] + 2 * b[2]) / (b[0] + b[1] + b[2]) - (a[0] + 2 * a[1]) / (1 + a[0] + a[1]);
	}
	return samples / rate_hz;
}

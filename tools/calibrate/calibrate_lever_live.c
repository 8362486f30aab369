/* imu9-calibrate lever-arm on the bus: the gateway identifies the lever arm (2060h) while the program says what is
 * missing. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "model/identify/lever_identification.h"
#include "od_values.h"
#include "tools/calibrate/calibrate_lever_arm.h"
#include "tools/calibrate/procedure.h"

enum {
	VERDICT = OD_SUB_LEVER_ARM_IDENTIFICATION_VERDICT,
	PROGRESS = OD_SUB_LEVER_ARM_IDENTIFICATION_PROGRESS,
	DURATION = OD_SUB_LEVER_ARM_IDENTIFICATION_DURATION,
	ARM = OD_SUB_LEVER_ARM_IDENTIFICATION_L,
	SIGMA = OD_SUB_LEVER_ARM_IDENTIFICATION_SIGMA_L,
	RESIDUAL = OD_SUB_LEVER_ARM_IDENTIFICATION_RESIDUAL,
};
enum { START_HELD = 1, START_REFERENCE = 2, ACCEPT = 3, DISCARD = 4 };
/* By judgement: until the gateway has an estimate (10 s), an axis is missing whose rate has less than that share of the
 * largest one; then a component of r whose sigma is that many times the smallest one, and more than that. */
static const double SLOW_SHARE = 0.3, SLOW_RAD_S = 0.3, UNSURE_RATIO = 2, UNSURE_M = 0.002;

/* What was seen of the motion. */
struct guide {
	double square[3]; /* sums of the rates' squares, (rad/s)^2 */
	unsigned count;
};

static bool read_vector(struct procedure *p, uint8_t sub, double v[3])
{
	for (uint8_t i = 0; i < 3; i++) {
		float value;

		if (!procedure_real(p, (uint8_t)(sub + i), &value))
			return false;
		v[i] = (double)value;
	}
	return true;
}

/* A rotation about an axis shows the components of r across it. So what is least certain along l needs more rotation
 * about s and t. */
const char *calibrate_missing_by_sigma(const double sigma_m[3])
{
	static const char *const TURN[] = {"s and t", "l and t", "l and s"};
	int worst = 0, best = 0;

	for (int i = 1; i < 3; i++) {
		worst = sigma_m[i] > sigma_m[worst] ? i : worst;
		best = sigma_m[i] < sigma_m[best] ? i : best;
	}
	return sigma_m[worst] > UNSURE_M && sigma_m[worst] > UNSURE_RATIO * sigma_m[best] ? TURN[worst] : NULL;
}

const char *calibrate_missing_by_rate(const double rate_rad_s[3])
{
	/* a bit for each axis that is missing */
	static const char *const TURN[] = {
		NULL, "l", "s", "l and s", "t", "l and t", "s and t", "all axes, and quicker"};
	double most = fmax(rate_rad_s[0], fmax(rate_rad_s[1], rate_rad_s[2]));
	unsigned missing = 0;

	for (unsigned i = 0; i < 3; i++)
		missing |= (rate_rad_s[i] < SLOW_SHARE * most || most < SLOW_RAD_S ? 1u : 0u) << i;
	return TURN[missing];
}

static bool see_rates(struct procedure *p, struct guide *guide)
{
	for (uint8_t i = 0; i < 3; i++) {
		float rate;

		if (!cli_node_read(&p->node, OD_INDEX_ANGULAR_RATE, (uint8_t)(i + 1), &rate, sizeof rate)) {
			cli_node_explain(
				&p->node, od_find(&imu9_od_table, OD_INDEX_ANGULAR_RATE, (uint8_t)(i + 1), NULL));
			return false;
		}
		guide->square[i] += (double)rate * (double)rate;
	}
	guide->count++;
	return true;
}

static bool show_progress(struct procedure *p, void *ctx)
{
	struct guide *guide = ctx;
	double arm_m[3], sigma_m[3], rms_rad_s[3];
	uint8_t progress;
	char text[200], estimate[100] = "";

	if (!procedure_byte(p, PROGRESS, &progress) || !read_vector(p, ARM, arm_m) || !read_vector(p, SIGMA, sigma_m) ||
		!see_rates(p, guide))
		return false;
	for (int i = 0; i < 3; i++)
		rms_rad_s[i] = sqrt(guide->square[i] / guide->count);
	bool known = sigma_m[0] > 0;
	const char *missing = known ? calibrate_missing_by_sigma(sigma_m) : calibrate_missing_by_rate(rms_rad_s);
	if (known)
		snprintf(estimate, sizeof estimate, "; r = %.1f +- %.1f, %.1f +- %.1f, %.1f +- %.1f mm", 1e3 * arm_m[0],
			1e3 * sigma_m[0], 1e3 * arm_m[1], 1e3 * sigma_m[1], 1e3 * arm_m[2], 1e3 * sigma_m[2]);
	snprintf(text, sizeof text, "%u %%%s; %s%s", progress, estimate,
		missing ? "turn it more about " : "all axes are there, go on", missing ? missing : "");
	procedure_show(text);
	return true;
}

static bool print_result(struct procedure *p)
{
	double arm_m[3], sigma_m[3];
	float residual;

	if (!read_vector(p, ARM, arm_m) || !read_vector(p, SIGMA, sigma_m) || !procedure_real(p, RESIDUAL, &residual))
		return false;
	procedure_result(p, "lever arm   l %9.2f +- %.2f   s %9.2f +- %.2f   t %9.2f +- %.2f mm (1 sigma)\n",
		1e3 * arm_m[0], 1e3 * sigma_m[0], 1e3 * arm_m[1], 1e3 * sigma_m[1], 1e3 * arm_m[2], 1e3 * sigma_m[2]);
	procedure_result(p, "residual    %.3f m/s^2 RMS\n", (double)residual);
	return true;
}

static int run(struct procedure *p, bool reference)
{
	struct guide guide = {0};
	uint8_t state = 0, verdict;
	float duration_s;
	char text[400];

	if (!procedure_real(p, DURATION, &duration_s))
		return CLI_FAILED;
	snprintf(text, sizeof text,
		reference ? "Lever arm: move the robot with quick rotations about all its axes, while another device "
			    "sends the\n"
			    "acceleration of the reference point (2075h). %.0f s, at most %.0f s."
			  : "Lever arm: hold the reference point still and turn the object about it, to and fro, about "
			    "all its\n"
			    "axes l, s and t, about once a second. %.0f s, at most %.0f s.",
		(double)duration_s, 3 * (double)duration_s);
	if (!procedure_begin(p, text) || !procedure_start(p, reference ? START_REFERENCE : START_HELD) ||
		!procedure_watch(p, show_progress, &guide, &state) || !procedure_byte(p, VERDICT, &verdict))
		return CLI_FAILED;
	if (state != PROCEDURE_DONE) {
		cli_error("lever-arm refused: %s", lever_verdict_text((enum lever_verdict)verdict));
		return CLI_FAILED;
	}
	return print_result(p) && procedure_accept(p, ACCEPT, DISCARD) ? CLI_OK : CLI_FAILED;
}

int calibrate_lever_live(const struct lever_request *r)
{
	struct procedure p = {.object = OD_INDEX_LEVER_ARM_IDENTIFICATION,
		.signal_fd = cli_signal_fd(),
		.yes = r->yes,
		.lead = r->lead};

	cli_node_open(&p.node, r->bus, r->node, r->timeout_ms);
	int result = run(&p, r->reference);
	cli_node_close(&p.node);
	close(p.signal_fd);
	return result;
}

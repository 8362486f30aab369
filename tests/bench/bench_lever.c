/* tests/bench/bench_lever.c
 * Time of one sample during the identification of the lever arm, and of the estimate, which is made once per second. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "model/identify/lever_identification.h"

enum { SAMPLES = 200000, ESTIMATES = 200 };

static double now_ns(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec * 1e9 + (double)t.tv_nsec;
}

int main(void)
{
	static struct lever_identification id;
	const struct lever_identification_config config = {
		.rate_hz = 200, .duration_s = 30, .reference = true, .estimate_delay = true};
	double start_ns, steps_ns, worst_ns = 0;

	if (lever_identification_init(&id, &config) < 0)
		return EXIT_FAILURE;
	start_ns = now_ns();
	for (int k = 0; k < SAMPLES; k++) {
		const double t = k / config.rate_hz;
		const struct vec3 gyro = {3 * sin(4 * t), 2 * sin(5 * t), sin(7 * t)},
				  force = {sin(3 * t), cos(2 * t), 9};

		lever_identification_step(&id, (uint64_t)k * 5000, gyro, force, &gyro);
	}
	steps_ns = now_ns() - start_ns;
	start_ns = now_ns();
	for (int i = 0; i < ESTIMATES; i++) {
		const double before_ns = now_ns();

		if (lever_identification_estimate(&id).progress_percent != 100)
			return EXIT_FAILURE;
		worst_ns = fmax(worst_ns, now_ns() - before_ns);
	}
	printf("step %.0f ns, estimate with all blocks full %.1f us (worst %.1f us), %zu bytes\n", steps_ns / SAMPLES,
		(now_ns() - start_ns) * 1e-3 / ESTIMATES, worst_ns * 1e-3, sizeof(id));
	return EXIT_SUCCESS;
}

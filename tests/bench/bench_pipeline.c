/* tests/bench/bench_pipeline.c
 * Time of one pipeline step on a moving robot, for each fusion and lever-arm model: best of several rounds, one core.
 * The robot stands still at the beginning and at the end, so that smoothing has one movement. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "model/pipeline.h"
#include "model/smoother.h"

enum { SAMPLES = 100000, ROUNDS = 5, RATE_HZ = 200, REST_S = 5 };

static struct imu_sample samples[SAMPLES];
static struct smoother smoother;

static void fill(void)
{
	for (int k = 0; k < SAMPLES; k++) {
		double t = (double)k / RATE_HZ, end = (double)SAMPLES / RATE_HZ - REST_S;
		double moves = t > REST_S && t < end;
		struct quat q = quat_from_rotation_vector(
			(struct vec3){moves * sin(t - REST_S), 0.3 * moves * sin(2 * (t - REST_S)), 0});

		samples[k] = (struct imu_sample){
			.t_us = (uint64_t)k * (1000000 / RATE_HZ),
			.gyro_rad_s = {moves * cos(t - REST_S), 0.6 * moves * cos(2 * (t - REST_S)), 0},
			.accel_m_s2 = quat_rotate_inverse(q, (struct vec3){0.3 * moves * sin(3 * t), 0, 9.81}),
			.mag_uT = quat_rotate_inverse(q, (struct vec3){0, 20, -45}),
			.flags = SAMPLE_MAG,
		};
	}
}

static double now_ns(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec * 1e9 + (double)t.tv_nsec;
}

static double ns_a_step(const struct pipeline_config *config, struct smoother *smoothed)
{
	double best = INFINITY;

	for (int round = 0; round < ROUNDS; round++) {
		struct pipeline_output out;
		struct pipeline p;
		double start;

		if (pipeline_init(&p, config, RATE_HZ) < 0)
			return NAN;
		pipeline_smooth(&p, smoothed);
		start = now_ns();
		for (int k = 0; k < SAMPLES; k++)
			pipeline_step(&p, &samples[k], &out);
		best = fmin(best, (now_ns() - start) / SAMPLES);
	}
	return best;
}

static int ascending(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* Median and maximum over the steps of the shortest time of each step in several rounds, which excludes preemption. */
static void print_times(const char *what, const struct pipeline_config *config, struct smoother *smoothed)
{
	static double least[SAMPLES];

	for (int round = 0; round < ROUNDS; round++) {
		struct pipeline_output out;
		struct pipeline p;

		if (pipeline_init(&p, config, RATE_HZ) < 0)
			return;
		pipeline_smooth(&p, smoothed);
		for (int k = 0; k < SAMPLES; k++) {
			double start = now_ns();

			pipeline_step(&p, &samples[k], &out);
			least[k] = fmin(round ? least[k] : INFINITY, now_ns() - start);
		}
	}
	qsort(least, SAMPLES, sizeof(least[0]), ascending);
	printf("pipeline step, position %s: %.0f ns, median %.0f, longest %.0f (clock included)\n", what,
		ns_a_step(config, smoothed), least[SAMPLES / 2], least[SAMPLES - 1]);
}

int main(void)
{
	static const char *const fusions[] = {"madgwick", "mahony", "kalman"};
	static const char *const models[] = {"off", "seed", "rigid"};

	fill();
	for (int fusion = 0; fusion < 3; fusion++)
		for (int model = 0; model < 3; model++) {
			struct pipeline_config config = PIPELINE_DEFAULTS;

			config.fusion.algorithm = (enum fusion_algorithm)fusion;
			config.estimator.model = (enum lever_arm_model)model;
			config.estimator.lever_arm_b_m = (struct vec3){0.05, 0, 0.1};
			printf("pipeline step, %s, lever arm %s: %.0f ns\n", fusions[fusion], models[model],
				ns_a_step(&config, NULL));
		}
	for (int mode = 0; mode < 3; mode++) {
		static const char *const modes[] = {"off", "zero velocity at rest", "navigation"};
		struct pipeline_config config = PIPELINE_DEFAULTS;

		config.position.mode = (enum position_mode)mode;
		print_times(modes[mode], &config, NULL);
	}
	print_times("navigation and its smoothing", &PIPELINE_DEFAULTS, &smoother);
	printf("smoothed: %u movement of %.0f s in %zu points\n", smoother.last.number, smoother.last.duration_s,
		smoother.last.count);
	return 0;
}

/* The whole device for days in simulated time: a robot that rests, and drives once an hour around a square of 2 m, at
 * 100 samples and SYNCs a second, with a master that reads by SDO every second and time from the host. The clock
 * wraps 2^32 ms in the middle.
 *
 * usage: soak_device [DAYS] [SEED]. Prints what was seen; exits 1 when a promise is broken: frames missing or too many,
 * an EMCY, a value that is not finite, memory that grows, errors that their sigmas do not explain. */
#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/log.h"
#include "model/math/quat.h"
#include "model/math/units.h"
#include "tests/scenario/world.h"

enum { HZ = 100, HOUR_S = 3600, TPDOS = 4 };

struct soak {
	struct world world;
	struct signal square;
	uint64_t samples, syncs, reads;
	uint64_t tpdos, heartbeats, emcys, answers, others; /* frames of the device */
	size_t heap;
	unsigned judged, tilt_off, heading_off, position_off; /* judgements at rest; those beyond 3 sigma */
	double worst_position_m, position_sigma_m;
	bool finite;
};

static bool broken;

/* Replaces gateway/log.c. */
void log_at(int severity, const char *format, ...)
{
	(void)severity, (void)format;
}

static void promise(bool kept, const char *what)
{
	printf("%-6s %s\n", kept ? "kept" : "BROKEN", what);
	broken = broken || !kept;
}

static void count_frames(struct soak *s)
{
	struct world *w = &s->world;

	for (size_t i = 0; i < w->frame_count; i++) {
		uint32_t function = w->frames[i].id & 0x780;

		assert_int_equal(w->frames[i].id & 0x7F, WORLD_NODE_ID);
		s->tpdos += function == 0x180 || function == 0x280 || function == 0x380 || function == 0x480;
		s->heartbeats += function == 0x700;
		s->emcys += function == 0x080;
		s->answers += function == 0x580;
	}
	w->frame_count = 0;
}

static struct signal_truth motion_at(const struct soak *s, double t_s)
{
	double in_hour_s = fmod(t_s, HOUR_S);
	struct signal_truth truth;

	signal_at(&s->square, in_hour_s < s->square.period_s ? in_hour_s : 0, &truth);
	return truth;
}

static void one_sample(struct soak *s, uint64_t start_us)
{
	double t_s = sensor_instant_s(&s->world.sensor);
	struct signal_truth truth = motion_at(s, t_s);
	struct imu_sample sample;

	sensor_measure(&s->world.sensor, &truth, &sample);
	sample.t_us += start_us;
	world_deliver(&s->world, &sample);
	world_receive(&s->world, 0x080, 0, NULL);
	s->samples++;
	s->syncs++;
}

/* Errors in units of sigma at the end of an hour, half of which the robot has rested at the origin. */
static void judge(struct soak *s)
{
	const struct od_values *v = &s->world.device.values;
	struct signal_truth truth = motion_at(s, (double)s->samples / HZ);
	struct quat q = {
		(double)v->quaternion.w, (double)v->quaternion.x, (double)v->quaternion.y, (double)v->quaternion.z};
	struct vec3 error_rad = quat_to_rotation_vector(quat_multiply(q, quat_conjugate(truth.q_nb)));
	double tilt_rad = hypot(error_rad.x, error_rad.y), heading_rad = fabs(error_rad.z);
	double tilt_sigma = hypot((double)v->attitude_sigma.x, (double)v->attitude_sigma.y) * RAD_PER_DEG;
	struct vec3 off = {(double)v->position_m.x - truth.position_n_m.x,
		(double)v->position_m.y - truth.position_n_m.y, (double)v->position_m.z - truth.position_n_m.z};
	double off_m = vec3_norm(off), sigma_m = vec3_norm((struct vec3){(double)v->position_sigma.x,
					       (double)v->position_sigma.y, (double)v->position_sigma.z});

	s->finite = s->finite && isfinite(tilt_rad + heading_rad + off_m + tilt_sigma + sigma_m);
	s->judged++;
	s->tilt_off += tilt_rad > 3 * tilt_sigma;
	s->heading_off += heading_rad > 3 * (double)v->attitude_sigma.z * RAD_PER_DEG;
	s->position_off += off_m > 3 * sigma_m;
	s->worst_position_m = fmax(s->worst_position_m, off_m);
	s->position_sigma_m = sigma_m;
}

static void one_hour(struct soak *s, uint64_t start_us)
{
	for (int second = 0; second < HOUR_S; second++) {
		for (int i = 0; i < HZ; i++)
			one_sample(s, start_us);
		world_receive(&s->world, 0x600 + WORLD_NODE_ID, 8, (const uint8_t[8]){0x40, 0x01, 0x10, 0});
		device_host_clock(&s->world.device, true, INT64_C(1795953600000000));
		s->reads++;
		count_frames(s);
	}
	judge(s);
	if (s->heap == 0)
		s->heap = mallinfo2().uordblks;
}

static void start(struct soak *s, uint64_t start_us, uint64_t seed)
{
	struct sensor_config sensor = *sensor_preset("lsm303dlhc_l3gd20");

	sensor_calibrate(&sensor);
	world_init(&s->world, &sensor, seed, "square");
	s->square = *signal_find("square");
	s->world.now_us = start_us;
	s->finite = true;
	world_power_on(&s->world, (const char *const[]){"producer_heartbeat_time=1000", NULL});
	world_nmt(&s->world, 1);
	s->world.frame_count = 0;
}

static void report(const struct soak *s)
{
	uint64_t seconds = s->samples / HZ;

	printf("%.1f days: %llu samples, %llu PDOs, %llu heartbeats, %llu SDO answers; position off by up to %.2f m "
	       "(sigma at the end %.2f m); beyond 3 sigma of %u hours: tilt %u, heading %u, position %u\n",
		(double)seconds / 86400, (unsigned long long)s->samples, (unsigned long long)s->tpdos,
		(unsigned long long)s->heartbeats, (unsigned long long)s->answers, s->worst_position_m,
		s->position_sigma_m, s->judged, s->tilt_off, s->heading_off, s->position_off);
	promise(s->tpdos == TPDOS * s->syncs, "each SYNC is answered by each PDO, once");
	promise(s->heartbeats + 1 >= seconds && s->heartbeats <= seconds + 1, "a heartbeat every second");
	promise(s->answers == s->reads, "each SDO request is answered");
	promise(s->emcys == 0, "no EMCY");
	promise(s->finite, "all values are finite");
	promise(mallinfo2().uordblks == s->heap, "no memory is allocated after the first hour");
	promise(s->tilt_off * 50 <= s->judged && s->heading_off * 50 <= s->judged && s->position_off * 50 <= s->judged,
		"at most 2 % of the errors are beyond 3 sigma");
	promise(s->position_sigma_m < 100, "the position is not given up: each standstill was seen");
}

int main(int argc, char **argv)
{
	double days = argc > 1 ? atof(argv[1]) : 7;
	uint64_t seed = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
	int hours = (int)ceil(days * 24);
	uint64_t wrap_us = (UINT64_C(1) << 32) * 1000;
	uint64_t start_us = wrap_us - (uint64_t)hours * HOUR_S * 1000000 / 2;
	static struct soak soak;

	printf("%d hours in simulated time, seed %llu\n", hours, (unsigned long long)seed);
	start(&soak, start_us, seed);
	for (int hour = 0; hour < hours; hour++)
		one_hour(&soak, start_us);
	report(&soak);
	return broken;
}

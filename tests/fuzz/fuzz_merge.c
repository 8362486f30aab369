/* Readings of three chips at arbitrary times: samples are finite, their times increase, and none is invented. */
#include <math.h>

#include "drivers/imu/merge.h"
#include "tests/fuzz/fuzz.h"

#define START_NS 1000000000000

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	static struct merge merge;
	unsigned gyros = 0, samples = 0;
	uint64_t last_us = 0;
	int64_t t_ns[4] = {0, START_NS, START_NS, START_NS};

	merge_init(&merge, (int64_t)read_byte(&in) * 10000);
	while (in.size > 0) {
		uint8_t kind = read_byte(&in);
		unsigned chip = 1 + kind % 3;
		struct imu_sample sample;
		struct merge_reading reading = {.value = {kind, (int8_t)read_byte(&in), 1}, .saturated = kind & 0x80};

		t_ns[chip] += (int64_t)((uint64_t)read_byte(&in) << (kind >> 3 & 15)) * 1000 - 100000;
		reading.t_ns = t_ns[chip];
		merge_add(&merge, (enum imu_chip)chip, &reading);
		gyros += chip == IMU_CHIP_GYRO;
		while (merge_next(&merge, &sample)) {
			require(samples == 0 || sample.t_us > last_us);
			require(vec3_finite(sample.gyro_rad_s) && vec3_finite(sample.accel_m_s2));
			require(!(sample.flags & SAMPLE_MAG) || vec3_finite(sample.mag_uT));
			last_us = sample.t_us;
			samples++;
		}
		require(samples + merge.lost <= gyros);
	}
	return 0;
}

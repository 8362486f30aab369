/* Arbitrary bytes as a log, of the format that the last one chooses: no crash, and all samples are finite with
 * increasing times. */
#include <assert.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

#include "drivers/imu/imu_log.h"

enum { FORMATS = 5 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static int fd = -1;
	struct imu_sample sample;
	const struct log_format *format;
	uint64_t last_us = 0;
	static struct imu_log log;
	char path[32], error[256], text[64];

	if (fd < 0)
		fd = memfd_create("log", 0);
	format = log_format_at(size ? data[size - 1] % FORMATS : 0);
	if (ftruncate(fd, 0) < 0 || pwrite(fd, data, size, 0) != (ssize_t)size)
		return 0;
	snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
	if (imu_log_open(&log, path, format, error, sizeof error) < 0)
		return 0;
	assert(log.rate_hz > 0);
	for (int n = 0; imu_log_next(&log, &sample) == 1; n++) {
		assert(n == 0 || sample.t_us > last_us);
		assert(vec3_finite(sample.gyro_rad_s) && vec3_finite(sample.accel_m_s2) && vec3_finite(sample.mag_uT));
		assert(vec3_finite(sample.ref_accel_b_m_s2) && isfinite(sample.temperature_degC));
		last_us = sample.t_us;
	}
	for (int i = 0; imu_log_message(&log, i, text, sizeof text); i++)
		assert(*text);
	imu_log_close(&log);
	return 0;
}

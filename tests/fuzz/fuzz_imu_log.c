/* Arbitrary bytes as a log, of the format that the last one chooses: no crash, and all samples are finite with
 * increasing times. */
#include "drivers/imu/imu_log.h"
#include "tests/fuzz/fuzz.h"

enum { FORMATS = 5 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct imu_sample sample;
	const struct log_format *format;
	uint64_t last_us = 0;
	static struct imu_log log;
	char error[256], text[64];

	format = log_format_at(size ? data[size - 1] % FORMATS : 0);
	if (imu_log_open(&log, fuzz_file(data, size), format, error, sizeof error) < 0)
		return 0;
	require(log.rate_hz > 0);
	for (int n = 0; imu_log_next(&log, &sample) == 1; n++) {
		require(n == 0 || sample.t_us > last_us);
		require(vec3_finite(sample.gyro_rad_s) && vec3_finite(sample.accel_m_s2) && vec3_finite(sample.mag_uT));
		require(vec3_finite(sample.ref_accel_b_m_s2) && isfinite(sample.temperature_degC));
		last_us = sample.t_us;
	}
	for (int i = 0; imu_log_message(&log, i, text, sizeof text); i++)
		require(*text);
	imu_log_close(&log);
	return 0;
}

/* Arbitrary bytes as a log of reference motion: an error that starts with the file's name, or rows that are finite at
 * any time. */
#include <math.h>
#include <string.h>

#include "tests/fuzz/fuzz.h"
#include "tools/lib/reference_log.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static const uint64_t times_us[] = {0, 10000, 20000, 1000000, 30000, UINT64_MAX, 5000000000};
	const char *path = fuzz_file(data, size);
	struct reference_log log = {0};
	char error[256] = "";
	struct vec3 accel_m_s2;

	if (reference_log_load(&log, path, error, sizeof(error)) != 0)
		require(strncmp(error, path, strlen(path)) == 0);
	else
		for (size_t i = 0; i < sizeof(times_us) / sizeof(times_us[0]); i++)
			if (reference_log_at(&log, times_us[i], &accel_m_s2))
				require(vec3_finite(accel_m_s2));
	reference_log_close(&log);
	return 0;
}

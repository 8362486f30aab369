#include "drivers/imu/iio_text.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int iio_parse_mount_matrix(const char *text, struct vec3 rows[3])
{
	struct vec3 r[3];
	int end = 0;

	/* cppcheck-suppress invalidScanfArgType_float ; it takes &r[0].x for a double */
	if (sscanf(text, "%lf , %lf , %lf ; %lf , %lf , %lf ; %lf , %lf , %lf %n", &r[0].x, &r[0].y, &r[0].z, &r[1].x,
		    &r[1].y, &r[1].z, &r[2].x, &r[2].y, &r[2].z, &end) != 9 ||
		text[end] != '\0')
		return -EINVAL;
	double handed = vec3_dot(vec3_cross(r[0], r[1]), r[2]) < 0 ? -1 : 1;

	for (int i = 0; i < 3; i++) {
		struct vec3 cross = vec3_scale(handed, vec3_cross(r[i], r[(i + 1) % 3]));

		if (!(fabs(vec3_norm(r[i]) - 1) < 0.01 && vec3_norm(vec3_sub(cross, r[(i + 2) % 3])) < 0.01))
			return -EINVAL;
	}
	memcpy(rows, r, sizeof r);
	return handed < 0;
}

static int choose_of_range(const char *text, double wanted, char *token, size_t size)
{
	double first, step, last, value;

	if (sscanf(text, "[%lf %lf %lf]", &first, &step, &last) != 3 || !(step > 0) || !(last >= first))
		return -EINVAL;
	value = first + step * ceil((fmax(wanted, first) - first) / step - 1e-9);
	snprintf(token, size, "%.9g", fmin(value, last));
	return value > last * (1 + 1e-9) ? -ERANGE : 0;
}

int iio_choose(const char *available, double wanted, char *token, size_t size)
{
	double best = 0, largest = -INFINITY;
	char best_token[32] = "", largest_token[32] = "", word[32];
	int n;

	if (available[0] == '[')
		return choose_of_range(available, wanted, token, size);
	for (; sscanf(available, "%31s%n", word, &n) == 1; available += n) {
		char *end;
		double value = strtod(word, &end);

		if (*end != '\0' || !isfinite(value))
			return -EINVAL;
		if (value > largest) {
			largest = value;
			strcpy(largest_token, word);
		}
		if (value >= wanted && (best_token[0] == '\0' || value < best)) {
			best = value;
			strcpy(best_token, word);
		}
	}
	if (largest_token[0] == '\0')
		return -EINVAL;
	snprintf(token, size, "%s", best_token[0] ? best_token : largest_token);
	return best_token[0] ? 0 : -ERANGE;
}

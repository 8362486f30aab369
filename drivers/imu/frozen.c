#include "drivers/imu/frozen.h"

#include <string.h>

bool frozen_watch(struct frozen *f, const void *raw, size_t size)
{
	if (f->same == 0 || memcmp(f->last, raw, size) != 0) {
		if (f->same > f->longest)
			f->longest = f->same;
		memcpy(f->last, raw, size);
		f->same = 0;
	}
	f->same++;
	return f->same >= FROZEN_AT_LEAST && f->same >= FROZEN_TIMES * f->longest;
}

/* Replays an IMU log in real time. The whole file is read into memory first, so that reading cannot delay a sample. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/imu_log.h"
#include "drivers/imu/pace.h"
#include "drivers/imu/source.h"

struct replay {
	struct imu_port port;
	struct pace pace;
	struct imu_sample *samples;
	size_t count, next;
	int loop;
	double speed;
	uint64_t interval_us, pass_us; /* sampling interval; duration of one pass */
	uint64_t shift_us;	       /* added to the times of this pass */
};

static int replay_read(struct imu_port *port, struct imu_sample *sample)
{
	struct replay *r = (struct replay *)port;
	uint64_t elapsed_us;
	int64_t late_ns;
	int again = 0;

	if (r->next == r->count) {
		if (!r->loop)
			return -ENODATA;
		again = 1;
	}
	elapsed_us = again ? r->pass_us : r->samples[r->next].t_us - r->samples[0].t_us;
	late_ns = pace_since(&r->pace, (int64_t)((double)(r->shift_us + elapsed_us) * 1e3 / r->speed));
	if (late_ns < 0)
		return 0;
	if (again) {
		r->next = 0;
		r->shift_us += r->pass_us;
	}
	*sample = r->samples[r->next++];
	sample->t_us += r->shift_us;
	if (again)
		sample->flags |= SAMPLE_DISCONTINUITY;
	port->counters.samples++;
	if ((double)late_ns > (double)r->interval_us * 1e3 / r->speed)
		port->counters.late++;
	return 1;
}

static void replay_close(struct imu_port *port)
{
	struct replay *r = (struct replay *)port;

	pace_stop(&r->pace);
	free(r->samples);
	free(r);
}

static const struct imu_ops REPLAY_OPS = {.read = replay_read, .close = replay_close};

static int parse_options(struct replay *r, char *options, char *error, size_t error_size)
{
	char *rest = options, *option;

	while ((option = strsep(&rest, ","))) {
		if (strcmp(option, "loop") == 0) {
			r->loop = 1;
		} else if (strncmp(option, "speed=", 6) != 0) {
			snprintf(error, error_size, "replay: unknown option '%.40s': use loop, speed=X", option);
			return -EINVAL;
		} else if (source_positive(option + 6, &r->speed) < 0 || r->speed < 1e-3 || r->speed > 1e6) {
			snprintf(error, error_size, "replay: '%.40s': use a factor from 0.001 to 1e6", option);
			return -EINVAL;
		}
	}
	return 0;
}

static int load(struct replay *r, struct imu_log *log)
{
	size_t room = 0;
	int got;

	for (;; r->count++) {
		if (r->count == room) {
			struct imu_sample *more;

			room = room ? 2 * room : 4096;
			more = realloc(r->samples, room * sizeof *more);
			if (!more)
				return -ENOMEM;
			r->samples = more;
		}
		got = imu_log_next(log, &r->samples[r->count]);
		if (got <= 0)
			return got;
	}
}

/* What there is to say about the log, a line each; the skipped rows are told by their counter. */
static void tell(struct replay *r, const struct imu_log *log)
{
	size_t n = 0, room = sizeof r->port.notes;
	char text[256];

	for (int i = 0; n < room && imu_log_message(log, i, text, sizeof text); i++)
		n += (size_t)snprintf(r->port.notes + n, room - n, "%s%s", n ? "\n" : "", text);
}

static int load_file(struct replay *r, const char *path, char *error, size_t error_size)
{
	const char *slash = strrchr(path, '/');
	struct imu_log *log = malloc(sizeof *log);
	int result = log ? imu_log_open(log, path, log_format_at(0), error, error_size) : -ENOMEM;

	if (result < 0) {
		free(log);
		return result;
	}
	result = load(r, log);
	if (result < 0)
		snprintf(error, error_size, "%s:%ld: %s", path, log->rows.table[0].line, strerror(-result));
	imu_log_close(log);
	r->port.rate_hz = log->rate_hz;
	r->port.uncalibrated = (uint8_t)imu_log_uncalibrated(log);
	r->port.silence_us = source_silence_us(log->rate_hz * r->speed);
	r->port.counters.skipped = log->rows.events.skipped;
	memcpy(r->port.last_skip, log->rows.events.last_skip, sizeof r->port.last_skip);
	tell(r, log);
	snprintf(r->port.name, sizeof r->port.name, "replay:%.50s", slash ? slash + 1 : path);
	r->interval_us = (uint64_t)(1e6 / log->rate_hz + 0.5);
	free(log);
	return result;
}

int replay_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	char *options = args, *path = strsep(&options, ",");
	struct replay *r;
	int result;

	(void)settings;
	if (!path || *path == '\0') {
		snprintf(error, error_size, "replay: no file: use " REPLAY_SYNTAX);
		return -EINVAL;
	}
	r = calloc(1, sizeof *r);
	if (!r)
		return -ENOMEM;
	r->port.ops = &REPLAY_OPS;
	r->speed = 1;
	result = parse_options(r, options, error, error_size);
	if (result == 0)
		result = load_file(r, path, error, error_size);
	if (result == 0) {
		r->pass_us = r->samples[r->count - 1].t_us - r->samples[0].t_us + r->interval_us;
		result = pace_start(&r->pace);
	}
	if (result < 0) {
		free(r->samples);
		free(r);
		return result;
	}
	r->port.fd = r->pace.fd;
	*port = &r->port;
	return 0;
}

#include "gateway/record_file.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <gnu/libc-version.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "gateway/device.h"
#include "gateway/device_state.h"
#include "od_values.h"

enum { SIZE_MB = 16, SIZE_MB_MAX = 2000, FILES = 8, KEEP_US = 60000000, TURN_NS = 100000000, TURNS_OF_SYNC = 50 };

/* ---- options ----------------------------------------------------------------------------------------------------- */

static bool number_option(const char *option, const char *key, unsigned low, unsigned high, unsigned *value)
{
	size_t length = strlen(key);
	char *end;

	if (strncmp(option, key, length) != 0 || option[length] < '0' || option[length] > '9')
		return false;
	unsigned long n = strtoul(option + length, &end, 10);
	if (*end != '\0' || n < low || n > high)
		return false;
	*value = (unsigned)n;
	return true;
}

int record_options(const char *text, struct record_options *o, char *why, size_t why_size)
{
	char copy[2 * RECORD_FOLDER_MAX], *rest = copy, *option;

	*o = (struct record_options){.size_mb = SIZE_MB, .files = FILES};
	snprintf(copy, sizeof(copy), "%s", text);
	option = strsep(&rest, ",");
	if (*option == '\0' || strlen(option) >= sizeof(o->folder)) {
		snprintf(why, why_size, "record: no folder: use DIR[,size=MB][,files=N]");
		return -EINVAL;
	}
	strcpy(o->folder, option);
	while ((option = strsep(&rest, ",")) != NULL) {
		if (number_option(option, "size=", 1, SIZE_MB_MAX, &o->size_mb) ||
			number_option(option, "files=", 2, RECORD_FILES_MAX, &o->files))
			continue;
		snprintf(why, why_size, "record: '%.40s': use size=1 to %d (MB of a file), files=2 to %d", option,
			SIZE_MB_MAX, RECORD_FILES_MAX);
		return -EINVAL;
	}
	return 0;
}

/* ---- names ------------------------------------------------------------------------------------------------------- */

static void name_of(const struct record_name *n, char *name, size_t size)
{
	snprintf(name, size, "imu9-%06u%s.imu.csv", n->number, n->kept ? ".kept" : "");
}

static bool parse_name(const char *name, struct record_name *n)
{
	char same[64];

	*n = (struct record_name){0};
	if (sscanf(name, "imu9-%u", &n->number) != 1)
		return false;
	n->kept = strstr(name, ".kept.") != NULL;
	name_of(n, same, sizeof(same));
	return strcmp(name, same) == 0;
}

static int by_number(const void *a, const void *b)
{
	unsigned x = ((const struct record_name *)a)->number, y = ((const struct record_name *)b)->number;

	return (x > y) - (x < y);
}

static int find_files(struct record_file *f)
{
	DIR *folder = opendir(f->options.folder);
	const struct dirent *entry;
	struct record_name name;
	int rc = 0;

	if (!folder)
		return -errno;
	while (rc == 0 && (entry = readdir(folder)) != NULL) {
		if (!parse_name(entry->d_name, &name))
			continue;
		if (f->count == sizeof(f->names) / sizeof(f->names[0]) - 1)
			rc = -E2BIG;
		else
			f->names[f->count++] = name;
	}
	closedir(folder);
	qsort(f->names, f->count, sizeof(f->names[0]), by_number);
	return rc;
}

/* Deletes the oldest of this kind, so that at most `most` are left. */
static void limit(struct record_file *f, bool kept, unsigned most)
{
	char name[64];
	unsigned left = 0;

	for (size_t i = 0; i < f->count; i++)
		left += f->names[i].kept == kept;
	for (size_t i = 0; i < f->count && left > most;) {
		if (f->names[i].kept != kept) {
			i++;
			continue;
		}
		name_of(&f->names[i], name, sizeof(name));
		unlinkat(f->folder_fd, name, 0);
		memmove(&f->names[i], &f->names[i + 1], (--f->count - i) * sizeof(f->names[0]));
		left--;
	}
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

static void end_file(struct record_file *f)
{
	if (f->fd >= 0) {
		fdatasync(f->fd);
		close(f->fd);
	}
	f->fd = -1;
	f->used = 0;
}

static void fail(struct record_file *f, int error)
{
	end_file(f);
	atomic_store(&f->record->error, error);
}

static void flush(struct record_file *f)
{
	for (size_t done = 0; f->fd >= 0 && done < f->used;) {
		ssize_t n = write(f->fd, f->buffer + done, f->used - done);

		if (n > 0)
			done += (size_t)n;
		else if (n == 0 || errno != EINTR)
			fail(f, n == 0 ? ENOSPC : errno);
	}
	f->written += f->used;
	f->used = 0;
	if (f->fd >= 0 && f->written >= f->options.size_mb * (size_t)1000000)
		atomic_store(&f->record->full, true);
}

/* Room for a line of RECORD_ROW_MAX. */
static char *line(struct record_file *f)
{
	if (f->used + RECORD_ROW_MAX > sizeof(f->buffer))
		flush(f);
	return f->buffer + f->used;
}

__attribute__((format(printf, 2, 3))) static void add(struct record_file *f, const char *format, ...)
{
	va_list args;
	char *out = line(f);

	va_start(args, format);
	int n = vsnprintf(out, RECORD_ROW_MAX, format, args);
	va_end(args);
	f->used += n < RECORD_ROW_MAX ? (size_t)n : RECORD_ROW_MAX - 1;
}

/* ---- the head of a file ------------------------------------------------------------------------------------------ */

/* The configuration objects that differ from their defaults. */
static void add_configuration(struct record_file *f, const struct device *saved)
{
	uint8_t wire[OD_VALUE_MAX], usual[OD_VALUE_MAX];
	char text[3 * OD_VALUE_MAX];
	struct od_values defaults;
	struct od base, od = {.table = &imu9_od_table, .values = (void *)&saved->values};

	od_init(&base, &imu9_od_table, &defaults, saved->canopen.id);
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = &imu9_od_table.entries[i];
		size_t size = e->access & OD_STORED ? od_get(&od, e, wire, sizeof(wire)) : 0;

		if (size > 0 && (od_get(&base, e, usual, sizeof(usual)) != size || memcmp(wire, usual, size) != 0) &&
			od_format(e, wire, size, text, sizeof(text)) >= 0)
			add(f, "# config %s = %s\n", e->name, text);
	}
}

static void add_state(struct record_file *f)
{
	enum { CHUNK = 96 };
	static const uint8_t zeros[CHUNK];
	const uint8_t *state = f->record->state;
	char text[4 * CHUNK / 3 + 4];

	for (size_t at = 0; at < sizeof(struct device); at += CHUNK) {
		size_t size = sizeof(struct device) - at < CHUNK ? sizeof(struct device) - at : CHUNK;

		if (memcmp(state + at, zeros, size) == 0)
			continue;
		record_base64(state + at, size, text);
		add(f, "# state %zu %s\n", at, text);
	}
	add(f, "# state-end %zu %08X\n", sizeof(struct device), od_crc32(0, state, sizeof(struct device)));
}

static void add_head(struct record_file *f)
{
	const struct device *saved = (const void *)f->record->state;
	const struct imu_port *imu = f->record->device->imu;
	bool self_test = imu->ops && imu->ops->self_test;
	unsigned u = imu->uncalibrated;
	char utc[32] = "";
	time_t now = time(NULL);
	struct tm tm;

	if (gmtime_r(&now, &tm))
		strftime(utc, sizeof(utc), "%Y-%m-%dT%H:%M:%SZ", &tm);
	add(f, "# imu9-recording 1 %s\n", device_state_build());
	add(f, "# of imu9-gateway " IMU9_VERSION ", glibc %s, at %s\n", gnu_get_libc_version(), utc);
	add(f, "# device %u %u %u %u\n", saved->canopen.id, saved->canopen.nmt.state, u, self_test);
	add(f, "# sensor %s\n", imu->name);
	add(f, "# can %s\n", f->record->device->bus->name);
	if (u)
		add(f, "# uncalibrated:%s%s%s\n", u & 1 ? " gyro" : "", u & 2 ? " accelerometer" : "",
			u & 4 ? " magnetometer" : "");
	add_configuration(f, saved);
	add_state(f);
	add(f, "%s\n", RECORD_COLUMNS);
}

static void begin_file(struct record_file *f, uint64_t now_us)
{
	struct record_name next = {.number = f->count ? f->names[f->count - 1].number + 1 : 1, .ours = true};
	char name[64];

	end_file(f);
	limit(f, false, f->options.files - 1);
	next.began_us = now_us;
	name_of(&next, name, sizeof(name));
	f->fd = openat(f->folder_fd, name, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
	if (f->fd < 0) {
		fail(f, errno);
	} else {
		f->names[f->count++] = next;
		f->written = 0;
		add_head(f);
	}
	atomic_store(&f->record->full, false);
	atomic_store(&f->record->state_in_use, false);
}

/* Files of this process that have something of the last minute. */
static void keep(struct record_file *f, uint64_t now_us)
{
	for (size_t i = f->count; i-- > 0 && f->names[i].ours;) {
		struct record_name *n = &f->names[i];
		char name[64], kept[64];

		name_of(n, name, sizeof(name));
		if (!n->kept) {
			n->kept = true;
			name_of(n, kept, sizeof(kept));
			renameat(f->folder_fd, name, f->folder_fd, kept);
			atomic_fetch_add(&f->record->kept, 1);
		}
		if (n->began_us + KEEP_US <= now_us)
			break;
	}
	limit(f, true, f->options.files);
}

/* ---- turns ------------------------------------------------------------------------------------------------------- */

static void take(struct record_file *f, const struct record_entry *e)
{
	switch (e->kind) {
	case RECORD_CUT:
		flush(f);
		begin_file(f, e->now_us);
		break;
	case RECORD_STOP:
		flush(f);
		end_file(f);
		break;
	case RECORD_KEEP:
		if (f->fd >= 0)
			keep(f, e->now_us);
		break;
	default:
		if (f->fd >= 0)
			f->used += record_text(e, line(f));
	}
}

void record_file_turn(struct record_file *f)
{
	const struct record_entry *e;

	while ((e = record_next(f->record)) != NULL) {
		take(f, e);
		record_taken(f->record);
	}
	flush(f);
}

static void *thread_main(void *arg)
{
	struct record_file *f = arg;
	const struct timespec turn = {.tv_nsec = TURN_NS};

	for (unsigned turns = 0; !atomic_load(&f->quit); turns++) {
		record_file_turn(f);
		if (turns % TURNS_OF_SYNC == 0 && f->fd >= 0)
			fdatasync(f->fd);
		nanosleep(&turn, NULL);
	}
	return NULL;
}

int record_file_init(struct record_file *f, struct record *record, const struct record_options *options)
{
	int rc = 0;

	memset(f, 0, sizeof(*f));
	f->record = record;
	f->options = *options;
	f->fd = -1;
	if (mkdir(options->folder, 0755) < 0 && errno != EEXIST)
		return -errno;
	f->folder_fd = open(options->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
	if (f->folder_fd < 0)
		return -errno;
	if (flock(f->folder_fd, LOCK_EX | LOCK_NB) < 0)
		rc = errno == EWOULDBLOCK ? -EADDRINUSE : -errno;
	if (rc == 0)
		rc = find_files(f);
	if (rc < 0) {
		close(f->folder_fd);
		return rc;
	}
	limit(f, true, options->files); /* the others with each file that begins */
	return 0;
}

int record_file_open(struct record_file *f, struct record *record, const struct record_options *options)
{
	int rc = record_file_init(f, record, options);

	if (rc == 0 && (rc = -pthread_create(&f->thread, NULL, thread_main, f)) < 0)
		close(f->folder_fd);
	return rc;
}

void record_file_close(struct record_file *f)
{
	atomic_store(&f->quit, true);
	if (f->thread)
		pthread_join(f->thread, NULL);
	record_file_turn(f);
	end_file(f);
	close(f->folder_fd);
}

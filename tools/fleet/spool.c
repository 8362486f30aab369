#include "tools/fleet/spool.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

#include "od/little_endian.h"
#include "od/od.h"

/* segment: "IMU9SPL1", number u64, CRC u32; then records: size u32, CRC u32, bytes.
 * acknowledgements: two of turn u64, segment u64, offset u32, CRC u32. */
enum { HEADER = 20, RECORD_HEAD = 8, ACK_SIZE = 24, SMALLEST_SEGMENT = 4096 };
static const char MAGIC[8] = "IMU9SPL1";

static struct spool_segment *segment_of(struct spool *spool, uint64_t number)
{
	struct spool_segment *segment = &spool->segments[number % SPOOL_SEGMENTS];

	return number > 0 && segment->number == number ? segment : NULL;
}

static const char *segment_path(const struct spool *spool, uint64_t number, char path[SPOOL_PATH_MAX + 32])
{
	snprintf(path, SPOOL_PATH_MAX + 32, "%s/spool-%02u.seg", spool->folder, (unsigned)(number % SPOOL_SEGMENTS));
	return path;
}

static int failed(struct spool *spool)
{
	int error = errno ? errno : EIO;

	spool->errors++;
	return -error;
}

static int write_all(int fd, const void *bytes, size_t size)
{
	const uint8_t *from = bytes;

	while (size > 0) {
		ssize_t n = write(fd, from, size);

		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			return -1;
		from += n;
		size -= (size_t)n;
	}
	return 0;
}

/* Bytes read: less than `size` at the end of the file, or after an error. */
static size_t read_at(int fd, void *bytes, size_t size, uint32_t offset)
{
	size_t done = 0;

	while (done < size) {
		ssize_t n = pread(fd, (uint8_t *)bytes + done, size - done, (off_t)(offset + done));

		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			break;
		done += (size_t)n;
	}
	return done;
}

static void make_header(uint64_t number, uint8_t header[HEADER])
{
	memcpy(header, MAGIC, sizeof(MAGIC));
	put_uint(header + 8, number, 8);
	put_u32(header + 16, od_crc32(0, header, 16));
}

static uint32_t record_crc(uint64_t number, uint32_t offset, const uint8_t *bytes, uint32_t size)
{
	uint8_t place[16];

	put_uint(place, number, 8);
	put_u32(place + 8, offset);
	put_u32(place + 12, size);
	return od_crc32(od_crc32(0, place, sizeof(place)), bytes, size);
}

/* The record at this offset. 1; 0: there is none, or it is damaged. */
static int read_record(int fd, uint64_t number, uint32_t offset, uint8_t *bytes, size_t capacity, uint32_t *size)
{
	uint8_t head[RECORD_HEAD];

	if (read_at(fd, head, sizeof(head), offset) != sizeof(head))
		return 0;
	*size = get_u32(head);
	if (*size == 0 || *size > capacity || read_at(fd, bytes, *size, offset + RECORD_HEAD) != *size)
		return 0;
	return record_crc(number, offset, bytes, *size) == get_u32(head + 4);
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void read_acks(struct spool *spool)
{
	uint8_t bytes[ACK_SIZE];

	for (uint32_t i = 0; i < 2; i++) {
		if (read_at(spool->ack_fd, bytes, sizeof(bytes), i * ACK_SIZE) != sizeof(bytes) ||
			od_crc32(0, bytes, ACK_SIZE - 4) != get_u32(bytes + ACK_SIZE - 4) ||
			get_uint(bytes, 8) <= spool->ack_turn)
			continue;
		spool->ack_turn = get_uint(bytes, 8);
		spool->acked = (struct spool_position){get_uint(bytes + 8, 8), get_u32(bytes + 16)};
	}
	spool->acked_on_disk = spool->acked;
}

static bool is_behind(struct spool_position a, struct spool_position b)
{
	return a.segment > b.segment || (a.segment == b.segment && a.offset > b.offset);
}

/* What is valid in a file: its number, size and records; the number remains 0 if it is no segment. */
static void scan(struct spool *spool, struct spool_segment *segment, int fd, uint64_t slot)
{
	uint8_t header[HEADER], expected[HEADER], bytes[SPOOL_RECORD_MAX];
	uint32_t size;

	if (read_at(fd, header, sizeof(header), 0) != sizeof(header))
		return;
	uint64_t number = get_uint(header + 8, 8);
	make_header(number, expected);
	if (memcmp(header, expected, sizeof(header)) != 0 || number == 0 || number % SPOOL_SEGMENTS != slot)
		return;
	*segment = (struct spool_segment){.number = number, .size = HEADER};
	while (segment->size < spool->segment_size &&
		read_record(fd, number, segment->size, bytes, sizeof(bytes), &size)) {
		segment->size += RECORD_HEAD + size;
		segment->records++;
		if (!is_behind((struct spool_position){number, segment->size}, spool->acked))
			segment->acked++;
	}
	segment->read = segment->acked;
	if (read_at(fd, bytes, 1, segment->size) == 1)
		spool->damaged++;
}

static void remove_segment(struct spool *spool, struct spool_segment *segment)
{
	char path[SPOOL_PATH_MAX + 32];

	spool->bytes -= segment->size;
	spool->records -= segment->records - segment->acked;
	if (spool->reading_segment == segment->number && spool->reading >= 0) {
		close(spool->reading);
		spool->reading = -1;
	}
	unlink(segment_path(spool, segment->number, path));
	*segment = (struct spool_segment){0};
	spool->unsynced_names = true;
}

static void scan_slot(struct spool *spool, uint64_t slot)
{
	struct spool_segment *segment = &spool->segments[slot];
	char path[SPOOL_PATH_MAX + 32];
	int fd = open(segment_path(spool, slot, path), O_RDONLY | O_CLOEXEC);

	if (fd < 0)
		return;
	scan(spool, segment, fd, slot);
	close(fd);
	spool->bytes += segment->size;
	spool->records += segment->records - segment->acked;
	if (segment->number >= spool->next)
		spool->next = segment->number + 1;
	if (segment->records == segment->acked)
		remove_segment(spool, segment->number ? segment : &(struct spool_segment){.number = slot});
}

/* The oldest segment that is not before this number; NULL: none. */
static struct spool_segment *oldest_from(struct spool *spool, uint64_t number)
{
	struct spool_segment *oldest = NULL;

	for (size_t i = 0; i < SPOOL_SEGMENTS; i++) {
		struct spool_segment *segment = &spool->segments[i];

		if (segment->number >= number && segment->number > 0 && (!oldest || segment->number < oldest->number))
			oldest = segment;
	}
	return oldest;
}

int spool_open(struct spool *spool, const char *folder, uint64_t bytes)
{
	char path[SPOOL_PATH_MAX + 32];

	*spool = (struct spool){.folder_fd = -1, .writing = -1, .reading = -1, .ack_fd = -1};
	if (strlen(folder) >= sizeof(spool->folder) || bytes < (uint64_t)SMALLEST_SEGMENT * SPOOL_SEGMENTS)
		return -EINVAL;
	memcpy(spool->folder, folder, strlen(folder) + 1);
	bytes /= SPOOL_SEGMENTS;
	spool->segment_size = bytes > INT32_MAX ? INT32_MAX : (uint32_t)bytes;
	spool->folder_fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
	if (spool->folder_fd < 0)
		return -errno;
	if (flock(spool->folder_fd, LOCK_EX | LOCK_NB) < 0) {
		close(spool->folder_fd);
		return -EBUSY;
	}
	snprintf(path, sizeof(path), "%s/spool.ack", folder);
	spool->ack_fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
	if (spool->ack_fd < 0) {
		int error = errno;

		close(spool->folder_fd);
		return -error;
	}
	read_acks(spool);
	spool->next = spool->acked.segment + 1;
	spool->unsynced_names = true;
	for (uint64_t slot = 0; slot < SPOOL_SEGMENTS; slot++)
		scan_slot(spool, slot);
	spool_rewind(spool);
	return 0;
}

void spool_close(struct spool *spool)
{
	spool_sync(spool);
	if (spool->writing >= 0)
		close(spool->writing);
	if (spool->reading >= 0)
		close(spool->reading);
	close(spool->ack_fd);
	close(spool->folder_fd);
}

/* ---- appending --------------------------------------------------------------------------------------------------- */

static int sync_segment(struct spool *spool)
{
	if (spool->unsynced && spool->writing >= 0 && fsync(spool->writing) != 0)
		return failed(spool);
	spool->unsynced = false;
	if (spool->unsynced_names && fsync(spool->folder_fd) != 0)
		return failed(spool);
	spool->unsynced_names = false;
	return 0;
}

static void end_segment(struct spool *spool)
{
	if (spool->writing >= 0)
		close(spool->writing);
	spool->writing = -1;
	spool->unsynced = false;
}

/* The oldest one gives way. */
static void drop_segment(struct spool *spool, struct spool_segment *segment)
{
	uint64_t number = segment->number;

	spool->dropped += segment->records - (segment->read > segment->acked ? segment->read : segment->acked);
	remove_segment(spool, segment);
	const struct spool_segment *next = oldest_from(spool, number + 1);
	struct spool_position begin = {next ? next->number : number + 1, HEADER};
	if (is_behind(begin, spool->acked))
		spool->acked = begin;
	if (is_behind(begin, spool->cursor))
		spool->cursor = begin;
}

static int begin_segment(struct spool *spool)
{
	struct spool_segment *segment = &spool->segments[spool->next % SPOOL_SEGMENTS];
	char path[SPOOL_PATH_MAX + 32];
	uint8_t header[HEADER];
	int result = sync_segment(spool); /* before what follows it */

	end_segment(spool);
	if (result < 0)
		return result;
	if (segment->number > 0)
		drop_segment(spool, segment);
	segment_path(spool, spool->next, path);
	unlink(path); /* what a power cut has left behind */
	spool->writing = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
	if (spool->writing < 0)
		return failed(spool);
	spool->unsynced = spool->unsynced_names = true;
	make_header(spool->next, header);
	if (write_all(spool->writing, header, sizeof(header)) < 0) {
		result = failed(spool);
		end_segment(spool);
		return result;
	}
	*segment = (struct spool_segment){.number = spool->next++, .size = HEADER};
	spool->bytes += HEADER;
	return 0;
}

int spool_append(struct spool *spool, const void *record, size_t size, struct spool_position *at)
{
	struct spool_segment *segment = segment_of(spool, spool->next - 1);
	uint8_t bytes[RECORD_HEAD + SPOOL_RECORD_MAX];

	assert(size > 0 && size <= SPOOL_RECORD_MAX);
	if (spool->writing < 0 || !segment || segment->size + RECORD_HEAD + size > spool->segment_size) {
		int result = begin_segment(spool);

		if (result < 0)
			return result;
		segment = segment_of(spool, spool->next - 1);
	}
	put_u32(bytes, (uint32_t)size);
	put_u32(bytes + 4, record_crc(segment->number, segment->size, record, (uint32_t)size));
	memcpy(bytes + RECORD_HEAD, record, size);
	if (write_all(spool->writing, bytes, RECORD_HEAD + size) < 0) {
		int result = failed(spool);

		end_segment(spool);
		return result;
	}
	spool->unsynced = true;
	segment->size += (uint32_t)(RECORD_HEAD + size);
	segment->records++;
	spool->bytes += RECORD_HEAD + size;
	spool->records++;
	*at = (struct spool_position){segment->number, segment->size};
	return 0;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static bool open_for_reading(struct spool *spool, uint64_t number)
{
	char path[SPOOL_PATH_MAX + 32];

	if (spool->reading >= 0 && spool->reading_segment == number)
		return true;
	if (spool->reading >= 0)
		close(spool->reading);
	spool->reading = open(segment_path(spool, number, path), O_RDONLY | O_CLOEXEC);
	spool->reading_segment = number;
	return spool->reading >= 0;
}

int spool_next(struct spool *spool, void *record, size_t capacity, size_t *size, struct spool_position *at)
{
	struct spool_segment *segment;
	uint32_t length;

	while ((segment = oldest_from(spool, spool->cursor.segment)) != NULL) {
		if (segment->number != spool->cursor.segment)
			spool->cursor = (struct spool_position){segment->number, HEADER};
		if (spool->cursor.offset >= segment->size) {
			if (!oldest_from(spool, segment->number + 1))
				return 0;
			spool->cursor = (struct spool_position){segment->number + 1, HEADER};
			continue;
		}
		if (open_for_reading(spool, segment->number) &&
			read_record(spool->reading, segment->number, spool->cursor.offset, record, capacity, &length)) {
			spool->cursor.offset += RECORD_HEAD + length;
			segment->read++;
			*size = length;
			*at = spool->cursor;
			return 1;
		}
		spool->errors++; /* it cannot be read any more: what is left of the segment is lost */
		spool->dropped += segment->records - segment->read;
		segment->read = segment->records;
		spool->cursor.offset = segment->size;
	}
	return 0;
}

void spool_skip(struct spool *spool)
{
	for (size_t i = 0; i < SPOOL_SEGMENTS; i++) {
		struct spool_segment *segment = &spool->segments[i];

		segment->read = segment->records;
		if (segment->number >= spool->cursor.segment && segment->number > 0)
			spool->cursor = (struct spool_position){segment->number, segment->size};
	}
}

void spool_rewind(struct spool *spool)
{
	spool->cursor = spool->acked;
	for (size_t i = 0; i < SPOOL_SEGMENTS; i++)
		spool->segments[i].read = spool->segments[i].acked;
}

/* ---- delivered --------------------------------------------------------------------------------------------------- */

void spool_acked(struct spool *spool, struct spool_position at)
{
	struct spool_segment *segment = segment_of(spool, at.segment);

	if (!is_behind(at, spool->acked))
		return; /* it was dropped meanwhile */
	for (size_t i = 0; i < SPOOL_SEGMENTS; i++) {
		struct spool_segment *before = &spool->segments[i];

		if (before->number > 0 && before->number < at.segment) {
			spool->records -= before->records - before->acked;
			before->acked = before->records;
		}
	}
	spool->acked = at;
	if (segment && segment->acked < segment->records) {
		segment->acked++;
		spool->records--;
	}
}

bool spool_is_empty(const struct spool *spool)
{
	return spool->records == 0;
}

static int write_ack(struct spool *spool)
{
	uint8_t bytes[ACK_SIZE];
	off_t place = (off_t)((spool->ack_turn + 1) % 2 * ACK_SIZE);

	put_uint(bytes, spool->ack_turn + 1, 8);
	put_uint(bytes + 8, spool->acked.segment, 8);
	put_u32(bytes + 16, spool->acked.offset);
	put_u32(bytes + 20, od_crc32(0, bytes, ACK_SIZE - 4));
	if (pwrite(spool->ack_fd, bytes, sizeof(bytes), place) != sizeof(bytes) || fsync(spool->ack_fd) != 0)
		return failed(spool);
	spool->ack_turn++;
	spool->acked_on_disk = spool->acked;
	return 0;
}

int spool_sync(struct spool *spool)
{
	int result = sync_segment(spool);

	if (result < 0)
		end_segment(spool); /* whether its pages will ever be written is not known */
	if (is_behind(spool->acked, spool->acked_on_disk)) {
		int acks = write_ack(spool);

		result = result < 0 ? result : acks;
	}
	for (size_t i = 0; i < SPOOL_SEGMENTS; i++) {
		struct spool_segment *segment = &spool->segments[i];

		if (segment->number == 0 || segment->acked < segment->records ||
			is_behind((struct spool_position){segment->number, segment->size}, spool->acked_on_disk))
			continue;
		if (segment->number == spool->next - 1)
			end_segment(spool);
		remove_segment(spool, segment);
	}
	return result;
}

/* Reads the FIFOs of the chips, which have five kinds (enum chip_fifo). A level that the chip cannot have is a failed
 * transfer: a chip that is not there reads as FFh on SPI. */
#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>
#include <string.h>

enum { SOURCE = 0x2F, AT_ONCE = 32 /* sets */ };

static unsigned get_u16(const uint8_t *bytes)
{
	return (unsigned)(bytes[0] | bytes[1] << 8);
}

static int read_sets(struct board *b, struct stream *s, uint8_t at, int64_t level)
{
	const size_t size = 6 * s->chip->triad_count;
	uint8_t bytes[I2C_BLOCK_MAX];

	for (int64_t left = level; left > 0;) {
		size_t sets = I2C_BLOCK_MAX / size;
		int result;

		if ((int64_t)sets > left)
			sets = (size_t)left;
		result = board_read_chip(b, s->chip, s->address, at, bytes, sets * size);
		if (result < 0)
			return result;
		for (size_t i = 0; i < sets; i++)
			stream_add(b, s, bytes + i * size);
		left -= (int64_t)sets;
	}
	return (int)level;
}

/* CHIP_FIFO_SETS: an overrun and "empty" contradict each other. */
static int read_single_sets(struct board *b, struct stream *s)
{
	int64_t from_ns = board_read_clock(b);
	uint8_t source;
	int result = board_read_chip(b, s->chip, s->address, SOURCE, &source, 1);
	int64_t level = source & 0x40 ? AT_ONCE : source & 0x1F;

	if (result < 0)
		return result;
	if (source == 0xFF)
		return -EIO;
	stream_observe(b, s, level, source & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	return read_sets(b, s, s->chip->data, level);
}

/* LSM9DS1 */
static int read_pairs(struct board *b, struct stream *s)
{
	const struct chip *chip = s->chip;
	int64_t from_ns = board_read_clock(b);
	uint8_t source, set[CHIP_SET];
	int result = board_read_chip(b, chip, s->address, SOURCE, &source, 1), level = source & 0x3F;

	if (result < 0)
		return result;
	if (level > AT_ONCE)
		return -EIO;
	stream_observe(b, s, level, source & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	for (int n = 0; n < level; n++) {
		for (size_t i = 0; i < chip->triad_count; i++) {
			result = board_read_chip(
				b, chip, s->address, (uint8_t)(chip->data + chip->triads[i].byte), set + 6 * i, 6);
			if (result < 0)
				return result;
		}
		stream_add(b, s, set);
	}
	return level;
}

/* LSM6DS33: the status contains the position of the next word in its set; after an overrun it may be in the middle. */
static int read_words(struct board *b, struct stream *s)
{
	enum { EMPTY = 0x10 };
	int64_t from_ns = board_read_clock(b), words;
	uint8_t status[4], skipped[10];
	int result = board_read_chip(b, s->chip, s->address, 0x3A, status, sizeof status);
	unsigned next;

	if (result < 0)
		return result;
	words = get_u16(status) & 0x0FFF;
	next = get_u16(status + 2) & 0x03FF;
	if (words > 0 && status[1] & EMPTY)
		return -EIO;
	if (next > 0 && next < 6 && words >= 6 - next) {
		words -= 6 - next;
		if ((result = board_read_chip(b, s->chip, s->address, 0x3E, skipped, (size_t)(6 - next) * 2)) < 0)
			return result;
	}
	stream_observe(b, s, words / 6, status[1] & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	return read_sets(b, s, 0x3E, words / 6 < AT_ONCE ? words / 6 : AT_ONCE);
}

static void add_tagged(struct board *b, struct stream *s, const uint8_t *entry)
{
	enum { TAG_GYRO = 1, TAG_ACCEL = 2 };
	unsigned tag = entry[0] >> 3;

	if (tag != TAG_GYRO && tag != TAG_ACCEL)
		return;
	memcpy(s->partial + (tag == TAG_GYRO ? 0 : 6), entry + 1, 6);
	s->partial_have |= tag;
	if (s->partial_have != (TAG_GYRO | TAG_ACCEL))
		return;
	s->partial_have = 0;
	stream_add(b, s, s->partial);
}

/* LSM6DSO: each entry is a tag and one triad. */
static int read_tagged(struct board *b, struct stream *s)
{
	enum { ENTRY = 7, DEPTH = 512, BLOCK = 4 };
	int64_t from_ns = board_read_clock(b), entries;
	uint8_t status[2], bytes[ENTRY * BLOCK];
	int result = board_read_chip(b, s->chip, s->address, 0x3A, status, sizeof status);

	if (result < 0)
		return result;
	entries = get_u16(status) & 0x03FF;
	if (entries > DEPTH)
		return -EIO;
	stream_observe(b, s, (entries + (s->partial_have != 0)) / 2, status[1] & 0x48 ? LOST_PERHAPS : LOST_NONE,
		from_ns, board_read_clock(b));
	if (entries > 2 * AT_ONCE)
		entries = 2 * AT_ONCE;
	for (int64_t left = entries; left > 0; left -= BLOCK) {
		size_t n = left < BLOCK ? (size_t)left : BLOCK;

		if ((result = board_read_chip(b, s->chip, s->address, 0x78, bytes, n * ENTRY)) < 0)
			return result;
		for (size_t i = 0; i < n; i++)
			add_tagged(b, s, bytes + i * ENTRY);
	}
	return (int)entries;
}

/* ---- packets ----------------------------------------------------------------------------------------------------- */

/* What it held is lost; how many samples, the next read tells from their times. */
static int flush(struct board *b, struct stream *s)
{
	const struct chip_register *writes = s->chip->packets.flush;
	int result = 0;

	for (size_t i = 0; i < 2 && writes[i].address && result == 0; i++)
		result = i2c_write(b->bus, s->address, writes[i].address, writes[i].value);
	s->flushed = true;
	s->fresh_ns = board_read_clock(b); /* it has samples */
	return result;
}

static void add_packet(struct board *b, struct stream *s, const uint8_t *packet)
{
	const struct chip_packets *p = &s->chip->packets;
	uint8_t set[CHIP_SET];

	for (size_t i = 0; i < s->chip->triad_count; i++)
		memcpy(set + 6 * i, packet + p->at[i], 6);
	stream_add(b, s, set);
}

static bool is_packet(const struct chip_packets *p, const uint8_t *packet)
{
	return (packet[0] & p->mask) == p->header;
}

/* A packet without its header shows that the FIFO does not begin with a packet, e.g. after an overflow, or since one
 * sensor began before the other. Without headers, an overflow shows it. */
static int read_packets(struct board *b, struct stream *s)
{
	const struct chip *chip = s->chip;
	const struct chip_packets *p = &chip->packets;
	int64_t from_ns = board_read_clock(b);
	uint8_t count[2] = {0}, bytes[I2C_BLOCK_MAX];
	int result = board_read_chip(b, chip, s->address, p->level, count, sizeof count), level, left;
	unsigned used = (uint16_t)stream_word(chip, count) & p->level_mask;
	bool full = used + p->size > p->depth;

	if (result < 0)
		return result;
	if (used > p->depth + p->size)
		return -EIO;
	if (full && p->mask == 0)
		return flush(b, s);
	level = (int)(used / p->size);
	stream_observe(b, s, level, full || s->flushed ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	s->flushed = false;
	left = level = level < AT_ONCE ? level : AT_ONCE;
	while (left > 0) {
		size_t n = I2C_BLOCK_MAX / p->size;

		if ((int)n > left)
			n = (size_t)left;
		if ((result = board_read_chip(b, chip, s->address, p->window, bytes, n * p->size)) < 0)
			return result;
		for (size_t i = 0; i < n; i++) {
			if (!is_packet(p, bytes + i * p->size))
				return flush(b, s);
			add_packet(b, s, bytes + i * p->size);
		}
		left -= (int)n;
	}
	return level;
}

int stream_read_fifo(struct board *b, struct stream *s)
{
	switch (s->chip->fifo) {
	case CHIP_FIFO_SETS:
		return read_single_sets(b, s);
	case CHIP_FIFO_PAIRS:
		return read_pairs(b, s);
	case CHIP_FIFO_WORDS:
		return read_words(b, s);
	case CHIP_FIFO_TAGGED:
		return read_tagged(b, s);
	case CHIP_FIFO_PACKETS:
		return read_packets(b, s);
	case CHIP_NO_FIFO:
		break;
	}
	return 0;
}

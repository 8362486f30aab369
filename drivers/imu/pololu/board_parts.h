/* drivers/imu/pololu/board_parts.h
 * Shared by the files behind board.h: board_detect.c detects the chips, board_plan.c chooses their settings, stream.c
 * initialises one chip and makes samples of its data, stream_fifo.c reads its FIFO, stream_watch.c detects its faults,
 * board.c schedules the reads and makes samples, board_self_test.c runs the self-test. */
#ifndef DRIVERS_IMU_POLOLU_BOARD_PARTS_H
#define DRIVERS_IMU_POLOLU_BOARD_PARTS_H

#include "drivers/imu/pololu/board.h"

#define BOARD_MS 1000000LL /* in ns */

enum {
	STREAM_FIRST_BACKOFF_MS = 10,
	STREAM_VERIFY_MS = 10, /* interval of reading back one register */
};

/* ---- board.c ---- */
/** Reads the clock into board->now_ns; called before and after everything that takes time. */
int64_t board_read_clock(struct board *board);
void board_sleep_until(struct board *board, int64_t ns);
void board_update_health(struct board *board);

/* ---- stream.c ---- */
int board_read_chip(
	const struct board *board, const struct chip *chip, uint8_t address, uint8_t at, uint8_t *bytes, size_t n);
/** 0; -ENODEV: another chip answers; other -errno: no answer. */
int board_identify(const struct board *board, const struct chip *chip, uint8_t address);
/** Writes the chip's registers and reads them back. 0; -EBADMSG: a register has another value; other -errno. */
int stream_set_up(struct board *board, struct stream *s);
/** Reads register i of the list back; results as those of stream_set_up(). */
int stream_verify(struct board *board, const struct stream *s, size_t i);
/** The value that register i of the list must have; -1: a later entry writes it again. */
int stream_expected(const struct chip_registers *list, size_t i);
/** Initialises the chip; on failure it is STREAM_DOWN with the fault. */
void stream_start(struct board *board, struct stream *s);
void stream_fail(struct board *board, struct stream *s, enum imu_fault fault);
/** Reads the new samples. Their number, or -errno. */
int stream_read(struct board *board, struct stream *s);
enum losses { LOST_NONE, LOST_PERHAPS, LOST_SOME };
/** Between from_ns and to_ns the chip had `level` samples, of which the oldest is the next to be read. How many were
 * lost before it is derived from the sample clock. */
void stream_observe(
	struct board *board, struct stream *s, int64_t level, enum losses losses, int64_t from_ns, int64_t to_ns);
/** Adds the next sample. `set`: the words of the triads, six bytes each. */
void stream_add(struct board *board, struct stream *s, const uint8_t *set);
/** Makes a set of the data registers. */
void stream_pack(const struct chip *chip, const uint8_t *data, uint8_t set[CHIP_SET]);
int16_t stream_word(const struct chip *chip, const uint8_t *bytes);
struct vec3 stream_decode(const struct stream *s, size_t triad, const uint8_t *set, bool *saturated);

/* ---- stream_fifo.c ---- */
/** Reads at most 32 samples of the FIFO, the rest next time. Result as that of stream_read(). */
int stream_read_fifo(struct board *board, struct stream *s);

/* ---- stream_watch.c ---- */
/** Number of equal samples that are a fault; 0: never, since a digit is coarser than the noise. Then only the chip's
 * data-ready bit shows that it samples. */
unsigned stream_same_limit(const struct stream *s);
/** Counts the result of a transfer with the chip. */
void stream_count_errors(struct board *board, struct stream *s, int result);
void stream_verify_next(struct board *board, struct stream *s);
/** Detects faults from the data that reads returned, not from how long they took: a slow machine is not a fault. */
void stream_watch(struct board *board, struct stream *s);

#endif

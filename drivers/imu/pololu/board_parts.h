/* drivers/imu/pololu/board_parts.h
 * What the files behind board.h share: board_detect.c finds the chips, board_plan.c chooses their settings, stream.c
 * starts and reads one chip, stream_watch.c judges it, board.c says when what is read and makes samples of it,
 * board_self_test.c tests. */
#ifndef DRIVERS_IMU_POLOLU_BOARD_PARTS_H
#define DRIVERS_IMU_POLOLU_BOARD_PARTS_H

#include "drivers/imu/pololu/board.h"

#define BOARD_MS 1000000LL /* in ns */

enum {
	STREAM_FIRST_BACKOFF_MS = 10,
	STREAM_VERIFY_MS = 10, /* one register is read back in so long */
};

/* ---- board.c ---- */
/** The clock is read before and after what takes time, and is the same (board->now_ns) for all that follows. */
int64_t board_read_clock(struct board *board);
void board_sleep_until(struct board *board, int64_t ns);
void board_update_health(struct board *board);

/* ---- stream.c ---- */
int board_read_chip(
	const struct board *board, const struct chip *chip, uint8_t address, uint8_t at, uint8_t *bytes, size_t n);
/** 0; -ENODEV: something else is there; other -errno: nobody. */
int board_identify(const struct board *board, const struct chip *chip, uint8_t address);
/** Writes its registers and reads them back. 0, -errno, or -EBADMSG: something else stands there. */
int stream_set_up(struct board *board, struct stream *s);
/** Whether register i of its list is as written, in the same terms. */
int stream_verify(struct board *board, const struct stream *s, size_t i);
/** What must stand in register i of the list; -1: it is written again further on. */
int stream_expected(const struct chip_registers *list, size_t i);
/** Up from now on, or down with its fault. */
void stream_start(struct board *board, struct stream *s);
void stream_fail(struct board *board, struct stream *s, enum imu_fault fault);
/** Takes what is new. Samples, or -errno. */
int stream_read(struct board *board, struct stream *s);
int16_t stream_word(const struct chip *chip, const uint8_t *bytes);
struct vec3 stream_decode(const struct stream *s, size_t triad, const uint8_t *set, bool *saturated);

/* ---- stream_watch.c ---- */
/** So many equal samples are no measurements; 0: this cannot be told, since a digit is coarser than the noise. What
 * shows then that a chip lives is that it says it has new data. */
unsigned stream_same_limit(const struct stream *s);
/** The outcome of a transfer with that chip. */
void stream_count_errors(struct board *board, struct stream *s, int result);
void stream_verify_next(struct board *board, struct stream *s);
/** By what reads have shown, not by how long they took: a machine that is slow is not a chip that failed. */
void stream_watch(struct board *board, struct stream *s);

#endif

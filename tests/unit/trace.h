/* tests/unit/trace.h
 * Traces: what a program computes, compared with what it computed when the trace was last written to a file of
 * tests/unit/traces/. A trace does not know what is correct: the tests beside it, `make honesty` and `make score` do.
 * It shows that something changed, and where, so that no result changes unnoticed.
 *
 * A change that is intended: `make traces` writes the files again, and their difference belongs to the commit.
 *
 * A file is a list of blocks, each with a line as header and lines of a name and up to three numbers, or a text. A
 * name whose numbers are all 0 is left out. Numbers are equal when they differ by at most TRACE_SHARE of them, or by
 * the resolution given: C libraries round sin, cos, exp and so on differently. */
#ifndef TESTS_UNIT_TRACE_H
#define TESTS_UNIT_TRACE_H

#include <stddef.h>

#include "model/math/vec3.h"

struct CMUnitTest;

#define TRACE_SHARE 3e-5

/** The values from here on belong to this block, e.g. "drive, 20 s". */
void trace_block(const char *header);
/** resolution: absolute difference that is none, in the unit of the values. 0: they are whole numbers and equal. */
void trace_vec(const char *name, struct vec3 values, double resolution);
void trace_value(const char *name, double value, double resolution);
/** A text of up to 200 characters, which has to be the same; "": left out in the file. */
void trace_text(const char *name, const char *text);
/** Fails the test when values differed since the last call. */
void trace_check(void);
/** Runs the tests with tests/unit/traces/NAME.txt, which it reads, or writes with IMU9_TRACES=write in the environment;
 * then one more, which fails when the file has blocks that nothing computed. `tests` has room for it behind `count`.
 * Returns the exit status. */
int trace_run(const char *name, struct CMUnitTest *tests, size_t count);

#endif

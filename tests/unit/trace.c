#include "tests/unit/trace.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LINES_MAX = 20000, LINE_BYTES = 256, SHOWN = 8 };

static struct {
	char path[100];
	FILE *written;		   /* or NULL: it is compared */
	char (*lines)[LINE_BYTES]; /* of the file */
	int count, next;	   /* next: line of the block that has not been compared */
	const char *header;
	int blocks, differences;
} trace;

static bool is_header(const char *line)
{
	return line[0] != ' ' && line[0] != '#';
}

static int open_trace(void **state)
{
	const char *mode = getenv("IMU9_TRACES"), *path = trace.path;
	FILE *file;

	(void)state;
	if (mode && strcmp(mode, "write") == 0) {
		trace.written = fopen(path, "w");
		assert_non_null(trace.written);
		fprintf(trace.written, "# Written by `make traces`, compared by make check: tests/unit/trace.h\n");
		return 0;
	}
	file = fopen(path, "r");
	if (!file)
		fail_msg("%s cannot be read: `make traces` writes it", path);
	trace.lines = calloc(LINES_MAX, LINE_BYTES);
	assert_non_null(trace.lines);
	while (trace.count < LINES_MAX && fgets(trace.lines[trace.count], LINE_BYTES, file)) {
		trace.lines[trace.count][strcspn(trace.lines[trace.count], "\n")] = 0;
		trace.count++;
	}
	fclose(file);
	return 0;
}

static void differ(const char *format, ...)
{
	va_list arguments;

	if (++trace.differences > SHOWN)
		return;
	va_start(arguments, format);
	vprint_error(format, arguments);
	va_end(arguments);
}

/* The lines of a block that nothing computed. */
static void expect_end_of_block(void)
{
	if (trace.header && trace.next < trace.count && !is_header(trace.lines[trace.next]))
		differ("%s: nothing computes%s (%s:%d)\n", trace.header, trace.lines[trace.next], trace.path,
			trace.next + 1);
}

void trace_block(const char *header)
{
	trace.blocks++;
	if (trace.written) {
		fprintf(trace.written, "%s\n", header);
		return;
	}
	expect_end_of_block();
	trace.header = header;
	for (trace.next = 0; trace.next < trace.count; trace.next++)
		if (strcmp(trace.lines[trace.next], header) == 0)
			break;
	if (trace.next++ == trace.count)
		differ("%s: is not in %s\n", header, trace.path);
}

static void write_values(const char *name, const double *values, int count)
{
	bool zero = true;

	for (int i = 0; i < count; i++)
		zero &= values[i] == 0;
	if (zero)
		return;
	fprintf(trace.written, "  %s", name);
	for (int i = 0; i < count; i++)
		fprintf(trace.written, values[i] == floor(values[i]) ? " %.0f" : " %.6g", values[i]);
	fprintf(trace.written, "\n");
}

/* resolution 0: a count */
static bool near(double a, double b, double resolution)
{
	return a == b || (resolution > 0 && fabs(a - b) <= resolution + TRACE_SHARE * fabs(b));
}

static void compare(const char *name, const double *values, int count, double resolution)
{
	const char *line = trace.next < trace.count ? trace.lines[trace.next] : "";
	double expected[3] = {0};
	size_t length = strlen(name);
	int row = trace.next + 1;

	if (line[0] == ' ' && strncmp(line + 2, name, length) == 0 && line[2 + length] == ' ') {
		char *at = (char *)line + 2 + length;

		for (int i = 0; i < count; i++)
			expected[i] = strtod(at, &at);
		trace.next++;
	}
	for (int i = 0; i < count; i++)
		if (!near(values[i], expected[i], resolution))
			differ("%s: %s%s is %.9g, not %.9g (%s:%d)\n", trace.header, name,
				count == 1 ? "" : (const char *const[]){" x", " y", " z"}[i], values[i], expected[i],
				trace.path, row);
}

static void values_are(const char *name, const double *values, int count, double resolution)
{
	if (trace.written)
		write_values(name, values, count);
	else
		compare(name, values, count, resolution);
}

void trace_vec(const char *name, struct vec3 v, double resolution)
{
	values_are(name, (const double[]){v.x, v.y, v.z}, 3, resolution);
}

void trace_value(const char *name, double value, double resolution)
{
	values_are(name, &value, 1, resolution);
}

void trace_text(const char *name, const char *text)
{
	const char *line = trace.next < trace.count ? trace.lines[trace.next] : "", *expected = "";
	size_t length = strlen(name);

	if (trace.written) {
		if (text[0])
			fprintf(trace.written, "  %s %s\n", name, text);
		return;
	}
	if (line[0] == ' ' && strncmp(line + 2, name, length) == 0 && line[2 + length] == ' ') {
		expected = line + 3 + length;
		trace.next++;
	}
	if (strcmp(text, expected) != 0)
		differ("%s: %s is '%s', not '%s' (%s:%d)\n", trace.header, name, text, expected, trace.path,
			trace.next);
}

void trace_check(void)
{
	int differences;

	if (!trace.written)
		expect_end_of_block();
	trace.header = NULL;
	differences = trace.differences;
	trace.differences = 0;
	if (differences > 0)
		fail_msg("%d values differ from %s. If this change is intended: `make traces`, and commit the "
			 "difference with its reason",
			differences, trace.path);
}

static void test_the_trace_has_nothing_else(void **state)
{
	int blocks = 0;

	(void)state;
	if (trace.written) {
		assert_int_equal(fclose(trace.written), 0);
		print_message("%s: %d blocks written\n", trace.path, trace.blocks);
		return;
	}
	for (int i = 0; i < trace.count; i++)
		blocks += is_header(trace.lines[i]);
	free(trace.lines);
	trace.lines = NULL;
	if (blocks != trace.blocks)
		fail_msg("%s has %d blocks, the test %d. If this change is intended: `make traces`", trace.path, blocks,
			trace.blocks);
}

int trace_run(const char *name, struct CMUnitTest *tests, size_t count)
{
	snprintf(trace.path, sizeof trace.path, "tests/unit/traces/%s.txt", name);
	tests[count++] = (struct CMUnitTest)cmocka_unit_test(test_the_trace_has_nothing_else);
	return _cmocka_run_group_tests(name, tests, count, open_trace, NULL);
}

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const char *const BUILDS[] = {"gcc -O2", "gcc -O0", "clang -O2", "clang -O0"};

static int has(const char *build)
{
	char command[64];

	snprintf(command, sizeof command, "command -v %.*s >/dev/null", (int)strcspn(build, " "), build);
	return system(command) == 0;
}

/* The checksum of what the program of that build prints. */
static void checksum_of(const char *build, char *sum, int size)
{
	char command[512], program[] = "/tmp/imu9_bits_XXXXXX";
	FILE *pipe;

	close(mkstemp(program));
	snprintf(command, sizeof command,
		"%s -std=c11 -I. -ffp-contract=off -o %s tests/unit/bits/samples.c model/sim/rng.c model/sim/signal.c "
		"model/sim/sensor.c -lm && "
		"%s | cksum",
		build, program, program);
	pipe = popen(command, "r");
	assert_non_null(pipe);
	assert_non_null(fgets(sum, size, pipe));
	assert_int_equal(pclose(pipe), 0);
	unlink(program);
}

static void test_one_seed_gives_the_same_bits_with_gcc_and_clang_optimised_or_not(void **state)
{
	char first[64], other[64];

	(void)state;
	if (access("tests/unit/bits/samples.c", R_OK) != 0 || !has("gcc") || !has("clang")) {
		print_message("skipped: needs gcc, clang and the sources\n");
		skip();
	}
	checksum_of(BUILDS[0], first, sizeof first);
	assert_true(strtol(strchr(first, ' '), NULL, 10) > 1000000); /* bytes printed */
	for (size_t i = 1; i < sizeof BUILDS / sizeof *BUILDS; i++) {
		checksum_of(BUILDS[i], other, sizeof other);
		assert_string_equal(other, first);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_one_seed_gives_the_same_bits_with_gcc_and_clang_optimised_or_not),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

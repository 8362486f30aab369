/* tests/unit/descriptors.h
 * The tests of a program leave no more descriptors open than there were: cmocka_run_group_tests(tests,
 * count_descriptors, no_descriptor_is_left). Standard input is closed, as that of a service may be: descriptor 0 is one
 * as any other. */
#ifndef TESTS_UNIT_DESCRIPTORS_H
#define TESTS_UNIT_DESCRIPTORS_H

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

static int descriptors_before;

static int open_descriptors(void)
{
	int n = 0;

	for (int fd = 0; fd < 1024; fd++)
		n += fcntl(fd, F_GETFD) >= 0;
	return n;
}

static int count_descriptors(void **state)
{
	(void)state;
	close(STDIN_FILENO);
	descriptors_before = open_descriptors();
	return 0;
}

static int no_descriptor_is_left(void **state)
{
	(void)state;
	if (open_descriptors() == descriptors_before)
		return 0;
	print_error("%d descriptors are left open\n", open_descriptors() - descriptors_before);
	exit(1); /* a group's teardown that fails does not change the status of the program */
}

#endif

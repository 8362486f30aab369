/* What a process in the sandbox can still do, and what not. Each test is a process of its own, since there is no way
 * out of the sandbox. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "gateway/sandbox.h"

enum { NO_SANDBOX = 77, WRONG = 99 };

/* Runs `body` in the sandbox; it returns whether all was as it should be. */
static void in_sandbox(bool (*body)(void))
{
	int status;
	pid_t pid = fork();

	assert_true(pid >= 0);
	if (pid == 0) {
		int rc = sandbox_enter();

		_exit(rc == -ENOTSUP || rc == -ENOSYS || rc == -EINVAL ? NO_SANDBOX : rc < 0 || !body() ? WRONG : 0);
	}
	assert_int_equal(waitpid(pid, &status, 0), pid);
	assert_true(WIFEXITED(status));
	if (WEXITSTATUS(status) == NO_SANDBOX)
		skip(); /* a kernel or an emulator without filters, or AddressSanitizer */
	assert_int_equal(WEXITSTATUS(status), 0);
}

static bool refused(long rc)
{
	return rc == -1 && errno == EPERM;
}

static bool start_programs(void)
{
	char *argv[] = {"/bin/true", NULL}, *environment[] = {NULL};

	return refused(execve(argv[0], argv, environment)) && refused(fork()) &&
	       refused(syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0)) && system("true") != 0 &&
	       syscall(SYS_clone3, NULL, 0) == -1 && errno == ENOSYS; /* the C library takes clone() then */
}

static void test_no_program_and_no_process_can_be_started(void **state)
{
	(void)state;
	in_sandbox(start_programs);
}

static bool reach_out(void)
{
	struct timespec now;

	clock_gettime(CLOCK_REALTIME, &now);
	/* the last three set what is so already: done by root, they change nothing where the sandbox has a hole */
	return refused(ptrace(PTRACE_TRACEME, 0, NULL, NULL)) && refused(mount("none", "/", "tmpfs", 0, NULL)) &&
	       refused(unshare(CLONE_NEWNS)) && refused(chroot("/")) && refused(setuid(getuid())) &&
	       refused(syscall(SYS_personality, 0xFFFFFFFF)) && refused(clock_settime(CLOCK_REALTIME, &now));
}

static void test_host_users_and_other_processes_are_out_of_reach(void **state)
{
	(void)state;
	in_sandbox(reach_out);
}

static int pipes[2];
static char seen;

/* Waits for a byte, then tries. */
static void *try_chroot(void *unused)
{
	char byte;

	return read(pipes[0], &byte, 1) == 1 && refused(chroot("/")) ? &seen : unused;
}

static bool start_thread(void)
{
	pthread_t thread;
	void *result;

	return pipe(pipes) == 0 && write(pipes[1], "", 1) == 1 &&
	       pthread_create(&thread, NULL, try_chroot, NULL) == 0 && pthread_join(thread, &result) == 0 &&
	       result == &seen;
}

static void test_threads_start_as_before_and_are_in_it_too(void **state)
{
	(void)state;
	in_sandbox(start_thread);
}

static void test_a_thread_that_ran_before_is_in_it_too(void **state)
{
	int status;

	(void)state;
	assert_int_equal(pipe(pipes), 0);
	pid_t pid = fork();
	if (pid == 0) {
		pthread_t thread;
		void *result;

		if (pthread_create(&thread, NULL, try_chroot, NULL) != 0)
			_exit(WRONG);
		int rc = sandbox_enter();
		if (rc == -ENOTSUP || rc == -ENOSYS || rc == -EINVAL)
			_exit(NO_SANDBOX);
		if (rc < 0 || write(pipes[1], "", 1) != 1 || pthread_join(thread, &result) != 0)
			_exit(WRONG);
		_exit(result == &seen ? 0 : WRONG);
	}
	assert_int_equal(waitpid(pid, &status, 0), pid);
	if (WEXITSTATUS(status) == NO_SANDBOX)
		skip();
	assert_int_equal(status, 0);
}

static bool store_a_file(void)
{
	char old[64], new[64];

	snprintf(old, sizeof(old), "/tmp/test_sandbox.%d.new", (int)getpid());
	snprintf(new, sizeof(new), "/tmp/test_sandbox.%d", (int)getpid());
	FILE *file = fopen(old, "w");
	return file && fputs("value", file) >= 0 && fflush(file) == 0 && fsync(fileno(file)) == 0 &&
	       fclose(file) == 0 && rename(old, new) == 0 && unlink(new) == 0;
}

static void test_files_are_written_and_renamed_as_before(void **state)
{
	(void)state;
	in_sandbox(store_a_file);
}

static bool no_library;

void *dlopen(const char *file, int mode)
{
	void *(*real)(const char *, int);

	*(void **)&real = dlsym(RTLD_NEXT, "dlopen");
	return no_library ? NULL : real(file, mode);
}

/* A process that may not set a filter, as under another sandbox, and one without the library. */
static void test_without_a_sandbox_the_process_is_told(void **state)
{
	struct sock_filter code[] = {BPF_STMT(BPF_LD | BPF_W | BPF_ABS, 0 /* the number of the call */),
		BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_seccomp, 0, 1),
		BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EPERM), BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)};
	struct sock_fprog program = {sizeof(code) / sizeof(code[0]), code};
	int status;

	(void)state;
	no_library = true;
	int rc = sandbox_enter();
	no_library = false;
	assert_true(rc == -ENOENT || rc == -ENOTSUP); /* the latter with a sanitizer */
	pid_t pid = fork();
	if (pid == 0) {
		if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 ||
			prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) != 0)
			_exit(NO_SANDBOX);
		_exit(sandbox_enter() < 0 ? 0 : WRONG);
	}
	assert_int_equal(waitpid(pid, &status, 0), pid);
	if (WEXITSTATUS(status) == NO_SANDBOX)
		skip();
	assert_int_equal(status, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_no_program_and_no_process_can_be_started),
		cmocka_unit_test(test_host_users_and_other_processes_are_out_of_reach),
		cmocka_unit_test(test_threads_start_as_before_and_are_in_it_too),
		cmocka_unit_test(test_a_thread_that_ran_before_is_in_it_too),
		cmocka_unit_test(test_files_are_written_and_renamed_as_before),
		cmocka_unit_test(test_without_a_sandbox_the_process_is_told),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}

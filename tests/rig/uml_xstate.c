/* tests/rig/uml_xstate.c
 * Makes Debian's user-mode-linux 6.1 work on processors with AMX. vcan-run preloads it where needed.
 *
 * UML saves 2696 bytes of its processes' extended state (x87 to PKRU) and restores them with PTRACE_SETREGSET. The host
 * accepts only the complete area, 11008 bytes with AMX, and returns EFAULT otherwise; UML then kills its init. This
 * library extends a short area by components in their initial state: nothing in the guest uses AMX. */
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { AREA_MAX = 65536, XSTATE_BV = 512 }; /* XSTATE_BV: offset of the bitmap of components present */
static const uint64_t AMX = UINT64_C(3) << 17;

static long set_whole_xstate(pid_t pid, const struct iovec *part)
{
	static unsigned char area[AREA_MAX];
	static size_t size;
	struct iovec whole = {area, size ? size : AREA_MAX};
	uint64_t present;

	if (!size) {
		if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, NT_X86_XSTATE, &whole) < 0)
			return -1;
		size = whole.iov_len;
	}
	if (part->iov_len >= size)
		return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, part);
	memcpy(area, part->iov_base, part->iov_len);
	memcpy(&present, area + XSTATE_BV, sizeof(present));
	present &= ~AMX;
	memcpy(area + XSTATE_BV, &present, sizeof(present));
	return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, &whole);
}

long ptrace(enum __ptrace_request request, ...)
{
	va_list args;
	long word = 0, ret;

	va_start(args, request);
	pid_t pid = va_arg(args, pid_t);
	void *addr = va_arg(args, void *);
	void *data = va_arg(args, void *);
	va_end(args);

	if (request == PTRACE_SETREGSET && addr == (void *)NT_X86_XSTATE)
		return set_whole_xstate(pid, data);
	/* as libc's: the system call stores a peeked word, the function returns it */
	if (request != PTRACE_PEEKTEXT && request != PTRACE_PEEKDATA && request != PTRACE_PEEKUSER)
		return syscall(SYS_ptrace, request, pid, addr, data);
	ret = syscall(SYS_ptrace, request, pid, addr, &word);
	if (ret < 0)
		return ret;
	errno = 0;
	return word;
}

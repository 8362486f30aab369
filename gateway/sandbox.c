/* The filter names what is forbidden, not what is allowed: what the C library and drivers call differs between
 * architectures and versions, and a sensor that stops years later by a list that was too short is worse. */
#include "gateway/sandbox.h"

#include <errno.h>
#include <malloc.h>
#include <sched.h>
#include <seccomp.h>

#define LIBRARY "libseccomp.so.2"
#define FUNCTIONS(VALUE, VOID, ENTRY)                                                                           \
	ENTRY(seccomp_init, scmp_filter_ctx, (uint32_t action))                                                 \
	VALUE(seccomp_attr_set, int, (scmp_filter_ctx filter, enum scmp_filter_attr attribute, uint32_t value), \
		(filter, attribute, value))                                                                     \
	VALUE(seccomp_syscall_resolve_name, int, (const char *name), (name))                                    \
	VALUE(seccomp_rule_add_array, int,                                                                      \
		(scmp_filter_ctx filter, uint32_t action, int call, unsigned int count,                         \
			const struct scmp_arg_cmp *args),                                                       \
		(filter, action, call, count, args))                                                            \
	VALUE(seccomp_load, int, (const scmp_filter_ctx filter), (filter))                                      \
	VOID(seccomp_release, (scmp_filter_ctx filter), (filter))
#include "drivers/loaded.h"

scmp_filter_ctx seccomp_init(uint32_t action)
{
	return load_library() ? library.seccomp_init(action) : NULL;
}

static const char *const forbidden[] = {
	/* programs and processes; clone() is below */
	"execve",
	"execveat",
	"fork",
	"vfork",
	/* other processes */
	"ptrace",
	"process_vm_readv",
	"process_vm_writev",
	"process_madvise",
	"kcmp",
	"pidfd_getfd",
	/* other users and capabilities */
	"setuid",
	"setgid",
	"setreuid",
	"setregid",
	"setresuid",
	"setresgid",
	"setfsuid",
	"setfsgid",
	"setgroups",
	"setuid32",
	"setgid32",
	"setreuid32",
	"setregid32",
	"setresuid32",
	"setresgid32",
	"setfsuid32",
	"setfsgid32",
	"setgroups32",
	"capset",
	"personality",
	/* mounts, namespaces, device files, files by handle */
	"mount",
	"umount",
	"umount2",
	"pivot_root",
	"chroot",
	"open_tree",
	"move_mount",
	"fsopen",
	"fsconfig",
	"fsmount",
	"fspick",
	"mount_setattr",
	"unshare",
	"setns",
	"mknod",
	"mknodat",
	"open_by_handle_at",
	"quotactl",
	"quotactl_fd",
	"swapon",
	"swapoff",
	/* the kernel and the host */
	"init_module",
	"finit_module",
	"delete_module",
	"kexec_load",
	"kexec_file_load",
	"reboot",
	"bpf",
	"perf_event_open",
	"userfaultfd",
	"io_uring_setup",
	"io_uring_enter",
	"io_uring_register",
	"add_key",
	"request_key",
	"keyctl",
	"acct",
	"syslog",
	"iopl",
	"ioperm",
	"sethostname",
	"setdomainname",
	"vhangup",
	"settimeofday",
	"clock_settime",
	"clock_settime64",
	"stime",
};

static int forbid(
	scmp_filter_ctx filter, const char *name, int error, unsigned int count, const struct scmp_arg_cmp *args)
{
	int call = seccomp_syscall_resolve_name(name);

	/* this architecture, or this version of the library, does not know it */
	return call == __NR_SCMP_ERROR
		       ? 0
		       : seccomp_rule_add_array(filter, SCMP_ACT_ERRNO((uint16_t)error), call, count, args);
}

static int load(scmp_filter_ctx filter)
{
	const struct scmp_arg_cmp no_thread = SCMP_A0(SCMP_CMP_MASKED_EQ, CLONE_THREAD, 0);
	int rc = seccomp_attr_set(filter, SCMP_FLTATR_CTL_TSYNC, 1);

	for (size_t i = 0; rc == 0 && i < sizeof(forbidden) / sizeof(forbidden[0]); i++)
		rc = forbid(filter, forbidden[i], EPERM, 0, NULL);
	if (rc == 0)
		rc = forbid(filter, "clone", EPERM, 1, &no_thread);
	if (rc == 0) /* its flags are in memory, which a filter cannot read; the C library then uses clone() */
		rc = forbid(filter, "clone3", ENOSYS, 0, NULL);
	return rc == 0 ? seccomp_load(filter) : rc;
}

#ifndef __has_feature /* clang's */
#define __has_feature(name) 0
#endif
#ifdef __SANITIZE_ADDRESS__ /* gcc's */
enum { SANITIZED = 1 };
#else
enum { SANITIZED = __has_feature(address_sanitizer) };
#endif

int sandbox_enter(void)
{
	scmp_filter_ctx filter = SANITIZED ? NULL : seccomp_init(SCMP_ACT_ALLOW);

	if (!filter)
		return SANITIZED ? -ENOTSUP : -ENOENT;
	int rc = load(filter);
	seccomp_release(filter);
	unload_library(); /* with what it had allocated, 0.2 MB */
	malloc_trim(0);
	return rc;
}

/* gateway/sandbox.h
 * Takes from the process what a gateway never needs, in case that a fault lets somebody run code in it: new processes
 * and programs, mounts, namespaces, kernel modules, other processes' memory, other users, the clock of the host.
 * systemd units can have that by their own means; this needs no systemd. By libseccomp. */
#ifndef GATEWAY_SANDBOX_H
#define GATEWAY_SANDBOX_H

/** For all threads of the process, those that start later, too, and for good. Such a system call fails with EPERM from
 * then on. Call it when the ports and windows are open. 0, or -errno: -ENOENT without libseccomp.so.2, -ENOSYS or
 * -EINVAL from a kernel without seccomp filters, -ENOTSUP under AddressSanitizer, which starts a process at the end. */
int sandbox_enter(void);

#endif

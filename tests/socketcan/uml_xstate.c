/* Preloaded into linux.uml on hosts with AMX, where it would panic with "ptrace set fp regs failed, errno = 14".
 *
 * User Mode Linux hands the host a buffer of fixed size (2696 bytes, up to AVX-512 and PKRU) as the extended processor
 * state; the host accepts nothing but the full size, which AMX makes larger. Here the buffer is padded to that size.
 * Zeros are right for the padding: no guest process can ask for AMX, so its tile state is never in use.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

enum { NT_X86_XSTATE = 0x202, LARGEST = 1 << 14 };

typedef long ptrace_function(enum __ptrace_request, ...);

long ptrace(enum __ptrace_request request, ...)
{
    static ptrace_function *host_ptrace;
    static size_t full_size;
    static char padded[LARGEST]; /* a guest kernel's stack is smaller; one process, one thread at a time calls this */
    struct iovec full = {padded, sizeof padded};
    va_list arguments;

    va_start(arguments, request);
    long pid = va_arg(arguments, long);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (!host_ptrace)
        *(void **)&host_ptrace = dlsym(RTLD_NEXT, "ptrace");
    if (request != PTRACE_SETREGSET || (long)address != NT_X86_XSTATE)
        return host_ptrace(request, pid, address, data);

    if (!full_size) {
        if (host_ptrace(PTRACE_GETREGSET, pid, address, &full) < 0)
            return -1;
        full_size = full.iov_len;
    }
    const struct iovec *given = data;
    if (given->iov_len >= full_size)
        return host_ptrace(request, pid, address, data);
    memcpy(padded, given->iov_base, given->iov_len);
    memset(padded + given->iov_len, 0, full_size - given->iov_len);
    full.iov_len = full_size;
    return host_ptrace(request, pid, address, &full);
}

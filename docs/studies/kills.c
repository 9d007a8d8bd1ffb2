/* Kills the process at its n-th system call that changes files. Loaded before the C library (LD_PRELOAD) by kills.py;
   casadical_arm(n) begins to count. A write that is the n-th writes half of its bytes first. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/stat.h>
#include <unistd.h>

static long left = -1;

void casadical_arm(long n) { left = n; }

static void hit(void)
{
    if (left > 0 && --left == 0) kill(getpid(), SIGKILL);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRAP(type, name, parameters, arguments) \
    type name parameters { hit(); return REAL(name) arguments; }

WRAP(int, rename, (const char *a, const char *b), (a, b))
WRAP(int, renameat, (int d, const char *a, int e, const char *b), (d, a, e, b))
WRAP(int, renameat2, (int d, const char *a, int e, const char *b, unsigned f), (d, a, e, b, f))
WRAP(int, link, (const char *a, const char *b), (a, b))
WRAP(int, linkat, (int d, const char *a, int e, const char *b, int f), (d, a, e, b, f))
WRAP(int, unlink, (const char *a), (a))
WRAP(int, unlinkat, (int d, const char *a, int f), (d, a, f))
WRAP(int, mkdir, (const char *a, mode_t m), (a, m))
WRAP(int, rmdir, (const char *a), (a))
WRAP(int, fsync, (int h), (h))
WRAP(int, ftruncate64, (int h, off64_t n), (h, n))
WRAP(int, chmod, (const char *a, mode_t m), (a, m))
WRAP(int, fchmod, (int h, mode_t m), (h, m))

ssize_t write(int h, const void *bytes, size_t n)
{
    if (left == 1 && n > 1) REAL(write)(h, bytes, n / 2);
    hit();
    return REAL(write)(h, bytes, n);
}

int open64(const char *a, int flags, ...)
{
    va_list rest;
    va_start(rest, flags);
    mode_t m = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    if (flags & (O_CREAT | O_TRUNC)) hit();
    return REAL(open64)(a, flags, m);
}

int open(const char *a, int flags, ...)
{
    va_list rest;
    va_start(rest, flags);
    mode_t m = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    if (flags & (O_CREAT | O_TRUNC)) hit();
    return REAL(open)(a, flags, m);
}

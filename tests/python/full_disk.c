// Preloaded by tests: files in PAVE_TEST_FULL_FOLDER share a disk of PAVE_TEST_FULL_BYTES bytes.
// SPDX-License-Identifier: BSD-3-Clause
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_llong written;

// Takes `count` bytes from the disk's room if `fd` is a file on it; false if they are not there.
static int has_room(int fd, size_t count) {
    const char *folder = getenv("PAVE_TEST_FULL_FOLDER"), *limit = getenv("PAVE_TEST_FULL_BYTES");
    char link[64], path[4096];
    if (!folder || !limit) return 1;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    const ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 1;
    path[length] = 0;
    if (strncmp(path, folder, strlen(folder)) != 0) return 1;
    return atomic_fetch_add(&written, (long long)count) + (long long)count <= atoll(limit);
}

#define REAL(name)                 \
    static __typeof__(&name) real; \
    if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *bytes, size_t count) {
    REAL(write);
    if (has_room(fd, count)) return real(fd, bytes, count);
    errno = ENOSPC;
    return -1;
}

ssize_t pwrite(int fd, const void *bytes, size_t count, off_t offset) {
    REAL(pwrite);
    if (has_room(fd, count)) return real(fd, bytes, count, offset);
    errno = ENOSPC;
    return -1;
}

ssize_t pwrite64(int fd, const void *bytes, size_t count, off64_t offset) {
    REAL(pwrite64);
    if (has_room(fd, count)) return real(fd, bytes, count, offset);
    errno = ENOSPC;
    return -1;
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    REAL(writev);
    size_t total = 0;
    for (int i = 0; i < count; ++i) total += parts[i].iov_len;
    if (has_room(fd, total)) return real(fd, parts, count);
    errno = ENOSPC;
    return -1;
}

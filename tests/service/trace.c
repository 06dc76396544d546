/* A library that a test preloads into the server; it needs no privilege and no package.
 *
 * It appends to the file $CALL_TRACE one line per event, in order: each file that was synced, each name
 * that a file was renamed or linked to (after the call), and each message sent on a socket (before the call).
 * With $CALL_KILL=n it kills the server before the nth of these calls.
 * While the file $CALL_HANG exists, a sync, and an open relative to a directory, do not return, as on a
 * network file system whose server is gone. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static int trace = -1;
static int kill_at = 0;
static int calls = 0;
static const char *hang = NULL;

__attribute__((constructor)) static void start(void) {
    const char *path = getenv("CALL_TRACE");
    if (path) trace = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    const char *at = getenv("CALL_KILL");
    if (at) kill_at = atoi(at);
    hang = getenv("CALL_HANG");
}

static void wait_while_hung(void) {
    while (hang && access(hang, F_OK) == 0) usleep(1000);
}

static void about_to(void) {
    if (kill_at && __atomic_add_fetch(&calls, 1, __ATOMIC_SEQ_CST) == kill_at) kill(getpid(), SIGKILL);
}

static int synced(int result, int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (trace >= 0 && result == 0 && length > 0) dprintf(trace, "synced %.*s\n", (int)length, path);
    return result;
}

static int renamed(int result, const char *to) {
    if (trace >= 0 && result == 0) dprintf(trace, "renamed %s\n", to);
    return result;
}

static void sending(int fd) {
    struct stat status;
    if (fstat(fd, &status) != 0 || !S_ISSOCK(status.st_mode)) return;
    about_to();
    if (trace >= 0) dprintf(trace, "sent\n");
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

int fsync(int fd) { about_to(); wait_while_hung(); return synced(NEXT(fsync)(fd), fd); }
int fdatasync(int fd) { about_to(); wait_while_hung(); return synced(NEXT(fdatasync)(fd), fd); }

int openat(int directory, const char *path, int flags, ...) {
    va_list arguments;
    va_start(arguments, flags);
    int mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(arguments, int) : 0;
    va_end(arguments);
    if (directory != AT_FDCWD) wait_while_hung();
    return NEXT(openat)(directory, path, flags, mode);
}
int openat64(int directory, const char *path, int flags, ...) {
    va_list arguments;
    va_start(arguments, flags);
    int mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(arguments, int) : 0;
    va_end(arguments);
    if (directory != AT_FDCWD) wait_while_hung();
    return NEXT(openat64)(directory, path, flags, mode);
}

int rename(const char *from, const char *to) { about_to(); return renamed(NEXT(rename)(from, to), to); }
int renameat(int a, const char *from, int b, const char *to) {
    about_to();
    return renamed(NEXT(renameat)(a, from, b, to), to);
}
int link(const char *from, const char *to) { about_to(); return renamed(NEXT(link)(from, to), to); }
int linkat(int a, const char *from, int b, const char *to, int flags) {
    about_to();
    return renamed(NEXT(linkat)(a, from, b, to, flags), to);
}

ssize_t write(int fd, const void *bytes, size_t count) {
    sending(fd);
    return NEXT(write)(fd, bytes, count);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    sending(fd);
    return NEXT(writev)(fd, parts, count);
}
ssize_t send(int fd, const void *bytes, size_t count, int flags) {
    sending(fd);
    return NEXT(send)(fd, bytes, count, flags);
}
ssize_t sendto(int fd, const void *bytes, size_t count, int flags, const struct sockaddr *to, socklen_t length) {
    sending(fd);
    return NEXT(sendto)(fd, bytes, count, flags, to, length);
}
ssize_t sendmsg(int fd, const struct msghdr *message, int flags) {
    sending(fd);
    return NEXT(sendmsg)(fd, message, flags);
}

/* Syncing and renaming files take 20 ms each, so that a kill finds them half done. SQLite's own
 * syncs (fdatasync) are as fast as they are: they are made in every tick.
 *
 * cc -shared -fPIC -o slow_disk.so slow_disk.c; LD_PRELOAD=... program */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>

static void wait_for_the_disk(void) { nanosleep(&(struct timespec){.tv_nsec = 20000000}, NULL); }

int fsync(int descriptor) {
    int (*real)(int);
    *(void **)&real = dlsym(RTLD_NEXT, "fsync");
    wait_for_the_disk();
    return real(descriptor);
}

int rename(const char *from, const char *to) {
    int (*real)(const char *, const char *);
    *(void **)&real = dlsym(RTLD_NEXT, "rename");
    wait_for_the_disk();
    return real(from, to);
}

/* The time of day jumps by up to a day, back or forth, at random; monotonic clocks do not.
 *
 * cc -shared -fPIC -o jumping_clock.so jumping_clock.c; LD_PRELOAD=... program */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static _Atomic int64_t offset_s, next_ns;
static _Atomic uint64_t drawn;

static int real(clockid_t clock, struct timespec *t) {
    static int (*_Atomic found)(clockid_t, struct timespec *);
    if (!found) *(void **)&found = dlsym(RTLD_NEXT, "clock_gettime");
    return found(clock, t);
}

static uint64_t draw(void) { /* splitmix64 */
    uint64_t x = atomic_fetch_add(&drawn, 0x9E3779B97F4A7C15u) + 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

__attribute__((constructor)) static void begin(void) {
    const char *seed = getenv("JUMPING_CLOCK_SEED");
    drawn = seed ? strtoull(seed, NULL, 10) * 0xD1342543DE82EF95u : 0;
}

static int64_t jump(void) {
    struct timespec now;
    real(CLOCK_MONOTONIC, &now);
    int64_t now_ns = now.tv_sec * INT64_C(1000000000) + now.tv_nsec, due = next_ns;
    /* Every 50 to 1050 ms, for whoever asks first. */
    if (now_ns >= due &&
        atomic_compare_exchange_strong(&next_ns, &due, now_ns + 50000000 + draw() % 1000000000))
        offset_s = (int64_t)(draw() % (2 * 86400 + 1)) - 86400;
    return offset_s;
}

int clock_gettime(clockid_t clock, struct timespec *t) {
    int failed = real(clock, t);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) t->tv_sec += jump();
    return failed;
}

int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}

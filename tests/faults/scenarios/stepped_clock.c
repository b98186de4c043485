/* Steps the system clock of one process; loaded by LD_PRELOAD, see test_clock_of_the_computer.py.
 *
 * All that a process asks the system clock is answered with the same offset, which is
 * read anew each time from the shared file STEPPED_CLOCK: one int64, in nanoseconds.
 * Deadlines that are given as times of this clock are translated back for the kernel.
 * A wait that has begun before a step is not cut short by it, as the kernel's would be.
 * The monotonic clocks are left alone: no step of a system clock moves them.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define NS_PER_S 1000000000LL
/* Where glibc keeps that a condition waits by the monotonic clock. */
#define MONOTONIC_CONDITION 2

static _Atomic int64_t none;
static _Atomic int64_t *offset_ns = &none;

static int (*real_clock_gettime)(clockid_t, struct timespec *);
static int (*real_clock_nanosleep)(clockid_t, int, const struct timespec *, struct timespec *);
static int (*real_cond_timedwait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
static int (*real_cond_clockwait)(pthread_cond_t *, pthread_mutex_t *, clockid_t,
                                  const struct timespec *);
static int (*real_mutex_timedlock)(pthread_mutex_t *, const struct timespec *);
static int (*real_mutex_clocklock)(pthread_mutex_t *, clockid_t, const struct timespec *);
static int (*real_sem_timedwait)(sem_t *, const struct timespec *);
static int (*real_sem_clockwait)(sem_t *, clockid_t, const struct timespec *);

static void *next(const char *name)
{
    return dlsym(RTLD_NEXT, name);
}

__attribute__((constructor)) static void begin(void)
{
    const char *path = getenv("STEPPED_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;

    real_clock_gettime = next("clock_gettime");
    real_clock_nanosleep = next("clock_nanosleep");
    /* By name alone, the oldest version would be found, which knows no clocks. */
    real_cond_timedwait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (!real_cond_timedwait)
        real_cond_timedwait = next("pthread_cond_timedwait");
    real_cond_clockwait = next("pthread_cond_clockwait");
    real_mutex_timedlock = next("pthread_mutex_timedlock");
    real_mutex_clocklock = next("pthread_mutex_clocklock");
    real_sem_timedwait = next("sem_timedwait");
    real_sem_clockwait = next("sem_clockwait");
    if (file >= 0) {
        void *page = mmap(NULL, sizeof none, PROT_READ, MAP_SHARED, file, 0);
        if (page != MAP_FAILED)
            offset_ns = page;
        close(file);
    }
    /* A test that steps nothing must not pass. */
    if (offset_ns == &none)
        abort();
}

static int is_system_clock(clockid_t clock)
{
    return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE;
}

static struct timespec moved(struct timespec time, int64_t by_ns)
{
    int64_t ns = time.tv_nsec + by_ns % NS_PER_S;

    time.tv_sec += by_ns / NS_PER_S;
    if (ns < 0 || ns >= NS_PER_S) {
        time.tv_sec += ns < 0 ? -1 : 1;
        ns += ns < 0 ? NS_PER_S : -NS_PER_S;
    }
    time.tv_nsec = ns;
    return time;
}

/* A deadline of the system clock as the kernel's clock will show it. */
static struct timespec for_kernel(clockid_t clock, const struct timespec *deadline)
{
    return is_system_clock(clock) ? moved(*deadline, -*offset_ns) : *deadline;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int failed;

    /* Libraries that are initialised earlier may ask, too. */
    if (!real_clock_gettime)
        real_clock_gettime = next("clock_gettime");
    failed = real_clock_gettime(clock, now);
    if (!failed && is_system_clock(clock))
        *now = moved(*now, *offset_ns);
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec time;
    (void)zone;

    clock_gettime(CLOCK_REALTIME, &time);
    now->tv_sec = time.tv_sec;
    now->tv_usec = time.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *result)
{
    struct timespec now;

    clock_gettime(CLOCK_REALTIME, &now);
    if (result)
        *result = now.tv_sec;
    return now.tv_sec;
}

int timespec_get(struct timespec *now, int base)
{
    return base == TIME_UTC && !clock_gettime(CLOCK_REALTIME, now) ? base : 0;
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
{
    struct timespec deadline = flags & TIMER_ABSTIME ? for_kernel(clock, until) : *until;

    return real_clock_nanosleep(clock, flags, &deadline, left);
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex,
                           const struct timespec *until)
{
    int is_monotonic = condition->__data.__wrefs & MONOTONIC_CONDITION;
    struct timespec deadline = for_kernel(is_monotonic ? CLOCK_MONOTONIC : CLOCK_REALTIME, until);

    return real_cond_timedwait(condition, mutex, &deadline);
}

int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock,
                           const struct timespec *until)
{
    struct timespec deadline = for_kernel(clock, until);

    return real_cond_clockwait(condition, mutex, clock, &deadline);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec deadline = for_kernel(CLOCK_REALTIME, until);

    return real_mutex_timedlock(mutex, &deadline);
}

int pthread_mutex_clocklock(pthread_mutex_t *mutex, clockid_t clock, const struct timespec *until)
{
    struct timespec deadline = for_kernel(clock, until);

    return real_mutex_clocklock(mutex, clock, &deadline);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until)
{
    struct timespec deadline = for_kernel(CLOCK_REALTIME, until);

    return real_sem_timedwait(semaphore, &deadline);
}

int sem_clockwait(sem_t *semaphore, clockid_t clock, const struct timespec *until)
{
    struct timespec deadline = for_kernel(clock, until);

    return real_sem_clockwait(semaphore, clock, &deadline);
}

/* Loaded before other libraries: a program's time of day is SHIFT_MS off, and nothing else;
   with SAWTOOTH_MS it gets there from 0 within that time, again and again. With SHIFT_FILE it is
   what this file holds, a number of nanoseconds in eight bytes, so that it can be set meanwhile. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static const long long second_ns = 1000000000LL;
static long long shift_ns, sawtooth_ns;
static const volatile long long *now_ns = &shift_ns;

__attribute__((constructor)) static void read_shift(void)
{
    const char *text = getenv("SHIFT_MS");
    shift_ns = text ? atoll(text) * 1000000LL : 0;
    text = getenv("SAWTOOTH_MS");
    sawtooth_ns = text ? atoll(text) * 1000000LL : 0;
    text = getenv("SHIFT_FILE");
    int file = text ? open(text, O_RDONLY) : -1;
    if (file >= 0) {
        void *place = mmap(NULL, sizeof *now_ns, PROT_READ, MAP_SHARED, file, 0);
        now_ns = place == MAP_FAILED ? now_ns : place;
        close(file);
    }
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
    int failed = (int)syscall(SYS_clock_gettime, clock, time);
    if (!failed && clock == CLOCK_REALTIME) {
        long long ns = time->tv_sec * second_ns + time->tv_nsec;
        ns += sawtooth_ns ? shift_ns * (ns % sawtooth_ns) / sawtooth_ns : *now_ns;
        time->tv_sec = ns / second_ns;
        time->tv_nsec = ns % second_ns;
    }
    return failed;
}

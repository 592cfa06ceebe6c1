/* The clock of a user-mode kernel on a computer that is too slow for it: while that kernel works, its time passes SLOWNESS times as slowly as
   the computer's; while it waits, as fast. Programs inside find a computer that is so many times as fast. Linux 6.1's user-mode kernel reads
   CLOCK_MONOTONIC, has one timer, whose times are from now on, and waits for it in sigsuspend. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <time.h>

#define SLOWNESS 8
#define SECOND 1000000000LL

struct rate { int64_t outside, inside, slowness; }; /* from a moment on; times in ns */

static int (*host_clock)(clockid_t, struct timespec *);
static int (*host_timer)(timer_t, int, const struct itimerspec *, struct itimerspec *);
static int (*host_wait)(const sigset_t *);
static struct rate rates[2];
static volatile int which; /* of the rates holds; a signal may come at any moment, and reads the time */
static timer_t timer;
static int64_t due, every; /* the timer's, by the time inside [ns]; 0: off */

static int64_t outside(void)
{
    struct timespec now;
    host_clock(CLOCK_MONOTONIC, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static int64_t inside(int64_t now)
{
    const struct rate *rate = &rates[which];
    return rate->inside + (now - rate->outside) / rate->slowness;
}

static struct timespec spec(int64_t ns) { return (struct timespec){ns / SECOND, ns % SECOND}; }

static void arm(void)
{
    int64_t slowness = rates[which].slowness, now = inside(outside());
    if (every && due <= now)
        due += ((now - due) / every + 1) * every;
    if (due <= now)
        return; /* it is off, or its signal has come or waits */
    struct itimerspec its = {spec(every * slowness), spec((due - now + 1) * slowness)};
    host_timer(timer, 0, &its, 0);
}

static void go_on(int64_t slowness)
{
    int64_t now = outside();
    rates[1 - which] = (struct rate){now, inside(now), slowness};
    which = 1 - which;
    arm();
}

__attribute__((constructor)) static void begin(void)
{
    host_clock = dlsym(RTLD_NEXT, "clock_gettime");
    host_timer = dlsym(RTLD_NEXT, "timer_settime");
    host_wait = dlsym(RTLD_NEXT, "sigsuspend");
    int64_t now = outside();
    rates[which] = (struct rate){now, now, SLOWNESS};
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    if (clock != CLOCK_MONOTONIC)
        return host_clock(clock, now);
    *now = spec(inside(outside()));
    return 0;
}

int timer_settime(timer_t set, int flags, const struct itimerspec *to, struct itimerspec *before)
{
    int64_t first = to->it_value.tv_sec * SECOND + to->it_value.tv_nsec;
    timer = set;
    every = first ? to->it_interval.tv_sec * SECOND + to->it_interval.tv_nsec : 0;
    due = first ? inside(outside()) + first : 0;
    if (!first)
        return host_timer(set, flags, to, before);
    arm();
    return 0;
}

int sigsuspend(const sigset_t *mask)
{
    go_on(1);
    int status = host_wait(mask);
    go_on(SLOWNESS);
    return status;
}

/* The frames of a bench's tick in C, over the datagrams of `drivers/udp_bus.py`: what the computer, its kernel and the emulator allow.

   cc -O2 -o udp_loop udp_loop.c
   ./udp_loop GROUP PORT PERIOD_NS TICKS TIMEOUT_NS BEAT_EVERY IDENTIFIERS SYNC BEAT COMMAND...

   SYNC, BEAT and COMMANDs are datagrams in hexadecimal; IDENTIFIERS are those of the answers to a SYNC, decimal, with commas. At absolute
   times it drains the socket, sends SYNC, waits for the answers, sends the commands, and the heartbeat every BEAT_EVERY ticks. To standard
   output goes a line per tick: nanoseconds from when it was due until it was ready to wait again, and how many ticks were missed before it.
*/
#include <arpa/inet.h>
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>

#define SPIN_NS 400000 /* as the bench: before a tick it does not sleep */
#define PRIORITY 50    /* as the bench's */
#define MOST 32
#define BYTES 512

typedef struct { unsigned char bytes[BYTES]; size_t length; } Datagram;

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void fail(const char *what)
{
    perror(what);
    exit(1);
}

static Datagram from_hex(const char *text)
{
    Datagram d = {.length = strlen(text) / 2};
    if (d.length > BYTES) fail("datagram");
    for (size_t i = 0; i < d.length; i++)
        if (sscanf(text + 2 * i, "%2hhx", &d.bytes[i]) != 1) fail("hexadecimal");
    return d;
}

/* The frame's identifier: the MessagePack integer behind its name; -1 where there is none. */
static int identifier_of(const unsigned char *bytes, size_t length)
{
    static const char name[] = "arbitration_id";
    const unsigned char *at = memmem(bytes, length, name, sizeof name - 1);
    if (at == NULL) return -1;
    at += sizeof name - 1;
    size_t left = length - (size_t)(at - bytes);
    if (left > 0 && at[0] < 0x80) return at[0];
    if (left > 1 && at[0] == 0xcc) return at[1];
    if (left > 2 && at[0] == 0xcd) return at[1] << 8 | at[2];
    return -1;
}

static int opened(struct sockaddr_in group, int receives)
{
    int s = socket(AF_INET, SOCK_DGRAM | (receives ? SOCK_NONBLOCK : 0), 0), one = 1, none = 0;
    struct in_addr loopback = {.s_addr = htonl(INADDR_LOOPBACK)};
    struct ip_mreq member = {.imr_multiaddr = group.sin_addr, .imr_interface = loopback};
    if (s < 0) fail("socket");
    if (receives) {
        setsockopt(s, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
        setsockopt(s, SOL_SOCKET, SO_REUSEPORT, &one, sizeof one);
        if (bind(s, (struct sockaddr *)&group, sizeof group)) fail("bind");
        if (setsockopt(s, IPPROTO_IP, IP_ADD_MEMBERSHIP, &member, sizeof member)) fail("group");
    } else {
        setsockopt(s, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
        setsockopt(s, IPPROTO_IP, IP_MULTICAST_TTL, &none, sizeof none);
        if (connect(s, (struct sockaddr *)&group, sizeof group)) fail("connect");
    }
    return s;
}

static void sent(int s, const Datagram *d)
{
    if (send(s, d->bytes, d->length, 0) < 0) fail("send");
}

int main(int count, char **word)
{
    if (count < 10) {
        fprintf(stderr, "too few arguments; see the head of udp_loop.c\n");
        return 2;
    }
    struct sockaddr_in group = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(word[2]))};
    if (inet_pton(AF_INET, word[1], &group.sin_addr) != 1) fail("address");
    const int64_t period = atoll(word[3]), timeout = atoll(word[5]);
    const long ticks = atol(word[4]), every = atol(word[6]);
    int identifiers[MOST], expected = 0, commands = count - 10;
    for (char *each = strtok(word[7], ","); each != NULL && expected < MOST; each = strtok(NULL, ",")) identifiers[expected++] = atoi(each);
    Datagram sync = from_hex(word[8]), beat = from_hex(word[9]), command[MOST];
    if (commands > MOST) fail("commands");
    for (int i = 0; i < commands; i++) command[i] = from_hex(word[10 + i]);
    int listener = opened(group, 1), sender = opened(group, 0);
    int64_t *whole = calloc((size_t)ticks, sizeof *whole);
    long *missed = calloc((size_t)ticks, sizeof *missed), done = 0, answered = 0;
    struct sched_param priority = {.sched_priority = PRIORITY};
    if (sched_setscheduler(0, SCHED_FIFO, &priority) == 0) mlockall(MCL_CURRENT | MCL_FUTURE);

    const int64_t began = now_ns();
    for (long k = 0; k < ticks; done++) {
        unsigned char bytes[4096];
        long behind = (now_ns() - began) / period - ++k;
        if (behind > 0) missed[done] = behind, k += behind;
        const int64_t due = began + k * period, asleep = due - now_ns() - SPIN_NS;
        if (asleep > 0) {
            struct timespec t = {asleep / 1000000000, asleep % 1000000000};
            nanosleep(&t, NULL);
        }
        while (now_ns() < due) {}
        while (recv(listener, bytes, sizeof bytes, 0) > 0) {}
        sent(sender, &sync);
        const int64_t overdue = now_ns() + timeout;
        uint32_t awaited = (uint32_t)((1ull << expected) - 1);
        while (awaited) {
            ssize_t length = recv(listener, bytes, sizeof bytes, 0);
            int64_t left = overdue - now_ns();
            if (length > 0) {
                int identifier = identifier_of(bytes, (size_t)length);
                for (int i = 0; i < expected; i++)
                    if (identifiers[i] == identifier) awaited &= ~(1u << i);
            } else if (left <= 0) {
                break;
            } else {
                struct pollfd line = {.fd = listener, .events = POLLIN};
                struct timespec t = {left / 1000000000, left % 1000000000};
                ppoll(&line, 1, &t, NULL);
            }
        }
        answered += !awaited;
        for (int i = 0; i < commands; i++) sent(sender, &command[i]);
        if (k % every == 0) sent(sender, &beat);
        whole[done] = now_ns() - due;
    }
    for (long i = 0; i < done; i++) printf("%lld %ld\n", (long long)whole[i], missed[i]);
    fprintf(stderr, "%ld of %ld answered\n", answered, done);
    return 0;
}

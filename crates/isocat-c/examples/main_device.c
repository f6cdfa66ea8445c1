/* A small MainDevice over port.h: it brings two drives into OP with SYNC0, runs some
 * cycles, and tells what the judges of the segment say of it.
 *
 *     main_device [CYCLES [SEGMENT.toml]]
 *
 * What it writes into the drives is what `isocat plan --start-up` lists for them. The exit code is the verdict: 0 in sync, 1 not, 3
 * nothing to judge; 2 if the MainDevice itself gave up. */
#include "port.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { APWR = 2, FPRD = 4, FPWR = 5, BRD = 7, BWR = 8, LRW = 12, FRMW = 14 };
enum { INIT = 1, PREOP = 2, SAFEOP = 4, OP = 8, ACKNOWLEDGE = 0x10 };
enum { DRIVES = 2, STATION = 0x1001, BYTES = 14, OUTPUTS_AND_INPUTS = 3 * DRIVES };

static const int64_t CYCLE = 1000000, TIMEOUT = 2000000;

static uint8_t frame[1514];
static size_t length;
static uint8_t image[BYTES];
static uint64_t shift;
static int64_t due;

static int give_up(const char *why)
{
    fprintf(stderr, "main_device: %s\n", why);
    exit(2);
}

static void put(uint8_t *to, uint64_t value, size_t bytes)
{
    for (; bytes > 0; bytes--, value >>= 8)
        *to++ = (uint8_t)value;
}

static uint64_t get(const uint8_t *from, size_t bytes)
{
    uint64_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | from[bytes];
    return value;
}

/* Begins a frame. */
static void begin(void)
{
    static const uint8_t header[14] = {255, 255, 255, 255, 255, 255, 2, 0, 0, 0, 0, 1, 0x88, 0xA4};
    memset(frame, 0, sizeof frame);
    memcpy(frame, header, sizeof header);
    length = 16;
}

/* Adds a datagram; gives where its data stand. Its working counter stands behind them. */
static size_t add(int command, unsigned adp, unsigned ado, const void *data, size_t bytes)
{
    static uint8_t index;
    size_t at = length;
    frame[at] = (uint8_t)command;
    frame[at + 1] = index++;
    put(frame + at + 2, adp, 2);
    put(frame + at + 4, ado, 2);
    put(frame + at + 6, bytes, 2);
    memcpy(frame + at + 10, data, bytes);
    length = at + 10 + bytes + 2;
    return at + 10;
}

/* Sends the frame, and waits for its answer, which takes its place. 0 if it is lost. */
static int exchange_frame(void)
{
    uint8_t index = frame[17];
    size_t on_wire = length < 60 ? 60 : length;
    put(frame + 14, 0x1000 | (length - 16), 2);
    if (nic_send(frame, on_wire) != 0)
        give_up("can't send");
    for (;;) {
        int came = nic_receive(frame, sizeof frame, TIMEOUT);
        if (came < 0)
            give_up("can't receive");
        if (came == 0)
            return 0;
        if (frame[17] == index)
            return 1;
    }
}

/* One datagram, by itself; gives its working counter. */
static unsigned access_with(int command, unsigned adp, unsigned ado, void *data, size_t bytes)
{
    size_t at;
    begin();
    at = add(command, adp, ado, data, bytes);
    if (!exchange_frame())
        return 0;
    memcpy(data, frame + at, bytes);
    return (unsigned)get(frame + at + bytes, 2);
}

static void write_to(int drive, unsigned address, uint64_t value, size_t bytes)
{
    uint8_t data[8];
    put(data, value, bytes);
    if (access_with(FPWR, (unsigned)(STATION + drive), address, data, bytes) != 1)
        give_up("a drive did not take what was written");
}

static uint64_t read_from(int drive, unsigned address, size_t bytes)
{
    uint8_t data[8] = {0};
    if (access_with(FPRD, (unsigned)(STATION + drive), address, data, bytes) != 1)
        give_up("a drive was not read");
    return get(data, bytes);
}

/* The frame of a cycle: the reference time for all, and the process data. Gives the working counter of the process data. */
static unsigned cycle(int64_t *dc_time)
{
    uint8_t nothing[8] = {0};
    size_t time, data;
    begin();
    time = add(FRMW, STATION, 0x0910, nothing, sizeof nothing);
    frame[time - 3] |= 0x80; /* another datagram follows: the highest bit of its length */
    data = add(LRW, 0, 0, image, sizeof image);
    if (!exchange_frame())
        return 0;
    *dc_time = (int64_t)get(frame + time, 8);
    memcpy(image, frame + data, sizeof image);
    return (unsigned)get(frame + data + sizeof image, 2);
}

/* Waits for the next cycle, and lets the instant of the one behind it follow the reference clock, which is to be at 0 of its cycle. */
static unsigned paced_cycle(void)
{
    int64_t dc_time = 0, off;
    unsigned counter;
    os_sleep_until(due);
    counter = cycle(&dc_time);
    off = dc_time % CYCLE;
    due += CYCLE - (off > CYCLE / 2 ? off - CYCLE : off) / 16;
    return counter;
}

/* Asks the drives for a state, and goes on with the exchange until they are there. */
static void reach(uint8_t state)
{
    int drive, tries;
    for (drive = 0; drive < DRIVES; drive++)
        write_to(drive, 0x0120, state, 2);
    for (drive = 0, tries = 0; drive < DRIVES; drive++)
        while ((read_from(drive, 0x0130, 2) & 0x1F) != state) {
            if (tries++ == 3000)
                give_up("a drive does not come to the state that it was asked for");
            paced_cycle();
        }
}

static void scan(void)
{
    uint8_t data[2] = {0};
    unsigned found = access_with(BRD, 0, 0x0130, data, 2), at;
    printf("%u SubDevices\n", found);
    if (found < DRIVES)
        give_up("too few SubDevices");
    data[0] = INIT | ACKNOWLEDGE;
    access_with(BWR, 0, 0x0120, data, 2);
    data[0] = 0;
    access_with(BWR, 0, 0x0981, data, 1); /* SYNC off, whatever ran before */
    for (at = 0; at < found; at++) {
        put(data, STATION + at, 2);
        access_with(APWR, 0u - at, 0x0010, data, 2);
    }
}

static void set_up_memory(int drive)
{
    unsigned inputs_and_outputs = (unsigned)(BYTES / DRIVES * drive);
    write_to(drive, 0x0810, 0x0001006400071200, 8); /* outputs: 7 bytes at 0x1200 */
    write_to(drive, 0x0818, 0x0001002000071400, 8); /* inputs: 7 bytes at 0x1400 */
    write_to(drive, 0x0600, 0x0700000700000000 | inputs_and_outputs, 8);
    write_to(drive, 0x0608, 0x0000000102001200, 8);
    write_to(drive, 0x0610, 0x0700000700000000 | inputs_and_outputs, 8);
    write_to(drive, 0x0618, 0x0000000101001400, 8);
}

/* Delay and offset of each drive against the first one, whose clock leads. They stand in a line. */
static void set_up_clocks(void)
{
    uint8_t latch[4] = {0};
    uint64_t reference = 0, loop = 0;
    int drive, number;
    access_with(BWR, 0, 0x0900, latch, sizeof latch);
    for (drive = 0; drive < DRIVES; drive++) {
        uint32_t out = (uint32_t)read_from(drive, 0x0900, 4), back = (uint32_t)read_from(drive, 0x0904, 4);
        int goes_on = (read_from(drive, 0x0110, 2) & 0x20) != 0; /* there is a link at port 1 */
        uint64_t received = read_from(drive, 0x0918, 8), behind = goes_on ? back - out : 0, delay;
        if (drive == 0) {
            reference = received;
            loop = behind;
        }
        delay = (loop - behind) / 2;
        write_to(drive, 0x0920, reference + delay - received, 8);
        write_to(drive, 0x0928, delay, 4);
        write_to(drive, 0x0930, 0x1000, 2); /* forgets what was filtered before the clock was set */
        printf("drive %d: delay %" PRIu64 " ns\n", drive, delay);
    }
    /* The clocks converge. With the 15 000 frames that are usual, SYNC0 would be off by some 900 ns at first. */
    for (number = 0; number < 60000; number++) {
        uint8_t time[8] = {0};
        access_with(FRMW, STATION, 0x0910, time, sizeof time);
    }
}

/* SYNC0 at the phase of the plan, with a look whether it runs. Frames are at 0 of the cycle. */
static void set_up_sync(void)
{
    uint64_t start, first, next;
    int drive, wait;
    start = read_from(0, 0x0910, 8) / (uint64_t)CYCLE * (uint64_t)CYCLE + 100 * (uint64_t)CYCLE + shift;
    for (drive = 0; drive < DRIVES; drive++) {
        write_to(drive, 0x09A0, (uint64_t)CYCLE, 8);
        write_to(drive, 0x0990, start, 8);
        write_to(drive, 0x0981, 3, 1);
    }
    for (wait = 0; wait < 150; wait++)
        paced_cycle();
    for (drive = 0; drive < DRIVES; drive++) {
        first = read_from(drive, 0x0990, 8);
        paced_cycle();
        paced_cycle();
        next = read_from(drive, 0x0990, 8);
        printf("drive %d: 0x092C %" PRIu64 " ns, SYNC0 %s\n", drive, read_from(drive, 0x092C, 4) & 0x7FFFFFFF,
               next != first ? "runs" : "stands");
    }
}

/* Asks the plan where SYNC0 belongs. */
static void ask_plan(void)
{
    isocat_plan *plan = NULL;
    isocat_plan_device device = {0};
    device.size = sizeof device;
    if (isocat_plan_new(port_segment(), &plan, NULL) < 0 || isocat_plan_get_device(plan, 0, &device, NULL) < 0)
        give_up("there is no plan");
    shift = (uint64_t)device.sync0_phase_ns;
    printf("plan: mode %s, SYNC0 %" PRIu64 " ns behind the frame\n", device.mode, shift);
    isocat_plan_free(plan);
}

static int tell_verdict(void)
{
    isocat_verdict *verdict = NULL;
    isocat_verdict_summary summary = {0};
    size_t at, number;
    isocat_bus_finish(port_bus(), NULL);
    summary.size = sizeof summary;
    if (isocat_bus_verdict(port_bus(), &verdict, NULL) < 0 || isocat_verdict_get_summary(verdict, &summary, NULL) < 0)
        give_up("there is no verdict");
    printf("%" PRIu64 " frames, %" PRIu64 " lost; %zu SubDevices in OP, judged for %.3f s: %s\n", summary.frames, summary.lost,
           summary.in_op, (double)summary.judged_ns / 1e9, summary.answer == ISOCAT_IN_SYNC ? "in sync" : "not in sync");
    for (at = 0; at < DRIVES; at++) {
        isocat_device_verdict device = {0};
        device.size = sizeof device;
        if (isocat_verdict_get_device(verdict, at, &device, NULL) < 0)
            break;
        printf("%s: %s, %s, SYNC0 within %.1f ns, least margin %.3f us\n", device.name, device.state, device.mode,
               device.sync0_worst_ns, device.least_margin_ns / 1e3);
        for (number = 0; number < device.findings; number++)
            printf("  %s\n", isocat_verdict_finding(verdict, at, number));
    }
    printf("wire %016" PRIx64 "\n", port_hash());
    isocat_verdict_free(verdict);
    return summary.answer;
}

int main(int argc, char **argv)
{
    long cycles = argc > 1 ? strtol(argv[1], NULL, 10) : 10000, number, missed = 0;
    uint8_t down[2] = {INIT, 0};
    int drive, answer;
    if (nic_setup(argc > 2 ? argv[2] : NULL) != 0)
        return 2;
    ask_plan();
    scan();
    for (drive = 0; drive < DRIVES; drive++) {
        write_to(drive, 0x0800, 0x0001002601001000, 8); /* mailbox: 256 bytes at 0x1000 and 0x1100 */
        write_to(drive, 0x0808, 0x0001002201001100, 8);
    }
    due = os_now();
    reach(PREOP);
    for (drive = 0; drive < DRIVES; drive++)
        set_up_memory(drive);
    set_up_clocks();
    due = os_now();
    for (number = 0; number < 250; number++) /* frames come to their phase */
        paced_cycle();
    set_up_sync();
    reach(SAFEOP);
    reach(OP);
    for (number = 0; number < cycles; number++) {
        put(image, (uint64_t)number, 2);
        missed += paced_cycle() != OUTPUTS_AND_INPUTS;
    }
    printf("%ld cycles, %ld of them incomplete\n", cycles, missed);
    access_with(BWR, 0, 0x0120, down, 2);
    answer = tell_verdict();
    nic_close();
    return answer;
}

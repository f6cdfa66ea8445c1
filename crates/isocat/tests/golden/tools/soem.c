// The segment for SOEM 2: PROGRAM INTERFACE [CYCLES]. Made of segment.toml by isocat plan.
// Fits with assumptions: least slack 985 ns, SubDevice 1 (stage): calc and copy time <= SYNC1 -
// SYNC0.
// Assumed: SubDevice 0 (axis 1): calc and copy of outputs 60 us: 0x1C32:06: not published; about a
// quarter of the minimum cycle, as other drives of this class state
// Assumed: SubDevice 0 (axis 1): calc and copy of inputs 40 us: 0x1C33:06: not published; from
// Input Latch on, so the 40 us of the application are in it; copying goes on beside them
// Assumed: SubDevice 0 (axis 1): delay of outputs 30 us: 0x1C32:09: not published; one power stage
// update of 30 us, and ETG.1020 asks for less than 1 us between them
// Assumed: SubDevice 1 (stage): share of the clock error in it 3 ns: the device states 0 or
// nothing; its profile knows its CPU
// Assumed: SubDevice 1 (stage): share of the clock error in it 238 ns: the device states 0 or
// nothing; its profile knows its CPU
// Assumed: SubDevice 2 (axis 2): calc and copy of outputs 15 us: 0x1C32:06: build constants of the
// application, not in the ESI; they fit into the minimum cycle time
// Assumed: SubDevice 2 (axis 2): calc and copy of inputs 8 us: 0x1C33:06: build constants of the
// application, not in the ESI; they fit into the minimum cycle time
// Assumed: SubDevice 2 (axis 2): delay of outputs 1 us: 0x1C32:09: build constants of the
// application, not in the ESI; they fit into the minimum cycle time
// LIMIT: SOEM does not look whether SYNC0 runs; the program reads 0x0990 twice.
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "soem/soem.h"

// Bus cycle: frames with gaps 9.6 us [wire] + one acyclic frame 6.72 us [wire] + send jitter 20 us
// [asked for] + jitter of hops 136 ns [chip] + clock error 240 ns [computed from drift loops and
// hops] + 100 ppm of it and a tick 210 ns [assumed] <= cycle 2 ms [asked for], slack 1.963094 ms
static const int64 CYCLE = 2000000;
// Phase of the frame at the reference clock, in the cycle of system time. It may be late by 20136
// ns.
static const int64 SEND_PHASE = 0;
static uint8 image[68];
static ecx_contextt ctx;

typedef struct
{
   uint32 vendor, product;
   uint32 outputs, inputs; // bytes
} expected;

// What must be there, by position. SOEM counts from 1.
static const expected DEVICES[] = {
   {0, 0, 0, 0},
   // 1: axis 1, mode dc-sync0, as it is wished, or the highest that the device has
   {0x0000006A, 0x00ACD200, 7, 7},
   // 2: stage, mode dc-sync1, as it is wished, or the highest that the device has
   {0x69736F63, 0x0004FFFF, 4, 4},
   // 3: axis 2, mode dc-sync0, as it is wished, or the highest that the device has
   {0x0048504D, 0x00000003, 7, 7},
   // 4: io, mode sm, as it is wished, or the highest that the device has
   {0x69736F63, 0x00100010, 16, 16},
   // 5: coupler, mode free-run, as it is wished, or the highest that the device has
   {0x00000002, 0x044C2C52, 0, 0},
};
#define COUNT ((int)(sizeof DEVICES / sizeof DEVICES[0]) - 1)

// SubDevice 1 (stage): mode dc-sync1, as it is wished, or the highest that the device has.
// Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the first
// one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
static int set_up_2(ecx_contextt *context, uint16 slave)
{
   int written = 1;

   // synchronization: 3 (DC SYNC1)
   written &= ecx_SDOwrite(context, slave, 0x1C32, 0x01, FALSE, 2, (uint8[]){0x03, 0x00}, EC_TIMEOUTRXM) > 0;
   // synchronization: 2 ms
   written &= ecx_SDOwrite(context, slave, 0x1C32, 0x02, FALSE, 4, (uint8[]){0x80, 0x84, 0x1E, 0x00}, EC_TIMEOUTRXM) > 0;
   // synchronization: 3 (DC SYNC1)
   written &= ecx_SDOwrite(context, slave, 0x1C33, 0x01, FALSE, 2, (uint8[]){0x03, 0x00}, EC_TIMEOUTRXM) > 0;
   // synchronization: 2 ms
   written &= ecx_SDOwrite(context, slave, 0x1C33, 0x02, FALSE, 4, (uint8[]){0x80, 0x84, 0x1E, 0x00}, EC_TIMEOUTRXM) > 0;
   if (!written)
      fprintf(stderr, "%d: an object was not written\n", slave);
   return written;
}

// SubDevice 2 (axis 2): mode dc-sync0, as it is wished, or the highest that the device has.
// Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the first
// one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
static int set_up_3(ecx_contextt *context, uint16 slave)
{
   int written = 1;

   // PDO assignment: count 0
   written &= ecx_SDOwrite(context, slave, 0x1C12, 0x00, FALSE, 1, (uint8[]){0x00}, EC_TIMEOUTRXM) > 0;
   // PDO assignment: 0x1600
   written &= ecx_SDOwrite(context, slave, 0x1C12, 0x01, FALSE, 2, (uint8[]){0x00, 0x16}, EC_TIMEOUTRXM) > 0;
   // PDO assignment: count 1
   written &= ecx_SDOwrite(context, slave, 0x1C12, 0x00, FALSE, 1, (uint8[]){0x01}, EC_TIMEOUTRXM) > 0;
   // PDO assignment: count 0
   written &= ecx_SDOwrite(context, slave, 0x1C13, 0x00, FALSE, 1, (uint8[]){0x00}, EC_TIMEOUTRXM) > 0;
   // PDO assignment: 0x1A00
   written &= ecx_SDOwrite(context, slave, 0x1C13, 0x01, FALSE, 2, (uint8[]){0x00, 0x1A}, EC_TIMEOUTRXM) > 0;
   // PDO assignment: count 1
   written &= ecx_SDOwrite(context, slave, 0x1C13, 0x00, FALSE, 1, (uint8[]){0x01}, EC_TIMEOUTRXM) > 0;
   // synchronization: 2 (DC SYNC0)
   written &= ecx_SDOwrite(context, slave, 0x1C32, 0x01, FALSE, 2, (uint8[]){0x02, 0x00}, EC_TIMEOUTRXM) > 0;
   // synchronization: 2 (DC SYNC0)
   written &= ecx_SDOwrite(context, slave, 0x1C33, 0x01, FALSE, 2, (uint8[]){0x02, 0x00}, EC_TIMEOUTRXM) > 0;
   if (!written)
      fprintf(stderr, "%d: an object was not written\n", slave);
   return written;
}

static void word(uint16 slave, uint16 address, uint16 value)
{
   value = htoes(value);
   ecx_FPWR(&ctx.port, ctx.slavelist[slave].configadr, address, sizeof value, &value, EC_TIMEOUTRET);
}

// Slaves with SYNC pulses.
static const uint16 WITH_PULSES[] = {1, 2, 3, 0};

static void registers(void)
{
   // axis 1: SYNC0 every 2000000 ns: 0x1C32:05: minimum cycle 250 us [0x1C32:05] <= cycle 2 ms
   // [asked for], slack 1.75 ms.
   // Phase 1024000 ns: the frame is at the reference clock at 0 ns, the pulse that acts lies at
   // 1.024 ms in all devices with DC, outputs are ready at 89.016 us, inputs are too late from
   // 1.95926 ms on.
   ecx_dcsync0(&ctx, 1, TRUE, 2000000, 1024000);
   // stage: SYNC0 every 2000000 ns: 0x1C32:05: minimum cycle 60 us [0x1C32:05] <= cycle 2 ms [asked
   // for], slack 1.94 ms.
   // Phase 1003000 ns: the frame is at the reference clock at 0 ns, the pulse that acts lies at
   // 1.024 ms in all devices with DC, outputs are ready at 50.781 us, inputs are too late from
   // 1.988525 ms on.
   // SYNC1 21000 ns after SYNC0: mode dc-sync1; 0x1C32:06: calc and copy of outputs 20 us
   // [0x1C32:06] + 100 ppm of it and a tick 12 ns [assumed] + share of the clock error in it 3 ns
   // [assumed] <= SYNC0 to SYNC1 21 us [plan], slack 985 ns; 0x1C32:02: SYNC0 to SYNC1 21 us [plan]
   // + share of the clock error in it 238 ns [assumed] + tick of the pulse 10 ns [chip] + less, not
   // equal 1 ns [plan] <= SYNC0 cycle 2 ms [asked for], slack 1.978751 ms.
   ecx_dcsync01(&ctx, 2, TRUE, 2000000, 21000, 1003000);
   // axis 2: SYNC0 every 2000000 ns: 0x1C32:05: minimum cycle 31.2 us [0x1C32:05] <= cycle 2 ms
   // [asked for], slack 1.9688 ms.
   // Phase 1024000 ns: the frame is at the reference clock at 0 ns, the pulse that acts lies at
   // 1.024 ms in all devices with DC, outputs are ready at 45.546 us, inputs are too late from
   // 1.99299 ms on.
   ecx_dcsync0(&ctx, 3, TRUE, 2000000, 1024000);
}

// A frame now, or at `due`, which then becomes the next instant. It carries the drift datagram,
// too.
static void exchange(struct timespec *due)
{
   int64 off;
   if (due)
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, due, NULL);
   ecx_send_processdata(&ctx);
   ecx_receive_processdata(&ctx, EC_TIMEOUTRET);
   if (!due)
      return;
   // When it was at the reference clock: 0 is wanted.
   off = (ctx.DCtime - SEND_PHASE) % CYCLE;
   if (off > CYCLE / 2)
      off -= CYCLE;
   if (off < -CYCLE / 2)
      off += CYCLE;
   due->tv_nsec += CYCLE - off / 16;
   while (due->tv_nsec >= 1000000000)
      due->tv_sec++, due->tv_nsec -= 1000000000;
}

static void ask(uint16 state)
{
   ctx.slavelist[0].state = state;
   ecx_writestate(&ctx, 0);
}

static uint32 next_pulse(uint16 slave)
{
   uint32 time = 0;
   ecx_FPRD(&ctx.port, ctx.slavelist[slave].configadr, 0x0990, sizeof time, &time, EC_TIMEOUTRET);
   return etohl(time);
}

int main(int argc, char **argv)
{
   struct timespec due;
   int at, cycle, wrong = 0, cycles = argc > 2 ? atoi(argv[2]) : 3000;
   if (argc < 2 || !ecx_init(&ctx, argv[1]))
      return 2;
   // Else the mapping asks for SAFEOP before SYNC is set up.
   ctx.manualstatechange = 1;
   if (ecx_config_init(&ctx) != COUNT)
      return 1;
   for (at = 1; at <= COUNT; at++)
      wrong |= ctx.slavelist[at].eep_man != DEVICES[at].vendor || ctx.slavelist[at].eep_id != DEVICES[at].product;
   ask(EC_STATE_PRE_OP);
   ecx_statecheck(&ctx, 0, EC_STATE_PRE_OP, EC_TIMEOUTSTATE);
   ctx.slavelist[2].PO2SOconfig = set_up_2;
   ctx.slavelist[3].PO2SOconfig = set_up_3;
   ecx_config_map_group(&ctx, image, 0);
   for (at = 1; at <= COUNT; at++)
      wrong |= ctx.slavelist[at].Obytes != DEVICES[at].outputs || ctx.slavelist[at].Ibytes != DEVICES[at].inputs;
   if (wrong)
      return 1;
   ecx_configdc(&ctx);
   // Filters of the drift loops: with those of reset, 0 and 12, a loop learns its speed too slowly.
   for (at = 0; WITH_PULSES[at]; at++)
      word(WITH_PULSES[at], 0x0934, 4 | 6 << 8);
   // The clocks converge, then frames come to their phase.
   for (cycle = 0; cycle < 15000; cycle++)
      exchange(NULL);
   clock_gettime(CLOCK_MONOTONIC, &due);
   for (cycle = 0; cycle < 250; cycle++)
      exchange(&due);
   registers();
   // The first pulse comes after 100 ms.
   for (cycle = 0; cycle <= 200000000 / CYCLE; cycle++)
      exchange(&due);
   for (at = 0; WITH_PULSES[at]; at++)
   {
      uint32 pulse = next_pulse(WITH_PULSES[at]);
      // Ten cycles are longer than any period of SYNC0 that is used with them.
      osal_usleep((uint32)(10 * CYCLE / 1000));
      printf("%d: SYNC0 %s\n", WITH_PULSES[at], next_pulse(WITH_PULSES[at]) != pulse ? "runs" : "stands");
   }
   clock_gettime(CLOCK_MONOTONIC, &due);
   for (cycle = 0; cycle < cycles; cycle++)
   {
      // In phase again; then up, without a pause in the cycle.
      if (cycle == 250)
         ask(EC_STATE_SAFE_OP);
      if (cycle == 500)
         ask(EC_STATE_OPERATIONAL);
      // Read inputs and write outputs here.
      exchange(&due);
   }
   ecx_readstate(&ctx);
   for (at = 1; at <= ctx.slavecount; at++)
      printf("%d: state %d, %s\n", at, ctx.slavelist[at].state, ec_ALstatuscode2string(ctx.slavelist[at].ALstatuscode));
   ask(EC_STATE_INIT);
   return 0;
}

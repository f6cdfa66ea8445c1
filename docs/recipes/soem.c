/* SOEM 2 on the segment of docs/recipes.md: clocks, SYNC0 by the plan's figures, a look whether it runs, OP.
 * soem INTERFACE [CYCLES] */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "soem/soem.h"

static const int64 CYCLE = 4000000, SHIFT = 2024000; /* ns; SHIFT is the acting pulse of `isocat plan` */
static const uint16 WITH_SYNC0[] = {1, 2};           /* whose mode in the plan is dc-sync0; SOEM counts from 1 */
static ecx_contextt ctx;
static uint8 image[4096];

/* A frame now, or at `due`, which then becomes the next instant. It carries the drift datagram, too. */
static void exchange(struct timespec *due)
{
   int64 off;
   if (due)
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, due, NULL);
   ecx_send_processdata(&ctx);
   ecx_receive_processdata(&ctx, EC_TIMEOUTRET);
   if (!due)
      return;
   off = ctx.DCtime % CYCLE; /* when it was at the reference clock: 0 of the cycle is wanted */
   if (off > CYCLE / 2)
      off -= CYCLE;
   due->tv_nsec += CYCLE - off / 16;
   while (due->tv_nsec >= 1000000000)
      due->tv_sec++, due->tv_nsec -= 1000000000;
}

static void ask(uint16 state)
{
   ctx.slavelist[0].state = state;
   ecx_writestate(&ctx, 0);
}

int main(int argc, char **argv)
{
   struct timespec due;
   int at, cycle, cycles = argc > 2 ? atoi(argv[2]) : 3000;
   if (argc < 2 || !ecx_init(&ctx, argv[1]))
      return 2;
   ctx.manualstatechange = 1; /* else the mapping asks for SAFEOP before SYNC is set up */
   if (ecx_config_init(&ctx) <= 0)
      return 1;
   ask(EC_STATE_PRE_OP);
   ecx_statecheck(&ctx, 0, EC_STATE_PRE_OP, EC_TIMEOUTSTATE);
   ecx_config_map_group(&ctx, image, 0);
   ecx_configdc(&ctx);
   for (at = 0; at < 2; at++) /* the drift loops' filters: with those of reset, 0 and 12, a loop learns its speed too slowly */
   {
      uint8 filters[] = {4, 6};
      ecx_FPWR(&ctx.port, ctx.slavelist[WITH_SYNC0[at]].configadr, 0x0934, 2, filters, EC_TIMEOUTRET);
   }
   for (cycle = 0; cycle < 15000; cycle++) /* the clocks converge */
      exchange(NULL);
   clock_gettime(CLOCK_MONOTONIC, &due);
   for (cycle = 0; cycle < 250; cycle++) /* frames come to their phase */
      exchange(&due);
   for (at = 0; at < 2; at++)
      ecx_dcsync0(&ctx, WITH_SYNC0[at], TRUE, CYCLE, SHIFT);
   for (cycle = 0; cycle < 50; cycle++) /* the first pulse comes after 100 ms */
      exchange(&due);
   for (at = 0; at < 2; at++)
   {
      uint16 address = ctx.slavelist[WITH_SYNC0[at]].configadr;
      uint32 difference = 0, pulse = 0, next = 0;
      ecx_FPRD(&ctx.port, address, 0x092C, 4, &difference, EC_TIMEOUTRET);
      ecx_FPRD(&ctx.port, address, 0x0990, 4, &pulse, EC_TIMEOUTRET);
      osal_usleep(10000);
      ecx_FPRD(&ctx.port, address, 0x0990, 4, &next, EC_TIMEOUTRET);
      printf("%d: 0x092C %u ns, SYNC0 %s\n", WITH_SYNC0[at], etohl(difference) & 0x7FFFFFFF,
             next != pulse ? "runs" : "stands");
   }
   clock_gettime(CLOCK_MONOTONIC, &due);
   for (cycle = 0; cycle < cycles; cycle++)
   {
      if (cycle == 250) /* in phase again; without a pause in the cycle */
         ask(EC_STATE_SAFE_OP);
      if (cycle == 500)
         ask(EC_STATE_OPERATIONAL);
      exchange(&due);
   }
   ecx_readstate(&ctx);
   for (at = 1; at <= ctx.slavecount; at++)
      printf("%d: state %d, %s\n", at, ctx.slavelist[at].state, ec_ALstatuscode2string(ctx.slavelist[at].ALstatuscode));
   ask(EC_STATE_INIT);
   return 0;
}

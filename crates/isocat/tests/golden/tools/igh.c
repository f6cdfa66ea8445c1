// The segment for the IgH EtherCAT Master. Made of segment.toml by isocat plan.
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
// LIMIT: up to 1.5.2 the start time lies on a grid of sync0_cycle + sync1_cycle, so that a SYNC1
// that is no multiple of SYNC0 puts SYNC0 on another phase at each start. Compare 0x0990 with the
// plan's phase.

#include <stddef.h>
#include <stdint.h>
#include <ecrt.h>

// Bus cycle: frames with gaps 9.6 us [wire] + one acyclic frame 6.72 us [wire] + send jitter 20 us
// [asked for] + jitter of hops 136 ns [chip] + clock error 240 ns [computed from drift loops and
// hops] + 100 ppm of it and a tick 210 ns [assumed] <= cycle 2 ms [asked for], slack 1.963094 ms
#define CYCLE_NS 2000000
// Frames are sent at this phase of the application time, and late by no more than the jitter.
#define SEND_PHASE_NS 0
#define SEND_JITTER_NS 20136
#define DEVICES 5

// SubDevice 0 (axis 1): mode dc-sync0, as it is wished, or the highest that the device has.
// Note: read-only in PREOP, and different there: 0x1C32:01 (0 (Free Run) instead of 2 (DC SYNC0)),
// 0x1C33:01 (0 (Free Run) instead of 2 (DC SYNC0)). The types follow from the SYNC unit on the way
// to SAFEOP, so its registers must be final before SAFEOP is asked for
static ec_pdo_entry_info_t entries_0_1600[] = {
   {0x6040, 0x00, 16},
   {0x607A, 0x00, 32},
   {0x6060, 0x00, 8},
};
static ec_pdo_info_t pdos_0_sm2[] = {
   {0x1600, 3, entries_0_1600},
};
static ec_pdo_entry_info_t entries_0_1a00[] = {
   {0x6041, 0x00, 16},
   {0x6064, 0x00, 32},
   {0x6061, 0x00, 8},
};
static ec_pdo_info_t pdos_0_sm3[] = {
   {0x1A00, 3, entries_0_1a00},
};
// 7 bytes of outputs, 7 of inputs; the watchdog as the SyncManager's control byte has it.
static const ec_sync_info_t syncs_0[] = {
   {2, EC_DIR_OUTPUT, 1, pdos_0_sm2, EC_WD_ENABLE},
   {3, EC_DIR_INPUT, 1, pdos_0_sm3, EC_WD_DISABLE},
   {0xff, EC_DIR_INVALID, 0, NULL, EC_WD_DEFAULT},
};

// SubDevice 1 (stage): mode dc-sync1, as it is wished, or the highest that the device has.
// Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the first
// one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
static ec_pdo_entry_info_t entries_1_1600[] = {
   {0x7000, 0x01, 32},
};
static ec_pdo_info_t pdos_1_sm2[] = {
   {0x1600, 1, entries_1_1600},
};
static ec_pdo_entry_info_t entries_1_1a00[] = {
   {0x6000, 0x01, 32},
};
static ec_pdo_info_t pdos_1_sm3[] = {
   {0x1A00, 1, entries_1_1a00},
};
// 4 bytes of outputs, 4 of inputs; the watchdog as the SyncManager's control byte has it.
static const ec_sync_info_t syncs_1[] = {
   {2, EC_DIR_OUTPUT, 1, pdos_1_sm2, EC_WD_ENABLE},
   {3, EC_DIR_INPUT, 1, pdos_1_sm3, EC_WD_DISABLE},
   {0xff, EC_DIR_INVALID, 0, NULL, EC_WD_DEFAULT},
};

// SubDevice 2 (axis 2): mode dc-sync0, as it is wished, or the highest that the device has.
// Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the first
// one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
static ec_pdo_entry_info_t entries_2_1600[] = {
   {0x6040, 0x00, 16},
   {0x607A, 0x00, 32},
   {0x6060, 0x00, 8},
};
static ec_pdo_info_t pdos_2_sm2[] = {
   {0x1600, 3, entries_2_1600},
};
static ec_pdo_entry_info_t entries_2_1a00[] = {
   {0x6041, 0x00, 16},
   {0x6064, 0x00, 32},
   {0x6061, 0x00, 8},
};
static ec_pdo_info_t pdos_2_sm3[] = {
   {0x1A00, 3, entries_2_1a00},
};
// 7 bytes of outputs, 7 of inputs; the watchdog as the SyncManager's control byte has it.
static const ec_sync_info_t syncs_2[] = {
   {2, EC_DIR_OUTPUT, 1, pdos_2_sm2, EC_WD_ENABLE},
   {3, EC_DIR_INPUT, 1, pdos_2_sm3, EC_WD_DISABLE},
   {0xff, EC_DIR_INVALID, 0, NULL, EC_WD_DEFAULT},
};

// SubDevice 3 (io): mode sm, as it is wished, or the highest that the device has.
static ec_pdo_entry_info_t entries_3_1600[] = {
   {0x7000, 0x01, 8},
   {0x7000, 0x02, 8},
   {0x7000, 0x03, 8},
   {0x7000, 0x04, 8},
   {0x7000, 0x05, 8},
   {0x7000, 0x06, 8},
   {0x7000, 0x07, 8},
   {0x7000, 0x08, 8},
   {0x7000, 0x09, 8},
   {0x7000, 0x0A, 8},
   {0x7000, 0x0B, 8},
   {0x7000, 0x0C, 8},
   {0x7000, 0x0D, 8},
   {0x7000, 0x0E, 8},
   {0x7000, 0x0F, 8},
   {0x7000, 0x10, 8},
};
static ec_pdo_info_t pdos_3_sm2[] = {
   {0x1600, 16, entries_3_1600},
};
static ec_pdo_entry_info_t entries_3_1a00[] = {
   {0x6000, 0x01, 8},
   {0x6000, 0x02, 8},
   {0x6000, 0x03, 8},
   {0x6000, 0x04, 8},
   {0x6000, 0x05, 8},
   {0x6000, 0x06, 8},
   {0x6000, 0x07, 8},
   {0x6000, 0x08, 8},
   {0x6000, 0x09, 8},
   {0x6000, 0x0A, 8},
   {0x6000, 0x0B, 8},
   {0x6000, 0x0C, 8},
   {0x6000, 0x0D, 8},
   {0x6000, 0x0E, 8},
   {0x6000, 0x0F, 8},
   {0x6000, 0x10, 8},
};
static ec_pdo_info_t pdos_3_sm3[] = {
   {0x1A00, 16, entries_3_1a00},
};
// 16 bytes of outputs, 16 of inputs; the watchdog as the SyncManager's control byte has it.
static const ec_sync_info_t syncs_3[] = {
   {2, EC_DIR_OUTPUT, 1, pdos_3_sm2, EC_WD_ENABLE},
   {3, EC_DIR_INPUT, 1, pdos_3_sm3, EC_WD_DISABLE},
   {0xff, EC_DIR_INVALID, 0, NULL, EC_WD_DEFAULT},
};

// SubDevice 4 (coupler): mode free-run, as it is wished, or the highest that the device has.

// First bytes of the outputs and inputs of each device in the domain; -1 for none.
static int outputs_at[DEVICES], inputs_at[DEVICES];

// Before ecrt_master_activate(). 0, or the error of the call that failed.
int configure(ec_master_t *master, ec_domain_t *domain, ec_slave_config_t *sc[DEVICES])
{
   int code = 0, i;

   for (i = 0; i < DEVICES; i++)
      outputs_at[i] = inputs_at[i] = -1;

   // axis 1 (0); revision 0x00000001 is not checked by this master.
   if (!(sc[0] = ecrt_master_slave_config(master, 0, 0, 0x0000006A, 0x00ACD200)))
      return -1;
   // PDO assignment and mapping; the master writes 0x1C12, 0x1C13 and mappings where they differ.
   if ((code = ecrt_slave_config_pdos(sc[0], EC_END, syncs_0)))
      return code;
   outputs_at[0] = ecrt_slave_config_reg_pdo_entry_pos(sc[0], 2, 0, 0, domain, NULL);
   if (outputs_at[0] < 0)
      return outputs_at[0];
   inputs_at[0] = ecrt_slave_config_reg_pdo_entry_pos(sc[0], 3, 0, 0, domain, NULL);
   if (inputs_at[0] < 0)
      return inputs_at[0];
   // AssignActivate 0x0300: the pulses of mode dc-sync0, with all units at the MainDevice.
   // sync0_cycle 2000000 ns: 0x1C32:05: minimum cycle 250 us [0x1C32:05] <= cycle 2 ms [asked for],
   // slack 1.75 ms.
   // sync0_shift 1024000 ns, against multiples of the cycle in the application time: the frame is
   // at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC,
   // outputs are ready at 89.016 us, inputs are too late from 1.95926 ms on.
   ecrt_slave_config_dc(sc[0], 0x0300, 2000000, 1024000, 0, 0);

   // stage (1); revision 0x00000001 is not checked by this master.
   if (!(sc[1] = ecrt_master_slave_config(master, 0, 1, 0x69736F63, 0x0004FFFF)))
      return -1;
   // PDO assignment and mapping; the master writes 0x1C12, 0x1C13 and mappings where they differ.
   if ((code = ecrt_slave_config_pdos(sc[1], EC_END, syncs_1)))
      return code;
   outputs_at[1] = ecrt_slave_config_reg_pdo_entry_pos(sc[1], 2, 0, 0, domain, NULL);
   if (outputs_at[1] < 0)
      return outputs_at[1];
   inputs_at[1] = ecrt_slave_config_reg_pdo_entry_pos(sc[1], 3, 0, 0, domain, NULL);
   if (inputs_at[1] < 0)
      return inputs_at[1];
   // synchronization: 3 (DC SYNC1)
   if ((code = ecrt_slave_config_sdo16(sc[1], 0x1C32, 0x01, 3u)))
      return code;
   // synchronization: 2 ms
   if ((code = ecrt_slave_config_sdo32(sc[1], 0x1C32, 0x02, 2000000u)))
      return code;
   // synchronization: 3 (DC SYNC1)
   if ((code = ecrt_slave_config_sdo16(sc[1], 0x1C33, 0x01, 3u)))
      return code;
   // synchronization: 2 ms
   if ((code = ecrt_slave_config_sdo32(sc[1], 0x1C33, 0x02, 2000000u)))
      return code;
   // AssignActivate 0x0700: the pulses of mode dc-sync1, with all units at the MainDevice.
   // sync0_cycle 2000000 ns: 0x1C32:05: minimum cycle 60 us [0x1C32:05] <= cycle 2 ms [asked for],
   // slack 1.94 ms.
   // sync0_shift 1003000 ns, against multiples of the cycle in the application time: the frame is
   // at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC,
   // outputs are ready at 50.781 us, inputs are too late from 1.988525 ms on.
   // sync1_cycle 21000 ns, register 0x09A4: mode dc-sync1; 0x1C32:06: calc and copy of outputs 20
   // us [0x1C32:06] + 100 ppm of it and a tick 12 ns [assumed] + share of the clock error in it 3
   // ns [assumed] <= SYNC0 to SYNC1 21 us [plan], slack 985 ns; 0x1C32:02: SYNC0 to SYNC1 21 us
   // [plan] + share of the clock error in it 238 ns [assumed] + tick of the pulse 10 ns [chip] +
   // less, not equal 1 ns [plan] <= SYNC0 cycle 2 ms [asked for], slack 1.978751 ms. sync1_shift is
   // ignored, or added to it.
   ecrt_slave_config_dc(sc[1], 0x0700, 2000000, 1003000, 21000, 0);

   // axis 2 (2); revision 0x00000001 is not checked by this master.
   if (!(sc[2] = ecrt_master_slave_config(master, 0, 2, 0x0048504D, 0x00000003)))
      return -1;
   // PDO assignment and mapping; the master writes 0x1C12, 0x1C13 and mappings where they differ.
   if ((code = ecrt_slave_config_pdos(sc[2], EC_END, syncs_2)))
      return code;
   outputs_at[2] = ecrt_slave_config_reg_pdo_entry_pos(sc[2], 2, 0, 0, domain, NULL);
   if (outputs_at[2] < 0)
      return outputs_at[2];
   inputs_at[2] = ecrt_slave_config_reg_pdo_entry_pos(sc[2], 3, 0, 0, domain, NULL);
   if (inputs_at[2] < 0)
      return inputs_at[2];
   // synchronization: 2 (DC SYNC0)
   if ((code = ecrt_slave_config_sdo16(sc[2], 0x1C32, 0x01, 2u)))
      return code;
   // synchronization: 2 (DC SYNC0)
   if ((code = ecrt_slave_config_sdo16(sc[2], 0x1C33, 0x01, 2u)))
      return code;
   // AssignActivate 0x0300: the pulses of mode dc-sync0, with all units at the MainDevice.
   // sync0_cycle 2000000 ns: 0x1C32:05: minimum cycle 31.2 us [0x1C32:05] <= cycle 2 ms [asked
   // for], slack 1.9688 ms.
   // sync0_shift 1024000 ns, against multiples of the cycle in the application time: the frame is
   // at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC,
   // outputs are ready at 45.546 us, inputs are too late from 1.99299 ms on.
   ecrt_slave_config_dc(sc[2], 0x0300, 2000000, 1024000, 0, 0);

   // io (3); revision 0x00000001 is not checked by this master.
   if (!(sc[3] = ecrt_master_slave_config(master, 0, 3, 0x69736F63, 0x00100010)))
      return -1;
   // PDO assignment and mapping; the master writes 0x1C12, 0x1C13 and mappings where they differ.
   if ((code = ecrt_slave_config_pdos(sc[3], EC_END, syncs_3)))
      return code;
   outputs_at[3] = ecrt_slave_config_reg_pdo_entry_pos(sc[3], 2, 0, 0, domain, NULL);
   if (outputs_at[3] < 0)
      return outputs_at[3];
   inputs_at[3] = ecrt_slave_config_reg_pdo_entry_pos(sc[3], 3, 0, 0, domain, NULL);
   if (inputs_at[3] < 0)
      return inputs_at[3];

   // coupler (4); revision 0x00120000 is not checked by this master.
   if (!(sc[4] = ecrt_master_slave_config(master, 0, 4, 0x00000002, 0x044C2C52)))
      return -1;

   // The reference clock of the plan: its first device with a clock, or the one that was chosen.
   if ((code = ecrt_master_select_reference_clock(master, sc[0])))
      return code;
   return code;
}

// Once in each cycle, at the instant whose application time is `app_time`; in operation and already
// on the way up.
// The first application time that the master gets must be a multiple of CYCLE_NS: it becomes the
// grid of all start times.
void exchange(ec_master_t *master, ec_domain_t *domain, uint64_t app_time)
{
   ecrt_master_receive(master);
   ecrt_domain_process(domain);
   // Read inputs and write outputs here.
   ecrt_master_application_time(master, app_time);
   // The reference clock follows the host. The plan counts with a host that follows the reference
   // clock, whose jitter does not reach SYNC0: for that leave this call out and steer by
   // ecrt_master_reference_clock_time().
   ecrt_master_sync_reference_clock(master);
   // All other clocks follow the reference clock.
   ecrt_master_sync_slave_clocks(master);
   ecrt_domain_queue(domain);
   ecrt_master_send(master);
}

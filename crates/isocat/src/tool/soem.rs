//! SOEM 2: a program in C that brings the segment up and keeps it in operation.

use isocat_wire::dc::AssignActivate;

use super::page::Page;
use super::sheet::Object;
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("// ");
    page.head(sheet, "The segment for SOEM 2: PROGRAM INTERFACE [CYCLES].");
    page.limits(0, &limits(sheet));
    page.line(
        "#include <stdio.h>\n#include <stdlib.h>\n#include <time.h>\n#include \"soem/soem.h\"\n",
    );
    page.note(0, format!("Bus cycle: {}", sheet.why_cycle));
    page.line(format!("static const int64 CYCLE = {};", sheet.cycle_ns));
    page.note(
        0,
        format!(
            "Phase of the frame at the reference clock, in the cycle of system time. \
        It may be late by {} ns.",
            sheet.send_jitter_ns
        ),
    );
    page.line(format!("static const int64 SEND_PHASE = {};", sheet.send_phase_ns));
    page.line(format!(
        "static uint8 image[{}];\nstatic ecx_contextt ctx;\n",
        (2 * sheet.image_bytes).max(64)
    ));
    page.line(
        "typedef struct\n{\n   uint32 vendor, product;\n   uint32 outputs, inputs; // \
        bytes\n} expected;\n",
    );
    page.note(0, "What must be there, by position. SOEM counts from 1.");
    page.line("static const expected DEVICES[] = {\n   {0, 0, 0, 0},");
    for device in &sheet.devices {
        let [outputs, inputs] = device.bytes();
        page.note(3, format!("{}: {}, {}", device.position + 1, device.name, device.why_mode));
        page.line(format!(
            "   {{0x{:08X}, 0x{:08X}, {outputs}, {inputs}}},",
            device.vendor, device.product
        ));
    }
    page.line("};\n#define COUNT ((int)(sizeof DEVICES / sizeof DEVICES[0]) - 1)\n");
    for device in &sheet.devices {
        hook(&mut page, device);
    }
    pulses(&mut page, sheet);
    page.line(EXCHANGE);
    page.line("int main(int argc, char **argv)\n{");
    page.line(BEGIN);
    for device in sheet.devices.iter().filter(|device| !device.objects.is_empty()) {
        page.line(format!("   ctx.slavelist[{0}].PO2SOconfig = set_up_{0};", device.position + 1));
    }
    page.line(CLOCKS);
    page.end() + UP
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = sheet.slower(
        "SOEM exchanges a group as a whole: give it a group of its own \
        (ecx_config_map_group) and send that as rarely",
    );
    let add = |limits: &mut Vec<String>, text: &str| limits.push(text.to_owned());
    if sheet.devices.iter().any(|device| device.watchdog.is_some()) {
        add(
            &mut limits,
            "SOEM has no call for the watchdog; its registers are written by hand below.",
        );
    }
    if sheet.with_pulses().next().is_some() {
        add(&mut limits, "SOEM does not look whether SYNC0 runs; the program reads 0x0990 twice.");
    }
    limits.extend(sheet.reference_not_first());
    if sheet.has_unusual_transitions() {
        add(
            &mut limits,
            "the hook is called before the mapping, in PREOP; another transition stands with its \
                download.",
        );
    }
    // The drives of other devices are named at their SDO downloads.
    let without_objects = sheet.devices.iter().filter(|device| device.objects.is_empty());
    let drives = |device: &Device| {
        let words = device.drives_left_out()?;
        Some(format!("SubDevice {} ({}): {words}", device.position, device.name))
    };
    limits.extend(without_objects.filter_map(drives));
    limits
}

/// The SDO downloads of a device, in the order of the plan.
fn hook(page: &mut Page, device: &Device) {
    if device.objects.is_empty() {
        return;
    }
    page.device(0, device);
    page.line(format!(
        "static int set_up_{}(ecx_contextt *context, uint16 slave)\n{{\n   int written = 1;\n",
        device.position + 1
    ));
    for Object { step, why } in &device.objects {
        let bytes: Vec<_> = step.data.iter().map(|byte| format!("0x{byte:02X}")).collect();
        let complete = if step.complete { "TRUE" } else { "FALSE" };
        page.note(3, why);
        page.line(format!(
            "   written &= ecx_SDOwrite(context, slave, 0x{:04X}, 0x{:02X}, \
            {complete}, {}, (uint8[]){{{}}}, EC_TIMEOUTRXM) > 0;",
            step.object.index,
            step.object.sub,
            step.data.len(),
            bytes.join(", ")
        ));
    }
    page.line(
        "   if (!written)\n      fprintf(stderr, \"%d: an object was not written\\n\", \
        slave);\n   return written;\n}\n",
    );
}

/// Registers that are written in PREOP, once the clocks have converged.
fn pulses(page: &mut Page, sheet: &Sheet) {
    page.line("static void word(uint16 slave, uint16 address, uint16 value)\n{");
    page.line(
        "   value = htoes(value);\n   ecx_FPWR(&ctx.port, ctx.slavelist[slave].configadr, \
        address, sizeof value, &value, EC_TIMEOUTRET);\n}\n",
    );
    page.note(0, "Slaves with SYNC pulses.");
    let with: Vec<_> =
        sheet.with_pulses().map(|(device, _)| format!("{}, ", device.position + 1)).collect();
    page.line(format!("static const uint16 WITH_PULSES[] = {{{}0}};\n", with.concat()));
    page.line("static void registers(void)\n{");
    for (device, unit) in sheet.with_pulses() {
        start(page, device, unit);
    }
    for (device, unit) in sheet.without_pulses() {
        page.note(3, format!("AssignActivate {}: {}.", unit.word, unit.why_word));
        page.line(format!("   word({}, 0x0980, 0x{:04X});", device.position + 1, unit.word.0));
    }
    for device in &sheet.devices {
        for (what, register, value) in device.watchdog.iter().flat_map(|one| one.registers()) {
            page.note(3, what);
            page.line(format!("   word({}, 0x{register:04X}, {value});", device.position + 1));
        }
    }
    page.line("}\n");
}

fn start(page: &mut Page, device: &Device, unit: &Unit) {
    let (slave, Unit { word, sync0_ns, sync1_ns, phase_ns, .. }) = (device.position + 1, unit);
    page.note(3, format!("{}: SYNC0 every {sync0_ns} ns: {}.", device.name, unit.why_sync0));
    page.note(3, format!("Phase {phase_ns} ns: {}.", unit.why_phase));
    match sync1_ns {
        0 => page.line(format!("   ecx_dcsync0(&ctx, {slave}, TRUE, {sync0_ns}, {phase_ns});")),
        _ => {
            page.note(3, format!("SYNC1 {sync1_ns} ns after SYNC0: {}.", unit.why_sync1));
            page.line(format!(
                "   ecx_dcsync01(&ctx, {slave}, TRUE, {sync0_ns}, {sync1_ns}, {phase_ns});"
            ));
        }
    }
    if ![AssignActivate::SYNC0, AssignActivate::SYNC0_AND_SYNC1].contains(word) {
        page.note(
            3,
            format!(
                "AssignActivate {word}: {}. SOEM itself writes 0x0300 or 0x0700.",
                unit.why_word
            ),
        );
        page.line(format!("   word({slave}, 0x0980, 0x{:04X});", word.0));
    }
}

const EXCHANGE: &str = "\
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
";

const BEGIN: &str = "   \
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
   ecx_statecheck(&ctx, 0, EC_STATE_PRE_OP, EC_TIMEOUTSTATE);";

const CLOCKS: &str = "   \
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
      printf(\"%d: SYNC0 %s\\n\", WITH_PULSES[at], next_pulse(WITH_PULSES[at]) != pulse ? \"runs\" : \"stands\");
   }
   clock_gettime(CLOCK_MONOTONIC, &due);";

const UP: &str = "   \
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
      printf(\"%d: state %d, %s\\n\", at, ctx.slavelist[at].state, ec_ALstatuscode2string(ctx.slavelist[at].ALstatuscode));
   ask(EC_STATE_INIT);
   return 0;
}
";

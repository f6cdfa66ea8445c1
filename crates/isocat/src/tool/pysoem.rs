//! pysoem 1.1: a program in Python that brings the segment up and keeps it in operation.

use super::page::Page;
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("# ");
    page.head(sheet, "The segment for pysoem: PROGRAM INTERFACE [CYCLES].");
    page.note(0, "Not to be named pysoem.py, or it imports itself.");
    page.limits(0, &limits(sheet));
    page.line("import sys\nimport time\n\nimport pysoem\n");
    page.note(0, format!("Bus cycle, ns: {}", sheet.why_cycle));
    page.line(format!("CYCLE = {}", sheet.cycle_ns));
    page.note(
        0,
        format!(
            "Phase of the frame at the reference clock, in the cycle of system time, \
        ns. It may be late by {} ns.",
            sheet.send_jitter_ns
        ),
    );
    page.line(format!("SEND_PHASE = {}\n", sheet.send_phase_ns));
    page.note(0, "By position: vendor, product, bytes of outputs, bytes of inputs.");
    page.line("DEVICES = [");
    for device in &sheet.devices {
        let [outputs, inputs] = device.bytes();
        page.device(4, device);
        page.line(format!(
            "    (0x{:08X}, 0x{:08X}, {outputs}, {inputs}),",
            device.vendor, device.product
        ));
    }
    page.line("]");
    objects(&mut page, sheet);
    pulses(&mut page, sheet);
    words(&mut page, sheet);
    page.end() + PROGRAM
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = sheet
        .slower("pysoem exchanges all devices in each cycle, so this one comes more often here");
    let add = |limits: &mut Vec<String>, text: &str| limits.push(text.to_owned());
    if sheet.with_pulses().next().is_some() {
        add(&mut limits, "SOEM does not look whether SYNC0 runs; the program reads 0x0990 twice.");
    }
    limits.extend(sheet.reference_not_first());
    if sheet.has_unusual_transitions() {
        add(
            &mut limits,
            "all downloads are made in PREOP, before the mapping; another transition stands with \
                its download.",
        );
    }
    limits
}

fn objects(page: &mut Page, sheet: &Sheet) {
    page.note(0, "SDO downloads in PREOP: position, index, sub-index, bytes, complete access.");
    page.line("OBJECTS = [");
    for device in &sheet.devices {
        for object in &device.objects {
            let step = &object.step;
            let bytes: String = step.data.iter().map(|byte| format!("{byte:02x}")).collect();
            let complete = if step.complete { "True" } else { "False" };
            let transition = object
                .unusual_transition()
                .map_or(String::new(), |letters| format!(", in {letters} by the plan"));
            page.note(4, format!("{}{transition}", object.why));
            page.line(format!(
                "    ({}, 0x{:04X}, 0x{:02X}, bytes.fromhex(\"{bytes}\"), {complete}),",
                device.position, step.object.index, step.object.sub
            ));
        }
    }
    page.line("]");
}

fn pulses(page: &mut Page, sheet: &Sheet) {
    page.note(
        0,
        "SYNC pulses: position, period of SYNC0, its phase in the cycle of system time, \
        SYNC1 after SYNC0 (None without), in ns.",
    );
    page.line("PULSES = [");
    for (Device { position, .. }, unit) in sheet.with_pulses() {
        let Unit { sync0_ns, sync1_ns, phase_ns, why_sync0, why_sync1, why_phase, .. } = unit;
        page.note(4, format!("{sync0_ns}: {why_sync0}."));
        page.note(4, format!("{phase_ns}: {why_phase}."));
        let sync1 = match sync1_ns {
            0 => "None".to_owned(),
            _ => {
                page.note(4, format!("{sync1_ns}: {why_sync1}."));
                sync1_ns.to_string()
            }
        };
        page.line(format!("    ({position}, {sync0_ns}, {phase_ns}, {sync1}),"));
    }
    page.line("]");
}

/// 16-bit registers for which SOEM has no call.
fn words(page: &mut Page, sheet: &Sheet) {
    page.note(
        0,
        "Registers of 16 bits that are written by hand when pulses are set up: position, \
        address, value.",
    );
    page.line("WORDS = [");
    for device in &sheet.devices {
        if let Some(unit) =
            device.unit.as_ref().filter(|unit| ![0x0300, 0x0700].contains(&unit.word.0))
        {
            page.note(
                4,
                format!(
                    "AssignActivate {}: {}. SOEM itself writes 0x0300 or 0x0700.",
                    unit.word, unit.why_word
                ),
            );
            page.line(format!("    ({}, 0x0980, 0x{:04X}),", device.position, unit.word.0));
        }
        for (what, register, value) in device.watchdog.iter().flat_map(|one| one.registers()) {
            page.note(4, what);
            page.line(format!("    ({}, 0x{register:04X}, {value}),", device.position));
        }
    }
    page.line("]\n");
}

const PROGRAM: &str = r#"
# us, of what is not cyclic; a busy machine needs more than 2 ms
pysoem.settings.timeouts.ret = 20_000
main_device = pysoem.Master()
# Else config_map() asks for SAFEOP before SYNC is set up.
main_device.manual_state_change = True
main_device.open(sys.argv[1])
if main_device.config_init() != len(DEVICES):
    sys.exit(f"expected {len(DEVICES)} SubDevices, found {len(main_device.slaves)}")
slaves = main_device.slaves
due = 0


def ask(state):
    main_device.state = state
    main_device.write_state()


def exchange(paced=True):
    """A frame now, or at its time; it carries the drift datagram, too."""
    global due
    if paced:
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
    main_device.send_processdata()
    main_device.receive_processdata(2_000)
    # When it was at the reference clock: 0 is wanted.
    off = (main_device.dc_time - SEND_PHASE + CYCLE // 2) % CYCLE - CYCLE // 2
    if paced:
        due += CYCLE - off // 16


def next_pulse(at):
    return int.from_bytes(slaves[at]._fprd(0x0990, 4), "little")


for at, (vendor, product, _, _) in enumerate(DEVICES):
    if (slaves[at].man, slaves[at].id) != (vendor, product):
        sys.exit(f"{at}: expected vendor 0x{vendor:08X} and product 0x{product:08X}, found "
                 f"0x{slaves[at].man:08X} and 0x{slaves[at].id:08X}")
ask(pysoem.PREOP_STATE)
main_device.state_check(pysoem.PREOP_STATE, 1_000_000)
for at, index, sub, data, complete in OBJECTS:
    slaves[at].sdo_write(index, sub, data, complete)
main_device.config_map()
for at, (_, _, outputs, inputs) in enumerate(DEVICES):
    found = len(slaves[at].output), len(slaves[at].input)
    if found != (outputs, inputs):
        sys.exit(f"{at}: expected {outputs} and {inputs} bytes of outputs and inputs, found {found}")
main_device.config_dc()
# Filters of the drift loops: with those of reset, 0 and 12, a loop learns its speed too slowly.
for at, *_ in PULSES:
    slaves[at]._fpwr(0x0934, bytes([4, 6]))
# The clocks converge, then frames come to their phase.
for _ in range(15_000):
    exchange(paced=False)
due = time.monotonic_ns()
for _ in range(250):
    exchange()
for at, sync0, phase, sync1 in PULSES:
    slaves[at].dc_sync(True, sync0, phase, sync1)
for at, address, value in WORDS:
    slaves[at]._fpwr(address, value.to_bytes(2, "little"))
# The first pulse comes after 100 ms.
for _ in range(200_000_000 // CYCLE + 1):
    exchange()
for at, *_ in PULSES:
    pulse = next_pulse(at)
    # Ten cycles are longer than any period of SYNC0 that is used with them.
    time.sleep(10 * CYCLE / 1e9)
    print(f"{at}: SYNC0 {'runs' if next_pulse(at) != pulse else 'stands'}")
due = time.monotonic_ns()
for number in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3000):
    # In phase again; then up, without a pause in the cycle.
    if number == 250:
        ask(pysoem.SAFEOP_STATE)
    if number == 500:
        ask(pysoem.OP_STATE)
    # Read slaves[at].input and set slaves[at].output here.
    exchange()
main_device.read_state()
for at, device in enumerate(slaves):
    print(f"{at}: state {device.state}, {pysoem.al_status_code_to_string(device.al_status)}")
in_op = all(device.state == pysoem.OP_STATE for device in slaves)
ask(pysoem.INIT_STATE)
sys.exit(0 if in_op else 1)
"#;

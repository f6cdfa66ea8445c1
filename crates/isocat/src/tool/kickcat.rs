//! KickCAT's Python binding 2.5: a program that brings the segment up without SYNC, since the
//! binding does not support clocks.

use super::page::Page;
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("# ");
    page.head(sheet, "The segment for KickCAT's Python binding: PROGRAM INTERFACE [CYCLES].");
    page.note(0, "Not to be named kickcat.py, or it imports itself.");
    page.limits(0, &limits(sheet));
    page.line(
        "import sys\nimport time\n\nimport kickcat\nfrom kickcat import State\nfrom \
        kickcat.mailbox.request import MessageStatus\n",
    );
    page.note(0, format!("Bus cycle, s: {}", sheet.why_cycle));
    page.line(format!("CYCLE = {:?}", sheet.cycle_ns as f64 / 1e9));
    // KickCAT writes one time to all devices; the longest one is too short for none of them.
    let written = sheet.devices.iter().filter_map(|device| device.watchdog);
    let written = written.filter(|watchdog| watchdog.is_of_process_data());
    let watchdog = written.max_by_key(|watchdog| watchdog.time_ns());
    match watchdog {
        Some(_) => page
            .note(0, "Watchdog of the process data, s, the same for all: as the plan writes it."),
        None => page.note(
            0,
            "Watchdog of the process data, s, the same for all: as the chips have it after reset.",
        ),
    }
    page.line(format!(
        "WATCHDOG = {:?}\n",
        watchdog.map_or(0.1, |watchdog| watchdog.time_ns() as f64 / 1e9)
    ));
    page.note(
        0,
        "By position: bytes of outputs, bytes of inputs. The binding shows no identities.",
    );
    page.line("DEVICES = [");
    for device in &sheet.devices {
        let [outputs, inputs] = device.bytes();
        page.device(4, device);
        page.note(4, format!("vendor 0x{:08X}, product 0x{:08X}", device.vendor, device.product));
        page.line(format!("    ({outputs}, {inputs}),"));
    }
    page.line("]");
    objects(&mut page, sheet);
    page.end() + PROGRAM
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = sheet
        .slower("KickCAT exchanges all devices in each cycle, so this one comes more often here");
    for (Device { position, name, .. }, unit) in sheet.with_pulses() {
        let Unit { word, sync0_ns, sync1_ns, phase_ns, why_phase, .. } = unit;
        let sync1 = match sync1_ns {
            0 => String::new(),
            _ => format!(", SYNC1 {sync1_ns} ns after it"),
        };
        limits.push(format!(
            "the binding has no clocks, so SubDevice {position} ({name}) runs without SYNC, if it \
                can at all. Wanted: AssignActivate {word}, SYNC0 every {sync0_ns} ns at phase \
                {phase_ns} ns ({why_phase}){sync1}. KickCAT's library in C++ has \
                Bus::enableDC(cycle, shift, start_delay): SYNC0 alone, one period and \
                shift for all."
        ));
    }
    for (Device { position, name, .. }, unit) in sheet.without_pulses() {
        limits.push(format!(
            "the binding can't write registers: AssignActivate {} of SubDevice \
            {position} ({name}) is left out.",
            unit.word
        ));
    }
    let has_outputs = |device: &&Device| device.channels.iter().any(|channel| channel.outputs);
    let mut times: Vec<_> = sheet.devices.iter().filter(has_outputs).collect();
    times.dedup_by_key(|device| device.watchdog.map(|watchdog| watchdog.time_ns()));
    let differ = times.len() > 1 && times.iter().any(|device| device.watchdog.is_some());
    if differ {
        limits.push(
            "KickCAT writes one watchdog to all devices: the longest that any of them is to have."
                .to_owned(),
        );
    }
    limits
}

fn objects(page: &mut Page, sheet: &Sheet) {
    page.note(
        0,
        "SDO downloads in PREOP: position, index, sub-index, complete access, bytes. \
        Types of DC modes are left out.",
    );
    page.line("OBJECTS = [");
    for device in &sheet.devices {
        // Without SYNC a device that waits for it would not come up.
        let sync = |index: u16| device.mode.uses_dc() && matches!(index, 0x1C32 | 0x1C33);
        for object in device.objects.iter().filter(|object| !sync(object.step.object.index)) {
            let step = &object.step;
            let bytes: String = step.data.iter().map(|byte| format!("{byte:02x}")).collect();
            let complete = if step.complete { "True" } else { "False" };
            page.note(4, &object.why);
            page.line(format!(
                "    ({}, 0x{:04X}, 0x{:02X}, {complete}, bytes.fromhex(\"{bytes}\")),",
                device.position, step.object.index, step.object.sub
            ));
        }
    }
    page.line("]\n");
}

const PROGRAM: &str = r#"
link = kickcat.create_link(sys.argv[1], "")
# KickCAT waits for the whole of this time at most of its steps, however soon frames come back.
link.set_timeout(0.01)
bus = kickcat.Bus(link)
bus.init(WATCHDOG)
subdevices = bus.slaves()
if len(subdevices) != len(DEVICES):
    sys.exit(f"expected {len(DEVICES)} SubDevices, found {len(subdevices)}")
bus.wait_for_state(State.PREOP, 10.0)
for at, index, sub, complete, data in OBJECTS:
    message = subdevices[at].mailbox.write_sdo(index, sub, complete, data, 2.0)
    while message.status() == MessageStatus.RUNNING:
        bus.process_mailboxes()
        time.sleep(0.001)
    if message.status() != MessageStatus.SUCCESS:
        sys.exit(f"{at}: 0x{index:04X}:{sub:02X} is not written: {message.status()}")
bus.create_mapping()
for at, (device, expected) in enumerate(zip(subdevices, DEVICES)):
    if (device.output_size, device.input_size) != expected:
        sys.exit(f"{at}: expected {expected} bytes, found {device.output_size} and {device.input_size}")
    device.set_output_bytes(bytes(device.output_size))
bus.request_state(State.SAFE_OP)
bus.wait_for_state(State.SAFE_OP, 10.0)


def cyclic():
    bus.process_data_no_check()
    time.sleep(0.0005)


cyclic()
bus.request_state(State.OPERATIONAL)
bus.wait_for_state(State.OPERATIONAL, 10.0, cyclic)
due = time.monotonic()
for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3000):
    # Read subdevices[at].input_data and call subdevices[at].set_output_bytes() here.
    bus.process_data()
    due += CYCLE
    time.sleep(max(0, due - time.monotonic()))
for at, device in enumerate(subdevices):
    print(f"{at}: {bus.get_state(device)}")
bus.request_state(State.INIT)
"#;

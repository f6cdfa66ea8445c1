//! TwinCAT 3: the values to enter in each dialog, with TwinCAT's names.

use isocat_wire::Nanos;

use super::page::Page;
use super::sheet::Object;
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("");
    page.head(sheet, "The segment for TwinCAT 3 (names of dialogs as in build 4024).");
    page.limits(0, &limits(sheet));
    page.line("");
    page.line("SYSTEM > Tasks > the task of the EtherCAT device > tab \"Task\"");
    field(
        &mut page,
        "Cycle ticks",
        &format!("{} ms", decimals(sheet.cycle_ns, 1_000_000)),
        &format!("the bus cycle: {}", sheet.why_cycle),
    );
    if let Some(reference) = sheet.reference.and_then(|at| sheet.devices.get(at)) {
        page.line(
            "I/O > Devices > the EtherCAT device > tab \"EtherCAT\" > Advanced Settings > \
            Distributed Clocks",
        );
        field(
            &mut page,
            "DC Mode",
            "Automatic DC Mode Selection, or Independent DC Time",
            "TwinCAT follows the reference clock, as the plan has it",
        );
        field(
            &mut page,
            "Reference Clock",
            &format!("{} (position {})", reference.name, reference.position),
            "the reference clock of the plan",
        );
        field(
            &mut page,
            "SYNC Shift Time",
            "read it, don't change it",
            "it is a part of each shift below",
        );
    }
    for device in &sheet.devices {
        one(&mut page, device, sheet);
    }
    page.end()
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = Vec::new();
    for device in sheet.devices.iter().filter(|device| device.every > 1) {
        limits.push(format!(
            "SubDevice {} ({}) is exchanged in every {} cycles: assign its Sync \
            Unit to a slower task; there is no field for a number.",
            device.position, device.name, device.every
        ));
    }
    limits.push(
        "devices come from ESI files, so AssignActivate is chosen as an Operation Mode \
        and not typed in; take the one that has the word below."
            .into(),
    );
    limits
}

fn one(page: &mut Page, device: &Device, sheet: &Sheet) {
    page.line("");
    page.device(0, device);
    page.line(format!(
        "I/O > the box at position {} > tab \"General\": vendor 0x{:08X}, product \
        0x{:08X}, revision 0x{:08X}",
        device.position, device.vendor, device.product, device.revision
    ));
    distributed_clock(page, device, sheet);
    process_data(page, device);
    if device.parameters().next().is_some() {
        page.line("  tab \"Startup\" > New...: CoE entries, in this order");
    }
    for object in device.parameters() {
        start_up(page, object);
    }
    if let Some(watchdog) = device.watchdog {
        page.line("  tab \"EtherCAT\" > Advanced Settings > General > Behavior > Watchdog");
        for (_, register, value) in watchdog.registers() {
            let (name, value) = match register {
                0x0400 => ("Set Multiplier (Reg. 400h)", value.to_string()),
                0x0410 => ("Set PDI Watchdog (Reg. 410h)", value.to_string()),
                _ => {
                    let ms = decimals(watchdog.time_ns(), 1_000_000);
                    ("Set SM Watchdog (Reg. 420h)", format!("{value}, {ms} ms"))
                }
            };
            field(page, name, &value, "as the plan has it");
        }
    }
}

fn distributed_clock(page: &mut Page, device: &Device, sheet: &Sheet) {
    page.line("  tab \"DC\" (absent where the ESI has no OpMode)");
    let Some(unit) = &device.unit else {
        let why = format!("mode {} has no SYNC", device.mode);
        return field(
            page,
            "Operation Mode",
            "FreeRun / SM-Synchron, or the first one without DC",
            &why,
        );
    };
    field(
        page,
        "Operation Mode",
        &format!("the one with AssignActivate #x{:04X}", unit.word.0),
        &unit.why_word,
    );
    if unit.sync0_ns > 0 {
        page.line("  tab \"DC\" > Advanced Settings > Distributed Clock > Cyclic Mode");
        pulses(page, unit, sheet);
    }
}

fn pulses(page: &mut Page, unit: &Unit, sheet: &Sheet) {
    let [cycle, sync0, sync1] = [sheet.cycle_ns, unit.sync0_ns.into(), unit.sync1_ns.into()];
    field(page, "Sync Unit Cycle (us)", &decimals(cycle, 1000), "shown, not typed: the bus cycle");
    let period = match cycle == sync0 {
        true => format!("Sync Unit Cycle x 1 = {} us", decimals(sync0, 1000)),
        false => format!(
            "{} us: a multiple or part of Sync Unit Cycle, or User Defined",
            decimals(sync0, 1000)
        ),
    };
    field(page, "SYNC 0: Cycle Time", &period, &unit.why_sync0);
    field(
        page,
        "SYNC 0: Shift Time, User Defined (us)",
        &format!(
            "{} less what \"+\" already shows there",
            decimals(unit.phase_ns - sheet.send_phase_ns, 1000)
        ),
        &format!("the sum is from the frame to SYNC0: {}", unit.why_phase),
    );
    field(page, "Enable SYNC 0", "on", "bit 1 of 0x0981");
    if sync1 == 0 {
        return field(page, "Enable SYNC 1", "off", "bit 2 of 0x0981");
    }
    let (factor, rest) = (sync1 / sync0 + 1, sync1 % sync0);
    field(
        page,
        "SYNC 1: Cycle Time",
        &format!("SYNC 0 Cycle x {factor}"),
        &format!("0x09A4 = {}: {}", Nanos(sync1), unit.why_sync1),
    );
    field(page, "SYNC 1: Shift Time (us)", &decimals(rest, 1000), "the rest of 0x09A4");
    field(page, "Enable SYNC 1", "on", "bit 2 of 0x0981");
}

fn process_data(page: &mut Page, device: &Device) {
    if device.channels.is_empty() {
        return;
    }
    page.line("  tab \"Process Data\"");
    for channel in &device.channels {
        let (kind, object) =
            if channel.outputs { ("Outputs", "0x1C12") } else { ("Inputs", "0x1C13") };
        let pdos: Vec<_> = channel.pdos.iter().map(|pdo| format!("0x{:04X}", pdo.index)).collect();
        let pdos = if pdos.is_empty() { "as they are".to_owned() } else { pdos.join(", ") };
        field(
            page,
            &format!("PDO Assignment ({object})"),
            &pdos,
            &format!("SM{} {kind}: {} bytes", channel.sync_manager, channel.bytes),
        );
    }
    let download = if device.objects.iter().any(Object::assigns) { "on" } else { "off" };
    field(page, "Download: PDO Assignment", download, "on where the plan writes 0x1C12 or 0x1C13");
}

fn start_up(page: &mut Page, object: &Object) {
    let step = &object.step;
    let dashed = |transition: &isocat_descriptions::start_up::Transition| {
        let letters = transition.to_string();
        format!("{} -> {}", &letters[..1], &letters[1..])
    };
    let transitions: Vec<_> = step.transitions.iter().map(dashed).collect();
    let bytes: Vec<_> = step.data.iter().map(|byte| format!("{byte:02X}")).collect();
    let complete = if step.complete { "on" } else { "off" };
    let value = format!(
        "Transition {}, Index (hex) {:04X}, Sub-Index (dec) {}, Complete Access {complete}, Data \
            (hexbin) {}",
        transitions.join(", "),
        step.object.index,
        step.object.sub,
        bytes.join(" "),
    );
    field(page, "CANopen Startup Entry", &value, &object.why);
}

/// A field of a dialog with its value, and the reason below.
fn field(page: &mut Page, name: &str, value: &str, why: &str) {
    page.line(format!("    {name}: {value}"));
    page.note(8, format!("because: {why}"));
}

/// Nanoseconds in a larger unit, with only the digits that are needed.
fn decimals(ns: i64, unit: i64) -> String {
    let digits = unit.ilog10() as usize;
    let (sign, ns) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    let (whole, rest) = (ns / unit.unsigned_abs(), ns % unit.unsigned_abs());
    let text = format!("{sign}{whole}.{rest:0digits$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

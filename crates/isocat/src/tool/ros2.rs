//! ethercat_driver_ros2: the `slave_config` of its generic plugin, one file for each SubDevice with
//! process data, parameters or SYNC.

use isocat_maindevice::segment::{Pdo, PdoEntry};

use super::page::Page;
use super::sheet::{Channel, Object};
use super::{Device, File, Sheet, Unit};

/// The files.
pub(super) fn files(sheet: &Sheet) -> Vec<File> {
    let file = |device| File { name: name(device), text: text(sheet, device) };
    let has_part = |device: &&Device| {
        !device.channels.is_empty() || !device.objects.is_empty() || device.unit.is_some()
    };
    sheet.devices.iter().filter(has_part).map(file).collect()
}

fn name(device: &Device) -> String {
    let keep = |letter: char| {
        if letter.is_ascii_alphanumeric() { letter.to_ascii_lowercase() } else { '_' }
    };
    let name: String = device.name.chars().take(32).map(keep).collect();
    format!("{}_{name}.yaml", device.position)
}

fn text(sheet: &Sheet, device: &Device) -> String {
    let mut page = Page::new("# ");
    page.head(sheet, "The slave_config of one SubDevice for ethercat_driver_ros2.");
    page.limits(0, &limits(sheet, device));
    let frequency = 1e9 / sheet.cycle_ns as f64;
    page.note(
        0,
        format!(
            "In the URDF: position {}, plugin \
        ethercat_generic_plugins/GenericEcSlave; control_frequency {frequency}. {}",
            device.position, sheet.why_cycle
        ),
    );
    page.device(0, device);
    page.line(format!("vendor_id: 0x{:08X}", device.vendor));
    page.line(format!("product_id: 0x{:08X}", device.product));
    if let Some(unit) = &device.unit {
        page.note(0, format!("{}.", unit.why_word));
        page.line(format!("assign_activate: 0x{:04X}", unit.word.0));
    }
    page.note(
        0,
        "Read by the CiA 402 plugin alone, ethercat_generic_plugins/EcCiA402Drive: a \
        fault is the application's business.",
    );
    page.line("auto_fault_reset: false");
    parameters(&mut page, device);
    for outputs in [true, false] {
        let of = device.channels.iter().filter(|channel| channel.outputs == outputs);
        let pdos: Vec<&Pdo> = of.flat_map(|channel| &channel.pdos).collect();
        if !pdos.is_empty() {
            channels(&mut page, outputs, &pdos);
        }
    }
    if !device.channels.is_empty() {
        page.note(0, "SyncManagers; the watchdog as the control byte has it.");
        page.line("sm:");
    }
    for Channel { outputs, sync_manager, watchdog, bytes, .. } in &device.channels {
        let (kind, pdo) = if *outputs { ("output", "rpdo") } else { ("input", "tpdo") };
        let watchdog = if *watchdog { "enable" } else { "disable" };
        page.note(2, format!("{bytes} bytes"));
        page.line(format!(
            "  - {{index: {sync_manager}, type: {kind}, pdo: {pdo}, watchdog: {watchdog}}}"
        ));
    }
    page.end()
}

fn limits(sheet: &Sheet, device: &Device) -> Vec<String> {
    let mut limits = Vec::new();
    if let Some(unit) = &device.unit {
        sync_limits(&mut limits, sheet, unit);
    }
    if device.every > 1 {
        limits.push(format!(
            "the plan exchanges this SubDevice in every {} cycles; this driver in each.",
            device.every
        ));
    }
    for (outputs, name) in [(true, "outputs"), (false, "inputs")] {
        if device.channels.iter().filter(|channel| channel.outputs == outputs).count() > 1 {
            limits.push(format!(
                "its {name} are in several SyncManagers, and this driver gives each of them all PDOs of the list: it \
                 can't run the device."
            ));
        }
    }
    if device.watchdog.is_some() {
        limits.push(
            "the watchdogs (0x0400 to 0x0420) can't be set: the chip's own 100 ms stay.".into(),
        );
    }
    limits.push(
        "types of PDO entries are not in the plan: write int8, int16 or int32 where a \
        value has a sign, and name interfaces."
            .into(),
    );
    limits
}

fn sync_limits(limits: &mut Vec<String>, sheet: &Sheet, unit: &Unit) {
    limits.push(format!(
        "the phase of SYNC0 can't be set: the driver makes its shift of the instant at which it \
            is configured. Wanted: {} ns; {}.",
        unit.phase_ns, unit.why_phase
    ));
    if i64::from(unit.sync0_ns) != sheet.cycle_ns {
        limits.push(format!(
            "SYNC0 always has the period of control_frequency. Wanted: {} ns; {}.",
            unit.sync0_ns, unit.why_sync0
        ));
    }
    if unit.sync1_ns > 0 {
        limits.push(format!(
            "SYNC1 always comes with SYNC0. Wanted: {} ns after it; {}.",
            unit.sync1_ns, unit.why_sync1
        ));
    }
    limits.extend(sheet.reference_not_first());
    limits.push("the reference clock follows the host, whose jitter reaches SYNC0.".into());
}

fn parameters(page: &mut Page, device: &Device) {
    if device.parameters().next().is_some() {
        page.note(0, "Start-up SDOs, written in PREOP.");
        page.line("sdo:");
    }
    for object in device.parameters() {
        let address = object.step.object;
        page.note(2, &object.why);
        match typed(object) {
            Some((kind, value)) => page.line(format!(
                "  - {{index: 0x{:04X}, sub_index: 0x{:02X}, \
                type: {kind}, value: {value}}}",
                address.index, address.sub
            )),
            None => page.limits(
                2,
                &[format!(
                    "{address} has {} bytes or is written with complete \
                access; a value here has at most 32 bits. Write it with the driver's SDO \
                service.",
                    object.step.data.len()
                )],
            ),
        }
    }
}

/// The driver reads values as a signed 32-bit integer, so the upper half of the unsigned range must
/// be written as negative numbers.
fn typed(object: &Object) -> Option<(&'static str, i64)> {
    let value = object.number().filter(|_| !object.step.complete)?;
    match object.step.data.len() {
        1 => Some(("uint8", value as i64)),
        2 => Some(("uint16", value as i64)),
        4 => Some(("int32", i64::from(value as u32 as i32))),
        _ => i32::try_from(value as i64).ok().map(|value| ("int64", i64::from(value))),
    }
}

fn channels(page: &mut Page, outputs: bool, pdos: &[&Pdo]) {
    let (list, interface) =
        if outputs { ("rpdo", "command_interface") } else { ("tpdo", "state_interface") };
    page.line(format!("{list}:"));
    for pdo in pdos {
        page.line(format!("  - index: 0x{:04X}\n    channels:", pdo.index));
        for PdoEntry { index, sub, bits } in &pdo.entries {
            let kind = match bits {
                8 | 16 | 32 | 64 => format!("uint{bits}"),
                _ => format!("bit{bits}"),
            };
            let name = match index {
                0 => String::new(),
                _ => format!(", {interface}: \"x{index:04x}_{sub:02x}\""),
            };
            page.line(format!(
                "      - {{index: 0x{index:04X}, sub_index: 0x{sub:02X}, type: {kind}{name}}}"
            ));
        }
    }
}

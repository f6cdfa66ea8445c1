//! linuxcnc-ethercat: `ethercat-conf.xml`, with every SubDevice as type `generic`.

use std::fmt::Write as _;

use isocat_maindevice::segment::PdoEntry;

use super::page::Page;
use super::sheet::Object;
use super::{Device, Sheet, Unit};

/// Entries up to this many bits become a pin.
const WIDEST_PIN: u8 = 32;

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::between("<!-- ", " -->");
    page.line("<?xml version=\"1.0\" encoding=\"UTF-8\"?>");
    page.head(sheet, "The segment for linuxcnc-ethercat: ethercat-conf.xml.");
    page.limits(0, &limits(sheet));
    page.line("<masters>");
    page.note(2, format!("appTimePeriod is the bus cycle: {}", sheet.why_cycle));
    page.note(
        2,
        "refClockSyncCycles -1: the servo thread follows the reference clock, as the plan has it.",
    );
    let reference =
        sheet.reference.map_or(String::new(), |at| format!(" refClockSlaveIdx=\"{at}\""));
    page.line(format!(
        "  <master idx=\"0\" appTimePeriod=\"{}\" refClockSyncCycles=\"-1\"{reference}>",
        sheet.cycle_ns
    ));
    for device in &sheet.devices {
        slave(&mut page, device);
    }
    page.line("  </master>\n</masters>");
    page.end()
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = sheet.slower("give its slave a syncUnit with that syncUnitCycle");
    let mut add = |text: &str| limits.push(text.to_owned());
    add("types of PDO entries are not in the plan: pins are u32; take s32, float or float-ieee \
            where a value has a sign or a point.");
    if sheet.with_pulses().next().is_some() {
        add("the frame's own phase is the servo thread's; sync0Shift counts from the first \
                application time, so the distance from frame to SYNC0 is kept only while pll-err \
                is near 0.");
    }
    if sheet.has_unusual_transitions() {
        add("every sdoConfig is written in PREOP; another transition stands with its element.");
    }
    limits.extend(sheet.watchdogs_at_igh());
    limits
}

fn slave(page: &mut Page, device: &Device) {
    let Device { position: at, vendor, product, .. } = device;
    page.device(4, device);
    page.line(format!(
        "    <slave idx=\"{at}\" type=\"generic\" vid=\"{vendor:08X}\" \
        pid=\"{product:08X}\" name=\"{}\" configPdos=\"{}\">",
        hal_name(device),
        !device.channels.is_empty()
    ));
    if let Some(unit) = &device.unit {
        dc_conf(page, unit);
    }
    if let Some(watchdog) = device.watchdog.filter(|watchdog| watchdog.is_of_process_data()) {
        let (divider, steps) = (watchdog.divider(), watchdog.steps());
        let unit = isocat_wire::time::Nanos((i64::from(divider) + 2) * 40);
        page.note(6, format!("Watchdog of the process data: {steps} steps of {unit}."));
        page.line(format!("      <watchdog divider=\"{divider}\" intervals=\"{steps}\"/>"));
    }
    for object in device.parameters() {
        sdo_config(page, object);
    }
    for channel in &device.channels {
        let (direction, letter) = if channel.outputs { ("out", "rx") } else { ("in", "tx") };
        page.note(6, format!("{} bytes.", channel.bytes));
        page.line(format!(
            "      <syncManager idx=\"{}\" dir=\"{direction}\">",
            channel.sync_manager
        ));
        for pdo in &channel.pdos {
            page.line(format!("        <pdo idx=\"{:04X}\">", pdo.index));
            for entry in &pdo.entries {
                page.line(format!("          {}", pdo_entry(entry, letter, pdo.index)));
            }
            page.line("        </pdo>");
        }
        page.line("      </syncManager>");
    }
    page.line("    </slave>");
}

/// A name for HAL: letters, digits and dashes, and the position, so that it is unique.
fn hal_name(device: &Device) -> String {
    let keep = |letter: char| if letter.is_ascii_alphanumeric() { letter } else { '-' };
    let name: String = device.name.chars().take(16).map(keep).collect();
    format!("D{}-{name}", device.position)
}

fn dc_conf(page: &mut Page, unit: &Unit) {
    page.note(6, format!("assignActivate {}: {}.", unit.word, unit.why_word));
    page.note(6, format!("sync0Cycle {} ns: {}.", unit.sync0_ns, unit.why_sync0));
    page.note(6, format!("sync0Shift {} ns: {}.", unit.phase_ns, unit.why_phase));
    let mut line = format!(
        "      <dcConf assignActivate=\"{:X}\" sync0Cycle=\"{}\" sync0Shift=\"{}\"",
        unit.word.0, unit.sync0_ns, unit.phase_ns
    );
    if unit.sync1_ns > 0 {
        page.note(
            6,
            format!("sync1Cycle {} ns, register 0x09A4: {}.", unit.sync1_ns, unit.why_sync1),
        );
        let _ = write!(line, " sync1Cycle=\"{}\" sync1Shift=\"0\"", unit.sync1_ns);
    }
    page.line(line + "/>");
}

fn sdo_config(page: &mut Page, object: &Object) {
    if let Some(transition) = object.unusual_transition() {
        page.note(6, format!("The plan writes the next one in {transition}."));
    }
    page.note(6, &object.why);
    let address = object.step.object;
    if object.step.complete && address.sub != 0 {
        let limit = format!("complete access begins at sub-index 0 here: {address} is left out.");
        return page.limits(6, &[limit]);
    }
    let sub =
        if object.step.complete { "complete".to_owned() } else { format!("{:02X}", address.sub) };
    page.line(format!("      <sdoConfig idx=\"{:04X}\" subIdx=\"{sub}\">", address.index));
    let bytes: Vec<_> = object.step.data.iter().map(|byte| format!("{byte:02X}")).collect();
    page.line(format!("        <sdoDataRaw data=\"{}\"/>\n      </sdoConfig>", bytes.join(" ")));
}

fn pdo_entry(entry: &PdoEntry, letter: &str, pdo: u16) -> String {
    let PdoEntry { index, sub, bits } = *entry;
    let kind = if bits == 1 { "bit" } else { "u32" };
    // Padding, and values that are too wide for a pin, get none.
    let pin = match index != 0 && bits <= WIDEST_PIN {
        true => format!(" halPin=\"{letter}-{pdo:04x}-{index:04x}-{sub:02x}\" halType=\"{kind}\""),
        false => String::new(),
    };
    format!("<pdoEntry idx=\"{index:04X}\" subIdx=\"{sub:02X}\" bitLen=\"{bits}\"{pin}/>")
}

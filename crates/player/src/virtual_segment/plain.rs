//! The profile of a device that only the ENI describes: its identity, its memory layout, its PDOs,
//! and each object that the ENI writes. Everything else is assumed, and the profile says so.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use isocat_descriptions::eni::{Eni, EniPdo};
use isocat_descriptions::start_up::{Address, DeviceStartUp, Transition};
use isocat_wire::register;

use isocat_segment::new_file::quoted;

/// The text of the profile.
pub(super) fn profile(eni: &Eni, position: usize) -> String {
    let device = &eni.start_up.devices[position];
    let mut text = head(device, position);
    if let Some(mailbox) = device.mailbox {
        let _ = writeln!(
            text,
            "[mailbox]\nreceive = {{ start = {}, length = {} }}\nsend = {{ start = {}, length = {} }}\n",
            mailbox.out.start, mailbox.out.length, mailbox.back.start, mailbox.back.length
        );
    }
    let mut objects = Objects::default();
    for outputs in [true, false] {
        if let Some(area) = area(device, outputs) {
            text += &process_data(eni, position, outputs, area, &mut objects);
        }
    }
    if device.mailbox.is_some() {
        objects.take_written(device);
        text += &objects.text();
        for index in ["1C32", "1C33"] {
            let _ = writeln!(
                text,
                "[[object]]\nindex = 0x{index}\nname = \"SM parameter\"\nlike = \"model_every_mode:{index}\"\n"
            );
        }
    }
    text
}

fn head(device: &DeviceStartUp, position: usize) -> String {
    // What the objects 0x1C32 and 0x1C33 announce needs a SYNC unit, which the list may leave off.
    let has_dc = device.dc.is_some() || device.mailbox.is_some();
    let mut text = format!("id = \"eni_{position}\"\nname = {}\n", quoted(name(device)));
    let _ = write!(text, "vendor = \"vendor 0x{:08X}\"\napplication = \"io\"\n", device.vendor);
    match (device.mailbox.is_some(), device.dc.is_some()) {
        (true, _) => {}
        (false, true) => text += "modes = [\"sm\", \"dc-sync0\"]\n",
        (false, false) => text += "modes = [\"sm\"]\n",
    }
    let _ = write!(
        text,
        "\n[identity]\nvendor_id = {}\nproduct_code = {}\nrevision = {}\nserial = {}\ndevice_type = 0\n",
        device.vendor, device.product, device.revision, device.serial
    );
    let _ = write!(text, "\n[esc]\nchip = \"ET1100\"\nsync_unit = {has_dc}\n");
    if !device.physics.trim().is_empty() {
        let _ = writeln!(text, "ports = {}", quoted(&device.physics));
    }
    text += "\n[times]\nreaction = \"50us\"\ncalc_and_copy = \"10us\"\napplication = \"20us\"\ninput_copy = \"10us\"\n";
    let _ = write!(text, "\n[[assumed]]\nwhat = {}\nwhy = \"an ENI does not say it\"\n\n", ASSUMED);
    text
}

const ASSUMED: &str = "[\"esc.chip\", \"esc.sync_unit\", \"times.reaction\", \"times.calc_and_copy\", \"times.application\", \
                       \"times.input_copy\"]";

fn name(device: &DeviceStartUp) -> &str {
    if device.name.trim().is_empty() { "device of an ENI" } else { device.name.trim() }
}

/// Start and length of the SyncManager of a direction, as the ENI writes them on the way to SAFEOP.
pub(super) fn area(device: &DeviceStartUp, outputs: bool) -> Option<(u16, u16)> {
    let first = if device.mailbox.is_some() { 2 } else { 0 };
    let steps = device.registers.iter().filter(|step| {
        step.transitions.contains(&Transition::PS) || step.transitions.contains(&Transition::IP)
    });
    let mut managers = steps.filter_map(|step| {
        let Address::Physical { register, .. } = step.address else { return None };
        let from = register.checked_sub(register::SM_0.address).filter(|from| *from < 128)?;
        let bytes: [u8; 8] = *step.data.first_chunk()?;
        let start = u16::from_le_bytes([bytes[0], bytes[1]]);
        let length = u16::from_le_bytes([bytes[2], bytes[3]]);
        let writes = bytes[4] >> 2 & 3 == 1;
        let is_meant = from / 8 >= first && writes == outputs && bytes[6] & 1 != 0 && length > 0;
        is_meant.then_some((start, length))
    });
    managers.next_back()
}

fn process_data(
    eni: &Eni,
    position: usize,
    outputs: bool,
    (start, length): (u16, u16),
    objects: &mut Objects,
) -> String {
    let device = &eni.start_up.devices[position];
    let (table, first) = if outputs { ("outputs", 0x1600) } else { ("inputs", 0x1A00) };
    let managers = device.sync_managers.iter().filter(|one| one.outputs == outputs);
    let assigned: Vec<u16> = managers.flat_map(|one| one.pdos.iter().copied()).collect();
    let pdos: Vec<&EniPdo> =
        eni.slaves[position].pdos.iter().filter(|pdo| pdo.outputs == outputs).collect();
    let bits = |pdo: &EniPdo| pdo.entries.iter().map(|entry| u32::from(entry.bits)).sum::<u32>();
    let chosen = pdos.iter().filter(|pdo| assigned.contains(&pdo.index));
    let fits = chosen.map(|pdo| bits(pdo)).sum::<u32>().div_ceil(8) == u32::from(length);
    // Without a mailbox only the length matters.
    let known = fits && device.mailbox.is_some();
    let default = if known { assigned } else { vec![first] };
    let mut text = format!("[{table}]\nstart = {start}\nlength = {length}\n");
    if device.mailbox.is_some() {
        text += "access = \"rw preop\"\nslots = 16\n";
    }
    let list = default.iter().map(|pdo| format!("0x{pdo:04X}")).collect::<Vec<_>>().join(", ");
    let _ = writeln!(text, "default = [{list}]");
    if !known {
        let _ = writeln!(text, "pdos = [[0x{first:04X}, {}]]\n", 8 * u32::from(length));
        return text;
    }
    for pdo in pdos {
        let _ = writeln!(
            text,
            "\n[[{table}.pdo]]\nindex = {}\nname = {}\nentries = [",
            pdo.index,
            quoted(label(pdo))
        );
        for entry in &pdo.entries {
            match kind(entry.bits).filter(|_| entry.index != 0) {
                Some(kind) => {
                    let _ = writeln!(
                        text,
                        "  [\"{:04X}:{:02X}\", \"{kind}\", \"value\"],",
                        entry.index, entry.sub
                    );
                    objects.add(entry.index, entry.sub, kind, outputs);
                }
                None => {
                    let _ = writeln!(text, "  {{ pad = {} }},", entry.bits.clamp(1, 64));
                }
            }
        }
        text += "]\n";
    }
    text + "\n"
}

fn label(pdo: &EniPdo) -> &str {
    if pdo.name.trim().is_empty() { "PDO" } else { pdo.name.trim() }
}

/// The type of a value with this number of bits.
fn kind(bits: u16) -> Option<&'static str> {
    match bits {
        8 => Some("UNSIGNED8"),
        16 => Some("UNSIGNED16"),
        32 => Some("UNSIGNED32"),
        64 => Some("UNSIGNED64"),
        _ => None,
    }
}

/// Objects by index and sub-index.
#[derive(Default)]
struct Objects(BTreeMap<u16, BTreeMap<u8, Entry>>);

/// An entry of an object.
struct Entry {
    kind: &'static str,
    access: &'static str,
    value: u64,
}

impl Objects {
    /// Adds an entry that is mapped.
    fn add(&mut self, index: u16, sub: u8, kind: &'static str, outputs: bool) {
        let access = if outputs { "rw rx" } else { "ro tx" };
        self.0.entry(index).or_default().insert(sub, Entry { kind, access, value: 0 });
    }

    /// Adds entries that the ENI writes, which can be written. Entries in a mapping that the ENI
    /// writes can be mapped.
    fn take_written(&mut self, device: &DeviceStartUp) {
        for step in &device.objects {
            let index = step.object.index;
            if (0x1C10..=0x1C33).contains(&index) || step.complete {
                continue;
            }
            let Some(kind) = kind(8 * step.data.len() as u16) else { continue };
            let is_rx = (0x1600..=0x17FF).contains(&index);
            let is_mapping = is_rx || (0x1A00..=0x1BFF).contains(&index);
            let access = if is_mapping { "rw preop" } else { "rw" };
            let entries = self.0.entry(index).or_default();
            let entry = entries.entry(step.object.sub).or_insert(Entry { kind, access, value: 0 });
            if is_mapping {
                // A PDO has the content that the ENI writes; other written entries begin at 0.
                entry.value =
                    step.data.iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte));
            }
            if let (true, [bits, sub, low, high]) =
                (is_mapping && step.object.sub > 0, &step.data[..])
            {
                let mapped = u16::from_le_bytes([*low, *high]);
                if let Some(kind) = self::kind((*bits).into()).filter(|_| mapped != 0) {
                    self.add(mapped, *sub, kind, is_rx);
                }
            }
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        for (index, entries) in &self.0 {
            let most = entries.keys().next_back().copied().unwrap_or(0);
            let _ = writeln!(
                text,
                "[[object]]\nindex = 0x{index:04X}\nname = \"object of the ENI\"\nentries = ["
            );
            if most > 0 && !entries.contains_key(&0) {
                let _ = writeln!(text, "  [0, \"UNSIGNED8\", \"ro\", {most}, \"count\"],");
            }
            for (sub, Entry { kind, access, value }) in entries {
                let value = if *sub == 0 && most > 0 {
                    u64::from(most).min((*value).max(1))
                } else {
                    *value
                };
                let _ = writeln!(text, "  [{sub}, \"{kind}\", \"{access}\", {value}, \"value\"],");
            }
            text += "]\n\n";
        }
        text
    }
}

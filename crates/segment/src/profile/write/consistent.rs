//! Adapts the draft of a description to a profile, which must not contradict itself.

use isocat_descriptions::document::FileError;
use isocat_esc::chip::{self, Chip, PortKind};
use isocat_sync::{SupportedTypes, object};
use isocat_wire::PortNumber;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::time::Nanos;

use super::super::draft::{Area, Draft, Eeprom, Entry, Object, Pdo, PdoEntry};
use super::super::{ApplicationKind, check, unknown};

/// Corrects what a profile must not contain, with a note of each kind; fails if a profile cannot
/// describe the device.
pub(super) fn mend(draft: &mut Draft<'_>, notes: &mut Vec<String>) -> Result<(), FileError> {
    possible(draft)?;
    if let ApplicationKind::DriveAt(_) = draft.application {
        draft.application = ApplicationKind::Drive;
    }
    parameters(draft, notes);
    if let Some(eeprom) = draft.eeprom.take() {
        for window in &eeprom.windows {
            notes.push(format!(
                "{WINDOW_LEFT_OUT}: SyncManager {} is a window of {} bytes of inputs on registers; a profile has no \
                 key for it",
                window.sync_manager, window.length
            ));
        }
        configuration(draft, &eeprom);
        chip(draft, notes);
    }
    for (number, mode) in draft.op_modes.iter_mut().enumerate() {
        if mode.name.is_empty() {
            mode.name = format!("OpMode {number}");
        }
    }
    if let Some(number) = draft.value(0x1000, 0).filter(|number| *number > 0) {
        draft.device_type = number as u32;
    }
    objects(draft, notes);
    mapping(draft, notes);
    synchronization(draft, notes);
    cycle(draft, notes);
    check::check(&as_read(draft))
}

/// Refuses a property that no key of a profile can express.
fn possible(draft: &Draft<'_>) -> Result<(), FileError> {
    let stop = |at: usize, what: String| {
        Err(draft.source.error(at, format!("{} can't be a profile: {what}", draft.id)))
    };
    for (area, name) in [(&draft.outputs, "outputs"), (&draft.inputs, "inputs")] {
        let Some(area) = area else { continue };
        if let Some(share) = area.further.first() {
            let words = format!(
                "its {name} are in several SyncManagers; a profile has one for each direction"
            );
            return stop(share.at, words);
        }
    }
    Ok(())
}

/// Removes the parameters of drives behind SoE, for which a profile has no key; the protocol stays
/// announced.
fn parameters(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let Some(mailbox) = &mut draft.mailbox else { return };
    let speaks = &mut mailbox.value.speaks;
    if !speaks.parameters.is_empty() {
        notes.push(format!(
            "{SOE_LEFT_OUT}: {} parameters of {} drives; a profile has no key for them, and the device of the file \
             answers SoE with errors",
            speaks.parameters.len(),
            speaks.drives
        ));
    }
    (speaks.drives, speaks.parameters) = (0, &[]);
    draft.parameters.clear();
}

/// The kind of the note on removed parameters.
const SOE_LEFT_OUT: &str = "soe-parameters-left-out";
/// The kind of the note of a window.
const WINDOW_LEFT_OUT: &str = "window-left-out";

/// Words 0 to 6 of the EEPROM, as keys of `[esc]`.
fn configuration(draft: &mut Draft<'_>, eeprom: &Eeprom) {
    let word =
        |at: usize| u16::from_le_bytes([eeprom.configuration[at], eeprom.configuration[at + 1]]);
    draft.esc.pulse = Nanos(10 * i64::from(word(4)));
    draft.esc.alias = word(8);
}

/// Selects a chip that a profile can name, with the ports and the memory of the device.
fn chip(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let (_, of_device) = draft.esc.chip;
    let narrow = !of_device.counts_64_bit() && !has_ebus(of_device);
    if !narrow && !of_device.counts_64_bit() {
        let what = "its clock has 32 bits; no ESC with EBUS ports that a profile can name has such a clock, and that \
                    of the ET1100 has 64";
        notes.push(what.to_owned());
    }
    let (name, chip) =
        if narrow { ("IP_CORE_32", &chip::IP_CORE_32) } else { ("ET1100", &chip::ET1100) };
    let ram_kib = of_device.ram_kib.max(chip.ram_kib);
    draft.esc.chip = (name, Chip { ram_kib, ..*chip }.with_ports(of_device.port_descriptor));
}

fn has_ebus(chip: Chip) -> bool {
    PortNumber::ALL.into_iter().any(|port| chip.port(port) == PortKind::Ebus)
}

/// Makes entries ascend, each with one place in complete access.
fn objects(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let mut mended = Vec::new();
    for object in &mut draft.objects {
        let ascend = object.entries.windows(2).all(|pair| pair[0].sub < pair[1].sub);
        if !ascend {
            object.entries.sort_by_cached_key(|entry| u64::from(entry.sub));
            object.entries.dedup_by_key(|entry| entry.sub);
            lay_out(&mut object.entries);
            mended.push(object.index);
        }
    }
    note(notes, &mended, "its sub-indices do not ascend, or stand twice; they are sorted");
    let mut twice = Vec::new();
    draft.objects.sort_by_cached_key(|object| u64::from(object.index));
    draft.objects.dedup_by(|later, first| {
        let is = later.index == first.index;
        twice.extend(is.then_some(first.index));
        is
    });
    note(notes, &twice, "stands twice; the first is taken");
    let mut closed = Vec::new();
    for object in &mut draft.objects {
        for entry in &mut object.entries {
            if !entry.access.has_any(Access::READ) && !entry.access.has_any(Access::WRITE) {
                entry.access = Access(entry.access.0 | Access::READ.0);
                closed.push(object.index);
            }
        }
    }
    closed.dedup();
    note(notes, &closed, "entries without access to read or write; they are read-only now");
}

/// Adds mapped entries to the dictionary, with this type and the right to be mapped.
fn mapping(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let (mut added, mut opened, mut typed, mut unmapped) = (vec![], vec![], vec![], vec![]);
    for (area, direction) in
        [(&mut draft.outputs, Access::RX_MAPPABLE), (&mut draft.inputs, Access::TX_MAPPABLE)]
    {
        if draft.mailbox.is_none() {
            continue;
        }
        let pdos = area.iter_mut().flat_map(|area: &mut Area| &mut area.pdos);
        for mapped in pdos.flat_map(|pdo: &mut Pdo| &mut pdo.entries) {
            let Some(address) = mapped.object else { continue };
            let Some(object) = draft.objects.iter_mut().find(|o| o.index == address.index) else {
                continue;
            };
            if !object.entries.iter().any(|entry| entry.sub == address.sub) {
                if object.code == ObjectCode::VAR || object.entries.len() < 2 {
                    (mapped.object, mapped.data_type) = (None, DataType::GAP);
                    unmapped.push(address.index);
                    continue;
                }
                add(object, mapped, address.sub);
                added.push(address.index);
            }
            let Some(found) = object.entries.iter_mut().find(|entry| entry.sub == address.sub)
            else {
                continue;
            };
            if found.data_type != mapped.data_type {
                mapped.data_type = found.data_type;
                typed.push(address.index);
            }
            if !found.access.has(direction) {
                found.access = found.access.with(direction);
                opened.push(address.index);
            }
        }
    }
    note(notes, &added, "a PDO maps an entry that the dictionary lacks; it is added");
    note(
        notes,
        &typed,
        "a PDO maps it as another type than the dictionary has; that of the dictionary is taken",
    );
    note(
        notes,
        &opened,
        "a PDO maps it, and the dictionary does not say that it can be; it can now",
    );
    note(
        notes,
        &unmapped,
        "a PDO maps an entry that a single value has no room for; its bits are padding",
    );
}

fn add(object: &mut Object, mapped: &PdoEntry, sub: u8) {
    let place = object.entries.partition_point(|entry| entry.sub < sub);
    let entry = Entry {
        at: object.at,
        sub,
        name: mapped.name.clone(),
        data_type: mapped.data_type,
        bits: mapped.bits.into(),
        offset: 0,
        access: Access::READ,
        default: Vec::new(),
        written: String::new(),
    };
    object.entries.insert(place, entry);
    lay_out(&mut object.entries);
    let count = object.entries.last().map_or(0, |last| last.sub);
    if let [first, ..] = &mut object.entries[..]
        && first.default.first().is_none_or(|most| *most < count)
    {
        (first.default, first.written) = (vec![count], count.to_string());
    }
}

/// Places entries one behind the other, unless they are already farther apart; sub-index 0 takes 16
/// bits.
fn lay_out(entries: &mut [Entry]) {
    let mut free = 0;
    for entry in entries {
        entry.offset = entry.offset.max(free);
        let bits = if entry.sub == 0 { entry.bits.max(16) } else { entry.bits };
        free = entry.offset + u32::from(bits);
    }
}

/// Limits the announcements of 0x1C32 and 0x1C33 to what the ESC can do, and marks a preset that
/// they do not announce as published.
fn synchronization(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let read = as_read(draft);
    for object in &read.objects {
        let index = object.index;
        if !matches!(index, object::OUTPUT_PARAMETER | object::INPUT_PARAMETER) {
            continue;
        }
        let types = read.value(index, object::sub::SUPPORTED_TYPES).unwrap_or(0);
        let types = SupportedTypes(types as u16);
        if (types.dc_sync0() || types.dc_sync1()) && !draft.esc.sync_unit {
            draft.esc.sync_unit = true;
            notes.push(format!(
                "0x{index:04X}:04 announces DC, and there is no Dc part: sync_unit is true all the same"
            ));
        }
        let contradicts = check::presets_an_unannounced_type(&read, object);
        let why = contradicts.then(|| "so in what this profile was made of".to_owned());
        for own in draft.objects.iter_mut().filter(|own| own.index == index) {
            own.contradiction.clone_from(&why);
        }
    }
}

/// The draft as it will be once its text is read.
fn as_read<'a>(draft: &Draft<'a>) -> Draft<'a> {
    let mut read = draft.clone();
    unknown::complete(&mut read);
    read
}

/// Shortens the CPU's times to fit into the minimum cycle that the device states.
fn cycle(draft: &mut Draft<'_>, notes: &mut Vec<String>) {
    let stated = |sub| draft.value(object::OUTPUT_PARAMETER, sub).unwrap_or(0) as i64;
    let minimum = stated(object::sub::MINIMUM_CYCLE_TIME);
    let times = &mut draft.times;
    let parts = [times.calc_and_copy, Some(times.application), times.input_copy];
    let needed: i64 = parts.iter().flatten().map(|time| time.0).sum();
    if minimum <= 0 || needed <= minimum {
        return;
    }
    let share =
        |time: Nanos| Nanos((i128::from(time.0) * i128::from(minimum) / i128::from(needed)) as i64);
    let share = |time: Nanos| share(time).max(Nanos(1));
    times.calc_and_copy = times.calc_and_copy.map(share);
    times.application = share(times.application);
    times.input_copy = times.input_copy.map(share);
    notes.push(format!(
        "the times that it states ({}) do not fit into its minimum cycle time of {}: [times] has them shorter",
        Nanos(needed),
        Nanos(minimum)
    ));
}

/// One note for several objects, naming the first ones by index.
fn note(notes: &mut Vec<String>, indices: &[u16], what: &str) {
    let mut indices = indices.to_vec();
    indices.sort_by_cached_key(|index| u64::from(*index));
    indices.dedup();
    let named: Vec<_> =
        indices.iter().take(MOST_NAMED).map(|index| format!("0x{index:04X}")).collect();
    let more = indices.len().saturating_sub(MOST_NAMED);
    match (named.is_empty(), more) {
        (true, _) => {}
        (false, 0) => notes.push(format!("{}: {what}", named.join(", "))),
        (false, _) => notes.push(format!("{} and {more} more: {what}", named.join(", "))),
    }
}

/// Number of objects that a note names.
const MOST_NAMED: usize = 4;

//! Contradictions within a profile. Each is an error at the line that cannot be true.

use std::ops::{Range, RangeInclusive};

use isocat_descriptions::document::FileError;
use isocat_subdevice::MAX_TRANSFER;
use isocat_sync::object::{self, ShiftBy};
use isocat_sync::{SupportedTypes, SyncType};
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use isocat_wire::register::PROCESS_RAM;
use isocat_wire::time::Nanos;

use super::draft::{Area, Draft, Entry, Object, Placed, buffers};
use super::{ApplicationKind, Startup, drive, unknown};

/// Refuses a profile that contradicts itself.
pub(super) fn check(draft: &Draft<'_>) -> Result<(), FileError> {
    memory(draft)?;
    sync_managers(draft)?;
    emulation(draft)?;
    unreadable(draft)?;
    if draft.mailbox.is_none() {
        without_mailbox(draft)?;
    }
    for (area, name, access) in [
        (&draft.outputs, "outputs", Access::RX_MAPPABLE),
        (&draft.inputs, "inputs", Access::TX_MAPPABLE),
    ] {
        if let Some(area) = area {
            assignment(draft, area, name)?;
            if draft.speaks_coe() {
                mapping(draft, area, access)?;
            }
        }
    }
    for object in &draft.objects {
        entries(draft, object)?;
    }
    stored(draft)?;
    for pair in draft.objects.windows(2) {
        if pair[0].index == pair[1].index {
            let at = pair[0].at.max(pair[1].at);
            return Err(draft.source.error(
                at,
                format!("object 0x{:04X} is defined twice; expected once", pair[0].index),
            ));
        }
    }
    for index in [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER] {
        if let Some(object) = draft.objects.iter().find(|object| object.index == index) {
            synchronization(draft, object)?;
        }
    }
    acknowledge(draft)?;
    application(draft)?;
    startup(draft)?;
    cycle(draft)
}

/// Checks that the downloads at start are possible.
fn startup(draft: &Draft<'_>) -> Result<(), FileError> {
    for Placed { at, value } in &draft.startup {
        let Startup { object, data, complete_access, .. } = value;
        let found = draft.objects.iter().find(|known| known.index == object.index);
        let entry = found.and_then(|known| known.entries.iter().find(|e| e.sub == object.sub));
        let message = match entry {
            None => format!("{object} is written at start, but the device has no such entry"),
            Some(entry) if !entry.access.has(Access::WRITE_PREOP) => {
                format!("{object} is written at start, but can't be written in PREOP")
            }
            Some(entry)
                if !complete_access && usize::from(entry.bits.div_ceil(8)) != data.len() =>
            {
                let (bytes, expected) = (data.len(), entry.bits.div_ceil(8));
                format!("{object} gets {bytes} bytes at start; expected {expected}")
            }
            Some(_) => continue,
        };
        return Err(draft.source.error(*at, message));
    }
    Ok(())
}

/// Checks that a device without a program has no mailbox; its outputs may be registers.
fn emulation(draft: &Draft<'_>) -> Result<(), FileError> {
    let Placed { at, value } = draft.behaviour;
    if value.device_emulation && draft.mailbox.is_some() {
        let message = "behaviour.device_emulation is true beside [mailbox], which needs a program; expected one of them";
        return Err(draft.source.error(at, message));
    }
    for (area, name) in [(&draft.outputs, "outputs"), (&draft.inputs, "inputs")] {
        let Some(area) = area else { continue };
        let (start, end) =
            (usize::from(area.start), usize::from(area.start) + usize::from(area.length));
        let digital = value.device_emulation
            && name == "outputs"
            && DIGITAL_OUTPUTS.contains(&start)
            && end <= DIGITAL_OUTPUTS.end;
        if start < usize::from(PROCESS_RAM) && !digital {
            let message = format!(
                "{name}.start is 0x{start:04X}, with {} bytes; expected 0x{PROCESS_RAM:04X} or more, or digital outputs \
                 at 0x{:04X} to 0x{:04X} beside behaviour.device_emulation",
                area.length,
                DIGITAL_OUTPUTS.start,
                DIGITAL_OUTPUTS.end - 1
            );
            return Err(draft.source.error(area.at, message));
        }
    }
    Ok(())
}

/// Checks that each area has a separate SyncManager, and that the ESC has it.
fn sync_managers(draft: &Draft<'_>) -> Result<(), FileError> {
    let (chip, esc) = draft.esc.chip;
    for (area, name) in [(&draft.outputs, "outputs"), (&draft.inputs, "inputs")] {
        let Some(Area { at, sync_manager, .. }) = area else { continue };
        if *sync_manager < 2 && draft.mailbox.is_some() {
            let message = format!(
                "{name}.sync_manager is {sync_manager}, which is the mailbox; expected 2 or more beside [mailbox]"
            );
            return Err(draft.source.error(*at, message));
        }
        if *sync_manager >= esc.sm_count {
            let most = esc.sm_count - 1;
            let message = format!(
                "{name}.sync_manager is {sync_manager}; expected at most {most}, the last of the {chip}"
            );
            return Err(draft.source.error(*at, message));
        }
    }
    match (&draft.outputs, &draft.inputs) {
        (Some(outputs), Some(inputs)) if outputs.sync_manager == inputs.sync_manager => {
            let message = format!(
                "outputs and inputs are both in SyncManager {}; expected one for each",
                inputs.sync_manager
            );
            Err(draft.source.error(inputs.at.max(outputs.at), message))
        }
        _ => Ok(()),
    }
}

/// Checks that areas are in the ESC's RAM and do not overlap; process data need three buffers.
pub(super) fn memory(draft: &Draft<'_>) -> Result<(), FileError> {
    let mut areas = Vec::new();
    if let Some(mailbox) = draft.mailbox {
        let (receive, send) = (mailbox.value.receive, mailbox.value.send);
        areas.push((mailbox.at, "the receive mailbox", receive.start, u32::from(receive.length)));
        areas.push((mailbox.at, "the send mailbox", send.start, u32::from(send.length)));
    }
    for (area, name) in [
        (&draft.outputs, "the outputs (three buffers)"),
        (&draft.inputs, "the inputs (three buffers)"),
    ] {
        for (at, start, length) in area.iter().flat_map(Area::places) {
            areas.push((at, name, start, buffers(start, length) * u32::from(length)));
        }
    }
    areas.sort_by_cached_key(|(_, _, start, _)| u64::from(*start));
    for pair in areas.windows(2) {
        let (_, name, start, length) = pair[0];
        let (at, next, next_start, _) = pair[1];
        let end = u32::from(start) + length;
        if end > u32::from(next_start) {
            return Err(draft.source.error(
                at,
                format!(
                    "{next}: start 0x{next_start:04X} overlaps; expected a start above 0x{:04X}, the end of \
                     {name}",
                    end - 1
                ),
            ));
        }
    }
    let (chip, esc) = draft.esc.chip;
    let kib = u32::from(esc.ram_kib);
    let ram_end = 0x1000 + kib * 1024;
    for (at, name, start, length) in areas {
        let end = u32::from(start) + length;
        if end > ram_end {
            return Err(draft.source.error(
                at,
                format!(
                    "{name} end at 0x{:04X}; expected at most 0x{:04X}, the end of the {kib} KiB of an \
                     {chip}",
                    end - 1,
                    ram_end - 1
                ),
            ));
        }
    }
    Ok(())
}

/// Checks that the values of all objects fit into the stack's store.
pub(super) fn stored(draft: &Draft<'_>) -> Result<(), FileError> {
    let entries = draft.objects.iter().flat_map(|object| &object.entries);
    let stored: u32 = entries.map(|entry| u32::from(entry.bits.div_ceil(8))).sum();
    if stored > u32::from(u16::MAX) {
        let message = format!("the values take {stored} bytes; expected at most {}", u16::MAX);
        return Err(draft.source.error(0, message));
    }
    Ok(())
}

/// Checks that a device with objects has CoE to read them.
fn unreadable(draft: &Draft<'_>) -> Result<(), FileError> {
    let Some(object) = draft.objects.first().filter(|_| !draft.speaks_coe()) else { return Ok(()) };
    let (without, expected) = match draft.mailbox {
        None => ("a mailbox", "a table [mailbox]"),
        Some(_) => ("CoE", "\"CoE\" in mailbox.protocols"),
    };
    let message = format!(
        "object 0x{:04X} is given, but it cannot be read without {without}; expected {expected}, or no objects",
        object.index
    );
    Err(draft.source.error(object.at, message))
}

/// Checks that a device without mailbox has one length for each direction.
fn without_mailbox(draft: &Draft<'_>) -> Result<(), FileError> {
    for (area, name) in [(&draft.outputs, "outputs"), (&draft.inputs, "inputs")] {
        let Some(area) = area else { continue };
        let bytes = area.bits(&area.default).div_ceil(8);
        if bytes < u32::from(area.length) {
            let message = format!(
                "{name}.length is {}, but {name}.default needs {bytes} bytes and nobody can assign \
                 more without a mailbox; expected {bytes}",
                area.length
            );
            return Err(draft.source.error(area.at, message));
        }
    }
    match draft.modes {
        Some(modes) if modes.value.dc_sync0() && !draft.esc.sync_unit => Err(draft.source.error(
            draft.esc.at,
            "esc.sync_unit is false, but modes has \"dc-sync0\"; expected true",
        )),
        _ => Ok(()),
    }
}

/// Checks that the assigned PDOs are defined, and fit into the slots and into the area.
fn assignment(draft: &Draft<'_>, area: &Area, name: &str) -> Result<(), FileError> {
    for (position, pdo) in area.pdos.iter().enumerate() {
        if draft.speaks_coe() && !MAPPING_OBJECTS.contains(&pdo.index) {
            return Err(draft.source.error(
                pdo.at,
                format!(
                    "PDO 0x{:04X} is no object of PDO mapping; expected 0x{:04X} to 0x{:04X} beside CoE",
                    pdo.index,
                    MAPPING_OBJECTS.start(),
                    MAPPING_OBJECTS.end()
                ),
            ));
        }
        if area.pdos[..position].iter().any(|before| before.index == pdo.index) {
            return Err(draft.source.error(
                pdo.at,
                format!("PDO 0x{:04X} is defined twice; expected once", pdo.index),
            ));
        }
        if pdo.entries.len() > 254 {
            return Err(draft
                .source
                .error(pdo.at, format!("{} entries; expected at most 254", pdo.entries.len())));
        }
    }
    for (key, list) in [("default", &area.default), ("recommended", &area.recommended)] {
        for (position, pdo) in list.iter().enumerate() {
            if area.pdos.iter().all(|defined| defined.index != pdo.value) {
                let defined: Vec<_> =
                    area.pdos.iter().map(|pdo| format!("0x{:04X}", pdo.index)).collect();
                let defined = defined.join(", ");
                return Err(draft.source.error(
                    pdo.at,
                    format!(
                        "{name}.{key} assigns PDO 0x{:04X}, which is not defined; expected one of: \
                         {defined}",
                        pdo.value
                    ),
                ));
            }
            if list[..position].iter().any(|before| before.value == pdo.value) {
                return Err(draft.source.error(
                    pdo.at,
                    format!("{name}.{key} assigns PDO 0x{:04X} twice; expected once", pdo.value),
                ));
            }
        }
        let at = list.first().map_or(area.at, |pdo| pdo.at);
        if list.len() > usize::from(area.slots) {
            return Err(draft.source.error(
                at,
                format!(
                    "{name}.{key} assigns {} PDOs; expected at most {}, the slots",
                    list.len(),
                    area.slots
                ),
            ));
        }
        let bytes = area.bits(list).div_ceil(8);
        if bytes > u32::from(area.length) {
            return Err(draft.source.error(
                at,
                format!(
                    "{name}.{key} needs {bytes} bytes; expected at most {}, the length of the area",
                    area.length
                ),
            ));
        }
    }
    let fixed = !area.access.has_any(Access::WRITE);
    let same =
        area.default.iter().map(|pdo| pdo.value).eq(area.recommended.iter().map(|p| p.value));
    if fixed && !same {
        return Err(draft.source.error(
            area.recommended.first().map_or(area.at, |pdo| pdo.at),
            format!(
                "{name}.recommended differs from {name}.default, but the assignment is read-only; \
                 expected the same"
            ),
        ));
    }
    Ok(())
}

/// Checks that mapped entries are in the dictionary, have the mapped length, and may be mapped in
/// this direction.
fn mapping(draft: &Draft<'_>, area: &Area, direction: Access) -> Result<(), FileError> {
    for entry in area.pdos.iter().flat_map(|pdo| &pdo.entries) {
        let Some(address) = entry.object else { continue };
        let object = draft.objects.iter().find(|object| object.index == address.index);
        let found = object.and_then(|object| object.entries.iter().find(|e| e.sub == address.sub));
        let Some(found) = found else {
            return Err(draft.source.error(
                entry.at,
                format!(
                    "{address} is mapped, but object 0x{:04X} has no such entry",
                    address.index
                ),
            ));
        };
        if found.data_type != entry.data_type {
            return Err(draft.source.error(
                entry.at,
                format!(
                    "{address} is mapped as {}; expected {}, its type in the dictionary",
                    type_name(entry.data_type),
                    type_name(found.data_type)
                ),
            ));
        }
        if !found.access.has(direction) {
            let word = if direction == Access::RX_MAPPABLE { "rx" } else { "tx" };
            return Err(draft
                .source
                .error(entry.at, format!("{address} is mapped, but its access lacks \"{word}\"")));
        }
    }
    Ok(())
}

/// Checks that entries ascend, begin with sub-index 0 and do not overlap in complete access.
fn entries(draft: &Draft<'_>, object: &Object) -> Result<(), FileError> {
    let address = |entry: &Entry| ObjectAddress::new(object.index, entry.sub);
    let Some(first) = object.entries.first() else {
        return Err(draft.source.error(
            object.at,
            format!("object 0x{:04X} has no entries; expected at least sub-index 0", object.index),
        ));
    };
    let counts = first.sub == 0 && first.data_type == DataType::UNSIGNED8;
    if first.sub != 0 || (object.entries.len() > 1 && !counts) {
        return Err(draft.source.error(
            first.at,
            format!(
                "{} is {}; expected sub-index 0 of type UNSIGNED8 first",
                address(first),
                type_name(first.data_type)
            ),
        ));
    }
    if let Some(last) = object.entries.last() {
        let bytes = (last.offset + u32::from(last.bits)).div_ceil(8);
        if bytes > MAX_TRANSFER as u32 {
            return Err(draft.source.error(
                last.at,
                format!(
                    "{} reaches to byte {bytes} of the object; expected at most {MAX_TRANSFER}, what \
                     an SDO can carry",
                    address(last)
                ),
            ));
        }
    }
    for pair in object.entries.windows(2) {
        let (before, entry) = (&pair[0], &pair[1]);
        if entry.sub <= before.sub {
            return Err(draft.source.error(
                entry.at,
                format!("{} follows {}; expected ascending", address(entry), address(before)),
            ));
        }
        // Sub-index 0 takes 16 bits in complete access, whatever its type.
        let bits = if before.sub == 0 { 16 } else { u32::from(before.bits) };
        let free = before.offset + bits;
        if entry.offset < free {
            return Err(draft.source.error(
                entry.at,
                format!(
                    "{} lies at bit {} of complete access, but {} reaches to bit {}; expected {free} \
                     or more",
                    address(entry),
                    entry.offset,
                    address(before),
                    free - 1
                ),
            ));
        }
    }
    Ok(())
}

/// The synchronization type at power-on.
struct Preset {
    /// Place in the file.
    at: usize,
    sync_type: SyncType,
    /// Whether sub-index 04 announces it.
    announced: bool,
}

/// The type at power-on of 0x1C32 or 0x1C33; `None` if it is not known: that contradicts nothing.
fn preset(draft: &Draft<'_>, object: &Object) -> Option<Preset> {
    let types = SupportedTypes(draft.value(object.index, object::sub::SUPPORTED_TYPES)? as u16);
    let entry = object.entries.iter().find(|entry| entry.sub == object::sub::SYNC_TYPE)?;
    if unknown::is_unknown(entry) {
        return None;
    }
    let sync_type = SyncType(draft.value(object.index, object::sub::SYNC_TYPE)? as u16);
    let inputs = object.index == object::INPUT_PARAMETER;
    let announced = match sync_type {
        SyncType::FREE_RUN => types.free_run(),
        SyncType::SM => types.sm_synchronous(),
        SyncType::INPUTS_ON_SM2 => inputs && types.sm_synchronous(),
        SyncType::DC_SYNC0 => types.dc_sync0(),
        SyncType::DC_SYNC1 => types.dc_sync1(),
        _ => false,
    };
    Some(Preset { at: entry.at, sync_type, announced })
}

/// Whether 0x1C32 or 0x1C33 presets a type that it does not announce.
pub(super) fn presets_an_unannounced_type(draft: &Draft<'_>, object: &Object) -> bool {
    preset(draft, object).is_some_and(|preset| !preset.announced)
}

/// Checks that the type at power-on and the shift agree with the announcement of sub-index 04.
fn synchronization(draft: &Draft<'_>, object: &Object) -> Result<(), FileError> {
    let find = |sub| object.entries.iter().find(|entry| entry.sub == sub);
    let value = |sub| draft.value(object.index, sub);
    let address = |sub| ObjectAddress::new(object.index, sub);
    let Some(types) = value(object::sub::SUPPORTED_TYPES) else { return Ok(()) };
    let types = SupportedTypes(types as u16);

    if let Some(Preset { at, sync_type, announced }) = preset(draft, object) {
        if announced && object.contradiction.is_some() {
            return Err(draft.source.error(
                object.at,
                format!(
                    "object 0x{:04X} has a contradiction written, but {} = {types} announces {sync_type}; \
                     expected none",
                    object.index,
                    address(object::sub::SUPPORTED_TYPES)
                ),
            ));
        }
        if !announced && object.contradiction.is_none() {
            return Err(draft.source.error(
                at,
                format!(
                    "{} is {sync_type}, but {} = {types} does not announce it; expected an announced \
                     type, or the key contradiction where the maker's table has it so",
                    address(object::sub::SYNC_TYPE),
                    address(object::sub::SUPPORTED_TYPES)
                ),
            ));
        }
    }
    let command = find(object::sub::GET_CYCLE_TIME);
    if draft.dynamic_times && !command.is_some_and(|entry| entry.access.has(Access::WRITE_OP)) {
        return Err(draft.source.error(
            object.at,
            format!(
                "behaviour.dynamic_times is true, but object 0x{:04X} has no {} to write in OP; \
                 expected one",
                object.index,
                address(object::sub::GET_CYCLE_TIME)
            ),
        ));
    }
    if draft.dynamic_times && draft.behaviour.value.polls_outputs {
        return Err(draft.source.error(
            draft.behaviour.at,
            "behaviour.dynamic_times is true beside polls_outputs, whose fixed time is what 0x1C32:06 \
             states; expected one of them",
        ));
    }
    let supported = find(object::sub::SUPPORTED_TYPES).map_or(object.at, |entry| entry.at);
    let announces = |what: &str, expected: &str| {
        let entry = address(object::sub::SUPPORTED_TYPES);
        draft.source.error(supported, format!("{entry} announces {what}; expected {expected}"))
    };
    if types.shift() == ShiftBy::LocalTimer && find(object::sub::SHIFT_TIME).is_none() {
        let shift = address(object::sub::SHIFT_TIME);
        return Err(announces("shift by local timer", &format!("an entry {shift}")));
    }
    if (types.dc_sync0() || types.dc_sync1()) && !draft.esc.sync_unit {
        return Err(draft.source.error(
            draft.esc.at,
            format!(
                "esc.sync_unit is false, but {} = {types} announces DC; expected true",
                address(object::sub::SUPPORTED_TYPES)
            ),
        ));
    }
    Ok(())
}

/// Checks that only pulses without an end of their own are acknowledged.
fn acknowledge(draft: &Draft<'_>) -> Result<(), FileError> {
    let (time, pulse) = (draft.times.acknowledge, draft.esc.pulse);
    if time.is_some() && pulse > Nanos::ZERO {
        return Err(draft.source.error(
            draft.times.at,
            format!(
                "times.acknowledge is given, but pulses end by themselves with esc.pulse = \"{pulse}\"; expected \
                 esc.pulse = \"0ns\" beside it"
            ),
        ));
    }
    Ok(())
}

/// Checks that a drive has the objects of its application, at whole bytes.
fn application(draft: &Draft<'_>) -> Result<(), FileError> {
    if draft.application != ApplicationKind::Drive
        || drive::layout(&draft.outputs, &draft.inputs).is_some()
    {
        return Ok(());
    }
    for (area, name, expected) in [
        (&draft.outputs, "outputs", [(0x6040, 16), (0x607A, 32)]),
        (&draft.inputs, "inputs", [(0x6041, 16), (0x6064, 32)]),
    ] {
        let mapped: Vec<(u16, u8)> = area
            .iter()
            .flat_map(|area| area.recommended.iter().filter_map(|pdo| area.pdo(pdo.value)))
            .flat_map(|pdo| &pdo.entries)
            .map(|entry| (entry.object.map_or(0, |object| object.index), entry.bits))
            .collect();
        if expected.iter().any(|entry| !drive::has(area, *entry)) {
            let words = |entries: &[(u16, u8)]| {
                let word = |(index, bits): &(u16, u8)| match index {
                    0 => format!("gap/{bits}"),
                    _ => format!("{index:04X}:00/{bits}"),
                };
                let words: Vec<_> = entries.iter().map(word).collect();
                if words.is_empty() { "nothing".to_owned() } else { words.join(", ") }
            };
            let at = area.as_ref().map_or(0, |area| area.at);
            return Err(draft.source.error(
                at,
                format!(
                    "the recommended {name} of a drive map {}; expected {} among them, at whole bytes",
                    words(&mapped),
                    words(&expected)
                ),
            ));
        }
    }
    Ok(())
}

/// Checks that the minimum cycle is below the longest accepted one and leaves time for the CPU's
/// work.
fn cycle(draft: &Draft<'_>) -> Result<(), FileError> {
    let entry = ObjectAddress::new(object::OUTPUT_PARAMETER, object::sub::MINIMUM_CYCLE_TIME);
    let minimum = draft.value(entry.index, entry.sub).unwrap_or(0) as i64;
    let most = draft.behaviour.value.maximum_cycle_time.0;
    if most > 0 && minimum > most {
        return Err(draft.source.error(
            draft.behaviour.at,
            format!(
                "maximum_cycle_time is {}, but {entry} states {} as minimum; expected more",
                draft.behaviour.value.maximum_cycle_time,
                isocat_wire::Nanos(minimum)
            ),
        ));
    }
    let stated = |index| draft.value(index, object::sub::CALC_AND_COPY_TIME).unwrap_or(0) as i64;
    let times = &draft.times;
    let needed = times.calc_and_copy.map_or(stated(object::OUTPUT_PARAMETER), |time| time.0)
        + times.application.0
        + times.input_copy.map_or(stated(object::INPUT_PARAMETER), |time| time.0);
    if minimum > 0 && needed > minimum {
        return Err(draft.source.error(
            times.at,
            format!(
                "calc and copy, application and input copy take {} together; expected at most {}, \
                 the minimum cycle time in {entry}",
                isocat_wire::Nanos(needed),
                isocat_wire::Nanos(minimum)
            ),
        ));
    }
    Ok(())
}

fn type_name(kind: DataType) -> String {
    kind.name().map_or_else(|| format!("type {:#06X}", kind.0), str::to_owned)
}

impl Area {
    /// The PDO with this index.
    fn pdo(&self, index: u16) -> Option<&super::draft::Pdo> {
        self.pdos.iter().find(|pdo| pdo.index == index)
    }

    /// Total number of bits of these PDOs.
    pub(super) fn bits(&self, list: &[Placed<u16>]) -> u32 {
        list.iter().filter_map(|pdo| self.pdo(pdo.value)).map(super::draft::Pdo::bits).sum()
    }
}

/// Objects of PDO mapping, for both directions: makers do not separate them.
const MAPPING_OBJECTS: RangeInclusive<u16> = 0x1600..=0x1BFF;

/// Registers that drive the digital outputs of an ESC.
pub(super) const DIGITAL_OUTPUTS: Range<usize> = 0x0F00..0x0F04;

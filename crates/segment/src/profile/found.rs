//! A profile of a device that a scan has found, from what the wire shows of it.

use isocat_descriptions::document::{FileError, Source};
use isocat_esc::chip::Chip;
use isocat_maindevice::WatchdogRegisters;
use isocat_subdevice::description::{Behaviour, Mailbox, Speaks};
use isocat_sync::object;
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::{Header, MailboxArea};
use isocat_wire::time::Nanos;

use super::draft::{Area, Assumed, Draft, Entry, Esc, Item, Object, Pdo, PdoEntry, Placed, Times};
use super::write::{self, ProfileText};
use super::{ApplicationKind, Identity, OpMode, dictionary, drive, keys, ports, rows, unknown};

/// A device as a scan reports it.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Found {
    /// Its id in segment files; usually its order number.
    pub id: String,
    /// Name of the product, from the SII.
    pub name: String,
    /// Object 0x1018, or words 0x08 to 0x0F of the SII.
    pub identity: Option<Identity>,
    /// Kind of its ESC: register 0x0000.
    pub esc_kind: u8,
    /// Whether its clock has 32 bits.
    pub narrow_clock: bool,
    /// Process RAM of the ESC, KiB: register 0x0006.
    pub ram_kib: u8,
    /// Letters of its ports, as in `Physics` of an ESI file.
    pub ports: String,
    /// Bit 2 of register 0x0141.
    pub sync_unit: bool,
    /// Length of SYNC pulses, register 0x0982: 0 ns to 655.35 us, 0 ns in acknowledge mode; `None`
    /// if it was not read.
    pub pulse: Option<Nanos>,
    /// Word 4 of the SII.
    pub alias: u16,
    /// Bit 0 of register 0x0141.
    pub device_emulation: bool,
    /// Start and length of the receive and the send mailbox, if it has them.
    pub mailbox: Option<[(u16, u16); 2]>,
    /// Protocols of the mailbox, word 0x1C of the SII.
    pub protocols: u16,
    /// Bit 2 of byte 5 of the SII's general category: PDOs can be assigned.
    pub assignable: bool,
    /// Process data from the MainDevice.
    pub outputs: Option<FoundArea>,
    /// Process data to the MainDevice.
    pub inputs: Option<FoundArea>,
    /// Objects 0x1C32 and 0x1C33 by their index, each with its entries.
    pub sync: Vec<(u16, Vec<FoundEntry>)>,
    /// OpModes of the SII.
    pub op_modes: Vec<OpMode>,
}

/// Process data of one direction.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct FoundArea {
    /// Number of the SyncManager.
    pub sync_manager: u8,
    /// First byte.
    pub start: u16,
    /// Bytes.
    pub length: u16,
    /// Assigned PDOs: index, and mapped entries with index and sub-index (0 for padding) and bits.
    pub pdos: Vec<(u16, Vec<(ObjectAddress, u8)>)>,
}

/// An entry of 0x1C32 or 0x1C33.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FoundEntry {
    /// Sub-index.
    pub sub: u8,
    /// The value; `None` if it could not be read.
    pub value: Option<u32>,
    /// Whether it can be written in PREOP; `None` if the device has no SDO information.
    pub writable: Option<bool>,
}

impl ProfileText {
    /// The profile file of a found device; `path` names its source in errors.
    pub fn from_found(found: &Found, path: &str) -> Result<Self, FileError> {
        let source = Source { path, text: "" };
        let Some(identity) = found.identity else {
            return Err(source.error(0, format!("{}: it has no vendor and product", found.id)));
        };
        let mut notes = vec![
            "names of entries, types of numbers, times of the CPU and further objects are not to be seen on a wire"
                .to_owned(),
        ];
        let is_read = found.mailbox.is_some() && found.protocols & Header::COE != 0;
        let sync = found.sync.iter().filter(|_| is_read);
        let objects = sync.map(|(index, entries)| sync_object(*index, entries)).collect();
        let (outputs, inputs) = (area(found, &found.outputs), area(found, &found.inputs));
        let chip = chip(found, &mut notes);
        let emulated = is_emulated(found);
        if found.device_emulation && !emulated {
            notes.push(
                "device emulation (0x0141 bit 0) is on beside a mailbox, which needs a program; it is off here".to_owned(),
            );
        }
        let mut draft = Draft {
            source,
            id: found.id.clone(),
            name: found.name.clone(),
            vendor: format!("vendor 0x{:08X}", identity.vendor_id),
            application: match drive::layout(&outputs, &inputs) {
                Some(_) => ApplicationKind::Drive,
                None => ApplicationKind::Io,
            },
            identity,
            device_type: 0,
            hardware_version: "1.0".to_owned(),
            software_version: "1.0".to_owned(),
            esc: Esc {
                at: 0,
                chip,
                sync_unit: found.sync_unit,
                pulse: found.pulse.unwrap_or(USUAL_PULSE),
                alias: found.alias,
                clock_tolerance: None,
                watchdog: WatchdogRegisters::default(),
            },
            mailbox: found.mailbox.map(|[receive, send]| {
                let area = |(start, length)| MailboxArea { start, length };
                let speaks = Speaks { protocols: found.protocols, drives: 0, parameters: &[] };
                let (receive, send) = (area(receive), area(send));
                Placed { at: 0, value: Mailbox { receive, send, speaks } }
            }),
            protocols: found.protocols,
            modes: None,
            outputs,
            inputs,
            objects,
            op_modes: found.op_modes.clone(),
            startup: Vec::new(),
            parameters: Vec::new(),
            times: times(found),
            behaviour: Placed {
                at: 0,
                value: Behaviour {
                    device_emulation: emulated,
                    watchdog_must_agree: false,
                    ..Behaviour::default()
                },
            },
            dynamic_times: false,
            assumed: Vec::new(),
            deviations: Vec::new(),
            eeprom: None,
        };
        if found.mailbox.is_none() {
            let types = unknown::any_device(&draft.op_modes);
            draft.modes = Some(Placed { at: 0, value: types });
        }
        if found.mailbox.is_some() && objects_lack_sync(&draft) {
            notes.push(
                "objects 0x1C32 and 0x1C33 were not read or are not there: nothing says by what it can be synchronized"
                    .to_owned(),
            );
        }
        assume(&mut draft, found);
        dictionary::complete(&mut draft);
        write::text(draft, path, notes)
    }
}

/// The chip of this kind, or else the usual one, with the memory and the ports that were read.
fn chip(found: &Found, notes: &mut Vec<String>) -> (&'static str, Chip) {
    let chips = || keys::CHIPS.iter().map(|(.., chip)| *chip);
    let as_wide = |chip: &Chip| chip.counts_64_bit() != found.narrow_clock;
    let ports = ports::descriptor(&found.ports);
    let has_ports = |chip: &Chip| chip.can_have_ebus() || !found.ports.contains('K');
    let fits = |chip: &Chip| as_wide(chip) && has_ports(chip);
    let known = chips().find(|(_, chip)| chip.kind == found.esc_kind && fits(chip));
    // An ET1100 can have any ports.
    let other = chips().find(|(_, chip)| fits(chip)).unwrap_or(keys::CHIPS[0].2);
    let (name, chip) = known.unwrap_or(other);
    if known.is_none() {
        let bits = if found.narrow_clock { 32 } else { 64 };
        notes.push(format!(
            "its ESC (kind 0x{:02X} in register 0x0000, clock of {bits} bits) is none that a profile can name; {name} \
             is taken",
            found.esc_kind
        ));
    }
    let ram_kib = if found.ram_kib == 0 { chip.ram_kib } else { found.ram_kib.min(60) };
    let ports = if ports == 0 { chip.port_descriptor } else { ports };
    (name, Chip { ram_kib, ..*chip }.with_ports(ports))
}

/// Whether there is no program behind the ESC.
fn is_emulated(found: &Found) -> bool {
    found.device_emulation && found.mailbox.is_none()
}

/// Whether no reading states the synchronization modes of the device.
fn objects_lack_sync(draft: &Draft<'_>) -> bool {
    !draft.objects.iter().any(|object| object.index == object::OUTPUT_PARAMETER)
}

fn area(found: &Found, area: &Option<FoundArea>) -> Option<Area> {
    let area = area.as_ref()?;
    let pdos: Vec<_> = area.pdos.iter().map(|(index, entries)| pdo(*index, entries)).collect();
    let assigned: Vec<_> =
        area.pdos.iter().map(|(index, _)| Placed { at: 0, value: *index }).collect();
    Some(Area {
        at: 0,
        sync_manager: area.sync_manager,
        start: area.start,
        length: area.length,
        access: match found.assignable {
            true => Access::READ.with(Access::WRITE_PREOP),
            false => Access::READ,
        },
        slots: pdos.len().clamp(1, 254) as u8,
        default: assigned.clone(),
        recommended: assigned,
        pdos,
        further: Vec::new(),
    })
}

fn pdo(index: u16, entries: &[(ObjectAddress, u8)]) -> Pdo {
    let mut all = Vec::new();
    for (object, bits) in entries {
        let is_padding = object.index == 0;
        let mut left = *bits;
        while left > 0 {
            // Padding has 64 bits at most in one row.
            let bits = if is_padding { left.min(64) } else { left };
            left -= bits;
            all.push(PdoEntry {
                at: 0,
                object: (!is_padding).then_some(*object),
                data_type: match is_padding {
                    true => DataType::GAP,
                    false => dictionary::drive_type(object.index, bits).unwrap_or(by_bits(bits)),
                },
                bits,
                name: if is_padding { String::new() } else { object.to_string() },
            });
        }
    }
    Pdo { at: 0, index, name: format!("PDO 0x{index:04X}"), entries: all }
}

/// The type of a number with this many bits; the sign is not known.
fn by_bits(bits: u8) -> DataType {
    match bits {
        1 => DataType::BOOLEAN,
        2 => DataType::BIT2,
        3 => DataType::BIT3,
        4 => DataType::BIT4,
        5 => DataType::BIT5,
        6 => DataType::BIT6,
        7 => DataType::BIT7,
        8 => DataType::UNSIGNED8,
        16 => DataType::UNSIGNED16,
        24 => DataType::UNSIGNED24,
        32 => DataType::UNSIGNED32,
        64 => DataType::UNSIGNED64,
        _ => DataType::OCTET_STRING,
    }
}

/// 0x1C32 or 0x1C33, with the types of ETG.1020.
fn sync_object(index: u16, found: &[FoundEntry]) -> Object {
    let mut entries: Vec<Entry> = Vec::new();
    let highest = found.iter().map(|entry| entry.sub).max().unwrap_or(0);
    let count = FoundEntry { sub: 0, value: Some(highest.into()), writable: Some(false) };
    let missing = found.iter().all(|entry| entry.sub != 0 || entry.value.is_none());
    // Sub-indices that are not in ETG.1020 and cannot be read are gaps.
    let is_there = |entry: &&FoundEntry| entry.value.is_some() || object::name(entry.sub).is_some();
    let rest = found.iter().filter(|entry| entry.sub != 0 || !missing).filter(is_there);
    for entry in missing.then_some(&count).into_iter().chain(rest) {
        let data_type = data_type(entry);
        let bits = data_type.bits().unwrap_or(32);
        let bytes = |value: u32| value.to_le_bytes()[..usize::from(bits.div_ceil(8))].to_vec();
        let default = entry.value.map_or(Vec::new(), bytes);
        // The command to measure is written in OP.
        let access = match (is_writable(entry), entry.sub) {
            (true, object::sub::GET_CYCLE_TIME) => Access::READ.with(Access::WRITE),
            (true, _) => Access::READ.with(Access::WRITE_PREOP),
            (false, _) => Access::READ,
        };
        // The device's own sub-indices may reach into the place of the next one of ETG.1020.
        let free = entries.last().map_or(0, |last| match last.sub {
            0 => 16,
            _ => last.offset + u32::from(last.bits),
        });
        let name = match entry.sub {
            0 => "Highest sub-index supported".to_owned(),
            sub => object::name(sub).map_or(format!("SubIndex {sub:03}"), str::to_owned),
        };
        entries.push(Entry {
            at: 0,
            sub: entry.sub,
            name,
            data_type,
            bits,
            offset: rows::next_offset(index, entry.sub, &entries).max(free),
            access,
            written: entry.value.map_or(rows::UNKNOWN.to_owned(), |value| value.to_string()),
            default,
        });
    }
    Object {
        at: 0,
        index,
        name: if index == object::OUTPUT_PARAMETER {
            "SM output parameter"
        } else {
            "SM input parameter"
        }
        .to_owned(),
        code: ObjectCode::RECORD,
        data_type: DataType::SYNC_PAR,
        entries,
        contradiction: None,
    }
}

/// The type of an entry by ETG.1020; if the value does not fit, one that is large enough.
fn data_type(entry: &FoundEntry) -> DataType {
    let usual = match entry.sub {
        0 => DataType::UNSIGNED8,
        object::sub::SYNC_TYPE
        | object::sub::SUPPORTED_TYPES
        | object::sub::GET_CYCLE_TIME
        | object::sub::SM_EVENT_MISSED..=object::sub::TOGGLE_FAILED => DataType::UNSIGNED16,
        object::sub::SYNC_ERROR => DataType::BOOLEAN,
        // Sub-indices that are not in ETG.1020 are usually short.
        sub if object::name(sub).is_none() => DataType::UNSIGNED8,
        _ => DataType::UNSIGNED32,
    };
    let has_room = |value: u32| u64::from(value) >> usual.bits().unwrap_or(32) == 0;
    match entry.value.is_none_or(has_room) || entry.sub == 0 {
        true => usual,
        false => DataType::UNSIGNED32,
    }
}

/// Whether an entry can be written; without SDO information, those that a MainDevice writes.
fn is_writable(entry: &FoundEntry) -> bool {
    let usual = matches!(entry.sub, object::sub::SYNC_TYPE | object::sub::CYCLE_TIME);
    entry.writable.unwrap_or(usual)
}

/// The stated times of its CPU; a time that is not stated is short compared with usual cycles.
fn times(found: &Found) -> Times {
    if is_emulated(found) {
        return Times::none(0);
    }
    let stated = |index| stated(found, index).unwrap_or(SHORT);
    Times {
        reaction: Nanos::micros(50),
        calc_and_copy: Some(stated(object::OUTPUT_PARAMETER)),
        application: SHORT,
        input_copy: Some(stated(object::INPUT_PARAMETER)),
        ..Times::none(0)
    }
}

/// Sub-index 06 of 0x1C32 or 0x1C33, if it is stated.
fn stated(found: &Found, index: u16) -> Option<Nanos> {
    let (_, entries) = found.sync.iter().find(|(found, _)| *found == index)?;
    let entry = entries.iter().find(|entry| entry.sub == object::sub::CALC_AND_COPY_TIME)?;
    Some(Nanos::from_u32(entry.value?)).filter(|time| *time > Nanos::ZERO)
}

/// Lists what the wire does not show.
fn assume(draft: &mut Draft<'_>, found: &Found) {
    let mut assume = |item: &str, why: &str| {
        let item = Placed { at: 0, value: Item::Key(item.to_owned(), String::new()) };
        draft.assumed.push(Assumed { item, why: why.to_owned() });
    };
    if found.pulse.is_none() && found.sync_unit {
        assume("esc.pulse", "the SII was not read; the usual one");
    }
    if found.mailbox.is_none() {
        let why =
            "without a mailbox it does not tell; what any device can do, and what its OpModes need";
        assume("modes", why);
    }
    if is_emulated(found) {
        return;
    }
    for (index, entries) in &found.sync {
        for entry in entries.iter().filter(|entry| entry.writable.is_none() && is_writable(entry)) {
            assume(
                &format!("0x{index:04X}:{:02X} access", entry.sub),
                "the device has no SDO information",
            );
        }
    }
    let why = "not to be seen on the wire; short against usual cycles";
    for (index, key) in [
        (object::OUTPUT_PARAMETER, "times.calc_and_copy"),
        (object::INPUT_PARAMETER, "times.input_copy"),
    ] {
        if stated(found, index).is_none() {
            assume(key, why);
        }
    }
    assume("times.application", why);
    assume("times.reaction", "not to be seen on the wire; as of most programs");
    assume("identity.device_type", "a scan does not read 0x1000");
    assume("identity.hardware_version", "a scan does not read 0x1009");
    assume("identity.software_version", "a scan does not read 0x100A");
}

/// CPU time for a step that is not stated.
const SHORT: Nanos = Nanos::micros(10);
/// Length of SYNC pulses if it is not known.
const USUAL_PULSE: Nanos = Nanos::micros(10);

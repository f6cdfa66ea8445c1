//! The object dictionary: first the objects that follow from short fields, then the static form of
//! all.

use isocat_descriptions::document::FileError;
use isocat_descriptions::start_up::Transition;
use isocat_subdevice::description::{Behaviour, Measured, Preset, ProcessDataArea};
use isocat_subdevice::{Description, Entry, Object};
use isocat_sync::SupportedTypes;
use isocat_sync::object::{self, ShiftBy};
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::sm_type;
use isocat_wire::time::Nanos;

use super::draft::{self, Area, Draft, Item, Pdo, Placed, Property};
use super::{
    ApplicationKind, Assignment, Assumption, CpuTimes, Origin, Profile, Startup, rows, sii, unknown,
};

/// Adds the objects that every device has or that follow from other parts of the file. An object in
/// the file stays unchanged.
pub(super) fn complete(draft: &mut Draft<'_>) {
    if !draft.speaks_coe() {
        // Without CoE they could not be read.
        return;
    }
    let at = GENERATED;
    let text = |index, name: &str, value: &str| {
        let row = Row { sub: 0, name, data_type: DataType::VISIBLE_STRING, access: Access::READ };
        var(at, index, row, value.as_bytes().to_vec())
    };
    let identity = draft.identity;
    let device_type = row(0, "Device type", DataType::UNSIGNED32, Access::READ);
    let mut generated = vec![
        var(at, 0x1000, device_type, draft.device_type.to_le_bytes().to_vec()),
        text(0x1008, "Device name", &draft.name),
        text(0x1009, "Manufacturer hardware version", &draft.hardware_version),
        text(0x100A, "Manufacturer software version", &draft.software_version),
        Group::new(at, 0x1018, "Identity", ObjectCode::RECORD, DataType::IDENTITY)
            .u32(1, "Vendor ID", identity.vendor_id)
            .u32(2, "Product code", identity.product_code)
            .u32(3, "Revision number", identity.revision)
            .u32(4, "Serial number", identity.serial)
            .finish(Access::READ, 4),
    ];

    let mut uses =
        vec![sm_type::MAILBOX_OUT, sm_type::MAILBOX_IN, sm_type::UNUSED, sm_type::UNUSED];
    for (area, kind) in [(&draft.outputs, sm_type::OUTPUTS), (&draft.inputs, sm_type::INPUTS)] {
        let Some(area) = area else { continue };
        let number = usize::from(area.sync_manager);
        uses.resize(uses.len().max(number + 1), sm_type::UNUSED);
        uses[number] = kind;
        for share in &area.further {
            let number = usize::from(share.sync_manager);
            uses.resize(uses.len().max(number + 1), sm_type::UNUSED);
            uses[number] = kind;
        }
    }
    let count = uses.len() as u8;
    let mut types = Group::new(
        at,
        object::SM_COMMUNICATION_TYPE,
        "SyncManager communication type",
        ObjectCode::ARRAY,
        DataType::UNSIGNED8,
    );
    for (sm, value) in (0u8..).zip(uses) {
        let name = format!("SyncManager {sm}");
        types = types.entry(row(sm + 1, &name, DataType::UNSIGNED8, Access::READ), vec![value]);
    }
    generated.push(types.finish(Access::READ, count));

    for (area, index, name) in [
        (&draft.outputs, object::OUTPUT_ASSIGNMENT, "RxPDO assign"),
        (&draft.inputs, object::INPUT_ASSIGNMENT, "TxPDO assign"),
    ] {
        if let Some(area) = area {
            generated.push(assignment(area, index, name));
            generated.extend(area.further.iter().map(|share| fixed_assignment(share, name)));
            generated.extend(area.pdos.iter().map(mapping));
        }
    }
    add_missing(&mut draft.objects, generated);
    if draft.application == ApplicationKind::Drive {
        add_missing(&mut draft.objects, [interpolation_time()]);
        add_missing(
            &mut draft.objects,
            DRIVE.map(|(index, name, data_type, access, value)| {
                let bytes = usize::from(data_type.bits().unwrap_or(32).div_ceil(8));
                let value = value.to_le_bytes()[..bytes].to_vec();
                var(at, index, row(0, name, data_type, access), value)
            }),
        );
    }
    let outputs = draft.outputs.iter().map(|area| (area, Access::RX_MAPPABLE.with(Access::WRITE)));
    let inputs = draft.inputs.iter().map(|area| (area, Access::TX_MAPPABLE));
    let mapped = outputs.chain(inputs).flat_map(|(area, access)| mapped_objects(area, access));
    let mapped: Vec<_> = mapped.collect();
    add_missing(&mut draft.objects, mapped);
    draft.objects.sort_by_cached_key(|object| u64::from(object.index));
    if draft.eeprom.is_none() {
        unknown::complete(draft);
    }
}

/// The place of what is not in the file: no object begins at its first byte.
const GENERATED: usize = 0;

/// Has the interpolation time written at start if the file has the object: it becomes the cycle.
/// Nothing is written to a drive whose file is silent, since a real one may be without.
///
/// What [`complete`] adds is not from the file, and has no place in it.
fn interpolate(draft: &mut Draft<'_>) {
    let index = object::INTERPOLATION_TIME;
    let written = |one: &Placed<Startup>| one.value.object.index == index;
    let parts = [(1, DataType::UNSIGNED8), (2, DataType::INTEGER8)];
    if draft.startup.iter().any(written) {
        return;
    }
    let from_file = |object: &&draft::Object| object.index == index && object.at != GENERATED;
    let object = draft.objects.iter().find(from_file);
    let part = |(sub, data_type)| {
        let mut entries = object?.entries.iter();
        let entry = entries.find(|entry| entry.sub == sub && entry.data_type == data_type)?;
        let value = Startup {
            transition: Transition::PS,
            object: ObjectAddress::new(index, sub),
            data: entry.default.clone(),
            complete_access: false,
        };
        let is_writable = entry.access.has(Access::WRITE_PREOP) && value.data.len() == 1;
        is_writable.then_some(Placed { at: entry.at, value })
    };
    let downloads: Option<Vec<_>> = parts.into_iter().map(part).collect();
    draft.startup.extend(downloads.unwrap_or_default());
}

/// The interpolation time of a drive, 1 ms after power-on.
fn interpolation_time() -> draft::Object {
    let index = object::INTERPOLATION_TIME;
    let access = Access::READ.with(Access::WRITE);
    let units = row(1, "Interpolation time units", DataType::UNSIGNED8, access);
    let power = row(2, "Interpolation time index", DataType::INTEGER8, access);
    // CiA 402 gives this record a type of its own.
    Group::new(GENERATED, index, "Interpolation time period", ObjectCode::RECORD, DataType(0x0080))
        .entry(units, vec![1])
        .entry(power, vec![(-3_i8).cast_unsigned()])
        .finish(Access::READ, 2)
}

/// Sets the power-on value of a 32-bit entry to another time; `None` if there is no such entry, or
/// the presets are full.
pub(super) fn preset(
    description: &mut Description,
    address: ObjectAddress,
    time: Nanos,
) -> Option<()> {
    let value = time.to_u32()?.to_le_bytes();
    let store = description.entry(address).filter(|entry| entry.bits == 32)?.store;
    let own = |preset: &&mut Option<Preset>| preset.is_none_or(|preset| preset.store == store);
    *description.behaviour.presets.iter_mut().find(own)? = Some(Preset { store, value });
    Some(())
}

impl Draft<'_> {
    /// The profile. The draft has passed `check`.
    pub(super) fn finish(mut self) -> Result<Profile, FileError> {
        interpolate(&mut self);
        let sii = sii::image(&self)?;
        let assumptions = self.assumptions()?;
        let stated = |index, sub| self.value(index, sub).map(|ns| Nanos::from_u32(ns as u32));
        let follow = |given: Option<Nanos>, index, key: &str| {
            given
                .or_else(|| stated(index, object::sub::CALC_AND_COPY_TIME).filter(|t| t.0 > 0))
                .ok_or_else(|| {
                    self.source.error(
                        self.times.at,
                        format!(
                            "times.{key} is missing; expected a duration, since {} states none to \
                             follow",
                            ObjectAddress::new(index, object::sub::CALC_AND_COPY_TIME)
                        ),
                    )
                })
        };
        let times = CpuTimes {
            reaction: self.times.reaction,
            calc_and_copy: follow(
                self.times.calc_and_copy,
                object::OUTPUT_PARAMETER,
                "calc_and_copy",
            )?,
            application: self.times.application,
            input_copy: follow(self.times.input_copy, object::INPUT_PARAMETER, "input_copy")?,
            jitter: self.times.jitter,
            acknowledge: self.times.acknowledge.unwrap_or(Nanos::ZERO),
            unevenness: self.times.unevenness,
        };
        // This comes last, since the CPU's times follow the values of the file.
        if self.dynamic_times {
            self.state_no_times();
        }
        let shifts_by = |index, by| {
            self.value(index, object::sub::SUPPORTED_TYPES)
                .is_some_and(|types| SupportedTypes(types as u16).shift() == by)
        };
        let local_timer = |index| shifts_by(index, ShiftBy::LocalTimer);
        let area = |area: &Option<Area>, other: &Option<Area>, usual: u8| match area {
            Some(Area { sync_manager, start, length, .. }) => {
                ProcessDataArea { sync_manager: *sync_manager, start: *start, max_length: *length }
            }
            // A number that the other direction does not use.
            None => {
                let is_taken = |number: &u8| {
                    other.as_ref().is_some_and(|other| {
                        let further = other.further.iter().map(|share| share.sync_manager);
                        std::iter::once(other.sync_manager).chain(further).any(|own| own == *number)
                    })
                };
                let mut numbers = [usual, usual ^ 1].into_iter().chain(4..16);
                let sync_manager = numbers.find(|number| !is_taken(number)).unwrap_or(usual);
                ProcessDataArea { sync_manager, start: 0, max_length: 0 }
            }
        };
        let further = |area: &Option<Area>| {
            let share = |share: &draft::Share| ProcessDataArea {
                sync_manager: share.sync_manager,
                start: share.start,
                max_length: share.length,
            };
            leak(area.iter().flat_map(|area| &area.further).map(share).collect())
        };
        let recommended = |area: &Option<Area>| {
            area.iter().flat_map(|area| &area.recommended).map(|pdo| pdo.value).collect()
        };
        let description = Description {
            objects: store(&self.objects),
            mailbox: self.mailbox.map(|mailbox| mailbox.value),
            outputs: area(&self.outputs, &self.inputs, 2),
            inputs: area(&self.inputs, &self.outputs, 3),
            further_outputs: further(&self.outputs),
            further_inputs: further(&self.inputs),
            behaviour: Behaviour {
                shift_outputs: local_timer(object::OUTPUT_PARAMETER),
                shift_inputs: local_timer(object::INPUT_PARAMETER),
                outputs_on_sync1: shifts_by(object::OUTPUT_PARAMETER, ShiftBy::Sync1),
                undeclared_types: match self.modes {
                    Some(modes) => modes.value,
                    None => self.behaviour.value.undeclared_types,
                },
                ..self.behaviour.value
            },
        };
        Ok(Profile {
            identity: self.identity,
            description,
            sii: sii.into(),
            chip: self.esc.chip.0,
            esc: self.esc.chip.1,
            clock_tolerance: self.esc.clock_tolerance,
            watchdog: self.esc.watchdog,
            times,
            application: self.application,
            sampling: None,
            assignment: Assignment {
                outputs: recommended(&self.outputs),
                inputs: recommended(&self.inputs),
            },
            assumptions,
            deviations: self.deviations,
            dynamic_times: self.dynamic_times,
            origin: Origin::Profile,
            calc_and_copy_given: self.times.calc_and_copy.is_some(),
            id: self.id,
            name: self.name,
            vendor: self.vendor,
            op_modes: self.op_modes,
            startup: self.startup.into_iter().map(|startup| startup.value).collect(),
            parameters: self.parameters,
            doubts: Vec::new(),
            physics: None,
        })
    }

    /// Announces dynamic times, and sets those of the sync objects to 0 until they are measured.
    fn state_no_times(&mut self) {
        let parameters = [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER];
        let measured = [
            object::sub::MINIMUM_CYCLE_TIME,
            object::sub::CALC_AND_COPY_TIME,
            object::sub::DELAY_TIME,
        ];
        let objects = self.objects.iter_mut().filter(|object| parameters.contains(&object.index));
        for entry in objects.flat_map(|object| &mut object.entries) {
            if measured.contains(&entry.sub) {
                entry.default.fill(0);
            }
            if let (object::sub::SUPPORTED_TYPES, [_, high]) = (entry.sub, &mut entry.default[..]) {
                *high |= (SupportedTypes::DYNAMIC_TIMES >> 8) as u8;
            }
        }
        let all = Measured {
            minimum_cycle: true,
            calc_and_copy: true,
            delay: true,
            ..self.behaviour.value.measured
        };
        self.behaviour.value.measured = all;
    }

    /// The default value of an entry.
    pub(super) fn value(&self, index: u16, sub: u8) -> Option<u64> {
        let object = self.objects.iter().find(|object| object.index == index)?;
        let entry = object.entries.iter().find(|entry| entry.sub == sub)?;
        let mut bytes = [0; 8];
        bytes.get_mut(..entry.default.len())?.copy_from_slice(&entry.default);
        Some(u64::from_le_bytes(bytes))
    }

    /// The items of `[[assumed]]`, with the values from the file.
    fn assumptions(&self) -> Result<Vec<Assumption>, FileError> {
        let finish = |assumed: &draft::Assumed| {
            let (item, value) = match &assumed.item.value {
                Item::Key(key, value) => (key.clone(), value.clone()),
                Item::Object(index) => (format!("0x{index:04X}"), self.object_in_words(*index)),
                Item::Entries { index, first, last, property } => {
                    let object = self.objects.iter().find(|object| object.index == *index);
                    let entries = object.iter().flat_map(|object| &object.entries);
                    let mut values = entries
                        .filter(|entry| (*first..=*last).contains(&entry.sub))
                        .map(|entry| match property {
                            Property::Value => entry.written.clone(),
                            Property::Access => in_words(entry.access),
                            Property::Offset => format!("bit {}", entry.offset),
                        });
                    let value = values.next().unwrap_or_default();
                    let same = values.all(|other| other == value);
                    let mut item = ObjectAddress::new(*index, *first).to_string();
                    if first != last {
                        item += &format!("-{last:02X}");
                    }
                    item += match property {
                        Property::Value => "",
                        Property::Access => " access",
                        Property::Offset => " offset",
                    };
                    (item, if same { value } else { "as listed".to_owned() })
                }
            };
            if value.is_empty() {
                let error = self.source.error(
                    assumed.item.at,
                    format!(
                        "{item} is assumed, but the device does not have it; expected an entry \
                             of its dictionary"
                    ),
                );
                return Err(error);
            }
            Ok(Assumption { item, value, why: assumed.why.clone() })
        };
        self.assumed.iter().map(finish).collect()
    }

    /// The mapping of a PDO, or the number of entries of another object; empty if there is no such
    /// object.
    fn object_in_words(&self, index: u16) -> String {
        let areas = self.outputs.iter().chain(&self.inputs);
        if let Some(pdo) = areas.flat_map(|area| &area.pdos).find(|pdo| pdo.index == index) {
            let entry = |entry: &draft::PdoEntry| match entry.object {
                Some(ObjectAddress { index, sub }) => {
                    format!("{index:04X}:{sub:02X}/{}", entry.bits)
                }
                None => format!("gap/{}", entry.bits),
            };
            return pdo.entries.iter().map(entry).collect::<Vec<_>>().join(", ");
        }
        match self.objects.iter().find(|object| object.index == index) {
            Some(object) => format!("{} entries", object.entries.len()),
            None => String::new(),
        }
    }
}

/// The static form of all objects, with an offset in the value store for every entry.
fn store(objects: &[draft::Object]) -> &'static [Object] {
    let mut at = 0;
    let mut place = |entry: &draft::Entry| {
        let store = at;
        at += entry.bits.div_ceil(8);
        Entry {
            sub: entry.sub,
            name: leak_text(&entry.name),
            data_type: entry.data_type,
            bits: entry.bits,
            complete_access_offset: entry.offset,
            access: entry.access,
            store,
            default: leak(entry.default.clone()),
        }
    };
    let object = |object: &draft::Object| Object {
        index: object.index,
        name: leak_text(&object.name),
        code: object.code,
        data_type: object.data_type,
        entries: leak(object.entries.iter().map(&mut place).collect()),
    };
    leak(objects.iter().map(object).collect())
}

pub(super) fn leak<T>(items: Vec<T>) -> &'static [T] {
    Box::leak(items.into_boxed_slice())
}

pub(super) fn leak_text(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

fn in_words(access: Access) -> String {
    let mut words = vec![match (access.has(Access::READ), access.has_any(Access::WRITE)) {
        (true, true) => "rw",
        (true, false) => "ro",
        (false, _) => "wo",
    }];
    if access.has_any(Access::WRITE) && !access.has(Access::WRITE) {
        for (right, word) in [
            (Access::WRITE_PREOP, "preop"),
            (Access::WRITE_SAFEOP, "safeop"),
            (Access::WRITE_OP, "op"),
        ] {
            words.extend(access.has(right).then_some(word));
        }
    }
    for (right, word) in [(Access::RX_MAPPABLE, "rx"), (Access::TX_MAPPABLE, "tx")] {
        words.extend(access.has(right).then_some(word));
    }
    words.join(" ")
}

fn add_missing(
    objects: &mut Vec<draft::Object>,
    generated: impl IntoIterator<Item = draft::Object>,
) {
    for object in generated {
        if objects.iter().all(|present| present.index != object.index) {
            objects.push(object);
        }
    }
}

/// The object 0x1C12 or 0x1C13.
fn assignment(area: &Area, index: u16, name: &str) -> draft::Object {
    let mut group = Group::new(area.at, index, name, ObjectCode::ARRAY, DataType::UNSIGNED16);
    for slot in 0..area.slots {
        let pdo = area.default.get(usize::from(slot)).map_or(0, |pdo| pdo.value);
        let name = format!("SubIndex {:03}", slot + 1);
        let row = row(slot + 1, &name, DataType::UNSIGNED16, area.access);
        group = group.entry(row, pdo.to_le_bytes().to_vec());
    }
    // `check` refuses more PDOs than slots.
    group.finish(area.access, area.default.len().min(255) as u8)
}

/// The assignment of a further SyncManager. It is read only.
fn fixed_assignment(share: &draft::Share, name: &str) -> draft::Object {
    let (code, kind) = (ObjectCode::ARRAY, DataType::UNSIGNED16);
    let name = format!("{name} (SM{})", share.sync_manager);
    let mut group = Group::new(share.at, share.assignment(), &name, code, kind);
    for (number, pdo) in (1u8..=254).zip(&share.pdos) {
        let name = format!("SubIndex {number:03}");
        let row = row(number, &name, kind, Access::READ);
        group = group.entry(row, pdo.to_le_bytes().to_vec());
    }
    group.finish(Access::READ, share.pdos.len().min(254) as u8)
}

/// A PDO's mapping object. It is read only.
fn mapping(pdo: &Pdo) -> draft::Object {
    let (code, kind) = (ObjectCode::RECORD, DataType::PDO_MAPPING);
    let mut group = Group::new(pdo.at, pdo.index, &pdo.name, code, kind);
    for (number, entry) in (1u8..=254).zip(&pdo.entries) {
        let object = entry.object.unwrap_or(ObjectAddress::new(0, 0));
        let value =
            u32::from(object.index) << 16 | u32::from(object.sub) << 8 | u32::from(entry.bits);
        group = group.u32(number, &format!("SubIndex {number:03}"), value);
    }
    group.finish(Access::READ, pdo.entries.len().min(254) as u8)
}

/// The objects that an area's PDOs map.
fn mapped_objects(area: &Area, access: Access) -> Vec<draft::Object> {
    let access = Access::READ.with(access);
    let mut mapped: Vec<(ObjectAddress, &draft::PdoEntry)> = area
        .pdos
        .iter()
        .flat_map(|pdo| &pdo.entries)
        .filter_map(|entry| Some((entry.object?, entry)))
        .collect();
    mapped.sort_by_cached_key(|(object, _)| u64::from(object.index) << 8 | u64::from(object.sub));
    mapped.dedup_by_key(|(object, _)| *object);
    let objects = mapped.chunk_by(|(one, _), (other, _)| one.index == other.index);
    let object = |entries: &[(ObjectAddress, &draft::PdoEntry)]| {
        let (first, entry) = entries[0];
        let zeros = |entry: &draft::PdoEntry| vec![0; usize::from(entry.bits.div_ceil(8))];
        if first.sub == 0 {
            let row = row(0, &entry.name, entry.data_type, access);
            return var(entry.at, first.index, row, zeros(entry));
        }
        let name = format!("Object {:04X}", first.index);
        let code = ObjectCode::RECORD;
        let mut group = Group::new(entry.at, first.index, &name, code, rows::RECORD);
        let mut highest = 0;
        for (object, entry) in entries {
            highest = object.sub;
            group =
                group.entry(row(object.sub, &entry.name, entry.data_type, access), zeros(entry));
        }
        group.finish(Access::READ, highest)
    };
    objects.map(object).collect()
}

struct Row<'a> {
    sub: u8,
    name: &'a str,
    data_type: DataType,
    access: Access,
}

fn row(sub: u8, name: &str, data_type: DataType, access: Access) -> Row<'_> {
    Row { sub, name, data_type, access }
}

/// A single value.
fn var(at: usize, index: u16, row: Row<'_>, value: Vec<u8>) -> draft::Object {
    let (code, data_type, name) = (ObjectCode::VAR, row.data_type, row.name.to_owned());
    let entries = vec![entry(at, index, row, value, &[])];
    draft::Object { at, index, name, code, data_type, entries, contradiction: None }
}

fn entry(
    at: usize,
    index: u16,
    row: Row<'_>,
    value: Vec<u8>,
    before: &[draft::Entry],
) -> draft::Entry {
    let number = value.iter().take(8).rev().fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
    draft::Entry {
        at,
        sub: row.sub,
        name: row.name.to_owned(),
        data_type: row.data_type,
        bits: row.data_type.bits().unwrap_or(8 * value.len() as u16),
        offset: rows::next_offset(index, row.sub, before),
        access: row.access,
        written: match row.data_type {
            DataType::VISIBLE_STRING => String::from_utf8_lossy(&value).into_owned(),
            _ => format!("{number:#x}"),
        },
        default: value,
    }
}

/// An ARRAY or RECORD under construction; [`Group::finish`] adds sub-index 0.
struct Group {
    object: draft::Object,
}

impl Group {
    fn new(at: usize, index: u16, name: &str, code: ObjectCode, data_type: DataType) -> Self {
        let (name, entries) = (name.to_owned(), Vec::new());
        let mut group = Self {
            object: draft::Object {
                at,
                index,
                name,
                code,
                data_type,
                entries,
                contradiction: None,
            },
        };
        let count = row(0, "Highest sub-index supported", DataType::UNSIGNED8, Access::READ);
        group = group.entry(count, vec![0]);
        group
    }

    fn entry(mut self, row: Row<'_>, value: Vec<u8>) -> Self {
        let draft::Object { at, index, ref entries, .. } = self.object;
        let entry = entry(at, index, row, value, entries);
        self.object.entries.push(entry);
        self
    }

    fn u32(self, sub: u8, name: &str, value: u32) -> Self {
        let row = row(sub, name, DataType::UNSIGNED32, Access::READ);
        self.entry(row, value.to_le_bytes().to_vec())
    }

    fn finish(mut self, access: Access, count: u8) -> draft::Object {
        let first = &mut self.object.entries[0];
        first.access = access;
        first.default = vec![count];
        first.written = count.to_string();
        self.object
    }
}

/// The type of an object of a CiA 402 drive, if it has this number of bits.
pub(super) fn drive_type(index: u16, bits: u8) -> Option<DataType> {
    let (_, _, data_type, ..) = DRIVE.iter().find(|(known, ..)| *known == index)?;
    Some(*data_type).filter(|kind| kind.bits() == Some(bits.into()))
}

/// Objects of a CiA 402 drive for cyclic synchronous position mode.
const DRIVE: [(u16, &str, DataType, Access, u32); 8] = {
    const COMMAND: Access = Access::READ.with(Access::WRITE).with(Access::RX_MAPPABLE);
    const STATUS: Access = Access::READ.with(Access::TX_MAPPABLE);
    [
        (0x603F, "Error code", DataType::UNSIGNED16, STATUS, 0),
        (0x6040, "Controlword", DataType::UNSIGNED16, COMMAND, 0),
        (0x6041, "Statusword", DataType::UNSIGNED16, STATUS, 0),
        (0x6060, "Modes of operation", DataType::INTEGER8, COMMAND, 0),
        (0x6061, "Modes of operation display", DataType::INTEGER8, STATUS, 0),
        (0x6064, "Position actual value", DataType::INTEGER32, STATUS, 0),
        (0x607A, "Target position", DataType::INTEGER32, COMMAND, 0),
        // Bit 7: cyclic synchronous position.
        (0x6502, "Supported drive modes", DataType::UNSIGNED32, Access::READ, 1 << 7),
    ]
};

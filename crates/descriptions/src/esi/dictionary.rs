//! The object dictionary, assembled from data types with their structure and objects with their
//! defaults.
//!
//! Sub-indices and bit offsets are in the data type, values in the object. They are matched by name
//! if every name agrees, or else by order. An object that cannot be assembled is left out with a
//! warning; the others stay.

use std::borrow::Cow;
use std::collections::HashMap;

use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};

use super::numbers::{hex_bytes, number};
use super::read::{self, U16, U32, cut};
use super::slots::{self, Follows};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// An object.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiObject {
    /// Byte offset in the text.
    pub at: usize,
    /// Index.
    pub index: u16,
    /// Increments of its index, for an object of a module.
    pub follows: Follows,
    /// Name.
    pub name: String,
    /// VAR, ARRAY or RECORD.
    pub code: ObjectCode,
    /// Type of the object; for a RECORD that of its first entry.
    pub data_type: DataType,
    /// Entries, ascending.
    pub entries: Vec<EsiEntry>,
}

/// An entry of an object.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiEntry {
    /// Sub-index.
    pub sub: u8,
    /// Name.
    pub name: String,
    /// Type.
    pub data_type: DataType,
    /// Bits.
    pub bits: u16,
    /// Bit offset in complete access.
    pub offset: u32,
    /// Rights.
    pub access: Access,
    /// Value after power-on: as many bytes as `bits` need, or empty for zeros.
    pub default: Vec<u8>,
}

/// The content of `Profile`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiProfile {
    /// Number of the device profile: 402 for drives, 5001 for modular devices. If the device has
    /// none, that of its first channel.
    pub number: Option<u16>,
    /// Numbers of the profiles of its channels (`ChannelInfo`), in the order of the file.
    pub channels: Vec<u16>,
    /// Whether the file has a dictionary.
    pub has_dictionary: bool,
    /// Objects, ascending by index.
    pub objects: Vec<EsiObject>,
}

impl EsiProfile {
    /// Whether it or one of its channels is a drive (CiA 402).
    pub fn is_drive(&self) -> bool {
        self.number == Some(DRIVE) || self.channels.contains(&DRIVE)
    }
}

/// Reads the profiles of a device. The first dictionary is used.
pub(super) fn read(
    device: Element<'_>,
    left: &mut usize,
    warnings: &mut Warnings,
) -> Result<EsiProfile, Problem> {
    let mut found = EsiProfile::default();
    // The high half has details of some profiles (402 with the type of drive).
    let mut number = |of| Ok(read::child(of, "ProfileNo", U32, warnings)?.map(|no| no as u16));
    for profile in device.children("Profile") {
        found.number = found.number.or(number(profile)?);
        for channel in profile.children("ChannelInfo") {
            found.channels.extend(number(channel)?);
        }
    }
    found.number = found.number.or(found.channels.first().copied());
    for profile in device.children("Profile") {
        if let Some(file) = profile.child("DictionaryFile") {
            warnings.add(WarningKind::DictionaryFile, file.at(), || {
                format!("the dictionary is in \"{}\"; it is not read", cut(&file.text()))
            });
        }
        if let Some(dictionary) = profile.child("Dictionary").filter(|_| !found.has_dictionary) {
            found.has_dictionary = true;
            found.objects = objects(dictionary, left, warnings);
        }
    }
    Ok(found)
}

/// `DataType`.
struct TypeDefinition<'a> {
    base: Cow<'a, str>,
    bits: u32,
    array: Option<Array>,
    items: Vec<Item<'a>>,
}

#[derive(Clone, Copy)]
struct Array {
    first: u32,
    count: u32,
}

/// `DataType/SubItem`.
struct Item<'a> {
    /// `None` for the elements of an array.
    sub: Option<u8>,
    name: Cow<'a, str>,
    kind: Cow<'a, str>,
    bits: u32,
    offset: u32,
    access: Option<Access>,
}

type Types<'a> = HashMap<Cow<'a, str>, TypeDefinition<'a>>;

fn objects(dictionary: Element<'_>, left: &mut usize, warnings: &mut Warnings) -> Vec<EsiObject> {
    let mut types = Types::new();
    for element in dictionary.child("DataTypes").iter().flat_map(|list| list.children("DataType")) {
        match definition(element) {
            Ok((name, kind)) => {
                types.entry(name).or_insert(kind);
            }
            Err(problem) => left_out(problem, "a data type", warnings),
        }
    }
    let list = dictionary.child("Objects");
    let mut all: Vec<EsiObject> = Vec::new();
    for element in list.iter().flat_map(|list| list.children("Object")) {
        match object(element, &types, warnings) {
            Ok(object) if object.entries.len() > *left => {
                let message = "the dictionaries of the file have too many entries";
                left_out(Problem::new(object.at, message), &named(element), warnings);
            }
            Ok(object) => {
                *left -= object.entries.len();
                all.push(object);
            }
            Err(problem) => left_out(problem, &named(element), warnings),
        }
    }
    all.sort_by_cached_key(|object| u64::from(object.index));
    all.dedup_by(|later, earlier| {
        let same = later.index == earlier.index;
        if same {
            let message = "it stands twice; the first counts";
            let what = format!("object 0x{:04X}", later.index);
            left_out(Problem::new(later.at, message), &what, warnings);
        }
        same
    });
    all
}

/// The name of an object for messages.
fn named(element: Element<'_>) -> String {
    match element.child_text("Index").as_ref() {
        "" => "an object without Index".to_owned(),
        index => format!("object {}", cut(index)),
    }
}

fn left_out(problem: Problem, what: &str, warnings: &mut Warnings) {
    warnings.add(WarningKind::ObjectLeftOut, problem.at, || format!("{what}: {}", problem.message));
}

fn definition<'a>(element: Element<'a>) -> Result<(Cow<'a, str>, TypeDefinition<'a>), Problem> {
    let (mut name, mut base) = (Cow::Borrowed(""), Cow::Borrowed(""));
    let (mut bits, mut array) = (0, None);
    let mut items = Vec::new();
    for child in element.elements() {
        match child.name() {
            "Name" if name.is_empty() => name = child.text(),
            "BaseType" => base = child.text(),
            "BitSize" => bits = small(child, MOST_BITS)?,
            "ArrayInfo" => {
                let of = |name| child.child(name).map_or(Ok(0), |child| small(child, 0xFFFF));
                array = Some(Array { first: of("LBound")?, count: of("Elements")? });
            }
            "SubItem" => items.push(item(child)?),
            _ => {}
        }
    }
    Ok((name, TypeDefinition { base, bits, array, items }))
}

fn item<'a>(element: Element<'a>) -> Result<Item<'a>, Problem> {
    let mut item = Item {
        sub: None,
        name: Cow::default(),
        kind: Cow::default(),
        bits: 0,
        offset: 0,
        access: None,
    };
    for child in element.elements() {
        match child.name() {
            "SubIdx" => item.sub = Some(small(child, 0xFF)? as u8),
            "Name" => item.name = child.text(),
            "Type" => item.kind = child.text(),
            "BitSize" => item.bits = small(child, MOST_BITS)?,
            "BitOffs" => item.offset = small(child, MOST_BITS)?,
            "Flags" => item.access = Some(access(child)?),
            _ => {}
        }
    }
    Ok(item)
}

fn object(
    element: Element<'_>,
    types: &Types<'_>,
    warnings: &mut Warnings,
) -> Result<EsiObject, Problem> {
    let (mut index, mut name, mut kind, mut bits) = (None, None, Cow::Borrowed(""), 0);
    let (mut info, mut flags) = (None, None);
    for child in element.elements() {
        match child.name() {
            "Index" => {
                let text = child.text();
                index = Some(read::integer(&text, child.at(), "Index", U16, warnings)? as u16);
            }
            "Name" if name.is_none() => name = Some(child.text()),
            "Type" => kind = child.text(),
            "BitSize" => bits = small(child, MOST_BITS)?,
            "Info" => info = Some(child),
            "Flags" => flags = Some(access(child)?),
            _ => {}
        }
    }
    let at = element.at();
    let index = index.ok_or_else(|| Problem::new(at, "Object lacks Index"))?;
    let access = flags.unwrap_or(Access::READ);
    let definition = resolve(&kind, types, at)?;
    let structure = definition.filter(|definition| !definition.items.is_empty());
    let (code, mut entries) = match structure {
        Some(structure) => entries(structure, types, access, at, warnings)?,
        None => {
            let data_type = primitive(&kind, types, bits, at, warnings)?;
            let name = name.as_deref().unwrap_or_default().to_owned();
            let bits = to_u16(bits, at)?;
            let entry =
                EsiEntry { sub: 0, name, data_type, bits, offset: 0, access, default: Vec::new() };
            (ObjectCode::VAR, vec![entry])
        }
    };
    if let Some(info) = info {
        match structure {
            None => entries[0].default = default(info, index, &entries[0], warnings),
            Some(_) => defaults(info, index, &mut entries, warnings),
        }
    }
    for pair in entries.windows(2) {
        if pair[1].sub <= pair[0].sub {
            let message = format!(
                "0x{index:04X}:{:02X} follows :{:02X}; expected ascending",
                pair[1].sub, pair[0].sub
            );
            return Err(Problem::new(at, message));
        }
    }
    let data_type = match (code, entries.get(1)) {
        (ObjectCode::VAR, _) => entries[0].data_type,
        (ObjectCode::ARRAY, Some(element)) => element.data_type,
        _ => DataType::PDO_MAPPING,
    };
    Ok(EsiObject {
        at,
        index,
        follows: slots::follows(element)?,
        name: name.unwrap_or_default().into_owned(),
        code,
        data_type,
        entries,
    })
}

/// The entries of a structure, with its arrays expanded.
fn entries(
    structure: &TypeDefinition<'_>,
    types: &Types<'_>,
    object_access: Access,
    at: usize,
    warnings: &mut Warnings,
) -> Result<(ObjectCode, Vec<EsiEntry>), Problem> {
    let mut all = Vec::with_capacity(structure.items.len());
    let mut code = ObjectCode::RECORD;
    if structure.items.len() > 256 {
        let message = format!("{} items; expected at most 256", structure.items.len());
        return Err(Problem::new(at, message));
    }
    for item in &structure.items {
        let access = item.access.unwrap_or(object_access);
        let array = types.get(&item.kind).filter(|_| item.sub.is_none());
        let Some((kind, array)) = array.and_then(|kind| Some((kind, kind.array?))) else {
            let sub = item.sub.ok_or_else(|| {
                let message = format!("item \"{}\" has no SubIdx and is no array", cut(&item.name));
                Problem::new(at, message)
            })?;
            all.push(EsiEntry {
                sub,
                name: item.name.clone().into_owned(),
                data_type: primitive(&item.kind, types, item.bits, at, warnings)?,
                bits: to_u16(item.bits, at)?,
                offset: item.offset,
                access,
                default: Vec::new(),
            });
            continue;
        };
        code = ObjectCode::ARRAY;
        // An array from 0 includes sub-index 0, which is a separate entry before it.
        let first = array.first.max(1);
        let last = first + array.count;
        if array.count == 0 || last > 256 || item.bits % array.count != 0 {
            let message = format!(
                "an array of {} elements from {first} in {} bits; expected at most 255 whole ones",
                array.count, item.bits
            );
            return Err(Problem::new(at, message));
        }
        let bits = item.bits / array.count;
        let data_type = primitive(&kind.base, types, bits, at, warnings)?;
        for sub in first..last {
            all.push(EsiEntry {
                sub: sub as u8,
                name: format!("SubIndex {sub:03}"),
                data_type,
                bits: to_u16(bits, at)?,
                offset: item.offset + (sub - first) * bits,
                access,
                default: Vec::new(),
            });
        }
    }
    Ok((code, all))
}

/// The values of a structure's entries.
fn defaults(info: Element<'_>, index: u16, entries: &mut [EsiEntry], warnings: &mut Warnings) {
    let by_order = || info.children("SubItem").enumerate();
    let same_names = by_order().all(|(place, item)| {
        entries.get(place).is_some_and(|entry| entry.name == item.child_text("Name"))
    });
    for (place, item) in by_order() {
        let name = item.child_text("Name");
        let found = match same_names {
            true => Some(place),
            false => {
                let mut named = entries.iter().enumerate().filter(|(_, entry)| entry.name == name);
                match (named.next(), named.next()) {
                    (Some((only, _)), None) => Some(only),
                    _ => {
                        warnings.add(WarningKind::ObjectItemsByOrder, item.at(), || {
                            format!("\"{}\" is no single name of the data type", cut(&name))
                        });
                        (place < entries.len()).then_some(place)
                    }
                }
            }
        };
        let (Some(found), Some(info)) = (found, item.child("Info")) else { continue };
        entries[found].default = default(info, index, &entries[found], warnings);
        if !same_names && !name.is_empty() {
            entries[found].name = name.into_owned();
        }
    }
}

/// The value of an entry in `Info`; empty if there is none or it cannot be read.
fn default(info: Element<'_>, index: u16, entry: &EsiEntry, warnings: &mut Warnings) -> Vec<u8> {
    let length = usize::from(entry.bits.div_ceil(8));
    for child in info.elements() {
        let text = child.text();
        let (value, expected) = match child.name() {
            "DefaultData" => (hex_bytes(&text), "two hex digits for each byte"),
            "DefaultString" => (Some(text.as_bytes().to_vec()), ""),
            "DefaultValue" => match number(&text) {
                Some(number) => (Some(number.value.to_le_bytes()[..length.min(8)].to_vec()), ""),
                None if text.is_empty() => continue,
                None => (real(&text, length), "a number"),
            },
            _ => continue,
        };
        let Some(mut value) = value else {
            warnings.add(WarningKind::DefaultLeftOut, child.at(), || {
                format!(
                    "0x{index:04X}:{:02X} has {} \"{}\"; expected {expected}; its value is unknown",
                    entry.sub,
                    child.name(),
                    cut(&text)
                )
            });
            return Vec::new();
        };
        let is_text = matches!(
            entry.data_type,
            DataType::VISIBLE_STRING | DataType::OCTET_STRING | DataType::UNICODE_STRING
        );
        if value.len() > length || value.len() < length && !is_text && !value.is_empty() {
            warnings.add(WarningKind::DefaultLength, child.at(), || {
                format!("{} bytes for an entry of {length}", value.len())
            });
        }
        value.resize(length, 0);
        return value;
    }
    Vec::new()
}

fn real(text: &str, length: usize) -> Option<Vec<u8>> {
    let value: f64 = text.parse().ok()?;
    match length {
        4 => Some((value as f32).to_le_bytes().to_vec()),
        8 => Some(value.to_le_bytes().to_vec()),
        _ => None,
    }
}

/// The definition of a name, through types that only rename another.
fn resolve<'t, 'a>(
    name: &str,
    types: &'t Types<'a>,
    at: usize,
) -> Result<Option<&'t TypeDefinition<'a>>, Problem> {
    let mut definition = types.get(name);
    for _ in 0..DEEPEST_TYPE {
        let Some(found) = definition else { return Ok(None) };
        let further = types.get(&found.base);
        let renames = found.items.is_empty() && found.array.is_none();
        match further {
            Some(_) if renames && found.base != name => definition = further,
            _ => return Ok(Some(found)),
        }
    }
    Err(Problem::new(at, format!("the type \"{}\" goes through too many others", cut(name))))
}

/// The type of a single value: by its name, or else by its bits.
fn primitive(
    name: &str,
    types: &Types<'_>,
    bits: u32,
    at: usize,
    warnings: &mut Warnings,
) -> Result<DataType, Problem> {
    let mut step = name;
    for _ in 0..=DEEPEST_TYPE {
        if let Some(kind) = by_name(step, bits) {
            return Ok(kind);
        }
        let Some(further) = types.get(step) else { break };
        step = &further.base;
    }
    let definition = resolve(name, types, at)?;
    let known = definition.is_some_and(|definition| definition.array.is_some());
    if !known {
        warnings.add(WarningKind::DataTypeUnknown, at, || {
            format!("\"{}\" is not defined; its {bits} bits count", cut(name))
        });
    }
    let declared = definition.map_or(0, |definition| definition.bits);
    Ok(by_bits(if bits > 0 { bits } else { declared }))
}

/// The code of a base type, if it fits the bits.
pub(super) fn by_name(name: &str, bits: u32) -> Option<DataType> {
    let kind = match name {
        "BOOL" | "BOOLEAN" | "BIT" => DataType::BOOLEAN,
        "SINT" => DataType::INTEGER8,
        "INT" => DataType::INTEGER16,
        "DINT" => DataType::INTEGER32,
        "LINT" => DataType::INTEGER64,
        "USINT" | "BYTE" | "UINT8" => DataType::UNSIGNED8,
        "UINT" | "WORD" | "UINT16" => DataType::UNSIGNED16,
        "INT24" => DataType::INTEGER24,
        "UINT24" => DataType::UNSIGNED24,
        "UDINT" | "DWORD" | "UINT32" => DataType::UNSIGNED32,
        "ULINT" | "LWORD" | "UINT64" => DataType::UNSIGNED64,
        "REAL" => DataType::REAL32,
        "LREAL" => DataType::REAL64,
        "BIT1" => DataType::BIT1,
        "BIT2" => DataType::BIT2,
        "BIT3" => DataType::BIT3,
        "BIT4" => DataType::BIT4,
        "BIT5" => DataType::BIT5,
        "BIT6" => DataType::BIT6,
        "BIT7" => DataType::BIT7,
        "BIT8" => DataType::BIT8,
        "BITARR8" => return (bits == 8).then_some(DataType::BIT8),
        "BITARR16" => DataType::UNSIGNED16,
        "BITARR32" => DataType::UNSIGNED32,
        text if text.starts_with("STRING") => return Some(DataType::VISIBLE_STRING),
        text if text.starts_with("ARRAY") => return Some(DataType::OCTET_STRING),
        _ => return None,
    };
    (bits == 0 || kind.bits().is_none_or(|own| u32::from(own) == bits)).then_some(kind)
}

/// A type with this number of bits.
pub(super) fn by_bits(bits: u32) -> DataType {
    match bits {
        1..=8 => DataType(DataType::BIT1.0 + bits as u16 - 1),
        16 => DataType::UNSIGNED16,
        24 => DataType::UNSIGNED24,
        32 => DataType::UNSIGNED32,
        64 => DataType::UNSIGNED64,
        _ => DataType::OCTET_STRING,
    }
}

/// `Flags`: access rights, and directions of mapping.
fn access(flags: Element<'_>) -> Result<Access, Problem> {
    let mut access = Access(0);
    for child in flags.elements() {
        let text = child.text();
        match child.name() {
            "Access" => {
                let restricted = |name| child.attribute(name).map_or("", str::trim);
                let reads = states(restricted("ReadRestrictions"), child.at())?;
                let writes = states(restricted("WriteRestrictions"), child.at())?;
                let lower = text.to_ascii_lowercase();
                if !matches!(&*lower, "ro" | "rw" | "wo" | "") {
                    let message = format!("Access \"{}\": expected ro, rw or wo", cut(&text));
                    return Err(Problem::new(child.at(), message));
                }
                if lower != "wo" {
                    access = access.with(Access(reads));
                }
                if lower.contains('w') {
                    access = access.with(Access(writes << 3));
                }
            }
            "PdoMapping" => {
                if text.contains(['R', 'r']) {
                    access = access.with(Access::RX_MAPPABLE);
                }
                if text.contains(['T', 't']) {
                    access = access.with(Access::TX_MAPPABLE);
                }
            }
            "Backup" if &*text == "1" => access = access.with(Access::BACKUP),
            "Setting" if &*text == "1" => access = access.with(Access::SETTINGS),
            _ => {}
        }
    }
    Ok(access)
}

/// Bits of the states in which an access is possible: PREOP, SAFEOP, OP.
fn states(restriction: &str, at: usize) -> Result<u16, Problem> {
    let mut bits = 0;
    for word in restriction.split('_').filter(|word| !word.is_empty()) {
        bits |= match word.to_ascii_lowercase().as_str() {
            "preop" => 1,
            "safeop" => 2,
            "op" => 4,
            _ => {
                let message = format!(
                    "restriction \"{}\": expected PreOP, SafeOP, OP or some of them joined by _",
                    cut(restriction)
                );
                return Err(Problem::new(at, message));
            }
        };
    }
    Ok(if bits == 0 { 7 } else { bits })
}

/// A number that has no unusual forms in these places; doubled prefixes are refused.
fn small(element: Element<'_>, most: u32) -> Result<u32, Problem> {
    let text = element.text();
    let found = number(&text).filter(|number| !number.doubled_prefix).map(|number| number.value);
    found.and_then(|value| u32::try_from(value).ok()).filter(|value| *value <= most).ok_or_else(
        || {
            let message = format!("{} = \"{}\": expected 0 to {most}", element.name(), cut(&text));
            Problem::new(element.at(), message)
        },
    )
}

fn to_u16(bits: u32, at: usize) -> Result<u16, Problem> {
    let message = || format!("a value of {bits} bits; expected at most {}", u16::MAX);
    u16::try_from(bits).map_err(|_| Problem::new(at, message()))
}

const MOST_BITS: u32 = 1 << 24;
const DEEPEST_TYPE: usize = 8;
/// Device profile of drives.
const DRIVE: u16 = 402;

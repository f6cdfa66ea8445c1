//! The rows of an object: `[sub-index, type, access, value, name]`.

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Source, Table, Value, name_hint};
use isocat_subdevice::MAX_TRANSFER;
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::time::Nanos;

use super::draft::{Entry, Object};
use super::keys;

/// Reads every `[[object]]`.
pub(super) fn objects(tables: Vec<Keys<'_>>) -> Result<Vec<Object>, FileError> {
    let mut all = Vec::new();
    for keys in tables {
        all.push(object(&keys, &all)?);
    }
    Ok(all)
}

/// Reads `[[object]]`; `before` are the earlier ones.
fn object(keys: &Keys<'_>, before: &[Object]) -> Result<Object, FileError> {
    let index = keys.get("index")?;
    let like = keys.value("like").map(|value| inherited(&value, before)).transpose()?;
    let mut entries = entries(keys, index, like.as_ref())?;
    if let Some(values) = keys.value("values") {
        set_values(values.table()?, &mut entries)?;
    }
    let code = match (keys.find_choice("code", &keys::CODES)?, &like) {
        (Some(code), _) => code,
        (None, Some(like)) => like.code,
        (None, None) if entries.len() == 1 => ObjectCode::VAR,
        (None, None) => ObjectCode::RECORD,
    };
    let data_type = match (keys.value("type"), code) {
        (Some(value), _) => parse_type(&value)?,
        (None, ObjectCode::RECORD) if matches!(index, 0x1C32 | 0x1C33) => DataType::SYNC_PAR,
        (None, ObjectCode::RECORD) => RECORD,
        (None, _) => entries.last().map_or(DataType::GAP, |entry| entry.data_type),
    };
    let contradiction = keys.find("contradiction")?;
    let name = match (keys.value("name"), like) {
        (None, Some(like)) => like.name,
        _ => keys.get("name")?,
    };
    Ok(Object { at: keys.at(), index, name, code, data_type, entries, contradiction })
}

/// `entries`, based on the object of `like`.
fn entries(keys: &Keys<'_>, index: u16, like: Option<&Object>) -> Result<Vec<Entry>, FileError> {
    let mut inherited = like.map_or(Vec::new(), |like| like.entries.clone());
    for (sub, number) in keys.items::<u8>("without", "sub-indices")? {
        let Some(at) = inherited.iter().position(|entry| entry.sub == number) else {
            return Err(sub.unexpected("a sub-index of the object that this one is like"));
        };
        inherited.remove(at);
    }
    let rows = match keys.value("entries") {
        None if like.is_some() => Vec::new(),
        _ => keys.required("entries")?.array("rows")?,
    };
    let mut own: Vec<Entry> = Vec::new();
    for row in rows {
        entry(&row, index, &mut own)?;
    }
    if like.is_none() {
        return Ok(own);
    }
    inherited.retain(|entry| own.iter().all(|own| own.sub != entry.sub));
    inherited.extend(own);
    inherited.sort_by_cached_key(|entry| u64::from(entry.sub));
    Ok(inherited)
}

/// The object that `like` names: `1C32` of this file, which must be an earlier one, or `name:1C32`
/// of the built-in profile of this name. Errors in its rows are reported at `like`.
fn inherited(value: &Value<'_>, before: &[Object]) -> Result<Object, FileError> {
    let expected = "an object of this file that stands before (\"1C32\") or of a built-in profile \
                    (\"kollmorgen_akd2g:1C32\")";
    let text = value.string(expected)?;
    let unknown = || value.error(format!("like = \"{text}\" is not there; expected {expected}"));
    let (profile, index) = match text.rsplit_once(':') {
        Some((profile, index)) => (Some(profile), index),
        None => (None, text),
    };
    let index = parse_hex(index, 4).ok_or_else(unknown)? as u16;
    let there;
    let objects = match profile {
        None => before,
        Some(name) => {
            let text = super::built_in_text(name)
                .ok_or_else(|| unknown().with_hint(name_hint(name, super::built_in_ids())))?;
            let source = Source { path: name, text };
            let document = source.parse()?;
            let root = Keys::open(Table::root(source, &document), &keys::FILE)?;
            there = self::objects(root.tables("object")?)?;
            &there
        }
    };
    let mut found = objects.iter().find(|o| o.index == index).ok_or_else(unknown)?.clone();
    for entry in &mut found.entries {
        entry.at = value.at();
    }
    Ok(found)
}

/// Reads `values = { 01 = 0x22, 05 = "1ms" }`: sub-indices in hex as in 1C32:0A.
fn set_values(table: Table<'_>, entries: &mut [Entry]) -> Result<(), FileError> {
    for (key, value) in table.values() {
        let sub = parse_hex(key, 2).map(|sub| sub as u8);
        let Some(entry) = entries.iter_mut().find(|entry| Some(entry.sub) == sub) else {
            return Err(value.error(format!(
                "values has the key \"{key}\"; expected a sub-index of the object in two hex digits"
            )));
        };
        entry.default = parse_value(&value, entry.data_type)?;
        entry.bits = bits(&value, entry.data_type, &entry.default, None)?;
        entry.written = value.as_string().unwrap_or(value.written()).to_owned();
        entry.at = value.at();
    }
    Ok(())
}

/// Reads one row; a row of gaps gives several entries.
fn entry(row: &Value<'_>, index: u16, entries: &mut Vec<Entry>) -> Result<(), FileError> {
    if row.is_table() {
        return gaps(row, index, entries);
    }
    let cells = keys::ROW.open(row)?;
    let more = cells.more()?;
    let offset = more.map(|more| more.find("offset")).transpose()?.flatten();
    let given = more.map(|more| more.find("bits")).transpose()?.flatten();
    let sub = cells.get("sub-index")?;
    let kind = parse_type(&cells.value("type"))?;
    let value = cells.value("value");
    let default = parse_value(&value, kind)?;
    entries.push(Entry {
        at: row.at(),
        sub,
        name: cells.get("name")?,
        data_type: kind,
        bits: bits(&value, kind, &default, given)?,
        offset: offset.unwrap_or_else(|| next_offset(index, sub, entries)),
        access: parse_access(&cells.value("access"))?,
        default,
        written: value.as_string().unwrap_or(value.written()).to_owned(),
    });
    Ok(())
}

/// `{ gaps = [14, 31], bits = 8 }`.
fn gaps(row: &Value<'_>, index: u16, entries: &mut Vec<Entry>) -> Result<(), FileError> {
    let keys = Keys::open(row.table()?, &keys::GAPS)?;
    let gaps = keys.required("gaps")?;
    let subs = keys::FIRST_AND_LAST.open(&gaps)?;
    let first: u8 = subs.get("first")?;
    let last = subs.value("last").integer(i64::from(first)..=255)? as u8;
    let (bits, name) = (keys.get("bits")?, keys.get::<String>("name")?);
    for sub in first..=last {
        entries.push(Entry {
            at: row.at(),
            sub,
            name: format!("{name} {sub}"),
            data_type: DataType::GAP,
            bits,
            offset: next_offset(index, sub, entries),
            access: Access::READ,
            default: Vec::new(),
            written: String::new(),
        });
    }
    Ok(())
}

/// Default offset of an entry in complete access: in 0x1C32 and 0x1C33 that of ETG.1020, in other
/// objects after the previous entry; sub-index 1 at bit 16.
pub(super) fn next_offset(index: u16, sub: u8, before: &[Entry]) -> u32 {
    const SYNC: [u32; 19] =
        [0, 16, 32, 64, 96, 112, 144, 176, 208, 224, 256, 288, 304, 320, 336, 352, 384, 416, 448];
    let behind = match before.last() {
        None => 0,
        Some(last) if last.sub == 0 => 16,
        Some(last) => last.offset + u32::from(last.bits),
    };
    match (index, sub) {
        // Gaps follow each other directly: the device defines their lengths.
        (0x1C32 | 0x1C33, 14..) if before.last().is_some_and(|e| e.data_type == DataType::GAP) => {
            behind
        }
        (0x1C32 | 0x1C33, 0..=18) => SYNC[usize::from(sub)],
        (0x1C32 | 0x1C33, 32) => 480,
        _ => behind,
    }
}

/// Reads a type's name.
pub(super) fn parse_type(value: &Value<'_>) -> Result<DataType, FileError> {
    let text = value.string("a type such as \"UNSIGNED32\"")?;
    let known = keys::TYPES.iter().find(|(name, ..)| *name == text);
    known.map(|(.., kind)| *kind).ok_or_else(|| {
        let usual = keys::TYPES.iter().take(USUAL_TYPES).map(|(name, ..)| *name);
        value.error(format!("unknown type \"{text}\"")).with_hint(name_hint(text, usual))
    })
}

/// Length of an entry: as given, or else that of its type or of its value.
fn bits(
    value: &Value<'_>,
    kind: DataType,
    default: &[u8],
    given: Option<u16>,
) -> Result<u16, FileError> {
    let of_value = 8 * default.len();
    let found = given.or(kind.bits()).or_else(|| u16::try_from(of_value).ok());
    match found {
        Some(0) if kind != DataType::VISIBLE_STRING => Err(value.error(
            "neither the type nor the value has a length; expected { bits = … } behind the row",
        )),
        Some(bits) if default.len() <= usize::from(bits.div_ceil(8)) => Ok(bits),
        _ => {
            let most = found.map_or(8 * MAX_TRANSFER, usize::from);
            let message = format!("the value has {of_value} bits; expected at most {most}");
            Err(value.error(message))
        }
    }
}

/// Bytes of a default value; empty for an unknown one.
fn parse_value(value: &Value<'_>, kind: DataType) -> Result<Vec<u8>, FileError> {
    let text = value.as_string();
    if let Some(digits) = text.and_then(|text| text.strip_prefix(HEX)) {
        return bytes_of(digits).ok_or_else(|| {
            value.error(format!(
                "\"{HEX}{digits}\": expected pairs of hex digits, as in \"{HEX}0A FF\""
            ))
        });
    }
    if text == Some(UNKNOWN) && kind != DataType::VISIBLE_STRING {
        return Ok(Vec::new());
    }
    let bytes =
        |number: i64, bits: u16| number.to_le_bytes()[..usize::from(bits.div_ceil(8))].to_vec();
    let unsupported = || {
        value.error(format!(
            "a value of this type has no other form; expected \"{UNKNOWN}\", or bytes of the wire such as \
             \"{HEX}0A FF\""
        ))
    };
    match kind {
        DataType::VISIBLE_STRING => Ok(value.string("a text")?.as_bytes().to_vec()),
        kind if is_signed(kind) => {
            let bits = kind.bits().unwrap_or(64);
            let most = i64::MAX >> (64 - bits);
            Ok(bytes(value.integer(-most - 1..=most)?, bits))
        }
        // Times may be written with a unit.
        DataType::UNSIGNED32 if text.is_some() => {
            let time = value.duration(Nanos::ZERO..=Nanos::from_u32(u32::MAX))?;
            Ok(bytes(time.0, 32))
        }
        DataType::REAL32 | DataType::REAL64 => Err(unsupported()),
        _ => match kind.bits() {
            Some(bits @ 1..64) => Ok(bytes(value.integer(0..=(1 << bits) - 1)?, bits)),
            Some(64) if kind == DataType::UNSIGNED64 => Ok(bytes(value.integer(0..=i64::MAX)?, 64)),
            _ => Err(unsupported()),
        },
    }
}

pub(super) const fn is_signed(kind: DataType) -> bool {
    matches!(
        kind,
        DataType::INTEGER8
            | DataType::INTEGER16
            | DataType::INTEGER24
            | DataType::INTEGER32
            | DataType::INTEGER64
    )
}

/// Pairs of hex digits with or without blanks; `None` for other texts.
pub(super) fn bytes_of(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    let (pairs, rest) = digits.as_chunks::<2>();
    let byte = |pair: &[u8; 2]| {
        let digit = |byte: u8| char::from(byte).to_digit(16);
        Some((digit(pair[0])? << 4 | digit(pair[1])?) as u8)
    };
    rest.is_empty().then(|| pairs.iter().map(byte).collect())?
}

/// Reads `ro`, `rw`, `wo`, `rw preop safeop`, `ro tx` and so on. An entry that cannot be written
/// may still be mapped to outputs, as in the tables of some makers.
pub(super) fn parse_access(value: &Value<'_>) -> Result<Access, FileError> {
    let text = value.string(keys::ACCESS_WORDS)?;
    let refuse = |why: String| {
        value.error(format!("access \"{text}\": {why}; expected {}", keys::ACCESS_WORDS))
    };
    let mut words = text.split_whitespace();
    let (mut access, writable) = match words.next() {
        Some("ro") => (Access::READ, false),
        Some("rw") => (Access::READ, true),
        Some("wo") => (Access::default(), true),
        Some(other) => return Err(refuse(format!("it begins with \"{other}\""))),
        None => return Err(refuse("it is empty".to_owned())),
    };
    for word in words {
        let right = match word {
            "preop" => Access::WRITE_PREOP,
            "safeop" => Access::WRITE_SAFEOP,
            "op" => Access::WRITE_OP,
            "rx" => Access::RX_MAPPABLE,
            "tx" => Access::TX_MAPPABLE,
            "backup" => Access::BACKUP,
            "settings" => Access::SETTINGS,
            other => return Err(refuse(format!("unknown word \"{other}\""))),
        };
        if access.has(right) {
            return Err(refuse(format!("\"{word}\" stands twice")));
        }
        access = access.with(right);
    }
    let states = access.has_any(Access::WRITE);
    match writable {
        false if states => return Err(refuse("read-only, yet it names states of writing".into())),
        true if !states => access = access.with(Access::WRITE),
        _ => {}
    }
    Ok(access)
}

/// Reads `6040:00`.
pub(super) fn parse_object(text: &str) -> Option<ObjectAddress> {
    let (index, sub) = text.split_once(':')?;
    Some(ObjectAddress::new(parse_hex(index, 4)? as u16, parse_hex(sub, 2)? as u8))
}

/// Reads exactly `digits` hex digits, with or without `0x`.
pub(super) fn parse_hex(text: &str, digits: usize) -> Option<u32> {
    let text = text.strip_prefix("0x").unwrap_or(text);
    let all_hex = text.bytes().all(|b| b.is_ascii_hexdigit());
    (text.len() == digits && all_hex).then(|| u32::from_str_radix(text, 16).ok())?
}

/// Prefix of the bytes of a value.
pub(super) const HEX: &str = "hex:";
/// A value that is not published.
pub(super) const UNKNOWN: &str = "unknown";
/// Type code of a RECORD defined by the device, as in the Slave Stack Code.
pub(super) const RECORD: DataType = DataType(0x002A);
/// Number of types that a hint lists: the first ones.
const USUAL_TYPES: usize = 12;

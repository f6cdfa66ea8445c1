//! Meaning of a code, object, register, word, mode, symptom or key of a file: looks up the user's
//! text in the tables of [`isocat_sync::explain`] and [`isocat_segment::keys`], and in the kinds of
//! findings, notes and doubts ([`kinds`]).
//!
//! A whole line of a log is looked up among those that MainDevices print, and by its numbers and
//! words (`lines`). A drive's own alarm number is never taken for an AL status code: such a code
//! has `0x` or `AL` before it, or is less than 0x8000.
//!
//! A key may occur in several places, and each has its [`Meaning`]. `key object` is the key where
//! `object` alone is a kind. A bare number may be several things, and each has its [`Meaning`], the
//! likeliest first. A kind before the number (`AL 0x0030`, `SI4 0x0427`, `register 0x0300`) selects
//! one.

mod key;
pub mod kinds;
mod lines;
mod number;
mod text;

use isocat_descriptions::document::{name_hint, nearest};
use isocat_segment::keys;
use isocat_sync::explain::{
    Entry, aborts, al_codes, assign_activate, modes, objects, registers, soe_codes, symptoms, terms,
};
use isocat_sync::object::{SupportedTypes, SyncType, sub};
use isocat_sync::{SyncMode, opmode};
use isocat_wire::dc::{AssignActivate, SystemTimeDifference};
use isocat_wire::soe::ErrorCode;
use isocat_wire::{AbortCode, AlStatus, AlStatusCode, Nanos, ObjectAddress};
use number::{Number, number};
use serde::Serialize;
pub use text::{json, text};

/// Version of the JSON document.
pub const FORMAT: &str = "isocat-explain/1";

/// One meaning of what was asked for.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Meaning {
    /// Kind of thing.
    pub kind: &'static str,
    /// The thing as the field writes it.
    pub what: String,
    /// Its name.
    pub name: String,
    /// What it means.
    pub means: &'static str,
    /// The decoded value, line by line; empty without a value.
    pub value: Vec<String>,
    /// The usual causes, likeliest first.
    pub causes: &'static [&'static str],
    /// Objects and registers to read next.
    pub read: &'static [&'static str],
    /// What to change.
    pub change: &'static [&'static str],
    /// How it was found in the text.
    pub found: Found,
}

/// How a meaning was found in the text that was asked for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Found {
    /// The text itself is a code, an object, a word and the like.
    Asked,
    /// The text holds a line that a program prints; or it is a number within such a line.
    Line,
    /// It is a number within a line that is not known.
    Number,
    /// It is a word of the field within a line that is not known.
    Word,
}

/// A text without a known meaning.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Unknown {
    /// The user's text.
    pub what: String,
    /// Why it is not understood.
    pub reason: String,
    /// Similar texts, and the forms that are understood.
    pub hint: String,
}

impl std::fmt::Display for Unknown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "\"{}\": {}\n{}", self.what, self.reason, self.hint)
    }
}

impl std::error::Error for Unknown {}

/// Explains a text: `0x001A`, `0x06090030`, `0x1C32:0B`, `0x1C32:04=0x0427`, `AL 0x0030`,
/// `dc-sync0`, `input_shift`, or a line of a log. Returns at least one meaning, the likeliest
/// first; of a line, the one that decides.
pub fn explain(what: &str) -> Result<Vec<Meaning>, Unknown> {
    asked(&of_kind(what)).or_else(|unknown| {
        let meanings = if reads_as_line(what.trim()) { lines::meanings(what) } else { Vec::new() };
        if meanings.is_empty() { Err(unknown) } else { Ok(meanings) }
    })
}

/// A number behind the words of its kind, as reports print it (`AL status code 0x001A`), with the
/// name of the kind; any other text as it is.
fn of_kind(what: &str) -> std::borrow::Cow<'_, str> {
    let what = what.trim();
    for (words, kind) in [("al status code", "AL"), ("sdo abort code", "abort")] {
        let rest = what.get(words.len()..).map(|rest| rest.trim_start_matches([' ', ':', '=']));
        let begins = what.get(..words.len()).is_some_and(|text| text.eq_ignore_ascii_case(words));
        if let Some(rest) = rest.filter(|rest| begins && number(rest).is_some()) {
            return format!("{kind} {rest}").into();
        }
    }
    what.into()
}

/// Whether a text that is not understood may be a line of a log: more than a number, an object or
/// a kind of number with a number.
fn reads_as_line(what: &str) -> bool {
    let of_a_number = |c: char| c.is_ascii_hexdigit() || "xX#:_-".contains(c);
    let is_number = |text: &str| text.chars().all(of_a_number);
    let of_a_kind = what
        .split_once([' ', '='])
        .filter(|(word, rest)| *word == "key" || kind(word).is_some() && is_number(rest.trim()));
    let place = what.split_once('=').map_or(what, |(place, _)| place.trim());
    // Some programs print an error of 32 bits of their own.
    let long = number(what).is_some_and(|number| number.long);
    of_a_kind.is_none() && (long || !is_number(place))
}

/// Explains a text that is itself a code, an object, a word and the like.
fn asked(what: &str) -> Result<Vec<Meaning>, Unknown> {
    let what = what.trim();
    let unknown =
        |reason: String, hint: String| Err(Unknown { what: what.to_owned(), reason, hint });
    if let Some(mode) = SyncMode::from_name(&what.to_lowercase()) {
        return Ok(vec![mode_meaning(mode)]);
    }
    if let Some(name) = what.strip_prefix("key ") {
        let meanings = key::meanings(name.trim());
        return match meanings.is_empty() {
            true => {
                unknown("is no key of a segment file or a profile".into(), key::hint(name.trim()))
            }
            false => Ok(meanings),
        };
    }
    if let Some((word, rest)) = what.split_once([' ', '=']).filter(|(word, _)| kind(word).is_some())
    {
        let kind = kind(word).expect("it was just looked up");
        return match kind.meaning(rest.trim()) {
            Ok(meaning) => Ok(vec![meaning]),
            Err(reason) => {
                let objects = || (kind.name == "object").then(object_list);
                unknown(reason, understood(kind.near(rest.trim()).or_else(objects)))
            }
        };
    }
    let of_kinds = kinds::meanings(what);
    if let Some(kind) = kind(what).filter(|_| of_kinds.is_empty()) {
        let reason = format!("a number must follow, such as \"{} {}\"", kind.name, kind.example);
        return unknown(reason, understood(None));
    }
    // A word such as "jitter" is both; the user more likely looks for a fault, so the symptom comes
    // first.
    let mut of_words: Vec<_> = symptoms::find(what).map(symptom_meaning).into_iter().collect();
    of_words.extend(terms::find(what).map(term_meaning));
    of_words.extend(key::meanings(what));
    of_words.extend(of_kinds);
    if !of_words.is_empty() {
        return Ok(of_words);
    }
    let of_maker = lines::makers::alone(what);
    if !of_maker.is_empty() {
        // The words of 0x1C32:04 are often written without 0x, too.
        let supported = number(what).and_then(|number| u16::try_from(number.value).ok());
        let supported = supported.filter(|word| objects::COMMON_SUPPORTED.contains(word));
        return Ok(supported.map(supported_meaning).into_iter().chain(of_maker).collect());
    }
    let (place, value) = match what.split_once('=') {
        Some((place, value)) => (place.trim(), Some(value.trim())),
        None => (what, None),
    };
    let value = match value.map(|text| (text, number(text))) {
        None => None,
        Some((_, Some(value))) => Some(value.value),
        Some((text, None)) => {
            return unknown(format!("\"{text}\" is no number"), understood(None));
        }
    };
    if place.contains(':') && !place.contains(' ') {
        let Some(address) = object_address(place) else {
            return unknown(
                "is no object; expected an index and a sub-index".into(),
                understood(None),
            );
        };
        return match object_meaning(address, value) {
            Some(meaning) => Ok(vec![meaning]),
            None => unknown(format!("nothing is known of object {address}"), known_objects()),
        };
    }
    let Some(number) = number(place) else {
        return unknown("is not understood".into(), format!("{}\n{FORMS}", near_word(place)));
    };
    let meanings = meanings(number, value);
    if !meanings.is_empty() {
        return Ok(meanings);
    }
    if let Some(meaning) = lines::makers::bare(what) {
        return Ok(vec![meaning]);
    }
    let reason = format!("{} is no number that is known", number.hex());
    match u16::try_from(number.value) {
        Ok(code) => match near_al_code(code) {
            // Objects start at this index.
            None if code >= 0x1000 => unknown(reason, known_objects()),
            near => unknown(reason, understood(near)),
        },
        Err(_) => unknown(reason, understood(near_abort(number.value))),
    }
}

/// All meanings of a bare number.
fn meanings(number: Number, value: Option<u32>) -> Vec<Meaning> {
    let Ok(short) = u16::try_from(number.value) else {
        return abort_meaning(number.value).into_iter().collect();
    };
    if number.long {
        return abort_meaning(number.value).into_iter().collect();
    }
    let mut all = Vec::new();
    all.extend(object_meaning(ObjectAddress::new(short, 0), None));
    let register = register_meaning(short, value);
    let word = assign_activate::KNOWN.contains(&short) && value.is_none();
    let word = word.then(|| word_meaning(short));
    let code = (value.is_none()).then(|| al_meaning(short)).flatten();
    // For small numbers the AL status code is the likeliest. Of those that are both register and
    // AssignActivate word, the word is more often met.
    all.extend(code);
    let word_first = !MORE_OFTEN_REGISTERS.contains(&short);
    let (first, second) = if word_first { (word, register) } else { (register, word) };
    all.extend(first);
    all.extend(second);
    if objects::COMMON_SUPPORTED.contains(&short) && value.is_none() {
        all.push(supported_meaning(short));
    }
    // Smaller numbers are AL status codes and registers, which are more often meant.
    if short >= FIRST_SOE && value.is_none() {
        all.extend(soe_meaning(short));
    }
    all
}

/// The first SoE error code that is explained without a kind before it.
const FIRST_SOE: u16 = 0x1001;

/// Words for AssignActivate that are more often registers.
const MORE_OFTEN_REGISTERS: [u16; 2] = [0x0120, 0x0130];

/// A kind of thing that may stand before a number.
struct Kind {
    name: &'static str,
    aliases: &'static [&'static str],
    /// An example number of this kind.
    example: &'static str,
    explain: fn(u32) -> Option<Meaning>,
    near: fn(u32) -> Option<String>,
}

static KINDS: [Kind; 7] = [
    Kind {
        name: "AL",
        aliases: &["al-status-code", "al-code"],
        example: "0x001A",
        explain: |code| al_meaning(u16::try_from(code).ok()?),
        near: |code| near_al_code(u16::try_from(code).ok()?),
    },
    Kind {
        name: "abort",
        aliases: &["sdo", "sdo-abort"],
        example: "0x06090030",
        explain: abort_meaning,
        near: near_abort,
    },
    Kind {
        name: "SoE",
        aliases: &["soe-error", "soe-code"],
        example: "0x1001",
        explain: |code| soe_meaning(u16::try_from(code).ok()?),
        near: |_| None,
    },
    Kind {
        name: "object",
        aliases: &["index"],
        example: "0x1C32",
        explain: |index| object_meaning(ObjectAddress::new(u16::try_from(index).ok()?, 0), None),
        near: |_| None,
    },
    Kind {
        name: "register",
        aliases: &["reg"],
        example: "0x0990",
        explain: |address| register_meaning(u16::try_from(address).ok()?, None),
        near: |_| None,
    },
    Kind {
        name: "AssignActivate",
        aliases: &["aa", "assign-activate"],
        example: "0x0300",
        explain: |word| Some(word_meaning(u16::try_from(word).ok()?)),
        near: |_| None,
    },
    Kind {
        name: "SI4",
        aliases: &["supported", "sync-types-supported"],
        example: "0x0427",
        explain: |word| Some(supported_meaning(u16::try_from(word).ok()?)),
        near: |_| None,
    },
];

fn kind(word: &str) -> Option<&'static Kind> {
    KINDS.iter().find(|kind| {
        kind.name.eq_ignore_ascii_case(word)
            || kind.aliases.iter().any(|alias| alias.eq_ignore_ascii_case(word))
    })
}

impl Kind {
    fn meaning(&self, text: &str) -> Result<Meaning, String> {
        if self.name == "object" && text.contains(':') {
            let address = object_address(text).ok_or("expected an index and a sub-index")?;
            return object_meaning(address, None)
                .ok_or_else(|| format!("nothing is known of object {address}"));
        }
        let number = number(text).ok_or_else(|| format!("\"{text}\" is no number"))?;
        (self.explain)(number.value)
            .ok_or_else(|| format!("{} is no {} that is known", number.hex(), self.name))
    }

    fn near(&self, text: &str) -> Option<String> {
        (self.near)(number(text)?.value)
    }
}

fn of(kind: &'static str, what: String, name: impl Into<String>, entry: &Entry) -> Meaning {
    let Entry { means, causes, read, change } = *entry;
    let name = name.into();
    let found = Found::Asked;
    Meaning { kind, what, name, means, value: Vec::new(), causes, read, change, found }
}

fn al_meaning(code: u16) -> Option<Meaning> {
    let entry = al_codes::explain(AlStatusCode(code))?;
    let name = AlStatusCode(code).meaning().unwrap_or("the maker's own");
    let mut meaning = of("AL status code", format!("0x{code:04X}"), name, entry);
    if code >= al_codes::FIRST_OF_VENDOR {
        meaning.value.push(format!(
            "0x{code:04X} is of the makers' range 0x8000 to 0xFFFF; no maker's code is known here"
        ));
    }
    Some(meaning)
}

fn abort_meaning(code: u32) -> Option<Meaning> {
    let entry = aborts::explain(AbortCode(code))?;
    let name = AbortCode(code).meaning().unwrap_or_default();
    Some(of("SDO abort code", format!("0x{code:08X}"), name, entry))
}

fn soe_meaning(code: u16) -> Option<Meaning> {
    let entry = soe_codes::explain(ErrorCode(code))?;
    let name = ErrorCode(code).meaning().unwrap_or_default();
    Some(of("SoE error code", format!("0x{code:04X}"), name, entry))
}

fn object_meaning(address: ObjectAddress, value: Option<u32>) -> Option<Meaning> {
    let (name, entry) = objects::sub_index(address)?;
    let what = match address.sub {
        0 => format!("0x{:04X}", address.index),
        _ => address.to_string(),
    };
    let mut meaning = of("object", what, name, entry);
    if let Some(value) = value {
        meaning.value = entry_value(address, value);
    }
    Some(meaning)
}

/// The value of an entry in words.
fn entry_value(address: ObjectAddress, value: u32) -> Vec<String> {
    let parameter = matches!(address.index, 0x1C32 | 0x1C33);
    let short = u16::try_from(value).ok();
    match (address.sub, short) {
        (sub::SUPPORTED_TYPES, Some(word)) if parameter => supported_lines(word),
        (sub::SYNC_TYPE, Some(kind)) if parameter => vec![SyncType(kind).to_string()],
        (
            sub::CYCLE_TIME..=sub::SHIFT_TIME
            | sub::MINIMUM_CYCLE_TIME..=sub::MINIMUM_DELAY_TIME
            | sub::DELAY_TIME..=sub::SYNC0_CYCLE_TIME
            | sub::MINIMUM_CYCLE_DISTANCE..=sub::MAXIMUM_SM_SYNC_DISTANCE,
            _,
        ) if parameter => vec![Nanos::from_u32(value).to_string()],
        _ => vec![format!("{value} (0x{value:X})")],
    }
}

fn register_meaning(address: u16, value: Option<u32>) -> Option<Meaning> {
    let register = registers::explain(address)?;
    let mut meaning = of("register", format!("0x{address:04X}"), register.name, &register.entry);
    let last = register.address + register.length - 1;
    if address != register.address {
        meaning.value.push(format!("part of 0x{:04X} to 0x{last:04X}", register.address));
    }
    if let Some(value) = value {
        meaning.value.push(match (address, u16::try_from(value)) {
            (0x0130, Ok(status)) => AlStatus(status).to_string(),
            (0x0134, Ok(code)) => AlStatusCode(code).to_string(),
            (0x092C, _) => {
                let difference = SystemTimeDifference(value);
                let size = Nanos::from_u32(difference.magnitude());
                let (older, newer) = match difference.is_negative() {
                    false => ("ahead of", "behind"),
                    true => ("behind", "ahead of"),
                };
                format!(
                    "the local clock is {size} {older} the time received ({newer} it on chips \
                         whose register text has bit 31 the other way round)"
                )
            }
            (0x0980, Ok(word)) => return Some(word_meaning(word)),
            (0x0928 | 0x09A0 | 0x09A4, _) => Nanos::from_u32(value).to_string(),
            _ => format!("{value} (0x{value:X})"),
        });
    }
    Some(meaning)
}

fn word_meaning(word: u16) -> Meaning {
    let word = AssignActivate(word);
    let name = "to 0x0980 (low byte) and 0x0981 (high byte)";
    let mut meaning = of("AssignActivate", word.to_string(), name, assign_activate::explain(word));
    meaning.value =
        assign_activate::bits(word).map(|(bit, effect)| format!("bit {bit:<2} {effect}")).collect();
    let mut modes = Vec::new();
    for registers in registers_of(word).into_iter().flatten() {
        for mode in registers.modes().iter().map(|mode| mode.name()) {
            if !modes.contains(&mode) {
                modes.push(mode);
            }
        }
    }
    if !modes.is_empty() {
        meaning.value.push(format!("modes: {}", modes.join(", ")));
    }
    meaning
}

/// The registers of two plain OpModes with this AssignActivate word: one with SYNC0 and SYNC1 once
/// a millisecond, and one with SYNC0 four times as often as SYNC1.
fn registers_of(word: AssignActivate) -> [Option<opmode::Registers>; 2] {
    [(1, 250_000), (-4, 0)].map(|(factor, shift1)| {
        let plain = opmode::OpMode {
            assign_activate: word,
            sync0: opmode::CycleTime { value: 0, factor: Some(factor) },
            sync1: opmode::CycleTime { value: 0, factor: Some(-1) },
            shift1,
            ..opmode::OpMode::default()
        };
        plain.registers(Nanos::millis(1), &opmode::Unit::default()).ok()
    })
}

fn supported_meaning(word: u16) -> Meaning {
    let address = ObjectAddress::new(0x1C32, sub::SUPPORTED_TYPES);
    let (name, entry) = objects::sub_index(address).expect("the table has every sub-index");
    let mut meaning = of("value of 0x1C32:04 and 0x1C33:04", format!("0x{word:04X}"), name, entry);
    meaning.value = supported_lines(word);
    meaning
}

fn supported_lines(word: u16) -> Vec<String> {
    let set = |bit: &usize| word >> bit & 1 == 1;
    let line = |bit: usize| format!("bit {bit:<2} {}", objects::SUPPORTED_BITS[bit]);
    let mut lines: Vec<_> = (0..16usize).filter(set).map(line).collect();
    let modes: Vec<_> = SyncMode::ALL
        .iter()
        .filter(|mode| mode.is_supported(SupportedTypes(word)))
        .map(|mode| mode.name())
        .collect();
    lines.push(match modes.is_empty() {
        true => "modes: none".into(),
        false => format!("modes: {}", modes.join(", ")),
    });
    lines
}

fn symptom_meaning(symptom: &symptoms::Symptom) -> Meaning {
    of("symptom", symptom.name.into(), "what is behind it", &symptom.entry)
}

fn term_meaning(term: &symptoms::Symptom) -> Meaning {
    of("term", term.name.into(), "a word of the field", &term.entry)
}

fn mode_meaning(mode: SyncMode) -> Meaning {
    of("mode", mode.name().into(), "synchronization mode", modes::explain(mode))
}

/// Parses `0x1C32:0B` or `1C32:0B`: both parts are hexadecimal.
fn object_address(text: &str) -> Option<ObjectAddress> {
    let (index, sub) = text.split_once(':')?;
    let hex = |text: &str| {
        let text = text.trim();
        let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")).unwrap_or(text);
        u16::from_str_radix(digits, 16).ok().filter(|_| !digits.starts_with(['+', '-']))
    };
    Some(ObjectAddress::new(hex(index)?, u8::try_from(hex(sub)?).ok()?))
}

/// Similar words: a mode, a kind, or a key of a file.
fn near_word(word: &str) -> String {
    let modes = SyncMode::ALL.iter().map(|mode| mode.name());
    let words: Vec<_> = modes.chain(KINDS.iter().map(|kind| kind.name)).chain(["modes"]).collect();
    let hint = name_hint(word, words.iter().copied());
    if nearest(word, &words).is_some() {
        return hint;
    }
    let symptoms: Vec<_> = symptoms::SYMPTOMS
        .iter()
        .chain(&terms::TERMS)
        .flat_map(|symptom| symptom.aliases.iter().copied().chain([symptom.name]))
        .collect();
    if let Some(near) = nearest(word, &symptoms) {
        return format!("did you mean \"{near}\"? {hint}, or a symptom or term");
    }
    let names: Vec<_> = keys::all().map(|place| place.key.name).collect();
    if let Some(near) = nearest(word, &names) {
        return format!("did you mean \"{near}\"? {hint}, or a key of a file");
    }
    let kinds = kinds::names();
    let kinds: Vec<_> = kinds.iter().map(String::as_str).collect();
    match nearest(word, &kinds) {
        Some(near) => format!("did you mean \"{near}\"? {hint}, or a kind of a finding or doubt"),
        None => hint,
    }
}

fn near_al_code(code: u16) -> Option<String> {
    let (near, _) = al_codes::CODES.iter().min_by_key(|(known, _)| known.abs_diff(code))?;
    if near.abs_diff(code) <= 0x10 {
        return Some(format!("the nearest AL status code is {}", AlStatusCode(*near)));
    }
    let near = objects::OBJECTS.into_iter().min_by_key(|index| index.abs_diff(code))?;
    let (name, _) = objects::object(near)?;
    (near.abs_diff(code) <= 0x100).then(|| format!("the nearest object is 0x{near:04X} ({name})"))
}

fn near_abort(code: u32) -> Option<String> {
    let (near, _) = aborts::CODES.iter().min_by_key(|(known, _)| {
        // A code that differs in one digit is nearer than one with a small difference.
        let digits = (0..8).filter(|digit| (known ^ code) >> (4 * digit) & 0xF != 0).count();
        (digits, known.abs_diff(code))
    })?;
    Some(format!("the nearest SDO abort code is {}", AbortCode(*near)))
}

/// The understood forms, with the list of known objects.
fn known_objects() -> String {
    understood(Some(object_list()))
}

fn object_list() -> String {
    let all = objects::OBJECTS.map(|index| format!("0x{index:04X}"));
    format!("objects that are known, those of synchronization: {}", all.join(", "))
}

fn understood(near: Option<String>) -> String {
    match near {
        Some(near) => format!("{near}\n{FORMS}"),
        None => FORMS.into(),
    }
}

/// The understood forms.
const FORMS: &str = "understood: 0x001A (AL status code), 0x06090030 (SDO abort code), 0x1C32:0B \
     (object), 0x1C32:04=0x0427 (its value), 0x0990 (register), 0x0300 (AssignActivate), dc-sync0 \
     (mode), modes, \"lost sync\" (symptom), input_shift (key of a segment file or a profile), \
     sync0-in-frame (kind of a finding, note or doubt), F7011 (alarm number of a drive's maker), a \
     whole line of a log; a kind before a number: AL, abort, SoE, object, register, \
     AssignActivate, SI4, key";

#[cfg(test)]
mod tests;

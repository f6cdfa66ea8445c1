//! Numbers within a line: AL status codes, abort codes, objects, registers and states.
//!
//! What stands before a number says what it is. A number that nothing names is only taken for what
//! cannot be mistaken: an abort code, an object of synchronization.

use isocat_sync::explain::{aborts, al_codes, symptoms};
use isocat_wire::ObjectAddress;

use super::super::{
    Meaning, abort_meaning, al_meaning, meanings as of_number, number::Number, object_meaning,
    register_meaning, symptom_meaning, word_meaning,
};
use super::makers;
use super::names::{ABORTS, AL_CODES};
use super::words::{Pattern, tokens};

/// One run of letters and digits.
struct Word<'a> {
    text: &'a str,
    /// In lower case.
    lower: String,
    /// The sign between it and the next run.
    after: &'a str,
}

/// The meanings of the numbers, the one that decides first.
pub(super) fn meanings(line: &str) -> Vec<Meaning> {
    let words = words(line);
    let mut used = vec![false; words.len()];
    let mut all = Vec::new();
    let mut code = None;
    let mut state = None;
    for (i, used) in used.iter_mut().enumerate() {
        let Some(role) = role(&words, i) else { continue };
        *used = true;
        match role {
            Role::AlCode(value) => code = code.or(Some(value)),
            Role::State(value) => state = state.or(Some(value)),
        }
    }
    let silent_stop = match (code, state) {
        (Some(0), Some(2)) => symptoms::find("stuck in PREOP"),
        (Some(0), Some(4)) => symptoms::find("stuck in SAFEOP"),
        _ => None,
    };
    all.extend(silent_stop.map(symptom_meaning));
    all.extend(code.and_then(al_meaning));
    for (i, used) in used.iter_mut().enumerate().filter(|(_, used)| !**used) {
        if let Some(abort) = abort(&words, i) {
            *used = true;
            all.extend(abort_meaning(abort));
        }
    }
    if code.is_none() {
        all.extend(named(line, all.is_empty()));
    }
    for i in 0..words.len() {
        let Some((address, count)) = object(&words, i).filter(|_| !used[i]) else { continue };
        if let Some(meaning) = object_meaning(address, None) {
            used[i..i + count].fill(true);
            all.push(meaning);
        }
    }
    all.extend(
        state
            .filter(|_| code != Some(0) || all.is_empty())
            .and_then(|state| register_meaning(0x0130, Some(u32::from(state)))),
    );
    let known_so_far = !all.is_empty();
    for i in (0..words.len()).filter(|i| !used[*i]) {
        all.extend(other(&words, i, known_so_far));
    }
    let mut once: Vec<Meaning> = Vec::new();
    for meaning in all {
        if !once.iter().any(|known| known.kind == meaning.kind && known.what == meaning.what) {
            once.push(meaning);
        }
    }
    once
}

enum Role {
    AlCode(u16),
    State(u16),
}

/// What the words before a number make of it.
fn role(words: &[Word<'_>], i: usize) -> Option<Role> {
    let before = words[i.saturating_sub(3)..i].iter().map(|word| word.lower.as_str());
    let before: Vec<&str> = before.collect();
    let last = before.last().copied().unwrap_or_default();
    let has = |word: &str| before.contains(&word);
    let names_code = before
        .iter()
        .any(|word| ["statuscode", "alstatuscode", "alcode", "alstatuscodes"].contains(word));
    let says_al = has("al") || before.iter().any(|word| word.starts_with("alstatus"));
    let is_code = names_code
        || has("code") && (has("status") || has("al"))
        || has("state") && last == "code"
        || says_al && (has("message") || has("error") || has("msg"));
    let hexadecimal = prefixed(&words[i].lower);
    let short = |value: u32| u16::try_from(value).ok();
    // "0x0134 is 0x001D": the register of the code, and its value.
    let reads_code = before.iter().rev().take(2).any(|word| *word == "0x0134");
    if let Some(value) = hexadecimal.filter(|value| reads_code && !(0x100..0x8000).contains(value))
    {
        return short(value).map(Role::AlCode);
    }
    if is_code {
        let value = match hexadecimal {
            Some(value) => value,
            // SOEM prints `StatusCode=  1e`.
            None if names_code || words[i].lower.len() == 4 => hex(&words[i].lower)?,
            None => words[i].lower.parse().ok()?,
        };
        return short(value).map(Role::AlCode);
    }
    let of_state = ["state", "alstate", "status", "alstatus", "zustand"].contains(&last);
    if of_state && (says_al || last.ends_with("state") || last == "zustand") {
        let value = match hexadecimal {
            Some(value) => value,
            None if words[i].lower.len() <= 2 => hex(&words[i].lower)?,
            None => return None,
        };
        let is_state = matches!(value & !0x10, 1..=4 | 8) && value < 0x20;
        return match (is_state, says_al) {
            (true, _) => short(value).map(Role::State),
            (false, true) => short(value).map(Role::AlCode),
            (false, false) => None,
        };
    }
    None
}

/// A known abort code: of eight hex digits, or a decimal number, as Python prints it.
fn abort(words: &[Word<'_>], i: usize) -> Option<u32> {
    let text = words[i].lower.as_str();
    let digits = text.strip_prefix("0x").unwrap_or(text);
    let known = |value: &u32| aborts::explain(isocat_wire::AbortCode(*value)).is_some();
    let eight = (digits.len() == 8).then(|| hex(digits)).flatten();
    let after_abort = || {
        let before = words[i.saturating_sub(2)..i].iter();
        before.into_iter().any(|word| word.lower.starts_with("abort"))
    };
    let seven = (digits.len() == 7 && (text != digits || after_abort())).then(|| hex(digits));
    let decimal = || text.parse().ok().filter(|value: &u32| *value >= 0x0503_0000);
    eight.or(seven.flatten()).filter(known).or_else(|| decimal().filter(known))
}

/// An AL status code or abort code by the text that is printed for it. A text that several stacks
/// also use in passing counts only if there is no number.
fn named(line: &str, alone: bool) -> Option<Meaning> {
    let tokens = tokens(line);
    let longest = |best: &mut Option<(usize, u32, bool)>, text: &str, code: u32, al: bool| {
        let letters = Pattern::new(text).fits(&tokens).unwrap_or_default();
        if letters > best.map_or(0, |(most, ..)| most) {
            *best = Some((letters, code, al));
        }
    };
    let mut best = None;
    for (code, text) in &AL_CODES {
        longest(&mut best, text, u32::from(*code), true);
    }
    for (code, text) in &ABORTS {
        longest(&mut best, text, *code, false);
    }
    match best.filter(|_| alone)? {
        (_, code, true) => al_meaning(u16::try_from(code).ok()?),
        (_, code, false) => abort_meaning(code),
    }
}

/// An object and the number of words that it takes: `0x1C12:00`, `1c12.00`, `0x1C12`, `1C12h`.
/// A number without a sign that it is hexadecimal needs a word that names it.
fn object(words: &[Word<'_>], i: usize) -> Option<(ObjectAddress, usize)> {
    let text = words[i].lower.as_str();
    let before = words[i.saturating_sub(2)..i].iter().map(|word| word.lower.as_str());
    let before: Vec<&str> = before.collect();
    let other = ["slave", "subdevice", "station", "address", "vendor", "product", "revision"];
    if before.last().is_some_and(|word| other.contains(word)) {
        return None;
    }
    let names = ["index", "object", "sdo", "pdo", "entry", "download", "upload", "obj", "idx"];
    let named = before.iter().any(|word| names.contains(word));
    let marked = prefixed(text).or_else(|| suffixed(text)).filter(|_| text.len() >= 5);
    let bare = || (text.len() == 4).then(|| hex(text)).flatten();
    let decimal = || {
        let abort = words.get(i + 2).and_then(|_| abort(words, i + 2));
        abort.and_then(|_| text.parse().ok())
    };
    let joined = matches!(words[i].after, ":" | ".") && text.len() >= 4;
    let index = match marked {
        Some(index) => index,
        None if named || joined => bare().or_else(decimal)?,
        None => decimal()?,
    };
    let index = u16::try_from(index).ok().filter(|index| *index >= 0x1000)?;
    let sub = words.get(i + 1).filter(|_| joined).and_then(|word| {
        let digits = word.lower.strip_prefix("0x").unwrap_or(&word.lower);
        (digits.len() <= 2).then(|| hex(digits)).flatten()
    });
    let sub = sub.and_then(|sub| u8::try_from(sub).ok());
    if marked.is_none() && !named && sub.is_none() && decimal().is_none() {
        return None;
    }
    let address = ObjectAddress::new(index, sub.unwrap_or(0));
    let known = object_meaning(address, None).is_some();
    Some((
        if known { address } else { ObjectAddress::new(index, 0) },
        1 + usize::from(sub.is_some()),
    ))
}

/// A number that nothing has explained yet: what it means by itself, if it is written with `0x` and
/// is no address, identity or pointer.
fn other(words: &[Word<'_>], i: usize, known_so_far: bool) -> Vec<Meaning> {
    let Some(value) = words.get(i).and_then(|word| prefixed(&word.lower)) else {
        return Vec::new();
    };
    let Ok(short) = u16::try_from(value) else { return Vec::new() };
    let before = words[i.saturating_sub(2)..i].iter().map(|word| word.lower.as_str());
    let before: Vec<&str> = before.collect();
    let is = |names: &[&str]| before.iter().any(|word| names.contains(word));
    if is(&["register", "reg", "ado", "fprd", "fpwr", "brd", "bwr", "aprd", "apwr", "frmw", "armw"])
    {
        return register_meaning(short, None).into_iter().collect();
    }
    if is(&["assignactivate", "activate", "dcassignactivate"]) {
        return vec![word_meaning(short)];
    }
    if known_so_far || is(&OF_SOMETHING_ELSE) {
        return Vec::new();
    }
    if short >= al_codes::FIRST_OF_VENDOR {
        return makers::known(&format!("{short:04X}"));
    }
    let after_error = is(&["error", "code", "fault", "reason"]) && short > 1;
    if let Some(code) = al_meaning(short).filter(|_| after_error) {
        return vec![code];
    }
    if words[i].text.len() < 6 {
        return Vec::new();
    }
    let number = Number { value, long: false };
    of_number(number, None).into_iter().filter(|meaning| meaning.kind != "SoE error code").collect()
}

/// Words before a number that is nothing that a table here could explain.
const OF_SOMETHING_ELSE: [&str; 26] = [
    "slave",
    "subdevice",
    "device",
    "station",
    "address",
    "vendor",
    "product",
    "revision",
    "serial",
    "offset",
    "datagram",
    "logical",
    "id",
    "devstate",
    "size",
    "length",
    "position",
    "alias",
    "config",
    "statusword",
    "word",
    "state",
    "mask",
    "flags",
    "type",
    "controlword",
];

/// The value of `0x1A`, or of `x300` and `#x300`, of which the sign is gone here.
fn prefixed(text: &str) -> Option<u32> {
    hex(text.strip_prefix("0x").or_else(|| text.strip_prefix('x'))?)
}

/// The value of `1C32h`.
fn suffixed(text: &str) -> Option<u32> {
    hex(text.strip_suffix('h').filter(|digits| digits.len() == 4)?)
}

fn hex(digits: &str) -> Option<u32> {
    let all = !digits.is_empty() && digits.chars().all(|c| c.is_ascii_hexdigit());
    all.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

/// The runs of letters and digits, with the sign behind each.
fn words(line: &str) -> Vec<Word<'_>> {
    let mut words = Vec::new();
    let mut rest = line;
    while let Some(start) = rest.find(|c: char| c.is_alphanumeric()) {
        let from = &rest[start..];
        let end = from.find(|c: char| !c.is_alphanumeric()).unwrap_or(from.len());
        let text = &from[..end];
        rest = &from[end..];
        let gap = rest.find(|c: char| c.is_alphanumeric()).unwrap_or(rest.len());
        words.push(Word { text, lower: text.to_lowercase(), after: &rest[..gap] });
    }
    words
}

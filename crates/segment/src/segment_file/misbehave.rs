//! The key `misbehave`: misbehaviours of a device, by name.

use isocat_descriptions::document::section::{Keys, Words};
use isocat_descriptions::document::{FileError, Value, name_hint};
use isocat_descriptions::quantity;
use isocat_subdevice::{BadAnswer, Misbehaviour, Misbehaviours};
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, AlState, AlStatusCode, ObjectAddress};

use crate::profile::Profile;

/// A word of [`Misbehaviour::WORDS`], an example of its arguments, and its reader.
type Word = (&'static str, &'static str, fn(&mut Arguments<'_>) -> Option<Misbehaviour>);

/// The readers of the words.
const WORDS: [Word; 32] = [
    ("wrong-value", "1C32:05 7", |a| Some(Misbehaviour::WrongValue(a.object()?, a.number()?))),
    ("wrong-type", "1C32:05 0x06", |a| {
        Some(Misbehaviour::WrongType(a.object()?, a.number()?.try_into().ok()?))
    }),
    ("missing-entry", "1C32:0C", |a| Some(Misbehaviour::MissingEntry(a.object()?))),
    ("read-only", "1C32:03", |a| Some(Misbehaviour::ReadOnly(a.object()?))),
    ("shifted-complete-access", "1C32", |a| Some(Misbehaviour::ShiftedCompleteAccess(a.index()?))),
    ("refuses-read", "1C32:05", |a| Some(Misbehaviour::RefusesRead(a.object()?))),
    ("refuses-write", "1C32:08 OP", |a| Some(Misbehaviour::RefusesWrite(a.object()?, a.state()?))),
    ("accepts-write", "1C32:05", |a| Some(Misbehaviour::AcceptsWrite(a.object()?))),
    ("accepts-value", "1C32:01 127", |a| {
        Some(Misbehaviour::AcceptsValue(a.object()?, a.number()?))
    }),
    ("wrong-abort", "1C32:01 0x06090030", |a| {
        Some(Misbehaviour::WrongAbort(a.object()?, AbortCode(a.number()?)))
    }),
    ("frozen-counter", "1C32:0B", |a| Some(Misbehaviour::FrozenCounter(a.object()?))),
    ("wrong-counter", "1C32:0B 2", |a| {
        Some(Misbehaviour::WrongCounter(a.object()?, a.number().filter(|more| *more > 0)?))
    }),
    ("keeps-counters", "", |_| Some(Misbehaviour::KeepsCounters)),
    ("ignores-reset", "", |_| Some(Misbehaviour::IgnoresReset)),
    ("wrong-limit", "3", |a| Some(Misbehaviour::WrongLimit(a.number()?.try_into().ok()?))),
    ("half-hidden", "", |_| Some(Misbehaviour::HalfHidden)),
    ("refused-state", "OP", |a| Some(Misbehaviour::RefusedState(a.state()?))),
    ("accepts-setup", "0x0030 0x05", |a| {
        let code = a.code()?;
        let activation = match a.rest() {
            true => Some(a.number()?.try_into().ok()?),
            false => None,
        };
        Some(Misbehaviour::AcceptsSetup(code, activation))
    }),
    ("wrong-al-code", "0x001B OP", |a| Some(Misbehaviour::WrongAlCode(a.code()?, a.state()?))),
    ("keeps-error", "0x001A", |a| Some(Misbehaviour::KeepsError(a.code()?))),
    ("forgets-error", "", |_| Some(Misbehaviour::ForgetsError)),
    ("late-application", "5us", |a| Some(Misbehaviour::LateApplication(a.time()?))),
    ("late-copy", "40us", |a| Some(Misbehaviour::LateCopy(a.time()?))),
    ("missed-copy", "3", |a| {
        Some(Misbehaviour::MissedCopy(a.number().filter(|every| *every > 0)?))
    }),
    ("short-of-time", "300us", |a| Some(Misbehaviour::ShortOfTime(a.time()?))),
    ("dead-sync0", "", |_| Some(Misbehaviour::DeadSync0)),
    ("ignores-shift", "", |_| Some(Misbehaviour::IgnoresShift)),
    ("ignores-sync-unit", "", |_| Some(Misbehaviour::IgnoresSyncUnit)),
    ("no-first-inputs", "", |_| Some(Misbehaviour::NoFirstInputs)),
    ("slow-mailbox", "1200ms", |a| Some(Misbehaviour::SlowMailbox(a.time()?))),
    ("bad-information", "short", |a| Some(Misbehaviour::BadInformation(a.answer()?))),
    ("bad-transfer", "1C32 silent", |a| Some(Misbehaviour::BadTransfer(a.index()?, a.answer()?))),
];

/// The vocabulary for people: each word with an example of its arguments, and its meaning.
pub fn vocabulary() -> impl Iterator<Item = (String, &'static str)> {
    WORDS.iter().map(|(name, example, _)| (format!("{name} {example}"), means(name)))
}

/// The words of the vocabulary, for the key's declaration.
pub(super) struct Vocabulary;

impl Words for Vocabulary {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        WORDS.iter().map(|(name, ..)| (*name, means(name))).collect()
    }
}

/// The meaning of a word in a table: without the full stop.
fn means(word: &str) -> &'static str {
    let means = Misbehaviour::means(word).expect("the word is one of the vocabulary");
    means.strip_suffix('.').unwrap_or(means)
}

/// Reads the key: a list of texts, each a word and its arguments.
pub(super) fn misbehave(keys: &Keys<'_>, profile: &Profile) -> Result<Misbehaviours, FileError> {
    let texts = keys.list("misbehave", "faults, such as [\"dead-sync0\", \"missed-copy 3\"]")?;
    if texts.is_empty() {
        return Ok(Misbehaviours::NONE);
    }
    let mut faults = Vec::new();
    for text in &texts {
        let fault = one(text)?;
        if let Some(why) = without_effect(profile, fault) {
            return Err(text.error(format!("{} has no {why} to misbehave with", profile.id)));
        }
        faults.push(fault);
    }
    Misbehaviours::of(&faults).ok_or_else(|| {
        let (found, most) = (faults.len(), Misbehaviours::MOST);
        keys.error_at("misbehave", format!("{found} faults; expected at most {most}"))
    })
}

/// A property that a fault needs and the device does not have.
fn without_effect(profile: &Profile, fault: Misbehaviour) -> Option<String> {
    use Misbehaviour::*;
    let objects = profile.description.objects;
    let object = |index| objects.iter().find(|object| object.index == index);
    match fault {
        WrongValue(at, _)
        | WrongType(at, _)
        | MissingEntry(at)
        | ReadOnly(at)
        | RefusesRead(at)
        | RefusesWrite(at, _)
        | AcceptsWrite(at)
        | AcceptsValue(at, _)
        | FrozenCounter(at)
        | WrongCounter(at, _) => {
            let entry =
                object(at.index).is_some_and(|o| o.entries.iter().any(|entry| entry.sub == at.sub));
            (!entry).then(|| at.to_string())
        }
        ShiftedCompleteAccess(index) | BadTransfer(index, _) => {
            object(index).is_none().then(|| format!("object 0x{index:04X}"))
        }
        DeadSync0 | IgnoresSyncUnit => {
            let dc = profile.modes().any(|mode| mode.uses_dc());
            (!dc).then(|| "mode with SYNC0".to_owned())
        }
        _ => None,
    }
}

fn one(value: &Value<'_>) -> Result<Misbehaviour, FileError> {
    let text = value.name("a fault, such as \"missed-copy 3\"")?;
    misbehaviour(text).map_err(|message| match message.split_once("\n") {
        Some((message, hint)) => value.error(message).with_hint(hint),
        None => value.error(message),
    })
}

/// Reads a word and its arguments. An error is a sentence, with a hint in a second line if there is
/// one.
pub(crate) fn misbehaviour(text: &str) -> Result<Misbehaviour, String> {
    let mut arguments = Arguments(text.split_whitespace());
    let name = arguments.0.next().unwrap_or_default();
    let Some((name, example, read)) = WORDS.iter().find(|word| word.0 == name) else {
        let hint = name_hint(name, WORDS.iter().map(|word| word.0));
        return Err(format!("unknown fault \"{name}\"\n{hint}"));
    };
    match read(&mut arguments) {
        Some(fault) if !arguments.rest() => Ok(fault),
        _ => {
            let expected = format!("{name} {example}");
            Err(format!("\"{text}\"; expected such as \"{}\"", expected.trim_end()))
        }
    }
}

/// The arguments of a word.
struct Arguments<'a>(std::str::SplitWhitespace<'a>);

impl Arguments<'_> {
    fn rest(&self) -> bool {
        self.0.clone().next().is_some()
    }

    fn number(&mut self) -> Option<u32> {
        let text = self.0.next()?;
        match text.strip_prefix("0x") {
            Some(digits) => u32::from_str_radix(digits, 16).ok(),
            None => text.parse().ok(),
        }
    }

    fn code(&mut self) -> Option<AlStatusCode> {
        self.number()?.try_into().ok().map(AlStatusCode)
    }

    fn time(&mut self) -> Option<Nanos> {
        let time = quantity::parse_duration(self.0.next()?).ok()?;
        (Nanos::ZERO..=Nanos::millis(60_000)).contains(&time).then_some(time)
    }

    fn index(&mut self) -> Option<u16> {
        u16::from_str_radix(self.0.next()?, 16).ok()
    }

    fn object(&mut self) -> Option<ObjectAddress> {
        let (index, sub) = self.0.next()?.split_once(':')?;
        let index = u16::from_str_radix(index, 16).ok()?;
        Some(ObjectAddress::new(index, u8::from_str_radix(sub, 16).ok()?))
    }

    fn answer(&mut self) -> Option<BadAnswer> {
        let word = self.0.next()?;
        BadAnswer::WORDS.iter().find(|(known, _)| *known == word).map(|(_, answer)| *answer)
    }

    fn state(&mut self) -> Option<AlState> {
        let name = self.0.next()?;
        let states = [AlState::Init, AlState::PreOp, AlState::SafeOp, AlState::Op];
        states.into_iter().find(|state| state.name() == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_the_vocabulary_is_read_from_its_example() {
        let readers: Vec<_> = WORDS.iter().map(|word| word.0).collect();
        let words: Vec<_> = Misbehaviour::WORDS.iter().map(|word| word.0).collect();
        assert_eq!(readers, words);
        for (word, example, read) in WORDS {
            let mut arguments = Arguments(example.split_whitespace());
            let fault = read(&mut arguments).unwrap_or_else(|| panic!("{word} {example}"));
            assert_eq!(fault.word(), word);
            assert!(!arguments.rest() && !means(word).ends_with('.'), "{word} {example}");
        }
    }
}

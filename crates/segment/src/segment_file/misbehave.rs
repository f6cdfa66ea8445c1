//! The key `misbehave`: what a device does wrong, by name.

use isocat_descriptions::document::section::{Keys, Words};
use isocat_descriptions::document::{FileError, Value, name_hint};
use isocat_descriptions::quantity;
use isocat_subdevice::Misbehaviour;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, AlState, AlStatusCode, ObjectAddress};

use crate::profile::Profile;

/// A name, an example of what stands behind it, what it means, and its reader.
type Word =
    (&'static str, &'static str, &'static str, fn(&mut Arguments<'_>) -> Option<Misbehaviour>);

/// The vocabulary.
const WORDS: [Word; 30] = [
    (
        "wrong-value",
        "1C32:05 7",
        "The entry always reads this number; what the device goes by stays right",
        |a| Some(Misbehaviour::WrongValue(a.object()?, a.number()?)),
    ),
    ("wrong-type", "1C32:05 0x06", "SDO information tells this type code for the entry", |a| {
        Some(Misbehaviour::WrongType(a.object()?, a.number()?.try_into().ok()?))
    }),
    (
        "missing-entry",
        "1C32:0C",
        "The entry does not exist: not for SDOs, not for SDO information",
        |a| Some(Misbehaviour::MissingEntry(a.object()?)),
    ),
    ("read-only", "1C32:03", "The entry can't be written, and SDO information says so", |a| {
        Some(Misbehaviour::ReadOnly(a.object()?))
    }),
    (
        "shifted-complete-access",
        "1C32",
        "Complete access to the object gives its bytes in wrong places",
        |a| Some(Misbehaviour::ShiftedCompleteAccess(a.index()?)),
    ),
    (
        "refuses-read",
        "1C32:05",
        "The entry can't be read in SAFEOP and OP, whatever its access word says",
        |a| Some(Misbehaviour::RefusesRead(a.object()?)),
    ),
    (
        "refuses-write",
        "1C32:08 OP",
        "The entry can't be written in this state, whatever its access word says",
        |a| Some(Misbehaviour::RefusesWrite(a.object()?, a.state()?)),
    ),
    (
        "accepts-write",
        "1C32:05",
        "The entry can be written in every state, whatever its access word says",
        |a| Some(Misbehaviour::AcceptsWrite(a.object()?)),
    ),
    ("accepts-value", "1C32:01 127", "The entry takes this number, which it must refuse", |a| {
        Some(Misbehaviour::AcceptsValue(a.object()?, a.number()?))
    }),
    (
        "wrong-abort",
        "1C32:01 0x06090030",
        "Transfers of the entry that must fail with this code fail with the general error",
        |a| Some(Misbehaviour::WrongAbort(a.object()?, AbortCode(a.number()?))),
    ),
    (
        "frozen-counter",
        "1C32:0B",
        "The sub-index of a sync object counts, but always reads 0",
        |a| Some(Misbehaviour::FrozenCounter(a.object()?)),
    ),
    (
        "wrong-counter",
        "1C32:0B 2",
        "The sub-index of a sync object reads so much more than it counted, once it has counted",
        |a| Some(Misbehaviour::WrongCounter(a.object()?, a.number().filter(|more| *more > 0)?)),
    ),
    (
        "keeps-counters",
        "",
        "The counters are not cleared at PREOP to SAFEOP, nor on the way back",
        |_| Some(Misbehaviour::KeepsCounters),
    ),
    ("ignores-reset", "", "Sub-index 08, bit 1 clears nothing", |_| {
        Some(Misbehaviour::IgnoresReset)
    }),
    ("wrong-limit", "3", "The limit of missed events is so much higher than it says", |a| {
        Some(Misbehaviour::WrongLimit(a.number()?.try_into().ok()?))
    }),
    (
        "half-hidden",
        "",
        "0x1C32:00 and 0x1C33:00 read 0 in SAFEOP and OP when the direction is not transmitted, but their sub-indices stay",
        |_| Some(Misbehaviour::HalfHidden),
    ),
    (
        "refused-state",
        "OP",
        "The state is never entered (INIT: not from SAFEOP and OP): 0x0001",
        |a| Some(Misbehaviour::RefusedState(a.state()?)),
    ),
    (
        "accepts-setup",
        "0x0030 0x05",
        "A set-up that must be refused with this code is accepted; with a number, only if register 0x0981 has this value",
        |a| {
            let code = a.code()?;
            let activation = match a.rest() {
                true => Some(a.number()?.try_into().ok()?),
                false => None,
            };
            Some(Misbehaviour::AcceptsSetup(code, activation))
        },
    ),
    (
        "wrong-al-code",
        "0x001B OP",
        "What must be told by this code, in this state, is told as 0x0001",
        |a| Some(Misbehaviour::WrongAlCode(a.code()?, a.state()?)),
    ),
    (
        "keeps-error",
        "0x001A",
        "The error with this code is not given up when it is acknowledged; INIT is the only way out",
        |a| Some(Misbehaviour::KeepsError(a.code()?)),
    ),
    ("forgets-error", "", "A request is followed although the error was not acknowledged", |_| {
        Some(Misbehaviour::ForgetsError)
    }),
    ("late-application", "5us", "Everything but the copying of outputs comes so much later", |a| {
        Some(Misbehaviour::LateApplication(a.time()?))
    }),
    ("late-copy", "40us", "The copying of outputs begins so much later", |a| {
        Some(Misbehaviour::LateCopy(a.time()?))
    }),
    ("missed-copy", "3", "Every so many-th SM2 event goes by unnoticed", |a| {
        Some(Misbehaviour::MissedCopy(a.number().filter(|every| *every > 0)?))
    }),
    (
        "short-of-time",
        "300us",
        "At SYNC0 cycles shorter than this, every other SM2 event goes by unnoticed",
        |a| Some(Misbehaviour::ShortOfTime(a.time()?)),
    ),
    ("dead-sync0", "", "SYNC0 is never noticed", |_| Some(Misbehaviour::DeadSync0)),
    ("ignores-shift", "", "The shift time has no effect", |_| Some(Misbehaviour::IgnoresShift)),
    (
        "ignores-sync-unit",
        "",
        "Who does not choose a type gets SM-synchronous operation, whatever the SYNC unit is set to",
        |_| Some(Misbehaviour::IgnoresSyncUnit),
    ),
    ("no-first-inputs", "", "SAFEOP is entered without inputs in the buffer", |_| {
        Some(Misbehaviour::NoFirstInputs)
    }),
    ("slow-mailbox", "1200ms", "The mailbox is answered so much later", |a| {
        Some(Misbehaviour::SlowMailbox(a.time()?))
    }),
];

/// The vocabulary for people: each word with an example of what stands behind it, and what it means.
pub fn vocabulary() -> impl Iterator<Item = (String, &'static str)> {
    WORDS.iter().map(|(name, example, means, _)| (format!("{name} {example}"), *means))
}

/// The words of the vocabulary, for the key's declaration.
pub(super) struct Vocabulary;

impl Words for Vocabulary {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        WORDS.iter().map(|(name, _, means, _)| (*name, *means)).collect()
    }
}

/// Reads the key: a list of texts, each a word and what it needs.
pub(super) fn misbehave(
    keys: &Keys<'_>,
    profile: &Profile,
) -> Result<&'static [Misbehaviour], FileError> {
    let texts = keys.list("misbehave", "faults, such as [\"dead-sync0\", \"missed-copy 3\"]")?;
    if texts.is_empty() {
        return Ok(&[]);
    }
    let mut faults = Vec::new();
    for text in &texts {
        let fault = one(text)?;
        if let Some(why) = without_effect(profile, fault) {
            return Err(text.error(format!("{} has no {why} to misbehave with", profile.id)));
        }
        faults.push(fault);
    }
    // It becomes part of a device's description, which lives as long as the program.
    Ok(Vec::leak(faults))
}

/// What a fault needs and the device does not have.
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
        ShiftedCompleteAccess(index) => {
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
    let mut arguments = Arguments(text.split_whitespace());
    let name = arguments.0.next().unwrap_or_default();
    let Some((name, example, _, read)) = WORDS.iter().find(|word| word.0 == name) else {
        return Err(value
            .error(format!("unknown fault \"{name}\""))
            .with_hint(name_hint(name, WORDS.iter().map(|word| word.0))));
    };
    match read(&mut arguments) {
        Some(fault) if !arguments.rest() => Ok(fault),
        _ => {
            let expected = format!("{name} {example}");
            Err(value.error(format!("\"{text}\"; expected such as \"{}\"", expected.trim_end())))
        }
    }
}

/// What stands behind a name.
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

    fn state(&mut self) -> Option<AlState> {
        let name = self.0.next()?;
        let states = [AlState::Init, AlState::PreOp, AlState::SafeOp, AlState::Op];
        states.into_iter().find(|state| state.name() == name)
    }
}

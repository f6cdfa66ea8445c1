//! Misbehaviours of devices by name, so that a device test can prove that it detects them.
//!
//! A device is correct as long as
//! [`Behaviour::misbehaviour`](crate::description::Behaviour::misbehaviour) is empty. Each
//! misbehaviour is small: it breaks one rule and keeps all others.

use isocat_wire::{AbortCode, AlState, AlStatusCode, Nanos, ObjectAddress};

/// Declares the vocabulary: the meaning, the word, and the misbehaviour with its parameters.
macro_rules! vocabulary {
    ($($(#[doc = $means:literal])+ $word:literal $fault:ident $(($($needs:ty),+))?,)+) => {
        /// A misbehaviour of a device.
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        pub enum Misbehaviour {
            $($(#[doc = $means])+ $fault $(($($needs),+))?,)+
        }

        impl Misbehaviour {
            /// The vocabulary: each word with its meaning.
            pub const WORDS: &'static [(&'static str, &'static str)] =
                &[$(($word, concat!($($means),+).trim_ascii()),)+];

            /// Its word.
            pub const fn word(&self) -> &'static str {
                match self {
                    $(Self::$fault { .. } => $word,)+
                }
            }

            /// The meaning of a word; `None` if it is not in the vocabulary.
            pub fn means(word: &str) -> Option<&'static str> {
                let mut words = Self::WORDS.iter();
                words.find(|(known, _)| *known == word).map(|(_, means)| *means)
            }
        }
    };
}

vocabulary! {
    /// The entry always reads this number; the value that the device uses stays right.
    "wrong-value" WrongValue(ObjectAddress, u32),
    /// SDO information gives this type code for the entry.
    "wrong-type" WrongType(ObjectAddress, u16),
    /// The entry does not exist, neither for SDOs nor for SDO information.
    "missing-entry" MissingEntry(ObjectAddress),
    /// The entry cannot be written, and SDO information says so.
    "read-only" ReadOnly(ObjectAddress),
    /// Complete access to the object gives its bytes at wrong places.
    "shifted-complete-access" ShiftedCompleteAccess(u16),
    /// The entry cannot be read in SAFEOP and OP, whatever its access word says.
    "refuses-read" RefusesRead(ObjectAddress),
    /// The entry cannot be written in this state, whatever its access word says.
    "refuses-write" RefusesWrite(ObjectAddress, AlState),
    /// The entry can be written in every state, whatever its access word says.
    "accepts-write" AcceptsWrite(ObjectAddress),
    /// The entry accepts this number, which it must refuse.
    "accepts-value" AcceptsValue(ObjectAddress, u32),
    /// Transfers of the entry that must fail with this code fail with the general error.
    "wrong-abort" WrongAbort(ObjectAddress, AbortCode),
    /// The sub-index of a sync object counts, but always reads 0.
    "frozen-counter" FrozenCounter(ObjectAddress),
    /// The sub-index of a sync object reads this much more than it counted, once it has counted.
    "wrong-counter" WrongCounter(ObjectAddress, u32),
    /// The counters are not cleared at PREOP to SAFEOP, nor on the way down.
    "keeps-counters" KeepsCounters,
    /// Sub-index 08, bit 1 clears nothing.
    "ignores-reset" IgnoresReset,
    /// The limit of missed events is this much higher than stated.
    "wrong-limit" WrongLimit(u16),
    /// 0x1C32:00 and 0x1C33:00 read 0 in SAFEOP and OP if the direction is not transmitted, but
    /// their sub-indices still exist.
    "half-hidden" HalfHidden,
    /// The state is never entered (INIT: not from SAFEOP and OP): code 0x0001.
    "refused-state" RefusedState(AlState),
    /// A set-up that must be refused with this code is accepted; with a number, only if register
    /// 0x0981 has this value.
    "accepts-setup" AcceptsSetup(AlStatusCode, Option<u8>),
    /// An error that must have this code, in this state, has code 0x0001.
    "wrong-al-code" WrongAlCode(AlStatusCode, AlState),
    /// The error with this code stays after it is acknowledged; only INIT clears it.
    "keeps-error" KeepsError(AlStatusCode),
    /// A request is accepted although the error was not acknowledged.
    "forgets-error" ForgetsError,
    /// All steps except the copying of outputs are this much later.
    "late-application" LateApplication(Nanos),
    /// The copying of outputs begins this much later.
    "late-copy" LateCopy(Nanos),
    /// Every n-th SM2 event is ignored.
    "missed-copy" MissedCopy(u32),
    /// With SYNC0 cycles shorter than this, every other SM2 event is ignored.
    "short-of-time" ShortOfTime(Nanos),
    /// SYNC0 is ignored.
    "dead-sync0" DeadSync0,
    /// The shift time has no effect.
    "ignores-shift" IgnoresShift,
    /// Without a chosen type the device is SM-synchronous, whatever the SYNC unit is set to.
    "ignores-sync-unit" IgnoresSyncUnit,
    /// SAFEOP is entered without inputs in the buffer.
    "no-first-inputs" NoFirstInputs,
    /// The mailbox is answered this much later.
    "slow-mailbox" SlowMailbox(Nanos),
    /// SDO information is answered in this way: short (the headers alone), silent, garbage (another
    /// service), error (of the mailbox) or abort.
    "bad-information" BadInformation(BadAnswer),
    /// SDO transfers of the object are answered in this way: short, silent, garbage, error or
    /// abort.
    "bad-transfer" BadTransfer(u16, BadAnswer),
}

/// A wrong answer of a mailbox service.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum BadAnswer {
    /// The CoE header and four bytes, whatever must follow.
    Short,
    /// No answer.
    Silent,
    /// A command that is not an answer to this request.
    Garbage,
    /// A mailbox error.
    Error,
    /// An abort with the general code.
    Abort,
}

impl BadAnswer {
    /// All wrong answers, each with its word.
    pub const WORDS: [(&'static str, Self); 5] = [
        ("short", Self::Short),
        ("silent", Self::Silent),
        ("garbage", Self::Garbage),
        ("error", Self::Error),
        ("abort", Self::Abort),
    ];
}

/// All misbehaviours of a device, at most [`MOST`](Self::MOST). They are kept by value, so that a
/// device can begin and end a misbehaviour without allocation.
#[derive(Clone, Copy, Debug)]
pub struct Misbehaviours {
    /// Entries from `count` on have no meaning.
    things: [Misbehaviour; Self::MOST],
    count: u8,
}

impl Misbehaviours {
    /// Most misbehaviours of a device at a time; 0 without the feature `misbehaviour`.
    pub const MOST: usize = if cfg!(feature = "misbehaviour") { 32 } else { 0 };
    /// No misbehaviour.
    pub const NONE: Self = Self { things: [Misbehaviour::KeepsCounters; Self::MOST], count: 0 };

    /// These misbehaviours; `None` if they are more than [`MOST`](Self::MOST).
    pub fn of(things: &[Misbehaviour]) -> Option<Self> {
        let mut all = Self::NONE;
        all.things.get_mut(..things.len())?.copy_from_slice(things);
        all.count = things.len() as u8;
        Some(all)
    }

    /// All misbehaviours, in the order in which they began.
    pub const fn all(&self) -> &[Misbehaviour] {
        self.things.split_at(self.count as usize).0
    }

    /// Begins a misbehaviour; one that is already present becomes the last. With
    /// [`MOST`](Self::MOST) of them, the first one ends.
    pub fn begin(&mut self, how: Misbehaviour) {
        self.end(how);
        if self.all().len() == Self::MOST {
            let Some(first) = self.all().first() else { return };
            self.end(*first);
        }
        self.things[usize::from(self.count)] = how;
        self.count += 1;
    }

    /// Ends a misbehaviour.
    pub fn end(&mut self, how: Misbehaviour) {
        let Some(place) = self.all().iter().position(|thing| *thing == how) else { return };
        self.things.copy_within(place + 1..usize::from(self.count), place);
        self.count -= 1;
    }
}

impl Default for Misbehaviours {
    fn default() -> Self {
        Self::NONE
    }
}

impl PartialEq for Misbehaviours {
    fn eq(&self, other: &Self) -> bool {
        self.all() == other.all()
    }
}

impl Eq for Misbehaviours {}

use Misbehaviour::*;

/// The misbehaviours of a device; empty for a correct device.
pub(crate) type Faults = [Misbehaviour];

/// The number that an entry shows in place of the right one.
pub(crate) fn shown(faults: &Faults, address: ObjectAddress, own: u32) -> u32 {
    let mut shown = own;
    for fault in faults {
        match *fault {
            WrongValue(at, number) if at == address => shown = number,
            FrozenCounter(at) if at == address => shown = 0,
            WrongCounter(at, more) if at == address && own > 0 => shown = own.saturating_add(more),
            _ => {}
        }
    }
    shown
}

/// The abort code in place of the right one.
pub(crate) fn abort(faults: &Faults, address: ObjectAddress, code: AbortCode) -> AbortCode {
    if faults.contains(&WrongAbort(address, code)) { AbortCode::GENERAL } else { code }
}

/// The AL status code in place of the right one.
pub(crate) fn al_code(faults: &Faults, state: AlState, code: AlStatusCode) -> AlStatusCode {
    if faults.contains(&WrongAlCode(code, state)) { AlStatusCode::UNSPECIFIED } else { code }
}

/// Whether a set-up that must be refused with this code is accepted; `activation` is register
/// 0x0981.
pub(crate) fn accepts(faults: &Faults, code: AlStatusCode, activation: u8) -> bool {
    faults.contains(&AcceptsSetup(code, None))
        || faults.contains(&AcceptsSetup(code, Some(activation)))
}

/// The wrong answer to transfers of an object, if any.
pub(crate) fn bad_transfer(faults: &Faults, index: u16) -> Option<BadAnswer> {
    number(faults, |fault| match *fault {
        BadTransfer(at, answer) if at == index => Some(answer),
        _ => None,
    })
}

/// The wrong answer to SDO information, if any.
pub(crate) fn bad_information(faults: &Faults) -> Option<BadAnswer> {
    number(faults, |fault| match *fault {
        BadInformation(answer) => Some(answer),
        _ => None,
    })
}

/// The first number that `of` finds.
pub(crate) fn number<T>(faults: &Faults, of: impl Fn(&Misbehaviour) -> Option<T>) -> Option<T> {
    faults.iter().find_map(of)
}

#[cfg(all(test, feature = "misbehaviour"))]
mod tests {
    use super::*;

    #[test]
    fn as_many_things_as_fit() {
        let things: [_; Misbehaviours::MOST + 1] =
            core::array::from_fn(|n| Misbehaviour::WrongLimit(n as u16));
        assert!(Misbehaviours::of(&things).is_none());
        let mut all = Misbehaviours::of(&things[..Misbehaviours::MOST]).expect("as many as fit");
        assert_eq!(all.all(), &things[..Misbehaviours::MOST]);
        // One more replaces the first. The same one again is present once, as the last.
        all.begin(things[Misbehaviours::MOST]);
        assert_eq!(all.all(), &things[1..]);
        all.begin(things[1]);
        assert_eq!((all.all().len(), all.all().last()), (Misbehaviours::MOST, Some(&things[1])));
        assert_eq!(all.all()[0], things[2]);
    }

    #[test]
    fn what_ends_is_gone() {
        let mut all = Misbehaviours::NONE;
        let (one, other) = (Misbehaviour::DeadSync0, Misbehaviour::KeepsCounters);
        all.begin(one);
        all.begin(other);
        all.end(one);
        all.end(one);
        assert_eq!(all.all(), [other]);
        all.end(other);
        assert_eq!(all, Misbehaviours::NONE);
    }
}

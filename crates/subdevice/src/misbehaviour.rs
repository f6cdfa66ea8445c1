//! Misbehaviour: what devices do wrong, by name, so that a test of devices can prove that it sees it.
//!
//! A device behaves as long as [`Behaviour::misbehaviour`](crate::description::Behaviour::misbehaviour) is empty.
//! Each fault is small: it breaks one promise and leaves all others.

use isocat_wire::{AbortCode, AlState, AlStatusCode, Nanos, ObjectAddress};

/// Declares the vocabulary: what each word means, the word, and the fault with what it needs.
macro_rules! vocabulary {
    ($($(#[doc = $means:literal])+ $word:literal $fault:ident $(($($needs:ty),+))?,)+) => {
        /// One thing that a device does wrong.
        #[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
        pub enum Misbehaviour {
            $($(#[doc = $means])+ $fault $(($($needs),+))?,)+
        }

        impl Misbehaviour {
            /// The vocabulary: each word, and what it means.
            pub const WORDS: &'static [(&'static str, &'static str)] =
                &[$(($word, concat!($($means),+).trim_ascii()),)+];

            /// The word for it.
            pub const fn word(&self) -> &'static str {
                match self {
                    $(Self::$fault { .. } => $word,)+
                }
            }

            /// What a word means; `None`: it is none of the vocabulary.
            pub fn means(word: &str) -> Option<&'static str> {
                let mut words = Self::WORDS.iter();
                words.find(|(known, _)| *known == word).map(|(_, means)| *means)
            }
        }
    };
}

vocabulary! {
    /// The entry always reads this number; what the device goes by stays right.
    "wrong-value" WrongValue(ObjectAddress, u32),
    /// SDO information tells this type code for the entry.
    "wrong-type" WrongType(ObjectAddress, u16),
    /// The entry does not exist: not for SDOs, not for SDO information.
    "missing-entry" MissingEntry(ObjectAddress),
    /// The entry can't be written, and SDO information says so.
    "read-only" ReadOnly(ObjectAddress),
    /// Complete access to the object gives its bytes in wrong places.
    "shifted-complete-access" ShiftedCompleteAccess(u16),
    /// The entry can't be read in SAFEOP and OP, whatever its access word says.
    "refuses-read" RefusesRead(ObjectAddress),
    /// The entry can't be written in this state, whatever its access word says.
    "refuses-write" RefusesWrite(ObjectAddress, AlState),
    /// The entry can be written in every state, whatever its access word says.
    "accepts-write" AcceptsWrite(ObjectAddress),
    /// The entry takes this number, which it must refuse.
    "accepts-value" AcceptsValue(ObjectAddress, u32),
    /// Transfers of the entry that must fail with this code fail with the general error.
    "wrong-abort" WrongAbort(ObjectAddress, AbortCode),
    /// The sub-index of a sync object counts, but always reads 0.
    "frozen-counter" FrozenCounter(ObjectAddress),
    /// The sub-index of a sync object reads so much more than it counted, once it has counted.
    "wrong-counter" WrongCounter(ObjectAddress, u32),
    /// The counters are not cleared at PREOP to SAFEOP, nor on the way back.
    "keeps-counters" KeepsCounters,
    /// Sub-index 08, bit 1 clears nothing.
    "ignores-reset" IgnoresReset,
    /// The limit of missed events is so much higher than it says.
    "wrong-limit" WrongLimit(u16),
    /// 0x1C32:00 and 0x1C33:00 read 0 in SAFEOP and OP when the direction is not transmitted, but their
    /// sub-indices stay.
    "half-hidden" HalfHidden,
    /// The state is never entered (INIT: not from SAFEOP and OP): 0x0001.
    "refused-state" RefusedState(AlState),
    /// A set-up that must be refused with this code is accepted; with a number, only if register 0x0981
    /// has this value.
    "accepts-setup" AcceptsSetup(AlStatusCode, Option<u8>),
    /// What must be told by this code, in this state, is told as 0x0001.
    "wrong-al-code" WrongAlCode(AlStatusCode, AlState),
    /// The error with this code is not given up when it is acknowledged; INIT is the only way out.
    "keeps-error" KeepsError(AlStatusCode),
    /// A request is followed although the error was not acknowledged.
    "forgets-error" ForgetsError,
    /// Everything but the copying of outputs comes so much later.
    "late-application" LateApplication(Nanos),
    /// The copying of outputs begins so much later.
    "late-copy" LateCopy(Nanos),
    /// Every so many-th SM2 event goes by unnoticed.
    "missed-copy" MissedCopy(u32),
    /// At SYNC0 cycles shorter than this, every other SM2 event goes by unnoticed.
    "short-of-time" ShortOfTime(Nanos),
    /// SYNC0 is never noticed.
    "dead-sync0" DeadSync0,
    /// The shift time has no effect.
    "ignores-shift" IgnoresShift,
    /// Who does not choose a type gets SM-synchronous operation, whatever the SYNC unit is set to.
    "ignores-sync-unit" IgnoresSyncUnit,
    /// SAFEOP is entered without inputs in the buffer.
    "no-first-inputs" NoFirstInputs,
    /// The mailbox is answered so much later.
    "slow-mailbox" SlowMailbox(Nanos),
    /// SDO information is answered so: short (the headers alone), silent, garbage (another service), error
    /// (of the mailbox) or abort.
    "bad-information" BadInformation(BadAnswer),
    /// SDO transfers of the object are answered so: short, silent, garbage, error or abort.
    "bad-transfer" BadTransfer(u16, BadAnswer),
}

/// How a mailbox service is answered that is not answered right.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum BadAnswer {
    /// By the CoE header and four bytes, whatever must stand behind them.
    Short,
    /// Not at all.
    Silent,
    /// By a command that is no answer to this request.
    Garbage,
    /// By a mailbox error.
    Error,
    /// By an abort with the general code.
    Abort,
}

impl BadAnswer {
    /// All of them, each with its word.
    pub const WORDS: [(&'static str, Self); 5] = [
        ("short", Self::Short),
        ("silent", Self::Silent),
        ("garbage", Self::Garbage),
        ("error", Self::Error),
        ("abort", Self::Abort),
    ];
}

/// What a device does wrong, all in all: [`MOST`](Self::MOST) things. It is kept by value, so that a device can begin and end to
/// misbehave without memory of its own for it.
#[derive(Clone, Copy, Debug)]
pub struct Misbehaviours {
    /// Those behind `count` mean nothing.
    things: [Misbehaviour; Self::MOST],
    count: u8,
}

impl Misbehaviours {
    /// Most things that a device does wrong at a time. Without the feature `misbehaviour` it does none.
    pub const MOST: usize = if cfg!(feature = "misbehaviour") { 32 } else { 0 };
    /// It behaves.
    pub const NONE: Self = Self { things: [Misbehaviour::KeepsCounters; Self::MOST], count: 0 };

    /// These things; `None` if they are more than [`MOST`](Self::MOST).
    pub fn of(things: &[Misbehaviour]) -> Option<Self> {
        let mut all = Self::NONE;
        all.things.get_mut(..things.len())?.copy_from_slice(things);
        all.count = things.len() as u8;
        Some(all)
    }

    /// All of them, in the order in which they began.
    pub const fn all(&self) -> &[Misbehaviour] {
        self.things.split_at(self.count as usize).0
    }

    /// Begins to do something wrong; what is done already is the last from then on. Where there are [`MOST`](Self::MOST), the
    /// first one ends.
    pub fn begin(&mut self, how: Misbehaviour) {
        self.end(how);
        if self.all().len() == Self::MOST {
            let Some(first) = self.all().first() else { return };
            self.end(*first);
        }
        self.things[usize::from(self.count)] = how;
        self.count += 1;
    }

    /// Ends to do something wrong.
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

/// What a device does wrong. Empty for a device that behaves.
pub(crate) type Faults = [Misbehaviour];

/// The number that an entry reads instead of its own.
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

/// The abort code that is sent instead of the right one.
pub(crate) fn abort(faults: &Faults, address: ObjectAddress, code: AbortCode) -> AbortCode {
    if faults.contains(&WrongAbort(address, code)) { AbortCode::GENERAL } else { code }
}

/// The AL status code that is shown instead of the right one.
pub(crate) fn al_code(faults: &Faults, state: AlState, code: AlStatusCode) -> AlStatusCode {
    if faults.contains(&WrongAlCode(code, state)) { AlStatusCode::UNSPECIFIED } else { code }
}

/// Whether a set-up is accepted that must be refused with this code; `activation` is register 0x0981.
pub(crate) fn accepts(faults: &Faults, code: AlStatusCode, activation: u8) -> bool {
    faults.contains(&AcceptsSetup(code, None))
        || faults.contains(&AcceptsSetup(code, Some(activation)))
}

/// How transfers of an object are answered instead of right.
pub(crate) fn bad_transfer(faults: &Faults, index: u16) -> Option<BadAnswer> {
    number(faults, |fault| match *fault {
        BadTransfer(at, answer) if at == index => Some(answer),
        _ => None,
    })
}

/// How SDO information is answered instead of right.
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
        // One more: the first gives way. The same again: it is there once, as the last.
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

//! Misbehaviour: what devices do wrong, by name, so that a test of devices can prove that it sees it.
//!
//! A device behaves as long as [`Behaviour::misbehaviour`](crate::description::Behaviour::misbehaviour) is empty.
//! Each fault is small: it breaks one promise and leaves all others.

use isocat_wire::{AbortCode, AlState, AlStatusCode, Nanos, ObjectAddress};

/// One thing that a device does wrong.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Misbehaviour {
    /// The entry always reads this number; what the device goes by stays right.
    WrongValue(ObjectAddress, u32),
    /// SDO information tells this type code for the entry.
    WrongType(ObjectAddress, u16),
    /// The entry does not exist: not for SDOs, not for SDO information.
    MissingEntry(ObjectAddress),
    /// The entry can't be written, and SDO information says so.
    ReadOnly(ObjectAddress),
    /// Complete access to the object gives its bytes in wrong places.
    ShiftedCompleteAccess(u16),
    /// The entry can't be read in SAFEOP and OP, whatever its access word says.
    RefusesRead(ObjectAddress),
    /// The entry can't be written in this state, whatever its access word says.
    RefusesWrite(ObjectAddress, AlState),
    /// The entry can be written in every state, whatever its access word says.
    AcceptsWrite(ObjectAddress),
    /// The entry takes this number, which it must refuse.
    AcceptsValue(ObjectAddress, u32),
    /// Transfers of the entry that must fail with this code fail with the general error.
    WrongAbort(ObjectAddress, AbortCode),
    /// The sub-index of a sync object counts, but always reads 0.
    FrozenCounter(ObjectAddress),
    /// The sub-index of a sync object reads so much more than it counted, once it has counted.
    WrongCounter(ObjectAddress, u32),
    /// The counters are not cleared at PREOP to SAFEOP, nor on the way back.
    KeepsCounters,
    /// Sub-index 08, bit 1 clears nothing.
    IgnoresReset,
    /// The limit of missed events is so much higher than it says.
    WrongLimit(u16),
    /// 0x1C32:00 and 0x1C33:00 read 0 in SAFEOP and OP when the direction is not transmitted, but their
    /// sub-indices stay.
    HalfHidden,
    /// The state is never entered (INIT: not from SAFEOP and OP): 0x0001.
    RefusedState(AlState),
    /// A set-up that must be refused with this code is accepted; with a number, only if register 0x0981
    /// has this value.
    AcceptsSetup(AlStatusCode, Option<u8>),
    /// What must be told by this code, in this state, is told as 0x0001.
    WrongAlCode(AlStatusCode, AlState),
    /// The error with this code is not given up when it is acknowledged; INIT is the only way out.
    KeepsError(AlStatusCode),
    /// A request is followed although the error was not acknowledged.
    ForgetsError,
    /// Everything but the copying of outputs comes so much later.
    LateApplication(Nanos),
    /// The copying of outputs begins so much later.
    LateCopy(Nanos),
    /// Every so many-th SM2 event goes by unnoticed.
    MissedCopy(u32),
    /// At SYNC0 cycles shorter than this, every other SM2 event goes by unnoticed.
    ShortOfTime(Nanos),
    /// SYNC0 is never noticed.
    DeadSync0,
    /// The shift time has no effect.
    IgnoresShift,
    /// Who does not choose a type gets SM-synchronous operation, whatever the SYNC unit is set to.
    IgnoresSyncUnit,
    /// SAFEOP is entered without inputs in the buffer.
    NoFirstInputs,
    /// The mailbox is answered so much later.
    SlowMailbox(Nanos),
}

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

/// The first number that `of` finds.
pub(crate) fn number<T>(faults: &Faults, of: impl Fn(&Misbehaviour) -> Option<T>) -> Option<T> {
    faults.iter().find_map(of)
}

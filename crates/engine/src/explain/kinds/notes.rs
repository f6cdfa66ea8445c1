//! What to do about notes of plans and scans.

use crate::report::NoteKind;

/// By kind.
pub(super) fn change(kind: NoteKind) -> &'static [&'static str] {
    use NoteKind as K;
    match kind {
        K::NotRead | K::GivenUp => &["what the sentence names, then scan again"],
        K::WayDown => &["power-cycle the devices, or let their MainDevice bring them to INIT"],
        K::PortNotThere | K::LinkWithoutSignal => {
            &["cables and connectors at that port; the order of devices if ports are swapped"]
        }
        K::PortsSwapped => &[
            "swap its plugs: the cable that comes from the MainDevice belongs into the port IN (port 0); frames pass all the same, \
             and other MainDevices compute other delays",
        ],
        K::NoReceiveTimes | K::ReceiveTimesOnly | K::DelayUnknown => {
            &["a mode without DC for this device, or its delay measured by hand"]
        }
        K::NoTypes | K::TypesExcludeEachOther | K::TypesDisagree => {
            &["mode, to one that the maker's manual names; the device's firmware, if it is yours"]
        }
        K::FreeRunNotAnnounced | K::TypeNotAnnounced => &[
            "nothing before OP: the way up writes the type; the device's firmware, if it is yours",
        ],
        K::Alias => &["power-cycle the device: register 0x0012 is loaded from the EEPROM then"],
        K::TooFewSyncManagers | K::TooFewFmmus => {
            &["the assignment, to fewer areas; else the device can't run with all of them"]
        }
        K::SyncManagerUse | K::BeyondTheMemory | K::Overlap | K::MailboxArea => {
            &["the EEPROM, if it is yours (`isocat sii --from FILE --out OUT`); else ask the maker"]
        }
        K::EepromIncomplete => {
            &["the EEPROM, by the whole image: the maker's description has what is missing \
             (`isocat sii --from FILE --type TYPE --out OUT`)"]
        }
        K::OpModeWithoutClock | K::DcWithoutClock => {
            &["mode, to one without DC: the device has no clock to run by"]
        }
        K::NotReadable
        | K::Length
        | K::Missing
        | K::NoShift
        | K::ShiftReadOnly
        | K::ShiftReserved => {
            &["the device's firmware, if it is yours: `isocat conform` holds it against ETG.1020"]
        }
        K::CopyLongerThanCycle | K::MinimumCyclesDiffer | K::DelayBoth | K::DelayNotFixed => {
            &["the cycle, so long that the longer time fits; the device's firmware, if it is yours"]
        }
        K::ErrorBefore => {
            &["nothing, if it does not come back: `isocat explain` of its code says what it was"]
        }
        K::InUse => &["stop the other MainDevice first, if there is one"],
        K::NoIdentity => &["the EEPROM: a device without identity can't be told from others"],
        K::NoSyncObject => &[
            "the maker's manual, for the times of the device: `measured_times` and `calc_copy` state them",
        ],
        K::WindowNotMapped => {
            &["nothing, if your application does not use the registers of this window"]
        }
        K::NothingAssigned => &["0x1C12 and 0x1C13: the assignment, or the modules of the device"],
        K::Counted => &["nothing, if they do not grow: `isocat watch` shows whether they do"],
        K::NotStated => {
            &["the times from the maker's manual: calc_copy and delay beside the device state them"]
        }
        K::NoSync0Cycle => &["sync0_cycle beside the device"],
        K::Sync0InFrame => {
            &["shift in the head of the segment file: `isocat plan --suggest` names the best"]
        }
        K::FreeRunBySm => &["mode, to \"sm\", which is what the device does"],
        K::ShiftUnused => &["shift beside the device: without it, or a mode with SYNC"],
        K::MailboxNoRoom => &["cycle, to a longer one; or smaller mailboxes"],
        K::TwoPhases => {
            &["nothing, if the outputs may act at either; else SYNC1, which marks the bus cycle"]
        }
        K::TypeReadOnly => &["mode, to that of the device's own types"],
        K::OpmodeSyncOff | K::FirstOpmodeDcOff => {
            &["opmode, to one with SYNC; or mode, to one without"]
        }
    }
}

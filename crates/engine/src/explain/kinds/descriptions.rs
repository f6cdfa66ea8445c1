//! What to do about doubts in descriptions.

use isocat_descriptions::esi::WarningKind;
use isocat_segment::profile::{DoubtKind, Obstacle};
use isocat_sync::opmode;

/// About a description, by kind.
pub(super) fn esi(kind: WarningKind) -> &'static [&'static str] {
    use WarningKind as K;
    match kind {
        K::EncodingName | K::EncodingMismatch => &[
            "names that look garbled; the description's author should state the encoding of the bytes",
        ],
        K::NumberDoubledPrefix => {
            &["nothing: the number was read; the author should write one prefix"]
        }
        K::VendorNameMissing | K::GroupUnknown | K::PhysicsMissing => {
            &["nothing, if the devices have the ports and names that you expect"]
        }
        K::ReferencedFileNotRead => &[
            "esi = [\"first.xml\", \"second.xml\"] in the segment file, if the other file has modules",
        ],
        K::ProductCodeMissing => &["another Type of the file: this one is a placeholder"],
        K::RevisionMissing | K::IdentityRepeated => &[
            "the revision, or the product, in the segment file, compared with the real device (`isocat scan`)",
        ],
        K::PhysicsUnknown => &["the ports of the real device, if it is not the end of its line"],
        K::SeveralControllers => &["a [[subdevice]] for each further ESC of the box"],
        K::SyncManagerName | K::SyncManagerNameContradicts | K::SyncManagerWithoutControl => &[
            "compare with the SII of the real device: `isocat scan` shows the use of each SyncManager",
        ],
        K::SyncManagerEnable | K::SyncManagerOneBuffer => {
            &["compare the SyncManager with the real device's SII (`isocat scan`)"]
        }
        K::SyncManagerSize => &["nothing: the MainDevice writes the sum of the assigned PDOs"],
        K::SyncManagerVirtual => {
            &["nothing, if your application does not use the registers of this window"]
        }
        K::RegisterUnused => &[
            "what the register does in the device, in its manual: a MainDevice of its maker writes it",
        ],
        K::PdoSyncManager | K::PdoLeftOut | K::PdoRepeated => {
            &["the assigned PDOs (`isocat plan --start-up`), compared with the maker's manual"]
        }
        K::PdoExcluded => &["the assignment: one of both PDOs, by an OpMode that has it"],
        K::PdoEntryPadded => &["nothing: the process image keeps the place of the entry"],
        K::ProcessDataMissing => &[
            "the modules of the device (`modules` in the segment file), or an OpMode that assigns PDOs",
        ],
        K::MailboxWithoutSyncManagers => {
            &["nothing: without its SyncManagers the mailbox is not used"]
        }
        K::MailboxProtocol => {
            &["nothing for synchronization; the virtual device answers with the protocol's error"]
        }
        K::DictionaryMissing | K::DictionaryFile => &[
            "times and types of 0x1C32 and 0x1C33 from the real device: `isocat profile` of a scan has them, \
             `calc_copy` and `delay` in the segment file state single ones",
        ],
        K::ObjectLeftOut | K::ObjectItemsByOrder | K::DataTypeUnknown => &[
            "nothing, unless your application reads or writes the object: then compare with the real device",
        ],
        K::DefaultLeftOut | K::DefaultLength => &[
            "the value on the real device, if the object matters: 0x1C32 and 0x1C33 do (`isocat scan`)",
        ],
        K::FirstOpModeWithoutDc => {
            &["opmode in the segment file, if the device shall run with SYNC"]
        }
        K::OpModeNameRepeated => &["opmode as a number: both have this name"],
        K::AssignActivateMissing => {
            &["opmode in the segment file: another OpMode, if the device shall run with SYNC"]
        }
        K::AssignActivateUnusual | K::Sync1Alone => &[
            "`isocat explain AssignActivate WORD` takes the word apart; ask the maker if the device stays below OP",
        ],
        K::Sync0CycleMissing => &["nothing, if SYNC0 once per bus cycle is right for the device"],
        K::Sync0CycleFixed => {
            &["the cycle, to one that the OpMode takes: `isocat plan --suggest` tries no others"]
        }
        K::Sync0CycleTwice => &["nothing: TwinCAT's rule is followed, the time counts"],
        K::Sync0CycleShort => &["the cycle: few devices follow a SYNC0 that fast"],
        K::Sync1Unused => &["nothing: SYNC1 stays off"],
        K::ShiftTimeHuge => &["nothing: what counts is the shift within a cycle"],
        K::OpModeObsolete => &["mode in the segment file: the old form states no AssignActivate"],
        K::DictionaryWithoutDc => &[
            "nothing on a real device, which states its own types; the virtual one takes those of the OpMode",
        ],
        K::SlotModuleAssumed | K::SlotModuleMissing => &[
            "modules in the segment file: `isocat devices FILE --modules` lists what each slot takes",
        ],
        K::ModuleIndexRepeated | K::PdoGroupUnaligned => &[
            "the order of the modules, compared with the real device's assignment (`isocat scan`)",
        ],
        K::ModulesTooLarge => &["fewer modules"],
        K::EepromMissing | K::ConfigDataLength => {
            &["sii in the segment file: the content of the real device's EEPROM"]
        }
        K::ElementUnknown => &["nothing: the element is not of synchronization"],
    }
}

/// About a device made of a description, by kind.
pub(super) fn doubt(kind: DoubtKind) -> &'static [&'static str] {
    use DoubtKind as K;
    match kind {
        K::Description(kind) => esi(kind),
        K::Pulses(kind) => pulses(kind),
        K::Revision => {
            &["revision in the segment file, compared with the real device (`isocat scan`)"]
        }
        K::OpMode => &["opmode in the segment file: `isocat devices FILE` lists them"],
        K::Mode => &["opmode, to one that stands for the mode; or no mode, for that of the OpMode"],
        K::ModuleOpMode => &["opmode, to one of those that the modules name; or other modules"],
        K::DriveNotEnabled => &[
            "an OpMode or PDOs with control word, target position, status word and actual position",
        ],
        K::Sii | K::SiiRevision => &["the EEPROM file, if it is not that of this device"],
        K::SyncModeNotStated => {
            &["mode in the segment file: \"sm\" or \"free-run\", as the maker's manual says"]
        }
        K::ShiftTimeSync0 => {
            &["shift in the head of the segment file, if the maker insists on this shift"]
        }
        K::Sync0Added => {
            &["nothing, if the device comes up; ask the maker if it refuses SAFEOP with 0x0030"]
        }
        K::Oversampling => &["the OpMode, if the samples of a cycle shall be taken by SYNC0"],
        K::InitCommandLeftOut => &["what it sets, by your application, if the device needs it"],
        K::InitCommandObject => &["nothing: a real device has the object, if its maker writes it"],
        K::CycleParameter => &["nothing: the drive needs the cycle that it really gets"],
        K::AlEventAdded => &["nothing: it is about the virtual device alone"],
        K::WindowNotMapped => {
            &["nothing, if your application does not use the registers of this window"]
        }
    }
}

/// About the pulses of an OpMode, by kind.
pub(super) fn pulses(kind: opmode::WarningKind) -> &'static [&'static str] {
    use opmode::WarningKind as K;
    match kind {
        K::SyncOff => &["opmode, to one with SYNC, if the device shall run with SYNC"],
        K::NotActivated | K::NoPulses | K::ClockOnly => {
            &["opmode: another one, if the device shall run with SYNC; this one makes no pulses"]
        }
        K::UnitAtPdi => {
            &["nothing on a real device, which sets up the unit itself; a virtual one can't run it"]
        }
        K::ReservedBits => &["ask the maker: `isocat explain AssignActivate WORD` names the bits"],
        K::Sync0Undefined | K::NegativeSync0 => {
            &["nothing, if SYNC0 once per bus cycle is right for the device"]
        }
        K::Sync0ValueAndFactor | K::Sync1ValueAndFactor | K::Sync1FixedAndShift => {
            &["nothing, if the time that counts is the one that the maker means"]
        }
        K::BelowLeast => &["the cycle, to a longer one"],
        K::BrokenPart | K::Sync0OffBus | K::PeriodOffBus | K::FixedSync0 => {
            &["the cycle, to one that the OpMode takes: `isocat plan --suggest` tries no others"]
        }
        K::SlowerThanBus => &["cycle beside the device: as long as its SYNC0"],
        K::FasterThanBus => &["opmode, to one with SYNC1, which marks the bus cycle"],
        K::Sync1Unused => &["nothing: SYNC1 stays off"],
        K::Sync1Alone => {
            &["nothing, if the device comes up; ask the maker if it refuses SAFEOP with 0x0030"]
        }
        K::Sync1Undefined | K::NegativeSync1 => {
            &["sync1 beside the device, if SYNC1 shall come later"]
        }
        K::Sync1BeforeSync0 | K::Sync1Period => {
            &["the cycle, if the wanted period follows from it; else ask the maker what is meant"]
        }
        K::PulsesCoincide => &["nothing: a device that acts on SYNC0 needs no SYNC1"],
        K::OffTick => &["the cycle, to a multiple of 10 ns times the parts of it"],
        K::LongShift => &["nothing: what counts is the shift within a cycle"],
    }
}

/// About what can't be simulated.
pub(super) fn obstacle(kind: Obstacle) -> &'static [&'static str] {
    match kind {
        Obstacle::Placeholder => &["type: another one of the file"],
        Obstacle::SeveralSyncManagers => {
            &["opmode, to one that assigns no PDOs to these SyncManagers"]
        }
        Obstacle::TooManyEntries | Obstacle::TooLarge | Obstacle::ProcessDataTooLong => &[
            "opmode or modules, to ones with less; a real device runs all the same (`run --interface`)",
        ],
        Obstacle::ProcessDataInRegisters => {
            &["nothing: a real device runs all the same (`run --interface`)"]
        }
        Obstacle::MailboxArea | Obstacle::MemoryOverlap => &[
            "the description, if it is yours; compare with the SII of the real device (`isocat scan`)",
        ],
        Obstacle::Sync0Cycle => {
            &["cycle: the message names those that the OpMode takes; or opmode"]
        }
        Obstacle::SyncUnitAtPdi => &["opmode, to one whose SYNC unit the MainDevice sets up"],
    }
}

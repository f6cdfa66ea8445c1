//! The objects of synchronization: 0x1C00, 0x1C12, 0x1C13, 0x1C32, 0x1C33, 0x10F1, and 0x10F4 and
//! 0x10F5 of devices that join two segments; of other objects those that are set or read with them.

use isocat_wire::ObjectAddress;

use super::{Entry, entry};
use crate::object::{
    ERROR_SETTINGS, INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER,
    SM_COMMUNICATION_TYPE, name, sub,
};

/// The objects that [`object`] knows.
pub const OBJECTS: [u16; 8] = [
    SM_COMMUNICATION_TYPE,
    OUTPUT_ASSIGNMENT,
    INPUT_ASSIGNMENT,
    OUTPUT_PARAMETER,
    INPUT_PARAMETER,
    ERROR_SETTINGS,
    EXTERNAL_STATUS,
    EXTERNAL_SETTINGS,
];

/// External synchronization, status: the device that joins two segments maps it into a TxPDO.
const EXTERNAL_STATUS: u16 = 0x10F4;
/// External synchronization, settings.
const EXTERNAL_SETTINGS: u16 = 0x10F5;

/// Messages that the device keeps.
const DIAGNOSIS_HISTORY: u16 = 0x10F3;
/// CiA 402: the last error.
const ERROR_CODE: u16 = 0x603F;
/// CiA 402: the time from one set point to the next.
const INTERPOLATION_TIME: u16 = 0x60C2;

/// Name and meaning of a whole object.
pub fn object(index: u16) -> Option<(&'static str, &'static Entry)> {
    Some(match index {
        SM_COMMUNICATION_TYPE => ("SyncManager communication type", &COMMUNICATION_TYPE),
        OUTPUT_ASSIGNMENT => ("PDO assignment of SM2, outputs", &ASSIGNMENT),
        INPUT_ASSIGNMENT => ("PDO assignment of SM3, inputs", &ASSIGNMENT),
        OUTPUT_PARAMETER => ("SM output parameter", &OUTPUTS),
        INPUT_PARAMETER => ("SM input parameter", &INPUTS),
        ERROR_SETTINGS => ("error settings", &ERRORS),
        EXTERNAL_STATUS => ("external synchronization status", &EXTERNAL),
        EXTERNAL_SETTINGS => ("external synchronization settings", &EXTERNAL_SET),
        DIAGNOSIS_HISTORY => ("diagnosis history", &HISTORY),
        0x1600..=0x17FF => ("PDO mapping, outputs (RxPDO)", &MAPPING),
        0x1A00..=0x1BFF => ("PDO mapping, inputs (TxPDO)", &MAPPING),
        ERROR_CODE => ("error code of the drive", &DRIVE_ERROR),
        INTERPOLATION_TIME => ("interpolation time period", &INTERPOLATION),
        _ => return None,
    })
}

/// Name and meaning of one entry; sub-index 0 gives those of [`object`]. `None` if the entry does
/// not exist or is not described here.
pub fn sub_index(object: ObjectAddress) -> Option<(&'static str, &'static Entry)> {
    let ObjectAddress { index, sub } = object;
    match (index, sub) {
        (_, 0) => self::object(index),
        (SM_COMMUNICATION_TYPE, 1..=32) => Some(("use of a SyncManager", &COMMUNICATION_TYPE)),
        (OUTPUT_ASSIGNMENT | INPUT_ASSIGNMENT, 1..=254) => Some(("an assigned PDO", &ASSIGNMENT)),
        (INPUT_PARAMETER, sub::MINIMUM_DELAY_TIME | 0x0F..=0x12) => Some(("reserved", &RESERVED)),
        (OUTPUT_PARAMETER | INPUT_PARAMETER, sub) => {
            let at = SUBS.iter().position(|(found, ..)| *found == sub)?;
            let (_, outputs, inputs) = &SUBS[at];
            let entry = if index == OUTPUT_PARAMETER { outputs } else { inputs };
            Some((name(sub)?, entry))
        }
        (ERROR_SETTINGS, 1) => Some(("local error reaction", &REACTION)),
        (ERROR_SETTINGS, 2) => Some(("sync error counter limit", &LIMIT)),
        (0x1600..=0x17FF | 0x1A00..=0x1BFF, 1..=254) => Some(("a mapped entry", &MAPPING)),
        (DIAGNOSIS_HISTORY, 1..=255) => Some(("diagnosis history", &HISTORY)),
        (INTERPOLATION_TIME, 1) => Some(("interpolation time, value", &INTERPOLATION)),
        (INTERPOLATION_TIME, 2) => Some(("interpolation time, power of ten", &INTERPOLATION)),
        (EXTERNAL_STATUS, 1) => Some(("sync mode", &EXTERNAL_MODE)),
        (EXTERNAL_STATUS, 14) => Some(("control value update toggle", &EXTERNAL_TOGGLE)),
        (EXTERNAL_STATUS, 15) => Some(("time stamp update toggle", &EXTERNAL_TOGGLE)),
        (EXTERNAL_STATUS, 16) => Some(("external device not connected", &EXTERNAL_ABSENT)),
        (EXTERNAL_STATUS, 17) => Some(("internal time stamp", &EXTERNAL_STAMPS)),
        (EXTERNAL_STATUS, 18) => Some(("external time stamp", &EXTERNAL_STAMPS)),
        (EXTERNAL_STATUS, 19) => Some(("control value for the reference clock", &EXTERNAL_CONTROL)),
        (EXTERNAL_SETTINGS, 1) => Some(("sync master", &EXTERNAL_SET)),
        (EXTERNAL_SETTINGS, 2) => Some(("32 bit time stamps", &EXTERNAL_SET)),
        (EXTERNAL_SETTINGS, 17) => Some(("control interval, ms", &EXTERNAL_SET)),
        (EXTERNAL_SETTINGS, 18) => Some(("additional system time", &EXTERNAL_SET)),
        _ => None,
    }
}

/// Meaning of each set bit of sub-index 04, from bit 0 on; bits 6:5 are read together.
pub const SUPPORTED_BITS: [&str; 16] = [
    "Free Run",
    "SM-synchronous: with SM2; inputs without outputs with SM3",
    "DC with SYNC0",
    "DC with SYNC1",
    "DC with subordinated cycles: SYNC0 several times in a cycle of SYNC1",
    "shift by a local timer (with bit 6 clear): :03 is writable",
    "shift by SYNC1 (with bit 5 clear)",
    "reserved",
    "reserved",
    "reserved; older stacks: delay times should be measured",
    "delay times depend on the configuration and should be measured (:08)",
    "delay times are fixed, the hardware synchronizes; then :07 equals :09",
    "reserved",
    "reserved",
    "dynamic times: :05, :06, :09 may read 0 and are measured in OP by :08",
    "reserved; set in many device descriptions, it means nothing",
];

/// Values of sub-index 04 that are so common that a bare number probably means this sub-index.
pub const COMMON_SUPPORTED: [u16; 20] = [
    0x0005, 0x0007, 0x000A, 0x000B, 0x000F, 0x0017, 0x001C, 0x001F, 0x0027, 0x040B, 0x0427, 0x0804,
    0x0806, 0x080F, 0x0C07, 0x4001, 0x440B, 0x8007, 0xC003, 0xC007,
];

static COMMUNICATION_TYPE: Entry = entry(
    "What each SyncManager is for: sub-index n+1 speaks of SM n. 0 unused, 1 mailbox out, 2 \
     mailbox in, 3 outputs, 4 inputs.",
    &[],
    &["0x0800 + 8 n: how the SyncManager is set"],
    &["nothing: it is read only, and control bytes must agree with it"],
);
static ASSIGNMENT: Entry = entry(
    "Which PDOs the SyncManager carries, in this order. Sub-index 0 is their number, each other \
     one the index of a PDO: 0x16xx for outputs, 0x1Axx for inputs.",
    &[],
    &["the mapping objects it names: their lengths add up to the SyncManager's length"],
    &["in PREOP: 0 to sub-index 0, then the PDOs, then their number; read back. Some devices \
         have it fixed"],
);
static MAPPING: Entry = entry(
    "What a PDO is made of: sub-index 0 is the number of entries, each other one 0xIIIISSLL, \
         index, sub-index and length in bits of an object. 0x1600 and on are outputs, 0x1A00 and \
         on inputs.",
    &[
        "a write is refused: the mapping is fixed, the PDO is still assigned, or the state is not \
             PREOP",
        "the object does not exist: the device has its PDOs in the SII alone",
    ],
    &["0x1C12 and 0x1C13: which PDOs are assigned", "the lengths of SM2 and SM3 against their sum"],
    &["in PREOP: 0 to sub-index 0 of the assignment and of the mapping, then entries, then their \
         number"],
);
static INTERPOLATION: Entry = entry(
    "The time from one set point to the next, by which a drive interpolates: :01 (u8) x 10 to the \
     power of :02 (i8) seconds. It must be the cycle at which set points come.",
    &[
        "longer or shorter than the cycle: the drive hums, clicks or vibrates, with a following \
             error",
        "a start-up list that was made for another cycle",
        "a write is refused: the drive takes SYNC0's cycle by itself, or does not take this value",
    ],
    &["0x09A0 and 0x1C32:02: the cycle of SYNC0", "0x6060 and 0x6061: the mode of operation"],
    &["the bus cycle, in PREOP: 1 ms is :01 = 1, :02 = -3; 500 us is :01 = 5, :02 = -4; 250 us \
             is :01 = 25, :02 = -5"],
);
static DRIVE_ERROR: Entry = entry(
    "The last error of a drive, u16, by CiA 402; the maker's own number is often elsewhere. 0x8700 \
     is the sync controller, 0xFFxx the maker's.",
    &["a fault of drive, motor or supply", "a lost synchronization or link, in the drive's words"],
    &["0x1001 and 0x10F3", "0x0134: the AL status code that belongs to it"],
    &["what the maker's manual says; communication faults first by 0x0134"],
);
static HISTORY: Entry = entry(
    "Messages that the device keeps about its errors, newest by :02, with a time stamp and a text \
     number of the maker.",
    &[],
    &["the text of a number in the device's description (ESI)", "0x603F and 0x1001"],
    &["nothing: read it before power is switched off"],
);
static OUTPUTS: Entry = entry(
    "How the device's outputs are synchronized: the mode, the times that a plan of the cycle \
     needs, and the counters that tell whether it is kept. `isocat explain modes` lists what each \
     mode needs of it.",
    &[],
    &[":04 what it can do, :01 what it does", ":05, :06, :09 for the plan", ":0B, :0C, :20 in OP"],
    &[":01 in PREOP, if the device lets it be written; else the SYNC unit decides"],
);
static INPUTS: Entry = entry(
    "How the device's inputs are synchronized: the same entries as in 0x1C32, for Input Latch \
     instead of Outputs Valid.",
    &[],
    &[
        ":04 what it can do, :01 what it does",
        ":06 until inputs are in their buffer",
        ":0B, :20 in OP",
    ],
    &[":01 in PREOP, together with 0x1C32:01: 2 with 2, 3 with 2 or 3, 0x22 with 1"],
);
static ERRORS: Entry = entry(
    "How the device reacts to errors of its own and to missed events.",
    &[],
    &[":02 how many misses it bears"],
    &[":02 in PREOP, if the process allows more or fewer misses"],
);
static REACTION: Entry = entry(
    "What the device does on a local error: 0 nothing, 1 as it leaves OP; others are the maker's.",
    &[],
    &["the maker's manual"],
    &["as the process needs it"],
);
static LIMIT: Entry = entry(
    "When this is reached by the missed events, the device leaves OP with 0x001A. A miss adds 3 \
     and a good event takes 1 away in most devices, so 4 (a usual value) bears one miss and falls \
     at the second or third in a row.",
    &[],
    &["0x1C32:0B: how near it came"],
    &["a higher limit where late frames are not worth a stop; 16 bits, 32 in older stacks"],
);
static RESERVED: Entry = entry(
    "Reserved in 0x1C33: the entry of 0x1C32 counts. Some devices show a value all the same.",
    &[],
    &["the same sub-index of 0x1C32"],
    &["nothing"],
);

/// Sub-index, its explanation in 0x1C32, and its explanation in 0x1C33.
static SUBS: [(u8, Entry, Entry); 19] = [
    (sub::SYNC_TYPE, SYNC_TYPE_OUT, SYNC_TYPE_IN),
    (sub::CYCLE_TIME, CYCLE_TIME, CYCLE_TIME),
    (sub::SHIFT_TIME, SHIFT_OUT, SHIFT_IN),
    (sub::SUPPORTED_TYPES, SUPPORTED, SUPPORTED),
    (sub::MINIMUM_CYCLE_TIME, MINIMUM_CYCLE, MINIMUM_CYCLE),
    (sub::CALC_AND_COPY_TIME, COPY_OUT, COPY_IN),
    (sub::MINIMUM_DELAY_TIME, MINIMUM_DELAY, MINIMUM_DELAY),
    (sub::GET_CYCLE_TIME, GET_CYCLE, GET_CYCLE),
    (sub::DELAY_TIME, DELAY_OUT, DELAY_IN),
    (sub::SYNC0_CYCLE_TIME, SYNC0_CYCLE, SYNC0_CYCLE),
    (sub::SM_EVENT_MISSED, MISSED, MISSED),
    (sub::CYCLE_TIME_TOO_SMALL, TOO_SMALL, TOO_SMALL),
    (sub::SHIFT_TIME_TOO_SHORT, TOO_SHORT_OUT, TOO_SHORT_IN),
    (sub::TOGGLE_FAILED, TOGGLE, TOGGLE),
    (sub::MINIMUM_CYCLE_DISTANCE, CYCLE_DISTANCE, RESERVED_ENTRY),
    (sub::MAXIMUM_CYCLE_DISTANCE, CYCLE_DISTANCE, RESERVED_ENTRY),
    (sub::MINIMUM_SM_SYNC_DISTANCE, SYNC_DISTANCE, RESERVED_ENTRY),
    (sub::MAXIMUM_SM_SYNC_DISTANCE, SYNC_DISTANCE, RESERVED_ENTRY),
    (sub::SYNC_ERROR, SYNC_ERROR, SYNC_ERROR),
];

const SYNC_TYPE_OUT: Entry = entry(
    "What the outputs are synchronized with, u16: 0 nothing (Free Run), 1 SM2, 2 SYNC0, 3 SYNC1.",
    &[
        "reads 1 though DC was meant: 0x0981 was written after SAFEOP, so the device chose before",
        "reads 0: it was never written and no SYNC unit runs",
    ],
    &[":04 for what may be written", "0x1C33:01", "0x0981: the SYNC unit must agree"],
    &["write it in PREOP and read it back in SAFEOP; some devices take it from 0x0981 alone"],
);
const SYNC_TYPE_IN: Entry = entry(
    "What the inputs are synchronized with, u16: 0 nothing (Free Run), 1 SM3 (without outputs), 2 \
     SYNC0, 3 SYNC1, 0x22 SM2 (with outputs).",
    &["0x06090030 on writing 1: a device with outputs takes 0x22"],
    &[":04 for what may be written", "0x1C32:01"],
    &["write it in PREOP, together with 0x1C32:01"],
);
const CYCLE_TIME: Entry = entry(
    "Cycle time, u32 ns. Free Run: the local timer's; SM-synchronous: from frame to frame; DC: a \
     copy of 0x09A0.",
    &["0x06090032 on writing: below :05"],
    &["0x09A0", ":05"],
    &["the bus cycle, where it is writable"],
);
const SHIFT_OUT: Entry = entry(
    "From the acting event (SYNC0, or SM2) to Outputs Valid, u32 ns. At least :09.",
    &[],
    &[
        ":04 bits 6:5: only 01 (local timer) makes it writable",
        ":0D counts what came too late for it",
    ],
    &["as large as the slowest device's, so that all outputs act together"],
);
const SHIFT_IN: Entry = entry(
    "From the acting event (SYNC0, or SM2) to Input Latch, u32 ns. At least :09.",
    &[],
    &[
        ":04 bits 6:5: only 01 (local timer) makes it writable",
        ":06: it must still fit before the next frame",
    ],
    &["larger for fresher inputs, as long as :03 + :06 end before the frame that fetches them"],
);
const SUPPORTED: Entry = entry(
    "What the device can do, u16, a bit each; `isocat explain SI4 0x0427` takes a value apart.",
    &[],
    &["both objects: a mode must be in both"],
    &["nothing: it is read only. In device descriptions it is often a generator's text: believe \
         the device"],
);
const MINIMUM_CYCLE: Entry = entry(
    "The shortest cycle that the device can do, u32 ns. 0: not known, or to be measured (:04 bit \
     14).",
    &[],
    &[":08 to have it measured", ":0C counts cycles that were too short"],
    &["a cycle of at least this; SM-synchronous: and the host's jitter on top"],
);
const COPY_OUT: Entry = entry(
    "What the device needs to take the outputs over and calculate, u32 ns: from the SM2 event \
     until SYNC0 may come (with SYNC1: from SYNC0 to SYNC1).",
    &[],
    &[":0B and :0C if it was not kept", "the arrival of the frame at this device"],
    &["SYNC0 at least arrival + host's jitter + this behind the cycle's beginning"],
);
const COPY_IN: Entry = entry(
    "From Input Latch until the inputs stand in the buffer of SM3, u32 ns.",
    &[],
    &["when the frame fetches the inputs"],
    &["Input Latch at least this before the frame; else inputs are a cycle old"],
);
const MINIMUM_DELAY: Entry = entry(
    "The least hardware delay from the acting event to Outputs Valid, u32 ns; :09 is the greatest.",
    &[],
    &[":09: the difference is the device's own jitter"],
    &["nothing: it is read only"],
);
const GET_CYCLE: Entry = entry(
    "A command, u16: bit 0 starts the measurement of :05, :06 and :09, bit 1 resets the error \
     counters :0B to :0E and :20.",
    &[],
    &[":05, :06, :09 after some seconds in OP"],
    &["write 1 in OP, wait, read, write 0; in 0x1C32 and 0x1C33"],
);
const DELAY_OUT: Entry = entry(
    "Hardware delay from the acting event to Outputs Valid, u32 ns: the greatest where :07 is \
         used.",
    &[],
    &[":03: must not be below"],
    &["nothing: it is read only; take it into account where outputs of several devices must act \
         together"],
);
const DELAY_IN: Entry = entry(
    "Hardware delay from the acting event to Input Latch, u32 ns. It counts where SYNC1 takes the \
     inputs of outputs that act at SYNC0 (dc-shift-sync1): the latch comes this long behind SYNC1. \
     In the other modes inputs are latched at the pulse itself, or after the shift of :03.",
    &[],
    &[":03: must not be below"],
    &["nothing: it is read only"],
);
const SYNC0_CYCLE: Entry = entry(
    "The fixed SYNC0 cycle that the application needs with subordinated cycles, u32 ns. Many \
     stacks show 0x09A0 here.",
    &[],
    &["0x09A0"],
    &["0x09A0 = this; SYNC1 once in a bus cycle"],
);
const MISSED: Entry = entry(
    "SM event missed, u16: SYNC0 came and no new frame had. In many devices it is no count but a \
     filter: a miss adds 3, a good cycle takes 1 away; at 0x10F1:02 the device leaves OP.",
    &[
        "frame late or lost in that cycle",
        "frame and SYNC0 too close: both orders occur",
        "the host's cycle is not locked onto the reference clock: it grows steadily, then rests, \
         and again",
        "the device runs faster than the bus (several SYNC0 in a cycle)",
    ],
    &[
        "0x10F1:02: the limit",
        ":0C at the same time: then the device is late, not the frame",
        "0x0990 against the arrival of the frame",
        "0x0300 to 0x0313: link errors",
    ],
    &[
        "SYNC0 further behind the frame: arrival + jitter + :06",
        "lock the host onto the reference clock",
        "a quieter host: real-time priority, a CPU of its own, no power saving",
    ],
);
const TOO_SMALL: Entry = entry(
    "Cycle time too small (cycle exceeded), u16: the device had not finished its cycle when the \
     next event came.",
    &[
        "the cycle is shorter than what the device needs, :05",
        "two frames in a cycle, or frames in bursts after a stall of the host",
        "SYNC0 comes before outputs are ready: less than :06 behind the frame",
    ],
    &[":05 and :06, measured by :08", "0x09A0"],
    &["a longer cycle", "SYNC0 further behind the frame", "fewer PDOs"],
);
const TOO_SHORT_OUT: Entry = entry(
    "Shift time too short, u16: outputs were not ready when they should have become valid.",
    &[":03 below what the device needs", "SYNC1 too close behind SYNC0, below :06"],
    &[":03, :09", "0x09A4"],
    &["a larger :03 or 0x09A4"],
);
const TOO_SHORT_IN: Entry = entry(
    "Shift time too short, u16: the device could not take the inputs at the instant of :03.",
    &[":03 below what the device needs"],
    &[":03, :09", "0x09A4"],
    &["a larger :03 or 0x09A4"],
);
const TOGGLE: Entry = entry(
    "RxPDO toggle failed, u16: the toggle bit in the outputs did not change, so the MainDevice's \
     application sent old values.",
    &["the application is slower than the bus cycle, or does not toggle the bit"],
    &["the mapped toggle bit"],
    &["let the application write outputs in each cycle"],
);
const CYCLE_DISTANCE: Entry = entry(
    "The least (:0F) and greatest (:10) time between two SM2 events that the device saw, u32 ns: \
     their difference is the jitter of frames.",
    &[],
    &[":11 and :12", "0x09A0 or the bus cycle: the mean must be that"],
    &["nothing: it is read only. A greatest of two cycles is a lost frame"],
);
const SYNC_DISTANCE: Entry = entry(
    "The least (:11) and greatest (:12) time from an SM2 event to the SYNC0 behind it that the \
     device saw, u32 ns.",
    &[],
    &[":06: the least must not be below"],
    &["shift SYNC0 by what is missing"],
);
const SYNC_ERROR: Entry = entry(
    "Sync error, one bit: 1 while the device counts itself out of synchronization. It can be \
     mapped into a TxPDO.",
    &["the missed events reached the limit", "the cycle was too short (:0C above 0)"],
    &[":0B, :0C, :0D", "0x10F1:02"],
    &["as :0B; reset it by :08 bit 1"],
);
const EXTERNAL: Entry = entry(
    "Status of a device that joins this segment to another clock, such as a bridge between two \
     segments: which side leads, and one pair of time stamps of both clocks (192 bits in a TxPDO).",
    &[],
    &[":10 (16): whether the other side is there", ":11 and :12 (17, 18): the pair of time stamps"],
    &["nothing: it is read only"],
);
const EXTERNAL_SET: Entry = entry(
    "Settings of external synchronization: which side leads, the width of time stamps, the control \
     interval in ms, and a system time to be added (112 bits).",
    &[],
    &["0x10F4: what comes of it"],
    &["write it before SAFEOP; some revisions allow sub-index 18 alone"],
);
const EXTERNAL_MODE: Entry = entry(
    "Which side leads, 2 bits: 0 none, 1 this device or the secondary side, 2 the primary side.",
    &[],
    &["0x10F5:01: the setting"],
    &["0x10F5:01"],
);
const EXTERNAL_TOGGLE: Entry = entry(
    "One bit that changes with each new value: the value is taken at a change.",
    &["a toggle that rests: the other side stands still or is not connected"],
    &[":10 (16)"],
    &["nothing: it is read only"],
);
const EXTERNAL_ABSENT: Entry = entry(
    "One bit: 1 while the external device is not connected or its time stamps are not valid.",
    &["the cable to the other side", "the other side is not in operation"],
    &["the working counter of the other segment's frames"],
    &["bring the other side up; until then the time stamps are not to be used"],
);
const EXTERNAL_STAMPS: Entry = entry(
    "One half of a pair of time stamps of the same instant: 17 by this segment's system time, 18 \
         by the other clock, u64 ns. Their difference is the offset between the clocks.",
    &[],
    &[":0F (15): the toggle, for a pair that belongs together"],
    &["nothing: it is read only. The side that follows steers its reference clock by the \
             difference"],
);
const EXTERNAL_CONTROL: Entry = entry(
    "How often the reference clock is to be written higher (above 0) or lower (below 0) than it \
     stands, i32: a proposal for the side that follows.",
    &[],
    &[":0E (14): the toggle"],
    &["nothing: it is read only"],
);
const RESERVED_ENTRY: Entry = entry("Reserved in 0x1C33.", &[], &[], &[]);

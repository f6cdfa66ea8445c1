//! AssignActivate words: what each bit does, and what a word is used for.

use isocat_wire::dc::AssignActivate;

use super::{Entry, entry};

/// The bits that are set in a word: number and effect, lowest first.
pub fn bits(word: AssignActivate) -> impl Iterator<Item = (u8, &'static str)> {
    BITS.into_iter().filter(move |(bit, _)| word.0 >> bit & 1 == 1)
}

/// What a word is used for, by the signals it makes.
pub fn explain(word: AssignActivate) -> &'static Entry {
    let asked = word.activation().sync0() || word.activation().sync1();
    if word.unit_at_pdi() {
        return &AT_PDI;
    }
    match (word.activates(), word.makes_sync0(), word.makes_sync1()) {
        (false, ..) if asked => &NOT_ACTIVATED,
        (false, ..) if word.latch0_at_pdi() || word.latch1_at_pdi() => &LATCH_ONLY,
        (false, ..) => &OFF,
        (true, false, false) => &UNIT_ONLY,
        (true, true, false) => &SYNC0,
        (true, true, true) => &BOTH,
        (true, false, true) => &SYNC1,
    }
}

/// Words in published device descriptions, the most frequent first.
pub const KNOWN: [u16; 12] = [
    0x0300, 0x0700, 0x0000, 0x0730, 0x0320, 0x0720, 0x0310, 0x0330, 0x0301, 0x0100, 0x0500, 0x0030,
];

const BITS: [(u8, &str); 16] = [
    (0, "the SYNC unit belongs to the PDI: the device programs it"),
    (1, "means nothing"),
    (2, "means nothing"),
    (3, "means nothing"),
    (4, "latch unit 0 belongs to the PDI"),
    (5, "latch unit 1 belongs to the PDI"),
    (6, "means nothing"),
    (7, "means nothing"),
    (8, "the SYNC unit is on (0x0981 bit 0)"),
    (9, "SYNC0 is made (0x0981 bit 1)"),
    (10, "SYNC1 is made (0x0981 bit 2)"),
    (11, "the unit switches itself on when the start time is written (0x0981 bit 3)"),
    (12, "a start time of 32 bits is extended (0x0981 bit 4)"),
    (13, "starts at once if the start time is not in the near future (0x0981 bit 5)"),
    (14, "the near future is about 2.1 s (0x0981 bit 6)"),
    (15, "one test pulse (0x0981 bit 7)"),
];

static OFF: Entry = entry(
    "The SYNC unit stays off: Free Run or SM-synchronous. The device description does not say \
     which; 0x1C32:01 does.",
    &[],
    &["0x1C32:04: which of both it can"],
    &["write 0 to 0x0980 and 0x0981, and 0 or 1 to 0x1C32:01"],
);
static LATCH_ONLY: Entry = entry(
    "No pulses; the device's processor uses the latch units.",
    &[],
    &["0x0980"],
    &["write the word as it is; nothing cyclic"],
);
static NOT_ACTIVATED: Entry = entry(
    "Signals are asked for, and the unit is not switched on: no pulses. A common mistake is to \
     take bit 8 for SYNC0 and bit 9 for SYNC1.",
    &["bit 8 was forgotten"],
    &["the device description"],
    &["0x0300 for SYNC0, 0x0700 for both"],
);
static UNIT_ONLY: Entry = entry(
    "The unit is on and makes no pulse: the device wants time stamps (latches, system time). A \
     common mistake is to take 0x0100 for SYNC0.",
    &[],
    &["0x09AE to 0x09CF: latch status and times"],
    &["0x0300 if SYNC0 was meant; stacks that look at 0x0981 may refuse SAFEOP with 0x0030"],
);
static SYNC0: Entry = entry(
    "SYNC0 alone: the mode \"dc-sync0\" of most drives and I/O devices. 0x09A0 holds the cycle; \
     0x09A4 is 0.",
    &[],
    &["0x1C32:01 and 0x1C33:01: 2 in SAFEOP", "0x0984, 0x0990: whether it runs"],
    &["0x09A0 = bus cycle, unless the device description fixes it; then the bus cycle must be a \
         multiple"],
);
static BOTH: Entry = entry(
    "SYNC0 and SYNC1. By 0x09A4 against 0x09A0: shorter, SYNC1 is a part of the cycle behind \
     SYNC0 (\"dc-shift-sync1\" or \"dc-sync1\"); as long or longer, SYNC0 runs several times in a \
     cycle of SYNC1 (\"dc-subordinated\", oversampling).",
    &[],
    &["0x09A0 and 0x09A4", "0x1C32:01 and 0x1C33:01: which of the modes", "0x1C32:04 bit 3"],
    &["0x09A4 = period of SYNC1 - 0x09A0 + shift of SYNC1; never the period itself"],
);
static SYNC1: Entry = entry(
    "SYNC1 without SYNC0: rare. SYNC0's cycle must be set all the same, SYNC1 is counted from it.",
    &[],
    &["0x09A0, 0x09A4, 0x0998"],
    &["0x0700 if the device can bear SYNC0; many stacks refuse this word with 0x0030"],
);
static AT_PDI: Entry = entry(
    "The device programs its SYNC unit itself; the MainDevice's writes to 0x0981 and on are \
     ignored once this is set.",
    &[],
    &["0x0981, 0x09A0, 0x0990 as the device set them"],
    &["write the word as it is; cycles and start time only if the device's manual asks for \
         them, and before"],
);

//! The sub-indices of 0x1C32 and 0x1C33 that a mode needs, and their access rights: the two tables
//! of ETG.1020 as data.
//!
//! The tables have eight [`Column`]s, more than the [`SyncMode`](crate::SyncMode)s: a shift by a
//! local timer and a shift by SYNC1 have separate columns. Known misprints are corrected: the rows
//! of the delay time and of the shift time are present, and the SYNC0 cycle time belongs to
//! subordinated cycles.
//!
//! A device of several modes has every sub-index that at least one of them needs.

use core::fmt;

use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};

mod doubts;

pub use doubts::{Aspect, DOUBTS, Doubt};

/// A synchronization mode as a column of the tables.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Column {
    /// Not synchronized.
    FreeRun,
    /// With SM2; for inputs only, with SM3.
    Sm,
    /// As `Sm`, with Input Latch shifted by a local timer.
    SmShift,
    /// With SYNC0.
    Dc,
    /// As `Dc`, with Outputs Valid and Input Latch shifted by a local timer.
    DcShift,
    /// With SYNC0, Outputs Valid or Input Latch shifted by SYNC1.
    DcShiftSync1,
    /// SYNC0 starts the calculation, SYNC1 lets outputs act.
    DcSync1,
    /// Several cycles of a fixed SYNC0 in one cycle of SYNC1.
    DcSubordinated,
}

impl Column {
    /// All columns, in the order of the tables.
    pub const ALL: [Self; 8] = [
        Self::FreeRun,
        Self::Sm,
        Self::SmShift,
        Self::Dc,
        Self::DcShift,
        Self::DcShiftSync1,
        Self::DcSync1,
        Self::DcSubordinated,
    ];

    /// The name of the column.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FreeRun => "Free Run",
            Self::Sm => "SM 2/3",
            Self::SmShift => "SM 2/3 shift",
            Self::Dc => "DC",
            Self::DcShift => "DC shift",
            Self::DcShiftSync1 => "DC shift SYNC1",
            Self::DcSync1 => "DC SYNC1",
            Self::DcSubordinated => "DC subordinated",
        }
    }
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The access rights of a sub-index.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Rights {
    /// Not used in this mode.
    None,
    /// Read only.
    Read,
    /// Readable and writable.
    ReadWrite,
    /// Read only or writable, as the device chooses.
    Either,
}

impl fmt::Display for Rights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "-",
            Self::Read => "R",
            Self::ReadWrite => "RW",
            Self::Either => "R/RW",
        })
    }
}

/// Whether a device with the mode must have a sub-index.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Need {
    /// Not used in this mode.
    None,
    /// The sub-index must exist.
    Mandatory,
    /// The sub-index may exist.
    Optional,
    /// The sub-index must exist if the condition holds.
    Conditional(Condition),
}

impl fmt::Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.pad("-"),
            Self::Mandatory => f.pad("M"),
            Self::Optional => f.pad("O"),
            Self::Conditional(condition) => f.pad(condition.mark()),
        }
    }
}

/// The condition under which a sub-index must exist.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Condition {
    /// The device supports more than Free Run.
    MoreThanFreeRun,
    /// Sub-index 04 announces dynamic times, bit 14: there must be a command to start the
    /// measurement.
    DynamicTimes,
    /// One of the counters 0B, 0C and 0D exists: what they count ends in the error.
    Counters,
}

impl Condition {
    /// All conditions, in the order of their marks.
    pub const ALL: [Self; 3] = [Self::MoreThanFreeRun, Self::DynamicTimes, Self::Counters];

    /// Short form, "C1" to "C3".
    pub const fn mark(self) -> &'static str {
        match self {
            Self::MoreThanFreeRun => "C1",
            Self::DynamicTimes => "C2",
            Self::Counters => "C3",
        }
    }

    /// The condition in words.
    pub const fn in_words(self) -> &'static str {
        match self {
            Self::MoreThanFreeRun => "the device supports more than Free Run",
            Self::DynamicTimes => "sub-index 04 announces dynamic times (bit 14)",
            Self::Counters => "sub-index 0B, 0C or 0D is there",
        }
    }
}

/// The content of the tables for a sub-index in a column.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Cell {
    /// The access rights.
    pub rights: Rights,
    /// Whether the sub-index must exist.
    pub need: Need,
}

impl Cell {
    /// Whether the mode uses the sub-index.
    pub const fn is_used(self) -> bool {
        !matches!(self.need, Need::None)
    }
}

/// The cell of a sub-index of 0x1C32 or 0x1C33. `None` for another object, for sub-index 00, which
/// every device has, and for sub-indices that are not in the tables.
pub const fn lookup(object: u16, sub: u8, column: Column) -> Option<Cell> {
    let rows = match object {
        OUTPUT_PARAMETER => &OUTPUTS,
        INPUT_PARAMETER => &INPUTS,
        _ => return None,
    };
    let mut at = 0;
    while at < rows.len() {
        if rows[at].sub == sub {
            let (rights, need) = (rows[at].rights[column as usize], rows[at].need[column as usize]);
            return Some(Cell { rights, need });
        }
        at += 1;
    }
    None
}

/// The sub-indices of the tables in ascending order, the same for both objects.
pub const SUBS: [u8; 19] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 32];

/// A row of both tables.
struct Row {
    sub: u8,
    rights: [Rights; 8],
    need: [Need; 8],
}

const fn row(sub: u8, rights: [Rights; 8], need: [Need; 8]) -> Row {
    Row { sub, rights, need }
}

// Cells, in the letters of the printed tables.
const N: Rights = Rights::None;
const R: Rights = Rights::Read;
const W: Rights = Rights::ReadWrite;
const E: Rights = Rights::Either;
const U: Need = Need::None;
const M: Need = Need::Mandatory;
const O: Need = Need::Optional;
const C1: Need = Need::Conditional(Condition::MoreThanFreeRun);
const C2: Need = Need::Conditional(Condition::DynamicTimes);
const C3: Need = Need::Conditional(Condition::Counters);

const UNUSED_RIGHTS: [Rights; 8] = [N; 8];
const UNUSED: [Need; 8] = [U; 8];
const BUT_FREE_RUN: [Rights; 8] = [N, R, R, R, R, R, R, R];
const DC_ONLY: [Rights; 8] = [N, N, N, R, R, R, R, R];
const OPTIONAL: [Need; 8] = [U, O, O, O, O, O, O, O];
const OPTIONAL_DC: [Need; 8] = [U, U, U, O, O, O, O, O];

#[rustfmt::skip]
const OUTPUTS: [Row; 19] = [
    //       Free SM shift DC shift S1 SYNC1 sub
    row( 1, [E,  W,  W,  E,  W,  W,  E,  W ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 2, [E,  E,  E,  R,  R,  R,  R,  R ], [O,  O,  O,  O,  M,  M,  O,  M ]),
    row( 3, [N,  N,  N,  N,  W,  N,  N,  W ], [U,  U,  U,  U,  M,  U,  U,  O ]),
    row( 4, [R,  R,  R,  R,  R,  R,  R,  R ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 5, [R,  R,  R,  R,  R,  R,  R,  R ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 6, DC_ONLY,                          [U,  U,  U,  M,  M,  M,  M,  M ]),
    row( 7, UNUSED_RIGHTS,                    UNUSED),
    row( 8, [N,  W,  W,  W,  W,  W,  W,  W ], [U,  C2, C2, C2, C2, C2, C2, C2]),
    row( 9, DC_ONLY,                          [U,  U,  U,  M,  M,  M,  M,  M ]),
    row(10, [N,  N,  N,  N,  N,  N,  N,  R ], [U,  U,  U,  U,  U,  U,  U,  M ]),
    row(11, BUT_FREE_RUN,                     OPTIONAL),
    row(12, BUT_FREE_RUN,                     [U,  M,  M,  M,  M,  M,  M,  M ]),
    row(13, DC_ONLY,                          OPTIONAL_DC),
    row(14, BUT_FREE_RUN,                     OPTIONAL),
    row(15, BUT_FREE_RUN,                     OPTIONAL),
    row(16, BUT_FREE_RUN,                     OPTIONAL),
    row(17, DC_ONLY,                          OPTIONAL_DC),
    row(18, DC_ONLY,                          OPTIONAL_DC),
    row(32, BUT_FREE_RUN,                     [U,  C3, C3, C3, C3, C3, C3, C3]),
];

#[rustfmt::skip]
const INPUTS: [Row; 19] = [
    //       Free SM shift DC shift S1 SYNC1 sub
    row( 1, [E,  W,  W,  E,  W,  W,  E,  W ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 2, [E,  E,  E,  R,  R,  R,  R,  R ], [O,  O,  O,  O,  M,  M,  O,  M ]),
    row( 3, [N,  N,  W,  N,  W,  N,  N,  W ], [U,  U,  M,  U,  M,  U,  U,  O ]),
    row( 4, [R,  R,  R,  R,  R,  R,  R,  R ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 5, [R,  R,  R,  R,  R,  R,  R,  R ], [C1, M,  M,  M,  M,  M,  M,  M ]),
    row( 6, DC_ONLY,                          [U,  U,  U,  M,  M,  M,  M,  M ]),
    row( 7, UNUSED_RIGHTS,                    UNUSED),
    row( 8, [N,  W,  W,  W,  W,  W,  W,  W ], [U,  C2, C2, C2, C2, C2, C2, C2]),
    row( 9, [N,  N,  N,  N,  N,  R,  N,  R ], [U,  U,  U,  U,  U,  M,  U,  M ]),
    row(10, [N,  N,  N,  N,  N,  N,  N,  R ], [U,  U,  U,  U,  U,  U,  U,  M ]),
    row(11, BUT_FREE_RUN,                     OPTIONAL),
    row(12, BUT_FREE_RUN,                     [U,  M,  M,  M,  M,  M,  M,  M ]),
    row(13, [N,  N,  N,  R,  R,  R,  N,  R ], [U,  U,  U,  O,  O,  O,  U,  O ]),
    row(14, BUT_FREE_RUN,                     OPTIONAL),
    row(15, UNUSED_RIGHTS,                    UNUSED),
    row(16, UNUSED_RIGHTS,                    UNUSED),
    row(17, UNUSED_RIGHTS,                    UNUSED),
    row(18, UNUSED_RIGHTS,                    UNUSED),
    row(32, BUT_FREE_RUN,                     [U,  C3, C3, C3, C3, C3, C3, C3]),
];

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;
    use std::vec::Vec;

    use super::*;

    /// A second transcription of both tables: rights and need of each column.
    const PRINTED: [(u16, u8, &str); 14] = [
        (0x1C32, 1, "R/RW C1, RW M, RW M, R/RW M, RW M, RW M, R/RW M, RW M"),
        (0x1C32, 2, "R/RW O, R/RW O, R/RW O, R O, R M, R M, R O, R M"),
        (0x1C32, 3, "- -, - -, - -, - -, RW M, - -, - -, RW O"),
        (0x1C33, 3, "- -, - -, RW M, - -, RW M, - -, - -, RW O"),
        (0x1C32, 6, "- -, - -, - -, R M, R M, R M, R M, R M"),
        (0x1C32, 8, "- -, RW C2, RW C2, RW C2, RW C2, RW C2, RW C2, RW C2"),
        (0x1C32, 9, "- -, - -, - -, R M, R M, R M, R M, R M"),
        (0x1C33, 9, "- -, - -, - -, - -, - -, R M, - -, R M"),
        (0x1C33, 10, "- -, - -, - -, - -, - -, - -, - -, R M"),
        (0x1C33, 12, "- -, R M, R M, R M, R M, R M, R M, R M"),
        (0x1C33, 13, "- -, - -, - -, R O, R O, R O, - -, R O"),
        (0x1C32, 16, "- -, R O, R O, R O, R O, R O, R O, R O"),
        (0x1C32, 17, "- -, - -, - -, R O, R O, R O, R O, R O"),
        (0x1C33, 17, "- -, - -, - -, - -, - -, - -, - -, - -"),
    ];

    fn printed(object: u16, sub: u8) -> String {
        let cell = |column| lookup(object, sub, column).unwrap();
        let cells = Column::ALL.map(cell).map(|cell| format!("{} {}", cell.rights, cell.need));
        cells.join(", ")
    }

    #[test]
    fn rows_read_as_printed() {
        for (object, sub, expected) in PRINTED {
            assert_eq!(printed(object, sub), expected, "{object:04X}:{sub:02X}");
        }
    }

    #[test]
    fn what_is_not_used_has_neither_right_nor_need() {
        for object in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
            for sub in SUBS {
                assert!(crate::object::name(sub).is_some());
                for column in Column::ALL {
                    let cell = lookup(object, sub, column).unwrap();
                    let place = format!("{object:04X}:{sub:02X} {column}");
                    assert_eq!(cell.rights == Rights::None, !cell.is_used(), "{place}");
                }
            }
        }
    }

    /// The objects differ where the event matters (03, 09, 13) and in entries for outputs only (15
    /// to 18).
    #[test]
    fn the_objects_differ_in_few_rows() {
        let differs = |sub: &u8| printed(0x1C32, *sub) != printed(0x1C33, *sub);
        let subs: Vec<u8> = SUBS.into_iter().filter(differs).collect();
        assert_eq!(subs, [3, 9, 13, 15, 16, 17, 18]);
    }

    #[test]
    fn other_sub_indices_are_not_in_the_tables() {
        for (object, sub) in
            [(0x1C32, 0), (0x1C32, 19), (0x1C33, 31), (0x1C33, 33), (0x1C12, 1), (0x1C34, 1)]
        {
            assert_eq!(lookup(object, sub, Column::Dc), None, "{object:04X}:{sub:02X}");
        }
        // `lookup` must work in a constant, for a stack without allocation.
        const SHIFT: Option<Cell> = lookup(0x1C33, 3, Column::SmShift);
        assert_eq!(SHIFT, Some(Cell { rights: Rights::ReadWrite, need: Need::Mandatory }));
    }
}

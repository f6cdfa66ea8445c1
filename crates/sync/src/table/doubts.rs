//! The cells in which a published copy of the tables differs from [`lookup`](super::lookup), and
//! why the copy is not followed.

use super::Column;
use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};

/// One of the two tables.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Aspect {
    /// The access rights of a sub-index.
    Rights,
    /// Whether a sub-index must exist.
    Need,
}

impl Aspect {
    /// The name in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rights => "access",
            Self::Need => "need",
        }
    }
}

/// Cells in which a source differs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Doubt {
    /// The object.
    pub object: u16,
    /// Its sub-indices.
    pub subs: &'static [u8],
    /// The columns; all of them if the whole row differs.
    pub columns: &'static [Column],
    /// Which table.
    pub aspect: Aspect,
    /// The source's content, in the letters of the tables; "no row" if the row is missing.
    pub printed: &'static str,
    /// Why the tables in this crate differ from it.
    pub reason: &'static str,
}

/// All doubts.
pub const DOUBTS: [Doubt; 6] = [
    Doubt {
        object: OUTPUT_PARAMETER,
        subs: &[0x0A],
        columns: &[Column::DcShiftSync1],
        aspect: Aspect::Rights,
        printed: "R",
        reason: SHIFTED_CELL,
    },
    Doubt {
        object: OUTPUT_PARAMETER,
        subs: &[0x0A],
        columns: &[Column::DcSubordinated],
        aspect: Aspect::Rights,
        printed: "-",
        reason: SHIFTED_CELL,
    },
    Doubt {
        object: INPUT_PARAMETER,
        subs: &[0x0F, 0x10, 0x11, 0x12],
        columns: &[Column::DcShiftSync1, Column::DcSubordinated],
        aspect: Aspect::Need,
        printed: "O",
        reason: "the record of 0x1C33 has these entries reserved, and in the other columns the O stands for \
                 0x1C32 alone",
    },
    Doubt {
        object: OUTPUT_PARAMETER,
        subs: &[0x03],
        columns: &Column::ALL,
        aspect: Aspect::Need,
        printed: "no row",
        reason: "a second copy of the same table has the row of the shift time",
    },
    Doubt {
        object: OUTPUT_PARAMETER,
        subs: &[0x09],
        columns: &Column::ALL,
        aspect: Aspect::Rights,
        printed: "no row",
        reason: ROWS_BEHIND,
    },
    Doubt {
        object: OUTPUT_PARAMETER,
        subs: &[0x08],
        columns: &Column::ALL,
        aspect: Aspect::Rights,
        printed: "no row",
        reason: ROWS_BEHIND,
    },
];

const SHIFTED_CELL: &str = "the same source has the entry mandatory with subordinated cycles only: its cell stands in \
                            the wrong column";
const ROWS_BEHIND: &str = "the name of 07 is missing there, so each name from 08 on stands beside the row before it: \
                           \"delay time 8\" is writable as the command 08 is";

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::super::lookup;
    use super::*;

    /// The ten cells that differ: the printed content is not the one used.
    #[test]
    fn what_is_printed_is_not_what_is_taken() {
        let mut cells = 0;
        for doubt in DOUBTS.iter().filter(|doubt| doubt.columns.len() < Column::ALL.len()) {
            for sub in doubt.subs {
                for column in doubt.columns {
                    let cell = lookup(doubt.object, *sub, *column).unwrap();
                    let taken = match doubt.aspect {
                        Aspect::Rights => cell.rights.to_string(),
                        Aspect::Need => cell.need.to_string(),
                    };
                    assert_ne!(taken, doubt.printed, "{:04X}:{sub:02X} {column}", doubt.object);
                    cells += 1;
                }
            }
        }
        assert_eq!(cells, 10);
    }
}

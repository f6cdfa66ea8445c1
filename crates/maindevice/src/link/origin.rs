//! Where a frame that came in is from.

use isocat_wire::frame::{LOCALLY_ADMINISTERED, payload_offset};

use crate::statistics::Statistics;

/// Where a frame that came in is from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Origin {
    /// From us, through a SubDevice or by a source address that can't show it.
    Ours {
        /// Where its datagrams begin.
        payload: usize,
    },
    /// From us, untouched.
    Echo,
    /// From another MainDevice.
    Foreign([u8; 6]),
    /// Not EtherCAT.
    Other,
}

impl Origin {
    /// The first ESC that a frame passes sets bit 1 of its source address.
    #[inline]
    pub fn of(frame: &[u8], source: [u8; 6]) -> Self {
        let Ok(payload) = payload_offset(frame) else { return Origin::Other };
        let Some(found) = frame[6..].first_chunk::<6>() else { return Origin::Other };
        if *found == source && source[0] & LOCALLY_ADMINISTERED == 0 {
            return Origin::Echo;
        }
        let passed = |mut address: [u8; 6]| {
            address[0] |= LOCALLY_ADMINISTERED;
            address
        };
        if passed(*found) == passed(source) {
            Origin::Ours { payload }
        } else {
            Origin::Foreign(*found)
        }
    }

    /// Counts a frame that is not an answer to us.
    #[cold]
    pub fn count(self, statistics: &mut Statistics) {
        match self {
            Origin::Ours { .. } => {}
            Origin::Echo => statistics.frames_echoed += 1,
            Origin::Foreign(source) => {
                statistics.frames_foreign += 1;
                statistics.foreign_source = Some(source);
            }
            Origin::Other => statistics.frames_other += 1,
        }
    }
}

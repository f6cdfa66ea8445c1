//! The sender of a received frame, and whether an ESC has processed it.

use isocat_wire::datagram::datagrams;
use isocat_wire::frame::{LOCALLY_ADMINISTERED, payload_offset};

use crate::statistics::Statistics;

/// The sender of a received frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Origin {
    /// Ours, returned by a SubDevice, or with a source address that cannot show it.
    Ours {
        /// Offset of its datagrams.
        payload: usize,
    },
    /// Ours, with an unchanged source address: an echo, or the answer of a segment whose first ESC
    /// does not mark frames (register 0x0100 bit 0 is 0, or a stack that never does). Its datagrams
    /// tell which, see [`is_touched`].
    Unmarked {
        /// Offset of its datagrams.
        payload: usize,
    },
    /// From another MainDevice.
    Foreign([u8; 6]),
    /// Not EtherCAT.
    Other,
}

impl Origin {
    /// Finds the sender. The first ESC that a frame passes sets bit 1 of its source address, if bit
    /// 0 of its 0x0100 is set.
    #[inline]
    pub fn of(frame: &[u8], source: [u8; 6]) -> Self {
        let Ok(payload) = payload_offset(frame) else { return Origin::Other };
        let Some(found) = frame[6..].first_chunk::<6>() else { return Origin::Other };
        let number = |[a, b, c, d, e, f]: [u8; 6]| u64::from_le_bytes([a, b, c, d, e, f, 0, 0]);
        let differs = number(*found) ^ number(source);
        match differs {
            // Nearly every frame is ours, and marked.
            MARK => Origin::Ours { payload },
            0 if source[0] & LOCALLY_ADMINISTERED != 0 => Origin::Ours { payload },
            0 => Origin::Unmarked { payload },
            _ => Origin::Foreign(*found),
        }
    }

    /// Counts a frame that is not an answer to us.
    #[cold]
    pub fn count(self, statistics: &mut Statistics) {
        match self {
            Origin::Ours { .. } => {}
            Origin::Unmarked { .. } => statistics.frames_echoed += 1,
            Origin::Foreign(source) => {
                statistics.frames_foreign += 1;
                statistics.foreign_source = Some(source);
            }
            Origin::Other => statistics.frames_other += 1,
        }
    }
}

/// The bit that the first ESC sets, in a source address as a number.
const MARK: u64 = LOCALLY_ADMINISTERED as u64;

/// Whether an ESC has changed a datagram: its working counter, or its position (ADP), which each
/// ESC increments. `sent` returns the position with which a datagram left, by its number in the
/// frame.
pub(crate) fn is_touched(payload: &[u8], sent: impl Fn(usize) -> Option<u16>) -> bool {
    datagrams(payload).map_while(Result::ok).enumerate().any(|(number, datagram)| {
        let counts = datagram.header.command().is_ok_and(|command| command.increments_position());
        let moved = || sent(number).is_some_and(|sent| sent != datagram.header.adp());
        datagram.wkc != 0 || counts && moved()
    })
}

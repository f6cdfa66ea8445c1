//! Source addresses of frames, as the MainDevices send them.

use std::time::Duration;

use isocat_captures::reading::Frame;
use isocat_wire::datagram::{Datagram, datagrams};
use isocat_wire::frame::LOCALLY_ADMINISTERED;
use isocat_wire::{Command, register};

/// Frames of one source address.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Talker {
    /// Without the bit that the first SubDevice sets.
    pub address: [u8; 6],
    pub frames: u64,
    /// How often the source changed to this address.
    pub turns: u64,
    /// Of these, frames that ask SubDevices for a state while the segment operates.
    pub asking: u64,
    pub first: usize,
    pub last: usize,
    pub last_at: Duration,
}

/// All source addresses.
#[derive(Clone, Debug, Default)]
pub(crate) struct Talkers {
    pub list: Vec<Talker>,
    /// Frames of source addresses beyond the `MOST_TALKERS` that are kept apart.
    pub others: u64,
    last: Option<[u8; 6]>,
}

impl Talkers {
    /// Takes a frame as it was first seen; `operating`: process data are exchanged.
    pub fn frame(&mut self, frame: &Frame, at: Duration, operating: bool) {
        let Some(address) = source(frame) else { return };
        let number = frame.number;
        let turn = self.last.replace(address) != Some(address);
        match self.list.iter().position(|talker| talker.address == address) {
            Some(place) => {
                let talker = &mut self.list[place];
                talker.frames += 1;
                talker.asking += u64::from(operating && asks_for_a_state(frame));
                talker.turns += u64::from(turn);
                talker.last = number;
                talker.last_at = at;
            }
            None if self.list.len() < MOST_TALKERS => {
                let (frames, turns, asking) =
                    (1, 1, u64::from(operating && asks_for_a_state(frame)));
                let (first, last, last_at) = (number, number, at);
                self.list.push(Talker { address, frames, turns, asking, first, last, last_at });
            }
            None => self.others += 1,
        }
    }
}

/// The source address of a frame, without the bit that the first SubDevice sets.
pub(crate) fn source(frame: &Frame) -> Option<[u8; 6]> {
    let mut address: [u8; 6] = frame.bytes.get(6..)?.first_chunk().copied()?;
    address[0] &= !LOCALLY_ADMINISTERED;
    Some(address)
}

/// Whether a frame writes AL control.
fn asks_for_a_state(frame: &Frame) -> bool {
    use Command::*;
    let Ok(payload) = isocat_wire::frame::payload(&frame.bytes) else { return false };
    let control = usize::from(register::AL_CONTROL.address);
    let asks = |datagram: Datagram<'_>| {
        let ado = usize::from(datagram.header.ado());
        let covers = (ado..ado + datagram.data.len()).contains(&control);
        covers && matches!(datagram.header.command(), Ok(Apwr | Fpwr | Bwr | Aprw | Fprw | Brw))
    };
    datagrams(payload).map_while(Result::ok).any(asks)
}

/// Source addresses that are kept apart.
const MOST_TALKERS: usize = 16;

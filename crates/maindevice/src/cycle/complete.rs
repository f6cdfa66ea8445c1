//! When a cycle is complete, and what came back of it.

use alloc::vec::Vec;

use isocat_wire::time::{Dc, Host, Time};

use super::CyclicExchange;
use super::presence::Place;
use crate::segment::{Chunk, SubDevice};

/// Which cycles are complete.
#[derive(Default)]
pub(super) struct Closing {
    /// Number of frames of the present cycle in flight.
    pub(super) out: usize,
    /// The last complete cycle: all of its frames are back, or the missing ones were given up.
    closed: u64,
    /// The last cycle that was reported.
    told: u64,
}

/// The data that came back last, and of which cycle it is.
#[derive(Default)]
pub(super) struct Taken {
    /// By chunk: the cycle of its inputs; 0 before the first.
    pub(super) chunks: Vec<u64>,
    /// The cycle whose reference time came back last, and that time.
    pub(super) time: (u64, Time<Dc>),
}

/// The present process data, without the outputs.
#[derive(Clone, Copy)]
pub(crate) struct Exchanged<'a> {
    places: &'a [Place],
    chunks: &'a [Chunk],
    taken: &'a [u64],
    inputs: &'a [u8],
    order: &'a [usize],
    exchanging: bool,
    slot: u64,
}

impl CyclicExchange {
    /// Closes the present cycle if none of its frames is in flight, or the next one is due. Call
    /// this after each input, when its data has been taken.
    #[inline]
    pub fn close(&mut self, now: Time<Host>) {
        if self.is_open() && self.is_sent() && (self.closing.out == 0 || now >= self.due) {
            self.closing.closed = self.number;
        }
    }

    /// Whether the present cycle is not complete yet; the next one must not begin before that.
    pub(super) fn is_open(&self) -> bool {
        self.closing.closed != self.number
    }

    /// The completed cycle, once, and whether process data ran in it.
    #[inline]
    pub fn take_closed(&mut self) -> Option<(u64, bool)> {
        let closed = self.closing.closed;
        if core::mem::replace(&mut self.closing.told, closed) == closed {
            return None;
        }
        Some((closed, self.exchanging))
    }

    /// The reference time that a cycle brought back, if it is the last reference time.
    pub fn reference_time_of(&self, cycle: u64) -> Option<Time<Dc>> {
        let (of, time) = self.taken.time;
        (of == cycle).then_some(time)
    }

    /// The outputs of the process image, and the data that came back.
    pub fn exchanged(&mut self) -> (&mut [u8], Exchanged<'_>) {
        let exchanged = Exchanged {
            places: &self.places,
            chunks: &self.image.chunks,
            taken: &self.taken.chunks,
            inputs: &self.inputs,
            order: &self.order,
            exchanging: self.exchanging,
            slot: self.slot,
        };
        (&mut self.outputs, exchanged)
    }
}

impl<'a> Exchanged<'a> {
    /// Positions in the order of the process image.
    pub fn order(&self) -> &'a [usize] {
        self.order
    }

    /// The inputs of a SubDevice.
    pub fn inputs(&self, device: &SubDevice) -> &'a [u8] {
        self.inputs.get(device.inputs.range()).unwrap_or_default()
    }

    /// The cycle of the inputs at a position.
    pub fn inputs_cycle(&self, position: usize) -> Option<u64> {
        let place = self.places.get(position).filter(|place| place.reads)?;
        Some(place.inputs_cycle(self.taken[place.chunk?])).filter(|cycle| *cycle > 0)
    }

    /// Whether the frames with the process data of a position left in the present cycle.
    pub fn takes_part(&self, position: usize) -> bool {
        let chunk = self.places.get(position).and_then(|place| place.chunk);
        let every = chunk.map_or(0, |chunk| u64::from(self.chunks[chunk].every));
        self.exchanging && (every == 1 || every > 1 && self.slot.is_multiple_of(every))
    }
}

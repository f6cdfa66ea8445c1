//! When a cycle is over, and what came back of it.

use alloc::vec::Vec;

use isocat_wire::time::{Dc, Host, Time};

use super::CyclicExchange;
use super::presence::Place;
use crate::segment::{Chunk, SubDevice};

/// How far cycles are.
#[derive(Default)]
pub(super) struct Closing {
    /// Frames of the present cycle that are under way.
    pub(super) out: usize,
    /// The last cycle that is over: all of it is back, or the rest was given up.
    closed: u64,
    /// The last one that was told.
    told: u64,
}

/// What came back last, and in which cycle.
#[derive(Default)]
pub(super) struct Taken {
    /// By chunk: the cycle that its inputs are of; 0 before the first.
    pub(super) chunks: Vec<u64>,
    /// The cycle whose reference time came back last, and that time.
    pub(super) time: (u64, Time<Dc>),
}

/// Process data as they stand, less the outputs.
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
    /// Closes the present cycle if none of its frames is under way, or the next one is due. To be called behind each
    /// input, when what came in has been taken.
    #[inline]
    pub fn close(&mut self, now: Time<Host>) {
        if self.is_open() && self.is_sent() && (self.closing.out == 0 || now >= self.due) {
            self.closing.closed = self.number;
        }
    }

    /// Whether the present cycle is not over yet: the next one must not begin.
    pub(super) fn is_open(&self) -> bool {
        self.closing.closed != self.number
    }

    /// The cycle that is over, once; and whether process data ran in it.
    #[inline]
    pub fn take_closed(&mut self) -> Option<(u64, bool)> {
        let closed = self.closing.closed;
        if core::mem::replace(&mut self.closing.told, closed) == closed {
            return None;
        }
        Some((closed, self.exchanging))
    }

    /// The reference time that a cycle brought back, if it was the last to do so.
    pub fn reference_time_of(&self, cycle: u64) -> Option<Time<Dc>> {
        let (of, time) = self.taken.time;
        (of == cycle).then_some(time)
    }

    /// The outputs of the image, and what came back.
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
    /// Positions in the order of the image.
    pub fn order(&self) -> &'a [usize] {
        self.order
    }

    /// The inputs of a SubDevice.
    pub fn inputs(&self, device: &SubDevice) -> &'a [u8] {
        self.inputs.get(device.inputs.range()).unwrap_or_default()
    }

    /// The cycle that the inputs at a position are of.
    pub fn inputs_cycle(&self, position: usize) -> Option<u64> {
        let place = self.places.get(position).filter(|place| place.reads)?;
        Some(place.inputs_cycle(self.taken[place.chunk?])).filter(|cycle| *cycle > 0)
    }

    /// Whether the frames that have a position's process data left in the present cycle.
    pub fn takes_part(&self, position: usize) -> bool {
        let chunk = self.places.get(position).and_then(|place| place.chunk);
        let every = chunk.map_or(0, |chunk| u64::from(self.chunks[chunk].every));
        self.exchanging && (every == 1 || every > 1 && self.slot % every == 0)
    }
}

//! The order in which clocks are read, with the datagrams of all of them.
//!
//! Which clocks are read changes only when SubDevices come, so the datagrams are made then. A batch
//! is a part of them, or two where the round begins again: it is copied as a whole.

use alloc::vec::Vec;

use isocat_wire::frame;

use super::clocks::Wanted;
use super::reads;

/// All clocks that are present, by index.
#[derive(Clone, Debug, Default)]
pub(super) struct Round {
    wanted: Vec<Wanted>,
    /// The datagrams that read them, one behind the other.
    datagrams: Vec<u8>,
    /// Where those of each clock end.
    ends: Vec<usize>,
}

impl Round {
    /// Memory for this number of clocks.
    pub fn new(clocks: usize) -> Self {
        Self {
            wanted: Vec::with_capacity(clocks),
            datagrams: Vec::with_capacity(clocks * reads::octets_of(true)),
            ends: Vec::with_capacity(clocks),
        }
    }

    /// Takes these clocks in the place of those before.
    pub fn set(&mut self, clocks: impl Iterator<Item = Wanted>) {
        self.wanted.clear();
        self.datagrams.clear();
        self.ends.clear();
        for clock in clocks {
            reads::ask(clock, &mut self.datagrams);
            self.wanted.push(clock);
            self.ends.push(self.datagrams.len());
        }
    }

    /// Whether there are no clocks.
    pub fn is_empty(&self) -> bool {
        self.wanted.is_empty()
    }

    /// Puts the clocks from index `turn` on, around the end, into the empty `wanted`, and their
    /// datagrams into `datagrams`: at most `most`, whose reads fit into a frame of `octets` bytes,
    /// and one at least.
    pub fn next(
        &self,
        turn: usize,
        (most, octets): (usize, usize),
        wanted: &mut Vec<Wanted>,
        datagrams: &mut Vec<u8>,
    ) {
        let room = octets.saturating_sub(frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN);
        // Nearly always all clocks are in the round, so that each is at its index.
        let from = match self.wanted.get(turn) {
            Some((index, ..)) if *index == turn => turn,
            _ => self.wanted.partition_point(|(index, ..)| *index < turn),
        };
        for (first, end) in [(from, self.wanted.len()), (0, from)] {
            let start = first.checked_sub(1).map_or(0, |before| self.ends[before]);
            let left = room.saturating_sub(datagrams.len());
            let ends = &self.ends[first..end.min(first + (most - wanted.len()))];
            let fit = match ends.last() {
                Some(end) if end - start <= left => ends.len(),
                _ => ends.partition_point(|end| end - start <= left),
            };
            let least = usize::from(wanted.is_empty() && most > 0).min(end - first);
            let count = fit.max(least);
            if count > 0 {
                wanted.extend_from_slice(&self.wanted[first..first + count]);
                datagrams.extend_from_slice(&self.datagrams[start..self.ends[first + count - 1]]);
            }
            if first + count < end {
                break;
            }
        }
    }
}

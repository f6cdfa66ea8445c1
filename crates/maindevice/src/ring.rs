//! The second port: a ring of SubDevices that one broken cable does not stop.
//!
//! Every frame leaves both ports at once, and the returned copies become one frame for the rest of
//! the machine.
//!
//! - **Whole ring.** Copy A, from the primary port, passes all SubDevices in processing order and
//!   arrives at the secondary port: it is the answer and is used unchanged. Copy B, from the
//!   secondary port, runs against that order, is not processed by any SubDevice, arrives at the
//!   primary port, and only shows that the ring is whole.
//! - **Cut ring.** Both copies turn at the cut and return to their port, each processed by its part
//!   and in the same order of SubDevices: B turns first. They are merged. One of them may be
//!   missing, lost or because there is no cable at its port. Then the other is used alone after a
//!   time ([`config::Ring::patience`]), and at once if this repeats.
//!
//! Each SubDevice is reached by one of the copies, so most commands mean in B what they mean in A.
//! The others become NOP in B:
//!
//! | command | in B | merged: data | why |
//! |---|---|---|---|
//! | FPRD FPRW | as it is | of the side that counted, B's if both | a station is on one side |
//! | FPWR BWR LWR | as it is | as sent | each SubDevice is written to once |
//! | BRD BRW | as it is | OR of both | each ORs into it |
//! | LRD LRW | as it is | bits that either side changed | each bit is read by one SubDevice |
//! | APRD APWR APRW ARMW | NOP | A's | positions would count from the cut |
//! | BWR BRW of 0x0900 | NOP | A's | times of two ways make no delay |
//! | FRMW of 0x0910 | NOP, or led by the first clock behind the cut | A's | all that follow would take the zeros for a time |
//! | FRMW of others | NOP | A's | the same |
//!
//! Working counters are added. The source address distinguishes the copies: B's has the lowest bit
//! of its last octet inverted. Buffers are reused from frame to frame, so that operation does not
//! allocate.
//!
//! The bring-up is that of a line: [`close`] closes the port through which the last SubDevice sends
//! to the secondary port, and [`open`] opens it again. Delays stay right in the whole ring, since A
//! goes the same way, and behind a cut, since B passes the SubDevices there in the same order; the
//! additional time of B is equal for all of them.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED, MAX_LEN, payload_offset};
use isocat_wire::time::{Host, Nanos, Time};

use crate::board::{RingState, View};
use crate::config;
use crate::link::CYCLIC_INDEX;

mod merge;
#[cfg(test)]
mod tests;
mod way;

pub(crate) use way::{check, close, is_closed, open};

/// A network port of the MainDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Port {
    /// The port in front of the first SubDevice.
    Primary,
    /// The other end of a ring, behind the last SubDevice.
    Secondary,
}

/// Frames in flight in both directions.
pub(crate) struct Copies {
    sources: [[u8; 6]; 2],
    patience: Nanos,
    /// Shortest time without copies after which the SubDevices behind that port count as lost.
    gone: Nanos,
    /// Longest time that a copy can be in flight: of a frame of the cycle, and of another one.
    longest: [Nanos; 2],
    slots: Vec<Slot>,
    /// The result of merging two copies.
    merged: Vec<u8>,
    /// When a copy from each port last came back.
    heard: [Time<Host>; 2],
    /// Number of copies from each port that did not come back since then, while the other copy did.
    missed: [u32; 2],
    /// The reference of the clocks behind the cut.
    pub leader: Option<StationAddress>,
    /// Number of copies that did not come back.
    pub lost: u64,
}

/// One frame.
struct Slot {
    state: State,
    /// The frame as it left the primary port.
    sent: Vec<u8>,
    /// The copy that came back first, if it turned at a cut.
    came: Vec<u8>,
    /// The port that it was sent from.
    first: Port,
    /// Whether the copy of each port is in flight.
    under_way: [bool; 2],
    /// Whether copy B has not left yet.
    to_send: bool,
    leader: Option<StationAddress>,
    expires: Time<Host>,
    /// When the wait for the other copy ends.
    until: Time<Host>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Free,
    /// No copy is back.
    Out,
    /// One copy turned at a cut and is kept.
    Half,
    /// The machine has its answer; further copies may still come.
    Done,
}

/// How a received frame is used.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Taken {
    /// The machine takes it unchanged.
    AsItIs,
    /// The machine takes [`Copies::merged`] instead.
    Merged,
    /// The machine takes nothing.
    Kept,
}

impl Copies {
    pub fn new(config: &crate::Config, ring: config::Ring, now: Time<Host>) -> Self {
        let mut second = config.source;
        second[5] ^= 1;
        let frame = config.timeouts.frame;
        Self {
            sources: [config.source, second],
            patience: ring.patience.unwrap_or(Nanos(config.cycle.0 / 4)),
            gone: Nanos(frame.0.saturating_mul(2)),
            longest: [Nanos(2 * config.cycle.0), Nanos(frame.0.saturating_mul(16))],
            slots: Vec::new(),
            merged: vec![0; MAX_LEN],
            heard: [now; 2],
            missed: [0; 2],
            leader: None,
            lost: 0,
        }
    }

    /// Called when a frame leaves the primary port; its copy must then leave the other port.
    pub fn sent(&mut self, now: Time<Host>, frame: &[u8]) {
        for slot in &mut self.slots {
            if slot.state != State::Free && slot.expires <= now {
                self.lost += slot.under_way.iter().map(|missing| u64::from(*missing)).sum::<u64>();
                slot.state = State::Free;
            }
        }
        let at = self.slots.iter().position(|slot| slot.state == State::Free);
        let at = at.unwrap_or_else(|| {
            self.slots.push(Slot::new());
            self.slots.len() - 1
        });
        let slot = &mut self.slots[at];
        slot.sent.clear();
        slot.sent.extend_from_slice(frame);
        slot.came.clear();
        slot.state = State::Out;
        slot.under_way = [true; 2];
        slot.to_send = true;
        slot.leader = self.leader;
        slot.until = Time::NEVER;
        slot.expires = now + self.longest[usize::from(!is_cyclic(frame))];
    }

    /// Writes the copy that must leave the secondary port now.
    pub fn transmit(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let fits = |slot: &&mut Slot| slot.state != State::Free && slot.to_send;
        let slot = self.slots.iter_mut().find(fits)?;
        let bytes = buffer.get_mut(..slot.sent.len())?;
        slot.to_send = false;
        bytes.copy_from_slice(&slot.sent);
        bytes[6..12].copy_from_slice(&self.sources[1]);
        merge::change(bytes, slot.leader);
        Some(bytes.len())
    }

    /// Takes a frame received at a port.
    pub fn take(
        &mut self,
        port: Port,
        now: Time<Host>,
        frame: &[u8],
        shared: &mut RingState,
    ) -> Taken {
        let Some(from) = self.origin(frame) else { return Taken::AsItIs };
        if shared.line && from == Port::Primary {
            return Taken::AsItIs;
        }
        let Some(at) = self.find(frame) else {
            // It is not expected; the machine counts such frames of the primary port.
            return if from == Port::Primary { Taken::AsItIs } else { Taken::Kept };
        };
        let (own, other) = (from as usize, 1 - from as usize);
        if !core::mem::replace(&mut self.slots[at].under_way[own], false) {
            return Taken::Kept;
        }
        (self.heard[own], self.missed[own]) = (now, 0);
        let taken = match (from, port) {
            (Port::Primary, Port::Secondary) => {
                if shared.view != View::Reverse {
                    shared.view = View::Whole;
                }
                let new = self.slots[at].state != State::Done;
                self.slots[at].state = State::Done;
                if new { Taken::AsItIs } else { Taken::Kept }
            }
            (Port::Secondary, Port::Primary) => {
                if merge::counts(frame) {
                    shared.view = View::Reverse;
                }
                // This copy passed no SubDevice, so the copy that turned holds all answers.
                match self.slots[at].state {
                    State::Half => self.alone(at, false, shared),
                    _ => Taken::Kept,
                }
            }
            _ => self.take_turned(at, from, now, frame, shared),
        };
        let slot = &mut self.slots[at];
        if slot.state == State::Done && !slot.under_way[other] {
            slot.state = State::Free;
        }
        taken
    }

    /// Takes a copy that turned at a cut.
    fn take_turned(
        &mut self,
        at: usize,
        from: Port,
        now: Time<Host>,
        frame: &[u8],
        shared: &mut RingState,
    ) -> Taken {
        let other = 1 - from as usize;
        match self.slots[at].state {
            State::Half => {
                let slot = &mut self.slots[at];
                let (a, b) = match from {
                    Port::Primary => (frame, &slot.came[..]),
                    Port::Secondary => (&slot.came[..], frame),
                };
                slot.state = State::Done;
                slot.until = Time::NEVER;
                let counts = merge::merge(a, b, &slot.sent, slot.leader, &mut self.merged);
                match counts {
                    Some(counts) => {
                        see(shared, counts);
                        Taken::Merged
                    }
                    None => Taken::Kept,
                }
            }
            State::Out => {
                let slot = &mut self.slots[at];
                slot.came.clear();
                slot.came.extend_from_slice(frame);
                (slot.state, slot.first) = (State::Half, from);
                let (cyclic, back) = (is_cyclic(&slot.sent), !slot.under_way[other]);
                if back || cyclic && self.missed[other] >= SILENT || self.is_gone(other, now) {
                    self.missed[other] = self.missed[other].saturating_add(u32::from(!back));
                    return self.alone(at, !back, shared);
                }
                self.slots[at].until = now + self.patience;
                Taken::Kept
            }
            State::Done | State::Free => Taken::Kept,
        }
    }

    /// Uses the received copy without the other. `silent`: the other has been missing for long.
    fn alone(&mut self, at: usize, silent: bool, shared: &mut RingState) -> Taken {
        let slot = &mut self.slots[at];
        slot.state = State::Done;
        slot.until = Time::NEVER;
        let counts = match slot.first {
            Port::Primary => merge::alone_a(&slot.came, &slot.sent, &mut self.merged),
            Port::Secondary => {
                merge::alone_b(&slot.came, &slot.sent, slot.leader, &mut self.merged)
            }
        };
        match counts {
            Some(counts) => {
                if silent {
                    see(shared, counts);
                }
                Taken::Merged
            }
            None => Taken::Kept,
        }
    }

    /// Ends the wait of a frame for its other copy. Call this until it returns `None`.
    pub fn expire(&mut self, now: Time<Host>, shared: &mut RingState) -> Option<Taken> {
        let at = self.slots.iter().position(|slot| slot.until <= now)?;
        let slot = &mut self.slots[at];
        slot.until = Time::NEVER;
        let other = 1 - slot.first as usize;
        self.missed[other] = self.missed[other].saturating_add(1);
        if !is_cyclic(&slot.sent) && !self.is_gone(other, now) {
            // A missing answer must be certain, so the frame is discarded here and sent again.
            self.slots[at].state = State::Done;
            return Some(Taken::Kept);
        }
        let silent = self.missed[other] >= SILENT;
        Some(self.alone(at, silent, shared))
    }

    /// Whether all SubDevices behind a port are lost.
    fn is_gone(&self, port: usize, now: Time<Host>) -> bool {
        self.missed[port] >= GONE && now - self.heard[port] >= self.gone
    }

    /// When the next wait for a copy ends.
    pub fn next_timeout(&self) -> Time<Host> {
        self.slots.iter().map(|slot| slot.until).fold(Time::NEVER, Time::min)
    }

    /// The frame that was merged from two copies, or made from one.
    pub fn merged(&self) -> &[u8] {
        &self.merged
    }

    /// The port from which a frame left; `None`: it is not ours.
    fn origin(&self, frame: &[u8]) -> Option<Port> {
        let found = passed(*frame.get(6..)?.first_chunk()?);
        match self.sources.map(passed) {
            [primary, _] if primary == found => Some(Port::Primary),
            [_, second] if second == found => Some(Port::Secondary),
            _ => None,
        }
    }

    fn find(&self, frame: &[u8]) -> Option<usize> {
        let start = payload_offset(frame).ok()?;
        // A truncated frame belongs to no slot.
        frame::payload(frame).ok()?;
        let same = |slot: &Slot| {
            slot.state != State::Free
                && slot.sent.get(12..start) == frame.get(12..start)
                && slot.sent.get(start + 1) == frame.get(start + 1)
        };
        self.slots.iter().position(same)
    }
}

impl Slot {
    fn new() -> Self {
        Self {
            state: State::Free,
            sent: Vec::with_capacity(MAX_LEN),
            came: Vec::with_capacity(MAX_LEN),
            first: Port::Primary,
            under_way: [false; 2],
            to_send: false,
            leader: None,
            expires: Time::ZERO,
            until: Time::NEVER,
        }
    }
}

fn passed(mut source: [u8; 6]) -> [u8; 6] {
    source[0] |= LOCALLY_ADMINISTERED;
    source
}

fn is_cyclic(frame: &[u8]) -> bool {
    let start = payload_offset(frame).unwrap_or(frame.len());
    frame.get(start + 1).is_some_and(|index| *index >= CYCLIC_INDEX)
}

/// Takes the working counters of a broadcast read on either side.
fn see(shared: &mut RingState, counts: merge::Counts) {
    if let Some((near, far)) = counts.broadcast {
        shared.view = View::Cut { near, far };
    }
}

/// Copies in a row that may be missing; after that frames of the cycle no longer wait for the other
/// copy.
const SILENT: u32 = 2;
/// The same for other frames, whose answers decide which SubDevices are lost: far more than a
/// disturbance takes.
const GONE: u32 = 10;

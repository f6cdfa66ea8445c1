//! The second port: a ring of SubDevices that one broken cable does not stop.
//!
//! Every frame leaves both ports at once, and what comes back becomes one frame for the rest of the machine.
//!
//! - **Whole ring.** Copy A, from the primary port, passes all SubDevices in processing order and arrives at the
//!   secondary port: it is the answer, and goes on as it is. Copy B, from the secondary port, runs against that
//!   order, is looked into by nobody, arrives at the primary port, and only shows that the ring is whole.
//! - **Cut ring.** Both copies turn at the cut and come back where they left, each processed by its part and in the
//!   same order of SubDevices: B turns first. They are merged. One of them may be missing, lost or because there is
//!   no cable at its port; then the other goes on alone behind a time ([`config::Ring::patience`]), and at once when
//!   that happens again and again.
//!
//! Each SubDevice is reached by one of the copies, so most commands mean in B what they mean in A. Those that don't
//! become NOP in B:
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
//! Working counters add up. The source address tells the copies apart: B's has the lowest bit of its last octet
//! inverted. Buffers are kept from frame to frame, so that nothing is allocated in operation.
//!
//! The way up is that of a line: [`close`] closes the port through which the last SubDevice sends to the secondary port,
//! and [`open`] opens it again. Delays stay true in the whole ring, as A goes the same way, and behind a cut,
//! as B passes those there in the same order; what it needs more it needs to all of them.

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
    /// The one in front of the first SubDevice.
    Primary,
    /// The other end of a ring, behind the last one.
    Secondary,
}

/// Frames under way in both directions.
pub(crate) struct Copies {
    sources: [[u8; 6]; 2],
    patience: Nanos,
    /// How long copies must have been missing at least until those behind their port are taken for gone.
    gone: Nanos,
    /// How long a copy can be under way: of a frame of the cycle, of another one.
    longest: [Nanos; 2],
    slots: Vec<Slot>,
    /// What two copies were made to.
    merged: Vec<u8>,
    /// When a copy from each port last came back.
    heard: [Time<Host>; 2],
    /// How many copies from each port did not come back since, while the other did.
    missed: [u32; 2],
    /// Leads the clocks behind the cut.
    pub leader: Option<StationAddress>,
    /// Copies that did not come back.
    pub lost: u64,
}

/// One frame.
struct Slot {
    state: State,
    /// As it left the primary port.
    sent: Vec<u8>,
    /// The copy that came back first, if it turned at a cut.
    came: Vec<u8>,
    /// Whom it came from.
    first: Port,
    /// Copies that are under way.
    under_way: [bool; 2],
    /// Copy B has not left yet.
    to_send: bool,
    leader: Option<StationAddress>,
    expires: Time<Host>,
    /// Until when the other copy is waited for.
    until: Time<Host>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Free,
    /// No copy is back.
    Out,
    /// One turned at a cut and is kept.
    Half,
    /// The machine has its answer; copies may still come.
    Done,
}

/// What becomes of a frame that came in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Taken {
    /// It goes on as it is.
    AsItIs,
    /// [`Copies::merged`] goes on in its place.
    Merged,
    /// Nothing goes on.
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

    /// A frame leaves the primary port; its copy is to leave the other.
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

    /// Writes the copy that is to leave the secondary port now.
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

    /// Takes a frame that came in at a port.
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
            // Nobody waits for it; the machine counts those that it knows.
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
                // It was at nobody's: what turned is all there is.
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

    /// A copy that turned at a cut.
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

    /// The copy that came goes on without the other. `silent`: the other has not come for long.
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

    /// A frame whose other copy is waited for no longer; to be called until it gives nothing.
    pub fn expire(&mut self, now: Time<Host>, shared: &mut RingState) -> Option<Taken> {
        let at = self.slots.iter().position(|slot| slot.until <= now)?;
        let slot = &mut self.slots[at];
        slot.until = Time::NEVER;
        let other = 1 - slot.first as usize;
        self.missed[other] = self.missed[other].saturating_add(1);
        if !is_cyclic(&slot.sent) && !self.is_gone(other, now) {
            // That nobody answers must be true: rather it is sent again.
            self.slots[at].state = State::Done;
            return Some(Taken::Kept);
        }
        let silent = self.missed[other] >= SILENT;
        Some(self.alone(at, silent, shared))
    }

    /// Whether nobody is behind a port any more.
    fn is_gone(&self, port: usize, now: Time<Host>) -> bool {
        self.missed[port] >= GONE && now - self.heard[port] >= self.gone
    }

    /// When a copy is waited for no longer.
    pub fn next_timeout(&self) -> Time<Host> {
        self.slots.iter().map(|slot| slot.until).fold(Time::NEVER, Time::min)
    }

    /// The frame that two copies, or one of them, were made to.
    pub fn merged(&self) -> &[u8] {
        &self.merged
    }

    /// From which port a frame left; `None`: it is none of ours.
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
        // Whatever is cut off is nobody's.
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

/// What a broadcast read counted on either side.
fn see(shared: &mut RingState, counts: merge::Counts) {
    if let Some((near, far)) = counts.broadcast {
        shared.view = View::Cut { near, far };
    }
}

/// Copies in a row that may be lost; behind that no frame of the cycle waits for the next.
const SILENT: u32 = 2;
/// The same for other frames, from which it follows who is lost: far more than a disturbance takes.
const GONE: u32 = 10;

//! Requests with the answers that belong to them.
//!
//! The first SubDevice sets bit 1 of the source address in what it sends back. A segment that
//! leaves it alone (0x0100 bit 0 = 0), a MainDevice whose own address has it, and a tap in the
//! middle of the line are paired by content: an answer has the datagrams of its request, and
//! differs from it.
//!
//! [`Pairing`] takes frames one by one and gives exchanges in the order of their requests. The
//! first [`LOOK_AHEAD`] frames decide how the tap saw the segment ([`Tap`]); from then on at most
//! [`MOST_OPEN`] requests and [`MOST_WAITING`] exchanges are held.

use std::collections::VecDeque;

use isocat_wire::Command;
use isocat_wire::datagram::{Header, datagrams};
use isocat_wire::frame::{self, FrameError, LOCALLY_ADMINISTERED};

use crate::reading::Frame;

mod tap;
#[cfg(test)]
mod tests;

pub use tap::{Seen, Tap};

/// A frame that went out, and what came back of it. At least one of them is there.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Exchange {
    /// As it passed the tap on its way to the devices behind it; `None`: it is not in the file.
    pub request: Option<Frame>,
    /// As it came back; `None`: it is not in the file.
    pub answer: Option<Frame>,
}

/// What was left out while pairing.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Tally {
    /// Frames that are none of EtherCAT, or without datagrams.
    pub foreign: usize,
    /// Frames of EtherCAT whose datagrams are cut off.
    pub broken: usize,
    /// Frames that the file has twice.
    pub duplicates: usize,
    /// Frames of interfaces that are not the tap.
    pub elsewhere: usize,
    /// Requests without an answer.
    pub unanswered: usize,
    /// Answers without a request.
    pub answers_alone: usize,
    /// Exchanges with both.
    pub pairs: usize,
}

/// Finds which frames belong together.
#[derive(Debug, Default)]
pub struct Pairing {
    /// What the first frames said; `None`: too few have come yet.
    tap: Option<Tap>,
    /// Frames that wait for that.
    ahead: Vec<(Frame, Signature)>,
    /// The first exchange of those that wait, by number.
    first: u64,
    /// Exchanges in the order of their requests, and whether each is complete.
    waiting: VecDeque<(Exchange, bool)>,
    open: VecDeque<Open>,
    last_answer: Option<Frame>,
    /// How long answers take on the average, ns.
    usual_ns: Option<u64>,
    tally: Tally,
    ended: bool,
}

/// A request that waits for its answer.
#[derive(Debug)]
struct Open {
    /// Number of its exchange.
    exchange: u64,
    at: u64,
    signature: Signature,
}

impl Pairing {
    /// Nothing is known yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes the next frame of the file.
    pub fn push(&mut self, frame: Frame) {
        let signature = match Signature::of(&frame.bytes) {
            Ok(signature) => signature,
            Err(true) => return self.tally.broken += 1,
            Err(false) => return self.tally.foreign += 1,
        };
        if let Some(tap) = self.tap {
            return self.take(tap, frame, signature);
        }
        self.ahead.push((frame, signature));
        if self.ahead.len() >= LOOK_AHEAD {
            self.decide();
        }
    }

    /// No more frames come: what is still open stays so.
    pub fn end(&mut self) {
        if self.tap.is_none() {
            self.decide();
        }
        self.ended = true;
    }

    /// The next exchange that is complete, or whose answer does not come any more.
    pub fn exchange(&mut self) -> Option<Exchange> {
        let complete = self.waiting.front()?.1;
        if !complete && !self.ended && self.waiting.len() < MOST_WAITING {
            return None;
        }
        let (exchange, _) = self.waiting.pop_front()?;
        while self.open.front().is_some_and(|open| open.exchange <= self.first) {
            self.open.pop_front();
        }
        self.first += 1;
        match (&exchange.request, &exchange.answer) {
            (_, None) => self.tally.unanswered += 1,
            (None, _) => self.tally.answers_alone += 1,
            _ => self.tally.pairs += 1,
        }
        Some(exchange)
    }

    /// What was left out so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// How the tap saw the segment; `None` before it is decided.
    pub fn tap(&self) -> Option<Tap> {
        self.tap
    }

    fn decide(&mut self) {
        let ahead = std::mem::take(&mut self.ahead);
        let tap = Tap::of(&ahead);
        self.tap = Some(tap);
        for (frame, signature) in ahead {
            self.take(tap, frame, signature);
        }
    }

    fn take(&mut self, tap: Tap, frame: Frame, signature: Signature) {
        if tap.interface.is_some_and(|interface| frame.interface != interface) {
            return self.tally.elsewhere += 1;
        }
        if tap.ring.is_some() && tap::source(&frame) != tap.ring {
            return self.tally.elsewhere += 1;
        }
        let at = nanos(&frame);
        self.give_up(at);
        let found = self.candidate(at, &signature);
        let is_answer = tap.is_answer(&frame);
        match found {
            Some(found) if self.comes_back(tap, &frame, found) => self.answered(found, at, frame),
            _ if is_answer => self.answer_alone(frame),
            Some(found) if self.is_copy(found, &frame) => self.tally.duplicates += 1,
            _ => self.request(at, frame, signature),
        }
    }

    /// The open request that an answer with this signature, seen at `at`, belongs to. Where a
    /// MainDevice gives all cyclic frames one index, requests whose frames were lost look alike:
    /// those that are much older than answers usually take are passed over.
    fn candidate(&self, at: u64, signature: &Signature) -> Option<usize> {
        let alike = || {
            let open = self.open.iter().enumerate();
            open.filter(|(_, open)| open.signature == *signature).map(|(place, _)| place)
        };
        let oldest = alike().next()?;
        let Some(usual) = self.usual_ns else { return Some(oldest) };
        let in_time = |place: &usize| at.saturating_sub(self.open[*place].at) <= 2 * usual + 20_000;
        alike().find(in_time).or_else(|| alike().next_back())
    }

    /// Requests whose answers do not come any more.
    fn give_up(&mut self, at: u64) {
        while let Some(open) = self.open.front() {
            let old = at.saturating_sub(open.at) >= GIVEN_UP_NS;
            if !old && self.open.len() < MOST_OPEN {
                return;
            }
            let place = (open.exchange - self.first) as usize;
            if let Some((_, complete)) = self.waiting.get_mut(place) {
                *complete = true;
            }
            self.open.pop_front();
        }
    }

    /// Whether this frame, whose datagrams are those of an open request, is its answer.
    fn comes_back(&self, tap: Tap, frame: &Frame, found: usize) -> bool {
        let Some(request) = self.request_of(found) else { return false };
        match tap.marked {
            true => tap.is_answer(frame),
            false if frame.sent == Some(true) && tap.behind == 0 => false,
            // Behind the tap nothing may have touched it.
            false => frame.bytes != request.bytes || tap.behind > 0,
        }
    }

    fn is_copy(&self, found: usize, frame: &Frame) -> bool {
        self.request_of(found).is_some_and(|request| is_copy(request, frame))
    }

    fn request_of(&self, found: usize) -> Option<&Frame> {
        let place = (self.open.get(found)?.exchange - self.first) as usize;
        self.waiting.get(place)?.0.request.as_ref()
    }

    fn answered(&mut self, found: usize, at: u64, frame: Frame) {
        let Some(open) = self.open.remove(found) else { return };
        let mut passed_over = 0;
        for old in self.open.iter().take(found).filter(|old| old.signature == open.signature) {
            // Frames do not overtake one another: that one is lost.
            if let Some(waiting) = self.waiting.get_mut((old.exchange - self.first) as usize) {
                waiting.1 = true;
            }
            passed_over += 1;
        }
        if passed_over > 0 {
            let mut place = 0;
            self.open.retain(|old| {
                place += 1;
                place > found || old.signature != open.signature
            });
        }
        let took = at.saturating_sub(open.at);
        // A running mean over some sixteen answers.
        self.usual_ns = Some(self.usual_ns.map_or(took, |usual| usual - usual / 16 + took / 16));
        if let Some(waiting) = self.waiting.get_mut((open.exchange - self.first) as usize) {
            waiting.0.answer = Some(frame.clone());
            waiting.1 = true;
        }
        self.last_answer = Some(frame);
    }

    fn answer_alone(&mut self, frame: Frame) {
        if self.last_answer.as_ref().is_some_and(|last| is_copy(last, &frame)) {
            return self.tally.duplicates += 1;
        }
        self.last_answer = Some(frame.clone());
        self.waiting.push_back((Exchange { request: None, answer: Some(frame) }, true));
    }

    fn request(&mut self, at: u64, frame: Frame, signature: Signature) {
        let exchange = self.first + self.waiting.len() as u64;
        self.waiting.push_back((Exchange { request: Some(frame), answer: None }, false));
        self.open.push_back(Open { exchange, at, signature });
    }
}

/// What an answer has in common with its request: its datagrams without what ESCs change in them.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Signature(Vec<(u8, u8, u32, u16)>);

impl Signature {
    /// `Err(true)`: a frame of EtherCAT whose datagrams can't be read; `Err(false)`: none of
    /// EtherCAT.
    fn of(bytes: &[u8]) -> Result<Self, bool> {
        let payload =
            frame::payload(bytes).map_err(|error| matches!(error, FrameError::Length { .. }))?;
        let mut list = Vec::new();
        for datagram in datagrams(payload) {
            let Header { command, index, address, len, .. } = datagram.map_err(|_| true)?.header;
            let counts = Command::try_from(command).is_ok_and(Command::increments_position);
            let address = if counts { address & 0xFFFF_0000 } else { address };
            list.push((command, index, address, len));
        }
        if list.is_empty() { Err(true) } else { Ok(Self(list)) }
    }
}

/// Whether the file has a frame twice, as a mirror of both ports of a switch does.
fn is_copy(one: &Frame, other: &Frame) -> bool {
    nanos(other).abs_diff(nanos(one)) < TWICE_NS && one.bytes == other.bytes
}

fn nanos(frame: &Frame) -> u64 {
    u64::try_from(frame.at.as_nanos()).unwrap_or(u64::MAX)
}

fn is_marked(bytes: &[u8]) -> bool {
    bytes.get(SOURCE).is_some_and(|octet| octet & LOCALLY_ADMINISTERED != 0)
}

/// Offset of the source address.
const SOURCE: usize = 6;
/// The same frame again within this time is one frame, seen twice.
const TWICE_NS: u64 = 100_000;
/// What has not come back by then does not come any more.
const GIVEN_UP_NS: u64 = 1_000_000_000;
/// Requests that wait for their answers at once.
pub const MOST_OPEN: usize = 256;
/// Exchanges that wait for an answer before them. A MainDevice with a cycle of 100 us sends this
/// number in 1.6 s.
pub const MOST_WAITING: usize = 16_384;
/// EtherCAT frames that are looked at before the first one is paired.
pub const LOOK_AHEAD: usize = 8192;

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
    /// The last answers, by which the same ones again are known as copies.
    last_answers: VecDeque<Frame>,
    /// Answers that no request was seen to, and whose request may still follow.
    early: VecDeque<Early>,
    taken: u64,
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
    /// Frames that were taken before it.
    taken: u64,
}

/// An answer that stands before its request in the file.
#[derive(Debug)]
struct Early {
    exchange: u64,
    at: u64,
    signature: Signature,
    /// Frames that were taken before it.
    taken: u64,
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

    /// Decides how the tap sees the segment by the frames so far, if answers are among them, and
    /// does not wait for more: for frames that are looked at as they come. Tells whether it is
    /// decided.
    pub fn decide_early(&mut self) -> bool {
        if self.tap.is_none() && Tap::of(&self.ahead).seen != Seen::Out {
            self.decide();
        }
        self.tap.is_some()
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
        while self.early.front().is_some_and(|early| early.exchange <= self.first) {
            self.early.pop_front();
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
        self.taken += 1;
        self.let_go();
        let is_answer = tap.is_answer(&frame);
        self.give_up(at);
        let found = self.candidate(at, &signature);
        match found {
            Some(found) if self.comes_back(tap, &frame, at, found) => {
                self.answered(found, at, frame)
            }
            _ if is_answer || self.is_again(tap, &frame) => {
                self.answer_alone(tap, at, frame, signature);
            }
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
        let in_time =
            |place: &usize| at.saturating_sub(self.open[*place].at) <= 2 * usual + SHORT_NS;
        alike().find(in_time).or_else(|| alike().next_back())
    }

    /// Requests whose answers do not come any more.
    fn give_up(&mut self, at: u64) {
        while let Some(open) = self.open.front() {
            // One frame alone may be late because the stamps jump.
            let few = self.taken - open.taken < GIVEN_UP_FRAMES;
            let old = at.saturating_sub(open.at) >= GIVEN_UP_NS && !few;
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
    fn comes_back(&self, tap: Tap, frame: &Frame, at: u64, found: usize) -> bool {
        let Some(request) = self.request_of(found) else { return false };
        match tap.marked {
            true => tap.is_answer(frame),
            false if frame.sent == Some(true) && tap.behind == 0 => false,
            false if tap.directed && frame.sent == request.sent => false,
            // The file tells directions: an answer in which no SubDevice counted looks like its
            // request.
            false if (request.sent, frame.sent) == (Some(true), Some(false)) => true,
            // Behind the tap nothing may have touched it; and a request with the same index may find
            // the one before still without answer. The way to the end of the segment is short.
            false if tap.behind > 0 => {
                let usual = self.usual_ns.unwrap_or(u64::MAX / 4);
                !tap::counts(frame).eq(tap::counts(request))
                    || at.saturating_sub(self.open[found].at) <= 2 * usual + SHORT_NS
            }
            false => frame.bytes != request.bytes,
        }
    }

    fn is_copy(&self, found: usize, frame: &Frame) -> bool {
        self.request_of(found).is_some_and(|request| is_copy(request, frame))
    }

    /// Whether this frame, which its source address does not tell to be an answer, is one of the last
    /// answers again: requests leave with working counters of 0.
    fn is_again(&self, tap: Tap, frame: &Frame) -> bool {
        tap.behind == 0
            && self.last_answers.iter().any(|last| last.bytes == frame.bytes)
            && counted(&frame.bytes)
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
        self.remember(frame);
    }

    fn remember(&mut self, answer: Frame) {
        if self.last_answers.len() >= COPIES {
            self.last_answers.pop_front();
        }
        self.last_answers.push_back(answer);
    }

    fn answer_alone(&mut self, tap: Tap, at: u64, frame: Frame, signature: Signature) {
        if self.last_answers.iter().any(|last| is_copy(last, &frame)) {
            return self.tally.duplicates += 1;
        }
        self.remember(frame.clone());
        let waits = tap.seen == Seen::Both;
        if waits {
            let exchange = self.first + self.waiting.len() as u64;
            self.early.push_back(Early { exchange, at, signature, taken: self.taken });
        }
        self.waiting.push_back((Exchange { request: None, answer: Some(frame) }, !waits));
    }

    fn request(&mut self, at: u64, frame: Frame, signature: Signature) {
        let is_its = |early: &Early| {
            let later = early.at.checked_sub(at);
            early.signature == signature && later.is_some_and(|ns| (1..EARLY_NS).contains(&ns))
        };
        if let Some(early) = self.early.iter().position(is_its) {
            let Some(Early { exchange, .. }) = self.early.remove(early) else { return };
            if let Some(waiting) = self.waiting.get_mut((exchange - self.first) as usize) {
                waiting.0.request = Some(frame);
                waiting.1 = true;
            }
            return;
        }
        let exchange = self.first + self.waiting.len() as u64;
        self.waiting.push_back((Exchange { request: Some(frame), answer: None }, false));
        self.open.push_back(Open { exchange, at, signature, taken: self.taken });
    }

    /// Answers whose requests do not follow any more.
    fn let_go(&mut self) {
        let old = |early: &Early| self.taken - early.taken > EARLY;
        while self.early.front().is_some_and(old) {
            let Some(early) = self.early.pop_front() else { return };
            if let Some(waiting) = self.waiting.get_mut((early.exchange - self.first) as usize) {
                waiting.1 = true;
            }
        }
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

/// Whether any SubDevice has counted in a frame.
fn counted(bytes: &[u8]) -> bool {
    let payload = frame::payload(bytes).unwrap_or(&[]);
    datagrams(payload).map_while(Result::ok).any(|datagram| datagram.wkc > 0)
}

/// Whether the file has a frame twice, as a mirror of both ports of a switch does. One of them may
/// have a VLAN tag and padding that the other one lacks.
fn is_copy(one: &Frame, other: &Frame) -> bool {
    let source =
        |frame: &Frame| frame.bytes.get(SOURCE..).and_then(|rest| rest.first_chunk::<6>()).copied();
    nanos(other).abs_diff(nanos(one)) < TWICE_NS
        && frame::payload(&one.bytes) == frame::payload(&other.bytes)
        && source(one) == source(other)
}

fn nanos(frame: &Frame) -> u64 {
    u64::try_from(frame.at.as_nanos()).unwrap_or(u64::MAX)
}

/// Whether a frame's source address has the bit that the first SubDevice sets.
pub fn is_marked(bytes: &[u8]) -> bool {
    bytes.get(SOURCE).is_some_and(|octet| octet & LOCALLY_ADMINISTERED != 0)
}

/// Offset of the source address.
const SOURCE: usize = 6;
/// The same frame again within this time is one frame, seen twice.
const TWICE_NS: u64 = 100_000;
/// What has not come back by then does not come any more.
const GIVEN_UP_NS: u64 = 1_000_000_000;
/// Answers take twice as long as usual and this at most, as far as time alone tells them.
const SHORT_NS: u64 = 20_000;
/// Answers among which a copy is looked for.
const COPIES: usize = 8;
/// Frames behind an answer among which its request is looked for, where packets are out of order.
const EARLY: u64 = 8;
/// The stamp of such a request lies less than this before that of its answer.
const EARLY_NS: u64 = 1_000_000;
/// Frames behind a request before which it is not given up.
const GIVEN_UP_FRAMES: u64 = 16;
/// Requests that wait for their answers at once.
pub const MOST_OPEN: usize = 256;
/// Exchanges that wait for an answer before them. A MainDevice with a cycle of 100 us sends this
/// number in 1.6 s.
pub const MOST_WAITING: usize = 16_384;
/// EtherCAT frames that are looked at before the first one is paired.
pub const LOOK_AHEAD: usize = 8192;

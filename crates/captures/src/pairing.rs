//! Pairs requests with their answers.
//!
//! The first SubDevice sets bit 1 of the source address in the frames that it sends back. Frames
//! are paired by content instead if the segment does not set it (0x0100 bit 0 = 0), if the
//! MainDevice's own address has it, or if the tap is in the middle of the line: an answer has the
//! datagrams of its request, and differs from it.
//!
//! [`Pairing`] takes frames one by one and returns exchanges in the order of their requests. The
//! first [`LOOK_AHEAD`] frames decide how the tap saw the segment ([`Tap`]); from then on it holds
//! at most [`MOST_OPEN`] requests and [`MOST_WAITING`] exchanges.

use std::collections::VecDeque;

use isocat_wire::Command;
use isocat_wire::datagram::{Header, datagrams};
use isocat_wire::frame::{self, FrameError, LOCALLY_ADMINISTERED};

use crate::reading::Frame;

mod tap;
#[cfg(test)]
mod tests;

pub use tap::{Seen, Tap};

/// A frame on its way out, and the same frame on its way back. At least one of them is present.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Exchange {
    /// The frame that passed the tap towards the devices behind it; `None`: it is not in the file.
    pub request: Option<Frame>,
    /// The frame that came back; `None`: it is not in the file.
    pub answer: Option<Frame>,
}

/// What pairing found and left out.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Tally {
    /// Frames that are not EtherCAT, or have no datagrams.
    pub foreign: usize,
    /// EtherCAT frames whose datagrams are cut off.
    pub broken: usize,
    /// Frames that the file has twice.
    pub duplicates: usize,
    /// Frames of interfaces other than the tap.
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
    /// How the tap saw the segment, by the first frames; `None`: not decided yet.
    tap: Option<Tap>,
    /// Frames that wait for the decision on the tap.
    ahead: Vec<(Frame, Signature)>,
    /// Number of the first exchange in `waiting`.
    first: u64,
    /// Exchanges in the order of their requests, and whether each is complete.
    waiting: VecDeque<(Exchange, bool)>,
    open: VecDeque<Open>,
    /// The last answers: an equal frame is a copy.
    last_answers: VecDeque<Frame>,
    /// Answers without a request so far, whose request may still follow.
    early: VecDeque<Early>,
    taken: u64,
    /// Mean time of answers, ns.
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

/// An answer that precedes its request in the file.
#[derive(Debug)]
struct Early {
    exchange: u64,
    at: u64,
    signature: Signature,
    /// Frames that were taken before it.
    taken: u64,
}

impl Pairing {
    /// A pairing without frames.
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
    /// does not wait for more: for frames that are processed as they come. Returns whether it is
    /// decided.
    pub fn decide_early(&mut self) -> bool {
        if self.tap.is_none() && Tap::of(&self.ahead).seen != Seen::Out {
            self.decide();
        }
        self.tap.is_some()
    }

    /// Ends the pairing: requests that are still open have no answer.
    pub fn end(&mut self) {
        if self.tap.is_none() {
            self.decide();
        }
        self.ended = true;
    }

    /// The next exchange that is complete, or whose answer can no longer come.
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

    /// What was found and left out so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// How the tap saw the segment; `None`: not decided yet.
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

    /// The open request that belongs to an answer with this signature, seen at `at`. If a
    /// MainDevice gives all cyclic frames the same index, requests whose frames were lost look
    /// alike: requests that are much older than answers usually take are skipped.
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

    /// Gives up requests whose answers can no longer come.
    fn give_up(&mut self, at: u64) {
        while let Some(open) = self.open.front() {
            // A single frame may seem late because the stamps jump.
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

    /// Whether this frame, which has the datagrams of an open request, is its answer.
    fn comes_back(&self, tap: Tap, frame: &Frame, at: u64, found: usize) -> bool {
        let Some(request) = self.request_of(found) else { return false };
        match tap.marked {
            // A first SubDevice that was told not to mark frames (0x0100) counts all the same.
            true => {
                let counts = || !tap::counts(frame).eq(tap::counts(request));
                tap.is_answer(frame) || counted(&frame.bytes) && counts()
            }
            false if frame.sent == Some(true) && tap.behind == 0 => false,
            false if tap.directed && frame.sent == request.sent => false,
            // The file states the direction: an answer that no SubDevice counted in looks like its
            // request.
            false if (request.sent, frame.sent) == (Some(true), Some(false)) => true,
            // The devices behind the tap may not have touched the answer, so it may look like its
            // request. A later request with the same index looks the same, but comes later than an
            // answer, whose way to the end of the segment is short.
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

    /// Whether this frame, whose source address does not mark it as an answer, repeats one of the
    /// last answers. Requests leave with working counters of 0, so it is no request if a working
    /// counter is above 0.
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
            // Frames do not overtake one another: the older frame is lost.
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
        // A moving mean over about 16 answers.
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

    /// Completes answers whose requests can no longer follow.
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

/// What an answer shares with its request: its datagrams without the parts that ESCs change.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Signature(Vec<(u8, u8, u32, u16)>);

impl Signature {
    /// `Err(true)`: an EtherCAT frame whose datagrams can't be read; `Err(false)`: not an EtherCAT
    /// frame.
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

/// Whether any SubDevice counted in a frame.
fn counted(bytes: &[u8]) -> bool {
    let payload = frame::payload(bytes).unwrap_or(&[]);
    datagrams(payload).map_while(Result::ok).any(|datagram| datagram.wkc > 0)
}

/// Whether two frames are the same one, captured twice, as by a mirror of both ports of a switch.
/// One may have a VLAN tag and padding that the other one lacks.
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
/// The same frame within this time is one frame that was captured twice.
const TWICE_NS: u64 = 100_000;
/// A frame that has not come back after this time is lost.
const GIVEN_UP_NS: u64 = 1_000_000_000;
/// If only the time tells an answer, it takes at most twice the usual time plus this.
const SHORT_NS: u64 = 20_000;
/// Number of last answers that are kept to find copies.
const COPIES: usize = 8;
/// Number of frames after an answer in which its request is searched, if packets are out of order.
const EARLY: u64 = 8;
/// The stamp of such a request is earlier than that of its answer by less than this.
const EARLY_NS: u64 = 1_000_000;
/// Number of frames after a request before it can be given up.
const GIVEN_UP_FRAMES: u64 = 16;
/// Requests that can wait for their answers at the same time.
pub const MOST_OPEN: usize = 256;
/// Exchanges that can wait for an answer before them. A MainDevice with a cycle of 100 us sends
/// this number in 1.6 s.
pub const MOST_WAITING: usize = 16_384;
/// EtherCAT frames that are read before the first one is paired.
pub const LOOK_AHEAD: usize = 8192;

//! A bus in virtual time: the served segment with a clock that its caller moves.
//!
//! Frames go in at given instants, and each answer waits until its last bit is back. There is no
//! real clock, socket or thread here, so the same calls give the same answers, bit for bit. The
//! interfaces for programs use it: C, and tests in Rust.
//!
//! Time moves only when the caller says so, and never back. The size of the steps changes nothing:
//! SubDevices are updated when a frame comes, when the caller asks for their state, and ten times a
//! second.

use std::collections::VecDeque;
use std::fmt;

use isocat_sim::MainPort;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, AlStatusCode, frame};

use crate::{Answer, Event, Order, Server, Setup, Summary};

/// The longest virtual time of a bus: a month. The segment's own time counts picoseconds and would
/// reach its end after three months.
pub const LONGEST: Nanos = Nanos::millis(30 * 24 * 3_600_000);
/// The largest step of time: an hour, which takes seconds to compute while SYNC pulses come each
/// millisecond.
pub const LONGEST_STEP: Nanos = Nanos::millis(3_600_000);
/// Number of answers and events that may wait for the caller. Further answers are lost, as at a
/// port whose memory is full; of events the oldest are dropped.
pub const MOST_WAITING: usize = 8_192;
/// Allowed lengths of frames in bytes, from the destination address on, without check sequence.
pub const LENGTHS: std::ops::RangeInclusive<usize> = frame::ETHERNET_HEADER_LEN..=frame::MAX_LEN;

/// A segment in virtual time.
///
/// - [`send`](Self::send) frames; this moves time to their instants.
/// - [`advance`](Self::advance) time, to [`next_arrival`](Self::next_arrival) or to any other
///   instant that the caller waits for.
/// - [`receive`](Self::receive) the answers that are back by then.
/// - [`outputs`](Self::outputs), [`set_inputs`](Self::set_inputs), [`inject`](Self::inject) at any
///   time.
/// - [`summary`](Self::summary) at any time, and at the end after [`finish`](Self::finish).
pub struct Bus {
    server: Server,
    began: Time<Host>,
    now: Time<Host>,
    /// The instant of the last update of the SubDevices.
    looked: Time<Host>,
    /// Answers under way, in the order of their arrival and then of their frames.
    arrivals: VecDeque<Arrival>,
    events: VecDeque<Event>,
    /// Number of answers that were lost because too many waited.
    overrun: u64,
}

/// An answer that is back at the MainDevice.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// The instant at which its last bit has arrived.
    pub at: Time<Host>,
    /// The port at which it arrives: in a whole ring this is not the one that the frame left.
    pub port: MainPort,
    /// Its bytes, from the destination address on, without check sequence.
    pub frame: Vec<u8>,
}

/// Why a call is refused. A refused call has no effect.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refused {
    /// The instant lies before the present.
    Backwards {
        /// The requested instant.
        at: Time<Host>,
        /// The present instant.
        now: Time<Host>,
    },
    /// The instant is too far ahead.
    TooFar {
        /// The requested instant.
        at: Time<Host>,
        /// The latest instant that is allowed.
        latest: Time<Host>,
    },
    /// No frame has this number of bytes.
    Length(usize),
    /// There is no such port, since the segment is not a ring.
    NoSuchPort,
}

impl Bus {
    /// A segment that is switched on at `now` of the caller's clock.
    pub fn new(setup: impl Into<Setup>, now: Time<Host>) -> Self {
        Self {
            server: Server::new(setup, now),
            began: now,
            now,
            looked: now,
            arrivals: VecDeque::new(),
            events: VecDeque::new(),
            overrun: 0,
        }
    }

    /// Sends a frame, whose first bit leaves the port at `at` or as soon as the frame before it has
    /// left. Returns whether and when it comes back; from then on [`receive`](Self::receive)
    /// returns it.
    pub fn send(
        &mut self,
        port: MainPort,
        at: Time<Host>,
        frame: &[u8],
    ) -> Result<Answer, Refused> {
        if !LENGTHS.contains(&frame.len()) {
            return Err(Refused::Length(frame.len()));
        }
        if port == MainPort::Secondary && !self.server.has_two_ports() {
            return Err(Refused::NoSuchPort);
        }
        self.advance(at)?;
        let mut bytes = frame.to_vec();
        let answer = self.server.frame_at(port, at, &mut bytes);
        self.server.after(&bytes);
        self.looked = at;
        if let Answer::Back { port, last_bit, .. } = answer {
            self.expect(Arrival { at: last_bit, port, frame: bytes });
        }
        while let Some((port, at, frame)) = self.server.take_copy() {
            self.expect(Arrival { at, port, frame });
        }
        self.take_events();
        Ok(answer)
    }

    /// The instant at which the next answer is back. It is in the past if an answer is already
    /// waiting.
    pub fn next_arrival(&self) -> Option<Time<Host>> {
        self.arrivals.front().map(|arrival| arrival.at)
    }

    /// The next answer, if it is back by now; [`receive`](Self::receive) takes it.
    pub fn peek(&self) -> Option<&Arrival> {
        self.arrivals.front().filter(|arrival| arrival.at <= self.now)
    }

    /// The next answer at one port, if it is back by now.
    pub fn peek_at(&self, port: MainPort) -> Option<&Arrival> {
        self.arrivals.get(self.next_at(port)?)
    }

    /// Takes the next answer that is back by now.
    pub fn receive(&mut self) -> Option<Arrival> {
        self.peek()?;
        self.arrivals.pop_front()
    }

    /// Takes the next answer at one port that is back by now; answers at the other port stay.
    pub fn receive_at(&mut self, port: MainPort) -> Option<Arrival> {
        let place = self.next_at(port)?;
        self.arrivals.remove(place)
    }

    fn next_at(&self, port: MainPort) -> Option<usize> {
        let mut back = self.arrivals.iter().take_while(|arrival| arrival.at <= self.now);
        back.position(|arrival| arrival.port == port)
    }

    /// Moves time to `to`.
    pub fn advance(&mut self, to: Time<Host>) -> Result<(), Refused> {
        self.check_within(to, LONGEST_STEP)?;
        while let Some(due) = self.server.next_timeout(self.looked).filter(|due| *due <= to) {
            self.look(due);
        }
        self.now = to;
        Ok(())
    }

    /// The next instant at which SubDevices are updated without a frame, for callers that wait.
    /// [`advance`](Self::advance) does these updates on its way.
    pub fn next_timeout(&self) -> Option<Time<Host>> {
        self.server.next_timeout(self.looked)
    }

    /// The present.
    pub fn now(&self) -> Time<Host> {
        self.now
    }

    /// The outputs that the device at `position` took last; `None` while they are in their safe
    /// state, or if there is no such device.
    pub fn outputs(&mut self, position: usize) -> Option<Vec<u8>> {
        self.look(self.now);
        self.server.outputs(position)
    }

    /// Sets the inputs of the device at `position` from now on; `None` returns them to its
    /// application.
    pub fn set_inputs(&mut self, position: usize, inputs: Option<&[u8]>) {
        self.look(self.now);
        self.server.set_inputs(position, inputs);
    }

    /// The state of the device at `position`, and its AL status code; `None` if there is no such
    /// device.
    pub fn state(&mut self, position: usize) -> Option<(AlState, AlStatusCode)> {
        self.look(self.now);
        let stack = &self.server.served().segment().devices().get(position)?.stack;
        Some((stack.state(), stack.status_code()))
    }

    /// Injects a fault now.
    pub fn inject(&mut self, order: Order) -> Result<(), String> {
        self.look(self.now);
        self.server.inject(self.now, order)
    }

    /// Plans a fault for a later instant, see [`check_plan`](Self::check_plan).
    pub fn inject_at(&mut self, at: Time<Host>, order: Order) -> Result<(), String> {
        self.check_plan(at).map_err(|refused| refused.to_string())?;
        self.server.inject_at(at, order)
    }

    /// Whether a fault can be planned for this instant: now, or later in the life of the bus.
    pub fn check_plan(&self, at: Time<Host>) -> Result<(), Refused> {
        self.check_within(at, LONGEST)
    }

    /// Sets or removes the link at a port of the MainDevice.
    pub fn link(&mut self, port: MainPort, up: bool) -> Result<(), Refused> {
        if port == MainPort::Secondary && !self.server.has_two_ports() {
            return Err(Refused::NoSuchPort);
        }
        self.look(self.now);
        self.server.link(self.now, port, up);
        Ok(())
    }

    /// Takes the next event.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// What happened so far, and the judges' present verdict. The current session continues.
    pub fn summary(&mut self, segment_file: &str, interface: &str) -> Summary {
        self.looked = self.now;
        self.server.take_stock(self.now);
        self.take_events();
        Summary::new(&self.server, segment_file, interface, self.now - self.began)
    }

    /// Ends the MainDevice's session at its last frame. If the MainDevice sends again, another
    /// session begins.
    pub fn finish(&mut self) {
        self.look(self.now);
        self.server.finish(self.now);
        self.take_events();
    }

    /// Number of answers that were lost because [`MOST_WAITING`] were waiting.
    pub fn overrun(&self) -> u64 {
        self.overrun
    }

    /// The segment, for inspection.
    pub fn server(&self) -> &Server {
        &self.server
    }

    fn expect(&mut self, arrival: Arrival) {
        if self.arrivals.len() >= MOST_WAITING {
            self.overrun += 1;
            return;
        }
        let place = self.arrivals.partition_point(|other| other.at <= arrival.at);
        self.arrivals.insert(place, arrival);
    }

    /// Updates the SubDevices up to `at`.
    fn look(&mut self, at: Time<Host>) {
        self.looked = at;
        self.server.idle(at);
        self.take_events();
    }

    fn take_events(&mut self) {
        while let Some(event) = self.server.poll_event() {
            if self.events.len() >= MOST_WAITING {
                self.events.pop_front();
            }
            self.events.push_back(event);
        }
    }

    fn check_within(&self, at: Time<Host>, ahead: Nanos) -> Result<(), Refused> {
        let later = |at: Time<Host>, span: Nanos| at.count().saturating_add_signed(span.0);
        let latest = Time::new(later(self.now, ahead).min(later(self.began, LONGEST)));
        match at {
            at if at < self.now => Err(Refused::Backwards { at, now: self.now }),
            at if at > latest => Err(Refused::TooFar { at, latest }),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Backwards { at, now } => {
                let (at, now) = (at.count(), now.count());
                write!(f, "the instant {at} ns has passed; expected {now} ns or later")
            }
            Self::TooFar { at, latest } => {
                let (at, latest) = (at.count(), latest.count());
                write!(f, "the instant {at} ns is too far ahead; expected {latest} ns at most")
            }
            Self::Length(length) => {
                let (least, most) = (LENGTHS.start(), LENGTHS.end());
                write!(f, "a frame of {length} bytes; expected {least} to {most}")
            }
            Self::NoSuchPort => {
                write!(
                    f,
                    "port 1 is the other end of a ring, and this segment is none; expected port 0"
                )
            }
        }
    }
}

impl std::error::Error for Refused {}

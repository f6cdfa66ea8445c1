//! A bus in virtual time: the served segment behind a clock that its caller moves.
//!
//! Frames go in at instants, and each answer waits until its last bit is back. Nothing here knows a
//! real clock, a socket or a thread, so the same calls give the same answers, bit for bit. Doors
//! for programs stand on it: C, tests in Rust.
//!
//! Time moves when the caller says so, and never back. How often it is moved changes nothing:
//! SubDevices are looked at when a frame comes, when the caller asks for what they do, and ten
//! times a second.

use std::collections::VecDeque;
use std::fmt;

use isocat_sim::MainPort;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, AlStatusCode, frame};

use crate::{Answer, Event, Order, Server, Setup, Summary};

/// The longest virtual time of a bus: a month. The segment's own time counts picoseconds, which
/// last for three of them.
pub const LONGEST: Nanos = Nanos::millis(30 * 24 * 3_600_000);
/// How far time moves at once at most: an hour, which takes seconds while SYNC pulses come each
/// millisecond.
pub const LONGEST_STEP: Nanos = Nanos::millis(3_600_000);
/// Answers and events that may wait for a caller who does not take them. More answers are lost, as
/// at a port whose memory is full; of events the oldest go.
pub const MOST_WAITING: usize = 8_192;
/// Lengths of frames, bytes from the destination address on, without check sequence.
pub const LENGTHS: std::ops::RangeInclusive<usize> = frame::ETHERNET_HEADER_LEN..=frame::MAX_LEN;

/// A segment in virtual time.
///
/// - [`send`](Self::send) frames; time goes on to their instants.
/// - [`advance`](Self::advance) time, to [`next_arrival`](Self::next_arrival) or to whatever the
///   caller waits for.
/// - [`receive`](Self::receive) what is back by then.
/// - [`outputs`](Self::outputs), [`set_inputs`](Self::set_inputs), [`inject`](Self::inject) on the
///   way.
/// - [`summary`](Self::summary) at any time, and at the end after [`finish`](Self::finish).
pub struct Bus {
    server: Server,
    began: Time<Host>,
    now: Time<Host>,
    /// When the segment was looked at last.
    looked: Time<Host>,
    /// Answers under way, by the instant at which they are back, and then in the order of their
    /// frames.
    arrivals: VecDeque<Arrival>,
    events: VecDeque<Event>,
    /// Answers that were lost since too many waited.
    overrun: u64,
}

/// An answer, back at the MainDevice.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// When its last bit is there.
    pub at: Time<Host>,
    /// At which port: in a whole ring not at the one that the frame left.
    pub port: MainPort,
    /// From the destination address on, without check sequence.
    pub frame: Vec<u8>,
}

/// Why a call is refused. Nothing has happened then.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refused {
    /// The instant lies before one that has come.
    Backwards {
        /// What was asked for.
        at: Time<Host>,
        /// The present.
        now: Time<Host>,
    },
    /// The instant is too far ahead.
    TooFar {
        /// What was asked for.
        at: Time<Host>,
        /// The latest that is taken.
        latest: Time<Host>,
    },
    /// No frame has so many bytes.
    Length(usize),
    /// There is no such port: the segment is no ring.
    NoSuchPort,
}

impl Bus {
    /// A segment that is switched on at `now`, on the caller's clock.
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
    /// left. Gives whether and when it comes back; [`receive`](Self::receive) has it then.
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

    /// When the next answer is back; earlier than the present where one waits to be taken.
    pub fn next_arrival(&self) -> Option<Time<Host>> {
        self.arrivals.front().map(|arrival| arrival.at)
    }

    /// The next answer, if it is back by now; [`receive`](Self::receive) takes it.
    pub fn peek(&self) -> Option<&Arrival> {
        self.arrivals.front().filter(|arrival| arrival.at <= self.now)
    }

    /// The same at one port.
    pub fn peek_at(&self, port: MainPort) -> Option<&Arrival> {
        self.arrivals.get(self.next_at(port)?)
    }

    /// Takes the next answer that is back by now.
    pub fn receive(&mut self) -> Option<Arrival> {
        self.peek()?;
        self.arrivals.pop_front()
    }

    /// The same at one port: answers at the other one stay.
    pub fn receive_at(&mut self, port: MainPort) -> Option<Arrival> {
        let place = self.next_at(port)?;
        self.arrivals.remove(place)
    }

    fn next_at(&self, port: MainPort) -> Option<usize> {
        let mut back = self.arrivals.iter().take_while(|arrival| arrival.at <= self.now);
        back.position(|arrival| arrival.port == port)
    }

    /// Time goes on to `to`.
    pub fn advance(&mut self, to: Time<Host>) -> Result<(), Refused> {
        self.check_within(to, LONGEST_STEP)?;
        while let Some(due) = self.server.next_timeout(self.looked).filter(|due| *due <= to) {
            self.look(due);
        }
        self.now = to;
        Ok(())
    }

    /// When SubDevices are looked at next without a frame, for callers that wait:
    /// [`advance`](Self::advance) does it on its way.
    pub fn next_timeout(&self) -> Option<Time<Host>> {
        self.server.next_timeout(self.looked)
    }

    /// The present.
    pub fn now(&self) -> Time<Host> {
        self.now
    }

    /// The outputs of the device at `position`, as it took them last; `None` while they are in
    /// their safe state, and where there is no such device.
    pub fn outputs(&mut self, position: usize) -> Option<Vec<u8>> {
        self.look(self.now);
        self.server.outputs(position)
    }

    /// Sets the inputs of the device at `position` from now on; `None` gives them back to its
    /// application.
    pub fn set_inputs(&mut self, position: usize, inputs: Option<&[u8]>) {
        self.look(self.now);
        self.server.set_inputs(position, inputs);
    }

    /// The state of the device at `position`, and why it is there; `None` where there is no such
    /// device.
    pub fn state(&mut self, position: usize) -> Option<(AlState, AlStatusCode)> {
        self.look(self.now);
        let stack = &self.server.served().segment().devices().get(position)?.stack;
        Some((stack.state(), stack.status_code()))
    }

    /// Lets something go wrong now.
    pub fn inject(&mut self, order: Order) -> Result<(), String> {
        self.look(self.now);
        self.server.inject(self.now, order)
    }

    /// Plans that something goes wrong at an instant to come, see [`check_plan`](Self::check_plan).
    pub fn inject_at(&mut self, at: Time<Host>, order: Order) -> Result<(), String> {
        self.check_plan(at).map_err(|refused| refused.to_string())?;
        self.server.inject_at(at, order)
    }

    /// Whether something can be planned for this instant: now, or later in the life of the bus.
    pub fn check_plan(&self, at: Time<Host>) -> Result<(), Refused> {
        self.check_within(at, LONGEST)
    }

    /// The link at a port of the MainDevice goes away, or comes.
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

    /// What happened so far, and the judges' verdict as of now. The session under way goes on.
    pub fn summary(&mut self, segment_file: &str, interface: &str) -> Summary {
        self.looked = self.now;
        self.server.take_stock(self.now);
        self.take_events();
        Summary::new(&self.server, segment_file, interface, self.now - self.began)
    }

    /// The MainDevice is done: its session ends as of its last frame. One that sends again begins
    /// another.
    pub fn finish(&mut self) {
        self.look(self.now);
        self.server.finish(self.now);
        self.take_events();
    }

    /// Answers that were lost since [`MOST_WAITING`] were not taken.
    pub fn overrun(&self) -> u64 {
        self.overrun
    }

    /// The segment, to look at.
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

    /// Lets SubDevices do what they do by themselves up to `at`.
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

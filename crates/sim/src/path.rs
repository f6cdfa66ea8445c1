//! The way of a frame through the segment: the ESC ports that it reaches, with their times.
//!
//! In an ESC a frame visits the ports in the order 0 → EPU → 3 → 1 → 2 → 0, from the port at which
//! it arrives. Closed ports are skipped; at an open port it leaves and comes back there. So only
//! frames that arrive at port 0, or that the closed loop of port 0 turns around, pass the EPU; a
//! frame that enters at port 1 goes 1 → 2 → 0 first. The loops that the ESCs report decide, not the
//! cables.
//!
//! A stay in an ESC costs its processing delay if the frame passes the EPU on the way to the next
//! open port, otherwise its forwarding delay, regardless of the number of closed ports.
//!
//! The order of the ports is computed once. The times also depend on the frame, since each hop
//! jitters: `Path::time` sets the arrivals of a frame that leaves at a point of true time.

use isocat_wire::PortNumber;
use isocat_wire::dl::DlStatus;
use isocat_wire::time::{Picos, Time, True};

use crate::disturbance::Line;
use crate::jitter::{Edges, Hop, NEAR};
use crate::oscillator::Oscillator;
use crate::wiring::{End, MainPort, Wiring};

#[cfg(test)]
mod tests;

/// Which ports of an ESC are closed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Loops([bool; 4]);

/// What happens to a frame that an open port receives.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Turn {
    /// Whether it passes the EPU before it leaves.
    pub processed: bool,
    /// The port at which it leaves.
    pub exit: PortNumber,
}

impl Loops {
    /// Only these ports are open.
    pub fn open(ports: &[PortNumber]) -> Self {
        Self::from_closed(PortNumber::ALL.map(|port| !ports.contains(&port)))
    }

    /// The loops of a DL status.
    pub fn of(status: DlStatus) -> Self {
        Self::from_closed(PortNumber::ALL.map(|port| status.loop_closed(port)))
    }

    /// With all ports closed, port 0 is treated as open.
    fn from_closed(mut closed: [bool; 4]) -> Self {
        closed[0] &= closed != [true; 4];
        Self(closed)
    }

    /// Whether frames turn around at this port instead of leaving.
    pub fn closed(&self, port: PortNumber) -> bool {
        self.0[port.index()]
    }

    /// What happens to a frame that arrives at an open port.
    pub fn turn(&self, port: PortNumber) -> Turn {
        let mut processed = port == PortNumber::P0;
        let mut at = next(port);
        while self.closed(at) && at != port {
            processed |= at == PortNumber::P0;
            at = next(at);
        }
        Turn { processed, exit: at }
    }
}

/// The least gap between two frames: a nibble of MII, and more than a tick of an ESC.
const LEAST_GAP: Picos = Picos(40_000);
/// By how much a frame is put off at most. One that a fault has held up by more does not keep
/// others back.
const MOST_PUT_OFF: Picos = Picos(1_000_000);

/// The next port in the order.
fn next(port: PortNumber) -> PortNumber {
    match port {
        PortNumber::P0 => PortNumber::P3,
        PortNumber::P3 => PortNumber::P1,
        PortNumber::P1 => PortNumber::P2,
        PortNumber::P2 => PortNumber::P0,
    }
}

/// One arrival of a frame at a port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// The SubDevice.
    pub device: usize,
    /// The port.
    pub port: PortNumber,
    /// Time since the first bit left the MainDevice, including jitter of the hops.
    pub after: Picos,
}

/// The time from the previous arrival to this one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Step {
    /// The previous stay and the hop.
    hop: Hop,
    /// The place of the port in [`Ports`].
    place: u32,
}

impl Step {
    /// Takes frames to the port, in their order; returns when the last one arrives there.
    /// `is_near`: it may be near true time zero.
    #[inline(always)]
    fn take_all(
        &self,
        fellows: &mut [Fellow],
        is_near: bool,
        ports: &mut Ports,
        stations: &impl Stations,
    ) -> Time<True> {
        let Self { hop, place } = self;
        let free = &mut ports.0[*place as usize];
        if hop.is_straight() && !is_near {
            return take_each(fellows, free, |at| hop.forward_straight(at));
        }
        let device = Ports::device(*place);
        take_each(fellows, free, |at| hop.forward(at, || stations.oscillator(device)))
    }
}

/// Takes frames to a port that is free from `free` on, by the time of the hop to it.
#[inline(always)]
fn take_each(
    fellows: &mut [Fellow],
    free: &mut Time<True>,
    hop: impl Fn(Time<True>) -> Time<True>,
) -> Time<True> {
    let (mut last, mut until) = (Time::ZERO, *free);
    for fellow in fellows {
        let at = hop(fellow.at);
        last = if until > at { put_off(at, until) } else { at };
        until = last + fellow.whole;
        fellow.at = last;
    }
    *free = until;
    last
}

/// Steps one after another whose arrivals are all entries, or all returns.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Leg {
    steps: usize,
    entries: bool,
}

/// When a port forwards frames, in addition to the wiring's delays.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Reception {
    pub edges: Edges,
    /// How much earlier than by the delays of the chip.
    pub sooner: Picos,
}

/// Until when the last frame occupies the ports of each SubDevice.
///
/// Where hops jitter, the gap between two frames changes by a period at some of them, so behind a
/// thousand hops it may be used up. A port takes no frame before the one before it is through, and
/// its ESC has seen its end.
#[derive(Debug)]
pub(crate) struct Ports(Vec<Time<True>>);

impl Ports {
    /// The free ports of this number of SubDevices.
    pub fn new(devices: usize) -> Self {
        Self(vec![Time::ZERO; 4 * devices])
    }

    /// The place of a port.
    pub fn place(device: usize, port: PortNumber) -> u32 {
        (4 * device + port.index()) as u32
    }

    /// The SubDevice of a place.
    fn device(place: u32) -> usize {
        place as usize / 4
    }

    /// Takes a frame of this duration that arrives at `at` at the port of a [place](Self::place);
    /// returns when it does, if the port is not free yet.
    #[inline]
    pub fn take(&mut self, place: u32, at: Time<True>, duration: Picos) -> Time<True> {
        self.occupy(place, at, duration + LEAST_GAP)
    }

    /// The same for the duration and the gap behind it.
    #[inline(always)]
    fn occupy(&mut self, place: u32, at: Time<True>, whole: Picos) -> Time<True> {
        let free = &mut self.0[place as usize];
        let at = if *free > at { put_off(at, *free) } else { at };
        *free = at + whole;
        at
    }
}

/// When a port takes a frame that arrives at `at` and finds it occupied until `free`.
#[cold]
#[inline(never)]
fn put_off(at: Time<True>, free: Time<True>) -> Time<True> {
    if free <= at + MOST_PUT_OFF { free } else { at }
}

/// One of several frames that take a path together.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Fellow {
    /// When its first bit leaves the MainDevice, and how long it lasts.
    pub start: Time<True>,
    pub duration: Picos,
    /// The same with the gap behind it.
    whole: Picos,
    /// When it has arrived at the port that all of them have reached; in the end when it is back.
    pub at: Time<True>,
}

impl Fellow {
    /// A frame at the MainDevice.
    pub fn new(start: Time<True>, duration: Picos) -> Self {
        Self { start, duration, whole: duration + LEAST_GAP, at: start }
    }
}

/// What frames that take a path together meet there.
pub(crate) trait Stations {
    /// The oscillator of a SubDevice.
    fn oscillator(&self, device: usize) -> &Oscillator;
    /// The frames have arrived at this place of the entries, which is the one of `device`.
    fn entered(&mut self, place: usize, device: usize, fellows: &[Fellow]);
}

/// All arrivals of one frame, in the order of time, and its way back.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Path {
    /// Arrivals after which the frame passes the processing unit, in processing order.
    pub entries: Vec<Arrival>,
    /// All other arrivals.
    pub returns: Vec<Arrival>,
    /// Time from the first bit's departure at the MainDevice to its return.
    pub round_trip: Picos,
    /// Where it comes back; `None` if it does not: no cable at the port, a port that sends without
    /// a receiver, or an endless way.
    pub end: Option<MainPort>,
    /// Whether every SubDevice on the way processes the frame when it first meets it. False if
    /// cables are swapped or the frame comes from the other end of a ring.
    pub processed_first: bool,
    /// A step for each arrival, in the order of time; empty if no hop jitters.
    steps: Vec<Step>,
    /// The steps by what they lead to.
    legs: Vec<Leg>,
    /// The time after the last arrival.
    last_step: Picos,
}

impl Path {
    /// The way of a frame that leaves the MainDevice at `from`. `loops` returns the closed ports of
    /// a SubDevice.
    pub fn new(wiring: &Wiring, loops: impl Fn(usize) -> Loops, from: MainPort) -> Self {
        Self::over(wiring, loops, |_| true, |_, _| Reception::default(), from)
    }

    /// The same over cables that carry signals only: a frame sent into another cable is lost.
    /// `reception` returns the additional times of ports.
    pub(crate) fn over(
        wiring: &Wiring,
        loops: impl Fn(usize) -> Loops,
        carries: impl Fn(Line) -> bool,
        reception: impl Fn(usize, PortNumber) -> Reception,
        from: MainPort,
    ) -> Self {
        let mut path = Path { processed_first: true, ..Path::default() };
        let mut processed = vec![false; wiring.devices()];
        let mut end = End::Main(from);
        let (mut at, mut before, mut jitters) = (Picos::ZERO, Picos::ZERO, false);
        // No port is reached twice, unless the way is endless.
        let mut most = 4 * wiring.devices() + 1;
        while let Some(hop) = wiring.hop(end).filter(|hop| carries((hop.cable, hop.direction))) {
            at += hop.delay;
            let (device, port) = match hop.to {
                End::Main(port) => {
                    path.last_step = at - before;
                    path.round_trip = at;
                    path.end = Some(port);
                    break;
                }
                End::Port(device, port) => (device, port),
            };
            let loops = loops(device);
            most -= 1;
            if loops.closed(port) || most == 0 {
                break;
            }
            let turn = loops.turn(port);
            let Reception { edges, sooner } = reception(device, port);
            at -= sooner;
            let arrival = Arrival { device, port, after: at };
            let (entries, place) = (turn.processed, Ports::place(device, port));
            path.steps.push(Step { hop: edges.after(at - before), place });
            match path.legs.last_mut() {
                Some(leg) if leg.entries == entries => leg.steps += 1,
                _ => path.legs.push(Leg { steps: 1, entries }),
            }
            (before, jitters) = (at, jitters | edges.are_there());
            let stay = wiring.stay(device);
            if turn.processed {
                path.entries.push(arrival);
                processed[device] = true;
                at += stay.processing;
            } else {
                path.returns.push(arrival);
                path.processed_first &= processed[device];
                at += stay.forwarding;
            }
            end = End::Port(device, turn.exit);
        }
        if !jitters {
            path.steps.clear();
        }
        path
    }

    /// Sets all arrivals and the round trip to those of a frame of this `duration` that leaves the
    /// MainDevice at `start`; `oscillator` returns the oscillator of a SubDevice.
    pub(crate) fn time<'a>(
        &mut self,
        (start, duration): (Time<True>, Picos),
        ports: &mut Ports,
        oscillator: impl Fn(usize) -> &'a Oscillator,
    ) {
        if self.steps.is_empty() {
            return;
        }
        let mut steps = self.steps.as_slice();
        let (mut entries, mut returns) = (self.entries.as_mut_slice(), self.returns.as_mut_slice());
        let whole = duration + LEAST_GAP;
        let mut at = start;
        for leg in &self.legs {
            let arrivals = if leg.entries { &mut entries } else { &mut returns };
            let reached = arrivals.split_off_mut(..leg.steps).unwrap_or_default();
            let taken = steps.split_off(..leg.steps).unwrap_or_default();
            for (step, arrival) in taken.iter().zip(reached) {
                at = step.hop.forward(at, || oscillator(Ports::device(step.place)));
                at = ports.occupy(step.place, at, whole);
                arrival.after = at - start;
            }
        }
        if self.end.is_some() {
            self.round_trip = at - start + self.last_step;
        }
    }

    /// Lets frames that leave the MainDevice one behind the other take the path together: at each
    /// port all of them arrive before the first one goes on. The arrivals and the round trip are
    /// those of the last one then. The path must have an end.
    pub(crate) fn time_all(
        &mut self,
        fellows: &mut [Fellow],
        ports: &mut Ports,
        stations: &mut impl Stations,
    ) {
        let (Some(first), Some(last)) = (fellows.first(), fellows.last()) else { return };
        let (sent, is_near) = (last.start, first.start.count() < NEAR);
        let mut steps = self.steps.as_slice();
        let (mut entries, mut returns) = (self.entries.as_mut_slice(), self.returns.as_mut_slice());
        let mut place = 0;
        fellows.iter_mut().for_each(|fellow| fellow.at = fellow.start);
        for leg in &self.legs {
            let taken = steps.split_off(..leg.steps).unwrap_or_default();
            if !leg.entries {
                let reached = returns.split_off_mut(..leg.steps).unwrap_or_default();
                for (step, arrival) in taken.iter().zip(reached) {
                    arrival.after = step.take_all(fellows, is_near, ports, stations) - sent;
                }
                continue;
            }
            let mut taken = taken.iter();
            for entry in entries.split_off_mut(..leg.steps).unwrap_or_default() {
                if let Some(step) = taken.next() {
                    entry.after = step.take_all(fellows, is_near, ports, stations) - sent;
                } else {
                    let at = |fellow: &mut Fellow| fellow.at = fellow.start + entry.after;
                    fellows.iter_mut().for_each(at);
                }
                stations.entered(place, entry.device, fellows);
                place += 1;
            }
        }
        if self.steps.is_empty() {
            fellows.iter_mut().for_each(|fellow| fellow.at = fellow.start + self.round_trip);
            return;
        }
        fellows.iter_mut().for_each(|fellow| fellow.at += self.last_step);
        self.round_trip = fellows.last().map_or(self.round_trip, |last| last.at - last.start);
    }
}

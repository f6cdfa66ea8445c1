//! Both sides meet: a MainDevice on its host, and a segment, in true time.

use std::collections::VecDeque;

use isocat_maindevice::{Application, Config, Event, MainDevice, Port, Runner};
use isocat_wire::frame;
use isocat_wire::time::{Host, Time, True};

use crate::bench::{Bench, Intent, Measured};
use crate::host::{HostMachine, HostModel};
use crate::observation::Observation;
use crate::segment::{Connection, Lost, Returned, Segment};
use crate::wiring::MainPort;

/// What a run is made of.
pub struct Setup {
    /// The one seed of all randomness.
    pub seed: u64,
    /// What the MainDevice is to do.
    pub config: Config,
    /// The machine that it runs on.
    pub host: HostModel,
    /// The segment. Parents stand before their children.
    pub segment: Vec<Connection>,
}

/// Sees every frame on the MainDevice's ports, and what happens at the SubDevices.
///
/// - Frames: [`frame`](Self::frame), [`secondary_frame`](Self::secondary_frame), [`lost`](Self::lost), and in front of SubDevices
///   [`probes`](Self::probes), [`probed`](Self::probed);
/// - SubDevices: [`observed`](Self::observed), [`measured`](Self::measured);
/// - the MainDevice: [`event`](Self::event), [`cycle`](Self::cycle);
/// - the judged time: [`judging_begins`](Self::judging_begins), [`judging_ends`](Self::judging_ends).
pub trait Tap {
    /// A frame whose first bit left the primary port (`sent`) or came back there at `at`.
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]);

    /// The same at the secondary port of a ring.
    fn secondary_frame(&mut self, _at: Time<True>, _sent: bool, _bytes: &[u8]) {}

    /// The frame that left a port at `at` does not come back to the program: why it was lost, or `None` if it came back
    /// damaged.
    fn lost(&mut self, _at: Time<True>, _port: Port, _why: Option<Lost>) {}

    /// Positions of the SubDevices in front of which frames are to be [`probed`](Self::probed); asked once. Where none
    /// stands, nothing is seen.
    fn probes(&self) -> Vec<usize> {
        Vec::new()
    }

    /// The first bit of a frame that a SubDevice processes entered it (`entered`) or left it at `at`, with what it holds
    /// then. Told when the frame is sent.
    fn probed(&mut self, _at: Time<True>, _device: usize, _entered: bool, _bytes: &[u8]) {}

    /// A frame that left the primary port at `at` has passed the SubDevices: how they stand then. Each is brought up to the last
    /// frame that concerned it.
    fn passed(&mut self, _at: Time<True>, _segment: &Segment) {}

    /// Something happened at a SubDevice at `at`; the segment is as it stands when that is told.
    fn observed(&mut self, _segment: &Segment, _at: Time<True>, _observation: &Observation) {}

    /// What the judges made of the event that was just observed at a SubDevice, if they did.
    fn measured(&mut self, _at: Time<True>, _device: usize, _measured: &Measured) {}

    /// The MainDevice told something, known at `at`.
    fn event(&mut self, _at: Time<True>, _event: &Event) {}

    /// All SubDevices are in operation, and are judged from `at` on.
    fn judging_begins(&mut self, _at: Time<True>, _intent: &Intent) {}

    /// The judged time is over: what comes now is in no report. SubDevices are brought up to `at`.
    fn judging_ends(&mut self, _at: Time<True>, _main: &MainDevice, _segment: &Segment) {}

    /// A cycle is over at `at`, and the application has had its turn if process data run: how the MainDevice and the
    /// segment stand then. Every frame of the cycle is in the program's hands, or given up as the next cycle is due.
    /// SubDevices are brought up to the last frame that passed them.
    fn cycle(&mut self, _at: Time<True>, _main: &MainDevice, _segment: &Segment) {}
}

/// A run in progress.
pub struct World<A, T> {
    now: Time<True>,
    runner: Runner<A>,
    host: HostMachine,
    segment: Segment,
    tap: Option<T>,
    /// The judges at their bench.
    pub bench: Bench,
    wanted: Option<Time<Host>>,
    wake_up: Time<True>,
    returning: VecDeque<Returning>,
    spare: Vec<Vec<u8>>,
    observations: Vec<Observation>,
}

/// A frame on its way back to the program.
struct Returning {
    port: Port,
    /// First bit back at the port.
    first_bit: Time<True>,
    /// In the program's hands.
    delivered: Time<True>,
    bytes: Vec<u8>,
}

impl<A: Application, T: Tap> World<A, T> {
    /// Everything switched on at true time zero.
    pub fn new(setup: Setup, application: A, tap: Option<T>) -> Self {
        let host = HostMachine::new(setup.host, setup.seed);
        let mut segment = Segment::new(setup.segment, setup.seed);
        for position in tap.iter().flat_map(Tap::probes) {
            segment.probe(position);
        }
        let now = Time::ZERO;
        let bench = Bench::new(segment.devices().len());
        let main = MainDevice::new(setup.config, host.now(now));
        Self {
            now,
            runner: Runner::new(main, application),
            host,
            segment,
            tap,
            bench,
            wanted: None,
            wake_up: Time::NEVER,
            returning: VecDeque::with_capacity(64),
            spare: Vec::with_capacity(64),
            observations: Vec::with_capacity(256),
        }
    }

    /// True time of the last thing that happened to the MainDevice.
    pub fn now(&self) -> Time<True> {
        self.now
    }
    /// The MainDevice.
    pub fn main(&self) -> &MainDevice {
        self.runner.main()
    }
    /// The MainDevice, to ask something of it.
    pub fn main_mut(&mut self) -> &mut MainDevice {
        self.runner.main_mut()
    }
    /// The machine that the MainDevice runs on, to hold it up.
    pub fn host_mut(&mut self) -> &mut HostMachine {
        &mut self.host
    }
    /// The segment.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }
    /// The segment, to pull its cables.
    pub fn segment_mut(&mut self) -> &mut Segment {
        &mut self.segment
    }
    /// The MainDevice's application.
    pub fn application(&self) -> &A {
        self.runner.application()
    }
    /// The MainDevice's application, to tell it something.
    pub fn application_mut(&mut self) -> &mut A {
        self.runner.application_mut()
    }
    /// The end of the run: the application and the tap are given back.
    pub fn into_parts(self) -> (A, Option<T>) {
        (self.runner.into_parts().1, self.tap)
    }
    /// The end of the run: the tap is given back.
    pub fn into_tap(self) -> Option<T> {
        self.tap
    }

    /// Lets the next thing happen to the MainDevice, if that is not after `limit`: a frame comes back or
    /// its timer wakes it. False if nothing does; then true time stands at `limit`, for the SubDevices
    /// too.
    pub fn step(&mut self, limit: Time<True>) -> bool {
        self.transmit();
        self.set_timer();
        let delivered = self.returning.front().map_or(Time::NEVER, |frame| frame.delivered);
        let next = delivered.min(self.wake_up);
        if next > limit {
            self.now = limit;
            let observations = &mut self.observations;
            self.segment.advance(limit, &mut |o| observations.push(o));
            self.judge();
            return false;
        }
        self.now = next;
        let now = self.host.now(next);
        if delivered <= self.wake_up {
            self.deliver(now);
        } else {
            self.wanted = None;
            self.wake_up = Time::NEVER;
            let complete = self.runner.handle_timeout(now);
            self.tap_cycle(complete);
        }
        true
    }

    /// Brings every SubDevice to the last frame that passed it, and the judges with them: before
    /// something is asked of them all.
    pub fn catch_up(&mut self) {
        let observations = &mut self.observations;
        self.segment.catch_up(&mut |o| observations.push(o));
        self.judge();
    }

    /// Takes the next event of the MainDevice.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.runner.poll_event()?;
        if let Some(tap) = &mut self.tap {
            tap.event(self.now, &event);
        }
        Some(event)
    }

    /// The judges begin: the segment is in operation.
    pub fn begin_judging(&mut self, intent: Intent) {
        if let Some(tap) = &mut self.tap {
            tap.judging_begins(self.now, &intent);
        }
        self.bench.begin(intent);
    }

    /// The judged time is over; gives the judges as they stand.
    pub fn end_judging(&mut self) -> Bench {
        if let Some(tap) = &mut self.tap {
            tap.judging_ends(self.now, self.runner.main(), &self.segment);
        }
        self.bench.clone()
    }

    fn deliver(&mut self, now: Time<Host>) {
        let Some(frame) = self.returning.pop_front() else { return };
        self.tap(frame.port, frame.first_bit, false, &frame.bytes);
        let complete = self.runner.handle_frame(frame.port, now, &frame.bytes);
        self.spare.push(frame.bytes);
        self.tap_cycle(complete);
    }

    fn tap_cycle(&mut self, complete: Option<u64>) {
        if let (Some(tap), Some(_)) = (&mut self.tap, complete) {
            tap.cycle(self.now, self.runner.main(), &self.segment);
        }
    }

    fn set_timer(&mut self) {
        let wanted = self.runner.next_timeout();
        if wanted != self.wanted {
            self.wanted = wanted;
            self.wake_up = wanted.map_or(Time::NEVER, |at| self.host.wake_up(at).max(self.now));
        }
    }

    fn transmit(&mut self) {
        let mut bytes = self.buffer();
        while let Some(len) = self.runner.poll_transmit(self.host.now(self.now), &mut bytes) {
            bytes.truncate(len);
            self.send(Port::Primary, bytes);
            bytes = self.buffer();
            while let Some(len) = self.runner.poll_secondary(&mut bytes) {
                bytes.truncate(len);
                self.send(Port::Secondary, bytes);
                bytes = self.buffer();
            }
        }
        self.spare.push(bytes);
    }

    fn buffer(&mut self) -> Vec<u8> {
        let mut bytes = self.spare.pop().unwrap_or_else(|| vec![0; frame::MAX_LEN]);
        bytes.resize(frame::MAX_LEN, 0);
        bytes
    }

    fn send(&mut self, from: Port, mut bytes: Vec<u8>) {
        let wired = match from {
            Port::Primary => MainPort::Primary,
            Port::Secondary => MainPort::Secondary,
        };
        let start = self.host.send(wired, self.now, bytes.len());
        self.tap(from, start, true, &bytes);
        let observations = &mut self.observations;
        let watch = &mut |o| observations.push(o);
        let fate = self.segment.pass_from(wired, &mut bytes, start, watch);
        if let Some(tap) = &mut self.tap {
            for seen in self.segment.take_probed() {
                tap.probed(seen.at, seen.device, seen.entered, &seen.bytes);
            }
        }
        if from == Port::Primary {
            self.bench.frame(&self.segment, &bytes, start);
            if let Some(tap) = &mut self.tap {
                tap.passed(start, &self.segment);
            }
        }
        self.judge();
        match fate {
            Ok(Returned { port, first_bit, last_bit, good: true }) => {
                let delivered = self.host.receive(last_bit);
                let port = match port {
                    MainPort::Primary => Port::Primary,
                    MainPort::Secondary => Port::Secondary,
                };
                // Those of the two ports overtake each other.
                let before = |other: &Returning| other.delivered <= delivered;
                let place = self.returning.iter().rposition(before).map_or(0, |at| at + 1);
                self.returning.insert(place, Returning { port, first_bit, delivered, bytes });
            }
            // What does not come back, or comes back damaged, no program ever sees.
            fate => {
                if let Some(tap) = &mut self.tap {
                    tap.lost(start, from, fate.err());
                }
                self.spare.push(bytes);
            }
        }
    }

    fn tap(&mut self, port: Port, at: Time<True>, sent: bool, bytes: &[u8]) {
        match (&mut self.tap, port) {
            (Some(tap), Port::Primary) => tap.frame(at, sent, bytes),
            (Some(tap), Port::Secondary) => tap.secondary_frame(at, sent, bytes),
            (None, _) => {}
        }
    }

    /// Lets the judges see what happened. They look at the reference clock, so this waits until the
    /// SubDevices are done.
    fn judge(&mut self) {
        for observation in self.observations.drain(..) {
            let measured = self.bench.observe(&self.segment, &observation);
            if let Some(tap) = &mut self.tap {
                let device = &self.segment.devices()[observation.device];
                let at = device.oscillator().when(observation.device_at);
                tap.observed(&self.segment, at, &observation);
                if measured != Measured::default() {
                    tap.measured(at, observation.device, &measured);
                }
            }
        }
    }
}

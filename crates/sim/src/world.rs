//! Connects both sides: a MainDevice on its host, and a segment, in true time.

use std::collections::VecDeque;

use isocat_maindevice::{Application, Config, Event, MainDevice, Port, Runner};
use isocat_wire::time::{Host, Nanos, Picos, Time, True};

use crate::bench::{Bench, Intent, Measured};
use crate::buffer::Buffer;
use crate::burst::Leaving;
use crate::course::Course;
use crate::device::DeviceSetup;
use crate::disturbance::BitError;
use crate::fault::frames::{FrameFaults, Harms};
use crate::fault::happen::Scene;
use crate::fault::{Fault, Foreign, Happened, Moment, Planned, Timeline};
use crate::host::{HostMachine, HostModel};
use crate::observation::Observation;
use crate::probe::Sight;
use crate::segment::{Closing, Connection, Lost, Returned, Segment};
use crate::watcher::Watcher;
use crate::wiring::{End, Hop, MainPort};

/// The parts of a run.
pub struct Setup {
    /// The only seed of all random numbers.
    pub seed: u64,
    /// The MainDevice's configuration.
    pub config: Config,
    /// The host on which it runs.
    pub host: HostModel,
    /// The segment. Parents come before their children.
    pub segment: Vec<Connection>,
    /// The cable that makes it a ring; `None`: the secondary port has no cable.
    pub ring: Option<Closing>,
    /// The planned faults.
    pub faults: Vec<Planned>,
    /// SubDevices that may replace others ([`Fault::Replace`]).
    pub spares: Vec<DeviceSetup>,
    /// Whether regular operation takes the fast lane, as it does by default: see
    /// [`Segment::set_lane`].
    pub lane: bool,
}

impl Setup {
    /// A segment without faults.
    pub const fn new(seed: u64, config: Config, host: HostModel, segment: Vec<Connection>) -> Self {
        let ring = None;
        let faults = Vec::new();
        Self { seed, config, host, segment, ring, faults, spares: Vec::new(), lane: true }
    }
}

/// An observer of every frame on the MainDevice's ports, and of events at the SubDevices.
///
/// - Frames: [`frame`](Self::frame), [`secondary_frame`](Self::secondary_frame),
///   [`lost`](Self::lost), and at SubDevices [`probes`](Self::probes), [`probed`](Self::probed);
/// - SubDevices: [`observed`](Self::observed), [`measured`](Self::measured);
/// - the MainDevice: [`event`](Self::event), [`cycle`](Self::cycle);
/// - the judged time: [`judging_begins`](Self::judging_begins),
///   [`judging_ends`](Self::judging_ends).
pub trait Tap {
    /// Called for a frame whose first bit left the primary port (`sent`) or came back there at
    /// `at`.
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]);

    /// The same at the secondary port of a ring.
    fn secondary_frame(&mut self, _at: Time<True>, _sent: bool, _bytes: &[u8]) {}

    /// Called for a frame that left a port at `at` but does not come back to the program: why it
    /// was lost, or `None` if it came back damaged.
    fn lost(&mut self, _at: Time<True>, _port: Port, _why: Option<Lost>) {}

    /// Positions of the SubDevices at which frames are [`probed`](Self::probed); asked once.
    /// Positions without a SubDevice have no effect.
    fn probes(&self) -> Vec<usize> {
        Vec::new()
    }

    /// Positions of the SubDevices with a tap in the cable at port 0; asked once. Positions without
    /// a SubDevice have no effect.
    fn cables(&self) -> Vec<usize> {
        Vec::new()
    }

    /// Called when the first bit of a frame passed a probe or a tap at a SubDevice at `at`, with
    /// the frame's content at that time. The call comes when the frame is sent.
    fn probed(&mut self, _at: Time<True>, _device: usize, _sight: Sight, _bytes: &[u8]) {}

    /// Called when a frame that left the primary port at `at` has passed the SubDevices. Each is
    /// advanced to the last frame that concerned it.
    fn passed(&mut self, _at: Time<True>, _segment: &Segment) {}

    /// Whether [`observed`](Self::observed) and [`measured`](Self::measured) are needed, and with
    /// them all events; asked once. Otherwise they are not called.
    fn observes(&self) -> bool {
        true
    }

    /// Called for an event at a SubDevice at `at`; the segment is in its state at the time of the
    /// call.
    fn observed(&mut self, _segment: &Segment, _at: Time<True>, _observation: &Observation) {}

    /// Called with the judges' measurements of the event that was just observed, if there are any.
    fn measured(&mut self, _at: Time<True>, _device: usize, _measured: &Measured) {}

    /// Called when a fault began or ended. Faults of cables and power are reported some
    /// milliseconds before their time.
    fn fault(&mut self, _happened: &Happened) {}

    /// Called for an event of the MainDevice, known at `at`.
    fn event(&mut self, _at: Time<True>, _event: &Event) {}

    /// Called when all SubDevices are in operation; they are judged from `at` on.
    fn judging_begins(&mut self, _at: Time<True>, _intent: &Intent) {}

    /// Called at the end of the judged time: later events are in no report. SubDevices are advanced
    /// to `at`.
    fn judging_ends(&mut self, _at: Time<True>, _main: &MainDevice, _segment: &Segment) {}

    /// Called when a cycle is complete at `at`, after the application was called if process data
    /// run, with the MainDevice and the segment at that time. The program has every frame of the
    /// cycle, or gave it up since the next cycle is due. SubDevices are advanced to the last frame
    /// that passed them.
    fn cycle(&mut self, _at: Time<True>, _main: &MainDevice, _segment: &Segment) {}

    /// The same for a foreign MainDevice while it is judged: its frame with process data is back.
    /// `None`: it is not judged any more.
    fn served_cycle(&mut self, _at: Time<True>, _cycle: Option<ServedCycle>, _segment: &Segment) {}
}

/// Passes every call on: a method of the trait that is missing here would never reach the tap.
impl<T: Tap + ?Sized> Tap for &mut T {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        (**self).frame(at, sent, bytes);
    }

    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        (**self).secondary_frame(at, sent, bytes);
    }

    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        (**self).lost(at, port, why);
    }

    fn probes(&self) -> Vec<usize> {
        (**self).probes()
    }

    fn cables(&self) -> Vec<usize> {
        (**self).cables()
    }

    fn probed(&mut self, at: Time<True>, device: usize, sight: Sight, bytes: &[u8]) {
        (**self).probed(at, device, sight, bytes);
    }

    fn passed(&mut self, at: Time<True>, segment: &Segment) {
        (**self).passed(at, segment);
    }

    fn observes(&self) -> bool {
        (**self).observes()
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        (**self).observed(segment, at, observation);
    }

    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        (**self).measured(at, device, measured);
    }

    fn fault(&mut self, happened: &Happened) {
        (**self).fault(happened);
    }

    fn event(&mut self, at: Time<True>, event: &Event) {
        (**self).event(at, event);
    }

    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        (**self).judging_begins(at, intent);
    }

    fn judging_ends(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        (**self).judging_ends(at, main, segment);
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        (**self).cycle(at, main, segment);
    }

    fn served_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>, segment: &Segment) {
        (**self).served_cycle(at, cycle, segment);
    }
}

/// A cycle of a foreign MainDevice, as the segment sees it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ServedCycle {
    /// Number of frames with process data since it was first judged.
    pub number: u64,
    /// Number of frames of all kinds that did not come back, since the start of the run.
    pub frames_lost: u64,
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
    spare: Vec<Buffer>,
    /// Frames that are to leave the primary port.
    leaving: Vec<Leaving>,
    /// The events for judges and tap, and whether the tap needs them.
    watcher: Watcher,
    observes: bool,
    timeline: Timeline,
    /// When each SubDevice was in sync; `None` if it is not recorded, or before operation.
    course: Option<Course>,
    follows_course: bool,
    /// The faults of frames at the primary port.
    port_faults: FrameFaults,
}

/// A frame on its way back to the program.
struct Returning {
    port: Port,
    /// When its first bit is back at the port.
    first_bit: Time<True>,
    /// When the program has it.
    delivered: Time<True>,
    frame: Buffer,
}

impl<A: Application, T: Tap> World<A, T> {
    /// Switches everything on at true time zero. Panics if cables do not fit, see [`Segment::new`].
    pub fn new(setup: Setup, application: A, tap: Option<T>) -> Self {
        let host = HostMachine::new(setup.host, setup.seed);
        let mut segment = Segment::new(setup.segment, setup.seed).in_ring(setup.ring);
        segment.set_lane(setup.lane);
        for position in tap.iter().flat_map(Tap::probes) {
            segment.probe(position);
        }
        for position in tap.iter().flat_map(Tap::cables) {
            segment.tap(position);
        }
        let now = Time::ZERO;
        let bench = Bench::new(segment.devices().len());
        let main = MainDevice::new(setup.config, host.now(now));
        Self {
            now,
            runner: Runner::new(main, application),
            host,
            segment,
            observes: tap.as_ref().is_some_and(Tap::observes),
            watcher: watcher(tap.as_ref()),
            tap,
            bench,
            wanted: None,
            wake_up: Time::NEVER,
            returning: VecDeque::with_capacity(64),
            spare: Vec::with_capacity(64),
            leaving: Vec::with_capacity(64),
            timeline: Timeline::new(setup.faults, setup.seed).with_spares(setup.spares),
            course: None,
            follows_course: false,
            port_faults: FrameFaults::default(),
        }
    }

    /// True time of the last event of the MainDevice.
    pub fn now(&self) -> Time<True> {
        self.now
    }
    /// The MainDevice.
    pub fn main(&self) -> &MainDevice {
        self.runner.main()
    }
    /// The MainDevice, for requests.
    pub fn main_mut(&mut self) -> &mut MainDevice {
        self.runner.main_mut()
    }
    /// The host on which the MainDevice runs.
    pub fn host(&self) -> &HostMachine {
        &self.host
    }
    /// The host on which the MainDevice runs, to delay it.
    pub fn host_mut(&mut self) -> &mut HostMachine {
        &mut self.host
    }
    /// The segment.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }
    /// The segment, to take actions on its plants, and the application.
    pub(crate) fn segment_and_application(&mut self) -> (&mut Segment, &A) {
        (&mut self.segment, self.runner.application())
    }
    /// The faults: planned, in force, happened.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }
    /// Lets a fault begin now, with a duration if one is given.
    pub fn inject(&mut self, fault: Fault, lasts: Option<Nanos>) {
        self.timeline.order(self.now, fault, lasts);
    }
    /// The segment, to pull its cables.
    pub fn segment_mut(&mut self) -> &mut Segment {
        &mut self.segment
    }
    /// The MainDevice's application.
    pub fn application(&self) -> &A {
        self.runner.application()
    }
    /// The MainDevice's application, to change it.
    pub fn application_mut(&mut self) -> &mut A {
        self.runner.application_mut()
    }
    /// Ends the run and returns the application and the tap.
    pub fn into_parts(self) -> (A, Option<T>) {
        (self.runner.into_parts().1, self.tap)
    }
    /// Ends the run and returns the tap.
    pub fn into_tap(self) -> Option<T> {
        self.tap
    }

    /// Processes the next event of the MainDevice, if it is not after `limit`: a frame comes back
    /// or its timer wakes it. Returns false if there is none; true time is then `limit`, for the
    /// SubDevices too.
    pub fn step(&mut self, limit: Time<True>) -> bool {
        self.let_faults_happen();
        if self.host.awake(self.now) == self.now {
            self.transmit();
            self.set_timer();
        }
        let delivered = self.returning.front().map_or(Time::NEVER, |frame| frame.delivered);
        let delivered = self.host.awake(delivered);
        self.wake_up = self.host.awake(self.wake_up);
        let fault = self.timeline.next().unwrap_or(Time::NEVER);
        let next = delivered.min(self.wake_up);
        if fault < next && fault <= limit {
            // Faults on cables were announced earlier; the others happen at the next step.
            self.now = self.now.max(fault);
            return true;
        }
        if next > limit {
            self.now = limit;
            self.segment.advance(limit, &mut self.watcher);
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

    /// Advances every SubDevice to the last frame that passed it, and the judges with them. Call
    /// this before reading their states.
    pub fn catch_up(&mut self) {
        self.segment.catch_up(&mut self.watcher);
        self.judge();
    }

    /// Takes the next event of the MainDevice.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.runner.poll_event()?;
        match event {
            Event::InOperation { .. } => self.timeline.reached(Moment::InOperation, self.now),
            Event::ReferenceLost { .. } => self.bench.led_by(None),
            Event::ReferenceElected { position, .. } => {
                self.count_on(position);
                self.bench.led_by(Some(position));
            }
            _ => {}
        }
        if let Some(tap) = &mut self.tap {
            tap.event(self.now, &event);
        }
        Some(event)
    }

    /// Records when each SubDevice is in sync, once judging begins: see [`course`](Self::course).
    pub fn follow_course(&mut self) {
        self.follows_course = true;
        self.watcher.keep_everything();
    }
    /// When each SubDevice was in sync; `None` if it is not recorded, and before judging.
    pub fn course(&self) -> Option<&Course> {
        self.course.as_ref()
    }

    /// Begins judging: the segment is in operation.
    pub fn begin_judging(&mut self, intent: Intent) {
        self.count_on(intent.reference);
        if self.follows_course {
            let states = self.segment.devices().iter().map(|device| device.stack.state());
            self.course = Some(Course::begin(self.now, &intent, states));
        }
        if let Some(tap) = &mut self.tap {
            tap.judging_begins(self.now, &intent);
        }
        if !self.observes && !self.follows_course {
            let devices = self.segment.devices().len();
            self.watcher.keep_for_judges(intent.is_timed(), devices);
        }
        self.bench.begin(intent);
    }

    /// Grids of the intent are those of the MainDevice's count, which goes on where a counter of 32
    /// bits begins again.
    fn count_on(&mut self, reference: usize) {
        if let Some(near) = self.main().system_time(self.host.now(self.now)) {
            self.segment.device_mut(reference).count_on(self.now, near);
        }
    }

    /// Ends the judged time; returns the judges.
    pub fn end_judging(&mut self) -> Bench {
        if let Some(course) = &mut self.course {
            course.end(self.now);
            self.follows_course = false;
            if !self.observes {
                let timed = self.bench.intent().is_none_or(Intent::is_timed);
                self.watcher.keep_for_judges(timed, self.segment.devices().len());
            }
        }
        if let Some(tap) = &mut self.tap {
            tap.judging_ends(self.now, self.runner.main(), &self.segment);
        }
        self.bench.clone()
    }

    fn deliver(&mut self, now: Time<Host>) {
        let Some(back) = self.returning.pop_front() else { return };
        self.tap(back.port, back.first_bit, false, back.frame.frame());
        let complete = self.runner.handle_frame(back.port, now, back.frame.frame());
        self.spare.push(back.frame);
        self.tap_cycle(complete);
    }

    /// Applies all faults up to now.
    fn let_faults_happen(&mut self) {
        if !self.timeline.is_due(self.now) {
            return;
        }
        // A timer is set to a reading of the clock, which stays the same if the clock changes.
        let reading = (self.wake_up < Time::NEVER).then(|| self.host.now(self.wake_up));
        if self.timeline.next().is_some_and(|at| at <= self.now) {
            self.catch_up_to_now();
        }
        let Self { timeline, segment, host, port_faults, watcher, .. } = self;
        let mut scene = Scene { segment, host: Some(host), port: port_faults };
        timeline.happen(self.now, &mut scene, watcher);
        let foreign = timeline.take_foreign();
        for happened in timeline.take_news() {
            if let Some(tap) = &mut self.tap {
                tap.fault(&happened);
            }
        }
        if let Some(reading) = reading {
            self.wake_up = self.host.when(reading).max(self.now);
        }
        self.judge();
        for frame in foreign {
            self.send_of_others(frame);
        }
    }

    /// Advances the SubDevices to the present true time, at which faults apply.
    fn catch_up_to_now(&mut self) {
        self.segment.live(self.now, &mut self.watcher);
    }

    /// Sends a frame of another MainDevice, at the same end of the same cable.
    fn send_of_others(&mut self, frame: Foreign) {
        let mut buffer = self.buffer();
        let len = frame.write(buffer.room());
        buffer.set_len(len);
        let start = self.host.send_of_others(MainPort::Primary, self.now, len);
        self.pass(Port::Primary, buffer, (start, start), Harms::default());
    }

    fn tap_cycle(&mut self, complete: Option<u64>) {
        if let Some(number) = complete.filter(|_| self.timeline.counts_cycles()) {
            self.timeline.reached(Moment::Cycle(number), self.now);
        }
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
        let together = self.tap.is_none() && !self.port_faults.are_any();
        let mut buffer = self.buffer();
        let now = self.host.now(self.now);
        while let Some(len) = self.runner.poll_transmit(now, buffer.room()) {
            buffer.set_len(len);
            if together {
                let start = self.host.send(MainPort::Primary, self.now, len);
                self.leaving.push(Leaving::new(buffer, start));
            } else {
                self.send(Port::Primary, buffer);
            }
            buffer = self.buffer();
            while let Some(len) = self.runner.poll_secondary(buffer.room()) {
                self.pass_leaving();
                buffer.set_len(len);
                self.send(Port::Secondary, buffer);
                buffer = self.buffer();
            }
        }
        self.pass_leaving();
        self.spare.push(buffer);
    }

    /// Passes the frames that are to leave the primary port through the segment, together if they
    /// can. No tap looks at them, and no fault waits for them at the port.
    fn pass_leaving(&mut self) {
        let mut leaving = core::mem::take(&mut self.leaving);
        let leader = self.bench.leader();
        let (from, watch) = (MainPort::Primary, &mut self.watcher);
        if self.segment.pass_together(from, &mut leaving, leader, watch) {
            for it in &leaving {
                self.bench.frame_at(&self.segment, it.frame.frame(), it.arrived);
            }
            self.judge();
            for Leaving { frame, start, fate, .. } in leaving.drain(..) {
                self.bring_home(Port::Primary, frame, start, fate, Harms::default());
            }
        } else {
            for Leaving { frame, start, .. } in leaving.drain(..) {
                self.pass(Port::Primary, frame, (start, start), Harms::default());
            }
        }
        self.leaving = leaving;
    }

    fn buffer(&mut self) -> Buffer {
        self.spare.pop().unwrap_or_default()
    }

    fn send(&mut self, from: Port, frame: Buffer) {
        let wired = wired(from);
        let start = self.host.send(wired, self.now, frame.frame().len());
        self.tap(from, start, true, frame.frame());
        let [out, back] = match (from, self.port_faults.are_any()) {
            (Port::Primary, true) => self.port_faults.at_port(),
            _ => Default::default(),
        };
        let start = start + Picos::from(out.late);
        if out.lost {
            if let Some(tap) = &mut self.tap {
                tap.lost(start, from, Some(Lost::AtThePort));
            }
            self.spare.push(frame);
            return;
        }
        if out.damaged {
            self.damage_next(wired, start);
        }
        let copy = out.doubled.then(|| frame.clone());
        self.pass(from, frame, (start, start), back);
        if let Some(copy) = copy {
            let again = self.host.send_of_others(wired, start, copy.frame().len());
            self.pass(from, copy, (start, again), back);
        }
    }

    /// Damages the next frame that leaves a port, on the first cable.
    fn damage_next(&mut self, port: MainPort, at: Time<True>) {
        if let Some(hop) = self.segment.wiring().hop(End::Main(port)) {
            let Hop { cable, direction, .. } = hop;
            self.segment.disturb(BitError { cable, direction, at, bit: DAMAGED_BIT });
        }
    }

    /// Passes a frame, or a copy of the one that left at `first`, through the segment and back, if
    /// it comes back; `back` are the faults on its way back.
    fn pass(
        &mut self,
        from: Port,
        mut frame: Buffer,
        (first, start): (Time<True>, Time<True>),
        back: Harms,
    ) {
        let wired = wired(from);
        let bytes = frame.frame_mut();
        let fate = self.segment.pass_copy(wired, bytes, (first, start), &mut self.watcher);
        if let Some(tap) = &mut self.tap {
            for seen in self.segment.take_probed() {
                tap.probed(seen.at, seen.device, seen.sight, &seen.bytes);
            }
        }
        if from == Port::Primary {
            self.bench.frame(&self.segment, frame.frame(), start);
            if let Some(tap) = &mut self.tap {
                tap.passed(start, &self.segment);
            }
        }
        self.judge();
        self.bring_home(from, frame, start, fate, back);
    }

    /// Brings a frame that left a port at `start` back to the program, if it comes back.
    fn bring_home(
        &mut self,
        from: Port,
        frame: Buffer,
        start: Time<True>,
        fate: Result<Returned, Lost>,
        back: Harms,
    ) {
        match fate {
            Ok(Returned { port, first_bit, last_bit, good: true })
                if !back.lost && !back.damaged =>
            {
                let (first_bit, last_bit) =
                    (first_bit + back.late.into(), last_bit + back.late.into());
                let delivered = self.host.receive(last_bit);
                let port = port.into();
                if back.doubled {
                    let frame = frame.clone();
                    self.bring_back(Returning { port, first_bit, delivered, frame });
                }
                self.bring_back(Returning { port, first_bit, delivered, frame });
            }
            // No program sees a frame that does not come back, or that comes back damaged.
            fate => {
                let why = if back.lost { Some(Lost::AtThePort) } else { fate.err() };
                if let Some(tap) = &mut self.tap {
                    tap.lost(start, from, why);
                }
                self.spare.push(frame);
            }
        }
    }

    fn bring_back(&mut self, frame: Returning) {
        // Frames of the two ports overtake each other, and late frames are overtaken.
        let before = |other: &Returning| other.delivered <= frame.delivered;
        let place = self.returning.iter().rposition(before).map_or(0, |at| at + 1);
        self.returning.insert(place, frame);
    }

    fn tap(&mut self, port: Port, at: Time<True>, sent: bool, bytes: &[u8]) {
        match (&mut self.tap, port) {
            (Some(tap), Port::Primary) => tap.frame(at, sent, bytes),
            (Some(tap), Port::Secondary) => tap.secondary_frame(at, sent, bytes),
            (None, _) => {}
        }
    }

    /// Passes the new events to the judges. They read the reference clock, so this comes after the
    /// SubDevices.
    fn judge(&mut self) {
        let tap = &mut self.tap.as_mut().filter(|_| self.observes);
        let course = &mut self.course.as_mut().filter(|_| self.follows_course);
        if tap.is_none() && course.is_none() {
            self.bench.observe_seen(&self.segment, &self.watcher);
            self.watcher.clear();
            return;
        }
        let Self { bench, segment, watcher, .. } = self;
        bench.observe_each(segment, watcher.seen(), &mut |observation, measured| {
            let oscillator = segment.devices()[observation.device].oscillator();
            let at = oscillator.when(observation.device_at);
            if let Some(course) = course {
                course.observe(observation.device, at, observation.event, measured);
            }
            if let Some(tap) = tap {
                tap.observed(segment, at, observation);
                if *measured != Measured::default() {
                    tap.measured(at, observation.device, measured);
                }
            }
        });
        watcher.clear();
    }
}

/// Keeps the events that the judges need, and those of a tap that needs all.
fn watcher(tap: Option<&impl Tap>) -> Watcher {
    let mut watcher = Watcher::for_judges();
    if tap.is_some_and(Tap::observes) {
        watcher.keep_everything();
    }
    watcher
}

fn wired(port: Port) -> MainPort {
    match port {
        Port::Primary => MainPort::Primary,
        Port::Secondary => MainPort::Secondary,
    }
}

/// Index of the bit that is flipped in a damaged frame: in its first datagram.
const DAMAGED_BIT: usize = 8 * 20;

//! The main job on a wire: up, in operation for a while, what the SubDevices say at the end, down.

use std::sync::atomic::{AtomicBool, Ordering};

use isocat_host::preflight::{self, Subject};
use isocat_host::{
    Exchange, Figures, Histogram, LinkError, RawSocket, RealTime, Recorder, Traffic, Waiting, Wish,
    clock,
};
use isocat_maindevice::motion::Axis;
use isocat_maindevice::quality::Change;
use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Config, Event, Motion, RequestId, Segment, SegmentChange};
use isocat_sim::Finding;
use isocat_sim::run::{Counters, Progress};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::phase;
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlStatus, AlStatusCode, ObjectAddress};

use super::judge;
use crate::report::quality::Quality;
use crate::status::Scribe;

/// What is to be done on which interface.
pub struct Job {
    /// What the MainDevice is asked for.
    pub config: Config,
    /// The open interface.
    pub socket: RawSocket,
    /// Its network namespace.
    pub namespace: Option<String>,
    /// How long to run once all SubDevices are in OP.
    pub duration: Nanos,
    /// Largest 0x092C with which a clock counts as synchronized.
    pub difference_limit: Nanos,
    /// What to ask of the machine.
    pub wish: Wish,
    /// Where frames are written to.
    pub recorder: Option<Recorder>,
    /// Who is told how it stands, about ten times a second.
    pub scribe: Option<Scribe>,
}

/// The machine as it was found before the run.
#[derive(Clone, Debug)]
pub struct Machine {
    /// What was granted for real time.
    pub granted: Vec<String>,
    /// What was refused, with advice.
    pub refused: Vec<String>,
    /// Settings that harm.
    pub findings: Vec<preflight::Finding>,
    /// Lateness of wake-ups, measured.
    pub wake_ups: Histogram,
}

impl Machine {
    /// Asks for real time for the calling thread, and looks what there is. As long as the first of both is
    /// kept, processors stay awake.
    pub fn prepare(
        subject: Subject<'_>,
        socket: Option<&RawSocket>,
        cycle: Nanos,
    ) -> Result<(RealTime, Self), LinkError> {
        let real_time = RealTime::ask(subject.wish);
        let subject = Subject { keeps_awake: real_time.keeps_awake(), ..subject };
        let machine = Self {
            granted: real_time.granted.clone(),
            refused: real_time.refused.clone(),
            findings: preflight::look(subject, socket)?,
            wake_ups: preflight::wake_ups(cycle),
        };
        Ok((real_time, machine))
    }
}

/// What a run came to.
#[derive(Debug)]
pub struct Outcome {
    /// The machine.
    pub machine: Machine,
    /// What was found on the wire.
    pub segment: Segment,
    /// Counts when the time in operation began, and when it was over.
    pub statistics: (Statistics, Statistics),
    /// How punctual the machine was in operation.
    pub figures: Figures,
    /// The servo at the end of the time in operation.
    pub phase: Option<phase::State>,
    /// How often it lost its lock in that time.
    pub locks_lost: u64,
    /// The longest time that the machine came too late for a cycle: how late, and since when of the time in
    /// operation.
    pub stall: Option<(Nanos, Nanos)>,
    /// How much faster the reference clock runs than the host's.
    pub rate_ppb: Option<i64>,
    /// How well that, and the phase, are known.
    pub uncertainty: Option<phase::Uncertainty>,
    /// The application's view of each SubDevice.
    pub axes: Vec<Axis>,
    /// What each SubDevice said at the end, by position.
    pub devices: Vec<AtEnd>,
    /// Time in operation; `None` if it never began.
    pub judged: Option<Nanos>,
    /// What ended the run.
    pub end: End,
    /// What was read in the background; `None`: it was not asked for, or operation was not reached.
    pub quality: Option<Quality>,
    /// Why the segment is not in sync; empty if it is.
    pub findings: Vec<Finding>,
    /// What else a reader ought to know.
    pub notes: Vec<String>,
    /// The recorder, to be finished.
    pub recorder: Option<Recorder>,
}

impl Outcome {
    /// Whether every SubDevice ran as it was asked to.
    pub fn in_sync(&self) -> bool {
        self.findings.is_empty()
    }

    /// The error of the MainDevice that ended the way up.
    pub fn failure(&self) -> Option<&isocat_maindevice::Error> {
        match &self.end {
            End::Failed(error) => Some(error),
            _ => None,
        }
    }
}

/// What ended a run.
#[derive(Debug)]
pub enum End {
    /// The time was over.
    Time,
    /// Somebody asked for it.
    Asked,
    /// The way up failed.
    Failed(isocat_maindevice::Error),
    /// The way up did not end.
    TooLong,
    /// Nothing came back any more.
    Silence,
    /// The interface failed.
    Link(LinkError),
}

/// What one SubDevice said when the time in operation was over.
#[derive(Clone, Copy, Debug, Default)]
pub struct AtEnd {
    /// Registers 0x0130 and 0x0134; `None`: it did not answer.
    pub status: Option<(AlStatus, AlStatusCode)>,
    /// Register 0x092C; `None` without clock, or it did not answer.
    pub difference: Option<Nanos>,
    /// Counters of 0x1C32 when the time in operation began.
    pub outputs_before: Counters,
    /// Counters of 0x1C32.
    pub outputs: Counters,
    /// Counters of 0x1C33 when the time in operation began.
    pub inputs_before: Counters,
    /// Counters of 0x1C33.
    pub inputs: Counters,
}

/// What the MainDevice reported while in operation.
#[derive(Debug, Default)]
pub(super) struct Noted {
    /// Position, status and code, and since when.
    pub states: Vec<(usize, AlStatus, AlStatusCode, Nanos)>,
    /// SubDevices expected and found, and since when.
    pub counts: Vec<(u16, u16, Nanos)>,
    /// What became of SubDevices, and since when.
    pub changes: Vec<(Option<usize>, SegmentChange, Nanos)>,
    pub locks_lost: u64,
    /// The longest time that the machine came too late for a cycle: how late, and since when of the time in
    /// operation.
    pub stall: Option<(Nanos, Nanos)>,
    /// Alarms of what was read in the background, and since when.
    pub alarms: Vec<(Nanos, Change)>,
    pub answers: Vec<(RequestId, Option<Vec<u8>>)>,
}

impl Job {
    /// Does it all, on a thread of its own that has the machine's attention. It ends early once `stop` is
    /// set. An error is one of the interface or of its namespace, before anything was sent.
    pub fn run(
        self,
        stop: &AtomicBool,
        progress: &mut (dyn FnMut(Progress) + Send),
    ) -> Result<Outcome, LinkError> {
        std::thread::scope(|scope| {
            let thread = scope.spawn(|| self.run_here(stop, progress));
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    fn run_here(
        self,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Outcome, LinkError> {
        let interface = self.socket.interface().to_owned();
        let namespace = self.namespace.as_deref();
        let subject =
            Subject { interface: Some(&interface), namespace, wish: self.wish, keeps_awake: false };
        let (_awake, machine) = Machine::prepare(subject, Some(&self.socket), self.config.cycle)?;
        let before = Traffic::of(&interface, namespace);
        let (jitter, watch) = (self.config.host_jitter, self.config.quality);
        let waiting = match self.wish.busy {
            true => Waiting::Busy,
            false => Waiting::sleep(&machine.wake_ups, self.config.cycle),
        };
        let mut run = Running {
            exchange: Exchange::new(
                self.config,
                self.socket,
                waiting,
                self.recorder,
                Motion::default(),
            ),
            stop,
            progress,
            scribe: self.scribe,
            origin: clock::now(),
            noted: Noted::default(),
            began: None,
            judged: None,
        };
        let mut devices = Vec::new();
        let mut statistics = (Statistics::default(), Statistics::default());
        let end = match run.bring_up() {
            Err(end) => {
                statistics.1 = run.exchange.main().statistics();
                end
            }
            Ok(()) => {
                // The counters may stand anywhere: what they grow by in operation is judged.
                devices = vec![AtEnd::default(); run.exchange.main().segment().devices.len()];
                let read = run.read(&mut devices, true);
                statistics.0 = run.exchange.main().statistics();
                let end = read.err().unwrap_or_else(|| run.operate(self.duration));
                statistics.1 = run.exchange.main().statistics();
                end
            }
        };
        let (phase, rate_ppb) = (run.exchange.main().phase(), run.exchange.main().rate_ppb());
        let uncertainty = run.exchange.main().phase_uncertainty();
        let answers = run.began.is_some() && matches!(end, End::Time | End::Asked);
        let mut notes = Vec::new();
        let read = if answers { run.read(&mut devices, false) } else { Ok(()) };
        if let Err(End::Link(error)) = read {
            notes.push(format!("reading the counters at the end: {error}"));
        }
        let segment = run.exchange.main().segment().clone();
        let quality = Quality::new(run.exchange.main(), watch);
        let carrier = run.exchange.socket().has_carrier();
        let down = match end {
            // Nothing more can be sent, or the MainDevice sends nothing more.
            End::Link(_) | End::Failed(_) => Ok(()),
            _ => run.go_down(),
        };
        notes.extend(down.err());
        let Running { exchange, noted, judged, .. } = run;
        let mut outcome = Outcome {
            machine,
            segment,
            statistics,
            figures: *exchange.figures(),
            phase,
            locks_lost: noted.locks_lost,
            stall: noted.stall,
            rate_ppb,
            uncertainty,
            axes: exchange.application().axes().to_vec(),
            devices,
            judged,
            end,
            quality: quality.map(|quality| quality.with_alarms(&noted.alarms)),
            findings: Vec::new(),
            notes,
            recorder: None,
        };
        let after = Traffic::of(&interface, namespace);
        let total = exchange.main().statistics();
        judge::judge(&mut outcome, &noted, &interface, carrier, self.difference_limit);
        judge::note(&mut outcome, &interface, jitter, total, before.zip(after));
        outcome.recorder = exchange.into_parts().1;
        Ok(outcome)
    }
}

/// A run in progress.
struct Running<'a> {
    exchange: Exchange<Motion>,
    stop: &'a AtomicBool,
    progress: &'a mut dyn FnMut(Progress),
    scribe: Option<Scribe>,
    /// What the scribe's times count from.
    origin: Time<Host>,
    noted: Noted,
    began: Option<Time<Host>>,
    judged: Option<Nanos>,
}

impl Running<'_> {
    fn bring_up(&mut self) -> Result<(), End> {
        let limit = clock::now() + BRING_UP_LIMIT;
        loop {
            let more = self.exchange.step(limit).map_err(End::Link)?;
            while let Some(event) = self.exchange.poll_event() {
                self.tell(&event);
                match event {
                    Event::Progress(stage) => (self.progress)(Progress::Stage(stage)),
                    Event::InOperation { .. } => return Ok(()),
                    Event::Failed(error) => return Err(End::Failed(error)),
                    _ => {}
                }
            }
            self.publish();
            if self.stop.load(Ordering::Relaxed) {
                return Err(End::Asked);
            }
            if !more || clock::now() >= limit {
                return Err(End::TooLong);
            }
        }
    }

    /// Lets the segment run.
    fn operate(&mut self, duration: Nanos) -> End {
        let began = clock::now();
        let until = began + duration;
        let mut told = began;
        self.began = Some(began);
        self.judged = Some(Nanos::ZERO);
        self.exchange.measure(true);
        let end = loop {
            if let Err(error) = self.exchange.step(until) {
                break End::Link(error);
            }
            let now = clock::now();
            self.take_events(now);
            self.publish();
            if now >= until {
                break End::Time;
            }
            if self.stop.load(Ordering::Relaxed) {
                break End::Asked;
            }
            if self.exchange.is_silent(SILENCE) {
                break End::Silence;
            }
            if now - told >= PROGRESS {
                told = now;
                (self.progress)(Progress::Judged(now - began));
            }
        };
        self.exchange.measure(false);
        self.judged = Some(clock::now() - began);
        end
    }

    /// Goes back to INIT; says what stands in the way.
    fn go_down(&mut self) -> Result<(), String> {
        let limit = clock::now() + STOP_LIMIT;
        self.exchange.main_mut().stop();
        loop {
            let more = match self.exchange.step(limit) {
                Ok(more) => more,
                Err(error) => return Err(format!("the way down: {error}")),
            };
            while let Some(event) = self.exchange.poll_event() {
                match event {
                    Event::Stopped => return Ok(()),
                    Event::Failed(error) => return Err(format!("the way down: {error}")),
                    _ => {}
                }
            }
            if !more || clock::now() >= limit {
                return Err("the way down did not end; SubDevices may still be in OP".to_owned());
            }
        }
    }

    /// Reads the counters of all SubDevices over the wire, while process data go on; at the end their states
    /// and clocks too.
    fn read(&mut self, devices: &mut [AtEnd], before: bool) -> Result<(), End> {
        let mut asked = Vec::new();
        let limit = clock::now() + READ_LIMIT;
        for position in 0..devices.len() {
            for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
                for object in self.counters_of(position, index) {
                    let request = self.exchange.main_mut().upload(position, object);
                    asked.push((request, position, Question::Counter(object)));
                }
            }
            if before {
                continue;
            }
            let main = self.exchange.main_mut();
            let status = register::AL_STATUS.address;
            let request = main.read_memory(position, status, STATUS_LEN);
            asked.push((request, position, Question::Status));
            if main.segment().devices[position].dc.has_clock() {
                let address = register::SYSTEM_TIME_DIFFERENCE.address;
                let len = Register::<SystemTimeDifference>::LEN;
                let request = main.read_memory(position, address, len);
                let polarity = main.segment().devices[position].difference_polarity;
                asked.push((request, position, Question::Difference(polarity)));
            }
        }
        self.noted.answers.clear();
        while self.noted.answers.len() < asked.len() {
            let now = clock::now();
            if now >= limit || self.exchange.is_silent(SILENCE) {
                break;
            }
            if before && self.stop.load(Ordering::Relaxed) {
                return Err(End::Asked);
            }
            if !self.exchange.step(limit).map_err(End::Link)? {
                break;
            }
            self.take_events(now);
        }
        for (request, position, question) in asked {
            let mut answers = self.noted.answers.iter();
            let answer = answers.find(|(id, _)| *id == request);
            let Some((_, Some(bytes))) = answer else { continue };
            devices[position].take(question, bytes, before);
        }
        Ok(())
    }

    /// The counters that a SubDevice has in 0x1C32 or 0x1C33.
    fn counters_of(&self, position: usize, index: u16) -> Vec<ObjectAddress> {
        let device = &self.exchange.main().segment().devices[position];
        let object = match index {
            OUTPUT_PARAMETER => &device.output_sync,
            _ => &device.input_sync,
        };
        let present = |sub: &u8| object.as_ref().is_some_and(|o| o.entry(*sub).is_some());
        COUNTERS.into_iter().filter(present).map(|sub| ObjectAddress::new(index, sub)).collect()
    }

    /// Tells the scribe of an event, if there is one.
    fn tell(&mut self, event: &Event) {
        if let Some(scribe) = &mut self.scribe {
            scribe.event((clock::now() - self.origin).0, event);
        }
    }

    /// Lets the scribe see what was read, and fill its board if that is due. It neither waits nor takes memory.
    fn publish(&mut self) {
        let Some(scribe) = &mut self.scribe else { return };
        let (at, main) = ((clock::now() - self.origin).0, self.exchange.main());
        scribe.cycle(main);
        if scribe.is_due(at) {
            // If somebody is just looking at the board, the next cycle does it.
            scribe.publish(at, main, |_, _| {});
        }
    }

    fn take_events(&mut self, now: Time<Host>) {
        let judging = self.began.filter(|_| self.judged == Some(Nanos::ZERO));
        while let Some(event) = self.exchange.poll_event() {
            self.tell(&event);
            if let (Some((device, change)), Some(began)) = (SegmentChange::of(&event), judging) {
                self.noted.changes.push((device, change, now - began));
            }
            match (event, judging) {
                (Event::Uploaded { request, result }, _) => {
                    self.noted.answers.push((request, result.ok()));
                }
                (Event::Read { request, result }, _) => {
                    self.noted.answers.push((request, result.ok()));
                }
                (Event::StateChanged { position, status, code, .. }, Some(began)) => {
                    self.noted.states.push((position, status, code, now - began));
                }
                (Event::CountChanged { expected, found, .. }, Some(began)) if found != expected => {
                    self.noted.counts.push((expected, found, now - began));
                }
                (Event::Phase { state, .. }, Some(_)) if state != phase::State::Locked => {
                    self.noted.locks_lost += 1;
                }
                (Event::Alarm(change), Some(began)) => {
                    self.noted.alarms.push((now - began, change));
                }
                (Event::CyclesSkipped { late, .. }, Some(began))
                    if self.noted.stall.is_none_or(|(longest, _)| late > longest) =>
                {
                    self.noted.stall = Some((late, now - began));
                }
                _ => {}
            }
        }
    }
}

/// Something asked of a SubDevice.
#[derive(Clone, Copy)]
enum Question {
    Counter(ObjectAddress),
    Status,
    Difference(DifferencePolarity),
}

impl AtEnd {
    fn take(&mut self, question: Question, bytes: &[u8], before: bool) {
        match question {
            Question::Counter(object) => {
                let number =
                    bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte));
                let counters = match (object.index, before) {
                    (OUTPUT_PARAMETER, true) => &mut self.outputs_before,
                    (OUTPUT_PARAMETER, false) => &mut self.outputs,
                    (_, true) => &mut self.inputs_before,
                    (_, false) => &mut self.inputs,
                };
                let counter = match object.sub {
                    sub::SM_EVENT_MISSED => &mut counters.sm_event_missed,
                    sub::CYCLE_TIME_TOO_SMALL => &mut counters.cycle_time_too_small,
                    sub::SHIFT_TIME_TOO_SHORT => &mut counters.shift_time_too_short,
                    _ => &mut counters.sync_error,
                };
                *counter = Some(number);
            }
            Question::Status => {
                let word = |at: usize| {
                    bytes
                        .get(at..)
                        .and_then(|rest| rest.first_chunk())
                        .copied()
                        .map(u16::from_le_bytes)
                };
                self.status = word(0).zip(word(4)).map(|(s, c)| (AlStatus(s), AlStatusCode(c)));
            }
            Question::Difference(polarity) => {
                let bytes = bytes.first_chunk().copied();
                self.difference =
                    bytes.map(|bytes| SystemTimeDifference::from_bytes(bytes).nanos(polarity));
            }
        }
    }
}

/// Time after which a way up that has not ended is given up; every step of it has a deadline of its own,
/// far below.
const BRING_UP_LIMIT: Nanos = Nanos::millis(300_000);
/// For reading the counters.
const READ_LIMIT: Nanos = Nanos::millis(10_000);
/// For the way down: three steps of 5 s, and room.
const STOP_LIMIT: Nanos = Nanos::millis(20_000);
/// The longest time without an answer.
pub(super) const SILENCE: Nanos = Nanos::millis(1_000);
/// Steps of the progress that is told.
const PROGRESS: Nanos = Nanos::millis(100);
/// AL status, a gap, AL status code.
const STATUS_LEN: usize = 6;
const COUNTERS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];

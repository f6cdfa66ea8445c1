//! The main job on a wire: the way up, a time in operation, the SubDevices' readings at the end,
//! and the way down.

use std::sync::atomic::{AtomicBool, Ordering};

use isocat_host::preflight::{self, Subject};
use isocat_host::{
    Exchange, Figures, Histogram, LinkError, RawSocket, RealTime, Recorder, Traffic, Waiting, Wish,
    clock,
};
use isocat_maindevice::motion::Axis;
use isocat_maindevice::quality::Change;
use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Config, DeviceConfig, Event, Motion, Segment};
use isocat_sim::Finding;
use isocat_sim::run::Progress;
use isocat_sync::phase;
use isocat_wire::time::{Host, Nanos, Time};

use super::judge;
use crate::report::quality::Quality;
use crate::status::Scribe;
use crate::verdict::{Answer, Engine, Questions, Readings, Unknown, Verdict};

/// A job for one interface.
pub struct Job {
    /// The configuration of the MainDevice.
    pub config: Config,
    /// The open interface.
    pub socket: RawSocket,
    /// Its network namespace.
    pub namespace: Option<String>,
    /// Time to run once all SubDevices are in OP.
    pub duration: Nanos,
    /// Largest 0x092C with which a clock counts as synchronized.
    pub difference_limit: Nanos,
    /// The real-time settings to request from the machine.
    pub wish: Wish,
    /// The recorder of frames.
    pub recorder: Option<Recorder>,
    /// The receiver of the status, about ten times a second.
    pub scribe: Option<Scribe>,
}

/// The machine as it was before the run.
#[derive(Clone, Debug)]
pub struct Machine {
    /// Real-time settings that were granted.
    pub granted: Vec<String>,
    /// Real-time settings that were refused, with advice.
    pub refused: Vec<String>,
    /// Settings that are harmful.
    pub findings: Vec<preflight::Finding>,
    /// Measured lateness of wake-ups.
    pub wake_ups: Histogram,
}

impl Machine {
    /// Requests real-time settings for the calling thread, and checks the machine. While the first
    /// returned value is kept, processors stay awake.
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

/// The result of a run.
#[derive(Debug)]
pub struct Outcome {
    /// The machine.
    pub machine: Machine,
    /// The segment that was found on the wire.
    pub segment: Segment,
    /// Counts at the beginning and at the end of the time in operation.
    pub statistics: (Statistics, Statistics),
    /// Punctuality of the machine in operation.
    pub figures: Figures,
    /// The servo at the end of the time in operation.
    pub phase: Option<phase::State>,
    /// How often the servo lost its lock in that time.
    pub locks_lost: u64,
    /// The longest time that the machine was late for a cycle: the lateness, and the time since the
    /// beginning of operation.
    pub stall: Option<(Nanos, Nanos)>,
    /// How much faster the reference clock runs than the host's.
    pub rate_ppb: Option<i64>,
    /// Uncertainty of that rate and of the phase.
    pub uncertainty: Option<phase::Uncertainty>,
    /// The application's view of each SubDevice.
    pub axes: Vec<Axis>,
    /// Readings of each SubDevice, before and at the end, by position.
    pub devices: Vec<Readings>,
    /// Time in operation; `None` if it never began.
    pub judged: Option<Nanos>,
    /// The reason for the end of the run.
    pub end: End,
    /// Result of the background reads; `None` if they were not requested, or operation was not
    /// reached.
    pub quality: Option<Quality>,
    /// Why the segment is not in sync.
    pub findings: Vec<Finding>,
    /// What could not be determined about the segment.
    pub unknown: Vec<Unknown>,
    /// Departures and returns of SubDevices that may be absent.
    pub visits: Vec<Finding>,
    /// Further notes for the reader.
    pub notes: Vec<String>,
    /// The recorder; the caller finishes it.
    pub recorder: Option<Recorder>,
}

impl Outcome {
    /// Whether every SubDevice ran as asked, or that this is not known.
    pub fn answer(&self) -> Answer {
        Answer::of(&self.findings, &self.unknown)
    }

    /// Adds the reason for the end of the run, and notes on it. `carrier` is whether the interface
    /// had a signal at the end, `jitter` the lateness that the plan allows, `total` the counts of
    /// all frames, and `traffic` the counts of the interface before and after.
    pub fn conclude(
        &mut self,
        interface: &str,
        carrier: Option<bool>,
        jitter: Nanos,
        total: Statistics,
        traffic: Option<(Traffic, Traffic)>,
    ) {
        judge::judge(self, interface, carrier);
        judge::note(self, interface, jitter, total, traffic);
    }

    /// The error of the MainDevice that ended the way up.
    pub fn failure(&self) -> Option<&isocat_maindevice::Error> {
        match &self.end {
            End::Failed(error) => Some(error),
            _ => None,
        }
    }
}

/// The reason for the end of a run.
#[derive(Debug)]
pub enum End {
    /// The time was over.
    Time,
    /// The user asked to stop.
    Asked,
    /// The way up failed.
    Failed(isocat_maindevice::Error),
    /// The way up of another tool's list of commands ended at one of its commands.
    List {
        /// The command, and what happened.
        what: String,
        /// The SubDevice whose command it is; `None` for those of the MainDevice.
        position: Option<usize>,
        /// Whether the list asks for something that is not supported, or names other SubDevices
        /// than those that answer.
        refused: bool,
    },
    /// The way up took too long.
    TooLong,
    /// No frame came back any more.
    Silence,
    /// The interface failed.
    Link(LinkError),
}

impl Job {
    /// Runs the whole job, on a separate thread with real-time settings. It ends early once `stop`
    /// is set. An error is one of the interface or of its namespace, before anything was sent.
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
        let optional = self.config.devices.iter().map(DeviceConfig::may_be_absent).collect();
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
            alarms: Vec::new(),
            questions: None,
            began: None,
            engine: None,
            received: 0,
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
                run.began = Some(clock::now());
                let main = run.exchange.main();
                run.engine = Some(Engine::begin(main, self.difference_limit, optional));
                statistics.0 = main.statistics();
                // The counters may have any value: their growth in operation is judged.
                devices = vec![Readings::default(); main.segment().devices.len()];
                let read = run.read(&mut devices, true);
                let end = read.err().unwrap_or_else(|| run.operate(self.duration));
                statistics.1 = run.exchange.main().statistics();
                end
            }
        };
        let (phase, rate_ppb) = (run.exchange.main().phase(), run.exchange.main().rate_ppb());
        let uncertainty = run.exchange.main().phase_uncertainty();
        let answers = run.judged.is_some() && matches!(end, End::Time | End::Asked);
        let mut notes = Vec::new();
        let read = if answers { run.read(&mut devices, false) } else { Ok(()) };
        if let Err(End::Link(error)) = read {
            notes.push(format!("reading the counters at the end: {error}"));
        }
        let verdict = run.end_judging(if answers { &devices } else { &[] });
        let segment = run.exchange.main().segment().clone();
        let quality = Quality::new(run.exchange.main(), watch);
        let carrier = run.exchange.socket().has_carrier();
        let down = match end {
            // Nothing more can be sent, or the MainDevice sends nothing more.
            End::Link(_) | End::Failed(_) | End::List { .. } => Ok(()),
            _ => run.go_down(),
        };
        notes.extend(down.err());
        let Running { exchange, alarms, judged, .. } = run;
        let Verdicts { verdict, locks_lost, stall } = verdict;
        let mut outcome = Outcome {
            machine,
            segment,
            statistics,
            figures: *exchange.figures(),
            phase,
            locks_lost,
            stall,
            rate_ppb,
            uncertainty,
            axes: exchange.application().axes().to_vec(),
            devices,
            judged,
            end,
            quality: quality.map(|quality| quality.with_alarms(&alarms)),
            findings: verdict.findings,
            unknown: verdict.unknown,
            visits: verdict.visits,
            notes,
            recorder: None,
        };
        let after = Traffic::of(&interface, namespace);
        let total = exchange.main().statistics();
        outcome.conclude(&interface, carrier, jitter, total, before.zip(after));
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
    /// Origin of the scribe's times.
    origin: Time<Host>,
    /// Alarms of the background reads, and the time of each.
    alarms: Vec<(Nanos, Change)>,
    /// The present questions to the SubDevices.
    questions: Option<Questions>,
    /// The instant when all SubDevices were in OP; judging starts there.
    began: Option<Time<Host>>,
    engine: Option<Engine>,
    /// Number of frames that had come back when the engine last took the data.
    received: u64,
    /// Duration of the judged time, once it is over.
    judged: Option<Nanos>,
}

/// The results of the time in operation.
#[derive(Default)]
struct Verdicts {
    verdict: Verdict,
    locks_lost: u64,
    stall: Option<(Nanos, Nanos)>,
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

    /// Runs the segment. It is never inlined, so that a profile separates operation from the ways
    /// up and down.
    #[inline(never)]
    fn operate(&mut self, duration: Nanos) -> End {
        let began = clock::now();
        let until = began + duration;
        let mut told = began;
        self.exchange.measure(true);
        let end = loop {
            if let Err(error) = self.exchange.step(until) {
                break End::Link(error);
            }
            let now = self.exchange.now();
            if self.has_news() {
                self.take_events(now);
            }
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
        self.judged = Some(clock::now() - self.began.unwrap_or(began));
        end
    }

    /// Ends the time in operation; `readings` are those of the SubDevices, if they were asked.
    fn end_judging(&mut self, readings: &[Readings]) -> Verdicts {
        let now = clock::now();
        self.take_events(now);
        let (Some(engine), Some(began)) = (self.engine.take(), self.began) else {
            return Verdicts::default();
        };
        let (locks_lost, stall) = (engine.locks_lost(), engine.stall());
        let axes = self.exchange.application().axes();
        let verdict = engine.end(now - began, self.exchange.main(), axes, readings);
        Verdicts { verdict, locks_lost, stall }
    }

    /// Goes back to INIT; the error says why that failed.
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

    /// Reads the counters of all SubDevices over the wire, while process data go on; at the end
    /// also their states and clocks.
    fn read(&mut self, devices: &mut [Readings], before: bool) -> Result<(), End> {
        let limit = clock::now() + READ_LIMIT;
        self.questions = Some(Questions::ask(self.exchange.main_mut(), before));
        while !self.questions.as_ref().is_none_or(Questions::are_answered) {
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
        if let Some(questions) = self.questions.take() {
            questions.fill(devices);
        }
        Ok(())
    }

    /// Passes an event to the scribe, if there is one.
    fn tell(&mut self, event: &Event) {
        if let Some(scribe) = &mut self.scribe {
            scribe.event((clock::now() - self.origin).0, event);
        }
    }

    /// Passes what was read to the scribe, and lets it fill its board if that is due. It neither
    /// waits nor allocates.
    fn publish(&mut self) {
        let Some(scribe) = &mut self.scribe else { return };
        let (at, main) = ((clock::now() - self.origin).0, self.exchange.main());
        scribe.cycle(main);
        if scribe.is_due(at) {
            // If a reader holds the board at the moment, the next cycle publishes.
            scribe.publish(at, main, |_, _| {});
        }
    }

    /// Whether a frame has come back, or there are events, since they were last taken. A step that
    /// only sends has nothing to tell.
    #[inline(always)]
    fn has_news(&self) -> bool {
        self.exchange.main().counts().frames_received != self.received || self.exchange.has_event()
    }

    /// Takes the events, and passes them and the received data to the verdict engine.
    fn take_events(&mut self, now: Time<Host>) {
        self.received = self.exchange.main().counts().frames_received;
        let at = self.began.map(|began| now - began);
        while let Some(event) = self.exchange.poll_event() {
            self.tell(&event);
            if let (Some(engine), Some(at)) = (&mut self.engine, at) {
                engine.event(at, &event);
            }
            if let Some(questions) = &mut self.questions {
                questions.event(&event);
            }
            if let (Event::Alarm(change), Some(at)) = (event, at)
                && self.alarms.len() < MOST_ALARMS
            {
                self.alarms.push((at, change));
            }
        }
        if let (Some(engine), Some(at)) = (&mut self.engine, at) {
            engine.cycle(at, self.exchange.main());
        }
    }
}

/// Time limit of the way up; every step of it has a much shorter deadline.
const BRING_UP_LIMIT: Nanos = Nanos::millis(300_000);
/// Time limit for reading the counters.
const READ_LIMIT: Nanos = Nanos::millis(10_000);
/// Time limit of the way down: three steps of 5 s, and a reserve.
const STOP_LIMIT: Nanos = Nanos::millis(20_000);
/// The longest time without an answer.
pub(super) const SILENCE: Nanos = Nanos::millis(1_000);
/// Interval of the progress reports.
const PROGRESS: Nanos = Nanos::millis(100);
/// Largest number of alarms that are kept, however long the run is.
const MOST_ALARMS: usize = 1_000;

//! The served segment without sockets and threads: frames and host time go in, answers and events
//! come out.

use std::collections::VecDeque;

use isocat_engine::status::edges::Onlooker;
use isocat_engine::status::{Event as Told, Status};
use isocat_rules::{Breached, Claims};
use isocat_segment::fault::Order;
use isocat_segment::scenario;
use isocat_sim::expect::Judgement;
use isocat_sim::fault::{Happened, Moment, RING_CABLE};
use isocat_sim::observation::Observed;
use isocat_sim::{Connection, Fault, MainPort, Passage, Served, ServedCycle, Tap, Timeline};
use isocat_wire::datagram::datagrams;
use isocat_wire::dc::SyncActivation;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, Command, frame, register};

use super::conduct::{Conduct, Reference, Seen};
use super::deed::Deed;
use super::evidence;
use super::expect::Watch;
use super::process_data::Handle;
use super::setup::Setup;
use super::verdict::{Case, Judged};
use crate::status::{self, INTERVAL, INTERVALS, MOST_EVENTS};
use crate::taps;

/// A virtual segment for frames from outside.
///
/// - For every frame: [`frame`](Self::frame) returns its [`Answer`] ([`frame_at`](Self::frame_at)
///   with two ports); after the answer is sent, [`after`](Self::after).
/// - Ports of a ring: [`has_two_ports`](Self::has_two_ports), [`link`](Self::link).
/// - While no frames come: [`idle`](Self::idle), at [`next_timeout`](Self::next_timeout) at the
///   latest.
/// - Process data: [`outputs`](Self::outputs), [`set_inputs`](Self::set_inputs).
/// - Results: [`poll_event`](Self::poll_event) for each event, and [`sessions`](Self::sessions) at
///   the end, after [`finish`](Self::finish).
pub struct Server {
    served: Served,
    /// The process data of each SubDevice.
    doors: Vec<Handle>,
    names: Vec<String>,
    sync0_limit: Picos,
    outputs_spread: Picos,
    /// What the segment is meant to do.
    claims: Claims,
    events: VecDeque<Event>,
    ended: Vec<Session>,
    /// Number of sessions and faults that were dropped.
    left_out: LeftOut,
    session: Option<Session>,
    /// The last frame that passed.
    passage: Option<Passage>,
    source: [u8; 6],
    /// Host time of the last frame, and the last host time that was given.
    last_frame: Time<Host>,
    /// The SubDevice whose time was last distributed.
    reference: Option<(Reference, usize)>,
    counts: Counts,
    ring: bool,
    /// Whether the caller executes faults of the MainDevice's machine.
    has_host: bool,
    /// The instant since which frames come from the secondary port only.
    secondary_alone: Option<Time<True>>,
    /// State of each SubDevice at the last observation.
    states: Vec<AlState>,
    /// The last events, for status requests.
    told: VecDeque<Told>,
    /// Collects recent figures, from the first status request on.
    onlooker: Option<Box<Onlooker>>,
    /// Observes the segment for its expectations.
    watch: Watch,
    /// Records what happens.
    tap: Option<Box<dyn Tap + Send>>,
    /// Number of judged cycles in all sessions.
    cycles: u64,
}

/// The fate of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// The frame goes back.
    Back {
        /// The port of the MainDevice at which it arrives: in a whole ring this is not the one that
        /// it left.
        port: MainPort,
        /// The instant at which its last bit is back at the MainDevice's port, if only the wire
        /// takes time. It includes an injected delay. It is rounded up to the ns, so never before
        /// the true instant.
        last_bit: Time<Host>,
        /// For an interface in real time, which itself takes longer than the wire: the answer must
        /// be held back until this instant. `None`: it must leave at once.
        hold: Option<Time<Host>>,
    },
    /// The frame does not go back.
    Lost,
}

/// Counters of the frames of all sessions.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Frames that came in.
    pub frames: u64,
    /// Frames that came back.
    pub answered: u64,
    /// Frames that were lost in the segment or by an injected fault.
    pub lost: u64,
    /// Frames that had to wait because they came faster than a wire carries them.
    pub held: u64,
}

/// Counts of old sessions and faults that were dropped.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct LeftOut {
    /// Number of sessions.
    pub sessions: u64,
    /// Number of injected faults.
    pub faults: u64,
}

/// The time from the first frame of a MainDevice to its last.
#[derive(Clone, Debug)]
pub struct Session {
    /// The conduct of the MainDevice.
    pub conduct: Conduct,
    /// For each of PREOP, SAFEOP and OP: the first and the last SubDevice that reached it.
    pub reached: [Option<Reached>; 3],
    /// Refused and lost states in order; only the first few are kept.
    pub refused: Vec<Refused>,
    /// The last stretch of operation; `None` if no SubDevice was ever in OP.
    pub judged: Option<Judged>,
    /// Earlier stretches. Each ended when a SubDevice was asked to leave OP, as one that has fallen
    /// is.
    pub earlier: Vec<Judged>,
    /// Number of further stretches, which are only counted.
    pub earlier_left_out: u64,
    /// How things stood when the MainDevice gave up, if nothing ever came to operation.
    pub attempt: Option<Attempt>,
    /// The end of the session.
    pub end: End,
    /// The judges are at work.
    judging: bool,
    /// Frames have stopped; the judges' results are as of then.
    silent: bool,
    /// The last requested state.
    requested: AlState,
    /// The state that was requested before the last pause in the exchange; kept until the exchange
    /// continues.
    paused: Option<AlState>,
    pending: bool,
}

/// How things stood when a MainDevice gave up before anything was in operation.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// State of each SubDevice.
    pub states: Vec<AlState>,
    /// 0x0981 of each SubDevice.
    pub activations: Vec<SyncActivation>,
    /// What was otherwise than it was meant.
    pub breached: Vec<Breached>,
}

/// The SubDevices that reached a state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reached {
    /// Instant of the first one.
    pub first: Time<True>,
    /// Instant of the last one so far.
    pub last: Time<True>,
    /// Number of times that a SubDevice reached the state.
    pub count: u64,
}

/// A SubDevice that left a state by itself or refused one.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Refused {
    /// The instant.
    pub at: Time<True>,
    /// Position of the SubDevice.
    pub device: usize,
    /// Its present state.
    pub state: AlState,
    /// The reason.
    pub code: AlStatusCode,
}

/// How a session ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// The session is still open.
    Open,
    /// Frames stopped, and the last requested state was below SAFEOP.
    Down,
    /// Frames stopped, and the last requested state was SAFEOP or OP.
    Abrupt,
}

/// An event of the served segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Event {
    /// A MainDevice has begun to send.
    SessionBegan {
        /// Its source address.
        source: [u8; 6],
    },
    /// A SubDevice changed its state.
    State {
        /// The instant, true time.
        at: Time<True>,
        /// Position of the SubDevice.
        device: usize,
        /// The new state.
        state: AlState,
        /// The reason, if the change was not requested.
        code: AlStatusCode,
    },
    /// All SubDevices that were asked for are in OP, and the judges begin.
    InOperation {
        /// Number of SubDevices in OP.
        devices: usize,
    },
    /// A fault began or ended.
    Fault(Happened),
    /// No frame has been sent for a while.
    SessionEnded {
        /// Whether the last requested state was SAFEOP or OP.
        abrupt: bool,
    },
}

/// Length of a silence that ends a session. No MainDevice waits as long for a mailbox or a state.
pub const SILENCE: Nanos = Nanos::millis(15_000);
/// Length of a silence in operation that is always tolerated, whatever the cycle.
const LEAST_HUSH: Nanos = Nanos::micros(200);
/// How far frames may be ahead of the wire before they are held back to its speed.
const LEAD: Nanos = Nanos::millis(1);
/// Interval of updates while the segment may change by itself.
pub const TICK: Nanos = Nanos::millis(100);
/// Least silence between a session that went back to INIT and the next one.
const PAUSE_DOWN: Nanos = Nanos::millis(50);
/// Least silence after a session that did not go back to INIT.
const PAUSE: Nanos = Nanos::millis(250);
/// A sender of a frame within this time counts as still present.
const STILL_THERE: Nanos = Nanos::millis(1_000);
/// Frames from the secondary port are copies, or frames that a MainDevice sends for its ring,
/// unless the primary port has been silent for this long.
const ALONE: Picos = Picos(100_000_000_000);
/// Number of refusals that are kept.
const MOST_REFUSED: usize = 32;
/// Number of stretches of operation that are kept.
const MOST_STRETCHES: usize = 256;
/// Number of records of ended sessions that are kept: some 40 MB.
const MOST_RECORDS: usize = 50_000;

impl Server {
    /// A segment that is switched on at `now`, from a [`Scenario`](isocat_segment::Scenario) or a
    /// setup made by hand.
    pub fn new(setup: impl Into<Setup>, now: Time<Host>) -> Self {
        let setup: Setup = setup.into();
        let Setup { sync0_limit, outputs_spread, shows_process_data, has_host, .. } = setup;
        let Setup { mut segment, ring, names, seed, faults, spares, expectations, claims, .. } =
            setup;
        let (of_the_host, planned): (Vec<_>, Vec<_>) =
            faults.into_iter().partition(|planned| is_left_out(&planned.fault, has_host));
        let timeline = Timeline::new(planned, seed).with_spares(spares);
        let watch = Watch::new(expectations, !of_the_host.is_empty(), segment.len());
        let outputs = |connection: &Connection| connection.device.description.outputs.max_length;
        let shown = if shows_process_data { &segment[..] } else { &[] };
        let doors: Vec<Handle> =
            shown.iter().map(|connection| Handle::new(outputs(connection))).collect();
        for (connection, door) in segment.iter_mut().zip(&doors) {
            let application = std::mem::replace(&mut connection.device.application, Box::new(()));
            connection.device.application = door.before(application);
        }
        Self {
            doors,
            states: vec![AlState::Init; segment.len()],
            told: VecDeque::new(),
            onlooker: None,
            watch,
            tap: None,
            cycles: 0,
            served: Served::new(segment, seed, now).in_ring(ring).with_faults(timeline),
            ring: ring.is_some(),
            has_host,
            secondary_alone: None,
            names,
            sync0_limit,
            outputs_spread,
            claims,
            events: VecDeque::new(),
            ended: Vec::new(),
            left_out: LeftOut::default(),
            session: None,
            passage: None,
            source: [0; 6],
            last_frame: now,
            reference: None,
            counts: Counts::default(),
        }
    }

    /// Handles a frame that came in at `arrived`. If it goes back, `bytes` contain the answer.
    pub fn frame(&mut self, arrived: Time<Host>, bytes: &mut [u8]) -> Answer {
        self.frame_at(MainPort::Primary, arrived, bytes)
    }

    /// Handles a frame that came in from one of the two ports of a MainDevice.
    pub fn frame_at(&mut self, from: MainPort, arrived: Time<Host>, bytes: &mut [u8]) -> Answer {
        self.counts.frames += 1;
        self.last_frame = arrived.max(self.last_frame);
        self.source = bytes.get(6..12).and_then(|s| s.first_chunk()).copied().unwrap_or_default();
        let before = self.tap.is_some().then(|| bytes.to_vec());
        let passage = self.served.frame_at(from, arrived, bytes);
        if let (Some(tap), Some(before)) = (&mut self.tap, before) {
            taps::show(tap.as_mut(), &passage, &before, bytes);
        }
        self.passage = Some(passage);
        let back = match passage.fate {
            Ok(back) if back.good => back,
            _ => {
                self.counts.lost += 1;
                return Answer::Lost;
            }
        };
        self.counts.answered += 1;
        // A real wire does not carry more than 100 Mbit/s either.
        let held = self.served.host_time(passage.start) - arrived > LEAD;
        // True time has picoseconds; this rounds up to the next nanosecond.
        let last_bit = self.served.host_time(back.last_bit + Picos(999));
        self.counts.held += u64::from(held);
        let hold = match (held, passage.late) {
            (false, Nanos::ZERO) => None,
            (false, late) => Some(arrived + late),
            (true, _) => Some(last_bit),
        };
        Answer::Back { port: back.port, last_bit, hold }
    }

    /// Shows frames, and events at SubDevices, to a tap that records them: a capture, waveforms, a
    /// trace. The tap gets no calls about the MainDevice's inside, which only a simulated
    /// MainDevice has.
    pub fn with_tap(mut self, tap: Box<dyn Tap + Send>) -> Self {
        self.served.show_everything();
        self.tap = Some(tap);
        self
    }

    /// Whether the segment is a ring between two ports of the MainDevice.
    pub fn has_two_ports(&self) -> bool {
        self.ring
    }

    /// Sets or removes the link at a port of the MainDevice as of `now`. In a ring the device at
    /// that port notices, as with a cable that is pulled, and frames from the other port turn round
    /// there.
    pub fn link(&mut self, now: Time<Host>, port: MainPort, up: bool) {
        self.served.advance(now);
        self.settle();
        self.served.link(port, up);
    }

    /// Notes that a program whose sockets can be seen is about to send a frame of its cycle, and
    /// whether it has not taken the answer to the last one of its kind, though that has come.
    pub fn about_to_send(&mut self, has_untaken: bool) {
        if let Some(session) = &mut self.session {
            let [untaken, sent] = session.conduct.cycle.untaken.get_or_insert_default();
            *untaken += u64::from(has_untaken);
            *sent += 1;
        }
    }

    /// Evaluates the last frame of [`frame`](Self::frame), after its answer was sent.
    pub fn after(&mut self, bytes: &[u8]) {
        let Some(passage) = self.passage.take() else { return };
        let source = self.source;
        if !self.leads(&passage) {
            if let Some(session) = &mut self.session
                && session.conduct.second_port(bytes)
            {
                self.served.carried_process_data(&passage, bytes.len());
            }
            return self.settle();
        }
        if self.session.as_mut().is_some_and(|session| session.is_over(passage.start, bytes)) {
            self.end_session();
        }
        let session = self.session.get_or_insert_with(|| {
            self.events.push_back(Event::SessionBegan { source });
            Session::new(passage.start)
        });
        let exchanged = session.conduct.done(Deed::ProcessData).is_some();
        let mut seen = session.conduct.frame(passage.start, source, bytes);
        // Station addresses are never written again in the middle: another MainDevice begins,
        // without a pause.
        if seen.addresses && exchanged {
            self.end_session();
            let mut session = Session::new(passage.start);
            seen = session.conduct.frame(passage.start, source, bytes);
            self.session = Some(session);
            self.events.push_back(Event::SessionBegan { source });
        }
        let Some(session) = &mut self.session else { return };
        session.silent = false;
        self.watch.goes_on();
        if seen.process_data {
            self.served.carried_process_data(&passage, bytes.len());
        }
        self.settle();
        if let Some(reference) = seen.reference {
            self.take_reference(reference);
        }
        let back = passage.fate.map_or(passage.start, |back| back.last_bit);
        self.follow(seen, passage.start);
        if seen.cycle && self.session.as_ref().is_some_and(|session| session.judging) {
            self.cycles += 1;
            let cycle = ServedCycle { number: self.cycles, frames_lost: self.counts.lost };
            self.show_cycle(back, Some(cycle));
        }
    }

    /// Tells the tap about the end of a judged cycle, or about the judged time.
    fn show_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>) {
        if let Some(tap) = &mut self.tap {
            tap.served_cycle(at, cycle, self.served.segment());
        }
    }

    /// Whether a frame shows what the MainDevice does: normally one of the primary port. At the
    /// secondary port a MainDevice with a ring sends copies, or frames that only test the way, and
    /// everything would seem to be done twice. If the primary port is silent, the secondary one
    /// counts.
    fn leads(&mut self, passage: &Passage) -> bool {
        match passage.from {
            MainPort::Primary => {
                self.secondary_alone = None;
                true
            }
            MainPort::Secondary => {
                let since = *self.secondary_alone.get_or_insert(passage.start);
                passage.start - since >= ALONE
            }
        }
    }

    /// Moves time to `now` without a frame.
    pub fn idle(&mut self, now: Time<Host>) {
        self.hush(now);
        if self.session.is_some() && now - self.last_frame > SILENCE {
            self.end_session();
        }
        self.served.advance(now);
        self.settle();
    }

    /// As [`idle`](Self::idle) while frames come often: `to` must be an instant before which no
    /// more frame can come.
    pub fn catch_up(&mut self, to: Time<Host>) {
        self.hush(to);
        self.served.advance(to);
        self.settle();
    }

    /// Judges the present session as of `now` without ending it.
    pub fn take_stock(&mut self, now: Time<Host>) {
        self.idle(now);
        let judged = self.judged();
        if let Some(session) = &mut self.session {
            session.judged = judged;
        }
    }

    /// The next instant at which [`idle`](Self::idle) is needed, if no frame comes.
    pub fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>> {
        // A segment without a MainDevice, and with no SubDevice above INIT, has nothing to do.
        let quiet = |device: &isocat_sim::device::Device| device.is_quiet();
        let asleep = self.session.is_none()
            && self.served.timeline().next().is_none()
            && self.served.segment().devices().iter().all(quiet);
        (!asleep).then_some(now + TICK)
    }

    /// When the next planned fault happens, if its time is known.
    pub fn next_fault(&self) -> Option<Time<Host>> {
        self.served.timeline().next().map(|at| self.served.host_time(at))
    }

    /// Injects a fault as of `now`. Returns an error if the order is not possible.
    pub fn inject(&mut self, now: Time<Host>, order: Order) -> Result<(), String> {
        self.served.advance(now);
        self.settle();
        self.inject_at(now, order)?;
        self.tell_faults();
        Ok(())
    }

    /// Plans a fault for the instant `at`, or for now if that is in the past. Returns an error if
    /// the order is not possible.
    pub fn inject_at(&mut self, at: Time<Host>, order: Order) -> Result<(), String> {
        let Order { fault, lasts, spare } = order;
        if !self.ring && fault.cable() == Some(RING_CABLE) {
            return Err("ring is the cable that closes a ring, and this segment is none".into());
        }
        if is_left_out(&fault, self.has_host) {
            return Err(format!(
                "{fault}: that happens to the machine of the MainDevice, which is not simulated here"
            ));
        }
        let spare = spare.as_deref().map(scenario::device);
        if let (Fault::Replace { device, .. }, Some(setup)) = (&fault, &spare) {
            let fits = self.served.segment().takes(*device, &setup.chip);
            fits.map_err(|port| format!("the other device has no such port {port} as is wired"))?;
        }
        self.served.inject(at, fault, lasts, spare);
        Ok(())
    }

    /// Takes the second answer of the last frame, if it was duplicated on its way: its port, the
    /// instant at which its last bit is back, and its bytes.
    pub fn take_copy(&mut self) -> Option<(MainPort, Time<Host>, Vec<u8>)> {
        let (port, last_bit, bytes) = self.served.take_copy()?;
        if let Some(tap) = &mut self.tap {
            let on_wire = Picos::from(Nanos(frame::duration_ns(bytes.len()) as i64));
            taps::show_frame(tap.as_mut(), port, last_bit + Picos(-on_wire.0), false, &bytes);
        }
        Some((port, self.served.host_time(last_bit + Picos(999)), bytes))
    }

    /// Reports the faults that have begun or ended.
    fn tell_faults(&mut self) {
        let news = self.served.take_news();
        self.events.extend(news.into_iter().map(Event::Fault));
    }

    /// The outputs that the device at `position` took last. `None` while they are in their safe
    /// state, if there is no such device, or if the [`Setup`] has no access to process data.
    pub fn outputs(&self, position: usize) -> Option<Vec<u8>> {
        self.doors.get(position)?.outputs()
    }

    /// Sets the inputs of the device at `position` from its next mapping on; `None` returns them to
    /// its application. Bytes beyond its process image are ignored; bytes that are not set stay
    /// those of its application. The call has no effect if there is no such device or the [`Setup`]
    /// has no access to process data.
    pub fn set_inputs(&mut self, position: usize, inputs: Option<&[u8]>) {
        if let Some(door) = self.doors.get(position) {
            door.set_inputs(inputs);
        }
    }

    /// Takes the next event.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.events.pop_front()?;
        if self.told.len() >= MOST_EVENTS {
            self.told.pop_front();
        }
        let now = self.served.now().as_nanos() as i64;
        self.told.push_back(status::event(&event, now));
        Some(event)
    }

    /// The present status. From the first call on, recent figures are collected too.
    pub fn status(&mut self, segment: &str) -> Status {
        self.settle();
        let onlooker = self.onlooker.take().unwrap_or_else(|| self.new_onlooker());
        let status = status::status(self, segment, &onlooker);
        self.onlooker = Some(onlooker);
        status
    }

    /// Ends the last session at its last frame. A session that still runs at `now` stays open,
    /// since its MainDevice did not end it.
    pub fn finish(&mut self, now: Time<Host>) {
        self.settle();
        if self.session.is_some() {
            self.end_session();
        }
        if now - self.last_frame < STILL_THERE
            && let Some(last) = self.ended.last_mut()
            && last.end == End::Abrupt
        {
            last.end = End::Open;
        }
    }

    /// The last events, oldest first.
    pub fn told(&self) -> impl Iterator<Item = &Told> {
        self.told.iter()
    }
    /// Largest SYNC0 error with which a SubDevice counts as synchronized.
    pub fn sync0_limit(&self) -> Picos {
        self.sync0_limit
    }
    /// The faults that began and ended, with their times; only the newest ones if there were very
    /// many.
    pub fn faults(&self) -> impl ExactSizeIterator<Item = &Happened> {
        self.served.timeline().happened()
    }

    /// The sessions that have ended, in order; only the newest ones if there were very many.
    pub fn sessions(&self) -> &[Session] {
        &self.ended
    }
    /// Number of sessions and faults before these.
    pub fn left_out(&self) -> LeftOut {
        LeftOut { faults: self.served.timeline().left_out(), ..self.left_out }
    }
    /// The present session.
    pub fn session(&self) -> Option<&Session> {
        self.session.as_ref()
    }
    /// Names of the SubDevices.
    pub fn names(&self) -> &[String] {
        &self.names
    }
    /// The segment and its judges.
    pub fn served(&self) -> &Served {
        &self.served
    }
    /// Frames so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }
    /// The SubDevice whose time is distributed; if there is none, the first with a clock.
    pub fn reference(&self) -> usize {
        let clock = |device: &isocat_sim::device::Device| {
            device.esc.register(register::FEATURES) & register::features::DC != 0
        };
        let first = || self.served.segment().devices().iter().position(clock).unwrap_or(0);
        self.reference.map_or_else(first, |(_, position)| position)
    }
    /// The judgements of the [`Setup`]'s expectations. Call [`finish`](Self::finish) before.
    pub fn judgements(&self) -> Vec<Judgement> {
        let sessions = self.ended.iter().chain(&self.session);
        self.watch.judgements(self.served.now(), sessions, self.served.timeline(), self.left_out())
    }
    /// The instant at which SubDevices first came into operation, if there are expectations.
    /// Instants in [`judgements`](Self::judgements) count from it.
    pub fn first_in_operation(&self) -> Option<Time<True>> {
        self.watch.began()
    }
    /// The judges' present results for the current exchange.
    pub fn judged(&self) -> Option<Judged> {
        let session = self.session.as_ref()?;
        let judged = session.judged.as_ref()?;
        Some(if session.judging && !session.silent {
            let case =
                Case { served: &self.served, conduct: &session.conduct, claims: &self.claims };
            judged.until(case, self.served.now())
        } else {
            judged.clone()
        })
    }

    /// An onlooker for judges that are at work or will be.
    fn new_onlooker(&self) -> Box<Onlooker> {
        let mut onlooker = Onlooker::new(self.states.len(), INTERVALS);
        if let Some(intent) = self.served.bench().intent() {
            onlooker.begin(self.served.now(), intent);
        }
        Box::new(onlooker)
    }

    /// Gives the new observations to the judges, and records them.
    fn settle(&mut self) {
        self.tell_faults();
        let now = self.served.now();
        let Self { served, events, session, states, onlooker, watch, tap, .. } = self;
        if let Some(onlooker) = onlooker
            && now - onlooker.began() >= INTERVAL
        {
            onlooker.turn(now);
        }
        served.settle(&mut |segment, observation, measured| {
            if let Some(onlooker) = onlooker {
                onlooker.observe(segment, observation);
            }
            let device = observation.device;
            let at = || segment.devices()[device].oscillator().when(observation.device_at);
            if let Some(tap) = tap {
                let at = at();
                tap.observed(segment, at, observation);
                tap.measured(at, device, measured);
            }
            if watch.follows() {
                let is_judged = session.as_ref().is_some_and(Session::is_judged);
                watch.observe(device, at(), observation.event, measured, is_judged);
            }
            let Observed::State(state, code) = observation.event else { return };
            let at = at();
            events.push_back(Event::State { at, device, state, code });
            let before = std::mem::replace(&mut states[device], state);
            let Some(session) = session else { return };
            // Only a SubDevice that reaches OP can complete the segment, not one that leaves it.
            session.pending |= state == AlState::Op;
            if code != AlStatusCode::NO_ERROR && session.refused.len() < MOST_REFUSED {
                session.refused.push(Refused { at, device, state, code });
            }
            let slot = match state {
                AlState::PreOp => 0,
                AlState::SafeOp => 1,
                AlState::Op => 2,
                AlState::Init | AlState::Boot => return,
            };
            let upward = state as u8 > before as u8;
            if code != AlStatusCode::NO_ERROR || !upward {
                return;
            }
            let reached = &mut session.reached[slot];
            let reached = reached.get_or_insert(Reached { first: at, last: at, count: 0 });
            reached.last = at;
            reached.count += 1;
        });
    }

    fn take_reference(&mut self, reference: Reference) {
        if self.reference.is_some_and(|(known, _)| known == reference) {
            return;
        }
        let devices = self.served.segment().devices();
        let position = match reference {
            Reference::Position(number) => Some(usize::from(number)),
            Reference::Station(station) => devices
                .iter()
                .position(|device| device.esc.register(register::STATION_ADDRESS) == station),
        };
        self.reference = position.filter(|at| *at < devices.len()).map(|at| (reference, at));
    }

    /// Starts and ends the judging according to the states that the MainDevice requests.
    fn follow(&mut self, seen: Seen, at: Time<True>) {
        let reference = self.reference();
        let Some(session) = &mut self.session else { return };
        if let Some(state) = seen.request {
            let before = std::mem::replace(&mut session.requested, state);
            self.watch.asked(at, (before, state), &self.states);
            if matches!(before, AlState::SafeOp | AlState::Op) && (state as u8) < before as u8 {
                self.keep_attempt(reference);
            }
        }
        let Some(session) = &mut self.session else { return };
        let leaves = seen.request.is_some_and(|state| state != AlState::Op);
        if leaves && session.judging {
            self.keep_judged();
            if let Some(session) = &mut self.session {
                session.judging = false;
            }
            self.show_cycle(at, None);
            return;
        }
        if seen.cycle && session.judging {
            let cycle = bus_cycle(&self.served, &self.claims, &session.conduct);
            let reached = self.served.system_time_ps(reference, at);
            session.conduct.cycle.reached(at, reached, cycle);
        }
        if !std::mem::take(&mut session.pending) {
            return;
        }
        let devices = self.served.segment().devices();
        let asked = |device: &&isocat_sim::device::Device| {
            device.esc.register(register::AL_CONTROL).state() == Ok(AlState::Op)
        };
        let in_op = |device: &isocat_sim::device::Device| device.stack.state() == AlState::Op;
        let fell = |device: &isocat_sim::device::Device| device.esc.al_status().error();
        let wanted = devices.iter().filter(asked).count();
        let there = devices.iter().filter(asked).filter(|device| in_op(device)).count();
        let fallen = devices.iter().filter(asked).any(fell);
        let more = session
            .judged
            .as_ref()
            .is_none_or(|judged| !session.judging || judged.devices_in_op < there);
        if there > 0 && there == wanted && !fallen && more {
            let cycle = cycle_of(&self.served, &self.claims, &session.conduct);
            session.conduct.cycle.restart();
            let limits = (self.sync0_limit, self.outputs_spread);
            self.served.begin_judging(reference, cycle, limits);
            if let Some(intent) = self.served.bench().intent() {
                self.watch.in_operation(at, intent, &self.states);
            }
            let before = session.judged.replace(Judged::begin(&self.served, at));
            // SubDevices that join those in OP begin a new stretch.
            if let Some(before) = before.filter(|_| !session.judging) {
                session.remember(before);
            }
            session.judging = true;
            self.events.push_back(Event::InOperation { devices: there });
            self.served.timeline_mut().reached(Moment::InOperation, at);
            if self.onlooker.is_some() {
                self.onlooker = Some(self.new_onlooker());
            }
        }
    }

    /// Called before time moves to `to` without a frame. If a frame is overdue in operation, the
    /// judges' results are kept as they are: later events may be effects of the silence.
    fn hush(&mut self, to: Time<Host>) {
        let Some(session) = self.session.as_ref().filter(|s| s.judging && !s.silent) else {
            return;
        };
        let last = session.conduct.last;
        let cycle = Nanos((session.conduct.cycle.intervals.mean() / 1000.0) as i64);
        if to - self.last_frame > (cycle + Nanos(cycle.0 / 2)).max(LEAST_HUSH) {
            self.keep_judged();
            self.watch.is_silent(last);
        }
    }

    /// Keeps the judges' results as they are.
    fn keep_judged(&mut self) {
        let last = self.session.as_ref().map_or(self.served.now(), |s| s.conduct.last);
        let Some(session) = &mut self.session else { return };
        session.silent = true;
        if let Some(judged) = &mut session.judged {
            let case =
                Case { served: &self.served, conduct: &session.conduct, claims: &self.claims };
            *judged = judged.until(case, last);
        }
    }

    /// Keeps what the MainDevice had set up before it went down, if nothing came to operation.
    fn keep_attempt(&mut self, reference: usize) {
        let Some(session) = self.session.as_mut().filter(|session| session.judged.is_none()) else {
            return;
        };
        let evidence = evidence::of_attempt(&self.served, &session.conduct, reference);
        let breached = isocat_rules::judge(&self.claims, &evidence).breached;
        let devices = self.served.segment().devices();
        let activations = devices.iter().map(|one| one.esc.register(register::SYNC_ACTIVATION));
        let activations = activations.collect();
        session.attempt = Some(Attempt { states: self.states.clone(), activations, breached });
    }

    fn end_session(&mut self) {
        let abrupt = |session: &Session| matches!(session.requested, AlState::SafeOp | AlState::Op);
        if self.session.as_ref().is_some_and(abrupt) {
            self.keep_attempt(self.reference());
        }
        if let Some(session) = self.session.as_ref().filter(|s| s.judging && !s.silent) {
            self.watch.is_silent(session.conduct.last);
            self.keep_judged();
            self.show_cycle(self.served.now(), None);
        }
        let Some(mut session) = self.session.take() else { return };
        let abrupt = matches!(session.requested, AlState::SafeOp | AlState::Op);
        session.end = if abrupt { End::Abrupt } else { End::Down };
        self.events.push_back(Event::SessionEnded { abrupt });
        self.ended.push(session);
        self.forget_oldest(MOST_RECORDS);
    }

    /// Drops the oldest sessions until at most `most` records are kept, but never the last session.
    fn forget_oldest(&mut self, most: usize) {
        let mut records: usize = self.ended.iter().map(Session::records).sum();
        let mut forgotten = 0;
        while records > most && forgotten + 1 < self.ended.len() {
            records -= self.ended[forgotten].records();
            forgotten += 1;
        }
        self.ended.drain(..forgotten);
        self.left_out.sessions += forgotten as u64;
    }
}

impl Session {
    /// Number of its records: one for itself, and one for each SubDevice in each stretch of
    /// operation.
    fn records(&self) -> usize {
        let judged = self.earlier.iter().chain(&self.judged);
        1 + judged.map(|stretch| stretch.devices.len()).sum::<usize>()
    }

    /// Keeps a stretch of operation. If there are too many, one that was in sync is dropped, so
    /// that the others are still reported.
    fn remember(&mut self, stretch: Judged) {
        if self.earlier.len() >= MOST_STRETCHES {
            self.earlier_left_out += 1;
            let in_sync = self.earlier.iter().position(Judged::in_sync);
            match in_sync.filter(|_| !stretch.in_sync()) {
                Some(forgotten) => self.earlier.remove(forgotten),
                None => return,
            };
        }
        self.earlier.push(stretch);
    }

    fn new(at: Time<True>) -> Self {
        Self {
            conduct: Conduct::new(at),
            reached: [None; 3],
            refused: Vec::new(),
            judged: None,
            earlier: Vec::new(),
            earlier_left_out: 0,
            attempt: None,
            end: End::Open,
            judging: false,
            silent: false,
            requested: AlState::Init,
            paused: None,
            pending: false,
        }
    }

    /// Whether a frame that left at `at` begins another session: this one had exchanged process
    /// data, and after a pause a MainDevice starts from the beginning. Some MainDevices first send
    /// a frame or two without information, so the pause is remembered until the exchange continues.
    fn is_over(&mut self, at: Time<True>, bytes: &[u8]) -> bool {
        let pause = if self.requested == AlState::Init { PAUSE_DOWN } else { PAUSE };
        let exchanged = self.conduct.done(Deed::ProcessData).is_some();
        if exchanged && at - self.conduct.last >= Picos::from(pause) {
            self.paused.get_or_insert(self.requested);
        }
        let Some(requested) = self.paused else { return false };
        let Ok(payload) = frame::payload(bytes) else { return false };
        let mut begins = false;
        for datagram in datagrams(payload).map_while(Result::ok) {
            if datagram.header.command().is_ok_and(Command::is_logical) {
                self.paused = None;
                return false;
            }
            // A MainDevice that only waits for a state also reads all AL statuses.
            let polls = datagram.header.ado() == register::AL_STATUS.address;
            Deed::read(&datagram.header, datagram.data, |deed| {
                begins |= matches!(deed, Deed::RequestInit | Deed::StationAddresses)
                    || deed == Deed::Count && !polls;
            });
        }
        if begins {
            self.requested = requested;
        }
        begins
    }

    /// Whether its SubDevices are being judged, because they are in operation.
    pub fn is_judged(&self) -> bool {
        self.judging
    }
}

/// Whether a fault cannot happen here: the host's clock is true time, and other MainDevices do not
/// come from this program.
fn is_left_out(fault: &Fault, has_host: bool) -> bool {
    use Fault::{ClockJump, LateWakeUps, SlowSends, Stall};
    let by_caller = matches!(fault, ClockJump { .. } | Stall | LateWakeUps(_) | SlowSends(_));
    fault.is_of_the_host() && !(has_host && by_caller)
}

/// The cycle of the segment: that of the SYNC units, else the one that was meant, else that of the
/// frames so far.
fn cycle_of(served: &Served, claims: &Claims, conduct: &Conduct) -> Nanos {
    let cycles = served.segment().devices().iter().filter(|device| device.esc.sync_active());
    let cycle = cycles.map(|device| device.esc.register(register::SYNC0_CYCLE)).max().unwrap_or(0);
    match cycle {
        0 => {
            claims.cycle.unwrap_or_else(|| Nanos((conduct.cycle.intervals.mean() / 1000.0) as i64))
        }
        cycle => Nanos::from_u32(cycle),
    }
}

/// The cycle of frames: the one that was meant, else that of the fastest SYNC unit, else that of
/// the frames so far.
fn bus_cycle(served: &Served, claims: &Claims, conduct: &Conduct) -> Nanos {
    let sync0 = || {
        let active = served.segment().devices().iter().filter(|device| device.esc.sync_active());
        let cycles = active.map(|device| device.esc.register(register::SYNC0_CYCLE));
        cycles.filter(|cycle| *cycle > 0).min().map(Nanos::from_u32)
    };
    claims.cycle.or_else(sync0).unwrap_or_else(|| cycle_of(served, claims, conduct))
}

#[cfg(test)]
mod tests;

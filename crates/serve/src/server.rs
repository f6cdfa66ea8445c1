//! The served segment without sockets and threads: frames and host time in, answers and events out.

use std::collections::VecDeque;

use isocat_engine::status::edges::Onlooker;
use isocat_engine::status::{Event as Told, Status};
use isocat_segment::fault::Order;
use isocat_segment::scenario;
use isocat_sim::expect::Judgement;
use isocat_sim::fault::{Happened, Moment, RING_CABLE};
use isocat_sim::observation::Observed;
use isocat_sim::{Connection, Fault, MainPort, Passage, Served, ServedCycle, Tap, Timeline};
use isocat_wire::datagram::datagrams;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, Command, frame, register};

use super::conduct::{Conduct, Reference, Seen};
use super::deed::Deed;
use super::expect::Watch;
use super::process_data::Handle;
use super::setup::Setup;
use super::verdict::Judged;
use crate::status::{self, INTERVAL, INTERVALS, MOST_EVENTS};
use crate::taps;

/// A virtual segment for frames from outside.
///
/// - For every frame: [`frame`](Self::frame) gives its [`Answer`] ([`frame_at`](Self::frame_at)
///   with two ports); when that is on its way, [`after`](Self::after).
/// - Ports of a ring: [`has_two_ports`](Self::has_two_ports), [`link`](Self::link).
/// - While nothing comes: [`idle`](Self::idle), at [`next_timeout`](Self::next_timeout) at the
///   latest.
/// - Process data: [`outputs`](Self::outputs), [`set_inputs`](Self::set_inputs).
/// - What happened: [`poll_event`](Self::poll_event); all of it at the end:
///   [`sessions`](Self::sessions) after [`finish`](Self::finish).
pub struct Server {
    served: Served,
    /// The process data of each SubDevice.
    doors: Vec<Handle>,
    names: Vec<String>,
    sync0_limit: Picos,
    outputs_spread: Picos,
    events: VecDeque<Event>,
    ended: Vec<Session>,
    /// How many sessions and faults are remembered no more.
    left_out: LeftOut,
    session: Option<Session>,
    /// The frame that passed last.
    passage: Option<Passage>,
    source: [u8; 6],
    /// Host time of the last frame, and of the last look at the clock.
    last_frame: Time<Host>,
    /// The SubDevice whose time was distributed last.
    reference: Option<(Reference, usize)>,
    counts: Counts,
    ring: bool,
    /// The caller lets faults of the MainDevice's machine happen.
    has_host: bool,
    /// Since when frames come from the secondary port alone.
    secondary_alone: Option<Time<True>>,
    /// State of each SubDevice as of the last observation.
    states: Vec<AlState>,
    /// The last events, for who asks what happened.
    told: VecDeque<Told>,
    /// Sees what is of late, once somebody has asked.
    onlooker: Option<Box<Onlooker>>,
    /// Follows it all for what is expected.
    watch: Watch,
    /// Keeps what happens.
    tap: Option<Box<dyn Tap + Send>>,
    /// Judged cycles, of all sessions.
    cycles: u64,
}

/// What is to become of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// It goes back.
    Back {
        /// At which port of the MainDevice: in a whole ring not at the one that it left.
        port: MainPort,
        /// When its last bit is back at the MainDevice's port, if the wire is all that takes time;
        /// a delay that was asked for is in it. Never earlier than true time: rounded up to the ns.
        last_bit: Time<Host>,
        /// For a door in real time, whose own answer takes longer than the wire: the answer is held
        /// back until then. `None`: it is to leave at once.
        hold: Option<Time<Host>>,
    },
    /// It does not go back.
    Lost,
}

/// Frames of all sessions.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Frames that came in.
    pub frames: u64,
    /// Frames that came back.
    pub answered: u64,
    /// Frames that were lost in the segment or by a fault that was asked for.
    pub lost: u64,
    /// Frames that had to wait since they came faster than a wire carries them.
    pub held: u64,
}

/// What happened so long ago that it is only counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct LeftOut {
    /// Sessions.
    pub sessions: u64,
    /// Faults that were asked for.
    pub faults: u64,
}

/// From the first frame of a MainDevice to its last.
#[derive(Clone, Debug)]
pub struct Session {
    /// What the MainDevice did.
    pub conduct: Conduct,
    /// First and last SubDevice that reached each of PREOP, SAFEOP, OP.
    pub reached: [Option<Reached>; 3],
    /// States that were refused, in order; not more than a few.
    pub refused: Vec<Refused>,
    /// The last stretch of operation; `None` if no SubDevice ever was in OP.
    pub judged: Option<Judged>,
    /// Stretches before it, each ended by a SubDevice that was asked to leave OP, as one that fell
    /// is.
    pub earlier: Vec<Judged>,
    /// More of them, which are only counted.
    pub earlier_left_out: u64,
    /// How it ended.
    pub end: End,
    /// The judging goes on.
    judging: bool,
    /// Frames have stopped; the judges' view is as of then.
    silent: bool,
    /// The state that was last asked for.
    requested: AlState,
    /// The state that was asked for before the last pause in the exchange, until the exchange goes
    /// on.
    paused: Option<AlState>,
    pending: bool,
}

/// SubDevices that reached a state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reached {
    /// The first one.
    pub first: Time<True>,
    /// The last one so far.
    pub last: Time<True>,
    /// How many went there, each counted as often as it did.
    pub count: u64,
}

/// A SubDevice that fell or refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Refused {
    /// When.
    pub at: Time<True>,
    /// Position.
    pub device: usize,
    /// Where it is now.
    pub state: AlState,
    /// Why.
    pub code: AlStatusCode,
}

/// How a session ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// It goes on.
    Open,
    /// Frames stopped when no SubDevice was above PREOP.
    Down,
    /// Frames stopped in the middle.
    Abrupt,
}

/// Something that happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Event {
    /// A MainDevice begins to send.
    SessionBegan {
        /// Its source address.
        source: [u8; 6],
    },
    /// A SubDevice changed its state.
    State {
        /// When, true time.
        at: Time<True>,
        /// Position.
        device: usize,
        /// The new state.
        state: AlState,
        /// Why, if it was not asked to.
        code: AlStatusCode,
    },
    /// All SubDevices that were asked to be in OP are: the judges begin.
    InOperation {
        /// How many.
        devices: usize,
    },
    /// A fault began or ended.
    Fault(Happened),
    /// Nothing has been sent for a while.
    SessionEnded {
        /// In the middle.
        abrupt: bool,
    },
}

/// Silence that ends a session. Longer than any MainDevice waits for a mailbox or a state.
pub const SILENCE: Nanos = Nanos::millis(15_000);
/// Silence in operation that is always let pass, whatever the cycle.
const LEAST_HUSH: Nanos = Nanos::micros(200);
/// How far frames may be ahead of the wire before they are held back to its speed.
const LEAD: Nanos = Nanos::millis(1);
/// While something may happen by itself, the segment is looked at this often.
pub const TICK: Nanos = Nanos::millis(100);
/// Silence between the last frame of one session that went back to INIT and the first of another,
/// at least.
const PAUSE_DOWN: Nanos = Nanos::millis(50);
/// The same after a session that did not.
const PAUSE: Nanos = Nanos::millis(250);
/// Who sent a frame this long ago is still there.
const STILL_THERE: Nanos = Nanos::millis(1_000);
/// Frames from the secondary port are copies, or what else a MainDevice does for its ring, unless
/// the primary port has been silent for this long.
const ALONE: Picos = Picos(100_000_000_000);
/// Refusals that are remembered.
const MOST_REFUSED: usize = 32;
/// Stretches of operation that are remembered.
const MOST_STRETCHES: usize = 256;
/// What is remembered of ended sessions: some 40 MB.
const MOST_RECORDS: usize = 50_000;

impl Server {
    /// A segment, of a [`Scenario`](isocat_segment::Scenario) or by hand, switched on at `now`.
    pub fn new(setup: impl Into<Setup>, now: Time<Host>) -> Self {
        let setup: Setup = setup.into();
        let Setup { sync0_limit, outputs_spread, shows_process_data, has_host, .. } = setup;
        let Setup { mut segment, ring, names, seed, faults, spares, expectations, .. } = setup;
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

    /// A frame that came in at `arrived`. If it goes back, `bytes` hold the answer.
    pub fn frame(&mut self, arrived: Time<Host>, bytes: &mut [u8]) -> Answer {
        self.frame_at(MainPort::Primary, arrived, bytes)
    }

    /// The same of a frame that came in from one of the ports of a MainDevice with two.
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
        // A real wire has no more than 100 Mbit/s either.
        let held = self.served.host_time(passage.start) - arrived > LEAD;
        // True time has picoseconds: to the next nanosecond.
        let last_bit = self.served.host_time(back.last_bit + Picos(999));
        self.counts.held += u64::from(held);
        let hold = match (held, passage.late) {
            (false, Nanos::ZERO) => None,
            (false, late) => Some(arrived + late),
            (true, _) => Some(last_bit),
        };
        Answer::Back { port: back.port, last_bit, hold }
    }

    /// Shows frames, and what happens at SubDevices, to somebody who keeps it: a capture,
    /// waveforms, a trace. What a tap is told of a MainDevice of ours it is not told here.
    pub fn with_tap(mut self, tap: Box<dyn Tap + Send>) -> Self {
        self.served.show_everything();
        self.tap = Some(tap);
        self
    }

    /// Whether the segment is a ring, between two ports of the MainDevice.
    pub fn has_two_ports(&self) -> bool {
        self.ring
    }

    /// The link at a port of the MainDevice went away as of `now`, or came: of a ring the device
    /// there notices, as with a cable that is pulled, so that frames from the other port turn at
    /// it.
    pub fn link(&mut self, now: Time<Host>, port: MainPort, up: bool) {
        self.served.advance(now);
        self.settle();
        self.served.link(port, up);
    }

    /// What follows from the frame that [`frame`](Self::frame) took last, once its answer is on its
    /// way.
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
        // Nobody gives addresses anew in the middle: another MainDevice begins, without any pause.
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

    /// Tells the tap that a judged cycle is over, or the judged time.
    fn show_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>) {
        if let Some(tap) = &mut self.tap {
            tap.served_cycle(at, cycle, self.served.segment());
        }
    }

    /// Whether a frame says what the MainDevice does: one of the primary port. A MainDevice with a
    /// ring sends its copies, or frames that only try the way, at the secondary port; it would seem
    /// to do all things twice. Where the primary port is silent, the secondary one says it.
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

    /// Time has passed and no frame came.
    pub fn idle(&mut self, now: Time<Host>) {
        self.hush(now);
        if self.session.is_some() && now - self.last_frame > SILENCE {
            self.end_session();
        }
        self.served.advance(now);
        self.settle();
    }

    /// As [`idle`](Self::idle) while frames come often: only as far as no frame can come any more.
    pub fn catch_up(&mut self, to: Time<Host>) {
        self.hush(to);
        self.served.advance(to);
        self.settle();
    }

    /// Judges the session under way as of `now`, for a look in the middle: it goes on.
    pub fn take_stock(&mut self, now: Time<Host>) {
        self.idle(now);
        let judged = self.judged();
        if let Some(session) = &mut self.session {
            session.judged = judged;
        }
    }

    /// When [`idle`](Self::idle) is wanted next, if nothing comes.
    pub fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>> {
        // A segment that nobody talks to, and nothing in it above INIT, has nothing to do.
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

    /// Injects a fault as of `now`; tells what is wrong with it.
    pub fn inject(&mut self, now: Time<Host>, order: Order) -> Result<(), String> {
        self.served.advance(now);
        self.settle();
        self.inject_at(now, order)?;
        self.tell_faults();
        Ok(())
    }

    /// Plans a fault for the instant `at`, or for now where that is over; tells what is wrong with
    /// it.
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

    /// Takes an answer beside that of the last frame, of one that was doubled on its way: at which
    /// port, and when its last bit is back.
    pub fn take_copy(&mut self) -> Option<(MainPort, Time<Host>, Vec<u8>)> {
        let (port, last_bit, bytes) = self.served.take_copy()?;
        if let Some(tap) = &mut self.tap {
            let on_wire = Picos::from(Nanos(frame::duration_ns(bytes.len()) as i64));
            taps::show_frame(tap.as_mut(), port, last_bit + Picos(-on_wire.0), false, &bytes);
        }
        Some((port, self.served.host_time(last_bit + Picos(999)), bytes))
    }

    /// Tells which faults have begun or ended.
    fn tell_faults(&mut self) {
        let news = self.served.take_news();
        self.events.extend(news.into_iter().map(Event::Fault));
    }

    /// The outputs of the device at `position`, as it took them last; `None` while they are in
    /// their safe state, and where there is no such device or the [`Setup`] does without process
    /// data.
    pub fn outputs(&self, position: usize) -> Option<Vec<u8>> {
        self.doors.get(position)?.outputs()
    }

    /// Sets the inputs of the device at `position` from the next time on that it maps them; `None`
    /// gives them back to its application. Bytes beyond its process image are left out; bytes that
    /// are not set stay its application's. Nothing happens where there is no such device or the
    /// [`Setup`] does without process data.
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

    /// What is known now, for who watches. From the first time on, what is of late is followed,
    /// too.
    pub fn status(&mut self, segment: &str) -> Status {
        self.settle();
        let onlooker = self.onlooker.take().unwrap_or_else(|| self.new_onlooker());
        let status = status::status(self, segment, &onlooker);
        self.onlooker = Some(onlooker);
        status
    }

    /// Ends the last session, as of its last frame. One that still goes on at `now` is left open:
    /// not the MainDevice ended it.
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
    /// The faults that began and ended, and when: the newest ones, where there were very many.
    pub fn faults(&self) -> impl ExactSizeIterator<Item = &Happened> {
        self.served.timeline().happened()
    }

    /// The sessions that have ended, in order: the newest ones, where there were very many.
    pub fn sessions(&self) -> &[Session] {
        &self.ended
    }
    /// How many came before these sessions and faults.
    pub fn left_out(&self) -> LeftOut {
        LeftOut { faults: self.served.timeline().left_out(), ..self.left_out }
    }
    /// The session under way.
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
    /// The SubDevice whose time is distributed; the first with a clock if nobody's is.
    pub fn reference(&self) -> usize {
        let clock = |device: &isocat_sim::device::Device| {
            device.esc.register(register::FEATURES) & register::features::DC != 0
        };
        let first = || self.served.segment().devices().iter().position(clock).unwrap_or(0);
        self.reference.map_or_else(first, |(_, position)| position)
    }
    /// What became of the expectations of the [`Setup`]: call [`finish`](Self::finish) before.
    pub fn judgements(&self) -> Vec<Judgement> {
        let sessions = self.ended.iter().chain(&self.session);
        self.watch.judgements(self.served.now(), sessions, self.served.timeline(), self.left_out())
    }
    /// When SubDevices came into operation for the first time, if anything is expected; what
    /// [`judgements`](Self::judgements) tells of instants counts from then.
    pub fn first_in_operation(&self) -> Option<Time<True>> {
        self.watch.began()
    }
    /// What the judges say now of the exchange that is under way.
    pub fn judged(&self) -> Option<Judged> {
        let session = self.session.as_ref()?;
        let judged = session.judged.as_ref()?;
        Some(if session.judging && !session.silent {
            judged.until(&self.served, self.served.now())
        } else {
            judged.clone()
        })
    }

    /// Of a judging that goes on, or waits.
    fn new_onlooker(&self) -> Box<Onlooker> {
        let mut onlooker = Onlooker::new(self.states.len(), INTERVALS);
        if let Some(intent) = self.served.bench().intent() {
            onlooker.begin(self.served.now(), intent);
        }
        Box::new(onlooker)
    }

    /// Shows what happened to the judges, and takes note.
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
            // Only who arrives can complete the segment, not who leaves.
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

    /// Begins and ends the judging as the MainDevice asks for states.
    fn follow(&mut self, seen: Seen, at: Time<True>) {
        let reference = self.reference();
        let Some(session) = &mut self.session else { return };
        if let Some(state) = seen.request {
            let before = std::mem::replace(&mut session.requested, state);
            self.watch.asked(at, (before, state), &self.states);
        }
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
            let cycle = cycle_of(&self.served, &session.conduct);
            session.conduct.cycle.reached(self.served.system_time_ps(reference, at), cycle);
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
            let cycle = cycle_of(&self.served, &session.conduct);
            session.conduct.cycle.restart();
            let limits = (self.sync0_limit, self.outputs_spread);
            self.served.begin_judging(reference, cycle, limits);
            if let Some(intent) = self.served.bench().intent() {
                self.watch.in_operation(at, intent, &self.states);
            }
            let before = session.judged.replace(Judged::begin(&self.served, at));
            // SubDevices that join those in OP make the stretch anew.
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

    /// Before time goes on to `to` without a frame: if one is overdue in operation, the judges'
    /// view is kept, for what comes from here on may be the silence's doing.
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

    /// Keeps the judges' view as it is.
    fn keep_judged(&mut self) {
        let last = self.session.as_ref().map_or(self.served.now(), |s| s.conduct.last);
        let Some(session) = &mut self.session else { return };
        session.silent = true;
        if let Some(judged) = &mut session.judged {
            *judged = judged.until(&self.served, last);
        }
    }

    fn end_session(&mut self) {
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

    /// Forgets the oldest sessions until no more is remembered than `most` records, but never the
    /// last one.
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
    /// What is remembered of it: itself, and each SubDevice in each stretch of operation.
    fn records(&self) -> usize {
        let judged = self.earlier.iter().chain(&self.judged);
        1 + judged.map(|stretch| stretch.devices.len()).sum::<usize>()
    }

    /// Remembers a stretch of operation. Of too many, one that was in sync is forgotten, so that
    /// those that were not are still told.
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
            end: End::Open,
            judging: false,
            silent: false,
            requested: AlState::Init,
            paused: None,
            pending: false,
        }
    }

    /// Whether a frame that left at `at` begins another session: this one had come to the exchange
    /// of process data, and after a pause somebody begins at the beginning. Some MainDevices first
    /// send a frame or two that say nothing, so the pause is remembered until the exchange goes on.
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
            // Who asks all for their AL status may as well wait for a state.
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

    /// Whether its SubDevices are being judged: they are in operation.
    pub fn is_judged(&self) -> bool {
        self.judging
    }
}

/// Whether a fault can't happen here: the host's clock is true time, and other MainDevices do not
/// come from here.
fn is_left_out(fault: &Fault, has_host: bool) -> bool {
    use Fault::{ClockJump, LateWakeUps, SlowSends, Stall};
    let by_caller = matches!(fault, ClockJump { .. } | Stall | LateWakeUps(_) | SlowSends(_));
    fault.is_of_the_host() && !(has_host && by_caller)
}

/// The cycle of the segment: that of the SYNC units, else that of the frames so far.
fn cycle_of(served: &Served, conduct: &Conduct) -> Nanos {
    let cycles = served.segment().devices().iter().filter(|device| device.esc.sync_active());
    let cycle = cycles.map(|device| device.esc.register(register::SYNC0_CYCLE)).max().unwrap_or(0);
    match cycle {
        0 => Nanos((conduct.cycle.intervals.mean() / 1000.0) as i64),
        cycle => Nanos::from_u32(cycle),
    }
}

#[cfg(test)]
mod tests;

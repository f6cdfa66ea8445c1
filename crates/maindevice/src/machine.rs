//! The machine: its inputs and outputs, and which frame may be sent next.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec::Vec;

use isocat_sync::phase;
use isocat_wire::frame;
use isocat_wire::time::{Dc, Host, Time};

use crate::bring_up::Work;
use crate::config::Config;
use crate::cycle::CyclicExchange;
use crate::delay_watch::DelayWatch;
use crate::error::Error;
use crate::event::{Event, Stage};
use crate::link::{CYCLIC_INDEX, Link, Origin, Shared};
use crate::mailbox::Mailboxes;
use crate::quality::{Monitor, Reads};
use crate::readmit::Keeper;
use crate::ring::Port;
use crate::segment::Segment;
use crate::statistics::Statistics;
use crate::times;

mod background;
mod delays;
mod looks;
mod procedures;
mod requests;
mod returns;
mod ring_port;
mod share;
mod watching;
mod way;

use procedures::Procedures;
use requests::Job;
use ring_port::Ring;
use share::Share;
use way::{Activity, Piece};

/// A MainDevice without sockets, threads or a clock of its own.
///
/// - Input: [`handle_frame`] for every frame that came in, [`handle_timeout`] when the instant of
///   [`next_timeout`] is reached.
/// - Output, to be drained after each input: [`poll_cycle`], which calls the application if a cycle
///   is complete; [`poll_event`] until it returns `None`; [`poll_transmit`] until it returns
///   `None`, which [`has_frame`] foresees; then [`next_timeout`] again. A
///   [`Runner`](crate::Runner) keeps this order.
/// - A ring ([`Config::ring`]): [`poll_secondary`] returns the frames of its second port, to be
///   drained after each frame of [`poll_transmit`], and [`handle_frame_at`] takes frames received
///   at either port.
/// - Process data: [`outputs_mut`] and [`inputs`], as the [`Application`](crate::Application) has
///   them in each cycle.
/// - Requests while it runs: [`upload`], [`download`], [`read_memory`], [`stop`].
/// - State: [`segment`], [`statistics`] or [`counts`], [`stage`], [`next_cycle`],
///   [`frames_in_flight`].
///
/// Time is the caller's monotonic clock, read as late as possible: the `now` of [`poll_transmit`]
/// is the time stamp of the frame that it returns, and the clock servo follows these stamps. Time
/// never goes backwards from call to call.
///
/// The machine starts to work at once. It reports [`Event::InOperation`] or [`Event::Failed`] in
/// the end; with [`Config::survey`], [`Event::Surveyed`] takes the place of the first.
///
/// It may be built in one thread and run in another: it is `Send`.
///
/// [`handle_frame`]: Self::handle_frame
/// [`handle_frame_at`]: Self::handle_frame_at
/// [`poll_secondary`]: Self::poll_secondary
/// [`handle_timeout`]: Self::handle_timeout
/// [`next_timeout`]: Self::next_timeout
/// [`poll_transmit`]: Self::poll_transmit
/// [`poll_event`]: Self::poll_event
/// [`poll_cycle`]: Self::poll_cycle
/// [`outputs_mut`]: Self::outputs_mut
/// [`inputs`]: Self::inputs
/// [`upload`]: Self::upload
/// [`download`]: Self::download
/// [`read_memory`]: Self::read_memory
/// [`next_cycle`]: Self::next_cycle
/// [`frames_in_flight`]: Self::frames_in_flight
/// [`stop`]: Self::stop
/// [`segment`]: Self::segment
/// [`statistics`]: Self::statistics
/// [`counts`]: Self::counts
/// [`has_frame`]: Self::has_frame
/// [`stage`]: Self::stage
pub struct MainDevice {
    config: Arc<Config>,
    link: Link,
    /// The data that procedures share with the machine; `None` while they run.
    shared: Option<Box<Shared>>,
    begin: Time<Host>,
    segment: Segment,
    mailboxes: Mailboxes,
    activity: Activity,
    stage: Stage,
    cycle: Option<CyclicExchange>,
    /// Wire time left for acyclic frames in this cycle, and the end of the last acyclic frame.
    share: Share,
    /// The procedures in addition to the cycle.
    procedures: Procedures,
    /// Object accesses that wait for their mailboxes.
    jobs: VecDeque<Job>,
    next_request: u32,
    /// The cyclic broadcast's reading at the last check of health, and the time of that check.
    checked: Option<((u16, u16), Time<Host>)>,
    /// SubDevices that are lost or out of OP, and the attempts to bring them back.
    keeper: Keeper,
    /// Number of SubDevices that answered when they last disagreed with the tree.
    unplanned: Option<u16>,
    /// The delay measurement in operation.
    delay_watch: Option<DelayWatch>,
    quality: Option<Monitor>,
    /// Reads of clocks that are under way.
    reads: Reads,
    ring: Option<Box<Ring>>,
    /// Why the bring-up failed. It is reported once SubDevices are back in INIT and the ring is
    /// restored.
    failure: Option<Error>,
    stopping: bool,
}

impl MainDevice {
    /// A machine that begins at `now`.
    pub fn new(config: Config, now: Time<Host>) -> Self {
        let timeouts = &config.timeouts;
        let link = Link::new(now, config.source, timeouts.frame, timeouts.retries);
        let ring = Ring::new(&config, &link, now);
        let config = Arc::new(config);
        let work = Work {
            link: link.clone(),
            config: config.clone(),
            segment: Segment::default(),
            mailboxes: Vec::new(),
            stage: Stage::Scan,
        };
        let first = match work.config.survey {
            None => Piece::Prepare,
            Some(_) => Piece::Survey,
        };
        let mut machine = Self {
            config,
            shared: Some(link.take()),
            link,
            begin: now,
            segment: Segment::default(),
            mailboxes: Vec::new(),
            activity: Activity::of(first, work),
            stage: Stage::Scan,
            cycle: None,
            share: Share::default(),
            procedures: Procedures::default(),
            jobs: VecDeque::new(),
            next_request: 0,
            checked: None,
            keeper: Keeper::default(),
            unplanned: None,
            delay_watch: None,
            quality: None,
            reads: Reads::default(),
            ring,
            failure: None,
            stopping: false,
        };
        machine.work();
        machine
    }

    /// Takes a received frame, without its FCS. Frames that are not ours, or that no procedure
    /// waits for, are counted and ignored; see [`Statistics`].
    pub fn handle_frame(&mut self, now: Time<Host>, frame: &[u8]) {
        if self.ring.is_some() {
            return self.handle_frame_at(Port::Primary, now, frame);
        }
        let (shared, source) = (in_hand(&mut self.shared), self.config.source);
        let taken = take_inline(shared, &mut self.cycle, source, now, frame);
        self.close_cycle(now);
        if taken {
            self.work();
        }
    }

    /// Passes the time to the machine, at [`MainDevice::next_timeout`] or at any other time.
    #[inline]
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        if self.ring.is_some() {
            // Kept copies are handled before their frame is given up.
            self.expire_copies(now);
        }
        let shared = in_hand(&mut self.shared);
        shared.handle_timeout(now);
        self.close_cycle(now);
        self.work();
    }

    /// The cycle that the last input completed, once, and whether process data ran in it.
    #[inline]
    pub(crate) fn take_closed(&mut self) -> Option<(u64, bool)> {
        let (number, has_data) = self.cycle.as_mut()?.take_closed()?;
        Some((number, has_data && !self.rehearses()))
    }

    /// Whether this bring-up only serves to let devices measure their times. The application is not
    /// called in it.
    #[inline]
    fn rehearses(&self) -> bool {
        match self.activity {
            Activity::Operating => false,
            _ if self.config.measure_times.is_none() => false,
            Activity::Task(Piece::MeasureTimes | Piece::PlanAnew, _) => true,
            _ => times::is_wanted(&self.segment, &self.config),
        }
    }

    /// Writes the next frame to send at once into `buffer` and returns its length; `None` if there
    /// is nothing to send now. `now` is the frame's time stamp. A buffer of [`crate::FRAME_LEN`]
    /// bytes is always long enough.
    #[inline]
    pub fn poll_transmit(&mut self, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        if matches!(self.activity, Activity::Over) || buffer.len() < frame::MIN_LEN {
            return None;
        }
        let shared = in_hand(&mut self.shared);
        shared.port.now = now;
        let is_cyclic = self.cycle.as_ref().is_some_and(|cycle| cycle.has_frame(now));
        // Each cycle asks once more than it has frames.
        if !is_cyclic && shared.port.first_len().is_none() {
            return None;
        }
        self.next_frame(is_cyclic, now, buffer)
    }

    /// Whether [`Self::poll_transmit`] may have a frame at `now`. If not, a loop need not read its
    /// clock for the frame's time stamp.
    #[inline]
    pub fn has_frame(&self, now: Time<Host>) -> bool {
        let is_cyclic = || self.cycle.as_ref().is_some_and(|cycle| cycle.has_frame(now));
        !matches!(self.activity, Activity::Over)
            && (is_cyclic() || self.shared().port.first_len().is_some())
    }

    fn next_frame(&mut self, is_cyclic: bool, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        let Self { shared, cycle, .. } = self;
        let shared = in_hand(shared);
        let len = match cycle {
            None => shared.transmit(now, buffer, frame::MAX_LEN)?,
            Some(cycle) if is_cyclic => match cycle.transmit_due(now, buffer, &mut shared.board) {
                Some(len) => len,
                None => self.next_acyclic_frame(now, buffer)?,
            },
            Some(_) => self.next_acyclic_frame(now, buffer)?,
        };
        if self.ring.is_some() {
            self.copy(now, &buffer[..len]);
        }
        Some(len)
    }

    /// A frame of procedures, in the time that the frames of the cycle leave.
    fn next_acyclic_frame(&mut self, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        let operates = matches!(self.activity, Activity::Operating);
        let Self { shared, cycle: Some(cycle), share, config, .. } = self else { return None };
        let shared = in_hand(shared);
        if shared.port.waits_for_quiet(now, cycle.in_flight()) {
            return None;
        }
        let most = share.room(cycle, config, operates, now, shared.port.first_len()?)?;
        let len = shared.transmit(now, buffer, most)?;
        share.take(now.max(cycle.through()), len);
        Some(len)
    }

    /// When to call [`MainDevice::handle_timeout`] next; `None` if the run is over. In cyclic
    /// exchange this is the exact instant at which the next frame must leave.
    #[inline]
    pub fn next_timeout(&self) -> Option<Time<Host>> {
        if matches!(self.activity, Activity::Over) {
            return None;
        }
        let mut next = self.shared().port.next_timeout();
        if let Some(cycle) = &self.cycle {
            next = next.min(cycle.due());
        }
        if let Some(ring) = &self.ring {
            next = next.min(ring.next_timeout());
        }
        if let Activity::Locking { since } = self.activity {
            let patience = self.config.timeouts.phase;
            let patience = self.cycle.as_ref().map_or(patience, |c| c.lock_patience(patience));
            next = next.min(since + patience);
        }
        (next != Time::NEVER).then_some(next)
    }

    /// When the next frames of process data are due; `None` outside the cyclic exchange.
    #[inline]
    pub fn next_cycle(&self) -> Option<Time<Host>> {
        self.cycle.as_ref().map(CyclicExchange::due)
    }

    /// The planned system time at which the first of these frames finds the reference clock. It
    /// advances by whole cycles even if the host is late; without a reference clock it follows the
    /// host's clock. `None` outside the cyclic exchange.
    pub fn next_grid(&self) -> Option<Time<Dc>> {
        self.cycle.as_ref().map(CyclicExchange::grid)
    }

    /// Number of frames that were sent and are neither back nor given up.
    #[inline]
    pub fn frames_in_flight(&self) -> usize {
        let cyclic = self.cycle.as_ref().map_or(0, CyclicExchange::in_flight);
        cyclic + self.shared().port.in_flight()
    }

    /// Takes the next event.
    #[inline]
    pub fn poll_event(&mut self) -> Option<Event> {
        in_hand(&mut self.shared).board.poll_event()
    }

    /// Whether there is an event.
    #[inline]
    pub fn has_event(&self) -> bool {
        self.shared().board.has_event()
    }

    /// The outputs of the SubDevice at `position`, sent with the next cycle; empty without outputs.
    pub fn outputs_mut(&mut self, position: usize) -> &mut [u8] {
        let range = self.segment.devices.get(position).map(|device| device.outputs.range());
        match (&mut self.cycle, range) {
            (Some(cycle), Some(range)) => cycle.outputs_mut().get_mut(range).unwrap_or_default(),
            _ => &mut [],
        }
    }

    /// The inputs of the SubDevice at `position`, as they last came back complete; empty without
    /// inputs.
    pub fn inputs(&self, position: usize) -> &[u8] {
        let range = self.segment.devices.get(position).map(|device| device.inputs.range());
        match (&self.cycle, range) {
            (Some(cycle), Some(range)) => cycle.inputs().get(range).unwrap_or_default(),
            _ => &[],
        }
    }

    /// Ends the run: OP → SAFEOP → PREOP, SYNC off, INIT; then [`Event::Stopped`]. During bring-up
    /// it ends the bring-up.
    pub fn stop(&mut self) {
        if !matches!(self.activity, Activity::Over) {
            self.stopping = true;
            self.work();
        }
    }

    /// The segment as of the last completed piece of the bring-up; AL states are up to date.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// Counts so far.
    pub fn statistics(&self) -> Statistics {
        *self.counts()
    }

    /// The same in place: they are many, and a loop looks at one or two in each cycle.
    #[inline]
    pub fn counts(&self) -> &Statistics {
        &self.shared().board.statistics
    }

    /// The last stage of bring-up or shutdown that was begun.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Whether all SubDevices went to OP and no stop was requested.
    #[inline]
    pub fn is_operating(&self) -> bool {
        matches!(self.activity, Activity::Operating)
    }

    /// The state of the clock servo; `None` before the cyclic exchange.
    pub fn phase(&self) -> Option<phase::State> {
        self.cycle.as_ref().map(|cycle| cycle.servo().state())
    }

    /// How much faster system time runs than the host's clock, parts per billion; `None` before the
    /// cyclic exchange.
    pub fn rate_ppb(&self) -> Option<i64> {
        self.cycle.as_ref().map(|cycle| cycle.servo().rate_ppb())
    }

    /// How well the servo knows phase and rate; `None` before the cyclic exchange, and with too few
    /// samples.
    pub fn phase_uncertainty(&self) -> Option<phase::Uncertainty> {
        self.cycle.as_ref().and_then(|cycle| cycle.servo().uncertainty())
    }

    /// Takes stamps of an external time, which the reference clock follows if [`Config::direction`]
    /// says so.
    pub fn external_stamps(&mut self, stamps: phase::external::Stamps) {
        if let Some(cycle) = &mut self.cycle {
            cycle.external_stamps(stamps);
        }
    }

    /// The control of the reference clock: its state, and the corrections that it writes. `None` if
    /// the reference clock is not controlled, and before the cyclic exchange.
    pub fn drive(&self) -> Option<&phase::Drive> {
        self.cycle.as_ref().and_then(|cycle| cycle.drive())
    }

    /// The system time at which a frame sent at `host` finds the reference clock, by the servo;
    /// `None` before the cyclic exchange.
    pub fn system_time(&self, host: Time<Host>) -> Option<Time<Dc>> {
        self.cycle.as_ref().map(|cycle| cycle.servo().dc_at(host))
    }

    /// The data that the application of a cycle works on.
    pub(crate) fn parts_mut(&mut self) -> (&Segment, Option<&mut CyclicExchange>) {
        (&self.segment, self.cycle.as_mut())
    }

    /// The cyclic exchange.
    pub(crate) fn exchange(&self) -> Option<&CyclicExchange> {
        self.cycle.as_ref()
    }

    /// The data that procedures share with the machine; no procedure may run.
    #[inline]
    fn shared(&self) -> &Shared {
        self.shared.as_deref().expect(IN_HAND)
    }

    /// Closes the cycle if an input completed it.
    #[inline]
    fn close_cycle(&mut self, now: Time<Host>) {
        if let Some(cycle) = &mut self.cycle {
            cycle.close(now);
        }
    }
}

/// A MainDevice may be built in one thread and run in another.
const _: () = {
    const fn is_send<T: Send>() {}
    is_send::<MainDevice>();
};

/// Passes a received frame to the cycle or to the procedures that wait for it; returns whether one
/// of them took it.
fn take(
    shared: &mut Shared,
    cycle: &mut Option<CyclicExchange>,
    config: &Config,
    now: Time<Host>,
    frame: &[u8],
) -> bool {
    take_inline(shared, cycle, config.source, now, frame)
}

/// The same where it is to cost no call.
#[inline(always)]
fn take_inline(
    shared: &mut Shared,
    cycle: &mut Option<CyclicExchange>,
    source: [u8; 6],
    now: Time<Host>,
    frame: &[u8],
) -> bool {
    shared.port.now = now;
    let payload = match Origin::of(frame, source) {
        Origin::Ours { payload } => payload,
        Origin::Unmarked { payload }
            if shared.port.is_answer(&frame[payload..], &shared.board.statistics) =>
        {
            payload
        }
        origin => {
            origin.count(&mut shared.board.statistics);
            return false;
        }
    };
    let taken =
        cycle.as_mut().is_some_and(|cycle| cycle.receive(now, frame, payload, &mut shared.board))
            || frame::payload(frame).is_ok_and(|payload| shared.receive(payload));
    if !taken {
        count_unexpected(shared, cycle, frame.get(payload + 1).copied());
    }
    taken
}

/// Counts a frame of ours that is not expected: one that was given up and counted as lost is late
/// from now on.
#[cold]
fn count_unexpected(shared: &mut Shared, cycle: &mut Option<CyclicExchange>, index: Option<u8>) {
    let was_given_up = index.is_some_and(|index| match cycle {
        Some(cycle) if index >= CYCLIC_INDEX => cycle.take_given_up(index),
        _ => index < CYCLIC_INDEX && shared.port.take_given_up(index),
    });
    let statistics = &mut shared.board.statistics;
    if was_given_up {
        statistics.frames_lost -= 1;
        statistics.frames_late += 1;
        statistics.cyclic_late += u64::from(index.is_some_and(|index| index >= CYCLIC_INDEX));
    } else {
        statistics.frames_unexpected += 1;
    }
}

/// The data that procedures share with the machine; no procedure may run.
#[inline]
fn in_hand(shared: &mut Option<Box<Shared>>) -> &mut Shared {
    shared.as_deref_mut().expect(IN_HAND)
}

/// Why the machine holds the shared data.
const IN_HAND: &str = "procedures run inside of `lend` alone";

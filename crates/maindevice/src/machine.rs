//! The machine: what goes in, what comes out, and who may send next.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll, Waker};

use isocat_sync::phase;
use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::frame::{self, duration_ns};
use isocat_wire::register;
use isocat_wire::time::{Dc, Host, Nanos, Time};
use isocat_wire::{ObjectAddress, StationAddress};

use crate::application::{self, Application};
use crate::bring_up::{self, End, Work};
use crate::clock;
use crate::coe;
use crate::config::Config;
use crate::cycle::Cycle;
use crate::delay::{self, Times};
use crate::delay_watch::{Change, DelayWatch};
use crate::error::{AccessError, Cause, Error, MailboxError, SdoError, SdoResult};
use crate::event::{Event, RequestId, Stage};
use crate::health::{self, Answer, Found, Look};
use crate::link::{Link, Origin, Shared};
use crate::mailbox::{Mailbox, Mailboxes};
use crate::quality::{self, ClockQuality, Monitor, Snapshot};
use crate::readmit::{self, Keeper, Return};
use crate::ring::{self, Port};
use crate::segment::{GAP, Segment};
use crate::statistics::Statistics;
use crate::survey;

mod background;
mod delays;
mod returns;
mod ring_port;
mod share;

use background::Asking;
use ring_port::Ring;
use share::Share;

/// A MainDevice without sockets, threads or a clock of its own.
///
/// - Input: [`handle_frame`] for every frame that came in, [`handle_timeout`] when the instant of
///   [`next_timeout`] is reached.
/// - Output, to be drained after each input: [`poll_cycle`], which calls the application if a cycle is complete;
///   [`poll_event`] until it gives `None`; [`poll_transmit`] until it gives `None`; then [`next_timeout`] anew. A
///   [`Runner`](crate::Runner) keeps this order.
/// - A ring ([`Config::ring`]): what its second port sends comes from [`poll_secondary`], to be drained after each frame
///   of [`poll_transmit`], and [`handle_frame_at`] takes what came in at either port.
/// - Process data: [`outputs_mut`] and [`inputs`], as the [`Application`] has them in each cycle.
/// - Wishes while it runs: [`upload`], [`download`], [`read_memory`], [`stop`].
/// - State: [`segment`], [`statistics`], [`stage`], [`next_cycle`], [`frames_in_flight`].
///
/// Time is the caller's monotonic clock, read as late as possible: the `now` of [`poll_transmit`]
/// is the time stamp of the frame that it gives, and the clock servo follows these stamps. Points
/// of time never go backwards from call to call.
///
/// The machine begins to work at once and ends in [`Event::InOperation`] or [`Event::Failed`]; with
/// [`Config::survey`] in [`Event::Surveyed`] instead.
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
/// [`stage`]: Self::stage
pub struct MainDevice {
    config: Arc<Config>,
    link: Link,
    /// What procedures share with the machine; `None` while they run.
    shared: Option<Box<Shared>>,
    begin: Time<Host>,
    segment: Segment,
    mailboxes: Mailboxes,
    activity: Activity,
    stage: Stage,
    cycle: Option<Cycle>,
    /// Wire time left in this cycle for acyclic frames, and the end of the last one.
    share: Share,
    jobs: VecDeque<Job>,
    running: Vec<RunningJob>,
    reads: Vec<(RequestId, Pin<Box<Reading>>)>,
    next_request: u32,
    health: Option<Pin<Box<dyn Future<Output = Look> + Send>>>,
    /// What the cyclic broadcast read when health was last checked, and in which cycle.
    checked: Option<((u16, u16), u64)>,
    /// Those that are lost or out of OP, and what is done about it.
    keeper: Keeper,
    /// How many answered when that last disagreed with the tree.
    unplanned: Option<u16>,
    /// Delays measured on in operation.
    delay_watch: Option<DelayWatch>,
    quality: Option<Monitor>,
    /// Clocks that are being read.
    reading: Option<Pin<Box<ReadingClocks>>>,
    /// The entry that is being read in the background.
    asking: Option<Asking>,
    latching: Option<Pin<Box<Latching>>>,
    rewriting: Vec<Pin<Box<Rewriting>>>,
    ring: Option<Box<Ring>>,
    /// Told once the ring is as it was found.
    failure: Option<Error>,
    stopping: bool,
}

/// What the machine is about.
enum Activity {
    /// A piece of the way up or down.
    Task(Piece, Pin<Box<dyn Future<Output = End> + Send>>),
    /// The host locks onto the reference clock.
    Locking { since: Time<Host> },
    /// All SubDevices are in OP.
    Operating,
    /// A survey is through; SubDevices are in PREOP.
    Surveyed,
    /// Nothing more is sent.
    Over,
}

/// The pieces of the way, see [`bring_up`].
#[derive(Clone, Copy, PartialEq, Eq)]
enum Piece {
    Prepare,
    Synchronize,
    Operate,
    Survey,
    LeaveOperation,
    Stop,
    OpenRing,
}

/// An acyclic request that waits for its mailbox.
struct Job {
    request: RequestId,
    position: usize,
    object: ObjectAddress,
    /// `None`: an upload.
    download: Option<Vec<u8>>,
}

/// A read of memory under way.
type Reading = dyn Future<Output = Result<Vec<u8>, AccessError>> + Send;

/// A latch of the receive times under way; `None`: it did not come back whole.
type Latching = dyn Future<Output = Option<Times>> + Send;

/// Reads of clocks under way.
type ReadingClocks = dyn Future<Output = Vec<(usize, Option<quality::Registers>)>> + Send;

/// A write of 0x0928 under way; gives whether it was taken.
type Rewriting = dyn Future<Output = (Change, bool)> + Send;

struct RunningJob {
    request: RequestId,
    position: usize,
    is_download: bool,
    service: Pin<Box<dyn Future<Output = (Mailbox, SdoResult)> + Send>>,
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
        let first: (Piece, Pin<Box<dyn Future<Output = End> + Send>>) = match work.config.survey {
            None => (Piece::Prepare, Box::pin(bring_up::prepare(work))),
            Some(_) => (Piece::Survey, Box::pin(survey::survey(work))),
        };
        let mut machine = Self {
            config,
            shared: Some(link.take()),
            link,
            begin: now,
            segment: Segment::default(),
            mailboxes: Vec::new(),
            activity: Activity::Task(first.0, first.1),
            stage: Stage::Scan,
            cycle: None,
            share: Share::default(),
            jobs: VecDeque::new(),
            running: Vec::new(),
            reads: Vec::new(),
            next_request: 0,
            health: None,
            checked: None,
            keeper: Keeper::default(),
            unplanned: None,
            delay_watch: None,
            quality: None,
            reading: None,
            asking: None,
            latching: None,
            rewriting: Vec::new(),
            ring,
            failure: None,
            stopping: false,
        };
        machine.work();
        machine
    }

    /// Takes a frame that came in, without its FCS. Frames that are not ours, or that nobody waits for,
    /// are counted and ignored; see [`Statistics`].
    pub fn handle_frame(&mut self, now: Time<Host>, frame: &[u8]) {
        if self.ring.is_some() {
            return self.handle_frame_at(Port::Primary, now, frame);
        }
        let taken = take(in_hand(&mut self.shared), &mut self.cycle, &self.config, now, frame);
        self.close_cycle(now);
        if taken {
            self.work();
        }
    }

    /// Tells the time, at [`MainDevice::next_timeout`] or at any other moment.
    #[inline]
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        if self.ring.is_some() {
            // What has come goes on before its frame is given up.
            self.expire_copies(now);
        }
        let shared = in_hand(&mut self.shared);
        shared.handle_timeout(now);
        self.close_cycle(now);
        self.work();
    }

    /// Calls the application if the last input has completed a cycle, and gives the cycle's number: all of its frames are
    /// back, or the next one is due and what is not back was given up. Once for each cycle, in order; the
    /// application is not called for those without process data. To be called behind each input, before
    /// [`poll_transmit`](Self::poll_transmit): a cycle that nobody asked for is not told any more when the next one is
    /// over.
    #[inline]
    pub fn poll_cycle<A: Application + ?Sized>(&mut self, application: &mut A) -> Option<u64> {
        let (number, has_data) = self.cycle.as_mut()?.take_closed()?;
        if has_data {
            application.cycle(&mut application::Cycle::new(self, number));
        }
        Some(number)
    }

    /// Writes the next frame to send at once into `buffer` and gives its length; `None` if there is
    /// nothing to send now. `now` is the frame's time stamp. A buffer of [`crate::FRAME_LEN`] bytes
    /// is always enough.
    #[inline]
    pub fn poll_transmit(&mut self, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        if matches!(self.activity, Activity::Over) || buffer.len() < frame::MIN_LEN {
            return None;
        }
        let len = self.next_frame(now, buffer)?;
        if self.ring.is_some() {
            self.copy(now, &buffer[..len]);
        }
        Some(len)
    }

    fn next_frame(&mut self, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        let Self { shared, cycle, share, config, .. } = self;
        let shared = in_hand(shared);
        shared.port.now = now;
        let Some(cycle) = cycle else {
            return shared.transmit(now, buffer, frame::MAX_LEN);
        };
        if let Some(len) = cycle.transmit(now, buffer, &mut shared.board) {
            return Some(len);
        }
        let most = share.room(cycle, config, now, shared.port.first_len()?)?;
        let len = shared.transmit(now, buffer, most)?;
        share.take(now.max(cycle.through()), len);
        Some(len)
    }

    /// When [`MainDevice::handle_timeout`] is wanted next; `None`: never, it is over. In cyclic
    /// exchange this is the exact instant at which the next frame is to leave.
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

    /// When the next frames of process data are to leave; `None` outside the cyclic exchange.
    pub fn next_cycle(&self) -> Option<Time<Host>> {
        self.cycle.as_ref().map(Cycle::due)
    }

    /// Frames that were sent and are neither back nor given up.
    pub fn frames_in_flight(&self) -> usize {
        let cyclic = self.cycle.as_ref().map_or(0, Cycle::in_flight);
        cyclic + self.shared().port.in_flight()
    }

    /// The next thing that happened.
    pub fn poll_event(&mut self) -> Option<Event> {
        in_hand(&mut self.shared).board.poll_event()
    }

    /// The outputs of the SubDevice at `position`, sent with the next cycle; empty if it has none.
    pub fn outputs_mut(&mut self, position: usize) -> &mut [u8] {
        let range = self.segment.devices.get(position).map(|device| device.outputs.range());
        match (&mut self.cycle, range) {
            (Some(cycle), Some(range)) => cycle.outputs_mut().get_mut(range).unwrap_or_default(),
            _ => &mut [],
        }
    }

    /// The inputs of the SubDevice at `position`, as they last came back complete; empty if it has
    /// none.
    pub fn inputs(&self, position: usize) -> &[u8] {
        let range = self.segment.devices.get(position).map(|device| device.inputs.range());
        match (&self.cycle, range) {
            (Some(cycle), Some(range)) => cycle.inputs().get(range).unwrap_or_default(),
            _ => &[],
        }
    }

    /// Asks for an upload of an entry; the bytes come as [`Event::Uploaded`]. Before PREOP, or
    /// without a CoE mailbox, the answer is an error.
    pub fn upload(&mut self, position: usize, object: ObjectAddress) -> RequestId {
        self.request(position, object, None)
    }

    /// Asks for a download to an entry; the end comes as [`Event::Downloaded`].
    pub fn download(&mut self, position: usize, object: ObjectAddress, data: &[u8]) -> RequestId {
        self.request(position, object, Some(data.to_vec()))
    }

    /// Asks for `len` bytes of the memory of the SubDevice at `position`, registers included; they come
    /// as [`Event::Read`]. A working counter other than 1 is an error. What is still under way when
    /// the run ends is not answered.
    pub fn read_memory(&mut self, position: usize, address: u16, len: usize) -> RequestId {
        let request = self.next_request();
        let station = self.segment.devices.get(position).map(|device| device.station);
        // A position that is not there gets an address that nobody has after the scan.
        let station = station.unwrap_or(StationAddress(0));
        self.lend(|machine| {
            let exchange = machine.link.fprd(station, address, len);
            let read = async move { exchange.expect(1).await.map(|reply| reply.data) };
            machine.reads.push((request, Box::pin(read)));
        });
        self.work();
        request
    }

    /// Ends the run: OP → SAFEOP → PREOP, SYNC off, INIT; then [`Event::Stopped`]. On the way up it
    /// ends that.
    pub fn stop(&mut self) {
        if !matches!(self.activity, Activity::Over) {
            self.stopping = true;
            self.work();
        }
    }

    /// What was found, as of the last completed piece of the way up; AL states as of now.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// Counts so far.
    pub fn statistics(&self) -> Statistics {
        self.shared().board.statistics
    }

    /// The stage of the way up or down that was last begun.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Whether all SubDevices went to OP and nobody asked for the end.
    pub fn is_operating(&self) -> bool {
        matches!(self.activity, Activity::Operating)
    }

    /// What the clock servo knows; `None` before the cyclic exchange.
    pub fn phase(&self) -> Option<phase::State> {
        self.cycle.as_ref().map(|cycle| cycle.servo().state())
    }

    /// How much faster system time runs than the host's clock, parts per billion; `None` before the
    /// cyclic exchange.
    pub fn rate_ppb(&self) -> Option<i64> {
        self.cycle.as_ref().map(|cycle| cycle.servo().rate_ppb())
    }

    /// How well the servo knows phase and rate; `None` before the cyclic exchange, and with too few samples.
    pub fn phase_uncertainty(&self) -> Option<phase::Uncertainty> {
        self.cycle.as_ref().and_then(|cycle| cycle.servo().uncertainty())
    }

    /// Takes stamps of an external time, if that is to lead the reference clock; see [`Config::direction`].
    pub fn external_stamps(&mut self, stamps: phase::external::Stamps) {
        if let Some(cycle) = &mut self.cycle {
            cycle.external_stamps(stamps);
        }
    }

    /// What leads the reference clock: how far it is, and what it puts into the clocks. `None` if nothing
    /// does, and before the cyclic exchange.
    pub fn drive(&self) -> Option<&phase::Drive> {
        self.cycle.as_ref().and_then(|cycle| cycle.drive())
    }

    /// The system time that a frame sent at `host` finds at the reference clock, by the servo;
    /// `None` before the cyclic exchange.
    pub fn system_time(&self, host: Time<Host>) -> Option<Time<Dc>> {
        self.cycle.as_ref().map(|cycle| cycle.servo().dc_at(host))
    }

    /// What the application of a cycle works on.
    pub(crate) fn parts_mut(&mut self) -> (&Segment, Option<&mut Cycle>) {
        (&self.segment, self.cycle.as_mut())
    }

    /// The cyclic exchange.
    pub(crate) fn exchange(&self) -> Option<&Cycle> {
        self.cycle.as_ref()
    }

    /// An input was taken: the cycle may be over.
    #[inline]
    fn close_cycle(&mut self, now: Time<Host>) {
        if let Some(cycle) = &mut self.cycle {
            cycle.close(now);
        }
    }

    /// Lets everything go on that can.
    fn work(&mut self) {
        in_hand(&mut self.shared).port.forget_waits();
        if self.is_quiet() {
            return;
        }
        self.lend(|machine| {
            machine.work_on_way();
            machine.work_on_entry();
            machine.work_on_jobs();
            machine.work_on_reads();
            machine.work_on_health();
            machine.work_on_returns();
            machine.work_on_delays();
            machine.work_on_quality();
        });
    }

    /// Lets procedures at what they share with the machine while `f` runs.
    fn lend<R>(&mut self, f: impl FnOnce(&mut Self) -> R) -> R {
        if let Some(shared) = self.shared.take() {
            self.link.lay_back(shared);
        }
        let result = f(self);
        self.shared = Some(self.link.take());
        result
    }

    /// What procedures share with the machine, while none runs.
    fn shared(&self) -> &Shared {
        self.shared.as_deref().expect(IN_HAND)
    }

    /// Whether nothing but the cycle runs: no procedure to poll, nobody out of OP.
    fn is_quiet(&self) -> bool {
        let op = AlStatus::new(AlState::Op).0;
        matches!(self.activity, Activity::Operating)
            && !self.stopping
            && self.jobs.is_empty()
            && self.running.is_empty()
            && self.reads.is_empty()
            && self.health.is_none()
            && self.checked.is_none()
            && self.latching.is_none()
            && self.reading.is_none()
            && self.asking.is_none()
            && !self.has_quality_to_look_at()
            && self.rewriting.is_empty()
            && !self.delay_watch.as_ref().is_some_and(|watch| watch.due(self.shared().port.now))
            && self.keeper.is_idle()
            && self.cycle.as_ref().is_some_and(|cycle| {
                cycle.al_status == op
                    && cycle.answering() == cycle.present()
                    && !cycle.doubts_clocks()
            })
    }

    fn work_on_way(&mut self) {
        loop {
            if self.stopping && self.begin_stop() {
                continue;
            }
            match &mut self.activity {
                Activity::Task(piece, task) => {
                    let piece = *piece;
                    let Poll::Ready((work, result)) = poll(task) else { return };
                    self.stage = work.stage;
                    self.segment = work.segment;
                    self.mailboxes = work.mailboxes;
                    self.after(piece, result);
                }
                Activity::Locking { since } => {
                    let since = *since;
                    let Some(cycle) = &self.cycle else { return };
                    if cycle.is_locked() && cycle.number() > 0 {
                        self.begin_piece(Piece::Synchronize);
                        continue;
                    }
                    let after = self.link.now() - since;
                    if after < cycle.lock_patience(self.config.timeouts.phase) {
                        return;
                    }
                    let error = cycle.servo().last_error();
                    self.fail(Error { stage: Stage::Phase, cause: Cause::Phase { error, after } });
                }
                Activity::Operating | Activity::Surveyed | Activity::Over => return,
            }
        }
    }

    /// Goes on behind a piece of the way.
    fn after(&mut self, piece: Piece, result: Result<(), Error>) {
        // The way down goes on to its end whatever happens on it.
        match (piece, result) {
            (Piece::LeaveOperation, _) => {
                if let Some(cycle) = &mut self.cycle {
                    cycle.exchange_process_data(false);
                }
                self.begin_piece(Piece::Stop);
            }
            (Piece::Stop, Ok(())) => {
                self.link.report(Event::Stopped);
                self.end();
            }
            (Piece::OpenRing, _) => {
                if let Some(error) = self.failure.take() {
                    self.link.report(Event::Failed(error));
                }
                self.end();
            }
            (_, Err(error)) => self.fail(error),
            (Piece::Prepare, Ok(())) => self.begin_cycle(),
            (Piece::Synchronize, Ok(())) => {
                if let Some(cycle) = &mut self.cycle {
                    cycle.exchange_process_data(true);
                }
                self.begin_piece(Piece::Operate);
            }
            (Piece::Operate, Ok(())) => self.begin_operation(),
            (Piece::Survey, Ok(())) => {
                self.activity = Activity::Surveyed;
                self.link.report(Event::Surveyed);
            }
        }
    }

    fn begin_cycle(&mut self) {
        let now = self.link.now();
        self.link.board(|board| {
            if self.segment.reference.is_some() && self.config.drift_compensation {
                board.statistics.time_to_converged = Some(now - self.begin);
            }
        });
        self.cycle = Some(Cycle::new(&self.config, &self.segment, now, self.config.source));
        self.stage = Stage::Phase;
        self.link.report(Event::Progress(Stage::Phase));
        self.activity = Activity::Locking { since: now };
    }

    fn begin_operation(&mut self) {
        let (now, begin) = (self.link.now(), self.begin);
        self.link.board(|board| {
            board.statistics.time_to_operation = Some(now - begin);
            board.statistics.bring_up_frames = board.statistics.frames_sent;
            let cycle = board.cycle;
            board.report(Event::InOperation { cycle, after: now - begin });
        });
        if let Some(cycle) = &mut self.cycle {
            cycle.measuring = true;
        }
        let watch = |config| DelayWatch::new(config, &self.segment, now);
        self.delay_watch = self.config.delay_watch.and_then(watch);
        let (number, counts) = self.link.board(|board| (board.cycle, board.statistics));
        let monitor = |config| Monitor::new(config, &self.segment, now, number, &counts);
        self.quality = self.config.quality.map(monitor);
        self.keeper = Keeper::new(self.segment.devices.len());
        self.activity = Activity::Operating;
    }

    fn begin_piece(&mut self, piece: Piece) {
        let work = Work {
            link: self.link.clone(),
            config: self.config.clone(),
            segment: self.segment.clone(),
            mailboxes: core::mem::take(&mut self.mailboxes),
            stage: self.stage,
        };
        let task: Pin<Box<dyn Future<Output = End> + Send>> = match piece {
            Piece::Prepare => Box::pin(bring_up::prepare(work)),
            Piece::Survey => Box::pin(survey::survey(work)),
            Piece::Synchronize => Box::pin(bring_up::synchronize(work)),
            Piece::Operate => Box::pin(bring_up::operate(work)),
            Piece::LeaveOperation => Box::pin(bring_up::leave_operation(work)),
            Piece::Stop => Box::pin(bring_up::stop(work)),
            Piece::OpenRing => Box::pin(bring_up::open_ring(work)),
        };
        self.activity = Activity::Task(piece, task);
    }

    /// Turns round, if the machine is on its way up or in operation.
    fn begin_stop(&mut self) -> bool {
        let turns = match &self.activity {
            Activity::Task(piece, _) => {
                !matches!(piece, Piece::LeaveOperation | Piece::Stop | Piece::OpenRing)
            }
            Activity::Locking { .. } | Activity::Operating | Activity::Surveyed => true,
            Activity::Over => false,
        };
        if turns {
            self.health = None;
            self.keeper = Keeper::default();
            self.forget_delays();
            self.refuse_jobs();
            self.asking = None;
            self.begin_piece(Piece::LeaveOperation);
        }
        turns
    }

    fn fail(&mut self, error: Error) {
        self.stage = error.stage;
        if ring::is_closed(&self.link) {
            self.failure = Some(error);
            return self.begin_piece(Piece::OpenRing);
        }
        self.link.report(Event::Failed(error));
        self.end();
    }

    /// Nothing more is sent.
    fn end(&mut self) {
        self.refuse_jobs();
        self.asking = None;
        self.reads.clear();
        self.health = None;
        self.keeper = Keeper::default();
        self.forget_delays();
        self.cycle = None;
        self.activity = Activity::Over;
    }

    fn request(
        &mut self,
        position: usize,
        object: ObjectAddress,
        download: Option<Vec<u8>>,
    ) -> RequestId {
        let request = self.next_request();
        self.jobs.push_back(Job { request, position, object, download });
        self.work();
        request
    }

    fn next_request(&mut self) -> RequestId {
        let request = RequestId(self.next_request);
        self.next_request = self.next_request.wrapping_add(1);
        request
    }

    /// Ends the reads that have their answer.
    fn work_on_reads(&mut self) {
        let mut at = 0;
        while at < self.reads.len() {
            let Poll::Ready(result) = poll(&mut self.reads[at].1) else {
                at += 1;
                continue;
            };
            let (request, _) = self.reads.swap_remove(at);
            self.link.report(Event::Read { request, result });
        }
    }

    /// Starts what has its mailbox free, ends what has its answer.
    fn work_on_jobs(&mut self) {
        let mut at = 0;
        while at < self.running.len() {
            let Poll::Ready((mailbox, result)) = poll(&mut self.running[at].service) else {
                at += 1;
                continue;
            };
            let job = self.running.swap_remove(at);
            if let Some(place) = self.mailboxes.get_mut(job.position) {
                *place = Some(mailbox);
            }
            self.answer(job.request, job.is_download, result);
        }
        let mut at = 0;
        while at < self.jobs.len() {
            let position = self.jobs[at].position;
            let busy = self.running.iter().any(|job| job.position == position)
                || self.asking.as_ref().is_some_and(|asking| asking.position == position)
                || self.jobs.iter().take(at).any(|job| job.position == position);
            // On the way up the mailboxes are in use; requests wait.
            let on_the_way = matches!(self.activity, Activity::Task(..)) && !self.stopping;
            if busy || on_the_way {
                at += 1;
                continue;
            }
            let mailbox = self.mailboxes.get_mut(position).and_then(Option::take);
            let Some(job) = self.jobs.remove(at) else { continue };
            match mailbox {
                Some(mailbox) => self.run(job, mailbox),
                None => {
                    let absent = Err(SdoError::Mailbox(MailboxError::Absent));
                    self.answer(job.request, job.download.is_some(), absent);
                }
            }
        }
    }

    fn run(&mut self, job: Job, mut mailbox: Mailbox) {
        let Job { request, position, object, download } = job;
        let is_download = download.is_some();
        let mut service: Pin<Box<dyn Future<Output = (Mailbox, SdoResult)> + Send>> =
            Box::pin(async move {
                let result = match download {
                    Some(data) => {
                        coe::download(&mut mailbox, object, &data, false).await.map(|()| Vec::new())
                    }
                    None => coe::upload(&mut mailbox, object, false).await,
                };
                (mailbox, result)
            });
        // The first poll queues its first datagram; it can't be done yet.
        let _pending = poll(&mut service).is_pending();
        self.running.push(RunningJob { request, position, is_download, service });
    }

    fn answer(&mut self, request: RequestId, is_download: bool, result: SdoResult) {
        self.link.report(match is_download {
            true => Event::Downloaded { request, result: result.map(|_| ()) },
            false => Event::Uploaded { request, result },
        });
    }

    /// Nobody will answer these any more.
    fn refuse_jobs(&mut self) {
        let waiting = self.jobs.drain(..).map(|job| (job.request, job.download.is_some()));
        let running = self.running.drain(..).map(|job| (job.request, job.is_download));
        for (request, is_download) in waiting.chain(running).collect::<Vec<_>>() {
            self.answer(request, is_download, Err(SdoError::Mailbox(MailboxError::Absent)));
        }
    }

    /// Looks at every SubDevice when the cyclic broadcast does not read OP everywhere, or of others than take
    /// part.
    fn work_on_health(&mut self) {
        let Activity::Operating = self.activity else { return };
        if let Some(check) = &mut self.health {
            let Poll::Ready(look) = poll(check) else { return };
            self.health = None;
            self.take_look(look);
        }
        let Some(cycle) = &self.cycle else { return };
        let seen = (cycle.al_status, cycle.answering());
        let good = seen == (AlStatus::new(AlState::Op).0, cycle.present());
        if good && self.checked.is_none() {
            return;
        }
        // The broadcast is an OR over all: a second SubDevice may fall without changing it. So the same
        // picture is looked at again after a while.
        let now = cycle.number();
        let known = |(picture, at): ((u16, u16), u64)| {
            picture == seen && now.wrapping_sub(at) < CHECK_AGAIN
        };
        if self.checked.is_some_and(known) {
            return;
        }
        self.checked = (!good).then_some((seen, now));
        let asked = self.segment.devices.iter().filter(|device| device.admitted);
        let asked = asked.map(|device| (device.position, device.station)).collect();
        let mut check: Pin<Box<dyn Future<Output = Look> + Send>> =
            Box::pin(health::look(self.link.clone(), asked));
        // The first poll queues its datagrams.
        let _pending = poll(&mut check).is_pending();
        self.health = Some(check);
    }

    fn take_look(&mut self, look: Look) {
        let cycle = self.link.board(|board| board.cycle);
        let (reference, mut lost) = (self.segment.reference, Vec::new());
        for (position, answer) in look.answers {
            match answer {
                Answer::Status(status, code) => {
                    let device = &mut self.segment.devices[position];
                    if (device.al_status, device.al_code) != (status, code) {
                        (device.al_status, device.al_code) = (status, code);
                        self.link.report(Event::StateChanged { position, status, code, cycle });
                    }
                    self.consider_recovery(position);
                }
                Answer::Nobody if self.config.readmission.is_some() => {
                    self.lose(position);
                    lost.push(position);
                }
                Answer::Nobody | Answer::Unknown => {}
            }
        }
        if self.config.readmission.is_none() {
            return;
        }
        if reference.is_some_and(|at| lost.contains(&at)) {
            self.elect();
        }
        match look.everybody {
            Some(_) if self.is_ring_cut() => {}
            Some(everybody) => self.welcome(everybody),
            None => {
                self.unplanned = None;
                for device in self.segment.devices.iter().filter(|device| !device.admitted) {
                    self.keeper.is_absent(device.position);
                }
            }
        }
    }
}

/// Cycles after which the states of all SubDevices are read again while the broadcast looks wrong.
const CHECK_AGAIN: u64 = 100;

/// A MainDevice may be built in one thread and run in another.
const _: () = {
    const fn is_send<T: Send>() {}
    is_send::<MainDevice>();
};

/// Hands a frame that came in to who waits for it; whether somebody did.
fn take(
    shared: &mut Shared,
    cycle: &mut Option<Cycle>,
    config: &Config,
    now: Time<Host>,
    frame: &[u8],
) -> bool {
    shared.port.now = now;
    let origin = Origin::of(frame, config.source);
    let Origin::Ours { payload } = origin else {
        origin.count(&mut shared.board.statistics);
        return false;
    };
    let taken =
        cycle.as_mut().is_some_and(|cycle| cycle.receive(now, frame, payload, &mut shared.board))
            || frame::payload(frame).is_ok_and(|payload| shared.receive(payload));
    if !taken {
        shared.board.statistics.frames_late += 1;
    }
    taken
}

/// What procedures share with the machine, while none runs.
fn in_hand(shared: &mut Option<Box<Shared>>) -> &mut Shared {
    shared.as_deref_mut().expect(IN_HAND)
}

/// Why the machine has it.
const IN_HAND: &str = "procedures run inside of `lend` alone";

fn poll<T: ?Sized + Future>(future: &mut Pin<Box<T>>) -> Poll<T::Output> {
    future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
}

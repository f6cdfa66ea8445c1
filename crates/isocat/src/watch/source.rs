//! Sources of statuses.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use isocat_engine::status::edges::Onlooker;
use isocat_engine::status::main_device::EVERY;
use isocat_engine::status::{Board, Kind, Scribe, Status};
use isocat_maindevice::{Event, Motion};
use isocat_segment::Scenario;
use isocat_sim::observation::Observation;
use isocat_sim::{Segment, Tap, World, run};
use isocat_wire::time::{Nanos, Picos, Time, True};

/// A source that gives each status once.
pub struct Source {
    from: From,
    /// The SubDevice whose cycle is observed; [`NOBODY`] for none.
    focus: Arc<AtomicUsize>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

enum From {
    Channel(Receiver<Status>),
    Board(Board),
}

/// No SubDevice is observed.
const NOBODY: usize = usize::MAX;
/// Largest number of waiting statuses; the simulation waits for the reader.
const WAITING: usize = 16;
/// The longest sleep between two checks for the end.
const NAP: Duration = Duration::from_millis(50);
/// Virtual time limit of a way up.
const BRING_UP_LIMIT: Picos = Picos(300_000_000_000_000);

/// Speed of virtual time.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Speed {
    /// This factor of the host's clock.
    Times(f64),
    /// As fast as it can be computed.
    Max,
}

impl Speed {
    /// Reads `max`, or a number from 0.001 to 1000.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text == "max" {
            return Ok(Speed::Max);
        }
        let times = text.parse::<f64>().ok().filter(|times| (1e-3..=1e3).contains(times));
        times.map(Speed::Times).ok_or_else(|| {
            format!("expected \"max\", or how many times as fast as real time, 0.001 to 1000, found {text}")
        })
    }
}

impl Source {
    /// Simulates a segment, on a separate thread.
    pub fn simulated(scenario: Scenario, speed: Speed, stop: Arc<AtomicBool>) -> Self {
        let (sender, receiver) = sync_channel(WAITING);
        let focus = Arc::new(AtomicUsize::new(NOBODY));
        let (looked, ended) = (focus.clone(), stop.clone());
        let thread = std::thread::spawn(move || {
            Simulation::new(&scenario, looked, ended).run(&scenario, speed, &sender);
        });
        Self { from: From::Channel(receiver), focus, stop, thread: Some(thread) }
    }

    /// The source of a loop that fills a board on this thread, until it is stopped.
    pub(crate) fn of_board(board: Board, stop: Arc<AtomicBool>, thread: JoinHandle<()>) -> Self {
        let focus = Arc::new(AtomicUsize::new(NOBODY));
        Self { from: From::Board(board), focus, stop, thread: Some(thread) }
    }

    /// Polls a status repeatedly.
    pub fn asked(
        mut ask: impl FnMut() -> Result<Status, String> + Send + 'static,
        first: Status,
        every: Duration,
        stop: Arc<AtomicBool>,
    ) -> Self {
        let (sender, receiver) = sync_channel(WAITING);
        let ended = stop.clone();
        let thread = std::thread::spawn(move || {
            let mut status = first;
            while !ended.load(Ordering::Relaxed) && sender.send(status.clone()).is_ok() {
                std::thread::sleep(every);
                match ask() {
                    Ok(next) => status = next,
                    Err(why) => {
                        status.stage = isocat_engine::status::Stage::Ended;
                        status.failure = Some(why);
                        status.events.clear();
                        // An error means that the reader has ended, which is fine.
                        let _ = sender.send(status);
                        return;
                    }
                }
            }
        });
        let focus = Arc::new(AtomicUsize::new(NOBODY));
        Self { from: From::Channel(receiver), focus, stop, thread: Some(thread) }
    }

    /// The next status; `None` if there is none yet.
    pub fn take(&self) -> Option<Status> {
        match &self.from {
            From::Board(board) => board.take(),
            From::Channel(receiver) => receiver.try_recv().ok(),
        }
    }

    /// Observes the cycle of this SubDevice.
    pub fn look_at(&self, position: Option<usize>) {
        self.focus.store(position.unwrap_or(NOBODY), Ordering::Relaxed);
    }

    /// Whether no further status can come.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops it, and waits for its end.
    pub fn end(mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // This releases a thread that waits to send.
        self.from = From::Channel(sync_channel(1).1);
        if let Some(thread) = self.thread.take()
            && let Err(panic) = thread.join()
        {
            std::panic::resume_unwind(panic);
        }
    }
}

/// A simulation in steps of the status interval.
struct Simulation {
    world: World<Motion, Shared>,
    onlooker: Rc<RefCell<Onlooker>>,
    scribe: Scribe,
    board: Board,
    focus: Arc<AtomicUsize>,
    stop: Arc<AtomicBool>,
}

#[derive(Clone)]
struct Shared(Rc<RefCell<Onlooker>>);

impl Tap for Shared {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}

    fn observed(&mut self, segment: &Segment, _: Time<True>, observation: &Observation) {
        self.0.borrow_mut().observe(segment, observation);
    }
}

impl Simulation {
    fn new(scenario: &Scenario, focus: Arc<AtomicUsize>, stop: Arc<AtomicBool>) -> Self {
        let setup = scenario.run().setup;
        let (cycle, limit) = (scenario.cycle.0, scenario.sync0_limit.0);
        let status = Status::new(scenario.source.clone(), Kind::Simulated, cycle, limit);
        let board = Board::new(status);
        let scribe = Scribe::new(board.clone(), &setup.config);
        let onlooker = Rc::new(RefCell::new(Onlooker::new(setup.segment.len(), 1)));
        let world = World::new(setup, Motion::default(), Some(Shared(onlooker.clone())));
        Self { world, onlooker, scribe, board, focus, stop }
    }

    fn run(mut self, scenario: &Scenario, speed: Speed, sender: &SyncSender<Status>) {
        let origin = Instant::now();
        let mut until = Time::<True>::ZERO;
        let mut began = false;
        loop {
            until += EVERY.into();
            let mut failure = None;
            loop {
                let more = self.world.step(until);
                self.take_events(scenario, &mut began, &mut failure);
                if !more || failure.is_some() || self.stop.load(Ordering::Relaxed) {
                    break;
                }
                self.scribe.cycle(self.world.main());
            }
            if !began && failure.is_none() && until - Time::ZERO > BRING_UP_LIMIT {
                failure = Some("the segment did not reach OP in the time allowed".to_owned());
            }
            let at = self.world.now();
            self.look();
            let at_ns = at.as_nanos() as i64;
            let (onlooker, bench) = (&self.onlooker, &self.world.bench);
            self.scribe.publish(at_ns, self.world.main(), |status, _| {
                onlooker.borrow_mut().turn(at);
                onlooker.borrow().over(status, bench);
            });
            let ends = failure.is_some();
            if ends {
                self.board.end(failure);
            }
            let Some(status) = self.board.take() else { return };
            if sender.send(status).is_err() || ends {
                return;
            }
            if !self.pace(origin, until, speed) {
                return;
            }
        }
    }

    /// Observes the cycle of the selected SubDevice.
    fn look(&mut self) {
        let position = self.focus.load(Ordering::Relaxed);
        let segment = self.world.main().segment();
        let cycle = segment.timing.as_ref().map(|timing| timing.cycle.cycle);
        let device = segment.devices.get(position);
        let every = |device: &isocat_maindevice::SubDevice| i64::from(device.every.max(1));
        let focus = device.zip(cycle).map(|(d, cycle)| (position, Nanos(cycle.0 * every(d))));
        self.onlooker.borrow_mut().look_at(focus);
    }

    fn take_events(&mut self, scenario: &Scenario, began: &mut bool, failure: &mut Option<String>) {
        while let Some(event) = self.world.poll_event() {
            let at = self.world.now();
            self.scribe.event(at.as_nanos() as i64, &event);
            match event {
                Event::InOperation { .. } => {
                    *began = true;
                    self.world.catch_up();
                    let intent = run::intent(self.world.main(), scenario.sync0_limit);
                    self.onlooker.borrow_mut().begin(at, &intent);
                    self.world.bench.begin(intent);
                }
                Event::Failed(error) => *failure = Some(error.to_string()),
                _ => {}
            }
        }
    }

    /// Waits for the host's clock; returns false if the source is to end.
    fn pace(&self, origin: Instant, until: Time<True>, speed: Speed) -> bool {
        let due = match speed {
            Speed::Max => Duration::ZERO,
            Speed::Times(times) => Duration::from_nanos((until.as_nanos() as f64 / times) as u64),
        };
        while !self.stop.load(Ordering::Relaxed) {
            let left = due.saturating_sub(origin.elapsed());
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(NAP));
        }
        false
    }
}

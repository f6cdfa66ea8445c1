//! The view of a test on the segment, and its means to change it.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::panic::Location;
use std::rc::{Rc, Weak};
use std::task::{Poll, Waker};
use std::time::Duration;

use isocat_serve::{Order, bus};
use isocat_sim::{Fault, MainPort};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, AlStatusCode};

use crate::Verdict;
use crate::clock::{Clock, Sleep};
use crate::executor::{Executor, Task};
use crate::host::{Instant, Span, nanos};
use crate::place::{Place, position};
use crate::segment::Segment;
use crate::socket::{Queue, Socket};

/// The segment of a run, in virtual time. Cheap to clone; all clones are the same bus.
///
/// - Time: [`now`](Self::now), [`sleep`](Self::sleep), [`within`](Self::within);
///   [`host_sleep`](Self::host_sleep) for an application.
/// - The application and other tasks: [`spawn`](Self::spawn). Its frames: [`socket`](Self::socket).
/// - The devices: [`device`](Self::device), [`all_op`](Self::all_op).
/// - Faults: [`fault`](Self::fault), [`fault_after`](Self::fault_after),
///   [`set_lateness`](Self::set_lateness).
/// - Results: [`verdict`](Self::verdict).
///
/// If a test asks for something that can't be done, for example for a device that does not exist,
/// the bus panics at that line of the test.
#[derive(Clone)]
pub struct Bus(pub(crate) Rc<Shared>);

pub(crate) struct Shared {
    pub clock: Rc<Clock>,
    pub executor: Rc<Executor>,
    bus: RefCell<bus::Bus>,
    names: Vec<String>,
    source: String,
    seed: u64,
    lateness: Cell<Duration>,
    sockets: RefCell<Vec<Weak<RefCell<Queue>>>>,
    /// Tasks that check a condition again at each instant at which something happens.
    watchers: RefCell<Vec<Waker>>,
    /// Hash of all frames that were sent and came back, with port and instant.
    hash: Cell<u64>,
}

/// A device of the segment.
#[derive(Clone)]
pub struct Device {
    bus: Bus,
    position: usize,
}

/// When the segment is switched on, on the host's clock.
const START: Time<Host> = Time::new(1_000_000_000);
/// How often a condition is checked while a test waits and nothing else happens, ns.
const LOOK: Instant = 1_000_000;

impl Bus {
    pub(crate) fn new(segment: &mut Segment, clock: Rc<Clock>, executor: Rc<Executor>) -> Self {
        let scenario = &segment.scenario;
        let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
        let (source, seed) = (scenario.source.clone(), scenario.seed);
        Self(Rc::new(Shared {
            clock,
            executor,
            bus: RefCell::new(bus::Bus::new(segment.setup(), START)),
            names,
            source,
            seed,
            lateness: Cell::new(segment.lateness),
            sockets: RefCell::new(Vec::new()),
            watchers: RefCell::new(Vec::new()),
            hash: Cell::new(FNV.0),
        }))
    }

    /// Virtual time since the segment was switched on.
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.0.clock.now())
    }

    /// Waits for this virtual time, exact to the nanosecond: for the test itself, and for the parts
    /// of the machine that it simulates.
    pub fn sleep(&self, time: Duration) -> Sleep {
        Sleep::new(time, false)
    }

    /// Waits for this virtual time like an application: its host wakes it late, by
    /// [`Segment::lateness`] and by faults.
    pub fn host_sleep(&self, time: Duration) -> Sleep {
        Sleep::new(time, true)
    }

    /// Waits until a condition holds. It is checked whenever something happens, and each
    /// millisecond.
    ///
    /// # Panics
    ///
    /// If it does not hold within `limit`.
    #[track_caller]
    pub fn within(
        &self,
        limit: Duration,
        condition: impl Fn(&Bus) -> bool,
    ) -> impl Future<Output = ()> {
        let (bus, place) = (self.clone(), Location::caller());
        let mut end = self.sleep(limit);
        std::future::poll_fn(move |context| {
            if condition(&bus) {
                return Poll::Ready(());
            }
            if std::pin::Pin::new(&mut end).poll(context).is_ready() {
                let states = bus.states();
                panic!(
                    "{place}: what was waited for did not come within {limit:?}; devices: {states}"
                );
            }
            bus.0.clock.wake_at(bus.0.clock.now() + LOOK, context.waker());
            bus.0.watchers.borrow_mut().push(context.waker().clone());
            Poll::Pending
        })
    }

    /// Runs a future concurrently with the test, as an executor of the application would. All tasks
    /// run on the test's thread, one at a time.
    pub fn spawn<F: Future + 'static>(&self, future: F) -> Task<F::Output> {
        self.0.executor.spawn(future)
    }

    /// A socket at the segment, for a stack that builds its own frames.
    pub fn socket(&self) -> Socket {
        self.open(MainPort::Primary)
    }

    /// A socket at the other end of a ring.
    ///
    /// # Panics
    ///
    /// If the segment is no ring.
    #[track_caller]
    pub fn secondary_socket(&self) -> Socket {
        let is_ring = self.0.bus.borrow().server().has_two_ports();
        assert!(is_ring, "no second port: the segment is no ring; expected `ring = true` in it");
        self.open(MainPort::Secondary)
    }

    fn open(&self, port: MainPort) -> Socket {
        let socket = Socket::new(self.clone(), port);
        let mut sockets = self.0.sockets.borrow_mut();
        sockets.retain(|socket| socket.strong_count() > 0);
        sockets.push(Rc::downgrade(&socket.queue));
        socket
    }

    /// A device by its name, or by its position from 0.
    ///
    /// # Panics
    ///
    /// If there is no such device.
    #[track_caller]
    pub fn device(&self, place: impl Place) -> Device {
        let names: Vec<&str> = self.0.names.iter().map(String::as_str).collect();
        Device { bus: self.clone(), position: position(&names, place) }
    }

    /// All devices, in the order of the line.
    pub fn devices(&self) -> impl Iterator<Item = Device> {
        let device = |position| Device { bus: self.clone(), position };
        (0..self.0.names.len()).map(device)
    }

    /// Whether all devices are in OP, none with an error.
    pub fn all_op(&self) -> bool {
        self.devices().all(|device| device.state() == AlState::Op && !device.has_error())
    }

    /// Causes a fault now: a line of `docs/faults.md`, for example `pull axis 2 for 200ms`. Of the
    /// faults of the host, `stall` and `late-wake-ups` are possible here.
    ///
    /// # Panics
    ///
    /// If the line is no such fault, or this segment can't have it.
    #[track_caller]
    pub fn fault(&self, line: &str) {
        self.fault_after(Duration::ZERO, line);
    }

    /// Causes a fault after this time.
    ///
    /// # Panics
    ///
    /// As [`fault`](Self::fault), and at the call, not when the fault is due.
    #[track_caller]
    pub fn fault_after(&self, time: Duration, line: &str) {
        if let Err(error) = self.order(time, line) {
            panic!("fault \"{line}\": {error}");
        }
    }

    fn order(&self, time: Duration, line: &str) -> Result<(), String> {
        let order = Order::parse(line, &self.0.names)?;
        let at = self.0.clock.now().saturating_add(nanos(time));
        let lasts = order.lasts.map_or(Instant::MAX, |lasts| lasts.0.max(0) as u64);
        let span = Span(at, at.saturating_add(lasts));
        match order.fault {
            Fault::Stall => self.0.clock.host.borrow_mut().stall(span),
            Fault::LateWakeUps(late) => self.0.clock.host.borrow_mut().be_late(span, late),
            _ if time.is_zero() => return self.0.at_present(|bus| bus.inject(order)),
            _ => return self.0.at_present(|bus| bus.inject_at(host_time(at), order)),
        }
        Ok(())
    }

    /// Sets how late the application's wake-ups are from now on, at most; see
    /// [`Segment::lateness`].
    pub fn set_lateness(&self, worst: Duration) {
        self.0.lateness.set(worst);
        self.0.clock.host.borrow_mut().set_lateness(worst);
    }

    /// What the MainDevice did so far, and the verdict of the judges at this instant.
    pub fn verdict(&self) -> Verdict {
        let summary = self.0.at_present(|bus| bus.summary(&self.0.source, "no interface"));
        self.0.verdict(summary)
    }

    /// Each device and its state, for messages.
    pub(crate) fn states(&self) -> String {
        let state = |device: Device| {
            let error =
                if device.has_error() { format!(" ({})", device.status()) } else { String::new() };
            format!("{} in {}{error}", device.name(), device.state().name())
        };
        self.devices().map(state).collect::<Vec<_>>().join(", ")
    }
}

impl Device {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.bus.0.names[self.position]
    }

    /// Its position in the line, from 0.
    pub fn position(&self) -> usize {
        self.position
    }

    /// Its state.
    pub fn state(&self) -> AlState {
        self.present().0
    }

    /// Its AL status code: why it left a state, or refused one.
    pub fn status(&self) -> AlStatusCode {
        self.present().1
    }

    /// Whether it left or refused a state, and the MainDevice has not acknowledged the error.
    pub fn has_error(&self) -> bool {
        self.status() != AlStatusCode::NO_ERROR
    }

    fn present(&self) -> (AlState, AlStatusCode) {
        let present = self.bus.0.at_present(|bus| bus.state(self.position));
        present.unwrap_or((AlState::Init, AlStatusCode::NO_ERROR))
    }

    /// The outputs that it took last; `None` while they are in their safe state.
    pub fn outputs(&self) -> Option<Vec<u8>> {
        self.bus.0.at_present(|bus| bus.outputs(self.position))
    }

    /// Sets its first inputs, from the next time on that it maps them. Bytes beyond its process
    /// image are ignored; bytes that are not set remain those of its application.
    pub fn set_inputs(&self, inputs: &[u8]) {
        self.bus.0.at_present(|bus| bus.set_inputs(self.position, Some(inputs)));
    }

    /// Returns control of the inputs to its application.
    pub fn release_inputs(&self) {
        self.bus.0.at_present(|bus| bus.set_inputs(self.position, None));
    }
}

impl Shared {
    /// Advances the segment to the present of the clock, and calls `act` with it.
    pub fn at_present<T>(&self, act: impl FnOnce(&mut bus::Bus) -> T) -> T {
        let mut bus = self.bus.borrow_mut();
        advance(&mut bus, host_time(self.clock.now()));
        act(&mut bus)
    }

    /// When the application receives the next answer.
    pub fn next_arrival(&self) -> Option<Instant> {
        let at = since_start(self.bus.borrow().next_arrival()?);
        Some(self.clock.host.borrow().receives(at))
    }

    /// Delivers the frames that have come back, and wakes the tasks that wait for them or check
    /// conditions.
    pub fn arrive(&self) {
        let now = self.clock.now();
        while self.next_arrival().is_some_and(|at| at <= now) {
            let Some(arrival) = self.at_present(bus::Bus::receive) else { break };
            self.take_in(arrival.at, arrival.port, &arrival.frame);
            for socket in self.sockets.borrow().iter().filter_map(Weak::upgrade) {
                socket.borrow_mut().put(&arrival);
            }
        }
        let watchers = std::mem::take(&mut *self.watchers.borrow_mut());
        watchers.into_iter().for_each(Waker::wake);
    }

    /// Sends a frame now.
    pub fn send(&self, port: MainPort, frame: &[u8]) -> Result<(), bus::Refused> {
        let at = host_time(self.clock.now());
        self.at_present(|bus| bus.send(port, at, frame))?;
        self.take_in(at, port, frame);
        Ok(())
    }

    /// Ends the run.
    pub fn finish(&self) -> Verdict {
        let summary = self.at_present(|bus| {
            bus.finish();
            bus.summary(&self.source, "no interface")
        });
        self.verdict(summary)
    }

    fn verdict(&self, summary: isocat_serve::Summary) -> Verdict {
        let lasted = Duration::from_nanos(self.clock.now());
        Verdict {
            summary,
            seed: self.seed,
            lateness: self.lateness.get(),
            lasted,
            wire: self.hash.get(),
        }
    }

    fn take_in(&self, at: Time<Host>, port: MainPort, frame: &[u8]) {
        let mut hash = self.hash.get();
        for byte in [&at.count().to_le_bytes()[..], &[port as u8], frame].concat() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(FNV.1);
        }
        self.hash.set(hash);
    }
}

/// Offset basis and prime of FNV-1a with 64 bits, which is the same on every machine and with every
/// compiler.
const FNV: (u64, u64) = (0xcbf2_9ce4_8422_2325, 0x0100_0000_01b3);

/// Advances the segment, in steps that it accepts.
fn advance(bus: &mut bus::Bus, to: Time<Host>) {
    while bus.now() < to {
        let step = to.min(bus.now() + bus::LONGEST_STEP);
        if bus.advance(step).is_err() {
            // The time is beyond the longest time of a segment; the limit of a run is lower.
            return;
        }
    }
}

/// The longest possible time of a run.
pub(crate) fn longest() -> Instant {
    bus::LONGEST.0.max(0) as u64
}

fn host_time(at: Instant) -> Time<Host> {
    START + Nanos(i64::try_from(at).unwrap_or(i64::MAX))
}

fn since_start(at: Time<Host>) -> Instant {
    (at - START).0.max(0) as u64
}

impl fmt::Debug for Bus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bus").field("now", &self.now()).finish_non_exhaustive()
    }
}

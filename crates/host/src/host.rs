//! The complete host for a program: a MainDevice with its application on its own thread, and calls
//! that block the caller but never the cycle.
//!
//! The thread asks for real time ([`RealTime`]), measures how late it wakes, and runs the loop
//! ([`Exchange`]). Calls of the caller reach it through a queue, which it checks in each step
//! without waiting.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel,
};
use std::thread::JoinHandle;
use std::time::Duration;

use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{
    AccessError, Application, Config, Event, MainDevice, RequestId, SdoError, Segment,
};
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatus, AlStatusCode, ObjectAddress};
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::{
    Exchange, Figures, LinkError, RawSocket, RealTime, Recorder, Waiting, Wish, clock, preflight,
};

/// An open interface, before any frame is sent.
///
/// ```no_run
/// use isocat_host::{Application, Config, Cycle, Host, Nanos};
///
/// struct Copy;
///
/// impl Application for Copy {
///     fn cycle(&mut self, cycle: &mut Cycle<'_>) {
///         for mut device in cycle.devices().filter(|device| device.is_fresh()) {
///             device.copy_inputs_to_outputs();
///         }
///     }
/// }
///
/// fn main() -> isocat_host::Result<()> {
///     let interface = std::env::args().nth(1).expect("usage: my-machine INTERFACE");
///     let mut host = Host::open(&interface)?.pinned(3).start(Config::new(Nanos::millis(1)), Copy);
///     let segment = host.until_operation()?;
///     println!("{} SubDevices in operation", segment.devices.len());
///     host.until_signal()?;
///     for (position, status, code) in host.stop()?.fallen {
///         eprintln!("SubDevice {position} was in {status}, {code}");
///     }
///     Ok(())
/// }
/// ```
#[derive(Debug)]
pub struct Host {
    socket: RawSocket,
    wish: Wish,
    recorder: Option<Recorder>,
}

impl Host {
    /// Opens an interface of this thread's network namespace. Needs `cap_net_raw`.
    pub fn open(interface: &str) -> Result<Self> {
        Ok(Self::on(RawSocket::open(interface, None)?))
    }

    /// Uses an interface that is already open.
    pub fn on(socket: RawSocket) -> Self {
        Self { socket, wish: Wish::default(), recorder: None }
    }

    /// Keeps the loop on this CPU.
    pub fn pinned(mut self, cpu: usize) -> Self {
        self.wish.cpu = Some(cpu);
        self
    }

    /// Makes the loop never sleep. It is then punctual on machines that wake late, but needs a CPU
    /// of its own.
    pub fn busy(mut self) -> Self {
        self.wish.busy = true;
        self
    }

    /// Sends every frame to this recorder. [`Ended::recorder`] returns it, to be finished.
    pub fn recording(mut self, recorder: Recorder) -> Self {
        self.recorder = Some(recorder);
        self
    }

    /// Starts the MainDevice on its own thread. The application is called from that thread.
    ///
    /// The config is changed as by [`on_a_socket`], since time stamps of a socket are not exact.
    pub fn start<A: Application + Send + 'static>(
        self,
        config: Config,
        application: A,
    ) -> Running<A> {
        let (wishes, orders) = sync_channel(ORDERS);
        let (told, events) = sync_channel(EVENTS);
        let work = move || run(self, config, application, orders, told);
        let thread = std::thread::spawn(work);
        Running { thread: Some(thread), wishes, events, seen: VecDeque::new(), ended: None }
    }
}

/// A MainDevice that runs on its own thread.
///
/// - Waiting: [`until_operation`](Self::until_operation), [`until_signal`](Self::until_signal),
///   [`event`](Self::event).
/// - Requests, answered while the cycle goes on: [`upload`](Self::upload),
///   [`download`](Self::download), [`read_memory`](Self::read_memory).
/// - A look inside: [`look`](Self::look), [`segment`](Self::segment),
///   [`statistics`](Self::statistics).
/// - The end: [`stop`](Self::stop). If the value is dropped instead, the thread shuts the segment
///   down by itself, and the caller does not wait for that.
///
/// Once the loop has ended, every call returns the error that ended it.
#[derive(Debug)]
pub struct Running<A> {
    thread: Option<JoinHandle<Finish<A>>>,
    wishes: SyncSender<Order<A>>,
    events: Receiver<Event>,
    /// Events that arrived while another one was awaited.
    seen: VecDeque<Event>,
    ended: Option<Finish<A>>,
}

/// The results of a MainDevice that has shut its segment down.
#[derive(Debug)]
pub struct Ended<A> {
    /// The application.
    pub application: A,
    /// The counters of the MainDevice.
    pub statistics: Statistics,
    /// Punctuality of the machine in operation.
    pub figures: Figures,
    /// What the machine granted and refused for real time.
    pub granted: Vec<String>,
    /// What was refused, each with advice.
    pub refused: Vec<String>,
    /// SubDevices that were not in OP when the shutdown began: position, AL status and AL status
    /// code. Empty if all were in OP.
    pub fallen: Vec<(usize, AlStatus, AlStatusCode)>,
    /// The recorder, to be finished.
    pub recorder: Option<Recorder>,
}

/// The result of the thread, and the error if it ended without request.
type Finish<A> = (Ended<A>, Option<Error>);

/// A config for a socket of an ordinary Linux machine. Where it has the defaults for exact time
/// stamps, it gets the values that such a socket needs. The stamps have some 10 us of noise
/// ([`Config::stamp_noise`], at most a twentieth of the cycle). A frame is given up after 20 ms,
/// since a machine that stalls has not lost it.
pub fn on_a_socket(mut config: Config) -> Config {
    let exact = Config::new(config.cycle);
    if config.stamp_noise == exact.stamp_noise {
        config.stamp_noise = STAMP_NOISE.min(Nanos(config.cycle.0 / 20));
    }
    if config.timeouts.frame == exact.timeouts.frame {
        config.timeouts.frame = FRAME_TIMEOUT;
    }
    config
}

/// The errors of a host.
pub enum Error {
    /// An error of the interface.
    Link(LinkError),
    /// An error of the segment, at which the MainDevice gave up.
    MainDevice(isocat_maindevice::Error),
    /// An object access failed; the SubDevice continues.
    Object(SdoError),
    /// A memory access failed; the SubDevice continues.
    Memory(AccessError),
    /// The shutdown did not end within [`STOP_LIMIT`]; SubDevices may still be in OP.
    StillUp,
    /// The thread has ended, and the reason was already returned.
    Over,
    /// Waiting for a signal failed.
    Signal(std::io::Error),
}

/// A result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Longest time of a shutdown.
pub const STOP_LIMIT: Nanos = Nanos::millis(5_000);

impl<A: Application + Send + 'static> Running<A> {
    /// Waits until all SubDevices are in OP. Returns the segment that was found.
    pub fn until_operation(&mut self) -> Result<Segment> {
        loop {
            match self.receive(LOOK)? {
                Some(Event::InOperation { .. }) => return self.segment(),
                Some(event) => self.keep(event),
                None => {}
            }
        }
    }

    /// Waits until SIGINT or SIGTERM arrives, or the loop ends with an error. SubDevices that leave
    /// OP meanwhile do not end it: they give events ([`event`](Self::event)), and [`Ended::fallen`]
    /// names those that did not return. Before this call a signal ends the process as usual, with
    /// the SubDevices in whatever state they are.
    pub fn until_signal(&mut self) -> Result<()> {
        let asked = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, asked.clone()).map_err(Error::Signal)?;
        }
        while !asked.load(Ordering::Relaxed) {
            if let Some(event) = self.receive(LOOK)? {
                self.keep(event);
            }
        }
        Ok(())
    }

    /// The next event; `None` if there is none within this time. Only about the last thousand
    /// events are kept; [`Event::Dropped`] tells how many were dropped.
    pub fn event(&mut self, within: Duration) -> Result<Option<Event>> {
        match self.seen.pop_front() {
            Some(event) => Ok(Some(event)),
            None => self.receive(within),
        }
    }

    /// Reads an object while the cycle goes on.
    pub fn upload(&mut self, position: usize, object: ObjectAddress) -> Result<Vec<u8>> {
        let answer = self.ask(move |main| main.upload(position, object))?;
        match answer {
            Event::Uploaded { result, .. } => result.map_err(Error::Object),
            _ => Err(Error::Over),
        }
    }

    /// Writes an object while the cycle goes on.
    pub fn download(&mut self, position: usize, object: ObjectAddress, data: &[u8]) -> Result<()> {
        let data = data.to_vec();
        let answer = self.ask(move |main| main.download(position, object, &data))?;
        match answer {
            Event::Downloaded { result, .. } => result.map_err(Error::Object),
            _ => Err(Error::Over),
        }
    }

    /// Reads registers or memory while the cycle goes on.
    pub fn read_memory(&mut self, position: usize, address: u16, len: usize) -> Result<Vec<u8>> {
        let answer = self.ask(move |main| main.read_memory(position, address, len))?;
        match answer {
            Event::Read { result, .. } => result.map_err(Error::Memory),
            _ => Err(Error::Over),
        }
    }

    /// Calls `look` with the MainDevice and the application, between two steps of the loop and on
    /// its thread. The time that `look` takes is missing in the cycle.
    pub fn look<R: Send + 'static>(
        &mut self,
        look: impl FnOnce(&MainDevice, &A) -> R + Send + 'static,
    ) -> Result<R> {
        let (answer, answered) = sync_channel(1);
        let order = Order::Look(Box::new(move |main, application| {
            // The caller may have stopped waiting.
            let _ = answer.send(look(main, application));
        }));
        self.order(order)?;
        self.await_answer(&answered)
    }

    /// The segment that was found: topology, identities, mapping, the plan.
    pub fn segment(&mut self) -> Result<Segment> {
        self.look(|main, _| main.segment().clone())
    }

    /// The counters so far.
    pub fn statistics(&mut self) -> Result<Statistics> {
        self.look(|main, _| main.statistics())
    }

    /// Takes the segment to INIT and ends the thread.
    pub fn stop(mut self) -> Result<Ended<A>> {
        // If the thread has already ended, its result tells why.
        let _ = self.order(Order::Stop);
        self.join();
        match self.ended.take() {
            Some((ended, None)) => Ok(ended),
            Some((_, Some(error))) => Err(error),
            None => Err(Error::Over),
        }
    }

    /// Sends a request and waits for the event that answers it.
    fn ask(
        &mut self,
        request: impl FnOnce(&mut MainDevice) -> RequestId + Send + 'static,
    ) -> Result<Event> {
        let (answer, answered) = sync_channel(1);
        self.order(Order::Ask(Box::new(request), answer))?;
        self.await_answer(&answered)
    }

    fn order(&mut self, order: Order<A>) -> Result<()> {
        self.wishes.send(order).map_err(|_| self.why())
    }

    fn await_answer<R>(&mut self, answered: &Receiver<R>) -> Result<R> {
        answered.recv().map_err(|_| self.why())
    }

    fn receive(&mut self, within: Duration) -> Result<Option<Event>> {
        match self.events.recv_timeout(within) {
            Ok(event) => Ok(Some(event)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.why()),
        }
    }

    fn keep(&mut self, event: Event) {
        if self.seen.len() >= EVENTS {
            self.seen.pop_front();
        }
        self.seen.push_back(event);
    }

    /// The reason why the thread has ended; it is returned once.
    fn why(&mut self) -> Error {
        self.join();
        self.ended.as_mut().and_then(|(_, error)| error.take()).unwrap_or(Error::Over)
    }

    fn join(&mut self) {
        if let Some(thread) = self.thread.take() {
            let ended = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            self.ended = Some(ended);
        }
    }
}

/// A request to the MainDevice.
type Request = Box<dyn FnOnce(&mut MainDevice) -> RequestId + Send>;

/// A look at the MainDevice and the application.
type Look<A> = Box<dyn FnOnce(&MainDevice, &A) + Send>;

/// What the caller asks of the loop.
enum Order<A> {
    Ask(Request, SyncSender<Event>),
    Look(Look<A>),
    Stop,
}

/// The function of the thread.
fn run<A: Application>(
    host: Host,
    config: Config,
    application: A,
    orders: Receiver<Order<A>>,
    told: SyncSender<Event>,
) -> Finish<A> {
    let Host { socket, wish, recorder } = host;
    let config = on_a_socket(config);
    let real_time = RealTime::ask(wish);
    let waiting = match wish.busy {
        true => Waiting::Busy,
        false => Waiting::sleep(&preflight::wake_ups(config.cycle), config.cycle),
    };
    let exchange = Exchange::new(config, socket, waiting, recorder, application);
    let mut work = Work {
        exchange,
        orders,
        told,
        untold: 0,
        asked: Vec::new(),
        fallen: Vec::new(),
        stopping: None,
        gone: false,
    };
    let error = work.run();
    let Work { exchange, fallen, .. } = work;
    let (statistics, figures) = (exchange.main().statistics(), *exchange.figures());
    let (application, recorder) = exchange.into_parts();
    let RealTime { granted, refused, .. } = real_time;
    (Ended { application, statistics, figures, granted, refused, fallen, recorder }, error)
}

/// SubDevices that take part but are not in OP.
fn fallen(main: &MainDevice) -> Vec<(usize, AlStatus, AlStatusCode)> {
    let op = AlStatus::new(AlState::Op);
    let devices = main.segment().devices.iter();
    let fallen = devices.filter(|device| device.admitted && device.al_status != op);
    fallen.map(|device| (device.position, device.al_status, device.al_code)).collect()
}

struct Work<A> {
    exchange: Exchange<A>,
    orders: Receiver<Order<A>>,
    told: SyncSender<Event>,
    /// Number of events for which the queue was full.
    untold: u64,
    /// Requests that wait for their events.
    asked: Vec<(RequestId, SyncSender<Event>)>,
    /// SubDevices that were not in OP when the shutdown began.
    fallen: Vec<(usize, AlStatus, AlStatusCode)>,
    /// Deadline of the shutdown.
    stopping: Option<isocat_wire::Time<isocat_wire::time::Host>>,
    /// The caller has dropped its end, so no orders will come.
    gone: bool,
}

impl<A: Application> Work<A> {
    /// Runs the loop until it is stopped or fails. Returns the error.
    fn run(&mut self) -> Option<Error> {
        loop {
            match self.exchange.step(self.exchange.now() + STEP) {
                Ok(true) => {}
                Ok(false) => return Some(Error::Over),
                Err(error) => return Some(Error::Link(error)),
            }
            while let Some(event) = self.exchange.poll_event() {
                match event {
                    Event::Stopped => return None,
                    Event::Failed(error) => return Some(Error::MainDevice(error)),
                    Event::InOperation { .. } => self.exchange.measure(true),
                    _ => {}
                }
                self.tell(event);
            }
            if self.stopping.is_some_and(|limit| clock::now() >= limit) {
                return Some(Error::StillUp);
            }
            self.obey();
        }
    }

    fn tell(&mut self, event: Event) {
        let request = match &event {
            Event::Uploaded { request, .. }
            | Event::Downloaded { request, .. }
            | Event::Read { request, .. } => Some(*request),
            _ => None,
        };
        let asked = request.and_then(|id| self.asked.iter().position(|(asked, _)| *asked == id));
        if let Some(at) = asked {
            // The caller may have stopped waiting.
            let _ = self.asked.swap_remove(at).1.send(event);
            return;
        }
        if self.untold > 0 {
            let dropped = Event::Dropped { count: self.untold };
            if self.told.try_send(dropped).is_ok() {
                self.untold = 0;
            }
        }
        if let Err(TrySendError::Full(_)) = self.told.try_send(event) {
            self.untold += 1;
        }
    }

    /// Handles the orders in the queue.
    fn obey(&mut self) {
        loop {
            let order = match self.orders.try_recv() {
                Ok(order) => order,
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) if self.gone => return,
                Err(TryRecvError::Disconnected) => {
                    self.gone = true;
                    Order::Stop
                }
            };
            match order {
                Order::Ask(request, answer) => {
                    self.asked.push((request(self.exchange.main_mut()), answer));
                }
                Order::Look(look) => look(self.exchange.main(), self.exchange.application()),
                Order::Stop if self.stopping.is_none() => {
                    self.exchange.measure(false);
                    self.fallen = fallen(self.exchange.main());
                    self.exchange.main_mut().stop();
                    self.stopping = Some(clock::now() + STOP_LIMIT);
                }
                Order::Stop => {}
            }
        }
    }
}

impl From<LinkError> for Error {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Link(error) => error.fmt(f),
            Self::MainDevice(error) => error.fmt(f),
            Self::Object(error) => error.fmt(f),
            Self::Memory(error) => error.fmt(f),
            Self::StillUp => f.write_str("the way down did not end; SubDevices may still be in OP"),
            Self::Over => f.write_str("the MainDevice has ended"),
            Self::Signal(error) => write!(f, "waiting for a signal: {error}"),
        }
    }
}

/// Prints the text for users, so that a `main` that returns this error ends with it.
impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for Error {}

/// Between the reading of the clock and the first bit on the wire the frame passes the kernel and
/// the driver. That takes some microseconds, and sometimes far more; measured on a virtual machine
/// with veth.
const STAMP_NOISE: Nanos = Nanos::micros(10);
/// Time from sending a frame to giving it up. A machine that stalls for tens of milliseconds has
/// not lost it.
pub const FRAME_TIMEOUT: Nanos = Nanos::millis(20);
/// Orders that may wait; further callers block.
const ORDERS: usize = 16;
/// Events that may wait for the caller; as many as the MainDevice keeps.
const EVENTS: usize = 1024;
/// How often a waiting caller looks for a signal.
const LOOK: Duration = Duration::from_millis(50);
/// The longest step of the loop: without a cycle, orders are seen within this time.
const STEP: Nanos = Nanos::millis(5);

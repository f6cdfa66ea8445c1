//! Carries frames between one interface, or the two of a ring, and the segment, until it is asked
//! to stop.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use isocat_host::{LinkError, RawSocket, Received, clock};
use isocat_sim::MainPort;
use isocat_wire::time::{Host, Nanos, Time};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::control::Requests;
use super::server::{Answer, Event, Server};

/// The way of waiting for frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Style {
    /// Spin on the socket instead of sleeping. Answers then take a few microseconds, but the
    /// service needs a CPU of its own.
    pub busy: bool,
}

/// Receives what happens in the service.
pub trait Audience {
    /// An event happened.
    fn event(&mut self, server: &Server, event: Event);
    /// A request arrived; the answer is one line.
    fn request(&mut self, server: &mut Server, request: &str) -> Reply;
    /// An interface went down, or is up again with a signal on its cable.
    fn link(&mut self, server: &Server, interface: &str, up: bool);
    /// Called about once a second.
    fn tick(&mut self, server: &Server);
    /// At this port of the MainDevice a frame came in at `at` (`answer` is false), or an answer was
    /// handed to the kernel then.
    fn frame(&mut self, _port: MainPort, _at: Time<Host>, _answer: bool, _bytes: &[u8]) {}
}

/// The answer to a request.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reply {
    /// The answer in one line.
    pub line: String,
    /// Whether the service must end.
    pub stop: bool,
}

/// The interfaces for frames: one for each port of the MainDevice.
pub struct Interfaces {
    /// The interface of the port that every MainDevice has.
    pub primary: RawSocket,
    /// The interface of the other end of a ring.
    pub secondary: Option<RawSocket>,
}

/// Serves until a signal or a request ends it, or an interface does not exist any more. The service
/// waits for an interface that goes down. Frames are lost meanwhile, as with a cable that is
/// pulled; in a ring the device at that port loses its link. `wake` becomes readable when a signal
/// or a request has come.
pub fn run(
    server: &mut Server,
    interfaces: Interfaces,
    wake: &mut UnixStream,
    requests: &Requests,
    style: Style,
    audience: &mut dyn Audience,
) -> Result<(), LinkError> {
    let failed =
        |error: io::Error| LinkError::Os { what: "waiting on", name: "signals".into(), error };
    wake.set_nonblocking(true).map_err(failed)?;
    let mut service = Service::new(interfaces);
    loop {
        let frames = service.turn(server, wake, style, audience)?;
        service.look_at_links(server, audience)?;
        while let Some(event) = server.poll_event() {
            audience.event(server, event);
        }
        if frames && !service.is_tick() {
            continue;
        }
        if service.is_wake(wake, style).map_err(failed)? {
            let mut stop = requests.signalled();
            requests.answer(|request| {
                let reply = audience.request(server, request);
                stop |= reply.stop;
                reply.line
            });
            if stop {
                return Ok(());
            }
        }
        let now = clock::now();
        if now >= service.next_tick {
            service.next_tick = now + Nanos::millis(1_000);
            audience.tick(server);
        }
    }
}

/// An interface, and the frame that came in there.
struct Port {
    socket: RawSocket,
    buffer: [u8; BUFFER],
    /// The frame in the buffer, if one waits there.
    waiting: Option<Received>,
    /// Whether there is a link.
    up: bool,
    /// Whether an error said that there is no link.
    failed: bool,
}

impl Port {
    fn new(socket: RawSocket) -> Self {
        Self { socket, buffer: [0; BUFFER], waiting: None, up: true, failed: false }
    }

    /// Takes the next frame from the interface, if none waits already.
    fn receive(&mut self) -> Result<(), LinkError> {
        if self.waiting.is_none() {
            let received = self.socket.receive(&mut self.buffer);
            self.waiting = self.unless_down(received)?.flatten();
        }
        Ok(())
    }

    fn send(&mut self, frame: &[u8]) -> Result<(), LinkError> {
        let sent = self.socket.send(frame);
        self.unless_down(sent).map(|_| ())
    }

    /// Returns `None`, and notes it, if the interface is down; its link is checked later.
    fn unless_down<T>(&mut self, result: Result<T, LinkError>) -> Result<Option<T>, LinkError> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(LinkError::Down(_)) => {
                self.failed = true;
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }
}

struct Service {
    /// The primary port, and in a ring the secondary one.
    ports: Vec<Port>,
    /// Answers that leave later, with their ports, in the order of their frames.
    held: VecDeque<(Time<Host>, usize, Vec<u8>)>,
    last_frame: Time<Host>,
    /// Time between the last two frames.
    distance: Nanos,
    /// Whether the last frame has been evaluated.
    caught_up: bool,
    next_tick: Time<Host>,
    spins: u32,
    /// While spinning: the instant of the last update of the SubDevices.
    looked: Time<Host>,
    /// The next check of the links.
    next_look: Option<Time<Host>>,
}

const PORTS: [MainPort; 2] = [MainPort::Primary, MainPort::Secondary];
/// Longer than any frame: a frame that fills it was cut.
const BUFFER: usize = 2048;
/// While spinning, SubDevices are kept this far behind the clock. A frame with an earlier stamp
/// would be handled as if it came then.
const BEHIND: Nanos = Nanos::micros(30);
/// While spinning, number of updates of the SubDevices between two frames, and the least step.
const LOOKS: i64 = 4;
const LEAST_STEP: Nanos = Nanos::micros(10);
const MOST_STEP: Nanos = Nanos::millis(1);
/// Number of spins between two checks of anything but the socket.
const SPINS: u32 = 256;
/// Interval of checks of an interface that is down.
const LOOK_AGAIN: Nanos = Nanos::millis(100);
/// Number of answers that may wait; further ones are lost, as on a port.
const MOST_HELD: usize = 8_192;
/// Distances of frames for which it pays to wake in between.
const HIDE: std::ops::Range<Nanos> = Nanos::micros(150)..Nanos::millis(50);

impl Service {
    fn new(interfaces: Interfaces) -> Self {
        let sockets = [Some(interfaces.primary), interfaces.secondary];
        let mut service = Self {
            ports: sockets.into_iter().flatten().map(Port::new).collect(),
            held: VecDeque::new(),
            last_frame: clock::now(),
            distance: Nanos(i64::MAX),
            caught_up: true,
            next_tick: clock::now(),
            spins: 0,
            looked: clock::now(),
            next_look: None,
        };
        service.next_look = service.is_ring().then(clock::now);
        service
    }

    fn is_ring(&self) -> bool {
        self.ports.len() > 1
    }

    /// Waits for a frame and answers it; sends answers that are due.
    fn turn(
        &mut self,
        server: &mut Server,
        wake: &UnixStream,
        style: Style,
        audience: &mut dyn Audience,
    ) -> Result<bool, LinkError> {
        let frames = match style.busy {
            true => self.spin(server, audience)?,
            false => self.sleep(server, wake)? && self.take(server, audience)?,
        };
        self.release(audience)?;
        Ok(frames)
    }

    /// Takes the first frame that came in, if any, and answers it.
    fn take(
        &mut self,
        server: &mut Server,
        audience: &mut dyn Audience,
    ) -> Result<bool, LinkError> {
        for port in &mut self.ports {
            port.receive()?;
        }
        let came = |at: &usize| self.ports[*at].waiting.map(|received| received.at);
        let first = (0..self.ports.len()).filter(|at| came(at).is_some()).min_by_key(came);
        let Some(at) = first else { return Ok(false) };
        let port = &mut self.ports[at];
        let Some(received) = port.waiting.take() else { return Ok(false) };
        if received.len > BUFFER {
            return Ok(true);
        }
        // The answer may leave at the other port, so it must not stay in this one's buffer.
        let mut buffer = port.buffer;
        let frame = &mut buffer[..received.len];
        audience.frame(PORTS[at], received.at, false, frame);
        match server.frame_at(PORTS[at], received.at, frame) {
            Answer::Back { port, hold: None, .. } => {
                if let Some(out) = self.ports.get_mut(port as usize) {
                    out.send(frame)?;
                    audience.frame(port, clock::now(), true, frame);
                }
            }
            Answer::Back { port, hold: Some(due), .. } => self.hold(due, port, frame.to_vec()),
            Answer::Lost => {}
        }
        while let Some((port, due, copy)) = server.take_copy() {
            self.hold(due, port, copy);
        }
        server.after(frame);
        self.distance = received.at - self.last_frame;
        self.last_frame = received.at;
        self.caught_up = false;
        Ok(true)
    }

    fn hold(&mut self, due: Time<Host>, port: MainPort, frame: Vec<u8>) {
        let port = port as usize;
        if self.held.len() < MOST_HELD && port < self.ports.len() {
            let place = self.held.partition_point(|(other, ..)| *other <= due);
            self.held.insert(place, (due, port, frame));
        }
    }

    /// Checks the links of interfaces that failed, and in a ring from time to time of all.
    fn look_at_links(
        &mut self,
        server: &mut Server,
        audience: &mut dyn Audience,
    ) -> Result<(), LinkError> {
        let fails = self.ports.iter().any(|port| port.failed && port.up);
        let now = clock::now();
        if !fails && self.next_look.is_none_or(|look| look > now) {
            return Ok(());
        }
        let is_ring = self.is_ring();
        for (at, port) in self.ports.iter_mut().enumerate() {
            if !port.socket.is_there() {
                return Err(LinkError::Down(port.socket.interface().to_owned()));
            }
            let failed = std::mem::take(&mut port.failed);
            let up = match port.up && !failed && !is_ring {
                true => true,
                false => port.socket.has_carrier().unwrap_or(port.up && !failed),
            };
            if up != port.up {
                port.up = up;
                if is_ring {
                    server.link(now, PORTS[at], up);
                }
                audience.link(server, port.socket.interface(), up);
            }
        }
        let looks = is_ring || self.ports.iter().any(|port| !port.up);
        self.next_look = looks.then_some(now + LOOK_AGAIN);
        Ok(())
    }

    /// Sleeps until something arrives or the SubDevices need an update. Returns whether it is a
    /// frame.
    fn sleep(&mut self, server: &mut Server, wake: &UnixStream) -> Result<bool, LinkError> {
        if self.ports.iter().any(|port| port.waiting.is_some()) {
            return Ok(true);
        }
        let now = clock::now();
        // The SubDevices' work is done in the pause before the next frame, or else with that frame.
        // In the pause it does not delay the answer.
        let hide = (!self.caught_up && HIDE.contains(&self.distance))
            .then(|| self.last_frame + Nanos(self.distance.0 / 4 * 3));
        let held = self.held.front().map(|(due, ..)| *due);
        let until = [server.next_timeout(now), hide, held, self.next_look];
        let until = until.into_iter().flatten().min();
        // A time in the past means no wait.
        let timeout = until.map(|until| Duration::from_nanos((until - now).0.max(0) as u64));
        let timeout = timeout.and_then(|timeout| Timespec::try_from(timeout).ok());
        let primary = &self.ports[0].socket;
        // Without a ring the one interface is listed twice.
        let secondary = self.ports.get(1).map_or(primary, |port| &port.socket);
        let [first, second] = [primary, secondary].map(|socket| PollFd::new(socket, PollFlags::IN));
        let mut fds = [first, second, PollFd::new(wake, PollFlags::IN)];
        match poll(&mut fds, timeout.as_ref()) {
            Ok(0) => {
                let now = clock::now();
                if hide.is_some_and(|hide| hide <= now) {
                    self.caught_up = true;
                    server.catch_up(now + -BEHIND);
                } else {
                    server.idle(now);
                }
                Ok(false)
            }
            Ok(_) => Ok(fds[..2].iter().any(|fd| !fd.revents().is_empty())),
            Err(Errno::INTR) => Ok(false),
            Err(error) => {
                let name = primary.interface().to_owned();
                Err(LinkError::Os { what: "waiting on", name, error: error.into() })
            }
        }
    }

    /// One iteration of spinning.
    fn spin(
        &mut self,
        server: &mut Server,
        audience: &mut dyn Audience,
    ) -> Result<bool, LinkError> {
        self.spins += 1;
        if self.take(server, audience)? {
            return Ok(true);
        }
        let now = clock::now();
        if now - self.last_frame < Nanos::millis(1_000) {
            // Only a few times between two frames, since a frame that arrives meanwhile must wait.
            let step = Nanos(self.distance.0 / LOOKS).clamp(LEAST_STEP, MOST_STEP);
            if now - self.looked >= step {
                self.looked = now;
                server.catch_up(now + -BEHIND);
            }
        } else if self.spins >= SPINS {
            server.idle(now);
        }
        Ok(self.spins < SPINS)
    }

    /// Sends the answers that are due.
    fn release(&mut self, audience: &mut dyn Audience) -> Result<(), LinkError> {
        while let Some((due, ..)) = self.held.front() {
            if *due > clock::now() {
                break;
            }
            if let Some((_, port, frame)) = self.held.pop_front() {
                self.ports[port].send(&frame)?;
                audience.frame(PORTS[port], clock::now(), true, &frame);
            }
        }
        Ok(())
    }

    /// Whether the work of once a second is due, however many frames come.
    fn is_tick(&self) -> bool {
        self.last_frame >= self.next_tick
    }

    /// Whether the service was woken.
    fn is_wake(&mut self, wake: &mut UnixStream, style: Style) -> io::Result<bool> {
        if style.busy {
            self.spins = 0;
        }
        let mut bytes = [0; 64];
        match wake.read(&mut bytes) {
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
            Err(error) => Err(error),
        }
    }
}

/// Longest time for the answer to a request.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

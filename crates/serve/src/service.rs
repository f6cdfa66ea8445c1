//! Frames from the interface to the segment and back, until somebody ends it.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use isocat_host::{LinkError, RawSocket, clock};
use isocat_wire::time::{Host, Nanos, Time};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::control::Requests;
use super::server::{Answer, Event, Server};

/// How frames are waited for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Style {
    /// Spin on the socket instead of sleeping: answers in a few microseconds, for a processor of its own.
    pub busy: bool,
}

/// Who is told what happens.
pub trait Audience {
    /// Something happened.
    fn event(&mut self, server: &Server, event: Event);
    /// A request came in; the answer is one line.
    fn request(&mut self, server: &mut Server, request: &str) -> Reply;
    /// The interface went down, or is up again with a signal on its cable.
    fn link(&mut self, server: &Server, up: bool);
    /// Called about once a second.
    fn tick(&mut self, server: &Server);
}

/// The answer to a request.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reply {
    /// One line.
    pub line: String,
    /// The service is to end.
    pub stop: bool,
}

/// Serves until a signal or a request ends it, or the interface has gone. One that goes down is waited for: what
/// comes meanwhile is lost, as with a cable that is pulled. `wake` becomes readable when a signal or a request has
/// come.
pub fn run(
    server: &mut Server,
    mut socket: RawSocket,
    wake: &mut UnixStream,
    requests: &Requests,
    style: Style,
    audience: &mut dyn Audience,
) -> Result<(), LinkError> {
    let failed =
        |error: io::Error| LinkError::Os { what: "waiting on", name: "signals".into(), error };
    wake.set_nonblocking(true).map_err(failed)?;
    let mut service = Service {
        buffer: [0; BUFFER],
        held: VecDeque::new(),
        last_frame: clock::now(),
        distance: Nanos(i64::MAX),
        caught_up: true,
        next_tick: clock::now(),
        spins: 0,
        looked: clock::now(),
        down: None,
    };
    loop {
        let turned = service.turn(server, &mut socket, wake, style);
        let frames = match turned {
            Ok(frames) => frames,
            Err(LinkError::Down(_)) if socket.is_there() => {
                if service.down.is_none() {
                    audience.link(server, false);
                }
                service.down = Some(clock::now() + LOOK_AGAIN);
                false
            }
            Err(error) => return Err(error),
        };
        if service.down.is_some_and(|look| look <= clock::now()) {
            service.down = Some(clock::now() + LOOK_AGAIN);
            if !socket.is_there() {
                return Err(LinkError::Down(socket.interface().to_owned()));
            }
            if socket.has_carrier() == Some(true) {
                service.down = None;
                audience.link(server, true);
            }
        }
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

struct Service {
    buffer: [u8; BUFFER],
    /// Answers that are to leave later, in the order of their frames.
    held: VecDeque<(Time<Host>, Vec<u8>)>,
    last_frame: Time<Host>,
    /// From the last frame but one to the last.
    distance: Nanos,
    /// What followed from the last frame has been worked off.
    caught_up: bool,
    next_tick: Time<Host>,
    spins: u32,
    /// While spinning: when the SubDevices' own work was done last.
    looked: Time<Host>,
    /// While the interface is down: when to look at it again.
    down: Option<Time<Host>>,
}

/// Longer than any frame: what fills it was cut.
const BUFFER: usize = 2048;
/// While spinning, SubDevices are kept this far behind the clock: a frame with a stamp earlier than that would be
/// taken as of then.
const BEHIND: Nanos = Nanos::micros(30);
/// While spinning, SubDevices are looked at so often between two frames, and in steps of this size.
const LOOKS: i64 = 4;
const LEAST_STEP: Nanos = Nanos::micros(10);
const MOST_STEP: Nanos = Nanos::millis(1);
/// Spins between two looks at anything but the socket.
const SPINS: u32 = 256;
/// From one look at an interface that is down to the next.
const LOOK_AGAIN: Nanos = Nanos::millis(100);
/// Answers that may wait: what a flood brings beyond them is lost, as it would be on a port.
const MOST_HELD: usize = 8_192;
/// Distances of frames for which it pays to wake between them.
const HIDE: std::ops::Range<Nanos> = Nanos::micros(150)..Nanos::millis(50);

impl Service {
    /// Waits for a frame, and answers it; sends what is due.
    fn turn(
        &mut self,
        server: &mut Server,
        socket: &mut RawSocket,
        wake: &UnixStream,
        style: Style,
    ) -> Result<bool, LinkError> {
        let frames = match style.busy {
            true => self.spin(server, socket)?,
            false => self.sleep(server, socket, wake)? && self.take(server, socket)?,
        };
        self.release(server, socket)?;
        Ok(frames)
    }

    /// Takes a frame if one is there, and answers it.
    fn take(&mut self, server: &mut Server, socket: &mut RawSocket) -> Result<bool, LinkError> {
        let Some(received) = socket.receive(&mut self.buffer)? else { return Ok(false) };
        let Some(frame) = self.buffer.get_mut(..received.len) else { return Ok(true) };
        match server.frame(received.at, frame) {
            Answer::Back { hold: None, .. } => socket.send(frame)?,
            Answer::Back { hold: Some(due), .. } if self.held.len() < MOST_HELD => {
                let place = self.held.partition_point(|(other, _)| *other <= due);
                self.held.insert(place, (due, frame.to_vec()));
            }
            Answer::Back { .. } | Answer::Lost => {}
        }
        while let Some((due, copy)) = server.take_copy() {
            let place = self.held.partition_point(|(other, _)| *other <= due);
            if self.held.len() < MOST_HELD {
                self.held.insert(place, (due, copy));
            }
        }
        server.after(frame);
        self.distance = received.at - self.last_frame;
        self.last_frame = received.at;
        self.caught_up = false;
        Ok(true)
    }

    /// Sleeps until something comes, or the SubDevices want to be looked at; tells whether it is a frame.
    fn sleep(
        &mut self,
        server: &mut Server,
        socket: &RawSocket,
        wake: &UnixStream,
    ) -> Result<bool, LinkError> {
        let now = clock::now();
        // The SubDevices' own work waits for the next frame, or is done in the pause before it: then the
        // answer to that frame does not wait for it.
        let hide = (!self.caught_up && HIDE.contains(&self.distance))
            .then(|| self.last_frame + Nanos(self.distance.0 / 4 * 3));
        let held = self.held.front().map(|(due, _)| *due);
        let until = [server.next_timeout(now), hide, held, self.down].into_iter().flatten().min();
        // What is over already waits for nothing.
        let timeout = until.map(|until| Duration::from_nanos((until - now).0.max(0) as u64));
        let timeout = timeout.and_then(|timeout| Timespec::try_from(timeout).ok());
        let mut fds = [PollFd::new(socket, PollFlags::IN), PollFd::new(wake, PollFlags::IN)];
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
            Ok(_) => Ok(!fds[0].revents().is_empty()),
            Err(Errno::INTR) => Ok(false),
            Err(error) => {
                let name = socket.interface().to_owned();
                Err(LinkError::Os { what: "waiting on", name, error: error.into() })
            }
        }
    }

    /// One turn of spinning.
    fn spin(&mut self, server: &mut Server, socket: &mut RawSocket) -> Result<bool, LinkError> {
        self.spins += 1;
        if self.take(server, socket)? {
            return Ok(true);
        }
        let now = clock::now();
        if now - self.last_frame < Nanos::millis(1_000) {
            // A few times between two frames, not at each turn: a frame that comes meanwhile waits.
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

    /// Sends what has waited long enough.
    fn release(&mut self, _server: &Server, socket: &RawSocket) -> Result<(), LinkError> {
        while let Some((due, _)) = self.held.front() {
            if *due > clock::now() {
                break;
            }
            if let Some((_, frame)) = self.held.pop_front() {
                socket.send(&frame)?;
            }
        }
        Ok(())
    }

    /// Whether it is time for what happens once a second, however many frames come.
    fn is_tick(&self) -> bool {
        self.last_frame >= self.next_tick
    }

    /// Whether somebody woke the service.
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

/// How long an answer to a request may take.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

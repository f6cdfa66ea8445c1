//! The wire as the conformance suite needs it: send frames and get them back or not, know the time, wait.

#[cfg(target_os = "linux")]
use std::sync::Arc;
#[cfg(target_os = "linux")]
use std::sync::atomic::{AtomicBool, Ordering};

use isocat_segment::Scenario;
use isocat_sim::observation::Observed;
use isocat_sim::{Lost, Served};
use isocat_wire::time::{Host, Nanos, Time, True};

/// What the suite sends its frames through.
pub trait Wire {
    /// The host's clock.
    fn now(&self) -> Time<Host>;

    /// Lets time pass until then; nothing if it is over.
    fn wait_until(&mut self, at: Time<Host>);

    /// Sends frames one right behind the other, and puts those that come back in their places. Tells which
    /// did. An error is one of this machine, not of the segment.
    fn exchange(&mut self, frames: &mut [Vec<u8>]) -> Result<Vec<bool>, String>;

    /// Everything as after power-on, where that is possible.
    fn restart(&mut self) {}

    /// What happened in the SubDevice at `position` since the last call, in true time; `None` where nobody can
    /// see it.
    fn seen(&mut self, position: usize) -> Option<Vec<Seen>>;

    /// How much later than asked for a frame may leave; 0 in virtual time, where nothing is late or lost.
    fn lateness(&self) -> Nanos;

    /// When the last frame had left, at the latest; `None` where frames leave at the very instant.
    fn last_left(&self) -> Option<Time<Host>> {
        None
    }

    /// Whether the user wants the end: no further frame is worth sending.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// Something that happened in a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Seen {
    /// When.
    pub at: Time<True>,
    /// What.
    pub event: Observed,
}

/// A segment in virtual time: nobody waits, and every frame leaves at the very instant.
pub struct VirtualWire {
    scenario: Scenario,
    served: Served,
    now: Time<Host>,
    seen: Vec<(usize, Seen)>,
}

impl VirtualWire {
    /// The segment of a scenario, just switched on.
    pub fn new(scenario: Scenario) -> Self {
        let served = switch_on(&scenario);
        Self { scenario, served, now: Time::ZERO, seen: Vec::new() }
    }

    fn settle(&mut self) {
        let Self { served, seen, .. } = self;
        served.settle(&mut |segment, observation, _| {
            let device = &segment.devices()[observation.device];
            let at = device.oscillator().when(observation.device_at);
            // Who never asks must not gather them for ever.
            if seen.len() == MOST_SEEN {
                seen.drain(..MOST_SEEN / 2);
            }
            seen.push((observation.device, Seen { at, event: observation.event }));
        });
    }
}

fn switch_on(scenario: &Scenario) -> Served {
    let setup = scenario.run().setup;
    let mut served = Served::new(setup.segment, setup.seed, Time::ZERO);
    served.show_everything();
    served
}

impl Wire for VirtualWire {
    fn now(&self) -> Time<Host> {
        self.now
    }

    fn wait_until(&mut self, at: Time<Host>) {
        self.now = self.now.max(at);
        self.served.advance(self.now);
        self.settle();
    }

    fn exchange(&mut self, frames: &mut [Vec<u8>]) -> Result<Vec<bool>, String> {
        let mut back = Vec::with_capacity(frames.len());
        for frame in frames {
            let passage = self.served.frame(self.now, frame);
            let returned: Result<_, Lost> = passage.fate;
            let end = returned.map_or(passage.start, |returned| returned.last_bit);
            let end = self.served.host_time(end) + Nanos(1);
            back.push((returned.is_ok_and(|returned| returned.good), end));
        }
        for (_, end) in &back {
            self.now = self.now.max(*end);
        }
        self.settle();
        Ok(back.into_iter().map(|(good, _)| good).collect())
    }

    fn restart(&mut self) {
        self.served = switch_on(&self.scenario);
        self.now = Time::ZERO;
        self.seen.clear();
    }

    fn seen(&mut self, position: usize) -> Option<Vec<Seen>> {
        self.settle();
        let seen = std::mem::take(&mut self.seen);
        Some(seen.into_iter().filter(|(at, _)| *at == position).map(|(_, seen)| seen).collect())
    }

    fn lateness(&self) -> Nanos {
        Nanos::ZERO
    }
}

/// Observations that are kept until somebody asks for them.
const MOST_SEEN: usize = 1 << 16;

/// A real interface in host time.
#[cfg(target_os = "linux")]
pub struct RawWire {
    socket: isocat_host::RawSocket,
    /// When the last frame had left.
    left: Option<Time<Host>>,
    stop: Arc<AtomicBool>,
    /// Keeps processors awake as long as it lives.
    _real_time: isocat_host::RealTime,
}

#[cfg(target_os = "linux")]
impl RawWire {
    /// The suite has this interface for itself. The calling thread becomes a real-time one, as far as it may.
    pub fn new(socket: isocat_host::RawSocket) -> Self {
        let _real_time = isocat_host::RealTime::ask(isocat_host::Wish::default());
        Self { socket, left: None, stop: Arc::default(), _real_time }
    }

    /// The same, but the suite ends when `stop` is set.
    pub fn until(self, stop: Arc<AtomicBool>) -> Self {
        Self { stop, ..self }
    }
}

#[cfg(target_os = "linux")]
impl Wire for RawWire {
    fn now(&self) -> Time<Host> {
        isocat_host::clock::now()
    }

    fn wait_until(&mut self, at: Time<Host>) {
        // Sleep most of it, spin on the clock for the rest: a wake-up may come late.
        while at - self.now() > SPIN {
            isocat_host::clock::sleep_until(at + -SPIN);
        }
        while self.now() < at {
            std::hint::spin_loop();
        }
    }

    fn exchange(&mut self, frames: &mut [Vec<u8>]) -> Result<Vec<bool>, String> {
        let mut back = vec![false; frames.len()];
        let mut buffer = [0; isocat_wire::frame::MAX_LEN];
        // What came too late for its own exchange is not taken for this one's.
        while self.socket.receive(&mut buffer).map_err(|e| e.to_string())?.is_some() {}
        for frame in &*frames {
            self.socket.send(frame).map_err(|e| e.to_string())?;
        }
        self.left = Some(self.now());
        let end = self.now() + PATIENCE;
        while back.contains(&false) && self.now() < end {
            let Some(received) = self.socket.receive(&mut buffer).map_err(|e| e.to_string())?
            else {
                self.socket.wait(Some(end)).map_err(|e| e.to_string())?;
                continue;
            };
            let Some(bytes) = buffer.get(..received.len) else { continue };
            let same = |frame: &[u8]| frame.get(INDEX) == bytes.get(INDEX);
            let place = (0..frames.len()).find(|&at| !back[at] && same(&frames[at]));
            if let Some(at) = place
                && bytes.len() >= frames[at].len()
            {
                let len = frames[at].len();
                frames[at].copy_from_slice(&bytes[..len]);
                back[at] = true;
            }
        }
        Ok(back)
    }

    fn seen(&mut self, _position: usize) -> Option<Vec<Seen>> {
        None
    }

    fn lateness(&self) -> Nanos {
        Nanos::micros(50)
    }

    fn last_left(&self) -> Option<Time<Host>> {
        self.left
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Index byte of the first datagram: behind the Ethernet and EtherCAT headers and the command.
#[cfg(target_os = "linux")]
const INDEX: usize = isocat_wire::frame::ETHERNET_HEADER_LEN + 2 + 1;
/// From sending a frame to giving it up.
#[cfg(target_os = "linux")]
const PATIENCE: Nanos = Nanos::millis(20);
/// How long before an instant the clock is watched.
#[cfg(target_os = "linux")]
const SPIN: Nanos = Nanos::micros(100);

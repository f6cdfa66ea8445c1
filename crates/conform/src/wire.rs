//! The wire as the conformance suite needs it: it sends frames and returns those that come back,
//! tells the time, and waits.

#[cfg(target_os = "linux")]
use std::sync::Arc;
#[cfg(target_os = "linux")]
use std::sync::atomic::{AtomicBool, Ordering};

use isocat_segment::Scenario;
use isocat_sim::observation::Observed;
use isocat_sim::{Lost, Served, Timeline};
use isocat_wire::time::{Host, Nanos, Time, True};

/// The connection that the suite sends its frames through.
pub trait Wire {
    /// The host's clock.
    fn now(&self) -> Time<Host>;

    /// Waits until `at`; returns at once if it has passed.
    fn wait_until(&mut self, at: Time<Host>);

    /// Sends frames, each right after the one before, and replaces those that come back. Returns
    /// which ones did. `Err`: this machine failed, not the segment.
    fn exchange(&mut self, frames: &mut [Vec<u8>]) -> Result<Vec<bool>, String>;

    /// Restores the state after power-on, if that is possible.
    fn restart(&mut self) {}

    /// Events in the SubDevice at `position` since the last call, in true time; `None`: they can't
    /// be observed.
    fn seen(&mut self, position: usize) -> Option<Vec<Seen>>;

    /// How late a frame may leave; 0 in virtual time, where no frame is late or lost.
    fn lateness(&self) -> Nanos;

    /// An upper bound of when the last frame had left; `None`: frames leave exactly at their
    /// instants.
    fn last_left(&self) -> Option<Time<Host>> {
        None
    }

    /// Whether the user stopped the suite: no further frame is worth sending.
    fn is_stopped(&self) -> bool {
        false
    }
}

/// An event in a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Seen {
    /// When it happened.
    pub at: Time<True>,
    /// What happened.
    pub event: Observed,
}

/// A segment in virtual time: nothing waits, and every frame leaves exactly at its instant.
pub struct VirtualWire {
    scenario: Scenario,
    served: Served,
    now: Time<Host>,
    seen: Vec<(usize, Seen)>,
}

impl VirtualWire {
    /// The segment of a scenario, right after power-on.
    pub fn new(scenario: Scenario) -> Self {
        let served = switch_on(&scenario);
        Self { scenario, served, now: Time::ZERO, seen: Vec::new() }
    }

    /// The same with the faults of the file that begin at an instant, and not in operation. A
    /// restart is without them.
    pub fn with_faults(scenario: Scenario) -> Self {
        let setup = scenario.run().setup;
        let faults = Timeline::new(setup.faults, setup.seed).with_spares(setup.spares);
        let new = Self::new(scenario);
        Self { served: new.served.with_faults(faults), ..new }
    }

    fn settle(&mut self) {
        let Self { served, seen, .. } = self;
        served.settle(&mut |segment, observation, _| {
            let device = &segment.devices()[observation.device];
            let at = device.oscillator().when(observation.device_at);
            // Bounds the memory if the events are never asked for.
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

/// Observations that are kept until they are asked for.
const MOST_SEEN: usize = 1 << 16;

/// A real interface in host time.
#[cfg(target_os = "linux")]
pub struct RawWire {
    socket: isocat_host::RawSocket,
    /// An upper bound of when the last frame had left.
    left: Option<Time<Host>>,
    stop: Arc<AtomicBool>,
    /// Keeps processors awake as long as it exists.
    _real_time: isocat_host::RealTime,
}

#[cfg(target_os = "linux")]
impl RawWire {
    /// Takes an interface, which nothing else may use. Makes the calling thread a real-time one, as
    /// far as permitted.
    pub fn new(socket: isocat_host::RawSocket) -> Self {
        let _real_time = isocat_host::RealTime::ask(isocat_host::Wish::default());
        Self { socket, left: None, stop: Arc::default(), _real_time }
    }

    /// Ends the suite when `stop` is set.
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
        // Sleeps for most of the time and spins for the rest, because a wake-up may be late.
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
        // Drops frames that came too late for their own exchange.
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

/// Offset of the index of the first datagram: after the Ethernet and EtherCAT headers and the
/// command.
#[cfg(target_os = "linux")]
const INDEX: usize = isocat_wire::frame::ETHERNET_HEADER_LEN + 2 + 1;
/// Time after which a frame that was sent counts as lost.
#[cfg(target_os = "linux")]
const PATIENCE: Nanos = Nanos::millis(20);
/// How long before an instant the thread spins on the clock.
#[cfg(target_os = "linux")]
const SPIN: Nanos = Nanos::micros(100);

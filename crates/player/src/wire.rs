//! The wire of the player's frames, with its clock: the virtual bus here, a real interface in
//! `real`.

use isocat_serve::{Answer, Bus};
use isocat_sim::MainPort;
use isocat_sim::random::Stream;
use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Time};

use crate::failure::Kind;

/// A buffer for one frame.
pub(crate) type Buffer = [u8; frame::MAX_LEN];

/// A connection to the segment, with a clock.
pub(crate) trait Wire {
    /// The present.
    fn now(&self) -> Time<Host>;

    /// Waits until `until`.
    fn wait(&mut self, until: Time<Host>) -> Result<(), Kind>;

    /// Waits for the beginning of a cycle; returns its real beginning, because hosts wake up late.
    fn wake_up(&mut self, due: Time<Host>) -> Result<Time<Host>, Kind>;

    /// Sends a frame at `at`, or as soon as possible afterwards.
    fn send(&mut self, at: Time<Host>, frame: &[u8]) -> Result<Sent, Kind>;

    /// Waits until `until` for the next frame that comes back; returns its length. `None`: none
    /// came.
    fn receive(&mut self, until: Time<Host>, buffer: &mut Buffer) -> Result<Option<usize>, Kind>;

    /// The properties of this wire.
    fn traits(&self) -> Traits;

    /// Begins or ends the measurement of the host's lateness.
    fn measure(&mut self, _on: bool) {}
}

/// A frame that was sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Sent {
    /// When its first bit left, as far as the host knows.
    pub at: Time<Host>,
    /// When its last bit will be back, if the wire knows that.
    pub back: Option<Time<Host>>,
}

/// The properties of a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Traits {
    /// How long to wait for a frame before it is lost.
    pub patience: Nanos,
    /// How much too early time stamps usually are; 0: they are exact.
    pub stamp_noise: Nanos,
}

/// The virtual bus, in virtual time.
pub(crate) struct VirtualWire<'t> {
    pub bus: Bus,
    /// Receives each frame that leaves.
    tap: &'t mut dyn FnMut(Time<Host>, &[u8]),
    seed: u64,
    /// Largest lateness of the host's wake-ups.
    jitter: Nanos,
    wake_ups: u64,
}

impl<'t> VirtualWire<'t> {
    pub fn new(
        bus: Bus,
        seed: u64,
        jitter: Nanos,
        tap: &'t mut dyn FnMut(Time<Host>, &[u8]),
    ) -> Self {
        Self { bus, tap, seed, jitter, wake_ups: 0 }
    }
}

impl Wire for VirtualWire<'_> {
    fn now(&self) -> Time<Host> {
        self.bus.now()
    }

    fn wait(&mut self, until: Time<Host>) -> Result<(), Kind> {
        if until > self.now() {
            self.bus.advance(until)?;
        }
        Ok(())
    }

    fn wake_up(&mut self, due: Time<Host>) -> Result<Time<Host>, Kind> {
        self.wake_ups += 1;
        let worst = u64::try_from(self.jitter.0).unwrap_or(0);
        let late = match worst {
            0 => 0,
            worst => Stream::new(self.seed, "wake-up of the player", self.wake_ups).lateness(worst),
        };
        Ok((due + Nanos(late as i64)).max(self.now()))
    }

    fn send(&mut self, at: Time<Host>, frame: &[u8]) -> Result<Sent, Kind> {
        let at = at.max(self.now());
        (self.tap)(at, frame);
        let back = match self.bus.send(MainPort::Primary, at, frame)? {
            Answer::Back { last_bit, .. } => Some(last_bit),
            Answer::Lost => None,
        };
        Ok(Sent { at, back })
    }

    fn receive(&mut self, until: Time<Host>, buffer: &mut Buffer) -> Result<Option<usize>, Kind> {
        match self.bus.next_arrival().filter(|at| *at <= until) {
            None => {
                self.wait(until)?;
                return Ok(None);
            }
            Some(at) => self.wait(at)?,
        }
        Ok(self.bus.receive().map(|arrival| {
            let length = arrival.frame.len().min(buffer.len());
            buffer[..length].copy_from_slice(&arrival.frame[..length]);
            length
        }))
    }

    fn traits(&self) -> Traits {
        Traits { patience: Nanos::millis(1), stamp_noise: Nanos::ZERO }
    }
}

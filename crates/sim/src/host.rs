//! The machine that the MainDevice runs on: its clock, its wake-ups, its network port.

use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};

use crate::oscillator::Oscillator;
use crate::random::Stream;

/// What is imperfect about a host.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostModel {
    /// Deviation of its clock from true time, ppb.
    pub clock_ppb: i64,
    /// Worst lateness of a timer's wake-up, ns; see [`Stream::lateness`] for the distribution.
    pub jitter: Nanos,
    /// From the program's decision to send to the first bit on the wire, and from the last bit of an
    /// answer to the program: software and network controller, constant.
    pub latency: Nanos,
    /// Wake-ups are either in time or as late as they can be, by the toss of a coin: the worst case that a plan
    /// must stand, every other cycle. Default: as a real machine.
    pub extremes: bool,
}

impl Default for HostModel {
    /// A PC with a tuned real-time kernel: 20 us wake-up lateness at worst, 2 us each way.
    fn default() -> Self {
        Self { clock_ppb: 0, jitter: Nanos(20_000), latency: Nanos(2_000), extremes: false }
    }
}

/// A host in true time.
#[derive(Clone, Debug)]
pub struct HostMachine {
    clock: Oscillator,
    jitter: Nanos,
    latency: Picos,
    extremes: bool,
    wake_ups: Stream,
    /// When the port has sent the last frame and the gap behind it.
    port_free: Time<True>,
}

impl HostMachine {
    /// A host whose clock counts from true time zero.
    pub fn new(model: HostModel, seed: u64) -> Self {
        Self {
            clock: Oscillator::new(model.clock_ppb),
            jitter: model.jitter,
            latency: model.latency.into(),
            extremes: model.extremes,
            wake_ups: Stream::new(seed, "host wake-up", 0),
            port_free: Time::ZERO,
        }
    }

    /// The host's clock.
    pub fn now(&self, at: Time<True>) -> Time<Host> {
        self.clock.read(at)
    }

    /// When a timer set to `wanted` really wakes the program.
    pub fn wake_up(&mut self, wanted: Time<Host>) -> Time<True> {
        let worst = self.jitter.0.max(0) as u64;
        let late = match self.extremes {
            true => worst * self.wake_ups.up_to(1),
            false => self.wake_ups.lateness(worst),
        };
        self.clock.when(wanted + Nanos(late as i64))
    }

    /// When the first bit of a frame of `len` bytes leaves that the program sends at `at`: behind the
    /// latency, and behind the frames before it.
    pub fn send(&mut self, at: Time<True>, len: usize) -> Time<True> {
        let start = (at + self.latency).max(self.port_free);
        let on_wire = len.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
        self.port_free = start + Picos(on_wire as i64 * BYTE_PS);
        start
    }

    /// When the program has an answer whose last bit arrived at `at`.
    pub fn receive(&self, at: Time<True>) -> Time<True> {
        at + self.latency
    }
}

const BYTE_PS: i64 = frame::BYTE_TIME_NS as i64 * 1000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wake_ups_are_late_but_never_early() {
        let mut host = HostMachine::new(HostModel { clock_ppb: 12_000, ..Default::default() }, 1);
        for ms in 1..1000 {
            let wanted = Time::new(ms * 1_000_000);
            let woken = host.wake_up(wanted);
            let late = host.clock.read::<Host>(woken) - wanted;
            assert!((0..=20_000).contains(&late.0), "{late}");
        }
    }

    #[test]
    fn extreme_wake_ups_are_in_time_or_as_late_as_can_be() {
        let mut host = HostMachine::new(HostModel { extremes: true, ..Default::default() }, 1);
        let mut late = |ms: u64| {
            let wanted = Time::new(ms * 1_000_000);
            let woken = host.wake_up(wanted);
            (host.clock.read::<Host>(woken) - wanted).0
        };
        let mut late: Vec<i64> = (1..1000).map(&mut late).collect();
        late.sort_unstable();
        late.dedup();
        assert_eq!(late, [0, 20_000]);
    }

    #[test]
    fn frames_queue_behind_each_other() {
        let mut host = HostMachine::new(HostModel::default(), 1);
        let first = host.send(Time::ZERO, 60);
        assert_eq!(first, Time::new(2_000_000));
        // 60 bytes, FCS, preamble and gap: 84 bytes of 80 ns.
        assert_eq!(host.send(Time::ZERO, 60), first + Picos(84 * 80_000));
        assert_eq!(host.send(Time::new(1_000_000_000), 60), Time::new(1_002_000_000));
    }
}

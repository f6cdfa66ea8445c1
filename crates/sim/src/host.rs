//! The host on which the MainDevice runs: its clock, its wake-ups, its network port.

use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};

use crate::fault::{LateHost, MILLION};
use crate::oscillator::{Bend, ClockModel, Oscillator, Step};
use crate::random::Stream;
use crate::wiring::MainPort;

/// The imperfections of a host.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct HostModel {
    /// Deviation of its clock from true time, ppb.
    pub clock_ppb: i64,
    /// Worst lateness of a timer's wake-up, ns; see [`Stream::lateness`] for the distribution.
    pub jitter: Nanos,
    /// Constant latency of software and network controller: from the program's decision to send to
    /// the first bit on the wire, and from the last bit of an answer to the program.
    pub latency: Nanos,
    /// Whether each wake-up is either in time or as late as possible, at random with equal
    /// probability. This is the worst case for a plan, in every other cycle on average. Default:
    /// lateness as on a real machine.
    pub extremes: bool,
    /// A sudden change of its clock's speed. Default: none.
    pub clock_step: Option<Step>,
    /// Lateness of wake-ups without a bound, instead of [`HostModel::jitter`]. Default: with the
    /// bound.
    pub wake_ups: Option<Delay>,
    /// Delay of each frame after the program's time stamp, in addition to the constant latency.
    /// Default: none.
    pub hold_ups: Option<Delay>,
    /// A time in which no program runs. Default: none.
    pub stall: Option<Stall>,
}

/// A random delay of programs: exponential, with rare additions of a much longer time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Delay {
    /// Mean of the exponential part.
    pub mean: Nanos,
    /// On average one draw in `one_of` is longer; 0 means never.
    pub one_of: u64,
    /// Range of the additional time, uniformly distributed from the first to the second.
    pub more: (Nanos, Nanos),
}

/// A time in which no program runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stall {
    /// True time at which it begins.
    pub at: Nanos,
    /// How long it lasts.
    pub length: Nanos,
}

impl Delay {
    /// Draws a delay.
    pub fn draw(&self, chance: &mut Stream) -> Nanos {
        let usual = Nanos(chance.exponential(self.mean.0.max(0) as u64) as i64);
        let (least, most) = self.more;
        match self.one_of > 0 && chance.up_to(self.one_of - 1) == 0 {
            true => usual + least + Nanos(chance.up_to((most - least).0.max(0) as u64) as i64),
            false => usual,
        }
    }
}

impl Default for HostModel {
    /// A PC with a tuned real-time kernel: wake-ups are late by 20 us at worst, and the latency is
    /// 2 us in each direction.
    fn default() -> Self {
        Self {
            clock_ppb: 0,
            jitter: Nanos(20_000),
            latency: Nanos(2_000),
            extremes: false,
            clock_step: None,
            wake_ups: None,
            hold_ups: None,
            stall: None,
        }
    }
}

/// A host in true time.
#[derive(Clone, Debug)]
pub struct HostMachine {
    clock: Oscillator,
    model: HostModel,
    wake_ups: Stream,
    hold_ups: Stream,
    /// When each port will have sent its last frame and the gap after it.
    port_free: [Time<True>; 2],
    /// Additional lateness of the next wake-up.
    oversleeps: Nanos,
    /// When programs stopped, and when they continue.
    stalled: Option<(Time<True>, Time<True>)>,
    late_wake_ups: Option<LateHost>,
    slow_sends: Option<LateHost>,
    faults: Stream,
}

impl HostMachine {
    /// A host whose clock counts from true time zero.
    pub fn new(model: HostModel, seed: u64) -> Self {
        let clock = ClockModel { step: model.clock_step, ..ClockModel::constant(model.clock_ppb) };
        Self {
            clock: Oscillator::of(&clock, &mut Stream::new(seed, "host clock", 0)),
            model,
            wake_ups: Stream::new(seed, "host wake-up", 0),
            hold_ups: Stream::new(seed, "host hold-up", 0),
            port_free: [Time::ZERO; 2],
            oversleeps: Nanos::ZERO,
            stalled: None,
            late_wake_ups: None,
            slow_sends: None,
            faults: Stream::new(seed, "host faults", 0),
        }
    }

    /// Lets no program run from `from` until `to`.
    pub(crate) fn stall(&mut self, from: Time<True>, to: Time<True>) {
        self.stalled = Some((from, to));
    }

    /// Sets the lateness of wake-ups from now on, in addition to that of the model.
    pub(crate) fn set_late_wake_ups(&mut self, late: Option<LateHost>) {
        self.late_wake_ups = late;
    }

    /// Sets the delay of frames from now on, in addition to that of the model.
    pub(crate) fn set_slow_sends(&mut self, late: Option<LateHost>) {
        self.slow_sends = late;
    }

    /// Changes the speed of its clock.
    pub(crate) fn bend_clock(&mut self, bends: &[Bend]) {
        self.clock.bend(bends);
    }

    /// Lets its clock jump ahead.
    pub(crate) fn jump(&mut self, at: Time<True>, by: Nanos) {
        self.clock.jump(at, by);
    }

    /// When a program handles an input that is there at `at`: no program runs while the host is
    /// stalled.
    pub(crate) fn awake(&self, at: Time<True>) -> Time<True> {
        let of_model = self.model.stall.map(|Stall { at, length }| {
            let begin = Time::ZERO + Picos::from(at);
            (begin, begin + Picos::from(length))
        });
        let stalls = [of_model, self.stalled];
        stalls.into_iter().flatten().fold(
            at,
            |at, (begin, end)| {
                if at >= begin && at < end { end } else { at }
            },
        )
    }

    /// When the wire at a port is free for a frame of `len` bytes from another sender, not before
    /// `at`.
    pub(crate) fn send_of_others(
        &mut self,
        port: MainPort,
        at: Time<True>,
        len: usize,
    ) -> Time<True> {
        self.occupy(port, at, len)
    }

    fn occupy(&mut self, port: MainPort, at: Time<True>, len: usize) -> Time<True> {
        let free = &mut self.port_free[port as usize];
        let start = at.max(*free);
        let on_wire = len.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
        *free = start + Picos(on_wire as i64 * BYTE_PS);
        start
    }

    /// Delays the next wake-up by this time, once.
    pub fn oversleep(&mut self, by: Nanos) {
        self.oversleeps = by;
    }

    /// The host's clock.
    pub fn now(&self, at: Time<True>) -> Time<Host> {
        self.clock.read(at)
    }

    /// When its clock shows this reading.
    pub fn when(&self, reading: Time<Host>) -> Time<True> {
        self.clock.when(reading)
    }

    /// When a timer set to `wanted` wakes the program.
    pub fn wake_up(&mut self, wanted: Time<Host>) -> Time<True> {
        let worst = self.model.jitter.0.max(0) as u64;
        let late = match (self.model.wake_ups, self.model.extremes) {
            (Some(delay), _) => delay.draw(&mut self.wake_ups),
            (None, true) => Nanos((worst * self.wake_ups.up_to(1)) as i64),
            (None, false) => Nanos(self.wake_ups.lateness(worst) as i64),
        };
        let later = self.late_wake_ups.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults));
        let oversleeps = core::mem::take(&mut self.oversleeps);
        self.awake(self.clock.when(wanted + late + later + oversleeps))
    }

    /// When the first bit of a frame of `len` bytes leaves a port, if the program sends it at `at`:
    /// after the latency, and after earlier frames at this port.
    pub fn send(&mut self, port: MainPort, at: Time<True>, len: usize) -> Time<True> {
        let held_up = self.model.hold_ups.map(|delay| delay.draw(&mut self.hold_ups));
        let slower = self.slow_sends.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults));
        let latency = self.model.latency + held_up.unwrap_or_default() + slower;
        self.occupy(port, at + Picos::from(latency), len)
    }

    /// When the program has an answer whose last bit arrived at `at`.
    pub fn receive(&self, at: Time<True>) -> Time<True> {
        at + Picos::from(self.model.latency)
    }
}

impl LateHost {
    /// Draws a lateness.
    pub fn draw(&self, chance: &mut Stream) -> Nanos {
        match chance.up_to(u64::from(MILLION) - 1) < u64::from(self.ppm) {
            true => {
                let span = (self.most - self.least).0.max(0) as u64;
                self.least + Nanos(chance.up_to(span) as i64)
            }
            false => Nanos::ZERO,
        }
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
    fn one_wake_up_comes_late() {
        let mut host = HostMachine::new(HostModel { jitter: Nanos(0), ..Default::default() }, 1);
        host.oversleep(Nanos(300_000));
        let woken = [1, 2].map(|ms| host.wake_up(Time::new(ms * 1_000_000)).as_nanos());
        assert_eq!(woken, [1_300_000, 2_000_000]);
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

    /// Stamps of 10 000 frames, and how long after the constant latency each frame left.
    #[test]
    fn delays_are_exponential_and_sometimes_more() {
        let more = (Nanos(50_000), Nanos(150_000));
        let delay = Delay { mean: Nanos(5_000), one_of: 100, more };
        let model =
            HostModel { wake_ups: Some(delay), hold_ups: Some(delay), ..Default::default() };
        let mut host = HostMachine::new(model, 1);
        let (mut woken, mut held) = (vec![], vec![]);
        for ms in 1..10_000 {
            let wanted = Time::new(ms * 1_000_000);
            let at = host.wake_up(wanted);
            woken.push((host.now(at) - wanted).0);
            held.push((host.send(MainPort::Primary, at, 60) - at).0 / 1_000 - 2_000);
        }
        for mut delays in [woken, held] {
            delays.sort_unstable();
            let at = |percent: usize| delays[delays.len() * percent / 100];
            // Quantiles of an exponential distribution: -ln(1 - p) times its mean.
            assert!((3_300..3_600).contains(&at(50)), "{}", at(50));
            assert!((10_800..12_600).contains(&at(90)), "{}", at(90));
            let spikes = delays.iter().filter(|delay| **delay > 60_000).count();
            assert!((60..140).contains(&spikes), "{spikes}");
            assert!(delays[0] >= 0 && delays[9_998] < 220_000);
        }
    }

    #[test]
    fn a_stall_puts_off_what_falls_into_it() {
        let stall = Some(Stall { at: Nanos(5_000_000), length: Nanos(1_000_000) });
        let model = HostModel { jitter: Nanos::ZERO, stall, ..Default::default() };
        let mut host = HostMachine::new(model, 1);
        let mut woken = |ns: u64| host.wake_up(Time::new(ns)).as_nanos();
        assert_eq!(
            [4_999_999, 5_000_000, 5_999_999, 6_000_000].map(&mut woken),
            [4_999_999, 6_000_000, 6_000_000, 6_000_000]
        );
    }

    #[test]
    fn frames_queue_behind_each_other() {
        let mut host = HostMachine::new(HostModel::default(), 1);
        let first = host.send(MainPort::Primary, Time::ZERO, 60);
        assert_eq!(first, Time::new(2_000_000));
        // 60 bytes, FCS, preamble and gap: 84 bytes of 80 ns.
        assert_eq!(host.send(MainPort::Primary, Time::ZERO, 60), first + Picos(84 * 80_000));
        assert_eq!(
            host.send(MainPort::Primary, Time::new(1_000_000_000), 60),
            Time::new(1_002_000_000)
        );
    }
}

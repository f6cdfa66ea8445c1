//! The machine on which a program seems to run: the cost of its calls, and its delays.

use isocat_sim::fault::LateHost;
use isocat_sim::host::Delay;
use isocat_sim::random::Stream;
use isocat_wire::time::{Host as Clock, Nanos, Time};

/// The cost of calls in virtual time. Each call has a cost, so that a loop that polls the time or a
/// frame comes to an end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Costs {
    /// Reading a clock, and any call that has no cost of its own here.
    pub call: Nanos,
    /// Sending a frame: the time from the call until the first bit is on the wire.
    pub send: Nanos,
    /// Asking for a frame, whether or not one is there.
    pub receive: Nanos,
}

impl Default for Costs {
    /// The costs of a PC: 200 ns, 3 us, 1 us.
    fn default() -> Self {
        Self { call: Nanos(200), send: Nanos(3_000), receive: Nanos(1_000) }
    }
}

/// The random delays of a machine.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Luck {
    /// Largest lateness of a wake-up; drawn by [`Stream::lateness`], with a mean of a fifth of
    /// this.
    pub lateness: Nanos,
    /// Lateness without an upper limit, in place of `lateness`.
    pub wake_ups: Option<Delay>,
    /// Measured lateness, in place of both: each value with its number of occurrences.
    pub measured: Vec<(Nanos, u64)>,
    /// Additional delay of frames that are sent.
    pub hold_ups: Option<Delay>,
    /// Preemption: on average one call in this many (0: none) takes longer, by a time evenly
    /// distributed up to the second value.
    pub preemption: (u64, Nanos),
    /// Seed of all random delays.
    pub seed: u64,
}

impl Default for Luck {
    /// No delays.
    fn default() -> Self {
        Self {
            lateness: Nanos::ZERO,
            wake_ups: None,
            measured: Vec::new(),
            hold_ups: None,
            preemption: (0, Nanos::ZERO),
            seed: 1,
        }
    }
}

/// A fault of the machine while the program runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MachineFault {
    /// No program runs from the first instant until the second. [`Time::NEVER`] means until the
    /// next stall is reported.
    Stall(Time<Clock>, Time<Clock>),
    /// From now on wake-ups are later than usual; `None`: as usual.
    LateWakeUps(Option<LateHost>),
    /// From now on frames are sent later than usual; `None`: as usual.
    SlowSends(Option<LateHost>),
    /// Real time, as the program reads it, jumps forward. Monotonic time does not, as in Linux.
    ClockJump(Nanos),
}

/// A machine with its costs and delays.
#[derive(Debug)]
pub struct Host {
    /// The cost of calls.
    pub costs: Costs,
    luck: Luck,
    wake_ups: Stream,
    arrivals: Stream,
    hold_ups: Stream,
    preemptions: Stream,
    bytes: Stream,
    faults: Stream,
    /// Additional delays of wake-ups and of sends from faults.
    late: Option<LateHost>,
    slow: Option<LateHost>,
    /// The time in which no program runs.
    stalled: Option<(Time<Clock>, Time<Clock>)>,
}

impl Host {
    /// A machine with these costs and delays.
    pub fn new(costs: Costs, luck: Luck) -> Self {
        let stream = |name| Stream::new(luck.seed, name, 0);
        Self {
            costs,
            wake_ups: stream("virtual host wake-up"),
            arrivals: stream("virtual host arrival"),
            hold_ups: stream("virtual host hold-up"),
            preemptions: stream("virtual host preemption"),
            bytes: stream("virtual host random bytes"),
            faults: stream("virtual host faults"),
            luck,
            late: None,
            slow: None,
            stalled: None,
        }
    }

    /// The instant at which a program runs that was to wake at `due`.
    pub fn wakes(&mut self, due: Time<Clock>) -> Time<Clock> {
        let late = lateness(&self.luck, &mut self.wake_ups);
        let fault = self.late.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults));
        self.after_stall(due + late + fault)
    }

    /// Additional delay until a returned frame reaches the socket: it needs an interrupt, which is
    /// as late as a timer's. Without this delay, frames that are sent as soon as others come back
    /// would be more regular than on any real machine.
    pub fn brings_up(&mut self) -> Nanos {
        let usual = lateness(&self.luck, &mut self.arrivals);
        usual + self.late.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults))
    }

    /// Additional delay until a frame is sent, beyond [`Costs::send`].
    pub fn holds_up(&mut self) -> Nanos {
        let usual = self.luck.hold_ups.as_ref().map(|delay| delay.draw(&mut self.hold_ups));
        let fault = self.slow.map_or(Nanos::ZERO, |slow| slow.draw(&mut self.faults));
        usual.unwrap_or(Nanos::ZERO) + fault
    }

    /// How long the program is preempted at this call.
    pub fn preempts(&mut self) -> Nanos {
        match self.luck.preemption {
            (0, _) => Nanos::ZERO,
            (one_of, _) if self.preemptions.up_to(one_of - 1) > 0 => Nanos::ZERO,
            (_, most) => Nanos(self.preemptions.up_to(most.0.max(0) as u64) as i64),
        }
    }

    /// If an instant lies in a stall, the end of that stall; otherwise the instant.
    pub fn after_stall(&self, at: Time<Clock>) -> Time<Clock> {
        match self.stalled {
            Some((from, to)) if from <= at && at < to => to,
            _ => at,
        }
    }

    /// Applies a fault of the machine. A clock jump must be applied by those who show the clock.
    pub fn suffer(&mut self, fault: MachineFault) {
        match fault {
            MachineFault::Stall(from, to) => self.stalled = Some((from, to)),
            MachineFault::LateWakeUps(late) => self.late = late,
            MachineFault::SlowSends(slow) => self.slow = slow,
            MachineFault::ClockJump(_) => {}
        }
    }

    /// Random bytes for a program.
    pub fn random(&mut self, bytes: &mut [u8]) {
        bytes.iter_mut().for_each(|byte| *byte = self.bytes.up_to(255) as u8);
    }
}

/// The lateness of one wake-up.
fn lateness(luck: &Luck, chance: &mut Stream) -> Nanos {
    match (&luck.measured[..], &luck.wake_ups) {
        ([], Some(delay)) => delay.draw(chance),
        ([], None) => Nanos(chance.lateness(luck.lateness.0.max(0) as u64) as i64),
        (measured, _) => draw(measured, chance),
    }
}

/// Draws one of the measured values, each with its frequency.
fn draw(measured: &[(Nanos, u64)], chance: &mut Stream) -> Nanos {
    let total: u64 = measured.iter().map(|(_, times)| times).sum();
    let mut at = chance.up_to(total.saturating_sub(1));
    for (value, times) in measured {
        match at.checked_sub(*times) {
            Some(rest) => at = rest,
            None => return *value,
        }
    }
    Nanos::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(luck: Luck) -> Host {
        Host::new(Costs::default(), luck)
    }

    #[test]
    fn without_bad_luck_all_is_in_time() {
        let mut host = host(Luck::default());
        assert_eq!(host.wakes(Time::new(1_000)), Time::new(1_000));
        assert_eq!((host.holds_up(), host.preempts()), (Nanos::ZERO, Nanos::ZERO));
    }

    #[test]
    fn lateness_keeps_its_bound_comes_near_it_and_repeats_by_its_seed() {
        let draw = |seed| {
            let mut host = host(Luck { lateness: Nanos(100), seed, ..Luck::default() });
            (0..10_000).map(|_| host.wakes(Time::ZERO).count()).collect::<Vec<_>>()
        };
        let all = draw(1);
        let most = *all.iter().max().expect("some");
        assert!((80..=100).contains(&most), "{most}");
        let mean = all.iter().sum::<u64>() / all.len() as u64;
        assert!((15..25).contains(&mean), "{mean}");
        assert_eq!(all, draw(1));
        assert_ne!(all, draw(2));
    }

    #[test]
    fn measured_lateness_comes_as_often_as_it_was_seen() {
        let measured = vec![(Nanos(10), 900), (Nanos(500), 100)];
        let mut host = host(Luck { measured, ..Luck::default() });
        let long = (0..10_000).filter(|_| host.wakes(Time::ZERO).count() == 500).count();
        assert!((900..1_100).contains(&long), "{long}");
    }

    #[test]
    fn a_fault_makes_wake_ups_and_sends_late_until_it_ends() {
        let mut host = host(Luck::default());
        let late = LateHost { least: Nanos(300), most: Nanos(400), ppm: 1_000_000 };
        host.suffer(MachineFault::LateWakeUps(Some(late)));
        assert!((1_300..=1_400).contains(&host.wakes(Time::new(1_000)).count()));
        assert_eq!(host.holds_up(), Nanos::ZERO);
        host.suffer(MachineFault::SlowSends(Some(late)));
        host.suffer(MachineFault::LateWakeUps(None));
        assert_eq!(host.wakes(Time::new(1_000)), Time::new(1_000));
        assert!((300..=400).contains(&host.holds_up().0));
    }

    #[test]
    fn in_a_stall_nothing_wakes() {
        let mut host = host(Luck::default());
        host.suffer(MachineFault::Stall(Time::new(100), Time::new(200)));
        let wakes = [99, 100, 199, 200].map(|due| host.wakes(Time::new(due)).count());
        assert_eq!(wakes, [99, 200, 200, 200]);
    }
}

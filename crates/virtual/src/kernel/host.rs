//! The machine that a program seems to run on: what its calls cost, and its bad luck.

use isocat_sim::fault::LateHost;
use isocat_sim::host::Delay;
use isocat_sim::random::Stream;
use isocat_wire::time::{Host as Clock, Nanos, Time};

/// What calls cost in virtual time. Each call costs something, so that a loop that asks for the
/// time, or for a frame, again and again comes to its end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Costs {
    /// Reading a clock, and any call that is not named here.
    pub call: Nanos,
    /// Sending a frame, from the call until its first bit is on the wire.
    pub send: Nanos,
    /// Asking for a frame, whether one is there or not.
    pub receive: Nanos,
}

impl Default for Costs {
    /// As of a PC: 200 ns, 3 us, 1 us.
    fn default() -> Self {
        Self { call: Nanos(200), send: Nanos(3_000), receive: Nanos(1_000) }
    }
}

/// The bad luck of a machine.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Luck {
    /// Worst lateness of a wake-up; drawn as of [`Stream::lateness`], a fifth of this in the mean.
    pub lateness: Nanos,
    /// Lateness without a bound, in place of that.
    pub wake_ups: Option<Delay>,
    /// Lateness as it was measured, in place of both: how often each one was seen.
    pub measured: Vec<(Nanos, u64)>,
    /// How much later than in time frames set out.
    pub hold_ups: Option<Delay>,
    /// Preemption: one of so many calls takes this much longer, evenly up to the second; 0: none.
    pub preemption: (u64, Nanos),
    /// Seed of all of it.
    pub seed: u64,
}

impl Default for Luck {
    /// None at all.
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

/// Something that happens to the machine while the program runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MachineFault {
    /// No program runs from the first instant until the second; [`Time::NEVER`]: until the next stall is told.
    Stall(Time<Clock>, Time<Clock>),
    /// Wake-ups are later than usual, from now on; `None`: as usual.
    LateWakeUps(Option<LateHost>),
    /// Frames set out later than usual, from now on; `None`: as usual.
    SlowSends(Option<LateHost>),
    /// Real time, as the program reads it, jumps ahead. Monotonic time does not, as in Linux.
    ClockJump(Nanos),
}

/// A machine.
#[derive(Debug)]
pub struct Host {
    /// What calls cost.
    pub costs: Costs,
    luck: Luck,
    wake_ups: Stream,
    arrivals: Stream,
    hold_ups: Stream,
    preemptions: Stream,
    bytes: Stream,
    faults: Stream,
    /// What faults add to wake-ups and to sends.
    late: Option<LateHost>,
    slow: Option<LateHost>,
    /// No program runs in this time.
    stalled: Option<(Time<Clock>, Time<Clock>)>,
}

impl Host {
    /// A machine with its luck.
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

    /// When a program runs that is to wake at `due`.
    pub fn wakes(&mut self, due: Time<Clock>) -> Time<Clock> {
        let late = lateness(&self.luck, &mut self.wake_ups);
        let fault = self.late.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults));
        self.after_stall(due + late + fault)
    }

    /// How much later a frame that is back reaches the socket: it takes an interrupt, which is as
    /// late as a timer's. Without that frames that are sent as fast as they come back would be as
    /// even as no machine sends them.
    pub fn brings_up(&mut self) -> Nanos {
        let usual = lateness(&self.luck, &mut self.arrivals);
        usual + self.late.map_or(Nanos::ZERO, |late| late.draw(&mut self.faults))
    }

    /// How much later a frame sets out than [`Costs::send`] says.
    pub fn holds_up(&mut self) -> Nanos {
        let usual = self.luck.hold_ups.as_ref().map(|delay| delay.draw(&mut self.hold_ups));
        let fault = self.slow.map_or(Nanos::ZERO, |slow| slow.draw(&mut self.faults));
        usual.unwrap_or(Nanos::ZERO) + fault
    }

    /// How long the program is kept from running at this call.
    pub fn preempts(&mut self) -> Nanos {
        match self.luck.preemption {
            (0, _) => Nanos::ZERO,
            (one_of, _) if self.preemptions.up_to(one_of - 1) > 0 => Nanos::ZERO,
            (_, most) => Nanos(self.preemptions.up_to(most.0.max(0) as u64) as i64),
        }
    }

    /// The end of a stall in which an instant lies, else the instant.
    pub fn after_stall(&self, at: Time<Clock>) -> Time<Clock> {
        match self.stalled {
            Some((from, to)) if from <= at && at < to => to,
            _ => at,
        }
    }

    /// Something happens to the machine. A jump of its clock is up to those who show it.
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

/// How late a machine is this time.
fn lateness(luck: &Luck, chance: &mut Stream) -> Nanos {
    match (&luck.measured[..], &luck.wake_ups) {
        ([], Some(delay)) => delay.draw(chance),
        ([], None) => Nanos(chance.lateness(luck.lateness.0.max(0) as u64) as i64),
        (measured, _) => draw(measured, chance),
    }
}

/// One of the values that were measured, each as often as it was.
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

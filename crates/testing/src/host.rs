//! The simulated host of the application, and its delays.
//!
//! The lateness of a wake-up depends only on the seed and on the instant at which it is due. So it
//! does not matter how often a stack asks for the same timer, or drops timers before they are due.

use std::time::Duration;

use isocat_sim::fault::LateHost;
use isocat_sim::random::Stream;

/// Nanoseconds from the beginning of a run.
pub(crate) type Instant = u64;

/// A span in nanoseconds, saturating.
pub(crate) fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

pub(crate) struct Host {
    seed: u64,
    /// Worst lateness of a wake-up, ns.
    worst: u64,
    /// Time from the last bit of an answer until a program has it, ns.
    latency: u64,
    /// Spans in which the host runs no program.
    stalls: Vec<Span>,
    /// Spans in which wake-ups are later than usual.
    late: Vec<(Span, LateHost)>,
}

/// A span from its first instant up to, but not including, its second.
#[derive(Clone, Copy)]
pub(crate) struct Span(pub Instant, pub Instant);

impl Host {
    pub fn new(seed: u64, worst: Duration, latency: Duration) -> Self {
        let latency = nanos(latency);
        Self { seed, worst: nanos(worst), latency, stalls: Vec::new(), late: Vec::new() }
    }

    pub fn set_lateness(&mut self, worst: Duration) {
        self.worst = nanos(worst);
    }

    pub fn stall(&mut self, span: Span) {
        self.stalls.push(span);
        self.stalls.sort_by_key(|span| span.0);
    }

    pub fn be_late(&mut self, span: Span, late: LateHost) {
        self.late.push((span, late));
    }

    /// When the host wakes a program whose timer is due at `due`.
    pub fn wakes(&self, due: Instant) -> Instant {
        let usual = match self.worst {
            0 => 0,
            worst => Stream::new(self.seed, "wake-up in a test", due).lateness(worst),
        };
        let faults = self.late.iter().zip(0..).filter(|((span, _), _)| span.holds(due));
        let more: u64 = faults.map(|((_, late), number)| self.by_fault(late, number, due)).sum();
        self.after_stalls(due.saturating_add(usual).saturating_add(more))
    }

    /// When a program has a frame whose last bit came at `at`.
    pub fn receives(&self, at: Instant) -> Instant {
        self.after_stalls(at.saturating_add(self.latency))
    }

    fn after_stalls(&self, at: Instant) -> Instant {
        // In the order of their beginnings, because one stall may end within the next.
        self.stalls.iter().fold(at, |at, stall| if stall.holds(at) { stall.1 } else { at })
    }

    fn by_fault(&self, late: &LateHost, number: u64, due: Instant) -> u64 {
        let mut chance = Stream::new(self.seed, "late wake-up in a test", due ^ number << 48);
        if chance.up_to(999_999) >= u64::from(late.ppm) {
            return 0;
        }
        let (least, most) = (late.least.0.max(0) as u64, late.most.0.max(0) as u64);
        least + chance.up_to(most.saturating_sub(least))
    }
}

impl Span {
    fn holds(&self, at: Instant) -> bool {
        (self.0..self.1).contains(&at)
    }
}

#[cfg(test)]
mod tests {
    use isocat_wire::time::Nanos;

    use super::*;

    fn host(seed: u64, late_us: u64) -> Host {
        Host::new(seed, Duration::from_micros(late_us), Duration::from_nanos(10))
    }

    fn late(host: &Host) -> Vec<u64> {
        (0..10_000).map(|n| host.wakes(n * 1_000_000) - n * 1_000_000).collect()
    }

    #[test]
    fn lateness_keeps_its_bound_comes_near_it_and_repeats_by_its_seed() {
        let of = |seed| late(&host(seed, 100));
        let largest = of(7).into_iter().max().unwrap_or_default();
        assert!((90_000..=100_000).contains(&largest), "{largest}");
        assert_eq!(of(7), of(7));
        assert_ne!(of(7), of(8));
        assert!(late(&host(7, 0)).iter().all(|late| *late == 0));
    }

    #[test]
    fn a_stall_holds_up_all_that_is_due_in_it_and_leads_into_the_next() {
        let mut host = host(1, 0);
        host.stall(Span(200, 300));
        host.stall(Span(100, 200));
        for (due, wakes) in [(99, 99), (100, 300), (299, 300), (300, 300)] {
            assert_eq!(host.wakes(due), wakes, "due at {due}");
        }
        for (at, has) in [(89, 99), (90, 300), (289, 300), (290, 300), (291, 301)] {
            assert_eq!(host.receives(at), has, "back at {at}");
        }
    }

    #[test]
    fn a_fault_makes_wake_ups_late_while_it_lasts() {
        let mut host = host(1, 0);
        let fault = LateHost { least: Nanos(300), most: Nanos(400), ppm: 500_000 };
        host.be_late(Span(0, 5_000_000_000), fault);
        let all = late(&host);
        assert!(all[..5_000].iter().all(|late| *late == 0 || (300..=400).contains(late)));
        let share = all[..5_000].iter().filter(|late| **late > 0).count();
        assert!((2_300..2_700).contains(&share), "{share} of 5000 by a chance of a half");
        assert!(all[5_000..].iter().all(|late| *late == 0), "it is over");
    }
}

//! The jitter of frames on their way, by the kinds of ports: it tells how good one latch is before
//! a second one is taken.
//!
//! A port takes a frame into its ESC's own clock. Each hop is therefore longer or shorter than the
//! average by up to half a period of that clock, evenly distributed: a variance of period² / 12.
//! The sums in this file are expectations over all phases between the clocks. How far latches
//! averaged the jitter out shows in their spread, see [`Averaging`](super::Averaging).

use isocat_wire::address::PortNumber;
use isocat_wire::time::Picos;

/// One SubDevice, in processing order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Hop {
    /// Index of its parent in the tree, and the parent's port.
    pub parent: Option<(usize, PortNumber)>,
    /// Period of the clock that receives frames from above.
    pub out: Picos,
    /// Period of the clock at the parent's port, for frames on their way back.
    pub back: Picos,
}

/// The jitter of the hops as one SubDevice sees it; all are variances in ps².
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct HopJitter {
    /// Of the arrival of a frame, relative to its arrival at the first SubDevice.
    pub arrival: u64,
    /// Of the delay from the first SubDevice, measured by one latch.
    pub delay: u64,
    /// Of the time from a frame's arrival until it is back at each port.
    pub rounds: [u64; 4],
    /// All round trips of SubDevices up to this one.
    sum: u64,
    /// The last SubDevice behind it.
    end: usize,
}

impl HopJitter {
    /// Standard deviation of the instant at which a frame arrives (1 sigma), ps, rounded up.
    pub fn arrival_deviation(&self) -> Picos {
        Picos(super::mean::root(self.arrival.into()) as i64)
    }
}

/// Adds up the hops of a segment; `jitter` must be as long as `hops`. For a SubDevice that is
/// processed before its parent (cables swapped) only its own hop is counted.
pub fn hop_jitter(hops: &[Hop], jitter: &mut [HopJitter]) {
    let above = |at: usize| hops[at].parent.filter(|(parent, _)| *parent < at);
    let mut sum = 0u64;
    for at in 0..hops.len().min(jitter.len()) {
        let (out, back) = (variance(hops[at].out), variance(hops[at].back));
        let mut found =
            HopJitter { arrival: out, delay: (out + back) / 4, end: at, ..HopJitter::default() };
        match above(at) {
            Some((parent, _)) => {
                // Before this SubDevice, frames pass the earlier branches of its parent.
                let branches = sum - jitter[parent].sum;
                found.arrival += jitter[parent].arrival + branches;
                found.delay += jitter[parent].delay + branches;
                sum += out + back;
            }
            // The way to the first SubDevice is not part of any delay.
            None => (found.arrival, found.delay) = (0, 0),
        }
        found.sum = sum;
        jitter[at] = found;
    }
    for at in (0..hops.len().min(jitter.len())).rev() {
        let Some((parent, port)) = above(at) else { continue };
        let end = jitter[at].end;
        jitter[parent].rounds[port.index()] = jitter[end].sum - jitter[parent].sum;
        jitter[parent].end = jitter[parent].end.max(end);
    }
}

/// The variance of numbers that are evenly distributed over a period.
fn variance(period: Picos) -> u64 {
    period.0.unsigned_abs().saturating_mul(period.0.unsigned_abs()) / 12
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use super::*;
    use PortNumber::{P1, P3};

    const ONE: u64 = 40_000 * 40_000 / 12;

    fn jitter(hops: &[Hop]) -> Vec<HopJitter> {
        let mut jitter = vec![HopJitter::default(); hops.len()];
        hop_jitter(hops, &mut jitter);
        jitter
    }

    fn hop(parent: Option<(usize, PortNumber)>) -> Hop {
        Hop { parent, out: Picos(40_000), back: Picos(40_000) }
    }

    #[test]
    fn along_a_line_each_hop_adds_its_part() {
        let line: Vec<Hop> =
            (0..4usize).map(|at| hop(at.checked_sub(1).map(|at| (at, P1)))).collect();
        let all = jitter(&line);
        let arrivals: Vec<u64> = all.iter().map(|one| one.arrival).collect();
        assert_eq!(arrivals, [0, ONE, 2 * ONE, 3 * ONE]);
        assert_eq!(all[3].arrival_deviation(), Picos(20_000), "40 ns / sqrt(12) x sqrt(3)");
        let delays: Vec<u64> = all.iter().map(|one| one.delay).collect();
        assert_eq!(delays, [0, ONE / 2, ONE / 2 * 2, ONE / 2 * 3]);
        let rounds: Vec<u64> = all.iter().map(|one| one.rounds[1]).collect();
        assert_eq!(rounds, [6 * ONE, 4 * ONE, 2 * ONE, 0]);
    }

    /// A fork with two SubDevices behind its first branch and one behind its second.
    #[test]
    fn branches_before_are_passed_there_and_back() {
        let hops = [hop(None), hop(Some((0, P3))), hop(Some((1, P1))), hop(Some((0, P1)))];
        let all = jitter(&hops);
        assert_eq!((all[2].arrival, all[3].arrival), (2 * ONE, 5 * ONE));
        assert_eq!(all[3].delay, 4 * ONE + ONE / 2);
        assert_eq!(all[0].rounds, [0, 6 * ONE, 0, 4 * ONE]);
    }

    #[test]
    fn ports_differ_and_nonsense_is_survived() {
        let ebus = Hop { parent: Some((0, P1)), out: Picos(10_000), back: Picos(40_000) };
        let all = jitter(&[hop(None), ebus]);
        assert_eq!((all[1].arrival, all[1].delay), (8_333_333, (8_333_333 + ONE) / 4));
        let later = hop(Some((7, P1)));
        assert_eq!(jitter(&[later, hop(Some((1, P1)))]).len(), 2);
        assert_eq!(jitter(&[]), []);
    }
}

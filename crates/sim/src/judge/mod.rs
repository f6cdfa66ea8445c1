//! Judges: each watches a run from outside, in true time, and knows one invariant.
//!
//! They use no formula of the planner or the device model. They compare with physics (true time,
//! the reference clock's oscillator) and with intent (the configured cycle and phase).

pub mod host_phase;
pub mod inputs_cycle;
pub mod lost_pulses;
pub mod missed_events;
mod opportunity;
pub mod outputs_cycle;
pub mod outputs_delay;
pub mod outputs_valid;
pub mod plant;
pub mod samples;
pub mod sync0_error;
pub mod sync_margin;

pub use host_phase::HostPhase;
pub use inputs_cycle::InputsCycle;
pub use lost_pulses::LostPulses;
pub use missed_events::MissedEvents;
pub use opportunity::{Late, Opportunity};
pub use outputs_cycle::OutputsCycle;
pub use outputs_delay::OutputsDelay;
pub use outputs_valid::OutputsValid;
pub use samples::Samples;
pub use sync_margin::SyncMargin;
pub use sync0_error::Sync0Error;

use isocat_wire::time::{Nanos, Picos};

/// A grid in system time: every `cycle`, at `phase`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Grid {
    /// Distance of two points.
    pub cycle: Nanos,
    /// Position of a point in the cycle.
    pub phase: Nanos,
}

impl Grid {
    /// Distance of a point of system time, in ps, from the nearest grid point; negative if it is
    /// earlier.
    pub fn error(&self, system_ps: i128) -> Picos {
        if let Some((since, cycle)) = self.short(system_ps) {
            let into = since.rem_euclid(cycle);
            return Picos(if into > cycle / 2 { into - cycle } else { into });
        }
        let cycle = i128::from(self.cycle.0) * 1000;
        let into = (system_ps - i128::from(self.phase.0) * 1000).rem_euclid(cycle);
        Picos((if into > cycle / 2 { into - cycle } else { into }) as i64)
    }

    /// Number of the nearest grid point.
    pub fn index(&self, system_ps: i128) -> i64 {
        if let Some((since, cycle)) = self.short(system_ps) {
            return (since + cycle / 2).div_euclid(cycle);
        }
        let cycle = i128::from(self.cycle.0) * 1000;
        let since = system_ps - i128::from(self.phase.0) * 1000 + cycle / 2;
        since.div_euclid(cycle) as i64
    }

    /// The time since a grid point and the cycle, ps, if they are short: division of 64 bits is
    /// much faster, and enough for 50 days.
    #[inline]
    fn short(&self, system_ps: i128) -> Option<(i64, i64)> {
        const SHORT: i64 = i64::MAX / 2;
        let (cycle, phase) = (self.cycle.0.checked_mul(1000)?, self.phase.0.checked_mul(1000)?);
        let since = i64::try_from(system_ps).ok()?.checked_sub(phase)?;
        (since.abs() < SHORT && cycle > 0 && cycle < SHORT).then_some((since, cycle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_signed_and_at_most_half_a_cycle() {
        let grid = Grid { cycle: Nanos(1_000), phase: Nanos(100) };
        assert_eq!(grid.error(5_100_000), Picos(0));
        assert_eq!(grid.error(5_100_001), Picos(1));
        assert_eq!(grid.error(5_099_999), Picos(-1));
        assert_eq!(grid.error(5_600_000), Picos(500_000));
        assert_eq!(grid.error(5_600_001), Picos(-499_999));
        assert_eq!((grid.index(5_099_999), grid.index(5_100_001)), (5, 5));
    }
}

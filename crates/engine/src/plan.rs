//! The timing budget of a segment, before anything is sent.
//!
//! [`Plan::of`] makes of a scenario the segment that a MainDevice would find, as far as profiles and cables
//! tell it, and lets the MainDevice's own planner decide: modes, process image, frames, phases, and each demand
//! on the cycle as a line. [`Plan::report`] is that as a document; [`proof`] runs the segment with the worst
//! jitter that was planned with and puts what really happened next to each line; [`what_if`] runs it once for
//! each cable and SubDevice that may go; [`suggest`] looks for the phase with the most even slack and the
//! smallest cycle.

use isocat_maindevice::segment::Timing;
use isocat_maindevice::{Config, Error, Segment};
use isocat_segment::{Scenario, offline};
use isocat_sync::budget::{Check, Demand};

pub(crate) mod build;
#[cfg(not(target_family = "wasm"))]
pub mod cycles;
pub mod proof;
pub mod report;
mod start_up;
pub mod suggest;
mod text;
mod warnings;
pub mod what_if;

pub use proof::Proof;
pub use report::PlanReport;
pub use what_if::WhatIf;

/// A segment with everything decided.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The segment as a MainDevice would have it before it sends its first cyclic frame.
    pub segment: Segment,
    /// What was asked for. Lines that do not fit are no error here.
    pub config: Config,
}

impl Plan {
    /// Plans the segment of a scenario. An error is a segment that can't be at all, such as a mode that a device
    /// does not have; a line that does not fit is part of the plan.
    pub fn of(scenario: &Scenario) -> Result<Self, Error> {
        let config = Config { force: true, ..scenario.config() };
        let mut segment = offline::segment(&scenario.devices);
        isocat_maindevice::plan(&mut segment, &config)?;
        Ok(Self { segment, config })
    }

    /// The same segment with other wishes.
    pub fn with(&self, config: Config) -> Result<Self, Error> {
        let mut segment = self.segment.clone();
        segment.timing = None;
        let config = Config { force: true, ..config };
        isocat_maindevice::plan(&mut segment, &config)?;
        Ok(Self { segment, config })
    }

    /// The timing.
    pub fn timing(&self) -> &Timing {
        self.segment.timing.as_ref().expect("a plan has its timing")
    }

    /// All lines: the position of the SubDevice, `None` for those of the frames, and the demand.
    pub fn demands(&self) -> impl Iterator<Item = (Option<usize>, Demand)> + '_ {
        let timing = self.timing();
        let of_devices = (0..timing.devices.len()).flat_map(move |position| {
            let demand = move |check| Some((Some(position), timing.demand(position, check)?));
            Check::OF_DEVICE.into_iter().filter_map(demand)
        });
        std::iter::once((None, timing.frames_in_cycle())).chain(of_devices)
    }

    /// The line of the cycle with the least slack; where a line does not fit, the one that lacks
    /// most.
    pub fn tightest(&self) -> (Option<usize>, Demand) {
        let counts = |demand: &Demand| demand.check.is_of_cycle() || !demand.line().fits();
        let demands = self.demands().filter(|(_, demand)| counts(demand));
        let least = demands.min_by_key(|(_, demand)| demand.slack());
        least.expect("the frames have a line")
    }

    /// Whether every line has slack.
    pub fn fits(&self) -> bool {
        self.demands().all(|(_, demand)| demand.line().fits())
    }
}

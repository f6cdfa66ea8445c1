//! The timing budget of a segment, before anything is sent.
//!
//! [`Plan::of`] makes from a scenario the segment that a MainDevice would find, as far as profiles
//! and cables tell it. The MainDevice's own planner then decides modes, process image, frames and
//! phases, and gives each demand on the cycle as a line. [`Plan::report`] is the plan as a
//! document. [`proof`] runs the segment with the largest planned jitter and puts the measured worst
//! cases next to each line. [`what_if`] runs it once for each cable and SubDevice that may fail.
//! [`suggest`] looks for the phase with the most even slack and the smallest cycle.

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

/// A segment with all decisions made.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The segment as a MainDevice would have it before its first cyclic frame.
    pub segment: Segment,
    /// The configuration that was asked for. Lines that do not fit are no error here.
    pub config: Config,
}

impl Plan {
    /// Plans the segment of a scenario. An error is a segment that is impossible, such as one with
    /// a mode that a device does not have; a line that does not fit is part of the plan.
    pub fn of(scenario: &Scenario) -> Result<Self, Error> {
        let config = Config { force: true, ..scenario.config() };
        let mut segment = offline::segment(&scenario.devices);
        isocat_maindevice::plan(&mut segment, &config)?;
        Ok(Self { segment, config })
    }

    /// Plans the same segment with another configuration.
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

    /// All lines: the position of the SubDevice (`None` for the lines of the frames), and the
    /// demand.
    pub fn demands(&self) -> impl Iterator<Item = (Option<usize>, Demand)> + '_ {
        let timing = self.timing();
        let of_devices = (0..timing.devices.len()).flat_map(move |position| {
            let demand = move |check| Some((Some(position), timing.demand(position, check)?));
            Check::OF_DEVICE.into_iter().filter_map(demand)
        });
        std::iter::once((None, timing.frames_in_cycle())).chain(of_devices)
    }

    /// The line of the cycle with the least slack; if some lines do not fit, the one that lacks
    /// most.
    pub fn tightest(&self) -> (Option<usize>, Demand) {
        let counts = |demand: &Demand| demand.check.is_of_cycle() || !demand.line().fits();
        let demands = self.demands().filter(|(_, demand)| counts(demand));
        let least = demands.min_by_key(|(_, demand)| demand.slack());
        least.expect("the frames have a line")
    }

    /// Whether every line fits.
    pub fn fits(&self) -> bool {
        self.demands().all(|(_, demand)| demand.line().fits())
    }
}

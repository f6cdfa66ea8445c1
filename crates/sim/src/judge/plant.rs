//! The effect of late outputs on a plant, compared with a plant that gets the same commands on the
//! grid.
//!
//! The ideal plant is equal and starts in the same state, and its commands are those intended for
//! each cycle. They act a constant time after the instant at which the cycle's frame should find
//! the reference clock. This time is the shortest that the SubDevice took in its first
//! [`CALIBRATION`] cycles. So the difference shows lateness only, and nothing that also occurs with
//! punctual outputs. Both plants are sampled at the same instants, [`LOOKS`] times in a cycle.

use std::collections::VecDeque;

use isocat_wire::time::{Picos, Time, True};

use crate::plant::{Acted, Motion, PlantSetup, State};

/// Number of cycles in which the shortest time from frame to acting outputs is found.
pub const CALIBRATION: usize = 32;
/// Number of samples of both plants in a cycle.
pub const LOOKS: i64 = 8;

/// Watches one plant.
#[derive(Clone, Debug)]
pub struct PlantJudge {
    setup: PlantSetup,
    bus_cycle: Picos,
    /// The real plant since the last action, and its next actions.
    real: Motion,
    acted: VecDeque<Acted>,
    /// When the frames of the last cycles should find the reference clock.
    cycles: VecDeque<Time<True>>,
    /// Shortest time from there to acting outputs, and the number of samples.
    delay: (Picos, usize),
    /// The plant with commands on the grid, once there are any, and its next commands.
    ideal: Option<Motion>,
    meant: VecDeque<(Time<True>, i64)>,
    /// The command in force on the grid.
    command: i64,
    figures: Figures,
}

/// The figures of one plant. Distances are those of the load, in um.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Figures {
    /// Number of samples of both plants; 0: none.
    pub looks: u64,
    /// Distance of the load from its place on the ideal plant.
    pub deviation: Spread,
    /// When it was largest.
    pub worst_at: Time<True>,
    /// Distance of the load from the command in force on the grid; zero if commands are torques.
    pub following: Spread,
    /// The same for the ideal plant.
    pub ideal_following: Spread,
    /// Torque in the coupling, Nm.
    pub coupling: Spread,
    /// The same for the ideal plant.
    pub ideal_coupling: Spread,
    /// The difference of both: the ripple that lateness causes.
    pub ripple: Spread,
}

/// Size of a figure over time.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Spread {
    /// The largest absolute value.
    pub largest: f64,
    squares: f64,
    count: u64,
}

impl Spread {
    /// Takes a value; returns whether it is the largest so far.
    pub fn push(&mut self, value: f64) -> bool {
        self.squares += value * value;
        self.count += 1;
        // The first value is the largest so far. A NaN also counts as the largest: the loop is
        // unstable.
        let is_largest = self.count == 1 || value.is_nan() || value.abs() > self.largest;
        if is_largest {
            self.largest = value.abs();
        }
        is_largest
    }

    /// Root of the mean square.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count.max(1) as f64).sqrt()
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.count
    }
}

impl PlantJudge {
    /// A judge without samples of this plant, in a segment with this bus cycle.
    pub fn new(setup: PlantSetup, bus_cycle: Picos) -> Self {
        Self {
            setup,
            bus_cycle,
            real: Motion::REST,
            acted: VecDeque::new(),
            cycles: VecDeque::new(),
            delay: (Picos(i64::MAX), 0),
            ideal: None,
            meant: VecDeque::new(),
            command: 0,
            figures: Figures::default(),
        }
    }

    /// The plant that it watches.
    pub fn setup(&self) -> &PlantSetup {
        &self.setup
    }

    /// The figures so far.
    pub fn figures(&self) -> &Figures {
        &self.figures
    }

    /// The constant time from the grid to acting outputs; `None` before it is measured.
    pub fn delay(&self) -> Option<Picos> {
        Some(self.delay.0).filter(|_| self.delay.1 >= CALIBRATION)
    }

    /// Takes an action of outputs at the SubDevice. Returns the time up to which actions are known.
    pub fn acts(&mut self, acted: Acted) -> Time<True> {
        self.acted.push_back(acted);
        acted.motion.at
    }

    /// Takes a cycle whose frame should find the reference clock at `at`, with its intended
    /// command, if any.
    pub fn cycle(&mut self, at: Time<True>, command: Option<i64>) {
        if self.cycles.len() == KEPT {
            self.cycles.pop_front();
        }
        self.cycles.push_back(at);
        if let (Some(command), Some(delay)) = (command, self.delay()) {
            self.meant.push_back((at + delay, command));
        }
    }

    /// Moves both plants to `at` and compares them. Returns the deviation, um; `None` before there
    /// are both.
    pub fn look(&mut self, at: Time<True>) -> Option<f64> {
        loop {
            let acts = self.acted.front().map_or(Time::NEVER, |acted| acted.motion.at);
            let meant = self.meant.front().map_or(Time::NEVER, |(at, _)| *at);
            if acts.min(meant) > at {
                break;
            }
            if acts <= meant {
                let Some(acted) = self.acted.pop_front() else { break };
                self.calibrate(&acted);
                self.real = acted.motion;
            } else {
                let Some((at, command)) = self.meant.pop_front() else { break };
                let before = self.ideal.unwrap_or(self.real);
                self.ideal = Some(before.act(&self.setup, at, command));
                self.command = command;
            }
        }
        let masses = self.setup.masses;
        let ideal = self.ideal?.until(&masses, at);
        self.ideal = Some(ideal);
        let real = self.real.until(&masses, at).state;
        Some(self.compare(at, &real, &ideal.state))
    }

    fn calibrate(&mut self, acted: &Acted) {
        let (least, seen) = self.delay;
        if seen >= CALIBRATION || acted.frame == Time::ZERO {
            return;
        }
        // The frame belongs to the nearest cycle; a frame before the first known cycle belongs to
        // none.
        let is_of = |cycle: &&Time<True>| (acted.frame - **cycle).0.abs() < self.bus_cycle.0 / 2;
        if let Some(cycle) = self.cycles.iter().find(is_of) {
            self.delay = (least.min(acted.motion.at - *cycle), seen + 1);
        }
    }

    fn compare(&mut self, at: Time<True>, real: &State, ideal: &State) -> f64 {
        let Self { setup, figures, command, .. } = self;
        let deviation = setup.travel(real.load - ideal.load);
        figures.looks += 1;
        if figures.deviation.push(deviation) {
            figures.worst_at = at;
        }
        if let crate::plant::Control::Position { .. } = setup.control {
            let wanted = setup.angle(*command);
            figures.following.push(setup.travel(wanted - real.load));
            figures.ideal_following.push(setup.travel(wanted - ideal.load));
        }
        let couplings = [real, ideal].map(|state| setup.masses.coupling(state));
        figures.coupling.push(couplings[0]);
        figures.ideal_coupling.push(couplings[1]);
        figures.ripple.push(couplings[0] - couplings[1]);
        deviation
    }
}

/// Number of cycles that a frame may belong to.
const KEPT: usize = 8;

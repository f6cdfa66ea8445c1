//! What late outputs do to the machine: it is held against one that gets the same commands on the grid.
//!
//! The other machine is equal, begins in the same state, and its commands are those that were meant for each cycle. They act
//! one constant time behind the instant at which the cycle's frame is to find the reference clock: the least that this SubDevice
//! took in its first [`CALIBRATION`] cycles. So what is seen is lateness, and nothing that a punctual run has too. Both are
//! looked at together, [`LOOKS`] times a cycle.

use std::collections::VecDeque;

use isocat_wire::time::{Picos, Time, True};

use crate::plant::{Acted, Motion, PlantSetup, State};

/// Cycles in which the least time from frame to acting outputs is found.
pub const CALIBRATION: usize = 32;
/// How often both machines are looked at in a cycle.
pub const LOOKS: i64 = 8;

/// Watches one plant.
#[derive(Clone, Debug)]
pub struct PlantJudge {
    setup: PlantSetup,
    bus_cycle: Picos,
    /// The machine as it is, since what acted last; and what acts then.
    real: Motion,
    acted: VecDeque<Acted>,
    /// When the last cycles were to find the reference clock.
    cycles: VecDeque<Time<True>>,
    /// Least time from there to acting outputs, and how many were seen.
    delay: (Picos, usize),
    /// The machine that gets its commands on the grid, once there are any; and what acts on it then.
    ideal: Option<Motion>,
    meant: VecDeque<(Time<True>, i64)>,
    /// The command in force on the grid.
    command: i64,
    figures: Figures,
}

/// What was seen of one plant. Distances are of the load, in um.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Figures {
    /// How often both machines were looked at; 0: they never were.
    pub looks: u64,
    /// From where the load would be on the grid to where it is.
    pub deviation: Spread,
    /// When it was farthest.
    pub worst_at: Time<True>,
    /// From the command in force on the grid to where the load is; zero where commands are torques.
    pub following: Spread,
    /// The same of the machine on the grid.
    pub ideal_following: Spread,
    /// Torque in the coupling, Nm.
    pub coupling: Spread,
    /// The same of the machine on the grid.
    pub ideal_coupling: Spread,
    /// The difference of both: the ripple that lateness makes.
    pub ripple: Spread,
}

/// Size of a figure that changes.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Spread {
    /// The largest, without its sign.
    pub largest: f64,
    squares: f64,
    count: u64,
}

impl Spread {
    /// Takes a value; whether it is the largest so far.
    pub fn push(&mut self, value: f64) -> bool {
        self.squares += value * value;
        self.count += 1;
        // The first one is, and what is no number any more: the loop is not stable.
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

    /// How many values there were.
    pub fn count(&self) -> u64 {
        self.count
    }
}

impl PlantJudge {
    /// Nothing was seen of this plant, in a segment with this bus cycle.
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

    /// What it is about.
    pub fn setup(&self) -> &PlantSetup {
        &self.setup
    }

    /// What was seen.
    pub fn figures(&self) -> &Figures {
        &self.figures
    }

    /// The constant time from the grid to acting outputs; `None` before it is known.
    pub fn delay(&self) -> Option<Picos> {
        Some(self.delay.0).filter(|_| self.delay.1 >= CALIBRATION)
    }

    /// Outputs acted at the SubDevice. Gives up to when it is known what acted.
    pub fn acts(&mut self, acted: Acted) -> Time<True> {
        self.acted.push_back(acted);
        acted.motion.at
    }

    /// A cycle whose frame is to find the reference clock at `at`, with the command that is meant for it; `None` if none is.
    pub fn cycle(&mut self, at: Time<True>, command: Option<i64>) {
        if self.cycles.len() == KEPT {
            self.cycles.pop_front();
        }
        self.cycles.push_back(at);
        if let (Some(command), Some(delay)) = (command, self.delay()) {
            self.meant.push_back((at + delay, command));
        }
    }

    /// Both machines move on to `at`, and are looked at. Gives the deviation, um; `None` before there are both.
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
        // The frame is that of the nearest cycle; one that came before the first that is known has none.
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

/// Cycles that a frame may belong to.
const KEPT: usize = 8;

//! Compares all plants of a run with ideal plants on the grid, and the axes with each other.

use isocat_maindevice::written::Written;
use isocat_wire::time::{Dc, Nanos, Picos, Time, True};

use crate::bench::Intent;
use crate::judge::plant::{LOOKS, PlantJudge, Spread};
use crate::plant::PlantSetup;
use crate::segment::Segment;

/// The judges of all plants. They sample in the order of true time, up to the time up to which the
/// actions of every SubDevice are known; this time advances with the frames that reach them.
#[derive(Clone, Debug)]
pub struct PlantBench {
    intent: Intent,
    judges: Vec<PlantJudge>,
    /// By judge: the time up to which its actions are known.
    known: Vec<Time<True>>,
    /// The present cycle, in system time and in true time, and the start of the next one.
    cycle: (Time<Dc>, Time<True>),
    next: Time<True>,
    look: i64,
    apart: Apart,
}

/// The difference in lateness of the axes, which distorts a common contour.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Apart {
    /// Difference of the largest and the least deviation of all plants at an instant, um. A single
    /// plant has no difference.
    pub distance: Spread,
    /// When the difference was largest.
    pub worst_at: Time<True>,
}

impl PlantBench {
    /// Begins with the cycle whose frame should find the reference clock at a point of system time,
    /// which is about `begin` in true time.
    pub fn new(
        setups: &[PlantSetup],
        intent: Intent,
        begin: (Time<Dc>, Time<True>),
        segment: &Segment,
    ) -> Self {
        let leader = Some(intent.reference);
        let at = on_grid(&intent, leader, segment, begin.1);
        Self {
            judges: setups
                .iter()
                .map(|setup| PlantJudge::new(*setup, intent.send.cycle.into()))
                .collect(),
            known: vec![Time::ZERO; setups.len()],
            cycle: (begin.0, at),
            next: on_grid(&intent, leader, segment, at + intent.send.cycle.into()),
            intent,
            // No command is intended for this cycle: the next one is the first that counts.
            look: LOOKS,
            apart: Apart::default(),
        }
    }

    /// Takes the new actions, and samples as far as all actions are known. `leader` is the
    /// SubDevice of the reference clock, if there is one.
    pub fn follow(&mut self, segment: &mut Segment, leader: Option<usize>, written: &Written) {
        for (judge, known) in self.judges.iter_mut().zip(&mut self.known) {
            for acted in segment.take_acted(judge.setup().device) {
                *known = judge.acts(acted);
            }
        }
        let first = self.known.iter().min().copied().unwrap_or(Time::ZERO);
        let last = self.known.iter().max().copied().unwrap_or(Time::ZERO);
        // A SubDevice that no frame reaches reports no actions; the others wait for it only for a
        // limited time.
        let until = first.max(Time::new(last.count().saturating_sub(LONGEST_WAIT.0 as u64)));
        self.look_until(until, segment, leader, written);
    }

    /// Samples up to the end of the run, when every SubDevice has been advanced to `end`.
    pub fn finish(
        &mut self,
        segment: &mut Segment,
        leader: Option<usize>,
        written: &Written,
        end: Time<True>,
    ) {
        self.follow(segment, leader, written);
        self.look_until(end, segment, leader, written);
    }

    /// The judges of the plants.
    pub fn judges(&self) -> &[PlantJudge] {
        &self.judges
    }

    /// The difference between the plants.
    pub fn apart(&self) -> &Apart {
        &self.apart
    }

    fn look_until(
        &mut self,
        until: Time<True>,
        segment: &Segment,
        leader: Option<usize>,
        written: &Written,
    ) {
        loop {
            let span = (self.next - self.cycle.1).0;
            let at = self.cycle.1 + Picos(span * self.look / LOOKS);
            if at > until {
                return;
            }
            if self.look == LOOKS {
                self.next_cycle(segment, leader, written);
                continue;
            }
            self.look += 1;
            self.look_at(at);
        }
    }

    fn look_at(&mut self, at: Time<True>) {
        let (mut least, mut most, mut seen) = (f64::INFINITY, f64::NEG_INFINITY, 0);
        for deviation in self.judges.iter_mut().filter_map(|judge| judge.look(at)) {
            (least, most, seen) = (least.min(deviation), most.max(deviation), seen + 1);
        }
        if seen == self.judges.len() && seen > 1 && self.apart.distance.push(most - least) {
            self.apart.worst_at = at;
        }
    }

    /// Begins the next cycle with its intended commands.
    fn next_cycle(&mut self, segment: &Segment, leader: Option<usize>, written: &Written) {
        let bus = self.intent.send.cycle;
        self.cycle = (self.cycle.0 + bus, self.next);
        self.look = 0;
        self.next = on_grid(&self.intent, leader, segment, self.next + bus.into());
        let (grid, at) = self.cycle;
        for judge in &mut self.judges {
            let PlantSetup { device, command, .. } = *judge.setup();
            if takes_part(&self.intent, device, grid) {
                judge.cycle(at, written.value(device, command, grid));
            }
        }
    }
}

/// Longest wait for the actions of a SubDevice. Actions that are reported later count from the time
/// of the report.
const LONGEST_WAIT: Picos = Picos(10_000_000_000_000);

/// Whether the process data of a SubDevice is exchanged in the cycle of a point of system time.
/// Slow SubDevices are exchanged in cycles whose number is a multiple of theirs.
fn takes_part(intent: &Intent, device: usize, grid: Time<Dc>) -> bool {
    let bus = intent.send.cycle.0;
    let own = intent.exchange.get(device).copied().flatten().map_or(bus, |own| own.cycle.0);
    let since = grid.count() as i64 - intent.send.phase.0;
    Nanos((since + bus / 2).rem_euclid(own.max(bus))) < Nanos(bus)
}

/// The instant near a guess at which the reference clock is on the grid of frames. Without such a
/// clock it is the guess.
fn on_grid(
    intent: &Intent,
    leader: Option<usize>,
    segment: &Segment,
    guess: Time<True>,
) -> Time<True> {
    let Some(leader) = leader.filter(|at| segment.devices()[*at].is_powered()) else {
        return guess;
    };
    let clock = &segment.devices()[leader];
    // Clocks run within 1 % of true time: the second step removes the error that the first step
    // leaves of a microsecond.
    (0..2).fold(guess, |at, _| at + Picos(-intent.send.error(clock.system_time_ps(at)).0))
}

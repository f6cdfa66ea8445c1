//! Faults of frames: frames that are lost, damaged, late or doubled.

use isocat_wire::time::Nanos;

use crate::cable::Direction;
use crate::fault::{FrameFault, Harm, MILLION, Which};
use crate::random::Stream;

/// The faults of frames that are in force at one place: at the MainDevice's port, or on the cables.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameFaults {
    active: Vec<Active>,
}

#[derive(Clone, Debug)]
struct Active {
    /// The id by which it ends.
    id: u64,
    fault: FrameFault,
    /// Remaining frames to hit, of a fault with a fixed number or of a burst.
    left: u64,
    chance: Stream,
}

/// The faults of a frame in one direction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Harms {
    pub lost: bool,
    pub damaged: bool,
    pub late: Nanos,
    pub doubled: bool,
}

impl FrameFaults {
    /// Begins a fault; its random numbers come from the seed of the run and its id.
    pub fn begin(&mut self, id: u64, fault: FrameFault, seed: u64) {
        let place = |active: &Active| {
            let kind = std::mem::discriminant(&active.fault.harm);
            let same_kind = kind == std::mem::discriminant(&fault.harm);
            let by_chance = matches!(active.fault.which, Which::Chance { .. });
            same_kind
                && by_chance
                && (active.fault.way, active.fault.cable) == (fault.way, fault.cable)
        };
        let left = match fault.which {
            Which::Next(count) => count,
            Which::Chance { ppm, .. } => {
                // Another probability at the same place replaces the former one.
                self.active.retain(|active| !place(active));
                if ppm == 0 {
                    return;
                }
                0
            }
        };
        let chance = Stream::new(seed, "fault of frames", id);
        self.active.push(Active { id, fault, left, chance });
    }

    /// Ends a fault.
    pub fn end(&mut self, id: u64) {
        self.active.retain(|active| active.id != id);
    }

    /// Ends all faults.
    pub fn heal(&mut self) {
        self.active.clear();
    }

    /// Whether any fault is in force.
    pub fn are_any(&self) -> bool {
        !self.active.is_empty()
    }

    /// The faults of the next frame that leaves the MainDevice, on its way out and on its way back.
    pub fn at_port(&mut self) -> [Harms; 2] {
        let mut harms = [Harms::default(); 2];
        for active in &mut self.active {
            if active.hits() {
                let way = active.way();
                active.harm(&mut harms[way as usize]);
            }
        }
        self.forget_spent();
        harms
    }

    /// The faults of a frame that enters a cable.
    pub fn on_cable(&mut self, cable: usize, direction: Direction) -> Harms {
        let mut harms = Harms::default();
        for active in &mut self.active {
            let fault = &active.fault;
            let here = fault.cable == Some(cable) && fault.way.is_none_or(|way| way == direction);
            if here && active.hits() {
                active.harm(&mut harms);
            }
        }
        self.forget_spent();
        harms
    }

    fn forget_spent(&mut self) {
        self.active
            .retain(|active| active.left > 0 || matches!(active.fault.which, Which::Chance { .. }));
    }
}

impl Active {
    /// Whether the next frame is hit.
    fn hits(&mut self) -> bool {
        if self.left > 0 {
            self.left -= 1;
            return true;
        }
        let Which::Chance { ppm, burst } = self.fault.which else { return false };
        let hit = self.chance.up_to(u64::from(MILLION) - 1) < u64::from(ppm);
        if hit {
            self.left = u64::from(burst.max(1)) - 1;
        }
        hit
    }

    /// The direction in which the frame is hit.
    fn way(&mut self) -> Direction {
        let either = |chance: &mut Stream| match chance.up_to(1) {
            0 => Direction::Out,
            _ => Direction::Back,
        };
        self.fault.way.unwrap_or_else(|| either(&mut self.chance))
    }

    fn harm(&mut self, harms: &mut Harms) {
        match self.fault.harm {
            Harm::Lost => harms.lost = true,
            Harm::Damaged => harms.damaged = true,
            Harm::Late { least, most } => {
                let more = self.chance.up_to((most - least).0.max(0) as u64);
                harms.late += least + Nanos(more as i64);
            }
            Harm::Doubled => harms.doubled = true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOSS: FrameFault =
        FrameFault { harm: Harm::Lost, which: Which::Next(1), way: None, cable: None };

    fn lost(faults: &mut FrameFaults, frames: usize) -> usize {
        let is_lost = |faults: &mut FrameFaults| faults.at_port().iter().any(|harms| harms.lost);
        (0..frames).filter(|_| is_lost(faults)).count()
    }

    #[test]
    fn losses_come_as_often_as_asked_for() {
        for (ppm, burst, expected) in [
            (100_000, 1, 1_800..2_200),
            // A hit affects two more frames: one of 12 frames begins a burst, so 3 of 12 are lost.
            (100_000, 3, 4_700..5_300),
            (MILLION, 1, 20_000..20_001),
        ] {
            let mut faults = FrameFaults::default();
            faults.begin(1, FrameFault { which: Which::Chance { ppm, burst }, ..LOSS }, 1);
            let count = lost(&mut faults, 20_000);
            assert!(expected.contains(&count), "{ppm} {burst}: {count}");
            faults.begin(2, FrameFault { which: Which::Chance { ppm: 0, burst: 1 }, ..LOSS }, 1);
            assert_eq!((lost(&mut faults, 1_000), faults.are_any()), (0, false));
        }
    }

    #[test]
    fn so_many_frames_are_lost_and_no_more() {
        let mut faults = FrameFaults::default();
        faults.begin(1, FrameFault { which: Which::Next(3), ..LOSS }, 1);
        assert_eq!((lost(&mut faults, 3), lost(&mut faults, 100)), (3, 0));
        assert!(!faults.are_any());
    }

    #[test]
    fn one_way_and_one_cable_leave_the_others_alone() {
        let mut faults = FrameFaults::default();
        let which = Which::Chance { ppm: MILLION, burst: 1 };
        let fault = FrameFault { which, way: Some(Direction::Back), cable: Some(2), ..LOSS };
        faults.begin(1, fault, 1);
        assert!(faults.on_cable(2, Direction::Back).lost);
        assert_eq!(faults.on_cable(2, Direction::Out), Harms::default());
        assert_eq!(faults.on_cable(1, Direction::Back), Harms::default());
        faults.end(1);
        assert!(!faults.on_cable(2, Direction::Back).lost);
    }

    #[test]
    fn late_frames_are_late_by_what_was_asked_for() {
        let mut faults = FrameFaults::default();
        let harm = Harm::Late { least: Nanos(1_000), most: Nanos(3_000) };
        let which = Which::Chance { ppm: MILLION, burst: 1 };
        faults.begin(1, FrameFault { harm, which, way: Some(Direction::Back), cable: None }, 1);
        let late: Vec<i64> = (0..1_000).map(|_| faults.at_port()[1].late.0).collect();
        assert!(late.iter().all(|late| (1_000..=3_000).contains(late)));
        assert!(late.iter().min() < Some(&1_050) && late.iter().max() > Some(&2_950));
    }
}

//! Expectations of a run, and whether they are met.
//!
//! A run of the simulation and a segment that is served to a foreign MainDevice provide the same
//! [`Evidence`], so every [`Expectation`] is judged by the same code.

use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::course::{Course, Stretch};
use crate::fault::{Happened, Moment, When};
use crate::finding::Finding;
use crate::judge::plant::PlantJudge;
use crate::plant_bench::PlantBench;

/// An expectation of a run, judged in true time.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Expectation {
    /// Whether the run is without any finding.
    InSync(bool),
    /// All SubDevices are in sync at an instant. Cycles are not counted here, so [`Moment::Cycle`]
    /// is never reached.
    InSyncAt(When),
    /// No SYNC0 edge of the SubDevice is farther off its grid than the limit.
    WorstSync0 {
        /// Position; `None`: all SubDevices.
        device: Option<usize>,
        /// The largest error.
        limit: Nanos,
    },
    /// No load of the SubDevice's plant is farther from its place with punctual outputs than the
    /// limit.
    PlantDeviation {
        /// Position; `None`: all plants.
        device: Option<usize>,
        /// The largest distance, nm.
        limit_nm: u64,
    },
    /// All SubDevices are in sync again this long after the last fault ended (or began, if it has
    /// no end), and stay in sync.
    RecoversWithin(Nanos),
    /// No SubDevice stays in OP for longer than this without new outputs.
    SafeWithin(Nanos),
    /// The first finding about a SubDevice is about this one.
    Blames(usize),
}

/// The result of a judgement.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Found {
    /// The run is as expected, without further details.
    AsExpected,
    /// Number of findings.
    Findings(usize),
    /// A SubDevice was not in sync at that time.
    OutOfSync(Stretch),
    /// A SYNC0 edge of a SubDevice was this far off.
    Sync0 {
        /// Position.
        device: usize,
        /// The error.
        error: Picos,
    },
    /// The load of a SubDevice's plant was this far from its place with punctual outputs.
    Deviation {
        /// Position.
        device: usize,
        /// The distance, nm.
        nm: u64,
    },
    /// Time from the last fault until all were in sync again.
    Recovered(Picos),
    /// Outputs of a SubDevice in OP were this old.
    Stale {
        /// Position.
        device: usize,
        /// Age of the outputs.
        age: Picos,
    },
    /// The first finding is about this SubDevice, if it is about any.
    Blamed(Option<usize>),
    /// The segment did not come into operation.
    NeverInOperation,
    /// The run ended before the judgement was possible.
    RunEnded,
    /// The instant was before operation.
    BeforeOperation,
    /// No SYNC0 edge was measured, so there is nothing to judge.
    NoEdge,
    /// There is no plant.
    NoPlant,
    /// No planned fault can happen here, or all fell before operation, so nothing was tested.
    NoFault,
    /// The first findings are no longer kept.
    Forgotten,
}

/// An expectation and its result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Judgement {
    /// The expectation.
    pub expectation: Expectation,
    /// Whether it is met.
    pub met: bool,
    /// The reason.
    pub found: Found,
}

impl Judgement {
    /// Whether there was data to judge by. Without data it is not met.
    pub fn is_judged(&self) -> bool {
        !matches!(self.found, Found::NoEdge | Found::NoFault | Found::NoPlant | Found::Forgotten)
    }
}

/// The data by which expectations are judged.
pub struct Evidence<'a> {
    /// The course of the run; `None`: it never came into operation.
    pub course: Option<&'a Course>,
    /// The judges of plants; `None` without plants, as in a served segment.
    pub plants: Option<&'a PlantBench>,
    /// When the judged time ended.
    pub end: Time<True>,
    /// The findings about the run, in the order of time.
    pub findings: &'a [Finding],
    /// The faults that began or ended by then.
    pub happened: Vec<&'a Happened>,
    /// Whether a planned fault did not begin by then.
    pub is_to_come: bool,
}

impl Expectation {
    /// Judges the expectation.
    pub fn judge(self, evidence: &Evidence<'_>) -> Judgement {
        let (met, found) = self.look(evidence);
        Judgement { expectation: self, met, found }
    }

    fn look(self, evidence: &Evidence<'_>) -> (bool, Found) {
        if let Self::InSync(expected) = self {
            let count = evidence.findings.len();
            let is_in_sync = count == 0 && evidence.course.is_some();
            if let Some(course) = evidence.course.filter(|_| is_in_sync && expected)
                && let Some(found) = untested(course, evidence)
            {
                return (false, found);
            }
            let found = match evidence.course {
                None => Found::NeverInOperation,
                Some(_) if is_in_sync => Found::AsExpected,
                Some(_) => Found::Findings(count),
            };
            return (is_in_sync == expected, found);
        }
        if let Self::Blames(expected) = self {
            let blamed = evidence.findings.iter().find_map(|finding| finding.place.device);
            return (blamed == Some(expected), Found::Blamed(blamed));
        }
        let Some(course) = evidence.course else { return (false, Found::NeverInOperation) };
        match self {
            Self::InSync(_) | Self::Blames(_) => unreachable!("looked at above"),
            Self::InSyncAt(when) => in_sync_at(when, course, evidence.end),
            Self::WorstSync0 { device, limit } => worst_sync0(device, limit, course),
            Self::PlantDeviation { device, limit_nm } => {
                plant_deviation(device, limit_nm, evidence.plants)
            }
            Self::RecoversWithin(limit) => recovers_within(limit, course, evidence),
            Self::SafeWithin(limit) => safe_within(limit, course),
        }
    }
}

/// Why a run in which nothing went wrong shows nothing: what was planned to happen did not yet, or
/// all of it fell before operation.
fn untested(course: &Course, evidence: &Evidence<'_>) -> Option<Found> {
    if evidence.is_to_come {
        return Some(Found::RunEnded);
    }
    let mut happened = evidence.happened.iter().peekable();
    happened.peek()?;
    let lasts = |one: &Happened| one.begins && one.lasts.is_none() && one.fault.can_end();
    let is_over = |one: &&Happened| one.at < course.began() && !lasts(one);
    happened.all(is_over).then_some(Found::NoFault)
}

fn in_sync_at(when: When, course: &Course, end: Time<True>) -> (bool, Found) {
    let at = match when {
        When::At(at) => Time::ZERO + Picos::from(at),
        When::After(Moment::InOperation, later) => course.began() + Picos::from(later),
        When::After(Moment::Cycle(_), _) => return (false, Found::RunEnded),
    };
    if at < course.began() {
        return (false, Found::BeforeOperation);
    }
    if at > end {
        return (false, Found::RunEnded);
    }
    match course.out_of_sync_at(at).next() {
        None => (true, Found::AsExpected),
        Some(stretch) => (false, Found::OutOfSync(*stretch)),
    }
}

fn worst_sync0(device: Option<usize>, limit: Nanos, course: &Course) -> (bool, Found) {
    let worst = |device: usize| Some((course.measured_sync0(device)?, device));
    let worst = match device {
        Some(device) => worst(device),
        None => (0..course.devices()).filter_map(worst).max(),
    };
    let Some((error, device)) = worst else { return (false, Found::NoEdge) };
    (error <= Picos::from(limit), Found::Sync0 { device, error })
}

fn plant_deviation(
    device: Option<usize>,
    limit_nm: u64,
    plants: Option<&PlantBench>,
) -> (bool, Found) {
    let Some(plants) = plants else { return (false, Found::NoPlant) };
    let judges = plants.judges().iter();
    let meant = judges.filter(|judge| device.is_none_or(|device| judge.setup().device == device));
    // Rounded up, so that 0 means no deviation at all. A NaN counts as the largest distance.
    let nm = |judge: &PlantJudge| match judge.figures().deviation.largest {
        um if um.is_nan() => u64::MAX,
        um => (um * 1_000.0).ceil() as u64,
    };
    let all: Vec<_> =
        meant.map(|judge| (nm(judge), judge.setup().device, judge.figures().looks)).collect();
    if all.iter().any(|(.., looks)| *looks == 0) {
        return (false, Found::RunEnded);
    }
    match all.iter().max() {
        Some(&(nm, device, _)) => (nm <= limit_nm, Found::Deviation { device, nm }),
        None => (false, Found::RunEnded),
    }
}

fn recovers_within(limit: Nanos, course: &Course, evidence: &Evidence<'_>) -> (bool, Found) {
    let last = evidence.happened.iter().map(|happened| happened.at).max();
    // Nothing recovers from what fell before operation, or from nothing.
    let fell = last.is_some_and(|last| last >= course.began());
    if !fell && course.stretches().is_empty() && course.left_out() == 0 {
        return (false, if evidence.is_to_come { Found::RunEnded } else { Found::NoFault });
    }
    let last = last.unwrap_or(course.began()).max(course.began());
    let until = last + Picos::from(limit);
    // If stretches were left out, the end of the last one is unknown.
    let late = course.stretches().iter().find(|stretch| stretch.open || stretch.to > until);
    if let Some(stretch) = late {
        return (false, Found::OutOfSync(*stretch));
    }
    if course.left_out() > 0 || until > evidence.end || evidence.is_to_come {
        return (false, Found::RunEnded);
    }
    let ends = course.stretches().iter().map(|stretch| stretch.to);
    let took = ends.max().map_or(Picos::ZERO, |end| (end - last).max(Picos::ZERO));
    (true, Found::Recovered(took))
}

fn safe_within(limit: Nanos, course: &Course) -> (bool, Found) {
    let stale = |device: usize| (course.longest_stale(device), device);
    let (age, device) = (0..course.devices()).map(stale).max().unwrap_or_default();
    (age <= Picos::from(limit), Found::Stale { device, age })
}

#[cfg(test)]
mod tests {
    use isocat_wire::AlState;

    use super::*;
    use crate::bench::{Intent, Measured};
    use crate::fault::Fault;
    use crate::judge::Grid;
    use crate::observation::Observed;

    const MS: u64 = 1_000_000_000;

    /// In operation since 100 ms, with a missed event at each of these times, ms; ended at 2 s.
    fn course(missed: &[u64]) -> Course {
        let grid = Grid { cycle: Nanos::millis(1), phase: Nanos::ZERO };
        let intent = Intent {
            reference: 0,
            send: grid,
            sync0: vec![None],
            acting: vec![None],
            exchange: vec![Some(grid)],
            inputs_shifted: Vec::new(),
            sync0_limit: Picos(1_000_000),
            outputs_spread: Picos(1_000_000),
        };
        let mut course = Course::begin(Time::new(100 * MS), &intent, [AlState::Op].into_iter());
        for ms in 101..2_000 {
            let at = Time::new(ms * MS);
            course.observe(0, at, Observed::Sm2, &Measured::default());
            if missed.contains(&ms) {
                course.observe(0, at, Observed::SmEventMissed(1), &Measured::default());
            }
        }
        course.end(Time::new(2_000 * MS));
        course
    }

    fn met(expectation: Expectation, course: &Course, faults: &[u64]) -> bool {
        let happened: Vec<_> = faults
            .iter()
            .map(|ms| Happened {
                at: Time::new(ms * MS),
                fault: Fault::Heal,
                begins: true,
                lasts: None,
            })
            .collect();
        let evidence = Evidence {
            course: Some(course),
            plants: None,
            end: Time::new(2_000 * MS),
            findings: &[],
            happened: happened.iter().collect(),
            is_to_come: false,
        };
        expectation.judge(&evidence).met
    }

    #[test]
    fn recovery_counts_from_the_last_fault_to_the_last_sign() {
        let course = course(&[500, 540]);
        let within = |ms, faults: &[u64]| {
            met(Expectation::RecoversWithin(Nanos::millis(ms)), &course, faults)
        };
        assert!(within(40, &[300, 500]) && !within(39, &[300, 500]));
        // Faults and signs after the end of the run are unknown.
        assert!(within(1_500, &[500]) && !within(1_501, &[500]));
    }

    /// Nothing goes wrong where nothing happens, or all that does falls before operation.
    #[test]
    fn what_tests_nothing_is_not_met() {
        let course = course(&[]);
        let in_sync = |faults: &[u64]| met(Expectation::InSync(true), &course, faults);
        assert_eq!([&[][..], &[50], &[99, 100], &[100]].map(in_sync), [true, false, true, true]);
    }

    #[test]
    fn an_instant_is_in_sync_or_not() {
        let course = course(&[500, 502]);
        let at = |ms| met(Expectation::InSyncAt(When::At(Nanos::millis(ms))), &course, &[]);
        assert_eq!(
            [99, 100, 499, 500, 501, 502, 503, 2_000, 2_001].map(at),
            [false, true, true, false, false, false, true, true, false]
        );
        let after = When::After(Moment::InOperation, Nanos::millis(401));
        assert!(!met(Expectation::InSyncAt(after), &course, &[]));
    }

    #[test]
    fn outputs_in_op_are_safe_within_their_pause() {
        let course = course(&[]);
        let within = |us| met(Expectation::SafeWithin(Nanos::micros(us)), &course, &[]);
        assert!(within(1_000) && !within(999));
    }
}

//! Compares the expectations of a served segment with what its judges saw in true time.
//!
//! The whole service is one run. It begins when all SubDevices that a MainDevice asked for are in
//! OP. It ends when the last MainDevice begins to shut the segment down, or when its frames stop.
//! Everything in between is part of the run, even a restart of the MainDevice.

use isocat_sim::bench::{Intent, Measured};
use isocat_sim::course::Course;
use isocat_sim::expect::{Evidence, Expectation, Found, Judgement};
use isocat_sim::fault::Happened;
use isocat_sim::observation::Observed;
use isocat_sim::{Finding, Timeline};
use isocat_wire::AlState;
use isocat_wire::time::{Time, True};

use crate::server::{LeftOut, Session};
use crate::verdict::Judged;

/// Observes a served segment for its expectations.
pub(crate) struct Watch {
    expectations: Vec<Expectation>,
    /// A fault of the segment file concerns the MainDevice's machine, so it cannot happen here.
    has_host_faults: bool,
    /// The course of the whole service since it first came into operation.
    course: Option<Course>,
    /// By position: whether the judges know the grid of the SubDevice's SYNC0. While a SubDevice is
    /// brought back, its SYNC unit may be configured again.
    on_grid: Vec<bool>,
    /// The end of the run, if nothing follows.
    end: Option<End>,
}

/// An end of the run that is still open.
struct End {
    at: Time<True>,
    /// The course up to that instant.
    course: Course,
    /// The MainDevice asked for a lower state; otherwise its frames stopped.
    on_the_way_down: bool,
}

impl Watch {
    pub fn new(expectations: Vec<Expectation>, has_host_faults: bool, devices: usize) -> Self {
        let on_grid = vec![false; devices];
        Self { expectations, has_host_faults, course: None, on_grid, end: None }
    }

    /// All SubDevices that were asked for are in OP, for the first time or again. Their grids are
    /// those that are now in their registers.
    pub fn in_operation(&mut self, at: Time<True>, intent: &Intent, states: &[AlState]) {
        if self.expectations.is_empty() {
            return;
        }
        let is_in_op = |state: &AlState| *state == AlState::Op;
        self.on_grid = states.iter().map(is_in_op).collect();
        match &mut self.course {
            Some(course) => course.bind(at, intent),
            None => self.course = Some(Course::begin(at, intent, states.iter().copied())),
        }
    }

    /// Whether a run is being observed.
    pub fn follows(&self) -> bool {
        self.course.is_some()
    }

    /// Adds an observation of a SubDevice, and what the judges measured with it. `is_judged`: the
    /// segment is in operation.
    pub fn observe(
        &mut self,
        device: usize,
        at: Time<True>,
        event: Observed,
        measured: &Measured,
        is_judged: bool,
    ) {
        let Some(course) = &mut self.course else { return };
        if let Observed::State(state, _) = event {
            self.on_grid[device] = is_judged && state == AlState::Op;
        }
        let nothing = Measured::default();
        let measured = if self.on_grid[device] { measured } else { &nothing };
        course.observe(device, at, event, measured);
    }

    /// The MainDevice asks for the state `now`, after the state `before`. The shutdown begins with
    /// the first request for a lower state. It does not if the MainDevice is raising SubDevices
    /// again: to OP, or to any state while others are in OP.
    pub fn asked(&mut self, at: Time<True>, (before, now): (AlState, AlState), states: &[AlState]) {
        let Some(course) = &self.course else { return };
        let is_upward = now == AlState::Op || now as u8 > before as u8;
        if is_upward {
            if now == AlState::Op || states.contains(&AlState::Op) {
                self.end = None;
            }
        } else if self.end.is_none() {
            self.end = Some(End::of(course, at, true));
        }
    }

    /// Frames have stopped after the one that left at `last`: later events may be effects of the
    /// silence.
    pub fn is_silent(&mut self, last: Time<True>) {
        if let (Some(course), None) = (&self.course, &self.end) {
            self.end = Some(End::of(course, last, false));
        }
    }

    /// Frames have resumed, so the silence was part of the run.
    pub fn goes_on(&mut self) {
        self.end.take_if(|end| !end.on_the_way_down);
    }

    /// The judgements of the expectations as of `now`.
    pub fn judgements<'a>(
        &self,
        now: Time<True>,
        sessions: impl Iterator<Item = &'a Session>,
        timeline: &Timeline,
        left_out: LeftOut,
    ) -> Vec<Judgement> {
        let Some(whole) = self.course.as_ref().map(|course| End::of(course, now, false)) else {
            let found = Found::NeverInOperation;
            let unmet = |expectation: &Expectation| unmet(*expectation, found);
            return self.expectations.iter().map(unmet).collect();
        };
        let end = self.end.as_ref().unwrap_or(&whole);
        let findings = findings(sessions);
        let (happened, later): (Vec<&Happened>, Vec<_>) =
            timeline.happened().partition(|happened| happened.at <= end.at);
        let is_to_come = timeline.is_to_come() || later.iter().any(|happened| happened.begins);
        let nothing_happens = self.has_host_faults && happened.is_empty() && !is_to_come;
        let [evidence, to_its_end] = [end, &whole].map(|end| Evidence {
            course: Some(&end.course),
            plants: None,
            end: end.at,
            findings: &findings,
            happened: happened.clone(),
            is_to_come,
        });
        let judge = |expectation: &Expectation| match expectation {
            Expectation::InSync(_) | Expectation::Blames(_) if left_out.sessions > 0 => {
                unmet(*expectation, Found::Forgotten)
            }
            Expectation::RecoversWithin(_) if nothing_happens => {
                unmet(*expectation, Found::NoFault)
            }
            // Outputs must go safe even if frames stop in the middle.
            Expectation::SafeWithin(_) => expectation.judge(&to_its_end),
            _ => expectation.judge(&evidence),
        };
        self.expectations.iter().map(judge).collect()
    }

    /// The instant at which SubDevices first came into operation; `None` before that, or without
    /// expectations.
    pub fn began(&self) -> Option<Time<True>> {
        self.course.as_ref().map(Course::began)
    }
}

impl End {
    fn of(course: &Course, at: Time<True>, on_the_way_down: bool) -> Self {
        let mut course = course.clone();
        course.end(at);
        Self { at, course, on_the_way_down }
    }
}

fn unmet(expectation: Expectation, found: Found) -> Judgement {
    Judgement { expectation, met: false, found }
}

/// The findings of all stretches of operation, in the order of time. A finding without a time of
/// its own comes last.
fn findings<'a>(sessions: impl Iterator<Item = &'a Session>) -> Vec<Finding> {
    let stretches = sessions.flat_map(|session| session.earlier.iter().chain(&session.judged));
    let of_stretch = |judged: &'a Judged| {
        judged
            .all_findings()
            .map(|finding| (finding.since.map(|since| judged.began + since.into()), finding))
    };
    let mut all: Vec<_> = stretches.flat_map(of_stretch).collect();
    all.sort_by_cached_key(|(at, _)| at.unwrap_or(Time::NEVER).count());
    all.into_iter().map(|(_, finding)| finding.clone()).collect()
}

#[cfg(test)]
mod tests {
    use isocat_sim::judge::Grid;
    use isocat_wire::AlState::*;
    use isocat_wire::time::{Nanos, Picos};

    use super::*;

    const MS: u64 = 1_000_000_000;

    /// A segment in operation since 100 ms.
    fn watch(expectations: &[Expectation]) -> Watch {
        let grid = Grid { cycle: Nanos::millis(1), phase: Nanos::ZERO };
        let intent = Intent {
            reference: 0,
            send: grid,
            sync0: vec![None; 2],
            acting: vec![None; 2],
            exchange: vec![None; 2],
            inputs_shifted: Vec::new(),
            sync0_limit: Picos(1_000_000),
            outputs_spread: Picos(1_000_000),
        };
        let mut watch = Watch::new(expectations.to_vec(), false, 2);
        watch.in_operation(Time::new(100 * MS), &intent, &[Op, Op]);
        watch
    }

    fn end_after(requests: &[(u64, AlState, [AlState; 2])]) -> Option<u64> {
        let mut watch = watch(&[Expectation::InSync(true)]);
        let mut before = Op;
        for (ms, state, states) in requests {
            watch.asked(Time::new(ms * MS), (before, *state), states);
            before = *state;
        }
        watch.end.map(|end| end.at.count() / MS)
    }

    #[test]
    fn the_way_down_begins_with_the_first_request_for_a_lower_state() {
        let up = [Op, Op];
        assert_eq!(end_after(&[]), None);
        assert_eq!(end_after(&[(200, SafeOp, up), (300, PreOp, up), (400, Init, up)]), Some(200));
        // A SubDevice that left OP is brought back.
        let fallen = [Op, SafeOp];
        assert_eq!(end_after(&[(200, SafeOp, fallen), (201, Op, fallen)]), None);
        // It cannot be brought back, until all are shut down.
        let tries = [(200, Init, fallen), (201, PreOp, fallen), (300, Init, fallen)];
        assert_eq!(end_after(&tries), Some(300));
        // All were shut down, and a program then scans the segment.
        let down = [Init, Init];
        assert_eq!(end_after(&[(200, Init, up), (900, PreOp, down), (999, Init, down)]), Some(200));
        assert_eq!(end_after(&[(200, Init, up), (900, PreOp, down), (999, Op, down)]), None);
    }

    #[test]
    fn findings_that_are_forgotten_are_not_judged() {
        let watch = watch(&[Expectation::InSync(true), Expectation::Blames(0)]);
        let timeline = Timeline::new(Vec::new(), 1);
        let of = |sessions| {
            let left_out = LeftOut { sessions, faults: 0 };
            let none = std::iter::empty();
            watch.judgements(Time::new(900 * MS), none, &timeline, left_out)
        };
        let [in_sync, blames] = of(0)[..] else { panic!("two") };
        assert!((in_sync.met, blames.met) == (true, false) && blames.is_judged());
        assert!(of(1).iter().all(|one| !one.met && one.found == Found::Forgotten));
    }
}

//! The events in a cycle of each SubDevice, in true time: events, steps, and the instants that the
//! sync objects define.

use std::fmt;

use isocat_segment::Scenario;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Tap};
pub use isocat_sync::Moment;
use isocat_wire::AlState;
use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::{Report, moment, watched};

/// Cycles of one SubDevice in operation.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Timeline {
    /// Events in true time from the beginning of the first cycle.
    pub entries: Vec<(Picos, Moment)>,
}

/// Runs a scenario and records `cycles` cycles of one SubDevice, from the next frame at least
/// `after` its change to OP.
pub fn record(scenario: &Scenario, device: usize, after: Nanos, cycles: u32) -> (Timeline, Report) {
    let recorder = Recorder { device, after, cycles, ..Recorder::default() };
    let mut recorded = None;
    let run = scenario.run();
    let tap = Shared(std::rc::Rc::new(std::cell::RefCell::new(recorder)));
    let mut theirs = tap.clone();
    let outcome = watched(run, &mut theirs, &mut |_| {});
    let report = Report::new(scenario, &outcome);
    recorded.replace(std::mem::take(&mut tap.0.borrow_mut().timeline));
    (recorded.unwrap_or_default(), report)
}

#[derive(Clone)]
struct Shared(std::rc::Rc<std::cell::RefCell<Recorder>>);

#[derive(Default)]
struct Recorder {
    device: usize,
    after: Nanos,
    cycles: u32,
    in_op: Option<Time<True>>,
    began: Option<Time<True>>,
    /// Begin of the first cycle that is not recorded.
    end: Option<Time<True>>,
    frames: u32,
    timeline: Timeline,
}

impl Tap for Shared {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let mut recorder = self.0.borrow_mut();
        let Some(in_op) = recorder.in_op else { return };
        if !sent || at < in_op + Picos::from(recorder.after) || !has_process_data(bytes) {
            return;
        }
        if recorder.frames == recorder.cycles {
            recorder.end.get_or_insert(at);
            return;
        }
        recorder.frames += 1;
        recorder.began.get_or_insert(at);
        recorder.note(at, Moment::Frame);
    }

    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        let mut recorder = self.0.borrow_mut();
        if observation.device != recorder.device {
            return;
        }
        if let Observed::State(AlState::Op, _) = observation.event {
            recorder.in_op.get_or_insert(at);
        }
        if let Some(moment) = moment::of(observation.event) {
            recorder.note(at, moment);
        }
    }
}

impl Recorder {
    fn note(&mut self, at: Time<True>, moment: Moment) {
        let over = self.end.is_some_and(|end| at >= end);
        if let Some(began) = self.began.filter(|began| at >= *began && !over) {
            self.timeline.entries.push((at - began, moment));
            // Frames are noted when they are sent, but SubDevices only when they are polled.
            self.timeline.entries.sort_by_key(|(at, _)| *at);
        }
    }
}

fn has_process_data(bytes: &[u8]) -> bool {
    let Ok(payload) = isocat_wire::frame::payload(bytes) else { return false };
    isocat_wire::datagram::datagrams(payload)
        .flatten()
        .any(|datagram| datagram.header.command().is_ok_and(|command| command.is_logical()))
}

/// One line for each event: microseconds from the beginning, with three decimals.
impl fmt::Display for Timeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, moment) in &self.entries {
            writeln!(f, "{:>12.3} us  {}", at.0 as f64 / 1e6, moment.words())?;
        }
        Ok(())
    }
}

//! A judge of one's own: a tap sees every frame, every event at a SubDevice and every figure of the
//! built-in judges, in true time.
//!
//! This one asks what no built-in judge does: do the outputs of the two drives of the built-in
//! segment become valid within 1 us of each other, in every cycle?
//!
//! `cargo run --release -p isocat --example 06_judge_of_ones_own`

use isocat::{Nanos, Scenario, SegmentFile};
use isocat_sim::Tap;
use isocat_sim::bench::Intent;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::segment::Segment;
use isocat_subdevice::Step;
use isocat_wire::time::{Picos, Time, True};

#[derive(Default)]
struct Together {
    judging: bool,
    /// When the outputs of SubDevices 0 and 1 became valid last.
    valid: [Option<Time<True>>; 2],
    cycles: u64,
    worst: Picos,
}

impl Tap for Together {
    fn frame(&mut self, _at: Time<True>, _sent: bool, _bytes: &[u8]) {}

    fn judging_begins(&mut self, _at: Time<True>, _intent: &Intent) {
        self.judging = true;
    }

    fn observed(&mut self, _segment: &Segment, at: Time<True>, observation: &Observation) {
        if !self.judging || observation.event != Observed::Began(Step::OutputsValid) {
            return;
        }
        let Some(valid) = self.valid.get_mut(observation.device) else { return };
        *valid = Some(at);
        if let [Some(first), Some(second)] = self.valid {
            let apart = if first < second { second - first } else { first - second };
            self.worst = self.worst.max(apart);
            self.cycles += 1;
            self.valid = [None; 2];
        }
    }
}

fn main() {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(500);

    let outcome = scenario.run().execute(Some(Together::default()), &mut |_| {});

    let judge = outcome.world.into_tap().expect("the tap that went in");
    println!("{} cycles: outputs at most {} ps apart", judge.cycles, judge.worst.0);
    assert!(judge.cycles > 490, "once a cycle");
    assert!(judge.worst < Picos(1_000_000), "within 1 us");
    // Two clocks are never the same: no difference at all would mean that nothing was measured.
    assert!(judge.worst > Picos(0), "too good to be true");
}

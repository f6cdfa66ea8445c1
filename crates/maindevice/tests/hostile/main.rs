//! A MainDevice on a wire with wrong answers: each call costs bounded work and memory, each run
//! ends with a named cause, and if one SubDevice lies, no other one is blamed. `ISOCAT_SEEDS=N`
//! tries N seeds, `ISOCAT_FIRST_SEED=N` starts at that seed.
//!
//! `-- --nocapture` prints a table; `cargo run --release -p isocat-host
//! --example hostile_wire 100000` times the calls.

mod device;
mod lies;
mod run;

use std::collections::BTreeMap;

use lies::{Lie, Wire};
use run::{Call, End, Meter, Story, Wishes};

/// Counts the allocations of calls: a measure of work that is the same in every run.
#[derive(Default)]
struct Allocations {
    /// Most allocations, and most bytes, of one call.
    worst: (u64, u64),
    bytes: i64,
    most_bytes: i64,
}

impl Meter for Allocations {
    fn call<R>(&mut self, _: Call, call: impl FnOnce() -> R) -> R {
        let mut result = None;
        let counted = allocation_counter::measure(|| result = Some(call()));
        self.worst.0 = self.worst.0.max(counted.count_total);
        self.worst.1 = self.worst.1.max(counted.bytes_total);
        self.bytes += counted.bytes_current;
        self.most_bytes = self.most_bytes.max(self.bytes);
        result.expect("it was called")
    }
}

/// Most allocations of one call, for each SubDevice and one more. A call that begins a stage queues
/// some datagrams for each SubDevice.
const MOST_ALLOCATIONS: u64 = 100;
/// Most bytes of one call, for each of them. The quality watch needs the most, once, for its
/// readings.
const MOST_BYTES: u64 = 300_000;
/// Most bytes held, for each of them.
const MOST_HELD: i64 = 200_000;

fn number(name: &str, default: u64) -> u64 {
    let text = std::env::var(name).ok();
    text.map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

#[test]
fn honest_segments_come_up() {
    for seed in 0..40 {
        let mut story = Story::of_seed(seed);
        (story.liars, story.wire, story.wishes.survey) = (Vec::new(), Wire::default(), false);
        let outcome = run::run(&story, &mut Allocations::default());
        assert_eq!(outcome.end, End::Stopped, "seed {seed}: {story:?}");
        assert!(outcome.was_up && outcome.statistics.frames_missed() == 0, "seed {seed}");
    }
}

#[test]
fn whatever_is_answered_costs_bounded_work_and_ends() {
    let first = number("ISOCAT_FIRST_SEED", 0);
    let mut ends: BTreeMap<(String, String), [u64; 3]> = BTreeMap::new();
    let (mut longest, mut most_frames, mut worst, mut most_bytes) = ((0, 0), (0, 0), (0, 0), 0);
    let (mut failed, mut named) = (0, 0);
    let mut bad = Vec::new();
    for seed in first..first + number("ISOCAT_SEEDS", 200) {
        let story = Story::of_seed(seed);
        let mut meter = Allocations::default();
        let outcome = run::run(&story, &mut meter);
        let name = match &outcome.end {
            End::Stopped => "stopped".into(),
            End::Failed(cause) => cause.name().into(),
            End::Endless => "ENDLESS".into(),
        };
        let lie = match story.liars[..] {
            [(_, lie, ..)] if story.wire.is_honest() && story.wishes.patient => {
                format!("{lie:?}, patient")
            }
            [(_, lie, ..)] if story.wire.is_honest() => format!("{lie:?}"),
            _ => "several".into(),
        };
        let [count, frames, took] = ends.entry((lie, name)).or_default();
        *count += 1;
        *frames = outcome.statistics.frames_sent.max(*frames);
        *took = outcome.took.max(*took);
        longest = longest.max((outcome.took, seed));
        most_frames = most_frames.max((outcome.statistics.frames_sent, seed));
        worst = (worst.0.max(meter.worst.0), worst.1.max(meter.worst.1));
        most_bytes = most_bytes.max(meter.most_bytes);
        if story.author().is_some() && matches!(outcome.end, End::Failed(_)) {
            failed += 1;
            named += u64::from(outcome.named);
        }
        let devices = story.makes.len() as u64;
        let (allocations, bytes) = meter.worst;
        let is_bounded = allocations <= MOST_ALLOCATIONS * (devices + 1)
            && bytes <= MOST_BYTES * (devices + 1)
            && meter.most_bytes <= MOST_HELD * (devices as i64 + 1);
        if outcome.end == End::Endless || !outcome.wrong_blame.is_empty() || !is_bounded {
            bad.push((seed, story, outcome.end, outcome.wrong_blame));
        }
    }
    println!("{:>24} {:>14} {:>6} {:>8} {:>8}", "lie", "end", "runs", "frames", "ms");
    for ((lie, name), [count, frames, took]) in &ends {
        println!("{lie:>24} {name:>14} {count:6} {frames:8} {:8}", took / 1_000_000);
    }
    println!("one liar ended {failed} runs, and is named in {named} of them");
    println!("longest run {} ms (seed {})", longest.0 / 1_000_000, longest.1);
    println!("most frames {} (seed {})", most_frames.0, most_frames.1);
    println!(
        "one call: at most {} allocations, {} bytes; held: {most_bytes} bytes",
        worst.0, worst.1
    );
    for (seed, story, end, blame) in bad.iter().take(20) {
        let blame = blame.first();
        println!(
            "seed {seed}: {} devices, {:?}, {end:?} {blame:?}",
            story.makes.len(),
            story.liars
        );
    }
    assert!(bad.is_empty(), "{} seeds", bad.len());
}

/// A clock that never converges is waited for as long as any other, but without loading the line.
#[test]
fn a_hostile_clock_is_waited_for_with_patience() {
    for lie in [Lie::Times, Lie::Difference] {
        for seed in 0..number("ISOCAT_SEEDS", 200) / 10 {
            let mut story = Story::of_seed(seed);
            let make = device::Make { clock: true, mailbox: false };
            let position = seed as usize % 3;
            (story.makes, story.liars) = (vec![make; 3], vec![(position, lie, 0, u64::MAX)]);
            story.wire = Wire::default();
            story.wishes = Wishes { patient: true, ..Wishes::default() };
            let outcome = run::run(&story, &mut Allocations::default());
            // 30 s at the rate of the first five seconds would be 310 000 frames.
            let frames = outcome.statistics.frames_sent;
            assert!(frames < 100_000, "{lie:?} {seed}: {frames} frames, {:?}", outcome.end);
            if let End::Failed(cause) = &outcome.end
                && let Some(place) = cause.place()
                && position > 0
            {
                assert_eq!(place.position, position, "{lie:?} {seed}: {cause}");
            }
        }
    }
}

/// A working counter of thousands costs only as much as the plan requires.
#[test]
fn work_grows_with_the_plan_and_not_with_what_is_claimed() {
    let worst = |count| {
        let mut story = Story::of_seed(1);
        story.makes = vec![device::Make { clock: false, mailbox: false }; count];
        // From its 700th datagram on the segment is in operation.
        story.liars = vec![(count / 2, Lie::CountsThousands, 700, u64::MAX)];
        (story.wire, story.wishes) = (Wire::default(), Wishes::default());
        let mut meter = Allocations::default();
        let outcome = run::run(&story, &mut meter);
        assert!(outcome.was_up && outcome.told > 0, "{count}: {:?}", outcome.end);
        meter.worst
    };
    let (few, many) = (worst(50), worst(200));
    assert!(many.0 < 6 * few.0 && many.1 < 6 * few.1, "{few:?} {many:?}");
}

/// Scripts of random bytes, as in the fuzz target.
#[test]
fn answers_that_follow_a_script_end_as_well() {
    let mut random = lies::Random(1);
    for _ in 0..number("ISOCAT_SEEDS", 200) {
        let len = random.below(200) as usize;
        let script: Vec<u8> = (0..len).map(|_| random.extreme() as u8).collect();
        run::follow(&script);
    }
}

#[test]
fn each_lie_is_told() {
    for lie in Lie::ALL {
        let told = |seed| {
            let mut story = Story::of_seed(seed);
            let make = device::Make { clock: true, mailbox: true };
            (story.makes, story.liars) = (vec![make; 3], vec![(1, lie, 0, u64::MAX)]);
            (story.wire, story.wishes) = (Wire::default(), Wishes::default());
            (story.wishes.requests, story.wishes.each_sii) = (true, true);
            run::run(&story, &mut Allocations::default()).told
        };
        assert!((0..3).any(|seed| told(seed) > 0), "{lie:?}");
    }
}

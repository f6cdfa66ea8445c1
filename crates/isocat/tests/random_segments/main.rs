//! Random segments of the built-in devices, in all their modes: what the plan says fits, runs in
//! sync, and its proof holds.
//!
//! A few are always tried. `ISOCAT_SEGMENTS=1000 cargo test --test random_segments --
//! --nocapture` tries as many as one likes, `ISOCAT_SEGMENTS_FROM` says with which number to begin.

mod generator;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use isocat::plan::{Plan, proof};
use isocat::profile;
use isocat::{Nanos, Scenario, SegmentFile};

use generator::{Drawn, draw};

/// What became of a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Fate {
    /// The file can't be, or no plan: a port that is taken, a mode that an ESC has no clock for.
    Refused,
    /// A line does not fit.
    DoesNotFit,
    /// It fits, is proven and runs in sync.
    InSync,
    /// It fits and fails, and a device needs longer than it states.
    Liar,
}

const FATES: [Fate; 4] = [Fate::Refused, Fate::DoesNotFit, Fate::InSync, Fate::Liar];

/// Tries one; the error is what the plan promised and the run did not keep.
fn try_one(number: u64) -> Result<Fate, String> {
    let Drawn { text, honest } = draw(number);
    let Ok(file) = SegmentFile::parse("random.toml", &text) else { return Ok(Fate::Refused) };
    let mut scenario = Scenario::from(file);
    scenario.duration = Nanos::millis(100).max(Nanos(scenario.cycle.0 * LEAST_CYCLES));
    let Ok(plan) = Plan::of(&scenario) else { return Ok(Fate::Refused) };
    if !plan.fits() {
        return Ok(Fate::DoesNotFit);
    }
    let mut report = plan.report(&scenario);
    proof::prove(&plan, &scenario).fill(&mut report);
    let proof = report.proof.expect("it was proven");
    let run = isocat::run(&scenario);
    match (proof.holds && run.in_sync, honest) {
        (true, _) => Ok(Fate::InSync),
        (false, false) => Ok(Fate::Liar),
        (false, true) => {
            let run: Vec<_> = run.findings.iter().map(|finding| finding.sentence()).collect();
            let found = (proof.findings.join("\n  "), run.join("\n  "));
            Err(format!("segment {number}:\nproof: {}\nrun: {}\n{text}", found.0, found.1))
        }
    }
}

/// Tries all with two at a time; how many had each fate, and what was not kept.
fn try_all(numbers: std::ops::Range<u64>) -> ([u64; FATES.len()], Vec<String>) {
    let next = AtomicU64::new(numbers.start);
    let results = Mutex::new(([0; FATES.len()], Vec::new()));
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= numbers.end {
                return;
            }
            let fate = try_one(number);
            let (counts, failures) = &mut *results.lock().expect("no thread panicked");
            match fate {
                Ok(fate) => counts[fate as usize] += 1,
                Err(what) => {
                    println!("{what}");
                    failures.push(what);
                }
            }
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(work);
        scope.spawn(work);
    });
    results.into_inner().expect("no thread panicked")
}

fn check(numbers: std::ops::Range<u64>) {
    let all = numbers.end - numbers.start;
    let (counts, failures) = try_all(numbers);
    for (fate, count) in FATES.iter().zip(counts) {
        println!("{fate:?}: {count}");
    }
    println!("not kept: {}", failures.len());
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    // Who refuses everything promises nothing.
    let [refused, unfit, in_sync, _] = counts;
    assert!(in_sync * 4 >= all, "{in_sync} of {all} ran");
    assert!(refused > 0 && unfit > 0, "{refused} refused, {unfit} do not fit");
}

#[test]
fn a_plan_that_fits_is_kept() {
    let number = |name: &str, otherwise: u64| {
        let text = std::env::var(name).ok();
        text.map_or(otherwise, |text| text.parse().expect("a number of segments"))
    };
    let from = number("ISOCAT_SEGMENTS_FROM", 0);
    check(from..from + number("ISOCAT_SEGMENTS", FEW));
}

/// Number of segments that are tried by default.
const FEW: u64 = 30;
/// Cycles that each runs at least.
const LEAST_CYCLES: i64 = 50;

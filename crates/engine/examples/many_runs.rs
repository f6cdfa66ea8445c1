//! Runs a segment file with the seeds from 1 to SEEDS, one after another: in a loop, or as a sweep
//! on one thread.
//!
//! `cargo run --release -p isocat-engine --example many_runs -- SEGMENT.toml loop SEEDS`
//!
//! It is what `crates/isocat-py/benches/overhead.py` compares the library for Python with.

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use isocat_engine::run;
use isocat_engine::sweep::Sweep;
use isocat_segment::{Scenario, SegmentFile};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, way, seeds] = arguments.as_slice() else {
        eprintln!("expected: SEGMENT.toml loop|sweep SEEDS");
        return ExitCode::FAILURE;
    };
    let Ok(seeds) = seeds.parse::<u64>() else {
        eprintln!("SEEDS: found {seeds}; expected a whole number");
        return ExitCode::FAILURE;
    };
    let good = match way.as_str() {
        "loop" => in_a_loop(path, seeds),
        "sweep" => as_a_sweep(path, seeds),
        _ => Err(format!("found {way}; expected loop or sweep")),
    };
    match good {
        Ok(good) => {
            println!("{good} of {seeds} runs as expected");
            ExitCode::SUCCESS
        }
        Err(why) => {
            eprintln!("{why}");
            ExitCode::FAILURE
        }
    }
}

/// The file is read once.
fn in_a_loop(path: &str, seeds: u64) -> Result<u64, String> {
    let file = SegmentFile::read(path).map_err(|error| error.to_string())?;
    let mut scenario = Scenario::from(file);
    let mut good = 0;
    for seed in 1..=seeds {
        scenario.seed = seed;
        good += u64::from(run(&scenario).as_expected());
    }
    Ok(good)
}

/// Each run has a segment file of its own.
fn as_a_sweep(path: &str, seeds: u64) -> Result<u64, String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    let mut sweep = Sweep::new(path, &text).map_err(|error| error.to_string())?;
    sweep.seeds(1, seeds);
    let mut good = 0;
    sweep.run_all(0, 1, &AtomicBool::new(false), |row| {
        good += u64::from(row.outcome.as_expected);
        Ok::<(), String>(())
    })?;
    Ok(good)
}

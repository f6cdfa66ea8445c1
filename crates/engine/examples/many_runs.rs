//! Runs a segment file with the seeds from 1 to SEEDS, one after another.
//!
//! `cargo run --release -p isocat-engine --example many_runs -- SEGMENT.toml SEEDS`
//!
//! It is what `crates/isocat-py/benches/overhead.py` compares the library for Python with.

use std::process::ExitCode;

use isocat_engine::run;
use isocat_segment::{Scenario, SegmentFile};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, seeds] = arguments.as_slice() else {
        eprintln!("expected: SEGMENT.toml SEEDS");
        return ExitCode::FAILURE;
    };
    let Ok(seeds) = seeds.parse::<u64>() else {
        eprintln!("SEEDS: found {seeds}; expected a whole number");
        return ExitCode::FAILURE;
    };
    let mut scenario = match SegmentFile::read(path) {
        Ok(file) => Scenario::from(file),
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    let mut in_sync = 0;
    for seed in 1..=seeds {
        scenario.seed = seed;
        in_sync += u64::from(run(&scenario).in_sync);
    }
    println!("{in_sync} of {seeds} runs in sync");
    ExitCode::SUCCESS
}

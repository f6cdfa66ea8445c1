//! Brings the built-in segment into synchronization, runs it for a second and looks at the result.
//!
//! `cargo run --release -p isocat --example 01_run_a_segment`

use isocat::{Nanos, Scenario, SegmentFile, run};

fn main() {
    // A segment of your own: SegmentFile::read("my.toml")
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(1_000);

    let report = run(&scenario);

    println!("{}", report.verdict);
    for device in &report.devices {
        match device.true_time.sync0_error {
            Some(error) => println!("{}: SYNC0 at most {} ns off", device.name, error.worst_ns),
            None => println!("{}: {}, no SYNC0", device.name, device.mode),
        }
    }
}

//! The clock servo against other laws: `servo [STARTS]`, default 100.
//!
//! Prints the table of `docs/servo.md`. Everything is virtual time from fixed seeds, so the output
//! is the same on every machine.

use std::process::ExitCode;

mod figures;
mod hosts;
mod laws;
mod race;

use figures::{Summary, Times};

fn main() -> ExitCode {
    let starts = std::env::args().nth(1).map_or(Ok(100), |text| text.parse());
    let Ok(starts) = starts else {
        eprintln!("usage: servo [STARTS]");
        return ExitCode::FAILURE;
    };
    println!(
        "| host | law | lock on target, ms | lock on own mean, ms | mean phase, us | repeats within, us | \
         deadlines within, us | earliest, us | latest, us | window, us | recovery, ms |"
    );
    println!("|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
    for course in hosts::COURSES {
        for law in laws::LAWS {
            let summary = Summary::of(&law, &course, starts);
            let micros = |ps: i64| ps as f64 / 1e6;
            println!(
                "| {} | {} | {} | {} | {:.2} | {:.3} | {:.3} | {:.2} | {:.2} | {:.2} | {} |",
                course.name,
                law.name,
                times(summary.lock, starts),
                times(summary.own_lock, starts),
                summary.mean / 1e6,
                summary.repeat / 1e6,
                micros(summary.worst),
                micros(summary.earliest),
                micros(summary.latest),
                micros(summary.latest - summary.earliest),
                if course.disturbance.is_some() {
                    times(summary.recovery, starts)
                } else {
                    "".into()
                },
            );
        }
    }
    ExitCode::SUCCESS
}

/// Median and worst time; if not all starts reach it, the number that do.
fn times(times: Times, starts: u64) -> String {
    let millis = |ps: i64| ps / 1_000_000_000;
    match times.reached as u64 {
        0 => "never".into(),
        all if all == starts => format!("{}, worst {}", millis(times.median), millis(times.worst)),
        some => format!("{} in {some} of {starts}", millis(times.median)),
    }
}

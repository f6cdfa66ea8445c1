//! Cost and memory of a line of N SubDevices: `scale N CYCLES [main|judged|mailbox|constant]`.
//!
//! Prints processor time of one cycle, and of one SubDevice and cycle, and resident bytes of one
//! SubDevice. With `main` the MainDevice runs the line, and with `judged` the judges look on as
//! well; without them frames are made before and only the segment works. With `mailbox` the
//! SubDevices have one, and with `constant` each hop takes all frames the same time.

use std::process::ExitCode;
use std::time::Duration;

#[path = "../benches/line/mod.rs"]
mod line;

use isocat_wire::Nanos;
use line::{Line, run_cycles, world};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| arguments.get(at).and_then(|text| text.parse::<u64>().ok());
    let (Some(count), Some(cycles)) = (number(0), number(1)) else {
        eprintln!("usage: scale N CYCLES [main|judged|mailbox|constant]");
        return ExitCode::FAILURE;
    };
    let count = count as usize;
    let before = resident();
    let with = arguments.get(2).map_or("", String::as_str);
    let (elapsed, after) = if matches!(with, "main" | "judged") {
        let mut world = match world(count) {
            Ok(world) => world,
            Err(error) => {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        };
        if with == "judged" {
            let intent = isocat_sim::run::intent(world.main(), Nanos::micros(1));
            world.begin_judging(intent);
        }
        let start = processor_time();
        let wrong = run_cycles(&mut world, cycles);
        let elapsed = processor_time().saturating_sub(start);
        assert_eq!(wrong, 0, "wrong working counters");
        (elapsed, resident())
    } else {
        let mut line = match with {
            "mailbox" => Line::with_mailbox(count),
            "constant" => Line::with_constant_hops(count),
            _ => Line::new(count),
        };
        let start = processor_time();
        for _ in 0..cycles {
            line.cycle();
        }
        let elapsed = processor_time().saturating_sub(start);
        line.assert_applications_ran();
        (elapsed, resident())
    };
    let bytes = after.saturating_sub(before) / count.max(1) as u64;
    let cycle = elapsed.as_nanos() as f64 / cycles.max(1) as f64;
    println!(
        "{count} SubDevices: {:.1} us a cycle, {:.1} ns and {bytes} bytes each",
        cycle / 1000.0,
        cycle / count.max(1) as f64
    );
    ExitCode::SUCCESS
}

/// Processor time of this thread from Linux, which excludes other programs; 0 on other systems.
fn processor_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let running = text.split_whitespace().next().and_then(|ns| ns.parse().ok());
    Duration::from_nanos(running.unwrap_or(0))
}

/// Resident memory of this process, bytes; 0 if the system does not report it.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB")).and_then(|kb| kb.parse().ok());
    kib.unwrap_or(0u64) * 1024
}

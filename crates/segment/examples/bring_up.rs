//! What the way up of a segment costs, stage by stage: `bring_up SEGMENT.toml...`.
//!
//! Virtual time, frames and bytes on the wire (with preamble, frame check sequence and gap), and
//! the worst SYNC0 error in the judged time behind it. All figures repeat exactly. Exit code 1 if a
//! segment does not come up.

use std::process::ExitCode;

use isocat_maindevice::{Event, Stage};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::Tap;
use isocat_wire::time::{Time, True};

/// Octets on the wire beside those of a frame: preamble, frame check sequence, gap.
const AROUND: usize = 8 + 4 + 12;
/// Shortest frame without its check sequence.
const SHORTEST: usize = 60;

fn main() -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for path in std::env::args().skip(1) {
        let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
        let file = SegmentFile::parse(&path, &text).unwrap_or_else(|error| panic!("{error}"));
        if !show(&path, &Scenario::from(file)) {
            code = ExitCode::FAILURE;
        }
    }
    code
}

/// Runs a segment and prints its table; whether it came up.
fn show(path: &str, scenario: &Scenario) -> bool {
    let outcome = scenario.run().execute(Some(Stages::default()), &mut |_| {});
    println!("{path}, {} SubDevices", scenario.devices.len());
    let worst = |of: &dyn Fn(&isocat_sim::judge::Sync0Error) -> f64| {
        let errors = outcome.bench.devices().iter().filter_map(|device| device.sync0.as_ref());
        errors.map(of).fold(0.0, f64::max)
    };
    let single = worst(&|error| error.statistics().worst() as f64 / 1e3);
    let mean = worst(&|error| error.statistics().mean().abs() / 1e3);
    let failure = outcome.failure.as_ref().map(ToString::to_string);
    let in_sync = outcome.in_sync();
    let converged = outcome.world.main().statistics().time_to_converged;
    let stages = outcome.world.into_tap().unwrap_or_default();
    stages.print();
    if let Some(failure) = failure {
        println!("{failure}");
        return false;
    }
    let converged = converged.map_or(0.0, |time| time.0 as f64 / 1e6);
    println!(
        "clocks converged after {converged:.1} ms; SYNC0 in {:.1} s: worst {single:.0} ns, largest mean {mean:.0} ns; in sync: {in_sync}",
        scenario.duration.0 as f64 / 1e9
    );
    true
}

/// What each stage took, in the order of the way.
#[derive(Default)]
struct Stages {
    all: Vec<Row>,
    over: bool,
}

struct Row {
    stage: Stage,
    since: Time<True>,
    until: Time<True>,
    frames: u64,
    /// Those with a system time for all clocks and nothing else.
    drift: u64,
    octets: u64,
}

impl Tap for Stages {
    fn frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        let Some(row) = self.all.last_mut().filter(|_| sent && !self.over) else { return };
        row.frames += 1;
        row.octets += (bytes.len().max(SHORTEST) + AROUND) as u64;
        // One datagram behind both headers: FRMW, and no other follows.
        row.drift += u64::from(
            bytes.get(16) == Some(&14) && bytes.get(23).is_some_and(|more| more & 0x80 == 0),
        );
    }

    fn event(&mut self, at: Time<True>, event: &Event) {
        if self.over {
            return;
        }
        if let Some(row) = self.all.last_mut() {
            row.until = at;
        }
        match event {
            Event::Progress(stage) => {
                self.all.push(Row {
                    stage: *stage,
                    since: at,
                    until: at,
                    frames: 0,
                    drift: 0,
                    octets: 0,
                });
            }
            Event::InOperation { .. } | Event::Failed(_) => self.over = true,
            _ => {}
        }
    }
}

impl Stages {
    fn print(&self) {
        println!("| stage | ms | frames | of these drift alone | bytes | wire |");
        println!("|---|---:|---:|---:|---:|---:|");
        let (mut frames, mut drift, mut octets) = (0, 0, 0);
        for row in &self.all {
            let ms = (row.until - row.since).0 as f64 / 1e9;
            let used = if ms > 0.0 { row.octets as f64 * 8e-5 / ms * 100.0 } else { 0.0 };
            println!(
                "| {} | {ms:.1} | {} | {} | {} | {used:.0} % |",
                row.stage, row.frames, row.drift, row.octets
            );
            frames += row.frames;
            drift += row.drift;
            octets += row.octets;
        }
        let end = self.all.last().map_or(0.0, |row| row.until.count() as f64 / 1e9);
        println!("| cold to OP | {end:.1} | {frames} | {drift} | {octets} | |");
    }
}

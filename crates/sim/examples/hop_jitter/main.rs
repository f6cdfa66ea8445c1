//! How far SYNC0 and 0x092C spread along a line, with the jitter of hops and without: the table of
//! `docs/dc.md`.
//!
//! ```text
//! cargo run --release -p isocat-sim --example hop_jitter
//! ```

#[path = "../../benches/line/mod.rs"]
mod line;
mod spread;

use spread::{Course, spread};

fn main() {
    let course = |devices, hop_jitter| Course {
        devices,
        hop_jitter,
        settling: [15_000, 30_000],
        cycles: 10_000,
    };
    println!("| line | hops | jitter | SYNC0: mean | sd | worst | 0x092C: mean | sd | worst |");
    println!("|---|---|---|---|---|---|---|---|---|");
    for (devices, hops) in [(51, &[1, 10, 50][..]), (301, &[1, 10, 50, 300])] {
        for hop_jitter in [false, true] {
            for one in spread(&course(devices, hop_jitter), hops) {
                let jitter = if hop_jitter { "yes" } else { "no" };
                let figures = [one.sync0_ns(), one.difference_ns()].concat();
                let figures: Vec<String> = figures.iter().map(|ns| format!("{ns:.1}")).collect();
                println!("| {} | {} | {jitter} | {} |", devices - 1, one.hops, figures.join(" | "));
            }
        }
    }
}

//! The plan of a segment that a program makes up: does it fit, which line is the tightest, what
//! would fit?
//!
//! `cargo run --release -p isocat --example 05_plan_from_code`

use isocat::plan::{Plan, suggest::suggest};
use isocat::{Nanos, Scenario, SegmentFile};

fn main() {
    // Both sides of what fits.
    for cycle in ["250us", "249us"] {
        let text = format!(
            "cycle = \"{cycle}\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 5\n"
        );
        let file = SegmentFile::parse("made up", &text).expect("a segment");
        let mut scenario = Scenario::from(file);
        // A host that may be late by this; the budget keeps it free before SYNC0.
        scenario.host.jitter = Nanos::micros(20);

        let plan = Plan::of(&scenario).expect("a plan");
        let (position, line) = plan.tightest();
        let place = position.map_or("the frames".to_owned(), |at| format!("SubDevice {at}"));
        println!("{cycle}: fits: {}, tightest: {} at {place}", plan.fits(), line.check.name());
        println!("  slack {}, SYNC0 at {:?} of the cycle", line.slack(), plan.timing().sync0);
        let suggestion = suggest(&plan, &scenario);
        println!("  smallest cycle that fits: {:?}", suggestion.smallest_cycle_ns.map(Nanos));
    }
}

//! From a maker's description (ESI) to a profile: what the file holds, what is doubtful in it, and
//! the device in a simulated segment.
//!
//! `cargo run --release -p isocat --example 08_esi_to_profile [FILE.xml]`; without a file it takes
//! a small synthetic one.

use isocat::esi::EsiFile;
use isocat::{Nanos, Scenario, SegmentFile, run};

const NOBODYS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/box.xml");

fn main() {
    let path = std::env::args().nth(1).unwrap_or(NOBODYS.to_owned());
    let file = EsiFile::read(&path).unwrap_or_else(|error| panic!("{error}"));
    for device in &file.devices {
        let revision = device.revision.unwrap_or(0);
        println!("{} revision 0x{revision:08X}", device.type_name);
        for mode in device.dc.iter().flat_map(|dc| &dc.op_modes) {
            println!("  OpMode {}", mode.name);
        }
    }
    for (device, warning) in file.warnings() {
        let place = device.map_or("the file", |device| &device.type_name);
        println!("doubtful in {place}: {}", warning.message);
    }

    // A segment file names the description; the profile is made of it, and runs as any other.
    let device = &file.devices[0].type_name;
    let text = format!("cycle = \"2ms\"\n[[subdevice]]\nesi = \"{path}\"\ntype = \"{device}\"\n");
    let segment =
        SegmentFile::parse("one of them", &text).unwrap_or_else(|error| panic!("{error}"));
    let mut scenario = Scenario::from(segment);
    scenario.duration = Nanos::millis(100);
    println!("{}", run(&scenario).verdict);
}

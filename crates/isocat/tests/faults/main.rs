//! Every word for a fault does what it says, seen in true time by an onlooker that the MainDevice
//! knows nothing of.

mod clocks;
mod devices;
mod docs;
mod frames;
mod host;
mod onlooker;
mod ring;
mod wires;

use isocat::fault::WORDS;

/// Every word is tried: an untried word might do nothing.
#[test]
fn every_word_is_tried() {
    let sources = [
        include_str!("clocks.rs"),
        include_str!("devices.rs"),
        include_str!("frames.rs"),
        include_str!("host.rs"),
        include_str!("ring.rs"),
        include_str!("wires.rs"),
    ];
    for word in &WORDS {
        let tried = sources.iter().any(|source| source.contains(&format!("\"{}", word.name)));
        assert!(tried, "no test lets \"{}\" happen", word.name);
    }
}

//! `isocat replay`.

use std::path::PathBuf;

use clap::Args;
use isocat_captures::reading::Reading;
use isocat_descriptions::limits;
use isocat_engine::replay::{Told, replay};
use isocat_segment::SegmentFile;

use super::run::json;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

pub const EXAMPLES: &str = "\
The capture was taken at the MainDevice's port and holds both directions: tcpdump, dumpcap,
Wireshark, or isocat run --interface IF --capture FILE. Number of SubDevices, chips, EEPROM
contents and cables are derived from it.

Each request passes a chain of modelled ESCs. Of each answer working counters, positions, IRQ
fields, source address and all data bytes are compared. Clocks are left out; AL status of devices
with a CPU, mailboxes and inputs are taken from the capture. Each difference has a kind; known
variances of parts and sessions are told apart. docs/replay.md has the rules.

Examples:
  isocat replay field.pcapng                    the differences by kinds, and the first of them
  isocat replay field.pcapng --all              each of them
  isocat replay field.pcapng --segment my.toml  chips of my.toml where the capture has none
  isocat replay field.pcapng --json | jq '.differences[] | select(.explained | not)'

Exit code: 0 each frame is exact or differs by a known variance, 1 one does not, 2 bad input or
nothing to compare.";

/// Arguments of `replay`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Capture of a real segment: pcapng or pcap, both directions in one file
    capture: PathBuf,
    /// Segment file with the devices in their order: their chips and EEPROM contents, if the
    /// capture does not show them
    #[arg(long, value_name = "SEGMENT")]
    segment: Option<String>,
    /// Print all differences, not only the first ones
    #[arg(long, conflicts_with = "json")]
    all: bool,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
}

/// Replays; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let path = arguments.capture.display().to_string();
    let bytes = match limits::read(&path, limits::CAPTURE) {
        Ok(bytes) => bytes,
        Err(error) => return fail(&error.to_string()),
    };
    let reading = match Reading::of(&bytes) {
        Ok(reading) => reading,
        Err(error) => return fail(&format!("{path}: {error}")),
    };
    let told = match arguments.segment.as_deref().map(SegmentFile::read).transpose() {
        Ok(file) => file.map(|file| told(&file)),
        Err(error) => return fail(&error.to_string()),
    };
    let report = match replay(&path, &reading, told.as_deref()) {
        Ok(report) => report,
        Err(nothing) => return fail(&format!("{path}: {nothing}")),
    };
    let code = print(&match arguments.json {
        true => json(&report),
        false => report.text(arguments.all),
    });
    match report.agrees {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        false => NOT_IN_SYNC,
    }
}

fn told(file: &SegmentFile) -> Vec<Told> {
    let told = file.subdevices.iter().map(|device| Told {
        name: device.name.clone(),
        chip: *device.profile.esc(),
        sii: device.profile.sii.to_vec(),
    });
    told.collect()
}

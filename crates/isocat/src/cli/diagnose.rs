//! `isocat diagnose`.

use std::fs::File;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::esi::EsiFile;
use isocat_diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat_segment::SegmentFile;

use super::run::{is_page, json, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

pub const EXAMPLES: &str = "\
A capture of any MainDevice's segment: pcapng or pcap, of tcpdump, dumpcap, Wireshark or
isocat run --capture. It may begin in operation, have one direction, other protocols between, and be
cut off. Several captures are read as one, in the order in which they are named: those of a ring buffer.

Each figure is told with the frame that shows it, as Wireshark numbers it. What the capture does not
show is told as unknown. docs/diagnose.md lists what is found.

Examples:
  isocat diagnose field.pcapng                     what went wrong first, where, and what to do
  isocat diagnose ring_*.pcapng --segment my.toml  devices by the names of my.toml
  isocat diagnose field.pcapng --esi vendor.xml    names by the maker's description
  isocat diagnose field.pcapng --json | jq '.findings[] | {kind, frame, what}'

Exit code: 0 no fault was found, 1 a fault was found, 2 a capture can't be read or has no EtherCAT.";

/// Arguments of `diagnose`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Captures: pcapng or pcap
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// Segment file with the names of the devices, in their order
    #[arg(long, value_name = "SEGMENT")]
    segment: Option<String>,
    /// Makers' descriptions with the names of devices; may be given several times
    #[arg(long, value_name = "FILE")]
    esi: Vec<String>,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
    /// Also write the report to a file: text, or JSON if it ends in .json
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// Diagnoses; gives the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    if is_page(arguments.report.as_deref()) {
        return fail(
            "--report: a page (.html) is not made of captures yet; expected .json or .txt",
        );
    }
    let names = match names(arguments) {
        Ok(names) => names,
        Err(message) => return fail(&message),
    };
    let report = match diagnose(&arguments.captures, &names) {
        Ok(report) => report,
        Err(message) => return fail(&message),
    };
    if let Err(message) = write_report(arguments.report.as_deref(), &report, &report.text(), None) {
        return fail(&message);
    }
    let code = print(&match arguments.json {
        true => json(&report),
        false => report.text(),
    });
    match report.found() {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => NOT_IN_SYNC,
        false => IN_SYNC,
    }
}

fn diagnose(captures: &[PathBuf], names: &Names) -> Result<DiagnoseReport, String> {
    let mut diagnosis = Diagnosis::new();
    for path in captures {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| format!("{name}: can't be read: {error}"))?;
        let bar = progress(&file);
        let read = diagnosis.read(&name, bar.wrap_read(file));
        bar.finish_and_clear();
        read.map_err(|error| format!("{name}: {error}"))?;
    }
    let all: Vec<String> = captures.iter().map(|path| path.display().to_string()).collect();
    diagnosis.report(names).map_err(|nothing| format!("{}: {nothing}", all.join(", ")))
}

/// A bar on standard error, if that is a terminal and the file is large.
fn progress(file: &File) -> ProgressBar {
    let length = file.metadata().map_or(0, |metadata| metadata.len());
    if length < LARGE {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:30} {bytes} of {total_bytes}, {eta} left");
    let bar = ProgressBar::new(length);
    if let Ok(style) = style {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

fn names(arguments: &Arguments) -> Result<Names, String> {
    let mut names = Names::default();
    if let Some(path) = &arguments.segment {
        let file = SegmentFile::read(path).map_err(|error| error.to_string())?;
        names.positions = file.subdevices.iter().map(|device| device.name.clone()).collect();
    }
    for path in &arguments.esi {
        let file = EsiFile::read(path).map_err(|error| error.to_string())?;
        for device in &file.devices {
            let Some(product) = device.product_code else { continue };
            names.identities.insert((file.vendor_id, product), device.type_name.clone());
        }
    }
    Ok(names)
}

/// From this length on reading a file takes long enough to show how far it is, bytes.
const LARGE: u64 = 64 << 20;

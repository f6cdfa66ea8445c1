//! `isocat diagnose`.

use std::fs::File;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_captures::probe::Probe;
#[cfg(target_os = "linux")]
use isocat_captures::reading::Frame;
use isocat_captures::reading::NoCapture;
use isocat_descriptions::esi::EsiFile;
use isocat_diagnose::report::VerdictKind;
use isocat_diagnose::{Around, Claims, DiagnoseReport, Diagnosis, Names};
use isocat_segment::{Scenario, SegmentFile};

use super::run::{command, is_page, json, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, NOT_KNOWN, fail, print};
use crate::html::diagnose::Diagnosed;
use crate::html::diagnose::figures::Figures;

mod annotate;

pub const EXAMPLES: &str = "\
A capture of any MainDevice's segment: pcapng or pcap, of tcpdump, dumpcap, Wireshark or
isocat run --capture. It may begin in operation, have one direction, other protocols between, and be
cut off. Several captures are read as one, in the order in which they are named: those of a ring buffer.

Each figure is told with the frame that shows it, as Wireshark numbers it. What the capture does not
show is told as unknown. docs/diagnose.md lists what is found.

With --interface it listens to what goes on there now, sends nothing, and says the same of that.

Examples:
  isocat diagnose field.pcapng                     what went wrong first, where, and what to do
  isocat diagnose ring_*.pcapng --segment my.toml  also what is otherwise than my.toml says
  isocat diagnose field.pcapng --esi vendor.xml    names by the maker's description
  isocat diagnose --interface eth0 --for 10s       what is wrong there now, beside any MainDevice
  isocat diagnose field.pcapng --report x.html     a page with pictures
  isocat diagnose field.pcapng --annotate out.pcapng
                                                   a copy with what was found as comments, for Wireshark
  isocat diagnose field.pcapng --json | jq '.findings[] | {kind, frame, what}'

Exit code: 0 in sync as far as it shows; 1 a fault was found; 2 a capture can't be read or has no
EtherCAT; 3 no fault was found, and whether devices were in sync is not known.";

/// Arguments of `diagnose`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Captures: pcapng or pcap
    #[cfg_attr(target_os = "linux", arg(required_unless_present = "interface"))]
    #[cfg_attr(not(target_os = "linux"), arg(required = true))]
    #[arg(value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// Segment file of the devices, in their order: their names, and what they are meant to do
    #[arg(long, value_name = "SEGMENT")]
    segment: Option<String>,
    /// Take what the captures show as what was meant
    #[arg(long, requires = "segment")]
    as_is: bool,
    /// ESI files with the names of devices; may be given several times
    #[arg(long, value_name = "FILE")]
    esi: Vec<String>,
    /// The captures are those of a hardware probe that writes its time stamps into the packets: esl
    /// (or et2000), the EtherCAT Switch Link
    #[arg(long, value_name = "NAME")]
    probe: Option<Probe>,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
    /// Also write the report to a file: text, JSON if it ends in .json, or a page with pictures if
    /// it ends in .html
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Also write a copy of the captures, as one pcapng file, with findings and states as comments
    /// at their packets
    #[arg(long, value_name = "FILE")]
    annotate: Option<PathBuf>,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    live: Live,
}

/// The interface to listen to, instead of a capture.
#[cfg(target_os = "linux")]
#[derive(Args, Debug)]
#[group(skip)]
#[command(next_help_heading = "On a network interface, now")]
struct Live {
    /// Listen on this network interface, and send nothing
    #[arg(long, value_name = "IF", conflicts_with = "captures")]
    interface: Option<String>,
    /// Network namespace of the interface
    #[arg(long, value_name = "NAME", requires = "interface")]
    netns: Option<String>,
    /// Time to listen, default 10s; Ctrl-C ends it early
    #[arg(long = "for", value_name = "DURATION", value_parser = super::run::duration, requires = "interface")]
    span: Option<isocat_wire::Nanos>,
}

/// What is given beside the captures.
#[derive(Default)]
pub(super) struct Given {
    pub names: Names,
    pub claims: Option<Claims>,
}

/// Diagnoses; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let (annotate, report) = (arguments.annotate.as_deref(), arguments.report.as_deref());
    let refused = |path| annotate::refused(path, &arguments.captures, report);
    if let Some(why) = annotate.and_then(refused) {
        return fail(&why);
    }
    let given = match given(arguments) {
        Ok(given) => given,
        Err(message) => return fail(&message),
    };
    let mut figures = Figures::default();
    let report = match arguments.diagnose(&given, &mut figures) {
        Ok(report) => report,
        Err(message) => return fail(&message),
    };
    let path = arguments.report.as_deref();
    let command = arguments.command();
    let page = is_page(path)
        .then(|| Diagnosed { report: &report, figures: &figures, command: &command }.page());
    if let Err(message) = write_report(path, &report, &report.text(), page.as_ref()) {
        return fail(&message);
    }
    if let Some(path) = annotate
        && let Err(message) = annotate::write(path, &arguments.captures, &report)
    {
        return fail(&message);
    }
    let code = print(&match arguments.json {
        true => json(&report),
        false => report.text(),
    });
    match report.verdict.kind {
        _ if code == BAD_INPUT => BAD_INPUT,
        VerdictKind::Found => NOT_IN_SYNC,
        VerdictKind::NothingFound => NOT_KNOWN,
        VerdictKind::InSync | VerdictKind::InOperation => IN_SYNC,
    }
}

impl Arguments {
    fn diagnose(&self, given: &Given, figures: &mut Figures) -> Result<DiagnoseReport, String> {
        #[cfg(target_os = "linux")]
        if let Some(interface) = &self.live.interface {
            return self.live.diagnose(interface, given);
        }
        diagnose(self, given, figures)
    }

    /// The command that repeats it.
    fn command(&self) -> String {
        let captures = self.captures.iter().map(|path| path.display().to_string());
        let segment = self.segment.iter().flat_map(|path| ["--segment".to_owned(), path.clone()]);
        let segment = segment.chain(self.as_is.then(|| "--as-is".to_owned()));
        let esi = self.esi.iter().flat_map(|path| ["--esi".to_owned(), path.clone()]);
        let probe = self.probe.iter().flat_map(|_| ["--probe".to_owned(), "esl".to_owned()]);
        let words: Vec<String> = ["isocat".to_owned(), "diagnose".to_owned()]
            .into_iter()
            .chain(captures)
            .chain(segment)
            .chain(esi)
            .chain(probe)
            .collect();
        command(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }
}

#[cfg(target_os = "linux")]
impl Live {
    fn diagnose(&self, interface: &str, given: &Given) -> Result<DiagnoseReport, String> {
        use super::listen::{Heard, listen};
        let mut listener = isocat_host::Listener::open(interface, self.netns.as_deref())
            .map_err(|error| error.to_string())?;
        let stop = super::interface::stop_on_signals()
            .map_err(|error| format!("signals can't be caught: {error}"))?;
        let name = format!("the interface {interface}");
        let mut live = isocat_diagnose::live::Live::new(&name).against(given.claims.clone());
        let mut number = 0;
        let span = self.span.unwrap_or(LISTEN);
        let bar = super::run::progress_bar(span);
        bar.set_message("listening");
        let mut began = None;
        let ended = listen(&mut listener, Some(span), &stop, &mut |heard| match heard {
            Heard::Frame { at, sent, bytes } => {
                number += 1;
                let (sent, bytes) = (Some(sent), bytes.to_vec());
                live.frame(Frame { number, at, interface: 0, sent, bytes });
            }
            Heard::Quiet(now) => {
                let began = *began.get_or_insert(now);
                bar.set_position(now.saturating_sub(began).as_nanos() as u64);
            }
            Heard::Down(_) => anstream::eprintln!("isocat diagnose: {name} is down"),
        });
        bar.finish_and_clear();
        ended.map_err(|error| error.to_string())?;
        let dropped = listener.dropped();
        if dropped > 0 {
            anstream::eprintln!(
                "warning: {dropped} frames were not heard: this machine was too slow, and what seems lost may be among them"
            );
        }
        live.report(&given.names).map_err(|nothing| format!("{name}: {nothing}"))
    }
}

fn diagnose(
    arguments: &Arguments,
    given: &Given,
    figures: &mut Figures,
) -> Result<DiagnoseReport, String> {
    let captures = &arguments.captures;
    let diagnosis = Diagnosis::new().with_probe(arguments.probe);
    let mut diagnosis = diagnosis.against(given.claims.clone());
    for path in captures {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| format!("{name}: can't be read: {error}"))?;
        let bar = progress(&file);
        let read = diagnosis.read_with(&name, bar.wrap_read(file), &mut |one| figures.push(one));
        bar.finish_and_clear();
        match read {
            Err(NoCapture::Unknown { found }) if found.is_empty() && captures.len() > 1 => {
                diagnosis.pass_over(&name, "the file is empty");
            }
            other => other.map_err(|error| format!("{name}: {error}"))?,
        }
    }
    let all: Vec<String> = captures.iter().map(|path| path.display().to_string()).collect();
    let report = diagnosis.report_with(&given.names, &mut |one| figures.push(one));
    let mut report = report.map_err(|nothing| format!("{}: {nothing}", all.join(", ")))?;
    look_around(arguments, &mut report);
    Ok(report)
}

/// Reads the captures a second time, for the events around the first fault. A capture that cannot
/// be read twice, such as a pipe, is skipped.
fn look_around(arguments: &Arguments, report: &mut DiagnoseReport) {
    let Some(around) = Around::new(report) else { return };
    let mut around = around.with_probe(arguments.probe);
    for path in &arguments.captures {
        let Ok(file) = File::open(path) else { return };
        if !file.metadata().is_ok_and(|metadata| metadata.is_file()) {
            return;
        }
        let bar = progress(&file);
        let read = around.read(&path.display().to_string(), bar.wrap_read(file));
        bar.finish_and_clear();
        if read.is_err() {
            around.pass_over();
        }
    }
    around.end(report);
}

/// A progress bar on standard error, if that is a terminal and the file is large.
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

fn given(arguments: &Arguments) -> Result<Given, String> {
    let mut given = match &arguments.segment {
        None => Given::default(),
        Some(path) => of_segment(path, arguments.as_is)?,
    };
    for path in &arguments.esi {
        let file = EsiFile::read(path).map_err(|error| error.to_string())?;
        for device in &file.devices {
            let Some(product) = device.product_code else { continue };
            given.names.identities.insert((file.vendor_id, product), device.type_name.clone());
        }
    }
    Ok(given)
}

/// The names of a segment file's SubDevices, and what the file claims, unless whatever the segment
/// does is taken as meant.
pub(super) fn of_segment(path: &str, as_is: bool) -> Result<Given, String> {
    let file = SegmentFile::read(path).map_err(|error| error.to_string())?;
    let mut scenario = Scenario::from(file);
    scenario.as_is |= as_is;
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let names = Names { positions: names, ..Names::default() };
    Ok(Given { names, claims: Some(scenario.claims()) })
}

/// Time to listen without --for.
#[cfg(target_os = "linux")]
const LISTEN: isocat_wire::Nanos = isocat_wire::Nanos::millis(10_000);
/// Length of a file, bytes, from which a progress bar is shown.
const LARGE: u64 = 64 << 20;

//! `isocat run`.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::document::FileError;
use isocat_descriptions::quantity;
use isocat_engine::Report;
use isocat_engine::diagnosis;
use isocat_engine::recording::{Recorded, Recording};
use isocat_engine::report::Finding;
use isocat_esc::DriftLaw;
use isocat_maindevice::{Fault, Segment};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::run::Progress;
use isocat_sim::{Judged, Kind, Outcome};
use isocat_wire::Nanos;
use serde::Serialize;

use super::files::Files;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};
use crate::html::{self, Page};

/// Shown below the help of `run`.
pub(crate) const EXAMPLES: &str = "\
Examples:
  isocat run my.toml --for 1min             a segment of your own
  isocat run --report run.html              the report as a page with timing diagrams
  isocat run --capture run.pcapng --tap 2   frames at the MainDevice and at SubDevice 2, for Wireshark
  isocat run --waves run.vcd                pulses, steps and states as waveforms, for GTKWave
  isocat run --trace run.perfetto-trace     the same with frames and clock errors, for Perfetto
  isocat run --series run.parquet           a row for each SubDevice and cycle; run.csv for CSV
  isocat run --json --report run.txt        the report for a program, and as a text beside it
  isocat run network.xml --esi esi/         what a configuration tool wrote (ENI), on devices made of these descriptions
  isocat run network.xml --interface eth1   the same on a real wire

docs/exports.md says what is in each file.";

/// Arguments of `run`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file, or the ENI of a configuration tool (.xml, .eni); without one, the built-in
    /// segment runs
    pub segment: Option<String>,
    /// Time to run once all devices are in OP, in virtual time or, with --interface, in host time:
    /// 500ms, 10s, 2min
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    pub duration: Option<Nanos>,
    /// Seed of all randomness; the same seed gives the same run
    #[arg(long)]
    seed: Option<u64>,
    /// Law of all drift loops, instead of that of the file: hold, block or proportional
    #[arg(long, value_name = "NAME")]
    drift_law: Option<DriftLaw>,
    /// Result of `isocat calibrate --chips` on a real segment, for the chips of the virtual one
    #[arg(long, value_name = "FILE")]
    chips: Option<String>,
    /// Print the report as one JSON document
    #[arg(long)]
    pub json: bool,
    /// Also write the report to this file: with timing diagrams if it ends in .html, JSON if in
    /// .json, otherwise text
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Also write a JUnit file for a CI system: each `[[expect]]` of the segment file is a test;
    /// without any the verdict is one
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Write every frame to this pcapng file, with comments at incidents
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
    /// Write the events at each SubDevice (SYNC0, SYNC1, SM events, steps, states) to this VCD
    /// file, as waveforms
    #[arg(long, value_name = "FILE")]
    pub waves: Option<PathBuf>,
    #[command(flatten)]
    pub files: super::files::Options,
    /// Continue without devices that fail on the way up: each is named with the cause, the others
    /// run and are judged; exit 1 if one was left out that is not optional in the segment file
    #[arg(long)]
    pub tolerate: bool,
    /// For testing: let the clocks drift apart
    #[arg(long)]
    no_drift_compensation: bool,
    /// For testing: run although the timing budget does not fit
    #[arg(long)]
    force: bool,
    /// For testing: simulate regular cycles without the shortcut, too; only the computing time
    /// depends on it
    #[arg(long, hide = true)]
    no_lane: bool,
    /// With --interface: answer GET /metrics for Prometheus at this address while it runs: a port
    /// of this machine, or an address
    #[arg(long, value_name = "ADDRESS", value_parser = crate::metrics::address)]
    pub metrics: Option<std::net::SocketAddr>,
    #[command(flatten)]
    pub eni: super::eni_run::Options,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    pub wire: super::interface::Options,
}

pub fn duration(text: &str) -> Result<Nanos, String> {
    let duration = quantity::parse_duration(text).map_err(|error| error.to_string())?;
    if (Nanos(1)..=LONGEST).contains(&duration) {
        Ok(duration)
    } else {
        Err(format!("expected a duration above zero and up to 24 hours, found {text}"))
    }
}

const LONGEST: Nanos = Nanos::millis(24 * 3_600_000);

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let path = arguments.segment.as_deref();
    if let Some(eni) = path.filter(|path| super::eni_run::is_eni(path)) {
        return run_eni(arguments, eni);
    }
    if let Some(message) = arguments.eni.refused_without_eni() {
        return fail(&message);
    }
    let file = match super::segment_or_built_in(path) {
        Ok(file) => file,
        Err(error) => return fail(&(error.to_string() + &path.map(verb_hint).unwrap_or_default())),
    };
    if let Some(message) = arguments.overwrites() {
        return fail(&message);
    }
    #[cfg(target_os = "linux")]
    match arguments.wire.interface.as_deref() {
        _ if arguments.wire.preflight => {
            let cycle = arguments.segment.as_ref().map(|_| file.cycle);
            return super::interface::look(arguments, cycle);
        }
        Some(_) if arguments.junit.is_some() => {
            return fail(
                "--junit is beside --interface; expected a simulation: what a segment file expects is judged in true time",
            );
        }
        Some(_) if arguments.waves.is_some() => {
            return fail(
                "--waves is given with --interface; expected a simulation, since pulses of real devices are not visible",
            );
        }
        Some(interface) => {
            return match arguments.files.refused_beside_interface() {
                Some(message) => fail(&message),
                None => super::interface::run(arguments, interface, file),
            };
        }
        None => {}
    }
    #[cfg(target_os = "linux")]
    if arguments.wire.recording.is_given() {
        return fail(
            "--record and its keys go with --interface; expected --capture FILE for a virtual run, which has all of it",
        );
    }
    if arguments.metrics.is_some() {
        return fail(
            "--metrics goes with --interface: a virtual run is over before anybody asks for its metrics; expected \
             \"isocat watch --metrics\", which goes at the pace of a clock",
        );
    }
    let scenario = match arguments.scenario(file) {
        Ok(scenario) => scenario,
        Err(error) => return fail(&error.to_string()),
    };
    if scenario.duration < scenario.cycle {
        let (duration, cycle) = (scenario.duration, scenario.cycle);
        return fail(&format!("--for {duration} is shorter than one cycle of {cycle}"));
    }
    let (capture, waves) = (arguments.capture.as_deref(), arguments.waves.as_deref());
    let wanted = arguments.files.with(capture, waves);
    let mut files = match wanted.and_then(|wanted| Files::create(&wanted, &scenario)) {
        Ok(files) => files,
        Err(message) => return fail(&message),
    };
    let bar = progress_bar(scenario.duration);
    files.recording = arguments.wants_page().then(|| Recording::of(&scenario));
    let outcome = scenario.run().execute(Some(files), &mut |progress| match progress {
        Progress::Stage(stage) => bar.set_message(stage.name()),
        Progress::Judged(time) => {
            bar.set_message("in operation");
            bar.set_position(time.0 as u64);
        }
    });
    bar.finish_and_clear();
    let report = Report::new(&scenario, &outcome);
    let refused = outcome.failure.as_ref().is_some_and(|e| e.cause.fault() == Fault::Configuration);
    finish(arguments, &scenario, report, outcome, refused)
}

/// Plays an ENI, unless options are given that only apply to a segment file.
fn run_eni(arguments: &Arguments, path: &str) -> u8 {
    #[cfg(target_os = "linux")]
    let (on_wire, records) =
        (arguments.wire.interface.as_deref(), arguments.wire.recording.is_given());
    #[cfg(not(target_os = "linux"))]
    let (on_wire, records) = (None::<&str>, false);
    let files = &arguments.files;
    let keys = [
        ("--junit", arguments.junit.is_some()),
        ("--capture without --interface", arguments.capture.is_some() && on_wire.is_none()),
        ("--record without --interface", records && on_wire.is_none()),
        ("--waves", arguments.waves.is_some()),
        ("--trace", files.trace.is_some()),
        ("--series", files.series.is_some()),
        ("--tolerate", arguments.tolerate),
        ("--no-drift-compensation", arguments.no_drift_compensation),
        ("--force", arguments.force),
        ("--metrics", arguments.metrics.is_some()),
        ("--report with .html", arguments.wants_page()),
    ];
    if let Some((key, _)) = keys.iter().find(|(_, given)| *given) {
        return fail(&format!(
            "{key} is beside an ENI, which is not supported; expected a segment file (.toml) beside it"
        ));
    }
    if let Some(message) = arguments.overwrites() {
        return fail(&message);
    }
    #[cfg(target_os = "linux")]
    if arguments.wire.preflight {
        return match super::eni_run::read(path) {
            Ok(eni) => super::interface::look(arguments, Some(Nanos(eni.start_up.cycle_ns))),
            Err(message) => fail(&message),
        };
    }
    #[cfg(target_os = "linux")]
    if let Some(interface) = on_wire {
        return super::eni_interface::run(arguments, interface, path);
    }
    let wishes = super::eni_run::Wishes {
        options: &arguments.eni,
        chips: arguments.chips.as_deref(),
        duration: arguments.duration,
        seed: arguments.seed,
        drift_law: arguments.drift_law,
        json: arguments.json,
        report: arguments.report.as_deref(),
    };
    super::eni_run::run(path, &wishes)
}

/// The exit code of a run: it depends on the judges and the expectations, never on the text of a
/// sentence.
fn exit_code(report: &Report, refused: bool) -> u8 {
    match (refused, report.as_expected()) {
        (true, _) => BAD_INPUT,
        (false, true) => IN_SYNC,
        (false, false) => NOT_IN_SYNC,
    }
}

/// Writes all requested output.
fn finish(
    arguments: &Arguments,
    scenario: &Scenario,
    mut report: Report,
    outcome: Outcome<Files>,
    refused: bool,
) -> u8 {
    let found = outcome.world.main().segment().clone();
    let files = outcome.world.into_tap().expect("it was given one");
    let recorded = match files.finish() {
        Ok(recording) => recording.map(Recording::finish),
        Err(message) => return fail(&message),
    };
    let limit = scenario.sync0_limit;
    match &recorded {
        Some(recorded) => report.explain(recorded, &found, limit),
        // A run in sync shall not pay for a recorder, so another one is recorded where it has to be
        // told why.
        None if !report.in_sync && !refused => {
            let (recorded, found) = record_again(scenario);
            report.explain(&recorded, &found, limit);
        }
        None => {}
    }
    let report = &report;
    let page = recorded.map(|recorded| {
        let command = arguments.command(scenario);
        html::run::Run { report, recorded: &recorded, segment: &found, limit, command: &command }
            .page()
    });
    let page = page.as_ref();
    if let Err(message) = write_report(arguments.report.as_deref(), report, &report.text(), page) {
        return fail(&message);
    }
    if let Some(path) = arguments.junit.as_deref() {
        let written = super::output::write(path, super::junit::document(report));
        if let Err(error) = written {
            return fail(&unwritable("JUnit", Some(path), &error));
        }
    }
    if refused && !arguments.json {
        return fail(&refusal(Some(scenario), report.findings.first(), &report.verdict));
    }
    match print(&if arguments.json { json(report) } else { report.text() }) {
        IN_SYNC => exit_code(report, refused),
        unwritten => unwritten,
    }
}

/// Repeats the run with a recorder.
fn record_again(scenario: &Scenario) -> (Recorded, Segment) {
    let bar = progress_bar(scenario.duration);
    bar.set_message("looking why");
    let recorded = diagnosis::record(scenario, &mut |progress| {
        if let Progress::Judged(time) = progress {
            bar.set_position(time.0 as u64);
        }
    });
    bar.finish_and_clear();
    recorded
}

/// A report as one JSON document.
pub fn json(report: &impl Serialize) -> String {
    crate::json::lines(report) + "\n"
}

/// Writes a report to the requested file, if any, in the format of its ending.
pub(crate) fn write_report(
    path: Option<&Path>,
    report: &impl Serialize,
    text: &str,
    page: Option<&Page>,
) -> Result<(), String> {
    let Some(path) = path else { return Ok(()) };
    let content = match (path.extension().and_then(|extension| extension.to_str()), page) {
        (Some("json"), _) => json(report),
        (Some("html" | "htm"), Some(page)) => page.render(),
        _ => anstream::adapter::strip_str(text).to_string(),
    };
    super::output::write(path, content).map_err(|error| unwritable("report", Some(path), &error))
}

/// Whether a report is requested as a page.
pub(crate) fn is_page(path: Option<&Path>) -> bool {
    let ending = path.and_then(Path::extension).and_then(|ending| ending.to_str());
    matches!(ending, Some("html" | "htm"))
}

/// A duration as an argument, such as `10s`.
pub fn argument(duration: Nanos) -> String {
    duration.to_string().replace(' ', "")
}

/// A command in the syntax of a shell.
pub fn command(words: &[&str]) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:+,%@".contains(c);
    let quoted = words.iter().map(|word| match !word.is_empty() && word.chars().all(plain) {
        true => (*word).to_owned(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    });
    quoted.collect::<Vec<_>>().join(" ")
}

/// The MainDevice's refusal, with the place of the device in the segment file, if there is one.
pub fn refusal(scenario: Option<&Scenario>, finding: Option<&Finding>, verdict: &str) -> String {
    let Some(finding) = finding else { return verdict.to_owned() };
    let Some(scenario) = scenario else { return finding.sentence() };
    let device = finding.position.and_then(|position| scenario.devices.get(position));
    let place = match device {
        Some(device) => format!("{}:{}", scenario.source, device.line),
        None => scenario.source.clone(),
    };
    let lack = match (&finding.kind, device) {
        (Kind::Judged(Judged::Failed { cause, .. }), Some(device)) => {
            super::plan::lack(cause, &device.profile.sii)
        }
        _ => String::new(),
    };
    format!("{place}: {}{lack}", finding.sentence())
}

/// A hint for a misspelled verb, which is read as a file name.
fn verb_hint(path: &str) -> String {
    use clap::CommandFactory;
    let command = super::CommandLine::command();
    let verbs: Vec<_> = command.get_subcommands().map(|verb| verb.get_name()).collect();
    if path.contains(['.', '/']) {
        return String::new();
    }
    format!("\nif a verb was meant: {}", verbs.join(", "))
}

impl Arguments {
    /// The scenario of a segment file, changed by the arguments.
    pub fn scenario(&self, file: SegmentFile) -> Result<Scenario, FileError> {
        let mut scenario = Scenario::from(file);
        super::apply_chips(self.chips.as_deref(), &mut scenario)?;
        scenario.duration = self.duration.unwrap_or(scenario.duration);
        scenario.seed = self.seed.unwrap_or(scenario.seed);
        scenario.drift_law = self.drift_law.or(scenario.drift_law);
        scenario.force = self.force;
        scenario.tolerate = self.tolerate;
        scenario.lane = !self.no_lane;
        scenario.drift_compensation &= !self.no_drift_compensation;
        Ok(scenario)
    }

    fn wants_page(&self) -> bool {
        is_page(self.report.as_deref())
    }

    /// The command that repeats a run of `scenario`.
    pub fn command(&self, scenario: &Scenario) -> String {
        let (seed, duration) = (scenario.seed.to_string(), argument(scenario.duration));
        let mut words = vec!["isocat", "run"];
        words.extend(self.segment.as_deref());
        words.extend(self.chips.as_deref().into_iter().flat_map(|file| ["--chips", file]));
        words.extend(["--for", &duration, "--seed", &seed]);
        let law = self.drift_law.map(|law| law.to_string());
        words.extend(law.iter().flat_map(|law| ["--drift-law", law]));
        let flags = [
            (self.tolerate, "--tolerate"),
            (self.no_drift_compensation, "--no-drift-compensation"),
            (self.force, "--force"),
        ];
        words.extend(flags.iter().filter(|(given, _)| *given).map(|(_, flag)| *flag));
        command(&words)
    }

    /// Files that would be overwritten: the segment itself, or one result by the other.
    fn overwrites(&self) -> Option<String> {
        let same = |one: &Path, other: &Path| {
            one == other
                || matches!((one.canonicalize(), other.canonicalize()), (Ok(a), Ok(b)) if a == b)
        };
        let files = [
            ("the segment file", self.segment.as_deref().map(Path::new)),
            ("--report", self.report.as_deref()),
            ("--junit", self.junit.as_deref()),
            ("--capture", self.capture.as_deref()),
            ("--waves", self.waves.as_deref()),
            ("--trace", self.files.trace.as_deref()),
            ("--series", self.files.series.as_deref()),
        ];
        let mut pairs = files.iter().enumerate().flat_map(|(number, (flag, path))| {
            files[..number].iter().map(move |(what, other)| (flag, path, what, other))
        });
        pairs.find_map(|(flag, path, what, other)| {
            let (path, other) = ((*path)?, (*other)?);
            same(path, other).then(|| format!("{flag} {} would overwrite {what}", path.display()))
        })
    }
}

pub(crate) fn unwritable(what: &str, path: Option<&Path>, error: &std::io::Error) -> String {
    let path = path.map_or(String::new(), |path| path.display().to_string());
    match error.kind() {
        std::io::ErrorKind::StorageFull => {
            format!("the {what} file {path} can't be written: no space left on its disk")
        }
        _ => format!("the {what} file {path} can't be written: {error}"),
    }
}

/// A progress bar, shown only on a terminal and only if the run takes a while.
pub(crate) fn progress_bar(duration: Nanos) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(duration.0 as u64);
    let template = "{msg:12} {wide_bar} {percent:>3} %  {eta}";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_codes_do_not_go_by_sentences() {
        let text = "cycle = \"1ms\"\nfor = \"50ms\"\n[host]\ndrift_compensation = false\n\
                    [[subdevice]]\ndevice = \"model_every_mode\"\n\
                    [[subdevice]]\ndevice = \"model_every_mode\"\nclock = \"40ppm\"\n";
        let file = SegmentFile::parse("test.toml", text).expect("it is right");
        let mut report = isocat_engine::run(&Scenario::from(file));
        assert!(!report.findings.is_empty(), "{}", report.verdict);
        assert_eq!((exit_code(&report, false), exit_code(&report, true)), (NOT_IN_SYNC, BAD_INPUT));
        report.verdict = "In sync: all is well.".into();
        for finding in &mut report.findings {
            finding.what = "nothing at all".into();
        }
        assert_eq!((exit_code(&report, false), exit_code(&report, true)), (NOT_IN_SYNC, BAD_INPUT));
    }
}

//! `isocat plan`.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};
use indicatif::{ProgressBar, ProgressStyle};
use isocat_descriptions::sii::SiiFile;
use isocat_descriptions::{eni, limits};
use isocat_engine::plan::{Plan, PlanReport, cycles, proof, suggest, what_if};
use isocat_esc::DriftLaw;
use isocat_maindevice::Cause;
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::Nanos;

use super::run::{argument, command, duration, is_page, json, progress_bar, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};
use crate::html;
use crate::tool::{File, Tool};

/// Arguments of `plan`.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("runs").args(["prove", "what_if"]).multiple(true))]
pub struct Arguments {
    /// Segment file, or an ENI (.xml, .eni) to compare with the plan; without one, the built-in
    /// segment is planned
    segment: Option<String>,
    /// Run the segment in virtual time with the worst jitter of the plan, and show the measured
    /// value next to each line
    #[arg(long)]
    prove: bool,
    /// With --prove: how long the proof runs once all devices are in OP; default as the segment
    /// file says. Else print the plan for another tool: twincat, igh, lcec, ros2, soem, pysoem,
    /// ethercrab, kickcat
    #[arg(long = "for", value_name = "DURATION|TOOL", value_parser = purpose)]
    purpose: Option<Purpose>,
    /// With --for TOOL: write its file here, or its files into this folder where it wants several
    /// (ros2)
    #[arg(long, value_name = "FILE|FOLDER", requires = "purpose")]
    out: Option<PathBuf>,
    /// Seed of the runs
    #[arg(long, requires = "runs")]
    seed: Option<u64>,
    /// Law of all drift loops, instead of that of the file: hold, block or proportional
    #[arg(long, value_name = "NAME", requires = "runs")]
    drift_law: Option<DriftLaw>,
    /// Result of `isocat calibrate --chips` on a real segment, for the chips of the virtual one
    #[arg(long, value_name = "FILE")]
    chips: Option<String>,
    /// Look for the phase with the most even slack and for the smallest cycle that fits
    #[arg(long)]
    suggest: bool,
    /// Plan the segment at each of these bus cycles instead, such as 250us,500us,1ms, and print one
    /// table: whether it fits, and the mode and the least slack of each SubDevice
    #[arg(long, value_name = "CYCLES", value_delimiter = ',', value_parser = cycle,
        conflicts_with_all = ["prove", "purpose", "suggest", "what_if", "start_up", "eni", "chips", "report"])]
    cycles: Vec<String>,
    /// Run the segment once for each cable that is pulled and each SubDevice that loses its power,
    /// and show which SubDevices stay in sync, whose outputs go safe, and when all are in sync
    /// again; for all, or for those named by position or name (--what-if=3,5)
    #[arg(long, value_name = "DEVICES", num_args = 0..=1, require_equals = true, default_missing_value = "all")]
    what_if: Option<String>,
    /// How long the cable or the power is gone; default 500ms, 60s at most
    #[arg(long, value_name = "DURATION", value_parser = gone, requires = "what_if")]
    gone: Option<Nanos>,
    /// Print instead what the way up will write, per device and transition, and the frames of a
    /// cycle
    #[arg(long, conflicts_with_all = ["prove", "suggest", "what_if"])]
    start_up: bool,
    /// Also write the start-up list to this file, as ENI
    #[arg(long, value_name = "FILE")]
    eni: Option<PathBuf>,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
    /// Also write the plan to this file: with timing diagrams if it ends in .html, JSON if in
    /// .json, else text
    #[arg(long, value_name = "FILE", conflicts_with = "start_up")]
    report: Option<PathBuf>,
    #[command(flatten)]
    eni_options: super::eni_run::Options,
}

/// What `--for` is for.
#[derive(Clone, Copy, Debug)]
enum Purpose {
    /// The proof runs as long.
    Duration(Nanos),
    /// The plan is printed for it.
    Tool(Tool),
}

/// Plans; gives the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    if let Some(path) = arguments.segment.as_deref().filter(|path| super::eni_run::is_eni(path)) {
        return arguments.compare(path);
    }
    if let Some(message) = arguments.eni_options.refused_without_eni().or(arguments.wrong_purpose())
    {
        return fail(&message);
    }
    if !arguments.cycles.is_empty() {
        return at_cycles(arguments);
    }
    let file = match super::segment_or_built_in(arguments.segment.as_deref()) {
        Ok(file) => file,
        Err(error) => return fail(&error.to_string()),
    };
    let mut scenario = Scenario::from(file);
    scenario.duration = arguments.duration().unwrap_or(scenario.duration);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    if let Err(error) = super::apply_chips(arguments.chips.as_deref(), &mut scenario) {
        return fail(&error.to_string());
    }
    scenario.drift_law = arguments.drift_law.or(scenario.drift_law);
    let plan = match Plan::of(&scenario) {
        Ok(plan) => plan,
        Err(error) => return fail(&place(&scenario, &error)),
    };
    if let Some(path) = &arguments.eni {
        let text = eni::write(&plan.start_up(&scenario));
        if let Err(error) = super::output::write(path, text) {
            return fail(&super::run::unwritable("ENI", Some(path), &error));
        }
    }
    if let Some(Purpose::Tool(tool)) = arguments.purpose {
        return for_tool(tool, arguments.out.as_deref(), &plan, &scenario);
    }
    if arguments.start_up {
        let list = plan.start_up(&scenario);
        let code = print(&if arguments.json { list.json() } else { list.text() });
        return if plan.fits() || code != IN_SYNC { code } else { NOT_IN_SYNC };
    }
    let mut report = plan.report(&scenario);
    if arguments.suggest {
        report.suggestion = Some(suggest::suggest(&plan, &scenario));
    }
    if arguments.prove {
        let bar = progress_bar(scenario.duration);
        bar.set_message("proving");
        let proof = proof::prove(&plan, &scenario);
        bar.finish_and_clear();
        proof.fill(&mut report);
    }
    if let Err(message) = arguments.try_what_if(&plan, &scenario, &mut report) {
        return fail(&message);
    }
    let page = is_page(arguments.report.as_deref())
        .then(|| html::plan::page(&plan, &report, &arguments.command(&scenario)));
    let (path, text) = (arguments.report.as_deref(), report.text());
    if let Err(message) = write_report(path, &report, &text, page.as_ref()) {
        return fail(&message);
    }
    let proven = report.proof.as_ref().is_none_or(|proof| proof.holds);
    let code = print(&if arguments.json { json(&report) } else { text });
    let comes_up = report.what_if.as_ref().is_none_or(|found| found.failure.is_none());
    match report.fits && proven && comes_up {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        false => NOT_IN_SYNC,
    }
}

/// Prints the plans at several bus cycles.
fn at_cycles(arguments: &Arguments) -> u8 {
    let count = arguments.cycles.len();
    if count > cycles::MOST {
        let most = cycles::MOST;
        return fail(&format!("--cycles has {count} cycles; expected {most} at most"));
    }
    let (path, text) = match arguments.segment.as_deref() {
        None => ("built-in segment", SegmentFile::built_in_text().to_owned()),
        Some(path) => match limits::read_text(path, limits::TOML) {
            Ok(text) => (path, text),
            Err(error) => return fail(&error.to_string()),
        },
    };
    match cycles::at_cycles(path, &text, &arguments.cycles) {
        Err(error) => fail(&error.to_string()),
        Ok(found) => {
            let code = print(&if arguments.json { json(&found) } else { found.text() });
            if found.all_fit() || code != IN_SYNC { code } else { NOT_IN_SYNC }
        }
    }
}

/// A bus cycle, as it is written in a segment file.
fn cycle(text: &str) -> Result<String, String> {
    duration(text.trim()).map(|_| text.trim().to_owned())
}

impl Arguments {
    /// How long the proof runs, if that is asked for.
    fn duration(&self) -> Option<Nanos> {
        match self.purpose {
            Some(Purpose::Duration(duration)) => Some(duration),
            _ => None,
        }
    }

    /// Why `--for` can't be beside what else is asked for.
    fn wrong_purpose(&self) -> Option<String> {
        let others = [
            ("--prove", self.prove),
            ("--what-if", self.what_if.is_some()),
            ("--suggest", self.suggest),
            ("--start-up", self.start_up),
            ("--json", self.json),
            ("--report", self.report.is_some()),
        ];
        let given = others.iter().find(|(_, given)| *given);
        match (self.purpose?, given) {
            (Purpose::Tool(tool), Some((key, _))) => Some(format!(
                "--for {} is beside {key}; expected --for TOOL alone, or with --out and --eni",
                tool.name()
            )),
            (Purpose::Duration(_), _) if !self.prove => {
                Some("--for DURATION is without --prove; expected --prove, or --for TOOL".into())
            }
            (Purpose::Duration(_), _) if self.out.is_some() => {
                Some("--out is beside --for DURATION; expected --for TOOL".into())
            }
            _ => None,
        }
    }

    /// Compares an ENI with the plan, unless keys are given that go with a segment file alone.
    fn compare(&self, path: &str) -> u8 {
        let keys = [
            ("--prove", self.prove),
            ("--suggest", self.suggest),
            ("--what-if", self.what_if.is_some()),
            ("--start-up", self.start_up),
            ("--cycles", !self.cycles.is_empty()),
            ("--eni", self.eni.is_some()),
            ("--for TOOL", matches!(self.purpose, Some(Purpose::Tool(_)))),
            ("--report with .html", is_page(self.report.as_deref())),
        ];
        if let Some((key, _)) = keys.iter().find(|(_, given)| *given) {
            return fail(&format!(
                "{key} is beside an ENI, which is not supported; expected a segment file (.toml) beside it"
            ));
        }
        let wishes = super::eni_run::Wishes {
            options: &self.eni_options,
            chips: self.chips.as_deref(),
            duration: self.duration(),
            seed: self.seed,
            drift_law: self.drift_law,
            json: self.json,
            report: self.report.as_deref(),
        };
        super::eni_run::plan(path, &wishes)
    }

    fn try_what_if(
        &self,
        plan: &Plan,
        scenario: &Scenario,
        report: &mut PlanReport,
    ) -> Result<(), String> {
        let Some(devices) = &self.what_if else { return Ok(()) };
        let settings = what_if::Settings {
            gone: self.gone.unwrap_or(what_if::GONE),
            devices: positions(devices, scenario)?,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
        };
        let bar = cases_bar(2 * settings.devices.len());
        let found = what_if::what_if(plan, scenario, &settings, &mut |done| {
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        report.what_if = Some(found);
        Ok(())
    }

    /// The command that repeats it.
    fn command(&self, scenario: &Scenario) -> String {
        let (seed, duration) = (scenario.seed.to_string(), argument(scenario.duration));
        let mut words = vec!["isocat", "plan"];
        words.extend(self.segment.as_deref());
        words.extend(self.chips.as_deref().into_iter().flat_map(|file| ["--chips", file]));
        words.extend(self.suggest.then_some("--suggest"));
        if self.prove {
            words.extend(["--prove", "--for", &duration]);
        }
        if self.prove || self.what_if.is_some() {
            words.extend(["--seed", &seed]);
        }
        let gone = self.gone.map(argument);
        let devices = self.what_if.as_ref().map(|devices| match devices.as_str() {
            "all" => "--what-if".to_owned(),
            devices => format!("--what-if={devices}"),
        });
        words.extend(devices.as_deref());
        words.extend(gone.iter().flat_map(|gone| ["--gone", gone]));
        let law = self.drift_law.map(|law| law.to_string());
        words.extend(law.iter().flat_map(|law| ["--drift-law", law]));
        command(&words)
    }
}

/// A tool by its name, or a duration.
fn purpose(text: &str) -> Result<Purpose, String> {
    if let Some(tool) = Tool::named(text) {
        return Ok(Purpose::Tool(tool));
    }
    let tools: Vec<_> = Tool::ALL.into_iter().map(Tool::name).collect();
    let expected = |error| format!("{error}; or the name of a tool: {}", tools.join(", "));
    duration(text).map(Purpose::Duration).map_err(expected)
}

/// Prints the plan for a tool, or writes its files; the exit code is that of the plan.
fn for_tool(tool: Tool, out: Option<&Path>, plan: &Plan, scenario: &Scenario) -> u8 {
    let files = tool.files(plan, scenario);
    let code = match out {
        None => {
            // Several documents of YAML in one stream are told apart by this line.
            let texts: Vec<_> = files.into_iter().map(|file| file.text).collect();
            print(&texts.join("---\n"))
        }
        Some(path) => match write_files(tool, path, files) {
            Ok(()) => IN_SYNC,
            Err(message) => return fail(&message),
        },
    };
    if plan.fits() || code != IN_SYNC { code } else { NOT_IN_SYNC }
}

fn write_files(tool: Tool, path: &Path, files: Vec<File>) -> Result<(), String> {
    let unwritable =
        |path: &Path, error: &_| super::run::unwritable(tool.name(), Some(path), error);
    if tool.many_files() {
        std::fs::create_dir_all(path).map_err(|error| unwritable(path, &error))?;
    }
    for File { name, text } in files {
        let path = if tool.many_files() { path.join(name) } else { path.to_owned() };
        super::output::write(&path, text).map_err(|error| unwritable(&path, &error))?;
    }
    Ok(())
}

/// A time for which something is gone.
fn gone(text: &str) -> Result<Nanos, String> {
    let time = duration(text)?;
    match time <= what_if::LONGEST {
        true => Ok(time),
        false => Err(format!("expected {} at most, found {text}", what_if::LONGEST)),
    }
}

/// SubDevices by position or name, in a list; or all.
fn positions(list: &str, scenario: &Scenario) -> Result<Vec<usize>, String> {
    let devices = &scenario.devices;
    if list == "all" {
        return Ok((0..devices.len()).collect());
    }
    let position = |word: &str| {
        let named = devices.iter().position(|device| device.name == word);
        let numbered = || word.parse().ok().filter(|at| *at < devices.len());
        named.or_else(numbered).ok_or_else(|| {
            let last = devices.len() - 1;
            format!(
                "--what-if: no SubDevice {word:?}; expected names or positions, 0 to {last}, or all"
            )
        })
    };
    list.split(',').map(|word| position(word.trim())).collect()
}

/// Cases that are over.
fn cases_bar(cases: usize) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {pos} of {len} cases, {eta} left");
    let bar = ProgressBar::new(cases as u64);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// What an EEPROM lacks for OP, to be said behind an error that can come of it.
pub(super) fn lack(cause: &Cause, image: &[u8]) -> String {
    if !matches!(cause, Cause::Mapping { .. } | Cause::Sii { .. }) {
        return String::new();
    }
    let file = SiiFile::from_bytes("EEPROM", image).ok();
    let lack = file.and_then(|file| file.doubts.into_iter().find(|doubt| doubt.keeps_from_op));
    lack.map_or_else(String::new, |lack| format!("; its EEPROM can't bring a device to OP: {lack}"))
}

/// An error with the place of its device in the segment file.
pub(super) fn place(scenario: &Scenario, error: &isocat_maindevice::Error) -> String {
    let position = error.cause.place().map(|place| place.position);
    match position.and_then(|position| scenario.devices.get(position)) {
        Some(device) => {
            let lack = lack(&error.cause, &device.profile.sii);
            format!("{}:{}: {error}{lack}", scenario.source, device.line)
        }
        None => format!("{}: {error}", scenario.source),
    }
}

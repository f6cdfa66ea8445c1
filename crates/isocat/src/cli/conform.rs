//! `isocat conform`.

use std::cell::Cell;
use std::path::PathBuf;

use clap::Args;
use isocat_conform as conform;
use isocat_conform::Progress;
use isocat_conform::report::{ConformanceReport, DeviceReport, heading, list};
use isocat_conform::rules::{self, Rule};
use isocat_conform::subject::Hints;
use isocat_conform::wire::{VirtualWire, Wire};
use isocat_descriptions::limits;
use isocat_segment::profile;
use isocat_segment::segment_file::{SubDevice, vocabulary};
use isocat_segment::{Scenario, SegmentFile};

use super::run::{command, is_page, unwritable, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

const EXAMPLES: &str = "\
Examples:
  isocat conform kollmorgen_akd2g           a built-in device, in virtual time
  isocat conform my-device.toml             a device profile of your own
  isocat conform my.toml --junit out.xml    each device of a segment file, for a build server
  isocat conform my.toml --rule CNT         one group of rules; or one rule, --rule CNT-03
  isocat conform --list                     the rules, without trying them; --faults: what breaks them
  isocat conform --interface eth0           what is on a real wire (root)

Results are printed as they come. Ctrl-C ends the suite: what was found until then is kept, the rest is \"not judged\", as are
rules during which frames were lost or late.

Exit code: 0 every rule that applies holds, 1 one does not or was not judged, 2 bad input.";

/// Arguments of `conform`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// A built-in device, a device profile, or a segment file, each device of which is tested, at
    /// cycles that the suite chooses
    #[arg(value_name = "DEVICE|SEGMENT.toml")]
    subject: Option<String>,
    /// Test the segment on this network interface; DEVICE or SEGMENT.toml is what is expected there
    /// (root)
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "IF")]
    interface: Option<String>,
    /// Network namespace of the interface, as `ip netns` names it
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "NAME", requires = "interface")]
    netns: Option<String>,
    /// Test only this rule, or the rules of this group (OBJ, ACC, REF, MODE, AL, CNT, TIME, REC);
    /// may be given several times
    #[arg(long = "rule", value_name = "ID")]
    rules: Vec<String>,
    /// Print the rules without testing them
    #[arg(long)]
    list: bool,
    /// Print the words of `misbehave` in a segment file, to see a rule fail
    #[arg(long)]
    faults: bool,
    /// Print the report as one JSON document
    #[arg(long)]
    json: bool,
    /// Also write the report to this file: a page if it ends in .html, JSON if in .json, otherwise
    /// text
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Also write the report to this file as JUnit
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
}

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    match arguments.run() {
        Ok(code) => code,
        Err(message) => fail(&message),
    }
}

impl Arguments {
    fn run(&self) -> Result<u8, String> {
        for id in &self.rules {
            if !rules::all().any(|rule| is_named(rule, id)) {
                let hint = profile::name_hint(id, rules::all().map(|rule| rule.id));
                return Err(format!("unknown rule \"{id}\"\n{hint}"));
            }
        }
        if self.list {
            return Ok(print(&list(rules::all().filter(|rule| self.wants(rule)))));
        }
        if self.faults {
            let width = vocabulary().map(|(word, _)| word.len()).max().unwrap_or(0);
            let lines = vocabulary().map(|(word, means)| format!("{word:width$}  {means}\n"));
            return Ok(print(&lines.collect::<String>()));
        }
        let file = self.subject.as_deref().map(segment).transpose()?;
        let printed = Cell::new(IN_SYNC);
        let (source, devices) = self.examine(file, &printed)?;
        let report = ConformanceReport::new(&source, devices);
        if let Some(path) = &self.junit {
            super::output::write(path, report.junit())
                .map_err(|error| unwritable("JUnit", Some(path), &error))?;
        }
        let page = is_page(self.report.as_deref()).then(|| {
            let mut words = vec!["isocat", "conform"];
            words.extend(self.subject.as_deref());
            #[cfg(target_os = "linux")]
            words.extend(self.interface.iter().flat_map(|interface| ["--interface", interface]));
            #[cfg(target_os = "linux")]
            words.extend(self.netns.iter().flat_map(|netns| ["--netns", netns]));
            words.extend(self.rules.iter().flat_map(|rule| ["--rule", rule]));
            crate::html::conform::page(&report, &command(&words))
        });
        write_report(self.report.as_deref(), &report, &report.text(), page.as_ref())?;
        // The text is there already.
        let code = if self.json { print(&super::run::json(&report)) } else { printed.get() };
        Ok(match code {
            IN_SYNC if !report.passed => NOT_IN_SYNC,
            BAD_INPUT => BAD_INPUT,
            code => code,
        })
    }

    #[cfg(target_os = "linux")]
    fn examine(
        &self,
        file: Option<SegmentFile>,
        printed: &Cell<u8>,
    ) -> Result<(String, Vec<DeviceReport>), String> {
        let Some(interface) = &self.interface else { return self.examine_virtual(file, printed) };
        let socket = isocat_host::RawSocket::open(interface, self.netns.as_deref())
            .map_err(|error| error.to_string())?;
        let stop = super::interface::stop_on_signals().map_err(|error| error.to_string())?;
        let mut wire = conform::wire::RawWire::new(socket).until(stop);
        let found = conform::count(&mut wire)?;
        let expected = file.as_ref().map_or(usize::from(found), |file| file.subdevices.len());
        if usize::from(found) != expected || found == 0 {
            let least = if file.is_some() { expected.to_string() } else { "1 or more".to_owned() };
            return Err(format!("{interface}: {found} SubDevices answer, expected {least}"));
        }
        let devices = file.map(|file| file.subdevices).unwrap_or_default();
        let reports = self.examine_each(&mut wire, found, &devices, printed)?;
        Ok((interface.clone(), reports))
    }

    #[cfg(not(target_os = "linux"))]
    fn examine(
        &self,
        file: Option<SegmentFile>,
        printed: &Cell<u8>,
    ) -> Result<(String, Vec<DeviceReport>), String> {
        self.examine_virtual(file, printed)
    }

    fn examine_virtual(
        &self,
        file: Option<SegmentFile>,
        printed: &Cell<u8>,
    ) -> Result<(String, Vec<DeviceReport>), String> {
        let file = file.ok_or(
            "a device or a segment file is needed\nisocat devices lists the built-in ones",
        )?;
        let scenario = Scenario::from(file);
        let (source, devices) = (scenario.source.clone(), scenario.devices.clone());
        let count = u16::try_from(devices.len()).unwrap_or(u16::MAX);
        let mut wire = VirtualWire::new(scenario);
        Ok((source, self.examine_each(&mut wire, count, &devices, printed)?))
    }

    fn examine_each(
        &self,
        wire: &mut dyn Wire,
        count: u16,
        devices: &[SubDevice],
        printed: &Cell<u8>,
    ) -> Result<Vec<DeviceReport>, String> {
        let bar = super::run::progress_bar(isocat_wire::Nanos(0));
        let mut reports = Vec::new();
        for position in 0..count {
            let device = devices.get(usize::from(position));
            let name = device.map_or(format!("SubDevice {position}"), |device| device.name.clone());
            let hints = device.map(Hints::of).transpose().map_err(|error| error.to_string())?;
            let hints = hints.unwrap_or_default();
            let wants = |rule: &Rule| self.wants(rule);
            // On a real wire a group takes its time-outs, so results are printed as they come.
            let show = |text: String| {
                if !self.json && printed.get() == IN_SYNC {
                    printed.set(bar.suspend(|| print(&text)));
                }
            };
            let report = conform::examine(wire, position, &name, &hints, wants, |now| match now {
                Progress::Begins(examined, modes) => {
                    show(heading(&name, position, examined, modes))
                }
                Progress::Trying(rule) => bar.set_message(format!("{name}: {}", rule.id)),
                Progress::Done(result) => show(result.text()),
            })?;
            show(report.summary());
            reports.push(report);
        }
        bar.finish_and_clear();
        Ok(reports)
    }

    fn wants(&self, rule: &Rule) -> bool {
        self.rules.is_empty() || self.rules.iter().any(|id| is_named(rule, id))
    }
}

fn is_named(rule: &Rule, name: &str) -> bool {
    let group = rule.id.split('-').next().unwrap_or(rule.id);
    rule.id.eq_ignore_ascii_case(name) || group.eq_ignore_ascii_case(name)
}

/// A segment with a built-in device, or a segment file.
fn segment(name: &str) -> Result<SegmentFile, String> {
    if name.ends_with(".toml") || name.contains('/') {
        let is_profile = limits::read_text(name, limits::TOML)
            .is_ok_and(|text| text.lines().any(|line| line.trim() == "[identity]"));
        if !is_profile {
            return SegmentFile::read(name).map_err(|error| error.to_string());
        }
        // A device profile: it stands alone.
        let path = std::path::absolute(name).map_err(|error| format!("{name}: {error}"))?;
        return SegmentFile::parse(name, &conform::segment_of(&path.display().to_string()))
            .map_err(|error| error.to_string());
    }
    if profile::built_in(name).is_none() {
        let hint = profile::name_hint(name, profile::built_in_ids());
        return Err(format!("unknown device \"{name}\"\n{hint}"));
    }
    SegmentFile::parse(name, &conform::segment_of(name)).map_err(|error| error.to_string())
}

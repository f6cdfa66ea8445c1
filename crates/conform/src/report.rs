//! The result of the suite: one document, for people and for machines.

use std::fmt::Write;

use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_descriptions::markup::escaped;
use isocat_segment::profile::Deviation;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::case::{Done, Stop};
use super::evidence::Evidence;
use super::mode::Mode;
use super::rules::{Check, Rule};

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-conformance-report/2";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<ConformanceReport>(FORMAT)
}

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ConformanceReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The device, the segment file or the interface.
    pub source: String,
    /// Whether no rule failed and every chosen rule was judged.
    pub passed: bool,
    /// The SubDevices, in the order of their positions.
    pub devices: Vec<DeviceReport>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceReport {
    /// Its name.
    pub name: String,
    /// Its position.
    pub position: u16,
    /// Rules that it keeps.
    pub passed: usize,
    /// Rules that it breaks.
    pub failed: usize,
    /// Rules that it breaks as its profile says.
    pub known_deviations: usize,
    /// Rules without a verdict: frames were lost or late, or the suite ended before.
    pub not_judged: usize,
    /// Rules that do not apply to it, or depend on another rule that fails.
    pub not_applicable: usize,
    /// What the suite examined: a device, or a stand-in.
    pub examined: Examined,
    /// Why the last rules were not tried: an interruption, or a failure of this machine.
    pub broken_off: Option<String>,
    /// Modes that it announces.
    pub modes: Vec<ModeResult>,
    /// The result of each rule.
    pub rules: Vec<RuleResult>,
}

/// What the suite examined. A failure of a simulated device is first a failure of the simulation:
/// of its profile or description, or of what was assumed where these say nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Examined {
    /// The device that answers on a real interface.
    Interface,
    /// A simulated device made from a device profile.
    SimulatedProfile,
    /// A simulated device made from its maker's description (ESI). Objects and process data are
    /// those of the description; states, timing and counters are those of the simulated stack.
    SimulatedDescription,
}

impl Examined {
    /// What the verdicts are about, as a sentence; `None`: the device itself.
    pub const fn note(self) -> Option<&'static str> {
        match self {
            Self::Interface => None,
            Self::SimulatedProfile => Some(
                "Judged is a simulated device made from its profile, not the product. --interface examines a product.",
            ),
            Self::SimulatedDescription => Some(
                "Judged is a simulated stand-in made from the maker's description, not the product: its objects are \
                 the description's, its states, times and counters those of the stand-in. --interface examines a \
                 product.",
            ),
        }
    }
}

/// A mode that a SubDevice announces.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ModeResult {
    /// Its name.
    pub name: &'static str,
    /// Why the suite does not try it.
    pub untried: Option<&'static str>,
}

impl ModeResult {
    /// Takes a mode from the table of modes.
    pub fn new(mode: &Mode) -> Self {
        Self { name: mode.name(), untried: mode.untried }
    }
}

/// The result of a rule.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", schemars(inline))]
pub enum Verdict {
    /// The rule holds.
    Pass,
    /// The rule does not hold.
    Fail,
    /// The rule does not hold, and the device's profile says so and why.
    KnownDeviation,
    /// The observation does not allow a verdict: frames were lost or late, or the suite ended
    /// before.
    NotJudged,
    /// The rule does not apply to the SubDevice, or depends on another rule that fails.
    NotApplicable,
}

impl Verdict {
    /// The verdict in one word.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::KnownDeviation => "dev",
            Self::NotJudged => "open",
            Self::NotApplicable => "n/a",
        }
    }
}

/// A rule and its result.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct RuleResult {
    /// Its name.
    pub id: &'static str,
    /// What it requires.
    pub what: &'static str,
    /// Where the requirement is written.
    pub source: &'static str,
    /// The result.
    pub verdict: Verdict,
    /// Why it does not apply or was not judged, by mode if it is tried in several modes.
    pub why: Vec<String>,
    /// Further information for the reader, for example which of several correct behaviours was
    /// found.
    pub notes: Vec<String>,
    /// What was looked at.
    pub evidence: Vec<Evidence>,
}

impl RuleResult {
    /// The result of a rule that was not tried yet.
    pub fn new(rule: &Rule) -> Self {
        Self {
            id: rule.id,
            what: rule.what,
            source: rule.source,
            verdict: Verdict::NotApplicable,
            why: Vec::new(),
            notes: Vec::new(),
            evidence: Vec::new(),
        }
    }

    /// A rule that can't be tried because another one fails.
    pub fn blocked(rule: &Rule, by: &str, why: &str) -> Self {
        Self { why: vec![format!("needs {by}: {why}")], ..Self::new(rule) }
    }

    /// A rule that does not apply to this kind of SubDevice.
    pub fn not_applicable(rule: &Rule, why: &str) -> Self {
        Self { why: vec![why.to_owned()], ..Self::new(rule) }
    }

    /// A rule without a verdict.
    pub fn not_judged(rule: &Rule, why: &str) -> Self {
        let verdict = Verdict::NotJudged;
        Self { verdict, why: vec![format!("not judged: {why}")], ..Self::new(rule) }
    }

    /// Adds the result of one check. `mode`: its mode, if the rule is tried in several.
    pub fn add(
        &mut self,
        mode: Option<&str>,
        evidence: Vec<Evidence>,
        notes: Vec<String>,
        done: Done,
    ) {
        let with_mode = |text: String| match mode {
            Some(mode) => format!("{mode}: {text}"),
            None => text,
        };
        let wrong = evidence.iter().any(|evidence| !evidence.right);
        let mut verdict = match (evidence.is_empty(), wrong) {
            (_, true) => Verdict::Fail,
            (true, _) => Verdict::NotApplicable,
            (false, false) => Verdict::Pass,
        };
        match done {
            Ok(()) if evidence.is_empty() => {
                self.why.push(with_mode("there was nothing to look at".to_owned()));
            }
            Ok(()) => {}
            Err(Stop::NotApplicable(why)) => self.why.push(with_mode(why)),
            Err(Stop::Blocked { by, why }) => {
                self.why.push(with_mode(format!("needs {by}: {why}")));
                // A check that did not end proves nothing.
                if by != self.id && !wrong {
                    verdict = Verdict::NotApplicable;
                } else {
                    verdict = Verdict::Fail;
                }
            }
            Err(Stop::Trouble(trouble)) => {
                self.why.push(with_mode(trouble.what));
                verdict = Verdict::Fail;
            }
            Err(Stop::NotJudged(why)) => {
                self.why.push(with_mode(format!("not judged: {why}")));
                verdict = Verdict::NotJudged;
            }
        }
        // A mode without a verdict leaves the rule open, unless another mode breaks it.
        self.verdict = match (self.verdict, verdict) {
            (Verdict::Fail, _) | (_, Verdict::Fail) => Verdict::Fail,
            (Verdict::NotJudged, _) | (_, Verdict::NotJudged) => Verdict::NotJudged,
            (Verdict::Pass, _) | (_, Verdict::Pass) => Verdict::Pass,
            _ => Verdict::NotApplicable,
        };
        let place = |evidence: Evidence| Evidence { place: with_mode(evidence.place), ..evidence };
        self.evidence.extend(evidence.into_iter().map(place));
        self.notes.extend(notes.into_iter().map(with_mode));
    }

    /// Applies a deviation that the profile states for this rule. A rule that holds nevertheless
    /// fails, because the profile is wrong; a fault at another place than the profile states
    /// remains a fault.
    pub fn deviates(&mut self, known: &Deviation) {
        let at = |place: &str, known: &String| {
            place.split_whitespace().any(|word| word.trim_end_matches(':') == known)
        };
        let wrong = || self.evidence.iter().filter(|evidence| !evidence.right);
        let elsewhere = wrong().any(|e| !known.places.iter().any(|known| at(&e.place, known)));
        match self.verdict {
            Verdict::NotApplicable | Verdict::NotJudged => return,
            Verdict::Pass => {
                self.verdict = Verdict::Fail;
                self.why.push("its profile names a deviation that is not there".to_owned());
            }
            _ if elsewhere || wrong().next().is_none() => {}
            _ => self.verdict = Verdict::KnownDeviation,
        }
        self.notes.push(format!("known of {}: {}", known.places.join(", "), known.why));
    }

    /// Applies an assumption: if a stand-in breaks this rule only because of what was assumed for
    /// it, that says nothing about the device.
    pub fn rests_on_assumption(&mut self, why: &str) {
        if self.verdict == Verdict::Fail {
            self.verdict = Verdict::NotApplicable;
            self.evidence.clear();
            self.why = vec![format!("{why}: the stand-in's behaviour is assumed")];
        }
    }

    /// The faults, one line each.
    fn faults(&self) -> Vec<String> {
        let wrong = self.evidence.iter().filter(|evidence| !evidence.right);
        let mut lines: Vec<_> = wrong
            .map(|e| format!("{}: expected {}, found {}", e.place, e.expected, e.found))
            .collect();
        // The reasons of modes in which the rule does not apply are no faults.
        if lines.is_empty() {
            lines.extend(self.why.iter().cloned());
        }
        lines
    }
}

impl DeviceReport {
    /// Makes the report and counts the verdicts.
    pub fn new(
        (name, position): (&str, u16),
        examined: Examined,
        broken_off: Option<String>,
        modes: Vec<ModeResult>,
        rules: Vec<RuleResult>,
    ) -> Self {
        let count = |verdict| rules.iter().filter(|rule| rule.verdict == verdict).count();
        Self {
            name: name.to_owned(),
            position,
            passed: count(Verdict::Pass),
            failed: count(Verdict::Fail),
            known_deviations: count(Verdict::KnownDeviation),
            not_judged: count(Verdict::NotJudged),
            not_applicable: count(Verdict::NotApplicable),
            examined,
            broken_off,
            modes,
            rules,
        }
    }
}

impl ConformanceReport {
    /// Makes the document of some SubDevices.
    pub fn new(source: &str, devices: Vec<DeviceReport>) -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            source: source.to_owned(),
            passed: devices.iter().all(|device| device.failed + device.not_judged == 0),
            devices,
        }
    }

    /// The document for people: a table of rules, with the faults below each.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for device in &self.devices {
            text += &device.text();
        }
        text
    }

    /// The document as JUnit XML for build servers: a suite for each SubDevice, a case for each
    /// rule.
    pub fn junit(&self) -> String {
        let mut text = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        let count = |of: fn(&DeviceReport) -> usize| self.devices.iter().map(of).sum::<usize>();
        let _ = writeln!(
            text,
            "<testsuites name=\"isocat conform\" tests=\"{}\" failures=\"{}\" skipped=\"{}\">",
            count(|device| device.rules.len()),
            count(|device| device.failed),
            count(DeviceReport::skipped)
        );
        for device in &self.devices {
            let _ = junit_suite(&mut text, device);
        }
        text + "</testsuites>\n"
    }
}

/// A list of rules for people, without results.
pub fn list<'r>(rules: impl Iterator<Item = &'r Rule>) -> String {
    let mut text = String::new();
    for rule in rules {
        let each = matches!(rule.check, Check::EachMode(_));
        let _ = writeln!(text, "{:<8} {}", rule.id, rule.what);
        let _ = writeln!(text, "         source:  {}", rule.source);
        let scope = if each { "in each mode; " } else { "" };
        let _ = writeln!(text, "         applies: {scope}{}", rule.applies);
    }
    text
}

/// The beginning of a device's text, which can be written as soon as its modes are known.
pub fn heading(name: &str, position: u16, examined: Examined, modes: &[ModeResult]) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{HEAD}{name} at position {position}{HEAD:#}");
    for line in examined.note().iter().flat_map(|note| wrap(note, WIDTH - 2)) {
        let _ = writeln!(out, "  {QUIET}{line}{QUIET:#}");
    }
    for mode in modes {
        if let Some(why) = mode.untried {
            let _ = writeln!(out, "  mode {} is announced and not tried: {why}", mode.name);
        }
    }
    out
}

impl RuleResult {
    /// The lines of this rule in a device's text.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let style = match self.verdict {
            Verdict::Pass => GOOD,
            Verdict::Fail => BAD,
            Verdict::KnownDeviation | Verdict::NotJudged => KNOWN,
            Verdict::NotApplicable => QUIET,
        };
        let mut lines = wrap(self.what, WIDTH - 17);
        let first = if lines.is_empty() { String::new() } else { lines.remove(0) };
        // Writing to a String cannot fail.
        let word = self.verdict.word();
        let _ = writeln!(out, "  {style}{word:<4}{style:#}  {:<8} {first}", self.id);
        for line in lines {
            let _ = writeln!(out, "                 {line}");
        }
        let faults = self.faults();
        let more = faults.len().saturating_sub(MOST_FAULTS);
        let mut below: Vec<String> = match self.verdict {
            Verdict::Pass => Vec::new(),
            _ => faults.into_iter().take(MOST_FAULTS).collect(),
        };
        if more > 0 && self.verdict != Verdict::Pass {
            below.push(format!("... and {more} more"));
        }
        if matches!(self.verdict, Verdict::Fail | Verdict::KnownDeviation) {
            below.push(format!("source: {}", self.source));
        }
        below.extend(self.notes.iter().cloned());
        for line in below.iter().flat_map(|line| wrap(line, WIDTH - 19)) {
            let _ = writeln!(out, "                   {QUIET}{line}{QUIET:#}");
        }
        out
    }
}

impl DeviceReport {
    /// The report for people: [`heading`], each rule, [`summary`](Self::summary).
    pub fn text(&self) -> String {
        let rules = self.rules.iter().map(RuleResult::text).collect::<String>();
        heading(&self.name, self.position, self.examined, &self.modes) + &rules + &self.summary()
    }

    /// The end of the text: how many rules hold, and how many do not.
    pub fn summary(&self) -> String {
        let style = match (self.failed, self.not_judged) {
            (0, 0) => GOOD,
            (0, _) => KNOWN,
            _ => BAD,
        };
        let deviate = match self.known_deviations {
            0 => String::new(),
            1 => "1 deviates as known, ".to_owned(),
            n => format!("{n} deviate as known, "),
        };
        let open = match self.not_judged {
            0 => String::new(),
            1 => "1 was not judged, ".to_owned(),
            n => format!("{n} were not judged, "),
        };
        let end = match &self.broken_off {
            Some(why) => format!(" (broken off: {why})"),
            None => String::new(),
        };
        format!(
            "{style}{} at position {}: {} rules hold, {} fail, {deviate}{open}{} do not apply{end}{style:#}\n",
            self.name, self.position, self.passed, self.failed, self.not_applicable
        )
    }

    /// The number of cases that JUnit calls skipped.
    fn skipped(&self) -> usize {
        self.not_applicable + self.not_judged + self.known_deviations
    }
}

fn junit_suite(out: &mut String, device: &DeviceReport) -> std::fmt::Result {
    let name = escaped(&format!("{} at position {}", device.name, device.position));
    writeln!(
        out,
        "  <testsuite name=\"{name}\" tests=\"{}\" failures=\"{}\" skipped=\"{}\">",
        device.rules.len(),
        device.failed,
        device.skipped()
    )?;
    for rule in &device.rules {
        let (id, what) = (rule.id, escaped(rule.what));
        let group = id.split('-').next().unwrap_or(id);
        write!(out, "    <testcase classname=\"{group}\" name=\"{id} {what}\"")?;
        let mut faults = rule.faults();
        if rule.verdict == Verdict::KnownDeviation {
            faults.extend(rule.notes.iter().cloned());
        }
        let text = escaped(&faults.join("\n"));
        let source = escaped(rule.source);
        match rule.verdict {
            Verdict::Pass => writeln!(out, "/>")?,
            Verdict::Fail => writeln!(
                out,
                ">\n      <failure message=\"{source}\">{text}</failure>\n    </testcase>"
            )?,
            // JUnit has no other word for these.
            Verdict::NotApplicable | Verdict::NotJudged | Verdict::KnownDeviation => {
                writeln!(out, ">\n      <skipped message=\"{text}\"/>\n    </testcase>")?;
            }
        }
    }
    writeln!(out, "  </testsuite>")
}

/// Faults of one rule that the text shows.
const MOST_FAULTS: usize = 8;
const GOOD: anstyle::Style = anstyle::AnsiColor::Green.on_default().bold();
const BAD: anstyle::Style = anstyle::AnsiColor::Red.on_default().bold();
const KNOWN: anstyle::Style = anstyle::AnsiColor::Yellow.on_default();
const HEAD: anstyle::Style = anstyle::Style::new().bold();
const QUIET: anstyle::Style = anstyle::Style::new().dimmed();

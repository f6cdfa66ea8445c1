//! The conformance suite: does a SubDevice synchronize as it says, seen from the MainDevice's side?
//!
//! [`wire`] carries frames, in virtual time or on a real interface; `tester` and `mailbox` make
//! registers, states, objects and an exchange of it, each frame at its own instant. [`subject`] is
//! what the SubDevice tells about itself, [`rules`] what it has to do, and `case` what a rule works
//! with. Of all that comes a [`report`].
//!
//! That the rules are not blind is proven by devices that break each of them: see
//! [`Misbehaviour`](isocat_subdevice::Misbehaviour).
#![forbid(unsafe_code)]

mod case;
pub mod evidence;
mod mailbox;
mod mode;
pub mod report;
pub mod rules;
pub mod subject;
mod tester;
pub mod wire;

use case::{Case, Done, Stop};
use isocat_descriptions::document::{FileError, name_hint};
use isocat_segment::profile::{self, Profile};
use isocat_segment::segment_file::SubDevice;
use isocat_wire::AlState;
use mode::MODES;
use report::{DeviceReport, ModeResult, RuleResult, Verdict};
use rules::{Check, Rule};
use subject::{Hints, Subject};
use tester::{Tester, Trouble};
use wire::Wire;

impl Hints {
    /// What a segment file knows of a device. An error names a deviation of its profile whose rule there is not.
    pub fn of(device: &SubDevice) -> Result<Self, FileError> {
        let profile = device.profile;
        let known = || rules::all().map(|rule| rule.id);
        for deviation in &profile.deviations {
            let rule = &deviation.rule;
            if !known().any(|known| known == rule) {
                let expected = "expected a rule of isocat conform, such as \"OBJ-04\"";
                let error = deviation.at.error(format!("unknown rule \"{rule}\"; {expected}"));
                return Err(error.with_hint(name_hint(rule, known())));
            }
        }
        Ok(Self {
            outputs: profile.assignment.outputs.clone(),
            inputs: profile.assignment.inputs.clone(),
            modes: profile.modes().collect(),
            identity: Some((profile.identity.vendor_id, profile.identity.product_code)),
            deviations: profile.deviations.clone(),
        })
    }
}

/// Tries the rules on the SubDevice at `position`. `chosen` tells which; `progress` is told each before it is
/// tried. An error is one of this machine, not of the SubDevice.
pub fn examine(
    wire: &mut dyn Wire,
    position: u16,
    name: &str,
    hints: &Hints,
    chosen: impl Fn(&Rule) -> bool,
    mut progress: impl FnMut(&Rule),
) -> Result<DeviceReport, String> {
    let mut tester = Tester::new(wire, position);
    let (subject, survey) = match Subject::survey(&mut tester, hints) {
        Ok((subject, al)) if al.is(AlState::PreOp) => (subject, None),
        Ok((subject, al)) => (subject, Some(format!("PREOP is not reached: {al}"))),
        Err(trouble) if trouble.own => return Err(trouble.what),
        Err(trouble) => (Subject::default(), Some(trouble.what)),
    };
    let found = (subject.header.vendor_id, subject.header.product_code);
    if survey.is_none() && hints.identity.is_some_and(|expected| expected != found) {
        let (vendor, product) = hints.identity.unwrap_or_default();
        return Err(format!(
            "position {position}: expected {name}, vendor 0x{vendor:08X}, product 0x{product:08X}; found vendor \
             0x{:08X}, product 0x{:08X}",
            found.0, found.1
        ));
    }
    let mut results = Vec::new();
    for rule in rules::all().filter(|rule| chosen(rule)) {
        progress(rule);
        let mut result = match (&survey, rule.id) {
            (Some(why), id) if id != "MODE-01" => RuleResult::blocked(rule, "MODE-01", why),
            _ => apply(rule, &mut tester, &subject)?,
        };
        if let Some(known) = hints.deviations.iter().find(|known| known.rule == rule.id) {
            result.deviates(known);
        }
        results.push(result);
    }
    // The device is left as quiet as it was found.
    let _ended = tester.restart();
    let modes = subject.modes.iter().map(ModeResult::new).collect();
    Ok(DeviceReport::new(name, position, modes, results))
}

fn apply(rule: &Rule, t: &mut Tester<'_>, s: &Subject) -> Result<RuleResult, String> {
    let mut result = RuleResult::new(rule);
    let (check, modes) = match rule.check {
        Check::Once(check) => (check, &MODES[..1]),
        Check::EachMode(check) => (check, &s.modes[..]),
    };
    let each = matches!(rule.check, Check::EachMode(_));
    if modes.is_empty() {
        result.verdict = Verdict::NotApplicable;
        result.why.push("it announces no mode".to_owned());
    }
    for mode in modes {
        for attempt in 1.. {
            let evidence = Vec::new();
            let mut case = Case { t: &mut *t, s, mode: *mode, evidence, notes: Vec::new() };
            let done: Done = (check)(&mut case);
            let Case { evidence, notes, .. } = case;
            if let Err(Stop::Trouble(Trouble { what, own: true })) = done {
                return Err(what);
            }
            let name = each.then_some(mode.name());
            let good = evidence.iter().all(|evidence| evidence.right)
                && matches!(done, Ok(()) | Err(Stop::NotApplicable(_)));
            match t.was_late() {
                // Whatever a late frame led to is not the SubDevice's doing.
                Some(late) if !good && attempt == MOST_ATTEMPTS => {
                    let why =
                        format!("this machine sent frames up to {late} late, {attempt} times");
                    result.add(name, Vec::new(), notes, Err(Stop::NotApplicable(why)));
                }
                Some(_) if !good => continue,
                _ => result.add(name, evidence, notes, done),
            }
            break;
        }
    }
    Ok(result)
}

/// A machine that is late is given so many chances.
const MOST_ATTEMPTS: u32 = 3;

/// A segment file with just this device, a built-in profile or the path of a profile file. A
/// terminal stands at the side of the MainDevice, on EBUS.
pub fn segment_of(device: &str) -> String {
    let host = if is_on_ebus(device) { "host = { port = \"ebus\" }\n" } else { "" };
    format!("cycle = \"1ms\"\n{host}[[subdevice]]\nname = \"{device}\"\ndevice = \"{device}\"\n")
}

/// What can't be read is refused with its reason where the segment file is.
fn is_on_ebus(device: &str) -> bool {
    let of_file = || Profile::from_toml(device, &std::fs::read_to_string(device).ok()?).ok();
    profile::built_in(device).or_else(of_file).is_some_and(Profile::is_on_ebus)
}

/// How many SubDevices there are.
pub fn count(wire: &mut dyn Wire) -> Result<u16, String> {
    Tester::new(wire, 0).count().map_err(|trouble| trouble.what)
}

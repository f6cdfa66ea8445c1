//! The conformance suite tests from the MainDevice's side whether a SubDevice synchronizes as it
//! states.
//!
//! [`wire`] carries frames, in virtual time or on a real interface. `tester` and `mailbox` build
//! registers, states, objects and an exchange on it, where each frame has its own instant.
//! [`subject`] holds what the SubDevice says about itself, [`rules`] what it has to do, and `case`
//! is the environment of a rule. The result is a [`report`].
//!
//! Simulated devices that break each rule prove that the rules find faults: see
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
use isocat_descriptions::limits;
use isocat_segment::profile::{self, Origin, Profile};
use isocat_segment::segment_file::SubDevice;
use isocat_sync::object::{OUTPUT_PARAMETER, sub};
use isocat_wire::{AlState, ObjectAddress};
use mode::MODES;
use report::{DeviceReport, Examined, ModeResult, RuleResult, Verdict};
use rules::{Check, Rule};
use subject::{Hints, Subject};
use tester::{Disturbance, Tester, Trouble};
use wire::Wire;

impl Hints {
    /// Takes what a segment file knows of a device. `Err`: its profile names a deviation from a
    /// rule that does not exist.
    pub fn of(device: &SubDevice) -> Result<Self, FileError> {
        let profile = &device.profile;
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
            stand_in: Some(profile.origin),
            assumed: assumed(profile),
        })
    }
}

/// What a rule depends on and a maker's description does not state: rules, each with what is
/// missing.
fn assumed(profile: &Profile) -> Vec<(&'static str, &'static str)> {
    if profile.origin == Origin::Profile {
        return Vec::new();
    }
    let mut assumed = vec![(
        "AL-16",
        "the description does not tell whether the device checks the watchdog's settings",
    )];
    let delay = ObjectAddress::new(OUTPUT_PARAMETER, sub::DELAY_TIME);
    if profile.assumptions.iter().any(|assumption| assumption.item == delay.to_string()) {
        assumed.push(("TIME-02", "the description states no delay time"));
    }
    assumed
}

/// The progress of an examination.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// The SubDevice has said what it is and which modes it has.
    Begins(Examined, &'a [ModeResult]),
    /// A rule is about to be tried.
    Trying(&'a Rule),
    /// The result of the rule.
    Done(&'a RuleResult),
}

/// Tries the rules on the SubDevice at `position`. `chosen` selects the rules; `progress` is told
/// the progress. If this machine fails or the user stops the suite, the remaining rules are not
/// judged. `Err`: the SubDevice there is not the expected one.
pub fn examine(
    wire: &mut dyn Wire,
    position: u16,
    name: &str,
    hints: &Hints,
    chosen: impl Fn(&Rule) -> bool,
    mut progress: impl FnMut(Progress<'_>),
) -> Result<DeviceReport, String> {
    let mut tester = Tester::new(wire, position);
    let (subject, survey) = survey(&mut tester, hints);
    let found = (subject.header.vendor_id, subject.header.product_code);
    if survey.is_ok() && hints.identity.is_some_and(|expected| expected != found) {
        let (vendor, product) = hints.identity.unwrap_or_default();
        return Err(format!(
            "position {position}: expected {name}, vendor 0x{vendor:08X}, product 0x{product:08X}; found vendor \
             0x{:08X}, product 0x{:08X}",
            found.0, found.1
        ));
    }
    let modes: Vec<_> = subject.modes.iter().map(ModeResult::new).collect();
    let examined = tester.examined(hints);
    progress(Progress::Begins(examined, &modes));
    let mut results = Vec::new();
    let mut broken_off = match &survey {
        Err(Stop::Trouble(trouble)) if trouble.ends_all() => Some(trouble.what.clone()),
        _ => None,
    };
    for rule in rules::all().filter(|rule| chosen(rule)) {
        progress(Progress::Trying(rule));
        let mut result = match (&broken_off, &survey) {
            (Some(why), _) => RuleResult::not_judged(rule, &format!("not tried: {why}")),
            (None, Err(Stop::NotJudged(why))) => RuleResult::not_judged(rule, why),
            (None, Err(Stop::NotApplicable(why))) => RuleResult::not_applicable(rule, why),
            (None, Err(Stop::Trouble(trouble))) if rule.id != "MODE-01" => {
                RuleResult::blocked(rule, "MODE-01", &trouble.what)
            }
            _ => {
                let (result, ended) = apply(rule, &mut tester, &subject);
                broken_off = ended;
                result
            }
        };
        if let Some(known) = hints.deviations.iter().find(|known| known.rule == rule.id) {
            result.deviates(known);
        }
        if examined != Examined::Interface
            && let Some((_, why)) = hints.assumed.iter().find(|(id, _)| *id == rule.id)
        {
            result.rests_on_assumption(why);
        }
        progress(Progress::Done(&result));
        results.push(result);
    }
    // The device is left in INIT.
    let _ended = tester.leave();
    Ok(DeviceReport::new((name, position), examined, broken_off, modes, results))
}

/// Reads what the SubDevice says about itself; the second value tells why no rule but MODE-01 can
/// be tried.
fn survey(t: &mut Tester<'_>, hints: &Hints) -> (Subject, Result<(), Stop>) {
    for attempt in 1.. {
        if t.has_device_emulation() == Ok(true) {
            let why = "device emulation (0x0141 bit 0): the ESC answers requests of states itself, and there is no \
                       program that could keep a rule";
            return (Subject::default(), Err(Stop::NotApplicable(why.to_owned())));
        }
        let asked = Subject::survey(t, hints);
        match (asked, t.disturbance()) {
            (Ok((subject, al)), _) if al.is(AlState::PreOp) => {
                let known = match subject.shares_a_direction() {
                    true => Err(Stop::NotApplicable(SHARED.to_owned())),
                    false => Ok(()),
                };
                return (subject, known);
            }
            (Err(trouble), _) if trouble.ends_all() => {
                return (Subject::default(), Err(trouble.into()));
            }
            (_, Some(_)) if attempt < MOST_ATTEMPTS => {}
            (_, Some(disturbance)) => {
                let why = not_judged(&disturbance, attempt);
                return (Subject::default(), Err(Stop::NotJudged(why)));
            }
            (Ok((subject, al)), None) => {
                let trouble = Trouble::new(format!("PREOP is not reached: {al}"));
                return (subject, Err(trouble.into()));
            }
            (Err(trouble), None) => return (Subject::default(), Err(trouble.into())),
        }
    }
    unreachable!("the last attempt has returned")
}

/// Tries one rule. The second value tells why no further rule can be tried.
fn apply(rule: &Rule, t: &mut Tester<'_>, s: &Subject) -> (RuleResult, Option<String>) {
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
            t.disturbance();
            let evidence = Vec::new();
            let mut case = Case { t: &mut *t, s, mode: *mode, evidence, notes: Vec::new() };
            let done: Done = (check)(&mut case);
            let Case { evidence, notes, .. } = case;
            let name = each.then_some(mode.name());
            if let Err(Stop::Trouble(trouble)) = &done
                && trouble.ends_all()
            {
                let stop = Stop::NotJudged(format!("not tried to the end: {}", trouble.what));
                result.add(name, Vec::new(), notes, Err(stop));
                return (result, Some(trouble.what.clone()));
            }
            let good = evidence.iter().all(|evidence| evidence.right)
                && matches!(done, Ok(()) | Err(Stop::NotApplicable(_)));
            match t.disturbance() {
                // Consequences of a lost or late frame are not the SubDevice's fault.
                Some(_) if !good && attempt < MOST_ATTEMPTS => continue,
                Some(disturbance) if !good => {
                    let stop = Stop::NotJudged(not_judged(&disturbance, attempt));
                    result.add(name, Vec::new(), notes, Err(stop));
                }
                _ => result.add(name, evidence, notes, done),
            }
            break;
        }
    }
    (result, None)
}

fn not_judged(disturbance: &Disturbance, attempts: u32) -> String {
    format!(
        "frames were lost or late in each of {attempts} attempts; in the last one {disturbance}"
    )
}

/// Why a device with several SyncManagers in one direction is not tried.
const SHARED: &str =
    "outputs or inputs are in several SyncManagers; the rules are made for one of each";
/// Attempts at a rule if frames are lost or late.
const MOST_ATTEMPTS: u32 = 3;

/// A segment file with just this device, which is a built-in profile or the path of a profile file.
/// The MainDevice's port is on EBUS if the device is a terminal on EBUS.
pub fn segment_of(device: &str) -> String {
    let host = if is_on_ebus(device) { "host = { port = \"ebus\" }\n" } else { "" };
    format!("cycle = \"1ms\"\n{host}[[subdevice]]\nname = \"{device}\"\ndevice = \"{device}\"\n")
}

/// Whether the device is on EBUS. A file that can't be read counts as not: reading the segment file
/// reports the reason.
fn is_on_ebus(device: &str) -> bool {
    let of_file =
        || Profile::from_toml(device, &limits::read_text(device, limits::TOML).ok()?).ok();
    profile::built_in(device).or_else(of_file).is_some_and(|profile| profile.is_on_ebus())
}

/// The number of SubDevices.
pub fn count(wire: &mut dyn Wire) -> Result<u16, String> {
    Tester::new(wire, 0).count().map_err(|trouble| trouble.what)
}

//! The injected faults of a run, and the results of its expectations.

use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_segment::Scenario;
use isocat_sim::course::{Sign, Stretch};
use isocat_sim::expect::{Expectation, Found, Judgement};
use isocat_sim::fault::{Moment, When};
use isocat_sim::{Outcome, Tap};
use isocat_wire::time::{Nanos, Picos, Time, True};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::text::{BAD, GOOD};

/// An injected fault that began or ended.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FaultNote {
    /// Time from the beginning of the judged time, negative on the way up; from power-on if the
    /// judged time never began.
    pub at_ns: i64,
    /// Description as a sentence; at the end of the fault with "over: " before it.
    pub what: String,
    /// Whether it began; otherwise it ended.
    pub begins: bool,
}

/// An expectation of the run.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Expected {
    /// The key of the segment file.
    pub key: String,
    /// The expectation, as a sentence.
    pub what: String,
    /// Whether it was met.
    pub met: bool,
    /// The observation, as a sentence.
    pub found: String,
}

/// The faults of a run.
pub(super) fn faults<T: Tap>(outcome: &Outcome<T>) -> Vec<FaultNote> {
    let zero = outcome.began.unwrap_or(Time::ZERO);
    let note = |happened: &isocat_sim::fault::Happened| FaultNote {
        at_ns: (happened.at - zero).0 / 1_000,
        what: happened.to_string(),
        begins: happened.begins,
    };
    let ended = outcome.ended.unwrap_or(Time::NEVER);
    let told = outcome.world.timeline().happened().filter(|happened| happened.at <= ended);
    told.map(note).collect()
}

/// The results of the expectations.
pub(super) fn expected<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>) -> Vec<Expected> {
    let name = |position: usize| match scenario.devices.get(position) {
        Some(device) => format!("SubDevice {position} ({})", device.name),
        None => format!("SubDevice {position}"),
    };
    let zero = outcome.began.unwrap_or(Time::ZERO);
    let judgements = outcome.judgements.iter();
    judgements.map(|judgement| Expected::of(judgement, zero, name)).collect()
}

impl Expected {
    /// A judgement in words. `zero` is when the run came into operation, `name` gives the name of a
    /// SubDevice by its position.
    pub fn of(judgement: &Judgement, zero: Time<True>, name: impl Fn(usize) -> String) -> Self {
        let (key, what) = wanted(&judgement.expectation, &name);
        let found = found(&judgement.found, zero, &name);
        Self { key: key.to_owned(), what, met: judgement.met, found }
    }
}

fn wanted(expectation: &Expectation, name: &impl Fn(usize) -> String) -> (&'static str, String) {
    match *expectation {
        Expectation::InSync(true) => ("in_sync", "in sync from beginning to end".to_owned()),
        Expectation::InSync(false) => ("in_sync", "not in sync all the time".to_owned()),
        Expectation::InSyncAt(when) => ("in_sync_at", format!("in sync {}", instant(when))),
        Expectation::WorstSync0 { device: None, limit } => {
            ("worst_sync0", format!("SYNC0 never more than {limit} off"))
        }
        Expectation::WorstSync0 { device: Some(device), limit } => {
            ("worst_sync0", format!("SYNC0 of {} never more than {limit} off", name(device)))
        }
        Expectation::PlantDeviation { device, limit_nm } => {
            let whose = device.map_or(String::new(), |device| format!(" of {}", name(device)));
            let limit = micrometres(limit_nm);
            ("plant_deviation", format!("load{whose} never more than {limit} off"))
        }
        Expectation::RecoversWithin(limit) => {
            ("recovers_within", format!("in sync again within {limit} of the last fault"))
        }
        Expectation::SafeWithin(limit) => {
            ("safe_within", format!("no device in OP for more than {limit} with old outputs"))
        }
        Expectation::Blames(device) => ("blames", format!("{} is named first", name(device))),
    }
}

fn instant(when: When) -> String {
    match when {
        When::At(at) => format!("{at} after power-on"),
        When::After(Moment::InOperation, later) => format!("{later} after operation began"),
        When::After(Moment::Cycle(number), later) => format!("{later} after cycle {number}"),
    }
}

fn found(found: &Found, zero: Time<True>, name: &impl Fn(usize) -> String) -> String {
    match *found {
        Found::AsExpected => "so it was".to_owned(),
        Found::Findings(0) => "nothing speaks against it".to_owned(),
        Found::Findings(1) => "1 finding".to_owned(),
        Found::Findings(count) => format!("{count} findings"),
        Found::OutOfSync(stretch) => out_of_sync(&stretch, zero, name),
        Found::Sync0 { device, error } => format!("{} off at {}", nanos(error), name(device)),
        Found::Deviation { device, nm } => {
            format!("{} off at {}", micrometres(nm), name(device))
        }
        Found::Recovered(Picos(0)) => "never out of sync since".to_owned(),
        Found::Recovered(took) => format!("after {}", nanos(took)),
        Found::Stale { device, age } => format!("{} at {}", nanos(age), name(device)),
        Found::Blamed(Some(device)) => format!("the first finding names {}", name(device)),
        Found::Blamed(None) => "no finding names a device".to_owned(),
        Found::NeverInOperation => "the segment never came into operation".to_owned(),
        Found::RunEnded => "the run ended before it could be seen".to_owned(),
        Found::BeforeOperation => "that was before operation began".to_owned(),
        Found::NoEdge => "no SYNC0 edge was measured".to_owned(),
        Found::NoPlant => "there are no plants here".to_owned(),
        Found::NoFault => "nothing happened in operation that would have tested it".to_owned(),
        Found::Forgotten => {
            "there were more sessions than are kept, so the first ones are forgotten".to_owned()
        }
    }
}

fn out_of_sync(stretch: &Stretch, zero: Time<True>, name: &impl Fn(usize) -> String) -> String {
    let sign = match stretch.sign {
        Sign::NotInOp => "not in OP",
        Sign::Sync0Off => "SYNC0 off its grid",
        Sign::NoSync0 => "no SYNC0",
        Sign::MissedEvent => "outputs missed",
        Sign::OutputsLate => "outputs behind their pulse",
    };
    let device = name(stretch.device);
    let from = nanos(stretch.from - zero);
    match stretch.open {
        true => {
            format!("{device} out of sync since {from} into the run and to its end ({sign} first)")
        }
        false if stretch.from == stretch.to => {
            format!("{device} out of sync at {from} into the run ({sign})")
        }
        false => {
            let to = nanos(stretch.to - zero);
            format!("{device} out of sync from {from} to {to} into the run ({sign} first)")
        }
    }
}

fn micrometres(nm: u64) -> String {
    format!("{} um", nm as f64 / 1_000.0)
}

/// A time rounded for people: to a thousandth of its value.
fn nanos(time: Picos) -> Nanos {
    let ns = time.0 / 1_000;
    let mut grain = 1;
    while ns.abs() / grain >= 10_000 {
        grain *= 10;
    }
    Nanos((ns + grain / 2 * ns.signum()) / grain * grain)
}

/// Largest number of faults in the text.
const MOST_FAULTS: usize = 12;

/// Writes a line for each expectation: whether it was met (`None`: that could not be judged), the
/// expectation and the observation. Writes nothing without expectations.
pub fn write_expected(
    out: &mut String,
    expected: &[(Option<bool>, &str, &str)],
) -> std::fmt::Result {
    use std::fmt::Write;
    if expected.is_empty() {
        return Ok(());
    }
    let met = expected.iter().filter(|(met, ..)| *met == Some(true)).count();
    let style = if met == expected.len() { GOOD } else { BAD };
    writeln!(out, "\n{style}Expected: {met} of {} came so.{style:#}", expected.len())?;
    for (met, what, found) in expected {
        let (mark, style, found) = match met {
            Some(true) => ("yes", GOOD, (*found).to_owned()),
            Some(false) => ("NO ", BAD, (*found).to_owned()),
            None => ("?  ", BAD, format!("not judged, {found}")),
        };
        for (number, line) in wrap(&format!("{what}: {found}"), WIDTH - 6).iter().enumerate() {
            match number {
                0 => writeln!(out, "  {style}{mark}{style:#} {line}")?,
                _ => writeln!(out, "      {line}")?,
            }
        }
    }
    Ok(())
}

/// Writes expectations and injected faults; nothing if there are none.
pub(super) fn write(
    out: &mut String,
    expected: &[Expected],
    faults: &[FaultNote],
) -> std::fmt::Result {
    use std::fmt::Write;
    let lines: Vec<_> =
        expected.iter().map(|one| (Some(one.met), &*one.what, &*one.found)).collect();
    write_expected(out, &lines)?;
    if !faults.is_empty() {
        writeln!(out, "\nWhat went wrong, as the segment file asks:")?;
        for fault in faults.iter().take(MOST_FAULTS) {
            let at = Nanos(fault.at_ns).to_string();
            for (number, line) in wrap(&fault.what, WIDTH - 16).iter().enumerate() {
                let at = if number == 0 { &*at } else { "" };
                writeln!(out, "  {at:>12}  {line}")?;
            }
        }
        if faults.len() > MOST_FAULTS {
            writeln!(out, "  and {} more; --json lists them all", faults.len() - MOST_FAULTS)?;
        }
    }
    Ok(())
}

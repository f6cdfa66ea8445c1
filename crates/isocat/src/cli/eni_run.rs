//! An ENI instead of a segment file: `isocat run`, `plan` and `scan` accept both.

use std::path::{Path, PathBuf};

use clap::Args;
use isocat_descriptions::eni::Eni;
use isocat_engine::plan::Plan;
use isocat_esc::DriftLaw;
use isocat_player::differences::{Difference, differences};
use isocat_player::virtual_segment::{self, Origin, VirtualSegment};
use isocat_player::{Report, Settings, play};
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::Nanos;

use super::run::{json, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

/// The sources of an ENI's virtual devices.
#[derive(Args, Debug)]
pub struct Options {
    /// With an ENI: device descriptions (ESI) for its devices, files or folders
    #[arg(long = "esi", value_name = "PATH", num_args = 1..)]
    esi: Vec<PathBuf>,
    /// With an ENI: the segment file to run it against, instead of one that is made from the ENI
    #[arg(long = "segment", value_name = "FILE", id = "against", conflicts_with = "esi")]
    against: Option<String>,
}

/// The other settings.
pub struct Wishes<'a> {
    /// The sources of devices.
    pub options: &'a Options,
    /// File of measured chips.
    pub chips: Option<&'a str>,
    /// Time to run in OP.
    pub duration: Option<Nanos>,
    /// Seed.
    pub seed: Option<u64>,
    /// Law of all drift loops.
    pub drift_law: Option<DriftLaw>,
    /// Whether to print JSON.
    pub json: bool,
    /// File for the report.
    pub report: Option<&'a Path>,
}

impl Options {
    /// The error for these options with a segment file.
    pub fn refused_without_eni(&self) -> Option<String> {
        let key = match (self.esi.is_empty(), &self.against) {
            (false, _) => "--esi",
            (_, Some(_)) => "--segment",
            _ => return None,
        };
        Some(format!(
            "{key} goes with an ENI, such as network.xml; a segment file names the descriptions of its devices itself"
        ))
    }
}

/// Whether a path is that of an ENI, by its ending.
pub fn is_eni(path: &str) -> bool {
    let ending = Path::new(path).extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| ["xml", "eni"].iter().any(|one| ending.eq_ignore_ascii_case(one)))
}

/// Runs an ENI; returns the exit code.
pub fn run(path: &str, wishes: &Wishes<'_>) -> u8 {
    let (eni, segment) = match prepared(path, wishes) {
        Ok(prepared) => prepared,
        Err(message) => return fail(&message),
    };
    let scenario = &segment.scenario;
    if scenario.duration < scenario.cycle {
        let (duration, cycle) = (scenario.duration, scenario.cycle);
        return fail(&format!("--for {duration} is shorter than one cycle of {cycle}"));
    }
    // The user's own segment is what it is; a description may lack objects that the device has.
    let is_users = segment.origins.contains(&Origin::SegmentFile);
    let settings = Settings { duration: scenario.duration, tolerates_unknown_objects: !is_users };
    let played = play(&eni.start_up, scenario, settings);
    let (compared, _) = compared(&eni, scenario);
    let report = Report::planned(&eni, &segment, compared).with_run(&played);
    let refused = played.failure.as_ref().is_some_and(|failure| failure.kind.is_refused());
    if let (true, false, Some(failure)) = (refused, wishes.json, &played.failure) {
        return fail(&format!("{path}: {failure}"));
    }
    let code = match (refused, report.as_expected()) {
        (true, _) => BAD_INPUT,
        (false, true) => IN_SYNC,
        (false, false) => NOT_IN_SYNC,
    };
    tell(&report, wishes, code)
}

/// Compares an ENI with our plan; returns the exit code.
pub fn plan(path: &str, wishes: &Wishes<'_>) -> u8 {
    let (eni, segment) = match prepared(path, wishes) {
        Ok(prepared) => prepared,
        Err(message) => return fail(&message),
    };
    let (compared, fits) = compared(&eni, &segment.scenario);
    if let Err(message) = &compared {
        return fail(message);
    }
    let report = Report::planned(&eni, &segment, compared);
    tell(&report, wishes, if fits { IN_SYNC } else { NOT_IN_SYNC })
}

/// Reads an ENI that can be run.
pub fn read(path: &str) -> Result<Eni, String> {
    let eni = Eni::read(path).map_err(|error| error.to_string())?;
    if let Err(reasons) = eni.runnable() {
        let reasons = reasons.iter().map(|reason| format!("\n- {reason}")).collect::<String>();
        return Err(format!(
            "{path} can't be run:{reasons}\n\"isocat eni {path}\" lists what is in it"
        ));
    }
    Ok(eni)
}

/// Reads an ENI and makes its segment.
pub fn segment(path: &str, options: &Options) -> Result<(Eni, VirtualSegment), String> {
    let eni = read(path)?;
    let made = match &options.against {
        Some(file) => SegmentFile::read(file).and_then(|file| virtual_segment::of_file(&eni, file)),
        None => virtual_segment::descriptions(&options.esi)
            .and_then(|descriptions| virtual_segment::of_eni(&eni, &descriptions)),
    };
    made.map(|made| (eni, made)).map_err(|error| error.to_string())
}

/// The same with the other settings.
fn prepared(path: &str, wishes: &Wishes<'_>) -> Result<(Eni, VirtualSegment), String> {
    let (eni, mut made) = segment(path, wishes.options)?;
    let scenario = &mut made.scenario;
    super::apply_chips(wishes.chips, scenario).map_err(|error| error.to_string())?;
    scenario.duration = wishes.duration.unwrap_or(scenario.duration);
    scenario.seed = wishes.seed.unwrap_or(scenario.seed);
    scenario.drift_law = wishes.drift_law.or(scenario.drift_law);
    Ok((eni, made))
}

/// The differences from our plan, or why there is none; and whether the plan fits.
fn compared(eni: &Eni, scenario: &Scenario) -> (Result<Vec<Difference>, String>, bool) {
    match Plan::of(scenario) {
        Err(error) => (Err(super::plan::place(scenario, &error)), false),
        Ok(plan) => {
            let ours = plan.start_up(scenario);
            (Ok(differences(&eni.start_up, &ours, &plan)), plan.fits())
        }
    }
}

fn tell(report: &Report, wishes: &Wishes<'_>, code: u8) -> u8 {
    let text = report.text();
    if let Err(message) = write_report(wishes.report, report, &text, None) {
        return fail(&message);
    }
    match print(&if wishes.json { json(report) } else { text }) {
        IN_SYNC => code,
        unwritten => unwritten,
    }
}

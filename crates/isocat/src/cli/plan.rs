//! `isocat plan`.

use std::path::PathBuf;

use clap::Args;
use isocat_descriptions::eni;
use isocat_engine::plan::{Plan, proof, suggest};
use isocat_esc::DriftLaw;
use isocat_segment::Scenario;
use isocat_wire::Nanos;

use super::run::{argument, command, duration, is_page, json, progress_bar, write_report};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};
use crate::html;

/// Arguments of `plan`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment is planned
    segment: Option<String>,
    /// Run the segment in virtual time with the worst jitter that is planned with, and show next to each line
    /// what really happened
    #[arg(long)]
    prove: bool,
    /// How long the proof runs once all devices are in OP; default as the segment file says
    #[arg(long = "for", value_name = "DURATION", value_parser = duration, requires = "prove")]
    duration: Option<Nanos>,
    /// Seed of the proof's run
    #[arg(long, requires = "prove")]
    seed: Option<u64>,
    /// Law of all drift loops, in the place of what the file says: hold, block or proportional
    #[arg(long, value_name = "NAME", requires = "prove")]
    drift_law: Option<DriftLaw>,
    /// What `isocat calibrate --chips` measured on a real segment, for the chips of the virtual one
    #[arg(long, value_name = "FILE")]
    chips: Option<String>,
    /// Look for the phase with the most even slack and for the smallest cycle that fits
    #[arg(long)]
    suggest: bool,
    /// Print instead what the way up will write, per device and transition, and the frames of a cycle
    #[arg(long, conflicts_with_all = ["prove", "suggest"])]
    start_up: bool,
    /// Also write the start-up list to this file, as ENI
    #[arg(long, value_name = "FILE")]
    eni: Option<PathBuf>,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
    /// Also write the plan to this file: with timing diagrams if it ends in .html, JSON if in .json, else text
    #[arg(long, value_name = "FILE", conflicts_with = "start_up")]
    report: Option<PathBuf>,
}

/// Plans; gives the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let file = match super::segment_or_built_in(arguments.segment.as_deref()) {
        Ok(file) => file,
        Err(error) => return fail(&error.to_string()),
    };
    let mut scenario = Scenario::from(file);
    scenario.duration = arguments.duration.unwrap_or(scenario.duration);
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
    if arguments.start_up {
        let list = plan.start_up(&scenario);
        let code = print(&if arguments.json { list.json() } else { list.text() });
        return if plan.fits() || code != IN_SYNC { code } else { NOT_IN_SYNC };
    }
    let mut report = plan.report(&scenario);
    if arguments.suggest {
        report.suggestion = Some(suggest::suggest(&plan));
    }
    if arguments.prove {
        let bar = progress_bar(scenario.duration);
        bar.set_message("proving");
        let proof = proof::prove(&plan, &scenario);
        bar.finish_and_clear();
        proof.fill(&mut report);
    }
    let page = is_page(arguments.report.as_deref())
        .then(|| html::plan::page(&plan, &report, &arguments.command(&scenario)));
    let (path, text) = (arguments.report.as_deref(), report.text());
    if let Err(message) = write_report(path, &report, &text, page.as_ref()) {
        return fail(&message);
    }
    let proven = report.proof.as_ref().is_none_or(|proof| proof.holds);
    let code = print(&if arguments.json { json(&report) } else { text });
    match report.fits && proven {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        false => NOT_IN_SYNC,
    }
}

impl Arguments {
    /// The command that repeats it.
    fn command(&self, scenario: &Scenario) -> String {
        let (seed, duration) = (scenario.seed.to_string(), argument(scenario.duration));
        let mut words = vec!["isocat", "plan"];
        words.extend(self.segment.as_deref());
        words.extend(self.chips.as_deref().into_iter().flat_map(|file| ["--chips", file]));
        words.extend(self.suggest.then_some("--suggest"));
        if self.prove {
            words.extend(["--prove", "--for", &duration, "--seed", &seed]);
        }
        let law = self.drift_law.map(|law| law.to_string());
        words.extend(law.iter().flat_map(|law| ["--drift-law", law]));
        command(&words)
    }
}

/// An error with the place of its device in the segment file.
fn place(scenario: &Scenario, error: &isocat_maindevice::Error) -> String {
    let position = error.cause.place().map(|place| place.position);
    match position.and_then(|position| scenario.devices.get(position)) {
        Some(device) => format!("{}:{}: {error}", scenario.source, device.line),
        None => format!("{}: {error}", scenario.source),
    }
}

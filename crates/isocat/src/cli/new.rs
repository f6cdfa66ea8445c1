//! `isocat new`: a segment file from descriptions and types, from an ENI, or from the result of a
//! scan.

mod offers;
mod sources;

use std::path::{Path, PathBuf};

use clap::Args;
use isocat_descriptions::quantity::parse_duration;
use isocat_engine::plan::Plan;
use isocat_segment::new_file::NewFile;
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::time::Nanos;

use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, output, print};

pub(super) const EXAMPLES: &str = "\
Examples:
  isocat new --esi beckhoff.xml --esi drives.xml EK1100 EL7041 AX5101 --out my.toml
                                                 types of makers' descriptions (or folders of them), and built-in profiles
  isocat new network.xml --esi esi/ --out my.toml    what a configuration tool exported (ENI)
  isocat scan --interface eth0 --json > found.json
  isocat new found.json --esi esi/ --out my.toml     what a scan found: identities, tree, cables by their delays, clocks

Exit code: 0 the file loads and its plan fits, 1 its plan does not fit, 2 bad input.";

/// Arguments of `isocat new`.
#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Types of the descriptions and names of built-in profiles, in the order of the wire; or one
    /// ENI (.xml, .eni); or one document of `isocat scan --json` (.json)
    what: Vec<String>,
    /// An ESI file, or a folder of them; may be given several times
    #[arg(long, value_name = "FILE")]
    esi: Vec<PathBuf>,
    /// Bus cycle; without it the shortest of 1, 2, 4 and 10 ms for which the plan fits, or the one
    /// that an OpMode with a fixed SYNC0 takes. An ENI has its own
    #[arg(long, value_parser = parse_cycle)]
    cycle: Option<Nanos>,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn parse_cycle(text: &str) -> Result<Nanos, String> {
    parse_duration(text).map_err(|error| error.to_string())
}

/// Makes the file; returns the exit code.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let mut made = match sources::collect(&arguments.what, &arguments.esi) {
        Ok(made) => made,
        Err(message) => return fail(&message),
    };
    let path = arguments.out.as_deref().unwrap_or(Path::new("my.toml"));
    let name = path.display().to_string();
    let cycles = match (arguments.cycle, made.cycle_is_given) {
        (Some(cycle), _) => vec![cycle],
        (None, true) => vec![made.file.cycle],
        (None, false) => CYCLES.into_iter().chain(made.cycles.drain(..)).collect(),
    };
    // What is written is what was read and planned.
    let mut verdict = Err("no cycle to try".to_owned());
    for cycle in cycles {
        made.file.cycle = cycle;
        verdict = planned(&made.file, &name);
        if verdict.as_ref().is_ok_and(|fits| *fits) {
            break;
        }
    }
    let text = made.file.text(&name);
    let code = match &verdict {
        Ok(true) => IN_SYNC,
        Ok(false) => NOT_IN_SYNC,
        Err(message) => return fail(message),
    };
    for note in &made.notes {
        anstream::eprintln!("isocat new: {note}");
    }
    let written = match &arguments.out {
        None => print(&text),
        Some(path) => match output::write(path, &text) {
            Ok(()) => IN_SYNC,
            Err(error) => fail(&super::run::unwritable("segment file", Some(path), &error)),
        },
    };
    if code == NOT_IN_SYNC {
        anstream::eprintln!(
            "isocat new: the plan does not fit; `isocat plan {name} --suggest` says what would"
        );
    } else if arguments.out.is_some() {
        anstream::eprintln!("isocat new: next, try `isocat plan {name}` and `isocat run {name}`");
    }
    if written == BAD_INPUT { BAD_INPUT } else { code }
}

/// Whether the plan of a file fits; an error if there is no plan.
fn planned(file: &NewFile, name: &str) -> Result<bool, String> {
    let text = file.text(name);
    let segment = SegmentFile::parse(name, &text).map_err(|error| error.to_string())?;
    let scenario = Scenario::from(segment);
    let plan = Plan::of(&scenario).map_err(|error| format!("{name} can't be planned: {error}"))?;
    Ok(plan.fits())
}

const CYCLES: [Nanos; 4] =
    [Nanos::millis(1), Nanos::millis(2), Nanos::millis(4), Nanos::millis(10)];

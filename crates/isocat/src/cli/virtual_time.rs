//! `isocat virtual`.

mod files;
mod luck;
mod mutate;
mod outcome;
mod seeds;
mod segment;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use isocat_descriptions::limits;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::Summary;
use isocat_virtual::kernel::{Costs, Luck};
use isocat_virtual::supervisor::{self, Ended, Options, Program, START};
use isocat_wire::time::Nanos;

use super::files::{Files, Wanted};
use super::run::{duration, unwritable};
use super::{BAD_INPUT, IN_SYNC, fail, output, print};
use files::SharedFiles;
use mutate::class::Classes;
use segment::Segment;

/// Shown below the help of `virtual`.
pub(crate) const EXAMPLES: &str = "\
Examples:
  isocat virtual -- ./my_master vt0                   the built-in segment, behind an interface that the program finds as vt0
  isocat virtual my.toml --for 60s -- ./my_master vt0
  isocat virtual my.toml --seed 7 --lateness 200us --report run.html -- ./my_master vt0
  isocat virtual my.toml --seeds 100 --faults swarm --failed failed -- ./my_master vt0
  isocat virtual my.toml --mutate 200 -- ./my_master vt0      with one mistake at a time in its frames: which are noticed

Exit code: 0 in sync, and the program ended with 0; 1 not in sync or not as expected; 2 bad input, or programs can't be
supervised here; 3 not known, as what was asked for OP did not come there; 4 the program failed, and nothing speaks
against synchronization.";

/// Arguments of `virtual`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment
    segment: Option<String>,
    /// Name of the interface for the program; it must not exist
    #[arg(long, value_name = "IF", default_value = "vt0")]
    interface: String,
    /// Name of the interface at the other end of a ring
    #[arg(long, value_name = "IF")]
    secondary: Option<String>,
    /// Seed of all randomness: the segment, the delays of the host, the program's random numbers
    #[arg(long)]
    seed: Option<u64>,
    /// Wake-ups of the program come late by up to this, instead of the lateness of the file's host
    #[arg(long, value_name = "TIME", value_parser = luck::lateness)]
    lateness: Option<Nanos>,
    /// Wake-ups are late as measured: a histogram of cyclictest -q -h, or lines of microseconds and
    /// counts
    #[arg(long, value_name = "FILE", conflicts_with = "lateness")]
    lateness_from: Option<PathBuf>,
    /// On average one system call in this many takes longer, by up to this time, as when another
    /// program has the processor (1000:300us)
    #[arg(long, value_name = "ONE_OF:TIME", value_parser = luck::preemption)]
    preemption: Option<(u64, Nanos)>,
    /// End the program after this virtual time, up to 24 hours
    #[arg(long = "for", value_name = "TIME", value_parser = duration, default_value = "3600s")]
    limit: Nanos,
    /// Whatever the program makes of the segment is meant: modes, cycles, phases and states of the
    /// file are no claims
    #[arg(long)]
    as_is: bool,
    /// Print the summary as JSON on standard output, once the program has ended
    #[arg(long)]
    json: bool,
    /// Also write the summary to this file: a page if it ends in .html, JSON if in .json, otherwise
    /// text
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write the expectations of the segment file to this file as JUnit for a CI system: each is a
    /// test
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write all frames to this file, in true time: pcapng
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
    /// Write the events at the SubDevices to this file, as waveforms: VCD
    #[arg(long, value_name = "FILE")]
    waves: Option<PathBuf>,
    /// Write frames, and the events at each SubDevice, to this file, as a trace for Perfetto
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Write a table with one row for each SubDevice and cycle to this file: CSV if it ends in
    /// .csv, Parquet if in .parquet
    #[arg(long, value_name = "FILE")]
    series: Option<PathBuf>,
    /// Read the segment from this file, as if it were SEGMENT
    #[arg(long, value_name = "FILE", hide = true)]
    text: Option<String>,
    #[command(flatten)]
    many: seeds::Options,
    #[command(flatten)]
    mistakes: mutate::Options,
    /// The program and its arguments
    #[arg(last = true, required = true, value_name = "PROGRAM")]
    program: Vec<OsString>,
}

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let result = match (arguments.many.seeds, arguments.mistakes.mutate) {
        (Some(seeds), _) => seeds::run(arguments, seeds),
        (None, Some(count)) => mutate::run(arguments, count),
        (None, None) => once(arguments),
    };
    result.unwrap_or_else(|message| fail(&message))
}

/// One run of the program.
fn once(arguments: &Arguments) -> Result<u8, String> {
    let mut scenario = Scenario::from(arguments.segment_file()?);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    scenario.as_is |= arguments.as_is;
    let interfaces = arguments.interfaces(&scenario)?;
    let program = arguments.find_program()?;
    let options = arguments.options(&scenario, interfaces)?;
    for (what, path) in [("report", &arguments.report), ("JUnit", &arguments.junit)] {
        if let Some(path) = path {
            output::probe(path).map_err(|error| unwritable(what, Some(path), &error))?;
        }
    }
    let files = SharedFiles::new(Files::create(&arguments.files()?, &scenario)?);
    let mut segment = Segment::new(&scenario, files.tap());
    segment.mutation = arguments.mistakes.mutation()?;
    segment.classes = arguments.mistakes.classes.is_some().then(Classes::default);
    let ended = supervisor::run(&program, &options, &mut segment).map_err(|e| e.to_string())?;
    segment.server.finish(START + ended.lasted);
    let interface = options.interfaces.join(" and ");
    let summary = Summary::new(&segment.server, &scenario.source, &interface, ended.lasted);
    files.finish()?;
    arguments.mistakes.write(segment.classes.as_ref())?;
    arguments.finish(&summary, scenario.seed, &ended, segment.hash)
}

impl Arguments {
    fn segment_file(&self) -> Result<SegmentFile, String> {
        let file = match &self.text {
            Some(path) => limits::read_text(path, limits::TOML).and_then(|text| {
                SegmentFile::parse(self.segment.as_deref().unwrap_or("built-in segment"), &text)
            }),
            None => super::segment_or_built_in(self.segment.as_deref()),
        };
        file.map_err(|error| error.to_string())
    }

    /// The names of the interfaces, if they are available.
    fn interfaces(&self, scenario: &Scenario) -> Result<Vec<String>, String> {
        if self.secondary.is_some() != scenario.ring.is_some() {
            let expected = if scenario.ring.is_some() {
                "--secondary IF beside --interface, as it is a ring"
            } else {
                "no --secondary, as it is no ring"
            };
            return Err(format!("{}: expected {expected}", scenario.source));
        }
        if self.secondary.as_ref() == Some(&self.interface) {
            return Err(format!(
                "--secondary {}: --interface has this name already; expected another one",
                self.interface
            ));
        }
        let names = [Some(&self.interface), self.secondary.as_ref()];
        let names: Vec<String> = names.into_iter().flatten().cloned().collect();
        for name in &names {
            if name.is_empty() || name.len() > 15 || name.contains(['/', ' ']) {
                return Err(format!(
                    "--interface {name}: this can't be the name of an interface; expected up to 15 characters such as vt0"
                ));
            }
            if Path::new("/sys/class/net").join(name).exists() {
                return Err(format!(
                    "--interface {name}: this machine has such an interface; expected a name of its own for the virtual one, such as vt0"
                ));
            }
        }
        Ok(names)
    }

    fn find_program(&self) -> Result<Program, String> {
        let [name, rest @ ..] = &self.program[..] else {
            return Err("expected a program behind --".into());
        };
        Program::find(name, rest).map_err(|refusal| refusal.to_string())
    }

    fn options(&self, scenario: &Scenario, interfaces: Vec<String>) -> Result<Options, String> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&stop))
                .map_err(|error| error.to_string())?;
        }
        let measured = self.lateness_from.as_deref().map(luck::histogram).transpose()?;
        let luck = Luck {
            lateness: self.lateness.unwrap_or(scenario.host.jitter),
            measured: measured.unwrap_or_default(),
            preemption: self.preemption.unwrap_or_default(),
            seed: scenario.seed,
            ..Luck::default()
        };
        Ok(Options { interfaces, costs: Costs::default(), luck, limit: Some(self.limit), stop })
    }

    fn files(&self) -> Result<Wanted<'_>, String> {
        let paths = [&self.capture, &self.waves, &self.trace, &self.series];
        Wanted::of(paths.map(|path| path.as_deref()))
    }

    /// Prints and writes all output; returns the exit code.
    fn finish(&self, summary: &Summary, seed: u64, ended: &Ended, hash: u64) -> Result<u8, String> {
        let words = outcome::words(ended, hash);
        anstream::eprint!("{}{words}", summary.text());
        if let Some(path) = &self.report {
            let text = match path.extension().and_then(|extension| extension.to_str()) {
                Some("json") => format!("{:#}\n", outcome::document(summary, seed, ended, hash)),
                Some("html" | "htm") => {
                    let mut lines: Vec<String> = words.lines().map(str::to_owned).collect();
                    let repeats = self.repeats(self.segment.as_deref(), seed);
                    lines.push(format!("The same again: {repeats}"));
                    crate::html::serve::virtual_page(summary, &lines).render()
                }
                _ => anstream::adapter::strip_str(&summary.text()).to_string() + &words,
            };
            output::write(path, text).map_err(|e| unwritable("report", Some(path), &e))?;
        }
        if let Some(path) = &self.junit {
            output::write(path, super::junit::of_service(summary, seed))
                .map_err(|error| unwritable("JUnit", Some(path), &error))?;
        }
        if self.json {
            let document = outcome::document(summary, seed, ended, hash);
            if print(&format!("{document}\n")) != IN_SYNC {
                return Ok(BAD_INPUT);
            }
        }
        Ok(outcome::exit_code(summary, ended))
    }
}

//! `isocat run --interface`: the main job on a real wire.

use std::io::BufWriter;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Receiver;

use clap::{ArgGroup, Args};
use isocat_engine::live::job::{Job, Machine};
use isocat_engine::live::{BothSinks, CaptureSink, Outcome};
use isocat_engine::report::interface::{self, Asked, InterfaceReport};
use isocat_engine::status::{Board, Kind, Scribe, Status};
use isocat_engine::verdict::{self, Answer};
use isocat_host::preflight::{self, Subject};
use isocat_host::{LinkError, RawSocket, Recorder, Wish};
use isocat_maindevice::{Config, Fault};
use isocat_recorders::capture::Capture;
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::run::Progress;
use isocat_wire::Nanos;
use signal_hook::consts::{SIGINT, SIGTERM};

use super::output::Output;
use super::record::{self, Recording};
use super::run::{
    Arguments, argument, command, duration, is_page, progress_bar, refusal, unwritable,
    write_report,
};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, NOT_KNOWN, fail, print};
use crate::html;
use crate::metrics;
use crate::record::Event;

/// Arguments of `run` for a real interface.
#[derive(Args, Debug)]
#[group(skip)]
#[command(
    next_help_heading = "On a real network interface",
    group(ArgGroup::new("wire").args(["interface", "preflight"]).multiple(true))
)]
pub struct Options {
    /// Run on this network interface instead of a virtual segment; the segment file is what is
    /// expected
    #[arg(long, value_name = "IF", conflicts_with = "seed")]
    pub interface: Option<String>,
    /// Network namespace of the interface
    #[arg(long, value_name = "NAME", requires = "interface")]
    pub netns: Option<String>,
    /// Accept any segment on the wire, with every SubDevice in its best mode
    #[arg(long, requires = "interface", conflicts_with = "segment")]
    pub any: bool,
    /// Bus cycle with --any or --preflight, default 1ms
    #[arg(long, requires = "wire", conflicts_with = "segment", value_parser = duration)]
    pub cycle: Option<Nanos>,
    /// Never sleep: spin on the interface and the clock, which occupies one CPU
    #[arg(long, requires = "wire")]
    pub busy: bool,
    /// Stay on this CPU, preferably an isolated one
    #[arg(long, value_name = "N", requires = "wire")]
    pub cpu: Option<usize>,
    /// Only check this machine for settings that harm punctuality; exit 0 for none, 1 for some, 2
    /// for bad input
    #[arg(long, conflicts_with_all = ["duration", "capture", "waves", "trace", "series", "report", "any"])]
    pub preflight: bool,
    #[command(flatten)]
    pub recording: Recording,
}

impl Options {
    pub fn wish(&self) -> Wish {
        Wish { cpu: self.cpu, busy: self.busy }
    }

    /// Opens the interface.
    pub fn open(&self, interface: &str) -> Result<RawSocket, LinkError> {
        RawSocket::open(interface, self.netns.as_deref())
    }

    pub fn check(&self, any: bool) -> Result<(), String> {
        if let Some(cpu) = self.cpu.filter(|cpu| !preflight::is_online(*cpu)) {
            return Err(format!("--cpu {cpu}: there is no such CPU online"));
        }
        if let Some(cycle) = self.cycle.filter(|_| !any && !self.preflight) {
            return Err(format!("--cycle {cycle} needs --any; a segment has its own cycle"));
        }
        match self.cycle {
            Some(cycle) if !(SHORTEST_CYCLE..=LONGEST_CYCLE).contains(&cycle) => Err(format!(
                "--cycle {cycle} is out of range; expected {SHORTEST_CYCLE} to {LONGEST_CYCLE}"
            )),
            _ => Ok(()),
        }
    }
}

/// Checks the machine, and prints harmful settings.
pub fn look(arguments: &Arguments, cycle: Option<Nanos>) -> u8 {
    let options = &arguments.wire;
    if let Err(message) = options.check(false) {
        return fail(&message);
    }
    let mut unread = None;
    let socket = match options.interface.as_deref().map(|interface| options.open(interface)) {
        None => None,
        Some(Ok(socket)) => Some(socket),
        Some(Err(error @ LinkError::Permission { .. })) => {
            let text = error.to_string().replace('\n', "; ");
            unread = Some(format!("how the interface gathers frames was not read: {text}"));
            None
        }
        Some(Err(error)) => return fail(&error.to_string()),
    };
    let subject = Subject {
        interface: options.interface.as_deref(),
        namespace: options.netns.as_deref(),
        wish: options.wish(),
        keeps_awake: false,
    };
    let cycle = options.cycle.or(cycle).unwrap_or(DEFAULT_CYCLE);
    // On a thread of its own, which takes its scheduling with it.
    let looked = std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            Machine::prepare(subject, socket.as_ref(), cycle).map(|(_awake, machine)| machine)
        });
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    let mut machine = match looked {
        Ok(machine) => machine,
        Err(error) => return fail(&error.to_string()),
    };
    machine.refused.extend(unread);
    let report = interface::Machine::from(&machine);
    let code = print(&match arguments.json {
        true => super::run::json(&report),
        false => report.text(cycle),
    });
    if code == IN_SYNC && report.harms_punctuality() { NOT_IN_SYNC } else { code }
}

/// Runs the segment on the interface; returns the exit code.
pub fn run(arguments: &Arguments, interface: &str, file: SegmentFile) -> u8 {
    let options = &arguments.wire;
    if let Err(message) = options.check(options.any) {
        return fail(&message);
    }
    let scenario = match arguments.scenario(file) {
        Ok(scenario) => scenario,
        Err(error) => return fail(&error.to_string()),
    };
    if let Some(message) = super::refused_ring(&scenario, interface) {
        return fail(&message);
    }
    let virtual_only = !scenario.faults.planned.is_empty()
        || !scenario.expectations.is_empty()
        || !scenario.outputs.is_empty()
        || !scenario.plants.is_empty();
    if virtual_only {
        eprintln!(
            "isocat: the [[fault]], [[expect]], [[output]] and [[plant]] tables of {} are for a virtual run; on an interface they are left out",
            scenario.source
        );
    }
    let config = config(options, &scenario);
    let asked = Asked {
        interface,
        namespace: options.netns.as_deref(),
        segment_file: (!options.any).then_some(scenario.source.as_str()),
        cycle: config.cycle,
        duration: scenario.duration,
        jitter: config.host_jitter,
    };
    if asked.duration < asked.cycle {
        let Asked { duration, cycle, .. } = asked;
        return fail(&format!("--for {duration} is shorter than one cycle of {cycle}"));
    }
    let socket = match options.open(interface) {
        Ok(socket) => socket,
        Err(error) => return fail(&error.to_string()),
    };
    let stop = match stop_on_signals() {
        Ok(stop) => stop,
        Err(error) => return fail(&format!("signals can't be caught: {error}")),
    };
    let bar = progress_bar(asked.duration);
    let begun = begin_recording(arguments, interface, names(options, &scenario));
    let (recorder, written) = match begun {
        Ok(begun) => begun,
        Err(message) => return fail(&message),
    };
    let (scribe, _metrics) = match arguments.metrics {
        None => (None, None),
        Some(address) => match measured(address, &config, &scenario, options) {
            Ok((scribe, server)) => (Some(scribe), Some(server)),
            Err(message) => return fail(&message),
        },
    };
    let job = Job {
        config,
        socket,
        namespace: options.netns.clone(),
        duration: asked.duration,
        difference_limit: scenario.sync0_limit,
        wish: options.wish(),
        recorder,
        scribe,
    };
    let outcome = job.run(&stop, &mut |progress| match progress {
        Progress::Stage(stage) => bar.set_message(stage.name()),
        Progress::Judged(time) => {
            bar.set_message("in operation");
            bar.set_position(time.0 as u64);
        }
    });
    bar.finish_and_clear();
    match outcome {
        Ok(outcome) => finish(arguments, &scenario, asked, outcome, written),
        Err(error) => fail(&error.to_string()),
    }
}

/// Starts to record frames for `--capture` and `--record`.
pub(super) fn begin_recording(
    arguments: &Arguments,
    interface: &str,
    names: Vec<String>,
) -> Result<(Option<Recorder>, Written), String> {
    let begin = |path: &Path| {
        let output = Output::create(path)?;
        let capture = Capture::of_interface(BufWriter::new(output.file()?), interface)?;
        Ok((CaptureSink(capture), output))
    };
    let (capture, file) = arguments
        .capture
        .as_deref()
        .map(begin)
        .transpose()
        .map_err(|error| unwritable("capture", arguments.capture.as_deref(), &error))?
        .unzip();
    let (guard, events) = arguments.wire.recording.begin(interface, names)?.unzip();
    let recorder = match (capture, guard) {
        (Some(capture), Some(guard)) => {
            Some(Recorder::new(BothSinks(Box::new(capture), Box::new(guard))))
        }
        (Some(capture), None) => Some(Recorder::new(capture)),
        (None, Some(guard)) => Some(Recorder::new(guard)),
        (None, None) => None,
    };
    Ok((recorder, Written { file, events }))
}

/// Ends the recording, and notes missing parts.
pub(super) fn end_recording(
    arguments: &Arguments,
    outcome: &mut Outcome,
    written: Written,
) -> Result<(), String> {
    let finished = outcome.recorder.take().map(|recorder| {
        let dropped = recorder.finish()?;
        written.file.map(Output::commit).transpose().map(|_| dropped)
    });
    outcome.notes.extend(written.events.iter().flat_map(record::notes));
    match finished {
        None | Some(Ok(0)) => Ok(()),
        Some(Ok(dropped)) => {
            let what = match arguments.capture {
                Some(_) => "in the capture: the disk was too slow",
                None => "recorded: this machine was too slow",
            };
            outcome.notes.push(format!("{dropped} frames are not {what}"));
            Ok(())
        }
        Some(Err(error)) => Err(unwritable("capture", arguments.capture.as_deref(), &error)),
    }
}

/// The exit code of an answer.
pub(super) const fn exit_code(answer: Answer) -> u8 {
    match answer {
        Answer::InSync => IN_SYNC,
        Answer::Except => NOT_IN_SYNC,
        Answer::NotKnown => NOT_KNOWN,
    }
}

/// The receivers of recorded frames.
pub(super) struct Written {
    /// The file of `--capture`.
    file: Option<Output>,
    /// Events of `--record`.
    events: Option<Receiver<Event>>,
}

/// Names of the devices, by position.
pub(super) fn names(options: &Options, scenario: &Scenario) -> Vec<String> {
    match options.any {
        true => Vec::new(),
        false => scenario.devices.iter().map(|device| device.name.clone()).collect(),
    }
}

/// The scribe that fills the board of a run, with the server that reads the board.
fn measured(
    address: SocketAddr,
    config: &Config,
    scenario: &Scenario,
    options: &Options,
) -> Result<(Scribe, metrics::Server), String> {
    let board = board(config, scenario, options);
    let server = super::watch::serve_metrics(address)?;
    let shown = server.page();
    let reader = board.clone();
    // It ends with the program: the loop is not to wait for it.
    std::thread::spawn(move || {
        loop {
            if let Some(status) = reader.take() {
                shown.show(&status);
            }
            std::thread::sleep(LOOK);
        }
    });
    Ok((Scribe::new(board, config), server))
}

/// The board of a real wire.
pub(super) fn board(config: &Config, scenario: &Scenario, options: &Options) -> Board {
    let segment = match options.any {
        true => options.interface.clone().unwrap_or_default(),
        false => scenario.source.clone(),
    };
    let limit = scenario.sync0_limit.0;
    Board::new(Status::new(segment, Kind::Wire, config.cycle.0, limit))
}

/// The configuration of the MainDevice on a real interface.
pub(super) fn config(options: &Options, scenario: &Scenario) -> Config {
    let config = match options.any {
        true => Config {
            drift_compensation: scenario.drift_compensation,
            force: scenario.force,
            tolerate: scenario.tolerate,
            ..Config::new(options.cycle.unwrap_or(DEFAULT_CYCLE))
        },
        false => scenario.config(),
    };
    verdict::with_reads(isocat_host::on_a_socket(config))
}

/// Writes all requested output.
fn finish(
    arguments: &Arguments,
    scenario: &Scenario,
    asked: Asked<'_>,
    mut outcome: Outcome,
    written: Written,
) -> u8 {
    if let Err(message) = end_recording(arguments, &mut outcome, written) {
        return fail(&message);
    }
    let report = InterfaceReport::new(asked, &outcome);
    let page = is_page(arguments.report.as_deref()).then(|| {
        let duration = argument(asked.duration);
        let mut words = vec!["isocat", "run"];
        words.extend(arguments.segment.as_deref());
        words.extend(["--interface", asked.interface]);
        words.extend(asked.namespace.iter().flat_map(|namespace| ["--netns", namespace]));
        words.extend(arguments.wire.any.then_some("--any"));
        words.extend(["--for", &duration]);
        words.extend(arguments.tolerate.then_some("--tolerate"));
        html::interface::page(&report, &outcome.segment, &command(&words))
    });
    let (path, page) = (arguments.report.as_deref(), page.as_ref());
    if let Err(message) = write_report(path, &report, &report.text(), page) {
        return fail(&message);
    }
    let failure = outcome.failure();
    let refused = failure.is_some_and(|error| error.cause.fault() == Fault::Configuration);
    if refused && !arguments.json {
        let place = (!arguments.wire.any).then_some(scenario);
        return fail(&refusal(place, report.findings.first(), &report.verdict));
    }
    let code = print(&match arguments.json {
        true => super::run::json(&report),
        false => report.text(),
    });
    match code {
        IN_SYNC if refused => BAD_INPUT,
        IN_SYNC => exit_code(report.answer),
        code => code,
    }
}

/// A flag that SIGINT and SIGTERM set; a second signal ends the program at once.
pub(super) fn stop_on_signals() -> std::io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        let code = 128 + signal;
        signal_hook::flag::register_conditional_shutdown(signal, code, stop.clone())?;
        signal_hook::flag::register(signal, stop.clone())?;
    }
    Ok(stop)
}

/// Time from one poll of the board to the next.
const LOOK: std::time::Duration = std::time::Duration::from_millis(100);
/// Bus cycle for a segment without a file.
const DEFAULT_CYCLE: Nanos = Nanos::millis(1);
const SHORTEST_CYCLE: Nanos = Nanos::micros(10);
const LONGEST_CYCLE: Nanos = Nanos::millis(1_000);

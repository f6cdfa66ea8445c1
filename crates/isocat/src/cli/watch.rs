//! `isocat watch`.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
#[cfg(target_os = "linux")]
use isocat_engine::report::words;
use isocat_engine::status::Status;
use isocat_esc::DriftLaw;
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::Nanos;

use super::run::duration;
use super::{IN_SYNC, NOT_IN_SYNC, fail};
use crate::metrics;
use crate::watch::gate::Outcome;
use crate::watch::source::Speed;
use crate::watch::terminal::{self, End};
use crate::watch::{Gate, Source, View};

/// Arguments of `watch`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment
    segment: Option<String>,
    /// Speed of virtual time: a factor of the host's clock, or "max"
    #[arg(long, default_value = "1", value_name = "TIMES", value_parser = Speed::parse)]
    speed: Speed,
    /// Seed of all randomness
    #[arg(long)]
    seed: Option<u64>,
    /// Law of all drift loops, instead of that of the file: hold, block or proportional
    #[arg(long, value_name = "NAME")]
    drift_law: Option<DriftLaw>,
    /// Print lines instead of a screen, as without a terminal
    #[arg(long)]
    plain: bool,
    /// Wait until every SYNC error has been within this limit for the time of --for, with all in
    /// OP, no counter increase and no alarm
    #[arg(long, value_name = "ERROR", value_parser = error_limit)]
    until: Option<Nanos>,
    /// Time for which the errors must be within the limit
    #[arg(long = "for", value_name = "DURATION", value_parser = duration, requires = "until")]
    hold: Option<Nanos>,
    /// End after this time of the segment; with --until: give up
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    within: Option<Nanos>,
    /// Answer GET /metrics for Prometheus at this address: a port of this machine, or an address
    #[arg(long, value_name = "ADDRESS", value_parser = metrics::address)]
    metrics: Option<SocketAddr>,
    /// For testing: let the clocks drift apart
    #[arg(long)]
    no_drift_compensation: bool,
    /// Run although the timing budget does not fit
    #[arg(long)]
    force: bool,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    place: Place,
}

/// The segment, if it is no simulation.
#[cfg(target_os = "linux")]
#[derive(Args, Debug)]
#[group(skip)]
#[command(next_help_heading = "A segment that is not simulated")]
struct Place {
    /// Run on this network interface
    #[arg(long, value_name = "IF", conflicts_with_all = ["seed", "speed"])]
    interface: Option<String>,
    /// Network namespace of the interface
    #[arg(long, value_name = "NAME", requires = "interface")]
    netns: Option<String>,
    /// Accept any segment on the wire, with every SubDevice in its best mode
    #[arg(long, requires = "interface", conflicts_with = "segment")]
    any: bool,
    /// Bus cycle with --any, default 1ms
    #[arg(long, requires = "any", value_parser = duration)]
    cycle: Option<Nanos>,
    /// Never sleep: spin on the interface and the clock, which occupies one CPU
    #[arg(long, requires = "interface")]
    busy: bool,
    /// Stay on this CPU, preferably an isolated one
    #[arg(long, value_name = "N", requires = "interface")]
    cpu: Option<usize>,
    #[command(flatten)]
    recording: super::record::Recording,
    /// Watch the segment of a running `isocat serve`: its interface, or the name of --setup-veth
    #[arg(long, value_name = "NAME", conflicts_with_all = ["segment", "interface", "seed", "speed"])]
    serve: Option<String>,
}

/// A limit of errors: 0ns to 1s.
fn error_limit(text: &str) -> Result<Nanos, String> {
    let limit =
        isocat_descriptions::quantity::parse_duration(text).map_err(|error| error.to_string())?;
    match (Nanos::ZERO..=MOST).contains(&limit) {
        true => Ok(limit),
        false => Err(format!("expected an error from 0ns to {MOST}, found {text}")),
    }
}

const MOST: Nanos = Nanos::millis(1_000);
/// Time for which errors must be small without --for.
const HOLD: Nanos = Nanos::millis(1_000);

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    if let (Some(within), Some(_)) = (arguments.within, arguments.until)
        && within < arguments.hold()
    {
        let hold = arguments.hold();
        return fail(&format!("--within {within} is shorter than --for {hold}: it can't be met"));
    }
    let stop = match stop_flag() {
        Ok(stop) => stop,
        Err(error) => return fail(&format!("signals can't be caught: {error}")),
    };
    let server = match arguments.metrics.map(serve_metrics).transpose() {
        Ok(server) => server,
        Err(message) => return fail(&message),
    };
    let mut recorded = Recorded::default();
    let (source, title) = match arguments.source(&stop, &mut recorded) {
        Ok(source) => source,
        Err(message) => return fail(&message),
    };
    let end = show(arguments, &source, title, &stop, server.as_ref());
    source.end();
    // Not before the terminal is given back.
    recorded.tell();
    match end {
        Ok(end) => finish(arguments, end),
        Err(error) => fail(&format!("the terminal can't be used: {error}")),
    }
}

/// The events of a recording.
#[derive(Default)]
struct Recorded {
    #[cfg(target_os = "linux")]
    events: Option<std::sync::mpsc::Receiver<crate::record::Event>>,
}

impl Recorded {
    fn tell(&self) {
        #[cfg(target_os = "linux")]
        for event in self.events.iter().flat_map(std::sync::mpsc::Receiver::try_iter) {
            anstream::eprintln!("isocat watch: {}", event.words());
        }
    }
}

fn show(
    arguments: &Arguments,
    source: &Source,
    title: String,
    stop: &AtomicBool,
    server: Option<&metrics::Server>,
) -> std::io::Result<End> {
    let page = server.map(metrics::Server::page);
    let mut reader = |status: &Status| {
        if let Some(page) = &page {
            page.show(status);
        }
    };
    let mut gate = arguments.gate();
    let within = arguments.within.map(|within| within.0);
    let end = if arguments.plain || !terminal::is_there() {
        terminal::print(source, gate.as_mut(), within, stop, &mut reader)
    } else {
        let mut view = View::new(title, wants_colour());
        terminal::run(source, &mut view, gate.as_mut(), within, stop, &mut reader)
    };
    end.map(|end| match (gate, end.outcome) {
        // Somebody ended it before the gate opened.
        (Some(gate), None) => {
            let outcome = Some(Outcome::Closed(format!("ended; {}", gate.account())));
            End { outcome, ..end }
        }
        (_, outcome) => End { outcome, ..end },
    })
}

/// Reports the end.
fn finish(arguments: &Arguments, end: End) -> u8 {
    let verdict = end.status.as_ref().map(Status::verdict);
    match (arguments.until, end.outcome) {
        (Some(_), Some(Outcome::Opened(words))) => {
            anstream::eprintln!("isocat watch: {words}");
            IN_SYNC
        }
        (Some(_), Some(Outcome::Closed(words))) => {
            anstream::eprintln!("isocat watch: {words}");
            NOT_IN_SYNC
        }
        // Who closed the output has seen enough.
        _ if end.unread => IN_SYNC,
        _ => match verdict {
            Some(verdict) => {
                anstream::eprintln!("isocat watch: {}", verdict.words);
                if verdict.good { IN_SYNC } else { NOT_IN_SYNC }
            }
            None => {
                anstream::eprintln!("isocat watch: ended before anything was known");
                NOT_IN_SYNC
            }
        },
    }
}

/// Starts to answer Prometheus; the error says what is wrong with the address.
pub(super) fn serve_metrics(address: SocketAddr) -> Result<metrics::Server, String> {
    told(address, metrics::Server::listen(address))
}

/// The same for a service, which is asked for its status through its control socket at each
/// request.
#[cfg(target_os = "linux")]
pub(super) fn serve_metrics_of(
    address: SocketAddr,
    control: &std::path::Path,
) -> Result<metrics::Server, String> {
    let control = control.to_owned();
    let text = move |_: &metrics::Page| {
        let answer = isocat_serve::control::request(&control, "watch").ok()?;
        Some(metrics::text(&serde_json::from_str(&answer).ok()?))
    };
    told(address, metrics::Server::listen_with(address, metrics::Page::default(), text))
}

/// Reports the address of the server, and who can reach it.
fn told(
    address: SocketAddr,
    server: std::io::Result<metrics::Server>,
) -> Result<metrics::Server, String> {
    let server = server.map_err(|error| format!("--metrics {address} can't be used: {error}"))?;
    let address = server.address();
    if !address.ip().is_loopback() {
        anstream::eprintln!(
            "warning: metrics are open to the network on {address}, without any password"
        );
    }
    anstream::eprintln!("metrics: http://{address}/metrics");
    Ok(server)
}

/// Whether to use colours: unless NO_COLOR is set.
fn wants_colour() -> bool {
    std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    #[cfg(target_os = "linux")]
    return super::interface::stop_on_signals();
    #[cfg(not(target_os = "linux"))]
    Ok(Arc::new(AtomicBool::new(false)))
}

impl Arguments {
    fn hold(&self) -> Nanos {
        self.hold.unwrap_or(HOLD)
    }

    fn gate(&self) -> Option<Gate> {
        self.until.map(|limit| Gate::new(limit, self.hold(), self.within))
    }

    fn scenario(&self, file: SegmentFile) -> Scenario {
        let mut scenario = Scenario::from(file);
        scenario.seed = self.seed.unwrap_or(scenario.seed);
        scenario.drift_law = self.drift_law.or(scenario.drift_law);
        scenario.force = self.force;
        scenario.drift_compensation &= !self.no_drift_compensation;
        // What registers and objects say is read in the background, in the default share of the
        // wire if the file has none.
        scenario.operation.quality.get_or_insert_default();
        scenario
    }

    /// Starts the source; also returns a description of the place.
    fn source(
        &self,
        stop: &Arc<AtomicBool>,
        recorded: &mut Recorded,
    ) -> Result<(Source, String), String> {
        #[cfg(not(target_os = "linux"))]
        let _ = recorded;
        #[cfg(target_os = "linux")]
        if self.place.interface.is_none() && self.place.recording.is_given() {
            return Err("--record and its keys go with --interface".into());
        }
        #[cfg(target_os = "linux")]
        if let Some(name) = &self.place.serve {
            return served(name, stop);
        }
        let file =
            super::segment_or_built_in(self.segment.as_deref()).map_err(|e| e.to_string())?;
        let scenario = self.scenario(file);
        #[cfg(target_os = "linux")]
        if let Some(interface) = &self.place.interface {
            return self.wire(interface, &scenario, stop, recorded);
        }
        let title = match self.speed {
            Speed::Times(times) => format!("simulated x{times}"),
            Speed::Max => "simulated x max".to_owned(),
        };
        Ok((Source::simulated(scenario, self.speed, stop.clone()), title))
    }

    #[cfg(target_os = "linux")]
    fn wire(
        &self,
        interface: &str,
        scenario: &Scenario,
        stop: &Arc<AtomicBool>,
        recorded: &mut Recorded,
    ) -> Result<(Source, String), String> {
        use isocat_engine::live::job::Job;
        use isocat_engine::status::Scribe;
        use isocat_host::Recorder;
        let Place { netns, any, cycle, busy, cpu, recording, .. } = &self.place;
        let options = super::interface::Options {
            interface: Some(interface.to_owned()),
            netns: netns.clone(),
            any: *any,
            cycle: *cycle,
            busy: *busy,
            cpu: *cpu,
            preflight: false,
            recording: recording.clone(),
        };
        options.check(*any)?;
        if let Some(message) = super::refused_ring(scenario, interface) {
            return Err(message);
        }
        let config = super::interface::config(&options, scenario);
        let socket = options.open(interface).map_err(|error| error.to_string())?;
        let board = super::interface::board(&config, scenario, &options);
        let names = super::interface::names(&options, scenario);
        let (guard, events) = recording.begin(interface, names)?.unzip();
        recorded.events = events;
        let job = Job {
            scribe: Some(Scribe::new(board.clone(), &config)),
            config,
            socket,
            namespace: options.netns.clone(),
            duration: FOREVER,
            difference_limit: scenario.sync0_limit,
            wish: options.wish(),
            recorder: guard.map(Recorder::new),
        };
        let (own, stopped) = (board.clone(), stop.clone());
        let thread = std::thread::spawn(move || {
            let failure = match job.run(&stopped, &mut |_| {}) {
                Err(error) => Some(error.to_string()),
                Ok(mut outcome) => {
                    if let Some(Err(error)) = outcome.recorder.take().map(Recorder::finish) {
                        anstream::eprintln!("isocat watch: the recording failed: {error}");
                    }
                    let found = outcome.findings.first().map(|finding| {
                        (finding.place, words::what(&finding.kind, words::Family::Wire))
                    });
                    let mut open = outcome.unknown.iter().filter(|open| open.kind.decides());
                    let open = open
                        .next()
                        .map(|open| (open.place, format!("not known: {}", words::gap(&open.kind))));
                    found.or(open).map(|(place, what)| match place.device {
                        Some(position) => format!("SubDevice {position}: {what}"),
                        None => what,
                    })
                }
            };
            own.end(failure);
        });
        Ok((Source::of_board(board, stop.clone(), thread), interface.to_owned()))
    }
}

/// A century, longer than anybody watches.
#[cfg(target_os = "linux")]
const FOREVER: Nanos = Nanos(3_155_760_000_000_000_000);

#[cfg(target_os = "linux")]
fn served(name: &str, stop: &Arc<AtomicBool>) -> Result<(Source, String), String> {
    use isocat_serve::control;
    let path = control::find_served(name);
    let ended = stop.clone();
    let ask = move || {
        let answer = control::request_until(&path, "watch", &ended)
            .map_err(|error| format!("no isocat serves there: {}: {error}", path.display()))?;
        serde_json::from_str::<Status>(&answer)
            .map_err(|error| format!("the service answered \"{}\": {error}", answer.trim()))
    };
    let first = ask()?;
    let source = Source::asked(ask, first, ASK, stop.clone());
    Ok((source, format!("served on {name}")))
}

/// Time from one request to a service to the next.
#[cfg(target_os = "linux")]
const ASK: std::time::Duration = std::time::Duration::from_millis(200);

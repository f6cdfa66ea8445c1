//! `isocat serve`.

use std::cell::Cell;
use std::fmt;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use clap::Args;
use isocat_esc::DriftLaw;
use isocat_host::{LinkError, RawSocket, Recorder, Veth, clock};
use isocat_segment::Scenario;
use isocat_serve::control::{self, Requests};
use isocat_serve::server::{Event, Server};
use isocat_serve::service::{self, Audience, Interfaces, Reply, Style};
use isocat_serve::summary::Outcome;
use isocat_serve::{Order, Setup, Summary};
use isocat_sim::MainPort;
use isocat_wire::AlState;
use isocat_wire::time::{Host, Time};
use serde_json::json;

use super::record::Recording;
use super::{IN_SYNC, NOT_IN_SYNC, NOT_KNOWN, fail, print};
use crate::record;

/// Arguments of `serve`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment is served
    segment: Option<String>,
    /// Network interface to serve on
    #[arg(long, value_name = "IF", required_unless_present = "setup_veth")]
    interface: Option<String>,
    /// Network interface of the other end of a ring, for a segment file with `ring`
    #[arg(long, value_name = "IF", requires = "interface", conflicts_with = "setup_veth")]
    secondary: Option<String>,
    /// Network namespace of the interface, as `ip netns` names it
    #[arg(long, value_name = "NAME", requires = "interface", conflicts_with = "setup_veth")]
    netns: Option<String>,
    /// Create a network namespace NAME with a veth pair in it, two for a ring, serve there, and
    /// remove it at the end
    #[arg(long, value_name = "NAME", conflicts_with = "interface")]
    setup_veth: Option<String>,
    /// Spin instead of sleeping: answers within microseconds, but occupies a processor
    #[arg(long)]
    busy: bool,
    /// Events and the summary as JSON, one per line
    #[arg(long)]
    json: bool,
    /// Seed of all randomness
    #[arg(long)]
    seed: Option<u64>,
    /// Law of all drift loops, instead of that of the file: hold, block or proportional
    #[arg(long, value_name = "NAME")]
    drift_law: Option<DriftLaw>,
    /// Result of `isocat calibrate --chips` on a real segment, for the chips of the virtual one
    #[arg(long, value_name = "FILE")]
    chips: Option<String>,
    /// Whatever a MainDevice makes of the segment is meant: modes, cycles, phases and states of the
    /// file are no claims
    #[arg(long)]
    as_is: bool,
    /// Also write the summary to this file: a page if it ends in .html, JSON if in .json, otherwise
    /// text
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write the expectations of the segment file to this file as JUnit for a CI system: each is a
    /// test
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Answer GET /metrics for Prometheus at this address: a port of this machine, or an address
    #[arg(long, value_name = "ADDRESS", value_parser = crate::metrics::address)]
    metrics: Option<std::net::SocketAddr>,
    #[command(flatten)]
    recording: Recording,
}

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let file = match super::segment_or_built_in(arguments.segment.as_deref()) {
        Ok(file) => file,
        Err(error) => return fail(&error.to_string()),
    };
    let mut scenario = Scenario::from(file);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    if let Err(error) = super::apply_chips(arguments.chips.as_deref(), &mut scenario) {
        return fail(&error.to_string());
    }
    scenario.as_is |= arguments.as_is;
    scenario.drift_law = arguments.drift_law.or(scenario.drift_law);
    let ends = match arguments.ends(&scenario) {
        Ok(ends) => ends,
        Err(message) => return fail(&message),
    };
    let interface = &ends.primary;
    let path = control::path_of(interface);
    if let Some(path) = &arguments.report
        && let Err(error) = super::output::probe(path)
    {
        return fail(&super::run::unwritable("report", Some(path), &error));
    }
    if let Some(path) = &arguments.junit
        && let Err(error) = super::output::probe(path)
    {
        return fail(&super::run::unwritable("JUnit", Some(path), &error));
    }
    if control::is_served(&path) {
        return fail(&format!("another isocat serves on {interface} already ({})", path.display()));
    }
    // Removed when this returns; whoever serves there already was asked before.
    let create = if ends.secondary.is_some() { Veth::create_ring } else { Veth::create };
    let veth = match arguments.setup_veth.as_deref().map(create).transpose() {
        Ok(veth) => veth,
        Err(error) => return fail(&error.to_string()),
    };
    let namespace = veth.as_ref().map(Veth::namespace).or(arguments.netns.as_deref());
    let interfaces = match ends.open(namespace) {
        Ok(interfaces) => interfaces,
        Err(error) => return fail(&error.to_string()),
    };
    let (requests, mut wake) = match Requests::listen(&path) {
        Ok(listening) => listening,
        Err(error) => return fail(&format!("{} can't be used: {error}", path.display())),
    };
    let metrics = arguments.metrics.map(|address| super::watch::serve_metrics_of(address, &path));
    if let Some(Err(message)) = metrics {
        return fail(&message);
    }
    let tape = match arguments.tape(&scenario, interface) {
        Ok(tape) => tape,
        Err(message) => return fail(&message),
    };
    let began = clock::now();
    let mut server = Server::new(Setup::from(&scenario).without_process_data(), began);
    let mut teller = Teller::new(arguments.json, began, scenario.source.clone(), tape);
    teller.greet(&scenario, &ends, veth.as_ref());
    let style = Style { busy: arguments.busy };
    let result = service::run(&mut server, interfaces, &mut wake, &requests, style, &mut teller);
    server.finish(clock::now());
    while let Some(event) = server.poll_event() {
        teller.event(&server, event);
    }
    teller.end();
    let served = clock::now() - began;
    let summary = Summary::new(&server, &scenario.source, &ends.to_string(), served);
    let code = finish(arguments, &summary, scenario.seed);
    match result {
        Ok(()) => code,
        Err(error) => fail(&error.to_string()),
    }
}

/// Names of the interfaces.
struct Ends {
    primary: String,
    /// The second one, for a ring.
    secondary: Option<String>,
}

impl Ends {
    fn open(&self, namespace: Option<&str>) -> Result<Interfaces, LinkError> {
        let open = |interface: &str| RawSocket::open(interface, namespace);
        let secondary = self.secondary.as_deref().map(open).transpose()?;
        Ok(Interfaces { primary: open(&self.primary)?, secondary })
    }
}

/// The names as text: `eth1`, or `eth1 and eth2`.
impl fmt::Display for Ends {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.primary)?;
        self.secondary.iter().try_for_each(|secondary| write!(f, " and {secondary}"))
    }
}

impl Arguments {
    /// Starts the recording for `--record`.
    fn tape(&self, scenario: &Scenario, interface: &str) -> Result<Option<Tape>, String> {
        if self.recording.is_given() && scenario.ring.is_some() {
            return Err("--record is for one interface; expected a segment that is no ring".into());
        }
        let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
        let begun = self.recording.begin(interface, names)?;
        Ok(begun.map(|(guard, events)| Tape { recorder: Recorder::new(guard), events }))
    }

    /// The interfaces to serve on; an error if they do not fit this segment.
    fn ends(&self, scenario: &Scenario) -> Result<Ends, String> {
        let (source, is_ring) = (&scenario.source, scenario.ring.is_some());
        if let Some(name) = &self.setup_veth {
            let secondary = is_ring.then(|| Veth::second_segment_end_of(name));
            return Ok(Ends { primary: Veth::segment_end_of(name), secondary });
        }
        let Some(primary) = &self.interface else {
            return Err("expected --interface or --setup-veth".into());
        };
        match (&self.secondary, is_ring) {
            (None, true) => Err(format!(
                "{source} is a ring, which has two ends; expected --secondary IF beside --interface {primary}"
            )),
            (Some(secondary), false) => Err(format!(
                "--secondary {secondary} is given, but {source} is no ring; expected ring = true in it, or one interface"
            )),
            (Some(secondary), true) if secondary == primary => Err(format!(
                "--secondary {secondary} is --interface too; expected another interface for the other end of the ring"
            )),
            (secondary, _) => Ok(Ends { primary: primary.clone(), secondary: secondary.clone() }),
        }
    }
}

/// Writes all requested output; returns the exit code.
fn finish(arguments: &Arguments, summary: &Summary, seed: u64) -> u8 {
    let json = |pretty| {
        let text = if pretty { crate::json::lines(summary) } else { crate::json::compact(summary) };
        text + "\n"
    };
    if let Some(path) = &arguments.report {
        let text = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => json(true),
            Some("html" | "htm") => crate::html::serve::page(summary).render(),
            _ => anstream::adapter::strip_str(&summary.text()).to_string(),
        };
        if let Err(error) = super::output::write(path, text) {
            // Nobody shall lose the summary for it.
            print(&if arguments.json { json(false) } else { summary.text() });
            return fail(&super::run::unwritable("report", Some(path), &error));
        }
    }
    if let Some(path) = &arguments.junit {
        let written = super::output::write(path, super::junit::of_service(summary, seed));
        if let Err(error) = written {
            return fail(&super::run::unwritable("JUnit", Some(path), &error));
        }
    }
    match (print(&if arguments.json { json(false) } else { summary.text() }), summary.outcome()) {
        (IN_SYNC, Outcome::NotAsExpected) => NOT_IN_SYNC,
        (IN_SYNC, Outcome::NotJudged) => NOT_KNOWN,
        (printed, _) => printed,
    }
}

/// The recording of the interface, and its events.
struct Tape {
    recorder: Recorder,
    events: Receiver<record::Event>,
}

/// Largest number of lines that wait for a reader.
const MOST_LINES: usize = 65_536;

/// Prints events on a separate thread, so that a reader that does not read cannot delay a frame.
struct Teller {
    lines: Option<SyncSender<String>>,
    /// Number of lines that were dropped because the reader did not read.
    left_out: Cell<u64>,
    writer: Option<std::thread::JoinHandle<()>>,
    json: bool,
    status: bool,
    began: Time<Host>,
    frames: u64,
    segment: String,
    tape: Option<Tape>,
}

impl Teller {
    fn new(json: bool, began: Time<Host>, segment: String, tape: Option<Tape>) -> Self {
        let (sender, receiver) = sync_channel::<String>(MOST_LINES);
        let status = !json && std::io::stdout().is_terminal();
        let writer = std::thread::spawn(move || {
            let mut out = anstream::stdout();
            for line in receiver {
                // Who closed the output does not want to read it.
                let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
            }
        });
        let (lines, writer, left_out) = (Some(sender), Some(writer), Cell::new(0));
        Self { lines, left_out, writer, json, status, began, frames: 0, segment, tape }
    }

    fn say(&self, line: String) {
        let Some(lines) = &self.lines else { return };
        let line = if self.status { format!("\r\x1b[K{line}\n") } else { line + "\n" };
        // What waits for a reader is bounded; the writer lives as long as this.
        if lines.try_send(line).is_err() {
            self.left_out.set(self.left_out.get() + 1);
        }
    }

    fn greet(&self, scenario: &Scenario, ends: &Ends, veth: Option<&Veth>) {
        let count = scenario.devices.len();
        let is_ring = ends.secondary.is_some();
        let second_main_end = veth.filter(|_| is_ring).map(Veth::second_main_end);
        if self.json {
            let namespace = veth.map(Veth::namespace);
            let line = json!({ "event": "serving", "segment_file": scenario.source, "subdevices": count,
                "interface": ends.primary, "secondary": ends.secondary, "namespace": namespace,
                "main_end": veth.map(Veth::main_end), "second_main_end": second_main_end });
            return self.say(line.to_string());
        }
        self.say(format!(
            "Serving {} ({count} SubDevices{}) on {ends}; Ctrl-C ends it.",
            scenario.source,
            if is_ring { " in a ring" } else { "" }
        ));
        if let Some(veth) = veth {
            let (namespace, main) = (veth.namespace(), veth.main_end());
            let second = second_main_end.map(|end| format!(" {end}")).unwrap_or_default();
            self.say(format!("Your MainDevice: ip netns exec {namespace} PROGRAM {main}{second}"));
        }
    }

    /// Prints the events of the recording.
    fn tell_tape(&self, events: &Receiver<record::Event>) {
        for event in events.try_iter() {
            self.say(match self.json {
                true => event.json().to_string(),
                false => format!("recording: {}", event.words()),
            });
        }
    }

    /// Ends the output, with everything written.
    fn end(&mut self) {
        if let Some(Tape { recorder, events }) = self.tape.take() {
            match recorder.finish() {
                Ok(0) => {}
                Ok(left_out) => eprintln!(
                    "{left_out} frames were not recorded: this machine was too slow for them"
                ),
                Err(error) => eprintln!("the recording failed: {error}"),
            }
            self.tell_tape(&events);
        }
        if self.left_out.get() > 0 {
            eprintln!(
                "{} lines were left out, since they were not read in time",
                self.left_out.get()
            );
        }
        if self.status
            && let Some(lines) = &self.lines
        {
            let _ = lines.send("\r\x1b[K".to_owned());
        }
        self.lines = None;
        if let Some(writer) = self.writer.take() {
            // It ends with its channel.
            let _ = writer.join();
        }
    }
}

impl Audience for Teller {
    fn event(&mut self, server: &Server, event: Event) {
        let now = (clock::now() - self.began).0;
        if self.json {
            return self.say(event_json(server, &event, now));
        }
        let at = |ns: i64| format!("{:>10.3} s ", ns as f64 / 1e9);
        let line = match event {
            Event::SessionBegan { source } => {
                format!("{} MainDevice {} begins", at(now), hex(&source))
            }
            Event::State { at: when, device, state, code } => {
                let why = if code.0 == 0 { String::new() } else { format!(", {code}") };
                let name = &server.names()[device];
                let when = at(when.as_nanos() as i64);
                format!("{when} SubDevice {device} ({name}): {state}{why}")
            }
            Event::InOperation { devices } => {
                format!("{} in operation: {devices} SubDevices; the judges begin", at(now))
            }
            Event::Fault(fault) => format!("{} {fault}", at(now)),
            Event::SessionEnded { abrupt } => {
                let how = if abrupt { ", in the middle" } else { "" };
                format!("{} MainDevice ends{how}", at(now))
            }
        };
        self.say(line);
    }

    fn request(&mut self, server: &mut Server, request: &str) -> Reply {
        let answer = |line: serde_json::Value, stop| Reply { line: line.to_string(), stop };
        match request {
            "stop" => answer(json!({ "ok": "stopping" }), true),
            "status" => answer(status(server), false),
            "watch" => {
                let status = server.status(&self.segment);
                answer(serde_json::to_value(status).unwrap_or_default(), false)
            }
            _ => {
                let order = Order::parse(request, server.names())
                    .map_err(|error| format!("{error}; or status, watch, stop"));
                let done = order.and_then(|order| {
                    let words = order.to_string();
                    server.inject(clock::now(), order).map(|()| words)
                });
                match done {
                    Ok(words) => answer(json!({ "ok": words }), false),
                    Err(error) => answer(json!({ "error": error }), false),
                }
            }
        }
    }

    fn link(&mut self, _server: &Server, interface: &str, up: bool) {
        let now = (clock::now() - self.began).0;
        if self.json {
            let event = if up { "interface up" } else { "interface down" };
            let line = json!({ "event": event, "at_ns": now, "interface": interface });
            return self.say(line.to_string());
        }
        let what = match up {
            true => "is up again",
            false => "is down: frames are lost until it is up again",
        };
        self.say(format!("{:>10.3} s  the interface {interface} {what}", now as f64 / 1e9));
    }

    fn frame(&mut self, _: MainPort, at: Time<Host>, answer: bool, bytes: &[u8]) {
        // As the MainDevice sees it: what comes here is what it sends.
        if let Some(tape) = &mut self.tape {
            tape.recorder.frame(at, !answer, bytes, false);
        }
    }

    fn tick(&mut self, server: &Server) {
        if let Some(tape) = &self.tape {
            self.tell_tape(&tape.events);
        }
        if !self.status {
            return;
        }
        let frames = server.counts().frames;
        let rate = frames - std::mem::replace(&mut self.frames, frames);
        let devices = server.served().segment().devices();
        let in_state =
            |state: AlState| devices.iter().filter(|device| device.stack.state() == state).count();
        let mut line = format!("{rate} frames/s");
        for state in [AlState::Init, AlState::PreOp, AlState::SafeOp, AlState::Op] {
            match in_state(state) {
                0 => {}
                count => line += &format!(", {count} in {state}"),
            }
        }
        if let Some(judged) = server.judged() {
            let worst = judged.devices.iter().filter_map(|device| device.sync0_error.as_ref());
            if let Some(worst) = worst.map(isocat_sim::Statistics::worst).max() {
                line += &format!(", SYNC0 error at most {:.1} ns", worst as f64 / 1e3);
            }
            let missed: u32 = judged.devices.iter().map(|device| device.counters[0]).sum();
            line += &format!(", SM events missed {missed}");
        }
        if let Some(lines) = &self.lines {
            // The next one tells it anew.
            let _ = lines.try_send(format!("\r\x1b[K{line}"));
        }
    }
}

fn event_json(server: &Server, event: &Event, now: i64) -> String {
    let line = match event {
        Event::SessionBegan { source } => {
            json!({ "event": "session began", "at_ns": now, "source": hex(source) })
        }
        Event::State { at, device, state, code } => json!({
            "event": "state", "at_ns": at.as_nanos(), "position": device,
            "device": server.names()[*device], "state": state.name(), "code": code.0,
        }),
        Event::InOperation { devices } => {
            json!({ "event": "in operation", "at_ns": now, "subdevices": devices })
        }
        Event::Fault(fault) => json!({ "event": "fault", "at_ns": now, "what": fault.to_string() }),
        Event::SessionEnded { abrupt } => {
            json!({ "event": "session ended", "at_ns": now, "abrupt": abrupt })
        }
    };
    line.to_string()
}

/// Present state, counters and SYNC of every SubDevice.
fn status(server: &Server) -> serde_json::Value {
    let judged = server.judged();
    let devices =
        server.served().segment().devices().iter().enumerate().map(|(position, device)| {
            let sync = device.stack.sync();
            let judged = judged.as_ref().map(|judged| &judged.devices[position]);
            let error = judged.and_then(|judged| judged.sync0_error.as_ref());
            json!({
                "position": position,
                "name": server.names()[position],
                "state": device.stack.state().name(),
                "code": device.stack.status_code().0,
                "mode": sync.mode().name(),
                "sync_active": device.esc.sync_active(),
                "sm_event_missed": sync.sm_event_missed(),
                "cycle_time_too_small": sync.cycle_time_too_small(),
                "shift_time_too_short": sync.shift_time_too_short(),
                "sync_error": sync.sync_error(),
                "sync0_edges": error.map(isocat_sim::Statistics::count),
                "sync0_error_worst_ns": error.map(|error| error.worst() as f64 / 1e3),
            })
        });
    let counts = server.counts();
    json!({
        "frames": counts.frames,
        "answered": counts.answered,
        "lost": counts.lost,
        "in_sync": judged.as_ref().map(isocat_serve::verdict::Judged::in_sync),
        "devices": devices.collect::<Vec<_>>(),
    })
}

fn hex(address: &[u8; 6]) -> String {
    let [a, b, c, d, e, f] = address;
    format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}")
}

/// Arguments of `control`.
#[derive(Args, Debug)]
pub struct ControlArguments {
    /// Interface on which `isocat serve` runs
    interface: String,
    /// pull DEVICE, plug DEVICE, power-cycle DEVICE [TIME], drop FRAMES, loss SHARE%, delay TIME
    /// [TIME], status, watch, stop
    #[arg(required = true, trailing_var_arg = true)]
    command: Vec<String>,
}

/// Runs `control`; returns the exit code.
pub fn control(arguments: &ControlArguments) -> u8 {
    let path = control::find_served(&arguments.interface);
    let answer = match control::request(&path, &arguments.command.join(" ")) {
        Ok(answer) => answer,
        Err(error) => {
            let (interface, path) = (&arguments.interface, path.display());
            return fail(&format!("no isocat serves on {interface}: {path}: {error}"));
        }
    };
    let value: serde_json::Value = match serde_json::from_str(&answer) {
        Ok(value) => value,
        Err(error) => return fail(&format!("the service answered \"{}\": {error}", answer.trim())),
    };
    match (value["ok"].as_str(), value["error"].as_str()) {
        (Some(words), _) => print(&format!("{words}\n")),
        (_, Some(error)) => fail(error),
        _ => match serde_json::to_string_pretty(&value) {
            Ok(text) => print(&format!("{text}\n")),
            Err(_) => IN_SYNC,
        },
    }
}

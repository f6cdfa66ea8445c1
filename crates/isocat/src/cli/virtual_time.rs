//! `isocat virtual`.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use isocat_segment::Scenario;
use isocat_serve::server::{Answer, Server};
use isocat_serve::{Setup, Summary};
use isocat_sim::MainPort;
use isocat_virtual::kernel::{Costs, Luck};
use isocat_virtual::supervisor::{self, Ended, Ending, How, Options, Program, START};
use isocat_virtual::{Wire, WireAnswer};
use isocat_wire::time::{Host, Nanos, Time};

use super::run::duration;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, NOT_KNOWN, fail, print};

/// Nothing is wrong with synchronization, but the program itself failed.
const PROGRAM_FAILED: u8 = 4;

/// Arguments of `virtual`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file; without one, the built-in segment
    segment: Option<String>,
    /// Name of the interface that the program is to use; it must not exist
    #[arg(long, value_name = "IF", default_value = "vt0")]
    interface: String,
    /// Name of the interface at the other end of a ring
    #[arg(long, value_name = "IF")]
    secondary: Option<String>,
    /// Seed of everything random: the segment, the host's bad luck, the program's random numbers
    #[arg(long)]
    seed: Option<u64>,
    /// Wake-ups of the program come late by up to this
    #[arg(long, value_name = "TIME", value_parser = duration)]
    lateness: Option<Nanos>,
    /// End the program after this virtual time
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    limit: Option<Nanos>,
    /// Print the summary as JSON on standard output, once the program has ended
    #[arg(long)]
    json: bool,
    /// Also write the summary to this file: a page if it ends in .html, JSON if in .json, else text
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// The program and its arguments
    #[arg(last = true, required = true, value_name = "PROGRAM")]
    program: Vec<OsString>,
}

/// Runs the verb; gives the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let file = match super::segment_or_built_in(arguments.segment.as_deref()) {
        Ok(file) => file,
        Err(error) => return fail(&error.to_string()),
    };
    let mut scenario = Scenario::from(file);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    let (program, options) = match prepare(arguments, &scenario) {
        Ok(prepared) => prepared,
        Err(message) => return fail(&message),
    };
    let mut wire = Segment::new(&scenario);
    let ended = match supervisor::run(&program, &options, &mut wire) {
        Ok(ended) => ended,
        Err(error) => return fail(&error.to_string()),
    };
    wire.server.finish(START + ended.lasted);
    let interface = options.interfaces.join(" and ");
    let summary = Summary::new(&wire.server, &scenario.source, &interface, ended.lasted);
    finish(arguments, &summary, &ended, wire.hash)
}

fn prepare(arguments: &Arguments, scenario: &Scenario) -> Result<(Program, Options), String> {
    let interfaces: Vec<String> = [Some(&arguments.interface), arguments.secondary.as_ref()]
        .into_iter()
        .flatten()
        .cloned()
        .collect();
    if arguments.secondary.is_some() != scenario.ring.is_some() {
        let expected = if scenario.ring.is_some() {
            "--secondary IF beside --interface, as it is a ring"
        } else {
            "no --secondary, as it is no ring"
        };
        return Err(format!("{}: expected {expected}", scenario.source));
    }
    for name in &interfaces {
        if name.is_empty() || name.len() > 15 || name.contains(['/', ' ']) {
            return Err(format!(
                "--interface {name}: this can't be the name of an interface; expected up to 15 characters such as vt0"
            ));
        }
        if std::path::Path::new("/sys/class/net").join(name).exists() {
            return Err(format!(
                "--interface {name}: this machine has such an interface; expected a name of its own for the virtual one, such as vt0"
            ));
        }
    }
    let [name, rest @ ..] = &arguments.program[..] else {
        return Err("expected a program behind --".into());
    };
    let program = Program::find(name, rest).map_err(|refusal| refusal.to_string())?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| error.to_string())?;
    }
    let luck = Luck {
        lateness: arguments.lateness.unwrap_or_default(),
        seed: scenario.seed,
        ..Luck::default()
    };
    let options =
        Options { interfaces, costs: Costs::default(), luck, limit: arguments.limit, stop };
    debug_assert!(!options.stop.load(Ordering::SeqCst), "nobody asked yet");
    Ok((program, options))
}

/// The segment behind the interfaces.
struct Segment {
    server: Server,
    /// Of all frames that came back and when they set out.
    hash: u64,
}

impl Segment {
    fn new(scenario: &Scenario) -> Self {
        let server = Server::new(Setup::from(scenario).without_process_data(), START);
        Self { server, hash: 0xCBF2_9CE4_8422_2325 }
    }

    fn take_in(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.hash = (self.hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
        }
    }
}

const PORTS: [MainPort; 2] = [MainPort::Primary, MainPort::Secondary];

impl Wire for Segment {
    fn send(
        &mut self,
        interface: usize,
        at: Time<Host>,
        frame: &[u8],
        answers: &mut Vec<WireAnswer>,
    ) {
        let mut bytes = frame.to_vec();
        let answer = self.server.frame_at(PORTS[interface], at, &mut bytes);
        self.take_in(&at.count().to_le_bytes());
        self.take_in(&bytes);
        self.server.after(&bytes);
        if let Answer::Back { port, last_bit, .. } = answer {
            answers.push(WireAnswer { at: last_bit, interface: port as usize, bytes });
        }
        while let Some((port, at, bytes)) = self.server.take_copy() {
            answers.push(WireAnswer { at, interface: port as usize, bytes });
        }
        while self.server.poll_event().is_some() {}
    }

    fn advance(&mut self, now: Time<Host>) {
        self.server.idle(now);
        while self.server.poll_event().is_some() {}
    }

    fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>> {
        self.server.next_timeout(now)
    }
}

fn finish(arguments: &Arguments, summary: &Summary, ended: &Ended, hash: u64) -> u8 {
    let words = words(ended, hash);
    anstream::eprint!("{}{words}", summary.text());
    let json = || {
        let mut document = serde_json::to_value(summary).unwrap_or_default();
        document["program"] = program_json(ended, hash);
        document
    };
    if let Some(path) = &arguments.report {
        let text = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => format!("{:#}\n", json()),
            Some("html" | "htm") => crate::html::serve::page(summary).render(),
            _ => anstream::adapter::strip_str(&summary.text()).to_string() + &words,
        };
        if let Err(error) = super::output::write(path, text) {
            return fail(&super::run::unwritable("report", Some(path), &error));
        }
    }
    if arguments.json && print(&format!("{}\n", json())) != IN_SYNC {
        return BAD_INPUT;
    }
    let answer = summary.sessions.last().map(|session| session.answer);
    match (answer, &ended.how) {
        (Some("except"), _) => NOT_IN_SYNC,
        (_, How::Deadlock(_) | How::Spins(_)) => PROGRAM_FAILED,
        (_, How::Itself(ending)) if *ending != Ending::Exited(0) => PROGRAM_FAILED,
        (Some("in-sync"), _) => IN_SYNC,
        _ => NOT_KNOWN,
    }
}

fn words(ended: &Ended, hash: u64) -> String {
    let how = match &ended.how {
        How::Itself(Ending::Exited(code)) => format!("ended with exit code {code}"),
        How::Itself(Ending::Killed(signal)) => format!("was ended by signal {signal}"),
        How::Limit => "was ended, as its time was over".into(),
        How::Stopped => "was ended, as asked".into(),
        How::Deadlock(who) => {
            format!(
                "was ended, as all its threads wait for what nobody will do: {}",
                who.join("; ")
            )
        }
        How::Spins(who) => {
            format!("was ended, as it ran for 2 s without any system call: {}", who.join("; "))
        }
    };
    let figures = &ended.figures;
    let mut text = format!(
        "The program {how}, after {:.6} s of virtual time.\n{} frames sent, {} received; {} calls stopped it, {} readings of the clock did not; {} threads, {} processes; wire {hash:016x}\n",
        ended.lasted.0 as f64 / 1e9,
        figures.sent,
        figures.received,
        figures.stops,
        figures.readings,
        figures.threads,
        figures.processes,
    );
    for (note, count) in &ended.notes {
        text += &format!("note: {note} ({count} times)\n");
    }
    text
}

fn program_json(ended: &Ended, hash: u64) -> serde_json::Value {
    let figures = &ended.figures;
    let (how, code) = match &ended.how {
        How::Itself(Ending::Exited(code)) => ("exited", Some(*code)),
        How::Itself(Ending::Killed(signal)) => ("killed", Some(*signal)),
        How::Limit => ("limit", None),
        How::Stopped => ("stopped", None),
        How::Deadlock(_) => ("deadlock", None),
        How::Spins(_) => ("spins", None),
    };
    serde_json::json!({
        "how": how, "code": code, "lasted_ns": ended.lasted.0, "wire_hash": format!("{hash:016x}"),
        "stops": figures.stops, "clock_readings": figures.readings, "switches": figures.switches,
        "frames_sent": figures.sent, "frames_received": figures.received,
        "threads": figures.threads, "processes": figures.processes, "notes": ended.notes,
    })
}

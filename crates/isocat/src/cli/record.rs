//! `isocat record`, and `--record` of other verbs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use clap::Args;
use isocat_captures::pairing::Seen;
use isocat_descriptions::quantity;
use isocat_diagnose::{Claims, Names};
use isocat_host::Listener;
use isocat_recorders::flight::{Limits, Told};
use isocat_wire::Nanos;
use serde_json::json;
use signal_hook::consts::SIGUSR1;

use super::diagnose::Given;
use super::listen::{Heard, listen};
use super::run::duration;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};
use crate::record::{Event, Guard, On, Wanted};

pub const EXAMPLES: &str = "\
It listens and sends nothing: beside a MainDevice on the same interface, or at a mirror port. The
last seconds stay in memory. When a working counter drops, a device leaves OP, SYNC is lost or frames
are lost, they are written with the seconds behind, and with the reason as a comment at its frame.
isocat diagnose reads the files. What the wire does not show is no reason: docs/record.md.

Examples:
  isocat record --interface eth0                    until Ctrl-C, files in this folder
  isocat record --interface eth0 --into /var/log/ecat --keep 30s --most-files 50
  isocat record --interface eth0 --on al-state,signal
  kill -USR1 $(pidof isocat)                        write what there is now

Exit code: 0 ended and nothing happened, 1 something did, 2 could not begin, no frame of EtherCAT came,
or a file could not be written.";

/// Arguments of `record`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Network interface to listen on
    #[arg(long, value_name = "IF")]
    interface: String,
    /// Network namespace of the interface
    #[arg(long, value_name = "NAME")]
    netns: Option<String>,
    /// Folder for the files, which is created if it does not exist
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    into: PathBuf,
    /// End after this time; without it a signal ends it
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    span: Option<Nanos>,
    /// Segment file of the devices, in their order: their names, and what they are meant to do
    #[arg(long, value_name = "SEGMENT")]
    segment: Option<String>,
    /// Take what the segment does as what was meant
    #[arg(long, requires = "segment")]
    as_is: bool,
    /// Print one JSON document per line
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    keys: Keys,
}

/// Amount and triggers of the recording.
#[derive(Args, Clone, Debug, Default)]
#[group(skip)]
pub struct Keys {
    /// Time that is kept before an incident: 10ms to 10min, default 10s
    #[arg(long, value_name = "DURATION", value_parser = keep)]
    keep: Option<Duration>,
    /// Time that is recorded after it: 0s to 1min, default 2s
    #[arg(long, value_name = "DURATION", value_parser = after)]
    after: Option<Duration>,
    /// Largest number of files of one recording: the first one and the newest others stay; default
    /// 10
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    most_files: Option<u16>,
    /// Incidents that trigger a file; default all
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_enum)]
    on: Vec<On>,
    /// Memory for frames, MiB; older frames are dropped first; default 128
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u16).range(1..=16_384))]
    memory: Option<u16>,
}

/// `--record` of verbs that use an interface for another purpose.
#[derive(Args, Clone, Debug, Default)]
#[group(skip)]
#[command(next_help_heading = "Recording when something happens")]
pub struct Recording {
    /// Write the last seconds of frames into this folder when SYNC is lost, a working counter
    /// drops, a device leaves OP or on SIGUSR1
    #[arg(long, value_name = "FOLDER")]
    record: Option<PathBuf>,
    #[command(flatten)]
    keys: Keys,
}

impl Keys {
    fn wanted(&self, names: Names, claims: Option<Claims>) -> Wanted {
        let limits = Limits {
            keep: self.keep.unwrap_or(KEEP),
            after: self.after.unwrap_or(AFTER),
            most_bytes: usize::from(self.memory.unwrap_or(MEMORY_MIB)) << 20,
            most_files: self.most_files.unwrap_or(MOST_FILES).into(),
        };
        let on = if self.on.is_empty() { On::ALL.to_vec() } else { self.on.clone() };
        Wanted { limits, on, names, claims }
    }

    /// The first option that was given.
    fn given(&self) -> Option<&'static str> {
        let keys = [
            (self.keep.is_some(), "--keep"),
            (self.after.is_some(), "--after"),
            (self.most_files.is_some(), "--most-files"),
            (!self.on.is_empty(), "--on"),
            (self.memory.is_some(), "--memory"),
        ];
        keys.into_iter().find(|(given, _)| *given).map(|(_, key)| key)
    }
}

impl Recording {
    /// Starts to record the frames of an interface, if requested; `names` are those of the devices,
    /// by position.
    pub fn begin(
        &self,
        interface: &str,
        names: Vec<String>,
    ) -> Result<Option<(Guard, Receiver<Event>)>, String> {
        let Some(folder) = &self.record else { return self.refused().map_or(Ok(None), Err) };
        let names = Names { positions: names, ..Names::default() };
        guard(folder, interface, self.keys.wanted(names, None)).map(Some)
    }

    /// The error for options without a recording; `None` if there is none.
    pub fn refused(&self) -> Option<String> {
        let key = self.keys.given().filter(|_| self.record.is_none())?;
        Some(format!("{key} needs --record FOLDER: it says how much is recorded"))
    }

    /// Whether a recording was requested, or any option of it was given.
    pub fn is_given(&self) -> bool {
        self.record.is_some() || self.keys.given().is_some()
    }
}

/// Results of the files, in the form of a report's notes; the incidents are already in the report.
pub fn notes(events: &Receiver<Event>) -> Vec<String> {
    let words = events.try_iter().filter_map(|event| match &event {
        Event::Happened { .. } => None,
        Event::File(Told::Written { reasons, .. }) => {
            let first = reasons.first().map_or("", |reason| &reason.what);
            Some(format!("{}: {first}", event.words()))
        }
        Event::File(_) => Some(event.words()),
    });
    words.collect()
}

/// Starts to guard an interface. From then on SIGUSR1 triggers a file.
fn guard(
    folder: &Path,
    interface: &str,
    wanted: Wanted,
) -> Result<(Guard, Receiver<Event>), String> {
    let asked = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGUSR1, asked.clone())
        .map_err(|error| format!("signals can't be caught: {error}"))?;
    Guard::new(folder, interface, wanted, asked)
        .map_err(|error| format!("the folder {} can't be written: {error}", folder.display()))
}

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    match record(arguments) {
        Ok(code) => code,
        Err(message) => fail(&message),
    }
}

fn record(arguments: &Arguments) -> Result<u8, String> {
    let Given { names, claims } = match &arguments.segment {
        None => Given::default(),
        Some(path) => super::diagnose::of_segment(path, arguments.as_is)?,
    };
    let interface = &arguments.interface;
    let mut listener =
        Listener::open(interface, arguments.netns.as_deref()).map_err(|error| error.to_string())?;
    let stop = super::interface::stop_on_signals()
        .map_err(|error| format!("signals can't be caught: {error}"))?;
    let wanted = arguments.keys.wanted(names, claims);
    let (mut guard, events) = guard(&arguments.into, interface, wanted)?;
    let mut log = Log { json: arguments.json, happened: 0, failed: 0, code: IN_SYNC };
    log.begin(arguments);
    let ended = listen(&mut listener, arguments.span, &stop, &mut |heard| {
        match heard {
            Heard::Frame { at, sent, bytes } => guard.frame(at, sent, bytes),
            Heard::Quiet(now) => guard.idle(now),
            Heard::Down(now) => log.down(interface, now),
        }
        log.all(&events);
    });
    let (frames, seen) = (guard.frames(), guard.seen());
    guard.finish();
    log.all(&events);
    let dropped = listener.dropped();
    log.end(interface, frames, dropped, seen);
    ended.map_err(|error| error.to_string())?;
    Ok(match (frames, log.failed, log.happened) {
        _ if log.code == BAD_INPUT => BAD_INPUT,
        (0, ..) => return Err(format!("no frame of EtherCAT came at {interface}")),
        (_, 1.., _) => BAD_INPUT,
        (_, _, 1..) => NOT_IN_SYNC,
        _ => IN_SYNC,
    })
}

/// The output while it listens.
struct Log {
    json: bool,
    /// Number of incidents, and of files that could not be written.
    happened: u64,
    failed: u64,
    /// Exit code of the output.
    code: u8,
}

impl Log {
    fn begin(&mut self, arguments: &Arguments) {
        let Arguments { interface, into, .. } = arguments;
        let line = match self.json {
            true => {
                json!({ "event": "listening", "interface": interface, "folder": into }).to_string()
            }
            false => {
                format!("Listening to {interface}; files go to {}; Ctrl-C ends it.", into.display())
            }
        };
        self.say(line);
    }

    fn all(&mut self, events: &Receiver<Event>) {
        for event in events.try_iter() {
            match &event {
                Event::Happened { .. } => self.happened += 1,
                Event::File(Told::Failed { .. }) => self.failed += 1,
                Event::File(_) => {}
            }
            self.say(match self.json {
                true => event.json().to_string(),
                false => event.words(),
            });
        }
    }

    fn down(&mut self, interface: &str, now: Duration) {
        self.say(match self.json {
            true => {
                json!({ "event": "interface down", "at_ns": now.as_nanos() as u64 }).to_string()
            }
            false => format!("the interface {interface} is down: it is heard again once it is up"),
        });
    }

    fn end(&mut self, interface: &str, frames: u64, dropped: u64, seen: Option<Seen>) {
        let happened = self.happened;
        if self.json {
            let seen = seen.map(|seen| match seen {
                Seen::Both => "both",
                Seen::Out => "out",
                Seen::Back => "back",
            });
            let line = json!({ "event": "ended", "frames": frames, "not_heard": dropped,
                "seen": seen, "happened": happened });
            return self.say(line.to_string());
        }
        let way = match seen {
            Some(Seen::Back) => ", those on their way back alone",
            Some(Seen::Out) => ", those on their way out alone, so nothing is known of devices",
            Some(Seen::Both) | None => "",
        };
        let what = match happened {
            0 => "nothing happened".to_owned(),
            1 => "one thing happened".to_owned(),
            more => format!("{more} things happened"),
        };
        self.say(format!("Heard {frames} frames at {interface}{way}; {what}."));
        if dropped > 0 {
            let what = "this machine was too slow, and what they would have said is unknown";
            self.say(format!("{dropped} frames were not heard: {what}."));
        }
    }

    fn say(&mut self, line: String) {
        self.code = self.code.max(print(&(line + "\n")));
    }
}

fn keep(text: &str) -> Result<Duration, String> {
    between(text, Nanos::millis(10), Nanos::millis(600_000), "10ms to 10min")
}

fn after(text: &str) -> Result<Duration, String> {
    between(text, Nanos::ZERO, Nanos::millis(60_000), "0s to 1min")
}

fn between(text: &str, least: Nanos, most: Nanos, expected: &str) -> Result<Duration, String> {
    let span = quantity::parse_duration(text).map_err(|error| error.to_string())?;
    match (least..=most).contains(&span) {
        true => Ok(Duration::from_nanos(span.0 as u64)),
        false => Err(format!("expected {expected}, found {text}")),
    }
}

/// Time that is kept without `--keep`: the time from a cause to its visible effect is rarely
/// longer.
const KEEP: Duration = Duration::from_secs(10);
const AFTER: Duration = Duration::from_secs(2);
const MOST_FILES: u16 = 10;
/// Enough for half a minute of both directions at a tenth of 100 Mbit/s.
const MEMORY_MIB: u16 = 128;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_have_bounds_on_both_sides() {
        for (text, ms) in [("10ms", 10), ("10s", 10_000), ("10min", 600_000)] {
            assert_eq!(keep(text), Ok(Duration::from_millis(ms)));
        }
        for text in ["0s", "9999999ns", "600000000001ns", "8760h", "-1s", "10", "long"] {
            assert!(keep(text).is_err(), "{text}");
        }
        for (text, ms) in [("0s", 0), ("1min", 60_000)] {
            assert_eq!(after(text), Ok(Duration::from_millis(ms)));
        }
        for text in ["-1ns", "60000000001ns"] {
            assert!(after(text).is_err(), "{text}");
        }
    }
}

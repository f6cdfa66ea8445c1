//! Frames that are stored when an incident happens.
//!
//! A [`Guard`] takes frames as they come, from a listener or from the loop of a MainDevice. It
//! keeps the last seconds ([`isocat_recorders::flight`]), passes each frame to the judge of
//! captures ([`isocat_diagnose::live`]), and triggers the recorder when the judge finds a selected
//! fault. Incidents, and the results of the files, are reported as [`Event`]s.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use isocat_captures::pairing::Seen;
use isocat_captures::reading::Frame;
use isocat_diagnose::live::{Live, Symptom};
use isocat_diagnose::{Claims, Names};
use isocat_recorders::flight::{FlightRecorder, Limits, Reason, Told};
use serde_json::{Value, json};

/// The incidents that trigger a file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum On {
    /// A working counter is lower than usual
    Wkc,
    /// A device leaves OP, refuses a state, or no longer answers
    AlState,
    /// SYNC is lost: skipped cycles, frames beyond SYNC0, clocks apart, a host that drifts
    Sync,
    /// Frames are lost, doubled, damaged, or come from another MainDevice
    Lost,
    /// SIGUSR1
    Signal,
}

impl On {
    /// All incidents.
    pub const ALL: [Self; 5] = [Self::Wkc, Self::AlState, Self::Sync, Self::Lost, Self::Signal];

    fn of(symptom: Symptom) -> Self {
        match symptom {
            Symptom::WorkingCounter => Self::Wkc,
            Symptom::State => Self::AlState,
            Symptom::Sync => Self::Sync,
            Symptom::Frames => Self::Lost,
        }
    }
}

/// A report of a guard.
#[derive(Debug)]
pub enum Event {
    /// An incident for which a file is written.
    Happened {
        /// Time when it was noticed, wall time since 1970.
        at: Duration,
        /// Number of the frame that shows it, from the beginning of the recording; `None` for a
        /// signal.
        frame: Option<usize>,
        /// The reason.
        reason: Reason,
    },
    /// The result of a file.
    File(Told),
}

/// The settings of a guard.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Limits of the recording.
    pub limits: Limits,
    /// The incidents that trigger a file.
    pub on: Vec<On>,
    /// Names of the devices.
    pub names: Names,
    /// What they are meant to do.
    pub claims: Option<Claims>,
}

/// Keeps frames, judges them, and triggers files.
#[derive(Debug)]
pub struct Guard {
    recorder: FlightRecorder,
    live: Live,
    wanted: Wanted,
    /// Set by a signal.
    asked: Arc<AtomicBool>,
    events: SyncSender<Event>,
    looked: Duration,
    /// Whether the judge has found a fault since it was last reset.
    found: bool,
    frames: u64,
}

impl Guard {
    /// Starts to guard `interface`, with files in `folder`; `asked` is set to request a file at
    /// once. The error says why no file can be written there. If `events` is no longer read,
    /// recording continues without reports.
    pub fn new(
        folder: &Path,
        interface: &str,
        wanted: Wanted,
        asked: Arc<AtomicBool>,
    ) -> std::io::Result<(Self, Receiver<Event>)> {
        let recorder = FlightRecorder::new(folder, interface, wanted.limits)?;
        let live = Live::new(interface).against(wanted.claims.clone());
        let (events, incoming) = sync_channel(MOST_EVENTS);
        let looked = Duration::ZERO;
        let guard = Self { recorder, live, wanted, asked, events, looked, found: false, frames: 0 };
        Ok((guard, incoming))
    }

    /// Takes a frame that was sent (`sent`) or received at `at`, wall time since 1970.
    pub fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        self.frames = self.recorder.frame(at, sent, bytes);
        let number = usize::try_from(self.frames).unwrap_or(usize::MAX);
        self.live.frame(Frame {
            number,
            at,
            interface: 0,
            sent: Some(sent),
            bytes: bytes.to_vec(),
        });
        if at >= self.looked + LOOK {
            self.idle(at);
        }
    }

    /// Advances the time to `now`, with or without frames; it must be called some ten times per
    /// second.
    pub fn idle(&mut self, now: Duration) {
        self.looked = now;
        if self.asked.swap(false, Ordering::Relaxed) && self.wanted.on.contains(&On::Signal) {
            let what = "SIGUSR1 asked for it".to_owned();
            self.happened(now, None, Reason { kind: "signal", what });
        }
        for news in self.live.news(&self.wanted.names) {
            self.found = true;
            if self.wanted.on.contains(&On::of(news.symptom)) {
                let (kind, what) = (news.finding.kind, news.finding.what);
                self.happened(now, Some(news.frame), Reason { kind, what });
            }
        }
        // The judge is reset just before the incident ends, so that later faults are new ones.
        let ends = self.recorder.until().is_none_or(|until| now + LOOK >= until);
        if self.found && ends {
            self.live.forget();
            self.found = false;
        }
        self.recorder.tick(now);
        while let Some(told) = self.recorder.poll() {
            self.say(Event::File(told));
        }
    }

    /// Number of frames so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The directions that are seen; `None` if that is not known yet.
    pub fn seen(&self) -> Option<Seen> {
        self.live.seen()
    }

    /// Writes the rest, and waits for the disk.
    pub fn finish(mut self) {
        self.idle(self.looked);
        let Self { recorder, events, .. } = self;
        for told in recorder.finish() {
            let _ = events.try_send(Event::File(told));
        }
    }

    fn happened(&mut self, at: Duration, frame: Option<usize>, reason: Reason) {
        self.recorder.trigger(frame.map(|frame| frame as u64), reason.clone());
        self.say(Event::Happened { at, frame, reason });
    }

    fn say(&self, event: Event) {
        // Events that are not read in time are dropped, to bound the memory; the file contains
        // them, too.
        let _ = self.events.try_send(event);
    }
}

#[cfg(target_os = "linux")]
impl isocat_host::recorder::Sink for Guard {
    fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        self.frame(at, sent, bytes);
    }

    fn idle(&mut self, now: Duration) {
        if now >= self.looked + LOOK {
            self.idle(now);
        }
    }

    fn finish(self: Box<Self>) -> std::io::Result<()> {
        Self::finish(*self);
        Ok(())
    }
}

impl Event {
    /// The event as one line for people.
    pub fn words(&self) -> String {
        match self {
            Self::Happened { frame: Some(frame), reason, .. } => {
                format!("frame {frame}: {}: {}", reason.kind, reason.what)
            }
            Self::Happened { frame: None, reason, .. } => {
                format!("{}: {}", reason.kind, reason.what)
            }
            Self::File(told) => of_file(told),
        }
    }

    /// The event as one line for programs.
    pub fn json(&self) -> Value {
        match self {
            Self::Happened { at, frame, reason } => json!({
                "event": "happened", "at_ns": at.as_nanos() as u64, "frame": frame,
                "kind": reason.kind, "what": reason.what,
            }),
            Self::File(Told::Written { path, frames, span, crowded, reasons, removed }) => json!({
                "event": "written", "file": path, "frames": frames,
                "span_ns": span.as_nanos() as u64, "crowded": crowded,
                "kinds": kinds(reasons), "removed": removed,
            }),
            Self::File(Told::Failed { path, error, reasons }) => json!({
                "event": "failed", "file": path, "error": error.to_string(),
                "kinds": kinds(reasons),
            }),
            Self::File(Told::Empty { reasons }) => {
                json!({ "event": "empty", "kinds": kinds(reasons) })
            }
            Self::File(Told::NotKept { reasons }) => {
                json!({ "event": "not kept", "kinds": kinds(reasons) })
            }
        }
    }
}

fn of_file(told: &Told) -> String {
    match told {
        Told::Written { path, frames, span, crowded, removed, .. } => {
            let crowded = match crowded {
                true => "; memory had no room for all older frames, --memory gives more",
                false => "",
            };
            let removed = removed.as_ref().map_or(String::new(), |removed| {
                format!("; {} was removed for it", removed.display())
            });
            let (path, seconds) = (path.display(), span.as_secs_f64());
            format!("written: {path}, {frames} frames of {seconds:.3} s{crowded}{removed}")
        }
        Told::Failed { path, error, reasons } => {
            let why = match error.kind() {
                std::io::ErrorKind::StorageFull => "no space left on its disk".to_owned(),
                _ => error.to_string(),
            };
            let kinds = kinds(reasons).join(", ");
            format!("{} can't be written: {why}; not recorded: {kinds}", path.display())
        }
        Told::Empty { reasons } => {
            format!("no frame was seen yet, so there is no file for: {}", kinds(reasons).join(", "))
        }
        Told::NotKept { reasons } => {
            let kinds = kinds(reasons).join(", ");
            format!("the one file that may be is written already, so there is none for: {kinds}")
        }
    }
}

fn kinds(reasons: &[Reason]) -> Vec<&'static str> {
    reasons.iter().map(|reason| reason.kind).collect()
}

/// Time from one search for faults to the next.
const LOOK: Duration = Duration::from_millis(50);
/// Largest number of events that wait to be read.
const MOST_EVENTS: usize = 1024;

//! A flight recorder: when something happens on a wire, the seconds before and after it are written
//! to a file.
//!
//! [`FlightRecorder::frame`] keeps each frame in a [`Ring`]. [`FlightRecorder::trigger`] reports an
//! event at a frame and begins an *incident*: the span from [`Limits::keep`] before the frame to
//! [`Limits::after`] after it. Further events in the second part belong to the same incident, which
//! then lasts until `after` after the last of them, but at most twice `after`; a later event begins
//! the next incident. When an incident is over, its frames are copied and given to a thread that
//! writes the file. So a slow or full disk does not delay frames, and events while a file is
//! written are not lost.
//!
//! Call [`FlightRecorder::tick`] from time to time, with or without frames, and take the results of
//! the files from [`FlightRecorder::poll`]. All instants are of one clock that does not jump, for
//! example wall time since 1970.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::ring::Ring;

mod writer;

use writer::{Job, Writer};

/// How much a flight recorder keeps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Time that is kept before an event.
    pub keep: Duration,
    /// Time that is kept after an event.
    pub after: Duration,
    /// Memory for frames, bytes. Copies that wait for the disk take up to twice as much in
    /// addition.
    pub most_bytes: usize,
    /// Number of files of one recorder in its folder, not 0. The first file always stays; of the
    /// others, the oldest one is removed for the newest.
    pub most_files: usize,
}

/// An event that is recorded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reason {
    /// A short name, which is part of the file's name.
    pub kind: &'static str,
    /// The event in a sentence.
    pub what: String,
}

/// The result of an incident.
#[derive(Debug)]
pub enum Told {
    /// It was written to a file.
    Written {
        /// The file.
        path: PathBuf,
        /// Number of frames in it.
        frames: u64,
        /// Time from its first frame to its last.
        span: Duration,
        /// Whether frames of the wanted span are missing, because the memory limit was reached.
        crowded: bool,
        /// The events, in the order in which they were reported.
        reasons: Vec<Reason>,
        /// The older file that was removed for it.
        removed: Option<PathBuf>,
    },
    /// The file could not be written, and nothing of it is left.
    Failed {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
        /// The events.
        reasons: Vec<Reason>,
    },
    /// There was no frame to write.
    Empty {
        /// The events.
        reasons: Vec<Reason>,
    },
    /// The only allowed file exists already.
    NotKept {
        /// The events.
        reasons: Vec<Reason>,
    },
}

/// Keeps the last seconds of a wire, and writes them when something happens.
#[derive(Debug)]
pub struct FlightRecorder {
    ring: Ring,
    limits: Limits,
    /// Incidents that are not written yet, in the order of their beginnings.
    incidents: VecDeque<Incident>,
    writer: Writer,
    told: VecDeque<Told>,
    /// The time of the last frame or tick.
    now: Duration,
}

/// A span of time around events.
#[derive(Debug)]
struct Incident {
    /// When its first event happened.
    at: Duration,
    /// Until when frames belong to it.
    until: Duration,
    reasons: Vec<(Duration, Reason)>,
    /// Number of reasons beyond those that are kept.
    more: u64,
}

impl FlightRecorder {
    /// Begins to keep frames of `interface`, for files in `folder`, which is created if it does not
    /// exist. `Err`: no file can be written there.
    pub fn new(folder: &Path, interface: &str, limits: Limits) -> io::Result<Self> {
        let writer = Writer::new(folder, interface, limits.most_files)?;
        // An incident lasts at most twice `after`, and an event may be reported late.
        let span = limits.keep + 2 * limits.after + LATE;
        let ring = Ring::new(span, limits.most_bytes);
        let (incidents, told) = (VecDeque::with_capacity(MOST_INCIDENTS), VecDeque::new());
        Ok(Self { ring, limits, incidents, writer, told, now: Duration::ZERO })
    }

    /// Takes a frame that left (`sent`) or came in at `at`; returns its number, from 1. Allocates
    /// nothing after memory has grown to the size of the span, unless an incident ends.
    pub fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) -> u64 {
        let number = self.ring.push(at, sent, bytes);
        self.tick(at);
        number
    }

    /// Reports an event at the frame with this number; `None`: at the last frame. The file has a
    /// comment there, or at the first frame after it if that frame is no longer kept.
    pub fn trigger(&mut self, number: Option<u64>, reason: Reason) {
        let number = number.unwrap_or(self.ring.last());
        let at = self.ring.at(number).unwrap_or(self.now);
        let after = self.limits.after;
        let full = self.incidents.len() >= MOST_INCIDENTS;
        let same = |incident: &Incident| full || at <= incident.at + after;
        if let Some(incident) = self.incidents.back_mut().filter(|last| same(last)) {
            incident.until = incident.until.max((at + after).min(incident.at + 2 * after));
            incident.add(at, reason);
            return;
        }
        let reasons = vec![(at, reason)];
        self.incidents.push_back(Incident { at, until: at + after, reasons, more: 0 });
    }

    /// Tells the present time, and writes the incidents that are over.
    pub fn tick(&mut self, now: Duration) {
        self.now = self.now.max(now);
        while self.incidents.front().is_some_and(|first| first.until < self.now) {
            if !self.give(false) {
                return;
            }
        }
    }

    /// The results of incidents, one after the other.
    pub fn poll(&mut self) -> Option<Told> {
        self.told.pop_front().or_else(|| self.writer.told())
    }

    /// When the present incident ends; `None`: there is none.
    pub fn until(&self) -> Option<Duration> {
        self.incidents.back().map(|last| last.until)
    }

    /// Writes all incidents, waits for the disk, and returns the results that were not taken yet.
    pub fn finish(mut self) -> Vec<Told> {
        while !self.incidents.is_empty() {
            self.give(true);
        }
        let mut told = Vec::from(self.told);
        told.extend(self.writer.finish());
        told
    }

    /// Gives the first incident to the writer. Returns false if the writer's queue is full, and the
    /// incident waits. With `patient`, waits for the writer instead.
    fn give(&mut self, patient: bool) -> bool {
        if !patient && !self.writer.has_room() {
            return false;
        }
        let Some(incident) = self.incidents.pop_front() else { return true };
        let from = incident.at.saturating_sub(self.limits.keep);
        let stretch = self.ring.copy(from, incident.until);
        let job = Job {
            at: incident.at,
            crowded: self.ring.lacks_since(from),
            comments: incident.comments(),
            reasons: incident.reasons.into_iter().map(|(_, reason)| reason).collect(),
            stretch,
        };
        if job.stretch.is_empty() {
            self.told.push_back(Told::Empty { reasons: job.reasons });
        } else {
            self.writer.give(job);
        }
        true
    }
}

impl Incident {
    fn add(&mut self, at: Duration, reason: Reason) {
        match self.reasons.len() < MOST_REASONS {
            true => self.reasons.push((at, reason)),
            false => self.more += 1,
        }
    }

    /// The comments of its file, each with its instant.
    fn comments(&self) -> Vec<(Duration, String)> {
        let words = |(at, Reason { kind, what }): &(Duration, Reason)| {
            (*at, format!("isocat: {kind}: {what}"))
        };
        let mut comments: Vec<_> = self.reasons.iter().map(words).collect();
        if let Some((at, _)) = comments.last().filter(|_| self.more > 0) {
            comments.push((*at, format!("isocat: {} more reasons came later", self.more)));
        }
        comments
    }
}

/// How late an event may be reported: a frame counts as lost when its answer has not come for a
/// second.
const LATE: Duration = Duration::from_secs(2);
/// Incidents that can wait to end, or for the disk.
const MOST_INCIDENTS: usize = 8;
/// Reasons that one file names.
const MOST_REASONS: usize = 64;

#[cfg(test)]
mod tests;

//! A flight recorder: the last seconds of a wire go to a file when something happens, and the
//! seconds behind it as well.
//!
//! [`FlightRecorder::frame`] keeps each frame in a [`Ring`]. [`FlightRecorder::trigger`] says that
//! something happened at a frame, and begins an *incident*: the span from [`Limits::keep`] before
//! it to [`Limits::after`] behind it. What happens within that second part belongs to the same
//! incident, which then lasts until `after` behind the last of it, at most twice `after` in all;
//! what happens later begins the next one. When an incident is over, its frames are copied and
//! given to a thread that writes the file. So neither a slow disk nor a full one holds up frames,
//! and what happens while a file is written is not lost.
//!
//! Call [`FlightRecorder::tick`] now and then, with or without frames, and take what became of the
//! files with [`FlightRecorder::poll`]. All instants are of one clock that does not jump, as wall
//! time since 1970.

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
    /// Time before something happens.
    pub keep: Duration,
    /// Time behind it.
    pub after: Duration,
    /// Memory for frames, bytes. Copies that wait for the disk take as much again, twice at most.
    pub most_bytes: usize,
    /// Files of one recorder in its folder, not 0. The first one stays; of the others, the oldest
    /// makes room for the newest.
    pub most_files: usize,
}

/// Something that happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reason {
    /// A short name; it becomes a part of the file's name.
    pub kind: &'static str,
    /// What it is, in a sentence.
    pub what: String,
}

/// What became of an incident.
#[derive(Debug)]
pub enum Told {
    /// It is in a file.
    Written {
        /// The file.
        path: PathBuf,
        /// Frames in it.
        frames: u64,
        /// From its first frame to its last.
        span: Duration,
        /// Whether frames of the span that was asked for are missing, since memory had no room for
        /// them.
        crowded: bool,
        /// What happened, in the order in which it was told.
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
        /// What happened.
        reasons: Vec<Reason>,
    },
    /// There was no frame to write.
    Empty {
        /// What happened.
        reasons: Vec<Reason>,
    },
    /// The one file that may be is there already.
    NotKept {
        /// What happened.
        reasons: Vec<Reason>,
    },
}

/// Keeps the last seconds, and writes them when something happens.
#[derive(Debug)]
pub struct FlightRecorder {
    ring: Ring,
    limits: Limits,
    /// In the order of their beginnings.
    incidents: VecDeque<Incident>,
    writer: Writer,
    told: VecDeque<Told>,
    /// When the last frame or tick was.
    now: Duration,
}

/// A span of time in which something happened.
#[derive(Debug)]
struct Incident {
    /// When the first of it happened.
    at: Duration,
    /// Until when frames belong to it.
    until: Duration,
    reasons: Vec<(Duration, Reason)>,
    /// Reasons that there was no room for.
    more: u64,
}

impl FlightRecorder {
    /// Begins to keep frames of `interface`, for files in `folder`, which is made if it is not
    /// there. The error says why no file can be written there.
    pub fn new(folder: &Path, interface: &str, limits: Limits) -> io::Result<Self> {
        let writer = Writer::new(folder, interface, limits.most_files)?;
        // An incident lasts for `after` twice at most, and what is wrong may be told late.
        let span = limits.keep + 2 * limits.after + LATE;
        let ring = Ring::new(span, limits.most_bytes);
        let (incidents, told) = (VecDeque::with_capacity(MOST_INCIDENTS), VecDeque::new());
        Ok(Self { ring, limits, incidents, writer, told, now: Duration::ZERO })
    }

    /// Takes a frame that left (`sent`) or came in at `at`; gives its number, from 1. Allocates
    /// nothing once memory has grown to what the span takes, unless an incident ends.
    pub fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) -> u64 {
        let number = self.ring.push(at, sent, bytes);
        self.tick(at);
        number
    }

    /// Something happened at the frame with this number; `None`: at the last one. The file has a
    /// comment there, or at the first frame behind it if that one is not kept any more.
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

    /// It is `now`: incidents that are over go to the disk.
    pub fn tick(&mut self, now: Duration) {
        self.now = self.now.max(now);
        while self.incidents.front().is_some_and(|first| first.until < self.now) {
            if !self.give(false) {
                return;
            }
        }
    }

    /// What became of incidents, one after the other.
    pub fn poll(&mut self) -> Option<Told> {
        self.told.pop_front().or_else(|| self.writer.told())
    }

    /// When the incident that goes on now is over; `None`: none goes on.
    pub fn until(&self) -> Option<Duration> {
        self.incidents.back().map(|last| last.until)
    }

    /// Writes what is left, waits for the disk, and gives what was not told yet.
    pub fn finish(mut self) -> Vec<Told> {
        while !self.incidents.is_empty() {
            self.give(true);
        }
        let mut told = Vec::from(self.told);
        told.extend(self.writer.finish());
        told
    }

    /// Gives the first incident to the writer. False: it has no room, and the incident waits.
    /// `patient`: waits for the room.
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

    /// The comments of its file, and when what they say happened.
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

/// What is wrong is told this much later than it happened, at most: a frame counts as lost when its
/// answer has not come for a second.
const LATE: Duration = Duration::from_secs(2);
/// Incidents that wait to be over, or for the disk.
const MOST_INCIDENTS: usize = 8;
/// Reasons that one file names.
const MOST_REASONS: usize = 64;

#[cfg(test)]
mod tests;

//! Hands a status from the loop that keeps a cycle to its readers.
//!
//! There is one status, filled in place. If a reader holds it, the loop leaves it for the next
//! cycle. The loop never waits, and allocates only if a text has changed. A reader takes a copy,
//! which resets the figures called `recent`. If the status is filled more often than it is taken,
//! values are kept, so that nothing between two reads is lost.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

use super::main_device::Note;
use super::{Event, Status};

/// The place of a status, shared by the loop and its readers.
#[derive(Clone, Debug)]
pub struct Board(Arc<Mutex<Sheet>>);

/// The content of a board.
#[derive(Debug)]
pub struct Sheet {
    /// The status; its `events` are empty, `notes` has them.
    pub status: Status,
    /// Events, each with its time.
    pub notes: VecDeque<(i64, Note)>,
    /// Number of notes that were dropped because no reader took them.
    pub dropped: u64,
    /// Whether it was taken since it was filled.
    pub taken: bool,
    /// Whether it was filled since it was taken.
    fresh: bool,
}

/// Largest number of notes that wait to be taken.
pub(crate) const MOST_NOTES: usize = 256;

impl Board {
    /// A board with a first status.
    pub fn new(status: Status) -> Self {
        let notes = VecDeque::with_capacity(MOST_NOTES);
        Self(Arc::new(Mutex::new(Sheet { status, notes, dropped: 0, taken: true, fresh: true })))
    }

    /// Fills the board. If a reader holds it, nothing happens and the result is false.
    pub fn fill(&self, with: impl FnOnce(&mut Sheet)) -> bool {
        let mut sheet = match self.0.try_lock() {
            Ok(sheet) => sheet,
            // A reader that panicked has not changed it.
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return false,
        };
        with(&mut sheet);
        (sheet.taken, sheet.fresh) = (false, true);
        true
    }

    /// Marks the end, with the reason in case of a failure. Waits while a reader holds the board.
    pub fn end(&self, failure: Option<String>) {
        while !self.fill(|sheet| {
            sheet.status.stage = super::Stage::Ended;
            sheet.status.failure.clone_from(&failure);
        }) {
            std::thread::yield_now();
        }
    }

    /// Takes the status, if it is new.
    pub fn take(&self) -> Option<Status> {
        let spare = VecDeque::with_capacity(MOST_NOTES);
        // It does not block on the lock, so that the loop never has to wake a thread.
        let mut sheet = loop {
            match self.0.try_lock() {
                Ok(sheet) => break sheet,
                Err(TryLockError::Poisoned(poisoned)) => break poisoned.into_inner(),
                Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_micros(200)),
            }
        };
        if !std::mem::take(&mut sheet.fresh) {
            return None;
        }
        sheet.taken = true;
        let mut status = sheet.status.clone();
        let notes = std::mem::replace(&mut sheet.notes, spare);
        let dropped = std::mem::take(&mut sheet.dropped);
        drop(sheet);
        let lost = (dropped > 0).then(|| Event {
            at_ns: status.at_ns,
            position: None,
            bad: false,
            alarm: false,
            what: format!("{dropped} events are not shown"),
        });
        status.events = lost.into_iter().chain(notes.into_iter().map(Event::from)).collect();
        Some(status)
    }
}

impl Sheet {
    /// Adds an event; if the queue is full, the oldest one is dropped.
    pub fn note(&mut self, at_ns: i64, note: Note) {
        if self.notes.len() >= MOST_NOTES {
            self.notes.pop_front();
            self.dropped += 1;
        }
        self.notes.push_back((at_ns, note));
    }
}

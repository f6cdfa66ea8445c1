//! From the loop that keeps a cycle to whoever looks.
//!
//! There is one status, in place. The loop fills it if nobody is just looking, else it leaves it for the next cycle: it never
//! waits, and where no text has changed it takes no memory. Who looks takes a copy, which resets what is called
//! `recent`; what is filled in more often than taken is kept, so that nothing between two looks is missed.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

use super::main_device::Note;
use super::{Event, Status};

/// The place where a status stands.
#[derive(Clone, Debug)]
pub struct Board(Arc<Mutex<Sheet>>);

/// What stands there.
#[derive(Debug)]
pub struct Sheet {
    /// The status; its `events` are empty, `notes` has them.
    pub status: Status,
    /// What happened: when, and what.
    pub notes: VecDeque<(i64, Note)>,
    /// Notes that were dropped since nobody took them.
    pub dropped: u64,
    /// It was taken since it was filled.
    pub taken: bool,
    /// It was filled since it was taken.
    fresh: bool,
}

/// Notes that wait to be taken.
pub(crate) const MOST_NOTES: usize = 256;

impl Board {
    /// With a first status.
    pub fn new(status: Status) -> Self {
        let notes = VecDeque::with_capacity(MOST_NOTES);
        Self(Arc::new(Mutex::new(Sheet { status, notes, dropped: 0, taken: true, fresh: true })))
    }

    /// Lets it be filled, unless somebody is just looking; then it is false, and nothing happened.
    pub fn fill(&self, with: impl FnOnce(&mut Sheet)) -> bool {
        let mut sheet = match self.0.try_lock() {
            Ok(sheet) => sheet,
            // Who looked and died has left it as it was.
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return false,
        };
        with(&mut sheet);
        (sheet.taken, sheet.fresh) = (false, true);
        true
    }

    /// Nothing more comes; says why, if that is bad news. Waits for whoever is looking.
    pub fn end(&self, failure: Option<String>) {
        while !self.fill(|sheet| {
            sheet.status.stage = super::Stage::Ended;
            sheet.status.failure.clone_from(&failure);
        }) {
            std::thread::yield_now();
        }
    }

    /// Takes what stands there, if it is new.
    pub fn take(&self) -> Option<Status> {
        let spare = VecDeque::with_capacity(MOST_NOTES);
        // Never waiting in the kernel, so that the loop never has to wake anybody.
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
    /// Notes what happened; the oldest gives way.
    pub fn note(&mut self, at_ns: i64, note: Note) {
        if self.notes.len() >= MOST_NOTES {
            self.notes.pop_front();
            self.dropped += 1;
        }
        self.notes.push_back((at_ns, note));
    }
}

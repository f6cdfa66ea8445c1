//! The states of a device over time, as requests and readings show them.

use std::time::Duration;

use isocat_wire::al::{AlControl, AlState, AlStatus, AlStatusCode};

use crate::known::{Known, Log};

/// A status, with the frame that first showed it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct StateSeen {
    pub frame: usize,
    pub at: Duration,
    pub status: AlStatus,
    /// AL status code, if it was read while this status held.
    pub code: Option<AlStatusCode>,
    /// The last frame that showed the previous status; `None`: none was seen before.
    pub before: Option<usize>,
    /// When that was.
    pub before_at: Option<Duration>,
    /// The last request of the MainDevice; `None`: none in this capture.
    pub asked: Option<Known<AlControl>>,
}

/// A request by AL control.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Asked {
    pub frame: usize,
    pub at: Duration,
    pub control: AlControl,
}

/// The states of one device.
#[derive(Clone, Debug)]
pub(crate) struct States {
    pub changes: Log<StateSeen>,
    pub requests: Log<Asked>,
    /// The present status, and the last frame that showed it.
    now: Option<(AlStatus, usize)>,
    /// When it was last seen.
    seen_at: Option<Duration>,
    /// The last request; `None`: none in this capture.
    pub asked: Option<Known<AlControl>>,
    /// When it was first seen in OP.
    pub op: Option<Known<Duration>>,
    /// The last frame that showed it in OP.
    pub last_op: usize,
}

impl StateSeen {
    /// Whether the error bit is the acknowledge bit of the request: a device without a CPU copies
    /// AL control to AL status.
    pub fn copied(&self) -> bool {
        let control = self.asked.map(|asked| asked.value.0 & 0x1F);
        control == Some(self.status.0 & 0x1F) && self.code.is_none_or(|code| code.0 == 0)
    }

    /// Whether it shows an error.
    pub fn error(&self) -> bool {
        self.status.error() && !self.copied()
    }
}

impl States {
    pub fn new() -> Self {
        let (changes, requests) = (Log::new(MOST_EVENTS), Log::new(MOST_EVENTS));
        Self { changes, requests, now: None, seen_at: None, asked: None, op: None, last_op: 0 }
    }

    /// Takes a request for a state.
    pub fn ask(&mut self, frame: usize, at: Duration, control: AlControl) {
        let new = Known { value: control, frame };
        if self.asked.replace(new).is_none_or(|asked| asked.value != control) {
            self.requests.push(Asked { frame, at, control });
        }
    }

    /// Takes AL status from a frame, perhaps with its code.
    pub fn see(
        &mut self,
        frame: usize,
        at: Duration,
        status: AlStatus,
        code: Option<AlStatusCode>,
    ) {
        if status.state() == Ok(AlState::Op) {
            self.last_op = frame;
        }
        let before = self.now.replace((status, frame));
        let before_at = self.seen_at.replace(at);
        if before.is_none_or(|(before, _)| before != status) {
            let (before, asked) = (before.map(|(_, frame)| frame), self.asked);
            let code = None;
            self.changes.push(StateSeen { frame, at, status, code, before, before_at, asked });
        }
        if let Some(code) = code {
            self.see_code(code);
        }
    }

    /// Takes an AL status code that was read alone.
    pub fn see_code(&mut self, code: AlStatusCode) {
        // If events were left off, the last one kept is not the present status.
        if self.changes.left_off() > 0 {
            return;
        }
        if let Some(last) = self.changes.kept.last_mut()
            && last.code.is_none_or(|known| known.0 == 0)
        {
            last.code = Some(code);
        }
    }

    /// Forgets the events so far; the present status stays known.
    pub fn forget(&mut self, at: Duration) {
        let mut changes = Log::new(MOST_EVENTS);
        let last = self.changes.kept.last().copied();
        let now = self.now.map(|(status, frame)| StateSeen {
            frame,
            at,
            status,
            code: None,
            before: Some(frame),
            before_at: Some(at),
            asked: self.asked,
        });
        // If events were left off, the last one kept is not the present status.
        if let Some(holds) = last.filter(|_| self.changes.left_off() == 0).or(now) {
            changes.push(holds);
        }
        self.changes = changes;
        self.requests = Log::new(MOST_EVENTS);
    }

    /// The present status, and the last frame that showed it.
    pub fn last_seen(&self) -> Option<(AlStatus, usize)> {
        self.now
    }

    /// The present status.
    pub fn now(&self) -> Option<AlStatus> {
        self.now.map(|(status, _)| status)
    }
}

/// Changes and requests of one device that are kept.
const MOST_EVENTS: usize = 256;

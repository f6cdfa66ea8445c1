//! The states of a device over time, as requests and readings show them.

use std::time::Duration;

use isocat_wire::al::{AlControl, AlStatus, AlStatusCode};

use crate::known::{Known, Log};

/// A status that was seen first in this frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct StateSeen {
    pub frame: usize,
    pub at: Duration,
    pub status: AlStatus,
    /// AL status code, if it was read while this status held.
    pub code: Option<AlStatusCode>,
    /// The last frame that showed the status before; `None`: none was seen before.
    pub before: Option<usize>,
    /// What the MainDevice had asked for last; `None`: nothing in this capture.
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
    /// The status that holds, and the last frame that showed it.
    now: Option<(AlStatus, usize)>,
    /// What was asked for last; `None`: nothing in this capture.
    pub asked: Option<Known<AlControl>>,
    /// When it was first seen in OP.
    pub op: Option<Known<Duration>>,
}

impl StateSeen {
    /// Whether the error bit is the acknowledge bit of the request: a device without a CPU copies
    /// AL control to AL status.
    pub fn copied(&self) -> bool {
        let control = self.asked.map(|asked| asked.value.0 & 0x1F);
        control == Some(self.status.0 & 0x1F) && self.code.is_none_or(|code| code.0 == 0)
    }

    /// It shows an error.
    pub fn error(&self) -> bool {
        self.status.error() && !self.copied()
    }
}

impl States {
    pub fn new() -> Self {
        let (changes, requests) = (Log::new(MOST_EVENTS), Log::new(MOST_EVENTS));
        Self { changes, requests, now: None, asked: None, op: None }
    }

    /// The MainDevice asked for a state.
    pub fn ask(&mut self, frame: usize, at: Duration, control: AlControl) {
        let new = Known { value: control, frame };
        if self.asked.replace(new).is_none_or(|asked| asked.value != control) {
            self.requests.push(Asked { frame, at, control });
        }
    }

    /// A frame shows AL status, perhaps with its code.
    pub fn see(
        &mut self,
        frame: usize,
        at: Duration,
        status: AlStatus,
        code: Option<AlStatusCode>,
    ) {
        let before = self.now.replace((status, frame));
        if before.is_none_or(|(before, _)| before != status) {
            let (before, asked) = (before.map(|(_, frame)| frame), self.asked);
            self.changes.push(StateSeen { frame, at, status, code: None, before, asked });
        }
        if let Some(code) = code {
            self.see_code(code);
        }
    }

    /// A frame shows AL status code alone.
    pub fn see_code(&mut self, code: AlStatusCode) {
        // While events are left off, the last one kept is not the one that holds.
        if self.changes.left_off() > 0 {
            return;
        }
        if let Some(last) = self.changes.kept.last_mut()
            && last.code.is_none_or(|known| known.0 == 0)
        {
            last.code = Some(code);
        }
    }

    /// What happened so far is told no more; what holds stays known.
    pub fn forget(&mut self, at: Duration) {
        let mut changes = Log::new(MOST_EVENTS);
        let last = self.changes.kept.last().copied();
        let now = self.now.map(|(status, frame)| StateSeen {
            frame,
            at,
            status,
            code: None,
            before: Some(frame),
            asked: self.asked,
        });
        // While events are left off, the last one kept is not the one that holds.
        if let Some(holds) = last.filter(|_| self.changes.left_off() == 0).or(now) {
            changes.push(holds);
        }
        self.changes = changes;
        self.requests = Log::new(MOST_EVENTS);
    }

    /// The status that holds.
    pub fn now(&self) -> Option<AlStatus> {
        self.now.map(|(status, _)| status)
    }
}

/// Changes and requests of one device that are kept.
const MOST_EVENTS: usize = 256;

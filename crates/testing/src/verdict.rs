//! The result of a run.

use std::fmt;
use std::time::Duration;

use isocat_serve::Summary;
use isocat_serve::summary::{JudgedSummary, Outcome, SessionSummary};

/// What the MainDevice did, and the verdict of judges that watched in the segment's true time.
///
/// Its text holds all of that, for the message of an assertion: `assert!(verdict.in_sync(),
/// "{verdict}")`.
#[derive(Clone, PartialEq, Debug)]
#[must_use = "a verdict that is not looked at fails no test"]
pub struct Verdict {
    pub(crate) summary: Summary,
    pub(crate) seed: u64,
    pub(crate) lateness: Duration,
    pub(crate) lasted: Duration,
    pub(crate) wire: u64,
}

impl Verdict {
    /// Whether devices reached operation, and there is no finding against any of them while it was
    /// asked to be in operation. If the MainDevice started again, each session counts.
    pub fn in_sync(&self) -> bool {
        let sessions = &self.summary.sessions;
        let came_up = |session: &SessionSummary| session.judged.is_some();
        sessions.last().is_some_and(came_up) && self.judged().all(|judged| judged.in_sync)
    }

    /// Whether everything that the `[[expect]]` tables of the segment file expect came true and
    /// could be judged; true without such tables.
    pub fn as_expected(&self) -> bool {
        self.summary.outcome() == Outcome::AsExpected
    }

    /// The least time from the end of copying and calculating to SYNC0, ns, over all devices in the
    /// last stretch of operation. Negative if a device was late; `None` without SYNC0.
    pub fn least_margin_ns(&self) -> Option<f64> {
        let devices = self.judged().last()?.devices.iter();
        devices.filter_map(|device| Some(device.sync0_margin.as_ref()?.min_ns)).reduce(f64::min)
    }

    /// The whole summary, as in `isocat serve --json`.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// Virtual time of the run.
    pub fn lasted(&self) -> Duration {
        self.lasted
    }

    /// A hash over all frames that were sent and came back, with port and instant. Two runs with
    /// equal hashes were the same on the wire, to the nanosecond.
    pub fn wire_hash(&self) -> u64 {
        self.wire
    }

    fn judged(&self) -> impl Iterator<Item = &JudgedSummary> {
        self.summary.sessions.iter().filter_map(|session| session.judged.as_ref())
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.summary.text();
        write!(f, "{}", anstream::adapter::strip_str(&text))?;
        let Self { seed, lasted, lateness, wire, .. } = self;
        let version = self.summary.version;
        write!(f, "\n{lasted:?} of virtual time, seed {seed}, ")?;
        if !lateness.is_zero() {
            write!(f, "wake-ups up to {lateness:?} late, ")?;
        }
        writeln!(f, "wire {wire:016x}, isocat {version}")
    }
}

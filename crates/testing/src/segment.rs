//! The segment that a test runs on, and what the test asks of the run.

use std::path::Path;
use std::time::Duration;

use isocat_descriptions::document::FileError;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::Setup;
use isocat_subdevice::Application;

use crate::place::position;

/// A virtual segment, and how a test runs on it.
///
/// Made of a segment file ([`file`](Self::file)), of its text ([`parse`](Self::parse)), or the
/// [`built_in`](Self::built_in) one.
#[must_use = "a segment does nothing until something runs on it"]
pub struct Segment {
    pub(crate) scenario: Scenario,
    pub(crate) lateness: Duration,
    pub(crate) latency: Duration,
    pub(crate) limit: Duration,
    applications: Vec<(usize, Box<dyn Application + Send>)>,
}

/// Virtual time after which a run ends with an error, unless a test says otherwise.
pub const LIMIT: Duration = Duration::from_secs(600);

/// From the last bit of an answer until the application has it, unless a test says otherwise: a PC
/// with a packet socket.
pub const LATENCY: Duration = Duration::from_micros(20);

impl Segment {
    /// A segment file. A relative path begins at the package's folder: `cargo test` runs tests there.
    ///
    /// # Errors
    ///
    /// What is wrong with the file, and at which line.
    pub fn file(path: impl AsRef<Path>) -> Result<Self, FileError> {
        SegmentFile::read(&path.as_ref().to_string_lossy()).map(Self::from)
    }

    /// The text of a segment file.
    ///
    /// # Errors
    ///
    /// What is wrong with it, and at which line.
    pub fn parse(text: &str) -> Result<Self, FileError> {
        SegmentFile::parse("the test's segment", text).map(Self::from)
    }

    /// The built-in segment, as `isocat example` prints it: two drives, a coupler with a PWM
    /// terminal, a third drive.
    pub fn built_in() -> Self {
        Self::from(SegmentFile::built_in())
    }

    /// The seed of everything random, in place of the file's: crystals, jitter, faults by chance,
    /// lateness of the host.
    pub fn seed(mut self, seed: u64) -> Self {
        self.scenario.seed = seed;
        self
    }

    /// The application's wake-ups are late by up to `worst`, a fifth of it in the mean. Default
    /// zero.
    pub fn lateness(mut self, worst: Duration) -> Self {
        self.lateness = worst;
        self
    }

    /// From the last bit of an answer until the application has it: network controller, interrupt,
    /// kernel. Default [`LATENCY`].
    pub fn latency(mut self, latency: Duration) -> Self {
        self.latency = latency;
        self
    }

    /// Virtual time after which the run ends with an error. Default [`LIMIT`].
    pub fn limit(mut self, limit: Duration) -> Self {
        self.limit = limit;
        self
    }

    /// Gives a device, by its name, an application of the test's own: the machine behind it. Its process data, objects and times stay
    /// those of its profile.
    ///
    /// # Panics
    ///
    /// If no device of the segment has this name.
    #[track_caller]
    pub fn application(
        mut self,
        device: &str,
        application: impl Application + Send + 'static,
    ) -> Self {
        let names: Vec<&str> =
            self.scenario.devices.iter().map(|device| device.name.as_str()).collect();
        let position = position(&names, device);
        self.applications.push((position, Box::new(application)));
        self
    }

    pub(crate) fn setup(&mut self) -> Setup {
        let mut setup = Setup::from(&self.scenario);
        for (position, application) in self.applications.drain(..) {
            setup.segment[position].device.application = application;
        }
        setup
    }
}

impl From<SegmentFile> for Segment {
    fn from(file: SegmentFile) -> Self {
        Self {
            scenario: Scenario::from(file),
            lateness: Duration::ZERO,
            latency: LATENCY,
            limit: LIMIT,
            applications: Vec::new(),
        }
    }
}

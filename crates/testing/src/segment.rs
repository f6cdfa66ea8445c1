//! The segment that a test runs on, and the settings of the run.

use std::path::Path;
use std::time::Duration;

use isocat_descriptions::document::FileError;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::Setup;
use isocat_subdevice::Application;

use crate::place::position;

/// A virtual segment, and the settings of a run.
///
/// It comes from a segment file ([`file`](Self::file)) or its text ([`parse`](Self::parse)), or is
/// the [`built_in`](Self::built_in) one.
#[must_use = "a segment does nothing until something runs on it"]
pub struct Segment {
    pub(crate) scenario: Scenario,
    pub(crate) lateness: Duration,
    pub(crate) latency: Duration,
    pub(crate) limit: Duration,
    applications: Vec<(usize, Box<dyn Application + Send>)>,
}

/// Default of the virtual time after which a run ends with an error.
pub const LIMIT: Duration = Duration::from_secs(600);

/// Default time from the last bit of an answer until the application has it: that of a PC with a
/// packet socket.
pub const LATENCY: Duration = Duration::from_micros(20);

impl Segment {
    /// Reads a segment file. A relative path begins at the package's folder, where `cargo test`
    /// runs tests.
    ///
    /// # Errors
    ///
    /// If the file is wrong, with the reason and the line.
    pub fn file(path: impl AsRef<Path>) -> Result<Self, FileError> {
        SegmentFile::read(&path.as_ref().to_string_lossy()).map(Self::from)
    }

    /// Reads the text of a segment file.
    ///
    /// # Errors
    ///
    /// If the text is wrong, with the reason and the line.
    pub fn parse(text: &str) -> Result<Self, FileError> {
        SegmentFile::parse("the test's segment", text).map(Self::from)
    }

    /// The built-in segment, as `isocat example` prints it: two drives, a coupler with a PWM
    /// terminal, a third drive.
    pub fn built_in() -> Self {
        Self::from(SegmentFile::built_in())
    }

    /// Sets the seed of all random values, in place of the file's: crystals, jitter, random faults,
    /// lateness of the host.
    pub fn seed(mut self, seed: u64) -> Self {
        self.scenario.seed = seed;
        self
    }

    /// Takes whatever the application makes of the segment as meant: modes, cycles, phases and
    /// states of the file are no claims. By default they are, and what is otherwise is a finding.
    pub fn as_is(mut self) -> Self {
        self.scenario.as_is = true;
        self
    }

    /// Sets how late the application's wake-ups are: by up to `worst`, and a fifth of it on
    /// average. Default zero.
    pub fn lateness(mut self, worst: Duration) -> Self {
        self.lateness = worst;
        self
    }

    /// Sets the time from the last bit of an answer until the application has it: network
    /// controller, interrupt, kernel. Default [`LATENCY`].
    pub fn latency(mut self, latency: Duration) -> Self {
        self.latency = latency;
        self
    }

    /// Sets the virtual time after which the run ends with an error. Default [`LIMIT`].
    pub fn limit(mut self, limit: Duration) -> Self {
        self.limit = limit;
        self
    }

    /// Replaces the application of the device with this name by one of the test: the machine behind
    /// it. Process data, objects and times remain those of its profile.
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

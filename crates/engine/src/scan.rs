//! A scan: the MainDevice explores a segment before any cycle, in virtual time or on an interface.
//!
//! The MainDevice goes as far as PREOP with converged clocks ([`Config::survey`]), everything is
//! read, and the SubDevices go back to INIT. [`report::scan`](crate::report::scan) reports the
//! result.

use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Config, Error, Event, Segment, Stage, Survey};
use isocat_segment::Scenario;
use isocat_sim::World;
use isocat_wire::time::{Nanos, Picos, Time};

use crate::NoTap;

/// The result of a scan.
#[derive(Clone, Debug)]
pub struct Scan {
    /// The segment; its problems list what could not be read.
    pub segment: Segment,
    /// Whether objects were read by SDO.
    pub objects: bool,
    /// Counts until the scan was complete.
    pub statistics: Statistics,
    /// Why it ended before everything was read; `None` if it was complete.
    pub failure: Option<Failure>,
    /// Why the way back to INIT failed.
    pub way_down: Option<String>,
}

/// The reason for an early end of a scan.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Failure {
    /// The MainDevice gave up.
    Gave(Error),
    /// It took longer than all its deadlines together.
    TooLong(Stage),
    /// The interface failed, or the user ended the scan.
    Ended(String),
}

impl Scan {
    /// Scans the virtual segment of a scenario. `objects` says whether to read them by SDO.
    pub fn of(scenario: &Scenario, objects: bool, progress: &mut dyn FnMut(Stage)) -> Self {
        let mut setup = scenario.run().setup;
        // A scan has one port, so it sees the ring without its last cable, as a line.
        setup.ring = None;
        setup.config = Config { hop_jitter: scenario.hop_jitter, ..config(objects) };
        Self::of_setup(setup, progress)
    }

    /// Scans any virtual segment whose MainDevice was asked for a survey.
    pub fn of_setup(setup: isocat_sim::Setup, progress: &mut dyn FnMut(Stage)) -> Self {
        let objects = setup.config.survey.is_none_or(|wish| wish.objects);
        let mut world = World::new(setup, (), None::<NoTap>);
        let limit = Time::ZERO + LIMIT;
        let failure = loop {
            if let Some(event) = world.poll_event() {
                match event {
                    Event::Progress(stage) => progress(stage),
                    Event::Surveyed => break None,
                    Event::Failed(error) => break Some(Failure::Gave(error)),
                    _ => {}
                }
            } else if !world.step(limit) {
                break Some(Failure::TooLong(world.main().stage()));
            }
        };
        let mut scan = Self {
            segment: world.main().segment().clone(),
            objects,
            statistics: world.main().statistics(),
            failure,
            way_down: None,
        };
        if !matches!(scan.failure, Some(Failure::Gave(_))) {
            world.main_mut().stop();
            let limit = world.now() + Picos::from(WAY_DOWN);
            scan.way_down = loop {
                match world.poll_event() {
                    Some(Event::Stopped) => break None,
                    Some(Event::Failed(error)) => break Some(error.to_string()),
                    Some(_) => {}
                    None if !world.step(limit) => break Some(NO_END.to_owned()),
                    None => {}
                }
            };
        }
        scan
    }
}

/// The configuration of the MainDevice. The cycle is never used.
pub fn config(objects: bool) -> Config {
    Config { survey: Some(Survey { objects }), ..Config::new(Nanos::millis(1)) }
}

/// Time limit of a scan; every step of it has a much shorter deadline.
const LIMIT: Picos = Picos(600_000_000_000_000);
/// Time limit of the way back to INIT: three steps of 5 s, and a reserve.
pub(crate) const WAY_DOWN: Nanos = Nanos::millis(20_000);
pub(crate) const NO_END: &str = "the way back to INIT did not end";

//! A scan: what a MainDevice finds out about a segment before any cycle, in virtual time or on an interface.
//!
//! The MainDevice goes as far as PREOP with converged clocks ([`Config::survey`]), everything is read, and the
//! SubDevices go back to INIT. [`report::scan`](crate::report::scan) tells what was found.

use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Config, Error, Event, Segment, Stage, Survey};
use isocat_segment::Scenario;
use isocat_sim::World;
use isocat_wire::time::{Nanos, Picos, Time};

use crate::NoTap;

/// What a scan found.
#[derive(Clone, Debug)]
pub struct Scan {
    /// What was found; what could not be read stands in its problems.
    pub segment: Segment,
    /// Whether objects were read by SDO.
    pub objects: bool,
    /// Counts until everything was known.
    pub statistics: Statistics,
    /// Why it ended before everything was asked; `None` if it came to its end.
    pub failure: Option<Failure>,
    /// What stood in the way back to INIT.
    pub way_down: Option<String>,
}

/// What ends a scan before its end.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Failure {
    /// The MainDevice gave up.
    Gave(Error),
    /// It took longer than all its deadlines together.
    TooLong(Stage),
    /// The interface failed, or somebody ended it.
    Ended(String),
}

impl Scan {
    /// Scans the virtual segment of a scenario. `objects`: read them by SDO.
    pub fn of(scenario: &Scenario, objects: bool, progress: &mut dyn FnMut(Stage)) -> Self {
        let mut setup = scenario.run().setup;
        // A scan has one port: it sees the line that the ring is without its last cable.
        setup.ring = None;
        setup.config = Config { hop_jitter: scenario.hop_jitter, ..config(objects) };
        Self::of_setup(setup, progress)
    }

    /// The same of any virtual segment whose MainDevice was asked for a survey.
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

/// What the MainDevice is asked for. The cycle is never used.
pub fn config(objects: bool) -> Config {
    Config { survey: Some(Survey { objects }), ..Config::new(Nanos::millis(1)) }
}

/// Time after which a scan is given up; every step of it has a deadline of its own, far below.
const LIMIT: Picos = Picos(600_000_000_000_000);
/// For the way back to INIT: three steps of 5 s, and room.
pub(crate) const WAY_DOWN: Nanos = Nanos::millis(20_000);
pub(crate) const NO_END: &str = "the way back to INIT did not end";

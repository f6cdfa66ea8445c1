//! One run: a segment comes up, faults happen, and two verdicts are given.

use isocat_engine::verdict::{self, Answer, Engine, Questions, Readings, Verdict};
use isocat_maindevice::{Event, Motion};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::run::intent;
use isocat_sim::{Setup, World};
use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::draw::Drawn;
use crate::held::{Mistake, hold, near_limit, no_recovery};
use crate::truth::{Truth, Witness};

pub enum Fate {
    /// The segment is invalid, or no plan fits.
    Refused,
    /// It did not reach OP.
    NotUp,
    Ran(Ran),
}

pub struct Ran {
    /// One word for each fault; empty without faults.
    pub faults: Vec<String>,
    pub lost: bool,
    pub answer: Answer,
    /// Whether it was to recover, and had the time for it.
    pub recovers: bool,
    pub wrong: Vec<(Mistake, String)>,
}

pub fn run(Drawn { text, recovers, reads }: Drawn) -> Fate {
    let Ok(file) = SegmentFile::parse("random.toml", &text) else { return Fate::Refused };
    let faults = words(&text);
    let recovers = recovers && !loads_nothing(&faults);
    let scenario = Scenario::from(file);
    if isocat_engine::plan::Plan::of(&scenario).map_or(true, |plan| !plan.fits()) {
        return Fate::Refused;
    }
    let mut setup = scenario.run().setup;
    if reads {
        setup.config = verdict::with_reads(setup.config);
    }
    let Some(world) = up(setup) else { return Fate::NotUp };
    let way_up = Nanos(world.now().as_nanos() as i64).max(Nanos(scenario.cycle.0 * WAY_BACK));
    let bound = RECOVERY + way_up + way_up;
    let mut field = Field::begin(world, scenario.sync0_limit);
    if reads {
        field.read(true);
    }
    field.operate(scenario.duration);
    if recovers {
        field.operate(bound);
        if field.is_out_of_sync() {
            // This shows whether it recovers at all.
            field.operate(PATIENCE);
        }
    }
    if reads {
        field.read(false);
    }
    let (verdict, truth) = field.end();
    let mut wrong = hold(&verdict, &truth, scenario.sync0_limit);
    if near_limit(&verdict) {
        wrong.retain(|(wrong, _)| *wrong != Mistake::FalseAlarm);
    }
    wrong.extend(no_recovery(&truth, bound).filter(|_| recovers));
    let (lost, answer) = (!truth.losses.is_empty(), verdict.answer());
    Fate::Ran(Ran { faults, lost, answer, recovers, wrong })
}

/// The words of the faults of a file.
fn words(text: &str) -> Vec<String> {
    let lines = text.lines().filter_map(|line| line.strip_prefix("what = \""));
    lines.map(|line| line.trim_end_matches('"').to_owned()).collect()
}

/// Whether a SubDevice may have been switched on while its EEPROM was dead. Its ESC has loaded
/// nothing then, and no MainDevice brings it back before it is switched off and on once more.
fn loads_nothing(faults: &[String]) -> bool {
    let about = |words: &[&str]| -> Vec<&str> {
        let parts = faults.iter().map(|fault| fault.split(' ').collect::<Vec<_>>());
        let about = parts.filter(|parts| words.contains(&parts[0]));
        about.filter_map(|parts| parts.get(1).copied()).collect()
    };
    let switched_on = about(&["power-cycle", "power-on", "replace"]);
    about(&["dead-eeprom"]).iter().any(|device| switched_on.contains(device))
}

fn up(setup: Setup) -> Option<World<Motion, Witness>> {
    let mut world = World::new(setup, Motion::default(), Some(Witness::default()));
    world.follow_course();
    loop {
        match world.poll_event() {
            Some(Event::InOperation { .. }) => return Some(world),
            Some(Event::Failed(_)) => return None,
            Some(_) => {}
            None if world.step(BRING_UP_LIMIT) => {}
            None => return None,
        }
    }
}

/// A segment in operation with both judges.
struct Field {
    world: World<Motion, Witness>,
    began: Time<True>,
    engine: Engine,
    questions: Option<Questions>,
    readings: Vec<Readings>,
}

impl Field {
    fn begin(mut world: World<Motion, Witness>, limit: Nanos) -> Self {
        world.catch_up();
        let engine = Engine::begin(world.main(), limit, Vec::new());
        world.begin_judging(intent(world.main(), limit));
        // Empty: nothing is read.
        let readings = Vec::new();
        let began = world.now();
        Self { world, began, engine, questions: None, readings }
    }

    /// Processes the next event.
    fn step(&mut self, until: Time<True>) -> bool {
        let more = self.world.step(until);
        let at = Nanos((self.world.now() - self.began).0 / 1_000);
        while let Some(event) = self.world.poll_event() {
            self.engine.event(at, &event);
            if let Some(questions) = &mut self.questions {
                questions.event(&event);
            }
        }
        self.engine.cycle(at, self.world.main());
        more
    }

    fn read(&mut self, before: bool) {
        let devices = self.world.main().segment().devices.len();
        self.readings.resize(devices, Readings::default());
        let until = self.world.now() + READ_LIMIT;
        self.questions = Some(Questions::ask(self.world.main_mut(), before));
        while !self.questions.as_ref().is_none_or(Questions::are_answered) && self.step(until) {}
        if let Some(questions) = self.questions.take() {
            questions.fill(&mut self.readings);
        }
    }

    fn operate(&mut self, duration: Nanos) {
        let end = self.world.now() + duration.into();
        while self.step(end) {}
    }

    fn is_out_of_sync(&self) -> bool {
        let course = self.world.course();
        course.is_some_and(|course| course.stretches().iter().any(|stretch| stretch.open))
    }

    fn end(mut self) -> (Verdict, Truth) {
        self.world.catch_up();
        self.world.end_judging();
        let at = Nanos((self.world.now() - self.began).0 / 1_000);
        let (main, axes) = (self.world.main(), self.world.application().axes());
        let verdict = self.engine.end(at, main, axes, &self.readings);
        (verdict, Truth::of(self.world, self.began))
    }
}

/// Limit in true time of a way up.
const BRING_UP_LIMIT: Time<True> = Time::new(60_000_000_000_000);
/// A SubDevice that waits for SYNC or inputs on its way to OP reports after 9 s why it does not get
/// there.
const PATIENCE: Nanos = Nanos::millis(15_000);
const READ_LIMIT: Picos = Picos(10_000_000_000_000);
/// Largest number of cycles for the recovery of one SubDevice besides the exchange: some 250 object
/// accesses of two cycles each.
const WAY_BACK: i64 = 600;
/// Time until a link is up again, the next attempt is made, and the longest pause of a recovery is
/// over; in addition to two ways up.
const RECOVERY: Nanos = Nanos::millis(300 + 1_000 + 200 + 500);

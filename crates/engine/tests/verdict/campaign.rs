//! One run: a segment comes up, something goes wrong, and two verdicts are given.

use isocat_engine::NoTap;
use isocat_engine::verdict::{self, Answer, Engine, Gap, Questions, Readings, Verdict};
use isocat_maindevice::{Event, Motion};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::host::{HostMachine, Stall};
use isocat_sim::oscillator::{Ramp, Step};
use isocat_sim::run::intent;
use isocat_sim::{BitError, Cable, Direction, Finding, Judged, Kind, Setup, World};
use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::before::LastLook;
use crate::draw::{Drawn, Fault, draw};
use crate::truth::{Loss, losses};

pub enum Fate {
    /// No such segment, or no plan that fits.
    Refused,
    /// It did not come to OP.
    NotUp,
    Ran(Ran),
}

pub struct Ran {
    pub fault: &'static str,
    /// In true time.
    pub losses: Vec<(usize, Loss)>,
    /// By what the wire shows.
    pub answer: Answer,
    /// Findings, and what is not known and decides.
    pub told: Vec<String>,
    /// Clocks near their limit are all that speaks against it.
    pub near_limit: bool,
    /// Why nothing on the wire can show these losses.
    pub hidden: Option<&'static str>,
    /// What the last look finds.
    pub before: Vec<&'static str>,
}

pub fn run(seed: u64) -> Fate {
    let Drawn { text, cycle, duration, fault } = draw(seed);
    let Ok(file) = SegmentFile::parse("random.toml", &text) else { return Fate::Refused };
    let mut scenario = Scenario::from(file);
    scenario.duration = duration;
    if isocat_engine::plan::Plan::of(&scenario).map_or(true, |plan| !plan.fits()) {
        return Fate::Refused;
    }
    let setup = |began: Option<Time<True>>| {
        let mut setup = scenario.run().setup;
        setup.config = verdict::with_reads(setup.config);
        if let Some(began) = began {
            change_setup(&mut setup, &fault, began);
        }
        setup
    };
    let early = matches!(
        fault,
        Fault::ClockStep { .. }
            | Fault::ClockRamp { .. }
            | Fault::HostClock { .. }
            | Fault::Stall { .. }
    );
    let Some(mut world) = up(setup(None)) else { return Fate::NotUp };
    if early {
        // Nothing changes before operation, so it begins at the same instant again.
        let began = world.now();
        world = match up(setup(Some(began))) {
            Some(world) => world,
            None => return Fate::NotUp,
        };
        assert_eq!(world.now(), began, "seed {seed}: a fault of later reaches back");
    }
    let mut field = Field::begin(world, &scenario);
    field.read(true);
    field.disturb(&fault);
    field.operate(duration, cycle, &fault);
    field.read(false);
    Fate::Ran(field.end(&fault))
}

/// What of a fault must be known before time begins.
fn change_setup(setup: &mut Setup, fault: &Fault, began: Time<True>) {
    let from = |at: Nanos| Nanos((began - Time::ZERO).0 / 1_000) + at;
    match *fault {
        Fault::ClockStep { device, at, by_ppb } => {
            let clock = &mut setup.segment[device as usize].device.clock;
            clock.step = Some(Step { by_ppb, at: from(at) });
        }
        Fault::ClockRamp { device, at, by_ppb, over } => {
            let clock = &mut setup.segment[device as usize].device.clock;
            clock.ramp = Some(Ramp { by_ppb, from: from(at), over });
        }
        Fault::HostClock { at, by_ppb } => {
            setup.host.clock_step = Some(Step { by_ppb, at: from(at) });
        }
        Fault::Stall { at, length } => setup.host.stall = Some(Stall { at: from(at), length }),
        _ => {}
    }
}

fn up(setup: Setup) -> Option<World<Motion, NoTap>> {
    let mut world = World::new(setup, Motion::default(), None);
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

/// A segment in operation with both who judge it.
struct Field {
    world: World<Motion, NoTap>,
    began: Time<True>,
    engine: Engine,
    last_look: LastLook,
    questions: Option<Questions>,
    readings: Vec<Readings>,
    limit: Nanos,
}

impl Field {
    fn begin(mut world: World<Motion, NoTap>, scenario: &Scenario) -> Self {
        let limit = scenario.sync0_limit;
        world.catch_up();
        let engine = Engine::begin(world.main(), limit, Vec::new());
        world.begin_judging(intent(world.main(), limit));
        let readings = vec![Readings::default(); world.main().segment().devices.len()];
        let (began, last_look) = (world.now(), LastLook::default());
        Self { world, began, engine, last_look, questions: None, readings, limit }
    }

    /// Lets the next thing happen.
    fn step(&mut self, until: Time<True>) -> bool {
        let more = self.world.step(until);
        let at = Nanos((self.world.now() - self.began).0 / 1_000);
        while let Some(event) = self.world.poll_event() {
            self.engine.event(at, &event);
            self.last_look.event(&event);
            if let Some(questions) = &mut self.questions {
                questions.event(&event);
            }
        }
        self.engine.cycle(at, self.world.main());
        more
    }

    fn read(&mut self, before: bool) {
        let until = self.world.now() + READ_LIMIT;
        self.questions = Some(Questions::ask(self.world.main_mut(), before));
        while !self.questions.as_ref().is_none_or(Questions::are_answered) && self.step(until) {}
        if let Some(questions) = self.questions.take() {
            questions.fill(&mut self.readings);
        }
    }

    /// Lets happen what happens to cables and power.
    fn disturb(&mut self, fault: &Fault) {
        let now = self.world.now();
        let segment = self.world.segment_mut();
        match *fault {
            Fault::Damaged { cable, at, frames, back } => {
                let direction = if back { Direction::Back } else { Direction::Out };
                for bit in 0..frames as usize {
                    let at = now + at.into();
                    segment.disturb(BitError {
                        cable: cable as usize,
                        direction,
                        at,
                        bit: 200 + bit,
                    });
                }
            }
            Fault::Cut { cable, at, length } => {
                segment.unplug(cable as usize, now + at.into());
                segment.plug(cable as usize, now + (at + length).into());
            }
            Fault::Power { device, at, length } => {
                segment.power_off(device as usize, now + at.into());
                segment.power_on(device as usize, now + (at + length).into());
            }
            _ => {}
        }
    }

    fn operate(&mut self, duration: Nanos, cycle: Nanos, fault: &Fault) {
        let begin = self.world.now();
        let end = begin + duration.into();
        let after = |at: Nanos| begin + at.into();
        let (mut done, mut held) = (0, 0);
        let mut sleeper = Oversleep::default();
        loop {
            let number = self.world.main().statistics().cycles;
            let now = self.world.now();
            match *fault {
                Fault::Late { at, by, times, every }
                    if now >= after(at)
                        && done < times
                        && number >= held + every
                        && sleeper.arm(self.world.host_mut(), number, by) =>
                {
                    (done, held) = (done + 1, number);
                }
                Fault::Exchanged { cable, at, metres }
                    if now >= after(at)
                        && done == 0
                        && self.world.main().frames_in_flight() == 0 =>
                {
                    done = 1;
                    let cable = cable as usize;
                    self.world.segment_mut().replace_cable(cable, Cable::of_length(metres * 1_000));
                }
                _ => {}
            }
            // Often enough that what is to be done at an instant is done there.
            let until = end.min(now + Picos::from(cycle));
            if !self.step(until) && until >= end {
                break;
            }
        }
    }

    fn end(mut self, fault: &Fault) -> Ran {
        self.world.catch_up();
        self.world.end_judging();
        let losses = losses(&self.world, self.began);
        let at = Nanos((self.world.now() - self.began).0 / 1_000);
        let skipped = self.engine.cycles_skipped();
        let (main, axes) = (self.world.main(), self.world.application().axes());
        let verdict = self.engine.end(at, main, axes, &self.readings);
        let findings = verdict
            .findings
            .iter()
            .map(|found| format!("{:?} {:?}", found.place.device, found.kind));
        let open = verdict.unknown.iter().filter(|unknown| unknown.kind.decides());
        let told =
            findings.chain(open.map(|open| format!("{:?} {:?}", open.place.device, open.kind)));
        Ran {
            fault: fault.name(),
            hidden: hidden(fault, &losses),
            losses,
            near_limit: near_limit(&verdict),
            answer: verdict.answer(),
            told: told.collect(),
            before: self.last_look.end(main, &self.readings, self.limit, skipped),
        }
    }
}

/// Whether clocks near their limit, on this side of it or just beyond, are all that speaks against a segment.
fn near_limit(verdict: &Verdict) -> bool {
    let near = |finding: &Finding| match finding.kind {
        Kind::Judged(Judged::ClockOff { difference, limit }) => difference.abs().0 < 2 * limit.0,
        _ => false,
    };
    let mut open = verdict.unknown.iter().filter(|open| open.kind.decides());
    verdict.findings.iter().all(near)
        && open.all(|open| matches!(open.kind, Gap::ClockNearLimit { .. }))
}

/// Makes the host sleep too long once. A timer is set anew with each frame that comes back, so it is told until the cycle
/// after the next has begun.
#[derive(Default)]
struct Oversleep {
    until: Option<u64>,
}

impl Oversleep {
    /// Whether it is over.
    fn arm(&mut self, host: &mut HostMachine, number: u64, by: Nanos) -> bool {
        let until = *self.until.get_or_insert(number + 2);
        let over = number >= until;
        host.oversleep(if over { Nanos::ZERO } else { by });
        if over {
            self.until = None;
        }
        over
    }
}

/// Why nothing on a wire can show any of these.
fn hidden(fault: &Fault, losses: &[(usize, Loss)]) -> Option<&'static str> {
    if losses.iter().all(|(_, loss)| *loss == Loss::OutputsUneven) {
        return Some("loss: at the pins alone");
    }
    // It does other things than it states, and its counter may have gone down again.
    matches!(fault, Fault::Misbehaves(_)).then_some("loss: by the device itself, between readings")
}

/// True time after which a way up that has not ended is given up.
const BRING_UP_LIMIT: Time<True> = Time::new(60_000_000_000_000);
const READ_LIMIT: Picos = Picos(10_000_000_000_000);

//! The main job in one call: brings a segment into synchronization, runs it and judges it.

use isocat_maindevice::motion::{Axis, Drive};
use isocat_maindevice::quality::Change;
use isocat_maindevice::written::{Output, Written};
use isocat_maindevice::{DeviceConfig, Event, MainDevice, Motion, RequestId, SegmentChange, Stage};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatus, ObjectAddress};

use crate::bench::{Bench, Intent};
use crate::expect::{Evidence, Expectation, Judgement};
use crate::finding::{Finding, Judged, Kind, Place};
use crate::judge::{Grid, Sync0Error};
use crate::plant::PlantSetup;
use crate::plant_bench::PlantBench;
use crate::silence::{Silence, Silences};
use crate::world::{Setup, Tap, World};

/// A run: its parts and its duration.
pub struct Run {
    /// Devices, host, intent, seed.
    pub setup: Setup,
    /// The judged time, from the instant at which all SubDevices are in OP.
    pub duration: Nanos,
    /// Largest SYNC0 error with which a SubDevice counts as synchronized.
    pub sync0_limit: Nanos,
    /// Outputs that the MainDevice's application writes on a timeline.
    pub outputs: Vec<Output>,
    /// The plants behind SubDevices, at most one for each SubDevice.
    pub plants: Vec<PlantSetup>,
    /// Its expectations.
    pub expectations: Vec<Expectation>,
    /// Whether the run records when each SubDevice is in sync ([`World::course`]). With
    /// expectations or faults it always does.
    pub follow_course: bool,
}

/// The progress of a run.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Progress {
    /// A stage of the bring-up begins.
    Stage(Stage),
    /// This part of the judged time has passed.
    Judged(Nanos),
}

/// Counters of 0x1C32 or 0x1C33, read over the wire at the end of the run; `None`: the SubDevice
/// does not have it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// Sub-index 0B.
    pub sm_event_missed: Option<u32>,
    /// Sub-index 0C.
    pub cycle_time_too_small: Option<u32>,
    /// Sub-index 0D.
    pub shift_time_too_short: Option<u32>,
    /// Sub-index 20.
    pub sync_error: Option<u32>,
}

/// Result of a run.
pub struct Outcome<T> {
    /// The run after the judged time: MainDevice, SubDevices.
    pub world: World<Motion, T>,
    /// The judges at the end of the judged time.
    pub bench: Bench,
    /// Start of the judged time in true time; `None` if it never began.
    pub began: Option<Time<True>>,
    /// End of the judged time in true time.
    pub ended: Option<Time<True>>,
    /// Counters of 0x1C32, by position.
    pub output_counters: Vec<Counters>,
    /// Counters of 0x1C33, by position.
    pub input_counters: Vec<Counters>,
    /// Alarms of readings in the background that came or ended in the judged time, with their time
    /// in it; empty without [`Config::quality`](isocat_maindevice::Config::quality).
    pub alarms: Vec<(Nanos, Change)>,
    /// The effect of lateness on the plants; `None` without plants, and without a reference clock.
    pub plants: Option<PlantBench>,
    /// The results of the expectations.
    pub judgements: Vec<Judgement>,
    /// The reasons why the segment is not in sync; empty if it is.
    pub findings: Vec<Finding>,
    /// The error that ended the bring-up, if it failed.
    pub failure: Option<isocat_maindevice::Error>,
    /// By position: whether it may be absent.
    pub optional: Vec<bool>,
    /// SubDevices that may be absent and came or were lost.
    pub visits: Vec<Finding>,
    /// By position: whether it has come and is being re-admitted.
    pub joining: Vec<bool>,
}

impl<T> Outcome<T> {
    /// Whether every SubDevice ran as configured.
    pub fn in_sync(&self) -> bool {
        self.failure.is_none() && self.findings.is_empty()
    }

    /// Whether every expectation was met; without expectations, whether the run was in sync.
    pub fn as_expected(&self) -> bool {
        match &self.judgements[..] {
            [] => self.in_sync(),
            all => all.iter().all(|judgement| judgement.met),
        }
    }
}

/// Virtual time after which an endless bring-up is given up. Every step of it has a separate
/// timeout that is far shorter.
const BRING_UP_LIMIT: Picos = Picos(300_000_000_000_000);
/// Virtual time for reading the counters at the end.
const READ_LIMIT: Picos = Picos(10_000_000_000_000);
/// Time between reports of the progress.
const PROGRESS: Picos = Picos(100_000_000_000);

impl Run {
    /// Runs and judges everything. `tap` sees every frame, `progress` is called from time to time.
    pub fn execute<T: Tap>(self, tap: Option<T>, progress: &mut dyn FnMut(Progress)) -> Outcome<T> {
        let devices = self.setup.segment.len();
        let wishes = self.setup.config.devices.iter();
        let optional: Vec<bool> = wishes.map(DeviceConfig::may_be_absent).collect();
        let follows =
            self.follow_course || !self.expectations.is_empty() || !self.setup.faults.is_empty();
        let mut world = World::new(self.setup, Motion::default(), tap);
        if !self.outputs.is_empty() {
            let origin = world.host().now(Time::ZERO);
            *world.application_mut() = Motion::writing(Written::new(self.outputs, origin));
        }
        for plant in &self.plants {
            world.segment_mut().attach(*plant);
        }
        if follows {
            world.follow_course();
        }
        let mut outcome = match bring_up(&mut world, progress) {
            Err(failure) => {
                let mut outcome = Outcome::new(world, devices, failure);
                outcome.take_counters();
                outcome
            }
            Ok(()) => {
                let began = world.now();
                world.catch_up();
                world.begin_judging(intent(world.main(), self.sync0_limit));
                let mut plants = plant_bench(&mut world, &self.plants);
                let mut notes = Notes::default();
                run_for(&mut world, self.duration.into(), &mut notes, &mut plants, progress);
                let ended = world.now();
                let bench = world.end_judging();
                let mut outcome = Outcome::new(world, devices, None);
                outcome.began = Some(began);
                outcome.ended = Some(ended);
                outcome.optional = optional;
                outcome.bench = bench;
                outcome.plants = plants;
                let since =
                    |(at, change): &(Time<True>, Change)| (Nanos((*at - began).0 / 1000), *change);
                outcome.alarms = notes.alarms.iter().map(since).collect();
                outcome.read_counters(&mut notes);
                outcome.judge(&notes);
                outcome
            }
        };
        outcome.hold_against(&self.expectations);
        outcome
    }
}

/// A finding and its time, to the picosecond, so that findings can be sorted in the order of
/// events.
#[derive(Clone, Debug)]
struct Dated {
    device: Option<usize>,
    /// `None`: it has no time.
    at: Option<Time<True>>,
    kind: Kind,
}

impl Dated {
    /// The finding in a run whose judged time began at `began`.
    fn since(self, began: Time<True>) -> Finding {
        let since = self.at.map(|at| Nanos((at - began).0 / 1000));
        Finding { place: Place { device: self.device, stage: None }, since, kind: self.kind }
    }
}

/// Events of the MainDevice during the judged time.
#[derive(Default)]
struct Notes {
    working_counter: u64,
    skipped: u64,
    /// Frames that were given up in the judged time, and those that had come late before it.
    missed: u64,
    /// The longest time in which frames left and none came back.
    silence: Option<Silence>,
    late_before: u64,
    slow_before: u64,
    /// Changes of the segment.
    changes: Vec<Dated>,
    /// SubDevices that were lost or admitted.
    moves: Vec<Dated>,
    /// SubDevices that were found.
    found: Vec<Dated>,
    /// SubDevices that have come and are being re-admitted.
    joining: Vec<usize>,
    alarms: Vec<(Time<True>, Change)>,
    answers: Vec<(RequestId, Option<u32>)>,
}

fn bring_up<T: Tap>(
    world: &mut World<Motion, T>,
    progress: &mut dyn FnMut(Progress),
) -> Result<(), Option<isocat_maindevice::Error>> {
    let limit = Time::ZERO + BRING_UP_LIMIT;
    loop {
        let more = world.step(limit);
        while let Some(event) = world.poll_event() {
            match event {
                Event::Progress(stage) => progress(Progress::Stage(stage)),
                Event::InOperation { .. } => return Ok(()),
                Event::Failed(error) => return Err(Some(error)),
                _ => {}
            }
        }
        if !more {
            return Err(None);
        }
    }
}

/// The intent that judges need for a segment in operation; `limit` is the largest SYNC0 error
/// allowed.
pub fn intent(main: &MainDevice, limit: Nanos) -> Intent {
    let segment = main.segment();
    let timing = segment.timing.as_ref();
    let cycle = timing.map_or(Nanos(1_000_000), |timing| timing.cycle.cycle);
    let limits = timing.map(|timing| timing.cycle.limits).unwrap_or_default();
    let send = timing.map_or(Nanos::ZERO, |timing| timing.cycle.send);
    let devices =
        || timing.into_iter().flat_map(|t| t.devices.iter().map(move |d| (t.sync0, &d.0)));
    let sync0 = |(shift, device): (Option<Nanos>, &isocat_sync::budget::Device)| {
        let phase = device.sync0_phase(shift.filter(|_| device.mode.uses_dc())?);
        Some(Grid { cycle: device.pulses.sync0_cycle, phase })
    };
    let acting = |(shift, device): (Option<Nanos>, &isocat_sync::budget::Device)| {
        let phase = shift.filter(|_| device.mode.uses_dc())?;
        Some(Grid { cycle, phase })
    };
    let exchange = |(_, device): (Option<Nanos>, &isocat_sync::budget::Device)| {
        Some(Grid { cycle: Nanos(cycle.0 * i64::from(device.every.max(1))), phase: send })
    };
    Intent {
        exchange: devices().map(exchange).collect(),
        inputs_shifted: devices().map(|(_, device)| device.input_shift > Nanos::ZERO).collect(),
        reference: segment.reference.unwrap_or(0),
        send: Grid { cycle, phase: send },
        sync0: devices().map(sync0).collect(),
        acting: devices().map(acting).collect(),
        sync0_limit: limit.into(),
        outputs_spread: limits.outputs_spread.into(),
    }
}

/// The judges of the plants, if there are plants and a reference clock: without one there is no
/// grid to compare with.
fn plant_bench<T: Tap>(world: &mut World<Motion, T>, setups: &[PlantSetup]) -> Option<PlantBench> {
    let intent = world.bench.intent()?.clone();
    world.main().segment().reference.filter(|_| !setups.is_empty())?;
    let (grid, due) = (world.main().next_grid()?, world.main().next_cycle()?);
    let begin = (grid, world.host().when(due));
    let segment = world.segment_mut();
    // Actions during bring-up are not judged.
    for setup in setups {
        segment.take_acted(setup.device).for_each(drop);
    }
    Some(PlantBench::new(setups, intent, begin, segment))
}

fn run_for<T: Tap>(
    world: &mut World<Motion, T>,
    duration: Picos,
    notes: &mut Notes,
    plants: &mut Option<PlantBench>,
    progress: &mut dyn FnMut(Progress),
) {
    let began = world.now();
    let end = began + duration;
    let before = world.main().statistics();
    let mut told = began;
    let mut silences = Silences::default();
    while world.step(end) {
        take_events(world, notes);
        silences.look(world.now(), world.main().counts());
        if let Some(plants) = plants {
            let leader = world.bench.leader();
            let (segment, motion) = world.segment_and_application();
            plants.follow(segment, leader, motion.written());
        }
        if world.now() - told >= PROGRESS {
            told = world.now();
            progress(Progress::Judged(Nanos((told - began).0 / 1000)));
        }
    }
    take_events(world, notes);
    if let Some(plants) = plants {
        let leader = world.bench.leader();
        let (segment, motion) = world.segment_and_application();
        plants.finish(segment, leader, motion.written(), end);
    }
    notes.missed = world.main().statistics().frames_missed() - before.frames_missed();
    notes.late_before = before.frames_late;
    notes.slow_before = before.frames_slow;
    notes.silence = silences.longest(world.now(), world.main().counts());
}

fn take_events<T: Tap>(world: &mut World<Motion, T>, notes: &mut Notes) {
    while let Some(event) = world.poll_event() {
        if let Some((device, change)) = SegmentChange::of(&event) {
            let list = if change.is_move() { &mut notes.moves } else { &mut notes.changes };
            list.push(Dated { device, at: Some(world.now()), kind: change.into() });
        }
        match &event {
            // It is noted once, even after several attempts.
            Event::Found { position, cycle } if !notes.joining.contains(position) => {
                notes.found.push(Dated {
                    device: Some(*position),
                    at: Some(world.now()),
                    kind: Judged::Found { cycle: *cycle }.into(),
                });
                notes.joining.push(*position);
            }
            Event::Lost { position, .. } | Event::Readmitted { position, .. } => {
                notes.joining.retain(|joining| joining != position);
            }
            _ => {}
        }
        match event {
            Event::WorkingCounter { .. } => notes.working_counter += 1,
            Event::CyclesSkipped { skipped, .. } => notes.skipped += skipped,
            Event::Alarm(change) => notes.alarms.push((world.now(), change)),
            Event::Uploaded { request, result } => {
                let number = result.ok().map(|bytes| {
                    bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
                });
                notes.answers.push((request, number));
            }
            _ => {}
        }
    }
}

const COUNTERS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];

impl<T: Tap> Outcome<T> {
    fn new(
        world: World<Motion, T>,
        devices: usize,
        failure: impl Into<Option<isocat_maindevice::Error>>,
    ) -> Self {
        let failure = failure.into();
        Self {
            bench: world.bench.clone(),
            world,
            began: None,
            ended: None,
            output_counters: vec![Counters::default(); devices],
            input_counters: vec![Counters::default(); devices],
            alarms: Vec::new(),
            plants: None,
            judgements: Vec::new(),
            findings: Vec::new(),
            failure,
            optional: Vec::new(),
            visits: Vec::new(),
            joining: vec![false; devices],
        }
    }

    /// Takes the counters as the MainDevice last read them, after a failed bring-up.
    fn take_counters(&mut self) {
        for (position, device) in self.world.main().segment().devices.iter().enumerate() {
            for (object, counters) in [
                (&device.output_sync, self.output_counters.get_mut(position)),
                (&device.input_sync, self.input_counters.get_mut(position)),
            ] {
                let (Some(object), Some(counters)) = (object, counters) else { continue };
                for sub in COUNTERS {
                    *counters.field(sub) = object.entry(sub).and_then(|entry| entry.number());
                }
            }
        }
    }

    /// Reads the counters over the wire while process data continue.
    fn read_counters(&mut self, notes: &mut Notes) {
        let mut asked = Vec::new();
        for position in 0..self.output_counters.len() {
            for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
                let device = &self.world.main().segment().devices[position];
                let object = if index == OUTPUT_PARAMETER {
                    &device.output_sync
                } else {
                    &device.input_sync
                };
                let present = |sub: &u8| object.as_ref().is_some_and(|o| o.entry(*sub).is_some());
                let subs: Vec<u8> = COUNTERS.into_iter().filter(present).collect();
                for sub in subs {
                    let object = ObjectAddress::new(index, sub);
                    asked.push((position, object, self.world.main_mut().upload(position, object)));
                }
            }
        }
        let limit = self.world.now() + READ_LIMIT;
        while notes.answers.len() < asked.len() && self.world.step(limit) {
            take_events(&mut self.world, notes);
        }
        for (position, object, request) in asked {
            let answer = notes.answers.iter().find(|(id, _)| *id == request);
            let Some((_, value)) = answer else { continue };
            let counters = if object.index == OUTPUT_PARAMETER {
                &mut self.output_counters[position]
            } else {
                &mut self.input_counters[position]
            };
            *counters.field(object.sub) = *value;
        }
    }

    fn judge(&mut self, notes: &Notes) {
        let Some(began) = self.began else { return };
        let mut findings = Vec::new();
        for position in 0..self.bench.devices().len() {
            let of_device = |(at, kind): (_, Judged)| {
                let device = Some(position);
                Dated { device, at, kind: kind.into() }
            };
            findings.extend(self.judge_device(position, began).into_iter().map(of_device));
        }
        let of_optional = |dated: &Dated| dated.device.is_some_and(|at| self.is_optional(at));
        let found = notes.found.iter().filter(|dated| of_optional(dated)).cloned();
        let moves = notes.moves.iter().cloned();
        let (mut visits, others): (Vec<_>, Vec<_>) = found.chain(moves).partition(of_optional);
        findings.extend(others);
        visits.sort_by_cached_key(|visit| visit.at.unwrap_or(Time::ZERO).count());
        self.visits = visits.into_iter().map(|visit| visit.since(began)).collect();
        for position in &notes.joining {
            self.joining[*position] = true;
        }
        for (position, device) in self.world.main().segment().devices.iter().enumerate() {
            let quiet = |visit: &Finding| visit.place.device != Some(position);
            if !device.admitted && self.is_optional(position) && self.visits.iter().all(quiet) {
                let (place, kind) = (Place::device(position), Judged::AlwaysAbsent.into());
                self.visits.push(Finding { place, since: None, kind });
            }
        }
        findings.extend(notes.changes.iter().cloned());
        let statistics = self.world.main().statistics();
        let datagrams = statistics.working_counter_errors;
        // Some come when the counters are read, behind the judged time.
        let late = (statistics.frames_late - notes.late_before).min(notes.missed);
        let silent = notes.silence.map_or(0, |silence| silence.frames);
        let lost = (notes.missed - late).saturating_sub(silent);
        let late = late + (statistics.frames_slow - notes.slow_before);
        let silence = notes.silence.map(|silence| Dated {
            device: None,
            at: Some(silence.since),
            kind: Judged::NothingCameBack {
                lasted: Nanos(silence.lasted.0 / 1_000_000 * 1000),
                frames: silence.frames,
            }
            .into(),
        });
        let of_segment = [
            (notes.working_counter > 0).then_some(Judged::WorkingCounter { datagrams }),
            (notes.skipped > 0).then_some(Judged::CyclesSkipped { cycles: notes.skipped }),
            (lost > 0).then_some(Judged::FramesLost { frames: lost }),
            (late > 0).then_some(Judged::AnswersLate { frames: late }),
        ];
        findings.extend(of_segment.into_iter().flatten().map(|kind| Dated {
            device: None,
            at: None,
            kind: kind.into(),
        }));
        findings.splice(..0, silence);
        // The first findings are nearest to the cause; findings without a time come last. What came
        // of a silence comes behind it, ordered by position: in it, who was hit first says nothing
        // about the cause.
        findings.sort_by_cached_key(|dated| {
            let at = dated.at.unwrap_or(Time::NEVER);
            let silence = notes.silence.filter(|silence| silence.contains(at));
            silence.map_or(at, |silence| silence.since).count()
        });
        self.findings = findings.into_iter().map(|dated| dated.since(began)).collect();
    }

    /// Judges the expectations.
    fn hold_against(&mut self, expectations: &[Expectation]) {
        let timeline = self.world.timeline();
        let ended = self.ended.unwrap_or(self.world.now());
        let (happened, later): (Vec<_>, Vec<_>) =
            timeline.happened().partition(|happened| happened.at <= ended);
        let evidence = Evidence {
            course: self.world.course(),
            plants: self.plants.as_ref(),
            end: ended,
            findings: &self.findings,
            happened,
            is_to_come: timeline.is_to_come() || later.iter().any(|happened| happened.begins),
        };
        let judge = |expectation: &Expectation| expectation.judge(&evidence);
        self.judgements = expectations.iter().map(judge).collect();
    }

    fn is_optional(&self, position: usize) -> bool {
        self.optional.get(position).copied().unwrap_or(false)
    }

    /// The findings about one SubDevice, and their times.
    fn judge_device(
        &self,
        position: usize,
        began: Time<True>,
    ) -> Vec<(Option<Time<True>>, Judged)> {
        let mut findings = Vec::new();
        let bench = &self.bench.devices()[position];
        let devices = &self.world.main().segment().devices;
        let left_out = devices[position].left_out.is_some();
        let absent = (self.is_optional(position) || left_out) && !devices[position].admitted;
        // A SubDevice that may be absent can leave OP for a while without a fault.
        let mut states = bench.states.iter();
        let left = match self.is_optional(position) {
            false => states.find(|change| change.at > began),
            true => states.next_back().filter(|last| !absent && last.state != AlState::Op),
        };
        if let Some(change) = left {
            let (state, code) = (AlStatus::new(change.state), change.code);
            findings.push((Some(change.at), Judged::LeftOp { state, code }));
        }
        let esc = &self.world.segment().devices()[position].esc;
        let lost = Judged::sync_still_active(&bench.lost_pulses, esc);
        findings.extend(lost.map(|(at, kind)| (Some(at), kind)));
        let known = &devices[position];
        let not_asked = known.mode_not_asked.filter(|_| known.admitted);
        findings.extend(not_asked.map(|object| (None, Judged::ModeNotAsked { object })));
        if let Some(first) = bench.missed.first() {
            let outputs = self.world.segment().devices()[position].stack.sync().has_outputs();
            let count = bench.missed.count();
            findings.push((Some(first), Judged::MissedEvents { count, outputs }));
        }
        let judged = |sync0: &&Sync0Error| !absent || sync0.statistics().count() > 0;
        if let Some(sync0) = bench.sync0.as_ref().filter(judged) {
            findings.extend(self.judge_sync0(position, sync0));
        }
        if let Some(at) = bench.outputs_delay.first_beyond() {
            let (spread, limit) = (bench.outputs_delay.spread(), bench.outputs_delay.limit());
            findings.push((Some(at), Judged::OutputsUneven { spread, limit }));
        }
        let device = &self.world.segment().devices()[position];
        let samples = device.sampling().map_or(0, |sampling| sampling.samples);
        let late = [
            Judged::outputs_late(bench.outputs_cycle.late()),
            Judged::inputs_late(bench.inputs_cycle.late()),
            Judged::samples_incomplete(&bench.output_samples, true, samples),
            Judged::samples_incomplete(&bench.input_samples, false, samples),
        ];
        findings.extend(late.into_iter().flatten().map(|(at, kind)| (Some(at), kind)));
        for (index, counters) in [
            (OUTPUT_PARAMETER, &self.output_counters[position]),
            (INPUT_PARAMETER, &self.input_counters[position]),
        ] {
            if let Some(complaint) = counters.complaint(index) {
                findings.push((None, complaint));
                // The inputs' object has the same counters as the outputs'.
                break;
            }
        }
        let long_enough = self.world.main().statistics().cycles >= SWITCH_ON_CYCLES;
        match self.world.application().axes().get(position) {
            Some(Axis::Drive(Drive { enabled_cycles: 0, .. })) if long_enough && !absent => {
                findings.push((None, Judged::DriveNotEnabled));
            }
            _ => {}
        }
        findings
    }

    fn judge_sync0(
        &self,
        position: usize,
        judge: &Sync0Error,
    ) -> Option<(Option<Time<True>>, Judged)> {
        let devices = self.world.segment().devices();
        let reference = self.world.main().segment().reference.map(|at| devices[at].oscillator());
        if let Some((at, error)) = judge.first_beyond() {
            let (limit, worst) = (judge.limit(), Picos(judge.statistics().worst() as i64));
            return Some((Some(at), Judged::Sync0OffGrid { error, limit, worst }));
        }
        if judge.statistics().count() == 0 {
            return Some((None, Judged::NoSync0));
        }
        let steered = reference.is_some_and(|clock| clock != devices[position].oscillator());
        let too_good = steered && !judge.is_plausible();
        too_good.then_some((None, Judged::Sync0WithoutSpread))
    }
}

/// Number of cycles within which a drive must have switched on.
const SWITCH_ON_CYCLES: u64 = 100;

impl Counters {
    /// A finding from the SubDevice's own counters, if its missed events do not already show it.
    fn complaint(&self, index: u16) -> Option<Judged> {
        let counted = |value: Option<u32>| value.filter(|count| *count > 0);
        let object = |sub| ObjectAddress::new(index, sub);
        let grew = None;
        if let Some(value) = counted(self.cycle_time_too_small) {
            let object = object(sub::CYCLE_TIME_TOO_SMALL);
            return Some(Judged::CycleTimeTooSmall { object, grew, value });
        }
        if let Some(value) = counted(self.shift_time_too_short) {
            let object = object(sub::SHIFT_TIME_TOO_SHORT);
            return Some(Judged::ShiftTimeTooShort { object, grew, value });
        }
        let object = object(sub::SYNC_ERROR);
        counted(self.sync_error).map(|value| Judged::SyncError { object, grew, value })
    }

    fn field(&mut self, sub: u8) -> &mut Option<u32> {
        match sub {
            sub::SM_EVENT_MISSED => &mut self.sm_event_missed,
            sub::CYCLE_TIME_TOO_SMALL => &mut self.cycle_time_too_small,
            sub::SHIFT_TIME_TOO_SHORT => &mut self.shift_time_too_short,
            _ => &mut self.sync_error,
        }
    }
}

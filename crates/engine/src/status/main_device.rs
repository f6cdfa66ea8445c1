//! Makes a status from the knowledge of a MainDevice.
//!
//! [`Scribe::event`] takes each event, [`Scribe::cycle`] the readings of each cycle, and
//! [`Scribe::publish`] fills the board about ten times a second. The loop that keeps the cycle
//! calls all of them, so they allocate only for texts. These are rare: the segment has changed.

use std::collections::VecDeque;

use isocat_maindevice::quality::{Alarm, Change, EntryQuality, Snapshot};
use isocat_maindevice::{Config, DeviceConfig, Event, MainDevice, SegmentChange, Stage};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::phase;
use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::time::{Host, Nanos, Time};

use super::board::{Board, MOST_NOTES, Sheet};
use super::names::servo_name;
use super::{Counter, Device, Error, Margin, Moment, Status, Words};

/// Fills a board from a MainDevice.
pub struct Scribe {
    board: Board,
    names: Vec<String>,
    /// Whether it may be absent, by position.
    optional: Vec<bool>,
    /// Time of the last filling of the board, and of the next one.
    filled_ns: i64,
    due_ns: i64,
    began_ns: Option<i64>,
    /// Readings of each clock, by position.
    marks: Vec<Mark>,
    locks_lost: u64,
    /// The stage of the way up.
    stage: Stage,
    /// States on the way up, by position, while the segment is not completely known.
    states: Vec<(AlStatus, AlStatusCode)>,
    /// The last cycle whose readings were taken.
    cycle: u64,
    skip_told_ns: Option<i64>,
    notes: VecDeque<(i64, Note)>,
    dropped: u64,
}

/// Readings of one clock in operation.
#[derive(Clone, Copy, Default)]
struct Mark {
    at: Option<Time<Host>>,
    now: i64,
    recent: Option<i64>,
    worst: i64,
    count: u64,
}

/// Time from one filling of the board to the next.
pub const EVERY: Nanos = Nanos::millis(100);
/// Host time between two notes of skipped cycles.
const SKIPS_APART: i64 = 1_000_000_000;
/// Least number of cycles without a drift frame that is reported.
const UNLED: u64 = 100;

impl Scribe {
    /// Fills this board for a MainDevice with this configuration.
    pub fn new(board: Board, config: &Config) -> Self {
        Self {
            board,
            names: config.devices.iter().map(|device| device.name.clone()).collect(),
            optional: config.devices.iter().map(DeviceConfig::may_be_absent).collect(),
            filled_ns: 0,
            due_ns: 0,
            began_ns: None,
            marks: Vec::new(),
            locks_lost: 0,
            stage: Stage::Scan,
            states: Vec::new(),
            cycle: 0,
            skip_told_ns: None,
            notes: VecDeque::with_capacity(MOST_NOTES),
            dropped: 0,
        }
    }

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Takes an event.
    pub fn event(&mut self, at_ns: i64, event: &Event) {
        match event {
            Event::Progress(stage) => self.stage = *stage,
            Event::StateChanged { position, status, code, .. } => {
                if self.states.len() <= *position {
                    self.states.resize(
                        position + 1,
                        (AlStatus::new(AlState::Init), AlStatusCode::NO_ERROR),
                    );
                }
                self.states[*position] = (*status, *code);
            }
            Event::InOperation { .. } => self.began_ns = Some(at_ns),
            Event::Phase { state, .. }
                if *state != phase::State::Locked && self.began_ns.is_some() =>
            {
                self.locks_lost += 1;
            }
            Event::CyclesSkipped { .. } => {
                if self.skip_told_ns.is_some_and(|told| at_ns - told < SKIPS_APART) {
                    return;
                }
                self.skip_told_ns = Some(at_ns);
            }
            _ => {}
        }
        let Some(note) = Note::of(event, self.began_ns.is_some()) else { return };
        if self.notes.len() >= MOST_NOTES {
            self.notes.pop_front();
            self.dropped += 1;
        }
        self.notes.push_back((at_ns, note));
    }

    /// Takes the readings since the last cycle. It is cheap enough to be called in each cycle.
    pub fn cycle(&mut self, main: &MainDevice) {
        let cycle = main.statistics().cycles;
        if cycle == std::mem::replace(&mut self.cycle, cycle) || self.began_ns.is_none() {
            return;
        }
        for clock in main.quality() {
            let (Some(mark), Some(reading)) = (self.marks.get_mut(clock.position), clock.last())
            else {
                continue;
            };
            if mark.at != Some(reading.at) {
                mark.at = Some(reading.at);
                mark.take(reading.difference.0);
            }
        }
    }

    /// Whether the board is due to be filled.
    pub fn is_due(&self, at_ns: i64) -> bool {
        at_ns >= self.due_ns
    }

    /// Fills the board; if a reader holds it, the next cycle does it. `over` adds better figures
    /// from elsewhere, and gets whether the last status was taken.
    pub fn publish(
        &mut self,
        at_ns: i64,
        main: &MainDevice,
        over: impl FnOnce(&mut Status, bool),
    ) -> bool {
        let board = self.board.clone();
        board.fill(|sheet| {
            let taken = sheet.taken;
            self.fill(sheet, at_ns, main);
            over(&mut sheet.status, taken);
            self.filled_ns = at_ns;
            self.due_ns = at_ns + EVERY.0;
        })
    }

    fn fill(&mut self, sheet: &mut Sheet, at_ns: i64, main: &MainDevice) {
        for (at, note) in self.notes.drain(..) {
            sheet.note(at, note);
        }
        sheet.dropped += std::mem::take(&mut self.dropped);
        let (taken, status) = (sheet.taken, &mut sheet.status);
        if taken {
            status.since_ns = self.filled_ns;
        }
        let operating = main.is_operating() && self.began_ns.is_some();
        status.stage =
            if operating { super::Stage::InOperation } else { super::Stage::Up(self.stage) };
        status.at_ns = at_ns;
        status.operation_ns = self.began_ns.map(|began| at_ns - began);
        self.fill_host(status, main);
        self.fill_devices(status, taken, main, operating);
    }

    fn fill_host(&self, status: &mut Status, main: &MainDevice) {
        let counts = main.statistics();
        let snapshot = main.snapshot();
        let host = &mut status.host;
        let latest = snapshot.and_then(|snapshot| snapshot.moments().next_back()?.latest);
        host.phase_error_ns = latest.map(|latest| latest.0 as f64);
        let phase = counts.phase_error;
        let worst = phase.min.0.abs().max(phase.max.0.abs());
        host.phase_error_worst_ns = (phase.count > 0).then_some(worst as f64);
        host.servo = main.phase();
        host.rate_ppm = main.rate_ppb().map(|ppb| ppb as f64 / 1e3);
        host.cycles = counts.cycles;
        host.frames_sent = counts.frames_sent;
        // Frames that are only late may still come.
        host.frames_lost = counts.frames_missed();
        host.working_counter_errors = counts.working_counter_errors;
        host.cycles_skipped = counts.cycles_skipped;
        host.locks_lost = self.locks_lost;
        host.unled_cycles = snapshot.and_then(|s| s.unled).filter(|cycles| *cycles >= UNLED);
    }

    fn fill_devices(
        &mut self,
        status: &mut Status,
        taken: bool,
        main: &MainDevice,
        operating: bool,
    ) {
        let segment = main.segment();
        let count = match segment.devices.len() {
            // On the way up the segment is not reported before it is completely known.
            0 => self.states.len().max(self.names.len()),
            count => count,
        };
        if status.devices.len() != count {
            let name = |position: usize| self.names.get(position).cloned().unwrap_or_default();
            status.devices = (0..count).map(|at| Device::new(at, name(at))).collect();
            self.marks = vec![Mark::default(); count];
        }
        for (device, (al_status, code)) in status.devices.iter_mut().zip(&self.states) {
            device.al_state = al_status.state().ok();
            device.al_error = al_status.error();
            device.al_code = code.0;
        }
        let snapshot = main.snapshot();
        for (device, found) in status.devices.iter_mut().zip(&segment.devices) {
            if device.name.is_empty() && !found.name.is_empty() {
                device.name.clone_from(&found.name);
            }
            device.mode = found.mode.name().into();
            device.has_sync = found.mode.uses_dc();
            device.is_reference = segment.reference == Some(found.position);
            device.asked =
                found.admitted || !self.optional.get(found.position).is_some_and(|may| *may);
            // On the way up the segment has the states before the last step; the events have those
            // of now.
            if operating || found.position >= self.states.len() {
                device.al_state = found.al_status.state().ok();
                device.al_error = found.al_status.error();
                device.al_code = found.al_code.0;
            }
            if let Some(mark) = self.marks.get_mut(found.position) {
                mark.fill(&mut device.error, taken);
            }
            if let Some(snapshot) = &snapshot {
                read(device, snapshot);
            }
            if device.moments.is_empty() && self.began_ns.is_some() {
                device.moments = moments(main, found.position);
            }
        }
    }
}

impl Mark {
    fn take(&mut self, difference: i64) {
        let size = difference.abs();
        self.now = difference;
        self.recent = Some(self.recent.map_or(size, |recent| recent.max(size)));
        self.worst = self.worst.max(size);
        self.count += 1;
    }

    fn fill(&mut self, error: &mut Option<Error>, taken: bool) {
        if self.count == 0 {
            return;
        }
        let recent = self.recent.take().map(|recent| recent as f64);
        let kept = error.and_then(|error| error.recent_ns).filter(|_| !taken);
        *error = Some(Error {
            now_ns: self.now as f64,
            recent_ns: larger(recent, kept),
            worst_ns: self.worst as f64,
            count: self.count,
        });
    }
}

/// The larger of two values, each of which may be missing.
pub(super) fn larger(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.max(other)),
        (one, other) => one.or(other),
    }
}

/// Takes the background reads of one SubDevice.
fn read(device: &mut Device, snapshot: &Snapshot<'_>) {
    let position = device.position;
    let clock = snapshot.clocks.iter().find(|clock| clock.position == position);
    let last = clock.and_then(|clock| clock.last());
    device.clock_ppm = last.map(|reading| -(reading.correction_ppb as f64) / 1e3);
    let margin = snapshot.devices.get(position).and_then(|device| device.margin);
    device.margin = margin
        .map(|margin| Margin { now_ns: margin.last.0 as f64, least_ns: margin.least.0 as f64 });
    let objects = snapshot.objects.get(position);
    let entries = objects.map_or(&[][..], |objects| &objects.entries);
    for entry in entries {
        let counters = match entry.object.index {
            OUTPUT_PARAMETER => &mut device.outputs,
            INPUT_PARAMETER => &mut device.inputs,
            _ => continue,
        };
        if let Some(at) = SUBS.iter().position(|sub| *sub == entry.object.sub) {
            counters[at] =
                Counter { value: entry.last.map(|(_, value)| value), risen: entry.risen };
        }
    }
    device.alarms.clear();
    let up = |alarm: Alarm| clock.is_some_and(|clock| clock.has(alarm));
    let of_clock = Alarm::OF_CLOCKS.into_iter().filter(|alarm| up(*alarm));
    let margin = margin.is_some_and(|margin| margin.has_alarm()).then_some(Alarm::Margin);
    let counter = entries.iter().any(EntryQuality::has_alarm).then_some(Alarm::Counter);
    let silent = objects.is_some_and(|objects| objects.is_silent());
    let silent = silent.then_some(Alarm::MailboxSilent);
    let all = of_clock.chain(margin).chain(counter).chain(silent);
    device.alarms.extend(all.map(|alarm| Words::from(alarm_words(alarm))));
}

/// The planned events of a SubDevice's cycle.
fn moments(main: &MainDevice, position: usize) -> Vec<Moment> {
    let timing = main.segment().timing.as_ref();
    let planned = timing.and_then(|timing| timing.moments(position));
    let line = |event: isocat_sync::Moment| {
        let span = planned?.of(event)?;
        let (earliest_ns, latest_ns) = (span.earliest.0, span.latest.0);
        Some(Moment { event, earliest_ns, latest_ns, seen_ns: None })
    };
    isocat_sync::Moment::PLANNED.into_iter().filter_map(line).collect()
}

/// A short text for a column.
pub(crate) fn alarm_words(alarm: Alarm) -> &'static str {
    match alarm {
        Alarm::Difference => "clock off",
        Alarm::NotConverging => "not converging",
        Alarm::Sliding => "clock slides",
        Alarm::SyncPending => "SYNC pending",
        Alarm::Silent => "clock silent",
        Alarm::Margin => "little margin",
        Alarm::Counter => "counter rises",
        Alarm::MailboxSilent => "mailbox silent",
    }
}

/// An event, which the reader puts into words.
#[derive(Clone, PartialEq, Debug)]
pub enum Note {
    /// A stage begins.
    Stage(Stage),
    /// All SubDevices are in OP.
    InOperation,
    /// A state changed; `true` means in operation.
    State(usize, AlStatus, AlStatusCode, bool),
    /// An alarm was raised or cleared.
    Alarm(Change),
    /// The working counter of a datagram of process data is wrong: chunk, expected, found.
    WorkingCounter(usize, u16, u16),
    /// The working counter is right again, after this number of cycles.
    Restored(usize, u64),
    /// A wrong number of clocks received the drift frame: expected, found.
    Drift(u16, u16),
    /// Number of cycles in which clocks have not been led; 0 means that they are led again.
    Unled(u64),
    /// Number of cycles that were skipped, and the lateness.
    Skipped(u64, Nanos),
    /// The state of the servo changed.
    Phase(phase::State),
    /// The number of SubDevices that answer changed: expected, found.
    Count(u16, u16),
    /// An emergency: position and error code.
    Emergency(usize, u16),
    /// An event in words: position, text, and whether it is bad.
    Told(Option<usize>, String, bool),
}

impl Note {
    /// The note of an event; `None` for one that is only counted.
    fn of(event: &Event, in_operation: bool) -> Option<Self> {
        Some(match event {
            Event::Progress(stage) => Note::Stage(*stage),
            Event::InOperation { .. } => Note::InOperation,
            Event::StateChanged { position, status, code, .. } => {
                Note::State(*position, *status, *code, in_operation)
            }
            Event::Alarm(change) => Note::Alarm(*change),
            Event::WorkingCounter { chunk, expected, found, .. } => {
                Note::WorkingCounter(*chunk, *expected, *found)
            }
            Event::WorkingCounterRestored { chunk, cycles, .. } => Note::Restored(*chunk, *cycles),
            Event::Drift { expected, found, .. } => Note::Drift(*expected, *found),
            Event::ClocksUnled { cycles } => Note::Unled(*cycles),
            Event::CyclesSkipped { late, skipped, .. } => Note::Skipped(*skipped, *late),
            Event::Phase { state, .. } => Note::Phase(*state),
            Event::CountChanged { expected, found, .. } => Note::Count(*expected, *found),
            Event::Emergency { position, code, .. } => Note::Emergency(*position, *code),
            Event::Failed(error) => Note::Told(None, error.to_string(), true),
            Event::DelayChanged { position, written, .. } => {
                let what = format!("its delay is no longer the {written} that were written");
                Note::Told(Some(*position), what, true)
            }
            _ => {
                let (position, change) = SegmentChange::of(event)?;
                Note::Told(position, change.to_string(), !change.is_good())
            }
        })
    }
}

impl From<(i64, Note)> for super::Event {
    fn from((at_ns, note): (i64, Note)) -> Self {
        let alarm = matches!(note, Note::Alarm(_));
        let (position, bad, what) = match note {
            Note::Stage(stage) => (None, false, format!("stage {stage}")),
            Note::InOperation => (None, false, "all in OP: in operation".to_owned()),
            Note::State(position, status, code, operating) => {
                let up = status == AlStatus::new(AlState::Op);
                let code_words = if code.0 == 0 { String::new() } else { format!(", {code}") };
                let bad = status.error() || operating && !up;
                (Some(position), bad, format!("{status}{code_words}"))
            }
            Note::Alarm(change) => {
                (Some(change.position), change.raised, change.what().to_string())
            }
            Note::WorkingCounter(chunk, expected, found) => {
                let what = format!("process data {chunk}: working counter {found}, not {expected}");
                (None, true, what)
            }
            Note::Restored(chunk, cycles) => (
                None,
                false,
                format!("process data {chunk} count right again after {cycles} cycles"),
            ),
            Note::Drift(expected, found) => {
                let what = format!("{found} of {expected} clocks take the reference's time");
                (None, found != expected, what)
            }
            Note::Unled(0) => (None, false, "clocks are led again".to_owned()),
            Note::Unled(cycles) => (None, true, format!("clocks are not led for {cycles} cycles")),
            Note::Skipped(skipped, late) => {
                (None, true, format!("{skipped} cycles skipped, {late} too late"))
            }
            Note::Phase(state) => {
                let what = format!("servo {}", servo_name(state));
                (None, state != phase::State::Locked, what)
            }
            Note::Count(expected, found) => {
                (None, found != expected, format!("{found} of {expected} SubDevices answer"))
            }
            Note::Emergency(position, code) => {
                (Some(position), true, format!("emergency 0x{code:04X}"))
            }
            Note::Told(position, what, bad) => (position, bad, what),
        };
        Self { at_ns, position, bad, alarm, what }
    }
}

/// The counters in the order of [`Device::outputs`].
const SUBS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];

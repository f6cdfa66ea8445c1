//! Judges whether a segment is in sync, from what its wire shows over the whole time in operation.
//!
//! An [`Engine`] gets its input while a MainDevice operates. It knows neither true time nor a
//! socket, so that a run on a real interface and one in virtual time can use the same engine. In
//! this order:
//!
//! - [`Engine::begin`], when all SubDevices are in OP;
//! - [`Engine::event`] with each event, and [`Engine::cycle`] after each input of the MainDevice.
//!   Neither allocates unless something happened that is a finding;
//! - [`Engine::end`], with the readings of the SubDevices before and after ([`Questions`],
//!   [`Readings`]). It returns a [`Verdict`].
//!
//! A loss that registers no longer show at the end was noticed while it happened. `frames` compares
//! the time at which each cycle's frame met the reference clock with the slack of each SubDevice in
//! the plan, `clocks` follows 0x092C, `counters` those of 0x1C32 and 0x1C33, and `told` keeps the
//! MainDevice's reports of states, frames and changes. Something that could have been read and was
//! not is a [`Gap`]: with one that [decides](Gap::decides) the answer is "not known", never "in
//! sync".

mod clocks;
mod counters;
mod frames;
mod gap;
mod questions;
mod told;
mod witness;

use isocat_maindevice::motion::{Axis, Drive};
use isocat_maindevice::statistics::{Statistics, Summary};
use isocat_maindevice::{Config, Event};
use isocat_sim::{Finding, Judged, Kind, Place};
use isocat_sync::phase;
use isocat_wire::time::Nanos;

use clocks::Clocks;
use counters::Counted;
pub use counters::Readings;
use frames::Frames;
pub use gap::{Gap, Unknown};
pub use questions::Questions;
use told::Told;
pub use witness::Witness;

/// The answer of a verdict.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answer {
    /// There are no findings, and all that could be read was read.
    InSync,
    /// There are findings: in sync except for these.
    Except,
    /// There are no findings, but something decisive was not read.
    NotKnown,
}

impl Answer {
    /// Its name in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::InSync => "in-sync",
            Self::Except => "except",
            Self::NotKnown => "not-known",
        }
    }

    /// The answer that follows from findings and gaps.
    pub fn of(findings: &[Finding], unknown: &[Unknown]) -> Self {
        match (findings, unknown.iter().any(|unknown| unknown.kind.decides())) {
            ([], false) => Self::InSync,
            ([], true) => Self::NotKnown,
            _ => Self::Except,
        }
    }
}

/// The name, such as `in-sync`.
impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// The result of an engine.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// Findings against the segment, in the order of time; findings without a time come last.
    pub findings: Vec<Finding>,
    /// What is not known.
    pub unknown: Vec<Unknown>,
    /// Departures and returns of SubDevices that may be absent; they are no findings.
    pub visits: Vec<Finding>,
}

impl Verdict {
    /// In sync, in sync except for the findings, or not known.
    pub fn answer(&self) -> Answer {
        Answer::of(&self.findings, &self.unknown)
    }
}

/// Adds the background reads that a verdict needs (clocks, counters and delays), unless the
/// configuration sets them.
pub fn with_reads(mut config: Config) -> Config {
    config.quality.get_or_insert_default();
    config.delay_watch.get_or_insert_default();
    config
}

/// Judges a segment in operation by what its MainDevice knows ([`Witness`]).
pub struct Engine {
    /// Largest distance of a clock from the reference with which it counts as synchronized.
    limit: Nanos,
    /// Counts at the beginning of the time in operation.
    first: Statistics,
    /// The counts of the last call.
    last: Seen,
    frames: Frames,
    clocks: Clocks,
    counters: Counted,
    told: Told,
}

/// Counts that tell what is new.
#[derive(Clone, Copy)]
struct Seen {
    /// Number of phase errors, and the least and the largest of them.
    errors: u64,
    least: Nanos,
    largest: Nanos,
    cycles: u64,
}

impl Seen {
    fn of(counts: &Statistics) -> Self {
        let Summary { count: errors, min: least, max: largest, .. } = counts.phase_error;
        Self { errors, least, largest, cycles: counts.cycles }
    }
}

impl Engine {
    /// Begins to judge when all SubDevices are in OP. `limit` is the largest 0x092C with which a
    /// clock counts as synchronized; `optional` says by position whether a SubDevice may be absent,
    /// with `false` for missing entries.
    pub fn begin(main: &impl Witness, limit: Nanos, optional: Vec<bool>) -> Self {
        let first = *main.statistics();
        Self {
            limit,
            first,
            last: Seen::of(&first),
            frames: Frames::new(main),
            clocks: Clocks::new(main, limit),
            counters: Counted::new(main),
            told: Told::new(optional),
        }
    }

    /// Takes an event at this time from the beginning.
    pub fn event(&mut self, at: Nanos, event: &Event) {
        self.told.event(at, event, self.limit);
    }

    /// Takes the received data at this time from the beginning. It must be called after each input,
    /// so that no frame's time is missed; it is cheap and does not allocate.
    #[inline]
    pub fn cycle(&mut self, at: Nanos, main: &impl Witness) {
        let counts = main.statistics();
        let known = std::mem::replace(&mut self.last, Seen::of(counts));
        let seen = self.last;
        if seen.errors != known.errors {
            self.frames.take(at, counts.phase_error.last);
            // If there are several at once, the worst ones are known too, if they are worse than
            // all before.
            if seen.errors > known.errors + 1 {
                let worst = [(seen.least, known.least), (seen.largest, known.largest)];
                for (seen, _) in worst.into_iter().filter(|(seen, known)| seen != known) {
                    self.frames.take(at, seen);
                }
            }
        }
        if seen.cycles != known.cycles {
            // One clock and one SubDevice per cycle: all of them would take too long on a long
            // line.
            self.clocks.look(at, main, counts.cycles);
            self.counters.look(main, counts.cycles);
        }
    }

    /// The longest stall of the host: its lateness for a cycle, and the time.
    pub fn stall(&self) -> Option<(Nanos, Nanos)> {
        self.told.stall
    }

    /// Number of times that the host lost its lock on the reference clock.
    pub fn locks_lost(&self) -> u64 {
        self.told.locks_lost
    }

    /// Number of cycles that the host skipped.
    pub fn cycles_skipped(&self) -> u64 {
        self.told.skipped
    }

    /// Ends the judging. `readings` are those of the SubDevices by position, empty if they were not
    /// asked; `axes` is the application's view of them.
    pub fn end(
        mut self,
        at: Nanos,
        main: &impl Witness,
        axes: &[Axis],
        readings: &[Readings],
    ) -> Verdict {
        self.cycle(at, main);
        let mut verdict = Verdict::default();
        let last = main.statistics();
        let cycles = last.cycles - self.first.cycles;
        let times = last.phase_error.count - self.first.phase_error.count;
        self.frames.end(main, cycles.saturating_sub(times), &mut verdict);
        self.clocks.end(at, main, readings, &mut verdict);
        self.counters.end(main, readings, self.frames.rooms(), &mut verdict);
        let behind = last.frames_behind - self.first.frames_behind;
        // With a clock the time of each frame is judged above.
        let is_timed =
            |finding: &Finding| matches!(finding.kind, Kind::Judged(Judged::FramesTooLate { .. }));
        if behind > 0 && !verdict.findings.iter().any(is_timed) {
            verdict.doubt(Place::SEGMENT, Gap::ReturnedLate { frames: behind });
        }
        let errors = last.working_counter_errors - self.first.working_counter_errors;
        let late = last.cyclic_late - self.first.cyclic_late;
        self.told.end(main, readings, (errors, late), &mut verdict);
        if main.segment().reference.is_some() && main.phase() != Some(phase::State::Locked) {
            let holdover = main.phase() == Some(phase::State::Holdover);
            verdict.add(Place::SEGMENT, None, Judged::HostNotLocked { holdover });
        }
        for (position, axis) in axes.iter().enumerate() {
            let there = main.segment().devices.get(position).is_some_and(|device| device.admitted);
            if matches!(axis, Axis::Drive(Drive { enabled_cycles: 0, .. }))
                && there
                && cycles >= SWITCH_ON_CYCLES
            {
                verdict.add(Place::device(position), None, Judged::DriveNotEnabled);
            }
        }
        for device in main.segment().devices.iter().filter(|device| device.admitted) {
            if let Some(object) = device.mode_not_asked {
                let place = Place::device(device.position);
                verdict.add(place, None, Judged::ModeNotAsked { object });
            }
        }
        gap::out_of_sight(main, &mut verdict);
        verdict.sort();
        verdict
    }
}

impl Verdict {
    fn add(&mut self, place: Place, since: Option<Nanos>, kind: Judged) {
        self.findings.push(Finding { place, since, kind: kind.into() });
    }

    fn doubt(&mut self, place: Place, kind: Gap) {
        self.unknown.push(Unknown { place, kind });
    }

    /// The earliest finding is nearest to the cause.
    pub(crate) fn sort(&mut self) {
        self.findings.sort_by_key(|finding| finding.since.unwrap_or(Nanos(i64::MAX)));
        self.unknown.sort_by_key(|unknown| (!unknown.kind.decides(), unknown.place.device));
    }
}

/// Cycles within which a drive must have switched on.
const SWITCH_ON_CYCLES: u64 = 100;

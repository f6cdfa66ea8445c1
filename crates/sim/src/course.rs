//! Records when each SubDevice was in sync and when it was not, over the whole run, for
//! expectations of runs with faults.
//!
//! A SubDevice is out of sync from the first sign of it until there were no signs for some cycles.
//! Signs are: it is not in OP, a SYNC0 edge is off its grid or missing, outputs were missed or came
//! after the pulse at which they should act.

use isocat_wire::AlState;
use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::bench::{Intent, Measured};
use crate::observation::Observed;

/// The first sign that a SubDevice was not in sync.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sign {
    /// It was not in OP.
    NotInOp,
    /// A SYNC0 edge was farther off its grid than allowed.
    Sync0Off,
    /// No SYNC0 edge came for more than two of its cycles.
    NoSync0,
    /// It missed the event of its outputs.
    MissedEvent,
    /// Outputs were ready after the pulse at which they should act.
    OutputsLate,
}

/// A time in which a SubDevice was not in sync.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stretch {
    /// Position of the SubDevice.
    pub device: usize,
    /// The first sign; it came at `from`.
    pub sign: Sign,
    /// When the first sign came.
    pub from: Time<True>,
    /// When the last sign came; from then on it was in OP without any sign.
    pub to: Time<True>,
    /// Whether it had not ended when the recording ended.
    pub open: bool,
}

/// The course of a run in operation.
#[derive(Clone, Debug)]
pub struct Course {
    began: Time<True>,
    limit: Picos,
    devices: Vec<Place>,
    stretches: Vec<Stretch>,
    left_out: u64,
    /// The largest absolute SYNC0 error of each SubDevice; `None` if no edge was measured.
    worst: Vec<Option<Picos>>,
}

/// The present state of one SubDevice.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Whether it has been in OP: a SubDevice that may be absent is judged only after it has come.
    takes_part: bool,
    in_op: bool,
    /// Number of its open stretch.
    stretch: Option<usize>,
    /// Time without a sign after which it is in sync again.
    quiet: Picos,
    /// Cycle of its SYNC0; `None` if SYNC0 is not configured.
    sync0: Option<Picos>,
    last_sync0: Time<True>,
    /// When its outputs were last stored while it was in OP, and the longest time in OP without new
    /// ones.
    stored: Option<Time<True>>,
    stale: Picos,
}

/// Most stretches that are kept: the first ones.
const MOST_STRETCHES: usize = 10_000;
/// Cycles without a sign after which a SubDevice is in sync again.
const QUIET_CYCLES: i64 = 4;

impl Course {
    /// A course that begins at `at`, when all SubDevices that take part are in OP. Those that are
    /// not, as they may be absent, take part from the time at which they come.
    pub fn begin(at: Time<True>, intent: &Intent, states: impl Iterator<Item = AlState>) -> Self {
        let devices = states.enumerate().map(|(position, state)| {
            let (sync0, quiet) = pace(intent, position);
            Place {
                takes_part: state == AlState::Op,
                in_op: state == AlState::Op,
                stretch: None,
                quiet,
                sync0,
                last_sync0: at,
                stored: None,
                stale: Picos::ZERO,
            }
        });
        let devices: Vec<Place> = devices.collect();
        Self {
            began: at,
            limit: intent.sync0_limit,
            worst: vec![None; devices.len()],
            devices,
            stretches: Vec::new(),
            left_out: 0,
        }
    }

    /// From `at` on SubDevices have other cycles, because a MainDevice has written them during
    /// operation.
    pub fn bind(&mut self, at: Time<True>, intent: &Intent) {
        self.limit = intent.sync0_limit;
        for (position, place) in self.devices.iter_mut().enumerate() {
            let had_sync0 = place.sync0.is_some();
            (place.sync0, place.quiet) = pace(intent, position);
            if !had_sync0 {
                place.last_sync0 = at;
            }
        }
    }

    /// Takes an event at a SubDevice, and what the judges measured of it.
    pub fn observe(&mut self, device: usize, at: Time<True>, event: Observed, measured: &Measured) {
        let place = &mut self.devices[device];
        if !place.takes_part {
            let has_come = matches!(event, Observed::State(AlState::Op, _));
            (place.takes_part, place.in_op, place.last_sync0) = (has_come, has_come, at);
            return;
        }
        let mut sign = None;
        if let Some(error) = measured.sync0_error {
            let size = Picos(error.0.abs());
            self.worst[device] = self.worst[device].max(Some(size));
            if size > self.limit {
                sign = Some(Sign::Sync0Off);
            }
        }
        if measured.margin.is_some_and(|margin| margin < Nanos::ZERO) {
            sign = sign.or(Some(Sign::OutputsLate));
        }
        match event {
            Observed::Sync0 => place.last_sync0 = at,
            Observed::SmEventMissed(_) => sign = Some(Sign::MissedEvent),
            Observed::StillActive(_) if place.in_op => sign = Some(Sign::NoSync0),
            Observed::Sm2 if place.in_op => place.note_stored(at),
            Observed::OutputsSafe => {
                place.note_pause(at);
                place.stored = None;
            }
            Observed::State(state, _) => {
                let was_in_op = std::mem::replace(&mut place.in_op, state == AlState::Op);
                if was_in_op && !place.in_op {
                    place.note_pause(at);
                    place.stored = None;
                }
                place.last_sync0 = at;
                if was_in_op || !place.in_op {
                    sign = Some(Sign::NotInOp);
                } else if let Some(number) = place.stretch {
                    // It was out of sync until now.
                    self.stretches[number].to = at;
                }
            }
            _ => {}
        }
        if place.in_op && sign.is_none() && place.sync0_stays_away(at) {
            sign = Some(Sign::NoSync0);
        }
        match sign {
            Some(sign) => self.sign(device, at, sign),
            None => self.quiet(device, at),
        }
    }

    /// Ends the recording.
    pub fn end(&mut self, at: Time<True>) {
        for device in 0..self.devices.len() {
            let place = &mut self.devices[device];
            if place.in_op {
                place.note_pause(at);
                if place.sync0_stays_away(at) {
                    self.sign(device, at, Sign::NoSync0);
                    continue;
                }
            }
            self.quiet(device, at);
        }
    }

    fn sign(&mut self, device: usize, at: Time<True>, sign: Sign) {
        self.quiet(device, at);
        let place = &mut self.devices[device];
        if let Some(number) = place.stretch {
            self.stretches[number].to = at;
            return;
        }
        if self.stretches.len() >= MOST_STRETCHES {
            self.left_out += 1;
            return;
        }
        place.stretch = Some(self.stretches.len());
        self.stretches.push(Stretch { device, sign, from: at, to: at, open: true });
    }

    /// Ends the stretch of a SubDevice that has been without a sign for long enough.
    fn quiet(&mut self, device: usize, at: Time<True>) {
        let place = &mut self.devices[device];
        let Some(number) = place.stretch else { return };
        let stretch = &mut self.stretches[number];
        if place.in_op && at - stretch.to >= place.quiet {
            stretch.open = false;
            place.stretch = None;
        } else if !place.in_op {
            stretch.to = stretch.to.max(at);
        }
    }

    /// When it began: all SubDevices were in OP.
    pub fn began(&self) -> Time<True> {
        self.began
    }

    /// The times in which SubDevices were not in sync, in the order of their begin.
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    /// Number of further stretches that were not kept.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The SubDevices that were not in sync at `at`.
    pub fn out_of_sync_at(&self, at: Time<True>) -> impl Iterator<Item = &Stretch> {
        let over = move |stretch: &&Stretch| {
            let is_in = at >= stretch.from && (stretch.open || at <= stretch.to);
            is_in || at < self.began
        };
        self.stretches.iter().filter(over)
    }

    /// Number of SubDevices.
    pub fn devices(&self) -> usize {
        self.devices.len()
    }

    /// The largest SYNC0 error of a SubDevice; zero without SYNC0.
    pub fn worst_sync0(&self, device: usize) -> Picos {
        self.measured_sync0(device).unwrap_or_default()
    }

    /// The same; `None` where no SYNC0 edge was measured.
    pub fn measured_sync0(&self, device: usize) -> Option<Picos> {
        self.worst.get(device).copied().flatten()
    }

    /// The longest time for which a SubDevice was in OP without new outputs after the last ones
    /// were stored, and did not make them safe; zero if it never had any.
    pub fn longest_stale(&self, device: usize) -> Picos {
        self.devices.get(device).map_or(Picos::ZERO, |place| place.stale)
    }
}

/// Cycle of the SYNC0 of a SubDevice, and the time without a sign after which it is in sync again.
fn pace(intent: &Intent, position: usize) -> (Option<Picos>, Picos) {
    let sync0 = intent.sync0.get(position).copied().flatten().map(|grid| grid.cycle);
    let cycle = sync0.map_or(intent.send.cycle, |cycle| cycle.max(intent.send.cycle));
    (sync0.map(Picos::from), Picos::from(Nanos(cycle.0 * QUIET_CYCLES)))
}

impl Place {
    fn sync0_stays_away(&self, at: Time<True>) -> bool {
        self.sync0.is_some_and(|cycle| at > self.last_sync0 + cycle + cycle)
    }

    fn note_stored(&mut self, at: Time<True>) {
        self.note_pause(at);
        self.stored = Some(at);
    }

    /// Records the present age of the outputs.
    fn note_pause(&mut self, at: Time<True>) {
        if let Some(stored) = self.stored {
            self.stale = self.stale.max(at - stored);
        }
    }
}

#[cfg(test)]
mod tests {
    use isocat_wire::AlStatusCode;

    use super::*;
    use crate::judge::Grid;

    const MS: u64 = 1_000_000_000;

    fn at(ms: u64) -> Time<True> {
        Time::new(ms * MS)
    }

    fn course() -> Course {
        let cycle = Nanos::millis(1);
        let grid = Grid { cycle, phase: Nanos::ZERO };
        let intent = Intent {
            reference: 0,
            send: grid,
            sync0: vec![Some(grid)],
            acting: vec![Some(grid)],
            exchange: vec![Some(grid)],
            inputs_shifted: Vec::new(),
            sync0_limit: Picos(1_000_000),
            outputs_spread: Picos(1_000_000),
        };
        Course::begin(at(10), &intent, [AlState::Op].into_iter())
    }

    fn edge(course: &mut Course, ms: u64, error_ps: i64) {
        let measured = Measured { sync0_error: Some(Picos(error_ps)), margin: None };
        course.observe(0, at(ms), Observed::Sync0, &measured);
    }

    #[test]
    fn both_sides_of_the_limit() {
        let mut course = course();
        for ms in 11..20 {
            edge(&mut course, ms, 1_000_000);
        }
        assert_eq!(course.stretches(), []);
        edge(&mut course, 20, -1_000_001);
        for ms in 21..30 {
            edge(&mut course, ms, 0);
        }
        let stretch =
            Stretch { device: 0, sign: Sign::Sync0Off, from: at(20), to: at(20), open: false };
        assert_eq!(course.stretches(), [stretch]);
        assert_eq!(course.worst_sync0(0), Picos(1_000_001));
        assert_eq!(course.out_of_sync_at(at(20)).count(), 1);
        assert_eq!(course.out_of_sync_at(at(21)).count(), 0);
        assert_eq!(course.out_of_sync_at(at(19)).count(), 0);
    }

    #[test]
    fn signs_in_a_row_are_one_stretch_and_the_way_back_to_op_belongs_to_it() {
        let mut course = course();
        let none = Measured::default();
        let missed = Observed::SmEventMissed(3);
        course.observe(0, at(12), missed, &none);
        course.observe(0, at(15), missed, &none);
        let state = |state| Observed::State(state, AlStatusCode::NO_ERROR);
        course.observe(0, at(16), state(AlState::SafeOp), &none);
        course.observe(0, at(300), state(AlState::Op), &none);
        for ms in 301..310 {
            edge(&mut course, ms, 5);
        }
        course.observe(0, at(310), missed, &none);
        course.end(at(311));
        let first =
            Stretch { device: 0, sign: Sign::MissedEvent, from: at(12), to: at(300), open: false };
        let last = Stretch { from: at(310), to: at(310), open: true, ..first };
        assert_eq!(course.stretches(), [first, last]);
    }

    #[test]
    fn a_sync0_that_stays_away_is_a_sign_after_two_cycles() {
        for (silence, stretches) in [(2, 0), (3, 1)] {
            let mut course = course();
            edge(&mut course, 20, 0);
            course.observe(0, at(20 + silence), Observed::Sm2, &Measured::default());
            assert_eq!(course.stretches().len(), stretches, "{silence}");
        }
    }

    #[test]
    fn outputs_are_stale_from_their_last_frame_until_op_is_left() {
        let mut course = course();
        let none = Measured::default();
        for ms in [11, 12, 15] {
            course.observe(0, at(ms), Observed::Sm2, &none);
        }
        assert_eq!(course.longest_stale(0), Picos::from(Nanos::millis(3)));
        let fallen = Observed::State(AlState::SafeOp, AlStatusCode::WATCHDOG);
        course.observe(0, at(115), fallen, &none);
        course.observe(0, at(900), Observed::Sm2, &none);
        course.end(at(1_000));
        assert_eq!(course.longest_stale(0), Picos::from(Nanos::millis(100)));
    }

    #[test]
    fn outputs_that_were_made_safe_in_op_are_stale_no_longer() {
        let stale = |safe: Option<u64>| {
            let mut course = course();
            let none = Measured::default();
            course.observe(0, at(15), Observed::Sm2, &none);
            if let Some(ms) = safe {
                course.observe(0, at(ms), Observed::OutputsSafe, &none);
            }
            course.observe(0, at(800), Observed::Sm2, &none);
            course.end(at(801));
            course.longest_stale(0)
        };
        let ms = |ms| Picos::from(Nanos::millis(ms));
        assert_eq!((stale(None), stale(Some(115))), (ms(785), ms(100)));
    }
}

//! The environment of a rule: the SubDevice, brought to the state where the rule begins, and a
//! place for its evidence.

use std::fmt::Display;

use isocat_sim::observation::Observed;
use isocat_subdevice::Step;
use isocat_sync::SyncMode;
use isocat_sync::object::ShiftBy;
use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, sub,
};
use isocat_sync::table::Column;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, AlState, ObjectAddress, register};

use super::evidence::Evidence;
use super::mode::Mode;
use super::subject::{Subject, SyncObject};
use super::tester::{Al, Grid, LOGICAL, Tester, Trouble};

/// Why a check ends early.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Stop {
    /// The rule does not apply to this SubDevice, or not in this mode.
    NotApplicable(String),
    /// Another rule that this one depends on fails, so this one can't begin.
    Blocked {
        /// The other rule.
        by: &'static str,
        /// How it fails here.
        why: String,
    },
    /// There was no answer, or a wrong one.
    Trouble(Trouble),
    /// The observation does not allow a verdict: frames were lost or late, or the user stopped the
    /// suite.
    NotJudged(String),
}

impl From<Trouble> for Stop {
    fn from(trouble: Trouble) -> Self {
        Self::Trouble(trouble)
    }
}

/// The end of a check. Its evidence is in the case.
pub type Done = Result<(), Stop>;

/// A check in progress.
pub struct Case<'a, 'w> {
    /// The connection to the SubDevice.
    pub t: &'a mut Tester<'w>,
    /// What the SubDevice says about itself.
    pub s: &'a Subject,
    /// The mode that the check runs in; rules of the whole SubDevice ignore it.
    pub mode: Mode,
    /// What was looked at.
    pub evidence: Vec<Evidence>,
    /// Further information for the reader, for example which of several correct behaviours was
    /// found.
    pub notes: Vec<String>,
}

/// Counters of one sync object; `None`: the object does not have that sub-index.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// SM event missed (0B).
    pub missed: Option<u64>,
    /// Cycle time too small (0C).
    pub too_small: Option<u64>,
    /// Shift time too short (0D).
    pub too_short: Option<u64>,
    /// Sync error (20).
    pub error: Option<u64>,
}

impl Counters {
    /// The counters that exist, with their sub-indices.
    pub fn each(&self) -> impl Iterator<Item = (u8, u64)> {
        let all = [
            (sub::SM_EVENT_MISSED, self.missed),
            (sub::CYCLE_TIME_TOO_SMALL, self.too_small),
            (sub::SHIFT_TIME_TOO_SHORT, self.too_short),
            (sub::SYNC_ERROR, self.error),
        ];
        all.into_iter().filter_map(|(sub, value)| Some((sub, value?)))
    }
}

impl Case<'_, '_> {
    /// Notes what was looked at, and whether it is right.
    pub fn expect(
        &mut self,
        place: impl Display,
        expected: impl Display,
        found: impl Display,
        right: bool,
    ) {
        self.evidence.push(Evidence {
            place: place.to_string(),
            expected: expected.to_string(),
            found: found.to_string(),
            right,
        });
    }

    /// Notes a number and the number that is expected.
    pub fn equal(&mut self, place: impl Display, expected: u64, found: u64) {
        self.expect(place, expected, found, expected == found);
    }

    /// Notes an abort code, or that there was no abort.
    pub fn aborts<T>(
        &mut self,
        place: impl Display,
        found: &Result<T, AbortCode>,
        expected: &[AbortCode],
    ) {
        let list: Vec<_> = expected.iter().map(|code| format!("0x{:08X}", code.0)).collect();
        let (text, right) = match found {
            Ok(_) => ("accepted".to_owned(), false),
            Err(code) => (format!("0x{:08X}", code.0), expected.contains(code)),
        };
        self.expect(place, format!("abort {}", list.join(" or ")), text, right);
    }

    /// Restarts the SubDevice and brings it to PREOP.
    pub fn preop(&mut self) -> Done {
        self.t.restart()?;
        let al = self.s.preop(self.t)?;
        blocked(al, AlState::PreOp, "MODE-01")
    }

    /// Does the same as [`preop`](Self::preop); not applicable without CoE objects.
    pub fn preop_with_objects(&mut self) -> Done {
        if self.s.coe.is_none() {
            return Err(not_applicable("it has no CoE mailbox"));
        }
        self.preop()
    }

    /// Assigns the PDOs, unless they are assigned already: an earlier rule may have left others
    /// where the power can't be switched off.
    pub fn assign(&mut self) -> Done {
        let s = self.s;
        for (direction, index) in [(&s.outputs, OUTPUT_ASSIGNMENT), (&s.inputs, INPUT_ASSIGNMENT)] {
            if direction.writable && self.t.assignment(index)? != direction.pdos {
                self.write_assignment(index, &direction.pdos)?;
            }
        }
        Ok(())
    }

    /// Writes a list of PDOs into 0x1C12 or 0x1C13.
    pub fn write_assignment(&mut self, index: u16, pdos: &[u16]) -> Done {
        let at = |sub| ObjectAddress::new(index, sub);
        self.must_write(at(0), &[0])?;
        for (slot, pdo) in (1..).zip(pdos) {
            self.must_write(at(slot), &pdo.to_le_bytes())?;
        }
        self.must_write(at(0), &[pdos.len() as u8])
    }

    /// Writes a value that the SubDevice has to accept.
    pub fn must_write(&mut self, object: ObjectAddress, data: &[u8]) -> Done {
        match self.t.download(object, data)? {
            Ok(()) => Ok(()),
            Err(code) => Err(Trouble::new(format!("{object} can't be written: {code}")).into()),
        }
    }

    /// Writes the types of a mode to 0x1C32:01 and 0x1C33:01, for each direction that has process
    /// data.
    pub fn choose(&mut self, mode: Mode) -> Done {
        let s = self.s;
        for object in s.live_objects() {
            let wanted = self.sync_type(object, mode);
            self.must_write(object.at(sub::SYNC_TYPE), &wanted.to_le_bytes())?;
        }
        Ok(())
    }

    /// The value that 0x1C32:01 or 0x1C33:01 has to have in a mode.
    pub fn sync_type(&self, object: &SyncObject, mode: Mode) -> u16 {
        match (object.index, self.s.outputs.len) {
            (OUTPUT_PARAMETER, _) => mode.output_type,
            (_, 0) => mode.input_only_type,
            _ => mode.input_type,
        }
    }

    /// Sets SM2, SM3 and their FMMUs.
    pub fn process_data(&mut self) -> Done {
        self.process_data_of(self.s)
    }

    /// Does the same as [`process_data`](Self::process_data) for a SubDevice with other process
    /// data.
    pub fn process_data_of(&mut self, s: &Subject) -> Done {
        for (number, direction, kind) in [(0, &s.outputs, Fmmu::WRITE), (1, &s.inputs, Fmmu::READ)]
        {
            let sm = s.sync_manager(direction.sm);
            // A device without data in this direction may lack the SyncManager.
            if direction.len > 0 || s.sms.get(direction.sm).is_some() {
                self.t.set_sync_manager(direction.sm, sm)?;
            }
            let fmmu = match direction.len {
                0 => Fmmu::default(),
                len => Fmmu::bytes(LOGICAL, len, sm.start, kind),
            };
            if direction.len > 0 || s.has_mailbox() {
                self.t.set(register::fmmu(number), fmmu)?;
            }
        }
        Ok(())
    }

    /// Sets up a mode up to the request of SAFEOP, which is not sent yet. Returns the grid of
    /// SYNC0, if there is one.
    pub fn prepare(&mut self, mode: Mode, cycle: Nanos) -> Result<Option<Grid>, Stop> {
        self.reachable(mode)?;
        self.preop()?;
        self.assign()?;
        if self.s.chooses_type() {
            self.choose(mode)?;
        }
        self.process_data()?;
        if !mode.uses_dc() {
            return Ok(None);
        }
        let ns = cycle.to_u32().unwrap_or(u32::MAX);
        let start = self.t.start_sync(mode.activation, mode.pulses(ns), LEAD_IN)?;
        Ok(Some(Grid { start, lead: self.lead(cycle) }))
    }

    /// Brings the SubDevice to SAFEOP in a mode and begins the exchange.
    pub fn safe_op(&mut self, mode: Mode, cycle: Nanos) -> Done {
        let grid = self.prepare(mode, cycle)?;
        let al = self.t.change(AlState::SafeOp, STATE_PATIENCE)?;
        blocked(al, AlState::SafeOp, "MODE-02")?;
        self.exchange(cycle, grid);
        Ok(())
    }

    /// Begins the exchange of process data.
    pub fn exchange(&mut self, cycle: Nanos, grid: Option<Grid>) {
        let lens = (usize::from(self.s.outputs.len), usize::from(self.s.inputs.len));
        self.t.begin_exchange(cycle, lens, grid);
    }

    /// Brings the SubDevice to OP in a mode, and runs some cycles.
    pub fn op(&mut self, mode: Mode, cycle: Nanos) -> Done {
        self.safe_op(mode, cycle)?;
        self.enter_op()
    }

    /// Goes from SAFEOP to OP.
    pub fn enter_op(&mut self) -> Done {
        self.t.run(SETTLING)?;
        let al = self.t.change(AlState::Op, OP_PATIENCE)?;
        blocked(al, AlState::Op, "MODE-03")?;
        Ok(self.t.run(SETTLING)?)
    }

    /// Brings the SubDevice to OP in the mode of this check, at the usual cycle.
    pub fn op_here(&mut self) -> Done {
        self.op(self.mode, self.cycle())
    }

    /// Whether a mode can be requested.
    pub fn reachable(&self, mode: Mode) -> Done {
        if let Some(why) = mode.untried {
            return Err(not_applicable(format!("{} is not tried: {why}", mode.name())));
        }
        if mode.uses_dc() && !self.s.has_dc {
            return Err(not_applicable("it has no SYNC unit"));
        }
        if mode.mode == SyncMode::DcSync1 && !self.s.chooses_type() {
            return Err(not_applicable(
                "DC SYNC1 can't be asked for: 0x1C32:01 is read only, and the registers alone ask for \
                 SYNC0 shifted by SYNC1",
            ));
        }
        let others = self.s.modes.iter().any(|other| other.mode == SyncMode::SmSynchronous);
        if mode.bit == 0 && others && !self.s.chooses_type() {
            return Err(not_applicable(
                "Free Run can't be asked for: 0x1C32:01 is read only, and SM-synchronous goes before",
            ));
        }
        Ok(())
    }

    /// The DC SYNC0 mode, if the SubDevice has it.
    pub fn sync0_mode(&self) -> Result<Mode, Stop> {
        let modes = self.s.modes.iter().copied();
        let mut dc = modes.filter(Mode::is_sync0);
        let mode = dc.next().ok_or_else(|| not_applicable("it announces no DC SYNC0"))?;
        self.reachable(mode)?;
        Ok(mode)
    }

    /// The first announced mode that can be requested.
    pub fn any_mode(&self) -> Result<Mode, Stop> {
        let mut modes = self.s.modes.iter().copied();
        modes
            .find(|mode| self.reachable(*mode).is_ok())
            .ok_or_else(|| not_applicable("it announces no mode that is tried"))
    }

    /// The cycle of a usual run: 1 ms, or more if the SubDevice needs a longer one.
    pub fn cycle(&self) -> Nanos {
        let least = self.least_cycle().0.max(1) as u64;
        Nanos::millis(least.div_ceil(1_000_000) as i64)
    }

    /// The shortest bus cycle that the SubDevice states for this mode: its SYNC0 cycle must not be
    /// below the minimum cycle time.
    pub fn least_cycle(&self) -> Nanos {
        Nanos(self.s.minimum_cycle().0 * i64::from(self.mode.subordinated_cycles()))
    }

    /// The mode of this check in the tables of ETG.1020.
    pub fn column(&self, object: &SyncObject) -> Column {
        let shifted = object.types().shift() == ShiftBy::LocalTimer;
        match (self.mode.mode, shifted) {
            (SyncMode::FreeRun, _) => Column::FreeRun,
            (SyncMode::SmSynchronous, false) => Column::Sm,
            (SyncMode::SmSynchronous, true) => Column::SmShift,
            (SyncMode::DcSync0, false) => Column::Dc,
            (SyncMode::DcSync0, true) => Column::DcShift,
            (SyncMode::DcShiftSync1, _) => Column::DcShiftSync1,
            (SyncMode::DcSync1, _) => Column::DcSync1,
            (SyncMode::DcSubordinated, _) => Column::DcSubordinated,
        }
    }

    /// How long before SYNC0 a frame passes, so that there is time to copy the outputs.
    pub fn lead(&self, cycle: Nanos) -> Nanos {
        let calc = self.s.sync_objects().find(|o| o.index == OUTPUT_PARAMETER);
        let calc = calc.and_then(|object| object.value(sub::CALC_AND_COPY_TIME)).unwrap_or(0);
        let calc = if calc == 0 { USUAL_COPY } else { Nanos(calc as i64) };
        // In subordinated cycles the frame must come after SYNC1, which is not the first SYNC0 of a
        // bus cycle.
        let room = Nanos(cycle.0 / i64::from(self.mode.subordinated_cycles()) * 4 / 5);
        (calc + ROOM + self.t.lateness()).min(room)
    }

    /// The counters of 0x1C32 or 0x1C33.
    pub fn counters(&mut self, index: u16) -> Result<Counters, Stop> {
        let s = self.s;
        let Some(object) = s.sync_objects().find(|object| object.index == index) else {
            return Ok(Counters::default());
        };
        let mut read = |sub| match object.entry(sub) {
            Some(_) => self.t.value(object.at(sub)),
            None => Ok(None),
        };
        Ok(Counters {
            missed: read(sub::SM_EVENT_MISSED)?,
            too_small: read(sub::CYCLE_TIME_TOO_SMALL)?,
            too_short: read(sub::SHIFT_TIME_TOO_SHORT)?,
            error: read(sub::SYNC_ERROR)?,
        })
    }

    /// The sync object whose counters are looked at: that of the outputs if there are any.
    pub fn leading(&self) -> Result<&'_ SyncObject, Stop> {
        self.s.leading().ok_or_else(|| not_applicable("it has no sync object"))
    }

    /// Requires that the counters of both objects are 0.
    pub fn all_clear(&mut self, when: &str) -> Done {
        for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
            for (sub, found) in self.counters(index)?.each().collect::<Vec<_>>() {
                self.equal(format!("{} {when}", ObjectAddress::new(index, sub)), 0, found);
            }
        }
        Ok(())
    }

    /// In simulation: requires that outputs acted exactly once between two frames.
    fn outputs_acted(&mut self) {
        // In Free Run outputs do not follow frames, and in subordinated cycles they act with every
        // SYNC0.
        if self.s.outputs.len == 0 || self.mode.bit == 0 || self.mode.bit == 4 {
            return;
        }
        let Some(seen) = self.t.seen() else { return };
        let (mut frames, mut wrong, mut acted) = (0, 0, None);
        for seen in seen {
            match seen.event {
                Observed::Sm2 => {
                    frames += 1;
                    wrong += u32::from(acted.is_some_and(|acted| acted != 1));
                    acted = Some(0);
                }
                Observed::Began(Step::OutputsValid) => acted = acted.map(|acted: u32| acted + 1),
                _ => {}
            }
        }
        let place = format!("outputs between {frames} frames");
        let found = format!("{wrong} times not, or more often");
        self.expect(place, "acted once each", found, wrong == 0);
    }

    /// Runs some cycles in OP, which must be without faults: state, working counters and sync
    /// counters.
    pub fn clean_run(&mut self, cycles: u64) -> Done {
        let before = self.t.exchange.as_ref().map_or(0, |exchange| exchange.wrong_counters);
        self.t.seen();
        self.t.run(cycles)?;
        self.outputs_acted();
        let Some(exchange) = self.t.exchange.clone() else {
            return Err(Trouble::new("no exchange goes on").into());
        };
        self.expect("state", AlState::Op, exchange.al, exchange.al.is(AlState::Op));
        let wrong = exchange.wrong_counters - before;
        let found = match exchange.wrong_counter {
            Some((found, right)) if wrong > 0 => {
                format!("{wrong} wrong, such as {found} for {right}")
            }
            _ => "all right".to_owned(),
        };
        self.expect(format!("working counters of {cycles} frames"), "all right", found, wrong == 0);
        if self.s.coe.is_some() {
            self.all_clear("after a clean run")?;
        }
        Ok(())
    }
}

/// Says that the rule does not apply to the SubDevice.
pub fn not_applicable(why: impl Into<String>) -> Stop {
    Stop::NotApplicable(why.into())
}

fn blocked(al: Al, wanted: AlState, by: &'static str) -> Done {
    if al.is(wanted) {
        Ok(())
    } else {
        Err(Stop::Blocked { by, why: format!("{wanted} is not reached: {al}") })
    }
}

/// How long a change of state may take, except to OP with DC.
pub(crate) const STATE_PATIENCE: Nanos = Nanos::millis(3_000);
/// How long a change to OP may take: SubDevices usually give up after 9 s.
pub(crate) const OP_PATIENCE: Nanos = Nanos::millis(12_000);
/// Time from the set-up of the SYNC unit to its first pulse.
pub(crate) const LEAD_IN: Nanos = Nanos::millis(20);
/// Cycles that pass before OP is requested.
const SETTLING: u64 = 5;
/// Calc and copy time of a SubDevice that states none.
const USUAL_COPY: Nanos = Nanos::micros(50);
/// Time for the frame itself, with a reserve.
const ROOM: Nanos = Nanos::micros(50);

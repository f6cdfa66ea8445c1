//! The mode of a device in one of its OpModes, at one bus cycle.

use isocat_descriptions::esi::{CycleTime, EsiDevice, EsiFile, EsiOpMode, ShiftTime};
use isocat_sync::SyncMode;
use isocat_sync::opmode::{self, BusCycles, Unit, Warning};
use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;

use super::super::{Doubt, DoubtKind, Profile};
use super::{NotSimulated, Obstacle};

/// An OpMode of a description that a device runs in.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TakenOpMode {
    /// Its name in the description.
    pub name: String,
    /// Its number in the description, from 0.
    pub number: usize,
    /// Its terms, from which registers follow at any bus cycle.
    pub terms: opmode::OpMode,
    /// What the description says of the SYNC unit.
    pub unit: Unit,
}

/// The settings of the MainDevice that make a device run as its OpMode says.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RunAs {
    /// The OpMode; `None` for a device without.
    pub op_mode: Option<TakenOpMode>,
    /// Mode.
    pub mode: SyncMode,
    /// Every mode that the OpMode may mean, the likeliest first: its registers do not distinguish
    /// them.
    pub modes: &'static [SyncMode],
    /// Time from SYNC0 to the SYNC1 that belongs to it; `None`: the time that the device needs.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0, if it is a fraction of the bus cycle.
    pub sync0_cycle: Option<Nanos>,
    /// Values for its registers 0x0980 and 0x0981; `None` without an OpMode.
    pub unit: Option<AssignActivate>,
    /// Doubts, and parts of the file that are not followed.
    pub notes: Vec<Doubt>,
}

impl RunAs {
    /// The settings for an OpMode (`None` for a device without) at a bus cycle.
    pub fn new(
        file: &EsiFile,
        device: &EsiDevice,
        op_mode: Option<usize>,
        profile: &Profile,
        bus: Nanos,
    ) -> Result<Self, NotSimulated> {
        let Some(taken) = op_mode.and_then(|number| TakenOpMode::new(device, number)) else {
            return Ok(Self::without_sync(profile, None, Vec::new()));
        };
        let at = device.op_modes()[taken.number].at;
        taken.run_as(profile, bus).map_err(|Refused { obstacle, words }| {
            let (name, kind) = (taken.name, obstacle.name());
            let message = format!("OpMode \"{name}\" can't be run ({kind}): {words}");
            NotSimulated { obstacle, error: file.error(at, message) }
        })
    }

    /// The mode with SYNC off: SM-synchronous, unless the device announces another one.
    fn without_sync(
        profile: &Profile,
        unit: Option<AssignActivate>,
        mut notes: Vec<Doubt>,
    ) -> Self {
        let types = profile.supported_types();
        let mode = match (profile.states_modes(), types.sm_synchronous()) {
            // A device that announces nothing can't refuse Free Run.
            (true, false) => SyncMode::FreeRun,
            (true, true) => SyncMode::SmSynchronous,
            (false, _) => {
                let words = "the description does not say by what the device works without SYNC; \
                             SM-synchronous is taken";
                notes.push(Doubt::new(DoubtKind::SyncModeNotStated, words.to_owned()));
                SyncMode::SmSynchronous
            }
        };
        let modes = &[SyncMode::SmSynchronous, SyncMode::FreeRun];
        Self { op_mode: None, mode, modes, sync1: None, sync0_cycle: None, unit, notes }
    }
}

/// Why a device can't run in its OpMode at a bus cycle.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Refused {
    obstacle: Obstacle,
    words: String,
}

impl TakenOpMode {
    /// The OpMode with this number, if the device has it.
    pub fn new(device: &EsiDevice, number: usize) -> Option<Self> {
        let mode = device.op_modes().get(number)?;
        let clock_only = device.dc.as_ref().is_some_and(|dc| dc.time_loop_control_only);
        let unit = Unit { clock_only, ..Unit::default() };
        Some(Self { name: mode.name.clone(), number, terms: terms(mode), unit })
    }

    /// The bus cycles at which its pulses repeat with the bus; `None` if there are none.
    pub fn bus_cycles(&self) -> Option<BusCycles> {
        self.terms.bus_cycles(&self.unit)
    }

    /// The settings at a bus cycle.
    pub(crate) fn run_as(&self, profile: &Profile, bus: Nanos) -> Result<RunAs, Refused> {
        let refused = |obstacle, words| Err(Refused { obstacle, words });
        let registers = match self.terms.registers(bus, &self.unit) {
            Ok(registers) => registers,
            Err(problem) => return refused(Obstacle::Sync0Cycle, problem.to_string()),
        };
        let op_mode = Some(self.clone());
        let found: Vec<Warning> = registers.warnings.iter().collect();
        let mut notes: Vec<Doubt> =
            found.iter().map(|warning| Doubt::new(warning.kind(), warning.to_string())).collect();
        let unit = Some(registers.assign_activate);
        if registers.count == 0 {
            return Ok(RunAs { op_mode, ..RunAs::without_sync(profile, unit, notes) });
        }
        if found.contains(&Warning::UnitAtPdi) {
            let words = "the device sets up its SYNC unit itself; a virtual one does not";
            return refused(Obstacle::SyncUnitAtPdi, words.to_owned());
        }
        let cycles = self.bus_cycles();
        if !cycles.is_some_and(|cycles| cycles.contains(bus)) {
            return refused(Obstacle::Sync0Cycle, self.other_cycle(registers.period(), bus));
        }
        let sync0 = Nanos(registers.sync0_cycle.into());
        let types = profile.supported_types();
        let stated = types.0 & ANY_MODE != 0;
        let candidates = registers.modes();
        let supported = candidates.iter().find(|mode| mode.is_supported(types) || !stated);
        let chosen = *supported.unwrap_or(&candidates[0]);
        if registers.phase() != Nanos::ZERO {
            let from = if registers.input_based { "inputs" } else { "outputs" };
            let words = format!(
                "{} behind the reference point of the {from}; the phase is the plan's",
                registers.phase()
            );
            notes.push(Doubt::new(DoubtKind::ShiftTimeSync0, words));
        }
        let word = self.terms.assign_activate;
        // SYNC0 is what SYNC1 is counted from and what these modes copy outputs by.
        let sync1_alone = word.makes_sync1() && !word.makes_sync0();
        if sync1_alone {
            let written = AssignActivate(word.0 | AssignActivate::SYNC0.0);
            let words =
                format!("{word} has no SYNC0, which mode {chosen} needs; {written} is written");
            notes.push(Doubt::new(DoubtKind::Sync0Added, words));
        }
        Ok(RunAs {
            op_mode,
            mode: chosen,
            modes: candidates,
            sync1: match chosen {
                // No distance is given, and none is no answer: what the device needs.
                SyncMode::DcSync1 if sync1_alone && registers.sync1 == 0 => None,
                SyncMode::DcShiftSync1 | SyncMode::DcSync1 => Some(Nanos(registers.sync1.into())),
                SyncMode::DcSubordinated => Some(registers.behind_sync0()),
                _ => None,
            },
            sync0_cycle: (chosen == SyncMode::DcSubordinated).then_some(sync0),
            unit,
            notes,
        })
    }

    /// Why a bus cycle is none of the OpMode's, and which it takes.
    fn other_cycle(&self, period: Nanos, bus: Nanos) -> String {
        let found = format!("its pulses repeat every {period}, the cycle is {bus}");
        let Some(cycles) = self.bus_cycles() else {
            return format!("{found}, and they are never the same; expected another OpMode");
        };
        // A device that is faster than the bus has no slower cycle of its own.
        let alone = match self.terms.assign_activate.makes_sync1() {
            true => "",
            false => ", or of this device alone (cycle beside esi), as a multiple of the bus cycle",
        };
        // A fixed SYNC0 goes with any multiple of it, if SYNC1 comes once in each bus cycle.
        let terms = &self.terms;
        let sync1_each_sync0 = terms.assign_activate.makes_sync1()
            && terms.sync0.value > 0
            && (terms.sync1.value, terms.sync1.factor) == (0, Some(1));
        let factor = match sync1_each_sync0 && bus.0 % terms.sync0.value == 0 {
            true => {
                "; or Factor -1 at CycleTimeSync1, with which SYNC1 comes once in each bus cycle"
            }
            false => "",
        };
        format!(
            "{found}; expected a cycle of {cycles}: of the bus (cycle in the head of the file){alone}{factor}"
        )
    }
}

/// The OpMode in the form for the arithmetic of the SYNC unit.
fn terms(mode: &EsiOpMode) -> opmode::OpMode {
    let cycle = |time: Option<CycleTime>| {
        time.map_or_else(Default::default, |time| opmode::CycleTime {
            value: time.value.0,
            factor: time.factor,
        })
    };
    let shift = |time: ShiftTime| opmode::ShiftTime {
        value: time.value.0,
        factor: time.factor,
        input: time.input,
    };
    opmode::OpMode {
        assign_activate: AssignActivate(mode.assign_activate),
        sync0: cycle(mode.cycle_time_sync0),
        shift0: mode.shift_time_sync0.map(shift).unwrap_or_default(),
        sync1: cycle(mode.cycle_time_sync1),
        shift1: mode.shift_time_sync1.map_or(0, |shift| shift.value.0),
    }
}

/// Bits of 0x1C32:04 that announce a mode.
const ANY_MODE: u16 = 0x001F;

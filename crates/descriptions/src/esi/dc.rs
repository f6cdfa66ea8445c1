//! Distributed clocks: the OpModes of the file, and doubts about each.

use isocat_wire::time::Nanos;

use super::read::{self, U8, U16};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// `Device/Dc`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiDc {
    /// Whether FRMW cannot be used to distribute the time.
    pub unknown_frmw: bool,
    /// Whether the system time has 32 bits.
    pub unknown_64_bit: bool,
    /// Whether it has an external source of time.
    pub external_reference_clock: bool,
    /// Whether it may be the reference clock.
    pub potential_reference_clock: bool,
    /// Whether it has only a system time: SYNC and latch units must not be used.
    pub time_loop_control_only: bool,
    /// OpModes; the first is the default.
    pub op_modes: Vec<EsiOpMode>,
}

/// `Dc/OpMode` as in the file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiOpMode {
    /// Byte offset in the text.
    pub at: usize,
    /// Name; not always unique.
    pub name: String,
    /// Description for people.
    pub description: String,
    /// Low byte for register 0x0980, high byte for 0x0981.
    pub assign_activate: u16,
    /// Cycle of SYNC0.
    pub cycle_time_sync0: Option<CycleTime>,
    /// Phase of SYNC0.
    pub shift_time_sync0: Option<ShiftTime>,
    /// Cycle of SYNC1.
    pub cycle_time_sync1: Option<CycleTime>,
    /// Time from SYNC0 to SYNC1, in addition to the cycle.
    pub shift_time_sync1: Option<ShiftTime>,
    /// PDO assignments that replace the default ones.
    pub assignments: Vec<OpModeAssignment>,
}

/// A cycle: a time, or a factor if the time is 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CycleTime {
    /// Time; 0 if the factor is used.
    pub value: Nanos,
    /// Positive: multiple of the cycle; negative: divisor of the bus cycle.
    pub factor: Option<i32>,
}

/// A phase.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ShiftTime {
    /// Time, may be negative.
    pub value: Nanos,
    /// Adds this many SYNC0 cycles; if negative, one SYNC0 cycle divided by this number.
    pub factor: Option<i32>,
    /// Whether it counts from the reference point of the inputs instead of that of the outputs.
    pub input: bool,
}

/// `OpMode/Sm` with PDOs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct OpModeAssignment {
    /// SyncManager.
    pub sync_manager: u8,
    /// PDO indices, each with its oversampling factor in this mode.
    pub pdos: Vec<(u16, Option<u16>)>,
}

impl EsiOpMode {
    /// Whether SYNC0 is generated.
    pub const fn sync0(&self) -> bool {
        self.assign_activate & (ACTIVE | SYNC0) == ACTIVE | SYNC0
    }

    /// Whether SYNC1 is generated.
    pub const fn sync1(&self) -> bool {
        self.assign_activate & (ACTIVE | SYNC1) == ACTIVE | SYNC1
    }

    /// Whether SYNC0 or SYNC1 is generated.
    pub(crate) const fn has_pulses(&self) -> bool {
        self.sync0() || self.sync1()
    }
}

/// Reads the DC part of a device.
pub(super) fn read(device: Element<'_>, warnings: &mut Warnings) -> Result<Option<EsiDc>, Problem> {
    let Some(element) = device.child("Dc") else { return Ok(None) };
    let mut dc = EsiDc {
        unknown_frmw: read::flag(element, "UnknownFRMW")?,
        unknown_64_bit: read::flag(element, "Unknown64Bit")?,
        external_reference_clock: read::flag(element, "ExternalRefClock")?,
        potential_reference_clock: read::flag(element, "PotentialReferenceClock")?,
        time_loop_control_only: read::flag(element, "TimeLoopControlOnly")?,
        op_modes: Vec::new(),
    };
    for child in element.children("OpMode") {
        let mode = op_mode(child, warnings)?;
        doubts(&mode, dc.time_loop_control_only, warnings);
        if dc.op_modes.iter().any(|before| before.name == mode.name) {
            warnings.add(WarningKind::OpModeNameRepeated, mode.at, || {
                format!("\"{}\" stands twice; choose by its number", read::cut(&mode.name))
            });
        }
        dc.op_modes.push(mode);
    }
    if let [first, others @ ..] = &dc.op_modes[..]
        && !first.has_pulses()
        && let Some(with) = others.iter().find(|mode| mode.has_pulses())
    {
        warnings.add(WarningKind::FirstOpModeWithoutDc, first.at, || {
            format!(
                "the default, \"{}\", has neither SYNC0 nor SYNC1; \"{}\" has",
                read::cut(&first.name),
                read::cut(&with.name)
            )
        });
    }
    Ok(Some(dc))
}

fn op_mode(element: Element<'_>, warnings: &mut Warnings) -> Result<EsiOpMode, Problem> {
    let at = element.at();
    let assign_activate = read::child(element, "AssignActivate", U16, warnings)?;
    if assign_activate.is_none() {
        warnings.add(WarningKind::AssignActivateMissing, at, || "taken as #x0000".to_owned());
    }
    let mut assignments = Vec::new();
    for sm in element.children("Sm") {
        let obsolete = ["SyncType", "CycleTime", "ShiftTime"];
        if let Some(old) = sm.elements().find(|child| obsolete.contains(&child.name())) {
            warnings.add(WarningKind::OpModeObsolete, old.at(), || {
                format!("{} is of an old version of the format; it is not used", old.name())
            });
        }
        let mut pdos = Vec::new();
        for pdo in sm.children("Pdo") {
            let index = read::integer(&pdo.text(), pdo.at(), "Pdo", U16, warnings)? as u16;
            let factor = read::attribute(pdo, "OSFac", U16, warnings)?.map(|factor| factor as u16);
            pdos.push((index, factor));
        }
        if let Some(number) = read::attribute(sm, "No", U8, warnings)? {
            // An empty list assigns nothing, an absent one leaves the default.
            if !pdos.is_empty() || sm.elements().next().is_none() {
                assignments.push(OpModeAssignment { sync_manager: number as u8, pdos });
            }
        }
    }
    Ok(EsiOpMode {
        at,
        name: element.child_text("Name").into_owned(),
        description: element.child_text("Desc").into_owned(),
        assign_activate: assign_activate.unwrap_or(0) as u16,
        cycle_time_sync0: cycle_time(element, "CycleTimeSync0", warnings)?,
        shift_time_sync0: shift_time(element, "ShiftTimeSync0", warnings)?,
        cycle_time_sync1: cycle_time(element, "CycleTimeSync1", warnings)?,
        shift_time_sync1: shift_time(element, "ShiftTimeSync1", warnings)?,
        assignments,
    })
}

fn cycle_time(
    mode: Element<'_>,
    name: &'static str,
    warnings: &mut Warnings,
) -> Result<Option<CycleTime>, Problem> {
    let Some(element) = mode.child(name) else { return Ok(None) };
    let text = element.text();
    let value = match &*text {
        "" => 0,
        text => read::integer(text, element.at(), name, 0..=i64::from(i32::MAX), warnings)?,
    };
    Ok(Some(CycleTime { value: Nanos(value), factor: factor(element, warnings)? }))
}

fn shift_time(
    mode: Element<'_>,
    name: &'static str,
    warnings: &mut Warnings,
) -> Result<Option<ShiftTime>, Problem> {
    let Some(element) = mode.child(name) else { return Ok(None) };
    let text = element.text();
    let value = match &*text {
        "" => 0,
        text => read::integer(text, element.at(), name, I32, warnings)?,
    };
    let input = read::flag(element, "Input")?;
    Ok(Some(ShiftTime { value: Nanos(value), factor: factor(element, warnings)?, input }))
}

fn factor(element: Element<'_>, warnings: &mut Warnings) -> Result<Option<i32>, Problem> {
    Ok(read::attribute(element, "Factor", I32, warnings)?.map(|factor| factor as i32))
}

/// Collects the doubts about a mode.
fn doubts(mode: &EsiOpMode, time_loop_control_only: bool, warnings: &mut Warnings) {
    let name = || read::cut(&mode.name);
    let word = mode.assign_activate;
    if !USUAL.contains(&word) {
        warnings.add(WarningKind::AssignActivateUnusual, mode.at, || {
            format!("\"{}\" has {word:#06x}", name())
        });
    }
    let cycle = mode.cycle_time_sync0;
    let (value, factor) = cycle.map_or((0, 0), |cycle| (cycle.value.0, cycle.factor.unwrap_or(0)));
    if mode.sync1() && !mode.sync0() {
        warnings.add(WarningKind::Sync1Alone, mode.at, || {
            format!("\"{}\" has {word:#06x}: SYNC1 without SYNC0, which it is counted from", name())
        });
    }
    if mode.has_pulses() && !time_loop_control_only {
        if value == 0 && factor == 0 {
            warnings.add(WarningKind::Sync0CycleMissing, mode.at, || {
                format!("\"{}\": the bus cycle is taken for SYNC0", name())
            });
        }
        if value != 0 {
            warnings.add(WarningKind::Sync0CycleFixed, mode.at, || {
                format!("\"{}\": SYNC0 every {}, in no other cycle", name(), Nanos(value))
            });
            if factor != 0 {
                warnings.add(WarningKind::Sync0CycleTwice, mode.at, || {
                    format!("\"{}\": {} and factor {factor}; the time counts", name(), Nanos(value))
                });
            }
            if value < SHORT {
                warnings.add(WarningKind::Sync0CycleShort, mode.at, || {
                    format!("\"{}\": {} is below {}", name(), Nanos(value), Nanos(SHORT))
                });
            }
        }
    }
    if mode.sync0() && !mode.sync1() {
        let used = mode
            .cycle_time_sync1
            .is_some_and(|cycle| cycle.value.0 != 0 || cycle.factor.unwrap_or(0) != 0);
        if used {
            warnings.add(WarningKind::Sync1Unused, mode.at, || {
                format!("\"{}\": a cycle of SYNC1, but {word:#06x} leaves it off", name())
            });
        }
    }
    let shifts = [mode.shift_time_sync0, mode.shift_time_sync1];
    if let Some(shift) = shifts.into_iter().flatten().find(|shift| shift.value.0.abs() >= HUGE) {
        warnings.add(WarningKind::ShiftTimeHuge, mode.at, || {
            format!("\"{}\" shifts by {}; its rest within the cycle counts", name(), shift.value)
        });
    }
}

const ACTIVE: u16 = 0x0100;
const SYNC0: u16 = 0x0200;
const SYNC1: u16 = 0x0400;
const I32: std::ops::RangeInclusive<i64> = i32::MIN as i64..=i32::MAX as i64;
/// AssignActivate words of known devices.
const USUAL: [u16; 14] = [
    0x0000, 0x0030, 0x0100, 0x0120, 0x0130, 0x0300, 0x0310, 0x0320, 0x0330, 0x0500, 0x0700, 0x0710,
    0x0720, 0x0730,
];
const SHORT: i64 = 10_000;
const HUGE: i64 = 1_000_000_000;

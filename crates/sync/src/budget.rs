//! The timing budget: where in the cycle SYNC0 must lie, and how much time each demand leaves over.
//!
//! All phases count from the start of the system-time cycle. The frame finds the reference clock at
//! [`Cycle::send`]; at a SubDevice its last output byte is stored [`Device::outputs_arrival`] later.
//!
//! ```text
//!   send        arrival      ready                   SYNC0                        next frame
//!    |-- frame --|-- 1C32:06 --|······ slack ·········|-- 1C33:03, 1C33:06 --|·· slack ··|
//!                                                      |-- 1C32:03 or :09 --> outputs valid
//! ```

use core::fmt;

use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::mode::SyncMode;
use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use crate::pulses::Pulses;

/// What all SubDevices share.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cycle {
    /// Bus cycle.
    pub cycle: Nanos,
    /// Phase at which the frame finds the reference clock.
    pub send: Nanos,
    /// A frame may be later than planned by this much, never earlier.
    pub jitter: Nanos,
    /// Two clocks of the segment may differ by this much.
    pub clock_error: Nanos,
}

/// One SubDevice's demands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Device {
    /// How it is synchronized.
    pub mode: SyncMode,
    /// Its SYNC pulses; nothing without DC.
    pub pulses: Pulses,
    /// From the frame at the reference clock until the last output byte is stored here; `None` if it
    /// has no outputs.
    pub outputs_arrival: Option<Nanos>,
    /// From the frame at the reference clock until the frame that fetches the inputs begins here;
    /// `None` if it has no inputs.
    pub inputs_fetched: Option<Nanos>,
    /// 0x1C32:05, 0x1C33:05: the larger one.
    pub minimum_cycle: Nanos,
    /// 0x1C32:06.
    pub output_calc_and_copy: Nanos,
    /// 0x1C32:09.
    pub output_delay: Nanos,
    /// 0x1C32:03, if outputs are shifted by a local timer.
    pub output_shift: Option<Nanos>,
    /// 0x1C33:06.
    pub input_calc_and_copy: Nanos,
    /// 0x1C33:03, if inputs are shifted by a local timer; else zero.
    pub input_shift: Nanos,
    /// 0x1C33:09: counts where SYNC1 takes the inputs.
    pub input_delay: Nanos,
}

impl Device {
    /// Phase of its SYNC0, with the acting pulse at `shift`.
    pub fn sync0_phase(&self, shift: Nanos) -> Nanos {
        let phase = shift - self.pulses.lead;
        Nanos(phase.0.checked_rem_euclid(self.pulses.sync0_cycle.0).unwrap_or(phase.0))
    }
}

/// A demand on the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Check {
    /// The cycle is not shorter than the SubDevice's minimum.
    MinimumCycle,
    /// Outputs are copied and calculated before the pulse that lets them act.
    OutputsBeforeSync0,
    /// Outputs are stored before the SYNC0 that fetches them.
    OutputsStoredBeforeSync0,
    /// SYNC1 leaves the time to copy and calculate from SYNC0 on.
    Sync1CoversCopy,
    /// SYNC1 comes before the next SYNC0.
    Sync1BeforeNextSync0,
    /// Inputs stand in the buffer before the frame that fetches them.
    InputsBeforeFrame,
    /// The shift of Outputs Valid is not shorter than the hardware needs.
    ShiftCoversDelay,
    /// Shifted outputs become valid within the cycle.
    ShiftWithinCycle,
}

impl Check {
    /// The object that states the demand.
    pub const fn object(self) -> ObjectAddress {
        let (index, sub) = match self {
            Check::MinimumCycle => (OUTPUT_PARAMETER, sub::MINIMUM_CYCLE_TIME),
            Check::OutputsBeforeSync0
            | Check::OutputsStoredBeforeSync0
            | Check::Sync1CoversCopy => (OUTPUT_PARAMETER, sub::CALC_AND_COPY_TIME),
            Check::Sync1BeforeNextSync0 => (OUTPUT_PARAMETER, sub::CYCLE_TIME),
            Check::InputsBeforeFrame => (INPUT_PARAMETER, sub::CALC_AND_COPY_TIME),
            Check::ShiftCoversDelay => (OUTPUT_PARAMETER, sub::DELAY_TIME),
            Check::ShiftWithinCycle => (OUTPUT_PARAMETER, sub::SHIFT_TIME),
        };
        ObjectAddress::new(index, sub)
    }

    /// The demand in words: what must not exceed what.
    pub const fn words(self) -> &'static str {
        match self {
            Check::MinimumCycle => "minimum cycle time (plus send jitter in SM mode) <= cycle",
            Check::OutputsBeforeSync0 => {
                "outputs stored + send jitter + clock error + calc and copy time <= SYNC0"
            }
            Check::OutputsStoredBeforeSync0 => {
                "outputs stored + send jitter + clock error <= SYNC0 that fetches them"
            }
            Check::Sync1CoversCopy => "calc and copy time <= SYNC1 - SYNC0",
            Check::Sync1BeforeNextSync0 => "SYNC1 - SYNC0 < SYNC0 cycle",
            Check::InputsBeforeFrame => {
                "pulse of Input Latch + input shift + calc and copy time + clock error <= next frame"
            }
            Check::ShiftCoversDelay => "delay time <= shift time",
            Check::ShiftWithinCycle => "shift time < cycle",
        }
    }
}

/// One line of the budget.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Line {
    /// The demand.
    pub check: Check,
    /// Time needed.
    pub needed: Nanos,
    /// Time there is.
    pub available: Nanos,
}

impl Line {
    /// What is left; negative if the demand is not met.
    pub fn slack(&self) -> Nanos {
        self.available - self.needed
    }
    /// Whether the demand is met.
    pub fn fits(&self) -> bool {
        self.slack() >= Nanos::ZERO
    }
}

/// `0x1C32:05: minimum cycle time <= cycle: needs 250 us, has 125 us, slack -125 us`
impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Line { check, needed, available } = self;
        let (object, words, slack) = (check.object(), check.words(), self.slack());
        write!(f, "{object}: {words}: needs {needed}, has {available}, slack {slack}")
    }
}

/// The lines of one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Budget {
    lines: [Option<Line>; 8],
}

impl Budget {
    /// All lines that the SubDevice's mode has.
    pub fn lines(&self) -> impl Iterator<Item = Line> + '_ {
        self.lines.iter().flatten().copied()
    }
    /// The line with this demand, if the mode has it.
    pub fn line(&self, check: Check) -> Option<Line> {
        self.lines().find(|line| line.check == check)
    }
    /// The line with the least slack that does not fit.
    pub fn failure(&self) -> Option<Line> {
        self.lines().filter(|line| !line.fits()).min_by_key(Line::slack)
    }
    /// The least slack.
    pub fn slack(&self) -> Option<Nanos> {
        self.lines().map(|line| line.slack()).min()
    }

    fn push(&mut self, check: Check, needed: Nanos, available: Nanos) {
        if let Some(free) = self.lines.iter_mut().find(|line| line.is_none()) {
            *free = Some(Line { check, needed, available });
        }
    }
}

/// SYNC0's phase for all SubDevices in DC SYNC0 together: in the middle between the latest moment at
/// which outputs are ready and the earliest at which inputs must be begun, in whole microseconds. `None` if no
/// SubDevice uses SYNC0.
///
/// One phase for all, so that their outputs switch together. If nothing fits it is the middle all the same,
/// and [`budget`] names the lines that fail.
pub fn common_shift<'a>(
    cycle: &Cycle,
    devices: impl IntoIterator<Item = &'a Device>,
) -> Option<Nanos> {
    let mut earliest = cycle.send;
    let mut latest = cycle.send + cycle.cycle;
    let mut used = false;
    for device in devices.into_iter().filter(|device| device.mode.uses_dc()) {
        used = true;
        earliest = earliest.max(outputs_ready(cycle, device).unwrap_or(earliest));
        if let Some(fetched) = device.inputs_fetched {
            latest = latest.min(cycle.send + cycle.cycle + fetched - input_time(cycle, device));
        }
    }
    let middle = (earliest.0 + latest.0).div_euclid(2);
    used.then_some(Nanos(middle.div_euclid(1_000) * 1_000))
}

/// The budget of one SubDevice with SYNC0 at `shift`.
pub fn budget(cycle: &Cycle, shift: Nanos, device: &Device) -> Budget {
    let mut budget = Budget::default();
    let jitter = if device.mode == SyncMode::SmSynchronous { cycle.jitter } else { Nanos::ZERO };
    let own_cycle = match device.mode {
        SyncMode::DcSubordinated => device.pulses.sync0_cycle,
        _ => cycle.cycle,
    };
    budget.push(Check::MinimumCycle, device.minimum_cycle + jitter, own_cycle);
    if !device.mode.uses_dc() {
        return budget;
    }
    if let Some(ready) = outputs_ready(cycle, device) {
        let pulses = &device.pulses;
        if device.mode == SyncMode::DcSync1 {
            let stored = ready - pulses.sync1;
            budget.push(Check::OutputsStoredBeforeSync0, stored, shift - pulses.lead);
            budget.push(Check::Sync1CoversCopy, device.output_calc_and_copy, pulses.sync1);
        } else {
            let lead =
                if device.mode == SyncMode::DcShiftSync1 { pulses.lead } else { Nanos::ZERO };
            budget.push(Check::OutputsBeforeSync0, ready - lead, shift - lead);
        }
    }
    if matches!(device.mode, SyncMode::DcSync1 | SyncMode::DcShiftSync1) {
        let needed = device.pulses.sync1 + Nanos(1);
        budget.push(Check::Sync1BeforeNextSync0, needed, device.pulses.sync0_cycle);
    }
    if let Some(fetched) = device.inputs_fetched {
        let next_frame = cycle.send + cycle.cycle + fetched;
        budget.push(Check::InputsBeforeFrame, shift + input_time(cycle, device), next_frame);
    }
    if let Some(output_shift) = device.output_shift {
        budget.push(Check::ShiftCoversDelay, device.output_delay, output_shift);
        budget.push(Check::ShiftWithinCycle, output_shift + Nanos(1), cycle.cycle);
    }
    budget
}

/// Earliest phase at which the acting pulse may come for the outputs' sake.
fn outputs_ready(cycle: &Cycle, device: &Device) -> Option<Nanos> {
    let arrival = cycle.send + device.outputs_arrival? + cycle.jitter + cycle.clock_error;
    Some(match device.mode {
        // SYNC0 fetches them, SYNC1 is the acting pulse.
        SyncMode::DcSync1 => arrival + device.pulses.sync1,
        SyncMode::DcShiftSync1 => arrival + device.output_calc_and_copy + device.pulses.lead,
        _ => arrival + device.output_calc_and_copy,
    })
}

/// Time from the acting pulse until inputs stand in the buffer.
fn input_time(cycle: &Cycle, device: &Device) -> Nanos {
    let pulses = &device.pulses;
    let latch = match device.mode {
        SyncMode::DcShiftSync1 => pulses.sync1 - pulses.lead + device.input_delay,
        SyncMode::DcSync1 => Nanos::ZERO,
        SyncMode::DcSubordinated => device.input_shift - pulses.behind_sync0(),
        _ => device.input_shift,
    };
    latch + device.input_calc_and_copy + cycle.clock_error
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const CYCLE: Cycle = Cycle {
        cycle: Nanos(1_000_000),
        send: Nanos(0),
        jitter: Nanos(20_000),
        clock_error: Nanos(100),
    };

    fn drive() -> Device {
        Device {
            mode: SyncMode::DcSync0,
            pulses: Pulses { sync0_cycle: Nanos(1_000_000), ..Pulses::default() },
            outputs_arrival: Some(Nanos(12_345)),
            inputs_fetched: Some(Nanos(1_000)),
            minimum_cycle: Nanos(250_000),
            output_calc_and_copy: Nanos(60_000),
            output_delay: Nanos(30_000),
            output_shift: None,
            input_calc_and_copy: Nanos(40_000),
            input_shift: Nanos(0),
            input_delay: Nanos(700),
        }
    }

    fn slack(cycle: &Cycle, shift: i64, device: &Device, check: Check) -> i64 {
        budget(cycle, Nanos(shift), device).line(check).unwrap().slack().0
    }

    #[test]
    fn outputs_ready_to_the_nanosecond() {
        let ready = 12_345 + 20_000 + 100 + 60_000;
        assert_eq!(slack(&CYCLE, ready, &drive(), Check::OutputsBeforeSync0), 0);
        let late = budget(&CYCLE, Nanos(ready - 1), &drive());
        assert_eq!(late.failure().unwrap().check, Check::OutputsBeforeSync0);
        assert_eq!(late.failure().unwrap().slack(), Nanos(-1));
    }

    #[test]
    fn inputs_before_the_next_frame_to_the_nanosecond() {
        let last = 1_000_000 + 1_000 - 40_000 - 100;
        assert_eq!(slack(&CYCLE, last, &drive(), Check::InputsBeforeFrame), 0);
        assert_eq!(slack(&CYCLE, last + 1, &drive(), Check::InputsBeforeFrame), -1);
        let shifted = Device { input_shift: Nanos(1), ..drive() };
        assert_eq!(slack(&CYCLE, last, &shifted, Check::InputsBeforeFrame), -1);
    }

    #[test]
    fn minimum_cycle_names_both_figures() {
        let short = Cycle { cycle: Nanos(125_000), ..CYCLE };
        let failure = budget(&short, Nanos(100_000), &drive()).failure().unwrap();
        let text = failure.to_string();
        assert!(text.starts_with("0x1C32:05: minimum cycle time"), "{text}");
        assert!(text.contains("needs 250 us, has 125 us"), "{text}");
        let exact = Device { mode: SyncMode::SmSynchronous, ..drive() };
        let cycle = |ns| Cycle { cycle: Nanos(ns), ..CYCLE };
        assert_eq!(slack(&cycle(270_000), 0, &exact, Check::MinimumCycle), 0);
        assert_eq!(slack(&cycle(269_999), 0, &exact, Check::MinimumCycle), -1);
    }

    #[test]
    fn shift_covers_the_delay_and_stays_in_the_cycle() {
        let with = |ns| Device { output_shift: Some(Nanos(ns)), ..drive() };
        assert_eq!(slack(&CYCLE, 500_000, &with(30_000), Check::ShiftCoversDelay), 0);
        assert_eq!(slack(&CYCLE, 500_000, &with(29_999), Check::ShiftCoversDelay), -1);
        assert_eq!(slack(&CYCLE, 500_000, &with(999_999), Check::ShiftWithinCycle), 0);
        assert_eq!(slack(&CYCLE, 500_000, &with(1_000_000), Check::ShiftWithinCycle), -1);
    }

    #[test]
    fn the_common_shift_shares_the_slack() {
        let slow = Device { output_calc_and_copy: Nanos(300_000), ..drive() };
        let shift = common_shift(&CYCLE, [&drive(), &slow]).unwrap();
        let before = slack(&CYCLE, shift.0, &slow, Check::OutputsBeforeSync0);
        let after = slack(&CYCLE, shift.0, &drive(), Check::InputsBeforeFrame);
        assert!((before - after).abs() <= 2_000, "{before} {after}");
        let free = Device { mode: SyncMode::FreeRun, ..drive() };
        assert_eq!(common_shift(&CYCLE, [&free]), None);
    }

    /// SYNC0 fetches, SYNC1 acts: both distances to the nanosecond.
    #[test]
    fn dc_sync1_needs_the_outputs_before_sync0_and_the_copy_time_before_sync1() {
        let distance = |sync1| Device {
            mode: SyncMode::DcSync1,
            pulses: Pulses::new(SyncMode::DcSync1, CYCLE.cycle, Nanos(sync1), Nanos::ZERO, false),
            ..drive()
        };
        let device = distance(60_000);
        let stored = 12_345 + 20_000 + 100;
        let at = |shift, device: &Device, check| slack(&CYCLE, shift, device, check);
        assert_eq!(at(stored + 60_000, &device, Check::OutputsStoredBeforeSync0), 0);
        assert_eq!(at(stored + 59_999, &device, Check::OutputsStoredBeforeSync0), -1);
        assert_eq!(at(500_000, &device, Check::Sync1CoversCopy), 0);
        assert_eq!(at(500_000, &distance(59_999), Check::Sync1CoversCopy), -1);
        assert_eq!(at(500_000, &distance(999_999), Check::Sync1BeforeNextSync0), 0);
        assert_eq!(at(500_000, &distance(1_000_000), Check::Sync1BeforeNextSync0), -1);
        assert_eq!(device.sync0_phase(Nanos(500_000)), Nanos(440_000));
        assert_eq!(device.sync0_phase(Nanos(50_000)), Nanos(990_000));
        // Inputs are taken at SYNC1 itself.
        let last = 1_000_000 + 1_000 - 40_000 - 100;
        assert_eq!(at(last, &device, Check::InputsBeforeFrame), 0);
    }

    #[test]
    fn inputs_at_sync1_come_later_than_the_outputs() {
        let device = Device {
            mode: SyncMode::DcShiftSync1,
            pulses: Pulses::new(
                SyncMode::DcShiftSync1,
                CYCLE.cycle,
                Nanos(200_000),
                Nanos::ZERO,
                false,
            ),
            ..drive()
        };
        let last = 1_000_000 + 1_000 - 200_000 - 700 - 40_000 - 100;
        assert_eq!(slack(&CYCLE, last, &device, Check::InputsBeforeFrame), 0);
        assert_eq!(slack(&CYCLE, last + 1, &device, Check::InputsBeforeFrame), -1);
        let ready = 12_345 + 20_000 + 100 + 60_000;
        assert_eq!(slack(&CYCLE, ready, &device, Check::OutputsBeforeSync0), 0);
        // Outputs at SYNC1 too: everything counts from there.
        let both = Device { pulses: Pulses { lead: Nanos(200_000), ..device.pulses }, ..device };
        assert_eq!(slack(&CYCLE, ready + 200_000, &both, Check::OutputsBeforeSync0), 0);
        assert_eq!(slack(&CYCLE, last + 200_000, &both, Check::InputsBeforeFrame), 0);
    }

    #[test]
    fn a_subordinated_cycle_is_measured_by_its_own_sync0() {
        let device = |sync0| Device {
            mode: SyncMode::DcSubordinated,
            pulses: Pulses::new(
                SyncMode::DcSubordinated,
                CYCLE.cycle,
                Nanos::ZERO,
                Nanos(sync0),
                false,
            ),
            ..drive()
        };
        assert_eq!(slack(&CYCLE, 500_000, &device(250_000), Check::MinimumCycle), 0);
        assert_eq!(slack(&CYCLE, 500_000, &device(125_000), Check::MinimumCycle), -125_000);
        assert_eq!(device(250_000).sync0_phase(Nanos(500_000)), Nanos(0));
    }
}

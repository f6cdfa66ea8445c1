//! The timing budget: where in the cycle SYNC0 must lie, and how much slack each demand has.
//!
//! All phases count from the start of the system-time cycle. The frame finds the reference clock at
//! [`Cycle::send`]; at a SubDevice its last output byte is stored [`Device::outputs_arrival`]
//! later.
//!
//! ```text
//!   send        arrival      ready                   SYNC0                        next frame
//!    |-- frame --|-- 1C32:06 --|······ slack ·········|-- 1C33:03, 1C33:06 --|·· slack ··|
//!                                                      |-- 1C32:03 or :09 --> outputs valid
//! ```
//!
//! A [`Check`] names a demand: one time that must not exceed another. Its [`Demand`] has both sides
//! as sums, whose [`Term`]s name each figure and its origin; a [`Line`] is the short form of the
//! demand. [`window`] gives the phases of the acting pulse that one SubDevice allows, and
//! [`moments`] the time span of each event.

use isocat_wire::time::Nanos;

use crate::mode::SyncMode;
use crate::pulses::{Pulses, SyncSignal};

mod check;
mod clocks;
mod line;
mod moments;
mod term;
#[cfg(test)]
mod tests;

pub use check::{Check, Sign, Source};
pub use clocks::{Tracking, USUAL_DEVIATION_PPB, clock_error};
pub use line::{Budget, Demand, Line};
pub use moments::{Moments, Span, moments};
pub use term::{Origin, Origins, Quantity, Sum, Term};

/// The figures that all SubDevices share.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cycle {
    /// Bus cycle.
    pub cycle: Nanos,
    /// Phase at which the frame finds the reference clock.
    pub send: Nanos,
    /// A frame may be later than planned by this much; it is never earlier.
    pub jitter: Nanos,
    /// The part of [`Cycle::jitter`] that the hops cause; the host causes the rest.
    pub hop_jitter: Nanos,
    /// In a ring: a frame that takes the longest way meets the reference clock this much later than
    /// planned. 0 on a line.
    pub ring_way: Nanos,
    /// Two clocks of the segment may differ by this much.
    pub clock_error: Nanos,
    /// Where the clock error comes from.
    pub clock_error_origin: Origin,
    /// The reference clock's oscillator may be faster or slower than the wire's bit clock by this
    /// much, ppb.
    pub clock_deviation_ppb: i64,
    /// The limits within which a SubDevice counts as synchronized.
    pub limits: Limits,
}

/// The limits within which a SubDevice counts as synchronized. The judges of a run and the plan
/// both reject larger errors.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest distance of a SYNC0 edge from the grid that was asked for.
    pub sync0_error: Nanos,
    /// Largest spread of the time from the acting pulse to Outputs Valid.
    pub outputs_spread: Nanos,
}

impl Default for Limits {
    /// 1 us for both. For SYNC0 this is the limit that the field calls synchronous; a healthy
    /// segment is far below it. For outputs it is the distance of minimum and maximum delay time,
    /// 0x1C32:07 and :09, that ETG.1020 allows.
    fn default() -> Self {
        Self { sync0_error: Nanos::micros(1), outputs_spread: Nanos::micros(1) }
    }
}

/// The limits of a SYNC unit's cycles that no object states: a device tells them only by its
/// refusal of SAFEOP. `None`: no limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SyncLimits {
    /// The longest time that it takes in 0x09A0 and 0x09A4; more than 0.
    pub longest: Option<Nanos>,
    /// 0x09A0 must be a multiple of this; more than 0.
    pub step: Option<Nanos>,
}

/// The figures of one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Device {
    /// Its synchronization mode.
    pub mode: SyncMode,
    /// Its SYNC pulses; zero without DC.
    pub pulses: Pulses,
    /// What ends the pulses of its SYNC signals. No object states it.
    pub sync_signal: SyncSignal,
    /// Its process data are exchanged in every n-th bus cycle; 1 or more.
    pub every: u32,
    /// How much earlier the frames with its process data arrive in cycles without the frames of
    /// other groups before them.
    pub frame_spread: Nanos,
    /// In a ring: how much earlier its frames arrive on the shortest way than on the longest. The
    /// arrivals are those of the longest way. 0 on a line.
    pub ring_spread: Nanos,
    /// Propagation delay from the reference clock. It is the part of both arrivals that does not
    /// depend on the frames.
    pub delay: Nanos,
    /// Time from the frame's arrival at the reference clock until the last output byte is stored
    /// here, in the fullest cycle; `None` without outputs.
    pub outputs_arrival: Option<Nanos>,
    /// Time from the frame's arrival at the reference clock until the frame that fetches the inputs
    /// begins here, in a cycle without frames of other groups before it; `None` without inputs.
    pub inputs_fetched: Option<Nanos>,
    /// Time from the frame's arrival at the reference clock until the frame that fetches the inputs
    /// has passed here, in the fullest cycle: the SM3 event.
    pub inputs_read: Option<Nanos>,
    /// How long outputs stay valid without new ones (registers 0x0400, 0x0420). `None`: no
    /// watchdog, or no outputs.
    pub watchdog: Option<Nanos>,
    /// The larger of 0x1C32:05 and 0x1C33:05.
    pub minimum_cycle: Nanos,
    /// The cycles of SYNC0 that it takes beside its minimum.
    pub sync_limits: SyncLimits,
    /// 0x1C32:06.
    pub output_calc_and_copy: Nanos,
    /// 0x1C32:09.
    pub output_delay: Nanos,
    /// 0x1C32:03, if outputs are shifted by a local timer.
    pub output_shift: Option<Nanos>,
    /// 0x1C33:06.
    pub input_calc_and_copy: Nanos,
    /// 0x1C33:03 if inputs are shifted by a local timer; otherwise zero.
    pub input_shift: Nanos,
    /// 0x1C33:09. It counts where SYNC1 latches the inputs.
    pub input_delay: Nanos,
    /// How much later than the pulse its steps may begin. No object states it.
    pub pulse_jitter: Nanos,
    /// The difference of the longest and the shortest time from the acting pulse to Outputs Valid.
    /// No object states it.
    pub outputs_spread: Nanos,
    /// Its oscillator may be faster or slower than the reference clock's by this much, ppb.
    pub clock_deviation_ppb: i64,
    /// Where these figures come from.
    pub origins: Origins,
}

impl Device {
    /// Phase of its SYNC0, with the acting pulse at `shift`.
    pub fn sync0_phase(&self, shift: Nanos) -> Nanos {
        let phase = shift - self.pulses.lead;
        Nanos(phase.0.checked_rem_euclid(self.pulses.sync0_cycle.0).unwrap_or(phase.0))
    }

    /// Time from one exchange of its process data to the next.
    pub fn exchange(&self, cycle: &Cycle) -> Nanos {
        Nanos(cycle.cycle.0 * i64::from(self.every))
    }

    /// The shift of its outputs by a local timer, if its mode has one. An output that acts at SYNC1
    /// is shifted by SYNC1, and 0x1C32:03 is not used (ETG.1020, columns "DC SYNC1" and "DC shift
    /// SYNC1").
    pub fn timed_output_shift(&self) -> Option<Nanos> {
        let timed = match self.mode {
            SyncMode::FreeRun | SyncMode::SmSynchronous | SyncMode::DcSync1 => false,
            SyncMode::DcShiftSync1 => self.pulses.lead == Nanos::ZERO,
            SyncMode::DcSync0 | SyncMode::DcSubordinated => true,
        };
        self.output_shift.filter(|_| timed)
    }

    /// Time from the acting pulse to Outputs Valid: the shift, but at least the delay of the
    /// hardware.
    pub fn outputs_act_after(&self) -> Nanos {
        self.timed_output_shift().unwrap_or(Nanos::ZERO).max(self.output_delay)
    }

    /// Time from SYNC1 to Input Latch where SYNC1 latches the inputs. Without outputs only
    /// 0x1C33:01 tells the mode, and the device then latches inputs at SYNC1 itself.
    fn delay_behind_sync1(&self) -> Nanos {
        if self.outputs_arrival.is_some() { self.input_delay } else { Nanos::ZERO }
    }

    /// Time from Start Input Latch to Input Latch (0x1C33:09), where SYNC1 or a local timer starts
    /// the latch; `None` where the pulse itself latches, or where no delay is stated.
    pub fn input_latch_delay(&self) -> Option<Nanos> {
        let delay = match self.mode {
            SyncMode::DcShiftSync1 => self.delay_behind_sync1(),
            _ if self.shifts_inputs() => self.input_delay,
            _ => Nanos::ZERO,
        };
        (delay > Nanos::ZERO).then_some(delay)
    }

    /// Whether a local timer shifts its inputs. The mode must have such a shift.
    pub fn shifts_inputs(&self) -> bool {
        let modes = [SyncMode::SmSynchronous, SyncMode::DcSync0, SyncMode::DcSubordinated];
        self.input_shift > Nanos::ZERO && modes.contains(&self.mode)
    }
}

/// The phases of the acting pulse that one SubDevice allows; `None` means no limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Window {
    /// The earliest phase: before it the outputs are not ready or, without outputs, the inputs not
    /// read.
    pub earliest: Option<Nanos>,
    /// The latest phase: after it the inputs miss the frame that fetches them.
    pub latest: Option<Nanos>,
}

/// The window of a SubDevice with DC; empty for others.
pub fn window(cycle: &Cycle, device: &Device) -> Window {
    if !device.mode.uses_dc() {
        return Window::default();
    }
    let side = |check| line::demand(cycle, Nanos::ZERO, device, check);
    Window {
        earliest: side(before_pulse(device)).map(|demand| -demand.slack()),
        latest: side(Check::InputsBeforeFrame).map(|demand| demand.slack()),
    }
}

/// The check that keeps the acting pulse behind the frame.
const fn before_pulse(device: &Device) -> Check {
    match device.mode {
        _ if device.outputs_arrival.is_none() => Check::InputsReadBeforeSync0,
        SyncMode::DcSync1 => Check::OutputsStoredBeforeSync0,
        _ => Check::OutputsBeforeSync0,
    }
}

/// The window that all SubDevices allow together: the output reference and the input reference.
pub fn common_window<'a>(
    cycle: &Cycle,
    devices: impl IntoIterator<Item = &'a Device>,
) -> Option<Window> {
    let mut common: Option<Window> = None;
    for device in devices.into_iter().filter(|device| device.mode.uses_dc()) {
        let window = window(cycle, device);
        let common = common.get_or_insert_default();
        common.earliest = common.earliest.max(window.earliest);
        common.latest = match (common.latest, window.latest) {
            (Some(one), Some(other)) => Some(one.min(other)),
            (one, other) => one.or(other),
        };
    }
    common
}

/// SYNC0's common phase for all SubDevices in DC SYNC0. It is the middle between the latest moment
/// at which outputs are ready and the earliest at which inputs must be started, in whole
/// microseconds. `None` if no SubDevice uses SYNC0.
///
/// One phase serves all, so that their outputs switch together. If nothing fits the result is still
/// the middle, and [`budget`] names the lines that fail.
pub fn common_shift<'a>(
    cycle: &Cycle,
    devices: impl IntoIterator<Item = &'a Device>,
) -> Option<Nanos> {
    let window = common_window(cycle, devices)?;
    let earliest = window.earliest.map_or(cycle.send, |earliest| earliest.max(cycle.send));
    let end = cycle.send + cycle.cycle;
    let latest = window.latest.map_or(end, |latest| latest.min(end));
    let middle = (earliest.0 + latest.0).div_euclid(2);
    Some(Nanos(middle.div_euclid(1_000) * 1_000))
}

/// The budget of one SubDevice with the acting pulse at `shift`.
pub fn budget(cycle: &Cycle, shift: Nanos, device: &Device) -> Budget {
    let mut budget = Budget::default();
    for check in Check::OF_DEVICE {
        if let Some(demand) = line::demand(cycle, shift, device, check) {
            budget.push(demand.line());
        }
    }
    budget
}

/// One line of the budget with all its figures; `None` if the SubDevice's mode does not have it.
pub fn demand(cycle: &Cycle, shift: Nanos, device: &Device, check: Check) -> Option<Demand> {
    line::demand(cycle, shift, device, check)
}

/// The demand of the frames themselves. `wire` is the time that all frames of a cycle take on the
/// wire, including gaps.
pub fn frames_in_cycle(cycle: &Cycle, wire: Nanos) -> Demand {
    line::frames_in_cycle(cycle, wire)
}

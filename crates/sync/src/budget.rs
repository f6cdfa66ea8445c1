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
//!
//! A demand ([`Check`]) says what must not exceed what; its [`Demand`] has both sides as sums whose
//! [`Term`]s name what each figure is and where it comes from; a [`Line`] is the demand in short. [`window`]
//! tells where one SubDevice lets the acting pulse lie, [`moments`] when what must have happened.

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

/// What all SubDevices share.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cycle {
    /// Bus cycle.
    pub cycle: Nanos,
    /// Phase at which the frame finds the reference clock.
    pub send: Nanos,
    /// A frame may be later than planned by this much, never earlier.
    pub jitter: Nanos,
    /// The part of [`Cycle::jitter`] that the hops make; the host makes the rest.
    pub hop_jitter: Nanos,
    /// In a ring: a frame that goes the longest way comes to the reference clock later than planned by this much. 0 on a line.
    pub ring_way: Nanos,
    /// Two clocks of the segment may differ by this much.
    pub clock_error: Nanos,
    /// Where the clock error comes from.
    pub clock_error_origin: Origin,
    /// The reference clock's oscillator may be faster or slower than the wire's bit clock by this
    /// much, ppb.
    pub clock_deviation_ppb: i64,
    /// With what a SubDevice counts as synchronized.
    pub limits: Limits,
}

/// With what a SubDevice counts as synchronized: the judges of a run refuse more, and so does the
/// plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest distance of a SYNC0 edge from the grid that was asked for.
    pub sync0_error: Nanos,
    /// Largest spread of the time from the acting pulse to Outputs Valid.
    pub outputs_spread: Nanos,
}

impl Default for Limits {
    /// 1 us for both. SYNC0: what the field calls synchronous; a healthy segment is far below.
    /// Outputs: the distance of minimum and maximum delay time, 0x1C32:07 and :09, that ETG.1020
    /// allows.
    fn default() -> Self {
        Self { sync0_error: Nanos::micros(1), outputs_spread: Nanos::micros(1) }
    }
}

/// One SubDevice's demands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Device {
    /// How it is synchronized.
    pub mode: SyncMode,
    /// Its SYNC pulses; nothing without DC.
    pub pulses: Pulses,
    /// How its SYNC signals fall again. No object states it.
    pub sync_signal: SyncSignal,
    /// Its process data travel in every so many bus cycles; 1 or more.
    pub every: u32,
    /// By how much the frames with its process data are earlier where those of other groups do not go before them.
    pub frame_spread: Nanos,
    /// In a ring: by how much its frames are earlier on the shortest way than on the longest, which is the one that counts in
    /// the arrivals. 0 on a line.
    pub ring_spread: Nanos,
    /// Propagation delay from the reference clock: the part of both arrivals that is no frame's.
    pub delay: Nanos,
    /// From the frame at the reference clock until the last output byte is stored here, in the fullest cycle; `None` if
    /// it has no outputs.
    pub outputs_arrival: Option<Nanos>,
    /// From the frame at the reference clock until the frame that fetches the inputs begins here, where no other
    /// group's goes before it; `None` if it has no inputs.
    pub inputs_fetched: Option<Nanos>,
    /// From the frame at the reference clock until that frame is through here, in the fullest cycle: the SM3 event.
    pub inputs_read: Option<Nanos>,
    /// How long outputs stay valid without new ones (registers 0x0400, 0x0420); `None`: as long as one likes, or
    /// there are none.
    pub watchdog: Option<Nanos>,
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
    /// How much later than the pulse its steps may begin: no object states it.
    pub pulse_jitter: Nanos,
    /// From the shortest to the longest time from the acting pulse to Outputs Valid: no object
    /// states it.
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

    /// From one exchange of its process data to the next.
    pub fn exchange(&self, cycle: &Cycle) -> Nanos {
        Nanos(cycle.cycle.0 * i64::from(self.every))
    }

    /// The shift of its outputs by a local timer, where its mode has one: an output that acts at
    /// SYNC1 is shifted by SYNC1, and 0x1C32:03 is not used (ETG.1020, columns "DC SYNC1" and "DC
    /// shift SYNC1").
    pub fn timed_output_shift(&self) -> Option<Nanos> {
        let timed = match self.mode {
            SyncMode::FreeRun | SyncMode::SmSynchronous | SyncMode::DcSync1 => false,
            SyncMode::DcShiftSync1 => self.pulses.lead == Nanos::ZERO,
            SyncMode::DcSync0 | SyncMode::DcSubordinated => true,
        };
        self.output_shift.filter(|_| timed)
    }

    /// From the acting pulse to Outputs Valid: the shift, but the hardware needs its delay.
    pub fn outputs_act_after(&self) -> Nanos {
        self.timed_output_shift().unwrap_or(Nanos::ZERO).max(self.output_delay)
    }

    /// From SYNC1 to Input Latch where SYNC1 takes the inputs. Without outputs 0x1C33:01 alone tells the mode, and to
    /// the device it is that of inputs at SYNC1 itself.
    fn delay_behind_sync1(&self) -> Nanos {
        if self.outputs_arrival.is_some() { self.input_delay } else { Nanos::ZERO }
    }

    /// Whether a local timer shifts its inputs, in a mode that has such a shift.
    pub fn shifts_inputs(&self) -> bool {
        let modes = [SyncMode::SmSynchronous, SyncMode::DcSync0, SyncMode::DcSubordinated];
        self.input_shift > Nanos::ZERO && modes.contains(&self.mode)
    }
}

/// Where one SubDevice lets the acting pulse lie; `None` where it does not mind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Window {
    /// Not before: its outputs would not be ready; without outputs, its inputs not read.
    pub earliest: Option<Nanos>,
    /// Not after: its inputs would miss the frame that fetches them.
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

/// The window of all SubDevices together: the output reference and the input reference.
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

/// One line of it with all its figures; `None` if the SubDevice's mode does not have it.
pub fn demand(cycle: &Cycle, shift: Nanos, device: &Device, check: Check) -> Option<Demand> {
    line::demand(cycle, shift, device, check)
}

/// The demand of the frames themselves: `wire` is the time that all frames of a cycle take on the wire,
/// gaps included.
pub fn frames_in_cycle(cycle: &Cycle, wire: Nanos) -> Demand {
    line::frames_in_cycle(cycle, wire)
}

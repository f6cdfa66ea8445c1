//! The lines of the budget: each demand as two sums.

use core::fmt;

use isocat_wire::time::Nanos;
use isocat_wire::{AlStatusCode, frame};

use super::term::{Origin, Quantity, Sum, Term};
use super::{Check, Cycle, Device, Sign, USUAL_DEVIATION_PPB, clocks};
use crate::mode::SyncMode;
use crate::pulses::{Pulses, SyncSignal};

/// One line of the budget.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Line {
    /// The demand.
    pub check: Check,
    /// Time that is needed.
    pub needed: Nanos,
    /// Time that is available.
    pub available: Nanos,
}

impl Line {
    /// The time left; negative if the demand is not met.
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
        let (words, slack) = (check.words(), self.slack());
        if let Some(source) = check.source() {
            write!(f, "{source}: ")?;
        }
        write!(f, "{words}: needs {needed}, has {available}, slack {slack}")
    }
}

/// A demand with all its figures.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Demand {
    /// The demand.
    pub check: Check,
    /// Time that is needed.
    pub needed: Sum,
    /// Time that is available.
    pub available: Sum,
}

impl Demand {
    /// The short form of the demand.
    pub fn line(&self) -> Line {
        Line { check: self.check, needed: self.needed.total(), available: self.available.total() }
    }
    /// The time left; negative if the demand is not met.
    pub fn slack(&self) -> Nanos {
        self.line().slack()
    }

    /// The step of which the cycle must be a multiple, where the demand is about one.
    pub fn step(&self) -> Option<Nanos> {
        let step = |term: &Term| term.quantity == Quantity::CycleStep;
        self.needed.terms().find(step).map(|term| term.value)
    }

    /// The sign that the demand is not met in a SubDevice of this mode.
    pub fn sign(&self, mode: SyncMode) -> Sign {
        let own = self.needed.terms().find(|term| term.quantity == Quantity::MinimumCycle);
        match own {
            // The device can refuse this cycle as soon as it is told of it.
            Some(own) if !mode.uses_dc() && own.value > self.available.total() => {
                Sign::Refusal(AlStatusCode::CYCLE_TIME_TOO_SMALL)
            }
            // SYNC0 itself is short enough.
            None if self.check == Check::LongestSyncCycle
                && self.needed.terms().any(|term| term.quantity == Quantity::Sync1) =>
            {
                Sign::Refusal(AlStatusCode::DC_SYNC1_CYCLE)
            }
            _ => self.check.sign(mode),
        }
    }
}

/// The lines of one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Budget {
    lines: [Option<Line>; Check::OF_DEVICE.len()],
}

impl Budget {
    /// All lines that exist in the SubDevice's mode.
    pub fn lines(&self) -> impl Iterator<Item = Line> + '_ {
        self.lines.iter().flatten().copied()
    }
    /// The line of this demand, if the mode has it.
    pub fn line(&self, check: Check) -> Option<Line> {
        self.lines().find(|line| line.check == check)
    }
    /// Of the lines that do not fit, the one with the least slack.
    pub fn failure(&self) -> Option<Line> {
        self.lines().filter(|line| !line.fits()).min_by_key(Line::slack)
    }
    /// The least slack of all lines about time in the cycle.
    pub fn slack(&self) -> Option<Nanos> {
        self.lines().filter(|line| line.check.is_of_cycle()).map(|line| line.slack()).min()
    }

    pub(super) fn push(&mut self, line: Line) {
        if let Some(free) = self.lines.iter_mut().find(|line| line.is_none()) {
            *free = Some(line);
        }
    }
}

/// The shortest frame, with its preamble, check sequence and the gap behind it; state requests need
/// it.
const ACYCLIC: Nanos =
    Nanos(((frame::MIN_LEN + frame::WIRE_OVERHEAD) as u64 * frame::BYTE_TIME_NS) as i64);

pub(super) fn frames_in_cycle(cycle: &Cycle, wire: Nanos) -> Demand {
    Demand {
        check: Check::FramesInCycle,
        needed: Sum::default()
            .and(Quantity::Frames, wire, Origin::Wire)
            .and(Quantity::Acyclic, ACYCLIC, Origin::Wire)
            .and_frame_jitter(cycle)
            .if_any(Quantity::RingWay, cycle.ring_way, Origin::Wire)
            .if_any(Quantity::ClockError, cycle.clock_error, cycle.clock_error_origin)
            // The wire does not count by the reference clock.
            .and_speed(cycle, cycle.clock_deviation_ppb, cycle.cycle),
        available: Sum::default().and(Quantity::Cycle, cycle.cycle, Origin::Intent),
    }
}

/// Both sides of a demand, with the acting pulse at `shift`; `None` if the SubDevice does not have
/// the demand.
pub(super) fn demand(cycle: &Cycle, shift: Nanos, device: &Device, check: Check) -> Option<Demand> {
    let mode = device.mode;
    let (needed, available) = match check {
        Check::FramesInCycle => return None,
        // A device without process data has no cycle.
        _ if device.outputs_arrival.is_none() && device.inputs_fetched.is_none() => return None,
        // In Free Run the cycle is the device's own, so only a stated minimum cycle is checked.
        Check::MinimumCycle if mode != SyncMode::FreeRun || device.minimum_cycle > Nanos::ZERO => {
            minimum_cycle(cycle, device)
        }
        Check::LongestSyncCycle if mode.uses_dc() => longest_sync_cycle(device)?,
        Check::Sync0InSteps if mode.uses_dc() => sync0_in_steps(device)?,
        Check::OutputsBeforeSync0 if mode.uses_dc() && mode != SyncMode::DcSync1 => {
            outputs_ready(cycle, shift, device)?
        }
        Check::OutputsStoredBeforeSync0 if mode == SyncMode::DcSync1 => {
            (outputs_stored(cycle, device)?, pulse(shift, device.pulses.lead))
        }
        Check::InputsReadBeforeSync0 if mode.uses_dc() => inputs_read(cycle, shift, device)?,
        Check::Sync1CoversCopy if mode == SyncMode::DcSync1 => {
            device.outputs_arrival?;
            let origins = &device.origins;
            let copy = device.output_calc_and_copy;
            let copy = Sum::default()
                .and(Quantity::OutputCalcAndCopy, copy, origins.output_calc_and_copy)
                .and_speed(cycle, device.clock_deviation_ppb, copy)
                .if_any(
                    Quantity::Moved,
                    clocks::moved(cycle, device.pulses.sync1),
                    Origin::Assumed,
                );
            (copy, Sum::default().and(Quantity::Sync1, device.pulses.sync1, origins.sync1))
        }
        Check::Sync1BeforeNextSync0
            if matches!(mode, SyncMode::DcSync1 | SyncMode::DcShiftSync1) =>
        {
            let origins = &device.origins;
            let sync1 = Sum::default().and(Quantity::Sync1, device.pulses.sync1, origins.sync1);
            let sync0_cycle = device.pulses.sync0_cycle;
            // Both pulses follow one system time, each on its own tick.
            let moved = clocks::moved(cycle, sync0_cycle - device.pulses.sync1);
            let tick = if moved > Nanos::ZERO { TICK } else { Nanos::ZERO };
            let sync1 = sync1.if_any(Quantity::Moved, moved, Origin::Assumed).if_any(
                Quantity::Tick,
                tick,
                Origin::Chip,
            );
            (
                strictly(sync1),
                Sum::default().and(Quantity::Sync0Cycle, sync0_cycle, origins.sync0_cycle),
            )
        }
        Check::InputsBeforeFrame if mode.uses_dc() => inputs_available(cycle, shift, device)?,
        Check::InputsBeforeFrame if device.shifts_inputs() => inputs_by_timer(cycle, device)?,
        Check::ShiftCoversDelay if mode.uses_dc() => {
            let shift = device.timed_output_shift()?;
            shift_covers(
                (device.output_delay, device.origins.output_delay, Quantity::OutputDelay),
                (shift, Origin::Intent, Quantity::OutputShift),
            )
        }
        Check::InputShiftCoversDelay if device.shifts_inputs() => {
            device.inputs_fetched?;
            let origins = &device.origins;
            shift_covers(
                (device.input_delay, origins.input_delay, Quantity::InputDelay),
                (device.input_shift, origins.input_shift, Quantity::InputShift),
            )
        }
        Check::OutputsValidInCycle if mode.uses_dc() => outputs_valid(cycle, device)?,
        Check::Sync0FallsInCycle if mode.uses_dc() => sync0_falls(cycle, device)?,
        Check::OutputsBeforeWatchdog => within_watchdog(cycle, device)?,
        Check::Sync0WithinLimit if mode.uses_dc() => sync0_within_limit(cycle)?,
        Check::OutputsSpreadWithinLimit if mode.uses_dc() => outputs_spread(cycle, device)?,
        _ => return None,
    };
    Some(Demand { check, needed, available })
}

fn minimum_cycle(cycle: &Cycle, device: &Device) -> (Sum, Sum) {
    let origin = device.origins.minimum_cycle;
    let needed = Sum::default().and(Quantity::MinimumCycle, device.minimum_cycle, origin);
    let available = Sum::default();
    match device.mode {
        SyncMode::SmSynchronous | SyncMode::FreeRun => (
            needed
                .and(Quantity::SendJitter, cycle.jitter - cycle.hop_jitter, Origin::Intent)
                .if_any(Quantity::HopJitter, cycle.hop_jitter, Origin::Chip)
                .if_any(Quantity::OtherGroups, device.frame_spread, Origin::Wire)
                .if_any(Quantity::RingWay, device.ring_spread, Origin::Wire)
                .and_own_minimum(cycle, device, device.exchange(cycle)),
            own_cycle(available, cycle, device),
        ),
        mode => {
            let needed = needed.and_own_minimum(cycle, device, device.minimum_cycle);
            let own = device.pulses.sync0_cycle > cycle.cycle;
            let available = match mode {
                SyncMode::DcSubordinated => sync0_cycle(device),
                _ if own => sync0_cycle(device),
                _ => available.and(Quantity::Cycle, cycle.cycle, Origin::Intent),
            };
            (needed, available)
        }
    }
}

/// A SYNC unit has two times: of SYNC0, and up to SYNC1. The longer one counts, but SYNC1 is looked
/// at only where SYNC0 is short enough.
fn longest_sync_cycle(device: &Device) -> Option<(Sum, Sum)> {
    let longest = device.sync_limits.longest?;
    let Pulses { sync0_cycle, sync1, .. } = device.pulses;
    let needed = match sync0_cycle <= longest && sync1 > sync0_cycle {
        true => Sum::default().and(Quantity::Sync1, sync1, device.origins.sync1),
        false => self::sync0_cycle(device),
    };
    Some((needed, Sum::default().and(Quantity::LongestCycle, longest, Origin::Profile)))
}

/// The last step has a figure of its own, so that it is named whether the cycle fits or not.
fn sync0_in_steps(device: &Device) -> Option<(Sum, Sum)> {
    let step = device.sync_limits.step?;
    let cycle = device.pulses.sync0_cycle.0;
    let whole = cycle.checked_div(step.0)?;
    let before = if whole * step.0 == cycle { whole - 1 } else { whole };
    let needed = Sum::default()
        .if_any(Quantity::StepsBefore, Nanos(before.max(0) * step.0), Origin::Profile)
        .and(Quantity::CycleStep, step, Origin::Profile);
    Some((needed, sync0_cycle(device)))
}

fn sync0_cycle(device: &Device) -> Sum {
    let (cycle, origin) = (device.pulses.sync0_cycle, device.origins.sync0_cycle);
    Sum::default().and(Quantity::Sync0Cycle, cycle, origin)
}

/// New outputs must arrive while the previous ones are valid; the SubDevice counts by its own
/// oscillator.
fn within_watchdog(cycle: &Cycle, device: &Device) -> Option<(Sum, Sum)> {
    device.outputs_arrival?;
    let (watchdog, origin) = (device.watchdog?, device.origins.watchdog);
    let needed = own_cycle(Sum::default(), cycle, device)
        .and_frame_jitter(cycle)
        .if_any(Quantity::OtherGroups, device.frame_spread, Origin::Wire)
        .if_any(Quantity::RingWay, device.ring_spread, Origin::Wire)
        .and_speed(cycle, device.clock_deviation_ppb, watchdog);
    Some((needed, Sum::default().and(Quantity::Watchdog, watchdog, origin)))
}

/// A SubDevice without outputs counts the reads of its inputs: exactly one between two pulses.
fn inputs_read(cycle: &Cycle, shift: Nanos, device: &Device) -> Option<(Sum, Sum)> {
    if device.outputs_arrival.is_some() {
        return None;
    }
    let read = through(cycle, device, device.inputs_read?);
    let lead = match device.mode {
        SyncMode::DcSubordinated => Nanos::ZERO,
        _ => device.pulses.lead,
    };
    Some((read, pulse(shift, lead)))
}

/// The latest instant at which the outputs are in the SubDevice's memory, by its own clock.
fn outputs_stored(cycle: &Cycle, device: &Device) -> Option<Sum> {
    Some(through(cycle, device, device.outputs_arrival?))
}

/// The latest instant at which the frame has passed; `end` counts from its arrival at the reference
/// clock.
fn through(cycle: &Cycle, device: &Device, end: Nanos) -> Sum {
    Sum::default()
        .if_any(Quantity::Send, cycle.send, Origin::Plan)
        .and(Quantity::FrameEnd, end - device.delay, Origin::Wire)
        .and(Quantity::Propagation, device.delay, device.origins.delay)
        .and_frame_jitter(cycle)
        .if_any(Quantity::ClockError, cycle.clock_error, cycle.clock_error_origin)
}

fn outputs_ready(cycle: &Cycle, shift: Nanos, device: &Device) -> Option<(Sum, Sum)> {
    let origin = device.origins.output_calc_and_copy;
    let copy = device.output_calc_and_copy;
    let ready = outputs_stored(cycle, device)?.and(Quantity::OutputCalcAndCopy, copy, origin);
    let lead = match device.mode {
        SyncMode::DcShiftSync1 => device.pulses.lead,
        _ => Nanos::ZERO,
    };
    Some((ready, pulse(shift, lead)))
}

/// A pulse that comes `lead` before the acting one.
fn pulse(shift: Nanos, lead: Nanos) -> Sum {
    Sum::default().and(Quantity::ActingPulse, shift, Origin::Plan).if_any(
        Quantity::Lead,
        -lead,
        Origin::Plan,
    )
}

/// Time from the acting pulse until inputs are in the buffer, against the distance from the pulse
/// to the next frame.
fn inputs_available(cycle: &Cycle, shift: Nanos, device: &Device) -> Option<(Sum, Sum)> {
    let fetched = device.inputs_fetched?;
    let (pulses, origins) = (&device.pulses, &device.origins);
    let by_timer = if device.shifts_inputs() { device.input_shift } else { Nanos::ZERO };
    let latch = match device.mode {
        SyncMode::DcShiftSync1 => Sum::default()
            .and(Quantity::Sync1, pulses.sync1, origins.sync1)
            .if_any(Quantity::Lead, -pulses.lead, Origin::Plan)
            .if_any(Quantity::InputDelay, device.delay_behind_sync1(), origins.input_delay),
        SyncMode::DcSync1 => Sum::default(),
        SyncMode::DcSubordinated => Sum::default()
            .if_any(Quantity::BehindSync0, -pulses.behind_sync0(), origins.sync1)
            .if_any(Quantity::InputShift, device.input_shift, origins.input_shift),
        _ => Sum::default().if_any(Quantity::InputShift, device.input_shift, origins.input_shift),
    };
    let needed = latch
        .if_any(Quantity::PulseJitter, device.pulse_jitter, origins.pulse_jitter)
        .and(Quantity::InputCalcAndCopy, device.input_calc_and_copy, origins.input_calc_and_copy)
        .if_any(Quantity::ClockError, cycle.clock_error, cycle.clock_error_origin)
        .and_timer(cycle, device, by_timer);
    let available =
        next_frame(cycle, device, fetched).and(Quantity::ActingPulse, -shift, Origin::Plan);
    Some((needed, available))
}

/// The same demand if a timer behind the SM event latches the inputs.
fn inputs_by_timer(cycle: &Cycle, device: &Device) -> Option<(Sum, Sum)> {
    let fetched = device.inputs_fetched?;
    let origins = &device.origins;
    let stored = outputs_stored(cycle, device)?;
    let copy = device.output_calc_and_copy;
    let timer_counts = device.input_shift >= copy;
    let waits = if !timer_counts {
        // The CPU is still busy with the outputs of the frame when the timer expires.
        stored.and(Quantity::OutputCalcAndCopy, copy, origins.output_calc_and_copy)
    } else {
        stored.and(Quantity::InputShift, device.input_shift, origins.input_shift)
    };
    let copy = device.input_calc_and_copy;
    let needed = waits
        .and(Quantity::InputCalcAndCopy, copy, origins.input_calc_and_copy)
        .and_timer(cycle, device, if timer_counts { device.input_shift } else { Nanos::ZERO });
    Some((needed, next_frame(cycle, device, fetched)))
}

/// The earliest instant at which the frame of the next exchange begins at the SubDevice.
fn next_frame(cycle: &Cycle, device: &Device, fetched: Nanos) -> Sum {
    let send = Sum::default().if_any(Quantity::Send, cycle.send, Origin::Plan);
    own_cycle(send, cycle, device)
        .if_any(Quantity::FrameBegin, fetched - device.delay, Origin::Wire)
        .and(Quantity::Propagation, device.delay, device.origins.delay)
}

/// The cycle of its exchange, which has a name of its own if it is not the bus cycle.
fn own_cycle(sum: Sum, cycle: &Cycle, device: &Device) -> Sum {
    let quantity = if device.every > 1 { Quantity::OwnCycle } else { Quantity::Cycle };
    sum.and(quantity, device.exchange(cycle), Origin::Intent)
}

type Figure = (Nanos, Origin, Quantity);

fn shift_covers(delay: Figure, shift: Figure) -> (Sum, Sum) {
    let sum = |(value, origin, quantity): Figure| Sum::default().and(quantity, value, origin);
    (sum(delay), sum(shift))
}

fn outputs_valid(cycle: &Cycle, device: &Device) -> Option<(Sum, Sum)> {
    device.outputs_arrival?;
    let (pulses, origins) = (&device.pulses, &device.origins);
    let needed = match device.timed_output_shift().filter(|shift| *shift >= device.output_delay) {
        Some(shift) => Sum::default().and(Quantity::OutputShift, shift, Origin::Intent),
        None => {
            let delay = device.output_delay;
            Sum::default().and(Quantity::OutputDelay, delay, origins.output_delay)
        }
    };
    // With subordinated cycles outputs act at each SYNC0 again.
    let pulse_cycle = pulses.sync0_cycle;
    let own = needed.total();
    let needed = needed
        .if_any(Quantity::PulseJitter, device.pulse_jitter, origins.pulse_jitter)
        .and_speed(cycle, device.clock_deviation_ppb, own);
    let available = Sum::default().and(Quantity::Sync0Cycle, pulse_cycle, origins.sync0_cycle);
    Some((needed, available))
}

/// SYNC0 ends before its next pulse is due. A pulse shorter than half the cycle is no problem, so
/// it has no line; as a rule it is 10 us.
fn sync0_falls(cycle: &Cycle, device: &Device) -> Option<(Sum, Sum)> {
    let (origins, sync0_cycle) = (&device.origins, device.pulses.sync0_cycle);
    let needed = match device.sync_signal {
        SyncSignal::Unknown => return None,
        SyncSignal::Pulse(length) if length + length < sync0_cycle => return None,
        SyncSignal::Pulse(length) => {
            Sum::default().and(Quantity::PulseLength, length, Origin::Profile)
        }
        SyncSignal::Acknowledged(after) => Sum::default()
            .and(Quantity::Acknowledge, after, origins.pulse_jitter)
            .if_any(Quantity::PulseJitter, device.pulse_jitter, origins.pulse_jitter),
    };
    // Its own oscillator counts up to there; the next pulse follows the clock that the drift loop
    // controls.
    let own = needed.total();
    let needed = needed.and_speed(cycle, device.clock_deviation_ppb, own).if_any(
        Quantity::Moved,
        clocks::moved(cycle, sync0_cycle),
        cycle.clock_error_origin,
    );
    Some((needed, self::sync0_cycle(device)))
}

/// SYNC0 follows the SubDevice's clock, on a tick.
fn sync0_within_limit(cycle: &Cycle) -> Option<(Sum, Sum)> {
    let error = Some(cycle.clock_error).filter(|error| *error > Nanos::ZERO)?;
    let needed = Sum::default().and(Quantity::ClockError, error, cycle.clock_error_origin).and(
        Quantity::Tick,
        TICK,
        Origin::Chip,
    );
    let limit = cycle.limits.sync0_error;
    Some((needed, Sum::default().and(Quantity::Sync0Limit, limit, Origin::Intent)))
}

/// The spread of outputs behind their pulse, in true time. `None` for outputs without spread.
fn outputs_spread(cycle: &Cycle, device: &Device) -> Option<(Sum, Sum)> {
    device.outputs_arrival?;
    let spread = Some(device.outputs_spread).filter(|spread| *spread > Nanos::ZERO)?;
    // Its CPU counts the spread by its own oscillator. The tick of the pulse shifts both ends of
    // the spread equally.
    let speed = clocks::speed_part(cycle, device.clock_deviation_ppb, spread);
    let needed = Sum::default()
        .and(Quantity::OutputsSpread, spread, device.origins.pulse_jitter)
        .if_any(Quantity::Deviation, speed, Origin::Assumed);
    let limit = cycle.limits.outputs_spread;
    Some((needed, Sum::default().and(Quantity::OutputsSpreadLimit, limit, Origin::Intent)))
}

/// SYNC pulses come on ticks.
const TICK: Nanos = Nanos(10);

impl Sum {
    /// Adds the lateness of a frame: the host's part and the hops' part.
    fn and_frame_jitter(self, cycle: &Cycle) -> Self {
        let host = cycle.jitter - cycle.hop_jitter;
        self.if_any(Quantity::SendJitter, host, Origin::Intent).if_any(
            Quantity::HopJitter,
            cycle.hop_jitter,
            Origin::Chip,
        )
    }

    /// Adds the error of a count of `span` by an oscillator that deviates by so much and that no
    /// loop corrects.
    fn and_speed(self, cycle: &Cycle, deviation_ppb: i64, span: Nanos) -> Self {
        let error = clocks::speed_error(cycle, deviation_ppb, span);
        match deviation_ppb {
            USUAL_DEVIATION_PPB => self.if_any(Quantity::ClockSpeed, error, Origin::Assumed),
            _ => self.if_any(Quantity::StatedClockSpeed, error, Origin::Profile),
        }
    }

    /// Adds that error for a local timer, if one runs.
    fn and_timer(self, cycle: &Cycle, device: &Device, span: Nanos) -> Self {
        match span {
            Nanos::ZERO => self,
            _ => self.and_speed(cycle, device.clock_deviation_ppb, span),
        }
    }

    /// Adds that error for a minimum cycle. A stated time is a nominal one; a time of a CPU is
    /// counted by the CPU's own oscillator.
    fn and_own_minimum(self, cycle: &Cycle, device: &Device, span: Nanos) -> Self {
        match device.origins.minimum_cycle {
            Origin::Assumed | Origin::MeasuredByDevice(_) => {
                self.and_speed(cycle, device.clock_deviation_ppb, span)
            }
            _ => self,
        }
    }
}

fn strictly(sum: Sum) -> Sum {
    sum.and(Quantity::Strictly, Nanos(1), Origin::Plan)
}

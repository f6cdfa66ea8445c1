//! The earliest and the latest instant of each event in a SubDevice's cycle.

use isocat_wire::time::Nanos;

use super::{Cycle, Device, Origin, clocks};
use crate::mode::SyncMode;
use crate::moment::Moment;

/// The earliest and the latest instant of an event, counted from the start of the bus cycle in
/// which the frame is sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Span {
    /// The event does not happen before this.
    pub earliest: Nanos,
    /// The event does not happen after this.
    pub latest: Nanos,
}

impl Span {
    fn after(self, least: Nanos, most: Nanos) -> Self {
        Self { earliest: self.earliest + least, latest: self.latest + most }
    }
}

/// The events of one SubDevice's cycle; `None` if the mode does not have the event or its time is
/// not known.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Moments {
    /// SM2: outputs are stored.
    pub outputs_stored: Option<Span>,
    /// Outputs are copied and calculated. No object states the least time for that.
    pub outputs_ready: Option<Span>,
    /// The first SYNC0 that belongs to the acting pulse.
    pub sync0: Option<Span>,
    /// SYNC1.
    pub sync1: Option<Span>,
    /// Outputs Valid.
    pub outputs_valid: Option<Span>,
    /// Input Latch.
    pub input_latch: Option<Span>,
    /// Inputs are in the buffer. No object states the least time for that.
    pub inputs_available: Option<Span>,
    /// The frame that fetches the inputs begins here.
    pub inputs_fetched: Option<Span>,
}

impl Moments {
    /// The planned span of a moment; `None` if the plan does not have it.
    pub const fn of(&self, moment: Moment) -> Option<Span> {
        match moment {
            Moment::Sm2 => self.outputs_stored,
            Moment::OutputsReady => self.outputs_ready,
            Moment::Sync0 => self.sync0,
            Moment::Sync1 => self.sync1,
            Moment::OutputsValid => self.outputs_valid,
            Moment::InputLatch => self.input_latch,
            Moment::InputsAvailable => self.inputs_available,
            Moment::Sm3 => self.inputs_fetched,
            Moment::Frame
            | Moment::OutputsFetched
            | Moment::ApplicationBegins
            | Moment::ApplicationEnds
            | Moment::InputsBegin => None,
        }
    }
}

/// The events with the acting pulse at `shift`. In Free Run only the frames have a phase in the bus
/// cycle.
pub fn moments(cycle: &Cycle, shift: Nanos, device: &Device) -> Moments {
    let Cycle { send, jitter, clock_error, .. } = *cycle;
    let (period, spread) = (device.exchange(cycle), device.frame_spread + device.ring_spread);
    let at = |phase: Nanos| Span { earliest: phase - clock_error, latest: phase + clock_error };
    let frame = |after: Nanos| at(send + after).after(Nanos::ZERO, jitter);
    let stored = device.outputs_arrival.map(|end| frame(end).after(-spread, Nanos::ZERO));
    let fetched = device.inputs_fetched.map(|begin| frame(begin).after(period, period + spread));
    let mut moments =
        Moments { outputs_stored: stored, inputs_fetched: fetched, ..Moments::default() };
    let pulses = &device.pulses;
    let sync0 = at(shift - pulses.lead);
    let latched = |span: Span| (span, span.after(Nanos::ZERO, device.input_calc_and_copy));
    let has_inputs = device.inputs_fetched.is_some();
    // The device counts spans behind a pulse by its own oscillator.
    let off = |span| clocks::speed_part(cycle, device.clock_deviation_ppb, span);
    match device.mode {
        SyncMode::FreeRun => return moments,
        SyncMode::SmSynchronous => {
            let all = stored.map(|span| span.after(Nanos::ZERO, device.minimum_cycle));
            moments.outputs_ready =
                stored.map(|span| span.after(Nanos::ZERO, device.output_calc_and_copy));
            moments.outputs_valid = all;
            let shift = Some(device.input_shift).filter(|_| device.shifts_inputs());
            match (stored, shift) {
                (Some(stored), Some(shift)) if has_inputs => {
                    let by_timer = stored.after(shift - off(shift), shift + off(shift));
                    let (latch, available) = latched(by_timer);
                    // The CPU may still be busy with the outputs.
                    let waits = device.output_calc_and_copy.max(shift) - shift;
                    let latest = available.latest + waits;
                    moments.input_latch = Some(latch);
                    moments.inputs_available = Some(Span { latest, ..available });
                }
                _ if has_inputs => (moments.input_latch, moments.inputs_available) = (all, all),
                _ => {}
            }
            return moments;
        }
        _ => {}
    }
    moments.sync0 = Some(sync0);
    moments.sync1 = device.mode.uses_sync1().then(|| sync0.after(pulses.sync1, pulses.sync1));
    if let Some(stored) = stored {
        let from = if device.mode == SyncMode::DcSync1 { sync0 } else { stored };
        moments.outputs_ready = Some(from.after(Nanos::ZERO, device.output_calc_and_copy));
        let after = device.outputs_act_after();
        // An assumed or measured delay is the longest one; the shortest is not known.
        let origin = device.origins.output_delay;
        let assumed = matches!(origin, Origin::Assumed | Origin::MeasuredByDevice(_));
        let least =
            if assumed { device.timed_output_shift().unwrap_or(Nanos::ZERO) } else { after };
        let most = after + off(after) + device.pulse_jitter;
        moments.outputs_valid = Some(at(shift).after(least - off(least), most));
    }
    if has_inputs {
        let after = match device.mode {
            SyncMode::DcShiftSync1 => pulses.sync1 - pulses.lead + device.delay_behind_sync1(),
            SyncMode::DcSync1 => Nanos::ZERO,
            SyncMode::DcSubordinated => device.input_shift - pulses.behind_sync0(),
            _ => device.input_shift,
        };
        let timed = if device.shifts_inputs() { off(device.input_shift) } else { Nanos::ZERO };
        let most = after + timed + device.pulse_jitter;
        let (latch, available) = latched(at(shift).after(after - timed, most));
        (moments.input_latch, moments.inputs_available) = (Some(latch), Some(available));
    }
    moments
}

//! Judges regular events as they were noted briefly.

use isocat_wire::Time;

use super::look::Look;
use super::{DeviceBench, Measured, take_fetched};
use crate::brief::{Brief, Parts};
use crate::judge::OutputsValid;
use crate::observation::Content;

impl DeviceBench {
    /// Passes regular events and their steps to the judges that they concern, as
    /// [`judge`](Self::judge) does one after the other.
    #[inline(always)]
    pub(super) fn judge_brief(
        &mut self,
        look: &mut Look<'_>,
        brief: &Brief,
        outputs_valid: &mut OutputsValid,
    ) {
        if brief.has != Parts::CYCLE || !self.judge_cycle(look, brief, outputs_valid) {
            self.judge_parts(look, brief, outputs_valid);
        }
    }

    /// The same for any parts, one after the other.
    #[inline(never)]
    fn judge_parts(
        &mut self,
        look: &mut Look<'_>,
        brief: &Brief,
        outputs_valid: &mut OutputsValid,
    ) {
        let (has, frame) = (brief.has, brief.frame);
        if has.any(Parts::STORED) {
            if self.binding.follows_stored {
                self.outputs_cycle.stored(frame);
            }
            if self.binding.latches_at_sm2 {
                self.inputs_cycle.event(frame);
            }
            if self.is_timed {
                self.margin.sm2(brief.frame_end);
            }
        }
        if has.any(Parts::FETCHED) {
            let content = Content { frame, latched: brief.fetched };
            let (at, bound) = ((brief.device as usize, brief.frame_end), &self.binding.inputs);
            take_fetched(&mut self.inputs_cycle, bound, look, at, &content);
            if self.binding.latches_at_sm3 {
                self.inputs_cycle.event(frame);
            }
        }
        if has.any(Parts::MAPPED) && self.is_timed {
            self.margin.begins();
            self.margin.ready(brief.mapped);
        }
        if has.any(Parts::PULSE) && self.is_timed {
            let at = look.true_time(brief, brief.pulse);
            let reference = look.system_time(at);
            let is_sync1 = has.any(Parts::SYNC1);
            self.pulse(reference, is_sync1, (brief.pulse, at), &mut Measured::default());
        }
        if has.any(Parts::VALID) {
            self.valid(brief.acted, || look.true_time(brief, brief.valid), outputs_valid);
        }
        if has.any(Parts::LATCHED) {
            self.inputs_cycle.latched(brief.latched, look.true_time(brief, brief.latched));
        }
    }

    /// The same for a whole cycle of a SubDevice with the usual roles of its pulses, all at once.
    /// `false`: it is another one, and nothing was done.
    #[inline(always)]
    fn judge_cycle(
        &mut self,
        look: &mut Look<'_>,
        brief: &Brief,
        outputs_valid: &mut OutputsValid,
    ) -> bool {
        if !self.is_plain || self.margin.is_copying() {
            return false;
        }
        let Some(sync0) = &mut self.sync0 else { return false };
        let pulse = look.true_time(brief, brief.pulse);
        let Some(reference) = look.system_time(pulse) else { return false };
        let content = Content { frame: brief.frame, latched: brief.fetched };
        let (index, bound) = (brief.device as usize, &self.binding.inputs);
        take_fetched(&mut self.inputs_cycle, bound, look, (index, brief.frame_end), &content);
        self.margin.cycle(brief.frame_end, brief.mapped, brief.pulse);
        let (number, _) = sync0.meet(pulse, reference);
        self.outputs_cycle.pulse(pulse);
        self.inputs_cycle.event(pulse);
        // Often outputs are valid at once, and inputs are latched when outputs are valid.
        let is_at_once = brief.valid == brief.pulse;
        let valid = if is_at_once { pulse } else { look.true_time(brief, brief.valid) };
        if brief.acted != Time::ZERO {
            self.outputs_cycle.acted(brief.acted, valid, &self.binding.outputs);
        }
        self.outputs_delay.cycle(pulse, valid);
        outputs_valid.valid(number, valid);
        self.cycle = None;
        let is_same = brief.latched == brief.valid;
        let latched = if is_same { valid } else { look.true_time(brief, brief.latched) };
        self.inputs_cycle.latched(brief.latched, latched);
        true
    }
}

//! What a SubDevice in regular operation tells judges: see [`Brief`].

use isocat_wire::time::{Device as DeviceClock, Time, True};

use super::Device;
use crate::brief::{Brief, NotedSteps, Parts};
use crate::cpu::Sequence;
use crate::watcher::Watcher;

impl Device {
    /// Notes the end of a frame that stored outputs, or fetched inputs.
    #[inline(never)]
    pub(super) fn note_frame_end(
        &self,
        at: Time<DeviceClock>,
        stored: bool,
        fetched: bool,
        watch: &mut Watcher,
    ) {
        let parts = Parts::STORED.only_if(stored).with(Parts::FETCHED.only_if(fetched));
        let brief = self.new_brief(parts, watch);
        (brief.frame_end, brief.frame) = (at, self.frame);
        if fetched {
            let sync_manager = self.stack.description().inputs.sync_manager;
            brief.fetched = Time::new(self.esc.label(sync_manager));
        }
    }

    /// Notes a pulse of SYNC0 or SYNC1.
    #[inline(never)]
    pub(super) fn note_pulse(&self, at: Time<DeviceClock>, sync1: bool, watch: &mut Watcher) {
        let other = if sync1 { Parts::SYNC0 } else { Parts::SYNC1 };
        let brief = match watch.last_brief(self.position as u32, Parts::PULSE) {
            Some(brief) => brief,
            None => self.new_brief(Parts::PULSE, watch),
        };
        (brief.has, brief.pulse) = (brief.has.without(other), at);
    }

    /// Notes steps of an event. `acted`: the frame of the outputs that have acted.
    #[inline(never)]
    pub(super) fn note_steps(
        &self,
        at: Time<DeviceClock>,
        sequence: &Sequence,
        noted: NotedSteps,
        acted: Time<True>,
        watch: &mut Watcher,
    ) {
        match watch.last_brief(self.position as u32, noted.parts) {
            Some(brief) => brief.put_steps(at, sequence, noted, acted),
            None => self.note_steps_anew(at, sequence, noted, acted, watch),
        }
    }

    /// The same in a new brief.
    #[inline(never)]
    fn note_steps_anew(
        &self,
        at: Time<DeviceClock>,
        sequence: &Sequence,
        noted: NotedSteps,
        acted: Time<True>,
        watch: &mut Watcher,
    ) {
        if noted.parts != Parts::NONE {
            let brief = self.new_brief(noted.parts, watch);
            brief.put_steps(at, sequence, noted, acted);
        }
    }

    #[inline(always)]
    fn new_brief<'a>(&self, parts: Parts, watch: &'a mut Watcher) -> &'a mut Brief {
        let factor = self.oscillator.factor();
        watch.new_brief(self.position as u32, self.state_version, factor, parts)
    }
}

impl Brief {
    /// Puts the steps of an event at `at`.
    #[inline(always)]
    fn put_steps(
        &mut self,
        at: Time<DeviceClock>,
        sequence: &Sequence,
        noted: NotedSteps,
        acted: Time<True>,
    ) {
        let NotedSteps { parts, mapped, valid, latched } = noted;
        let span = |place: u8| sequence.spans()[usize::from(place)];
        if parts.any(Parts::MAPPED) {
            self.mapped = at + span(mapped).until();
        }
        if parts.any(Parts::VALID) {
            (self.valid, self.acted) = (at + span(valid).after(), acted);
        }
        if parts.any(Parts::LATCHED) {
            self.latched = at + span(latched).after();
        }
    }
}

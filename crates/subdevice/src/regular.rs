//! Regular operation in a simulation: what [`SubDevice::is_regular`] makes sure of is not checked
//! again, and steps between whose beginning and end nothing comes are done as a whole.

use isocat_esc::Pdi;
use isocat_sync::{Event, Step};
use isocat_wire::register::al_event;
use isocat_wire::time::{Device, Time};

use crate::application::Application;
use crate::prepared::{Place, Prepared};
use crate::stack::SubDevice;
use crate::sync_engine::Prompt;

impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// As [`handle_event_in_place`](Self::handle_event_in_place), if the device is
    /// [regular](Self::is_regular) and its [`sync_deadline`](Self::sync_deadline) is to come.
    #[inline(always)]
    pub fn handle_regular_event<T>(
        &mut self,
        now: Time<Device>,
        event: Event,
        pdi: &mut impl Pdi,
        prepared: &mut Prepared<T>,
    ) -> Option<Place> {
        self.application.event(event);
        if event == Event::Sm3 && self.sync.has_outputs() {
            // It takes the place of SM2 only where that never comes.
            return None;
        }
        let looks = self.sync.looks_for_outputs(event) && self.sync.has_outputs();
        let new_outputs = looks && pdi.events() & self.output_event() != 0;
        let before = self.sync.missed_events_total();
        let prompt = self.sync.react_prepared(now, event, (new_outputs, true), prepared);
        if event == Event::Sm2 {
            if prompt == Prompt::Drop {
                self.process_data.drop_outputs(pdi);
            }
        } else if self.sync.missed_events_total() != before && !self.stays(now, event, true, pdi) {
            // The pulse itself has shown that too many events are missing.
            return None;
        }
        match prompt {
            Prompt::Start(place) => Some(place),
            Prompt::Nothing | Prompt::Drop => None,
        }
    }

    /// Whether its AL status stays as it is at the next SYNC pulse, if the device is
    /// [regular](Self::is_regular) and its [`sync_deadline`](Self::sync_deadline) is behind that.
    #[inline]
    pub fn bears_a_miss(&self) -> bool {
        self.sync.bears_a_miss()
    }

    /// The timer of Free Run ticks on a device that is [regular](Self::is_regular): as
    /// [`handle_event_in_place`](Self::handle_event_in_place) and then [`poll`](Self::poll).
    /// Returns also whether the main loop had work, so that anything may have changed.
    #[inline]
    pub fn regular_tick<T>(
        &mut self,
        now: Time<Device>,
        pdi: &mut impl Pdi,
        prepared: &mut Prepared<T>,
    ) -> (Option<Place>, bool) {
        self.application.event(Event::Timer);
        let events = pdi.events();
        let looks = self.sync.looks_for_outputs(Event::Timer) && self.sync.has_outputs();
        let new_outputs = looks && events & self.output_event() != 0;
        let prompt = self.sync.react_prepared(now, Event::Timer, (new_outputs, true), prepared);
        let of_main_loop = al_event::AL_CONTROL | al_event::SM_ACTIVATION | al_event::WATCHDOG;
        let works = events & of_main_loop != 0
            || self.mailbox.wants(events)
            || self.mailbox.is_repeating()
            || self.esm.is_opening()
            || self.sync.sync_deadline().is_some_and(|deadline| now >= deadline)
            || self.sync.sequence_lost();
        if works {
            self.poll(now, pdi);
        }
        match prompt {
            Prompt::Start(place) => (Some(place), works),
            Prompt::Nothing | Prompt::Drop => (None, works),
        }
    }

    /// Whether [`whole_step`](Self::whole_step) may do the steps that events start: the device
    /// measures no times, and its outputs have no toggle bit. As long as the steps of an event
    /// are kept as they are, this does not change.
    #[inline]
    pub fn does_whole_steps(&self) -> bool {
        !self.sync.measures() && self.description().behaviour.output_toggle.is_none()
    }

    /// Does a step that an event has started. It ends before any other step begins, and before the
    /// [`sync_deadline`](Self::sync_deadline). This is [`begin`](Self::begin) and
    /// [`finish`](Self::finish) at once.
    #[inline(always)]
    pub fn whole_step(&mut self, step: Step, pdi: &mut impl Pdi) {
        self.sync.ran(step);
        match step {
            Step::MapOutputs => {
                let outputs = self.process_data.fetch_outputs(self.dictionary.outputs_mut(), pdi);
                self.sync.outputs_fetched(None);
                if self.sync.outputs_ready() {
                    self.application.map_outputs(outputs);
                }
                debug_assert!(!self.sync.sequence_lost(), "it would have left OP");
            }
            Step::Application => self.application.application(self.sync.application_cycle()),
            Step::OutputsValid => self.application.outputs_valid(),
            Step::LatchInputs => self.application.latch_inputs(),
            Step::MapInputs => self.hand_over_inputs(pdi),
        }
    }
}

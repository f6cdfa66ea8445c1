//! Regular operation in a simulation: what [`SubDevice::is_regular`] makes sure of is not checked
//! again, and steps between whose beginning and end nothing comes are done as a whole.

use isocat_esc::Pdi;
use isocat_sync::{Event, Step};
use isocat_wire::time::{Device, Time};

use crate::application::Application;
use crate::prepared::{Prepared, Started};
use crate::stack::SubDevice;

impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// As [`handle_event_prepared`](Self::handle_event_prepared), if the device is
    /// [regular](Self::is_regular) and its [`sync_deadline`](Self::sync_deadline) is to come.
    #[inline(always)]
    pub fn handle_regular_event<'p, T>(
        &mut self,
        now: Time<Device>,
        event: Event,
        pdi: &mut impl Pdi,
        prepared: &'p mut Prepared<T>,
    ) -> Started<'p, T> {
        self.application.event(event);
        let looks = self.sync.looks_for_outputs(event) && self.sync.has_outputs();
        let new_outputs = looks && pdi.events() & self.output_event() != 0;
        let started = self.sync.react_prepared(now, event, (new_outputs, true), prepared);
        let Some(started) = started else {
            self.process_data.drop_outputs(pdi);
            return Started::NOTHING;
        };
        // The pulse itself may have shown that too many events are missing.
        if self.sync.sequence_lost() && !self.stays(now, event, true, pdi) {
            return Started::NOTHING;
        }
        started
    }

    /// Whether [`whole_step`](Self::whole_step) may do the steps of the last event: the device is
    /// [regular](Self::is_regular), measures no times, and its outputs have no toggle bit.
    #[inline]
    pub fn does_whole_steps(&self) -> bool {
        !self.sync.measures() && self.description().behaviour.output_toggle.is_none()
    }

    /// Does a step that an event has started. It ends at `end`, before any other step begins. This
    /// is [`begin`](Self::begin) and [`finish`](Self::finish) at once.
    #[inline(always)]
    pub fn whole_step(&mut self, end: Time<Device>, step: Step, pdi: &mut impl Pdi) {
        self.sync.ran(step);
        match step {
            Step::MapOutputs => {
                self.process_data.fetch_outputs(self.dictionary.images_mut().outputs, pdi);
                self.sync.outputs_fetched(None);
                if self.sync.outputs_ready() {
                    let image = self.dictionary.output_image();
                    self.application.map_outputs(self.process_data.outputs(image));
                }
                self.supervise(end, pdi);
            }
            Step::Application => self.application.application(self.sync.application_cycle()),
            Step::OutputsValid => self.application.outputs_valid(),
            Step::LatchInputs => self.application.latch_inputs(),
            Step::MapInputs => self.hand_over_inputs(pdi),
        }
    }
}

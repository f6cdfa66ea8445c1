//! The application of a simulated SubDevice, and what else looks at its process data.

use isocat_subdevice::{Application, Event};
use isocat_wire::{AbortCode, Nanos, ObjectAddress};

use crate::plant::Plant;
use crate::sampling::{Sampler, Sampling};

/// An application behind a pointer, since the devices of a segment have different ones. It notes
/// when outputs were mapped and acted, which only the stack decides, and passes them to the plant
/// that they move.
pub struct BoxedApplication {
    application: Box<dyn Application + Send>,
    /// Whether outputs were mapped since the last check.
    mapped: bool,
    /// Whether its outputs acted since the last check.
    acted: bool,
    made_safe: bool,
    /// What else looks at its process data; few devices have it.
    beside: Option<Box<Beside>>,
}

/// What looks at the process data of a device beside its application.
struct Beside {
    /// The plant that its outputs move.
    plant: Option<Plant>,
    /// The converters of a device that oversamples.
    sampler: Option<Sampler>,
}

/// Functions of their own, so that the way of a device without them stays short.
impl Beside {
    #[inline(never)]
    fn event(&mut self, event: Event) {
        self.sampler.iter_mut().for_each(|sampler| sampler.event(event));
    }
    #[inline(never)]
    fn map(&mut self, outputs: &[u8]) {
        self.plant.iter_mut().for_each(|plant| plant.map(outputs));
        self.sampler.iter_mut().for_each(|sampler| sampler.map(outputs));
    }
    #[inline(never)]
    fn act(&mut self) {
        self.plant.iter_mut().for_each(|plant| plant.act());
    }
    #[inline(never)]
    fn latch(&mut self) {
        self.plant.iter_mut().for_each(|plant| plant.latch());
        self.sampler.iter_mut().for_each(|sampler| sampler.latch());
    }
    #[inline(never)]
    fn show_samples(&self, inputs: &mut [u8]) {
        self.sampler.iter().for_each(|sampler| sampler.show(inputs));
    }
    #[inline(never)]
    fn show_plant(&self, inputs: &mut [u8]) {
        self.plant.iter().for_each(|plant| plant.show(inputs));
    }
}

impl BoxedApplication {
    /// Around this application.
    pub(super) fn new(
        application: Box<dyn Application + Send>,
        sampling: Option<Sampling>,
    ) -> Self {
        let beside = sampling.map(|sampling| {
            Box::new(Beside { plant: None, sampler: Some(Sampler::new(sampling)) })
        });
        Self { application, mapped: false, acted: false, made_safe: false, beside }
    }

    pub(super) fn take_mapped(&mut self) -> bool {
        std::mem::take(&mut self.mapped)
    }

    pub(super) fn take_acted(&mut self) -> bool {
        std::mem::take(&mut self.acted)
    }

    /// Whether outputs became safe since the last call.
    pub(super) fn take_made_safe(&mut self) -> bool {
        std::mem::take(&mut self.made_safe)
    }

    /// Whether nothing else looks at its process data.
    #[inline]
    pub(super) fn is_bare(&self) -> bool {
        self.beside.is_none()
    }

    /// Where its plant is; `None` if nothing is beside it.
    pub(super) fn plant(&mut self) -> Option<&mut Option<Plant>> {
        self.beside.as_deref_mut().map(|beside| &mut beside.plant)
    }

    pub(super) fn take_plant(&mut self, plant: Option<Plant>) {
        if plant.is_some() || self.beside.is_some() {
            let nothing = || Box::new(Beside { plant: None, sampler: None });
            self.beside.get_or_insert_with(nothing).plant = plant;
        }
    }

    pub(super) fn sampler_mut(&mut self) -> Option<&mut Sampler> {
        self.beside.as_deref_mut()?.sampler.as_mut()
    }

    pub(super) fn sampler(&self) -> Option<&Sampler> {
        self.beside.as_deref()?.sampler.as_ref()
    }
}

impl Application for BoxedApplication {
    fn power_off(&mut self) {
        if let Some(Beside { plant, sampler }) = self.beside.as_deref_mut() {
            plant.iter_mut().for_each(|plant| plant.release());
            sampler.iter_mut().for_each(|sampler| sampler.power_off());
        }
        self.application.power_off();
    }
    #[inline(always)]
    fn event(&mut self, event: Event) {
        if let Some(beside) = &mut self.beside {
            beside.event(event);
        }
        self.application.event(event);
    }
    #[inline(always)]
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.mapped = true;
        if let Some(beside) = &mut self.beside {
            beside.map(outputs);
        }
        self.application.map_outputs(outputs);
    }
    #[inline]
    fn application(&mut self, cycle: Nanos) {
        self.application.application(cycle);
    }
    #[inline]
    fn outputs_valid(&mut self) {
        self.acted = true;
        if let Some(beside) = &mut self.beside {
            beside.act();
        }
        self.application.outputs_valid();
    }
    #[inline]
    fn latch_inputs(&mut self) {
        if let Some(beside) = &mut self.beside {
            beside.latch();
        }
        self.application.latch_inputs();
    }
    #[inline]
    fn map_inputs(&mut self, inputs: &mut [u8]) {
        if let Some(beside) = &self.beside {
            beside.show_samples(inputs);
        }
        self.application.map_inputs(inputs);
        if let Some(beside) = &self.beside {
            beside.show_plant(inputs);
        }
    }
    fn safe_outputs(&mut self) {
        self.made_safe = true;
        if let Some(Beside { plant, sampler }) = self.beside.as_deref_mut() {
            plant.iter_mut().for_each(|plant| plant.release());
            sampler.iter_mut().for_each(|sampler| sampler.release());
        }
        self.application.safe_outputs();
    }
    fn read_object(
        &mut self,
        object: ObjectAddress,
        value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        self.application.read_object(object, value)
    }
    fn write_object(&mut self, object: ObjectAddress, value: &[u8]) -> Result<(), AbortCode> {
        self.application.write_object(object, value)
    }
}

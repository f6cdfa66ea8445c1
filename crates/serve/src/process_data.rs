//! The process data of a served device, for a caller that reads and sets them.
//!
//! Each device's application runs behind a [`Door`]. The door keeps a copy of the outputs that the
//! application gets, and replaces the application's inputs by the caller's. Both happen in the
//! device's own steps, so the caller's inputs are on the wire when the device maps its inputs the
//! next time, and not before.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use isocat_subdevice::Application;
use isocat_sync::Event;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

/// The data that the caller and the device share.
#[derive(Debug)]
pub(crate) struct ProcessData {
    /// The outputs that the device took last. The memory is kept, so that a cycle allocates
    /// nothing.
    outputs: Vec<u8>,
    /// The device drives its outputs; otherwise they are in their safe state.
    driven: bool,
    /// The caller's inputs; `None` if the application's are used.
    inputs: Option<Vec<u8>>,
}

/// The caller's side of a [`Door`].
#[derive(Clone, Debug)]
pub(crate) struct Handle(Arc<Mutex<ProcessData>>);

impl Handle {
    /// A handle for a device with at most this many bytes of outputs.
    pub fn new(most_outputs: u16) -> Self {
        let outputs = Vec::with_capacity(most_outputs.into());
        Self(Arc::new(Mutex::new(ProcessData { outputs, driven: false, inputs: None })))
    }

    /// The outputs that the device took last; `None` while they are in their safe state.
    pub fn outputs(&self) -> Option<Vec<u8>> {
        let data = self.lock();
        data.driven.then(|| data.outputs.clone())
    }

    /// Sets the inputs; `None` returns them to the application.
    pub fn set_inputs(&self, inputs: Option<&[u8]>) {
        self.lock().inputs = inputs.map(<[u8]>::to_vec);
    }

    /// The application, with the door in front of it.
    pub fn before(&self, application: Box<dyn Application + Send>) -> Box<dyn Application + Send> {
        Box::new(Door { data: self.clone(), application })
    }

    fn lock(&self) -> MutexGuard<'_, ProcessData> {
        // A panic leaves nothing half done, since the image is replaced as a whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An application whose process data the caller can read and set.
struct Door {
    data: Handle,
    application: Box<dyn Application + Send>,
}

impl Application for Door {
    fn event(&mut self, event: Event) {
        self.application.event(event);
    }

    fn map_outputs(&mut self, outputs: &[u8]) {
        let mut data = self.data.lock();
        data.driven = true;
        data.outputs.clear();
        data.outputs.extend_from_slice(outputs);
        drop(data);
        self.application.map_outputs(outputs);
    }

    fn application(&mut self, cycle: Nanos) {
        self.application.application(cycle);
    }

    fn outputs_valid(&mut self) {
        self.application.outputs_valid();
    }

    fn latch_inputs(&mut self) {
        self.application.latch_inputs();
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        self.application.map_inputs(inputs);
        if let Some(set) = &self.data.lock().inputs {
            let len = set.len().min(inputs.len());
            inputs[..len].copy_from_slice(&set[..len]);
        }
    }

    fn safe_outputs(&mut self) {
        self.data.lock().driven = false;
        self.application.safe_outputs();
    }

    fn power_off(&mut self) {
        self.data.lock().driven = false;
        self.application.power_off();
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

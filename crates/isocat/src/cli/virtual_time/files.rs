//! The files of a run, shared by the segment, which fills them, and the command, which completes
//! them.

use std::sync::{Arc, Mutex, PoisonError};

use isocat_maindevice::Port;
use isocat_sim::bench::Measured;
use isocat_sim::observation::Observation;
use isocat_sim::{Lost, Segment, ServedCycle, Tap};
use isocat_wire::time::{Time, True};

use crate::cli::files::Files;

/// Files that are written while the program runs.
#[derive(Clone)]
pub struct SharedFiles(Arc<Mutex<Option<Files>>>);

impl SharedFiles {
    pub fn new(files: Files) -> Self {
        Self(Arc::new(Mutex::new(Some(files))))
    }

    /// The tap that writes them; `None` if there are none.
    pub fn tap(&self) -> Option<Box<dyn Tap + Send>> {
        let files = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = files.as_ref().is_some_and(|files| !files.is_empty());
        wanted.then(|| Box::new(self.clone()) as _)
    }

    /// Writes the rest.
    pub fn finish(&self) -> Result<(), String> {
        let files = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        files.map_or(Ok(()), |files| files.finish().map(drop))
    }

    fn with(&self, show: impl FnOnce(&mut Files)) {
        let mut files = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(files) = files.as_mut() {
            show(files);
        }
    }
}

impl Tap for SharedFiles {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.with(|files| files.frame(at, sent, bytes));
    }
    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.with(|files| files.secondary_frame(at, sent, bytes));
    }
    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        self.with(|files| files.lost(at, port, why));
    }
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.with(|files| files.observed(segment, at, observation));
    }
    fn served_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>, segment: &Segment) {
        self.with(|files| files.served_cycle(at, cycle, segment));
    }
    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        self.with(|files| files.measured(at, device, measured));
    }
}

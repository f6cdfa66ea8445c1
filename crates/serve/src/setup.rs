//! What is served: the devices, the seed, and the limits that the judges go by.

use isocat_segment::Scenario;
use isocat_sim::{Closing, Connection, DeviceSetup, Expectation, Planned};
use isocat_subdevice::Application;
use isocat_wire::time::Picos;

/// The segment that a [`Server`](crate::Server) serves.
///
/// Made of a [`Scenario`], or by hand. The application of a device may be the caller's own, see
/// [`with_application`](Self::with_application).
pub struct Setup {
    /// The SubDevices. Parents stand before their children.
    pub segment: Vec<Connection>,
    /// What makes a ring of them; `None`: they hang on one port.
    pub ring: Option<Closing>,
    /// Their names, in the same order.
    pub names: Vec<String>,
    /// The seed of all randomness.
    pub seed: u64,
    /// What goes wrong of itself. What concerns a host is left out unless
    /// [`has_host`](Self::has_host).
    pub faults: Vec<Planned>,
    /// The caller runs the MainDevice's machine and lets stalls, jumps of its clock, late wake-ups and slow sends happen to it, as
    /// [`Event::Fault`] tells. What the host's clock or another MainDevice does is left out all the same. Default false.
    ///
    /// [`Event::Fault`]: crate::server::Event::Fault
    pub has_host: bool,
    /// What is expected of all this: [`Server::judgements`](crate::Server::judgements) tells what
    /// became of it.
    pub expectations: Vec<Expectation>,
    /// SubDevices that may come in the place of others.
    pub spares: Vec<DeviceSetup>,
    /// Largest SYNC0 error with which a SubDevice counts as synchronized.
    pub sync0_limit: Picos,
    /// Largest spread of outputs behind their pulse with which a SubDevice counts as synchronized.
    pub outputs_spread: Picos,
    /// The server's caller may look at process data and set them. A service that nobody asks for
    /// them does without, and saves some hundred instructions for each device and cycle. Default
    /// true.
    pub shows_process_data: bool,
}

impl From<&Scenario> for Setup {
    fn from(scenario: &Scenario) -> Self {
        let setup = scenario.run().setup;
        Self {
            segment: setup.segment,
            ring: setup.ring,
            names: scenario.devices.iter().map(|device| device.name.clone()).collect(),
            seed: setup.seed,
            faults: setup.faults,
            has_host: false,
            expectations: scenario.expectations.clone(),
            spares: setup.spares,
            sync0_limit: scenario.sync0_limit.into(),
            outputs_spread: scenario.outputs_spread.into(),
            shows_process_data: true,
        }
    }
}

impl Setup {
    /// The caller runs the MainDevice's machine, see [`has_host`](Self::has_host).
    pub fn with_host(mut self) -> Self {
        self.has_host = true;
        self
    }

    /// Nobody will look at process data or set them.
    pub fn without_process_data(mut self) -> Self {
        self.shows_process_data = false;
        self
    }

    /// Gives the device at `position` an application of the caller's own. Its process data, objects and times stay those of its
    /// profile.
    ///
    /// # Panics
    ///
    /// If there is no such device.
    pub fn with_application(
        mut self,
        position: usize,
        application: impl Application + Send + 'static,
    ) -> Self {
        self.segment[position].device.application = Box::new(application);
        self
    }
}

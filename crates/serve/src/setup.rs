//! The setup of a service: the devices, the seed, and the judges' limits.

use isocat_rules::Claims;
use isocat_segment::Scenario;
use isocat_sim::{Closing, Connection, DeviceSetup, Expectation, Planned};
use isocat_subdevice::Application;
use isocat_wire::time::Picos;

/// The segment that a [`Server`](crate::Server) serves.
///
/// It is made from a [`Scenario`], or by hand. The application of a device may be the caller's own,
/// see [`with_application`](Self::with_application).
pub struct Setup {
    /// The SubDevices; parents come before their children.
    pub segment: Vec<Connection>,
    /// The cable that makes a ring of them; `None`: all hang on one port.
    pub ring: Option<Closing>,
    /// Their names, in the same order.
    pub names: Vec<String>,
    /// The seed of all randomness.
    pub seed: u64,
    /// The planned faults. Faults of a host are left out unless [`has_host`](Self::has_host).
    pub faults: Vec<Planned>,
    /// The caller simulates the MainDevice's machine and executes its stalls, clock jumps, late
    /// wake-ups and slow sends when [`Event::Fault`] reports them. Faults of the host's clock or of
    /// another MainDevice are left out in any case. Default false.
    ///
    /// [`Event::Fault`]: crate::server::Event::Fault
    pub has_host: bool,
    /// The expectations; [`Server::judgements`](crate::Server::judgements) returns the results.
    pub expectations: Vec<Expectation>,
    /// SubDevices that may replace others.
    pub spares: Vec<DeviceSetup>,
    /// Largest SYNC0 error with which a SubDevice counts as synchronized.
    pub sync0_limit: Picos,
    /// Largest spread of outputs behind their pulse with which a SubDevice counts as synchronized.
    pub outputs_spread: Picos,
    /// What the segment is meant to do; a MainDevice that does otherwise is a finding. By default
    /// the claims of the segment file, and none without a file.
    pub claims: Claims,
    /// Whether the server's caller may read and set process data. A service without such access
    /// saves some hundred instructions for each device and cycle. Default true.
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
            claims: scenario.claims(),
            shows_process_data: true,
        }
    }
}

impl Setup {
    /// The caller simulates the MainDevice's machine, see [`has_host`](Self::has_host).
    pub fn with_host(mut self) -> Self {
        self.has_host = true;
        self
    }

    /// Switches the access to process data off.
    pub fn without_process_data(mut self) -> Self {
        self.shows_process_data = false;
        self
    }

    /// Gives the device at `position` an application of the caller. Its process data, objects and
    /// times stay those of its profile.
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

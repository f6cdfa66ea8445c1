//! The part that a device author writes.

use isocat_sync::Event;
use isocat_wire::soe::{self, Idn};
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

/// The application of a SubDevice. Every call has a default that does nothing.
///
/// The stack calls the steps of a cycle in the order and at the instants of the synchronization
/// mode (see `isocat_sync::Step`).
pub trait Application {
    /// Called at an event in SAFEOP or OP, before the steps that it starts, for programs that do
    /// more at an event than these steps.
    fn event(&mut self, _event: Event) {}

    /// Takes the outputs that arrived: the process image of SM2. Called only in OP.
    fn map_outputs(&mut self, _outputs: &[u8]) {}

    /// Does the application's own work, once in a cycle of `cycle` (zero if unknown). With
    /// subordinated cycles it is the cycle of SYNC0, unless the application runs at SYNC1.
    fn application(&mut self, _cycle: Nanos) {}

    /// Lets the outputs act on the process from now on.
    fn outputs_valid(&mut self) {}

    /// Latches the inputs of the process now.
    fn latch_inputs(&mut self) {}

    /// Writes the inputs into the process image of SM3.
    fn map_inputs(&mut self, _inputs: &mut [u8]) {}

    /// Sets the outputs to their safe state: OP was left.
    fn safe_outputs(&mut self) {}

    /// Called when the device is switched off and will start again: the content of RAM is lost.
    /// Outputs have no power, so [`safe_outputs`](Self::safe_outputs) is not called.
    fn power_off(&mut self) {}

    /// Reads the present value of an object of the application into the front of `value`; returns
    /// its length in bytes. `None` leaves the object to the stack's own store.
    fn read_object(
        &mut self,
        _object: ObjectAddress,
        _value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        None
    }

    /// Reads the present value of a parameter of the application, for SoE, into the front of
    /// `value`; returns its length in bytes. A list begins with its length
    /// ([`Parameter`](crate::Parameter)). `None` leaves it to the stack's own store.
    fn read_parameter(
        &mut self,
        _drive: u8,
        _idn: Idn,
        _value: &mut [u8],
    ) -> Option<Result<usize, soe::ErrorCode>> {
        None
    }

    /// Called when a value is written to a parameter; an error ends the transfer, and nothing is
    /// stored.
    fn write_parameter(
        &mut self,
        _drive: u8,
        _idn: Idn,
        _value: &[u8],
    ) -> Result<(), soe::ErrorCode> {
        Ok(())
    }

    /// Called when a value is written to an object; an error aborts the transfer, and nothing is
    /// stored.
    fn write_object(&mut self, _object: ObjectAddress, _value: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }
}

impl Application for () {}

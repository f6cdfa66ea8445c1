//! What a device author writes.

use isocat_sync::Event;
use isocat_wire::soe::{self, Idn};
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

/// The application of a SubDevice. Every call has a default that does nothing.
///
/// The stack calls the steps of a cycle in the order and at the instants that the synchronization mode
/// gives them (see `isocat_sync::Step`).
pub trait Application {
    /// An event came in SAFEOP or OP, before the steps that it starts: for programs that do more at an event than
    /// the steps of the mode.
    fn event(&mut self, _event: Event) {}

    /// Outputs have arrived: the process image of SM2. Called in OP only.
    fn map_outputs(&mut self, _outputs: &[u8]) {}

    /// The application's own work, once a cycle of `cycle` (zero if unknown). With subordinated cycles
    /// that is the cycle of SYNC0, unless the application runs at SYNC1.
    fn application(&mut self, _cycle: Nanos) {}

    /// The outputs act on the process from now on.
    fn outputs_valid(&mut self) {}

    /// Take the inputs from the process now.
    fn latch_inputs(&mut self) {}

    /// Put the inputs into the process image of SM3.
    fn map_inputs(&mut self, _inputs: &mut [u8]) {}

    /// OP was left: outputs go to their safe state.
    fn safe_outputs(&mut self) {}

    /// The device is switched off, and will start anew: what was kept in RAM is gone. Outputs are
    /// without power, so [`safe_outputs`](Self::safe_outputs) is not called.
    fn power_off(&mut self) {}

    /// The present value of an object of the application, into the front of `value`; gives its bytes.
    /// `None` leaves the object to the stack's own store.
    fn read_object(
        &mut self,
        _object: ObjectAddress,
        _value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        None
    }

    /// The present value of a parameter of the application, which SoE asks for, into the front of `value`; gives its
    /// bytes. A list has its length in front ([`Parameter`](crate::Parameter)). `None` leaves it to the stack's own store.
    fn read_parameter(
        &mut self,
        _drive: u8,
        _idn: Idn,
        _value: &mut [u8],
    ) -> Option<Result<usize, soe::ErrorCode>> {
        None
    }

    /// A value was written to a parameter; an error ends the transfer and nothing is stored.
    fn write_parameter(
        &mut self,
        _drive: u8,
        _idn: Idn,
        _value: &[u8],
    ) -> Result<(), soe::ErrorCode> {
        Ok(())
    }

    /// A value was written to an object; an error aborts the transfer and nothing is stored.
    fn write_object(&mut self, _object: ObjectAddress, _value: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }
}

impl Application for () {}

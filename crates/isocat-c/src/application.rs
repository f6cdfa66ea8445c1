//! The behaviour of a SubDevice, written in C.

use std::ffi::c_void;

use isocat_subdevice::Application;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

/// Returned by read_object and write_object for an object that the application does not have: then
/// the SubDevice's own store handles it.
pub const ISOCAT_NOT_MINE: u32 = 0xFFFFFFFF;

/// The application of a SubDevice. Each function may be NULL: then that step does nothing. Set the
/// whole struct to 0, then `size`.
///
/// Functions are called from calls on a bus (send, advance, and those that read SubDevices), on the
/// calling thread, one at a time, in the order of virtual time. They must return: no longjmp, no
/// exceptions. Meanwhile calls on the same bus are refused (ISOCAT_BUSY). Memory passed to a
/// function is valid until the function returns.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_application {
    /// sizeof(isocat_application).
    pub size: usize,
    /// The first argument of each function; the library does not read what it points to.
    pub user: *mut c_void,
    /// New outputs of the MainDevice, as process image. Only called in OP.
    pub map_outputs: Option<extern "C" fn(user: *mut c_void, outputs: *const u8, length: usize)>,
    /// The application's own work, called once in each cycle. `cycle_ns` is the cycle in ns, or 0
    /// if it is not known.
    pub work: Option<extern "C" fn(user: *mut c_void, cycle_ns: i64)>,
    /// Outputs act on the process from now on.
    pub outputs_valid: Option<extern "C" fn(user: *mut c_void)>,
    /// Takes the inputs from the process now.
    pub latch_inputs: Option<extern "C" fn(user: *mut c_void)>,
    /// Writes the inputs into the process image to the MainDevice. Bytes that are not written keep
    /// their values.
    pub map_inputs: Option<extern "C" fn(user: *mut c_void, inputs: *mut u8, length: usize)>,
    /// OP was left: outputs take their safe state.
    pub safe_outputs: Option<extern "C" fn(user: *mut c_void)>,
    /// The SubDevice lost its power. When it comes back, it starts from INIT.
    pub power_off: Option<extern "C" fn(user: *mut c_void)>,
    /// An object is read. Writes its value to `value`, which holds up to `capacity` bytes, and its
    /// length to `length`. Returns 0, an SDO abort code, or ISOCAT_NOT_MINE.
    pub read_object: Option<
        extern "C" fn(
            user: *mut c_void,
            index: u16,
            sub: u8,
            value: *mut u8,
            capacity: usize,
            length: *mut usize,
        ) -> u32,
    >,
    /// An object was written. Returns 0 or ISOCAT_NOT_MINE if the value may be stored, or an SDO
    /// abort code.
    pub write_object: Option<
        extern "C" fn(
            user: *mut c_void,
            index: u16,
            sub: u8,
            value: *const u8,
            length: usize,
        ) -> u32,
    >,
}

/// The application that a SubDevice runs.
#[derive(Clone, Copy)]
pub(crate) struct Own(pub(crate) isocat_application);

impl Own {
    fn step(&self, step: Option<extern "C" fn(*mut c_void)>) {
        if let Some(step) = step {
            step(self.0.user);
        }
    }
}

impl Application for Own {
    fn map_outputs(&mut self, outputs: &[u8]) {
        if let Some(map) = self.0.map_outputs {
            map(self.0.user, outputs.as_ptr(), outputs.len());
        }
    }

    fn application(&mut self, cycle: Nanos) {
        if let Some(work) = self.0.work {
            work(self.0.user, cycle.0);
        }
    }

    fn outputs_valid(&mut self) {
        self.step(self.0.outputs_valid);
    }

    fn latch_inputs(&mut self) {
        self.step(self.0.latch_inputs);
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        if let Some(map) = self.0.map_inputs {
            map(self.0.user, inputs.as_mut_ptr(), inputs.len());
        }
    }

    fn safe_outputs(&mut self) {
        self.step(self.0.safe_outputs);
    }

    fn power_off(&mut self) {
        self.step(self.0.power_off);
    }

    fn read_object(
        &mut self,
        object: ObjectAddress,
        value: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        let read = self.0.read_object?;
        let mut length = 0;
        let (index, sub, capacity) = (object.index, object.sub, value.len());
        match read(self.0.user, index, sub, value.as_mut_ptr(), capacity, &raw mut length) {
            ISOCAT_NOT_MINE => None,
            // The application claims more bytes than the buffer holds.
            0 if length > capacity => Some(Err(AbortCode::GENERAL)),
            0 => Some(Ok(length)),
            code => Some(Err(AbortCode(code))),
        }
    }

    fn write_object(&mut self, object: ObjectAddress, value: &[u8]) -> Result<(), AbortCode> {
        let Some(write) = self.0.write_object else { return Ok(()) };
        match write(self.0.user, object.index, object.sub, value.as_ptr(), value.len()) {
            0 | ISOCAT_NOT_MINE => Ok(()),
            code => Err(AbortCode(code)),
        }
    }
}

//! The behaviour of a SubDevice, written in C.

use std::ffi::c_void;

use isocat_subdevice::Application;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

/// What read_object and write_object answer for an object that the application does not have: the
/// SubDevice's own store has it.
pub const ISOCAT_NOT_MINE: u32 = 0xFFFFFFFF;

/// The application of a SubDevice. Every function may be NULL: then nothing is done in that step.
/// Set all of it to 0, then `size`.
///
/// Functions are called out of the calls of a bus (send, advance, and whatever looks at
/// SubDevices), on the thread that made the call, one at a time, in the order of virtual time. They
/// must return: no longjmp, no exceptions. Calls on the same bus are refused meanwhile
/// (ISOCAT_BUSY). Memory that they are given is theirs until they return.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_application {
    /// sizeof(isocat_application).
    pub size: usize,
    /// What each function gets as its first argument; the library does not look behind it.
    pub user: *mut c_void,
    /// Outputs have come: the process image from the MainDevice. In OP only.
    pub map_outputs: Option<extern "C" fn(user: *mut c_void, outputs: *const u8, length: usize)>,
    /// The application's own work, called once in each cycle. `cycle_ns` is the cycle in ns, and 0
    /// where it is not known.
    pub work: Option<extern "C" fn(user: *mut c_void, cycle_ns: i64)>,
    /// Outputs act on the process from now on.
    pub outputs_valid: Option<extern "C" fn(user: *mut c_void)>,
    /// Inputs are to be taken from the process now.
    pub latch_inputs: Option<extern "C" fn(user: *mut c_void)>,
    /// Inputs are to be put into the process image to the MainDevice. Bytes that are left alone
    /// stay as they were.
    pub map_inputs: Option<extern "C" fn(user: *mut c_void, inputs: *mut u8, length: usize)>,
    /// OP was left: outputs go to their safe state.
    pub safe_outputs: Option<extern "C" fn(user: *mut c_void)>,
    /// The SubDevice lost its power. When it comes back, it starts from INIT.
    pub power_off: Option<extern "C" fn(user: *mut c_void)>,
    /// An object is read: its value goes into `value`, which has room for `capacity` bytes, and its
    /// length into `length`. Gives 0, an SDO abort code, or ISOCAT_NOT_MINE.
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
    /// An object was written. Gives 0 or ISOCAT_NOT_MINE where the value may be stored, or an SDO
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
            // More than there is room for is no value.
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

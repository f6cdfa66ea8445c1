//! SubDevices of a bus: their states and process data.

use crate::bus::{Inside, isocat_bus};
use crate::failure::{Failure, guard, isocat_code, isocat_error};
use crate::segment::check_position;
use crate::sys;

/// The state of a SubDevice.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct isocat_device_state {
    /// sizeof(isocat_device_state).
    pub size: usize,
    /// 1 INIT, 2 PREOP, 3 BOOT, 4 SAFEOP, 8 OP.
    pub state: u32,
    /// AL status code (0x0134): the reason of a state that was not requested; else 0.
    pub status_code: u32,
}

/// Calls `work` if a device has this position.
fn with_device<T>(
    bus: *const isocat_bus,
    position: usize,
    work: impl FnOnce(&mut Inside) -> Result<T, Failure>,
) -> Result<T, Failure> {
    isocat_bus::with(bus, |inside| {
        check_position(position, inside.bus.server().names().len())?;
        work(inside)
    })
}

/// The present state of a SubDevice.
///
/// `state`: receives it; `size` must be set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_device_get_state(
    bus: *mut isocat_bus,
    position: usize,
    state: *mut isocat_device_state,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        with_device(bus, position, |inside| {
            let found = inside.bus.state(position);
            let (now, code) = found.ok_or_else(|| Failure::range("expected a SubDevice"))?;
            let size = size_of::<isocat_device_state>();
            let status_code = code.0.into();
            sys::fill(state, isocat_device_state { size, state: now as u32, status_code })
        })
    })
}

/// The outputs that a SubDevice took last. ISOCAT_NOTHING while they are in their safe state.
///
/// `buffer`: holds up to `capacity` bytes.
/// `length`: receives the number of bytes; with ISOCAT_TOO_SMALL, the number that is needed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_device_outputs(
    bus: *mut isocat_bus,
    position: usize,
    buffer: *mut u8,
    capacity: usize,
    length: *mut usize,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        with_device(bus, position, |inside| {
            let outputs = inside.bus.outputs(position);
            sys::put("length", length, outputs.as_ref().map_or(0, Vec::len))?;
            let Some(outputs) = outputs else { return Ok(isocat_code::ISOCAT_NOTHING) };
            sys::copy("buffer", &outputs, buffer, capacity)?;
            Ok(isocat_code::ISOCAT_OK)
        })
    })
}

/// Sets the inputs of a SubDevice. They are on the wire after it has mapped its inputs the next
/// time, and remain until they are set again. Bytes of the process image beyond `length` remain
/// those of its application.
///
/// `inputs`: is copied; at most as many bytes as the SubDevice can have.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_device_set_inputs(
    bus: *mut isocat_bus,
    position: usize,
    inputs: *const u8,
    length: usize,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        with_device(bus, position, |inside| {
            let devices = inside.bus.server().served().segment().devices();
            let most = devices[position].stack.description().inputs.max_length;
            let inputs = sys::bytes("inputs", inputs, length, most.into())?;
            inside.bus.set_inputs(position, Some(inputs));
            Ok(())
        })
    })
}

/// Returns control of the inputs of a SubDevice to its application.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_device_release_inputs(
    bus: *mut isocat_bus,
    position: usize,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        with_device(bus, position, |inside| {
            inside.bus.set_inputs(position, None);
            Ok(())
        })
    })
}

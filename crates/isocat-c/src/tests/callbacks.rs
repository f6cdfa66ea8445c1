//! Tests SubDevices with applications of the caller.

use std::cell::Cell;
use std::ffi::c_void;
use std::ptr;

use super::runs::{main_device, run};
use super::*;
use crate::application::*;

/// What the functions of an application share.
struct Machine {
    bus: Cell<*mut isocat_bus>,
    value: Cell<u8>,
    worked: Cell<u32>,
    safe: Cell<u32>,
    /// The code of a call on the bus from inside a function.
    inside: Cell<Option<isocat_code>>,
}

fn machine(user: *mut c_void) -> &'static Machine {
    unsafe { &*user.cast::<Machine>() }
}

extern "C" fn map_outputs(user: *mut c_void, outputs: *const u8, length: usize) {
    assert_eq!(length, 4);
    machine(user).value.set(unsafe { *outputs });
}

extern "C" fn work(user: *mut c_void, cycle_ns: i64) {
    let machine = machine(user);
    assert!(cycle_ns == 0 || cycle_ns == 1_000_000, "{cycle_ns}");
    machine.worked.set(machine.worked.get() + 1);
    let mut now = 0;
    machine.inside.set(Some(unsafe { isocat_bus_now(machine.bus.get(), &raw mut now, NOWHERE) }));
    // Refused as well; otherwise the library would continue on freed memory.
    unsafe { isocat_bus_free(machine.bus.get()) };
}

extern "C" fn map_inputs(user: *mut c_void, inputs: *mut u8, _length: usize) {
    unsafe { *inputs = machine(user).value.get().wrapping_add(1) };
}

extern "C" fn safe_outputs(user: *mut c_void) {
    machine(user).safe.set(machine(user).safe.get() + 1);
}

fn application(machine: &Machine) -> isocat_application {
    isocat_application {
        size: size_of::<isocat_application>(),
        user: ptr::from_ref(machine).cast_mut().cast(),
        map_outputs: Some(map_outputs),
        work: Some(work),
        outputs_valid: None,
        latch_inputs: None,
        map_inputs: Some(map_inputs),
        safe_outputs: Some(safe_outputs),
        power_off: None,
        read_object: None,
        write_object: None,
    }
}

fn a_machine() -> Machine {
    Machine {
        bus: Cell::new(ptr::null_mut()),
        value: Cell::new(0),
        worked: Cell::new(0),
        safe: Cell::new(0),
        inside: Cell::new(None),
    }
}

#[test]
fn a_device_has_an_application_of_the_callers_own() {
    let machine = a_machine();
    let segment = three("");
    let own = application(&machine);
    done(|error| unsafe { isocat_segment_plug_in(segment, 1, &raw const own, error) });
    let bus = bus_of(segment);
    machine.bus.set(bus);
    let mut main = main_device();
    run(bus, &mut main, 500_000_000);
    main.outputs_mut(1)[0] = 41;
    run(bus, &mut main, 5_000_000);
    assert_eq!((main.inputs(1)[0], main.inputs(0)[0]), (42, 0));
    assert!(machine.worked.get() >= 100, "once a cycle");
    assert_eq!(machine.inside.get(), Some(isocat_code::ISOCAT_BUSY), "no call out of a callback");
    let safe = machine.safe.get();
    // Frames stop, and the watchdog of 100 ms expires.
    done(|error| unsafe { isocat_bus_advance(bus, now(bus) + 200_000_000, error) });
    assert_eq!(machine.safe.get(), safe + 1);
    unsafe { isocat_bus_free(bus) };
}

extern "C" fn read_object(
    _user: *mut c_void,
    index: u16,
    sub: u8,
    value: *mut u8,
    capacity: usize,
    length: *mut usize,
) -> u32 {
    match (index, sub) {
        (0x1008, 0) => {
            unsafe { ptr::copy_nonoverlapping(b"own".as_ptr(), value, capacity.min(3)) };
            unsafe { *length = 3 };
            0
        }
        (0x1009, 0) => {
            unsafe { *length = capacity + 1 };
            0
        }
        (0x100A, 0) => 0x0800_0020,
        _ => ISOCAT_NOT_MINE,
    }
}

extern "C" fn write_object(
    user: *mut c_void,
    _index: u16,
    sub: u8,
    value: *const u8,
    length: usize,
) -> u32 {
    machine(user).value.set(if length == 0 { 0 } else { unsafe { *value } });
    if sub == 0 { 0 } else { 0x0601_0002 }
}

#[test]
fn objects_are_read_and_written_by_callbacks() {
    use isocat_subdevice::Application;
    use isocat_wire::{AbortCode, ObjectAddress};
    let machine = a_machine();
    let mut own = Own(isocat_application {
        read_object: Some(read_object),
        write_object: Some(write_object),
        ..application(&machine)
    });
    let mut room = [0; 8];
    let mut read = |index| own.read_object(ObjectAddress::new(index, 0), &mut room);
    assert_eq!(read(0x1009), Some(Err(AbortCode::GENERAL)), "longer than its room");
    assert_eq!(read(0x100A), Some(Err(AbortCode(0x0800_0020))));
    assert_eq!(read(0x100B), None, "the store's");
    assert_eq!(read(0x1008), Some(Ok(3)));
    assert_eq!(&room[..3], b"own");
    assert_eq!(own.write_object(ObjectAddress::new(0x2000, 0), &[9]), Ok(()));
    assert_eq!(machine.value.get(), 9);
    let refused = own.write_object(ObjectAddress::new(0x2000, 1), &[]);
    assert_eq!(refused, Err(AbortCode(0x0601_0002)));
    let mut silent = Own(isocat_application { read_object: None, write_object: None, ..own.0 });
    assert_eq!(silent.read_object(ObjectAddress::new(0x1008, 0), &mut [0; 8]), None);
    assert_eq!(silent.write_object(ObjectAddress::new(0x2000, 1), &[]), Ok(()));
}

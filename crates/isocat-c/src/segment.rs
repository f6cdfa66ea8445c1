//! Segments: the SubDevices on the wire.

use std::collections::BTreeMap;
use std::ffi::{CString, c_char};
use std::ptr;
use std::sync::Mutex;

use ::isocat_segment::{Scenario, SegmentFile};
use isocat_descriptions::limits;

use crate::application::{Own, isocat_application};
use crate::failure::{Failure, guard, isocat_code, isocat_error, lock};
use crate::sys;

/// The version of this interface. It is raised when programs can no longer be linked with a newer
/// library.
pub const ISOCAT_ABI_VERSION: u32 = 0;

/// A segment: the SubDevices on the wire and their set-up. Buses and plans are made from it, and do
/// not need it afterwards.
pub struct isocat_segment {
    described: Mutex<Described>,
    names: Vec<CString>,
    cycle_ns: i64,
    ports: u32,
}

/// The parts that may be changed before a bus is made from it.
pub(crate) struct Described {
    pub scenario: Scenario,
    pub applications: BTreeMap<usize, Own>,
}

impl isocat_segment {
    fn new(file: SegmentFile) -> Self {
        let names = file.subdevices.iter().map(|device| sys::c_string(&device.name)).collect();
        let ports = if file.ring.is_some() { 2 } else { 1 };
        let cycle_ns = file.cycle.0;
        let described = Described { scenario: file.into(), applications: BTreeMap::new() };
        Self { described: Mutex::new(described), names, cycle_ns, ports }
    }

    /// Locks the description and calls `work` with it.
    pub(crate) fn with<T>(
        &self,
        work: impl FnOnce(&mut Described) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        work(&mut *lock("segment", &self.described)?)
    }
}

/// Refuses a position that no device has.
pub(crate) fn check_position(position: usize, devices: usize) -> Result<(), Failure> {
    match position < devices {
        true => Ok(()),
        false => Err(Failure::range(format!(
            "position {position}; expected 0 to {}",
            devices.saturating_sub(1)
        ))),
    }
}

/// ISOCAT_ABI_VERSION of the running library. A program compares it with that of its header.
#[unsafe(no_mangle)]
pub extern "C" fn isocat_abi_version() -> u32 {
    ISOCAT_ABI_VERSION
}

/// The version of the library, for example "0.1.0". Always valid.
#[unsafe(no_mangle)]
pub extern "C" fn isocat_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// Returns the built-in segment: two drives, a coupler with a terminal, and a third drive, at 1 ms.
///
/// `segment`: receives the handle, which is freed by isocat_segment_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_built_in(
    segment: *mut *mut isocat_segment,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::give("segment", segment, || Ok(isocat_segment::new(SegmentFile::built_in())))
    })
}

/// Reads a segment file (TOML, docs/segment-file.md) of at most 16 MiB, and the files that it
/// names.
///
/// `path`: UTF-8. Relative paths in the file begin at its folder.
/// `segment`: receives the handle, which is freed by isocat_segment_free.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_read(
    path: *const c_char,
    segment: *mut *mut isocat_segment,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::give("segment", segment, || {
            let file = SegmentFile::read(sys::text("path", path)?)?;
            Ok(isocat_segment::new(file))
        })
    })
}

/// Reads a segment file from memory.
///
/// `text`: `length` bytes of UTF-8, at most 16 MiB; a zero at the end is not needed.
/// `path`: the name in errors; relative paths in the text begin at its folder. NULL: the name is
/// "segment", and paths begin at the working directory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_parse(
    text: *const u8,
    length: usize,
    path: *const c_char,
    segment: *mut *mut isocat_segment,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::give("segment", segment, || {
            let path = if path.is_null() { "segment" } else { sys::text("path", path)? };
            let text = sys::utf8("text", sys::bytes("text", text, length, limits::TOML)?)?;
            Ok(isocat_segment::new(SegmentFile::parse(path, text)?))
        })
    })
}

/// The number of its SubDevices; 0 for NULL. Positions count from 0, in processing order.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_devices(segment: *const isocat_segment) -> usize {
    sys::borrow("segment", segment).map_or(0, |segment| segment.names.len())
}

/// The name of a SubDevice in UTF-8; NULL if there is none. Valid as long as the segment.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_device_name(
    segment: *const isocat_segment,
    position: usize,
) -> *const c_char {
    let name = |segment: &isocat_segment| Some(segment.names.get(position)?.as_ptr());
    sys::borrow("segment", segment).ok().and_then(name).unwrap_or(ptr::null())
}

/// The bus cycle of the description, ns; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_cycle_ns(segment: *const isocat_segment) -> i64 {
    sys::borrow("segment", segment).map_or(0, |segment| segment.cycle_ns)
}

/// The number of MainDevice ports that it needs: 1, or 2 for a ring; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_ports(segment: *const isocat_segment) -> u32 {
    sys::borrow("segment", segment).map_or(0, |segment| segment.ports)
}

/// Sets the seed of all random values, for buses that are made from now on. The default is the
/// file's seed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_set_seed(
    segment: *mut isocat_segment,
    seed: u64,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        sys::borrow("segment", segment)?.with(|described| {
            described.scenario.seed = seed;
            Ok(())
        })
    })
}

/// Replaces the application of a SubDevice by one of the caller, in buses that are made from now
/// on. Process data, objects and times remain those of its profile. A second call for the same
/// SubDevice replaces the first one.
///
/// `application`: is copied; `size` must be set. What `user` points to must live as long as the
/// buses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_plug_in(
    segment: *mut isocat_segment,
    position: usize,
    application: *const isocat_application,
    error: *mut *mut isocat_error,
) -> isocat_code {
    guard(error, || {
        let segment = sys::borrow("segment", segment)?;
        check_position(position, segment.names.len())?;
        let own = Own(sys::read(application)?);
        segment.with(|described| {
            described.applications.insert(position, own);
            Ok(())
        })
    })
}

/// Frees a segment; NULL is ignored.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn isocat_segment_free(segment: *mut isocat_segment) {
    sys::take(segment);
}

//! Tests the functions, called as C calls them.

mod callbacks;
mod hostile;
mod plans;
mod runs;

use std::ffi::{CStr, CString, c_char};
use std::ptr;

use crate::bus::*;
use crate::failure::*;
use crate::segment::*;

pub const BEGIN: u64 = 5_000_000_000;
pub const NOWHERE: *mut *mut isocat_error = ptr::null_mut();

/// Makes a call that may fail; returns its code, and the text of its error.
pub fn call(work: impl FnOnce(*mut *mut isocat_error) -> isocat_code) -> (isocat_code, String) {
    let mut error = ptr::null_mut();
    let code = work(&raw mut error);
    assert_eq!((code as i32) < 0, !error.is_null(), "an error if it failed, and none else");
    if error.is_null() {
        return (code, String::new());
    }
    let words = text(unsafe { isocat_error_text(error) });
    assert_eq!(unsafe { isocat_error_code(error) }, code);
    unsafe { isocat_error_free(error) };
    (code, words)
}

/// Makes a call that must not fail.
pub fn done(work: impl FnOnce(*mut *mut isocat_error) -> isocat_code) {
    assert_eq!(call(work), (isocat_code::ISOCAT_OK, String::new()));
}

pub fn text(pointer: *const c_char) -> String {
    assert!(!pointer.is_null());
    unsafe { CStr::from_ptr(pointer) }.to_str().expect("UTF-8").to_owned()
}

/// Makes a call that returns a text, which the caller owns.
pub fn owned(work: impl FnOnce(*mut *mut c_char, *mut *mut isocat_error) -> isocat_code) -> String {
    let mut given = ptr::null_mut();
    done(|error| work(&raw mut given, error));
    let words = text(given);
    unsafe { isocat_text_free(given) };
    words
}

pub fn c(text: &str) -> CString {
    CString::new(text).expect("no zero in it")
}

pub fn parse(text: &str) -> *mut isocat_segment {
    let mut segment = ptr::null_mut();
    let name = c("a test");
    done(|error| unsafe {
        isocat_segment_parse(text.as_ptr(), text.len(), name.as_ptr(), &raw mut segment, error)
    });
    segment
}

/// A segment of three devices in a line, with further keys of the file.
pub fn three(keys: &str) -> *mut isocat_segment {
    parse(&format!("cycle = \"1ms\"\n{keys}\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = 3\n"))
}

/// A bus of a segment; frees the segment.
pub fn bus_of(segment: *mut isocat_segment) -> *mut isocat_bus {
    let mut bus = ptr::null_mut();
    done(|error| unsafe { isocat_bus_new(segment, BEGIN, &raw mut bus, error) });
    unsafe { isocat_segment_free(segment) };
    bus
}

pub fn now(bus: *const isocat_bus) -> u64 {
    let mut now = 0;
    done(|error| unsafe { isocat_bus_now(bus, &raw mut now, error) });
    now
}

pub fn arrival() -> isocat_arrival {
    isocat_arrival { size: size_of::<isocat_arrival>(), at_ns: 0, length: 0, port: 0, reserved: 0 }
}

/// The next answer at a port.
pub fn receive(bus: *mut isocat_bus, port: u32) -> Option<(isocat_arrival, Vec<u8>)> {
    let (mut buffer, mut arrival) = ([0; 1514], arrival());
    let code = unsafe {
        isocat_bus_receive(bus, port, buffer.as_mut_ptr(), buffer.len(), &raw mut arrival, NOWHERE)
    };
    match code {
        isocat_code::ISOCAT_OK => Some((arrival, buffer[..arrival.length].to_vec())),
        isocat_code::ISOCAT_NOTHING => None,
        failed => panic!("{failed:?}"),
    }
}

/// A frame that all SubDevices count in.
pub fn count() -> Vec<u8> {
    let mut frame = vec![0; 60];
    frame[..6].fill(0xFF);
    frame[6] = 2;
    frame[12..14].copy_from_slice(&[0x88, 0xA4]);
    frame[14..16].copy_from_slice(&(0x1000_u16 | 14).to_le_bytes());
    // BRD of 0x0130, two bytes.
    frame[16] = 7;
    frame[20..22].copy_from_slice(&0x0130_u16.to_le_bytes());
    frame[22] = 2;
    frame
}

/// Sends that frame. If an answer comes, returns how many SubDevices counted, the port of the
/// answer, and the number of its copies.
pub fn counted(bus: *mut isocat_bus, port: u32, at: u64) -> Option<(u8, u32, usize)> {
    let frame = count();
    let mut sent =
        isocat_sent { size: size_of::<isocat_sent>(), back_ns: 7, comes_back: 7, port: 7 };
    done(|error| unsafe {
        isocat_bus_send(bus, port, at, frame.as_ptr(), frame.len(), &raw mut sent, error)
    });
    done(|error| unsafe { isocat_bus_advance(bus, at + 100_000, error) });
    let all: Vec<_> = std::iter::from_fn(|| receive(bus, ISOCAT_ANY_PORT)).collect();
    assert_eq!(sent.comes_back != 0, !all.is_empty());
    let (first, bytes) = all.first()?;
    assert_eq!((sent.back_ns, sent.port), (first.at_ns, first.port));
    assert!(sent.back_ns > at + 84 * 80, "the frame on the wire, and the devices");
    Some((bytes[28], first.port, all.len()))
}

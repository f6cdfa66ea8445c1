//! Sends SDO requests in any order to a SubDevice. The checks are those of the crate's own tests.
#![no_main]

#[path = "../../crates/subdevice/tests/checking/mod.rs"]
#[allow(dead_code, reason = "each target tells one kind of story")]
mod checking;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| checking::sdo(bytes));

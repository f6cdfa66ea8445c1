//! Changes the answers to a MainDevice as the bytes say: it must end, and its work must stay
//! bounded. The segment and the run are those of the crate's own tests.
#![no_main]

#[path = "../../crates/maindevice/tests/hostile/device.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod device;
#[path = "../../crates/maindevice/tests/hostile/lies.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod lies;
#[path = "../../crates/maindevice/tests/hostile/run.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod run;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| run::follow(bytes));

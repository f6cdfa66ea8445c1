//! Reads a capture of arbitrary bytes. The checks are those of the command's own tests.
#![no_main]

#[path = "../../crates/isocat/tests/descriptions/checking/mod.rs"]
#[allow(dead_code, reason = "each target tries one door")]
mod checking;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| checking::capture(bytes));

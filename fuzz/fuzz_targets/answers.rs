//! Feeds arbitrary bytes to the parsers of answers: frames, mailbox messages, CoE services. The
//! checks are those of the crate's own tests.
#![no_main]

#[path = "../../crates/wire/tests/checking/mod.rs"]
#[allow(dead_code, reason = "each target tells one kind of story")]
mod checking;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| checking::answers(bytes));

//! Parsers of what comes back: frames, mailbox messages, CoE services: what must hold is in the checking code of the crate's own tests.
#![no_main]

#[path = "../../crates/wire/tests/checking/mod.rs"]
#[allow(dead_code, reason = "each target tells one kind of story")]
mod checking;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| checking::answers(bytes));

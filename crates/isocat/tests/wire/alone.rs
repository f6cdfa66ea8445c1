//! Tests with a wire keep real time: two of them at once would disturb each other. A test that
//! could not be judged says so.
//!
//! `ISOCAT_NOT_SHOWN` names a file to which such tests write a line each, so that a test that shows
//! nothing does not pass in silence: the test and why, or `skipped` and what is missing.

use std::fs::OpenOptions;
use std::io::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The only wire of this program, until the guard is dropped.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Says that a test could not be judged, as the machine was too late each time.
pub fn not_shown(test: &str, why: &str) {
    tell(&format!("{test}: {why}"));
}

/// Says that a test needs what is not there.
pub fn skipped(why: &str) {
    tell(&format!("skipped: {why}"));
}

fn tell(line: &str) {
    let line = line.split_whitespace().collect::<Vec<_>>().join(" ");
    eprintln!("{line}");
    let Some(path) = std::env::var_os("ISOCAT_NOT_SHOWN") else { return };
    let file = OpenOptions::new().create(true).append(true).open(&path);
    let written = file.and_then(|mut file| writeln!(file, "{line}"));
    written.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

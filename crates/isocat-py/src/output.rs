//! Writes files that appear completely or not at all.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

/// Writes a file under another name in its folder, and renames it when it is on the disk.
pub fn whole(path: &Path, write: impl FnOnce(File) -> io::Result<()>) -> io::Result<()> {
    let mut name: OsString = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = File::create(&part).and_then(|file| {
        write(file.try_clone()?)?;
        file.sync_all()?;
        fs::rename(&part, path)
    });
    if written.is_err() {
        // The file may not exist.
        let _ = fs::remove_file(&part);
    }
    written
}

/// Writes bytes to a file like [`whole`].
pub fn bytes(path: &Path, content: &[u8]) -> io::Result<()> {
    whole(path, |file| {
        let mut file = BufWriter::new(file);
        file.write_all(content)?;
        file.flush()
    })
}

/// Makes an `OSError` with number, text and file, as `open` raises it.
pub fn raise(error: &io::Error, path: &Path) -> PyErr {
    let path = path.display().to_string();
    match error.raw_os_error() {
        Some(number) => {
            let words = error.to_string();
            let words = words.split(" (os error").next().unwrap_or_default().to_owned();
            PyOSError::new_err((number, words, path))
        }
        None => PyOSError::new_err(format!("{path}: {error}")),
    }
}

/// The extension of a file's name, in lower case.
pub fn ending(path: &Path) -> String {
    path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase()
}

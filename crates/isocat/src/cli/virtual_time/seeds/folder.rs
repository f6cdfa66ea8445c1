//! The folder for the files of many runs, and which of them stay.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::row::Row;
use crate::cli::IN_SYNC;
use crate::cli::run::unwritable;

/// Largest number of runs that are kept because they were not in sync.
const MOST_FAILED: usize = 100;

/// A folder to which runs write. Files that are not kept are removed with the run.
pub struct Folder {
    path: PathBuf,
    /// Whether the user asked for it, so that it stays.
    stays: bool,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    failed: usize,
    /// The run with the least margin so far, if it is kept only for that reason.
    closest: Option<(f64, u64)>,
}

impl Folder {
    /// The folder at `path`, or a temporary one.
    pub fn create(path: Option<&Path>) -> Result<Self, String> {
        let stays = path.is_some();
        let path = path.map_or_else(
            || std::env::temp_dir().join(format!("isocat-virtual-{}", std::process::id())),
            Path::to_owned,
        );
        fs::create_dir_all(&path).map_err(|error| unwritable("folder", Some(&path), &error))?;
        Ok(Self { path, stays, kept: Mutex::default() })
    }

    /// Segment file, report and output of a run.
    pub fn files(&self, number: u64) -> [PathBuf; 3] {
        ["toml", "json", "txt"].map(|ending| self.path.join(format!("run-{number}.{ending}")))
    }

    /// Keeps the files of a run that was not in sync, and of the one with the least margin; removes
    /// all others.
    pub fn consider(&self, row: &Row) -> io::Result<()> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if self.stays && row.code != i32::from(IN_SYNC) && kept.failed < MOST_FAILED {
            kept.failed += 1;
            return Ok(());
        }
        // Of two that come as close, the one with the lower number: whichever ended first.
        let place = (row.margin_ns.unwrap_or(f64::INFINITY), row.number);
        let is_closest = self.stays && kept.closest.is_none_or(|closest| place < closest);
        let leaves = match is_closest {
            true => kept.closest.replace(place).map(|(_, number)| number),
            false => Some(row.number),
        };
        leaves.map_or(Ok(()), |number| self.files(number).iter().try_for_each(fs::remove_file))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if !self.stays {
            // It holds nothing that was asked for.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

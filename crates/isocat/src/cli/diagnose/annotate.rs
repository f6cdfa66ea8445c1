//! `--annotate`: a copy of the captures with the findings as comments at their packets.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use isocat_captures::annotating::{Annotated, CopyError};
use isocat_diagnose::DiagnoseReport;

use super::progress;
use crate::cli::output::Output;
use crate::cli::run::unwritable;

/// The content of a copy.
#[derive(Default)]
struct Done {
    packets: usize,
    commented: usize,
    without_place: usize,
}

/// Why no copy can be written to `path`, before anything is read: the captures are read a second
/// time for it, and must not be overwritten.
pub(super) fn refused(path: &Path, captures: &[PathBuf], report: Option<&Path>) -> Option<String> {
    if report == Some(path) {
        return Some(format!("--annotate {} would overwrite the report", path.display()));
    }
    let real = path.canonicalize().ok();
    for capture in captures {
        if capture == path || real.is_some() && capture.canonicalize().ok() == real {
            return Some(format!("--annotate {} would overwrite a capture", path.display()));
        }
        if capture.exists() && !capture.is_file() {
            let name = capture.display();
            return Some(format!("--annotate reads {name} twice; expected an ordinary file"));
        }
    }
    None
}

/// Writes the copy; describes its content on standard error.
pub(super) fn write(
    path: &Path,
    captures: &[PathBuf],
    report: &DiagnoseReport,
) -> Result<(), String> {
    let fails = |error: std::io::Error| unwritable("annotated", Some(path), &error);
    let output = Output::create(path).map_err(fails)?;
    let mut copy = Annotated::new(BufWriter::new(output.file().map_err(fails)?));
    let mut done = Done::default();
    for (capture, comments) in captures.iter().zip(report.comments()) {
        let name = capture.display();
        let file = File::open(capture).map_err(|error| format!("{name}: {error}"))?;
        let bar = progress(&file);
        let copied = copy.add(bar.wrap_read(file), &comments);
        bar.finish_and_clear();
        let copied = match copied {
            Ok(copied) => copied,
            Err(CopyError::Write(error)) => return Err(fails(error)),
            // The report says it, too.
            Err(CopyError::Capture(none)) => {
                anstream::eprintln!("{name} is left out: {none}");
                continue;
            }
        };
        if let Some(why) = copied.ended {
            anstream::eprintln!("{name} is not copied to its end: {why}");
        }
        done.packets += copied.packets;
        done.commented += copied.commented;
        done.without_place += copied.without_place;
    }
    copy.finish().map_err(fails)?;
    output.commit().map_err(fails)?;
    let Done { packets, commented, without_place } = done;
    anstream::eprintln!(
        "{}: {packets} packets, {commented} with comments (frame.comment)",
        path.display()
    );
    if without_place > 0 {
        anstream::eprintln!("{without_place} packets have no room for comments (simple packets)");
    }
    Ok(())
}

//! The thread that writes incidents to files, so that frames do not wait for the disk.
//!
//! A file is first written as `NAME.PID.part` in the same folder, synchronized to the disk and then
//! renamed: an incomplete file never has a final name.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::{Reason, Told};
use crate::capture::Capture;
use crate::ring::Stretch;

/// One incident that is to be written.
#[derive(Debug)]
pub(super) struct Job {
    /// When its first event happened.
    pub at: Duration,
    pub stretch: Stretch,
    /// Whether frames are missing in the stretch.
    pub crowded: bool,
    /// Comments with their instants.
    pub comments: Vec<(Duration, String)>,
    pub reasons: Vec<Reason>,
}

/// Writes incidents, one after the other.
#[derive(Debug)]
pub(super) struct Writer {
    jobs: Sender<Job>,
    told: Receiver<Told>,
    thread: JoinHandle<()>,
    /// Jobs whose result did not come back yet.
    open: usize,
    done: VecDeque<Told>,
}

/// The state of the thread.
struct Files {
    folder: PathBuf,
    interface: String,
    most: usize,
    /// The files that it wrote, oldest first.
    written: VecDeque<PathBuf>,
}

impl Writer {
    pub fn new(folder: &Path, interface: &str, most: usize) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let probe = folder.join(format!(".isocat-{}.part", std::process::id()));
        File::create(&probe)?;
        fs::remove_file(probe)?;
        let (jobs, incoming) = channel::<Job>();
        let (telling, told) = channel();
        let interface = interface.to_owned();
        let (folder, written) = (folder.to_owned(), VecDeque::new());
        let mut files = Files { folder, interface, most, written };
        let thread = std::thread::spawn(move || {
            for job in incoming {
                // The file is written even if the result is no longer wanted.
                let _ = telling.send(files.take(job));
            }
        });
        Ok(Self { jobs, told, thread, open: 0, done: VecDeque::new() })
    }

    /// Whether a further job would wait for at most one other job.
    pub fn has_room(&mut self) -> bool {
        self.look();
        self.open < MOST_JOBS
    }

    pub fn give(&mut self, job: Job) {
        if self.jobs.send(job).is_ok() {
            self.open += 1;
        }
    }

    /// The result of a job.
    pub fn told(&mut self) -> Option<Told> {
        self.look();
        self.done.pop_front()
    }

    /// Waits until all is written.
    pub fn finish(self) -> impl Iterator<Item = Told> {
        drop(self.jobs);
        if let Err(panic) = self.thread.join() {
            std::panic::resume_unwind(panic);
        }
        self.done.into_iter().chain(self.told)
    }

    fn look(&mut self) {
        for told in self.told.try_iter() {
            self.open -= 1;
            self.done.push_back(told);
        }
    }
}

impl Files {
    fn take(&mut self, job: Job) -> Told {
        let Job { at, stretch, crowded, comments, reasons } = job;
        if self.most == 1 && !self.written.is_empty() {
            return Told::NotKept { reasons };
        }
        let path = self.path(at, &reasons);
        match self.write(&path, &stretch, comments) {
            Err(error) => Told::Failed { path, error, reasons },
            Ok(removed) => {
                self.written.push_back(path.clone());
                let mut frames = stretch.frames();
                let first = frames.next().map_or(Duration::ZERO, |frame| frame.at);
                let last = frames.last().map_or(first, |frame| frame.at);
                let span = last.saturating_sub(first);
                let frames = stretch.frames().count() as u64;
                Told::Written { path, frames, span, crowded, reasons, removed }
            }
        }
    }

    /// The path of a file, for example `eth0-20261123T184012.345Z-working-counter.pcapng`.
    fn path(&self, at: Duration, reasons: &[Reason]) -> PathBuf {
        let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let interface: String = self.interface.chars().map(plain).collect();
        let kind = reasons.first().map_or("unknown", |reason| reason.kind);
        let stem = format!("{interface}-{}-{kind}", utc(at));
        let names = std::iter::once(format!("{stem}.pcapng"))
            .chain((2..).map(|number| format!("{stem}-{number}.pcapng")));
        let mut paths = names.map(|name| self.folder.join(name));
        paths.find(|path| !path.exists()).unwrap_or_default()
    }

    /// Writes a file; returns the older one that was removed for it.
    fn write(
        &mut self,
        path: &Path,
        stretch: &Stretch,
        comments: Vec<(Duration, String)>,
    ) -> io::Result<Option<PathBuf>> {
        // Another recorder of the same wire may write a file with this name to the same folder.
        let part = path.with_extension(format!("{}.part", std::process::id()));
        let written = File::create(&part)
            .and_then(|file| write(BufWriter::new(file), &self.interface, stretch, comments))
            .and_then(|writer| writer.into_inner().map_err(io::IntoInnerError::into_error))
            .and_then(|file| file.sync_all());
        let named = written.and_then(|()| {
            let removed = self.make_room();
            fs::rename(&part, path).map(|()| removed)
        });
        if named.is_err() {
            // The first error is reported; a remaining part of the file does no harm.
            let _ = fs::remove_file(&part);
        }
        named
    }

    /// Removes the oldest file except the first, if there would be too many.
    fn make_room(&mut self) -> Option<PathBuf> {
        if self.written.len() < self.most {
            return None;
        }
        let oldest = self.written.remove(1)?;
        // A file that was moved away takes no space.
        fs::remove_file(&oldest).ok().map(|()| oldest)
    }
}

/// Writes frames with comments as a capture.
pub(super) fn write<W: Write>(
    writer: W,
    interface: &str,
    stretch: &Stretch,
    comments: Vec<(Duration, String)>,
) -> io::Result<W> {
    let mut capture = Capture::of_interface(writer, interface)?;
    for (at, words) in comments {
        capture.comment(at, words);
    }
    for frame in stretch.frames() {
        capture.write(frame.at, frame.sent, frame.bytes);
    }
    capture.finish()
}

/// A wall time since 1970 as date and time of day, UTC: `20261123T184012.345Z`.
fn utc(at: Duration) -> String {
    let (mut days, second) = (at.as_secs() / 86_400, at.as_secs() % 86_400);
    let is_leap =
        |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    let (day, millisecond) = (days + 1, at.subsec_millis());
    format!("{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}.{millisecond:03}Z")
}

/// Jobs that the thread has at most: one is written, one waits.
const MOST_JOBS: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ring::Ring;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (second, name) in [
            (0, "19700101T000000.000Z"),
            (86_399, "19700101T235959.000Z"),
            (86_400, "19700102T000000.000Z"),
            // Expected values are from `date -u -d @...`.
            (951_782_399, "20000228T235959.000Z"),
            (951_782_400, "20000229T000000.000Z"),
            (951_868_800, "20000301T000000.000Z"),
            (1_798_761_599, "20261231T235959.000Z"),
            (1_798_761_600, "20270101T000000.000Z"),
            (4_107_542_400, "21000301T000000.000Z"),
        ] {
            assert_eq!(utc(Duration::from_secs(second)), name, "{second}");
        }
        assert_eq!(utc(Duration::from_nanos(999_999_999)), "19700101T000000.999Z");
    }

    /// A disk that accepts this many bytes.
    struct Disk(usize);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            match self.0.checked_sub(bytes.len()) {
                Some(left) => self.0 = left,
                None => return Err(io::ErrorKind::StorageFull.into()),
            }
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_disk_that_is_a_byte_too_small_is_an_error() {
        let mut ring = Ring::new(Duration::from_secs(1), 1 << 20);
        (1..=50).for_each(|at| {
            ring.push(Duration::from_millis(at), true, &[0x5A; 60]);
        });
        let stretch = ring.copy(Duration::ZERO, Duration::MAX);
        let whole = write(Disk(1 << 20), "eth0", &stretch, Vec::new()).expect("there is room");
        let needed = (1 << 20) - whole.0;
        assert!(needed > 50 * 60, "{needed}");
        let exact = write(Disk(needed), "eth0", &stretch, Vec::new()).expect("it fits exactly");
        assert_eq!(exact.0, 0);
        let full = write(Disk(needed - 1), "eth0", &stretch, Vec::new());
        assert_eq!(full.err().map(|error| error.kind()), Some(io::ErrorKind::StorageFull));
    }
}

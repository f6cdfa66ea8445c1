//! A full disk leaves the file of before as it was, and is called full: for each file that the
//! command writes.
//!
//! Needs root, which mounts a file system in memory; without it the test says so.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::alone::skipped;
use crate::service::{isocat, text};

/// A file system in memory with room for next to nothing, as long as it lives.
struct Tiny(PathBuf);

impl Tiny {
    /// `None`, with a word, where it can't be had.
    fn mount(name: &str) -> Option<Self> {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::create_dir_all(&folder).expect("the target directory is writable");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", "size=32k", "tmpfs"]).arg(&folder);
        match mount.output() {
            Ok(output) if output.status.success() => return Some(Self(folder)),
            Ok(output) => skipped(&format!("no tmpfs: {}", text(&output.stderr))),
            Err(error) => skipped(&format!("no mount: {error}")),
        }
        None
    }
}

impl Drop for Tiny {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

/// Options that write a file, and the name of one.
const WRITERS: [(&str, &str); 7] = [
    ("--capture", "run.pcapng"),
    ("--waves", "run.vcd"),
    ("--trace", "run.perfetto-trace"),
    ("--series", "run.csv"),
    ("--series", "run.parquet"),
    ("--report", "run.html"),
    ("--report", "run.json"),
];

#[test]
fn a_full_disk_leaves_the_file_of_before_and_is_called_that() {
    let Some(disk) = Tiny::mount("full-disk") else { return };
    for (option, name) in WRITERS {
        let path = disk.0.join(name);
        std::fs::write(&path, "good").expect("room for four bytes");
        // So little room that no report fits either.
        let rest = disk.0.join("rest");
        std::fs::write(&rest, vec![0; 24 << 10]).expect("room for it");
        let path_text = path.to_str().expect("UTF-8");
        let output = isocat(&["run", "--for", "300ms", option, path_text]);
        let message = text(&output.stderr).replace("\n       ", " ");
        assert_eq!(output.status.code(), Some(2), "{option}: {message}");
        assert!(message.contains("no space left"), "{option}: {message}");
        assert!(message.replace(' ', "").contains(&path_text.replace(' ', "")), "{message}");
        assert_eq!(std::fs::read_to_string(&path).expect("it is there"), "good", "{option}");
        let names: Vec<_> = std::fs::read_dir(&disk.0)
            .expect("ours")
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .filter(|found| found != "rest" && found != name)
            .collect();
        assert!(names.is_empty(), "{option} left {names:?}");
        std::fs::remove_file(&path).expect("ours");
        std::fs::remove_file(&rest).expect("ours");
    }
}

//! Files that the command writes: they appear complete, or not at all.
//!
//! A file is written under another name in the same folder, `NAME.PID.part`, flushed to the disk
//! and then renamed. So an existing file stays until the new one is complete, and a full disk or a
//! signal leaves no partial file under the final name. Devices, pipes and files below `/dev` and
//! `/proc` are written directly.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file under construction. If it is dropped before [`commit`](Self::commit), nothing is left.
pub struct Output {
    file: File,
    /// The temporary and the final name; `None` if it is written directly.
    names: Option<(PathBuf, PathBuf)>,
}

impl Output {
    /// Begins a file for `path`. An existing file must be writable.
    pub fn create(path: &Path) -> io::Result<Self> {
        let Some(target) = renamed_to(path)? else {
            let file = OpenOptions::new().write(true).create(true).truncate(true).open(path)?;
            return Ok(Self { file, names: None });
        };
        let before = match fs::metadata(&target) {
            Ok(before) => {
                // A file that is protected from writing is protected from being replaced, too.
                OpenOptions::new().write(true).open(&target)?;
                Some(before)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let mut name = target.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.part", std::process::id()));
        let part = target.with_file_name(name);
        let file = OpenOptions::new().write(true).create(true).truncate(true).open(&part)?;
        let output = Self { file, names: Some((part, target)) };
        if let Some(before) = before {
            output.file.set_permissions(before.permissions())?;
        }
        Ok(output)
    }

    /// The file to write. Everything must be written before [`commit`](Self::commit).
    pub fn file(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// Flushes the file to the disk, and gives it its final name.
    pub fn commit(mut self) -> io::Result<()> {
        let Some((part, target)) = &self.names else { return Ok(()) };
        self.file.sync_all()?;
        fs::rename(part, target)?;
        // The name is on the disk with its folder; where folders can't be opened, the file is good
        // all the same.
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
            let _ = folder.sync_all();
        }
        self.names = None;
        Ok(())
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Some((part, _)) = &self.names {
            // Nothing is left that could take the error.
            let _ = fs::remove_file(part);
        }
    }
}

/// Writes a whole file.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let output = Output::create(path)?;
    output.file()?.write_all(content.as_ref())?;
    output.commit()
}

/// Checks whether a file could be written to `path`, without changing anything.
pub fn probe(path: &Path) -> io::Result<()> {
    match renamed_to(path)? {
        Some(_) => Output::create(path).map(drop),
        // To open a pipe is to wait for its reader.
        None => Ok(()),
    }
}

/// The final path of a file for `path`, with links resolved; `None` if it is no ordinary file.
fn renamed_to(path: &Path) -> io::Result<Option<PathBuf>> {
    if ["/dev", "/proc"].iter().any(|folder| path.starts_with(folder)) {
        return Ok(None);
    }
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Some(path.to_owned())),
        Err(error) => Err(error),
        Ok(found) if found.is_symlink() => match fs::canonicalize(path) {
            Ok(target) if target.is_file() && !target.starts_with("/proc") => Ok(Some(target)),
            // A link to a device, or to where nothing is yet.
            _ => Ok(None),
        },
        Ok(found) if found.is_file() || found.is_dir() => Ok(Some(path.to_owned())),
        Ok(_) => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty folder for this test.
    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("isocat-output-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir(&folder).expect("the folder for temporary files is writable");
        folder
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("our folder");
        let name = |entry: io::Result<fs::DirEntry>| entry.expect("an entry").file_name();
        let mut names: Vec<_> =
            entries.map(|entry| name(entry).to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn what_stood_there_stays_until_the_new_file_is_whole() {
        let folder = folder("whole");
        let path = folder.join("report.txt");
        fs::write(&path, "old").expect("writable");
        let output = Output::create(&path).expect("created");
        output.file().expect("a handle").write_all(b"half of the n").expect("written");
        assert_eq!(fs::read_to_string(&path).expect("there"), "old");
        assert_eq!(names(&folder).len(), 2, "{:?}", names(&folder));
        drop(output);
        assert_eq!(fs::read_to_string(&path).expect("there"), "old");
        assert_eq!(names(&folder), ["report.txt"]);

        write(&path, "new").expect("written");
        assert_eq!(fs::read_to_string(&path).expect("there"), "new");
        assert_eq!(names(&folder), ["report.txt"]);
        fs::remove_dir_all(folder).expect("ours");
    }

    #[test]
    fn probing_changes_nothing() {
        let folder = folder("probe");
        probe(&folder.join("new.txt")).expect("writable");
        assert!(names(&folder).is_empty());
        assert!(probe(&folder.join("no/such/folder.txt")).is_err());
        assert!(probe(&folder).is_err(), "a folder is no file");
        fs::remove_dir_all(folder).expect("ours");
    }

    #[cfg(unix)]
    #[test]
    fn links_and_permissions_stay() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = folder("links");
        let (path, link) = (folder.join("real.txt"), folder.join("link.txt"));
        fs::write(&path, "old").expect("writable");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("ours");
        symlink(&path, &link).expect("a link");
        write(&link, "new").expect("written");
        assert_eq!(fs::read_to_string(&path).expect("there"), "new");
        assert!(fs::symlink_metadata(&link).expect("there").is_symlink());
        let mode = fs::metadata(&path).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
        write(Path::new("/dev/null"), "nothing").expect("a device takes it");
        fs::remove_dir_all(folder).expect("ours");
    }
}

//! Reads all given descriptions, files and folders, in one process, and prints their number of
//! bytes and devices. `benches/import.sh` measures the time.

use std::path::{Path, PathBuf};

use isocat_descriptions::esi::EsiFile;

fn main() {
    let files: Vec<PathBuf> =
        std::env::args().skip(1).flat_map(|path| files(Path::new(&path))).collect();
    let (mut bytes, mut devices, mut refused) = (0, 0, 0);
    for path in &files {
        let Ok(content) = std::fs::read(path) else { continue };
        bytes += content.len();
        match EsiFile::from_bytes(&path.display().to_string(), &content) {
            Ok(file) => devices += file.devices.len(),
            Err(_) => refused += 1,
        }
    }
    println!("{} files, {bytes} bytes, {devices} devices, {refused} files refused", files.len());
}

fn files(path: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(path) else { return vec![path.to_owned()] };
    let mut all: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    all.retain(|path| path.extension().is_some_and(|end| end.eq_ignore_ascii_case("xml")));
    all.sort();
    all
}

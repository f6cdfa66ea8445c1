//! Real descriptions, which belong to their makers and are not part of the project: they are looked for
//! beside it. What is kept here are counts.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use isocat::esi::{EsiFile, WarningKind};

/// The files, sorted by name; none with a word if they are not there.
fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/esi");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no descriptions in {}", folder.display());
        return Vec::new();
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = paths.filter(|path| path.extension().is_some_and(|e| e == "xml")).collect();
    files.sort();
    files
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}

#[test]
fn every_file_is_read_or_refused_with_its_place() {
    let mut summary = String::from(
        "# Descriptions, as they were imported: devices (refused), modules, and each warning with the\n\
         # number of places that have it. UPDATE_GOLDEN=1 rewrites this file.\n",
    );
    let files = files();
    for path in &files {
        let path_name = path.display().to_string();
        match EsiFile::read(&path_name) {
            Ok(file) => {
                let refused = file.refused.len();
                writeln!(
                    summary,
                    "{}: {}, {} devices ({refused} refused), {} modules",
                    name(path),
                    file.encoding.name(),
                    file.devices.len(),
                    file.modules.len()
                )
                .unwrap();
                for error in &file.refused {
                    writeln!(summary, "    refused at {}:{}", error.line, error.column).unwrap();
                    println!("{error}");
                }
                for kind in WarningKind::ALL {
                    let of_kind = file.warnings().filter(|(_, warning)| warning.kind == *kind);
                    let (devices, places) = of_kind
                        .fold((0, 0), |(devices, places), (_, w)| (devices + 1, places + w.count));
                    if places > 0 {
                        writeln!(summary, "    {kind} {places} in {devices}").unwrap();
                    }
                }
            }
            Err(error) => {
                writeln!(summary, "{}: refused at {}:{}", name(path), error.line, error.column).unwrap();
                println!("{error}");
            }
        }
    }
    if files.is_empty() {
        return;
    }
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/esi_import.txt");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&golden, &summary).unwrap();
    }
    let expected = std::fs::read_to_string(&golden).unwrap_or_default();
    assert_eq!(summary, expected, "UPDATE_GOLDEN=1 takes the new one");
}

//! The conformance suite on stand-ins made from makers' descriptions: published files, looked for
//! beside the project. What `run` brings into sync must not fail by the suite's own set-up.
//!
//! `cargo test --test descriptions conform_descriptions:: -- --nocapture` prints each rule that
//! does not hold, and where.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use isocat::conform::report::{DeviceReport, Examined, Verdict};
use isocat::conform::subject::Hints;
use isocat::conform::wire::VirtualWire;
use isocat::esi::EsiFile;
use isocat::{Scenario, SegmentFile, conform};

/// The files, sorted by name; none with a word if they are not there.
fn files() -> Vec<PathBuf> {
    let shared = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let mut files = Vec::new();
    for folder in ["esi", "esi-more"] {
        let folder = shared.join(folder);
        let Ok(entries) = std::fs::read_dir(&folder) else {
            println!("skipped: no descriptions in {}", folder.display());
            continue;
        };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        files.extend(paths.filter(|path| path.extension().is_some_and(|ending| ending == "xml")));
    }
    files.sort();
    files
}

fn segment(path: &str, name: &str, revision: u32) -> Option<SegmentFile> {
    let text = format!(
        "cycle = \"4ms\"\n[[subdevice]]\nesi = \"{path}\"\ntype = \"{name}\"\nrevision = {revision}\n"
    );
    SegmentFile::parse("trial", &text).ok()
}

fn examine(file: SegmentFile) -> DeviceReport {
    let hints = Hints::of(&file.subdevices[0]).expect("known rules");
    let mut wire = VirtualWire::new(Scenario::from(file));
    conform::examine(&mut wire, 0, "stand-in", &hints, |_| true, |_| ()).expect("what is described")
}

/// Most types that are taken of a file: some files list hundreds of a kind.
const MOST_TYPES: usize = 6;

#[test]
fn no_stand_in_fails_by_the_set_up_of_the_suite() {
    let mut by_rule: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    let (mut devices, mut clean) = (0, 0);
    for path in files() {
        let path = path.display().to_string();
        let Ok(esi) = EsiFile::read(&path) else { continue };
        let mut types: Vec<&str> = Vec::new();
        for device in &esi.devices {
            if types.contains(&device.type_name.as_str()) || types.len() == MOST_TYPES {
                continue;
            }
            let revision = device.revision.unwrap_or(0);
            // What can't be simulated has its reason in another test.
            let Some(file) = segment(&path, &device.type_name, revision) else { continue };
            types.push(&device.type_name);
            let report = examine(file);
            assert_eq!(report.examined, Examined::SimulatedDescription);
            devices += 1;
            clean += usize::from(report.failed == 0);
            for rule in report.rules.iter().filter(|rule| rule.verdict == Verdict::Fail) {
                let wrong = rule.evidence.iter().find(|evidence| !evidence.right);
                let wrong = wrong.map(|e| format!("{}: {} / {}", e.place, e.expected, e.found));
                let why = wrong.or_else(|| rule.why.first().cloned()).unwrap_or_default();
                let file = path.rsplit('/').next().unwrap_or_default();
                by_rule
                    .entry(rule.id)
                    .or_default()
                    .push(format!("{file} {}: {why}", device.type_name));
            }
        }
    }
    println!("{devices} stand-ins, {clean} without a failure");
    for (rule, cases) in &by_rule {
        println!("{rule}: {}", cases.len());
        for case in cases.iter().take(400) {
            println!("    {case}");
        }
    }
    for rule in ["MODE-01", "MODE-02", "MODE-03", "AL-16", "TIME-02"] {
        assert!(!by_rule.contains_key(rule), "{rule}: {:?}", by_rule.get(rule));
    }
}

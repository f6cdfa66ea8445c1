//! Profiles written from real descriptions, which belong to their makers and lie beside the
//! project: wherever a segment with the description is in sync, the one with the profile is, too.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isocat::esi::{EsiDevice, EsiFile};
use isocat::profile::{Profile, ProfileText, RunAs};
use isocat::segment_file::SubDevice;
use isocat::{Nanos, NoTap, Scenario, SegmentFile};
use isocat_sim::HostModel;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};
use isocat_wire::PortNumber;

/// The files, sorted by name; none with a word if they are not there.
fn files() -> Vec<PathBuf> {
    let shared = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let mut files = Vec::new();
    for folder in ["esi", "esi-more"] {
        let Ok(entries) = std::fs::read_dir(shared.join(folder)) else {
            println!("skipped: no descriptions in {}", shared.join(folder).display());
            continue;
        };
        files.extend(entries.map(|entry| entry.unwrap().path()));
    }
    files.retain(|path| path.extension().is_some_and(|e| e == "xml"));
    files.sort();
    files
}

/// A device in one of its OpModes, as the description has it and as the profile written from it.
struct Pair {
    words: String,
    cycle: Nanos,
    run_as: RunAs,
    description: Arc<Profile>,
    written: Arc<Profile>,
}

fn pair(file: &EsiFile, device: &EsiDevice, op_mode: Option<usize>) -> Option<(String, Pair)> {
    let description = Profile::from_esi(file, device, op_mode).ok()?;
    // Those that state a longer minimum get the next of a row of usual cycles.
    let least = [OUTPUT_PARAMETER, INPUT_PARAMETER]
        .iter()
        .filter_map(|index| description.sync_parameters(*index)?.minimum_cycle_time)
        .max()
        .unwrap_or(Nanos::ZERO);
    let cycles = [1, 2, 4, 10, 20, 100, 1_000].map(Nanos::millis);
    let cycle = cycles.into_iter().find(|cycle| *cycle >= least)?;
    let run_as = RunAs::new(file, device, op_mode, &description, cycle).ok()?;
    // What no profile can say is another test's matter.
    let text = ProfileText::from_esi(file, device, op_mode, "a test").ok()?.text;
    let written = Profile::from_toml("written.toml", &text).expect("a profile");
    // Revisions of one device differ in little but their identity.
    let what_counts: String = text
        .lines()
        .filter(|line| {
            !["#", "revision", "id =", "name ="].iter().any(|head| line.starts_with(head))
        })
        .collect();
    let key =
        format!("{what_counts} {:?} {cycle}", (run_as.mode, run_as.sync1, run_as.sync0_cycle));
    let mode = op_mode.map_or("-", |number| &device.op_modes()[number].name);
    let words = format!("{} {} {mode}", file.path, device.type_name);
    Some((key, Pair { words, cycle, run_as, description, written }))
}

/// Devices in a line; whether all come to OP and are in sync there.
fn in_sync(devices: &[(&RunAs, &Arc<Profile>)], cycle: Nanos) -> bool {
    let text =
        format!("cycle = \"{}us\"\n[[subdevice]]\ndevice = \"simple_io16\"", cycle.0 / 1_000);
    let mut scenario = Scenario::from(SegmentFile::parse("trial", &text).expect("a segment file"));
    // Least cycles are met to the nanosecond.
    scenario.hop_jitter = false;
    let template = scenario.devices.remove(0);
    for (position, (run_as, profile)) in devices.iter().enumerate() {
        let mut device = SubDevice { name: format!("trial {position}"), ..template.clone() };
        device.profile = Arc::clone(profile);
        device.mode = Some(run_as.mode);
        device.sync1 = run_as.sync1;
        device.sync0_cycle = run_as.sync0_cycle;
        device.place.upstream = position.checked_sub(1).map(|above| (above, PortNumber::P1));
        scenario.devices.push(device);
    }
    scenario.host = HostModel { jitter: Nanos::ZERO, ..HostModel::default() };
    // A drive needs some cycles to be enabled.
    scenario.duration = Nanos(60 * cycle.0);
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    outcome.failure.is_none() && outcome.in_sync()
}

#[test]
fn in_sync_as_the_description() {
    let mut seen = HashSet::new();
    let mut pairs = Vec::new();
    for path in files() {
        let Ok(file) = EsiFile::read(&path.display().to_string()) else { continue };
        for device in file.usable() {
            let modes = device.op_modes().len();
            let numbers = if modes == 0 { vec![None] } else { (0..modes).map(Some).collect() };
            for (key, pair) in numbers.into_iter().filter_map(|mode| pair(&file, device, mode)) {
                if seen.insert(key) {
                    pairs.push(pair);
                }
            }
        }
    }
    pairs.sort_by_key(|pair| pair.cycle);
    let (mut in_both, mut in_none) = (0, 0);
    for of_cycle in pairs.chunk_by(|one, other| one.cycle == other.cycle) {
        let cycle = of_cycle[0].cycle;
        let ends = |pair: &&Pair| !pair.written.esc().has_port(PortNumber::P1);
        let (ends, inner): (Vec<&Pair>, Vec<&Pair>) = of_cycle.iter().partition(ends);
        for line in inner.chunks(12).chain(ends.chunks(1)) {
            let devices: Vec<_> = line.iter().map(|pair| (&pair.run_as, &pair.written)).collect();
            if in_sync(&devices, cycle) {
                in_both += line.len();
                continue;
            }
            for pair in line {
                let written = in_sync(&[(&pair.run_as, &pair.written)], cycle);
                let described = in_sync(&[(&pair.run_as, &pair.description)], cycle);
                assert_eq!(written, described, "{}: the profile, and the description", pair.words);
                *if written { &mut in_both } else { &mut in_none } += 1;
            }
        }
    }
    println!(
        "{} different: {in_both} in sync by description and profile, {in_none} by neither",
        pairs.len()
    );
    assert!(pairs.is_empty() || in_both > 10 * in_none, "{in_both} in sync, {in_none} not");
}

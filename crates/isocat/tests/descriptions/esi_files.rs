//! Real descriptions, which belong to their makers and are not part of the project: they are looked
//! for beside it. What is kept here are counts.
//!
//! `cargo test --test descriptions esi_files:: -- --nocapture` prints every device in every OpMode.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isocat::esi::{EsiDevice, EsiFile, WarningKind};
use isocat::profile::{Profile, RunAs};
use isocat::segment_file::SubDevice;
use isocat::{Nanos, NoTap, Scenario, SegmentFile};
use isocat_sim::HostModel;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};
use isocat_wire::PortNumber;

/// The files, sorted by name; none with a word if they are not there.
fn files() -> Vec<PathBuf> {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let folder = folder.join("esi");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no descriptions in {}", folder.display());
        return Vec::new();
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        paths.filter(|path| path.extension().is_some_and(|e| e == "xml")).collect();
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
                writeln!(summary, "{}: refused at {}:{}", name(path), error.line, error.column)
                    .unwrap();
                println!("{error}");
            }
        }
    }
    if !files.is_empty() {
        golden("esi_import.txt", &summary);
    }
}

fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(text == expected, "{name} changed: UPDATE_GOLDEN=1 takes the new one\n{text}");
}

/// A device in one of its OpModes, at the bus cycle it is tried with.
struct Trial {
    file: usize,
    device: String,
    op_mode: String,
    cycle: Nanos,
    /// What came of it: `op`, or the name of the reason.
    result: Result<Ready, String>,
    words: String,
}

struct Ready {
    profile: Arc<Profile>,
    run_as: RunAs,
    /// All that the way up depends on: equal ones go up alike.
    key: String,
}

/// Everything that is to be tried: each device, once for each of its OpModes.
fn trials(files: &[PathBuf]) -> Vec<Trial> {
    let mut all = Vec::new();
    for (number, path) in files.iter().enumerate() {
        let Ok(file) = EsiFile::read(&path.display().to_string()) else { continue };
        for device in &file.devices {
            let modes = device.op_modes().len();
            let numbers = if modes == 0 { vec![None] } else { (0..modes).map(Some).collect() };
            for op_mode in numbers {
                all.push(trial(number, &file, device, op_mode));
            }
        }
    }
    all
}

fn trial(number: usize, file: &EsiFile, device: &EsiDevice, op_mode: Option<usize>) -> Trial {
    let mut trial = Trial {
        file: number,
        device: format!("{} {:#010x}", device.type_name, device.revision.unwrap_or(0)),
        op_mode: op_mode
            .map_or("-".into(), |number| format!("{number} {}", device.op_modes()[number].name)),
        cycle: Nanos::millis(1),
        result: Err(String::new()),
        words: String::new(),
    };
    let ready = Profile::from_esi(file, device, op_mode).and_then(|profile| {
        // Those that state a longer minimum get the next of a row of usual cycles.
        let least = [OUTPUT_PARAMETER, INPUT_PARAMETER]
            .iter()
            .filter_map(|index| profile.sync_parameters(*index)?.minimum_cycle_time)
            .max();
        if let Some(least) = least {
            let cycles = [1, 2, 4, 10, 20, 100, 1_000].map(Nanos::millis);
            trial.cycle = cycles.into_iter().find(|cycle| *cycle >= least).unwrap_or(cycles[6]);
        }
        let run_as = RunAs::new(file, device, op_mode, &profile, trial.cycle)?;
        let key = key(&profile, &run_as, trial.cycle);
        Ok(Ready { profile, run_as, key })
    });
    trial.result = ready.map_err(|error| {
        trial.words = error.to_string();
        error.obstacle.name().to_owned()
    });
    trial
}

fn key(profile: &Profile, run_as: &RunAs, cycle: Nanos) -> String {
    let description = &profile.description;
    let objects = description.objects.iter().filter(|object| {
        matches!(object.index, 0x1C00 | 0x1C12 | 0x1C13 | 0x1C32 | 0x1C33 | 0x10F1)
            || profile.assignment.outputs.contains(&object.index)
            || profile.assignment.inputs.contains(&object.index)
    });
    let values: Vec<_> = objects
        .map(|o| {
            (
                o.index,
                o.entries.iter().map(|e| (e.sub, e.bits, e.access, e.default)).collect::<Vec<_>>(),
            )
        })
        .collect();
    let header = isocat_wire::sii::Header::parse(&profile.sii).unwrap();
    let managers: Vec<_> = isocat_wire::sii::categories(&profile.sii)
        .map(Result::unwrap)
        .filter(|category| [40, 41].contains(&category.kind))
        .map(|category| category.data.to_vec())
        .collect();
    format!(
        "{:?} {:?} {:?} {:?} {values:?} {:?} {managers:?} {:?} {:?} {:?} {:?} {:?} {:?} {cycle:?}",
        description.mailbox,
        description.outputs,
        description.inputs,
        description.behaviour,
        (header.configuration, header.protocols),
        profile.esc(),
        profile.times,
        profile.application,
        profile.startup,
        (run_as.mode, run_as.sync1, run_as.sync0_cycle),
        profile.assignment,
    )
}

/// The segment of some ready devices in a line.
fn scenario(devices: &[(&Ready, usize)], cycle: Nanos) -> Scenario {
    let text =
        format!("cycle = \"{}us\"\n[[subdevice]]\ndevice = \"simple_io16\"", cycle.0 / 1_000);
    let mut scenario = Scenario::from(SegmentFile::parse("trial", &text).expect("a segment file"));
    // Least cycles are met to the nanosecond.
    scenario.hop_jitter = false;
    let template = scenario.devices.remove(0);
    for (position, (ready, number)) in devices.iter().enumerate() {
        let mut device = SubDevice { name: format!("trial {number}"), ..template.clone() };
        device.profile = ready.profile.clone();
        device.mode = Some(ready.run_as.mode);
        device.sync1 = ready.run_as.sync1;
        device.sync0_cycle = ready.run_as.sync0_cycle;
        device.place.upstream = position.checked_sub(1).map(|above| (above, PortNumber::P1));
        scenario.devices.push(device);
    }
    scenario.host = HostModel { jitter: Nanos::ZERO, ..HostModel::default() };
    // A drive needs some cycles to be enabled.
    scenario.duration = Nanos(60 * cycle.0);
    scenario
}

/// Brings devices up; `Ok` if all came to OP and were in sync there.
fn boot(devices: &[(&Ready, usize)], cycle: Nanos) -> Result<(), (String, String)> {
    let outcome = scenario(devices, cycle).run().execute(None::<NoTap>, &mut |_| {});
    match &outcome.failure {
        None if outcome.in_sync() => Ok(()),
        None => Err(("op-not-in-sync".into(), format!("{:?}", outcome.findings))),
        Some(error) => {
            let debug = format!("{:?}", error.cause);
            let kind = debug.split([' ', '(', '{']).next().unwrap_or_default().to_lowercase();
            Err((format!("failed-{kind}"), error.to_string()))
        }
    }
}

/// The result of each trial. Equal ones are brought up once; several stand in one segment, and each
/// alone if that does not come up.
fn results(trials: &[Trial]) -> Vec<(String, String)> {
    let mut representatives: BTreeMap<Nanos, Vec<usize>> = BTreeMap::new();
    let mut of_key: HashMap<&str, usize> = HashMap::new();
    for (number, trial) in trials.iter().enumerate() {
        let Ok(ready) = &trial.result else { continue };
        of_key.entry(&ready.key).or_insert_with(|| {
            representatives.entry(trial.cycle).or_default().push(number);
            number
        });
    }
    let mut found: HashMap<usize, (String, String)> = HashMap::new();
    for (cycle, numbers) in &representatives {
        for group in numbers.chunks(12) {
            let ready = |number: usize| trials[number].result.as_ref().ok().unwrap();
            let ends = |number: &usize| !ready(*number).profile.esc().has_port(PortNumber::P1);
            let (ends, inner): (Vec<usize>, Vec<usize>) = group.iter().copied().partition(ends);
            let line: Vec<_> = inner.iter().map(|number| (ready(*number), *number)).collect();
            let together = !line.is_empty() && boot(&line, *cycle).is_ok();
            for (number, alone) in
                inner.into_iter().map(|n| (n, !together)).chain(ends.into_iter().map(|n| (n, true)))
            {
                let result = if alone { boot(&[(ready(number), number)], *cycle) } else { Ok(()) };
                let op = |()| ("op".to_owned(), String::new());
                found.insert(number, result.map_or_else(|error| error, op));
            }
        }
    }
    let of = |trial: &Trial| match &trial.result {
        Err(name) => (name.clone(), trial.words.clone()),
        Ok(ready) => found[&of_key[ready.key.as_str()]].clone(),
    };
    trials.iter().map(of).collect()
}

/// Every device comes to OP in each of its OpModes and is in sync there, or there is a reason with
/// a name. Equal configurations are brought up once. With `--nocapture` the whole table is printed.
#[test]
fn every_device_in_every_op_mode() {
    let files = files();
    let trials = trials(&files);
    let results = results(&trials);
    println!("| file | device | OpMode | cycle | mode | result | reason |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let mut of_file: BTreeMap<String, BTreeMap<&str, usize>> = BTreeMap::new();
    let mut all: BTreeMap<&str, usize> = BTreeMap::new();
    for (trial, (result, words)) in trials.iter().zip(&results) {
        let mode = trial.result.as_ref().map_or("-", |ready| ready.run_as.mode.name());
        let Trial { device, op_mode, cycle, .. } = trial;
        let file = name(&files[trial.file]);
        let words = words.split(".xml:").last().unwrap_or_default();
        println!("| {file} | {device} | {op_mode} | {cycle} | {mode} | {result} | {words} |");
        *of_file.entry(file).or_default().entry(result).or_default() += 1;
        *all.entry(result).or_default() += 1;
        assert!(
            !result.starts_with("failed"),
            "no reason with a name: {device} {op_mode}: {words}"
        );
    }
    println!("{} trials, {} different: {all:?}", trials.len(), different(&trials));
    if trials.is_empty() {
        return;
    }
    let mut summary = String::from(
        "# Devices of descriptions, each in each of its OpModes, brought up in virtual time: how many came to\n\
         # OP and were in sync, and why others were not tried. UPDATE_GOLDEN=1 rewrites this file.\n",
    );
    for (file, counts) in of_file.iter().chain([(&"all".to_owned(), &all)]) {
        let counts: Vec<_> = counts.iter().map(|(name, count)| format!("{name} {count}")).collect();
        writeln!(summary, "{file}: {}", counts.join(", ")).unwrap();
    }
    golden("esi_boots.txt", &summary);
}

/// A drive that has an OpMode with SYNC0 runs with SYNC0 if nothing is asked for, wherever its
/// profile stands.
#[test]
fn drives_run_with_sync0_by_default() {
    let files = files();
    let (mut tried, mut by_channel) = (0, 0);
    for path in &files {
        let path = path.display().to_string();
        let Ok(file) = EsiFile::read(&path) else { continue };
        let drives = file.devices.iter().filter(|device| device.profile.is_drive());
        for drive in drives.filter(|device| device.op_modes().iter().any(|mode| mode.sync0())) {
            let (name, revision) = (&drive.type_name, drive.revision.unwrap_or(0));
            let text = format!(
                "cycle = \"4ms\"\n[[subdevice]]\nesi = \"{path}\"\ntype = \"{name}\"\nrevision = {revision}"
            );
            // What can't be simulated has its reason in another test.
            let Ok(segment) = SegmentFile::parse("trial", &text) else { continue };
            let mode = segment.subdevices[0].mode;
            assert!(mode.is_some_and(|mode| mode.uses_dc()), "{path} {name}: {mode:?}");
            tried += 1;
            by_channel += usize::from(!drive.profile.channels.is_empty());
        }
    }
    println!("{tried} drives, {by_channel} of them by the profile of a channel");
    assert!(files.is_empty() || (tried > by_channel && by_channel > 0), "{tried}, {by_channel}");
}

fn different(trials: &[Trial]) -> usize {
    let keys = trials.iter().filter_map(|trial| trial.result.as_ref().ok()).map(|ready| &ready.key);
    keys.collect::<std::collections::HashSet<_>>().len()
}

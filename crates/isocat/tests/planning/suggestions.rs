//! What `plan --suggest` names can be written into the segment file: the file is read, planned and
//! run with it, whatever cycles the OpModes of its devices take.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use isocat::esi::EsiFile;
use isocat::plan::report::Suggestion;
use isocat::plan::{Plan, cycles, suggest};
use isocat::profile::TakenOpMode;
use isocat::{Nanos, NoTap, Scenario, SegmentFile};

const BOX: &str = include_str!("../esi/box.xml");
/// The OpMode of the box with SYNC0 alone, and the one with SYNC1.
const SYNC0: &str =
    "<CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0><ShiftTimeSync0>0</ShiftTimeSync0>";
const WITH_SYNC1: &str =
    "<CycleTimeSync0>250000</CycleTimeSync0><CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1>";

/// A description of its own for each test, gone with it.
struct Description(PathBuf);

impl Description {
    /// The box with other times in place of those of its OpModes.
    fn with(name: &str, times: &[(&str, &str)]) -> Self {
        let mut text = BOX.to_owned();
        for (old, new) in times {
            assert!(text.contains(old), "{old}");
            text = text.replace(old, new);
        }
        let name = format!("isocat-suggestions-{}-{name}.xml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        Self(path)
    }

    /// A segment of the box.
    fn segment(&self, cycle: &str, keys: &str) -> String {
        format!(
            "cycle = \"{cycle}\"\nfor = \"20ms\"\n[[subdevice]]\nesi = {:?}\ntype = \"Drive\"\n{keys}\n",
            self.0
        )
    }
}

impl Drop for Description {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn scenario(text: &str) -> Scenario {
    Scenario::from(
        SegmentFile::parse("s.toml", text).unwrap_or_else(|error| panic!("{error}\n{text}")),
    )
}

/// The segment file with the suggested cycles in the place of its own.
fn rewritten(text: &str, found: &Suggestion) -> String {
    let mut table: toml::Table = text.parse().unwrap();
    let duration = |ns: i64| toml::Value::String(format!("{ns}ns"));
    table["cycle"] = duration(found.smallest_cycle_ns.expect("a cycle that fits"));
    if found.drops_shift {
        table.remove("shift");
    }
    let devices = table["subdevice"].as_array_mut().unwrap();
    for own in &found.own_cycles {
        let device = devices[own.position].as_table_mut().unwrap();
        device.insert("cycle".to_owned(), duration(own.cycle_ns));
    }
    table.to_string()
}

/// Plays what is suggested for a segment file: with it, the file is read and its plan fits. Gives
/// the suggestion and the segment.
fn played(text: &str) -> (Suggestion, Scenario) {
    let before = scenario(text);
    let found = suggest::suggest(&Plan::of(&before).unwrap(), &before);
    let after = scenario(&rewritten(text, &found));
    let plan = Plan::of(&after).unwrap();
    assert!(plan.fits(), "{:?}\n{text}", plan.tightest());
    (found, after)
}

fn in_sync(scenario: &Scenario) {
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    assert!(outcome.failure.is_none(), "{:?}", outcome.failure);
    assert!(outcome.in_sync(), "{:?}", outcome.findings);
}

/// Smallest cycle and what was tried: step, least, most; all in ns.
fn figures(found: &Suggestion) -> (i64, [i64; 3]) {
    let tried = found.cycles.as_ref().unwrap();
    (found.smallest_cycle_ns.unwrap(), [tried.step_ns, tried.least_ns, tried.most_ns])
}

#[test]
fn a_fixed_sync0_allows_its_own_cycle_only() {
    let fixed = Description::with("fixed", &[(SYNC0, "<CycleTimeSync0>2000000</CycleTimeSync0>")]);
    let text = fixed.segment("2ms", "opmode = \"DC\"");
    let (found, after) = played(&text);
    assert_eq!(figures(&found), (2_000_000, [2_000_000, 2_000_000, 2_000_000]));
    assert_eq!(found.smallest_cycle(), "2 ms, the only one that the devices take");
    in_sync(&after);

    // Any other cycle is refused with the way out.
    let refusal = |text: &str| SegmentFile::parse("s.toml", text).unwrap_err().to_string();
    for cycle in ["1ms", "1999999ns", "2000001ns", "4ms"] {
        let error = refusal(&fixed.segment(cycle, "opmode = \"DC\""));
        assert!(error.contains("expected a cycle of 2 ms"), "{error}");
    }
    // As the refusal says: the device alone.
    let alone = fixed.segment("1ms", "opmode = \"DC\"\ncycle = \"2ms\"");
    in_sync(&scenario(&alone));
    let table = cycles::at_cycles("s.toml", &text, &["1ms", "2ms"].map(str::to_owned)).unwrap();
    let [short, right] = &table.plans[..] else { panic!("two plans") };
    assert!(!short.fits && short.verdict.contains("expected a cycle of 2 ms"), "{}", short.verdict);
    assert!(right.fits, "{}", right.verdict);
}

/// A device that takes part in every second bus cycle: the bus cycle is half of what its OpMode
/// takes, and the file needs both.
#[test]
fn slower_devices_keep_their_ratio_and_their_op_mode() {
    let fixed = Description::with("slow", &[(SYNC0, "<CycleTimeSync0>2000000</CycleTimeSync0>")]);
    let slow = fixed.segment("1ms", "opmode = \"DC\"\ncycle = \"2ms\"");
    let text = format!("{slow}[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    let (found, after) = played(&text);
    assert_eq!(figures(&found), (1_000_000, [1_000_000; 3]));
    in_sync(&after);

    // Any OpMode: the ratio stays, and the words name the device's cycle.
    let plain = Description::with("ratio", &[]);
    let text = plain.segment("2ms", "opmode = \"DC\"\ncycle = \"4ms\"").replacen(
        "cycle",
        "shift = \"1ms\"\ncycle",
        1,
    );
    let (found, after) = played(&text);
    let (smallest, _) = figures(&found);
    assert!(smallest < 1_000_000, "{smallest}");
    assert_eq!(after.devices[0].cycle, Some(Nanos(2 * smallest)));
    let words = found.smallest_cycle();
    let own =
        format!("; without the shift of the file; cycle {} for SubDevice 0", Nanos(2 * smallest));
    assert!(words.ends_with(&own), "{words}");
    in_sync(&after);
}

/// SYNC1 marks the bus cycle: multiples of SYNC0, and once SYNC0 alone, in another mode.
#[test]
fn a_fixed_sync0_with_sync1_allows_multiples() {
    let at = |name: &str, sync0: i64, cycle: &str, keys: &str| {
        let times = WITH_SYNC1.replace("250000", &sync0.to_string());
        let file = Description::with(name, &[(WITH_SYNC1, &times)]);
        let (found, after) = played(&file.segment(cycle, keys));
        in_sync(&after);
        (figures(&found), after.devices[0].mode.unwrap().name())
    };
    let (found, mode) = at("multiples", 250_000, "1ms", "opmode = \"Fixed\"");
    assert_eq!((found, mode), ((250_000, [250_000, 250_000, 1_000_000_000]), "dc-sync0"));
    // A mode that SYNC1 needs does not go with a single SYNC0.
    let keys = "opmode = \"Fixed\"\nmode = \"dc-subordinated\"";
    let (found, mode) = at("subordinated", 250_000, "1ms", keys);
    assert_eq!((found.0, mode), (500_000, "dc-subordinated"));
    // No multiple of a microsecond.
    let (found, _) = at("half", 312_500, "1250us", "opmode = \"Fixed\"");
    assert_eq!(found.1, [312_500, 312_500, 999_687_500 + 312_500]);
}

/// SYNC0 by factor follows the bus, and so does the suggested plan.
#[test]
fn parts_of_the_bus_cycle_follow_it() {
    let times = "<CycleTimeSync0 Factor=\"-4\">0</CycleTimeSync0><CycleTimeSync1 Factor=\"4\">0</CycleTimeSync1>";
    let file = Description::with("parts", &[(WITH_SYNC1, times)]);
    let text = file.segment("1ms", "opmode = \"Fixed\"");
    let (found, after) = played(&text);
    let (smallest, tried) = figures(&found);
    assert_eq!(tried, [1_000, 1_000, 1_000_000_000]);
    assert_eq!(after.devices[0].sync0_cycle, Some(Nanos(smallest / 4)));
    in_sync(&after);
}

/// A distance of SYNC1 is the least that the bus cycle may have, and a microsecond more is tried.
#[test]
fn a_distance_of_sync1_is_a_lower_bound() {
    let times = "<CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0><CycleTimeSync1 Factor=\"1\">0</CycleTimeSync1>\
                 <ShiftTimeSync1>800000</ShiftTimeSync1>";
    let file = Description::with("distance", &[(WITH_SYNC1, times)]);
    let text = file.segment("4ms", "opmode = \"Fixed\"");
    let (found, after) = played(&text);
    let (smallest, tried) = figures(&found);
    assert_eq!(tried, [1_000, 801_000, 1_000_000_000]);
    assert!(smallest >= 801_000, "{smallest}");
    assert!(
        found.smallest_cycle().contains("; the devices take 801 us to 1 s"),
        "{}",
        found.smallest_cycle()
    );
    in_sync(&after);
}

/// Published OpModes: each kind of them once, wherever a description has it.
#[test]
fn suggestions_for_published_op_modes_are_accepted() {
    let shared = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let (mut seen, mut narrowed) = (HashSet::new(), 0);
    for path in ["esi", "esi-more"].iter().flat_map(|folder| descriptions(&shared.join(folder))) {
        let path = path.display().to_string();
        let Ok(file) = EsiFile::read(&path) else { continue };
        for device in &file.devices {
            for number in 0..device.op_modes().len() {
                let taken = TakenOpMode::new(device, number).expect("it has this number");
                let Some(cycles) = taken.bus_cycles() else { continue };
                let kind = (taken.terms, device.profile.is_drive());
                if seen.contains(&kind) {
                    continue;
                }
                let cycle = cycles.nearest(Nanos::millis(2)).0;
                let (name, revision) = (&device.type_name, device.revision.unwrap_or(0));
                let text = format!(
                    "cycle = \"{cycle}ns\"\n[[subdevice]]\nesi = {path:?}\ntype = {name:?}\n\
                     revision = {revision}\nopmode = {number}\n"
                );
                // What can't be simulated, or does not fit at any cycle, has its tests elsewhere.
                let before = match SegmentFile::parse("s.toml", &text) {
                    Ok(file) => Scenario::from(file),
                    Err(error) => {
                        assert!(!error.to_string().contains("its pulses repeat"), "{error}");
                        continue;
                    }
                };
                let Ok(plan) = Plan::of(&before) else { continue };
                if suggest::suggest(&plan, &before).smallest_cycle_ns.is_none() {
                    continue;
                }
                played(&text);
                seen.insert(kind);
                narrowed += usize::from(cycles.least != cycles.step || cycles.step > Nanos(1));
            }
        }
    }
    println!("{} kinds of OpModes, {narrowed} of them take some cycles only", seen.len());
    assert!(seen.is_empty() || (seen.len() >= 40 && narrowed >= 20), "{}", seen.len());
}

/// The descriptions of a folder, by name; none with a word if it is not there.
fn descriptions(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        println!("skipped: no descriptions in {}", folder.display());
        return Vec::new();
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut all: Vec<_> =
        paths.filter(|path| path.extension().is_some_and(|e| e == "xml")).collect();
    all.sort();
    all
}

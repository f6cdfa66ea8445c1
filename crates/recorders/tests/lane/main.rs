//! Regular parts of a cycle take a short way through the simulation (the lane), which must not be
//! visible: each scenario runs with and without it, and all output must be equal to the byte. The
//! output is captures with probes and taps, waveforms, traces, series, findings of judges, each
//! call of a tap, and registers, memory and counters of all SubDevices during the run.
//!
//! Scenarios are random: modes, shifts, subordinated cycles, jitter, trees and rings, devices that
//! come late, faults of all kinds. A few of them always run. `ISOCAT_SEGMENTS=2000 cargo test
//! --test lane -- --nocapture` runs more; `ISOCAT_SEGMENTS_FROM` sets the number of the first one.

mod bulk;
#[path = "../../../isocat/tests/random_segments/generator.rs"]
#[allow(dead_code, reason = "whether devices are honest is another test's concern")]
mod generator;
mod judges;
mod scenarios;
mod witness;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use isocat_segment::{Scenario, SegmentFile, profile};
use isocat_sim::{Outcome, Tap};
use isocat_wire::Nanos;
use isocat_wire::time::{Time, True};

use scenarios::scenario;
use witness::{Digest, Witness};

/// Digests of the output of a run, by name.
type Digests = Vec<(&'static str, u64)>;

/// Runs a scenario: the digests of all output, and what was found.
fn run(scenario: &Scenario) -> (Digests, String) {
    let outcome = scenario.run().execute(Some(Witness::new(scenario)), &mut |_| {});
    let found = format!("{:?} {:?}", outcome.findings, outcome.failure);
    let mut digests = results(&outcome);
    digests.extend(outcome.world.into_tap().expect("the tap").finish());
    (digests, found)
}

/// Digests of the results of a run, which do not depend on the tap.
fn results<T: Tap>(outcome: &Outcome<T>) -> Digests {
    let counters = (&outcome.output_counters, &outcome.input_counters, &outcome.alarms);
    let main = (outcome.world.main().statistics(), outcome.world.main().segment());
    let found = (&outcome.findings, &outcome.failure, &outcome.visits);
    let all = [
        ("judges", format!("{:?}", outcome.bench)),
        ("course", format!("{:?} {:?}", outcome.world.course(), outcome.judgements)),
        ("counters", format!("{counters:?}")),
        ("main", format!("{:?} {:?} {:?}", main, outcome.began, outcome.ended)),
        ("found", format!("{found:?}")),
    ];
    all.map(|(what, text)| (what, Digest::of(text.as_bytes()))).into()
}

/// A tap that observes nothing, so that only what judges need is reported. It has the probes and
/// cables of the witness, because these change the way of frames through a segment.
struct Nobody {
    probes: Vec<usize>,
    cables: Vec<usize>,
}

impl Tap for Nobody {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
    fn probes(&self) -> Vec<usize> {
        self.probes.clone()
    }
    fn cables(&self) -> Vec<usize> {
        self.cables.clone()
    }
    fn observes(&self) -> bool {
        false
    }
}

/// Runs a scenario with and without the lane; returns whether it reached operation. `Err` names
/// what differs.
fn try_one(name: &str, text: &str) -> Result<bool, String> {
    let Ok(file) = SegmentFile::parse("random.toml", text) else { return Ok(false) };
    let mut scenario = Scenario::from(file);
    scenario.duration = scenario.duration.max(Nanos(scenario.cycle.0 * LEAST_CYCLES));
    scenario.force = true;
    let [short, long] = [true, false].map(|lane| run(&Scenario { lane, ..scenario.clone() }));
    if short == long {
        let witness = Witness::new(&scenario);
        let nobody = Nobody { probes: witness.probes(), cables: witness.cables() };
        let unseen = results(&scenario.run().execute(Some(nobody), &mut |_| {}));
        if !short.0.starts_with(&unseen) {
            return Err(format!("{name} is another one where nobody looks on:\n{text}"));
        }
        return Ok(!short.0.iter().any(|(what, digest)| *what == "judged" && *digest == 0));
    }
    let differ = short.0.iter().zip(&long.0).filter(|(one, other)| one != other);
    let differ: Vec<_> = differ.map(|((what, _), _)| *what).collect();
    Err(format!("{name}: {differ:?} differ\n{}\n{}\n{text}", short.1, long.1))
}

/// A number from the environment.
fn number(name: &str, otherwise: u64) -> u64 {
    let text = std::env::var(name).ok();
    text.map_or(otherwise, |text| text.parse().expect("a number of scenarios"))
}

/// Writes a device description; returns its path.
fn written(name: &str, description: &str) -> String {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("lane");
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(name);
    std::fs::write(&path, description).expect("a file");
    path.display().to_string()
}

/// Runs all scenarios; returns how many were judged, and what differed.
fn try_all(all: &[(String, String)]) -> (usize, Vec<String>) {
    try_each(all, try_one)
}

/// Tries all scenarios, two at a time; returns how many did what is wanted, and what differed.
fn try_each(
    all: &[(String, String)],
    try_one: impl Fn(&str, &str) -> Result<bool, String> + Sync,
) -> (usize, Vec<String>) {
    let next = AtomicU64::new(0);
    let results = Mutex::new((0, Vec::new()));
    let work = || {
        while let Some((name, text)) = all.get(next.fetch_add(1, Ordering::Relaxed) as usize) {
            let found = try_one(name, text);
            let (judged, failures) = &mut *results.lock().expect("no thread panicked");
            match found {
                Ok(was_judged) => *judged += usize::from(was_judged),
                Err(what) => {
                    println!("{what}");
                    failures.push(what);
                }
            }
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(work);
        scope.spawn(work);
    });
    results.into_inner().expect("no thread panicked")
}

#[test]
fn random_scenarios_are_the_same_without_the_lane() {
    let from = number("ISOCAT_SEGMENTS_FROM", 0);
    let count = number("ISOCAT_SEGMENTS", FEW);
    let all: Vec<_> =
        (from..from + count).map(|n| (format!("scenario {n}"), scenario(n))).collect();
    let (judged, failures) = try_all(&all);
    println!("{judged} of {} got into operation, {} differ", all.len(), failures.len());
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    // Scenarios that do not reach operation prove nothing.
    assert!(judged * 3 >= all.len(), "{judged} of {} got into operation", all.len());
}

/// Runs the files of the documentation: each fault, a ring, a machine.
#[test]
fn documented_faults_are_the_same_without_the_lane() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/faults");
    let files = std::fs::read_dir(folder).expect("the folder of faults");
    let mut all: Vec<_> = files
        .map(|file| file.expect("a file").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "toml"))
        .map(|path| {
            let text = std::fs::read_to_string(&path).expect("a file of text");
            // Shortens the half second before the fault.
            let text = text.replace("+ 500ms", "+ 60ms").replace("for = \"2s\"", "for = \"250ms\"");
            (path.display().to_string(), text)
        })
        .collect();
    all.sort();
    assert!(all.len() >= 25, "{} files", all.len());
    let (judged, failures) = try_all(&all);
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert!(judged * 10 >= all.len() * 9, "{judged} of {} got into operation", all.len());
}

/// Devices that oversample: inputs and outputs, with a program and without, and a set that is never
/// whole.
#[test]
fn samples_are_the_same_without_the_lane() {
    let mut all = Vec::new();
    for (kind, purpose) in [("TxPdo", "Inputs"), ("RxPdo", "Outputs")] {
        for (emulation, sync0) in [("0C", ""), ("0D", ""), ("0C", "sync0_cycle = \"250us\"\n")] {
            let name = format!("{purpose}-{emulation}.xml");
            let esi = written(&name, &sampler(kind, purpose, emulation));
            let device = format!("[[subdevice]]\nesi = {esi:?}\ntype = \"Sampler\"\n{sync0}");
            let fault = "[[fault]]\nat = \"in-operation + 20ms\"\nwhat = \"drop 2\"\n";
            let text = format!(
                "cycle = \"1ms\"\nfor = \"40ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n{device}{device}{fault}"
            );
            all.push((format!("{name} {sync0}"), text));
        }
    }
    let (judged, failures) = try_all(&all);
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert_eq!(judged, all.len());
}

/// A device without process data whose SYNC0 stays active until it is acknowledged. Its stack has
/// no mode with SYNC, and acknowledges all the same.
#[test]
fn pulses_that_nobody_uses_are_acknowledged_without_the_lane_too() {
    let esi = written("acknowledges.xml", &acknowledges());
    let all: Vec<_> = ["", "device = \"kollmorgen_akd2g\"", "device = \"simple_io16\""]
        .iter()
        .map(|beside| {
            let beside = if beside.is_empty() { "" } else { &format!("[[subdevice]]\n{beside}\n") };
            let device = format!("[[subdevice]]\nesi = {esi:?}\ntype = \"Pulses\"\nopmode = 0\n");
            (beside.to_owned(), format!("cycle = \"1ms\"\nfor = \"40ms\"\n{beside}{device}"))
        })
        .collect();
    let (judged, failures) = try_all(&all);
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert_eq!(judged, all.len());
}

/// No process data, and SYNC0 in each cycle whose pulse length in the EEPROM is 0.
fn acknowledges() -> String {
    "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group><Type>G</Type></Group></Groups>\
     <Devices><Device Physics=\"YY\"><Type ProductCode=\"4\" RevisionNo=\"1\">Pulses</Type><GroupType>G</GroupType>\
     <Dc><OpMode><Name>DC</Name><AssignActivate>#x0300</AssignActivate><CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0>\
     </OpMode></Dc><Eeprom><ByteSize>256</ByteSize><ConfigData>08000200</ConfigData></Eeprom></Device></Devices>\
     </Descriptions></EtherCATInfo>"
        .to_owned()
}

/// Ten samples of 8 bits in a cycle.
fn sampler(kind: &str, purpose: &str, emulation: &str) -> String {
    format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group><Type>G</Type></Group></Groups>\
         <Devices><Device Physics=\"YY\"><Type ProductCode=\"2\" RevisionNo=\"3\">Sampler</Type><GroupType>G</GroupType>\
         <Sm StartAddress=\"#x1000\" ControlByte=\"#x44\" Enable=\"1\">{purpose}</Sm><{kind} Sm=\"0\" OSFac=\"10\" \
         OSIndexInc=\"1\"><Index>#x1A00</Index><Name>S</Name><Entry><Index>#x6000</Index><SubIndex>1</SubIndex><BitLen>8</BitLen>\
         <Name>S</Name><DataType>USINT</DataType></Entry></{kind}><Dc><OpMode><Name>Samples</Name>\
         <AssignActivate>#x0730</AssignActivate><CycleTimeSync0 Factor=\"-10\">0</CycleTimeSync0>\
         <CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1></OpMode></Dc><Eeprom><ByteSize>256</ByteSize>\
         <ConfigData>04{emulation}00cce803</ConfigData></Eeprom></Device></Devices></Descriptions></EtherCATInfo>"
    )
}

/// Number of scenarios that run by default.
const FEW: u64 = 24;
/// Number of cycles that each scenario runs at least.
const LEAST_CYCLES: i64 = 40;

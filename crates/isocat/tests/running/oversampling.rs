//! Devices that oversample: each sample at its own SYNC0, whole sets, and what is found where they
//! are not whole.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use isocat::esi::EsiFile;
use isocat::profile::{Profile, ProfileText};
use isocat::report::samples::Samples;
use isocat::waves::Waves;
use isocat::{Nanos, NoTap, Report, Scenario, SegmentFile};
use isocat_maindevice::MainDevice;
use isocat_sim::bench::Intent;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::sampling::Sample;
use isocat_sim::{Segment, Tap};
use isocat_sync::{Step, SyncMode};
use isocat_wire::time::{Time, True};
use vcd::{Command, Parser, ScopeItem, Value};

/// A device with one direction: a count of 16 bits, and behind it an entry that stands there
/// `factor` times.
fn description(outputs: bool, entry: u16, factor: u16, sync0: &str) -> String {
    let (kind, purpose, control) = match outputs {
        true => ("RxPdo", "Outputs", "#x44"),
        false => ("TxPdo", "Inputs", "#x20"),
    };
    let pdo = |factor: &str, index: u16, object: u16, bits: u16| {
        format!(
            "<{kind} Sm=\"0\"{factor}><Index>{index}</Index><Name>P</Name><Entry><Index>{object}</Index><SubIndex>1</SubIndex>\
             <BitLen>{bits}</BitLen><Name>E</Name><DataType>UINT</DataType></Entry></{kind}>"
        )
    };
    let first = if outputs { 0x1600 } else { 0x1A00 };
    let count = pdo("", first, 0x6800, COUNT_BITS as u16);
    let samples = pdo(&format!(" OSFac=\"{factor}\" OSIndexInc=\"1\""), first + 1, 0x6000, entry);
    format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group><Type>G</Type></Group></Groups>\
         <Devices><Device Physics=\"KK\"><Type ProductCode=\"2\" RevisionNo=\"3\">Sampler</Type><Name>Sampler</Name>\
         <GroupType>G</GroupType><Sm StartAddress=\"#x1000\" ControlByte=\"{control}\" Enable=\"1\">{purpose}</Sm>\
         {count}{samples}<Dc><OpMode><Name>Samples</Name>{sync0}</OpMode></Dc>\
         <Eeprom><ByteSize>256</ByteSize><ConfigData>040C00cce803</ConfigData></Eeprom></Device></Devices></Descriptions>\
         </EtherCATInfo>"
    )
}

/// `pulses` SYNC0 in a cycle, and one SYNC1.
fn parts(pulses: u16) -> String {
    format!(
        "<AssignActivate>#x0730</AssignActivate><CycleTimeSync0 Factor=\"-{pulses}\">0</CycleTimeSync0>\
         <CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1>"
    )
}

/// SYNC0 with a cycle of its own.
const FIXED: &str = "<AssignActivate>#x0730</AssignActivate><CycleTimeSync0>250000</CycleTimeSync0>\
     <CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1>";

/// Bits of the count.
const COUNT_BITS: usize = 16;

/// A reference clock, and the device behind it.
fn scenario(description: &str, cycle: &str, keys: &str) -> Scenario {
    static NUMBER: AtomicUsize = AtomicUsize::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("oversampling-{number}"));
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("sampler.xml"), description).expect("a file");
    let text = format!(
        "cycle = \"{cycle}\"\nfor = \"40ms\"\n[[subdevice]]\ndevice = \"beckhoff_ek1100\"\n[[subdevice]]\n\
         name = \"sampler\"\nesi = \"sampler.xml\"\ntype = \"Sampler\"\n{keys}"
    );
    let path = folder.join("segment.toml").display().to_string();
    Scenario::from(SegmentFile::parse(&path, &text).unwrap_or_else(|error| panic!("{error}")))
}

/// Position of the device.
const SAMPLER: usize = 1;

/// Keeps what happens at the device, and its inputs as each cycle brings them.
#[derive(Default)]
struct Watch {
    events: Vec<(u64, Observed)>,
    images: Vec<Vec<u8>>,
    /// Since when it is judged, ps.
    since: Option<u64>,
}

impl Tap for Watch {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        if observation.device == SAMPLER {
            self.events.push((at.count(), observation.event));
        }
    }
    fn judging_begins(&mut self, at: Time<True>, _: &Intent) {
        self.since = Some(at.count());
    }
    fn cycle(&mut self, _: Time<True>, main: &MainDevice, _: &Segment) {
        if self.since.is_some() {
            self.images.push(main.inputs(SAMPLER).to_vec());
        }
    }
}

fn watch(scenario: &Scenario) -> (Watch, Report) {
    let outcome = scenario.run().execute(Some(Watch::default()), &mut |_| {});
    let report = Report::new(scenario, &outcome);
    (outcome.world.into_tap().expect("the tap"), report)
}

/// The signal as it is documented: a sawtooth of 10 ms over the whole range, which begins with the
/// run.
fn signal(at_ps: u64, bits: u32) -> u32 {
    const PERIOD: u128 = 10_000_000_000;
    (u128::from(at_ps) % PERIOD * (1 << bits) / PERIOD) as u32
}

/// The samples in an image, those of one bit from the lowest bit on.
fn unpack(image: &[u8], bits: usize) -> Vec<u32> {
    let bit = |at: usize| u32::from(image[at / 8] >> (at % 8) & 1);
    let sample = |at: usize| (0..bits).fold(0, |value, n| value | bit(at + n) << n);
    (COUNT_BITS..image.len() * 8 + 1 - bits).step_by(bits).map(sample).collect()
}

/// A step of the ESC's clock, and what both clocks may be off in the time from one sample to the
/// next.
fn is_even(found_ps: u64, wanted_ps: u64) -> bool {
    found_ps.abs_diff(wanted_ps) <= 10_000 + wanted_ps * 25 / 1_000_000
}

/// Looks at everything of a device that samples inputs: `pulses` samples of so many bits in a cycle
/// of 1 ms.
fn check_inputs(pulses: u16, bits: u32, entry: u16, factor: u16) -> (Watch, Samples) {
    let text = description(false, entry, factor, &parts(pulses));
    // A program with the times that are assumed of one can't have so short a SYNC0: device
    // emulation has none.
    let (text, keys) = match pulses {
        ..100 => (text, ""),
        _ => (text.replace("040C00", "040D00"), "pulse = \"500ns\"\n"),
    };
    let scenario = scenario(&text, "1ms", keys);
    let (seen, report) = watch(&scenario);
    assert!(report.in_sync, "{}", report.verdict);
    let since = seen.since.expect("it is judged");
    let mut sets: Vec<Vec<u32>> = vec![Vec::new()];
    let (mut pulse, mut last, mut distances) = (0, None, Vec::new());
    for (at, event) in &seen.events {
        match event {
            Observed::Sync0 => pulse = *at,
            Observed::Sampled(Sample { is_output: false, channel: 0, number, value }) => {
                assert_eq!(*at, pulse, "at its own SYNC0");
                assert_eq!(*value, signal(*at, bits), "what the signal shows then");
                if *at > since {
                    let set = sets.last().expect("one");
                    assert_eq!(usize::from(*number), set.len(), "its number in the set");
                    distances.extend(last.map(|last| at - last));
                    last = Some(*at);
                }
                sets.last_mut().expect("one").push(*value);
            }
            Observed::Sampled(other) => panic!("{other:?}"),
            Observed::Began(Step::LatchInputs) => {
                assert_eq!(*at, pulse, "the last one and the latch are together");
                if *at > since {
                    assert_eq!(sets.last().expect("one").len(), usize::from(pulses));
                }
                sets.push(Vec::new());
            }
            _ => {}
        }
    }
    let wanted = 1_000_000_000 / u64::from(pulses);
    for found in &distances {
        assert!(is_even(*found, wanted), "{found} ps from sample to sample, {wanted} wanted");
    }
    // Each cycle brings the set behind the one that came before it.
    assert!(seen.images.len() >= 38, "{} cycles", seen.images.len());
    let images: Vec<_> = seen.images.iter().map(|image| unpack(image, bits as usize)).collect();
    let first = sets.windows(2).position(|pair| pair[0] == images[0] && pair[1] == images[1]);
    let first = first.expect("the first image is a set");
    assert_eq!(images[..], sets[first..first + images.len()], "no set is left out or mixed");
    // The report measured the same.
    let samples = report.devices[SAMPLER].true_time.input_samples.expect("it oversamples");
    assert_eq!((samples.in_set, samples.incomplete), (pulses, 0));
    assert!((38..=40).contains(&samples.sets), "{}", samples.sets);
    let distance = samples.distance.expect("more than one");
    let ns = |ps: Option<&u64>| *ps.expect("some") as f64 / 1e3;
    assert_eq!(distance.min_ns, ns(distances.iter().min()));
    assert_eq!(distance.max_ns, ns(distances.iter().max()));
    assert_eq!(report.devices[SAMPLER].true_time.output_samples, None);
    assert_eq!(report.devices[0].true_time.input_samples, None);
    (seen, samples)
}

#[test]
fn ten_samples_a_cycle_differ_by_their_instants() {
    let (seen, _) = check_inputs(10, 16, 16, 10);
    for image in &seen.images {
        let samples = unpack(image, 16);
        // 100 us are 655.36 steps of the signal; once in ten cycles it begins anew.
        let steps: Vec<u32> =
            samples.windows(2).map(|pair| pair[1].wrapping_sub(pair[0]) & 0xFFFF).collect();
        assert!(steps.iter().all(|step| (655..=656).contains(step)), "{steps:?}");
    }
    // The last sample of a set is taken with SYNC1.
    let last = |event: &Observed| matches!(event, Observed::Sampled(sample) if sample.number == 9);
    let of = |wanted: &dyn Fn(&Observed) -> bool| -> Vec<u64> {
        let since = seen.since.expect("it is judged");
        let events = seen.events.iter().filter(|(at, event)| *at > since && wanted(event));
        events.map(|(at, _)| *at).collect()
    };
    assert_eq!(of(&last), of(&|event| *event == Observed::Sync1));
}

#[test]
fn one_sample_in_a_cycle_is_that_of_its_sync0() {
    check_inputs(1, 16, 16, 1);
}

#[test]
fn two_samples_and_a_hundred() {
    check_inputs(2, 16, 16, 2);
    check_inputs(100, 8, 8, 100);
}

/// Terminals with digital inputs have eight samples in an entry.
#[test]
fn a_thousand_samples_of_one_bit() {
    check_inputs(1_000, 1, 8, 125);
}

#[test]
fn waves_have_each_sample_at_its_instant() {
    let scenario = scenario(&description(false, 16, 10, &parts(10)), "1ms", "");
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let mut file = Vec::new();
    let outcome = scenario.run().execute(Some(Waves::new(&mut file, names)), &mut |_| {});
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let mut parser = Parser::new(&file[..]);
    let header = parser.parse_header().expect("a header");
    let id = |scope: &str, name: &str| {
        let var = header.find_var(&["segment", scope, name]);
        var.unwrap_or_else(|| panic!("{scope} has {name}")).code
    };
    let [sample, value, sync0] =
        ["in0_sample", "in0_value", "sync0"].map(|name| id("d1_sampler", name));
    let others = header.items.iter().find_map(|item| match item {
        ScopeItem::Scope(scope) => Some(scope),
        _ => None,
    });
    let other = others.expect("one for all").items.iter().find_map(|item| match item {
        ScopeItem::Scope(scope) if scope.identifier.starts_with("d0_") => Some(scope),
        _ => None,
    });
    let is_sample = |item: &ScopeItem| match item {
        ScopeItem::Var(var) => var.reference.contains("_sample"),
        _ => false,
    };
    assert!(!other.expect("the coupler").items.iter().any(is_sample), "only what oversamples");
    let number = |bits: &vcd::Vector| {
        bits.iter().fold(0u32, |number, bit| number << 1 | u32::from(bit == Value::V1))
    };
    let (mut now, mut pulse, mut numbers) = (0, 0, Vec::new());
    for command in parser {
        match command.expect("a command") {
            Command::Timestamp(at) => now = at,
            Command::ChangeScalar(changed, _) if changed == sync0 => pulse = now,
            Command::ChangeVector(changed, bits) if changed == sample => {
                assert_eq!(now, pulse, "with SYNC0");
                numbers.push((now, number(&bits)));
            }
            Command::ChangeVector(changed, bits) if changed == value => {
                assert_eq!(number(&bits), signal(now, 16));
            }
            _ => {}
        }
    }
    assert!(numbers.len() >= 400, "{}", numbers.len());
    for pair in numbers[numbers.len() - 390..].windows(2) {
        let ((before, one), (at, next)) = (pair[0], pair[1]);
        assert_eq!(next, (one + 1) % 10);
        assert!(is_even(at - before, 100_000_000), "{} ps", at - before);
    }
}

/// Four samples of outputs: the first acts with SYNC1, each further one with its SYNC0, with the
/// value that came for it.
#[test]
fn samples_of_outputs_act_at_their_instants() {
    let mut keys = String::new();
    for (at, base) in [("0ms", 10), ("20ms", 100)] {
        for number in 0..4 {
            keys += &format!(
                "[[output]]\nat = \"in-operation + {at}\"\ndevice = \"sampler\"\nplace = \"byte {}\"\ntype = \"u8\"\n\
                 value = {}\n",
                2 + number,
                base + number
            );
        }
    }
    let scenario = scenario(&description(true, 8, 4, &parts(4)), "1ms", &keys);
    let (seen, report) = watch(&scenario);
    assert!(report.in_sync, "{}", report.verdict);
    let since = seen.since.expect("it is judged") + 3_000_000_000;
    let (mut sync0, mut sync1, mut number_expected, mut bases) = (0, 0, None, Vec::new());
    for (at, event) in &seen.events {
        match event {
            Observed::Sync0 => sync0 = *at,
            Observed::Sync1 => sync1 = *at,
            Observed::Sampled(Sample { is_output, channel, number, value }) if *at > since => {
                assert!(*is_output && *channel == 0);
                let expected = number_expected.replace((number + 1) % 4);
                assert!(expected.is_none_or(|expected| expected == *number), "{number}");
                assert_eq!(*at, sync0, "with a SYNC0");
                assert_eq!(*number == 0, sync1 == *at, "the first one with SYNC1");
                bases.push(value - u32::from(*number));
            }
            _ => {}
        }
    }
    bases.dedup();
    assert_eq!(bases, [10, 100], "all samples of a set came with one frame");
    let samples = report.devices[SAMPLER].true_time.output_samples.expect("it oversamples");
    assert_eq!((samples.in_set, samples.incomplete), (4, 0));
    assert!((38..=40).contains(&samples.sets), "{}", samples.sets);
    let distance = samples.distance.expect("more than one");
    for ns in [distance.min_ns, distance.max_ns] {
        assert!(is_even((ns * 1e3) as u64, 250_000_000), "{ns}");
    }
}

/// The figures of what was found of samples: expected, first found, how many; all kinds.
fn incomplete(scenario: &Scenario) -> (Option<serde_json::Value>, Vec<&'static str>) {
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    let report = Report::new(scenario, &outcome);
    let kinds = report.findings.iter().map(|finding| finding.kind.name()).collect();
    let found = serde_json::to_value(&report).expect("JSON")["findings"]
        .as_array()
        .expect("a list")
        .iter()
        .find(|finding| finding["kind"] == "samples-incomplete")
        .cloned();
    (found, kinds)
}

/// SYNC0 has a cycle of its own, so a bus cycle that is one shorter or one longer brings another
/// number of pulses.
#[test]
fn a_bus_cycle_with_other_pulses_is_found() {
    for (outputs, entry) in [(false, 16), (true, 8)] {
        let text = description(outputs, entry, 4, FIXED);
        for (cycle, found) in [("750us", Some(3)), ("1ms", None), ("1250us", Some(5))] {
            let (incomplete, kinds) = incomplete(&scenario(&text, cycle, ""));
            match (incomplete, found) {
                (None, None) => {}
                (Some(finding), Some(found)) => {
                    assert_eq!(
                        (&finding["figures"]["found"]),
                        &serde_json::json!(found),
                        "{cycle}"
                    );
                    assert_eq!(finding["figures"]["expected"], 4);
                    assert_eq!(finding["figures"]["outputs"], outputs);
                }
                (found, _) => panic!("{cycle} {outputs}: {found:?} {kinds:?}"),
            }
        }
    }
}

#[test]
fn samples_without_sync0_are_found() {
    for outputs in [false, true] {
        let text = description(outputs, 8, 4, &parts(4));
        let (finding, kinds) = incomplete(&scenario(&text, "1ms", "mode = \"sm\"\n"));
        let finding = finding.unwrap_or_else(|| panic!("{kinds:?}"));
        assert_eq!(finding["figures"]["found"], 0);
        assert!(finding["figures"]["count"].as_u64().expect("a number") >= 38, "{finding}");
    }
}

/// Pulses that are longer than the distance of two samples make no edge: the device has no whole
/// set, and does not get into OP.
#[test]
fn pulses_without_an_edge_are_not_silent() {
    let text = description(false, 16, 10, &parts(10));
    let kinds_with = |pulse: &str| {
        // The plan refuses it.
        incomplete(&Scenario { force: true, ..scenario(&text, "1ms", pulse) }).1
    };
    assert_eq!(kinds_with("pulse = \"100us\"\n"), Vec::<&str>::new());
    assert_eq!(kinds_with("pulse = \"110us\"\n"), ["failed"]);
}

/// Where SYNC0 does not take them, that is told, and nothing is expected of it.
#[test]
fn several_values_at_one_sync0_are_a_doubt() {
    let once =
        "<AssignActivate>#x0300</AssignActivate><CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0>";
    let off = "<AssignActivate>0</AssignActivate>";
    let fixed = "<AssignActivate>#x0300</AssignActivate><CycleTimeSync0>1000000</CycleTimeSync0>";
    let comes_once = "SYNC0 comes 1 times";
    for (sync0, words) in [(once, comes_once), (fixed, comes_once), (off, "no SYNC0 takes them")] {
        let scenario = scenario(&description(false, 16, 2, sync0), "1ms", "");
        let device = &scenario.devices[SAMPLER];
        assert_eq!(device.profile.sampling, None);
        let told = device.notes.iter().find(|note| note.kind.name() == "oversampling");
        assert!(told.is_some_and(|note| note.what.contains(words)), "{:?}", device.notes);
        assert!(watch(&scenario).1.in_sync);
    }
    // One value, by SYNC0 or not, is nothing to doubt.
    for (sync0, sampled) in [(once, true), (off, false)] {
        let scenario = scenario(&description(false, 16, 1, sync0), "1ms", "");
        let device = &scenario.devices[SAMPLER];
        assert_eq!(device.profile.sampling.is_some(), sampled);
        assert!(
            device.notes.iter().all(|note| note.kind.name() != "oversampling"),
            "{:?}",
            device.notes
        );
    }
}

#[test]
fn a_profile_file_says_that_it_has_no_samples() {
    let text = description(false, 16, 10, &parts(10));
    let file = EsiFile::from_bytes("sampler.xml", text.as_bytes()).expect("a description");
    let device = &file.devices[0];
    let profile = Profile::from_esi(&file, device, Some(0)).expect("it can be simulated");
    let sampling = profile.sampling.as_ref().expect("it oversamples");
    assert_eq!((sampling.samples, sampling.inputs.len(), sampling.outputs.len()), (10, 1, 0));
    let written = ProfileText::from_esi(&file, device, Some(0), "a test").expect("a profile");
    assert!(written.text.contains("oversampling"), "{}", written.text);
}

#[test]
fn the_text_of_the_report_has_the_samples() {
    let scenario = scenario(&description(false, 16, 10, &parts(10)), "1ms", "");
    let text = watch(&scenario).1.text();
    let line = text.lines().find(|line| line.contains("sampler") && line.contains("inputs"));
    let figures: Vec<_> = line.expect("a line").split_whitespace().collect();
    assert_eq!(figures[..4], ["1", "sampler", "inputs", "10"], "{text}");
    assert_eq!(figures[5], "0", "{text}");
}

/// Published descriptions beside the project; none with a word if they are not there.
fn files() -> Vec<PathBuf> {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let mut files = Vec::new();
    for part in ["esi", "esi-more"] {
        let entries = std::fs::read_dir(folder.join(part)).into_iter().flatten().flatten();
        files.extend(entries.map(|entry| entry.path()));
    }
    files.retain(|path| path.extension().is_some_and(|ending| ending == "xml"));
    files.sort();
    if files.is_empty() {
        println!("skipped: no descriptions in {}", folder.display());
    }
    files
}

/// Each OpMode of each terminal that oversamples: all samples, whole sets, evenly apart.
#[test]
fn published_terminals_that_oversample_do() {
    let mut tried = 0;
    for path in files() {
        let name = path.display().to_string();
        let text = std::fs::read(&path).expect("a file");
        if !text.windows(5).any(|word| word == b"OSFac") {
            continue;
        }
        let file = EsiFile::read(&name).expect("a description");
        for device in &file.devices {
            for number in 0..device.op_modes().len() {
                let Ok(profile) = Profile::from_esi(&file, device, Some(number)) else { continue };
                let Some(sampling) = profile.sampling.clone() else { continue };
                let segment = format!(
                    "cycle = \"1ms\"\nfor = \"8ms\"\n[[subdevice]]\ndevice = \"beckhoff_ek1100\"\n[[subdevice]]\n\
                     esi = {name:?}\ntype = {:?}\nrevision = {}\nopmode = {number}\n",
                    device.type_name,
                    device.revision.unwrap_or(0)
                );
                let Ok(parsed) = SegmentFile::parse("segment.toml", &segment) else { continue };
                let scenario = Scenario::from(parsed);
                let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
                let report = Report::new(&scenario, &outcome);
                let place =
                    format!("{} {} {number}", device.type_name, device.op_modes()[number].name);
                assert!(report.in_sync, "{place}: {}", report.verdict);
                let seen = &report.devices[SAMPLER].true_time;
                let wanted = Nanos::millis(1).0 as u64 * 1_000 / u64::from(sampling.samples);
                for (has, samples) in [
                    (!sampling.inputs.is_empty(), seen.input_samples),
                    (!sampling.outputs.is_empty(), seen.output_samples),
                ] {
                    assert_eq!(samples.is_some(), has, "{place}");
                    let Some(samples) = samples else { continue };
                    assert_eq!(
                        (samples.in_set, samples.incomplete),
                        (sampling.samples, 0),
                        "{place}"
                    );
                    assert!(samples.sets >= 6, "{place}: {}", samples.sets);
                    let distance = samples.distance.expect("more than one");
                    for ns in [distance.min_ns, distance.max_ns] {
                        assert!(is_even((ns * 1e3) as u64, wanted), "{place}: {ns} ns");
                    }
                    tried += 1;
                }
                let is_one = report.devices[SAMPLER].mode == SyncMode::DcSync0;
                assert_eq!(is_one, sampling.samples == 1, "{place}");
            }
        }
    }
    println!("{tried} OpModes tried");
}

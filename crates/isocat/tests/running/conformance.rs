//! The conformance suite: devices that behave pass, and of devices that do not, exactly the rule
//! that they break fails.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock};

use isocat::conform::report::{ConformanceReport, DeviceReport, Verdict};
use isocat::conform::rules;
use isocat::conform::subject::Hints;
use isocat::conform::wire::VirtualWire;
use isocat::{Scenario, SegmentFile, conform, profile};

const DRIVE: &str = "kollmorgen_akd2g";
const STACK: &str = "hpmicro_ecat_cia402_ssc";
const EVERY_MODE: &str = "model_every_mode";
const TERMINAL: &str = "beckhoff_el2502-0010";
/// The drive, with SYNC1 announced: see [`device`].
const WITH_SYNC1: &str = "sync1";

/// A rule, a device, what makes it break the rule, and the rules that have to follow.
type Breaker = (&'static str, &'static str, &'static [&'static str], &'static [&'static str]);

const BREAKERS: &[Breaker] = &[
    ("OBJ-01", DRIVE, &["wrong-value 1C00:03 7"], &[]),
    ("OBJ-02", DRIVE, &["wrong-type 1C12:01 0x05"], &[]),
    ("OBJ-03", DRIVE, &["wrong-type 1C32:02 0x06"], &[]),
    ("OBJ-04", DRIVE, &["missing-entry 1C32:06"], &[]),
    ("OBJ-05", DRIVE, &["missing-entry 1C32:20"], &[]),
    ("OBJ-06", TERMINAL, &["missing-entry 1C32:08"], &[]),
    ("OBJ-07", DRIVE, &["shifted-complete-access 1C32"], &[]),
    ("OBJ-08", TERMINAL, &["wrong-value 1C32:00 0"], &[]),
    ("OBJ-09", DRIVE, &["wrong-value 1C33:05 1"], &[]),
    ("OBJ-10", DRIVE, &["wrong-value 1C33:04 0x00A7"], &[]),
    ("OBJ-11", EVERY_MODE, &["read-only 1C33:03"], &[]),
    ("OBJ-12", DRIVE, &["wrong-value 1C32:07 31000"], &[]),
    ("OBJ-13", STACK, &["wrong-type 10F1:02 0x05"], &[]),
    ("OBJ-14", DRIVE, &["wrong-abort 1C32:F0 0x06090011"], &[]),
    ("OBJ-15", DRIVE, &["wrong-abort 1C3F:01 0x06020000"], &[]),
    ("OBJ-16", DRIVE, &["half-hidden"], &[]),
    ("ACC-01", DRIVE, &["refuses-read 1C33:06"], &[]),
    ("ACC-02", DRIVE, &["accepts-write 1C33:06"], &[]),
    ("ACC-03", DRIVE, &["refuses-write 1C33:08 PREOP"], &[]),
    ("ACC-04", STACK, &["wrong-abort 1C32:01 0x08000022"], &[]),
    ("ACC-05", DRIVE, &["wrong-abort 1C12:00 0x08000022"], &[]),
    ("ACC-06", DRIVE, &["refuses-write 1C33:08 OP"], &[]),
    ("REF-01", STACK, &["accepts-value 1C32:01 0x7F"], &[]),
    ("REF-02", STACK, &["accepts-value 1C32:01 3"], &[]),
    ("REF-03", STACK, &["accepts-value 1C33:01 1"], &[]),
    ("REF-04", DRIVE, &["wrong-abort 1C32:08 0x06070012"], &[]),
    ("REF-05", DRIVE, &["accepts-value 1C12:01 0x2000"], &[]),
    ("REF-06", DRIVE, &["wrong-abort 1C12:01 0x06010003"], &[]),
    ("REF-07", DRIVE, &["accepts-value 1C12:00 5"], &[]),
    ("REF-08", DRIVE, &["wrong-abort 1C12:05 0x06090011"], &[]),
    ("MODE-01", DRIVE, &["refused-state PREOP"], &[]),
    ("MODE-02", DRIVE, &["refused-state SAFEOP"], &["AL-12", "REC-02"]),
    ("MODE-03", DRIVE, &["refused-state OP"], &["AL-17", "AL-18", "AL-19", "TIME-01"]),
    ("MODE-04", DRIVE, &["wrong-value 1C33:01 9"], &[]),
    ("MODE-05", DRIVE, &["wrong-value 1C33:02 5"], &[]),
    // Whatever ends in a clean run ends in this.
    (
        "MODE-06",
        DRIVE,
        &["wrong-value 1C33:0D 1"],
        &["CNT-07", "TIME-01", "REC-03", "REC-04", "REC-05"],
    ),
    ("MODE-07", STACK, &["ignores-sync-unit"], &[]),
    ("MODE-08", DRIVE, &["no-first-inputs"], &[]),
    ("MODE-09", DRIVE, &["refused-state INIT"], &[]),
    ("AL-01", DRIVE, &["accepts-setup 0x0016"], &[]),
    ("AL-02", DRIVE, &["wrong-al-code 0x0011 INIT"], &[]),
    ("AL-03", DRIVE, &["wrong-al-code 0x0012 PREOP"], &[]),
    ("AL-04", DRIVE, &["accepts-setup 0x001D"], &[]),
    ("AL-05", DRIVE, &["accepts-setup 0x001E"], &[]),
    ("AL-06", DRIVE, &["accepts-setup 0x0025"], &[]),
    ("AL-07", DRIVE, &["accepts-setup 0x0024"], &[]),
    ("AL-08", DRIVE, &["accepts-setup 0x0030 0x01"], &[]),
    ("AL-09", DRIVE, &["accepts-setup 0x0030 0x05"], &[]),
    ("AL-10", DRIVE, &["accepts-setup 0x0030 0x07"], &[]),
    ("AL-11", TERMINAL, &["accepts-setup 0x0030 0x03"], &[]),
    ("AL-12", DRIVE, &["accepts-setup 0x0036"], &[]),
    ("AL-13", WITH_SYNC1, &["accepts-setup 0x0030 0x07"], &[]),
    ("AL-14", STACK, &["accepts-setup 0x0030 0x00"], &[]),
    ("AL-15", STACK, &["accepts-setup 0x0029"], &[]),
    ("AL-16", DRIVE, &["accepts-setup 0x001F"], &[]),
    ("AL-17", DRIVE, &["wrong-al-code 0x002D SAFEOP"], &[]),
    ("AL-18", DRIVE, &["wrong-al-code 0x001B SAFEOP"], &[]),
    ("AL-19", DRIVE, &["wrong-al-code 0x001A SAFEOP"], &[]),
    ("AL-20", DRIVE, &["wrong-al-code 0x001B OP"], &[]),
    ("AL-21", DRIVE, &["wrong-al-code 0x001A OP"], &[]),
    ("AL-22", DRIVE, &["wrong-al-code 0x002C OP"], &[]),
    ("CNT-01", DRIVE, &["wrong-counter 1C32:0B 2"], &["CNT-07"]),
    ("CNT-02", STACK, &["wrong-limit 3"], &[]),
    ("CNT-03", DRIVE, &["wrong-counter 1C32:0C 1", "wrong-counter 1C33:0C 1"], &[]),
    ("CNT-04", DRIVE, &["frozen-counter 1C32:0D"], &[]),
    ("CNT-05", DRIVE, &["wrong-value 1C32:20 0"], &["CNT-07"]),
    ("CNT-06", DRIVE, &["ignores-reset"], &[]),
    ("CNT-07", DRIVE, &["frozen-counter 1C33:0C"], &[]),
    ("CNT-08", DRIVE, &["keeps-counters"], &[]),
    ("CNT-09", EVERY_MODE, &["wrong-value 1C32:10 5"], &[]),
    ("TIME-01", DRIVE, &["short-of-time 300us"], &[]),
    ("TIME-02", STACK, &["late-application 5us"], &[]),
    // So late that nothing with SYNC0 is where it should be either.
    ("TIME-03", DRIVE, &["late-application 260us"], &["TIME-01", "TIME-02", "TIME-05"]),
    // An event that waits for the copying hides the next one.
    ("TIME-04", DRIVE, &["late-copy 20us"], &["CNT-03"]),
    // A shift that is not done is never too short.
    ("TIME-05", DRIVE, &["ignores-shift"], &["CNT-04"]),
    ("TIME-06", DRIVE, &["slow-mailbox 1200ms"], &[]),
    ("TIME-07", EVERY_MODE, &["wrong-value 1C33:06 1"], &[]),
    ("REC-01", DRIVE, &["forgets-error"], &[]),
    ("REC-02", DRIVE, &["keeps-error 0x001D"], &[]),
    ("REC-03", DRIVE, &["keeps-error 0x001B"], &[]),
    ("REC-04", DRIVE, &["keeps-error 0x001A"], &[]),
    ("REC-05", DRIVE, &["keeps-error 0x002C"], &[]),
];

/// The name of a device in a segment file: a built-in profile, or a changed one that is written for
/// it.
fn device(name: &str) -> String {
    if name != WITH_SYNC1 {
        return name.to_owned();
    }
    let text = profile::built_in_text(DRIVE).expect("a profile");
    // Bit 3 of 0x1C32:04 and 0x1C33:04.
    let changed = text.replace("0x0427", "0x042F").replace("0x0027", "0x002F");
    assert_ne!(text, changed);
    let path = format!("{}/with_sync1.toml", env!("CARGO_TARGET_TMPDIR"));
    std::fs::write(&path, changed).expect("a writable folder");
    path
}

fn examine(name: &str, misbehave: &[&str]) -> DeviceReport {
    let faults: Vec<_> = misbehave.iter().map(|fault| format!("\"{fault}\"")).collect();
    let device = device(name);
    let text = format!("{}misbehave = [{}]\n", conform::segment_of(&device), faults.join(", "));
    let file = SegmentFile::parse("test.toml", &text).unwrap_or_else(|error| panic!("{error}"));
    let hints = Hints::of(&file.subdevices[0]).expect("known rules");
    let mut wire = VirtualWire::new(Scenario::from(file));
    conform::examine(&mut wire, 0, name, &hints, |_| true, |_| ()).expect("no trouble of ours")
}

/// The reports of all built-in devices, which several tests look at: each is examined once.
fn built_in() -> &'static BTreeMap<&'static str, DeviceReport> {
    static REPORTS: OnceLock<BTreeMap<&str, DeviceReport>> = OnceLock::new();
    REPORTS.get_or_init(|| {
        let reports = Mutex::new(BTreeMap::new());
        each(&profile::built_in_ids().collect::<Vec<_>>(), |id| {
            let report = examine(id, &[]);
            reports.lock().expect("no panic").insert(*id, report);
        });
        reports.into_inner().expect("no panic")
    })
}

fn with_verdict(report: &DeviceReport, verdict: Verdict) -> BTreeSet<&'static str> {
    let rules = report.rules.iter().filter(|rule| rule.verdict == verdict);
    rules.map(|rule| rule.id).collect()
}

/// Calls `job` for each item, on as many threads as there are processors.
fn each<T: Sync>(items: &[T], job: impl Fn(&T) + Sync) {
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
                    job(item);
                }
            });
        }
    });
}

#[test]
fn every_built_in_device_conforms() {
    assert_eq!(built_in().len(), profile::built_in_ids().count());
    for (id, report) in built_in() {
        let text = ConformanceReport::new(id, vec![report.clone()]).text();
        assert_eq!(report.failed, 0, "{text}");
        // Couplers have states and a clock, and nothing else to look at.
        let least = if id.starts_with("beckhoff_ek") { 8 } else { 10 };
        assert!(report.passed >= least, "{text}");
    }
}

/// Both ways: what is named must be there, and what is there must be named.
#[test]
fn a_known_deviation_is_told_apart_and_has_to_be_there() {
    let known = |id| with_verdict(&built_in()[id], Verdict::KnownDeviation);
    assert_eq!(known("yaskawa_sgd7s-a0"), BTreeSet::from(["OBJ-04", "OBJ-11"]));
    assert_eq!(known("rtlabs_soes_xmc4_dynpdo"), BTreeSet::from(["OBJ-03", "OBJ-10"]));
    assert_eq!(known(STACK), BTreeSet::new());

    let text = profile::built_in_text(TERMINAL).expect("a profile");
    let path = format!("{}/deviates.toml", env!("CARGO_TARGET_TMPDIR"));
    let named = "\n[[deviation]]\nrule = \"OBJ-01\"\nplaces = [\"1C00\"]\nwhy = \"a test\"\n";
    std::fs::write(&path, format!("{text}{named}")).expect("a writable folder");
    let report = examine(&path, &[]);
    assert_eq!(with_verdict(&report, Verdict::Fail), BTreeSet::from(["OBJ-01"]));
    let rule = report.rules.iter().find(|rule| rule.id == "OBJ-01").expect("tried");
    assert_eq!(rule.why, ["its profile names a deviation that is not there"]);
}

#[test]
fn a_deviation_names_a_rule_that_there_is() {
    let text = profile::built_in_text(TERMINAL).expect("a profile");
    let named = "\n[[deviation]]\nrule = \"OBJ-99\"\nplaces = [\"1C00\"]\nwhy = \"a test\"\n";
    let profile = profile::Profile::from_toml("some.toml", &format!("{text}{named}"));
    let mut file = SegmentFile::parse("a test", &conform::segment_of(TERMINAL)).expect("a segment");
    file.subdevices[0].profile = profile.expect("a profile");
    let error = Hints::of(&file.subdevices[0]).expect_err("refused").to_string();
    let line = text.lines().count() + 3;
    assert!(
        error.contains(&format!("some.toml:{line}:8"))
            && error.contains("unknown rule \"OBJ-99\"; expected a rule of isocat conform"),
        "{error}"
    );
}

#[test]
fn every_rule_is_tried_on_some_built_in_device() {
    let mut tried = BTreeSet::new();
    for report in built_in().values() {
        tried.extend(with_verdict(report, Verdict::Pass));
    }
    let all: BTreeSet<_> = rules::all().map(|rule| rule.id).collect();
    let left: Vec<_> = all.difference(&tried).collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn every_rule_has_a_device_that_breaks_it() {
    let broken: Vec<_> = BREAKERS.iter().map(|breaker| breaker.0).collect();
    let all: Vec<_> = rules::all().map(|rule| rule.id).collect();
    let of = |group: &str, ids: &[&'static str]| -> BTreeSet<&'static str> {
        ids.iter().copied().filter(|id| id.starts_with(group)).collect()
    };
    assert_eq!(of("", &broken), of("", &all), "each rule has a breaker, each breaker a rule");
    assert_eq!(broken.len(), all.len(), "one of each");
    let unique: BTreeSet<_> = all.iter().collect();
    assert_eq!(unique.len(), all.len(), "no rule stands twice");
}

#[test]
fn who_breaks_a_rule_fails_this_rule_and_no_other() {
    let wrong = Mutex::new(Vec::new());
    each(BREAKERS, |(rule, name, misbehave, follow)| {
        let report = examine(name, misbehave);
        let found = with_verdict(&report, Verdict::Fail);
        let expected: BTreeSet<_> = follow.iter().copied().chain([*rule]).collect();
        if found != expected {
            let text = format!(
                "{rule}, {name} with {misbehave:?}: expected {expected:?}, found {found:?}"
            );
            wrong.lock().expect("no panic").push(text);
        }
    });
    let mut wrong = wrong.into_inner().expect("no panic");
    wrong.sort();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn faults_of_the_field_are_seen() {
    let faults = [
        (["dead-sync0"], "MODE-03"),
        (["frozen-counter 1C32:0B"], "CNT-01"),
        (["missed-copy 100"], "MODE-06"),
        (["frozen-counter 1C33:0B"], "CNT-07"),
        (["wrong-counter 1C33:20 1"], "CNT-07"),
        (["wrong-counter 1C32:0D 200"], "CNT-04"),
        (["wrong-value 1C32:03 5"], "TIME-05"),
        // Beside what is known of it.
        (["read-only 1C32:03"], "OBJ-11"),
        (["missed-copy 7"], "MODE-06"),
        (["wrong-value 1C32:01 9"], "MODE-04"),
        (["late-application 5us"], "TIME-05"),
    ];
    each(&faults, |(misbehave, rule)| {
        let failed = with_verdict(&examine(DRIVE, misbehave), Verdict::Fail);
        assert!(failed.contains(rule), "{misbehave:?}: {failed:?}");
    });
}

#[test]
fn the_same_device_gives_the_same_report() {
    assert_eq!(examine(DRIVE, &["missed-copy 7"]), examine(DRIVE, &["missed-copy 7"]));
}

//! What becomes of a segment when a cable or a SubDevice goes for a time: what `plan --what-if`
//! says of known segments.

use std::path::Path;

use isocat::columns::plain;
use isocat::plan::what_if::{self, Case, Clocks, Fate, Gone, NotBack, Outcome, Settings};
use isocat::plan::{Plan, WhatIf};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_sim::fault::{Fault, Moment, Planned, When};
use isocat_wire::AlState;

const LINE: &str = "cycle = \"1ms\"\nrecovery = { first = \"20ms\", longest = \"100ms\" }\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis\"\ncount = 3\n";

/// Devices that act on the arrival of frames: nothing but the watchdog takes them out of OP.
const SIMPLE: &str = "cycle = \"1ms\"\nwatchdog = \"WATCHDOG\"\nrecovery = { first = \"20ms\", longest = \"100ms\" }\n\
    [[subdevice]]\ndevice = \"simple_io16\"\nname = \"near\"\n[[subdevice]]\ndevice = \"simple_io16\"\nname = \"far\"\n";

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("what_if.toml", text).unwrap_or_else(|e| panic!("{e}")))
}

fn of(text: &str, devices: &[usize], gone: Nanos) -> WhatIf {
    let scenario = scenario(text);
    let plan = Plan::of(&scenario).expect("a plan");
    let settings = Settings { gone, devices: devices.to_vec(), threads: 2 };
    what_if::what_if(&plan, &scenario, &settings, &mut |_| {})
}

fn case(found: &WhatIf, what: Gone, device: usize) -> &Case {
    let case = found.cases.iter().find(|case| case.what == what && case.device == device);
    case.expect("it was tried")
}

fn left_with(fate: &Fate) -> Option<(AlState, u16)> {
    (fate.outcome == Outcome::LeftOp).then_some((fate.state?, fate.code?))
}

fn outcomes(case: &Case) -> Vec<Outcome> {
    case.devices.iter().map(|fate| fate.outcome).collect()
}

/// Drives miss their frames at the next pulses and give up: the third SYNC0 without outputs. The
/// one in front of the cut goes on, and is not disturbed.
#[test]
fn those_behind_a_cut_leave_op_by_their_own_check() {
    let found = of(LINE, &[0, 1, 2], what_if::GONE);
    assert_eq!(found.cases.len(), 6);
    let cut = case(&found, Gone::Cable, 1);
    assert_eq!(cut.clocks, Clocks::Lead);
    assert_eq!(cut.devices[0].outcome, Outcome::InSync);
    assert_eq!((cut.devices[0].in_sync_ns, cut.devices[0].held_ns), (Some(0), None));
    assert!(cut.devices[0].sync0_worst_ns.is_some_and(|worst| worst < 200.0));
    for fate in &cut.devices[1..] {
        assert_eq!(left_with(fate), Some((AlState::SafeOp, 0x001A)));
        let after_ns = fate.after_ns.expect("it left");
        assert!((1_000_000..=3_000_000).contains(&after_ns), "{after_ns}");
        // The last frame came less than a cycle before the cut.
        let held = fate.held_ns.expect("it has outputs");
        assert!((after_ns..after_ns + 1_000_000).contains(&held), "{held} of {after_ns}");
        // A link takes 300 ms to come.
        assert!(fate.in_sync_ns.is_some_and(|ns| (300_000_000..3_000_000_000).contains(&ns)));
    }
    let slowest = cut.devices.iter().map(|fate| fate.in_sync_ns).max().flatten();
    assert_eq!(cut.in_sync_ns, slowest);
    let off = case(&found, Gone::Power, 1);
    assert_eq!(off.devices[0].outcome, Outcome::InSync);
    assert_eq!(off.devices[1].outcome, Outcome::WithoutPower);
    assert_eq!(left_with(&off.devices[2]), Some((AlState::SafeOp, 0x001A)));
    assert_eq!(case(&found, Gone::Cable, 2).devices[1].outcome, Outcome::InSync);
}

/// What a case says is what the run of a segment file with the same fault shows, of which the
/// course of the run tells.
#[test]
fn a_case_is_the_run_with_that_fault() {
    let found = of(LINE, &[2], what_if::GONE);
    let cut = case(&found, Gone::Cable, 2);
    let mut scenario = scenario(LINE);
    scenario.host.extremes = true;
    scenario.shift = Plan::of(&scenario).expect("a plan").timing().sync0;
    let before = Nanos(found.before_ns);
    let when = When::After(Moment::InOperation, before);
    let pull =
        Planned { lasts: Some(what_if::GONE), ..Planned::once(when, Fault::Pull { cable: 2 }) };
    scenario.faults.planned = vec![pull];
    scenario.duration = Nanos::millis(3_000);
    let outcome = scenario.run().execute(None::<isocat_engine::NoTap>, &mut |_| {});
    let course = outcome.world.course().expect("there are faults");
    let [stretch] = course.stretches() else { panic!("{:#?}", course.stretches()) };
    let back = course.began() + (before + what_if::GONE).into();
    assert_eq!(cut.devices[2].in_sync_ns, Some((stretch.to - back).0 / 1_000));
    assert_eq!(cut.devices[2].held_ns, Some(course.longest_stale(2).0 / 1_000));
}

/// Without frames for less than the watchdog a device stays in OP with the outputs that it has, for
/// longer it leaves. The link takes 300 ms to come; frames are missed from the last one before the
/// cut to the first one behind.
#[test]
fn both_sides_of_the_watchdog() {
    let gone = Nanos::millis(1);
    let far = |watchdog: &str| {
        let found = of(&SIMPLE.replace("WATCHDOG", watchdog), &[1], gone);
        case(&found, Gone::Cable, 1).devices[1].clone()
    };
    let long = far("2s");
    assert_eq!(long.outcome, Outcome::CutOff, "{long:#?}");
    let held = long.held_ns.expect("it stays in OP");
    assert!(held > 301_000_000, "{held}");
    // Watchdogs count in steps of 100 us.
    let step = 100_000;
    // `held` misses a few us at its ends, so that a watchdog just above it may still fire.
    let above = far(&format!("{}ns", (held + step / 10) / step * step + step));
    assert_eq!((above.outcome, above.held_ns), (Outcome::CutOff, Some(held)));
    let below = far(&format!("{}ns", held / step * step));
    assert_eq!(left_with(&below), Some((AlState::SafeOp, 0x001B)), "{below:#?}");
}

/// A device without a program stays in OP, and its watchdog makes its outputs safe all the same.
#[test]
fn the_watchdog_of_a_device_without_a_program_makes_its_outputs_safe() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let profile = include_str!("../../../segment/profiles/simple_io16.toml");
    let circuit = profile
        .replace("\"simple_io16\"", "\"circuit\"")
        .replace("[behaviour]", "[behaviour]\ndevice_emulation = true");
    std::fs::write(folder.join("circuit.toml"), circuit).expect("a folder for tests");
    let far = |watchdog: &str| {
        let text = SIMPLE.replace("WATCHDOG", watchdog);
        let text = text.replace(
            "device = \"simple_io16\"\nname = \"far\"",
            "device = \"circuit.toml\"\nname = \"far\"",
        );
        let file = SegmentFile::parse(&folder.join("w.toml").display().to_string(), &text);
        let scenario = Scenario::from(file.unwrap_or_else(|error| panic!("{error}")));
        let plan = Plan::of(&scenario).expect("a plan");
        let settings = Settings { gone: Nanos::millis(1), devices: vec![1], threads: 2 };
        let found = what_if::what_if(&plan, &scenario, &settings, &mut |_| {});
        case(&found, Gone::Cable, 1).devices[1].clone()
    };
    let held = far("2s");
    assert_eq!((held.outcome, held.made_safe), (Outcome::CutOff, false), "{held:#?}");
    assert!(held.held_ns.is_some_and(|held| held > 301_000_000), "{held:#?}");
    let safe = far("100ms");
    assert_eq!((safe.outcome, safe.made_safe), (Outcome::CutOff, true), "{safe:#?}");
    // From the frame itself, which restarts the watchdog with its last byte.
    let range = 99_900_000..100_100_000;
    assert!(safe.held_ns.is_some_and(|held| range.contains(&held)), "{safe:#?}");
}

/// A fork without a clock: the reference is the first of one branch, and when it goes another one
/// leads.
#[test]
fn another_clock_leads_while_the_reference_is_gone() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let profile = include_str!("../../../segment/profiles/simple_io16.toml");
    let without = profile
        .replace("\"simple_io16\"", "\"fork\"")
        .replace("sync_unit = true", "sync_unit = false");
    std::fs::write(folder.join("fork.toml"), without).expect("a folder for tests");
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"fork.toml\"\nname = \"fork\"\n\
        [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"left\"\nconnect = \"fork:1\"\n\
        [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"right\"\nconnect = \"fork:2\"\n";
    let path = folder.join("tree.toml");
    let file =
        SegmentFile::parse(path.to_str().expect("a name"), text).unwrap_or_else(|e| panic!("{e}"));
    let scenario = Scenario::from(file);
    let plan = Plan::of(&scenario).expect("a plan");
    let settings = Settings { gone: what_if::GONE, devices: vec![1, 2], threads: 1 };
    let found = what_if::what_if(&plan, &scenario, &settings, &mut |_| {});
    assert_eq!(found.reference, Some(1));
    for what in [Gone::Cable, Gone::Power] {
        let first = case(&found, what, 1);
        assert_eq!((first.clocks, first.leads), (Clocks::TakenOver, Some(2)));
        // The one that leads is on its own grid, not off that of a clock without power.
        assert_eq!(first.devices[2].outcome, Outcome::InSync, "{first:#?}");
        assert!(first.devices[2].sync0_worst_ns.is_some_and(|worst| worst < 200.0), "{first:#?}");
        assert!(first.in_sync_ns.is_some_and(|ns| ns > 0), "{first:#?}");
        let second = case(&found, what, 2);
        assert_eq!(second.clocks, Clocks::Lead);
        assert_eq!(second.devices[1].outcome, Outcome::InSync);
    }
}

/// With the cable at the MainDevice nothing answers: nothing is lost to it that could be taken up
/// again, and devices that have left OP are the business of `recovery`.
#[test]
fn who_is_not_brought_back_is_told_with_the_reason() {
    let with = of(LINE, &[0], what_if::GONE);
    let cut = case(&with, Gone::Cable, 0);
    assert_eq!(cut.clocks, Clocks::Lost);
    assert!(cut.in_sync_ns.is_some_and(|ns| ns > 0), "{cut:#?}");

    let off = LINE.replace("recovery", "#");
    let without = of(&off, &[0], what_if::GONE);
    let cut = case(&without, Gone::Cable, 0);
    assert_eq!(cut.in_sync_ns, None);
    assert!(cut.devices.iter().all(|fate| fate.not_back == Some(NotBack::RecoveryOff)), "{cut:#?}");
    assert!(with.recovers && !without.recovers);
    assert!(without.notes().len() == with.notes().len() + 1);
}

/// A coupler has no process data: nothing shows that it is cut off but that no frame comes back, or
/// that it is lost.
#[test]
fn a_coupler_is_cut_off_where_no_frame_comes_back() {
    let text = "cycle = \"1ms\"\nrecovery = \"once\"\n[[subdevice]]\ndevice = \"beckhoff_ek1100\"\n\
        name = \"coupler\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nconnect = \"coupler:2\"\n";
    let found = of(text, &[0, 1], what_if::GONE);
    assert_eq!(found.reference, Some(0));
    let cut = case(&found, Gone::Cable, 0);
    assert_eq!((cut.devices[0].outcome, cut.clocks), (Outcome::CutOff, Clocks::Lost), "{cut:#?}");
    assert!(cut.devices[0].in_sync_ns.is_some_and(|ns| ns > 0), "{cut:#?}");
    let behind = case(&found, Gone::Cable, 1);
    assert_eq!((behind.devices[0].outcome, behind.clocks), (Outcome::Idle, Clocks::Lead));
}

/// Less than the 15 us in which a link is noticed to be gone, and between two frames: no device
/// notices.
#[test]
fn a_cut_that_meets_no_frame_is_no_cut() {
    let found = of(LINE, &[2], Nanos::micros(1));
    let cut = case(&found, Gone::Cable, 2);
    assert_eq!(outcomes(cut), [Outcome::InSync; 3], "{cut:#?}");
    assert_eq!(cut.in_sync_ns, Some(0));
}

/// The number of threads changes nothing, nor do the faults that the file asks for.
#[test]
fn the_same_on_any_number_of_threads() {
    let faults = format!("{LINE}[[fault]]\nat = \"0s\"\nwhat = \"power-off 0\"\n");
    let of = |text: &str, threads| {
        let scenario = scenario(text);
        let plan = Plan::of(&scenario).expect("a plan");
        let settings = Settings { gone: Nanos::millis(50), devices: vec![2, 1], threads };
        let mut told = Vec::new();
        let found = what_if::what_if(&plan, &scenario, &settings, &mut |done| told.push(done));
        assert_eq!(told, [1, 2, 3, 4]);
        found
    };
    let one = of(LINE, 1);
    assert_eq!(one, of(&faults, 3));
    assert_eq!(one.cases.iter().map(|case| case.device).collect::<Vec<_>>(), [2, 2, 1, 1]);
}

/// A mode for which the segment never comes up is an error, and no table.
#[test]
fn a_segment_that_does_not_come_up_is_told() {
    let dead = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmisbehave = [\"dead-sync0\"]\n";
    let scenario = scenario(dead);
    let plan = Plan::of(&scenario).expect("a plan");
    let settings = Settings { gone: what_if::GONE, devices: vec![0], threads: 1 };
    let found = what_if::what_if(&plan, &scenario, &settings, &mut |_| {});
    assert!(found.failure.is_some() && found.cases.is_empty(), "{found:#?}");
    let sentence = found.failure.clone().unwrap_or_default();
    assert!(plain(&found.text()).contains(&sentence[..40]), "{sentence}");
}

/// The sample of docs/what-if.md is what the command prints of the file above it.
#[test]
fn the_sample_of_the_docs() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/what-if.md");
    let page = std::fs::read_to_string(&path).expect("docs/what-if.md is there");
    let block = |head: &str| {
        let (_, from) = page.split_once(head).expect("the page has it");
        from.split_once("\n```").expect("it ends").0.to_owned()
    };
    let text = plain(&of(&block("```toml\n"), &[0, 1, 2], what_if::GONE).text());
    let shown = block("```text\n");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, page.replace(&shown, text.trim())).expect("the page is writable");
        return;
    }
    assert_eq!(shown, text.trim(), "UPDATE_GOLDEN=1 rewrites it");
}

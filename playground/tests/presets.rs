//! Tests that each preset shows what it promises.

use std::collections::BTreeMap;

use isocat_playground::answer::{Answer, of};
use isocat_playground::presets::PRESETS;
use isocat_playground::run::run;
use isocat_playground::state::State;

fn texts(state: &str) -> BTreeMap<String, String> {
    let pairs = state.split('&').filter_map(|pair| pair.split_once('='));
    pairs.map(|(key, text)| (key.to_owned(), text.to_owned())).collect()
}

fn answer(state: &str) -> Answer {
    let answer = of(&texts(state));
    assert_eq!(answer.problems, [], "{state}");
    answer
}

fn state(id: &str) -> &'static str {
    PRESETS.iter().find(|preset| preset.id == id).expect("there is such a preset").state
}

fn preset(id: &str) -> Answer {
    answer(state(id))
}

fn pictures<'a>(answer: &'a Answer, place: &str) -> Vec<&'a str> {
    let at = answer.pictures.iter().filter(|picture| picture.place == place);
    at.map(|picture| picture.svg.as_str()).collect()
}

/// The ns of a time as the page writes it.
fn ns(text: &str) -> f64 {
    let (number, unit) = text.split_once(' ').expect("a number and a unit");
    let size = match unit {
        "ns" => 1.0,
        "us" => 1e3,
        "ms" => 1e6,
        other => panic!("{other}"),
    };
    number.parse::<f64>().expect("a number") * size
}

#[test]
fn all_have_pictures_and_a_verdict() {
    for preset in PRESETS {
        let answer = answer(preset.state);
        assert!(!answer.verdict.is_empty(), "{}", preset.id);
        assert!(!answer.pictures.is_empty(), "{}", preset.id);
        let bad = ["slack-1", "slack-jitter", "no-drift", "cut"].contains(&preset.id);
        assert_eq!(answer.good, !bad, "{}: {}", preset.id, answer.verdict);
        for picture in &answer.pictures {
            assert!(picture.svg.starts_with("<svg"), "{}", preset.id);
            assert!(!picture.svg.contains("NaN"), "{}: {}", preset.id, picture.place);
        }
    }
}

#[test]
fn slack_0_runs_clean_and_a_nanosecond_less_counts() {
    let clean = preset("slack-0");
    assert!(clean.verdict.starts_with("In sync: 2 of 2"), "{}", clean.verdict);
    assert_eq!(clean.devices[1].margin, "0 ns");
    assert!(!clean.devices[1].late);
    assert!(clean.devices.iter().all(|device| device.counters[0] == "0"));
    assert!(pictures(&clean, "counter").is_empty() && pictures(&clean, "miss").is_empty());

    let missed = preset("slack-1");
    assert!(!missed.good);
    let count = |position: usize| missed.devices[position].counters[0].parse().unwrap_or(0u32);
    assert_eq!(count(0), 0, "the first device has a cable's delay more");
    assert!(count(1) > 4, "{:?}", missed.devices[1].counters);
    assert_eq!(missed.devices[1].state, "SAFEOP+ERR");
    // The second device counts on the way up, and no other device does.
    let counter = pictures(&missed, "counter");
    assert!(counter[0].contains("device 1") && !counter[0].contains("device 0"), "{}", counter[0]);
    assert_eq!(pictures(&missed, "miss").len(), 1);
    // The two presets only differ by a nanosecond of copy time.
    let copy = |id: &str| texts(state(id))["copy-time"].clone();
    assert_eq!((copy("slack-0"), copy("slack-1")), ("292670ns".into(), "292671ns".into()));
}

#[test]
fn jitter_that_eats_the_slack_counts_now_and_then() {
    let answer = preset("slack-jitter");
    let early = answer.devices.iter().all(|device| device.late && device.counters[0] != "0");
    assert!(early, "{:?}", answer.devices);
    assert!(
        answer.findings.iter().any(|finding| finding.contains("times")),
        "{:?}",
        answer.findings
    );
    // The picture shows the value of the selected cycle.
    let value = |cycle: &str| {
        let mut of = texts(state("slack-jitter"));
        of.insert("at".into(), cycle.into());
        let answer = isocat_playground::answer::of(&of);
        let picture = pictures(&answer, "counter")[0].to_owned();
        let shown = picture.split("0x1C32:0B = ").nth(1).and_then(|rest| rest.split('<').next());
        shown.and_then(|shown| shown.parse::<u32>().ok()).expect("a value")
    };
    let values: Vec<u32> = (0..=290).step_by(5).map(|cycle| value(&cycle.to_string())).collect();
    assert_eq!((values.first(), values.last()), (Some(&0), Some(&6)), "{values:?}");
    assert!(values.iter().any(|value| (1..=5).contains(value)), "{values:?}");
}

#[test]
fn clocks_that_nobody_leads_run_apart() {
    let apart = preset("no-drift");
    // 60 ppm from the reference for 0.4 s, plus the difference from before.
    let worst = ns(&apart.devices[1].sync0);
    assert!((24_000.0..60_000.0).contains(&worst), "{worst}");
    assert!(apart.verdict.contains("off the grid"), "{}", apart.verdict);
    let led = preset("sync");
    assert!(led.devices.iter().all(|device| ns(&device.sync0) < 100.0), "{:?}", led.devices);
}

#[test]
fn in_sm_mode_outputs_have_the_jitter_of_the_host() {
    let spread =
        |id| preset(id).devices.iter().map(|device| ns(&device.outputs)).fold(0.0, f64::max);
    let (sm, dc) = (spread("sm-jitter"), spread("dc-jitter"));
    assert!((50_000.0..=201_000.0).contains(&sm), "{sm}");
    assert!(dc > 0.0 && dc < 100.0, "{dc}");
}

#[test]
fn the_way_up_is_looked_at_below_zero() {
    let answer = preset("sync");
    let [at, least, most] = answer.at;
    assert_eq!((at, most), (0, 299));
    assert!(least <= -50, "{least}");
    let mut of = texts(state("sync"));
    let far = |of: &BTreeMap<String, String>| {
        let answer = isocat_playground::answer::of(of);
        let picture = &answer.pictures[0];
        let end = picture.svg.split("data-to=\"").nth(1).and_then(|rest| rest.split('"').next());
        end.and_then(|end| end.parse::<f64>().ok()).expect("an axis")
    };
    // Offsets are good when they are written; then clocks run apart until drift frames lead them.
    let early = (least..-1).step_by(3).map(|at| {
        of.insert("at".into(), at.to_string());
        far(&of)
    });
    let early = early.fold(0.0, f64::max);
    of.insert("at".into(), "-1".into());
    let late = far(&of);
    assert!(early >= 2.0 * late, "clocks converge: from {early} to {late}");
}

#[test]
fn modes_are_those_of_their_names() {
    for (id, mode) in [
        ("sm-sync0", "dc-sync0"),
        ("sm-sync0-sync1", "dc-shift-sync1"),
        ("subordinated", "dc-subordinated"),
        ("free-run", "free-run"),
    ] {
        let answer = preset(id);
        assert_eq!(answer.devices[0].mode, mode);
        let sync1 = pictures(&answer, "cycle").iter().any(|picture| picture.contains("SYNC1"));
        assert_eq!(sync1, ["dc-shift-sync1", "dc-subordinated"].contains(&mode), "{id}");
    }
}

#[test]
fn what_the_plan_refuses_is_told_and_drawn() {
    let answer = answer("calc-copy=600us&cycle=500us");
    assert!(!answer.good);
    assert!(
        answer.verdict.contains("slack") || answer.verdict.contains("500 us"),
        "{}",
        answer.verdict
    );
}

/// The first device is not affected. Devices behind the cut leave OP, and are re-admitted when the
/// link returns.
#[test]
fn a_pulled_cable_is_seen_in_its_cycle() {
    let cut = preset("cut");
    assert!(!cut.good);
    let at: Vec<i64> = cut.faults.iter().map(|incident| incident.at).collect();
    assert_eq!(at, [50, 70], "{:?}", cut.faults);
    assert!(cut.faults[1].what.starts_with("70 ms: over: "), "{:?}", cut.faults);
    assert!(cut.devices.iter().all(|device| device.state == "OP"), "{:?}", cut.devices);
    assert!(cut.devices[0].counters[0] == "0", "{:?}", cut.devices[0]);
    let about = |position: usize| {
        let name = format!("SubDevice {position} (");
        cut.findings.iter().any(|finding| finding.starts_with(&name))
    };
    assert_eq!([0, 1, 2].map(about), [false, true, true], "{:#?}", cut.findings);
    // At the device behind the cut, outputs come, and no longer in the next cycle.
    let outputs = |cycle: &str, device: &str| {
        let mut of = texts(state("cut"));
        of.extend([("at".into(), cycle.into()), ("show".into(), device.into())]);
        pictures(&isocat_playground::answer::of(&of), "waves")[0].to_owned()
    };
    let seen = ["48", "52"].map(|cycle| outputs(cycle, "1").matches("SM2").count());
    assert!(seen[0] > seen[1], "{seen:?}");
}

/// A device that no frame reaches counts in the cycle in which it misses its outputs, not later
/// when a frame reaches it again.
#[test]
fn what_is_missed_behind_a_cut_is_counted_in_its_cycle() {
    let state = State::read(&texts(state("cut").replace("&at=52", "").as_str())).expect("a state");
    let ran = run(&state).expect("it runs");
    let first = ran.counters.iter().find(|(_, values)| values[1] > 0).expect("it counts");
    assert!((50_000_000_000..54_000_000_000).contains(&first.0.0), "{first:?}");
    assert!(ran.counters.is_sorted_by_key(|(at, _)| *at));
    assert!(ran.counters.iter().all(|(_, values)| values[0] == 0));
    assert_eq!(ran.counters.last().map(|(_, values)| values.clone()), Some(vec![0, 0, 0]));
}

/// The file on the page has the faults, and the command runs it with them.
#[test]
fn faults_and_recovery_stand_in_the_file() {
    for (recovery, written) in [("never", 0), ("once", 1), ("again", 1)] {
        let state =
            [("recovery", recovery), ("faults", "cycle 700: drop 5\n in-operation: sync-off 1 ")];
        let answer = of(&state.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect());
        let file = isocat::SegmentFile::parse("page.toml", &answer.file).expect("it is right");
        assert_eq!(file.faults.planned.len(), 2, "{}", answer.file);
        assert_eq!(answer.file.matches("\nrecovery = ").count(), written, "{}", answer.file);
    }
}

//! Tests "Synchronization in ten pictures": each picture of the documentation is a state of the
//! page, which is drawn and compared with the committed one. `UPDATE_GOLDEN=1 cargo test --test
//! pictures` in this folder writes the pictures, and the page of text with their figures.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use isocat::picture::{Picture, waves};
use isocat::quantity::time;
use isocat::timeline::Moment;
use isocat_playground::run::{self, Ran};
use isocat_playground::state::State;
use isocat_playground::{pictures, pulses};
use isocat_sim::observation::Observed;
use isocat_wire::time::Nanos;

/// A picture, and the state that makes it.
struct Shown {
    file: &'static str,
    state: &'static str,
    picture: Picture,
}

fn state(hash: &str) -> State {
    let pairs = hash.split('&').map(|pair| pair.split_once('=').expect("a key and its value"));
    let texts: BTreeMap<String, String> =
        pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
    State::read(&texts).unwrap_or_else(|problems| panic!("{hash}: {problems:?}"))
}

fn ran(hash: &str) -> Ran {
    run::run(&state(hash)).unwrap_or_else(|problems| panic!("{hash}: {problems:?}"))
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

fn golden(name: &str, text: &str) {
    let path = folder().join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("it can be made");
        std::fs::write(&path, text).expect("it can be written");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(text == committed, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
}

const FREE_RUN: &str = "mode=free-run&devices=1&cycles=200";
const SM: &str = "mode=sm&devices=1&host-jitter=200us";
const AT_ONCE: &str = "mode=dc-sync0&devices=4&cable=100m&host-jitter=20us";
const SYNC0: &str = "mode=dc-sync0&devices=1&calc-copy=60us";
const SYNC0_SYNC1: &str = "mode=dc-shift-sync1&devices=1&calc-copy=60us&sync1=250us";
const SYNC1: &str = "mode=dc-sync1&devices=1&calc-copy=60us";
const SUBORDINATED: &str = "mode=dc-subordinated&devices=1&sync0-cycle=250us";
const GENERATION: [(&str, &str); 4] = [
    ("08a-cyclic.svg", "view=pulses&pulse=100us"),
    ("08b-single-shot.svg", "view=pulses&pulse=100us&sync0-cycle=0ns"),
    ("08c-cyclic-acknowledge.svg", "view=pulses&pulse=0ns&acknowledge=300us"),
    ("08d-single-shot-acknowledge.svg", "view=pulses&pulse=0ns&sync0-cycle=0ns&acknowledge=700us"),
];
const WAY_UP: &str = "mode=dc-sync0&devices=2&clocks=50ppm";
const NOT_LED: &str = "mode=dc-sync0&devices=2&clocks=50ppm&drift-compensation=off&cycles=400";
const LATE: &str =
    "mode=dc-sync0&devices=2&phase=300us&copy-time=276us&force=on&host-jitter=40us&seed=3";

#[test]
fn ten_pictures_and_their_words() {
    let runs: BTreeMap<&str, Ran> =
        [FREE_RUN, SM, AT_ONCE, SYNC0, SYNC0_SYNC1, SYNC1, SUBORDINATED, WAY_UP, NOT_LED, LATE]
            .into_iter()
            .map(|hash| (hash, ran(hash)))
            .collect();
    let of = |hash: &str| &runs[hash];
    for hash in [FREE_RUN, SM, AT_ONCE, SYNC0, SYNC0_SYNC1, SYNC1, SUBORDINATED, WAY_UP] {
        assert!(of(hash).report.in_sync, "{hash}: {}", of(hash).report.verdict);
    }
    for hash in [NOT_LED, LATE] {
        assert!(!of(hash).report.in_sync, "{hash}: {}", of(hash).report.verdict);
    }
    let drawn = |hash| pictures::cycle(of(hash), 0).expect("it has a cycle");
    let mut all = vec![
        Shown {
            file: "01-free-run.svg",
            state: FREE_RUN,
            picture: pictures::waves(of(FREE_RUN), 0, 20),
        },
        Shown { file: "02-sm.svg", state: SM, picture: drawn(SM) },
        Shown {
            file: "03a-frames.svg",
            state: AT_ONCE,
            picture: one_cycle(of(AT_ONCE), Observed::Sm2, "SM2"),
        },
        Shown {
            file: "03b-at-once.svg",
            state: AT_ONCE,
            picture: one_cycle(of(AT_ONCE), Observed::Sync0, "SYNC0"),
        },
        Shown { file: "04-sm-sync0.svg", state: SYNC0, picture: drawn(SYNC0) },
        Shown { file: "05-sm-sync0-sync1.svg", state: SYNC0_SYNC1, picture: drawn(SYNC0_SYNC1) },
        Shown { file: "06-dc-sync1.svg", state: SYNC1, picture: drawn(SYNC1) },
        Shown { file: "07-subordinated.svg", state: SUBORDINATED, picture: drawn(SUBORDINATED) },
    ];
    for (file, hash) in GENERATION {
        all.push(Shown { file, state: hash, picture: pulses::generate(&state(hash)).draw() });
    }
    let clock = pictures::clock(of(WAY_UP), 1).expect("its clock is led");
    all.push(Shown { file: "09a-led.svg", state: WAY_UP, picture: clock });
    let away = pictures::sync0(of(NOT_LED), 1, Nanos::micros(1)).expect("it has SYNC0");
    all.push(Shown { file: "09b-not-led.svg", state: NOT_LED, picture: away });
    all.push(Shown {
        file: "10a-late.svg",
        state: LATE,
        picture: pictures::cycle(of(LATE), 1).expect("it has a cycle"),
    });
    let miss = pictures::first_miss(of(LATE), 1).expect("it misses");
    all.push(Shown { file: "10b-missed.svg", state: LATE, picture: miss });
    for Shown { file, picture, .. } in &all {
        golden(&format!("pictures/{file}"), &picture.file());
    }
    golden("pictures.md", &page(&all, &runs));
}

/// Draws when an event happens at each device in one cycle, with the whole cycle as the picture's
/// width.
fn one_cycle(ran: &Ran, which: Observed, name: &str) -> Picture {
    let cycle = ran.cycle.0 as f64;
    let of = |position: usize| {
        let of = ran.events.iter().filter(|(_, at, event)| *at == position && *event == which);
        of.map(|(at, ..)| at.0 as f64 / 1e3).collect::<Vec<f64>>()
    };
    let first = of(0).into_iter().find(|at| *at > 20.0 * cycle).expect("it runs so long");
    let signals: Vec<waves::Signal> = (0..ran.report.devices.len())
        .map(|position| {
            let near = |at: &f64| (at - first).abs() < cycle / 4.0;
            let at = of(position).into_iter().find(near).expect("it has one in each cycle") - first;
            let words = format!(
                "{} {} device 0",
                time(at.abs().round()),
                if at < 0.0 { "before" } else { "behind" }
            );
            waves::Signal {
                name: format!("{name} of device {position}"),
                high: false,
                // Only the edge is reported; it is drawn long enough to be visible.
                changes: vec![at, at + 300.0],
                events: if position > 0 { vec![(at, words)] } else { Vec::new() },
                distances: Vec::new(),
            }
        })
        .collect();
    let title = format!("{name} of four devices in one cycle");
    waves::draw(&format!("one-{name}"), &title, (-500.0, 4_500.0), &signals)
}

fn mean(ran: &Ran, position: usize, moment: Moment) -> Option<f64> {
    let cycle = ran.recorded.devices.get(position)?.cycle.as_ref()?;
    cycle.of(moment).map(|seen| seen.mean() / 1e3)
}

/// The terms of the manual's figure, what they are here, and what the run measured.
fn words(ran: &Ran) -> String {
    let seen = ran.recorded.devices[0].cycle.as_ref().expect("it has a cycle");
    let at =
        |moment| mean(ran, 0, moment).map_or("-".into(), |ns| format!("at {}", time(ns.round())));
    let took = |ps: f64| format!("takes {}", time((ps / 1e3).round()));
    let between = |from, to| match (mean(ran, 0, from), mean(ran, 0, to)) {
        (Some(from), Some(to)) => time((to - from).round()),
        _ => "-".into(),
    };
    let pulses: Vec<f64> = ran
        .events
        .iter()
        .filter(|(_, device, event)| *device == 0 && *event == Observed::Sync0)
        .map(|(at, ..)| at.0 as f64 / 1e3)
        .collect();
    let cycle = (pulses[pulses.len() - 1] - pulses[0]) / (pulses.len() - 1) as f64;
    let latch = if mean(ran, 0, Moment::Sync1).is_some() { Moment::Sync1 } else { Moment::Sync0 };
    let rows = [
        ("SM2 Event", "outputs are stored in SM2", at(Moment::Sm2)),
        (
            "PDO_OutputMapping(), Calc and Copy Time (0x1C32.6)",
            "outputs are fetched, copied and calculated",
            took(seen.outputs_took.mean()),
        ),
        ("Sync0", "the pulse at which outputs act", at(Moment::Sync0)),
        ("Sync1", "the pulse at which inputs are taken", at(Moment::Sync1)),
        (
            "ECAT_Application()",
            "the application",
            format!("from {} on", at(Moment::ApplicationBegins).trim_start_matches("at ")),
        ),
        (
            "Outputs valid, Delay Time (0x1C32.9)",
            "from the pulse to Outputs Valid",
            format!("{} behind SYNC0", between(Moment::Sync0, Moment::OutputsValid)),
        ),
        (
            "Start Input Latch",
            "the pulse that starts the latch",
            format!("{}, {}", if latch == Moment::Sync1 { "SYNC1" } else { "SYNC0" }, at(latch)),
        ),
        (
            "Inputs latch, Delay Time (0x1C33.9)",
            "from there to Input Latch",
            format!(
                "{} behind {}",
                between(latch, Moment::InputLatch),
                if latch == Moment::Sync1 { "SYNC1" } else { "SYNC0" }
            ),
        ),
        (
            "PDO_InputMapping(), Calc and Copy Time (0x1C33.6)",
            "inputs are copied into SM3",
            took(seen.inputs_took.mean()),
        ),
        (
            "Cycle Time (0x1C32.2/0x1C33.2)",
            "from SYNC0 to SYNC0",
            format!(
                "{} of true time: its clock is {:+.0} ppm fast",
                time(cycle.round()),
                (1e6 / cycle - 1.0) * 1e6
            ),
        ),
    ];
    let mut text =
        String::from("| in the manual's figure | what it is | in this run |\n|---|---|---|\n");
    for (word, what, figure) in rows.iter().filter(|(_, _, figure)| figure != "-") {
        let _ = writeln!(text, "| {word} | {what} | {figure} |");
    }
    text
}

fn page(all: &[Shown], runs: &BTreeMap<&str, Ran>) -> String {
    let show = |file: &str| {
        let shown = all.iter().find(|shown| shown.file == file).expect("it was drawn");
        format!(
            "![{}](pictures/{file})\n\n[Play with it](../playground/index.html#{}): `#{}`\n",
            shown.picture.title, shown.state, shown.state
        )
    };
    let spread = |hash: &str, moment| {
        let seen =
            runs[hash].recorded.devices[0].cycle.as_ref().and_then(|c| c.of(moment).copied());
        seen.map_or("-".into(), |seen| time(((seen.largest() - seen.least()) as f64 / 1e3).round()))
    };
    let sync0 = |hash: &str, position: usize| {
        let error = runs[hash].report.devices[position].true_time.sync0_error;
        error.map_or("-".into(), |error| time(error.worst_ns.round()))
    };
    let missed = runs[LATE].recorded.devices[1].missed_count;
    let left = runs[LATE].recorded.devices[1]
        .cycle
        .as_ref()
        .map_or(0.0, |c| c.outputs_left.least() as f64 / 1e3);
    let at_once = (1..4).filter_map(|at| runs[AT_ONCE].report.devices[at].true_time.sync0_error);
    let at_once = at_once.map(|error| error.worst_ns).fold(0.0, f64::max);
    let last_sm2 = mean(&runs[AT_ONCE], 3, Moment::Sm2).unwrap_or_default()
        - mean(&runs[AT_ONCE], 0, Moment::Sm2).unwrap_or_default();
    format!(
        include_str!("pictures.md"),
        free_run = show("01-free-run.svg"),
        sm = show("02-sm.svg"),
        sm_spread = spread(SM, Moment::OutputsValid),
        frames = show("03a-frames.svg"),
        at_once = show("03b-at-once.svg"),
        at_once_frames = time(last_sm2.round()),
        at_once_error = time(at_once.round()),
        sync0 = show("04-sm-sync0.svg"),
        sync0_words = words(&runs[SYNC0]),
        sync0_frames = spread(SYNC0, Moment::Sm2),
        sync0_valid = spread(SYNC0, Moment::OutputsValid),
        sync0_sync1 = show("05-sm-sync0-sync1.svg"),
        sync0_sync1_words = words(&runs[SYNC0_SYNC1]),
        sync1 = show("06-dc-sync1.svg"),
        subordinated = show("07-subordinated.svg"),
        cyclic = show("08a-cyclic.svg"),
        single = show("08b-single-shot.svg"),
        cyclic_acknowledge = show("08c-cyclic-acknowledge.svg"),
        single_acknowledge = show("08d-single-shot-acknowledge.svg"),
        led = show("09a-led.svg"),
        led_error = sync0(WAY_UP, 1),
        not_led = show("09b-not-led.svg"),
        not_led_error = sync0(NOT_LED, 1),
        late = show("10a-late.svg"),
        missed_picture = show("10b-missed.svg"),
        late_missed = missed,
        late_left = time(left),
    )
}

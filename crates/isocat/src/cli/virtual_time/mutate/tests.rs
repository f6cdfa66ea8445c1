//! What a mutation does to a frame, and what counts as an effect.

use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::{Command, StationAddress};
use serde_json::{Value, json};

use super::class::{Class, Classes, Shown};
use super::effect::{Effect, Figures};
use super::mutant::{Change, Mutant, Mutation};

const DELAY: Address = Address::Station(StationAddress(0x1001), 0x0928);
const WKC: u16 = 1;

/// A frame with a read of AL status and a write of a delay.
fn frame() -> Vec<u8> {
    let mut bytes = vec![0; 128];
    let mut writer = FrameWriter::new(&mut bytes, [1; 6]);
    let state = Address::Station(StationAddress(0x1001), 0x0130);
    writer.push(Command::Fprd, 7, state, &[0; 2]).expect("it is short");
    writer.push(Command::Fpwr, 7, DELAY, &[10, 0, 0, 0]).expect("it is short");
    let len = writer.finish();
    bytes.truncate(len);
    bytes
}

/// Command, address, data and working counter of each datagram.
fn told(frame: &[u8]) -> Vec<(u8, u32, Vec<u8>, u16)> {
    let all = datagrams(frame::payload(frame).expect("a frame")).map(|one| one.expect("whole"));
    all.map(|one| (one.header.command, one.header.address, one.data.to_vec(), one.wkc)).collect()
}

/// What one frame after the other looks like at the segment, with what is sent behind each, and
/// what the program gets back if nobody answers.
fn through(change: Change, after: u64, always: bool, frames: usize) -> [Vec<Vec<u8>>; 2] {
    let class = class();
    let mut mutation = Mutation::new(Mutant { class, change, after, always, wkc: WKC });
    let (mut sent, mut back) = (Vec::new(), Vec::new());
    for _ in 0..frames {
        let mut bytes = frame();
        let behind = mutation.out(&mut bytes, false);
        sent.push(bytes.clone());
        sent.extend(behind);
        mutation.back(&mut bytes);
        back.push(bytes);
    }
    [sent, back]
}

fn class() -> Class {
    let mut classes = Classes::default();
    classes.take(&frame(), &frame(), false);
    let [(class, Shown { count: 1, .. })] = classes.list()[..] else {
        panic!("a read changes nothing: {classes:?}")
    };
    class
}

#[test]
fn a_datagram_that_is_left_out_comes_back_as_if_it_had_been_taken() {
    let [sent, back] = through(Change::LeftOut, 0, false, 2);
    assert_eq!(told(&sent[0])[1].0, 0, "a NOP");
    assert_eq!(told(&sent[1]), told(&frame()), "once");
    let mut taken = told(&frame());
    taken[1].3 = WKC;
    assert_eq!(told(&back[0]), taken);
    let [sent, _] = through(Change::LeftOut, 1, false, 3);
    let left_out: Vec<bool> = sent.iter().map(|one| told(one)[1].0 == 0).collect();
    assert_eq!(left_out, [false, true, false]);
    let [sent, _] = through(Change::LeftOut, 0, true, 2);
    assert!(sent.iter().all(|one| told(one)[1].0 == 0));
}

#[test]
fn a_datagram_comes_twice_or_later_in_a_frame_of_its_own() {
    let alone = told(&frame())[1..].to_vec();
    let [sent, back] = through(Change::Twice, 0, false, 2);
    let all: Vec<_> = sent.iter().map(|one| told(one)).collect();
    assert_eq!(all, [told(&frame()), alone.clone(), told(&frame())]);
    assert_eq!(back[0], frame());
    let [sent, back] = through(Change::Later, 0, false, 2);
    assert_eq!((told(&sent[0])[1].0, told(&sent[1]), told(&sent[2])), (0, told(&frame()), alone));
    assert_eq!(told(&back[0])[1].3, WKC);
}

#[test]
fn what_it_says_is_otherwise_at_the_segment_alone() {
    for (change, address, data) in [
        (Change::Address(1), 0x0929_1001_u32, [10, 0, 0, 0]),
        (Change::Address(-1), 0x0927_1001, [10, 0, 0, 0]),
        (Change::Neighbour(1), 0x0928_1002, [10, 0, 0, 0]),
        (Change::Value(-1), 0x0928_1001, [9, 0, 0, 0]),
        (Change::Zero, 0x0928_1001, [0; 4]),
        (Change::Bit(0), 0x0928_1001, [11, 0, 0, 0]),
        (Change::Bit(31), 0x0928_1001, [10, 0, 0, 0x80]),
    ] {
        let [sent, back] = through(change, 0, true, 1);
        let (_, found, bytes, _) = told(&sent[0])[1].clone();
        assert_eq!((found, &bytes[..]), (address, &data[..]), "{change:?}");
        assert_eq!(back[0], frame(), "{change:?}");
    }
}

#[test]
fn all_bits_of_what_is_written_are_turned_over_once() {
    let mutants = |count| Mutant::all_of(class(), Shown { count, wkc: WKC });
    let bits = mutants(1).filter(|one| matches!(one.change, Change::Bit(_))).count();
    assert_eq!(bits, 32);
    // What comes once is not changed each time besides, and what comes often also in the middle.
    assert_eq!(
        (mutants(2).count(), mutants(9).count()),
        (2 * mutants(1).count(), 3 * mutants(1).count())
    );
    assert!(mutants(9).any(|one| one.after == 4 && !one.always));
}

/// A report of a run of two drives that are in sync.
fn report() -> Value {
    let span = |least: i64, mean: i64, most: i64| json!({"min_ns": least, "mean_ns": mean, "max_ns": most});
    let device = json!({
        "state": "OP", "mode": "dc-sync0", "guarded": true, "sync0_cycle_ns": 1_000_000,
        "sync0_error": {"worst_ns": 90}, "sync0_margin": span(300_000, 310_000, 320_000),
        "outputs_age": span(500_000, 510_000, 520_000), "inputs_age": span(400_000, 410_000, 420_000),
        "sm_event_missed": 0, "cycle_time_too_small": 0, "shift_time_too_short": 0,
        "output_bits": [[0, 64]], "input_bits": [[64, 128]], "kinds": [],
    });
    let mut other = device.clone();
    (other["output_bits"], other["input_bits"]) = (json!([[128, 192]]), json!([[192, 256]]));
    json!({"sessions": [{
        "cycle": {"phase": span(0, 5_000, 10_000), "longest_drift_gap_ns": 1_100_000},
        "judged": {"judged_ns": 1_000_000_000, "devices": [device, other]},
    }]})
}

/// The effects where one figure is another one.
fn effects(path: &str, value: Value) -> Vec<Effect> {
    let good = report();
    let mut changed = good.clone();
    *changed.pointer_mut(&format!("/sessions/0/{path}")).expect(path) = value;
    Figures::of(&changed).against(&Figures::of(&good), 1e6, 1e3)
}

#[test]
fn each_effect_alone_is_seen_and_less_than_it_is_not() {
    let none = effects("judged/judged_ns", json!(500_000_000));
    assert_eq!(none, []);
    let of = |at| format!("judged/devices/1/{at}");
    for (path, without, with, word) in [
        (of("state"), json!("OP"), json!("SAFEOP"), "state"),
        (of("mode"), json!("dc-sync0"), json!("sm"), "mode"),
        (of("guarded"), json!(true), json!(false), "not guarded"),
        (of("sync0_cycle_ns"), json!(1_000_000), json!(1_000_001), "cycle of SYNC0"),
        (of("sync0_error"), json!({"worst_ns": 1_000}), json!({"worst_ns": 1_001}), "SYNC0 off"),
        (of("sync0_error"), json!({"worst_ns": 1_000}), Value::Null, "no SYNC0"),
        (of("sync0_margin/min_ns"), json!(1), json!(0), "SYNC0 before outputs"),
        (of("sync0_margin/mean_ns"), json!(311_000), json!(311_001), "SYNC0 apart"),
        (of("outputs_age/mean_ns"), json!(760_000), json!(760_001), "outputs"),
        (of("inputs_age/max_ns"), json!(920_000), json!(920_001), "inputs"),
        (of("sm_event_missed"), json!(0), json!(1), "missed events"),
        (
            of("output_bits"),
            json!([[192, 256]]),
            json!([[127, 191], [63, 64]]),
            "logical bits of another one",
        ),
        (
            of("kinds"),
            json!([{"kind": "other-mode"}]),
            json!([{"kind": "missed-events"}]),
            "found by the judges",
        ),
    ] {
        assert_eq!(effects(&path, without), [], "{path}");
        let found = effects(&path, with);
        assert!(found.contains(&(word, Some(1))), "{path}: {found:?}");
    }
    for (path, without, with, word) in [
        ("judged/judged_ns", 500_000_000, 499_999_999, "shorter operation"),
        ("cycle/phase/max_ns", 40_000, 40_001, "frames wander"),
        ("cycle/longest_drift_gap_ns", 100_000_000, 100_000_001, "no reference time"),
    ] {
        assert_eq!(effects(path, json!(without)), [], "{path}");
        assert_eq!(effects(path, json!(with)), [(word, None)], "{path}");
    }
    let at_the_edge = |ns: i64| {
        let mut changed = report();
        changed["sessions"][0]["judged"]["devices"][1]["sync0_error"]["worst_ns"] = json!(ns);
        Figures::of(&changed).is_at_the_edge(&Figures::of(&report()), 1e3)
    };
    assert_eq!([799, 800, 1_249, 1_250].map(at_the_edge), [false, true, true, false]);
    assert_eq!(effects("judged", Value::Null), [("never in operation", None)]);
    // A phase that moves by more than a quarter of the cycle at both.
    let good = report();
    let mut moved = good.clone();
    for at in 0..2 {
        moved["sessions"][0]["judged"]["devices"][at]["sync0_margin"]["mean_ns"] = json!(560_001);
    }
    let found = Figures::of(&moved).against(&Figures::of(&good), 1e6, 1e3);
    assert_eq!(found, [("phase", Some(0)), ("phase", Some(1))]);
}

//! Tests the four modes of SYNC signal generation, by pulse length and cycle.

use std::collections::BTreeMap;

use isocat_playground::pulses::{Generated, generate};
use isocat_playground::state::State;

fn of(state: &str) -> Generated {
    let pairs = state.split('&').filter_map(|pair| pair.split_once('='));
    let texts: BTreeMap<_, _> = pairs.map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
    generate(&State::read(&texts).expect("the state is right"))
}

/// Changes of a signal, relative to the start time.
fn changes(generated: &Generated, which: usize) -> Vec<u64> {
    generated.changes[which].iter().map(|at| at - generated.start).collect()
}

#[test]
fn cyclic() {
    let generated = of("pulse=100us&cycle=1ms&sync1=250us");
    assert_eq!(generated.kind, "cyclic");
    let of_each = |from: u64| {
        (0..6).flat_map(move |k| [k * 1_000_000 + from, k * 1_000_000 + from + 100_000])
    };
    assert_eq!(changes(&generated, 0), of_each(0).collect::<Vec<_>>());
    assert_eq!(changes(&generated, 1), of_each(250_000).collect::<Vec<_>>());
    let picture = generated.draw().svg();
    for words in [
        "activation 0x0981",
        "start 0x0990",
        "pulse 0x0982 100 us",
        "cycle 0x09A0 1 ms",
        "0x09A4 250 us",
    ] {
        assert!(picture.contains(words), "{words}");
    }
}

#[test]
fn single_shot() {
    let generated = of("pulse=50us&sync0-cycle=0ns&sync1=250us");
    assert_eq!(generated.kind, "single shot");
    assert_eq!(changes(&generated, 0), [0, 50_000]);
    assert_eq!(changes(&generated, 1), [250_000, 300_000]);
}

#[test]
fn cyclic_acknowledge() {
    let generated = of("pulse=0ns&acknowledge=300us");
    assert_eq!(generated.kind, "cyclic acknowledge");
    let expected: Vec<u64> =
        (0..6).flat_map(|k| [k * 1_000_000, k * 1_000_000 + 300_000]).collect();
    assert_eq!(changes(&generated, 0), expected);
    assert_eq!(generated.acknowledged[0].len(), 6);
    // Acknowledged after more than a cycle, every other pulse makes no edge.
    let late = of("pulse=0ns&acknowledge=1500us");
    assert_eq!(changes(&late, 0)[..4], [0, 1_500_000, 2_000_000, 3_500_000]);
    let never = of("pulse=0ns");
    assert_eq!(changes(&never, 0), [0], "it stays active");
    assert!(never.verdict().contains("nobody reads 0x098E"), "{}", never.verdict());
}

#[test]
fn single_shot_acknowledge() {
    let generated = of("pulse=0ns&sync0-cycle=0ns&acknowledge=700us");
    assert_eq!(generated.kind, "single shot acknowledge");
    assert_eq!(changes(&generated, 0), [0, 700_000]);
}

#[test]
fn a_pulse_longer_than_the_cycle_never_ends() {
    let generated = of("pulse=600us&sync0-cycle=500us");
    assert_eq!(changes(&generated, 0), [0]);
    assert_eq!(generated.edges[0].len(), 1);
}

#[test]
fn sync1_behind_more_than_a_cycle_comes_less_often() {
    let generated = of("pulse=100us&cycle=1ms&sync1=1250us");
    let rises: Vec<u64> = changes(&generated, 1).iter().step_by(2).copied().collect();
    assert_eq!(rises[..3], [1_250_000, 3_250_000, 5_250_000]);
}

//! SYNC0 and SYNC1 of a follower in true time, against the closed form: pulse k is due when the
//! reference's system time is start + k T0.
//!
//! An edge's error has two parts. *Generation jitter*: an edge comes at the first tick at which the
//! follower's own system time has reached the target, 0 to 10 ns after it. *Loop residual*: the
//! difference of that system time from the reference's. They are measured separately, and the error
//! is their difference.

use isocat_esc::{Chip, EscEvent, IP_CORE_32, LAN9252};
use isocat_wire::dc::{ActivationStatus, AssignActivate, SyncActivation};
use isocat_wire::register;

use super::pair::{EPOCH, Edge, Pair};

/// SYNC0 cycle, ns.
const T0: u64 = 1_000_000;
/// The follower is 87 ppm faster than the reference, and neither of them is exact.
const PPB: (i64, i64) = (-13_000, 73_999);
/// Largest loop residual after the start-up, ps.
const RESIDUAL: i64 = 12_000;
/// SYNC1 cycle times, in quarters of T0.
const D1: [u64; 5] = [0, 1, 4, 5, 8];
/// Ticks of a pulse: 100 us; and acknowledge mode.
const PULSES: [u16; 2] = [10_000, 0];

/// A pair with a locked follower, as after a MainDevice's start-up of 20000 frames.
fn locked(chip: &'static Chip, local: u64, pulse: u16) -> Pair {
    let mut pair = Pair::new(chip, PPB, local, pulse);
    pair.set_offset();
    pair.set_loop(0x1000, (4, 6));
    for _ in 0..20_000 {
        pair.distribute(60_000);
    }
    pair
}

/// Activates SYNC0 and SYNC1 at a whole ms plus `odd` ns; returns the start time.
fn activate(pair: &mut Pair, cycle: u64, d1: u64, odd: u64) -> u64 {
    let now = pair.reference.clock.read::<isocat_wire::time::Device>(pair.now).count() + EPOCH;
    let start = (now / T0 + 3) * T0 + odd;
    let wide = pair.follower.esc.chip().counts_64_bit();
    pair.write(1, register::SYNC_ACTIVATION, SyncActivation(0));
    pair.write(1, register::SYNC0_CYCLE, cycle as u32);
    pair.write(1, register::SYNC1_CYCLE, d1 as u32);
    pair.write(1, register::SYNC_START_TIME, if wide { start } else { start & 0xFFFF_FFFF });
    let activation = AssignActivate::SYNC0_AND_SYNC1.activation();
    pair.write(1, register::SYNC_ACTIVATION, activation);
    assert_eq!(pair.read(1, register::ACTIVATION_STATUS), ActivationStatus(3), "both pending");
    start
}

/// Statistics of the edges.
#[derive(Debug)]
struct Found {
    /// Edges by generation jitter, 0 to 10 ns.
    jitter: [usize; 11],
    /// Least and largest loop residual, ps.
    residual: (i64, i64),
    /// Least and largest error in true time, ps.
    error: (i64, i64),
}

impl Found {
    const NOTHING: Self =
        Self { jitter: [0; 11], residual: (i64::MAX, i64::MIN), error: (i64::MAX, i64::MIN) };

    fn edge(&mut self, pair: &Pair, edge: &Edge, target: u64) {
        let wide = pair.follower.esc.chip().counts_64_bit();
        let beyond = edge.system.wrapping_sub(target);
        let beyond = if wide { beyond as i64 } else { i64::from(beyond as u32 as i32) };
        assert!((0..=10).contains(&beyond), "{edge:?}: {beyond} ns beyond {target}");
        self.jitter[beyond as usize] += 1;
        let error = (edge.at - pair.due(target)).0;
        widen(&mut self.error, error);
        widen(&mut self.residual, beyond * 1_000 - error);
    }

    fn edges(&self) -> usize {
        self.jitter.iter().sum()
    }

    /// Checks the limits on both sides: neither too bad nor too good.
    fn check(&self, what: &str) {
        let (least, most) = self.residual;
        assert!(-RESIDUAL < least && most < RESIDUAL, "{what}: the loop's residual, {self:?}");
        assert!(most - least > 1_000, "{what}: a loop without any residual, {self:?}");
        let used = self.jitter.iter().filter(|count| **count > 0).count();
        assert!((8..=11).contains(&used), "{what}: generation jitter, {self:?}");
        let (least, most) = self.error;
        assert!(-RESIDUAL < least && most < 10_000 + RESIDUAL, "{what}: in true time, {self:?}");
        assert!(most - least > 8_000, "{what}: edges off the 10 ns grid, {self:?}");
    }
}

fn widen(range: &mut (i64, i64), value: i64) {
    *range = (range.0.min(value), range.1.max(value));
}

/// The edges of one output.
fn of(edges: &[Edge], event: EscEvent) -> Vec<Edge> {
    edges.iter().filter(|edge| edge.event == event).copied().collect()
}

/// Compares a train of pulses with start + first + k period, from the first pulse to the last
/// before now.
fn compare(pair: &Pair, found: &mut Found, edges: &[Edge], first: u64, period: u64) {
    for (edge, k) in edges.iter().zip(0u64..) {
        found.edge(pair, edge, first + k * period);
    }
    let next = first + edges.len() as u64 * period;
    assert!(pair.due(next) + isocat_wire::Picos(100_000) > pair.now, "the pulse at {next} is lost");
}

/// Tests the cyclic mode, and cyclic acknowledge.
#[test]
fn cyclic_modes_keep_the_closed_form() {
    for pulse in PULSES {
        let mut pair = locked(&LAN9252, 1_000_000_000, pulse);
        for quarters in D1 {
            let d1 = quarters * T0 / 4;
            let start = activate(&mut pair, T0, d1, 0);
            pair.edges.clear();
            for _ in 0..500 {
                pair.distribute(T0);
            }
            let mut found = Found::NOTHING;
            compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync0), start, T0);
            let sync0 = found.edges();
            assert!((490..=500).contains(&sync0), "{sync0} SYNC0");
            let period = (d1 / T0 + 1) * T0;
            compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync1), start + d1, period);
            let sync1 = found.edges() - sync0;
            let expected = 500 * T0 / period;
            assert!((expected - 10..=expected).contains(&(sync1 as u64)), "{sync1} SYNC1");
            found.check(&std::format!("pulse {pulse}, D1 {quarters}/4 T0"));
            println!("cyclic, pulse {pulse} ticks, D1 {quarters}/4 T0: {found:?}");
            assert_eq!(pair.read(1, register::ACTIVATION_STATUS), ActivationStatus(0));
        }
    }
}

/// Tests single shot, and single shot acknowledge: one pulse each, however long the wait.
#[test]
fn single_shots_keep_the_closed_form() {
    for pulse in PULSES {
        let mut pair = locked(&LAN9252, 1_000_000_000, pulse);
        for quarters in D1 {
            let d1 = quarters * T0 / 4;
            let mut found = Found::NOTHING;
            for shot in 0..60 {
                let start = activate(&mut pair, 0, d1, shot * 12_347);
                pair.edges.clear();
                for _ in 0..8 {
                    pair.distribute(T0);
                }
                let (sync0, sync1) =
                    (of(&pair.edges, EscEvent::Sync0), of(&pair.edges, EscEvent::Sync1));
                assert_eq!((sync0.len(), sync1.len()), (1, 1), "shot {shot}");
                found.edge(&pair, &sync0[0], start);
                found.edge(&pair, &sync1[0], start + d1);
            }
            found.check(&std::format!("pulse {pulse}, D1 {quarters}/4 T0"));
            println!("single shot, pulse {pulse} ticks, D1 {quarters}/4 T0: {found:?}");
        }
    }
}

/// The generation jitter alone is within 12 ns peak to peak, and spread over this range.
#[test]
fn generation_jitter_fills_its_bound_and_no_more() {
    let mut pair = locked(&LAN9252, 1_000_000_000, 100);
    let start = activate(&mut pair, T0, 0, 0);
    pair.edges.clear();
    for _ in 0..20_000 {
        pair.distribute(T0);
    }
    let mut found = Found::NOTHING;
    compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync0), start, T0);
    found.check("20 s");
    println!("generation jitter: {found:?}");
    // There are ten equally probable values, and an eleventh from ticks of 11 ns.
    let edges = found.edges();
    for (ns, count) in found.jitter[..10].iter().enumerate() {
        let share = 1_000 * count / edges;
        assert!((50..=200).contains(&share), "{ns} ns: {share} per mille, {found:?}");
    }
    assert!(found.jitter[10] < edges / 100, "{found:?}");
}

/// Without the loop the same clock leaves the bound within a cycle or two.
#[test]
fn an_unlocked_clock_leaves_the_bound() {
    let mut pair = Pair::new(&LAN9252, PPB, 1_000_000_000, 100);
    pair.set_offset();
    let start = activate(&mut pair, T0, 0, 0);
    pair.run(100 * T0);
    let edges = of(&pair.edges, EscEvent::Sync0);
    let error = |k: usize| (edges[k].at - pair.due(start + k as u64 * T0)).0;
    let drift = (error(90) - error(0)) / 90;
    assert!((-87_200..=-86_800).contains(&drift), "{drift} ps a cycle are 87 ppm");
}

/// Local and system time of a 32-bit ESC wrap every 4.29 s, at different instants; SYNC continues.
#[test]
fn the_wrap_of_32_bits_neither_loses_nor_doubles_a_pulse() {
    let mut pair = locked(&IP_CORE_32, 0xFFFF_FFFF - 2_000_000_000, 100);
    let start = activate(&mut pair, T0, T0 / 4, 0);
    pair.edges.clear();
    let local = |pair: &Pair| {
        let now = pair.follower.clock.read(pair.now);
        (pair.follower.esc.local_time(now).count(), pair.follower.esc.system_time(now).count())
    };
    let mut wraps = (0, 0);
    for _ in 0..9_000 {
        let before = local(&pair);
        pair.distribute(T0);
        let after = local(&pair);
        wraps.0 += u32::from(after.0 < before.0);
        wraps.1 += u32::from(after.1 < before.1);
    }
    assert_eq!(wraps, (2, 2), "local and system time wrapped");
    let mut found = Found::NOTHING;
    compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync0), start, T0);
    let sync0 = found.edges();
    compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync1), start + T0 / 4, T0);
    assert!(sync0 >= 8_790 && found.edges() >= 2 * sync0 - 1, "{sync0} SYNC0, {found:?}");
    found.check("across the wraps");
}

/// The start has passed when the activation arrives: a 32-bit ESC waits for the wrap, 4.29 s later.
#[test]
fn a_late_activation_waits_for_the_wrap() {
    let mut pair = locked(&IP_CORE_32, 0, 100);
    let start = activate(&mut pair, T0, 0, 0);
    pair.write(1, register::SYNC_ACTIVATION, SyncActivation(0));
    pair.edges.clear();
    // The start time is not written again, but activated again after it has passed.
    pair.run(10 * T0);
    pair.write(1, register::SYNC_ACTIVATION, SyncActivation(3));
    assert_eq!(pair.read(1, register::ACTIVATION_STATUS), ActivationStatus(5));
    for _ in 0..4_300 {
        pair.distribute(T0);
    }
    let mut found = Found::NOTHING;
    let first = start + (1 << 32);
    compare(&pair, &mut found, &of(&pair.edges, EscEvent::Sync0), first, T0);
    assert!((10..=20).contains(&found.edges()), "{found:?}");
}

//! How fast the drift loop's model locks, as a golden file, and how well.
//!
//! The published part has limits of its own here: the deviation of register 0x0932, the largest speed,
//! the resolution. The model's own figures are in `../golden/drift_loop.txt`; `UPDATE_GOLDEN=1` writes
//! it anew.

use std::fmt::Write;

use isocat_esc::LAN9252;
use isocat_wire::register;

use crate::pair::Pair;

/// The follower's local time at power-on, ns: an offset of 1 s.
const OFFSET: u64 = 1_000_000_000;
/// Differences to reach, ps.
const LIMITS: [i64; 3] = [1_000_000, 100_000, 20_000];
const REFERENCE_PPM: i64 = -13;
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/drift_loop.txt");

/// One line of the table.
struct Line {
    start: u16,
    depths: (u8, u8),
    ppm: i64,
    /// True time between two FRMW, ns.
    interval: u64,
    /// FRMW after which the difference is below each of the limits for good.
    counts: [u64; 3],
    /// Largest difference in the last fortieth, ps.
    rest: i64,
    /// Register 0x0932 at the end.
    speed: i16,
}

/// Both oscillators, ppb: the follower's is off by `ppm` from the reference's, which is not true either.
fn clocks(ppm: i64) -> (i64, i64) {
    (1_000 * REFERENCE_PPM, 1_000 * (REFERENCE_PPM + ppm))
}

/// Relative deviation by the published formula, in 10^-12.
fn deviation(start: u16, difference: i16) -> i64 {
    let (s, d) = (i64::from(start) + 2, i64::from(difference));
    1_000_000_000_000 * d / (5 * (s + d) * (s - d))
}

/// Runs `frames` FRMW from the present difference on.
fn lock(pair: &mut Pair, interval: u64, frames: u64) -> ([u64; 3], i64) {
    let (mut counts, mut rest) = ([0; 3], 0);
    let (mut difference, mut look) = (0, 1);
    for frame in 1..=frames {
        // Far away it suffices to look now and then.
        if frame >= look {
            difference = pair.difference().abs();
            look = frame + if difference > 100 * LIMITS[0] { 64 } else { 1 };
        }
        for (count, limit) in counts.iter_mut().zip(LIMITS) {
            if difference >= limit {
                *count = frame;
            }
        }
        if frame > frames / 40 * 39 {
            rest = rest.max(difference);
        }
        pair.distribute(interval);
    }
    (counts, rest)
}

impl Line {
    /// With the offset register set, and what the clocks drift apart in 50 ms left over: 5 us.
    fn corrected(start: u16, depths: (u8, u8), ppm: i64, interval: u64) -> Self {
        let mut pair = Pair::new(&LAN9252, clocks(ppm), OFFSET, 100);
        pair.set_offset();
        pair.run(50_000_000);
        pair.set_loop(start, depths);
        let left = pair.difference();
        assert!((4_900_000..5_200_000).contains(&left.abs()), "{left} ps are left");
        assert_eq!(left > 0, ppm > 0, "a fast clock is ahead");
        Self::run(pair, (start, depths, ppm, interval), 60_000)
    }

    /// With the loop alone: it has to bring back 1 s against the drift.
    fn slewed(start: u16, ppm: i64) -> Self {
        let pair = uncorrected(start, ppm);
        assert!((pair.difference().abs() - 1_000_000_000_000).abs() < 100_000_000);
        Self::run(pair, (start, (0, 12), ppm, 1_000_000), Self::shortest(start, ppm) / 10 * 11)
    }

    /// FRMW, one a ms, that 1 s takes at the largest speed less the drift.
    fn shortest(start: u16, ppm: i64) -> u64 {
        let largest = deviation(start, (start - 0x7F) as i16);
        1_000_000_000_000_000 / (largest - 1_000_000 * ppm.abs()) as u64
    }

    fn run(
        mut pair: Pair,
        (start, depths, ppm, interval): (u16, (u8, u8), i64, u64),
        frames: u64,
    ) -> Self {
        let (counts, rest) = lock(&mut pair, interval, frames);
        let speed = pair.read(1, register::SPEED_COUNTER_DIFFERENCE);
        let shown = pair.read(1, register::SYSTEM_TIME_DIFFERENCE).nanos().0;
        assert!(shown.abs() <= rest / 1_000 + 20, "0x092C shows {shown} ns, true are {rest} ps");
        Self { start, depths, ppm, interval, counts, rest, speed }
    }

    fn write(&self, table: &mut String) {
        let Self { start, depths, ppm, interval, counts, rest, speed } = self;
        let us = interval / 1_000;
        let [first, second, third] = counts;
        let (rest, ppb) = ((rest + 500) / 1_000, deviation(*start, *speed) / 1_000);
        writeln!(
            table,
            "{start:#06x} {:>5} {:>5} {ppm:>5} {us:>8} {first:>8} {second:>8} {third:>8} {rest:>5} \
             {speed:>6} {ppb:>8}",
            depths.0, depths.1
        )
        .expect("a string takes it");
    }

    fn check(&self) {
        let Self { start, ppm, counts, rest, speed, .. } = *self;
        let name = std::format!("{start:#06x}, {:?}, {ppm} ppm, {} ns", self.depths, self.interval);
        // The speed that cancels the oscillator's, within one unit of the register on either side.
        let wanted = -1_000_000 * ppm * 1_000_000 / (1_000_000 + REFERENCE_PPM + ppm);
        let (below, above) = (deviation(start, speed - 1), deviation(start, speed + 1));
        assert!(below < wanted && wanted < above, "{name}: {wanted} not {below}..{above}");
        assert!((300..20_000).contains(&rest), "{name}: {rest} ps remain");
        assert!(counts.is_sorted(), "{name}: {counts:?}");
    }
}

/// A pair 1 s apart whose offset register knows nothing of it.
fn uncorrected(start: u16, ppm: i64) -> Pair {
    let mut pair = Pair::new(&LAN9252, clocks(ppm), 0, 100);
    pair.set_offset();
    let offset = pair.read(1, register::SYSTEM_TIME_OFFSET);
    let delay = pair.read(1, register::SYSTEM_TIME_DELAY);
    // Ahead where the clock is fast, so that the drift adds to it.
    let second = if ppm > 0 { 1_000_000_000 } else { -1_000_000_000i64 };
    pair.write_offset(offset.wrapping_add_signed(second), delay);
    pair.set_loop(start, (0, 12));
    pair
}

#[test]
fn the_table_of_the_model() {
    let lines: Vec<Line> = std::thread::scope(|scope| {
        let mut lines = vec![];
        for start in [0x0100, 0x1000, 0x3000] {
            let burst = [(0, 12), (4, 12), (0, 8)].map(|depths| (depths, 10_000));
            // And one in the cycle of a running machine.
            for (depths, interval) in burst.into_iter().chain([((0, 12), 1_000_000)]) {
                for ppm in [100, -100] {
                    lines.push(scope.spawn(move || Line::corrected(start, depths, ppm, interval)));
                }
            }
            lines.push(scope.spawn(move || Line::slewed(start, 100)));
        }
        lines.push(scope.spawn(move || Line::slewed(0x1000, -100)));
        lines.into_iter().map(|line| line.join().expect("a line of its own")).collect()
    });
    let mut table = String::from(HEAD);
    for line in &lines {
        line.write(&mut table);
    }
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(GOLDEN, &table).expect("the golden file can be written");
    }
    for line in &lines {
        line.check();
    }
    // At the usual settings: about the 15000 frames that MainDevices are advised to send.
    for line in &lines {
        if (line.start, line.depths, line.interval) == (0x1000, (0, 12), 10_000) {
            let [_, second, third] = line.counts;
            assert!((5_000..12_000).contains(&second) && (12_000..18_000).contains(&third));
        }
        if line.counts[0] > 1_000_000 {
            let shortest = Line::shortest(line.start, line.ppm);
            let range = shortest - shortest / 1_000..shortest + shortest / 50;
            assert!(range.contains(&line.counts[0]), "{:?}, not {range:?}", line.counts);
        }
    }
    let golden = std::fs::read_to_string(GOLDEN).unwrap_or_default();
    assert!(table == golden, "the model changed: run with UPDATE_GOLDEN=1\n{table}");
}

/// A smaller 0x0930 locks faster, from the same difference.
#[test]
fn a_larger_speed_counter_start_is_slower() {
    let counts = [0x0100, 0x1000, 0x3000]
        .map(|start| Line::corrected(start, (0, 12), 100, 10_000).counts[2]);
    assert!(counts.is_sorted() && counts[0] * 4 < counts[1], "{counts:?}");
}

/// Far off, the clock goes at the largest speed that register 0x0932 can hold, and no faster.
#[test]
fn far_off_the_largest_speed_is_the_published_one() {
    for start in [0x0100u16, 0x1000, 0x3000] {
        for ppm in [100, -100] {
            let mut pair = uncorrected(start, ppm);
            for _ in 0..40_000 {
                pair.distribute(100_000);
            }
            let speed = pair.read(1, register::SPEED_COUNTER_DIFFERENCE);
            let range = (start - 0x7F) as i16;
            let full = if ppm > 0 { -range } else { range };
            assert!((full - speed).abs() <= range / 200, "{start:#06x}: {speed}, not {full}");
            let (before, from) = (pair.difference(), pair.now);
            for _ in 0..1_000 {
                pair.distribute(100_000);
            }
            let (moved, true_time) = (pair.difference() - before, (pair.now - from).0);
            // Both speeds together, in 10^-12; the product of the two is 80 ppb at most.
            let expected = deviation(start, full) + 1_000_000 * ppm;
            let found = (i128::from(moved) * 1_000_000_000_000 / i128::from(true_time)) as i64;
            assert!((found - expected).abs() < 300_000, "{start:#06x}: {found}, not {expected}");
        }
    }
}

const HEAD: &str = "\
# FRMW until the system time difference stays below a limit: follower off by ppm, FRMW every interval.
# Local clocks 1 s apart. Lines with counts below a million: offset register set 50 ms before, which
# leaves 5 us; the others: offset register not set, the loop brings back the whole second.
# rest: largest difference in the last fortieth; speed: register 0x0932 at the end, and what it means.
# start filter depths   ppm interval                 FRMW until    rest  speed deviation
#        time speed               us  1000 ns   100 ns    20 ns    ns             ppb
";

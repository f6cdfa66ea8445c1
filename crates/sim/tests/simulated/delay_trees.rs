//! The delay measurement on random trees: each delay is within its stated error, and each one
//! reported as indeterminate really is.
//!
//! ESCs latch frames of the simulated segment, and `isocat_sync::delay` computes delays from these
//! latches. Two judges that share no code with it check them: the walk of the frame in true time
//! and, for determinacy, linear algebra. The unknowns there are the cables; each difference of two
//! receive times is an equation; a delay can be known if its sum of cables is a combination of
//! these.

use crate::support::*;
use PortNumber::*;
use isocat_esc::Chip;
use isocat_sim::{Cable, ClockModel, Connection, MainPort, Segment};
use isocat_sync::delay::{
    Averaging, Delay, Found, Hop, HopJitter, Mean, Node, Stay, Why, hop_jitter, propagation_delays,
    turn,
};
use isocat_wire::PortNumber;
use isocat_wire::time::{Picos, Time};

/// Chips that keep frames for different times; the last one has no receive times.
static CHIPS: [Chip; 4] = [
    WIDE,
    Chip {
        kind: 0x31,
        processing_delay: Picos(283_400),
        forwarding_delay: Picos(251_700),
        ..NARROW
    },
    Chip { kind: 0x32, processing_delay: Picos(140_300), forwarding_delay: Picos(140_300), ..WIDE },
    Chip {
        kind: 0x33,
        processing_delay: Picos(201_100),
        forwarding_delay: Picos(163_900),
        ..PLAIN
    },
];

/// Splitmix64.
struct Chance(u64);

impl Chance {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % end
    }

    fn once_in(&mut self, times: u64) -> bool {
        self.below(times) == 0
    }
}

/// A segment and its true properties.
struct Tree {
    links: Vec<Link>,
    chips: Vec<&'static Chip>,
    segment: Segment,
    from: MainPort,
    /// Mean time until a frame reaches the processing unit, ps.
    arrivals: Vec<i64>,
    /// Whether hops jitter, and delays allow for it.
    hop_jitter: bool,
}

impl Tree {
    /// 2 to 40 SubDevices, with one cable in eight swapped, one chip in six without receive times,
    /// and without jitter of hops.
    fn random(chance: &mut Chance, most_ppb: u64) -> Self {
        Self::with(chance, most_ppb, false)
    }

    /// The same; if hops jitter, no cable is swapped.
    fn with(chance: &mut Chance, most_ppb: u64, hop_jitter: bool) -> Self {
        let count = 2 + chance.below(39) as usize;
        let lines = chance.once_in(3);
        let mut links: Vec<Link> = Vec::new();
        let mut free: Vec<(usize, PortNumber)> = Vec::new();
        for device in 0..count {
            let parent = if device == 0 {
                None
            } else if lines {
                // The last ports are those of the last SubDevice.
                Some(free.pop().unwrap())
            } else {
                let at = chance.below(free.len() as u64) as usize;
                Some(free.swap_remove(at))
            };
            let swapped = chance.once_in(8) && !hop_jitter;
            let entry = if swapped { [P1, P2, P3][chance.below(3) as usize] } else { P0 };
            let mut ports: Vec<_> = PortNumber::ALL.into_iter().filter(|p| *p != entry).collect();
            let first = chance.below(3) as usize;
            ports.rotate_left(first);
            free.extend(ports.into_iter().map(|port| (device, port)));
            links.push((parent, entry));
        }
        // An ESC whose port 0 is closed marks frames as circulating, and the next such ESC destroys
        // them.
        let mut closed = 0;
        for device in 0..count {
            let (parent, entry) = links[device];
            let used = links.iter().any(|link| link.0 == Some((device, P0)));
            closed += usize::from(entry != P0 && !used);
            links[device] = (parent, if used || closed == 1 { entry } else { P0 });
        }
        let chips = (0..count).map(|_| match chance.once_in(6) {
            true => &CHIPS[3],
            false => &CHIPS[chance.below(3) as usize],
        });
        let chips: Vec<_> = chips.collect();
        let connections = links.iter().zip(&chips).map(|((parent, port), chip)| {
            let ppb = chance.below(2 * most_ppb + 1) as i64 - most_ppb as i64;
            // One counter in four wraps its lower half at about the time of the latches.
            let local = match chance.below(4) {
                0 => {
                    (chance.below(1 << 20) << 31).wrapping_sub(5_000_000 + chance.below(3_000_000))
                }
                _ => chance.below(u64::MAX),
            };
            let setup = device(chip, ClockModel::constant(ppb), Time::new(local));
            let cable = Cable::of_length(100 + chance.below(90_000));
            Connection { port: *port, hop_jitter, ..Connection::new(*parent, cable, setup) }
        });
        let connections = connections.collect();
        let seed = if hop_jitter { chance.below(u64::MAX) } else { 1 };
        Self::of(Segment::new(connections, seed), links, chips, hop_jitter)
    }

    /// A tree that no frame has passed yet.
    fn of(segment: Segment, links: Vec<Link>, chips: Vec<&'static Chip>, hop_jitter: bool) -> Self {
        let mut arrivals = vec![0; links.len()];
        for entry in &segment.path().entries {
            arrivals[entry.device] = entry.after.0;
        }
        Self { links, chips, segment, from: MainPort::Primary, arrivals, hop_jitter }
    }

    fn timed(&self, device: usize) -> bool {
        !std::ptr::eq(self.chips[device], &CHIPS[3])
    }

    /// The SubDevices in processing order, as a MainDevice would find them.
    fn order(&self) -> Vec<usize> {
        self.segment.path_from(self.from).entries.iter().map(|entry| entry.device).collect()
    }

    /// Time until the frame reaches the processing unit, ps.
    fn true_arrival(&self, device: usize) -> i64 {
        self.arrivals[device]
    }

    fn is_open(&self, device: usize, port: PortNumber) -> bool {
        let (parent, entry) = self.links[device];
        entry == port && (parent.is_some() || device == 0)
            || self.links.iter().any(|link| link.0 == Some((device, port)))
    }

    /// A MainDevice's knowledge of it after a latch, in this order.
    fn nodes(&self, order: &[usize]) -> Vec<Node> {
        let position = |device| order.iter().position(|other| *other == device).unwrap();
        order
            .iter()
            .map(|device| {
                let (parent, entry) = self.links[*device];
                let chip = self.chips[*device];
                Node {
                    parent: parent.map(|(parent, port)| (position(parent), port)),
                    entry,
                    open: PortNumber::ALL.map(|port| self.is_open(*device, port)),
                    receive_times: self
                        .timed(*device)
                        .then(|| receive_times(&self.segment, *device)),
                    stay: Stay::exact(chip.kind, chip.processing_delay, chip.forwarding_delay),
                }
            })
            .collect()
    }

    /// Makes this number of latches, at instants that fall anywhere within a tick; returns the
    /// results by position.
    fn measure(&mut self, chance: &mut Chance, latches: u64, rate_ppb: u32) -> Vec<Delay> {
        let order = self.order();
        let timed = (0..order.len()).filter(|device| self.timed(*device)).count();
        let Some(reference) = order.iter().position(|device| self.timed(*device)) else {
            return Vec::new();
        };
        let mut means = self.expected(&order, reference);
        let mut found = vec![Found::default(); order.len()];
        for number in 0..latches {
            let at = 5_000_000_000 + number * 300_000_000 + chance.below(100_000_000);
            assert_eq!(usize::from(latch(&mut self.segment, self.from, Time::new(at))), timed);
            propagation_delays(&self.nodes(&order), reference, rate_ppb, &mut found);
            for (mean, found) in means.iter_mut().zip(&found) {
                mean.add(found);
            }
        }
        assert!(means.iter().all(|mean| mean.latches() + mean.left_out() == latches as u32));
        let averaging = Averaging::of(&means);
        means.iter().map(|mean| mean.delay(averaging)).collect()
    }

    /// The expected jitter of hops: MII everywhere.
    fn expected(&self, order: &[usize], reference: usize) -> Vec<Mean> {
        let mut jitter = vec![HopJitter::default(); order.len()];
        if self.hop_jitter {
            let period = Picos(40_000);
            let hop = |node: Node| Hop { parent: node.parent, out: period, back: period };
            let hops: Vec<Hop> = self.nodes(order).into_iter().map(hop).collect();
            hop_jitter(&hops, &mut jitter);
            let first = jitter[reference].delay;
            jitter.iter_mut().for_each(|one| one.delay = one.delay.saturating_sub(first));
        }
        jitter.into_iter().map(Mean::expecting).collect()
    }

    /// No delay can be off by more than a tick for each fork with receive times and two for its
    /// ends.
    fn hard_bound(&self) -> i64 {
        let ports = |d| PortNumber::ALL.into_iter().filter(|port| self.is_open(d, *port)).count();
        let forks = (0..self.links.len()).filter(|device| ports(*device) > 2).count();
        10_000 * (2 + forks as i64)
    }
}

/// Determines by linear algebra over a prime field which delays can be known. There is one unknown
/// for each SubDevice: the cable above it, one way. All equations are written by walking with the
/// frame.
struct Oracle<'a> {
    tree: &'a Tree,
    /// Cables passed since the frame began.
    now: Vec<i64>,
    /// When the frame arrives at each port of each SubDevice, in the order of arrival.
    arrivals: Vec<Vec<(PortNumber, Vec<i64>)>>,
    unit: Vec<Vec<i64>>,
}

impl<'a> Oracle<'a> {
    fn new(tree: &'a Tree) -> Self {
        let count = tree.links.len();
        let mut oracle = Self {
            tree,
            now: vec![0; count],
            arrivals: vec![Vec::new(); count],
            unit: vec![Vec::new(); count],
        };
        oracle.walk(0);
        oracle
    }

    fn walk(&mut self, device: usize) {
        let entry = self.tree.links[device].1;
        let round = [P0, P3, P1, P2];
        let first = round.iter().position(|port| *port == entry).unwrap();
        self.arrivals[device].push((entry, self.now.clone()));
        for step in 0..4 {
            let port = round[(first + step) % 4];
            let child = self.tree.links.iter().position(|link| link.0 == Some((device, port)));
            if let Some(child) = child.filter(|_| port != entry) {
                self.now[child] += 1;
                self.walk(child);
                self.now[child] += 1;
                self.arrivals[device].push((port, self.now.clone()));
            }
            // The processing unit is behind port 0, whether it is open or not.
            if port == P0 {
                self.unit[device] = self.now.clone();
            }
        }
    }

    /// Whether the receive times determine the delay from one SubDevice to the other.
    fn can_be_known(&self) -> impl Fn(usize, usize) -> bool {
        const PRIME: i64 = 1_000_003;
        let power = |mut base: i64, mut exponent: i64| {
            let mut result = 1;
            while exponent > 0 {
                if exponent % 2 == 1 {
                    result = result * base % PRIME;
                }
                (base, exponent) = (base * base % PRIME, exponent / 2);
            }
            result
        };
        let reduce = move |mut row: Vec<i64>, basis: &[(usize, Vec<i64>)]| {
            for (pivot, known) in basis {
                let factor = row[*pivot];
                for (value, known) in row.iter_mut().zip(known) {
                    *value = (*value - factor * known).rem_euclid(PRIME);
                }
            }
            row
        };
        let difference = |from: &[i64], to: &[i64]| -> Vec<i64> {
            to.iter().zip(from).map(|(to, from)| (to - from).rem_euclid(PRIME)).collect()
        };
        let mut basis: Vec<(usize, Vec<i64>)> = Vec::new();
        for device in (0..self.arrivals.len()).filter(|device| self.tree.timed(*device)) {
            for pair in self.arrivals[device].windows(2) {
                let row = reduce(difference(&pair[0].1, &pair[1].1), &basis);
                if let Some(pivot) = row.iter().position(|value| *value != 0) {
                    let inverse = power(row[pivot], PRIME - 2);
                    basis.push((pivot, row.iter().map(|value| value * inverse % PRIME).collect()));
                }
            }
        }
        move |from, to| {
            let wanted = difference(&self.unit[from], &self.unit[to]);
            reduce(wanted, &basis).iter().all(|value| *value == 0)
        }
    }
}

/// 1000 trees of chips with known stays and clocks of equal speed: only quantization remains.
#[test]
fn random_trees_state_their_errors_right() {
    for latches in [1, 16] {
        let (mut known, mut within, mut indeterminate) = (0u32, 0u32, 0u32);
        let (mut sum, mut squares, mut worst) = (0.0, 0.0, 0.0f64);
        let (mut stated, mut actual) = (0.0, 0.0);
        for seed in 0..1000 {
            let mut chance = Chance(seed);
            let mut tree = Tree::random(&mut chance, 0);
            let (results, order) = (tree.measure(&mut chance, latches, 0), tree.order());
            let Some(reference) = order.iter().copied().find(|device| tree.timed(*device)) else {
                continue;
            };
            let oracle = Oracle::new(&tree);
            let can_be_known = oracle.can_be_known();
            for (device, result) in order.iter().zip(&results) {
                let place = format!("seed {seed}, SubDevice {device}: {result:?}");
                let truth = tree.true_arrival(*device) - tree.true_arrival(reference);
                if !tree.timed(*device) {
                    let why = Why::NoReceiveTimes;
                    assert_eq!(*result, Delay::Indeterminate { why, between: None }, "{place}");
                    continue;
                }
                assert_eq!(can_be_known(reference, *device), result.bar().is_some(), "{place}");
                match result {
                    Delay::Known { delay, standard_error, systematic } => {
                        assert_eq!(systematic.0, 0, "{place}");
                        assert!(delay.0 >= 0, "{place}");
                        if *device == reference {
                            assert_eq!((delay.0, standard_error.0), (0, 0), "{place}");
                            continue;
                        }
                        let error = delay.0 - truth;
                        assert!(error.abs() <= tree.hard_bound(), "{place}, off by {error} ps");
                        known += 1;
                        within += u32::from(error.abs() <= result.bar().unwrap().0);
                        let score = error as f64 / standard_error.0 as f64;
                        (sum, squares) = (sum + score, squares + score * score);
                        worst = worst.max(score.abs());
                        stated += (standard_error.0 as f64).powi(2);
                        actual += (error as f64).powi(2);
                    }
                    Delay::Indeterminate { between, .. } => {
                        indeterminate += 1;
                        let Some((least, most)) = between else { continue };
                        let noise = tree.hard_bound();
                        let inside = least.0 - noise <= truth && truth <= most.0 + noise;
                        assert!(inside, "{place}, truly {truth} ps");
                    }
                }
            }
        }
        let count = f64::from(known);
        let coverage = f64::from(within) / count;
        let (mean, rms) = (sum / count, (squares / count).sqrt());
        let root = |squares: f64| (squares / count).sqrt() / 1_000.0;
        println!(
            "{latches:2} latches: {known} known, {indeterminate} indeterminate; {:.2} % within 1.96 sigma, \
             errors of {mean:.3} +- {rms:.3} sigma, {worst:.1} at worst; {:.2} ns stated, {:.2} ns found",
            100.0 * coverage,
            root(stated),
            root(actual),
        );
        assert!(known > 10_000 && indeterminate > 1_000);
        assert!((0.90..=0.999).contains(&coverage), "{coverage}");
        // The effect of averaging is estimated from the spread, cautiously for small segments.
        let (least, ratio) = if latches == 1 { (0.95, 0.9..=1.1) } else { (0.7, 0.95..=2.3) };
        assert!(mean.abs() < 0.05 && (least..=1.05).contains(&rms), "{mean} +- {rms}");
        assert!(ratio.contains(&(stated / actual)), "{stated} and {actual}");
    }
}

/// 400 trees whose hops jitter, with clocks up to 25 ppm apart: the stated errors hold, and more
/// latches make them smaller.
#[test]
fn jitter_is_within_the_stated_errors_and_averages_out() {
    let mut errors = Vec::new();
    for latches in [1, 16, 128] {
        let (mut known, mut within) = (0u32, 0u32);
        let (mut stated, mut actual) = (0.0, 0.0);
        for seed in 20_000..20_400 {
            let mut chance = Chance(seed);
            let mut tree = Tree::with(&mut chance, 25_000, true);
            let (results, order) = (tree.measure(&mut chance, latches, 50_000), tree.order());
            let Some(reference) = order.iter().position(|device| tree.timed(*device)) else {
                continue;
            };
            for (device, result) in order.iter().zip(&results) {
                let Delay::Known { delay, standard_error, .. } = result else { continue };
                if *device == order[reference] {
                    continue;
                }
                let truth = tree.true_arrival(*device) - tree.true_arrival(order[reference]);
                let error = delay.0 - truth;
                known += 1;
                within += u32::from(error.abs() <= result.bar().unwrap().0);
                stated += (standard_error.0 as f64).powi(2);
                actual += (error as f64).powi(2);
            }
        }
        let count = f64::from(known);
        let coverage = f64::from(within) / count;
        let (stated, actual) = ((stated / count).sqrt(), (actual / count).sqrt());
        println!(
            "{latches:3} latches: {known} known, {:.2} % within the bar; {:.1} ns stated, {:.1} ns found",
            100.0 * coverage,
            stated / 1_000.0,
            actual / 1_000.0,
        );
        assert!(known > 4_000);
        assert!((0.90..=0.999).contains(&coverage), "{latches} latches: {coverage}");
        assert!((0.8..2.3).contains(&(stated / actual)), "{stated} and {actual}");
        errors.push(actual);
    }
    assert!(errors[1] < errors[0] / 2.5, "16 are better than one: {errors:?}");
    assert!(errors[2] < errors[1] / 2.0, "128 are better than 16: {errors:?}");
}

/// Clocks of equal speed keep their phase, so that latches average nothing, and the error says so.
#[test]
fn clocks_of_one_speed_average_nothing() {
    let (mut known, mut within) = (0u32, 0u32);
    for seed in 30_000..30_200 {
        let mut chance = Chance(seed);
        let mut tree = Tree::with(&mut chance, 0, true);
        let (results, order) = (tree.measure(&mut chance, 16, 0), tree.order());
        let Some(reference) = order.iter().position(|device| tree.timed(*device)) else { continue };
        for (device, result) in order.iter().zip(&results) {
            let (Some(bar), Delay::Known { delay, .. }) = (result.bar(), result) else { continue };
            if *device != order[reference] {
                let truth = tree.true_arrival(*device) - tree.true_arrival(order[reference]);
                known += 1;
                within += u32::from((delay.0 - truth).abs() <= bar.0);
            }
        }
    }
    let coverage = f64::from(within) / f64::from(known);
    assert!((0.90..=0.999).contains(&coverage), "{coverage}");
}

/// Clocks of different speeds: their effect is within the systematic part.
#[test]
fn speeds_of_clocks_are_within_the_bound() {
    let mut beyond = 0;
    for seed in 5_000..5_200 {
        let mut chance = Chance(seed);
        let mut tree = Tree::random(&mut chance, 50_000);
        let (results, order) = (tree.measure(&mut chance, 16, 100_000), tree.order());
        let Some(reference) = order.iter().copied().find(|device| tree.timed(*device)) else {
            continue;
        };
        for (device, result) in order.iter().zip(&results) {
            let Delay::Known { delay, standard_error, systematic } = result else { continue };
            let truth = tree.true_arrival(*device) - tree.true_arrival(reference);
            // The reference's own deviation changes the length of a ns of its counter.
            let truth_error = 50_000 * truth / 1_000_000_000;
            let error = (delay.0 - truth).abs();
            let limit = systematic.0 + 5 * standard_error.0 + truth_error;
            assert!(error <= limit, "seed {seed}, {device}: {error} ps, {result:?}");
            beyond += u32::from(error > 5 * standard_error.0);
        }
    }
    println!("{beyond} beyond 5 sigma without the speeds");
}

/// 300 SubDevices on 120 m of cable: SYNC0 of the last one against the first.
#[test]
fn a_long_line() {
    const COUNT: usize = 300;
    let (mut squares, mut off) = (0.0, 0.0);
    let rounds = 60;
    for seed in 0..rounds {
        let mut chance = Chance(seed);
        let connections = line(COUNT).into_iter().map(|(parent, _)| {
            let local = Time::new(chance.below(u64::MAX));
            let cable = Cable::of_length(301 + chance.below(200));
            let device = device(&WIDE, ClockModel::constant(0), local);
            Connection { hop_jitter: false, ..Connection::new(parent, cable, device) }
        });
        let segment = Segment::new(connections.collect(), 1);
        let mut tree = Tree::of(segment, line(COUNT), vec![&WIDE; COUNT], false);
        let result = tree.measure(&mut chance, 1, 0)[COUNT - 1];
        let Delay::Known { delay, standard_error, .. } = result else { panic!("{result:?}") };
        assert_eq!(standard_error.0, 2_042);
        let truth = tree.true_arrival(COUNT - 1) - tree.true_arrival(0);
        let error = (delay.0 - truth) as f64;
        squares += error * error;

        // The same times, with processing assumed 1 ns longer than it is.
        let mut nodes = tree.nodes(&tree.order());
        for node in &mut nodes {
            node.stay.processing += Picos(1_000);
        }
        let mut found = vec![Found::default(); COUNT];
        propagation_delays(&nodes, 0, 0, &mut found);
        off += (found[COUNT - 1].delay().unwrap() - delay).0 as f64;
    }
    let deviation = (squares / f64::from(rounds as u32)).sqrt() / 1_000.0;
    let off = off / f64::from(rounds as u32) / 1_000.0;
    println!("last of {COUNT}: {deviation:.2} ns by quantization, {off:.1} ns by 1 ns of tDiff");
    assert!((1.5..=2.6).contains(&deviation), "{deviation} ns");
    assert!((off - 149.0).abs() < 0.01, "{off} ns");
}

/// A ring of 7 that is cut anywhere: each side is measured by frames from its own end, with one
/// description of the ring.
#[test]
fn both_sides_of_a_cut_ring() {
    const COUNT: usize = 7;
    for cut in 0..=COUNT {
        let mut segment = segment(&line(COUNT), |_| &WIDE);
        segment.close_ring(COUNT - 1, P1, cable(COUNT)).unwrap();
        segment.unplug(cut, micros(1));
        segment.advance(micros(1_000), &mut isocat_sim::Watcher::blind());
        for (from, side) in [(MainPort::Primary, 0..cut), (MainPort::Secondary, cut..COUNT)] {
            if side.is_empty() {
                continue;
            }
            let wkc = latch(&mut segment, from, micros(5_000));
            assert_eq!(usize::from(wkc), side.len());
            let mut nodes: Vec<Node> = (0..COUNT)
                .map(|i| Node {
                    parent: i.checked_sub(1).map(|above| (above, P1)),
                    entry: P0,
                    open: [i != cut, i + 1 != cut, false, false],
                    receive_times: Some(receive_times(&segment, i)),
                    stay: Stay::exact(0, WIDE.processing_delay, WIDE.forwarding_delay),
                })
                .collect();
            if from == MainPort::Secondary {
                turn(&mut nodes, COUNT - 1, P1);
            }
            let entries = &segment.path_from(from).entries;
            let reference = entries[0];
            let mut found = vec![Found::default(); COUNT];
            propagation_delays(&nodes, reference.device, 0, &mut found);
            for (i, found) in found.iter().enumerate() {
                let Some(entry) = entries.iter().find(|entry| entry.device == i) else {
                    assert!(found.why().is_some(), "cut at {cut}: {i} is on the other side");
                    continue;
                };
                let delay = found.delay().expect("it can be known");
                let error = (delay - (entry.after - reference.after)).0;
                assert!(
                    error.abs() <= 20_000,
                    "cut at {cut}, from {from:?}: {i} is {error} ps off"
                );
            }
        }
    }
}

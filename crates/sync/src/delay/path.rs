//! The delays that one latch gives: the way of every SubDevice from the reference clock.
//!
//! The way is a sum over SubDevices. Each contributes a few of its own receive times with
//! coefficients of a half: this makes errors cancel along a line and determines their variance. Let
//! a SubDevice have the entry `e` and the last port `l`, and let the way leave it through `a`,
//! after the port `p`:
//!
//! - to reach it adds `(e - l) / 2`;
//! - to leave it adds `(a + p) / 2 - e`.
//!
//! In a line `p` is `e` and `a` is `l`, so the sum is zero. From the reference the ways lead up to
//! the first SubDevice with receive times, and from there down to all the others. Each SubDevice is
//! visited a fixed number of times.

use isocat_wire::address::PortNumber;
use isocat_wire::time::{Nanos, Picos};

use super::{Node, Stay, Why};

/// The result of one latch for one SubDevice.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// The way from the reference's processing unit to this one's. With [`Found::why`] it is the
    /// middle of the possible range.
    pub(super) delay: Picos,
    /// Half the width of the possible range; `None` means no limit. 0 if the delay is known.
    pub(super) slack: Option<Picos>,
    pub(super) why: Option<Why>,
    /// Four times the sum of the squared coefficients of all receive times in the delay.
    pub(super) quarters: u64,
    pub(super) systematic: Picos,
    /// Time from the frame's arrival at the entry to its arrival at each other port, ns.
    pub(super) rounds: [Option<i64>; 4],
    work: Work,
}

/// The state of the calculation for one SubDevice.
#[derive(Clone, Copy, Debug)]
struct Work {
    /// Its receive times can be used.
    timed: bool,
    progress: Progress,
    /// The next SubDevice in an order in which parents come first.
    after: usize,
    /// The nearest SubDevice above with usable times.
    above: Option<Above>,
    /// The part of its distance from the reference's processing unit that other SubDevices' times
    /// give.
    others: Sum,
    /// The coefficients of its own receive times in that distance, in halves.
    own: [i8; 4],
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Progress {
    Waiting,
    OnTheWay,
    /// Its `above` is known.
    Placed,
    /// Its `others` and `own` are known.
    Reached,
}

#[derive(Clone, Copy, Debug)]
struct Above {
    at: usize,
    port: PortNumber,
    /// What the SubDevices in between add on the way out, less what they add on the way back.
    uneven: Picos,
    bound: Picos,
    /// A SubDevice in between that branches.
    branch: Option<usize>,
}

/// A sum of receive times and stays.
#[derive(Clone, Copy, Default, Debug)]
struct Sum {
    /// In half ps.
    halves: i64,
    quarters: u64,
    /// In half ps.
    systematic: u64,
    /// In half ps.
    slack: i64,
    why: Option<Why>,
}

impl Default for Found {
    fn default() -> Self {
        let work = Work {
            timed: false,
            progress: Progress::Waiting,
            after: NONE,
            above: None,
            others: Sum::default(),
            own: [0; 4],
        };
        Self {
            delay: Picos::ZERO,
            slack: None,
            why: Some(Why::NoLatch),
            quarters: 0,
            systematic: Picos::ZERO,
            rounds: [None; 4],
            work,
        }
    }
}

/// Computes the way of each SubDevice from the reference clock, from the times of one latch.
///
/// `rate_ppb` is the largest difference of the speeds of two counters, parts per billion: 100 000
/// for two that run freely within 50 ppm each. A SubDevice without receive times and with two open
/// ports counts as cable; so does one whose times cannot be used. `found` must be as long as
/// `nodes`; entries beyond that stay as they are. A parent that does not exist, that has the port
/// closed, or that is part of a circle counts as none.
pub fn propagation_delays(nodes: &[Node], reference: usize, rate_ppb: u32, found: &mut [Found]) {
    let count = nodes.len().min(found.len());
    let mut way = Way { nodes: &nodes[..count], reference, rate_ppb, found: &mut found[..count] };
    for i in 0..count {
        way.found[i] = Found::default();
        way.found[i].work.timed = way.nodes[i].in_order(count);
    }
    let first = way.place_all();
    way.go_up();
    let mut at = first;
    while at != NONE {
        way.go_down(at);
        way.found[at].judge(&way.nodes[at], at == reference, rate_ppb);
        at = way.found[at].work.after;
    }
    if !way.found.get(reference).is_some_and(|found| found.work.timed) {
        for (found, node) in way.found.iter_mut().zip(nodes) {
            let timed = node.receive_times.is_some();
            found.why = Some(if timed { Why::NoReference } else { Why::NoReceiveTimes });
            found.slack = None;
        }
    }
}

/// No further SubDevice.
const NONE: usize = usize::MAX;
/// A tick of the counters, ps.
pub(super) const TICK: i64 = 10_000;
/// Longest plausible round trip to the next SubDevice: 25 km of fibre. A port at which no frame
/// comes back shows an arbitrary time.
const LONGEST_HOP_NS: i64 = 250_000;

struct Way<'a> {
    nodes: &'a [Node],
    reference: usize,
    rate_ppb: u32,
    found: &'a mut [Found],
}

impl Node {
    /// Whether its receive times grow from port to port, in a segment of `count` SubDevices.
    fn in_order(&self, count: usize) -> bool {
        if self.receive_times.is_none() {
            return false;
        }
        let longest = LONGEST_HOP_NS.saturating_mul(count as i64);
        let mut before = 0;
        self.visited().skip(1).all(|port| {
            let at = self.between(self.entry, port);
            let right = at >= before && at <= longest;
            before = at;
            right
        })
    }

    /// Coefficients (in halves) for reaching the SubDevice.
    fn reached(&self) -> [i8; 4] {
        let mut all = [0; 4];
        all[self.entry.index()] += 1;
        all[self.last().index()] -= 1;
        all
    }

    /// Coefficients (in halves) for leaving the SubDevice through this port.
    fn left(&self, port: PortNumber) -> [i8; 4] {
        let mut all = [0; 4];
        all[port.index()] += 1;
        all[self.before(port).index()] += 1;
        all[self.entry.index()] -= 2;
        all
    }

    /// The sum with these coefficients, in half ps. The coefficients add up to zero, so the offset
    /// of the counter has no effect.
    fn weigh(&self, halves: [i8; 4]) -> i64 {
        let one =
            |port: PortNumber| i64::from(halves[port.index()]) * self.between(self.entry, port);
        1_000 * self.visited().map(one).sum::<i64>()
    }
}

fn plus(one: [i8; 4], other: [i8; 4]) -> [i8; 4] {
    core::array::from_fn(|port| one[port] + other[port])
}

fn minus(one: [i8; 4], other: [i8; 4]) -> [i8; 4] {
    core::array::from_fn(|port| one[port] - other[port])
}

impl Way<'_> {
    /// Finds the next clock above each SubDevice. Returns the first of an order in which parents
    /// come first.
    fn place_all(&mut self) -> usize {
        let (mut first, mut last) = (NONE, NONE);
        for i in 0..self.nodes.len() {
            // Follow the parents up to one that is placed, leaving a trail, and go back along it.
            let (mut at, mut below) = (i, NONE);
            while self.found[at].work.progress == Progress::Waiting {
                let work = &mut self.found[at].work;
                (work.progress, work.after) = (Progress::OnTheWay, below);
                below = at;
                match self.parent(at) {
                    Some((parent, _)) => at = parent,
                    None => break,
                }
            }
            while below != NONE {
                let next = self.found[below].work.after;
                self.place(below);
                match last {
                    NONE => first = below,
                    last => self.found[last].work.after = below,
                }
                last = below;
                self.found[last].work.after = NONE;
                below = next;
            }
        }
        first
    }

    fn parent(&self, i: usize) -> Option<(usize, PortNumber)> {
        let leads_down = |(parent, port): &(usize, PortNumber)| {
            self.nodes.get(*parent).is_some_and(|node| node.visited().skip(1).any(|p| p == *port))
        };
        self.nodes[i].parent.filter(leads_down)
    }

    fn place(&mut self, i: usize) {
        self.found[i].work.progress = Progress::Placed;
        let Some((parent, port)) = self.parent(i) else { return };
        let (node, work) = (&self.nodes[parent], self.found[parent].work);
        if work.progress != Progress::Placed {
            return;
        }
        self.found[i].work.above = if work.timed {
            let (uneven, bound) = (Picos::ZERO, Picos::ZERO);
            Some(Above { at: parent, port, uneven, bound, branch: None })
        } else {
            work.above.map(|mut above| {
                let out = (&node.stay, node.processes(node.before(port)));
                let back = (&node.stay, node.processes(port));
                let (uneven, bound) = Stay::difference(out, back);
                above.uneven += uneven;
                above.bound += bound;
                if node.visited_ports() > 2 {
                    above.branch = above.branch.or(Some(parent));
                }
                above
            })
        };
    }

    /// The part of twice the way from `above` to `i` that the coefficients do not give: the stays,
    /// and the unknown part.
    fn hop(&self, i: usize, above: &Above) -> Hop {
        let (from, node) = (&self.nodes[above.at], &self.nodes[i]);
        let before = from.before(above.port);
        let out = (&from.stay, from.processes(before));
        let back = (&node.stay, node.processes(node.last()));
        let (difference, bound) = Stay::difference(out, back);
        let (uneven, bound) = (difference + above.uneven, bound + above.bound);
        let branch = from.between(before, above.port);
        let mut hop = Hop { uneven, bound, unknown: 0, why: None, alone: false };
        if !self.found[i].work.timed {
            // Only this is known: the frame met the SubDevice on its way through the branch.
            let why = Why::TimesContradict;
            return Hop { unknown: 1_000 * branch, why: Some(why), alone: true, ..hop };
        }
        let kept = node.between(node.entry, node.last());
        let twice = 1_000 * (branch - kept) + uneven.0;
        // Each of the two differences may be wrong by a tick, and the clocks run at different
        // speeds.
        let noise = 2 * TICK + bound.0 + speeds(1_000 * branch.max(kept), self.rate_ppb);
        if twice < -noise {
            let by = Nanos((-twice - noise + 999).div_euclid(1_000));
            let why = Why::ShorterThanLoop { above: above.at, by };
            hop = Hop { unknown: 1_000 * branch, why: Some(why), alone: true, ..hop };
        } else if let Some(at) = above.branch {
            let why = Some(Why::BranchWithoutTimes { at });
            hop = Hop { unknown: twice.max(0), why, ..hop };
        }
        hop
    }

    /// Goes from the reference up to the first clock above it.
    fn go_up(&mut self) {
        let reference = self.reference;
        if !self.found.get(reference).is_some_and(|found| found.work.timed) {
            return;
        }
        let node = &self.nodes[reference];
        let mut own = [0; 4];
        own[node.unit().index()] -= 2;
        own[node.entry.index()] += 2;
        let mut at = reference;
        let mut sum = Sum::default();
        loop {
            let work = &mut self.found[at].work;
            (work.others, work.own, work.progress) = (sum, own, Progress::Reached);
            let Some(above) = work.above else { return };
            let hop = self.hop(at, &above);
            let reached = if hop.alone { [0; 4] } else { self.nodes[at].reached() };
            sum.add(&self.nodes[at], minus(own, reached), at == reference, self.rate_ppb);
            sum.cross(at, &hop, -1);
            own = minus([0; 4], self.nodes[above.at].left(above.port));
            at = above.at;
        }
    }

    /// Goes from the next clock above to this SubDevice, if that clock was reached.
    fn go_down(&mut self, i: usize) {
        let work = self.found[i].work;
        if work.progress == Progress::Reached || self.nodes[i].receive_times.is_none() {
            return;
        }
        let Some(above) = work.above else { return };
        let from = self.found[above.at].work;
        if from.progress != Progress::Reached {
            return;
        }
        let hop = self.hop(i, &above);
        let node = &self.nodes[above.at];
        let mut sum = from.others;
        let is_reference = above.at == self.reference;
        sum.add(node, plus(from.own, node.left(above.port)), is_reference, self.rate_ppb);
        sum.cross(above.at, &hop, 1);
        let work = &mut self.found[i].work;
        work.own = if hop.alone { [0; 4] } else { self.nodes[i].reached() };
        (work.others, work.progress) = (sum, Progress::Reached);
    }
}

/// The part of the way from one clock to the next that the coefficients do not give.
struct Hop {
    uneven: Picos,
    bound: Picos,
    /// The part of the round trip that cannot be determined, ps.
    unknown: i64,
    why: Option<Why>,
    /// The times of the lower SubDevice do not count.
    alone: bool,
}

/// Error of a span in ps from the speed of the clock that measured it.
fn speeds(span: i64, rate_ppb: u32) -> i64 {
    (i128::from(span.abs()) * i128::from(rate_ppb) / 1_000_000_000) as i64
}

impl Sum {
    /// Adds the receive times of one SubDevice.
    fn add(&mut self, node: &Node, halves: [i8; 4], is_reference: bool, rate_ppb: u32) {
        let value = node.weigh(halves);
        self.halves += value;
        self.quarters += halves.iter().map(|half| i64::from(*half).pow(2) as u64).sum::<u64>();
        // All other times are measured in the reference's time, so that has no error of speed.
        if !is_reference {
            self.systematic += speeds(value, rate_ppb) as u64;
        }
    }

    /// Adds the part of a way down (1) or up (-1) that the times do not give. The way begins at the
    /// SubDevice `from`.
    fn cross(&mut self, from: usize, hop: &Hop, sign: i64) {
        // The first unknown one on the way is the reason for all behind it.
        self.why = match (self.why, hop.why) {
            (Some(_), _) => Some(Why::Above { at: from }),
            (None, why) => why,
        };
        self.halves += sign * hop.uneven.0;
        self.systematic += hop.bound.0.unsigned_abs();
        self.slack += hop.unknown;
    }
}

impl Found {
    /// Computes the result after the SubDevice was reached.
    fn judge(&mut self, node: &Node, is_reference: bool, rate_ppb: u32) {
        let work = self.work;
        if node.receive_times.is_none() {
            self.why = Some(Why::NoReceiveTimes);
            return;
        }
        if work.progress != Progress::Reached {
            self.why = Some(if work.timed { Why::NothingInCommon } else { Why::TimesContradict });
            return;
        }
        let mut sum = work.others;
        let mut halves = work.own;
        if work.timed {
            for port in node.visited().skip(1) {
                self.rounds[port.index()] = Some(node.between(node.entry, port));
            }
            halves[node.unit().index()] += 2;
            halves[node.entry.index()] -= 2;
        }
        sum.add(node, halves, is_reference, rate_ppb);
        self.delay = Picos(sum.halves / 2);
        self.quarters = sum.quarters;
        self.systematic = Picos(sum.systematic.div_ceil(2) as i64);
        self.why = if work.timed { sum.why } else { Some(Why::TimesContradict) };
        self.slack = Some(Picos(sum.slack / 2));
    }

    /// The reason why the latch does not give the delay; `None` if it does.
    pub fn why(&self) -> Option<Why> {
        self.why
    }

    /// The delay by this latch alone. It may be below 0 ns within its error.
    pub fn delay(&self) -> Option<Picos> {
        self.why.is_none().then_some(self.delay)
    }
}

//! Receive times on every kind of tree: the latched times give the true delays.
//!
//! The formula is that of the ESC data sheet (section I, propagation delay measurement), written
//! here again and not taken from the planner. Let A be above B, `a` the port of A towards B and `p`
//! the port of A at which the frame arrived before:
//!
//! ```text
//! t(A→B) = ((tA_a - tA_p) - (tB_last - tB_entry) + tDiff) / 2
//! ```
//!
//! Here `tDiff` is the time that A adds on the way out less the time that B adds on the way back:
//! the processing delay if the frame passes the EPU there, otherwise the forwarding delay. The
//! results are judged by the walk of the frame in true time.

use crate::support::*;
use PortNumber::*;
use isocat_esc::Chip;
use isocat_sim::segment::processing_order;
use isocat_sim::{Cable, ClockModel, Connection, MainPort, Segment};
use isocat_wire::PortNumber;
use isocat_wire::time::{Picos, Time};

/// A segment, and its connections seen from one of its ends.
struct Case {
    name: String,
    segment: Segment,
    from: MainPort,
    /// Links of the SubDevices that process frames from this end.
    links: Vec<Option<Link>>,
}

impl Case {
    fn new(name: &str, links: &[Link], chip: impl Fn(usize) -> &'static Chip) -> Self {
        let segment = segment(links, chip);
        let links = links.iter().copied().map(Some).collect();
        Self { name: name.to_owned(), segment, from: MainPort::Primary, links }
    }

    fn chip(&self, device: usize) -> &Chip {
        self.segment.devices()[device].esc.chip()
    }

    fn has_clock(&self, device: usize) -> bool {
        *self.chip(device) != PLAIN
    }

    fn link(&self, device: usize) -> Link {
        self.links[device].expect("it hangs on this end")
    }

    /// The ports that a frame visits, from its entry on.
    fn visited(&self, device: usize) -> Vec<PortNumber> {
        let (_, entry) = self.link(device);
        let used = |port: &PortNumber| {
            *port == entry || self.links.iter().flatten().any(|l| l.0 == Some((device, *port)))
        };
        round(entry).filter(used).collect()
    }

    /// The stay of a frame that came in at `port` until it leaves at the next port that it visits.
    fn stay(&self, device: usize, port: PortNumber) -> i64 {
        let visited = self.visited(device);
        let at = visited.iter().position(|other| *other == port).unwrap();
        let next = visited[(at + 1) % visited.len()];
        // It passes the EPU if it came in at port 0 or passes the closed port 0.
        let between = round(port).skip(1).take_while(|other| *other != next);
        let processed = port == P0 || between.into_iter().any(|other| other == P0);
        let chip = self.chip(device);
        if processed { chip.processing_delay.0 } else { chip.forwarding_delay.0 }
    }

    /// Time between two receive times of one SubDevice, ns.
    fn between(&self, device: usize, from: PortNumber, to: PortNumber) -> i64 {
        let times = receive_times(&self.segment, device);
        i64::from(times[to.index()].wrapping_sub(times[from.index()]))
    }

    /// Delay in ps from the first SubDevice with a clock, and the number of forks in between;
    /// `None` if the receive times do not determine it.
    fn measured(&self, device: usize) -> Option<(i64, i64)> {
        if self.reference() == device {
            return Some((0, 0));
        }
        // Up to the next clock; a SubDevice with two ports but without a clock counts as cable with
        // a known asymmetry.
        let ((mut above, mut port), mut uneven) = (self.link(device).0?, 0);
        while !self.has_clock(above) {
            if self.visited(above).len() != 2 {
                return None;
            }
            uneven += self.stay(above, self.link(above).1) - self.stay(above, port);
            (above, port) = self.link(above).0?;
        }
        let visited = self.visited(above);
        let before = visited[visited.iter().position(|other| *other == port).unwrap() - 1];
        let (entry, last) = (self.link(device).1, *self.visited(device).last().unwrap());
        let round_trip = self.between(above, before, port) - self.between(device, entry, last);
        let difference = uneven + self.stay(above, before) - self.stay(device, last);
        let hop = (1_000 * round_trip + difference) / 2;
        let earlier = 1_000 * self.between(above, self.link(above).1, before);
        let (above_delay, forks) = self.measured(above)?;
        Some((above_delay + earlier + hop, forks + i64::from(visited.len() > 2)))
    }

    /// The first SubDevice with a clock that a frame meets.
    fn reference(&self) -> usize {
        let clocks =
            (0..self.links.len()).filter(|d| self.links[*d].is_some() && self.has_clock(*d));
        clocks.min_by_key(|device| self.true_arrival(*device)).expect("one has a clock")
    }

    fn true_arrival(&self, device: usize) -> Picos {
        arrival(&self.segment, self.from, device, self.link(device).1)
    }

    fn true_delay(&self, device: usize) -> i64 {
        (self.true_arrival(device) - self.true_arrival(self.reference())).0
    }

    /// Latches and compares. In a line all quantization cancels except that of the two ends (10
    /// ns); each fork leaves one and a half more. Returns the errors of the delays that can be
    /// known, ps.
    fn judge(&mut self) -> Vec<i64> {
        let at = micros(5_000);
        let member = |device: &usize| self.links[*device].is_some() && self.has_clock(*device);
        let members = (0..self.links.len()).filter(member).count();
        assert_eq!(usize::from(latch(&mut self.segment, self.from, at)), members, "{}", self.name);
        let mut errors = Vec::new();
        for device in 0..self.links.len() {
            if self.links[device].is_none() || !self.has_clock(device) {
                continue;
            }
            let Some((measured, forks)) = self.measured(device) else { continue };
            let error = measured - self.true_delay(device);
            let limit = 10_000 + 15_000 * forks;
            assert!(error.abs() <= limit, "{}: {device} is {error} ps off", self.name);
            errors.push(error);
        }
        errors
    }
}

/// The order of the ports from a given one.
fn round(from: PortNumber) -> impl Iterator<Item = PortNumber> {
    let order = [P0, P3, P1, P2];
    let first = order.iter().position(|port| *port == from).unwrap();
    (0..4).map(move |step| order[(first + step) % 4])
}

fn child(parent: usize, port: PortNumber) -> Link {
    (Some((parent, port)), P0)
}

const ROOT: Link = (None, P0);

fn star() -> Vec<Link> {
    vec![ROOT, child(0, P3), child(0, P1), child(0, P2)]
}

/// Every SubDevice except the leaves has children at ports 1 and 2; 31 in all.
fn tree_of_depth_5() -> Vec<Link> {
    let link = |number: usize| {
        let port = if number % 2 == 1 { P1 } else { P2 };
        number.checked_sub(1).map_or(ROOT, |n| child(n / 2, port))
    };
    (0..31).map(link).collect()
}

/// A cross whose three branches are lines of seven with a cross at their end.
fn deep_cross() -> Vec<Link> {
    let mut links = vec![ROOT];
    for port in [P1, P2, P3] {
        let mut last = (0, port);
        for _ in 0..7 {
            links.push(child(last.0, last.1));
            last = (links.len() - 1, P1);
        }
        let end = links.len() - 1;
        links.extend([P3, P1, P2].map(|port| child(end, port)));
    }
    links
}

/// The cable from above is in port 1 at some SubDevices, in port 2 at one, and at the end of the
/// line.
fn swapped() -> Vec<Link> {
    vec![
        ROOT,
        (Some((0, P1)), P1),
        child(1, P0),
        (Some((2, P1)), P2),
        child(3, P0),
        child(3, P1),
        (Some((4, P1)), P1),
    ]
}

fn zoo(chip: &'static Chip) -> Vec<Case> {
    vec![
        Case::new("line of 300", &line(300), |_| chip),
        Case::new("star", &star(), |_| chip),
        Case::new("tree of depth 5", &tree_of_depth_5(), |_| chip),
        Case::new("cross with deep branches", &deep_cross(), |_| chip),
        Case::new("swapped cables", &swapped(), |_| chip),
    ]
}

#[test]
fn receive_times_give_the_true_delays() {
    for mut case in zoo(&WIDE) {
        let errors = case.judge();
        assert_eq!(errors.len(), case.links.len(), "{}: all can be known", case.name);
        // Counters count in ticks of 10 ns but cables do not, so too small errors would be wrong.
        let worst = errors.iter().map(|error| error.abs()).max().unwrap();
        assert!(worst >= 1_000, "{}: {worst} ps", case.name);
    }
}

#[test]
fn counters_of_32_and_64_bits_latch_the_same() {
    for (mut wide, mut narrow) in zoo(&WIDE).into_iter().zip(zoo(&NARROW)) {
        assert_eq!(wide.judge(), narrow.judge(), "{}", wide.name);
        let mut wrapped = 0;
        for device in 0..wide.links.len() {
            let times = receive_times(&wide.segment, device);
            assert_eq!(times, receive_times(&narrow.segment, device), "{}: {device}", wide.name);
            let (entry, last) = (wide.link(device).1, *wide.visited(device).last().unwrap());
            wrapped += usize::from(times[last.index()] < times[entry.index()]);
        }
        assert!(wide.name != "line of 300" || wrapped > 0, "some wrap on the way");
    }
}

#[test]
fn a_device_without_clock_in_each_position() {
    for plain in 0..8 {
        let chip = |number| if number == plain { &PLAIN } else { &WIDE };
        let mut case = Case::new(&format!("line, {plain} without clock"), &line(8), chip);
        assert_eq!(case.judge().len(), 7);
        // It does not answer the write of 0x0900, since it has no such register.
        assert_eq!(receive_times(&case.segment, plain), [0; 4]);
    }
    for plain in 0..4 {
        let chip = |number| if number == plain { &PLAIN } else { &WIDE };
        let mut case = Case::new(&format!("star, {plain} without clock"), &star(), chip);
        // Behind a fork without receive times the delay is unknown.
        assert_eq!(case.judge().len(), if plain == 0 { 1 } else { 3 });
    }
}

#[test]
fn a_ring_cut_at_every_edge() {
    const COUNT: usize = 6;
    for cut in 0..=COUNT {
        let mut segment = segment(&line(COUNT), |_| &WIDE);
        let closing = segment.close_ring(COUNT - 1, P1, cable(COUNT)).unwrap();
        assert_eq!(closing, COUNT);
        segment.unplug(cut, micros(1));
        segment.advance(micros(1_000), &mut isocat_sim::Watcher::blind());
        let upper = |number| if number < cut { Some(line(COUNT)[number]) } else { None };
        let lower = |number: usize| {
            let above = (number + 1 < COUNT).then_some((number + 1, P0));
            if number < cut { None } else { Some((above, P1)) }
        };
        let mut known = 0;
        let mut seen = segment;
        for (from, links) in [
            (MainPort::Primary, (0..COUNT).map(upper).collect::<Vec<_>>()),
            (MainPort::Secondary, (0..COUNT).map(lower).collect()),
        ] {
            if links.iter().flatten().count() == 0 {
                continue;
            }
            let name = format!("ring cut at {cut}, from {from:?}");
            let mut case = Case { name, segment: seen, from, links };
            known += case.judge().len();
            seen = case.segment;
        }
        assert_eq!(known, COUNT, "each is processed from one end");
    }
}

/// The measurement is off by half of the additional time of the way out: no measurement can see it.
#[test]
fn an_uneven_cable_is_an_error_of_half_the_difference() {
    for uneven in [-60_000, 40_000] {
        let connections = line(2).into_iter().enumerate().map(|(number, (parent, _))| {
            let cable = cable(number).with_asymmetry(Picos(uneven * number as i64));
            Connection::new(parent, cable, device(&WIDE, ClockModel::default(), Time::ZERO))
        });
        let mut case = Case::new("line", &line(2), |_| &WIDE);
        case.segment = Segment::new(connections.collect(), 1);
        latch(&mut case.segment, MainPort::Primary, micros(5_000));
        let error = case.measured(1).unwrap().0 - case.true_delay(1);
        assert!((error + uneven / 2).abs() <= 10_000, "{error} ps for {uneven} ps");
    }
}

/// A PHY that receives more slowly than it sends has the same effect.
#[test]
fn so_is_an_uneven_phy() {
    let mut connections: Vec<_> = line(2)
        .into_iter()
        .map(|(parent, _)| {
            let device = device(&WIDE, ClockModel::default(), Time::ZERO);
            Connection::new(parent, Cable::of_length(10_000), device)
        })
        .collect();
    let phy = isocat_sim::Phy { transmit: Picos(200_000), receive: Picos(360_000) };
    connections[1].phys = Some([phy; 4]);
    let mut case = Case::new("line", &line(2), |_| &WIDE);
    case.segment = Segment::new(connections, 1);
    latch(&mut case.segment, MainPort::Primary, micros(5_000));
    let error = case.measured(1).unwrap().0 - case.true_delay(1);
    assert!((error + 80_000).abs() <= 10_000, "{error} ps");
}

/// Positions follow the processing unit: a swapped SubDevice comes after those on its port 0.
#[test]
fn the_order_of_processing() {
    assert_eq!(processing_order(&line(3)), [0, 1, 2]);
    assert_eq!(processing_order(&star()), [0, 1, 2, 3]);
    assert_eq!(processing_order(&swapped()), [0, 2, 4, 6, 3, 5, 1]);
    let fork = [ROOT, child(0, P1), child(0, P3)];
    assert_eq!(processing_order(&fork), [0, 2, 1]);
}

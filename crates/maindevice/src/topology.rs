//! The tree of the SubDevices: parents from the open ports.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::PortNumber;
use isocat_wire::dl::DlStatus;

use crate::error::Cause;

/// The ports of one SubDevice.
#[derive(Clone, Copy)]
pub(crate) struct Ports {
    /// Register 0x0110.
    pub status: DlStatus,
    /// The port through which frames enter.
    pub entry: PortNumber,
    /// Receive times of one latch, if available.
    pub times: Option<[u32; 4]>,
}

/// The parent of each SubDevice and the port there, in processing order.
///
/// A frame visits the ports after its entry in the order 0 → 3 → 1 → 2 and enters a branch as soon
/// as it meets an open port. The processing unit is behind port 0. SubDevices on ports that are
/// visited before it come before their parent in processing order, the others after it. The former
/// exist if the cable from above is in another port than 0.
pub(crate) fn parents(ports: &[Ports]) -> Result<Vec<Option<(usize, PortNumber)>>, Cause> {
    let mut parents = vec![None; ports.len()];
    let mut trees: Vec<Tree> = Vec::new();
    for (position, own) in ports.iter().enumerate() {
        let before = own.before().count();
        for port in own.before().collect::<Vec<_>>().into_iter().rev() {
            // Larger trees than the one that ends here may hang on the port: the largest one that
            // fits the time that the frame was away.
            let away = own.away(port);
            let mut tried = trees.clone();
            while close(&mut tried, ports, &mut parents) {
                let larger = |tree: &&Tree| trees.last().is_some_and(|last| last.top != tree.top);
                let fits = |tree: &Tree| ports[tree.top].away_in_all() < away;
                if tried.last().filter(larger).is_some_and(fits) {
                    trees.clone_from(&tried);
                }
            }
            let Some(tree) = trees.pop() else { return Err(mismatch(ports)) };
            parents[tree.top] = Some((position, port));
        }
        trees.push(Tree { top: position, wanted: own.downstream().count() - before });
    }
    while close(&mut trees, ports, &mut parents) {}
    match trees[..] {
        [Tree { wanted: 0, .. }] | [] => Ok(parents),
        _ => Err(mismatch(ports)),
    }
}

/// Checks that the number of open ports fits a tree of this number of SubDevices, of any shape.
pub(crate) fn check_count(ports: &[Ports]) -> Result<(), Cause> {
    let offered: usize = ports.iter().map(|own| own.downstream().count()).sum();
    if offered + 1 == ports.len() { Ok(()) } else { Err(mismatch(ports)) }
}

fn mismatch(ports: &[Ports]) -> Cause {
    let offered = ports.iter().map(|own| own.downstream().count()).sum();
    Cause::Topology { devices: ports.len(), ports: offered }
}

/// A SubDevice with the trees behind it, as far as they are known.
#[derive(Clone, Copy)]
struct Tree {
    top: usize,
    /// Number of trees that must follow and hang on it.
    wanted: usize,
}

/// Attaches trees to the last SubDevice that needs some, if enough of them follow it; the last of
/// them may be the last of all. Returns whether there was such a SubDevice.
fn close(
    trees: &mut Vec<Tree>,
    ports: &[Ports],
    parents: &mut [Option<(usize, PortNumber)>],
) -> bool {
    let whole = trees.iter().rev().take_while(|tree| tree.wanted == 0).count();
    let Some(at) = trees.len().checked_sub(whole + 1) else { return false };
    let Tree { top, wanted } = trees[at];
    if whole < wanted {
        return false;
    }
    let after = ports[top].downstream().skip(ports[top].before().count());
    for (tree, port) in trees.drain(at + 1..=at + wanted).zip(after) {
        parents[tree.top] = Some((top, port));
    }
    trees[at].wanted = 0;
    true
}

impl Ports {
    /// The open ports after the entry, in the order in which the frame visits them.
    fn downstream(&self) -> impl Iterator<Item = PortNumber> {
        let (status, entry) = (self.status, self.entry);
        round(entry).skip(1).filter(move |port| status.open(*port))
    }

    /// Those of them that it visits before it is processed.
    fn before(&self) -> impl Iterator<Item = PortNumber> {
        let entry = self.entry;
        let own = self.downstream();
        let place = |port: PortNumber| PortNumber::PROCESSING_ORDER.iter().position(|p| *p == port);
        own.filter(move |port| {
            entry != PortNumber::P0 && (*port == PortNumber::P0 || place(*port) > place(entry))
        })
    }

    /// How long the frame was away behind a port, ns; 0 if unknown.
    fn away(&self, port: PortNumber) -> u32 {
        let open = |other: &PortNumber| self.status.open(*other) || *other == self.entry;
        let before = round(self.entry).take_while(|other| *other != port).filter(open).last();
        self.between(before.unwrap_or(self.entry), port)
    }

    /// Time from its entry until the frame was back from the last branch, ns; the longest time if
    /// unknown.
    fn away_in_all(&self) -> u32 {
        match self.times {
            Some(_) => self.between(self.entry, self.downstream().last().unwrap_or(self.entry)),
            None => u32::MAX,
        }
    }

    fn between(&self, from: PortNumber, to: PortNumber) -> u32 {
        self.times.map_or(0, |times| times[to.index()].wrapping_sub(times[from.index()]))
    }
}

/// All ports in the order in which a frame visits them.
fn round(entry: PortNumber) -> impl Iterator<Item = PortNumber> {
    let order = PortNumber::PROCESSING_ORDER;
    let at = order.iter().position(|port| *port == entry).unwrap_or(0);
    (0..4).map(move |step| order[(at + step) % 4])
}

/// The port through which frames enter, as far as the links show it: port 0 if it is open.
pub(crate) fn likely_entry(status: DlStatus) -> PortNumber {
    PortNumber::PROCESSING_ORDER
        .into_iter()
        .find(|port| status.open(*port))
        .unwrap_or(PortNumber::P0)
}

/// The port through which frames enter, by the receive times: the open port with the earliest time,
/// among those whose time differs from the latch before. Times wrap.
pub(crate) fn entry_by_times(
    status: DlStatus,
    times: &[u32; 4],
    before: Option<&[u32; 4]>,
) -> PortNumber {
    let time = |port: PortNumber| times[port.index()];
    let stale = |port: PortNumber| before.is_some_and(|before| before[port.index()] == time(port));
    PortNumber::PROCESSING_ORDER
        .into_iter()
        .filter(|port| status.open(*port) && !stale(*port))
        .reduce(|first, port| {
            let earlier = (time(port).wrapping_sub(time(first)) as i32) < 0;
            if earlier { port } else { first }
        })
        .unwrap_or(likely_entry(status))
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn open(ports: &[PortNumber]) -> Ports {
        let status = ports
            .iter()
            .fold(DlStatus::default(), |status, port| status.with_port(*port, true, false, true));
        Ports { status, entry: likely_entry(status), times: None }
    }

    fn swapped(ports: &[PortNumber], entry: PortNumber, times: [u32; 4]) -> Ports {
        Ports { entry, times: Some(times), ..open(ports) }
    }

    #[test]
    fn a_line() {
        let found = parents(&[open(&[P0, P1]), open(&[P0, P1]), open(&[P0])]).unwrap();
        assert_eq!(found, [None, Some((0, P1)), Some((1, P1))]);
    }

    /// A fork whose first branch, behind port 3, is itself a fork.
    #[test]
    fn a_fork_in_a_fork() {
        let ports =
            [open(&[P0, P3, P1]), open(&[P0, P1, P2]), open(&[P0]), open(&[P0]), open(&[P0])];
        let expected = [None, Some((0, P3)), Some((1, P1)), Some((1, P2)), Some((0, P1))];
        assert_eq!(parents(&ports).unwrap(), expected);
    }

    #[test]
    fn one_device_more_or_less_than_ports_is_an_error() {
        let two = [open(&[P0, P1]), open(&[P0, P1])];
        assert_eq!(parents(&two), Err(Cause::Topology { devices: 2, ports: 2 }));
        assert_eq!(check_count(&two), Err(Cause::Topology { devices: 2, ports: 2 }));
        let two = [open(&[P0]), open(&[P0])];
        assert_eq!(parents(&two), Err(Cause::Topology { devices: 2, ports: 0 }));
        assert_eq!(check_count(&two), Err(Cause::Topology { devices: 2, ports: 0 }));
        let hidden = [open(&[P0]), open(&[P0, P1])];
        assert!(check_count(&hidden).is_ok() && parents(&hidden).is_err(), "a swapped cable");
    }

    /// SubDevices on port 0 of one with swapped cables are processed before it.
    #[test]
    fn a_swapped_cable_turns_the_order_round() {
        let first = swapped(&[P0, P1], P1, [1500, 500, 0, 0]);
        assert_eq!(parents(&[open(&[P0]), first]).unwrap(), [Some((1, P0)), None]);
        let cross = swapped(&[P0, P1, P2, P3], P1, [1500, 500, 900, 2500]);
        let leaf = open(&[P0]);
        let expected = [Some((2, P2)), Some((2, P0)), None, Some((2, P3))];
        assert_eq!(parents(&[leaf, leaf, cross, leaf]).unwrap(), expected);
    }

    /// X, Z, Y with Y swapped: X on Y's port 0 with Z behind it, or Y on X with Z on its port 0.
    /// Only the times tell which.
    #[test]
    fn times_tell_which_of_two_trees_it_is() {
        let leaf = swapped(&[P0], P0, [0; 4]);
        let x = |away| swapped(&[P0, P1], P0, [0, away, 0, 0]);
        let y = |away: u32| swapped(&[P0, P1], P1, [away, 0, 0, 0]);
        let below = [Some((2, P0)), Some((0, P1)), None];
        assert_eq!(parents(&[x(1000), leaf, y(2000)]).unwrap(), below);
        let above = [None, Some((2, P0)), Some((0, P1))];
        assert_eq!(parents(&[x(2000), leaf, y(1000)]).unwrap(), above);
    }

    #[test]
    fn a_swapped_cable_shows_in_the_times() {
        let status = open(&[P0, P1]).status;
        let entry = |times| entry_by_times(status, &times, None);
        assert_eq!(entry([1500, 500, 0, 0]), P1);
        assert_eq!(entry([500, 1500, 0, 0]), P0);
        assert_eq!(entry([5, u32::MAX - 5, 0, 0]), P1, "wraps in between");
        // No frame comes back at this port.
        assert_eq!(entry_by_times(status, &[5000, 500, 0, 0], Some(&[1500, 500, 0, 0])), P0);
    }

    /// The way of a frame through a tree with hops of 500 ns.
    struct Walk {
        /// By SubDevice: parent with its port, and the own port upstream.
        links: Vec<(Option<(usize, PortNumber)>, PortNumber)>,
        now: u32,
        times: Vec<[u32; 4]>,
        order: Vec<usize>,
    }

    impl Walk {
        fn visit(&mut self, device: usize) {
            let entry = self.links[device].1;
            self.times[device][entry.index()] = self.now;
            for port in round(entry) {
                let child = self.links.iter().position(|link| link.0 == Some((device, port)));
                if let Some(child) = child.filter(|_| port != entry) {
                    self.now = self.now.wrapping_add(500);
                    self.visit(child);
                    self.now = self.now.wrapping_add(500);
                    self.times[device][port.index()] = self.now;
                }
                if port == P0 {
                    self.order.push(device);
                }
            }
        }
    }

    /// Random trees with every second cable swapped: the tree follows from processing order, open
    /// ports and times.
    #[test]
    fn any_tree_of_swapped_cables() {
        let mut state = 1u64;
        let mut below = |end: usize| {
            state = state.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(0x1405_7B7E_F767_814F);
            (state >> 33) as usize % end
        };
        for _ in 0..2_000 {
            let count = 1 + below(30);
            let mut links = Vec::new();
            let mut free: Vec<(usize, PortNumber)> = Vec::new();
            for device in 0..count {
                let parent = (device > 0).then(|| free.swap_remove(below(free.len())));
                let entry = if below(2) == 0 { P0 } else { PortNumber::ALL[below(4)] };
                free.extend(
                    PortNumber::ALL.map(|port| (device, port)).iter().filter(|p| p.1 != entry),
                );
                links.push((parent, entry));
            }
            let start = (below(2) * 0xFFFF_F000) as u32;
            let times = vec![[0; 4]; count];
            let mut walk = Walk { links, now: start, times, order: Vec::new() };
            walk.visit(0);
            let position = |device| walk.order.iter().position(|other| *other == device).unwrap();
            let used = |device: usize, port: PortNumber| {
                walk.links[device].1 == port
                    || walk.links.iter().any(|l| l.0 == Some((device, port)))
            };
            let ports = |device: &usize| {
                let open = PortNumber::ALL.into_iter().filter(|port| used(*device, *port));
                let status =
                    open.fold(DlStatus::default(), |s, p| s.with_port(p, true, false, true));
                let times = walk.times[*device];
                Ports { status, entry: entry_by_times(status, &times, None), times: Some(times) }
            };
            let found = parents(&walk.order.iter().map(ports).collect::<Vec<_>>()).unwrap();
            for (found, device) in found.iter().zip(&walk.order) {
                let expected = walk.links[*device].0.map(|(parent, port)| (position(parent), port));
                assert_eq!(*found, expected, "{:?}", walk.links);
            }
        }
    }
}

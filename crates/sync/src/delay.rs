//! Propagation delays from the receive times of the ports.
//!
//! A write to register 0x0900 latches, at each port of each ESC, when that frame arrived there; only
//! differences within one ESC mean anything, since each counts its own time. Frames pass the ports in
//! the order 0 → 3 → 1 → 2, so the time at a port less the time at the port used before it is the
//! round trip through the branch behind that port (ESC data sheet section I, "propagation delay
//! measurement").

use isocat_wire::address::PortNumber;
use isocat_wire::time::Nanos;

/// One SubDevice as the delay measurement sees it. Nodes stand in processing order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Node {
    /// Index of the SubDevice it hangs on, and that one's port. `None`: the first of the segment.
    pub parent: Option<(usize, PortNumber)>,
    /// The port through which frames come in; 0 unless the cables are swapped.
    pub entry: PortNumber,
    /// Ports that frames leave through.
    pub open: [bool; 4],
    /// Receive times of the ports, ns of its own counter, wrapping; `None` without distributed clocks.
    pub receive_times: Option<[u32; 4]>,
    /// Processing delay less forwarding delay of its ESC (tDiff): frames on their way out take the one,
    /// on their way back the other. Zero if it is not known.
    pub forwarding_difference: Nanos,
}

impl Node {
    fn open_ports(&self) -> usize {
        self.open.iter().filter(|open| **open).count()
    }

    /// The ports in the order in which a frame that entered at [`Node::entry`] visits them.
    fn order(&self) -> impl DoubleEndedIterator<Item = PortNumber> + '_ {
        let order = PortNumber::PROCESSING_ORDER;
        let first = order.iter().position(|port| *port == self.entry).unwrap_or(0);
        (0..4).map(move |i| order[(first + i) % 4]).filter(|port| self.open[port.index()])
    }

    /// Time from the frame's entry to its return at `port`.
    fn return_at(&self, port: PortNumber) -> Option<i64> {
        let times = self.receive_times?;
        Some(i64::from(times[port.index()].wrapping_sub(times[self.entry.index()])))
    }

    /// Time from the frame's entry until it leaves through `port`: its return at the port before.
    fn departure_at(&self, port: PortNumber) -> Option<i64> {
        let before = self.order().take_while(|p| *p != port).last()?;
        self.return_at(before)
    }

    /// Time from the frame's entry to its return from the last branch.
    fn loop_time(&self) -> Option<i64> {
        self.return_at(self.order().last()?)
    }
}

/// Writes the propagation delay of each SubDevice from the reference clock, the first with receive
/// times; `None` where it can't be known: no receive times of its own, or a branching SubDevice
/// without them in between, or times that contradict each other.
///
/// SubDevices without receive times and with two open ports count as cable. Panics if `delays` is
/// shorter than `nodes`.
pub fn propagation_delays(nodes: &[Node], delays: &mut [Option<Nanos>]) {
    let mut reference_found = false;
    for (i, node) in nodes.iter().enumerate() {
        delays[i] = if node.receive_times.is_none() {
            None
        } else if !reference_found {
            reference_found = true;
            Some(Nanos::ZERO)
        } else {
            delay_of(nodes, delays, i)
        };
    }
}

fn delay_of(nodes: &[Node], delays: &[Option<Nanos>], i: usize) -> Option<Nanos> {
    let (parent, port) = clock_above(nodes, i)?;
    let above = &nodes[parent];
    let departure = above.departure_at(port)?;
    let round_trip = above.return_at(port)? - departure;
    let both_ways = round_trip - nodes[i].loop_time()?;
    if both_ways < 0 {
        return None;
    }
    // A leaf turns frames round behind its processing unit, so they take the same both ways.
    let is_leaf = nodes[i].open_ports() < 2;
    let difference = if is_leaf { 0 } else { nodes[i].forwarding_difference.0 };
    Some(delays[parent]? + Nanos(departure + (both_ways + difference) / 2))
}

/// The next SubDevice upstream that has receive times, and its port towards node `i`.
fn clock_above(nodes: &[Node], i: usize) -> Option<(usize, PortNumber)> {
    let (mut parent, mut port) = nodes[i].parent?;
    while nodes[parent].receive_times.is_none() {
        if nodes[parent].open_ports() > 2 {
            return None;
        }
        (parent, port) = nodes[parent].parent?;
    }
    Some((parent, port))
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn node(parent: Option<(usize, PortNumber)>, ports: &[usize], times: Option<[u32; 4]>) -> Node {
        let open = core::array::from_fn(|port| ports.contains(&port));
        let forwarding_difference = Nanos::ZERO;
        Node { parent, entry: P0, open, receive_times: times, forwarding_difference }
    }

    fn delays<const N: usize>(nodes: [Node; N]) -> [Option<i64>; N] {
        let mut delays = [None; N];
        propagation_delays(&nodes, &mut delays);
        delays.map(|delay| delay.map(|d: Nanos| d.0))
    }

    /// Two LAN9252 as captured: a loop of 1440 ns, 720 ns written to the second.
    #[test]
    fn a_leaf_is_half_the_round_trip_away() {
        let first = node(None, &[0, 1], Some([0x1553_D022, 0x1553_D5C2, 7, 7]));
        let leaf = node(Some((0, P1)), &[0], Some([1234, 0, 0, 0]));
        assert_eq!(delays([first, leaf]), [Some(0), Some(720)]);
    }

    /// EK1100 and E-bus neighbours as captured: delays 0, 145, 300 ns.
    #[test]
    fn a_line_takes_off_what_lies_behind() {
        let nodes = [
            node(None, &[0, 1], Some([0x3C62_0F52, 0x3C62_11AA, 0, 0])),
            node(Some((0, P1)), &[0, 1], Some([0x3D0B_D6AE, 0x3D0B_D7E4, 0, 0])),
            node(Some((1, P1)), &[0], Some([99, 0, 0, 0])),
        ];
        assert_eq!(delays(nodes), [Some(0), Some(145), Some(300)]);
    }

    /// A fork: behind port 3 a leaf (round trip 1000), behind port 1 a leaf (round trip 600). The
    /// second is reached only after the whole first branch.
    /// Out through 155 ns of processing, back through 135 ns of forwarding, 100 ns of cable: known, the
    /// difference gives the true delays.
    #[test]
    fn the_difference_of_the_directions_counts_unless_the_child_is_a_leaf() {
        let mut nodes = [
            // Through the middle one and back: its own loop of 510 ns, its forwarding, two cables.
            node(None, &[0, 1], Some([0, 155 + 100 + 510 + 135 + 100, 0, 0])),
            node(Some((0, P1)), &[0, 1], Some([0, 155 + 100 + 155 + 100, 0, 0])),
            node(Some((1, P1)), &[0], Some([0; 4])),
        ];
        assert_eq!(delays(nodes), [Some(0), Some(245), Some(245 + 255)]);
        nodes[1].forwarding_difference = Nanos(20);
        assert_eq!(delays(nodes), [Some(0), Some(255), Some(255 + 255)]);
    }

    #[test]
    fn later_branches_wait_for_earlier_ones() {
        let nodes = [
            node(None, &[0, 1, 3], Some([100, 1700, 0, 1100])),
            node(Some((0, P3)), &[0], Some([5, 0, 0, 0])),
            node(Some((0, P1)), &[0], Some([5, 0, 0, 0])),
        ];
        assert_eq!(delays(nodes), [Some(0), Some(500), Some(1000 + 300)]);
    }

    #[test]
    fn devices_without_clocks_are_cable_unless_they_branch() {
        let leaf = |parent, port| node(Some((parent, port)), &[0], Some([0; 4]));
        let first = node(None, &[0, 1], Some([0, 2000, 0, 0]));
        let plain = node(Some((0, P1)), &[0, 1], None);
        assert_eq!(delays([first, plain, leaf(1, P1)]), [Some(0), None, Some(1000)]);
        let branching = node(Some((0, P1)), &[0, 1, 2], None);
        assert_eq!(delays([first, branching, leaf(1, P1)]), [Some(0), None, None]);
    }

    #[test]
    fn counters_may_wrap_between_the_ports() {
        let first = node(None, &[0, 1], Some([u32::MAX - 99, 1340, 0, 0]));
        let leaf = node(Some((0, P1)), &[0], Some([0; 4]));
        assert_eq!(delays([first, leaf]), [Some(0), Some(720)]);
    }

    #[test]
    fn a_child_slower_than_its_branch_is_a_contradiction() {
        let first = node(None, &[0, 1], Some([0, 500, 0, 0]));
        let middle = node(Some((0, P1)), &[0, 1], Some([0, 501, 0, 0]));
        assert_eq!(delays([first, middle])[1], None);
        let middle = node(Some((0, P1)), &[0, 1], Some([0, 500, 0, 0]));
        assert_eq!(delays([first, middle])[1], Some(0));
    }

    /// Cable plugged into port 1: frames come in there and go on 2 → 0.
    #[test]
    fn the_entry_port_may_be_another() {
        let first = node(None, &[0, 1], Some([0, 3000, 0, 0]));
        let swapped = Node {
            parent: Some((0, P1)),
            entry: P1,
            open: [true, true, false, false],
            receive_times: Some([1500, 500, 0, 0]),
            forwarding_difference: Nanos::ZERO,
        };
        let leaf = node(Some((1, P0)), &[0], Some([0; 4]));
        assert_eq!(delays([first, swapped, leaf]), [Some(0), Some(1000), Some(1500)]);
    }
}

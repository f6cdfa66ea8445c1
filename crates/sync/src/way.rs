//! Propagation delays from the parts of a segment: cables, PHYs, and the stay of frames in chips.
//!
//! This serves a segment that cannot be measured yet. A frame that enters an ESC leaves through its
//! open ports in the order 0 → 3 → 1 → 2, comes back from each branch through the same port, and
//! goes back upstream last. The processing unit is between port 0 and port 3: the stay that passes
//! it takes the processing delay, each other stay the forwarding delay.

use isocat_wire::PortNumber;
use isocat_wire::time::Picos;

/// One SubDevice with its connection. SubDevices are in processing order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cabled {
    /// Its parent and the parent's port. `None`: the MainDevice.
    pub parent: Option<(usize, PortNumber)>,
    /// Its own port upstream.
    pub entry: PortNumber,
    /// Delay from the parent's port to its own: PHY, cable, PHY.
    pub out: Picos,
    /// The same delay on the way back.
    pub back: Picos,
    /// A stay through the processing unit.
    pub processing: Picos,
    /// A stay past the processing unit.
    pub forwarding: Picos,
}

/// The result of [`propagation`] for one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Way {
    /// Time from the frame's arrival at the first SubDevice to its arrival here.
    pub delay: Picos,
    /// Time from its arrival here until it leaves upstream after all branches.
    round: Picos,
    /// Time from its arrival here until its return from the branches so far.
    spent: Picos,
    /// The port at which it last came back.
    last: Option<PortNumber>,
}

/// Computes the way to each SubDevice. Panics if `ways` is shorter than `nodes`, or if a parent
/// comes after its child.
pub fn propagation(nodes: &[Cabled], ways: &mut [Way]) {
    for (way, node) in ways.iter_mut().zip(nodes) {
        // One stay passes the processing unit, whichever ports are open.
        *way = Way { round: node.processing, ..Way::default() };
    }
    for (child, node) in nodes.iter().enumerate().rev() {
        if let Some((parent, _)) = node.parent {
            let branch = node.out + ways[child].round + node.back + nodes[parent].forwarding;
            ways[parent].round += branch;
        }
    }
    for (child, node) in nodes.iter().enumerate() {
        let Some((parent, port)) = node.parent else { continue };
        let above = &nodes[parent];
        let from = ways[parent].last.unwrap_or(above.entry);
        let stay = if passes_unit(from, port) { above.processing } else { above.forwarding };
        let departure = ways[parent].spent + stay;
        ways[child].delay = ways[parent].delay + departure + node.out;
        ways[parent].spent = departure + node.out + ways[child].round + node.back;
        ways[parent].last = Some(port);
    }
}

/// Whether the way from one open port to the next leads from port 0 to port 3.
fn passes_unit(from: PortNumber, to: PortNumber) -> bool {
    let place = |port| PortNumber::PROCESSING_ORDER.iter().position(|other| *other == port);
    let (from, to) = (place(from), place(to));
    from == Some(0) || (to != Some(0) && to <= from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn node(parent: Option<(usize, PortNumber)>, entry: PortNumber) -> Cabled {
        let (out, back) = (Picos(50_000), Picos(51_000));
        let (processing, forwarding) = (Picos(155_000), Picos(135_000));
        Cabled { parent, entry, out, back, processing, forwarding }
    }

    fn delays<const N: usize>(nodes: [Cabled; N]) -> [i64; N] {
        let mut ways = [Way::default(); N];
        propagation(&nodes, &mut ways);
        ways.map(|way| way.delay.0)
    }

    #[test]
    fn a_line() {
        let line = [node(None, P0), node(Some((0, P1)), P0), node(Some((1, P1)), P0)];
        assert_eq!(delays(line), [0, 205_000, 410_000]);
    }

    /// A fork: the frame enters the second branch after the whole of the first, a line of two.
    #[test]
    fn a_fork() {
        let nodes = [
            node(None, P0),
            node(Some((0, P3)), P0),
            node(Some((1, P1)), P0),
            node(Some((0, P1)), P0),
        ];
        // The branch: 155 + 50, round of two devices (155 + 50 + 155 + 51 + 135), 51, 135, 50.
        let branch = 155 + 50 + (155 + 50 + 155 + 51 + 135) + 51 + 135 + 50;
        assert_eq!(delays(nodes), [0, 205_000, 410_000, branch * 1_000]);
    }

    /// With the upstream cable in port 1 a frame leaves through port 0 before it passes the
    /// processing unit.
    #[test]
    fn a_swapped_cable() {
        assert_eq!(delays([node(None, P1), node(Some((0, P0)), P0)]), [0, 185_000]);
        assert!(passes_unit(P1, P3) && passes_unit(P0, P2) && passes_unit(P1, P1));
        assert!(!passes_unit(P3, P1) && !passes_unit(P2, P0));
    }
}

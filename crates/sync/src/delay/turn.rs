//! A segment as frames from its other end see it.

use isocat_wire::address::PortNumber;

use super::Node;

/// Turns the tree round: frames now come into node `last` through its port `port`, as those from the second port
/// of a MainDevice do behind the cut of a ring. All that hung on the way from the first to the last keeps its place.
///
/// The receive times must be those of a frame from that side, and [`Node::open`] as it was then: behind a cut the
/// port towards it is closed. Nodes that frames from there do not reach (on the near side of the cut) keep what
/// they have; their delays come from the frames of their own side. While the ring is whole no frame comes back
/// the way it went, and nothing can be measured in either direction.
pub fn turn(nodes: &mut [Node], last: usize, port: PortNumber) {
    let (mut at, mut entry, mut parent) = (last, port, None);
    // A chain longer than all nodes would go round for ever.
    for _ in 0..nodes.len() {
        let Some(node) = nodes.get_mut(at) else { return };
        let (above, own) = (node.parent, node.entry);
        (node.parent, node.entry) = (parent, entry);
        // What is above hangs below from now on, unless the cut lies between.
        let Some((next, its_port)) = above.filter(|_| node.open[own.index()]) else { return };
        (parent, at, entry) = (Some((at, own)), next, its_port);
    }
}

//! The tree of a segment for frames that come from its other end.

use isocat_wire::address::PortNumber;

use super::Node;

/// Turns the tree round: frames now enter node `last` through its port `port`. Frames from the
/// second port of a MainDevice do so behind the cut of a ring. Nodes that hang on the way from the
/// first to the last keep their places.
///
/// The receive times must be those of a frame from that side, and so must [`Node::open`]: behind a
/// cut the port towards it is closed. Nodes on the near side of the cut, which those frames do not
/// reach, keep their values; their delays come from the frames of their own side. While the ring is
/// whole no frame returns on the way it went, so nothing can be measured in either direction.
pub fn turn(nodes: &mut [Node], last: usize, port: PortNumber) {
    let (mut at, mut entry, mut parent) = (last, port, None);
    // The limit ends the loop for parents that form a circle.
    for _ in 0..nodes.len() {
        let Some(node) = nodes.get_mut(at) else { return };
        let (above, own) = (node.parent, node.entry);
        (node.parent, node.entry) = (parent, entry);
        // The former parent becomes a child, unless the cut lies between.
        let Some((next, its_port)) = above.filter(|_| node.open[own.index()]) else { return };
        (parent, at, entry) = (Some((at, own)), next, its_port);
    }
}

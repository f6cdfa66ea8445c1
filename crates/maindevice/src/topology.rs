//! Who hangs on whom: parents from the ports that are open.

use alloc::vec::Vec;

use isocat_wire::PortNumber;
use isocat_wire::dl::DlStatus;

use crate::error::Cause;

/// The parent of each SubDevice and the port there, in processing order. `ports` holds the DL
/// status of each and the port through which frames come in.
///
/// A frame visits the ports after its entry in the order 0 → 3 → 1 → 2 and goes down a branch as
/// soon as it meets an open port, so the SubDevices behind it follow in processing order.
pub(crate) fn parents(
    ports: &[(DlStatus, PortNumber)],
) -> Result<Vec<Option<(usize, PortNumber)>>, Cause> {
    let mut parents = Vec::with_capacity(ports.len());
    // Open ports that still wait for a SubDevice; the next one hangs on the last.
    let mut waiting: Vec<(usize, PortNumber)> = Vec::new();
    let mut offered = 0;
    for (position, (status, entry)) in ports.iter().enumerate() {
        let parent = waiting.pop();
        if parent.is_none() && position > 0 {
            return Err(Cause::Topology { devices: ports.len(), ports: offered });
        }
        parents.push(parent);
        let first = waiting.len();
        waiting.extend(downstream(*status, *entry).map(|port| (position, port)));
        waiting[first..].reverse();
        offered += waiting.len() - first;
    }
    if waiting.is_empty() {
        Ok(parents)
    } else {
        Err(Cause::Topology { devices: ports.len(), ports: offered })
    }
}

/// The open ports after the entry, in the order in which the frame visits them.
fn downstream(status: DlStatus, entry: PortNumber) -> impl Iterator<Item = PortNumber> {
    let order = PortNumber::PROCESSING_ORDER;
    let at = order.iter().position(|port| *port == entry).unwrap_or(0);
    (1..4).map(move |step| order[(at + step) % 4]).filter(move |port| status.open(*port))
}

/// The port through which frames come in, as far as the links tell it: port 0 if it is open.
pub(crate) fn likely_entry(status: DlStatus) -> PortNumber {
    PortNumber::PROCESSING_ORDER
        .into_iter()
        .find(|port| status.open(*port))
        .unwrap_or(PortNumber::P0)
}

/// The port through which frames come in, by the receive times: the open one with the earliest.
/// Times wrap.
pub(crate) fn entry_by_times(status: DlStatus, times: &[u32; 4]) -> PortNumber {
    let time = |port: PortNumber| times[port.index()];
    PortNumber::PROCESSING_ORDER
        .into_iter()
        .filter(|port| status.open(*port))
        .reduce(|first, port| {
            let earlier = (time(port).wrapping_sub(time(first)) as i32) < 0;
            if earlier { port } else { first }
        })
        .unwrap_or(PortNumber::P0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn open(ports: &[PortNumber]) -> (DlStatus, PortNumber) {
        let status = ports
            .iter()
            .fold(DlStatus::default(), |status, port| status.with_port(*port, true, false, true));
        (status, likely_entry(status))
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
        let two = [open(&[P0]), open(&[P0])];
        assert_eq!(parents(&two), Err(Cause::Topology { devices: 2, ports: 0 }));
    }

    #[test]
    fn a_swapped_cable_shows_in_the_times() {
        let (status, _) = open(&[P0, P1]);
        assert_eq!(entry_by_times(status, &[1500, 500, 0, 0]), P1);
        assert_eq!(entry_by_times(status, &[500, 1500, 0, 0]), P0);
        assert_eq!(entry_by_times(status, &[5, u32::MAX - 5, 0, 0]), P1, "wraps in between");
    }
}

//! Compares the SubDevices that answer with the tree of the scan.

use alloc::collections::{BTreeMap, BTreeSet};
use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::PortNumber;

use crate::health::Found;
use crate::segment::{Segment, SubDevice};

/// The place in the processing order at which each position answers, by position; `None`: it does
/// not answer.
///
/// A SubDevice is present if its parent is and the parent's port to it is open. `Err`: this does
/// not agree with the SubDevices that answer, for example while a link comes up, or after cables
/// were changed. `is_out`: a different device was found in the place of this SubDevice, so the next
/// one that may hang there is tried.
pub(crate) fn places(
    segment: &Segment,
    everybody: &[Found],
    is_out: impl Fn(usize) -> bool,
) -> Result<Vec<Option<usize>>, ()> {
    let mut places: Vec<Option<usize>> = vec![None; segment.devices.len()];
    let mut next = 0;
    let stations = segment.devices.iter().filter(|device| device.admitted);
    let stations: BTreeMap<_, _> =
        stations.map(|device| (device.station.0, device.position)).collect();
    // Ports at which one of the possible SubDevices hangs.
    let mut occupied = BTreeSet::new();
    for (position, device) in segment.devices.iter().enumerate() {
        let there = match device.parent {
            None => position == 0,
            Some((above, port)) => is_open(&places, everybody, above, port),
        };
        // Only one of the SubDevices that may hang at one port does: the first that was not found
        // to be a different one.
        let shares = |other: &&SubDevice| position > 0 && other.parent == device.parent;
        let port = device.parent.map(|(above, port)| (above, port.index()));
        let behind = &segment.devices[position + 1..];
        let mut next_turn = behind.iter().filter(shares).filter(|other| !other.admitted);
        let out = !device.admitted && is_out(position);
        if !there
            || occupied.contains(&port)
            || out && next_turn.any(|other| !is_out(other.position))
        {
            continue;
        }
        let found = everybody.get(next).ok_or(())?;
        if device.admitted && found.station != device.station {
            return Err(());
        }
        // A known SubDevice is at another place.
        if stations.get(&found.station.0).is_some_and(|known| *known != position) {
            return Err(());
        }
        places[position] = Some(next);
        occupied.insert(port);
        next += 1;
    }
    if next == everybody.len() { Ok(places) } else { Err(()) }
}

fn is_open(places: &[Option<usize>], everybody: &[Found], above: usize, port: PortNumber) -> bool {
    let place = places.get(above).copied().flatten();
    place.and_then(|at| everybody.get(at)).is_some_and(|found| found.dl_status.open(port))
}

#[cfg(test)]
pub(super) mod tests {
    use isocat_wire::StationAddress;
    use isocat_wire::dl::DlStatus;

    use super::*;

    /// A fork with a branch of two at port 1 and a branch of one at port 2.
    pub fn fork() -> Segment {
        let device = |(position, parent): (usize, Option<(usize, PortNumber)>)| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            device.parent = parent;
            device
        };
        let above =
            [None, Some((0, PortNumber::P1)), Some((1, PortNumber::P1)), Some((0, PortNumber::P2))];
        Segment {
            devices: above.into_iter().enumerate().map(device).collect(),
            ..Segment::default()
        }
    }

    /// A SubDevice with an address and the ports at which frames continue.
    fn found(station: u16, ports: &[PortNumber]) -> Found {
        let open = |status: DlStatus, port: &PortNumber| status.with_port(*port, true, false, true);
        let dl_status = ports.iter().fold(DlStatus::default(), open);
        Found { station: StationAddress(station), dl_status }
    }

    fn stand(segment: &Segment, everybody: &[Found]) -> Result<Vec<Option<usize>>, ()> {
        places(segment, everybody, |_| false)
    }

    /// Two groups share one port: a pair and a single SubDevice.
    #[test]
    fn whose_turn_it_is_at_a_port_that_several_may_hang_at() {
        use PortNumber::{P0, P1, P2};
        let mut segment = fork();
        let mut other = SubDevice::new(4, StationAddress(0x1005));
        other.parent = Some((0, P2));
        segment.devices.push(other);
        for device in &mut segment.devices[3..] {
            device.admitted = false;
        }
        let pair = [found(0x1002, &[P0, P1]), found(0x1003, &[P0])];
        let mut all = vec![found(0x1001, &[P0, P1, P2])];
        all.extend(pair);
        all.push(found(0, &[P0]));
        let line = [Some(0), Some(1), Some(2)];
        let stands = |out: &[usize]| {
            let places = places(&segment, &all, |position| out.contains(&position));
            places.map(|places| (places[..3] == line, places[3], places[4]))
        };
        assert_eq!(stands(&[]), Ok((true, Some(3), None)));
        assert_eq!(stands(&[3]), Ok((true, None, Some(3))));
        assert_eq!(stands(&[3, 4]), Ok((true, Some(3), None)), "a stranger, whoever it is");
    }

    #[test]
    fn who_stands_where_follows_from_open_ports() {
        use PortNumber::{P0, P1, P2};
        let mut segment = fork();
        segment.devices[1].admitted = false;
        segment.devices[2].admitted = false;
        let fork = found(0x1001, &[P0, P1, P2]);
        let right = found(0x1004, &[P0]);
        // Both are back; only the first; none.
        let all = [fork, found(0, &[P0, P1]), found(0x1003, &[P0]), right];
        assert_eq!(stand(&segment, &all), Ok(vec![Some(0), Some(1), Some(2), Some(3)]));
        let one = [fork, found(0, &[P0]), right];
        assert_eq!(stand(&segment, &one), Ok(vec![Some(0), Some(1), None, Some(2)]));
        let none = [found(0x1001, &[P0, P2]), right];
        assert_eq!(stand(&segment, &none), Ok(vec![Some(0), None, None, Some(1)]));
        // Rejected: an open port without a SubDevice behind it yet; one more than the tree has; a
        // known one at another place.
        assert_eq!(stand(&segment, &[fork, right]), Err(()));
        let more = [fork, found(0, &[P0]), right, found(0, &[P0])];
        assert_eq!(stand(&segment, &more), Err(()));
        assert_eq!(stand(&segment, &[fork, right, found(0, &[P0])]), Err(()));
    }
}

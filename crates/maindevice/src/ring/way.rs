//! The ring during bring-up: a line, with the port to the other end closed.

use alloc::vec::Vec;

use isocat_wire::PortNumber;
use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, Value};

use crate::board::{RingState, View};
use crate::error::{Cause, Place, RingProblem};
use crate::link::Link;
use crate::segment::Segment;

/// Checks that the ring can be used, as far as the frames so far show it.
pub(crate) fn check(link: &Link) -> Result<(), Cause> {
    let problem = match link.board(|board| board.ring.map(|ring| ring.view)) {
        Some(View::Cut { near, far }) if far > 0 => RingProblem::Cut { near, far },
        Some(View::Reverse) => RingProblem::Reverse,
        _ => return Ok(()),
    };
    Err(Cause::Ring(problem))
}

/// Makes a line of the ring: closes the port through which the last SubDevice sends to the
/// secondary port. It does nothing without a ring, or if no SubDevice sends there.
pub(crate) async fn close(link: &Link, segment: &Segment) -> Result<(), Cause> {
    if link.board(|board| board.ring.is_none()) {
        return Ok(());
    }
    check(link)?;
    let address = register::DL_STATUS.address;
    let all = segment.devices.iter();
    let reads: Vec<_> = all.map(|device| link.fprd(device.station, address, 2)).collect();
    let mut open = Vec::with_capacity(reads.len());
    for read in reads {
        let bytes = read.expect(1).await?.data;
        let status = DlStatus::from_bytes(bytes.first_chunk().copied().unwrap_or_default());
        open.push(PortNumber::ALL.map(|port| status.open(port)));
    }
    let place = |position: usize| Place { position, name: segment.devices[position].name.clone() };
    let exit = exit(&open).map_err(|(position, port)| {
        Cause::Ring(RingProblem::Branch { place: place(position), port })
    })?;
    let exit_of = exit.map(|(position, _)| segment.devices[position].station);
    // From here on only one port sends; if a later step fails, the write is undone.
    link.board(|board| {
        if let Some(ring) = &mut board.ring {
            (ring.line, ring.exit) = (true, exit_of);
        }
    });
    if let (Some((position, port)), Some(station)) = (exit, exit_of) {
        let loops: u8 = CLOSED << (2 * port.index());
        link.fpwr(station, LOOPS, &loops.to_bytes()).expect(1).await?;
        let status = link.read(station, register::DL_STATUS).await?;
        if status.open(port) {
            return Err(Cause::Ring(RingProblem::Open { place: place(position), port }));
        }
    }
    Ok(())
}

/// Makes the line a ring again.
pub(crate) async fn open(link: &Link) -> Result<(), Cause> {
    if let Some(station) = link.board(|board| board.ring.and_then(|ring| ring.exit)) {
        link.fpwr(station, LOOPS, &AUTOMATIC.to_bytes()).expect(1).await?;
    }
    link.board(|board| board.ring.iter_mut().for_each(|ring| *ring = RingState::default()));
    Ok(())
}

/// Whether a closed port must be opened before the run ends.
pub(crate) fn is_closed(link: &Link) -> bool {
    link.board(|board| board.ring.is_some_and(|ring| ring.exit.is_some()))
}

/// The port at which frames leave for the other end, if there is one: all SubDevices have been
/// passed by then. SubDevices behind a later port would only be reached by frames from the other
/// end, so that port is the error.
fn exit(open: &[[bool; 4]]) -> Result<Option<(usize, PortNumber)>, (usize, PortNumber)> {
    let downstream = |position: usize| {
        // In reverse order, since they are taken from the end.
        let ports = [PortNumber::P2, PortNumber::P1, PortNumber::P3].into_iter();
        ports.filter(move |port| open[position][port.index()]).map(move |port| (position, port))
    };
    let mut ways: Vec<(usize, PortNumber)> = Vec::new();
    for position in 0..open.len() {
        if position > 0 && ways.pop().is_none() {
            // More SubDevices answer than the ports lead to; the topology check reports that.
            return Ok(None);
        }
        ways.extend(downstream(position));
    }
    let exit = ways.pop();
    match ways.first() {
        Some(behind) => Err(*behind),
        None => Ok(exit),
    }
}

/// Loop control of the ports, two bits each, in DL control.
const LOOPS: u16 = register::DL_CONTROL.address + 1;
const AUTOMATIC: u8 = 0;
const CLOSED: u8 = 0b11;

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn found(ports: &[&[PortNumber]]) -> Result<Option<(usize, PortNumber)>, (usize, PortNumber)> {
        let open: Vec<_> =
            ports.iter().map(|open| PortNumber::ALL.map(|port| open.contains(&port))).collect();
        exit(&open)
    }

    #[test]
    fn the_exit_is_where_no_device_is_left() {
        assert_eq!(found(&[&[P0, P1], &[P0, P1]]), Ok(Some((1, P1))));
        assert_eq!(found(&[&[P0, P1], &[P0]]), Ok(None), "a line");
        // A branch at port 3 of the first comes before the way on, and one at port 1 of the last
        // before port 2.
        assert_eq!(found(&[&[P0, P3, P1], &[P0, P1], &[P0], &[P0, P1]]), Ok(Some((3, P1))));
        assert_eq!(found(&[&[P0, P1], &[P0, P1, P2], &[P0]]), Ok(Some((1, P2))));
        assert_eq!(found(&[]), Ok(None));
        assert_eq!(found(&[&[P0], &[P0]]), Ok(None), "no tree at all");
    }

    /// Frames leave at port 1 for the other end and never reach port 2.
    #[test]
    fn a_branch_behind_the_exit_is_named() {
        assert_eq!(found(&[&[P0, P1, P2], &[P0, P1]]), Err((0, P2)));
    }
}

//! Compares the frames of a cycle: those for process data, for the clocks and for the states.

use isocat_descriptions::start_up::{Address, CyclicDatagram, StartUp};
use isocat_wire::al::AlState;
use isocat_wire::frame::duration_ns;
use isocat_wire::time::Nanos;
use isocat_wire::{Command, register};

use super::{Difference, Kind};
use crate::cyclic::is_drift;

pub(super) fn compare(eni: &StartUp, ours: &StartUp) -> Vec<Difference> {
    let mut all = Vec::new();
    let mut differ = |kind, place: &str, one: String, other: String, consequence: &str| {
        if one != other {
            all.push(Difference {
                position: None,
                kind,
                transition: None,
                place: place.into(),
                eni: Some(one),
                plan: Some(other),
                consequence: consequence.into(),
            });
        }
    };
    differ(
        Kind::Frames,
        "process data of a cycle",
        process_data(eni),
        process_data(ours),
        "outputs and inputs travel in other datagrams: LRW carries both at once, and a device that can't take it needs LWR \
         and LRD",
    );
    differ(
        Kind::Frames,
        "wire time of a cycle",
        wire_time(eni),
        wire_time(ours),
        "process data reach the devices earlier or later in the cycle",
    );
    let drift = |list: &StartUp| {
        let one = in_op(list).find(|datagram| is_drift(datagram));
        one.map_or("none".into(), |one| format!("{} of {} bytes", one.command, one.length))
    };
    differ(
        Kind::DriftDatagram,
        "system time of a cycle",
        drift(eni),
        drift(ours),
        "ARMW and FRMW do the same by position and by station address; 4 bytes are the lower half of the time. Without \
         either, clocks run apart",
    );
    let watch = |list: &StartUp| {
        let one = in_op(list).find(|one| is_state_watch(one));
        one.map_or("none".to_owned(), |one| format!("{} of {} bytes", one.command, one.length))
    };
    differ(
        Kind::StateWatch,
        "AL status of a cycle",
        watch(eni),
        watch(ours),
        "without the broadcast, a device that leaves OP is noticed by its working counter alone",
    );
    all
}

fn in_op(list: &StartUp) -> impl Iterator<Item = &CyclicDatagram> {
    let all = list.frames.iter().flat_map(|frame| &frame.datagrams);
    all.filter(|one| one.states.is_empty() || one.states.contains(&AlState::Op))
}

fn is_state_watch(datagram: &CyclicDatagram) -> bool {
    datagram.command == Command::Brd
        && matches!(datagram.address, Address::Physical { register, .. } if register == register::AL_STATUS.address)
}

/// Commands and bytes of the logical datagrams.
fn process_data(list: &StartUp) -> String {
    let logical = in_op(list).filter(|one| matches!(one.address, Address::Logical(_)));
    let all: Vec<_> = logical.map(|one| format!("{} {}", one.command, one.length)).collect();
    if all.is_empty() { "none".into() } else { all.join(", ") }
}

/// The time on the wire of all frames of the fullest cycle.
fn wire_time(list: &StartUp) -> String {
    let length = |datagrams: &[CyclicDatagram]| {
        let sent = datagrams
            .iter()
            .filter(|one| one.states.is_empty() || one.states.contains(&AlState::Op));
        let bytes: usize = sent.map(|one| usize::from(one.length) + 12).sum();
        (bytes + 16).max(isocat_wire::frame::MIN_LEN)
    };
    let time: u64 = list.frames.iter().map(|frame| duration_ns(length(&frame.datagrams))).sum();
    Nanos(time as i64).to_string()
}

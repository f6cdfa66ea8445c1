//! How a tap saw the segment: the direction of frames, and the number of SubDevices before the tap.

use std::collections::BTreeSet;

use isocat_wire::Command;
use isocat_wire::datagram::datagrams;
use isocat_wire::frame::{LOCALLY_ADMINISTERED, payload};

use super::{SOURCE, Signature, is_marked};
use crate::reading::Frame;

/// Which frames the tap saw.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Seen {
    /// Frames on their way out and on their way back.
    Both,
    /// Only frames on their way out: the answers of the devices are not known.
    Out,
    /// Only frames that have passed devices: when they left is not known.
    Back,
}

/// How a tap saw the segment, by its first frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Tap {
    /// Which frames it saw.
    pub seen: Seen,
    /// Bit 1 of the source address distinguishes answers from requests; false: the content does.
    pub marked: bool,
    /// The file distinguishes the two directions.
    pub directed: bool,
    /// SubDevices that a frame has passed before the tap first sees it; 0 at the MainDevice's port.
    pub behind: u16,
    /// The interface of the MainDevice's port, if a file has several; `None`: all interfaces count.
    pub interface: Option<u32>,
    /// Both ends of a ring were captured: the MainDevice sends from two interfaces, and this is the
    /// address of its first port. Its frames from the other port carry the same datagrams.
    pub ring: Option<[u8; 6]>,
}

impl Tap {
    /// Decides by these frames, which are the first of the file.
    pub(super) fn of(frames: &[(Frame, Signature)]) -> Self {
        let marked = tells_by_mark(frames);
        let ring = first_of_two_ports(frames, marked);
        let interface = main_interface(frames, marked).filter(|_| ring.is_none());
        let ours: Vec<&Frame> = frames
            .iter()
            .map(|(frame, _)| frame)
            .filter(|frame| interface.is_none_or(|interface| frame.interface == interface))
            .collect();
        let answers = ours.iter().filter(|frame| is_marked(&frame.bytes)).count();
        let counted = ours.iter().any(|frame| counts(frame).any(|(_, wkc)| wkc > 0));
        let directed =
            [true, false].iter().all(|way| ours.iter().any(|frame| frame.sent == Some(*way)));
        let (seen, behind) = match marked {
            true if answers == 0 => (Seen::Out, 0),
            true if answers == ours.len() => (Seen::Back, 0),
            true => (Seen::Both, 0),
            false if !counted => (Seen::Out, 0),
            false => (Seen::Both, least_position(&ours)),
        };
        Self { seen, marked, directed, behind, interface, ring }
    }

    /// Whether the source address marks this frame as an answer.
    pub(super) fn is_answer(self, frame: &Frame) -> bool {
        self.marked && is_marked(&frame.bytes)
    }
}

/// Whether the source addresses distinguish answers from requests: two addresses differ in that bit
/// alone, or all frames go one way.
fn tells_by_mark(frames: &[(Frame, Signature)]) -> bool {
    let mut asking = BTreeSet::new();
    let mut answering = BTreeSet::new();
    for (frame, _) in frames {
        let Some(source) = frame.bytes.get(SOURCE..SOURCE + 6) else { continue };
        let mut address = source.to_vec();
        address[0] |= LOCALLY_ADMINISTERED;
        match is_marked(&frame.bytes) {
            true => answering.insert(address),
            false => asking.insert(address),
        };
    }
    if !asking.is_disjoint(&answering) {
        return true;
    }
    if asking.is_empty() && !frames.iter().any(|(frame, _)| counts(frame).any(|(_, n)| n > 0)) {
        // The MainDevice's own address has the bit, and no device has answered.
        return false;
    }
    !pairs_by_content(frames)
}

/// Whether neighbouring frames with the same datagrams differ in what devices count: then one is
/// the answer to the other. In a sequence of answers alone, all count the same.
fn pairs_by_content(frames: &[(Frame, Signature)]) -> bool {
    let (mut differ, mut alike) = (0, 0);
    for pair in frames.windows(2) {
        let [(one, a), (other, b)] = pair else { continue };
        if a != b || one.bytes.get(SOURCE..SOURCE + 6) != other.bytes.get(SOURCE..SOURCE + 6) {
            continue;
        }
        match counts(one).eq(counts(other)) {
            true => alike += 1,
            false => differ += 1,
        }
    }
    differ > alike
}

/// For each datagram, the values that devices count up: position, if the command has one, and
/// working counter.
pub(super) fn counts(frame: &Frame) -> impl Iterator<Item = (u16, u16)> {
    let payload = payload(&frame.bytes).unwrap_or(&[]);
    datagrams(payload).map_while(Result::ok).map(|datagram| {
        let counts = datagram.header.command().is_ok_and(Command::increments_position);
        (if counts { datagram.header.adp() } else { 0 }, datagram.wkc)
    })
}

/// The smallest position in a broadcast. MainDevices send 0, and each device adds 1.
fn least_position(frames: &[&Frame]) -> u16 {
    let positions = frames.iter().flat_map(|frame| {
        let payload = payload(&frame.bytes).unwrap_or(&[]);
        datagrams(payload).map_while(Result::ok).filter_map(|datagram| {
            let command = datagram.header.command().ok()?;
            matches!(command, Command::Brd | Command::Bwr | Command::Brw)
                .then_some(datagram.header.adp())
        })
    });
    positions.min().unwrap_or(0)
}

/// The address of the first port, if frames leave from several interfaces with different addresses.
fn first_of_two_ports(frames: &[(Frame, Signature)], marked: bool) -> Option<[u8; 6]> {
    let sent = frames.iter().map(|(frame, _)| frame).filter(|frame| !is_marked(&frame.bytes));
    let mut ports = sent.filter_map(|frame| Some((frame.interface, source(frame)?)));
    let (first, address) = ports.next().filter(|_| marked)?;
    let is_other = |(interface, source): (u32, [u8; 6])| interface != first && source != address;
    ports.any(is_other).then_some(address)
}

/// The source address without the bit that the first SubDevice sets.
pub(super) fn source(frame: &Frame) -> Option<[u8; 6]> {
    let mut address: [u8; 6] = frame.bytes.get(SOURCE..)?.first_chunk().copied()?;
    address[0] &= !LOCALLY_ADMINISTERED;
    Some(address)
}

/// The interface of the first frame, if it sees answers too or answers are not marked; `None`: all
/// interfaces count.
fn main_interface(frames: &[(Frame, Signature)], marked: bool) -> Option<u32> {
    let (first, _) = frames.first()?;
    let port = first.interface;
    let mut both = frames.iter().filter(|(frame, _)| frame.interface == port);
    let answers = both.any(|(frame, _)| is_marked(&frame.bytes));
    (!marked || answers).then_some(port)
}

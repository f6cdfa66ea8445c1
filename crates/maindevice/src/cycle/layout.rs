//! The content of each frame of a cycle, and its time on the wire.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN};
use isocat_wire::frame::{MAX_LEN, MIN_LEN, duration_ns};
use isocat_wire::register;
use isocat_wire::time::Nanos;

use super::frames::Part;
use crate::segment::{DatagramPlan, FramePlan, GAP, ProcessImage, Segment};

/// The content of one frame.
pub(super) struct Parts {
    /// The frame leaves in the bus cycles whose number is a multiple of this.
    pub(super) every: u32,
    pub(super) parts: Vec<Part>,
}

/// The content of each frame of a cycle. No chunk is divided, so no SubDevice is. `clock`: whether
/// there is a reference clock, and whether it is controlled.
///
/// Frames of every cycle come first and are the same in each cycle; the chunks already have this
/// order.
pub(super) fn plan_frames(
    image: &ProcessImage,
    clock: (bool, bool),
    exchanging: bool,
) -> Vec<Parts> {
    let mut frames = vec![Parts { every: 1, parts: Vec::new() }];
    let mut room = ROOM;
    let mut put = |every: u32, part: Part, len: usize| {
        let len = len + DATAGRAM_OVERHEAD;
        if len > room || frames.last().is_none_or(|frame| frame.every != every) {
            frames.push(Parts { every, parts: Vec::new() });
            room = ROOM;
        }
        room -= len;
        if let Some(frame) = frames.last_mut() {
            frame.parts.push(part);
        }
    };
    if clock.0 {
        put(1, Part::Drift, TIME_LEN);
        if clock.1 {
            put(1, Part::Lead, TIME_LEN);
        }
    }
    let chunks = image.chunks.iter().enumerate().filter(|_| exchanging);
    let (fast, slow): (Vec<_>, Vec<_>) = chunks.partition(|(_, chunk)| chunk.every == 1);
    let status = (None, 1, 2);
    let all = fast.into_iter().map(|(at, chunk)| (Some(at), chunk.every, chunk.length));
    let slow = slow.into_iter().map(|(at, chunk)| (Some(at), chunk.every, chunk.length));
    for (chunk, every, len) in all.chain([status]).chain(slow) {
        let len = usize::from(len);
        match chunk {
            None => put(every, Part::AlStatus, len),
            Some(at) if image.read_write => put(every, Part::ReadWrite(at), len),
            Some(at) => {
                put(every, Part::Write(at), len);
                put(every, Part::Read(at), len);
            }
        }
    }
    frames
}

/// The frames of a cycle with process data, as they will be sent: their content, and their times on
/// the wire in the fullest cycle, counted from the first bit of the first frame.
pub(crate) fn frames(segment: &Segment, compensate: bool, leads: bool) -> Vec<FramePlan> {
    let image = &segment.image;
    let mut start = 0;
    let mut frames: Vec<FramePlan> = Vec::new();
    let clock = (segment.reference.is_some(), leads);
    for Parts { every, parts } in plan_frames(image, clock, true) {
        let mut at = HEADERS;
        let mut datagrams = Vec::new();
        for part in parts {
            let chunk = |chunk: usize| {
                let of = &image.chunks[chunk];
                (Address::Logical(of.logical), usize::from(of.length), Some(chunk))
            };
            let (command, (address, length, chunk)) = match part {
                Part::Drift | Part::Lead => {
                    let station = segment.reference.map(|at| segment.devices[at].station);
                    let station = station.unwrap_or(StationAddress(0));
                    let address = Address::Station(station, register::SYSTEM_TIME.address);
                    let command = match (part, compensate) {
                        (Part::Lead, _) => Command::Fpwr,
                        (_, true) => Command::Frmw,
                        (_, false) => Command::Fprd,
                    };
                    (command, (address, TIME_LEN, None))
                }
                Part::AlStatus => {
                    let address = Address::Broadcast(register::AL_STATUS.address);
                    (Command::Brd, (address, 2, None))
                }
                Part::ReadWrite(at) => (Command::Lrw, chunk(at)),
                Part::Write(at) => (Command::Lwr, chunk(at)),
                Part::Read(at) => (Command::Lrd, chunk(at)),
            };
            datagrams.push(DatagramPlan { command, address, length, offset: at, chunk });
            at += DATAGRAM_OVERHEAD + length;
        }
        let end = start + duration_ns(at);
        let (begin, end_of) = (Nanos(start as i64), Nanos(end as i64));
        // In its emptiest cycle, only the frames whose period divides its own go before it.
        let absent = frames.iter().filter(|frame| every % frame.every != 0);
        let spread = Nanos(absent.map(|frame| (frame.end - frame.begin + GAP).0).sum());
        let length = at.max(MIN_LEN);
        frames.push(FramePlan { every, spread, begin, end: end_of, length, datagrams });
        start = end + GAP.0 as u64;
    }
    frames
}

/// Times on the wire of the frames of a chunk in the fullest cycle, counted from the first bit of
/// the cycle's first frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct ChunkTimes {
    /// Begin of the frame that fetches its inputs.
    pub fetched: Nanos,
    /// End of that frame: a SyncManager counts as read when the check sequence was good.
    pub read: Nanos,
    /// End of the frame that brings its outputs: a SyncManager passes them on when the check
    /// sequence was good.
    pub stored: Nanos,
    /// How much earlier all these times are if fewer frames go before them.
    pub spread: Nanos,
}

/// The times of each chunk.
pub(crate) fn chunk_times(frames: &[FramePlan], chunks: usize) -> Vec<ChunkTimes> {
    let mut times = vec![ChunkTimes::default(); chunks];
    for frame in frames {
        for datagram in &frame.datagrams {
            let Some(times) = datagram.chunk.and_then(|chunk| times.get_mut(chunk)) else {
                continue;
            };
            times.spread = frame.spread;
            if datagram.command != Command::Lwr {
                (times.fetched, times.read) = (frame.begin, frame.end);
            }
            if datagram.command != Command::Lrd {
                times.stored = frame.end;
            }
        }
    }
    times
}

/// Most bytes of a chunk: the space in one frame besides the drift datagram and AL status.
pub(crate) const MOST_CHUNK: usize =
    ROOM - 3 * DATAGRAM_OVERHEAD - TIME_LEN - isocat_wire::register::Register::<u16>::LEN;

/// Ethernet and EtherCAT headers.
pub(super) const HEADERS: usize =
    isocat_wire::frame::ETHERNET_HEADER_LEN + isocat_wire::frame::ETHERCAT_HEADER_LEN;
/// Bytes for datagrams in a frame.
pub(super) const ROOM: usize = MAX_LEN - HEADERS;
pub(super) const DATAGRAM_OVERHEAD: usize = HEADER_LEN + isocat_wire::datagram::WKC_LEN;
/// Bytes of the system time.
pub(super) const TIME_LEN: usize = 8;
pub(super) const ZEROS: [u8; MAX_LEN] = [0; MAX_LEN];

//! What goes into which frame of a cycle, and when it is on the wire.

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

/// Which parts go into which frame of a cycle. No chunk is cut, so no SubDevice is. `clock`: there is a reference
/// clock; it is led.
pub(super) fn plan_frames(
    image: &ProcessImage,
    clock: (bool, bool),
    exchanging: bool,
) -> Vec<Vec<Part>> {
    let mut frames: Vec<Vec<Part>> = vec![Vec::new()];
    let mut room = ROOM;
    let mut put = |part: Part, len: usize| {
        let len = len + DATAGRAM_OVERHEAD;
        if len > room {
            frames.push(Vec::new());
            room = ROOM;
        }
        room -= len;
        if let Some(frame) = frames.last_mut() {
            frame.push(part);
        }
    };
    if clock.0 {
        put(Part::Drift, TIME_LEN);
        if clock.1 {
            put(Part::Lead, TIME_LEN);
        }
    }
    if exchanging {
        for (at, chunk) in image.chunks.iter().enumerate() {
            let len = usize::from(chunk.length);
            match image.read_write {
                true => put(Part::ReadWrite(at), len),
                false => {
                    put(Part::Write(at), len);
                    put(Part::Read(at), len);
                }
            }
        }
    }
    put(Part::AlStatus, 2);
    frames
}

/// The frames of a cycle with process data, as they will be sent: what is in them, and when they are on the
/// wire, counted from the first bit of the first.
pub(crate) fn frames(segment: &Segment, compensate: bool, leads: bool) -> Vec<FramePlan> {
    let image = &segment.image;
    let mut start = 0;
    let mut frames = Vec::new();
    let clock = (segment.reference.is_some(), leads);
    for parts in plan_frames(image, clock, true) {
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
        frames.push(FramePlan { begin, end: end_of, length: at.max(MIN_LEN), datagrams });
        start = end + GAP.0 as u64;
    }
    frames
}

/// When the frames of a chunk are on the wire, counted from the first bit of the cycle's first frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct ChunkTimes {
    /// Begin of the frame that fetches its inputs.
    pub fetched: Nanos,
    /// End of that frame: a SyncManager is read when the check sequence was found good.
    pub read: Nanos,
    /// End of the frame that brings its outputs: a SyncManager passes them on when the check sequence was
    /// found good.
    pub stored: Nanos,
}

/// The times of each chunk.
pub(crate) fn chunk_times(frames: &[FramePlan], chunks: usize) -> Vec<ChunkTimes> {
    let mut times = vec![ChunkTimes::default(); chunks];
    for frame in frames {
        for datagram in &frame.datagrams {
            let Some(times) = datagram.chunk.and_then(|chunk| times.get_mut(chunk)) else {
                continue;
            };
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

/// Most bytes of a chunk: what fits beside the drift datagram and AL status in one frame.
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

//! The frames of a cycle, built once, and how returned datagrams are recognized.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN, Header, WKC_LEN};
use isocat_wire::frame::{FrameWriter, MAX_LEN, duration_ns};
use isocat_wire::register;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::CyclicExchange;
use super::layout::{HEADERS, Parts, TIME_LEN, ZEROS, plan_frames};
use crate::segment::GAP;

/// One frame of the cycle. All but its data is known before it is sent.
pub(super) struct CyclicFrame {
    /// The frame leaves in the bus cycles whose number by system time is a multiple of this.
    pub(super) every: u32,
    /// Ethernet and EtherCAT headers.
    pub(super) head: [u8; HEADERS],
    /// Its datagrams, one behind the other.
    pub(super) datagrams: Vec<CyclicDatagram>,
    /// Bytes up to the end of the last datagram.
    pub(super) used: usize,
    /// Bytes of the frame; above `used` if it is padded.
    pub(super) len: usize,
    /// Its time on the wire, with the gap after it.
    pub(super) wire: Nanos,
    /// When the frame was sent, for its two flights by parity of the cycle.
    pub(super) flights: [Option<Time<Host>>; 2],
    pub(super) cycles: [u64; 2],
    /// The system time at which each of them was to find the reference clock.
    pub(super) planned: [Time<Dc>; 2],
}

/// One datagram of a frame.
pub(super) struct CyclicDatagram {
    pub(super) part: Part,
    /// Its header, without the index.
    pub(super) header: [u8; HEADER_LEN],
    /// Offset of the header in the frame.
    pub(super) start: usize,
    /// Bytes of data.
    pub(super) len: usize,
    /// Offset of its process data in the image.
    pub(super) image: usize,
    pub(super) mark: Mark,
}

impl CyclicDatagram {
    /// Its data and its working counter in a returned frame; `None` if the frame is too short.
    #[inline]
    pub(super) fn found_in<'a>(&self, bytes: &'a [u8]) -> Option<(&'a [u8], u16)> {
        let (data, rest) = bytes.get(self.start + HEADER_LEN..)?.split_at_checked(self.len)?;
        Some((data, u16::from_le_bytes(*rest.first_chunk()?)))
    }

    /// Takes another command from now on.
    pub(super) fn set_command(&mut self, command: Command) {
        self.header[0] = command as u8;
        self.mark = Mark::of(&self.header);
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Drift,
    /// The write that controls the reference clock.
    Lead,
    /// Of this chunk, as are the following two.
    ReadWrite(usize),
    Write(usize),
    Read(usize),
    AlStatus,
}

impl CyclicExchange {
    /// Builds the frames of a cycle.
    pub(super) fn build(&mut self) {
        self.frames.clear();
        self.in_flight = 0;
        // If the number of frames changes, an index may mean another frame.
        self.given_up = 0;
        let reference = self.reference.as_ref();
        let clock = (reference.is_some(), self.drive.is_some());
        for Parts { every, parts } in plan_frames(&self.image, clock, self.exchanging) {
            let mut bytes = vec![0; MAX_LEN];
            let mut writer = FrameWriter::new(&mut bytes, self.source);
            let mut datagrams: Vec<CyclicDatagram> = Vec::new();
            for part in parts {
                let (command, address, len) = match part {
                    Part::Drift => {
                        let Some(reference) = reference else { continue };
                        let address =
                            Address::Station(reference.station, register::SYSTEM_TIME.address);
                        let command = if reference.reading { Command::Fprd } else { Command::Frmw };
                        (command, address, TIME_LEN)
                    }
                    Part::Lead => {
                        let Some(reference) = reference else { continue };
                        let address = register::SYSTEM_TIME.address;
                        (Command::Fpwr, Address::Station(reference.station, address), TIME_LEN)
                    }
                    Part::AlStatus => {
                        (Command::Brd, Address::Broadcast(register::AL_STATUS.address), 2)
                    }
                    Part::ReadWrite(chunk) => self.logical(Command::Lrw, chunk),
                    Part::Write(chunk) => self.logical(Command::Lwr, chunk),
                    Part::Read(chunk) => self.logical(Command::Lrd, chunk),
                };
                let pushed = writer.push(command, 0, address, &ZEROS[..len]);
                let data = pushed.expect("the plan of the frames keeps their length");
                let image = match part {
                    Part::ReadWrite(chunk) | Part::Write(chunk) | Part::Read(chunk) => {
                        self.image.chunks[chunk].logical as usize
                    }
                    Part::Drift | Part::Lead | Part::AlStatus => 0,
                };
                let (header, mark) = ([0; HEADER_LEN], Mark { mask: 0, value: 0 });
                let start = data - HEADER_LEN;
                datagrams.push(CyclicDatagram { part, header, start, len, image, mark });
            }
            let len = writer.finish();
            // Only now does each header tell whether another datagram follows.
            for datagram in &mut datagrams {
                datagram.header.copy_from_slice(&bytes[datagram.start..][..HEADER_LEN]);
                let mark = Mark::of(&datagram.header);
                datagram.mark =
                    if datagram.part == Part::Lead { mark.of_any_command() } else { mark };
            }
            let mut head = [0; HEADERS];
            head.copy_from_slice(&bytes[..HEADERS]);
            let last = datagrams.last();
            let used = last.map_or(HEADERS, |last| last.start + HEADER_LEN + last.len + WKC_LEN);
            let (flights, cycles, planned) = ([None; 2], [0; 2], [Time::ZERO; 2]);
            let wire = Nanos(duration_ns(len) as i64) + GAP;
            self.frames.push(CyclicFrame {
                every,
                head,
                datagrams,
                used,
                len,
                wire,
                flights,
                cycles,
                planned,
            });
        }
        self.frame_bits =
            self.frames.len().saturating_sub(1).checked_ilog2().map_or(0, |log| log + 1);
        self.grouped = self.frames.iter().any(|frame| frame.every > 1);
    }

    pub(super) fn logical(&self, command: Command, chunk: usize) -> (Command, Address, usize) {
        let chunk = &self.image.chunks[chunk];
        (command, Address::Logical(chunk.logical), usize::from(chunk.length))
    }
}

/// How a datagram is recognized: the first eight bytes of its header, without the bits that change
/// on the way.
#[derive(Clone, Copy)]
pub(super) struct Mark {
    pub(super) mask: u64,
    pub(super) value: u64,
}

impl Mark {
    pub(super) fn of(header: &[u8; HEADER_LEN]) -> Self {
        // Command, address and length count. The index, which tells the cycle, and the flags do
        // not.
        let mut mask = 0x07FF_FFFF_FFFF_00FF;
        if Header::parse(header).command().is_ok_and(|command| command.increments_position()) {
            mask &= !0xFFFF_0000;
        }
        let [bytes @ .., _, _] = header;
        Self { mask, value: u64::from_le_bytes(*bytes) & mask }
    }

    /// The mark without the command.
    pub(super) fn of_any_command(self) -> Self {
        let mask = self.mask & !0xFF;
        Self { mask, value: self.value & mask }
    }

    /// Whether the datagram is at byte `start` of a frame.
    #[inline]
    pub(super) fn is_at(self, bytes: &[u8], start: usize) -> bool {
        let found = bytes.get(start..).and_then(|rest| rest.first_chunk());
        found.is_some_and(|found| u64::from_le_bytes(*found) & self.mask == self.value)
    }
}

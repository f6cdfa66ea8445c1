//! The frames of a cycle, built once, and how returned datagrams are recognized.

use alloc::vec;
use alloc::vec::Vec;

use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN, Layout};
use isocat_wire::frame::{FrameWriter, MAX_LEN};
use isocat_wire::register;
use isocat_wire::time::{Host, Time};

use super::CyclicExchange;
use super::layout::{Parts, TIME_LEN, ZEROS, plan_frames};

/// One frame of the cycle and the places of its datagrams.
pub(super) struct CyclicFrame {
    /// The frame leaves in the bus cycles whose number by system time is a multiple of this.
    pub(super) every: u32,
    pub(super) bytes: Vec<u8>,
    /// Offsets are from the start of the frame.
    pub(super) datagrams: Vec<(Part, Layout)>,
    pub(super) marks: Vec<Mark>,
    /// When the frame was sent, for its two flights by parity of the cycle.
    pub(super) flights: [Option<Time<Host>>; 2],
    pub(super) cycles: [u64; 2],
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
        // If the number of frames changes, an index may mean another frame.
        self.given_up = 0;
        let reference = self.reference.as_ref();
        let clock = (reference.is_some(), self.drive.is_some());
        for Parts { every, parts } in plan_frames(&self.image, clock, self.exchanging) {
            let mut bytes = vec![0; MAX_LEN];
            let mut writer = FrameWriter::new(&mut bytes, self.source);
            let mut datagrams = Vec::new();
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
                datagrams.push((part, data - HEADER_LEN));
            }
            let len = writer.finish();
            bytes.truncate(len);
            let datagrams: Vec<_> = datagrams
                .into_iter()
                .map(|(part, start)| {
                    let layout = Layout::at(&bytes, start);
                    (part, layout.expect("the datagram was just written"))
                })
                .collect();
            let mark = |(part, layout): &(Part, Layout)| {
                let mark = Mark::of(layout);
                if *part == Part::Lead { mark.of_any_command() } else { mark }
            };
            let marks = datagrams.iter().map(mark).collect();
            let (flights, cycles) = ([None; 2], [0; 2]);
            self.frames.push(CyclicFrame { every, bytes, datagrams, marks, flights, cycles });
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
    pub(super) fn of(layout: &Layout) -> Self {
        // Command, address and length count. The index, which tells the cycle, and the flags do
        // not.
        let mut mask = 0x07FF_FFFF_FFFF_00FF;
        if layout.header.command().is_ok_and(|command| command.increments_position()) {
            mask &= !0xFFFF_0000;
        }
        let [bytes @ .., _, _] = layout.header.emit();
        Self { mask, value: u64::from_le_bytes(bytes) & mask }
    }

    /// The mark without the command.
    pub(super) fn of_any_command(self) -> Self {
        let mask = self.mask & !0xFF;
        Self { mask, value: self.value & mask }
    }

    /// Whether the datagram is at byte `start` of a frame.
    pub(super) fn is_at(self, bytes: &[u8], start: usize) -> bool {
        let found = bytes.get(start..).and_then(|rest| rest.first_chunk());
        found.is_some_and(|found| u64::from_le_bytes(*found) & self.mask == self.value)
    }
}

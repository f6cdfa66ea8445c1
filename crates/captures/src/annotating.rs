//! Copies of captures with comments at some of their packets, as one pcapng file.
//!
//! Blocks of pcapng are copied byte by byte; a packet with comments gets them as options
//! (opt_comment) before its own ones. A pcap file becomes a section of its own. Files follow one
//! another as sections, so packets of the second file are numbered on from those of the first.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Cursor, Read, Write};

use pcap_file::TsResolution;
use pcap_file::pcap::{PcapReader, RawPcapPacket};

use crate::reading::{CUT_OFF, MAGIC_NG, NoCapture, words};

mod block;
#[cfg(test)]
mod tests;

use block::{Block, Order};

/// Comments by the number of the packet in its file, from 1.
pub type Comments = BTreeMap<usize, Vec<String>>;

/// A copy that is being written.
#[derive(Debug)]
pub struct Annotated<W: Write> {
    out: W,
}

/// The result of copying one capture.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Copied {
    /// Packets that were copied.
    pub packets: usize,
    /// Packets that got comments.
    pub commented: usize,
    /// Packets whose comments are left out: their kind of block (simple packet) can't hold options.
    pub without_place: usize,
    /// Why the copy ends before the end of the file; `None`: it is complete.
    pub ended: Option<String>,
}

/// Why a capture was not copied.
#[derive(Debug)]
pub enum CopyError {
    /// It is no capture.
    Capture(NoCapture),
    /// The copy can't be written.
    Write(io::Error),
}

impl fmt::Display for CopyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Capture(none) => write!(f, "{none}"),
            Self::Write(error) => write!(f, "the copy can't be written: {error}"),
        }
    }
}

impl std::error::Error for CopyError {}

impl<W: Write> Annotated<W> {
    /// Begins a copy, which is empty.
    pub fn new(out: W) -> Self {
        Self { out }
    }

    /// Appends a copy of a capture. If it is damaged, or ends in the middle of a block, the blocks
    /// before that are copied.
    pub fn add(&mut self, mut source: impl Read, comments: &Comments) -> Result<Copied, CopyError> {
        let mut first = Vec::new();
        let unreadable =
            |error: io::Error| CopyError::Capture(NoCapture::Unreadable(error.to_string()));
        source.by_ref().take(4).read_to_end(&mut first).map_err(unreadable)?;
        let all = Cursor::new(first.clone()).chain(source);
        match &first[..] {
            MAGIC_NG => self.blocks(all, comments),
            _ => {
                let none = |_| CopyError::Capture(NoCapture::Unknown { found: first });
                self.packets(PcapReader::new(all).map_err(none)?, comments)
            }
        }
    }

    /// Ends the copy, after all captures were added.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }

    fn blocks(&mut self, mut source: impl Read, comments: &Comments) -> Result<Copied, CopyError> {
        let mut copied = Copied::default();
        let mut order = Order::Little;
        loop {
            let mut block = match Block::read(&mut source, &mut order) {
                Ok(Some(block)) => block,
                Ok(None) => return Ok(copied),
                Err(why) => return Ok(Copied { ended: Some(why), ..copied }),
            };
            if block.is_packet() {
                copied.packets += 1;
                match comments.get(&copied.packets).map(|all| block.comment(order, all)) {
                    Some(true) => copied.commented += 1,
                    Some(false) => copied.without_place += 1,
                    None => {}
                }
            }
            block.write(order, &mut self.out).map_err(CopyError::Write)?;
        }
    }

    fn packets<R: Read>(
        &mut self,
        mut source: PcapReader<R>,
        comments: &Comments,
    ) -> Result<Copied, CopyError> {
        let header = source.header();
        let (order, mut copied) = (Order::Little, Copied::default());
        let digits = match header.ts_resolution {
            TsResolution::MicroSecond => 6,
            TsResolution::NanoSecond => 9,
        };
        let link = u32::from(header.datalink);
        for block in [Block::section(), Block::interface(link, header.snaplen, digits)] {
            block.write(order, &mut self.out).map_err(CopyError::Write)?;
        }
        while let Some(packet) = source.next_raw_packet() {
            let packet = match packet {
                Ok(packet) => packet,
                Err(error) => return Ok(Copied { ended: Some(words(&error)), ..copied }),
            };
            copied.packets += 1;
            let mut block = Block::packet(units(&packet, digits), packet.orig_len, &packet.data);
            if let Some(all) = comments.get(&copied.packets) {
                copied.commented += usize::from(block.comment(order, all));
            }
            block.write(order, &mut self.out).map_err(CopyError::Write)?;
        }
        Ok(copied)
    }
}

/// The stamp of a packet in units of 10^-`digits` s.
fn units(packet: &RawPcapPacket<'_>, digits: u8) -> u64 {
    u64::from(packet.ts_sec) * 10_u64.pow(digits.into()) + u64::from(packet.ts_frac)
}

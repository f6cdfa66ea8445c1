//! Frames of a run in a pcapng file, with nanosecond time stamps.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::Duration;

use isocat_sim::Tap;
use isocat_wire::time::{Time, True};
use pcap_file::DataLink;
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};

/// Writes all frames at the MainDevice's port to a file: sent ones are marked outbound, those that
/// came back inbound. Time stamps of a simulation are true time, from the beginning of the run; those of a
/// real interface are wall time, taken just before a frame is handed to the kernel and when the kernel has
/// it back.
pub struct Capture<W: Write = BufWriter<File>> {
    writer: PcapNgWriter<W>,
    /// The first error; later frames are dropped.
    failed: Option<io::Error>,
}

/// Flags option of a packet: direction inbound.
const INBOUND: u32 = 1;
/// Flags option of a packet: direction outbound.
const OUTBOUND: u32 = 2;
/// Time stamps in units of 10^-9 s.
const NANOSECONDS: u8 = 9;

impl Capture {
    /// Creates the file.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?))
    }

    /// Creates the file for a real interface.
    pub fn create_of_interface(path: &Path, interface: &str) -> io::Result<Self> {
        let file = BufWriter::new(File::create(path)?);
        Self::begin(file, interface.to_owned(), "a network interface, in wall time")
    }
}

impl<W: Write> Capture<W> {
    /// Writes to `writer`.
    pub fn new(writer: W) -> io::Result<Self> {
        Self::begin(writer, "main".to_owned(), "the MainDevice's port, in true time")
    }

    fn begin(writer: W, name: String, description: &'static str) -> io::Result<Self> {
        let mut writer = PcapNgWriter::new(writer).map_err(io::Error::other)?;
        let interface = InterfaceDescriptionBlock {
            linktype: DataLink::ETHERNET,
            snaplen: 0xFFFF,
            options: vec![
                InterfaceDescriptionOption::IfName(name.into()),
                InterfaceDescriptionOption::IfDescription(description.into()),
                InterfaceDescriptionOption::IfTsResol(NANOSECONDS),
            ],
        };
        writer.write_pcapng_block(interface).map_err(io::Error::other)?;
        Ok(Self { writer, failed: None })
    }

    /// Ends the file; gives the first error there was.
    pub fn finish(self) -> io::Result<()> {
        match self.failed {
            Some(error) => Err(error),
            None => self.writer.into_inner().flush(),
        }
    }
}

impl<W: Write> Tap for Capture<W> {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.write(Duration::from_nanos(at.as_nanos()), sent, bytes);
    }
}

impl<W: Write> Capture<W> {
    /// Writes a frame that left (`sent`) or came back at `at`.
    pub fn write(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        if self.failed.is_some() {
            return;
        }
        let packet = EnhancedPacketBlock {
            interface_id: 0,
            timestamp: at,
            original_len: bytes.len() as u32,
            data: bytes.into(),
            options: vec![EnhancedPacketOption::Flags(if sent { OUTBOUND } else { INBOUND })],
        };
        if let Err(error) = self.writer.write_pcapng_block(packet) {
            self.failed = Some(io::Error::other(error));
        }
    }
}

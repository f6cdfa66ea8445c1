//! Writes the frames of a run to a pcapng file with nanosecond time stamps. Each place where frames
//! are seen is an interface, and events are comments in words.
//!
//! Packets are written in the order of time, whatever the order in which they arrive here: the last
//! [`WINDOW`] packets are held back, and events with them, until the packet nearest to each event
//! is known.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::Duration;

use isocat_maindevice::{Event, Port, SegmentChange};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::probe::Sight;
use isocat_sim::{Lost, Segment, Tap};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::ObjectAddress;
use isocat_wire::time::{Time, True};
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::{DataLink, PcapError};

/// Writes all frames at the MainDevice's ports to a file: sent frames are marked outbound, frames
/// that came back inbound. Time stamps of a simulation are true time, from the beginning of the
/// run. Those of a real interface are wall time, taken right before a frame is given to the kernel
/// and when the kernel has received it.
///
/// In a simulation, frames can also be seen in front of SubDevices ([`Capture::with_probes`]):
/// inbound as they enter the SubDevice, outbound as they leave it, processed. On cables
/// ([`Capture::with_cables`]) they are outbound away from the MainDevice and inbound on their way
/// back, as a tap in the line sees them.
pub struct Capture<W: Write = BufWriter<File>> {
    writer: PcapNgWriter<W>,
    /// The first error; later frames are dropped.
    failed: Option<io::Error>,
    /// Names of the SubDevices, by position.
    names: Vec<String>,
    /// Positions with a probe. The interface of each is 1 + its index here.
    probes: Vec<usize>,
    /// Positions with a tap on the cable in front of them. Their interfaces follow those of the
    /// probes.
    cables: Vec<usize>,
    /// The interface of the secondary port, after its first frame.
    secondary: Option<u32>,
    /// Packets that are held back, in the order of time.
    held: VecDeque<Packet>,
    /// Events that no packet carries yet, in the order of time.
    notes: VecDeque<Note>,
}

struct Packet {
    at: Duration,
    interface: u32,
    flags: u32,
    data: Vec<u8>,
}

/// A comment for a packet.
struct Note {
    at: Duration,
    /// Whether it belongs to the first packet from `at` on; false: to the nearest packet.
    behind: bool,
    words: String,
}

/// Number of packets that are held back, because some events arrive a few frames late. It bounds
/// memory to 1.5 MB.
pub const WINDOW: usize = 1024;
/// Flags option of a packet: direction inbound.
const INBOUND: u32 = 1;
/// Flags option of a packet: direction outbound.
const OUTBOUND: u32 = 2;
/// Time stamps in units of 10^-9 s.
const NANOSECONDS: u8 = 9;
/// The primary port's interface.
const MAIN: u32 = 0;

impl Capture {
    /// Creates the file.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?))
    }
}

impl<W: Write> Capture<W> {
    /// Begins a file of a simulation, written to `writer`.
    pub fn new(writer: W) -> io::Result<Self> {
        Self::begin(writer, "main", "the MainDevice's port, in true time")
    }

    /// Begins a file of a real interface, written to `writer`.
    pub fn of_interface(writer: W, interface: &str) -> io::Result<Self> {
        Self::begin(writer, interface, "a network interface, in wall time")
    }

    fn begin(writer: W, name: &str, description: &str) -> io::Result<Self> {
        let writer = PcapNgWriter::new(writer).map_err(cause)?;
        let mut capture = Self {
            writer,
            failed: None,
            names: Vec::new(),
            probes: Vec::new(),
            cables: Vec::new(),
            secondary: None,
            held: VecDeque::with_capacity(WINDOW),
            notes: VecDeque::new(),
        };
        capture.describe(name, description)?;
        Ok(capture)
    }

    /// Sets the names of the SubDevices, by position.
    pub fn with_names(self, names: Vec<String>) -> Self {
        Self { names, ..self }
    }

    /// Adds an interface for each of these SubDevices, which shows the frames in front of it:
    /// `subdevice-2` for position 2. Must be called at most once.
    pub fn with_probes(mut self, positions: &[usize]) -> io::Result<Self> {
        self.probes = positions.to_vec();
        self.probes.sort_unstable();
        self.probes.dedup();
        for position in self.probes.clone() {
            let of = self.subject(position);
            let what = format!("in front of {of}: inbound enters it, outbound leaves it processed");
            self.describe(&format!("subdevice-{position}"), &(what + ", in true time"))?;
        }
        Ok(self)
    }

    /// Adds an interface for the cable at port 0 of each of these SubDevices: `cable-2` in front of
    /// position 2. Must be called at most once, after the probes.
    pub fn with_cables(mut self, positions: &[usize]) -> io::Result<Self> {
        self.cables = positions.to_vec();
        self.cables.sort_unstable();
        self.cables.dedup();
        for position in self.cables.clone() {
            let of = self.subject(position);
            let what = format!("on the cable in front of {of}, in true time");
            self.describe(&format!("cable-{position}"), &what)?;
        }
        Ok(self)
    }

    fn describe(&mut self, name: &str, description: &str) -> io::Result<()> {
        let interface = InterfaceDescriptionBlock {
            linktype: DataLink::ETHERNET,
            snaplen: 0xFFFF,
            options: vec![
                InterfaceDescriptionOption::IfName(Cow::Owned(name.to_owned())),
                InterfaceDescriptionOption::IfDescription(Cow::Owned(description.to_owned())),
                InterfaceDescriptionOption::IfTsResol(NANOSECONDS),
            ],
        };
        self.writer.write_pcapng_block(interface).map_err(cause).map(|_| ())
    }

    /// Ends the file. Returns its writer, or the first error.
    pub fn finish(mut self) -> io::Result<W> {
        while !self.held.is_empty() {
            self.release();
        }
        if let Some(error) = self.failed {
            return Err(error);
        }
        let mut writer = self.writer.into_inner();
        writer.flush()?;
        Ok(writer)
    }

    /// Takes a frame that left (`sent`) or came back at `at`.
    pub fn write(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        self.hold(at, MAIN, sent, bytes);
    }

    /// Adds a comment to the packet nearest to `at`.
    pub fn comment(&mut self, at: Duration, words: String) {
        self.note(Note { at, behind: false, words });
    }

    fn hold(&mut self, at: Duration, interface: u32, outbound: bool, bytes: &[u8]) {
        let flags = if outbound { OUTBOUND } else { INBOUND };
        let packet = Packet { at, interface, flags, data: bytes.to_vec() };
        let place = self.held.iter().rposition(|other| other.at <= at).map_or(0, |last| last + 1);
        self.held.insert(place, packet);
        if self.held.len() > WINDOW {
            self.release();
        }
    }

    fn note(&mut self, note: Note) {
        let before = |other: &Note| other.at <= note.at;
        let place = self.notes.iter().rposition(before).map_or(0, |last| last + 1);
        self.notes.insert(place, note);
    }

    /// Writes the oldest packet with its comments.
    fn release(&mut self) {
        let Some(Packet { at, interface, flags, data }) = self.held.pop_front() else { return };
        let next = self.held.front().map(|packet| packet.at);
        let belongs = |note: &Note| match next {
            None => true,
            Some(_) if note.at <= at => true,
            Some(next) => !note.behind && note.at - at <= next.saturating_sub(note.at),
        };
        let mut options = vec![EnhancedPacketOption::Flags(flags)];
        let mut later = VecDeque::new();
        for note in self.notes.drain(..) {
            match belongs(&note) {
                true => options.push(EnhancedPacketOption::Comment(note.words.into())),
                false => later.push_back(note),
            }
        }
        self.notes = later;
        if self.failed.is_some() {
            return;
        }
        let packet = EnhancedPacketBlock {
            interface_id: interface,
            timestamp: at,
            original_len: data.len() as u32,
            data: data.into(),
            options,
        };
        if let Err(error) = self.writer.write_pcapng_block(packet) {
            self.failed = Some(cause(error));
        }
    }

    /// `SubDevice 2 (axis 3)`
    fn subject(&self, position: usize) -> String {
        match self.names.get(position) {
            Some(name) => format!("SubDevice {position} ({name})"),
            None => format!("SubDevice {position}"),
        }
    }
}

impl<W: Write> Tap for Capture<W> {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.hold(stamp(at), MAIN, sent, bytes);
    }

    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let interface =
            self.secondary.unwrap_or(MAIN + 1 + (self.probes.len() + self.cables.len()) as u32);
        if self.secondary.is_none() {
            // The description of an interface must precede its packets; all packets that are held
            // back belong to others.
            let what = "the MainDevice's secondary port, in true time";
            if let Err(error) = self.describe("main-secondary", what) {
                self.failed.get_or_insert(error);
            }
            self.secondary = Some(interface);
        }
        self.hold(stamp(at), interface, sent, bytes);
    }

    fn lost(&mut self, at: Time<True>, _: Port, why: Option<Lost>) {
        let words = match why {
            Some(lost) => format!("this frame is lost: {lost}"),
            None => "this frame comes back damaged: it is lost".to_owned(),
        };
        self.comment(stamp(at), words);
    }

    fn probes(&self) -> Vec<usize> {
        self.probes.clone()
    }

    fn cables(&self) -> Vec<usize> {
        self.cables.clone()
    }

    fn probed(&mut self, at: Time<True>, device: usize, sight: Sight, bytes: &[u8]) {
        let (probe, cable) =
            (self.probes.binary_search(&device), self.cables.binary_search(&device));
        let (number, outbound) = match sight {
            Sight::Enters => (probe, false),
            Sight::Leaves => (probe, true),
            Sight::Outbound => (cable.map(|number| self.probes.len() + number), true),
            Sight::Inbound => (cable.map(|number| self.probes.len() + number), false),
        };
        if let Ok(number) = number {
            self.hold(stamp(at), MAIN + 1 + number as u32, outbound, bytes);
        }
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        let who = self.subject(observation.device);
        match observation.event {
            Observed::State(state, code) => {
                let why = if code.0 == 0 { String::new() } else { format!(", {code}") };
                let words = format!("{who}: now in {state}{why}");
                self.note(Note { at: stamp(at), behind: true, words });
            }
            Observed::OutputsSafe => {
                let words = format!("{who}: its watchdog expired, outputs are safe");
                self.comment(stamp(at), words);
            }
            Observed::SmEventMissed(counter) => {
                let sync = segment.devices()[observation.device].stack.sync();
                let index = if sync.has_outputs() { OUTPUT_PARAMETER } else { INPUT_PARAMETER };
                let object = ObjectAddress::new(index, sub::SM_EVENT_MISSED);
                let words = format!("{who}: SM event missed, {object} now {counter}");
                self.comment(stamp(at), words);
            }
            _ => {}
        }
    }

    fn event(&mut self, at: Time<True>, event: &Event) {
        if let Some(words) = self.words(event) {
            self.comment(stamp(at), words);
        }
    }
}

impl<W: Write> Capture<W> {
    /// Describes faults that the MainDevice found, and changes of SubDevices.
    fn words(&self, event: &Event) -> Option<String> {
        Some(match event {
            Event::WorkingCounter { cycle, chunk, expected, found } => format!(
                "cycle {cycle}: working counter of process data {chunk} is {found}, expected {expected}"
            ),
            Event::WorkingCounterRestored { cycle, chunk, cycles } => format!(
                "cycle {cycle}: working counter of process data {chunk} is right again after {cycles} cycles"
            ),
            Event::Drift { cycle, expected, found } if found != expected => {
                format!(
                    "cycle {cycle}: working counter of the drift datagram is {found}, expected {expected}"
                )
            }
            Event::Alarm(change) => {
                format!("{}: alarm: {}", self.subject(change.position), change.what())
            }
            event => match SegmentChange::of(event)? {
                (Some(position), change) => format!("{}: {change}", self.subject(position)),
                (None, change) => change.to_string(),
            },
        })
    }
}

fn stamp(at: Time<True>) -> Duration {
    Duration::from_nanos(at.as_nanos())
}

/// The cause of an error: a full disk is reported as such, whatever the library wraps it in.
fn cause(error: PcapError) -> io::Error {
    match error {
        PcapError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

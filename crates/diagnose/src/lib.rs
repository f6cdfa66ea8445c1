//! A capture of anybody's EtherCAT segment in; what is known of it, and what went wrong, out.
//!
//! Data's way: `isocat-captures` reads frames and finds which belong together. `access` takes each
//! exchange apart into datagrams; `observer` keeps what they say, by subject: `device` (which
//! devices there are) with `known` (registers), `sii` (identity), `state`, `mailbox`, `sync_unit`
//! and `counters`; `clock` (drift frames), `cycle` (rhythm and working counters), `phase` (frames
//! against SYNC0), `talker` (sources of frames). All of it is bounded, however long a capture is.
//! At the end `judge` looks what speaks against the segment, as `finding`s with kinds; `words`
//! makes sentences of them, and [`report`] the document. [`Around`] looks at the captures once more
//! and tells what happened in the frames around the first fault.
//!
//! [`live`] is the same for frames that are seen as they come.
//!
//! Nothing is guessed: what the capture does not show is told as unknown.
//!
//! ```no_run
//! use isocat_diagnose::{Diagnosis, Names};
//! let file = std::fs::File::open("field.pcapng")?;
//! let mut diagnosis = Diagnosis::new();
//! diagnosis.read("field.pcapng", file)?;
//! let report = diagnosis.report(&Names::default())?;
//! println!("{}", report.verdict.sentence);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod access;
mod around;
mod clock;
mod counters;
mod cycle;
mod device;
mod files;
mod finding;
mod judge;
mod known;
pub mod live;
mod mailbox;
mod measured;
mod observer;
mod phase;
pub mod report;
mod sii;
mod state;
mod sync_unit;
mod talker;
mod words;

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;

use isocat_captures::pairing::Pairing;
use isocat_captures::probe::Probe;
use isocat_captures::reading::{Frame, NoCapture, Reader, Tally};

pub use around::Around;
use files::Files;
pub use finding::KINDS;
pub use measured::{Grid, Measured, Onlooker};
use observer::Observer;
pub use report::DiagnoseReport;

/// A diagnosis of one capture, or of several that continue one another.
#[derive(Debug)]
pub struct Diagnosis {
    files: Files,
    pairing: Pairing,
    observer: Observer,
    probe: Option<Probe>,
}

/// What devices are called, beside what their EEPROMs say.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Names {
    /// By position, as a segment file has them.
    pub positions: Vec<String>,
    /// By vendor id and product code, as descriptions have them.
    pub identities: BTreeMap<(u32, u32), String>,
}

/// Why a capture can't be diagnosed: no frame of EtherCAT is in it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Nothing {
    /// Packets in the captures.
    pub packets: usize,
    /// Frames of other protocols.
    pub foreign: usize,
    /// Packets of which the captures do not hold all bytes of EtherCAT.
    pub cut: usize,
    /// Frames of EtherCAT whose datagrams contradict themselves.
    pub broken: usize,
    /// Packets of links without Ethernet frames.
    pub other_links: usize,
    /// The link type of the first of them.
    pub other_link: Option<u32>,
    /// Why reading ended before the end of a capture.
    pub ended: Option<String>,
}

impl fmt::Display for Nothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no frame of EtherCAT that can be read (EtherType 0x88A4, or UDP to port 0x88A4); found ")?;
        write!(f, "{} packets, {} of other protocols", self.packets, self.foreign)?;
        if self.cut > 0 {
            write!(f, ", {} cut by a snap length (capture whole packets)", self.cut)?;
        }
        if self.broken > 0 {
            write!(f, ", {} with damaged datagrams", self.broken)?;
        }
        if let Some(link) = self.other_link {
            let count = self.other_links;
            write!(
                f,
                ", {count} of a link without Ethernet frames (link type {link}; expected 1, 113 or 276)"
            )?;
        }
        match &self.ended {
            Some(why) => write!(f, "; not read to its end: {why}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for Nothing {}

impl Default for Diagnosis {
    fn default() -> Self {
        Self::new()
    }
}

impl Diagnosis {
    /// Nothing was read yet.
    pub fn new() -> Self {
        let (pairing, observer) = (Pairing::new(), Observer::new());
        Self { files: Files::default(), pairing, observer, probe: None }
    }

    /// Packets of the captures have the header of a probe.
    pub fn with_probe(self, probe: Option<Probe>) -> Self {
        Self { probe, ..self }
    }

    /// Reads a capture, which continues those that were read before. `name` is what frames of it
    /// are told with. `Err`: it is neither pcapng nor pcap; nothing of it was taken.
    pub fn read(&mut self, name: &str, source: impl Read) -> Result<(), NoCapture> {
        self.read_with(name, source, &mut |_| {})
    }

    /// The same; `onlooker` hears what is measured of each cycle.
    pub fn read_with(
        &mut self,
        name: &str,
        source: impl Read,
        onlooker: &mut Onlooker<'_>,
    ) -> Result<(), NoCapture> {
        let mut reader = Reader::new(source)?.with_probe(self.probe);
        self.files.begin(name);
        while let Some(mut frame) = reader.frame() {
            frame.number = self.files.number(frame.number);
            self.pairing.push(frame);
            self.observe(onlooker);
        }
        self.files.end(reader.tally().clone());
        Ok(())
    }

    /// Takes a frame that is no part of a file; `frame.number` counts from 1.
    fn take(&mut self, frame: Frame) {
        self.files.packet();
        self.pairing.push(frame);
        self.observe(&mut |_| {});
    }

    /// A capture that is not there, as the empty file that a ring buffer of captures begins: its
    /// place among the others is kept.
    pub fn pass_over(&mut self, name: &str, why: &str) {
        self.files.begin(name);
        self.files.end(Tally { ended: Some(why.to_owned()), ..Tally::default() });
    }

    /// Says what was found. `Err`: no frame of EtherCAT is in the captures.
    pub fn report(self, names: &Names) -> Result<DiagnoseReport, Nothing> {
        self.report_with(names, &mut |_| {})
    }

    /// The same; `onlooker` hears what is measured of the last cycles, which wait for their answers
    /// until then.
    pub fn report_with(
        mut self,
        names: &Names,
        onlooker: &mut Onlooker<'_>,
    ) -> Result<DiagnoseReport, Nothing> {
        self.pairing.end();
        self.observe(onlooker);
        let pairs = self.pairing.tally();
        if self.observer.exchanges == 0 {
            let captures = self.files.reports();
            let sum = |of: fn(&report::CaptureReport) -> usize| captures.iter().map(of).sum();
            return Err(Nothing {
                packets: sum(|capture| capture.packets),
                foreign: pairs.foreign,
                cut: sum(|capture| capture.cut),
                broken: pairs.broken,
                other_links: sum(|capture| capture.other_links),
                other_link: captures.iter().find_map(|capture| capture.other_link),
                ended: captures.iter().find_map(|capture| capture.ended.clone()),
            });
        }
        let tap = self.pairing.tap();
        let name =
            |position: Option<u16>, vendor: u32, product: u32| names.of(position, vendor, product);
        Ok(report::report(&self.files, &self.observer, pairs, tap, &name))
    }

    fn observe(&mut self, onlooker: &mut Onlooker<'_>) {
        while let Some(exchange) = self.pairing.exchange() {
            if let Some(tap) = self.pairing.tap() {
                self.observer.exchange(tap, &exchange, onlooker);
            }
        }
    }
}

impl Names {
    fn of(&self, position: Option<u16>, vendor: u32, product: u32) -> Option<String> {
        let by_position = position.and_then(|position| self.positions.get(usize::from(position)));
        by_position.or_else(|| self.identities.get(&(vendor, product))).cloned()
    }
}

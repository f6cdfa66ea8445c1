//! Diagnoses a capture of any EtherCAT segment: what is known of the segment, and what went wrong.
//!
//! The way of the data: `isocat-captures` reads frames and pairs requests with answers. `access`
//! takes each exchange apart into datagrams; `observer` keeps what they say, by subject: `device`
//! (which devices there are) with `known` (registers), `sii` (identity), `state`, `mailbox`,
//! `sync_unit` and `counters`; `clock` (drift frames), `cycle` (rhythm and working counters),
//! `phase` (frames against SYNC0), `talker` (sources of frames). All of it is bounded, however long
//! a capture is. At the end `judge` makes `finding`s with kinds of it, and with `evidence` the
//! rulebook holds it against what was meant; `words` turns findings into sentences, and [`report`]
//! into the document. [`Around`] reads the captures a second time and
//! tells what happened in the frames around the first fault.
//!
//! [`live`] does the same for frames as they arrive.
//!
//! Nothing is guessed: what the capture does not show is reported as unknown.
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
mod evidence;
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
pub use finding::{KINDS, MEANINGS};
pub use isocat_rules::Claims;
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

/// Names of devices, in addition to those in their EEPROMs.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Names {
    /// By position, as a segment file has them.
    pub positions: Vec<String>,
    /// By vendor id and product code, as descriptions have them.
    pub identities: BTreeMap<(u32, u32), String>,
}

/// Why a capture can't be diagnosed: it holds no EtherCAT frame.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Nothing {
    /// Packets in the captures.
    pub packets: usize,
    /// Frames of other protocols.
    pub foreign: usize,
    /// Packets that the captures cut off within their EtherCAT part.
    pub cut: usize,
    /// Frames of EtherCAT whose datagrams contradict themselves.
    pub broken: usize,
    /// Packets of links without Ethernet frames.
    pub other_links: usize,
    /// The link type of the first packet in `other_links`.
    pub other_link: Option<u32>,
    /// Why a capture was not read to its end.
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
    /// A diagnosis that has read nothing yet.
    pub fn new() -> Self {
        let (pairing, observer) = (Pairing::new(), Observer::new());
        Self { files: Files::default(), pairing, observer, probe: None }
    }

    /// Sets the probe whose header precedes each packet of the captures.
    pub fn with_probe(self, probe: Option<Probe>) -> Self {
        Self { probe, ..self }
    }

    /// Also holds what the captures show against what the segment was meant to do; call it before
    /// anything is read.
    pub fn against(mut self, claims: Option<Claims>) -> Self {
        self.observer.claims = claims;
        self
    }

    /// Reads a capture, which continues those that were read before. `name`: how the report names
    /// its frames. `Err`: it is neither pcapng nor pcap, and nothing of it was taken.
    pub fn read(&mut self, name: &str, source: impl Read) -> Result<(), NoCapture> {
        self.read_with(name, source, &mut |_| {})
    }

    /// Does the same as [`read`](Self::read), and calls `onlooker` with what is measured of each
    /// cycle.
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

    /// Takes a frame that belongs to no file; `frame.number` counts from 1.
    fn take(&mut self, frame: Frame) {
        self.files.packet();
        self.pairing.push(frame);
        self.observe(&mut |_| {});
    }

    /// Counts a capture that can't be read, for example the empty file that a ring buffer of
    /// captures begins, so that the next ones keep their places in the report. `why` is told in the
    /// report.
    pub fn pass_over(&mut self, name: &str, why: &str) {
        self.files.begin(name);
        self.files.end(Tally { ended: Some(why.to_owned()), ..Tally::default() });
    }

    /// Reports what was found. `Err`: no EtherCAT frame is in the captures.
    pub fn report(self, names: &Names) -> Result<DiagnoseReport, Nothing> {
        self.report_with(names, &mut |_| {})
    }

    /// Does the same as [`report`](Self::report), and calls `onlooker` with what is measured of the
    /// last cycles, which wait for their answers until then.
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
        Ok(report::report(&self.files, &self.observer, pairs, tap, names))
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
    fn name(&self, position: Option<u16>, vendor: u32, product: u32) -> Option<String> {
        let by_position = position.and_then(|position| self.positions.get(usize::from(position)));
        by_position.or_else(|| self.identities.get(&(vendor, product))).cloned()
    }
}

//! A capture of anybody's EtherCAT segment in; what is known of it, and what went wrong, out.
//!
//! Data's way: `isocat-captures` reads frames and finds which belong together. `access` takes each
//! exchange apart into datagrams; `observer` keeps what they say, by subject: `device` (which
//! devices there are) with `known` (registers), `sii` (identity), `state`, `mailbox`, `sync_unit`
//! and `counters`; `clock` (drift frames), `cycle` (rhythm and working counters), `phase` (frames
//! against SYNC0), `talker` (sources of frames). All of it is bounded, however long a capture is.
//! At the end `judge` looks what speaks against the segment, as `finding`s with kinds; `words`
//! makes sentences of them, and [`report`] the document.
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
mod clock;
mod counters;
mod cycle;
mod device;
mod files;
mod finding;
mod judge;
mod known;
mod mailbox;
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
use isocat_captures::reading::{NoCapture, Reader};

use files::Files;
pub use finding::KINDS;
use observer::Observer;
pub use report::DiagnoseReport;

/// A diagnosis of one capture, or of several that continue one another.
#[derive(Debug)]
pub struct Diagnosis {
    files: Files,
    pairing: Pairing,
    observer: Observer,
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
    /// Packets that are cut off, broken or of links without Ethernet frames.
    pub unreadable: usize,
}

impl fmt::Display for Nothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { packets, foreign, unreadable } = self;
        write!(
            f,
            "no frame of EtherCAT that can be read (EtherType 0x88A4, or UDP to port 0x88A4); found {packets} packets, {foreign} of \
             other protocols, {unreadable} cut off, broken or of a link without Ethernet frames"
        )
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
        Self { files: Files::default(), pairing: Pairing::new(), observer: Observer::new() }
    }

    /// Reads a capture, which continues those that were read before. `name` is what frames of it
    /// are told with. `Err`: it is neither pcapng nor pcap; nothing of it was taken.
    pub fn read(&mut self, name: &str, source: impl Read) -> Result<(), NoCapture> {
        let mut reader = Reader::new(source)?;
        self.files.begin(name);
        while let Some(mut frame) = reader.frame() {
            frame.number = self.files.number(frame.number);
            self.pairing.push(frame);
            self.observe();
        }
        self.files.end(reader.tally().clone());
        Ok(())
    }

    /// Says what was found. `Err`: no frame of EtherCAT is in the captures.
    pub fn report(mut self, names: &Names) -> Result<DiagnoseReport, Nothing> {
        self.pairing.end();
        self.observe();
        let pairs = self.pairing.tally();
        if self.observer.exchanges == 0 {
            let captures = self.files.reports();
            let sum = |of: fn(&report::CaptureReport) -> usize| captures.iter().map(of).sum();
            let cut: usize = sum(|capture| capture.cut + capture.other_links);
            return Err(Nothing {
                packets: sum(|capture| capture.packets),
                foreign: pairs.foreign,
                unreadable: cut + pairs.broken,
            });
        }
        let tap = self.pairing.tap();
        let name =
            |position: Option<u16>, vendor: u32, product: u32| names.of(position, vendor, product);
        Ok(report::report(&self.files, &self.observer, pairs, tap, &name))
    }

    fn observe(&mut self) {
        while let Some(exchange) = self.pairing.exchange() {
            if let Some(tap) = self.pairing.tap() {
                self.observer.exchange(tap, &exchange);
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

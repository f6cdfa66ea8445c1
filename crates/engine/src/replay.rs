//! Replays the capture of a real segment through a chain of modelled ESCs and compares each answer.
//!
//! How data flow: `exchange` has requests with their answers, `parts` takes frames apart,
//! `evidence` collects what the capture shows of each SubDevice, and `guess` derives its chip from
//! that; `chain` is the model. Before each request `cpu` does at the PDI what the answer shows that
//! the CPU had done (`sight` is the part of a SubDevice's memory that an answer shows). Then the
//! request passes the chain, `compare` finds the differences, and `ledger` their reasons.
//! [`ReplayReport`] reports them.
//!
//! A difference has a [`Kind`]. Some are known variances of parts and sessions
//! ([`Kind::is_explained`]): the model adopts them, so that each is reported once. The others are
//! faults of the model or of the silicon.

mod chain;
mod compare;
mod cpu;
mod evidence;
mod exchange;
mod guess;
mod kind;
mod ledger;
mod names;
mod parts;
mod report;
mod sight;

use std::fmt;

use isocat_captures::reading::Reading;

use chain::Chain;
use compare::{Part, Raw, compare};
use cpu::Cpus;
use evidence::Evidence;
use exchange::{Exchange, Exchanges};
pub use guess::Told;
pub use kind::Kind;
use ledger::Ledger;
use parts::pairs;
#[cfg(feature = "schema")]
pub use report::schema;
pub use report::{DeviceReport, Difference, FORMAT, KindReport, ReplayReport};

/// Why a capture cannot be replayed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Nothing {
    /// It has no EtherCAT frame.
    NoFrames {
        /// Number of frames of other protocols.
        foreign: usize,
        /// Number of packets that the file has truncated, or that are not Ethernet.
        unreadable: usize,
    },
    /// It has only requests.
    NoAnswers {
        /// Their number.
        requests: usize,
        /// Number of packets that the file has truncated, or that are not Ethernet.
        unreadable: usize,
    },
    /// It has only answers.
    NoRequests {
        /// Their number.
        answers: usize,
    },
    /// Frames came back, but no SubDevice incremented a working counter or position.
    NoDevices {
        /// Number of frames.
        frames: usize,
    },
    /// The number of SubDevices exceeds the limit.
    TooMany {
        /// Their number.
        found: usize,
    },
    /// The segment file has another number of SubDevices.
    OtherSegment {
        /// Number in the segment file.
        expected: usize,
        /// Number in the capture.
        found: usize,
    },
}

impl fmt::Display for Nothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoFrames { foreign, unreadable } => write!(
                f,
                "the capture has no frame of EtherCAT that can be read; found {foreign} of other protocols and {unreadable} that are cut \
                 off or none of Ethernet"
            ),
            Self::NoAnswers { requests, unreadable: 0 } => write!(
                f,
                "the capture has {requests} requests and no answer: no SubDevice was there, or only one direction was captured; \
                 expected both directions in one file"
            ),
            Self::NoAnswers { requests, unreadable } => write!(
                f,
                "the capture has {requests} requests and no answer that can be read, and {unreadable} frames that are cut off or none \
                 of Ethernet; expected whole frames of both directions in one file"
            ),
            Self::NoRequests { answers } => write!(
                f,
                "the capture has {answers} answers and no request that belongs to them; expected both directions in one file"
            ),
            Self::NoDevices { frames } => {
                write!(f, "{frames} frames came back and no SubDevice has counted in them")
            }
            Self::TooMany { found } => write!(
                f,
                "positions are counted up by {found}; expected at most {MOST_DEVICES} SubDevices"
            ),
            Self::OtherSegment { expected, found } => {
                write!(f, "the segment file has {expected} SubDevices, the capture shows {found}")
            }
        }
    }
}

impl std::error::Error for Nothing {}

/// Replays a capture; `source` names it. `told` is what a segment file states of each SubDevice.
pub fn replay(
    source: &str,
    reading: &Reading,
    told: Option<&[Told]>,
) -> Result<ReplayReport, Nothing> {
    let exchanges = Exchanges::of(&reading.frames);
    let devices = countable(reading, &exchanges)?;
    if let Some(told) = told.filter(|told| told.len() != devices) {
        return Err(Nothing::OtherSegment { expected: told.len(), found: devices });
    }
    let stations = evidence::stations_before(&exchanges.list, devices);
    let evidence = Evidence::of(&exchanges.list, stations);
    let builds = guess::builds(&evidence, told);
    let mut report = ReplayReport::begin(source, reading, &exchanges);
    report.describe(&evidence, &builds, told);
    let mut replayer = Replayer {
        chain: Chain::new(&evidence, builds),
        cpus: Cpus::new(devices),
        ledger: Ledger::new(devices),
        reached: devices,
    };
    for at in 0..exchanges.list.len() {
        replayer.exchange(&exchanges.list[at..], &mut report);
    }
    report.end();
    Ok(report)
}

/// The number of SubDevices, if there is anything to compare.
fn countable(reading: &Reading, exchanges: &Exchanges) -> Result<usize, Nothing> {
    let requests = exchanges.list.len();
    if requests == 0 && exchanges.tally.answers_alone > 0 {
        return Err(Nothing::NoRequests { answers: exchanges.tally.answers_alone });
    }
    let unreadable = reading.tally.cut + reading.tally.other_links + exchanges.tally.broken;
    if requests == 0 {
        return Err(Nothing::NoFrames { foreign: exchanges.tally.foreign, unreadable });
    }
    if exchanges.unanswered() == requests {
        return Err(Nothing::NoAnswers { requests, unreadable });
    }
    match evidence::devices(&exchanges.list) {
        0 => Err(Nothing::NoDevices { frames: requests - exchanges.unanswered() }),
        found if found > MOST_DEVICES => Err(Nothing::TooMany { found }),
        devices => Ok(devices),
    }
}

struct Replayer {
    chain: Chain,
    cpus: Cpus,
    ledger: Ledger,
    /// Number of SubDevices that the last frame reached.
    reached: usize,
}

impl Replayer {
    /// Replays the first of these exchanges; the others follow later.
    fn exchange(&mut self, ahead: &[Exchange], report: &mut ReplayReport) {
        let Some(exchange) = ahead.first() else { return };
        self.chain.advance(exchange.at);
        let stations = sight::stations(&self.chain);
        let Some((answer, _)) = &exchange.answer else {
            let mut frame = exchange.request.clone();
            self.chain.pass(&mut frame, self.reached);
            self.ledger.lost();
            return;
        };
        let change = self.reach(exchange);
        self.cpus.act(&mut self.chain, ahead);
        let mut frame = exchange.request.clone();
        self.chain.pass(&mut frame, self.reached);
        let (found, compared) = compare(exchange, &frame, &self.chain, &stations);
        let mut list = Vec::new();
        list.extend(change.map(|raw| (raw, Kind::SegmentChange)));
        for raw in found {
            let kind = self.ledger.kind(&raw, exchange, &self.chain);
            self.ledger.adopt(&raw, kind, &mut self.chain);
            list.push((raw, kind));
        }
        self.ledger.compared(list.is_empty());
        self.ledger.note(exchange, &stations);
        report.compared(exchange, *answer, compared, &list);
    }

    /// Determines the number of SubDevices that a frame reached, from the positions that it
    /// counted. Returns a difference if that number has changed.
    fn reach(&mut self, exchange: &Exchange) -> Option<Raw> {
        let passed = pairs(exchange).iter().find_map(parts::Pair::passed)?;
        let passed = passed.min(self.chain.escs.len());
        let before = std::mem::replace(&mut self.reached, passed);
        (before != passed).then(|| Raw {
            datagram: 0,
            part: Part::Position,
            device: None,
            address: None,
            silicon: (passed as u16).to_le_bytes().to_vec(),
            model: (before as u16).to_le_bytes().to_vec(),
        })
    }
}

/// Limit of the SubDevices in a capture. A segment has at most 65 535; captures at hand have ten.
const MOST_DEVICES: usize = 1024;

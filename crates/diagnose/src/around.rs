//! What happened in the frames around the first fault: a second look at the captures, once it is
//! known which frame that is.
//!
//! Consecutive exchanges with the same meaning are one moment, so there are few moments before and
//! after the fault, however short the cycle is.

use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::time::Duration;

use isocat_captures::pairing::{Exchange, Pairing, Tap};
use isocat_captures::probe::Probe;
use isocat_captures::reading::{NoCapture, Reader};
use isocat_sync::explain::registers;
use isocat_wire::Command;
use isocat_wire::al::{AlControl, AlStatus, AlStatusCode};

use crate::access::{Access, accesses, is_broadcast};
use crate::files::Files;
use crate::report::{
    AroundReport, DeviceReport, DiagnoseReport, FrameRef, MomentReport, WeightKind,
};
use crate::talker::source;

/// Looks at the captures of a report once more, in the same order.
#[derive(Debug)]
pub struct Around {
    files: Files,
    pairing: Pairing,
    tap: Option<Tap>,
    probe: Option<Probe>,
    /// Place of the finding in the report, and the number of its frame over all captures.
    finding: usize,
    center: usize,
    /// Kinds of the findings that name a frame, by the frame's number over all captures.
    named: BTreeMap<usize, Vec<&'static str>>,
    /// Names of devices by station address and by position.
    stations: BTreeMap<u16, String>,
    positions: BTreeMap<u16, String>,
    several_sources: bool,
    moments: VecDeque<Moment>,
    /// Stamp of the exchange that shows the fault; `None` until that exchange was read.
    met: Option<Duration>,
    /// Exchanges read after the fault, and the moments that they make.
    exchanges_behind: usize,
    moments_behind: usize,
}

/// Consecutive exchanges that say the same.
#[derive(Debug)]
struct Moment {
    request: Option<usize>,
    answer: Option<usize>,
    last: usize,
    times: u64,
    at: Duration,
    what: String,
    findings: Vec<&'static str>,
    is_center: bool,
}

impl Around {
    /// Looks for the first fault of a report; `None`: there is none.
    pub fn new(report: &DiagnoseReport) -> Option<Self> {
        let is_fault = |one: &&crate::report::FindingReport| one.weight == WeightKind::Fault;
        let first = report.findings.iter().find(is_fault)?;
        let number = |at: FrameRef| report.number_in_copy(at);
        let mut named: BTreeMap<usize, Vec<&'static str>> = BTreeMap::new();
        for finding in &report.findings {
            for frame in [finding.frame].iter().chain(&finding.evidence) {
                let kinds = named.entry(number(*frame)).or_default();
                if !kinds.contains(&finding.kind) {
                    kinds.push(finding.kind);
                }
            }
        }
        let devices = &report.devices;
        let names = || devices.iter().filter_map(|one| Some((one, own_name(one, devices)?)));
        Some(Self {
            files: Files::default(),
            pairing: Pairing::new(),
            tap: None,
            probe: None,
            finding: report.findings.iter().position(|one| one == first)?,
            center: number(first.frame),
            named,
            stations: names().filter_map(|(d, n)| Some((d.station.as_ref()?.value, n))).collect(),
            positions: names().filter_map(|(d, n)| Some((d.position?, n))).collect(),
            several_sources: report.frames.sources.len() > 1,
            moments: VecDeque::new(),
            met: None,
            exchanges_behind: 0,
            moments_behind: 0,
        })
    }

    /// Sets the probe whose header precedes each packet of the captures.
    pub fn with_probe(self, probe: Option<Probe>) -> Self {
        Self { probe, ..self }
    }

    /// Reads the next capture, until the moments around the fault are complete.
    pub fn read(&mut self, name: &str, source: impl Read) -> Result<(), NoCapture> {
        if self.is_done() {
            return Ok(());
        }
        let mut reader = Reader::new(source)?.with_probe(self.probe);
        self.files.begin(name);
        while let Some(mut frame) = reader.frame() {
            frame.number = self.files.number(frame.number);
            self.pairing.push(frame);
            self.look();
            if self.is_done() {
                break;
            }
        }
        self.files.end(reader.tally().clone());
        Ok(())
    }

    /// Counts a capture that can't be read, so that the next ones keep their places in the report.
    pub fn pass_over(&mut self) {
        self.files.begin("");
    }

    /// Writes into the report what was seen.
    pub fn end(mut self, report: &mut DiagnoseReport) {
        self.pairing.end();
        self.look();
        let Some(center) = self.met else { return };
        let place = |number: usize| self.files.place(number);
        let moments = self.moments.iter().map(|moment| MomentReport {
            request: moment.request.map(place),
            answer: moment.answer.map(place),
            last: place(moment.last),
            times: moment.times,
            at_ns: signed(moment.at) - signed(center),
            what: moment.what.clone(),
            findings: moment.findings.clone(),
        });
        let moments = moments.collect();
        report.around = Some(AroundReport { finding: self.finding, moments });
    }

    fn is_done(&self) -> bool {
        self.exchanges_behind >= EXCHANGES_BEHIND || self.moments_behind > MOMENTS
    }

    fn look(&mut self) {
        while let Some(exchange) = self.pairing.exchange() {
            self.tap = self.tap.or(self.pairing.tap());
            if let Some(tap) = self.tap.filter(|_| !self.is_done()) {
                self.exchange(tap, &exchange);
            }
        }
    }

    fn exchange(&mut self, tap: Tap, exchange: &Exchange) {
        let Some(first) = exchange.request.as_ref().or(exchange.answer.as_ref()) else { return };
        let request = exchange.request.as_ref().map(|frame| frame.number);
        let answer = exchange.answer.as_ref().map(|frame| frame.number);
        let last = answer.or(request).unwrap_or_default();
        if last + FRAMES_BEFORE < self.center {
            return;
        }
        let is_center = request == Some(self.center) || answer == Some(self.center);
        let kinds = [request, answer].into_iter().flatten();
        let mut findings: Vec<&'static str> =
            kinds.filter_map(|number| self.named.get(&number)).flatten().copied().collect();
        findings.dedup();
        let mut what = self.words(tap, exchange);
        if self.several_sources {
            let address = source(first).map_or("?".to_owned(), crate::words::mac);
            what = format!("{address}: {what}");
        }
        if is_center && self.met.is_none() {
            self.met = Some(first.at);
        }
        self.exchanges_behind += usize::from(self.met.is_some());
        let like = self.moments.back_mut().filter(|last| {
            !is_center && !last.is_center && last.what == what && last.findings == findings
        });
        if let Some(moment) = like {
            moment.times += 1;
            moment.last = last;
            return;
        }
        self.moments_behind += usize::from(self.met.is_some());
        let (times, at) = (1, first.at);
        let moment = Moment { request, answer, last, times, at, what, findings, is_center };
        self.moments.push_back(moment);
        if self.met.is_none() && self.moments.len() > MOMENTS {
            self.moments.pop_front();
        }
        if self.moments_behind > MOMENTS + 1 {
            self.moments.pop_back();
        }
    }

    /// Describes an exchange in words.
    fn words(&self, tap: Tap, exchange: &Exchange) -> String {
        let mut all = Vec::new();
        let mut more = 0;
        for access in accesses(exchange, tap, None) {
            match all.len() < DATAGRAMS {
                true => all.push(self.access(&access)),
                false => more += 1,
            }
        }
        if more > 0 {
            all.push(format!("{more} more"));
        }
        let what = all.join("; ");
        match (&exchange.request, &exchange.answer) {
            (_, None) => format!("{what}: no answer"),
            (None, _) => format!("{what}: an answer alone"),
            _ => what,
        }
    }

    fn access(&self, access: &Access<'_>) -> String {
        let command = access.command;
        let wkc = access.wkc().map_or(String::new(), |wkc| format!(", wkc {wkc}"));
        if command.is_logical() {
            return format!("{command} {:#010x}{wkc}", access.header.address);
        }
        let whom = match access.position {
            _ if is_broadcast(command) => "all".to_owned(),
            Some(position) => {
                self.positions.get(&position).cloned().unwrap_or(format!("position {position}"))
            }
            None if command.increments_position() => format!("{:#06x}", access.header.adp()),
            None => {
                let station = access.header.adp();
                self.stations.get(&station).cloned().unwrap_or(format!("{station:#06x}"))
            }
        };
        let name = match registers::explain(access.ado()) {
            Some(register) => register.name.to_owned(),
            None => format!("{:#06x}", access.ado()),
        };
        format!("{command} {name} of {whom}{}{wkc}", value(access))
    }
}

/// The name of a device; with its number if other devices have the same name.
fn own_name(device: &DeviceReport, devices: &[DeviceReport]) -> Option<String> {
    let name = device.name.as_ref()?;
    match devices.iter().filter(|other| other.name.as_ref() == Some(name)).count() {
        1 => Some(name.clone()),
        _ => Some(device.title()),
    }
}

fn value(access: &Access<'_>) -> String {
    let Some(data) = access.written().or(access.read()) else { return String::new() };
    let word = match *data {
        [low] => u16::from(low),
        [low, high, ..] => u16::from_le_bytes([low, high]),
        [] => return String::new(),
    };
    match access.ado() {
        0x0120 => {
            let acknowledged = if AlControl(word).acknowledge() { ", acknowledged" } else { "" };
            format!(" = {}{acknowledged}", AlStatus(word & 0x0F))
        }
        0x0130 if access.command != Command::Brd => {
            let code = data.get(4..6).map(|code| u16::from_le_bytes([code[0], code[1]]));
            let code = code.filter(|code| *code != 0);
            let code = code.map_or(String::new(), |code| format!(", code {code:#06x}"));
            format!(" = {}{code}", AlStatus(word))
        }
        0x0130 => format!(" = {word:#06x}"),
        0x0134 => format!(" = {}", AlStatusCode(word)),
        0x0980 | 0x0981 => format!(" = {word:#06x}"),
        _ => String::new(),
    }
}

fn signed(at: Duration) -> i64 {
    i64::try_from(at.as_nanos()).unwrap_or(i64::MAX)
}

/// Moments that are kept on each side of the fault.
const MOMENTS: usize = 6;
/// Frames before the fault that are looked at.
const FRAMES_BEFORE: usize = 4096;
/// Exchanges after the fault that are looked at.
const EXCHANGES_BEHIND: usize = 2048;
/// Datagrams of an exchange that are described; further ones are counted.
const DATAGRAMS: usize = 4;

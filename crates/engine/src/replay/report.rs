//! The result of a replay, for programs and for people.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use isocat_captures::reading::Reading;
use isocat_descriptions::columns::{WIDTH, wrap};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::compare::{Part, Raw};
use super::evidence::Evidence;
use super::exchange::{Exchange, Exchanges};
use super::guess::{Build, Told};
use super::kind::Kind;
use super::names::name;
use super::parts::pairs;
use crate::report::{BAD, GOOD, QUIET};

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-replay/1";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<ReplayReport>(FORMAT)
}

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ReplayReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The capture.
    pub capture: String,
    /// Whether each compared frame is exact or explained.
    pub agrees: bool,
    /// One sentence for people.
    pub verdict: String,
    /// The SubDevices as they were modelled, by position.
    pub devices: Vec<DeviceReport>,
    /// Packets in the file.
    pub packets: usize,
    /// Number of compared answers.
    pub frames: usize,
    /// Of these, answers that the model gives bit for bit.
    pub exact: usize,
    /// Of these, answers that differ only by known variances.
    pub explained: usize,
    /// Of these, answers with at least one difference that is not explained.
    pub different: usize,
    /// Number of compared data bytes.
    pub bytes: usize,
    /// Requests without an answer.
    pub unanswered: usize,
    /// Answers without a request.
    pub answers_alone: usize,
    /// Frames that are in the file twice.
    pub duplicates: usize,
    /// Packets of other protocols or interfaces, and truncated or broken ones.
    pub left_out: usize,
    /// Why the file was not read to its end; null if it was.
    pub ended: Option<String>,
    /// Occurrences of each kind of difference.
    pub kinds: Vec<KindReport>,
    /// The differences in their order, at most 10 000.
    pub differences: Vec<Difference>,
    /// Number of differences beyond these.
    pub differences_left_off: usize,
}

/// A SubDevice as it was modelled.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceReport {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Its name in the segment file; null without one.
    pub name: Option<String>,
    /// The chip.
    pub chip: &'static str,
    /// Whether neither capture nor segment file determines the chip: then it is the one that
    /// contradicts the capture least.
    pub guessed: bool,
    /// SII word 0: PDI control in the low byte, ESC configuration in the high byte.
    pub pdi: u16,
    /// Product code in its EEPROM; null if it was not read.
    pub product_code: Option<u32>,
    /// Bytes of the EEPROM that the capture shows.
    pub eeprom_bytes: usize,
    /// Write time of its EEPROM, ns, as far as the capture shows it.
    pub eeprom_burn_time_ns: i64,
    /// Station address from before the capture; null if none was used.
    pub station_before: Option<u16>,
}

/// A kind of difference.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct KindReport {
    /// Its name.
    pub kind: &'static str,
    /// Whether it is a known variance of parts or sessions.
    pub explained: bool,
    /// Number of frames with this kind.
    pub frames: usize,
    /// Number of occurrences.
    pub differences: usize,
}

/// One difference.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Difference {
    /// Number of the answer in the file.
    pub frame: usize,
    /// Number of its request.
    pub request: usize,
    /// Datagram in the frame, from 0.
    pub datagram: usize,
    /// Command and address, such as `FPRD 0x1001:0x0130`.
    pub command: String,
    /// Position of the SubDevice; null if it may be one of several.
    pub device: Option<usize>,
    /// The part that differs: a register by its name, or a part of the frame.
    pub place: String,
    /// Its address; null for parts of the frame.
    pub address: Option<u16>,
    /// Answer of the silicon: bytes in hex in the order of the frame, or a number for counters.
    pub expected: String,
    /// Answer of the model.
    pub found: String,
    /// The kind.
    pub kind: &'static str,
    /// Whether it is a known variance of parts or sessions.
    pub explained: bool,
}

impl ReplayReport {
    pub(super) fn begin(source: &str, reading: &Reading, exchanges: &Exchanges) -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            capture: source.to_owned(),
            agrees: false,
            verdict: String::new(),
            devices: Vec::new(),
            packets: reading.tally.packets,
            frames: 0,
            exact: 0,
            explained: 0,
            different: 0,
            bytes: 0,
            unanswered: exchanges.unanswered(),
            answers_alone: exchanges.tally.answers_alone,
            duplicates: exchanges.tally.duplicates,
            left_out: exchanges.tally.foreign
                + exchanges.tally.broken
                + exchanges.tally.elsewhere
                + reading.tally.cut
                + reading.tally.other_links,
            ended: reading.tally.ended.clone(),
            kinds: Vec::new(),
            differences: Vec::new(),
            differences_left_off: 0,
        }
    }

    pub(super) fn describe(
        &mut self,
        evidence: &Evidence,
        builds: &[Build],
        told: Option<&[Told]>,
    ) {
        for (position, (device, build)) in evidence.devices.iter().zip(builds).enumerate() {
            let word = |word: u32| device.words.get(&word).copied().map(u32::from);
            let product = word(0x0A).zip(word(0x0B)).map(|(low, high)| low | high << 16);
            self.devices.push(DeviceReport {
                position,
                name: told.map(|told| told[position].name.clone()),
                chip: build.chip.name,
                guessed: build.guessed,
                pdi: u16::from_le_bytes([build.configuration[0], build.configuration[1]]),
                product_code: product,
                eeprom_bytes: 2 * device.words.len(),
                eeprom_burn_time_ns: build.chip.eeprom_burn_time.0,
                station_before: device.station,
            });
        }
    }

    pub(super) fn compared(
        &mut self,
        exchange: &Exchange,
        answer: usize,
        bytes: usize,
        list: &[(Raw, Kind)],
    ) {
        self.frames += 1;
        self.bytes += bytes;
        match list {
            [] => self.exact += 1,
            list if list.iter().all(|(_, kind)| kind.is_explained()) => self.explained += 1,
            _ => self.different += 1,
        }
        let mut kinds: BTreeMap<Kind, usize> = BTreeMap::new();
        for (raw, kind) in list {
            *kinds.entry(*kind).or_default() += 1;
            match self.differences.len() < MOST_DIFFERENCES {
                true => self.differences.push(difference(exchange, answer, raw, *kind)),
                false => self.differences_left_off += 1,
            }
        }
        for (kind, times) in kinds {
            match self.kinds.iter_mut().find(|known| known.kind == kind.name()) {
                Some(known) => {
                    known.frames += 1;
                    known.differences += times;
                }
                None => self.kinds.push(KindReport {
                    kind: kind.name(),
                    explained: kind.is_explained(),
                    frames: 1,
                    differences: times,
                }),
            }
        }
    }

    pub(super) fn end(&mut self) {
        self.agrees = self.different == 0;
        self.kinds.sort_by_key(|kind| (kind.explained, kind.kind));
        let devices = match self.devices.len() {
            1 => "1 SubDevice".to_owned(),
            number => format!("{number} SubDevices"),
        };
        let Self { frames, exact, explained, different, .. } = self;
        self.verdict = match (*different, *explained) {
            (0, 0) => format!("The model answers as {devices} did: all {frames} frames are exact."),
            (0, explained) => format!(
                "The model answers as {devices} did: {exact} of {frames} frames are exact, {explained} differ by known variances."
            ),
            (different, explained) => format!(
                "The model differs from {devices} in {different} of {frames} frames; {exact} are exact, {explained} differ by known \
                 variances."
            ),
        };
    }

    /// The report as text with ANSI styles; with `all` each difference, otherwise the first ones.
    pub fn text(&self, all: bool) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text, all);
        text
    }

    fn write(&self, out: &mut String, all: bool) -> fmt::Result {
        let style = if self.agrees { GOOD } else { BAD };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        writeln!(out, "{QUIET}{}{QUIET:#}", self.capture)?;
        writeln!(
            out,
            "\n{} packets: {} answers compared with {} data bytes, {} requests without answer, {} answers without request, {} twice, {} \
             left out",
            self.packets,
            self.frames,
            self.bytes,
            self.unanswered,
            self.answers_alone,
            self.duplicates,
            self.left_out
        )?;
        if let Some(why) = &self.ended {
            writeln!(out, "not read to its end: {why}")?;
        }
        writeln!(out, "\n  # chip                      PDI     product     EEPROM")?;
        for device in &self.devices {
            let product = device.product_code.map_or(String::new(), |code| format!("{code:#010x}"));
            let guessed = if device.guessed { "  (chip guessed)" } else { "" };
            writeln!(
                out,
                "{:>3} {:<25} {:#06x}  {product:<10}  {} bytes seen{guessed}{}",
                device.position,
                device.chip,
                device.pdi,
                device.eeprom_bytes,
                device.name.as_ref().map_or(String::new(), |name| format!("  {name}"))
            )?;
        }
        self.write_differences(out, all)
    }

    fn write_differences(&self, out: &mut String, all: bool) -> fmt::Result {
        if self.kinds.is_empty() {
            return Ok(());
        }
        writeln!(out, "\nframes  differences")?;
        for kind in &self.kinds {
            let known = if kind.explained { "  known variance" } else { "" };
            writeln!(out, "{:>6}  {:>11}  {}{known}", kind.frames, kind.differences, kind.kind)?;
        }
        writeln!(out, "\n frame  what                                      silicon -> model")?;
        let most = if all { usize::MAX } else { SHOWN };
        // If not all are shown, differences that are not explained come first.
        let mut shown: Vec<&Difference> = self.differences.iter().collect();
        if !all {
            shown.sort_by_key(|difference| difference.explained);
        }
        for difference in shown.iter().take(most) {
            let Difference { frame, command, place, expected, found, kind, .. } = difference;
            let device = difference.device.map_or(String::new(), |at| format!(" [{at}]"));
            writeln!(out, "{frame:>6}  {command}{device} {place}: {expected} -> {found}  {kind}")?;
        }
        let more = self.differences.len().saturating_sub(most) + self.differences_left_off;
        if more > 0 {
            writeln!(out, "        and {more} more; --all or --json shows them")?;
        }
        Ok(())
    }
}

fn difference(exchange: &Exchange, answer: usize, raw: &Raw, kind: Kind) -> Difference {
    let pairs = pairs(exchange);
    let command = pairs.get(raw.datagram).map_or(String::new(), |pair| {
        let header = pair.sent.header;
        match pair.command.is_logical() {
            true => format!("{} {:#010x}", pair.command, header.address),
            false => format!("{} {:#06x}:{:#06x}", pair.command, header.adp(), header.ado()),
        }
    });
    let number = |bytes: &[u8]| {
        let bytes = [bytes.first(), bytes.get(1)].map(|byte| byte.copied().unwrap_or(0));
        u16::from_le_bytes(bytes)
    };
    let value = |bytes: &[u8]| match raw.part {
        Part::WorkingCounter | Part::Position => number(bytes).to_string(),
        Part::EventField => format!("{:#06x}", number(bytes)),
        Part::Source | Part::Data => hex(bytes),
    };
    let place = match (raw.part, raw.address) {
        (Part::WorkingCounter, _) => "working counter".to_owned(),
        (Part::Position, _) if kind == Kind::SegmentChange => "SubDevices reached".to_owned(),
        (Part::Position, _) => "position (ADP)".to_owned(),
        (Part::EventField, _) => "IRQ field".to_owned(),
        (Part::Source, _) => "source address".to_owned(),
        (Part::Data, Some(address)) => format!("{} ({address:#06x})", name(address)),
        (Part::Data, None) => "data that no FMMU maps".to_owned(),
    };
    Difference {
        frame: answer,
        request: exchange.request_number,
        datagram: raw.datagram,
        command,
        device: raw.device,
        place,
        address: raw.address.filter(|_| raw.part == Part::Data),
        expected: value(&raw.silicon),
        found: value(&raw.model),
        kind: kind.name(),
        explained: kind.is_explained(),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Number of differences that a report keeps.
const MOST_DIFFERENCES: usize = 10_000;
/// Number of differences in the text unless all are asked for.
const SHOWN: usize = 20;

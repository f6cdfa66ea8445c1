//! What a diagnosis says, for programs and for people.

use std::time::Duration;

use isocat_captures::pairing::{Seen as TapSeen, Tally as Pairs, Tap};
use schemars::JsonSchema;
use serde::Serialize;

use crate::access::shows_answers;
use crate::files::Files;
use crate::finding::{Finding, Sure, Weight};
use crate::observer::Observer;
use crate::{clock, cycle, judge, words};

mod device;
mod text;
mod unknown;

pub use device::{
    Aborts, DeviceReport, Distance, ErrorCounter, Esc, FmmuReport, Identity, MailboxReport,
    ObjectValue, StateReport, SyncManagerReport, SyncSwitch,
};

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-diagnose/1";

/// JSON schema of the document, draft 2020-12.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(DiagnoseReport).to_value()
}

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct DiagnoseReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// What it comes to.
    pub verdict: Verdict,
    /// The captures, in the order in which they were read.
    pub captures: Vec<CaptureReport>,
    /// The frames of all of them.
    pub frames: FramesReport,
    /// How the capture saw the segment; null without frames of EtherCAT.
    pub tap: Option<TapReport>,
    /// What speaks against the segment: faults first, each in the order of time.
    pub findings: Vec<FindingReport>,
    /// The devices, by position; those of which no position is known come last.
    pub devices: Vec<DeviceReport>,
    /// How many SubDevices frames passed: the first number and each change, up to 256.
    pub reach: Vec<ReachReport>,
    /// The drift frames and the clock that they read; null if there are none.
    pub clock: Option<ClockReport>,
    /// The cyclic exchange; null if there is none.
    pub cycle: Option<CycleReport>,
    /// What the capture does not show.
    pub unknown: Vec<String>,
}

/// What a diagnosis comes to.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Verdict {
    /// In one word.
    pub kind: VerdictKind,
    /// One sentence for people.
    pub sentence: String,
}

/// In one word.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum VerdictKind {
    /// Frames came before their SYNC0 in operation, and no fault was found.
    InSync,
    /// No fault was found; whether the segment was in sync the capture does not show.
    NothingFound,
    /// At least one fault was found.
    Found,
}

/// One capture.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct CaptureReport {
    /// Its name, as the user gave it.
    pub name: String,
    /// Packets in it, of whatever protocol.
    pub packets: usize,
    /// Packets of which the file does not hold all bytes of EtherCAT.
    pub cut: usize,
    /// Packets of links without Ethernet frames.
    pub other_links: usize,
    /// Why it was not read to its end; null if it was.
    pub ended: Option<String>,
}

/// The frames of all captures.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct FramesReport {
    /// Requests with their answers.
    pub pairs: usize,
    /// Requests without an answer.
    pub unanswered: usize,
    /// Answers without a request.
    pub answers_alone: usize,
    /// Frames that are there twice.
    pub duplicates: usize,
    /// Frames of interfaces other than the MainDevice's port.
    pub elsewhere: usize,
    /// Frames of EtherCAT whose datagrams are cut off or contradict themselves.
    pub broken: usize,
    /// Frames of other protocols.
    pub foreign: usize,
    /// From the first frame of EtherCAT to the last, ns, by the stamps.
    pub span_ns: u64,
    /// Frames whose stamp is earlier than that of the one before.
    pub backwards: u64,
    /// Source addresses of the MainDevices, as they send; up to 16.
    pub sources: Vec<SourceReport>,
}

/// Frames of one source address.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SourceReport {
    /// Without the bit that the first SubDevice sets.
    pub address: String,
    /// How many.
    pub frames: u64,
    /// The first of them.
    pub first: FrameRef,
}

/// How a capture saw the segment.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct TapReport {
    /// Which frames it saw.
    pub seen: SeenKind,
    /// Bit 1 of the source address tells answers from requests; if not, the datagrams do.
    pub marked: bool,
    /// SubDevices between the MainDevice and the tap.
    pub behind: u16,
    /// The interface of the file, from 0; null: all count.
    pub interface: Option<u32>,
    /// Both ends of a ring were captured; what the MainDevice sends from its second port is left out.
    pub ring: bool,
}

/// Which frames a capture saw.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SeenKind {
    /// Both directions.
    Both,
    /// Frames on their way out alone.
    Out,
    /// Frames on their way back alone.
    Back,
}

/// A frame of a capture, as Wireshark numbers it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct FrameRef {
    /// Place of the capture in the list, from 0.
    pub capture: usize,
    /// Number of the frame in it, from 1.
    pub frame: usize,
}

/// A value, and the frame that shows it.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Shown<T> {
    /// The value.
    pub value: T,
    /// The frame; of several the latest.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// One finding.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct FindingReport {
    /// Its kind; docs/diagnose.md lists all.
    pub kind: &'static str,
    /// How much it weighs.
    pub weight: WeightKind,
    /// Whether the frames show it, or only fit.
    pub sure: SureKind,
    /// Place of the device in `devices`; null: the segment.
    pub device: Option<usize>,
    /// One sentence for people.
    pub what: String,
    /// The first frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT; null: the frame alone is known.
    pub at_ns: Option<u64>,
    /// Further frames that belong to it.
    pub evidence: Vec<FrameRef>,
    /// What to do, likeliest first.
    pub remedies: Vec<String>,
}

/// How much a finding weighs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WeightKind {
    /// Something went wrong.
    Fault,
    /// Something was forgotten, or done otherwise than it should be, and did no harm yet.
    Warning,
    /// Worth knowing.
    Note,
}

/// How sure a finding is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SureKind {
    /// The frames show it.
    Shown,
    /// The frames fit, and something else would show the same.
    Likely,
}

/// How many SubDevices frames passed from some frame on.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ReachReport {
    /// SubDevices.
    pub subdevices: u16,
    /// The first frame that passed so many.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// The drift frames.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ClockReport {
    /// FRMW or ARMW.
    pub command: &'static str,
    /// Place of the reference in `devices`; null: it is none of them.
    pub reference: Option<usize>,
    /// Its address: a station for FRMW, a position for ARMW.
    pub address: u16,
    /// How many there are.
    pub frames: u64,
    /// The first and the last of them.
    pub first: FrameRef,
    /// The last of them.
    pub last: FrameRef,
    /// Bytes of the time that they bring, 4 or 8.
    pub bytes: u16,
    /// The longest time without one in operation, ns by the stamps; null: not known.
    pub longest_gap_ns: Option<u64>,
    /// How often the reference became another one.
    pub changes: u64,
}

/// The cyclic exchange.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct CycleReport {
    /// In operation since this frame; null: no state of operation was seen.
    pub operation: Option<FrameRef>,
    /// From one cycle to the next by the stamps of the capture.
    pub by_stamps: Option<RhythmReport>,
    /// The same by the clock of the reference, to its 10 ns: not touched by the stamps.
    pub by_clock: Option<RhythmReport>,
    /// The logical datagrams.
    pub transmissions: Vec<TransmissionReport>,
}

/// From one cycle to the next, ns.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct RhythmReport {
    /// Intervals.
    pub count: u64,
    /// Their mean.
    pub mean_ns: u64,
    /// Half of them are not longer, to three digits.
    pub median_ns: u64,
    /// 99 % of them are not longer, to three digits.
    pub most_99_ns: u64,
    /// The shortest.
    pub shortest_ns: Shown<u64>,
    /// The longest.
    pub longest_ns: Shown<u64>,
}

/// A logical datagram.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct TransmissionReport {
    /// LRD, LWR or LRW.
    pub command: &'static str,
    /// First logical address.
    pub address: u32,
    /// Bytes.
    pub bytes: u16,
    /// Frames with it, in the whole capture.
    pub frames: u64,
    /// The first of them.
    pub first: FrameRef,
    /// The working counter that came back most often in operation; null: none did.
    pub usual_working_counter: Option<u16>,
    /// What the FMMUs that the capture shows make of it; null: they do not map all of it.
    pub computed_working_counter: Option<u16>,
    /// Frames that came back with less than usual in operation.
    pub low: u64,
    /// Frames without an answer in operation.
    pub lost: u64,
}

/// Makes the document.
pub(crate) fn report(
    files: &Files,
    observer: &Observer,
    pairs: Pairs,
    tap: Option<Tap>,
    names: &dyn Fn(Option<u16>, u32, u32) -> Option<String>,
) -> DiagnoseReport {
    let order = order(observer);
    let findings = tap.map_or(Vec::new(), |tap| judge::findings(observer, tap));
    let builder = Builder { files, observer, order };
    let devices: Vec<DeviceReport> = (0..builder.order.len())
        .map(|at| device::report(&builder, builder.order[at], names))
        .collect();
    let findings: Vec<FindingReport> =
        findings.iter().map(|finding| builder.finding(finding, &devices)).collect();
    let mut report = DiagnoseReport {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION"),
        verdict: Verdict { kind: VerdictKind::NothingFound, sentence: String::new() },
        captures: files.reports(),
        frames: builder.frames(pairs),
        tap: tap.map(tap_report),
        findings,
        devices,
        reach: builder.reach(),
        clock: builder.clock(),
        cycle: builder.cycle(),
        unknown: Vec::new(),
    };
    report.unknown = unknown::unknown(&report, tap.is_some_and(shows_answers));
    report.verdict = report.judge();
    report
}

impl DiagnoseReport {
    /// Whether a fault was found.
    pub fn found(&self) -> bool {
        self.verdict.kind == VerdictKind::Found
    }

    fn judge(&self) -> Verdict {
        let faults: Vec<&FindingReport> =
            self.findings.iter().filter(|one| one.weight == WeightKind::Fault).collect();
        let measured: Vec<&Distance> =
            self.devices.iter().filter_map(|device| device.distance.as_ref()).collect();
        let frames = measured.iter().map(|distance| distance.frames).max().unwrap_or(0);
        let (kind, sentence) = match (faults.first(), frames) {
            (Some(first), _) => {
                let more = match faults.len() - 1 {
                    0 => String::new(),
                    1 => "; one more fault was found".to_owned(),
                    more => format!("; {more} more faults were found"),
                };
                let sentence =
                    format!("First at {}: {}{more}.", self.frame(first.frame), first.what);
                (VerdictKind::Found, sentence)
            }
            (None, 1..) => {
                let least = measured.iter().map(|distance| distance.shortest_ns.value).min();
                let sentence = format!(
                    "In sync as far as the capture shows it: {frames} cyclic frames came before their SYNC0 at {} devices, {} before it at least.",
                    measured.len(),
                    words::ns(least.unwrap_or(0).max(0) as u64)
                );
                (VerdictKind::InSync, sentence)
            }
            (None, 0) => {
                let sentence = "No fault was found; whether devices were in sync is not known.";
                (VerdictKind::NothingFound, sentence.to_owned())
            }
        };
        Verdict { kind, sentence }
    }

    /// `frame 17`; with several captures `frame 17 of b.pcapng`.
    pub(crate) fn frame(&self, at: FrameRef) -> String {
        match self.captures.get(at.capture) {
            Some(capture) if self.captures.len() > 1 => {
                format!("frame {} of {}", at.frame, capture.name)
            }
            _ => format!("frame {}", at.frame),
        }
    }
}

/// Places of the observer's devices in the order of the document.
fn order(observer: &Observer) -> Vec<usize> {
    let mut order: Vec<usize> = (0..observer.devices.list.len()).collect();
    order.sort_by_key(|place| {
        let device = &observer.devices.list[*place];
        (device.position.is_none(), device.position, *place)
    });
    order
}

/// What all parts of the document are made of.
pub(crate) struct Builder<'a> {
    pub files: &'a Files,
    pub observer: &'a Observer,
    /// Places of devices in the observer's list, by their place in the document.
    pub order: Vec<usize>,
}

impl Builder<'_> {
    /// The place of a device in the document.
    fn place(&self, place: usize) -> Option<usize> {
        self.order.iter().position(|known| *known == place)
    }

    fn at_ns(&self, at: Duration) -> u64 {
        let first = self.observer.first.unwrap_or_default();
        u64::try_from(at.saturating_sub(first).as_nanos()).unwrap_or(u64::MAX)
    }

    fn finding(&self, finding: &Finding, devices: &[DeviceReport]) -> FindingReport {
        let name = |place: usize| {
            let device = self.place(place).and_then(|place| devices.get(place));
            device.map_or(String::new(), DeviceReport::title)
        };
        let subject = finding.device.map_or("the segment".to_owned(), name);
        let mut evidence: Vec<FrameRef> =
            finding.frames.iter().map(|frame| self.files.place(*frame)).collect();
        evidence.sort_unstable();
        evidence.dedup();
        FindingReport {
            kind: finding.kind.name(),
            weight: match finding.kind.weight() {
                Weight::Fault => WeightKind::Fault,
                Weight::Warning => WeightKind::Warning,
                Weight::Note => WeightKind::Note,
            },
            sure: match finding.sure {
                Sure::Shown => SureKind::Shown,
                Sure::Likely => SureKind::Likely,
            },
            device: finding.device.and_then(|place| self.place(place)),
            what: words::what(&finding.kind, &subject, name),
            frame: self.files.place(finding.frame),
            at_ns: finding.at.map(|at| self.at_ns(at)),
            evidence,
            remedies: words::remedies(&finding.kind),
        }
    }

    fn frames(&self, pairs: Pairs) -> FramesReport {
        let sources = self.observer.talkers.list.iter().map(|talker| SourceReport {
            address: words::mac(talker.address),
            frames: talker.frames,
            first: self.files.place(talker.first),
        });
        FramesReport {
            pairs: pairs.pairs,
            unanswered: pairs.unanswered,
            answers_alone: pairs.answers_alone,
            duplicates: pairs.duplicates,
            elsewhere: pairs.elsewhere,
            broken: pairs.broken,
            foreign: pairs.foreign,
            span_ns: self.at_ns(self.observer.last),
            backwards: self.observer.backwards,
            sources: sources.collect(),
        }
    }

    fn reach(&self) -> Vec<ReachReport> {
        let reach = self.observer.reach.kept.iter();
        reach
            .map(|reach| ReachReport { subdevices: reach.to, frame: self.files.place(reach.frame) })
            .collect()
    }

    fn clock(&self) -> Option<ClockReport> {
        let drift = &self.observer.drift;
        let reference = drift.reference?.value;
        Some(ClockReport {
            command: drift.command?.name(),
            reference: judge::reference(self.observer).and_then(|place| self.place(place)),
            address: match reference {
                clock::Reference::Station(address) | clock::Reference::Position(address) => address,
            },
            frames: drift.count,
            first: self.files.place(drift.first?.frame),
            last: self.files.place(drift.last?.frame),
            bytes: drift.bytes,
            longest_gap_ns: drift
                .gap
                .filter(|_| self.observer.operation.is_some())
                .map(|gap| gap.value.as_nanos() as u64),
            changes: drift.changes,
        })
    }

    fn cycle(&self) -> Option<CycleReport> {
        let cycle = &self.observer.cycle;
        if cycle.logical.is_empty() {
            return None;
        }
        Some(CycleReport {
            operation: self.observer.operation.map(|known| self.files.place(known.frame)),
            by_stamps: self.rhythm(&cycle.rhythm),
            by_clock: self.rhythm(&cycle.by_clock),
            transmissions: cycle.logical.iter().map(|one| self.transmission(one)).collect(),
        })
    }

    fn rhythm(&self, rhythm: &cycle::Rhythm) -> Option<RhythmReport> {
        let (shortest, longest) = (rhythm.shortest()?, rhythm.longest.first()?);
        let shown = |value, frame| Shown { value, frame: self.files.place(frame) };
        Some(RhythmReport {
            count: rhythm.count,
            mean_ns: rhythm.mean()?,
            median_ns: rhythm.median()?,
            most_99_ns: rhythm.share(100)?,
            shortest_ns: shown(shortest.value, shortest.frame),
            longest_ns: shown(longest.ns, longest.frame),
        })
    }

    fn transmission(&self, logical: &cycle::Logical) -> TransmissionReport {
        let devices = self.observer.devices.list.iter();
        let computed: u16 = devices.map(|device| judge::cyclic::share(logical, device)).sum();
        let usual = logical.usual();
        let low = usual.map(|usual| logical.counts.range(..usual).map(|(_, times)| times).sum());
        TransmissionReport {
            command: logical.command.name(),
            address: logical.address,
            bytes: logical.len,
            frames: logical.frames,
            first: self.files.place(logical.first),
            usual_working_counter: usual,
            computed_working_counter: (computed > 0).then_some(computed),
            low: low.unwrap_or(0),
            lost: logical.lost.count,
        }
    }
}

fn tap_report(tap: Tap) -> TapReport {
    TapReport {
        seen: match tap.seen {
            TapSeen::Both => SeenKind::Both,
            TapSeen::Out => SeenKind::Out,
            TapSeen::Back => SeenKind::Back,
        },
        marked: tap.marked,
        behind: tap.behind,
        interface: tap.interface,
        ring: tap.ring.is_some(),
    }
}

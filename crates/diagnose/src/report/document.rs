//! The document: what a capture says, but for the parts of single devices.

use schemars::JsonSchema;
use serde::Serialize;

use super::device::DeviceReport;

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct DiagnoseReport {
    /// Name and number of this format.
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
    /// What happened around the first fault; null without a fault, or if nothing looked for it.
    pub around: Option<AroundReport>,
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
    /// The link type of the first of them, as the registry of LINKTYPE_ values numbers it.
    pub other_link: Option<u32>,
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
    /// Both ends of a ring were captured; what the MainDevice sends from its second port is left
    /// out.
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

/// What happened in the frames around the first fault.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct AroundReport {
    /// Place of the fault in `findings`.
    pub finding: usize,
    /// In the order of time; up to 6 before the one that shows the fault, and up to 6 behind it.
    pub moments: Vec<MomentReport>,
}

/// A frame that went out and came back, and those behind it that say the same.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct MomentReport {
    /// As it went out; null: that frame is not in the capture.
    pub request: Option<FrameRef>,
    /// As it came back; null: it did not.
    pub answer: Option<FrameRef>,
    /// The last frame of those that say the same.
    pub last: FrameRef,
    /// How many say the same, at least 1.
    pub times: u64,
    /// When the first of them was, ns by the stamps from the one that shows the fault.
    pub at_ns: i64,
    /// Commands, devices, registers and working counters.
    pub what: String,
    /// Kinds of the findings that name a frame of it.
    pub findings: Vec<&'static str>,
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
    /// The first frame that passed this number of SubDevices.
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

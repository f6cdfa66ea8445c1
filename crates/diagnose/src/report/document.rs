//! The document of a diagnosis, without the parts of single devices.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::device::DeviceReport;

/// The whole document.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DiagnoseReport {
    /// Name and number of this format.
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The conclusion.
    pub verdict: Verdict,
    /// The captures, in the order in which they were read.
    pub captures: Vec<CaptureReport>,
    /// The frames of all of them.
    pub frames: FramesReport,
    /// How the capture saw the segment; null without EtherCAT frames.
    pub tap: Option<TapReport>,
    /// What went wrong in the segment: faults first, each weight in the order of time.
    pub findings: Vec<FindingReport>,
    /// The devices, by position; devices without a known position come last.
    pub devices: Vec<DeviceReport>,
    /// How many SubDevices frames passed: the first number and each change, up to 256.
    pub reach: Vec<ReachReport>,
    /// The drift frames and the clock that they read; null if there are none.
    pub clock: Option<ClockReport>,
    /// The cyclic exchange; null if there is none.
    pub cycle: Option<CycleReport>,
    /// How far what was meant could be checked; null without a segment file.
    pub claims: Option<ClaimsReport>,
    /// What happened around the first fault; null if there is no fault, or it was not asked for.
    pub around: Option<AroundReport>,
    /// What the capture does not show.
    pub unknown: Vec<String>,
}

/// The conclusion of a diagnosis.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Verdict {
    /// The conclusion in one word.
    pub kind: VerdictKind,
    /// One sentence for people.
    pub sentence: String,
}

/// The conclusion of a diagnosis in one word.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum VerdictKind {
    /// In operation, frames came before their SYNC0, and no fault was found.
    InSync,
    /// In operation, no SubDevice has SYNC0, so that there was nothing to synchronize, and no fault
    /// was found.
    InOperation,
    /// No fault was found; the capture does not show whether the segment was in sync.
    NothingFound,
    /// At least one fault was found.
    Found,
}

/// One capture.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct CaptureReport {
    /// Its name, as the user gave it.
    pub name: String,
    /// Packets in it, of any protocol.
    pub packets: usize,
    /// Packets that the file cuts off within their EtherCAT part.
    pub cut: usize,
    /// Packets of links without Ethernet frames.
    pub other_links: usize,
    /// The link type of the first of them, by the registry of LINKTYPE_ values.
    pub other_link: Option<u32>,
    /// Why it was not read to its end; null: it was read to its end.
    pub ended: Option<String>,
}

/// The frames of all captures.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FramesReport {
    /// Requests with their answers.
    pub pairs: usize,
    /// Requests without an answer.
    pub unanswered: usize,
    /// Answers without a request.
    pub answers_alone: usize,
    /// Frames that were captured twice.
    pub duplicates: usize,
    /// Frames of interfaces other than the MainDevice's port.
    pub elsewhere: usize,
    /// Frames of EtherCAT whose datagrams are cut off or contradict themselves.
    pub broken: usize,
    /// Frames of other protocols.
    pub foreign: usize,
    /// From the first EtherCAT frame to the last, ns, by the stamps.
    pub span_ns: u64,
    /// Frames whose stamp is earlier than that of the one before.
    pub backwards: u64,
    /// Source addresses of the MainDevices, as they send; up to 16.
    pub sources: Vec<SourceReport>,
}

/// Frames of one source address.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SourceReport {
    /// The address, without the bit that the first SubDevice sets.
    pub address: String,
    /// Number of frames.
    pub frames: u64,
    /// The first frame.
    pub first: FrameRef,
}

/// How a capture saw the segment.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct TapReport {
    /// Which frames it saw.
    pub seen: SeenKind,
    /// Bit 1 of the source address distinguishes answers from requests; false: the datagrams do.
    pub marked: bool,
    /// SubDevices between the MainDevice and the tap.
    pub behind: u16,
    /// The interface of the file, from 0; null: all interfaces count.
    pub interface: Option<u32>,
    /// Both ends of a ring were captured; frames that the MainDevice sends from its second port are
    /// left out.
    pub ring: bool,
}

/// Which frames a capture saw.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SeenKind {
    /// Both directions.
    Both,
    /// Only frames on their way out.
    Out,
    /// Only frames on their way back.
    Back,
}

/// A frame of a capture, as Wireshark numbers it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FrameRef {
    /// Place of the capture in the list, from 0.
    pub capture: usize,
    /// Number of the frame in it, from 1.
    pub frame: usize,
}

/// A value, and the frame that shows it.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Shown<T> {
    /// The value.
    pub value: T,
    /// The frame; for several frames, the latest.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// One finding.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FindingReport {
    /// Its kind; docs/diagnose.md lists all kinds.
    pub kind: &'static str,
    /// Its weight.
    pub weight: WeightKind,
    /// Whether the frames prove it or only agree with it.
    pub sure: SureKind,
    /// Place of the device in `devices`; null: the finding is about the segment.
    pub device: Option<usize>,
    /// One sentence for people.
    pub what: String,
    /// The first frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// Time of that frame, ns from the first EtherCAT frame; null: not known.
    pub at_ns: Option<u64>,
    /// Further frames that belong to it.
    pub evidence: Vec<FrameRef>,
    /// What to do, likeliest first.
    pub remedies: Vec<String>,
}

/// What was held against the claims of a segment file.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ClaimsReport {
    /// Number of claims that were checked; those that do not hold are among the findings.
    pub checked: usize,
    /// Claims that could not be checked.
    pub not_checked: Vec<NotChecked>,
}

/// A claim that could not be checked.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct NotChecked {
    /// Position of the SubDevice; null: the claim is about the segment.
    pub position: Option<usize>,
    /// Name of the rule.
    pub rule: &'static str,
    /// What the capture does not show.
    pub needs: &'static str,
}

/// What happened in the frames around the first fault.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct AroundReport {
    /// Place of the fault in `findings`.
    pub finding: usize,
    /// The moments in the order of time; up to 6 before the one that shows the fault, and up to 6
    /// after it.
    pub moments: Vec<MomentReport>,
}

/// A frame that went out and came back, and the following frames that say the same.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct MomentReport {
    /// The frame on its way out; null: it is not in the capture.
    pub request: Option<FrameRef>,
    /// The frame on its way back; null: it did not come back.
    pub answer: Option<FrameRef>,
    /// The last frame of those that say the same.
    pub last: FrameRef,
    /// Number of frames that say the same, at least 1.
    pub times: u64,
    /// Time of the first frame, ns, by the stamps, from the frame that shows the fault.
    pub at_ns: i64,
    /// Commands, devices, registers and working counters.
    pub what: String,
    /// Kinds of the findings that name a frame of this moment.
    pub findings: Vec<&'static str>,
}

/// How much a finding weighs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum WeightKind {
    /// Something went wrong.
    Fault,
    /// Something was forgotten or done wrong, but did no harm yet.
    Warning,
    /// Worth knowing; it is not wrong.
    Note,
}

/// How sure a finding is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SureKind {
    /// The frames prove it.
    Shown,
    /// The frames agree with it, but another cause would show the same frames.
    Likely,
}

/// The number of SubDevices that frames passed from some frame on.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ReachReport {
    /// Number of SubDevices.
    pub subdevices: u16,
    /// The first frame that passed this number of SubDevices.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// The drift frames.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ClockReport {
    /// FRMW or ARMW.
    pub command: &'static str,
    /// Place of the reference in `devices`; null: it is not in `devices`.
    pub reference: Option<usize>,
    /// Its address: a station for FRMW, a position for ARMW.
    pub address: u16,
    /// Number of drift frames.
    pub frames: u64,
    /// The first drift frame.
    pub first: FrameRef,
    /// The last drift frame.
    pub last: FrameRef,
    /// Bytes of the time in them, 4 or 8.
    pub bytes: u16,
    /// The longest time without a drift frame in operation, ns: by the stamps or by the reference
    /// clock, whichever is shorter; null: not known.
    pub longest_gap_ns: Option<u64>,
    /// How often the reference changed.
    pub changes: u64,
}

/// The cyclic exchange.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct CycleReport {
    /// The frame from which on the segment is in operation; null: no state of operation was seen.
    pub operation: Option<FrameRef>,
    /// From one cycle to the next, by the stamps of the capture.
    pub by_stamps: Option<RhythmReport>,
    /// From one cycle to the next, by the reference clock, to its 10 ns; the stamps do not affect
    /// it.
    pub by_clock: Option<RhythmReport>,
    /// From a frame to its answer, by the stamps of the capture: what the segment takes, and what
    /// the machine takes on which they were made. Null: the capture does not have both directions.
    pub round_trip: Option<RhythmReport>,
    /// What frame, cables and devices take of it at most, computed, ns. The rest is the machine's.
    /// Null: not known how many devices frames pass.
    pub on_wire_ns: Option<u64>,
    /// The logical datagrams.
    pub transmissions: Vec<TransmissionReport>,
}

/// From one cycle to the next, ns.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct RhythmReport {
    /// Number of intervals.
    pub count: u64,
    /// The mean interval.
    pub mean_ns: u64,
    /// The length that half of the intervals do not exceed, to three digits.
    pub median_ns: u64,
    /// The length that 99 % of the intervals do not exceed, to three digits.
    pub most_99_ns: u64,
    /// The shortest interval.
    pub shortest_ns: Shown<u64>,
    /// The longest interval.
    pub longest_ns: Shown<u64>,
}

/// A logical datagram.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct TransmissionReport {
    /// LRD, LWR or LRW.
    pub command: &'static str,
    /// First logical address.
    pub address: u32,
    /// Number of bytes.
    pub bytes: u16,
    /// Frames with it, in the whole capture.
    pub frames: u64,
    /// The first of them.
    pub first: FrameRef,
    /// The working counter that is usual in operation: the highest one that came back at least 8
    /// times, else the most frequent one; null: no frame came back.
    pub usual_working_counter: Option<u16>,
    /// The working counter by the FMMUs that the capture shows; null: none of them maps the
    /// datagram.
    pub computed_working_counter: Option<u16>,
    /// Frames in operation that came back with less than the usual working counter.
    pub low: u64,
    /// Frames in operation without an answer.
    pub lost: u64,
}

//! The same judge on frames that are seen as they come.
//!
//! [`Live::frame`] takes each frame; [`Live::news`], called a few times a second, gives the faults
//! that were not there before. A listener may run for weeks: [`Live::forget`] makes room for what
//! comes, and keeps what is known of the devices and their set-up. A fault that was told before is
//! told again if it happens again behind that.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use isocat_captures::pairing::{Seen, is_marked};
use isocat_captures::reading::Frame;

use crate::finding::{Finding, Kind, Weight};
use crate::report::{self, FindingReport};
use crate::{DiagnoseReport, Diagnosis, Names, Nothing, judge};

/// A diagnosis that goes on.
#[derive(Debug)]
pub struct Live {
    diagnosis: Diagnosis,
    /// When the first frame came.
    first: Option<Duration>,
    now: Duration,
    /// Faults of frames up to this one were told.
    since: usize,
    /// Faults that were told since then, and at which device.
    told: BTreeSet<Key>,
    /// When a fault that lasts was told last.
    lasting: BTreeMap<Key, Duration>,
    /// The counters of 0x1C32 and 0x1C33 as they were told.
    counted: BTreeMap<(Option<usize>, u32), u64>,
}

/// Kind and device.
type Key = (&'static str, Option<usize>);

/// What a fault is seen by.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Symptom {
    /// A working counter is below what is usual.
    WorkingCounter,
    /// A device left a state, refused one, or does not answer.
    State,
    /// Clocks, SYNC units, the rhythm of frames or their distance to SYNC0.
    Sync,
    /// Frames that were lost, damaged, doubled, or of another MainDevice.
    Frames,
}

/// A fault that was not there before.
#[derive(Clone, PartialEq, Debug)]
pub struct News {
    /// What it is seen by.
    pub symptom: Symptom,
    /// Number of the frame that shows it.
    pub frame: usize,
    /// The fault, in words too.
    pub finding: FindingReport,
}

impl Live {
    /// Nothing was seen yet. `name` is what the listener is told with in a report.
    pub fn new(name: &str) -> Self {
        let mut diagnosis = Diagnosis::new();
        diagnosis.files.begin(name);
        Self {
            diagnosis,
            first: None,
            now: Duration::ZERO,
            since: 0,
            told: BTreeSet::new(),
            lasting: BTreeMap::new(),
            counted: BTreeMap::new(),
        }
    }

    /// Takes a frame. Numbers begin at 1 and grow.
    pub fn frame(&mut self, frame: Frame) {
        self.first.get_or_insert(frame.at);
        self.now = self.now.max(frame.at);
        if self.hears_first_answer(&frame) {
            let files = std::mem::take(&mut self.diagnosis.files);
            self.diagnosis = Diagnosis { files, ..Diagnosis::new() };
        }
        self.diagnosis.take(frame);
    }

    /// Faults that were not told yet, in the order of the frames that show them.
    pub fn news(&mut self, names: &Names) -> Vec<News> {
        let settled = self.first.is_some_and(|first| self.now >= first + SETTLE);
        if settled && self.diagnosis.pairing.decide_early() {
            self.diagnosis.observe(&mut |_| {});
        }
        let Some(tap) = self.diagnosis.pairing.tap() else { return Vec::new() };
        let observer = &self.diagnosis.observer;
        let mut findings = judge::findings(observer, tap);
        findings.retain(|finding| {
            let later = finding.frame > self.since && is_fault(finding);
            later && !self.told.contains(&key(finding)) && self.is_news(finding)
        });
        self.told.extend(findings.iter().map(key));
        if findings.is_empty() {
            return Vec::new();
        }
        findings.sort_by_key(|finding| finding.frame);
        let observer = &self.diagnosis.observer;
        let name = |position, vendor, product| names.of(position, vendor, product);
        let told = report::told(&self.diagnosis.files, observer, &findings, &name);
        let news = findings.iter().zip(told).map(|(from, finding)| News {
            symptom: symptom(&from.kind),
            frame: from.frame,
            finding,
        });
        news.collect()
    }

    /// Which directions the listener sees; `None`: that is not known yet.
    pub fn seen(&self) -> Option<Seen> {
        self.diagnosis.pairing.tap().map(|tap| tap.seen)
    }

    /// What happened so far is told no more. What lasts is told again after [`AGAIN`] at the
    /// earliest.
    pub fn forget(&mut self) {
        self.diagnosis.observer.forget();
        self.told.clear();
        self.since = self.diagnosis.observer.frame;
        let now = self.now;
        self.lasting.retain(|_, at| *at + AGAIN > now);
    }

    /// Says what was found since the last [`forget`](Self::forget). `Err`: no frame of EtherCAT
    /// came.
    pub fn report(self, names: &Names) -> Result<DiagnoseReport, Nothing> {
        self.diagnosis.report(names)
    }

    /// Whether a frame is the first answer of devices, where the tap was taken for one that sees
    /// requests alone: devices were switched on since. What requests alone say is worth nothing
    /// then.
    fn hears_first_answer(&self, frame: &Frame) -> bool {
        let tap = self.diagnosis.pairing.tap();
        tap.is_some_and(|tap| tap.seen == Seen::Out && tap.marked) && is_marked(&frame.bytes)
    }

    /// Whether a fault is one that happened now, or lasts for so long that it is told again.
    fn is_news(&mut self, finding: &Finding) -> bool {
        if let Kind::SyncCounted { object, count } = &finding.kind {
            let object = u32::from(object.index) << 8 | u32::from(object.sub);
            let before = self.counted.insert((finding.device, object), *count);
            return before.is_none_or(|before| *count > before);
        }
        if symptom(&finding.kind) != Symptom::Sync {
            return true;
        }
        let (now, key) = (self.now, key(finding));
        let again = self.lasting.get(&key).is_none_or(|last| now >= *last + AGAIN);
        if again {
            self.lasting.insert(key, now);
        }
        again
    }
}

fn key(finding: &Finding) -> Key {
    (finding.kind.name(), finding.device)
}

fn is_fault(finding: &Finding) -> bool {
    finding.kind.weight() == Weight::Fault
}

fn symptom(kind: &Kind) -> Symptom {
    match kind {
        Kind::WorkingCounter { .. } => Symptom::WorkingCounter,
        Kind::LeftOp { .. }
        | Kind::AlError { .. }
        | Kind::DevicesVanished { .. }
        | Kind::DeviceSilent {} => Symptom::State,
        Kind::FramesLost { .. }
        | Kind::FramesDoubled { .. }
        | Kind::ErrorsCounted { .. }
        | Kind::AnotherTalker { .. } => Symptom::Frames,
        _ => Symptom::Sync,
    }
}

/// From the first frame on this long frames are gathered, before it is judged which directions the
/// tap sees.
const SETTLE: Duration = Duration::from_secs(1);
/// What is wrong with SYNC or with the rhythm often lasts: from one time that it is told to the
/// next.
pub const AGAIN: Duration = Duration::from_secs(60);

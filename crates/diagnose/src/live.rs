//! Diagnoses frames as they arrive.
//!
//! [`Live::frame`] takes each frame; [`Live::news`], called a few times a second, returns the new
//! faults. A listener may run for weeks: [`Live::forget`] drops past events to bound memory, and
//! keeps what is known of the devices and their set-up. A fault that was reported before is
//! reported again if it happens again after that.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use isocat_captures::pairing::{Seen, is_marked};
use isocat_captures::reading::Frame;
use isocat_rules::{Breach, Claims};

use crate::finding::{Finding, Kind, Weight};
use crate::judge::claims;
use crate::report::{self, FindingReport};
use crate::{DiagnoseReport, Diagnosis, Names, Nothing, judge};

/// A diagnosis that runs while frames arrive.
#[derive(Debug)]
pub struct Live {
    diagnosis: Diagnosis,
    /// When the first frame came.
    first: Option<Duration>,
    now: Duration,
    /// Faults shown by frames up to this number were reported.
    since: usize,
    /// Kinds and devices of the faults reported since then.
    told: BTreeSet<Key>,
    /// When each lasting fault was last reported.
    lasting: BTreeMap<Key, Duration>,
    /// The counters of 0x1C32 and 0x1C33 as they were last reported.
    counted: BTreeMap<(Option<usize>, u32), u64>,
}

/// Kind and device.
type Key = (&'static str, Option<usize>);

/// What kind of symptom shows a fault.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Symptom {
    /// A working counter is below what is usual.
    WorkingCounter,
    /// A device left a state, refused one, or does not answer.
    State,
    /// Clocks, SYNC units, the rhythm of frames or their distance to SYNC0.
    Sync,
    /// Frames that were lost, damaged, doubled, or came from another MainDevice.
    Frames,
}

/// A new fault.
#[derive(Clone, PartialEq, Debug)]
pub struct News {
    /// Its kind of symptom.
    pub symptom: Symptom,
    /// Number of the frame that shows it.
    pub frame: usize,
    /// The fault, also in words.
    pub finding: FindingReport,
}

impl Live {
    /// A diagnosis that has seen nothing yet. `name`: how a report names the listener.
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

    /// Also holds what it hears against what the segment was meant to do.
    pub fn against(mut self, claims: Option<Claims>) -> Self {
        self.diagnosis = self.diagnosis.against(claims);
        self
    }

    /// Takes a frame. Frame numbers begin at 1 and grow.
    pub fn frame(&mut self, frame: Frame) {
        self.first.get_or_insert(frame.at);
        self.now = self.now.max(frame.at);
        if self.hears_first_answer(&frame) {
            let files = std::mem::take(&mut self.diagnosis.files);
            let claims = self.diagnosis.observer.claims.take();
            self.diagnosis = Diagnosis { files, ..Diagnosis::new().against(claims) };
        }
        self.diagnosis.take(frame);
    }

    /// Faults that were not reported yet, in the order of the frames that show them.
    pub fn news(&mut self, names: &Names) -> Vec<News> {
        let settled = self.first.is_some_and(|first| self.now >= first + SETTLE);
        if settled && self.diagnosis.pairing.decide_early() {
            self.diagnosis.observe(&mut |_| {});
        }
        let Some(tap) = self.diagnosis.pairing.tap() else { return Vec::new() };
        let observer = &self.diagnosis.observer;
        let rulings = claims::rulings(observer);
        let mut findings = judge::findings(observer, tap, &rulings);
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
        let told = report::told(&self.diagnosis.files, observer, &findings, names);
        let news = findings.iter().zip(told).map(|(from, finding)| News {
            symptom: symptom(&from.kind),
            frame: from.frame,
            finding,
        });
        news.collect()
    }

    /// Which directions the listener sees; `None`: not known yet.
    pub fn seen(&self) -> Option<Seen> {
        self.diagnosis.pairing.tap().map(|tap| tap.seen)
    }

    /// Forgets the events so far. A fault that lasts is reported again after [`AGAIN`] at the
    /// earliest.
    pub fn forget(&mut self) {
        self.diagnosis.observer.forget();
        self.told.clear();
        self.since = self.diagnosis.observer.frame;
        let now = self.now;
        self.lasting.retain(|_, at| *at + AGAIN > now);
    }

    /// Reports what was found since the last [`forget`](Self::forget). `Err`: no EtherCAT frame
    /// came.
    pub fn report(self, names: &Names) -> Result<DiagnoseReport, Nothing> {
        self.diagnosis.report(names)
    }

    /// Whether a frame is the first answer of devices after the tap was taken for one that sees
    /// requests alone. Devices were then switched on since, and what was concluded from requests
    /// alone is void.
    fn hears_first_answer(&self, frame: &Frame) -> bool {
        let tap = self.diagnosis.pairing.tap();
        tap.is_some_and(|tap| tap.seen == Seen::Out && tap.marked) && is_marked(&frame.bytes)
    }

    /// Whether a fault happened now, or has lasted for so long that it is reported again.
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
        | Kind::StayedBelow { .. }
        | Kind::OpWithoutData { .. }
        | Kind::DeviceSilent {}
        | Kind::Breached(Breach::NotOperated { .. }) => Symptom::State,
        Kind::FramesLost { .. }
        | Kind::SilentToTheEnd { .. }
        | Kind::NothingCameBack { .. }
        | Kind::AnswersLate { .. }
        | Kind::FramesDoubled { .. }
        | Kind::ErrorsCounted { .. }
        | Kind::AnotherTalker { .. }
        | Kind::Breached(Breach::NotCarried { .. } | Breach::SeveralTalkers { .. }) => {
            Symptom::Frames
        }
        _ => Symptom::Sync,
    }
}

/// Time after the first frame in which frames are gathered, before the diagnosis decides which
/// directions the tap sees.
const SETTLE: Duration = Duration::from_secs(1);
/// Time between two reports of the same lasting fault: faults of SYNC or of the rhythm often last.
pub const AGAIN: Duration = Duration::from_secs(60);

//! What a diagnosis says, for programs and for people.

use std::time::Duration;

use isocat_captures::pairing::{Seen as TapSeen, Tally as Pairs, Tap};
use isocat_wire::AlState;

use crate::access::shows_answers;
use crate::files::Files;
use crate::finding::{Finding, Sure, Weight};
use crate::judge::claims::Held;
use crate::observer::Observer;
use crate::state::Asked;
use crate::{Names, clock, cycle, judge, words};

mod comments;
mod device;
mod document;
mod text;
mod unknown;

pub use device::*;
pub use document::*;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-diagnose/2";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<DiagnoseReport>(FORMAT)
}

/// Makes the document.
pub(crate) fn report(
    files: &Files,
    observer: &Observer,
    pairs: Pairs,
    tap: Option<Tap>,
    names: &Names,
) -> DiagnoseReport {
    let order = order(observer);
    let rulings = judge::claims::rulings(observer);
    let findings = tap.map_or(Vec::new(), |tap| judge::findings(observer, tap, &rulings));
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
        claims: observer.claims.as_ref().map(|_| claims_report(&rulings)),
        around: None,
        unknown: Vec::new(),
    };
    report.unknown = unknown::unknown(&report, tap.is_some_and(shows_answers));
    report.unknown.extend(left_out(observer));
    let both_ways = observer.devices.list.iter().any(crate::evidence::goes_both_ways);
    if both_ways {
        let what =
            "which inputs devices gave: an FMMU reads and writes, so outputs may lie over them";
        report.unknown.insert(0, what.to_owned());
    }
    let in_order = || builder.order.iter().map(|place| &observer.devices.list[*place]);
    let doubts = Doubts {
        unseen: in_order().map(|device| device.states.op.is_none()).collect(),
        pulsing: in_order().map(|device| device.sync.operates()).collect(),
        lacking: lacking(&rulings, names, observer),
        unled: crate::evidence::unled(observer)
            .and_then(|unled| builder.order.iter().position(|place| *place == unled)),
        is_open: tap.is_some_and(|tap| tap.seen == TapSeen::Back) && observer.is_operating(),
        has_no_sync: tap.is_some_and(|tap| tap.seen == TapSeen::Both)
            && crate::evidence::operates_without_sync(observer),
    };
    if doubts.has_no_sync {
        report.unknown.retain(|what| what != unknown::SYNC);
    }
    report.verdict = report.judge(doubts);
    report
}

/// What keeps a capture without a fault from showing that devices were in sync.
struct Doubts {
    /// By device, whether it was never read in OP.
    unseen: Vec<bool>,
    /// By device, whether it had SYNC0 in operation.
    pulsing: Vec<bool>,
    /// What is not known though it was claimed.
    lacking: Option<String>,
    /// The first device whose clock is not known to have come to the reference.
    unled: Option<usize>,
    /// The capture has answers alone and ends in operation, so it is not known what came behind the
    /// last answer.
    is_open: bool,
    /// All devices came up in the capture, without SYNC0, and operated. What they did after that is
    /// a finding.
    has_no_sync: bool,
}

/// What is missing to say that the segment is in sync as it was meant: the evidence for the first
/// unchecked claim about the state, the mode or the SYNC0 of a SubDevice.
fn lacking(rulings: &[Held], names: &Names, observer: &Observer) -> Option<String> {
    let decides = ["operates", "mode", "sync0-cycle", "in-phase"];
    let mut unchecked = rulings.iter().flat_map(|held| &held.ruling.unchecked);
    let unchecked = unchecked.find(|one| decides.contains(&one.rule))?;
    let name = unchecked.device.and_then(|at| names.positions.get(at));
    let place = unchecked.device.and_then(|at| observer.devices.at(u16::try_from(at).ok()?));
    let states = place.map(|place| &observer.devices.list[place].states);
    let below =
        states.and_then(|states| states.last_seen()).filter(|_| unchecked.rule == "operates");
    Some(match (name, below) {
        (Some(name), Some((status, _))) => {
            let op = |asked: &Asked| asked.control.state() == Ok(AlState::Op);
            let requests = states.map(|states| &states.requests.kept).into_iter().flatten();
            let asked = match requests.into_iter().any(op) {
                true => "",
                false => ", and nothing asked it for OP",
            };
            format!("{name} in OP: it was in {status} at last{asked}")
        }
        (Some(name), None) => format!("{} of {name}", unchecked.needs),
        (None, _) => unchecked.needs.to_owned(),
    })
}

fn claims_report(rulings: &[Held]) -> ClaimsReport {
    let mut report = ClaimsReport { checked: 0, not_checked: Vec::new() };
    for Held { ruling, .. } in rulings {
        report.checked += ruling.checked;
        let not_checked = ruling.unchecked.iter().map(|one| NotChecked {
            position: one.device,
            rule: one.rule,
            needs: one.needs,
        });
        report.not_checked.extend(not_checked);
    }
    report
}

/// Turns findings into their report.
pub(crate) fn told(
    files: &Files,
    observer: &Observer,
    findings: &[Finding],
    names: &Names,
) -> Vec<FindingReport> {
    let builder = Builder { files, observer, order: order(observer) };
    let places = builder.order.iter();
    let devices: Vec<DeviceReport> =
        places.map(|place| device::report(&builder, *place, names)).collect();
    findings.iter().map(|finding| builder.finding(finding, &devices)).collect()
}

/// Sentences about what was not kept because memory is bounded.
fn left_out(observer: &Observer) -> impl Iterator<Item = String> {
    let all = [
        (observer.devices.left_out, "accesses to further devices"),
        (observer.cycle.left_out, "frames with further logical datagrams"),
        (observer.talkers.others, "frames of further source addresses"),
    ];
    let all = all.into_iter().filter(|(count, _)| *count > 0);
    all.map(|(count, what)| format!("what is in {count} {what}: more than are kept apart"))
}

impl DiagnoseReport {
    /// Whether a fault was found.
    pub fn found(&self) -> bool {
        self.verdict.kind == VerdictKind::Found
    }

    fn judge(&self, doubts: Doubts) -> Verdict {
        let faults: Vec<&FindingReport> =
            self.findings.iter().filter(|one| one.weight == WeightKind::Fault).collect();
        let measured: Vec<&Distance> =
            self.devices.iter().filter_map(|device| device.distance.as_ref()).collect();
        // Without its state, frames at the right time prove nothing.
        let with = |doubts: &[bool], measured: bool| {
            let mut all = self.devices.iter().zip(doubts);
            let wanted = |device: &DeviceReport| device.distance.is_some() == measured;
            all.find(|(device, doubt)| wanted(device) && **doubt).map(|(device, _)| device)
        };
        let below = with(&doubts.unseen, true);
        let unmeasured = with(&doubts.pulsing, false);
        let frames = measured.iter().map(|distance| distance.frames).max().unwrap_or(0);
        let (kind, sentence) = match (faults.first(), frames, below) {
            (Some(first), ..) => {
                let more = match faults.len() - 1 {
                    0 => String::new(),
                    1 => "; one more fault was found".to_owned(),
                    more => format!("; {more} more faults were found"),
                };
                let sentence =
                    format!("First at {}: {}{more}.", self.frame(first.frame), first.what);
                (VerdictKind::Found, sentence)
            }
            (None, 1.., Some(device)) => {
                let sentence = format!(
                    "No fault was found; whether devices were in sync is not known: {} was not read in OP.",
                    device.title()
                );
                (VerdictKind::NothingFound, sentence)
            }
            (None, _, None) if doubts.lacking.is_some() => {
                let sentence = format!(
                    "No fault was found; whether devices were in sync as they are meant to is not known: the capture does not show {}.",
                    doubts.lacking.unwrap_or_default()
                );
                (VerdictKind::NothingFound, sentence)
            }
            (None, 1.., None) if doubts.unled.is_some() => {
                let unled = doubts.unled.map(|at| self.devices[at].title()).unwrap_or_default();
                let sentence = format!(
                    "No fault was found; whether devices were in sync is not known: the capture does not show that the clock of {unled} had come to the reference (0x092C) before it operated.",
                );
                (VerdictKind::NothingFound, sentence)
            }
            (None, 1.., None) if unmeasured.is_some() => {
                let title = unmeasured.map(DeviceReport::title).unwrap_or_default();
                let sentence = format!(
                    "No fault was found; whether all devices were in sync is not known: the capture does not show where frames lie against SYNC0 of {title}.",
                );
                (VerdictKind::NothingFound, sentence)
            }
            (None, 1.., None) if doubts.is_open => {
                let sentence = "No fault was found; whether devices stayed in sync is not known: the capture has answers alone and ends in operation, as it would if nothing answered any more.";
                (VerdictKind::NothingFound, sentence.to_owned())
            }
            (None, 1.., None) => {
                let least = measured.iter().map(|distance| distance.shortest_ns.value).min();
                let sentence = format!(
                    "In sync as far as the capture shows it: {frames} cyclic frames came before their SYNC0 at {} devices, {} before it at least.",
                    measured.len(),
                    words::ns(least.unwrap_or(0).max(0) as u64)
                );
                (VerdictKind::InSync, sentence)
            }
            (None, 0, _) if doubts.has_no_sync => {
                let rhythm = self.cycle.as_ref().and_then(|cycle| cycle.by_stamps.as_ref());
                let cycles = rhythm.map_or(0, |rhythm| rhythm.count);
                let sentence = format!(
                    "In operation as far as the capture shows it: all {} SubDevices were in OP, none has SYNC0, so there was nothing to synchronize; {cycles} cycles.",
                    self.devices.len()
                );
                (VerdictKind::InOperation, sentence)
            }
            (None, 0, _) => {
                // In the order in which the others follow from it.
                let why = self.unknown.iter().find(|what| *what != unknown::CABLES);
                let why = why.map_or(String::new(), |what| {
                    format!(": the capture does not show {}", what.trim_end_matches('.'))
                });
                let sentence =
                    format!("No fault was found; whether devices were in sync is not known{why}.");
                (VerdictKind::NothingFound, sentence.to_owned())
            }
        };
        Verdict { kind, sentence }
    }

    /// `frame 17`; with several captures `frame 17 of b.pcapng`.
    pub fn frame(&self, at: FrameRef) -> String {
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

/// What all parts of the document are built from.
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
            round_trip: self.rhythm(&cycle.round_trip),
            on_wire_ns: Some(cycle.on_wire_ns).filter(|ns| *ns > 0),
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

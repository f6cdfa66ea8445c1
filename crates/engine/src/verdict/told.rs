//! Keeps the MainDevice's reports while the segment is in operation.

use std::collections::BTreeMap;

use isocat_maindevice::quality::{Alarm, Change};
use isocat_maindevice::{Event, SegmentChange};
use isocat_sim::{Finding, Judged, Place};
use isocat_sync::delay::Delay;
use isocat_sync::phase;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatus, AlStatusCode};

use super::{Gap, Readings, Verdict, Witness};

/// The events that matter for the verdict.
pub(super) struct Told {
    optional: Vec<bool>,
    /// By position: the first state that was not OP, and the last one.
    left: BTreeMap<usize, Left>,
    /// The first change of the number of SubDevices that answer: expected, found, time.
    count: Option<(u16, u16, Nanos)>,
    changes: Vec<Finding>,
    visits: Vec<Finding>,
    /// Number of frames that did not come back, and the time of the first one.
    lost: (u64, Option<Nanos>),
    /// Time since working counters were wrong, and the chunks concerned.
    wrong: Option<Nanos>,
    chunks: Vec<usize>,
    pub skipped: u64,
    skipped_since: Option<Nanos>,
    pub stall: Option<(Nanos, Nanos)>,
    pub locks_lost: u64,
    unled: u64,
    dropped: u64,
}

#[derive(Clone, Copy)]
struct Left {
    first: (AlStatus, AlStatusCode, Nanos),
    last: AlStatus,
}

impl Told {
    pub fn new(optional: Vec<bool>) -> Self {
        Self {
            optional,
            left: BTreeMap::new(),
            count: None,
            changes: Vec::new(),
            visits: Vec::new(),
            lost: (0, None),
            wrong: None,
            chunks: Vec::new(),
            skipped: 0,
            skipped_since: None,
            stall: None,
            locks_lost: 0,
            unled: 0,
            dropped: 0,
        }
    }

    fn is_optional(&self, position: usize) -> bool {
        self.optional.get(position).copied().unwrap_or(false)
    }

    /// Takes an event; `limit` is the largest error of a clock.
    pub fn event(&mut self, at: Nanos, event: &Event, limit: Nanos) {
        if let Some((device, change)) = SegmentChange::of(event) {
            let visit = change.is_move() && device.is_some_and(|at| self.is_optional(at));
            let place = Place { device, stage: None };
            let list = if visit { &mut self.visits } else { &mut self.changes };
            if list.len() < MOST_CHANGES {
                list.push(Finding { place, since: Some(at), kind: change.into() });
            }
        }
        match event {
            Event::StateChanged { position, status, code, .. } => {
                let is_op = *status == AlStatus::new(AlState::Op);
                match self.left.get_mut(position) {
                    Some(left) => left.last = *status,
                    None if is_op => {}
                    None => {
                        let first = (*status, *code, at);
                        self.left.insert(*position, Left { first, last: *status });
                    }
                }
            }
            Event::CountChanged { expected, found, .. } if found != expected => {
                self.count.get_or_insert((*expected, *found, at));
            }
            Event::FrameLost { .. } => {
                self.lost.0 += 1;
                self.lost.1.get_or_insert(at);
            }
            Event::WorkingCounter { chunk, .. } => {
                self.wrong.get_or_insert(at);
                if !self.chunks.contains(chunk) {
                    self.chunks.push(*chunk);
                }
            }
            Event::CyclesSkipped { late, skipped, .. } => {
                self.skipped += skipped;
                self.skipped_since.get_or_insert(at);
                if self.stall.is_none_or(|(longest, _)| *late > longest) {
                    self.stall = Some((*late, at));
                }
            }
            Event::Phase { state, .. } if *state != phase::State::Locked => self.locks_lost += 1,
            Event::ClocksUnled { cycles } => self.unled = self.unled.max(*cycles),
            Event::DelayChanged {
                position,
                written,
                found: Delay::Known { delay: found, .. },
                ..
            } if (Picos::from(*written) - *found).0.abs() > Picos::from(limit).0 => {
                let (written, found) = (*written, *found);
                let kind = Judged::DelayChanged { written, found }.into();
                if self.changes.len() < MOST_CHANGES {
                    let place = Place::device(*position);
                    self.changes.push(Finding { place, since: Some(at), kind });
                }
            }
            Event::Alarm(Change { position, alarm: Alarm::SyncPending, raised: true, .. })
                if self.changes.len() < MOST_CHANGES =>
            {
                let place = Place::device(*position);
                let kind = Judged::NoSync0.into();
                self.changes.push(Finding { place, since: Some(at), kind });
            }
            Event::Dropped { count } => self.dropped += count,
            _ => {}
        }
    }

    /// Adds the results. `readings` are those of the SubDevices at the end, `errors` counts
    /// datagrams with a wrong working counter, `late` the frames of cycles that came after
    /// they were given up.
    pub fn end(
        self,
        main: &impl Witness,
        readings: &[Readings],
        (errors, late): (u64, u64),
        verdict: &mut Verdict,
    ) {
        for device in &main.segment().devices {
            let position = device.position;
            let optional = self.is_optional(position);
            let left = self.left.get(&position);
            // A SubDevice that may be absent is sometimes on its way up or down.
            let left = left.filter(|left| {
                !optional || device.admitted && left.last != AlStatus::new(AlState::Op)
            });
            let place = Place::device(position);
            if let Some(Left { first: (state, code, since), .. }) = left {
                let (state, code) = (*state, *code);
                verdict.add(place, Some(*since), Judged::LeftOp { state, code });
                continue;
            }
            let absent = optional && !device.admitted;
            match readings.get(position).map(|readings| readings.status) {
                Some(Some((status, _))) if status == AlStatus::new(AlState::Op) => {}
                _ if absent => {}
                Some(Some((state, code))) => {
                    verdict.add(place, None, Judged::NotInOp { state, code });
                }
                Some(None) => verdict.add(place, None, Judged::NoAnswer),
                // They were not asked, since no frame comes back.
                None => {}
            }
        }
        if let Some((expected, found, since)) = self.count.filter(|_| !self.may_change(main)) {
            let kind = Judged::CountChanged { expected, found };
            verdict.add(Place::SEGMENT, Some(since), kind);
        }
        let (missed, since) = self.lost;
        let late = late.min(missed);
        if missed > late {
            verdict.add(Place::SEGMENT, since, Judged::FramesLost { frames: missed - late });
        }
        if late > 0 {
            verdict.add(Place::SEGMENT, since, Judged::AnswersLate { frames: late });
        }
        if errors > 0 {
            let kind = Judged::WorkingCounter { datagrams: errors };
            verdict.add(self.only_device(main), self.wrong, kind);
        }
        if self.skipped > 0 {
            let kind = Judged::CyclesSkipped { cycles: self.skipped };
            verdict.add(Place::SEGMENT, self.skipped_since, kind);
        }
        if self.unled > 0 && main.segment().devices.iter().any(|device| device.mode.uses_dc()) {
            verdict.doubt(Place::SEGMENT, Gap::ClocksNotLed { cycles: self.unled });
        }
        if self.dropped > 0 {
            verdict.doubt(Place::SEGMENT, Gap::EventsDropped { count: self.dropped });
        }
        verdict.findings.extend(self.changes);
        verdict.visits = self.visits;
    }

    /// Whether the number of SubDevices that answer may change, because some may be absent.
    fn may_change(&self, main: &impl Witness) -> bool {
        (0..main.segment().devices.len()).any(|position| self.is_optional(position))
    }

    /// The SubDevice whose working counter was wrong, if only its process data were concerned.
    fn only_device(&self, main: &impl Witness) -> Place {
        let segment = main.segment();
        let [chunk] = self.chunks[..] else { return Place::SEGMENT };
        let Some(chunk) = segment.image.chunks.get(chunk) else { return Place::SEGMENT };
        let mapped = segment.devices.iter().filter(|device| {
            chunk.holds(device) && (device.outputs.length > 0 || device.inputs.length > 0)
        });
        match mapped.map(|device| device.position).collect::<Vec<_>>()[..] {
            [position] => Place::device(position),
            _ => Place::SEGMENT,
        }
    }
}

/// Largest number of changes that are kept: memory is bounded however long a segment runs.
const MOST_CHANGES: usize = 1_000;

//! SubDevices that are lost and re-admitted while the segment runs.

use alloc::boxed::Box;
use alloc::vec::Vec;

use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::time::Nanos;

use super::MainDevice;
use super::background::{Ends, Kind};
use super::procedures::{About, Ended};
use super::way::Activity;
use crate::board::Wish;
use crate::clock;
use crate::delay_watch::DelayWatch;
use crate::error::Cause;
use crate::event::Event;
use crate::health::Found;
use crate::readmit::{self, Return};

/// SubDevices that are lost and re-admitted.
impl MainDevice {
    /// Takes a SubDevice out of the exchange.
    pub(super) fn lose(&mut self, position: usize) {
        let number = self.link.board(|board| board.cycle);
        let device = &mut self.segment.devices[position];
        device.admitted = false;
        (device.al_status, device.al_code) = (AlStatus(0), AlStatusCode::NO_ERROR);
        self.states_changed();
        self.link.report(Event::Lost { position, cycle: number });
        if let Some(cycle) = &mut self.cycle {
            cycle.set_present(position, false);
        }
        self.procedures.end_at(Kind::Recover, position);
        self.close_mailbox(position);
        self.keeper.is_lost(position);
        self.end_background(Ends::Way);
        if self.segment.reference == Some(position) {
            self.link.report(Event::ReferenceLost { position, cycle: number });
        }
    }

    /// If the reference clock is lost, the first remaining clock becomes the reference: the drift
    /// datagram reaches only the clocks behind it.
    pub(super) fn elect(&mut self) {
        let gone = |at: usize| self.segment.devices.get(at).is_some_and(|device| !device.admitted);
        if !self.segment.reference.is_some_and(gone) {
            return;
        }
        let candidate = |device: &&crate::SubDevice| device.admitted && device.dc.has_clock();
        let elected = self.segment.devices.iter().find(candidate).map(|device| device.position);
        if let Some(elected) = elected {
            self.lead(elected);
        }
    }

    /// Makes another clock the reference.
    pub(super) fn lead(&mut self, position: usize) {
        self.segment.reference = Some(position);
        let number = self.link.board(|board| board.cycle);
        if let Some(cycle) = &mut self.cycle {
            cycle.set_reference(&self.segment.devices[position]);
            cycle.hold_clocks(false);
        }
        self.link.report(Event::ReferenceElected { position, cycle: number });
    }

    /// Starts to re-admit SubDevices that are in their places, if more answer than take part.
    pub(super) fn welcome(&mut self, everybody: Vec<Found>) {
        if self.procedures.has(Kind::Readmit) {
            return;
        }
        let (now, cycle) = self.link.with(|shared| (shared.port.now, shared.board.cycle));
        let found = everybody.len() as u16;
        let is_out = |position| self.keeper.is_out(position);
        let Ok(places) = readmit::places(&self.segment, &everybody, is_out) else {
            return self.report_unplanned(found);
        };
        self.unplanned = None;
        let devices = &self.segment.devices;
        let placed = |at: usize| places[at].is_some();
        for device in devices.iter().filter(|device| !placed(device.position)) {
            // Another SubDevice that may hang at the same port may be there instead.
            let shares = |other: &&crate::SubDevice| other.parent == device.parent;
            if !devices.iter().filter(shares).any(|other| placed(other.position)) {
                self.keeper.is_absent(device.position);
            }
        }
        let back = self.keeper.wanted(&places, &self.segment, now);
        if back.is_empty() {
            return;
        }
        for &position in &back {
            self.keeper.begin(position, now);
            self.link.report(Event::Found { position, cycle });
        }
        let (link, config) = (self.link.clone(), self.config.clone());
        let segment = self.segment.clone();
        let outcomes = self.keeper.outcomes.clone();
        let work = Return { link, config, segment, everybody, places, back, outcomes };
        self.procedures.start(Kind::Readmit, About::default(), async {
            readmit::readmit(work).await;
            Ended::Readmit
        });
    }

    /// Reports that this number of SubDevices answer and do not agree with the plan.
    pub(super) fn report_unplanned(&mut self, found: u16) {
        if !self.procedures.has(Kind::Readmit) && self.unplanned.replace(found) != Some(found) {
            let cycle = self.link.board(|board| board.cycle);
            self.link.report(Event::Unplanned { cycle, found });
        }
    }

    /// Continues all re-admissions, and takes the result of each.
    pub(super) fn work_on_returns(&mut self) {
        let Activity::Operating = self.activity else { return };
        if !self.procedures.has(Kind::Readmit) {
            return;
        }
        let ended = self.procedures.go_on(Kind::Readmit, &mut 0).is_some();
        self.grant_wishes();
        let outcomes = core::mem::take(&mut *self.keeper.outcomes.lock());
        for (position, outcome) in outcomes {
            self.take_return(position, outcome);
        }
        if ended {
            // A SubDevice that was to become the reference may have failed before that.
            if let Some(cycle) = &mut self.cycle {
                cycle.hold_clocks(false);
            }
            if self.segment.devices.iter().all(|device| device.admitted) {
                let (now, jitters) = (self.link.now(), self.config.hop_jitter);
                let watch = |config| DelayWatch::new(config, &self.segment, now, jitters);
                self.delay_watch = self.config.delay_watch.and_then(watch);
            }
        }
    }

    /// Continues the recovery of SubDevices to OP.
    pub(super) fn work_on_recoveries(&mut self) {
        let Activity::Operating = self.activity else { return };
        let mut from = 0;
        while let Some(ended) = self.procedures.go_on(Kind::Recover, &mut from) {
            let Ended::Recover(position, result) = ended else { continue };
            let now = self.link.now();
            let (result, mailbox) = *result;
            let (policy, well) = (self.config.recovery, result.is_ok());
            let through_init = self.keeper.needs_init(position);
            if matches!(&result, Err(cause) if kept_error(cause)) {
                self.keeper.kept_error(position);
            }
            let (after, again) = self.keeper.attempted(position, policy, now, well);
            if let Some(place) = self.mailboxes.get_mut(position).filter(|_| mailbox.is_some()) {
                *place = mailbox;
            }
            match result {
                Ok(device) => {
                    // Its delay may have been corrected meanwhile, so only these fields are taken
                    // over.
                    let known = &mut self.segment.devices[position];
                    (known.al_status, known.al_code) = (device.al_status, device.al_code);
                    known.sync = device.sync;
                    self.states_changed();
                    self.link.report(Event::Recovered { position, after, through_init });
                }
                Err(cause) => self.link.report(Event::NotRecovered { position, cause, again }),
            }
        }
    }

    /// Corrects delays if frames take another way. It does so in the same cycle, since each
    /// datagram with a wrong time moves the clocks further.
    pub(super) fn work_on_shift(&mut self) {
        let Some(cycle) = &mut self.cycle else { return };
        let Activity::Operating = self.activity else {
            // Delays are not corrected during bring-up and shutdown, but the clocks are controlled.
            return cycle.trust_clocks();
        };
        if !self.procedures.has(Kind::Shift) && cycle.doubts_clocks() {
            let reference = self.segment.reference.filter(|_| self.config.readmission.is_some());
            let Some(reference) = reference else { return cycle.trust_clocks() };
            let noise = clock::noise(&self.segment, &self.config);
            // The last readings may already be of the new way, so their median is used.
            let before = |position: usize| {
                let quality = self.quality.as_ref().map_or(&[][..], |monitor| monitor.clocks());
                let clock = quality.iter().find(|clock| clock.position == position)?;
                let first = clock.readings().count().saturating_sub(READINGS_OF_LATE);
                let mut of_late: Vec<Nanos> =
                    clock.readings().skip(first).map(|reading| reading.difference).collect();
                of_late.sort_unstable();
                of_late.get(of_late.len() / 2).copied()
            };
            let with_limits = |device: &crate::SubDevice| {
                let limits = clock::limits(&self.config, noise[device.position]);
                (device.clone(), limits, before(device.position).unwrap_or_default())
            };
            let led = |device: &&crate::SubDevice| {
                device.admitted
                    && device.dc.has_clock()
                    && self.segment.reference != Some(device.position)
            };
            let clocks = self.segment.devices.iter().filter(led).map(with_limits).collect();
            let station = self.segment.devices[reference].station;
            let (filter, _) = clock::depths(&self.segment, &self.config);
            let shift = clock::shift(self.link.clone(), filter, station, clocks);
            let shift = async { Ended::Shift(shift.await) };
            self.procedures.start(Kind::Shift, About::default(), shift);
        }
        if let Some(Ended::Shift(delays)) = self.procedures.go_on(Kind::Shift, &mut 0) {
            for (position, delay) in delays {
                self.segment.devices[position].delay = Some(delay);
                if let Some(quality) = &mut self.quality {
                    quality.delay_changed(position);
                }
            }
            cycle.trust_clocks();
        }
    }

    pub(super) fn grant_wishes(&mut self) {
        while let Some(wish) = self.link.board(|board| board.wishes.pop_front()) {
            match (wish, &mut self.cycle) {
                (Wish::HoldClocks, Some(cycle)) => cycle.hold_clocks(true),
                (Wish::Lead(position), Some(_)) => self.lead(position),
                (Wish::Delay(position, delay), Some(_)) => {
                    self.segment.devices[position].delay = Some(delay);
                    if let Some(quality) = &mut self.quality {
                        quality.delay_changed(position);
                    }
                }
                (Wish::LeaveOut(position), Some(cycle)) => cycle.set_present(position, false),
                // A cycle that begins later finds out itself which SubDevices take part.
                (_, None) => {}
            }
        }
    }

    pub(super) fn take_return(&mut self, position: usize, outcome: readmit::Outcome) {
        let (now, number) = self.link.with(|shared| (shared.port.now, shared.board.cycle));
        match outcome {
            Ok(one) => {
                let (device, mailbox) = *one;
                self.segment.devices[position] = crate::SubDevice { admitted: true, ..device };
                self.states_changed();
                if let Some(place) = self.mailboxes.get_mut(position) {
                    *place = mailbox;
                }
                if let Some(cycle) = &mut self.cycle {
                    cycle.set_present(position, true);
                }
                let after = self.keeper.admitted(position, now);
                self.link.report(Event::Readmitted { position, cycle: number, after });
            }
            Err(cause) => {
                let policy = self.config.readmission.unwrap_or_default();
                let again = self.keeper.failed(position, &cause, policy, now);
                // It may have been chosen as reference, but did not get so far.
                self.elect();
                self.link.report(Event::NotReadmitted { position, cause, again });
            }
        }
    }

    /// Starts the recovery of a SubDevice that answers but is not in OP, if it is due.
    pub(super) fn consider_recovery(&mut self, position: usize) {
        let device = &self.segment.devices[position];
        let (status, code) = (device.al_status, device.al_code);
        let now = self.link.now();
        if status == AlStatus::new(AlState::Op) {
            return self.keeper.is_well(position, now);
        }
        let Some(attempt) = self.keeper.attempt(position, self.config.recovery, now) else {
            return;
        };
        self.link.report(Event::Recovering { position, status, code, attempt });
        let (link, config) = (self.link.clone(), self.config.clone());
        let segment = self.segment.clone();
        if self.keeper.needs_init(position) {
            self.close_mailbox(position);
            let restart = readmit::restart(link, config, segment, position);
            self.procedures.start(Kind::Recover, About::position(position), async move {
                Ended::Recover(position, Box::new(restart.await))
            });
        } else {
            let recover = readmit::recover(link, config, segment, position);
            self.procedures.start(Kind::Recover, About::position(position), async move {
                Ended::Recover(position, Box::new((recover.await, None)))
            });
        }
    }

    /// Ends what goes on in a mailbox: a procedure on it would take the answers of its later
    /// re-admission.
    fn close_mailbox(&mut self, position: usize) {
        if let Some(mailbox) = self.mailboxes.get_mut(position) {
            *mailbox = None;
        }
        self.procedures.end_at(Kind::Entry, position);
        let asked = self.procedures.end_at(Kind::Request, position);
        self.refuse_these(&asked);
    }
}

/// Whether a SubDevice kept its error although that was acknowledged.
fn kept_error(cause: &Cause) -> bool {
    matches!(cause, Cause::StateTimeout { requested: AlState::SafeOp, status, .. } if status.error())
}

/// Number of readings of a clock whose median is its recent difference.
const READINGS_OF_LATE: usize = 8;

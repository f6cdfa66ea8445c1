//! SubDevices that go and come back while the segment runs.

use super::*;
use crate::board::Wish;

/// SubDevices that go and come back.
impl MainDevice {
    /// A SubDevice takes no part any more.
    pub(super) fn lose(&mut self, position: usize) {
        let number = self.link.board(|board| board.cycle);
        let device = &mut self.segment.devices[position];
        device.admitted = false;
        (device.al_status, device.al_code) = (AlStatus(0), AlStatusCode::NO_ERROR);
        if let Some(mailbox) = self.mailboxes.get_mut(position) {
            *mailbox = None;
        }
        self.link.report(Event::Lost { position, cycle: number });
        if let Some(cycle) = &mut self.cycle {
            cycle.set_present(position, false);
        }
        self.keeper.recovering.retain(|(other, _)| *other != position);
        self.forget_delays();
        if self.segment.reference == Some(position) {
            self.link.report(Event::ReferenceLost { position, cycle: number });
        }
    }

    /// If the reference is gone, the first clock that is left leads: the drift datagram reaches what lies behind it.
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

    /// Another clock leads.
    pub(super) fn lead(&mut self, position: usize) {
        self.segment.reference = Some(position);
        let number = self.link.board(|board| board.cycle);
        if let Some(cycle) = &mut self.cycle {
            cycle.set_reference(&self.segment.devices[position]);
            cycle.hold_clocks(false);
        }
        self.link.report(Event::ReferenceElected { position, cycle: number });
    }

    /// More answer than take part: those that are where they belong are taken up.
    pub(super) fn welcome(&mut self, everybody: Vec<Found>) {
        if self.keeper.readmitting.is_some() {
            return;
        }
        let (now, cycle) = self.link.with(|shared| (shared.port.now, shared.board.cycle));
        let found = everybody.len() as u16;
        let is_out = |position| self.keeper.is_out(position);
        let Ok(places) = readmit::places(&self.segment, &everybody, is_out) else {
            if self.unplanned != Some(found) {
                self.unplanned = Some(found);
                self.link.report(Event::Unplanned { cycle, found });
            }
            return;
        };
        self.unplanned = None;
        let devices = &self.segment.devices;
        let placed = |at: usize| places[at].is_some();
        for device in devices.iter().filter(|device| !placed(device.position)) {
            // Another that may hang at the same port may be there in its stead.
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
        let mut task: Pin<Box<readmit::Readmitting>> = Box::pin(readmit::readmit(work));
        // The first poll queues its datagrams.
        let _pending = poll(&mut task).is_pending();
        self.keeper.readmitting = Some(task);
    }

    /// Goes on with what is under way, and takes its end.
    pub(super) fn work_on_returns(&mut self) {
        let Activity::Operating = self.activity else {
            // Nothing is set right on the way up or down, and the clocks are led all the same.
            if let Some(cycle) = &mut self.cycle {
                cycle.trust_clocks();
            }
            return;
        };
        self.work_on_shift();
        if let Some(task) = &mut self.keeper.readmitting {
            let ended = poll(task).is_ready();
            self.grant_wishes();
            let outcomes = core::mem::take(&mut *self.keeper.outcomes.lock());
            for (position, outcome) in outcomes {
                self.take_return(position, outcome);
            }
            if ended {
                self.keeper.readmitting = None;
                // A reference that was to lead and did not get so far.
                if let Some(cycle) = &mut self.cycle {
                    cycle.hold_clocks(false);
                }
                if self.segment.devices.iter().all(|device| device.admitted) {
                    let now = self.link.now();
                    let watch = |config| DelayWatch::new(config, &self.segment, now);
                    self.delay_watch = self.config.delay_watch.and_then(watch);
                }
            }
        }
        let mut at = 0;
        while at < self.keeper.recovering.len() {
            let Poll::Ready(result) = poll(&mut self.keeper.recovering[at].1) else {
                at += 1;
                continue;
            };
            let (position, _) = self.keeper.recovering.swap_remove(at);
            let now = self.link.now();
            let (after, again) = self.keeper.attempted(position, self.config.recovery, now);
            match result {
                Ok(device) => {
                    self.segment.devices[position] = device;
                    self.link.report(Event::Recovered { position, after });
                }
                Err(cause) => self.link.report(Event::NotRecovered { position, cause, again }),
            }
        }
    }

    /// Sets delays right where frames have come to take another way: in the same cycle, as each datagram with a
    /// wrong time throws the clocks off further.
    pub(super) fn work_on_shift(&mut self) {
        let Some(cycle) = &mut self.cycle else { return };
        if self.keeper.shifting.is_none() && cycle.doubts_clocks() {
            let reference = self.segment.reference.filter(|_| self.config.readmission.is_some());
            let Some(reference) = reference else { return cycle.trust_clocks() };
            let led = |device: &&crate::SubDevice| {
                device.admitted
                    && device.dc.has_clock()
                    && self.segment.reference != Some(device.position)
            };
            let clocks = self.segment.devices.iter().filter(led).cloned().collect();
            let (link, threshold) = (self.link.clone(), self.config.drift_threshold);
            let station = self.segment.devices[reference].station;
            self.keeper.shifting = Some(Box::pin(clock::shift(link, threshold, station, clocks)));
        }
        let Some(task) = &mut self.keeper.shifting else { return };
        if let Poll::Ready(delays) = poll(task) {
            self.keeper.shifting = None;
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
                // It was to lead, and did not get so far.
                self.elect();
                self.link.report(Event::NotReadmitted { position, cause, again });
            }
        }
    }

    /// A SubDevice that answers and is not in OP.
    pub(super) fn consider_recovery(&mut self, position: usize) {
        let device = &self.segment.devices[position];
        let (status, code) = (device.al_status, device.al_code);
        if status == AlStatus::new(AlState::Op) {
            return;
        }
        let now = self.link.now();
        let Some(attempt) = self.keeper.attempt(position, self.config.recovery, now) else {
            return;
        };
        self.link.report(Event::Recovering { position, status, code, attempt });
        let (link, config) = (self.link.clone(), self.config.clone());
        let mut task: Pin<Box<readmit::Recovering>> =
            Box::pin(readmit::recover(link, config, self.segment.clone(), position));
        // The first poll queues its datagram.
        let _pending = poll(&mut task).is_pending();
        self.keeper.recovering.push((position, task));
    }
}

//! Reads the states of all SubDevices.

use alloc::vec::Vec;

use isocat_wire::al::{AlState, AlStatus};
use isocat_wire::time::{Host, Nanos, Time};

use super::MainDevice;
use super::background::Kind;
use super::procedures::{About, Ended};
use super::way::Activity;
use crate::event::Event;
use crate::health::{self, Answer, Look, Others};

/// States.
impl MainDevice {
    /// Reads the state of every SubDevice if the cyclic broadcast does not show OP everywhere, or
    /// if the number of answers is not that of the SubDevices that take part.
    pub(super) fn work_on_looks(&mut self) {
        let Activity::Operating = self.activity else { return };
        if let Some(Ended::Look(look)) = self.procedures.go_on(Kind::Look, &mut 0) {
            self.take_look(look);
        }
        if self.procedures.has(Kind::Look) {
            return;
        }
        let Some(cycle) = &self.cycle else { return };
        let seen = (cycle.al_status, cycle.answering());
        let good = seen == (AlStatus::new(AlState::Op).0, cycle.present());
        if good && self.checked.is_none() {
            return;
        }
        // The broadcast is an OR over all SubDevices: another SubDevice may leave OP without a
        // change of it. So the states are also read again after a while, and when a SubDevice may
        // be recovered.
        let now = self.link.now();
        let next_attempt = self.keeper.next_attempt();
        let known = |(picture, at): ((u16, u16), Time<Host>)| {
            let attempt = next_attempt.filter(|attempt| *attempt > at);
            picture == seen && now < attempt.unwrap_or(Time::NEVER).min(at + CHECK_AGAIN)
        };
        if self.checked.is_some_and(known) {
            return;
        }
        self.checked = (!good).then_some((seen, now));
        let asked = self.segment.devices.iter().filter(|device| device.admitted);
        let asked = asked.map(|device| (device.position, device.station)).collect();
        let look = health::look(self.link.clone(), asked, self.segment.devices.len());
        self.procedures.start(Kind::Look, About::default(), async { Ended::Look(look.await) });
    }

    fn take_look(&mut self, look: Look) {
        let cycle = self.link.board(|board| board.cycle);
        let (reference, mut lost) = (self.segment.reference, Vec::new());
        for (position, answer) in look.answers {
            match answer {
                Answer::Status(status, code) => {
                    let device = &mut self.segment.devices[position];
                    if (device.al_status, device.al_code) != (status, code) {
                        (device.al_status, device.al_code) = (status, code);
                        self.states_changed();
                        self.link.report(Event::StateChanged { position, status, code, cycle });
                    }
                    self.consider_recovery(position);
                }
                Answer::Nobody if self.config.readmission.is_some() => {
                    self.lose(position);
                    lost.push(position);
                }
                Answer::Nobody | Answer::Unknown => {}
            }
        }
        if self.config.readmission.is_none() {
            return;
        }
        if reference.is_some_and(|at| lost.contains(&at)) {
            self.elect();
        }
        match look.others {
            Others::Everybody(_) | Others::TooMany(_) if self.is_ring_cut() => {}
            Others::Everybody(everybody) => self.welcome(everybody),
            Others::TooMany(found) => self.report_unplanned(found),
            Others::None => {
                self.unplanned = None;
                for device in self.segment.devices.iter().filter(|device| !device.admitted) {
                    self.keeper.is_absent(device.position);
                }
            }
        }
    }
}

/// Time after which the states of all SubDevices are read again while the broadcast is wrong. It
/// does not depend on the cycle, as the pauses of [`Recovery`](crate::Recovery) do not.
const CHECK_AGAIN: Nanos = Nanos::millis(100);

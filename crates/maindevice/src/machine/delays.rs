//! Delay measurement while the segment runs.

use isocat_wire::register;

use super::MainDevice;
use super::background::Kind;
use super::procedures::{About, Ended};
use super::way::Activity;
use crate::delay;
use crate::delay_watch::Change;
use crate::event::Event;

/// Delays while the segment runs.
impl MainDevice {
    /// Latches when it is due, and reports changed delays.
    pub(super) fn work_on_latches(&mut self) {
        let Activity::Operating = self.activity else { return };
        let now = self.link.now();
        let Some(watch) = &mut self.delay_watch else { return };
        if self.procedures.has(Kind::Latch) {
            let Some(Ended::Latch(times)) = self.procedures.go_on(Kind::Latch, &mut 0) else {
                return;
            };
            self.link.board(|board| match times {
                Some(_) => board.statistics.delay_latches += 1,
                None => board.statistics.delay_latches_lost += 1,
            });
            for change in watch.sample(now, times.as_ref()) {
                self.take_change(change);
            }
        } else if watch.due(now) {
            let (link, stations) = (self.link.clone(), delay::stations(&self.segment));
            self.procedures.start(Kind::Latch, About::default(), async move {
                Ended::Latch(delay::latch(&link, &stations).await.ok())
            });
        }
    }

    fn take_change(&mut self, change: Change) {
        let Change { position, written, found } = change;
        let Some(found) = found else {
            return self.link.report(Event::DelayRestored { position, written });
        };
        let wished = self.config.delay_watch.is_some_and(|watch| watch.rewrite);
        let device = &self.segment.devices[position];
        match found.nanos().filter(|_| wished && device.dc.has_clock()) {
            Some(delay) => {
                let address = register::SYSTEM_TIME_DELAY.address;
                let data = (delay.0 as u32).to_le_bytes();
                let write = self.link.fpwr(device.station, address, &data);
                let write = async move { Ended::Rewrite(change, write.expect(1).await.is_ok()) };
                self.procedures.start(Kind::Rewrite, About::position(position), write);
            }
            None => {
                let rewritten = false;
                self.link.report(Event::DelayChanged { position, written, found, rewritten });
            }
        }
    }

    /// Reports which delays were written.
    pub(super) fn work_on_rewriting(&mut self) {
        let Activity::Operating = self.activity else { return };
        let mut from = 0;
        while let Some(ended) = self.procedures.go_on(Kind::Rewrite, &mut from) {
            let Ended::Rewrite(change, rewritten) = ended else { continue };
            let Change { position, written, found: Some(found) } = change else { continue };
            if rewritten {
                let device = &mut self.segment.devices[position];
                (device.delay, device.measured_delay) = (found.nanos(), Some(found));
                if let Some(watch) = &mut self.delay_watch {
                    watch.rewritten(position, found);
                }
            }
            self.link.report(Event::DelayChanged { position, written, found, rewritten });
        }
    }
}

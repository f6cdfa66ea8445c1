//! Delays that are measured again while the segment runs.

use super::*;

/// Delays while the segment runs.
impl MainDevice {
    /// Latches when it is time, and tells what has changed.
    pub(super) fn work_on_delays(&mut self) {
        let Activity::Operating = self.activity else { return };
        self.end_rewriting();
        let now = self.link.now();
        let Some(watch) = &mut self.delay_watch else { return };
        if let Some(latching) = &mut self.latching {
            let Poll::Ready(times) = poll(latching) else { return };
            self.latching = None;
            self.link.board(|board| match times {
                Some(_) => board.statistics.delay_latches += 1,
                None => board.statistics.delay_latches_lost += 1,
            });
            for change in watch.sample(now, times.as_ref()) {
                self.take_change(change);
            }
        } else if watch.due(now) {
            let (link, stations) = (self.link.clone(), delay::stations(&self.segment));
            let mut latching: Pin<Box<Latching>> =
                Box::pin(async move { delay::latch(&link, &stations).await.ok() });
            // The first poll queues its datagram.
            let _pending = poll(&mut latching).is_pending();
            self.latching = Some(latching);
        }
    }

    pub(super) fn take_change(&mut self, change: Change) {
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
                let write = async move { (change, write.expect(1).await.is_ok()) };
                self.rewriting.push(Box::pin(write));
            }
            None => {
                let rewritten = false;
                self.link.report(Event::DelayChanged { position, written, found, rewritten });
            }
        }
    }

    pub(super) fn end_rewriting(&mut self) {
        let mut at = 0;
        while at < self.rewriting.len() {
            let Poll::Ready((change, rewritten)) = poll(&mut self.rewriting[at]) else {
                at += 1;
                continue;
            };
            drop(self.rewriting.swap_remove(at));
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

    pub(super) fn forget_delays(&mut self) {
        self.reading = None;
        self.delay_watch = None;
        self.latching = None;
        self.rewriting.clear();
    }
}

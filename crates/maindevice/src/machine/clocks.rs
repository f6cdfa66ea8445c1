//! Clocks that are read while the segment runs.

use super::*;

/// Clocks while the segment runs.
impl MainDevice {
    /// What the clocks say that are read in the background ([`Config::quality`]); empty without, and before the segment
    /// is in operation. Stays when it ends.
    pub fn quality(&self) -> &[ClockQuality] {
        self.quality.as_ref().map_or(&[], |monitor| monitor.clocks())
    }

    /// Time on the wire of the frames that read them so far.
    pub fn quality_wire_time(&self) -> Nanos {
        self.quality.as_ref().map_or(Nanos::ZERO, |monitor| monitor.spent())
    }

    pub(super) fn work_on_quality(&mut self) {
        let Activity::Operating = self.activity else { return };
        let now = self.link.now();
        let Some(monitor) = &mut self.quality else { return };
        let unled = self.cycle.as_ref().and_then(|cycle| cycle.unled());
        if let Some(cycles) = unled.and_then(|cycles| monitor.guidance(cycles)) {
            self.link.report(Event::ClocksUnled { cycles });
        }
        if let Some(reading) = &mut self.reading {
            let Poll::Ready(found) = poll(reading) else { return };
            self.reading = None;
            for (index, registers) in found {
                for change in monitor.sample(index, registers) {
                    let quality::Change { position, alarm, raised, difference, slope_ppb } = change;
                    let alarm =
                        Event::ClockAlarm { position, alarm, raised, difference, slope_ppb };
                    self.link.report(alarm);
                }
            }
        } else if monitor.due(now) {
            let wanted = monitor.batch(now);
            let mut reading: Pin<Box<ReadingClocks>> =
                Box::pin(quality::read(self.link.clone(), wanted));
            // The first poll queues its datagrams.
            let _pending = poll(&mut reading).is_pending();
            self.reading = Some(reading);
        }
    }
}

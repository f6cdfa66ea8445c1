//! What is read in the background while the segment runs.

use super::*;

/// An entry that is being read; its mailbox is with it.
pub(super) struct Asking {
    pub(super) position: usize,
    object: ObjectAddress,
    /// What the mailbox had spent before.
    before: Nanos,
    service: Pin<Box<dyn Future<Output = (Mailbox, SdoResult)> + Send>>,
}

/// How well the segment runs.
impl MainDevice {
    /// What the clocks say that are read in the background ([`Config::quality`]); empty without, and before the segment
    /// is in operation. Stays when it ends.
    pub fn quality(&self) -> &[ClockQuality] {
        self.quality.as_ref().map_or(&[], |monitor| monitor.clocks())
    }

    /// All that is known at this moment: clocks, error counters and distances, states, working counters, margins, and
    /// the moments before. `None` without [`Config::quality`], and outside operation.
    pub fn snapshot(&self) -> Option<Snapshot<'_>> {
        let cycle = self.cycle.as_ref()?;
        Some(self.quality.as_ref()?.snapshot(self.shared().port.now, cycle))
    }

    /// Time on the wire of the frames that were sent for it so far, and since when. A frame that was lost and sent
    /// again counts once.
    pub fn quality_wire_time(&self) -> Option<(Nanos, Time<Host>)> {
        self.quality.as_ref().map(|monitor| (monitor.spent(), monitor.began()))
    }

    /// Whether there is something to read or to judge.
    pub(super) fn has_quality_to_look_at(&self) -> bool {
        let (Some(monitor), Some(cycle)) = (&self.quality, &self.cycle) else { return false };
        monitor.is_due(self.shared().port.now, cycle.number())
    }

    /// Takes the answer to the entry that was asked for, and gives its mailbox back.
    pub(super) fn work_on_entry(&mut self) {
        let Some(asking) = &mut self.asking else { return };
        let Poll::Ready((mailbox, answer)) = poll(&mut asking.service) else { return };
        let (position, object) = (asking.position, asking.object);
        let cost = mailbox.spent() - asking.before;
        self.asking = None;
        // One that was lost meanwhile has none, or has got another when it came back.
        let admitted = self.segment.devices.get(position).is_some_and(|device| device.admitted);
        if let Some(place) = self.mailboxes.get_mut(position).filter(|place| place.is_none())
            && admitted
        {
            *place = Some(mailbox);
        }
        let now = self.link.now();
        if let Some(monitor) = &mut self.quality {
            // That of one that is gone is no surprise.
            let changes = monitor.take_entry((position, object), now, &answer, cost, admitted);
            self.report_alarms(changes);
        }
    }

    pub(super) fn work_on_quality(&mut self) {
        let Activity::Operating = self.activity else { return };
        let now = self.link.now();
        let (Some(monitor), Some(cycle)) = (&mut self.quality, &mut self.cycle) else { return };
        if let Some(cycles) = cycle.unled().and_then(|cycles| monitor.guidance(cycles)) {
            self.link.report(Event::ClocksUnled { cycles });
        }
        let counts = self.link.board(|board| board.statistics);
        let mut changes = monitor.look(now, &self.segment, cycle, &counts);
        match &mut self.reading {
            Some(reading) => {
                if let Poll::Ready(found) = poll(reading) {
                    self.reading = None;
                    for (index, registers) in found {
                        changes.extend(monitor.take_clock(index, registers));
                    }
                }
            }
            None => {
                let wanted = monitor.clocks_to_read(now);
                if !wanted.is_empty() {
                    let mut reading: Pin<Box<ReadingClocks>> =
                        Box::pin(quality::read(self.link.clone(), wanted));
                    // The first poll queues its datagrams.
                    let _pending = poll(&mut reading).is_pending();
                    self.reading = Some(reading);
                }
            }
        }
        self.report_alarms(changes);
        self.ask_for_entry(now);
    }

    /// Reads an entry if it is time, through a mailbox that nobody uses or waits for.
    fn ask_for_entry(&mut self, now: Time<Host>) {
        if self.asking.is_some() {
            return;
        }
        let Self { quality: Some(monitor), mailboxes, jobs, .. } = self else { return };
        let is_free = |position: usize| {
            mailboxes.get(position).is_some_and(Option::is_some)
                && !jobs.iter().any(|job| job.position == position)
        };
        let Some((position, object)) = monitor.entry_to_read(now, is_free) else { return };
        let Some(mut mailbox) = self.mailboxes.get_mut(position).and_then(Option::take) else {
            return;
        };
        let before = mailbox.spent();
        let mut service: Pin<Box<dyn Future<Output = (Mailbox, SdoResult)> + Send>> =
            Box::pin(async move {
                let answer = coe::upload(&mut mailbox, object, false).await;
                (mailbox, answer)
            });
        // The first poll queues its first datagram; it can't be done yet.
        let _pending = poll(&mut service).is_pending();
        self.asking = Some(Asking { position, object, before, service });
    }

    fn report_alarms(&self, changes: Vec<quality::Change>) {
        for change in changes {
            self.link.report(Event::Alarm(change));
        }
    }
}

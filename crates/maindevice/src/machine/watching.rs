//! Readings in the background while the segment runs.

use alloc::vec::Vec;

use isocat_wire::time::{Host, Nanos, Time};

use super::MainDevice;
use super::background::Kind;
use super::procedures::{About, Ended};
use super::way::Activity;
use crate::coe;
use crate::event::Event;
use crate::quality::{self, ClockQuality, ObjectQuality, Snapshot};

/// Quality of the running segment.
impl MainDevice {
    /// The clocks that are read in the background ([`Config::quality`](crate::Config::quality));
    /// empty without it, and before the segment is in operation. The readings remain after
    /// operation ends.
    pub fn quality(&self) -> &[ClockQuality] {
        self.quality.as_ref().map_or(&[], |monitor| monitor.clocks())
    }

    /// All present readings: clocks, error counters and distances, states, working counters and
    /// margins, with their history. `None` without [`Config::quality`](crate::Config::quality), and
    /// outside operation.
    pub fn snapshot(&self) -> Option<Snapshot<'_>> {
        let cycle = self.cycle.as_ref()?;
        Some(self.quality.as_ref()?.snapshot(self.shared().port.now, cycle))
    }

    /// The objects that are read in the background, by position: those of [`Self::snapshot`].
    pub fn object_quality(&self) -> Option<&[ObjectQuality]> {
        self.cycle.as_ref()?;
        Some(self.quality.as_ref()?.objects())
    }

    /// Whether delays are measured while the segment runs
    /// ([`Config::delay_watch`](crate::Config::delay_watch)).
    pub fn watches_delays(&self) -> bool {
        self.delay_watch.is_some()
    }

    /// Wire time of the frames sent for it so far, and the start of that time. A frame that was
    /// lost and sent again counts once.
    pub fn quality_wire_time(&self) -> Option<(Nanos, Time<Host>)> {
        self.quality.as_ref().map(|monitor| (monitor.spent(), monitor.began()))
    }

    /// Whether there is a value to read or to judge.
    pub(super) fn has_quality_to_look_at(&self) -> bool {
        let (Some(monitor), Some(cycle)) = (&self.quality, &self.cycle) else { return false };
        monitor.is_due(self.shared().port.now, cycle.number())
    }

    /// Called wherever the state of a SubDevice in the segment changes in operation.
    pub(super) fn states_changed(&mut self) {
        if let Some(monitor) = &mut self.quality {
            monitor.states_changed();
        }
    }

    /// Takes the answer for the requested entry, and puts its mailbox back.
    pub(super) fn work_on_entry(&mut self) {
        let Some(ended) = self.procedures.go_on(Kind::Entry, &mut 0) else { return };
        let Ended::Entry { position, object, before, answer } = ended else { return };
        let (mailbox, answer) = answer;
        let cost = mailbox.spent() - before;
        // A SubDevice that was lost meanwhile has no mailbox, or got a new one when it came back.
        let admitted = self.segment.devices.get(position).is_some_and(|device| device.admitted);
        if let Some(place) = self.mailboxes.get_mut(position).filter(|place| place.is_none())
            && admitted
        {
            *place = Some(mailbox);
        }
        let now = self.link.now();
        if let Some(monitor) = &mut self.quality {
            // A silent mailbox of a lost SubDevice raises no alarm.
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
        if self.procedures.has(Kind::Clocks) {
            if let Some(Ended::Clocks(found)) = self.procedures.go_on(Kind::Clocks, &mut 0) {
                // While the delays do not fit the way of frames, 0x092C shows the way and not the
                // clock.
                for (index, registers) in found.into_iter().filter(|_| !cycle.doubts_clocks()) {
                    changes.extend(monitor.take_clock(index, registers));
                }
            }
        } else {
            let wanted = monitor.clocks_to_read(now);
            if !wanted.is_empty() {
                let read = quality::read(self.link.clone(), wanted);
                let read = async { Ended::Clocks(read.await) };
                self.procedures.start(Kind::Clocks, About::default(), read);
            }
        }
        self.report_alarms(changes);
        self.ask_for_entry(now);
    }

    /// Reads an entry if it is due, through a mailbox that is free and that no request waits for.
    fn ask_for_entry(&mut self, now: Time<Host>) {
        if self.procedures.has(Kind::Entry) {
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
        self.procedures.start(Kind::Entry, About::position(position), async move {
            let answer = coe::upload(&mut mailbox, object, false).await;
            Ended::Entry { position, object, before, answer: (mailbox, answer) }
        });
    }

    fn report_alarms(&self, changes: Vec<quality::Change>) {
        for change in changes {
            self.link.report(Event::Alarm(change));
        }
    }
}

//! Readings in the background while the segment runs.

use alloc::vec::Vec;

use isocat_wire::time::{Host, Nanos, Time};

use super::background::Kind;
use super::procedures::{About, Ended};
use super::share::most_octets;
use super::way::Activity;
use super::{MainDevice, in_hand};
use crate::board::Board;
use crate::coe;
use crate::event::Event;
use crate::link::Shared;
use crate::quality::{self, ClockQuality, Monitor, ObjectQuality, Snapshot};

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

    /// Takes what was read of clocks, starts the next reads, and judges. The reads are no procedure
    /// since they are made all the time: their datagrams are built here, in memory that is used
    /// again.
    #[inline(never)]
    pub(super) fn watch(&mut self) {
        let (Some(monitor), Some(cycle)) = (&self.quality, &self.cycle) else { return };
        let port = &self.shared().port;
        let is_due = monitor.is_due(port.now, cycle.number(), cycle.unled());
        if is_due || self.reads.are_back(port) {
            self.work_on_quality();
        }
    }

    /// The same, whether or not something is due.
    pub(super) fn work_on_quality(&mut self) {
        let Activity::Operating = self.activity else { return };
        let Self { shared, quality, cycle, reads, segment, config, .. } = self;
        let (Some(monitor), Some(cycle)) = (quality, cycle) else { return };
        let Shared { port, board } = in_hand(shared);
        let now = port.now;
        if let Some(cycles) = cycle.unled().and_then(|cycles| monitor.guidance(cycles)) {
            board.report(Event::ClocksUnled { cycles });
        }
        for change in monitor.look(now, segment, cycle, &board.statistics) {
            board.report(Event::Alarm(change));
        }
        if reads.are_under_way() {
            // While the delays do not fit the way of frames, 0x092C shows the way and not the
            // clock.
            let doubted = cycle.doubts_clocks();
            if doubted {
                reads.take(port, &mut (), |(), _, _| (), |(), _| ());
            } else {
                let judge = |(monitor, board): &mut (&mut Monitor, &mut Board), index, found| {
                    for change in monitor.judge_clock(index, found) {
                        board.report(Event::Alarm(change));
                    }
                };
                let keep = |context: &mut (&mut Monitor, &mut Board), index, registers| {
                    if !context.0.keep_clock(index, registers) {
                        judge(context, index, Some(registers));
                    }
                };
                let miss = |context: &mut (&mut Monitor, &mut Board), index| {
                    judge(context, index, None);
                };
                reads.take(port, &mut (&mut *monitor, board), keep, miss);
            }
        } else if monitor.has_clocks_to_read(now, cycle.number()) {
            let octets = most_octets(cycle, config);
            let (wanted, datagrams) = reads.clear();
            monitor.clocks_to_read(now, cycle.number(), octets, wanted, datagrams);
            reads.start(port);
        }
        if monitor.has_entry_to_read(now) && !self.procedures.has(Kind::Entry) {
            self.lend(|machine| machine.ask_for_entry(now));
        }
    }

    /// Reads an entry if it is due, through a mailbox that is free and that no request waits for.
    fn ask_for_entry(&mut self, now: Time<Host>) {
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

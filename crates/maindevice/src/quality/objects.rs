//! Reads the sync objects 0x1C32 and 0x1C33 while the segment runs: error counters and measured
//! distances, by SDO, one entry at a time, each SubDevice in turn.

use alloc::vec::Vec;

use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::ObjectAddress;
use isocat_wire::time::{Host, Nanos, Time};

use super::pace::Pace;
use crate::alarm::{Alarm, Change, Found, Hysteresis, RAISE};
use crate::error::{SdoError, SdoResult};
use crate::segment::{SubDevice, SyncEntry, SyncObject};

/// One entry of 0x1C32 or 0x1C33 as it was last read.
///
/// Reading changes nothing in the device. Only a write to :08 and the bring-up reset counters, and
/// distances are the least and the largest since SAFEOP.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EntryQuality {
    /// The entry.
    pub object: ObjectAddress,
    /// Time of its last answer, and its value: a count, ns for distances (:0F to :12), 0 or 1 for
    /// the sync error (:20). `None` before the first answer.
    pub last: Option<(Time<Host>, u32)>,
    /// Increase of the counter, summed from reading to reading. 0x1C32:0B decreases by itself while
    /// events come in time, so its decrease has no meaning, and an error that came and went between
    /// two readings is not seen. Any other counter that decreases has started again from 0.
    pub risen: u64,
    alarm: Hysteresis,
}

impl EntryQuality {
    /// Whether its alarm ([`Alarm::Counter`]) is raised.
    pub const fn has_alarm(&self) -> bool {
        self.alarm.is_up()
    }

    fn new(index: u16, entry: &SyncEntry) -> Self {
        let object = ObjectAddress::new(index, entry.sub);
        Self { object, last: None, risen: 0, alarm: Hysteresis::new(1, CALM) }
    }

    /// Takes a value; returns the alarm if it comes or ends.
    fn take(&mut self, at: Time<Host>, value: u32) -> Option<(bool, Found)> {
        let before = self.last.replace((at, value)).map_or(value, |(_, value)| value);
        let rise = match self.object.sub {
            sub::SYNC_ERROR => u32::from(value != 0 && before == 0),
            sub if !COUNTERS.contains(&sub) => return None,
            sub::SM_EVENT_MISSED => value.saturating_sub(before),
            _ if value < before => value,
            _ => value - before,
        };
        self.risen += u64::from(rise);
        let bad = match self.object.sub {
            sub::SYNC_ERROR => value != 0,
            _ => rise > 0,
        };
        let raised = self.alarm.sample(bad, !bad)?;
        let found = Found::Counter { object: self.object, value, risen: self.risen };
        Some((raised, found))
    }
}

/// The objects of one SubDevice.
#[derive(Clone, Debug)]
pub struct ObjectQuality {
    position: usize,
    /// The entries that it has, without those that it refused.
    pub entries: Vec<EntryQuality>,
    /// Number of services without an answer.
    pub unanswered: u32,
    silent: Hysteresis,
    turn: usize,
    /// It is not asked before this time.
    rests: Time<Host>,
}

impl ObjectQuality {
    /// Whether [`Alarm::MailboxSilent`] is raised.
    pub const fn is_silent(&self) -> bool {
        self.silent.is_up()
    }

    /// Chooses the entries to read from the answers during bring-up.
    fn new(device: &SubDevice, asked: bool) -> Self {
        let of = |index: u16, object: &Option<SyncObject>, subs: &'static [u8]| {
            let entries = object.iter().flat_map(|object| &object.entries);
            let there =
                move |entry: &&SyncEntry| subs.contains(&entry.sub) && entry.number().is_some();
            entries.filter(there).map(|entry| EntryQuality::new(index, entry)).collect::<Vec<_>>()
        };
        let mut entries = Vec::new();
        if asked && device.has_coe() {
            entries = of(OUTPUT_PARAMETER, &device.output_sync, &COUNTERS);
            entries.extend(of(OUTPUT_PARAMETER, &device.output_sync, &DISTANCES));
            entries.extend(of(INPUT_PARAMETER, &device.input_sync, &COUNTERS));
        }
        Self {
            position: device.position,
            entries,
            unanswered: 0,
            silent: Hysteresis::new(RAISE, 1),
            turn: 0,
            rests: Time::ZERO,
        }
    }

    /// Takes an answer; returns the alarms that come or end.
    fn take(&mut self, object: ObjectAddress, at: Time<Host>, answer: &SdoResult) -> Vec<Change> {
        let position = self.position;
        let mut changes = Vec::new();
        let mut tell = |alarm, (raised, found)| {
            changes.push(Change { position, alarm, raised, found });
        };
        let silent = !matches!(answer, Ok(_) | Err(SdoError::Abort(_)));
        self.unanswered += u32::from(silent);
        if let Some(raised) = self.silent.sample(silent, !silent) {
            let found = Found::Mailbox { unanswered: self.unanswered };
            tell(Alarm::MailboxSilent, (raised, found));
        }
        if silent {
            // A service without an answer takes seconds, during which no other SubDevice is asked.
            self.rests = at + REST;
            return changes;
        }
        let value = answer.as_ref().ok().and_then(|bytes| number(bytes));
        let place = self.entries.iter().position(|entry| entry.object == object);
        match (place, value) {
            (Some(place), Some(value)) => {
                if let Some(change) = self.entries[place].take(at, value) {
                    tell(Alarm::Counter, change);
                }
                self.turn = place + 1;
            }
            (Some(place), None) => {
                self.entries.remove(place);
            }
            (None, _) => {}
        }
        changes
    }
}

/// Reads the objects of all SubDevices in turn.
#[derive(Clone, Debug)]
pub(super) struct Objects {
    asked: bool,
    pub all: Vec<ObjectQuality>,
    /// Whether any of them has an entry to read.
    there: bool,
    turn: usize,
    pub pace: Pace,
}

impl Objects {
    /// The objects of a segment; none without `asked`.
    pub fn new(asked: bool, devices: &[SubDevice], pace: Pace) -> Self {
        let all = devices.iter().map(|device| ObjectQuality::new(device, asked)).collect();
        let mut objects = Self { asked, all, there: false, turn: 0, pace };
        objects.take_stock();
        objects
    }

    /// Notes whether any SubDevice has an entry to read, wherever entries come or go: a segment
    /// without any is asked in each cycle.
    fn take_stock(&mut self) {
        self.there = self.all.iter().any(|device| !device.entries.is_empty());
    }

    /// Whether any SubDevice has an entry to read.
    pub fn are_there(&self) -> bool {
        self.there
    }

    pub fn is_due(&self, now: Time<Host>) -> bool {
        self.pace.is_due(now) && self.are_there()
    }

    /// Called when the state of a SubDevice has changed: a silent one may answer now, and the
    /// entries of one that has come are now known.
    pub fn meet(&mut self, device: &SubDevice) {
        let Some(known) = self.all.get_mut(device.position) else { return };
        known.rests = Time::ZERO;
        if device.admitted && known.entries.is_empty() {
            known.entries = ObjectQuality::new(device, self.asked).entries;
            self.take_stock();
        }
    }

    /// The entry to read next, of SubDevices with a free mailbox.
    pub fn next(
        &mut self,
        now: Time<Host>,
        is_free: impl Fn(usize) -> bool,
    ) -> Option<(usize, ObjectAddress)> {
        let count = self.all.len();
        let ready = |device: &ObjectQuality| {
            !device.entries.is_empty() && now >= device.rests && is_free(device.position)
        };
        let found = (0..count).map(|i| (self.turn + i) % count).find(|at| ready(&self.all[*at]));
        let Some(at) = found else {
            self.pace.rest(now, LOOK_AGAIN);
            return None;
        };
        self.turn = at + 1;
        let device = &self.all[at];
        let entry = device.entries[device.turn % device.entries.len()];
        Some((device.position, entry.object))
    }

    /// Takes the answer of a reading; returns the alarms that come or end.
    pub fn take(
        &mut self,
        (position, object): (usize, ObjectAddress),
        now: Time<Host>,
        answer: &SdoResult,
    ) -> Vec<Change> {
        let Some(device) = self.all.get_mut(position) else { return Vec::new() };
        let changes = device.take(object, now, answer);
        // An entry that was refused is gone.
        if device.entries.is_empty() {
            self.take_stock();
        }
        changes
    }
}

/// A value of 1 to 4 bytes.
fn number(bytes: &[u8]) -> Option<u32> {
    let fits = (1..=4).contains(&bytes.len());
    fits.then(|| bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte)))
}

/// The error counters, and the sync error flag.
const COUNTERS: [u8; 5] = [
    sub::SM_EVENT_MISSED,
    sub::CYCLE_TIME_TOO_SMALL,
    sub::SHIFT_TIME_TOO_SHORT,
    sub::TOGGLE_FAILED,
    sub::SYNC_ERROR,
];
/// The distances of SM2 events and SYNC0 that the device measures; reserved in 0x1C33.
const DISTANCES: [u8; 4] = [
    sub::MINIMUM_CYCLE_DISTANCE,
    sub::MAXIMUM_CYCLE_DISTANCE,
    sub::MINIMUM_SM_SYNC_DISTANCE,
    sub::MAXIMUM_SM_SYNC_DISTANCE,
];
/// Number of readings without an increase that end the alarm of a counter.
const CALM: u8 = 3;
/// Pause after a mailbox did not answer.
const REST: Nanos = Nanos(30_000_000_000);
/// Pause if no mailbox is free.
const LOOK_AGAIN: Nanos = Nanos(10_000_000);

#[cfg(test)]
mod tests {
    use alloc::vec;

    use isocat_wire::AbortCode;

    use super::*;
    use crate::error::MailboxError;

    fn entry(sub: u8) -> EntryQuality {
        let value = Ok(vec![0, 0]);
        EntryQuality::new(0x1C32, &SyncEntry { sub, description: None, value })
    }

    fn take(entry: &mut EntryQuality, values: &[u32]) -> Vec<Option<bool>> {
        let at = |i: usize| Time::new(i as u64);
        let of = |(i, value): (usize, &u32)| Some(entry.take(at(i), *value)?.0);
        values.iter().enumerate().map(of).collect()
    }

    /// The first value raises no alarm; an increase does, and three readings without one end it.
    #[test]
    fn a_counter_that_rises() {
        let mut counter = entry(0x0C);
        let changes = take(&mut counter, &[7, 7, 8, 8, 8, 9, 9, 9, 9, 9]);
        assert_eq!(changes[2], Some(true));
        assert_eq!(changes[8], Some(false), "two readings were not enough: {changes:?}");
        assert_eq!(changes.iter().flatten().count(), 2);
        assert_eq!((counter.risen, counter.last), (2, Some((Time::new(9), 9))));
        // The counter was reset, and has risen to 3 since.
        assert_eq!(take(&mut counter, &[3]), [Some(true)]);
        assert_eq!(counter.risen, 5);
    }

    /// 0x1C32:0B decreases by events in time: only its increases count.
    #[test]
    fn the_counter_that_leaks() {
        let mut missed = entry(0x0B);
        let changes = take(&mut missed, &[0, 3, 2, 1, 0, 0, 3, 6]);
        let expected = [None, Some(true), None, None, Some(false), None, Some(true), None];
        assert_eq!(changes, expected);
        assert_eq!(missed.risen, 9);
    }

    /// The flag is an alarm as long as it is set, even from the start; distances raise none.
    #[test]
    fn sync_error_and_distances() {
        let mut flag = entry(0x20);
        let changes = take(&mut flag, &[1, 1, 0, 0, 0]);
        assert_eq!(changes, [Some(true), None, None, None, Some(false)]);
        let mut distance = entry(0x11);
        assert_eq!(take(&mut distance, &[500, 400, 300]), [None; 3]);
        assert_eq!((distance.risen, distance.last), (0, Some((Time::new(2), 300))));
    }

    fn objects(entries: &[&[u8]]) -> Objects {
        let pace = Pace::new(10, Time::ZERO);
        let mut objects = Objects::new(false, &[], pace);
        for (position, subs) in entries.iter().enumerate() {
            let mut device = SubDevice::new(position, isocat_wire::StationAddress(1));
            device.sii.header.protocols = isocat_wire::sii::Header::COE;
            device.sii.header.receive.length = 128;
            device.sii.header.send.length = 128;
            let entries = subs.iter().map(|sub| SyncEntry {
                sub: *sub,
                description: None,
                value: Ok(vec![0, 0]),
            });
            let object = SyncObject { entries: entries.collect(), ..SyncObject::default() };
            device.output_sync = Some(object);
            objects.all.push(ObjectQuality::new(&device, true));
        }
        objects.take_stock();
        objects
    }

    /// SubDevices without entries and with a mailbox in use are skipped; a refused entry is not
    /// read again.
    #[test]
    fn each_in_turn() {
        let mut objects = objects(&[&[0x01, 0x0B, 0x0C, 0x11], &[0x01, 0x02], &[0x0D]]);
        let now = Time::new(0);
        let ask = |objects: &mut Objects, answer: SdoResult, busy: usize| {
            let (position, object) = objects.next(now, |at| at != busy).expect("somebody is free");
            objects.take((position, object), now, &answer);
            (position, object.sub)
        };
        let ok = || Ok(vec![5, 0]);
        let nobody = 9;
        assert_eq!(ask(&mut objects, ok(), nobody), (0, 0x0B));
        assert_eq!(ask(&mut objects, ok(), nobody), (2, 0x0D));
        assert_eq!(
            ask(&mut objects, Err(SdoError::Abort(AbortCode::NO_OBJECT)), nobody),
            (0, 0x0C)
        );
        assert_eq!(ask(&mut objects, ok(), 2), (0, 0x11));
        assert_eq!(ask(&mut objects, ok(), 2), (0, 0x0B));
        assert_eq!(ask(&mut objects, ok(), nobody), (2, 0x0D));
        assert_eq!(ask(&mut objects, ok(), nobody), (0, 0x11));
        let left: Vec<u8> = objects.all[0].entries.iter().map(|entry| entry.object.sub).collect();
        assert_eq!(left, [0x0B, 0x11]);
        assert_eq!(objects.next(now, |_| false), None);
        assert!(!objects.is_due(now), "nobody is free: later");
    }

    /// Three services without an answer raise the alarm, and the first answer ends it; in between
    /// the mailbox gets its pause.
    #[test]
    fn a_mailbox_that_is_silent() {
        let mut objects = objects(&[&[0x0B]]);
        let mut now = Time::new(0);
        let lost = Err(SdoError::Mailbox(MailboxError::NoAnswer { after: Nanos(1) }));
        let wanted = (0, ObjectAddress::new(0x1C32, 0x0B));
        for expected in [None, None, Some(true), None] {
            assert_eq!(objects.next(now, |_| true), Some(wanted));
            let changes = objects.take(wanted, now, &lost);
            assert_eq!(changes.first().map(|change| change.raised), expected);
            assert_eq!(objects.next(now + REST + Nanos(-1), |_| true), None);
            now += REST;
        }
        objects.all[0].rests = now + REST;
        objects.meet(&SubDevice::new(0, isocat_wire::StationAddress(1)));
        assert_eq!(objects.next(now, |_| true), Some(wanted));
        let changes = objects.take(wanted, now, &Ok(vec![0, 0]));
        assert_eq!((changes[0].alarm, changes[0].raised), (Alarm::MailboxSilent, false));
        assert_eq!(objects.all[0].unanswered, 4);
    }
}

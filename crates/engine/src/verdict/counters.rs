//! Follows the counters of the SubDevices: 0x1C32 and 0x1C33 before, during and after operation.

use isocat_maindevice::SubDevice;
use isocat_maindevice::quality::EntryQuality;
use isocat_maindevice::segment::SyncObject;
use isocat_sim::run::Counters;
use isocat_sim::{Judged, Place};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlStatus, AlStatusCode, ObjectAddress};

use super::{Gap, Verdict, Witness};

/// Readings of one SubDevice at the beginning and at the end of the time in operation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Readings {
    /// Registers 0x0130 and 0x0134 at the end; `None` if it did not answer.
    pub status: Option<(AlStatus, AlStatusCode)>,
    /// Register 0x092C at the end; `None` without clock, or if it did not answer.
    pub difference: Option<Nanos>,
    /// Counters of 0x1C32 at the beginning of the time in operation.
    pub outputs_before: Counters,
    /// Counters of 0x1C32 at the end.
    pub outputs: Counters,
    /// Counters of 0x1C33 at the beginning of the time in operation.
    pub inputs_before: Counters,
    /// Counters of 0x1C33 at the end.
    pub inputs: Counters,
}

/// Follows the counters that are read in the background.
pub(super) struct Counted {
    /// By position: time of the last reading of the counter of missed events, and the longest time
    /// between two readings.
    paces: Vec<Pace>,
}

#[derive(Clone, Copy, Default)]
struct Pace {
    last: Option<Time<Host>>,
    longest: Nanos,
    silent: bool,
}

impl Counted {
    pub fn new(main: &impl Witness) -> Self {
        Self { paces: vec![Pace::default(); main.segment().devices.len()] }
    }

    /// Takes the readings of one SubDevice: in each cycle another one.
    pub fn look(&mut self, main: &impl Witness, cycle: u64) {
        let Some(objects) = main.objects() else { return };
        let at = (cycle % self.paces.len().max(1) as u64) as usize;
        let (Some(pace), Some(objects)) = (self.paces.get_mut(at), objects.get(at)) else {
            return;
        };
        pace.silent |= objects.is_silent();
        let missed = |entry: &&EntryQuality| entry.object.sub == sub::SM_EVENT_MISSED;
        let Some((last, _)) = objects.entries.iter().find(missed).and_then(|entry| entry.last)
        else {
            return;
        };
        if pace.last != Some(last) {
            let before = pace.last.replace(last).unwrap_or(last);
            pace.longest = pace.longest.max(last - before);
        }
    }

    /// Adds the results. `in_frames` says for which positions the frames' times show misses.
    pub fn end(
        &mut self,
        main: &impl Witness,
        readings: &[Readings],
        in_frames: impl Fn(usize) -> bool,
        verdict: &mut Verdict,
    ) {
        for device in main.segment().devices.iter().filter(|device| device.admitted) {
            let position = device.position;
            let place = Place::device(position);
            let objects = main.objects().and_then(|objects| objects.get(position));
            let entries = objects.map_or(&[][..], |objects| &objects.entries);
            let said = readings.get(position).copied().unwrap_or_default();
            // The inputs' object mirrors the outputs'.
            let counted = complaint(OUTPUT_PARAMETER, &said.outputs_before, &said.outputs, entries)
                .or_else(|| complaint(INPUT_PARAMETER, &said.inputs_before, &said.inputs, entries));
            if let Some(kind) = counted {
                verdict.add(place, None, kind);
            }
            if !device.mode.uses_dc() {
                continue;
            }
            let pace = self.paces[position];
            let ended = said.outputs.sm_event_missed.or(said.inputs.sm_event_missed);
            match (has_missed(device), in_frames(position)) {
                (false, false) => verdict.doubt(place, Gap::NothingTells),
                (false, true) => verdict.doubt(place, Gap::NoCounter),
                (true, _) if pace.silent || pace.last.is_none() && ended.is_none() => {
                    verdict.doubt(place, Gap::CountersNotRead);
                }
                (true, _) => verdict.doubt(place, Gap::OwnMisses { longest: pace.longest }),
            }
        }
    }
}

/// Whether a SubDevice counts missed events.
fn has_missed(device: &SubDevice) -> bool {
    let has = |object: &Option<SyncObject>| {
        object.as_ref().is_some_and(|object| {
            object.entry(sub::SM_EVENT_MISSED).is_some_and(|entry| entry.number().is_some())
        })
    };
    has(&device.output_sync) || has(&device.input_sync)
}

/// The worst count of an object in operation: an increase from beginning to end, or an increase in
/// the background reads that may have gone down again.
fn complaint(
    index: u16,
    before: &Counters,
    after: &Counters,
    entries: &[EntryQuality],
) -> Option<Judged> {
    let object = |sub| ObjectAddress::new(index, sub);
    let grown = |sub: u8, before: Option<u32>, after: Option<u32>| {
        let seen = entries.iter().find(|entry| entry.object == object(sub));
        let risen = seen.map_or(0, |entry| u32::try_from(entry.risen).unwrap_or(u32::MAX));
        let last = after.or(seen.and_then(|entry| Some(entry.last?.1)))?;
        // A counter that is smaller than before was reset and counted again. The counter of missed
        // events goes down by itself.
        let by = match last.checked_sub(before.unwrap_or(0)) {
            Some(by) => by,
            None if sub == sub::SM_EVENT_MISSED => 0,
            None => last,
        };
        let by = by.max(risen);
        (by > 0).then_some((object(sub), by, last))
    };
    let missed = (before.sm_event_missed, after.sm_event_missed);
    if let Some((object, grew, value)) = grown(sub::SM_EVENT_MISSED, missed.0, missed.1) {
        return Some(Judged::SmEventMissed { object, grew, value });
    }
    let small = (before.cycle_time_too_small, after.cycle_time_too_small);
    if let Some((object, grew, value)) = grown(sub::CYCLE_TIME_TOO_SMALL, small.0, small.1) {
        return Some(Judged::CycleTimeTooSmall { object, grew: Some(grew), value });
    }
    let short = (before.shift_time_too_short, after.shift_time_too_short);
    if let Some((object, grew, value)) = grown(sub::SHIFT_TIME_TOO_SHORT, short.0, short.1) {
        return Some(Judged::ShiftTimeTooShort { object, grew: Some(grew), value });
    }
    let flag = object(sub::SYNC_ERROR);
    let risen = entries.iter().any(|entry| entry.object == flag && entry.risen > 0);
    let value = after.sync_error.filter(|error| *error > 0);
    let value = value.or(risen.then_some(1))?;
    Some(Judged::SyncError { object: flag, grew: None, value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_grew_in_operation_counts() {
        let missed = |missed| Counters { sm_event_missed: Some(missed), ..Counters::default() };
        let says = |before, after| complaint(0x1C32, &missed(before), &missed(after), &[]);
        let object = ObjectAddress::new(0x1C32, 0x0B);
        let grew = |grew, value| Some(Judged::SmEventMissed { object, grew, value });
        assert_eq!(says(7, 7), None);
        assert_eq!(says(7, 8), grew(1, 8));
        assert_eq!(says(7, 2), None, "it goes down by itself");
        assert_eq!(says(7, 0), None);
        assert_eq!(complaint(0x1C32, &Counters::default(), &Counters::default(), &[]), None);
        let small = |small| Counters { cycle_time_too_small: Some(small), ..Counters::default() };
        let says = |before, after| complaint(0x1C32, &small(before), &small(after), &[]);
        let object = ObjectAddress::new(0x1C32, 0x0C);
        let grew =
            |grew, value| Some(Judged::CycleTimeTooSmall { object, grew: Some(grew), value });
        assert_eq!(says(7, 7), None);
        assert_eq!(says(7, 2), grew(2, 2), "set back, and counted on");
    }

    #[test]
    fn a_sync_error_counts_while_it_is_set() {
        let set = Counters { sync_error: Some(1), ..Counters::default() };
        let object = ObjectAddress::new(0x1C33, 0x20);
        let found = Some(Judged::SyncError { object, grew: None, value: 1 });
        assert_eq!(complaint(0x1C33, &set, &set, &[]), found);
        assert_eq!(complaint(0x1C33, &set, &Counters::default(), &[]), None);
    }
}

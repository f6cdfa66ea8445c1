//! All that is known at one moment, and the moments before.

use alloc::vec::Vec;

use isocat_sync::budget::Check;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::clocks::ClockQuality;
use super::objects::ObjectQuality;
use super::ring::Ring;
use crate::alarm::{Alarm, Change, Found, Hysteresis, LET_GO, RAISE};
use crate::cycle::CyclicExchange;
use crate::segment::{Segment, SubDevice, Timing};
use crate::statistics::Statistics;

/// What is known of the segment now. All points of time in it are the host's;
/// [`MainDevice::system_time`](crate::MainDevice::system_time) tells any of them in the segment's time.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Now.
    pub at: Time<Host>,
    /// Now, in the segment's time, by the servo.
    pub system: Time<Dc>,
    /// Cycles begun.
    pub cycle: u64,
    /// Cycles since all clocks last took the reference's time; `None` without clocks.
    pub unled: Option<u64>,
    /// By chunk of the process image: cycles in a row whose working counter was wrong, of LRW or LRD and of LWR.
    pub working_counters: &'a [[u64; 2]],
    /// All clocks but the reference's own.
    pub clocks: &'a [ClockQuality],
    /// By position: error counters and distances.
    pub objects: &'a [ObjectQuality],
    /// By position: AL status, and what is left before SYNC0.
    pub devices: &'a [DeviceQuality],
    pub(super) moments: &'a Ring<Moment>,
}

impl<'a> Snapshot<'a> {
    /// The last moments, oldest first, each of a hundred cycles or a few more; as many are kept as readings of a
    /// clock.
    pub fn moments(&self) -> impl DoubleEndedIterator<Item = Moment> + 'a {
        self.moments.iter()
    }
}

/// What happened in some hundred cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Moment {
    /// Its end.
    pub at: Time<Host>,
    /// Its end in the segment's time.
    pub system: Time<Dc>,
    /// The last cycle in it.
    pub cycle: u64,
    /// Cycles in it.
    pub cycles: u64,
    /// OR of all AL status at its end.
    pub al_status: AlStatus,
    /// SubDevices that answered at its end.
    pub answering: u16,
    /// Datagrams with a wrong working counter in it.
    pub working_counter_errors: u64,
    /// Frames lost in it.
    pub frames_lost: u64,
    /// How much later than planned the latest frame found the reference clock; `None`: none brought a time back.
    pub latest: Option<Nanos>,
    /// The largest of the last readings of 0x092C.
    pub difference: Nanos,
}

/// State and margin of one SubDevice.
#[derive(Clone, Copy, Debug)]
pub struct DeviceQuality {
    /// Last AL status seen (0x0130).
    pub status: AlStatus,
    /// Its code (0x0134).
    pub code: AlStatusCode,
    /// Since when it is so, to the next reading; from operation on.
    pub since: Time<Host>,
    /// What is left before SYNC0; `None` if it has no SYNC0, or without clocks.
    pub margin: Option<Margin>,
}

/// What frames leave between outputs ready, as the device states its times, and the SYNC0 that they are for. Counted by
/// the time that the reference clock puts into the cycle's first frame, so what the host's stamps are like is not in
/// it; the clock error is taken off, as in the plan.
#[derive(Clone, Copy, Debug)]
pub struct Margin {
    /// With a frame in time.
    pub planned: Nanos,
    /// In the last hundred cycles, at the latest frame.
    pub last: Nanos,
    /// The least so far.
    pub least: Nanos,
    alarm: Hysteresis,
}

impl Margin {
    /// Whether its alarm ([`Alarm::Margin`]) is up.
    pub const fn has_alarm(&self) -> bool {
        self.alarm.is_up()
    }

    fn new(timing: &Timing, position: usize) -> Option<Self> {
        let (_, budget) = timing.devices.get(position)?;
        let slack = budget.lines().filter(|line| BEFORE_SYNC0.contains(&line.check));
        // The jitter that the plan keeps free is there for frames that are late.
        let planned = slack.map(|line| line.slack()).min()? + timing.cycle.jitter;
        let alarm = Hysteresis::new(RAISE, LET_GO);
        Some(Self { planned, last: planned, least: planned, alarm })
    }

    /// Takes the latest frame. It is well again with a quarter of what is planned above the limit.
    fn take(&mut self, latest: Nanos, limit: Option<Nanos>) -> Option<(bool, Found)> {
        self.last = self.planned - latest;
        self.least = self.least.min(self.last);
        let (left, limit) = (self.last, limit?);
        let well = limit + Nanos((self.planned - limit).0 / 4);
        let raised = self.alarm.sample(left < limit, left >= well)?;
        Some((raised, Found::Margin { left, limit }))
    }
}

/// Keeps what a snapshot needs beside clocks and objects.
#[derive(Clone, Debug)]
pub(super) struct Record {
    pub devices: Vec<DeviceQuality>,
    pub moments: Ring<Moment>,
    limit: Option<Nanos>,
    /// Cycle and counts at the end of the last moment.
    before: (u64, u64, u64),
}

impl Record {
    pub fn new(
        limit: Option<Nanos>,
        history: usize,
        segment: &Segment,
        now: Time<Host>,
        cycle: u64,
        counts: &Statistics,
    ) -> Self {
        // Without a clock no frame brings back when it came.
        let timing = segment.timing.as_ref().filter(|_| segment.reference.is_some());
        let device = |device: &SubDevice| DeviceQuality {
            status: device.al_status,
            code: device.al_code,
            since: now,
            margin: timing.and_then(|timing| Margin::new(timing, device.position)),
        };
        Self {
            devices: segment.devices.iter().map(device).collect(),
            moments: Ring::new(history),
            limit,
            before: (cycle, counts.working_counter_errors, counts.frames_missed()),
        }
    }

    /// Whether a moment is over.
    pub fn is_due(&self, cycle: u64) -> bool {
        cycle.wrapping_sub(self.before.0) >= MOMENT
    }

    /// Takes the states as they are known now; tells whose has changed.
    pub fn take_states(
        &mut self,
        now: Time<Host>,
        segment: &Segment,
        mut tell: impl FnMut(&SubDevice),
    ) {
        for (known, device) in self.devices.iter_mut().zip(&segment.devices) {
            let seen = (device.al_status, device.al_code);
            if (known.status, known.code) != seen {
                (known.status, known.code) = seen;
                known.since = now;
                tell(device);
            }
        }
    }

    /// Ends a moment; gives the alarms that come or go.
    pub fn end_moment(
        &mut self,
        now: Time<Host>,
        cycle: &mut CyclicExchange,
        counts: &Statistics,
        difference: Nanos,
    ) -> Vec<Change> {
        let latest = cycle.take_latest();
        let (number, errors, lost) = self.before;
        let missed = counts.frames_missed();
        self.before = (cycle.number(), counts.working_counter_errors, missed);
        self.moments.push(Moment {
            at: now,
            system: cycle.servo().dc_at(now),
            cycle: cycle.number(),
            cycles: cycle.number() - number,
            al_status: AlStatus(cycle.al_status),
            answering: cycle.answering(),
            working_counter_errors: counts.working_counter_errors - errors,
            frames_lost: missed - lost,
            latest,
            difference,
        });
        latest.map_or(Vec::new(), |latest| self.take_latest(latest))
    }

    fn take_latest(&mut self, latest: Nanos) -> Vec<Change> {
        let mut changes = Vec::new();
        for (position, device) in self.devices.iter_mut().enumerate() {
            let Some(margin) = &mut device.margin else { continue };
            if let Some((raised, found)) = margin.take(latest, self.limit) {
                changes.push(Change { position, alarm: Alarm::Margin, raised, found });
            }
        }
        changes
    }
}

/// Cycles of a moment.
const MOMENT: u64 = 100;
/// The lines of the plan that a late frame eats up.
const BEFORE_SYNC0: [Check; 3] =
    [Check::OutputsStoredBeforeSync0, Check::OutputsBeforeSync0, Check::InputsReadBeforeSync0];

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 us planned, limit 20 us: raised below 20 us three times in a row, well again from 30 us on.
    #[test]
    fn margins_by_one_nanosecond() {
        let planned = Nanos(60_000);
        let alarm = Hysteresis::new(RAISE, LET_GO);
        let mut margin = Margin { planned, last: planned, least: planned, alarm };
        let mut take = |late: i64, times: usize| {
            let limit = Some(Nanos(20_000));
            let takes = (0..times).map(|_| Some(margin.take(Nanos(late), limit)?.0));
            takes.collect::<Vec<_>>()
        };
        assert_eq!(take(40_000, 10), [None; 10], "at the limit");
        assert_eq!(take(40_001, 3), [None, None, Some(true)]);
        assert_eq!(take(30_001, 20), [None; 20], "not well yet");
        let mut gone = [None; 8];
        gone[7] = Some(false);
        assert_eq!(take(30_000, 8), gone);
        assert_eq!((margin.last, margin.least), (Nanos(30_000), Nanos(19_999)));
        assert_eq!(margin.take(Nanos(90_000), None), None, "without a limit");
        assert_eq!(margin.least, Nanos(-30_000));
    }
}
